"""A filter's step as C, compiled by the system's compiler, gives the library's results."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import huber, innovation_window
from celnav.tape.tape import CannotCompile

COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
TIMES = 0.5 * np.arange(40)


def swing(x, epoch):
    a, v = x[..., 0], x[..., 1]
    middle = v - 0.5 * epoch.dt * np.sin(a)
    return np.stack([a + epoch.dt * middle, v - epoch.dt * np.sin(a + 0.5 * epoch.dt * v)], -1)


def seen(x, _epoch):
    return np.stack([np.sin(x[..., 0]), np.cos(x[..., 0])], -1)


MOTION = celnav.Motion(swing, Q=np.diag([1e-6, 1e-4]))
SENSOR = celnav.Sensor(seen, R=0.01 * np.eye(2))
PRIOR = celnav.Gaussian([1.0, 0.0], np.diag([0.1, 0.1]))
FILTERS = {
    "root": celnav.ukf(MOTION, SENSOR),
    "covariance": celnav.ukf(MOTION, SENSOR, form="covariance"),
    "ekf": celnav.ekf(
        celnav.Motion(lambda x, e: x @ np.array([[1.0, 0.5], [0.0, 1.0]]).T, Q=1e-3 * np.eye(2)),
        SENSOR,
    ),
    "window": celnav.ukf(MOTION, SENSOR, hooks=[innovation_window(5)]),
    "Huber": celnav.ukf(MOTION, SENSOR, hooks=[huber()]),
    "colored": celnav.colored(MOTION, SENSOR, 0.8 * np.eye(2)),
    "augmented": celnav.augmented(MOTION, SENSOR, 0.8 * np.eye(2)),
}


class Exported:
    """The functions of a file, compiled."""

    def __init__(self, folder, filter, **options):
        source, library = folder / "filter.c", folder / "filter.so"
        celnav.export_c(filter, source, PRIOR, **options)
        self.text = source.read_text(encoding="utf-8")
        flags = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC"]
        subprocess.run([COMPILER, *flags, "-o", library, source, "-lm"], check=True)
        self.functions = ctypes.CDLL(str(library))
        sizes = {
            name: int(size) for name, size in re.findall(r"#define FILTER_(\w+) (\d+)", self.text)
        }
        self.state, self.given, self.out = (
            np.zeros(sizes[name]) for name in ("STATE", "IN", "OUT")
        )
        self._call("start", self.state)

    def _call(self, name, *arrays):
        getattr(self.functions, f"filter_{name}")(*(ctypes.c_void_p(x.ctypes.data) for x in arrays))

    def step(self, k, t, dt, z):
        self.given[:3] = k, t, dt
        self._call(
            "step" if k else "first", self.state, self.given, np.ascontiguousarray(z), self.out
        )
        return self.out.copy()


@pytest.mark.skipif(COMPILER is None, reason="no C compiler here")
@pytest.mark.parametrize("name", FILTERS)
def test_the_code_gives_what_the_library_gives(tmp_path, name):
    rng = np.random.default_rng(1)
    z = celnav.simulate(MOTION, SENSOR, PRIOR, TIMES, runs=1, seed=3)[1][:, 0]
    z[rng.random(z.shape) < 0.2] = np.nan
    flown = Exported(tmp_path, FILTERS[name])
    rows = np.array([flown.step(k, TIMES[k], 0.5 if k else 0.0, z[k]) for k in range(len(TIMES))])
    track = celnav.run(FILTERS[name], PRIOR, TIMES, z)
    n = track.mean.shape[-1]
    close = 1e-6 if name == "ekf" else 1e-10  # numpy uses differences, the code derivatives
    np.testing.assert_allclose(rows[:, :n], track.mean, rtol=close, atol=close)
    np.testing.assert_allclose(rows[:, n : 2 * n], track.std, rtol=close, atol=1e-12)
    np.testing.assert_array_equal(rows[:, 2 * n + 4 : 2 * n + 6] != 0.0, track.used)
    assert flown.state[0] == pytest.approx(
        track.log_likelihood, rel=1e-4 if name == "ekf" else 1e-9
    )
    assert not re.search(
        r"\b(malloc|for|while|if|goto)\b", flown.text.partition("*/")[2].replace("/* ", "")
    )


@pytest.mark.skipif(COMPILER is None, reason="no C compiler here")
def test_a_fixed_interval_is_part_of_the_code(tmp_path):
    flown = Exported(tmp_path, FILTERS["root"], dt=0.5)
    z = np.zeros((3, 2))
    rows = [flown.step(k, 0.5 * k, np.nan, z[k]) for k in range(3)]  # the rows are not used
    known = celnav.run(FILTERS["root"], PRIOR, TIMES[:3], z)
    np.testing.assert_allclose([row[:2] for row in rows], known.mean, rtol=1e-12, atol=1e-12)
    assert "every interval is 0.5 s" in flown.text


def test_what_cannot_be_exported_is_named(tmp_path):
    file = tmp_path / "filter.c"
    with pytest.raises(ValueError, match="name: expected an identifier of C, got '1st'"):
        celnav.export_c(FILTERS["root"], file, PRIOR, name="1st")
    with pytest.raises(
        ValueError, match=r"prior: expected the prior of one run with mean \(N,\), got \(3, 2\)"
    ):
        celnav.export_c(FILTERS["root"], file, celnav.Gaussian(np.zeros((3, 2)), np.eye(2)))
    with pytest.raises(
        ValueError, match="m: expected the length of each of 1 measurements, which R does not say"
    ):
        celnav.export_c(
            celnav.ukf(MOTION, celnav.Sensor(seen, R=lambda _mean, _epoch: np.eye(2))), file, PRIOR
        )
    with pytest.raises(ValueError, match="dt: expected a positive number, got 0"):
        celnav.export_c(FILTERS["root"], file, PRIOR, dt=0)
    with pytest.raises(
        CannotCompile, match=r"a branch depends on a number .*test_export.py, line \d+: return x if"
    ):
        celnav.export_c(
            celnav.ukf(celnav.Motion(lambda x, _epoch: branches(x), Q=np.eye(2)), SENSOR),
            file,
            PRIOR,
        )
    assert not file.exists()


def branches(x):
    return x if x[..., 0].max() > 0.0 else -x
