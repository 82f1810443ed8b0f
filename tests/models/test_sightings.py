"""Sightings: position to angles and back, the Jacobian against differences, stars behind the Earth,
ambiguous angles.
"""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from celnav.models.orbit import EARTH, UnitWarning
from celnav.models.sightings import (
    angles,
    jacobian,
    observe,
    position,
    pseudo_position_covariance,
    star_directions,
    visible,
)

R0 = np.array([4593.859722, 4391.854959, 3230.759943])
SEPARATION = 0.5 * np.pi


@settings(max_examples=80, deadline=None)
@given(
    st.floats(6600.0, 45000.0),
    st.floats(0.2, 1.4),
    st.floats(0.0, 2.0 * np.pi),
    st.floats(0.5, 2.6),
    st.sampled_from([1.0, -1.0]),
)
def test_angles_and_back(radius, latitude, longitude, separation, side):
    u = [
        np.cos(latitude) * np.cos(longitude),
        np.cos(latitude) * np.sin(longitude),
        side * np.sin(latitude),
    ]
    r = radius * np.array(u)
    back = position(angles(r, star_directions(separation)), separation, side)
    # arccos near 0 or pi, and the root near the plane of the stars, lose digits: use other angles.
    assume(np.abs(u[0]) < 0.99)
    assert np.abs(back - r).max() < 1e-8 * radius / 7000.0


def test_round_trip_on_the_reference_orbit():
    back = position(angles(R0, star_directions(SEPARATION)), SEPARATION)
    assert np.abs(back - R0).max() < 1e-10


def test_the_angles_are_the_printed_ones():
    theta, r = 1.1, np.linalg.norm(R0)
    A = angles(R0, star_directions(theta))
    x, y, _ = R0
    expected = [
        np.arccos(x / r),
        np.arccos((x * np.cos(theta) + y * np.sin(theta)) / r),
        2.0 * np.arcsin(EARTH.radius_km / r),
    ]
    np.testing.assert_allclose(A, expected, rtol=1e-14)


def test_the_printed_range_equation_is_wrong_and_ours_is_not():
    A3 = angles(np.array([7129.5, 0.0, 0.0]), star_directions(SEPARATION))[2]
    assert 0.5 * EARTH.radius_km * np.sin(0.5 * A3) == pytest.approx(2853.0, abs=1.0)
    assert EARTH.radius_km / np.sin(0.5 * A3) == pytest.approx(7129.5, rel=1e-14)


def test_angles_cannot_tell_the_hemisphere():
    mirrored = R0 * [1.0, 1.0, -1.0]
    stars = star_directions(SEPARATION)
    np.testing.assert_allclose(angles(mirrored, stars), angles(R0, stars), rtol=1e-15)
    np.testing.assert_allclose(
        position(angles(mirrored, stars), SEPARATION, -1.0), mirrored, rtol=1e-12
    )


@pytest.mark.parametrize("batch", [(3,), (2, 3)])
def test_batches_with_a_hemisphere_each(batch):
    rng = np.random.default_rng(1)
    r = R0 + rng.normal(size=(*batch, 3)) * 500.0
    r[..., 2] *= rng.choice([-1.0, 1.0], batch)
    back = position(angles(r, star_directions(1.3)), 1.3, np.sign(r[..., 2]))
    np.testing.assert_allclose(back, r, rtol=1e-11)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("separation", [SEPARATION, 1.0, 2.0])
def test_jacobian_is_the_difference_quotient(separation, side):
    r = R0 * [1.0, 1.0, side]
    A = angles(r, star_directions(separation))
    h = 1e-5
    G = [
        (position(A + h * e, separation, side) - position(A - h * e, separation, side)) / (2.0 * h)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(jacobian(A, separation, side), np.array(G).T, rtol=1e-6, atol=1e-3)


def test_jacobian_of_a_batch():
    r = R0 + np.random.default_rng(2).normal(size=(4, 3)) * 300.0
    A = angles(r, star_directions(1.2))
    np.testing.assert_allclose(jacobian(A, 1.2), [jacobian(a, 1.2) for a in A], rtol=1e-12)


def test_pseudo_position_covariance_is_that_of_samples():
    sigma = np.deg2rad([0.005, 0.005, 0.005]) / 3.0
    P = pseudo_position_covariance(R0, SEPARATION, sigma)
    A = (
        angles(R0, star_directions(SEPARATION))
        + np.random.default_rng(3).normal(size=(100_000, 3)) * sigma
    )
    sampled = np.cov(position(A, SEPARATION).T)
    scale = np.sqrt(P.diagonal())
    np.testing.assert_allclose(
        sampled / np.outer(scale, scale),
        P / np.outer(scale, scale),
        atol=5.0 * np.sqrt(2.0 / 100_000),
    )


def test_pseudo_position_covariance_of_the_specified_sensor():
    """0.005 deg on all angles: 0.155, 0.49, 1.08 km along the principal axes at the start of the
    reference orbit.
    """
    camera = np.deg2rad(0.005)
    star = np.hypot(camera, np.deg2rad(3.0 / 3600.0))
    P = pseudo_position_covariance(R0, SEPARATION, [star, star, camera])
    np.testing.assert_allclose(np.sqrt(np.linalg.eigvalsh(P)), [0.155, 0.49, 1.08], rtol=0.02)


def test_the_earth_hides_stars():
    r = np.array([7000.0, 0.0, 0.0])
    stars = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_array_equal(visible(r, stars), [True, False, True])
    seen = observe(r, stars)
    np.testing.assert_array_equal(np.isnan(seen), [False, True, False, False])
    np.testing.assert_allclose(seen[[0, 2, 3]], angles(r, stars)[[0, 2, 3]])


def test_a_star_sets_where_the_limb_is():
    r = np.array([7000.0, 0.0, 0.0])
    limb = np.arcsin(EARTH.radius_km / 7000.0)
    for margin, seen in ((1e-6, True), (-1e-6, False)):
        angle = limb + margin  # from the direction of the Earth's center, -x
        assert visible(r, np.array([[-np.cos(angle), np.sin(angle), 0.0]]))[0] == seen


def test_inside_the_earth_there_is_no_limb():
    A = angles(np.array([6000.0, 0.0, 100.0]), star_directions(SEPARATION))
    np.testing.assert_array_equal(np.isnan(A), [False, False, True])


def test_impossible_angles_are_refused_or_marked():
    A = np.array([angles(R0, star_directions(SEPARATION)), [0.1, 0.1, 2.0]])
    with pytest.raises(ValueError, match=r"A: expected angles of a position .*, got 1 sets"):
        position(A, SEPARATION)
    marked = position(A, SEPARATION, strict=False)
    np.testing.assert_allclose(marked[0], R0, rtol=1e-12)
    assert np.isnan(marked[1, 2])


def test_missing_angles_stay_missing():
    A = angles(R0, star_directions(SEPARATION))
    A[1] = np.nan
    r = position(A, SEPARATION)
    np.testing.assert_array_equal(np.isnan(r), [False, True, True])


A0 = angles(R0, star_directions(SEPARATION))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: star_directions(0.0), "separation: expected two directions"),
        (lambda: star_directions(np.pi), "separation"),
        (lambda: star_directions(np.nan), "separation: expected a finite number, got nan"),
        (lambda: position(A0, np.pi), "separation"),
        (lambda: position(A0[:2], SEPARATION), r"A: expected shape \(..., 3\), got \(2,\)"),
        (
            lambda: position([*A0[:2], 0.0], SEPARATION),
            "A: expected an angular diameter between 0 and pi",
        ),
        (lambda: position([*A0[:2], np.pi], SEPARATION), "A: expected an angular diameter"),
        (lambda: position([np.inf, *A0[1:]], SEPARATION), "A: expected finite numbers or nan"),
        (lambda: position(A0, SEPARATION, 0.5), "hemisphere"),
        (
            lambda: jacobian(angles(R0 * [1.2, 1.2, 0.0], star_directions(SEPARATION)), SEPARATION),
            "A: .*plane of the stars",
        ),
    ],
)
def test_sightings_refuse_and_say_what(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: star_directions(75.0), "separation: 75 rad is more than a full turn"),
        (
            lambda: position([np.rad2deg(A0[0]), *A0[1:]], SEPARATION, strict=False),
            "A: 49.8834 rad is more than a full turn",
        ),
        (
            lambda: pseudo_position_covariance(R0, SEPARATION, [18.0, 18.0, 18.0]),
            "sigma: a standard deviation of 18 rad is more than 1",
        ),
    ],
)
def test_angles_in_degrees_or_seconds_are_warned_of(call, words):
    with pytest.warns(UnitWarning, match=f"^{words}; angles are in radians$"):
        call()
