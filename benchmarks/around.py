"""``python -m benchmarks.around``: what stands around the loop of a filter, with peers and beside another checkout.

Each library, and each checkout, works in a process of its own; they take turns, pass by pass.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any, NamedTuple

import numpy as np

Work = Callable[[], object]
"""One timed pass."""
ROOT = Path(__file__).resolve().parents[1]
LEAST = 0.05  # CPU seconds of a turn: a shorter pass is done again
H = np.eye(3, 6)


class Case(NamedTuple):
    """What is measured. unit: of the time. units: how many of them a pass takes."""

    name: str
    unit: str
    units: float
    celnav: Callable[[], Work]
    peers: Mapping[str, Callable[[], Work]]


# -- celnav ------------------------------------------------------------------------------------
def orbit_of(runs: tuple[int, ...] = (), steps: int = 300) -> tuple[Any, Any, Any, Any]:
    """Filter, prior, times and measurements of the common workload."""
    import celnav
    from celnav.models import orbit

    motion = celnav.Motion(lambda x, _epoch: orbit.step(x, 1.0), sqrt_Q=SQRT_Q)
    filter = celnav.ukf(motion, celnav.Sensor(H, 0.04 * np.eye(3)))
    return filter, celnav.Gaussian(start(), P0), np.arange(float(steps)), measured(runs, steps)


SQRT_Q = np.diag([7.5e-3] * 3 + [1e-8] * 3)
P0 = np.diag([0.15**2] * 3 + [3.5e-5**2] * 3)


def start() -> Any:
    """Position and velocity, km and km/s."""
    return np.array([6180.0, 3568.0, 0.0, -1.58, 2.74, 6.77])


def measured(runs: tuple[int, ...], steps: int) -> Any:
    """Positions ``(steps, ..., 3)`` of simulated orbits."""
    from celnav.models import orbit

    rng = np.random.default_rng(0)
    x, z = start() + rng.standard_normal((*runs, 6)) @ np.sqrt(P0), []
    for k in range(steps):
        x = orbit.step(x, 1.0) + rng.standard_normal((*runs, 6)) @ SQRT_Q if k else x
        z.append(x[..., :3] + 0.2 * rng.standard_normal((*runs, 3)))
    return np.array(z)


def stream(lag: int = 0) -> Work:
    """A step at a time, or with a fixed lag."""
    import celnav
    from celnav.filters.fixed_lag import FixedLag

    filter, prior, times, z = orbit_of()
    fast = celnav.compiled(filter)
    stepped: Any = FixedLag(fast, lag) if lag else fast
    epochs = list(celnav.epochs(times, z))

    def work() -> None:
        state = stepped.start(prior)
        for epoch in epochs:
            state, _ = stepped.step(state, epoch)

    return work


def flight(runs: tuple[int, ...], steps: int, keep: str = "std") -> Work:
    """A flight of a filter that was compiled before."""
    import celnav

    filter, prior, times, z = orbit_of(runs, steps)
    fast = celnav.compiled(filter)
    return lambda: fast.run(prior, times, z, keep=keep)


def again() -> Work:
    """`celnav.run` by machine code of a filter that it has run before."""
    import celnav

    filter, prior, times, z = orbit_of((), 100)
    return lambda: celnav.run(filter, prior, times, z, engine="compiled")


def smoothing(runs: tuple[int, ...]) -> Work:
    """Flight and way back."""
    import celnav

    filter, prior, times, z = orbit_of(runs, 200)
    fast = celnav.compiled(filter)
    track = fast.run(prior, times, z, keep="cov")
    options: dict[str, Any] = {"engine": "compiled"}
    try:
        celnav.smooth(track, **options)
    except TypeError:  # versions before 0.3 go back by numpy alone
        options = {}
    return lambda: celnav.smooth(fast.run(prior, times, z, keep="cov"), **options)


def iterated() -> Work:
    """Three iterations of a smoother."""
    import celnav

    filter, prior, times, z = orbit_of((), 100)
    return lambda: celnav.iterated_smoother(
        filter, prior, times, z, iterations=3, engine="compiled"
    )


def simulated() -> Work:
    """10,000 runs of 101 epochs of a pendulum."""
    import celnav

    motion = celnav.Motion(swing, 0.02 * np.eye(2))
    sensor = celnav.Sensor(np.eye(1, 2), 0.1 * np.eye(1))
    prior, times = celnav.Gaussian([0.0, 1.0], np.eye(2)), 0.1 * np.arange(101)
    return lambda: celnav.simulate(motion, sensor, prior, times, runs=10_000)


def swing(x: Any, _epoch: Any) -> Any:
    """A pendulum."""
    return np.stack([x[..., 0] + 0.1 * x[..., 1], x[..., 1] - 0.1 * np.sin(x[..., 0])], -1)


def plainly_simulated() -> Work:
    """The same by numpy, with one generator."""

    def work() -> None:
        rng = np.random.default_rng(0)
        x, z = np.array([0.0, 1.0]) + rng.standard_normal((10_000, 2)), []
        for k in range(101):
            if k:
                x = swing(x, None) + np.sqrt(0.02) * rng.standard_normal((10_000, 2))
            z.append(x[:, :1] + np.sqrt(0.1) * rng.standard_normal((10_000, 1)))

    return work


def linear_of(n: int, runs: int, steps: int) -> tuple[Any, Any, Any]:
    """F, H and measurements of a linear system, half of whose numbers are measured."""
    rng = np.random.default_rng(n)
    F = 0.99 * np.linalg.qr(rng.standard_normal((n, n)))[0]
    return F, rng.standard_normal((n // 2, n)), rng.standard_normal((steps, runs, n // 2))


def linear(n: int, runs: int = 1000, steps: int = 100) -> Work:
    """A Kalman filter of many runs with one prior covariance."""
    import celnav

    F, G, z = linear_of(n, runs, steps)
    motion, sensor = celnav.Motion(F, 0.1 * np.eye(n)), celnav.Sensor(G, np.eye(n // 2))
    prior, fast = (
        celnav.Gaussian(np.zeros(n), np.eye(n)),
        celnav.compiled(celnav.ekf(motion, sensor)),
    )
    return lambda: fast.run(prior, np.arange(float(steps)), z)


def campaign() -> Work:
    """A unit of 100 runs of 600 steps of a paper's filter, after another one."""
    from celnav.campaign.missions import study
    from celnav.campaign.units import units_of

    mission = {"paper": "csrukf", "filters": ["csrukf+z0"], "runs": 10_000}
    work = study(mission | {"config": {"phi": 0.8, "steps": 600}})
    units = iter([unit for some in units_of(work) for unit in some])
    return lambda: next(units).do()


def first(n: int) -> Work:
    """What a process spends until machine code has flown: its imports, recording, compiling."""
    text = f"import benchmarks.compiled as it; it.lorenz_works({n})[1]()"
    return lambda: subprocess.run([sys.executable, "-c", text], check=True)


# -- peers -------------------------------------------------------------------------------------
def dynamax_smoothing(runs: tuple[int, ...]) -> Work:
    """Unscented filter and smoother."""
    jnp: Any = import_module("jax.numpy")

    from benchmarks.peers import jax_orbit

    ssm: Any = import_module("dynamax.nonlinear_gaussian_ssm")
    matrix, hyper = jnp.asarray(H), ssm.UKFHyperParams(1.0, 0.0, 0.0)
    params = ssm.ParamsNLGSSM(
        initial_mean=jnp.asarray(start()),
        initial_covariance=jnp.asarray(P0),
        dynamics_function=jax_orbit(),
        dynamics_covariance=jnp.asarray(SQRT_Q @ SQRT_Q),
        emission_function=lambda x: matrix @ x,
        emission_covariance=0.04 * jnp.eye(3),
    )

    def one(z: Any) -> Any:
        return ssm.unscented_kalman_smoother(params, z, hyper).smoothed_means

    return _mapped(one, measured(runs, 200))


def cuthbert_smoothing(runs: tuple[int, ...]) -> Work:
    """Extended filter and smoother in square-root form: another algorithm, of fewer evaluations."""
    jnp: Any = import_module("jax.numpy")

    from benchmarks.peers import jax_orbit

    cuthbert, moments = import_module("cuthbert"), import_module("cuthbert.gaussian.moments")
    step, root, matrix = jax_orbit(), jnp.asarray(SQRT_Q), jnp.asarray(H)

    def dynamics(state: Any, _z: Any) -> Any:
        return lambda x: (step(x), root), state.mean

    def observation(state: Any, z: Any) -> Any:
        return lambda x: (matrix @ x, 0.2 * jnp.eye(3)), state.mean, z

    def one(z: Any) -> Any:
        forward = moments.build_filter(
            jnp.asarray(start()), jnp.sqrt(jnp.asarray(P0)), dynamics, observation
        )
        states = cuthbert.filter(forward, z, forward.init_prepare())
        return cuthbert.smoother(moments.build_smoother(dynamics), states).mean

    return _mapped(one, measured(runs, 200))


def dynamax_linear(n: int, runs: int = 1000, steps: int = 100) -> Work:
    """A Kalman filter mapped over runs."""
    jnp: Any = import_module("jax.numpy")

    ssm: Any = import_module("dynamax.linear_gaussian_ssm")
    F, G, z = linear_of(n, runs, steps)
    none = {"bias": jnp.zeros(n), "input_weights": jnp.zeros((n, 0))}
    seen = {"bias": jnp.zeros(n // 2), "input_weights": jnp.zeros((n // 2, 0))}
    params = ssm.ParamsLGSSM(
        initial=ssm.ParamsLGSSMInitial(jnp.zeros(n), jnp.eye(n)),
        dynamics=ssm.ParamsLGSSMDynamics(weights=jnp.asarray(F), cov=0.1 * jnp.eye(n), **none),
        emissions=ssm.ParamsLGSSMEmissions(weights=jnp.asarray(G), cov=jnp.eye(n // 2), **seen),
    )

    def one(z: Any) -> Any:
        found = ssm.lgssm_filter(params, z)
        return found.filtered_means, found.filtered_covariances.diagonal(0, -2, -1)

    return _mapped(one, z)


def cuthbert_linear(n: int, runs: int = 1000, steps: int = 100) -> Work:
    """A square-root Kalman filter mapped over runs, step by step."""
    jnp: Any = import_module("jax.numpy")

    cuthbert, kalman = import_module("cuthbert"), import_module("cuthbert.gaussian.kalman")
    F, G, z = linear_of(n, runs, steps)
    dynamics = jnp.asarray(F), jnp.zeros(n), np.sqrt(0.1) * jnp.eye(n)
    matrix, none, root = jnp.asarray(G), jnp.zeros(n // 2), jnp.eye(n // 2)

    def one(z: Any) -> Any:
        filter = kalman.build_filter(
            jnp.zeros(n), jnp.eye(n), lambda _z: dynamics, lambda z: (matrix, none, root, z)
        )
        return cuthbert.filter(filter, z, filter.init_prepare()).mean

    return _mapped(one, z)


def _mapped(one: Callable[[Any], Any], z: Any) -> Work:
    """One run, or all of them in parts of 128, compiled by JAX."""
    jax: Any = import_module("jax")

    if z.ndim == 2:
        single, data = jax.jit(one), jax.numpy.asarray(z)
        return lambda: jax.block_until_ready(single(data))
    every = jax.jit(jax.vmap(one, in_axes=1, out_axes=1))
    parts = [jax.numpy.asarray(z[:, i : i + 128]) for i in range(0, z.shape[1], 128)]
    return lambda: [jax.block_until_ready(every(part)) for part in parts]


# -- what is measured --------------------------------------------------------------------------
def smooth_case(name: str, runs: tuple[int, ...]) -> Case:
    """A smoother and its peers."""
    peers = {"dynamax": dynamax_smoothing, "cuthbert": cuthbert_smoothing}
    works = {peer: partial(make, runs) for peer, make in peers.items()}
    count = 200.0 * int(np.prod(runs))
    return Case(name, "us a step of a run", count, partial(smoothing, runs), works)


def linear_case(n: int, runs: int) -> Case:
    """A linear filter and its peers."""
    peers = {"dynamax": dynamax_linear, "cuthbert": cuthbert_linear}
    works = {peer: partial(make, n, runs) for peer, make in peers.items()}
    name = f"linear, n = {n}, m = {n // 2}, {runs} runs"
    return Case(name, "us a step of a run", 100.0 * runs, partial(linear, n, runs), works)


CASES = [
    Case("compiled(filter).step", "us a step", 300, stream, {}),
    Case("FixedLag(compiled(filter), 20)", "us a step", 300, lambda: stream(20), {}),
    Case("flight of 1 epoch, one run", "us", 1, lambda: flight((), 1), {}),
    Case("flight of 300 epochs, one run", "us a step", 300, lambda: flight((), 300), {}),
    Case("run(engine='compiled') again, 100 epochs", "us a step", 100, again, {}),
    Case("4,096 runs", "us a step of a run", 61 * 4096, lambda: flight((4096,), 61), {}),
    Case(
        "keep='cov', one run of 10,000 epochs",
        "us a step",
        1e4,
        lambda: flight((), 10_000, "cov"),
        {},
    ),
    smooth_case("smoother, 100 runs", (100,)),
    smooth_case("smoother, one run", ()),
    Case("iterated smoother of 3", "us a step", 300, iterated, {}),
    *(linear_case(n, 1000) for n in (6, 15, 30)),
    linear_case(30, 4096),
    Case(
        "simulate 10,000 runs of 101 epochs",
        "us a step of a run",
        1.01e6,
        simulated,
        {"one generator": plainly_simulated},
    ),
    Case("campaign, a unit of csrukf", "us a step of a run", 6e4, campaign, {}),
    *(Case(f"first result, n = {n}", "s", 1e6, partial(first, n), {}) for n in (9, 15, 24, 32)),
]


def serve(library: str) -> None:
    """Answer names of cases with the seconds of a pass, or why there is none."""
    works: dict[str, Work] = {}
    known = {case.name: case for case in CASES}
    for line in sys.stdin:
        case, text = known[line.strip()], ""
        try:
            make = case.celnav if library == "celnav" else case.peers[library]
            if case.name not in works:
                works[case.name] = make()
                works[case.name]()
            begin, passes = _cpu(), 0
            while not passes or _cpu() - begin < LEAST:
                works[case.name]()
                passes += 1
            text = f"{(_cpu() - begin) / passes!r}"
        except Exception as error:  # of whatever a library raises
            text = f"{type(error).__name__}: {error}".replace("\n", " ")
        print(text, flush=True)


def _cpu() -> float:
    """CPU seconds of this process and of those that it has started."""
    children = os.times()
    return process_time() + children.children_user + children.children_system


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.around", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--rounds", type=int, default=7, help="passes of each (default 7)")
    parser.add_argument("--against", type=Path, help="another checkout of celnav")
    parser.add_argument("--only", default="", help="a part of the names of cases")
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks"), help="folder")
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.serve:
        serve(options.serve)
        return 0
    others = {"before": options.against.resolve()} if options.against else {}
    rows = []
    for case in [case for case in CASES if options.only in case.name]:
        rows.append(measure(case, options.rounds, others))
        print(told(rows[-1]), flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(rows, indent=1) + "\n"
    (options.out / "around.json").write_text(text, encoding="utf-8")
    return 0


def measure(case: Case, rounds: int, others: dict[str, Path]) -> dict[str, Any]:
    """Median times of a case by library, in its unit, and ratios to celnav within rounds."""
    roots = {"celnav": ROOT, **others, **dict.fromkeys(case.peers, ROOT)}
    with_process = {name: _process(name, root, name in others) for name, root in roots.items()}
    found: dict[str, list[float]] = {name: [] for name in roots}
    why: dict[str, str] = {}
    for _ in range(rounds):
        for name, process in with_process.items():
            if name in why:
                continue
            print(case.name, file=process.stdin, flush=True)
            answer = process.stdout.readline().strip() or "it ended"
            try:
                found[name].append(1e6 * float(answer) / case.units)
            except ValueError:
                why[name] = answer
    for process in with_process.values():
        process.stdin.close()
        process.wait()
    times = {name: median(values) for name, values in found.items() if values}
    ratios = {
        name: median(a / b for a, b in zip(values, found["celnav"], strict=False))
        for name, values in found.items()
        if values and name != "celnav"
    }
    return {"case": case.name, "unit": case.unit, "times": times, "ratios": ratios, "absent": why}


def _process(name: str, root: Path, other: bool) -> Any:
    """A library that waits for names of cases."""
    command = [sys.executable, str(Path(__file__)), "--serve", "celnav" if other else name]
    paths = os.pathsep.join([str(root), str(ROOT)])
    return subprocess.Popen(
        command,
        env=os.environ | {"PYTHONPATH": paths},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=root,
    )


def told(row: dict[str, Any]) -> str:
    """A row of the table."""
    times = [f"{name} {value:.3g}" for name, value in row["times"].items()]
    ratios = [f"{name} / celnav {value:.3g}" for name, value in row["ratios"].items()]
    absent = [f"{name}: {why}" for name, why in row["absent"].items()]
    return f"| {row['case']} | {row['unit']} | {', '.join(times)} | {'; '.join(ratios + absent)} |"


if __name__ == "__main__":
    raise SystemExit(main())
