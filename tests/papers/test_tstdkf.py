"""The pulsar paper: its ephemerides, its noises, filters that must agree, and the ledger."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr
from once import once
from readable import faults
from scipy.interpolate import CubicSpline

from celnav import Epoch, FilterError, Gaussian, Motion, Sensor, ekf, run, steps
from celnav.files import Outputs, data, read_npz
from celnav.filters.run import ENGINE
from celnav.filters.two_stage import TwoStage
from celnav.models.ephemeris import GM, de421
from celnav.models.orbit import advance, flow
from celnav.models.pulsar import LIGHT_KM_S, pulsars
from celnav.papers.tstdkf import PRESETS, SETTINGS, STUDY, Setting, filters, show, simulate, study
from celnav.papers.tstdkf.scenario import (
    LINEAR,
    TABLE_5,
    YEAR,
    kalman,
    linearized,
    models,
    nine_states,
    nominal,
    sky,
    trial,
)
from celnav.show.claims import dumps
from celnav.study.montecarlo import generator

SHORT = replace(TABLE_5, days=0.5)
WHITE = replace(SHORT, setting=SETTINGS[5])
STATEMENTS = [
    "earth-km-gives-km",
    "augmentation-falls-short",
    "de405-to-de421",
    "ephemeris-error-slow",
    "central-body-position-dominates",
    "other-body-or-ephemeris-alike",
    "de421-planets",
    "third-bodies-not-white",
    "measurement-noise-colored",
    "tkf-converges-fast-and-cheap",
    "reduces-to-ekf",
    "rho-trades-speed-for-noise",
    "month-errors-lower",
    "month-bias-faster",
    "year-tracked",
    "tkf-approaches-then-lost",
    "best-in-all-settings",
    "stable-over-settings",
    "position-more-sensitive",
    "setting-1-position",
    "setting-1-velocity",
    "setting-1-largest",
    "measurement-color-matters-more",
    "setting-5-alike",
]
PRINTED = {
    "earth-km-gives-km": "1",
    "ephemeris-error-slow": "300",
    "rho-trades-speed-for-noise": "[0, 50]",
    "tkf-approaches-then-lost": "30",
    "best-in-all-settings": "5",
    "setting-1-position": "[56.49, 35.18]",
    "setting-1-velocity": "[27.66, 17.07]",
}


def runs(count, study=0):
    return [generator(0, study, r) for r in range(count)]


# -- ephemerides -----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["ephemeris_2015.npz", "planets_2015.npz"])
def test_the_table_is_the_one_that_the_readme_names(name):
    digest = hashlib.sha256(data(name).read_bytes()).hexdigest()
    assert digest in (data("README.md")).read_text(encoding="utf-8")


def test_figure_2s_extremes():
    earth = study.ephemerides()[1]["de405/earth"]
    assert earth.shape == (1753, 3)
    np.testing.assert_allclose(earth.min(0), [-0.5606, -0.3954, -0.8366], atol=5e-4)
    np.testing.assert_allclose(earth.max(0), [0.8037, 1.6712, 1.4104], atol=5e-4)
    np.testing.assert_allclose(earth[0], [-0.1004, 1.6063, -0.4490], atol=5e-4)
    np.testing.assert_allclose(earth[-1], [-0.2636, 1.6712, -0.3754], atol=5e-4)
    norm = np.linalg.norm(earth, axis=1)
    np.testing.assert_allclose([norm.min(), norm.max()], [0.1819, 1.7419], atol=5e-4)


def test_figure_2_is_a_drift_and_waves_of_a_year():
    dates, differences = study.ephemerides()
    t = (np.asarray(dates.rest) - dates.rest[0]) / 365.25
    waves = [f(2.0 * np.pi * k * t) for k in (1, 2) for f in (np.sin, np.cos)]
    basis, values = np.stack([np.ones_like(t), t, *waves], 1), differences["de405/earth"]
    left = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    assert np.sqrt(np.square(left).mean(0)).max() < 0.65e-3  # km


def test_other_ephemerides():
    differences = study.ephemerides()[1]
    norm = np.linalg.norm(differences["de423/earth"], axis=1)
    np.testing.assert_allclose([norm.min(), norm.max()], [0.3027, 0.4316], atol=5e-4)
    assert (
        np.linalg.norm(differences["de405/earth"] - differences["de406/earth"], axis=1).max()
        <= 0.01855
    )
    sun = differences["de405/sun"]
    np.testing.assert_allclose([sun[:, 1].min(), sun[:, 1].max()], [0.593, 0.649], atol=1e-3)
    heliocentric = np.linalg.norm(differences["de405/earth"] - sun, axis=1)
    np.testing.assert_allclose([heliocentric.min(), heliocentric.max()], [0.712, 1.511], atol=1e-3)


def test_planets_of_de440_are_those_of_the_longer_table():
    """Computed separately, every eight days."""
    dates, differences = study.ephemerides()
    mjd = (dates.day - 2400000.5) + np.asarray(dates.rest)[::8]
    years = read_npz(data("ephemeris_years.npz"))
    for body in ("earth", "sun"):
        other = CubicSpline(years["mjd"], years[f"de440-de421/{body}"])(mjd)
        np.testing.assert_allclose(differences[f"de440/{body}"], other, atol=1e-4)
    # In DE405 the Moon's error is about as large as the Earth's.
    earth, moon = differences["de405/earth"][::8], differences["de405/moon"]
    assert 1e-5 < np.abs(earth - moon).max() < 0.02


def test_every_eighth_instant_is_enough(monkeypatch):
    month = replace(TABLE_5, days=30.0)
    fine = study.difference("de405/earth", month)
    dates, found = study.ephemerides()
    fewer = {"de405/earth": found["de405/earth"][::8]}
    monkeypatch.setattr(study, "ephemerides", lambda: (dates, fewer))
    np.testing.assert_allclose(study.difference("de405/earth", month), fine, rtol=0, atol=1e-3)


def test_delays_are_exact_geometry_with_distances_from_the_sun():
    timing, (earth, sun, _) = TABLE_5.timing, sky(replace(TABLE_5, days=1.0))
    b, D, n = -sun, timing.distances, timing.directions
    # |Dn - b| - |Dn - p| without the difference of two kiloparsecs.
    squares = np.square(b).sum(1) - np.square(earth + b).sum(1)
    near, far = (np.linalg.norm(D[:, None] * n - at[:, None], axis=2) for at in (earth + b, b))
    exact = (squares[:, None] + 2.0 * D * (earth @ n.T)) / (near + far)
    np.testing.assert_allclose(
        timing.delay(earth, sun) - timing.shapiro(earth, sun), exact, rtol=0, atol=1e-7
    )


def test_figure_6_is_the_difference_of_delays():
    (earth, sun, _), timing, bias = sky(SHORT), SHORT.timing, SHORT.bias(SHORT.times)
    place = earth + nominal(SHORT).state[:, :3]
    Gamma = timing.gradient(place, sun)
    difference = timing.delay(place + bias, sun) - timing.delay(place, sun)
    np.testing.assert_allclose((Gamma @ bias[..., None])[..., 0], difference, rtol=0, atol=1e-7)
    assert 0.0 < np.linalg.norm(Gamma, axis=2).max() - 1.0 < 1e-7


def test_timings_are_as_good_as_published():
    for seconds, metres in ((500.0, [109.0, 326.0, 345.0]), (300.0, [140.7, 420.6, 444.8])):
        found = [1e3 * LIGHT_KM_S * p.timing_std(seconds) for p in pulsars(TABLE_5.pulsars)]
        np.testing.assert_allclose(found, metres, atol=1.0)
    rows = TABLE_5.timing.directions / TABLE_5.sigma_km[:, None]
    assert np.sqrt(np.trace(np.linalg.inv(rows.T @ rows))) == pytest.approx(
        2.4, abs=0.05
    )  # km, of three timings alone
    assert np.linalg.cond(TABLE_5.timing.directions) == pytest.approx(
        11.3, abs=0.1
    )  # pulsars are far from the axes


# -- what the dynamics leave out -------------------------------------------------------------------
def test_figures_7_and_8():
    found = study.accelerations(TABLE_5)
    total = np.sum(list(found.values()), 0)
    np.testing.assert_allclose(
        np.sqrt(np.square(total).mean(0)), [6.92e-10, 6.82e-10, 4.20e-10], rtol=0.01
    )
    np.testing.assert_allclose(np.abs(total).max(0), [19.5e-10, 15.4e-10, 9.2e-10], rtol=0.01)
    largest = {
        "moon": 1.55e-9,
        "sun": 5.69e-10,
        "venus": 4.7e-15,
        "jupiter": 2.6e-15,
        "saturn": 1.3e-16,
        "mercury": 8.8e-17,
        "mars": 1.7e-17,
        "uranus": 3.6e-18,
        "neptune": 1.1e-18,
        "pluto": 1.1e-22,
    }
    assert set(found) == set(largest)
    for body, value in largest.items():
        assert np.linalg.norm(found[body], axis=1).max() == pytest.approx(value, rel=0.04), body
    power, _ = study.power(total[:-1])
    cycles = np.fft.rfftfreq(len(total) - 1, TABLE_5.step_s) * 86400.0
    assert all(14.33 <= cycles[power[:, i].argmax()] <= 14.40 for i in range(3))
    assert 28.68 < cycles[(power.max(1) * (cycles > 20.0)).argmax()] < 28.82
    assert (np.sort(power, 0)[::-1][: len(power) // 100].sum(0) / power.sum(0) > 0.9999).all()
    np.testing.assert_allclose(study.correlation(total[:-1]), 0.951, atol=0.002)


def test_a_spectrum_has_its_line_and_its_correlation():
    t = 300.0 * np.arange(2000)
    values = np.stack([np.cos(2.0 * np.pi * n * t / 86400.0) for n in (3.0, 10.0, 14.4)], -1)
    cycles = np.fft.rfftfreq(2000, 300.0) * 86400.0
    assert [cycles[column.argmax()] for column in study.power(values)[0].T] == [
        pytest.approx(n, abs=0.15) for n in (3.0, 10.0, 14.4)
    ]
    assert study.correlation(values)[2] == pytest.approx(np.cos(np.radians(18.0)), abs=2e-3)
    assert study.power(np.random.default_rng(0).standard_normal((4000, 1)))[1] == pytest.approx(
        np.exp(-np.euler_gamma), abs=0.05
    )


def test_wrong_places_of_bodies_pull_by_newtons_law():
    config = replace(SHORT, days=0.05)
    wrong = {"moon": np.array([1e5, 0.0, 0.0]), "earth": np.array([0.0, 2e4, 0.0])}
    found, place = study.accelerations(config, wrong), nominal(config).state[:, :3]
    at = {
        body: de421().state(body, config.dates).position + wrong.get(body, 0.0)
        for body in ("earth", "moon", "sun")
    }
    for body in ("moon", "sun"):
        far = at[body] - at["earth"]
        near = far - place
        exact = [GM[body] * x / np.linalg.norm(x, axis=1)[:, None] ** 3 for x in (near, far)]
        np.testing.assert_allclose(found[body], exact[0] - exact[1], rtol=1e-5, atol=1e-18)


def test_a_pull_moves_the_orbit_as_an_integration_does():
    pull = np.array([1e-9, -2e-9, 3e-9])
    x = [SHORT.orbit]
    for _ in range(SHORT.samples):
        x.append(advance(x[-1], SHORT.step_s, extra=lambda r, _t: pull.reshape(3, 1, 1) + 0.0 * r))
    moved = study.response(SHORT, np.tile(pull, (SHORT.samples + 1, 1, 1)))
    exact = np.stack(x) - nominal(SHORT).state
    np.testing.assert_allclose(moved[:, 0], exact, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_errors_that_are_given_are_errors_that_are_drawn():
    still = np.zeros((SHORT.samples + 1, 3))
    given = study.displaced(
        lambda _: {"x": (np.tile([1.0, 0.0, 0.0], (len(still), 1)), still)}, ["tkf"], SHORT, runs(2)
    )
    drawn = study.linear(["constant"], 12, ["tkf"], SHORT, runs(2))
    for name in ("ekf", "tkf"):
        np.testing.assert_allclose(
            given[f"x/{name}/error"][:, 0], drawn[f"constant/{name}/error"][:, 0], rtol=1e-9
        )


def test_errors_of_bodies_are_those_of_the_ephemerides():
    tracks, d = study.bodies(SHORT), study.difference("de405/earth", SHORT)
    assert not np.any(tracks["none"])
    np.testing.assert_array_equal(tracks["position"][0], d)
    half = 0.5 * np.diff(d, axis=0)  # the middle of an observation from its end
    np.testing.assert_allclose(tracks["velocity"][0][1:], half, rtol=0, atol=1e-7)
    (earth, sun, _), timing = sky(SHORT), SHORT.timing
    place = earth + nominal(SHORT).state[:, :3]
    seen = (timing.gradient(place, sun) @ tracks["others"][0][..., None])[..., 0]
    other_sun = sun + study.difference("de405/sun", SHORT)
    exact = timing.delay(place, other_sun) - timing.delay(place, sun)
    np.testing.assert_allclose(seen, exact, rtol=0, atol=1e-9)
    assert 0.0 < np.abs(tracks["others"][1]).max() < 1e-13  # km/s^2


def test_a_satellite_of_mars():
    config = replace(WHITE, days=0.25, **study.MARS)
    a, e, *_ = config.elements
    r, v = config.orbit[:3], config.orbit[3:]
    assert v @ v == pytest.approx(GM["mars"] * (2.0 / np.linalg.norm(r) - 1.0 / a), rel=1e-12)
    assert np.linalg.norm(r) - 3396.0 == pytest.approx(a * (1.0 - e) - 3396.0, rel=1e-12)
    np.testing.assert_array_equal(sky(config)[0], de421().state("mars", config.dates).position)
    linear = study.linear(["sine"], 1, ["tkf"], config, runs(2))
    sim = simulate([config], runs(2))
    other = study.run_filters(["sine"], sim, filters([config]), ["tkf"])
    for name in ("ekf", "tkf"):
        one, two = (found[f"sine/{name}/error"][20:, :, 0] for found in (linear, other))
        np.testing.assert_allclose(one, two, atol=0.03)


# -- the scenario ----------------------------------------------------------------------------------
BOTH = [replace(SHORT, setting=SETTINGS[i]) for i in (1, 5)]


@pytest.fixture(scope="module")
def sim():
    return simulate(BOTH, runs(6))


def test_the_orbit_has_twenty_samples_a_turn():
    a = TABLE_5.elements[0]
    assert 2.0 * np.pi * np.sqrt(a**3 / 398600.4418) == pytest.approx(6000.0, abs=0.01)


def test_noises_are_stationary_and_correlated_as_the_model_has_them():
    config = replace(TABLE_5, days=0.2)
    sim, noise = simulate(config, runs(300)), config.noise
    timing, (earth, sun, _) = config.timing, sky(config)
    for k in (1, len(sim.z) - 1):
        V = sim.z[k] - timing.delay(earth[k] + sim.bias[k] + sim.truth[k][:, :3], sun[k])
        np.testing.assert_allclose(
            V.std(0), config.sigma_km / np.sqrt(0.75), rtol=4.0 / np.sqrt(600.0)
        )
    # W = J V + Q: the residual of the flow, in units of its standard deviation, is proportional to
    # V.
    k = len(sim.z) - 1
    moved = flow(sim.truth[k - 1], config.step_s)
    W = np.linalg.solve(moved.G, (sim.truth[k] - moved.state)[..., None])[..., 0]
    for i in range(3):
        sample = np.corrcoef(W[:, i], V[:, i])[0, 1]
        through = noise.J[i, i] * np.sqrt(noise.V[i, i])
        exact = through / np.sqrt(through**2 + noise.Q[i, i])
        assert np.arctanh(sample) == pytest.approx(
            np.arctanh(exact), abs=4.0 / np.sqrt(300.0)
        )  # Fisher's interval


def test_settings_see_the_same_numbers(sim):
    alone = simulate(WHITE, runs(6))
    np.testing.assert_allclose(
        sim.z[1:, 1], alone.z[1:], rtol=0, atol=1e-7
    )  # two of the last digits of 1.5e8 km


def test_a_run_does_not_depend_on_how_many_there_are():
    many, one = simulate(SHORT, runs(3)), simulate(SHORT, runs(3)[2:])
    np.testing.assert_allclose(one.z[1:, 0], many.z[1:, 2], rtol=0, atol=1e-6)


@pytest.mark.parametrize("trend", ["sine", "growing", "triangle"])
def test_the_ephemeris_error_is_of_its_amplitude(trend):
    t = np.linspace(0.0, 365.25 * 86400.0, 1001)
    bias = replace(TABLE_5, trend=trend).bias(t)
    bound = np.asarray(TABLE_5.amplitude_km) * (1.25 if trend == "growing" else 1.0)
    assert (np.abs(bias).max(0) <= bound + 1e-12).all()
    assert (np.abs(bias).max(0) > 0.7 * np.asarray(TABLE_5.amplitude_km)).all()


def follow(config, count, names=("ekf", "tkf", "tkf-fair", "tdkf", "tstdkf", "aug")):
    """Errors ``(T, runs, 6)`` of each filter."""
    known, sim = filters(config), simulate(config, runs(count))
    return {
        n: run(known[n], sim.prior, sim.epochs(), keep="mean").mean[..., :6] - sim.truth[1:]
        for n in names
    }


def test_where_all_noise_is_white_the_filters_are_one():
    white = follow(WHITE, 6, ("tkf", "tkf-fair", "tdkf"))
    # A delay of an astronomical unit in km has seven digits behind the point.
    np.testing.assert_allclose(white["tdkf"], white["tkf"], rtol=0, atol=1e-7)
    np.testing.assert_allclose(white["tkf-fair"], white["tkf"], rtol=0, atol=1e-7)


def test_the_exact_filter_is_the_two_stages_where_the_bias_is_constant():
    e = follow(replace(WHITE, walk_km=0.0), 4, ("tkf", "aug"))
    # Each is linearized about its own estimate, the first stage's and the corrected one: a
    # kilometer apart at the start.
    np.testing.assert_allclose(e["aug"][..., :3], e["tkf"][..., :3], rtol=0, atol=2e-3)


def test_nine_states_are_the_two_stages_where_the_bias_is_constant_or_walks():
    """With M_0 = 0 and no random walk they equal the EKF; with Gamma = 0 the bias remains at its
    prior.
    """
    for walk in (0.0, 1e-3):
        config = replace(YEAR, days=0.5, walk_km=walk)
        known, sim = filters(config, LINEAR), linearized([config], runs(3))
        two = TwoStage.of(
            known["tkf"].first, LINEAR.Gamma, known["tkf"].bias, Qb=walk**2 * np.eye(3)
        )
        one, other = (
            run(filter, sim.prior, sim.epochs(), keep="cov") for filter in (known["aug9"], two)
        )
        np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(one.cov, other.cov, rtol=0, atol=1e-9)
    no_slope = LINEAR._replace(Gamma=lambda x, epoch: 0.0 * epoch.u[2])
    kept = run(
        nine_states(no_slope, config.noise.E, config.noise.Xi, known["tkf"].bias, np.zeros((3, 3))),
        sim.prior,
        sim.epochs(),
    )
    np.testing.assert_allclose(kept.std[-1, ..., 6:], config.bias_prior_km)
    sure = replace(config, bias_prior_km=1e-12, walk_km=0.0)
    e = {
        name: run(filters(sure, LINEAR)[name], sim.prior, sim.epochs(), keep="mean").mean[..., :6]
        for name in ("ekf", "aug9")
    }
    np.testing.assert_allclose(e["aug9"], e["ekf"], rtol=0, atol=1e-9)


def test_a_constant_bias_is_followed_by_a_gain_that_falls():
    """For a constant scalar bias the gain after k timings is 1 / k, so the lag behind a ramp grows
    as k / 2.
    """
    R, prior, times = 1.0, Gaussian(np.zeros(1), 1e6 * np.eye(1)), np.arange(401.0)
    track = run(
        ekf(Motion(np.eye(1), np.zeros((1, 1))), Sensor(np.eye(1), R * np.eye(1))),
        prior,
        times,
        times[:, None],
    )
    np.testing.assert_allclose(
        times[[100, 400]] - track.mean[[100, 400], 0], [50.0, 200.0], rtol=0.02
    )


def test_nine_states_are_no_heavy_load():
    count = study.operations(replace(SHORT, days=0.01), runs(1))
    assert count["ekf"] < count["tkf"] < count["aug9"] < 0.6 * count["tstdkf"]


def test_without_a_scale_the_strong_tracking_stage_is_the_ordinary_one():
    config = replace(YEAR, days=0.5)
    flown = study.linear(["step"], 12, ["sweep", "nine"], config, runs(2))
    for form in "CB":
        np.testing.assert_array_equal(flown[f"step/{form}, ρ = 0/error"], flown["step/tdkf/error"])
    np.testing.assert_allclose(
        flown["step/aug9 0/error"],
        study.linear(["step"], 12, ["tkf"], config, runs(2))["step/tkf/error"],
    )
    alone = study.run_filters(
        ["step"],
        linearized([replace(config, trend="step")], runs(2)),
        filters(config, LINEAR, on=study.BESIDE),
        ["tstdkf"],
        every=12,
    )
    np.testing.assert_allclose(flown["step/C/error"], alone["step/tstdkf/error"])


def test_the_days_that_an_estimate_is_off_are_counted():
    far, near = (np.full((3, 48), x) for x in (0.3, 0.2))
    assert study.days(far) == 2.0
    assert study.days(near) == 0.0
    assert study.days(far, np.hstack([far[:, :24], near[:, 24:]])) == -1.0
    bias = replace(SHORT, trend="step").bias(SHORT.times)
    np.testing.assert_array_equal(np.unique(bias, axis=0), [[0.0] * 3, [0.3] * 3])
    assert (bias[:, 0] > 0.0).mean() == pytest.approx(0.5, abs=0.01)


def test_the_days_until_a_tenth_are_counted():
    error = np.tile(np.r_[np.full(10, 0.2), np.full(38, 0.05)], (3, 1))
    assert study.until_tenth(error) == pytest.approx(10 * 300.0 / 86400.0)
    assert study.until_tenth(error, error[:, 5:]) == 2.0
    late = np.hstack([error, np.full((3, 1), 0.3)])
    assert study.until_tenth(late, error) == pytest.approx(4.9)


def test_a_timing_by_area_and_background():
    crab, *_, weak = pulsars(TABLE_5.pulsars)
    for p in (crab, weak):
        assert p.timing_std(300.0, 1e3) / p.timing_std(300.0, 1e5) == pytest.approx(10.0, rel=1e-12)
    assert crab.timing_std(300.0, background=0.05) == pytest.approx(
        crab.timing_std(300.0, background=0.0), rel=2e-3
    )
    loud = 1e3 * weak.flux
    background = (
        0.5
        * weak.width_s
        * np.sqrt(loud * weak.width_s / weak.period_s / (1e4 * 300.0))
        / (weak.flux * weak.pulsed_fraction)
    )
    assert weak.timing_std(300.0, background=loud) == pytest.approx(background, rel=0.05)


def test_the_exact_filter_is_the_best_of_colored_noise():
    colored = {
        name: np.sqrt(np.square(e[len(e) // 2 :, :, :3]).sum(-1).mean())
        for name, e in follow(SHORT, 6).items()
    }
    assert colored["aug"] < colored["tdkf"] < colored["tkf"] < colored["ekf"]


def test_the_exact_filter_is_the_differenced_one_where_only_the_coupling_is():
    """F = L = 0: differencing is exact."""
    e = follow(replace(SHORT, walk_km=0.0, setting=Setting(0.0, 0.0, 4.8)), 4, ("tdkf", "aug"))
    np.testing.assert_allclose(e["tdkf"][..., :3], e["aug"][..., :3], atol=1e-3)


def test_a_known_bias_leaves_the_ekf():
    e = follow(replace(SHORT, bias_prior_km=1e-12), 3, ("ekf", "tkf"))
    np.testing.assert_allclose(e["tkf"], e["ekf"], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"step_s": 0.0}, "step_s"),
        ({"runs": 2.5}, "runs"),
        ({"trend": "linear"}, "trend"),
        ({"factor": "A"}, "factor"),
        ({"walk_km": -1.0}, "walk_km"),
        ({"error_km": (0.0, 1.0, 1.0)}, "error_km"),
        ({"elements": (1.0, 2.0)}, "elements"),
        ({"amplitude_km": (1.0, np.nan, 0.0)}, "amplitude_km"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(PRESETS["table5"], **change)


def test_dates_outside_the_ephemeris_and_unknown_pulsars_are_refused():
    with (
        pytest.warns(UserWarning, match="dubious year"),
        pytest.raises(ValueError, match=r"^date: expected JD TDB between"),
    ):
        simulate(replace(SHORT, start_utc="2060-01-01"), runs(1))
    with pytest.raises(ValueError, match=r"^pulsar: expected one of"):
        simulate(replace(SHORT, pulsars=("B0531+21", "B1821-24", "Vela")), runs(1))
    with pytest.raises(ValueError, match=r"^F: expected a diagonal matrix with magnitudes below 1"):
        simulate(replace(SHORT, setting=Setting(1.0, 0.0, 0.0)), runs(1))


def test_a_missing_timing_is_a_prediction_for_the_plain_stage():
    sim = simulate(SHORT, runs(3))
    filter, epochs = filters(SHORT)["tkf"], list(sim.epochs())
    state = filter.start(sim.prior)
    state, _ = filter.step(state, epochs[0])
    lost, (info,) = filter.step(
        state, Epoch(*epochs[1][:4], np.full_like(epochs[1].z, np.nan), None)
    )
    assert info.used is not None
    assert not info.used.any()
    np.testing.assert_array_equal(lost.bias.mean, state.bias.mean)


def test_there_is_a_bound_where_the_truth_is_what_the_exact_filter_believes():
    assert trial(replace(SHORT, initial="drawn", trend="constant"), runs(1)).reference == "aug"
    assert trial(SHORT, runs(1)).reference == ""


# -- the linear driver -----------------------------------------------------------------------------
def test_the_linear_driver_is_the_nonlinear_one():
    config = replace(YEAR, days=0.5)
    linear = study.linear(study.TRENDS, 1, ("tkf", "tdkf", "aug"), config, runs(2))
    cases = [replace(config, trend=trend) for trend in study.TRENDS]
    sim, stronger = (
        simulate(cases, runs(2)),
        [replace(case, factor="proportional") for case in cases],
    )
    other = study.run_filters(
        study.TRENDS, sim, filters(cases, on=study.BESIDE), ("tkf", "tstdkf", "aug")
    )
    other = {key.replace("tstdkf", "C"): value for key, value in other.items()}
    found = study.run_filters(study.TRENDS, sim, filters(stronger, on=study.BESIDE), ["tstdkf"])
    other |= {key.replace("tstdkf", "B"): value for key, value in found.items()}
    for name in ("ekf", "tkf", "tdkf", "C", "B", "aug"):
        for trend in study.TRENDS:
            a, b = (found[f"{trend}/{name}/error"][20:, :, 0] for found in (linear, other))
            # One kilometer from the nominal orbit, the curvature causes errors of some meters in
            # the first revolutions.
            np.testing.assert_allclose(a, b, atol=0.02, err_msg=name)


def test_an_hour_of_the_linear_driver_is_the_mean_of_its_steps():
    config = replace(YEAR, days=0.4)  # nine hours, and the rest, which is left
    fine, coarse = (
        study.linear(study.TRENDS, every, ("tkf", "tdkf", "aug"), config, runs(2))
        for every in (1, 12)
    )
    assert config.samples == 115
    np.testing.assert_array_equal(coarse["times"], 3600.0 * np.arange(1, 10))
    for name in ("tkf", "B", "aug"):
        np.testing.assert_allclose(
            coarse[f"sine/{name}/first"], fine[f"sine/{name}/first"][11:108:12]
        )
        means = np.square(fine[f"growing/{name}/error"])[:108].reshape(9, 12, 2, 3).mean(1)
        np.testing.assert_allclose(np.square(coarse[f"growing/{name}/error"]), means)


def test_runs_of_a_linear_year_share_one_covariance():
    config = replace(YEAR, days=0.1)
    sim = linearized([config, replace(config, trend="growing")], runs(4))
    for name, filter in filters(config, LINEAR).items():
        *_, (_, state, _) = steps(filter, sim.prior, sim.epochs())
        assert (state.first if name == "tdkf" else state).belief.mean.shape[:2] == (2, 4)
        assert (state.first if hasattr(state, "first") else state).belief.cov.ndim == 2, name


def test_the_bound_is_the_exact_filters_covariance():
    config = replace(SHORT, days=0.25)
    sim = simulate(config, runs(1))
    std = run(filters(config)["aug"], sim.prior, sim.epochs()).std[:, 0]
    bounds = np.sqrt(study.nominal_covariances([config], "aug")[:, 0].diagonal(0, 1, 2))
    # The filter begins 1.7 km off the nominal orbit, where gravity's gradient is another by 3 * 1.7
    # / 7136.
    for a, b in ((slice(3), slice(3)), (slice(15, 18), slice(6, 9))):
        np.testing.assert_allclose(
            np.linalg.norm(std[:, a], axis=1), np.linalg.norm(bounds[:, b], axis=1), rtol=5e-3
        )


def test_the_bias_is_told_from_the_orbit_by_axis():
    std = np.sqrt(
        study.nominal_covariances([replace(WHITE, days=1.0)], "tkf")[-1, 0].diagonal()[6:]
    )
    np.testing.assert_allclose(std, [0.105, 0.027, 0.078], atol=6e-4)


def test_color_of_the_process_noise_alone_is_nearly_exact():
    config = replace(
        SHORT, days=3.0, setting=Setting(0.0, 0.9, 0.0), bias_prior_km=1e-9, walk_km=0.0
    )
    kept, least = (
        study.nominal_covariances([config], name)[-1, 0, :3, :3].trace() for name in ("tdkf", "aug")
    )
    assert abs(kept / least - 1.0) < 5e-5


def test_what_pulls_in_the_truth_is_what_the_filter_may_model():
    """A filter that models Sun and Moon has the same residuals as a filter without them on a truth
    without them.
    """
    config = replace(WHITE, days=0.25)
    with_them, without = (
        simulate(replace(config, pulled=pulled), runs(2)) for pulled in (True, False)
    )
    assert np.abs(with_them.truth - without.truth)[-1, :, :3].max() > 0.01  # km
    c = replace(config, pulled=True)
    knowing = kalman(models(c, pulled=True), c.noise.E, c.noise.Xi)
    one = run(knowing, with_them.prior, with_them.epochs(), keep="mean").mean - with_them.truth[1:]
    two = (
        run(filters(config)["ekf"], without.prior, without.epochs(), keep="mean").mean
        - without.truth[1:]
    )
    np.testing.assert_allclose(one[..., :3], two[..., :3], atol=1e-5)


# -- the study -------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def results():
    return once(STUDY)


def test_every_figure_draws(results):
    assert list(show.FIGURES)[:3] == ["figure_01", "figure_02", "figure_02b"]
    assert len(show.FIGURES) == 15
    for stem, (caption, draw) in show.FIGURES.items():
        fig = draw(results)
        number = stem.removeprefix("figure_").lstrip("0")
        beyond = " (not in the paper)" if caption.startswith("Beyond the paper") else ""
        assert fig.get_suptitle().startswith(f"Figure {number}{beyond}: ")
        assert caption.endswith(".")
        drawn = [ax for ax in fig.axes if ax.axison]
        assert all(ax.get_xlabel() or ax.get_ylabel() or ax.get_title() for ax in drawn)
        assert not faults(fig), stem


def test_the_moon_splits_the_lines_at_the_orbital_rate(results):
    fig = show.FIGURES["figure_08"][1](results)
    for line in fig.axes[1].lines:
        cycles, power = line.get_data()
        below, lower, center, upper, above = (
            power[np.abs(cycles - at) < 0.01].max() for at in (14.325, 14.36, 14.4, 14.45, 14.485)
        )
        assert 0.5 * min(below, center) > lower  # resolved at half of their power
        assert 0.5 * min(center, above) > upper


def test_tables(results):
    rows = {name: make(results) for name, (_, make) in show.TABLES.items()}
    assert list(rows) == [f"table_{i}" for i in (*range(1, 6), "5b")]
    assert all(row["source"] for i in range(1, 5) for row in rows[f"table_{i}"])
    for table in (rows["table_5"], rows["table_5b"]):
        assert [row["setting"] for row in table] == [i for i in SETTINGS for _ in range(2)]
    values = {row["parameter"]: row["value"] for row in rows["table_3"]}
    assert values["phase"] == "0, 1.5708, 0.785398"
    assert values["area_cm2"] == "10000"
    one = rows["table_5"][0]
    assert one["below TKF (%)"] == pytest.approx(100.0 * (1.0 - one["TSTDKF"] / one["TKF"]))
    assert one["below TKF, the paper's (%)"] == 35.18


def test_the_ledger_has_every_statement_with_what_is_printed(results):
    rows = {row.id: row for row in STUDY.rows if row.kind == "statement"}
    assert list(rows) == STATEMENTS
    assert {id: str(row.printed) for id, row in rows.items() if row.printed is not None} == PRINTED
    for group, printed in study.PRINTED.items():
        assert rows[f"setting-1-{group}"].printed == list(printed)
    listed = json.loads(dumps(results.claims()))["claims"]
    assert not [
        claim["id"] for claim in listed if claim["verdict"] not in ("undecided", claim["expected"])
    ]
    found = {claim["id"]: claim for claim in listed}
    assert found["setting-1-position"]["verdict"] == "undecided"  # half a day is no month
    assert found["erratum-1-size"]["verdict"] == "paper in error"
    assert found["reduces-to-ekf"]["value"] < 1e-6


def test_cases_side_by_side_are_cases_alone():
    config = replace(TABLE_5, days=0.1)
    together = study.five(config, runs(3))
    alone, known = simulate([config], runs(3)), filters([config])
    fair = study.run_filters(["1"], alone, {"tkf": known["tkf-fair"]}, ["tkf"])
    np.testing.assert_allclose(together["fair/tkf/error"], fair["1/tkf/error"], rtol=1e-5)
    exact = study.run_filters(["1"], alone, known, ["aug"])
    np.testing.assert_allclose(together["1/aug/error"], exact["1/aug/error"], rtol=1e-5)
    np.testing.assert_allclose(
        study.five(config, runs(3)[2:])["3/tstdkf/error"][:, 0],
        together["3/tstdkf/error"][:, 2],
        rtol=1e-5,
    )
    form_b = [replace(config, factor="proportional")]
    variant = study.run_filters(
        ["B"], simulate(form_b, runs(2, 1)), filters(form_b, on=study.BESIDE), ["tstdkf"]
    )
    found = study.apart(study.VARIANTS, ["tstdkf"], config, runs(2, 1))
    np.testing.assert_allclose(found["form B/tstdkf/error"], variant["B/tstdkf/error"], rtol=1e-5)


def test_recordings_are_written_under_their_names(results, tmp_path):
    assert show.record(results, Outputs(tmp_path)) == show.RECORDINGS
    for name, id in zip(show.RECORDINGS, ("celnav-tstdkf", "celnav-tstdkf-year"), strict=True):
        (found,) = rr.chunk.RrdReader(tmp_path / name).recordings()
        assert found.application_id == id
    month, year = (
        {
            str(c.entity_path)
            for c in rr.chunk.RrdReader(tmp_path / name).stream().to_chunks()
            if not c.is_static
        }
        for name in show.RECORDINGS
    )
    assert {
        "/world/sat/orbits",
        "/world/pull/moon",
        "/sun/earth",
        "/error/aug/ellipsoid",
        "/plots/bias/x/tstdkf",
    } <= month
    assert "/plots/bias/x/ekf" not in month  # this filter does not estimate it
    assert {f"/plots/{trend}/z/B" for trend in ("sine", "growing", "triangle")} <= year


@pytest.mark.parametrize("engine", ["numpy", "auto"])
def test_a_run_that_is_lost_is_told(sim, engine):
    broken = sim._replace(z=np.where(np.arange(len(sim.z))[:, None, None, None] == 5, 1e300, sim.z))
    token = ENGINE.set(engine)
    with pytest.raises(FilterError, match=r"step \d"), np.errstate(all="ignore"):
        study.run_filters(["1", "5"], broken, filters(BOTH), ["tkf"])
    ENGINE.reset(token)
