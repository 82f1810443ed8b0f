"""Filters for colored measurement noise ``V' = Phi V + zeta``, ``zeta ~ N(0, R)``: whiten by differencing.

The difference ``z* = z' - Phi z`` of consecutive measurements has white noise, correlated with the process noise. `colored`
conditions on it in one transform, `celnav.filters.decorrelated.decorrelated` in the two steps of [Sun2015]. `augmented` carries
V in the state: the exact reference. All take any rule and both forms, and a ``Phi`` that may be full, differ from run to run,
or be a function of the epoch.

A missing sample costs two differences, the one that ends and the one that begins with it: conservative, unbiased, and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import batched, check_hooks, check_model, check_rule
from celnav.filters.coloring import Colored, Coloring, coloring, difference, first_update, measurement_matrix, noises, taken
from celnav.filters.conditioning import Model, condition, evaluate, images, settled
from celnav.filters.driver import Epoch, Filter, State, sequential
from celnav.filters.info import Hook, Info
from celnav.filters.step import predict, update
from celnav.gaussian.belief import Gaussian, sqrt_cov
from celnav.gaussian.linalg import Array, block, matvec, side_by_side
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.gaussian.transform import KEEP, Image, Outputs, Transform


def colored(
    f: Model,
    h: Model | ArrayLike,
    rule: Transform,
    Phi: Coloring,
    *,
    Q: Any = None,
    R: Any = None,
    sqrt_Q: Any = None,
    sqrt_R: Any = None,
    Sigma0: ArrayLike | None = None,
    first_rule: Transform | None = None,
    hooks: Sequence[Hook] = (),
) -> Filter:
    """Single-transform filter: condition ``x' = f(x) + w`` on ``z' - Phi z = h(x') - Phi h(x) + zeta`` directly.

    Parameters
    ----------
    f: dynamics.
    h: measurement matrix ``(m, n)``, or a function. With a function the process noise enters the measurement nonlinearly, so
        it goes through the points: ``rule`` then has the dimension of state and noise together and ``sqrt_Q`` is constant.
    Phi: see `Coloring`; checked by `coloring`.
    Q, R: covariances of ``w`` and of the increments ``zeta`` (not of V), or their roots.
    Sigma0: covariance of the first noise sample ``V_0``. None: the first sample only anchors the first difference, as in
        the paper, which is the limit of a large ``Sigma0``.
    first_rule: rule of dimension n for the update with ``Sigma0``; needed where ``h`` is a function.
    hooks: see `celnav.filters.info.Hook`.

    The first epoch has ``dt == 0``, every later one an interval. States and measurements are vectors: the difference of two
    measurements knows nothing of a seam. Where an angle is measured, carry the noise in the state.

    Raises
    ------
    ValueError: naming the argument that cannot be; at the step, if shapes or intervals do not go together.
    """
    check_model("f", f)
    check_rule(rule)
    check_rule(rule if first_rule is None else first_rule, "first_rule")
    check_hooks(hooks)
    H = None if callable(h) else measurement_matrix("h", h)
    process, increments, m = noises(Q, sqrt_Q, R, sqrt_R, None if H is None else H.shape[-2])
    if H is not None:
        conditioned = _linear(f, H, rule, process, increments, hooks)
    else:
        assert callable(h)
        if callable(process):
            raise ValueError("sqrt_Q: expected constant columns where the measurement is a function")
        if not process.shape[-2]:
            raise ValueError(f"sqrt_Q: expected columns (n, r), got shape {process.shape}")
        if Sigma0 is not None and first_rule is None:
            raise ValueError("first_rule: expected a rule of the state's dimension where the measurement is a function")
        conditioned = _through_points(f, h, rule, process, increments, hooks)
    phi = coloring(Phi, m)
    first = first_update(h, rule if first_rule is None else first_rule, Sigma0)

    def step(state: Colored, epoch: Epoch) -> tuple[Colored, Info]:
        state, z = taken(state, epoch, m)
        if state.z is None:
            belief, info = first(state.belief, epoch._replace(z=z))
            return Colored(belief, z, state.lagged, state.memory), info
        coefficient = phi(epoch)
        belief, info, memory = conditioned(state, coefficient, difference(coefficient, state.z, z), epoch)
        return Colored(belief, z, state.lagged, memory), info

    return Filter(lambda prior: Colored(prior, None, prior), step)


class Lifted(NamedTuple):
    """A belief pushed through ``f``: the images of ``f(x)`` and of ``x``, from which every linear row here is made."""

    y: Image
    x: Image
    root: Array
    rule: Transform
    belief: Gaussian
    g: Callable[..., Outputs]

    def rows(self, after: Array, before: Array) -> Image:
        """Image of ``after @ f(x) + before @ x``; centers are combined before the small shift is added."""
        center = matvec(after, self.y.center) + matvec(before, self.x.center)
        shift = matvec(after, np.broadcast_to(self.y.shift, self.y.center.shape))
        return Image(center, shift, after @ self.y.columns + before @ self.x.columns)

    def slope(self) -> Array:
        return self.rule.slope(self.y, self.root)

    def settled(self, after: Gaussian, z: Array | None) -> tuple[Gaussian, str]:
        return settled(self.belief, after, ("f",), self.rule, self.g, EUCLIDEAN, (), z)


def lift(f: Model, rule: Transform, belief: Gaussian, epoch: Epoch) -> Lifted:
    root = belief.form.root(belief.spread)

    def g(points: Array) -> Outputs:
        return images("f", f, points, epoch, (), points.shape[-1]), KEEP

    (y, x), _ = rule.transform(g, belief.mean, root, EUCLIDEAN, (EUCLIDEAN, EUCLIDEAN), epoch=epoch)
    return Lifted(y, x, root, rule, belief, g)


def _linear(f: Model, H: Array, rule: Transform, process: Any, increments: Any, hooks: Sequence[Hook]) -> Callable[..., Any]:
    """Condition with a measurement matrix: ``A = [[D_z, H Q^1/2, R^1/2], [D_y, Q^1/2, 0]]``."""

    def conditioned(state: Colored, Phi: Array, z: Array, epoch: Epoch) -> tuple[Gaussian, Info, Any]:
        belief = state.belief
        W, Z = evaluate(process, belief.mean, epoch), evaluate(increments, belief.mean, epoch)
        lifted = lift(f, rule, belief, epoch)
        measured = lifted.rows(H, -Phi @ H)
        A = block([[measured.columns, H @ W, Z], [lifted.y.columns, W, 0]])

        def slopes() -> tuple[Array, ...]:
            F = lifted.slope()
            return H @ F - Phi @ H, F

        after, info, memory = condition(
            belief, lifted.y, A, rule.sign, z - measured.center - measured.shift,
            noise=(W.shape[-1], Z.shape[-1]), slopes=slopes, hooks=hooks, memory=state.memory, epoch=epoch,
        )  # fmt: skip
        after, failure = lifted.settled(after, z)
        return after, info._replace(failure=failure), memory

    return conditioned


def _through_points(
    f: Model, h: Model, rule: Transform, process: Array, increments: Any, hooks: Sequence[Hook]
) -> Callable[..., Any]:
    """Condition with a measurement function: the process noise goes through the points."""

    def conditioned(state: Colored, Phi: Array, z: Array, epoch: Epoch) -> tuple[Gaussian, Info, Any]:
        Z = evaluate(increments, state.belief.mean, epoch)
        belief = batched("R", Z.shape[:-2], state.belief)
        root = belief.form.root(belief.spread)
        m, s = Z.shape[-2:]

        def g(points: Array, w: Array) -> Outputs:
            y = images("f", f, points.copy(), epoch, (), points.shape[-1]) + w
            now = images("h", h, y.copy(order="K"), epoch, (), m)
            before = images("h", h, points, epoch, (), m)
            return now - matvec(Phi, before), y

        (measured, y), A = rule.transform(g, belief.mean, root, EUCLIDEAN, (EUCLIDEAN, EUCLIDEAN), (process,), s, epoch)
        A[..., :m, A.shape[-1] - s :] = Z
        A[..., m:, A.shape[-1] - s :] = 0.0

        def slopes() -> tuple[Array, ...]:
            return rule.slope(measured, root), rule.slope(y, root)

        after, info, memory = condition(
            belief, y, A, rule.sign, z - measured.center - measured.shift,
            noise=(0, s), slopes=slopes, hooks=hooks, memory=state.memory, epoch=epoch,
        )  # fmt: skip
        after, failure = settled(belief, after, ("h", "f"), rule, g, EUCLIDEAN, (process,), z)
        return after, info._replace(failure=failure), memory

    return conditioned


def augmented(
    f: Model,
    H: ArrayLike,
    rule: Transform,
    Phi: Coloring,
    *,
    Q: ArrayLike,
    R: ArrayLike,
    Sigma0: ArrayLike,
) -> Filter:
    """The exact reference: a filter on ``[x; V] (n + m)`` with no measurement noise of its own.

    ``rule`` has dimension n + m. The state's belief is that of ``[x; V]``; start it from a prior of ``x`` alone. Its
    covariance is singular after each measurement. A missing sample costs nothing but itself.
    """
    check_model("f", f)
    check_rule(rule)
    matrix = measurement_matrix("H", H)
    m, n = matrix.shape[-2:]
    phi = coloring(Phi, m)
    process, increments, first = sqrt_cov(Q, "Q", n), sqrt_cov(R, "R", m), sqrt_cov(Sigma0, "Sigma0", m)

    def move(x: Array, epoch: Any) -> Array:
        return np.concatenate([images("f", f, x[..., :n], epoch, (), n), matvec(phi(epoch), x[..., n:])], -1)

    both = sequential(
        predict(move, rule, sqrt_Q=block([[process, 0], [0, increments]])),
        update(side_by_side([matrix, np.eye(m)]), rule, sqrt_R=np.zeros((m, 0))),
    )

    def start(prior: Gaussian) -> State:
        prior = batched("Sigma0", first.shape[:-2], prior if callable(Phi) else batched("Phi", np.shape(Phi)[:-2], prior))
        batch = prior.mean.shape[:-1]
        mean = np.concatenate([prior.mean, np.zeros((*batch, m))], -1)
        noise = np.broadcast_to(first, (*batch, m, m))
        spread = noise if prior.form.name == "square root" else noise @ noise.mT
        state: State = both.start(Gaussian(mean, block([[prior.spread, 0], [0, spread]]), prior.form))
        return state

    return Filter(start, both.step)
