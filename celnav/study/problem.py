"""Problems (a model, and runs drawn from it) and a comparison of filters on them.

Truth and measurements are drawn from the model that the filters use, except for outliers and
correlated noise. So a filter can be consistent, and its accuracy can be compared with a bound.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from celnav.analysis.metrics import bootstrap, rms
from celnav.filters.colored import colored
from celnav.filters.joint import evaluate
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Epochs, Filter, as_seconds, epochs
from celnav.filters.run import steps
from celnav.filters.sequential import sigma_point
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import finite, function, instance, integer, number
from celnav.gaussian.linalg import Array, matvec
from celnav.gaussian.rules import Taylor
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.lazy import LazyModule
from celnav.study.montecarlo import generator, normals
from celnav.study.trial import (
    Group,
    Noiseless,
    Trial,
    bound,
    check_groups,
    evaluate_filter,
    squares,
    trial_from_arrays,
)

__all__ = ["WILD", "Problem", "compare"]

special = LazyModule("scipy.special")
WILD = 10.0  # factor of an outlier's noise
PASSES = 3  # number of timing measurements at most, of which the smallest is reported
ENOUGH_S = 0.5  # no further measurement after so many seconds


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem whose runs are drawn from the filters' model: a motion, a sensor and a prior.

    motion, sensor: models with additive noise, constant or a function of mean and epoch.
    prior: initial belief, mean ``(N,)`` and covariance ``(n, n)``.
    times: ``(T,)`` s, increasing.
    u: T - 1 inputs ``epoch.u``; ``u[k]`` acts from ``times[k]`` to ``times[k + 1]``.
    phi: correlation of successive noise samples of the measurement, in [0, 1): an AR(1) process.
    outliers: fraction of the components, in [0, 1), whose noise is `WILD` times as large. The
        filters do not model them.
    groups: components to evaluate, by name; one group of all components if empty.

    >>> problem = Problem(motion, sensor, prior, np.arange(601.0), outliers=0.05)
    """

    motion: Motion
    sensor: Sensor
    prior: Gaussian
    times: Array
    u: Array | None = None
    _: KW_ONLY
    phi: float = 0.0
    outliers: float = 0.0
    groups: Sequence[Group] = ()

    def __post_init__(self) -> None:
        instance("motion", self.motion, Motion, "celnav.Motion(f, Q)")
        instance("sensor", self.sensor, Sensor, "celnav.Sensor(h, R)")
        prior = instance("prior", self.prior, Gaussian, "celnav.Gaussian(mean, cov)")
        vectors = self.motion.space == EUCLIDEAN
        if prior.mean.ndim != 1 or prior.cov.ndim != 2 or (vectors and len(prior.mean) != self.n):
            raise ValueError(
                f"prior: expected one mean (N,) and covariance (n, n), got {prior.mean.shape} and "
                f"{prior.cov.shape}"
            )
        for name in ("phi", "outliers"):
            number(name, getattr(self, name), 0.0, below=1.0)
        object.__setattr__(self, "times", finite("times", as_seconds(self.times)))
        if self.times.ndim != 1 or len(self.times) < 2 or not (np.diff(self.times) > 0.0).all():
            raise ValueError(
                f"times: expected two or more increasing numbers, got shape {self.times.shape}"
            )
        check_groups(self.groups, self.n)
        if self.motion.augment or self.sensor.augment:
            raise ValueError(
                "augment: expected models with additive noise (Q, R), got augmented noise"
            )
        noise = zip(("prior, Q", "R"), self._noise(), (self.n, self.m), strict=True)
        for name, columns, rows in noise:
            if columns.ndim != 2 or len(columns) != rows:
                raise ValueError(
                    f"{name}: expected a covariance ({rows}, {rows}) that all runs share, got "
                    f"{(*columns.shape[:-1], columns.shape[-2])}"
                )

    @property
    def n(self) -> int:
        """Dimension n of the state's differences."""
        return len(self.prior.cov)

    @cached_property
    def m(self) -> int:
        """Dimension m of the measurement's differences."""
        if self.sensor.m is not None:
            return self.sensor.m
        z = _image(self.sensor, self.prior.mean[None], self.epochs[1])
        return int(self.sensor.space.minus(z, z).shape[-1])

    @property
    def epochs(self) -> Epochs:
        """`Epochs` with inputs, without measurements."""
        return epochs(self.times, u=self.u)

    def _noise(self) -> tuple[Any, Any]:
        """Noise columns at the second epoch: process ``(n, r)``, measurement ``(m, s)``."""
        mean, epoch = self.prior.mean, self.epochs[1]
        return self.motion.columns(mean, epoch, self.n), self.sensor.columns(mean, epoch, self.m)

    def draw(self, rngs: Sequence[np.random.Generator]) -> tuple[Array, Array]:
        """Truth ``(T, runs, N)`` and measurements ``(T, runs, M)``, one run for each generator."""
        T, space, (W, V) = len(self.times), self.motion.space, self._noise()
        start, walk, noise, lot = normals(
            rngs, (self.n,), (T, W.shape[1]), (T, V.shape[1]), (T, self.m)
        )
        factor = np.where(
            np.abs(lot) > (special.ndtri(1.0 - 0.5 * self.outliers) if self.outliers else np.inf),
            WILD,
            1.0,
        )
        x = space.plus(np.tile(self.prior.mean, (len(start), 1)), start @ self.prior.sqrt_cov.T)
        truth, z, v = [], [], np.zeros(self.m)
        for k, epoch in enumerate(self.epochs):
            if k:
                W = self.motion.columns(x, epoch, self.n)
                x = space.plus(_image(self.motion, x, epoch), matvec(W, walk[k]))
            fresh = matvec(self.sensor.columns(x, epoch, self.m), noise[k])
            v = self.phi * v + np.sqrt(1.0 - self.phi**2) * fresh if k else fresh
            truth.append(x)
            z.append(self.sensor.space.plus(_image(self.sensor, x, epoch, self.m), factor[k] * v))
        return np.stack(truth), np.stack(z)

    def trial(
        self,
        filters: Mapping[str, Filter],
        rngs: Sequence[np.random.Generator],
        reference: str = "",
    ) -> Trial:
        """A `Trial` of filters by name on drawn runs; ``reference``: see
        `celnav.study.trial.Trial`.
        """
        truth, z = self.draw(rngs)
        groups = tuple(self.groups) or (Group("state", "", slice(0, self.n)),)
        more: dict[str, Any] = {"u": self.u, "space": self.motion.space, "reference": reference}
        return trial_from_arrays(groups, filters, self.prior, self.times, z, truth, **more)


def _image(model: Motion | Sensor, x: Array, epoch: Epoch, m: int | None = None) -> Array:
    y = evaluate(model, x[None].copy(), epoch, m=m)[0]
    if not np.isfinite(y).all():
        raise ValueError(f"{model.name}: expected finite numbers, got others at t = {epoch.t}")
    return np.asarray(y)


class Comparison(NamedTuple):
    """Accuracy, consistency and cost of a filter on a problem.

    problem, filter: names.
    rms: RMS error of the first group over the second half of the epochs; rms_low, rms_high: its
        95 % interval.
    efficiency: the linearized posterior Cramer-Rao bound divided by ``rms``, about 1 for an optimal
        filter; nan if there is no bound. It may exceed 1 slightly by chance, or if process noise
        moves the runs away from the run at which the bound is linearized.
    anees, low, high: NEES divided by the dimension, 1 if consistent, and its 95 % interval. All
        intervals come from the differences between runs.
    lost: number of runs without an estimate.
    us_per_step: CPU time per step and run, microseconds, the least of up to `PASSES` measurements.
    """

    problem: str
    filter: str
    rms: float
    rms_low: float
    rms_high: float
    efficiency: float
    anees: float
    low: float
    high: float
    lost: int
    us_per_step: float


def compare(
    problems: Mapping[str, Problem],
    filters: Mapping[str, Callable[[Problem], Filter | None]],
    *,
    runs: int = 200,
    seed: int = 0,
) -> list[Comparison]:
    """A list with a `Comparison` for each problem and filter, all with the same noise.

    problems: by name.
    filters: by name, functions of a problem that return a filter, or None if the filter does not
        apply.
    runs: number of runs of each problem. seed: run r uses the generator of ``(seed, 0, r)``.

    >>> filters = {"UKF": lambda p: celnav.ukf(p.motion, p.sensor)}
    >>> filters["EKF"] = lambda p: celnav.ekf(p.motion, p.sensor)
    >>> pandas.DataFrame(compare({"falling body": problem}, filters))
    """
    runs = integer("runs", runs)
    example = "functions by name, such as {'UKF': lambda p: celnav.ukf(p.motion, p.sensor)}"
    for make in instance("filters", filters, Mapping, example).values():
        function("filters", make, "(problem)")
    rows = []
    example = "problems by name, such as {'turn': problem}"
    for name, problem in instance("problems", problems, Mapping, example).items():
        instance("problems", problem, Problem, "each a Problem(motion, sensor, prior, times)")
        made = {
            key: filter for key, make in filters.items() if (filter := make(problem)) is not None
        }
        trial = problem.trial(made, [generator(seed, 0, run) for run in range(runs)])
        least = _bound(problem)
        for key, filter in made.items():
            run = evaluate_filter(trial, key)
            half, n = len(run.times) // 2, run.error.shape[-1]
            sound = np.isfinite(run.nees[half:]).all(0)
            square = squares(trial.groups[:1], run.error)[half:, sound, 0].mean(0)
            efficiency = np.nan
            if least is not None:
                efficiency = float(np.sqrt(least[half:, 0].mean() / square.mean()))
            accuracy = _interval(rms, square)
            anees = _interval(np.mean, run.nees[half:, sound].mean(0) / n)
            us = 1e6 * _seconds(filter, trial, key) / (runs * len(problem.times))
            lost = int((~sound).sum())
            rows.append(Comparison(name, key, *accuracy, efficiency, *anees, lost, us))
    return rows


def _seconds(filter: Filter, trial: Trial, name: str) -> float:
    """CPU seconds of a filter for all runs, without evaluation: the minimum of `PASSES`, or of
    fewer that together take `ENOUGH_S`.
    """
    passes = list[float]()
    while len(passes) < PASSES and sum(passes) < ENOUGH_S:
        start = process_time()
        deque(steps(filter, trial.prior, trial.epochs(name)), 0)
        passes.append(process_time() - start)
    return min(passes)


def _interval(statistic: Callable[[Array], Any], samples: Array) -> tuple[float, float, float]:
    """A statistic of runs, and its interval; nan for too few runs."""
    value = float(statistic(samples)) if len(samples) else np.nan
    return value, *(bootstrap(statistic, samples) if len(samples) > 1 else (np.nan, np.nan))


def _bound(problem: Problem) -> Array | None:
    """`bound` along the undisturbed run, from the filter that models the correlation of the noise.

    None for correlated noise on curved spaces. Outliers are ignored.
    """
    if problem.phi == 0.0:
        best: Filter = sigma_point(problem.motion, problem.sensor, rule=Taylor())
    elif problem.motion.space == problem.sensor.space == EUCLIDEAN:
        best = colored(
            problem.motion,
            problem.sensor,
            problem.phi * np.eye(problem.m),
            rule=Taylor(),
        )
    else:
        return None
    undisturbed: Sequence[Any] = [Noiseless()]
    return bound(problem.trial({"best": best}, undisturbed, "best"))
