"""Independent fixes at all epochs: position and clock from ranges, velocity and drift from rates,
without faulty measurements.

The module also estimates the noise from the residuals of the fixes. With several satellite systems
a fix includes the offsets of their clocks. A single range of a system contributes nothing to the
position and cannot be tested, so it is not used. The first axis is the epoch ``T``, the next the
satellite ``S``. In tuples and axes, ranges have index 0 and rates index 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array, outer
from celnav.models import pseudorange
from celnav.models.gnss import B1I_HZ, LIGHT
from celnav.receiver.integrity import Monitored, misfit, monitored, noise_components
from celnav.receiver.least_squares import gauss_newton
from celnav.receiver.sky import GROUND_M

LEAST_ELEVATION = np.radians(1.0)
"""Below this elevation, rad, delays and standard deviations are constant."""
GIVEN = (1.5, 0.05)
"""Standard deviations at the zenith, m and m/s, before they are estimated."""
RESOLUTION = (1e-3, 1e-3 * LIGHT / B1I_HZ)
"""Resolution of a file, m and m/s: smaller noise cannot be observed."""
QUIETEST, LOUDEST = 0.25, 8.0
"""Least and largest noise as multiples of `GIVEN`. The estimate starts at the least, because large
noise would hide faults. Noise above the largest is not credible for a receiver: the measurements
then contradict each other.
"""
ENOUGH = 100
"""Least number of redundant measurements for an estimate of the noise."""
MOST_EPOCHS = 1000
"""Most epochs that an estimate uses, evenly spread: more would change little."""


class Noise(NamedTuple):
    """Noise of ranges or of rates by system. Its variance is
    ``level^2 + (zenith / sin(elevation))^2``.

    level, zenith: m or m/s, for the systems of a log in their order; the last value applies to all
        further systems.
    redundancy: number of redundant measurements in the estimate; 0: the values were given, or there
        were too few measurements.
    """

    level: tuple[float, ...]
    zenith: tuple[float, ...]
    redundancy: int = 0

    def variance(self, elevation: Array, system: Array) -> Array:
        """Variance at elevations, rad, of satellites; ``system`` is the index of a satellite's
        system.
        """
        level, zenith = (
            np.array(values)[np.minimum(system, len(values) - 1)]
            for values in (self.level, self.zenith)
        )
        up = np.sin(np.maximum(elevation, LEAST_ELEVATION))
        return np.asarray(np.square(level) + np.square(zenith / up))


class Seen(NamedTuple):
    """Measurements ``z (T, 2 S)``, nan where missing, of satellites ``q, w, elevation`` from near
    ``position (T, 3)``.

    modeled: ``(T, S)``, variance of ranges (m^2) from atmosphere and orbits, in addition to the
        receiver's noise. offsets: ``(k, S)``, clock offsets as in `celnav.models.pseudorange`.
    """

    z: Array
    q: Array
    w: Array
    elevation: Array
    position: Array
    modeled: Array
    offsets: Array

    @property
    def system(self) -> Array:
        """Index of each satellite's system ``(..., S)``, from 0."""
        k = self.offsets.shape[-2]
        return np.asarray(np.arange(1, k + 1) @ self.offsets, dtype=int)

    def deviations(self, noise: tuple[Noise, Noise]) -> Array:
        """Standard deviations ``(T, 2 S)`` of ranges and rates."""
        ranges, rates = (kind.variance(self.elevation, self.system) for kind in noise)
        return np.asarray(np.sqrt(np.concatenate([ranges + self.modeled, rates], -1)))


class Fixed(NamedTuple):
    """Fixes of all epochs; states, variances and covariances are nan where there is no fix.

    states, variances: ``(T, 8 + k)``; the variances from the receiver's noise alone.
    cov: ``(T, 3, 3)`` m^2, of positions. sigma: ``(T, 2 S)``, standard deviations of the
        measurements.
    kinds: which ranges and rates are kept. misfit: ``(T,)``, sum of squared range residuals over
        their variances, nan without a fix.
    residuals: of ranges and of rates ``(T, S)``, in standard deviations, nan at epochs without
        redundancy and for measurements that are not kept; and the number of redundant measurements.
    """

    states: Array
    variances: Array
    cov: Array
    sigma: Array
    kinds: tuple[Monitored, Monitored]
    misfit: Array
    residuals: tuple[tuple[Array, int], tuple[Array, int]]

    def measurements(self, what: str) -> Array:
        """Whether ranges and rates ``(T, 2 S)`` are ``what``: "kept" or "excluded"."""
        return np.concatenate([getattr(kind, what) for kind in self.kinds], -1)


def fixed(seen: Seen, noise: tuple[Noise, Noise], false_alarm: float) -> Fixed:
    """Fixes at all epochs; the rate of a satellite with a faulty range is not used either."""
    packed, order = _packed(seen)
    fits = _fits(packed, noise, false_alarm)
    sigma, (T, S) = seen.deviations(noise), seen.elevation.shape
    kinds, shares, residuals, n = [], [], [], order.shape[-1]
    for fit in fits:
        kept, excluded = np.zeros((2, T, S), bool)
        np.put_along_axis(kept, order, fit.kind.kept[:, :n], -1)
        np.put_along_axis(excluded, order, fit.kind.excluded[:, :n], -1)
        kinds.append(fit.kind._replace(kept=kept, excluded=excluded))
        left = np.zeros((T, S))
        np.put_along_axis(left, order, fit.left[:, :n], -1)
        # Without a fix the residuals have no meaning, and without redundancy they are zero.
        left = np.where(kept & (fit.spare > 0)[:, None], left, np.nan)
        shares.append(_white_share(left, fit.x.shape[-1]))
        residuals.append((left, int(fit.spare.sum())))
    ranges, rates = fits
    # Without measurements of the first system no offset from its clock can be determined.
    first = (ranges.kind.kept[:, :n] & (packed.system == 0)).any(-1, keepdims=True)
    apart = np.where(first & ~ranges.kind.kept[:, n:], ranges.x[:, 4:], np.nan)
    states = _states(np.concatenate([ranges.x[:, :4], apart], -1), rates.x)
    variances = _states(
        *(share * fit.cov.diagonal(0, -2, -1) for share, fit in zip(shares, fits, strict=True))
    )
    squares = np.where(np.isfinite(states[:, 6]), misfit(ranges.left, ranges.kind.kept), np.nan)
    return Fixed(
        states,
        variances,
        ranges.cov[:, :3, :3],
        sigma,
        (kinds[0], kinds[1]),
        squares,
        (residuals[0], residuals[1]),
    )


def _white_share(left: Array, unknowns: int) -> float:
    """The share of the measurements' variances that is uncorrelated from epoch to epoch.

    left: residuals ``(T, S)`` in standard deviations, nan where missing. Errors of atmosphere and
        orbits hardly change from one epoch to the next. So half the mean squared difference is the
        variance of the receiver's noise alone.
    """
    changes = left[1:] - left[:-1]
    both = np.isfinite(changes)
    spare = both.sum(-1) - unknowns
    changes = np.where(both & (spare > 0)[:, None], changes, 0.0)
    redundancy = spare[spare > 0].sum()
    return float(0.5 * np.square(changes).sum() / redundancy) if redundancy else 1.0


def _states(ranges: Array, rates: Array) -> Array:
    """States from the components that ranges and rates determine, each ``(..., 4 or more)``."""
    return np.concatenate(
        [ranges[..., :3], rates[..., :3], ranges[..., 3:4], rates[..., 3:], ranges[..., 4:]], -1
    )


def _packed(seen: Seen) -> tuple[Seen, Array]:
    """Measurements in ``n`` columns, the largest number at any epoch, and the indices ``(T, n)`` of
    their satellites. The offsets become ``(T, k, n)``.
    """
    S = seen.elevation.shape[-1]
    ranges, rates = seen.z[:, :S], seen.z[:, S:]
    there = np.isfinite(ranges) | np.isfinite(rates)
    n = int(there.sum(-1).max(initial=0))
    order = np.argsort(~there, axis=-1, kind="stable")[:, :n]

    def pick(values: Array) -> Array:
        return np.take_along_axis(values, order.reshape(order.shape + (1,) * (values.ndim - 2)), 1)

    z = np.concatenate([pick(ranges), pick(rates)], -1)
    offsets = np.moveaxis(seen.offsets[:, order], 0, 1)
    q, w, elevation, modeled = map(pick, (seen.q, seen.w, seen.elevation, seen.modeled))
    return Seen(z, q, w, elevation, seen.position, modeled, offsets), order


class _Fit(NamedTuple):
    """Fixes ``x (T, n)`` from ranges or from rates, their covariances, and the kept measurements.

    left, G: residuals and Jacobians in standard deviations. Ranges have one more column for each
        offset: a pseudo-measurement that the offset is zero. It is kept where satellites do not
        determine the offset.
    """

    x: Array
    cov: Array
    kind: Monitored
    left: Array
    G: Array

    @property
    def spare(self) -> Array:
        """Measurements beyond what a fix needs, ``(T,)``; 0 without a fix."""
        beyond = self.kind.kept.sum(-1) - self.G.shape[-1]
        return np.where(np.isfinite(self.x[:, 0]), np.maximum(beyond, 0), 0)


def _fits(seen: Seen, noise: tuple[Noise, Noise], false_alarm: float) -> tuple[_Fit, _Fit]:
    """Fits of ranges and of rates, from `_packed` measurements."""
    n, k = seen.q.shape[-2], seen.offsets.shape[-2]
    sigma = seen.deviations(noise)
    # Without an earlier position start on the ground below the mean direction of the satellites.
    away = np.where(np.isfinite(seen.z[:, :n, None]), seen.q, 0.0).sum(-2)
    below = GROUND_M[0] * away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1.0)
    near = np.where(
        np.linalg.norm(seen.position, axis=-1, keepdims=True) > 1.0, seen.position, below
    )

    def ranges(rows: Array, x: Array) -> tuple[Array, Array]:
        # range = |q - x| + c + offsets, (K, n): G = [-(q - x)' / |q - x|, 1, offsets] in rows. The
        # last k rows are the pseudo-measurements that offsets are 0.
        away = seen.q[rows] - x[:, None, :3]
        distance = np.sqrt(np.einsum("...i,...i->...", away, away))
        clocks = np.concatenate([np.ones((len(x), n, 1)), seen.offsets[rows].mT], -1)
        values = distance + (clocks @ x[:, 3:, None])[..., 0]
        G = np.concatenate([-away / distance[..., None], clocks], -1)
        zero = np.broadcast_to(np.eye(k, 4 + k, 4), (len(x), k, 4 + k))
        return np.concatenate([values, x[:, 4:]], -1), np.concatenate([G, zero], -2)

    def on_earth(x: Array) -> Array:
        size = np.linalg.norm(x[..., :3], axis=-1, keepdims=True)
        return np.where((size > GROUND_M[0]) & (size < GROUND_M[1]), x, np.nan)

    def comparable(there: Array) -> Array:
        if not k:
            return there
        there = there[:, :n]
        for system in range(k + 1):
            members = there & (seen.system == system)
            there = there & ~(members & (members.sum(-1, keepdims=True) == 1))
        return np.concatenate([there, pseudorange.undetermined(there, seen.offsets)], -1)

    start = np.concatenate([near, np.zeros((len(near), 1 + k))], -1)
    z, deviation = (
        np.pad(v[:, :n], ((0, 0), (0, k)), constant_values=c)
        for v, c in ((seen.z, 0.0), (sigma, 1.0))
    )
    first = _fit(ranges, on_earth, comparable, z, deviation, start, false_alarm)
    here = np.concatenate(
        [np.where(np.isfinite(first.x[:, :3]), first.x[:, :3], near), np.zeros((len(near), 5))], -1
    )
    # Rates are linear in velocity and drift at a known position: rate = rate at rest + H (v, d).
    towards = pseudorange.jacobian(here, seen.q, seen.w)[:, n:, [3, 4, 5, 7]]
    still = pseudorange.measure(here, seen.q, seen.w)[:, n:]

    def rates(rows: Array, x: Array) -> tuple[Array, Array]:
        return still[rows] + (towards[rows] @ x[..., None])[..., 0], towards[rows]

    z = np.where(first.kind.excluded[:, :n], np.nan, seen.z[:, n:])
    zeros = np.zeros((len(near), 4))
    second = _fit(rates, np.asarray, np.asarray, z, sigma[:, n:], zeros, false_alarm)
    return first, second


def _fit(
    model: Callable[[Array, Array], tuple[Array, Array]],
    possible: Callable[[Array], Array],
    comparable: Callable[[Array], Array],
    z: Array,
    sigma: Array,
    start: Array,
    false_alarm: float,
) -> _Fit:
    """Fixes from ranges or from rates.

    model: ``(epochs, states) ->`` measurements and Jacobians. possible: a function that replaces
        impossible states by nan. comparable: a function that removes measurements ``(K, S)`` that
        are alone in their system.
    """

    def solve(rows: Array, kept: Array) -> tuple[Array, Array]:
        _, x, root = gauss_newton(
            lambda x: model(rows, x),
            np.where(kept, z[rows], np.nan),
            sigma[rows],
            start[rows],
            rounds=20,
        )
        return possible(x), outer(root)

    def linear(rows: Array, x: Array) -> tuple[Array, Array]:
        values, G = model(rows, x)
        return np.nan_to_num((z[rows] - values) / sigma[rows]), G / sigma[rows][..., None]

    every, used = np.arange(len(z)), comparable(np.isfinite(z))
    kind = monitored(
        lambda rows, kept: solve(rows, kept)[0], linear, used, start, false_alarm=false_alarm
    )
    kept = comparable(kind.kept)
    # If a system has only two measurements and they contradict each other, both are excluded,
    # because it is unknown which one is faulty.
    kind = kind._replace(kept=kept, excluded=used & ~kept & ~kind.unusable[:, None])
    x, cov = solve(every, kind.kept)
    return _Fit(x, cov, kind, *linear(every, np.where(np.isfinite(x), x, start)))


def estimated(seen: Seen, false_alarm: float) -> tuple[Noise, Noise]:
    """Noise of ranges and rates by system and elevation, from the residuals of sound measurements;
    `GIVEN` where they are too few.

    The estimate starts with small noise, which is doubled as long as most fixes fail the test.
    """
    some = slice(None, None, -(-len(seen.z) // MOST_EPOCHS))
    z, q, w, elevation, position, modeled, offsets = seen
    z, q, w, elevation, position, modeled = (
        values[some] for values in (z, q, w, elevation, position, modeled)
    )
    seen, _ = _packed(Seen(z, q, w, elevation, position, modeled, offsets))
    usual = (Noise((0.0,), (GIVEN[0],)), Noise((0.0,), (GIVEN[1],)))
    noise = (Noise((0.0,), (QUIETEST * GIVEN[0],)), Noise((0.0,), (QUIETEST * GIVEN[1],)))
    fits = _fits(seen, noise, false_alarm)
    while any(
        loud := [2 * int(fit.kind.unusable.sum()) > int(fit.kind.tested.sum()) for fit in fits]
    ):
        noise = (_louder(noise[0], loud[0]), _louder(noise[1], loud[1]))
        if any(kind.zenith[0] > LOUDEST * least for kind, least in zip(noise, GIVEN, strict=True)):
            return usual
        fits = _fits(seen, noise, false_alarm)
    for _ in range(12):
        before = noise
        noise = (
            _estimated(fits[0], seen, seen.modeled, before[0], RESOLUTION[0]) or usual[0],
            _estimated(fits[1], seen, 0.0 * seen.modeled, before[1], RESOLUTION[1]) or usual[1],
        )
        if all(
            len(new.level) == len(old.level) and np.allclose(new[:2], old[:2], rtol=0.02)
            for new, old in zip(noise, before, strict=True)
        ):
            break
        fits = _fits(seen, noise, false_alarm)
    return noise


def _louder(noise: Noise, loud: bool) -> Noise:
    return noise._replace(zenith=(2.0 * noise.zenith[0],)) if loud else noise


def _estimated(
    fit: _Fit, seen: Seen, modeled: Array, noise: Noise, resolution: float
) -> Noise | None:
    """Noise of ranges or rates from the residuals of fixes with ``noise``; None: too few.

    Each system has its own noise if all have enough measurements.
    """
    n = seen.q.shape[-2]
    spare = fit.spare
    rows = np.flatnonzero(spare > 0)
    if spare.sum() < ENOUGH:
        return None
    kept, elevation, system = fit.kind.kept[rows], seen.elevation[rows], seen.system[rows]
    count = [int((kept[:, :n] & (system == j)).sum()) for j in range(seen.offsets.shape[-2] + 1)]
    if min(count) < 2 * ENOUGH:
        count, system = [sum(count)], np.zeros_like(system)
    variance = noise.variance(elevation, seen.system[rows]) + modeled[rows]
    up = np.sin(np.maximum(elevation, LEAST_ELEVATION))
    masks = [(system == j) / variance for j in range(len(count))]
    parts = np.array([part for mask in masks for part in (mask, mask / up**2)])
    more = [(0, 0)] * 2 + [(0, kept.shape[-1] - n)]
    parts = np.pad(np.concatenate([parts, (modeled[rows] / variance)[None]]), more)
    squares = noise_components(fit.left[rows], fit.G[rows], kept, parts[:-1], parts[-1])
    level, zenith = np.sqrt(squares).reshape(-1, 2).T.tolist()
    return Noise(tuple(max(v, resolution) for v in level), tuple(zenith), int(spare.sum()))
