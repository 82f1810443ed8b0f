"""The advice of `diagnose`, used as a user would: a filter with the printed numbers predicts what
is printed. On simulated logs, and on real logs if CELNAV_DATA has them.
"""

from __future__ import annotations

import gzip
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import celnav
from celnav.analysis.diagnose import diagnose
from celnav.commands.diagnose import read
from celnav.models.noise import ar1

LOGS = Path(os.environ.get("CELNAV_DATA", "real")) / "logs"
real_only = pytest.mark.skipif(not LOGS.is_dir(), reason="CELNAV_DATA has no folder logs")
DIGITS = 0.01
"""The page prints three digits of a standard deviation, and of a coefficient's distance from 1."""
NUMBER = r"(-?\d[\d.e+-]*)"
COLORED = rf"celnav\.colored\(motion, sensor, Phi=\[\[{NUMBER}\]\]\) with R=\[\[{NUMBER}\]\]"
STATE = (
    rf"a state V' = {NUMBER} V \+ zeta, zeta of variance {NUMBER} and V of {NUMBER}, "
    rf"measured as h\(x\) \+ V with R=\[\[{NUMBER}\]\]"
)
MEAN = rf".*?for the mean of these samples it predicts σ = {NUMBER}"
FACTORS = rf"the given filter with Q times {NUMBER} and R times {NUMBER}"
FITTED = rf"celnav\.(\w+)\(motion, sensor, Phi=np\.diag\(\[{NUMBER}\]\)\) with R=np\.diag\(\[{NUMBER}\]\)"
END = rf"; at the end it predicts σ = {NUMBER}, the given filter {NUMBER}"


def advice(pattern, text):
    """The numbers in a sentence; None if the sentence is missing."""
    found = re.search(pattern, str(text).replace("\n         ", " "))
    return found and [float(x) if re.fullmatch(NUMBER, x) else x for x in found.groups()]


# -- tables of residuals ---------------------------------------------------------------------------
def end_of_constant(make, Phi, R, x, white=None):
    """σ of a constant without prior information, after all samples ``x (T,)``."""
    sensor = celnav.Sensor([[1.0]], [[R]])
    constant, prior = celnav.Motion([[1.0]], [[0.0]]), celnav.Gaussian([0.0], [[1e8 * R]])
    if make == "colored":
        filter = celnav.colored(constant, sensor, [[Phi]])
    else:
        driving, stationary = white
        motion = celnav.Motion(np.diag([1.0, Phi]), np.diag([0.0, driving]))
        filter = celnav.ekf(motion, celnav.Sensor([[1.0, 1.0]], [[R]]))
        prior = celnav.Gaussian([0.0, 0.0], np.diag([1e8 * R, stationary]))
    track = celnav.run(filter, prior, np.arange(float(len(x))), x[:, None])
    return track.std[-1, 0]


def check_table(x):
    """Every filter that the page names for residuals ``(T,)``. Returns the page."""
    page = diagnose(x[:, None], np.arange(float(len(x))))
    found = advice(COLORED + MEAN, page)
    if found is not None:
        Phi, R, sigma = found
        assert end_of_constant("colored", Phi, R, x) == pytest.approx(sigma, rel=DIGITS)
    state = advice(STATE + MEAN, page)
    if state is not None:
        Phi, driving, stationary, R, sigma = state
        assert driving == pytest.approx(stationary * (1.0 - Phi**2), rel=DIGITS)
        predicted = end_of_constant("state", Phi, R, x, (driving, stationary))
        assert predicted == pytest.approx(sigma, rel=DIGITS)
    assert (found is None) != (state is None), page
    return str(page).replace("\n         ", " ")


def first_order(phi, steps, rng):
    return ar1([[phi]], np.sqrt(1.0 - phi**2) * rng.standard_normal((steps - 1, 1)), [0.3])[:, 0]


CLOCKS = {
    "receiver": lambda rng: first_order(0.7, 4000, rng) + first_order(0.995, 4000, rng),
    "oscillator": lambda rng: np.diff(rng.standard_normal(4001)) + 0.3 * rng.standard_normal(4000),
    "mixture": lambda rng: first_order(0.99, 4000, rng) + rng.standard_normal(4000),
    "slow": lambda rng: first_order(0.998, 4000, rng),
}
"""Residuals of a pulse against a clock, a frequency whose phase is noisy, ..."""


@pytest.mark.parametrize(
    ("clock", "word"),
    [
        ("receiver", "none suggested; celnav.colored("),
        ("oscillator", "none suggested; celnav.colored(motion, sensor, Phi=[[-0."),
        ("mixture", ": suggested: a state V' = 0.9"),
        ("slow", ": suggested: celnav.colored(motion, sensor, Phi=[[0.99"),
    ],
)
def test_a_clock_s_advice_is_what_a_filter_gives(clock, word):
    assert word in check_table(CLOCKS[clock](np.random.default_rng(3)))


@real_only
@pytest.mark.parametrize("name", ["gps_1pps", "ocxo_frequency"])
def test_a_real_clock_s_advice_is_what_a_filter_gives(name, tmp_path):
    path = tmp_path / f"{name}.csv"
    path.write_bytes(gzip.decompress((LOGS / f"{name}.csv.gz").read_bytes()))
    assert "none suggested; celnav.colored(" in check_table(read(path).residuals[:, 0, 0])


# -- a cart with odometry and ranges ---------------------------------------------------------------
def cart(Q, R):
    """A cart on a rail, with a measured speed as input."""
    return celnav.ekf(
        celnav.Motion(lambda x, epoch: x + epoch.u * epoch.dt, [[Q]]), celnav.Sensor([[1.0]], [[R]])
    )


def rail(rng, R, slip=0.0, every=1, T=2000):
    """Times, ranges and speeds at 10 Hz; ``slip``: coefficient of the speed's error."""
    t = 0.1 * np.arange(T)
    v = 0.3 * np.sin(0.05 * t)
    x = np.concatenate([[0.0], np.cumsum(0.1 * v[:-1])])
    z = x + np.sqrt(R) * rng.standard_normal(T)
    z[np.arange(T) % every > 0] = np.nan
    return t, z[:, None], (v + 0.1 * first_order(slip, T, rng))[:-1, None]


def check_cart(Q, R, t, z, u):
    """Check every filter that the page names. Returns the page, and its sentences about Q and R."""
    prior, given = celnav.Gaussian(z[0], [[R]]), cart(Q, R)
    page = diagnose(celnav.run(given, prior, t, z, u), prior=prior, z=z, u=u)
    before = celnav.run(given, prior, t, z, u).std[-1, 0]
    factors, color = advice(FACTORS + END, page), advice(FITTED + END, page)
    if factors is not None:
        of_Q, of_R, sigma, given_sigma = factors
        better = cart(of_Q * Q, of_R * R)
        track = celnav.run(better, prior, t, z, u)
        gain = track.log_likelihood - celnav.run(given, prior, t, z, u).log_likelihood
        grows = advice(rf"the log-likelihood grows by {NUMBER} with them", page)
        assert grows == pytest.approx([gain], rel=DIGITS)
        assert gain > 0.0
        assert track.std[-1, 0] == pytest.approx(sigma, rel=DIGITS)
        assert before == pytest.approx(given_sigma, rel=DIGITS)
    if color is not None:
        name, Phi, noise, sigma, given_sigma = color
        sensor = replace(given.sensors[0], R=None, sqrt_R=[[np.sqrt(noise)]])
        filter = getattr(celnav, name)(given.motion, sensor, [[Phi]], rule=given.rule)
        track = celnav.run(filter, prior, t, z, u)
        assert track.std[-1, 0] == pytest.approx(sigma, rel=DIGITS)
        assert before == pytest.approx(given_sigma, rel=DIGITS)
    assert factors or color, page
    return str(page).replace("\n         ", " ")


SUGGESTED = "model    suggested: the given filter with Q times"
FIT = "model    fitted, not suggested: the given filter with Q times"


@pytest.mark.parametrize(
    ("truth", "first", "second"),
    [
        ({"R": 1e-4}, SUGGESTED, "celnav.colored is not suggested"),
        ({"R": 1e-4, "every": 20}, FIT, "do not distinguish color from wrong dynamics"),
        ({"R": 1e-4, "slip": -0.9}, FIT, "celnav.colored is not suggested"),
        ({"R": 1e-8, "slip": -0.5}, "model    suggested: celnav.colored(", "the noise is colored"),
    ],
)
def test_a_cart_s_advice_is_what_a_filter_gives(truth, first, second):
    """The filter is given 16 times the range variance of 1e-4 m^2, and a quarter of the speed's
    noise.
    """
    text = check_cart(0.25e-4, 16e-4, *rail(np.random.default_rng(1), **truth))
    assert first in text
    assert second in text


@real_only
@pytest.mark.parametrize(
    ("every", "word"), [(1, "fitted, not suggested: the given"), (100, "suggested: the given")]
)
def test_a_real_cart_s_advice_is_what_a_filter_gives(every, word):
    """With the standard deviations from the data's authors. The laser's errors depend on the place,
    so no factors make the innovations white as long as all ranges are used.
    """
    log = loadmat(LOGS / "dataset1.mat")
    t, r, v = (log[name][:, 0] for name in ("t", "r", "v"))
    z = (log["l"] - r[:, None]).astype(float)
    z[np.arange(len(t)) % every > 0] = np.nan
    Q, R = 0.01 * log["v_var"].item(), log["r_var"].item()
    text = check_cart(Q, R, t, z, v[:-1, None])
    assert f"model    {word} filter with Q times" in text
    assert "left out: the likelihood has no clear maximum in Phi and R" in text
