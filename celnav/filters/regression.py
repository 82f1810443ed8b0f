"""Statistical linear regression: the linear function that is nearest to a model over a belief, and
what it leaves over.
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


def regressed(seen: Joint, belief: Belief, way: Array) -> Joint:
    """The joint of a measurement and of the state as ``belief`` has it, by the regression
    ``z = A x + b + e`` over another belief.

    seen: the joint over that other belief, by points, with the state kept. way: ``(..., n)`` from
    its mean to that of ``belief``. What A leaves of the columns is e, noise with the signs that
    they have [Garcia2015].
    """
    own, root = seen.measurement, belief.sqrt_cov
    n = root.shape[-1]
    A = pseudo_gain(block([[seen.state.columns], [own.columns]]), seen.sign, n)
    left, moved = own.columns - A @ seen.state.columns, matvec(A, way)
    kept = block([[root, np.zeros((n, left.shape[-1]))]])
    return seen._replace(
        innovation=seen.innovation - moved,
        measurement=Image(
            own.center, own.shift + moved, block([[A @ root, left]]), partial(np.asanyarray, A)
        ),
        state=Image(belief.mean, np.zeros(n), kept, partial(np.eye, n)),
        sign=np.concatenate([np.ones(n), np.broadcast_to(seen.sign, left.shape[-1:])]),
        prior_factor=belief[1],
    )


def pseudo_gain(
    A: Array, sign: Array, m: int, center: Array | None = None, least: float = 0.0
) -> Array:
    """Gain ``cov(x, y) cov(y)^+ (..., n, m)`` of columns of y and x; the pseudo-inverse where the
    covariance of y is singular.

    ``center``: where y lies, whose round-off the columns carry. ``least``: part of a deviation
        below which a direction is known.
    """
    D_y, D_x = A[..., :m, :], A[..., m:, :]
    S = SquareRoot.marginal(D_y, sign)
    signed = D_x * sign
    std = np.sqrt(np.einsum("...ij,...ij->...i", S, S))
    known = std == 0.0
    unit = np.where(known, 1.0, std)
    # Differences of images carry the round-off of the images: below it a direction of y is known,
    # not merely well known.
    if center is None:
        noise: Any = 0.0
    elif center.shape[-1] == S.shape[-1]:
        noise = EPS * np.where(known, 0.0, np.abs(center) / unit).max(-1)
    else:
        noise = EPS * np.abs(center).max(-1) / unit.min(-1)
    bound = np.maximum(4.0 * (S.shape[-1] * EPS + noise), least)
    singular = np.asanyarray((S.diagonal(0, -2, -1) <= bound[..., None] * unit).any(-1))
    eye, none = np.eye(S.shape[-1]), is_concretely_true(~singular.any())
    recorded = S.dtype.hasobject  # there a singular run is lost: the numpy engine flies it again
    regular = S if none else np.where(singular[..., None, None], np.nan if recorded else eye, S)
    gain = solve_right(regular, signed @ solve_lower(regular, D_y).mT)
    if none or recorded:
        return gain
    u, s, _ = np.linalg.svd(np.where(singular[..., None, None], S / unit[..., None], eye))
    kept = s > bound[..., None]
    inverse = np.where(kept, 1.0 / np.where(kept, s, 1.0), 0.0)[..., None]
    # S = unit u s v': cov(y)^+ = (u / s) (u / s)' in units of the standard deviations
    half = inverse * (u.mT / unit[..., None, :])
    pseudo = (signed @ (half @ D_y).mT) @ half
    return np.where(singular[..., None, None], pseudo, gain)
