"""Arrival times of millisecond pulsars, their timing models, fixes of the Earth, and ephemerides.

With ``n`` the direction of a pulsar and ``d`` the error of the Earth's position in its ephemeris,
pulses arrive ``n.d`` km early. The timing model of a pulsar has phase, spin and spin-down,
position, proper motion and parallax. Each is a column of a linear model. Besides the reported
noise, there are white noise and a random walk of the spin. Their sizes maximize the restricted
likelihood. The fit absorbs position errors that resemble its columns: a constant or yearly error,
and most of a slow error [Blandford1984].

We use the released residuals [Agazie2023], from models fitted to all years. For the columns above,
a new fit to some years removes the effect of the first fit exactly. Binary orbits and dispersion
still depend on all years.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import minimize

from celnav.files import InputError, data, read_npz
from celnav.gaussian.linalg import Array
from celnav.models.ephemeris import DAY_S, GM, Tdb, de421
from celnav.models.pulsar import LIGHT_KM_S
from celnav.real import found

YEAR, WEEK, AU_S = 365.25, 7.0, 499.00478384
LEAST_DAYS, LEAST_YEARS = 30, 3.0
"""Minimum number of days, and minimum time, of a pulsar's earlier observations."""


# -- arrival times and timing models ---------------------------------------------------------------
class Arrivals(NamedTuple):
    """Daily averages of a pulsar.

    n: direction ``(3,)``. day: ``(N,)``, MJD. late, sigma: ``(N,)`` km, delay and its standard
    deviation. earth: position of the Earth, ``(N, 3)`` AU.
    """

    name: str
    n: Array
    day: Array
    late: Array
    sigma: Array
    earth: Array


@lru_cache(maxsize=2)
def read(folder: Path) -> tuple[Arrivals, ...]:
    """Read the pulsars of ``daily_averages.npz`` in a folder.

    Raises
    ------
    FileNotFoundError: naming the folder. InputError: naming the file, and the first invalid row.
    """
    (path,) = found(folder, ["daily_averages.npz"])
    try:
        stored = read_npz(path)
    except ValueError as error:
        raise InputError(str(error)) from None
    names, rows = stored.get("names", np.zeros(0, str)), stored.get("epochs", np.zeros(0))
    if (
        names.ndim != 1
        or names.dtype.kind != "U"
        or rows.ndim != 2
        or rows.shape[1] != 11
        or rows.dtype.kind != "f"
    ):
        raise InputError(
            f"{path}: expected names (pulsars,) and epochs (N, 11), got {names.shape} and "
            f"{rows.shape}"
        )
    which, far = rows[:, 1], np.linalg.norm(rows[:, 7:10], axis=1) / AU_S
    right = {
        "finite numbers": np.isfinite(rows).all(1),
        "days after 1990 (MJD)": (rows[:, 0] > 47892.0) & (rows[:, 0] < 1e5),
        "an index of a pulsar among the names": (which >= 0)
        & (which < len(names))
        & (which == np.round(which)),
        "a standard deviation above 0 and below 1 s": (rows[:, 3] > 0.0) & (rows[:, 3] < 1.0),
        "a direction of length 1": np.abs(np.linalg.norm(rows[:, 4:7], axis=1) - 1.0) < 1e-6,
        "the Earth within 0.97 to 1.03 AU of the barycenter": (far > 0.97) & (far < 1.03),
    }
    for expected, well in right.items():
        if not well.all():
            bad = int(np.argmin(well))
            raise InputError(
                f"{path}: expected {expected}, got row {bad}: "
                f"{np.array2string(rows[bad], precision=6)}"
            )
    each = ((str(name), rows[which == i]) for i, name in enumerate(names))
    sets = ((name, r[np.argsort(r[:, 0], kind="stable")]) for name, r in each if len(r))
    return tuple(
        Arrivals(
            name, r[0, 4:7], r[:, 0], LIGHT_KM_S * r[:, 2], LIGHT_KM_S * r[:, 3], r[:, 7:10] / AU_S
        )
        for name, r in sets
    )


def model(a: Arrivals) -> Array:
    """Columns ``(N, 8)`` of a timing model: phase, spin, spin-down, position (2), proper motion
    (2), parallax.
    """
    years = (a.day - a.day[0]) / YEAR / 10.0
    east = np.cross([0.0, 0.0, 1.0], a.n)
    east /= np.linalg.norm(east)
    sky = a.earth @ np.stack([east, np.cross(a.n, east)], 1)
    parallax = (a.earth @ a.n) ** 2 - (a.earth**2).sum(1)
    return np.column_stack(
        [np.ones_like(years), years, years**2, sky, sky * years[:, None], parallax]
    )


def walk(a: Arrivals) -> Array:
    """Covariance ``(N, N)`` of the phase for a random walk of the spin, 1 km/year in each year."""
    t = (a.day - a.day[0]) / YEAR
    low, high = np.minimum.outer(t, t), np.maximum.outer(t, t)
    return np.asarray(low * low * (3.0 * high - low) / 6.0)


class Clock(NamedTuple):
    """A pulsar as a clock, with a timing model fitted to its past.

    arrivals: all arrivals. before, after: ``(N,)`` bool, arrivals used in the fit, and predicted
    arrivals. early: ``(k,)`` km, predicted minus observed times of the predicted arrivals. cov:
    ``(k, k)``, covariance of ``early``. weights: ``(k, N0)``; the prediction is ``weights @
    late[before]``. noise: additional white noise (km), random walk of the spin (km/year in a year).
    """

    arrivals: Arrivals
    before: Array
    after: Array
    early: Array
    cov: Array
    weights: Array
    noise: tuple[float, float]

    def seen(self, moved: Array, learned: bool) -> Array:
        """Change of ``early``, ``(k, ...)`` km, for a displacement ``moved (N, 3, ...)`` km of the
        Earth.

        learned: whether the timing model was fitted with the same displacement.
        """
        sooner = np.tensordot(self.arrivals.n, moved, (0, 1))
        return np.asarray(
            sooner[self.after] - np.tensordot(self.weights, sooner[self.before], 1) * learned
        )


def sized(late: Array, sigma: Array, M: Array, K: Array) -> tuple[float, float]:
    """White noise and random walk of the spin with the largest restricted likelihood. This
    likelihood does not depend on the parameters of the timing model.
    """

    def loss(logs: Array) -> float:
        white, red = np.exp(logs)
        L = np.linalg.cholesky(np.diag(sigma**2 + white**2) + red**2 * K)
        R = np.abs(
            np.linalg.qr(solve_triangular(L, np.column_stack([M, late]), lower=True), mode="r")
        )
        return float(
            np.log(L.diagonal()).sum() + np.log(R.diagonal()[:-1]).sum() + 0.5 * R[-1, -1] ** 2
        )

    starts = ([-3.0, -4.6], [-3.0, -1.2])
    best = min(
        (
            minimize(loss, s, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.01})
            for s in starts
        ),
        key=lambda r: r.fun,
    )
    white, red = np.exp(best.x)
    return float(white), float(red)


@lru_cache(maxsize=4)
def clocks(folder: Path, split: float, end: float) -> tuple[Clock, ...]:
    """Pulsars with enough observations before ``split`` (MJD), with their timing models, until
    ``end``.
    """
    out = []
    for a in read(folder):
        before, after = a.day < split, (a.day >= split) & (a.day < end)
        if before.sum() < LEAST_DAYS or split - a.day[0] < LEAST_YEARS * YEAR or not after.any():
            continue
        M, K = model(a), walk(a)
        white, red = sized(a.late[before], a.sigma[before], M[before], K[np.ix_(before, before)])
        V = np.diag(a.sigma**2 + white**2) + red**2 * K
        L = np.linalg.cholesky(V[np.ix_(before, before)])
        columns, shared = (
            solve_triangular(L, x, lower=True) for x in (M[before], V[np.ix_(before, after)])
        )
        Q, R = np.linalg.qr(columns)
        left = solve_triangular(R, (M[after] - shared.T @ columns).T, trans="T").T
        weights = solve_triangular(L, (shared.T + left @ Q.T).T, lower=True, trans="T").T
        cov = V[np.ix_(after, after)] - shared.T @ shared + left @ left.T
        early = weights @ a.late[before] - a.late[after]
        out.append(Clock(a, before, after, early, cov, weights, (white, red)))
    if not out:
        raise InputError(
            f"{folder}: expected pulsars with {LEAST_YEARS:g} years of observations before MJD "
            f"{split:.0f}, got none"
        )
    return tuple(out)


# -- fixes -----------------------------------------------------------------------------------------
class Weeks(NamedTuple):
    """Weeks with a fix.

    day: middle of the week (MJD) ``(T,)``. R, y: equations ``y (T, 3, ...) = R (T, 3, 3) d`` plus
    noise of unit covariance. heard: number of pulsars ``(T,)``.
    """

    day: Array
    R: Array
    y: Array
    heard: Array

    @property
    def fix(self) -> Array:
        """Least-squares positions of the Earth ``(T, 3, ...)`` km, relative to its ephemeris."""
        return np.linalg.solve(self.R, self.y.reshape(*self.y.shape[:2], -1)).reshape(self.y.shape)

    @property
    def std(self) -> Array:
        """Predicted σ ``(T,)`` km of the fix: root of the sum of the three variances."""
        return np.asarray(
            np.linalg.norm(
                np.linalg.solve(self.R, np.broadcast_to(np.eye(3), self.R.shape)), axis=(1, 2)
            )
        )


def weekly(
    heard: Sequence[Clock], early: Sequence[Array], start: float, end: float, least: int = 6
) -> Weeks:
    """Weekly least-squares fixes from the early arrivals of each clock, ``(k, ...)`` km."""
    day, R, y, count = [], [], [], []
    days = [c.arrivals.day[c.after] for c in heard]
    for first in np.arange(start, end, WEEK):
        rows = [np.flatnonzero((d >= first) & (d < first + WEEK)) for d in days]
        there = [(c, k, z) for c, k, z in zip(heard, rows, early, strict=True) if len(k)]
        if len(there) < least:
            continue
        L = np.linalg.cholesky(block_diag(*(c.cov[np.ix_(k, k)] for c, k, _ in there)))
        H = np.concatenate([np.tile(c.arrivals.n, (len(k), 1)) for c, k, _ in there])
        z = np.concatenate([z[k] for _, k, z in there])
        Q, upper = np.linalg.qr(solve_triangular(L, H, lower=True))
        # A positive diagonal, so that the components of successive weeks correspond.
        sign = np.copysign(1.0, upper.diagonal())
        Q, upper = Q * sign, upper * sign[:, None]
        white = solve_triangular(L, z.reshape(len(z), -1), lower=True)
        day.append(first + 0.5 * WEEK)
        R.append(upper)
        y.append((Q.T @ white).reshape(3, *z.shape[1:]))
        count.append(len(there))
    if len(day) < 2:
        raise InputError(
            f"expected two weeks or more with {least} observed pulsars, got {len(day)}"
        )
    return Weeks(np.array(day), np.stack(R), np.stack(y), np.array(count))


def remembered(
    heard: Sequence[Clock], early: Sequence[Array], day: Array, moves: Array
) -> tuple[Array, Array]:
    """Weekly equations of arrivals, whitened by earlier arrivals of the same pulsar: ``y (T, 12) =
    H (T, 12, 12) x`` plus unit noise.

    The earlier arrivals determine the error of the timing model.

    moves: transition matrices ``(T, 12, 12)`` from the first week to each of the weeks
    ``day (T,)``.
    """
    rows, weeks = [], []
    for c, z in zip(heard, early, strict=True):
        week = np.searchsorted(day + 0.5 * WEEK, c.arrivals.day[c.after], "right")
        there = week < len(day)
        A = c.arrivals.n @ (moves[:, :3] + moves[:, 6:9])[week[there]]
        L = np.linalg.cholesky(c.cov[np.ix_(there, there)])
        rows.append(solve_triangular(L, np.column_stack([A, z[there]]), lower=True))
        weeks.append(week[there])
    every, week = np.concatenate(rows), np.concatenate(weeks)
    padded = (np.concatenate([every[week == k], np.zeros((13, 13))]) for k in range(len(day)))
    R = np.stack([np.linalg.qr(part, mode="r")[:12] for part in padded])
    return np.asarray(np.linalg.solve(moves.mT, R[..., :12].mT).mT), R[..., 12]


# -- ephemerides -----------------------------------------------------------------------------------
@lru_cache(maxsize=1)
def differences() -> dict[str, CubicSpline]:
    """DE440 minus an older ephemeris, from ``data/ephemeris_years.npz``: splines of ``(T, 3)`` km
    by day (MJD). Keys name ephemeris and body (Earth or Sun), such as "de405/sun".
    """
    t = read_npz(data("ephemeris_years.npz"))
    new = {body: t[f"de440-de421/{body}"] for body in ("earth", "sun")}
    old = {
        f"de405/{body}": difference - t[f"de405-de421/{body}"] for body, difference in new.items()
    }
    return {
        name: CubicSpline(t["mjd"], d)
        for name, d in ({f"de421/{body}": d for body, d in new.items()} | old).items()
    }


def transition(start: float, end: float) -> Array:
    """Transition matrix ``(6, 6)`` of a small error of the Earth's orbit about the Sun, from one
    day (MJD) to another.
    """
    steps = max(1, round(2.0 * (end - start)))
    at = Tdb(2400000.5, start + (end - start) * np.arange(2 * steps + 1) / (2 * steps))
    r = de421().state("earth", at).position - de421().state("sun", at).position
    size, A = np.linalg.norm(r, axis=1)[:, None, None], np.zeros((len(r), 6, 6))
    A[:, :3, 3:] = np.eye(3)
    A[:, 3:, :3] = GM["sun"] * (3.0 * r[:, :, None] * r[:, None] / size**5 - np.eye(3) / size**3)
    Phi, h = np.eye(6), (end - start) * DAY_S / steps
    for a, b, c in zip(A[:-1:2], A[1::2], A[2::2], strict=True):  # Runge-Kutta of order 4
        k1 = a @ Phi
        k2 = b @ (Phi + 0.5 * h * k1)
        k3 = b @ (Phi + 0.5 * h * k2)
        Phi = Phi + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + c @ (Phi + h * k3))
    return Phi
