"""Beliefs in both forms against the covariance algebra written out, and invalid arguments of a
Gaussian.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from celnav.gaussian.belief import Gaussian, any_lost, nees, symmetric
from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Covariance, SquareRoot

BATCHES = [(), (3,), (2, 3)]
FORMS = pytest.mark.parametrize("form", [SquareRoot, Covariance])


def cov(form, spread):
    """Covariance from the matrix that a form stores."""
    return form(np.zeros(spread.shape[-1]), spread).cov


def signed(A, sign):
    """A diag(sign) A'."""
    return (A * sign) @ A.mT


@FORMS
@pytest.mark.parametrize("batch", BATCHES)
def test_root_covariance_and_std_agree_and_a_sum_adds(form, batch):
    A = np.random.default_rng(1).normal(size=(*batch, 3, 5))
    P = A @ A.mT
    belief = form.of(Gaussian(np.ones((*batch, 3)), P))
    assert isinstance(belief, form)
    np.testing.assert_allclose(belief.cov, P, atol=1e-13)
    np.testing.assert_allclose(belief.sqrt_cov @ belief.sqrt_cov.mT, P, atol=1e-13)
    np.testing.assert_allclose(belief.std, np.sqrt(P.diagonal(0, -2, -1)), rtol=1e-13)
    np.testing.assert_allclose(cov(form, form.sum(belief[1], A)), 2.0 * P, atol=1e-12)
    T = np.random.default_rng(4).normal(size=(*batch, 3, 3))
    np.testing.assert_allclose(cov(form, form.transported(T, belief[1])), T @ P @ T.mT, atol=1e-11)


SIGNS = {
    "all positive": np.ones(1),
    "two negative": np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
}


def prearray(batch, sign):
    """Columns whose signed covariance is positive definite: columns with
    negative sign are small.
    """
    A = np.random.default_rng(2).normal(size=(*batch, 5, 10))
    A *= np.where(sign < 0.0, 0.1, 1.0)
    return A


@FORMS
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("sign", SIGNS.values(), ids=SIGNS)
def test_marginal_counts_columns_with_their_sign(form, batch, sign):
    A = prearray(batch, sign)
    np.testing.assert_allclose(cov(form, form.marginal(A, sign)), signed(A, sign), atol=1e-12)


@FORMS
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("sign", SIGNS.values(), ids=SIGNS)
def test_condition_is_the_schur_complement(form, batch, sign):
    A = prearray(batch, sign)
    P, m = signed(A, sign), 2
    S, U, spread = form.condition(A, sign, m)
    K = P[..., m:, :m] @ np.linalg.inv(P[..., :m, :m])
    np.testing.assert_allclose(S @ S.mT, P[..., :m, :m], atol=1e-12)
    np.testing.assert_allclose(U, K @ S, atol=1e-12)
    np.testing.assert_allclose(cov(form, spread), P[..., m:, m:] - K @ P[..., :m, m:], atol=1e-12)


@FORMS
@pytest.mark.parametrize("sign", SIGNS.values(), ids=SIGNS)
def test_condition_with_a_given_gain_is_josephs_form(form, sign):
    A = prearray((3,), sign)
    P, m = signed(A, sign), 2
    K = np.random.default_rng(3).normal(size=(3, 3, m))
    S, U, spread = form.condition(A, sign, m, K)
    T = np.concatenate([-K, np.broadcast_to(np.eye(3), (3, 3, 3))], -1)
    np.testing.assert_allclose(cov(form, spread), T @ P @ T.mT, atol=1e-11)
    np.testing.assert_allclose(U, K @ S, atol=1e-12)


@FORMS
@pytest.mark.parametrize("sign", SIGNS.values(), ids=SIGNS)
def test_conditioning_is_the_same_where_the_prior_covariance_is_given(form, sign):
    A = prearray((3,), sign)
    A[..., 2:, 8:] = 0.0  # noise in the first rows only
    known, noise = form.marginal(A[..., 2:, :], sign), A[..., :2, 8:]
    given = form.condition(A, sign, 2, None, prior_factor=known, noise=noise)
    for mine, plain in zip(given, form.condition(A, sign, 2), strict=True):
        np.testing.assert_allclose(mine, plain, atol=1e-12)


def test_both_ways_to_say_a_gaussian_and_both_forms_are_the_same_belief():
    mean, P = np.array([1.0, 2.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
    for prior in (Gaussian(mean, P), Gaussian(mean, sqrt_cov=np.linalg.cholesky(P))):
        for belief in (prior, SquareRoot.of(prior), Covariance.of(prior)):
            np.testing.assert_allclose(belief.cov, P, rtol=1e-14)
            np.testing.assert_allclose(belief.sqrt_cov, np.linalg.cholesky(P), rtol=1e-14)
            np.testing.assert_allclose(belief.std, np.sqrt([2.0, 1.0]), rtol=1e-14)


def test_a_mean_may_be_replaced():
    """The root belongs to the covariance and is not a separate argument of `replace`."""
    P = np.array([[2.0, 0.5], [0.5, 1.0]])
    for prior in (Gaussian(np.zeros(2), P), Gaussian(np.zeros(2), sqrt_cov=np.linalg.cholesky(P))):
        other = replace(prior, mean=np.array([1.0, -1.0]))
        np.testing.assert_array_equal(other.mean, [1.0, -1.0])
        np.testing.assert_allclose(other.cov, P, rtol=1e-14)
        np.testing.assert_allclose(other.sqrt_cov, np.linalg.cholesky(P), rtol=1e-14)


def test_means_and_covariances_may_have_batch_axes_of_their_own():
    """Each run has its samples, about its mean, with its covariance."""
    means, P = np.arange(10.0).reshape(5, 2) ** 2, np.array([[2.0, 0.5], [0.5, 1.0]])
    each, N = np.arange(1.0, 6.0)[:, None, None] * P, 20_000
    for mean, cov in ((means, P), (means[1], each), (means, each)):
        prior = Gaussian(mean, cov)
        np.testing.assert_array_equal(prior.mean, mean)
        np.testing.assert_allclose(prior.cov, cov, rtol=1e-14)
        x = prior.sample(np.random.default_rng(0), (N,))
        assert x.shape == (N, 5, 2)
        root = np.linalg.cholesky(np.broadcast_to(cov, (5, 2, 2)))
        white = np.linalg.solve(root, (x - mean)[..., None])[..., 0].reshape(N, 10)
        # Ten columns of independent normal numbers: bounds of five standard deviations for mean and
        # covariance.
        np.testing.assert_allclose(white.mean(0), 0.0, atol=5.0 / np.sqrt(N))
        np.testing.assert_allclose(np.cov(white.T), np.eye(10), atol=5.0 * np.sqrt(2.0 / N))


def test_lost_is_what_is_not_finite_or_has_a_negative_variance():
    mean = np.zeros((4, 2))
    P = np.array([np.diag(v) for v in ([1.0, 4.0], [1.0, -1e-9], [4.0, -1e-13], [np.nan, 1.0])])
    np.testing.assert_array_equal(Covariance(mean, P).lost(), [False, True, False, True])
    np.testing.assert_array_equal(SquareRoot(mean, P).lost(), [False, False, False, True])
    np.testing.assert_array_equal(SquareRoot(np.array([[0.0, np.inf]]), P[:1]).lost(), [True])
    assert [any_lost(Covariance(mean[:1], P[i : i + 1])) for i in range(4)] == [
        False,
        True,
        False,
        True,
    ]


def test_samples_have_the_moments():
    P = np.array([[2.0, 0.5], [0.5, 1.0]])
    belief = Gaussian(np.array([[1.0, -1.0], [3.0, 0.0]]), np.stack([P, 4.0 * P]))
    x = belief.sample(np.random.default_rng(5), (200_000,))
    assert x.shape == (200_000, 2, 2)
    for i, scale in enumerate((1.0, 4.0)):
        tolerance = (
            5.0 * np.sqrt(2.0) * 2.0 * scale / np.sqrt(200_000)
        )  # five standard deviations of a sample variance
        np.testing.assert_allclose(np.cov(x[:, i].T), scale * P, atol=tolerance)
        np.testing.assert_allclose(
            x[:, i].mean(0), belief.mean[i], atol=5.0 * np.sqrt(2.0 * scale / 200_000)
        )


def test_samples_on_a_curved_space_are_tangents():
    """Three numbers about zero for a quaternion with four, for any mean."""
    P, N = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, -0.3], [0.0, -0.3, 0.5]]), 50_000
    for mean in ([0.0, 0.0, 0.0, 1.0], [0.6, 0.0, -0.8, 0.0]):
        x = Gaussian(np.array(mean), P).sample(np.random.default_rng(0), (N,))
        np.testing.assert_allclose(x.mean(0), 0.0, atol=5.0 * np.sqrt(2.0 / N))
        np.testing.assert_allclose(np.cov(x.T), P, atol=5.0 * 2.0 * np.sqrt(2.0 / N))


@pytest.mark.parametrize("batch", BATCHES)
def test_nees_is_the_quadratic_form(batch):
    rng = np.random.default_rng(6)
    A, e = rng.normal(size=(*batch, 3, 5)), rng.normal(size=(*batch, 3))
    P = A @ A.mT
    expected = np.einsum("...i,...ij,...j->...", e, np.linalg.inv(P), e)
    np.testing.assert_allclose(nees(e, np.linalg.cholesky(P)), expected, rtol=1e-10)


def test_nees_of_samples_is_chi_square():
    belief = Gaussian(np.zeros(4), np.diag([1.0, 1e-12, 1e12, 4.0]))
    values = nees(belief.sample(np.random.default_rng(7), (2000,)), belief.sqrt_cov)
    low, high = chi2.ppf([0.0005, 0.9995], 4 * 2000) / 2000
    assert low < values.mean() < high


@pytest.mark.parametrize(
    ("mean", "cov", "words"),
    [
        ([0.0, np.nan], np.eye(2), "mean: expected finite"),
        (0.0, np.eye(1), "mean: expected shape"),
        (["a", "b"], np.eye(2), "mean: expected numbers"),
        ([0.0, 0.0], [1.0, 1.0], r"cov: expected symmetric positive semidefinite.*shape \(2,\)"),
        ([0.0, 0.0], np.ones((2, 3)), r"cov: .*shape \(2, 3\)"),
        ([0.0, 0.0], np.diag([1.0, -0.25]), "cov: .*got an eigenvalue -0.25"),
        ([0.0, 0.0], [[1.0, 0.5], [0.4, 1.0]], "cov: .*asymmetry 0.1"),
        ([0.0, 0.0], [[1.0, np.inf], [np.inf, 1.0]], "cov: expected finite"),
        ([0.0, 0.0], np.eye(3), r"mean: expected shape \(..., 3\)"),
        (np.zeros((2, 2)), np.broadcast_to(np.eye(2), (3, 2, 2)), "mean: expected batch axes"),
    ],
)
def test_a_gaussian_refuses_and_says_what(mean, cov, words):
    with pytest.raises(ValueError, match=words):
        Gaussian(mean, cov)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "exactly one"),
        ({"cov": np.eye(1), "sqrt_cov": np.eye(1)}, "exactly one"),
        ({"sqrt_cov": [[1.0, 0.5], [0.0, 1.0]]}, "sqrt_cov: expected a lower triangular matrix"),
        ({"sqrt_cov": [1.0]}, r"sqrt_cov: expected shape \(..., n, n\), got \(1,\)"),
        ({"sqrt_cov": np.ones((2, 1))}, r"sqrt_cov: expected shape \(..., n, n\), got \(2, 1\)"),
        ({"sqrt_cov": [[np.nan]]}, "sqrt_cov: expected finite"),
    ],
)
def test_a_root_says_what_it_must_be(given, words):
    with pytest.raises(ValueError, match=words):
        Gaussian([0.0, 0.0], **given)


def test_a_covariance_names_the_argument_and_the_size():
    with pytest.raises(
        ValueError,
        match=r"R: expected symmetric positive semidefinite \(3, 3\), got shape \(2, 2\)",
    ):
        symmetric(np.eye(2), "R", 3)


def test_finite_copies():
    a = np.array([1.0, 2.0])
    b = finite("a", a)
    b[0] = 9.0
    assert a[0] == 1.0
