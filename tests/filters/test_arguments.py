"""What cannot be is refused where it is given, by name, with what was expected and what came."""

import pickle
import re
from copy import deepcopy

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints

import celnav
from celnav.filters.adaptive import gate
from celnav.filters.colored import augmented, colored
from celnav.filters.decorrelated import decorrelated
from celnav.filters.single_draw import single_draw
from celnav.filters.two_stage import plain, two_stage
from celnav.gaussian.belief import covariance, square_root
from celnav.gaussian.spaces import EUCLIDEAN, angles, product

RULE = celnav.unscented(2)
MOTION = celnav.predict(lambda x, e: x, RULE, np.eye(2))
SEE = celnav.update(np.eye(2), RULE, np.eye(2))
FILTER = celnav.sequential(MOTION, SEE)
PRIOR = square_root(np.zeros(2), np.eye(2))


HEADING = celnav.update(np.eye(2), RULE, np.eye(2), space=angles([1]))
DATES = np.datetime64("2026-01-01") + np.arange(3) * np.timedelta64(1, "s")
QUATERNION = celnav.Gaussian(np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3), PRIOR.form)
EYE3 = np.eye(3)
TRANSPOSED = celnav.Taylor(lambda x, e: (np.ones((2, 3)),))
NO_TUPLE = celnav.Taylor(lambda x, e: np.eye(2))


def f(x, epoch):
    return x


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (celnav.unscented, "rule: expected a rule, such as celnav.unscented(n), got function unscented"),
        (celnav.Taylor, "rule: expected a rule, such as celnav.unscented(n), got class Taylor"),
        (6, "rule: expected a rule, such as celnav.unscented(n), got int"),
        (MerweScaledSigmaPoints(2, 1.0, 0.0, 1.0), "MerweScaledSigmaPoints (celnav.from_filterpy makes it one)"),
    ],
    ids=["not called", "a class", "a number", "filterpy's"],
)
def test_a_rule_that_is_none(given, told):
    made = [
        lambda: celnav.predict(f, given, np.eye(2)),
        lambda: celnav.update(f, given, np.eye(2)),
        lambda: celnav.update(np.eye(2), given, np.eye(2)),
        lambda: colored(f, np.eye(2), given, 0.5 * np.eye(2), Q=np.eye(2), R=np.eye(2)),
        lambda: decorrelated(f, np.eye(2), given, 0.5 * np.eye(2), Q=np.eye(2), R=np.eye(2)),
        lambda: augmented(f, np.eye(2), given, 0.5 * np.eye(2), Q=np.eye(2), R=np.eye(2), Sigma0=np.eye(2)),
        lambda: single_draw(f, f, given, extra=(np.eye(2),)),
    ]
    for make in made:
        with pytest.raises(ValueError, match="rule") as error:
            make()
        assert told in str(error.value)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: celnav.predict(np.eye(2), RULE), "f: expected a function (points, epoch), got ndarray"),
        (lambda: celnav.predict(f, RULE, space=[0]), "space: expected a Space, such as celnav.angles([0]), got list"),
        (lambda: celnav.update(f, RULE, [[1.0]], measurement_space=celnav.angles), "measurement_space: expected a Space"),
        (lambda: celnav.update(f, RULE, np.eye(2), hooks=gate(4.0)), "hooks: expected a list of hooks"),
        (lambda: celnav.update(f, RULE, np.eye(2), hooks=[gate]), "expected functions (memory, joint, epoch), got function gate"),
        (lambda: celnav.update(f, RULE), "R: expected measurement noise, R, sqrt_R or extra"),
        (lambda: celnav.predict(f, RULE), "Q: expected process noise, Q, sqrt_Q or extra; if there is none"),
        (lambda: celnav.sequential(MOTION, HEADING), "space: expected the same in predict and update, got vectors"),
        (lambda: celnav.run(FILTER, PRIOR, np.zeros((3, 2))), "epochs: expected celnav.epochs(times, z), or records like"),
        (lambda: celnav.run(FILTER, PRIOR, [celnav.Epoch(k, float(k)) for k in (0, 1)]), "dt: expected the interval since t = 0"),
        (lambda: celnav.epochs(DATES, np.zeros((3, 1))), "times: expected numbers, got dates or durations; seconds are"),
        (lambda: celnav.epochs(DATES - DATES[0], np.zeros((3, 1))), "times: expected numbers, got dates or durations"),
        (lambda: square_root(np.ma.masked_values([1.0, -9.0], -9.0), np.eye(2)), "mean: expected finite numbers, got 1 that"),
        (lambda: SEE(PRIOR, [1j, 0.0]), "z: expected numbers, got"),
        (lambda: celnav.angles(3), "components: expected a sequence, such as [0], got 3"),
        (lambda: product(angles(), EUCLIDEAN), "factors: expected triples (space, length of its points, length of its tangents)"),
        (lambda: product((EUCLIDEAN, 2, 2)).plus(np.zeros(3), np.zeros(3)), "point: expected 2 components of a product of spaces"),
        (lambda: MOTION(QUATERNION), "space: expected one for states of 4 components with 3 deviations, got vectors"),
        (lambda: SEE(QUATERNION, [0.0, 0.0]), "space: expected one for states of 4 components with 3 deviations, got vectors"),
        (lambda: celnav.update(np.eye(2), RULE, np.eye(2), gain=np.eye(3))(PRIOR, [0.0, 0.0]), "gain: expected shape (..., 2, 2)"),
        (lambda: celnav.predict(f, TRANSPOSED, np.eye(2))(PRIOR), "jacobians: expected shape (..., 2, 2), got (2, 3)"),
        (lambda: celnav.predict(f, NO_TUPLE, np.eye(2))(PRIOR), "jacobians: expected a tuple, one matrix for each"),
        (lambda: two_stage(FILTER, np.eye(2), PRIOR), "first: expected a first stage, such as plain(predict, update), got Filter"),
        (lambda: two_stage(plain(MOTION, SEE), np.eye(2), np.eye(2)), "bias: expected a Gaussian, such as"),
        (lambda: two_stage(plain(MOTION, SEE), np.eye(3), PRIOR), "Gamma: expected shape (..., m, 2) to go with the bias"),
        (lambda: plain(SEE, MOTION), "predict: expected a part (belief, epoch), got Conditioning"),
        (lambda: plain(MOTION, MOTION), "update: expected a part (belief, z, epoch, memory), got Motion"),
        (lambda: colored(f, [1.0, 0.0], RULE, [[0.5]], Q=np.eye(2), R=[[1.0]]), "h: expected a matrix (m, n), got shape (2,)"),
        (lambda: square_root([0.0, 0.0], [[1.0, 2.0], [3.0]]), "cov: expected numbers, got [[1.0, 2.0], [3.0]]"),
        (lambda: celnav.epochs([0.0, 1.0], [[1.0, 2.0], [3.0]]), "z: expected numbers, got [[1.0, 2.0], [3.0]]"),
        (lambda: celnav.epochs([0.0, 1.0], [[1.0, 2.0], None]), "got [[1.0, 2.0], None]; use nan for what is missing"),
        (lambda: augmented(f, f, RULE, 1.0, Q=1.0, R=1.0, Sigma0=1.0), "H: expected a matrix (m, n), got a function"),
        (lambda: celnav.update(np.eye(2), RULE, 0.04), "got shape (); [[0.04]] of one component, 0.04 * np.eye(n) of n alike"),
        (lambda: celnav.update(np.eye(2), RULE, [0.1, 0.2]), "got shape (2,); variances alone are np.diag(...)"),
        (lambda: celnav.sequential(SEE, MOTION), "predict: expected a part (belief, epoch), got Conditioning"),
        (lambda: celnav.sequential(MOTION, MOTION), "updates: expected parts (belief, z, epoch, memory) after the predict part"),
        (lambda: celnav.sequential(MOTION, [SEE]), "after the predict part, got list"),
        (lambda: celnav.sequential(FILTER, SEE), "predict: expected a part (belief, epoch), got Filter"),
        (lambda: celnav.run(PRIOR, FILTER, celnav.epochs([0.0])), "filter: expected a Filter, such as celnav.sequential makes"),
        (lambda: celnav.run(FILTER, np.zeros(2), celnav.epochs([0.0])), "prior: expected a Gaussian, such as celnav.square_root"),
        (lambda: FILTER.step(PRIOR, celnav.Epoch()), "state: expected what the filter's start(prior) or last step gave"),
        (lambda: celnav.epochs([0.0, 1.0], [1.0, 2.0]), "got (2,); one component is z[:, None]"),
        (lambda: celnav.from_filterpy(3), "points: expected a filterpy sigma-point object"),
        (lambda: celnav.angles([0.5]), "components: expected integers of at least 0, got [0.5]"),
        (lambda: celnav.angles([5]).minus(np.zeros(2), np.zeros(2)), "angles: expected components below 2"),
        (lambda: celnav.smooth(None, [], f), "motion: expected the filter's predict part"),
        (lambda: SEE(PRIOR, 3.0), "z: expected shape (..., m), got the number 3.0; one component is [z]"),
    ],
)  # fmt: skip
def test_other_arguments(make, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        make()


def test_batches_that_do_not_go_together():
    prior = square_root(np.zeros((5, 2)), np.eye(2))
    with pytest.raises(ValueError, match=r"z: batch axes \(3,\) do not go with those of the belief, \(5,\)"):
        celnav.run(FILTER, prior, celnav.epochs([0.0, 1.0], np.zeros((2, 3, 2))))
    # one measurement for all runs, and one run's belief for all measurements, do
    assert celnav.run(FILTER, prior, celnav.epochs([0.0], np.zeros((1, 2)))).mean.shape == (1, 5, 2)
    assert celnav.run(FILTER, PRIOR, celnav.epochs([0.0], np.zeros((1, 3, 2)))).mean.shape == (1, 3, 2)


def test_no_noise_has_no_columns():
    """A measurement without noise is possible, and exact; it has to be said."""
    exact = celnav.update([[1.0, 1.0]], RULE, sqrt_R=np.zeros((1, 0)))
    for prior in (PRIOR, covariance(np.zeros(2), np.eye(2))):
        belief, _, _ = exact(prior, [3.0])
        np.testing.assert_allclose(belief.mean, [1.5, 1.5], rtol=1e-12)
        np.testing.assert_allclose(belief.cov, [[0.5, -0.5], [-0.5, 0.5]], atol=1e-12)


def test_a_model_that_takes_the_epoch_for_its_interval_is_told_what_it_gets():
    filter = celnav.sequential(celnav.predict(lambda x, dt: x + dt * x, RULE, np.eye(2)), SEE)
    with pytest.raises(ValueError, match="inhomogeneous") as error:
        celnav.run(filter, PRIOR, celnav.epochs([0.0, 1.0], np.zeros((2, 2))))
    assert (
        "f is called with points (5, 2) and an Epoch: epoch.dt is its interval, epoch.u (None) its input" in error.value.__notes__
    )


@pytest.mark.parametrize(
    "model",
    [
        lambda x, e: np.array([x[0] + x[1], x[1]]),
        lambda x, e: [x[0], x[9]],
        lambda x, e: EYE3 @ x,
        lambda x, e: x[:, 0],
        lambda x, e: x[..., 0],
    ],
    ids=["rows", "beyond", "matrix", "column", "one component"],
)
@pytest.mark.parametrize("runs", [(), (4,)])
def test_a_model_of_one_vector_is_told_what_points_are(model, runs):
    """Whether its value has another shape or it raises by itself."""
    prior = square_root(np.zeros((*runs, 3)), np.eye(3))
    for rule in (celnav.unscented(3), celnav.Taylor(lambda x, e: (EYE3,))):
        with pytest.raises((ValueError, IndexError)) as error:
            celnav.run(celnav.sequential(celnav.predict(model, rule, EYE3)), prior, celnav.epochs([0.0, 1.0]))
        said = "\n".join([str(error.value), *getattr(error.value, "__notes__", [])])
        assert "points are (p, ..., n): a component is x[..., 0], a product with a matrix x @ F.T" in said


def test_what_a_track_and_a_rule_say_of_themselves():
    z = np.zeros((3, 4, 2))
    track = celnav.run(FILTER, square_root(np.zeros((4, 2)), np.eye(2)), celnav.epochs([0.0, 1.0, 2.0], z))
    assert repr(track) == "Track(3 epochs from 0 to 2 s, 4 runs; mean, std, innovation stored, square root form)"
    assert repr(celnav.unscented(2)) == "Rule(n=2, points=4 and a center of weight 0, negative weights=0)"
    assert repr(celnav.unscented(2, 0.5)) == "Rule(n=2, points=5, negative weights=1)"


def test_angles_can_be_sent_to_another_process():
    for places in (None, [1]):
        space = pickle.loads(pickle.dumps(celnav.angles(places)))
        np.testing.assert_allclose(space.minus(np.array([0.0, 3.0]), np.array([0.0, -3.0])), [0.0, 6.0 - 2.0 * np.pi], rtol=1e-12)


def test_what_is_masked_is_missing():
    """netCDF and FITS readers give masked arrays."""
    z = np.ma.masked_values([[1.0, 1.0], [-999.0, 2.0], [3.0, 3.0]], -999.0)
    found, expected = (celnav.run(FILTER, PRIOR, celnav.epochs(np.arange(3.0), v)) for v in (z, z.filled(np.nan)))
    np.testing.assert_array_equal(found.mean, expected.mean)
    np.testing.assert_array_equal(found.dof, [2, 1, 2])
    np.testing.assert_array_equal(SEE(PRIOR, z[1])[0].mean, SEE(PRIOR, [np.nan, 2.0])[0].mean)
    listed = celnav.run(FILTER, PRIOR, celnav.epochs(np.arange(3.0), list(z)))
    np.testing.assert_array_equal(listed.mean, expected.mean)


def noise(mean, epoch):
    return 0.1 * np.eye(2)


def move(x, epoch):
    return x + 0.0


def test_parts_can_be_sent_to_another_process():
    """With functions that can; a space that came back is the same space."""
    parts = celnav.predict(move, RULE, sqrt_Q=noise), celnav.update(np.eye(2), RULE, np.eye(2))
    motion = pickle.loads(pickle.dumps(parts[0]))
    belief, _ = motion(PRIOR, celnav.Epoch(1, 1.0, 1.0))
    np.testing.assert_allclose(belief.cov, 1.01 * np.eye(2))
    celnav.sequential(motion, parts[1])
    celnav.sequential(deepcopy(parts[0]), parts[1])


@pytest.mark.parametrize("rule", [celnav.Taylor(), celnav.unscented(2, 1e-3, 2.0)], ids=["taylor", "alpha"])
def test_a_model_in_single_precision_is_told_where_differences_are_round_off(rule):
    """A deviation of 1e-5 came out of one of 0.01, and nothing was said."""
    single = celnav.predict(lambda x, epoch: x.astype(np.float32), rule, 1e-10 * np.eye(2))
    with pytest.warns(RuntimeWarning, match="f returns float32: its values differ .* Compute in float64"):
        single(celnav.square_root([7000.0, 7000.0], 1e-4 * np.eye(2)))
    see = celnav.update(lambda x, epoch: x[..., :1].astype(np.float32), rule, [[1.0]])
    with pytest.warns(RuntimeWarning, match="h returns float32"):
        see(celnav.square_root([7000.0, 7000.0], 1e-4 * np.eye(2)), [7000.0])


def test_single_precision_that_does_no_harm_is_taken_in_silence():
    """Differences far above round-off, a component that is known exactly, Jacobians of one's own."""
    for rule in (celnav.unscented(2), celnav.Taylor(lambda x, epoch: (np.eye(2),))):
        part = celnav.predict(lambda x, epoch: x.astype(np.float32), rule, np.zeros((2, 2)))
        after, _ = part(celnav.square_root([7000.0, 0.1], np.diag([1e4, 0.0])))
        np.testing.assert_allclose(after.std, [100.0, 0.0], rtol=1e-5)


def test_masked_values_of_a_model_are_refused():
    """Of what is hidden nothing is known; masked arrays without a mask are arrays."""
    rule, prior = celnav.unscented(2), celnav.square_root(np.ones(2), np.eye(2))

    def hidden(x, epoch=None):
        return np.ma.masked_greater(x, 1.5)

    for name, call in {
        "f": lambda: celnav.predict(hidden, rule, np.eye(2))(prior),
        "h": lambda: celnav.update(hidden, rule, np.eye(2))(prior, [1.0, 1.0]),
        "sqrt_R": lambda: celnav.update(np.eye(2), rule, sqrt_R=lambda x, e: hidden(2.0 * np.eye(2)))(prior, [1.0, 1.0]),
        "jacobians": lambda: celnav.predict(lambda x, e: x, celnav.Taylor(lambda x, e: (hidden(2.0 * np.eye(2)),)), np.eye(2))(
            prior
        ),
    }.items():
        with pytest.raises(ValueError, match=f"^{name}: expected numbers, got masked ones; a component .* is nan in z"):
            call()
    after, _ = celnav.predict(lambda x, e: np.ma.masked_array(x), rule, np.eye(2))(prior)
    np.testing.assert_allclose(after.cov, 2.0 * np.eye(2), atol=1e-14)


def test_jacobians_are_a_function():
    for given in (np.eye(2), (np.eye(2),), 3):
        with pytest.raises(ValueError, match=r"^jacobians: expected a function \(mean, epoch\) -> \(J,\), such as lambda x, epoch"):
            celnav.Taylor(given)
