"""Hooks that inflate measurement noise by what no error of the state can explain: the innovation less its least-squares fit.

A maneuver, or any other error of the prediction, lies in the range of the measurement matrix and leaves such a residual alone;
it takes more measurements than unknowns. The matrix is that of statistical linearization (see `celnav.filters.adaptive`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.adaptive import last_of
from celnav.filters.joint import Hook, Joint
from celnav.gaussian.checks import finite, integer, number
from celnav.gaussian.linalg import Array, matvec, range_basis

NOTHING = 1e-6
"""Deviations of the noise."""


class Residual(NamedTuple):
    """Residuals ``(..., m)`` of the fit (0 where not measured), their variances, the noise's, and which were measured."""

    values: Array
    variances: Array
    noise: Array
    used: Array


def residual(joint: Joint) -> Residual:
    """The part of an innovation that no state error explains, by weighted least squares over all states.

    A direction in which a deviation of the prior moves the measurement by less than a millionth of its noise explains nothing.
    """
    assert joint.measurement is not None
    e = np.asarray(joint.innovation)
    _, noise = joint.variances()
    used = ~np.isnan(e) & (noise > 0.0)
    root = np.where(used, np.sqrt(np.where(noise > 0.0, 1.0 / np.where(noise > 0.0, noise, 1.0), 0.0)), 0.0)
    D = joint.state.columns
    variance = np.einsum("...ij,...ij,j->...i", D, D, np.broadcast_to(joint.sign, D.shape[-1:]))
    if joint.process_noise is not None:
        variance = variance + np.square(joint.process_noise[1]).sum(-1)
    std = np.sqrt(np.maximum(variance, 0.0))
    Q = range_basis(root[..., None] * joint.measurement.jacobian() * std[..., None, :], NOTHING)
    y = root * np.where(used, e, 0.0)
    left = y - matvec(Q, matvec(Q.mT, y))
    share = np.maximum(1.0 - np.square(Q).sum(-1), 0.0)
    return Residual(left * np.sqrt(np.where(used, noise, 0.0)), np.where(used, share * noise, 0.0), noise, used)


def group_parity(groups: Sequence[ArrayLike], unknowns: int, *, deviations: float = 3.0) -> Hook:
    """Inflate the noise of a whole group of components to what the group's residuals show, at once and without a window.

    ``s = sum r^2 / R / (N - unknowns)`` over the N measured components of a group; its noise is inflated by s where that exceeds
    ``1 + deviations sqrt(2 / (N - unknowns))``. Groups with fewer than ``unknowns + 2`` measured components are left alone.

    Parameters
    ----------
    groups: index arrays of the components, such as ranges and rates. unknowns: that a group determines.

    Raises
    ------
    ValueError: for groups that are empty or overlap, or numbers that cannot be.
    """
    if not isinstance(groups, Iterable):
        raise ValueError(f"groups: expected index arrays of components, such as [[0, 1], [2, 3]], got {groups!r:.80}")
    members = [_places(group) for group in groups]
    together = np.concatenate(members) if members else np.empty(0, int)
    if not together.size or any(not g.size for g in members) or len(set(together.tolist())) != together.size:
        raise ValueError("groups: expected groups of components that do not overlap")
    unknowns = min(integer("unknowns", unknowns), 10**9)  # no group is as large
    number("deviations", deviations, 0.0)

    def hook(memory: Any, joint: Joint, _epoch: Any) -> tuple[Any, Joint]:
        r = residual(joint)
        if together.max() >= r.values.shape[-1]:
            raise ValueError(f"groups: expected components below {r.values.shape[-1]}, got {together.max()}")
        factor = np.ones(r.values.shape)
        squares = np.where(r.used, r.values**2 / np.where(r.used, r.noise, 1.0), 0.0)
        for group in members:
            spare = r.used[..., group].sum(-1) - unknowns
            enough = spare >= 2
            s = squares[..., group].sum(-1) / np.where(enough, spare, 1)
            bound = 1.0 + deviations * np.sqrt(2.0 / np.where(enough, spare, 1))
            factor[..., group] = np.where(enough & (s > bound), s, 1.0)[..., None]
        return memory, joint.inflated(np.sqrt(factor))

    return hook


def _places(group: ArrayLike) -> Array:
    """Components of a group, whole numbers from 0 on."""
    places = finite("groups", group)
    if places.ndim != 1 or (places != np.round(places)).any() or (places < 0.0).any():
        raise ValueError(f"groups: expected places of components from 0 on, such as [[0, 1], [2, 3]], got {group!r:.80}")
    return places.astype(int)


class ParityWindow(NamedTuple):
    """Memory of `channel_parity`: the last normalized squares ``(M, ..., m)``, nan before there were any, and when."""

    squares: Array
    k: Any


def channel_parity(M: int) -> Hook:
    """Inflate the noise of each component to what its last ``M`` residuals show, in their own deviations: ``max(1, mean r^2 / C)``.

    A component has factor 1 until it has M samples of consecutive epochs.

    Raises
    ------
    ValueError: unless ``M`` is a positive integer.
    """
    size = integer("M", M)

    def hook(memory: ParityWindow | None, joint: Joint, epoch: Any) -> tuple[ParityWindow, Joint]:
        r, k = residual(joint), getattr(epoch, "k", None)
        spare = r.used & (r.variances > 1e-6 * r.noise)  # a component that the fit cannot do without has no residual
        squares = np.where(spare, r.values**2 / np.where(spare, r.variances, 1.0), np.nan)
        ring = last_of(None if memory is None else memory.squares, None if memory is None else memory.k, squares, epoch, size)
        full = ~np.isnan(ring).any(0)
        factor = np.where(full, np.maximum(1.0, np.where(full, ring, 0.0).mean(0)), 1.0)
        return ParityWindow(ring, k), joint.inflated(np.sqrt(factor))

    return hook
