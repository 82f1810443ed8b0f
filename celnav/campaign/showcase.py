"""A mission's first run, filter by filter: errors within three deviations, drawn and recorded."""

from __future__ import annotations

import contextlib
from os import PathLike
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from celnav.campaign import Outcome
from celnav.campaign.figures import PALETTE
from celnav.campaign.missions import Study
from celnav.campaign.units import STUDY
from celnav.gaussian.linalg import Array
from celnav.models.earth import SEMI_MAJOR_M
from celnav.papers import load
from celnav.papers.own import name_of
from celnav.show import colors, scenes
from celnav.show import showcase as showcases
from celnav.show.estimates import Estimate, Group
from celnav.show.figures import figure
from celnav.show.plots import Curve, Plot
from celnav.study.montecarlo import generator
from celnav.study.trial import Followed, Trial, follow

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.show.recording import Recorder

__all__ = ["errors", "record", "showcase"]


class Showcase(NamedTuple):
    """The first run: what each filter made of it at the judged epochs ``times (K,)`` s, and its ``truth (K, 3)`` km, None where the
    state is no orbit."""

    study: Study
    times: Array
    groups: tuple[Group, ...]
    truth: Array | None
    estimates: dict[str, Estimate]


def showcase(study: Study) -> Showcase | None:
    """Follow the first run of a mission with the filters that can; None if it cannot be simulated, or no filter can."""
    filters: dict[str, Followed] = {}
    with contextlib.suppress(Exception):  # what went wrong is among the reasons in the table
        trial: Trial = load(study.paper).trial(
            study.configurations[0].config, [generator(study.seed, STUDY, 0)]
        )
        for name in study.filters:
            with contextlib.suppress(Exception):
                filters[name] = follow(trial, name)
    if not filters:
        return None
    truth = None
    if trial.place is not None:
        epochs = trial.epochs(next(iter(filters)))
        truth = np.stack(
            [trial.place(epoch.truth)[0] for epoch in epochs if epoch.truth is not None]
        )
    groups = []
    for name, unit, part, scale in trial.groups:
        numbered = tuple(str(i) for i in range(1, part.stop - part.start + 1))
        groups.append(
            Group(name, unit, part, scale, ("x", "y", "z") if len(numbered) == 3 else numbered)
        )
    estimates = {
        name: Estimate(name, _color(study, name), f.error, f.std[:, 0] ** 2, f.nees[:, 0])
        for name, f in filters.items()
    }
    return Showcase(study, next(iter(filters.values())).times, tuple(groups), truth, estimates)


def _color(study: Study, filter: str) -> str:
    return PALETTE[study.filters.index(filter) % len(PALETTE)]


def errors(shown: Showcase) -> Figure:
    """Errors of the first run, a row for each group and a column for each filter."""
    rows, columns = len(shown.groups), len(shown.estimates)
    fig, axes = figure(
        max(5.0, 2.6 * columns),
        2.0 * rows + 0.4,
        rows,
        columns,
        squeeze=False,
        sharex=True,
        sharey="row",
    )
    late = slice(len(shown.times) // 4, None)
    for row, group in zip(axes, shown.groups, strict=True):
        top = 0.0
        for ax, estimate in zip(row, shown.estimates.values(), strict=True):
            error, reach = (
                estimate.error(group)[:, 0],
                3.0 * np.asarray(estimate.sigma(group)).max(1),
            )
            ax.plot(
                shown.times,
                reach,
                color=colors.SIGMA,
                linewidth=0.8,
                label="±3σ, the largest of them",
            )
            ax.plot(shown.times, -reach, color=colors.SIGMA, linewidth=0.8)
            for i, component in enumerate(error.T):
                ax.plot(
                    shown.times,
                    component,
                    color=PALETTE[i % 6],
                    linewidth=0.8,
                    label=f"component {i + 1}",
                )
            top = max(
                top, 1.2 * float(np.nanmax(np.abs([*error[late].T, reach[late]]), initial=0.0))
            )
        row[0].set_ylabel(f"{group.name} error ({group.unit})")
        if top > 0.0:
            row[0].set_ylim(-top, top)
    for ax, name in zip(axes[0], shown.estimates, strict=True):
        ax.set_title(name)
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    fig.suptitle("errors of the first run (axes cut off before the first quarter is over)")
    return fig


def record(shown: Showcase, outcome: Outcome, path: str | PathLike[str]) -> None:
    """Record the first run, and the rms of all runs. Needs rerun.

    Raises
    ------
    OSError: if ``path`` cannot be written. ValueError: if it is a file that celnav did not make.
    """
    study, truth, spaces = shown.study, shown.truth, []
    if truth is not None:
        eye = float(np.abs(truth).max()) * np.array([2.2, -1.8, 1.4])
        spaces = [showcases.Space("orbit", "orbit, km", eye, growing=["orbit/satellite/trail"])]

    def scene(out: Recorder) -> None:
        if truth is not None:
            out.globe("orbit/earth", 1e-3 * SEMI_MAJOR_M)
            scenes.track(out, "orbit/satellite", truth, colors.TRUTH, "satellite")

    run = showcases.Showcase(
        f"mission {study.title}", _about(study, outcome), shown.times, shown.estimates, shown.groups, scene=scene, spaces=spaces,
        plots={"all runs": _rms(shown, outcome)},
        facts={"paper": name_of(study.paper), "runs": study.runs, "seed": study.seed, "filters": ", ".join(study.filters)},
    )  # fmt: skip
    showcases.record(run, path)


def _rms(shown: Showcase, outcome: Outcome) -> dict[str, Plot]:
    """Errors of all runs, at the epochs that were scored, by group."""
    found, plots = outcome.first[0][1], {}
    for i, group in enumerate(shown.groups):
        curves = {}
        for name, scores in found.scores.items():
            if scores is not None:
                with np.errstate(invalid="ignore", divide="ignore"):
                    rms = np.sqrt(scores["square"][:, i] / scores["count"])
                curves[name] = Curve(_spread(shown, rms), _color(shown.study, name), name)
        if found.bound is not None:
            curves["bound"] = Curve(
                _spread(shown, np.sqrt(found.bound[:, i])), colors.BOUND, "bound", width=1.0
            )
        plots[group.name] = Plot(
            f"log10 rms of {shown.study.runs} runs: {group.name}, {group.unit}", curves, log=True
        )
    return plots


def _spread(shown: Showcase, values: Array) -> Array:
    """Values of scored epochs, at the recording's epochs; nan between."""
    out = np.full(len(shown.times), np.nan)
    out[np.unique([*range(0, len(out), shown.study.every), len(out) - 1])] = values
    return out


def _about(study: Study, outcome: Outcome) -> str:
    """What one sees."""
    lines = [
        f"# {study.title}",
        f"{study.runs} runs of `{name_of(study.paper)}`, seed {study.seed}.",
        "",
    ]
    for row in outcome.rows:
        for name, unit in row.groups:
            found = row.accuracy(name)
            if found is not None:
                lines.append(
                    f"- **{row.filter}** {name}: rms {found.rms:.3g} {unit}, takes itself for {found.sigma:.3g}"
                )
        if row.failed:
            lines.append(f"- **{row.filter}**: {row.failed} runs failed")
    return "\n".join(lines)
