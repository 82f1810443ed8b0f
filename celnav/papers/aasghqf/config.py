"""The paper's parameters, and those it does not give."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array
from celnav.models import earth
from celnav.models.earth import Flight, turning_flight
from celnav.study.montecarlo import steps

TITLE = "Adaptive anisotropic sparse Gauss-Hermite quadrature filter for star, SAR and inertial navigation"
CITATION = """\
@article{Liang2014,
  author  = {Liang, H. and Mu, R. and Cui, N. and Wang, D.},
  title   = {Adaptive anisotropic SGHQF and its application to integrated navigation},
  journal = {Control and Decision},
  year    = {2014},
  note    = {in Chinese; received May 2014, revised August 2014}
}"""

PAPER_WEIGHTS = (1, 1, 2, 2, 2, 1, 1, 2, 2, 2, 2, 2, 2)
"""Weights of the sparse grid in Table 2."""
NONLINEAR_WEIGHTS = (1, 1, 1) + (2,) * 10
"""Weights by nonlinearity: 57 points."""
MICRO_G = 1e-6 * earth.STANDARD_GRAVITY


@dataclass(frozen=True)
class Config:
    """Everything that a run of the study depends on.

    Attributes
    ----------
    longitude_deg: of the start.
    latitude_deg: of the start.
    height_m: above the ellipsoid, constant.
    speed_m_per_s: over the ground, at the start.
    heading_deg: from north to east, at the start.
    acceleration_m_per_s2: along the track, constant.
    turn_rate_deg_per_s: to the right, constant.
    step_s: interval of the filters' steps.
    steps: in a run.
    runs: of a Monte Carlo.
    level: accuracy level of the sparse grids.
    threshold: degree of observability beyond which a state is weighted 1, in the paper's Table 2.
    misalignment_deg: of the platform at the start, standard deviations east, north and up.
    velocity_m_per_s: standard deviation of the velocity at the start, east and north.
    position_m: standard deviation of the position at the start, east and north.
    drift_deg_per_h: standard deviation of each gyro's constant drift.
    bias_ug: standard deviation of each accelerometer's constant bias.
    angle_walk_deg_per_sqrt_h: noise of the gyros.
    velocity_walk_ug_per_sqrt_hz: noise of the accelerometers.
    star_arcsec: noise of a star fix, standard deviation on each component of a star's direction.
    sar_m: noise of a fix by radar, standard deviation east and north.
    star_interval: steps from one star fix to the next.
    sar_interval: steps from one radar fix to the next.

    Raises
    ------
    ValueError: naming the parameter that cannot be.
    """

    longitude_deg: float = 110.0  # paper
    latitude_deg: float = 40.0  # paper
    height_m: float = 20000.0  # chosen: a "high-altitude vehicle", constant
    speed_m_per_s: float = 200.0  # paper
    heading_deg: float = 65.0  # paper
    acceleration_m_per_s2: float = 0.5  # paper; along the track (inferred)
    turn_rate_deg_per_s: float = 0.1  # paper; to the right (chosen)
    step_s: float = 1.0  # chosen
    steps: int = 500  # paper
    runs: int = 50  # paper
    level: int = 3  # paper
    threshold: float = 5.0  # paper
    misalignment_deg: tuple[float, float, float] = (10.0, 10.0, 10.0)  # not in the paper: "large"
    velocity_m_per_s: float = 1.0  # chosen
    position_m: float = 50.0  # chosen
    drift_deg_per_h: float = 0.1  # paper; as the deviation of a random constant
    bias_ug: float = 200.0  # paper; ditto
    angle_walk_deg_per_sqrt_h: float = 0.01  # not in the paper
    velocity_walk_ug_per_sqrt_hz: float = 20.0  # not in the paper
    star_arcsec: float = 20.0  # paper; for each component of a star's vector (inferred)
    sar_m: float = 18.0  # paper; for each axis
    star_interval: int = 1  # steps between star fixes: not in the paper
    sar_interval: int = 1  # steps between SAR fixes: not in the paper

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            finite(name, getattr(self, name), (3,) if name == "misalignment_deg" else ())
        for name in ("steps", "runs", "level", "star_interval", "sar_interval"):
            value = getattr(self, name)
            if value < 1 or value != int(value):
                raise ValueError(f"{name}: expected a positive integer, got {value!r}")
        steps("steps", self.steps)
        for name in ("step_s", "velocity_m_per_s", "position_m", "drift_deg_per_h", "bias_ug", "star_arcsec", "sar_m"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)!r}")
        for name in ("angle_walk_deg_per_sqrt_h", "velocity_walk_ug_per_sqrt_hz"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name}: expected a number that is not negative, got {getattr(self, name)!r}")
        if min(self.misalignment_deg) <= 0.0:
            raise ValueError(f"misalignment_deg: expected positive numbers, got {self.misalignment_deg!r}")

    @property
    def idle(self) -> dict[str, str]:
        """Parameters without effect, and why."""
        return {"threshold": "on filters: it belongs to the paper's Table 2"}

    @property
    def samples(self) -> int:
        """Of the trajectory, in a run."""
        return 2 * self.steps

    @property
    def end_s(self) -> float:
        """The last epoch, s."""
        return self.step_s * self.steps

    @property
    def times(self) -> Array:
        """Epochs ``(steps + 1,)`` s."""
        return self.step_s * np.arange(self.steps + 1)

    @cached_property
    def flight(self) -> Flight:
        """Truth at the epochs and in the middles between them, ``2 steps + 1`` epochs."""
        return self.flight_at(0.5 * self.step_s * np.arange(2 * self.steps + 1))

    def flight_at(self, times: Array) -> Flight:
        """Truth at ``times (T,)`` s, the start first."""
        return turning_flight(
            times,
            longitude=float(np.radians(self.longitude_deg)),
            latitude=float(np.radians(self.latitude_deg)),
            height_m=self.height_m,
            speed=self.speed_m_per_s,
            heading=float(np.radians(self.heading_deg)),
            acceleration=self.acceleration_m_per_s2,
            turn_rate=float(np.radians(self.turn_rate_deg_per_s)),
        )

    @property
    def meters(self) -> Array:
        """Meters per radian of longitude and latitude at the start, ``(2,)``."""
        return meters_per_radian(np.radians(self.latitude_deg), self.height_m)

    @property
    def sigma0(self) -> Array:
        """Standard deviations ``(13,)`` of the prior."""
        return np.concatenate(
            [
                np.radians(self.misalignment_deg),
                [self.velocity_m_per_s] * 2,
                self.position_m / self.meters,
                [np.radians(self.drift_deg_per_h) / 3600.0] * 3,
                [self.bias_ug * MICRO_G] * 3,
            ]
        )

    @property
    def sqrt_Q(self) -> Array:
        """Columns ``(13, 5)`` of the process noise of one step: misalignment and velocity walk."""
        angle = np.radians(self.angle_walk_deg_per_sqrt_h) / 60.0
        velocity = self.velocity_walk_ug_per_sqrt_hz * MICRO_G
        return np.asarray(np.eye(13, 5) * (np.repeat([angle, velocity], [3, 2]) * np.sqrt(self.step_s)))

    @property
    def sigma_star(self) -> float:
        """Deviation of a component of a star's vector, rad."""
        return float(np.radians(self.star_arcsec / 3600.0))

    def sigma_z(self, latitude: float) -> Array:
        """Deviations ``(8,)`` of all measurements at a latitude: two star vectors, longitude, latitude."""
        return np.concatenate([np.full(6, self.sigma_star), self.sar_m / meters_per_radian(latitude, self.height_m)])


def meters_per_radian(latitude: float, height_m: float) -> Array:
    """``(2,)``: of longitude, of latitude."""
    east = (earth.transverse_radius(latitude) + height_m) * np.cos(latitude)
    return np.array([east, earth.meridian_radius(latitude) + height_m])


A = Config()
A_SLOW = replace(A, star_interval=10, sar_interval=20)
T3 = replace(
    A,
    misalignment_deg=(25.0, 20.0, 12.0),
    star_interval=30,
    sar_interval=25,
    angle_walk_deg_per_sqrt_h=1.0,
    velocity_walk_ug_per_sqrt_hz=50.0,
)
T3_ARCMIN = replace(T3, misalignment_deg=(20.0, 15.0, 7.0), star_arcsec=1200.0, star_interval=20, sar_interval=10)
PRESETS = {"T3": T3, "A": A, "A-slow": A_SLOW, "T3-arcmin": T3_ARCMIN}
