"""Diagnosis of logs: white, biased, wrongly sized and colored residuals are distinguished, and
bands have their stated coverage.
"""

from __future__ import annotations

import ast
import re

import numpy as np
import pytest
from scipy.stats import binom, chi2

import celnav
from celnav.analysis.diagnose import _ljung_box as ljung_box
from celnav.analysis.diagnose import autocorrelation, diagnose, first_order, grid_index
from celnav.gaussian.spaces import wrap
from celnav.models.motion import constant_velocity
from celnav.models.noise import ar1
from celnav.papers.csrukf import scenario
from celnav.show.diagnosis import figure
from celnav.study.montecarlo import generator

T = np.arange(300.0)
RNG = np.random.default_rng(1)


def noise(phi, steps, runs=1, m=1, rng=None):
    """First-order noise ``(steps, runs, m)`` of unit variance."""
    size, rng = (runs, m), rng or np.random.default_rng(11)
    return ar1(
        phi * np.eye(m),
        np.sqrt(1.0 - phi**2) * rng.standard_normal((steps - 1, *size)),
        rng.standard_normal(size),
    )


def inside(count, of, level=0.95):
    """Whether a count of successes agrees with a probability, with a binomial test at the level
    0.001.
    """
    return binom.ppf(0.0005, of, level) <= count <= binom.ppf(0.9995, of, level)


@pytest.mark.parametrize(
    ("phi", "steps", "runs"),
    [(0.0, 300, 1), (0.0, 40, 4), (0.7, 300, 1), (0.9, 400, 2), (-0.5, 300, 1)],
)
def test_bands_and_intervals_cover(phi, steps, runs):
    """Intervals contain bias 0, size 1, coefficient and standard deviation in 95 % of many logs;
    white noise passes Ljung-Box.
    """
    rng, many = np.random.default_rng(2), 300
    counts = np.zeros(5, int)
    colored = 0
    for _ in range(many):
        found = diagnose(noise(phi, steps, runs, rng=rng), np.arange(float(steps)), std=1.0)
        (c,), (sensor,) = found.components, found.sensors
        counts[:3] += [
            c.bias_interval[0] <= 0.0 <= c.bias_interval[1],
            sensor.band[0] <= sensor.nis <= sensor.band[1],
            c.p > 0.05,
        ]
        if c.coloring is not None:
            colored += 1
            low, high = c.coloring.sigma_interval
            counts[3:] += [
                c.coloring.phi_interval[0] <= phi <= c.coloring.phi_interval[1],
                low <= 1.0 <= high,
            ]
    assert inside(counts[0], many), counts
    assert inside(counts[1], many), counts
    if phi == 0.0:
        assert inside(counts[2], many), counts
    else:
        assert colored == many
        assert inside(counts[3], many), counts
        assert inside(counts[4], many), counts


def test_statistics_by_their_formulas():
    """Autocorrelation, the Ljung-Box statistic and NIS for complete data, written out."""
    x = noise(0.4, 200)[:, 0, 0]
    found = diagnose(x[:, None], np.arange(200.0), std=2.0, lags=5)
    c = found.components[0]
    d = x - x.mean()
    r = np.array([(d[k:] * d[:-k]).sum() / (d * d).sum() for k in range(1, 6)])
    np.testing.assert_allclose(c.autocorrelation, r * 200.0 / (200.0 - np.arange(1, 6)))
    assert c.ljung_box == pytest.approx(200.0 * 202.0 * (r**2 / (200.0 - np.arange(1, 6))).sum())
    assert c.p == pytest.approx(chi2.sf(c.ljung_box, 5))
    assert c.bias == pytest.approx(x.mean())
    assert found.sensors[0].nis == pytest.approx((x**2).mean() / 4.0)
    np.testing.assert_allclose(found.sensors[0].squares, x**2 / 4.0)


@pytest.mark.parametrize("phi", [(0.9,), (-0.6,), (0.0,), (1.2, -0.7), (0.3, -0.6)])
def test_correlations_are_summed_as_long_as_two_of_them_are_positive(phi):
    """The initial positive sequence; at most half of the lags, with a correction for the subtracted
    mean.
    """
    rng, N = np.random.default_rng(6), 200
    x = rng.standard_normal(N)
    for k in range(2, N):
        x[k] += sum(a * x[k - 1 - i] for i, a in enumerate(phi))
    rho, pairs, longer, squares = autocorrelation(x[:, None], np.arange(N), 10)
    d = x - x.mean()
    every = [np.mean(d[lag:] * d[: N - lag]) / np.mean(d * d) for lag in range(N // 2)]
    np.testing.assert_allclose(rho, every[1:11], rtol=1e-12, atol=1e-14)
    assert pairs.tolist() == [N - lag for lag in range(1, 11)]
    many = next(k for k in range(0, N // 2, 2) if every[k] + every[k + 1] <= 0.0)
    terms = [((1.0 if not lag else 2.0) * (N - lag) / N, every[lag]) for lag in range(many)]
    plain, most = sum(w * r for w, r in terms), sum(w for w, _ in terms)
    assert plain > 1.0 / N
    expected = max(plain, plain / (1.0 - (most - plain) / N))  # L = sum w (r + (1 - r) L / N)
    assert longer == pytest.approx(expected, rel=1e-9)
    kept = [w * max(r * r - 1.0 / (N - lag), 0.0) for lag, (w, r) in enumerate(terms) if lag]
    assert squares == pytest.approx(1.0 + sum(kept), rel=1e-12)


def test_lags_without_pairs_have_no_degree_of_freedom():
    """Samples are two steps apart, except one: every other of twenty lags has pairs."""
    x = np.full((201, 1), np.nan)
    x[::2, 0] = np.random.default_rng(8).standard_normal(101)
    place = np.arange(201)
    rho, pairs, *_ = autocorrelation(x, place, 20)
    assert np.flatnonzero(pairs).tolist() == list(range(1, 20, 2))
    x[::2, 0] -= x[::2, 0].mean()
    direct = [x[: -2 * k, 0][::2] @ x[2 * k :, 0][::2] / (101 - k) for k in range(1, 11)]
    direct = np.array(direct) / np.nanmean(x**2)
    expected = 103.0 / 101.0 * (direct**2 * (101.0 - np.arange(1, 11))).sum()
    for fitted in (0, 1):
        statistic, p = ljung_box(rho, pairs, 101, fitted)
        assert statistic == pytest.approx(expected, rel=1e-12)
        assert p == pytest.approx(chi2(10 - fitted).sf(expected), rel=1e-9)


def test_gaps_and_missing_components_cost_only_themselves():
    """A lag uses the pairs that exist, by their times; gaps in a long log change no conclusion."""
    x, t = noise(0.8, 2000, m=2)[:, 0], np.arange(2000.0)
    rng = np.random.default_rng(3)
    x[rng.random(x.shape) < 0.3] = np.nan
    x[:, 1] += 1.0
    kept = np.delete(np.arange(2000), slice(500, 900))
    found = diagnose(x[kept], 0.5 * t[kept] + 7.0)
    assert found.step == pytest.approx(0.5)
    for c, bias in zip(found.components, (False, True), strict=True):
        assert c.samples == np.isfinite(x[kept, 0 if not bias else 1]).sum()
        assert c.coloring.phi_interval[0] < 0.8 < c.coloring.phi_interval[1]
        assert c.coloring.sigma_interval[0] < 1.0 < c.coloring.sigma_interval[1]
        assert c.coloring.p > 0.01
        assert found.biased(c) is bias
        assert found.white(c) == "colored"
        d = x[kept, int(bias)] - c.bias
        pairs = [
            (d[i] * d[i + 1])
            for i in range(len(kept) - 1)
            if kept[i + 1] == kept[i] + 1 and np.isfinite(d[i] * d[i + 1])
        ]
        assert c.autocorrelation[0] == pytest.approx(np.mean(pairs) / np.nanmean(d * d))
    by_order = diagnose(x[:400], np.cumsum(rng.uniform(0.1, 3.0, 400)))
    assert by_order.step is None
    assert "at irregular times" in str(by_order)
    assert "20 lags of 1 sample" in str(by_order)


def test_first_order_noise_by_the_joint_density():
    """The restricted likelihood of all samples, from the whole covariance matrix, has its maximum
    at the result of the recursion.
    """
    at = np.delete(np.arange(60), [7, 8, 30])
    x = noise(0.6, 60)[at, 0, 0]
    found = first_order(x[:, None], at, 10, 0.95)

    def cost(phi):
        C = phi ** np.abs(at[:, None] - at)
        one, inverse = np.ones(len(at)), np.linalg.inv(C)
        information = one @ inverse @ one
        left = x - (one @ inverse @ x) / information
        variance = left @ inverse @ left / (len(at) - 1)
        return 0.5 * (
            (len(at) - 1) * np.log(variance) + np.linalg.slogdet(C)[1] + np.log(information)
        ), np.sqrt(variance)

    grid = np.linspace(0.01, 0.99, 981)
    best = grid[np.argmin([cost(phi)[0] for phi in grid])]
    assert found.phi == pytest.approx(best, abs=1e-3)
    assert found.sigma == pytest.approx(cost(found.phi)[1], rel=1e-6)
    for end in found.phi_interval:
        assert cost(end)[0] - cost(found.phi)[0] == pytest.approx(0.5 * 1.959964**2, rel=1e-4)


def test_bias_size_and_whiteness_are_told_apart():
    white = np.random.default_rng(7).standard_normal((300, 3))
    sound = diagnose(white, T, std=1.0, level=0.999)
    biased = diagnose(
        white + np.array([0.0, 0.5, 0.0]),
        T,
        std=1.0,
        names=["east_m", "north_m", "up_m"],
        level=0.999,
    )
    large = diagnose(white, T, std=[0.5, 0.5, 0.5], level=0.999)
    unknown = diagnose(white, T, level=0.999)
    assert sound.sound
    assert [biased.biased(c) for c in biased.components] == [False, True, False]
    assert f"bias     north_m: {biased.components[1].bias:.3g} (" in str(biased)
    assert "as large as predicted" in str(sound)
    assert not large.sound
    assert "overconfident, " in str(large)
    assert np.sqrt(large.sensors[0].nis) == pytest.approx(2.0, rel=0.1)
    assert "no predicted σ is given" in str(unknown)
    assert unknown.components[0].size is None
    assert all(
        found.white(c) == "white" for found in (sound, large, unknown) for c in found.components
    )


def test_a_little_correlation_of_much_data_is_called_little():
    found = diagnose(noise(0.03, 4000, 20), np.arange(4000.0))
    assert found.components[0].p < 1e-6
    assert found.white(found.components[0]) == "nearly white"
    assert "to little effect" in str(found)


def satellite(**changed):
    """[Sun2015]'s satellite with its colored noise, and the track of a filter that treats the noise
    as white.
    """
    config = scenario.Config(steps=200, runs=6, noise_level="stationary", phi=0.8, **changed)
    flown = scenario.simulate(config, [generator(3, 0, run) for run in range(6)])
    motion = celnav.Motion(
        lambda x, epoch: celnav.models.orbit.step(x, epoch.dt), sqrt_Q=config.sqrt_Q
    )
    return config, flown, motion, celnav.Sensor(np.eye(3, 6), config.sigma_km**2 * np.eye(3))


def test_a_white_filter_in_colored_noise_is_diagnosed_and_cured():
    """Phi and R are recovered within their intervals. The suggested filter passes, and its
    predicted σ agrees with its errors.
    """
    config, flown, motion, gps = satellite()
    track = celnav.run(celnav.ukf(motion, gps), flown.prior, config.times, flown.z)
    found = diagnose(track, prior=flown.prior, z=flown.z, names=["x", "y", "z"], level=0.99)
    assert not found.sound
    assert all(found.white(c) == "colored" for c in found.components)
    model = found.model
    assert model.degenerate == ""
    assert ((model.phi_interval[:, 0] < 0.8) & (model.phi_interval[:, 1] > 0.8)).all()
    assert (
        (model.sigma_interval[:, 0] < config.sigma_km)
        & (model.sigma_interval[:, 1] > config.sigma_km)
    ).all()
    assert model.gain > model.white_gain + 10.0 > 20.0
    better = celnav.colored(motion, celnav.Sensor(gps.h, model.R), model.Phi)
    cured = celnav.run(better, flown.prior, config.times, flown.z)
    np.testing.assert_allclose(
        model.predicted, cured.std[-1].mean(0) if cured.std.ndim > 2 else cured.std[-1]
    )
    np.testing.assert_allclose(
        model.white_predicted, track.std[-1].mean(0) if track.std.ndim > 2 else track.std[-1]
    )
    again = diagnose(cured, prior=flown.prior, z=flown.z)
    assert again.sound
    assert again.model is None
    text = str(found)
    assert f"{model.predicted[0]:.3g}" in text.replace("\n         ", " ")
    assert "the noise is colored" in text.replace("\n         ", " ")
    error = ((cured.mean - flown.truth)[-1, :, :3] ** 2).mean()
    assert error < 3.0 * (model.predicted[:3] ** 2).mean()


def test_without_data_or_a_model_it_says_so():
    config, flown, motion, gps = satellite()
    track = celnav.run(celnav.ukf(motion, gps), flown.prior, config.times, flown.z)
    assert "prior=prior, z=z" in diagnose(track).why
    both = celnav.run(
        celnav.augmented(motion, gps, 0.2 * np.eye(3)), flown.prior, config.times, flown.z
    )
    assert "one sensor of vectors" in diagnose(both, prior=flown.prior, z=flown.z).why


@pytest.mark.parametrize("gap", [0.0, np.nan])
@pytest.mark.parametrize("turning", ["motion", "sensor"])
def test_a_filter_of_angles_has_no_filter_for_colored_noise(turning, gap):
    """The fitted model adds the noise to vectors; on a circle the model is a different one."""
    circle = celnav.angles([0])
    spaces = {turning: circle}
    motion = celnav.Motion(lambda x, _e: x, [[1e-4]], space=spaces.get("motion", celnav.EUCLIDEAN))
    compass = celnav.Sensor(lambda x, _e: x, [[0.01]], space=spaces.get("sensor", celnav.EUCLIDEAN))
    start = celnav.Gaussian([0.0], [[0.01]])
    z = 0.1 * noise(0.8, len(T))[:, 0]
    z[50] += gap
    found = diagnose(celnav.run(celnav.ukf(motion, compass), start, T, z), prior=start, z=z)
    assert found.model is None
    assert found.why.startswith("celnav.colored is for one sensor of vectors with a constant R")


def test_a_large_first_innovation_hides_no_color():
    """The innovation normalized by its predicted σ decides, not an innovation that is large because
    of a wide prior; Phi and R come from the likelihood.
    """
    motion, radar = celnav.Motion([[1.0]], [[1e-4]]), celnav.Sensor([[1.0]], [[0.25]])
    start = celnav.Gaussian([0.0], [[1e6]])
    _, z = celnav.simulate(motion, radar, start, T, runs=5, seed=2, Phi=[[0.8]])
    found = diagnose(
        celnav.run(celnav.ukf(motion, radar), start, T, z), prior=start, z=z, level=0.99
    )
    assert found.white(found.components[0]) == "colored"
    assert found.model.phi_interval[0, 0] < 0.8 < found.model.phi_interval[0, 1]
    assert found.model.sigma_interval[0, 0] < 0.5 < found.model.sigma_interval[0, 1]
    alone = diagnose(celnav.run(celnav.ukf(motion, radar), start, T, z))
    assert "Phi of its innovations" in str(alone)
    assert "with R=" not in str(alone)


def test_sensors_and_runs_that_are_lost():
    """Each sensor has a separate size; unused components are left out."""
    motion, start = (
        celnav.Motion(np.eye(2), 0.01 * np.eye(2)),
        celnav.Gaussian(np.zeros(2), np.eye(2)),
    )
    sensors = celnav.Sensor(np.eye(2), np.eye(2)), celnav.Sensor(np.eye(1, 2), [[0.25]])
    _, z = celnav.simulate(motion, sensors, start, T, runs=3)
    z[1][::3] = np.nan
    wrong = sensors[0], celnav.Sensor(np.eye(1, 2), [[0.04]])
    found = diagnose(celnav.run(celnav.ukf(motion, *wrong), start, T, z))
    assert [sensor.names for sensor in found.sensors] == [("z0", "z1"), ("z2",)]
    assert found.components[2].samples == np.isfinite(z[1]).sum()
    first, second = found.sensors
    assert second.nis > second.band[1]
    assert second.nis > first.nis


@pytest.mark.parametrize("std", [1.0, None])
def test_the_figure(std):
    drawn = figure(diagnose(noise(0.5, 300, m=2), T, std=std))
    titles = ["(a) Is it white?", "(b) Is it as large as predicted?"] if std else ["Is it white?"]
    assert [ax.get_title() for ax in drawn.axes] == titles
    assert len(drawn.axes[0].lines) >= 3


def flat(text):
    """The page as one line."""
    return str(text).replace("\n         ", " ")


# -- noise that is fitted --------------------------------------------------------------------------
def least_squares(x, C):
    """Mean, its σ and the restricted log-likelihood of samples with covariance C, written out."""
    one, inverse = np.ones(len(x)), np.linalg.inv(C)
    information = one @ inverse @ one
    left = x - one @ inverse @ x / information
    log_det = np.linalg.slogdet(C)[1] + np.log(information)
    return information**-0.5, -0.5 * (log_det + left @ inverse @ left)


def test_the_mean_of_first_order_noise_is_as_uncertain_as_generalized_least_squares_say():
    """With gaps and runs: every pair within a run enters by its distance, and no pair from two
    runs.
    """
    place = np.delete(np.arange(80), [7, 8, 30, 55])
    x = noise(0.7, 80, 2)[place, :, 0]
    x[5, 0] = np.nan
    found = first_order(x, place, 10, 0.95)
    runs, at = np.nonzero(np.isfinite(x).T)
    distance = np.abs(place[at][:, None] - place[at])
    C = found.sigma**2 * np.where(runs[:, None] == runs, found.phi**distance, 0.0)
    sigma, _ = least_squares(x.T[np.isfinite(x).T], C)
    assert found.mean_sigma == pytest.approx(sigma, rel=1e-9)


def test_the_filter_that_is_suggested_predicts_what_is_said():
    """For the mean of the samples, which is a constant without prior information."""
    x = 1.5 * noise(0.9, 600)[:, 0]
    found = diagnose(x, np.arange(600.0), std=1.0)
    fit = found.components[0].coloring
    constant = celnav.Motion([[1.0]], [[0.0]])
    fix = celnav.Sensor([[1.0]], [[fit.sigma**2]])
    start = celnav.Gaussian([0.0], [[1e8]])
    track = celnav.run(celnav.colored(constant, fix, [[fit.phi]]), start, np.arange(600.0), x)
    assert fit.mean_sigma == pytest.approx(track.std[-1, 0], rel=1e-6)
    assert f"predicts σ = {track.std[-1, 0]:.3g}, white noise" in flat(found)
    assert f"white noise {fit.sigma / np.sqrt(600):.3g}" in flat(found)


def test_first_order_noise_plus_white_noise_by_the_joint_density():
    """No neighbor of the fit is more probable, and likelihood and σ of the mean equal the values
    from the covariance matrix.
    """
    rng, place = np.random.default_rng(4), np.delete(np.arange(300), slice(100, 130))
    x = (noise(0.9, 300, 2, rng=rng) + 0.7 * rng.standard_normal((300, 2, 1)))[place, :, 0]
    found = first_order(x, place, 20, 0.95)
    mixture = found.mixture
    runs, at = np.nonzero(np.isfinite(x).T)
    distance = np.abs(place[at][:, None] - place[at])

    def density(phi, sigma, white):
        C = sigma**2 * np.where(runs[:, None] == runs, phi**distance, 0.0)
        return least_squares(x.T.ravel(), C + white**2 * np.eye(len(C)))

    best = density(mixture.phi, mixture.sigma, mixture.white_sigma)
    alone = density(found.phi, found.sigma, 0.0)
    assert mixture.mean_sigma == pytest.approx(best[0], rel=1e-9)
    assert mixture.gain == pytest.approx(best[1] - alone[1], rel=1e-6)
    for i in range(3):
        for factor in (0.98, 1.02):
            near = [mixture.phi, mixture.sigma, mixture.white_sigma]
            near[i] *= factor
            assert density(*near)[1] < best[1]
    assert mixture.p > 0.05 > found.p


def test_a_model_that_was_rejected_is_not_suggested():
    rng = np.random.default_rng(4)
    mixed = noise(0.9, 1000, rng=rng)[:, 0] + 0.7 * rng.standard_normal((1000, 1))
    found = diagnose(mixed, np.arange(1000.0))
    assert "suggested: a state V' = 0.9" in flat(found)
    assert "suggested: celnav.colored" not in flat(found)
    swinging = np.zeros((1000, 1))
    for k in range(2, 1000):
        swinging[k] = 1.6 * swinging[k - 1] - 0.9 * swinging[k - 2] + rng.standard_normal()
    text = flat(diagnose(swinging, np.arange(1000.0)))
    assert text.count("rejected: its innovations are not white (p < 1e-15)") == 2
    assert "model    z0: none suggested; celnav.colored(motion, sensor, Phi=[[0.8" in text
    assert " suggested: " not in text.replace("none suggested", "")


def test_noise_that_alternates_is_fitted_too():
    """Its first correlation is -1, so no sum of two neighboring correlations is positive."""
    found = diagnose(np.tile([[1.0], [-1.0]], (150, 1)), T)
    assert found.components[0].autocorrelation[0] == pytest.approx(-1.0)
    assert found.components[0].longer < 0.1
    assert "nan" not in str(found)


# -- lags ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("jitter", [0, 1])
def test_a_slow_sensor_is_judged_on_its_own_samples(jitter):
    """A sensor at each 25th epoch of a fast sensor is evaluated as if there
    were no other epochs.
    """
    slow = noise(0.9, 300)[:, 0, 0]
    at = 25 * np.arange(300) + jitter * np.random.default_rng(0).integers(-1, 2, 300)
    at[0] = 0
    x = np.full((7500, 2), np.nan)
    x[:, 0], x[at, 1] = np.random.default_rng(1).standard_normal(7500), slow
    fast, found = diagnose(x, 0.1 * np.arange(7500.0), std=1.0).components
    alone = diagnose(slow[:, None], 2.5 * np.arange(300.0), std=1.0).components[0]
    assert fast.step == pytest.approx(0.1)
    assert found.step == pytest.approx(2.5, rel=1e-3)
    assert found.p < 1e-15
    assert found.longer == pytest.approx(alone.longer)
    np.testing.assert_allclose(found.autocorrelation, alone.autocorrelation)
    np.testing.assert_allclose(found.band, alone.band)
    np.testing.assert_allclose(found.bias_interval, alone.bias_interval)
    np.testing.assert_allclose(found.size_band, alone.size_band)
    assert found.coloring.phi == pytest.approx(alone.coloring.phi)
    text = flat(diagnose(x, 0.1 * np.arange(7500.0), std=1.0))
    assert "z1: no (Ljung-Box" in text
    assert "20 lags of 2.5 s" in text
    assert "an epoch each 2.5 s" in text


def test_most_samples_missing_at_random_leave_the_grid():
    x = noise(0.9, 2000)[:, 0]
    x[np.random.default_rng(0).random(2000) < 0.7] = np.nan
    c = diagnose(x, np.arange(2000.0)).components[0]
    assert c.step == 1.0
    assert c.coloring.phi_interval[0] < 0.9 < c.coloring.phi_interval[1]


def test_clocks_that_jitter_and_long_gaps_have_a_grid_too():
    t = np.arange(400.0) + np.random.default_rng(0).uniform(-0.04, 0.04, 400)
    t[200:] += 100.0
    place, step = grid_index(t)
    np.testing.assert_array_equal(place, np.rint(t - t[0]).astype(int))
    assert step == pytest.approx(1.0, rel=1e-3)
    assert grid_index(np.cumsum(np.random.default_rng(0).uniform(0.1, 3.0, 400)))[1] is None


def test_epochs_off_any_grid_have_the_model_of_their_order():
    """If nothing depends on the time between the epochs."""
    filter = celnav.ukf(celnav.Motion(np.eye(1), [[1e-4]]), celnav.Sensor(np.eye(1), [[1.0]]))
    prior, z = celnav.Gaussian([0.0], [[1.0]]), noise(0.8, 300)[:, 0]
    off = np.cumsum(np.random.default_rng(0).uniform(0.1, 3.0, 300))
    one, other = (
        diagnose(celnav.run(filter, prior, t, z), prior=prior, z=z) for t in (off, np.arange(300.0))
    )
    assert one.step is None
    assert one.components[0].step is None
    assert one.model.phi_interval[0, 0] < 0.8 < one.model.phi_interval[0, 1]
    for name in ("Phi", "R", "predicted"):
        np.testing.assert_allclose(
            getattr(one.model, name), getattr(other.model, name), rtol=1e-3, err_msg=name
        )


def test_without_pairs_it_cannot_tell():
    x = np.full((100, 100, 1), np.nan)
    x[np.arange(100), np.arange(100)] = np.random.default_rng(0).standard_normal((100, 1))
    found = diagnose(x, np.arange(100.0), std=1.0)
    (c,) = found.components
    assert np.isnan([c.p, c.ljung_box, *c.autocorrelation, *c.band]).all()
    assert (c.effective, c.effective_squares, c.longer) == (100.0, 100.0, 1.0)
    assert found.white(c) == "unknown"
    assert not found.sound
    assert "z0: cannot tell: too few pairs of its samples lie within 20 lags of 1 s" in flat(found)
    assert "no pairs" in str(found)
    assert len(figure(found).axes[0].lines) >= 1


def test_the_figure_of_a_slow_sensor_has_its_lags_and_measured_epochs():
    x = np.full((2500, 1), np.nan)
    x[::25] = noise(0.5, 100)[:, 0]
    lags, means = figure(diagnose(x, 0.1 * np.arange(2500.0), std=1.0)).axes
    curve = next(line for line in lags.lines if len(line.get_xdata()) == 20)
    np.testing.assert_allclose(curve.get_xdata(), 2.5 * np.arange(1, 21))
    binned = next(line for line in means.lines if len(line.get_xdata()) == 60)
    assert np.isfinite(binned.get_ydata()).all()


# -- tracks ----------------------------------------------------------------------------------------
WALK = constant_velocity(2, 0.01)
FIX = celnav.Sensor(np.eye(2, 4), 4.0 * np.eye(2))
HERE = celnav.Gaussian(np.zeros(4), np.diag([4.0, 4.0, 1.0, 1.0]))


def test_a_motion_whose_noise_is_a_function_has_a_rival_too():
    """A motion of the package and its matrices are the same model, and get the same diagnosis."""
    times = np.arange(200.0)
    _, z = celnav.simulate(WALK, FIX, HERE, times, runs=2, seed=1, Phi=0.9 * np.eye(2))
    Q = 0.01 * np.kron([[1.0 / 3.0, 0.5], [0.5, 1.0]], np.eye(2))
    by_function, by_matrix = (
        diagnose(celnav.run(celnav.ukf(motion, FIX), HERE, times, z), prior=HERE, z=z)
        for motion in (WALK, celnav.Motion(np.eye(4) + np.eye(4, k=2), Q))
    )
    assert by_function.model.white_gain == pytest.approx(by_matrix.model.white_gain, abs=1e-3)
    assert by_function.model.gain == pytest.approx(by_matrix.model.gain, abs=1e-3)
    assert flat(by_function).endswith(flat(by_matrix).partition("the log-likelihood")[2])
    assert "the noise is colored" in flat(by_function)
    assert "nan" not in str(by_function)


def test_components_stay_as_correlated_as_they_were_given():
    """Each component has its σ and its coefficient; R is printed as a full matrix."""
    R, times = 1e-14 * np.array([[4.0, 1.5], [1.5, 1.0]]), np.arange(100.0)
    walk, start = constant_velocity(2, 1e-16), celnav.Gaussian(HERE.mean, 1e-14 * HERE.cov)
    fix = celnav.Sensor(np.eye(2, 4), R)
    _, z = celnav.simulate(walk, fix, start, times, runs=1, seed=1, Phi=0.9 * np.eye(2))
    found = diagnose(celnav.run(celnav.ukf(walk, fix), start, times, z), prior=start, z=z)
    sigma = np.sqrt(found.model.R.diagonal())
    np.testing.assert_allclose(found.model.R / np.outer(sigma, sigma), [[1.0, 0.75], [0.75, 1.0]])
    printed = re.search(r"with R=np\.array\((.*?)\);", flat(found)).group(1)
    np.testing.assert_allclose(ast.literal_eval(printed), found.model.R, rtol=1e-3)


def test_what_was_not_compared_is_said():
    times = np.arange(100.0)
    _, z = celnav.simulate(WALK, FIX, HERE, times, runs=1, seed=1, Phi=0.9 * np.eye(2))
    found = diagnose(celnav.run(celnav.ukf(WALK, FIX), HERE, times, z), prior=HERE, z=z)
    alone = found.model._replace(factors=None, not_compared="the filter fails")
    text = flat(found._replace(model=alone))
    assert "other Q and R alone were not compared (the filter fails)" in text
    assert "fitted, not suggested: celnav.colored(" in text
    assert "nan" not in text
    assert "these data" not in text
    assert "suggested: celnav.colored(" in flat(found).replace("not suggested", "")
    assert "times" not in flat(found).partition("model")[2]


def test_missing_samples_are_fitted_by_the_filter_that_loses_nothing():
    """Each missing sample costs two differences, so the likelihood of differences is not the
    likelihood of all data.
    """
    walk, fix = celnav.Motion([[1.0]], [[0.01]]), celnav.Sensor([[1.0]], [[1.0]])
    start, times = celnav.Gaussian([0.0], [[1.0]]), np.arange(400.0)
    _, z = celnav.simulate(walk, fix, start, times, runs=1, seed=3, Phi=[[0.9]])
    z = z[:, 0]
    z[np.random.default_rng(0).random(400) < 0.3] = np.nan
    track = celnav.run(celnav.ukf(walk, fix), start, times, z)
    found = diagnose(track, prior=start, z=z)
    model = found.model
    assert model.name == "augmented"
    assert model.phi_interval[0, 0] < 0.9 < model.phi_interval[0, 1]
    best = celnav.augmented(walk, celnav.Sensor([[1.0]], model.R), model.Phi)
    again = celnav.run(best, start, times, z)
    assert model.gain == pytest.approx(again.log_likelihood - track.log_likelihood)
    np.testing.assert_allclose(model.predicted, again.std[-1, :1])
    assert "celnav.augmented(motion, sensor, Phi=" in str(found)


def test_noise_functions_and_measurement_functions_are_fitted_together():
    turn = celnav.models.motion.coordinated_turn(0.1, 1e-5)
    ranges = celnav.Sensor(lambda x, _epoch: np.hypot(x[..., :1], x[..., 1:2]), [[25.0]])
    start = celnav.Gaussian([500.0, 500.0, 5.0, 0.0, 0.01], np.diag([25.0, 25.0, 1.0, 1.0, 1e-4]))
    times = np.arange(100.0)
    _, z = celnav.simulate(turn, ranges, start, times, runs=1, seed=2, Phi=[[0.9]])
    found = diagnose(celnav.run(celnav.ukf(turn, ranges), start, times, z), prior=start, z=z)
    assert found.model.name == "augmented"
    assert np.isfinite(found.model.white_gain)


# -- angles ----------------------------------------------------------------------------------------
def polar(x, _epoch):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), np.arctan2(x[..., 1], x[..., 0])], -1)


POLAR = np.diag([25.0, np.radians(1.0) ** 2])
WRAPS = celnav.Sensor(polar, POLAR, space=celnav.angles([1]))
CURE = "the cure is celnav.Sensor(..., space=celnav.angles([1]))"


def crossing(sensor, runs, rate=1.0, filter=celnav.ekf):
    """A target that crosses the angle's wrap at +-pi, south of the radar; its track and
    measurements.
    """
    start = celnav.Gaussian([-800.0, -150.0, 0.0, rate], np.diag([100.0, 100.0, 1.0, 1.0]))
    times = np.arange(400.0)
    _, z = celnav.simulate(WALK, WRAPS, start, times, runs=runs, seed=3)
    made = filter(WALK, sensor)
    return celnav.run(made, start, times, z, on_failure="flag"), z, start


@pytest.mark.parametrize("filter", [celnav.ukf, celnav.ekf])
def test_a_forgotten_wrap_is_said_by_name(filter):
    track, z, start = crossing(celnav.Sensor(polar, POLAR), 20, filter=filter)
    found = diagnose(track, prior=start, z=z)
    assert "wrap     z1: " in str(found)
    assert CURE in flat(found)
    assert CURE in flat(diagnose(track))
    assert found.model is None
    assert "wrap the angle first" in str(found)
    assert not found.sound
    cured, z, _ = crossing(WRAPS, 20, filter=filter)
    assert diagnose(cured, z=z).wraps == diagnose(cured).wraps == ()


def test_one_crossing_is_enough_where_the_measurements_are_known():
    walk = celnav.Motion([[1.0, 1.0], [0.0, 1.0]], np.diag([1e-5, 1e-6]))
    compass, start = (
        celnav.Sensor(np.eye(1, 2), [[0.01]]),
        celnav.Gaussian([2.5, 0.02], np.diag([0.01, 1e-6])),
    )
    times = np.arange(40.0)
    _, z = celnav.simulate(walk, compass, start, times, runs=1, seed=1)
    for measured in (wrap(z[:, 0]), np.mod(z[:, 0] + np.pi, 2.0 * np.pi)):
        moved = celnav.Gaussian(
            start.mean + (measured[0, 0] - z[0, 0, 0]) * np.eye(2)[0], start.cov
        )
        track = celnav.run(celnav.ukf(walk, compass), moved, times, measured)
        (line,) = diagnose(track, z=measured).wraps
        assert line.startswith("z0: 1 of 40 samples jump by 2 pi")
        assert diagnose(track).wraps == ()


@pytest.mark.parametrize("filter", [celnav.ukf, celnav.ekf])
@pytest.mark.parametrize("runs", [1, 30])
def test_a_filter_that_is_lost_after_its_first_jump_still_names_the_angle(runs, filter):
    """The innovations after the jump are large and do not count. One run needs z."""
    noise, times = np.diag([25.0, np.radians(5.0) ** 2]), np.arange(60.0)
    walk = celnav.models.motion.constant_velocity(2, q=0.05)
    start = celnav.Gaussian([-300.0, 60.0, 0.0, -3.0], np.diag([25.0, 25.0, 1.0, 1.0]))
    right = celnav.Sensor(polar, noise, space=celnav.angles([1]))
    truth, z = celnav.simulate(walk, right, start, times, runs=runs, seed=3)
    for sensor, forgotten in ((celnav.Sensor(polar, noise), True), (right, False)):
        track = celnav.run(filter(walk, sensor), start, times, z, keep="cov", on_failure="flag")
        found = diagnose(track, z=z).wraps
        assert [CURE in line for line in found] == [True] * forgotten
        if runs > 1:
            assert track.report(truth).wraps == diagnose(track).wraps
            assert bool(diagnose(track).wraps) == forgotten


@pytest.mark.parametrize("case", ["offset", "wide", "heavy", "outliers", "multipath"])
def test_sensors_that_are_no_angles_are_left_alone(case):
    """Ranges whose innovations are near 2 pi by chance; if multipath has just this size, z shows
    that they are ranges.
    """
    rng = np.random.default_rng(5)
    x = 0.1 * rng.standard_normal((2000, 1))
    if case == "offset":
        x = x + 2.0 * np.pi
    elif case == "wide":
        x = 60.0 * x
    elif case == "heavy":
        x = x / rng.standard_normal((2000, 1))
    else:
        late = rng.random((2000, 1)) < 0.05
        x = x + late * (rng.exponential(8.0, (2000, 1)) if case == "outliers" else 2.0 * np.pi)
    z = 40.0 + x
    assert diagnose(x, np.arange(2000.0), z=z).wraps == ()
    if case != "multipath":
        assert diagnose(x, np.arange(2000.0)).wraps == ()


@pytest.mark.parametrize(("turns", "wraps"), [(30, False), (60, True)])
def test_jumps_are_a_wrap_only_if_a_third_of_them_are_turns(turns, wraps):
    """Both counts exceed the number of full turns expected for jumps of any size."""
    x = 0.02 * np.random.default_rng(5).standard_normal((2000, 1))
    x[10:1990:16, 0] = 10.0  # 124 that are not full turns
    x[10 : 10 + 16 * turns : 16, 0] = 2.0 * np.pi
    found = diagnose(x, np.arange(2000.0)).wraps
    assert [line.split(",")[0] for line in found] == wraps * [
        f"z0: {turns} of 2000 samples jump by 2 pi"
    ]


# -- pages, whole ----------------------------------------------------------------------------------
SOUND = """\
one run, 300 epochs over 299 s, 1 s apart; 4 components missing

component  samples     rms  predicted σ     mean            (99 %)  lag 1    correlation at lag 1  p if white
east_m         300  0.9153            1  -0.0665  -0.215 to 0.0817    1 s  -0.003 (white: ±0.149)        0.75
north_m        296  0.9495            1   -0.202  -0.419 to 0.0137    1 s  -0.042 (white: ±0.150)        0.78

size     east_m, north_m: as large as predicted (east_m 0.915, north_m 0.949); NIS per degree of freedom is
         0.869, expected 0.856 to 1.16 (99 %, correlation counted)
bias     east_m, north_m: none detected
white    east_m: yes (Ljung-Box 15.4 of 20 lags of 1 s, p 0.75; 0 beyond the band)
white    north_m: yes (Ljung-Box 14.85 of 20 lags of 1 s, p 0.78; 0 beyond the band)"""


def test_the_page_of_sound_residuals():
    white = np.random.default_rng(7).standard_normal((300, 2))
    white[5:9, 1] = np.nan
    found = diagnose(white, T, std=1.0, names=["east_m", "north_m"], level=0.99)
    assert str(found) == SOUND


SLOW = """\
one run, 7500 epochs over 749.9 s, 0.1 s apart; 7200 components missing

component                               fast                   slow
samples                                 7500                    300
rms                                   0.9959                 0.9142
predicted σ                                1                      1
mean                                -0.00582                 0.0765
(95 %)                     -0.0283 to 0.0166        -0.203 to 0.356
lag 1                                  0.1 s                  2.5 s
correlation at lag 1  -0.005 (white: ±0.023)  0.798 (white: ±0.113)
p if white                              0.92                < 1e-15

size     fast, slow: as large as predicted (fast 0.996, slow 0.914); NIS per degree of freedom is 0.986,
         expected 0.967 to 1.03 (95 %, correlation counted)
bias     fast, slow: none detected
white    fast: yes (Ljung-Box 12.02 of 20 lags of 0.1 s, p 0.92; 1 beyond the band)
white    slow: no (Ljung-Box 501 of 20 lags of 2.5 s, p < 1e-15; 8 beyond the band); σ of its mean is 2.63
         times that of white noise
noise    slow: Phi from sample to sample = 0.804 (0.735 to 0.873, 95 %), a correlation time of 11.4 s, σ =
         0.9244 (0.7966 to 1.154)
noise    slow: first-order noise is accepted: its innovations are white (p 0.58)
model    slow: suggested: celnav.colored(motion, sensor, Phi=[[0.804]]) with R=[[0.8545]], an epoch each
         2.5 s; for the mean of these samples it predicts σ = 0.16, white noise 0.0534"""


def test_the_page_of_a_fast_and_a_slow_sensor():
    x = np.full((7500, 2), np.nan)
    x[:, 0], x[::25, 1:] = np.random.default_rng(1).standard_normal(7500), noise(0.8, 300)[:, 0]
    found = diagnose(x, 0.1 * np.arange(7500.0), std=[1.0, 1.0], names=["fast", "slow"])
    assert str(found) == SLOW


MIXED = """\
one run, 1000 epochs over 999 s, 1 s apart

component  samples    rms  predicted σ     mean           (95 %)  lag 1   correlation at lag 1  p if white
z0            1000  1.222            -  -0.0366  -0.339 to 0.266    1 s  0.637 (white: ±0.062)     < 1e-15

size     z0: no predicted σ is given, so nothing is said of the size
bias     z0: none detected
white    z0: no (Ljung-Box 2410 of 20 lags of 1 s, p < 1e-15; 20 beyond the band); σ of its mean is 3.92 times
         that of white noise
noise    z0: Phi from sample to sample = 0.639 (0.591 to 0.687, 95 %), a correlation time of 2.23 s, σ = 1.224
         (1.149 to 1.317)
noise    z0: first-order noise is rejected: its innovations are not white (p < 1e-15)
noise    z0: with white noise beside it, it is accepted: its innovations are white (p 0.76); the
         log-likelihood grows by 66.35
model    z0: suggested: a state V' = 0.9178 V + zeta, zeta of variance 0.1695 and V of 1.075, measured as h(x)
         + V with R=[[0.4484]]; for the mean of these samples it predicts σ = 0.158, the first-order noise
         alone 0.0823, white noise 0.0387"""


def test_the_page_of_first_order_noise_beside_white_noise():
    rng = np.random.default_rng(4)
    mixed = noise(0.9, 1000, rng=rng)[:, 0] + 0.7 * rng.standard_normal((1000, 1))
    assert str(diagnose(mixed, np.arange(1000.0))) == MIXED


TRACK = """\
one run, 300 epochs over 299 s, 1 s apart

component  samples    rms  predicted σ    mean           (95 %)  lag 1   correlation at lag 1  p if white
z0             300  1.347            -  0.0583  -0.258 to 0.374    1 s  0.711 (white: ±0.113)     < 1e-15

size     z0: 0.572 times as large as predicted; NIS per degree of freedom is 0.327, expected 0.762 to 1.27
         (95 %, correlation counted)
bias     z0: none detected
white    z0: no (Ljung-Box 328 of 20 lags of 1 s, p < 1e-15; 11 beyond the band); σ of its mean is 2.05 times
         that of white noise
model    suggested: celnav.colored(motion, sensor, Phi=np.diag([0.862])) with R=np.diag([2.754]); at the end
         it predicts σ = 1.57, 0.249, the given filter 1.04, 0.242
model    Phi lies in 0.6158 to 0.9546, σ of its noise in 0.9519 to 2.893 (95 %)
model    the log-likelihood grows by 176.9 with it, by 44.43 with other Q and R alone: the noise is colored
model    its innovations are white (p 0.71)"""


def test_the_page_of_a_track_with_colored_noise():
    """The page of one log, without an axis of runs."""
    motion = celnav.models.motion.constant_velocity(1, 0.01)
    gps, start = (
        celnav.Sensor([[1.0, 0.0]], [[4.0]]),
        celnav.Gaussian([0.0, 0.0], np.diag([4.0, 1.0])),
    )
    z = celnav.simulate(motion, gps, start, T, runs=1, seed=1, Phi=[[0.9]])[1][:, 0]
    track = celnav.run(celnav.ukf(motion, gps), start, T, z)
    assert str(diagnose(track, prior=start, z=z)) == TRACK


# -- arguments -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "options", "match"),
    [
        (
            (np.ones((300, 1)), T),
            {},
            "at least 20 samples that vary for each component, got only 1 for z0",
        ),
        ((RNG.standard_normal((10, 1)), T[:10]), {}, "got 10 samples for z0"),
        ((RNG.standard_normal((300, 1)), None), {}, "times: expected times with an array"),
        (
            (RNG.standard_normal((300, 1)), T[::-1]),
            {},
            "times: expected increasing times, got a difference of",
        ),
        ((RNG.standard_normal(300), T), {}, r"residuals: expected shape \(300, ..., m\)"),
        ((RNG.standard_normal((300, 2)), T[1:]), {}, r"residuals: expected shape \(299, ..., m\)"),
        (
            (RNG.standard_normal((300, 2)), T),
            {"std": np.ones(3)},
            r"std: expected a shape that broadcasts to the residuals' \(300, 2\)",
        ),
        ((RNG.standard_normal((300, 1)), T), {"std": 0.0}, "std: expected positive"),
        ((RNG.standard_normal((300, 2)), T), {"names": ["x"]}, "names: expected 2"),
        ((RNG.standard_normal((300, 2)), T), {"lags": 0}, "lags"),
        ((RNG.standard_normal((300, 2)), T), {"level": 1.0}, "level"),
    ],
)
def test_bad_input_is_refused_by_name(arguments, options, match):
    with pytest.raises(ValueError, match=match):
        diagnose(*arguments, **options)


def test_a_track_without_innovations_is_refused():
    config, flown, motion, gps = satellite()
    track = celnav.run(celnav.ukf(motion, gps), flown.prior, config.times, flown.z, keep="nothing")
    with pytest.raises(ValueError, match="residuals: expected a track with innovations"):
        diagnose(track)


def test_residuals_may_have_dates():
    x = np.random.default_rng(5).standard_normal((60, 1))
    dates = np.datetime64("2026-03-01T00:00:00") + np.arange(60) * np.timedelta64(30, "s")
    assert str(diagnose(x, dates)) == str(diagnose(x, 30.0 * np.arange(60)))
