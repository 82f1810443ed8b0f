"""Trials of the papers: the evaluated quantities, and the bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from celnav import Gaussian, epochs, run
from celnav.analysis.metrics import chi_square_band
from celnav.filters.records import FromFunctions, Info, State
from celnav.gaussian.linalg import SquareRoot
from celnav.papers import PAPERS, csrukf, load
from celnav.papers.csrukf import study as ledger
from celnav.study.montecarlo import generator
from celnav.study.trial import Group, Noiseless, Trial, bound, evaluate_filter, squares

SMALL = {
    "csrukf": {"steps": 40, "phi": 0.8},
    "ssukf": {"duration_s": 20.0},
    "tstdkf": {"days": 0.5, "initial": "drawn", "trend": "constant"},
    "aasghqf": {"steps": 25, "misalignment_deg": (1.0, 1.0, 1.0)},
    "aukf": {"duration_s": 5.0, "burst": "none"},
    "mars": {"weeks": 12},
}
RUNS = 12


def small(paper, **change):
    module = load(paper)
    config = replace(next(iter(module.PRESETS.values())), **SMALL[paper] | change)
    return module.trial(config, [generator(1, 0, r) for r in range(RUNS)]), module.trial(
        config, [Noiseless()]
    )


@pytest.mark.parametrize("paper", PAPERS)
def test_every_filter_of_every_paper_can_be_judged(paper):
    trial, noiseless = small(paper)
    least = bound(noiseless)
    assert {group.name: group.unit for group in trial.groups} == load(paper).JUDGED
    for name in trial.filters:
        found = evaluate_filter(trial, name, every=2)
        n = found.error.shape[-1]
        assert found.error.shape == found.std.shape == (len(found.times), RUNS, n)
        assert found.nees.shape == found.nis.shape == found.dof.shape == (len(found.times), RUNS)
        assert np.isfinite(found.nees).all()
        assert not found.lost
        assert (np.diff(found.times) > 0).all()
        assert squares(trial.groups, found.error).shape[-1] == len(trial.groups)
    assert (least is None) == (paper == "aukf")
    if least is not None:
        best = evaluate_filter(trial, trial.reference)
        assert least.shape == (len(best.times), len(trial.groups))
        rms, own = (np.sqrt(squares(trial.groups, a).mean((0, 1))) for a in (best.error, best.std))
        np.testing.assert_allclose(own / np.sqrt(least.mean(0)), 1.0, atol=0.05)
        np.testing.assert_allclose(rms / np.sqrt(least.mean(0)), 1.0, atol=5.0 / np.sqrt(2 * RUNS))


def test_following_twice_gives_the_same_and_every_second_epoch_is_a_part():
    trial, _ = small("csrukf")
    whole, again, part = (
        evaluate_filter(trial, "csrukf"),
        evaluate_filter(trial, "csrukf"),
        evaluate_filter(trial, "csrukf", every=2),
    )
    for name in ("times", "error", "std", "nees", "nis", "dof"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(again, name))
        np.testing.assert_array_equal(getattr(whole, name)[::2], getattr(part, name))


def test_the_numbers_are_those_of_their_definitions():
    config = replace(csrukf.PRESETS["P"], **SMALL["csrukf"])
    sim = csrukf.simulate(config, [generator(1, 0, r) for r in range(RUNS)])
    track = run(csrukf.filters(config)["srukf"], sim.prior, sim.epochs("srukf"), keep="cov")
    found = evaluate_filter(
        csrukf.trial(config, [generator(1, 0, r) for r in range(RUNS)]), "srukf"
    )
    error = track.mean - sim.truth
    np.testing.assert_array_equal(found.error, error)
    np.testing.assert_allclose(found.std, track.std, rtol=1e-14)
    np.testing.assert_allclose(
        found.nees,
        (error * np.linalg.solve(track.cov, error[..., None])[..., 0]).sum(-1),
        rtol=1e-9,
    )
    np.testing.assert_allclose(found.nis, track.nis, rtol=1e-13)
    np.testing.assert_array_equal(found.dof, track.dof)
    np.testing.assert_allclose(
        squares((Group("v", "m/s", slice(3, 6), 1e3),), error)[..., 0],
        (error[..., 3:] ** 2).sum(-1) * 1e6,
        rtol=1e-14,
    )


@pytest.mark.parametrize("phi", [0.0, 0.8, 1.0])
def test_the_bound_is_that_of_linear_analysis(phi):
    config = replace(csrukf.PRESETS["P"], steps=60, phi=phi)
    expected = ledger.expected(config, (phi,))["csrukf+z0"][:, 0]
    least = np.sqrt(bound(csrukf.trial(config, [Noiseless()])))
    np.testing.assert_allclose(least[:, 0], np.linalg.norm(expected[:, :3], axis=1), rtol=1e-6)
    np.testing.assert_allclose(least[:, 1], np.linalg.norm(expected[:, 3:], axis=1), rtol=1e-6)


def test_pseudo_positions_with_the_covariance_of_the_angles_are_worth_as_much_as_the_angles():
    trial, _ = small("csrukf", measured="angles")
    mean = [
        squares(trial.groups, evaluate_filter(trial, name).error).mean((0, 1))
        for name in ("csrukf-jacobian", "angles")
    ]
    np.testing.assert_allclose(*mean, rtol=0.02)


def broken(lose_at, back_at=99):
    """A filter with three runs, the second of which has no estimate for a while."""

    def step(state, epoch):
        mean = np.zeros((3, 2))
        if lose_at <= epoch.k < back_at:
            mean[1] = np.nan
        return State(SquareRoot(mean, np.eye(2))), (Info(),)

    truth, prior = np.ones((6, 3, 2)), Gaussian(np.zeros((3, 2)), np.eye(2))
    filter = FromFunctions(lambda prior: State(SquareRoot.of(prior)), step)

    def compare(truth, belief):
        return belief.mean - truth, belief.sqrt_cov

    return Trial(
        (Group("x", "m", slice(0, 2)),),
        {"f": filter},
        prior,
        lambda name: epochs(np.arange(6.0), truth=truth),
        compare,
    )


def test_a_run_without_estimate_at_the_end_is_lost_and_one_that_comes_back_is_not():
    gone, returned = evaluate_filter(broken(3), "f"), evaluate_filter(broken(2, 4), "f")
    assert gone.lost == [(1, 3.0, "the estimate is not finite")]
    assert returned.lost == []
    np.testing.assert_array_equal(
        np.isnan(returned.nees), np.arange(6)[:, None] * [0, 1, 0] // 2 == 1
    )


@pytest.mark.parametrize("back_at", [4, 99])
def test_a_single_run_needs_no_axis(back_at):
    """It is run 0, and is evaluated like the equal run among three."""
    many = broken(2, back_at)

    def alone(state, epoch):
        after, infos = many.filters["f"].step(state, epoch)
        return State(SquareRoot(after.belief.mean[1], np.eye(2))), infos

    start = Gaussian(np.zeros(2), np.eye(2))
    one = many._replace(
        filters={"f": FromFunctions(lambda prior: State(SquareRoot.of(prior)), alone)},
        prior=start,
        epochs=lambda name: epochs(np.arange(6.0), truth=np.ones((6, 2))),
    )
    found, expected = evaluate_filter(one, "f"), evaluate_filter(many, "f")
    for name in ("error", "std", "nees"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[:, 1])
    assert found.lost == [(0, *what) for _, *what in expected.lost]
    assert len(found.lost) == (back_at == 99)


def test_epochs_without_a_truth_cannot_be_judged():
    trial = broken(9)._replace(epochs=lambda name: epochs(np.arange(3.0)))
    with pytest.raises(ValueError, match="truth"):
        evaluate_filter(trial, "f")


@pytest.mark.parametrize("measured", ["positions", "angles"])
@pytest.mark.parametrize("first_noise", ["R", "stationary"])
def test_the_exact_filter_is_consistent_whatever_the_first_noise(measured, first_noise):
    config = replace(
        csrukf.PRESETS["P"],
        steps=15,
        phi=0.95,
        measured=measured,
        first_noise=first_noise,
        prior_position_km=5.0,
    )
    trial = csrukf.trial(config, [generator(2, 0, r) for r in range(200)])
    found = evaluate_filter(trial, trial.reference)
    low, high = chi_square_band(6, 200, level=0.9999)
    assert low < found.nees[0].mean() < high
    assert low < found.nees[-1].mean() < high


def test_the_last_epoch_is_judged_whatever_lies_between():
    trial, _ = small("csrukf")
    whole, part = evaluate_filter(trial, "csrukf"), evaluate_filter(trial, "csrukf", every=7)
    chosen = [0, 7, 14, 21, 28, 35, 40]
    np.testing.assert_array_equal(part.times, whole.times[chosen])
    np.testing.assert_array_equal(part.error, whole.error[chosen])
    np.testing.assert_array_equal(part.nees, whole.nees[chosen])
    assert list(evaluate_filter(trial, "csrukf", every=1000).times) == [
        whole.times[0],
        whole.times[-1],
    ]


def test_a_bound_is_given_only_where_the_exact_filter_believes_what_is_simulated():
    assert bound(small("tstdkf", trend="sine")[1]) is None
    assert bound(small("tstdkf", initial="paper")[1]) is None
