"""The one joint and the one conditioning, of which every filter here is made.

Push a belief through models, write the deviation columns down, set the noise columns beside them, condition the last n rows on the
first m::

    A = [ D_z  W_z  V ]   m rows       predict: m = 0, g = f          update:   g = (h, identity)
        [ D_x  W_x  0 ]   n rows       colored: g = (h(f) - Phi h, f)  smoother: g = (f, identity), measured = the next state

Four things meet here, none of which knows the others: a rule (how g becomes columns), a form (what a covariance is kept as), a
space (what a difference is) and hooks (what may be changed before conditioning).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from celnav.filters.mixing import POINTS, WATCH, check_apart, unknown
from celnav.filters.model import (
    Linear,
    Motion,
    Noise,
    Sensor,
    as_floats,
    given_back,
    is_linear,
    matrices_of,
)
from celnav.filters.records import Info
from celnav.gaussian.checks import beside, instance, numbers
from celnav.gaussian.linalg import (
    POSITIVE,
    Array,
    Belief,
    Form,
    block,
    factored,
    matvec,
    side_by_side,
    solve_right,
    surely,
    whiten,
)
from celnav.gaussian.rules import Image, Taylor
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.tape.numbers import each_row, in_model, known_alike, present
from celnav.tape.tape import refused

__all__ = [
    "KEEP", "Gain", "Hook", "Joint", "alike", "at", "by_matrix", "condition", "evaluate", "joint", "linear", "marginal",
    "over_runs", "rule_for", "whole",
]  # fmt: skip

KEEP: Final = object()
"""Stands for "the state itself" among the outputs of a function: its columns are then exact, on any space."""


class Joint(NamedTuple):
    """The joint of a measurement (m rows) and a state (n rows): what a hook sees and may replace.

    innovation: ``(..., m)``, measurement minus prediction; nan where nothing was measured, or a hook leaves it out. None where
        there is nothing to condition on.
    measurement, state: their images, with columns ``(..., m, q)`` and ``(..., n, q)`` from the prior.
    sign: ``(q,)``, -1 where a weight is negative; one 1 may stand for all. Where a measurement is linear in covariance
        form, and neither hook nor gain looks on, the covariance ``(..., n, n)`` of the state: its columns are then unit vectors.
    process_noise: its columns ``(..., m, r)`` in the measurement, 0 for zeros, and ``(..., n, r)`` in the state; None without.
    measurement_noise: its columns ``(..., m, s)``; None without.
    known: the state's own root or covariance, where the state is that of the belief and nothing was added.
    noise_first: whether the measurement noise stands first among the `columns`; no sign may be negative then.
    """

    innovation: Any
    measurement: Any
    state: Image
    sign: Array
    process_noise: tuple[Any, Any] | None = None
    measurement_noise: Array | None = None
    known: Array | None = None
    noise_first: bool = False

    def columns(self) -> Array:
        """The pre-array ``(..., m + n, q + r + s)``, drawn above.

        Small columns after large ones keep their digits in a QR, and noise is what may be small. Only where the state is kept and
        its measurement linear V comes first: most reflections are then short or nothing, which takes half the time.
        """
        D = self.state.columns
        if self.measurement is None:
            W = None if self.process_noise is None else self.process_noise[1]
            if W is None:
                return D
            return np.concatenate((D, W), -1) if D.ndim == W.ndim == 2 else block([[D, W]])
        rows: list[list[Any]] = [[self.measurement.columns], [D]]
        if self.process_noise is not None:
            for row, part in zip(rows, self.process_noise, strict=True):
                row.append(part)
        if self.measurement_noise is not None:
            at = 0 if self.noise_first else len(rows[0])
            rows[0].insert(at, self.measurement_noise)
            rows[1].insert(at, 0)
        return block(rows)

    def covariances(self) -> tuple[Array, Array]:
        """Of the innovation without measurement noise ``(..., m, m)``, and of state and innovation ``(..., n, m)``."""
        D_z, D_x = self.measurement.columns, self.state.columns
        S0, cross = (D_z * self.sign) @ D_z.mT, (D_x * self.sign) @ D_z.mT
        if self.process_noise is not None:
            W_z, W_x = self.process_noise
            if type(W_z) is not int:
                S0 = S0 + W_z @ W_z.mT
                cross = cross + W_x @ W_z.mT
        return S0, cross

    def variances(self) -> tuple[Array, Array]:
        """Variances ``(..., m)`` of the innovation without measurement noise, and of that noise."""
        D = self.measurement.columns
        prior = np.einsum("...ij,...ij,j->...i", D, D, np.broadcast_to(self.sign, D.shape[-1:]))
        if self.process_noise is not None and type(self.process_noise[0]) is not int:
            prior = prior + np.square(self.process_noise[0]).sum(-1)
        V = self.measurement_noise
        return prior, np.zeros(D.shape[-2]) if V is None else np.einsum("...ij,...ij->...i", V, V)

    def leaving_out(self, mask: Array) -> Joint:
        """Without the components of the measurement where ``mask (..., m)`` is True."""
        return self._replace(innovation=np.where(mask, np.nan, self.innovation))

    def inflated(self, factor: Array) -> Joint:
        """With measurement noise of standard deviations ``factor (..., m)`` times as large."""
        V = self.measurement_noise
        return self if V is None else self._replace(measurement_noise=factor[..., None] * V)

    def factored(self) -> Joint:
        """With signs in place of a covariance."""
        if self.sign.ndim < 2 or self.measurement is None:
            return self
        (D_z, sign), (D_x, _) = (
            factored(image.columns, self.sign) for image in (self.measurement, self.state)
        )
        return self._replace(
            measurement=self.measurement._replace(columns=D_z),
            state=self.state._replace(columns=D_x),
            sign=sign,
        )


Hook = Callable[[Any, Joint, Any], tuple[Any, Joint]]
"""``(memory, joint, epoch) -> (memory, joint)``; the memory is None at the start."""
Gain = Array | Callable[[Array, Array, int], Array]
"""A prescribed gain ``(..., n, m)``, or a function of the pre-array ``A``, its ``sign`` and ``m`` that gives it."""


def joint(
    rule: Any, belief: Belief, outputs: Sequence[Any] | Callable[..., tuple[Any, ...]], epoch: Any = None, *,
    space: Space = EUCLIDEAN, spaces: Sequence[Space] | None = None, z: Array | None = None,
    process_noise: Any = None, measurement_noise: Noise = None, augment: Sequence[Array] = (),
) -> Joint:  # fmt: skip
    """Push a belief through models, and set the noise beside what comes out.

    rule: `Rule` or `Taylor`, or a function of the dimension.
    outputs: the measurement (if any) and the state, each a `Motion`, a `Sensor`, `KEEP` (the state itself) or ``(value, matrix)``
        of what is linear, if both are; or a function ``(points, epoch, *noise points)`` of both.
    space: of the belief. spaces: of what a function gives; None: vectors.
    z: ``(..., m)``, what was measured; None: there is no measurement among the outputs.
    process_noise: columns ``(..., n, r)`` beside the state, a function ``(mean, epoch)`` of them, or a pair of those beside the
        measurement and beside the state.
    measurement_noise: columns ``(..., m, s)``, or a function of them. augment: roots of the noises that go through the points.
    """
    rule = rule_for(rule, belief, augment)
    W: Any = at(process_noise, belief.mean, epoch)
    V = at(measurement_noise, belief.mean, epoch)
    W = W if W is None or type(W) is tuple else (0, W)
    if W is not None and W[1].ndim > 2:
        belief = over_runs(
            "Q", W[1].shape[:-2], belief
        )  # a model may need the axes that only the noise has
    if V is not None and V.ndim > 2:
        belief = over_runs("R", V.shape[:-2], belief)
    for E in augment:
        belief = over_runs("augment", E.shape[:-2], belief)
    mean = belief.mean

    noise_first, images = False, []
    models: Sequence[Any] = () if callable(outputs) else outputs
    first: Any = models[0] if models else None
    if models and all(one is KEEP or type(one) is tuple or by_matrix(one, rule) for one in models):
        found: list[Any] = [
            (mean, None)
            if one is KEEP
            else one
            if type(one) is tuple
            else linear(one, rule, mean, epoch, space)
            for one in models
        ]
        # A prediction factors the covariance even so: whether it is definite is to be noticed.
        root, sign = (
            belief.factor() if found[-1][1] is None and not augment else (belief.sqrt_cov, POSITIVE)
        )
        for value, matrix in found:
            images.append(_linear_image(value, matrix, root, sign, augment))
        noise_first = (
            sign.ndim == 1
            and isinstance(first, Sensor)
            and (not callable(first.h) or isinstance(first.h, Linear))
        )
    else:
        root, sign = belief.sqrt_cov, rule.sign
        x, *noise = rule.points(mean, root, space, augment)
        values = outputs(x, epoch, *noise) if callable(outputs) else outputs
        for i, y in enumerate(values):
            if y is KEEP:
                images.append(
                    Image(
                        mean,
                        np.zeros(root.shape[-1]),
                        rule.kept(root, augment),
                        partial(np.eye, root.shape[-1]),
                    )
                )
            elif isinstance(y, np.ndarray):
                images.append(rule.image(y, EUCLIDEAN if spaces is None else spaces[i], root))
            else:
                images.append(
                    rule.image(
                        evaluate(y, x, epoch, noise, None if z is None else z.shape[-1]),
                        y.space,
                        root,
                    )
                )
    state = images[-1]
    if V is not None and not V.ndim:  # a standard deviation alone
        V = V * np.eye(images[0].columns.shape[-2])
    for name, columns, image in (
        ("Q", W and W[1], state),
        ("Q" if isinstance(first, Motion) else "R", V, images[0]),
    ):
        if columns is not None and columns.shape[-2] != image.columns.shape[-2]:
            raise ValueError(
                f"{name}: expected {image.columns.shape[-2]} rows to go with the model, got {columns.shape[-2]}"
            )
    known = belief[1] if state.center is mean and W is None else None
    if z is None:
        return Joint(None, None, state, sign, W, None, known)
    measured, m = images[0], images[0].center.shape[-1]
    own = (
        spaces[0]
        if spaces is not None
        else first.space
        if isinstance(first, Motion | Sensor)
        else EUCLIDEAN
    )
    if z.shape[-1] != m:
        raise ValueError(f"z: expected {m} components to go with h, got {z.shape[-1]}")
    if z.ndim > 1 and z.shape[:-1] != mean.shape[:-1]:
        beside("z", z.shape[:-1], mean.shape[:-1], "the belief")
    if own is EUCLIDEAN:
        innovation = z - measured.center - measured.shift
    else:  # the mean may lie across a seam from the center
        innovation = own.minus(
            own.plus(measured.center, own.minus(z, measured.center) - measured.shift),
            measured.center,
        )
    return Joint(innovation, measured, state, sign, W, V, known, noise_first)


def rule_for(rule: Any, belief: Belief, augment: Sequence[Array] = ()) -> Any:
    """The rule of a belief and of the noises through its points, where it is a function of the dimension."""
    if hasattr(rule, "image"):
        return rule
    n: int = belief[1].shape[-1]
    return rule(n + sum([E.shape[-1] for E in augment]) if augment else n)


def at(noise: Any, mean: Array, epoch: Any) -> Any:
    """Columns of a noise at an epoch."""
    return in_model(noise, mean, epoch) if callable(noise) else noise


def by_matrix(model: Any, rule: Any) -> bool:
    """Whether a model enters by its matrix alone: it is linear, or the rule asks for derivatives that are known."""
    return is_linear(getattr(model, model.name)) or (
        model.jacobian is not None and isinstance(rule, Taylor)
    )


def linear(
    model: Motion | Sensor, rule: Any, mean: Array, epoch: Any, space: Space = EUCLIDEAN
) -> tuple[Array, Array]:
    """Value at the mean and matrix of a model that enters `by_matrix`; ``space``: that of the state."""
    function: Any = getattr(model, model.name)
    if is_linear(function):
        matrix = function.at(epoch, mean.shape[-1]) if callable(function) else function
        if model.name == "f" and matrix.shape[-2] != mean.shape[-1]:
            raise ValueError(
                f"matrix: expected shape (..., {mean.shape[-1]}, {mean.shape[-1]}), got {matrix.shape}"
            )
        value = matvec(matrix, mean)
        if (look := WATCH.get()) is not None:
            look(model.name, value[None])
        return value, matrix
    center = mean if rule.about is None else np.broadcast_to(rule.about, mean.shape)
    none = [np.zeros((1, *center.shape[:-1], E.shape[-2])) for E in model.augment]
    value = evaluate(model, center[None].copy(), epoch, none)[0]
    J = matrices_of("jacobian", model.jacobian, center, epoch)
    if J.ndim < 2 or (model.space is EUCLIDEAN and J.shape[-2] != value.shape[-1]):
        raise ValueError(
            f"jacobian: expected shape (..., {value.shape[-1]}, n) to go with {model.name}, got {J.shape}"
        )
    if rule.about is None:
        return value, J
    way = space.minus(mean, center)
    return model.space.plus(value, matvec(J[..., : way.shape[-1]], way)), J


def _linear_image(
    value: Array, matrix: Array | None, root: Array, sign: Array, augment: Sequence[Array]
) -> Image:
    """The image of a linear function, of its value at the mean and its matrix ``(..., k, n + noises)``; None: the identity."""
    n = root.shape[-1]
    if matrix is None:
        columns = (
            side_by_side([root, *(np.zeros((n, E.shape[-1])) for E in augment)])
            if augment
            else root
        )
        return Image(value, np.zeros(n), columns, partial(np.eye, n))
    width = root.shape[-2] + (sum([E.shape[-2] for E in augment]) if augment else 0)
    if matrix.shape[-1] != width:
        raise ValueError(
            f"jacobian: expected shape (..., {matrix.shape[-2]}, {width}), got {matrix.shape}"
        )
    if augment:
        ends = np.cumsum([E.shape[-2] for E in (root, *augment)])
        columns = side_by_side(
            [
                matrix[..., end - E.shape[-2] : end] @ E
                for end, E in zip(ends, (root, *augment), strict=True)
            ]
        )
    else:
        columns = matrix if sign.ndim > 1 else matrix @ root
    return Image(
        value, np.zeros(matrix.shape[-2]), columns, partial(np.asanyarray, matrix[..., :n])
    )


def over_runs(name: str, batch: tuple[int, ...], belief: Belief) -> Belief:
    """The belief, with a mean for each of the runs that only an argument has; ValueError names one that does not go with it."""
    runs = belief.mean.shape[:-1]
    if not batch or batch == runs:
        return belief
    if belief.mean.dtype.hasobject:
        raise refused(
            f"{name}: a function that gives a matrix for each run is not recorded; give the matrices "
            "(runs, n, n) themselves, or put them into u"
        )
    together = beside(name, batch, runs, "the belief")
    return (
        belief
        if together == runs
        else belief._replace(mean=np.broadcast_to(belief.mean, (*together, belief.mean.shape[-1])))
    )


def whole(form: Form, mean: Array, spread: Array) -> Belief:
    """The belief, where mean and covariance differ from run to run in axes of their own."""
    batch = beside("Q, R", spread.shape[:-2], mean.shape[:-1], "the belief")
    return form(
        np.broadcast_to(mean, (*batch, mean.shape[-1])),
        np.broadcast_to(spread, (*batch, *spread.shape[-2:])),
    )


def marginal(form: Form, joint: Joint, space: Space) -> Belief:
    """The belief about the state, with nothing to condition on: a prediction."""
    mean, spread = (
        space.plus(joint.state.center, joint.state.shift),
        form.marginal(joint.columns(), joint.sign),
    )
    return (
        form(mean, spread)
        if spread.ndim == 2 or spread.shape[:-2] == mean.shape[:-1]
        else whole(form, mean, spread)
    )


def condition(
    form: Form, joint: Joint, space: Space, *,
    hooks: Sequence[Hook] = (), memory: Any = None, epoch: Any = None, gain: Gain | None = None,
) -> tuple[Belief, Info, Any]:  # fmt: skip
    """The belief about the state given the innovation, what was done, and the hooks' memory.

    Components that are nan are marginalized exactly, in each run by itself. With a prescribed ``gain`` the covariance is that of a
    filter which uses it, whatever it is.
    """
    given = joint.innovation
    if hooks or callable(gain):
        joint = joint.factored()
    if hooks:
        joint, memory = _adapted(joint, hooks, memory, epoch)
    innovation, measured, state = joint.innovation, joint.measurement, joint.state

    used, m = present(innovation), innovation.shape[-1]
    A, mask = joint.columns(), alike(used)
    if not surely(mask.all()):
        # Rows that were not measured: no columns from the prior, a unit noise of their own and a zero innovation.
        here = mask[..., None]
        A = block([[A[..., :m, :] * here, np.eye(m) * ~here], [A[..., m:, :], 0]])
        innovation = np.where(mask, innovation, 0.0)
    K: Any = gain
    if gain is not None:
        K = (
            numbers(
                "gain",
                gain(A, joint.sign, m) if callable(gain) else gain,
                (..., A.shape[-2] - m, m),
            )
            * mask[..., None, :]
        )
    S, U, spread = form.condition(
        A, joint.sign, m, K, known=joint.known, noise=joint.measurement_noise
    )
    whitened = whiten(S, innovation)
    step = state.shift + (matvec(U, whitened) if K is None else matvec(K, innovation))
    if space.transport is not None:
        spread = form.transported(space.transport(step), spread)

    def optimal() -> Array:
        return solve_right(S, U) if K is None else K

    R = None if not hooks else joint.variances()[1]
    info = Info(given, whitened, used, S, optimal, measured.jacobian, R=R)
    mean = space.plus(state.center, step)
    together = spread.ndim == 2 or spread.shape[:-2] == mean.shape[:-1]
    return form(mean, spread) if together else whole(form, mean, spread), info, memory


def _adapted(joint: Joint, hooks: Sequence[Hook], memory: Any, epoch: Any) -> tuple[Joint, Any]:
    """The joint after its hooks, which may replace its arrays or write into them, and their memories."""
    columns, memories = joint.state.columns, []
    measurement, state = (
        image._replace(columns=image.columns.copy()) for image in (joint.measurement, joint.state)
    )
    W, V = joint.process_noise, joint.measurement_noise
    given = joint = joint._replace(
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
        remembered, joint = given_back("hooks", hook(remembered, joint, epoch), "memory, joint")
        instance("hooks", joint, Joint, "hooks that give back (memory, joint)")
        memories.append(remembered)
    same = joint.sign is given.sign and joint.process_noise is given.process_noise
    if not same or not known_alike(joint.state.columns, columns):
        joint = joint._replace(known=None)
    return joint, tuple(memories)


def alike(used: Array) -> Array:
    """A mask ``(..., m)`` as one, ``(m,)``, where it is that of all runs: what they share then stays one for all."""
    every: Array = np.logical_and.reduce(used, tuple(range(used.ndim - 1)))
    return every if used.ndim == 1 or every.all() or (used == every).all() else used


def evaluate(
    model: Motion | Sensor, x: Array, epoch: Any, noise: Sequence[Array] = (), m: int | None = None
) -> Array:
    """Values ``(p, ..., m)`` of a model at points ``x (p, ..., N)``, as floats of the shape they must have.

    ``m``: how many components are measured. The function may change its argument: rules make points for one call, and a caller with
    two hands out a copy. What it raises carries a note of what it got.
    """
    name = model.name
    function: Any = getattr(model, name)
    if not callable(function):
        return matvec(function, x)
    vectors = not isinstance(model, Motion) and model.space is EUCLIDEAN and model.m in (None, m)
    dimension = x.shape[-1] if isinstance(model, Motion) else m if vectors else None
    copies = [array.copy(order="K") for array in (x, *noise)] if unknown(function, x) else None
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
        given = "an input" if getattr(epoch, "u", None) is not None else "None"
        note = f"{name} is called with points {x.shape} and an Epoch: epoch.dt is its interval, epoch.u ({given}) its input"
        error.add_note(note)
        error.add_note(POINTS)
        raise
    if (
        y.shape[:-1] != x.shape[:-1]
        or not y.ndim
        or (dimension is not None and y.shape[-1] != dimension)
    ):
        expected = ", ".join(
            str(s) for s in (*x.shape[:-1], "m" if dimension is None else dimension)
        )
        raise ValueError(f"{name} returned shape {y.shape}, expected ({expected}); {POINTS}")
    if (look := WATCH.get()) is not None:
        other = look(name, y)
        y = y if other is None else other
    if copies is not None:
        y = y.copy(order="K")  # it may be a buffer of the model's
        check_apart(name, function, copies, epoch, y)
    return np.asanyarray(y)
