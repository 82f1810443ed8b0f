"""Time and measurement update of one vector: what `predict` and `update` do, without what many runs at once need.

No batches, no spaces, no hooks, nothing missing: a step then takes half the time. Form and rule do the algebra, as everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from celnav.gaussian.belief import PRECISE, Gaussian
from celnav.gaussian.linalg import Array, matvec, whiten
from celnav.gaussian.rule import Rule

Images = Callable[[Array, Any], Array]
"""Points ``(p, n)``, and None for an epoch, to their images ``(p, k)``."""


def time_update(belief: Gaussian, f: Images, rule: Rule, sqrt_Q: Array) -> Gaussian:
    """The belief ``(n,)`` after ``x' = f(x) + w``; ``sqrt_Q (n, r)``. Nothing is checked."""
    mean, columns = rule.moments(f(rule.drawn(belief.mean, belief.root), None))
    return Gaussian(mean, belief.form.marginal(np.concatenate([columns, sqrt_Q], -1), rule.sign), belief.form)


class Updated(NamedTuple):
    """What a measurement update found.

    Attributes
    ----------
    belief: after it. images: ``(p, m)`` of the points. innovation, white: ``(m,)``. S: ``(m, m)``, root of the innovation's
        covariance. U: ``(n, m)``, the gain is ``U S^-1``.
    """

    belief: Gaussian
    images: Array
    innovation: Array
    white: Array
    S: Array
    U: Array


def measurement_update(belief: Gaussian, z: Array, h: Images, rule: Rule, sqrt_R: Array) -> Updated:
    """The belief ``(n,)`` given ``z = h(x) + v``; ``sqrt_R (m, s)`` without a row of zeros. Nothing is checked."""
    (m, s), root = sqrt_R.shape, belief.root
    images = h(rule.drawn(belief.mean, root), None)
    mean, columns = rule.moments(images)
    q = columns.shape[-1]
    A = np.zeros((m + len(root), q + s))
    A[:m, :q], A[:m, q:], A[m:, :q] = columns, sqrt_R, root.dot(rule.unit.T)
    S, U, spread = belief.form.condition(A, rule.sign, m, None, (belief.spread, PRECISE * np.sqrt(np.vecdot(sqrt_R, sqrt_R))))
    innovation = z - mean
    white = whiten(S, innovation)
    return Updated(Gaussian(belief.mean + matvec(U, white), spread, belief.form), images, innovation, white, S, U)
