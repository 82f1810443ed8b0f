"""The study: every run behind the figures, tables and claims, from a configuration and a seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from time import process_time
from typing import Any

import numpy as np

from celnav.filters.records import Epochs, Filter
from celnav.filters.run import run
from celnav.gaussian.belief import nees
from celnav.gaussian.linalg import Array
from celnav.models import orbit
from celnav.papers.csrukf import errata, scenario, theory
from celnav.papers.csrukf.config import STRESS, B, Config, D, P
from celnav.papers.csrukf.theory import UNITS
from celnav.study.montecarlo import Outcome, Plan, Progress, Unit, blocks, carry_out, generator, run_count

PHIS = (0.0, 0.8, 1.0)
WRONG = {1.0: (0.95, 0.99), 0.8: (0.9, 1.0)}
"""True coefficient -> wrong ones assumed by the filter."""
NAMES = {0.0: "0", 0.8: "0.8", 1.0: "I"}


@dataclass(frozen=True)
class Result:
    """Everything that figures, tables, claims and recordings read.

    ``data[study][name]`` are arrays ``(T, runs, ...)``; studies are "P/0", "P/0.8", "P/I", "D/0.8", "D/I", "stress/...",
    "wrong/...", "sensor/...". Errors (estimate minus truth) and deviations are in km and m/s. ``theory`` holds linear
    analysis, ``facts`` single numbers, ``timings`` CPU seconds.
    """

    config: Config
    seed: int
    runs: int
    full: bool
    data: dict[str, dict[str, Array]]
    theory: dict[str, Any]
    facts: dict[str, float]
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def times(self) -> Array:
        """Epochs ``(T,)`` s."""
        return self.config.times

    def arrays(self) -> dict[str, Array]:
        """Arrays to store: errors, NEES and NIS of the two filters that the paper compares, and the first run's deviations."""
        out = {"times": self.times}
        for study in ("P/0", "P/0.8", "P/I"):
            for name in ("srukf", "csrukf"):
                out |= {f"{study}/{name}/{key}": self.data[study][f"{name}/{key}"] for key in ("error", "nees", "nis")}
                out[f"{study}/{name}/std"] = self.data[study][f"{name}/std"][:, 0]
        return out


def _errors(name: str, filter: Filter, sim: scenario.Scenario, epochs: Epochs, out: dict[str, Array]) -> None:
    """Run a filter over a batch and file its errors, deviations, NEES, NIS and the roots of the first run."""

    def also(epoch: Any, state: Any, info: Any) -> dict[str, Any]:  # noqa: ARG001
        belief = state.belief
        mean, root = belief.mean[..., :6], belief.sqrt_cov[..., :6, :6]
        error = mean - epoch.truth
        row = {"error": error * UNITS, "std": belief.std[..., :6] * UNITS, "nees": nees(error, root), "root0": root[:1]}
        lagged = getattr(state, "lagged", None)
        if lagged is not None:
            row["lagged"] = lagged.mean
        if belief.mean.shape[-1] > 6:
            row |= {"noise": belief.mean[..., 6:], "noise_std": belief.std[..., 6:]}
        return row

    track = run(filter, sim.prior, epochs, keep="mean", also=also, on_failure="flag")
    nis = np.full(track.extra["nees"].shape, np.nan) if track.whitened is None else np.where(track.dof == 0, np.nan, track.nis)
    out |= {f"{name}/{key}": value for key, value in track.extra.items()} | {f"{name}/nis": nis}


def _simulated(config: Config, seed: int, study: int, runs: range) -> scenario.Scenario:
    return scenario.simulate(config, [generator(seed, study, r) for r in runs])


def _cases(config: Config, seed: int, study: int, runs: range, names: tuple[str, ...], wrong: tuple[str, ...]) -> dict[str, Array]:
    """Filters on pseudo-positions: those of `scenario.filters` and of `errata` by name."""
    sim = _simulated(config, seed, study, runs)
    out = {"truth": sim.truth, "z": sim.z, "noise": sim.noise}
    known = scenario.filters(config)
    for name in names:
        _errors(name, known[name], sim, sim.epochs_of(name), out)
        if name == "csrukf":  # the lagged estimate of epoch k stands in the state of epoch k + 1
            out["lagged/error"] = (out.pop("csrukf/lagged")[1:] - sim.truth[:-1]) * UNITS
        else:
            out.pop(f"{name}/lagged", None)
    for name in wrong:
        filter = getattr(errata, name)(config)
        _errors(name, filter, sim, sim.epochs(), out)
        out.pop(f"{name}/lagged", None)
    return out


def _assumed(config: Config, seed: int, study: int, runs: range, phis: tuple[float, ...]) -> dict[str, Array]:
    """CSRUKF with a coefficient that is not the true one."""
    sim = _simulated(config, seed, study, runs)
    out: dict[str, Array] = {}
    for phi in phis:
        _errors(f"{phi:g}", scenario.single_transform(config, config.R, phi * np.eye(3)), sim, sim.epochs(), out)
        out.pop(f"{phi:g}/lagged")
    return out


def _sensors(config: Config, seed: int, study: int, runs: range, names: tuple[str, ...]) -> dict[str, Array]:
    """Filters on measured angles, converted to pseudo-positions or ("angles") used as they are."""
    measuring = replace(config, measured="angles")
    sim, filters = _simulated(measuring, seed, study, runs), scenario.filters(measuring)
    out: dict[str, Array] = {}
    for name in names:
        _errors(name, filters[name], sim, sim.epochs_of(name), out)
    return {key: value for key, value in out.items() if not key.endswith("lagged")}


def _peer(config: Config, seed: int) -> dict[str, Array]:
    """filterpy's UKF on the first run with white noise, its distance from ours, and the CPU time of both (ours: 100 runs)."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    sim = _simulated(config, seed, 0, range(100))
    points = MerweScaledSigmaPoints(6, config.alpha, config.beta, config.kappa)
    ukf = UnscentedKalmanFilter(6, 3, config.step_s, lambda x: x[:3], lambda x, dt: orbit.step(x, dt), points)
    ukf.x, ukf.P = np.array(sim.prior.mean[0]), np.array(sim.prior.cov)
    ukf.Q, ukf.R = config.sqrt_Q @ config.sqrt_Q.T, config.R
    start, means = process_time(), [ukf.x]
    for z in sim.z[1:, 0]:
        ukf.predict()
        ukf.update(z)
        means.append(ukf.x)
    theirs = process_time() - start
    start = process_time()
    track = run(scenario.filters(config)["srukf"], sim.prior, sim.epochs(first=False))
    ours = process_time() - start
    assert track.mean is not None
    far = np.abs(track.mean[:, 0, :3] - np.array(means)[:, :3]).max() * 1e3
    return {"filterpy_m": np.array([[far]]), "filterpy_s": np.array([[theirs]]), "srukf_100_s": np.array([[ours]])}


def _hemisphere(config: Config) -> dict[str, float]:
    """Errata 1 and 2 along the nominal orbit: the printed radius, and the error of the printed sign after z turns negative."""
    from celnav.models import sightings

    stars = sightings.star_directions(config.separation)
    path = config.nominal(2900)[:, :3]
    south = int(np.argmax(path[:, 2] < 0.0))
    first, later = path[0], path[south + 300]
    angles = sightings.angles(np.stack([first, later]), stars)
    wrong = sightings.position(angles[1], config.separation, 1.0)
    right = sightings.position(angles, config.separation, np.sign([first[2], later[2]]))
    return {
        "printed_radius_km": float(errata.printed_radius(angles[0, 2])),
        "true_radius_km": float(np.linalg.norm(first)),
        "round_trip_km": float(np.abs(right - np.stack([first, later])).max()),
        "equator_s": float(south * config.step_s),
        "wrong_sign_km": float(np.linalg.norm(wrong - later)),
    }


def _units(config: Config, seed: int, runs: int, block: int) -> list[Unit]:
    units: list[Unit] = []

    def add(label: str, function: Callable[..., dict[str, Array]], count: int, *arguments: Any) -> None:
        units.extend(Unit(label, function, (*arguments[:3], part, *arguments[3:])) for part in blocks(count, block))

    study = {"P": config, "D": replace(D, steps=config.steps)}
    basic = ("srukf", "csrukf", "csrukf+z0", "augmented", "openloop")
    inflated = {0.8: ("srukf-reff",), 1.0: ("srukf-inflated",)}
    for i, phi in enumerate(PHIS):
        names = (*basic, *inflated.get(phi, ()))
        wrong = ("printed_roots", "without_first_update") if phi == 0.0 else ()
        add(f"P/{NAMES[phi]}", _cases, runs, replace(config, phi=phi), seed, i, names, wrong)
    add("D/I", _cases, runs, replace(study["D"], phi=1.0), seed, 3, basic, ())
    add("D/0.8", _cases, runs, replace(study["D"], phi=0.8), seed, 12, ("srukf",), ())
    stress = replace(STRESS, steps=min(STRESS.steps, config.steps))
    stress_runs = max(2, round(STRESS.runs * runs / config.runs))
    for i, phi in enumerate(PHIS):
        extra = ("without_correlation", "printed_roots", *(("no_redraw",) if phi == 0.0 else ()))
        add(f"stress/{NAMES[phi]}", _cases, stress_runs, replace(stress, phi=phi), seed, 4 + i, ("srukf", "csrukf"), extra)
    for phi, assumed in WRONG.items():
        add(f"wrong/{NAMES[phi]}", _assumed, runs, replace(config, phi=phi), seed, PHIS.index(phi), assumed)
    for i, phi in enumerate(PHIS):
        names = ("csrukf-isotropic", "csrukf-jacobian", *(("srukf-isotropic",) if phi == 1.0 else ()))
        add(f"sensor/P/{NAMES[phi]}", _sensors, runs, replace(config, phi=phi), seed, 7 + i, names)
    for i, phi in enumerate((0.0, 1.0)):
        names = ("csrukf-isotropic", "csrukf-jacobian", "angles")
        add(f"sensor/D/{NAMES[phi]}", _sensors, runs, replace(study["D"], phi=phi), seed, 10 + i, names)
    units.append(Unit("peer", _peer, (config, seed)))
    return units


def plan(
    config: Config = P,
    *,
    runs: int | None = None,
    seed: int = 0,
    effort: float = 1.0,
    block: int = 128,
) -> Plan[Result]:
    """The whole study, to be carried out. Pure: reads and writes no files.

    Parameters
    ----------
    config: usually a preset; ``phi`` is set by the study.
    runs: Monte-Carlo runs; None: those of the configuration, times ``effort``.
    seed: see `celnav.study.montecarlo`.
    effort: in (0, 1]; also shortens the long arc and the random settings.
    block: runs computed together. It changes no result.

    Raises
    ------
    ValueError: naming an argument that cannot be.
    """
    count = run_count(config.runs, runs, effort)

    def result(outcomes: Mapping[str, Outcome]) -> Result:
        start = process_time()
        long_steps = max(3000, round(18000 * effort))
        analysis: dict[str, Any] = {
            "P": theory.expected(config, PHIS),
            "sweep/P": theory.expected(config, theory.SWEEP),
            "sweep/D": theory.expected(replace(D, steps=config.steps), theory.SWEEP),
            "B": theory.expected(replace(B, steps=config.steps), PHIS),
            "long": theory.long_arc(config, long_steps),
            "settings": theory.random_settings(config, max(50, round(300 * effort)), generator(seed, 20, 0)),
        }
        facts = _hemisphere(config)
        without, redrawn = errata.redraw_defect(generator(seed, 21, 0))
        upper, lower = errata.root_defect(generator(seed, 22, 0))
        facts |= {"redraw_without": without, "redraw_with": redrawn, "upper_root": upper, "lower_root": lower}
        facts["variance_by_negative_center"] = errata.variance_by_negative_center()
        data = {label: outcome.arrays for label, outcome in outcomes.items()}
        peer = data.pop("peer")
        facts["filterpy_m"] = float(peer["filterpy_m"][0, 0])
        timings = {f"cpu_s {label}": outcome.cpu_s for label, outcome in outcomes.items()}
        timings |= {"cpu_s theory": process_time() - start}
        timings |= {"filterpy one run, s": float(peer["filterpy_s"][0, 0]), "srukf 100 runs, s": float(peer["srukf_100_s"][0, 0])}
        timings["srukf 100 runs / filterpy one run"] = timings["srukf 100 runs, s"] / timings["filterpy one run, s"]
        return Result(config, seed, count, count >= config.runs, data, analysis, facts, timings)

    return Plan(_units(config, seed, count, block), result)


def reproduce(config: Config = P, *, jobs: int = 1, progress: Progress | None = None, **options: Any) -> Result:
    """Carry out `plan` in ``jobs`` processes; the other arguments are those of `plan`."""
    return carry_out(plan(config, **options), jobs=jobs, progress=progress)
