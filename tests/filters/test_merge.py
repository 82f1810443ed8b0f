"""Samples of several clocks on common epochs, against a slow loop."""

from __future__ import annotations

import numpy as np
import pytest

import celnav
from celnav.filters.merge import merge

rng = np.random.default_rng(0)
T_IMU = np.cumsum(0.01 * (1.0 + 0.3 * rng.uniform(-1.0, 1.0, 60)))
RATE, FORCE = rng.standard_normal((60, 2, 3)), rng.standard_normal((60, 3))
T_FIX = np.r_[T_IMU[4], np.linspace(0.05, 0.5, 7), T_IMU[-1]]
FIX = rng.standard_normal((9, 2, 6))
T_WHEEL, WHEEL = np.r_[T_FIX[2], 0.311], rng.standard_normal((2, 1))


def interpolated(t, samples, at):
    for k in range(len(t) - 1):
        if t[k] <= at <= t[k + 1]:
            share = (at - t[k]) / (t[k + 1] - t[k])
            return samples[k] + share * (samples[k + 1] - samples[k])
    raise AssertionError(at)


def slowly():
    """The same, epoch by epoch."""
    times = sorted({*T_IMU, *T_FIX, *T_WHEEL})
    fixes, wheel = [], []
    for t in times:
        fixes.append(next((z for s, z in zip(T_FIX, FIX, strict=True) if s == t), FIX[0] * np.nan))
        wheel.append(
            next((z for s, z in zip(T_WHEEL, WHEEL, strict=True) if s == t), WHEEL[0] * np.nan)
        )
    middles = [0.5 * (a + b) for a, b in zip(times[1:], times[:-1], strict=True)]
    u = [[interpolated(T_IMU, samples, m) for m in middles] for samples in (RATE, FORCE)]
    return times, (fixes, wheel), u


def test_against_a_loop():
    times, z, u = slowly()
    merged = merge(imu=(T_IMU, (RATE, FORCE)), fixes=(T_FIX, FIX), wheel=(T_WHEEL, WHEEL))
    np.testing.assert_array_equal(merged.times, times)
    for got, expected in zip(merged.z, z, strict=True):
        np.testing.assert_array_equal(got, expected)
    for got, expected in zip(merged.u, u, strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-12)
    order = merge(imu=(T_IMU, FORCE), wheel=(T_WHEEL, WHEEL), fixes=(T_FIX, FIX)).z
    assert [column.shape[1:] for column in order] == [(1,), (2, 6)]


def test_one_sensor_and_one_array_of_inputs_are_no_tuples():
    """In the form for `celnav.run`; for a linear rate the value in the middle gives the exact
    integral.
    """
    t = np.linspace(0.0, 1.0, 11)
    merged = merge(imu=(t, 2.0 * t[:, None]), fixes=([0.25, 0.33, 1.0], np.zeros((3, 1))))
    motion = celnav.Motion(lambda x, epoch: x + epoch.u * epoch.dt, [[1e-8]])
    filter = celnav.ekf(motion, celnav.Sensor(np.eye(1), [[1e6]]))
    track = celnav.run(filter, celnav.Gaussian([0.0], [[1e-8]]), *merged)
    np.testing.assert_allclose(track.mean[:, 0], track.times**2, atol=1e-9)
    assert track.dof.sum() == 3


def test_times_apart_by_round_off_are_one():
    t = np.arange(101) * 0.01
    merged = merge(imu=(t, t[:, None]), fixes=(np.cumsum(np.full(10, 0.1)), np.zeros((10, 2))))
    assert len(merged.times) == 101
    assert np.isfinite(merged.z[10::10]).all()


GOOD = {"imu": (T_IMU, RATE), "fixes": (T_FIX, FIX)}
HOLE = np.r_[T_IMU[:30], T_IMU[30:] + 0.1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fixes": (T_FIX[::-1], FIX)}, r"fixes: expected times that increase, got .* at index 1"),
        ({"imu": (np.r_[T_IMU[:1], T_IMU[:-1]], RATE)}, "imu: expected times that increase"),
        ({"fixes": (T_FIX[:-1], FIX)}, r"fixes: expected samples \(8, ..., any\) to go with the"),
        ({"fixes": (T_FIX, FIX[:, 0, 0])}, r"fixes: expected samples \(9, ..., any\).* \(9,\)"),
        ({"imu": (T_IMU, (RATE, FORCE[1:]))}, r"imu: expected samples \(60, ..., any\) to go"),
        ({"imu": (T_IMU, np.nan * RATE)}, "imu: expected finite numbers"),
        ({"imu": (T_IMU[:1], RATE[:1])}, "imu: expected two samples or more, got 1"),
        ({"imu": RATE}, r"imu: expected \(times, samples\), got ndarray"),
        ({"fixes": (T_FIX + 9.0, FIX)}, "fixes: expected times within .* got 9 of 9 that are not"),
        ({"fixes": (T_FIX - 0.1, FIX)}, "fixes: .* 2 of 9 that are not; trim=True leaves them"),
        ({"imu": (HOLE, RATE)}, "imu: expected samples at most 0.0.* apart .*; max_gap=0.11"),
        ({"imu": (T_IMU, RATE), "max_gap": 0.01}, "imu: expected samples at most 0.01 s apart"),
        ({"imu": (T_IMU, RATE), "max_gap": -1.0}, "max_gap: expected a positive number, got -1.0"),
        ({"fixes": ([0.1, 0.1 + 1e-12], FIX[:2])}, "fixes: expected samples at least 1.*e-08 s"),
        ({"fixes": (["a"], FIX[:1])}, "fixes: expected numbers"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(changes, message):
    with pytest.raises(ValueError, match="^" + message):
        merge(**(GOOD | changes))


def test_nothing_to_merge():
    with pytest.raises(ValueError, match=r"^sensors: expected at least one"):
        merge(imu=(T_IMU, RATE))


def test_what_is_allowed_is_done():
    merge(imu=(HOLE, RATE), fixes=(T_FIX, FIX), max_gap=0.12)
    early = merge(imu=(T_IMU, RATE), fixes=(T_FIX - 0.1, FIX), trim=True)
    assert early.times[0] == T_IMU[0]
    np.testing.assert_array_equal(early.z[np.isfinite(early.z[:, 0, 0])], FIX[2:])
