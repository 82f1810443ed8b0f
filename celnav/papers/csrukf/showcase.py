"""Recording of one run: the scene about the Earth, the errors in a space of their own, the plots [Sun2015]."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.sightings import star_directions
from celnav.show import colors

if TYPE_CHECKING:
    from celnav.show.recording import Recorder

FILTERS = {"srukf": "SRUKF", "csrukf": "CSRUKF", "openloop": "open loop"}
BOUNDED = ("csrukf", "srukf")  # whose bounds are seen at first
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Estimate:
    """What a filter made of the run: ``mean (T, 6)`` km, km/s, ``cov (T, 6, 6)``, ``nees (T,)`` and ``nis (T,)`` (nan: none)."""

    mean: Array
    cov: Array
    nees: Array
    nis: Array


@dataclass(frozen=True)
class Showcase:
    """One run in full and the Monte Carlo behind it.

    Attributes
    ----------
    title, notes: heading and Markdown of the text panel.
    times: ``(T,)`` s.
    truth: ``(T, 6)`` km, km/s.
    measurements: pseudo-positions ``(T, 3)`` km, nan where none.
    noise: the true colored noise ``(T, 3)`` km; noise_mean, noise_std: its estimate by the augmented filter.
    estimates: of the filters "srukf", "csrukf" and "openloop".
    ensemble: position errors ``(T, runs, 3)`` km of some runs of each filter.
    rmse: 3-D position RMSE ``(T,)`` km of the Monte Carlo; bound: the posterior Cramér-Rao bound ``(T,)`` km.
    separation: of the two stars, rad. radius_km: of the Earth.
    nees_band, nis_band: within which a consistent filter stays.
    """

    title: str
    notes: str
    times: Array
    truth: Array
    measurements: Array
    noise: Array
    noise_mean: Array
    noise_std: Array
    estimates: dict[str, Estimate]
    ensemble: dict[str, Array]
    rmse: dict[str, Array]
    bound: Array
    separation: float
    radius_km: float
    nees_band: tuple[float, float]
    nis_band: tuple[float, float]


def record_showcase(showcase: Showcase, path: str | Path) -> Path:
    """Write the recording to ``path`` and return it; see `celnav.show.recording.recording` for what is replaced and raised.

    Raises
    ------
    ValueError: if an array does not go with the times or a filter is missing; it names the entity or the field.
    OSError: if ``path`` cannot be written.
    """
    from celnav.show import recording  # late: reproducing the paper needs no viewer

    _check(showcase)
    color = {"srukf": colors.COMPARISON, "csrukf": colors.ESTIMATE, "openloop": colors.OPEN_LOOP}
    facts = {"paper": "csrukf", "nees_band": list(showcase.nees_band), "nis_band": list(showcase.nis_band)}
    name = f"csrukf: {showcase.title}"
    with recording.recording(path, showcase.times, name=name, layout=_layout(showcase), properties=facts) as out:
        out.text("info", f"# {showcase.title}\n\n{showcase.notes}\n\n{_LEGEND}")
        _scene(out, showcase, color)
        _errors(out, showcase, color)
        _plots(out, showcase, color)
        for key, estimate in showcase.estimates.items():
            out.exact(f"state/{key}", mean=estimate.mean, covariance=estimate.cov)
        out.exact("state/truth", mean=showcase.truth)
    return Path(path)


_LEGEND = """
**Colors.** green: truth · orange: CSRUKF · blue: SRUKF · purple: open loop · sky blue: measured pseudo-positions · gray: ±3σ ·
yellow: posterior Cramér–Rao bound.

**Scene.** The directions i1, i2 of two stars, their angles A1, A2 to the position vector, and the sight lines to the Earth's limb,
A3 apart. Estimates and truth differ by less than a line's width; hence the second view:

**Errors.** Estimate minus truth. A consistent filter keeps the origin in its 3σ ellipsoid. Points: other runs. Sky blue: the last
30 s of the measurement's error.

Space bar: play. Tabs: other axes. Double-click in a plot: all of its range.
"""


def _check(showcase: Showcase) -> None:
    for name, given in (("estimates", showcase.estimates), ("ensemble", showcase.ensemble), ("rmse", showcase.rmse)):
        if set(given) != set(FILTERS):
            raise ValueError(f"{name}: expected the filters {sorted(FILTERS)}, got {sorted(given)}")
    count = len(showcase.times)
    for name, array, shape in (
        ("truth", showcase.truth, (6,)),
        *((name, getattr(showcase, name), (3,)) for name in ("measurements", "noise", "noise_mean", "noise_std")),
        ("bound", showcase.bound, ()),
        *((f"rmse {key}", rmse, ()) for key, rmse in showcase.rmse.items()),
        *((f"estimates {key} mean", e.mean, (6,)) for key, e in showcase.estimates.items()),
        *((f"estimates {key} cov", e.cov, (6, 6)) for key, e in showcase.estimates.items()),
        *((f"estimates {key} nees", e.nees, ()) for key, e in showcase.estimates.items()),
        *((f"estimates {key} nis", e.nis, ()) for key, e in showcase.estimates.items()),
    ):
        if array.shape != (count, *shape):
            raise ValueError(f"{name}: expected shape {(count, *shape)}, got {array.shape}")
    if not np.isfinite(showcase.truth).all():
        raise ValueError("truth: expected finite positions and velocities")
    lowest = np.linalg.norm(showcase.truth[:, :3], axis=1).min()
    if not 0.0 < showcase.radius_km < lowest:
        raise ValueError(f"radius_km: expected less than the satellite's radius {lowest:.6g} km, got {showcase.radius_km!r}")
    for name, (low, high) in (("nees_band", showcase.nees_band), ("nis_band", showcase.nis_band)):
        if not 0.0 < low < high < np.inf:
            raise ValueError(f"{name}: expected 0 < low < high, got {(low, high)}")


def _scene(out: Recorder, showcase: Showcase, color: dict[str, str]) -> None:
    """`world`: the Earth, the satellite, what it sees, and the lines that truth and estimates draw."""

    position = showcase.truth[:, :3]
    out.globe("world/earth", showcase.radius_km)
    out.path("world/arc", [position], colors.FAINT)
    out.trail("world/truth", position, colors.TRUTH, radius=3.5)
    for key, estimate in showcase.estimates.items():
        out.trail(f"world/{key}", estimate.mean[:, :3], color[key], radius=1.2)
    out.points("world/z", showcase.measurements, colors.MEASUREMENT, radius=1.0)
    out.points("world/satellite", position, "#FFFFFF", radius=5.0, label="satellite")
    stars = star_directions(showcase.separation)
    length = 0.9 * showcase.radius_km
    for label, star in zip(("i1", "i2"), stars, strict=True):
        out.arrow(f"world/stars/{label}", position, np.broadcast_to(length * star, position.shape), "#FFF3C4", label)
    limb = _limb(position, showcase.truth[:, 3:], showcase.radius_km)
    sight = np.stack([np.broadcast_to(position[:, None], limb.shape), limb], 2)
    out.strips("world/sight/earth_limb", sight, [colors.MEASUREMENT] * 2, radius=1.5)
    up = position / np.linalg.norm(position, axis=1, keepdims=True)
    arcs = [_arc(up, np.broadcast_to(star, up.shape)) for star in stars]
    lines = (limb - position[:, None]) / np.linalg.norm(limb - position[:, None], axis=-1, keepdims=True)
    arcs.append(_arc(lines[:, 0], lines[:, 1]))
    around = position[:, None, None] + 0.2 * showcase.radius_km * np.stack(arcs, 1)
    out.strips("world/angles", around, ["#FFF3C4", "#FFF3C4", colors.MEASUREMENT], labels=["A1", "A2", "A3"])
    zenith = position[:, None, None] * np.array([1.0, 1.3])[:, None]
    out.strips("world/zenith", zenith, [colors.FAINT])


def _limb(position: Array, velocity: Array, radius: float) -> Array:
    """Points ``(T, 2, 3)`` where the sight lines in the orbit's plane touch the Earth: p'p = R^2 and p'(p - r) = 0."""
    r = np.linalg.norm(position, axis=1, keepdims=True)
    up = position / r
    along = velocity - np.sum(velocity * up, 1, keepdims=True) * up
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    sine = radius / r
    return radius * np.stack([sine * up + sign * np.sqrt(1.0 - sine * sine) * along for sign in (1.0, -1.0)], 1)


def _arc(start: Array, end: Array, points: int = 13) -> Array:
    """Great-circle arcs ``(T, points, 3)`` between unit vectors ``(T, 3)``."""
    angle = np.arccos(np.clip(np.sum(start * end, 1), -1.0, 1.0))[:, None, None]
    part = np.linspace(0.0, 1.0, points)[:, None]
    across = end - np.cos(angle[:, 0]) * start
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    arcs: Array = np.cos(part * angle) * start[:, None] + np.sin(part * angle) * across[:, None]
    return arcs


def _errors(out: Recorder, showcase: Showcase, color: dict[str, str]) -> None:
    """`error`: estimates minus truth in km about the origin, which single precision on the scale of the orbit would hide."""

    position = showcase.truth[:, :3]
    length = 10.0 ** np.floor(np.log10(_extent(showcase)))
    out.path("error/axes", list(length * np.stack([np.zeros((3, 3)), np.eye(3)], 1)), colors.SIGMA)
    out.points("error/truth", np.zeros_like(position), colors.TRUTH, radius=6.0)
    out.trail("error/z", showcase.measurements - position, colors.MEASUREMENT, radius=0.4)
    for key, estimate in showcase.estimates.items():
        error = estimate.mean[:, :3] - position
        out.trail(f"error/{key}/trail", error, color[key], radius=0.6)
        out.points(f"error/{key}/estimate", error, color[key], radius=3.0)
        out.ellipsoids(f"error/{key}/ellipsoid", error, estimate.cov[:, :3, :3], color[key])
        out.points(f"error/{key}/ensemble", showcase.ensemble[key], color[key], radius=1.5)


def _plots(out: Recorder, showcase: Showcase, color: dict[str, str]) -> None:
    """`plots`: errors with bounds, the colored noise, consistency and the Monte Carlo."""

    for key, estimate in showcase.estimates.items():
        error, sigma = _error_and_sigma(showcase, estimate)
        shown = key in BOUNDED
        width = 3.0 if key == "csrukf" else 1.2  # where it coincides with another, both are seen
        for i, axis in enumerate(AXES):
            for quantity, j in (("pos_err", i), ("vel_err", i + 3)):
                entity = f"plots/{quantity}/{axis}/{key}"
                out.curve(entity, error[:, j], color[key], FILTERS[key], width=width)
                out.bounds(entity, sigma[:, j], FILTERS[key], shown=shown, color=color[key])
        out.log_curve(f"plots/nees/{key}", estimate.nees, color[key], FILTERS[key], width=width)
        out.log_curve(f"plots/nis/{key}", estimate.nis, color[key], FILTERS[key], width=width)
        out.log_curve(f"plots/rmse/{key}", showcase.rmse[key], color[key], FILTERS[key], width=width)
    out.log_curve("plots/rmse/pcrb", showcase.bound, colors.BOUND, "Cramér–Rao bound", width=1.2)
    for name, band in (("nees", showcase.nees_band), ("nis", showcase.nis_band)):
        for end, value in zip(("low", "high"), band, strict=True):
            out.level(f"plots/{name}/band/{end}", float(np.log10(value)), f"95 % band, {end}")
    for i, axis in enumerate(AXES):
        out.curve(f"plots/V/{axis}/truth", showcase.noise[:, i], colors.TRUTH, "true V")
        entity = f"plots/V/{axis}/augmented"
        out.curve(entity, showcase.noise_mean[:, i], colors.BOUND, "augmented filter")
        out.bounds(entity, showcase.noise_std[:, i], "augmented filter", center=showcase.noise_mean[:, i], color=colors.BOUND)


def _error_and_sigma(showcase: Showcase, estimate: Estimate) -> tuple[Array, Array]:
    """Errors and deviations ``(T, 6)``, km and m/s."""
    units = np.repeat([1.0, 1e3], 3)
    variance = estimate.cov.diagonal(0, -2, -1)
    return units * (estimate.mean - showcase.truth), units * np.sqrt(np.where(variance >= 0.0, variance, np.nan))


def _largest(values: Array, quantile: float = 1.0) -> float:
    """Largest magnitude of the finite values, or a quantile of them; 0 if there are none."""
    magnitudes = np.abs(values[np.isfinite(values)])
    return float(np.quantile(magnitudes, quantile)) if magnitudes.size else 0.0


def _extent(showcase: Showcase) -> float:
    """Size of the picture of the errors, km: the ellipsoid of the CSRUKF at its largest and most of the other runs."""
    size = 3.0 * _largest(_error_and_sigma(showcase, showcase.estimates["csrukf"])[1][:, :3])
    cloud = _largest(np.linalg.norm(showcase.ensemble["srukf"], axis=-1), 0.9)
    return max(size, min(cloud, 3.2 * size)) or 1.0


def _layout(showcase: Showcase) -> Any:
    """Scene and errors at the left, plots at the right."""
    from celnav.show.views import columns, plot, rows, space, tabs, text

    times = showcase.times
    size = _extent(showcase)
    middle = showcase.truth[len(times) // 2]
    up = middle[:3] / np.linalg.norm(middle[:3])
    side = np.cross(up, middle[3:] / np.linalg.norm(middle[3:]))
    side *= np.copysign(1.0, side[2])
    target = showcase.radius_km * 0.8 * up
    toward = side + np.array([0.0, 0.0, 0.8])  # the orbit's plane seen from its side, and the stars' plane from above
    scene = space(
        "world",
        "scene, km",
        eye=target + 1.7 * showcase.radius_km * toward / np.linalg.norm(toward),
        target=target,
        growing=dict.fromkeys(["world/truth", "world/z", *(f"world/{key}" for key in FILTERS)], np.inf),
    )
    errors = space(
        "error",
        "errors, km (origin: truth)",
        eye=size * np.array([1.7, -1.5, 1.1]),
        growing={"error/z": 30.0, **dict.fromkeys((f"error/{key}/trail" for key in FILTERS), np.inf)},
    )
    errors_of = [_error_and_sigma(showcase, showcase.estimates[key]) for key in BOUNDED]

    def limits(part: slice) -> tuple[float, float]:
        """Symmetric, room for the errors but never so much that the widest bounds shrink to a line."""
        error = max(_largest(e[:, part]) for e, _ in errors_of)
        bound = 3.0 * max(_largest(s[:, part]) for _, s in errors_of)
        most = 1.05 * max(bound, min(error, 3.0 * bound)) or 1.0
        return -most, most

    position, velocity = limits(slice(0, 3)), limits(slice(3, 6))
    return columns(
        rows(scene, columns(errors, text("info", "about"), shares=[3, 2]), shares=[5, 4]),
        rows(
            tabs(*(plot(f"plots/pos_err/{i}", f"position error {i}, km", times, limits=position) for i in AXES)),
            tabs(*(plot(f"plots/vel_err/{i}", f"velocity error {i}, m/s", times, limits=velocity) for i in AXES)),
            tabs(*(plot(f"plots/V/{i}", f"colored noise V {i}, km", times) for i in AXES)),
            columns(
                tabs(
                    plot("plots/nees", "log10 NEES (gray: band)", times, legend=False),
                    plot("plots/nis", "log10 NIS", times, legend=False),
                ),
                plot("plots/rmse", "log10 RMSE in km (yellow: bound)", times, legend=False),
            ),
        ),
        shares=[11, 10],
    )
