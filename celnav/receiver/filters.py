"""Filters of a moving receiver's log, by name: an EKF, and unscented filters that differ in what they do to the noise."""

from __future__ import annotations

from typing import Any

import numpy as np

from celnav.filters.adaptive import gate, innovation_window
from celnav.filters.driver import Epoch, Filter, sequential
from celnav.filters.info import Hook
from celnav.filters.parity import channel_parity, group_parity
from celnav.filters.robust import huber, sage_husa, student_t
from celnav.filters.step import predict, update
from celnav.gaussian.linalg import Array
from celnav.gaussian.points import unscented
from celnav.gaussian.taylor import Taylor
from celnav.gaussian.transform import Transform
from celnav.models import pseudorange
from celnav.models.receiver import CRYSTAL, process_noise, transition


def hooks(S: int, window: int = 10) -> dict[str, tuple[Hook, ...]]:
    """What each filter does to the noise of S ranges and S rates before it uses them; the ukf nothing."""
    return {
        "ukf": (),
        "aukf": (innovation_window(window),),
        "group": (parity_of_groups(S),),
        "channel": (channel_parity(window),),
        "gate": (gate(4.0),),
        "huber": (huber(),),
        "student": (student_t(4.0),),
        "sage-husa": (sage_husa(0.95),),
    }


def parity_of_groups(S: int) -> Hook:
    """The hook of the filter "group": ranges and rates of S satellites, each for a vector and a clock."""
    return group_parity((range(S), range(S, 2 * S)), 4)


def filters(S: int, *, acceleration: float = 0.01, window: int = 10) -> dict[str, Filter]:
    """Filters of a `Log` by name: ekf, and the unscented ones of `hooks`.

    ``acceleration``: density of the white acceleration, m^2/s^3: 0.01 for a receiver at rest or nearly so, ``a^2 T`` for one that
    turns with the acceleration a, measured each T seconds.

    Raises
    ------
    ValueError: unless it is positive.
    """
    if not (np.isfinite(acceleration) and acceleration > 0.0):
        raise ValueError(f"acceleration: expected a positive density in m^2/s^3, got {acceleration!r}")

    def adapted(rule: Transform, hook: tuple[Hook, ...]) -> Filter:
        move = Taylor(lambda _x, epoch: (transition(epoch.dt),))
        forward = predict(lambda x, epoch: x @ transition(epoch.dt).T, move, sqrt_Q=root)
        return sequential(forward, update(_measured, rule, sqrt_R=_noise, hooks=hook))

    def root(_mean: Array, epoch: Epoch) -> Array:
        return np.linalg.cholesky(process_noise(epoch.dt, acceleration, *CRYSTAL))

    rule: Any = unscented(8, 1.0, 2.0, 0.0)
    ekf = Taylor(lambda x, epoch: (pseudorange.jacobian(x, *epoch.u[:2]),))
    return {"ekf": adapted(ekf, ())} | {name: adapted(rule, hook) for name, hook in hooks(S, window).items()}


def _measured(x: Array, epoch: Epoch) -> Array:
    return pseudorange.measure(x, *epoch.u[:2])


def _noise(_mean: Array, epoch: Epoch) -> Array:
    return np.asarray(np.eye(epoch.u[2].shape[-1]) * epoch.u[2])
