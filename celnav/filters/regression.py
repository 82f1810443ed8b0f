"""Statistical linear regression: the linear function that fits a model best over a belief, and the
residual of this fit.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from celnav.filters.joint import Joint
from celnav.gaussian.linalg import (
    EPS,
    Array,
    Belief,
    SquareRoot,
    block,
    is_concretely_true,
    matvec,
    solve_lower,
    solve_right,
)
from celnav.gaussian.rules import Image


def regressed(joint: Joint, belief: Belief, offset: Array) -> Joint:
    """The joint of a measurement and of a state with prior ``belief``, by the regression
    ``z = A x + b + e`` over another belief.

    joint: the joint over the other belief, from sigma points, with the state unchanged. offset:
        ``(..., n)``, from the other belief's mean to the mean of ``belief``. The residual e of the
        columns is treated as noise, with the signs of the columns [Garcia2015].
    """
    # A = cov(z, x) cov(x)^+, and E = D_z - A D_x are the columns of e.
    image, root = joint.measurement, belief.sqrt_cov
    n = root.shape[-1]
    A = pseudo_gain(block([[joint.state.columns], [image.columns]]), joint.sign, n)
    E, moved = image.columns - A @ joint.state.columns, matvec(A, offset)
    columns = block([[root, np.zeros((n, E.shape[-1]))]])
    # Columns: first the prior's, [A L; L], then the columns of e, which enter only the measurement.
    return joint._replace(
        innovation=joint.innovation - moved,
        measurement=Image(
            image.center, image.shift + moved, block([[A @ root, E]]), partial(np.asanyarray, A)
        ),
        state=Image(belief.mean, np.zeros(n), columns, partial(np.eye, n)),
        sign=np.concatenate([np.ones(n), np.broadcast_to(joint.sign, E.shape[-1:])]),
        prior_factor=belief[1],
    )


def pseudo_gain(
    A: Array, sign: Array, m: int, center: Array | None = None, least: float = 0.0
) -> Array:
    """Gain ``cov(x, y) cov(y)^+ (..., n, m)`` from columns of y (m rows) and x (n rows), with the
    pseudo-inverse where the covariance of y is singular.

    center: the value of y ``(..., m)``, whose round-off is in the columns.
    least: a direction of y is treated as constant if its standard deviation is at most this
        fraction of the standard deviations of the components.
    """
    # With S S' = cov(y): K = D_x sign D_y' S^-T S^-1.
    D_y, D_x = A[..., :m, :], A[..., m:, :]
    S = SquareRoot.marginal(D_y, sign)
    signed = D_x * sign
    std = np.sqrt(np.einsum("...ij,...ij->...i", S, S))
    constant = std == 0.0
    unit = np.where(constant, 1.0, std)
    # Differences of images contain the round-off of the images: a direction of y below this
    # round-off is treated as constant.
    if center is None:
        noise: Any = 0.0
    elif center.shape[-1] == S.shape[-1]:
        noise = EPS * np.where(constant, 0.0, np.abs(center) / unit).max(-1)
    else:
        noise = EPS * np.abs(center).max(-1) / unit.min(-1)
    bound = np.maximum(4.0 * (S.shape[-1] * EPS + noise), least)
    singular = np.asanyarray((S.diagonal(0, -2, -1) <= bound[..., None] * unit).any(-1))
    eye, none = np.eye(S.shape[-1]), is_concretely_true(~singular.any())
    # A recorded step returns nan in a singular run, and the numpy engine repeats this run.
    recorded = S.dtype.hasobject
    regular = S if none else np.where(singular[..., None, None], np.nan if recorded else eye, S)
    gain = solve_right(regular, signed @ solve_lower(regular, D_y).mT)
    if none or recorded:
        return gain
    u, s, _ = np.linalg.svd(np.where(singular[..., None, None], S / unit[..., None], eye))
    significant = s > bound[..., None]
    inverse = np.where(significant, 1.0 / np.where(significant, s, 1.0), 0.0)[..., None]
    # S = diag(unit) u s v', so in units of the standard deviations cov(y)^+ = (u / s) (u / s)'.
    half = inverse * (u.mT / unit[..., None, :])
    pseudo = (signed @ (half @ D_y).mT) @ half
    return np.where(singular[..., None, None], pseudo, gain)
