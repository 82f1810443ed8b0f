"""Two-stage filters against the augmented Kalman filter."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from celnav import Gaussian, Motion, Sensor, epochs, run, two_stage, ukf
from celnav.filters.records import Info
from celnav.filters.two_stage import Stage, TwoStage
from celnav.gaussian.linalg import SquareRoot, block

RNG = np.random.default_rng(0)
T, N, M, B = 40, 4, 3, 2
F = 0.9 * np.linalg.qr(RNG.normal(size=(N, N)))[0]
H, GAMMA = RNG.normal(size=(M, N)), RNG.normal(size=(M, B))
Q, R = 0.1 * np.diag([1.0, 0.5, 2.0, 0.3]), np.diag([0.5, 1.0, 0.2])
P0, M0, B0 = 2.0 * np.eye(N), np.diag([4.0, 1.0]), np.array([0.3, -0.2])
MOTION, SEEN, BIAS = Motion(lambda x, _epoch: x @ F.T, Q), Sensor(H, R), Gaussian(B0, M0)
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])


def measured(runs=3, seed=1):
    return np.random.default_rng(seed).normal(size=(T, runs, M)) * 2.0


def prior(runs):
    return Gaussian(np.zeros((runs, N)), P0)


def followed(filter, z, known=None):
    return run(
        filter,
        prior(z.shape[1]) if known is None else known,
        epochs(np.arange(float(T)), z),
        keep="cov",
    )


def augmented(form, z, Qb=None, M0=M0):
    transition = block([[F, 0], [0, np.eye(B)]])
    noise = block([[Q, 0], [0, np.zeros((B, B)) if Qb is None else Qb]])
    filter = ukf(
        Motion(lambda x, _epoch: x @ transition.T, noise),
        Sensor(np.hstack([H, GAMMA]), R),
        form=form,
    )
    mean = np.tile(np.concatenate([np.zeros(N), B0]), (z.shape[1], 1))
    return followed(filter, z, Gaussian(mean, block([[P0, 0], [0, M0]])))


def staged(form, z, M0=M0, **options):
    return followed(two_stage(MOTION, SEEN, GAMMA, Gaussian(B0, M0), form=form, **options), z)


@FORMS
@pytest.mark.parametrize("Qb", [None, np.diag([0.05, 0.02])], ids=["constant", "walk"])
def test_two_stages_are_the_augmented_filter(form, Qb):
    z = measured()
    two, one = staged(form, z, Qb=Qb), augmented(form, z, Qb)
    np.testing.assert_allclose(two.mean, one.mean, atol=1e-10)
    np.testing.assert_allclose(two.cov, one.cov, atol=1e-10)
    np.testing.assert_allclose(two.innovation, one.innovation, atol=1e-10)
    np.testing.assert_allclose(two.nis, one.nis, atol=1e-9)
    np.testing.assert_allclose(two.log_likelihood, one.log_likelihood, rtol=1e-9)


@FORMS
@pytest.mark.parametrize(
    "Qb",
    [None, np.zeros((B, B)), np.diag([0.05, 0.0]), np.full((B, B), 0.1)],
    ids=["none", "zero", "one", "both"],
)
@pytest.mark.parametrize(
    "M0",
    [np.zeros((B, B)), np.diag([4.0, 0.0]), np.diag([0.0, 1.0]), np.outer([1.0, 3.0], [1.0, 3.0])],
)
def test_a_bias_that_is_known_exactly(form, M0, Qb):
    """In all, some or a combination of its components, whichever components walk."""
    z = measured()
    z[7, 1] = np.nan
    two, one = staged(form, z, M0, Qb=Qb), augmented(form, z, Qb, M0)
    np.testing.assert_allclose(two.mean, one.mean, atol=1e-7)
    np.testing.assert_allclose(two.cov, one.cov, atol=1e-7)


@pytest.mark.parametrize("precise", [1.0, 1e-5])
def test_a_combination_of_biases_stays_known_for_long(precise):
    """In covariance form, where round-off remains from the time when the covariance was large."""
    sensor, known = Sensor(H, precise * R), Gaussian(B0, np.outer([1.0, 3.0], [1.0, 3.0]))
    z = np.concatenate([measured(seed=seed) for seed in range(4)])
    forms = (
        two_stage(MOTION, sensor, GAMMA, known, form=form, Qb=np.zeros((B, B)))
        for form in ("square root", "covariance")
    )
    one, two = (run(filter, prior(3), np.arange(float(len(z))), z, keep="cov") for filter in forms)
    np.testing.assert_allclose(two.mean, one.mean, atol=1e-9)
    np.testing.assert_allclose(two.cov, one.cov, atol=1e-12)


@FORMS
def test_missing_measurements_are_left_out_of_both_stages(form):
    z = measured()
    z[5, 0, 1] = z[6, 1] = z[9] = np.nan
    two, one = staged(form, z, Qb=np.diag([0.05, 0.02])), augmented(form, z, np.diag([0.05, 0.02]))
    np.testing.assert_allclose(two.mean, one.mean, atol=1e-10)
    np.testing.assert_allclose(two.cov, one.cov, atol=1e-10)
    np.testing.assert_allclose(two.nis, one.nis, atol=1e-9)
    np.testing.assert_array_equal(two.used, one.used)
    np.testing.assert_allclose(two.log_likelihood, one.log_likelihood, rtol=1e-9)


@FORMS
def test_a_bias_known_to_be_zero_leaves_the_first_stage_alone(form):
    z = measured()
    two = followed(
        two_stage(MOTION, SEEN, GAMMA, Gaussian(np.zeros(B), np.zeros((B, B))), form=form), z
    )
    one = followed(ukf(MOTION, SEEN, form=form), z)
    np.testing.assert_allclose(two.mean[..., :N], one.mean, atol=1e-12)
    np.testing.assert_array_equal(two.mean[..., N:], 0.0)


def test_the_sensitivity_is_the_derivative():
    z = measured(runs=1)
    filter = two_stage(MOTION, SEEN, GAMMA, BIAS)
    state, moved = filter.start(prior(1)), filter.start(prior(1))
    unit = np.array([0.7, -1.3])
    when = epochs(np.arange(float(T)), z)
    for epoch in when:
        state, _ = filter.step(state, epoch)
        moved, _ = filter.step(moved, epoch._replace(z=epoch.z + GAMMA @ unit))
    np.testing.assert_allclose(
        moved.first.belief.mean - state.first.belief.mean, -(state.Lambda @ unit), atol=1e-12
    )


class Fixed(NamedTuple):
    """State of `Lagged`: the estimate, and the residual of the last measurement."""

    belief: SquareRoot
    rest: Any = None


class Lagged:
    """A first stage with constant gain K. It subtracts D times the last residual from the
    measurement, and adds Omega times the innovation to its prediction.
    """

    D = np.array([[0.6, 0.2, 0.0], [0.0, -0.4, 0.1], [0.3, 0.0, 0.5]])
    K = 0.2 * H.T
    OMEGA = 0.1 * RNG.normal(size=(N, M))

    def __init__(self, omega):
        self.omega = self.OMEGA if omega else None

    def start(self, prior):
        return Fixed(SquareRoot.of(prior))

    def predict(self, state, _epoch):
        return state._replace(belief=state.belief._replace(mean=state.belief.mean @ F.T)), F

    def update(self, state, epoch):
        x, first = state.belief.mean, state.rest is None
        y = epoch.z - x @ H.T - (0.0 if first else state.rest @ self.D.T)
        if self.omega is not None:
            x = x + y @ self.omega.T
            y = y - (y @ self.omega.T) @ H.T
        x = x + y @ self.K.T
        lag = (None, None) if first else (self.D, H)
        stage = Stage(y, np.eye(M), self.K, H, np.ones(M, bool), self.omega, *lag)
        info = Info(innovation=y, whitened=y, used=stage.used)
        return Fixed(state.belief._replace(mean=x), epoch.z - x @ H.T), stage, info


@pytest.mark.parametrize("omega", [False, True], ids=["", "Omega"])
def test_the_sensitivity_is_the_derivative_where_measurements_are_differenced(omega):
    """With a linear first stage: the bias acts on a measurement directly and through the lag."""
    z, unit = measured(runs=1), np.array([0.7, -1.3])
    filter = TwoStage.of(Lagged(omega), GAMMA, BIAS)
    state = moved = filter.start(prior(1))
    for k, epoch in enumerate(epochs(np.arange(float(T)), z)):
        state, _ = filter.step(state, epoch)
        moved, _ = filter.step(moved, epoch._replace(z=epoch.z + GAMMA @ unit))
        explained = -(state.Lambda @ unit)
        np.testing.assert_allclose(
            moved.first.belief.mean[0] - state.first.belief.mean[0], explained, atol=1e-12
        )
        assert np.abs(explained).max() > 0.01, k


def test_batches_are_singles():
    z = measured()
    many, one = staged("square root", z), staged("square root", z[:, 1:2])
    np.testing.assert_allclose(many.mean[:, 1], one.mean[:, 0], rtol=1e-12, atol=1e-12)


@FORMS
def test_a_boost_of_one_is_none_and_inflates_the_gain_only(form):
    z = measured()

    def constant(value):
        return lambda memory, seen: (memory, np.full((*seen.residual.shape[:-1], B), value))

    none, one, four = (
        staged(form, z, boost=boost) for boost in (None, constant(1.0), constant(4.0))
    )
    np.testing.assert_allclose(one.mean, none.mean, atol=1e-10)
    np.testing.assert_allclose(four.cov, none.cov, atol=1e-12)
    assert np.abs(four.mean[..., N:] - none.mean[..., N:]).max() > 0.1
    # The gain from an inflated covariance, written out.
    filter = two_stage(MOTION, SEEN, GAMMA, BIAS, form=form, boost=constant(4.0))
    state, _ = filter.step(filter.start(prior(len(z[0]))), epochs(np.arange(float(T)), z)[0])
    innovation, S = z[0], GAMMA - H @ np.zeros((N, B))
    total = S @ (4.0 * M0) @ S.T + H @ P0 @ H.T + R
    K = np.linalg.solve(total, S @ (4.0 * M0)).T
    np.testing.assert_allclose(state.bias.mean, B0 + (innovation - B0 @ S.T) @ K.T, atol=1e-12)


@pytest.mark.parametrize(
    "bias",
    [
        Gaussian(np.tile(B0, (3, 1)), M0),
        Gaussian(B0, np.tile(M0, (3, 1, 1))),
        Gaussian(np.tile(B0, (3, 1)), np.tile(M0, (3, 1, 1))),
    ],
    ids=["mean", "covariance", "both"],
)
def test_a_bias_of_each_run_goes_with_as_many_runs(bias):
    filter = two_stage(MOTION, SEEN, GAMMA, bias)
    found, expected = followed(filter, measured(3)), staged("square root", measured(3))
    np.testing.assert_allclose(found.mean, expected.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.cov, expected.cov, rtol=0, atol=1e-12)
    with pytest.raises(
        ValueError, match=r"^bias: expected one, or one for each run \(4,\), got \(3,\)$"
    ):
        filter.start(prior(4))


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: two_stage(MOTION, SEEN, [[np.nan]], BIAS), "Gamma"),
        (lambda: two_stage(MOTION, SEEN, GAMMA[:, :1], BIAS), "Gamma"),
        (lambda: staged("covariance", measured()[..., :2]), "z"),
        (lambda: two_stage(MOTION, SEEN, GAMMA, BIAS, Qb=-np.eye(B)), "Qb"),
        (lambda: two_stage(MOTION, SEEN, GAMMA, BIAS, Qb=np.eye(B + 1)), "Qb"),
        (lambda: two_stage(MOTION, SEEN, GAMMA, B0), "bias"),
        (lambda: TwoStage.of(MOTION, GAMMA, BIAS), "first"),
    ],
)
def test_bad_input_is_refused_by_name(make, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        make()
