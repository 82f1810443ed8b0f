"""Checks of what filters are made of: each error names the argument, what was expected and what came."""

from __future__ import annotations

from collections.abc import Sequence
from inspect import signature
from typing import Any

import numpy as np

from celnav import checks
from celnav.checks import kind, numbers
from celnav.gaussian import Gaussian
from celnav.linalg import Array
from celnav.spaces import EUCLIDEAN, Space


def check_model(name: str, function: Any) -> None:
    """A model is a function."""
    checks.function(name, function, "(points, epoch)")


def check_rule(rule: Any, name: str = "rule") -> None:
    """A rule is an object with ``transform``, not the function that makes it and not filterpy's."""
    if isinstance(rule, type) or not hasattr(rule, "transform"):
        hint = " (celnav.from_filterpy makes it one)" if hasattr(rule, "sigma_points") else ""
        raise ValueError(f"{name}: expected a rule, such as celnav.unscented(n), got {kind(rule)}{hint}")


def check_space(name: str, space: Any) -> None:
    """A space is a `Space`."""
    checks.instance(name, space, Space, "a Space, such as celnav.angles([0])")


def check_state(belief: Gaussian, space: Space) -> None:
    """A state of vectors has as many deviations as components."""
    N, n = belief.mean.shape[-1], belief.spread.shape[-1]
    if n != N and space == EUCLIDEAN:
        raise ValueError(f"space: expected one for states of {N} components with {n} deviations, got vectors")


def check_hooks(hooks: Any) -> None:
    """Hooks are a sequence of functions of three arguments."""
    if isinstance(hooks, str) or not isinstance(hooks, Sequence):
        raise ValueError(f"hooks: expected a list of hooks, such as [celnav.filters.adaptive.gate(4.0)], got {kind(hooks)}")
    for hook in hooks:
        if not takes(hook, 3):
            raise ValueError(f"hooks: expected functions (memory, joint, epoch), got {kind(hook)}")


def takes(function: Any, count: int) -> bool:
    """Whether something can be called with so many arguments, as far as one can tell."""
    if not callable(function):
        return False
    try:
        signature(function).bind(*(None,) * count)
    except TypeError:
        return False
    except ValueError:  # a function of C that does not say
        return True
    return True


def measurement(z: Any, belief: Gaussian) -> tuple[Array, Gaussian]:
    """A measurement ``(..., m)`` as floats, and the belief, once for each run if only the measurement has runs.

    Raises
    ------
    ValueError: if z is no array ``(..., m)``, or its batch axes do not go with those of the belief.
    """
    measured = numbers("z", z)
    if measured.ndim == 0:
        raise ValueError(f"z: expected shape (..., m), got the number {measured}; one component is [z]")
    return measured, batched("z", measured.shape[:-1], belief)


def batched(name: str, batch: tuple[int, ...], belief: Gaussian) -> Gaussian:
    """The belief, once for each run if only the argument has runs.

    Raises
    ------
    ValueError: naming the argument, if its batch axes do not go with those of the belief.
    """
    own = belief.mean.shape[:-1]
    if not batch or batch == own:
        return belief
    try:
        joint = np.broadcast_shapes(batch, own)
    except ValueError:
        raise ValueError(f"{name}: batch axes {batch} do not go with those of the belief, {own}") from None
    return belief if joint == own else belief.broadcast_to(joint)


def check_extra(extra: Any) -> None:
    """Noises through the points are a sequence of their roots, matrices ``(..., k, k)``."""
    if not isinstance(extra, tuple | list) or not all(isinstance(root, np.ndarray) and root.ndim >= 2 for root in extra):
        raise ValueError("extra: expected a sequence of matrices, a root (k, k) for each noise, such as (np.eye(2),)")
