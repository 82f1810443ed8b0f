"""Process noise is estimated from steps of a simulated clock or velocity with known densities.

Clocks are simulated in small steps, so that no formula for the noise over an interval is needed.
"""

from __future__ import annotations

import numpy as np
import pytest

from celnav.models.gnss import LIGHT
from celnav.receiver.filters import CRYSTAL, PHONE
from celnav.receiver.walks import ENOUGH, acceleration_noise, walk_noise

RUNS, FINE = 40, 20
DENSE = 600


def clocks(white, walk, times, seed, runs=RUNS):
    """Values and rates ``(runs, T)`` of clocks, in `FINE` steps an interval."""
    rng, dt = np.random.default_rng(seed), np.diff(times)
    h = np.repeat(dt / FINE, FINE)
    d = np.cumsum(np.sqrt(walk * h) * rng.normal(size=(runs, h.size)), -1)
    d = np.concatenate([np.zeros((runs, 1)), d], -1)
    middle = 0.5 * (d[:, 1:] + d[:, :-1])
    b = np.cumsum(middle * h + np.sqrt(white * h) * rng.normal(size=(runs, h.size)), -1)
    b = np.concatenate([np.zeros((runs, 1)), b], -1)
    return b[:, ::FINE], d[:, ::FINE]


def measured(white, walk, times, sigma, seed=0):
    """These clocks with measurement errors of standard deviation ``sigma``."""
    values = clocks(white, walk, times, seed)
    rng = np.random.default_rng(seed + 1)
    return [v + s * rng.normal(size=v.shape) for v, s in zip(values, sigma, strict=True)]


def estimates(times, b, d, sigma):
    var = [np.full(len(times), s**2) for s in sigma]
    return [walk_noise(times, *pair, *var) for pair in zip(b, d, strict=True)]


EVERY_SECOND = np.arange(DENSE, dtype=float)
CASES = {
    "a crystal without errors": (CRYSTAL, EVERY_SECOND, (1e-3, 1e-3)),
    "a crystal": (CRYSTAL, EVERY_SECOND, (0.3, 0.05)),
    "a crystal at 30 s": (CRYSTAL, 30.0 * EVERY_SECOND, (0.5, 0.02)),
    "a phone": (PHONE, EVERY_SECOND, (6.0, 0.03)),
    "a phone at uneven times": (PHONE, np.cumsum(1.0 + np.arange(DENSE) % 4), (6.0, 0.03)),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("rates", [True, False])
def test_clocks_are_found_within_what_is_claimed(name, rates):
    """Means over the runs are within four standard errors, and the runs scatter with the predicted
    standard deviations.
    """
    densities, times, sigma = CASES[name]
    b, d = measured(*densities, times, sigma)
    walks = estimates(times, b, d if rates else np.full_like(d, np.nan), sigma)
    values = np.array([walk[:2] for walk in walks])
    std = np.array([walk[2:4] for walk in walks]).mean(0)
    clipped = values.std(0) < 0.6 * std  # a density that is not seen is zero in half of the runs
    error = np.abs(values.mean(0) - densities) / (std / np.sqrt(RUNS))
    assert (clipped | (error < 4.0)).all()
    assert (values.std(0) < 1.6 * std).all()
    if rates:
        assert not clipped[1]
        # The white noise of a crystal is hidden by errors of decimeters, or by its random walk.
        assert not clipped[0] or name in ("a crystal", "a crystal at 30 s")
    assert (np.array([walk.cautious for walk in walks]).mean(0) >= 0.9 * np.array(densities)).all()


@pytest.mark.parametrize("rates", [True, False])
@pytest.mark.parametrize("size", [1e-3 * LIGHT, 2e3])
def test_resets_are_found_and_are_not_noise(rates, size):
    b, d = measured(*PHONE, EVERY_SECOND, (6.0, 0.03))
    at = np.arange(25, DENSE, 50)
    b_reset = b + size * (EVERY_SECOND[:, None] >= at).sum(-1)
    d = d if rates else np.full_like(d, np.nan)
    plain, walks = (estimates(EVERY_SECOND, v, d, (6.0, 0.03)) for v in (b, b_reset))
    for before, after in zip(plain, walks, strict=True):
        assert abs(after.white - before.white) < 2.0 * before.white_std
        assert set(at) <= set(np.flatnonzero(after.reset))
        np.testing.assert_allclose(after.reset[at], size, atol=100.0)
        # Without rates a clock step enters two second differences.
        assert np.count_nonzero(after.reset) <= len(at) * (1 if rates else 2) + 1
    assert np.mean([np.count_nonzero(walk.reset) for walk in plain]) < 0.5


def test_short_logs_give_cautious_estimates_or_none():
    """With `ENOUGH` steps the estimate plus one standard deviation covers the
    truth in most runs.
    """
    times = EVERY_SECOND[: ENOUGH + 1]
    sigma = (6.0, 0.03)
    b, d = measured(*PHONE, times, sigma)
    cautious = np.array([walk.cautious for walk in estimates(times, b, d, sigma)])
    assert (cautious > 0.5 * np.array(PHONE)).mean() > 0.85
    assert (cautious < 4.0 * np.array(PHONE)).mean() > 0.9
    assert estimates(times[:-1], b[:, :-1], d[:, :-1], sigma) == [None] * RUNS
    b[:, 3] = np.nan
    assert estimates(times, b, d, sigma) == [None] * RUNS


def test_epochs_without_a_fix_are_intervals():
    b, d = measured(*CRYSTAL, EVERY_SECOND, (1e-3, 1e-3))
    there = np.random.default_rng(2).random(DENSE) < 0.5
    there[0] = True
    gaps = [np.where(there, v, np.nan) for v in (b, d)]
    alone = [v[:, there] for v in (b, d)]
    whole = estimates(EVERY_SECOND, *gaps, (1e-3, 1e-3))
    part = estimates(EVERY_SECOND[there], *alone, (1e-3, 1e-3))
    assert [walk[:5] for walk in whole] == [walk[:5] for walk in part]


def test_the_allan_variance_is_that_of_the_densities():
    """Second differences of a clock, divided by twice the squared interval, against the sum."""
    white, walk = CRYSTAL
    b, _ = clocks(white, walk, EVERY_SECOND, 3, runs=400)
    for m in (1, 10, 30):
        second = b[:, 2 * m :: m] - 2.0 * b[:, m:-m:m] + b[:, : -2 * m : m]
        allan = np.square(second).mean() / (2.0 * m**2)
        assert allan == pytest.approx(white / m + walk * m / 3.0, rel=0.1)


@pytest.mark.parametrize("density", [0.0, 1.0])
@pytest.mark.parametrize("rates", [True, False])
def test_the_acceleration_of_a_receiver_is_found(density, rates):
    p, v = clocks(0.0, density, EVERY_SECOND, 4, runs=3)
    rng = np.random.default_rng(5)
    p, v = p + 1.0 * rng.normal(size=p.shape), v + 0.03 * rng.normal(size=v.shape)
    v = v if rates else np.full_like(v, np.nan)
    var = np.full((DENSE, 3), 1.0), np.full((DENSE, 3), 0.03**2)
    value = acceleration_noise(EVERY_SECOND, p.T, v.T, *var)
    assert 0.8 * density <= value < (1.2 * density + 1e-3 if rates else 2.0 * density + 1.0)
    few = EVERY_SECOND[:5], p.T[:5], v.T[:5], var[0][:5], var[1][:5]
    assert acceleration_noise(*few) is None
