"""Models of GRACE-A and its fixes, with settings from 2 and 3 August 2008. Units: m, s; Earth-fixed
axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaln

from celnav.analysis.tuning import Tuned, maximize_likelihood
from celnav.filters.adaptive import student_t
from celnav.filters.colored import colored
from celnav.filters.joint import Joint
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter, Info, epochs
from celnav.filters.run import run
from celnav.filters.sequential import ukf
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, cholesky, matvec, whiten
from celnav.models import earth, ephemeris, gravity, orbit
from celnav.real.grace.positions import STEP_S, Positions, read

__all__ = [
    "DEGREE",
    "DOF",
    "SETTINGS",
    "TAU_S",
    "TRAINED",
    "Setting",
    "Training",
    "Weighed",
    "around",
    "believed",
    "fitted",
    "linear",
    "orientation",
    "prior",
    "step",
    "trained",
    "training",
    "weighing",
]

POLE = (0.24 * np.pi / 648000.0, 0.47 * np.pi / 648000.0)
TT_GPS_S, GPS_UTC_S, UT1_UTC_S = 51.184, 14.0, -0.458
"""Differences of time scales, s; `POLE` is the polar motion, x and y, rad."""


# -- models ----------------------------------------------------------------------------------------
class Around(NamedTuple):
    """Quantities by epoch on Earth-fixed axes, ``(T, 3)``: rotation rate of the axes (rad/s), and
    geocentric positions of Sun and Moon (m).
    """

    spin: Array
    sun: Array
    moon: Array


def orientation(times: Array) -> tuple[Array, Array]:
    """Rotations ``(T, 3, 3)`` from celestial to Earth-fixed axes at GPS seconds since 2000-01-01
    12:00, and TT ``(T, 2)``.
    """
    tt = np.stack([np.full(times.shape, 2451545.0), (times + TT_GPS_S) / 86400.0], -1)
    return earth.orientation(tt, tt - [0.0, (TT_GPS_S + GPS_UTC_S - UT1_UTC_S) / 86400.0], POLE), tt


def around(times: Array) -> Around:
    """`Around` at the beginning of each of the T - 1 intervals between GPS seconds ``(T,)``."""
    fixed, tt = orientation(times)
    date, kernel = ephemeris.from_tt(*tt[:-1].T), ephemeris.de421()
    center, *bodies = (kernel.state(body, date).position for body in ("earth", "sun", "moon"))
    sun, moon = (matvec(fixed[:-1], 1e3 * (body - center)) for body in bodies)
    return Around(earth.spin(fixed, STEP_S), sun, moon)


def step(x: Array, epoch: Any, field: gravity.Gravity) -> Array:
    """State ``(..., 6)`` m, m/s on Earth-fixed axes after an interval, by one Runge-Kutta step of
    order 4. Its error in 10 s is 0.01 mm.
    """
    h, r, v = epoch.dt, x[..., :3], x[..., 3:]
    spin, sun, moon = epoch.u

    def pull(r: Array, v: Array) -> Array:
        bodies = orbit.third_body(r, sun, 1e9 * ephemeris.GM["sun"]) + orbit.third_body(
            r, moon, 1e9 * ephemeris.GM["moon"]
        )
        return np.asanyarray(field.acceleration(r) + earth.inertial_forces(r, v, spin) + bodies)

    a1 = pull(r, v)
    v2 = v + 0.5 * h * a1
    a2 = pull(r + 0.5 * h * v, v2)
    v3 = v + 0.5 * h * a2
    a3 = pull(r + 0.5 * h * v2, v3)
    v4 = v + h * a3
    a4 = pull(r + h * v3, v4)
    return np.concatenate(
        [r + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)], -1
    )


class Setting(NamedTuple):
    """Standard deviation (m) of a fix's errors, their correlation over a step, and standard
    deviation (m/s) of the velocity change by unmodeled forces in a step, per axis.
    """

    sigma: float
    phi: float
    q: float


Settings = Setting | Array
"""One setting, or several as runs ``(3, runs)``."""


def motion(field: gravity.Gravity, q: Any) -> Motion:
    """Motion under gravity and white accelerations, with a σ of ``q`` m/s per step."""
    white = np.array([[STEP_S**2 / 3.0, STEP_S / 2.0], [STEP_S / 2.0, 1.0]])
    return Motion(
        partial(step, field=field), np.square(q)[..., None, None] * np.kron(white, np.eye(3))
    )


def believed(field: gravity.Gravity, setting: Settings) -> tuple[Motion, Sensor, Array]:
    """Motion, sensor, and coefficient of the sensor's noise over a step."""
    sigma, phi, q = (np.asarray(part, float)[..., None, None] for part in setting)
    return motion(field, q[..., 0, 0]), Sensor(np.eye(3, 6), sigma**2 * np.eye(3)), phi * np.eye(3)


def prior(log: Positions) -> Gaussian:
    """Position and velocity from a polynomial through the first two minutes. Its covariance is much
    larger than its errors.
    """
    there = np.flatnonzero(~np.isnan(log.z[:, 0]))[:13]
    fit = np.polynomial.polynomial.polyfit(log.times[there] - log.times[0], log.z[there], 5)
    return Gaussian(np.concatenate([fit[0], fit[1]]), np.diag([100.0**2] * 3 + [1.0] * 3))


# -- settings, from 2 and 3 August -----------------------------------------------------------------
DEGREE, TRAINED = 16, 8500
"""Degree of the gravity field; number of epochs of each day that a likelihood uses."""
SCREEN, SCREENED_M = Setting(4.0, 0.95, 1e-4), 6.0
"""Setting of a filter that detects outlying fixes, and its limit for innovations (m). The screened
likelihood omits fixes with a larger innovation.
"""


DOF = 4.0
"""Degrees of freedom of Student's t: the default of `celnav.filters.adaptive.student_t`, not a fit.
"""
SETTINGS = {
    "robust": Setting(1.877, 0.9773, 2.545e-4),
    "screened": Setting(1.43, 0.898, 3.83e-4),
    "normal": Setting(0.938, 0.673, 1.71e-3),
    "by correlation": Setting(3.35, 0.9907, 9.1e-5),
    "white, by NIS": Setting(1.148, 0.0, 2.545e-4),
    "white, by likelihood": Setting(0.519, 0.0, 0.01546),
}
"""Settings of the filters.

robust: maximum likelihood of all fixes, with Student's t of `DOF` for the increments of errors.
colored: as robust, with the variance of that distribution.
screened: maximum Gaussian likelihood without fixes that are off by `SCREENED_M`.
normal: maximum Gaussian likelihood of all fixes; a few fixes dominate it.
by correlation: standard deviation of the residuals, and the lag at which their correlation is 1/e.
white: as colored, without correlation.
white, inflated: R times (1 + phi) / (1 - phi), which is correct for the mean of many fixes.
white, by NIS: R gives a correct NIS.
white, by likelihood: R and Q maximize the likelihood of white Gaussian errors.
shortest, longest: one fixed time constant, an end of `TAU_S`, with the largest σ.
bound: the range `TAU_S` of time constants, with the largest σ; ``phi`` is that of the bound.
"""
_scale, _phi, _q = SETTINGS["robust"]
_sigma = _scale * float(np.sqrt(DOF / (DOF - 2.0)))
SETTINGS |= dict.fromkeys(("white", "white, gated"), Setting(_sigma, 0.0, _q))
SETTINGS |= dict.fromkeys(("colored", "augmented", "without z_0"), Setting(_sigma, _phi, _q))
SETTINGS["white, inflated"] = Setting(_sigma * float(np.sqrt((1.0 + _phi) / (1.0 - _phi))), 0.0, _q)
_fits = [SETTINGS[name] for name in ("robust", "screened", "normal", "by correlation")]
_taus = [-STEP_S / float(np.log(fit.phi)) for fit in _fits]
TAU_S = min(_taus), max(_taus)
"""Shortest and longest time constant (s) of the four fits to the fixes of 2 and 3 August."""
_largest = max(_sigma, *(fit.sigma for fit in _fits))
for _name, _tau in zip(("shortest", "longest", "bound"), (*TAU_S, np.sqrt(np.prod(TAU_S)))):
    SETTINGS[_name] = Setting(_largest, float(np.exp(-STEP_S / _tau)), _q)


class Training(NamedTuple):
    """Two days of fixes as two runs, relative to a trajectory that is accurate to some meters.

    times: s ``(T,)``. z: fixes minus the trajectory ``(T, 2, 3)``.
    u: transition of the state minus the trajectory over each interval; matrices ``(T - 1, 2, 6,
    6)`` and offsets ``(T - 1, 2, 6)``.
    prior: of both runs. far: whether a fix is off by `SCREENED_M`, ``(T, 2, 1)``.
    """

    times: Array
    z: Array
    u: tuple[Array, Array]
    prior: Gaussian
    far: Array

    def screened(self) -> Training:
        """The `Training` without outlying fixes."""
        return self._replace(z=np.where(self.far, np.nan, self.z))


def training(paths: Sequence[Path], field: gravity.Gravity, count: int) -> Training:
    """The first ``count`` epochs of two days, relative to the trajectory of a filter with the
    setting `SCREEN`.

    Within meters of the trajectory the motion is linear to 1e-11 m/s^2. So it is linearized once,
    not in each run of a search.
    """
    logs = [read(path) for path in paths]
    each = [prior(log) for log in logs]
    both = Gaussian(np.stack([one.mean for one in each]), each[0].cov)
    times, z = STEP_S * np.arange(count), np.stack([log.z[:count] for log in logs], 1)
    u = Around(
        *(
            np.stack(parts, 1)
            for parts in zip(*(around(log.times[:count]) for log in logs), strict=True)
        )
    )
    M, S, Phi = believed(field, SCREEN)
    track = run(colored(M, S, Phi), both, times, z, u, keep="mean")
    aside = np.repeat([10.0, 1e-2], 3)
    points = np.concatenate([np.diag(aside), -np.diag(aside), np.zeros((1, 6))])
    # Pieces of 200 epochs, because all epochs together would need gigabytes.
    pieces = [slice(k, min(k + 200, count - 1)) for k in range(0, count - 1, 200)]
    moved = np.concatenate(
        [
            step(
                track.mean[p, :, None] + points,
                Epoch(dt=STEP_S, u=Around(*(part[p, :, None] for part in u))),
                field,
            )
            for p in pieces
        ]
    )
    far = (
        np.any(np.abs(track.innovation) > SCREENED_M, -1, keepdims=True)
        & (times > 0.0)[:, None, None]
    )
    F = np.moveaxis((moved[..., :6, :] - moved[..., 6:12, :]) / (2.0 * aside[:, None]), -2, -1)
    at_start = Gaussian(both.mean - track.mean[0], both.cov)
    return Training(
        times, z - track.mean[..., :3], (F, moved[..., 12, :] - track.mean[1:]), at_start, far
    )


def linear(believed: tuple[Motion, Sensor, Array]) -> tuple[Motion, Sensor, Array]:
    """The model for the state minus the trajectory of a `Training`."""
    M, S, Phi = believed
    return Motion(lambda x, epoch: matvec(epoch.u[0], x) + epoch.u[1], sqrt_Q=M.noise), S, Phi


def trained(field: gravity.Gravity, setting: Settings, kind: str = "colored") -> Filter:
    """A filter for a `Training`.

    kind: "colored"; "white"; or "tails", colored with Student's t for the increments of a fix's
    errors (see `Weighed`).
    """
    M, S, Phi = linear(believed(field, setting))
    if kind == "white":
        return ukf(M, S)
    return (
        Weighed(colored(M, S, Phi, hooks=weighing(DOF))) if kind == "tails" else colored(M, S, Phi)
    )


def fitted(data: Training, field: gravity.Gravity, start: Setting, kind: str = "colored") -> Tuned:
    """Maximum-likelihood ``sigma``, ``q``, and ``phi`` for colored noise.

    kind: see `trained`.
    """

    def build(parameters: Array) -> tuple[Filter, Gaussian]:
        sigma, q, *phi = parameters
        return trained(field, Setting(sigma, phi[0] if phi else 0.0, q), kind), data.prior

    color = kind != "white"
    first, domain = (
        [start.sigma, start.q, *([start.phi] * color)],
        ["positive", "positive", *(["unit interval"] * color)],
    )
    return maximize_likelihood(
        build, first, epochs(data.times, data.z, data.u), domain=domain, factor=30.0, tolerance=0.1
    )


def weighing(dof: float) -> list[Any]:
    """Hooks: the log-density of an innovation under Student's t, then the corresponding weights."""

    def density(_memory: Any, joint: Joint, _epoch: Any) -> tuple[Array, Joint]:
        V: Any = joint.measurement_noise
        used = ~np.isnan(joint.innovation)
        S = np.where(
            used[..., None] & used[..., None, :],
            joint.covariances()[0] + V @ V.mT,
            np.eye(V.shape[-2]),
        )
        root = cholesky(S)
        u = whiten(root, np.where(used, joint.innovation, 0.0))
        most = gammaln(0.5 * (dof + 1.0)) - gammaln(0.5 * dof) - 0.5 * np.log(dof * np.pi)
        each = (
            most - 0.5 * (dof + 1.0) * np.log(1.0 + u * u / dof) - np.log(root.diagonal(0, -2, -1))
        )
        return np.asanyarray(np.where(used, each, 0.0).sum(-1)), joint

    return [density, student_t(dof)]


@dataclass(frozen=True, eq=False)
class Weighed:
    """A filter with the hooks of `weighing`; its likelihood is Student's t."""

    filter: Any

    def start(self, prior: Gaussian) -> Any:
        """State of the filter before the first epoch."""
        return self.filter.start(prior)

    def step(self, state: Any, epoch: Epoch) -> tuple[Any, tuple[Info, ...]]:
        """Step of the filter, with the density from its first hook in the information."""
        state, (info,) = self.filter.step(state, epoch)
        return state, (info if state.memory is None else info._replace(mixture=state.memory[0]),)
