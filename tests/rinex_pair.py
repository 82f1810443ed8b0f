"""A small pair of RINEX files of the synthetic constellation, as text."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pymap3d import ecef2geodetic

from celnav.models import pseudorange
from celnav.models.beidou import B1I_HZ, ELLIPSOID, GPS_AHEAD_S, LIGHT
from celnav.receiver.constellation import synthetic
from celnav.receiver.rinex import Observations
from celnav.receiver.sky import GPS_L1_HZ, klobuchar, local_axes, look, saastamoinen

WEEK = 755
TOE = 604800.0 * WEEK + 345600.0
PLACE = np.array([-2611857.0, 4741146.0, 3363676.0])
ALPHA, BETA = (4.6566e-09, 1.4901e-08, -5.9605e-08, -1.1921e-07), (8.192e04, 9.8304e04, -6.5536e04, -5.2429e05)


def constellation():
    b = synthetic(TOE)
    rng = np.random.default_rng(0)
    return replace(b, a0=1e-4 * rng.normal(size=len(b)), a1=1e-11 * rng.normal(size=len(b)), tgd=1e-8 * rng.normal(size=len(b)))


def label(text, name):
    return f"{text:<60}{name:<20}\n"


def civil(t):
    moment = np.datetime64("2006-01-01T00:00:00") + np.timedelta64(round(t), "s")
    return str(moment).replace("T", "-").replace(":", "-").split("-")


def navigation(b, toe=TOE):
    """A navigation file of the sets."""
    text = label(f"{3.04:9.2f}{'':11}{'N: GNSS NAV DATA':<20}{'C: BDS':<20}", "RINEX VERSION / TYPE")
    for name, row in (("GPSA", ALPHA), ("GPSB", BETA)):
        text += label(f"{name} " + "".join(f"{v:12.4E}" for v in row), "IONOSPHERIC CORR")
    text += label("", "END OF HEADER")
    for s, name in enumerate(b.names):
        y, mo, d, h, mi, sec = civil(toe)
        rows = [
            [b.a0[s], b.a1[s], b.a2[s]], [1.0, b.crs[s], b.delta_n[s], b.M0[s]], [b.cuc[s], b.e[s], b.cus[s], b.sqrt_a[s]],
            [b.toe[s] % 604800.0, b.cic[s], b.Omega0[s], b.cis[s]], [b.i0[s], b.crc[s], b.omega[s], b.Omega_dot[s]],
            [b.i_dot[s], 0.0, float(WEEK), 0.0], [2.0, b.health[s], b.tgd[s], 0.0], [345600.0, 0.0],
        ]  # fmt: skip
        text += f"{name} {y} {mo} {d} {h} {mi} {sec}" + "".join(f"{v:19.12E}" for v in rows[0]) + "\n"
        text += "".join("    " + "".join(f"{v:19.12E}" for v in row) + "\n" for row in rows[1:])
    return text


def measurements(b, times, bias):
    """Pseudoranges and Doppler ``(T, S)`` at `PLACE`, by a clock ahead by ``bias`` m, with the atmosphere, in a plain loop."""
    latitude, longitude, height = ecef2geodetic(*PLACE, ell=ELLIPSOID, deg=False)
    code, doppler = np.empty((len(times), len(b))), np.empty((len(times), len(b)))
    for k, (tag, ahead) in enumerate(zip(times, bias, strict=True)):
        t = tag - ahead / LIGHT
        seen = pseudorange.sources(b, t, PLACE)
        sky = look(seen.q, PLACE, local_axes(latitude, longitude))
        above = np.maximum(sky.elevation, 0.05)
        iono = klobuchar(ALPHA, BETA, t + GPS_AHEAD_S, latitude, longitude, above, sky.azimuth)
        z = pseudorange.measure(np.concatenate([PLACE, np.zeros(3), [ahead, 30.0]]), seen.q, seen.w)
        code[k] = z[: len(b)] - seen.clock + (GPS_L1_HZ / B1I_HZ) ** 2 * iono + saastamoinen(latitude, height, above)
        doppler[k] = -(z[len(b) :] - seen.drift) * B1I_HZ / LIGHT
    return code, doppler


def observations(b, times, ahead=14.0, system="GPS"):
    """An observation file at times (s of BDT), and its pseudoranges and Doppler: C19 is away at the second epoch, G01 is there."""
    text = label(f"{3.04:9.2f}{'':11}{'OBSERVATION DATA':<20}{'M: Mixed':<20}", "RINEX VERSION / TYPE")
    text += label("TEST", "MARKER NAME")
    text += label("".join(f"{v:14.4f}" for v in PLACE), "APPROX POSITION XYZ")
    text += label(f"{0.5:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N")
    text += label("G    2 C1C D1C", "SYS / # / OBS TYPES") + label("C    3 C2I L2I D2I", "SYS / # / OBS TYPES")
    y, mo, d, h, mi, sec = civil(times[0] + ahead)
    text += label(f"  {y}    {mo}    {d}    {h}    {mi}   {sec}.0000000     {system}", "TIME OF FIRST OBS") + label(
        "", "END OF HEADER"
    )
    code, doppler = measurements(b, times, 3e4 + 30.0 * (times - times[0]))
    for k, t in enumerate(times):
        rows = [
            f"{name}{code[k, s]:14.3f}  {'':14}  {doppler[k, s]:14.3f}" for s, name in enumerate(b.names) if (k, name) != (1, "C19")
        ]
        if k == 1:
            code[k, b.names.index("C19")] = doppler[k, b.names.index("C19")] = np.nan
        y, mo, d, h, mi, sec = civil(t + ahead)
        text += f"> {y} {mo} {d} {h} {mi} {sec}.0000000  0{len(rows) + 1:3d}\n"
        text += "\n".join(["G01  22000000.000        1000.000", *rows]) + "\n"
    return text, code, doppler


TIMES = TOE + 1800.0 + 30.0 * np.arange(3)


def written(tmp_path, text, name="file.rnx"):
    path = tmp_path / name
    path.write_text(text, encoding="ascii")
    return path


def observed(b, times, bias):
    """A log of a receiver at `PLACE` whose clock is ahead by ``bias`` m."""
    return Observations(Path("obs.rnx"), "TEST", PLACE, times, b.names, *measurements(b, times, bias))
