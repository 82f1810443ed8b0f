"""The study of [Deng2013]: the runs, and the numbers that decide what the abstract states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from celnav.analysis.bounds import riccati
from celnav.analysis.metrics import ratio as rms_ratio
from celnav.gaussian.linalg import Array, cholesky
from celnav.papers.mars.scenario import (
    FINE,
    GROUPS,
    PRIOR_STD,
    Config,
    cruise,
    decomposed,
    process,
    spin_noise,
    trial,
)
from celnav.study.ledger import Bounds, Decision, Number, estimate, read_ledger
from celnav.study.numbers import Decided, all_of, consistency, of, over, ratio, rmse, tiers
from celnav.study.study import Part, Results, Rngs, Study, monte_carlo

__all__ = [
    "AREAS",
    "BEST",
    "CASES",
    "PRESSURE",
    "SETTLED",
    "SIX",
    "STUDY",
    "USUAL",
    "bounds",
    "least_squares",
    "parts",
]

UNITS = np.repeat([1.0, 1e3], 3)
ALL, SETTLED = "cruise", slice(4, None)
"""From the fifth observation to arrival."""
AREAS = (0.02, 0.1, 1.0)
PRESSURE = {"modeled": 1e-11, "unmodeled": 1e-10}
"""σ of the acceleration (km/s^2) if a tenth of the solar radiation pressure, or all of it, is not
modeled."""
SIX = {
    f"{area:g} m², {name}": replace(FINE, area_m2=area, acceleration_km_per_s2=a)
    for name, a in PRESSURE.items()
    for area in AREAS
}
USUAL, BEST = "0.1 m², modeled", "1 m², modeled"
CASES = {
    **SIX,
    "three years": replace(SIX[BEST], fit_years=3.0),
    "ten years old": replace(SIX[BEST], age_years=10.0),
}
"""Six readings of the abstract, and two other timing models with the best of them."""
NEAR: Bounds = (4.8, 7.2)
"""NEES within 20 % of 6."""
WALK: dict[str, Bounds] = {"three years": (NEAR[1], None)}
FILTERS = ("ignoring", "inflated", "walk", "modes", "openloop")


# -- bounds ----------------------------------------------------------------------------------------
def least_squares(config: Config, *, spin: bool) -> Array:
    """Covariances ``(T, 6, 6)`` of the best linear estimate of each state from all observations so
    far, by least squares for the initial error and the accelerations.

    The errors of all delays have one covariance, with the spin noise or without. For this nearly
    linear problem it is the Cramér-Rao bound.
    """
    c, (nominal, Phi, sun) = config, cruise(config)
    T, m = c.weeks, len(c.pulsars)
    # The state of week k is S[k] @ parameters, which are in units of their standard deviations.
    S = np.zeros((T + 1, 6, 6 + 3 * T))
    S[0, :, :6] = np.diag(PRIOR_STD)
    for k in range(T):
        S[k + 1] = Phi[k] @ S[k]
        S[k + 1, :, 6 + 3 * k : 9 + 3 * k] = process(c)
    H = c.timing.gradient(sun + nominal[:, :3], sun)[1:]
    A = (H @ S[1:, :3]).reshape(T * m, -1)
    R = np.kron(np.eye(T), np.diag(c.sigma_km**2))
    if spin:
        R += np.einsum("mkl,mn->kmln", spin_noise(c), np.eye(m)).reshape(R.shape)
    whitened, prior = np.linalg.solve(cholesky(R), A), np.eye(len(A.T))
    covariances = []
    for k in range(1, T + 1):
        U = np.linalg.qr(np.vstack([prior, whitened[: m * k]])).R
        half = np.linalg.solve(U.T, S[k].T)
        covariances.append(half.T @ half)
    return np.stack(covariances)


def bounds(config: Config, _: Rngs) -> dict[str, Array]:
    """Bounds ``(T, 6)`` km, m/s with and without spin noise, the σ of the spin noise ``(T, m)`` km,
    and numbers for checks."""
    c, (_states, Phi, _sun) = config, cruise(config)
    with_spin, without = (least_squares(c, spin=spin) for spin in (True, False))
    G, R = process(c), np.diag(c.sigma_km**2)
    n = c.timing.directions
    H = np.hstack([n, 0.0 * n])
    kalman = riccati(Phi, H, G @ G.T, R, np.diag(PRIOR_STD**2)).covariances[1:]
    every = np.square(decomposed(c))
    return {
        "with spin noise": UNITS * np.sqrt(with_spin.diagonal(0, 1, 2)),
        "without": UNITS * np.sqrt(without.diagonal(0, 1, 2)),
        "spin": np.sqrt(every.sum(-1)),
        "riccati": np.abs(np.trace(kalman, 0, 1, 2) / np.trace(without, 0, 1, 2) - 1.0),
        "kept": every[..., : c.modes].sum((0, 2)) / every.sum((0, 2)),
        "fix": np.sqrt(np.trace(np.linalg.solve(n.T @ np.linalg.solve(R, n), np.eye(3))))[None],
    }


def parts(_effort: float = 1.0) -> dict[str, Part]:
    """All parts of the study."""
    runs = {
        name: monte_carlo(trial, FILTERS, c, number, c.runs, cost=4.0, cov=True)
        for number, (name, c) in enumerate(CASES.items())
    }
    return {**runs, **{f"bounds/{name}": Part(bounds, c) for name, c in CASES.items()}}


# -- numbers that decide ---------------------------------------------------------------------------
def level(group: str, most: float) -> Decision:
    """RMSE of the filter with modes, in all six cases, or in the best."""
    unit = {"position": "km", "velocity": "m/s"}[group]
    each = {
        name: rmse(f"{name}: {group} RMSE ({unit})", (name, "modes"), group, (None, most), at=ALL)
        for name in SIX
    }
    return tiers(reproduced=[*each.values()], in_part=[each[BEST]])


def against_modes(names: Sequence[str], filter: str, accept: Bounds) -> list[Decided]:
    """Position RMSE of a filter over that of the filter with modes."""
    return [
        over(f"{name}: position RMSE, {filter} over modes", name, filter, "modes", accept, at=ALL)
        for name in names
    ]


def nees(names: Sequence[str], filter: str, accept: Bounds) -> list[Decided]:
    """Mean NEES of a filter."""
    return [
        consistency(f"{name}: NEES, {filter}", (name, filter), accept, at=ALL) for name in names
    ]


def over_bound(name: str, group: str) -> Decided:
    """RMSE of the filter with modes over the bound."""

    def number(r: Results) -> Number:
        std = r.get(f"bounds/{name}", "with spin noise")[SETTLED, r.group(group).part]
        least = np.square(std).sum(-1).mean()
        return estimate(
            f"{name}: {group} RMSE over the bound",
            lambda squares: float(np.sqrt(squares.mean() / least)),
            [r.squares(name, "modes", group, ALL).sum(-1)],
            (0.9, 1.1),
        )

    return number


def direction(r: Results) -> list[Number]:
    """RMS error along the direction to the first pulsar and across it, ignoring over modes."""
    n = CASES[BEST].timing.directions[0]
    along, across = [], []
    for name in ("ignoring", "modes"):
        error = r.error(BEST, name, "position")[SETTLED]
        square = np.square(error @ n)
        along.append(square.mean(0))
        across.append((np.square(error).sum(-1) - square).mean(0))
    return [
        estimate("RMS error along, ignoring over modes", rms_ratio, along, (2.0, None)),
        estimate("RMS error across, ignoring over modes", rms_ratio, across, (None, 1.05)),
    ]


DECISIONS: dict[str, Decision] = {
    "help": all_of(
        *(
            over(f"{n}: position RMSE over that without", n, "modes", "openloop", (None, 1), at=ALL)
            for n in SIX
        )
    ),
    "position": level("position", 20.0),
    "velocity": level("velocity", 0.1),
    "irregularities": tiers(
        reproduced=against_modes([*SIX, "three years"], "ignoring", (1.05, None)),
        in_part=nees([BEST], "ignoring", (9.0, None)),
    ),
    "optimal": all_of(
        *(over_bound(name, group.name) for name in CASES for group in GROUPS),
        *nees([*CASES], "modes", (5.4, 6.6)),
    ),
    "direction": direction,
    "walk": all_of(
        *against_modes([*CASES], "walk", (None, 1.05)),
        *(number for name in CASES for number in nees([name], "walk", WALK.get(name, NEAR))),
    ),
    "inflation": all_of(
        *nees([BEST], "inflated", NEAR), *against_modes([BEST], "inflated", (None, 1.05))
    ),
    "dynamics": ratio(
        "position RMSE, 1 m², unmodeled, over 0.02 m², modeled",
        ("1 m², unmodeled", "modes"),
        ("0.02 m², modeled", "modes"),
        "position",
        (None, 1.0),
        at=ALL,
    ),
    "old": against_modes(["ten years old"], "ignoring", (2.0, None))[0],
    "fix": of(f"bounds/{USUAL}", "fix", "position error of a fix (km)", (20.0, None)),
    "riccati": all_of(*(of(f"bounds/{n}", "riccati", n, (None, 1e-3)) for n in CASES)),
    "kept": all_of(*(of(f"bounds/{n}", "kept", n, (0.95, None), np.min) for n in CASES)),
}
ROWS, ANSWER = read_ledger(Path(__file__).with_name("ledger.toml"), DECISIONS)
STUDY = Study(
    "mars",
    GROUPS,
    trial,
    parts,
    ROWS,
    figure="figure_02",
    says="Four millisecond pulsars, timed every seven days with an X-ray telescope, give the "
    "position of a spacecraft on its way to Mars to 20 km and its velocity to 0.1 m/s. "
    "Irregularities of the pulsars' spin need to be accounted for.",
    found=ANSWER,
    windows=lambda _config, _times: {ALL: SETTLED},
)
