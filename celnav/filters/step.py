"""The parts that filters are made of: `predict` and `update`, for any rule, form and space.

Functions of a model take points ``(p, ..., N)`` (the point axis leads, so inputs per run broadcast by themselves) and the
`Epoch` at hand; noise that goes through the points follows as further arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import (
    batched,
    check_extra,
    check_hooks,
    check_memory,
    check_model,
    check_rule,
    check_space,
    check_state,
    measurement,
)
from celnav.filters.conditioning import (
    INDEFINITE,
    Model,
    Noise,
    condition,
    evaluate,
    images,
    informed,
    innovation_of,
    noise_columns,
    set_noise,
    settled,
)
from celnav.filters.info import Gain, Hook, Info
from celnav.gaussian.belief import PRECISE, Gaussian
from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array, matvec
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.transform import KEEP, Image, Outputs, Transform

Predict = Callable[[Gaussian, Any], tuple[Gaussian, Info]]
Update = Callable[..., tuple[Gaussian, Info, Any]]


def _prior(belief: Gaussian, rule: Transform) -> tuple[Array, Array]:
    """A root, and what its columns count with: what only Jacobians act on need not be factored."""
    return belief.columns if rule.linear else (belief.root, rule.sign)


@dataclass(frozen=True)
class Motion:
    """The part that `predict` makes: called with ``(belief, epoch)`` it gives the belief after the interval, and `Info`.

    Attributes
    ----------
    f, rule, extra, space: as given. noise: columns of the process noise; see `celnav.filters.conditioning.noise_columns`.
    """

    f: Model
    rule: Transform
    noise: Noise = None
    extra: Sequence[Array] = ()
    space: Space = EUCLIDEAN

    def __call__(self, belief: Gaussian, epoch: Any = None) -> tuple[Gaussian, Info]:
        f, rule, space = self.f, self.rule, self.space
        check_state(belief, space)
        columns = evaluate(self.noise, belief.mean, epoch)
        if isinstance(dt := getattr(epoch, "dt", None), np.ndarray) and columns is self.noise and dt.any() and not dt.all():
            raise ValueError("dt: expected an interval for every run or for none where Q is constant, got 0 for some of them")
        r = 0
        if columns is not None:
            r, belief = columns.shape[-1], batched("Q", columns.shape[:-2], belief)
        root, sign = _prior(belief, rule)

        def g(points: Array, *w: Array) -> Outputs:
            return (images("f", f, points, epoch, w, belief.mean.shape[-1]),)

        (state,), A = rule.transform(g, belief.mean, root, space, (space,), self.extra, r, epoch)
        if columns is not None:
            set_noise("Q", A[..., A.shape[-1] - r :], columns)
        predicted = Gaussian(space.plus(state.center, state.shift), belief.form.marginal(A, sign), belief.form)
        predicted, failure = settled(belief, predicted, ("f",), rule, g, space, self.extra)
        return predicted, Info(slopes=(lambda: (rule.slope(state, root),),), failure=failure)


def predict(
    f: Model,
    rule: Transform,
    Q: Any = None,
    *,
    sqrt_Q: Any = None,
    extra: Sequence[Array] = (),
    space: Space = EUCLIDEAN,
) -> Motion:
    """The part that moves a belief through the dynamics ``x' = f(x, epoch) + w``, ``w ~ N(0, Q)``.

    Parameters
    ----------
    f: model, ``(points (p, ..., N), epoch, *noise points (p, ..., k)) -> (p, ..., N)``. The point axis leads; ``epoch.dt`` is the
        interval, ``epoch.u`` the input.
    rule: any rule (`celnav.gaussian.transform.Transform`), of dimension n plus that of ``extra``.
    Q, sqrt_Q: process noise as a covariance ``(..., n, n)`` or as columns ``(..., n, r)``, or a function ``(mean, epoch)`` of
        either. A motion without noise has columns ``(n, 0)``.
    extra: roots ``(k, k)`` of noises that go *through* the points (augmentation): ``f(x, epoch, *noise)``.
    space: the state's space.

    Returns
    -------
    ``(belief, epoch) -> (belief, info)``; `celnav.filters.smoother.smooth` takes the same part.

    Raises
    ------
    ValueError: naming the argument that cannot be; at the step, if shapes do not go together.
    """
    check_rule(rule)
    check_extra(extra)
    check_model("f", f, noises=len(extra))
    check_space("space", space)
    noise = noise_columns(Q, sqrt_Q, "Q")
    if noise is None and not len(extra):
        raise ValueError("Q: expected process noise, Q, sqrt_Q or extra; if there is none, sqrt_Q=np.zeros((n, 0))")
    return Motion(f, rule, noise, extra, space)


@dataclass(frozen=True)
class Conditioning:
    """The part that `update` makes: called with ``(belief, z, epoch=None, memory=None)`` it gives the belief given z, `Info` and
    the memory of its hooks.

    Attributes
    ----------
    step: what does it. space, measurement_space: as given.
    """

    step: Update
    space: Space
    measurement_space: Space

    def __call__(self, belief: Gaussian, z: Any, epoch: Any = None, memory: Any = None) -> tuple[Gaussian, Info, Any]:
        return self.step(belief, z, epoch, memory)


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
) -> Conditioning:
    """The part that conditions a belief on a measurement ``z = h(x, epoch) + v``, ``v ~ N(0, R)``.

    Parameters
    ----------
    h: model, ``(points (p, ..., N), epoch, *noise points) -> (p, ..., m)``, or a matrix ``(..., m, n)``: a linear measurement is
        exact and cheap under any rule.
    rule: any rule (`celnav.gaussian.transform.Transform`), of dimension n plus that of ``extra``.
    R, sqrt_R: measurement noise as a covariance ``(..., m, m)`` or as columns ``(..., m, s)``, or a function ``(mean, epoch)``
        of either. A measurement without noise has columns ``(m, 0)``.
    extra: roots of noises that go through the points: ``h(x, epoch, *noise)``; these may be all the noise there is.
    space, measurement_space: the spaces of state and measurement.
    hooks: ``(memory, joint, epoch) -> (memory, joint)``, one after the other: each sees the joint of measurement and state
        (`celnav.filters.info.Joint`) and may replace it. Ready ones are in `celnav.filters.adaptive`, ``robust`` and ``parity``.
    gain: a prescribed gain ``(..., n, m)`` instead of the optimal one, or ``(A, sign, m) -> gain`` (`celnav.filters.info.Gain`).

    Returns
    -------
    ``(belief, z, epoch=None, memory=None) -> (belief, info, memory)``. ``z (..., m)``: nan components are left out.

    Raises
    ------
    ValueError: naming the argument that cannot be; at the step, if shapes do not go together.
    """
    check_rule(rule)
    check_extra(extra)
    check_space("space", space)
    check_space("measurement_space", measurement_space)
    check_hooks(hooks)
    columns = noise_columns(R, sqrt_R, "R")
    if columns is None and not extra:
        raise ValueError("R: expected measurement noise, R, sqrt_R or extra; if there is none, sqrt_R=np.zeros((m, 0))")
    if extra and not callable(h):
        raise ValueError("extra: expected a function h(points, epoch, *noise) with it, got a matrix; R is its noise")
    return conditioning(h, rule, columns, extra, space, measurement_space, hooks, gain)


def conditioning(
    h: Model | ArrayLike,
    rule: Transform,
    columns: Noise,
    extra: Sequence[Array] = (),
    space: Space = EUCLIDEAN,
    measurement_space: Space = EUCLIDEAN,
    hooks: Sequence[Hook] = (),
    gain: Gain | None = None,
) -> Conditioning:
    """What `update` gives, of arguments that were checked: for one who makes it anew at every step. ``columns``: of the noise."""
    plain = not hooks and gain is None
    most = _precise(columns) if isinstance(columns, np.ndarray) else None
    if callable(gain):
        check_model("gain", gain, "(A, sign, m)")
    elif gain is not None:
        gain = finite("gain", gain)
    # Only what is exact must be looked at: the rest cannot be of what is known already.
    noisy = bool(len(extra)) or gain is not None or (isinstance(columns, np.ndarray) and bool(columns.any(-1).all()))
    if callable(h):
        check_model("h", h, noises=len(extra))
        lift = _through_rule(h, rule, extra, space, measurement_space, plain)
    else:
        lift = _through_matrix(h, noise_first=not hooks)

    def part(belief: Gaussian, z: Any, epoch: Any = None, memory: Any = None) -> tuple[Gaussian, Info, Any]:
        check_state(belief, space)
        if memory is not None and hooks:
            check_memory(memory, len(hooks))
        z, belief = measurement(z, belief)
        if np.isnan(z).all():
            return belief, _skipped(belief, z, measurement_space), memory
        if measurement_space.check is not None:
            z = measurement_space.check(z, "z")
        noise = evaluate(columns, belief.mean, epoch)
        s = 0
        if noise is not None:
            s, belief = noise.shape[-1], batched("R", noise.shape[:-2], belief)
        lifted = lift(belief, z.shape[-1], epoch, s)
        A, measured = lifted.A, lifted.measured
        if noise is not None:
            m = measured.columns.shape[-2]
            set_noise("R", A[..., :m, lifted.room], noise)
            A[..., m:, lifted.room] = 0.0
        innovation = innovation_of(z, measured, measurement_space)
        posterior, info, kept = condition(
            belief, lifted.state, A, lifted.sign, innovation,
            noise=(0, s), space=space, slopes=lifted.slopes, hooks=hooks, memory=memory, gain=gain, epoch=epoch,
            known=None if noise is None or len(extra) else (belief.spread, _precise(noise) if most is None else most),
        )  # fmt: skip
        if not noisy:
            exact = np.asarray(info.used) & ~(noise.any(-1) if s else np.zeros(1, bool))
            if exact.any():
                posterior = informed(posterior, info, exact, *lifted.size())
        posterior, failure = settled(belief, posterior, ("h",), rule, lifted.g, space, extra, z)
        if failure == INDEFINITE and not noisy and not (s and noise.any(-1).all()):
            failure += _REDUNDANT
        return posterior, info._replace(failure=failure) if failure else info, kept

    return Conditioning(part, space, measurement_space)


_REDUNDANT = (
    "; a measurement without noise must say what is not known already: of redundant sensors, or of a constraint that is repeated, "
    "leave out all but one (z is nan) or give them a small R"
)


def _precise(noise: Array) -> Array:
    """Deviations of an innovation beyond which the measurement is precise."""
    return np.asarray(PRECISE * np.sqrt(np.vecdot(noise, noise)))


def _skipped(belief: Gaussian, z: Array, space: Space) -> Info:
    """The record of a measurement that is wholly missing."""
    one = np.full(z.shape[-1], np.nan)
    shape = (*np.broadcast_shapes(z.shape[:-1], belief.mean.shape[:-1]), space.minus(one, one).shape[-1])
    return Info(np.full(shape, np.nan), np.zeros(shape), np.zeros(shape, bool))


class _Lifted(NamedTuple):
    """A belief seen through a measurement: both images, the pre-array, its room for noise, and how it came about.

    ``size``: ``() -> (spread, size)`` as `celnav.filters.conditioning.informed` takes them.
    """

    measured: Image
    state: Image
    A: Array
    room: slice
    sign: Array
    slopes: Callable[[], tuple[Array, ...]]
    g: Callable[..., Outputs]
    size: Callable[[], tuple[Array, Array]]


def _through_rule(
    h: Model, rule: Transform, extra: Sequence[Array], space: Space, measurement_space: Space, plain: bool
) -> Callable[..., _Lifted]:
    def lift(belief: Gaussian, m: int, epoch: Any, room: int) -> _Lifted:
        root, sign = _prior(belief, rule) if plain else (belief.root, rule.sign)

        def g(points: Array, *v: Array) -> Outputs:
            return images("h", h, points, epoch, v, m), KEEP

        (measured, state), A = rule.transform(g, belief.mean, root, space, (measurement_space, space), extra, room, epoch)
        noise = slice(A.shape[-1] - room, None)

        def size() -> tuple[Array, Array]:
            n = belief.spread.shape[-1]
            axes = np.moveaxis(belief.std[..., None] * np.eye(n), -1, 0)
            y = images("h", h, space.plus(belief.mean, np.concatenate([0.0 * axes[:1], axes])), epoch, (), m)
            spread = np.abs(measurement_space.minus(y[1:], y[:1])).max(0)
            return spread, np.abs(measured.center) if measured.center.shape == spread.shape else np.zeros(1)

        return _Lifted(measured, state, A, noise, sign, lambda: (rule.slope(measured, root),), g, size)

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

        def size() -> tuple[Array, Array]:
            return (np.abs(H) @ np.abs(root)).max(-1), np.zeros(1)

        return _Lifted(measured, state, A, noise, positive, lambda: (H,), lambda *points: (), size)

    return lift
