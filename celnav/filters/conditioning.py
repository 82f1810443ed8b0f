"""The one conditioning step, and what its arrays are made of.

Push a belief through a function, write the deviation columns down, set the noise columns beside them, condition on the first
m rows::

    A = [ D_z  N_z ]   m rows       predict: m = 0, g = f          update:   g = (h, identity)
        [ D_x  N_x ]   n rows       fused:   g = (h(f), f)         smoother: g = (f, identity), data = next state
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any
from warnings import warn

import numpy as np

from celnav.filters.arguments import check_model
from celnav.filters.info import Gain, Hook, Info, Joint
from celnav.filters.mixing import POINTS, check_runs_apart, unknown
from celnav.gaussian.belief import Gaussian, all_sound, sound, sqrt_cov
from celnav.gaussian.checks import finite, numbers, unmasked
from celnav.gaussian.linalg import Array, matvec, solve_upper_transposed, tria, whiten
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.transform import KEEP, Image, Outputs, Transform

_EPS = float(np.finfo(np.float64).eps)

Model = Callable[..., Any]
"""``(points (p, ..., N), epoch, *noise points) -> (p, ..., M)``."""
Noise = Array | Callable[[Array, Any], Array] | None
"""Columns ``(..., n, r)`` of a noise, constant or ``(mean, epoch) -> columns``; None: no noise."""


def noise_columns(cov: Any, sqrt: Any, name: str) -> Noise:
    """Noise columns from a covariance (checked) or from a root; either may be a function ``(mean, epoch)``. None of neither.

    Raises
    ------
    ValueError: naming the argument: both given, a covariance that is none, columns that are no matrix; of a function when called.
    """
    if cov is not None and sqrt is not None:
        raise ValueError(f"{name}: expected one of {name} and sqrt_{name}, got both")
    if sqrt is not None:
        if callable(sqrt):
            check_model(f"sqrt_{name}", sqrt, "(mean, epoch)")
            return partial(_columns_of, sqrt, f"sqrt_{name}")
        return _columns(f"sqrt_{name}", finite(f"sqrt_{name}", sqrt))
    if cov is None:
        return None
    if callable(cov):
        check_model(name, cov, "(mean, epoch)")
        return partial(_root_of, cov, name)
    return sqrt_cov(cov, name)


def _columns_of(function: Callable[[Array, Any], Any], name: str, mean: Array, epoch: Any) -> Array:
    return _columns(name, numbers(name, unmasked(name, function(mean, epoch))))


def _root_of(function: Callable[[Array, Any], Any], name: str, mean: Array, epoch: Any) -> Array:
    return sqrt_cov(function(mean, epoch), name)


def _columns(name: str, columns: Array) -> Array:
    if columns.ndim < 2:
        raise ValueError(f"{name}: expected columns of shape (..., n, r), got {columns.shape}")
    return columns


def set_noise(name: str, room: Array, columns: Array) -> None:
    """Write noise into its columns of a pre-array; an error names the noise, not the array."""
    if columns.shape[-2] != room.shape[-2]:
        raise ValueError(f"{name}: expected {room.shape[-2]} rows to go with the model, got {columns.shape[-2]}")
    room[...] = columns


def evaluate(noise: Any, mean: Array, epoch: Any) -> Any:
    """A constant as it is, a function evaluated."""
    return noise(mean, epoch) if callable(noise) else noise


def images(name: str, function: Model, points: Array, epoch: Any, noise: Sequence[Array], dimension: int | None = None) -> Array:
    """Values of a model function at the points, as floats of the shape they must have.

    The function may change its argument: rules make points for one call, and a caller with two hands out a copy.

    Raises
    ------
    ValueError: naming the function, if what it returns has another shape. What it raises itself carries a note of what it got.
    """
    copies = [array.copy(order="K") for array in (points, *noise)] if points.ndim > 2 and unknown(function, points) else None
    try:
        values = function(points, epoch, *noise)
        y: Array = values if type(values) is np.ndarray and values.dtype == np.float64 else _doubles(name, values, points)
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        given = "an input" if getattr(epoch, "u", None) is not None else "None"
        error.add_note(
            f"{name} is called with points {points.shape} and an Epoch: epoch.dt is its interval, epoch.u ({given}) its input"
        )
        error.add_note(POINTS)
        raise
    if y.ndim != points.ndim or y.shape[:-1] != points.shape[:-1] or (dimension is not None and y.shape[-1] != dimension):
        last = "m" if dimension is None else dimension
        expected = "(" + ", ".join(str(s) for s in (*points.shape[:-1], last)) + ")"
        raise ValueError(f"{name} returned shape {y.shape}, expected {expected}; {POINTS}")
    if copies is not None:
        y = y.copy(order="K")  # it may be a buffer of the model's
        check_runs_apart(name, function, copies, epoch, y)
    return y


def _doubles(name: str, values: Any, points: Array) -> Array:
    """Values as floats; warns of single precision where differences, all that a filter has of a model, are little but round-off."""
    y, given = numbers(name, unmasked(name, values)), np.asarray(values)
    single = given.dtype.kind == "f" and given.itemsize < y.itemsize
    if not single or len(points) == 1 or not y.size or y.shape[:-1] != points.shape[:-1]:
        return y
    differences, moved = np.ptp(y, 0), np.ptp(points, 0) > 0.0
    moved = moved if moved.shape == differences.shape else moved.any(-1, keepdims=True)
    if (moved & (differences < 1e3 * np.finfo(given.dtype).eps * np.abs(y).max(0))).any():
        warn(
            f"{name} returns {given.dtype}: its values differ between points by little more than round-off. Compute in float64.",
            RuntimeWarning,
            stacklevel=4,
        )
    return y


def innovation_of(z: Array, predicted: Image, space: Space) -> Array:
    """Measurement minus its prediction, ``(..., m)``; on a space that wraps the mean may lie across the seam from its center."""
    difference = space.minus(z, predicted.center)
    if space is EUCLIDEAN or not isinstance(predicted.shift, np.ndarray):
        return np.asarray(difference - predicted.shift)
    return space.minus(space.plus(predicted.center, difference - predicted.shift), predicted.center)


def condition(
    belief: Gaussian,
    state: Image,
    A: Array,
    sign: Array,
    innovation: Array,
    *,
    noise: tuple[int, int] = (0, 0),
    space: Space = EUCLIDEAN,
    slopes: Callable[[], tuple[Array, ...]] = tuple,
    hooks: Sequence[Hook] = (),
    memory: Any = None,
    gain: Gain | None = None,
    epoch: Any = None,
    known: tuple[Array, Array] | None = None,
) -> tuple[Gaussian, Info, Any]:
    """Condition a state on an innovation, given the pre-array of both.

    Parameters
    ----------
    belief: gives the form, and batch axes that A may lack.
    state: image of the state; its rows are the last n of ``A``.
    A: pre-array ``(..., m + n, q + r + s)``: columns of the prior, of the process noise and of the measurement noise.
    sign: ``(q,)``.
    innovation: ``(..., m)``, nan where not measured: those rows are marginalized exactly, in each run by itself.
    noise: ``(r, s)``.
    space: of the state. slopes: what hooks get as `Joint.slopes`, and the `Info` after them.
    hooks, memory, gain, epoch: see `celnav.filters.step.update`.
    known: see `celnav.gaussian.belief.Form`; not used where a hook changes the state's rows.

    Returns
    -------
    The belief after it, the `Info` and the hooks' memory.
    """
    m = innovation.shape[-1]
    measured = innovation
    kept = memory
    if hooks:
        r, s = noise
        q = A.shape[-1] - r - s
        before, counts = A[..., m:, :].copy(), sign  # a hook may replace the joint's arrays or write into them
        joint = Joint(innovation.copy(), A[..., :q], sign, A[..., q : q + r], A[..., q + r :], slopes)
        memories = []
        for hook, own in zip(hooks, (None,) * len(hooks) if memory is None else memory, strict=True):
            own, joint = hook(own, joint, epoch)
            memories.append(own)
        kept, innovation, sign = tuple(memories), joint.innovation, joint.sign
        A = np.concatenate([joint.columns, joint.process, joint.sensor], -1)
        if sign is not counts or not np.array_equal(A[..., m:, :], before):
            known = None
    used = innovation == innovation
    if not used.all():
        A, innovation = _left_out(A, innovation, used)
    K = gain(A, sign, m) if callable(gain) else gain  # after the mask: a prescribed gain must see what is missing
    if K is not None:
        K = _checked_gain(K, A.shape[-2] - m, m)
        if not used.all():
            K = K * used[..., None, :]
    S, U, spread = belief.form.condition(A, sign, m, K, known)
    white = whiten(S, innovation)
    step = state.shift + (matvec(U, white) if K is None else matvec(K, innovation))
    if space.transport is not None:
        spread = _transported(belief, space.transport(step), spread)
    posterior = Gaussian(space.plus(state.center, step), spread, belief.form)

    def optimal() -> Array:
        return solve_upper_transposed(S, U.mT).mT if K is None else K

    return posterior, Info(measured, white, used, S, optimal, (None, slopes)), kept


def _checked_gain(gain: Any, n: int, m: int) -> Array:
    K = numbers("gain", gain)
    if K.ndim < 2 or K.shape[-2:] != (n, m):
        raise ValueError(f"gain: expected shape (..., {n}, {m}), got {K.shape}")
    return K


def _left_out(A: Array, innovation: Array, used: Array) -> tuple[Array, Array]:
    """Rows that were not measured: no columns from the prior, a unit noise of their own and a zero innovation."""
    m, rows = used.shape[-1], A.shape[-2]
    batch = np.broadcast_shapes(A.shape[:-2], used.shape[:-1])
    keep = np.ones((*batch, rows, 1))
    keep[..., :m, 0] = used
    unit = np.zeros((*batch, rows, m))
    unit[..., np.arange(m), np.arange(m)] = ~used
    return np.concatenate([A * keep, unit], -1), np.where(used, innovation, 0.0)


def _transported(belief: Gaussian, matrix: Array, spread: Array) -> Array:
    if belief.form.name == "covariance":
        return matrix @ spread @ matrix.mT
    return tria(matrix @ spread)


def informed(posterior: Gaussian, info: Info, exact: Array, spread: Array, size: Array) -> Gaussian:
    """The posterior, but nan for runs in which a measurement without noise is of what was known already.

    Parameters
    ----------
    exact: ``(..., m)`` bool, the components used that have no noise.
    spread, size: ``(..., m)``, what the measurement varies by over the belief, direction by direction, and how large it is: what is
        left of either after cancellation is round-off.
    """
    S = info.innovation_root
    assert S is not None
    rounding = np.sqrt(_EPS) if posterior.form.name == "covariance" else _EPS
    least = 16.0 * (rounding * spread + _EPS * size)
    nothing = np.asarray((exact & (S.diagonal(0, -2, -1) <= least)).any(-1))
    if not nothing.any():
        return posterior
    mean = np.where(nothing[..., None], np.nan, posterior.mean)
    return Gaussian(mean, np.where(nothing[..., None, None], np.nan, posterior.spread), posterior.form)


INDEFINITE = "the innovation covariance is not positive definite"


def settled(
    before: Gaussian,
    after: Gaussian,
    names: Sequence[str],
    rule: Transform,
    g: Callable[..., Outputs],
    space: Space,
    extra: Sequence[Array] = (),
    z: Array | None = None,
) -> tuple[Gaussian, str]:
    """The belief after a step, nan in runs that are lost, and why one that was sound before is not; empty if there is none."""
    if all_sound(after):
        return after, ""
    kept = sound(after)
    lost = sound(before) & ~kept
    mean, spread = np.where(kept[..., None], after.mean, np.nan), np.where(kept[..., None, None], after.spread, np.nan)
    return Gaussian(mean, spread, after.form), _reason(before, lost, names, rule, g, space, extra, z) if lost.any() else ""


def _reason(
    before: Gaussian,
    lost: Array,
    names: Sequence[str],
    rule: Transform,
    g: Callable[..., Outputs],
    space: Space,
    extra: Sequence[Array],
    z: Array | None,
) -> str:
    if z is not None and np.isinf(z).any():
        return "z is infinite"
    root = before.form.root(before.spread)
    if (lost & ~np.isfinite(root).all((-2, -1))).any():
        return "the covariance lost positive definiteness in the step before; a prior of celnav.square_root has twice the digits"
    for name, y in zip(names, g(*rule.points(before.mean, root, space, extra)), strict=False):
        if y is KEEP:
            continue
        bad = ~np.isfinite(y).all(-1) & lost
        if bad.any():
            return f"{name} is not finite at sigma point {int(np.argwhere(bad)[0, 0])}"
    return "the covariance lost positive definiteness" if z is None else INDEFINITE
