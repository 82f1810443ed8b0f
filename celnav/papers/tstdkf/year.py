"""A year, by the linear driver: 105,120 steps of all filters along three trends of the ephemeris error."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from celnav.filters.records import Epoch
from celnav.filters.two_stage import Boost
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, matvec
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.estimators import filters
from celnav.papers.tstdkf.linear import LINEAR, epochs
from celnav.papers.tstdkf.method import excess, proportional, strong_tracking
from celnav.papers.tstdkf.scenario import noise_of
from celnav.study.montecarlo import normals

TRENDS = ("sine", "growing", "triangle")
FORMS = ("tdkf", "C", "B", "A")
"""Of the differenced filter: without strong tracking, and with the three forms of its factors."""
NAMES = ("ekf", "tkf", *FORMS, "aug")
HOUR = 12
"""Steps."""
CHUNK = 16
"""How many times as many steps as are kept together a filter takes at once."""


def _boost(config: Config) -> Callable[[Any, Boost], tuple[Any, Array]]:
    """All `FORMS` at once: form A is B of the innovations of the first stage."""

    def factor(ratios: Array, rho: Array) -> Array:
        return np.concatenate([excess(ratios[:2], rho[:2]), proportional(ratios[2:], rho[2:])])

    rho = np.multiply.outer([0.0, 1.0, 1.0, 1.0], np.array([config.rho]))
    boosts = strong_tracking(rho, config.tau, factor=factor)

    def boost(memory: Any, seen: Boost) -> tuple[Any, Array]:
        residual = np.empty((len(FORMS), *seen.innovation.shape))
        residual[:] = seen.residual  # one for all forms as long as they have one estimate
        residual[-1] = seen.innovation
        total = np.stack([seen.total, seen.total, seen.total, seen.own])[:, None]
        result: tuple[Any, Array] = boosts(memory, seen._replace(residual=residual, total=total))
        return result

    return boost


def simulate(config: Config, rngs: Sequence[np.random.Generator], trends: Sequence[str]) -> Iterator[Epoch]:
    """Epochs of the linear driver, ``truth`` the error of the position and the ephemeris error ``(trends * rngs, 6)`` km."""
    c, noise, T, count = config, noise_of(config), config.steps + 1, len(trends)
    xi, e, start, _ = normals(rngs, (T, 3), (T, 6), (9,), (9,))
    xi *= c.sigma_km
    e *= c.process_std
    same, times = np.tile(np.arange(len(rngs)), count), c.step_s * np.arange(T)
    bias = np.repeat(np.stack([replace(c, trend=name).bias(times) for name in trends], 1), len(rngs), 1)
    V, Q = start[same, :3] * np.sqrt(noise.V.diagonal()), start[same, 3:] * np.sqrt(noise.Q.diagonal())
    x = np.zeros((len(same), 6))
    for epoch in epochs(c):
        k, at = epoch.k, epoch.u
        V = V @ noise.F + xi[k, same]
        Q = Q @ noise.L + e[k, same]
        x = x @ at.Phi.T + (V @ noise.J.T + Q) @ at.G.T
        z = (x[:, :3] + bias[k]) @ at.Gamma.T + V
        yield epoch._replace(z=z, truth=np.concatenate([x[:, :3], bias[k]], 1))


def track(
    config: Config, rngs: Sequence[np.random.Generator], trends: Sequence[str] = TRENDS, *, every: int = 1
) -> dict[str, Array]:
    """Every filter along trends of the ephemeris error, on the same noise for each trend.

    Returns
    -------
    Of each ``every`` steps: ``times`` ``(K, 1)`` s and ``bias (K, trends * rngs, 3)`` km, the truth, at their end; for each of
    `NAMES` ``<filter>/bias``, as estimated there, and the means over them of the squared errors ``<filter>/position`` and
    ``<filter>/error``, of the bias, ``(K, trends * rngs)`` km^2.
    """
    c, runs = config, len(trends) * len(rngs)
    believed = filters(c, seen=LINEAR)
    flown = believed["tkf"], replace(believed["tdkf"], boost=_boost(c)), believed["aug"]
    prior = Gaussian(np.tile(c.deviation, (runs, 1)), np.diag(c.deviation**2))  # one covariance for all of them
    states = [filter.start(prior) for filter in flown]
    rows: list[tuple[Array, ...]] = []
    stream = simulate(c, rngs, trends)
    while part := list(islice(stream, CHUNK * every)):
        starts = np.arange(0, len(part), every)
        counts = np.diff(starts, append=len(part))
        ends, truth = starts + counts - 1, np.stack([epoch.truth for epoch in part])
        row = [np.array([part[end].t for end in ends])[:, None], truth[ends, :, 3:]]
        for i, filter in enumerate(flown):  # one after the other is faster than all at each step
            states[i], found = _fly(filter, states[i], part)
            error = (found - truth[:, None]).reshape(*found.shape[:3], 2, 3)
            means = np.add.reduceat(np.vecdot(error, error), starts) / counts[:, None, None, None]
            for j in range(found.shape[1]):
                row += [found[ends, j, :, 3:], means[:, j, :, 0], means[:, j, :, 1]]
        rows.append(tuple(row))
    keys = ["times", "bias", *(f"{name}/{what}" for name in NAMES for what in ("bias", "position", "error"))]
    return {key: np.concatenate(column) for key, column in zip(keys, zip(*rows, strict=True), strict=True)}


def _fly(filter: Any, state: Any, epochs: Sequence[Epoch]) -> tuple[Any, Array]:
    """State after some epochs, and errors of the position and biases ``(epochs, filters, runs, 6)`` as estimated on the way."""
    found = []
    for epoch in epochs:
        state, _ = filter.step(state, epoch)
        if not hasattr(state, "bias"):
            mean = state.belief.mean
            found.append(np.concatenate([mean[None, :, :3], mean[None, :, 15:]], -1))
            continue
        b = state.bias.mean
        b = b if b.ndim > 2 else np.stack([np.zeros_like(b), b])  # EKF is TKF without its bias
        found.append(np.concatenate([state.first.belief.mean[:, :3] + matvec(state.Lambda[:3], b), b], -1))
    return state, np.stack(found)
