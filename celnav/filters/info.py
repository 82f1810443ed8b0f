"""What passes between the parts of a filter: the joint that hooks see, and the record of a step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array

_LOG_2PI = float(np.log(2.0 * np.pi))


class Joint(NamedTuple):
    """The joint of a measurement (first m rows) and a state (other n rows): what a hook sees and may replace.

    Attributes
    ----------
    innovation: ``(..., m)``; set a component to nan to leave it out.
    columns: ``(..., m + n, q)`` from the prior; ``sign (q,)`` is -1 where a weight is negative.
    process, sensor: ``(..., m + n, r)`` and ``(..., m + n, s)``, additive noise of the dynamics and of the measurement.
    slopes: ``() -> tuple`` of statistical Jacobians, ``dz/dx`` first.
    """

    innovation: Array
    columns: Array
    sign: Array
    process: Array
    sensor: Array
    slopes: Callable[[], tuple[Array, ...]]


Hook = Callable[[Any, Joint, Any], tuple[Any, Joint]]
"""``(memory, joint, epoch) -> (memory, joint)``; the memory is None at the start."""
Gain = Array | Callable[[Array, Array, int], Array]
"""A prescribed gain ``(..., n, m)``, or a function of the pre-array ``A``, its ``sign`` and ``m`` that gives it."""


class Info(NamedTuple):
    """What one predict or update did.

    Attributes
    ----------
    innovation: ``(..., m)`` measurement minus its prediction, before hooks; nan where nothing was measured.
    white: ``(..., m)`` ``S^-1 innovation`` with the lower root S of the innovation covariance; 0 where not used.
    used: ``(..., m)`` bool, the components that took part.
    innovation_root: ``(..., m, m)`` S, with unit rows for components not used.
    gain: ``() -> (..., n, m)``.
    slopes: functions ``() -> tuple`` of statistical Jacobians, of the prediction (None without one) and of the update.
    failure: why a run of this step is no longer finite; empty if none newly failed.
    redone: ``(...)`` bool, the runs that `fallback` did again; None if there was none.
    silent: whether there was a measurement to take, but it was None.
    """

    innovation: Array | None = None
    white: Array | None = None
    used: Array | None = None
    innovation_root: Array | None = None
    gain: Callable[[], Array] | None = None
    slopes: tuple[Callable[[], tuple[Array, ...]] | None, ...] = ()
    failure: str = ""
    redone: Array | None = None
    silent: bool = False

    @property
    def nis(self) -> Array | None:
        """Normalized innovation squared, ``(...)``: chi-square with ``used.sum(-1)`` degrees of freedom."""
        return None if self.white is None else np.vecdot(self.white, self.white)

    @property
    def log_likelihood(self) -> Array | None:
        """Logarithm of the density of the components used, ``(...)``."""
        if self.white is None or self.used is None:
            return None
        value: Array = -0.5 * (self.nis + np.add.reduce(self.used, -1, int) * _LOG_2PI)
        if self.innovation_root is not None:
            with np.errstate(divide="ignore"):  # a lost run has a nan in `white`
                value = value - np.add.reduce(np.log(self.innovation_root.diagonal(0, -2, -1)), -1)
        return value
