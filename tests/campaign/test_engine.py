"""The campaign engine with any executor, any order, and workers that die."""

from __future__ import annotations

import random
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager

import pytest

from celnav.campaign import (
    UnfinishedError,
    VersionError,
    campaign,
    from_executor,
    processes,
    serial,
)
from celnav.campaign.engine import ATTEMPTS, compute
from celnav.campaign.executors import Workers
from celnav.campaign.missions import study
from celnav.campaign.table import columns, to_csv
from celnav.campaign.units import units_of

TABLE = {
    "paper": "csrukf",
    "filters": ["srukf", "csrukf"],
    "runs": 12,
    "block": 3,
    "config": {"steps": 6, "phi": [0.0, 0.8]},
}


def csv(outcome):
    return to_csv(columns(outcome.rows))


@pytest.fixture(scope="module")
def wanted(tmp_path_factory):
    return csv(campaign(study(TABLE), tmp_path_factory.mktemp("wanted")))


@pytest.fixture
def plan():
    return [unit for units in units_of(study(TABLE)) for unit in units]


class Shuffled(Executor):
    """An executor that works in last-in, first-out or any other order, and has only ``submit``."""

    def __init__(self, seed):
        self._random = random.Random(seed)
        self._waiting = []

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        self._waiting.append((future, fn, args))
        if len(self._waiting) == 8:
            self._random.shuffle(self._waiting)
            for one, function, arguments in self._waiting:
                one.set_result(function(*arguments))
        return future


@pytest.mark.parametrize("seed", range(3))
def test_any_order_of_completion_gives_the_same_table(wanted, tmp_path, seed):
    assert csv(campaign(study(TABLE), tmp_path, from_executor(Shuffled(seed)))) == wanted


def test_an_executor_of_threads_gives_the_same_table(wanted, tmp_path):
    with ThreadPoolExecutor(2) as pool:
        assert csv(campaign(study(TABLE), tmp_path, from_executor(pool))) == wanted


def mortal(lives, dies=lambda unit: True, opened=None):
    """Executors whose worker dies after some units, or at each try of one unit: then all submitted
    work is lost.
    """
    deaths = []

    class Mortal(Executor):
        def __init__(self):
            self._left = lives

        def submit(self, fn, /, unit, *args):
            future = Future()
            if self._left == 0 and dies(unit):
                deaths.append(unit)
                future.set_exception(BrokenExecutor("a worker died"))
            else:
                self._left = max(self._left - 1, 0)
                future.set_result(fn(unit, *args))
            return future

    @contextmanager
    def start():
        if opened is not None:
            opened.append(1)
        yield Mortal()

    return Workers(start, 2), deaths


def test_work_goes_on_after_workers_die(wanted, tmp_path):
    workers, deaths = mortal(3)
    assert csv(campaign(study(TABLE), tmp_path, workers)) == wanted
    assert len(deaths) >= 2


def test_a_unit_that_kills_its_workers_is_told_and_the_others_are_done(plan):
    poison = plan[2]
    workers, deaths = mortal(0, lambda unit: unit == poison)
    kept = []
    with pytest.raises(
        UnfinishedError,
        match=rf"^1 unit is not done: csrukf: {poison.part}, runs 6 to 8 \(its worker dies\)$",
    ):
        compute(plan, workers, lambda unit, result: kept.append(unit))
    assert set(kept) == set(plan) - {poison}
    assert len(deaths) <= len(plan) + ATTEMPTS


def test_what_was_done_when_a_worker_died_is_kept(plan):
    class Half(Executor):
        """An executor that waits for four units, then does all but the first, whose worker dies."""

        def __init__(self):
            self._waiting = []

        def submit(self, fn, /, *args):
            self._waiting.append((Future(), fn, args))
            if len(self._waiting) == 4:
                (first, _, _), *rest = self._waiting
                for future, function, arguments in rest:
                    future.set_result(function(*arguments))
                first.set_exception(BrokenExecutor("a worker died"))
            return self._waiting[-1][0]

    kept = []
    executors = [Half(), None]

    @contextmanager
    def start():
        yield executors.pop(0) or stack

    with ThreadPoolExecutor(1) as stack:
        compute(plan, Workers(start, 4), lambda unit, result: kept.append(unit))
    assert kept[:3] == plan[1:4]
    assert len(kept) == len(set(kept)) == len(plan)


def test_workers_that_always_die_end_it(plan):
    opened = []
    workers, _ = mortal(0, opened=opened)
    with pytest.raises(UnfinishedError, match=r"^8 units are not done: .* and 5 more$"):
        compute(plan, workers, lambda unit, result: None)
    assert len(opened) == ATTEMPTS + len(plan)


def failing(error):
    class Failing(Executor):
        def submit(self, fn, /, unit, *args):
            future = Future()
            if unit.runs.start == 3:
                future.set_exception(error)
            else:
                future.set_result(fn(unit, *args))
            return future

    return from_executor(Failing())


def test_units_that_fail_are_told_after_all_others_are_done(plan):
    kept = []
    with pytest.raises(
        UnfinishedError,
        match=r"^2 units are not done: csrukf: \w+, runs 3 to 5 \(MemoryError\); csrukf: \w+, runs 3 to 5",
    ):
        compute(plan, failing(MemoryError()), lambda unit, result: kept.append(unit))
    assert len(kept) == len(plan) - 2


def test_another_version_ends_it_at_once(plan):
    kept = []
    with pytest.raises(VersionError, match="other"):
        compute(plan, failing(VersionError("other")), lambda unit, result: kept.append(unit))
    assert len(kept) < len(plan)


def test_a_cluster_that_drops_the_work_is_told(plan):
    with pytest.raises(OSError, match="dropped the work"):
        compute(plan, failing(CancelledError()), lambda unit, result: None)


def test_what_cannot_be_kept_ends_it(plan):
    def keep(unit, result):
        raise OSError(28, "no space left to write the file", "units/x.npz")

    with pytest.raises(OSError, match="no space left"):
        compute(plan, serial(), keep)


@pytest.mark.parametrize("jobs", [0, -1, 1.5])
def test_a_number_of_processes_that_cannot_be_is_refused(jobs):
    with pytest.raises(ValueError, match=r"^jobs: expected a positive integer"):
        processes(jobs)


def test_an_executor_that_cannot_be_opened_again_is_told_and_what_it_did_is_kept(plan):
    class Broken(Executor):
        """An executor that does three units, then raises an error."""

        left = 3

        def submit(self, fn, /, unit, *args):
            if not self.left:
                raise BrokenExecutor("the machine is gone")
            self.left -= 1
            future = Future()
            future.set_result(fn(unit, *args))
            return future

    kept = []
    with pytest.raises(
        OSError, match=r"the executor is broken \(BrokenExecutor: the machine is gone\)"
    ):
        compute(plan, from_executor(Broken()), lambda unit, result: kept.append(unit))
    assert kept == plan[:3]
