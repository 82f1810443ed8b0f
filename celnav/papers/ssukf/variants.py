"""Other forms of the same filters: the total attitude as the state, and roots that are not taken block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.driver import Epoch, Filter, run, sequential
from celnav.filters.info import Info
from celnav.filters.step import Predict, predict, update
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian, covariance
from celnav.gaussian.linalg import Array, block
from celnav.gaussian.rule import Rule
from celnav.gaussian.spaces import EUCLIDEAN, Space, product
from celnav.papers.ssukf.config import ARCSEC, Config
from celnav.papers.ssukf.scenario import Scenario, dynamics, filters, noise_root, spread, star, state_space
from celnav.study.montecarlo import normals


# -- the total attitude in modified Rodrigues parameters: the paper's words taken literally ----------------------------------
def to_tangent(q: Array) -> Array:
    """From deviations of total parameters and drift to those of rotation vector and drift, ``(..., 6, 6)``."""
    p = q[..., :3] / (1.0 + q[..., 3:])
    return block([[4.0 * attitude.transport(p, 1.0, 1.0), 0], [0, np.eye(3)]])


def total_prior(prior: Gaussian) -> Gaussian:
    """The prior with its spread in total parameters."""
    columns, sign = prior.columns
    return prior._replace(spread=prior.form.marginal(np.linalg.solve(to_tangent(prior.mean[..., :4]), columns), sign))


def total_filters(config: Config, *, c: float | None = None, switched: bool = True) -> dict[str, Filter]:
    """AUKF and SSUKF on the total attitude. Without the switch to the shadow set (``switched``) they meet its singularity."""
    W, V = noise_root(config.gyro, config.step_s), config.sigma_n * np.eye(3)
    sky = attitude.total_attitude()
    space = product((sky, 4, 3), (EUCLIDEAN, 3, 3))
    moving = dynamics(config.gyro)

    def f(x: Array, epoch: Epoch, *noise: Array) -> Array:
        y = moving(x, epoch, *noise)
        if switched:
            y[..., :4] = attitude.positive(y[..., :4])
        return np.asarray(y)

    def parts(time: Rule, noise: tuple[Array, ...], measured: Rule, sensor: tuple[Array, ...]) -> Filter:
        see = update(star, measured, extra=sensor, space=space, measurement_space=sky)
        return sequential(predict(f, time, extra=noise, space=space), see)

    return {
        "aukf-total": parts(spread(15, config, c=c), (W, V), spread(15, config, c=c), (W, V)),
        "ssukf-total": parts(spread(12, config, c=c), (W,), spread(9, config, c=c), (V,)),
    }


class Spin(NamedTuple):
    """A spin through more than a whole turn.

    Attributes
    ----------
    times: ``(T,)`` s. errors: filter -> ``(T,)`` largest error of the runs, arcsec. switches: how often, in a run, the total form
        changed its parameters. crossing: when the turn is whole, s.
    """

    times: Array
    errors: dict[str, Array]
    switches: float
    crossing: float

    def settled(self, filter: str) -> float:
        """Largest error after the first minute, arcsec."""
        return float(np.nanmax(self.errors[filter][self.times > 60.0]))


def spin(
    config: Config,
    rngs: Sequence[np.random.Generator],
    *,
    rate_deg_per_s: float = 1.0,
    range_deg: tuple[float, float] = (270.0, 370.0),
) -> Spin:
    """Local and total form of the SSUKF while the satellite spins past the singularity at 360 deg."""
    c = config
    T = round((range_deg[1] - range_deg[0]) / rate_deg_per_s * c.star_hz) + 1
    short = replace(c, duration_s=(T - 1) / c.star_hz)
    axis = np.array([0.6, 0.0, 0.8])
    turned = np.radians(range_deg[0] + rate_deg_per_s * np.arange(T) / c.star_hz)
    q = attitude.exp(turned[:, None, None] * axis)
    white, walk, star = normals(rngs, (T - 1, 3), (T - 1, 3), (T, 3))
    drift = np.concatenate([np.zeros((1, len(rngs), 3)), np.cumsum(c.gyro.drift_std(c.step_s) * walk, 0)])
    gyro = c.gyro.measure(q, drift, white, c.step_s)
    stars = attitude.multiply(attitude.exp(c.sigma_n * star), q)
    truth = np.concatenate([np.broadcast_to(q, stars.shape), drift], -1)
    mean = np.tile(np.append(q[0], np.zeros(3)), (len(rngs), 1))
    deviation = np.concatenate([np.full(3, c.sigma_n), np.full(3, c.gyro.drift_std(1.0) + 1e-9)])
    prior = covariance(mean, np.diag(deviation**2))
    scenario = Scenario(short, truth, gyro, stars, prior, prior)

    def track(filter: Filter, prior: Gaussian) -> Array:
        mean = run(filter, prior, scenario.epochs(), keep="mean", on_failure="flag").mean
        assert mean is not None
        return mean[..., :4]

    tracks = {
        "local": track(filters(short)["ssukf"], scenario.prior),
        **{
            name: track(total_filters(short, switched=name == "switched")["ssukf-total"], total_prior(scenario.prior))
            for name in ("switched", "unswitched")
        },
    }
    errors = {n: attitude.angle(attitude.multiply(q, attitude.inverse(p))).max(1) / ARCSEC for n, p in tracks.items()}
    sides = (tracks["switched"][1:] * tracks["switched"][:-1]).sum(-1)
    return Spin(np.arange(T) / c.star_hz, errors, float((sides < 0.0).sum(0).mean()), (360.0 - range_deg[0]) / rate_deg_per_s)


# -- dense roots: the joint covariance of state and noise is factored as a whole ---------------------------------------------
def dense_filters(config: Config, *, c: float | None = None) -> dict[str, Filter]:
    """AUKF and SSUKF that factor the whole augmented covariance, as the paper writes them."""
    w, v = noise_root(config.gyro, config.step_s).diagonal(), np.full(3, config.sigma_n)
    time = {"aukf": np.concatenate([w, v]), "ssukf": w}
    measured = {"aukf": np.concatenate([w, v]), "ssukf": v}
    return {name: sequential(_dense_predict(config, time[name], c), _dense_update(config, measured[name], c)) for name in time}


def _augmented(belief: Gaussian, noise: Array) -> Gaussian:
    mean = np.concatenate([belief.mean, np.zeros((*belief.mean.shape[:-1], len(noise)))], -1)
    return Gaussian(mean, block([[belief.spread, 0], [0, belief.form.marginal(np.diag(noise), np.ones(1))]]), belief.form)


def _reduced(belief: Gaussian) -> Gaussian:
    """The belief about attitude and drift alone: of a lower root, too, the first rows are all there is of them."""
    return Gaussian(belief.mean[..., :7], belief.spread[..., :6, :6], belief.form)


def _space(noise: Array) -> Space:
    return product((state_space(), 7, 6), (EUCLIDEAN, len(noise), len(noise)))


def _dense_predict(config: Config, noise: Array, c: float | None) -> Predict:
    through = dynamics(config.gyro)

    def f(x: Array, epoch: Epoch) -> Array:
        return np.concatenate([through(x[..., :7], epoch, x[..., 7:]), x[..., 7:]], -1)

    n = 6 + len(noise)
    part = predict(f, spread(n, config, c=c), sqrt_Q=np.zeros((n, 0)), space=_space(noise))  # the noise is in the state

    def dense(belief: Gaussian, epoch: Any = None) -> tuple[Gaussian, Info]:
        after, info = part(_augmented(belief, noise), epoch)
        return _reduced(after), info

    return dense


def _dense_update(config: Config, noise: Array, c: float | None) -> Any:
    def h(x: Array, epoch: Epoch) -> Array:
        return star(x[..., :7], epoch, x[..., 7:][..., -3:])

    rule, sky, none = spread(6 + len(noise), config, c=c), attitude.attitude(), np.zeros((3, 0))  # the noise is in the state
    part = update(h, rule, sqrt_R=none, space=_space(noise), measurement_space=sky)

    def dense(belief: Gaussian, z: Any, epoch: Any = None, memory: Any = None) -> tuple[Gaussian, Info, Any]:
        after, info, memory = part(_augmented(belief, noise), z, epoch, memory)
        return _reduced(after), info, memory

    return dense
