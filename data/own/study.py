"""A radar sees a vehicle: its range well, its bearing poorly. Do filters know how little they know? Change what you like.

celnav reproduce study.py --effort 0.1   does a tenth of the runs and writes out/index.html; without --effort all of them
celnav list study.py                     parameters, which a mission (paper = "study.py") may change and sweep
"""

from dataclasses import dataclass

import numpy as np

import celnav
from celnav.models.motion import constant_velocity
from celnav.show import colors, figures
from celnav.show.draw import Line, Panel, panels
from celnav.study import numbers
from celnav.study.ledger import Sentence, statement
from celnav.study.parameters import Timed, param
from celnav.study.study import Part, Study, evaluate_filters
from celnav.study.trial import trial_from_arrays

TITLE = "A vehicle by range and bearing"
GROUPS = (celnav.Group("position", "m", slice(0, 2)), celnav.Group("velocity", "m/s", slice(2, 4)))  # what is judged


@dataclass(frozen=True)
class Config(Timed):
    """Parameters, with units in their names; param: the default, its source, its meaning, its bounds."""

    steps: int = param(60, "chosen", "measurements after the first, 1 s apart", least=1)
    runs: int = param(400, "chosen", "of a Monte Carlo", least=2)
    range_m: float = param(1.0, "chosen", "deviation of a range", above=0.0)
    bearing_deg: float = param(3.0, "chosen", "deviation of a bearing", above=0.0)

    @property
    def times(self):
        return np.arange(self.steps + 1.0)


def believed(c):
    """Motion, sensor and start, of which filters are made; states are [east, north] and their rates, in m and m/s."""
    h = lambda x, epoch: np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)  # noqa: E731
    radar = celnav.Sensor(h, np.diag([c.range_m, np.radians(c.bearing_deg)]) ** 2, space=celnav.angles([1]))
    start = celnav.Gaussian([1000.0, 0.0, -5.0, 10.0], np.diag([100.0, 100.0, 5.0, 5.0]) ** 2)
    return constant_velocity(2, q=0.1), radar, start


def filters(c):
    motion, radar, _ = believed(c)
    return {"ekf": celnav.ekf(motion, radar), "ukf": celnav.ukf(motion, radar)}


def simulate(c, rngs):
    """A run for each generator: truth (T, runs, 4), measurements (T, runs, 2). What is believed happens; yours may differ."""
    return celnav.simulate(*believed(c), c.times, runs=rngs)


def trial(c, rngs):
    """Filters on what is simulated, and how they are judged."""
    truth, z = simulate(c, rngs)
    return trial_from_arrays(GROUPS, filters(c), believed(c)[2], c.times, z, truth)


def evaluate(c, rngs):
    """What a process does: all filters on some of the runs."""
    return evaluate_filters(trial(c, rngs), list(filters(c)))


def figure(r):
    """Errors and consistency over time; r: results."""
    left = [figures.rmse(r, "usual", name, line, "position") for name, line in LINES.items()]
    right = [figures.consistency(r, "usual", LINES, "nees", 4)]
    return panels([Panel("", left, "time (s)", "RMSE of position (m)"), Panel("", right, "time (s)", "NEES", "y")], size=(7, 3))


PRESETS = {"usual": Config()}
PARTS = {name: Part(evaluate, c, runs=c.runs) for name, c in PRESETS.items()}
LINES = {"ekf": Line("EKF", colors.COMPARISON), "ukf": Line("UKF", colors.ESTIMATE)}
FIGURES = {"figure_01": ("Position error of the runs, and their mean NEES with the 95 % band of a consistent filter.", figure)}
NEES = numbers.consistency("NEES", ("usual", "ekf"), accept=(4.0, None), at=slice(1, None))
WHY = "that of a consistent filter with four states is 4"
CLAIM = statement("claims", "An extended filter is overconfident.", NEES, why=WHY, found="Mean NEES {0}.", figure="figure_01")
FOUND = [Sentence("It does, until later bearings have settled the position.", {"claims": "reproduced"})]
STUDY = Study("study", GROUPS, trial, lambda effort: PARTS, [CLAIM], "An EKF takes an arc for a line.", FOUND, "figure_01")
