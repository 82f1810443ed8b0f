"""Fixes of all epochs at once, each by itself: position and clock of ranges, velocity and drift of
rates, without faulty ones.

Also how large the noise is that their residuals show. With a second system of satellites a fix has
the offset of its clock besides, where both are seen; a system's only range says nothing of the
position, nothing tests it, and it is not used. Epochs ``T`` lead, satellites ``S`` follow; a kind
of measurement, ranges or rates, is a tuple's or an axis' place 0 or 1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from celnav.filters.model import Sensor
from celnav.filters.records import Epoch
from celnav.filters.run import run
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.models import pseudorange
from celnav.models.gnss import B1I_HZ, LIGHT
from celnav.receiver.integrity import Monitored, misfit, monitored, noise_components
from celnav.receiver.least_squares import least_squares
from celnav.receiver.sky import GROUND_M

LEAST_ELEVATION = np.radians(1.0)
"""What delays and deviations are taken for below it."""
GIVEN = (1.5, 0.05)
"""Deviations at the zenith, m and m/s, until they are estimated."""
RESOLUTION = (1e-3, 1e-3 * LIGHT / B1I_HZ)
"""Of a file, in m and m/s: less noise cannot be seen."""
QUIETEST, LOUDEST = 0.25, 8.0
"""Times `GIVEN`, where the estimate begins: loud noise would hide faults. No receiver is louder;
what looks so is contradiction.
"""
ENOUGH = 100
"""Redundant measurements to estimate noise of."""
MOST_EPOCHS = 1000
"""That it is estimated of, evenly: more say nothing new."""


class Noise(NamedTuple):
    """Of a kind of measurement: its variance is ``level^2 + (zenith / sin(elevation))^2``.

    ``redundancy``: of how many redundant measurements it was estimated; 0: it was given, or they
        were too few.
    """

    level: float
    zenith: float
    redundancy: int = 0

    def deviations(self, elevation: Array) -> Array:
        """At elevations, rad."""
        return np.asarray(
            np.hypot(self.level, self.zenith / np.sin(np.maximum(elevation, LEAST_ELEVATION)))
        )


class Seen(NamedTuple):
    """Measurements ``z (T, 2 S)``, nan where there is none, of satellites ``q, w, elevation`` near
    ``position (T, 3)``.

    ``second (S,)``: 1 for those of a second system, 0 for those of the first; None: there is one
    system.
    """

    z: Array
    q: Array
    w: Array
    elevation: Array
    position: Array
    second: Array | None = None


class Fixed(NamedTuple):
    """States ``(T, 8 or 9)``, their variances, and covariances of positions ``(T, 3, 3)``, nan
    where there is no fix; deviations ``sigma (T, 2 S)``.

    ``kinds``: of ranges and rates, what is left of them; ``left`` and ``G``: residuals ``(T, S)``
    and Jacobians ``(T, S, 4)``, in deviations. With a second system ranges have a place more, for
    "the offset is zero", which is kept where one system is missing.
    """

    states: Array
    variances: Array
    cov: Array
    sigma: Array
    kinds: tuple[Monitored, Monitored]
    left: tuple[Array, Array]
    G: tuple[Array, Array]

    def measurements(self, what: str) -> Array:
        """Of ranges and rates ``(T, 2 S)``, whether they are "kept" or "excluded"."""
        return np.concatenate(
            [getattr(kind, what)[:, : self.sigma.shape[-1] // 2] for kind in self.kinds], -1
        )

    @property
    def misfit(self) -> Array:
        """Squared residuals of ranges ``(T,)``; nan without a fix."""
        return np.where(
            np.isfinite(self.states[:, 6]), misfit(self.left[0], self.kinds[0].kept), np.nan
        )


def fixed(seen: Seen, noise: tuple[Noise, Noise], false_alarm: float) -> Fixed:
    """Fixes of all epochs; a satellite whose range is faulty is not asked for its rate either."""
    S, second = seen.q.shape[-2], seen.second
    offset = 0 if second is None else 1
    sigma = np.concatenate([kind.deviations(seen.elevation) for kind in noise], -1)
    away = np.where(np.isfinite(seen.z[:, :S, None]), seen.q, 0.0).sum(-2)
    below = GROUND_M[0] * away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1.0)
    near = np.where(
        np.linalg.norm(seen.position, axis=-1, keepdims=True) > 1.0, seen.position, below
    )

    def ranges(rows: Array, x: Array) -> tuple[Array, Array]:
        at, q, w = _states(x, np.zeros((*x.shape[:-1], 4))), seen.q[rows], seen.w[rows]
        G = pseudorange.jacobian(at, q, w, second)[..., :S, [0, 1, 2, 6] + [8] * offset]
        zero = np.broadcast_to(np.eye(4 + offset)[4:], (*G.shape[:-2], offset, 4 + offset))
        return np.concatenate(
            [pseudorange.measure(at, q, w, second)[..., :S], x[..., 4:]], -1
        ), np.concatenate([G, zero], -2)

    def on_earth(x: Array) -> Array:
        size = np.linalg.norm(x[..., :3], axis=-1, keepdims=True)
        return np.where((size > GROUND_M[0]) & (size < GROUND_M[1]), x, np.nan)

    def comparable(there: Array) -> Array:
        if second is None:
            return there
        there = there[:, :S]
        for system in (second == 0.0, second == 1.0):
            there = there & ~(system & ((there & system).sum(-1, keepdims=True) == 1))
        both = (there & (second == 0.0)).any(-1) & (there & (second == 1.0)).any(-1)
        return np.concatenate([there, ~both[:, None]], -1)

    start = np.concatenate([near, np.zeros((len(near), 1 + offset))], -1)
    z, deviation = (
        np.pad(v[:, :S], ((0, 0), (0, offset)), constant_values=c)
        for v, c in ((seen.z, 0.0), (sigma, 1.0))
    )
    of_ranges = _kind(ranges, on_earth, comparable, z, deviation, start, false_alarm)
    here = np.concatenate(
        [
            np.where(np.isfinite(of_ranges.x[:, :3]), of_ranges.x[:, :3], near),
            np.zeros((len(near), 5)),
        ],
        -1,
    )
    towards = pseudorange.jacobian(here, seen.q, seen.w)[:, S:, [3, 4, 5, 7]]
    still = pseudorange.measure(here, seen.q, seen.w)[:, S:]

    def rates(rows: Array, x: Array) -> tuple[Array, Array]:
        return still[rows] + (towards[rows] @ x[..., None])[..., 0], towards[rows]

    z = np.where(of_ranges.kind.excluded[:, :S], np.nan, seen.z[:, S:])
    of_rates = _kind(
        rates,
        lambda x: x,
        lambda there: there,
        z,
        sigma[:, S:],
        np.zeros((len(near), 4)),
        false_alarm,
    )
    apart = np.where(of_ranges.kind.kept[:, S:], np.nan, of_ranges.x[:, 4:])
    states = _states(np.concatenate([of_ranges.x[:, :4], apart], -1), of_rates.x)
    variances = _states(*(kind.cov.diagonal(0, -2, -1) for kind in (of_ranges, of_rates)))
    kinds, left, G = (
        (of_ranges.kind, of_rates.kind),
        (of_ranges.left, of_rates.left),
        (of_ranges.G, of_rates.G),
    )
    return Fixed(states, variances, of_ranges.cov[:, :3, :3], sigma, kinds, left, G)


def _states(ranges: Array, rates: Array) -> Array:
    """What ranges and rates determine, each ``(..., 4 or 5)``, in the order of a state."""
    return np.concatenate(
        [ranges[..., :3], rates[..., :3], ranges[..., 3:4], rates[..., 3:], ranges[..., 4:]], -1
    )


class _Kind(NamedTuple):
    x: Array
    cov: Array
    kind: Monitored
    left: Array
    G: Array


def _kind(
    model: Callable[[Array, Array], tuple[Array, Array]],
    possible: Callable[[Array], Array],
    comparable: Callable[[Array], Array],
    z: Array,
    sigma: Array,
    start: Array,
    false_alarm: float,
) -> _Kind:
    """Fixes of one kind: ``model``: ``(epochs, states) ->`` measurements and Jacobians;
    ``possible`` makes other states nan; ``comparable``: those of the measurements ``(K, S)`` that
    are not alone.
    """

    def solve(rows: Array, kept: Array) -> tuple[Array, Array]:
        sensor = Sensor(
            lambda x, _epoch: model(rows, x[0])[0][None],
            sqrt_R=lambda _x, _epoch: sigma[rows][..., None] * np.eye(sigma.shape[-1]),
            jacobian=lambda x, _epoch: model(rows, x)[1],
        )
        filter = least_squares(sensor, rounds=20)
        epoch = Epoch(z=np.where(kept, z[rows], np.nan))
        track = run(
            filter,
            Gaussian(start[rows], np.eye(start.shape[-1])),
            [epoch],
            keep="cov",
            on_failure="flag",
        )
        assert track.mean is not None
        return possible(track.mean[0]), track.cov[0]

    def linear(rows: Array, x: Array) -> tuple[Array, Array]:
        values, G = model(rows, x)
        return np.nan_to_num((z[rows] - values) / sigma[rows]), G / sigma[rows][..., None]

    every, used = np.arange(len(z)), comparable(np.isfinite(z))
    kind = monitored(
        lambda rows, kept: solve(rows, kept)[0], linear, used, start, false_alarm=false_alarm
    )
    kept = comparable(kind.kept)
    # Of two of a system that contradict each other nothing tells the faulty one: both go.
    kind = kind._replace(kept=kept, excluded=used & ~kept & ~kind.unusable[:, None])
    x, cov = solve(every, kind.kept)
    return _Kind(x, cov, kind, *linear(every, np.where(np.isfinite(x), x, start)))


def estimated(seen: Seen, false_alarm: float) -> tuple[Noise, Noise]:
    """Noise of ranges and rates, by elevation, of the residuals of what is not faulty; `GIVEN`
    where they are too few.

    It is first taken for small, and for twice as large as long as most fixes contradict themselves.
    """
    some = slice(None, None, -(-len(seen.z) // MOST_EPOCHS))
    z, q, w, elevation, position = (values[some] for values in seen[:5])
    seen = Seen(z, q, w, elevation, position, seen.second)
    usual = (Noise(0.0, GIVEN[0]), Noise(0.0, GIVEN[1]))
    noise = (Noise(0.0, QUIETEST * GIVEN[0]), Noise(0.0, QUIETEST * GIVEN[1]))
    fixes = fixed(seen, noise, false_alarm)
    while any(
        loud := [2 * int(kind.unusable.sum()) > int(kind.tested.sum()) for kind in fixes.kinds]
    ):
        noise = (_louder(noise[0], loud[0]), _louder(noise[1], loud[1]))
        if any(kind.zenith > LOUDEST * usual for kind, usual in zip(noise, GIVEN, strict=True)):
            return usual
        fixes = fixed(seen, noise, false_alarm)
    for _ in range(12):
        before = noise
        noise = (
            _estimated(fixes, seen.elevation, 0) or usual[0],
            _estimated(fixes, seen.elevation, 1) or usual[1],
        )
        if np.allclose(noise, before, rtol=0.02):
            break
        fixes = fixed(seen, noise, false_alarm)
    return noise


def _louder(noise: Noise, loud: bool) -> Noise:
    return noise._replace(zenith=2.0 * noise.zenith) if loud else noise


def _estimated(fixes: Fixed, elevation: Array, kind: int) -> Noise | None:
    S = elevation.shape[-1]
    kept, left, G = fixes.kinds[kind].kept, fixes.left[kind], fixes.G[kind]
    more = ((0, 0), (0, kept.shape[-1] - S))
    sigma = np.pad(fixes.sigma[:, kind * S : (kind + 1) * S], more, constant_values=1.0)
    elevation = np.pad(elevation, more, constant_values=1.0)
    spare = np.where(np.isfinite(fixes.states[:, (6, 7)[kind]]), kept.sum(-1) - G.shape[-1], 0)
    rows = np.flatnonzero(spare > 0)
    if spare.sum() < ENOUGH:
        return None
    up = np.sin(np.maximum(elevation[rows], LEAST_ELEVATION))
    parts = np.stack([np.square(1.0 / sigma[rows]), np.square(1.0 / (sigma[rows] * up))])
    level, zenith = np.sqrt(noise_components(left[rows], G[rows], kept[rows], parts))
    return Noise(max(float(level), RESOLUTION[kind]), float(zenith), int(spare.sum()))
