"""Figures of a campaign: accuracy and consistency over the swept keys, and errors over time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.campaign import CampaignResult
from celnav.campaign.missions import MissionStudy
from celnav.campaign.scores import column
from celnav.campaign.table import plain
from celnav.campaign.units import Scored
from celnav.gaussian.linalg import Array
from celnav.papers import load
from celnav.show import colors
from celnav.show.draw import Item, Panel, curve, grid, look, panels

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_PANELS = 12
BOUND: Any = {
    "color": "black",
    "linewidth": 0.9,
    "linestyle": (0, (4, 2)),
    "label": "bound",
    "zorder": 0,
}
Common = Callable[[Array, Array], Item]
"""An item that is drawn once in a panel: ``(places along the x axis, columns of the first filter)
->`` item.
"""


def stems(study: MissionStudy) -> list[str]:
    """File stems of all figures that `figures` may draw."""
    judged = load(study.paper).JUDGED
    each = [f"{kind}_{name}" for kind in ("accuracy", "time") for name in judged]
    return [*each, "consistency", "failures"]


def figures(outcome: CampaignResult) -> dict[str, Figure]:
    """Figures by file stem: accuracy of each group, consistency, failures if some runs failed, and
    errors over time.
    """
    out = {f"accuracy_{name}": accuracy(outcome, name, unit) for name, unit in outcome.groups}
    if outcome.groups:
        out["consistency"] = consistency(outcome)
        out |= {f"time_{name}": over_time(outcome, i) for i, (name, _) in enumerate(outcome.groups)}
    if any(row["failed"] for row in outcome.rows):
        out["failures"] = _failures(outcome)
    return out


def _look(study: MissionStudy, filter: str) -> dict[str, Any]:
    """Look of a filter, the same in all figures."""
    return look(study.filters.index(filter)) | {"label": filter}


def _axis(study: MissionStudy) -> tuple[str, Sequence[Any], bool]:
    """The key along the x axis, its values, and whether they are numbers. It is the key with the
    most values, numbers before words.
    """
    if not study.swept:
        return "", ("",), False

    def is_numeric(key: str) -> bool:
        return all(type(value) in (float, int) for value in study.swept[key])

    key = max(study.swept, key=lambda key: (is_numeric(key), len(study.swept[key])))
    return key, study.swept[key], is_numeric(key)


def _over_keys(
    outcome: CampaignResult, label: str, title: str, names: Sequence[str], common: Common
) -> Figure:
    """A panel for each combination of the other keys, with a curve for each filter over the key of
    the x axis.

    names: columns of the table: value, low and high (or the value alone), then those of ``common``.
    """
    study = outcome.study
    key, values, numeric = _axis(study)
    others = [
        {k: plain(v) for k, v in point.values.items() if k != key} for point in study.configurations
    ]
    combinations = [others[i] for i in range(len(others)) if others[i] not in others[:i]]
    words = [plain(value) for value in values]
    drawn = []
    for fixed in combinations[:MOST_PANELS]:
        items: list[Item] = [_ticks(values, numeric)]
        for number, name in enumerate(study.filters):
            rows = [
                row
                for row in outcome.rows
                if row["filter"] == name and fixed.items() <= row.items()
            ]
            at = np.array([row[key] if numeric else words.index(row.get(key, "")) for row in rows])
            order = np.argsort(at)
            # Places of words have room for several filters side by side.
            beside = 0.0 if numeric else 0.6 * ((number + 0.5) / len(study.filters) - 0.5)
            places = at[order] + beside
            columns = np.array([[rows[i].get(name, np.nan) for i in order] for name in names])
            items.append(_interval(places, columns[:3], _look(study, name)))
            items += [] if number else [common(places, columns[3:])]
        drawn.append(Panel(_named(fixed), items, key, label))
    return _figure(drawn, len(combinations), title, "panels", 2)


def _named(values: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {plain(value)}" for key, value in values.items())


def _ticks(values: Sequence[Any], numeric: bool) -> Item:
    def item(ax: Axes) -> None:
        if not numeric:
            ax.set_xticks(range(len(values)), [str(plain(value)) for value in values])
            return
        if min(values) > 0 and max(values) >= 10 * min(values):
            ax.set_xscale("log")
        if len(values) <= 8:
            ax.set_xticks(values, [f"{value:g}" for value in values])
            ax.set_xticks([], minor=True)

    return item


def _figure(drawn: list[Panel], total: int, title: str, what: str, columns: int) -> Figure:
    """A figure of panels with a common y axis, which is logarithmic if values are far apart.

    total: number of all panels, of which some may be left out. columns: at most.
    """
    rows = grid(drawn, min(len(drawn), columns))
    if total > len(drawn):
        title = f"{title} (the first {len(drawn)} of {total} {what})"
    fig = panels(*rows, title=title, sharey=True)
    ends = np.array([ax.dataLim.intervaly for ax in fig.axes[: len(drawn)]])
    if ends[:, 1].max() > 4.0 * ends[:, 0].min() > 0.0:
        fig.axes[0].set_yscale("log")
    return fig


def _interval(at: Array, values: Array, look: dict[str, Any]) -> Item:
    """Item of values with intervals, as rows value, low and high; or of values alone."""
    reach = np.nan_to_num(np.abs(values[1:] - values[0])) if len(values) > 1 else None
    return lambda ax: ax.errorbar(at, values[0], reach, capsize=2, **look)


def accuracy(outcome: CampaignResult, group: str, unit: str) -> Figure:
    """Root mean square errors over the settled epochs, with intervals, and the bound."""

    def draw_bound(at: Array, columns: Array) -> Item:
        (bound,) = columns
        if not np.isfinite(bound).any():
            return curve([], [])
        alone = len(at) == 1  # then the bound is drawn as a level
        return curve([-0.35, 0.35] if alone else at, [*bound, *bound] if alone else bound, **BOUND)

    names = [column(group, statistic, unit) for statistic in ("rms", "low", "high", "bound")]
    title = f"{group}: settled rms of {outcome.study.runs} runs, 95 % interval"
    return _over_keys(outcome, f"rms error ({unit})", title, names, draw_bound)


def consistency(outcome: CampaignResult) -> Figure:
    """NEES over its dimension, and the band of a consistent filter."""

    def draw_band(_: Array, bands: Array) -> Item:
        shade: Any = {"color": colors.SIGMA, "alpha": 0.25, "linewidth": 0.0}
        known = bands[:, np.isfinite(bands[0])].T[:1]
        label = "consistent (95 %, one epoch)"
        return lambda ax: [ax.axhspan(*band, label=label, **shade) for band in known]

    names = ("anees", "anees_low", "anees_high", "band_low", "band_high")
    title = "consistency: average NEES over its dimension"
    return _over_keys(outcome, "NEES / dimension (-)", title, names, draw_band)


def _failures(outcome: CampaignResult) -> Figure:
    """Figure of the number of failed runs."""
    runs = outcome.study.runs

    def full(*_: Array) -> Item:
        return lambda ax: ax.set_ylim(-0.02 * runs, 1.02 * runs)

    return _over_keys(outcome, f"runs that failed, of {runs}", "failures", ["failed"], full)


def over_time(outcome: CampaignResult, group: int) -> Figure:
    """Root mean square errors of the first configurations over time, with the filters' predictions
    and the bound.
    """
    study = outcome.study
    name, unit = outcome.first[0][1].groups[group]
    drawn = [
        Panel(
            _named(point.values), _curves(study, scored, group), "time (s)", f"rms error ({unit})"
        )
        for point, scored in outcome.first
    ]
    title = f"{name} over time; dotted: predicted by the filter"
    total = len(study.configurations)
    return _figure(drawn, total, title, "configurations", 2)


def _curves(study: MissionStudy, scored: Scored, group: int) -> Iterator[Item]:
    times: Array | None = None
    yield lambda ax: ax.set_yscale("log")
    for name, scores in scored.scores.items():
        times, look = scores["times"], _look(study, name) | {"marker": ""}
        with np.errstate(invalid="ignore", divide="ignore"):
            rms, sigma = (
                np.sqrt(scores[a][:, group] / scores[b])
                for a, b in (("square", "count"), ("variance", "predicted"))
            )
        yield curve(times, rms, **look)
        yield curve(times, sigma, color=look["color"], linestyle=":", linewidth=0.8)
    if scored.bound is not None and times is not None:
        yield curve(times, np.sqrt(scored.bound[:, group]), **BOUND)
