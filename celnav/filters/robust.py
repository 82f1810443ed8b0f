"""Hooks that take measurement noise for other than Gaussian, or for unknown: they weigh each component anew at every epoch.

All work with every rule and form. What a state correction explains of an innovation is taken by the measurement matrix of
statistical linearization, ``H = P_zx P^-1`` (the Jacobian of an extended filter). Noise is taken to be of independent components.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.adaptive import counted, scaled, variances
from celnav.filters.arguments import repetitions
from celnav.filters.info import Hook, Joint
from celnav.gaussian.checks import number
from celnav.gaussian.linalg import Array, matvec


def huber(threshold: float = 1.345, rounds: int = 6) -> Hook:
    """Weigh a component by ``min(1, threshold / u)``, u its residual after the update in deviations of its noise [Huber 1964].

    ``rounds`` of reweighting; the noise variance of a component is divided by its weight.

    Raises
    ------
    ValueError: unless both are positive, ``rounds`` an integer.
    """
    bound = number("threshold", threshold, above=0.0)
    return _reweighted(lambda u: bound / np.maximum(u, bound), rounds)


def student_t(dof: float = 4.0, rounds: int = 6) -> Hook:
    """Weigh a component by ``(dof + 1) / (dof + u^2)``, as for noise of Student's t distribution; see `huber`."""
    nu = number("dof", dof, above=0.0)
    return _reweighted(lambda u: (nu + 1.0) / (nu + u * u), rounds)


def _reweighted(weight: Callable[[Array], Array], rounds: int) -> Hook:
    most = repetitions("rounds", rounds)

    def hook(memory: Any, joint: Joint, _epoch: Any) -> tuple[Any, Joint]:
        e = joint.innovation
        used = ~np.isnan(e)
        m = e.shape[-1]
        _, noise = variances(joint)
        used &= noise > 0.0
        R = np.where(used, noise, 1.0)
        D = counted(joint)[..., :m, :]
        columns = np.concatenate([joint.columns, joint.process], -1)
        S0 = D @ columns[..., :m, :].mT
        cross = columns[..., m:, :] @ D.mT
        explained = joint.slopes()[0] @ cross
        both = used[..., :, None] & used[..., None, :]
        S0, explained, y = np.where(both, S0, 0.0), np.where(used[..., None], explained, 0.0), np.where(used, e, 0.0)
        W = np.ones_like(R)
        for _ in range(most):
            S = S0 + (R / W)[..., None] * np.eye(m)
            fitted = matvec(explained, np.linalg.solve(S, y[..., None])[..., 0])
            W = np.where(used, weight(np.abs(y - fitted) / np.sqrt(R)), 1.0)
        return memory, joint._replace(sensor=scaled(joint.sensor, 1.0 / np.sqrt(W)))

    return hook


class Estimated(NamedTuple):
    """Memory of `sage_husa`: variances of the noise ``(..., m)`` as estimated, and how many epochs they come from."""

    noise: Array
    epochs: Array


def sage_husa(forgetting: float = 0.95, least: float = 0.25, smallest: float = 0.01) -> Hook:
    """Estimate the noise's variances from innovations with fading memory [Sage & Husa 1969].

    ``R_k+1 = (1 - d) R_k + d max(e^2 - S0, smallest R)`` with ``d = (1 - b) / (1 - b^(k+1))``; what is used is not below
    ``least R``, so it may lie below the nominal noise. A component that is not measured keeps its estimate.

    Parameters
    ----------
    forgetting: b, in (0, 1). least, smallest: parts of the nominal variance.

    Raises
    ------
    ValueError: for other numbers.
    """
    number("forgetting", forgetting, above=0.0, below=1.0)
    floor, bottom = number("least", least, above=0.0), number("smallest", smallest, above=0.0)

    def hook(memory: Estimated | None, joint: Joint, _epoch: Any) -> tuple[Estimated, Joint]:
        e = joint.innovation
        prior, nominal = variances(joint)
        shape = np.broadcast_shapes(e.shape, nominal.shape)
        noise, count = (np.broadcast_to(nominal, shape), np.zeros(shape)) if memory is None else memory
        used = np.broadcast_to(~np.isnan(e), shape)
        d = (1.0 - forgetting) / (1.0 - forgetting ** (count + 1.0))
        found = np.maximum(np.where(used, e, 0.0) ** 2 - prior, bottom * nominal)
        noise = np.where(used, (1.0 - d) * noise + d * found, noise)
        after = Estimated(noise, count + used)
        known = nominal > 0.0
        factor = np.sqrt(np.where(known, np.maximum(noise, floor * nominal), 1.0) / np.where(known, nominal, 1.0))
        return after, joint._replace(sensor=scaled(joint.sensor, factor))

    return hook
