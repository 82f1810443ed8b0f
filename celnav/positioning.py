"""From a receiver's log to what a filter takes: satellites, corrected measurements, first fixes.

State: position (m, Earth-fixed), velocity (m/s), clock bias (m) and drift (m/s), as in `celnav.models.pseudorange`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pymap3d import ecef2geodetic

from celnav.checks import finite
from celnav.files import InputError
from celnav.filters.driver import Epoch, run
from celnav.filters.least_squares import least_squares
from celnav.gaussian import Gaussian, covariance
from celnav.linalg import Array
from celnav.models import pseudorange
from celnav.models.atmosphere import GPS_L1_HZ, klobuchar, saastamoinen
from celnav.models.beidou import B1I_HZ, ELLIPSOID, GPS_AHEAD_S, LIGHT
from celnav.rinex import Navigation, Observations

CREDIBLE_M = (1.5e7, 5e7)
"""Pseudoranges outside are none."""
CREDIBLE_M_PER_S = 1e4
"""Nor are larger rates."""
LEAST_ELEVATION = np.radians(1.0)
"""What delays and deviations are taken for below it."""
MILLISECOND_M = 1e-3 * LIGHT
"""By whole ones of these many receivers set their clock."""
START = (100.0, 10.0, 100.0, 10.0)
"""Deviations about the first fix: m, m/s, m, m/s."""


@dataclass(frozen=True)
class Log:
    """A receiver's log, ready for a filter. It starts at the first epoch whose fix is as consistent as most are.

    Attributes
    ----------
    times: ``(T,)`` s of BDT. names: of the satellites, ``S``.
    z: ``(T, 2 S)`` ranges (m) and rates (m/s) without clocks of satellites, atmosphere and jumps of the receiver's clock; nan where
        there is none. sigma: ``(T, 2 S)`` their deviations. q, w: ``(T, S, 3)``, see `celnav.models.pseudorange.Sources`.
    elevation, azimuth: ``(T, S)`` rad, nan of satellites that cannot be used.
    fixes, fix_cov: ``(T, 8)`` and of positions ``(T, 3, 3)`` m^2, of each epoch by itself, nan where it has none.
    jumps: ``(T,)`` m, what the receiver has set its clock by since the start, which was taken off ranges and fixes.
    dilution: of each epoch ``(T,)``. ionosphere: whether the broadcast model's coefficients were there to correct it by.
    left_out: why measurements are not used, and how many.
    """

    times: Array
    names: list[str]
    z: Array
    sigma: Array
    q: Array
    w: Array
    elevation: Array
    azimuth: Array
    fixes: Array
    fix_cov: Array
    jumps: Array
    dilution: pseudorange.Dilution
    ionosphere: bool
    left_out: dict[str, int]

    @property
    def used(self) -> Array:
        """Which ranges there are, ``(T, S)``."""
        return np.isfinite(self.z[:, : len(self.names)])

    def epochs(self) -> Iterator[Epoch]:
        """Epochs for `filters`; ``u`` is ``(q, w, sigma)`` at the epoch's time."""
        intervals = np.diff(self.times, prepend=self.times[:1])
        for k, (t, dt) in enumerate(zip(self.times.tolist(), intervals.tolist(), strict=True)):
            yield Epoch(k, t, dt, (self.q[k], self.w[k], self.sigma[k]), self.z[k])

    def prior(self) -> Gaussian:
        """About the first fix, in covariance form, ``(8,)``."""
        position, velocity, bias, drift = START
        return covariance(np.nan_to_num(self.fixes[0]), np.diag(np.square([position] * 3 + [velocity] * 3 + [bias, drift])))

    def part(self, which: slice) -> Log:
        """Some of the epochs."""
        names = ("times", "z", "sigma", "q", "w", "elevation", "azimuth", "fixes", "fix_cov", "jumps")
        arrays: dict[str, Any] = {name: getattr(self, name)[which] for name in names}
        return replace(self, **arrays, dilution=pseudorange.Dilution(*(values[which] for values in self.dilution)))


def prepare(
    observations: Observations,
    navigation: Navigation,
    *,
    mask_deg: float = 10.0,
    sigma: ArrayLike = (1.5, 0.05),
) -> Log:
    """Satellites and corrected measurements of a log. Nothing is taken from the header's position.

    Parameters
    ----------
    observations, navigation: what was read from the two files.
    mask_deg: satellites below this elevation are not used, from 0 to below 90.
    sigma: deviations of range (m) and rate (m/s) at the zenith; elsewhere divided by the sine of the elevation.

    Raises
    ------
    ValueError: for a mask or deviations that cannot be. InputError: naming the files, if no epoch has a fix.
    """
    least = mask(mask_deg)
    deviations = finite("sigma", sigma, (2,))
    if not (deviations > 0.0).all():
        raise ValueError(f"sigma: expected positive deviations, got {sigma!r}")
    times, code = observations.times, observations.code
    rows = np.stack([navigation.nearest(name, times) for name in observations.names], -1)
    given = np.isfinite(code)
    credible = (np.nan_to_num(code) > CREDIBLE_M[0]) & (np.nan_to_num(code) < CREDIBLE_M[1])
    measured = -observations.doppler * LIGHT / B1I_HZ
    wild = np.abs(np.nan_to_num(measured)) > CREDIBLE_M_PER_S
    usable = credible & (rows >= 0)
    left_out = {
        "without a healthy broadcast set in its time": int((given & (rows < 0)).sum()),
        "pseudorange out of all bounds": int((given & ~credible & (rows >= 0)).sum()),
        "rate out of all bounds": int((usable & wild).sum()),
    }
    position, velocity, clock = np.zeros((len(times), 3)), np.zeros((len(times), 3)), np.zeros(len(times))
    for known in (False, True, True):
        seen = _sources(navigation, rows, times, code, usable, position, velocity)
        ranges, rates = code + seen.clock, np.where(wild, np.nan, measured) + seen.drift
        used, elevation, azimuth, delay = usable, np.full(code.shape, np.pi / 2.0), np.zeros(code.shape), np.zeros(code.shape)
        if known:
            elevation, azimuth, delay = _sky(navigation, times - clock / LIGHT, seen.q, position)
            used = usable & (elevation >= least)
        weight = 1.0 / np.sin(np.maximum(elevation, LEAST_ELEVATION))
        sigma_of = np.concatenate([deviations[0] * weight, deviations[1] * weight], -1)
        z = np.concatenate([np.where(used, ranges - delay, np.nan), np.where(used, rates, np.nan)], -1)
        fixes, cov = _fixes(z, seen, sigma_of, position)
        there = np.isfinite(fixes[:, 6])
        if not there.any():
            raise InputError(
                f"{observations.path}, {navigation.path}: expected an epoch with four satellites above the mask, got none"
            )
        near = _nearest(there)
        position, velocity, clock = fixes[near, :3], np.nan_to_num(fixes[near, 3:6]), fixes[near, 6]
    left_out["below the mask"] = int((usable & ~used).sum())
    first = _first_consistent(z, fixes, seen, sigma_of)
    left_out["before the first consistent fix"] = int(used[:first].sum())
    z, fixes, jumps = _without_jumps(z, fixes, times)
    shown = np.where(usable, 1.0, np.nan)
    log = Log(
        times, observations.names, z, sigma_of, seen.q, seen.w, shown * elevation, shown * azimuth, fixes, cov, jumps,
        pseudorange.dilution(seen.q, position, _axes(position), used), navigation.klobuchar is not None, left_out,
    )  # fmt: skip
    return log.part(slice(first, None))


def mask(degrees: float) -> float:
    """A least elevation in rad.

    Raises
    ------
    ValueError: unless it is from 0 to below 90 degrees.
    """
    if not 0.0 <= degrees < 90.0:
        raise ValueError(f"mask_deg: expected degrees from 0 to below 90, got {degrees!r}")
    return float(np.radians(degrees))


def _first_consistent(z: Array, fixes: Array, seen: pseudorange.Sources, sigma: Array) -> int:
    """The first epoch whose residuals are not three times as large as usual, among those with more ranges than unknowns."""
    S = z.shape[-1] // 2
    left = (z - pseudorange.measure(fixes, seen.q, seen.w))[:, :S] / sigma[:, :S]
    spare = np.isfinite(left).sum(-1) - 4
    size = np.nansum(np.square(left), -1) / np.maximum(spare, 1)
    if not (spare > 0).any():
        return int(np.argmax(np.isfinite(fixes[:, 6])))
    return int(np.argmax((spare > 0) & (size <= 9.0 * np.median(size[spare > 0]))))


def _nearest(there: Array) -> Array:
    """Of each epoch the nearest ``(T,)`` that has something."""
    k, own = np.flatnonzero(there), np.arange(len(there))
    after = np.clip(np.searchsorted(k, own), 0, len(k) - 1)
    before = np.maximum(after - 1, 0)
    return np.asarray(np.where(np.abs(k[after] - own) < np.abs(k[before] - own), k[after], k[before]))


def _sources(
    navigation: Navigation, rows: Array, times: Array, code: Array, usable: Array, position: Array, velocity: Array
) -> pseudorange.Sources:
    """Satellites by epoch ``(T, S)``; those that are not usable stand anywhere."""
    T, S = rows.shape
    q, w = np.full((T, S, 3), 3e7), np.zeros((T, S, 3))
    clock, drift = np.zeros((T, S)), np.zeros((T, S))
    for s in range(S):
        for row in np.unique(rows[usable[:, s], s]):
            k = np.flatnonzero(usable[:, s] & (rows[:, s] == row))
            sets = navigation.sets.chosen(np.array([row]))
            seen = pseudorange.emitted(sets, times[k], code[k, s, None], position[k], velocity[k])
            q[k, s], w[k, s], clock[k, s], drift[k, s] = (part[:, 0] for part in seen)
    return pseudorange.Sources(q, w, clock, drift)


def _geodetic(position: Array) -> tuple[Array, Array, Array]:
    """Latitude and longitude (rad) and height (m), ``(T,)`` each."""
    latitude, longitude, height = (np.reshape(v, len(position)) for v in ecef2geodetic(*position.T, ell=ELLIPSOID, deg=False))
    return latitude, longitude, height


def _axes(position: Array) -> Array:
    latitude, longitude, _ = _geodetic(position)
    return pseudorange.local_axes(latitude, longitude)


def _sky(navigation: Navigation, times: Array, q: Array, position: Array) -> tuple[Array, Array, Array]:
    """Elevation, azimuth and the delay of the atmosphere ``(T, S)`` m."""
    latitude, longitude, height = (v[:, None] for v in _geodetic(position))
    elevation, azimuth = pseudorange.look(q, position, _axes(position))
    above = np.maximum(elevation, LEAST_ELEVATION)
    delay = saastamoinen(latitude, np.clip(height, -1000.0, 11000.0), above)
    if navigation.klobuchar is not None:
        alpha, beta = navigation.klobuchar
        at_l1 = klobuchar(alpha, beta, times[:, None] + GPS_AHEAD_S, latitude, longitude, above, azimuth)
        delay = delay + (GPS_L1_HZ / B1I_HZ) ** 2 * at_l1
    return elevation, azimuth, delay


def _fixes(z: Array, seen: pseudorange.Sources, sigma: Array, position: Array) -> tuple[Array, Array]:
    """All epochs at once: position and bias from ranges, then velocity and drift from rates; nan where there are too few.

    States ``(T, 8)`` and covariances of positions ``(T, 3, 3)``.
    """
    T, S = seen.q.shape[:2]

    def states(x: Array) -> Array:
        return np.concatenate([x[..., :3], np.zeros((*x.shape[:-1], 3)), x[..., 3:], np.zeros((*x.shape[:-1], 1))], -1)

    def ranges(x: Array, _epoch: Epoch) -> Array:
        return pseudorange.measure(states(x), seen.q, seen.w)[..., :S]

    def slope(x: Array, _epoch: Epoch) -> Array:
        return pseudorange.jacobian(states(x), seen.q, seen.w)[..., :S, [0, 1, 2, 6]]

    def batch(h: Callable[..., Array], jacobian: Callable[..., Array], part: slice, start: Array) -> tuple[Array, Array]:
        filter = least_squares(h, jacobian, sigma[:, part], rounds=20)
        track = run(filter, covariance(start, np.eye(4)), [Epoch(z=z[:, part])], keep="spread", on_failure="flag")
        assert track.mean is not None
        return track.mean[0], track.cov[0]

    fix, cov = batch(ranges, slope, slice(S), np.concatenate([position, np.zeros((T, 1))], -1))
    here = np.concatenate([np.nan_to_num(fix[:, :3]), np.zeros((T, 5))], -1)
    towards = pseudorange.jacobian(here, seen.q, seen.w)[:, S:, [3, 4, 5, 7]]
    still = pseudorange.measure(here, seen.q, seen.w)[:, S:]
    moving, _ = batch(
        lambda x, _epoch: still + (towards @ x[..., None])[..., 0], lambda _x, _epoch: towards, slice(S, 2 * S), np.zeros((T, 4))
    )
    return np.concatenate([fix[:, :3], moving[:, :3], fix[:, 3:], moving[:, 3:]], -1), cov[:, :3, :3]


def _without_jumps(z: Array, fixes: Array, times: Array) -> tuple[Array, Array, Array]:
    """Ranges and biases as if the receiver had never set its clock by whole milliseconds, and by how much it had ``(T,)``.

    Where it did so between two fixes that are not neighbors, nobody knows when: ranges in between are left out.
    """
    S, k = z.shape[-1] // 2, np.flatnonzero(np.isfinite(fixes[:, 6]))
    jumps, z, fixes = np.zeros(len(times)), z.copy(), fixes.copy()
    if len(k) > 1:
        step, dt = np.diff(fixes[k, 6]), np.diff(times[k])
        # Without rates the clock runs on as it did between the last two fixes.
        ran = (step - MILLISECOND_M * np.round(step / MILLISECOND_M)) / dt
        drift = fixes[k, 7]
        expected = np.where(np.isnan(drift[1:] + drift[:-1]), np.concatenate([ran[:1], ran[:-1]]), 0.5 * (drift[1:] + drift[:-1]))
        whole = MILLISECOND_M * np.round((step - expected * dt) / MILLISECOND_M)
        for last, following in zip(k[:-1][whole != 0.0], k[1:][whole != 0.0], strict=True):
            z[last + 1 : following, :S] = np.nan
        jumps[k[1:]] = whole
        jumps = np.cumsum(jumps)
    z[:, :S] -= jumps[:, None]
    fixes[:, 6] -= jumps
    return z, fixes, jumps
