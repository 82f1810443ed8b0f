"""The second paper: what it draws, tabulates and claims, and the identities behind it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr

from celnav import Epoch, Gaussian, Motion, run, sigma_point
from celnav.files import Outputs
from celnav.gaussian.rules import gauss_hermite, simplex, tensor_product
from celnav.papers import aasghqf, figures
from celnav.papers.aasghqf import analysis, errata, scenario, study
from celnav.papers.aasghqf.config import A_SLOW, PAPER_WEIGHTS, A
from celnav.papers.aasghqf.published import TABLE_3
from celnav.study.claims import dumps
from celnav.study.montecarlo import do, effort, generator, joined


@pytest.fixture(scope="module")
def result():
    return aasghqf.reproduce(replace(A, steps=100), effort=effort())


@pytest.fixture(scope="module")
def short():
    sim = aasghqf.simulate(replace(A, steps=30), [generator(3, 0, r) for r in range(4)])
    return sim, aasghqf.filters(sim.config)


def tracks(short, *names):
    sim, known = short
    return [run(known[name], sim.prior, sim.epochs()) for name in names]


def test_every_figure_draws(result):
    drawn = {name: function(result) for name, function in figures(aasghqf).items()}
    assert len(drawn) == 11
    for fig in drawn.values():
        assert all(ax.get_xlabel() or ax.get_ylabel() or ax.get_title() or ax.lines for ax in fig.axes)
    for name in ("figure_03", "figure_04", "figure_05"):
        assert len(drawn[name].axes[0].lines) == 5


def test_figures_1_and_2_show_the_published_numbers_of_points(result):
    for figure, count in ((aasghqf.figure_1, 21), (aasghqf.figure_2, 9)):
        assert sum(len(c.get_offsets()) for c in figure(result).axes[0].collections) == count


def test_tables(result):
    assert all(row["paper"] == row["ours"] for row in aasghqf.table_1(result))
    assert len(aasghqf.table_1(result)) == 12
    assert [row["weight by nonlinearity"] for row in aasghqf.table_2(result)] == [1.0] * 3 + [2.0] * 10
    printed = [row for row in aasghqf.table_3(result) if row["source"] == "paper"]
    for row in printed:
        assert list(row.values())[2:] == TABLE_3[row["filter"]].tolist()
    assert [row["points, ours"] for row in aasghqf.table_4(result)] == [27, 417, 75]


def test_claims_are_plain_json_with_one_verdict_each(result):
    listed = json.loads(dumps(aasghqf.claims(result)))
    assert {c["kind"] for c in listed} == {"paper", "calibrated", "erratum", "beyond"}
    assert not any("time" in c["id"] for c in listed)
    exact = {c["id"]: c for c in listed if c["ci"] is None and c["kind"] in ("paper", "erratum")}
    assert exact["table-1"]["verdict"] == "reproduced"
    assert exact["erratum-1-points"]["value"] == 75
    assert exact["table-4-aasghqf"]["verdict"] == "not reproduced"


def test_the_block_size_changes_no_byte_of_the_claims(result):
    every = study._units(result.config, 0, result.runs, 1)
    units = [unit for unit in every if unit.label.startswith(("A/", "start/45"))]
    assert len(units) > 3  # each run by itself
    data = dict(result.data)
    for label, outcome in joined(units, [do(unit) for unit in units]).items():
        name = label if label in data else label.partition("/")[0]
        assert set(outcome.arrays) <= set(data[name])
        data[name] = data[name] | outcome.arrays
    again = replace(result, data=data)
    assert dumps(aasghqf.claims(again)) == dumps(aasghqf.claims(result))


def test_57_points_are_the_filter_of_417(short):
    fine, coarse = tracks(short, "sghqf", "nonlinear")
    assert np.abs((fine.mean - coarse.mean) / fine.std).max() < 1e-5


def test_longitude_and_latitude_need_no_points_of_their_own(short):
    sim, _ = short
    (paper,) = tracks(short, "aasghqf")
    fewer = run(scenario.quadrature_filter(study.smolyak(13, 3, [1, 1] + [2] * 11), sim.config), sim.prior, sim.epochs())
    assert np.abs((paper.mean - fewer.mean) / paper.std).max() < 1e-6


def test_the_marginalized_rule_is_the_tensor_rule():
    """Three dimensions are nonlinear, two linear given these: 3^3 x 3 points do what 3^5 do."""
    rng = np.random.default_rng(0)
    B = rng.standard_normal((5, 2))

    def f(x, _epoch=None):
        phi, y = x[..., :3], x[..., 3:]
        first = np.stack([np.sin(phi[..., 0]), phi[..., 1] * phi[..., 2], np.cos(phi[..., 2]), phi[..., 0], phi[..., 1]], -1)
        return first + (np.cos(phi[..., :1]) * y) @ B.T

    root = np.linalg.cholesky(np.cov(rng.standard_normal((5, 40))))
    prior, motion = Gaussian(rng.standard_normal(5), sqrt_cov=root), Motion(f, np.zeros((5, 5)))
    filters = (sigma_point(motion, rule=rule) for rule in (tensor_product(gauss_hermite(3, 3), simplex(2)), gauss_hermite(5, 3)))
    marginal, whole = (filter.predict(filter.start(prior), Epoch(dt=1.0)).belief for filter in filters)
    np.testing.assert_allclose(marginal.mean, whole.mean, atol=1e-13)
    np.testing.assert_allclose(marginal.cov, whole.cov, atol=1e-12)


def test_both_forms_agree(short):
    sim, known = short
    filter = sigma_point(*scenario.model(sim.config), rule=scenario.rules()["nonlinear"], form="square root")
    roots = run(filter, sim.prior, sim.epochs())
    covariances = run(known["nonlinear"], sim.prior, sim.epochs())
    assert np.abs((roots.mean - covariances.mean) / covariances.std).max() < 1e-4


def test_a_rule_that_loses_definiteness_is_redone_and_counted():
    sim = aasghqf.simulate(replace(A_SLOW, steps=3), [generator(1, 0, r) for r in range(6)])
    track = run(aasghqf.filters(sim.config)["ckf5"], sim.prior, sim.epochs())
    np.testing.assert_array_equal(track.events["redone"], 1)
    assert (track.failed_at < 0).all()
    positive = run(aasghqf.filters(sim.config)["ghqf3"], sim.prior, sim.epochs())
    np.testing.assert_allclose(track.mean[0], positive.mean[0], atol=1e-12)


def test_fixes_come_at_their_own_rates():
    sim = aasghqf.simulate(replace(A_SLOW, steps=40), generator(0, 0, 0))
    seen = np.isfinite(sim.z)
    assert np.flatnonzero(seen[:, 0]).tolist() == [0, 10, 20, 30, 40]
    assert np.flatnonzero(seen[:, 6]).tolist() == [0, 20, 40]
    track = run(aasghqf.filters(sim.config)["nonlinear"], sim.prior, sim.epochs())
    np.testing.assert_array_equal(track.used, seen)


def test_a_point_beyond_the_chart_loses_its_run_only():
    sim = aasghqf.simulate(replace(A, steps=2), [generator(0, 0, r) for r in range(3)])
    epoch = list(sim.epochs())[1]
    x = np.tile(sim.truth[0], (4, 1, 1))
    x[2, 1, 0] = np.radians(89.5)
    lost = np.isnan(scenario.dynamics(x, epoch)).all(-1)
    assert np.argwhere(lost).tolist() == [[2, 1]]


def test_the_bound_keeps_to_the_truth_and_is_the_kalman_covariance():
    sim = aasghqf.simulate(replace(A, steps=5), [generator(2, 0, r) for r in range(2)])
    track = run(study.bound_filter(sim.config), Gaussian(sim.truth[0], sim.prior.cov), sim.epochs())
    np.testing.assert_array_equal(track.mean, sim.truth)
    triad = run(aasghqf.filters(sim.config)["triad-ekf"], sim.prior, sim.epochs())
    np.testing.assert_allclose(triad.std[-1], track.std[-1], rtol=0.05)


def test_small_misalignment_is_the_kalman_filter():
    assert analysis.small_misalignment(A) < 1e-6


def test_closed_mean_of_the_rotation():
    sigma = np.radians([10.0, 20.0, 5.0])
    rule = gauss_hermite(3, 12)
    from celnav.models.inertial import misalignment_matrix

    sampled = np.einsum("p,pij->ij", rule.wm, misalignment_matrix(rule.nodes * sigma))
    np.testing.assert_allclose(sampled, analysis.mean_rotation(sigma), atol=1e-13)


def test_how_ninety_nine_points_arise():
    assert errata.points_merged_at_the_origin(3, PAPER_WEIGHTS) == 99
    assert errata.points_merged_at_the_origin(3, (1, 1)) == 1 + 2 * 2 + 2 * 6 + 8


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"runs": 0}, "runs"),
        ({"star_interval": 0}, "star_interval"),
        ({"sar_m": -1.0}, "sar_m"),
        ({"misalignment_deg": (1.0, 2.0)}, "misalignment_deg"),
        ({"misalignment_deg": (1.0, 0.0, 2.0)}, "misalignment_deg"),
        ({"angle_walk_deg_per_sqrt_h": -1.0}, "angle_walk_deg_per_sqrt_h"),
        ({"speed_m_per_s": np.nan}, "speed_m_per_s"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(A, **change)


@pytest.mark.parametrize("bad", [{"effort": 0.0}, {"effort": 2.0}, {"runs": 1}, {"runs": 2.5}, {"block": 0}, {"jobs": 0}])
def test_reproduce_refuses_bad_arguments_by_name(bad):
    with pytest.raises(ValueError, match=f"^{next(iter(bad))}"):
        aasghqf.reproduce(**bad)


def test_degrees_by_singular_values_and_their_weights():
    np.testing.assert_allclose(analysis.svd_degree(np.diag([3.0, 0.5, 7.0])), [3.0, 0.5, 7.0])
    np.testing.assert_allclose(analysis.svd_degree(np.diag([3.0, 0.5, 7.0]), 1), [6.0, 1.0, 14.0])
    assert analysis.threshold_weights([9.8, 5.0, 5.1, 0.0], 5.0) == (1, 2, 1, 2)


def test_recordings_hold_what_the_filters_gave(result, tmp_path):
    assert aasghqf.record(result, Outputs(tmp_path)) == aasghqf.RECORDINGS
    found = {str(c.entity_path): c for c in rr.chunk.RrdReader(tmp_path / "aasghqf_T3.rrd").stream().to_chunks() if not c.is_static}
    nees = found["/plots/consistency/nees/ukf"].to_record_batch().column("Scalars:scalars").to_pylist()
    np.testing.assert_allclose(10.0 ** np.ravel(nees), result.data["T3"]["ukf/nees"][:, 0] / 13.0)
    drawn = {"/world/star1/expected", "/points/ukf/negative", "/error/sghqf/ellipsoid", "/error/measured/points"}
    assert drawn <= set(found)
