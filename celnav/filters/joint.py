"""The joint of a measurement and a state, and its conditioning: every filter here is made of these
two operations.

An update with a linear measurement ``z = H x + v``, in the letters of the books (``P = L L'``,
``R = V V'``)::

    A = [ H L   V ]                      deviations of z and x, in columns
        [  L    0 ]
    tria(A) = [ S   0  ]                 S S'   = H P H' + R
              [ U   L+ ]                 U S'   = P H'                K = U S^-1
    y  = z - H x                         L+ L+' = P - K S S' K'
    x+ = x + U (S^-1 y) = x + K y        P+     = L+ L+'

[Tronarp2024] also uses QR with sigma points and without a downdate, but factors the residual of the
regression too. Here the joint is factored once, and no residual is formed.

A rule replaces H and the identity by any functions, and returns the columns D of their images. The
noise columns stand to the right::

    A = [ D_z  W_z  V ]   m rows         predict:  m = 0, g = f
        [ D_x  W_x  0 ]   n rows         update:   g = (h, identity)
                                         colored:  g = (h(f) - Phi h, f)
                                         smoother: g = (f, identity), z = the next state

The mean of an image is its center c plus a shift s: ``y = z - c - s``. A column of negative weight
has sign -1: the covariance is ``A diag(sign) A'``.

Four arguments determine the result: a rule (how a function becomes columns), a form (how a
covariance is stored), a space (what a difference is) and hooks (what may be changed before
conditioning).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import repeat
from typing import Any, Final, NamedTuple

import numpy as np

from celnav.filters.mixing import POINTS, WATCH, check_apart, unknown
from celnav.filters.model import (
    Linear,
    Motion,
    Noise,
    Sensor,
    as_floats,
    check_return,
    matrices_of,
)
from celnav.filters.records import Info
from celnav.gaussian.checks import broadcast_batches, describe, instance, numbers
from celnav.gaussian.linalg import (
    POSITIVE,
    Array,
    Belief,
    Form,
    SquareRoot,
    block,
    is_concretely_true,
    matvec,
    present,
    side_by_side,
    solve_right,
    whiten,
)
from celnav.gaussian.rules import Image, Taylor
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.tape.numbers import each_row, in_model, known_alike
from celnav.tape.tape import cannot_compile

KEEP: Final = object()
"""Marks the state itself among the outputs of a function: its columns are then exact, on any space.
"""


class Joint(NamedTuple):
    """The joint of a measurement (m rows) and a state (n rows), which a hook gets and may replace.

    innovation: ``(..., m)``, measurement minus prediction; nan where nothing was measured, or where
        a hook leaves the component out. None if there is nothing to condition on.
    measurement, state: their images, with columns ``(..., m, q)`` and ``(..., n, q)`` from the
        prior.
    sign: ``(q,)``, -1 where a weight is negative; ``(1,)`` may stand for +1 in all columns.
    process_noise: its columns ``(..., m, r)`` in the measurement, 0 for zeros, and ``(..., n, r)``
        in the state; None without.
    measurement_noise: its columns ``(..., m, s)``; None without.
    prior_factor: the belief's root or covariance, if the state is the unchanged state of the
        belief, without process noise; else None.
    noise_first: whether the measurement noise stands first among the `columns`; ``sign`` is then
        ``(1,)``, +1.
    """

    innovation: Any
    measurement: Any
    state: Image
    sign: Array
    process_noise: tuple[Any, Any] | None = None
    measurement_noise: Array | None = None
    prior_factor: Array | None = None
    noise_first: bool = False

    def columns(self) -> tuple[Array, Array]:
        """The pre-array ``(..., m + n, q + r + s)``, drawn above, and the signs of its columns.

        In a QR, small columns keep their digits after large columns, so the noises stand last. The
        exception is the square-root form with a linear measurement: the measurement noise stands
        first, because each of its columns has one row. The reflections are then short, and a large
        noise keeps its digits.
        """
        measurement, W, V = self.measurement, self.process_noise, self.measurement_noise
        x_row: list[Any] = [self.state.columns]
        z_row: list[Any] = [] if measurement is None else [measurement.columns]
        if W is not None:
            z_row.append(W[0])
            x_row.append(W[1])
        if V is not None:
            at = 0 if self.noise_first else len(z_row)
            z_row.insert(at, V)
            x_row.insert(at, 0)
        A = block([x_row] if measurement is None else [z_row, x_row])
        sign = self.sign
        return A, sign if len(sign) == 1 else _padded(sign, A.shape[-1] - len(sign))

    def covariances(self) -> tuple[Array, Array]:
        """Covariance of the innovation without measurement noise ``(..., m, m)``, and cross
        covariance of state and innovation ``(..., n, m)``.
        """
        A, sign = self._replace(measurement_noise=None).columns()
        m = self.measurement.columns.shape[-2]
        # (..., m + n, m): the covariance of [z; x] with z.
        cov = A @ _signed(A[..., :m, :], sign).mT
        return cov[..., :m, :], cov[..., m:, :]

    def variances(self) -> tuple[Array, Array]:
        """Variances ``(..., m)`` of the innovation without measurement noise, and of the
        measurement noise.
        """
        A, sign = self._replace(measurement_noise=None).columns()
        # The rows of the measurement, (..., m, q); process noise may reach it as well.
        D = A[..., : self.measurement.columns.shape[-2], :]
        return np.vecdot(_signed(D, sign), D), self.noise_variances()

    def noise_variances(self) -> Array:
        """Variances ``(..., m)`` of the measurement noise."""
        V = self.measurement_noise
        return np.zeros(self.measurement.columns.shape[-2]) if V is None else np.vecdot(V, V)

    def leaving_out(self, mask: Array) -> Joint:
        """The joint without the measured components where ``mask (..., m)`` is True."""
        return self._replace(innovation=np.where(mask, np.nan, self.innovation))

    def inflated(self, factor: Array) -> Joint:
        """The joint with the standard deviations of the measurement noise multiplied by
        ``factor (..., m)``.
        """
        V = self.measurement_noise
        return self if V is None else self._replace(measurement_noise=factor[..., None] * V)


Hook = Callable[[Any, Joint, Any], tuple[Any, Joint]]
"""``(memory, joint, epoch) -> (memory, joint)``; the memory is None at the start."""
Gain = Array | Callable[[Array, Array, int], Array]
"""A prescribed gain ``(..., n, m)``, or a function of the pre-array ``A``, its ``sign`` and ``m``
that returns it.
"""


def _padded(sign: Array, count: int) -> Array:
    """The signs with +1 for ``count`` more columns of noise."""
    return np.append(sign, np.ones(count))


def _signed(A: Array, sign: Array) -> Array:
    """Columns times their signs."""
    return A if len(sign) == 1 else A * sign


# -- pushing a belief through models ---------------------------------------------------------------
def joint(
    rule: Any,
    belief: Belief,
    outputs: Sequence[Any] | Callable[..., tuple[Any, ...]],
    epoch: Any = None,
    *,
    space: Space = EUCLIDEAN,
    spaces: Sequence[Space] | None = None,
    z: Array | None = None,
    process_noise: Any = None,
    measurement_noise: Noise = None,
    augment: Sequence[Array] = (),
) -> Joint:
    """Push a belief through models, and append the noise columns to their images.

    rule: `Rule` or `Taylor`, or a function of the dimension.
    outputs: the measurement (if any) and the state, each a `Motion`, a `Sensor`, `KEEP` (the state
        itself), or ``(value, matrix)`` if all outputs are linear; or a function
        ``(points, epoch, *noise points)`` that returns both. If one output is not linear, all are
        evaluated at the points.
    space: the space of the belief. spaces: the spaces of a function's outputs; None: vectors.
    z: measurement ``(..., m)``; None: there is no measurement among the outputs.
    process_noise: columns ``(..., n, r)`` of the state rows, a function ``(mean, epoch)`` that
        returns them, or a pair: the columns of the measurement rows and of the state rows.
    measurement_noise: columns ``(..., m, s)``, or a function ``(mean, epoch)`` of them. augment:
        roots of the noises that go through the points.
    """
    rule = rule_for(rule, belief, augment)
    W, V = process_noise, measurement_noise
    if callable(W):
        W = in_model(W, belief.mean, epoch)
    if callable(V):
        V = in_model(V, belief.mean, epoch)
    # Columns beside the measurement, and beside the state.
    W = W if W is None or type(W) is tuple else (0, W)
    W_x = None if W is None else W[1]
    names = ("Q", "R", *["augment"] * len(augment))
    for name, columns in zip(names, (W_x, V, *augment), strict=True):
        if columns is not None and columns.ndim > 2:
            # The noise may have axes of runs that the belief does not have, and a model may need
            # them.
            belief = broadcast_to_runs(name, columns.shape[:-2], belief)
    m = None if z is None else z.shape[-1]
    if not callable(outputs) and all(map(by_matrix, outputs, repeat(rule))):
        images, sign = _linear_images(outputs, rule, belief, epoch, space, augment), POSITIVE
    else:
        images = _point_images(outputs, rule, belief, epoch, space, spaces, augment, m)
        sign = rule.sign
    measurement, state = images[0], images[-1]
    first: Any = None if callable(outputs) else outputs[0]
    if V is not None and not V.ndim:  # a standard deviation alone
        V = V * np.eye(measurement.columns.shape[-2])
    owner = "Q" if isinstance(first, Motion) else "R"
    for name, columns, image in (("Q", W_x, state), (owner, V, measurement)):
        rows = image.columns.shape[-2]
        if columns is not None and columns.shape[-2] != rows:
            raise ValueError(
                f"{name}: expected {rows} rows to go with the model, got {columns.shape[-2]}"
            )
    # The state is the state of the belief: no function was applied, and no noise added.
    prior_factor = belief[1] if state.center is belief.mean and W is None else None
    if z is None:
        return Joint(None, None, state, sign, W, None, prior_factor)
    z_space = getattr(first, "space", EUCLIDEAN) if spaces is None else spaces[0]
    innovation = _innovation(z, measurement, z_space, belief)
    by_qr = isinstance(belief, SquareRoot) and sign is POSITIVE
    noise_first = by_qr and isinstance(first, Sensor) and first.linear
    return Joint(innovation, measurement, state, sign, W, V, prior_factor, noise_first)


def _innovation(z: Array, measurement: Image, space: Space, belief: Belief) -> Array:
    """Measurement minus prediction ``(..., m)``."""
    center, shift = measurement.center, measurement.shift
    m = center.shape[-1]
    if z.shape[-1] != m:
        raise ValueError(f"z: expected {m} components to go with h, got {z.shape[-1]}")
    if z.ndim > 1 and z.shape[:-1] != belief.mean.shape[:-1]:
        broadcast_batches("z", z.shape[:-1], belief.mean.shape[:-1], "the belief")
    if space is EUCLIDEAN:
        return np.asanyarray(z - center - shift)
    if not shift.dtype.hasobject and not shift.any():  # the shift is 0 under Taylor's rule
        return np.asanyarray(space.minus(z, center))
    # z - (center + shift), as a difference from the center: the mean of an angle may be past the
    # wrap at +-pi.
    return np.asanyarray(space.minus(space.plus(center, space.minus(z, center) - shift), center))


def rule_for(rule: Any, belief: Belief, augment: Sequence[Array] = ()) -> Any:
    """The rule for a belief and for the noises through its points; a function of the dimension is
    called.
    """
    if hasattr(rule, "image"):
        return rule
    n: int = belief[1].shape[-1]
    return rule(n + sum([E.shape[-1] for E in augment]) if augment else n)


def noise_at(noise: Any, mean: Array, epoch: Any) -> Any:
    """Columns of a noise at a mean and an epoch; the noise is constant or a function of both."""
    return in_model(noise, mean, epoch) if callable(noise) else noise


# -- by points -------------------------------------------------------------------------------------
def _point_images(
    outputs: Any,
    rule: Any,
    belief: Belief,
    epoch: Any,
    space: Space,
    spaces: Sequence[Space] | None,
    augment: Sequence[Array],
    m: int | None,
) -> list[Image]:
    """Images of the outputs from their values at the points of a rule."""
    # Points lie along the columns of a root, in either form.
    root, n = belief.sqrt_cov, belief[1].shape[-1]
    x, *noise = rule.points(belief.mean, root, space, augment)
    values = outputs(x, epoch, *noise) if callable(outputs) else outputs
    images = []
    for i, y in enumerate(values):
        if y is KEEP:
            columns = rule.state_columns(root, augment)
            images.append(Image(belief.mean, np.zeros(n), columns, partial(np.eye, n)))
        elif isinstance(y, np.ndarray):
            images.append(rule.image(y, EUCLIDEAN if spaces is None else spaces[i], root))
        else:
            images.append(rule.image(evaluate(y, x, epoch, noise, m), y.space, root))
    return images


def evaluate(
    model: Motion | Sensor, x: Array, epoch: Any, noise: Sequence[Array] = (), m: int | None = None
) -> Array:
    """Values ``(p, ..., m)`` of a model at points ``x (p, ..., N)``, guarded.

    ``m``: number of measured components. At its first call a model is checked: it must treat each
        point and each run separately. A model may change its argument, so a caller that needs the
        points again passes a copy.
    """
    function: Any = getattr(model, model.name)
    if not callable(function):
        return matvec(function, x)
    if unknown(function, x):
        copies = [array.copy(order="K") for array in (x, *noise)]
        # The model may return its internal buffer, which the check would overwrite.
        y = _values(model, x, epoch, noise, m).copy(order="K")
        check_apart(model.name, function, copies, epoch, y)
    else:
        y = _values(model, x, epoch, noise, m)
    if (look := WATCH.get()) is not None:
        other = look(model.name, y)
        y = y if other is None else other
    return np.asanyarray(y)


def _values(
    model: Motion | Sensor, x: Array, epoch: Any, noise: Sequence[Array], m: int | None
) -> Array:
    """Values of a model as floats in the expected shape; an error gets a note with the model's
    arguments.
    """
    name = model.name
    function: Any = getattr(model, name)
    try:
        if x.dtype.hasobject:
            y: Any = in_model(
                partial(each_row, lambda x, *noise: function(x, epoch, *noise)), x, *noise
            )
        else:
            y = function(x, epoch, *noise)
        if type(y) is not np.ndarray or y.dtype != np.float64:
            y = as_floats(name, y, x)
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        checked = x.dtype.hasobject or ": expected" in str(error)  # by us, or while recording
        if not checked and _is_of_interval(model, x, epoch, noise):
            raise ValueError(
                f"{name}: expected a function (points, epoch), got {describe(function)} of points "
                f"and their interval; pass lambda x, epoch: {name}(x, epoch.dt)"
            ) from error
        u_text = "an input" if getattr(epoch, "u", None) is not None else "None"
        error.add_note(
            f"{name} is called with points {x.shape} and an Epoch: epoch.dt is its interval, "
            f"epoch.u ({u_text}) its input"
        )
        error.add_note(POINTS)
        raise
    if isinstance(model, Motion):
        size: int | None = x.shape[-1]
    else:
        size = m if model.space is EUCLIDEAN and model.m in (None, m) else None
    if not y.ndim or y.shape[:-1] != x.shape[:-1] or size not in (None, y.shape[-1]):
        expected = ", ".join(map(str, (*x.shape[:-1], "m" if size is None else size)))
        raise ValueError(f"{name} returned shape {y.shape}, expected ({expected}); {POINTS}")
    values: Array = y
    return values


def _is_of_interval(model: Motion | Sensor, x: Array, epoch: Any, noise: Sequence[Array]) -> bool:
    """Whether a model that failed for an epoch works for its interval, as ``f(x, dt)`` does."""
    try:
        as_floats(model.name, getattr(model, model.name)(x, epoch.dt, *noise), x)
    except Exception:
        return False
    return True


# -- by matrices -----------------------------------------------------------------------------------
def by_matrix(output: Any, rule: Any) -> bool:
    """Whether a matrix describes an output: its model is linear, or the rule is Taylor's and the
    model has a ``jacobian``. `KEEP` and ``(value, matrix)`` are linear.
    """
    if output is KEEP or type(output) is tuple:
        return True
    return output.linear or (isinstance(rule, Taylor) and output.jacobian is not None)


def linear(
    model: Motion | Sensor, rule: Any, mean: Array, epoch: Any, space: Space = EUCLIDEAN
) -> tuple[Array, Array]:
    """Value ``(..., k)`` at the mean and matrix ``(..., k, n)`` of a model for which `by_matrix` is
    true; ``space``: of the state.
    """
    function: Any = getattr(model, model.name)
    if model.linear:
        matrix = function.at(epoch, mean.shape[-1]) if isinstance(function, Linear) else function
        if model.name == "f" and matrix.shape[-2] != mean.shape[-1]:
            n = mean.shape[-1]
            raise ValueError(f"matrix: expected shape (..., {n}, {n}), got {matrix.shape}")
        value = matvec(matrix, mean)
        if (look := WATCH.get()) is not None:
            look(model.name, value[None])
        return value, matrix
    center = mean if rule.about is None else np.broadcast_to(rule.about, mean.shape)
    # One point (1, ..., N), and noise points (1, ..., k) at their mean.
    zero_noise = [np.zeros((1, *center.shape[:-1], E.shape[-2])) for E in model.augment]
    value = evaluate(model, center[None].copy(), epoch, zero_noise)[0]
    # f(mean) = f(center) + J (mean - center), where center is the point of expansion.
    J = matrices_of("jacobian", model.jacobian, center, epoch)
    if J.ndim < 2 or (model.space is EUCLIDEAN and J.shape[-2] != value.shape[-1]):
        raise ValueError(
            f"jacobian: expected shape (..., {value.shape[-1]}, n) to go with {model.name}, "
            f"got {J.shape}"
        )
    if rule.about is None:
        return value, J
    offset = space.minus(mean, center)
    return model.space.plus(value, matvec(J[..., : offset.shape[-1]], offset)), J


def _linear_images(
    outputs: Sequence[Any],
    rule: Any,
    belief: Belief,
    epoch: Any,
    space: Space,
    augment: Sequence[Array],
) -> list[Image]:
    """Images of linear functions from their values at the mean and their matrices."""
    root, mean, n = belief.sqrt_cov, belief.mean, belief[1].shape[-1]
    images = []
    for output in outputs:
        if output is KEEP:
            # A function with noise arguments is linear only under Taylor's rule; its noises do not
            # enter here.
            columns = rule.state_columns(root, augment) if augment else root
            images.append(Image(mean, np.zeros(n), columns, partial(np.eye, n)))
        else:
            value, J = output if type(output) is tuple else linear(output, rule, mean, epoch, space)
            images.append(_linear_image(value, J, root, augment))
    return images


def _linear_image(value: Array, J: Array, root: Array, augment: Sequence[Array]) -> Image:
    """The image of a linear function from its value at the mean and its matrix
    ``(..., k, n + noises)``.
    """
    n, k = root.shape[-1], J.shape[-2]
    # J = [J_x, J_noise1, ...]: the columns of J belong to the state, then to each noise.
    ends = np.cumsum([E.shape[-2] for E in (root, *augment)]) if augment else (n,)
    if J.shape[-1] != ends[-1]:
        raise ValueError(f"jacobian: expected shape (..., {k}, {ends[-1]}), got {J.shape}")
    columns = J[..., :n] @ root
    if augment:
        noise = (
            J[..., end - E.shape[-2] : end] @ E for end, E in zip(ends[1:], augment, strict=True)
        )
        columns = side_by_side([columns, *noise])
    return Image(value, np.zeros(k), columns, partial(np.asanyarray, J[..., :n]))


# -- axes of runs ----------------------------------------------------------------------------------
def broadcast_to_runs(name: str, batch: tuple[int, ...], belief: Belief) -> Belief:
    """The belief with its mean broadcast to the runs of an argument; ValueError names an argument
    that does not broadcast with it.
    """
    runs = belief.mean.shape[:-1]
    if not batch or batch == runs:
        return belief
    if belief.mean.dtype.hasobject:
        raise cannot_compile(
            f"{name}: a function that gives a matrix for each run is not recorded; give the "
            "matrices "
            "(runs, n, n) themselves, or put them into u"
        )
    together = broadcast_batches(name, batch, runs, "the belief")
    if together == runs:
        return belief
    return belief._replace(mean=np.broadcast_to(belief.mean, (*together, belief.mean.shape[-1])))


def broadcast_belief(form: Form, mean: Array, factor: Array) -> Belief:
    """The belief with mean and covariance broadcast to their joint axes of runs."""
    batch = broadcast_batches("Q, R", factor.shape[:-2], mean.shape[:-1], "the belief")
    return form(
        np.broadcast_to(mean, (*batch, mean.shape[-1])),
        np.broadcast_to(factor, (*batch, *factor.shape[-2:])),
    )


def _belief(form: Form, mean: Array, factor: Array) -> Belief:
    """The belief; a covariance that all runs share remains a single ``(n, n)``."""
    if factor.ndim == 2 or factor.shape[:-2] == mean.shape[:-1]:
        return form(mean, factor)
    return broadcast_belief(form, mean, factor)


def shared_mask(used: Array) -> Array:
    """A mask ``(..., m)``, reduced to ``(m,)`` if it is the same in all runs, so that shared
    matrices need no axis of runs.
    """
    # Reduced over all axes of runs, (m,): the two differ if only some runs have a gap.
    every: Array = np.logical_and.reduce(used, tuple(range(used.ndim - 1)))
    return every if used.ndim == 1 or every.all() or (used == every).all() else used


# -- conditioning ----------------------------------------------------------------------------------
def marginal(form: Form, joint: Joint, space: Space) -> Belief:
    """The belief about the state without conditioning: a prediction."""
    mean = space.plus(joint.state.center, joint.state.shift)
    return _belief(form, mean, form.marginal(*joint.columns()))


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
    """The belief about the state given the innovation, an `Info`, and the hooks' memory.

    `Info.innovation` is the innovation before the hooks; the other fields are from after the hooks.

    Components that are nan are marginalized exactly, in each run separately. With a prescribed
    ``gain`` the covariance is correct for this gain, optimal or not.
    """
    measured = joint.innovation
    if hooks:
        joint, memory = _adapted(joint, hooks, memory, epoch)
    y, m = joint.innovation, joint.innovation.shape[-1]
    used = present(y)
    complete = is_concretely_true(used.all())
    A, sign = joint.columns()
    if not complete:
        mask = shared_mask(used)
        # An unmeasured row gets no prior columns, a noise of variance 1 and a zero innovation, so
        # that it has no effect.
        A = block(
            [[A[..., :m, :] * mask[..., None], np.eye(m) * ~mask[..., None]], [A[..., m:, :], 0]]
        )
        sign = sign if len(sign) == 1 else _padded(sign, m)
        y = np.where(mask, y, 0.0)
    K: Any = gain
    if gain is not None:
        K = gain(A, sign, m) if callable(gain) else gain
        K = numbers("gain", K, (..., A.shape[-2] - m, m))
        K = K if complete else K * mask[..., None, :]
    # S (..., m, m) with S S' the innovation covariance, U = K S (..., n, m), and the root or
    # covariance of the state given z.
    S, U, factor = form.condition(
        A, sign, m, K, prior_factor=joint.prior_factor, noise=joint.measurement_noise
    )
    whitened = whiten(S, y)  # S^-1 y
    # x+ = center + shift + K y, with K y = U S^-1 y.
    step = joint.state.shift + (matvec(U, whitened) if K is None else matvec(K, y))
    if space.transport is not None:
        factor = form.transported(space.transport(step), factor)

    def gain_used() -> Array:
        return solve_right(S, U) if K is None else K

    # R after the hooks, as used in the update.
    R = joint.noise_variances() if hooks else None
    info = Info(measured, whitened, used, S, gain_used, joint.measurement.jacobian, R=R)
    return _belief(form, space.plus(joint.state.center, step), factor), info, memory


def _copied(image: Image) -> Image:
    """A copy of an image, whose arrays a hook may overwrite."""
    center, shift, columns, jacobian = image
    shift = shift.copy() if isinstance(shift, np.ndarray) else shift
    return Image(center.copy(), shift, columns.copy(), jacobian)


def _adapted(joint: Joint, hooks: Sequence[Hook], memory: Any, epoch: Any) -> tuple[Joint, Any]:
    """The joint after the hooks, and their memories. Hooks may replace or overwrite its arrays."""
    columns, memories = joint.state.columns, []
    measurement, state = _copied(joint.measurement), _copied(joint.state)
    W, V = joint.process_noise, joint.measurement_noise
    original = joint = joint._replace(
        innovation=joint.innovation.copy(),
        measurement=measurement,
        state=state,
        process_noise=W and (W[0] if type(W[0]) is int else W[0].copy(), W[1].copy()),
        measurement_noise=None if V is None else V.copy(),
        noise_first=False,
    )
    for hook, remembered in zip(
        hooks, (None,) * len(hooks) if memory is None else memory, strict=True
    ):
        remembered, joint = check_return("hooks", hook(remembered, joint, epoch), "memory, joint")
        instance("hooks", joint, Joint, "hooks that give back (memory, joint)")
        memories.append(remembered)
        components, rows = joint.innovation.shape[-1], joint.measurement.columns.shape[-2]
        if components != rows:
            raise ValueError(
                f"hooks: expected an innovation of {rows} components, one for each row of the "
                f"measurement's columns, got {components}"
            )
    # The shortcut with the prior's covariance is valid only if no hook changed the columns.
    same = joint.sign is original.sign and joint.process_noise is original.process_noise
    if not same or not known_alike(joint.state.columns, columns):
        joint = joint._replace(prior_factor=None)
    return joint, tuple(memories)
