"""The filter of [Sun2015] for colored measurement noise: decorrelate, update the past state, predict.

A decorrelated system, an update that gives the *lagged* estimate ``E[x_k | z_0..z_k+1]`` and a prediction that gives the one
without latency, ``E[x_k+1 | z_0..z_k+1]``. With a linear model this is what `celnav.filters.colored.colored` gives in one step.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.arguments import check_hooks, check_model, check_rule
from celnav.filters.colored import lift
from celnav.filters.coloring import Colored, Coloring, coloring, difference, first_update, measurement_matrix, noises, taken
from celnav.filters.conditioning import Model, condition, evaluate
from celnav.filters.driver import Epoch, Filter
from celnav.filters.info import Hook, Info, Joint
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, block, matvec, solve_upper_transposed, tria
from celnav.gaussian.transform import Transform


class Decorrelation(NamedTuple):
    """Gain ``J (..., n, m)`` and the roots of ``Q* (..., n, n)`` and ``R* (..., m, m)`` [Sun2015, Eqs. 10-20]."""

    J: Array
    sqrt_Q: Array
    sqrt_R: Array


def decorrelation(H: Array, sqrt_Q: Array, sqrt_R: Array) -> Decorrelation:
    """Decorrelate process noise and differenced measurement noise by one QR, without subtraction.

    The lower root of ``[[R^1/2, H Q^1/2], [0, Q^1/2]]`` is ``[[R*^1/2, 0], [J R*^1/2, Q*^1/2]]``. Subtracting covariances
    instead, ``Q* = Q - Q H' R*^-1 H Q``, loses every digit once the process noise is 1e8 times the measurement noise.
    """
    m = H.shape[-2]
    L = tria(block([[sqrt_R, H @ sqrt_Q], [0, sqrt_Q]]))
    sqrt_R_star = L[..., :m, :m]
    J = solve_upper_transposed(sqrt_R_star, L[..., m:, :m].mT).mT
    return Decorrelation(J, L[..., m:, m:], sqrt_R_star)


def decorrelated(
    f: Model,
    H: ArrayLike,
    rule: Transform,
    Phi: Coloring,
    *,
    Q: Any = None,
    R: Any = None,
    sqrt_Q: Any = None,
    sqrt_R: Any = None,
    Sigma0: ArrayLike | None = None,
    hooks: Sequence[Hook] = (),
) -> Filter:
    """The filter of [Sun2015] with its errata corrected: update the past state, then predict with ``J``, ``Q*`` and ``R*``.

    ``x* = f(x) + J (z* - h(x))`` and ``h(x) = H f(x) - Phi H x`` [Sun2015, Eqs. 8, 14]. The state after an epoch holds both
    estimates: ``belief`` of the present state, ``lagged`` of the previous one, each given all measurements so far.
    Parameters as in `colored`; ``H`` is a matrix. Hooks may leave measurements out, as gates do. Those that change the noise are
    for `colored`: here the noise also decides how the measurement enters the prediction.

    Raises
    ------
    ValueError: as `colored`; from the filter, for a hook that changes more than the innovation.
    """
    check_model("f", f)
    check_rule(rule)
    check_hooks(hooks)
    matrix = measurement_matrix("H", H)
    process, increments, m = noises(Q, sqrt_Q, R, sqrt_R, matrix.shape[-2])
    if not callable(process) and process.shape[-2] != matrix.shape[-1]:
        raise ValueError(f"H: expected {process.shape[-2]} columns to go with Q, got {matrix.shape[-1]}")
    gates = [_leaving_out(hook) for hook in hooks]
    phi = coloring(Phi, m)
    first = first_update(matrix, rule, Sigma0)
    constant = None if callable(process) or callable(increments) else decorrelation(matrix, process, increments)

    def system(mean: Array, epoch: Epoch, used: Array) -> Decorrelation:
        """The decorrelated system; a row that was not measured has no part in ``J`` (its noise is its own)."""
        if used.all() and constant is not None:
            return constant
        W, Z = evaluate(process, mean, epoch), evaluate(increments, mean, epoch)
        if used.all():
            return decorrelation(matrix, W, Z)
        unit = used[..., None] * 1.0
        return decorrelation(matrix * unit, W, np.concatenate([Z * unit, np.eye(m) * (1.0 - unit)], -1))

    def past(belief: Gaussian, Phi: Array, z: Array, epoch: Epoch, memory: Any) -> tuple[Gaussian, Info, Any]:
        lifted = lift(f, rule, belief, epoch)
        h = lifted.rows(matrix, -Phi @ matrix)
        noise = system(belief.mean, epoch, np.ones(m, bool)).sqrt_R
        A = block([[h.columns, noise], [lifted.x.columns, 0]])

        def slopes() -> tuple[Array, ...]:
            return (matrix @ lifted.slope() - Phi @ matrix,)

        lagged, info, kept = condition(
            belief, lifted.x, A, rule.sign, z - h.center - h.shift,
            noise=(0, m), slopes=slopes, hooks=gates, memory=memory, epoch=epoch,
        )  # fmt: skip
        lagged, failure = lifted.settled(lagged, z)
        return lagged, info._replace(failure=failure), kept

    def forward(lagged: Gaussian, Phi: Array, z: Array, epoch: Epoch, used: Array) -> tuple[Gaussian, str]:
        star = system(lagged.mean, epoch, used)
        lifted = lift(f, rule, lagged, epoch)
        JH = star.J @ matrix
        y = lifted.rows(np.eye(JH.shape[-1]) - JH, star.J @ Phi @ matrix)
        mean = y.center + y.shift + matvec(star.J, np.where(used, z, 0.0))
        ahead = Gaussian(mean, lagged.form.marginal(block([[y.columns, star.sqrt_Q]]), rule.sign), lagged.form)
        return lifted.settled(ahead, None)

    def step(state: Colored, epoch: Epoch) -> tuple[Colored, Info]:
        state, z = taken(state, epoch, m)
        if state.z is None:
            belief, info = first(state.belief, epoch._replace(z=z))
            return Colored(belief, z, state.lagged, state.memory), info
        Phi_k = phi(epoch)
        z_star = difference(Phi_k, state.z, z)
        lagged, info, memory = past(state.belief, Phi_k, z_star, epoch, state.memory)
        belief, failure = forward(lagged, Phi_k, z_star, epoch, np.asarray(info.used))
        return Colored(belief, z, lagged, memory), info._replace(failure=info.failure or failure)

    return Filter(lambda prior: Colored(prior, None, prior), step)


def _leaving_out(hook: Hook) -> Hook:
    """The hook, held to leaving measurements out."""

    def gate(memory: Any, joint: Joint, epoch: Any) -> tuple[Any, Joint]:
        memory, after = hook(memory, joint, epoch)
        if any(getattr(after, part) is not getattr(joint, part) for part in ("columns", "sign", "process", "sensor")):
            raise ValueError(
                "hooks: expected hooks that only leave measurements out, got one that changes noise; `colored` takes it"
            )
        return memory, after

    return gate
