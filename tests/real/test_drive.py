"""Files of a drive: simulated files are read back, and damaged files raise an
error with the line.
"""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest

from celnav.files import InputError
from celnav.models import earth
from celnav.real import drive

HEADER = "%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s) ratio"
SPEED = " vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun"
FIX = "2025/07/08 19:34:{:06.3f} 40.1 -105.2 1601.5 1 21 0.01 0.02 0.03 0 0 0 0 9"
RATES = " 1.0 2.0 3.0 0.05 0.06 0.07 0 0 0"


def solution(path, lines):
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_solution_with_velocity(tmp_path):
    lines = [
        "% program: x",
        HEADER + SPEED,
        *(FIX.format(18.499 + 0.25 * k) + RATES for k in range(3)),
    ]
    fixes = drive.read_pos(solution(tmp_path / "a.pos", lines))
    np.testing.assert_allclose(np.diff(fixes.t), 0.25, atol=1e-6)
    assert fixes.t[0] == pytest.approx(1752003258.499, abs=1e-6)
    np.testing.assert_allclose(np.degrees([fixes.latitude[0], fixes.longitude[0]]), [40.1, -105.2])
    np.testing.assert_array_equal(fixes.velocity[0], [1.0, 2.0, -3.0])
    np.testing.assert_array_equal(fixes.sigma_position[1], [0.01, 0.02, 0.03])
    np.testing.assert_array_equal(fixes.sigma_velocity[1], [0.05, 0.06, 0.07])
    assert fixes.quality.tolist() == [1, 1, 1]
    packed = tmp_path / "a.pos.gz"
    packed.write_bytes(gzip.compress((tmp_path / "a.pos").read_bytes()))
    np.testing.assert_array_equal(drive.read_pos(packed).t, fixes.t)


def test_a_solution_without_velocity(tmp_path):
    fixes = drive.read_pos(solution(tmp_path / "a.pos", [HEADER, FIX.format(1.0)]))
    assert np.isnan(fixes.velocity).all()
    assert fixes.height_m.tolist() == [1601.5]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([FIX.format(1.0)], "expected a header line % GPST .*, got none with GPST, latitude"),
        ([HEADER.replace("Q", "q"), FIX.format(1.0)], "got none with Q$"),
        ([HEADER.replace("GPST", "UTC"), FIX.format(1.0)], "got none with GPST$"),
        ([HEADER, FIX.format(1.0) + " 7"], "line 2: expected a date, a time and 13 numbers"),
        ([HEADER, FIX.format(1.0)[:60]], "line 2: expected a date, a time and 13 numbers"),
        ([HEADER, FIX.format(1.0).replace("21", "nan")], "line 2: expected a date"),
        ([HEADER, FIX.format(1.0).replace("07/08", "13/08")], "line 2: expected a date"),
        ([HEADER, FIX.format(2.0), FIX.format(1.0)], "expected increasing times"),
        ([HEADER], "expected fixes, got none"),
    ],
)
def test_what_is_no_solution_is_refused(tmp_path, lines, message):
    with pytest.raises(InputError, match=message):
        drive.read_pos(solution(tmp_path / "a.pos", lines))


def tags(path, ticks=(131, 146, 1131)):
    head = b"TIMETAG RTKLIB demo5".ljust(60, b"\0") + struct.pack("<IId", 7, 1752003261, 0.25)
    path.write_bytes(
        head + b"".join(struct.pack("<II", tick, 40 * k) for k, tick in enumerate(ticks))
    )
    return path


SAMPLES = ["0.1,0.0", *(f"0.0,0.5,1.0,10.0,-20.0,0.0,{500 + 10 * k}" for k in range(101)), "0.1"]


def test_samples_by_time_tags(tmp_path):
    """The unit's clock is scaled to the tags: 1 s on it is 1.131 s."""
    table = solution(tmp_path / "a.csv", SAMPLES)
    samples = drive.read_imu(table, tags(tmp_path / "a.tag"))
    assert samples.t[0] == 1752003261.25
    assert samples.t[-1] == pytest.approx(1752003262.381, abs=1e-6)
    np.testing.assert_allclose(samples.force[5], [0.0, 0.5 * 9.80665, 9.80665])
    np.testing.assert_allclose(np.degrees(samples.rate[5]), [10.0, -20.0, 0.0])


def test_what_is_no_sample_is_refused(tmp_path):
    tagged = tags(tmp_path / "a.tag")
    for k, line, message in (
        (3, "1,2,3", "line 4: expected seven numbers"),
        (9, SAMPLES[8], "line 10: expected an increasing clock"),
    ):
        lines = SAMPLES.copy()
        lines[k] = line
        with pytest.raises(InputError, match=message):
            drive.read_imu(solution(tmp_path / "a.csv", lines), tagged)
    with pytest.raises(InputError, match="expected four lines or more"):
        drive.read_imu(solution(tmp_path / "a.csv", SAMPLES[:3]), tagged)
    with pytest.raises(InputError, match="expected time tags of RTKLIB"):
        drive.read_tags(tmp_path / "a.csv")


def test_local_positions_are_those_of_pymap3d():
    pymap3d = pytest.importorskip("pymap3d")
    rng = np.random.default_rng(0)
    origin = 0.7, -1.8, 1600.0
    L, lon, h = (o + s * rng.uniform(-1.0, 1.0, 5) for o, s in zip(origin, (0.01, 0.01, 500.0)))
    found = earth.local_position(L, lon, h, origin)
    expected = pymap3d.geodetic2ned(L, lon, h, *origin, deg=False)
    np.testing.assert_allclose(found, np.stack(expected, -1), atol=1e-6)
    np.testing.assert_allclose(earth.local_position(*origin, origin), np.zeros(3), atol=1e-9)
