"""The recording of the year: how the filters follow an ephemeris error along three trends."""

from __future__ import annotations

import numpy as np

from celnav.papers.tstdkf.evidence import AXES
from celnav.papers.tstdkf.figures import COLORS
from celnav.papers.tstdkf.study import Result
from celnav.papers.tstdkf.year import TRENDS
from celnav.show import colors
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import Showcase

TRACKED = {"tkf": "TKF", "C": "TSTDKF, form C", "B": "TSTDKF, form B", "aug": "AUG"}


def year(result: Result) -> Showcase:
    """The first run of each trend: plots alone."""
    data = result.data["year"]
    rows, runs = slice(None, None, 6 if len(data["times"]) > 120 else 1), data["bias"].shape[1] // len(TRENDS)
    plots: dict[str, dict[str, Plot]] = {}
    for k, trend in enumerate(TRENDS):
        place = {key: Curve(np.sqrt(data[f"{key}/position"][rows, k * runs]), COLORS[key], TRACKED[key]) for key in TRACKED}
        row = plots.setdefault(trend, {})
        for i, axis in enumerate(AXES):
            tracks = {key: Curve(data[f"{key}/bias"][rows, k * runs, i], COLORS[key], TRACKED[key]) for key in TRACKED}
            tracks["truth"] = Curve(data["bias"][rows, k * runs, i], colors.TRUTH, "truth")
            row[axis] = Plot(f"{trend}: ephemeris error {axis}, km", tracks, limits=(-0.4, 0.4))
        row["position"] = Plot(f"{trend}: position error, km", place)
    facts, legend = {"paper": "tstdkf", "seed": result.seed, "runs": result.runs}, {COLORS[key]: TRACKED[key] for key in TRACKED}
    return Showcase("tstdkf year", NOTES, data["times"][rows, 0], plots=plots, legend=legend, facts=facts, counter="step")


NOTES = """# A year of three trends

The ephemeris error on three axes along a sine, a growing and a triangular trend. The two-stage filter (TKF) takes it for constant
and does not follow. Strong tracking follows in form B, hardly in form C. The exact filter (AUG), told of a random walk, follows
best. Position errors are the rms of an hour. Computed by the linear driver.
"""
