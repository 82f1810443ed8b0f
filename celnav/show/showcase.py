"""Showcases: recordings of one full run, with its scene, its errors about the origin, plots with
bounds, and exact states.

A study provides arrays and draws its own scene. Names, layout and legend are the same for all
studies. rerun is imported when a showcase is recorded, not before.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian.checks import finite, numbers
from celnav.gaussian.linalg import Array
from celnav.show import colors
from celnav.show.estimates import Estimate
from celnav.show.plots import Curve, Plot, draw, legend_place
from celnav.study.trial import Group

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.show.recording import Recorder

WINDOW_PX, FRAME_PX = 800.0, 45.0
"""Height of the plots in a window of the usual size, and the part of a plot around its axes."""
WITH_LEGEND = 1.6
"""Height of a plot with a legend, whose colors hold for the others too."""
ENSEMBLE = 20
"""Further runs that are drawn as points."""
LOG = " (powers of ten)"
"""End of the title of a plot whose axis has decimal logarithms."""
FAR = 20.0
"""Errors that exceed their view by this factor are left out; initial errors may be so large."""


class SceneView(NamedTuple):
    """A view of a study's entities below ``origin``, see `celnav.show.views.space`. The past of the
    ``growing`` entities is visible.
    """

    origin: str
    name: str
    eye: Any
    target: Any = (0.0, 0.0, 0.0)
    up: Any = (0.0, 0.0, 1.0)
    growing: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Showcase:
    """One run in full, and the Monte Carlo behind it.

    Attributes
    ----------
    name: title of the recording in the viewer. notes: Markdown. times: ``(T,)`` s.
    estimates: by name, the study's own first. Initially the bounds of the first two are visible.
    hidden: names of estimates whose errors are hidden until clicked in the legend.
    groups: of the error's components. truth: the states ``(T, m)``, to be read back.
    truths: ``(T, k)`` by name of a group, in its unit. A group with a truth is drawn as estimates,
        others as errors.
    axes: the linear map ``(3, n)`` from errors to the space of errors, in ``unit``; None: no such
        space.
    measured: errors ``(T, 3)`` of the measurements in that space, nan where there is none. nis_dof:
        components of a measurement.
    bound: lower bound of the RMSE, ``(T,)`` by name of the group, in its unit.
    scene: draws the content of the ``spaces``. plots: further plots by name, in rows by name.
    bars: values ``(k,)`` by title.
    legend: meaning of further colors. parameters: of the study; only numbers and texts are shown.
    states: which of several states holds, ``(T,)`` texts by title, beside those of the estimates;
        "" where none holds. shades: colors of states that `celnav.show.colors.STATES` lacks.
    facts: about the recording, beside the number of runs of the estimates.
    counter: name of a timeline of steps.
    start: time (s) at which the recording is shown first, where something is to be seen; None: the
        end. start_date: date and time of ``t = 0``. trail_s: length of trails.
    """

    name: str
    notes: str
    times: Array
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    groups: Sequence[Group] = ()
    truth: Array | None = None
    axes: Array | None = None
    unit: str = ""
    measured: Array | None = None
    nis_dof: int = 1
    bound: Mapping[str, Array] = field(default_factory=dict)
    scene: Callable[[Recorder], None] | None = None
    spaces: Sequence[SceneView] = ()
    plots: Mapping[str, Mapping[str, Plot]] = field(default_factory=dict)
    bars: Mapping[str, Array] = field(default_factory=dict)
    legend: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    counter: str = ""
    truths: Mapping[str, Array] = field(default_factory=dict)
    hidden: Collection[str] = ()
    states: Mapping[str, Sequence[str]] = field(default_factory=dict)
    shades: Mapping[str, str] = field(default_factory=dict)
    start: float | None = None
    start_date: str | None = None
    trail_s: float = np.inf

    @property
    def main(self) -> list[str]:
        """Names of the estimates whose bounds are visible initially."""
        return list(self.estimates)[:2]

    @property
    def lanes(self) -> dict[str, Sequence[str]]:
        """States by title: those of the estimates, and the others."""
        own = {e.label: e.states for e in self.estimates.values() if e.states is not None}
        return {**own, **self.states}


def write(showcases: Mapping[str, Showcase], outputs: Outputs) -> list[str]:
    """The file names of showcases, after `record` has written them."""
    for name, showcase in showcases.items():
        with outputs.path_for(name) as path:
            record(showcase, path)
    return list(showcases)


def record(showcase: Showcase, path: str | os.PathLike[str]) -> None:
    """Write the recording; see `celnav.show.recording.recording` for what is replaced. Needs rerun.

    Raises
    ------
    ValueError: if an array does not go with the others, or ``path`` is a file that celnav did not
        make.
    OSError: if ``path`` cannot be written.
    """
    from celnav.show.recording import recording

    _check(showcase)
    rows = {**_errors(showcase), **showcase.plots, **_statistics(showcase)}
    for row, plots in rows.items():
        for name, plot in plots.items():
            for key, c in plot.curves.items():
                entity, shape = _entity("plots", row, name, key), (len(showcase.times),)
                numbers(f"{entity} values", c.values, shape)
                if c.sigma is not None:
                    numbers(f"{entity} sigma", c.sigma, shape)
    mapped, size = _mapped(showcase)
    runs = [estimate.errors.shape[1] for estimate in showcase.estimates.values()]
    facts = ({"runs": runs[0]} if runs else {}) | {**showcase.facts}
    about: Any = {"name": showcase.name, "properties": facts, "counter": showcase.counter}
    about |= {"start": showcase.start, "start_date": showcase.start_date}
    with recording(path, showcase.times, layout=_layout(showcase, rows, size), **about) as out:
        out.text("info", f"{showcase.notes}\n\n{_legend(showcase)}")
        if showcase.scene is not None:
            showcase.scene(out)
        if mapped:
            _draw_errors(out, showcase, mapped, size)
        for row, plots in rows.items():
            for name, plot in plots.items():
                draw(out, _entity("plots", row, name), plot)
        for title, values in showcase.bars.items():
            out.bars(_entity("bars", title), values, colors.ESTIMATE)
        shades = {**colors.STATES, **showcase.shades}
        for title, names in showcase.lanes.items():
            held = {name: shade for name, shade in shades.items() if name in set(names)}
            out.states(_entity("states", title), names, held)
        if showcase.truth is not None:
            out.exact("state/truth", mean=showcase.truth)
        for key, e in showcase.estimates.items():
            spread = (
                {} if e.cov is None else {"covariance" if e.cov.ndim == 3 else "variance": e.cov}
            )
            out.exact(f"state/{key}", error=e.errors[:, 0], **spread)


def _entity(*names: str) -> str:
    """The entity path of names, which may contain spaces."""
    return "/".join(name.replace(" ", "_") for name in names)


def _check(showcase: Showcase) -> None:
    """Raise the errors that the recorder would miss, or would report without a name."""
    T = len(finite("times", showcase.times, ("T",)))
    for key, e in showcase.estimates.items():
        n = numbers(f"estimates {key} errors", e.errors, (T, "runs", "n")).shape[-1]
        if e.cov is not None:
            numbers(f"estimates {key} cov", e.cov, (T, n) if np.ndim(e.cov) == 2 else (T, n, n))
    if showcase.axes is not None:
        finite("axes", showcase.axes, (3, "n"))


def _legend(showcase: Showcase) -> str:
    """Markdown with the meaning of the colors, and hints for the viewer."""
    meant = [
        (colors.TRUTH, "truth"),
        *((e.color, e.label) for e in showcase.estimates.values()),
        *showcase.legend.items(),
    ]
    meant += [(colors.BOUND, "Cramér–Rao bound")] * bool(showcase.bound) + [
        (colors.SIGMA, "95 % band")
    ] * bool(showcase.estimates)
    lines = [
        "**Colors.** "
        + " · ".join(f"{colors.NAMES.get(color, color)}: {text}" for color, text in meant)
        + "."
    ]
    errors = (
        "**Errors.** Estimate minus truth. A consistent filter keeps the origin in its 3σ "
        "ellipsoid. Points: other runs."
    )
    lines += [errors] * (showcase.axes is not None)
    lines.append(
        "Bar below: play. Tabs: other axes. Click in a legend: hide. Double-click in a plot: "
        "all of its range. Powers of ten: -1 on the axis is 0.1, 2 is 100."
    )
    rows = [
        f"| {name} | {text} |"
        for name, value in showcase.parameters.items()
        if (text := _plain(value))
    ]
    return (
        "\n\n".join(lines)
        + "\n\n"
        + "\n".join(["| parameter | |", "|---|---|", *rows] if rows else [])
    )


def _plain(value: Any) -> str:
    """A parameter's value as text; empty if it is not a number, a text or a tuple of these."""
    if isinstance(value, tuple):
        return ", ".join(parts) if all(parts := [_plain(part) for part in value]) else ""
    return (
        f"{value:.12g}"
        if isinstance(value, float)
        else str(value)
        if isinstance(value, int | str)
        else ""
    )


def _largest(values: Array, quantile: float = 1.0) -> float:
    """A quantile of the magnitudes of the finite values; 0 if there are none."""
    magnitudes = np.abs(values[np.isfinite(values)])
    return float(np.quantile(magnitudes, quantile)) if magnitudes.size else 0.0


def _reach(errors: Sequence[Array], sigmas: Sequence[Array | None], quantile: float) -> float:
    """Half size of a view that shows errors and three standard deviations ``(T, ...)``.

    Large initial values must not shrink the rest to a line. So three standard deviations count at
    most twice their value after the first quarter of the run, and errors only from there.
    """
    late = slice(len(errors[0]) // 4 if errors else 0, None)
    predicted = [s for s in sigmas if s is not None]
    bound = 3.0 * max(
        (min(_largest(s), 2.0 * _largest(s[late]) or np.inf) for s in predicted), default=0.0
    )
    error = max((_largest(e[late], quantile) for e in errors), default=0.0)
    return max(bound, min(error, 3.0 * bound) if bound else error)


def _errors(showcase: Showcase) -> dict[str, dict[str, Plot]]:
    """A row of plots for each group: one for each axis, and one of sizes."""
    rows: dict[str, dict[str, Plot]] = {}
    for group in showcase.groups:
        errors = {
            key: (e.error(group)[:, 0], e.sigma(group))
            for key, e in showcase.estimates.items()
            if e.error(group).size
        }
        main = [errors[key] for key in showcase.main if key in errors]
        reach = 1.05 * _reach([error for error, _ in main], [sigma for _, sigma in main], 1.0)
        truth = showcase.truths.get(group.name)
        about = np.zeros((len(showcase.times), len(group.names))) if truth is None else truth
        limits = (
            (float(np.nanmin(about)) - reach, float(np.nanmax(about)) + reach)
            if reach > 0.0
            else None
        )
        row = rows.setdefault(group.name, {})
        for i, axis in enumerate(group.names):
            curves = {} if truth is None else {"truth": Curve(about[:, i], colors.TRUTH, "truth")}
            for key, (error, sigma) in errors.items():
                center = 0.0 if truth is None else about[:, i] + error[:, i]
                curves[key] = _curve(
                    showcase,
                    key,
                    about[:, i] + error[:, i],
                    None if sigma is None else sigma[:, i],
                    center,
                )
            row[axis] = Plot(
                f"{group.name} {'error ' * (truth is None)}{axis}, {group.unit}",
                curves,
                limits=limits,
            )
        lengths = {
            key: [None if part is None else np.linalg.norm(part, axis=1) for part in both]
            for key, both in errors.items()
        }
        sizes = {key: _curve(showcase, key, *both) for key, both in lengths.items()}
        row["size"] = Plot(f"|{group.name} error|, {group.unit}{LOG}", sizes, log=True)
    return rows


def _curve(
    showcase: Showcase, key: str, values: Any, sigma: Array | None = None, center: Any = 0.0
) -> Curve:
    """A curve in the color of an estimate. The viewer draws in the order of names, so wide curves
    stay visible below the curves that they coincide with.
    """
    e, below = showcase.estimates[key], sorted(showcase.estimates).index(key)
    return Curve(
        values,
        e.color,
        e.label,
        sigma,
        center,
        shown=key in showcase.main,
        width=max(1.2, 3.2 - below),
        visible=key not in showcase.hidden,
    )


def _statistics(showcase: Showcase) -> dict[str, dict[str, Plot]]:
    """NEES and NIS over their dimensions, and the RMSE of all runs."""
    rows: dict[str, dict[str, Plot]] = {"consistency": {}, "rmse": {}}
    every = showcase.estimates.items()
    n = max((e.errors.shape[-1] for _, e in every), default=1)
    for name, dimension in (("nees", n), ("nis", showcase.nis_dof)):
        curves = {
            key: _curve(showcase, key, values / dimension)
            for key, e in every
            if (values := getattr(e, name)) is not None
        }
        low, high = (limit / dimension for limit in chi_square_band(dimension, 1))
        if curves:
            title = f"{name.upper()} / {dimension}{LOG}"
            rows["consistency"][name] = Plot(
                title, curves, log=True, band=(low, high), legend=False
            )
    for group in showcase.groups:
        errors = {
            key: error for key, e in every if (error := e.error(group)).size and error.shape[1] > 1
        }
        rmse = {
            key: _curve(showcase, key, np.sqrt(np.square(error).sum(-1).mean(1)))
            for key, error in errors.items()
        }
        if group.name in showcase.bound:
            rmse["bound"] = Curve(
                showcase.bound[group.name], colors.BOUND, "Cramér–Rao bound", width=1.2
            )
        if rmse:
            rows["rmse"][group.name] = Plot(
                f"RMSE of {group.name}, {group.unit}{LOG}", rmse, log=True, legend=False
            )
    return {row: plots for row, plots in rows.items() if plots}


_Mapped = dict[str, tuple[Array, Array | None]]
"""Estimates in the space of errors: all runs ``(T, runs, 3)``, covariances ``(T, 3, 3)`` of the
first.
"""


def _mapped(showcase: Showcase) -> tuple[_Mapped, float]:
    """Estimates in the space of errors, and the half size of its view."""
    if showcase.axes is None:
        return {}, 1.0
    mapped: _Mapped = {}
    for key, e in showcase.estimates.items():
        A = showcase.axes[:, : e.errors.shape[-1]]
        mapped[key] = (
            e.errors @ A.T,
            A @ e.cov @ A.T if e.cov is not None and e.cov.ndim == 3 else None,
        )
    errors, covs = zip(*(mapped[key] for key in showcase.main), strict=True) if mapped else ((), ())
    sigmas = [
        None if cov is None else np.sqrt(np.fmax(cov.diagonal(0, -2, -1), 0.0)) for cov in covs
    ]
    return mapped, _reach(
        [np.linalg.norm(e[:, : ENSEMBLE + 1], axis=-1) for e in errors], sigmas, 0.9
    ) or 1.0


def _draw_errors(out: Recorder, showcase: Showcase, mapped: _Mapped, size: float) -> None:
    """Draw errors about the origin, since single precision at the scale of an orbit would hide
    them.
    """
    length = 10.0 ** np.floor(np.log10(size))
    out.path("error/axes", list(length * np.stack([np.zeros((3, 3)), np.eye(3)], 1)), colors.SIGMA)
    out.points("error/truth", np.zeros((len(out.times), 3)), colors.TRUTH, radius=6.0)
    if showcase.measured is not None:
        out.points("error/measured/points", showcase.measured, colors.MEASUREMENT, radius=1.5)
        out.trail("error/measured/trail", showcase.measured, colors.MEASUREMENT, radius=0.4)
    for key, (errors, cov) in mapped.items():
        color = showcase.estimates[key].color
        near = np.where(np.linalg.norm(errors, axis=-1, keepdims=True) < FAR * size, errors, np.nan)
        if (
            showcase.estimates[key].cov is not None
        ):  # a line through estimates of single epochs says nothing
            out.trail(f"error/{key}/trail", near[:, 0], color, radius=0.6)
        out.points(f"error/{key}/estimate", near[:, 0], color, radius=3.0)
        if errors.shape[1] > 1:
            out.points(f"error/{key}/ensemble", near[:, 1 : ENSEMBLE + 1], color, radius=1.5)
        if cov is not None:
            small = np.trace(cov, axis1=1, axis2=2)[:, None] < (FAR * size) ** 2
            out.ellipsoids(
                f"error/{key}/ellipsoid", np.where(small, near[:, 0], np.nan), cov, color
            )


def _layout(showcase: Showcase, rows: Mapping[str, Mapping[str, Plot]], size: float) -> Any:
    """Scene and errors at the left, plots at the right."""
    from celnav.show import views

    times = showcase.times
    about = [views.text(origin="info", name="about")]
    about += [views.bar_chart(origin=_entity("bars", title), name=title) for title in showcase.bars]
    left: list[Any] = [views.tabs(*about)]
    if showcase.axes is not None:
        growing = {
            f"error/measured/{what}": 0.05 * float(times[-1] - times[0])
            for what in ("points", "trail")
        }
        growing |= {f"error/{key}/trail": showcase.trail_s for key in showcase.estimates}
        eye = size * np.array([1.7, -1.5, 1.1])
        left = [
            views.columns(
                views.space(
                    "error", f"errors, {showcase.unit} (origin: truth)", eye=eye, growing=growing
                ),
                *left,
                column_shares=(3, 2),
            )
        ]
    if showcase.spaces:
        scenes = [
            views.space(
                **scene._asdict() | {"growing": dict.fromkeys(scene.growing, showcase.trail_s)}
            )
            for scene in showcase.spaces
        ]
        left = [views.tabs(*scenes), *left]
    # Without a scene all plots of a row fit side by side.
    arranged = views.tabs if showcase.spaces else views.columns
    below = [row for row in ("consistency", "rmse") if row in rows]
    above = [row for row in rows if row not in below]
    named, shares = set[str](), dict[str, float]()
    for row in above:
        labels = {c.label for p in rows[row].values() if p.legend for c in p.curves.values()}
        shares[row] = 1.0 if labels <= named else WITH_LEGEND
        named |= labels
    lanes = [0.42 + 0.22 * len(showcase.lanes)] * bool(showcase.lanes)
    unit_px = WINDOW_PX / sum([*shares.values(), *lanes, bool(below)])

    def plot(row: str, name: str, alone: bool) -> Any:
        p, height = rows[row][name], unit_px * shares.get(row, 1.0) - FRAME_PX
        corner, limits = "", p.limits
        if p.legend and shares.get(row) == WITH_LEGEND and alone:
            corner, limits = legend_place(p, times, height)
        return views.plot(_entity("plots", row, name), p.title, limits=limits, legend=corner)

    drawn = [
        arranged(
            *(plot(row, name, bool(showcase.spaces) or not i) for i, name in enumerate(rows[row]))
        )
        for row in above
    ]
    drawn += [views.states("states", "states")] * len(lanes)
    if below:
        tabs = [views.tabs(*(plot(row, name, False) for name in rows[row])) for row in below]
        drawn.append(views.columns(*tabs))
    heights = [*shares.values(), *lanes, *[1.0] * bool(below)]
    return views.columns(
        views.rows(*left, row_shares=(5, 4)[: len(left)]),
        views.rows(*drawn, row_shares=heights),
        column_shares=(11, 10) if showcase.spaces else (1, 4),
    )
