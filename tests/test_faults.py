"""Bad input raises an error that names the argument before anything is computed; missing data are
skipped and counted.
"""

from __future__ import annotations

import numpy as np
import pytest

import celnav
from celnav.filters.colored import coloring
from celnav.filters.records import FromFunctions
from celnav.filters.run import explain
from celnav.models import orbit, sightings
from celnav.models.orbit import UnitWarning

EYE = np.eye(2)
PRIOR = celnav.Gaussian(np.zeros(2), EYE)
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])


def filtered(f=lambda x, epoch: x, h=EYE, Q=EYE, R=EYE, **options):
    return celnav.ukf(celnav.Motion(f, Q), celnav.Sensor(h, R), **options)


OF_THREE = celnav.sigma_point(celnav.Motion(lambda x, epoch: x, EYE), rule=celnav.unscented(3))


def run(z, prior=PRIOR, times=None, **model):
    return celnav.run(
        filtered(**model),
        prior,
        celnav.epochs(np.arange(float(len(z))) if times is None else times, z),
    )


@pytest.mark.parametrize("z", [None, np.full(2, np.nan)], ids=["none", "nan"])
def test_a_missing_measurement_leaves_the_prediction(z):
    state = filtered().start(PRIOR)
    state, _ = filtered().step(state, celnav.Epoch(0, 0.0, 0.0, None, z))
    np.testing.assert_array_equal(state.belief.mean, PRIOR.mean)
    np.testing.assert_array_equal(state.belief.sqrt_cov, PRIOR.sqrt_cov)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: run(np.full((3, 2), np.inf)), "z"),
        (lambda: run([["a", "b"]] * 3), "z"),
        (lambda: run(np.zeros((3, 3))), "z: expected 2 components to go with h, got 3"),
        (lambda: run(np.zeros((3, 2, 1))), "z: expected 2 components"),
        (lambda: run(np.zeros((3, 2)), h=np.eye(3), R=np.eye(3)), "h: expected a matrix"),
        (
            lambda: run(np.zeros((3, 2)), h=lambda x, epoch: x[..., :1]),
            r"h returned shape \(5, 1\), expected \(5, 2\)",
        ),
        (lambda: filtered(Q=[0.5, 0.5]), "Q: expected .* got shape"),
        (lambda: filtered(R=[0.5, 0.5]), "R: expected .* got shape"),
        (lambda: run(np.zeros((3, 2)), times=[0.0, 2.0, 1.0]), "times"),
        (lambda: run(np.zeros((3, 2)), times=[0.0, np.nan, 1.0]), "times"),
        (lambda: run(np.zeros((3, 2)), times=[0.0, 1.0]), "z"),
        (lambda: celnav.Gaussian(np.zeros(2), [[1.0, 0.1], [0.2, 1.0]]), "cov"),
        (lambda: celnav.Gaussian(np.zeros(2), np.diag([1.0, -1.0])), "cov"),
        (lambda: celnav.Gaussian(np.zeros(2), np.ones((2, 3))), "cov"),
        (lambda: celnav.Gaussian(np.zeros(2), np.full((2, 2), np.nan)), "cov"),
        (lambda: celnav.Gaussian([np.nan, 0.0], EYE), "mean"),
        (lambda: celnav.Gaussian(np.zeros((2, 1)), EYE), "mean"),
        (lambda: filtered(Q=-EYE), "Q"),
        (lambda: filtered(R=-EYE), "R"),
        (lambda: run(np.zeros((3, 2)), R=np.eye(3)), "R"),
        (lambda: run(np.zeros((3, 2)), Q=np.eye(3)), "Q"),
        (lambda: celnav.unscented(0), "n"),
        (lambda: celnav.unscented(-1), "n"),
        (lambda: celnav.unscented(2, alpha=0.0), "alpha"),
        (lambda: celnav.unscented(2, alpha=-1.0), "alpha"),
        (lambda: celnav.unscented(2, alpha=np.nan), "alpha"),
        (lambda: celnav.unscented(2, kappa=-2.0), "kappa"),
        (lambda: celnav.gauss_hermite(9, 7), "order.*40353607"),
        (lambda: celnav.gauss_hermite(2, 0), "order"),
        (lambda: celnav.cubature(3, 4), "degree"),
        (
            lambda: celnav.run(filtered(), PRIOR, celnav.epochs([0.0], [[0.0, 0.0]]), every=0),
            "every",
        ),
        (
            lambda: celnav.run(filtered(), PRIOR, celnav.epochs([0.0], [[0.0, 0.0]]), keep="all"),
            "keep",
        ),
        (
            lambda: celnav.run(
                filtered(), PRIOR, celnav.epochs([0.0], [[0.0, 0.0]]), on_failure="ignore"
            ),
            "on_failure",
        ),
        (lambda: celnav.run(filtered(), PRIOR, [celnav.Epoch(0, 0.0, -1.0)]), "dt"),
        (lambda: celnav.run(filtered(), PRIOR, [celnav.Epoch(0, 0.0, np.nan)]), "dt"),
        (lambda: coloring(1.01 * EYE), "Phi"),
        (lambda: coloring(np.ones((2, 3))), "Phi"),
        (lambda: celnav.Motion(lambda x, e: x), "Q"),
        (lambda: celnav.Sensor(EYE), "R"),
        (lambda: celnav.run(OF_THREE, PRIOR, [celnav.Epoch(1, 1.0, 1.0)]), "rule"),
        (lambda: orbit.check_orbit(np.zeros(6)), "state"),
        (lambda: sightings.star_directions(np.pi), "separation"),
        (lambda: sightings.position([1.0, 1.0, 4.0], 1.5), "A"),
        (lambda: sightings.position([0.1, 0.1, 2.0], np.pi / 2), "A"),
    ],
)
def test_bad_input_is_refused_by_name(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()


def test_a_wrong_length_of_f_is_told_with_both_shapes():
    with pytest.raises(ValueError, match=r"f returned shape \(5, 1\), expected \(5, 2\)"):
        run(np.zeros((3, 2)), f=lambda x, epoch: x[..., :1])


def test_an_exception_of_the_model_passes_with_the_step_as_a_note():
    def f(x, epoch):
        raise RuntimeError("no ephemeris")

    with pytest.raises(RuntimeError, match="no ephemeris") as caught:
        run(np.zeros((3, 2)), f=f)
    assert "step 1" in caught.value.__notes__[0]


def test_a_model_that_changes_its_argument_or_reuses_a_buffer_changes_nothing():
    buffer = np.empty((5, 2))

    def mutating(x, epoch):
        x *= 2.0
        return x

    def reusing(x, epoch):
        np.multiply(x, 2.0, out=buffer)
        return buffer

    z = np.ones((5, 2))
    clean = run(z, f=lambda x, epoch: 2.0 * x).mean
    np.testing.assert_array_equal(run(z, f=mutating).mean, clean)
    np.testing.assert_array_equal(run(z, f=reusing).mean, clean)


def test_a_list_from_h_is_accepted_and_callers_arrays_are_not_written_to():
    mean, cov, z = np.zeros(2), np.eye(2), np.ones((4, 2))
    kept = mean.copy(), cov.copy(), z.copy()
    run(z, celnav.Gaussian(mean, cov), h=lambda x, epoch: x.tolist())
    for a, b in zip((mean, cov, z), kept, strict=True):
        np.testing.assert_array_equal(a, b)


def test_covariances_that_are_asymmetric_by_round_off_are_symmetrized():
    P = np.array([[2.0, 0.5], [0.5 * (1.0 + 1e-15), 1.0]])
    cov = celnav.Gaussian(np.zeros(2), P).cov
    np.testing.assert_array_equal(cov, cov.T)


def test_an_infinite_measurement_in_a_stream_is_told_and_the_state_is_kept():
    filter = filtered()
    state, _ = filter.step(filter.start(PRIOR), celnav.Epoch(0, 0.0, 0.0, None, np.ones(2)))
    bad = celnav.Epoch(1, 1.0, 1.0, None, np.array([np.inf, 0.0]))
    with pytest.raises(celnav.FilterError, match=r"step 1.*z is infinite"):
        celnav.run(FromFunctions(lambda _: state, filter.step), PRIOR, [bad])
    good = celnav.Epoch(1, 1.0, 1.0, None, np.ones(2))
    again = filter.step(state, good)[0].belief
    fresh = celnav.run(filter, PRIOR, celnav.epochs([0.0, 1.0], np.ones((2, 2))))
    np.testing.assert_array_equal(again.mean, fresh.mean[-1])


def test_a_model_that_is_not_finite_at_a_point_is_named_with_step_and_point():
    def f(x, epoch):
        return np.where(x[..., :1] < -0.5, np.nan, x)  # one point is as far to that side

    with pytest.raises(
        celnav.FilterError, match=r"step 1, t = 1.0: f is not finite at sigma point 3"
    ):
        run(np.zeros((3, 2)), f=f)


@FORMS
def test_a_singular_innovation_is_told_not_divided_by(form):
    with pytest.raises(celnav.FilterError, match="innovation covariance is not positive definite"):
        run(
            np.ones((2, 2)),
            celnav.Gaussian(np.zeros(2), np.diag([1.0, 0.0])),
            R=np.zeros((2, 2)),
            form=form,
        )


@FORMS
def test_no_process_noise_works(form):
    track = run(np.ones((50, 2)), Q=np.zeros((2, 2)), form=form)
    np.testing.assert_allclose(track.std[-1], 1.0 / np.sqrt(51.0), rtol=1e-12)


@FORMS
def test_badly_conditioned_innovations_need_no_inverse(form):
    """cond(S) = 1e14: the same measurement in mixed components gives the same posterior."""
    R, T = np.diag([1e14, 1.0]), np.array([[1.0, 0.0], [1.0, 1.0]])
    track = run(np.array([[1.0, 1.0]]) @ T.T, h=T, R=T @ R @ T.T, form=form)
    np.testing.assert_allclose(track.mean[0], [1.0 / (1.0 + 1e14), 0.5], atol=2e-2 * 0.5)
    plain = run(np.array([[1.0, 1.0]]), R=R, form=form)
    np.testing.assert_allclose(plain.mean[0], [1.0 / (1.0 + 1e14), 0.5], rtol=1e-14)
    np.testing.assert_allclose(plain.std[0], [1.0, np.sqrt(0.5)], rtol=1e-12)


def test_a_covariance_stays_symmetric_over_many_steps():
    F = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.1], [-0.01, 0.0, 0.99]])
    filter = filtered(
        lambda x, epoch: x @ F.T, np.eye(1, 3), 1e-3 * np.eye(3), np.eye(1), form="covariance"
    )
    state, z = filter.start(celnav.Gaussian(np.zeros(3), np.eye(3))), np.zeros(1)
    for k in range(10_000):
        state, _ = filter.step(state, celnav.Epoch(k, float(k), 1.0, None, z))
    P = state.belief.cov
    assert np.linalg.norm(P - P.T) <= 1e-12 * np.linalg.norm(P)


def test_integers_and_single_precision_are_computed_in_double():
    prior = celnav.Gaussian(np.array([1, 2]), np.eye(2, dtype=np.float32))
    assert prior.mean.dtype == prior.cov.dtype == prior.sqrt_cov.dtype == np.float64
    z, third = np.array([[1.0, 2.0], [0.5, 1.5], [3.0, -1.0]]), np.eye(2) / 3.0
    exact = run(z, prior, Q=third, R=np.eye(2))
    assert exact.mean.dtype == exact.std.dtype == np.float64
    single = run(z.astype(np.float32), prior, Q=third, R=np.eye(2, dtype=np.float32))
    np.testing.assert_array_equal(single.mean, exact.mean)  # all of z is exact in single precision
    whole = run((2.0 * z).astype(int), prior, Q=third, R=np.eye(2, dtype=int))
    np.testing.assert_array_equal(whole.mean, run(2.0 * z, prior, Q=third, R=np.eye(2)).mean)


@FORMS
def test_singular_covariances_work(form):
    prior = celnav.Gaussian(np.zeros(2), np.diag([1.0, 0.0]))
    track = run(np.ones((6, 2)), prior, Q=np.diag([1.0, 0.0]), R=np.diag([1.0, 2.0]), form=form)
    assert np.isfinite(track.mean).all()
    np.testing.assert_allclose(track.std[:, 1], 0.0, atol=1e-12)


def test_no_measurement_noise_works_where_the_prior_has_spread():
    track = run(np.ones((3, 2)), R=np.zeros((2, 2)))
    np.testing.assert_allclose(track.mean, 1.0, atol=1e-12)


def test_a_zero_interval_does_not_predict():
    track = run(np.full((2, 2), np.nan), times=[1.0, 1.0])
    np.testing.assert_array_equal(track.std[1], track.std[0])


def test_the_mean_of_constants_survives_a_small_alpha():
    motion = celnav.Motion(lambda x, epoch: np.full_like(x, 7000.0), sqrt_Q=np.zeros((6, 0)))
    filter = celnav.ukf(motion, alpha=1e-3, beta=2.0)
    prior = celnav.Gaussian(np.full(6, 7000.0), np.eye(6))
    after = filter.predict(filter.start(prior), celnav.Epoch(1, 1.0, 1.0)).belief
    np.testing.assert_allclose(after.mean, 7000.0, atol=1e-9)


def test_an_indefinite_innovation_covariance_is_flagged_not_returned():
    sensor = celnav.Sensor(lambda x, epoch: np.cos(3.0 * x[..., :6]), 0.0025 * np.eye(6))
    filter = celnav.ckf(celnav.Motion(np.eye(13), np.zeros((13, 13))), sensor, degree=5)
    wide = celnav.Gaussian(
        np.zeros((3, 13)), np.eye(13) * np.array([0.2, 3.0, 0.2])[:, None, None] ** 2
    )
    before, epoch = filter.start(wide), celnav.Epoch(z=np.ones((3, 6)))
    after, _ = filter.update(before, epoch)
    assert explain(filter, before, after, epoch).startswith(
        "the innovation covariance is not positive definite"
    )
    np.testing.assert_array_equal(np.isfinite(after.belief.mean).all(-1), [True, False, True])


def test_a_partly_observed_state_tells_lower_from_upper_roots():
    A = np.array([[1.0, 0.5, 0.1], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    H, Q3, R1 = np.array([[1.0, 0.0, 0.0]]), np.diag([0.0, 0.0, 0.1]), np.array([[0.5]])
    x, P = np.zeros(3), np.diag([1.0, 4.0, 9.0])
    filter = filtered(lambda p, epoch: p @ A.T, H, Q3, R1)
    z = np.arange(10.0)[:, None]
    track = celnav.run(filter, celnav.Gaussian(x, P), celnav.epochs(np.arange(10.0), z), keep="cov")
    for k in range(10):
        if k:
            x, P = A @ x, A @ P @ A.T + Q3
        S = H @ P @ H.T + R1
        K = P @ H.T / S
        x, P = x + K @ (z[k] - H @ x), P - K @ S @ K.T
    np.testing.assert_allclose(track.mean[-1], x, atol=1e-10)
    np.testing.assert_allclose(track.cov[-1], P, atol=1e-10)


def test_units_that_look_wrong_are_warned_of():
    with pytest.warns(UnitWarning, match="positions are in km"):
        orbit.check_orbit([100.0, 0.0, 0.0, 0.0, 7.0, 0.0])
    with pytest.warns(UnitWarning, match="km and km/s"):
        orbit.check_orbit([7e6, 0.0, 0.0, 0.0, 7500.0, 0.0])
    with pytest.warns(UnitWarning, match="radians"):
        orbit.from_elements(7000.0, 0.0, 65.0, 0.0, 0.0, 0.0)


def test_a_star_behind_the_earth_is_skipped():
    seen = sightings.observe(
        np.array([-7000.0, 0.0, 0.0]), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    )
    assert np.isnan(seen[0])
    assert np.isfinite(seen[1:]).all()


def test_a_long_stream_runs_in_the_memory_of_one_step():
    import tracemalloc

    def stream(count):
        yield from (
            celnav.Epoch(k, float(k), 1.0, None, np.zeros((20, 2)), np.zeros((20, 2)))
            for k in range(count)
        )

    def squares(total, epoch, state, _infos):
        count, sums = total or (0, 0.0)
        return count + 1, sums + np.square(state.belief.mean - epoch.truth)

    prior = celnav.Gaussian(np.zeros((20, 2)), EYE)
    tracemalloc.start()
    track = celnav.run(filtered(), prior, stream(3000), keep="nothing", reduce=squares)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3_000_000
    assert track.reduced[0] == 3000
    assert track.mean is None
