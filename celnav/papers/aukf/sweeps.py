"""The studies, each a function of a configuration and generators."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from celnav.filters.adaptive import innovation_window
from celnav.filters.records import Epoch, Filter, FromFunctions, Info, State
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import unscented
from celnav.models import pseudorange
from celnav.papers.aukf.config import PRESETS, Config
from celnav.papers.aukf.errata import without_redraw
from celnav.papers.aukf.follow import Found, Kept, follow, follow_cases, watched
from celnav.papers.aukf.scenario import EKF, Scenario, adapted, filters, simulate, ukf, visible
from celnav.receiver.filters import parity_of_groups
from celnav.study.montecarlo import normals

Rngs = Sequence[np.random.Generator]
MAIN = ("ls", "ekf", "ukf", "aukf", "group")
CASES = ("none", "ranges")
"""Of the burst, in the main study."""
MISTUNED_M = PRESETS["mistuned"].true_sigma_range_m


def _labelled(label: str, found: Found) -> Found:
    return {f"{label}/{key}": value for key, value in found.items()}


def _size(config: Config) -> int:
    return len(visible(config).names)


def _paper(config: Config, Q: Array | None = None) -> Filter:
    """The paper's filter, with its factors kept."""
    return adapted(config, _size(config), ukf(config), watched(innovation_window(config.window)), Q=Q)


def main(config: Config, rngs: Rngs) -> Found:
    """Without a burst ("none") and with one on all ranges ("ranges")."""
    cases = {case: simulate(replace(config, burst=case), rngs) for case in CASES}
    known = filters(config)
    chosen = {name: known[name] for name in MAIN} | {"aukf": _paper(config)}
    shown = ("ekf", "aukf", "group")
    return follow_cases(chosen, cases, Kept(nis=shown, cov=(*shown, "ukf"), factor=("aukf",)))


def baselines(config: Config, rngs: Rngs) -> Found:
    """All filters where the burst is on all ranges, on everything, on one satellite's range, and where the noise is mistuned."""
    cases = {case: replace(config, burst=case) for case in ("ranges", "both", "one")}
    cases["mistuned"] = replace(config, burst="none", true_sigma_range_m=MISTUNED_M)
    return follow_cases(filters(config), {case: simulate(c, rngs) for case, c in cases.items()})


PROCESS_NOISE = {1.0: (1.0, 10.0, 100.0, 300.0, 1000.0), 0.1: (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)}
"""Interval (s) -> densities of the acceleration (m^2/s^3)."""


def process_noise(config: Config, rngs: Rngs) -> Found:
    """Quiet, by interval and process noise: ``<interval>/<density>/...``."""
    out: Found = {}
    for interval, densities in PROCESS_NOISE.items():
        c = replace(config, burst="none", interval_s=interval)
        sim, S = simulate(c, rngs), _size(c)
        Q = np.repeat([replace(c, acceleration_noise_m2_per_s3=density).Q for density in densities], len(rngs), 0)
        group = adapted(c, S, ukf(c), parity_of_groups(S), Q=Q)
        chosen = {"ekf": adapted(c, S, EKF, Q=Q), "aukf": _paper(c, Q), "group": group}
        cases = {f"{interval:g}/{density:g}": sim for density in densities}
        out |= follow_cases(chosen, cases, Kept(nis=("ekf",), factor=("aukf",)))
    return out


def disturbed(config: Config, rngs: Rngs) -> Found:
    """UKF and AUKF where single runs differ most: the burst on ranges and rates ("both"), and mistuned noise ("mistuned")."""
    cases = {"both": replace(config, burst="both"), "mistuned": replace(config, burst="none", true_sigma_range_m=MISTUNED_M)}
    known = filters(config)
    return follow_cases({name: known[name] for name in ("ukf", "aukf")}, {case: simulate(c, rngs) for case, c in cases.items()})


WINDOWS = {("1 Hz", 1.0, 1000.0): (1, 2, 5, 10), ("10 Hz", 0.1, 100.0): (5, 10, 30), ("default", 0.1, None): (1, 3, 50, 100)}
"""Name, interval (s) and process noise (None: that of the configuration) -> lengths of the window."""


def windows(config: Config, rngs: Rngs) -> Found:
    """A burst on all ranges, by rate and window; where nothing else is changed, UKF and group parity stand in `main`."""
    out: Found = {}
    for (label, interval, density), lengths in WINDOWS.items():
        c = replace(config, burst="ranges", interval_s=interval, acceleration_noise_m2_per_s3=density)
        S, rule = _size(c), ukf(c)
        chosen = {f"M = {M}": adapted(c, S, rule, innovation_window(M)) for M in lengths}
        if label != "default":
            chosen |= {"ukf": adapted(c, S, rule), "group": adapted(c, S, rule, parity_of_groups(S))}
        out |= _labelled(label, follow(chosen, simulate(c, rngs)))
    return out


INITIAL_KM = (1.0, 10.0, 100.0, 1000.0)
SMALL_ALPHA = "ukf, alpha = 0.001"
FROM_A_FIX = "ekf from a fix"


def from_a_fix(config: Config) -> Filter:
    """The EKF that starts at the least-squares fix of the first epoch, and so from anywhere."""
    known = filters(config)
    fix, ekf = known["ls"], known["ekf"]

    def step(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if epoch.k:
            return ekf.step(state, epoch)
        found, infos = fix.step(fix.start(state.belief), epoch)
        return ekf.start(found.belief), infos

    return FromFunctions(ekf.start, step)


def initial_errors(config: Config, rngs: Rngs) -> Found:
    """1 Hz, no burst: large initial errors of the position, of which the prior knows; the first half minute."""
    short = replace(config, burst="none", interval_s=1.0, duration_s=min(30.0, config.duration_s))
    cases = {f"{km:g}": replace(short, deviation=(1e3 * km, *config.deviation[1:])) for km in INITIAL_KM}
    known, S = filters(short), _size(short)
    chosen = {name: known[name] for name in ("ekf", "ukf", "aukf")}
    chosen[SMALL_ALPHA] = adapted(short, S, unscented(8, 1e-3, short.beta, 0.0))
    chosen[FROM_A_FIX] = from_a_fix(short)
    return follow_cases(chosen, {km: simulate(c, rngs) for km, c in cases.items()})


def matched(config: Config, rngs: Rngs) -> Found:
    """Truth drawn from the filters' own model, 1 Hz: errors, NEES, NIS; ``bound (T, 1, 8)``: variances of the posterior bound."""
    c = replace(config, burst="none", interval_s=1.0, acceleration_noise_m2_per_s3=100.0)
    sim, known = drawn(c, rngs), filters(c)
    chosen = {name: known[name] for name in ("ekf", "ukf", "aukf", "group", "channel")}
    chosen |= {"aukf": _paper(c), "no redraw": without_redraw(c, _size(c), ukf(c))}
    names = tuple(chosen)
    return follow(chosen, sim, Kept(nis=names, nees=names, factor=("aukf",))) | {"bound": bound(sim)[:, None]}


def drawn(config: Config, rngs: Rngs) -> Scenario:
    """A scenario whose truth moves by the filters' model; satellites are where they would be for the circle."""
    sim = simulate(config, rngs)
    T, runs, S = len(sim.truth), len(rngs), len(sim.satellites.names)
    first, walk, noise = normals(rngs, (8,), (T, 8), (T, 2 * S))
    root, truth = np.linalg.cholesky(config.Q), np.empty((T, runs, 8))
    truth[0] = sim.truth[0]
    for k in range(1, T):
        truth[k] = truth[k - 1] @ config.F.T + walk[k] @ root.T
    sigma = config.sigma(S)
    z = pseudorange.measure(truth, sim.satellites.q[:, None], sim.satellites.w[:, None]) + sigma * noise
    prior = Gaussian(truth[0] + first * np.sqrt(config.P0.diagonal()), np.broadcast_to(config.P0, (runs, 8, 8)))
    return Scenario(config, truth, z, sim.satellites, prior)


def bound(sim: Scenario) -> Array:
    """Variances ``(T, 8)`` of the posterior Cramer-Rao bound, with information averaged over the runs."""
    c, S = sim.config, len(sim.satellites.names)
    weight = 1.0 / np.square(c.sigma(S))
    P, out = c.P0, []
    for k, truth in enumerate(sim.truth):
        if k:
            P = c.F @ P @ c.F.T + c.Q
        H = pseudorange.jacobian(truth, sim.satellites.q[k], sim.satellites.w[k])
        gained = (H.mT @ (weight[:, None] * H)).mean(0)
        P = np.linalg.solve(np.eye(8) + P @ gained, P)
        out.append(P.diagonal())
    return np.stack(out)


def redraw(config: Config, rngs: Rngs) -> Found:
    """No burst: the points of the prediction used again for the measurement; an EKF whose Jacobian is of the last estimate."""
    c = replace(config, burst="none")
    S, rule = _size(c), ukf(c)
    chosen = {"ukf": adapted(c, S, rule), "no redraw": without_redraw(c, S, rule)}
    chosen |= {"ekf": adapted(c, S, EKF), "late ekf": adapted(c, S, EKF, late=True)}
    return follow(chosen, simulate(c, rngs), Kept(nees=("no redraw",)))


class Study(NamedTuple):
    """A study's function and its runs at full effort; None: those of the configuration."""

    function: Callable[[Config, Rngs], Found]
    runs: int | None


STUDIES = {
    "main": Study(main, None),
    "baselines": Study(baselines, 20),
    "process noise": Study(process_noise, 20),
    "windows": Study(windows, 20),
    "initial errors": Study(initial_errors, 20),
    "matched": Study(matched, 40),
    "redraw": Study(redraw, 20),
    "disturbed": Study(disturbed, None),
}
"""In the order of their random numbers."""
