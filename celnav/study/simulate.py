"""Truth and measurements drawn from what a filter believes: of the same `Motion` and `Sensor`, so they cannot disagree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.colored import coloring, zeta_of
from celnav.filters.epochs import epochs
from celnav.filters.joint import at, evaluate
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import instance, integer, sequence
from celnav.gaussian.linalg import Array, matvec
from celnav.study.montecarlo import generator

MOST_RUNS = 1_000_000
"""Generators of numbers take time and memory."""


def simulate(
    motion: Motion,
    sensor: Sensor | Sequence[Sensor],
    prior: Gaussian,
    times: ArrayLike,
    *,
    runs: int,
    seed: int = 0,
    u: Any = None,
    Phi: Any = None,
) -> tuple[Array, Any]:
    """Draw runs: a start from the prior, process noise in each interval, measurement noise at each epoch.

    Parameters
    ----------
    motion, sensor: what a filter of them believes; of several sensors a sequence. Noise through the points is drawn, too.
    prior: mean ``(N,)`` and covariance ``(n, n)`` of the start.
    times: ``(T,)`` s. u: inputs, as in `celnav.epochs`.
    runs: how many. seed: run r has the generator of ``(seed, 0, r)``, whatever the number of runs.
    Phi: ``(m, m)`` or a function of the epoch, of colored noise ``V' = Phi V + zeta`` of covariance R (one sensor).

    Returns
    -------
    The truth ``(T, runs, N)`` and the measurements ``(T, runs, m)``, a tuple of them for a sequence of sensors.

    Raises
    ------
    ValueError: naming the argument that cannot be.

    >>> truth, z = celnav.simulate(motion, gps, prior, np.arange(601.0), runs=500)
    """
    instance("motion", motion, Motion, "celnav.Motion(f, Q)")
    sensors = (sensor,) if isinstance(sensor, Sensor) else tuple(sequence("sensor", sensor, "[celnav.Sensor(h, R)]"))
    if not sensors:
        raise ValueError("sensor: expected one or more, got none")
    for each in sensors:
        instance("sensor", each, Sensor, "celnav.Sensor(h, R)")
    if Phi is not None and len(sensors) != 1:
        raise ValueError(f"Phi: expected one sensor with it, got {len(sensors)}")
    instance("prior", prior, Gaussian, "celnav.Gaussian(mean, cov)")
    if prior.mean.ndim != 1 or prior.cov.ndim != 2:
        raise ValueError(f"prior: expected one mean (N,) and covariance (n, n), got {prior.mean.shape} and {prior.cov.shape}")
    when, seed = epochs(times, u=u), integer("seed", seed, 0)
    runs = integer("runs", runs)
    if runs > MOST_RUNS:
        raise ValueError(f"runs: expected at most {MOST_RUNS}, got {runs}")
    rngs = [generator(seed, 0, run) for run in range(runs)]
    phi = None if Phi is None else coloring(Phi, sensors[0].m)
    zeta = None if Phi is None else zeta_of(sensors[0], Phi, None)

    def draw(columns: Any) -> Array:
        return matvec(columns, np.stack([rng.standard_normal(columns.shape[-1]) for rng in rngs]))

    for name, model in (("f", motion.f), *(("h", each.h) for each in sensors)):
        if not callable(model) and model.shape[-1] != len(prior.cov):
            raise ValueError(f"prior: expected {model.shape[-1]} components to go with {name}, got {len(prior.cov)}")
    x = motion.space.plus(np.tile(prior.mean, (runs, 1)), draw(prior.sqrt_cov))
    V: Any = None
    truth, z = [], []
    for epoch in when:
        if epoch.dt:
            x = moved(motion, x, epoch, draw)
        row = []
        for each in sensors:
            augment = [draw(root)[None] for root in each.augment]
            y = evaluate(each, x[None].copy(), epoch, augment)[0]
            columns = at(each.noise, x, epoch)
            if phi is not None and zeta is not None and V is not None:
                V = matvec(phi(epoch) if callable(phi) else phi, V) + draw(at(zeta, x, epoch))
            else:
                V = None if columns is None else draw(columns)
            row.append(y if V is None else each.space.plus(y, of_rows("R", V, each.space.minus(y, y))))
        truth.append(x)
        z.append(row)
    columns_of_z = tuple(np.stack(column) for column in zip(*z, strict=True))
    return np.stack(truth), columns_of_z[0] if isinstance(sensor, Sensor) else columns_of_z


def moved(motion: Motion, x: Array, epoch: Epoch, draw: Any) -> Array:
    """States ``(runs, N)`` after an interval, with the process noise that ``draw`` gives of its columns."""
    augment = [draw(root)[None] for root in motion.augment]
    y = evaluate(motion, x[None].copy(), epoch, augment)[0]
    columns = at(motion.noise, x, epoch)
    return y if columns is None else motion.space.plus(y, of_rows("Q", draw(columns), motion.space.minus(y, y)))


def of_rows(name: str, noise: Array, like: Array) -> Array:
    """The noise, if it has the components of a difference."""
    if noise.shape[-1] != like.shape[-1]:
        raise ValueError(f"{name}: expected {like.shape[-1]} rows to go with the model, got {noise.shape[-1]}")
    return noise
