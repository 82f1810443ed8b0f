"""A radar measures range and bearing of a vehicle. Is an extended Kalman filter overconfident?

celnav reproduce study.py   runs this study and writes out/index.html"""

from dataclasses import dataclass

import numpy as np

import celnav

TITLE = "A vehicle by range and bearing"
GROUPS = (celnav.Group("position", "m", slice(0, 2)), celnav.Group("velocity", "m/s", slice(2, 4)))


@dataclass(frozen=True)
class Config(celnav.study.Timed):
    runs: int = celnav.study.param(400, "chosen", "Monte-Carlo runs", least=2)
    steps: int = celnav.study.param(60, "chosen", "measurements, 1 s apart", least=1)
    bearing_deg: float = celnav.study.param(3.0, "chosen", "σ of a bearing", above=0.0)

    @property
    def times(self):
        return np.arange(self.steps + 1.0)


def problem(config):  # a state is east and north (m), then their rates (m/s)
    def h(x, epoch):  # x (..., 4)
        return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)

    R = np.diag([1.0, np.radians(config.bearing_deg)]) ** 2
    radar = celnav.Sensor(h, R, space=celnav.angles([1]))
    prior = celnav.Gaussian([1000.0, 0.0, -5.0, 10.0], np.diag([100.0, 100.0, 5.0, 5.0]) ** 2)
    motion = celnav.models.motion.constant_velocity(2, q=0.1)
    return celnav.Problem(motion, radar, prior, config.times, groups=GROUPS)


def filters(config):
    models = problem(config).motion, problem(config).sensor
    return {"ekf": celnav.ekf(*models), "ukf": celnav.ukf(*models)}


def trial(config, rngs):  # truth and measurements, a run with each random generator
    return problem(config).trial(filters(config), rngs)


def figure(results):
    lines = {"ekf": celnav.show.Line("EKF", "blue"), "ukf": celnav.show.Line("UKF", "orange")}
    nees = celnav.show.figures.consistency(results, "usual", lines, "nees", 4)
    return celnav.show.panels(celnav.show.Panel("", [nees], "time (s)", "NEES", "y"), height=2.5)


PRESETS = {"usual": Config()}
PARTS = {"usual": celnav.study.monte_carlo(trial, ("ekf", "ukf"), Config(), runs=Config.runs)}
FIGURES = {"figure_01": ("Mean NEES, and the 95 % band of a consistent filter.", figure)}
# The range that is accepted is written down before the number is known.
NEES = celnav.study.numbers.consistency("NEES", ("usual", "ekf"), (4.0, None), at=slice(1, None))
WHY = "The NEES of a consistent filter of four states is 4 in the mean."
ROW = celnav.study.statement("overconfident", "An EKF is overconfident.", NEES, why=WHY)
STUDY = celnav.study.Study("study", GROUPS, trial, lambda effort: PARTS, [ROW], figure="figure_01")
