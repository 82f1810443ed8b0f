"""The study of aasghqf: contract, exactness, independence of the number of runs, and the ledger."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from once import once
from readable import faults
from scipy.linalg import block_diag, expm
from scipy.spatial.transform import Rotation

from celnav import Epoch, Gaussian, Motion, iterated_smoother, run, sigma_point
from celnav.analysis.metrics import chi_square_band
from celnav.analysis.observability import (
    jacobian,
    nonlinearity_weights,
    state_singular_values,
    threshold_weights,
)
from celnav.files import Outputs
from celnav.gaussian.belief import nees
from celnav.gaussian.linalg import Covariance
from celnav.gaussian.rules import gauss_hermite, simplex, tensor_product
from celnav.gaussian.sparse_grid import index_set, point_count, smolyak
from celnav.models import misalignment
from celnav.papers import aasghqf
from celnav.papers.aasghqf import scenario, show, study
from celnav.papers.aasghqf.scenario import (
    BORESIGHTS,
    DEGREE,
    NONLINEAR_WEIGHTS,
    PAPER_WEIGHTS,
    PRESETS,
    A,
    measurement,
)
from celnav.show.claims import dumps
from celnav.show.reading import read
from celnav.study.montecarlo import generator
from celnav.study.study import evaluate_filters

STATEMENTS = """
table-1-counts points-for-two-states degrees-of-observability threshold-weights observability-is-the-criterion
adapts-along-the-flight better-than-ukf higher-order-is-why alike-sghqf table-3-levels
table-4-points one-millisecond-more cheaper-than-sghqf saving-grows points-grow sghqf-beats-ekf-ukf-cheaper-than-ghqf
"""
TABLE_1 = "7, 21, 37, 57, 81, 109, 7, 9, 23, 25, 41, 43"
TABLE_2 = (
    "9.845 9.845 4.635 1.0 1.0 9.639 9.639 6.984e-5 6.937e-6 5.937e-5 6.686e-6 3.795e-5 3.652e-7"
)
TABLE_3 = """
0.350 0.367 0.412 0.527 0.609 18.163 17.821
0.217 0.203 0.251 0.328 0.397 16.274 16.183
0.223 0.201 0.256 0.303 0.426 15.997 16.285
"""
TABLE_4 = "27 0.0021 417 0.0065 99 0.0028"


@pytest.fixture(scope="module")
def results():
    return once(aasghqf.STUDY)


@pytest.fixture(scope="module")
def short():
    sim = aasghqf.simulate(replace(A, steps=30), [generator(3, 0, r) for r in range(4)])
    return sim, aasghqf.filters(sim.config)


def tracks(short, *names):
    sim, known = short
    return [run(known[name], sim.prior, sim.epochs()) for name in names]


# -- the ledger ------------------------------------------------------------------------------------
def test_the_ledger_has_every_statement_and_at_most_so_much_else():
    count = Counter(row.kind for row in aasghqf.STUDY.rows)
    assert [row.id for row in aasghqf.STUDY.rows if row.kind == "statement"] == STATEMENTS.split()
    assert count["erratum"] == 5
    assert count["finding"] <= 10
    assert count["check"] <= 50


def test_printed_numbers_are_verbatim():
    assert [*study.TABLE_1["SGHQF"], *study.TABLE_1["AASGHQF"]] == [
        int(n) for n in TABLE_1.split(",")
    ]
    assert [float(n) for n in TABLE_2.split()] == study.TABLE_2
    assert [n for row in study.TABLE_3.values() for n in row] == [float(n) for n in TABLE_3.split()]
    assert [n for row in study.TABLE_4.values() for n in row] == [float(n) for n in TABLE_4.split()]
    assert PAPER_WEIGHTS == (1, 1, 2, 2, 2, 1, 1, 2, 2, 2, 2, 2, 2)


def test_the_ledger_prints_the_tables_that_decide_it():
    printed = {row.id: row.printed for row in aasghqf.STUDY.rows if row.printed is not None}
    points = {name: list(row) for name, row in study.TABLE_4.items()}
    assert printed["table-1-counts"] == study.TABLE_1
    assert printed["saving-grows"] == study.TABLE_1 | points
    assert printed["degrees-of-observability"] == study.TABLE_2
    assert printed["threshold-weights"] == list(scenario.PAPER_WEIGHTS)
    for id in ("better-than-ukf", "alike-sghqf", "table-3-levels"):
        assert printed[id] == study.TABLE_3


def test_what_needs_no_runs_comes_out_as_expected(results):
    claims = {claim.id: claim for claim in results.claims()}
    dumps(claims.values())
    exact = [
        "table-1-counts",
        "points-for-two-states",
        "degrees-of-observability",
        "threshold-weights",
        "higher-order-is-why",
        "table-4-points",
        "saving-grows",
        "points-grow",
        "one-millisecond-more",
        "cheaper-than-sghqf",
        "erratum-9-units",
        "first-fix",
        *(row.id for row in study.ROWS if row.kind == "erratum"),
    ]
    assert {id: claims[id].verdict for id in exact} == {id: claims[id].expected for id in exact}
    for claim in claims.values():
        known = claim.verdict == claim.expected and claim.numbers and claim.row.found
        assert claim.note or not known
        assert not re.search(r"\{\d", claim.note)
    assert sum(claim.surprise for claim in claims.values()) <= 2  # two runs decide little


def test_a_run_does_not_depend_on_how_many_there_are():
    config = replace(A, steps=20)
    three = aasghqf.simulate(config, [generator(5, 0, r) for r in range(3)])
    one = aasghqf.simulate(config, [generator(5, 0, 2)])
    np.testing.assert_array_equal(three.z[:, 2:], one.z)
    many, alone = (
        evaluate_filters(study.judged(config, [generator(5, 0, r) for r in runs]), ("ukf",))
        for runs in ((0, 1, 2), (2,))
    )
    np.testing.assert_allclose(many["ukf/error"][:, 2:], alone["ukf/error"], rtol=1e-7, atol=1e-9)


def test_averages_are_those_of_their_definition(results):
    number = study.averaged("", [("A", "ukf"), ("A", "sghqf")], states=slice(3, 5))(results)
    ukf, sghqf = (
        np.sqrt(np.square(results.get("A", f"{f}/error")[..., 3:5]).mean(1)).mean(0).sum()
        for f in ("ukf", "sghqf")
    )
    assert number.value == pytest.approx(ukf / sghqf, rel=1e-12)
    assert number.ci[0] < number.value < number.ci[1]


# -- what is shown ---------------------------------------------------------------------------------
def test_every_figure_draws(results):
    assert [f"figure_{i:02d}" for i in range(1, 11)] == list(show.FIGURES)
    drawn = {stem: draw(results) for stem, (_, draw) in show.FIGURES.items()}
    for stem, fig in drawn.items():
        assert not faults(fig), stem
        title = fig._suptitle.get_text()
        assert title.startswith(f"Figure {int(stem[-2:])}")
        assert ("(not in the paper)" in title) == (stem > "figure_05")
        assert all(
            ax.get_xlabel() or ax.get_ylabel() or ax.get_title() or ax.lines for ax in fig.axes
        )
    for stem, count in (
        ("figure_03", 3),
        ("figure_04", 2),
        ("figure_05", 2),
        ("figure_09", 3),
        ("figure_10", 3),
    ):
        assert [len(ax.lines) for ax in drawn[stem].axes] == [5] * count
    for stem, count in (("figure_01", 21), ("figure_02", 9)):
        assert sum(len(c.get_offsets()) for c in drawn[stem].axes[0].collections) == count


def test_tables(results):
    one, two, three, four = (draw(results) for _, draw in show.TABLES.values())
    assert all(row["paper"] == row["ours"] for row in one)
    assert len(one) == 12
    assert [row["degree, paper"] for row in two] == study.TABLE_2
    for row in (row for row in three if row["source"] == "paper"):
        assert list(row.values())[2:] == study.TABLE_3[row["filter"]]
    assert [row["points, ours"] for row in four] == [27, 417, 75]


def test_a_recording_holds_the_first_run(results, tmp_path):
    made = show.showcase(results, "T3")
    estimate = made.estimates["sghqf"]
    scale = np.array([1.0 / DEGREE] * 3)
    std = np.sqrt(estimate.cov.diagonal(0, -2, -1))[:, :3] * scale
    np.testing.assert_allclose(std, results.get("T3", "sghqf/std")[:, 0, :3], rtol=1e-6)
    assert show.record(results, Outputs(tmp_path)) == show.RECORDINGS
    assert {path.name for path in tmp_path.iterdir() if path.suffix == ".rrd"} == set(
        show.RECORDINGS
    )
    lanes = read(tmp_path / "aasghqf_T3.rrd")
    z = np.stack([epoch.z[0] for epoch in results.first("T3").epochs("ukf")])
    for sensor, rows in (("stars", slice(0, 6)), ("SAR", slice(6, 8))):
        lane = lanes[f"states/{sensor}"]
        at = np.searchsorted(lane.times, results.times("T3") + 1e-6) - 1
        measured = np.isfinite(z[:, rows]).all(1)
        assert measured.any()
        np.testing.assert_array_equal(lane["state"][at], np.where(measured, "used", "missing"))


# -- grids and observability -----------------------------------------------------------------------
@pytest.mark.parametrize(
    ("level", "weights"), [(3, (1, 1)), (3, (2, 1)), (3, (2, 2, 1, 1)), (4, (1, 2, 3)), (3, (2, 2))]
)
def test_tensor_rules_with_their_coefficients_are_the_smolyak_rule(level, weights):
    terms = study.grid({index: c for index, c in index_set(level, weights).items() if c})
    merged = {
        point: sum(parts)
        for point, parts in terms.items()
        if abs(sum(parts)) > 1e-12 * sum(map(abs, parts))
    }
    rule = smolyak(len(weights), level, weights)
    known = dict(zip(map(tuple, rule.nodes.tolist()), rule.wm.tolist(), strict=True))
    assert merged.keys() == {point for point, weight in known.items() if weight}
    for point, weight in merged.items():
        assert weight == pytest.approx(known[point], rel=1e-11)


def test_degrees_by_singular_values_and_their_weights():
    both = np.stack([np.diag([3.0, 0.5, 7.0]), np.diag([1.0, 2.0, 4.0])])
    np.testing.assert_allclose(state_singular_values(both), [[3.0, 0.5, 7.0], [1.0, 2.0, 4.0]])
    assert threshold_weights([9.8, 5.0, 5.1, 0.0], 5.0) == (1, 2, 1, 2)


def test_only_the_misalignment_is_nonlinear(short):
    sim, _ = short
    first, second, *_ = sim.epochs()

    def alone(epoch):  # of the first run
        u = epoch.u._replace(attitude=epoch.u.attitude[0])
        if u.interval is not None:
            u = u._replace(
                interval=u.interval._replace(
                    attitude=u.interval.attitude[0], force=u.interval.force[0]
                )
            )
        return epoch._replace(u=u)

    bent = [
        lambda x: misalignment.advance(x, alone(second).u.interval, 1.0),
        lambda x: scenario.measurement(x, alone(first)),
    ]
    assert (
        nonlinearity_weights(bent, np.zeros(13), sim.config.sigma0, tolerance=1e-3)
        == NONLINEAR_WEIGHTS
    )


def at_rest(config, turned=None):
    """The observability at the start of an error-free flight, with a rotated body."""
    nav = misalignment.navigation(config.flight, 0, np.zeros(3), np.zeros(3))
    if turned is not None:
        nav = nav._replace(attitude=nav.attitude @ turned)
    return Epoch(
        dt=1.0, u=scenario.Inputs(nav, nav.attitude, BORESIGHTS @ nav.attitude.T, np.eye(8))
    )


def test_at_rest_the_matrix_of_a_piece_is_that_of_lie_derivatives(results):
    values = state_singular_values(scenario.observability(np.zeros(13), at_rest(A), A.units))
    np.testing.assert_allclose(
        values / values[3], results.get("observability", "every")[0, 0], rtol=1e-5, atol=1e-8
    )


def test_from_the_second_order_on_the_weights_do_not_depend_on_it():
    matrices = [
        scenario.observability(np.zeros(13), at_rest(A), A.units, order) for order in range(1, 13)
    ]
    values = [state_singular_values(matrix) for matrix in matrices]
    first, *others = (threshold_weights(one / one[3], 5.0) for one in values)
    assert set(first) == {2}
    assert set(others) == {(1, 1) + (2,) * 11}


def test_level_flight_does_not_tell_the_vertical_bias_and_a_roll_tells_it_by_its_sine():
    def column(degrees):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        roll = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        return scenario.observability(np.zeros(13), at_rest(A, roll), A.units)

    assert np.linalg.matrix_rank(column(0.0)) <= 12
    assert state_singular_values(column(0.0))[12] == 0.0
    one, two = (np.linalg.norm(column(degrees)[:, 12]) for degrees in (1.0, 2.0))
    assert two / one == pytest.approx(np.sin(np.radians(2.0)) / np.sin(np.radians(1.0)), rel=1e-6)


def test_pieces_without_transitions_are_those_with_them():
    """The null space of each piece is contained in the null space of its rates, so the stacks of
    both kinds have the same null space.
    """
    x, known = (
        np.zeros(13),
        [at_rest(A), at_rest(replace(A, heading_deg=110.0, speed_m_per_s=300.0))],
    )
    H0, H1 = (scenario.observability(x, e, A.units, 12) for e in known)
    A0, A1 = (jacobian(lambda x, e=e: misalignment.derivative(x, e.u.interval), x) for e in known)
    move = expm(50.0 * A0 * A.units[0] / A.units[0][:, None])
    stripped, total = (
        np.linalg.matrix_rank(np.concatenate([H0, last]), tol=1e-9) for last in (H1, H1 @ move)
    )
    assert stripped == total == 12
    assert np.abs(A1[:, 12]).max() < 1e-3 * np.abs(A1).max()


def test_extreme_thresholds_are_the_isotropic_rule_and_the_rule_before(short):
    sim, _ = short
    epoch = next(sim.epochs())
    belief = Covariance(sim.prior.mean, np.broadcast_to(sim.prior.cov, (4, 13, 13)))
    everything = scenario.by_observability(sim.config, 0.0)(belief, epoch, None)
    assert {f"{number:013b}"[1:] for number in everything.tolist()} == {
        "1" * 12
    }  # perhaps except the vertical bias
    never = scenario.by_observability(sim.config, 1e30)
    np.testing.assert_array_equal(never(belief, epoch, None), 2**13 - 1)
    np.testing.assert_array_equal(never(belief, epoch, np.full(4, 3)), 3)


def test_counts_of_points_and_what_they_save():
    for m, k in ((2, 0), (2, 3), (4, 9), (7, 2)):
        assert point_count(m + k, 3, [1] * m + [2] * k) == 1 + 2 * k + 8 * m + 2 * m * (m - 1)
    saved = [
        1.0 - point_count(n, 3, [1] * (n // 2) + [2] * (n // 2)) / point_count(n, 3)
        for n in (6, 12, 24, 400)
    ]
    assert np.diff(saved).min() > 0.0
    assert saved[-1] == pytest.approx(1.0 - 0.5**2, abs=0.01)


@pytest.mark.parametrize("n", [2, 5, 13, 20, 40])
def test_sparse_grids_have_as_many_points_as_their_polynomials(n):
    """Isotropic grids from rules with 1, 3, 7 and 15 points, which share only the center: closed
    forms of degree level - 1, compared with m^n.
    """
    assert point_count(n, 3) == 1 + 6 * n + 2 * n * n
    pairs, triples = n * (n - 1) // 2, n * (n - 1) * (n - 2) // 6
    assert (
        abs(point_count(n, 4) - (1 + 2 * (1 + 3 + 7) * n + (4 + 2 * 12) * pairs + 8 * triples)) <= 1
    )
    assert gauss_hermite(2, 7).num_sigmas() == 7**2


# -- the filters -----------------------------------------------------------------------------------
def test_57_points_are_the_filter_of_417(short):
    fine, coarse = tracks(short, "sghqf", "nonlinear")
    assert np.abs((fine.mean - coarse.mean) / fine.std).max() < 1e-5


def test_longitude_and_latitude_need_no_points_of_their_own(short):
    sim, _ = short
    (paper,) = tracks(short, "aasghqf")
    fewer = run(
        scenario.quadrature_filter(smolyak(13, 3, [1, 1] + [2] * 11), sim.config),
        sim.prior,
        sim.epochs(),
    )
    assert np.abs((paper.mean - fewer.mean) / paper.std).max() < 1e-6


def test_small_misalignment_is_the_kalman_filter():
    config = replace(A, misalignment_deg=(1e-5 / DEGREE,) * 3, steps=20)
    sim = aasghqf.simulate(config, [generator(0, 99, r) for r in range(2)])
    exact, *others = tracks(
        (sim, aasghqf.filters(config)),
        "ekf",
        "ukf",
        "sghqf",
        "aasghqf",
        "nonlinear",
        "ckf",
        "ghqf3",
    )
    assert max(np.abs((track.mean - exact.mean) / config.sigma0).max() for track in others) < 1e-6


def test_an_anisotropic_rule_needs_the_nonlinear_states_first_and_a_lower_root():
    """Errors of the mean star residuals over random correlated covariances: with a permuted root
    the rule with 57 points loses its accuracy.
    """
    epoch = next(aasghqf.simulate(replace(A, steps=1), study.UNDISTURBED).epochs())
    rng, scale = np.random.default_rng(0), np.repeat([10.0 * DEGREE, 1.0], [3, 10])
    errors = {"lower": [], "upper": []}

    def mean(rule, root):
        points = np.zeros((len(rule.nodes), 13))
        points[:, :3] = rule.nodes @ root[:3].T
        return rule.wm @ scenario.measurement(points, epoch)[:, :6]

    for _ in range(20):
        B = rng.standard_normal((13, 13))
        P = B @ B.T
        P *= np.outer(scale / np.sqrt(P.diagonal()), scale / np.sqrt(P.diagonal()))
        exact = mean(gauss_hermite(3, 15), np.linalg.cholesky(P[:3, :3]))
        roots = {
            "lower": np.linalg.cholesky(P),
            "upper": np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1],
        }
        for name, root in roots.items():
            errors[name].append(
                np.linalg.norm(mean(smolyak(13, 3, NONLINEAR_WEIGHTS), root) - exact)
                / np.linalg.norm(exact)
            )
    assert np.median(errors["lower"]) < 1e-3
    assert np.median(errors["upper"]) > 100.0 * np.median(errors["lower"])


def test_the_marginalized_rule_is_the_tensor_rule():
    """Three dimensions are nonlinear, two are linear given these: 3^3 x 3 points give the result of
    3^5.
    """
    rng = np.random.default_rng(0)
    B = rng.standard_normal((5, 2))

    def f(x, _epoch=None):
        phi, y = x[..., :3], x[..., 3:]
        first = np.stack(
            [
                np.sin(phi[..., 0]),
                phi[..., 1] * phi[..., 2],
                np.cos(phi[..., 2]),
                phi[..., 0],
                phi[..., 1],
            ],
            -1,
        )
        return first + (np.cos(phi[..., :1]) * y) @ B.T

    root = np.linalg.cholesky(np.cov(rng.standard_normal((5, 40))))
    prior, motion = Gaussian(rng.standard_normal(5), sqrt_cov=root), Motion(f, np.zeros((5, 5)))
    filters = (
        sigma_point(motion, rule=rule)
        for rule in (tensor_product(gauss_hermite(3, 3), simplex(2)), gauss_hermite(5, 3))
    )
    marginal, whole = (
        filter.predict(filter.start(prior), Epoch(dt=1.0)).belief for filter in filters
    )
    np.testing.assert_allclose(marginal.mean, whole.mean, atol=1e-13)
    np.testing.assert_allclose(marginal.cov, whole.cov, atol=1e-12)


def test_both_forms_agree(short):
    sim, known = short
    assert known["nonlinear"].first.form is Covariance
    filter = sigma_point(
        *scenario.model(sim.config), rule=scenario.rules()["nonlinear"], form="square root"
    )
    roots = run(filter, sim.prior, sim.epochs())
    covariances = run(known["nonlinear"], sim.prior, sim.epochs())
    assert np.abs((roots.mean - covariances.mean) / covariances.std).max() < 1e-4


def test_a_rule_that_loses_definiteness_is_redone_and_counted():
    sim = aasghqf.simulate(
        replace(PRESETS["A-slow"], steps=3), [generator(1, 0, r) for r in range(6)]
    )
    ckf5, positive, *others = tracks(
        (sim, aasghqf.filters(sim.config)), "ckf5", "ghqf3", "ukf", "sghqf", "aasghqf", "nonlinear"
    )
    np.testing.assert_array_equal(ckf5.events["redone"], 1)
    assert (ckf5.failed_at < 0).all()
    np.testing.assert_allclose(ckf5.mean[0], positive.mean[0], atol=1e-12)
    assert not any(np.any(track.events["redone"]) for track in others)


def test_weights_by_nonlinearity_on_line_are_those_of_57_points_then_of_27(short):
    sim, _ = short
    track = run(
        scenario.adaptive(scenario.by_nonlinearity(), sim.config),
        sim.prior,
        sim.epochs(),
        also=lambda epoch, state, infos: {"chosen": state.chosen},
    )
    assert [
        scenario.weighted(number).num_sigmas()
        for number in track.extra["chosen"][[0, -1], 0].tolist()
    ] == [57, 27]
    (fine,) = tracks(short, "sghqf")
    assert np.abs((track.mean - fine.mean) / fine.std).max() < 0.3


def test_mounting_errors_that_are_known_change_nothing():
    """Reading K: a filter that rotates its prediction as the sensors rotate their measurements,
    with isotropic noise.
    """
    config = replace(A, steps=10)
    sim, rng = (
        aasghqf.simulate(config, [generator(0, 0, r) for r in range(2)]),
        np.random.default_rng(0),
    )
    E = block_diag(*Rotation.from_rotvec(1e-3 * rng.standard_normal((2, 3))).as_matrix(), np.eye(2))
    motion, sensor = scenario.model(config)
    other = replace(sensor, h=lambda x, epoch: measurement(x, epoch) @ E.T)
    turned = sigma_point(motion, other, rule=scenario.rules()["nonlinear"], form="covariance")
    own, given = (
        run(scenario.filters(config)["nonlinear"], sim.prior, sim.epochs()),
        sim._replace(z=sim.z @ E.T),
    )
    other = run(turned, sim.prior, given.epochs())
    assert np.abs((own.mean - other.mean) / own.std).max() < 1e-5


def test_mounting_errors_turn_the_attitude_by_the_closed_form():
    """Reading U, one fix without noise: the bias is the least-squares solution; a common error is
    reproduced exactly.
    """
    config, mu = (
        replace(A, steps=1),
        1e-4 * np.array([[[0.3, -0.8, 0.5], [1.1, 0.4, -0.2]], [[0.3, -0.8, 0.5]] * 2]),
    )
    sim = aasghqf.simulate(config, study.UNDISTURBED * 2)
    epoch = next(sim.epochs())
    z = scenario.mounted(sim, mu).z[0, :, :6]
    np.testing.assert_allclose(z.reshape(2, 2, 3), np.cross(mu, BORESIGHTS), atol=1e-7)
    attitude = epoch.u.attitude
    phi = misalignment.wahba_misalignment(z, attitude, epoch.u.stars)
    bias = -np.einsum("rij,ri->rj", attitude, phi)  # on body axes; C_n^n' turns axes, not vectors
    r1, r2 = BORESIGHTS
    r3 = np.cross(r1, r2)
    expected = [mu[0, 1] @ r1, mu[0, 0] @ r2, 0.5 * (mu[0, 0] + mu[0, 1]) @ r3]
    np.testing.assert_allclose(bias[0] @ np.array([r1, r2, r3]).T, expected, atol=1e-7)
    np.testing.assert_allclose(bias[1], mu[1, 0], atol=1e-7)


def test_estimated_mounting_errors_are_in_the_model(short):
    """Reading S: at a state with these errors, the prediction equals the measurement."""
    config = replace(A, steps=1)
    mu = 1e-4 * np.array([[[0.3, -0.8, 0.5], [1.1, 0.4, -0.2]]])
    sim = aasghqf.simulate(config, [generator(0, 0, 0)])
    filter, prior = scenario.mounting_filter(config, 1e-3)
    assert prior.mean.shape == (1, 19)
    x = np.concatenate([sim.truth[0], mu.reshape(1, 6)], -1)
    epoch = next(sim.epochs())
    added = scenario.mounted(sim, mu).z[0] - sim.z[0]
    np.testing.assert_allclose(
        filter.sensors[0].h(x[None], epoch)[0] - measurement(sim.truth[:1], epoch)[0],
        added,
        atol=1e-7,
    )


def test_fixes_come_at_their_own_rates():
    sim = aasghqf.simulate(replace(PRESETS["A-slow"], steps=40), [generator(0, 0, 0)])
    seen = np.isfinite(sim.z)
    assert np.flatnonzero(seen[:, 0, 0]).tolist() == [0, 10, 20, 30, 40]
    assert np.flatnonzero(seen[:, 0, 6]).tolist() == [0, 20, 40]
    (track,) = tracks((sim, aasghqf.filters(sim.config)), "nonlinear")
    np.testing.assert_array_equal(track.used, seen)


def test_a_point_beyond_the_chart_loses_its_run_only():
    sim = aasghqf.simulate(replace(A, steps=2), [generator(0, 0, r) for r in range(3)])
    epoch = list(sim.epochs())[1]
    x = np.tile(sim.truth[0], (4, 1, 1))
    x[2, 1, 0] = np.radians(89.5)
    lost = np.isnan(scenario.dynamics(x, epoch)).all(-1)
    assert np.argwhere(lost).tolist() == [[2, 1]]


# -- the first star fix, linearized again ----------------------------------------------------------
def regression(rule, m, C, epoch):
    """``A, b, Omega`` of the measurement of one run over ``N(m, C)``, by sums over points
    [Garcia2015].
    """
    x = m + rule.nodes @ np.linalg.cholesky(C).T
    y = measurement(x[:, None], epoch)[:, 0]
    mean = rule.wm @ y
    A = np.linalg.solve(C, (x - m).T @ (rule.wc[:, None] * (y - mean))).T
    return A, mean - A @ m, (y - mean).T @ (rule.wc[:, None] * (y - mean)) - A @ C @ A.T


@pytest.mark.parametrize("form", ["square root", "covariance"])
@pytest.mark.parametrize("name", ["ukf", "aasghqf", "nonlinear"])
@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_iterations_are_the_posterior_linearization_filter_written_out(form, name, iterations):
    sim, rule = aasghqf.simulate(replace(A, steps=1), [generator(11, 0, 0)]), scenario.rules()[name]
    epoch, P = next(sim.epochs()), np.diag(sim.config.sigma0**2)
    filter = sigma_point(*scenario.model(sim.config), rule=rule, form=form, iterations=iterations)
    belief = filter.update(filter.start(sim.prior), epoch)[0].belief
    m, C = np.zeros(13), P
    for _ in range(iterations):
        A_, b, Omega = regression(rule, m, C, epoch)
        S = A_ @ P @ A_.T + Omega + epoch.u.sqrt_R**2
        K = np.linalg.solve(S, A_ @ P).T
        m, C = K @ (epoch.z[0] - b), P - K @ S @ K.T
    std = np.sqrt(C.diagonal())
    np.testing.assert_allclose(belief.mean[0] / std, m / std, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(
        belief.cov[0] / np.outer(std, std), C / np.outer(std, std), rtol=0.0, atol=1e-6
    )


def test_the_unscented_filter_sees_the_bend_of_the_stars_in_two_of_six_directions():
    """Its points move one angle at a time. If two angles together bend a star's measurement, the
    filter treats it as linear and as precise.
    """
    sim = aasghqf.simulate(A, study.UNDISTURBED)
    epoch, fine = next(sim.epochs()), tensor_product(gauss_hermite(3, 20), simplex(10))
    noise = epoch.u.sqrt_R.diagonal()[:6]
    for rule, seen in ((scenario.rules()["ukf"], 2), (fine, 6)):
        Omega = regression(rule, np.zeros(13), np.diag(A.sigma0**2), epoch)[2][:6, :6] / np.outer(
            noise, noise
        )
        values = np.linalg.eigvalsh(Omega)
        assert (values > 100.0).sum() == seen  # ten standard deviations of the noise
        np.testing.assert_allclose(values[: 6 - seen], 0.0, atol=1e-6)


def test_three_linearizations_of_the_first_fix_leave_no_filter_overconfident():
    """A linearization about an error of e rad neglects e^2 / 2: 10 deg give 1 deg, 1 deg gives 30
    arcsec, and 30 arcsec gives an error far below the noise.
    """
    config = replace(PRESETS["A-slow"], steps=10)
    sim = aasghqf.simulate(config, [generator(12, 0, r) for r in range(200)])
    epochs, (low, high) = list(sim.epochs()), chi_square_band(13, 200)

    def value(track):
        return nees(track.mean - sim.truth, track.sqrt_cov).mean(-1)[[0, 10]]

    def filter(name, iterations=1):
        return sigma_point(
            *scenario.model(config),
            rule=scenario.rules()[name],
            form="covariance",
            iterations=iterations,
        )

    single, again = (
        run(filter("ukf", iterations), sim.prior, epochs, keep="cov") for iterations in (1, 3)
    )
    closed = run(scenario.filters(config)["triad-ekf"], sim.prior, epochs, keep="cov")
    assert (value(single) > 1.3e4).all()
    for track in (again, closed, iterated_smoother(filter("ukf"), sim.prior, epochs, iterations=3)):
        assert (low < value(track)).all()
        assert (value(track) < high).all()
    for name in ("ukf", "aasghqf", "nonlinear", "ekf"):  # all end where the closed solution begins
        end = run(filter(name, 5), sim.prior, epochs)
        assert np.abs((end.mean - closed.mean) / closed.std).max() < 0.01


def test_of_a_prior_of_45_degrees_iterations_may_end_in_other_angles_but_of_the_same_attitude():
    sim = aasghqf.simulate(
        replace(A, steps=1, misalignment_deg=(45.0,) * 3), [generator(13, 0, r) for r in range(300)]
    )
    filter = sigma_point(
        *scenario.model(sim.config), rule=scenario.rules()["ukf"], form="covariance", iterations=30
    )
    found, true = filter.update(filter.start(sim.prior), next(sim.epochs()))[0].belief, sim.truth[0]
    away = np.abs(found.mean - true)[:, misalignment.PHI].max(-1) > 0.01
    assert 0 < away.sum() < 30
    C, D = (misalignment.misalignment_matrix(x[:, misalignment.PHI]) for x in (found.mean, true))
    assert np.abs(C - D).max() < 6.0 * np.radians(sim.config.star_arcsec / 3600.0)


# -- six states ------------------------------------------------------------------------------------
def test_six_states_are_those_of_the_error_model_without_the_others():
    """The filter with six states equals the filter with 13 states if the other seven states have no
    error and do not move.
    """
    config = replace(study.SIX, steps=8)
    sim, known, prior = scenario.six_states(config, [generator(7, 0, r) for r in range(3)])
    six = list(scenario.SIX)
    assert not np.delete(sim.truth, six, axis=-1).any()
    assert np.ptp(sim.truth[..., misalignment.PHI], axis=0).all()

    def held(x, epoch):
        moved = x + epoch.dt * misalignment.derivative(x, epoch.u.interval)
        return np.where(np.isin(range(13), six), moved, 0.0)

    kept = np.isin(range(13), six)
    motion = Motion(held, sqrt_Q=config.sqrt_Q * kept[:, None])
    start = Gaussian(sim.prior.mean, np.diag(np.where(kept, config.sigma0**2, 1e-30)))
    for name, rule in (("ekf", scenario.rules()["ekf"]), ("sghqf", scenario.rules()["sghqf"])):
        wide = sigma_point(motion, scenario.model(config)[1], rule=rule, form="covariance")
        one = run(known[name], prior, sim.epochs())
        two = run(wide, start, sim.epochs())
        assert np.abs((one.mean - two.mean[..., six]) / one.std).max() < 1e-3, name


def test_times_to_a_tenth_and_what_three_conditions_make(results):
    error = np.array([[2.0, 0.5, 3.0], [0.9, 0.1, 3.0], [0.5, 2.0, 3.0]])[..., None] * [
        1.0,
        0.0,
        0.0,
    ]
    fake = replace(results, data={"p": {"f/error": error, "start": np.full((1, 3), 10.0)}})
    np.testing.assert_array_equal(study.tenth(fake, "p", "f"), [5.0, 0.0, 15.0])
    row = next(row for row in study.ROWS if row.id.startswith("sghqf-beats"))

    def verdict(ekf, ukf, ghqf, operations=1.0):
        """RMSE of the filters over the RMSE of SGHQF, constant over time; half of the filters are
        at once below a tenth of the initial error.
        """
        noise = np.random.default_rng(0).uniform(0.9, 1.1, (3, 40, 3))
        sizes = {"sghqf": 1.0, "ekf": ekf, "ukf": ukf, "ghqf": ghqf}
        shared = {f"{name}/error": size * noise for name, size in sizes.items()}
        shared["start"] = 17.3 * np.linspace(0.9, 1.6, 40)[None]
        counts = {"six/sghqf": np.array([operations]), "six/ghqf": np.array([2.0])}
        data = {"six states": shared, "tensor": shared, "operations": counts}
        return row.judged(replace(results, data=data)).verdict

    assert verdict(2.0, 3.0, 1.0) == "reproduced"
    assert verdict(0.5, 3.0, 1.0) == "in part"
    assert verdict(2.0, 3.0, 0.9) == "in part"
    assert verdict(2.0, 3.0, 1.0, 3.0) == "in part"
    assert verdict(0.5, 3.0, 0.9) == "not reproduced"


def test_one_filter_that_is_better_everywhere_is_better_in_part(results):
    row = next(row for row in study.ROWS if row.id == "better-than-ukf")
    rng = np.random.default_rng(1)

    def verdict(sghqf, aasghqf):
        noise = rng.uniform(0.9, 1.1, (3, 40, 7))
        sizes = {"ukf": 1.0, "sghqf": sghqf, "nonlinear": sghqf, "aasghqf": aasghqf}
        errors = {f"{name}/error": size * noise for name, size in sizes.items()}
        parts = dict.fromkeys([*PRESETS, study.MANY], errors)
        return row.judged(replace(results, data=parts)).verdict

    assert [verdict(*pair) for pair in ((0.5, 0.5), (0.5, 2.0), (2.0, 0.5))] == [
        "reproduced",
        "in part",
        "not reproduced",
    ]


# -- bad input -------------------------------------------------------------------------------------
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
