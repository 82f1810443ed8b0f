"""States from single measurements by weighted least squares, without a prior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from celnav.filters.joint import evaluate, noise_at
from celnav.filters.model import Sensor, check_matrices, check_prior
from celnav.filters.records import Epoch, Info, State
from celnav.filters.sequential import as_measurement
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import instance, integer, numbers, together, unmasked
from celnav.gaussian.linalg import Array, Covariance, matvec, outer

RANK = 1e-10
"""Least share of a Jacobian's column that is independent of the others; below it the state is
undetermined.
"""
AT_REST = 1e-4
"""Size of a step, in standard deviations, below which the iteration stops."""


def least_squares(sensor: Sensor, *, rounds: int = 10) -> LeastSquares:
    """A filter that computes a fix from every measurement by Gauss-Newton, from the last fix or the
    prior's mean.

    Components that are nan are left out. A run is nan at an epoch whose measurement is missing or
    does not determine the state. At the next epoch it starts from its last fix.

    sensor: a sensor with a ``jacobian`` and noise with independent components; ValueError
        otherwise.
    rounds: most Gauss-Newton iterations; a run stops when a step is below a ten-thousandth of its
        standard deviation.

    The filter is in covariance form. Its innovations are the residuals of the fix; its whitened
    innovations are the residuals over their standard deviations.

    >>> filter = least_squares(celnav.Sensor(ranges, R, jacobian=directions))
    >>> fixes = celnav.run(filter, guess, times, z)
    """
    instance("sensor", sensor, Sensor, "celnav.Sensor(h, R, jacobian=...)")
    if sensor.jacobian is None and callable(sensor.h):
        raise ValueError(
            "sensor: expected a sensor with a jacobian (mean, epoch) -> (..., m, n), got none"
        )
    columns = sensor.noise
    if columns is None:
        raise ValueError(
            "R: expected variances of independent components, got noise through the points"
        )
    if isinstance(columns, np.ndarray):
        columns = np.atleast_2d(columns)  # a single standard deviation may apply to all
        R = columns @ columns.mT
        variances = R.diagonal(0, -2, -1)
        beside = np.abs(R - variances[..., None] * np.eye(R.shape[-1])).max(initial=0.0)
        if (variances <= 0.0).any() or beside > 1e-12 * variances.max(initial=0.0):
            raise ValueError(
                "R: expected positive variances of independent components, a diagonal matrix, got "
                "another"
            )
    return LeastSquares(sensor, integer("rounds", rounds, 1, 10_000))


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """The filter that `least_squares` returns."""

    sensor: Sensor
    rounds: int

    def start(self, prior: Gaussian) -> State:
        """State before the first epoch."""
        check_prior(prior)
        n = prior.mean.shape[-1]
        check_matrices(n, n, self.sensor)
        return State(Covariance.of(prior), (prior.mean,))

    def step(self, state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        """State after an epoch: a fix, and its residuals."""
        x = state.memory[0]
        n = x.shape[-1]
        if epoch.z is None:
            return State(Covariance(x * np.nan, np.full((*x.shape, n), np.nan)), (x,)), (
                Info(silent=True),
            )
        z = as_measurement(epoch.z[0] if isinstance(epoch.z, tuple) else epoch.z, self.sensor)
        if self.sensor.m not in (None, z.shape[-1]):
            raise ValueError(
                f"z: expected {self.sensor.m} components to go with h, got {z.shape[-1]}"
            )
        batch = together(prior=x.shape[:-1], z=z.shape[:-1])
        x = np.broadcast_to(x, (*batch, n))
        z = np.broadcast_to(z, (*batch, z.shape[-1]))
        V = noise_at(self.sensor.noise, x, epoch)
        deviations = np.sqrt(np.square(V).sum(-1))

        def model(x: Array) -> tuple[Array, Array]:
            return self._value(x, epoch), self._jacobian(x, epoch, z.shape[-1])

        # x minimizes the sum of ((z - h(x)) / deviations)^2; root root' = (J' R^-1 J)^-1.
        x, fix, root = gauss_newton(model, z, deviations, x, self.rounds)
        left = z - self._value(x, epoch)
        whitened = np.nan_to_num(left / deviations)
        return State(Covariance(fix, outer(root)), (x,)), (Info(left, whitened, ~np.isnan(z)),)

    def _value(self, x: Array, epoch: Epoch) -> Array:
        return evaluate(self.sensor, x[None], epoch)[0, ...]

    def _jacobian(self, x: Array, epoch: Epoch, m: int) -> Array:
        J = self.sensor.jacobian(x, epoch) if self.sensor.jacobian is not None else self.sensor.h
        return numbers("jacobian", unmasked("jacobian", J), (..., m, x.shape[-1]))


def gauss_newton(
    model: Callable[[Array], tuple[Array, Array]],
    z: Array,
    deviations: Array,
    start: Array,
    rounds: int,
) -> tuple[Array, Array, Array]:
    """States ``x (..., n)`` that minimize the sum of ``((z - h(x)) / deviations)^2``.

    Parameters
    ----------
    model: ``x -> h(x) (..., m)`` and its Jacobian ``(..., m, n)``. z: measurements ``(..., m)``,
        nan where there is none. deviations: standard deviations ``(..., m)``. start: states
        ``(..., n)``. rounds: iterations at most.

    Returns
    -------
    The last states; the same with nan where measurements do not determine a state; and square roots
    of their covariances ``(..., n, n)``, with nan likewise.
    """
    x, n, used = start, start.shape[-1], ~np.isnan(z)
    weight = np.where(used, 1.0 / deviations, 0.0)
    enough, moving, eye = used.sum(-1) >= n, np.ones(start.shape[:-1], bool), np.eye(n)
    root, determined = np.zeros((*x.shape, n)), enough
    for _ in range(rounds if z.shape[-1] >= n else 0):  # too few measurements determine nothing
        values, G = model(x)
        G = weight[..., None] * G
        length = np.sqrt(np.square(G).sum(-2))
        Q, R = np.linalg.qr(G / np.where(length > 0.0, length, 1.0)[..., None, :])
        ranked = (np.abs(R.diagonal(0, -2, -1)).min(-1) > RANK) & enough
        inverse = np.linalg.solve(
            np.where(ranked[..., None, None], R * length[..., None, :], eye), eye
        )
        left = np.where(used, z - values, 0.0)
        step = np.where(ranked[..., None], matvec(Q.mT, weight * left), 0.0)
        # A converged run keeps its state while other runs still iterate.
        x = np.where(moving[..., None], x + matvec(inverse, step), x)
        root = np.where(moving[..., None, None], inverse, root)
        determined = np.where(moving, ranked, determined)
        moving = moving & (np.abs(step).max(-1) > AT_REST)
        if not moving.any():
            break
    fix = np.where(determined[..., None], x, np.nan)
    return x, fix, np.where(determined[..., None, None], root, np.nan)
