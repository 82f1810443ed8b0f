"""The paper's parameters, and those it does not give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array
from celnav.models.gyro import Body, Gyro
from celnav.study.montecarlo import steps

TITLE = "State-switching unscented Kalman filter for attitude"
CITATION = """\
@article{Wu2012,
  author  = {Wu, Bo and Xu, Huan and Qiao, Xiangwei},
  title   = {State-switching unscented Kalman filter for attitude determination of a satellite},
  year    = {2012},
  note    = {in Chinese; the text available has lost its equations, curves and the numbers of Table 1}
}"""
ARCSEC = np.pi / 648000.0
"""rad."""
DEG_PER_H = np.pi / 648000.0
"""rad/s."""
UNITS = np.repeat([ARCSEC, DEG_PER_H], 3)
"""What errors of rotation vector and drift are divided by, ``(6,)``: arcsec and deg/h."""


@dataclass(frozen=True)
class Config:
    """Everything that a run of the study depends on.

    Attributes
    ----------
    orbit_rate_rad_per_s: of the circular orbit; gravity turns the body with it.
    attitude_deg: true roll, pitch and yaw at the start.
    rate_deg_per_s: true angular velocity at the start, body axes, against the stars.
    inertia: tensor of inertia, body axes, kg m^2.
    wheels: angular momentum of the wheels, body axes, N m s.
    torque: constant disturbance, body axes, N m.
    gyro_hz: samples of the gyro; a whole number for each star sample.
    star_hz: samples of the star sensor.
    gyro_deg_per_h: white noise of one gyro sample, standard deviation on each axis.
    drift_deg_per_h: stationary standard deviation of the gyro's drift, on each axis.
    tau_s: correlation time of the drift.
    bias_deg_per_h: true drift at the start, each axis.
    star_arcsec: noise of the star sensor, standard deviation on each axis.
    prior_deg: standard deviations of the attitude at the start: roll, pitch, yaw.
    prior_drift_deg_per_h: standard deviation of the drift at the start, on each axis.
    alpha: spread of the sigma points.
    kappa: second parameter of the sigma points' spread.
    beta: weight of the sigma points' center in the covariance; 2 is best for Gaussians.
    duration_s: of a run.
    runs: of a Monte Carlo.
    preintegrated: whether gyro samples between two star samples make one time update.

    Raises
    ------
    ValueError: naming the parameter that cannot be.
    """

    orbit_rate_rad_per_s: float = 1e-3  # paper
    attitude_deg: tuple[float, float, float] = (1.0, 2.0, 10.0)  # paper: roll, pitch, yaw; the estimate starts at identity
    rate_deg_per_s: tuple[float, float, float] = (0.01, 0.01, 0.05)  # paper; as inertial body rates (chosen)
    inertia: tuple[tuple[float, float, float], ...] = ((52.0, 1.2, -0.8), (1.2, 47.0, 0.6), (-0.8, 0.6, 61.0))  # chosen: lost
    wheels: tuple[float, float, float] = (0.0, -2.0, 0.0)  # chosen
    torque: tuple[float, float, float] = (1e-6, -1e-6, 0.5e-6)  # chosen
    gyro_hz: float = 100.0  # paper
    star_hz: float = 4.0  # paper
    gyro_deg_per_h: float = 0.5  # paper; the deviation of one sample (inferred)
    drift_deg_per_h: float = 0.02  # paper; the stationary deviation of the drift (inferred)
    tau_s: float = 3600.0  # chosen
    bias_deg_per_h: tuple[float, float, float] = (1.0, 1.0, 1.0)  # paper: drift at the start
    star_arcsec: float = 20.0  # paper; each axis
    prior_deg: tuple[float, float, float] = (1.0, 2.0, 10.0)  # chosen
    prior_drift_deg_per_h: float = 1.0  # chosen
    alpha: float = 0.1  # chosen: "small"
    kappa: float = 0.0  # paper
    beta: float = 2.0  # chosen
    duration_s: float = 600.0  # chosen
    runs: int = 200  # chosen
    preintegrated: bool = True  # chosen: one time update for the samples between two star samples

    def __post_init__(self) -> None:
        vectors = ("attitude_deg", "rate_deg_per_s", "wheels", "torque", "bias_deg_per_h", "prior_deg")
        shapes: dict[str, tuple[int, ...]] = {"inertia": (3, 3), **dict.fromkeys(vectors, (3,))}
        for name in self.__dataclass_fields__:
            finite(name, getattr(self, name), shapes.get(name, ()))
        positive = ("gyro_hz", "star_hz", "tau_s", "star_arcsec", "prior_drift_deg_per_h", "alpha", "duration_s", "runs")
        for name in positive:
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)!r}")
        for name in ("gyro_deg_per_h", "drift_deg_per_h"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name}: expected a number that is not negative, got {getattr(self, name)!r}")
        if min(self.prior_deg) <= 0.0:
            raise ValueError(f"prior_deg: expected positive numbers, got {self.prior_deg!r}")
        if self.runs != int(self.runs):
            raise ValueError(f"runs: expected a positive integer, got {self.runs!r}")
        if abs(self.gyro_hz / self.star_hz - self.ratio) > 1e-9:
            raise ValueError(
                f"gyro_hz: expected a whole number of samples for each star sample, got {self.gyro_hz / self.star_hz:g}"
            )
        steps("duration_s", self.duration_s * self.star_hz)
        steps("duration_s", self.duration_s * self.gyro_hz)
        Body(self.inertia)

    @property
    def ratio(self) -> int:
        """Gyro samples for each star sample."""
        return round(self.gyro_hz / self.star_hz)

    @property
    def gyro_dt(self) -> float:
        """Interval of the gyro's samples, s."""
        return 1.0 / self.gyro_hz

    @property
    def step_s(self) -> float:
        """Interval of the filters' time updates, s."""
        return 1.0 / self.star_hz if self.preintegrated else self.gyro_dt

    @property
    def star_epochs(self) -> int:
        """Star samples in a run."""
        return round(self.duration_s * self.star_hz)

    @property
    def samples(self) -> int:
        """Gyro samples in a run."""
        return self.star_epochs * self.ratio

    @property
    def end_s(self) -> float:
        """The last star sample, s."""
        return (self.star_epochs if self.preintegrated else self.samples) * self.step_s

    @property
    def gyro(self) -> Gyro:
        """The gyro: white noise of a sample and stationary drift, as densities."""
        sigma_v = self.gyro_deg_per_h * DEG_PER_H * float(np.sqrt(self.gyro_dt))
        return Gyro(sigma_v, self.drift_deg_per_h * DEG_PER_H * float(np.sqrt(2.0 / self.tau_s)), self.tau_s)

    @property
    def body(self) -> Body:
        """The satellite."""
        return Body(self.inertia, self.wheels, self.torque, self.orbit_rate_rad_per_s)

    @property
    def sigma_n(self) -> float:
        """Deviation of the star sensor on each axis, rad."""
        return self.star_arcsec * ARCSEC

    @property
    def sigma0(self) -> Array:
        """Deviations ``(6,)`` of the prior: rotation (rad) and drift (rad/s)."""
        return np.concatenate([np.radians(self.prior_deg), np.full(3, self.prior_drift_deg_per_h * DEG_PER_H)])


STANDARD = Config()
FULL_RATE = replace(STANDARD, preintegrated=False)
PRESETS = {"standard": STANDARD, "100 Hz": FULL_RATE}
