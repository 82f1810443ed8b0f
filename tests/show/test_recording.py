"""Recordings read back with pyarrow alone, and files that are complete or do not exist."""

import contextlib
import io
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from machine import children
from PIL import Image

import celnav
from celnav import cli
from celnav.show import colors, recording, views

TIMES = np.arange(20.0) * 0.5
RERUN = Path(sys.executable).with_name("rerun")


@pytest.fixture(autouse=True)
def _strict():
    before = rr.error_utils.strict_mode()
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(before)


def read(path, entity, component):
    """Times ``(T,)`` and one array per row of a component."""
    times, rows = [], []
    for chunk in rr.chunk.RrdReader(path).stream().filter(content=entity).to_chunks():
        batch = chunk.to_record_batch()
        if chunk.is_static or component not in batch.schema.names:
            continue
        times += (batch.column("t").cast("int64").to_numpy() * 1e-9).tolist()
        rows += [np.array(row.as_py() or []) for row in batch.column(component)]
    order = np.argsort(times, kind="stable")
    return np.array(times)[order], [rows[i] for i in order]


def write(path, draw, *, name="a test", times=TIMES, layout=None):
    view = views.plot("/plots", "plots") if layout is None else layout
    with recording.recording(path, times, name=name, layout=view, properties={"seed": 3}) as out:
        draw(out)
    return path


def verify(path):
    return subprocess.run(
        [RERUN, "rrd", "verify", path], capture_output=True, timeout=60
    ).returncode


def covariances(rng, steps=len(TIMES)):
    A = rng.standard_normal((steps, 3, 3))
    return A @ A.mT


class Log:
    """A stream that stores what is logged: for each entity its components by name."""

    def __init__(self):
        self.found = {}

    def log(self, entity, style, **_options):
        self.found[entity] = {
            str(batch.component_descriptor()).split(":")[-1]: batch.as_arrow_array().to_pylist()
            for batch in style.as_component_batches()
        }

    def send_columns(self, *_columns):
        pass


@pytest.mark.parametrize(("options", "seen"), [({}, True), ({"shown": False}, False)])
def test_a_curve_is_seen_unless_it_is_to_be_hidden(options, seen):
    log = Log()
    recording.Recorder(log, TIMES).curve("plots/a", TIMES, "#112233", "speed", width=2.0, **options)
    assert log.found["plots/a"] == {
        "visible_series": [seen],
        "names": ["speed"],
        "widths": [2.0],
        "colors": [0x112233FF],
    }


@pytest.mark.parametrize(("options", "seen"), [({}, True), ({"shown": False}, False)])
def test_bounds_are_seen_unless_they_are_to_be_hidden(options, seen):
    log = Log()
    recording.Recorder(log, TIMES).bounds("plots/a", TIMES, "speed", color="#112233", **options)
    style = {
        "visible_series": [seen] * 2,
        "names": ["speed ±3σ"] * 2,
        "widths": [1.0] * 2,
        "colors": [0x112233FF] * 2,
    }
    assert log.found == {"plots/a/3s": style}


def test_a_globe_has_circles_every_fifteen_degrees():
    """Eleven circles of latitude, and 24 half circles from pole to pole,
    slightly above the ground.
    """
    log = Log()
    recording.Recorder(log, TIMES).globe("earth", 6378.0)
    assert log.found["earth"]["half_sizes"] == [[6378.0] * 3]
    lines = [np.array(line) for line in log.found["earth/grid"]["strips"]]
    for line in lines:
        np.testing.assert_allclose(np.linalg.norm(line, axis=1), 1.003 * 6378.0, rtol=1e-6)
    circles, halves = lines[:11], lines[11:]
    heights = [np.degrees(np.arcsin(line[:, 2] / 1.003 / 6378.0)) for line in circles]
    np.testing.assert_allclose(
        np.stack(heights), np.tile(np.arange(-75.0, 90.0, 15.0)[:, None], (1, 121)), atol=1e-3
    )
    assert len(halves) == 24
    middle = [np.degrees(np.arctan2(line[30, 1], line[30, 0])) % 360.0 for line in halves]
    np.testing.assert_allclose(middle, np.arange(0.0, 360.0, 15.0), atol=1e-3)
    for line in halves:
        np.testing.assert_allclose(line[[0, -1], 2], 1.003 * 6378.0 * np.array([-1, 1]), rtol=1e-6)


def test_ellipsoid_axes_rebuild_the_covariance():
    from scipy.spatial.transform import Rotation

    P = covariances(np.random.default_rng(0), 200)
    half, quaternions = recording.ellipsoid_axes(P, 3.0)
    V = Rotation.from_quat(quaternions).as_matrix()
    np.testing.assert_allclose(
        V @ ((half / 3.0) ** 2 * np.eye(3)[:, None]).transpose(1, 0, 2) @ V.mT,
        P,
        atol=1e-12 * np.abs(P).max(),
    )


def test_ellipsoid_axes_of_a_singular_and_of_an_indefinite_covariance():
    half, _ = recording.ellipsoid_axes(np.diag([4.0, 1.0, 0.0]))
    np.testing.assert_allclose(np.sort(half), [0.0, 3.0, 6.0])
    with pytest.raises(ValueError, match="positive semidefinite"):
        recording.ellipsoid_axes(np.diag([1.0, 1.0, -0.1]))


def test_columns_come_back(tmp_path):
    rng = np.random.default_rng(1)
    line, cloud, P = rng.standard_normal((20, 3)), rng.standard_normal((20, 4, 3)), covariances(rng)
    line[7] = cloud[3, 1] = P[5] = np.nan
    curve = rng.standard_normal(20)
    curve[[0, 9]] = np.nan, np.inf

    def draw(out):
        out.trail("world/line", line, colors.TRUTH)
        out.points("world/cloud", cloud, colors.ESTIMATE)
        out.ellipsoids("world/ellipsoid", line, P, colors.ESTIMATE)
        out.arrow("world/arrow", line, 2.0 * line, colors.TRUTH, "arrow")
        out.strips(
            "world/strips",
            np.stack([cloud, cloud], 1),
            [colors.TRUTH, colors.ESTIMATE],
            labels=["a", "b"],
        )
        out.curve("plots/curve", curve, colors.TRUTH, "curve")
        out.bounds("plots/curve", np.abs(curve), "curve", center=1.0)
        out.level("plots/level", 2.0, "level")
        out.level("plots/band", [0.5, 1.5], "band")
        out.globe("world/earth", 3.0)
        out.text("info", "# text")
        out.exact("state", mean=line, covariance=P)

    path = write(tmp_path / "a.rrd", draw)

    t, segments = read(path, "/world/line", "LineStrips3D:strips")
    np.testing.assert_allclose(t, TIMES)
    assert [len(s) for s in segments] == [0, *(int(k not in (7, 8)) for k in range(1, 20))]
    for k in (1, 6, 9, 19):
        np.testing.assert_allclose(segments[k][0], line[k - 1 : k + 1], rtol=1e-6)

    _, points = read(path, "/world/cloud", "Points3D:positions")
    np.testing.assert_allclose(points[3], np.delete(cloud[3], 1, 0), rtol=1e-6)
    np.testing.assert_allclose(points[4], cloud[4], rtol=1e-6)

    _, half = read(path, "/world/ellipsoid", "Ellipsoids3D:half_sizes")
    assert [len(h) for h in half] == [int(k not in (5, 7)) for k in range(20)]
    np.testing.assert_allclose(half[6][0] ** 2 / 9.0, np.linalg.eigvalsh(P[6]), rtol=1e-5)

    _, vectors = read(path, "/world/arrow", "Arrows3D:vectors")
    np.testing.assert_allclose(vectors[2][0], 2.0 * line[2], rtol=1e-6)
    _, strips = read(path, "/world/strips", "LineStrips3D:strips")
    assert [len(s) for s in strips] == [2 * int(k != 3) for k in range(20)]
    np.testing.assert_allclose(strips[4][1], cloud[4], rtol=1e-6)

    _, scalars = read(path, "/plots/curve", "Scalars:scalars")
    assert [k for k in range(20) if not len(scalars[k])] == [0, 9]
    np.testing.assert_array_equal([scalars[k][0] for k in (1, 8, 19)], curve[[1, 8, 19]])
    _, bounds = read(path, "/plots/curve/3s", "Scalars:scalars")
    half = 3.0 * abs(curve[1])
    np.testing.assert_array_equal(bounds[1], [1.0 - half, 1.0 + half])
    _, band = read(path, "/plots/band", "Scalars:scalars")
    np.testing.assert_array_equal(band, [[0.5, 1.5]] * 2)
    t, level = read(path, "/plots/level", "Scalars:scalars")
    np.testing.assert_allclose(t, TIMES[[0, -1]])
    np.testing.assert_array_equal(level, [[2.0], [2.0]])

    _, mean = read(path, "/state", "mean")
    _, covariance = read(path, "/state", "covariance")
    np.testing.assert_array_equal(np.array(mean), line)
    np.testing.assert_array_equal(np.array(covariance).reshape(20, 3, 3), P)


def test_the_file_is_verified_says_the_same_twice_and_holds_its_layout(tmp_path):
    def draw(out):
        out.curve("plots/a", np.where(TIMES < 1.0, np.nan, TIMES), colors.TRUTH, "a")
        out.ellipsoids(
            "world/p", np.zeros((20, 3)), covariances(np.random.default_rng(0)), colors.TRUTH
        )

    space = views.space(
        "/world", "world", eye=(5.0, 0.0, 0.0), growing={"world/p": 3.0, "world/q": np.inf}
    )
    layout = views.columns(
        space, views.rows(views.tabs(views.plot("/plots", "p")), views.text(origin="/i"))
    )
    first, second = (write(tmp_path / f"{i}.rrd", draw, layout=layout) for i in range(2))
    assert verify(first) == 0
    reader = rr.chunk.RrdReader(first)
    (entry,), (blueprint,) = reader.recordings(), reader.blueprints()
    assert (entry.application_id, entry.recording_id) == ("celnav-a-test", "a-test")
    assert blueprint.application_id == entry.application_id
    assert reader.store().summary() == rr.chunk.RrdReader(second).store().summary()
    assert "log_time" not in reader.store().summary()
    compare = subprocess.run(
        [RERUN, "rrd", "compare", first, second], capture_output=True, timeout=60
    )
    assert compare.returncode == 0, compare.stderr[-500:]


def test_a_truncated_file_is_told(tmp_path):
    path = write(tmp_path / "a.rrd", lambda out: out.curve("plots/a", TIMES, colors.TRUTH, "a"))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert verify(path) != 0


def test_an_own_file_is_replaced_and_a_failure_leaves_it(tmp_path):
    path = write(tmp_path / "a.rrd", lambda out: out.curve("plots/a", TIMES, colors.TRUTH, "a"))
    old = path.read_bytes()

    class Stop(BaseException):
        pass

    def fail(out):
        out.curve("plots/a", TIMES, colors.TRUTH, "a")
        raise Stop("here")

    with pytest.raises(Stop, match=r"^here$"):
        write(path, fail)
    assert path.read_bytes() == old
    with pytest.raises(ValueError, match=r"plots/a values: expected shape \(20,\), got \(3,\)"):
        write(path, lambda out: out.curve("plots/a", np.zeros(3), colors.TRUTH, "a"))
    assert path.read_bytes() == old
    with pytest.raises(Stop, match=r"^here$"):
        write(tmp_path / "new.rrd", fail)
    assert [p.name for p in tmp_path.iterdir()] == ["a.rrd"]
    write(path, lambda out: out.curve("plots/b", TIMES, colors.TRUTH, "b"))
    assert path.read_bytes() != old
    assert "/plots/b" in rr.chunk.RrdReader(path).store().summary()
    assert [p.name for p in tmp_path.iterdir()] == ["a.rrd"]


def test_a_failing_replacement_leaves_the_old_file(tmp_path, monkeypatch):
    path = write(tmp_path / "a.rrd", lambda out: out.curve("plots/a", TIMES, colors.TRUTH, "a"))
    old = path.read_bytes()

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="no space left to write the file") as caught:
        write(path, lambda out: out.curve("plots/b", TIMES, colors.TRUTH, "b"))
    assert caught.value.filename == str(path)
    assert path.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == ["a.rrd"]


def test_foreign_files_are_left_alone(tmp_path):
    path = tmp_path / "notes.rrd"
    path.write_text("my notes")
    with pytest.raises(
        ValueError, match=r"path: expected a new file or a recording of celnav.*notes\.rrd"
    ):
        write(path, lambda out: None)
    assert path.read_text() == "my notes"
    other = rr.RecordingStream("other", recording_id="x")
    memory = other.memory_recording()
    other.log("a", rr.Scalars(1.0))
    path.write_bytes(memory.drain_as_bytes())
    with pytest.raises(ValueError, match="path: expected a new file"):
        write(path, lambda out: None)


def test_unwritable_paths_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"its folder does not exist: .*nowhere"):
        write(tmp_path / "nowhere" / "a.rrd", lambda out: None)
    (tmp_path / "folder.rrd").mkdir()
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        write(tmp_path / "folder.rrd", lambda out: None)
    with pytest.raises(ValueError, match=r"path: expected the name of an \.rrd file, got .*a\.png"):
        write(tmp_path / "a.png", lambda out: None)
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"its folder does not exist: .*file/a\.rrd"):
        write(tmp_path / "file" / "a.rrd", lambda out: None)


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0], [0.0, np.nan], [[0.0, 1.0]]])
def test_bad_times(tmp_path, times):
    with pytest.raises(ValueError, match="times: expected two or more finite, increasing seconds"):
        write(
            tmp_path / "a.rrd",
            lambda out: None,
            times=np.array(times),
            layout=views.text(origin="/info"),
        )


def test_strict_mode_holds_inside_and_is_given_back(tmp_path):
    rr.set_strict_mode(False)
    seen = []
    write(tmp_path / "a.rrd", lambda out: seen.append(rr.error_utils.strict_mode()))
    assert seen == [True]
    assert rr.error_utils.strict_mode() is False


def python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)


def test_celnav_alone_pulls_in_neither_rerun_nor_matplotlib():
    done = python(
        "import celnav, sys; print([m for m in ('rerun', 'matplotlib', 'pyarrow') if m in "
        "sys.modules])"
    )
    assert (done.stdout.strip(), done.returncode) == ("[]", 0), done.stderr


def test_filters_and_models_work_without_rerun():
    modules = "celnav.filters.run, celnav.filters.colored, celnav.models.orbit, celnav.models.sightings, celnav.papers.csrukf"
    done = python(
        f"import sys; sys.modules['rerun'] = None; import {modules}, celnav.papers.csrukf.show, "
        "celnav.show.scenes; print('ok')"
    )
    assert (done.stdout.strip(), done.returncode) == ("ok", 0), done.stderr
    done = python("import sys; sys.modules['rerun'] = None; import celnav.show.recording")
    assert "rerun" in done.stderr
    assert done.returncode == 1


def test_states_are_lanes_that_change(tmp_path):
    """Only changes are logged; "" ends a lane, and each state has its color."""
    names = np.array(["used"] * 5 + ["rejected"] * 2 + [""] * 3 + ["used"] * 10)
    path = write(tmp_path / "a.rrd", lambda out: out.states("states/z", names))
    t, held = read(path, "/states/z", "StateChange:state")
    np.testing.assert_allclose(t, TIMES[[0, 5, 7, 10]])
    assert [row.tolist() for row in held] == [["used"], ["rejected"], [""], ["used"]]
    log = Log()
    recording.Recorder(log, TIMES).states("z", names, {"used": "#112233", "rejected": "#445566"})
    assert log.found["z"] == {
        "values": ["used", "rejected"],
        "labels": ["used", "rejected"],
        "colors": [0x112233FF, 0x445566FF],
    }


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["used"] * 3, "names: expected 20 texts, got 3"),
        (["lost"] * 20, r"colors: expected a color of each state, got none of \['lost'\]"),
        ([1] * 20, "names: expected a text"),
    ],
)
def test_states_that_do_not_fit_are_named(tmp_path, names, message):
    with pytest.raises(ValueError, match=message):
        write(tmp_path / "a.rrd", lambda out: out.states("states/z", names))


def test_dates_are_a_timeline_if_the_start_is_known(tmp_path):
    start = "2015-10-17T04:00:00"
    about = {"name": "a", "layout": views.plot("/plots", "plots"), "start_date": start}
    with recording.recording(tmp_path / "a.rrd", TIMES, start=2.5, **about) as out:
        out.curve("plots/a", TIMES, colors.TRUTH, "a")
    for chunk in rr.chunk.RrdReader(tmp_path / "a.rrd").stream().to_chunks():
        if not chunk.is_static:
            batch = chunk.to_record_batch()
            seconds, dates = (batch.column(name).cast("int64").to_numpy() for name in ("t", "date"))
            assert (dates - seconds == np.datetime64(start, "ns").astype("int64")).all()
    found = celnav.show.read(tmp_path / "a.rrd")
    assert (found.start, found.start_date) == (2.5, np.datetime64(start))


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"start": 99.0}, r"start: expected a number of at least 0 and of at most 9\.5, got 99"),
        ({"start_date": "noon"}, "start_date: expected a date, such as '2015-10-17T0"),
    ],
)
def test_bad_starts(tmp_path, about, message):
    layout = views.text(origin="/info")
    with (
        pytest.raises(ValueError, match=message),
        recording.recording(tmp_path / "a.rrd", TIMES, name="a", layout=layout, **about),
    ):
        pass


@pytest.mark.skipif(
    not any(Path("/usr/share/vulkan/icd.d").glob("*.json")), reason="no Vulkan driver is installed"
)
def test_the_viewer_draws_a_picture_without_a_screen(tmp_path):
    from matplotlib.image import imread

    from celnav.show.picture import picture

    path = write(
        tmp_path / "a.rrd", lambda out: out.curve("plots/a", np.sin(TIMES), colors.ESTIMATE, "a")
    )
    picture(path, tmp_path / "a.png", 5.0, width=800)
    drawn = imread(tmp_path / "a.png")
    assert drawn.shape[1] == 800
    red, green, blue = np.moveaxis(drawn[50:-50, :, :3], -1, 0)
    orange = (red > green + 0.1) & (green > blue + 0.1)
    assert orange.any(0).sum() > 400  # the curve, thin as it is, from left to right


def test_a_picture_is_of_the_recording_at_its_time_without_the_bar(tmp_path, monkeypatch):
    """With a stand-in for the viewer; 31 of the 900 rows of its window are the viewer's bar."""
    from PIL import Image

    from celnav.show import picture, window

    told = []

    class Client:
        def open(self, recording):
            told.append(recording)

        def set_time(self, timeline, *, duration, play_state):
            told.append((timeline, duration, play_state))

        def take_screenshot(self, max_size):
            told.append(max_size)
            rows = np.random.default_rng(0).integers(0, 255, (900, 40, 3), np.uint8)
            rows[:31] = 7
            out = io.BytesIO()
            Image.fromarray(rows).save(out, "PNG")
            return out.getvalue()

    class Viewer(window.Viewer):
        def ask(self, request):
            return request(Client())

    viewer = contextlib.nullcontext(Viewer(None, 0, None, 0.0))
    monkeypatch.setattr(window, "viewer", lambda *options: told.append(options) or viewer)
    monkeypatch.setattr(picture.time, "sleep", lambda seconds: None)
    monkeypatch.chdir(tmp_path)
    picture.picture("a.rrd", tmp_path / "a.png", 2.5, width=300)
    opened = [("--headless",), str(tmp_path / "a.rrd"), ("t", 2.5, "paused")]
    assert told[:3] == opened
    assert set(told[3:]) == {300}
    drawn = np.asarray(Image.open(tmp_path / "a.png"))
    np.testing.assert_array_equal(
        drawn, np.random.default_rng(0).integers(0, 255, (900, 40, 3), np.uint8)[31:]
    )


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("no\nadapter", r"\(no adapter\); it needs a Vulkan driver"),
        (
            "panicked at 'Failed to get render context'\nstack backtrace:\n 6: core",
            r"\(panicked at 'Failed to get render context'\); it needs a Vulkan driver",
        ),
        ("out of memory", r"\(out of memory\)"),
        (3, r"\(it ended with exit status 3\)"),
    ],
)
def test_a_viewer_that_ends_by_itself_is_one_line_with_what_it_said(
    tmp_path, monkeypatch, said, words
):
    from celnav.show import picture, window

    script = f"import sys; sys.exit({said!r})"
    monkeypatch.setattr(window, "command", lambda *words: [sys.executable, "-c", script])
    with pytest.raises(OSError, match=rf"a\.rrd: the viewer gave no picture {words}$"):
        picture.picture(tmp_path / "a.rrd", tmp_path / "a.png", 5.0)
    assert not list(tmp_path.iterdir())


class BusyViewer:
    """A viewer that answers late, and then shows one picture after another."""

    failures, asked = 3, 0

    @classmethod
    def connect(cls, url):
        return cls()

    def open(self, path):
        BusyViewer.asked += 1
        if BusyViewer.asked <= BusyViewer.failures:
            raise RuntimeError("Deadline expired before operation could complete")

    def set_time(self, timeline, duration, play_state):
        assert (duration, play_state) == (5.0, "paused")

    def take_screenshot(self, max_size):
        shown, content = np.random.default_rng(0).integers(0, 255, (100, 100, 3)), io.BytesIO()
        Image.fromarray(shown.astype(np.uint8)).save(content, "PNG")
        return content.getvalue()


LISTENS = """
import socket, sys, time
with socket.create_server(("127.0.0.1", int(sys.argv[-1]))):
    time.sleep(60)
"""


@pytest.fixture
def busy(monkeypatch):
    from celnav.show import picture, window

    monkeypatch.setattr(window, "command", lambda *words: [sys.executable, "-c", LISTENS, *words])
    monkeypatch.setattr(window, "ViewerClient", BusyViewer)
    monkeypatch.setattr(picture, "SETTLE_S", 0.0)
    monkeypatch.setattr(BusyViewer, "asked", 0)
    return picture


def test_a_viewer_on_a_busy_machine_is_asked_again(busy, tmp_path):
    busy.picture(tmp_path / "a.rrd", tmp_path / "a.png", 5.0)
    assert BusyViewer.asked == 4
    with Image.open(tmp_path / "a.png") as drawn:
        assert drawn.size == (100, 97)


def test_a_viewer_that_never_answers_is_not_blamed_on_vulkan(busy, tmp_path, monkeypatch):
    monkeypatch.setattr(BusyViewer, "failures", 10_000)
    monkeypatch.setattr("celnav.show.window.PATIENCE_S", 2.0)
    words = (
        r"in 2 s \(Deadline expired before operation could complete\); try again on an idle machine"
    )
    with pytest.raises(OSError, match=rf"a\.rrd: the viewer gave no picture {words}$"):
        busy.picture(tmp_path / "a.rrd", tmp_path / "a.png", 5.0)
    assert BusyViewer.asked > 2
    assert not list(tmp_path.iterdir())


def listening(pids):
    """Addresses, as in /proc/net/tcp, that processes listen to."""
    sockets = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                sockets.add(os.readlink(link))
    lines = [
        line.split()
        for name in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]
    ]
    return [words[1] for words in lines if words[3] == "0A" and f"socket:[{words[9]}]" in sockets]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_the_viewer_listens_to_this_machine_only(tmp_path, monkeypatch):
    """As it is started for a window and for a picture; here as a server, which needs no screen."""
    from celnav.show import window

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words, silent = window.command("--serve-grpc", "--port", str(port)), subprocess.DEVNULL
    process = subprocess.Popen(words, stderr=silent, stdout=silent, start_new_session=True)
    try:
        deadline = time.monotonic() + 60.0
        while (
            not (found := listening([process.pid, *children(process.pid)]))
            and time.monotonic() < deadline
        ):
            time.sleep(0.1)
    finally:
        window._end(process)
    assert found == [f"0100007F:{port:04X}"]


CLOSES = """
import socket, sys, time
with socket.create_server(("127.0.0.1", int(sys.argv[-1]))):
    time.sleep(1.0)
"""


@pytest.mark.parametrize(
    ("options", "at"), [([], 3.0), (["--at", "4.5"], 4.5)], ids=["start", "at"]
)
def test_a_window_opens_at_the_start_of_the_recording(tmp_path, monkeypatch, options, at):
    """With a stand-in for the viewer, whose window is closed after a second."""
    from celnav.show import window

    told = []

    class Client(BusyViewer):
        def open(self, path):
            told.append(path)

        def set_time(self, timeline, duration, play_state):
            told.append((timeline, duration, play_state))

    def command(*words):
        told.append(words[:-1])
        return [sys.executable, "-c", CLOSES, *words]

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(window, "command", command)
    monkeypatch.setattr(window, "ViewerClient", Client)
    path, layout = tmp_path / "a.rrd", views.plot("/plots", "plots")
    with recording.recording(path, TIMES, name="a", layout=layout, start=3.0) as out:
        out.curve("plots/a", TIMES, colors.ESTIMATE, "a")
    assert cli.main(["view", str(path), *options]) == 0
    shown = (*window.SIZE, "--hide-welcome-screen", "--port")
    assert told == [shown, str(path), ("t", at, "paused")]


@pytest.mark.parametrize(("status", "failed"), [(0, False), (3, True)])
def test_a_window_may_be_closed_before_it_shows_the_recording(
    tmp_path, monkeypatch, status, failed
):
    from celnav.show import window

    script = f"import sys; sys.exit({status})"
    monkeypatch.setattr(window, "command", lambda *words: [sys.executable, "-c", script])
    words = r"a\.rrd: the viewer opened no window \(it ended with exit status 3\)$"
    expected = pytest.raises(OSError, match=words) if failed else contextlib.nullcontext()
    with expected:
        window.show(tmp_path / "a.rrd", 0.0)
