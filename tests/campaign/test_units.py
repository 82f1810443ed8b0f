"""Work units: their keys, and the treatment of runs that fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from celnav.campaign import units
from celnav.campaign.missions import study
from celnav.campaign.scores import merge
from celnav.campaign.units import VersionError, code, execute, read, units_of
from celnav.filters.records import FromFunctions
from celnav.papers import csrukf
from celnav.study.montecarlo import generator
from celnav.study.study import Unit
from celnav.tape.cuda import CudaError

TABLE = {
    "paper": "csrukf",
    "filters": ["srukf", "csrukf"],
    "runs": 10,
    "block": 4,
    "config": {"steps": 12, "phi": [0.0, 0.8]},
}


@pytest.fixture
def unit():
    return units_of(study(TABLE))[1][0]


@pytest.fixture
def broken(monkeypatch):
    """Let the paper's trial, or one of its filters, raise an error in the runs whose first true
    position is in a set.
    """

    def use(where, runs):
        original = csrukf.trial
        config = csrukf.PRESETS["P"]
        marks = {
            r: original(replace(config, steps=1), [generator(0, units.STUDY, r)]).prior.mean[0, 0]
            for r in runs
        }

        def trial(config, rngs):
            made = original(config, rngs)
            hit = np.isin(made.prior.mean[:, 0], list(marks.values())).any()
            if where == "trial" and hit:
                raise ValueError("the orbit ends in the ground")

            def step(state, epoch):
                if hit and epoch.k == 3:
                    raise ValueError("no such star")
                return made.filters["csrukf"].step(state, epoch)

            raising = (
                {"csrukf": FromFunctions(made.filters["csrukf"].start, step)}
                if where == "filter"
                else {}
            )
            return made._replace(filters={**made.filters, **raising})

        monkeypatch.setattr(csrukf, "trial", trial)

    return use


def test_units_cover_all_runs_of_all_configurations_in_order():
    plan = units_of(study(TABLE))
    assert [[u.runs for u in part] for part in plan] == [[range(4), range(4, 8), range(8, 10)]] * 2
    assert len({u.key for part in plan for u in part}) == 6


def first(**change):
    return units_of(study(TABLE | change))[0][0]


def test_the_key_is_that_of_what_determines_the_result():
    assert first(runs=77).key == first().key
    assert first(config=TABLE["config"] | {"phi": [0.0]}).key == first().key
    others = [
        {"paper": "ssukf", "filters": ["ssukf"], "config": {}},
        {"filters": ["srukf"]},
        {"seed": 1},
        {"block": 5},
        {"every": 2},
        {"settle_s": 1.0},
        {"limits": {"position": 1.0}},
        {"engine": "numpy"},
        {"config": TABLE["config"] | {"phi": 0.81}},
    ]
    assert len({first().key, *(first(**change).key for change in others)}) == 10


def changed(unit, **change):
    """A unit with other work."""
    return unit._replace(work=unit.work._replace(work=replace(unit.work.work, **change)))


def flown(unit):
    """The results of a unit, read from its arrays."""
    return read(execute(unit, code()), unit.work.work.filters)


def failures(found, name):
    """The reasons why runs of a filter failed, and their number."""
    return {why: count for (filter, why), count in found.reasons.items() if filter == name}


def test_a_unit_gives_the_same_numbers_again_and_survives_packing(unit):
    one, two = (flown(unit) for _ in range(2))
    again = read(one.arrays(unit.work.work.filters), unit.work.work.filters)
    assert set(one.scores) == {"srukf", "csrukf"}
    for name, scores in one.scores.items():
        for stat, value in scores.items():
            np.testing.assert_array_equal(value, two.scores[name][stat])
            np.testing.assert_array_equal(value, again.scores[name][stat])
    np.testing.assert_array_equal(one.bound, again.bound)
    assert (again.groups, again.reasons, again.steps) == (one.groups, one.reasons, one.steps)
    assert one.groups == (("position", "km"), ("velocity", "m/s"))
    assert one.steps == {"srukf": 4 * 13, "csrukf": 4 * 13}


def test_a_result_is_as_small_for_many_runs_as_for_few(unit):
    few, many = (execute(unit._replace(runs=range(last)), code()) for last in (2, 40))
    assert {n: a.shape for n, a in few.items()} == {n: a.shape for n, a in many.items()}


def test_only_the_first_block_knows_the_bound():
    plan = units_of(study(TABLE))[0]
    assert [flown(u).bound is None for u in plan] == [False, True, True]


def test_a_run_that_raises_in_a_filter_fails_alone(unit, broken):
    broken("filter", {2})
    found = flown(unit)
    assert found.reasons == {("csrukf", "ValueError: no such star"): 1}
    assert found.scores["csrukf"]["runs"] == 3
    assert "no such star" in found.trace
    singles = [flown(unit._replace(runs=range(r, r + 1))).scores["csrukf"] for r in (0, 1, 3)]
    np.testing.assert_allclose(
        found.scores["csrukf"]["square"], merge(singles)["square"], rtol=1e-9
    )


def test_a_run_that_cannot_be_simulated_fails_in_every_filter(unit, broken):
    broken("trial", {1})
    found = flown(unit)
    for name in TABLE["filters"]:
        assert failures(found, name) == {"ValueError: the orbit ends in the ground": 1}
        assert found.scores[name]["runs"] == 3
    assert [name for name, _ in found.groups] == ["position", "velocity"]


def test_a_unit_of_failures_only_has_no_scores_but_reasons(unit, broken):
    broken("trial", range(4))
    found = flown(unit)
    assert found.scores == {}
    assert found.groups == ()
    assert [sum(failures(found, name).values()) for name in TABLE["filters"]] == [4, 4]


def test_a_filter_that_a_configuration_does_not_have_is_no_failure(unit):
    found = flown(changed(unit, filters=("srukf", "srukf-inflated")))
    assert failures(found, "srukf-inflated") == {}
    assert list(found.scores) == ["srukf"]
    assert found.scores["srukf"]["runs"] == 4


def test_settled_epochs_that_do_not_exist_are_the_reason_of_every_run(unit):
    found = flown(changed(unit, settle_s=1e6))
    for name in TABLE["filters"]:
        ((why, count),) = failures(found, name).items()
        assert count == 4
        assert "settle_s: expected a time of at most" in why


def test_lack_of_memory_is_not_a_failure_of_the_run(unit, monkeypatch):
    def trial(config, rngs):
        raise MemoryError("of this trial")

    monkeypatch.setattr(csrukf, "trial", trial)
    with pytest.raises(MemoryError, match=r"^of this trial$"):
        execute(unit, code())


def test_the_lack_of_a_device_is_not_either(unit, monkeypatch):
    def absent():
        raise CudaError("engine='cuda': expected the driver")

    monkeypatch.setattr("celnav.engine.compiled.device", absent)
    with pytest.raises(CudaError, match="expected the driver"):
        execute(unit._replace(engine="cuda"), code())


def test_another_celnav_is_refused(unit):
    with pytest.raises(
        VersionError, match=r"has celnav \S+, code \w+, this has celnav 9\.9, code abc; install"
    ):
        execute(unit, code() | {"celnav": "9.9", "code": "abc"})
    with pytest.raises(VersionError, match=r"has numpy \S+, this has numpy 1\.0; install"):
        execute(unit, code() | {"numpy": "1.0"})


@pytest.mark.parametrize("paper", ["ssukf", "tstdkf", "aasghqf", "aukf"])
def test_units_of_every_paper_can_be_hashed(paper):
    assert (
        len({u.key for part in units_of(study({"paper": paper, "runs": 250})) for u in part}) == 3
    )
    assert isinstance(units_of(study({"paper": paper}))[0][0], Unit)
