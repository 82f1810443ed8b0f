"""What passes between the parts of a step: `Epoch`, `Info`, `State`, and what a filter is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array

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
