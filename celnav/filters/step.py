"""The one conditioning step, and the parts that every filter is made of: predict and update.

Push a belief through a function, write the deviation columns down, set the noise columns beside them, condition on the first
m rows::

    A = [ D_z  N_z ]   m rows       predict: m = 0, g = f          update:   g = (h, identity)
        [ D_x  N_x ]   n rows       fused:   g = (h(f), f)         smoother: g = (f, identity), data = next state

Functions of a model take points ``(p, ..., N)`` (the point axis leads, so inputs per run broadcast by themselves) and the
`Epoch` at hand; noise that goes through the points follows as further arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.info import Gain, Hook, Info, Joint
from celnav.gaussian import Gaussian, finite, sqrt_cov
from celnav.linalg import Array, matvec, solve_upper_transposed, tria, whiten
from celnav.points import KEEP, Image, Outputs, Transform
from celnav.spaces import EUCLIDEAN, Space

Model = Callable[..., Any]
"""``(points (p, ..., N), epoch, *noise points) -> (p, ..., M)``."""
Noise = Array | Callable[[Array, Any], Array] | None
"""Columns ``(..., n, r)`` of a noise, constant or ``(mean, epoch) -> columns``; None: no noise."""


def _prior(belief: Gaussian, rule: Transform) -> tuple[Array, Array]:
    """A root, and what its columns count with: what only Jacobians act on need not be factored."""
    return belief.columns if rule.linear else (belief.root, rule.sign)


Predict = Callable[[Gaussian, Any], tuple[Gaussian, Info]]
Update = Callable[..., tuple[Gaussian, Info, Any]]


def noise_columns(cov: Any, sqrt: Any, name: str) -> Noise:
    """Noise columns from a covariance (checked) or from a root; either may be a function ``(mean, epoch)``."""
    if cov is not None and sqrt is not None:
        raise ValueError(f"{name}: expected one of {name} and sqrt_{name}, got both")
    if sqrt is not None:
        if callable(sqrt):
            function: Callable[[Array, Any], Array] = sqrt
            return function
        columns = finite(f"sqrt_{name}", sqrt)
        if columns.ndim < 2:
            raise ValueError(f"sqrt_{name}: expected columns of shape (..., n, r), got {columns.shape}")
        return columns
    if cov is None:
        return None
    if callable(cov):
        return lambda mean, epoch: sqrt_cov(cov(mean, epoch), name)
    return sqrt_cov(cov, name)


def evaluate(noise: Any, mean: Array, epoch: Any) -> Any:
    """A constant as it is, a function evaluated."""
    return noise(mean, epoch) if callable(noise) else noise


def images(name: str, function: Model, points: Array, epoch: Any, noise: Sequence[Array], dimension: int | None = None) -> Array:
    """Values of a model function at the points, as floats of the shape they must have.

    The function may change its argument: rules make points for one call, and a caller with two hands out a copy.
    """
    y = np.asarray(function(points, epoch, *noise), dtype=np.float64)
    if y.ndim != points.ndim or y.shape[:-1] != points.shape[:-1] or (dimension is not None and y.shape[-1] != dimension):
        last = "m" if dimension is None else dimension
        expected = "(" + ", ".join(str(s) for s in (*points.shape[:-1], last)) + ")"
        raise ValueError(f"{name} returned shape {y.shape}, expected {expected}")
    return y


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
    known: Array | None = None,
) -> tuple[Gaussian, Info, Any]:
    """Condition a state on an innovation, given the pre-array of both.

    Parameters
    ----------
    belief: gives the form.
    state: image of the state; its rows are the last n of ``A``.
    A: pre-array ``(..., m + n, q + r + s)``: columns of the prior, of the process noise and of the measurement noise.
    sign: ``(q,)``.
    innovation: ``(..., m)``, nan where not measured: those rows are marginalized exactly, in each run by itself.
    noise: ``(r, s)``.
    known: spread of the state's rows, if it is at hand; not used where a hook replaces columns of these.
    """
    m = innovation.shape[-1]
    measured = innovation
    kept = memory
    if hooks:
        r, s = noise
        q = A.shape[-1] - r - s
        joint = given = Joint(innovation, A[..., :q], sign, A[..., q : q + r], A[..., q + r :], slopes)
        memories = []
        for hook, own in zip(hooks, (None,) * len(hooks) if memory is None else memory, strict=True):
            own, joint = hook(own, joint, epoch)
            memories.append(own)
        kept, innovation, sign = tuple(memories), joint.innovation, joint.sign
        same = joint.columns is given.columns and joint.sign is given.sign and joint.process is given.process
        if not same or (joint.sensor is not given.sensor and joint.sensor[..., m:, :].any()):
            known = None
        A = np.concatenate([joint.columns, joint.process, joint.sensor], -1)
    used = innovation == innovation
    if not used.all():
        A, innovation = _left_out(A, innovation, used)
    K = gain(A, sign, m) if callable(gain) else gain  # after the mask: a prescribed gain must see what is missing
    S, U, spread = belief.form.condition(A, sign, m, K, known)
    white = whiten(S, innovation)
    step = state.shift + (matvec(U, white) if K is None else matvec(K, innovation))
    if space.transport is not None:
        spread = _transported(belief, space.transport(step), spread)
    posterior = Gaussian(space.plus(state.center, step), spread, belief.form)

    def optimal() -> Array:
        return solve_upper_transposed(S, U.mT).mT if K is None else K

    return posterior, Info(measured, white, used, S, optimal, (None, slopes)), kept


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


def predict(
    f: Model,
    rule: Transform,
    Q: Any = None,
    *,
    sqrt_Q: Any = None,
    extra: Sequence[Array] = (),
    space: Space = EUCLIDEAN,
) -> Predict:
    """The part that moves a belief through the dynamics ``x' = f(x, epoch) + w``, ``w ~ N(0, Q)``.

    Parameters
    ----------
    f: model function; see `Model`.
    rule: any `Transform`, of dimension n plus that of ``extra``.
    Q, sqrt_Q: process noise as a covariance ``(..., n, n)`` or as columns ``(..., n, r)`` (one of them, or neither).
    extra: roots ``(k, k)`` of noises that go *through* the points (augmentation): ``f(x, epoch, *noise)``.
    space: the state's space.

    Returns
    -------
    ``(belief, epoch) -> (belief, info)``.
    """
    columns = noise_columns(Q, sqrt_Q, "Q")

    def part(belief: Gaussian, epoch: Any = None) -> tuple[Gaussian, Info]:
        noise = evaluate(columns, belief.mean, epoch)
        r = 0 if noise is None else noise.shape[-1]
        root, sign = _prior(belief, rule)

        def g(points: Array, *w: Array) -> Outputs:
            return (images("f", f, points, epoch, w, belief.mean.shape[-1]),)

        (state,), A = rule.transform(g, belief.mean, root, space, (space,), extra, r, epoch)
        if r:
            _set_noise("Q", A[..., A.shape[-1] - r :], noise)
        predicted = Gaussian(space.plus(state.center, state.shift), belief.form.marginal(A, sign), belief.form)
        failure = explain(belief, predicted, ("f",), rule, g, space, extra)
        return predicted, Info(slopes=(lambda: (rule.slope(state, root),),), failure=failure)

    return part


def update(
    h: Model | ArrayLike,
    rule: Transform,
    R: Any = None,
    *,
    sqrt_R: Any = None,
    extra: Sequence[Array] = (),
    space: Space = EUCLIDEAN,
    measurement_space: Space = EUCLIDEAN,
    hooks: Sequence[Hook] = (),
    gain: Gain | None = None,
) -> Update:
    """The part that conditions a belief on a measurement ``z = h(x, epoch) + v``, ``v ~ N(0, R)``.

    Parameters
    ----------
    h: model function, or a matrix ``(..., m, n)``: a linear measurement is exact and cheap under any rule.
    rule: any `Transform`, of dimension n plus that of ``extra``.
    R, sqrt_R: measurement noise as a covariance ``(..., m, m)`` or as columns ``(..., m, s)`` (one of them, or neither).
    extra: roots of noises that go through the points: ``h(x, epoch, *noise)``.
    space, measurement_space: the spaces of state and measurement.
    hooks: each sees the joint and may replace it; see `Hook`.
    gain: a prescribed gain instead of the optimal one; see `Gain`.

    Returns
    -------
    ``(belief, z, epoch=None, memory=None) -> (belief, info, memory)``. ``z (..., m)``: nan components are left out.
    """
    columns = noise_columns(R, sqrt_R, "R")
    plain = not hooks and gain is None
    if callable(h):
        lift = _through_rule(h, rule, extra, space, measurement_space, plain)
    else:
        lift = _through_matrix(h, noise_first=not hooks)

    def part(belief: Gaussian, z: Any, epoch: Any = None, memory: Any = None) -> tuple[Gaussian, Info, Any]:
        z = np.asarray(z, dtype=np.float64)
        if np.isnan(z).all():
            return belief, _skipped(belief, z, measurement_space), memory
        if measurement_space.check is not None:
            z = measurement_space.check(z, "z")
        noise = evaluate(columns, belief.mean, epoch)
        s = 0 if noise is None else noise.shape[-1]
        lifted = lift(belief, z.shape[-1] if z.ndim else 0, epoch, s)
        A, measured = lifted.A, lifted.measured
        if s:
            m = measured.columns.shape[-2]
            _set_noise("R", A[..., :m, lifted.room], noise)
            A[..., m:, lifted.room] = 0.0
        innovation = measurement_space.minus(z, measured.center) - measured.shift
        posterior, info, kept = condition(
            belief, lifted.state, A, lifted.sign, innovation,
            noise=(0, s), space=space, slopes=lifted.slopes, hooks=hooks, memory=memory, gain=gain, epoch=epoch,
            known=belief.spread,
        )  # fmt: skip
        failure = explain(belief, posterior, ("h",), rule, lifted.g, space, extra, z)
        return posterior, info._replace(failure=failure) if failure else info, kept

    return part


def _skipped(belief: Gaussian, z: Array, space: Space) -> Info:
    """The record of a measurement that is wholly missing."""
    one = z.reshape(-1, z.shape[-1])[0]
    shape = (*np.broadcast_shapes(z.shape[:-1], belief.mean.shape[:-1]), space.minus(one, one).shape[-1])
    return Info(np.full(shape, np.nan), np.zeros(shape), np.zeros(shape, bool))


class _Lifted(NamedTuple):
    """A belief seen through a measurement: both images, the pre-array, its room for noise, and how it came about."""

    measured: Image
    state: Image
    A: Array
    room: slice
    sign: Array
    slopes: Callable[[], tuple[Array, ...]]
    g: Callable[..., Outputs]


def _through_rule(
    h: Model, rule: Transform, extra: Sequence[Array], space: Space, measurement_space: Space, plain: bool
) -> Callable[..., _Lifted]:
    def lift(belief: Gaussian, m: int, epoch: Any, room: int) -> _Lifted:
        root, sign = _prior(belief, rule) if plain else (belief.root, rule.sign)

        def g(points: Array, *v: Array) -> Outputs:
            return images("h", h, points, epoch, v, m), KEEP

        (measured, state), A = rule.transform(g, belief.mean, root, space, (measurement_space, space), extra, room, epoch)
        noise = slice(A.shape[-1] - room, None)
        return _Lifted(measured, state, A, noise, sign, lambda: (rule.slope(measured, root),), g)

    return lift


def _through_matrix(h: ArrayLike, noise_first: bool) -> Callable[..., _Lifted]:
    """A linear measurement needs no points: its columns are exactly ``H @ root``.

    With the noise before the triangular root most of the QR's reflections are short or nothing: it takes half the time.
    """
    H = finite("h", h)
    if H.ndim < 2:
        raise ValueError(f"h: expected a function or a matrix (..., m, n), got shape {H.shape}")
    rows, n = H.shape[-2:]
    positive = np.ones(n)

    def lift(belief: Gaussian, m: int, _: Any, room: int) -> _Lifted:
        if belief.spread.shape[-1] != n:
            raise ValueError(f"h: expected a matrix (m, {belief.spread.shape[-1]}), got ({rows}, {n})")
        if m != rows:
            raise ValueError(f"z: expected {rows} components to go with h, got {m}")
        root = belief.form.root(belief.spread)
        batch = root.shape[:-2] if H.ndim == 2 else np.broadcast_shapes(root.shape[:-2], H.shape[:-2])
        A = np.empty((*batch, m + n, n + room))
        noise, prior = (slice(0, room), slice(room, None)) if noise_first else (slice(n, None), slice(0, n))
        of_z, of_x = A[..., :m, prior], A[..., m:, prior]
        np.matmul(H, root, out=of_z)
        of_x[...] = root
        measured, state = Image(matvec(H, belief.mean), 0.0, of_z), Image(belief.mean, 0.0, of_x)
        return _Lifted(measured, state, A, noise, positive, lambda: (H,), lambda *points: ())

    return lift


def _set_noise(name: str, room: Array, noise: Array) -> None:
    """Write noise into its columns of a pre-array; an error names the noise, not the array."""
    if noise.shape[-2] != room.shape[-2]:
        raise ValueError(f"{name}: expected {room.shape[-2]} rows to go with the model, got {noise.shape[-2]}")
    room[...] = noise


def explain(
    before: Gaussian,
    after: Gaussian,
    names: Sequence[str],
    rule: Transform,
    g: Callable[..., Outputs],
    space: Space,
    extra: Sequence[Array] = (),
    z: Array | None = None,
) -> str:
    """Why a run that was finite before a step is not so after it; empty if there is none."""
    if isfinite(np.add.reduce(after.mean, None) + np.add.reduce(after.spread, None)):  # cheap; what overflows is seen below
        return ""
    was = np.isfinite(before.mean).all(-1) & np.isfinite(before.spread).all((-2, -1))
    lost = was & ~(np.isfinite(after.mean).all(-1) & np.isfinite(after.spread).all((-2, -1)))
    if not lost.any():
        return ""
    if z is not None and np.isinf(z).any():
        return "z is infinite"
    points = rule.points(before.mean, before.form.root(before.spread), space, extra)
    for name, y in zip(names, g(*points), strict=False):
        if y is KEEP:
            continue
        bad = ~np.isfinite(y).all(-1) & lost
        if bad.any():
            return f"{name} is not finite at sigma point {int(np.argwhere(bad)[0, 0])}"
    return "the covariance lost positive definiteness" if z is None else "the innovation covariance is not positive definite"
