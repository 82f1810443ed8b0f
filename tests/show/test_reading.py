"""Recordings read back: bit for bit, and with a word for each file that is none of ours."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
import rerun as rr

import celnav
from celnav.show import colors, recording, views

TIMES = np.arange(30) / 10.0


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.rrd"


def write(path, draw, **about):
    layout = views.plot("plots", "plots")
    with recording.recording(path, TIMES, name="a test", layout=layout, **about) as out:
        draw(out)
    return celnav.show.read(path)


def test_what_was_logged_comes_back_bit_for_bit(path):
    rng = np.random.default_rng(0)
    exact = {
        "time": rng.standard_normal(30) * 1e-300,
        "one": rng.standard_normal((30, 1)) * 1e300,
        "mean": rng.standard_normal((30, 3)),
        "covariance": rng.standard_normal((30, 3, 3)),
        "runs": rng.standard_normal((30, 2, 1, 3)),
    }
    exact["mean"][4, 1], exact["mean"][5, 0], exact["mean"][6] = np.nan, -0.0, np.inf
    found = write(path, lambda out: out.exact("state/ukf", **exact))
    entity = found["state/ukf"]
    assert set(entity.values) == set(exact)
    for name, values in exact.items():
        assert entity[name].shape == values.shape
        assert entity[name].tobytes() == values.tobytes()
    np.testing.assert_array_equal(entity.times, TIMES)
    assert found.end == found.start == 2.9


def test_a_name_that_had_integers_keeps_real_numbers(tmp_path):
    """rerun stores the type that a name has first in a process."""
    whole, real = np.arange(30), np.arange(30) + 0.5
    for k, values in enumerate((whole, real)):
        found = write(
            tmp_path / f"{k}.rrd",
            lambda out, values=values: out.exact("a", x=values),
            properties={"x": (0, 0.5)[k]},
        )
        np.testing.assert_array_equal(found["a"]["x"], values)
        assert found.facts["x"] == (0, 0.5)[k]


def test_curves_have_gaps_and_geometry_is_single_precision(path):
    rng = np.random.default_rng(0)
    curve, points, cloud = (rng.standard_normal((30, *k)) for k in ((), (3,), (4, 3)))
    curve[3], points[5], cloud[7, 2] = np.nan, np.nan, np.nan

    def draw(out):
        out.curve("plots/a", curve, colors.TRUTH, "a")
        out.bounds("plots/a", np.abs(curve), "a")
        out.points("world/one", points, colors.TRUTH)
        out.points("world/cloud", cloud, colors.TRUTH)
        out.text("info", "# a text")

    found = write(path, draw)
    assert found["plots/a"]["scalars"].tobytes() == curve.tobytes()
    half = 3.0 * np.abs(curve)
    np.testing.assert_array_equal(found["plots/a/3s"]["scalars"], np.stack([-half, half], 1))
    np.testing.assert_array_equal(found["world/one"]["positions"], points.astype(np.float32))
    short = cloud.astype(np.float32)
    short[7, 2:] = [short[7, 3], [np.nan] * 3]  # the missing point is the last of its row
    np.testing.assert_array_equal(found["world/cloud"]["positions"], short)
    assert "info" not in found.entities


def test_facts_and_the_start_come_back(path):
    facts = {"paper": "csrukf", "seed": 3, "share": 0.5}
    found = write(path, lambda out: None, properties=facts, start=1.5)
    assert (found.facts, found.start, found.start_date) == (facts, 1.5, None)


def test_a_record_is_frozen_and_names_what_it_has(path):
    found = write(path, lambda out: out.exact("state", mean=TIMES))
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.start = 0.0
    with pytest.raises(KeyError, match="expected one of state, got 'truth'"):
        found["truth"]
    with pytest.raises(KeyError, match="expected one of mean, got 'cov'"):
        found["state"]["cov"]


def test_files_that_are_none_of_ours_are_named(path, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"a\.rrd: no such recording"):
        celnav.show.read(path)
    path.write_text("notes")
    with pytest.raises(
        ValueError, match=r"a\.rrd: expected a recording, got a damaged or other fi"
    ):
        celnav.show.read(path)
    with pytest.raises(ValueError, match=r"path: expected a path, such as 'flight\.rrd', got int"):
        celnav.show.read(3)
    path.unlink()
    write(path, lambda out: out.curve("plots/a", TIMES, colors.TRUTH, "a"))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(
        ValueError, match=r"a\.rrd: expected a recording, got a damaged or other fi"
    ):
        celnav.show.read(path)
    other = rr.RecordingStream("other", recording_id="x")
    memory = other.memory_recording()
    other.log("a", rr.Scalars(1.0))
    (tmp_path / "b.rrd").write_bytes(memory.drain_as_bytes())
    with pytest.raises(
        ValueError, match=r"b\.rrd: expected a recording of celnav, got one of othe"
    ):
        celnav.show.read(tmp_path / "b.rrd")


def test_the_room_stays_light():
    code = (
        "import sys, celnav; celnav.show.read, celnav.show.live; "
        "print(*{'rerun', 'matplotlib', 'pyarrow'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (done.stdout, done.returncode) == ("\n", 0), done.stderr
