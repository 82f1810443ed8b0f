"""Scores of blocks against statistics of all runs at once."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from celnav.campaign.scores import merge, score, summarize
from celnav.study.trial import Evaluation, Group, squares

GROUPS = (Group("position", "km", slice(0, 2)), Group("rate", "m/s", slice(2, 3), 1e3))
STD = np.array([2.0, 1.0, 1e-3])


def followed(error, nis=None, lost=()):
    """Errors of a filter with the predicted standard deviation `STD`."""
    K, runs, _ = error.shape
    nees = np.square(error / STD).sum(-1)
    dof = np.full((K, runs), 2)
    return Evaluation(
        np.arange(float(K)),
        error,
        np.broadcast_to(STD, error.shape),
        nees,
        nees if nis is None else nis,
        dof,
        np.zeros((K, 3, 3)),
        list(lost),
        K,
    )


def summed_up(scores, bound=None):
    return summarize(scores, GROUPS, bound)


def accuracies(summary):
    """The numbers of the groups."""
    return [value for name, value in summary.items() if name.startswith(("position", "rate"))]


def errors(runs, K=8, seed=0):
    return np.random.default_rng(seed).standard_normal((K, runs, 3)) * STD


def scored(error, **options):
    return score(followed(error), GROUPS, **{"settle_s": None, "limits": {}} | options)


def test_merged_blocks_say_what_all_runs_say():
    error = errors(50)
    blocks = [scored(error[:, part])[0] for part in (slice(0, 20), slice(20, 35), slice(35, 50))]
    found = summed_up(merge(blocks))
    late = error[4:]
    position = np.sqrt(np.square(late[..., :2]).sum(-1).mean())
    np.testing.assert_allclose(found["position_rms_km"], position, rtol=1e-12)
    np.testing.assert_allclose(
        found["rate_rms_m_per_s"], 1e3 * np.sqrt(np.square(late[..., 2]).mean()), rtol=1e-12
    )
    np.testing.assert_allclose(
        found["position_final_km"], np.sqrt(np.square(error[-1, :, :2]).sum(-1).mean()), rtol=1e-12
    )
    np.testing.assert_allclose(found["position_sigma_km"], np.sqrt(5.0), rtol=1e-12)
    np.testing.assert_allclose(found["anees"], np.square(late / STD).sum(-1).mean() / 3, rtol=1e-12)
    np.testing.assert_allclose(found["nis"], np.square(late / STD).sum(-1).mean() / 2, rtol=1e-12)
    np.testing.assert_allclose(
        found["nees_beyond"], (np.square(late / STD).sum(-1) > chi2.ppf(0.95, 3)).mean(), rtol=1e-12
    )
    np.testing.assert_allclose(
        found["nis_beyond"], (np.square(late / STD).sum(-1) > chi2.ppf(0.95, 2)).mean(), rtol=1e-12
    )
    whole = merge(blocks)
    np.testing.assert_allclose(
        whole["square"] / whole["count"][:, None], squares(GROUPS, error).mean(1), rtol=1e-12
    )
    assert found["runs"] == 50


def test_one_block_is_merged_with_nothing_and_no_block_is_refused():
    one = scored(errors(5))[0]
    assert all(np.array_equal(merge([one])[name], one[name]) for name in one)
    with pytest.raises(ValueError, match="block"):
        merge([])
    with pytest.raises(ValueError, match="epochs"):
        merge([one, scored(errors(5, K=7))[0]])


def test_intervals_cover_the_truth_as_often_as_they_say():
    found = [summed_up(scored(errors(40, K=4, seed=s))[0]) for s in range(600)]
    truth = np.sqrt(5.0)
    inside = np.mean([f["position_low_km"] <= truth <= f["position_high_km"] for f in found])
    assert abs(inside - 0.95) < 0.03
    assert abs(np.mean([f["anees_low"] <= 1.0 <= f["anees_high"] for f in found]) - 0.95) < 0.03
    band = [
        f["band_low"]
        <= np.square(errors(40, K=4, seed=s)[-1] / STD).sum(-1).mean() / 3
        <= f["band_high"]
        for s, f in enumerate(found)
    ]
    assert abs(np.mean(band) - 0.95) < 0.03


def test_few_values_are_beyond_their_quantile_for_a_consistent_filter_and_many_for_another():
    beyond, every = scored(errors(3000))[0]["nees_beyond"]
    assert every == 4 * 3000
    assert abs(beyond / every - 0.05) < 0.01
    assert scored(3.0 * errors(3000))[0]["nees_beyond"][0] > 5 * beyond


def test_the_settled_epochs_begin_where_they_are_said_to():
    error = errors(10)
    error[:6] *= 100.0
    early, late = (
        summed_up(scored(error, settle_s=0.0)[0]),
        summed_up(scored(error, settle_s=6.0)[0]),
    )
    assert early["position_rms_km"] > 10 * late["position_rms_km"]
    np.testing.assert_allclose(
        late["position_rms_km"], np.sqrt(np.square(error[6:, :, :2]).sum(-1).mean()), rtol=1e-12
    )


def test_settling_after_the_end_is_refused():
    with pytest.raises(
        ValueError, match=r"^settle_s: expected a time of at most 7 s, the last epoch, got 7\.5$"
    ):
        scored(errors(3), settle_s=7.5)


def test_lost_runs_and_runs_beyond_their_limit_are_failures_and_not_in_the_sums():
    error = errors(6)
    error[5:, 2] = np.nan
    error[-1, 4, 2] = 1.0  # 1000 m/s
    found, failures = score(
        followed(error, lost=[(2, 5.0, "lost")]), GROUPS, settle_s=None, limits={"rate": 500.0}
    )
    assert [(f.run, f.t, f.why) for f in failures] == [
        (2, 5.0, "lost"),
        (4, 7.0, "rate: error above 500 m/s at the end"),
    ]
    rest = scored(error[:, [0, 1, 3, 5]])[0]
    assert all(np.array_equal(found[name], rest[name]) for name in rest)


def test_an_estimate_that_is_missing_for_an_epoch_is_left_out_there():
    error = errors(4)
    error[5, 1] = np.nan
    found = scored(error)[0]
    assert found["count"].tolist() == [4, 4, 4, 4, 4, 3, 4, 4]
    summary = summed_up(found)
    own = [np.nanmean(np.square(error[4:, r, :2]).sum(-1)) for r in range(4)]
    np.testing.assert_allclose(summary["position_rms_km"], np.sqrt(np.mean(own)), rtol=1e-12)


def test_the_bound_is_compared_over_the_settled_epochs():
    least = np.tile([[4.0, 0.25]], (8, 1))
    least[:4] = 1e6
    found = summed_up(scored(errors(20))[0], least)
    assert found["position_bound_km"] == 2.0
    np.testing.assert_allclose(
        found["rate_efficiency"], 0.5 / found["rate_rms_m_per_s"], rtol=1e-12
    )
    assert np.isnan(summed_up(scored(errors(20))[0])["position_bound_km"])


def test_one_run_has_no_interval_and_no_run_has_no_accuracy():
    one = summed_up(scored(errors(1))[0])
    assert np.isfinite(one["position_rms_km"])
    assert np.isnan(one["position_low_km"])
    none = summed_up(
        score(followed(errors(1), lost=[(0, 1.0, "lost")]), GROUPS, settle_s=None, limits={})[0]
    )
    assert none["runs"] == 0
    assert np.isnan(none["position_rms_km"])


def test_errors_count_where_the_filter_has_no_covariance_and_the_others_have_their_consistency():
    error = errors(4)
    error[:, 3] = 50.0
    found = followed(error)
    std, nees = found.std.copy(), found.nees.copy()
    std[:, 3], nees[:, 3] = np.nan, np.nan
    std[0, 3] = STD  # but at one unsettled epoch
    scores, failed = score(found._replace(std=std, nees=nees), GROUPS, settle_s=None, limits={})
    assert [(f.run, f.why) for f in failed] == [
        (3, "no positive definite covariance at any settled epoch")
    ]
    np.testing.assert_array_equal(
        accuracies(summed_up(scores)), accuracies(summed_up(scored(error[:, :3])[0]))
    )
    std[5, 3] = STD  # at a settled epoch too: now it counts
    scores, failed = score(found._replace(std=std, nees=nees), GROUPS, settle_s=None, limits={})
    assert failed == []
    found = summed_up(scores)
    position = np.sqrt(np.square(error[4:, :, :2]).sum(-1).mean())
    np.testing.assert_allclose(found["position_rms_km"], position, rtol=1e-12)
    np.testing.assert_allclose(
        found["anees"], np.square(error[4:, :3] / STD).sum(-1).mean() / 3, rtol=1e-12
    )


def test_a_run_without_an_estimate_where_it_is_judged_is_a_failure_and_no_perfect_run():
    error = errors(4)
    error[4:7, 2] = np.nan  # finite again at the last epoch
    error[7, 2] = 0.1
    found = scored(error, settle_s=4.0)
    assert summed_up(found[0])["runs"] == 4
    error[7, 2] = np.nan
    scores, failed = scored(error, settle_s=4.0)
    assert [(f.run, f.why) for f in failed] == [(2, "no estimate at any settled epoch")]
    others = summed_up(scored(error[:, [0, 1, 3]], settle_s=4.0)[0])
    np.testing.assert_array_equal(accuracies(summed_up(scores)), accuracies(others))
