"""A covariance shared by all runs in linear filters, compared with an exact Kalman filter for each
run.
"""

from __future__ import annotations

import numpy as np
import pytest

from celnav import Gaussian, Linear, Motion, Sensor, ckf, ekf, epochs, run, steps, two_stage
from celnav.filters.switching import Fallback
from celnav.filters.two_stage import TwoStage
from celnav.gaussian.rules import Taylor
from celnav.models.noise import ar1_noise
from celnav.papers.tstdkf.method import Differenced, strong_tracking

RNG = np.random.default_rng(5)
T, RUNS, N, M, B = 25, 5, 4, 3, 2
F = RNG.normal(size=(T, N, N)) / np.sqrt(N)
H, GAMMA = RNG.normal(size=(T, M, N)), RNG.normal(size=(T, M, B))
Q, R, WALK = 0.1 * np.diag([1.0, 0.5, 2.0, 0.3]), np.diag([0.5, 1.0, 0.2]), np.diag([0.05, 0.02])
X0, P0, M0 = RNG.normal(size=(RUNS, N)), np.diag([2.0, 1.0, 0.5, 1.0]), np.diag([4.0, 1.0])
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])


def at(table):
    """A function that returns the table's row for an epoch."""
    return lambda epoch: table[epoch.k]


def constants(table):
    return lambda _mean, epoch: table[epoch.k]


def along(table):
    """The same as a function of points."""
    return lambda x, epoch: x @ table[epoch.k].T


MODELS = {
    "linear": (Motion(Linear(at(F)), Q), Sensor(Linear(at(H)), R)),
    "noise of the epoch": (
        Motion(Linear(at(F)), lambda _mean, _epoch: Q),
        Sensor(Linear(at(H)), lambda _mean, _epoch: R),
    ),
    "by Jacobians": (
        Motion(along(F), Q, jacobian=constants(F)),
        Sensor(along(H), R, jacobian=constants(H)),
    ),
}
MADE = pytest.mark.parametrize("made", MODELS)


def measured(missing=()):
    z = 2.0 * np.random.default_rng(1).normal(size=(T, RUNS, M))
    for where in missing:
        z[where] = np.nan
    return z


ALIKE = ((3, slice(None), 1), (7,), (8, slice(None), slice(2)))
APART = ((3, 0, 1), (9, 2))
SHARED = Gaussian(X0, P0)


def kalman(z, F=F, H=H, Q=Q, P=P0, pad=0):
    """Means ``(T, runs, n)`` and covariances by the textbook, run by run; the first epoch is an
    update.
    """
    means, covs = (np.empty((T, RUNS, N + pad, *more)) for more in ((), (N + pad,)))
    for i in range(RUNS):
        x, C = np.concatenate([X0[i], np.zeros(pad)]), P
        for k in range(T):
            if k:
                x, C = F[k] @ x, F[k] @ C @ F[k].T + Q
            used = ~np.isnan(z[k, i])
            h = H[k][used]
            K = np.linalg.solve(h @ C @ h.T + R[np.ix_(used, used)], h @ C).T
            x, C = x + K @ (z[k, i][used] - h @ x), C - K @ h @ C
            means[k, i], covs[k, i] = x, C
    return means, covs


def followed(filter, z, prior=SHARED):
    """Means and covariances, the latter with their stored shape."""
    states = [state.belief for _, state, _ in steps(filter, prior, epochs(np.arange(float(T)), z))]
    shape = states[-1].mean.shape  # at the first epochs several boosts may share one estimate
    return np.stack([np.broadcast_to(belief.mean, shape) for belief in states]), [
        belief.cov for belief in states
    ]


def augmented(z, Qb):
    """The exact filter of state and bias."""
    whole = np.zeros((2, T, N + B, N + B))
    whole[0, :, :N, :N], whole[0, :, N:, N:] = F, np.eye(B)
    noise, P = np.zeros((2, N + B, N + B))
    noise[:N, :N], noise[N:, N:] = Q, 0.0 if Qb is None else Qb
    P[:N, :N], P[N:, N:] = P0, M0
    return kalman(z, whole[0], np.concatenate([H, GAMMA], -1), noise, P, B)


@FORMS
@MADE
@pytest.mark.parametrize("missing", [(), ALIKE], ids=["all measured", "missing alike"])
def test_a_linear_filter_carries_one_covariance(form, made, missing):
    z = measured(missing)
    mean, covs = followed(ekf(*MODELS[made], form=form), z)
    exact, their = kalman(z)
    np.testing.assert_allclose(mean, exact, atol=1e-11)
    for mine, theirs in zip(covs, their, strict=True):
        assert mine.shape == (N, N)
        np.testing.assert_allclose(np.broadcast_to(mine, theirs.shape), theirs, atol=1e-11)


@FORMS
@MADE
def test_runs_that_miss_different_measurements_part(form, made):
    z = measured(APART)
    mean, covs = followed(ekf(*MODELS[made], form=form), z)
    exact, their = kalman(z)
    np.testing.assert_allclose(mean, exact, atol=1e-11)
    assert [cov.shape for cov in covs] == [(N, N)] * 3 + [(RUNS, N, N)] * (T - 3)
    np.testing.assert_allclose(covs[-1], their[-1], atol=1e-11)


@FORMS
@MADE
@pytest.mark.parametrize("Qb", [None, WALK], ids=["constant", "walk"])
@pytest.mark.parametrize("missing", [(), ALIKE, APART], ids=["all measured", "alike", "apart"])
def test_two_stages_carry_one_covariance(form, made, Qb, missing):
    z, bias = measured(missing), Gaussian(np.zeros(B), M0)
    filter = two_stage(*MODELS[made], constants(GAMMA), bias, Qb=Qb, form=form, rule=Taylor())
    mean, covs = followed(filter, z)
    exact, their = augmented(z, Qb)
    np.testing.assert_allclose(mean, exact, atol=1e-10)
    for mine, theirs in zip(covs, their, strict=True):
        np.testing.assert_allclose(np.broadcast_to(mine, theirs.shape), theirs, atol=1e-10)
    assert covs[-1].shape == ((RUNS, N + B, N + B) if missing == APART else (N + B, N + B))


def test_a_track_has_every_run():
    filter = two_stage(
        *MODELS["linear"], constants(GAMMA), Gaussian(np.zeros(B), M0), form="covariance"
    )
    one, many = (
        run(filter, prior, np.arange(float(T)), measured(ALIKE), keep="cov")
        for prior in (SHARED, apart())
    )
    assert one.cov.shape == (T, RUNS, N + B, N + B)
    for name in ("mean", "std", "cov", "nis", "log_likelihood", "innovation"):
        np.testing.assert_allclose(
            getattr(one, name), getattr(many, name), atol=1e-11, err_msg=name
        )
    np.testing.assert_array_equal(one.events["missing"], many.events["missing"])


def apart():
    """The prior with a covariance for each run."""
    return Gaussian(X0, np.tile(P0, (RUNS, 1, 1)))


def test_what_has_no_matrix_has_a_covariance_for_each_run():
    bent = Motion(lambda x, epoch: np.sin(x @ F[epoch.k].T), Q)
    for filter in (
        ckf(bent, MODELS["linear"][1]),
        Fallback(ekf(*MODELS["linear"]), ckf(*MODELS["linear"])),
    ):
        assert filter.start(SHARED).belief.cov.shape == (RUNS, N, N)


@FORMS
def test_a_measurement_without_noise_of_what_is_known_is_told(form):
    """The failure occurs in every run."""
    sensor = Sensor(Linear(lambda _epoch: np.eye(1, N)), np.zeros((1, 1)))
    filter = ekf(MODELS["linear"][0], sensor, sensor, form=form)
    state, _ = filter.update(
        filter.start(SHARED),
        epochs([0.0], (np.zeros((1, RUNS, 1)), np.full((1, RUNS, 1), np.nan)))[0],
    )
    assert state.belief.cov.shape == (N, N)
    expected = X0 - X0[:, :1] * P0[:, 0] / P0[0, 0]
    np.testing.assert_allclose(state.belief.mean, expected, atol=1e-12)
    state, _ = filter.update(
        state, epochs([0.0], (np.zeros((1, RUNS, 1)), np.full((1, RUNS, 1), np.nan)))[0]
    )
    assert np.isnan(state.belief.mean).all()


# -- strong tracking and differencing --------------------------------------------------------------
FACTORS = 1.0 + np.random.default_rng(2).random((2, RUNS, B))


def constant_boost(memory, seen):
    assert seen.total.shape[-2:] == (M, M)
    return memory, FACTORS


@FORMS
@pytest.mark.parametrize("prior", [SHARED, apart()], ids=["shared", "apart"])
def test_a_boost_inflates_the_covariance_of_the_gain_alone(form, prior):
    filter = two_stage(
        *MODELS["linear"],
        constants(GAMMA),
        Gaussian(np.zeros(B), M0),
        boost=constant_boost,
        form=form,
    )
    (_, last, _), (_, state, (info,)) = list(
        steps(filter, prior, epochs(np.arange(4.0), measured()[:4]))
    )[2:]
    S = np.broadcast_to(H[3] @ (F[3] @ last.Lambda) + GAMMA[3], (2, RUNS, M, B))
    own = np.broadcast_to(last.bias.cov, (2, RUNS, B, B))
    D = np.sqrt(FACTORS)[..., None] * np.eye(B)
    inflated = D @ own @ D
    first = np.broadcast_to(info.sqrt_S @ info.sqrt_S.mT - S @ own @ S.mT, (2, RUNS, M, M))
    K = np.linalg.solve(S @ inflated @ S.mT + first, S @ inflated).mT
    expected = last.bias.mean + (K @ np.asarray(info.innovation)[..., None])[..., 0]
    np.testing.assert_allclose(state.bias.mean, expected, atol=1e-11)


def test_the_differenced_stage_carries_one_covariance():
    noise = ar1_noise(0.5 * np.eye(M), 0.3 * np.eye(N), 0.2 * RNG.normal(size=(N, M)), R, Q)
    G = RNG.normal(size=(T, N, N))
    stage = Differenced(
        lambda x, epoch: (x @ F[epoch.k].T, F[epoch.k], G[epoch.k]), along(H), constants(H), noise
    )
    boost = strong_tracking([[[8.0, 3.0, 2.0]], [[0.0, 0.0, 0.0]]], 5.0)

    def boosted(memory, seen):
        memory, factors = boost(memory, seen)
        return memory, factors[..., :B]

    filter = TwoStage.of(stage, constants(GAMMA), Gaussian(np.zeros(B), M0), boost=boosted)
    z = measured()
    (one, covs), (many, theirs) = (followed(filter, z, prior) for prior in (SHARED, apart()))
    np.testing.assert_allclose(one, many, atol=1e-11)
    assert covs[-1].shape == (N + B, N + B)
    np.testing.assert_allclose(np.broadcast_to(covs[-1], theirs[-1].shape), theirs[-1], atol=1e-11)
