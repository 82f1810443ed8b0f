"""Invalid arguments raise an error at once, with the name, what was expected and what came."""

import pickle
import re
from copy import deepcopy
from inspect import signature

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints

import celnav
from celnav.filters.adaptive import gate
from celnav.filters.sequential import SingleDraw
from celnav.filters.switching import Fallback
from celnav.filters.two_stage import Plain, TwoStage
from celnav.gaussian.spaces import EUCLIDEAN, angles, product


def f(x, epoch):
    return x


EYE = np.eye(2)
MOTION, SENSOR = celnav.Motion(f, EYE), celnav.Sensor(EYE, EYE)
FILTER = celnav.ukf(MOTION, SENSOR)
PRIOR = celnav.Gaussian(np.zeros(2), EYE)
DATES = np.datetime64("2026-01-01") + np.arange(3) * np.timedelta64(1, "s")
QUATERNION = celnav.Gaussian([0.0, 0.0, 0.0, 1.0], np.eye(3))
TRANSPOSED = celnav.Motion(f, EYE, jacobian=lambda x, epoch: np.ones((2, 3)))


def predicted(motion, prior=PRIOR):
    filter = celnav.ekf(motion)
    return filter.predict(filter.start(prior), celnav.Epoch(1, 1.0, 1.0)).belief


def updated(z, prior=PRIOR, filter=FILTER):
    return filter.update(filter.start(prior), celnav.Epoch(z=z))[0].belief


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (
            celnav.Taylor,
            "rule: expected a rule, such as celnav.unscented(n) or celnav.unscented, got class "
            "Taylor",
        ),
        (6, "rule: expected a rule, such as celnav.unscented(n) or celnav.unscented, got int"),
        (
            MerweScaledSigmaPoints(2, 1.0, 0.0, 1.0),
            "MerweScaledSigmaPoints (celnav.from_filterpy makes it one)",
        ),
    ],
    ids=["a class", "a number", "filterpy's"],
)
def test_a_rule_that_is_none(given, told):
    made = [
        lambda: celnav.sigma_point(MOTION, rule=given),
        lambda: celnav.sigma_point(MOTION, celnav.Sensor(f, EYE), rule=given),
        lambda: celnav.sigma_point(MOTION, SENSOR, rule=given),
        lambda: celnav.colored(MOTION, SENSOR, 0.5 * EYE, rule=given),
        lambda: celnav.decorrelated(MOTION, SENSOR, 0.5 * EYE, rule=given),
        lambda: celnav.augmented(MOTION, SENSOR, 0.5 * EYE, rule=given),
        lambda: celnav.two_stage(MOTION, SENSOR, EYE, PRIOR, rule=given),
    ]
    for make in made:
        with pytest.raises(ValueError, match="rule") as error:
            make()
        assert told in str(error.value)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (
            lambda: celnav.Motion([EYE[0]], EYE),
            "f: expected a function (points, epoch) or a matrix (..., n, n), got shape (1, 2)",
        ),
        (
            lambda: celnav.Sensor([1.0, 0.0], EYE),
            "h: expected a function (points, epoch) or a matrix (..., m, n), got shape (2,)",
        ),
        (
            lambda: celnav.Motion(EYE, EYE, space=angles()),
            "f: expected a function where states are not vectors, got a matrix",
        ),
        (
            lambda: celnav.Motion(f, EYE, space=[0]),
            "space: expected a Space, such as celnav.angles([0]), got list",
        ),
        (lambda: celnav.Sensor(f, [[1.0]], space=celnav.angles), "space: expected a Space"),
        (
            lambda: celnav.Motion(f, EYE, jacobian=EYE),
            "jacobian: expected a function (mean, epoch), got ndarray; a linear f is",
        ),
        (
            lambda: celnav.Motion(f, EYE, jacobian=(EYE,)),
            "jacobian: expected a function (mean, epoch), got tuple; a linear f is",
        ),
        (
            lambda: celnav.Sensor(f, EYE, jacobian=3),
            "jacobian: expected a function (mean, epoch), got int; a linear h is",
        ),
        (lambda: celnav.Motion(f, EYE, sqrt_Q=EYE), "Q: expected one of Q and sqrt_Q, got both"),
        (
            lambda: celnav.Sensor(f),
            "R: expected the noise's covariance, R or sqrt_R; without noise it is np.zeros((k, k))",
        ),
        (
            lambda: celnav.Motion(f),
            "Q: expected the noise's covariance, Q or sqrt_Q; without noise it is np.zeros((k, k))",
        ),
        (
            lambda: celnav.Sensor(EYE, [0.1, 0.2]),
            "got shape (2,); pass np.diag(...) of variances",
        ),
        (lambda: celnav.ukf(MOTION, SENSOR, hooks=gate(4.0)), "hooks: expected a list of hooks"),
        (
            lambda: celnav.ukf(MOTION, SENSOR, hooks=[gate]),
            "expected functions (memory, joint, epoch), got function gate",
        ),
        (
            lambda: celnav.ukf(MOTION, SENSOR, hooks=[[gate(4.0)]] * 2),
            "hooks: expected hooks, or 1 lists of them, one for each",
        ),
        (
            lambda: celnav.ukf(MOTION, SENSOR, form="root"),
            "form: expected one of square root, covariance, got 'root'",
        ),
        (
            lambda: celnav.ukf(MOTION, SENSOR, SENSOR, gain=EYE),
            "gain: expected one sensor with a prescribed gain, got 2",
        ),
        (
            lambda: celnav.ekf(MOTION, SENSOR, iterations=0),
            "iterations: expected an integer from 1 to 10000, got 0",
        ),
        (lambda: celnav.ukf(SENSOR, MOTION), "motion: expected celnav.Motion(f, Q), got Sensor"),
        (
            lambda: celnav.ukf(FILTER, SENSOR),
            "motion: expected celnav.Motion(f, Q), got Sequential",
        ),
        (lambda: celnav.ukf(MOTION, MOTION), "sensors: expected celnav.Sensor(h, R), got Motion"),
        (lambda: celnav.ukf(MOTION, [SENSOR]), "sensors: expected celnav.Sensor(h, R), got list"),
        (
            lambda: celnav.decorrelated(MOTION, celnav.Sensor(f, EYE), 0.5 * EYE),
            "sensor: expected a measurement matrix (m, n)",
        ),
        (
            lambda: celnav.augmented(MOTION, celnav.Sensor(EYE, f), 0.5),
            "R: expected a constant covariance (m, m) of the noise",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, np.zeros((3, 2))),
            "times: expected shape (T,) with T > 0, got (3, 2)",
        ),
        (
            lambda: list(celnav.steps(FILTER, PRIOR, np.zeros(3))),
            "epochs: expected celnav.epochs(times, z), or records like",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, celnav.epochs([0.0]), [[0.0, 0.0]]),
            "z: expected none beside epochs, which already have",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, [celnav.Epoch(k, float(k)) for k in (0, 1)]),
            "dt: expected the interval since t = 0",
        ),
        (
            lambda: celnav.run(PRIOR, FILTER, [0.0]),
            "filter: expected a filter, such as celnav.ukf(motion, sensor), got Gaussian",
        ),
        (
            lambda: celnav.run(FILTER, np.zeros(2), [0.0]),
            "prior: expected a Gaussian, such as celnav.Gaussian(mean, cov), got",
        ),
        (
            lambda: FILTER.step(PRIOR, celnav.Epoch()),
            "state: expected what the filter's start(prior) or last step gave",
        ),
        (
            lambda: celnav.epochs([0.0] * 3, DATES[:, None]),
            "z: expected numbers, got dates or durations; seconds are",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, [0.0], engine=""),
            "engine: expected one of numpy, compiled, cuda, auto, got ''",
        ),
        (
            lambda: celnav.run(FILTER, PRIOR, [0.0], engine={}),
            "engine: expected one of numpy, compiled, cuda, auto, got {}",
        ),
        (
            lambda: celnav.iterated_smoother(FILTER, PRIOR, [0.0], engine=""),
            "engine: expected one of numpy, compiled",
        ),
        (
            lambda: celnav.epochs([0.0, 1.0], [[1.0, 2.0], [3.0]]),
            "z: expected numbers, got [[1.0, 2.0], [3.0]]",
        ),
        (
            lambda: celnav.epochs([0.0, 1.0], [[1.0, 2.0], None]),
            "got [[1.0, 2.0], None]; use nan for missing entries",
        ),
        (lambda: celnav.epochs([0.0, 1.0], [1.0, 2.0]), "got (2,); one component is z[:, None]"),
        (
            lambda: celnav.Gaussian(np.ma.masked_values([1.0, -9.0], -9.0), EYE),
            "mean: expected finite numbers, got 1 that",
        ),
        (
            lambda: celnav.Gaussian([0.0, 0.0], [[1.0, 2.0], [3.0]]),
            "cov: expected numbers, got [[1.0, 2.0], [3.0]]",
        ),
        (
            lambda: predicted(MOTION, QUATERNION),
            "space: expected a space for 4 components, 3 differences, got vectors",
        ),
        (
            lambda: updated([0.0, 0.0], QUATERNION),
            "space: expected a space for 4 components, 3 differences, got vectors",
        ),
        (lambda: predicted(TRANSPOSED), "jacobian: expected shape (..., 2,"),
        (lambda: predicted(celnav.Motion(np.eye(3), np.eye(3))), "f: expected a matrix"),
        (
            lambda: updated([0.0, 0.0], filter=celnav.ukf(MOTION, SENSOR, gain=np.eye(3))),
            "gain: expected shape (..., 2, 2)",
        ),
        (lambda: updated([1j, 0.0]), "z: expected numbers, got"),
        (
            lambda: updated(3.0),
            "z: expected shape (..., m), got the number 3.0; one component is [z]",
        ),
        (
            lambda: updated((np.zeros(2), np.zeros(2))),
            "z: expected 1 measurements, one a sensor, got 2",
        ),
        (lambda: updated([1.0]), "z: expected 2 components"),
        (lambda: updated(np.zeros((2, 1))), "z: expected 2 components"),
        (
            lambda: TwoStage.of(FILTER, EYE, PRIOR),
            "first: expected a first stage, such as celnav.filters.two_stage.Plain",
        ),
        (
            lambda: TwoStage.of(Plain(FILTER), np.eye(3), PRIOR),
            "Gamma: expected shape (..., m, 2) to go with the bias, got (3, 3)",
        ),
        (
            lambda: celnav.two_stage(MOTION, SENSOR, EYE, EYE),
            "bias: expected celnav.Gaussian(mean, cov), got",
        ),
        (
            lambda: celnav.two_stage(MOTION, SENSOR, EYE, PRIOR, Qb=np.eye(3)),
            "Qb: expected symmetric positive semidefinite (2, 2)",
        ),
        (
            lambda: SingleDraw.of(FILTER),
            "filter: expected one sensor, and process noise through the points (augment) only",
        ),
        (
            lambda: Fallback(FILTER, MOTION),
            "second: expected celnav.ukf(motion, sensor), got Motion",
        ),
        (
            lambda: celnav.export_c(FILTER, "filter.c", None),
            "prior: expected a Gaussian, such as celnav.Gaussian(mean, cov)",
        ),
        (
            lambda: celnav.export_c(FILTER, "filter.c", EYE),
            "prior: expected a Gaussian, such as celnav.Gaussian(mean, cov)",
        ),
        (
            lambda: celnav.ukf(MOTION, SENSOR, alpha=1e-7),
            "alpha, kappa, wm: expected weights that leave three digits of a mean",
        ),
        (lambda: celnav.smooth(None), "track: expected what celnav.run gave, got NoneType"),
        (lambda: celnav.from_filterpy(3), "points: expected a filterpy sigma-point object"),
        (lambda: celnav.angles(3), "components: expected a sequence, such as [0], got 3"),
        (lambda: celnav.angles([0.5]), "components: expected integers of at least 0, got [0.5]"),
        (
            lambda: celnav.angles([5]).minus(np.zeros(2), np.zeros(2)),
            "angles: expected components below 2",
        ),
        (
            lambda: product(angles(), EUCLIDEAN),
            "factors: expected triples (space, N, n) with the lengths of points and of tangents",
        ),
        (
            lambda: product((EUCLIDEAN, 2, 2)).plus(np.zeros(3), np.zeros(3)),
            "point: expected 2 components for the product space",
        ),
    ],
)
def test_other_arguments(make, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        make()


def test_batches_that_do_not_go_together():
    prior = celnav.Gaussian(np.zeros((5, 2)), EYE)
    with pytest.raises(ValueError, match=r"^z: .*\(5,\).*\(3,\)"):
        celnav.run(FILTER, prior, [0.0, 1.0], np.zeros((2, 3, 2)))
    # one measurement for all runs, and one run's belief for all measurements, do
    assert celnav.run(FILTER, prior, [0.0], np.zeros((1, 2))).mean.shape == (1, 5, 2)
    assert celnav.run(FILTER, PRIOR, [0.0], np.zeros((1, 3, 2))).mean.shape == (1, 3, 2)


@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_no_noise_has_no_columns(form):
    """A measurement without noise is possible, and exact; it must be stated."""
    for none in ({"sqrt_R": np.zeros((1, 0))}, {"R": np.zeros((1, 1))}):
        belief = updated(
            [3.0], filter=celnav.ukf(MOTION, celnav.Sensor([[1.0, 1.0]], **none), form=form)
        )
        np.testing.assert_allclose(belief.mean, [1.5, 1.5], rtol=1e-12)
        np.testing.assert_allclose(belief.cov, [[0.5, -0.5], [-0.5, 0.5]], atol=1e-12)


def _moved(x, dt):
    return x + dt * x


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@pytest.mark.parametrize("name", ["f", "h"])
def test_a_model_of_the_interval_raises_one_clear_message(name, engine):
    """As filterpy's ``fx(x, dt)``; the epoch is not a number."""
    motion = celnav.Motion(_moved if name == "f" else EYE, EYE)
    sensor = celnav.Sensor(_moved if name == "h" else EYE, EYE)
    message = (
        f"{name}: expected a function (points, epoch), got function _moved of points and their "
        f"interval; pass lambda x, epoch: {name}(x, epoch.dt)"
    )
    with pytest.raises(ValueError, match=re.escape(message)):
        celnav.run(celnav.ukf(motion, sensor), PRIOR, [0.0, 1.0], np.zeros((2, 2)), engine=engine)


def test_the_cure_for_a_model_of_the_interval_works():
    motion = celnav.Motion(lambda x, epoch: _moved(x, epoch.dt), EYE)
    track = celnav.run(celnav.ukf(motion, SENSOR), PRIOR, [0.0, 1.0], np.zeros((2, 2)))
    assert np.isfinite(track.mean).all()


def test_a_model_that_fails_for_another_reason_raises_its_own_error():
    """Its note says what it was called with."""
    motion = celnav.Motion(lambda x, epoch: x + epoch.truth["rate"], EYE)
    with pytest.raises((TypeError, ValueError)) as error:
        celnav.run(celnav.ukf(motion, SENSOR), PRIOR, [0.0, 1.0], np.zeros((2, 2)))
    assert "expected a function" not in str(error.value)
    assert (
        "f is called with points (5, 2) and an Epoch: epoch.dt is its interval, epoch.u (None) its "
        "input"
    ) in error.value.__notes__


@pytest.mark.parametrize(
    "model",
    [
        lambda x, e: np.array([x[0] + x[1], x[1]]),
        lambda x, e: [x[0], x[9]],
        lambda x, e: np.eye(3) @ x,
        lambda x, e: x[:, 0],
        lambda x, e: x[..., 0],
    ],
    ids=["rows", "beyond", "matrix", "column", "one component"],
)
@pytest.mark.parametrize("runs", [(), (4,)])
def test_a_model_of_one_vector_is_told_what_points_are(model, runs):
    """Whether its value has another shape or the model itself raises an error."""
    prior, jacobian = (
        celnav.Gaussian(np.zeros((*runs, 3)), np.eye(3)),
        lambda mean, epoch: np.eye(3),
    )
    motion, linear = (celnav.Motion(model, np.eye(3), jacobian=known) for known in (None, jacobian))
    for filter in (celnav.ukf(motion), celnav.ekf(linear)):
        with pytest.raises((ValueError, IndexError)) as error:
            celnav.run(filter, prior, [0.0, 1.0])
        said = "\n".join([str(error.value), *getattr(error.value, "__notes__", [])])
        assert (
            "points are (p, ..., n): a component is x[..., 0], np.stack([...], axis=-1) joins "
            "components, a product with a matrix is x @ F.T"
        ) in said


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@pytest.mark.parametrize("runs", [(), (4,)])
@pytest.mark.parametrize("rule", [celnav.ukf, celnav.ckf], ids=["5 points", "4 points"])
def test_components_joined_along_the_first_axis_are_told_the_last(rule, runs, engine):
    """``np.array`` of components has their axis first; the named cure works. Four components at
    four points have the right shape, but mix points.
    """
    parts = lambda x: [x[..., 0], x[..., 1], x[..., 0] + x[..., 1], x[..., 0]]  # noqa: E731
    first, last = (
        celnav.Sensor(h, np.eye(4))
        for h in (lambda x, e: np.array(parts(x)), lambda x, e: np.stack(parts(x), axis=-1))
    )
    prior, z = celnav.Gaussian(np.zeros((*runs, 2)), EYE), np.zeros((2, *runs, 4))
    with pytest.raises(ValueError, match=r"^h.*np\.stack\(\[\.\.\.\], axis=-1\) joins components"):
        celnav.run(rule(MOTION, first), prior, [0.0, 1.0], z, engine=engine)
    celnav.run(rule(MOTION, last), prior, [0.0, 1.0], z, engine=engine)


def test_what_tracks_rules_filters_and_spaces_say_of_themselves():
    track = celnav.run(
        FILTER, celnav.Gaussian(np.zeros((4, 2)), EYE), [0.0, 1.0, 2.0], np.zeros((3, 4, 2))
    )
    assert repr(track) == "Track(3 epochs from 0 to 2 s, 4 runs; mean, std, innovation stored)"
    assert (
        repr(celnav.unscented(2))
        == "Rule(n=2, points=4 and a center of weight 0, negative weights=0)"
    )
    assert repr(celnav.unscented(2, 0.5)) == "Rule(n=2, points=5, negative weights=1)"
    assert (
        repr(celnav.colored(MOTION, SENSOR, 0.5 * EYE))
        == "Colored(function f; ndarray; unscented, square root)"
    )
    assert (
        repr(celnav.imm([FILTER, FILTER], np.full((2, 2), 0.5)))
        == f"InteractingModels(filters=({FILTER!r}, {FILTER!r}))"
    )
    assert "space: 'Space' = EUCLIDEAN" in str(signature(celnav.Motion))


def test_angles_can_be_sent_to_another_process():
    for places in (None, [1]):
        space = pickle.loads(pickle.dumps(celnav.angles(places)))
        np.testing.assert_allclose(
            space.minus(np.array([0.0, 3.0]), np.array([0.0, -3.0])),
            [0.0, 6.0 - 2.0 * np.pi],
            rtol=1e-12,
        )


def test_what_is_masked_is_missing():
    """Readers of netCDF and FITS return masked arrays."""
    z = np.ma.masked_values([[1.0, 1.0], [-999.0, 2.0], [3.0, 3.0]], -999.0)
    found, expected, listed = (
        celnav.run(FILTER, PRIOR, np.arange(3.0), v) for v in (z, z.filled(np.nan), list(z))
    )
    np.testing.assert_array_equal(found.mean, expected.mean)
    np.testing.assert_array_equal(found.dof, [2, 1, 2])
    np.testing.assert_array_equal(listed.mean, expected.mean)
    np.testing.assert_array_equal(updated(z[1]).mean, updated([np.nan, 2.0]).mean)


def noise(mean, epoch):
    return 0.1 * EYE


def move(x, epoch):
    return x + 0.0


def test_filters_can_be_sent_to_another_process():
    """If their functions can be pickled; an unpickled space is the same space."""
    for space in (EUCLIDEAN, angles([1])):
        filter = celnav.ukf(celnav.Motion(move, sqrt_Q=noise, space=space), SENSOR)
        celnav.run(filter, PRIOR, [0.0], np.ones((1, 2)))
        for other in (pickle.loads(pickle.dumps(filter)), deepcopy(filter)):
            belief = other.predict(other.start(PRIOR), celnav.Epoch(1, 1.0, 1.0)).belief
            np.testing.assert_allclose(belief.cov, 1.01 * EYE)


@pytest.mark.parametrize(
    "rule", [celnav.Taylor(), celnav.unscented(2, 1e-3, 2.0)], ids=["taylor", "alpha"]
)
def test_a_model_in_single_precision_is_told_where_differences_are_round_off(rule):
    """A standard deviation of 0.01 once became 1e-5 without a warning."""
    far = celnav.Gaussian([7000.0, 7000.0], 1e-4 * EYE)
    single = celnav.sigma_point(
        celnav.Motion(lambda x, epoch: x.astype(np.float32), 1e-10 * EYE), rule=rule
    )
    with pytest.warns(
        RuntimeWarning, match="f returns float32: its values differ .* Compute in float64"
    ):
        single.predict(single.start(far), celnav.Epoch(1, 1.0, 1.0))
    see = celnav.sigma_point(
        MOTION, celnav.Sensor(lambda x, epoch: x[..., :1].astype(np.float32), [[1.0]]), rule=rule
    )
    with pytest.warns(RuntimeWarning, match="h returns float32"):
        updated([7000.0], far, see)


def test_single_precision_that_does_no_harm_is_taken_in_silence():
    """Differences far above round-off, an exact component, user-supplied Jacobians."""
    motion = celnav.Motion(
        lambda x, epoch: x.astype(np.float32), np.zeros((2, 2)), jacobian=lambda x, epoch: EYE
    )
    for filter in (celnav.ukf(motion), celnav.ekf(motion)):
        after = filter.predict(
            filter.start(celnav.Gaussian([7000.0, 0.1], np.diag([1e4, 0.0]))),
            celnav.Epoch(1, 1.0, 1.0),
        ).belief
        np.testing.assert_allclose(after.std, [100.0, 0.0], rtol=1e-5)


def test_masked_values_of_a_model_are_refused():
    """Masked values are unknown; masked arrays without a mask are ordinary arrays."""

    def hidden(x, epoch=None):
        return np.ma.masked_greater(x, 1.0005)

    def of_two(mean, epoch):
        return hidden(2.0 * EYE)

    prior = celnav.Gaussian(np.ones(2), EYE)
    for name, motion, sensor in (
        ("f", celnav.Motion(hidden, EYE), SENSOR),
        ("h", MOTION, celnav.Sensor(hidden, EYE)),
        ("Q", celnav.Motion(f, of_two), SENSOR),
        ("R", MOTION, celnav.Sensor(EYE, of_two)),
        ("sqrt_R", MOTION, celnav.Sensor(EYE, sqrt_R=of_two)),
        ("jacobian", celnav.Motion(f, EYE, jacobian=of_two), SENSOR),
        ("matrix", celnav.Motion(celnav.Linear(lambda epoch: of_two(None, epoch)), EYE), SENSOR),
    ):
        with pytest.raises(
            ValueError,
            match=f"^{name}: expected numbers, got masked ones; if a component .* nan in z instead",
        ):
            celnav.run(celnav.ekf(motion, sensor), prior, [0.0, 1.0], np.ones((2, 2)))
    bare = celnav.ukf(celnav.Motion(lambda x, e: np.ma.masked_array(x), EYE))
    np.testing.assert_allclose(
        celnav.run(bare, prior, [0.0, 1.0], keep="cov").cov[-1], 2.0 * EYE, atol=1e-14
    )
