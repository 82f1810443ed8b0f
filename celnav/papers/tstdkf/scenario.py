"""[Xu2023]: an Earth satellite measures pulse delays of three pulsars; the noise is colored, and
the Earth's ephemeris has an error.

Our copy of the paper lacks the display equations. We infer Eq. 2, delay of a pulse
(`celnav.models.pulsar.Timing`); 3-4, orbit (`celnav.models.orbit`); 17, 69, 70, ephemeris error
(`Config.bias`); 19, standard deviation of a timing (`Pulsar.timing_std`); 21-56 and 57-61,
differencing and strong tracking (`celnav.papers.tstdkf.method`), on two stages
(`celnav.filters.two_stage`).

Several configurations can run together as *cases*. They have an axis before the runs' axis, and
share random numbers, orbit and times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.model import Linear, Motion, Sensor
from celnav.filters.records import Epoch, Epochs, Info, State, epochs
from celnav.filters.run import run
from celnav.filters.sequential import Sequential, ekf
from celnav.filters.two_stage import Plain, TwoStage
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, block, cholesky, matvec, side_by_side
from celnav.models import orbit
from celnav.models.ephemeris import GM, Tdb, de421, from_utc
from celnav.models.noise import Noise, ar1, ar1_noise
from celnav.models.orbit import EARTH, NODES, Earth, Extra, Flow, advance, flow, third_body
from celnav.models.pulsar import LIGHT_KM_S, Timing, pulsars
from celnav.papers import citation
from celnav.papers.tstdkf.method import Differenced, strong_tracking
from celnav.study.montecarlo import normals, steps
from celnav.study.parameters import Parameters, Timed, param
from celnav.study.study import Rngs
from celnav.study.trial import Group, Trial

__all__ = [
    "CITATION",
    "DAY_S",
    "GRAVITY",
    "GROUPS",
    "JUDGED",
    "KAPPA",
    "LINEAR",
    "PRESETS",
    "PULLING",
    "SETTINGS",
    "TABLE_5",
    "TITLE",
    "YEAR",
    "YEAR_S",
    "Config",
    "Scenario",
    "Setting",
    "filters",
    "kalman",
    "linearized",
    "models",
    "nine_states",
    "noises",
    "nominal",
    "simulate",
    "sky",
    "trial",
]

TITLE = "Two-stage strong-tracking differential Kalman filter for X-ray pulsars"
CITATION = citation("Xu2023")
YEAR_S = 365.25 * 86400.0
DAY_S = 86400.0
KAPPA = 4.8
GRAVITY = {"earth": EARTH, "mars": Earth(GM["mars"], 3396.0, 1.9566e-3)}
"""Gravity of the bodies that a satellite may orbit; Mars: radius and J2 of the field GMM-3."""
TUNED = (
    "chosen: fitted with the other fitted one so that setting 1 gives the paper's percentages in "
    "position"
)


# -- parameters ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setting(Parameters):
    """One row of Table 4."""

    F: float = param(
        0.5,
        "chosen",
        "AR(1) coefficient of the measurement noise, V' = F V + increment; the increment has the "
        "timing's standard deviation",
    )
    L: float = param(0.5, "chosen", "AR(1) coefficient of the process noise")
    kappa: float = param(KAPPA, TUNED, "coupling of the increments of both noises")


SETTINGS = {
    1: Setting(),
    2: Setting(kappa=0.0),
    3: Setting(0.5, 0.0, 0.0),
    4: Setting(0.0, 0.5, 0.0),
    5: Setting(0.0, 0.0, 0.0),
}
"""Table 4, as inferred: from all effects (setting 1) to all noise white (setting 5)."""


@dataclass(frozen=True)
class Config(Timed):
    """All parameters of a run."""

    start_utc: str = param("2015-10-17T04:00:00", "paper", "date and time of the start, UTC")
    step_s: float = param(
        300.0, "paper", "interval between timings, and observation time of each", above=0.0
    )
    days: float = param(30.0, "paper", "length of a run, days", above=0.0)
    runs: int = param(50, "paper", "number of Monte-Carlo runs", least=1)
    pulsars: tuple[str, ...] = param(
        ("B0531+21", "B1821-24", "B1937+21"), "paper", "names of the three pulsars"
    )
    center: str = param("earth", "paper", "body that the satellite orbits", one_of=tuple(GRAVITY))
    elements: tuple[float, ...] = param(
        (7136.635, 1.809e-3, 65.0, 30.0, 30.0, 0.0),
        "chosen: common in this literature",
        "orbital elements: semi-major axis (km), eccentricity, inclination, node, perigee and true "
        "anomaly (deg)",
    )
    error_km: tuple[float, ...] = param(
        (1.0,) * 3, "paper", "initial position error, each axis, and its σ in the prior", above=0.0
    )
    error_m_per_s: tuple[float, ...] = param(
        (0.02,) * 3, "paper", "initial velocity error, each axis, and its σ in the prior", above=0.0
    )
    rate_noise_km_per_s: float = param(
        1e-8,
        "paper: unit inferred",
        "σ of the process noise, position's rate, each axis",
        above=0.0,
    )
    acceleration_noise_km_per_s2: float = param(
        1e-10,
        "paper: unit inferred",
        "σ of the process noise, velocity's rate, each axis",
        above=0.0,
    )
    setting: Setting = SETTINGS[1]
    amplitude_km: tuple[float, ...] = param(
        (0.09, 0.12, 0.075), TUNED, "amplitude of the Earth's ephemeris error, each axis"
    )
    phase: tuple[float, ...] = param(
        (0.0, 0.5 * np.pi, 0.25 * np.pi), "chosen", "phase of the ephemeris error, each axis, rad"
    )
    trend: str = param(
        "sine",
        "inferred: Eqs 17, 69, 70",
        "ephemeris error over time: a sine with a period of a year, growing, a triangle; constant, "
        "drawn from its prior; or a step at half time from 0 to the σ of its prior",
        one_of=("sine", "growing", "triangle", "constant", "step"),
    )
    initial: str = param(
        "paper",
        "inferred",
        "initial errors: the values above, or drawn from the prior",
        one_of=("paper", "drawn"),
    )
    pulled: bool = param(False, "inferred", "whether the Sun and Moon attract the satellite")
    bias_prior_km: float = param(
        0.3, "chosen", "σ of the initial ephemeris error in the filters, each axis", above=0.0
    )
    walk_km: float = param(
        5e-5,
        "chosen",
        "σ of the random-walk steps of the ephemeris error in AUG and AUG9, each axis",
        least=0.0,
    )
    rho: tuple[float, ...] = param(
        (8.0, 15.0, 9.0),
        "paper",
        "how strongly the fading factors respond to the residual of each pulsar",
    )
    tau: float = param(100.0, "paper", "window of the fading factors, number of measurements")
    factor: str = param(
        "excess",
        "chosen: form C, after seeing setting 5; form B is the alternative",
        "fading factors from the excess of the residuals (form C), or proportional to the "
        "residuals (form B)",
        one_of=("excess", "proportional"),
    )

    def check(self) -> None:
        """Check that there are three pulsars, and some steps."""
        if len(self.pulsars) != 3:
            raise ValueError(f"pulsars: expected 3 names, got {', '.join(self.pulsars) or 'none'}")
        steps("days", self.days * DAY_S / self.step_s)

    @property
    def times(self) -> Array:
        """Seconds since the start, ``(T,)``; there is no measurement at the first epoch."""
        return self.step_s * np.arange(round(self.days * DAY_S / self.step_s) + 1)

    @property
    def dates(self) -> Tdb:
        """The epochs as dates."""
        return from_utc(self.start_utc).after(self.times)

    @property
    def orbit(self) -> Array:
        """Nominal state ``(6,)`` at the start, km and km/s."""
        a, e, *angles = self.elements
        i, node, perigee, anomaly = np.radians(angles).tolist()
        return orbit.from_elements(a, e, i, node, perigee, anomaly, GRAVITY[self.center])

    @property
    def timing(self) -> Timing:
        """Timing model of the three pulsars."""
        return Timing(pulsars(self.pulsars))

    @property
    def sigma_km(self) -> Array:
        """Standard deviations ``(3,)`` of the timings, km [Xu2023, Eq. 19; inferred]."""
        return np.array([p.timing_std(self.step_s) for p in pulsars(self.pulsars)]) * LIGHT_KM_S

    @property
    def deviation(self) -> Array:
        """Initial errors and standard deviations of the prior, ``(6,)`` km and km/s."""
        return np.concatenate([self.error_km, np.asarray(self.error_m_per_s) * 1e-3])

    @property
    def process_std(self) -> Array:
        """Standard deviations of the driving noise of the rates ``(6,)``, km/s and km/s^2."""
        return np.repeat([self.rate_noise_km_per_s, self.acceleration_noise_km_per_s2], 3)

    @property
    def noise(self) -> Noise:
        """Noises of the setting; ``J (6, 3)`` has two diagonal blocks, scaled by the standard
        deviations of the driving noises."""
        s = self.setting
        std = self.process_std
        J = s.kappa * std[:, None] * np.vstack([np.diag(1.0 / self.sigma_km)] * 2)
        return ar1_noise(
            s.F * np.eye(3), s.L * np.eye(6), J, np.diag(self.sigma_km**2), np.diag(std**2)
        )

    def bias(self, t: Array) -> Array:
        """Ephemeris error ``(..., 3)`` km, ``t`` s after the start
        [Xu2023, Eqs 17, 69, 70; inferred]; not for the trend "constant"."""
        if self.trend == "step":
            return (
                self.bias_prior_km
                * np.ones(3)
                * (np.asarray(t)[..., None] > 0.5 * self.days * DAY_S)
            )
        angle = 2.0 * np.pi / YEAR_S * np.asarray(t)[..., None]
        A = np.asarray(self.amplitude_km)
        phase = np.asarray(self.phase)
        growing = 1.5 * angle / (2.0 * np.pi) - 0.75 + 0.5 * np.sin(2.0 * angle + phase)
        triangle = (2.0 / np.pi) * np.arcsin(np.cos(angle + phase))
        return np.asarray(
            A * {"sine": np.sin(angle + phase), "growing": growing}.get(self.trend, triangle)
        )


TABLE_5 = Config()
WHITE = replace(TABLE_5, setting=SETTINGS[5])
YEAR = replace(TABLE_5, days=365.0, runs=3, setting=Setting(kappa=4.5), walk_km=1e-4)
PRESETS = {"table5": TABLE_5, "white": WHITE, "year": YEAR}


# -- truth and measurements ------------------------------------------------------------------------
Cases = Config | Sequence[Config]
"""One configuration, or several that run together."""
PULLING = ("sun", "moon")


def stacked(cases: Cases, of: Callable[[Config], Any]) -> Array:
    """A parameter of one configuration; for several configurations, an array ``(cases, 1, ...)``,
    which broadcasts over the runs."""
    return (
        np.asarray(of(cases))
        if isinstance(cases, Config)
        else np.stack([np.asarray(of(case)) for case in cases])[:, None]
    )


def one_of(cases: Cases) -> Config:
    """The first configuration, whose times, orbit and pulsars all cases share."""
    return cases if isinstance(cases, Config) else cases[0]


def noises(cases: Cases) -> Noise:
    """Noises of the cases, see `stacked`."""
    return Noise(*(stacked(cases, attrgetter(f"noise.{name}")) for name in Noise._fields))


def sky(config: Config) -> tuple[Array, Array, Array | None]:
    """Positions of the central body and of the Sun from DE421 at each epoch, ``(T, 3)`` km, as the
    filters assume them. If Sun and Moon attract the satellite, also their positions relative to the
    center, ``(T, 2, N, 3)`` km, at the nodes of the step that ends at each epoch."""
    earth, sun = (de421().state(body, config.dates).position for body in (config.center, "sun"))
    if not config.pulled:
        return earth, sun, None
    nodes = from_utc(config.start_utc).after(
        config.times[:, None] - config.step_s * (1.0 - NODES.at)
    )
    center = de421().state(config.center, nodes).position
    return (
        earth,
        sun,
        np.stack([de421().state(body, nodes).position - center for body in PULLING], 1),
    )


def pull(bodies: Array | None) -> Extra | None:
    """Acceleration due to Sun and Moon, whose positions during a step are ``(2, N, 3)`` km."""
    if bodies is None:
        return None
    both = [(at[:, None], GM[body]) for body, at in zip(PULLING, bodies, strict=True)]
    return lambda r, _: np.moveaxis(
        sum((third_body(np.moveaxis(r, 0, -1), *one) for one in both), np.zeros(3)), -1, 0
    )


def nominal(config: Config) -> Flow:
    """The undisturbed orbit ``(T, 6)``, and ``Phi`` and ``G`` of each step, ``(T - 1, 6, 6)``. Do
    not write to these arrays: they are cached."""
    return _coasted(tuple(config.orbit.tolist()), config.step_s, config.samples, config.center)


@lru_cache(maxsize=4)
def _coasted(start: tuple[float, ...], step_s: float, steps: int, center: str) -> Flow:
    gravity = GRAVITY[center]
    when = epochs(step_s * np.arange(steps + 1))
    prior = Gaussian(start, np.zeros((6, 6)))
    x = carried(lambda x, epoch: advance(x, epoch.dt, gravity), prior, when)
    pieces = [
        flow(part, step_s, gravity)[1:] for part in np.array_split(x[:-1], 1 + steps // 4096)
    ]  # pieces that fit the processor's cache
    return Flow(x, *map(np.concatenate, zip(*pieces, strict=True)))


class Scenario(NamedTuple):
    """Simulated runs, time first, of one configuration or of several ``(cases, runs)``: ``truth (T,
    ..., 6)`` km, km/s; ``bias (T, ..., 3)`` km; ``z (T, ..., m)`` km, whose first epoch is not
    used; ``inputs``: arrays ``(T - 1, ...)`` for the models."""

    truth: Array
    bias: Array
    z: Array
    inputs: tuple[Array | None, ...]
    prior: Gaussian
    step_s: float

    @property
    def times(self) -> Array:
        """Seconds since the start, ``(T,)``."""
        return self.step_s * np.arange(len(self.truth))

    def some(self, runs: slice) -> Scenario:
        """Some of the runs, for all cases."""
        return self._part(slice(None), runs)

    def of(self, cases: list[int]) -> Scenario:
        """The cases with these indices."""
        return self._part(cases, slice(None))

    def _part(self, *at: Any) -> Scenario:
        mean = self.prior.mean
        cov = self.prior.cov
        if cov.ndim > 2:  # one covariance per run
            cov = np.broadcast_to(cov, (*mean.shape, mean.shape[-1]))[at]
        truth, bias, z = (part[:, *at] for part in (self.truth, self.bias, self.z))
        return self._replace(truth=truth, bias=bias, z=z, prior=Gaussian(mean[at], cov))

    def measured(self) -> Epochs:
        """Epochs from the first measurement on, without the truth."""
        every: Epochs = epochs(self.times, self.z, self.inputs)[1:]
        return every

    def epochs(self) -> Epochs:
        """The epochs with the truth, state and bias ``(..., 9)``."""
        truth = side_by_side([self.truth, self.bias])
        every: Epochs = epochs(self.times, self.z, self.inputs, truth)[1:]
        return every


def drawn(cases: Cases, rngs: Rngs) -> tuple[Array, Array, Array, Array]:
    """AR(1) noises V ``(T, ..., runs, 3)`` km and Q ``(T, ..., runs, 6)``; standard normal numbers
    for the initial state ``(runs, 6)`` and for the bias ``(runs, 3)`` of each run."""
    c = one_of(cases)
    noise = noises(cases)
    xi, e, first, rest = normals(rngs, (c.samples + 1, 3), (c.samples + 1, 6), (9,), (9,))
    both = (
        (noise.F, xi * c.sigma_km, first[:, :3], noise.V),
        (noise.L, e * c.process_std, first[:, 3:], noise.Q),
    )
    V, Q = (
        ar1(color, by[1:], start * np.sqrt(cov.diagonal(0, -2, -1)))
        for color, by, start, cov in both
    )
    return V, Q, rest[:, :6], rest[:, 6:]


def simulate(cases: Cases, rngs: Rngs) -> Scenario:
    """Simulate one run of each case with each generator."""
    c = one_of(cases)
    noise = noises(cases)
    V, Q, begun, constant = drawn(cases, rngs)
    timing = c.timing
    earth, sun, bodies = sky(c)
    each = [c] if isinstance(cases, Config) else cases
    errors = [
        case.bias_prior_km * constant if case.trend == "constant" else case.bias(c.times)[:, None]
        for case in each
    ]
    bias = np.stack(
        [np.broadcast_to(error, (len(V), len(rngs), 3)) for error in errors], 1
    ).reshape(V.shape)
    # G of the nominal orbit maps the disturbance; a run's own G differs by a relative 1e-4.
    pushes = Q[1:]
    pushes += matvec(noise.J, V[1:])
    pushes = (pushes.reshape(len(pushes), -1, 6) @ nominal(c).G.mT).reshape(pushes.shape)
    truth = pushed(c, pushes, None if bodies is None else bodies[1:])
    z = V
    z[0] = np.nan
    for some in np.array_split(np.arange(1, len(z)), 1 + len(z) // 256):
        there = (some, *(None,) * (z.ndim - 2))
        place = earth[there] + bias[some] + truth[some, ..., :3]
        z[some] += timing.delay(place, sun[there])
    deviation = stacked(cases, lambda case: case.deviation)
    start = np.where(stacked(cases, lambda case: [case.initial == "drawn"]), begun, 1.0)
    prior = Gaussian(c.orbit + start * deviation, deviation[..., None] ** 2 * np.eye(6))
    return Scenario(
        truth,
        bias,
        z,
        (earth[1:], sun[1:], None if bodies is None else bodies[1:]),
        prior,
        c.step_s,
    )


def carried(f: Callable[[Array, Epoch], Array], prior: Gaussian, when: Epochs) -> Array:
    """States ``(T, ..., 6)`` from repeated prediction: the means of a filter without sensors."""
    motion = Motion(f, np.zeros((6, 6)), jacobian=lambda _x, _epoch: np.eye(6))
    return run(ekf(motion, form="covariance"), prior, when, keep="mean").mean


def pushed(config: Config, pushes: Array, bodies: Array | None) -> Array:
    """Orbits ``(T, ..., 6)`` from the nominal start.

    pushes: ``(T - 1, ..., 6)`` km, km/s at the end of each step. bodies: see `pull`.
    """
    gravity = GRAVITY[config.center]
    start = np.broadcast_to(config.orbit, pushes.shape[1:])

    def f(x: Array, epoch: Epoch) -> Array:
        push, attracting = epoch.u
        return np.asanyarray(advance(x, epoch.dt, gravity, pull(attracting)) + push)

    when = epochs(config.times, u=(pushes, bodies))
    return carried(f, Gaussian(start, np.zeros((6, 6))), when)


def linearized(cases: Sequence[Config], rngs: Rngs) -> Scenario:
    """Runs of the errors about the nominal orbit, for `LINEAR` models. Their filters have one
    covariance for all runs. Cases differ only in their ephemeris error. A constant error is 1 km
    along x, y and z in the first three runs, and along random directions in the others."""
    c = cases[0]
    V, Q, _, constant = drawn(cases[0], rngs)
    orbit, Phi, G = nominal(c)
    earth, sun, _ = sky(c)
    J = c.noise.J
    x = np.zeros_like(Q)
    Gamma = c.timing.gradient(earth + orbit[:, :3], sun)
    x[1:] = (V[1:] @ J.T + Q[1:]) @ G.mT
    for now, before, transition in zip(x[1:], x, Phi.mT, strict=False):
        now += before @ transition
    unit = constant / np.linalg.norm(constant, axis=1, keepdims=True)
    batch = (len(x), len(cases), len(rngs))
    unit[:3] = np.eye(3)[: len(unit)]
    errors = [
        unit[None] if case.trend == "constant" else case.bias(c.times)[:, None] for case in cases
    ]
    bias = np.stack([np.broadcast_to(error, (len(x), *error.shape[1:])) for error in errors], 1)
    truth = np.broadcast_to(x[:, None], (*batch, 6))
    bias = np.broadcast_to(bias, (*batch, 3))
    z = (truth[..., :3] + bias) @ Gamma[:, None].mT + V[:, None]
    prior = Gaussian(np.broadcast_to(c.deviation, (*batch[1:], 6)), np.diag(c.deviation**2))
    return Scenario(truth, bias, z, (Phi, G, Gamma[1:]), prior, c.step_s)


# -- models ----------------------------------------------------------------------------------------
class Models(NamedTuple):
    """Models of orbit and timings (km) in the filters, functions of ``(mean (..., 6 or more),
    epoch)``, with the Earth at its position in the ephemeris. ``Gamma (..., m, 3)``: Jacobian of
    the timings with respect to the satellite's position, and to the ephemeris error. ``linear``:
    whether the functions are linear, with Jacobians that do not depend on the mean."""

    move: Callable[[Array, Epoch], Flow]
    measure: Callable[[Array, Epoch], Array]
    Gamma: Callable[[Array, Epoch], Array]
    linear: bool = False

    def H(self, mean: Array, epoch: Epoch) -> Array:
        """``[Gamma 0]``."""
        return block([[self.Gamma(mean, epoch), np.zeros((3, 3))]])

    def believed(self, kind: Any, function: Any, jacobian: Any, **noise: Any) -> Any:
        """A `Motion` or `Sensor` made of a function and its Jacobian, or of the Jacobian alone if
        the model is linear."""
        return (
            kind(Linear(partial(jacobian, np.zeros(6))), **noise)
            if self.linear
            else kind(function, jacobian=jacobian, **noise)
        )


class Orbiting:
    """Functions for `Models` of a configuration. ``pulled``: whether they model Sun and Moon."""

    def __init__(self, config: Config, pulled: bool):
        self.timing, self.gravity, self.pulled = config.timing, GRAVITY[config.center], pulled
        self._last: tuple[Any, Any, Any] = (None, None, None)

    def move(self, mean: Array, epoch: Epoch) -> Flow:
        """Next state, Jacobian and noise input from one integration; the last result is cached."""
        x = mean[..., :6]
        if x.dtype.hasobject:  # recorded: the recorder merges equal computations
            return self._flow(x, epoch)
        last_x, at, result = self._last
        if at is not epoch or not np.array_equal(last_x, x):
            result = self._flow(x, epoch)
            self._last = x.copy(), epoch, result
        return result  # type: ignore[no-any-return]

    def _flow(self, x: Array, epoch: Epoch) -> Flow:
        return flow(x, epoch.dt, self.gravity, pull(epoch.u[2] if self.pulled else None))

    def measure(self, x: Array, epoch: Epoch) -> Array:
        """Delays ``(..., m)`` km."""
        return self.timing.delay(epoch.u[0] + x[..., :3], epoch.u[1])

    def Gamma(self, x: Array, epoch: Epoch) -> Array:
        """Jacobian of the delays with respect to the position ``(..., m, 3)``."""
        return self.timing.gradient(epoch.u[0] + x[..., :3], epoch.u[1])


def models(config: Config, pulled: bool = False) -> Models:
    """The models of a configuration. ``pulled``: whether they model Sun and Moon."""
    of = Orbiting(config, pulled)
    return Models(of.move, of.measure, of.Gamma)


LINEAR = Models(  # of errors about the nominal orbit; epoch.u is (Phi, G, Gamma)
    lambda error, epoch: Flow(matvec(epoch.u[0], error[..., :6]), epoch.u[0], epoch.u[1]),
    lambda error, epoch: matvec(epoch.u[2], error[..., :3]),
    lambda _, epoch: epoch.u[2],
    linear=True,
)


# -- the filters -----------------------------------------------------------------------------------
def filters(
    cases: Cases, seen: Models | None = None, noise: Noise | None = None, *, on: ArrayLike = 1.0
) -> dict[str, Any]:
    """The filters by name. seen, noise: models and noises that replace the models and noises of the
    cases. on: factor that multiplies rho.

    ekf ignores the bias. tkf estimates it in a second stage; its first stage is ekf. Both assume
    the covariances of the driving noise, the paper's choice (inferred). ekf-fair and tkf-fair
    assume the stationary covariances of the noises. tdkf and tstdkf have two stages on differenced
    measurements, without and with strong tracking. aug9 is ekf with the bias appended as a random
    walk. aug has all noises and the bias as states, and is exact. The state is ``(r, v)`` for ekf,
    ``(r, v, V, Q, b)`` for aug, and ``(r, v, b)`` for the others.
    """
    seen = seen or models(one_of(cases))
    n = noise or noises(cases)
    bias = Gaussian(np.zeros(3), stacked(cases, lambda case: case.bias_prior_km**2 * np.eye(3)))
    out: dict[str, Any] = {}
    for name, (Q, R) in zip(("", "-fair"), n.whites, strict=True):
        out[f"ekf{name}"] = kalman(seen, Q, R)
        out[f"tkf{name}"] = TwoStage.of(Plain(out[f"ekf{name}"]), seen.Gamma, bias)
    tdkf = TwoStage.of(Differenced(seen.move, seen.measure, seen.H, n), seen.Gamma, bias)
    walk = stacked(cases, lambda case: case.walk_km * np.eye(3))
    out["aug9"] = nine_states(seen, n.E, n.Xi, bias, walk)
    rho = stacked(cases, lambda case: case.rho)
    form = stacked(cases, lambda case: [case.factor == "proportional"])
    boost = strong_tracking(on * rho, one_of(cases).tau, proportional=form)
    return out | {
        "tdkf": tdkf,
        "tstdkf": replace(tdkf, boost=boost),
        "aug": augmented(seen, n, bias, walk),
    }


# Matrices that may differ between runs are arguments of a `partial`, so that the compiled engine
# can detect them.
def kalman(seen: Models, Q: Array, R: Array) -> Sequential:
    """An EKF that treats all noise as white, with covariances Q ``(..., 6, 6)`` of the rates and R
    ``(..., m, m)``."""
    functions = partial(_follows, seen), partial(_transition, seen)
    motion = seen.believed(Motion, *functions, sqrt_Q=partial(_driven, seen, np.linalg.cholesky(Q)))
    return ekf(motion, seen.believed(Sensor, seen.measure, seen.H, R=R), form="covariance")


def _follows(seen: Models, x: Array, epoch: Epoch) -> Array:
    return seen.move(x[0], epoch).state[None]


def _transition(seen: Models, x: Array, epoch: Epoch) -> Array:
    return seen.move(x, epoch).Phi


def _driven(seen: Models, root: Array, x: Array, epoch: Epoch) -> Array:
    return np.asanyarray(seen.move(x, epoch).G @ root)


def augmented(seen: Models, n: Noise, bias: Gaussian, walk: Array) -> Appended:
    """The exact filter: 18 states ``(x, V, Q, b)``, with a random-walk bias and no white noise in
    the measurement. It has square-root form, because an update determines V from the other states,
    which makes the covariance singular."""
    xi = np.sqrt(n.Xi)
    e = np.sqrt(n.E)
    eye = np.eye(3)
    color, cov = (
        block([[V, 0, 0], [0, Q, 0], [0, 0, b]])
        for V, Q, b in ((n.F, n.L, eye), (n.V, n.Q, bias.cov))
    )
    drives = block([[n.J @ xi, e, 0], [xi, 0, 0], [0, e, 0], [0, 0, walk]])
    return appended(
        seen,
        cov,
        color,
        block([[n.J @ n.F, n.L, np.zeros((6, 3))]]),
        drives,
        "square root",
        sqrt_R=np.zeros((3, 1)),
    )


def nine_states(seen: Models, Q: Array, R: Array, bias: Gaussian, walk: Array) -> Appended:
    """`kalman` with the bias appended, ``(x, b)``; ``walk (..., 3, 3)``: square root of the
    covariance of the bias's steps."""
    drives = block([[np.linalg.cholesky(Q), 0], [0, walk]])
    return appended(seen, bias.cov, np.eye(3), np.zeros((6, 3)), drives, "covariance", R=R)


@dataclass(frozen=True, eq=False)
class Appended:
    """A filter of the orbit and ``q`` further states with initial covariance ``cov (..., q,
    q)``."""

    filter: Sequential
    cov: Array

    def start(self, prior: Gaussian) -> State:
        """State before the first epoch, from a prior of the orbit."""
        mean = side_by_side([prior.mean, np.zeros(self.cov.shape[-1])])
        return self.filter.start(Gaussian(mean, block([[prior.cov, 0], [0, self.cov]])))

    def step(self, state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        """State after an epoch."""
        return self.filter.step(state, epoch)


def appended(
    seen: Models, cov: Array, color: Array, into: Array, drives: Array, form: str, **R: Array
) -> Appended:
    """An EKF of the orbit and ``s (..., q)``: the noises if q > 3 (of the timings first), then the
    bias.

    ``s' = color s + w``, initially N(0, cov); the noise of the orbit is ``into s + w``. drives:
    ``(..., 6 + q, r)``, square root of the covariance of w. R: see `ekf`.
    """
    slope = partial(_slope_with, seen, cov.shape[-1] - 3)
    motion = seen.believed(
        Motion,
        partial(_follows_with, seen, color, into),
        partial(_transition_with, seen, color, into),
        sqrt_Q=partial(_driven_with, seen, drives),
    )
    sensor = seen.believed(Sensor, partial(_measured_with, seen, slope), slope, **R)
    return Appended(ekf(motion, sensor, form=form), cov)


def _follows_with(seen: Models, color: Array, into: Array, x: Array, epoch: Epoch) -> Array:
    moved = seen.move(x[0], epoch)
    s = x[0][..., 6:]
    orbit = moved.state + matvec(moved.G, matvec(into, s))
    return np.concatenate([orbit, matvec(color, s)], -1)[None]


def _transition_with(seen: Models, color: Array, into: Array, x: Array, epoch: Epoch) -> Array:
    _, Phi, G = seen.move(x, epoch)
    return block([[Phi, G @ into], [0, color]])


def _driven_with(seen: Models, drives: Array, x: Array, epoch: Epoch) -> Array:
    return block([[seen.move(x, epoch).G @ drives[..., :6, :]], [drives[..., 6:, :]]])


def _slope_with(seen: Models, noises: int, x: Array, epoch: Epoch) -> Array:
    """Jacobian of the timings; ``noises``: number of states between orbit and bias, V first."""
    return block([[seen.H(x, epoch), np.eye(3, noises), seen.Gamma(x, epoch)]])


def _measured_with(seen: Models, slope: Any, x: Array, epoch: Epoch) -> Array:
    return np.asanyarray(seen.measure(x, epoch) + matvec(slope(x, epoch)[..., 6:], x[..., 6:]))


# -- evaluation ------------------------------------------------------------------------------------
GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(config: Config, rngs: Rngs) -> Trial:
    """A trial with one run for each generator, for missions, campaigns and the study.

    The orbit is evaluated, because all filters estimate it. There is a bound if the initial errors
    and a constant ephemeris error are drawn from their priors, as the exact filter assumes.
    """
    sim = simulate(config, rngs)
    by_name = filters(config)
    reference = "aug" if config.initial == "drawn" and config.trend == "constant" else ""

    def compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
        return belief.mean[..., :6] - truth[..., :6], cholesky(belief.cov[..., :6, :6])

    return Trial(
        GROUPS,
        by_name,
        sim.prior,
        lambda _name: sim.epochs(),
        compare,
        reference,
        lambda x: x[..., :3],
    )
