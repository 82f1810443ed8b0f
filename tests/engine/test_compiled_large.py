"""Filters whose steps are too long to be unrolled: models, factorizations and products as loops."""

from __future__ import annotations

import numpy as np
import pytest
from twice import assert_same, twice

import celnav
from celnav.engine.recording import Engine
from celnav.engine.runs import as_data
from celnav.gaussian import recorded
from celnav.tape import numbers
from celnav.tape.tape import CannotCompile

pytestmark = pytest.mark.usefixtures("eager")

pytest.importorskip("llvmlite")

N = 8
TIMES = 0.02 * np.arange(9)
RNG = np.random.default_rng(8)


def ring(x, epoch):
    """A Heun step of the Lorenz-96 system with an input as forcing."""

    def rate(x):
        return (np.roll(x, -1, -1) - np.roll(x, 2, -1)) * np.roll(x, 1, -1) - x + epoch.u

    first = rate(x)
    return x + 0.5 * epoch.dt * (first + rate(x + epoch.dt * first))


def amplitude(x, _epoch):
    return np.hypot(x[..., ::2], x[..., 1::2])


def flight(form="square root", rule=None, noisy=False):
    motion = celnav.Motion(ring, sqrt_Q=0.1 * np.eye(N))
    filter = celnav.sigma_point(
        motion,
        celnav.Sensor(amplitude, np.eye(N // 2)),
        rule=rule or celnav.unscented(N),
        form=form,
    )
    z = 8.0 + RNG.standard_normal((len(TIMES), 5, N // 2))
    if noisy:
        z[RNG.random(z.shape) < 0.3] = np.nan
    prior = celnav.Gaussian(8.0 + RNG.standard_normal((5, N)), np.eye(N))
    return filter, prior, celnav.epochs(TIMES, z, u=list(np.linspace(7.0, 8.75, len(TIMES) - 1)))


def calls(filter, prior, epochs):
    """Loops in the step with a prediction."""
    data = as_data(filter, epochs)
    engine = Engine(filter, prior, data)
    kind = data.distinct[data.kinds[-1]]
    kernel = engine.record(engine.begin, kind, engine.inputs(data.u[kind.u], len(epochs))).kernel
    return {op[1] for op in kernel.tape.ops if op[0] == "call"}


@pytest.mark.parametrize(
    "rule", [celnav.unscented(N, alpha=1.0, kappa=1.0), celnav.cubature(N), celnav.smolyak(N, 2)]
)
@pytest.mark.parametrize(("form", "noisy"), [("square root", True), ("covariance", False)])
def test_a_model_is_a_loop_over_the_points(rule, form, noisy):
    filter, prior, epochs = flight(form, rule, noisy)
    assert calls(filter, prior, list(epochs))
    assert_same(*twice(filter, prior, epochs))


@pytest.mark.parametrize("form", ["square root", "covariance"])
def test_factorizations_and_products_are_loops_where_they_are_long(form, monkeypatch):
    filter, prior, epochs = flight(form, noisy=True)
    before = calls(filter, prior, list(epochs))
    for module, name in (
        (recorded, "LONG"),
        (recorded, "LONG_SOLUTION"),
        (numbers, "LONG_PRODUCT"),
    ):
        monkeypatch.setattr(module, name, 500)
    assert len(calls(filter, prior, list(epochs))) > len(before)
    assert_same(*twice(filter, prior, epochs))


def test_what_is_too_long_is_left_to_numpy_unless_it_is_asked_for(monkeypatch):
    filter, prior, epochs = flight()
    monkeypatch.setattr("celnav.engine.compiled.operation_limit", lambda *_work: 1000)
    monkeypatch.setattr("celnav.engine.compiled.EXPECTED_OPERATIONS", (0, 0))
    track = celnav.run(filter, prior, epochs, engine="auto")
    assert track.engine.startswith("numpy: a step of ")
    assert "at most 1000 are compiled" in track.engine
    assert celnav.run(filter, prior, epochs, engine="compiled").engine == "compiled"
    monkeypatch.setattr("celnav.engine.compiled.MOST", 1000)
    with pytest.raises(
        CannotCompile, match="operations takes longer than it saves: at most 1000 are compiled"
    ):
        celnav.run(flight()[0], prior, epochs, engine="compiled")
