"""The smaller studies: what the paper's result depends on, and what lies beyond it. All but the year with the nonlinear filters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.records import Epoch, Info
from celnav.filters.two_stage import Stage
from celnav.gaussian.linalg import Array
from celnav.papers.tstdkf import year
from celnav.papers.tstdkf.config import KAPPA, SETTINGS, Config, Setting
from celnav.papers.tstdkf.estimators import Models, augmented, boosted, differencing, driving, models, stationary, two_stages
from celnav.papers.tstdkf.follow import Found, follow
from celnav.papers.tstdkf.forces import accelerations, spectrum
from celnav.papers.tstdkf.method import Differenced, Noise, ar1_noise
from celnav.papers.tstdkf.scenario import PULLING, beside, noise_of, simulate

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


def month(config: Config, rngs: Rngs, few: Rngs) -> Found:
    """The settings, numbered from 1, in ``table 5``; `PARAMETERS`, in their order, with fewer runs in ``parameters``."""
    table = simulate([replace(config, setting=setting) for setting in SETTINGS.values()], rngs)
    first, names = table.case(0), [f"table 5/{number}" for number in SETTINGS]
    out = {"table 5/1/truth": np.concatenate([first.truth[1:, :1], first.bias[1:, :1]], -1), "table 5/1/z": first.z[1:, :1]}
    both = table
    if few:
        both = beside(table, simulate(parameter_cases(config), few))
        names += [f"parameters/{number}" for number in range(len(PARAMETERS))]
    # The first setting once more, for EKF and TKF with the stationary covariances.
    again = beside(both, first)
    believed = two_stages(again.cases, again.runs, [*map(driving, both.cases), stationary(first.cases[0])])
    for key, value in follow("tkf", again, filter=believed, showcase=True).items():
        case, filter, what = key.split("/", 2)
        number = int(case)
        out[f"{names[number]}/{filter}/{what}" if number < len(names) else f"{names[0]}/{filter}-fair/{what}"] = value
    for name, sim in (("tstdkf", both), ("aug", table)):
        out |= _named(names, follow(name, sim, showcase=True, consistency=("aug",)))
    return out


def _named(names: Sequence[str], found: Found) -> Found:
    """With the names of the cases for their numbers."""
    return {f"{names[int(case)]}/{rest}": value for (case, _, rest), value in ((k.partition("/"), v) for k, v in found.items())}


STRONG = {"F = 0.8": Setting(0.8, 0.5, KAPPA), "F = L = 0.8": Setting(0.8, 0.8, 0.5), "F = 0.9, L = 0.8": Setting(0.9, 0.8, 0.5)}
"""Settings of strong color."""
COUPLINGS = ((0.0, 0.0), (0.0, KAPPA), (KAPPA, 0.0), (KAPPA, 0.5 * KAPPA), (KAPPA, KAPPA), (KAPPA, -KAPPA))
"""Coupling of the noises, and what the filters take it for."""
KNOWN = COUPLINGS.index((KAPPA, KAPPA))
"""The first setting among them."""


def ten_days(config: Config, rngs: Rngs) -> Found:
    """Filters that know the coupling, or not, ``couplings``, in the order of `COUPLINGS`; `STRONG` with form B, which suffers
    most, ``strong color``; TDKF and TSTDKF in setting 1 with the bias observation matrix of the prose, ``plain slope``."""
    base = SETTINGS[1]
    coupled, believed = ([replace(config, setting=replace(base, kappa=pair[i])) for pair in COUPLINGS] for i in (0, 1))
    strong = [replace(config, setting=setting, factor="proportional") for setting in STRONG.values()]
    names = [f"couplings/{i}" for i in range(len(coupled))] + [f"strong color/{i}" for i in range(len(strong))]
    sim, out = simulate(coupled + strong, rngs), Found()
    for name in ("tkf", "tstdkf", "aug"):
        out |= _named(names, follow(name, sim, believed=believed + strong))
    c = sim.cases[KNOWN]
    variant = follow("tstdkf", sim.case(KNOWN), filter=boosted(c, also_plain=True, first=undifferenced(models(c), noise_of(c))))
    return out | _named(["plain slope"], variant)


@dataclass(frozen=True, eq=False)
class Undifferenced(Differenced):
    """The differenced stage, but the second is told nothing of it: the bias as in measurements as they are, Gamma for Gamma'."""

    def predict(self, state: Any, epoch: Epoch) -> tuple[Any, Array | None]:
        """State that knows what the model says of the interval, and the transition matrix."""
        state, Phi = super().predict(state, epoch)
        x, _, G = state.moved
        H, GJ = self.slope(x, epoch), G @ self.noise.J
        Omega = np.linalg.solve((np.eye(3) + H @ GJ).mT, GJ.mT).mT
        return state, None if Phi is None else Phi - Omega @ (H @ Phi)

    def update(self, state: Any, epoch: Epoch) -> tuple[Any, Stage | None, Info]:
        """State given the measurement, and what was done."""
        after, done, info = super().update(state, epoch)
        return after, None if done is None else done._replace(Omega=None, lag=None, before=None), info


def undifferenced(seen: Models, noise: Noise) -> Undifferenced:
    """The first stage of the variant "plain slope"."""
    stage = differencing(seen, noise)
    return Undifferenced(stage.move, stage.h, stage.slope, stage.noise)


def consistency(config: Config, rngs: Rngs) -> Found:
    """Initial errors and constant biases drawn from their priors: ``0``: setting 1, ``1``: white noise."""
    drawn = replace(config, trend="constant", initial="drawn", walk_km=0.0)
    sim, out = simulate([replace(drawn, setting=SETTINGS[i]) for i in (1, 5)], rngs), Found()
    for name in ("tkf", "tstdkf", "aug"):
        out |= _named(["consistency/0", "consistency/1"], follow(name, sim, consistency=("ekf", "tkf", "tdkf", "aug")))
    return out


def forces(config: Config, rngs: Rngs) -> Found:
    """Sun and Moon pull; all other noise is white. Who models them, who leaves them to white noise, who to AR(1) noise."""
    c = replace(config, setting=SETTINGS[5], pulled=True)
    sim, out = simulate(c, rngs), Found()
    matched = matched_noise(c)
    modeled = two_stages((c,), 1, [driving(c)], models(c, pulled=True))
    colored = boosted(c, also_plain=True, first=differencing(models(c), matched))
    for label, name, filter in (
        ("modeled", "tkf", modeled),
        ("white", "tkf", None),
        ("colored", "tstdkf", colored),
        ("colored", "aug", augmented(c, noise=matched)),
    ):
        out |= _named([f"forces/{label}"], follow(name, sim, filter=filter))
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
    """See `celnav.papers.tstdkf.year.track`, hour by hour."""
    return {f"year/{key}": value for key, value in year.track(config, rngs, every=year.HOUR).items()}


def drivers(config: Config, rngs: Rngs) -> dict[str, Array]:
    """The beginning of the year by both drivers: ``linear/<filter>/...`` and ``nonlinear/<filter>/...``, squared errors."""
    cases = [replace(config, trend=trend) for trend in year.TRENDS]
    sim, both = simulate(cases, deepcopy(rngs)), year.track(config, rngs)
    stronger = follow("tstdkf", sim, believed=[replace(case, factor="proportional") for case in cases])
    found = follow("tkf", sim) | follow("tstdkf", sim) | follow("aug", sim)
    found |= {key.replace("tstdkf", "B"): value for key, value in stronger.items()}
    out = {f"drivers/linear/{name}/position": both[f"{name}/position"] for name in NONLINEAR}
    for name, theirs in NONLINEAR.items():
        cases_of = [found[f"{i}/{theirs}/position"] for i in range(len(cases))]
        out[f"drivers/nonlinear/{name}/position"] = np.concatenate(cases_of, 1)
    return out


class Study(NamedTuple):
    """A study of the configuration at hand, or of the year's: its function, number (for random numbers), days and runs."""

    function: Callable[[Config, Rngs], dict[str, Array]]
    number: int
    days: float
    runs: int
    year: bool = False


STUDIES = {
    "year": Study(_year, 7, 365.0, 24, year=True),
    "ten days": Study(ten_days, 4, 10.0, 12),
    "forces": Study(forces, 6, 10.0, 20),
    "consistency": Study(consistency, 5, 3.0, 40),
    "drivers": Study(drivers, 8, 3.0, 3, year=True),
}
"""All but `month`."""
FEW = 8
"""Runs of the variants in `month`."""
