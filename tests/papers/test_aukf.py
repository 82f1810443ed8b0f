"""The BeiDou paper: its track, its sky, and filters that are the same where they must be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from celnav.filters.adaptive import innovation_window
from celnav.filters.driver import run, sequential
from celnav.filters.step import predict, update
from celnav.models import pseudorange
from celnav.montecarlo import generator
from celnav.papers.aukf import PRESETS, errata, filters, simulate, sweeps
from celnav.papers.aukf.follow import follow as follow_all
from celnav.papers.aukf.follow import watched
from celnav.papers.aukf.scenario import EKF, adapted, axes, circle, visible
from celnav.points import unscented

SHORT = replace(PRESETS["burst"], duration_s=4.0, burst_s=(2.0, 3.0))


def runs(count, study=0):
    return [generator(0, study, r) for r in range(count)]


def test_the_track_is_a_circle_of_four_g():
    config = PRESETS["burst"]
    assert config.radius_m == pytest.approx(4078.865, abs=1e-3)
    assert 2.0 * np.pi / config.turn_rate == pytest.approx(64.0707, abs=1e-4)
    position, velocity = circle(config)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 400.0)
    difference = (position[2:] - position[:-2]) / (2.0 * config.interval_s)
    np.testing.assert_allclose(difference, velocity[1:-1], atol=0.01)
    assert np.ptp(position @ axes(config)[2]) < 1e-6  # level


def test_the_sky_is_that_of_the_design():
    config = PRESETS["burst"]
    seen, (position, _) = visible(config), circle(config)
    assert len(seen.names) == 15
    assert sum(name in ("C01", "C02", "C03", "C04", "C05") for name in seen.names) == 5
    assert sum(name in ("C38", "C39", "C40") for name in seen.names) == 3
    assert (seen.elevation > np.radians(10.0)).all()
    dop = pseudorange.dilution(seen.q, position, axes(config))
    for value, near in zip(dop, (1.78, 1.55, 0.73, 1.36, 0.88), strict=True):
        assert np.median(value) == pytest.approx(near, abs=0.02)


def follow(sim, names):
    known = filters(sim.config)
    return {n: run(known[n], sim.prior, sim.epochs(), keep="spread").mean - sim.truth for n in names}


@pytest.fixture(scope="module")
def errors():
    return follow(simulate(SHORT, runs(6)), ("ls", "ekf", "ukf", "aukf", "group"))


def test_extended_and_unscented_are_the_same(errors):
    assert np.abs(errors["ekf"] - errors["ukf"]).max() < 1e-5


def test_a_window_that_is_never_full_changes_no_bit():
    sim = simulate(SHORT, runs(2))
    never = filters(replace(SHORT, window=1000))["aukf"]
    plain = filters(SHORT)["ukf"]
    one, two = (run(f, sim.prior, sim.epochs(), keep="mean").mean for f in (never, plain))
    np.testing.assert_array_equal(one, two)


def test_in_a_burst_adaptation_helps(errors):
    burst = slice(22, 30)
    sizes = {n: np.sqrt(np.square(e[burst, :, :3]).sum(-1).mean()) for n, e in errors.items()}
    assert sizes["ls"] > sizes["ukf"] > sizes["aukf"]
    assert sizes["group"] < 0.5 * sizes["ukf"]


def test_batches_are_singles(errors):
    one = simulate(SHORT, runs(6)[3:4])
    np.testing.assert_allclose(follow(one, ("aukf",))["aukf"][:, 0], errors["aukf"][:, 3], rtol=0, atol=1e-6)


def test_every_rule_moves_a_linear_model_alike():
    """The prediction is a matrix: the unscented filter drawn through it is that which is moved by its Jacobian."""
    sim, S = simulate(SHORT, runs(2)), len(visible(SHORT).names)
    rule = unscented(8, 1.0, 2.0, 0.0)
    F, sigma = SHORT.F, np.repeat([3.0, 0.1], S)
    drawn = sequential(
        predict(lambda x, _e: x @ F.T, rule, SHORT.Q), update(lambda x, e: pseudorange.measure(x, *e.u), rule, np.diag(sigma**2))
    )
    one, two = (run(f, sim.prior, sim.epochs(), keep="mean").mean for f in (drawn, adapted(SHORT, S, rule)))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-6)
    assert EKF.linear


@pytest.mark.parametrize(
    ("change", "name"),
    [({"interval_s": 0.0}, "interval_s"), ({"burst": "some"}, "burst"), ({"window": 0}, "window"), ({"runs": 1.5}, "runs"),
     ({"sigma_range_m": np.nan}, "sigma_range_m"), ({"deviation": (1.0, 1.0, 1.0, 0.0)}, "deviation"),
     ({"clock_walk_m2_per_s3": -1.0}, "clock_walk_m2_per_s3")],
)  # fmt: skip
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(PRESETS["burst"], **change)


def test_a_clipped_mean_of_squares_exceeds_one():
    for M, exact in ((5, 0.244), (10, 0.176), (30, 0.102)):
        assert errata.clipped_mean(M) == pytest.approx(exact, abs=6e-4)
    draws = np.maximum(1.0, np.square(np.random.default_rng(0).normal(size=(200_000, 10))).mean(1))
    assert errata.clipped_mean(10) == pytest.approx(draws.mean() - 1.0, abs=3e-3)


def test_without_drawing_anew_the_gain_lacks_the_process_noise():
    sim, S = simulate(PRESETS["quiet"], runs(3)), len(visible(SHORT).names)
    rule = unscented(8, 1.0, 2.0, 0.0)
    found = follow_all({"without": errata.without_redraw(SHORT, S, rule), "with": adapted(SHORT, S, rule)}, sim)
    sizes = {n: np.sqrt(np.square(found[f"{n}/error"][100:600, :, :3]).sum(-1).mean()) for n in ("without", "with")}
    assert sizes["without"] > 3.0 * sizes["with"]
    # Without process noise there is nothing to lack.
    still = replace(SHORT, acceleration_noise_m2_per_s3=1e-12, clock_white_m2_per_s=0.0, clock_walk_m2_per_s3=1e-12)
    sim = simulate(still, runs(2))
    found = follow_all({"without": errata.without_redraw(still, S, rule), "with": adapted(still, S, rule)}, sim)
    np.testing.assert_allclose(found["without/error"], found["with/error"], rtol=0, atol=1e-3)


def test_factors_are_watched():
    sim, S = simulate(SHORT, runs(4)), len(visible(SHORT).names)
    hook = watched(innovation_window(10))
    found = follow_all({"aukf": adapted(SHORT, S, unscented(8), (hook,))}, sim, factors=("aukf",), consistency=("aukf",))
    factor = found["aukf/factor"]
    assert factor.shape == (41, 4, 2 * S)
    np.testing.assert_array_equal(factor[:9], 1.0)
    assert factor.min() >= 1.0 - 1e-12
    assert factor[29, :, :S].mean() > 50.0 * factor[15, :, :S].mean()
    assert found["aukf/nees"].shape == found["aukf/nis"].shape == (41, 4)


def test_the_bound_is_what_a_linear_filter_reaches():
    """Along one track the bound is the covariance of the extended filter at the truth."""
    config = replace(SHORT, burst="none")
    sim = simulate(config, runs(1))
    sim = sim._replace(prior=sim.prior._replace(mean=sim.truth[0]))
    track = run(filters(config)["ekf"], sim.prior, sim.epochs())
    np.testing.assert_allclose(track.std[:, 0], np.sqrt(sweeps.bound(sim)), rtol=1e-4)


def test_every_study_gives_its_filters():
    """Half a minute of each, two runs: what is promised is there and finite, but for filters that are lost."""
    short = replace(PRESETS["burst"], duration_s=3.0, burst_s=(1.0, 2.0))
    for name in ("quiet", "matched", "initial errors", "redraw"):
        found = sweeps.STUDIES[name].function(short, runs(2))
        assert found
        for key, values in found.items():
            assert values.shape[1] in (1, 2), (name, key)
            assert np.isfinite(values).all() or key.startswith("ls"), (name, key)
