"""Interacting multiple models against textbook loops, against a single model, and on simulated
switches.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import celnav
from celnav.analysis.metrics import chi_square_band
from celnav.filters.adaptive import gate
from celnav.filters.imm import mixed
from celnav.filters.records import FromFunctions
from celnav.filters.switching import Fallback
from celnav.gaussian.attitude import exp, multiply
from celnav.gaussian.belief import nees
from celnav.gaussian.linalg import SquareRoot
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0], [0.2, 1.0]])
NOISES = [np.diag([1e-4, 1e-4]), np.array([[0.3, 0.4], [0.4, 1.0]])]
R = np.array([[0.5, 0.1], [0.1, 0.8]])
PI = np.array([[0.95, 0.05], [0.15, 0.85]])
P0 = np.array([[2.0, 0.3], [0.3, 1.0]])
T, RUNS = 30, 100
TIMES = np.arange(float(T))
STATIONARY = np.array([0.75, 0.25])


def simulated(rng, runs):
    """States ``(T, runs, 2)``, models ``(T, runs)`` and measurements of a jump Markov system."""
    mode = (rng.random(runs) < STATIONARY[1]).astype(int)
    x = rng.multivariate_normal(np.zeros(2), P0, runs)
    roots, truth, modes = np.linalg.cholesky(np.array(NOISES)), [], []
    for k in range(T):
        if k:
            mode = (rng.random(runs) < PI[mode, 1]).astype(int)
            x = x @ F.T + (roots[mode] @ rng.standard_normal((runs, 2, 1)))[..., 0]
        truth.append(x)
        modes.append(mode)
    z = np.array(truth) @ H.T + rng.multivariate_normal(np.zeros(2), R, (T, runs))
    return np.array(truth), np.array(modes), z


TRUTH, MODES, Z = simulated(np.random.default_rng(5), RUNS)
GAPS = Z.copy()
GAPS[3:6] = np.nan
GAPS[8, ::2] = np.nan
GAPS[10, 1::3, 0] = np.nan
PRIOR = celnav.Gaussian(np.zeros((RUNS, 2)), P0)


def models(form="square root", by=celnav.ukf, **options):
    return [by(celnav.Motion(F, Q), celnav.Sensor(H, R), form=form, **options) for Q in NOISES]


def bank(form="square root", **options):
    return celnav.imm(models(form, **options), PI, initial=STATIONARY)


def probable(epoch, state, infos):
    return {"probabilities": state.probabilities}


def textbook(z, pi=PI, mu=STATIONARY):
    """Means, covariances, probabilities and log-likelihood of one run, from the
    textbook algorithm.
    """
    k = len(mu)
    x, P = [np.zeros(2)] * k, [P0] * k
    out, likelihood = [], 0.0
    for step, measured in enumerate(z):
        if step:
            ahead = mu @ pi
            mixed_x, mixed_P = [], []
            for j in range(k):
                w = pi[:, j] * mu / ahead[j]
                m = sum(w[i] * x[i] for i in range(k))
                mixed_x.append(F @ m)
                C = sum(w[i] * (P[i] + np.outer(x[i] - m, x[i] - m)) for i in range(k))
                mixed_P.append(F @ C @ F.T + NOISES[j])
            x, P, mu = mixed_x, mixed_P, ahead
        here = ~np.isnan(measured)
        if here.any():
            density = np.zeros(k)
            for j in range(k):
                A = H[here]
                S = A @ P[j] @ A.T + R[np.ix_(here, here)]
                K = P[j] @ A.T @ np.linalg.inv(S)
                density[j] = multivariate_normal(A @ x[j], S).pdf(measured[here])
                x[j], P[j] = x[j] + K @ (measured[here] - A @ x[j]), P[j] - K @ S @ K.T
            likelihood += np.log(mu @ density)
            mu = mu * density / (mu @ density)
        m = sum(mu[j] * x[j] for j in range(k))
        out.append((m, sum(mu[j] * (P[j] + np.outer(x[j] - m, x[j] - m)) for j in range(k)), mu))
    return [np.array(part) for part in zip(*out, strict=True)], likelihood


@FORMS
@pytest.mark.parametrize("z", [Z, GAPS], ids=["complete", "gaps"])
def test_is_the_textbook(form, z):
    track = celnav.run(bank(form), PRIOR, TIMES, z, keep="cov", also=probable)
    for i in range(6):
        (mean, cov, mu), likelihood = textbook(z[:, i])
        np.testing.assert_allclose(track.mean[:, i], mean, atol=1e-10)
        np.testing.assert_allclose(track.cov[:, i], cov, atol=1e-10)
        np.testing.assert_allclose(track.extra["probabilities"][:, i], mu, atol=1e-10)
        np.testing.assert_allclose(track.log_likelihood[i], likelihood, rtol=1e-11)


@FORMS
def test_one_model_and_models_alike_are_the_filter_itself(form):
    one = models(form)[1]
    alone = celnav.run(one, PRIOR, TIMES, GAPS, keep="cov")
    for filter in (celnav.imm([one], [[1.0]]), celnav.imm([one] * 3, np.full((3, 3), 1.0 / 3.0))):
        track = celnav.run(filter, PRIOR, TIMES, GAPS, keep="cov")
        for name in ("mean", "std", "cov", "innovation", "whitened", "used", "log_likelihood"):
            np.testing.assert_allclose(
                getattr(track, name), getattr(alone, name), rtol=1e-9, atol=1e-10
            )
        for name, count in alone.events.items():
            np.testing.assert_array_equal(track.events[name], count)


@FORMS
def test_runs_of_a_batch_are_those_alone(form):
    together = celnav.run(bank(form), PRIOR, TIMES, GAPS, keep="cov", also=probable)
    only_z = celnav.run(
        bank(form), celnav.Gaussian(np.zeros(2), P0), TIMES, GAPS, keep="cov", also=probable
    )
    for i in range(12):  # each pattern of gaps twice
        alone = celnav.run(
            bank(form),
            celnav.Gaussian(np.zeros(2), P0),
            TIMES,
            GAPS[:, i],
            keep="cov",
            also=probable,
        )
        for many in (together, only_z):
            for name in ("mean", "cov", "whitened", "used"):
                np.testing.assert_allclose(
                    getattr(many, name)[:, i], getattr(alone, name), atol=1e-11
                )
            np.testing.assert_allclose(
                many.extra["probabilities"][:, i], alone.extra["probabilities"], atol=1e-11
            )
            np.testing.assert_allclose(many.log_likelihood[i], alone.log_likelihood, rtol=1e-12)
            assert {name: count[i] for name, count in many.events.items()} == alone.events


def test_where_nothing_is_measured_probabilities_are_predicted():
    track = celnav.run(bank(), PRIOR, TIMES, GAPS, also=probable)
    mu = track.extra["probabilities"]
    np.testing.assert_allclose(mu[4], mu[3] @ PI, atol=1e-14)
    np.testing.assert_allclose(mu[8, ::2], mu[7, ::2] @ PI, atol=1e-14)
    assert (np.abs(mu[8, 1::2] - mu[7, 1::2] @ PI).max(-1) > 1e-6).all()


def test_is_consistent_where_models_switch():
    """And each model alone is not consistent. The probabilities agree with the frequencies of the
    models, and the NIS uses the mixture's moments.

    The posterior is not Gaussian: its NEES has a standard deviation of 3.5 to 4, not 2. Merging of
    histories makes the filter conservative by a twentieth; the band of a hundred runs does not see
    that.
    """
    low, high = chi_square_band(2, 100)
    truth, modes, z = simulated(np.random.default_rng(6), 1000)
    prior = celnav.Gaussian(np.zeros((1000, 2)), P0)
    track = celnav.run(bank(), prior, TIMES, z, keep="cov", also=probable)
    error, mu = nees((truth - track.mean)[10:], track.sqrt_cov[10:]), track.extra["probabilities"]
    assert ((low < error.mean(1)) & (error.mean(1) < high)).all()
    assert 0.9 < error.mean() / 2.0 < 1.05
    assert 0.95 < track.nis.mean() / 2.0 < 1.05
    given = np.take_along_axis(mu, modes[..., None], -1)
    np.testing.assert_allclose(given.mean(), np.square(mu).sum(-1).mean(), atol=0.01)
    for p in (0.2, 0.8):  # calibration: relative frequency at epochs with this probability
        assert abs(modes[np.abs(mu[..., 1] - p) < 0.05].mean() - p) < 0.05
    for alone in models():
        other = celnav.run(alone, prior, TIMES, z, keep="cov")
        assert abs(nees((truth - other.mean)[10:], other.sqrt_cov[10:]).mean() / 2.0 - 1.0) > 0.15
        assert other.log_likelihood.sum() < track.log_likelihood.sum()


def test_probabilities_do_not_underflow():
    """A model that was improbable for long becomes probable again, although the chain has no
    transition to it.
    """
    static = celnav.imm(
        [
            celnav.ukf(
                celnav.Motion(np.eye(1), 0.0 * np.eye(1)), celnav.Sensor(np.eye(1), r * np.eye(1))
            )
            for r in (1e-2, 1e2)
        ],
        np.eye(2),
    )
    z = np.r_[np.tile([30.0, -30.0], 40), np.zeros(120)][:, None]
    prior = celnav.Gaussian(np.zeros(1), 1e-6 * np.eye(1))
    track = celnav.run(
        static,
        prior,
        np.arange(len(z)),
        z,
        also=lambda epoch, state, infos: {"log": state.log_probabilities},
    )
    assert track.extra["log"][79, 0] < -1e6
    assert np.isfinite(track.extra["log"]).all()
    np.testing.assert_allclose(logsumexp(track.extra["log"], axis=-1), 0.0, atol=1e-12)
    one, two = (
        celnav.run(filter, prior, np.arange(len(z)), z).log_likelihood for filter in static.filters
    )
    np.testing.assert_allclose(
        track.log_likelihood, logsumexp([one, two]) - np.log(2.0), rtol=1e-12
    )


def test_a_model_that_nothing_leads_to():
    left = celnav.imm(models(), [[0.0, 1.0], [0.0, 1.0]], initial=[1.0, 0.0])
    track = celnav.run(left, PRIOR, TIMES, Z, also=probable)
    np.testing.assert_array_equal(
        track.extra["probabilities"][1:], np.broadcast_to([0.0, 1.0], (T - 1, RUNS, 2))
    )
    np.testing.assert_allclose(
        track.mean[-1], celnav.run(models()[1], PRIOR, TIMES, Z).mean[-1], atol=1e-6
    )


@FORMS
def test_lost_runs_are_nan_and_their_neighbors_go_on(form):
    def h(x, epoch):
        return np.where((epoch.k == 5) & (x[..., :1] > 2.0), np.nan, x)

    filters = [celnav.ukf(celnav.Motion(F, Q), celnav.Sensor(h, R), form=form) for Q in NOISES]
    z = np.zeros((T, 3, 2))
    z[:, 1] = 40.0
    filter, prior = celnav.imm(filters, PI), celnav.Gaussian(np.zeros((3, 2)), 0.01 * P0)
    track = celnav.run(filter, prior, TIMES, z, on_failure="flag", also=probable)
    np.testing.assert_array_equal(track.failed_at, [-1, 5, -1])
    assert np.isnan(track.mean[5:, 1]).all()
    assert np.isnan(track.extra["probabilities"][5:, 1]).all()
    pair = celnav.Gaussian(np.zeros((2, 2)), 0.01 * P0)
    neighbors = celnav.run(filter, pair, TIMES, z[:, ::2], also=probable)
    np.testing.assert_allclose(track.mean[:, ::2], neighbors.mean, rtol=0, atol=1e-13)
    np.testing.assert_allclose(track.log_likelihood[::2], neighbors.log_likelihood, rtol=1e-13)
    with pytest.raises(celnav.FilterError, match=r"step 5, .*run \(1,\): h is not finite"):
        celnav.run(filter, prior, TIMES, z)


def test_an_interval_of_no_length_switches_nothing():
    moving = [
        celnav.ukf(
            celnav.Motion(
                lambda x, e: x + 0.0 * e.dt,
                lambda mean, e, q=q: q * np.multiply.outer(e.dt, np.eye(2)),
            ),
            celnav.Sensor(H, R),
        )
        for q in (0.1, 1.0)
    ]
    filter, prior = celnav.imm(moving, PI), celnav.Gaussian(np.zeros((2, 2)), P0)
    z = np.random.default_rng(0).standard_normal((3, 2, 2))

    def ends(dts):
        ends = np.cumsum([np.max(dt) for dt in dts])
        epochs = [
            celnav.Epoch(k, t, dt, z=part)
            for k, (t, dt, part) in enumerate(zip(ends, dts, z, strict=True))
        ]
        return celnav.run(filter, prior, epochs, also=probable, keep="cov")

    both, none, one = (
        ends([0.0, np.array([0.0, 1.0]), 1.0]),
        ends([0.0, 0.0, 1.0]),
        ends([0.0, 1.0, 1.0]),
    )
    for run, alone in enumerate((none, one)):
        np.testing.assert_allclose(both.mean[:, run], alone.mean[:, run], atol=1e-12)
        np.testing.assert_allclose(both.cov[:, run], alone.cov[:, run], atol=1e-12)
        np.testing.assert_allclose(
            both.extra["probabilities"][:, run], alone.extra["probabilities"][:, run], atol=1e-12
        )


def test_two_sensors_are_one_and_a_prior_of_each_model():
    joined = celnav.run(
        bank(), [PRIOR, celnav.Gaussian(PRIOR.mean + 1.0, P0)], TIMES, Z, also=probable
    )
    parts = [
        celnav.Sensor(H[:1], [[0.5]]),
        celnav.Sensor(H[1:] - 0.2 * H[:1], [[R[1, 1] - 0.02]]),
    ]  # uncorrelated by a shear
    apart = celnav.imm(
        [celnav.ukf(celnav.Motion(F, Q), *parts) for Q in NOISES], PI, initial=STATIONARY
    )
    sheared = Z[..., :1], Z[..., 1:] - 0.2 * Z[..., :1]
    track = celnav.run(
        apart, [PRIOR, celnav.Gaussian(PRIOR.mean + 1.0, P0)], TIMES, sheared, also=probable
    )
    np.testing.assert_allclose(track.mean, joined.mean, atol=1e-9)
    np.testing.assert_allclose(
        track.extra["probabilities"], joined.extra["probabilities"], atol=1e-9
    )
    np.testing.assert_allclose(track.log_likelihood, joined.log_likelihood, rtol=1e-9)


def test_mixtures_on_angles_and_attitudes():
    angle = celnav.angles([0])
    both = mixed(
        angle,
        [SquareRoot(np.array([x]), 0.1 * np.eye(1)) for x in (3.0, -3.0)],
        np.array([0.5, 0.5]),
    )
    np.testing.assert_allclose(np.abs(both.mean), np.pi, atol=1e-12)
    np.testing.assert_allclose(both.cov, 0.01 + (np.pi - 3.0) ** 2, atol=1e-12)
    space, q = celnav.attitude(), np.array([0.5, 0.5, 0.5, 0.5])
    turned = [multiply(exp(np.array([0.0, 0.0, a])), q) for a in (-0.4, 0.4)]
    both = mixed(
        space,
        [SquareRoot(turned[0], 0.1 * np.eye(3)), SquareRoot(-turned[1], 0.1 * np.eye(3))],
        np.array([0.5, 0.5]),
    )
    np.testing.assert_allclose(space.minus(both.mean, q), 0.0, atol=1e-6)
    half = np.abs(space.minus(turned[1], q)[2])
    np.testing.assert_allclose(both.cov, np.diag([0.01, 0.01, 0.01 + half**2]), atol=1e-6)


@FORMS
@pytest.mark.parametrize("transported", [False, True])
def test_attitudes_that_are_turned_by_one_of_two_motions(form, transported):
    """Quaternions with either sign, some of them not measured: a batch equals its runs, and the
    true motion is identified.
    """
    still, turn = np.array([0.0, 0.0, 0.0]), np.array([0.02, 0.0, 0.05])
    space = celnav.attitude(transported=transported)
    motions = [
        celnav.Motion(lambda x, e, w=w: multiply(exp(w), x), 1e-6 * np.eye(3), space=space)
        for w in (still, turn)
    ]
    sensor, times = (
        celnav.Sensor(lambda x, e: x, 1e-4 * np.eye(3), space=celnav.attitude()),
        np.arange(12.0),
    )
    one = celnav.Gaussian([0.0, 0.0, 0.0, 1.0], 0.01 * np.eye(3))
    prior = celnav.Gaussian(np.tile(one.mean, (6, 1)), one.cov)
    z = (
        celnav.simulate(motions[1], sensor, one, times, runs=6)[1]
        * np.array([1.0, -1.0] * 3)[:, None]
    )
    z[5, ::2] = np.nan
    filter = celnav.imm(
        [celnav.ukf(motion, sensor, form=form) for motion in motions], [[0.9, 0.1], [0.1, 0.9]]
    )
    many = celnav.run(filter, prior, times, z, keep="cov", also=probable)
    assert (many.extra["probabilities"][-1, :, 1] > 0.9).all()
    for i in range(6):
        alone = celnav.run(filter, one, times, z[:, i], keep="cov")
        np.testing.assert_allclose(many.mean[:, i], alone.mean, atol=1e-10)
        np.testing.assert_allclose(many.cov[:, i], alone.cov, atol=1e-12)


def test_filters_of_any_kind():
    points = [Fallback(a, b) for a, b in zip(models(), models(by=celnav.ekf), strict=True)]
    colored = [
        celnav.colored(celnav.Motion(F, Q), celnav.Sensor(H, R), 0.0 * np.eye(2)) for Q in NOISES
    ]
    plain = celnav.run(bank(), PRIOR, TIMES, Z)
    for filters in (points, colored, models(hooks=[gate(50.0)])):
        track = celnav.run(celnav.imm(filters, PI, initial=STATIONARY), PRIOR, TIMES, Z)
        np.testing.assert_allclose(track.mean, plain.mean, atol=1e-8)
        np.testing.assert_allclose(track.log_likelihood, plain.log_likelihood, atol=1e-6)


@FORMS
def test_compiled(form):
    pytest.importorskip("llvmlite")

    def h(x, epoch=None):
        return np.stack([np.hypot(x[..., 0], 300.0), x[..., 1] + 0.1 * np.sin(x[..., 0])], -1)

    z = h(TRUTH[:, :20]) + Z[:, :20] - TRUTH[:, :20] @ H.T
    filter = celnav.imm(
        [celnav.ukf(celnav.Motion(F, Q), celnav.Sensor(h, R), form=form) for Q in NOISES], PI
    )
    for measured in (z, np.where(np.isnan(GAPS[:, :20]), np.nan, z)):
        prior = celnav.Gaussian(np.zeros((20, 2)), P0)
        there, here = (
            celnav.run(filter, prior, TIMES, measured, keep="cov", engine=engine)
            for engine in ("compiled", "numpy")
        )
        for name in ("mean", "std", "cov", "innovation", "whitened", "log_likelihood"):
            np.testing.assert_allclose(
                getattr(there, name), getattr(here, name), rtol=1e-7, atol=1e-8
            )
        np.testing.assert_array_equal(there.used, here.used)
        assert there.engine == "compiled"


def test_what_compiled_code_does_not_know():
    for prior, more in (([PRIOR, PRIOR], {}), (PRIOR, {"also": probable})):
        with pytest.raises(CannotCompile, match=r"^prior: expected one Gaussian|^also, reduce"):
            celnav.run(bank(), prior, TIMES, Z, engine="compiled", **more)
        track = celnav.run(bank(), prior, TIMES, Z, engine="auto", **more)
        assert track.engine.startswith("numpy: ")


def test_a_belief_may_be_the_prior():
    """A tuple, as a list of priors may be."""
    known, found = (
        celnav.run(bank(), prior, TIMES, Z)
        for prior in (PRIOR, SquareRoot(PRIOR.mean, PRIOR.sqrt_cov))
    )
    np.testing.assert_array_equal(found.mean, known.mean)


def test_smoothing_is_refused():
    with pytest.raises(ValueError, match="got InteractingModels, whose estimate is a mixture"):
        celnav.smooth(celnav.run(bank(), PRIOR, TIMES, Z, keep="cov"))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: celnav.imm([], PI), "filters: expected a length of at least 1, got 0"),
        (lambda: celnav.imm(models()[0], PI), "filters: expected a sequence"),
        (lambda: celnav.imm([1, 2], PI), "filters: expected filters, such as celnav.ukf"),
        (lambda: celnav.imm([FromFunctions(None, None)] * 2, PI), "filters: expected filters"),
        (lambda: celnav.imm(models(), PI.T), "transition: expected probabilities that sum to 1"),
        (lambda: celnav.imm(models(), np.eye(3)), r"transition: expected shape \(2, 2\)"),
        (
            lambda: celnav.imm(models(), [[1.5, -0.5], [0.0, 1.0]]),
            "transition: expected probabilities",
        ),
        (lambda: celnav.imm(models(), PI, initial=[0.5, 0.6]), "initial: expected probabilities"),
        (lambda: celnav.imm(models(), PI, initial=[1.0]), r"initial: expected shape \(2,\)"),
        (
            lambda: bank().start([PRIOR]),
            "prior: expected one Gaussian, or one for each of 2 models, got 1",
        ),
        (
            lambda: celnav.imm([models()[0], models("covariance")[1]], PI).start(PRIOR),
            "filters: expected filters with the same state",
        ),
    ],
)
def test_what_cannot_be_meant(make, told):
    with pytest.raises(ValueError, match=told):
        make()
