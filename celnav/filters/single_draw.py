"""Predict and update on one set of sigma points: the augmented form of [van der Merwe 2004], without drawing anew in between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from celnav.filters.arguments import (
    batched,
    check_extra,
    check_hooks,
    check_model,
    check_part,
    check_rule,
    check_space,
    given_back,
    measurement,
)
from celnav.filters.conditioning import Model, condition, evaluate, images, innovation_of, noise_columns, set_noise, settled
from celnav.filters.driver import Epoch, Filter, State
from celnav.filters.info import Hook, Info
from celnav.filters.step import Update, predict
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.transform import Outputs, Transform


def single_draw(
    f: Model,
    h: Model,
    rule: Transform,
    *,
    extra: Sequence[Array],
    R: Any = None,
    sqrt_R: Any = None,
    space: Space = EUCLIDEAN,
    measurement_space: Space = EUCLIDEAN,
    hooks: Sequence[Hook] = (),
) -> Update:
    """The part that moves a belief through the dynamics and conditions it on a measurement in one transform.

    Noise that goes through the points reaches both functions, so noise of the process and of the measurement may be
    correlated: give their joint root. Additive process noise would not reach the measurement, and is not offered.

    Parameters
    ----------
    f, h: model functions ``f(x, epoch, *noise)`` and ``h(f(x), epoch, *noise)``, with all noises of ``extra``.
    rule: of dimension n plus that of ``extra``. extra: roots ``(k, k)``. Others as in `celnav.filters.step.update`.

    Returns
    -------
    ``(belief, z, epoch=None, memory=None) -> (belief, info, memory)``, with a wholly missing ``z`` a prediction.

    Raises
    ------
    ValueError: naming the argument that cannot be; at the step, if shapes do not go together.
    """
    check_rule(rule)
    check_extra(extra)
    check_model("h", h, noises=len(extra))
    check_space("measurement_space", measurement_space)
    check_hooks(hooks)
    columns = noise_columns(R, sqrt_R, "R")
    forward = predict(f, rule, extra=extra, space=space)

    def part(belief: Gaussian, z: Any, epoch: Any = None, memory: Any = None) -> tuple[Gaussian, Info, Any]:
        z, belief = measurement(z, belief)
        if np.isnan(z).all():
            after, info = forward(belief, epoch)
            return after, info, memory
        if measurement_space.check is not None:
            z = measurement_space.check(z, "z")
        noise = evaluate(columns, belief.mean, epoch)
        s = 0
        if noise is not None:
            s, belief = noise.shape[-1], batched("R", noise.shape[:-2], belief)
        root = belief.form.root(belief.spread)

        def g(points: Array, *w: Array) -> Outputs:
            y = images("f", f, points, epoch, w, belief.mean.shape[-1])
            return images("h", h, y.copy(order="K"), epoch, w, z.shape[-1]), y

        (measured, state), A = rule.transform(g, belief.mean, root, space, (measurement_space, space), extra, s, epoch)
        m = measured.columns.shape[-2]
        if noise is not None:
            A[..., m:, A.shape[-1] - s :] = 0.0
            set_noise("R", A[..., :m, A.shape[-1] - s :], noise)
        innovation = innovation_of(z, measured, measurement_space)
        posterior, info, kept = condition(
            belief, state, A, rule.sign, innovation, noise=(0, s), space=space,
            slopes=lambda: (rule.slope(measured, root), rule.slope(state, root)), hooks=hooks, memory=memory, epoch=epoch,
        )  # fmt: skip
        posterior, failure = settled(belief, posterior, ("h", "f"), rule, g, space, extra, z)
        return posterior, info._replace(failure=failure) if failure else info, kept

    return part


def drawn_once(part: Update, first: Update) -> Filter:
    """A filter of such a part; an epoch with ``dt == 0``, which has no dynamics, is left to the update ``first``.

    Raises
    ------
    ValueError: from the filter, for an epoch whose ``z`` is None: a missing measurement is nan here.
    """

    for name, value in (("part", part), ("first", first)):
        check_part(name, value)

    def step(state: State, epoch: Epoch) -> tuple[State, Info]:
        if epoch.z is None:
            raise ValueError("z: expected a measurement or nan at every epoch, got None")
        moving = bool(np.any(epoch.dt))
        chosen, memory = (part, state.memory[1]) if moving else (first, state.memory[0])
        found = chosen(state.belief, epoch.z, epoch, memory)
        belief, info, kept = given_back("part" if moving else "first", found, "belief, info, memory")
        return State(belief, (state.memory[0], kept) if moving else (kept, state.memory[1])), info

    return Filter(lambda prior: State(prior, (None, None)), step)
