"""Checks of what filters are made of: each error names the argument, what was expected and what came."""

from __future__ import annotations

from collections.abc import Sequence
from inspect import signature
from math import prod
from typing import Any

import numpy as np

from celnav.gaussian import checks
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import kind, numbers
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space

MOST_REPETITIONS = 10_000


def check_model(name: str, function: Any, arguments: str = "(points, epoch)", noises: int = 0) -> None:
    """A model, or another function from outside, can be called with its arguments, and with so many noises after them."""
    arguments = arguments.replace(")", ", *noise)") if noises else arguments
    checks.function(name, function, arguments)
    if not takes(function, arguments.count(",") + (noises or 1)):
        raise ValueError(f"{name}: expected a function {arguments}, got {kind(function)} of other arguments")


def check_part(name: str, part: Any, kinds: tuple[int, ...] = (4,)) -> None:
    """A part is called with a belief and more: two arguments in all to predict, four to update."""
    if not any(takes(part, count) for count in kinds):
        called = " or ".join({2: "(belief, epoch)", 4: "(belief, z, epoch, memory)"}[count] for count in kinds)
        raise ValueError(f"{name}: expected a part {called}, got {kind(part)}")


def given_back(name: str, value: Any, what: str) -> Any:
    """What a function from outside gave back, if it is as many things as ``what`` names."""
    if not isinstance(value, tuple | list) or isinstance(value, Gaussian) or len(value) != what.count(",") + 1:
        raise ValueError(f"{name}: expected ({what}) from what was given, got {kind(value)}")
    return value


def check_belief(belief: Any, name: str = "belief") -> None:
    """A belief is a `Gaussian`."""
    checks.instance(name, belief, Gaussian, "a Gaussian, such as celnav.square_root(mean, cov)")


def check_memory(memory: Any, hooks: int) -> None:
    """The memory of hooks is what the update gave before."""
    if memory is not None and not (isinstance(memory, tuple) and len(memory) == hooks):
        raise ValueError(f"memory: expected None or what the update gave back, a tuple for {hooks} hooks, got {kind(memory)}")


def window(name: str, size: int, shape: tuple[int, ...]) -> Array:
    """A window of so many samples, none seen yet: nan."""
    if size * prod(shape) > checks.LIMIT:
        raise ValueError(f"{name}: expected a window of at most {checks.LIMIT} numbers, got {size} samples of {prod(shape)} each")
    return np.full((size, *shape), np.nan)


def positive(name: str, value: Any, zero: bool = False) -> float:
    """A positive number, or 0 if that may be; infinity, which is no bound at all, too."""
    if isinstance(value, float) and value == np.inf:
        return np.inf
    return checks.number(name, value, 0.0) if zero else checks.number(name, value, above=0.0)


def repetitions(name: str, value: Any) -> int:
    """How often something is done again at every step."""
    count = checks.integer(name, value)
    if count > MOST_REPETITIONS:
        raise ValueError(f"{name}: expected at most {MOST_REPETITIONS} at every step, got {count}")
    return count


def flag(name: str, value: Any) -> bool:
    """True or False."""
    return bool(checks.choice(name, value, [False, True]))


def check_rule(rule: Any, name: str = "rule") -> None:
    """A rule is an object with ``transform``, not the function that makes it and not filterpy's."""
    if isinstance(rule, type) or not hasattr(rule, "transform"):
        hint = " (celnav.from_filterpy makes it one)" if hasattr(rule, "sigma_points") else ""
        raise ValueError(f"{name}: expected a rule, such as celnav.unscented(n), got {kind(rule)}{hint}")


def check_space(name: str, space: Any) -> None:
    """A space is a `Space`."""
    checks.instance(name, space, Space, "a Space, such as celnav.angles([0])")


def check_state(belief: Any, space: Space) -> None:
    """A state of vectors has as many deviations as components."""
    if not isinstance(belief, Gaussian):
        check_belief(belief)
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
        parameters = signature(function)
    except (TypeError, ValueError):  # a function of C that does not say
        return True
    try:
        parameters.bind(*(None,) * count)
    except TypeError:
        return False
    return True


def measurement(z: Any, belief: Any) -> tuple[Array, Gaussian]:
    """A measurement ``(..., m)`` as floats, and the belief, once for each run if only the measurement has runs.

    Raises
    ------
    ValueError: if z is no array ``(..., m)``, or its batch axes do not go with those of the belief.
    """
    if not isinstance(belief, Gaussian):
        check_belief(belief)
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
