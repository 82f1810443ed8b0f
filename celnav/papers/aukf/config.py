"""The paper's parameters, and those it does not give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from celnav.gaussian.checks import finite, integer
from celnav.gaussian.linalg import Array
from celnav.receiver.filters import CRYSTAL, process_noise, transition
from celnav.study.montecarlo import steps

TITLE = "Adaptive unscented Kalman filter for BeiDou positioning"
CITATION = """\
@article{Fan,
  author  = {Fan, L. and Chen, A. and Chen, S. and Han, L.},
  title   = {An adaptive unscented {Kalman} filter for {BeiDou} receiver positioning},
  note    = {in Chinese; year and journal are not in the text available, which has lost its display equations and Table 1}
}"""
STANDARD_GRAVITY = 9.80665
LONGEST_WINDOW = 100_000
CHOICES = {"burst": ("none", "ranges", "both", "one")}


@dataclass(frozen=True)
class Config:
    """Everything that a run of the study depends on.

    Attributes
    ----------
    speed_m_per_s: of the receiver, on a level circle.
    acceleration_g: towards the circle's center.
    height_m: above the ellipsoid.
    latitude_deg: of the circle.
    longitude_deg: of the circle.
    interval_s: of the measurements.
    duration_s: of a run.
    mask_deg: least elevation of satellites.
    sigma_range_m: noise of a range, standard deviation: what the filters take it for.
    sigma_rate_m_per_s: noise of a range rate, standard deviation.
    true_sigma_range_m: noise of a range, standard deviation: what it is.
    burst: which measurements a burst disturbs: none, all ranges, both ranges and rates, or the range of one satellite.
    burst_s: start and end of the burst.
    burst_sigma: size of the burst, m on ranges and m/s on rates.
    burst_satellite: which satellite a burst on one disturbs, counted from 0.
    acceleration_noise_m2_per_s3: density of the white acceleration in the filters; left out: acceleration_g squared, times
        interval_s.
    clock_white_m2_per_s: density of the white noise of the receiver clock's frequency.
    clock_walk_m2_per_s3: density of its random walk.
    bias_m: true error of the receiver's clock at the start, as a range.
    drift_m_per_s: true rate of that error at the start.
    deviation: standard deviations of the prior: position (m), velocity (m/s), clock (m) and its rate (m/s).
    window: epochs over which the adaptive filter averages residuals.
    alpha: spread of the sigma points.
    beta: weight of the sigma points' center in the covariance; 2 is best for Gaussians.
    runs: of a Monte Carlo.

    Raises
    ------
    ValueError: naming the parameter that cannot be.
    """

    speed_m_per_s: float = 400.0  # paper
    acceleration_g: float = 4.0  # paper
    height_m: float = 800.0  # paper
    latitude_deg: float = 32.03  # inferred
    longitude_deg: float = 118.85  # inferred
    interval_s: float = 0.1  # chosen: at 10 Hz the paper's result in the burst appears
    duration_s: float = 90.0  # chosen
    mask_deg: float = 10.0  # chosen
    sigma_range_m: float = 3.0  # chosen: what the filters take the noise for
    sigma_rate_m_per_s: float = 0.1  # chosen
    true_sigma_range_m: float = 3.0  # chosen: what it is
    burst: str = "ranges"  # chosen: the paper does not say which channels
    burst_s: tuple[float, float] = (60.0, 70.0)  # paper
    burst_sigma: float = 50.0  # paper; m and m/s
    burst_satellite: int = 2  # chosen: its place among the visible ones
    acceleration_noise_m2_per_s3: float | None = None  # inferred: None stands for a^2 T
    clock_white_m2_per_s: float = CRYSTAL[0]  # chosen
    clock_walk_m2_per_s3: float = CRYSTAL[1]  # chosen
    bias_m: float = 3e4  # chosen
    drift_m_per_s: float = 30.0  # chosen
    deviation: tuple[float, float, float, float] = (10.0, 1.0, 10.0, 1.0)  # chosen: m, m/s, m, m/s
    window: int = 10  # chosen: the paper says M
    alpha: float = 1.0  # chosen
    beta: float = 2.0  # paper
    runs: int = 100

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int, ...]] = {"burst_s": (2,), "deviation": (4,)}
        for name in self.__dataclass_fields__:
            if name != "burst" and (name, getattr(self, name)) != ("acceleration_noise_m2_per_s3", None):
                finite(name, getattr(self, name), shapes.get(name, ()))
        positive = ("speed_m_per_s", "acceleration_g", "interval_s", "duration_s", "sigma_range_m", "sigma_rate_m_per_s",
                    "true_sigma_range_m", "burst_sigma", "alpha")  # fmt: skip
        for name in positive:
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)!r}")
        for name in ("acceleration_noise_m2_per_s3", "clock_white_m2_per_s", "clock_walk_m2_per_s3"):
            if (getattr(self, name) or 0.0) < 0.0:
                raise ValueError(f"{name}: expected a number that is not negative, got {getattr(self, name)!r}")
        for name, largest in (("latitude_deg", 90.0), ("longitude_deg", 360.0)):
            if abs(getattr(self, name)) > largest:
                raise ValueError(f"{name}: expected at most {largest:g} degrees, got {getattr(self, name)!r}")
        if not 0.0 <= self.mask_deg < 90.0:
            raise ValueError(f"mask_deg: expected degrees from 0 to below 90, got {self.mask_deg!r}")
        if self.burst_s[0] >= self.burst_s[1]:
            raise ValueError(f"burst_s: expected a start before an end, got {self.burst_s!r}")
        if isinstance(self.burst_satellite, bool) or int(self.burst_satellite) != self.burst_satellite or self.burst_satellite < 0:
            raise ValueError(f"burst_satellite: expected a place from 0 on, got {self.burst_satellite!r}")
        if min(self.deviation) <= 0.0:
            raise ValueError(f"deviation: expected positive numbers, got {self.deviation!r}")
        if self.burst not in CHOICES["burst"]:
            raise ValueError(f"burst: expected one of {', '.join(CHOICES['burst'])}, got {self.burst!r}")
        steps("duration_s", self.duration_s / self.interval_s)
        for name in ("window", "runs"):
            integer(name, getattr(self, name))
        if self.window > LONGEST_WINDOW:
            raise ValueError(f"window: expected at most {LONGEST_WINDOW} epochs, which are all held, got {self.window:g}")

    @property
    def idle(self) -> dict[str, str]:
        """Parameters without effect in this configuration, and why."""
        if self.burst == "none":
            return dict.fromkeys(("burst_s", "burst_sigma", "burst_satellite"), "without a burst")
        return {} if self.burst == "one" else {"burst_satellite": "where the burst is not on one satellite"}

    @property
    def samples(self) -> int:
        """Steps of a run."""
        return round(self.duration_s / self.interval_s)

    @property
    def end_s(self) -> float:
        """The last epoch, s."""
        return self.interval_s * self.samples

    @property
    def times(self) -> Array:
        """Epochs ``(T,)`` s."""
        return self.interval_s * np.arange(self.samples + 1)

    @property
    def radius_m(self) -> float:
        """Of the circle."""
        return self.speed_m_per_s**2 / (self.acceleration_g * STANDARD_GRAVITY)

    @property
    def turn_rate(self) -> float:
        """rad/s."""
        return self.acceleration_g * STANDARD_GRAVITY / self.speed_m_per_s

    def sigma(self, S: int) -> Array:
        """What filters take for the deviations of S ranges and S rates, ``(2 S,)`` m and m/s."""
        return np.repeat([self.sigma_range_m, self.sigma_rate_m_per_s], S)

    @property
    def F(self) -> Array:
        """Constant velocity and clock drift over an interval, ``(8, 8)``."""
        return transition(self.interval_s)

    @property
    def acceleration_noise(self) -> float:
        """Density of the white acceleration, m^2/s^3: ``a^2 T``, if it is not given, makes up for a constant one."""
        given = self.acceleration_noise_m2_per_s3
        return given if given is not None else (self.acceleration_g * STANDARD_GRAVITY) ** 2 * self.interval_s

    @property
    def Q(self) -> Array:
        """Process noise of an interval, ``(8, 8)``."""
        c = self
        return process_noise(c.interval_s, c.acceleration_noise, c.clock_white_m2_per_s, c.clock_walk_m2_per_s3)

    @property
    def P0(self) -> Array:
        """Covariance of the prior, ``(8, 8)``."""
        position, velocity, bias, drift = self.deviation
        return np.diag(np.square([position] * 3 + [velocity] * 3 + [bias, drift]))


STANDARD = Config()
PRESETS = {
    "burst": STANDARD,
    "quiet": replace(STANDARD, burst="none"),
    "mistuned": replace(STANDARD, burst="none", true_sigma_range_m=10.0),
    "1 Hz": replace(STANDARD, interval_s=1.0),
}
