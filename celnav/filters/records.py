"""What passes between the parts of a step: `Epoch`, `Joint`, `Info`, `State`, and what a filter is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, block
from celnav.gaussian.rules import Image

_LOG_2PI = float(np.log(2.0 * np.pi))


class FilterError(ArithmeticError):
    """A run lost definiteness or met numbers that are not finite; the message says which run, when and why."""


class Epoch(NamedTuple):
    """What is known about the interval ``(t - dt, t]`` and the sample at its end.

    Attributes
    ----------
    k: index. t: time, s. dt: length of the interval, s.
    u: the input that acts over the interval.
    z: one measurement ``(..., m)`` or a tuple of them, one for each sensor; nan or None where there is none.
    truth: whatever a simulation wants to hand on.
    """

    k: int = 0
    t: Any = 0.0
    dt: Any = 0.0
    u: Any = None
    z: Any = None
    truth: Any = None


class Joint(NamedTuple):
    """The joint of a measurement (m rows) and a state (n rows): what a hook sees and may replace.

    Attributes
    ----------
    innovation: ``(..., m)``, measurement minus prediction; nan where nothing was measured, or a hook leaves it out. None where
        there is nothing to condition on.
    measurement, state: their images, with columns ``(..., m, q)`` and ``(..., n, q)`` from the prior.
    sign: ``(q,)``, -1 where a weight is negative; one 1 may stand for all.
    process_noise: its columns ``(..., m, r)`` in the measurement and ``(..., n, r)`` in the state, 0 for zeros; None without.
    measurement_noise: its columns ``(..., m, s)``; None without.
    known: the state's own root or covariance, where the state is that of the belief and nothing was added.
    noise_first: whether the measurement noise stands first among the `columns`; no sign may be negative then.
    """

    innovation: Array | None
    measurement: Image | None
    state: Image
    sign: Array
    process_noise: tuple[Any, Any] | None = None
    measurement_noise: Array | None = None
    known: Array | None = None
    noise_first: bool = False

    def columns(self) -> Array:
        """The pre-array ``(..., m + n, q + r + s)``.

        [ D_z  W_z  V ]   m rows
        [ D_x  W_x  0 ]   n rows

        Small columns after large ones keep their digits in a QR, and noise is what may be small. Only where the state is kept and
        its measurement linear V comes first: most reflections are then short or nothing, which takes half the time.
        """
        D = self.state.columns
        if self.measurement is None:
            W = None if self.process_noise is None else self.process_noise[1]
            if W is None or type(W) is int:
                return D
            return np.concatenate((D, W), -1) if D.ndim == W.ndim == 2 else block([[D, W]])
        rows: list[list[Any]] = [[self.measurement.columns], [D]]
        if self.process_noise is not None:
            for row, part in zip(rows, self.process_noise, strict=True):
                row.append(part)
        if self.measurement_noise is not None:
            at = 0 if self.noise_first else len(rows[0])
            rows[0].insert(at, self.measurement_noise)
            rows[1].insert(at, 0)
        return block(rows)

    def covariances(self) -> tuple[Array, Array]:
        """Of the innovation without measurement noise ``(..., m, m)``, and of state and innovation ``(..., n, m)``."""
        assert self.measurement is not None
        D_z, D_x = self.measurement.columns, self.state.columns
        S0, cross = (D_z * self.sign) @ D_z.mT, (D_x * self.sign) @ D_z.mT
        if self.process_noise is not None:
            W_z, W_x = self.process_noise
            if type(W_z) is not int:
                S0 = S0 + W_z @ W_z.mT
                cross = cross if type(W_x) is int else cross + W_x @ W_z.mT
        return S0, cross

    def variances(self) -> tuple[Array, Array]:
        """Variances ``(..., m)`` of the innovation without measurement noise, and of that noise."""
        assert self.measurement is not None
        D = self.measurement.columns
        prior = np.einsum("...ij,...ij,j->...i", D, D, np.broadcast_to(self.sign, D.shape[-1:]))
        if self.process_noise is not None and type(self.process_noise[0]) is not int:
            prior = prior + np.square(self.process_noise[0]).sum(-1)
        V = self.measurement_noise
        return prior, np.zeros(D.shape[-2]) if V is None else np.einsum("...ij,...ij->...i", V, V)

    def std(self) -> Array:
        """Standard deviations ``(..., n)`` of the state."""
        D = self.state.columns
        variance = np.einsum("...ij,...ij,j->...i", D, D, np.broadcast_to(self.sign, D.shape[-1:]))
        if self.process_noise is not None and type(self.process_noise[1]) is not int:
            variance = variance + np.square(self.process_noise[1]).sum(-1)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def leaving_out(self, mask: Array) -> Joint:
        """Without the components of the measurement where ``mask (..., m)`` is True."""
        return self._replace(innovation=np.where(mask, np.nan, np.asarray(self.innovation)))

    def inflated(self, factor: Array) -> Joint:
        """With measurement noise of standard deviations ``factor (..., m)`` times as large."""
        return (
            self if self.measurement_noise is None else self._replace(measurement_noise=factor[..., None] * self.measurement_noise)
        )


Hook = Callable[[Any, Joint, Any], tuple[Any, Joint]]
"""``(memory, joint, epoch) -> (memory, joint)``; the memory is None at the start."""
Gain = Array | Callable[[Array, Array, int], Array]
"""A prescribed gain ``(..., n, m)``, or a function of the pre-array ``A``, its ``sign`` and ``m`` that gives it."""


class Info(NamedTuple):
    """What one measurement did to a belief.

    Attributes
    ----------
    innovation: ``(..., m)`` measurement minus its prediction, before hooks; nan where nothing was measured.
    whitened: ``(..., m)`` ``S^-1 innovation`` with the lower root S of the innovation covariance; 0 where not used.
    used: ``(..., m)`` bool, the components that took part.
    sqrt_S: ``(..., m, m)`` S, with unit rows for components not used.
    gain, jacobian: ``() -> (..., n, m)`` and ``() -> (..., m, n)``, the measurement's (statistical) Jacobian.
    redone: ``(...)`` bool, the runs that a `celnav.filters.fallback.Fallback` did again; None if there was none.
    silent: whether there was no measurement at all, not even nan.
    """

    innovation: Array | None = None
    whitened: Array | None = None
    used: Array | None = None
    sqrt_S: Array | None = None
    gain: Callable[[], Array] | None = None
    jacobian: Callable[[], Array] | None = None
    redone: Array | None = None
    silent: bool = False

    @property
    def nis(self) -> Array | None:
        """Normalized innovation squared, ``(...)``: chi-square with ``used.sum(-1)`` degrees of freedom."""
        return None if self.whitened is None else np.vecdot(self.whitened, self.whitened)

    @property
    def log_likelihood(self) -> Array | None:
        """Logarithm of the density of the components used, ``(...)``."""
        if self.whitened is None or self.used is None:
            return None
        value: Array = -0.5 * (self.nis + np.add.reduce(self.used, -1, int) * _LOG_2PI)
        if self.sqrt_S is not None:
            with np.errstate(divide="ignore"):  # a lost run has a nan in `whitened`
                value = value - np.add.reduce(np.log(self.sqrt_S.diagonal(0, -2, -1)), -1)
        return value


class State(NamedTuple):
    """State of a filter between epochs: the belief, and the memories of the hooks of each sensor."""

    belief: Any
    memory: tuple[Any, ...] = ()


class FromFunctions(NamedTuple):
    """A filter of two functions, for what no class here does; see `Filter`."""

    start: Callable[[Gaussian], Any]
    step: Callable[[Any, Epoch], tuple[Any, tuple[Info, ...]]]


class Filter(Protocol):
    """What `celnav.run` asks of a filter. All its memory lies in the state, which can be kept, copied and resumed."""

    def start(self, prior: Gaussian) -> Any:
        """State before the first epoch; ``state.belief`` is the estimate."""

    def step(self, state: Any, epoch: Epoch) -> tuple[Any, tuple[Info, ...]]:
        """State after an epoch, and an `Info` of each sensor."""
