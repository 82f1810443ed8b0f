"""Hooks, which adapt what a filter believes of a measurement before it uses it: gates, windows, robust weights; and a gain.

A hook sees the `Joint` of measurement and state before the update and may replace it; hooks act one after the other, each with its
own memory, and run by run: a run in a batch gets what it would get alone. What a state correction explains of an innovation is
taken by the measurement's (statistical) Jacobian. Noise is taken to be of independent components. More hooks:
`celnav.filters.parity` (what no state explains).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.special import gammaincinv

from celnav.filters.joint import Gain, Hook, Joint
from celnav.gaussian.checks import LIMIT, choice, integer, number
from celnav.gaussian.linalg import Array, cholesky, matvec, solve_lower, solve_upper_transposed, weighted, whiten


def gate(gamma: float) -> Hook:
    """Leave out each component whose innovation exceeds ``gamma`` of its standard deviations.

    Rejected components are nan from there on, for the hooks that follow and for the update; the `Track` counts them in
    ``events["rejected"]``. A gate that is too narrow for the model's errors locks the filter out of its measurements.

    An infinite ``gamma`` leaves out nothing.

    Raises
    ------
    ValueError: unless ``gamma`` is positive.

    >>> filter = celnav.ukf(motion, sensor, hooks=[celnav.filters.adaptive.gate(4.0)])
    """
    if not np.array_equal(gamma, np.inf):
        number("gamma", gamma, above=0.0)

    def hook(memory: Any, joint: Joint, _epoch: Any) -> tuple[Any, Joint]:
        prior, noise = joint.variances()
        return memory, joint.leaving_out(np.asarray(joint.innovation) ** 2 > gamma**2 * (prior + noise))

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
        e = np.asarray(joint.innovation)
        m = e.shape[-1]
        if m not in bounds:
            bounds[m] = np.concatenate([[np.inf], 2.0 * gammaincinv(0.5 * np.arange(1, m + 1), probability)])
        used = ~np.isnan(e)
        S, V = joint.covariances()[0], joint.measurement_noise
        S = S if V is None else S + V @ V.mT
        S = np.where(used[..., :, None] & used[..., None, :], S, 0.0) + np.where(used, 0.0, 1.0)[..., None] * np.eye(m)
        white = whiten(cholesky(S), np.where(used, e, 0.0))
        beyond = np.einsum("...i,...i->...", white, white) > bounds[m][used.sum(-1)]
        return memory, joint.leaving_out(beyond[..., None])

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
        e = np.asarray(joint.innovation)
        ring = last_of(None if memory is None else memory.innovations, None if memory is None else memory.k, e, epoch, size, gaps)
        full = ~np.isnan(ring).any(0)
        if full.any():
            prior, noise = joint.variances()
            full = full & (noise > 0.0)
            C = np.where(full, ring, 0.0)
            A = ((C * C).mean(0) - prior) / np.where(full, noise, 1.0)
            joint = joint.inflated(np.sqrt(np.where(full, np.maximum(1.0, A), 1.0)))
        return Window(ring, getattr(epoch, "k", None)), joint

    return hook


def last_of(ring: Array | None, before: Any, values: Array, epoch: Any, size: int, gaps: str = "restart") -> Array:
    """The last values ``(size, ..., m)`` of a window that moves on, nan before there were any."""
    if ring is None:
        if size * values.size > LIMIT:
            raise ValueError(f"M: expected a window of at most {LIMIT} numbers, got {size} samples of {values.size} each")
        ring = np.full((size, *values.shape), np.nan)
    ring = np.broadcast_to(ring, (size, *np.broadcast_shapes(ring.shape[1:], values.shape)))
    moved = np.concatenate([ring[1:], np.broadcast_to(values, ring.shape[1:])[None]])
    if gaps == "skip":
        return np.where(np.isnan(values), ring, moved)
    k = getattr(epoch, "k", None)
    # A hook is not called where the whole block has no measurement: that is a gap of every component as well.
    if k is not None and before is not None and k > before + 1:
        moved[:-1] = np.nan
    return moved


# -- robust weights ------------------------------------------------------------------------------------------------------
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
    most = integer("rounds", rounds, 1, 10_000)

    def hook(memory: Any, joint: Joint, _epoch: Any) -> tuple[Any, Joint]:
        assert joint.measurement is not None
        e = np.asarray(joint.innovation)
        _, noise = joint.variances()
        used = ~np.isnan(e) & (noise > 0.0)
        R = np.where(used, noise, 1.0)
        S0, cross = joint.covariances()
        explained = joint.measurement.jacobian() @ cross
        both = used[..., :, None] & used[..., None, :]
        S0, explained, y = np.where(both, S0, 0.0), np.where(used[..., None], explained, 0.0), np.where(used, e, 0.0)
        W = np.ones_like(R)
        for _ in range(most):
            S = S0 + (R / W)[..., None] * np.eye(e.shape[-1])
            fitted = matvec(explained, np.linalg.solve(S, y[..., None])[..., 0])
            W = np.where(used, weight(np.abs(y - fitted) / np.sqrt(R)), 1.0)
        return memory, joint.inflated(1.0 / np.sqrt(W))

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
        e = np.asarray(joint.innovation)
        prior, nominal = joint.variances()
        shape = np.broadcast_shapes(e.shape, nominal.shape)
        noise, count = (np.broadcast_to(nominal, shape), np.zeros(shape)) if memory is None else memory
        used = np.broadcast_to(~np.isnan(e), shape)
        d = (1.0 - forgetting) / (1.0 - forgetting ** (count + 1.0))
        seen = np.maximum(np.where(used, e, 0.0) ** 2 - prior, bottom * nominal)
        noise = np.where(used, (1.0 - d) * noise + d * seen, noise)
        noisy = nominal > 0.0
        factor = np.sqrt(np.where(noisy, np.maximum(noise, floor * nominal), 1.0) / np.where(noisy, nominal, 1.0))
        return Estimated(noise, count + used), joint.inflated(factor)

    return hook


# -- a gain --------------------------------------------------------------------------------------------------------------
def consider(n: int, k: int) -> Gain:
    """Schmidt's gain: optimal for the first ``n`` states, 0 for the ``k`` considered ones after them.

    Considered states (biases, constants of a model) are not estimated, but their uncertainty, and what the others owe to
    them, is carried along exactly. A fixed gain needs no function: with ``gain=K (n, m)`` a filter has the covariance that goes
    with K, whatever it is.

    Raises
    ------
    ValueError: unless ``n > 0`` and ``k >= 0`` are integers; at the update, if they do not add up to the state.

    >>> filter = celnav.ukf(motion, sensor, gain=consider(6, 3))
    >>> steady = celnav.ukf(motion, sensor, gain=np.array([[0.4], [0.1]]))  # an alpha-beta filter that knows its own errors
    """
    integer("n", n), integer("k", k, 0)

    def gain(A: Array, sign: Array, m: int) -> Array:
        if A.shape[-2] - m != n + k:
            raise ValueError(f"consider: expected a state of {n} + {k} components, got {A.shape[-2] - m}")
        C = weighted(A[..., : m + n, :], sign) @ A[..., :m, :].mT
        S = cholesky(C[..., :m, :])
        K = solve_upper_transposed(S, solve_lower(S, C[..., m:, :].mT)).mT
        return np.concatenate([K, np.zeros((*K.shape[:-2], k, m))], -2)

    return gain
