"""``python -m benchmarks.attitude``: what state switching saves, as time.

Three kinds of code. Point by point: plain Python on floats, one point after the other, as a
processor without vectors would work, with the augmented covariance factored whole (dense) or block
by block. Arrays: celnav, one run alone and 500 at once. Filters take turns; the number of each is
its smallest over the rounds. ``--full`` runs the paper's 100 Hz over 600 s for 200 runs.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions, Info, State
from celnav.filters.run import run
from celnav.filters.sequential import Sequential, sigma_point
from celnav.gaussian import attitude
from celnav.gaussian.linalg import Array, block
from celnav.gaussian.spaces import EUCLIDEAN, product
from celnav.papers.ssukf.scenario import (
    PRESETS,
    Config,
    dynamics,
    filters,
    noise_root,
    simulate,
    spread,
    star,
    state_space,
    trial,
)
from celnav.study.montecarlo import blocks, generator
from celnav.study.study import evaluate_filters

Matrix = list[list[float]]
POINTWISE = {"aukf": (9, 9), "ssukf": (6, 3)}
"""Dimensions of the noise beside the state in prediction and update."""


# -- point by point --------------------------------------------------------------------------------
def cholesky(P: Matrix) -> Matrix:
    """Lower root, row by row."""
    n = len(P)
    L = [[0.0] * n for _ in range(n)]
    for i in range(n):
        row = L[i]
        for j in range(i + 1):
            other = L[j]
            total = P[i][j]
            for k in range(j):
                total -= row[k] * other[k]
            row[j] = math.sqrt(total) if i == j else total / other[j]
    return L


def times(q: list[float], p: list[float]) -> list[float]:
    """Quaternion product, scalar last."""
    a, b, c, d = q
    x, y, z, w = p
    return [
        d * x + w * a - b * z + c * y,
        d * y + w * b - c * x + a * z,
        d * z + w * c - a * y + b * x,
        d * w - a * x - b * y - c * z,
    ]


def from_p(x: float, y: float, z: float) -> list[float]:
    """Quaternion of Rodrigues parameters, a = 1, b = 4."""
    square = x * x + y * y + z * z
    q4 = (16.0 - square) / (16.0 + square)
    s = (1.0 + q4) / 4.0
    return [s * x, s * y, s * z, q4]


def to_p(q: list[float]) -> list[float]:
    """The opposite of `from_p`."""
    s = math.copysign(4.0, q[3]) / (1.0 + abs(q[3]))
    return [s * q[0], s * q[1], s * q[2]]


def turn(x: float, y: float, z: float) -> list[float]:
    """Quaternion of a rotation vector."""
    angle = math.sqrt(x * x + y * y + z * z)
    s = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
    return [s * x, s * y, s * z, math.cos(0.5 * angle)]


class Scalar:
    """One filter, point by point: dimensions of both augmented states, dense or block roots."""

    def __init__(self, noise_time: int, noise_measured: int, dense: bool):
        self.time, self.measured, self.dense = noise_time, noise_measured, dense
        config = PRESETS["100 Hz"]
        gyro, self.dt = config.gyro, 1.0 / config.gyro_hz
        self.factor = gyro.factor(self.dt)
        w = [gyro.rate_std(self.dt)] * 3 + [gyro.drift_std(self.dt)] * 3
        v = [config.sigma_n] * 3
        self.sigma_time, self.sigma_measured = (
            (w + v)[:noise_time],
            ((w + v)[:noise_measured] if noise_measured > 3 else v),
        )
        self.alpha2, self.beta = config.alpha**2, config.beta
        self.q, self.b = [0.0, 0.0, 0.0, 1.0], [0.0] * 3
        self.P = np.diag(config.sigma0**2).tolist()
        self.calls = 0

    def points(self, sigma: list[float]) -> tuple[list[list[float]], float, float]:
        """Augmented points about zero, weight of the center in covariances, weight of the others."""
        m = len(sigma)
        L = 6 + m
        c = self.alpha2 * L
        if self.dense:
            joint = [row + [0.0] * m for row in self.P] + [[0.0] * L for _ in range(m)]
            for i, s in enumerate(sigma):
                joint[6 + i][6 + i] = s * s
            root = cholesky(joint)
            columns = [[row[j] for row in root] for j in range(L)]
        else:
            root = cholesky(self.P)
            columns = [[row[j] for row in root] + [0.0] * m for j in range(6)]
            for i, s in enumerate(sigma):
                column = [0.0] * L
                column[6 + i] = s
                columns.append(column)
        reach = math.sqrt(c)
        found = [[0.0] * L]
        for column in columns:
            found.append([reach * x for x in column])
            found.append([-reach * x for x in column])
        self.calls += len(found)
        return found, 2.0 - L / c - self.alpha2 + self.beta, 0.5 / c

    def predict(self, rate: list[float]) -> None:
        """One gyro sample."""
        found, center, other = self.points(self.sigma_time)
        rows = []
        origin: list[float] = []
        dt, f, q, b = self.dt, self.factor, self.q, self.b
        for s in found:
            drift = [b[0] + s[3], b[1] + s[4], b[2] + s[5]]
            step = turn(*((rate[i] - drift[i] - s[6 + i]) * dt for i in range(3)))
            moved = times(step, times(from_p(s[0], s[1], s[2]), q))
            if not origin:
                back = [-moved[0], -moved[1], -moved[2], moved[3]]
                origin = moved
            rows.append(to_p(times(moved, back)) + [f * drift[i] + s[9 + i] for i in range(3)])
        mean = [rows[0][i] + other * sum(row[i] - rows[0][i] for row in rows[1:]) for i in range(6)]
        P = [[0.0] * 6 for _ in range(6)]
        for k, row in enumerate(rows):
            weight = other if k else center
            d = [row[i] - mean[i] for i in range(6)]
            for i in range(6):
                scaled, out = weight * d[i], P[i]
                for j in range(i + 1):
                    out[j] += scaled * d[j]
        for i in range(6):
            for j in range(i):
                P[j][i] = P[i][j]
        self.P, self.q, self.b = P, times(from_p(*mean[:3]), origin), mean[3:]

    def update(self, measured: list[float]) -> None:
        """One star sample."""
        found, center, other = self.points(self.sigma_measured)
        first = len(self.sigma_measured) + 3
        rows = [to_p(times(turn(*s[first : first + 3]), from_p(s[0], s[1], s[2]))) for s in found]
        mean = [rows[0][i] + other * sum(row[i] - rows[0][i] for row in rows[1:]) for i in range(3)]
        S, C = [[0.0] * 3 for _ in range(3)], [[0.0] * 3 for _ in range(6)]
        for k, (row, s) in enumerate(zip(rows, found, strict=True)):
            weight = other if k else center
            d = [weight * (row[i] - mean[i]) for i in range(3)]
            for i in range(3):
                for j in range(3):
                    S[i][j] += d[i] * (row[j] - mean[j])
            for i in range(6):
                for j in range(3):
                    C[i][j] += s[i] * d[j]
        L = cholesky(S)
        z = to_p(times(measured, [-self.q[0], -self.q[1], -self.q[2], self.q[3]]))
        white = solve(L, [z[i] - mean[i] for i in range(3)])
        gains = [solve(L, row) for row in C]
        d = [sum(g[i] * white[i] for i in range(3)) for g in gains]
        self.P = [
            [self.P[i][j] - sum(gains[i][k] * gains[j][k] for k in range(3)) for j in range(6)]
            for i in range(6)
        ]
        self.q, self.b = times(from_p(*d[:3]), self.q), [self.b[i] + d[3 + i] for i in range(3)]


def solve(L: Matrix, b: list[float]) -> list[float]:
    """Forward substitution."""
    x: list[float] = []
    for i, row in enumerate(L):
        x.append((b[i] - sum(row[k] * x[k] for k in range(i))) / row[i])
    return x


def scalar_work(noise: tuple[int, int], dense: bool, per: int) -> Callable[[], float]:
    """One star interval of a filter, point by point; returns CPU seconds."""
    config = replace(PRESETS["100 Hz"], duration_s=0.25)
    sim = simulate(config, [generator(0, 0, 0)])
    rates, measured = sim.gyro[:, 0].tolist(), sim.stars[1, 0].tolist()

    def once() -> float:
        filter = Scalar(*noise, dense)
        start = process_time()
        for rate in rates[:per]:
            filter.predict(rate)
        filter.update(measured)
        return process_time() - start

    return once


def agreement() -> float:
    """Largest difference of the point-by-point SSUKF from that of the package after a star interval
    (rad).
    """
    config = replace(PRESETS["100 Hz"], duration_s=0.25)
    sim = simulate(config, [generator(0, 0, 0)])
    scalar = Scalar(6, 3, dense=False)
    for rate in sim.gyro[:, 0].tolist():
        scalar.predict(rate)
    scalar.update(sim.stars[1, 0].tolist())
    mean = run(filters(config)["ssukf"], sim.prior, sim.epochs(), keep="mean").mean
    assert mean is not None
    return float(np.abs(np.abs(mean[-1, 0, :4]) - np.abs(scalar.q)).max())


# -- dense roots: the joint covariance of state and noise is factored as a whole, as the paper
# writes it
def dense_filters(config: Config, *, form: str = "covariance") -> dict[str, Filter]:
    """AUKF and SSUKF that factor the whole augmented covariance."""
    w, v = noise_root(config.gyro, config.step_s).diagonal(), np.full(3, config.sigma_n)
    time = {"aukf": np.concatenate([w, v]), "ssukf": w}
    measured = {"aukf": np.concatenate([w, v]), "ssukf": v}
    return {name: _dense(config, time[name], measured[name], form) for name in time}


def _dense(config: Config, time: Array, measured: Array, form: str) -> Filter:
    """A filter that takes the noise into the state before each of its parts, and out of it after."""
    through = dynamics(config.gyro)

    def f(x: Array, epoch: Epoch) -> Array:
        return np.concatenate([through(x[..., :7], epoch, x[..., 7:]), x[..., 7:]], -1)

    def h(x: Array, epoch: Epoch) -> Array:
        return star(x[..., :7], epoch, x[..., 7:][..., -3:])

    def part(noise: Array) -> Sequential:  # the noise is in the state
        n = 6 + len(noise)
        space = product((state_space(), 7, 6), (EUCLIDEAN, len(noise), len(noise)))
        motion = Motion(f, sqrt_Q=np.zeros((n, 0)), space=space)
        seen = Sensor(h, sqrt_R=np.zeros((3, 0)), space=attitude.attitude())
        return sigma_point(motion, seen, rule=lambda n: spread(n, config), form=form)

    forward, back = part(time), part(measured)

    def step(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if epoch.dt:
            state = _reduced(forward.predict(_augmented(state, time), epoch))
        after, infos = back.update(_augmented(state, measured), epoch)
        return _reduced(after), infos

    return FromFunctions(lambda prior: State(forward.form.of(prior), (None,)), step)


def _augmented(state: State, noise: Array) -> State:
    belief, form = state.belief, type(state.belief)
    mean = np.concatenate([belief.mean, np.zeros((*belief.mean.shape[:-1], len(noise)))], -1)
    return state._replace(
        belief=form(mean, block([[belief[1], 0], [0, form.marginal(np.diag(noise), np.ones(1))]]))
    )


def _reduced(state: State) -> State:
    """About attitude and drift alone: of a lower root, too, the first rows are all there is of
    them.
    """
    belief = state.belief
    return state._replace(belief=type(belief)(belief.mean[..., :7], belief[1][..., :6, :6]))


# -- arrays ----------------------------------------------------------------------------------------
def array_work(name: str, runs: int, per: int, dense: bool) -> Callable[[], float]:
    """One star interval of a filter of the package; returns CPU seconds."""
    config = replace(
        PRESETS["100 Hz" if per > 1 else "standard"],
        duration_s=0.25 if runs > 1 or per > 1 else 2.5,
    )
    sim = simulate(config, [generator(0, 0, r) for r in range(runs)])
    filter = (dense_filters if dense else filters)(config)[name]
    epochs = list(sim.epochs())

    def once() -> float:
        start = process_time()
        run(filter, sim.prior, epochs, keep="nothing", engine="numpy")
        return (process_time() - start) / (len(config.times) - 1)

    return once


def calls(noise: tuple[int, int], per: int) -> int:
    """Evaluations of f and h in a star interval of a filter, point by point."""
    filter = Scalar(*noise, dense=False)
    for _ in range(per):
        filter.predict([0.0, 0.0, 0.0])
    filter.update([0.0, 0.0, 0.0, 1.0])
    return filter.calls


def linearity(rounds: int) -> float:
    """Coefficient of determination of time over calls, point by point with block roots: both
    filters, 1:1 to 25:1.
    """
    cases = [(noise, per) for noise in POINTWISE.values() for per in (1, 5, 10, 15, 20, 25)]
    found = compared({str(case): scalar_work(case[0], False, case[1]) for case in cases}, rounds)
    return float(np.corrcoef([calls(*case) for case in cases], list(found.values()))[0, 1] ** 2)


def compared(works: dict[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """Smallest of each over interleaved rounds."""
    best = dict.fromkeys(works, math.inf)
    for _ in range(rounds):
        for name, once in works.items():
            best[name] = min(best[name], once())
    return best


def table(rounds: int) -> dict[str, dict[str, float]]:
    """Kind of code -> filter -> seconds from star to star."""
    out = {}
    for dense in (True, False):
        for per in (1, 25):
            root = "dense" if dense else "block"
            works = {name: scalar_work(noise, dense, per) for name, noise in POINTWISE.items()}
            out[f"point by point, {root}, {per}:1"] = compared(works, rounds)
    for runs in (1, 500):
        for per in (1, 25):
            for dense in (True, False):
                names = ("aukf", "ssukf") if dense else ("aukf", "ssukf", "additive", "mekf")
                works = {name: array_work(name, runs, per, dense) for name in names}
                root = "dense" if dense else "block"
                few = max(5, rounds // 4) if runs > 1 else rounds
                out[f"arrays, {runs} run{'s' if runs > 1 else ''}, {root}, {per}:1"] = compared(
                    works, few
                )
    return out


def full_rate(runs: int = 200) -> dict[str, float]:
    """The paper's 100 Hz over 600 s: CPU and wall seconds, and how far AUKF and SSUKF are apart
    (arcsec).
    """
    cpu, wall, apart, first = process_time(), perf_counter(), 0.0, 0.0
    for part in blocks(runs, 200):
        one = trial(PRESETS["100 Hz"], [generator(0, 0, r) for r in part])
        found = evaluate_filters(one, ("aukf", "ssukf"))
        difference = np.abs(found["aukf/error"] - found["ssukf/error"])[1:, :, :3]
        apart = max(apart, float(difference.max()))
        first += float(np.square(found["ssukf/error"][1, :, :3]).sum())
    rms = math.sqrt(first / (3 * runs))
    return {
        "cpu_s": process_time() - cpu,
        "wall_s": perf_counter() - wall,
        "apart_arcsec": apart,
        "first_star_arcsec": rms,
    }


def main() -> int:
    """Measure and print, as a table or as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.attitude", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument(
        "--full", action="store_true", help="also the paper's 100 Hz, 600 s, 200 runs (minutes)"
    )
    parser.add_argument("--json", type=Path, help="write the numbers here too")
    options = parser.parse_args()
    print(f"point by point against arrays: {agreement():.1e} rad after a star interval")
    found = table(options.rounds)
    print(
        f"{'code':40} {'AUKF':>10} {'SSUKF':>10} {'ratio':>7}   us of CPU from star to star; others"
    )
    for kind, times in found.items():
        others = ", ".join(
            f"{name} {1e6 * t:.0f}" for name, t in times.items() if name not in ("aukf", "ssukf")
        )
        aukf, ssukf = times["aukf"], times["ssukf"]
        per = 25 if kind.endswith("25:1") else 1
        made = ", ".join(
            f"{name} {calls(noise, per)} calls"
            for name, noise in POINTWISE.items()
            if kind.startswith("point")
        )
        print(
            f"{kind:40} {1e6 * aukf:10.0f} {1e6 * ssukf:10.0f} {ssukf / aukf:7.2f}   {others}{made}"
        )
    print(
        "time over calls of f and h, point by point, block roots: r^2 = "
        f"{linearity(options.rounds):.4f}"
    )
    if options.full:
        found["100 Hz, 600 s, 200 runs, AUKF and SSUKF"] = full_rate()
        print(found["100 Hz, 600 s, 200 runs, AUKF and SSUKF"])
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
