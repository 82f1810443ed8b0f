"""[Xu2024]: a satellite of the Earth that times three pulsars, with colored noise and an error of the Earth's ephemeris.

The display equations of the text at hand are lost; what was inferred is

=============  ======================================================  ===========================================
equation       content                                                 here
=============  ======================================================  ===========================================
2              delay of a pulse                                        `celnav.models.pulsar.Timing`
3-4            orbit and its derivatives                               `celnav.models.orbit`
17, 69, 70     ephemeris error                                         `Config.bias`
19             deviation of a timing                                   `celnav.models.pulsar.Pulsar.timing_std`
21-56          colored, correlated noise; differencing                 `celnav.papers.tstdkf.method.Differenced`
57-61          strong tracking                                         `celnav.papers.tstdkf.method.strong_tracking`
(Friedland)    two stages                                              `celnav.filters.two_stage`
=============  ======================================================  ===========================================

Several configurations are flown side by side, as *cases* on the same random numbers: what a step costs is mostly what its first
run costs. They share times, orbit and pulsars; the runs of one case lie after those of another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.model import Linear, Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions, State
from celnav.filters.sequential import Sequential, ekf
from celnav.filters.two_stage import Plain, TwoStage
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, block, cholesky, matvec, side_by_side
from celnav.models import orbit
from celnav.models.ephemeris import GM, Tdb, de421, from_utc
from celnav.models.orbit import NODES, Extra, Flow, advance, flow, third_body
from celnav.models.pulsar import LIGHT_KM_S, Timing, pulsars
from celnav.papers.tstdkf.method import Differenced, Noise, ar1_noise, excess, proportional, strong_tracking
from celnav.study.montecarlo import normals, steps
from celnav.study.parameters import Parameters, param
from celnav.study.trial import Group, Trial

TITLE = "Two-stage strong-tracking differential Kalman filter for X-ray pulsars"
CITATION = """\
@article{Xu2024,
  author  = {Xu, Q. and Cui, H. and Ding, B. and Zhao, A. and Zhao, Y.},
  title   = {Two-stage strong-tracking differential {Kalman} filter for {X}-ray pulsar navigation considering coloured noise},
  year    = {2024},
  note    = {in Chinese; the text available has lost its display equations and the bodies of its tables}
}"""
YEAR_S, DAY_S = 365.25 * 86400.0, 86400.0
KAPPA = 4.8
TUNED = "chosen: with the other tuned one, so that setting 1 gives the paper's percentages of position"


# -- parameters --------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setting(Parameters):
    """One row of Table 4."""

    F: float = param(0.5, "chosen", "color of the measurement noise, V' = F V + increment, which is as large as pulsars are timed")
    L: float = param(0.5, "chosen", "color of the process noise, likewise")
    kappa: float = param(KAPPA, TUNED, "how strongly the increments of both are correlated")


SETTINGS = {1: Setting(), 2: Setting(kappa=0.0), 3: Setting(0.5, 0.0, 0.0), 4: Setting(0.0, 0.5, 0.0), 5: Setting(0.0, 0.0, 0.0)}
"""Table 4, as inferred: everything, ..., all noise white."""


@dataclass(frozen=True)
class Config(Parameters):
    """Everything that a run depends on."""

    start_utc: str = param("2015-10-17T04:00:00", "paper", "date and time of the start, UTC")
    step_s: float = param(300.0, "paper", "interval of the measurements, over which pulses are timed", above=0.0)
    days: float = param(30.0, "paper", "length of a run, days", above=0.0)
    runs: int = param(50, "paper", "of a Monte Carlo", least=1)
    pulsars: tuple[str, ...] = param(("B0531+21", "B1821-24", "B1937+21"), "paper", "names of the three that are timed")
    elements: tuple[float, ...] = param(
        (7136.635, 1.809e-3, 65.0, 30.0, 30.0, 0.0), "chosen: common in this literature",
        "of the orbit: semi-major axis (km), eccentricity, inclination, node, perigee and true anomaly (deg)",
    )  # fmt: skip
    error_km: tuple[float, ...] = param((1.0,) * 3, "paper", "of the position at the start, each axis, and in the prior", above=0.0)
    error_m_per_s: tuple[float, ...] = param((0.02,) * 3, "paper", "the same of the velocity", above=0.0)
    rate_noise_km_per_s: float = param(1e-8, "paper: unit inferred", "process noise of the position's rate, each axis", above=0.0)
    acceleration_noise_km_per_s2: float = param(1e-10, "paper: unit inferred", "the same of the velocity's rate", above=0.0)
    setting: Setting = SETTINGS[1]
    amplitude_km: tuple[float, ...] = param((0.09, 0.12, 0.075), TUNED, "of the error of the Earth's ephemeris, each axis")
    phase: tuple[float, ...] = param((0.0, 0.5 * np.pi, 0.25 * np.pi), "chosen", "of that error's year, each axis, rad")
    trend: str = param(
        "sine", "inferred: Eqs 17, 69, 70", "how it goes on: a year's sine, growing, a triangle, or constant, drawn from its prior",
        one_of=("sine", "growing", "triangle", "constant"),
    )  # fmt: skip
    initial: str = param("paper", "inferred", "initial errors: those above, or drawn from the prior", one_of=("paper", "drawn"))
    pulled: bool = param(False, "inferred", "whether Sun and Moon pull at the satellite")
    bias_prior_km: float = param(0.3, "chosen", "deviation of that error at the start, each axis, in the filters", above=0.0)
    walk_km: float = param(5e-5, "chosen", "deviation of the steps of that error in the exact filter, each axis", least=0.0)
    rho: tuple[float, ...] = param((8.0, 15.0, 9.0), "paper", "how strongly the fading factors answer, each pulsar")
    tau: float = param(100.0, "paper", "window of the fading factors, in measurements")
    factor: str = param(
        "excess", "chosen: form C, after setting 5; B is the other", "fading factors of what residuals exceed, or in proportion",
        one_of=("excess", "proportional"),
    )  # fmt: skip

    def check(self) -> None:
        """Three pulsars, a length of some steps."""
        if len(self.pulsars) != 3:
            raise ValueError(f"pulsars: expected 3 names, got {', '.join(self.pulsars) or 'none'}")
        steps("days", self.days * DAY_S / self.step_s)

    @property
    def steps(self) -> int:
        """Measurements."""
        return round(self.days * DAY_S / self.step_s)

    @property
    def times(self) -> Array:
        """Seconds since the start, ``(steps + 1,)``; nothing is measured at the first."""
        return self.step_s * np.arange(self.steps + 1)

    @property
    def dates(self) -> Tdb:
        """The same as dates."""
        return from_utc(self.start_utc).after(self.times)

    @property
    def orbit(self) -> Array:
        """Nominal state ``(6,)`` at the start, km and km/s."""
        a, e, *angles = self.elements
        return orbit.from_elements(a, e, *np.radians(angles).tolist())

    @property
    def timing(self) -> Timing:
        """The pulsars' delays."""
        return Timing(pulsars(self.pulsars))

    @property
    def sigma_km(self) -> Array:
        """Deviations ``(3,)`` of the timings after an interval, km [Xu2024, Eq. 19; inferred]."""
        return np.array([p.timing_std(self.step_s) for p in pulsars(self.pulsars)]) * LIGHT_KM_S

    @property
    def deviation(self) -> Array:
        """Deviations of the prior, which are the initial errors, ``(6,)`` km and km/s."""
        return np.concatenate([self.error_km, np.asarray(self.error_m_per_s) * 1e-3])

    @property
    def process_std(self) -> Array:
        """Driving noise of the rates ``(6,)``, km/s and km/s^2."""
        return np.repeat([self.rate_noise_km_per_s, self.acceleration_noise_km_per_s2], 3)

    @property
    def noise(self) -> Noise:
        """Noises of the setting; ``J (6, 3)`` is two diagonal blocks, in deviations of the driving noises."""
        s, std = self.setting, self.process_std
        J = s.kappa * std[:, None] * np.vstack([np.diag(1.0 / self.sigma_km)] * 2)
        return ar1_noise(s.F * np.eye(3), s.L * np.eye(6), J, np.diag(self.sigma_km**2), np.diag(std**2))

    def bias(self, t: Array) -> Array:
        """Error ``(..., 3)`` km of the ephemeris, ``t`` s after the start [Xu2024, Eqs 17, 69, 70; inferred], if not constant."""
        angle = 2.0 * np.pi / YEAR_S * np.asarray(t)[..., None]
        A, phase = np.asarray(self.amplitude_km), np.asarray(self.phase)
        if self.trend == "sine":
            return np.asarray(A * np.sin(angle + phase))
        if self.trend == "growing":
            return np.asarray(A * (1.5 * angle / (2.0 * np.pi) - 0.75 + 0.5 * np.sin(2.0 * angle + phase)))
        return np.asarray(A * (2.0 / np.pi) * np.arcsin(np.cos(angle + phase)))


TABLE_5 = Config()
WHITE = replace(TABLE_5, setting=SETTINGS[5])
YEAR = replace(TABLE_5, days=365.0, runs=3, setting=Setting(kappa=4.5), walk_km=1e-4)
PRESETS = {"table5": TABLE_5, "white": WHITE, "year": YEAR}


# -- what happens ------------------------------------------------------------------------------------------------------------
PULLING = ("sun", "moon")
SHARED = ("start_utc", "step_s", "days", "pulsars", "elements", "rate_noise_km_per_s", "acceleration_noise_km_per_s2", "pulled")


class Sky(NamedTuple):
    """Where Earth and Sun are at each epoch, ``(T, 3)`` km: what the filters believe.

    ``bodies``: Sun and Moon from the Earth's center at the nodes of the step before each epoch, ``(T, 2, N, 3)``, if they pull.
    """

    earth: Array
    sun: Array
    bodies: Array | None


def sky(config: Config) -> Sky:
    """Earth and Sun, and what pulls, by DE421."""
    earth, sun = (de421().state(body, config.dates).position for body in ("earth", "sun"))
    if not config.pulled:
        return Sky(earth, sun, None)
    nodes = from_utc(config.start_utc).after(config.times[:, None] - config.step_s * (1.0 - NODES.at))
    center = de421().state("earth", nodes).position
    return Sky(earth, sun, np.stack([de421().state(body, nodes).position - center for body in PULLING], 1))


def pull(bodies: Array | None) -> Extra | None:
    """What Sun and Moon, at ``(2, N, 3)`` during a step, add to the acceleration."""
    if bodies is None:
        return None

    def extra(r: Array, _times: Array) -> Array:
        position = np.moveaxis(r, 0, -1)
        pulls = (third_body(position, at[:, None], GM[body]) for body, at in zip(PULLING, bodies, strict=True))
        return np.moveaxis(sum(pulls, np.zeros(3)), -1, 0)

    return extra


def nominal_orbit(config: Config) -> Array:
    """States ``(T, 6)`` of the undisturbed orbit; not to be written to."""
    return _undisturbed(config.elements, config.step_s, config.steps)


@lru_cache(maxsize=4)
def _undisturbed(elements: tuple[float, ...], step_s: float, steps: int) -> Array:
    out = np.empty((steps + 1, 6))
    out[0] = Config(elements=elements).orbit
    for k in range(steps):
        out[k + 1] = advance(out[k], step_s)
    out.flags.writeable = False
    return out


class Scenario(NamedTuple):
    """Simulated runs, time-major: configurations and how many ``runs`` of each; ``truth (T, all runs, 6)`` km, km/s; ``bias (T, all
    runs, 3)`` km; ``z (T, all runs, m)`` km, nan at the start."""

    cases: tuple[Config, ...]
    runs: int
    truth: Array
    bias: Array
    z: Array
    sky: Sky
    prior: Gaussian

    def epochs(self) -> Iterator[Epoch]:
        """Epochs from the first measurement on; ``u`` is ``(earth, sun, bodies)``, ``truth`` state and bias ``(runs, 9)``."""
        dt = self.cases[0].step_s
        for k in range(1, len(self.truth)):
            bodies = None if self.sky.bodies is None else self.sky.bodies[k]
            truth = np.concatenate([self.truth[k], self.bias[k]], -1)
            yield Epoch(k, k * dt, dt, (self.sky.earth[k], self.sky.sun[k], bodies), self.z[k], truth)

    def only(self, first: int, count: int = 1) -> Scenario:
        """Some of the cases."""
        part = slice(first * self.runs, (first + count) * self.runs)
        truth, bias, z = (values[:, part] for values in (self.truth, self.bias, self.z))
        prior = Gaussian(self.prior.mean[part], self.prior.cov[part])
        return Scenario(self.cases[first : first + count], self.runs, truth, bias, z, self.sky, prior)


Cases = Config | Sequence[Config]


def as_cases(cases: Cases) -> tuple[Config, ...]:
    """One configuration or several; ValueError names what they must share."""
    together = (cases,) if isinstance(cases, Config) else tuple(cases)
    for name in SHARED:
        if len({getattr(case, name) for case in together}) != 1:
            raise ValueError(f"{name}: expected the same in all cases, got {', '.join(str(getattr(c, name)) for c in together)}")
    return together


def each(values: Sequence[Any], runs: int) -> Array:
    """Arrays of the cases, with an axis of all runs; that of a single case as it is."""
    return np.asarray(values[0]) if len(values) == 1 else np.repeat(np.stack([np.asarray(value) for value in values]), runs, 0)


def noises(cases: Sequence[Config], runs: int) -> Noise:
    """Noises of cases, see `each`."""
    return Noise(*(each(same, runs) for same in zip(*(case.noise for case in cases), strict=True)))


def simulate(cases: Cases, rngs: Sequence[np.random.Generator]) -> Scenario:
    """Simulate one run of each case with each generator."""
    together = as_cases(cases)
    c, count, runs = together[0], len(together), len(rngs)
    T, timing, seen = c.steps + 1, c.timing, sky(c)
    xi, e, first, drawn = (np.tile(draw, (count, 1)) for draw in normals(rngs, (T, 3), (T, 6), (9,), (9,)))
    noise, sigma, std = noises(together, runs), c.sigma_km, c.process_std
    V, Q = (part * np.sqrt(cov.diagonal(0, -2, -1)) for part, cov in ((first[:, :3], noise.V), (first[:, 3:], noise.Q)))
    bias = np.empty((T, count * runs, 3))
    for i, case in enumerate(together):
        own = slice(i * runs, (i + 1) * runs)
        bias[:, own] = case.bias_prior_km * drawn[own, 6:] if case.trend == "constant" else case.bias(c.times)[:, None]
    # The disturbance is mapped by the nominal orbit's G, from which that of a run differs by 1e-4 of itself.
    G = flow(nominal_orbit(c)[:-1], c.step_s).G
    truth, z = np.empty((T, count * runs, 6)), np.full((T, count * runs, 3), np.nan)
    truth[0] = c.orbit
    for k in range(1, T):
        V, Q = matvec(noise.F, V) + sigma * xi[k], matvec(noise.L, Q) + std * e[k]
        extra = pull(None if seen.bodies is None else seen.bodies[k])
        truth[k] = advance(truth[k - 1], c.step_s, extra=extra) + (matvec(noise.J, V) + Q) @ G[k - 1].T
        z[k] = timing.delay(seen.earth[k] + bias[k] + truth[k, :, :3], seen.sun[k]) + V
    deviation = np.repeat([case.deviation for case in together], runs, 0)
    start = np.where(np.repeat([case.initial == "drawn" for case in together], runs)[:, None], drawn[:, :6], 1.0)
    prior = Gaussian(c.orbit + start * deviation, deviation[..., None] ** 2 * np.eye(6))
    return Scenario(together, runs, truth, bias, z, seen, prior)


# -- models ------------------------------------------------------------------------------------------------------------------
class Models(NamedTuple):
    """Orbit and timings (km, with the Earth where it is believed to be) as filters see them, of ``(mean (..., 6 or more), epoch)``.

    ``Gamma (..., m, 3)`` is the slope with respect to the position, and to an error of the Earth's. ``linear``: whether they are
    products with their derivatives, the same for every mean.
    """

    move: Callable[[Array, Epoch], Flow]
    measure: Callable[[Array, Epoch], Array]
    Gamma: Callable[[Array, Epoch], Array]
    linear: bool = False

    def H(self, mean: Array, epoch: Epoch) -> Array:
        """``[Gamma 0]``."""
        Gamma = self.Gamma(mean, epoch)
        return np.concatenate([Gamma, np.zeros_like(Gamma)], -1)


class Orbit:
    """The orbit's flow about the last state asked for: what follows, Jacobian and noise input come from one integration."""

    def __init__(self, pulled: bool = False) -> None:
        self._pulled = pulled
        self._last: tuple[Array, int, Flow] | None = None

    def __call__(self, mean: Array, epoch: Epoch) -> Flow:
        """Flow of an interval from the orbit in ``mean (..., 6 or more)``."""
        x = mean[..., :6]
        if self._last is None or self._last[1] != epoch.k or not np.array_equal(self._last[0], x):
            self._last = x.copy(), epoch.k, flow(x, epoch.dt, extra=pull(epoch.u[2] if self._pulled else None))
        return self._last[2]


def models(config: Config, pulled: bool = False) -> Models:
    """The models of a configuration. ``pulled``: whether they know of Sun and Moon."""
    timing = config.timing
    return Models(
        Orbit(pulled),
        lambda x, epoch: timing.delay(epoch.u[0] + x[..., :3], epoch.u[1]),
        lambda x, epoch: timing.gradient(epoch.u[0] + x[..., :3], epoch.u[1]),
    )


LINEAR = Models(
    lambda error, epoch: Flow(matvec(epoch.u[0], error[..., :6]), epoch.u[0], epoch.u[1]),
    lambda error, epoch: matvec(epoch.u[2], error[..., :3]),
    lambda _, epoch: epoch.u[2],
    linear=True,
)
"""Models of errors about the nominal orbit, for `nominal_epochs`: all runs have the same covariances, which are computed once."""


def nominal_epochs(config: Config, chunk: int = 4096) -> Iterator[Epoch]:
    """Epochs of the nominal orbit, linearized some at a time; ``u`` is ``(Phi, G, Gamma)``, and nothing is measured yet."""
    x, seen, dt = nominal_orbit(config), sky(config), config.step_s
    for first in range(0, config.steps, chunk):
        part = slice(first, first + chunk + 1)
        _, Phi, G = flow(x[part][:-1], dt)
        Gamma = config.timing.gradient(seen.earth[part] + x[part, :3], seen.sun[part])[1:]
        for k, step in enumerate(zip(Phi, G, Gamma, strict=True), start=first + 1):
            yield Epoch(k, k * dt, dt, step)


# -- the filters -------------------------------------------------------------------------------------------------------------
White = tuple[Array, Array]
"""Covariances ``(..., 6, 6)`` and ``(..., m, m)`` of rates and timings, for a filter that takes all noise for white."""
FORMS = {"excess": excess, "proportional": proportional}


def driving(config: Config) -> White:
    """The covariances of the driving noise, the paper's (inferred) choice."""
    return config.noise.E, config.noise.Xi


def stationary(config: Config) -> White:
    """The covariances that the noises really have."""
    noise = config.noise
    return noise.Q + noise.J @ noise.V @ noise.J.mT, noise.V


def kalman(seen: Models, whites: Sequence[White], runs: int = 1) -> Sequential:
    """An EKF that takes all noise for white."""
    Q, R = (each(same, runs) for same in zip(*whites, strict=True))
    move, root = seen.move, np.linalg.cholesky(Q)

    def f(x: Array, epoch: Epoch) -> Array:
        return move(x[0], epoch).state[None]

    motion = derived(Motion, seen, f, lambda x, epoch: move(x, epoch).Phi, sqrt_Q=lambda x, epoch: move(x, epoch).G @ root)
    return ekf(motion, derived(Sensor, seen, seen.measure, seen.H, R=R), form="covariance")


def derived(kind: Any, seen: Models, function: Any, jacobian: Any, **noise: Any) -> Any:
    """A `Motion` or `Sensor` of a function and its Jacobian, which is all of it where it is linear."""
    return kind(Linear(partial(jacobian, np.zeros(6))), **noise) if seen.linear else kind(function, jacobian=jacobian, **noise)


def bias_prior(cases: Sequence[Config], runs: int) -> Gaussian:
    """Belief about the ephemeris error at the start."""
    cov = each([case.bias_prior_km**2 * np.eye(3) for case in cases], runs)
    return Gaussian(np.zeros(cov.shape[:-1]), cov)


def two_stages(cases: Sequence[Config], runs: int, whites: Sequence[White], seen: Models) -> TwoStage:
    """TKF, whose first stage is EKF."""
    return TwoStage.of(Plain(kalman(seen, whites, runs)), seen.Gamma, bias_prior(cases, runs))


def boosted(
    cases: Cases, runs: int = 1, *, plain: bool = False, first: Differenced | None = None, seen: Models | None = None
) -> TwoStage:
    """TSTDKF. ``plain``: along a leading axis TDKF too, first of both. ``first``: another first stage. ``seen``: other models."""
    together = as_cases(cases)
    seen, rho = seen or models(together[0]), each([case.rho for case in together], runs)
    chosen = each([[case.factor == "proportional"] for case in together], runs)

    def factor(ratios: Array, weights: Array) -> Array:
        return np.where(chosen, proportional(ratios, weights), excess(ratios, weights))

    form = FORMS[together[0].factor] if len({case.factor for case in together}) == 1 else factor
    boost = strong_tracking(np.stack([0.0 * rho, rho]).reshape(2, -1, 3) if plain else rho, together[0].tau, factor=form)
    stage = first or Differenced(seen.move, seen.measure, seen.H, noises(together, runs))
    return TwoStage.of(stage, seen.Gamma, bias_prior(together, runs), boost=boost)


def filters(cases: Cases, runs: int = 1, seen: Models | None = None) -> dict[str, Any]:
    """The filters by name, for priors ``(all runs, 6)``; for one case of any batch shape. ``seen``: other models.

    ekf, tkf: ignorance and two stages, with the covariances of the driving noise; the first stage of tkf is ekf. ekf-fair,
    tkf-fair: the same with the stationary covariances. tdkf, tstdkf: two stages on differenced measurements, without and with
    strong tracking. aug: all noises and the bias among the states, exact. Beliefs of ekf are about ``(r, v)``, of aug about
    ``(r, v, V, Q, b)``, of the others about ``(r, v, b)``.
    """
    together = as_cases(cases)
    seen = seen or models(together[0])
    tstdkf, out = boosted(together, runs, seen=seen), dict[str, Any]()
    for name, white in (("", driving), ("-fair", stationary)):
        believed = [white(case) for case in together]
        out |= {f"ekf{name}": kalman(seen, believed, runs), f"tkf{name}": two_stages(together, runs, believed, seen)}
    return {**out, "tdkf": replace(tstdkf, boost=None), "tstdkf": tstdkf, "aug": augmented(together, runs, seen=seen)}


def augmented(cases: Cases, runs: int = 1, *, noise: Noise | None = None, seen: Models | None = None) -> Filter:
    """The exact filter: 18 states ``(x, V, Q, b)``, the bias a random walk, and no noise left in the measurement.

    ``noise``: other noises than those of the cases. In square-root form: after an update V is known from the rest, so the
    covariance is singular.
    """
    together = as_cases(cases)
    n, seen = noise or noises(together, runs), seen or models(together[0])
    move, JF, bias = seen.move, n.J @ n.F, bias_prior(together, runs)

    def f(x: Array, epoch: Epoch) -> Array:
        mean = x[0]
        moved = move(mean, epoch)
        V, Q, b = mean[..., 6:9], mean[..., 9:15], mean[..., 15:]
        rates = matvec(JF, V) + matvec(n.L, Q)
        return np.concatenate([moved.state + matvec(moved.G, rates), matvec(n.F, V), matvec(n.L, Q), b], -1)[None]

    walk = each([case.walk_km * np.eye(3) for case in together], runs)
    color, drives, constant = block([[n.F, 0], [0, n.L]]), block([[np.sqrt(n.Xi), 0], [0, np.sqrt(n.E)]]), np.eye(3)
    into, through = side_by_side([JF, n.L]), side_by_side([n.J @ np.sqrt(n.Xi), np.sqrt(n.E)])

    def transition(x: Array, epoch: Epoch) -> Array:
        _, Phi, G = move(x, epoch)
        return block([[Phi, G @ into, 0], [0, color, 0], [0, 0, constant]])

    def columns(x: Array, epoch: Epoch) -> Array:
        return block([[move(x, epoch).G @ through, 0], [drives, 0], [0, walk]])

    def h(x: Array, epoch: Epoch) -> Array:
        return np.asarray(seen.measure(x, epoch) + x[..., 6:9] + matvec(seen.Gamma(x, epoch), x[..., 15:]))

    def jacobian(x: Array, epoch: Epoch) -> Array:
        Gamma = seen.Gamma(x, epoch)
        H = np.zeros((*Gamma.shape[:-1], 18))
        H[..., :3], H[..., 6:9], H[..., 15:] = Gamma, np.eye(3), Gamma
        return H

    exact = ekf(derived(Motion, seen, f, transition, sqrt_Q=columns), derived(Sensor, seen, h, jacobian, sqrt_R=np.zeros((3, 1))))

    def start(prior: Gaussian) -> State:
        mean = np.concatenate([prior.mean, np.zeros((*prior.mean.shape[:-1], 12))], -1)
        parts = [np.asarray(part) for part in (prior.cov, n.V, n.Q, bias.cov)]
        return exact.start(Gaussian(mean, block([[part if i == j else 0 for j in range(4)] for i, part in enumerate(parts)])))

    return FromFunctions(start, exact.step)


# -- how they are judged -----------------------------------------------------------------------------------------------------
GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run with each generator, for missions, campaigns and the study. The orbit is judged, which all filters estimate.

    There is a bound where what is simulated is what the exact filter believes: initial errors and a constant ephemeris error that
    are drawn from their priors.
    """
    sim, known = simulate(config, rngs), filters(config)
    believed = config.initial == "drawn" and config.trend == "constant"
    return Trial(GROUPS, known, sim.prior, lambda _name: sim.epochs(), _compare, "aug" if believed else "", lambda x: x[..., :3])


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean[..., :6] - truth[..., :6], cholesky(belief.cov[..., :6, :6])
