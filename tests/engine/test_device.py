"""Filters on a real NVIDIA device, compared with numpy; skipped without a device."""

from __future__ import annotations

import numpy as np
import pytest
import test_compiled as bodies
import test_compiled_runs as runs
import test_cuda as host
from taped import FUNCTIONS
from twice import assert_same, twice

import celnav
from celnav.tape import cuda, llvm, ptx
from celnav.tape.tape import Tape

pytest.importorskip("llvmlite")


try:
    cuda.device()
except cuda.CudaError as error:
    pytest.skip(str(error), allow_module_level=True)

pytestmark = pytest.mark.usefixtures("eager")


def compared(*arguments, **options):
    """A run with numpy and a run on the device, after a check that they agree."""
    known, found = twice(*arguments, engine="cuda", **options)
    assert_same(known, found, engine="cuda")
    return known


@pytest.mark.parametrize("name", host.FALLS)
def test_filters_of_a_falling_body(name):
    filter, z = bodies.FALLS[name]
    compared(filter, bodies.MANY, bodies.TIMES, z, keep="cov")


@pytest.mark.parametrize("name", host.OTHERS)
def test_other_filters(name):
    compared(*host.OTHERS[name](), keep="cov")


@pytest.mark.parametrize("name", runs.BATCHES)
@pytest.mark.parametrize(("keep", "every"), [("std", 1), *host.KEPT])
def test_batches_and_what_is_kept(name, keep, every):
    prior, z = runs.BATCHES[name]
    compared(runs.FILTER, prior, runs.TIMES, z, keep=keep, every=every)


@pytest.mark.parametrize("name", runs.LOST)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_lost_runs_are_those_of_numpy(name):
    z = runs.logarithm(np.minimum(runs.SEEN, 2.9), None) if "sensor" in name else runs.SEEN
    known = compared(runs.LOST[name], runs.GROWING, runs.TIMES, z, keep="cov")
    assert (known.failed_at >= 0).any()


@pytest.mark.parametrize("name", llvm.LIBM)
def test_functions_of_the_c_library(name):
    """Within three units in the last place of the library's results, and more for powers."""
    tape = Tape()
    inputs = 2 if name in ("pow", "atan2", "fmod", "hypot") else 1
    y = tape.node(name, *(tape.input().i for _ in range(inputs)))
    kernel = llvm.Kernel(tape, [("own", i) for i in range(inputs)], [], [y])
    ranges = {"asin": (-1.0, 1.0), "acos": (-1.0, 1.0), "pow": (0.1, 10.0), "log1p": (-0.9, 9.0)}
    x = np.random.default_rng(0).uniform(*ranges.get(name, (-9.0, 9.0)), (1, inputs, 300))
    if name.startswith("log") and name != "log1p":
        x = np.abs(x)
    kinds, at = np.zeros(1, np.int32), np.zeros(1, np.int64)
    state, shared = np.zeros((1, 1, 300)), np.zeros((1, 1))
    device = cuda.device()
    entry = device.entry(ptx.program([kernel], 1))
    with device.lane() as lane:
        rows = lane.run(entry, kinds, at, state, shared, x, results=300).copy()
    device.release()
    expected = FUNCTIONS[name](*x[0])
    units = np.abs(rows - expected) / np.spacing(np.abs(expected))
    allowed = 2.0 + 2.0 * np.abs(x[0, 1] * np.log(x[0, 0])) if name == "pow" else 3.0
    assert (units <= allowed).all(), units.max()


def test_threads_share_the_device():
    """A number of runs that does not fill the last block, with one thread and with three."""
    prior = celnav.Gaussian(np.linspace(-1.0, 1.0, 600).reshape(300, 2), 0.3 * runs.EYE)
    z = np.random.default_rng(8).standard_normal((6, 300, 2)) + 1.0
    filter = celnav.ukf(runs.MOTION, runs.SENSOR)
    one, three = (
        celnav.run(filter, prior, runs.TIMES, z, engine="cuda", jobs=jobs) for jobs in (1, 3)
    )
    np.testing.assert_array_equal(one.mean, three.mean)
    np.testing.assert_array_equal(one.std, three.std)
