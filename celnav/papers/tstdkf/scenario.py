"""Truth and timings of pulsars. Several configurations are simulated side by side, on the same random numbers.

Such *cases* may differ in noise, ephemeris error, prior and what filters are given; they share times, orbit and pulsars. The runs
of one case lie after those of another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from celnav.filters.records import Epoch
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, matvec
from celnav.models.ephemeris import GM, de421
from celnav.models.orbit import NODES, Extra, advance, flow, third_body
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.method import Noise, ar1_noise
from celnav.study.montecarlo import normals

PULLING = ("sun", "moon")
SHARED = ("start_utc", "step_s", "days", "pulsars", "elements", "rate_noise_km_per_s", "acceleration_noise_km_per_s2", "pulled")


class Sky(NamedTuple):
    """Where Earth and Sun are at each epoch, ``(T, 3)`` km: what the filters believe.

    ``bodies``: Sun and Moon from the Earth's center at the nodes of the step before each epoch, ``(T, 2, N, 3)``; None if they do
    not pull.
    """

    earth: Array
    sun: Array
    bodies: Array | None


class Scenario(NamedTuple):
    """Simulated runs, time-major.

    Attributes
    ----------
    cases: configurations, and runs: how many of each. truth: ``(T, all runs, 6)`` km and km/s. bias: ``(T, all runs, 3)`` km.
    z: ``(T, all runs, m)`` km, nan at the start.
    """

    cases: tuple[Config, ...]
    runs: tuple[int, ...]
    truth: Array
    bias: Array
    z: Array
    sky: Sky
    prior: Gaussian

    @property
    def times(self) -> Array:
        """Seconds since the start, ``(T,)``."""
        return self.cases[0].step_s * np.arange(len(self.truth))

    def epochs(self) -> Iterator[Epoch]:
        """Epochs from the first measurement on; ``u`` is ``(earth, sun, bodies)``, ``truth`` state and bias ``(runs, 9)``."""
        dt = self.cases[0].step_s
        for k in range(1, len(self.truth)):
            bodies = None if self.sky.bodies is None else self.sky.bodies[k]
            truth = np.concatenate([self.truth[k], self.bias[k]], -1)
            yield Epoch(k, k * dt, dt, (self.sky.earth[k], self.sky.sun[k], bodies), self.z[k], truth)

    def case(self, index: int) -> Scenario:
        """One case alone."""
        first = sum(self.runs[:index])
        part = slice(first, first + self.runs[index])
        prior = Gaussian(self.prior.mean[part], self.prior.cov[part])
        truth, bias, z = (values[:, part] for values in (self.truth, self.bias, self.z))
        return Scenario(self.cases[index : index + 1], self.runs[index : index + 1], truth, bias, z, self.sky, prior)


def beside(*parts: Scenario) -> Scenario:
    """Scenarios whose cases go together as one: what a step costs is mostly what its first run costs.

    Raises
    ------
    ValueError: naming what they must share.
    """
    cases = as_cases([case for part in parts for case in part.cases])
    truth, bias, z = (np.concatenate(values, 1) for values in zip(*((p.truth, p.bias, p.z) for p in parts), strict=True))
    prior = Gaussian(np.concatenate([p.prior.mean for p in parts]), np.concatenate([p.prior.cov for p in parts]))
    return Scenario(cases, sum((part.runs for part in parts), ()), truth, bias, z, parts[0].sky, prior)


def as_cases(cases: Config | Sequence[Config]) -> tuple[Config, ...]:
    """One configuration or several, checked to go together.

    Raises
    ------
    ValueError: naming what they must share.
    """
    together = (cases,) if isinstance(cases, Config) else tuple(cases)
    for name in SHARED:
        if len({getattr(case, name) for case in together}) != 1:
            raise ValueError(f"{name}: expected the same in all cases, got {', '.join(str(getattr(c, name)) for c in together)}")
    return together


def noise_of(config: Config) -> Noise:
    """Noises of a setting."""
    s, xi, e = config.setting, np.diag(config.sigma_km**2), np.diag(config.process_std**2)
    return ar1_noise(s.F * np.eye(3), s.L * np.eye(6), config.coupling(s.kappa), xi, e)


def sky(config: Config) -> Sky:
    """Earth and Sun, and what pulls, by DE421."""
    starts = config.step_s * np.arange(config.steps + 1)
    dates = config.start.after(starts)
    earth, sun = (de421().state(body, dates).position for body in ("earth", "sun"))
    if not config.pulled:
        return Sky(earth, sun, None)
    nodes = config.start.after(starts[:, None] - config.step_s * (1.0 - NODES.at))
    center = de421().state("earth", nodes).position
    return Sky(earth, sun, np.stack([de421().state(body, nodes).position - center for body in PULLING], 1))


def pull(bodies: Array | None) -> Extra | None:
    """What Sun and Moon, at ``(2, N, 3)`` during a step, add to the acceleration."""
    if bodies is None:
        return None

    def extra(r: Array, _times: Array) -> Array:
        position = np.moveaxis(r, 0, -1)
        pulls = (third_body(position, at[:, None], GM[body]) for body, at in zip(PULLING, bodies, strict=True))
        return np.moveaxis(sum(pulls, np.zeros(3)), -1, 0)

    return extra


def nominal_orbit(config: Config) -> Array:
    """States ``(T, 6)`` of the undisturbed orbit; not to be written to."""
    return _undisturbed(config.elements, config.step_s, config.steps)


@lru_cache(maxsize=4)
def _undisturbed(elements: tuple[float, ...], step_s: float, steps: int) -> Array:
    out = np.empty((steps + 1, 6))
    out[0] = Config(elements=elements).orbit
    for k in range(steps):
        out[k + 1] = advance(out[k], step_s)
    out.flags.writeable = False
    return out


def simulate(cases: Config | Sequence[Config], rngs: Sequence[np.random.Generator]) -> Scenario:
    """Simulate one run of each case with each generator.

    Raises
    ------
    ValueError: for cases that do not go together, dates outside the ephemeris, or noises that cannot be.
    """
    together = as_cases(cases)
    c, count, runs = together[0], len(together), len(rngs)
    T, timing, seen = c.steps + 1, c.timing, sky(c)
    xi, e, first, drawn = (np.tile(draw, (count, 1)) for draw in normals(rngs, (T, 3), (T, 6), (9,), (9,)))
    noise = Noise(*(np.repeat(np.stack(same), runs, 0) for same in zip(*map(noise_of, together), strict=True)))
    V = first[:, :3] * np.sqrt(noise.V.diagonal(0, -2, -1))
    Q = first[:, 3:] * np.sqrt(noise.Q.diagonal(0, -2, -1))
    sigma, std = c.sigma_km, c.process_std
    bias = _biases(together, drawn[:, 6:], T)
    # The disturbance is mapped by the nominal orbit's G, from which that of a run differs by 1e-4 of itself.
    G = flow(nominal_orbit(c)[:-1], c.step_s).G
    truth, z = np.empty((T, count * runs, 6)), np.full((T, count * runs, 3), np.nan)
    truth[0] = c.orbit
    for k in range(1, T):
        V = matvec(noise.F, V) + sigma * xi[k]
        Q = matvec(noise.L, Q) + std * e[k]
        extra = pull(None if seen.bodies is None else seen.bodies[k])
        truth[k] = advance(truth[k - 1], c.step_s, extra=extra) + (matvec(noise.J, V) + Q) @ G[k - 1].T
        z[k] = timing.delay(seen.earth[k] + bias[k] + truth[k, :, :3], seen.sun[k]) + V
    own = [
        drawn[i * runs : (i + 1) * runs, :6] if case.initial == "drawn" else np.ones((runs, 6)) for i, case in enumerate(together)
    ]
    deviation = np.repeat([case.deviation for case in together], runs, 0)
    spread = deviation[..., None] ** 2 * np.eye(6)
    prior = Gaussian(c.orbit + np.concatenate(own) * deviation, spread)
    return Scenario(together, (runs,) * count, truth, bias, z, seen, prior)


def _biases(cases: Sequence[Config], drawn: Array, T: int) -> Array:
    """Errors of the Earth's ephemeris, ``(T, runs, 3)`` km."""
    out, runs = np.empty((T, *drawn.shape)), len(drawn) // len(cases)
    for i, case in enumerate(cases):
        part = slice(i * runs, (i + 1) * runs)
        if case.trend == "constant":
            out[:, part] = case.bias_prior_km * drawn[part]
        else:
            out[:, part] = case.bias(case.step_s * np.arange(T))[:, None]
    return out
