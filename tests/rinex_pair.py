"""A small pair of RINEX files of the synthetic constellation, as text."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from celnav.models import pseudorange
from celnav.models.gnss import B1I_HZ, GPS_AHEAD_S, L1_HZ, LIGHT
from celnav.receiver.constellation import synthetic
from celnav.receiver.geodesy import ELLIPSOID, ecef2geodetic
from celnav.receiver.rinex import Observations
from celnav.receiver.sky import klobuchar, local_axes, look, saastamoinen

WEEK = 755
TOE = 604800.0 * WEEK + 345600.0
PLACE = np.array([-2611857.0, 4741146.0, 3363676.0])
ALPHA, BETA = (
    (4.6566e-09, 1.4901e-08, -5.9605e-08, -1.1921e-07),
    (8.192e04, 9.8304e04, -6.5536e04, -5.2429e05),
)


def constellation():
    b = synthetic(TOE)
    rng = np.random.default_rng(0)
    return replace(
        b,
        a0=1e-4 * rng.normal(size=len(b)),
        a1=1e-11 * rng.normal(size=len(b)),
        tgd=1e-8 * rng.normal(size=len(b)),
    )


def gps():
    """GPS satellites: four in each of six planes."""
    b = constellation()
    b, k = b.chosen(b.number >= 19.0).chosen(np.arange(24)), np.arange(24)
    angles = {
        "Omega0": np.radians(60.0 * (k // 4) + 25.0),
        "M0": np.radians(90.0 * (k % 4) + 37.0 * (k // 4)),
    }
    return replace(
        b,
        number=k + 1.0,
        system=np.ones(24),
        sqrt_a=np.full(24, np.sqrt(26560e3)),
        e=np.full(24, 0.01),
        **angles,
    )


def galileo():
    """Galileo satellites: eight in each of three planes; I/NAV's clock and group delay."""
    b, k = gps(), np.arange(24)
    angles = {
        "Omega0": np.radians(120.0 * (k // 8) + 65.0),
        "M0": np.radians(45.0 * (k % 8) + 15.0 * (k // 8)),
    }
    return replace(
        b,
        system=np.full(24, 2.0),
        sqrt_a=np.full(24, np.sqrt(29600.3e3)),
        e=np.full(24, 2e-4),
        accuracy=np.full(24, 3.12),
        **angles,
    )


def both():
    """Sets of BeiDou and GPS."""
    return joined(constellation(), gps())


def joined(*parts):
    """Sets of several constellations."""
    return type(parts[0])(
        *(
            np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(parts[0])
        )
    )


def above(b, times):
    """Satellites above 5 degrees at `PLACE` at some of the times, and C05 and C19, for tests.

    Orbits are computed separately for each satellite; satellites below the horizon are never used.
    """
    latitude, longitude, _ = ecef2geodetic(*PLACE, ell=ELLIPSOID, deg=False)
    q = pseudorange.sources(b, np.asarray(times), PLACE[None]).q
    high = look(q, PLACE, local_axes(latitude, longitude)).elevation > np.radians(5.0)
    return b.chosen(high.any(0) | np.isin(b.names, ["C05", "C19"]))


def label(text, name):
    return f"{text:<60}{name:<20}\n"


def civil(t):
    moment = np.datetime64("2006-01-01T00:00:00") + np.timedelta64(round(t), "s")
    return str(moment).replace("T", "-").replace(":", "-").split("-")


def navigation(b, toe=TOE):
    """A navigation file with these sets."""
    text = label(
        f"{3.04:9.2f}{'':11}{'N: GNSS NAV DATA':<20}{'M: MIXED' if b.system.any() else 'C: BDS':<20}",
        "RINEX VERSION / TYPE",
    )
    for name, row in (("GPSA", ALPHA), ("GPSB", BETA)):
        text += label(f"{name} " + "".join(f"{v:12.4E}" for v in row), "IONOSPHERIC CORR")
    text += label("", "END OF HEADER")
    for s, name in enumerate(b.names):
        ahead = 14.0 * (b.system[s] > 0)
        y, mo, d, h, mi, sec = civil(toe + ahead)
        rows = [
            [b.a0[s], b.a1[s], b.a2[s]],
            [1.0, b.crs[s], b.delta_n[s], b.M0[s]],
            [b.cuc[s], b.e[s], b.cus[s], b.sqrt_a[s]],
            [(b.toe[s] + ahead) % 604800.0, b.cic[s], b.Omega0[s], b.cis[s]],
            [b.i0[s], b.crc[s], b.omega[s], b.Omega_dot[s]],
            [b.i_dot[s], 517.0 if name[0] == "E" else 0.0, float(WEEK), 0.0],
            # Galileo's first group delay belongs to the clock of F/NAV.
            [b.accuracy[s] or 2.0, b.health[s]]
            + ([-3e-9, b.tgd[s]] if name[0] == "E" else [b.tgd[s], 0.0]),
            [345600.0, 0.0],
        ]
        text += (
            f"{name} {y} {mo} {d} {h} {mi} {sec}" + "".join(f"{v:19.12E}" for v in rows[0]) + "\n"
        )
        text += "".join("    " + "".join(f"{v:19.12E}" for v in row) + "\n" for row in rows[1:])
    return text


def measurements(b, times, bias, offset=0.0):
    """Pseudoranges and Doppler ``(T, S)`` at `PLACE` for a clock that is ahead by ``bias`` m, with
    the atmosphere, in a plain loop.

    ``offset``: m, by which the clock is further ahead of the GPS clock.
    """
    hz = np.where(b.system > 0, L1_HZ, B1I_HZ)
    latitude, longitude, height = ecef2geodetic(*PLACE, ell=ELLIPSOID, deg=False)
    code, doppler = np.empty((len(times), len(b))), np.empty((len(times), len(b)))
    for k, (tag, ahead) in enumerate(zip(times, bias, strict=True)):
        t = tag - ahead / LIGHT
        seen = pseudorange.sources(b, t, PLACE)
        sky = look(seen.q, PLACE, local_axes(latitude, longitude))
        above = np.maximum(sky.elevation, 0.05)
        iono = klobuchar(ALPHA, BETA, t + GPS_AHEAD_S, latitude, longitude, above, sky.azimuth)
        z = pseudorange.measure(np.concatenate([PLACE, np.zeros(3), [ahead, 30.0]]), seen.q, seen.w)
        code[k] = (
            z[: len(b)]
            - seen.clock
            + (L1_HZ / hz) ** 2 * iono
            + saastamoinen(latitude, height, above)
            + offset * (b.system == 1)
        )
        doppler[k] = -(z[len(b) :] - seen.drift) * hz / LIGHT
    return code, doppler


def observations(b, times, ahead=14.0, system="GPS", offset=0.0):
    """An observation file at times (s of BDT), and its pseudoranges and Doppler. C19 is missing at
    the second epoch, G01 is not.
    """
    text = label(
        f"{3.04:9.2f}{'':11}{'OBSERVATION DATA':<20}{'M: Mixed':<20}", "RINEX VERSION / TYPE"
    )
    text += label("TEST", "MARKER NAME")
    text += label("".join(f"{v:14.4f}" for v in PLACE), "APPROX POSITION XYZ")
    text += label(f"{0.5:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N")
    text += label("G    2 C1C D1C", "SYS / # / OBS TYPES") + label(
        "C    3 C2I L2I D2I", "SYS / # / OBS TYPES"
    )
    if (b.system == 2).any():
        text += label("E    2 C1C D1C", "SYS / # / OBS TYPES")
    y, mo, d, h, mi, sec = civil(times[0] + ahead)
    text += label(
        f"  {y}    {mo}    {d}    {h}    {mi}   {sec}.0000000     {system}", "TIME OF FIRST OBS"
    ) + label("", "END OF HEADER")
    code, doppler = measurements(b, times, 3e4 + 30.0 * (times - times[0]), offset)
    for k, t in enumerate(times):
        rows = [
            f"{name}{code[k, s]:14.3f}  {' ' * 16 if name[0] == 'C' else ''}{doppler[k, s]:14.3f}"
            for s, name in enumerate(b.names)
            if (k, name) != (1, "C19")
        ]
        if not b.system.any():  # of BeiDou alone
            rows = ["G01  22000000.000        1000.000", *rows]
        if k == 1 and "C19" in b.names:
            code[k, b.names.index("C19")] = doppler[k, b.names.index("C19")] = np.nan
        y, mo, d, h, mi, sec = civil(t + ahead)
        text += f"> {y} {mo} {d} {h} {mi} {sec}.0000000  0{len(rows):3d}\n"
        text += "\n".join(rows) + "\n"
    return text, code, doppler


TIMES = TOE + 1800.0 + 30.0 * np.arange(3)


def written(tmp_path, text, name="file.rnx"):
    path = tmp_path / name
    path.write_text(text, encoding="ascii")
    return path


def observed(b, times, bias, offset=0.0):
    """A log of a receiver at `PLACE` whose clock is ahead by ``bias`` m, and ahead of the GPS clock
    by ``offset`` m more.
    """
    return Observations(
        Path("obs.rnx"), "TEST", PLACE, times, b.names, *measurements(b, times, bias, offset)
    )


def modeled_errors(log, rng):
    """Errors of ranges ``(T, S)`` m with the variances that a prepared log assumes for atmosphere
    and orbits.
    """
    return np.sqrt(log.modeled) * rng.normal(size=log.modeled.shape)
