"""Noise tuning, shown once: the increments' deviation from the likelihood of the innovations of one run."""

from __future__ import annotations

from dataclasses import replace

from celnav.analysis.tuning import Tuned, maximize_likelihood
from celnav.filters.records import Filter
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array
from celnav.papers.csrukf.config import Config
from celnav.papers.csrukf.scenario import simulate, single_transform
from celnav.study.montecarlo import generator


def sigma(config: Config, seed: int = 0, start: float = 1.0) -> Tuned:
    """Estimate ``sigma_km`` of a simulated run of ``config``, starting from ``start`` km."""
    sim = simulate(config, generator(seed, 30, 0))

    def build(parameters: Array) -> tuple[Filter, Gaussian]:
        guess = replace(config, sigma_km=float(parameters[0]))
        return single_transform(guess, guess.R), sim.prior

    return maximize_likelihood(build, [start], sim.epochs())
