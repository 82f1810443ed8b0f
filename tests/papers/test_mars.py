"""The study of mars: spin noise, the cruise, filters against least squares, and the ledger."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rerun as rr
from once import once
from readable import faults
from scipy.integrate import quad

import celnav
from celnav.files import Outputs
from celnav.models.ephemeris import de421
from celnav.models.orbit import Earth, propagate
from celnav.papers import mars
from celnav.papers.mars import scenario, study
from celnav.study.montecarlo import generator
from celnav.study.trial import Noiseless, evaluate_filter

SHORT = replace(mars.PRESETS["large"], weeks=12)
STATEMENTS = "help position velocity irregularities archival"
YEAR_S = 365.25 * 86400.0


@pytest.fixture(scope="module")
def results():
    return once(mars.STUDY)


@pytest.fixture(scope="module")
def claims(results):
    return {claim.id: claim for claim in results.claims()}


# -- spin noise ------------------------------------------------------------------------------------
def test_the_variance_of_the_spin_noise_is_an_integral_over_its_spectrum():
    """Independent form: for each frequency the extrapolated fit is subtracted from a single wave,
    and the power is integrated by quadrature over all frequencies.
    """
    c = replace(SHORT, fit_years=5.0, age_years=1.0)
    ground = np.linspace(-6.0, -1.0, scenario.FITTED) * YEAR_S
    at = c.times[-1]
    design = np.vander(ground / YEAR_S, 3)
    weights = np.vander([at / YEAR_S], 3) @ np.linalg.pinv(design)

    def power(log_f, i):
        f = np.exp(log_f)
        left = np.exp(2j * np.pi * f * at) - weights @ np.exp(2j * np.pi * f * ground)
        density = sum(scenario.spectrum(f, *p) for p in (mars.RED[c.pulsars[i]], mars.COMMON))
        return density * abs(left[0]) ** 2 * f

    for i in (0, 1):  # the two pulsars whose spectra are steep
        ends = np.log([1e-3 / YEAR_S, 1.0 / (14.0 * 86400.0)])
        variance = quad(power, *ends, args=(i,), limit=2000, epsrel=1e-5)[0]
        std = 299792.458 * np.sqrt(variance)
        assert np.sqrt(scenario.spin_noise(c)[i, -1, -1]) == pytest.approx(std, rel=0.01)


def test_drawn_spin_noise_has_its_covariance():
    """The measurements, less delays and photon noise, are drawn with the covariance."""
    c = replace(SHORT, weeks=6, modes=2, area_m2=1e12, hours=42.0, acceleration_km_per_s2=1e-20)
    runs = mars.trial(c, [generator(0, 0, run) for run in range(4000)])
    sun = mars.cruise(c).sun
    spin = np.stack(
        [
            epoch.z - c.timing.delay(sun[k] + epoch.truth[:, :3], sun[k])
            for k, epoch in enumerate(runs.epochs(""), 1)
        ]
    )  # (T, runs, m)
    sample = np.einsum("krm,lrm->mkl", spin, spin) / 4000
    expected = scenario.spin_noise(c)
    scale = np.sqrt(np.einsum("mkk,mll->mkl", expected, expected))
    assert np.abs((sample - expected) / scale).max() < 5.0 * np.sqrt(2.0 / 4000)


def test_modes_add_up_to_the_covariance_and_the_largest_is_the_first():
    modes = scenario.decomposed(SHORT)
    np.testing.assert_allclose(
        np.einsum("kmj,lmj->mkl", modes, modes), scenario.spin_noise(SHORT), rtol=1e-9, atol=1e-12
    )
    size = np.square(modes).sum(0)
    assert (np.diff(size, axis=1) <= 1e-12).all()


def test_an_older_or_shorter_fit_predicts_worse():
    last = {
        name: np.sqrt(scenario.spin_noise(c)[:, -1, -1])
        for name, c in (
            ("usual", SHORT),
            ("older", replace(SHORT, age_years=5.0)),
            ("oldest", replace(SHORT, age_years=10.0)),
        )
    }
    assert (last["usual"] < last["older"]).all()
    assert (last["older"] < last["oldest"]).all()


# -- the cruise ------------------------------------------------------------------------------------
def test_the_cruise_leaves_the_earth_and_reaches_mars():
    c = mars.PRESETS["usual"]
    states, Phi, sun = mars.cruise(c)
    earth, planet = (de421().state(body, c.dates).position for body in ("earth", "mars"))
    np.testing.assert_allclose(states[0, :3] + sun[0], earth[0], atol=1e-3)
    np.testing.assert_allclose(states[-1, :3] + sun[-1], planet[-1], atol=1e-3)
    departure = states[0, 3:] - np.subtract(
        *(de421().state(body, c.dates).velocity[0] for body in ("earth", "sun"))
    )
    assert 2.5 < np.linalg.norm(departure) < 4.5  # km/s, as of missions to Mars
    assert len(Phi) == len(states) - 1 == 36


def test_a_week_is_as_168_hours_of_runge_kutta():
    states, _, _ = mars.cruise(SHORT)
    sun = Earth(mars.SUN.mu, 1.0, 0.0)
    with pytest.warns(celnav.models.orbit.UnitWarning, match="not an Earth orbit"):
        hourly = propagate(states[0], 3600.0, 168, sun)[-1]
    np.testing.assert_allclose(hourly, states[1], rtol=1e-10)


# -- filters ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("age", [0.0, 10.0])
def test_the_filter_with_all_modes_is_least_squares_over_the_whole_cruise(age):
    """Its covariance along the undisturbed cruise, recursive, is that of one batch with the dense
    covariance of the spin noise.
    """
    c = replace(SHORT, modes=12, age_years=age)
    std = evaluate_filter(mars.trial(c, [Noiseless()]), "modes").std[:, 0]
    batch = study.least_squares(c, spin=True).diagonal(0, 1, 2)
    np.testing.assert_allclose(std, np.sqrt(batch), rtol=1e-4)


def test_the_filter_that_ignores_spin_noise_is_least_squares_without_it():
    std = evaluate_filter(mars.trial(SHORT, [Noiseless()]), "ignoring").std[:, 0]
    batch = study.least_squares(SHORT, spin=False).diagonal(0, 1, 2)
    np.testing.assert_allclose(std, np.sqrt(batch), rtol=1e-4)


def test_the_unscented_filter_estimates_the_same():
    c = replace(SHORT, modes=1)
    runs = mars.trial(c, [generator(0, 0, run) for run in range(20)])
    filter = runs.filters["modes"]
    runs = runs._replace(filters={"ekf": filter, "ukf": celnav.ukf(filter.motion, *filter.sensors)})
    ekf, ukf = (evaluate_filter(runs, name) for name in ("ekf", "ukf"))
    assert np.abs((ekf.error - ukf.error) / ekf.std).max() < 0.01
    np.testing.assert_allclose(ekf.std, ukf.std, rtol=0.001)


def test_jacobians_are_derivatives():
    runs = mars.trial(SHORT, [generator(0, 0, 0)])
    filter = runs.filters["modes"]
    epoch = next(iter(runs.epochs("")))
    mean = runs.prior.mean[0]
    h = np.concatenate([np.repeat([1e3, 1e-2], 3), np.ones(len(mean) - 6)])
    shifted = np.stack([mean + np.diag(h), mean - np.diag(h)])
    for model in (filter.motion.f, filter.sensors[0].h):
        y = model(shifted, epoch)
        numerical = (y[0] - y[1]).T / (2.0 * h)
        jacobian = filter.motion.jacobian if model is filter.motion.f else None
        jacobian = jacobian or filter.sensors[0].jacobian
        np.testing.assert_allclose(jacobian(mean, epoch), numerical, rtol=1e-5, atol=1e-6)


def test_wrong_parameters_are_named():
    with pytest.raises(ValueError, match=r"pulsars: expected some of B1937\+21, .*'B0531\+21'"):
        replace(SHORT, pulsars=("B0531+21",) * 4)
    with pytest.raises(ValueError, match="modes: expected at most weeks, 12, got 13"):
        replace(SHORT, modes=13)


# -- figures, table, recording, ledger -------------------------------------------------------------
def test_every_figure_is_readable(results):
    assert list(mars.FIGURES) == [f"figure_{i:02d}" for i in range(1, 5)]
    for number, (caption, draw) in enumerate(mars.FIGURES.values(), 1):
        fig = draw(results)
        assert fig.get_suptitle().startswith(f"Figure {number} (not in the paper): ")
        assert caption.endswith(".")
        assert not faults(fig), number


def test_figure_2_draws_the_rms_of_the_position_error(results):
    first = mars.FIGURES["figure_02"][1](results).axes[0].lines[0]
    error = results.error("0.02 m², modeled", "modes", "position")
    rms = np.sqrt(np.square(error).sum(-1).mean(1))
    np.testing.assert_allclose(first.get_ydata(), rms)
    np.testing.assert_allclose(first.get_xdata(), np.arange(1, 37))


def test_the_table_has_a_row_for_each_case_and_filter(results):
    _, make = mars.TABLES["table_1"]
    rows = make(results)
    assert len(rows) == 8 * 4
    assert all(np.isfinite(value) for row in rows for value in list(row.values())[2:])


def test_the_recording_holds_the_first_run(results, tmp_path):
    assert mars.record(results, Outputs(tmp_path)) == mars.RECORDINGS
    chunks = rr.chunk.RrdReader(tmp_path / mars.RECORDINGS[0]).stream().to_chunks()
    found = {str(c.entity_path): c for c in chunks if not c.is_static}
    error = np.array(found["/state/modes"].to_record_batch().column("error").to_pylist())
    expected = results.error(study.BEST, "modes", "position")[:, 0]
    np.testing.assert_allclose(error[:, :3], expected)
    assert {"/world/truth/here", "/world/pulsar/J0437-4715", "/plots/toward/first/modes"} <= set(
        found
    )


def test_the_ledger_has_the_statements_of_the_abstract(claims):
    of_paper = [id for id, claim in claims.items() if claim.kind == "statement"]
    assert of_paper == STATEMENTS.split()
    assert all(claims[id].row.place == "abstract" for id in of_paper)
    assert all(claims[id].row.revised is None for id in of_paper)
    assert all(len(claim.row.why) > 20 for claim in claims.values() if claim.kind != "check")


def test_no_verdict_is_another_than_expected(claims):
    assert [id for id, claim in claims.items() if claim.surprise] == []


def test_accepted_ranges_of_statements_are_those_of_the_abstract(claims):
    for id, most, count in (("position", 20.0, 7), ("velocity", 0.1, 7)):
        numbers = [outcome.number for outcome in claims[id].outcomes]
        assert [number.accept for number in numbers] == [(None, most)] * count
