"""A mission's first run, filter by filter: errors within three deviations, drawn and recorded."""

from __future__ import annotations

import contextlib
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.campaign import Outcome
from celnav.campaign.figures import PALETTE
from celnav.campaign.missions import Study
from celnav.campaign.units import STUDY
from celnav.gaussian.linalg import Array
from celnav.models.earth import SEMI_MAJOR_M
from celnav.papers import load
from celnav.show import colors
from celnav.show.figures import figure
from celnav.study.montecarlo import generator
from celnav.study.trial import Followed, Group, Trial, follow

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Showcase(NamedTuple):
    """The first run: ``truth (K, 3)`` km at the judged epochs, None where the state is no orbit; what each filter made of it; the
    ``components`` that are shown, and their ``scale``."""

    study: Study
    groups: tuple[Group, ...]
    truth: Array | None
    filters: dict[str, Followed]
    components: Array
    scale: Array

    @property
    def times(self) -> Array:
        """The judged epochs ``(K,)`` s."""
        return next(iter(self.filters.values())).times

    def error(self, name: str) -> Array:
        """Of a filter, ``(K, components)`` in the units of the groups."""
        return np.asarray(self.filters[name].error[:, 0, self.components] * self.scale)

    def std(self, name: str) -> Array:
        """What a filter takes for the deviations of `error`."""
        return np.asarray(self.filters[name].std[:, 0, self.components] * self.scale)


def showcase(study: Study) -> Showcase | None:
    """Follow the first run of a mission with the filters that can; None if it cannot be simulated, or no filter can."""
    filters: dict[str, Followed] = {}
    with contextlib.suppress(Exception):  # what went wrong is among the reasons in the table
        trial: Trial = load(study.paper).trial(study.configurations[0].config, [generator(study.seed, STUDY, 0)])
        for name in study.filters:
            with contextlib.suppress(Exception):
                filters[name] = follow(trial, name)
    if not filters:
        return None
    truth = None
    if trial.place is not None:
        epochs = trial.epochs(next(iter(filters)))
        truth = np.stack([trial.place(epoch.truth)[0] for epoch in epochs if epoch.truth is not None])
    components = np.concatenate([np.arange(g.part.start, g.part.stop) for g in trial.groups])
    scale = np.concatenate([np.broadcast_to(g.scale, g.part.stop - g.part.start) for g in trial.groups])
    return Showcase(study, trial.groups, truth, filters, components, scale)


def _parts(groups: tuple[Group, ...]) -> list[slice]:
    """Where the groups lie in the components that are shown."""
    ends = np.cumsum([g.part.stop - g.part.start for g in groups]).tolist()
    return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


def errors(shown: Showcase) -> Figure:
    """Errors of the first run, a row for each group and a column for each filter."""
    names = list(shown.filters)
    fig, axes = figure(max(5.0, 2.6 * len(names)), 2.0 * len(shown.groups) + 0.4, len(shown.groups), len(names), squeeze=False,
                       sharex=True, sharey="row")  # fmt: skip
    late = slice(len(shown.times) // 4, None)
    for row, group, part in zip(axes, shown.groups, _parts(shown.groups), strict=True):
        for ax, name in zip(row, names, strict=True):
            error, reach = shown.error(name)[:, part], 3.0 * shown.std(name)[:, part].max(1)
            ax.plot(shown.times, reach, color=colors.SIGMA, linewidth=0.8, label="±3σ, the largest of them")
            ax.plot(shown.times, -reach, color=colors.SIGMA, linewidth=0.8)
            for i, component in enumerate(error.T):
                ax.plot(shown.times, component, color=PALETTE[i % 6], linewidth=0.8, label=f"component {i + 1}")
        row[0].set_ylabel(f"{group.name} error ({group.unit})")
        seen = [np.abs([shown.error(name)[late, part], 3.0 * shown.std(name)[late, part]]) for name in names]
        top = 1.2 * float(np.nanmax(seen, initial=0.0))
        if top > 0.0:
            row[0].set_ylim(-top, top)
    for ax, name in zip(axes[0], names, strict=True):
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
    from celnav.show import recording, views

    times, study = shown.times, shown.study
    palette = {name: PALETTE[i % 6] for i, name in enumerate(study.filters)}
    plots = [views.plot(f"rms/{g.name}", f"{g.name}: rms of {study.runs} runs, log10 of {g.unit}", times) for g in shown.groups]
    tabs = [
        views.rows(
            *(views.plot(f"first/{f}/{g.name}", f"{f}: {g.name} of the first run, {g.unit}", times) for g in shown.groups), name=f
        )
        for f in shown.filters
    ]
    left: list[Any] = [views.text("info", "about"), views.plot("nees", "NEES over its dimension, first run, log10", times)]
    if shown.truth is not None:
        reach = float(np.abs(shown.truth).max())
        eye = reach * np.array([2.2, -1.8, 1.4])
        left.insert(0, views.space("orbit", "orbit, km", eye=eye, growing={"orbit/truth": np.inf}))
    layout = views.columns(views.rows(*left), views.tabs(views.rows(*plots, name="all runs"), *tabs), shares=(2, 3))
    facts = {"paper": study.paper, "runs": study.runs, "seed": study.seed, "filters": ", ".join(study.filters)}
    with recording.recording(path, times, name=f"mission {study.title}", layout=layout, properties=facts) as out:
        out.text("info", _about(study, outcome))
        if shown.truth is not None:
            out.globe("orbit/earth", 1e-3 * SEMI_MAJOR_M)
            out.trail("orbit/truth", shown.truth, colors.TRUTH)
            out.points("orbit/here", shown.truth, colors.TRUTH, radius=6.0, label="satellite")
        for name, found in shown.filters.items():
            for group, part in zip(shown.groups, _parts(shown.groups), strict=True):
                for i, component in enumerate(shown.error(name)[:, part].T):
                    out.curve(f"first/{name}/{group.name}/{i + 1}", component, PALETTE[i % 6], f"component {i + 1}")
                out.bounds(f"first/{name}/{group.name}/sigma", shown.std(name)[:, part].max(1), "largest")
            out.log_curve(f"nees/{name}", found.nees[:, 0] / found.error.shape[-1], palette[name], name)
        _rms(out, shown, outcome, palette)


def _rms(out: Any, shown: Showcase, outcome: Outcome, palette: dict[str, str]) -> None:
    """Errors of all runs, at the epochs that were scored."""
    found = outcome.first[0][1]
    for i, group in enumerate(shown.groups):
        for name, scores in found.scores.items():
            if scores is not None:
                with np.errstate(invalid="ignore", divide="ignore"):
                    rms = np.sqrt(scores["square"][:, i] / scores["count"])
                out.log_curve(f"rms/{group.name}/{name}", _spread(shown, rms), palette[name], name)
        if found.bound is not None:
            bound = _spread(shown, np.sqrt(found.bound[:, i]))
            out.log_curve(f"rms/{group.name}/bound", bound, colors.BOUND, "bound", width=1.0)


def _spread(shown: Showcase, values: Array) -> Array:
    """Values of scored epochs, at the recording's epochs; nan between."""
    out = np.full(len(shown.times), np.nan)
    out[np.unique([*range(0, len(out), shown.study.every), len(out) - 1])] = values
    return out


def _about(study: Study, outcome: Outcome) -> str:
    """What one sees."""
    lines = [f"# {study.title}", f"{study.runs} runs of `{study.paper}`, seed {study.seed}.", ""]
    for row in outcome.rows:
        for name, unit in row.groups:
            found = row.accuracy(name)
            if found is not None:
                lines.append(f"- **{row.filter}** {name}: rms {found.rms:.3g} {unit}, takes itself for {found.sigma:.3g}")
        if row.failed:
            lines.append(f"- **{row.filter}**: {row.failed} runs failed")
    return "\n".join(lines)
