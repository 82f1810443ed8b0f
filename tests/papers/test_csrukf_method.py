"""The covariance of csrukf in five forms, and where each loses digits; closed forms for the loss
from a larger Phi.
"""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.linalg import lapack

from celnav.analysis.bounds import actual_covariance, colored_bound
from celnav.filters.run import run
from celnav.papers.csrukf import method, scenario
from celnav.study.montecarlo import generator

decimals = np.vectorize(Decimal, otypes=[object])
EPS = np.finfo(float).eps


def posterior(form, spread, D, E, sqrt_R):
    """Covariance given a measurement."""
    with np.errstate(invalid="ignore", divide="ignore"):
        after = method.updated(form, spread, D, E, sqrt_R)[1]
    return after @ after.mT if form in method.ROOTS else after


def scalar(form, e, make=np.array):
    """The variance after a prior variance of 1 and a measurement with standard deviation ``e``; e^2
    / (1 + e^2) is correct.
    """
    one = make([[1.0]])
    return posterior(form, one, one, one, make([[e]]))[0, 0]


@pytest.mark.parametrize("form", method.FORMS)
def test_what_subtracts_has_half_the_digits(form):
    subtracts = form in ("plain", "symmetrized", "downdated")
    for e in (1e-2, 1e-4, 1e-6):
        wrong = abs(scalar(form, e) * (1.0 + e * e) / (e * e) - 1.0)
        assert wrong <= (8.0 * EPS / e**2 if subtracts else 8.0 * EPS)
    if subtracts:
        assert wrong > 1e3 * EPS
        assert scalar(form, 1e-9) != pytest.approx(
            1e-18, rel=0.5, abs=0.0
        )  # zero, not positive definite, or round-off
    else:
        assert scalar(form, 1e-9) == pytest.approx(1e-18, rel=1e-12)


def cycles(form, make, n=3):
    """A covariance after updates and motions of a random linear system."""
    rng = np.random.default_rng(1)
    F, H, S = (make(rng.standard_normal(shape)) for shape in ((4, 4), (2, 4), (4, 4)))
    S, sqrt_Q, sqrt_R = method.tria(S), make(0.1 * np.eye(4)), make(1e-3 * np.eye(2))
    spread = S if form in method.ROOTS else S @ S.mT
    for _ in range(n):
        S = spread if form in method.ROOTS else method.cholesky(spread)
        spread = method.updated(form, spread, S, H @ S, sqrt_R)[1]
        A = np.concatenate(
            [F @ (spread if form in method.ROOTS else method.cholesky(spread)), sqrt_Q], -1
        )
        spread = method.tria(A) if form in method.ROOTS else A @ A.mT
    return spread @ spread.mT if form in method.ROOTS else spread


@pytest.mark.parametrize("form", method.FORMS)
def test_in_fifty_digits_all_forms_are_one(form):
    with localcontext(prec=50):
        exact = cycles("array", decimals)
        assert max(abs(cycles(form, decimals) - exact).ravel()) < Decimal("1e-40")
    np.testing.assert_allclose(cycles(form, np.array), exact.astype(float), rtol=1e-7)


def test_factorizations_are_those_of_lapack_and_stay_in_single_precision():
    A = np.random.default_rng(2).standard_normal((5, 9))
    L, C, P = method.tria(A), method.cholesky(A @ A.T), A @ A.T
    np.testing.assert_allclose(L, np.abs(np.linalg.qr(A.T, mode="r").T) * np.sign(L), rtol=1e-12)
    np.testing.assert_allclose(C, lapack.dpotrf(P, lower=1, clean=1)[0], rtol=1e-12)
    V = 0.5 * C[:, :2]
    np.testing.assert_allclose(
        method.downdate(C, V), np.linalg.cholesky(P - V @ V.T), rtol=1e-9, atol=1e-12
    )
    for short, long in ((method.tria(A.astype("f")), L), (method.cholesky(P.astype("f")), C)):
        assert short.dtype == np.float32
        assert 1e-9 < np.abs(short - long).max() < 1e-5
    assert np.isnan(method.cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]))[1, 1])
    assert np.isnan(method.downdate(np.eye(2), np.array([[1.0], [0.0]]))).any()


def test_what_is_small_keeps_its_digits_where_what_is_large_stands_first():
    """A reflection that starts with the noise of a precise measurement keeps half of the digits."""
    large, small = np.array([[1.0], [1.0]]), np.array([[1e-6], [0.0]])
    first, last = (
        method.tria(np.concatenate(columns, -1))[1, 1]
        for columns in ((large, small), (small, large))
    )
    assert first == pytest.approx(1e-6 / np.hypot(1.0, 1e-6), rel=4.0 * EPS)
    assert abs(last * np.hypot(1.0, 1e-6) / 1e-6 - 1.0) > 1e3 * EPS


def test_a_row_of_zeros_has_a_root():
    root = method.tria(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0], [3.0, 4.0, 2.0]]))
    np.testing.assert_allclose(
        root, [[5.0, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 2.0]], atol=4e-15
    )


def test_an_update_is_skew_by_rounding_only_and_the_next_prediction_is_symmetric():
    rng = np.random.default_rng(3)
    S, H = method.tria(rng.standard_normal((20, 6, 6))), rng.standard_normal((3, 6))
    P = method.updated("plain", S @ S.mT, S, H @ S, 0.1 * np.eye(3))[1]
    assert 0.0 < np.abs(P - P.mT).max() < 1e-13
    x = np.zeros((20, 6))
    P = method.step("plain", x, P, lambda X: X, np.zeros((6, 6)))[1]
    assert np.abs(P - P.mT).max() <= 4.0 * EPS * np.abs(P).max()


@pytest.mark.parametrize(
    ("changes", "name"),
    [({"phi": 0.8}, "csrukf"), ({"phi": 1.0}, "csrukf"), ({"measured": "angles"}, "angles")],
)
@pytest.mark.parametrize("form", method.FORMS)
def test_every_form_is_the_library_s_filter(changes, name, form):
    config = replace(scenario.P, steps=20, **changes)
    sims = [scenario.simulate(config, [generator(1, 1, r) for r in range(2)])] * 2
    track = run(scenario.filters(config)[name], sims[0].prior, sims[0].epochs(name))
    for k, (x, spread) in enumerate(
        method.fly(form, "double", [(config, 1.0), (config, 1e3)], sims)
    ):
        std = np.sqrt(
            np.vecdot(spread, spread) if form in method.ROOTS else spread.diagonal(0, -2, -1)
        )
        np.testing.assert_allclose(x, np.broadcast_to(track.mean[k + 1], x.shape), atol=1e-8)
        np.testing.assert_allclose(std, np.broadcast_to(track.std[k + 1], std.shape), rtol=1e-6)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_what_color_costs_the_mean_of_samples(phi):
    """A constant in stationary noise: the best estimate, and the mean of the samples, which is the
    estimate of a filter for white noise.
    """
    N, one, R, far = 40, np.ones((1, 1)), 0.04, 1e8 * np.ones((1, 1))
    first = R / (1.0 - phi**2)
    best = colored_bound(
        np.ones((N - 1, 1, 1)), one, phi * one, 0.0 * one, R * one, far, first * one
    )[-1, 0, 0]
    assert best == pytest.approx(R / ((1.0 - phi**2) + (N - 1) * (1.0 - phi) ** 2), rel=1e-6)
    gains = 1.0 / np.arange(1.0, N + 1.0)[:, None, None]
    mean = actual_covariance(
        np.ones((N, 1, 1)), one, gains, 0.0 * one, phi * one, R * one, far, first * one
    )[-1, 0, 0]
    sums = N * (1.0 + phi) / (1.0 - phi) - 2.0 * phi * (1.0 - phi**N) / (1.0 - phi) ** 2
    assert mean == pytest.approx(first * sums / N**2, rel=1e-6)


@pytest.mark.parametrize("N", [2, 30])
def test_larger_phi_worse_is_no_theorem(N):
    """The slope of a line with unknown start: with two samples it is more precise in random-walk
    noise than in white noise, with many samples less.
    """
    F, H, R = np.tile([[1.0, 1.0], [0.0, 1.0]], (N - 1, 1, 1)), np.eye(1, 2), 0.04 * np.ones((1, 1))
    white, walk = (
        colored_bound(F, H, phi * np.ones((1, 1)), np.zeros((2, 2)), R, 1e6 * np.eye(2), first)[
            -1, 1, 1
        ]
        for phi, first in ((0.0, R), (1.0, 1e6 * R))
    )
    assert white == pytest.approx(12.0 * 0.04 / (N * (N**2 - 1)), rel=1e-4)
    assert walk == pytest.approx(0.04 / (N - 1), rel=1e-4)
    assert (walk < white) == (N == 2)
