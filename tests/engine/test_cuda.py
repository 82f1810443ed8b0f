"""Filters on a device: their PTX, and their runs with a driver that uses the host."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest
import test_compiled as bodies
import test_compiled_runs as runs
from fake_cuda import Driver, installed
from taped import FUNCTIONS
from twice import assert_same, told, twice

import celnav
from celnav.cli import main
from celnav.filters.run import ENGINE
from celnav.models import orbit
from celnav.tape import cuda, llvm, ptx
from celnav.tape.tape import CannotCompile, Tape

pytestmark = pytest.mark.usefixtures("eager")

pytest.importorskip("llvmlite")

ROUNDED = re.compile(r"^\s*(?:@\S+\s+)?((?:add|sub|mul|fma|mad|div|rcp|sqrt)\.\S*f64)", re.M)


@pytest.fixture
def driver(monkeypatch):
    found = installed(monkeypatch, Driver())
    yield found
    assert left(found) == (0, 0, 0)


def left(driver):
    """Blocks on the device and on the host, and streams, that were not freed."""
    return len(driver.memory), len(driver.locked), driver.streams


@pytest.fixture
def reader(monkeypatch):
    """A driver that interprets the PTX line by line."""
    return installed(monkeypatch, Driver(literal=True))


def flown(*arguments, **options):
    """A run with numpy and a run on the device, after a check that they agree."""
    known, found = twice(*arguments, engine="cuda", **options)
    assert_same(known, found, engine="cuda")
    return known, found


def sound(text, tmp_path):
    """PTX has an entry with eleven parameters, no calls, and IEEE rounding; ``ptxas`` accepts it if
    installed.
    """
    assert len(re.findall(r"^\.visible \.entry entry\(", text, re.M)) == 1
    assert len(re.findall(r"^\s+\.param \.u64 .*entry_param_\d+", text, re.M)) == 11
    assert ".extern" not in text
    assert not re.search(r"\bcall\b", text)
    found = set(ROUNDED.findall(text))
    assert found
    assert all(".rn." in name for name in found), found
    assert not re.search(r"\.(approx|ftz|full)\b", text)
    if assembler := shutil.which("ptxas"):
        (tmp_path / "text.ptx").write_text(text)
        done = subprocess.run(
            [assembler, "-arch=sm_80", "-O0", "text.ptx", "-o", "text.cubin"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr


# -- every kind of filter --------------------------------------------------------------------------
FALLS = (
    "unscented",
    "unscented, cov",
    "simplex",
    "sparse grid",
    "chi-square hook",
    "window hook",
    "window skip hook, cov",
    "Huber hook",
    "Sage-Husa hook, cov",
    "colored, gaps",
    "colored, cov",
    "colored of runs",
    "decorrelated, gaps",
    "augmented",
    "two stages",
    "single draw",
    "noise through the points",
    "two sensors",
    "two rates",
    "one of two",
    "no measurement",
    "no sensor",
    "noises that are functions",
    "noises of runs",
    "gains of runs",
)


FEW = [0, 1, 2, 3, 9, 10]  # whole, in part and not at all measured; the reader takes its time


def few(z):
    """Measurements at some epochs."""
    if z is None:
        return None
    return tuple(map(few, z)) if isinstance(z, tuple) else z[FEW]


@pytest.mark.parametrize("name", FALLS)
def test_filters_of_a_falling_body(name, reader, tmp_path):
    filter, z = bodies.FALLS[name]
    flown(filter, bodies.MANY, bodies.TIMES[: len(FEW)], few(z), keep="cov")
    (text,) = reader.sources
    sound(text, tmp_path)


def low_orbit(form):
    def step(x, epoch):
        return orbit.step(x, epoch.dt)

    motion, gps = (
        celnav.Motion(step, sqrt_Q=np.diag([7e-3] * 3 + [1e-8] * 3)),
        celnav.Sensor(np.eye(3, 6), 0.04 * np.eye(3)),
    )
    prior = celnav.Gaussian(
        orbit.from_elements(7136.6, 0.001, *np.radians([65, 30, 30, 0])),
        np.diag([0.02] * 3 + [1e-9] * 3),
    )
    _, z = celnav.simulate(motion, gps, prior, TIMES, runs=2)
    if form == "square root":
        z[2, 1], z[3, :, 2] = np.nan, np.nan
    return celnav.ukf(motion, gps, form=form), prior, TIMES, z


def bearings(make):
    return make(bodies.STRAIGHT, bodies.TOWER), bodies.ENTRY, bodies.SCANS, bodies.PLOTS


def spinning():
    motion, seconds, turns = bodies.turning(False), bodies.SECONDS[:4], bodies.TURNS[:3]
    z, _ = celnav.simulate(motion, bodies.STARS, bodies.UPRIGHT, seconds, u=turns, runs=2)
    u = turns[:, None] + 1e-5 * np.random.default_rng(1).standard_normal((3, 2, 3))
    return celnav.ukf(motion, bodies.TRACKER), bodies.UPRIGHT, seconds, z[..., :4], u


TIMES = np.arange(4.0)
OTHERS = {
    "orbit": lambda: low_orbit("square root"),
    "orbit, cov": lambda: low_orbit("covariance"),
    "angles": lambda: bearings(celnav.ukf),
    "EKF": lambda: (
        celnav.ekf(*bodies.EXACT),
        bodies.MANY,
        bodies.TIMES[: len(FEW)],
        few(bodies.GAPS),
    ),
    "EKF, cov": lambda: (
        celnav.ekf(*bodies.EXACT, form="covariance"),
        bodies.MANY,
        bodies.TIMES[: len(FEW)],
        few(bodies.Z),
    ),
    "attitude, input of each run": spinning,
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_filters(name, reader, tmp_path):
    flown(*OTHERS[name](), keep="cov")
    (text,) = reader.sources
    sound(text, tmp_path)


@pytest.mark.parametrize("name", ["two sensors", "window skip hook, cov"])
def test_the_same_program_as_machine_code(name, driver):
    flown(bodies.FALLS[name][0], bodies.MANY, bodies.TIMES, bodies.FALLS[name][1], keep="cov")


@pytest.mark.parametrize("name", llvm.LIBM)
def test_functions_of_the_c_library_are_arithmetic(name, driver, tmp_path):
    """And within some units in the last place of the library's results."""
    tape = Tape()
    y = tape.node(
        name,
        *(tape.input().i for _ in range(2 if name in ("pow", "atan2", "fmod", "hypot") else 1)),
    )
    kernel = llvm.Kernel(tape, [("own", i) for i in range(len(tape.ops) - 1)], [], [y])
    text = ptx.program([kernel], 1)
    sound(text, tmp_path)
    rng = np.random.default_rng(0)
    given = {
        "asin": (-1.0, 1.0),
        "acos": (-1.0, 1.0),
        "pow": (0.1, 10.0),
        "log1p": (-0.9, 9.0),
    }.get(name, (-9.0, 9.0))
    x = rng.uniform(*given, (1, len(kernel.inputs), 300))
    if name.startswith("log") and name != "log1p":
        x = np.abs(x)
    device = cuda.Device(driver)
    kinds, at = np.zeros(1, np.int32), np.zeros(1, np.int64)
    state, shared = np.zeros((1, 1, 300)), np.zeros((1, 1))
    with device.lane() as lane:
        rows = lane.run(device.entry(text), kinds, at, state, shared, x, results=300).copy()
    device.release()
    expected = FUNCTIONS[name](*x[0])
    units = np.abs(rows - expected) / np.spacing(np.abs(expected))
    allowed = 2.0 + 2.0 * np.abs(x[0, 1] * np.log(x[0, 0])) if name == "pow" else 3.0
    assert (units <= allowed).all(), units.max()


# -- runs ------------------------------------------------------------------------------------------
KEPT = [("cov", 2), ("mean", 100), ("nothing", 1)]
SOME = ("one run", "runs of both", "two axes", "no measurement")


@pytest.mark.parametrize(
    ("name", "keep", "every"),
    [
        *((name, "std", 1) for name in runs.BATCHES),
        *((name, *kept) for name in SOME for kept in KEPT),
    ],
)
def test_batches_and_what_is_kept(name, keep, every, driver):
    flown(
        runs.FILTER,
        runs.BATCHES[name][0],
        runs.TIMES,
        runs.BATCHES[name][1],
        keep=keep,
        every=every,
    )


@pytest.mark.parametrize("name", ["plain", "covariance", "window", "colored"])
def test_any_components_may_be_missing(name, driver):
    rng = np.random.default_rng(7)
    flown(
        runs.GAPPED[name],
        runs.PRIOR,
        runs.TIMES,
        np.where(rng.random(runs.Z.shape) < 0.4, np.nan, runs.Z),
        keep="cov",
    )


@pytest.mark.parametrize("name", runs.LOST)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_lost_runs_are_those_of_numpy(name, driver):
    filter, z = (
        runs.LOST[name],
        runs.logarithm(np.minimum(runs.SEEN, 2.9), None) if "sensor" in name else runs.SEEN,
    )
    known, _ = flown(filter, runs.GROWING, runs.TIMES, z, keep="cov")
    assert (known.failed_at >= 0).any()
    errors = [
        told(celnav.run, filter, runs.GROWING, runs.TIMES, z, engine=engine)
        for engine in ("numpy", "cuda")
    ]
    assert errors[0].startswith("FilterError: step ")
    assert errors[0] == errors[1]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_lost_run_alone(driver):
    filter, prior = (
        celnav.ukf(runs.EXPLODING, runs.LINEAR),
        celnav.Gaussian(runs.GROWING.mean[5], runs.GROWING.cov),
    )
    known, _ = flown(filter, prior, runs.TIMES, runs.SEEN[:, 5])
    assert known.failed_at >= 0


@pytest.mark.parametrize(
    "name", ["f of runs", "h of runs", "bias of runs", "three hooks", "a certain state"]
)
def test_what_is_seldom(name, driver):
    flown(*runs.ODD[name], runs.TIMES, runs.Z if "certain" in name else runs.HOLED, keep="cov")


def test_inputs_that_come_and_go(driver):
    def driven(x, epoch):
        return (
            runs.bend(x, epoch)
            if epoch.u is None
            else runs.bend(x, epoch) + 0.1 * epoch.u[0] + epoch.u[1]
        )

    u = [None, None, (np.ones(2), 0.1), (np.zeros(2), 0.2), None, (-np.ones(2), 0.0)]
    epochs = [celnav.Epoch(k, float(k), float(k > 0), one, runs.Z[k]) for k, one in enumerate(u)]
    flown(celnav.ukf(celnav.Motion(driven, 0.01 * runs.EYE), runs.SENSOR), runs.PRIOR, epochs)


@pytest.mark.parametrize("jobs", [1, 3])
def test_runs_are_flown_in_parts_that_the_device_has_room_for(jobs, monkeypatch):
    """Half of its memory, for all threads together; the results do not depend on it."""
    prior = celnav.Gaussian(np.linspace(-1.0, 1.0, 300).reshape(150, 2), 0.3 * runs.EYE)
    z = np.random.default_rng(8).standard_normal((6, 150, 2)) + 1.0
    whole = installed(monkeypatch, Driver())
    filters = [celnav.ukf(runs.MOTION, runs.SENSOR) for _ in range(2)]  # compared with numpy
    at_once = celnav.run(filters[0], prior, runs.TIMES, z, engine="cuda")
    pieces = whole.calls["cuLaunchKernel"]  # of the one chunk, between sentinels
    assert 1 < pieces <= len(runs.TIMES)
    small = installed(monkeypatch, Driver(free=40_000))
    _, found = flown(filters[1], prior, runs.TIMES, z, jobs=jobs)
    assert small.calls["cuLaunchKernel"] > pieces + 2 * jobs
    assert small.most < 0.6 * small.free
    assert left(small) == (0, 0, 0)
    for name in ("mean", "std", "whitened", "log_likelihood"):
        np.testing.assert_array_equal(getattr(found, name), getattr(at_once, name))


def test_a_program_is_made_and_loaded_once(driver):
    flown_again = celnav.compiled(runs.FILTER, engine="cuda")
    for count in (4, 2):
        found = flown_again.run(runs.PRIOR, runs.TIMES, runs.Z[:, :count])
        assert_same(
            celnav.run(runs.FILTER, runs.PRIOR, runs.TIMES, runs.Z[:, :count]), found, engine="cuda"
        )
    celnav.run(runs.FILTER, runs.PRIOR, runs.TIMES, runs.Z, engine="cuda")
    assert (len(driver.sources), driver.calls["cuModuleLoadDataEx"], driver.calls["cuInit"]) == (
        1,
        1,
        1,
    )
    assert driver.calls["cuMemAlloc_v2"] == driver.calls["cuMemFree_v2"]
    assert 18 <= driver.calls["cuMemAlloc_v2"] < 6 * driver.calls["cuLaunchKernel"]


def test_a_study_takes_the_engine_that_is_set(driver):
    problem = celnav.Problem(
        celnav.Motion(runs.bend, 0.01 * runs.EYE), runs.SENSOR, runs.PRIOR, runs.TIMES
    )
    token = ENGINE.set("cuda")
    try:
        celnav.compare({"bend": problem}, {"UKF": lambda p: celnav.ukf(p.motion, p.sensor)}, runs=4)
    finally:
        ENGINE.reset(token)
    assert driver.calls["cuLaunchKernel"] > 0


# -- faults ----------------------------------------------------------------------------------------
def fly(engine="cuda", **options):
    return celnav.run(runs.FILTER, runs.PRIOR, runs.TIMES, runs.Z, engine=engine, **options)


def test_without_a_driver(monkeypatch, capsys, tmp_path):
    def absent(name, *arguments, known=ctypes.CDLL, **options):
        if "cuda" in str(name):
            raise OSError(f"{name}: cannot open shared object file")
        return known(name, *arguments, **options)

    monkeypatch.setattr(ctypes, "CDLL", absent)
    cuda.device.cache_clear()
    with pytest.raises(
        RuntimeError,
        match=r"^engine='cuda': expected the driver of an NVIDIA device, \S+, got none \(\S+: cannot",
    ):
        fly()
    assert fly("auto").engine == "compiled"
    assert main(["reproduce", "csrukf", "--engine", "cuda", "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.startswith(
        "celnav: engine='cuda': expected the driver of an NVIDIA device"
    )
    assert not (tmp_path / "out").exists()


FAULTS = {
    "no device": (
        {"failing": {"cuInit": (100, 1)}},
        r"cuInit: CUDA_ERROR_NO_DEVICE \(no CUDA-capable device is detected\)",
    ),
    "old device": (
        {"capability": (6, 1)},
        r"expected a device of compute capability 7\.0 or higher, got 6\.1",
    ),
    "compiler": (
        {"failing": {"cuModuleLoadDataEx": (218, 1)}, "log": b"ptxas fatal : bad line 7"},
        r"cuModuleLoadDataEx: CUDA_ERROR_INVALID_PTX \(a PTX JIT compilation failed\): ptxas fatal "
        r": bad line 7",
    ),
    "no room for a run": (
        {"free": 200},
        r"cuMemAlloc_v2 of \d+ bytes: CUDA_ERROR_OUT_OF_MEMORY \(out of memory\)",
    ),
    "no memory after all": (
        {"failing": {"cuMemAlloc_v2": (2, 4)}},
        r"cuMemAlloc_v2 of \d+ bytes: CUDA_ERROR_OUT_OF_MEMORY",
    ),
    "copy": (
        {"failing": {"cuMemcpyHtoDAsync_v2": (1, 3)}},
        r"cuMemcpyHtoDAsync_v2: CUDA_ERROR_INVALID_VALUE \(invalid argument\)",
    ),
    "launch": (
        {"failing": {"cuLaunchKernel": (1, 1)}},
        r"cuLaunchKernel: CUDA_ERROR_INVALID_VALUE",
    ),
    "flight": (
        {"failing": {"cuStreamSynchronize": (700, 1)}},
        r"cuStreamSynchronize: CUDA_ERROR_ILLEGAL_ADDRESS \(an illegal memory",
    ),
    "copy back": (
        {"failing": {"cuMemcpyDtoHAsync_v2": (1, 2)}},
        r"cuMemcpyDtoHAsync_v2: CUDA_ERROR_INVALID_VALUE",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_told_and_nothing_leaks(name, monkeypatch):
    options, message = FAULTS[name]
    driver = installed(monkeypatch, Driver(**options))
    for jobs in (1, 2):
        with pytest.raises(cuda.CudaError, match=f"^engine='cuda': {message}"):
            fly(jobs=jobs)
        assert left(driver) == (0, 0, 0)
    if name == "no memory after all":
        assert driver.calls["cuMemFree_v2"] == 3
    assert fly("auto").engine == "compiled"
    assert fly("numpy").engine == "numpy"


def test_a_fault_is_not_hidden_by_those_that_follow(monkeypatch):
    failing = {"cuStreamSynchronize": (700, 1), "cuCtxSetCurrent": (700, 4)}
    driver = installed(monkeypatch, Driver(failing=failing))
    with pytest.raises(cuda.CudaError, match=r"^engine='cuda': cuStreamSynchronize: "):
        fly()
    assert driver.calls["cuCtxSetCurrent"] == 4
    assert left(driver) == (0, 0, 0)


def test_what_is_refused_in_words_of_the_package_is_so_here(driver):
    for options, words in (
        (
            {"also": lambda epoch, state, infos: {}},
            "also, reduce: expected none with engine='cuda', which keeps no states",
        ),
        ({"keep": "all"}, "keep: expected one of std, cov, mean, nothing, got 'all'"),
    ):
        with pytest.raises(ValueError, match=words):
            fly(**options)
    with pytest.raises(ValueError, match="engine: expected one of compiled, cuda, got 'auto'"):
        celnav.compiled(runs.FILTER, engine="auto")
    with pytest.raises(CannotCompile, match="a branch depends on a number"):
        celnav.run(
            celnav.ukf(celnav.Motion(runs.branch, runs.EYE), runs.SENSOR),
            runs.PRIOR,
            runs.TIMES,
            runs.Z,
            engine="cuda",
        )
    assert not driver.calls["cuLaunchKernel"]
