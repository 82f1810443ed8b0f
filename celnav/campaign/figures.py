"""Figures of a campaign: accuracy and consistency over the swept keys, and over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.campaign import Outcome, Row
from celnav.campaign.missions import Configuration, Study
from celnav.campaign.table import Merged, plain
from celnav.gaussian.linalg import Array
from celnav.papers import load
from celnav.show import colors
from celnav.show.figures import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PALETTE", "accuracy", "consistency", "figures", "over_time", "stems"]

MOST_PANELS = 12
PALETTE = (
    colors.ESTIMATE,
    colors.COMPARISON,
    colors.OPEN_LOOP,
    colors.REFERENCE,
    colors.PAPER,
    colors.MEASUREMENT,
)
MARKERS = "osD^vP"


def stems(study: Study) -> list[str]:
    """Of everything that `figures` may draw."""
    judged = load(study.paper).JUDGED
    return [
        *(f"{kind}_{name}" for kind in ("accuracy", "time") for name in judged),
        "consistency",
        "failures",
    ]


def figures(outcome: Outcome) -> dict[str, Figure]:
    """Drawings by file stem: the accuracy of each group, the consistency, failures if there are any, and errors over time."""
    groups = next((row.groups for row in outcome.rows if row.groups), ())
    out = {f"accuracy_{name}": accuracy(outcome, name, unit) for name, unit in groups}
    if groups:
        out["consistency"] = consistency(outcome)
        out |= {f"time_{name}": over_time(outcome, i) for i, (name, _) in enumerate(groups)}
    if any(row.failed for row in outcome.rows):
        out["failures"] = failures(outcome)
    return out


def style(study: Study, filter: str) -> dict[str, Any]:
    """Color, marker and line of a filter, the same in all figures."""
    i = study.filters.index(filter)
    return {
        "color": PALETTE[i % 6],
        "marker": MARKERS[i % 6],
        "linestyle": ("-", "--", ":")[i // 6 % 3],
        "label": filter,
    }


def _keys(study: Study) -> tuple[str | None, list[str]]:
    """The key along the x axis, which has the most values (numbers before words), and the others."""
    if not study.swept:
        return None, []
    best = max(study.swept, key=lambda key: (_numeric(study.swept[key]), len(study.swept[key])))
    return best, [key for key in study.swept if key != best]


def _numeric(values: Sequence[Any]) -> bool:
    return all(isinstance(v, float | int) and not isinstance(v, bool) for v in values)


def _panels(study: Study) -> list[dict[str, Any]]:
    """Values of the keys that are not along the x axis, one dict a panel."""
    others = _keys(study)[1]
    return list(
        {
            tuple(p.values[k] for k in others): {k: p.values[k] for k in others}
            for p in study.configurations
        }.values()
    )


def _draw(
    outcome: Outcome, label: str, title: str, draw: Callable[[Axes, list[Row], Array, str], None]
) -> Figure:
    """A panel for each combination of the other keys, and in it a curve for each filter over the first."""
    study = outcome.study
    key, panels = _keys(study)[0], _panels(study)
    shown = panels[:MOST_PANELS]
    columns = min(len(shown), 4)
    lines = -(-len(shown) // columns)
    fig, axes = figure(
        max(4.6, 3.1 * columns), 2.9 * lines + 0.3, lines, columns, squeeze=False, sharey=True
    )
    values = study.swept[key] if key else ("",)
    numeric = bool(key) and _numeric(values)
    for ax, panel in zip(axes.flat, shown, strict=False):
        for name in study.filters:
            rows = [
                r
                for r in outcome.rows
                if r.filter == name and all(r.values[k] == v for k, v in panel.items())
            ]
            at = [
                float(r.values[key])
                if key and numeric
                else float(values.index(r.values[key] if key else ""))
                for r in rows
            ]
            # Side by side where there is room between the values.
            beside = (
                0.0
                if numeric
                else 0.6 * ((study.filters.index(name) + 0.5) / len(study.filters) - 0.5)
            )
            order = np.argsort(at)
            draw(ax, [rows[i] for i in order], np.asarray(at)[order] + beside, name)
        if numeric:
            if min(values) > 0 and max(values) >= 10 * min(values):
                ax.set_xscale("log")
            if len(values) <= 8:
                ax.set_xticks(values, [f"{v:g}" for v in values])
                ax.set_xticks([], minor=True)
        else:
            ax.set_xticks(range(len(values)), [str(plain(v)) for v in values])
        ax.set_xlabel(key or "")
        ax.set_title(", ".join(f"{k} = {plain(v)}" for k, v in panel.items()))
    for ax in axes.flat[len(shown) :]:
        ax.remove()
    for ax in axes[:, 0]:
        ax.set_ylabel(label)
    _finish(fig)
    rest = f" (the first {len(shown)} of {len(panels)} panels)" if len(panels) > len(shown) else ""
    fig.suptitle(title + rest)
    return fig


def _finish(fig: Figure) -> None:
    """A legend below, and a logarithmic axis where the values are far apart."""
    fig.legend(
        *fig.axes[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=2 if fig.get_figwidth() < 6.0 else 4,
    )
    low, high = (
        np.min([ax.dataLim.intervaly[0] for ax in fig.axes]),
        np.max([ax.dataLim.intervaly[1] for ax in fig.axes]),
    )
    if high > 4.0 * low > 0.0:
        fig.axes[0].set_yscale("log")


def accuracy(outcome: Outcome, group: str, unit: str) -> Figure:
    """Root mean square errors over the settled epochs, with intervals, and the bound."""
    study = outcome.study

    def draw(ax: Axes, rows: list[Row], at: Array, name: str) -> None:
        found = [row.accuracy(group) for row in rows]
        rms, low, high, least = (
            np.array([np.nan if a is None else getattr(a, stat) for a in found])
            for stat in ("rms", "low", "high", "bound")
        )
        reach = np.nan_to_num(np.stack([rms - low, high - rms]))
        ax.errorbar(at, rms, reach, capsize=2, markersize=3, **style(study, name))
        if np.isfinite(least).any() and name == study.filters[0]:
            middle = at if len(at) > 1 else np.array([-0.35, 0.35])
            bound = least if len(at) > 1 else np.repeat(least, 2)
            ax.plot(
                middle,
                bound,
                color="black",
                linewidth=0.9,
                linestyle=(0, (4, 2)),
                label="bound",
                zorder=0,
            )

    return _draw(
        outcome,
        f"rms error ({unit})",
        f"{group}: settled rms of {study.runs} runs, 95 % interval",
        draw,
    )


def consistency(outcome: Outcome) -> Figure:
    """NEES over its dimension, and the band of a consistent filter."""
    study = outcome.study

    def draw(ax: Axes, rows: list[Row], at: Array, name: str) -> None:
        empty = (np.nan, np.nan, np.nan)
        anees, low, high = np.array(
            [
                empty if r.summary is None else (r.summary.anees, r.summary.low, r.summary.high)
                for r in rows
            ]
        ).T
        ax.errorbar(
            at,
            anees,
            np.nan_to_num([anees - low, high - anees]),
            capsize=2,
            markersize=3,
            **style(study, name),
        )
        band = next((row.summary.band for row in rows if row.summary is not None), None)
        if band is not None and name == study.filters[0]:
            ax.axhspan(
                *band,
                color=colors.SIGMA,
                alpha=0.25,
                linewidth=0.0,
                label="consistent (95 %, one epoch)",
            )

    return _draw(
        outcome, "NEES / dimension (-)", "consistency: average NEES over its dimension", draw
    )


def failures(outcome: Outcome) -> Figure:
    """Part of the runs that failed."""
    study = outcome.study

    def draw(ax: Axes, rows: list[Row], at: Array, name: str) -> None:
        ax.plot(at, [row.failed / study.runs for row in rows], markersize=3, **style(study, name))
        ax.set_ylim(-0.02, 1.02)

    return _draw(outcome, "runs that failed (part)", "failures", draw)


def over_time(outcome: Outcome, group: int) -> Figure:
    """Root mean square errors at each epoch of the first configurations, what filters take them for, and the bound."""
    study, shown = outcome.study, outcome.first
    name, unit = shown[0][1].groups[group]
    columns = min(len(shown), 3)
    lines = -(-len(shown) // columns)
    fig, axes = figure(
        max(5.0, 4.0 * columns), 2.8 * lines + 0.3, lines, columns, squeeze=False, sharey=True
    )
    for ax, (point, found) in zip(axes.flat, shown, strict=False):
        _curves(ax, study, found, group, point)
    for ax in axes.flat[len(shown) :]:
        ax.remove()
    for ax in axes[:, 0]:
        ax.set_ylabel(f"rms error ({unit})")
    _finish(fig)
    rest = (
        f" (the first {len(shown)} of {len(study.configurations)} configurations)"
        if len(study.configurations) > len(shown)
        else ""
    )
    fig.suptitle(f"{name} over time; dotted: what the filter takes it for{rest}")
    return fig


def _curves(ax: Axes, study: Study, found: Merged, group: int, point: Configuration) -> None:
    times: Array | None = None
    for name in study.filters:
        scores = found.scores[name]
        if scores is None:
            continue
        times, look = scores["times"], style(study, name)
        with np.errstate(invalid="ignore", divide="ignore"):
            rms, sigma = (
                np.sqrt(scores[a][:, group] / scores[b])
                for a, b in (("square", "count"), ("variance", "known"))
            )
        ax.semilogy(times, rms, color=look["color"], linestyle=look["linestyle"], label=name)
        ax.semilogy(times, sigma, color=look["color"], linestyle=":", linewidth=0.8)
    if found.bound is not None and times is not None:
        ax.semilogy(
            times,
            np.sqrt(found.bound[:, group]),
            color="black",
            linewidth=0.9,
            linestyle=(0, (4, 2)),
            label="bound",
            zorder=0,
        )
    ax.set_xlabel("time (s)")
    ax.set_title(", ".join(f"{k} = {plain(v)}" for k, v in point.values.items()))
