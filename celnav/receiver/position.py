"""Preparation of a receiver's log for a filter: satellites, corrected measurements, first fixes.

State: position (m, Earth-fixed), velocity (m/s), clock bias (m) and drift (m/s). With two or three
satellite systems the state also has the offset (m) of each later clock from the first, as in
`celnav.models.pseudorange`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.files import InputError
from celnav.filters.records import Epoch
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import finite
from celnav.gaussian.linalg import Array
from celnav.models import pseudorange
from celnav.models.gnss import GPS_AHEAD_S, L1_HZ, LIGHT
from celnav.receiver.correlated import Correlation, correlation
from celnav.receiver.fixes import LEAST_ELEVATION, Noise, Seen, estimated, fixed
from celnav.receiver.geodesy import ELLIPSOID, ecef2geodetic
from celnav.receiver.rinex import OTHERS, SYSTEMS, Navigation, Observations
from celnav.receiver.sky import (
    BROADCAST_LEFT,
    TYPICAL_IONOSPHERE,
    TYPICAL_LEFT,
    Dilution,
    atmosphere_variance,
    dilution,
    klobuchar,
    local_axes,
    look,
    saastamoinen,
)
from celnav.receiver.walks import Walk, acceleration_noise, walk_noise

CREDIBLE_M = (1.5e7, 5e7)
"""Least and largest pseudorange that is used."""
CREDIBLE_M_PER_S = 1e4
"""Largest rate that is used."""
COARSE = (100.0, 1.0)
"""Standard deviations (m, m/s) of measurements before elevations and delays are known."""
MOVED = 16.27
"""Squared Mahalanobis distance that one in 1000 fixes of a receiver at rest exceeds."""
MILLISECOND_M = 1e-3 * LIGHT
"""A millisecond times the speed of light, m: many receivers set their clock by
multiples of this.
"""
START = (100.0, 100.0, 100.0, 10.0, 10.0, 10.0, 100.0, 10.0, 100.0, 100.0)
"""Standard deviations of the first state: position m, velocity m/s, clock m, m/s, and offsets m."""


@dataclass(frozen=True, eq=False)
class Log:
    """A receiver's log, ready for a filter: from the first fix that could be tested to the last
    measurement.

    Attributes
    ----------
    times: ``(T,)`` s of BDT. names: of the satellites, ``S``, starting with the first system.
    z: ``(T, 2 S)``, ranges (m) and rates (m/s), nan where missing. They are corrected for satellite
        clocks, atmosphere and jumps of the receiver's clock. sigma: ``(T, 2 S)``, their standard
        deviations. q, w: ``(T, S, 3)``, see `celnav.models.pseudorange.Sources`.
    modeled: ``(T, S)`` m^2, variance of ranges from remaining atmospheric delays, broadcast orbits
        and clocks. It is part of sigma^2 if the noise was estimated, else 0.
    elevation, azimuth: ``(T, S)`` rad, nan for satellites that cannot be used.
    fixes, fix_cov: ``(T, 8 + k)``, and of positions ``(T, 3, 3)`` m^2. Each fix uses only its
        epoch; nan at an epoch without a fix.
    misfit: ``(T,)``, squared range residuals of the fixes over their variances: chi-square with
        `spare` degrees of freedom.
    excluded: ``(T, 2 S)``, the faulty measurements. unusable: ``(T, 2)``, whether all ranges, or
        all rates, are left out because they contradict each other and the fault cannot be located.
        tested: ``(T, 2)``, whether there was redundancy.
    noise: of ranges and of rates. correlation: of the errors of ranges and of rates.
    jumps: ``(T,)`` m, sum of the steps by which the receiver has set its clock since the start. The
        jumps were subtracted from ranges and fixes. dilution: of each epoch ``(T,)``.
    ionosphere: whether coefficients for the ionosphere were broadcast or given; else the log uses
        `celnav.receiver.sky.TYPICAL_IONOSPHERE`.
    clock: process noise of the receiver's clock, estimated from its fixes, and the steps by which
        it was set; None: too few fixes. acceleration: density (m^2/s^3) of the receiver's
        acceleration, also estimated; None: too few rates.
    left_out: reasons why measurements are not used, with their number. others: systems in the files
        that are not used.
    files: names of the files that were read. damaged: one message for each damaged epoch or
        broadcast set that was left out, with its line.
    """

    times: Array
    names: list[str]
    z: Array
    sigma: Array
    modeled: Array
    q: Array
    w: Array
    elevation: Array
    azimuth: Array
    fixes: Array
    fix_cov: Array
    misfit: Array
    excluded: Array
    unusable: Array
    tested: Array
    noise: tuple[Noise, Noise]
    correlation: tuple[Correlation, Correlation]
    jumps: Array
    dilution: Dilution
    ionosphere: bool
    clock: Walk | None
    acceleration: float | None
    left_out: dict[str, int]
    others: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    damaged: tuple[str, ...] = ()

    @cached_property
    def used(self) -> Array:
        """Which ranges are used, ``(T, S)``."""
        return np.isfinite(self.z[:, : len(self.names)])

    @property
    def systems(self) -> str:
        """Letters of the systems."""
        return "".join(dict.fromkeys(name[0] for name in self.names))

    @cached_property
    def second(self) -> Array | None:
        """Offsets of clocks ``(k, S)`` as in `celnav.models.pseudorange`; None: there is one
        system.
        """
        return _second(self.names)

    @property
    def spare(self) -> Array:
        """Redundancy of the ranges, ``(T,)``: a fix needs four, and one for each further system
        that is measured.
        """
        letters = np.array([name[0] for name in self.names])
        seen = [(self.used & (letters == letter)).any(-1) for letter in self.systems]
        return np.asarray(self.used.sum(-1) - 3 - np.maximum(np.sum(seen, 0), 1))

    @property
    def moved(self) -> bool:
        """Whether the receiver moved: more than half of the fixes are farther from their median
        position than `MOVED` allows for their covariances.
        """
        there = np.isfinite(self.fixes[:, 0])
        away = self.fixes[there, :3] - np.median(self.fixes[there, :3], 0)
        squares = away * np.linalg.solve(self.fix_cov[there], away[..., None])[..., 0]
        return bool(there.any() and np.median(squares.sum(-1)) > MOVED)

    def epochs(self, compact: bool = False) -> Iterator[Epoch]:
        """Epochs for `filters`; ``u`` is ``(q, w, sigma, reset)`` at the epoch's time.

        ``reset`` is the step (m) by which the clock was set. With several systems ``u`` also has
        `second`. ``compact``: only the measured satellites, for a filter in `COMPACT`.
        """
        intervals = np.diff(self.times, prepend=self.times[:1])
        reset = np.zeros(len(self.times)) if self.clock is None else self.clock.reset
        for k, (t, dt) in enumerate(zip(self.times.tolist(), intervals.tolist(), strict=True)):
            rows = self.rows(k, compact)
            s = rows[: len(rows) // 2]
            offsets = () if self.second is None else (self.second[:, s],)
            u = self.q[k, s], self.w[k, s], self.sigma[k, rows], reset[k], *offsets
            yield Epoch(k, t, dt, u, self.z[k, rows])

    def rows(self, k: int, compact: bool = False) -> Array:
        """Indices in `z` of the ranges, then of the rates, at an epoch of `epochs`."""
        S, measured = len(self.names), np.isfinite(self.z[k])
        s = np.flatnonzero(measured[:S] | measured[S:] | (not compact))
        return np.concatenate([s, s + S])

    def prior(self, k: int = 0) -> Gaussian:
        """Prior centered on the fix of an epoch, ``(8 + k,)``. Without rates the velocity is
        computed from this fix and the next.
        """
        fix = self.fixes[k].copy()
        later = k + 1 + np.flatnonzero(np.isfinite(self.fixes[k + 1 :, 6]))
        if np.isnan(fix[7]) and later.size:
            interval = self.times[later[0]] - self.times[k]
            step = (self.fixes[later[0]] - fix) / interval
            fix[[3, 4, 5, 7]] = step[[0, 1, 2, 6]]
        return Gaussian(np.nan_to_num(fix), np.diag(np.square(START[: len(fix)])))

    def part(self, which: slice) -> Log:
        """The log of some of the epochs."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays: dict[str, Any] = {
            name: x[which] for name, x in values.items() if isinstance(x, np.ndarray)
        }
        clock = self.clock and self.clock._replace(reset=self.clock.reset[which])
        dilution = Dilution(*(values[which] for values in self.dilution))
        return replace(self, **arrays, clock=clock, dilution=dilution)


def prepare(
    observations: Observations,
    navigation: Navigation,
    *,
    systems: str | None = None,
    mask_deg: float = 10.0,
    sigma: ArrayLike | None = None,
    false_alarm: float = 1e-5,
) -> Log:
    """Satellites and corrected measurements of a log. The header's position is not used.

    Parameters
    ----------
    observations, navigation: the contents of the files.
    systems: letters of the satellite systems to use, from "C", "G" and "E"; None: all that have
        both ranges and orbits.
    mask_deg: satellites below this elevation are not used, from 0 to below 90.
    sigma: standard deviations of range (m) and rate (m/s) at the zenith, including all errors;
        elsewhere they are divided by the sine of the elevation. None: errors of atmosphere and
        orbits are modeled, and the receiver's noise is estimated from the residuals of the fixes.
    false_alarm: probability that a fix without a fault fails the test of its residuals; faults are
        excluded by `celnav.receiver.integrity`. 0: nothing is tested.

    Raises
    ------
    ValueError: for invalid systems, mask, sigma or false_alarm. InputError: naming the files, if no
        epoch has a fix, or if a requested system has no ranges or no orbits.
    """
    least = mask(mask_deg)
    given_noise = deviations(sigma)
    files = f"{observations.path}, {navigation.path}"
    observations, others = _of_systems(observations, navigation, systems, files)
    times, code = observations.times, observations.code
    navigation.check_times(files, times)
    hz = np.array([SYSTEMS[name[0]].hz for name in observations.names])
    second = _second(observations.names)
    rows = np.stack([navigation.nearest(name, times) for name in observations.names], -1)
    there = np.isfinite(code)
    credible = (np.nan_to_num(code) > CREDIBLE_M[0]) & (np.nan_to_num(code) < CREDIBLE_M[1])
    with np.errstate(over="ignore"):
        measured = -observations.doppler * LIGHT / hz
    wild = np.abs(np.nan_to_num(measured)) > CREDIBLE_M_PER_S
    usable = credible & (rows >= 0)
    named, unused = (
        ", ".join(f"{name} {many}" for name, many in counts.items())
        for counts in (navigation.left_out, navigation.unused)
    )
    left_out = {
        "epochs out of order": observations.out_of_order,
        "broadcast sets that are incomplete or have a number that no message can hold"
        + (f" ({named})" if named else ""): sum(navigation.left_out.values()),
        f"records of orbits that are not used ({unused})": sum(navigation.unused.values()),
        "without a healthy broadcast set in its time": int((there & (rows < 0)).sum()),
        "pseudorange out of all bounds": int((there & ~credible & (rows >= 0)).sum()),
        "rate out of all bounds": int((usable & wild).sum()),
    }
    refusal = InputError(
        f"{files}: expected an epoch with four satellites above the mask whose ranges agree, got "
        "none"
    )
    if usable.sum(-1).max(initial=0) < 4:
        raise refusal
    position, velocity = np.zeros((2, len(times), 3))
    clock = np.zeros(len(times))
    noise = (Noise((COARSE[0],), (0.0,)), Noise((COARSE[1],), (0.0,)))
    modeled = np.zeros(code.shape)
    offsets = np.zeros((0, code.shape[-1])) if second is None else second
    # Three passes: without delays; with delays but coarse noise; with delays and the final noise.
    for with_delays, final in ((False, False), (True, False), (True, True)):
        sources = _sources(navigation, rows, times, code, usable, position, velocity)
        ranges, rates = code + sources.clock, np.where(wild, np.nan, measured) + sources.drift
        used, elevation = usable, np.full(code.shape, np.pi / 2.0)
        azimuth, delay = np.zeros((2, *code.shape))
        if with_delays:
            elevation, azimuth, delay, remaining = _sky(
                navigation, times - clock / LIGHT, sources.q, position, hz
            )
            used = usable & (elevation >= least)
        z = np.concatenate(
            [np.where(used, ranges - delay, np.nan), np.where(used, rates, np.nan)], -1
        )
        if final and given_noise is None:
            modeled = remaining + _orbit_variance(navigation, rows, observations.names)
        visible = Seen(z, sources.q, sources.w, elevation, position, modeled, offsets)
        if final:
            noise = estimated(visible, false_alarm) if given_noise is None else given_noise
        fixes = fixed(visible, noise, false_alarm)
        there = np.isfinite(fixes.states[:, 6])
        if not there.any():
            raise refusal
        near = fixes.states[_nearest(there)]
        position, velocity, clock = near[:, :3], np.nan_to_num(near[:, 3:6]), near[:, 6]
    left_out["below the mask"] = int((usable & ~used).sum())
    kept, excluded = fixes.measurements("kept"), fixes.measurements("excluded")
    lone = (np.isfinite(z) & ~kept & ~excluded)[:, : code.shape[-1]] & ~fixes.kinds[0].unusable[
        :, None
    ]
    left_out["the only range of a system, which nothing tests"] = int(lone.sum())
    z = np.where(kept, z, np.nan)
    tested = there & fixes.kinds[0].tested
    first = int(np.argmax(tested if tested.any() else there))
    z, states, jumps = _without_jumps(z, fixes.states, times)
    ranged = np.isfinite(z[:, : len(observations.names)])
    left_out["before the first consistent fix"] = int(ranged[:first].sum())
    sound = np.where((tested if tested.any() else there)[:, None], states, np.nan)
    (place, v, bias, drift), variances = (
        (values[:, :3], values[:, 3:6], values[:, 6], values[:, 7])
        for values in (sound, fixes.variances)
    )
    of_ranges, of_rates = (
        correlation(times, left, np.isfinite(left), redundancy)
        for left, redundancy in fixes.residuals
    )
    shown = np.where(usable, 1.0, np.nan)
    log = Log(
        times,
        observations.names,
        z,
        fixes.sigma,
        modeled,
        visible.q,
        visible.w,
        shown * elevation,
        shown * azimuth,
        states,
        fixes.cov,
        fixes.misfit,
        excluded,
        np.stack([kind.unusable for kind in fixes.kinds], -1),
        np.stack([kind.tested for kind in fixes.kinds], -1),
        noise,
        (of_ranges, of_rates),
        jumps,
        dilution(visible.q, position, _axes(position), ranged, second),
        navigation.klobuchar is not None,
        walk_noise(times, bias, drift, *variances[2:]),
        acceleration_noise(times, place, v, *variances[:2]),
        left_out,
        others,
        (str(observations.path), *str(navigation.path).split(", ")),
        observations.damaged + navigation.damaged,
    )
    end = int(np.flatnonzero(ranged.any(-1))[-1]) + 1
    return log.part(slice(first, end))


def _second(names: list[str]) -> Array | None:
    letters = np.array([name[0] for name in names])
    later = list(dict.fromkeys(letters))[1:]
    return np.array([letters == letter for letter in later], float) if later else None


def chosen(systems: str | None) -> str:
    """Letters of systems, in the order of `SYSTEMS`; None: all. ValueError for others."""
    if systems is not None and (not systems or set(systems) - set(SYSTEMS)):
        letters = ", ".join(f"{letter} ({system.name})" for letter, system in SYSTEMS.items())
        raise ValueError(f"systems: expected letters of {letters}, got {systems!r}")
    return "".join(letter for letter in SYSTEMS if systems is None or letter in systems)


def _of_systems(
    observations: Observations, navigation: Navigation, systems: str | None, files: str
) -> tuple[Observations, tuple[str, ...]]:
    """The observations of the systems to be used, and the names of the other systems."""
    available = {
        "ranges": {name[0] for name in observations.names},
        "orbits": {name[0] for name in navigation.sets.names},
    }
    wanted = chosen(systems)
    used = [letter for letter in wanted if all(letter in there for there in available.values())]
    missing = [
        f"{SYSTEMS[letter].name}'s {what}"
        for letter in wanted
        for what, there in available.items()
        if letter not in there
    ]
    if not used or (systems is not None and missing):
        raise InputError(
            f"{files}: expected ranges and orbits of one system, got no {' and no '.join(missing)}"
        )
    others = [
        SYSTEMS[letter].name
        for letter in SYSTEMS
        if letter in available["ranges"] and letter not in used
    ]
    return observations.of("".join(used)), (
        *others,
        *(OTHERS.get(letter, letter) for letter in observations.others),
    )


def deviations(sigma: ArrayLike | None) -> tuple[Noise, Noise] | None:
    """Noise of ranges and rates from standard deviations at the zenith, m and m/s; None: to be
    estimated.

    ValueError unless they are positive.
    """
    if sigma is None:
        return None
    zenith = finite("sigma", sigma, (2,))
    if not (zenith > 0.0).all():
        raise ValueError(f"sigma: expected positive standard deviations, got {sigma!r}")
    return Noise((0.0,), (float(zenith[0]),)), Noise((0.0,), (float(zenith[1]),))


def mask(degrees: float) -> float:
    """The least elevation in rad; ValueError unless it is from 0 to below 90 degrees."""
    if not 0.0 <= degrees < 90.0:
        raise ValueError(f"mask_deg: expected degrees from 0 to below 90, got {degrees!r}")
    return float(np.radians(degrees))


def _nearest(there: Array) -> Array:
    """Index ``(T,)``, for each epoch, of the nearest epoch at which ``there`` is true."""
    k, epochs = np.flatnonzero(there), np.arange(len(there))
    after = np.clip(np.searchsorted(k, epochs), 0, len(k) - 1)
    before = np.maximum(after - 1, 0)
    return np.asarray(
        np.where(np.abs(k[after] - epochs) < np.abs(k[before] - epochs), k[after], k[before])
    )


def _sources(
    navigation: Navigation,
    rows: Array,
    times: Array,
    code: Array,
    usable: Array,
    position: Array,
    velocity: Array,
) -> pseudorange.Sources:
    """Satellites by epoch ``(T, S)``; values of unusable satellites have no meaning."""
    T, S = rows.shape
    q, w = np.full((T, S, 3), 3e7), np.zeros((T, S, 3))
    clock, drift = np.zeros((T, S)), np.zeros((T, S))
    k, s = np.nonzero(usable)
    sets = navigation.sets.chosen(rows[k, s])
    pairs = pseudorange.emitted_each(sets, times[k], code[k, s], position[k], velocity[k])
    q[k, s], w[k, s], clock[k, s], drift[k, s] = pairs
    return pseudorange.Sources(q, w, clock, drift)


def _geodetic(position: Array) -> tuple[Array, Array, Array]:
    """Latitude and longitude (rad) and height (m), ``(T,)`` each."""
    latitude, longitude, height = (
        np.reshape(v, len(position)) for v in ecef2geodetic(*position.T, ell=ELLIPSOID, deg=False)
    )
    return latitude, longitude, height


def _axes(position: Array) -> Array:
    latitude, longitude, _ = _geodetic(position)
    return local_axes(latitude, longitude)


def _sky(
    navigation: Navigation, times: Array, q: Array, position: Array, hz: Array
) -> tuple[Array, Array, Array, Array]:
    """Elevation and azimuth, rad, the delay of the atmosphere, m, and the variance, m^2, of its
    error; each ``(T, S)``.
    """
    latitude, longitude, height = (v[:, None] for v in _geodetic(position))
    elevation, azimuth = look(q, position, _axes(position))
    above = np.maximum(elevation, LEAST_ELEVATION)
    delay = saastamoinen(latitude, np.clip(height, -1000.0, 11000.0), above)
    alpha, beta = navigation.klobuchar or TYPICAL_IONOSPHERE
    left = BROADCAST_LEFT if navigation.klobuchar else TYPICAL_LEFT
    at_l1 = klobuchar(
        alpha, beta, times[:, None] + GPS_AHEAD_S, latitude, longitude, above, azimuth
    )
    ionosphere = (L1_HZ / hz) ** 2 * at_l1
    variance = atmosphere_variance(above, left * ionosphere)
    return elevation, azimuth, delay + ionosphere, variance


def _orbit_variance(navigation: Navigation, rows: Array, names: list[str]) -> Array:
    """Variance ``(T, S)`` m^2 of ranges from broadcast orbits and clocks. It is larger for a
    satellite that broadcasts a larger error than is usual in its system.
    """
    systems = [SYSTEMS[name[0]] for name in names]
    usual, predicted = np.array([[each.range_error_m, each.accuracy_m] for each in systems]).T
    return np.asarray(
        np.square(usual * np.maximum(navigation.sets.accuracy[rows] / predicted, 1.0))
    )


def _without_jumps(z: Array, fixes: Array, times: Array) -> tuple[Array, Array, Array]:
    """Ranges and clock biases without the steps of whole milliseconds by which the receiver set its
    clock, and the sum of these steps ``(T,)`` m.

    If the clock was set between two fixes that are not neighbors, the epoch of the step is unknown.
    Ranges in between are then left out.
    """
    S, k = z.shape[-1] // 2, np.flatnonzero(np.isfinite(fixes[:, 6]))
    jumps, z, fixes = np.zeros(len(times)), z.copy(), fixes.copy()
    if len(k) > 1:
        step, dt = np.diff(fixes[k, 6]), np.diff(times[k])
        # Without rates the drift is computed from the last two fixes.
        ran = (step - MILLISECOND_M * np.round(step / MILLISECOND_M)) / dt
        drift = fixes[k, 7]
        expected = np.where(
            np.isnan(drift[1:] + drift[:-1]),
            np.concatenate([ran[:1], ran[:-1]]),
            0.5 * (drift[1:] + drift[:-1]),
        )
        whole = MILLISECOND_M * np.round((step - expected * dt) / MILLISECOND_M)
        for last, following in zip(k[:-1][whole != 0.0], k[1:][whole != 0.0], strict=True):
            z[last + 1 : following, :S] = np.nan
        jumps[k[1:]] = whole
        jumps = np.cumsum(jumps)
    z[:, :S] -= jumps[:, None]
    fixes[:, 6] -= jumps
    return z, fixes, jumps
