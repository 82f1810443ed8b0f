"""A car with an inertial unit: a simulated drive in the format of the files, and the real drive if
available.
"""

from __future__ import annotations

import re
import struct
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

from celnav.models import earth
from celnav.real import ins
from celnav.study.study import Results

REAL = next(
    (p / "shared/data/ins" for p in Path(__file__).parents if (p / "shared/data/ins").is_dir()),
    Path("nowhere"),
)
real_only = pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
END_S, DT, START_S = 140.0, 0.01, 1752003258.0
HEADER = (
    "%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) "
    "sdun(m) age(s) ratio vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun"
)


def speed(t):
    """m/s: the car stands for 36 s."""
    return np.where(t > 36.0, 8.0 * (1.0 - np.exp(-np.maximum(t - 36.0, 0.0) / 4.0)), 0.0)


def heading(t):
    return 0.5 + np.where(t > 36.0, 0.8 * np.sin(0.2 * (t - 36.0)), 0.0)


@cache
def made():
    """Rows of the unit, on its axes, and of the solution."""
    rng = np.random.default_rng(0)
    fine = np.arange(-0.5, END_S + 1.0, DT / 2)
    s, psi = speed(fine), heading(fine)
    along, turn = np.gradient(s, fine), np.gradient(psi, fine)
    v = np.stack([s * np.cos(psi), s * np.sin(psi), 0.0 * s], -1)
    p = np.stack([cumulative_simpson(x, x=fine, initial=0.0) for x in v.T], -1)
    own = slice(0, None, 2)
    rate = np.stack([0.0 * turn, 0.0 * turn, turn], -1)[own]
    g = float(earth.normal_gravity(np.radians(40.0), 1600.0))
    force = np.stack([along, s * turn, 0.0 * s - g], -1)[own]
    rate = rate + np.radians(0.05) + 2e-3 * rng.standard_normal(rate.shape)
    force = force + 0.05 + 0.03 * rng.standard_normal(force.shape)
    mounted = Rotation.from_euler("ZYX", ins.MOUNT[::-1])  # unit to car, in scipy's convention
    unit = [mounted.apply(x) for x in (np.degrees(rate), force / 9.80665)]
    at = np.arange(0.0, END_S, 0.25)
    k = np.round((at + 0.5) / (DT / 2)).astype(int)
    return fine[own], unit, at, p[k], v[k] + 0.05 * rng.standard_normal((len(at), 3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive")
    t, (rate, force), at, p, v = made()
    clock = 1000 + np.round(1000.0 * (t - t[0])).astype(int)
    table = [
        ",".join(f"{x:.6f}" for x in (*f, *w)) + f",{c}"
        for f, w, c in zip(force, rate, clock, strict=True)
    ]
    (path / "imu_1.csv").write_text("\n".join(["cut", *table, "cut"]) + "\n")
    start = START_S + t[0] + ins.LATE_S
    head = b"TIMETAG RTKLIB demo5".ljust(60, b"\0")
    last = round(1000.0 * (t[-1] - t[0]))
    (path / "imu_1.csv.tag").write_bytes(
        head + struct.pack("<IId", 0, int(start), start % 1.0) + struct.pack("<IIII", 0, 0, last, 1)
    )
    north, east = earth.radii(np.radians(40.0), 1600.0)
    lines = [HEADER]
    for s, x, u in zip(at, p, v, strict=True):
        latitude = 40.0 + np.degrees(x[0] / north)
        longitude = -105.0 + np.degrees(x[1] / (east * np.cos(np.radians(40.0))))
        clock_s = 14.0 * 60.0 + 18.0 + s
        when = f"2025/07/08 19:{20 + int(clock_s // 60):02d}:{clock_s % 60.0:06.3f}"
        lines.append(
            f"{when} {latitude:.10f} {longitude:.10f} {1600.0 - x[2]:.4f} 1 9 0.01 0.01 0.01 0 0 0 "
            f"0 9 {u[0]:.4f} {u[1]:.4f} {-u[2]:.4f} 0.05 0.05 0.05 0 0 0"
        )
    (path / "gnss_1.pos").write_text("\n".join(lines) + "\n")
    return path


def test_the_log_is_read_on_the_car_s_axes(folder):
    log = ins.log(folder)
    t, _, at, p, v = made()
    assert log.t[0] == pytest.approx(t[0], abs=1e-3)
    rest = log.t < 30.0
    np.testing.assert_allclose(log.force[rest].mean(0), [0.05, 0.05, -9.74], atol=0.02)
    np.testing.assert_allclose(log.t_fix, at, atol=1e-3)
    np.testing.assert_allclose(log.fixes[:, :3], p, atol=0.05)  # the ellipsoid is curved
    np.testing.assert_allclose(log.fixes[:, 3:], v, atol=1e-3)


def test_outages_are_those_of_the_program():
    t = np.arange(0.0, 549.01, 0.25)
    each = ins.outages(t)
    assert len(each) == 11
    np.testing.assert_allclose(each[:2], [[39.875, 54.875], [84.875, 99.875]])
    inside = ins.withheld(t)
    assert (inside == 0).sum() == 60
    assert inside[t < 39.8].max() == -1


@pytest.mark.parametrize("name", ["fixes", "wheels", "smoothed"])
def test_a_made_drive_is_followed(folder, name):
    """Drift, standard deviations and NEES in two outages; a wrong filter's drift would be tens of
    meters.
    """
    config = ins.Drive(folder, **ins.FLOWN[name])
    out = ins.fly(config, [])
    assert out["drift"].shape == (2, 2)
    assert (out["nees"] / 3.0 < 5.0).all(), out
    assert out["worst"].max() < {"fixes": 6.0, "wheels": 2.0, "smoothed": 0.5}[name]
    assert out["sigma"].max() < {"fixes": 12.0, "wheels": 4.0, "smoothed": 0.3}[name]


def test_the_ledger_is_decided_by_what_the_parts_gave():
    """With simulated results each row has a number; a worst case that is too large is not shown."""
    rng = np.random.default_rng(0)
    data = {
        name: {
            "drift": np.abs(rng.standard_normal((11, 2))) + 1.0,
            "sigma": np.ones(11),
            "nees": np.full(11, 3.0),
            "worst": np.full(11, 0.2),
            "nis": np.array(1.0),
        }
        for name in ins.FLOWN
    }
    data["wheels"]["drift"][3, 1] = 11.0
    data["settings"] = {"log_likelihood": np.array([1.0, 2.0, 3.0, 2.0])}
    results = Results(ins.STUDY, 0, 1.0, ins.parts(1.0, Path()), data)
    verdicts = {claim.id: claim.verdict for claim in results.claims()}
    assert verdicts["worst"] == "not shown"
    assert verdicts["smoothed"] == "shown"
    assert verdicts["settings"] == "holds"
    assert verdicts["rest"] == "not shown"
    assert len(ins.table(results)) == len(ins.FLOWN)


def test_the_program_for_files_in_the_documentation_runs(folder, capsys):
    """On a simulated drive, with a slightly rotated and delayed unit."""
    page = (Path(ins.__file__).parents[2] / "docs/howto/inertial.md").read_text(encoding="utf-8")
    program = re.search(r"```py\n(.*?)```", page, re.DOTALL)[1]
    for name, file in (("imu.csv.tag", "imu_1.csv.tag"), ("imu.csv", "imu_1.csv")):
        program = program.replace(f'"{name}"', repr(str(folder / file)))
    program = program.replace('"rover.pos"', repr(str(folder / "gnss_1.pos")))
    exec(program, {})
    ratio, lag = capsys.readouterr().out.splitlines()
    # Positions, half of the components, are exact; velocities contribute (0.05 / 0.06)^2.
    assert 0.2 < float(ratio) < 1.0
    assert float(lag.split()[0].strip("[]")) == pytest.approx(ins.LATE_S, abs=0.02)


@real_only
def test_real_outages():
    """The first two outages of the real log, as in the study."""
    out = ins.fly(ins.Drive(REAL, constrained=True, end_s=150.0), [])
    assert out["drift"].shape == (3, 2)
    assert out["drift"][:, 1].max() == pytest.approx(5.235, abs=0.02)
