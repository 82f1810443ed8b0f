"""Geometry of scenes, compared with the sensors' measurements."""

import numpy as np
from scipy.spatial.transform import Rotation

from celnav.models.orbit import EARTH, from_elements, propagate
from celnav.models.sightings import angles, star_directions
from celnav.show import scenes

ORBIT = propagate(from_elements(7136.635, 1e-3, *np.deg2rad([65.0, 30.0, 30.0]), 0.0), 10.0, 60)


class Drawn:
    """A recorder that stores its arguments."""

    def __init__(self):
        self.given = {}

    def __getattr__(self, name):
        """The first of what is drawn of an entity."""
        return lambda entity, *arrays, **rest: self.given.setdefault(entity, arrays)


def test_sight_lines_touch_the_earth_at_the_measured_angles():
    position, stars, out = ORBIT[:, :3], star_directions(1.2), Drawn()
    scenes.sightings(out, "world", position, ORBIT[:, 3:], stars, EARTH.radius_km)
    lines = out.given["world/limb"][0]
    start, direction = lines[:, :, 0], lines[:, :, 1] - lines[:, :, 0]
    np.testing.assert_allclose(start, np.repeat(position[:, None], 2, 1), rtol=1e-12)
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    # The distance of the Earth's center from the line is its radius.
    np.testing.assert_allclose(
        np.linalg.norm(np.cross(start, unit), axis=-1), EARTH.radius_km, rtol=1e-12
    )
    A = angles(position, stars)
    np.testing.assert_allclose(np.arccos(np.sum(unit[:, 0] * unit[:, 1], -1)), A[:, 2], atol=1e-9)
    arcs = out.given["world/angles"][0] - position[:, None, None]
    ends = arcs[:, :, [0, -1]] / np.linalg.norm(arcs[:, :, [0, -1]], axis=-1, keepdims=True)
    np.testing.assert_allclose(np.arccos(np.sum(ends[:, :, 0] * ends[:, :, 1], -1)), A, atol=1e-9)
    for i, star in enumerate(stars, start=1):
        origins, vectors = out.given[f"world/stars/i{i}"][:2]
        np.testing.assert_array_equal(origins, position)
        np.testing.assert_allclose(
            vectors / np.linalg.norm(vectors, axis=1, keepdims=True), np.tile(star, (61, 1))
        )


def test_axes_turn_as_much_as_the_error_but_no_further_than_can_be_seen():
    """Ten times as far, if that is less than a right angle; other axes remain on the true axes."""
    out, axis = Drawn(), np.array([0.6, 0.0, 0.8])
    angles = np.array([0.0, 0.01, 0.15, 0.158, 2.0])
    error = angles[:, None] * axis
    scenes.turning(out, "world/truth", {"own": (error, "#112233")}, 2.0, factor=10.0)
    origins, quaternions = out.given["world/truth/own"]
    np.testing.assert_array_equal(origins, np.zeros((5, 3)))
    seen = np.array([0.0, 0.1, 1.5, 0.0, 0.0])
    expected = Rotation.from_rotvec(seen[:, None] * axis)
    turned = Rotation.from_quat(quaternions) * expected.inv()
    np.testing.assert_allclose(turned.magnitude(), 0.0, atol=1e-12)


def test_the_line_behind_is_as_long_as_there_is():
    points = np.arange(30.0).reshape(10, 3)
    behind = scenes.behind(points, 4, every=3)
    assert behind.shape == (4, 5, 3)
    np.testing.assert_array_equal(behind[0], np.repeat(points[:1], 5, 0))
    np.testing.assert_array_equal(behind[2], points[2:7])


def test_a_view_from_the_side_looks_at_the_orbit_from_above_the_equator():
    space = scenes.beside("world", "scene", ORBIT[0], EARTH.radius_km, ["world/a/trail"])
    assert np.linalg.norm(space.eye) > EARTH.radius_km
    assert space.eye[2] > space.target[2]
    assert space.growing == ["world/a/trail"]
