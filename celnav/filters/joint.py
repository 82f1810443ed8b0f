"""The one joint and the one conditioning, of which every filter here is made.

Push a belief through a function, write the deviation columns down, set the noise columns beside them, condition the last n rows on
the first m::

    A = [ D_z  W_z  V ]   m rows       predict: m = 0, g = f          update:   g = (h, identity)
        [ D_x  W_x  0 ]   n rows       colored: g = (h(f) - Phi h, f)  smoother: g = (f, identity), measured = the next state

Four things meet here, none of which knows the others: a rule (how g becomes columns), a form (what a covariance is kept as), a
space (what a difference is) and hooks (what may be changed before conditioning).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from celnav.filters.model import given_back
from celnav.filters.records import Gain, Hook, Info, Joint
from celnav.gaussian.belief import Belief, Covariance, SquareRoot
from celnav.gaussian.checks import instance, numbers
from celnav.gaussian.linalg import EPS, Array, matvec, solve_upper_transposed, whiten
from celnav.gaussian.rules import KEEP, Image
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.taylor import POSITIVE, kept_image, linear_image

Form = type[SquareRoot] | type[Covariance]


def joint(
    rule: Any,
    belief: Belief,
    g: Callable[..., tuple[Any, ...]] | Sequence[Any],
    spaces: Sequence[Space],
    *,
    z: Array | None = None,
    process_noise: Any = None,
    measurement_noise: Array | None = None,
    augment: Sequence[Array] = (),
    noise_first: bool = False,
) -> Joint:
    """Push a belief through ``g``, and set the noise beside it.

    Parameters
    ----------
    rule: `Rule` or `Taylor`.
    g: ``(points, *noise points) -> outputs``, the measurement (if any) and the state; or these outputs, linear each, as ``(value,
        matrix)``. An output may be `KEEP`, the state itself.
    spaces: of the belief, and of each output.
    z: ``(..., m)``, what was measured; None: there is no measurement among the outputs.
    process_noise: columns ``(..., n, r)`` beside the state, or a pair of those beside the measurement and beside the state.
    measurement_noise: columns ``(..., m, s)``. augment: roots of the noises that ``g`` takes. noise_first: see `Joint`.
    """
    mean, root = belief.mean, belief.sqrt_cov
    if callable(g):
        images, sign = rule.images(g, mean, root, spaces[0], spaces[1:], augment), rule.sign
    else:
        images = [kept_image(mean, root, augment) if y is KEEP else linear_image(y[0], y[1], root, augment) for y in g]
        sign = POSITIVE
    if process_noise is not None and type(process_noise) is not tuple:
        process_noise = (0, process_noise)
    state = images[-1]
    if process_noise is not None:
        _check_noise("Q", process_noise[0 if type(process_noise[1]) is int else 1], state, mean)
    if measurement_noise is not None:
        _check_noise("R", measurement_noise, images[0], mean)
    known = belief[1] if state.center is mean and process_noise is None else None
    if z is None:
        return Joint(None, None, state, sign, process_noise, None, known)
    m = images[0].columns.shape[-2]
    if spaces[1] is EUCLIDEAN and z.shape[-1] != m:
        raise ValueError(f"z: expected {m} components to go with h, got {z.shape[-1]}")
    if z.ndim > 1 and z.shape[:-1] != mean.shape[:-1]:
        _joint_batch("z", z.shape[:-1], mean.shape[:-1])
    innovation = innovation_of(z, images[0], spaces[1])
    return Joint(innovation, images[0], state, sign, process_noise, measurement_noise, known, noise_first)


def _joint_batch(name: str, batch: tuple[int, ...], runs: tuple[int, ...]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(batch, runs)
    except ValueError:
        raise ValueError(f"{name}: batch axes {batch} do not go with those of the belief, {runs}") from None


def over_runs(name: str, batch: tuple[int, ...], belief: Belief) -> Belief:
    """The belief, with a mean for each of the runs that only an argument has; ValueError names one that does not go with it."""
    runs = belief.mean.shape[:-1]
    if not batch or batch == runs:
        return belief
    together = _joint_batch(name, batch, runs)
    return belief if together == runs else belief._replace(mean=np.broadcast_to(belief.mean, (*together, belief.mean.shape[-1])))


def _whole(form: Form, mean: Array, spread: Array) -> Belief:
    """The belief; where only its covariance differs from run to run, with a mean for each run, too."""
    if spread.ndim > 2 and spread.shape[:-2] != mean.shape[:-1]:
        batch = _joint_batch("Q, R", spread.shape[:-2], mean.shape[:-1])
        mean = np.broadcast_to(mean, (*batch, mean.shape[-1]))
        spread = np.broadcast_to(spread, (*batch, *spread.shape[-2:]))
    return form(mean, spread)


def _check_noise(name: str, noise: Array, image: Image, mean: Array) -> None:
    if noise.shape[-2] != image.columns.shape[-2]:
        raise ValueError(f"{name}: expected {image.columns.shape[-2]} rows to go with the model, got {noise.shape[-2]}")
    if noise.ndim > 2 and noise.shape[:-2] != mean.shape[:-1]:
        _joint_batch(name, noise.shape[:-2], mean.shape[:-1])


def innovation_of(z: Array, predicted: Image, space: Space) -> Array:
    """Measurement minus its prediction, ``(..., m)``; on a space that wraps the mean may lie across the seam from its center."""
    difference = space.minus(z, predicted.center)
    if space is EUCLIDEAN or not isinstance(predicted.shift, np.ndarray):
        return np.asarray(difference - predicted.shift)
    return space.minus(space.plus(predicted.center, difference - predicted.shift), predicted.center)


def marginal(form: Form, joint: Joint, space: Space) -> Belief:
    """The belief about the state, with nothing to condition on: a prediction."""
    state = joint.state
    return _whole(form, space.plus(state.center, state.shift), form.marginal(joint.columns(), joint.sign))


def condition(
    form: Form,
    joint: Joint,
    space: Space,
    *,
    hooks: Sequence[Hook] = (),
    memory: Any = None,
    epoch: Any = None,
    gain: Gain | None = None,
) -> tuple[Belief, Info, Any]:
    """The belief about the state given the innovation, what was done, and the hooks' memory.

    Components that are nan are marginalized exactly, in each run by itself. With a prescribed ``gain`` the covariance is that of a
    filter which uses it, whatever it is.
    """
    given = joint.innovation
    if hooks:
        joint, memory = _adapted(joint, hooks, memory, epoch)
    innovation, measured, state = joint.innovation, joint.measurement, joint.state
    assert innovation is not None
    assert measured is not None
    used, m = innovation == innovation, innovation.shape[-1]
    A = joint.columns()
    if not used.all():
        A, innovation = _left_out(A, innovation, used)
    K: Any = gain
    if gain is not None:
        K = _checked_gain(gain(A, joint.sign, m) if callable(gain) else gain, A.shape[-2] - m, m) * used[..., None, :]
    S, U, spread = form.condition(A, joint.sign, m, K, joint.known, joint.measurement_noise)
    whitened = whiten(S, innovation)
    step = state.shift + (matvec(U, whitened) if K is None else matvec(K, innovation))
    if space.transport is not None:
        spread = form.transported(space.transport(step), spread)

    def optimal() -> Array:
        return solve_upper_transposed(S, U.mT).mT if K is None else K

    info = Info(given, whitened, used, S, optimal, measured.jacobian)
    return _whole(form, space.plus(state.center, step), spread), info, memory


def _adapted(joint: Joint, hooks: Sequence[Hook], memory: Any, epoch: Any) -> tuple[Joint, Any]:
    """The joint after its hooks, which may replace its arrays or write into them, and their memories."""
    assert joint.measurement is not None
    columns, memories = joint.state.columns, []
    measurement, state = (image._replace(columns=image.columns.copy()) for image in (joint.measurement, joint.state))
    W: Any = joint.process_noise
    V = joint.measurement_noise
    given = joint = joint._replace(
        innovation=np.array(joint.innovation),
        measurement=measurement,
        state=state,
        process_noise=None if W is None else (_copied(W[0]), _copied(W[1])),
        measurement_noise=None if V is None else V.copy(),
        noise_first=False,
    )
    for hook, remembered in zip(hooks, (None,) * len(hooks) if memory is None else memory, strict=True):
        remembered, joint = given_back("hooks", hook(remembered, joint, epoch), "memory, joint")
        instance("hooks", joint, Joint, "hooks that give back (memory, joint)")
        memories.append(remembered)
    same = joint.sign is given.sign and joint.process_noise is given.process_noise
    if not same or not np.array_equal(joint.state.columns, columns):
        joint = joint._replace(known=None)
    return joint, tuple(memories)


def _copied(part: Any) -> Any:
    return part if type(part) is int else part.copy()


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


def known_already(form: Form, info: Info, exact: Array, deviation: Array, size: Array) -> Array:
    """Runs ``(...)`` in which a measurement without noise is of what was known already: nothing but round-off is left of it.

    Parameters
    ----------
    exact: ``(..., m)`` bool, the components without noise.
    deviation, size: ``(..., m)``, what the measurement varies by over the belief, direction by direction, and how large it is: what
        is left of either after cancellation is round-off.
    """
    assert info.sqrt_S is not None
    assert info.used is not None
    least = 16.0 * (form.rounding() * deviation + EPS * size)
    return np.asarray((exact & info.used & (info.sqrt_S.diagonal(0, -2, -1) <= least)).any(-1))
