"""The studies, each a function of a configuration and generators."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from celnav.filters.adaptive import innovation_window
from celnav.filters.driver import Filter
from celnav.filters.parity import group_parity
from celnav.gaussian import covariance
from celnav.linalg import Array
from celnav.models import pseudorange
from celnav.montecarlo import normals
from celnav.papers.aukf.config import Config
from celnav.papers.aukf.errata import without_redraw
from celnav.papers.aukf.follow import Found, follow, watched
from celnav.papers.aukf.scenario import Scenario, adapted, filters, simulate, visible
from celnav.points import unscented

Rngs = Sequence[np.random.Generator]
MAIN = ("ls", "ekf", "ukf", "aukf", "group")
CASES = ("ranges", "both", "one", "mistuned")


def _labelled(label: str, found: Found) -> Found:
    return {f"{label}/{key}": value for key, value in found.items()}


def _chosen(config: Config, names: Iterable[str]) -> dict[str, Filter]:
    known = filters(config)
    return {name: known[name] for name in names}


def quiet(config: Config, rngs: Rngs) -> Found:
    """No burst; with the factors of AUKF, and the filter that draws its points once."""
    c = replace(config, burst="none")
    return _watched(c, simulate(c, rngs))


def burst(config: Config, rngs: Rngs) -> Found:
    """A burst on all ranges; with the factors of AUKF."""
    c = replace(config, burst="ranges")
    return _watched(c, simulate(c, rngs))


def _watched(c: Config, sim: Scenario) -> Found:
    S = len(sim.satellites.names)
    chosen = _chosen(c, MAIN)
    chosen["aukf"] = adapted(c, S, unscented(8, c.alpha, c.beta, 0.0), (watched(innovation_window(c.window)),))
    return follow(chosen, sim, factors=("aukf",), consistency=("ekf", "ukf", "aukf"))


def baselines(config: Config, rngs: Rngs) -> Found:
    """All filters where the burst is on all ranges, on everything, on one satellite's range, and where the noise is mistuned."""
    out: Found = {}
    for case in CASES:
        c = replace(config, burst="none", true_sigma_range_m=10.0) if case == "mistuned" else replace(config, burst=case)
        out |= _labelled(case, follow(filters(c), simulate(c, rngs)))
    return out


PROCESS_NOISE = {1.0: (1.0, 10.0, 100.0, 300.0, 1000.0), 0.1: (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)}
"""Interval (s) -> densities of the acceleration (m^2/s^3)."""


def process_noise(config: Config, rngs: Rngs) -> Found:
    """Quiet, by interval and process noise."""
    out: Found = {}
    for interval, densities in PROCESS_NOISE.items():
        base = replace(config, burst="none", interval_s=interval)
        sim = simulate(base, rngs)
        for density in densities:
            c = replace(base, acceleration_noise_m2_per_s3=density)
            S = len(sim.satellites.names)
            chosen = _chosen(c, ("ekf", "aukf", "group"))
            chosen["aukf"] = adapted(c, S, unscented(8, c.alpha, c.beta, 0.0), (watched(innovation_window(c.window)),))
            found = follow(chosen, sim, factors=("aukf",), consistency=("ekf",))
            out |= _labelled(f"{interval:g}/{density:g}", found)
    return out


WINDOWS = {("1 Hz", 1.0, 1000.0): (1, 2, 5, 10), ("10 Hz", 0.1, 100.0): (5, 10, 30), ("default", 0.1, 0.0): (1, 3, 10, 50, 100)}
"""Name, interval (s) and process noise -> lengths of the window."""


def windows(config: Config, rngs: Rngs) -> Found:
    """A burst on all ranges, by rate and window."""
    out: Found = {}
    for (label, interval, density), lengths in WINDOWS.items():
        c = replace(config, burst="ranges", interval_s=interval, acceleration_noise_m2_per_s3=density)
        sim, S = simulate(c, rngs), len(visible(c).names)
        rule = unscented(8, c.alpha, c.beta, 0.0)
        chosen = {f"M = {M}": adapted(c, S, rule, (innovation_window(M),)) for M in lengths}
        chosen |= {"ukf": adapted(c, S, rule), "group": adapted(c, S, rule, (group_parity((range(S), range(S, 2 * S)), 4),))}
        out |= _labelled(label, follow(chosen, sim))
    return out


INITIAL_KM = (1.0, 10.0, 100.0, 1000.0)


def initial_errors(config: Config, rngs: Rngs) -> Found:
    """1 Hz, no burst: large initial errors of the position, of which the prior knows; the first minute's half."""
    out: Found = {}
    for km in INITIAL_KM:
        c = replace(config, burst="none", interval_s=1.0, duration_s=30.0, deviation=(1e3 * km, *config.deviation[1:]))
        sim, S = simulate(c, rngs), len(visible(c).names)
        chosen = _chosen(c, ("ekf", "ukf", "aukf"))
        chosen["ukf, alpha = 0.001"] = adapted(c, S, unscented(8, 1e-3, c.beta, 0.0))
        out |= _labelled(f"{km:g}", follow(chosen, sim))
    return out


def matched(config: Config, rngs: Rngs) -> Found:
    """Truth drawn from the filters' own model, 1 Hz: errors, NEES, NIS; ``bound (T, 1, 8)``: variances of the posterior bound."""
    c = replace(config, burst="none", interval_s=1.0, acceleration_noise_m2_per_s3=100.0)
    sim = drawn(c, rngs)
    S = len(sim.satellites.names)
    rule = unscented(8, c.alpha, c.beta, 0.0)
    chosen = _chosen(c, ("ekf", "ukf", "aukf", "group", "channel")) | {"no redraw": without_redraw(c, S, rule)}
    return follow(chosen, sim, consistency=tuple(chosen)) | {"bound": bound(sim)[:, None]}


def drawn(config: Config, rngs: Rngs) -> Scenario:
    """A scenario whose truth moves by the filters' model; satellites are where they would be for the circle."""
    sim = simulate(config, rngs)
    T, runs, S = len(sim.truth), len(rngs), len(sim.satellites.names)
    first, walk, noise = normals(rngs, (8,), (T, 8), (T, 2 * S))
    root, truth = np.linalg.cholesky(config.Q), np.empty((T, runs, 8))
    truth[0] = sim.truth[0]
    for k in range(1, T):
        truth[k] = truth[k - 1] @ config.F.T + walk[k] @ root.T
    sigma = np.repeat([config.sigma_range_m, config.sigma_rate_m_per_s], S)
    z = pseudorange.measure(truth, sim.satellites.q[:, None], sim.satellites.w[:, None]) + sigma * noise
    prior = covariance(truth[0] + first * np.sqrt(config.P0.diagonal()), np.broadcast_to(config.P0, (runs, 8, 8)))
    return Scenario(config, truth, z, sim.satellites, prior)


def bound(sim: Scenario) -> Array:
    """Variances ``(T, 8)`` of the posterior Cramer-Rao bound, with information averaged over the runs."""
    c, S = sim.config, len(sim.satellites.names)
    weight = 1.0 / np.square(np.repeat([c.sigma_range_m, c.sigma_rate_m_per_s], S))
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
    """No burst: the points of the prediction used again for the measurement."""
    c = replace(config, burst="none")
    sim = simulate(c, rngs)
    S, rule = len(sim.satellites.names), unscented(8, c.alpha, c.beta, 0.0)
    return follow({"ukf": adapted(c, S, rule), "no redraw": without_redraw(c, S, rule)}, sim, consistency=("ukf", "no redraw"))


class Study(NamedTuple):
    """A study's function and its runs at full effort; None: those of the configuration."""

    function: Callable[[Config, Rngs], Found]
    runs: int | None


STUDIES = {
    "quiet": Study(quiet, None),
    "burst": Study(burst, None),
    "baselines": Study(baselines, 20),
    "process noise": Study(process_noise, 20),
    "windows": Study(windows, 20),
    "initial errors": Study(initial_errors, 20),
    "matched": Study(matched, 40),
    "redraw": Study(redraw, 20),
}
"""In the order of their random numbers."""
