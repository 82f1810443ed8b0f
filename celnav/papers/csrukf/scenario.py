"""[Sun2015]: a satellite determines its position from two stars and the Earth's limb, with colored
measurement noise.

========  =========================  ======================================
equation  content                    here
========  =========================  ======================================
38        acceleration with J2       `celnav.models.orbit.acceleration`
40-43     angles and position        `celnav.models.sightings`
1-2       colored measurement noise  `simulate`, `celnav.models.noise.ar1`
4-8       differenced measurement    `celnav.filters.colored.difference`
10-20     decorrelation, J, Q*, R*   `celnav.filters.colored.decorrelation`
21-37     the filter                 `celnav.filters.colored.decorrelated`
========  =========================  ======================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.colored import augmented, colored, decorrelated
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epochs, Filter, epochs
from celnav.filters.sequential import sigma_point
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, Belief, semidefinite_root
from celnav.gaussian.rules import Rule, unscented
from celnav.models import orbit, sightings
from celnav.models.noise import ar1, effective_covariance, stationary_covariance
from celnav.papers import citation
from celnav.study.montecarlo import MOST_STEPS, normals
from celnav.study.parameters import Timed, param
from celnav.study.trial import Group, Trial

__all__ = [
    "CITATION",
    "GROUPS",
    "JUDGED",
    "MISSION",
    "PRESETS",
    "STRESS",
    "TITLE",
    "Config",
    "D",
    "H",
    "P",
    "Scenario",
    "assuming",
    "filters",
    "simulate",
    "trial",
]

TITLE = "Square-root unscented Kalman filter for colored measurement noise"
CITATION = citation("Sun2015")
H = np.eye(3, 6)
FIT = "inferred: by a fit to Tables 1 and 2"


# -- parameters ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Config(Timed):
    """All parameters of a run; angles in degrees, as the paper prints them."""

    semi_major_axis_km: float = param(7136.635, "paper", "semi-major axis of the orbit", below=1e6)
    eccentricity: float = param(0.001, "paper", "eccentricity of the orbit", least=0.0, below=1.0)
    inclination_deg: float = param(
        65.0, "paper", "inclination of the orbit to the equator", least=0.0, most=180.0
    )
    raan_deg: float = param(30.0, "paper", "right ascension of the ascending node")
    argument_of_perigee_deg: float = param(
        30.0, "paper", "argument of perigee, from the ascending node"
    )
    true_anomaly_deg: float = param(
        0.0, "chosen: z > 0 for 2499 s", "true anomaly at the start of a run"
    )
    step_s: float = param(
        1.0, "paper", "interval between measurements, and step of the filters", above=0.0
    )
    steps: int = param(600, "paper", "steps in a run", least=1, most=MOST_STEPS)
    runs: int = param(100, "paper", "runs of the Monte Carlo simulation", least=1)
    camera_deg: float = param(
        0.005, "paper", "accuracy of the directions to the Earth's edges, if angles are measured"
    )
    star_arcsec: float = param(
        3.0, "paper", "accuracy of the directions to the stars, if angles are measured"
    )
    separation_deg: float = param(
        90.0, "chosen", "angle between the two stars, if angles are measured"
    )
    accuracy_sigmas: float = param(
        3.0, "inferred", "number of standard deviations in these accuracies"
    )
    sigma_km: float = param(
        0.2,
        FIT,
        "standard deviation of the position noise on each axis, with the meaning of noise_level",
        above=0.0,
    )
    noise_level: str = param(
        "increments",
        "inferred: the paper's R",
        "what sigma_km, or camera_deg and star_arcsec, describe: the colored noise V itself "
        "(stationary), or the white increments that drive it",
        one_of=("stationary", "increments"),
    )
    prior_position_km: float = param(
        0.15, FIT, "standard deviation of the initial estimate on each axis", least=0.0
    )
    prior_velocity_m_per_s: float = param(
        0.035, FIT, "standard deviation of the initial estimate on each axis", least=0.0
    )
    noise_position_km: float = param(
        7.5e-3, FIT, "standard deviation of the process noise of one step on each axis", least=0.0
    )
    noise_velocity_km_per_s: float = param(
        1e-8, FIT, "standard deviation of the process noise of one step on each axis", least=0.0
    )
    phi: float = param(
        0.0,
        "paper: 0, 0.8, 1",
        "coefficient of the colored noise, V' = phi V + increment; 1: a random walk",
        least=-1.0,
        most=1.0,
    )
    measured: str = param(
        "positions",
        "inferred",
        "what the filters are given: positions that are computed from the angles, or the angles",
        one_of=("positions", "angles"),
    )
    first_noise: str | None = param(
        None,
        "chosen",
        "covariance of the first noise sample: that of the increments (R), of the stationary "
        "noise, or zero; if omitted, as noise_level says",
        one_of=("R", "stationary", "zero", None),
    )
    alpha: float = param(1.0, "chosen: no negative weight", "spread of the sigma points")
    beta: float = param(
        0.0,
        "chosen",
        "enters the covariance weight of the central sigma point; 2 is optimal for Gaussians",
    )
    kappa: float = param(0.0, "chosen", "second parameter of the spread of the sigma points")

    def check(self) -> None:
        """Check that the orbit is above the Earth, and that noise and sigma points are valid."""
        if (a := self.semi_major_axis_km) <= (
            least := orbit.EARTH.radius_km / (1.0 - self.eccentricity)
        ):
            raise ValueError(
                f"semi_major_axis_km: expected an orbit above the Earth, from {least:.6g} km, got "
                f"{a!r}"
            )
        for name, other in (("noise_level", "'increments'"), ("first_noise", "R or zero")):
            if getattr(self, name) == "stationary" and abs(self.phi) == 1.0:
                why = (
                    f"for phi = {self.phi:g}: a random walk has no stationary standard deviation, "
                    "only its increments have one"
                )
                raise ValueError(f"{name}: expected {other} {why}")
        unscented(6, self.alpha, self.beta, self.kappa)
        with np.errstate(over="raise"):
            self.R, self.sqrt_Q @ self.sqrt_Q, self.sqrt_P0 @ self.sqrt_P0

    @property
    def idle(self) -> dict[str, str]:
        """Parameters without effect in this configuration, and why."""
        if self.measured == "angles":
            return {
                "sigma_km": "if angles are measured (camera_deg and star_arcsec are their noise)"
            }
        names = ("camera_deg", "star_arcsec", "separation_deg", "accuracy_sigmas")
        return dict.fromkeys(names, "if positions are measured (sigma_km is their noise)")

    @property
    def times(self) -> Array:
        """Epochs ``(steps + 1,)`` s."""
        return self.step_s * np.arange(self.steps + 1)

    @property
    def Phi(self) -> Array:
        """Coefficient matrix of the colored noise, ``(3, 3)``."""
        return self.phi * np.eye(3)

    @property
    def increment(self) -> float:
        """Ratio of the standard deviation of the noise increments to `sigma`."""
        return float(np.sqrt(1.0 - self.phi**2)) if self.noise_level == "stationary" else 1.0

    @property
    def sigma(self) -> Array:
        """Standard deviations ``(3,)`` of the measurements: of positions, km; or of the two angles
        to the stars and of the Earth's angular diameter, rad."""
        if self.measured == "positions":
            return np.full(3, self.sigma_km)
        camera = np.radians(self.camera_deg)
        star = np.radians(self.star_arcsec / 3600.0)
        return np.array([np.hypot(camera, star)] * 2 + [camera]) / self.accuracy_sigmas

    @property
    def R(self) -> Array:
        """Covariance of the noise increments, ``(3, 3)`` km^2 or rad^2."""
        return np.diag((self.increment * self.sigma) ** 2)

    @property
    def Sigma0(self) -> Array:
        """Covariance of the first noise sample, ``(3, 3)`` km^2 or rad^2."""
        first = self.first_noise or ("stationary" if self.noise_level == "stationary" else "R")
        return (
            stationary_covariance(self.Phi, self.R)
            if first == "stationary"
            else self.R
            if first == "R"
            else 0.0 * self.R
        )

    @property
    def sqrt_Q(self) -> Array:
        """Square root of the process noise covariance of one step, ``(6, 6)`` km, km/s."""
        return np.diag(np.repeat([self.noise_position_km, self.noise_velocity_km_per_s], 3))

    @property
    def sqrt_P0(self) -> Array:
        """Square root of the prior's covariance, ``(6, 6)`` km, km/s."""
        return np.diag(np.repeat([self.prior_position_km, 1e-3 * self.prior_velocity_m_per_s], 3))

    @property
    def rule(self) -> Rule:
        """Rule of the state's sigma points."""
        return unscented(6, self.alpha, self.beta, self.kappa)

    @property
    def separation(self) -> float:
        """Angle between the stars, rad."""
        return float(np.radians(self.separation_deg))

    def nominal(self, steps: int | None = None) -> Array:
        """Orbit without process noise, ``(steps + 1, 6)`` km, km/s."""
        angles = np.radians(
            [
                self.inclination_deg,
                self.raan_deg,
                self.argument_of_perigee_deg,
                self.true_anomaly_deg,
            ]
        )
        start = orbit.from_elements(self.semi_major_axis_km, self.eccentricity, *angles)
        return orbit.propagate(start, self.step_s, self.steps if steps is None else steps)


P = Config()
D = replace(
    P,
    prior_position_km=10.0,
    prior_velocity_m_per_s=10.0,
    noise_position_km=1e-5,
    noise_velocity_km_per_s=1e-9,
)
B = replace(
    P, sigma_km=0.38, prior_position_km=0.37, noise_position_km=0.0, noise_velocity_km_per_s=5e-9
)
STRESS = replace(P, steps=200, runs=200, noise_position_km=0.2, noise_velocity_km_per_s=1e-6)
PRESETS = {"P": P, "D": D, "B": B, "stress": STRESS}
"""Fitted to the final errors; a poor prior; fitted to the time averages; strong process noise."""
MISSION = {"noise_level": "stationary"}
"""Default parameters of a mission: the variance of the noise does not depend on its correlation."""


# -- simulation ------------------------------------------------------------------------------------
class Scenario(NamedTuple):
    """Simulated runs, time-major.

    ``truth (T, runs, 6)`` km, km/s; ``z (T, runs, 3)`` km, pseudo-positions; ``noise (T, runs,
    3)``, the colored noise V in the units of the measurements; ``angles (T, runs, 3)`` rad if
    angles were measured, else None.
    """

    config: Config
    truth: Array
    z: Array
    noise: Array
    prior: Gaussian
    angles: Array | None = None

    def epochs(self, filter: str = "") -> Epochs:
        """Epochs for a filter of `filters`: positions or angles. Filters that assume white noise do
        not get the first sample."""
        z = self.z
        truth = self.truth
        first = not filter.startswith("srukf")
        if filter.startswith("angles"):
            z = np.asarray(self.angles)
            first = filter == "angles+z0" or self.config.phi != 0.0
        if filter == "lagged":
            truth = np.concatenate([truth[:1], truth[:-1]])  # it estimates the previous epoch
        return epochs(
            self.config.times,
            z if first else np.concatenate([np.full_like(z[:1], np.nan), z[1:]]),
            truth=truth,
        )


def simulate(config: Config, rngs: Sequence[np.random.Generator]) -> Scenario:
    """One run for each generator: orbit with process noise, colored noise (Eqs. 1, 2), an initial
    estimate drawn from the prior.

    If angles are measured, the noise is added to the three angles, and the pseudo-positions are
    computed from them.
    """
    c = config
    initial, w, first, zeta = normals(rngs, (6,), (c.steps, 6), (3,), (c.steps, 3))
    truth = np.empty((c.steps + 1, len(rngs), 6))
    truth[0] = c.nominal(0)[0]
    for k in range(c.steps):
        truth[k + 1] = orbit.step(truth[k], c.step_s) + w[k] * c.sqrt_Q.diagonal()
    noise = ar1(c.Phi, zeta * c.increment * c.sigma, first * semidefinite_root(c.Sigma0).diagonal())
    angles = None
    z = truth[..., :3] + noise
    if c.measured == "angles":
        angles = sightings.angles(truth[..., :3], sightings.star_directions(c.separation)) + noise
        z = sightings.position(angles, c.separation, np.sign(truth[..., 2]), strict=False)
    return Scenario(
        c,
        truth,
        z,
        noise,
        Gaussian(truth[0] + initial * c.sqrt_P0.diagonal(), sqrt_cov=c.sqrt_P0),
        angles,
    )


# -- the filters -----------------------------------------------------------------------------------
def orbital(config: Config) -> Motion:
    """The orbit model of the filters."""

    def f(x: Array, _epoch: object) -> Array:
        return orbit.step(x, config.step_s)

    return Motion(f, sqrt_Q=config.sqrt_Q)


def white(config: Config, R: Any) -> Filter:
    """SRUKF, which assumes white noise of covariance ``R``: ``(3, 3)``, or a function of state and
    epoch."""
    return sigma_point(orbital(config), Sensor(H, R), rule=config.rule)


def assuming(config: Config, R: Any, Phi: Array | None = None) -> Filter:
    """CSRUKF with one transform, for pseudo-positions, with an assumed coefficient and increments
    of covariance ``R``."""
    sensor = Sensor(H, np.eye(3))  # the first sample is not used
    return colored(
        orbital(config),
        sensor,
        config.Phi if Phi is None else Phi,
        increments=R,
        first=False,
        rule=config.rule,
    )


def filters(config: Config) -> dict[str, Filter]:
    """The filters by name, as in figures and tables; openloop uses no measurements.

    With positions: srukf assumes white noise. csrukf has the paper's structure, corrected.
    csrukf+z0 also uses the first sample, with one transform. augmented is the exact reference.
    srukf-reff assumes white noise with the same spectral density at zero frequency; a random walk
    has none, so srukf-inflated assumes white noise with half the final variance of the walk.

    With angles: srukf-isotropic and csrukf-isotropic use pseudo-positions and assume the same noise
    on all components. csrukf-jacobian uses the covariance that follows from the angles. angles uses
    the angles themselves, and whitens their noise if it is colored. angles+z0 also uses the first
    sample, and is the exact reference.
    """
    c = config
    motion = orbital(config)
    openloop = sigma_point(motion, rule=c.rule)
    if c.measured == "positions":
        sensor = Sensor(H, c.Sigma0)
        options = dict[str, Any](increments=c.R, rule=c.rule)
        other = "srukf-inflated" if abs(c.phi) == 1.0 else "srukf-reff"
        return {
            "srukf": white(c, np.diag(c.sigma**2)),
            "csrukf": decorrelated(motion, sensor, c.Phi, first=False, **options),
            "csrukf+z0": colored(motion, sensor, c.Phi, **options),
            "augmented": augmented(motion, sensor, c.Phi, increments=c.R),
            "openloop": openloop,
            other: white(
                c,
                effective_covariance(c.Phi, c.R) if other == "srukf-reff" else 0.5 * c.steps * c.R,
            ),
        }
    stars = sightings.star_directions(c.separation)
    table = sightings.pseudo_position_covariance(c.nominal()[:, :3], c.separation, c.sigma)
    isotropic = np.trace(table, axis1=-2, axis2=-1).mean() / 3.0 * np.eye(3)

    def h(x: Array, epoch: object) -> Array:  # noqa: ARG001
        return sightings.angles(x[..., :3], stars)

    def whitened(*, first: bool) -> Filter:
        rule = lambda n: c.rule if n == 6 else unscented(n)  # noqa: E731
        return colored(motion, Sensor(h, c.Sigma0), c.Phi, increments=c.R, first=first, rule=rule)

    return {
        "srukf-isotropic": white(c, isotropic),
        "csrukf-isotropic": assuming(c, c.increment**2 * isotropic),
        "csrukf-jacobian": assuming(c, lambda _, epoch: c.increment**2 * table[epoch.k]),
        "angles": whitened(first=False)
        if c.phi
        else sigma_point(motion, Sensor(h, sqrt_R=np.diag(c.sigma)), rule=c.rule),
        "angles+z0": whitened(first=True),
        "openloop": openloop,
    }


# -- evaluation ------------------------------------------------------------------------------------
GROUPS = (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3))
JUDGED = {group.name: group.unit for group in GROUPS}


def trial(config: Config, rngs: Sequence[np.random.Generator]) -> Trial:
    """One run for each generator, for missions, campaigns and the study."""
    sim = simulate(config, rngs)
    exact = {"positions": "csrukf+z0", "angles": "angles+z0"}[config.measured]
    return Trial(
        GROUPS, filters(config), sim.prior, sim.epochs, _compare, exact, lambda x: x[..., :3]
    )


def _compare(truth: Array, belief: Belief) -> tuple[Array, Array]:
    return belief.mean[..., :6] - truth, belief.sqrt_cov[..., :6, :6]
