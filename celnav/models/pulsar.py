"""X-ray pulsars: directions, timing accuracy, and pulse delays as functions of position. Units: km,
s.

The measurement is the delay of a pulse between the spacecraft and the solar-system barycenter,
times the speed of light, in km. Positions are barycentric, on ICRS axes.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from celnav.files import data
from celnav.gaussian.checks import choice, instance, number, sequence
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import Space

LIGHT_KM_S = 299792.458
GM_SUN = 1.32712440041e11  # km^3/s^2
KPC_KM = 3.0856775814913673e16
BACKGROUND = 0.005  # of X-rays, photons / cm^2 / s
AREA_CM2 = 1e4


@dataclass(frozen=True)
class Pulsar:
    """A pulsar; ValueError for values out of range.

    right_ascension_deg, declination_deg: J2000. distance_kpc: from the Sun. period_s: pulse period.
    width_s: pulse width. flux: photons / cm^2 / s. pulsed_fraction: pulsed part of the flux, up to
        1.
    """

    name: str
    right_ascension_deg: float
    declination_deg: float
    distance_kpc: float
    period_s: float
    width_s: float
    flux: float
    pulsed_fraction: float

    def __post_init__(self) -> None:
        instance("name", self.name, str, "a text, such as 'B1937+21'")
        try:
            number("right_ascension_deg", self.right_ascension_deg)
            number("declination_deg", self.declination_deg, -90.0, 90.0)
            for name in ("distance_kpc", "period_s", "width_s", "flux"):
                number(name, getattr(self, name), above=0.0)
            number("pulsed_fraction", self.pulsed_fraction, above=0.0, most=1.0)
        except ValueError as error:
            raise ValueError(f"{error} for {self.name}") from None

    @cached_property
    def direction(self) -> Array:
        """Unit vector ``(3,)`` from the solar system to the pulsar."""
        ra, dec = np.radians(self.right_ascension_deg), np.radians(self.declination_deg)
        return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])

    @property
    def distance_km(self) -> float:
        """Distance in km."""
        return self.distance_kpc * KPC_KM

    def timing_std(
        self, seconds: float, area_cm2: float = AREA_CM2, background: float = BACKGROUND
    ) -> float:
        """Standard deviation (s) of a pulse's time of arrival from ``seconds`` of observation.

        It is ``W / (2 SNR)``; SNR is the number of pulsed photons over the standard deviation of
        the number of all photons during pulses [Sheikh2006]. area_cm2: of the detector.
        background: of X-rays, photons / cm^2 / s.
        """
        seconds, area_cm2 = (
            number("seconds", seconds, above=0.0),
            number("area_cm2", area_cm2, above=0.0),
        )
        background = number("background", background, 0.0)
        pulsed = self.flux * area_cm2 * self.pulsed_fraction * seconds
        others = (
            (background + self.flux * (1.0 - self.pulsed_fraction))
            * area_cm2
            * seconds
            * self.width_s
            / self.period_s
        )
        return float(0.5 * self.width_s * np.sqrt(others + pulsed) / pulsed)


def known() -> dict[str, Pulsar]:
    """The pulsars in ``data/pulsars.toml`` by name."""
    with data("pulsars.toml").open("rb") as file:
        return {name: Pulsar(name, **values) for name, values in tomllib.load(file).items()}


def pulsars(names: Sequence[str]) -> list[Pulsar]:
    """List of the pulsars in `known` with these names; ValueError for an unknown name."""
    table = known()
    return [
        table[choice("pulsar", name, table)] for name in sequence("names", names, '["B1937+21"]')
    ]


class Timing:
    """Pulse delays of several pulsars as functions of a barycentric position [Sheikh2006]: Roemer,
    parallax and Shapiro terms.

    Delays include whole periods. A measured phase does not: it determines a delay modulo one period
    (467 km for B1937+21), see `uncounted`. ValueError if three or more directions lie in one plane.

    >>> timing = Timing(pulsars(["B0531+21", "B1821-24", "B1937+21"]))
    >>> sensor = celnav.Sensor(lambda x, epoch: timing.delay(earth + x[..., :3], sun), R)
    """

    def __init__(self, pulsars: Sequence[Pulsar]):
        chosen = sequence("pulsars", pulsars, 'celnav.models.pulsar.pulsars(["B1937+21"])', least=1)
        example = 'a Pulsar, such as known()["B1937+21"]'
        self.pulsars: tuple[Pulsar, ...] = tuple(
            instance("pulsars", p, Pulsar, example) for p in chosen
        )
        self.directions = np.stack([p.direction for p in self.pulsars])
        self.distances = np.array([p.distance_km for p in self.pulsars])
        if len(self.pulsars) >= 3 and np.linalg.cond(self.directions) > 1e6:
            raise ValueError(
                "pulsars: expected directions that span space, got directions in one plane"
            )

    @property
    def uncounted(self) -> Space:
        """Measurement `Space` of phases without a pulse count, for ``Sensor(..., space=)``:
        innovations are wrapped to half a period on each side of 0.
        """
        periods = LIGHT_KM_S * np.array([p.period_s for p in self.pulsars])
        return Space(minus=partial(_within_half_a_period, periods))

    def delay(self, position: Array, sun: Array) -> Array:
        """Delays ``(..., m)`` km at positions ``(..., 3)`` km; ``sun (..., 3)`` is the Sun's
        position, km. The Shapiro term is `shapiro`.
        """
        b = -np.asarray(sun)
        along, of_b = position @ self.directions.T, b @ self.directions.T
        square, cross = (terms.sum(-1)[..., None] for terms in (np.square(position), b * position))
        # n.r + ((n.r)^2 - r^2 + 2 (n.b)(n.r) - 2 b.r) / (2 D), where b is minus the Sun's position.
        parallax = (along * along - square + 2.0 * of_b * along - 2.0 * cross) / (
            2.0 * self.distances
        )
        return np.asanyarray(along + parallax + self.shapiro(position, sun))

    def shapiro(self, position: Array, sun: Array) -> Array:
        """Shapiro delay ``(..., m)`` km as most papers print it, with ``|r| + |b|`` where
        `shapiro_exact` has ``|r + b|``.
        """
        ratio = self._reach(position) / self._reach(-np.asarray(sun))
        return np.asanyarray(2.0 * GM_SUN / LIGHT_KM_S**2 * np.log(np.abs(ratio + 1.0)))

    def shapiro_exact(self, position: Array, sun: Array) -> Array:
        """Shapiro delay ``(..., m)`` km between the barycenter and the position, with the exact
        distance from the Sun.
        """
        b = -np.asarray(sun)
        return np.asanyarray(
            2.0 * GM_SUN / LIGHT_KM_S**2 * np.log(self._reach(position + b) / self._reach(b))
        )

    def _reach(self, v: Array) -> Array:
        """``n.v + |v|`` for each pulsar, ``(..., m)`` km."""
        return np.asanyarray(v @ self.directions.T + np.linalg.norm(v, axis=-1, keepdims=True))

    def gradient(self, position: Array, sun: Array) -> Array:
        """Jacobian ``(..., m, 3)`` of `delay` with respect to the position."""
        n, b = self.directions, -np.asarray(sun)
        along, of_b = (position @ n.T)[..., None], (b @ n.T)[..., None]
        radius = np.linalg.norm(position, axis=-1)[..., None, None]
        far = np.linalg.norm(b, axis=-1)[..., None, None]
        parallax = (
            along * n - position[..., None, :] + of_b * n - b[..., None, :]
        ) / self.distances[:, None]
        unit = position[..., None, :] / radius
        # The gradient of log(n.r + |r| + n.b + |b|).
        shapiro = 2.0 * GM_SUN / LIGHT_KM_S**2 * (n + unit) / (along + radius + of_b + far)
        return np.asanyarray(n + parallax + shapiro)


def _within_half_a_period(periods: Array, b: Array, a: Array) -> Array:
    return np.asanyarray(b - a - periods * np.round((b - a) / periods))
