"""Studies: parts in blocks, results by name, decisive numbers, parameters with checks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from multiprocessing.reduction import ForkingPickler

import numpy as np
import pytest

import celnav
from celnav.study.ledger import Number, Row
from celnav.study.numbers import (
    all_of,
    consistency,
    constant,
    correlation,
    count_holding,
    entries,
    lagged,
    of,
    operations,
    over,
    over_time,
    ratio,
    rmse,
    settling,
    some,
    tiers,
)
from celnav.study.parameters import Parameters, Timed, param
from celnav.study.problem import Problem
from celnav.study.study import (
    START_S,
    Part,
    Study,
    Unit,
    evaluate_filters,
    evaluate_from_priors,
    monte_carlo,
)
from celnav.study.trial import Group

GROUPS = (Group("position", "m", slice(0, 1)), Group("velocity", "mm/s", slice(1, 2), 1e3))
F, H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(1, 2)


def problem(sigma):
    motion, sensor = celnav.Motion(F, 0.01 * np.eye(2)), celnav.Sensor(H, sigma**2 * np.eye(1))
    return Problem(
        motion, sensor, celnav.Gaussian(np.zeros(2), np.eye(2)), np.arange(6.0), groups=GROUPS
    )


def trial(sigma, rngs):
    one = problem(sigma)
    filters = {"kf": celnav.ukf(one.motion, one.sensor), "blind": celnav.ukf(one.motion)}
    return one.trial(filters, rngs)


def work(sigma, rngs):
    return evaluate_filters(trial(sigma, rngs), ("kf", "blind"))


def facts(value, rngs):
    return {"values": np.arange(3) * value, "lot": rngs[0].normal(size=2)}


def parts(effort, scale=1.0):
    return {
        "good": Part(work, 0.5, 3, 40, 16, 2.0),
        "bad": Part(work, 5.0, 4, 40, 16),
        "facts": Part(facts, scale, 9),
    }


STUDY = Study(
    "tiny",
    GROUPS,
    trial,
    parts,
    [Row("finding", "one", "It is so", of("facts", "values", "x", (None, 3.0)))],
)


@pytest.fixture(scope="module")
def results():
    return STUDY.reproduce(seed=2)


def test_the_block_size_changes_nothing(results):
    other = replace(STUDY, parts=lambda effort: {"good": Part(work, 0.5, 3, 40, 7)}).reproduce(
        seed=2
    )
    for name in ("kf/error", "blind/std", "kf/nees", "kf/nis"):
        np.testing.assert_allclose(other.get("good", name), results.get("good", name), rtol=1e-12)
    assert results.get("good", "kf/error").shape == (6, 40, 2)
    np.testing.assert_array_equal(results.times("good"), np.arange(6.0))


def test_errors_are_in_the_units_of_the_groups(results):
    sim = trial(0.5, [celnav.study.montecarlo.generator(2, 3, r) for r in range(40)])
    track = celnav.run(sim.filters["kf"], sim.prior, sim.epochs("kf"))
    truth = np.stack([epoch.truth for epoch in sim.epochs("kf")])
    np.testing.assert_allclose(
        results.error("good", "kf", "velocity")[..., 0],
        1e3 * (track.mean - truth)[..., 1],
        rtol=1e-9,
    )
    np.testing.assert_allclose(
        results.error("good", "kf", "position", "std")[..., 0], track.std[..., 0], rtol=1e-9
    )
    np.testing.assert_allclose(results.get("good", "kf/nis"), track.nis, rtol=1e-9)
    assert np.isnan(results.get("good", "blind/nis")).all()


def test_filters_of_a_trial_are_a_part_by_one_call():
    """The call returns the arrays of `evaluate_filters`, also in another process."""
    part = monte_carlo(trial, ("kf",), 2.0, 3, 5, every=2, cov=True)
    assert (part.number, part.runs, part.block, part.cost) == (3, 5, 100, 1.0)
    made = ForkingPickler.loads(ForkingPickler.dumps(part))
    found = made.work(made.config, [np.random.default_rng(i) for i in range(2)])
    runs = trial(2.0, [np.random.default_rng(i) for i in range(2)])
    expected = evaluate_filters(runs, ("kf",), 2, cov=True)
    assert set(found) == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def test_the_effort_scales_runs_and_only_takes_parts():
    units = STUDY.units(effort=0.1, seed=1, only=["good", "facts"])
    assert [(unit.part, len(unit.runs)) for unit in units] == [("good", 4), ("facts", 1)]
    good = [unit.cost for unit in STUDY.units() if unit.part == "good"]
    assert sum(good) == pytest.approx(2.0 + len(good) * START_S)
    with pytest.raises(
        ValueError, match=r"^only: expected one of good, bad, facts, got 'god'; did you mean good"
    ):
        STUDY.units(only=["god"])


def test_a_unit_has_a_key_of_all_that_it_depends_on():
    def keys(**options):
        return {unit.key for unit in STUDY.units(**options)}

    every = [keys(), keys(seed=1), keys(effort=0.5), keys(scale=2.0)]
    assert [len(one) for one in every] == [7, 7, 5, 7]
    assert len(set.union(*every)) == sum(map(len, every))
    assert keys() == keys()


def test_a_warning_of_a_unit_is_an_error():
    unit = Unit(
        "tiny",
        "bad",
        Part(lambda config, rngs: {"x": np.log(np.zeros(2))}, None),
        0,
        range(1),
        "",
        1.0,
    )
    with pytest.raises(RuntimeWarning, match="divide by zero"):
        unit.do()
    with pytest.raises(ValueError, match="expected arrays"):
        unit.check({})


def test_the_first_run_can_be_flown_again(results):
    again = results.first("good")
    track = celnav.run(again.filters["kf"], again.prior, again.epochs("kf"), keep="mean")
    truth = np.stack([epoch.truth for epoch in again.epochs("kf")])
    np.testing.assert_allclose(
        (track.mean - truth)[:, 0, 0], results.error("good", "kf", "position")[:, 0, 0], atol=1e-12
    )


def test_ratios_and_levels_are_those_of_the_runs(results):
    kf, blind = (
        np.square(results.error("good", name, "position")[..., 0]) for name in ("kf", "blind")
    )
    at_end = ratio("x", ("good", "kf"), ("good", "blind"), "position")(results)
    assert at_end.value == pytest.approx(np.sqrt(kf[-1].mean() / blind[-1].mean()))
    assert at_end.ci[0] < at_end.value < at_end.ci[1] < 1.0
    assert over("x", "good", "kf", "blind")(results) == at_end
    late = ratio("x", ("good", "kf"), ("good", "kf"), "position", at=slice(3, None), to=0)(results)
    assert late.value == pytest.approx(np.sqrt(kf[3:].mean() / kf[0].mean()))
    level = rmse("x", ("bad", "kf"), "velocity", (None, 1.0))(results)
    assert level.value == pytest.approx(
        np.sqrt(np.square(results.error("bad", "kf", "velocity")[-1]).mean())
    )
    assert consistency("x", ("good", "kf"), at=slice(None))(results).value == pytest.approx(
        results.get("good", "kf/nees").mean()
    )
    for what in ("nees", "nis"):
        values = results.get("good", f"kf/{what}")
        np.testing.assert_array_equal(results.nees("good", "kf", what=what), values[-1])
        np.testing.assert_array_equal(results.nees("good", "kf", 2, what), values[2])
        some = results.nees("good", "kf", slice(2, 5), what)
        np.testing.assert_allclose(some, values[2:5].mean(0), rtol=1e-14)


def test_a_table_is_in_its_band_or_of_its_level_or_neither(results):
    exact = np.sqrt(np.concatenate([results.squares("good", "kf", g.name).mean(0) for g in GROUPS]))
    for factor, verdict in ((1.0, "reproduced"), (2.0, "level only"), (9.0, "not reproduced")):
        decide = entries(
            [(("good", "kf"), factor * exact)], ("position", "velocity"), "reproduced", 10, 0
        )
        assert Row("statement", "t", "A table", decide).judged(results).verdict == verdict
        (level,) = decide(results)["level only"]
        assert level.value == pytest.approx(factor)
        assert level.accept == (None, pytest.approx(np.sqrt(10.0), rel=0.02))  # half a decade


def test_a_correlation_is_the_cosine_of_two_columns():
    """About zero, all components together, whatever their units."""
    rng = np.random.default_rng(0)
    a, b = rng.normal(0.3, 2.0, (2, 50, 3))
    assert correlation(a, 7.0 * a) == pytest.approx(1.0)
    assert correlation(3.0 * a, -0.1 * a) == pytest.approx(-1.0)
    cosine = np.dot(a.ravel(), b.ravel()) / np.linalg.norm(a) / np.linalg.norm(b)
    assert correlation(a, b) == pytest.approx(cosine)
    assert correlation(100.0 * a, b) == pytest.approx(cosine)
    assert correlation(np.array([1.0, -1.0]), np.array([1.0, 1.0])) == 0.0


def test_a_column_and_itself_later():
    values = np.arange(10.0).reshape(5, 2)
    now, later = lagged(values, 2)
    np.testing.assert_array_equal(now, values)
    np.testing.assert_array_equal(later[:3], values[2:])
    assert np.isnan(later[3:]).all()
    np.testing.assert_array_equal(lagged(values)[1][:4], values[1:])


def test_a_statistic_over_time_leaves_out_what_is_not_known(results):
    """AR(1) noise with two components: the correlation after some epochs, from
    the 100th epoch on.
    """
    rng, phi = np.random.default_rng(1), 0.8
    x = rng.normal(size=(3100, 2))
    for k in range(1, len(x)):
        x[k] = phi * x[k - 1] + np.sqrt(1.0 - phi**2) * x[k]
    x[:100] = 1e3
    x[500, 0] = x[2000:2010, 1] = np.nan
    for lag in (1, 3):
        found = over_time(
            "x", correlation, lambda _, lag=lag: lagged(x, lag), (0.0, 1.0), start=100, block=50
        )(results)
        a, b = x[100:-lag], x[100 + lag :]
        known = np.isfinite(a).all(1) & np.isfinite(b).all(1)
        a, b = a[known], b[known]
        assert found.value == pytest.approx((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))
        # Bartlett: the standard deviation is below sqrt((1 + phi^2) / (1 - phi^2) / T).
        assert abs(found.value - phi**lag) < 4.0 * np.sqrt(4.6 / 6000)
        low, high = found.ci
        assert low < found.value < high
        assert high - low < 8.0 * np.sqrt(4.6 / 6000)
        assert found.accept == (0.0, 1.0)


def test_the_interval_of_a_statistic_over_time_is_that_of_correlated_epochs(results):
    """The mean of AR(1) noise has the variance (1 + phi) / (1 - phi) / T; with independent epochs
    it would be 1 / T.
    """
    rng, phi, steps = np.random.default_rng(3), 0.8, 6000
    x = rng.normal(size=steps)
    for k in range(1, steps):
        x[k] = phi * x[k - 1] + np.sqrt(1.0 - phi**2) * x[k]
    found = over_time("x", np.mean, lambda _: [x], block=100)(results)
    width = 2.0 * 1.96 * np.sqrt((1.0 + phi) / (1.0 - phi) / steps)
    assert found.ci[1] - found.ci[0] == pytest.approx(width, rel=0.2)
    assert found.runs == 0  # epochs are no runs that a paper's could be counted against


def test_when_an_error_settles(results):
    """From the epoch after the last one at which the RMSE of the runs is above the level."""
    rmse_kf, rmse_blind = (
        np.sqrt(np.square(results.error("good", name, "position")).mean((1, 2)))
        for name in ("kf", "blind")
    )
    level = float(np.sort(rmse_kf)[3])
    after = float(np.flatnonzero(rmse_kf >= level)[-1] + 1)
    kf, blind = ("good", "kf"), ("good", "blind")
    assert settling("x", kf, "position", level)(results).value == after
    assert 0.0 < after < 6.0
    assert settling("x", kf, "position", 0.0)(results).value == 6.0  # never, in six epochs
    assert settling("x", kf, "position", 1e9)(results).value == 0.0
    assert rmse_blind[-1] > level
    sooner = settling("x", kf, "position", level, sooner=blind)(results)
    assert sooner.value == after - 6.0
    start = settling("x", kf, "position", 1e9, window=slice(2, 5))(results)
    assert start.value == 2.0
    assert settling("x", kf, "position", 0.0, window=slice(2, 5))(results).value == 5.0


def test_medians_and_components(results):
    kf, blind = (
        np.square(results.error("good", name, "position")[-1, :, 0]) for name in ("kf", "blind")
    )
    found = ratio("x", ("good", "kf"), ("good", "blind"), "position", median=True)(results)
    assert found.value == pytest.approx(np.sqrt(np.median(kf) / np.median(blind)))
    both = Group("both", "m", slice(0, 2))
    error = np.random.default_rng(4).normal(size=(6, 40, 2))

    class Two:
        """Results of one group of two components."""

        def squares(self, part, name, group, at):
            assert (part, name, group) == ("good", "kf", both.name)
            return np.square(error[at])

    one = rmse("x", ("good", "kf"), "both")(Two())
    assert one.value == pytest.approx(np.sqrt(np.square(error[-1]).sum(-1).mean()))
    each = rmse("x", ("good", "kf"), "both", each=True)(Two())
    assert each.value == pytest.approx(np.sqrt(np.square(error[-1]).mean()))
    second = ratio("x", ("good", "kf"), ("good", "kf"), "both", at=2, to=3, axes=slice(1, 2))(Two())
    assert second.value == pytest.approx(
        np.linalg.norm(error[2, :, 1]) / np.linalg.norm(error[3, :, 1])
    )


def test_filters_from_several_priors_are_those_from_each():
    """With one covariance, or with one for each run."""
    one = trial(0.5, [celnav.study.montecarlo.generator(1, 0, r) for r in range(4)])
    mean, cov = np.arange(8.0).reshape(4, 2), np.arange(1.0, 5.0)[:, None, None] * np.eye(2)
    priors = {"shared": one.prior, "own": celnav.Gaussian(mean, cov)}
    found = evaluate_from_priors(one, priors, ("kf", "blind"))
    for label, prior in priors.items():
        alone = evaluate_filters(one._replace(prior=prior), ("kf", "blind"))
        np.testing.assert_array_equal(found["times"], alone.pop("times"))
        for key, values in alone.items():
            name, what = key.split("/")
            np.testing.assert_allclose(
                found[f"{name}, {label}/{what}"], values, rtol=1e-12, err_msg=key
            )


def test_numbers_go_together(results):
    both = all_of(constant("a", 2.0), of("facts", "values", "b", reduce=np.sum))(results)
    assert [number.value for number in both] == [2.0, 3.0]
    assert list(tiers(in_part=[constant("a", 1.0)])(results)) == ["in part"]
    assert [claim.verdict for claim in results.claims()] == ["shown"]


@dataclass(frozen=True)
class Config(Timed):
    """Something."""

    step_s: float = param(1.0, "paper", "interval", above=0.0)
    runs: int = param(3, "chosen: why not", "how many", least=1)
    kind: str | None = param(None, "inferred", "which", one_of=("a", "b", None))
    shape: tuple[float, float] = param((1.0, 2.0), "paper", "of it", least=0.0)
    loud: bool = param(False, "chosen", "whether")

    def check(self):
        if self.step_s > self.runs:
            raise ValueError(f"step_s: expected at most {self.runs}, got {self.step_s}")

    @property
    def times(self):
        return self.step_s * np.arange(self.runs + 1)


def test_a_configuration_says_when_its_epochs_are():
    assert (Config().samples, Config().end_s) == (3, 3.0)
    with pytest.raises(TypeError, match="times"):
        dataclass(frozen=True)(type("Timeless", (Timed,), {}))()
    assert not hasattr(Parameters, "times")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step_s": 0.0}, r"^step_s: expected a positive number, got 0.0"),
        ({"step_s": np.nan}, r"^step_s: expected a positive number"),
        ({"runs": 1.5}, r"^runs: expected a positive integer, got 1.5"),
        ({"kind": "c"}, r"^kind: expected one of a, b, got 'c'"),
        ({"shape": (1.0, -2.0)}, r"^shape: expected a number of at least 0, got -2"),
        ({"shape": (1.0,)}, r"^shape: expected shape"),
        ({"loud": 3}, r"^loud: expected one of True, False"),
        ({"step_s": 4.0}, r"^step_s: expected at most 3"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        Config(**change)


def test_a_configuration_knows_its_length():
    assert (Config().samples, Config(step_s=0.5).end_s) == (3, 1.5)
    with pytest.raises(ValueError, match=r"^source: expected one of paper, inferred, chosen"):
        param(1.0, "guessed", "x")


def test_operations_are_compared_as_the_part_has_counted_them():
    class Counted:
        def get(self, part, name):
            assert part == "operations"
            return np.array([{"ukf": 600, "ekf": 200}[name]])

    assert operations("x", "ukf", "ekf", (None, 2.0))(Counted()) == Number("x", 3.0, (None, 2.0))
    assert operations("x", "ukf", "ekf", compare=np.subtract)(Counted()).value == 400.0


def test_numbers_that_hold_are_counted_for_sure_and_perhaps():
    sure, open_, bad = (Number("x", 0.5, (0.0, 1.0), ci) for ci in (None, (0.5, 1.5), (2.0, 3.0)))
    numbers = [sure, open_, bad, sure]
    assert count_holding("n", numbers, (2, None))[1:4] == (2.0, (2, None), (2.0, 3.0))
    assert count_holding("n", numbers, (2, None), leading=True)[1:4] == (1.0, (2, None), (1.0, 2.0))
    decided = some("n", 2, [lambda _, number=number: number for number in numbers])(None)
    assert decided == Number("n", 2, (2, None))


def test_a_window_of_a_study_without_windows_is_an_error_with_a_cure():
    study = Study("none", GROUPS, trial, lambda _effort: {"usual": Part(runs, None, runs=4)}, [])
    with pytest.raises(ValueError, match=r"no windows, got 'late'; give Study windows="):
        study.reproduce(only=["usual"]).squares("usual", "kf", "position", "late")


def runs(_config, rngs):
    return evaluate_filters(trial(1.0, rngs), ["kf"])
