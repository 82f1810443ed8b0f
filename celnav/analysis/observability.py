"""Observability of nonlinear systems, degrees of observability and nonlinearity, and sparse-grid
weights from them.

Functions map points ``(p, n)`` to values ``(p, m)``; for a batch of states, ``(p, ..., n)`` to
``(p, ..., m)``. Derivatives are computed by complex step, exact to round-off, so functions must
accept complex points. numpy's functions do, except `abs`, comparisons and `arctan2`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import Chebyshev
from numpy.typing import ArrayLike

from celnav.gaussian import checks
from celnav.gaussian.belief import symmetric
from celnav.gaussian.checks import finite, integer, number, sequence
from celnav.gaussian.linalg import Array

__all__ = [
    "hysteresis",
    "information_degree",
    "jacobian",
    "lie_gradients",
    "nonlinearity_degree",
    "nonlinearity_weights",
    "observability_matrix",
    "state_singular_values",
    "threshold_weights",
]

Function = Callable[[Array], Array]

_TINY = 1e-30j  # the step, along each axis
_NODES = 21


def jacobian(function: Function, x: ArrayLike) -> Array:
    """Jacobian ``(..., m, n)`` of a function at ``x (..., n)`` by complex step [Squire1998];
    ValueError if its values have another shape.

    >>> celnav.analysis.observability.jacobian(lambda x: np.sin(x), [0.0, 0.0])
    array([[1., 0.],
           [0., 1.]])
    """
    checks.function("function", function, "(points)")
    at = finite("x", x, (..., "n"))
    return _slopes("function", function, at + _TINY * _axes(at))


def _axes(x: Array) -> Array:
    """Unit vectors ``(n, ..., n)`` along the axes of states ``(..., n)``, the axis first."""
    return np.moveaxis(np.broadcast_to(np.eye(x.shape[-1]), (*x.shape, x.shape[-1])), -2, 0)


def _slopes(name: str, function: Function, points: Array) -> Array:
    """Derivatives ``(..., m, p)`` of a function along complex points ``(p, ..., n)``."""
    values = function(points)
    if np.asarray(values).dtype.kind not in "iufc":
        raise ValueError(
            f"{name}: expected values (p, ..., m) at points (p, ..., n), got "
            f"{checks.describe(values)}"
        )
    return np.moveaxis(finite(name, np.imag(values), (*points.shape[:-1], "m")), 0, -1) / _TINY.imag


def lie_gradients(
    f: Function, h: Function, x: ArrayLike, order: int, *, window: float = 1.0
) -> Array:
    """Gradients of the Lie derivatives ``L_f^k h``, k = 0 to ``order`` (at most 6),
    ``(order + 1, m, n)`` [Hermann1977].

    ``L_f^k h`` is the k-th time derivative of ``h`` along the flow of ``f``. The function computes
    the gradient of ``h`` with respect to the initial state at Chebyshev nodes of
    ``[-window, window]`` s, and differentiates a polynomial through these. The system is observable
    at ``x`` if all rows together have rank n. At an equilibrium the gradients are ``H A^k``.

    f: time derivative of the state, independent of time. h: measurement. x: ``(n,)``.
    window: s; flow and measurement must be smooth over twice this time. The round-off of a k-th
        derivative grows as ``window^-k``.

    >>> f, h = lambda x: x @ A.T, lambda x: x[..., :1]
    >>> rows = celnav.analysis.observability.lie_gradients(f, h, [0.0, 1.0], order=1)
    >>> bool(np.linalg.matrix_rank(rows.reshape(-1, 2)) == 2)  # observable
    True
    """
    order, window = integer("order", order, 0, 6), number("window", window, above=0.0)
    at = finite("x", x, ("n",))
    rate = np.shape(checks.function("f", f, "(points)")(at[None]))
    if rate != (1, len(at)):
        raise ValueError(
            f"f: expected rates (p, {len(at)}) at points (p, {len(at)}), got shape {rate} for one "
            "point"
        )
    checks.function("h", h, "(points)")
    # Chebyshev nodes; integration runs forward and backward from 0, each interval once.
    nodes = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    forth, back = nodes[nodes >= 0.0][::-1], nodes[nodes < 0.0]
    # One initial state per axis, displaced by the complex step: the imaginary part is the gradient.
    start = at + _TINY * np.eye(len(at))
    states = _flow(f, start, window * forth) + _flow(f, start, window * back)
    gradients = np.stack([_slopes("h", h, y) for y in states])
    series = [Chebyshev.basis(k) for k in range(_NODES)]
    basis = np.stack([s(np.concatenate([forth, back])) for s in series], -1)
    # The polynomial through the gradients at the nodes, and its derivatives at 0.
    coefficients = np.linalg.solve(basis, gradients.reshape(_NODES, -1))
    slopes = [np.array([s.deriv(k)(0.0) for s in series]) for k in range(order + 1)]
    return np.stack(
        [
            (slope @ coefficients).reshape(gradients.shape[1:]) / window**k
            for k, slope in enumerate(slopes)
        ]
    )


def _flow(f: Function, x: Array, times: Array) -> list[Array]:
    """States at ``times``, ordered by distance from 0; Runge-Kutta steps are so short that their
    error is near round-off.
    """
    out, now = [], 0.0
    longest = np.abs(times[-1]) / 300.0
    for t in times:
        parts = max(1, int(np.ceil(abs(t - now) / longest)))
        dt = (t - now) / parts
        for _ in range(parts if dt else 0):
            k1 = f(x)
            k2 = f(x + 0.5 * dt * k1)
            k3 = f(x + 0.5 * dt * k2)
            k4 = f(x + dt * k3)
            x = x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        out.append(x)
        now = t
    return out


def information_degree(P0: ArrayLike, F: ArrayLike, H: ArrayLike, R: ArrayLike) -> Array:
    """Ratio ``(n,)`` of prior to posterior standard deviation over a window of K epochs without
    process noise; 1 means unobserved.

    P0: ``(n, n)``. F: ``(K - 1, n, n)``, transitions between the epochs. H: ``(K, m, n)``.
    R: ``(m, m)`` or ``(K, m, m)``.

    >>> Fs, Hs = np.tile(F, (9, 1, 1)), np.tile(H, (10, 1, 1))
    >>> degree = celnav.analysis.observability.information_degree(P0, Fs, Hs, R)
    """
    rows = finite("H", H, ("K", "m", "n"))
    K, m, n = rows.shape
    prior, transitions = symmetric(P0, "P0", n)[1], finite("F", F, (K - 1, n, n))
    noise = symmetric(R, "R", m)[1]
    if noise.shape[:-2] not in ((), (K,)):
        raise ValueError(
            f"R: expected one matrix, or one for each of {K} epochs, got shape {np.shape(R)}"
        )
    Phi, information = prior, np.eye(n)  # in units of the prior
    for k, (row, root) in enumerate(zip(rows, np.broadcast_to(noise, (K, m, m)), strict=True)):
        if k:
            Phi = transitions[k - 1] @ Phi
        # Rows in units of the noise and of the prior: their squares add up to the information.
        white = np.linalg.solve(root, row @ Phi)
        information = information + white.T @ white
    posterior = prior @ np.linalg.solve(information, prior.T)
    return np.asarray(np.sqrt(np.square(prior).sum(-1) / posterior.diagonal()))


def nonlinearity_weights(
    functions: Sequence[Function],
    mean: ArrayLike,
    std: ArrayLike,
    *,
    tolerance: float = 1e-6,
    coarse: int = 2,
) -> tuple[int, ...]:
    """Sparse-grid weights, a tuple of n integers: 1 for states in which the functions are
    nonlinear, ``coarse`` for the others.

    A state is nonlinear if the second difference of an output over one standard deviation exceeds
    ``tolerance`` times the norm of the output's first differences. A state that only multiplies
    nonlinear states is not: given these, the functions are linear in it.

    functions: functions of real points, such as the dynamics and the measurement.
    mean, std: ``(n,)``, of the belief.

    >>> rule = celnav.smolyak(6, 3, nonlinearity_weights([step, measure], prior.mean, prior.std))
    """
    center = finite("mean", mean, ("n",))
    sigma = _positive("std", std, center.shape)
    tolerance, coarse = number("tolerance", tolerance, 0.0), integer("coarse", coarse)
    functions, steps = sequence("functions", functions, "[f, h]", least=1), np.diag(sigma)
    # Test four random points: a function may be nonlinear only in part of the region.
    centers = center + sigma * np.random.default_rng(0).uniform(-1.0, 1.0, (4, len(center)))
    bends = np.zeros(len(center), bool)
    for function in functions:
        checks.function("functions", function, "(points)")
        for c in centers:
            y0, up, down = (
                finite("functions", function(x), (len(x), "m"))
                for x in (c[None], c + steps, c - steps)
            )
            scale = np.sqrt(np.square(0.5 * (up - down)).sum(0))
            second = np.abs(0.5 * (up + down) - y0)
            bends |= (second > tolerance * scale).any(-1)
    return tuple(np.where(bends, 1, coarse).tolist())


def nonlinearity_degree(
    function: Function, mean: ArrayLike, std: ArrayLike, scale: ArrayLike
) -> Array:
    """Degrees of nonlinearity ``(..., n)``: for each state, the largest second difference of the
    outputs over one standard deviation, relative to ``scale``.

    Unlike `nonlinearity_weights` it is relative to a scale: a second difference below the
    measurement noise needs no points, however nonlinear the function is.

    mean, std: ``(..., n)``, of the beliefs.
    scale: ``(..., m)``, such as the standard deviations of the measurement noise.

    >>> mean, sigma = [1.0, 1.0], [0.1, 1.0]
    >>> celnav.analysis.observability.nonlinearity_degree(lambda x: x**2, mean, sigma, [0.1, 0.1])
    array([ 0.1, 10. ])
    """
    checks.function("function", function, "(points)")
    center = finite("mean", mean, (..., "n"))
    steps = _positive("std", std, center.shape) * _axes(center)
    y0, up, down = (
        finite("function", function(x), (*x.shape[:-1], "m"))
        for x in (center[None], center + steps, center - steps)
    )
    bends = np.abs(0.5 * (up + down) - y0) / _positive("scale", scale, (..., y0.shape[-1]))
    return np.moveaxis(bends.max(-1), 0, -1)


def _positive(name: str, value: ArrayLike, shape: tuple[Any, ...]) -> Array:
    values = finite(name, value, shape)
    if (values <= 0.0).any():
        raise ValueError(f"{name}: expected positive numbers, got {value!r:.80}")
    return values


def observability_matrix(A: ArrayLike, H: ArrayLike, order: int) -> Array:
    """Observability matrix ``(..., (order + 1) m, n)`` of a linear system: ``H A^k`` for k = 0 to
    ``order``, stacked.

    Along a track, each segment has its own matrix, linearized with `jacobian`. The stacked matrices
    of all segments so far form the stripped observability matrix, which omits the transitions
    between segments [Goshen1992].

    A: ``(..., n, n)``, 1/s. H: ``(..., m, n)``.

    >>> celnav.analysis.observability.observability_matrix(A, [[1.0, 0.0]], order=1)
    array([[1., 0.],
           [0., 1.]])
    """
    rows = [finite("H", H, (..., "m", "n"))]
    rate = finite("A", A, (..., rows[0].shape[-1], rows[0].shape[-1]))
    for _ in range(integer("order", order, 0)):
        rows.append(rows[-1] @ rate)
    return np.concatenate(np.broadcast_arrays(*rows), -2)


def state_singular_values(matrix: ArrayLike, cov: ArrayLike | None = None) -> Array:
    """Singular values ``(..., n)`` of observability matrices ``(..., rows, n)``, assigned to the
    states.

    Each state gets the singular value whose right singular vector has the largest component in this
    state; 0 if the vector is unobservable. Degrees of observability are these values divided by the
    value of a reference state [Liang2014, Eq. 15]. They depend on the units of the states;
    `information_degree` does not.

    cov: ``(..., n, n)``, of the initial state. It weights each right singular vector by the initial
        standard deviation along it.

    >>> celnav.analysis.observability.state_singular_values([[2.0, 0.0], [0.0, 0.5]])
    array([2. , 0.5])
    """
    rows = finite("matrix", matrix, (..., "rows", "n"))
    n = rows.shape[-1]
    # Add rows of zeros if there are fewer rows than states.
    missing = [(0, 0)] * (rows.ndim - 2) + [(0, max(n - rows.shape[-2], 0)), (0, 0)]
    _, values, Vt = np.linalg.svd(np.pad(rows, missing), full_matrices=False)
    # Column i of Vt has the components of all right singular vectors in state i.
    size = np.abs(Vt)
    if cov is not None:
        size *= np.sqrt(np.square(Vt @ symmetric(cov, "cov", n)[1]).sum(-1))[..., None]
    observed, which = np.broadcast_arrays(
        np.where(values < 1e-12 * values[..., :1], 0.0, values), size.argmax(-2)
    )
    return np.asarray(np.take_along_axis(observed, which, -1))


def threshold_weights(degree: ArrayLike, threshold: float) -> tuple[int, ...]:
    """Sparse-grid weights from degrees of observability ``(n,)``: 1 above the threshold, 2 for the
    others [Liang2014, Eq. 19].

    >>> celnav.analysis.observability.threshold_weights([9.6, 1.0, 0.2], 5.0)
    (1, 2, 2)
    """
    return tuple(
        np.where(finite("degree", degree, ("n",)) > number("threshold", threshold), 1, 2).tolist()
    )


def hysteresis(degree: ArrayLike, threshold: float, before: ArrayLike, band: float = 1.1) -> Array:
    """Mask ``(..., n)`` of the degrees above a threshold; degrees within a factor ``band`` of it
    keep their value in ``before (..., n)``.

    >>> celnav.analysis.observability.hysteresis([9.6, 5.2, 5.2], 5.0, before=[0, 0, 1])
    array([ True, False,  True])
    """
    degrees, limit, factor = (
        finite("degree", degree, (..., "n")),
        number("threshold", threshold),
        number("band", band, 1.0),
    )
    return np.where(
        finite("before", before, (..., degrees.shape[-1])) > 0.0,
        degrees > limit / factor,
        degrees > limit * factor,
    )
