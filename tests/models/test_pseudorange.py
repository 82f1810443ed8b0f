"""Measurements of a receiver, against light time and differences."""

from __future__ import annotations

import numpy as np
import pytest

from celnav.models import pseudorange
from celnav.models.gnss import LIGHT, ROTATION_RATE, satellites
from celnav.receiver.constellation import synthetic

TOE = 345600.0
PLACE = np.array([-2613000.0, 4739000.0, 3365000.0])


def light_time_range(b, s, t, place):
    """Distance that light travels in an inertial frame, by plain iteration."""
    delay = 0.08
    for _ in range(8):
        p = satellites(b, t - delay).position[s]
        c, n = np.cos(ROTATION_RATE * delay), np.sin(ROTATION_RATE * delay)
        delay = (
            np.linalg.norm(np.array([c * p[0] + n * p[1], c * p[1] - n * p[0], p[2]]) - place)
            / LIGHT
        )
    return LIGHT * delay


def test_range_and_rate_are_those_of_light_time():
    b, t, v = synthetic(TOE), TOE + 1800.0, np.array([120.0, -300.0, 200.0])
    seen = pseudorange.sources(b, t, PLACE, v)
    found = pseudorange.measure(np.concatenate([PLACE, v, [30.0, 3.0]]), seen.q, seen.w)
    S = len(b)
    for s in range(0, S, 3):
        assert found[s] - 30.0 == pytest.approx(light_time_range(b, s, t, PLACE), abs=1e-6)
        h = 0.5
        ahead, back = (light_time_range(b, s, t + k * h, PLACE + k * h * v) for k in (1, -1))
        far, farther = (
            light_time_range(b, s, t + 2 * k * h, PLACE + 2 * k * h * v) for k in (1, -1)
        )
        rate = (8.0 * (ahead - back) - (far - farther)) / (12.0 * h)
        assert found[S + s] - 3.0 == pytest.approx(rate, abs=5e-6)


def test_the_jacobian_is_the_difference():
    seen = pseudorange.sources(synthetic(TOE), TOE + 1800.0, PLACE)
    x = np.concatenate([PLACE, [100.0, 50.0, -20.0, 3e4, 30.0]])
    H = pseudorange.jacobian(x, seen.q, seen.w)
    for i, size in enumerate(np.array([100.0] * 3 + [1.0] * 3 + [10.0, 1.0])):
        e = size * np.eye(8)[i]
        column = (
            pseudorange.measure(x + e, seen.q, seen.w) - pseudorange.measure(x - e, seen.q, seen.w)
        ) / (2.0 * size)
        np.testing.assert_allclose(H[:, i], column, rtol=0, atol=1e-8)


def test_from_pseudoranges_the_clock_of_the_receiver_cancels():
    b, t, bias = synthetic(TOE), TOE + 1800.0, 3e5  # a millisecond
    seen = pseudorange.sources(b, t, PLACE)
    ranges = np.linalg.norm(seen.q - PLACE, axis=-1) + bias - seen.clock
    again = pseudorange.emitted(b, t + bias / LIGHT, ranges, PLACE + 10.0)
    np.testing.assert_allclose(again.q, seen.q, rtol=0, atol=1e-3)
    np.testing.assert_allclose(again.clock, seen.clock, rtol=0, atol=1e-6)
