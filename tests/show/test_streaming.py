"""A filter shown while it runs, into a file that is read back."""

import sys

import numpy as np
import pytest

import celnav
from celnav.show import window

TIMES = np.arange(40.0)
NAMES = ["position, m", "speed, m/s"]
PRIOR = celnav.Gaussian([0.0, 10.0], np.diag([100.0, 4.0]))


def flown():
    """A filter with a gate, and measurements with a gap and an outlier."""
    gate = celnav.filters.adaptive.gate(5.0)
    sensor = celnav.Sensor(np.eye(1, 2), R=25.0)
    motion = celnav.models.motion.constant_velocity(1, q=0.1)
    z = 10.0 * TIMES[:, None] + 5.0 * np.random.default_rng(0).standard_normal((40, 1))
    z[10:15], z[20] = np.nan, 1e4
    return celnav.ukf(motion, sensor, hooks=[gate]), z


def test_each_epoch_is_shown(tmp_path):
    filter, z = flown()
    with celnav.show.live("a car", NAMES, to=tmp_path / "a.rrd") as show:
        for step in celnav.steps(filter, PRIOR, celnav.epochs(TIMES, z)):
            show(*step)
    track, found = (
        celnav.run(filter, PRIOR, TIMES, z, keep="cov"),
        celnav.show.read(tmp_path / "a.rrd"),
    )
    np.testing.assert_array_equal(found["state"].times, TIMES)
    assert found["state"]["mean"].tobytes() == track.mean.tobytes()
    assert found["state"]["covariance"].tobytes() == track.cov.tobytes()
    for k in range(2):
        x, half = track.mean[:, k], 3.0 * track.std[:, k]
        expected = np.stack([x, x - half, x + half], 1)
        np.testing.assert_array_equal(found[f"estimate/{k}"]["scalars"], expected)
    innovation = found["innovation/sensor_1"]["scalars"]
    np.testing.assert_array_equal(innovation, track.innovation[:, 0])
    nis = found["nis/sensor_1"]["scalars"]
    np.testing.assert_array_equal(nis, np.where(track.used[:, 0], track.nis, np.nan))
    states = found["states/sensor_1"]["state"]
    expected = np.full(40, "used", "U8")
    expected[10:15], expected[20] = "missing", "rejected"
    np.testing.assert_array_equal(states, expected)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"components": []}, "components: expected"),
        ({"components": [1, 2]}, "components: expected a text"),
        ({"to": 3}, "to: expected a path or an address, got int"),
        ({"to": "a.png"}, r"path: expected the name of an \.rrd file, got 'a\.png'"),
        ({"name": 3}, "name: expected a text"),
    ],
)
def test_wrong_arguments(tmp_path, arguments, message):
    about = {"name": "a", "components": NAMES, "to": tmp_path / "a.rrd"} | arguments
    with pytest.raises(ValueError, match=message), celnav.show.live(**about):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("names", "runs"), [(["x"], 0), (NAMES, 3)])
def test_a_state_that_does_not_fit_is_told(tmp_path, names, runs):
    filter, z = flown()
    z = np.stack([z] * runs, 1) if runs else z
    step = next(celnav.steps(filter, PRIOR, celnav.epochs(TIMES, z)))
    with (
        pytest.raises(ValueError, match="components: expected names of a state"),
        celnav.show.live("a car", names, to=tmp_path / "a.rrd") as show,
    ):
        show(*step)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def no_window(monkeypatch):
    """A viewer with a window; here as a server, which needs no screen."""
    command, started = window.command, []

    def server(*words):
        assert words[:2] == window.SIZE
        return command("--serve-grpc", *words[-2:])

    def start(said, *options):
        started.append(original(said, *options))
        return started[-1]

    original = window.start
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(window, "command", server)
    monkeypatch.setattr(window, "start", start)
    yield started
    for viewer in started:
        viewer.process.returncode = None
        window._end(viewer.process)


def test_a_viewer_is_started_and_goes_on(no_window):
    """It listens to this machine only, and is found without the PATH."""
    filter, z = flown()
    with celnav.show.live("a car", NAMES) as show:
        for step in celnav.steps(filter, PRIOR, celnav.epochs(TIMES, z)):
            show(*step)
    (viewer,) = no_window
    viewer.process.returncode = None
    assert viewer.process.poll() is None
    assert viewer.address.startswith("rerun+http://127.0.0.1:")


def test_a_viewer_that_does_not_start_is_told(monkeypatch):
    script = "import sys; sys.exit('no adapter')"
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(window, "command", lambda *words: [sys.executable, "-c", script])
    words = r"the viewer opened no window \(no adapter\); it needs a Vulkan driver$"
    with pytest.raises(OSError, match=words), celnav.show.live("a car", NAMES):
        pass


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have displays")
def test_no_display_is_told_before_a_viewer_starts(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with (
        pytest.raises(OSError, match=r"no display for a window; give a file or"),
        celnav.show.live("a car", NAMES),
    ):
        pass
