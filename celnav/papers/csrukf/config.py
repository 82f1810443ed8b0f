"""The paper's parameters, and those it does not give."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule, unscented
from celnav.models import orbit
from celnav.models.noise import stationary_covariance
from celnav.study.montecarlo import steps

TITLE = "Square-root unscented Kalman filter for colored measurement noise"
CITATION = """\
@article{Sun2015,
  author  = {Sun, Huimin and Zhuang, Chunqing and Xu, Shengzhong},
  title   = {Square-Root Unscented Kalman Filter for Satellite Autonomous Celestial Navigation System
             with Colored Measurement Noise},
  year    = {2015},
  note    = {in Chinese}
}"""

FARTHEST_KM = 1e6
"""Beyond, the Earth holds no satellites."""
CHOICES = {
    "measured": ("positions", "angles"),
    "noise_level": ("stationary", "increments"),
    "first_noise": ("R", "stationary", "zero"),
}
MISSION = {"noise_level": "stationary"}
"""What a mission begins with instead: how large the noise is then does not depend on its color."""


@dataclass(frozen=True)
class Config:
    """Everything that a run of the study depends on; angles in degrees, as the paper prints them.

    Attributes
    ----------
    semi_major_axis_km: of the orbit.
    eccentricity: of the orbit.
    inclination_deg: of the orbit to the equator.
    raan_deg: right ascension of the ascending node.
    argument_of_perigee_deg: from the ascending node.
    true_anomaly_deg: where on the orbit a run starts, from the perigee.
    step_s: interval of the measurements and of the filters' steps.
    steps: in a run.
    runs: of a Monte Carlo.
    camera_deg: accuracy of the Earth's edges, where angles are measured.
    star_arcsec: accuracy of the directions to stars, where angles are measured.
    separation_deg: angle between the two stars, where angles are measured.
    accuracy_sigmas: how many standard deviations the accuracies of camera and star sensor are.
    sigma_km: standard deviation of the noise of a measured position, on each axis; of which noise, says noise_level.
    noise_level: what sigma_km, or camera_deg and star_arcsec, are the deviation of: the colored noise V itself (stationary),
        however large phi is, or the white increments that drive it, in V' = phi V + increment.
    prior_position_km: standard deviation of the estimate at the start, on each axis.
    prior_velocity_m_per_s: standard deviation of the estimate at the start, on each axis.
    noise_position_km: process noise of one step, standard deviation on each axis.
    noise_velocity_km_per_s: process noise of one step, standard deviation on each axis.
    phi: color of the noise, V' = phi V + increment: 0 is white, 1 a random walk.
    measured: positions, computed from the angles beforehand, or the angles themselves.
    first_noise: covariance of the first noise: that of the increments (R), of the stationary noise, or zero; left out: as
        noise_level.
    alpha: spread of the sigma points.
    beta: weight of the sigma points' center in the covariance; 2 is best for Gaussians.
    kappa: second parameter of the sigma points' spread.

    Raises
    ------
    ValueError: naming the parameter that cannot be.
    """

    semi_major_axis_km: float = 7136.635  # paper
    eccentricity: float = 0.001  # paper
    inclination_deg: float = 65.0  # paper
    raan_deg: float = 30.0  # paper
    argument_of_perigee_deg: float = 30.0  # paper
    true_anomaly_deg: float = 0.0  # chosen: keeps z > 0 for 2499 s
    step_s: float = 1.0  # paper
    steps: int = 600  # paper
    runs: int = 100  # paper
    camera_deg: float = 0.005  # paper; whether 1 or 3 sigma is not stated
    star_arcsec: float = 3.0  # paper; ditto
    separation_deg: float = 90.0  # chosen: the angle between the stars
    accuracy_sigmas: float = 3.0  # inferred: the accuracies are 3-sigma values
    sigma_km: float = 0.2  # inferred: root of the increments' covariance R, each axis
    noise_level: str = "increments"  # inferred, as the paper's R
    prior_position_km: float = 0.15  # inferred by a fit to Tables 1 and 2
    prior_velocity_m_per_s: float = 0.035  # inferred by a fit to Tables 1 and 2
    noise_position_km: float = 7.5e-3  # inferred: root of Q, per step
    noise_velocity_km_per_s: float = 1e-8  # inferred
    phi: float = 0.0  # paper: 0 (case 1), 1 and 0.8 (cases 2 and 3), times the identity
    measured: str = "positions"  # inferred; of "angles" the noise lives on them, and positions are computed from them
    first_noise: str | None = None  # chosen: covariance of V_0; None: of what noise_level says, which is R in the paper
    alpha: float = 1.0  # chosen, with beta and kappa: no negative weight
    beta: float = 0.0
    kappa: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if name not in CHOICES:
                finite(name, getattr(self, name), ())
        for name, known in CHOICES.items():
            if getattr(self, name) not in known and (name, getattr(self, name)) != ("first_noise", None):
                raise ValueError(f"{name}: expected one of {', '.join(known)}, got {getattr(self, name)!r}")
        if self.steps < 1 or self.steps != int(self.steps):
            raise ValueError(f"steps: expected at least 1 (two samples), got {self.steps!r}")
        steps("steps", self.steps)
        if self.runs < 1 or self.runs != int(self.runs):
            raise ValueError(f"runs: expected a positive integer, got {self.runs!r}")
        if abs(self.phi) > 1.0:
            raise ValueError(f"phi: expected a magnitude of at most 1, got {self.phi!r}")
        if self.sigma_km <= 0.0:
            raise ValueError(f"sigma_km: expected a positive number, got {self.sigma_km!r}")
        if self.step_s <= 0.0:
            raise ValueError(f"step_s: expected a positive number, got {self.step_s!r}")
        for name in ("prior_position_km", "prior_velocity_m_per_s", "noise_position_km", "noise_velocity_km_per_s"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name}: expected a number that is not negative, got {getattr(self, name)!r}")
        if not 0.0 <= self.eccentricity < 1.0:
            raise ValueError(f"eccentricity: expected a number of at least 0 and below 1, got {self.eccentricity!r}")
        if not 0.0 <= self.inclination_deg <= 180.0:
            raise ValueError(f"inclination_deg: expected degrees from 0 to 180, got {self.inclination_deg!r}")
        least = orbit.EARTH.radius_km / (1.0 - self.eccentricity)
        if not least < self.semi_major_axis_km < FARTHEST_KM:
            expected = f"an orbit above the Earth, from {least:.6g} to {FARTHEST_KM:g} km"
            raise ValueError(f"semi_major_axis_km: expected {expected}, got {self.semi_major_axis_km!r}")
        if self.noise_level == "stationary" and abs(self.phi) == 1.0:
            walk = "a random walk has no stationary deviation, only its increments have one"
            raise ValueError(f"noise_level: expected 'increments' where phi is {self.phi:g}: {walk}")
        if self.first_noise == "stationary" and abs(self.phi) == 1.0:
            raise ValueError(f"first_noise: expected R or zero where phi is {self.phi:g}, which has no stationary noise")
        unscented(6, self.alpha, self.beta, self.kappa)

    @property
    def idle(self) -> dict[str, str]:
        """Parameters without effect in this configuration, and why."""
        if self.measured == "positions":
            names = ("camera_deg", "star_arcsec", "separation_deg", "accuracy_sigmas")
            return dict.fromkeys(names, "where positions are measured (sigma_km is their noise)")
        return {"sigma_km": "where angles are measured (camera_deg and star_arcsec are their noise)"}

    @property
    def Phi(self) -> Array:
        """Coefficient matrix of the colored noise, ``(3, 3)``."""
        return self.phi * np.eye(3)

    @property
    def samples(self) -> int:
        """Steps of a run."""
        return self.steps

    @property
    def end_s(self) -> float:
        """The last epoch, s."""
        return self.step_s * self.steps

    @property
    def increment(self) -> float:
        """Deviation of the noise increments, in those that are given."""
        return float(np.sqrt(1.0 - self.phi**2)) if self.noise_level == "stationary" else 1.0

    @property
    def R(self) -> Array:
        """Covariance of the noise increments, ``(3, 3)`` km^2."""
        return (self.increment * self.sigma_km) ** 2 * np.eye(3)

    @property
    def white_R(self) -> Array:
        """Covariance that a filter is given which takes the noise for white, ``(3, 3)`` km^2: what `noise_level` says."""
        return self.sigma_km**2 * np.eye(3)

    @property
    def Sigma0(self) -> Array:
        """Covariance of the first noise sample, ``(3, 3)`` km^2."""
        return self._start(self.R)

    @property
    def angle_Sigma0(self) -> Array:
        """The same of measured angles, ``(3, 3)`` rad^2."""
        return self._start(np.diag((self.increment * self.sigma_angles) ** 2))

    def _start(self, R: Array) -> Array:
        first = self.first_noise or ("stationary" if self.noise_level == "stationary" else "R")
        return stationary_covariance(self.Phi, R) if first == "stationary" else R if first == "R" else 0.0 * R

    @property
    def sqrt_Q(self) -> Array:
        """Root of the process noise of one step, ``(6, 6)`` km, km/s."""
        return np.diag(np.repeat([self.noise_position_km, self.noise_velocity_km_per_s], 3))

    @property
    def sqrt_P0(self) -> Array:
        """Root of the prior's covariance, ``(6, 6)`` km, km/s."""
        return np.diag(np.repeat([self.prior_position_km, 1e-3 * self.prior_velocity_m_per_s], 3))

    @property
    def sigma_angles(self) -> Array:
        """Deviations ``(3,)`` rad, as given, of the angles to the stars and of the Earth's diameter."""
        camera, star = np.radians(self.camera_deg), np.radians(self.star_arcsec / 3600.0)
        return np.array([np.hypot(camera, star)] * 2 + [camera]) / self.accuracy_sigmas

    @property
    def separation(self) -> float:
        """Angle between the stars, rad."""
        return float(np.radians(self.separation_deg))

    @property
    def times(self) -> Array:
        """Epochs ``(steps + 1,)`` s."""
        return self.step_s * np.arange(self.steps + 1)

    @property
    def rule(self) -> Rule:
        """Sigma points of the state."""
        return unscented(6, self.alpha, self.beta, self.kappa)

    def initial_state(self) -> Array:
        """True state at the start, ``(6,)`` km, km/s, from the elements."""
        angles = (self.inclination_deg, self.raan_deg, self.argument_of_perigee_deg, self.true_anomaly_deg)
        return orbit.from_elements(self.semi_major_axis_km, self.eccentricity, *np.radians(angles))

    def nominal(self, steps: int | None = None) -> Array:
        """Orbit without process noise, ``(steps + 1, 6)``."""
        return orbit.propagate(self.initial_state(), self.step_s, self.steps if steps is None else steps)

    def prior(self, mean: Array) -> Gaussian:
        """Belief at the start about ``mean (..., 6)``."""
        return Gaussian(mean, sqrt_cov=self.sqrt_P0)


P = Config()
D = replace(P, prior_position_km=10.0, prior_velocity_m_per_s=10.0, noise_position_km=1e-5, noise_velocity_km_per_s=1e-9)
B = replace(
    P, sigma_km=0.38, prior_position_km=0.37, prior_velocity_m_per_s=0.035, noise_position_km=0.0, noise_velocity_km_per_s=5e-9
)
STRESS = replace(P, steps=200, runs=200, noise_position_km=0.2, noise_velocity_km_per_s=1e-6)
PRESETS = {"P": P, "D": D, "S": P, "S-D": D, "B": B, "stress": STRESS}
