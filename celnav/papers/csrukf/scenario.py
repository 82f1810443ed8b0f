"""Truth and measurements of the satellite, and the filters that the paper and this study compare."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.colored import augmented, colored, decorrelated
from celnav.filters.model import Model, Motion, Sensor
from celnav.filters.records import Epochs, Filter, epochs
from celnav.filters.sequential import sigma_point
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, semidefinite_root
from celnav.gaussian.rules import Rule, unscented
from celnav.models import orbit, sightings
from celnav.models.noise import ar1, effective_covariance
from celnav.papers.csrukf.config import Config
from celnav.study.montecarlo import normals

H = np.eye(3, 6)


class Scenario(NamedTuple):
    """Simulated runs, time-major; without a run axis if one generator was given.

    ``truth (T, ..., 6)`` km, km/s; ``z (T, ..., 3)`` km, pseudo-positions; ``noise (T, ..., 3)``, the colored noise V in the
    units of what was measured; ``angles (T, ..., 3)`` rad where angles were measured, else None.
    """

    config: Config
    truth: Array
    z: Array
    noise: Array
    prior: Gaussian
    angles: Array | None = None

    @property
    def times(self) -> Array:
        """Epochs ``(T,)`` s."""
        return self.config.times

    def epochs(self, *, first: bool = True) -> Epochs:
        """Epochs with pseudo-positions; ``first=False`` withholds the sample at the start."""
        return epochs(self.times, self.z if first else _without_first(self.z), truth=self.truth)

    def angle_epochs(self, *, first: bool = True) -> Epochs:
        """Epochs with angles."""
        if self.angles is None:
            raise ValueError("angle_epochs: this scenario measured positions")
        return epochs(self.times, self.angles if first else _without_first(self.angles), truth=self.truth)

    def epochs_of(self, filter: str) -> Epochs:
        """What a filter of `filters` is given: positions or angles; those that take the noise for white, not the first sample."""
        if filter.startswith("angles"):
            return self.angle_epochs(first=filter == "angles+z0" or self.config.phi != 0.0)
        return self.epochs(first=not filter.startswith("srukf"))


def _without_first(z: Array) -> Array:
    out = z.copy()
    out[0] = np.nan
    return out


def dynamics(config: Config) -> Model:
    """Model function of one step of the orbit."""

    def f(x: Array, epoch: object) -> Array:  # noqa: ARG001
        return orbit.step(x, config.step_s)

    return f


def simulate(config: Config, rng: np.random.Generator | Sequence[np.random.Generator]) -> Scenario:
    """Simulate one run, or one run for each generator: orbit with process noise, colored noise, an initial estimate.

    Where angles are measured, the noise lives on the three of them, and the pseudo-positions are computed from them.
    """
    single = isinstance(rng, np.random.Generator)
    rngs = [rng] if isinstance(rng, np.random.Generator) else list(rng)
    initial, disturbance, first, zeta = normals(rngs, (6,), (config.steps, 6), (3,), (config.steps, 3))
    truth = np.empty((config.steps + 1, len(rngs), 6))
    truth[0] = config.initial_state()
    w = disturbance * config.sqrt_Q.diagonal()
    for k in range(config.steps):
        truth[k + 1] = orbit.step(truth[k], config.step_s) + w[k]
    mean = truth[0] + initial * config.sqrt_P0.diagonal()
    measured, increment = None, config.increment
    if config.measured == "angles":
        noise = ar1(config.Phi, zeta * increment * config.sigma_angles, first * semidefinite_root(config.angle_Sigma0).diagonal())
        measured = sightings.angles(truth[..., :3], sightings.star_directions(config.separation)) + noise
        z = sightings.position(measured, config.separation, np.sign(truth[..., 2]), strict=False)
    else:
        noise = ar1(config.Phi, zeta * increment * config.sigma_km, first * semidefinite_root(config.Sigma0).diagonal())
        z = truth[..., :3] + noise
    if single:
        truth, z, noise, mean = truth[:, 0], z[:, 0], noise[:, 0], mean[0]
        measured = None if measured is None else measured[:, 0]
    return Scenario(config, truth, z, noise, config.prior(mean), measured)


def filters(config: Config) -> dict[str, Filter]:
    """The filters, by the names that figures and tables use.

    srukf: white noise assumed. csrukf: the paper's structure, corrected; its state also holds the lagged estimate.
    csrukf+z0: uses the first sample, in one transform. augmented: the exact reference. srukf-reff: white noise of the same
    spectrum at zero frequency, where there is one, else srukf-inflated: of half the walk's final variance. openloop: no
    measurement at all. Where angles are measured see `angle_filters`.
    """
    if config.measured == "angles":
        return angle_filters(config)
    Phi, options = config.Phi, dict[str, Any](increments=config.R, rule=config.rule)
    motion, sensor = orbital(config), Sensor(H, config.Sigma0)
    out: dict[str, Filter] = {
        "srukf": white(config, config.white_R),
        "csrukf": decorrelated(motion, sensor, Phi, first=False, **options),
        "csrukf+z0": colored(motion, sensor, Phi, **options),
        "augmented": augmented(motion, sensor, Phi, increments=config.R),
        "openloop": open_loop(config),
    }
    if abs(config.phi) < 1.0:
        out["srukf-reff"] = white(config, effective_covariance(Phi, config.R))
    else:
        out["srukf-inflated"] = white(config, 0.5 * config.steps * config.R)
    return out


def orbital(config: Config) -> Motion:
    """What filters believe of the orbit."""
    return Motion(dynamics(config), sqrt_Q=config.sqrt_Q)


def at_epoch(R: Array) -> Any:
    """A covariance ``(3, 3)``, or a function that looks it up in a table ``(T, 3, 3)``."""
    return R if R.ndim == 2 else lambda _, epoch: R[epoch.k]


def open_loop(config: Config) -> Filter:
    """No measurement at all."""
    return sigma_point(orbital(config), rule=config.rule)


def white(config: Config, R: Array) -> Filter:
    """SRUKF that takes the noise for white, of covariance ``R (3, 3)`` or a table ``(T, 3, 3)`` of them."""
    return sigma_point(orbital(config), Sensor(H, at_epoch(R)), rule=config.rule)


def single_transform(config: Config, R: Array, filter_phi: Array | None = None) -> Filter:
    """CSRUKF in one transform with covariances of increments ``R (3, 3)`` or ``(T, 3, 3)``, and any assumed coefficient."""
    Phi, sensor = config.Phi if filter_phi is None else filter_phi, Sensor(H, np.eye(3))  # the first sample is not used
    return colored(orbital(config), sensor, Phi, increments=at_epoch(R), first=False, rule=config.rule)


def jacobian_covariance(config: Config) -> Array:
    """Covariances ``(T, 3, 3)`` km^2 of the pseudo-position along the nominal orbit, from the angles' accuracy."""
    return sightings.pseudo_position_covariance(config.nominal()[:, :3], config.separation, config.sigma_angles)


def angle_filters(config: Config) -> dict[str, Filter]:
    """Filters where angles are measured, by name.

    srukf-isotropic, csrukf-isotropic: on pseudo-positions, all components taken for equally good. csrukf-jacobian: on
    pseudo-positions, with the covariance that the angles give them. angles: on the angles themselves; their noise is whitened
    if it has a color. angles+z0: uses the first sample too, the exact reference. openloop: no measurement at all.
    """
    stars, table, squared = sightings.star_directions(config.separation), jacobian_covariance(config), config.increment**2
    isotropic = np.trace(table, axis1=-2, axis2=-1).mean() / 3.0 * np.eye(3)
    motion, increments = orbital(config), squared * np.diag(config.sigma_angles**2)

    def h(x: Array, epoch: object) -> Array:  # noqa: ARG001
        return sightings.angles(x[..., :3], stars)

    def whitened(*, first: bool) -> Filter:
        return colored(motion, Sensor(h, config.angle_Sigma0), config.Phi, increments=increments, first=first, rule=rule)

    def rule(n: int) -> Rule:
        return config.rule if n == 6 else unscented(n)

    plain = sigma_point(motion, Sensor(h, sqrt_R=np.diag(config.sigma_angles)), rule=config.rule)
    return {
        "srukf-isotropic": white(config, isotropic),
        "csrukf-isotropic": single_transform(config, squared * isotropic),
        "csrukf-jacobian": single_transform(config, squared * table),
        "angles": whitened(first=False) if config.phi else plain,
        "angles+z0": whitened(first=True),
        "openloop": open_loop(config),
    }
