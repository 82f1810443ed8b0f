"""Other forms of the same filters: the total attitude as the state, and roots that are not taken block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions, Info, State
from celnav.filters.run import run
from celnav.filters.sequential import Sequential, sigma_point
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, block, tria
from celnav.gaussian.rules import Rule
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
    """The prior with its covariance in total parameters."""
    return Gaussian(prior.mean, sqrt_cov=tria(np.linalg.solve(to_tangent(prior.mean[..., :4]), prior.sqrt_cov)))


def total_attitude() -> Space:
    """Space of attitudes whose tangents are differences of modified Rodrigues parameters of the attitudes themselves.

    The sign of the point decides between its two sets of parameters: a model that hands on `positive` quaternions switches to
    the shadow set in time, and the covariance follows by itself, since every other point is taken on the side of the center.
    """

    def parameters(q: Array) -> Array:
        return np.asarray(q[..., :3] / (1.0 + q[..., 3:]))

    def plus(point: Array, tangent: Array) -> Array:
        return attitude.from_rodrigues(parameters(point) + tangent, 1.0, 1.0)

    def minus(later: Array, earlier: Array) -> Array:
        side = np.copysign(1.0, (later * earlier).sum(-1, keepdims=True))
        return parameters(later * side) - parameters(earlier)

    return Space(plus, minus, check=attitude.unit)


def total_filters(config: Config, *, c: float | None = None, switched: bool = True, form: str = "covariance") -> dict[str, Filter]:
    """AUKF and SSUKF on the total attitude. Without the switch to the shadow set (``switched``) they meet its singularity."""
    W, V = noise_root(config.gyro, config.step_s), config.sigma_n * np.eye(3)
    sky = total_attitude()
    space = product((sky, 4, 3), (EUCLIDEAN, 3, 3))
    moving = dynamics(config.gyro)

    def f(x: Array, epoch: Epoch, *noise: Array) -> Array:
        y = moving(x, epoch, *noise)
        if switched:
            y[..., :4] = attitude.positive(y[..., :4])
        return np.asarray(y)

    def through(time: tuple[Array, ...], measured: tuple[Array, ...]) -> Filter:
        seen = Sensor(star, augment=measured, space=sky)
        return sigma_point(Motion(f, augment=time, space=space), seen, rule=lambda n: spread(n, config, c=c), form=form)

    return {"aukf-total": through((W, V), (W, V)), "ssukf-total": through((W,), (V,))}


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
    prior = Gaussian(mean, np.diag(deviation**2))
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
def dense_filters(config: Config, *, c: float | None = None, form: str = "covariance") -> dict[str, Filter]:
    """AUKF and SSUKF that factor the whole augmented covariance, as the paper writes them."""
    w, v = noise_root(config.gyro, config.step_s).diagonal(), np.full(3, config.sigma_n)
    time = {"aukf": np.concatenate([w, v]), "ssukf": w}
    measured = {"aukf": np.concatenate([w, v]), "ssukf": v}
    return {name: _dense(config, time[name], measured[name], c, form) for name in time}


def _dense(config: Config, time: Array, measured: Array, c: float | None, form: str) -> Filter:
    """A filter that takes the noise into the state before each of its parts, and out of it after."""
    through = dynamics(config.gyro)

    def f(x: Array, epoch: Epoch) -> Array:
        return np.concatenate([through(x[..., :7], epoch, x[..., 7:]), x[..., 7:]], -1)

    def h(x: Array, epoch: Epoch) -> Array:
        return star(x[..., :7], epoch, x[..., 7:][..., -3:])

    def rule(n: int) -> Rule:
        return spread(n, config, c=c)

    def part(noise: Array) -> Sequential:  # the noise is in the state
        n = 6 + len(noise)
        motion = Motion(f, sqrt_Q=np.zeros((n, 0)), space=_space(noise))
        return sigma_point(motion, Sensor(h, sqrt_R=np.zeros((3, 0)), space=attitude.attitude()), rule=rule, form=form)

    forward, back = part(time), part(measured)

    def step(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if epoch.dt:
            state = _reduced(forward.predict(_augmented(state, time), epoch))
        after, infos = back.update(_augmented(state, measured), epoch)
        return _reduced(after), infos

    return FromFunctions(lambda prior: State(forward.form.of(prior), (None,)), step)


def _augmented(state: State, noise: Array) -> State:
    belief, form = state.belief, type(state.belief)
    mean = np.concatenate([belief.mean, np.zeros((*belief.mean.shape[:-1], len(noise)))], -1)
    return state._replace(belief=form(mean, block([[belief[1], 0], [0, form.marginal(np.diag(noise), np.ones(1))]])))


def _reduced(state: State) -> State:
    """About attitude and drift alone: of a lower root, too, the first rows are all there is of them."""
    belief = state.belief
    return state._replace(belief=type(belief)(belief.mean[..., :7], belief[1][..., :6, :6]))


def _space(noise: Array) -> Space:
    return product((state_space(), 7, 6), (EUCLIDEAN, len(noise), len(noise)))
