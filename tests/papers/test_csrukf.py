"""The study of csrukf: contract, exactness, independence of blocks, and what the claims say."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr

from celnav.files import Outputs
from celnav.papers import csrukf, figures, tables
from celnav.papers.csrukf import errata, scenario, study, theory
from celnav.study.claims import dumps
from celnav.study.montecarlo import do, generator, joined

SHORT = replace(csrukf.PRESETS["P"], steps=40, runs=6)


@pytest.fixture(scope="module")
def result():
    return csrukf.reproduce(replace(csrukf.PRESETS["P"], steps=200), effort=0.04, seed=3)


@pytest.fixture(scope="module")
def short():
    return csrukf.reproduce(SHORT, runs=6, effort=0.05, seed=2)


def test_every_figure_draws_what_its_axes_say(result):
    drawn = figures(csrukf)
    assert [f"figure_{i:02d}" for i in range(1, 19)] == list(drawn)
    for stem, draw in drawn.items():
        fig = draw(result)
        assert fig.axes, stem
        labels = [label for ax in fig.axes for label in (ax.get_xlabel(), ax.get_ylabel()) if label]
        assert any("(" in label for label in labels), (stem, labels)


def test_figure_2_draws_the_errors_of_the_first_run(result):
    line = csrukf.figure_2(result).axes[0].lines[0]
    np.testing.assert_array_equal(line.get_ydata(), np.abs(result.data["P/0"]["srukf/error"][:, 0, 0]))


def test_tables_hold_the_papers_numbers_verbatim(result):
    assert list(tables(csrukf)) == ["table_1", "table_2", "table_3"]
    first = csrukf.table_1(result)[0]
    assert (first["filter"], first["source"], first["x_km"], first["vz_m_per_s"]) == ("SRUKF", "paper", 0.0355, 0.0384)
    assert len(csrukf.table_3(result)) == 12


def test_claims_are_plain_json_with_one_verdict_each(result):
    listed = json.loads(dumps(csrukf.claims(result)))
    assert len({c["id"] for c in listed}) == len(listed) > 90
    assert {c["kind"] for c in listed} == {"paper", "calibrated", "erratum", "beyond"}
    for number in range(1, 14):
        assert any(c["id"].startswith(f"figure-{number}-") for c in listed), number


def test_few_runs_leave_claims_undecided_rather_than_wrong(result):
    listed = csrukf.claims(result)
    assert sum(c.holds is None for c in listed) > 10
    assert sum(c.failure for c in listed) <= 0.05 * len(listed)  # 95 % intervals


def test_the_block_size_changes_no_byte_of_the_claims(short):
    units = [unit for unit in study._units(SHORT, 2, 6, 4) if unit.label in ("P/0.8", "D/I", "stress/I", "wrong/I")]
    assert len(units) > 4  # six runs in blocks of four
    found = joined(units, [do(unit) for unit in units])
    again = replace(short, data=short.data | {label: outcome.arrays for label, outcome in found.items()})
    assert dumps(csrukf.claims(again)) == dumps(csrukf.claims(short))


def test_a_run_does_not_depend_on_how_many_there_are():
    three = scenario.simulate(SHORT, [generator(5, 0, r) for r in range(3)])
    one = scenario.simulate(SHORT, generator(5, 0, 2))
    np.testing.assert_array_equal(three.z[:, 2], one.z)
    np.testing.assert_array_equal(three.prior.mean[2], one.prior.mean)


def test_the_nominal_orbit_has_the_check_values():
    end = csrukf.PRESETS["P"].nominal()[-1]
    np.testing.assert_allclose(end, [1128.513522, 3832.733730, 5905.955241, -6.558624, -2.301214, 2.751041], atol=2e-6)


def test_linear_theory_has_the_values_of_an_independent_prototype():
    expected = theory.expected(csrukf.PRESETS["P"], (0.0, 0.8, 1.0))
    np.testing.assert_allclose(expected.srukf[-1, 1], [0.1295, 0.1297, 0.1298, 0.0477, 0.0516, 0.0542], atol=6e-5)
    np.testing.assert_allclose(expected.csrukf[-1, 2], [0.2346, 0.2475, 0.2501, 0.1400, 0.1816, 0.2045], atol=6e-5)
    np.testing.assert_allclose(expected.openloop[-1, 0], [0.2347, 0.2476, 0.2503, 0.1400, 0.1817, 0.2046], atol=6e-5)


def test_monte_carlo_follows_linear_theory_within_its_scatter():
    many = replace(csrukf.PRESETS["P"], steps=60, phi=1.0)
    sim = scenario.simulate(many, [generator(0, 0, r) for r in range(300)])
    expected = theory.expected(many, (1.0,))
    for name, std, first in (
        ("srukf", expected.srukf, False),
        ("csrukf", expected.csrukf, True),
        ("csrukf+z0", expected.first, True),
    ):
        track = study.run(scenario.filters(many)[name], sim.prior, sim.epochs(first=first))
        rmse = np.sqrt(np.square((track.mean[-1] - sim.truth[-1]) * theory.UNITS).mean(0))
        np.testing.assert_allclose(rmse / std[-1, 0], 1.0, atol=5.0 / np.sqrt(600))


def test_filters_coincide_where_they_must():
    config = replace(SHORT, phi=0.8)
    sim = scenario.simulate(config, [generator(1, 1, r) for r in range(4)])
    tracks = {
        n: study.run(f, sim.prior, sim.epochs()).mean[..., :6]
        for n, f in scenario.filters(config).items()
        if "+" in n or "aug" in n
    }
    assert np.abs(tracks["csrukf+z0"] - tracks["augmented"]).max() < 1e-7
    paper = study.run(scenario.filters(config)["csrukf"], sim.prior, sim.epochs()).mean
    single = study.run(scenario.single_transform(config, config.R), sim.prior, sim.epochs()).mean
    assert np.abs(paper - single).max() < 1e-6


def test_reused_points_are_wrong_and_redrawn_ones_right():
    without, redrawn = errata.redraw_defect(np.random.default_rng(4))
    assert without > 0.01
    assert redrawn < 1e-12


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"phi": 1.1}, "phi"),
        ({"sigma_km": 0.0}, "sigma_km"),
        ({"alpha": 0.0}, "alpha"),
        ({"kappa": -6.0}, "kappa"),
        ({"steps": 0}, "steps"),
        ({"runs": 0}, "runs"),
        ({"noise_position_km": -1.0}, "noise_position_km"),
        ({"first_noise": "none"}, "first_noise"),
        ({"phi": 1.0, "first_noise": "stationary"}, "first_noise"),
        ({"eccentricity": float("nan")}, "eccentricity"),
        ({"eccentricity": 1.0}, "eccentricity"),
        ({"semi_major_axis_km": -7000.0}, "semi_major_axis_km"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(csrukf.PRESETS["P"], **change)


@pytest.mark.parametrize("bad", [{"effort": 0.0}, {"effort": 2.0}, {"runs": 1}, {"jobs": 0}, {"block": 0}])
def test_reproduce_refuses_bad_arguments_by_name(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        csrukf.reproduce(SHORT, **bad)


@pytest.mark.parametrize(("first", "factor"), [("R", 1.0), ("zero", 0.0), ("stationary", 1.0 / 0.36), (None, 1.0)])
def test_the_first_noise_is_what_is_chosen(first, factor):
    config = replace(csrukf.Config(), phi=0.8, first_noise=first)
    np.testing.assert_allclose(config.Sigma0, factor * config.R, rtol=1e-12)
    np.testing.assert_allclose(np.trace(config.angle_Sigma0), factor * (config.sigma_angles**2).sum(), rtol=1e-12)


def test_recordings_hold_the_first_run_and_the_monte_carlo(short, tmp_path):
    assert csrukf.record(short, Outputs(tmp_path)) == csrukf.RECORDINGS
    assert {p.name for p in tmp_path.glob("*.rrd")} == set(csrukf.RECORDINGS)
    found = {
        str(c.entity_path): c for c in rr.chunk.RrdReader(tmp_path / "csrukf_P_08.rrd").stream().to_chunks() if not c.is_static
    }
    data = short.data["P/0.8"]
    error = np.array(found["/state/csrukf"].to_record_batch().column("error").to_pylist())
    np.testing.assert_allclose(error, data["csrukf/error"][:, 0] / theory.UNITS)
    rmse = found["/plots/rmse/position/srukf"].to_record_batch().column("Scalars:scalars").to_pylist()
    np.testing.assert_allclose(10.0 ** np.ravel(rmse), np.sqrt(np.square(data["srukf/error"][..., :3]).sum(-1).mean(1)))
    drawn = {"/world/limb", "/world/stars/i2", "/world/angles", "/world/z", "/error/openloop/ellipsoid", "/plots/V/x/augmented"}
    assert drawn <= set(found)
