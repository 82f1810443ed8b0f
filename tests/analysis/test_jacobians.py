"""The Jacobian checker passes what is right, and names the entry that is wrong."""

import numpy as np
import pytest

from celnav.analysis.jacobians import check_jacobian
from celnav.gaussian.spaces import angles
from celnav.models import orbit, sightings

SEPARATION = np.pi / 2
POSITIONS = np.array([[4593.86, 4391.85, 3230.76], [-2000.0, 6500.0, -1500.0], [6000.0, -1000.0, 3500.0]])
SIDES = np.sign(POSITIONS[:, 2])
ANGLES = sightings.angles(POSITIONS, sightings.star_directions(SEPARATION))


def located(A, separation, side):
    return sightings.position(A, separation, side)


def test_sightings():
    """The pseudo-position's Jacobian, for one position and for several with an input of their own."""
    check = check_jacobian(located, sightings.jacobian, ANGLES, args=(SEPARATION, SIDES), rtol=1e-8)
    assert check.numerical.shape == (3, 3, 3)
    assert check.error < 1e-8
    one = check_jacobian(located, sightings.jacobian, ANGLES[1], args=(SEPARATION, SIDES[1]), rtol=1e-8)
    np.testing.assert_allclose(one.numerical, check.numerical[1], rtol=1e-12)


@pytest.mark.parametrize("entry", [(0, 0, 0), (1, 2, 1), (2, 1, 2)])
def test_a_wrong_entry_is_named(entry):
    """A relative error of 1e-4 in one entry of one run: which, what it is, what it should be."""

    def wrong(A, separation, side):
        J = sightings.jacobian(A, separation, side)
        J[entry] *= 1.0001
        return J

    right = sightings.jacobian(ANGLES, SEPARATION, SIDES)[entry]
    with pytest.raises(ValueError, match=r"jacobian: expected .* \(relative error") as caught:
        check_jacobian(located, wrong, ANGLES, args=(SEPARATION, SIDES))
    message = str(caught.value)
    assert f"at entry {entry[1:]} of run ({entry[0]},)" in message
    assert float(message.split("expected ")[1].split(" ")[0]) == pytest.approx(right, rel=1e-7)
    assert float(message.split("got ")[1].split(" ")[0]) == pytest.approx(1.0001 * right, rel=1e-7)


def test_a_wrong_sign_and_a_wrong_zero_are_found():
    """One run: an entry of the wrong sign, and one that should be 0."""
    J = sightings.jacobian(ANGLES[0], SEPARATION, 1.0)
    flipped = J.copy()
    flipped[2, 0] *= -1.0
    with pytest.raises(ValueError, match=r"at entry \(2, 0\), got"):
        check_jacobian(located, flipped, ANGLES[0], args=(SEPARATION, 1.0))
    assert J[0, 1] == 0.0
    nonzero = J.copy()
    nonzero[0, 1] = 1.0
    with pytest.raises(ValueError, match=r"at entry \(0, 1\), got 1 "):
        check_jacobian(located, nonzero, ANGLES[0], args=(SEPARATION, 1.0))


def test_units_do_not_matter():
    """An orbit in km and km/s: entries of the transition matrix differ by six orders, each is judged by its own effect."""
    x = np.array([4593.859722, 4391.854959, 3230.759943, -4.608350, 0.500952, 5.871685])
    step = np.repeat([10.0, 0.01], 3)

    def move(points, dt):
        return orbit.step(points, dt)

    F = orbit.transition(x, 10.0)
    assert check_jacobian(move, F, x, args=(10.0,), step=step).error < 1e-6
    wrong = F.copy()
    wrong[3, 0] *= 1.1  # 1e-5 per second: nothing beside the ones on the diagonal, but of effect over 10 km
    with pytest.raises(ValueError, match=r"at entry \(3, 0\)"):
        check_jacobian(move, wrong, x, args=(10.0,), step=step)


def test_a_linear_function_is_exact_and_angles_wrap():
    M = np.array([[1.0, 2.0, 0.0], [0.0, -3.0, 1e-3]])
    check = check_jacobian(lambda x: x @ M.T, lambda x: (M,), np.zeros(3))
    np.testing.assert_allclose(check.numerical, M, rtol=0, atol=1e-13)

    def bearing(x):
        return np.arctan2(x[..., 1:], x[..., :1])

    at = np.array([-2.0, 1e-4])
    J = np.array([[-at[1], at[0]]]) / (at @ at)
    check_jacobian(bearing, J, at, output_space=angles())
    with pytest.raises(ValueError, match="choose another step"):
        check_jacobian(bearing, J, at)


def test_where_differences_cannot_judge():
    """A kink, and a domain that ends within the step, are told as such, not blamed on the Jacobian."""
    with pytest.raises(ValueError, match=r"function: expected it to be smooth .* entry \(0, 0\)"):
        check_jacobian(np.abs, np.array([[1.0]]), np.array([1e-4]))
    with np.errstate(invalid="ignore"), pytest.raises(ValueError, match="choose another step"):
        check_jacobian(np.arcsin, np.array([[1.0 / np.sqrt(1.0 - 0.9999**2)]]), np.array([0.9999]))
    good = check_jacobian(np.arcsin, np.array([[1.0 / np.sqrt(1.0 - 0.9999**2)]]), np.array([0.9999]), step=1e-5)
    assert good.error < 1e-6


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((lambda x: x, np.eye(2), np.zeros(3)), r"jacobian: expected shape \(3, 3\), got \(2, 2\)"),
        ((lambda x: x[0], np.eye(3), np.zeros(3)), "function: expected shape"),
        ((lambda x: x, np.eye(3), [np.nan, 0.0, 0.0]), "point: expected finite"),
        ((lambda x: x, np.full((3, 3), np.nan), np.zeros(3)), r"relative error inf"),
    ],
)
def test_bad_input_is_refused_by_name(arguments, match):
    with pytest.raises(ValueError, match=match):
        check_jacobian(*arguments)
    with pytest.raises(ValueError, match="step: expected positive"):
        check_jacobian(lambda x: x, np.eye(3), np.zeros(3), step=0.0)
    with pytest.raises(ValueError, match="rtol"):
        check_jacobian(lambda x: x, np.eye(3), np.zeros(3), rtol=0.0)
