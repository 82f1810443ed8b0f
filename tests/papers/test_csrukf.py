"""The study of csrukf: contract, exactness, independence of blocks, and the ledger."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import rerun as rr
from once import once
from readable import faults
from scipy.linalg import block_diag

from celnav.files import Outputs
from celnav.filters.run import run
from celnav.models import orbit
from celnav.papers import csrukf
from celnav.papers.csrukf import scenario, study
from celnav.papers.csrukf.method import FORMS
from celnav.study.ledger import Row
from celnav.study.montecarlo import generator
from celnav.study.study import Part

SHORT = replace(csrukf.PRESETS["P"], steps=40)
STATEMENTS = """white-alike table-1-levels srukf-diverges csrukf-converges csrukf-far-better table-2-levels little-change
larger-phi-worse srukf-changes-more better-at-both table-3-levels square-roots-stabilize
geometry-fixes-position whitened-and-optimal"""
PRINTED = """
0.0355 0.0321 0.0356 0.0338 0.0343 0.0384
0.0340 0.0356 0.0363 0.0382 0.0349 0.0359
2.7618 5.4616 3.7964 1.3072 2.4412 2.6518
0.4071 0.1994 0.1565 0.2672 0.2743 0.1969
17.346 19.323 18.184 5.6096 5.2659 5.0236
0.4218 0.2694 0.6928 0.3623 0.3979 0.4783
40.373 34.767 31.659 10.281 10.479 11.694
0.6935 0.5870 0.9375 0.8720 0.6347 0.6273
"""
"""Tables 1, 2 and 3 as printed in the paper."""


@pytest.fixture(scope="module")
def results():
    return once(csrukf.STUDY)


@pytest.fixture(scope="module")
def claims(results):
    return {claim.id: claim for claim in results.claims()}


def test_every_figure_draws_what_its_axes_say(results):
    assert list(csrukf.FIGURES) == [f"figure_{i:02d}" for i in range(1, 20)]
    for number, (caption, draw) in enumerate(csrukf.FIGURES.values(), 1):
        fig = draw(results)
        beyond = " (not in the paper)" if number > 13 else ""
        assert fig.get_suptitle().startswith(f"Figure {number}{beyond}: ")
        axes = [ax for ax in fig.axes if ax.axison]
        labels = [label for ax in axes for label in (ax.get_xlabel(), ax.get_ylabel()) if label]
        assert number == 1 or all("(" in label for label in labels), (number, labels)
        assert caption.endswith(".")
        assert not faults(fig), number


def test_figure_2_draws_the_errors_of_the_first_run(results):
    many, minute = csrukf.FIGURES["figure_02"][1](results).axes

    def error(filter):
        return np.abs(results.error("0", filter, "position")[:, 0, 0])

    np.testing.assert_array_equal(many.lines[0].get_ydata(), error("csrukf"))
    for line, filter in zip(minute.lines, ("srukf", "csrukf", "lagged"), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), error(filter)[-61:])
    # As printed, an estimate has used the next sample: it is of the epoch before.
    assert [line.get_xdata()[-1] for line in minute.lines] == [600.0, 600.0, 599.0]


def test_figure_5_has_the_printed_rmse_with_both_signs(results):
    many, _ = csrukf.FIGURES["figure_05"][1](results).axes
    printed = [line.get_ydata()[0] for line in many.lines if line.get_linestyle() == "--"]
    values = [row[3] for row in (study.TABLE_1["SRUKF"], study.TABLE_1["CSRUKF"])]
    assert sorted(printed) == sorted([*values, *np.negative(values)])


def test_figure_19_has_a_row_for_each_form(results):
    for ax, precision in zip(
        csrukf.FIGURES["figure_19"][1](results).axes[:2], ("double", "single"), strict=True
    ):
        lost, apart = (
            np.stack(
                [
                    results.get("forms/ratios", f"{form}, {precision}/{what}").mean(1)
                    for form in FORMS
                ]
            )
            for what in ("lost", "apart")
        )
        np.testing.assert_array_equal(np.ma.filled(ax.collections[0].get_array(), np.nan), apart)
        assert len(ax.lines[0].get_xdata()) == (lost > 0.0).sum() > 0
        names = [label.get_text() for label in ax.get_yticklabels()]
        assert names == list(FORMS.values())


def test_tables_hold_the_papers_numbers_verbatim(results):
    wanted = [[float(part) for part in line.split()] for line in PRINTED.split("\n") if line]
    printed = [
        row
        for _, table in csrukf.TABLES.values()
        for row in table(results)
        if row["source"] == "paper"
    ]
    assert [[v for v in row.values() if isinstance(v, float)] for row in printed] == wanted
    assert [len(table(results)) for _, table in csrukf.TABLES.values()] == [6, 6, 12]


def test_what_changes_little_is_printed_as_in_the_tables(claims):
    rows = {"Table 1": study.TABLE_1["CSRUKF"], "Table 2": study.TABLE_2["CSRUKF"]}
    assert claims["little-change"].row.printed == rows


def test_the_ledger_has_every_statement_of_the_paper_and_says_why(claims):
    statements = {id: claim for id, claim in claims.items() if claim.kind == "statement"}
    assert list(statements) == STATEMENTS.split()
    for claim in statements.values():
        assert claim.row.place
        assert claim.row.why
        assert claim.row.found
    kinds = [claim.kind for claim in claims.values()]
    assert kinds.count("finding") <= 10
    assert kinds.count("check") <= 50


def test_few_runs_leave_rows_undecided_rather_than_wrong(claims):
    assert sum(claim.verdict == "undecided" for claim in claims.values()) > 10
    assert sum(claim.surprise for claim in claims.values()) <= 0.1 * len(claims)  # 95 % intervals


def test_only_statements_are_called_reproduced(claims):
    assert all(
        "reproduced" not in claim.verdict for claim in claims.values() if claim.kind != "statement"
    )


def test_the_block_size_changes_nothing():
    def flown(block):
        part = Part(study.parts()["stress/I"].work, replace(SHORT, phi=1.0), 6, 5, block)
        return replace(csrukf.STUDY, parts=lambda effort: {"x": part}).reproduce(seed=2).data["x"]

    one, two = flown(5), flown(2)
    for name in set(one) - {"cpu_s"}:
        a, b = one[name], two[name]
        if name.endswith("/cov"):  # of the first run of each block
            a, b = a[:, :1], b[:, :1]
        np.testing.assert_array_equal(a, b)


def test_a_run_does_not_depend_on_how_many_there_are():
    three = scenario.simulate(SHORT, [generator(5, 0, r) for r in range(3)])
    one = scenario.simulate(SHORT, [generator(5, 0, 2)])
    np.testing.assert_array_equal(three.z[:, 2], one.z[:, 0])
    np.testing.assert_array_equal(three.prior.mean[2], one.prior.mean[0])


def test_the_nominal_orbit_has_the_check_values():
    end = csrukf.PRESETS["P"].nominal()[-1]
    np.testing.assert_allclose(
        end, [1128.513522, 3832.733730, 5905.955241, -6.558624, -2.301214, 2.751041], atol=2e-6
    )


def test_linear_theory_has_the_values_of_an_independent_prototype():
    expected = study.expected(csrukf.PRESETS["P"], (0.0, 0.8, 1.0))
    np.testing.assert_allclose(
        expected["srukf"][-1, 1], [0.1295, 0.1297, 0.1298, 0.0477, 0.0516, 0.0542], atol=6e-5
    )
    np.testing.assert_allclose(
        expected["csrukf"][-1, 2], [0.2346, 0.2475, 0.2501, 0.1400, 0.1816, 0.2045], atol=6e-5
    )


@pytest.mark.parametrize(("preset", "averaged"), [("P", False), ("B", True)])
def test_tables_1_and_2_come_out_together(preset, averaged):
    """RMS factor over eight lengths, position and velocity of two filters, from linear theory: the
    quantity to which P and B were fitted.
    """
    expected, logs = study.expected(csrukf.PRESETS[preset], (0.0, 1.0)), []
    for i, table in enumerate((study.TABLE_1, study.TABLE_2)):
        for filter, printed in table.items():
            std = expected[filter.lower()][1 if averaged else -1 :, i]
            ours = np.sqrt(np.square(std).mean(0))
            logs += [
                np.log(np.linalg.norm(ours[part]) / np.linalg.norm(printed[part]))
                for part in (slice(0, 3), slice(3, 6))
            ]
    assert np.exp(np.sqrt(np.mean(np.square(logs)))) < 1.2


def test_monte_carlo_follows_linear_theory_within_its_scatter():
    many = replace(csrukf.PRESETS["P"], steps=60, phi=1.0)
    sim, expected = (
        scenario.simulate(many, [generator(0, 0, r) for r in range(300)]),
        study.expected(many, (1.0,)),
    )
    for name, std in expected.items():
        track = run(scenario.filters(many)[name], sim.prior, sim.epochs(name))
        rmse = np.sqrt(np.square((track.mean[-1] - sim.truth[-1]) * study.UNITS).mean(0))
        np.testing.assert_allclose(rmse / std[-1, 0], 1.0, atol=5.0 / np.sqrt(600))


def conditioned(F, H, Phi, Q, R, P0, Sigma0):
    """Covariances of the last state of a linear system given all measurements, and given only their
    differences, by conditioning the joint of all variables, written out.
    """
    T, n = len(F), len(P0)
    roots = [P0, *[Q] * T, Sigma0, *[R] * T]
    draws = block_diag(*(np.linalg.cholesky(root) for root in roots))
    x, *w = np.split(draws[: n * (T + 1)], T + 1)
    V, *zeta = np.split(draws[n * (T + 1) :], T + 1)
    z = [H @ x + V]
    for f, process, increment in zip(F, w, zeta, strict=True):
        x, V = f @ x + process, Phi @ V + increment
        z.append(H @ x + V)
    differences = [later - Phi @ before for before, later in pairwise(z)]
    for samples in (np.concatenate(z), np.concatenate(differences)):
        U = x @ samples.T
        yield x @ x.T - U @ np.linalg.solve(samples @ samples.T, U.T)


@pytest.mark.parametrize("phi", [0.0, 0.8, 1.0])
def test_the_bound_of_all_measurements_is_below_that_of_their_differences(phi):
    """CSRUKF attains the second bound. A filter that uses the samples themselves, such as SRUKF, is
    limited only by the first.
    """
    config = replace(csrukf.PRESETS["P"], steps=12)
    F, Phi = orbit.transition(config.nominal()[:-1], config.step_s), phi * np.eye(3)
    Q, P0 = (np.square(root) for root in (config.sqrt_Q, config.sqrt_P0))  # both are diagonal
    exact = conditioned(F, scenario.H, Phi, Q, config.R, P0, config.R)
    expected = study.expected(config, (phi,))
    stds = [np.sqrt(cov.diagonal()) * study.UNITS for cov in exact]
    for name, std in zip(("csrukf+z0", "csrukf"), stds, strict=True):
        np.testing.assert_allclose(expected[name][-1, 0], std, rtol=1e-6)
    assert (stds[1][:3] > stds[0][:3]).all()


def test_no_filter_of_any_setting_is_better_than_any_filter():
    """SRUKF is one of these filters. It is better than the bound from
    differences in many settings.
    """
    gain = study.settings(50, csrukf.PRESETS["P"], [generator(0, 20, 0)])["gain"]
    assert (gain >= 1.0).all()


def test_the_filter_is_compared_with_the_bound_of_all_measurements(results):
    config = replace(csrukf.PRESETS["P"], steps=12)
    theory = {f"P/{name}": std for name, std in study.expected(config, study.SWEEP).items()}
    error = np.random.default_rng(0).standard_normal((1, 40, 6))
    parts = {"theory": theory, "I, many": {"csrukf/error": error}}
    number = study.over_theory("I")(replace(results, data=parts))
    F, Phi = orbit.transition(config.nominal()[:-1], config.step_s), np.eye(3)
    Q, P0 = (np.square(root) for root in (config.sqrt_Q, config.sqrt_P0))
    everything, _ = conditioned(F, scenario.H, Phi, Q, config.R, P0, config.R)
    square = np.square(error[0, :, :3]).sum(-1).mean()
    assert number.value == pytest.approx(np.sqrt(square / np.trace(everything[:3, :3])), rel=1e-6)


def test_filters_coincide_where_they_must():
    config = replace(SHORT, phi=0.8)
    sim = scenario.simulate(config, [generator(1, 1, r) for r in range(4)])
    known = scenario.filters(config) | {"single": scenario.assuming(config, config.R)}
    mean = {
        name: run(known[name], sim.prior, sim.epochs()).mean[..., :6]
        for name in ("csrukf+z0", "augmented", "csrukf", "single")
    }
    assert np.abs(mean["csrukf+z0"] - mean["augmented"]).max() < 1e-7
    assert np.abs(mean["csrukf"] - mean["single"]).max() < 1e-6


def test_srukf_is_filterpys_ukf():
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    from celnav.models import orbit

    sim = scenario.simulate(SHORT, [generator(0, 0, 0)])
    points = MerweScaledSigmaPoints(6, SHORT.alpha, SHORT.beta, SHORT.kappa)
    ukf = UnscentedKalmanFilter(
        6, 3, SHORT.step_s, lambda x: x[:3], lambda x, dt: orbit.step(x, dt), points
    )
    ukf.x, ukf.P = np.array(sim.prior.mean[0]), np.array(sim.prior.cov)
    ukf.Q, ukf.R = SHORT.sqrt_Q @ SHORT.sqrt_Q.T, SHORT.R
    means = [ukf.x]
    for z in sim.z[1:, 0]:
        ukf.predict()
        ukf.update(z)
        means.append(ukf.x)
    track = run(scenario.filters(SHORT)["srukf"], sim.prior, sim.epochs("srukf"))
    assert np.abs(track.mean[:, 0, :3] - np.array(means)[:, :3]).max() < 1e-8


def test_the_lagged_estimate_is_that_of_the_epoch_before():
    config = replace(SHORT, phi=0.8)
    sim = scenario.simulate(config, [generator(1, 1, 0)])
    late = run(study.variants(config)["lagged"], sim.prior, sim.epochs("lagged"), keep="mean").mean[
        :, 0
    ]
    own = run(scenario.filters(config)["csrukf"], sim.prior, sim.epochs(), keep="mean").mean[:, 0]
    assert 0.0 < np.abs(late[2:] - own[1:-1])[:, :3].max() < 0.1
    assert [float(e.truth[0, 0]) for e in sim.epochs("lagged")][1:] == sim.truth[:-1, 0, 0].tolist()


def test_reused_points_are_wrong_and_redrawn_ones_right():
    found = study.redrawn(SHORT, [np.random.default_rng(4)])
    assert found["reused"].max() > 0.01
    assert found["redrawn"].max() < 1e-12


def test_the_whitened_system_is_exact_once_corrected():
    found = study.linear(SHORT, [np.random.default_rng(4)])
    assert found["cross"].max() < 1e-12
    assert found["corrected"].max() < 1e-10
    assert found["first sample lost"].max() > 0.1


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


@pytest.mark.parametrize(
    ("first", "factor"), [("R", 1.0), ("zero", 0.0), ("stationary", 1.0 / 0.36), (None, 1.0)]
)
@pytest.mark.parametrize("measured", ["positions", "angles"])
def test_the_first_noise_is_what_is_chosen(first, factor, measured):
    config = replace(csrukf.Config(), phi=0.8, first_noise=first, measured=measured)
    np.testing.assert_allclose(config.Sigma0, factor * config.R, rtol=1e-12)


def test_recordings_hold_the_first_run_and_the_monte_carlo(results, tmp_path):
    assert csrukf.record(results, Outputs(tmp_path)) == csrukf.RECORDINGS
    assert {p.name for p in tmp_path.glob("*.rrd")} == set(csrukf.RECORDINGS)
    chunks = rr.chunk.RrdReader(tmp_path / "csrukf_P_08.rrd").stream().to_chunks()
    found = {str(c.entity_path): c for c in chunks if not c.is_static}
    error = np.array(found["/state/csrukf"].to_record_batch().column("error").to_pylist())
    np.testing.assert_allclose(error[:, :3], results.error("0.8", "csrukf", "position")[:, 0])
    rmse = (
        found["/plots/rmse/position/srukf"].to_record_batch().column("Scalars:scalars").to_pylist()
    )
    wanted = np.sqrt(np.square(results.error("0.8", "srukf", "position")).sum(-1).mean(1))
    np.testing.assert_allclose(10.0 ** np.ravel(rmse), wanted)
    drawn = {
        "/world/limb",
        "/world/stars/i2",
        "/world/angles",
        "/world/z",
        "/error/openloop/ellipsoid",
        "/plots/V/x/augmented",
    }
    assert drawn <= set(found)


def test_rows_are_data():
    assert all(isinstance(row, Row) for row in csrukf.STUDY.rows)
    assert len({row.id for row in csrukf.STUDY.rows}) == len(csrukf.STUDY.rows)
