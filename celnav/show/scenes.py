"""Common parts of the scenes of recordings: tracks, sight lines and angles of a satellite, and the
line behind a moving point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from celnav.gaussian import attitude
from celnav.gaussian.linalg import Array
from celnav.models.sightings import limb
from celnav.show import colors
from celnav.show.showcase import SceneView

if TYPE_CHECKING:
    from celnav.show.recording import Recorder


def track(
    out: Recorder,
    entity: str,
    points: Array,
    color: str,
    label: str = "",
    *,
    cov: Array | None = None,
    radius: float = 1.0,
) -> None:
    """Log a point that moves through ``points (T, 3)``, its ``trail`` and, if given, the 3σ
    ellipsoid of ``cov (T, 3, 3)``.

    The view must list ``entity/trail`` as growing.
    """
    out.trail(f"{entity}/trail", points, color, radius=radius)
    out.points(f"{entity}/here", points, color, radius=radius + 3.0, label=label)
    if cov is not None:
        out.ellipsoids(f"{entity}/ellipsoid", points, cov, color)


def sightings(
    out: Recorder, origin: str, position: Array, velocity: Array, stars: Array, radius: float
) -> None:
    """Log a satellite above a sphere, with the directions that it measures.

    position, velocity: ``(T, 3)``. stars: directions ``(k, 3)``. The scene has the sphere's limb,
    the angles between the vertical and the stars, and the angle between the limb's sight lines.
    """
    out.globe(f"{origin}/earth", radius)
    out.path(f"{origin}/orbit", [position], colors.FAINT)
    track(out, f"{origin}/truth", position, colors.TRUTH, radius=3.5)
    for i, star in enumerate(stars, start=1):
        out.arrow(
            f"{origin}/stars/i{i}",
            position,
            np.broadcast_to(0.9 * radius * star, position.shape),
            colors.STAR,
            f"i{i}",
        )
    touched = limb(position, velocity, radius)
    lines = touched - position[:, None]
    out.strips(
        f"{origin}/limb",
        np.stack([touched - lines, touched], 2),
        [colors.MEASUREMENT] * 2,
        radius=1.5,
    )
    up, lines = unit(position), unit(lines)
    arcs = [
        *(arc(up, np.broadcast_to(star, up.shape)) for star in stars),
        arc(lines[:, 0], lines[:, 1]),
    ]
    around = position[:, None, None] + 0.2 * radius * np.stack(arcs, 1)
    shades = [*[colors.STAR] * len(stars), colors.MEASUREMENT]
    out.strips(
        f"{origin}/angles", around, shades, labels=[f"A{i}" for i in range(1, len(arcs) + 1)]
    )
    out.strips(
        f"{origin}/zenith", position[:, None, None] * np.array([1.0, 1.3])[:, None], [colors.FAINT]
    )


def beside(
    origin: str, title: str, state: Array, radius: float, growing: Sequence[str]
) -> SceneView:
    """A view of a satellite's scene that shows an orbital plane from its side, from above the
    equator. ``state (6,)`` is a state on the orbit.
    """
    side = np.cross(unit(state[:3]), unit(state[3:]))
    target = 0.8 * radius * unit(state[:3])
    eye = target + 1.7 * radius * unit(np.copysign(1.0, side[2]) * side + np.array([0.0, 0.0, 0.8]))
    return SceneView(origin, title, eye, target, growing=growing)


def turning(
    out: Recorder,
    entity: str,
    errors: Mapping[str, tuple[Array, str]],
    length: float,
    factor: float = 1.0,
) -> None:
    """Log the axes of estimates below ``entity``, whose own axes are the truth's.

    errors: rotation vectors ``(T, 3)`` rad and colors by name. factor: enlargement of the
    rotations. A rotation that would then exceed a right angle is left out.
    """
    for key, (error, color) in errors.items():
        small = np.linalg.norm(error, axis=1, keepdims=True) < 0.5 * np.pi / factor
        out.pose(
            f"{entity}/{key}",
            np.zeros(error.shape),
            attitude.exp(np.where(small, factor * error, 0.0)),
        )
        out.axes(f"{entity}/{key}", length, [color] * 3, radius=0.7)


def constellation(
    out: Recorder,
    origin: str,
    places: Array,
    orbits: Array,
    receiver: Array,
    names: Sequence[str],
    shades: Sequence[str],
) -> None:
    """Satellites at ``places (T, S, 3)`` on ``orbits (points, S, 3)``, with names and colors, seen
    from ``receiver (T, 3)``.
    """
    for s, (name, shade) in enumerate(zip(names, shades, strict=True)):
        out.path(f"{origin}/orbit/{name}", [orbits[:, s]], shade, radius=0.3)
        out.points(f"{origin}/sat/{name}", places[:, s], shade, radius=4.0, label=str(name))
    out.strips(
        f"{origin}/sight",
        np.stack([np.broadcast_to(receiver[:, None], places.shape), places], 2),
        shades,
        radius=0.5,
    )
    out.points(f"{origin}/receiver", receiver, colors.TRUTH, radius=4.0, label="receiver")


def flight(
    out: Recorder,
    origin: str,
    place: Array,
    computed: Array,
    fixed: Array,
    sights: Array,
    expected: Array,
) -> None:
    """Log an aircraft and its stellar-inertial navigation.

    place, computed: true position, and that of the inertial system, ``(T, 3)``. fixed: whether
    there is a fix, ``(T,)``. sights, expected: sight lines to stars, and where the system expects
    them, ``(T, 3, k)``. The view must list the trails of aircraft and inertial as growing.
    """
    track(out, f"{origin}/aircraft", place, colors.TRUTH, "aircraft", radius=2.5)
    track(out, f"{origin}/inertial", computed, colors.SIGMA, "inertial system", radius=1.5)
    out.points(
        f"{origin}/fix", np.where(fixed[:, None], place, np.nan), colors.MEASUREMENT, radius=3.0
    )
    for k in range(sights.shape[-1]):
        out.arrow(
            f"{origin}/star{k + 1}/sight", place, sights[..., k], colors.STAR, f"star {k + 1}"
        )
        out.arrow(f"{origin}/star{k + 1}/expected", place, expected[..., k], colors.MEASUREMENT, "")


def sigma_points(out: Recorder, entity: str, points: Array, weights: Array, color: str) -> None:
    """Log points ``(T, N, 3)`` about the truth at the origin; white if their weight is negative."""
    out.points(f"{entity}/positive", points[:, weights > 0.0], color, radius=2.5)
    out.points(f"{entity}/negative", points[:, weights < 0.0], colors.NEGATIVE, radius=2.5)
    out.points(f"{entity}/truth", np.zeros((len(points), 3)), colors.TRUTH, radius=5.0)


def unit(vectors: Array) -> Array:
    """Vectors ``(..., 3)`` of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def arc(start: Array, end: Array) -> Array:
    """Great-circle arcs ``(T, 13, 3)`` between unit vectors ``(T, 3)`` that are not parallel."""
    angle = np.arccos(np.clip(np.sum(start * end, 1), -1.0, 1.0))[:, None, None]
    part = np.linspace(0.0, 1.0, 13)[:, None]
    across = unit(end - np.cos(angle[:, 0]) * start)[:, None]
    return np.asarray(np.cos(part * angle) * start[:, None] + np.sin(part * angle) * across)


def behind(points: Array, steps: int, every: int = 1) -> Array:
    """The last steps of a track ``(K, 3)`` behind each ``every``-th point, ``(T, steps + 1, 3)``;
    near the start as many steps as exist.
    """
    rows = np.arange(0, len(points), every)[:, None] + np.arange(-steps, 1)
    return np.asarray(points[np.maximum(rows, 0)])
