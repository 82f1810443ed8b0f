"""Adaptation as parts: hooks that gate or inflate, prescribed gains, and a second rule for what the first loses.

A hook sees the joint of measurement and state before the update and may replace it (`celnav.filters.info.Hook`); hooks act
one after the other, each with its own memory, and run by run: a run in a batch gets what it would get alone. A gain leaves
the joint alone and says what to do with the innovation (`celnav.filters.info.Gain`). More hooks: `celnav.filters.robust` (one
measurement at a time), `celnav.filters.parity` (what no state explains).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaincinv

from celnav.filters.arguments import check_belief, check_part, positive, window
from celnav.filters.info import Gain, Hook, Info, Joint
from celnav.filters.step import Conditioning, Motion
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import choice, integer, kind, number
from celnav.gaussian.linalg import Array, cholesky, solve_lower, solve_upper_transposed, whiten


def _signs(sign: Array, q: int) -> Array:
    """Signs of all ``q`` columns; those beyond ``sign`` count with +1."""
    return np.concatenate([sign, np.ones(q - len(sign))])


def counted(joint: Joint) -> Array:
    """Columns ``(..., m + n, q + r)`` without those of the measurement noise, each times its sign."""
    D = joint.columns * _signs(joint.sign, joint.columns.shape[-1])
    batch = np.broadcast_shapes(D.shape[:-1], joint.process.shape[:-1])
    return np.concatenate([np.broadcast_to(part, (*batch, part.shape[-1])) for part in (D, joint.process)], -1)


def variances(joint: Joint) -> tuple[Array, Array]:
    """Variances ``(..., m)`` of the innovation: without the measurement noise, and those of that noise."""
    m = joint.innovation.shape[-1]
    D, W, N = (part[..., :m, :] for part in (joint.columns, joint.process, joint.sensor))
    prior = np.einsum("...ij,...ij,j->...i", D, D, _signs(joint.sign, D.shape[-1])) + np.einsum("...ij,...ij->...i", W, W)
    return prior, np.einsum("...ij,...ij->...i", N, N)


def gate(gamma: float) -> Hook:
    """Leave out each component whose innovation exceeds ``gamma`` of its standard deviations.

    Rejected components are nan from there on, for the hooks that follow and for the update; the `Track` counts them in
    ``events["rejected"]``. A gate that is too narrow for the model's errors locks the filter out of its measurements.

    Raises
    ------
    ValueError: unless ``gamma`` is positive.
    """
    positive("gamma", gamma)

    def hook(memory: Any, joint: Joint, _epoch: Any) -> tuple[Any, Joint]:
        prior, noise = variances(joint)
        beyond = joint.innovation**2 > gamma**2 * (prior + noise)
        return memory, joint._replace(innovation=np.where(beyond, np.nan, joint.innovation))

    return hook


def chi_square_gate(probability: float = 0.999) -> Hook:
    """Leave out the whole measurement of a run whose normalized innovation squared is improbably large.

    ``probability`` is that of keeping a measurement which the model describes: the bound is the chi-square quantile with as
    many degrees of freedom as the run has measured components.

    Raises
    ------
    ValueError: unless ``0 < probability < 1``.
    """
    number("probability", probability, above=0.0, below=1.0)
    bounds: dict[int, Array] = {}

    def hook(memory: Any, joint: Joint, _epoch: Any) -> tuple[Any, Joint]:
        e = joint.innovation
        m = e.shape[-1]
        if m not in bounds:
            bounds[m] = np.concatenate([[np.inf], 2.0 * gammaincinv(0.5 * np.arange(1, m + 1), probability)])
        A = np.concatenate([joint.columns, joint.process, joint.sensor], -1)[..., :m, :]
        used = ~np.isnan(e)
        A = A * used[..., None]
        S = (A * _signs(joint.sign, A.shape[-1])) @ A.mT + np.where(used, 0.0, 1.0)[..., None] * np.eye(m)
        white = whiten(cholesky(S), np.where(used, e, 0.0))
        beyond = np.einsum("...i,...i->...", white, white) > bounds[m][used.sum(-1)]
        return memory, joint._replace(innovation=np.where(beyond[..., None], np.nan, e))

    return hook


class Window(NamedTuple):
    """Memory of `innovation_window`: the last innovations ``(M, ..., m)``, nan before there were any, and when."""

    innovations: Array
    k: Any


def innovation_window(M: int, gaps: str = "restart") -> Hook:
    """Inflate the measurement noise of each component to what its last ``M`` innovations show.

    With ``C`` the mean square of the last M innovations (the present one included), ``S0`` the innovation's variance without
    measurement noise and ``R`` that noise's variance, ``C = S0 + A R`` gives ``A = max(1, (C - S0) / R)``; the noise becomes
    ``A^1/2 R A^1/2``. A component has ``A = 1`` until it has M samples. Innovations enter as they come, before any
    inflation. The noise is only ever inflated, and a maneuver inflates it too: it needs a process noise that covers those.

    Parameters
    ----------
    M: length of the window.
    gaps: "restart": the samples must be of consecutive epochs, a missing one restarts its component's window. "skip": the
        last M there were, for sensors that are slower than the epochs.

    Raises
    ------
    ValueError: unless ``M`` is a positive integer and ``gaps`` one of the two.
    """
    size = integer("M", M)
    choice("gaps", gaps, ("restart", "skip"))

    def hook(memory: Window | None, joint: Joint, epoch: Any) -> tuple[Window, Joint]:
        e, k = joint.innovation, getattr(epoch, "k", None)
        ring = window("M", size, e.shape) if memory is None else memory.innovations
        if ring.shape[1:] != e.shape:
            ring = np.broadcast_to(ring, (size, *e.shape))
        if gaps == "restart":
            # An update is not called where the whole block has no measurement: that is a gap of every component as well.
            if memory is not None and k is not None and memory.k is not None and k > memory.k + 1:
                ring = np.full_like(ring, np.nan)
            ring = np.concatenate([ring[1:], e[None]])
        else:
            ring = np.where(np.isnan(e), ring, np.concatenate([ring[1:], e[None]]))
        full = ~np.isnan(ring).any(0)
        if full.any():
            prior, noise = variances(joint)
            full = full & (noise > 0.0)
            C = np.where(full, ring, 0.0)
            A = ((C * C).mean(0) - prior) / np.where(full, noise, 1.0)
            factor = np.sqrt(np.where(full, np.maximum(1.0, A), 1.0))
            joint = joint._replace(sensor=scaled(joint.sensor, factor))
        return Window(ring, k), joint

    return hook


def scaled(sensor: Array, factor: Array) -> Array:
    """Measurement noise columns ``(..., m + n, s)`` with their first m rows scaled by ``factor (..., m)``."""
    m = factor.shape[-1]
    batch = np.broadcast_shapes(sensor.shape[:-2], factor.shape[:-1])
    scaled = np.array(np.broadcast_to(sensor, (*batch, *sensor.shape[-2:])))
    scaled[..., :m, :] *= factor[..., None]
    return scaled


def consider(n: int, k: int) -> Gain:
    """Schmidt's gain: optimal for the first ``n`` states, 0 for the ``k`` considered ones after them.

    Considered states (biases, constants of a model) are not estimated, but their uncertainty, and what the others owe to
    them, is carried along exactly. A fixed gain needs no function: ``update(h, rule, R, gain=K)`` with ``K (n, m)`` gives the
    covariance of a filter that uses K, whatever it is::

        part = update(h, rule, R, gain=consider(6, 3))
        steady = update(h, rule, R, gain=np.array([[0.4], [0.1]]))  # an alpha-beta filter that knows its own errors

    Raises
    ------
    ValueError: unless ``n > 0`` and ``k >= 0`` are integers; at the update, if they do not add up to the state.
    """
    for name, value, least in (("n", n, 1), ("k", k, 0)):
        integer(name, value, least)

    def gain(A: Array, sign: Array, m: int) -> Array:
        if A.shape[-2] - m != n + k:
            raise ValueError(f"consider: expected a state of {n} + {k} components, got {A.shape[-2] - m}")
        C = (A[..., : m + n, :] * _signs(sign, A.shape[-1])) @ A[..., :m, :].mT
        S = cholesky(C[..., :m, :])
        K = solve_upper_transposed(S, solve_lower(S, C[..., m:, :].mT)).mT
        return np.concatenate([K, np.zeros((*K.shape[:-2], k, m))], -2)

    return gain


def fallback(first: Callable[..., Any], second: Callable[..., Any]) -> Callable[..., Any]:
    """A predict or update part that does again, with the second, those runs which the first loses.

    Parameters
    ----------
    first, second: two predict parts, or two update parts, of the same model with different rules: one of negative weights,
        say, and one without. Hooks, if any, must be the same; their memory is that of the first.

    Returns
    -------
    A part of the same kind. The runs of the block that the first does not lose keep its result bit for bit. ``Info.redone``
    says which were done again, and the `Track` counts them in ``events["redone"]``. A run that both lose stays lost.
    """

    for name, given in (("first", first), ("second", second)):
        check_part(name, given, (2, 4))
    if isinstance(first, Conditioning) != isinstance(second, Conditioning) and isinstance(second, Conditioning | Motion):
        raise ValueError(f"second: expected a part like the first, got {kind(first)} and {kind(second)}")

    def part(belief: Gaussian, *arguments: Any, **named: Any) -> Any:
        check_belief(belief)
        after, info, *memory = first(belief, *arguments, **named)
        kept = _sound(after)
        if kept.all():
            return after, info, *memory
        lost = _sound(belief) & ~kept
        if not lost.any():
            return after, info, *memory
        again, other, *_ = second(belief, *arguments, **named)
        merged = Gaussian(_pick(lost, again.mean, after.mean, 1), _pick(lost, again.spread, after.spread, 2), after.form)
        gone = (lost & ~_sound(merged)).any()
        failure = " and, done again, ".join(dict.fromkeys(f for f in (info.failure, other.failure) if f)) if gone else ""
        return merged, _merged(lost, info, other)._replace(failure=failure, redone=lost), *memory

    return part


def _sound(belief: Gaussian) -> Array:
    """Runs ``(...)`` whose belief is finite and, in covariance form too, definite."""
    root = belief.form.root(belief.spread)
    return np.asarray(np.isfinite(belief.mean).all(-1) & np.isfinite(root).all((-2, -1)))


def _pick(where: Array, chosen: Array, otherwise: Array, rank: int) -> Array:
    return np.where(where.reshape(where.shape + (1,) * rank), chosen, otherwise)


def _merged(lost: Array, info: Info, other: Info) -> Info:
    """What was done, run by run; gains and slopes are merged when asked for."""
    arrays: dict[str, Any] = {}
    for name, rank in (("innovation", 1), ("white", 1), ("used", 1), ("innovation_root", 2)):
        mine, theirs = getattr(info, name), getattr(other, name)
        if mine is not None and theirs is not None:
            arrays[name] = _pick(lost, theirs, mine, rank)
    mine, theirs = info.gain, other.gain
    if mine is not None and theirs is not None:
        arrays["gain"] = lambda: _pick(lost, theirs(), mine(), 2)

    def slopes(a: Any, b: Any) -> Any:
        if a is None or b is None:
            return a
        return lambda: tuple(_pick(lost, y, x, 2) for x, y in zip(a(), b(), strict=True))

    return info._replace(**arrays, slopes=tuple(slopes(a, b) for a, b in zip(info.slopes, other.slopes, strict=True)))
