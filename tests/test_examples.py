"""The examples in docstrings run: all examples of public names and of all other docstrings."""

from __future__ import annotations

import doctest
import re
from functools import cache
from importlib import import_module
from operator import attrgetter
from pathlib import Path

import numpy as np
import pandas
import pytest
from filterpy.kalman import MerweScaledSigmaPoints

import celnav
from celnav.analysis import metrics
from celnav.models import orbit

ROOT = Path(celnav.__file__).parent
NAMES = re.findall(
    r"\.\. auto(?:function|class):: celnav\.([\w.]*)",
    "".join(
        path.read_text(encoding="utf-8")
        for path in sorted((ROOT.parent / "docs" / "reference").glob("*.md"))
    ),
)
WITHOUT = {  # records that are given, not made; what they are part of has the example
    "gaussian.spaces.Space",
    "analysis.diagnose.Diagnosis",
    "filters.sequential.Iterated",
    "filters.records.Filter",
    "filters.dropin.SquareRootUKF",
    "FilterError",
    "study.study.Study",
    "study.study.Results",
    "study.ledger.Claim",
    "show.reading.Recorded",
    "show.reading.Entity",
}
GIVEN = ("de440.bsp", "EGM2008.gfc", "csrukf", "finding(")  # files and studies of others
PLAIN = {"analysis", "filters", "gaussian", "models", "study"}


def examples():
    """Every docstring with an example, by module and line; found in the module's text, whatever
    object it belongs to.
    """
    for path in sorted(ROOT.rglob("*.py")):
        if path.relative_to(ROOT).parts[0] in PLAIN:
            text = path.read_text(encoding="utf-8")
            if ">>> " in text:
                name = ".".join(("celnav", *path.relative_to(ROOT).with_suffix("").parts))
                for test in doctest.DocTestFinder(recurse=True, exclude_empty=True).find(
                    import_module(name), name
                ):
                    if test.examples and not any(
                        name in example.source for example in test.examples for name in GIVEN
                    ):
                        yield test


TESTS = {test.name: test for test in examples()}


def test_everything_on_the_first_level_has_one():
    assert len(NAMES) > 80
    lacking = {name for name in NAMES if ">>> " not in (attrgetter(name)(celnav).__doc__ or "")}
    assert lacking == WITHOUT


@cache
def problem():
    """The names that the examples use: a satellite whose position is measured."""
    F, H = np.eye(6) + np.eye(6, k=3), np.eye(3, 6)
    Q, R, P0 = 1e-8 * np.eye(6), 0.04 * np.eye(3), np.diag([1.0] * 3 + [1e-4] * 3)
    x0 = orbit.from_elements(7136.6, 0.001, *np.radians([65, 30, 30, 0]))

    def f(x, epoch, *noise):
        return orbit.step(x, epoch.dt) + sum(noise, 0.0)

    def build(parameters):
        sigma, phi = parameters
        return celnav.colored(
            motion, celnav.Sensor(H, R=sigma**2 * np.eye(3)), phi * np.eye(3)
        ), prior

    motion, gps, prior, times = (
        celnav.Motion(f, Q),
        celnav.Sensor(H, R),
        celnav.Gaussian(x0, P0),
        np.arange(31.0),
    )
    truth, z = celnav.simulate(motion, gps, prior, times, runs=2)
    filter = celnav.ukf(motion, gps)
    t, space = np.arange(0.0, 3.0, 0.01), celnav.product(p=3, v=3)
    car = celnav.ukf(celnav.Motion(f, Q, space=space), gps)
    return {
        **{name: getattr(celnav, name) for name in celnav.__all__},
        "celnav": celnav,
        "np": np,
        "pandas": pandas,
        "orbit": orbit,
        "F": F,
        "H": H,
        "Q": Q,
        "R": R,
        "P0": P0,
        "x0": x0,
        "f": f,
        "h": lambda x, epoch: x[..., :3],
        "motion": motion,
        "gps": gps,
        "sensor": gps,
        "radar": gps,
        "camera": celnav.Sensor(H, R),
        "cruise": motion,
        "turn": motion,
        "prior": prior,
        "times": times,
        "truth": truth,
        "z": z,
        "filter": filter,
        "other": filter,
        "Fs": np.tile(F, (30, 1, 1)),
        "A": np.array([[0.0, 1.0], [0.0, 0.0]]),
        "track": celnav.run(filter, prior, times, z, keep="cov"),
        "build": build,
        "pictures": np.full_like(z, np.nan),
        "picture": z[18],
        "problem": celnav.Problem(motion, gps, prior, times),
        "squares_of_one_filter": np.arange(1.0, 9.0),
        "squares_of_another": np.arange(2.0, 10.0),
        "ratio": metrics.ratio,
        "epochs": celnav.epochs(times, z),
        "MerweScaledSigmaPoints": MerweScaledSigmaPoints,
        "fx": lambda x, dt: x,
        "rngs": [np.random.default_rng(i) for i in range(2)],
        "filters": {"ukf": filter},
        "groups": (celnav.Group("position", "m", slice(0, 3), 1000.0),),
        "step": lambda x: x**2,
        "measure": lambda x: x[..., :3],
        "t": t,
        "rate": np.zeros((len(t), 3)),
        "force": np.tile([0.0, 0.0, -9.81], (len(t), 1)),
        "t_fix": t[25::25],
        "z_fix": np.tile(x0[:3], (len(t[25::25]), 1)),
        "imu": celnav.models.inertial.Imu(1e-4, 1e-3, 1e-3, 0.05),
        "lat": np.full(2, 0.8),
        "lon": np.full(2, 0.1),
        "height": np.full(2, 100.0),
        "car_track": celnav.run(car, prior, times, z, keep="cov"),
        "infos": filter.step(filter.start(prior), celnav.Epoch(z=z[0]))[1],
    }


@pytest.mark.parametrize("name", TESTS)
def test_an_example_runs(name, tmp_path, monkeypatch):
    """And prints the output shown in the docstring, if any."""
    monkeypatch.chdir(tmp_path)
    test = TESTS[name]
    known = problem() | test.globs
    for example in test.examples:
        source = example.source
        if not example.want:
            exec(compile(source, name, "exec"), known)
        else:
            got = repr(eval(source, known)) + "\n"
            assert doctest.OutputChecker().check_output(
                example.want, got, doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
            ), got


def test_modules_name_what_the_reference_shows():
    """``__all__`` of a module names its public objects; the reference shows nothing else."""
    shown = [
        (thing.__module__, name.rsplit(".", 1)[-1])
        for name in NAMES
        for thing in [attrgetter(name)(celnav)]
    ]
    for module, name in shown:
        own = import_module(module)
        assert name in own.__all__, f"{module}.{name}"
        assert all(hasattr(own, public) for public in own.__all__), module
