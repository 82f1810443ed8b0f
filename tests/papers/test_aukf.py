"""The BeiDou paper: its track, its sky, and filters that must agree."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
from once import once
from readable import faults
from rinex_pair import TOE, constellation, navigation, observations, written
from scipy.special import gammaincc, gammaln

from celnav import Gaussian, Motion, Sensor, ekf, imm, run, sigma_point
from celnav.analysis.metrics import bootstrap, ratio
from celnav.files import Outputs
from celnav.filters.adaptive import innovation_window
from celnav.filters.records import State
from celnav.filters.run import ENGINE
from celnav.gaussian.belief import nees
from celnav.gaussian.rules import Taylor, unscented
from celnav.models import pseudorange
from celnav.papers import aukf
from celnav.papers.aukf import PRESETS, filters, scenario, show, simulate, study
from celnav.papers.aukf.scenario import adapted, axes, circle, noise_factors, ukf, visible
from celnav.receiver import day
from celnav.receiver.filters import hooks
from celnav.receiver.sky import dilution
from celnav.show.claims import dumps
from celnav.study.ledger import Number
from celnav.study.montecarlo import generator
from celnav.study.numbers import count_holding
from celnav.study.operations import step_operations
from celnav.study.study import Results

SHORT = replace(PRESETS["burst"], duration_s=4.0, burst_s=(2.0, 3.0))


def runs(count, study=0):
    return [generator(0, study, r) for r in range(count)]


def test_the_track_is_a_circle_of_four_g():
    config = PRESETS["burst"]
    position, velocity = circle(config)
    east, north, _ = axes(config) @ velocity.T
    heading = np.unwrap(np.arctan2(north, east))
    assert 90.0 / (heading[-1] - heading[0]) == pytest.approx(64.0707 / (2.0 * np.pi), rel=1e-6)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 400.0)
    difference = (position[2:] - position[:-2]) / (2.0 * config.interval_s)
    np.testing.assert_allclose(difference, velocity[1:-1], atol=0.01)
    assert np.ptp(position @ axes(config)[2]) < 1e-6  # level


def test_a_turn_is_the_circle_between_its_tangents():
    whole, config = PRESETS["burst"], replace(PRESETS["burst"], turn_s=(20.0, 40.0))
    (position, velocity), turn = circle(config), slice(200, 401)
    for part, of_circle in zip((position, velocity), circle(whole), strict=True):
        np.testing.assert_allclose(part[turn], of_circle[turn], rtol=0.0, atol=1e-8)
    for straight in (slice(0, 201), slice(400, None)):
        np.testing.assert_array_equal(
            velocity[straight], np.broadcast_to(velocity[straight][0], velocity[straight].shape)
        )
    np.testing.assert_allclose(
        np.diff(position, axis=0), 0.05 * (velocity[1:] + velocity[:-1]), rtol=0.0, atol=1e-3
    )
    np.testing.assert_array_equal(circle(replace(whole, turn_s=(-5.0, 90.0)))[0], circle(whole)[0])


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


def test_models_that_take_turns_tell_a_maneuver_from_noise():
    """As in the notebook on methods, but shorter: a turn from 4 to 8 s, and a noise burst from 11
    to 13 s in straight flight.

    The window treats the turn as noise if the process noise does not cover it, and is less accurate
    in straight flight if it does. An IMM with two process noises avoids both, but has no model of
    the burst; with a second noise of the ranges it has one.
    """
    turning = replace(PRESETS["burst"], turn_s=(4.0, 8.0), burst_s=(11.0, 13.0), duration_s=13.0)
    straight, sim = (
        replace(turning, acceleration_noise_m2_per_s3=0.01),
        simulate(turning, runs(8, 82)),
    )
    S, rule, window = len(sim.satellites.names), ukf(turning), innovation_window(10)
    calm, loud = (
        [adapted(replace(c, sigma_range_m=sigma), S, rule) for c in (straight, turning)]
        for sigma in (3.0, 50.0)
    )
    turns = np.array([[0.99, 0.01], [0.01, 0.99]])
    known = {
        "straight": calm[0],
        "turn": calm[1],
        "imm": imm(calm, turns),
        "both": imm([*calm, *loud], np.kron(turns, turns)),
        "straight, window": adapted(straight, S, rule, window),
        "turn, window": adapted(turning, S, rule, window),
    }
    also = {
        name: lambda _epoch, state, _infos: {"p": state.probabilities} for name in ("imm", "both")
    }
    tracks = {
        name: run(f, sim.prior, sim.epochs(), keep="cov", also=also.get(name))
        for name, f in known.items()
    }
    times, errors = (
        sim.config.times,
        {name: track.mean - sim.truth for name, track in tracks.items()},
    )

    def squares(name, start, end, group=slice(0, 3)):
        span = (times >= start) & (times < end)
        return np.square(errors[name][span][..., group]).sum(-1).mean(0)

    def over(a, b, *span):
        return bootstrap(ratio, squares(a, *span), squares(b, *span))

    velocity = slice(3, 6)
    assert (squares("straight, window", 7.0, 8.0) > 100.0**2).all()
    assert over("imm", "straight, window", 4.0, 8.0)[1] < 0.1
    assert over("imm", "straight", 5.0, 8.0, velocity)[1] < 0.1
    assert over("imm", "turn, window", 2.0, 4.0, velocity)[1] < 0.75
    assert over("imm", "turn, window", 11.0, 13.0)[0] > 1.0
    assert over("both", "turn, window", 11.0, 13.0)[1] < 1.0
    for name in also:
        turned = tracks[name].extra["p"][..., 1::2].sum(-1)
        assert (turned[45:80] > 0.9).all()
        assert turned[110:].mean() < 0.1
    span = slice(45, 80)
    claimed = {
        name: nees(errors[name][span], track.sqrt_cov[span]).mean() / 8.0
        for name, track in tracks.items()
    }
    assert all(0.6 < claimed[name] < 1.1 for name in also)
    assert claimed["straight"] > 100.0


def test_batches_are_singles(errors):
    one = simulate(SHORT, runs(6)[3:4])
    np.testing.assert_allclose(
        follow(one, ("aukf",))["aukf"][:, 0], errors["aukf"][:, 3], rtol=0, atol=1e-6
    )


def test_every_rule_moves_a_linear_model_alike():
    """The prediction is a matrix: propagating sigma points gives the same result as the Jacobian."""
    sim, S = simulate(SHORT, runs(2)), len(visible(SHORT).names)
    rule = unscented(8, 1.0, 2.0, 0.0)
    plain = adapted(SHORT, S, rule)
    drawn = sigma_point(Motion(lambda x, _e: x @ SHORT.F.T, SHORT.Q), *plain.sensors, rule=rule)
    one, two = (run(f, sim.prior, sim.epochs(), keep="mean").mean for f in (drawn, plain))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"interval_s": 0.0}, "interval_s"),
        ({"burst": "some"}, "burst"),
        ({"window": 0}, "window"),
        ({"runs": 1.5}, "runs"),
        ({"sigma_range_m": np.nan}, "sigma_range_m"),
        ({"alpha": None}, "alpha"),
        ({"deviation": (1.0, 1.0, 1.0, 0.0)}, "deviation"),
        ({"clock_walk_m2_per_s3": -1.0}, "clock_walk_m2_per_s3"),
        ({"burst_s": (70.0, 60.0)}, "burst_s"),
        ({"turn_s": (40.0, 40.0)}, "turn_s"),
        ({"turn_s": (0.0, np.inf)}, "turn_s"),
        ({"turn_s": 20.0}, "turn_s"),
        ({"mask_deg": 90.0}, "mask_deg"),
        ({"latitude_deg": 100.0}, "latitude_deg"),
        ({"burst_satellite": -1}, "burst_satellite"),
        ({"burst_satellite": 2.5}, "burst_satellite"),
        ({"acceleration_noise_m2_per_s3": -1.0}, "acceleration_noise_m2_per_s3"),
        ({"assumed_m": 0.0}, "assumed_m"),
        ({"motion": "straight"}, "motion"),
        ({"burst_count": 0}, "burst_count"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(PRESETS["burst"], **change)


def test_a_satellite_that_is_not_there_is_told():
    with pytest.raises(ValueError, match=r"^burst_satellite: expected an index below 15"):
        simulate(replace(SHORT, burst="one", burst_satellite=20), runs(1))


def test_some_of_the_ranges_are_struck_evenly():
    hit = scenario.burst(replace(SHORT, burst="one", burst_count=3), 15)[25]
    np.testing.assert_array_equal(np.flatnonzero(hit), [2, 7, 12])
    assert np.flatnonzero(scenario.burst(replace(SHORT, burst="one"), 15)[25]).tolist() == [2]


def flown(config, names, count=2, **keep):
    """Filters alone, by `celnav.run`."""
    sim = simulate(config, runs(count))
    S = len(sim.satellites.names)
    known = {**filters(config, S), "no redraw": study.no_redraw(config, S)}
    return sim, {name: run(known[name], sim.prior, sim.epochs(), **keep) for name in names}


def test_without_drawing_anew_the_gain_lacks_the_process_noise():
    sim, tracks = flown(PRESETS["quiet"], ("no redraw", "ukf"), 3, keep="mean")
    sizes = {
        n: np.sqrt(np.square((t.mean - sim.truth)[100:600, :, :3]).sum(-1).mean())
        for n, t in tracks.items()
    }
    assert sizes["no redraw"] > 3.0 * sizes["ukf"]
    # Without process noise it makes no difference whether the points are redrawn.
    still = replace(
        SHORT,
        acceleration_noise_m2_per_s3=1e-12,
        clock_white_m2_per_s=0.0,
        clock_walk_m2_per_s3=1e-12,
    )
    _, tracks = flown(still, ("no redraw", "ukf"), keep="mean")
    np.testing.assert_allclose(tracks["no redraw"].mean, tracks["ukf"].mean, rtol=0, atol=1e-3)


def side_by_side(names, cases=None, count=2, **more):
    return study.run_filters(
        study.Flight(names, cases={"": {}} if cases is None else cases, **more),
        (),
        SHORT,
        runs(count),
    )


def test_factors_are_watched():
    found, sim = side_by_side(("aukf",), count=4), simulate(SHORT, runs(4))
    np.testing.assert_array_equal(found["aukf/ranges"][:9], 1.0)
    assert found["aukf/ranges"].shape == (41, 4)
    assert found["aukf/ranges"][29].mean() > 50.0 * found["aukf/ranges"][15].mean()
    assert (
        found["aukf/ranges above 1"][29].mean()
        > 0.99
        > found["aukf/rates above 1"][15].mean()
        >= 0.0
    )
    plain = run(filters(SHORT)["aukf"], sim.prior, sim.epochs(), keep="mean").mean - sim.truth
    np.testing.assert_allclose(found["aukf/error"], plain[..., :3], rtol=0, atol=1e-9)


def test_cases_side_by_side_are_cases_alone():
    both = side_by_side(
        ("aukf", "student"), {f"{case}/": {"burst": case} for case in ("none", "ranges")}, anew=True
    )
    rngs = runs(2)
    for case in ("none", "ranges"):
        sim = simulate(replace(SHORT, burst=case), rngs)
        for name in ("aukf", "student"):
            track = run(
                filters(SHORT)[name],
                sim.prior,
                sim.epochs(),
                keep="mean",
                also=lambda _e, _s, i: {"nis": i[0].nis},
            )
            np.testing.assert_allclose(
                both[f"{case}/{name}/error"],
                (track.mean - sim.truth)[..., :3],
                rtol=1e-6,
                atol=1e-6,
            )
            np.testing.assert_allclose(both[f"{case}/{name}/nis"], track.extra["nis"], rtol=1e-6)


def test_a_process_noise_of_each_case_is_that_of_the_case_alone():
    cases = {f"{q:g}/": {"acceleration_noise_m2_per_s3": q} for q in (1.0, 100.0)}
    both = side_by_side(("ekf",), cases)
    for case, change in cases.items():
        sim, tracks = flown(replace(SHORT, **change), ("ekf",), keep="mean")
        np.testing.assert_allclose(
            both[f"{case}ekf/error"], (tracks["ekf"].mean - sim.truth)[..., :3], rtol=0, atol=1e-7
        )


def test_parts_of_a_number_are_drawn_one_after_the_other():
    after = study.run_filters(study.Flight(("ls",)), [SHORT], SHORT, runs(2))["ls/error"]
    both = side_by_side(("ls",), {"first/": {}, "second/": {}}, anew=True)
    np.testing.assert_array_equal(after, both["second/ls/error"])
    assert np.abs(after - both["first/ls/error"]).max() > 1.0


def test_what_a_prior_claims_may_be_wrong():
    far = replace(SHORT, deviation=(100.0, 1.0, 10.0, 1.0))
    one, two = (simulate(c, runs(2)).prior for c in (far, replace(far, assumed_m=10.0)))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(two.cov[0], SHORT.P0)


@pytest.mark.parametrize("alpha", [1.0, 0.1])
def test_a_linear_measurement_makes_all_of_them_the_textbooks_filter(alpha):
    sim, S = simulate(replace(SHORT, duration_s=1.0), runs(2)), len(visible(SHORT).names)
    H = pseudorange.jacobian(sim.truth[0, 0], sim.satellites.q[0], sim.satellites.w[0])
    R = SHORT.R(S)
    rng = np.random.default_rng(0)
    truth = sim.truth - sim.truth[0, :1]  # relative to the start, to limit round-off
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
    """One of two runs has no measurements; the hooks are called with both."""
    sim = simulate(replace(SHORT, duration_s=1.0), runs(2))
    z = sim.z.copy()
    z[:, 0] = np.nan
    blind, S = sim._replace(z=z), len(sim.satellites.names)
    for hook in (
        innovation_window(3),
        *(h[0] for name, h in hooks(S).items() if name not in ("ukf", "aukf")),
    ):
        f = adapted(SHORT, S, ukf(SHORT), hook)
        error, seeing = (
            run(f, s.prior, s.epochs(), keep="mean").mean - s.truth for s in (blind, sim)
        )
        moved = blind.prior.mean[0] @ np.linalg.matrix_power(SHORT.F, 10).T - blind.truth[10, 0]
        np.testing.assert_allclose(error[10, 0], moved, rtol=0, atol=1e-6)
        np.testing.assert_allclose(error[:, 1], seeing[:, 1], rtol=0, atol=1e-6)


def test_the_smallest_window_takes_each_innovation_for_itself():
    sim, S = simulate(replace(SHORT, duration_s=1.0), runs(1)), len(visible(SHORT).names)
    filter = adapted(SHORT, S, ukf(SHORT), innovation_window(1))
    R, plain = SHORT.R(S).diagonal(), adapted(SHORT, S, ukf(SHORT))
    state = filter.start(sim.prior)
    for epoch in sim.epochs():
        _, (info,) = plain.step(State(state.belief, (None,)), epoch)
        prior = (info.sqrt_S @ info.sqrt_S.mT).diagonal(0, -2, -1) - R
        state, (own,) = filter.step(state, epoch)
        np.testing.assert_allclose(
            own.R / R, np.maximum(1.0, (info.innovation**2 - prior) / R), rtol=1e-6
        )


def test_factors_of_the_noise_are_told_by_what_is_struck():
    """Means and fractions, separately for disturbed and undisturbed ranges; 1
    for a missing range.
    """
    S, missing = 3, np.array([[1.0, 9.0, np.nan, 1.0, 4.0, 1.0]])
    R = np.repeat([SHORT.sigma_range_m, SHORT.sigma_rate_m_per_s], S) ** 2
    track = SimpleNamespace(extra={"R": missing * R})
    A = noise_factors(track, SHORT, S)
    np.testing.assert_allclose(A, [[1.0, 9.0, 1.0, 1.0, 4.0, 1.0]])
    found = study.of_factors(A, np.array([[False, True, False]]))
    expected = {
        "ranges": 11 / 3,
        "ranges above 1": 1 / 3,
        "rates": 2.0,
        "rates above 1": 1 / 3,
        "bad": 9.0,
        "good": 1.0,
        "good above 2": 0.0,
    }
    assert {name: value.item() for name, value in found.items()} == pytest.approx(expected)


# -- the state as an error -------------------------------------------------------------------------
def of_errors(filter, form):
    """The same filter for the errors of a nominal state, which is the last input of an epoch."""

    def slopes(d, epoch):
        return pseudorange.jacobian(
            epoch.u[2] + (d if form in ("closed", "open") else 0.0 * d), *epoch.u[:2]
        )

    def h(d, epoch):
        if form == "linearized":
            return pseudorange.measure(epoch.u[2] + 0.0 * d, *epoch.u[:2]) + np.einsum(
                "...ij,...j->...i", slopes(d, epoch), d
            )
        return pseudorange.measure(epoch.u[2] + d, *epoch.u[:2])

    return replace(filter, sensors=(Sensor(h, sqrt_R=filter.sensors[0].noise, jacobian=slopes),))


def apart(sim, name, form):
    """Estimates of the error-state filter minus those of the full-state filter, and the last
    nominal state.
    """
    full, x, out = filters(sim.config)[name], sim.prior.mean, []
    filter, other = of_errors(full, form), full.start(sim.prior)
    state = filter.start(Gaussian(0.0 * x, sim.prior.cov))
    for epoch in sim.epochs():
        other, _ = full.step(other, epoch)
        x = x @ sim.config.F.T if epoch.dt else x
        state, _ = filter.step(state, epoch._replace(u=(*epoch.u, x)))
        d = state.belief.mean
        out.append(x + d - other.belief.mean)
        if form == "closed":
            x, state = x + d, state._replace(belief=state.belief._replace(mean=0.0 * d))
    return np.array(out), x


def far(meters, **change):
    c = replace(
        SHORT,
        duration_s=3.0,
        burst_s=(1.0, 2.0),
        deviation=(meters, *SHORT.deviation[1:]),
        **change,
    )
    return simulate(c, runs(2))


@pytest.mark.parametrize("meters", [10.0, 1e4, 1e6])
@pytest.mark.parametrize("name", ["ekf", "ukf", "aukf"])
def test_a_state_of_errors_changes_no_estimate_and_saves_no_evaluation(name, meters, monkeypatch):
    sim, count, measure = far(meters), [], pseudorange.measure
    monkeypatch.setattr(
        pseudorange, "measure", lambda x, *u: count.append(np.size(x)) or measure(x, *u)
    )
    for form in ("closed", "open"):
        count.clear()
        off, _ = apart(sim, name, form)
        assert np.abs(off[..., :3]).max() < max(1e-6, 1e-9 * meters), form
        assert count[::2] == count[1::2]  # of the full state and of the errors in turn


def test_what_is_linearized_once_for_all_is_off_by_the_curvature_of_the_range():
    sim = far(1e4, burst="none")
    off, nominal = apart(sim, "ekf", "linearized")
    u, truth = (sim.satellites.q[-1], sim.satellites.w[-1]), sim.truth[-1]
    H, R = pseudorange.jacobian(nominal, *u), SHORT.R(len(sim.satellites.names))
    curved = (
        pseudorange.measure(truth, *u)
        - pseudorange.measure(nominal, *u)
        - np.einsum("rij,rj->ri", H, truth - nominal)
    )
    d, away = (truth - nominal)[:, None, :3], u[0] - nominal[:, None, :3]
    distance = np.linalg.norm(away, axis=-1)
    across = np.square(d).sum(-1) - np.square((d * away).sum(-1) / distance)
    np.testing.assert_allclose(curved[:, :15], across / (2.0 * distance), rtol=0.01)
    fit = np.linalg.solve(
        H.mT @ np.linalg.solve(R, H), H.mT @ np.linalg.solve(R, curved[..., None])
    )[:, :3, 0]
    np.testing.assert_allclose(off[-1, :, :3], fit, atol=0.2 * np.abs(fit).max())
    # With the exact measurement only the gain is linearized at another state.
    assert np.abs(apart(sim, "ekf", "slopes")[0][..., :3]).max() < 0.05 * np.abs(off[..., :3]).max()


# -- the window ------------------------------------------------------------------------------------
def walk(hook, z, R=4.0, Q=1.0, apply=True):
    """Factors of a hook in a scalar Kalman filter for a random walk, which uses or ignores them;
    its gains and innovation variances.
    """

    def seen(memory, joint, epoch):
        own, after = hook(None if memory is None else memory[0], joint, epoch)
        return (own, after.variances()[1] / joint.variances()[1]), after if apply else joint

    rule, prior = unscented(1, 1.0, 2.0, 0.0), Gaussian(np.zeros(1), 10.0 * np.eye(1))
    filter = sigma_point(
        Motion(np.eye(1), Q * np.eye(1)), Sensor(np.eye(1), R * np.eye(1)), rule=rule, hooks=[seen]
    )
    return run(
        filter,
        prior,
        np.arange(len(z)),
        z,
        also=lambda _e, s, i: {"A": s.memory[0][0][1], "S": i[0].sqrt_S ** 2, "K": i[0].gain()},
    ).extra


@pytest.mark.parametrize(
    ("M", "above", "excess"), [(1, 0.3173, 0.4839), (10, 0.4405, 0.1755), (50, 0.4734, 0.0795)]
)
def test_consistent_innovations_inflate_the_noise_as_chi_square_says(M, above, excess):
    a, rng = 0.5 * M, np.random.default_rng(3)
    assert gammaincc(a, a) == pytest.approx(above, abs=1e-4)
    assert np.exp(a * np.log(a) - a - gammaln(a + 1.0)) == pytest.approx(excess, abs=1e-4)
    T, n = 150, 2000
    x = (
        np.sqrt(10.0) * rng.standard_normal((n, 1))
        + np.cumsum(rng.standard_normal((T, n, 1)), 0)
        - rng.standard_normal((1, n, 1))
    )
    found = walk(innovation_window(M), x + 2.0 * rng.standard_normal((T, n, 1)), apply=False)
    A, S = found["A"][-100 + M :: M].ravel(), found["S"][-1].ravel()[0]
    assert (A > 1.0).mean() == pytest.approx(above, abs=4.0 * np.sqrt(above / len(A)))
    assert (A - 1.0).mean() == pytest.approx(excess * S / 4.0, abs=4.0 * A.std() / np.sqrt(len(A)))


def test_one_outlier_stays_in_the_window_for_as_many_epochs_as_it_has():
    z = np.zeros((60, 1, 1))
    z[30] = 400.0
    A = walk(innovation_window(10), z)["A"].ravel()
    np.testing.assert_allclose(A[30:40], 400.0**2 / (10.0 * 4.0), rtol=0.05)
    np.testing.assert_array_equal(np.delete(A, range(30, 40)), 1.0)


def test_a_large_first_innovation_is_taken_for_noise():
    for e in (1.0, 30.0, 1e4):
        K = walk(innovation_window(1), np.full((1, 1, 1), e))["K"].item()
        assert pytest.approx(10.0 / (10.0 + max(4.0, e**2 - 10.0)), rel=1e-9) == K


# -- several bad channels --------------------------------------------------------------------------
def test_channels_that_share_no_state_do_not_touch_each_other():
    rng, eye = np.random.default_rng(5), np.eye(8)
    z, bad = rng.standard_normal((30, 20, 8)), [1, 4, 6]
    z[15:, :, bad] += 1e4

    def kept(z, *hooks):
        filter = sigma_point(
            Motion(eye, 0.01 * eye), Sensor(eye, eye), rule=unscented(8, 1.0, 2.0, 0.0), hooks=hooks
        )
        return run(filter, Gaussian(np.zeros(8), eye), np.arange(30), z, keep="mean").mean

    one, two, alone = (
        kept(z, innovation_window(3)),
        kept(z),
        kept(z[..., [0] * 8], innovation_window(3)),
    )
    np.testing.assert_allclose(one[..., 0], alone[..., 0], rtol=0, atol=1e-9)
    assert (
        np.abs(one[-1][:, bad]).max() < 3.0 < 1e2 < np.abs(two[-1][:, bad]).min()
    )  # almost only a prediction


def test_all_ranges_too_long_are_a_step_of_the_clock():
    c = replace(SHORT, burst_shape="constant", sigma_range_m=3.0)
    struck, plain = simulate(c, runs(3)), simulate(replace(c, burst="none"), runs(3))
    np.testing.assert_allclose((struck.z - plain.z)[20:30, :, :15], 50.0, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(struck.z[:20], plain.z[:20])
    known, steps, group = filters(c), {}, hooks(15)["group"][0]
    for name in ("ls", "ukf"):
        one, two = (
            run(known[name], sim.prior, sim.epochs(), keep="mean").mean for sim in (struck, plain)
        )
        steps[name] = one - two
    np.testing.assert_allclose(
        steps["ls"][25][:, [0, 1, 2, 6]], [[0.0, 0.0, 0.0, 50.0]] * 3, rtol=0, atol=1e-5
    )
    # A filter with an exact clock state assigns a part of the fault to position; the parity
    # residual is independent of it.
    assert np.linalg.norm(steps["ukf"][29, :, :3], axis=-1).min() > 5.0

    def blind(memory, joint, epoch):
        longer = joint._replace(innovation=joint.innovation + np.repeat([50.0, 0.0], 15))
        one, two = (group(None, each, epoch)[1].variances()[1] for each in (joint, longer))
        np.testing.assert_allclose(one, two, rtol=1e-6)
        return memory, joint

    run(adapted(c, 15, ukf(c), blind), plain.prior, plain.epochs())


def test_factors_of_bad_and_good_ranges_are_told_apart():
    found = side_by_side(("aukf",), {"": {"burst": "one", "burst_count": 3}}, count=4)
    during = slice(29, 30)
    parts = {
        what: found[f"aukf/{what}"][during].mean()
        for what in ("bad", "good", "good above 2", "ranges")
    }
    assert parts["bad"] > 100.0 > 5.0 > parts["good"] >= 1.0
    assert 3.0 * parts["bad"] + 12.0 * parts["good"] == pytest.approx(
        15.0 * parts["ranges"], rel=1e-9
    )
    assert 0.0 <= parts["good above 2"] < 0.3
    np.testing.assert_array_equal(found["aukf/bad"][:20], 0.0)  # there are none


def test_on_prediction_alone_the_position_grows_with_the_process_noise():
    c = replace(
        SHORT,
        mask_deg=20.0,
        burst="both",
        burst_sigma=1e4,
        burst_s=(2.0, 8.0),
        duration_s=8.0,
        motion="model",
    )
    sizes = []
    for q in (10.0, 1000.0):
        sim, tracks = flown(replace(c, acceleration_noise_m2_per_s3=q), ("aukf",), 4, keep="mean")
        assert len(sim.satellites.names) == 12
        sizes.append(
            np.sqrt(np.square((tracks["aukf"].mean - sim.truth)[-10:, :, :3]).sum(-1).mean())
        )
    assert sizes[1] > 3.0 * sizes[0]


def test_counts_and_times_of_findings():
    numbers = [
        Number("", 0.5, (None, 1.0), ci) for ci in ((0.4, 0.6), (0.4, 1.2), (0.4, 0.6), (1.1, 1.2))
    ]
    assert count_holding("", numbers, (2, None))[1:4] == (2.0, (2, None), (2.0, 3.0))
    assert count_holding("", numbers, (2, None), leading=True)[1:4] == (1.0, (2, None), (1.0, 3.0))
    error = {"ukf": [5, 5, 1, 5, 1, 1], "aukf": [5, 1, 1, 1, 1, 1]}
    fake = SimpleNamespace(
        error=lambda _part, name, _group: np.tile(
            np.array(error[name], float)[:, None, None], (1, 3, 3)
        ),
        parts={"p": SimpleNamespace(config=SimpleNamespace(interval_s=0.5))},
    )
    assert study.later("", "p", "", 3.0, fake).value == (1 - 4) * 0.5


# -- what needs no filters -------------------------------------------------------------------------
def test_the_node_of_a_flat_orbit_is_lost_and_its_place_is_not():
    found = study.nodes(SHORT, [generator(0, 50, 0)])
    formula = np.degrees(study.NORMAL_ERROR / np.sin(np.radians(study.TILTS_DEG)))
    np.testing.assert_allclose(found["node"][:3], formula[:3], rtol=0.01)
    np.testing.assert_allclose(formula[[0, 2, 4]], [0.00699, 0.328, 32.8], rtol=0.01)
    assert found["node"][4] == pytest.approx(41.0, rel=0.02)
    np.testing.assert_allclose(found["place"], np.degrees(study.NORMAL_ERROR), rtol=0.01)


def test_the_unscented_transform_of_polar_coordinates():
    m = study.polar(SHORT, [generator(0, 51, 0)])
    assert m["exact"][0, 1] == pytest.approx(np.exp(-0.5 * np.radians(15.0) ** 2), abs=1e-12)
    np.testing.assert_allclose(m["unscented"], [m["exact"][0], [0.2529, 0.0517]], atol=1e-4)
    assert abs(m["linearized"][0, 1] - m["exact"][0, 1]) > 0.03


def test_geostationary_formulas():
    found = day.formulas(PRESETS["burst"].times[::100])
    assert found["right"].max() < 1e-6
    assert found["others"].min() > 6e5
    assert found["minute"].max() == pytest.approx(184e3, rel=0.01)
    assert found["half hour"].max() == pytest.approx(5.53e6, rel=0.01)


def test_the_rate_is_that_of_the_range():
    config = PRESETS["burst"]
    sim, k, step = simulate(config, runs(1)), 450, 0.5
    position, velocity = (part[k] for part in circle(config))
    broadcast = scenario.synthetic()
    used = broadcast.chosen(np.isin(broadcast.names, sim.satellites.names))
    around = []
    for s in (-step, step):
        here = position + s * velocity
        seen = pseudorange.sources(used, scenario.START_S + config.times[k] + s, here)
        around.append(np.linalg.norm(seen.q - here, axis=-1))
    state = np.concatenate([position, velocity, np.zeros(2)])
    rate = pseudorange.measure(state, sim.satellites.q[k], sim.satellites.w[k])[15:]
    np.testing.assert_allclose((around[1] - around[0]) / (2.0 * step), rate, rtol=0, atol=5e-6)


def test_operations_of_a_step_grow_by_what_the_measurement_does_at_each_point():
    """An absolute value in ``h`` adds one operation for each measured component: at the 17 points
    of the UKF, once in the EKF, with each engine.

    Two points differ only in the clock drift: their ranges equal the center's, and are not computed
    again.
    """
    config = replace(SHORT, duration_s=0.1, burst="none", mask_deg=50.0)
    sim = simulate(config, runs(1))
    S = len(sim.satellites.names)

    def count(rule, engine, scale):
        plain = adapted(config, S, rule)
        sensor = replace(plain.sensors[0], h=lambda x, e: scale(pseudorange.measure(x, *e.u)))
        filter = sigma_point(plain.motion, sensor, rule=rule, form="covariance")
        token = ENGINE.set(engine)
        try:
            return step_operations(filter, sim.prior, list(sim.epochs()))
        finally:
            ENGINE.reset(token)

    for rule, points, shared in ((Taylor(), 1, 0), (ukf(config), 17, 2)):
        once = count(rule, "numpy", lambda z: z)
        twice = count(rule, "auto", np.abs)
        assert twice - once == points * 2 * S - shared * S


def test_a_gap_is_compared_with_that_of_the_right_noise():
    sizes = {"mistuned": {"ukf": 1.0, "aukf": 0.8}, "quiet": {"ukf": 2.0, "aukf": 1.95}}
    fake = SimpleNamespace(
        squares=lambda part, name, _group, _at: np.full((5, 3), sizes[part][name] ** 2)
    )
    error, wider = study.gap(fake)
    assert error.value == pytest.approx(0.8)
    assert wider.value == pytest.approx(0.2 / 0.025)
    assert error.holds
    assert wider.holds


def test_which_half_of_a_statement_holds():
    """In part: an error that is larger by any factor, and slow starts; a faster recovery after the
    burst, but a slower start from far away.
    """
    rows = {row.id: row for row in aukf.STUDY.rows}
    times = np.arange(0.0, 90.05, 0.1)
    burst = (times >= 60.0)[:, None, None]
    noise = np.random.default_rng(0).uniform(0.9, 1.1, (len(times), 20, 3))

    def judged(id, scale):
        def error(part, name, _group="position", _what="error"):
            return noise * scale(part, name)

        fake = Results(aukf.STUDY, 0, 1.0, study.parts(), {})
        object.__setattr__(fake, "error", error)
        object.__setattr__(fake, "times", lambda _part: times)
        return rows[id].judged(fake).verdict

    def wrong(most):
        late = np.where(times < 5.0, 100.0, 1.0)[:, None, None]
        slow = dict.fromkeys(study.STARTS[1:], late)
        return lambda part, _name: slow.get(part, most if part == "near/R 3" else 1.0)

    assert [judged("ukf-sensitive", wrong(most)) for most in (3.0, 1.5, 1.0)] == [
        "reproduced",
        "in part",
        "not reproduced",
    ]

    def settles(aukf_s, ukf_s, far):
        def scale(part, name):
            after = {"aukf": aukf_s, "ukf": ukf_s}.get(name, 0.0)
            if part in study.STARTS:
                return np.where(times < (far if name == "aukf" else 1.0), 100.0, 1.0)[:, None, None]
            return np.where(burst & (times < 70.0 + after)[:, None, None], 100.0, 1.0)

        return scale

    assert judged("faster-convergence", settles(1.0, 6.0, 5.0)) == "in part"
    assert judged("faster-convergence", settles(1.0, 6.0, 0.2)) == "reproduced"
    assert judged("faster-convergence", settles(6.0, 1.0, 5.0)) == "not reproduced"


# -- the study -------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def results():
    return once(aukf.STUDY)


def test_every_figure_draws(results):
    assert len(show.FIGURES) == 16
    for stem, (caption, draw) in show.FIGURES.items():
        fig = draw(results)
        assert caption.endswith("."), stem
        if stem == "figure_14":
            assert fig is None  # the receiver's files were not given
        else:
            number, rest = int(stem[-2:]), " (not in the paper)" if stem > "figure_09" else ""
            assert fig.get_suptitle().startswith(f"Figure {number}{rest}: "), stem
            assert not faults(fig), stem


def test_tables(results):
    rows = {stem: table(results) for stem, (_, table) in show.TABLES.items()}
    assert len(rows) == 2
    assert [row["filter"] for row in rows["table_1"]] == ["LS", "EKF", "UKF", "AUKF", "UKF", "AUKF"]
    assert {row["paper"] for row in rows["table_1"]} == {"lost"}
    assert rows["table_1"][0]["X (m)"] > rows["table_1"][1]["X (m)"]
    assert rows["table_2"] == []  # the receiver's files were not given


STATEMENTS = """
ls-rough ukf-better-than-ekf no-extra-computation transform-second-order ukf-sensitive geo-needs-rotation a-is-identity
system-noise-weakened several-outliers clearly-better-quiet table-1-order burst-suppressed fast-recovery faster-convergence
"""


def test_every_statement_is_in_the_ledger_and_nothing_surprises(results):
    claims = {c.id: c for c in results.claims()}
    statements = [c for c in claims.values() if c.kind == "statement"]
    assert [c.id for c in statements] == STATEMENTS.split()
    assert all(c.row.why and c.row.place and c.row.found for c in statements)
    assert not {id for id, c in claims.items() if c.surprise}
    assert not any(
        id.startswith("real-") for id in claims
    )  # without files no sentence about the receiver
    assert len([c for c in claims.values() if c.kind == "finding"]) <= 10
    dumps(claims.values())


def test_printed_numbers_are_the_papers():
    printed = {row.id: row.printed for row in aukf.STUDY.rows if row.printed is not None}
    assert (
        json.dumps(printed) == '{"transform-second-order": 2, "burst-suppressed": [60, 70, 0, 50]}'
    )
    c = PRESETS["burst"]
    given = (c.speed_m_per_s, c.acceleration_g, c.height_m, *c.burst_s, c.burst_sigma, c.beta)
    assert " ".join(f"{value:g}" for value in given) == "400 4 800 60 70 50 2"


def test_checks_of_a_real_receiver_say_what_its_day_judges():
    rows = {row.id: row for row in aukf.STUDY.rows if row.needs == "real"}
    says = {f"real-{id}": f"Real receiver: {text}" for id, (text, _) in day.JUDGED.items()}
    assert {id: row.says for id, row in rows.items()} == says


def test_a_run_does_not_depend_on_how_many_there_are():
    three, one = simulate(SHORT, runs(3)), simulate(SHORT, runs(3)[2:])
    np.testing.assert_array_equal(three.z[:, 2], one.z[:, 0])
    np.testing.assert_array_equal(three.prior.mean[2], one.prior.mean[0])


def test_a_recording_of_the_burst_is_written_and_none_of_an_absent_receiver(results, tmp_path):
    assert show.record(results, Outputs(tmp_path)) == ["aukf_burst.rrd"]
    (found,) = rr.chunk.RrdReader(tmp_path / "aukf_burst.rrd").recordings()
    assert found.application_id == "celnav-aukf-burst"
    drawn = {
        str(c.entity_path)
        for c in rr.chunk.RrdReader(tmp_path / "aukf_burst.rrd").stream().to_chunks()
        if not c.is_static
    }
    assert {
        "/world/sight",
        "/track/aukf/ellipsoid",
        "/error/group/estimate",
        "/plots/consistency/nis/ekf",
        "/states/noise",
    } <= drawn
    assert "/error/ls/ellipsoid" not in drawn  # it has no covariance
    assert not (tmp_path / "aukf_real.rrd").exists()


def test_an_absent_receiver_is_absent_and_a_folder_without_files_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "real" not in study.parts()
    with pytest.raises(FileNotFoundError, match="expected a RINEX observation file"):
        study.parts(rinex=tmp_path)


def test_a_receivers_files_make_a_part_of_their_own(tmp_path):
    """A short log of the synthetic constellation; `celnav reproduce --rinex`
    computes a real day.
    """
    sky, times = constellation(), TOE + 1800.0 + 10.0 * np.arange(120)
    written(tmp_path, observations(sky, times)[0], "TEST_MO.rnx")
    written(tmp_path, navigation(sky), "TEST_MN.rnx")
    results = aukf.STUDY.reproduce(only=["real"], rinex=tmp_path)
    claims = {c.id: c for c in results.claims([row for row in aukf.STUDY.rows if row.needs])}
    assert len(claims) == 10
    assert claims["real-ls"].verdict == claims["real-burst"].verdict == "holds"
    assert claims["real-consecutive"].verdict == "no number"  # one set of each satellite
    assert [row["filter"] for row in show.TABLES["table_2"][1](results)] == [
        "LS",
        "EKF",
        "UKF",
        "AUKF",
        "group parity",
    ]
    drawn = show.FIGURES["figure_14"][1](results)
    assert drawn.get_suptitle().startswith("Figure 14 (not in the paper): ")
    assert len(drawn.axes) == 3
    found = day.positioned(results.parts["real"].config, "aukf", 10.0)
    np.testing.assert_allclose(np.linalg.norm(found.local(found.mean), axis=-1), 0.0, atol=2.0)
