"""The smaller studies: what the paper's result depends on, and what lies beyond it. All but the year with the nonlinear filters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.differenced import Noise, ar1_noise
from celnav.filters.driver import Epoch
from celnav.filters.info import Info
from celnav.filters.two_stage import First, Stage, plain, two_stage
from celnav.linalg import Array
from celnav.papers.tstdkf import year
from celnav.papers.tstdkf.config import KAPPA, SETTINGS, Config, Setting
from celnav.papers.tstdkf.estimators import augmented, bias_prior, boosted, differencing, driving, sensor
from celnav.papers.tstdkf.follow import Found, follow
from celnav.papers.tstdkf.forces import accelerations, spectrum
from celnav.papers.tstdkf.scenario import PULLING, noise_of, simulate

Rngs = Sequence[np.random.Generator]
LARGER = 20.0 / 3.0
"""By how much larger the ephemeris error is in a study of its amplitude."""


def _scaled(config: Config, factor: float) -> Config:
    x, y, z = (factor * a for a in config.amplitude_km)
    return replace(config, amplitude_km=(x, y, z))


PARAMETERS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "M0 = (0.03 km)²": {"bias_prior_km": 0.03},
    "M0 = (1 km)²": {"bias_prior_km": 1.0},
    "F = 0.8": {"setting": Setting(0.8, 0.5, KAPPA)},
    f"ephemeris error × {LARGER:.3g}": {"amplitude": LARGER},
    "κ = 0.5, M0 = (1 km)²": {"setting": Setting(0.5, 0.5, 0.5), "bias_prior_km": 1.0},
    "κ = 5, M0 = (1 km)²": {"setting": Setting(0.5, 0.5, 5.0), "bias_prior_km": 1.0},
    "κ = 8, M0 = (1 km)²": {"setting": Setting(0.5, 0.5, 8.0), "bias_prior_km": 1.0},
    "F = L = 0.8, κ = 0.5, form B": {"setting": Setting(0.8, 0.8, 0.5), "factor": "proportional"},
    "F = 0.9, L = 0.8, κ = 0.5, form B": {"setting": Setting(0.9, 0.8, 0.5), "factor": "proportional"},
    "form B": {"factor": "proportional"},
    "white, form B": {"setting": SETTINGS[5], "factor": "proportional"},
    f"white, ephemeris error × {LARGER:.3g}": {"setting": SETTINGS[5], "amplitude": LARGER},
    "white, no ephemeris error": {"setting": SETTINGS[5], "amplitude": 0.0},
}
"""Variants of setting 1: what is changed."""
WHITE_LARGER, WHITE_NONE = len(PARAMETERS) - 2, len(PARAMETERS) - 1
"""The last two of them, for Figs 3 and 4."""


def parameter_cases(config: Config) -> list[Config]:
    """The configurations of `PARAMETERS`."""
    out = []
    for changes in PARAMETERS.values():
        rest = {name: value for name, value in changes.items() if name != "amplitude"}
        case = replace(replace(config, setting=SETTINGS[1]), **rest)
        out.append(_scaled(case, float(changes.get("amplitude", 1.0))))
    return out


def parameters(config: Config, rngs: Rngs) -> Found:
    """`PARAMETERS`, in their order."""
    sim = simulate(parameter_cases(config), rngs)
    return follow("tkf", sim) | follow("tstdkf", sim)


STRONG = {"F = 0.8": Setting(0.8, 0.5, KAPPA), "F = L = 0.8": Setting(0.8, 0.8, 0.5), "F = 0.9, L = 0.8": Setting(0.9, 0.8, 0.5)}
"""Settings of strong color."""


def strong_color(config: Config, rngs: Rngs) -> Found:
    """`STRONG`, with form B, which suffers most, and the exact filter."""
    sim = simulate([replace(config, setting=setting, factor="proportional") for setting in STRONG.values()], rngs)
    return follow("tkf", sim) | follow("tstdkf", sim) | follow("aug", sim)


def undifferenced(config: Config) -> First:
    """The differenced stage, but the second is told nothing of it: the bias as in measurements as they are, Gamma for Gamma'."""
    noise, seen = noise_of(config), sensor(config)
    stage = differencing(config, noise)

    def predict(state: Any, epoch: Epoch) -> tuple[Any, Array | None]:
        state, Phi = stage.predict(state, epoch)
        x, _, G = state.moved
        H, GJ = seen.H(x, epoch), G @ noise.J
        Omega = np.linalg.solve((np.eye(3) + H @ GJ).mT, GJ.mT).mT
        return state, Phi - Omega @ (H @ Phi)

    def update(state: Any, epoch: Epoch) -> tuple[Any, Stage | None, Info]:
        after, done, info = stage.update(state, epoch)
        return after, None if done is None else done._replace(Omega=None, lag=None, before=None), info

    return stage._replace(predict=predict, update=update)


def plain_slope(config: Config, rngs: Rngs) -> Found:
    """TDKF and TSTDKF in setting 1 as they should be, ``0``, and with the bias observation matrix of the prose, ``1``."""
    c = replace(config, setting=SETTINGS[1])
    sim = simulate(c, rngs)
    variant = follow("tstdkf", sim, filter=boosted(c, also_plain=True, first=undifferenced(c)))
    return follow("tstdkf", sim) | {key.replace("0/", "1/", 1): value for key, value in variant.items()}


COUPLINGS = ((0.0, 0.0), (0.0, KAPPA), (KAPPA, 0.0), (KAPPA, 0.5 * KAPPA), (KAPPA, KAPPA), (KAPPA, -KAPPA))
"""Coupling of the noises, and what the filters take it for."""


def couplings(config: Config, rngs: Rngs) -> Found:
    """Filters that know the coupling, or not; in the order of `COUPLINGS`."""
    base = SETTINGS[1]
    cases, believed = ([replace(config, setting=replace(base, kappa=pair[i])) for pair in COUPLINGS] for i in (0, 1))
    sim, out = simulate(cases, rngs), Found()
    for name in ("tkf", "tstdkf", "aug"):
        out |= follow(name, sim, believed=believed)
    return out


def consistency(config: Config, rngs: Rngs) -> Found:
    """Initial errors and constant biases drawn from their priors: ``0``: setting 1, ``1``: white noise."""
    drawn = replace(config, trend="constant", initial="drawn", walk_km=0.0)
    sim, out = simulate([replace(drawn, setting=SETTINGS[i]) for i in (1, 5)], rngs), Found()
    for name in ("tkf", "tstdkf", "aug"):
        out |= follow(name, sim, consistency=("ekf", "tkf", "tdkf", "aug"))
    return out


def forces(config: Config, rngs: Rngs) -> Found:
    """Sun and Moon pull; all other noise is white. Who models them, who leaves them to white noise, who to AR(1) noise."""
    c = replace(config, setting=SETTINGS[5], pulled=True)
    sim, seen, bias, out = simulate(c, rngs), sensor(c), bias_prior((c,), 1), Found()
    matched = matched_noise(c)
    modeled = two_stage(plain(*driving(c, pulled=True)), seen.Gamma, bias)
    colored = boosted(c, also_plain=True, first=differencing(c, matched))
    for label, name, filter in (
        ("modeled", "tkf", modeled),
        ("white", "tkf", None),
        ("colored", "tstdkf", colored),
        ("colored", "aug", augmented(c, noise=matched)),
    ):
        out |= {key.replace("0/", f"{label}/", 1): value for key, value in follow(name, sim, filter=filter).items()}
    return out


def matched_noise(config: Config) -> Noise:
    """Noises as in the white setting, but of an acceleration as strong and as correlated as the pulls of Sun and Moon."""
    pulls = accelerations(config)
    total = np.asarray(sum(pulls[body] for body in PULLING))
    correlation = spectrum(total, config.step_s).correlation
    driven = config.process_std**2
    driven[3:] += np.square(total).mean(0) * (1.0 - correlation**2)
    L = np.diag([0.0, 0.0, 0.0, *correlation])
    return ar1_noise(np.zeros((3, 3)), L, np.zeros((6, 3)), np.diag(config.sigma_km**2), np.diag(driven))


NONLINEAR = {"ekf": "ekf", "tkf": "tkf", "tdkf": "tdkf", "C": "tstdkf", "B": "B", "aug": "aug"}
"""Names of the linear driver's filters among the others."""


def _year(config: Config, rngs: Rngs) -> dict[str, Array]:
    """See `celnav.papers.tstdkf.year.track`; with ``times`` ``(K, 1)`` s."""
    out = year.track(config, rngs)
    return out | {"times": config.step_s * np.arange(1, config.steps + 1)[:, None]}


def drivers(config: Config, rngs: Rngs) -> dict[str, Array]:
    """The beginning of the year by both drivers: ``linear/<filter>/...`` and ``nonlinear/<filter>/...``, squared errors."""
    cases = [replace(config, trend=trend) for trend in year.TRENDS]
    sim, both = simulate(cases, deepcopy(rngs)), year.track(config, rngs)
    stronger = boosted([replace(case, factor="proportional") for case in cases], sim.runs, also_plain=True)
    found: Found = {}
    for name in ("tkf", "tstdkf", "aug"):
        found |= follow(name, sim)
    found |= {key.replace("tstdkf", "B"): value for key, value in follow("tstdkf", sim, filter=stronger).items()}
    out = {f"linear/{name}/position": both[f"{name}/position"] for name in NONLINEAR}
    for name, theirs in NONLINEAR.items():
        cases_of = [found[f"{i}/{theirs}/position"] for i in range(len(cases))]
        out[f"nonlinear/{name}/position"] = np.concatenate(cases_of, 1)
    return out


class Study(NamedTuple):
    """A study of the configuration at hand, or of the year's: its function, days and runs."""

    function: Callable[[Config, Rngs], dict[str, Array]]
    days: float
    runs: int
    year: bool = False


STUDIES = {
    "parameters": Study(parameters, 30.0, 8),
    "strong color": Study(strong_color, 10.0, 8),
    "plain slope": Study(plain_slope, 10.0, 8),
    "couplings": Study(couplings, 10.0, 12),
    "consistency": Study(consistency, 3.0, 40),
    "forces": Study(forces, 10.0, 20),
    "year": Study(_year, 365.0, 6, year=True),
    "drivers": Study(drivers, 3.0, 3, year=True),
}
"""In the order of their random numbers."""
