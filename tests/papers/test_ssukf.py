"""The scenario of the third paper: its filters are one filter, and settle where theory says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from celnav import attitude
from celnav.filters.driver import run
from celnav.models.gyro import preintegrate
from celnav.montecarlo import generator
from celnav.papers.ssukf import PRESETS, filters, simulate
from celnav.papers.ssukf.config import ARCSEC, DEG_PER_H, STANDARD

SHORT = replace(STANDARD, duration_s=10.0)


def apart(a, b):
    """Largest angle between two sequences of attitudes after the start, arcsec."""
    turned = attitude.multiply(a.mean[1:, ..., :4], attitude.inverse(b.mean[1:, ..., :4]))
    return attitude.angle(turned).max() / ARCSEC


@pytest.fixture(scope="module")
def sim():
    return simulate(SHORT, [generator(0, 0, r) for r in range(6)])


def tracks(sim, **options):
    return {name: run(filter, sim.prior, sim.epochs()) for name, filter in filters(sim.config, **options).items()}


def test_the_filters_are_one_filter(sim):
    track = tracks(sim)
    assert apart(track["aukf"], track["ssukf"]) < 1e-6
    for other in ("aukf-1", "additive", "usque", "mekf"):
        assert apart(track["aukf"], track[other]) < 1e-3, other


@pytest.mark.parametrize("c", [15.0, 7.0, 0.15])
def test_at_equal_spread_switching_is_full_augmentation(sim, c):
    known = filters(sim.config, c=c)
    a, b = (run(known[name], sim.prior, sim.epochs()) for name in ("aukf", "ssukf"))
    assert apart(a, b) < 1e-7
    np.testing.assert_allclose(a.std, b.std, rtol=1e-9)


def test_transport_hardly_matters_where_attitude_is_measured_whole(sim):
    plain, moved = (filters(sim.config, transported=t)["ssukf"] for t in (False, True))
    a, b = (run(filter, sim.prior, sim.epochs()) for filter in (plain, moved))
    assert 1e-6 < apart(a, b) < 0.5
    np.testing.assert_allclose(a.std[-1], b.std[-1], rtol=0.01)


def test_preintegrated_samples_do_what_single_ones_do():
    full = simulate(replace(SHORT, duration_s=4.0, preintegrated=False), [generator(0, 0, r) for r in range(3)])
    sim = full.integrated()
    few = run(filters(sim.config)["ssukf"], sim.prior, sim.epochs())
    many = run(filters(full.config)["ssukf"], full.prior, full.epochs())
    turned = attitude.multiply(few.mean[1:, ..., :4], attitude.inverse(many.mean[25::25, ..., :4]))
    assert attitude.angle(turned).max() < 2e-3 * ARCSEC


def test_samples_may_be_integrated_about_any_drift():
    full = simulate(replace(SHORT, preintegrated=False), [generator(0, 0, r) for r in range(3)])
    each = full.gyro.reshape(-1, 25, 3, 3).swapaxes(0, 1)
    drifts = (np.zeros(3), np.full(3, DEG_PER_H), np.array([1.0, -2.0, 3.0]) * DEG_PER_H)
    rates = [preintegrate(each, drift, full.config.gyro_dt) for drift in drifts]
    assert max(np.abs(rate - rates[0]).max() for rate in rates) * 0.25 < 1e-12


def test_the_error_is_the_sensors_after_the_first_star(sim):
    track = run(filters(sim.config)["ssukf"], sim.prior, sim.epochs())
    error = attitude.log(attitude.multiply(sim.truth[..., :4], attitude.inverse(track.mean[..., :4]))) / ARCSEC
    np.testing.assert_allclose(np.degrees(error[0] * ARCSEC)[:, 2], 10.0, atol=0.1)
    assert 12.0 < np.sqrt(np.square(error[1]).mean()) < 30.0
    assert np.sqrt(np.square(error[-1]).mean()) < 8.0


def test_drawn_errors_are_those_of_the_prior():
    sim = simulate(replace(SHORT, duration_s=0.25), [generator(1, 0, r) for r in range(400)])
    error = attitude.log(attitude.multiply(sim.truth[0][:, :4], attitude.inverse(sim.drawn.mean[:, :4])))
    np.testing.assert_allclose(error.std(0), SHORT.sigma0[:3], rtol=0.15)
    np.testing.assert_allclose((sim.truth[0] - sim.drawn.mean)[:, 4:].std(0), SHORT.sigma0[3:], rtol=0.15)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"star_hz": 3.0}, "gyro_hz"),
        ({"gyro_hz": 1.0}, "gyro_hz"),
        ({"tau_s": 0.0}, "tau_s"),
        ({"star_arcsec": -1.0}, "star_arcsec"),
        ({"prior_deg": (1.0, 0.0, 1.0)}, "prior_deg"),
        ({"inertia": ((1.0, 0.0), (0.0, 1.0))}, "inertia"),
        ({"alpha": 0.0}, "alpha"),
        ({"runs": 1.5}, "runs"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(PRESETS["standard"], **change)
