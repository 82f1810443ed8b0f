"""Simulation of truth and measurements with the `Motion` and `Sensor` of a filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.colored import coloring, zeta_of
from celnav.filters.joint import evaluate, noise_at
from celnav.filters.model import Motion, Sensor, check_matrices
from celnav.filters.records import Epoch, epochs, without_input
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import instance, integer, sequence
from celnav.gaussian.linalg import Array, matvec
from celnav.study.montecarlo import Draws, generators

__all__ = ["simulate"]

MOST_RUNS = 1_000_000  # random generators need time and memory


def simulate(
    motion: Motion,
    sensor: Sensor | Sequence[Sensor],
    prior: Gaussian,
    times: ArrayLike,
    *,
    runs: int | Sequence[np.random.Generator] | None = None,
    seed: int = 0,
    u: Any = None,
    Phi: Any = None,
) -> tuple[Array, Any]:
    """Draw truth ``(T, runs, N)`` and measurements ``(T, runs, m)`` from models; for a sequence of
    sensors, a tuple of measurements.

    motion, sensor: the models of a filter; a sequence of sensors is possible. Augmented noise is
        drawn too.
    prior: initial mean ``(N,)`` and covariance ``(n, n)``.
    times: ``(T,)`` s. u: inputs, as in `celnav.epochs`.
    runs: number of runs. None gives one run without a run axis, ``(T, N)`` and ``(T, m)``. A list
        of generators has one for each run.
    seed: run r uses the generator of ``(seed, 0, r)``, whatever the number of runs.
    Phi: ``(m, m)`` or a function of the epoch, for colored noise ``V' = Phi V + zeta``, where zeta
        has covariance R (one sensor only).

    ValueError names an argument that does not fit.

    >>> truth, z = celnav.simulate(motion, gps, prior, np.arange(601.0), runs=500)
    """
    instance("motion", motion, Motion, "celnav.Motion(f, Q)")
    sensors = (
        [sensor]
        if isinstance(sensor, Sensor)
        else sequence("sensor", sensor, "[celnav.Sensor(h, R)]", least=1)
    )
    for each in sensors:
        instance("sensor", each, Sensor, "celnav.Sensor(h, R)")
    if Phi is not None and len(sensors) != 1:
        raise ValueError(f"Phi: expected one sensor with it, got {len(sensors)}")
    instance("prior", prior, Gaussian, "celnav.Gaussian(mean, cov)")
    if prior.mean.ndim != 1 or prior.cov.ndim != 2:
        raise ValueError(
            f"prior: expected one mean (N,) and covariance (n, n), got {prior.mean.shape} and "
            f"{prior.cov.shape}"
        )
    check_matrices(len(prior.mean), len(prior.cov), motion, *sensors)
    if (
        isinstance(runs, list | tuple)
        and runs
        and all(hasattr(rng, "standard_normal") for rng in runs)
    ):
        rngs: Sequence[np.random.Generator] = runs
    else:
        if (count := integer("runs", 1 if runs is None else runs)) > MOST_RUNS:
            raise ValueError(f"runs: expected at most {MOST_RUNS}, got {count}")
        rngs = generators(seed, 0, count)

    normal = Draws(rngs, owned=rngs is not runs)

    def draw(columns: Array) -> Array:
        return matvec(columns, normal(columns.shape[-1]))

    def white(model: Motion | Sensor, x: Array, epoch: Epoch, rows: int) -> Any:
        columns = model.columns(x, epoch, rows)
        return None if columns is None else draw(columns)

    def image(
        name: str, model: Motion | Sensor, x: Array, epoch: Epoch, noise: Callable[..., Any] = white
    ) -> Array:
        """Values of a model at states ``(runs, N)``, with augmented noise and the additive noise
        ``name``.
        """
        augment = [draw(root)[None] for root in model.augment]
        y: Array = evaluate(model, x[None].copy(), epoch, augment)[0]
        rows = model.space.minus(y, y).shape[-1]
        added = noise(model, x, epoch, rows)
        if added is None:
            return y
        if added.shape[-1] != rows:
            raise ValueError(
                f"{name}: expected {rows} rows to go with the model, got {added.shape[-1]}"
            )
        return model.space.plus(y, added)

    measured_noise, V = white, None
    if Phi is not None:
        phi, zeta = coloring(Phi, sensors[0].m), zeta_of(sensors[0], Phi, None)

        def measured_noise(model: Motion | Sensor, x: Array, epoch: Epoch, rows: int) -> Any:
            nonlocal V
            V = (
                white(model, x, epoch, rows)
                if V is None
                else matvec(phi(epoch) if callable(phi) else phi, V)
                + draw(noise_at(zeta, x, epoch))
            )
            return V

    x = motion.space.plus(np.tile(prior.mean, (len(rngs), 1)), draw(prior.sqrt_cov))
    truth, z = [], []
    for epoch in epochs(times, u=u):
        try:
            if epoch.dt:
                x = image("Q", motion, x, epoch)
            z.append([image("R", each, x, epoch, measured_noise) for each in sensors])
        except (AttributeError, TypeError) as error:
            raise without_input(error, epoch) from error
        truth.append(x)
    normal.close()
    shown = (slice(None), 0) if runs is None else slice(None)
    measured = tuple(np.stack(column)[shown] for column in zip(*z, strict=True))
    return np.stack(truth)[shown], measured[0] if isinstance(sensor, Sensor) else measured
