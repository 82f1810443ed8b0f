"""An argument that one engine rejects is rejected by the other with the same message."""

from __future__ import annotations

import warnings
from itertools import product

import numpy as np
import pytest
import test_arguments
import test_wrong_filter_arguments as doors
from twice import told

import celnav
from celnav.tape.tape import CannotCompile, place_of

pytestmark = pytest.mark.usefixtures("eager")

pytest.importorskip("llvmlite")

RUN = celnav.run
NOT_COMPILED = {
    "two_stage",
    "strong_tracking",
    "Differenced",
    "least_squares",
    "least_squares of",
    "group_parity",
    "channel_parity",
}
"""Cases whose models inspect the values of their arguments."""
DATA = {
    ("epoch", "k"),
    ("epoch", "t"),
    ("epoch", "dt"),
    ("epoch", "u"),
    ("epoch", "z"),
    ("epochs", "u"),
    ("run", "u"),
    ("Taylor", "about"),
}
"""Arguments that need not be numbers for numpy, which does not use them, or not at all epochs."""


@pytest.fixture
def compiled(monkeypatch):
    """A switch to the other engine for all calls of `celnav.run` without an engine."""

    def switched(on):
        monkeypatch.setattr(
            celnav,
            "run",
            (lambda *a, **more: RUN(*a, **({"engine": "compiled"} | more))) if on else RUN,
        )

    return switched


def outcomes(compiled, call, make):
    """How a call ends with either engine, with new arguments for each."""
    found = []
    for on in (False, True):
        compiled(on)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found.append(told(call, **make()))
    compiled(False)
    return found


@pytest.mark.parametrize("door", [door for door in doors.DOORS if door not in NOT_COMPILED])
def test_wrong_arguments_end_alike(door, compiled):
    """An argument that numpy rejects gives the same message; an argument that numpy accepts is
    compiled, or a message says that it cannot be.
    """
    call, good = doors.DOORS[door]
    if door == "run":
        good = {name: value for name, value in good.items() if name not in ("also", "reduce")}
    known, found = outcomes(compiled, call, lambda: good)
    assert known == found == ""
    for argument, (what, wrong) in product(good, doors.WRONG.items()):
        if (door, argument) in DATA:
            continue
        value = (
            (lambda: (i for i in range(3))) if what == "generator" else (lambda wrong=wrong: wrong)
        )
        known, found = outcomes(
            compiled, call, lambda argument=argument, value=value: good | {argument: value()}
        )
        if known != found:
            assert (known, found[:14]) == ("", "CannotCompile:"), (argument, what)


def test_arguments_that_are_told_alike(compiled):
    """The cases of another file, unchanged."""
    compiled(True)
    for mark in test_arguments.test_other_arguments.pytestmark:
        for make, text in mark.args[1]:
            assert text in told(make)
    test_arguments.test_batches_that_do_not_go_together()
    test_arguments.test_what_is_masked_is_missing()
    for name in ("f", "h"):
        test_arguments.test_a_model_of_the_interval_raises_one_clear_message(name, "compiled")
    test_arguments.test_a_model_that_fails_for_another_reason_raises_its_own_error()


@pytest.mark.parametrize("runs", [(), (4,)])
def test_models_of_one_vector_are_told_alike(runs, compiled):
    marks = {
        mark.args[0]: mark
        for mark in test_arguments.test_a_model_of_one_vector_is_told_what_points_are.pytestmark
    }
    compiled(True)
    for model in marks["model"].args[1]:
        test_arguments.test_a_model_of_one_vector_is_told_what_points_are(model, runs)


def divided(x, epoch):
    return x / (1 / 0)


def beyond(x, epoch):
    return x[..., [0, 5]]


def short(x, epoch):
    return x[..., :1]


def unknown(x, epoch):
    return {}["x"]


def nothing(x, epoch):
    return None


def text(x, epoch):
    return "x"


@pytest.mark.parametrize("model", [divided, beyond, short, unknown, nothing, text])
def test_models_that_are_at_fault_end_alike(model, compiled):
    arguments = celnav.Gaussian(np.zeros((3, 2)), np.eye(2)), doors.TIMES, np.ones((3, 2))
    for motion, sensor in (
        (celnav.Motion(model, np.eye(2)), doors.SENSOR),
        (doors.MOTION, celnav.Sensor(model, np.eye(2))),
    ):
        filter = celnav.ukf(motion, sensor)
        known, found = (
            told(RUN, filter, *arguments, engine=engine) for engine in ("numpy", "compiled")
        )
        assert known == found
        assert known != "" or model is short


@pytest.mark.parametrize("epochs", [None, 3.0])
def test_what_is_no_sequence_of_epochs_is_told_alike(epochs):
    filter, prior = (
        celnav.ukf(doors.MOTION, doors.SENSOR),
        celnav.Gaussian(np.zeros((3, 2)), np.eye(2)),
    )
    known, *found = (
        told(RUN, filter, prior, epochs, engine=engine) for engine in ("numpy", "compiled", "auto")
    )
    assert found == [known, known]
    assert known.startswith("ValueError: ")


def test_an_epoch_without_a_number_is_left_to_numpy():
    filter, prior = (
        celnav.ukf(doors.MOTION, doors.SENSOR),
        celnav.Gaussian(np.zeros((3, 2)), np.eye(2)),
    )
    epochs = [
        celnav.Epoch(None, 0.0, 0.0, None, np.ones((3, 2))),
        celnav.Epoch(None, 1.0, 1.0, None, np.ones((3, 2))),
    ]
    assert (
        told(RUN, filter, prior, epochs, engine="compiled")
        == "CannotCompile: epochs: expected numbers k, got None"
    )
    assert RUN(filter, prior, epochs, engine="auto").engine.startswith(
        "numpy: epochs: expected numbers k"
    )


def test_the_line_that_is_named_is_the_users():
    motion = celnav.Motion(_asks_inside, np.eye(2))
    with pytest.raises(CannotCompile, match=r" \(test_compiled_arguments\.py, line \d+: .*float"):
        celnav.run(
            celnav.ukf(motion),
            celnav.Gaussian([0.0, 1.0], np.eye(2)),
            np.arange(3.0),
            engine="compiled",
        )
    assert place_of([(np.__file__, 3), (celnav.__file__, 2), ("<stdin>", 1)]) == ""


def _asks_inside(x, epoch):
    return x * float(x[0, 0])
