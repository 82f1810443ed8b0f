"""A mission's first run, filter by filter: errors with bounds at 3σ, drawn and recorded."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from celnav.campaign import CampaignResult
from celnav.campaign.missions import MissionStudy
from celnav.campaign.scores import column
from celnav.campaign.units import STUDY
from celnav.gaussian.linalg import Array
from celnav.models.earth import SEMI_MAJOR_M
from celnav.papers import load
from celnav.papers.own import name_of
from celnav.show import colors, scenes, showcase
from celnav.show.draw import Item, Line, Panel, components, curve, look, panels
from celnav.show.estimates import Estimate
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import SceneView, Showcase
from celnav.study.montecarlo import generator
from celnav.study.trial import Evaluation, Trial, evaluate_filter

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.show.recording import Recorder

BOUNDS = Line("±3σ, the largest of them", colors.SIGMA, width=0.8)


def first_run(study: MissionStudy) -> Showcase | None:
    """The first run of a mission with all filters that do not fail; None if all fail, or if the run
    cannot be simulated.
    """
    filters: dict[str, Evaluation] = {}
    with contextlib.suppress(Exception):  # the table has the error among its reasons
        config = study.configurations[0].config
        trial: Trial = load(study.paper).trial(config, [generator(study.seed, STUDY, 0)])
        for name in study.filters:
            with contextlib.suppress(Exception):
                filters[name] = evaluate_filter(trial, name)
    if not filters:
        return None
    some, run = next(iter(filters.items()))
    orbit = None
    if trial.place is not None:
        truths = [epoch.truth for epoch in trial.epochs(some) if epoch.truth is not None]
        orbit = np.stack([trial.place(truth)[0] for truth in truths])
    return Showcase(
        f"mission {study.title}",
        "",
        run.times,
        {
            name: Estimate(name, color, f.error, f.std[:, 0] ** 2, f.nees[:, 0])
            for name, color in _shades(study).items()
            if (f := filters.get(name)) is not None
        },
        trial.groups,
        truth=orbit,
    )


def _shades(study: MissionStudy) -> dict[str, str]:
    return {name: look(i)["color"] for i, name in enumerate(study.filters)}


def errors(shown: Showcase) -> Figure:
    """Figure of the first run's errors: a row for each group, a column for each filter."""
    rows: list[list[Panel]] = []
    late = slice(len(shown.times) // 4, None)
    for group in shown.groups:
        every, top = [], 0.0
        for name, estimate in shown.estimates.items():
            error = estimate.error(group)[:, 0]
            reach = 3.0 * np.asarray(estimate.sigma(group)).max(1)
            items: list[Item] = [
                curve(shown.times, reach, BOUNDS),
                curve(shown.times, -reach, BOUNDS, label=None),
            ]
            labels = [f"component {i + 1}" for i in range(error.shape[1])]
            shades = [look(i)["color"] for i in range(error.shape[1])]
            items += components(shown.times, error, labels, shades, linewidth=0.8)
            every.append((name if not rows else "", items))
            magnitudes = np.abs([*error[late].T, reach[late]])
            top = max(top, 1.2 * float(np.nanmax(magnitudes, initial=0.0)))
        more = {"ylim": (-top, top)} if top > 0.0 else {}
        label = f"{group.name} error ({group.unit})"
        rows.append([Panel(title, items, "time (s)", label, more=more) for title, items in every])
    return panels(
        *rows,
        height=2.0,
        title="Errors of the first run (axes cut off before the first quarter is over)",
        sharex=True,
        sharey="row",
    )


def record(shown: Showcase, outcome: CampaignResult, path: str | PathLike[str]) -> None:
    """Record the first run, and the rms of all runs. Needs rerun.

    Raises
    ------
    OSError: if ``path`` cannot be written. ValueError: if it is a file that celnav did not make.
    """
    study, orbit, spaces = outcome.study, shown.truth, []
    if orbit is not None:
        eye = float(np.abs(orbit).max()) * np.array([2.2, -1.8, 1.4])
        spaces = [SceneView("orbit", "orbit, km", eye, growing=["orbit/satellite/trail"])]

    def scene(out: Recorder) -> None:
        if orbit is not None:
            out.globe("orbit/earth", 1e-3 * SEMI_MAJOR_M)
            scenes.track(out, "orbit/satellite", orbit, colors.TRUTH, "satellite")

    facts = {
        "paper": name_of(study.paper),
        "runs": study.runs,
        "seed": study.seed,
        "filters": ", ".join(study.filters),
    }
    plots = {"all runs": _rms(shown, outcome)}
    run = replace(shown, notes=_notes(outcome), truth=None, scene=scene, spaces=spaces)
    showcase.record(replace(run, plots=plots, facts=facts), path)


def _rms(shown: Showcase, outcome: CampaignResult) -> dict[str, Plot]:
    """Plots of the RMS errors of all runs at the scored epochs, by group."""
    study, scored, plots = outcome.study, outcome.first[0][1], {}

    def spread(values: Array) -> Array:
        """Values of scored epochs on the epochs of the recording; nan at the others."""
        out = np.full(len(shown.times), np.nan)
        out[np.unique([*range(0, len(out), study.every), len(out) - 1])] = values
        return out

    for i, group in enumerate(shown.groups):
        curves = {}
        for name, scores in scored.scores.items():
            with np.errstate(invalid="ignore", divide="ignore"):
                rms = np.sqrt(scores["square"][:, i] / scores["count"])
            curves[name] = Curve(spread(rms), _shades(study)[name], name)
        if scored.bound is not None:
            bound = spread(np.sqrt(scored.bound[:, i]))
            curves["bound"] = Curve(bound, colors.BOUND, "bound", width=1.0)
        title = f"RMS of {study.runs} runs: {group.name}, {group.unit}{showcase.LOG}"
        plots[group.name] = Plot(title, curves, log=True)
    return plots


def _notes(outcome: CampaignResult) -> str:
    """The text beside the recording."""
    study = outcome.study
    first = f"{study.runs} runs of `{name_of(study.paper)}`, seed {study.seed}."
    lines = [f"# {study.title}", first, ""]
    for row in outcome.rows:
        filter = f"- **{row['filter']}**"
        for name, unit in outcome.groups if row["runs"] else ():
            rms, sigma = (row[column(name, statistic, unit)] for statistic in ("rms", "sigma"))
            lines.append(f"{filter} {name}: rms error {rms:.3g} {unit}, predicted {sigma:.3g}")
        if row["failed"]:
            lines.append(f"{filter}: {row['failed']} runs failed")
    return "\n".join(lines)
