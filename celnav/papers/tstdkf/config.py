"""The paper's parameters, and those it does not give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array
from celnav.models import orbit
from celnav.models.ephemeris import Tdb, from_utc
from celnav.models.pulsar import LIGHT_KM_S, Timing, pulsars
from celnav.study.montecarlo import steps

TITLE = "Two-stage strong-tracking differential Kalman filter for X-ray pulsars"
CITATION = """\
@article{Xu2024,
  author  = {Xu, Q. and Cui, H. and Ding, B. and Zhao, A. and Zhao, Y.},
  title   = {Two-stage strong-tracking differential {Kalman} filter for {X}-ray pulsar navigation considering coloured noise},
  year    = {2024},
  note    = {in Chinese; the text available has lost its display equations and the bodies of its tables}
}"""
YEAR_S = 365.25 * 86400.0
DAY_S = 86400.0
KAPPA = 4.8
"""Tuned, with the amplitudes of the bias, to the paper's percentages of position in setting 1."""


@dataclass(frozen=True)
class Setting:
    """One row of Table 4: AR(1) coefficients of both noises, and how strongly they are correlated.

    Attributes
    ----------
    F: color of the measurement noise, a number below 1 in size; its increments are as large as the pulsars are timed, so that the
        noise grows with it.
    L: color of the process noise, likewise.
    kappa: how strongly the increments of both are correlated.
    """

    F: float
    L: float
    kappa: float


SETTINGS = {
    1: Setting(0.5, 0.5, KAPPA),
    2: Setting(0.5, 0.5, 0.0),
    3: Setting(0.5, 0.0, 0.0),
    4: Setting(0.0, 0.5, 0.0),
    5: Setting(0.0, 0.0, 0.0),
}
"""Table 4, as inferred: everything, ..., all noise white."""


CHOICES = {
    "trend": ("sine", "growing", "triangle", "constant"),
    "initial": ("paper", "drawn"),
    "pulled": (False, True),
    "factor": ("excess", "proportional"),
}


@dataclass(frozen=True)
class Config:
    """Everything that a run of the study depends on.

    Attributes
    ----------
    start_utc: date and time of the start, UTC.
    step_s: interval of the measurements; pulses are timed over it, so a longer one is timed better.
    days: length of a run, days.
    runs: of a Monte Carlo.
    pulsars: names of the three that are timed.
    elements: of the orbit: semi-major axis (km), eccentricity, inclination, node, perigee and true anomaly (deg).
    error_km: error of the position at the start, each axis, and its standard deviation in the prior.
    error_m_per_s: error of the velocity at the start, each axis, and its standard deviation in the prior.
    rate_noise_km_per_s: process noise that drives the position's rate, standard deviation on each axis.
    acceleration_noise_km_per_s2: process noise that drives the velocity's rate, standard deviation on each axis.
    setting: color of both noises, see `Setting`.
    amplitude_km: of the error of the Earth's ephemeris, each axis.
    phase: of that error's year, each axis, rad.
    trend: how that error goes on: over a year's sine, growing, a triangle, or constant and drawn from its prior.
    initial: whether every run starts with the error above (paper) or with one drawn from the prior.
    pulled: whether Sun and Moon pull at the satellite.
    bias_prior_km: standard deviation of the ephemeris error at the start, on each axis, in the filters.
    walk_km: how far the exact filter lets that error walk in a step, standard deviation on each axis.
    rho: how strongly the fading factors answer, each pulsar.
    tau: window of the fading factors, in measurements.
    factor: form of the fading factors: of what residuals exceed, or proportional to them.

    Raises
    ------
    ValueError: naming the parameter that cannot be.
    """

    start_utc: str = "2015-10-17T04:00:00"  # paper
    step_s: float = 300.0  # paper
    days: float = 30.0  # paper
    runs: int = 50  # paper
    pulsars: tuple[str, ...] = ("B0531+21", "B1821-24", "B1937+21")  # paper
    elements: tuple[float, ...] = (7136.635, 1.809e-3, 65.0, 30.0, 30.0, 0.0)  # chosen: a km, e, and angles in deg
    error_km: tuple[float, float, float] = (1.0, 1.0, 1.0)  # paper
    error_m_per_s: tuple[float, float, float] = (0.02, 0.02, 0.02)  # paper
    rate_noise_km_per_s: float = 1e-8  # paper; unit inferred
    acceleration_noise_km_per_s2: float = 1e-10  # paper; unit inferred
    setting: Setting = SETTINGS[1]
    amplitude_km: tuple[float, float, float] = (0.09, 0.12, 0.075)  # chosen, tuned with kappa: "sub-km"
    phase: tuple[float, float, float] = (0.0, 0.5 * np.pi, 0.25 * np.pi)  # chosen
    trend: str = "sine"  # Eqs 17, 69, 70: "sine", "growing", "triangle"; or "constant": drawn from its prior
    initial: str = "paper"  # error at the start: the paper's, or "drawn" from the prior
    pulled: bool = False  # whether Sun and Moon pull at the satellite
    bias_prior_km: float = 0.3  # chosen
    walk_km: float = 5e-5  # chosen: of the exact filter's bias, each step
    rho: tuple[float, float, float] = (8.0, 15.0, 9.0)  # paper
    tau: float = 100.0  # paper
    factor: str = "excess"  # chosen: form C; "proportional" is B

    def __post_init__(self) -> None:
        vectors = ("error_km", "error_m_per_s", "amplitude_km", "phase", "rho")
        words = ("start_utc", "pulsars", "setting", *CHOICES)
        shapes: dict[str, tuple[int, ...]] = {"elements": (6,), **dict.fromkeys(vectors, (3,))}
        for name in self.__dataclass_fields__:
            if name not in words:
                finite(name, getattr(self, name), shapes.get(name, ()))
        for name in ("step_s", "days", "runs", "bias_prior_km", "rate_noise_km_per_s", "acceleration_noise_km_per_s2"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)!r}")
        if self.runs != int(self.runs):
            raise ValueError(f"runs: expected a positive integer, got {self.runs!r}")
        if len(self.pulsars) != 3:
            raise ValueError(f"pulsars: expected 3 names, got {', '.join(self.pulsars) or 'none'}")
        steps("days", self.days * DAY_S / self.step_s)
        if self.walk_km < 0.0:
            raise ValueError(f"walk_km: expected a number that is not negative, got {self.walk_km!r}")
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                raise ValueError(f"{name}: expected one of {', '.join(map(str, known))}, got {getattr(self, name)!r}")
        if min(self.error_km + self.error_m_per_s) <= 0.0:
            raise ValueError("error_km, error_m_per_s: expected positive numbers, which are the prior's deviations too")

    @property
    def steps(self) -> int:
        """Measurements."""
        return round(self.days * DAY_S / self.step_s)

    @property
    def samples(self) -> int:
        """Steps of a run."""
        return self.steps

    @property
    def end_s(self) -> float:
        """The last measurement, s."""
        return self.step_s * self.steps

    @property
    def start(self) -> Tdb:
        """The start epoch."""
        return from_utc(self.start_utc)

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
        """Deviations ``(3,)`` of the timings after an interval, km."""
        return np.array([p.timing_std(self.step_s) for p in pulsars(self.pulsars)]) * LIGHT_KM_S

    @property
    def deviation(self) -> Array:
        """Deviations of the prior, which are the initial errors, ``(6,)`` km and km/s."""
        return np.concatenate([self.error_km, np.asarray(self.error_m_per_s) * 1e-3])

    @property
    def process_std(self) -> Array:
        """Driving noise of the rates ``(6,)``, km/s and km/s^2."""
        return np.repeat([self.rate_noise_km_per_s, self.acceleration_noise_km_per_s2], 3)

    def coupling(self, kappa: float) -> Array:
        """``J (6, 3)``: two diagonal blocks, in deviations of the driving noises."""
        unit = np.vstack([np.diag(1.0 / self.sigma_km), np.diag(1.0 / self.sigma_km)])
        return kappa * self.process_std[:, None] * unit

    def bias(self, t: Array) -> Array:
        """Error ``(..., 3)`` km of the Earth's ephemeris, ``t`` seconds after the start [Xu2024, Eqs 17, 69, 70; inferred].

        Of a trend that is a function of time.
        """
        angle = 2.0 * np.pi / YEAR_S * np.asarray(t)[..., None]
        A, phase = np.asarray(self.amplitude_km), np.asarray(self.phase)
        if self.trend == "sine":
            return np.asarray(A * np.sin(angle + phase))
        if self.trend == "growing":
            return np.asarray(A * (1.5 * angle / (2.0 * np.pi) - 0.75 + 0.5 * np.sin(2.0 * angle + phase)))
        return np.asarray(A * (2.0 / np.pi) * np.arcsin(np.cos(angle + phase)))


TABLE_5 = Config()
WHITE = replace(TABLE_5, setting=SETTINGS[5])
YEAR = replace(TABLE_5, days=365.0, runs=3, setting=Setting(0.5, 0.5, 4.5), walk_km=1e-4)
PRESETS = {"table5": TABLE_5, "white": WHITE, "year": YEAR}
