"""The study of [Sun2015]: the runs, and the numbers that decide the paper's statements, its errors,
and our findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

import celnav
from celnav.analysis.bounds import actual_covariance, colored_bound, riccati
from celnav.analysis.metrics import chi_square_band
from celnav.filters.colored import (
    Decorrelated,
    Decorrelation,
    augmented,
    colored,
    decorrelated,
    decorrelation,
)
from celnav.filters.joint import condition, joint
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions, State
from celnav.filters.run import run
from celnav.filters.sequential import ukf
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, SquareRoot
from celnav.gaussian.rules import unscented
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models import orbit, sightings
from celnav.models.noise import stationary_covariance
from celnav.papers.csrukf.method import FORMS, compared
from celnav.papers.csrukf.scenario import (
    GROUPS,
    STRESS,
    Config,
    D,
    H,
    P,
    assuming,
    filters,
    simulate,
    trial,
)
from celnav.study.ledger import Bounds, Decision, Number, Tiers, estimate, read_ledger, read_printed
from celnav.study.montecarlo import BRIEF
from celnav.study.numbers import (
    Decided,
    all_of,
    consistency,
    constant,
    entries,
    of,
    over,
    ratio,
    tiers,
)
from celnav.study.study import Part, Results, Rngs, Study, monte_carlo
from celnav.study.trial import Trial

__all__ = [
    "BOTH",
    "COLORS",
    "HELD",
    "PHIS",
    "RATIOS",
    "STUDY",
    "SWEEP",
    "TABLE_1",
    "TABLE_2",
    "TABLE_3",
    "UNITS",
    "expected",
    "linear",
    "parts",
    "redrawn",
    "variants",
]

UNITS = np.repeat([1.0, 1e3], 3)
BOTH = ("position", "velocity")
ISOTROPIC = "csrukf-isotropic"
PHIS = {"0": 0.0, "0.8": 0.8, "I": 1.0}
STEPS = (0.0, 0.5, 0.8, 0.95, 1.0)
SWEEP = (-0.5, *STEPS[:4], 0.99, 0.999, 1.0)
COLORS = (0.0, 0.25, 0.5, 0.8, 0.9, 0.95, 0.99)
SMALL = (1e-6, 1e-3, 0.035)
RATIOS = np.arange(0.0, 9.1, 0.5)
FORM_PARTS = ("forms/paper", "forms/small", "forms/long", "forms/angles", "forms/ratios")
HELD = {
    "stationary covariance": lambda phi: 1.0 - phi**2,
    "spectral density": lambda phi: (1.0 - phi) ** 2,
}
"""Quantities that may stay fixed, instead of the increments, while phi increases, and the resulting
factors of the increments' covariance."""
LEDGER = Path(__file__).with_name("ledger.toml")
TABLE_1, TABLE_2, TABLE_3 = (read_printed(LEDGER)[f"table-{n}-levels"] for n in (1, 2, 3))
"""RMSE of x, y, z (km) and vx, vy, vz (m/s), as printed."""


# -- runs ------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False, repr=False)
class Other(Decorrelated):
    """The paper's filter with a decorrelated system other than the correct one."""

    _: KW_ONLY
    star: Decorrelation

    def system(self, mean: Array, epoch: Epoch, used: Array) -> Decorrelation:  # noqa: ARG002
        """The decorrelated system that it was made with."""
        return self.star


def variants(config: Config) -> dict[str, Filter]:
    """Further filters for comparison with `filters`.

    lagged: csrukf's estimate of the previous epoch, which uses one more sample. printed roots: Q*
    and R* themselves, not their roots, in the QR of Eqs. 27, 32. without J: whitened, but not
    decorrelated. phi ...: csrukf with that assumed coefficient.
    """
    csrukf: Any = filters(config)["csrukf"]
    star = decorrelation(H, config.sqrt_Q, np.sqrt(config.R))
    squared = Decorrelation(star.J, star.sqrt_Q @ star.sqrt_Q.T, star.sqrt_R @ star.sqrt_R.T)

    def step(state: State, epoch: Epoch) -> tuple[State, Any]:
        after, infos = csrukf.step(state.memory, epoch)
        return State(after.lagged, after), infos

    def start(prior: Gaussian) -> State:
        state = csrukf.start(prior)
        return State(state.belief, state)

    without = star._replace(J=0.0 * star.J, sqrt_Q=config.sqrt_Q)
    out: dict[str, Filter] = {
        "lagged": FromFunctions(start, step),
        "printed roots": Other(**vars(csrukf), star=squared),
        "without J": Other(**vars(csrukf), star=without),
    }
    for phi in (0.9, 0.95, 0.99, 1.0):
        out[f"phi {phi:g}"] = assuming(config, config.R, phi * np.eye(3))
    return out


def with_variants(config: Config, rngs: Rngs) -> Trial:
    """`trial`, with `variants` among the filters."""
    runs = trial(config, rngs)
    if config.measured == "positions":
        runs = runs._replace(filters={**runs.filters, **variants(config)})
    return runs


def walk(config: Config, rngs: Rngs) -> dict[str, Array]:
    """The colored noise itself, as the error of a filter that returns each measurement:
    ``noise/error (T, runs, 6)``."""
    noise = simulate(config, rngs).noise
    return {"noise/error": np.concatenate([noise, 0.0 * noise], -1)}


# -- results without runs --------------------------------------------------------------------------
def expected(config: Config, phis: Sequence[float], held: str = "") -> dict[str, Array]:
    """Exact standard deviations ``(T, phis, 6)`` km, m/s along the nominal orbit, by filter; SRUKF
    assumes white noise of covariance R.

    The first noise sample has covariance R. With something ``held`` fixed it is stationary.
    """
    phi = np.asarray(phis)[:, None, None]
    F = orbit.transition(config.nominal()[:-1], config.step_s)
    Phi = phi * np.eye(3)
    R = config.R
    Q = config.sqrt_Q @ config.sqrt_Q.T
    P0 = config.sqrt_P0 @ config.sqrt_P0.T
    gains = riccati(F, H, Q, R, P0).gains
    first = R
    if held:
        R = R * HELD[held](phi)
        first = R / (1.0 - phi**2)
    covs = {
        "srukf": actual_covariance(F, H, gains, Q, Phi, R, P0, first),
        "csrukf": colored_bound(F, H, Phi, Q, R, P0),
        "csrukf+z0": colored_bound(F, H, Phi, Q, R, P0, first),
    }
    return {name: UNITS * np.sqrt(cov.diagonal(0, -2, -1)) for name, cov in covs.items()}


def theory(long_steps: int, config: Config, _: Rngs) -> dict[str, Array]:
    """`expected` for P and D, also with each quantity of `HELD` fixed, and for a long arc from a
    poor prior without process noise, with Phi = I and 0.8 I."""
    poor = replace(
        D,
        prior_position_km=100.0,
        prior_velocity_m_per_s=100.0,
        noise_position_km=0.0,
        noise_velocity_km_per_s=1e-15,
    )
    wanted: dict[str, Any] = {
        "P": (config, SWEEP),
        "D": (D, SWEEP),
        "long": (replace(poor, steps=long_steps), (1.0, 0.8)),
    }
    for held in HELD:
        wanted |= {f"{held}/P": (config, COLORS, held), f"{held}/D": (D, COLORS, held)}
    out: dict[str, Array] = {}
    for key, arguments in wanted.items():
        out |= {f"{key}/{name}": std for name, std in expected(*arguments).items()}
    return out


def settings(count: int, config: Config, rngs: Rngs) -> dict[str, Array]:
    """Time-averaged errors with random sigma, P0, Q and Sigma0, each ``(count,)``: can other
    parameters give Table 3?

    The parameters are log-uniform: sigma from 0.03 to 3 km; the prior from 0.1 to 10 sigma and from
    3 mm/s to 0.3 m/s; process noise from 1e-4 to 0.1 sigma and from 1e-6 to 1e-4 m/s; Sigma0 from
    0.1 to 10 R. Table 1 is possible with priors in these ranges.

    growth: ratio of the SRUKF's errors at I and 0.8 I. gain: ratio of the SRUKF's error at 0.8 I to
    the bound of all measurements. (The bound of measurement differences, which CSRUKF reaches, is
    not a bound for SRUKF.) misfit: largest factor between the 24 errors of a parameter set and the
    printed errors.
    """
    ends = ((-1.5, 0.5), (-1.0, 1.0), (-5.5, -3.5), (-4.0, -1.0), (-9.0, -7.0), (-0.5, 0.5))
    sigma, p_r, p_v, q_r, q_v, s0 = (10.0 ** rngs[0].uniform(*end, count) for end in ends)
    P0, Q = (
        np.eye(6) * np.repeat(np.stack(pair, -1) ** 2, 3, -1)[:, None]
        for pair in ((sigma * p_r, p_v), (sigma * q_r, q_v))
    )
    F = orbit.transition(config.nominal()[:-1], config.step_s)
    R = (sigma**2)[:, None, None] * np.eye(3)
    Sigma0 = R * s0[:, None, None] ** 2
    gains = riccati(F, H, Q, R, P0).gains
    far = []
    size = {}
    for case, Phi in (("0.8", 0.8 * np.eye(3)), ("I", np.eye(3))):
        covs = {
            "SRUKF": actual_covariance(F, H, gains, Q, Phi, R, P0, Sigma0),
            "CSRUKF": colored_bound(F, H, Phi, Q, R, P0),
            "bound": colored_bound(F, H, Phi, Q, R, P0, Sigma0),
        }
        for name, cov in covs.items():
            std = UNITS * np.sqrt(cov.diagonal(0, -2, -1).mean(0))
            size[case, name] = np.linalg.norm(std[:, :3], axis=-1)
            if name in TABLE_3[case]:
                far.append(np.abs(np.log(std / TABLE_3[case][name])).max(-1))
    gain = size["0.8", "SRUKF"] / size["0.8", "bound"]
    growth = size["I", "SRUKF"] / size["0.8", "SRUKF"]
    return {"growth": growth, "gain": gain, "misfit": np.exp(np.max(far, axis=0))}


def geometry(config: Config, _: Rngs) -> dict[str, Array]:
    """Eqs. 40 to 42 over one revolution of the printed orbit, from angles without noise.

    radius: radius by Eq. 41 as printed, relative to the true radius. wrong: position error (km) of
    the printed root at each epoch. corrected: position error with the correct hemisphere. later:
    position error of the printed root 300 s after the equator.
    """
    period = 2.0 * np.pi * np.sqrt(config.semi_major_axis_km**3 / orbit.EARTH.mu)
    separation = config.separation
    path = config.nominal(round(period / config.step_s))[:, :3]
    angles = sightings.angles(path, sightings.star_directions(separation))
    z = path[:, 2]
    wrong, right = (
        np.linalg.norm(sightings.position(angles, separation, s) - path, axis=-1)
        for s in (1.0, np.sign(z))
    )
    radius = 0.5 * orbit.EARTH.radius_km * np.sin(0.5 * angles[:1, 2]) / np.linalg.norm(path[0])
    return {
        "wrong": wrong,
        "radius": radius,
        "corrected": right[np.abs(z) > 1.0],
        "later": wrong[[np.argmax(z < 0.0) + 300]],
    }


def redrawn(_: Config, rngs: Rngs) -> dict[str, Array]:
    """One linear step whose update reuses the points of the prediction (Eqs. 29-32), or draws new
    points: differences from the Kalman filter."""
    F = np.eye(6) + 0.1 * rngs[0].standard_normal((6, 6))
    z = rngs[0].standard_normal(3)
    eye = np.eye(6)
    sensor = Sensor(H, np.eye(3))
    epoch = Epoch(1, 1.0, 1.0, None, z)
    prior = Gaussian(np.zeros(6), np.eye(6))
    new, exact = (ukf(Motion(f, eye), sensor) for f in (lambda x, _: x @ F.T, F))
    truth, after = (filter.step(filter.start(prior), epoch)[0].belief for filter in (exact, new))

    def both(x: Array, _: Any) -> tuple[Array, Array]:
        return (x @ F.T)[..., :3], x @ F.T

    belief = new.start(prior).belief
    noises: Any = {"process_noise": eye, "measurement_noise": np.eye(3)}
    old = joint(unscented(6), belief, both, epoch, z=z, **noises)
    reused = condition(SquareRoot, old, EUCLIDEAN)[0]

    def error(belief: Any) -> Array:
        return np.asarray(np.abs(np.vstack([belief.mean - truth.mean, belief.cov - truth.cov])))

    return {"reused": error(reused), "redrawn": error(after)}


def linear(_: Config, rngs: Rngs) -> dict[str, Array]:
    """A random linear system with colored noise: test of the decorrelation, and comparison with
    exact conditioning.

    cross: covariance of process and differenced noise after the decorrelation, relative to before.
    corrected, first sample lost: differences of mean and standard deviation from the filter with
    the noise in its state, in standard deviations, over 40 epochs.
    """
    (rng,) = rngs
    n = 6
    m = 3
    F = 0.98 * np.eye(n) + 0.1 * rng.standard_normal((n, n))
    A = rng.standard_normal((m, n))
    C = rng.standard_normal((m, m))
    Phi = 0.9 * C / np.abs(np.linalg.eigvals(C)).max()
    q, r = (rng.uniform(0.1, 1.0, size) for size in (n, m))
    star = decorrelation(A, np.diag(q), np.diag(r))
    QH = np.diag(q**2) @ A.T
    out = {"cross": np.abs(QH - star.J @ star.sqrt_R @ star.sqrt_R.T) / np.abs(QH).max()}
    motion = Motion(F, np.diag(q**2))
    prior = Gaussian(np.zeros(n), np.eye(n))
    times = np.arange(41.0)
    sensor = Sensor(A, stationary_covariance(Phi, np.diag(r**2)))
    z = celnav.simulate(
        motion, sensor, prior, times, runs=1, seed=int(rng.integers(2**31)), Phi=Phi
    )[1]
    candidates = (
        augmented(motion, sensor, Phi),
        colored(motion, sensor, Phi),
        decorrelated(motion, sensor, Phi, first=False),
    )
    exact, *others = (run(filter, prior, times, z, keep="cov") for filter in candidates)
    for name, track in zip(("corrected", "first sample lost"), others, strict=True):
        std = exact.std[..., :n]
        apart = np.broadcast_arrays(track.mean - exact.mean[..., :n], track.std - std)
        out[name] = np.abs(apart) / std
    return out


def parts(effort: float = 1.0) -> dict[str, Part]:
    """All parts of the study. The long arc, the random parameter sets and the runs of `compared`
    grow with the effort. Below an effort of `BRIEF` the sweep over coefficients has shorter runs.
    """

    filter_runs = partial(monte_carlo, with_variants, cov=True)

    def flights(names: str, config: Config, number: int, runs: int = P.runs) -> Part:
        filters = names.split(", ")
        cost = 8e-6 * config.steps * runs * len(filters)
        return filter_runs(filters, config, number, runs, 128, cost)

    basic = "srukf, csrukf, csrukf+z0, openloop"
    both = ("srukf", "csrukf")
    colored = replace(P, phi=0.8)
    walking = replace(P, phi=1.0)
    poor = replace(D, phi=1.0)
    out = {
        "0.8, many": filter_runs(both, colored, 1, 1600, 200, 16.0, every=60),
        "0, many": filter_runs(both, P, 0, 1600, 200, 14.0, every=P.steps),
        "I, many": filter_runs(both[1:], walking, 2, 400, 200, 2.0, every=P.steps),
        "0": flights(f"{basic}, srukf-reff, lagged, printed roots", P, 0),
        "0.8": flights(f"{basic}, srukf-reff, phi 0.9, phi 1", colored, 1),
        "I": flights(f"{basic}, srukf-inflated, phi 0.95, phi 0.99", walking, 2),
        "D/I": flights(basic, poor, 3),
        "walk": Part(walk, walking, 2, P.runs, 128, 0.1),
        "stress/I": flights("csrukf, without J", replace(STRESS, phi=1.0), 6, STRESS.runs),
        "sensor/D/I": flights(f"{ISOTROPIC}, angles", replace(poor, measured="angles"), 11),
        "theory": Part(
            partial(theory, max(3000, round(18000 * effort))), P, cost=9.0 * effort + 0.5
        ),
        "settings": Part(partial(settings, max(50, round(300 * effort))), P, 20, cost=4.0 * effort),
        "geometry": Part(geometry, P, cost=0.2),
        "redrawn": Part(redrawn, P, 21, cost=0.1),
        "linear": Part(linear, P, 23, cost=0.1),
    }
    many, some, day = (max(20, round(steps * effort)) for steps in (600, 200, 360))
    paper, small, long, angles, ratios = forms = [list[tuple[Config, float]]() for _ in range(5)]
    for c, phi in product((P, D), PHIS.values()):
        paper += [(replace(c, phi=phi, steps=many), unit) for unit in (1.0, 1e3)]
        small += [(replace(c, phi=phi, sigma_km=s, steps=some), 1.0) for s in SMALL]
        long += [(replace(c, phi=phi, steps=day, step_s=240.0), 1.0)]
    for c, size in product((P, D), (1.0, 1e-3)):
        angular = replace(c, measured="angles", steps=some)
        precise = replace(angular, camera_deg=0.005 * size, star_arcsec=3.0 * size)
        angles += [(precise, 1.0)]
    noiseless = replace(D, noise_position_km=0.0, noise_velocity_km_per_s=0.0, steps=20)
    for exponent in RATIOS:
        sigma = D.prior_position_km * 10.0**-exponent
        ratios += [(replace(noiseless, sigma_km=sigma), 1.0)]
    for number, (name, cases) in enumerate(zip(FORM_PARTS, forms, strict=True), 30):
        cost = 2e-3 * len(cases) * cases[0][0].steps
        out[name] = Part(partial(compared, cases), P, number, 20, 20, cost)
    for number, name, c in ((13, "P", P), (14, "D", D)):
        config = replace(c, steps=200) if effort < BRIEF else c
        for phi in STEPS:
            part = flights("srukf, csrukf", replace(config, phi=phi), number)
            out[f"sweep/{name}/{phi:g}"] = part
    return out


# -- numbers of the ledger -------------------------------------------------------------------------
ALL = slice(1, None)
LATE = slice(STRESS.steps // 2, None)
FITTED = "reproduced with fitted parameters"
SETTINGS = {"0.8, many": "Φ = 0.8 I", "I": "Φ = I", "D/I": "Φ = I, poor prior"}


def length(printed: Sequence[float], group: str) -> float:
    """Norm of the printed errors of position or velocity."""
    return float(np.linalg.norm(printed[GROUPS[BOTH.index(group)].part]))


def better(case: str, position: float, velocity: float) -> list[Decided]:
    """RMSE ratio of CSRUKF to SRUKF, at the end and averaged over time."""
    numbers = []
    for group, most in zip(BOTH, (position, velocity), strict=True):
        for at, when in ((-1, "at the end"), (ALL, "averaged")):
            label = f"{group} RMSE over the SRUKF's, {SETTINGS[case]}, {when}"
            numbers.append(over(label, case, "csrukf", "srukf", (None, most), group, at=at))
    return numbers


def changes(r: Results) -> Tiers:
    """Growth of the SRUKF's error from 0.8 I to I, relative to the CSRUKF's growth; computed and
    printed."""
    numbers = []
    cases = (("I", "srukf"), ("0.8", "srukf"), ("0.8", "csrukf"), ("I", "csrukf"))
    for group in BOTH:
        a, b, c, d = (length(TABLE_3[case][filter.upper()], group) for case, filter in cases)
        number = estimate(
            f"growth of the {group} RMSE from 0.8 I to I, SRUKF over CSRUKF",
            lambda a, b, c, d: np.sqrt(a.mean() * c.mean() / (b.mean() * d.mean())),
            [r.squares(*case, group).sum(-1) for case in cases],
            (1.0, None),
            printed=round(a * c / (b * d), 2),
            printed_runs=100,
            printed_count=2,
        )
        numbers.append(number)
    return {"reproduced": numbers, "in part": numbers}


def stepwise(r: Results) -> list[Number]:
    """Growth of the RMSE in every step up in phi, for both filters, priors and groups, with the
    same random numbers; the smallest first."""
    numbers = []
    parts = {"sweep/P": "fitted prior", "sweep/D": "poor prior"}
    for f, part, group, (a, b) in product(("srukf", "csrukf"), parts, BOTH, pairwise(STEPS)):
        label = f"growth of the {group} RMSE, {f.upper()}, {parts[part]}, φ from {a:g} to {b:g}"
        step = (f"{part}/{b:g}", f), (f"{part}/{a:g}", f)
        numbers.append(ratio(label, *step, group, (1.0, None))(r))
    return sorted(numbers, key=lambda number: number.value)


PAPER = [(FORM_PARTS[0], "double")]
STRESSED = [(FORM_PARTS[0], "single"), *product(FORM_PARTS[1:4], ("double", "single"))]


def of_forms(r: Results, what: str, where: Sequence[tuple[str, str]], *forms: str) -> Array:
    """A result of `compared` for each run and case ``(runs, cases)``, the largest of the forms."""
    return np.concatenate(
        [np.max([r.get(part, f"{f}, {p}/{what}") for f in forms], 0) for part, p in where]
    ).T


def stable(r: Results) -> Tiers:
    """Whether the covariance form fails more often, or has larger errors, than the printed root: in
    double precision, or only under stress.

    The covariance form is P - K S K', plain or symmetrized, whichever is worse in a run. Under
    stress all cases have the same weight.
    """

    lost = partial(of_forms, r, "lost")
    covariance = ("plain", "symmetrized")

    def more(where: Sequence[tuple[str, str]]) -> Array:
        return lost(where, *covariance) - lost(where, "downdated")

    def share(label: str, which: Array, accept: Bounds = (None, None)) -> Number:
        return estimate(label, np.mean, [which], accept)

    gap = more(PAPER)
    if (gap > 0.0).any():
        worst = "excess share of failed runs, in the worst case"
        first = estimate(worst, lambda x: x.mean(0).max(), [gap], (1e-9, None))
    else:
        first = estimate(
            "RMSE over that of the printed root, in the worst case",
            lambda a, b: np.sqrt((a.mean(0) / b.mean(0)).max()),
            [of_forms(r, "square", PAPER, *names) for names in (covariance, ("downdated",))],
            (1.0 + 1e-6, None),
        )
    single, double = ([(part, p) for part in FORM_PARTS[:4]] for p in ("single", "double"))
    said = "in single precision, share"
    off = f"{said} of the runs of one QR with a state that is off by 1 σ or more"
    others = [
        *(share(f"{said} of runs that fail, {FORMS[f]}", lost(single, f)) for f in FORMS),
        share(off, of_forms(r, "apart", single, "array") >= 1.0),
        Number("runs that fail in double precision, any form", lost(double, *FORMS).sum()),
        Number("largest difference of two forms (σ)", of_forms(r, "apart", PAPER, *FORMS).max()),
    ]
    under = share("under stress, excess share of failed runs", more(STRESSED), (0.05, None))
    return {"reproduced": [first], "in part": [under], "not reproduced": others}


def held_fixed(r: Results) -> list[Number]:
    """Smallest and largest factor of the RMSE for an increase of phi, over both priors, position
    and velocity, at the end and averaged over time."""

    def step(extreme: Any, held: str, name: str, most: float | None = 1.0) -> Number:
        steps = []
        for prior in "PD":
            square = np.square(r.get("theory", f"{held}/{prior}/{name}"))
            square = square.reshape(-1, len(COLORS), 2, 3).sum(-1)
            for rms in (square[-1], square[1:].mean(0)):
                steps.append(np.sqrt(rms[1:] / rms[:-1]))
        size = {np.min: "smallest", np.max: "largest"}[extreme]
        label = (
            f"{size} growth of the RMSE, {name.upper().replace('+Z0', ' with z_0')}, fixed {held}"
        )
        return Number(label, float(extreme(steps)), (None, most))

    covariance, density = HELD
    return [
        step(np.min, covariance, "srukf", None),
        step(np.min, covariance, "csrukf", None),
        step(np.max, density, "srukf"),
        step(np.max, density, "csrukf+z0"),
        step(np.max, density, "csrukf", None),
    ]


def converges(case: str, prior: str) -> list[Decided]:
    """Ratios of the final error to the initial error and to the open-loop error. An interval that
    contains 1 shows no convergence."""
    start = over(
        f"final over initial position RMSE, {prior}",
        case,
        "csrukf",
        "csrukf",
        (None, 1.0),
        to=0,
        strict=True,
    )
    loop = over(
        f"final position RMSE over the open loop's, {prior}",
        case,
        "csrukf",
        "openloop",
        (None, 1.0),
        strict=True,
    )
    return [start, loop]


def over_theory(case: str) -> Decided:
    """Ratio of CSRUKF's final 3-D position RMSE, from many runs, to the posterior Cramer-Rao bound
    of all measurements. CSRUKF uses only differences; the bound also uses the first sample."""

    def number(r: Results) -> Number:
        bound = np.square(r.get("theory", "P/csrukf+z0")[-1, SWEEP.index(PHIS[case]), :3]).sum()
        ours = r.squares(f"{case}, many", "csrukf", "position").sum(-1)
        return estimate(
            f"final position RMSE over the bound, Φ = {case}",
            lambda x: np.sqrt(x.mean() / bound),
            [ours],
            (0.85, 1.15),
        )

    return number


def long_arc(r: Results) -> list[Number]:
    """Ratio of SRUKF's 3-D RMSE to the bound of all measurements after 3000 s, from a poor prior.
    The bound of measurement differences is not a bound for SRUKF, which uses the samples."""
    srukf = r.get("theory", "long/srukf")[3000, :, :3]
    bound = r.get("theory", "long/csrukf+z0")[3000, :, :3]
    walk, colored = np.linalg.norm(srukf, axis=-1) / np.linalg.norm(bound, axis=-1)
    return [
        Number("position RMSE over the bound, Φ = I", walk, (1.5, 2.5)),
        Number("position RMSE over the bound, Φ = 0.8 I", colored, (1.0, 1.05)),
    ]


def growth(a: Sequence[float], b: Sequence[float]) -> float:
    """Largest factor between the position entries of two printed rows."""
    return float(np.divide(b[:3], a[:3]).max())


def right(wrong: Array) -> float:
    """Share of the errors (km) that are below 1 m."""
    return float((wrong < 1e-3).mean())


# -- the ledger ------------------------------------------------------------------------------------
SAME = ((-1, -1, "at the end"), (ALL, ALL, "averaged"))
AHEAD = ((-1, -2, "at the end"), (slice(2, None), slice(1, -1), "averaged"))
CELLS = [((case, filter.lower()), TABLE_3[case][filter]) for case in TABLE_3 for filter in TABLE_1]

DECISIONS: dict[str, Decision] = {
    "white-alike": all_of(
        *(
            over(
                f"{group} RMSE over the SRUKF's, {name}, {w}",
                "0",
                f,
                "srukf",
                (0.885, 1.13),
                group,
                at=at,
                to=to,
            )
            for f, name, when in (("csrukf", "same data", SAME), ("lagged", "as printed", AHEAD))
            for group in BOTH
            for at, to, w in when
        )
    ),
    "table-1-levels": entries(
        [(("0, many", f.lower()), TABLE_1[f]) for f in TABLE_1], BOTH, FITTED, 100, 2
    ),
    "srukf-diverges": all_of(
        consistency(
            "mean NEES at the end", ("I", "srukf"), (10.0 * chi_square_band(6, 100)[1], None)
        ),
        over(
            "position RMSE, 600 s over 300 s",
            "I",
            "srukf",
            "srukf",
            (1.0, None),
            to=300,
        ),
        ratio(
            "position RMSE over that of the noise itself",
            ("I", "srukf"),
            ("walk", "noise"),
            "position",
        ),
    ),
    "csrukf-converges": all_of(*converges("I", "fitted prior"), *converges("D/I", "poor prior")),
    "csrukf-far-better": tiers(
        reproduced=[*better("I", 0.26, 0.34), *better("D/I", 0.26, 0.34)],
        in_part=better("I", 0.26, 0.34),
    ),
    "table-2-levels": entries(
        [(("I", f.lower()), TABLE_2[f]) for f in TABLE_2], BOTH, FITTED, 100, 2
    ),
    "little-change": all_of(
        *(
            constant(
                f"growth of the {g} RMSE, printed",
                length(TABLE_2["CSRUKF"], g) / length(TABLE_1["CSRUKF"], g),
                (None, 3.2),
            )
            for g in BOTH
        ),
        *(
            ratio(f"growth of the {g} RMSE", ("I", "csrukf"), ("0", "csrukf"), g, (None, 3.2))
            for g in BOTH
        ),
    ),
    "larger-phi-worse": stepwise,
    "srukf-changes-more": changes,
    "better-at-both": tiers(
        reproduced=[*better("0.8, many", 0.16, 0.28), *better("I", 0.15, 0.26)],
        in_part=[*better("0.8, many", 1.0, 1.0), *better("I", 0.15, 0.26)],
    ),
    "table-3-levels": lambda r: {
        **entries(CELLS, BOTH, "reproduced", 100, 3)(r),
        "not reproduced": [
            of(
                "settings",
                "misfit",
                "largest factor between printed and ours, best random parameters",
                reduce=np.min,
            )(r)
        ],
    },
    "square-roots-stabilize": stable,
    "geometry-fixes-position": tiers(
        reproduced=[
            of(
                "geometry",
                "wrong",
                "share of a revolution with position errors below 1 m",
                (1.0, None),
                right,
            )
        ],
        in_part=[
            of(
                "geometry",
                "wrong",
                "share of the paper's own 600 s with position errors below 1 m",
                (1.0, None),
                lambda x: right(x[: P.steps + 1]),
            ),
            of(
                "geometry",
                "corrected",
                "largest position error if the hemisphere is given (km)",
                (None, 1e-3),
            ),
            of("geometry", "wrong", "largest position error (km)"),
        ],
    ),
    "whitened-and-optimal": tiers(
        reproduced=[
            of(
                "redrawn",
                "reused",
                "printed step less the Kalman filter (σ of the prior)",
                (None, 1e-9),
            ),
            of(
                "linear",
                "first sample lost",
                "without the first sample, less the exact solution (σ)",
                (None, 1e-9),
            ),
        ],
        in_part=[
            of("linear", "cross", "part of the cross-covariance that remains", (None, 1e-9)),
            of(
                "linear",
                "corrected",
                "corrected filter less the exact solution (σ)",
                (None, 1e-9),
            ),
        ],
    ),
    "erratum-radius": of("geometry", "radius", "printed over correct radius r", (0.39, 0.41)),
    "erratum-hemisphere": of(
        "geometry", "later", "position error 300 s past the equator (km)", (3900.0, 4100.0)
    ),
    "erratum-shapes": constant("columns of H less rows of Φ", len(H.T) - len(P.Phi), (1, None)),
    "erratum-moments": of(
        "linear", "cross", "part of the cross-covariance that remains, corrected", (None, 1e-9)
    ),
    "erratum-9-roots-nees": all_of(
        consistency(
            "mean NEES at the end, Φ = 0, printed roots in km", ("0", "printed roots"), (1e3, None)
        ),
        over(
            "velocity RMSE over the corrected filter's",
            "0",
            "printed roots",
            "csrukf",
            (5.0, None),
            "velocity",
        ),
    ),
    "erratum-11-redraw": all_of(
        of(
            "redrawn",
            "reused",
            "one linear step less the Kalman filter (σ of the prior)",
            (0.01, None),
        ),
        of("redrawn", "redrawn", "the same with new points", (None, 1e-12)),
    ),
    "erratum-19-growth": constant(
        "largest printed growth of an axis, Table 1 to 2",
        growth(TABLE_1["CSRUKF"], TABLE_2["CSRUKF"]),
        (3.0, None),
    ),
    "erratum-20-contradiction": constant(
        "largest ratio of the SRUKF's printed RMS errors, Table 3 to 2",
        growth(TABLE_2["SRUKF"], TABLE_3["I"]["SRUKF"]),
        (3.0, None),
    ),
    "erratum-21-growth": all_of(
        of(
            "settings",
            "growth",
            "least growth of the SRUKF's RMSE from 0.8 I to I, random settings",
            (5.0, None),
            np.min,
        ),
        of(
            "settings",
            "gain",
            "largest RMSE of the SRUKF over the bound at 0.8 I, random settings",
            (None, 5.0),
        ),
    ),
    "remark-first-sample": over(
        "position RMSE with z_0 over RMSE without, poor prior, Φ = I",
        "D/I",
        "csrukf+z0",
        "csrukf",
        (None, 0.6),
    ),
    "remark-angle-space": over(
        "position RMSE with whitened angles over that with whitened positions",
        "sensor/D/I",
        "angles",
        ISOTROPIC,
        (None, 0.95),
    ),
    "openloop-final": over(
        "3-D position RMSE over the open loop's", "I", "csrukf", "openloop", (0.98, 1.02)
    ),
    "consistent": all_of(
        *(
            consistency(f"mean NEES at the end, Φ = {n}", (f"{n}, many", "csrukf"), (5.0, 7.1))
            for n in PHIS
        )
    ),
    "at-the-bound": all_of(*map(over_theory, PHIS)),
    "cheap-remedy": all_of(
        over(
            "3-D position RMSE over the CSRUKF's, Φ = 0.8 I",
            "0.8",
            "srukf-reff",
            "csrukf",
            (0.9, 1.1),
        ),
        consistency("mean NEES at the end, Φ = 0.8 I", ("0.8", "srukf-reff"), (4.8, 7.1)),
        over(
            "3-D position RMSE over the CSRUKF's, Φ = I",
            "I",
            "srukf-inflated",
            "csrukf",
            (5.0, None),
        ),
        consistency("mean NEES at the end, Φ = I", ("I", "srukf-inflated"), (200.0, None)),
    ),
    "larger-phi-convention": held_fixed,
    "poor-prior": all_of(
        over("position RMSE over the SRUKF's, without z_0", "D/I", "csrukf", "srukf", (1.3, None)),
        over("position RMSE over the SRUKF's, with z_0", "D/I", "csrukf+z0", "srukf", (None, 0.85)),
    ),
    "wrong-coefficient": all_of(
        consistency("mean NEES, φ = 1, assumed 0.95", ("I", "phi 0.95"), (50.0, None), at=ALL),
        consistency("mean NEES, φ = 0.8, assumed 1", ("0.8", "phi 1"), (4.9, 7.3), at=ALL),
        over(
            "position RMSE over that with the true φ",
            "0.8",
            "phi 1",
            "csrukf",
            (2.0, 4.0),
        ),
    ),
    "correlation-matters": over(
        "position RMSE over that with J, Φ = I",
        "stress/I",
        "without J",
        "csrukf",
        (1.2, None),
        at=LATE,
    ),
    "long-arc": long_arc,
    "nis-csrukf": all_of(
        *(
            consistency(f"mean NIS, Φ = {n}", (n, "csrukf"), (2.8, 3.2), at=ALL, what="nis")
            for n in PHIS
        )
    ),
}

ROWS, ANSWER = read_ledger(LEDGER, DECISIONS)
STUDY = Study(
    "csrukf",
    GROUPS,
    trial,
    parts,
    ROWS,
    figure="figure_15",
    says="Differencing whitens colored measurement noise. A square-root UKF that uses differences "
    "is as good as the ordinary one in white noise, and converges where the ordinary one diverges.",
    found=ANSWER,
)
