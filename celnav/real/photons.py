"""Files of a pulsar observation in X-rays: photons, orbit of the satellite, timing model of the
pulsar.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from celnav.files import InputError
from celnav.gaussian.linalg import Array
from celnav.lazy import requires_extra
from celnav.models.ephemeris import DAY_S, Tdb, de421, from_tt
from celnav.models.pulsar import LIGHT_KM_S, Pulsar, Timing
from celnav.real import found

CHANNELS, LEAST_PHOTONS, LEAST_S = (5, 49), 1000, 480.0
"""Detector channels in use; minimum number of photons, and minimum time."""


class Spin(NamedTuple):
    """A timing model: pulsar; epoch (MJD, TDB); frequency and its derivatives ``rates (k,)``, 1/s,
    1/s^2, ...
    """

    pulsar: Pulsar
    epoch: float
    rates: Array

    def cycles(self, t: Array) -> Array:
        """Cycles since the epoch, ``t`` s after it at the barycenter."""
        out = np.zeros_like(t)
        for order in range(len(self.rates), 0, -1):  # Horner's scheme for t f0 + t^2 f1 / 2 + ...
            out = t / order * (self.rates[order - 1] + out)
        return out


class Photons(NamedTuple):
    """Photons of an observation.

    t, since: ``(N,)`` s, since the first photon, and since the spin's epoch (TDB). place: ``(N,
    3)`` km, geocentric position of the satellite. earth, sun: ``(N, 3)`` km, barycentric
    positions.
    """

    t: Array
    since: Array
    place: Array
    earth: Array
    sun: Array
    spin: Spin

    @property
    def along(self) -> Array:
        """Position of the satellite toward the pulsar, ``(N,)`` km."""
        return np.asarray(self.place @ self.spin.pulsar.direction)

    def cycles(self, part: float | None) -> Array:
        """Cycles ``(N,)`` with the satellite at a fraction of its distance from the Earth's center;
        None uses the uncorrected times of its clock.
        """
        if part is None:
            return self.spin.cycles(self.since)
        delay = Timing([self.spin.pulsar]).delay(self.earth + part * self.place, self.sun)[:, 0]
        return self.spin.cycles(self.since + delay / LIGHT_KM_S)


def table(
    path: Path, extension: str, columns: tuple[str, ...]
) -> tuple[Mapping[str, Any], list[Array]]:
    """Header and columns ``(N,)``, as float64, of a binary table in a FITS file.

    Raises
    ------
    ImportError: if astropy is missing; the message says how to install it. InputError: naming the
    file, if it is damaged or not a FITS file.
    """
    with requires_extra(f"{path}: a FITS file", "real"):
        from astropy.io import fits

    content = path.read_bytes()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with fits.open(BytesIO(content)) as file:
                hdu = file[extension]
                values = [np.asarray(hdu.data[name], np.float64) for name in columns]
                header = {
                    key: hdu.header[key] for key in ("MJDREFI", "MJDREFF", "TIMEZERO", "TIMESYS")
                }
                offsets = [float(header[key]) for key in ("MJDREFI", "MJDREFF", "TIMEZERO")]
    except Exception as error:  # astropy raises many kinds of errors
        raise InputError(
            f"{path}: expected a FITS file with a table {extension} of {', '.join(columns)} "
            f"({error})"
        ) from None
    if header["TIMESYS"] != "TT" or not np.isfinite(offsets).all() or not 4e4 < offsets[0] < 1e5:
        raise InputError(f"{path}: expected times in TT after MJDREFI + MJDREFF, got {header}")
    for name, column in zip(columns, values, strict=True):
        if column.ndim != 1 or not len(column) or not np.isfinite(column).all():
            raise InputError(f"{path}: expected finite numbers (N,) in {name}, got {column!r:.80}")
    if (np.diff(values[0]) < 0.0).any():
        raise InputError(f"{path}: expected times that do not decrease in {columns[0]}, got others")
    return header, values


def read_par(path: Path) -> Spin:
    """Read a timing model in the format of tempo.

    Raises
    ------
    InputError: naming the file, and the line or the missing name; for a pulsar with a companion.
    """
    try:
        words = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: expected a timing model, with a name and a value on each line ({error})"
        ) from None
    entries = {word[0].upper(): word[1] for word in words if len(word) > 1}
    if "BINARY" in entries or "PB" in entries:
        raise InputError(
            f"{path}: expected a pulsar without a companion, got one with it; binary orbits are "
            "not modeled"
        )
    if missing := {"RAJ", "DECJ", "F0", "PEPOCH"} - entries.keys():
        raise InputError(
            f"{path}: expected a timing model with {', '.join(sorted(missing))}, got one without"
        )
    if entries.get("UNITS", "TDB") != "TDB":
        raise InputError(f"{path}: expected UNITS TDB, got {entries['UNITS']}")

    def value(name: str) -> float:
        try:
            number = float(entries[name].replace("D", "e").replace("d", "e"))
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise InputError(f"{path}: expected a number as {name}, got {entries[name]!r:.40}")
        return number

    def angle(name: str) -> float:
        parts = re.fullmatch(r"([+-]?)(\d+):(\d+):(\d+(?:\.\d*)?)", entries[name], re.ASCII)
        if parts is None:
            raise InputError(f"{path}: expected {name} as 15:13:55.62, got {entries[name]!r:.40}")
        sign, *sixties = parts.groups()
        degrees = sum(float(part) / 60.0**i for i, part in enumerate(sixties))
        return -degrees if sign == "-" else degrees

    rates = [value("F0")]
    while (name := f"F{len(rates)}") in entries:
        rates.append(value(name))
    if not 1e-3 < rates[0] < 1e4:
        raise InputError(f"{path}: expected F0 in pulses per second, got {rates[0]!r}")
    try:
        pulsar = Pulsar(
            entries.get("PSRJ", path.stem),
            15.0 * angle("RAJ"),
            angle("DECJ"),
            4.4,
            1.0 / rates[0],
            0.3 / rates[0],
            1.0,
            1.0,
        )
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return Spin(pulsar, value("PEPOCH"), np.array(rates))


@lru_cache(maxsize=2)
def read(folder: Path) -> Photons:
    """Read events (``*.fits*``), orbit (``FPorbit*``) and timing model (``*.par``) of a folder.

    Raises
    ------
    FileNotFoundError: naming the folder. ImportError, InputError: see `table` and `read_par`.
    InputError also if the orbit does not cover the events, or if there are too few events.
    """
    events, orbit, model = found(folder, ["*.fits*", "FPorbit*", "*.par"])
    spin = read_par(model)
    header, (t, channel) = table(events, "XTE_SE", ("TIME", "PHA"))
    flown, (at, *state) = table(orbit, "XTE_PE", ("Time", "X", "Y", "Z", "Vx", "Vy", "Vz"))
    t = t[(channel >= CHANNELS[0]) & (channel <= CHANNELS[1])]
    begun = [
        float(h["MJDREFI"]) + float(h["MJDREFF"]) + float(h["TIMEZERO"]) / DAY_S
        for h in (header, flown)
    ]
    if len(t) < LEAST_PHOTONS or t[-1] - t[0] < LEAST_S:
        raise InputError(
            f"{events}: expected at least {LEAST_PHOTONS} photons in at least {LEAST_S:g} s, got "
            f"{len(t)}"
        )
    met = t + (begun[0] - begun[1]) * DAY_S
    if (np.diff(at) <= 0.0).any() or met[0] < at[0] or met[-1] > at[-1]:
        raise InputError(
            f"{orbit}: expected the orbit from {met[0]:.0f} to {met[-1]:.0f} s, got {at[0]:.0f} to "
            f"{at[-1]:.0f}"
        )
    r, v = np.stack(state[:3], 1) / 1e3, np.stack(state[3:], 1) / 1e3
    radius = np.linalg.norm(r, axis=1)
    if radius.min() < 6378.0 or radius.max() > 1e6:
        raise InputError(
            f"{orbit}: expected positions (m) above the Earth, got {radius.min():.0f} to "
            f"{radius.max():.0f} km from its center"
        )
    near = slice(np.searchsorted(at, met[0], "right") - 1, np.searchsorted(at, met[-1]) + 1)
    place = CubicHermiteSpline(at[near], r[near], v[near])(met)
    rest = header["MJDREFF"] + (t + float(header["TIMEZERO"])) / DAY_S
    date = from_tt(np.full(len(t), 2400000.5 + header["MJDREFI"]), rest)
    since = date.since(Tdb(2400000.5, spin.epoch))
    earth, sun = (de421().state(body, date).position for body in ("earth", "sun"))
    return Photons(t - t[0], since, place, earth, sun, spin)
