"""A year, by the linear driver: 105,120 steps of all filters along three trends of the ephemeris error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from celnav.filters.two_stage import Boost
from celnav.gaussian.linalg import Array
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.linear import (
    differenced,
    exact,
    plain,
    start_differenced,
    start_exact,
    start_plain,
    steps,
)
from celnav.papers.tstdkf.method import excess, proportional, strong_tracking
from celnav.papers.tstdkf.scenario import noise_of
from celnav.study.montecarlo import normals

TRENDS = ("sine", "growing", "triangle")
FORMS = ("tdkf", "C", "B", "A")
"""Of the differenced filter: without strong tracking, and with the three forms of its factors."""
NAMES = ("ekf", "tkf", *FORMS, "aug")
CHUNK = 128
"""How many times as many steps as are kept together have their estimates evaluated together."""
HOUR = 12
"""Steps."""


def _boost(config: Config) -> Callable[[Any, Boost], tuple[Any, Array]]:
    """All `FORMS` at once: form A is B of the innovations of the first stage."""

    def factor(ratios: Array, rho: Array) -> Array:
        return np.concatenate([excess(ratios[:1], rho), proportional(ratios[1:], rho)])

    boosts = strong_tracking(config.rho, config.tau, factor=factor)

    def boost(memory: Any, seen: Boost) -> tuple[Any, Array]:
        residual = np.concatenate([seen.residual[1:3], seen.innovation[None]])
        total = np.stack([seen.total, seen.total, seen.own])[:, None]
        memory, factors = boosts(memory, seen._replace(residual=residual, total=total))
        return memory, np.concatenate([np.ones_like(factors[:1]), factors])

    return boost


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
    c, noise, T, count = config, noise_of(config), config.steps + 1, len(trends)
    xi, e, start, _ = normals(rngs, (T, 3), (T, 6), (9,), (9,))
    xi *= c.sigma_km
    e *= c.process_std
    same, runs = np.tile(np.arange(len(rngs)), count), count * len(rngs)
    times = c.step_s * np.arange(T)
    bias = np.concatenate([np.tile(replace(c, trend=name).bias(times)[:, None], (1, len(rngs), 1)) for name in trends], 1)
    V, Q = start[same, :3] * np.sqrt(noise.V.diagonal()), start[same, 3:] * np.sqrt(noise.Q.diagonal())
    truth = np.zeros((runs, 6))
    s1, s2, s3 = start_plain(c, runs), start_differenced(c, runs, len(FORMS)), start_exact(c, runs)
    boost, K = _boost(c), T - 1
    ends = np.append(np.arange(every, K, every), K)  # of a few steps each, the last of them maybe fewer
    out = {"times": times[ends, None], "bias": bias[ends]}
    for name in NAMES:
        out[f"{name}/bias"] = np.empty((len(ends), runs, 3))
        out |= {f"{name}/{what}": np.empty((len(ends), runs)) for what in ("position", "error")}
    found: list[tuple[Array, ...]] = []
    for k, at in enumerate(steps(config), start=1):
        V = V @ noise.F + xi[k, same]
        Q = Q @ noise.L + e[k, same]
        truth = truth @ at.Phi.T + (V @ noise.J.T + Q) @ at.G.T
        z = (truth[:, :3] + bias[k]) @ at.Gamma.T + V
        s1 = plain(s1, at, z, noise)
        s2 = differenced(s2, at, z, noise, boost, k == 1)
        s3 = exact(s3, at, z)
        found.append((truth, bias[k], s1.x, s1.b, s1.Lambda, s2.x, s2.b, s2.Lambda, s3.x))
        if len(found) == CHUNK * every or k == K:  # a year of whole states would not fit into memory
            _keep(out, (k - len(found)) // every, every, *(np.stack(column) for column in zip(*found, strict=True)))
            found = []
    return out


def _keep(
    out: dict[str, Array], first: int, every: int, truth: Array, bias: Array,
    x1: Array, b1: Array, L1: Array, x2: Array, b2: Array, L2: Array, x3: Array,
) -> None:  # fmt: skip
    """Write what is kept of some steps: first stages ``x``, biases and sensitivities of TKF, of all `FORMS`, and the exact one."""
    estimates = {"ekf": (x1, np.zeros_like(b1)), "tkf": (x1 + b1 @ L1.mT, b1), "aug": (x3[..., :6], x3[..., 15:])}
    estimates |= {form: (x2 + b2[:, i] @ L2.mT, b2[:, i]) for i, form in enumerate(FORMS)}
    starts = np.arange(0, len(truth), every)
    counts = np.diff(starts, append=len(truth))
    part, ends = slice(first, first + len(starts)), starts + counts - 1
    for name, (x, b) in estimates.items():
        out[f"{name}/bias"][part] = b[ends]
        for what, error in (("position", x[..., :3] - truth[..., :3]), ("error", b - bias)):
            out[f"{name}/{what}"][part] = np.add.reduceat(np.square(error).sum(-1), starts) / counts[:, None]
