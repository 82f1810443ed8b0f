"""Epochs made of arrays: their intervals, whatever part of them is taken, and what they hold in memory."""

import tracemalloc

import numpy as np
import pytest

import celnav

SLOPE = 2.0


def speed(epochs, prior=None):
    """The track of a point that moves at a constant speed."""
    move = lambda x, e: np.stack([x[..., 0] + e.dt * x[..., 1], x[..., 1]], -1)  # noqa: E731
    filter = celnav.ukf(
        celnav.Motion(move, sqrt_Q=np.zeros((2, 0))), celnav.Sensor([[1.0, 0.0]], [[0.01]])
    )
    return celnav.run(
        filter,
        celnav.Gaussian([0.0, 0.0], 100.0 * np.eye(2)) if prior is None else prior,
        epochs,
        keep="cov",
    )


def last(track):
    """The belief that a track ends with."""
    return type(track.belief)(track.belief[0][-1], track.belief[1][-1])


TIMES = np.array([0.0, 1.0, 2.5, 3.0, 4.0, 6.0, 7.0, 8.5])
WHOLE = celnav.epochs(TIMES, SLOPE * TIMES[:, None], truth=TIMES)


def test_a_stride_has_intervals_of_its_own():
    """Every other measurement of a point at 2 m/s says 2 m/s, as epochs made of these alone do."""
    for taken in (WHOLE[::2], WHOLE[:][::2], WHOLE[::2][:]):
        found, expected = speed(taken), speed(celnav.epochs(TIMES[::2], SLOPE * TIMES[::2, None]))
        np.testing.assert_array_equal(found.mean, expected.mean)
        assert found.mean[-1, 1] == pytest.approx(SLOPE, abs=1e-3)
        assert [e.k for e in taken] == [0, 1, 2, 3]
        assert [e.truth for e in taken] == TIMES[::2].tolist()
    assert [(e.k, e.dt) for e in WHOLE[1::3]] == [(1, 1.0), (2, 3.0), (3, 4.5)]
    assert [e.dt for e in WHOLE[::2][1::2]] == [2.5, 4.5]


def test_a_part_goes_on_where_the_one_before_it_ended():
    whole = speed(WHOLE)
    for k in (1, 3, 7):
        first = speed(WHOLE[:k])
        second = speed(WHOLE[k:], last(first))
        np.testing.assert_array_equal(np.concatenate([first.mean, second.mean]), whole.mean)
    half = speed(WHOLE[::2])
    first = speed(WHOLE[::2][:2])
    second = speed(WHOLE[::2][2:], last(first))
    np.testing.assert_array_equal(np.concatenate([first.mean, second.mean]), half.mean)
    np.testing.assert_array_equal(speed(WHOLE[:3] + WHOLE[3:]).mean, whole.mean)
    assert [(e.k, e.t, e.dt) for e in WHOLE[5:7]] == [(5, 6.0, 2.0), (6, 7.0, 1.0)]
    assert (WHOLE[-1].k, WHOLE[-1].t, WHOLE[-1].dt) == (7, 8.5, 1.5)
    assert (len(WHOLE[9:]), repr(WHOLE[9:]), repr(WHOLE[2:])) == (
        0,
        "Epochs(0)",
        "Epochs(6 from 2.5 to 8.5 s)",
    )


def test_inputs_belong_to_intervals():
    when = celnav.epochs(TIMES, u=np.arange(7.0))
    assert [e.u for e in when] == [None, *np.arange(7.0)]
    assert [e.u for e in when[2:4]] == [1.0, 2.0]
    with pytest.raises(ValueError, match="epochs: an interval of 2 epochs has 2 inputs"):
        when[::2]


def test_what_cannot_be_taken():
    with pytest.raises(ValueError, match="epochs: expected a slice that runs forward"):
        WHOLE[::-1]
    for beyond in (8, -9):
        with pytest.raises(IndexError, match="index out of range"):
            WHOLE[beyond]


def test_epochs_are_made_one_at_a_time():
    """Nothing as long as the record but the arrays given."""
    when = celnav.epochs(np.arange(200_000.0), np.zeros((200_000, 1)))
    tracemalloc.start()
    try:
        for _ in zip(range(10), when, strict=False):
            pass
        for _ in zip(range(10), when[5:], strict=False):
            pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100_000
