"""A log that is asked: white, biased, wrongly sized and colored residuals are told apart, and bands cover what they promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, chi2

import celnav
from celnav.analysis.diagnose import diagnose, first_order
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
    """Whether a count of successes is within binomial error, of one in a thousand, of a probability."""
    return binom.ppf(0.0005, of, level) <= count <= binom.ppf(0.9995, of, level)


@pytest.mark.parametrize(
    ("phi", "steps", "runs"),
    [(0.0, 300, 1), (0.0, 40, 4), (0.7, 300, 1), (0.9, 400, 2), (-0.5, 300, 1)],
)
def test_bands_and_intervals_cover(phi, steps, runs):
    """At 95 % of many logs: the bias 0, the size 1, the coefficient and the deviation; and white noise passes Ljung and Box."""
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
    """Autocorrelation, Ljung and Box's statistic, NIS: of complete data, written out."""
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


def test_gaps_and_missing_components_cost_only_themselves():
    """Pairs of a lag are those that exist, by their times; what is left out of a long log changes no conclusion."""
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
        assert c.coloring.rest_p > 0.01
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
    assert "a lag is an epoch" in str(by_order)


def test_first_order_noise_by_the_joint_density():
    """The restricted likelihood of all samples at once, by the whole covariance, has its maximum where the recursion says."""
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
    assert "as large as claimed" in str(sound)
    assert not large.sound
    assert "times as large as claimed" in str(large)
    assert np.sqrt(large.sensors[0].nis) == pytest.approx(2.0, rel=0.1)
    assert "no deviations are claimed" in str(unknown)
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
    """[Sun2015]'s satellite with its colored noise, and what a filter believes that takes it for white."""
    config = scenario.Config(steps=200, runs=6, noise_level="stationary", phi=0.8, **changed)
    flown = scenario.simulate(config, [generator(3, 0, run) for run in range(6)])
    motion = celnav.Motion(
        lambda x, epoch: celnav.models.orbit.step(x, epoch.dt), sqrt_Q=config.sqrt_Q
    )
    return config, flown, motion, celnav.Sensor(np.eye(3, 6), config.sigma_km**2 * np.eye(3))


def test_a_white_filter_in_colored_noise_is_diagnosed_and_cured():
    """Phi and R are recovered within their intervals, the filter that is advised passes, and claims what its errors are."""
    config, flown, motion, gps = satellite()
    track = celnav.run(celnav.ukf(motion, gps), flown.prior, config.times, flown.z)
    found = diagnose(track, prior=flown.prior, z=flown.z, names=["x", "y", "z"], level=0.99)
    assert not found.sound
    assert all(found.white(c) == "colored" for c in found.components)
    model = found.model
    assert model.converged
    assert ((model.phi_interval[:, 0] < 0.8) & (model.phi_interval[:, 1] > 0.8)).all()
    assert (
        (model.sigma_interval[:, 0] < config.sigma_km)
        & (model.sigma_interval[:, 1] > config.sigma_km)
    ).all()
    assert model.gain > model.white_gain + 10.0 > 20.0
    better = celnav.colored(motion, celnav.Sensor(gps.h, model.R), model.Phi)
    cured = celnav.run(better, flown.prior, config.times, flown.z)
    np.testing.assert_allclose(
        model.claims, cured.std[-1].mean(0) if cured.std.ndim > 2 else cured.std[-1]
    )
    np.testing.assert_allclose(
        model.white_claims, track.std[-1].mean(0) if track.std.ndim > 2 else track.std[-1]
    )
    again = diagnose(cured, prior=flown.prior, z=flown.z)
    assert again.sound
    assert again.model is None
    text = str(found)
    assert f"{model.claims[0]:.3g}" in text.replace("\n         ", " ")
    assert "it is color" in text.replace("\n         ", " ")
    error = ((cured.mean - flown.truth)[-1, :, :3] ** 2).mean()
    assert error < 3.0 * (model.claims[:3] ** 2).mean()


def test_without_data_or_a_model_it_says_so():
    config, flown, motion, gps = satellite()
    track = celnav.run(celnav.ukf(motion, gps), flown.prior, config.times, flown.z)
    assert "prior=prior, z=z" in diagnose(track).why
    both = celnav.run(
        celnav.augmented(motion, gps, 0.2 * np.eye(3)), flown.prior, config.times, flown.z
    )
    assert "one sensor of vectors" in diagnose(both, prior=flown.prior, z=flown.z).why


def test_a_large_first_innovation_hides_no_color():
    """What is normalized by its claim decides, not what is large because the prior was wide; Phi and R come of the likelihood."""
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
    assert "Phi of the innovations is" in str(alone)
    assert "with R=" not in str(alone)


def test_sensors_and_runs_that_are_lost():
    """Each sensor has a size of its own; what was not used is not there."""
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


@pytest.mark.parametrize("claimed", [1.0, None])
def test_the_figure(claimed):
    drawn = figure(diagnose(noise(0.5, 300, m=2), T, std=claimed))
    assert [ax.get_title() for ax in drawn.axes] == ["Is it white?", "Is it as large as claimed?"][
        : 2 if claimed else 1
    ]
    assert len(drawn.axes[0].lines) >= 3


@pytest.mark.parametrize(
    ("arguments", "options", "match"),
    [
        (
            (np.ones((300, 1)), T),
            {},
            "at least 20 samples that vary of each component, got only 1 of z0",
        ),
        ((RNG.standard_normal((10, 1)), T[:10]), {}, "got 10 samples of z0"),
        ((RNG.standard_normal((300, 1)), None), {}, "times: expected them with an array"),
        ((RNG.standard_normal((300, 1)), T[::-1]), {}, "times: expected them to increase"),
        ((RNG.standard_normal(300), T), {}, r"residuals: expected shape \(300, ..., m\)"),
        ((RNG.standard_normal((300, 2)), T[1:]), {}, r"residuals: expected shape \(299, ..., m\)"),
        (
            (RNG.standard_normal((300, 2)), T),
            {"std": np.ones(3)},
            r"std: expected deviations that go with residuals \(300, 2\)",
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
