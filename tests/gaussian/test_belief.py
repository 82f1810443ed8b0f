"""Beliefs in both forms: their parts against the covariance algebra written out, and what priors refuse."""

import numpy as np
import pytest
from scipy.stats import chi2

from celnav.gaussian.belief import COVARIANCE, SQUARE_ROOT, covariance, nees, sqrt_cov, square_root
from celnav.gaussian.checks import finite

FORMS = [SQUARE_ROOT, COVARIANCE]
BATCHES = [(), (3,), (2, 3)]


def by_form(form):
    return pytest.mark.parametrize(form, FORMS, ids=lambda f: f.name)


def spread_of(form, P):
    return np.linalg.cholesky(P) if form is SQUARE_ROOT else P


def signed(A, sign):
    """A diag(sign, 1, 1, ...) A'."""
    s = np.concatenate([sign, np.ones(A.shape[-1] - len(sign))])
    return (A * s) @ A.mT


@by_form("form")
@pytest.mark.parametrize("batch", BATCHES)
def test_spread_root_covariance_and_std_agree(form, batch):
    A = np.random.default_rng(1).normal(size=(*batch, 3, 5))
    P = A @ A.mT
    S = spread_of(form, P)
    np.testing.assert_allclose(form.covariance(S), P, atol=1e-13)
    np.testing.assert_allclose(form.root(S) @ form.root(S).mT, P, atol=1e-13)
    np.testing.assert_allclose(form.std(S), np.sqrt(P.diagonal(0, -2, -1)), rtol=1e-13)
    np.testing.assert_allclose(form.covariance(form.sum(S, A)), 2.0 * P, atol=1e-12)


SIGNS = {"all positive": np.ones(8), "two negative": np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0])}


def prearray(batch, sign):
    """Columns whose signed covariance is definite: those of negative sign are small."""
    A = np.random.default_rng(2).normal(size=(*batch, 5, 10))
    A[..., :8] *= np.where(sign < 0.0, 0.1, 1.0)
    return A


@by_form("form")
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("sign", SIGNS.values(), ids=SIGNS)
def test_marginal_counts_columns_with_their_sign(form, batch, sign):
    A = prearray(batch, sign)
    np.testing.assert_allclose(form.covariance(form.marginal(A, sign)), signed(A, sign), atol=1e-12)


@by_form("form")
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("sign", SIGNS.values(), ids=SIGNS)
def test_condition_is_the_schur_complement(form, batch, sign):
    A = prearray(batch, sign)
    P, m = signed(A, sign), 2
    S, U, spread = form.condition(A, sign, m)
    K = P[..., m:, :m] @ np.linalg.inv(P[..., :m, :m])
    np.testing.assert_allclose(S @ S.mT, P[..., :m, :m], atol=1e-12)
    np.testing.assert_allclose(U, K @ S, atol=1e-12)
    np.testing.assert_allclose(form.covariance(spread), P[..., m:, m:] - K @ P[..., :m, m:], atol=1e-12)


@by_form("form")
@pytest.mark.parametrize("sign", SIGNS.values(), ids=SIGNS)
def test_condition_with_a_given_gain_is_josephs_form(form, sign):
    A = prearray((3,), sign)
    P, m = signed(A, sign), 2
    K = np.random.default_rng(3).normal(size=(3, 3, m))
    S, U, spread = form.condition(A, sign, m, K)
    T = np.concatenate([-K, np.broadcast_to(np.eye(3), (3, 3, 3))], -1)
    np.testing.assert_allclose(form.covariance(spread), T @ P @ T.mT, atol=1e-11)
    np.testing.assert_allclose(U, K @ S, atol=1e-12)


def test_priors_of_both_forms_are_the_same_belief():
    mean, P = np.array([1.0, 2.0]), np.array([[2.0, 0.5], [0.5, 1.0]])
    for belief in (square_root(mean, P), square_root(mean, root=np.linalg.cholesky(P)), covariance(mean, P)):
        np.testing.assert_allclose(belief.cov, P, rtol=1e-14)
        np.testing.assert_allclose(belief.root, np.linalg.cholesky(P), rtol=1e-14)
        np.testing.assert_allclose(belief.std, np.sqrt([2.0, 1.0]), rtol=1e-14)


def test_a_prior_broadcasts_means_and_covariances():
    belief = square_root(np.zeros((5, 2)), np.eye(2))
    assert belief.spread.shape == (5, 2, 2)
    belief = covariance(np.zeros(2), np.broadcast_to(np.eye(2), (4, 2, 2)))
    assert belief.mean.shape == (4, 2)


def test_samples_have_the_moments():
    P = np.array([[2.0, 0.5], [0.5, 1.0]])
    belief = covariance(np.array([[1.0, -1.0], [3.0, 0.0]]), np.stack([P, 4.0 * P]))
    x = belief.sample(np.random.default_rng(5), (200_000,))
    assert x.shape == (200_000, 2, 2)
    for i, scale in enumerate((1.0, 4.0)):
        tolerance = 5.0 * np.sqrt(2.0) * 2.0 * scale / np.sqrt(200_000)  # five deviations of a sample variance
        np.testing.assert_allclose(np.cov(x[:, i].T), scale * P, atol=tolerance)
        np.testing.assert_allclose(x[:, i].mean(0), belief.mean[i], atol=5.0 * np.sqrt(2.0 * scale / 200_000))


def test_samples_on_a_curved_space_are_tangents():
    belief = square_root(np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3))
    assert belief.sample(np.random.default_rng(0), (7,)).shape == (7, 3)


@pytest.mark.parametrize("batch", BATCHES)
def test_nees_is_the_quadratic_form(batch):
    rng = np.random.default_rng(6)
    A, e = rng.normal(size=(*batch, 3, 5)), rng.normal(size=(*batch, 3))
    P = A @ A.mT
    expected = np.einsum("...i,...ij,...j->...", e, np.linalg.inv(P), e)
    np.testing.assert_allclose(nees(e, np.linalg.cholesky(P)), expected, rtol=1e-10)


def test_nees_of_samples_is_chi_square():
    belief = square_root(np.zeros(4), np.diag([1.0, 1e-12, 1e12, 4.0]))
    values = nees(belief.sample(np.random.default_rng(7), (2000,)), belief.root)
    low, high = chi2.ppf([0.0005, 0.9995], 4 * 2000) / 2000
    assert low < values.mean() < high


@pytest.mark.parametrize("make", [square_root, covariance])
@pytest.mark.parametrize(
    ("mean", "cov", "words"),
    [
        ([0.0, np.nan], np.eye(2), "mean: expected finite"),
        (0.0, np.eye(1), "mean: expected shape"),
        (["a", "b"], np.eye(2), "mean: expected numbers"),
        ([0.0, 0.0], [1.0, 1.0], r"cov: expected symmetric positive semidefinite.*shape \(2,\)"),
        ([0.0, 0.0], np.ones((2, 3)), r"cov: .*shape \(2, 3\)"),
        ([0.0, 0.0], np.diag([1.0, -0.25]), "cov: .*smallest eigenvalue -0.25"),
        ([0.0, 0.0], [[1.0, 0.5], [0.4, 1.0]], "cov: .*asymmetry 0.1"),
        ([0.0, 0.0], [[1.0, np.inf], [np.inf, 1.0]], "cov: expected finite"),
        ([0.0, 0.0], np.eye(3), r"mean: expected shape \(..., 3\)"),
        (np.zeros((2, 2)), np.broadcast_to(np.eye(2), (3, 2, 2)), "mean: batch axes"),
    ],
)
def test_a_prior_refuses_and_says_what(make, mean, cov, words):
    with pytest.raises(ValueError, match=words):
        make(mean, cov)


def test_a_root_prior_needs_exactly_one_of_both():
    with pytest.raises(ValueError, match="exactly one"):
        square_root([0.0])
    with pytest.raises(ValueError, match="exactly one"):
        square_root([0.0], np.eye(1), root=np.eye(1))


def test_sqrt_cov_names_the_argument_and_the_size():
    with pytest.raises(ValueError, match=r"R: expected symmetric positive semidefinite \(3, 3\), got shape \(2, 2\)"):
        sqrt_cov(np.eye(2), "R", 3)


def test_finite_copies():
    a = np.array([1.0, 2.0])
    b = finite("a", a)
    b[0] = 9.0
    assert a[0] == 1.0
