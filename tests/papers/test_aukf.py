"""The BeiDou paper: its track, its sky, and filters that are the same where they must be."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import hatanaka
import numpy as np
import pytest
import rerun as rr

from celnav import Gaussian, Motion, Sensor, ekf, run, sigma_point
from celnav.files import Outputs
from celnav.filters.adaptive import innovation_window
from celnav.filters.records import State
from celnav.gaussian.rules import unscented
from celnav.models import pseudorange
from celnav.papers import aukf, figures, tables
from celnav.papers.aukf import PRESETS, analysis, errata, filters, real, simulate, sweeps
from celnav.papers.aukf.constellation import elements, kepler
from celnav.papers.aukf.follow import Kept, follow_cases, watched
from celnav.papers.aukf.follow import follow as follow_all
from celnav.papers.aukf.scenario import EKF, adapted, axes, circle, sensor, ukf, visible
from celnav.receiver.filters import hooks
from celnav.receiver.sky import dilution
from celnav.study.claims import dumps
from celnav.study.montecarlo import effort, generator

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
    dop = dilution(seen.q, position, axes(config))
    for value, near in zip(dop, (1.78, 1.55, 0.73, 1.36, 0.88), strict=True):
        assert np.median(value) == pytest.approx(near, abs=0.02)


def follow(sim, names):
    known = filters(sim.config)
    return {n: run(known[n], sim.prior, sim.epochs(), keep="mean").mean - sim.truth for n in names}


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
    drawn = sigma_point(Motion(lambda x, _e: x @ SHORT.F.T, SHORT.Q), sensor(np.repeat([3.0, 0.1], S)), rule=rule)
    one, two = (run(f, sim.prior, sim.epochs(), keep="mean").mean for f in (drawn, adapted(SHORT, S, rule)))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "name"),
    [({"interval_s": 0.0}, "interval_s"), ({"burst": "some"}, "burst"), ({"window": 0}, "window"), ({"runs": 1.5}, "runs"),
     ({"sigma_range_m": np.nan}, "sigma_range_m"), ({"alpha": None}, "alpha"), ({"deviation": (1.0, 1.0, 1.0, 0.0)}, "deviation"),
     ({"clock_walk_m2_per_s3": -1.0}, "clock_walk_m2_per_s3"), ({"burst_s": (70.0, 60.0)}, "burst_s"),
     ({"mask_deg": 90.0}, "mask_deg"),
     ({"latitude_deg": 100.0}, "latitude_deg"), ({"burst_satellite": -1}, "burst_satellite"),
     ({"burst_satellite": 2.5}, "burst_satellite"),
     ({"acceleration_noise_m2_per_s3": -1.0}, "acceleration_noise_m2_per_s3")],
)  # fmt: skip
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(PRESETS["burst"], **change)


def test_a_satellite_that_is_not_there_is_told():
    with pytest.raises(ValueError, match=r"^burst_satellite: expected a place below 15"):
        simulate(replace(SHORT, burst="one", burst_satellite=20), runs(1))


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
    found = follow_all({"aukf": adapted(SHORT, S, unscented(8), hook)}, sim, Kept(nis=("aukf",), nees=("aukf",), factor=("aukf",)))
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
    sim = sim._replace(prior=Gaussian(sim.truth[0], sim.prior.cov))
    track = run(filters(config)["ekf"], sim.prior, sim.epochs())
    np.testing.assert_allclose(track.std[:, 0], np.sqrt(sweeps.bound(sim)), rtol=1e-4)


def test_cases_side_by_side_are_cases_alone():
    cases = {case: simulate(replace(SHORT, burst=case), runs(2)) for case in ("none", "ranges")}
    known = filters(SHORT)
    chosen = {"aukf": known["aukf"], "student": known["student"]}
    kept = Kept(nis=("aukf",), nees=("aukf",), cov=("aukf",))
    together = follow_cases(chosen, cases, kept)
    for case, sim in cases.items():
        for key, values in follow_all(chosen, sim, kept).items():
            np.testing.assert_allclose(together[f"{case}/{key}"], values, rtol=1e-6, atol=1e-6, err_msg=key)


def test_a_process_noise_of_each_run_is_that_of_the_run_alone():
    sim, S = simulate(SHORT, runs(1)), len(visible(SHORT).names)
    Q = [replace(SHORT, acceleration_noise_m2_per_s3=q).Q for q in (1.0, 100.0)]
    both = follow_cases({"f": adapted(SHORT, S, EKF, Q=np.stack(Q))}, {"1": sim, "100": sim})
    for name, one in zip(("1", "100"), Q, strict=True):
        alone = follow_all({"f": adapted(SHORT, S, EKF, Q=one)}, sim)["f/error"]
        np.testing.assert_allclose(both[f"{name}/f/error"], alone, rtol=0, atol=1e-7)


@pytest.mark.parametrize("alpha", [1.0, 0.1])
def test_a_linear_measurement_makes_all_of_them_the_textbooks_filter(alpha):
    sim, S = simulate(replace(SHORT, duration_s=1.0), runs(2)), len(visible(SHORT).names)
    H = pseudorange.jacobian(sim.truth[0, 0], sim.satellites.q[0], sim.satellites.w[0])
    R = np.diag(np.square(np.repeat([SHORT.sigma_range_m, SHORT.sigma_rate_m_per_s], S)))
    rng = np.random.default_rng(0)
    truth = sim.truth - sim.truth[0, :1]  # about the start, so that round-off is of meters
    z = truth @ H.T + rng.normal(size=(*truth.shape[:2], 2 * S)) @ np.sqrt(R)
    start = sim.prior.mean - sim.truth[0, :1]
    F, Q = SHORT.F, SHORT.Q
    means = {}
    motion, seen = (
        Motion(lambda x, _e: x @ F.T, Q, jacobian=lambda _x, _e: F),
        Sensor(lambda x, _e: x @ H.T, R, jacobian=lambda _x, _e: H),
    )
    known = {
        "ukf": sigma_point(motion, seen, rule=unscented(8, alpha, 2.0, 0.0), form="covariance"),
        "ekf": ekf(motion, seen, form="covariance"),
    }
    for name, f in known.items():
        when = [e._replace(z=v) for e, v in zip(sim.epochs(), z, strict=True)]
        means[name] = run(f, Gaussian(start, sim.prior.cov), when).mean
    x, P, book = start.copy(), SHORT.P0, []
    for k, measured in enumerate(z):
        if k:
            x, P = x @ F.T, F @ P @ F.T + Q
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        x, P = x + (measured - x @ H.T) @ K.T, P - K @ H @ P
        book.append(x)
    for name, mean in means.items():
        np.testing.assert_allclose(mean, book, rtol=0, atol=1e-9, err_msg=name)


def test_without_satellites_it_is_a_prediction():
    """One of two runs is blind: the hooks see both."""
    sim = simulate(replace(SHORT, duration_s=1.0), runs(2))
    z = sim.z.copy()
    z[:, 0] = np.nan
    blind, S = sim._replace(z=z), len(sim.satellites.names)
    for hook in (innovation_window(3), *(h[0] for name, h in hooks(S).items() if name not in ("ukf", "aukf"))):
        error, seeing = (follow_all({"f": adapted(SHORT, S, ukf(SHORT), hook)}, s)["f/error"] for s in (blind, sim))
        moved = blind.prior.mean[0] @ np.linalg.matrix_power(SHORT.F, 10).T - blind.truth[10, 0]
        np.testing.assert_allclose(error[10, 0], moved, rtol=0, atol=1e-6)
        np.testing.assert_allclose(error[:, 1], seeing[:, 1], rtol=0, atol=1e-6)


def test_the_smallest_window_takes_each_innovation_for_itself():
    sim, S = simulate(replace(SHORT, duration_s=1.0), runs(1)), len(visible(SHORT).names)
    filter = adapted(SHORT, S, ukf(SHORT), watched(innovation_window(1)))
    R, plain = SHORT.sigma(S) ** 2, adapted(SHORT, S, ukf(SHORT))
    state = filter.start(sim.prior)
    for epoch in sim.epochs():
        _, (info,) = plain.step(State(state.belief, (None,)), epoch)
        prior = (info.sqrt_S @ info.sqrt_S.mT).diagonal(0, -2, -1) - R
        state, _ = filter.step(state, epoch)
        np.testing.assert_allclose(state.memory[0][0][1], np.maximum(1.0, (info.innovation**2 - prior) / R), rtol=1e-6)


# -- what needs no filters -----------------------------------------------------------------------------------------------------
def test_the_node_of_a_flat_orbit_is_lost():
    found = analysis.nodes(generator(0, 50, 0))
    np.testing.assert_allclose(found.drawn[:3], found.formula[:3], rtol=0.01)
    np.testing.assert_allclose(found.formula[[0, 2, 4]], [0.00699, 0.328, 32.8], rtol=0.01)


def test_the_unscented_transform_of_polar_coordinates():
    m = analysis.polar(generator(0, 51, 0), 100_000)
    assert m.exact_mean[1] == pytest.approx(np.exp(-0.5 * np.radians(15.0) ** 2), abs=1e-12)
    np.testing.assert_allclose(m.unscented_mean, m.exact_mean, atol=1e-4)
    np.testing.assert_allclose(m.unscented_std, [0.2529, 0.0517], atol=1e-4)


def test_the_geometry_is_exact():
    g = analysis.geometry(PRESETS["burst"])
    assert (len(g.names), g.geostationary, g.inclined) == (15, 5, 3)
    assert g.rate_error < 5e-6
    assert 40.0 < g.turn_m < 50.0
    assert analysis.geometry(replace(PRESETS["burst"], mask_deg=30.0)).geostationary < 5
    assert g.misplaced_m.min() > 6e5


def test_an_absent_receiver_is_absent_and_a_folder_without_files_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert real.real(PRESETS["burst"], generator(0, 60, 0)) is None
    with pytest.raises(FileNotFoundError, match="expected a RINEX observation file"):
        aukf.reproduce(effort=0.01, rinex=tmp_path)


# -- the study -----------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def result():
    return aukf.reproduce(effort=effort())


def test_every_figure_draws(result):
    drawn = {name: function(result) for name, function in figures(aukf).items()}
    assert list(drawn)[:3] == ["figure_01", "figure_02", "figure_03"]
    assert len(drawn) == 17
    for fig in drawn.values():
        assert any(ax.get_xlabel() or ax.get_title() or ax.texts for ax in fig.axes)


def test_tables(result):
    rows = {name: function(result) for name, function in tables(aukf).items()}
    assert len(rows) == 8
    assert [row["filter"] for row in rows["table_1"]] == ["LS", "EKF", "UKF", "AUKF", "UKF", "AUKF"]
    assert rows["table_1"][0]["X (m)"] > rows["table_1"][1]["X (m)"]
    assert len(rows["table_2"]) == 40
    assert rows["table_8"] == [{"filter": "input absent", "RMS (m)": "", "RMS with an added burst (m)": ""}]


LENGTHY = ("process-", "start-", "erratum-1", "erratum-5")


def test_claims_are_plain_json_and_exact_ones_hold_at_any_effort(result):
    listed = json.loads(dumps(aukf.claims(result)))
    assert {c["kind"] for c in listed} == {"paper", "calibrated", "erratum", "beyond"}
    found = {c["id"]: c for c in listed}
    for id, c in found.items():
        if c["ci"] is None and not id.startswith((*LENGTHY, "real-")):
            assert c["holds"] == c["expected"], (id, c["value"], c["accept"])
    assert {c["verdict"] for id, c in found.items() if id.startswith("real-")} == {"input absent"}
    assert found["erratum-3-same"]["verdict"] == "paper in error"
    assert result.full or found["figure-7-burst"]["verdict"] == "undecided"


def test_every_erratum_has_its_number(result):
    numbers = {int(c.id.split("-")[1]) for c in aukf.claims(result) if c.id.startswith("erratum-")}
    assert numbers == set(range(1, len(aukf.ERRATA) + 1))


def test_a_recording_of_the_burst_is_written_and_none_of_an_absent_receiver(result, tmp_path):
    assert aukf.record(result, Outputs(tmp_path)) == ["aukf_burst.rrd"]
    (found,) = rr.chunk.RrdReader(tmp_path / "aukf_burst.rrd").recordings()
    assert found.application_id == "celnav-aukf-burst"
    drawn = {str(c.entity_path) for c in rr.chunk.RrdReader(tmp_path / "aukf_burst.rrd").stream().to_chunks() if not c.is_static}
    assert {"/world/sight", "/track/aukf/ellipsoid", "/error/group/estimate", "/plots/consistency/nis/ekf", "/events"} <= drawn
    assert "/error/ls/ellipsoid" not in drawn  # it has no covariance
    assert not (tmp_path / "aukf_real.rrd").exists()


REAL = Path(__file__).parents[3] / "shared" / "data" / "rinex"


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_a_real_receiver(result, tmp_path):
    """The first two hours of its day; `celnav reproduce --rinex` takes twelve."""
    text = hatanaka.decompress(next(REAL.glob("*MO.crx.gz")).read_bytes()).decode("ascii")
    (tmp_path / "ESBC_MO.rnx").write_text(text[: text.index("> 2020 06 25 02 00")], encoding="ascii")
    shutil.copy(next(REAL.glob("*MN.rnx.gz")), tmp_path)
    day = real.real(PRESETS["burst"], generator(0, 60, 0), tmp_path)
    listed = {c.id: c for c in aukf.claims(replace(result, real=day)) if c.id.startswith("real-")}
    assert len(listed) == 10
    assert all(c.holds for c in listed.values()), {id: c.value for id, c in listed.items()}
    assert [row["filter"] for row in tables(aukf)["table_8"](replace(result, real=day))] == [
        "LS",
        "EKF",
        "UKF",
        "AUKF",
        "group parity",
    ]
    assert aukf.record(replace(result, real=day), Outputs(tmp_path / "out")) == aukf.RECORDINGS


def test_elements_of_a_place_and_a_velocity_are_those_it_was_made_from():
    found = elements(*kepler(a=2.8e7, e=0.01, i=0.96, Omega=1.1, omega=0.4, M=2.2))
    np.testing.assert_allclose(found, [2.8e7, 0.01, 0.96, 1.1, 0.4, 2.2], rtol=1e-12)
