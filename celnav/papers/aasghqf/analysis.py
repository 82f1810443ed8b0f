"""What needs no simulation: grids, observability, moments of the measurement, the covariance after the first star fix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import sqrtm

from celnav.analysis import observability
from celnav.filters.records import Epoch
from celnav.filters.run import run
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule, gauss_hermite
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.gaussian.sparse_grid import smolyak
from celnav.models import inertial
from celnav.papers.aasghqf.adaptive_grid import Adapted, adapt
from celnav.papers.aasghqf.config import MICRO_G, Config, meters_per_radian
from celnav.papers.aasghqf.scenario import BORESIGHTS, Inputs, filters, measurement, rules, simulate
from celnav.study.montecarlo import generator

MISALIGNMENTS_DEG = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
DIMENSIONS = (2, 4, 6, 8, 10, 13, 16, 20, 25, 30, 40)


def svd_degree(matrix: Array, reference: int | None = None) -> Array:
    """Degree of observability ``(n,)`` of each state by singular values of an observability matrix ``(rows, n)``.

    State j gets the singular value whose right vector has its largest component there, divided by that of the state
    ``reference`` [Liang2014, Eq. 15]. It depends on the units of the states; `information_degree` does not.
    """
    _, values, Vt = np.linalg.svd(matrix)
    degree = np.asarray(values[np.abs(Vt[: len(values)]).argmax(0)])
    return degree if reference is None else degree / degree[reference]


def threshold_weights(degree: ArrayLike, threshold: float) -> tuple[int, ...]:
    """Weights of a sparse grid by degrees of observability: 1 above the threshold, 2 at and below it [Liang2014, Eq. 16]."""
    return tuple(np.where(np.asarray(degree) > threshold, 1, 2).tolist())


class Observability(NamedTuple):
    """Degrees ``(13,)``: the paper's by singular values (misalignment in rad and in deg), free of units, and the weights."""

    svd: Array
    svd_degrees: Array
    information: Array
    by_threshold: tuple[int, ...]
    by_threshold_degrees: tuple[int, ...]
    by_nonlinearity: tuple[int, ...]


def first_epoch(config: Config, phi: Array | None = None) -> Epoch:
    """The first epoch of a flight with a true misalignment (none if not given)."""
    flight = config.flight
    angles = np.zeros(3) if phi is None else phi
    attitude = inertial.misalignment_matrix(angles) @ flight.attitude[0]
    stars = BORESIGHTS @ flight.attitude[0].T
    interval = inertial.navigation(flight, 1, angles, np.zeros(3))
    sigma = config.sigma_z(float(flight.latitude[0]))
    return Epoch(0, 0.0, config.step_s, Inputs(interval, attitude, stars, np.diag(sigma)))


def observe(config: Config, window: int = 60) -> Observability:
    """Observability at the start; the unit-free degree over ``window`` epochs without process noise."""
    epoch = first_epoch(config)
    nav = inertial.navigation(config.flight, 0, np.zeros(3), np.zeros(3))
    meters = meters_per_radian(float(nav.latitude), config.height_m)
    units = np.concatenate([np.ones(5), 1.0 / meters, np.full(3, np.radians(1.0) / 3600.0), np.full(3, MICRO_G)])

    def degree(units: Array) -> Array:
        def f(x: Array) -> Array:
            return inertial.derivative(x * units, nav) / units

        def h(x: Array) -> Array:
            z = measurement(x * units, epoch)
            return np.concatenate([z[..., :6], z[..., 6:] * meters], -1)

        gradients = observability.lie_gradients(f, h, np.zeros(13), 3)
        return svd_degree(gradients.reshape(-1, 13), reference=3)

    in_degrees = np.concatenate([np.full(3, np.radians(1.0)), units[3:]])
    svd, svd_degrees = degree(units), degree(in_degrees)
    information = _information(config, min(window, config.steps))

    def step(x: Array) -> Array:
        return inertial.advance(x, epoch.u.interval, config.step_s)

    nonlinear = observability.nonlinearity_weights(
        [step, lambda x: measurement(x, epoch)], np.zeros(13), config.sigma0, tolerance=1e-3
    )
    return Observability(
        svd,
        svd_degrees,
        information,
        threshold_weights(svd, config.threshold),
        threshold_weights(svd_degrees, config.threshold),
        nonlinear,
    )


def _information(config: Config, window: int) -> Array:
    """Unit-free degree along the flight without errors, all sensors at each epoch."""
    flight, zero = config.flight, np.zeros(3)
    F, H = [], []
    for k in range(window):
        nav = inertial.navigation(flight, 2 * k + 1, zero, zero)
        attitude, stars = flight.attitude[2 * k], BORESIGHTS @ flight.attitude[2 * k].T
        epoch = Epoch(k, 0.0, 0.0, Inputs(None, attitude, stars, np.eye(8)))
        F.append(observability.jacobian(partial(inertial.advance, nav=nav, dt=config.step_s), np.zeros(13)))
        H.append(observability.jacobian(partial(measurement, epoch=epoch), np.zeros(13)))
    R = np.diag(config.sigma_z(float(flight.latitude[0])) ** 2)
    return observability.information_degree(np.diag(config.sigma0**2), np.stack(F[:-1]), np.stack(H), R)


def mean_rotation(sigma: Array) -> Array:
    """Mean of ``C_n^n'`` ``(3, 3)`` for independent zero-mean angles of deviations ``sigma (3,)``, in closed form."""
    damp = np.exp(-0.5 * np.square(sigma))
    return np.diag([damp[1] * damp[2], damp[0] * damp[2], damp[0] * damp[1]])


def mean_error(rule: Rule, sigma_deg: float, config: Config) -> float:
    """Relative error of the mean star residuals by a rule, independent misalignments of one deviation."""
    sigma = np.radians(sigma_deg)
    epoch = first_epoch(config)
    points = np.zeros((len(rule.nodes), 13))
    points[:, :3] = sigma * rule.nodes[:, :3]
    got = rule.wm @ measurement(points, epoch)[:, :6]
    turned = epoch.u.stars @ (mean_rotation(np.full(3, sigma)) - np.eye(3)).T
    exact = (turned @ epoch.u.attitude).ravel()
    return float(np.linalg.norm(got - exact) / np.linalg.norm(exact))


ROOTS: dict[str, Callable[[Array], Array]] = {
    "lower Cholesky": np.linalg.cholesky,
    "symmetric": lambda P: np.real(sqrtm(P)),
    "upper Cholesky": lambda P: np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1],
}


def root_errors(config: Config, rng: np.random.Generator, count: int = 50, sigma_deg: float = 10.0) -> dict[str, dict[str, float]]:
    """Median relative error of the mean star residuals over random correlated covariances, for each rule and kind of root."""
    epoch, fine = first_epoch(config), gauss_hermite(3, 15)
    scale = np.concatenate([np.full(3, np.radians(sigma_deg)), np.ones(10)])
    errors: dict[str, dict[str, list[float]]] = {r: {k: [] for k in ROOTS} for r in ("nonlinear", "sghqf")}
    for _ in range(count):
        A = rng.standard_normal((13, 13))
        P = A @ A.T
        P *= np.outer(scale / np.sqrt(P.diagonal()), scale / np.sqrt(P.diagonal()))

        def mean(rule: Rule, root: Array) -> Array:
            phi = rule.nodes @ root[:3].T
            points = np.concatenate([phi, np.zeros((len(phi), 10))], -1)
            return rule.wm @ measurement(points, epoch)[:, :6]

        exact = mean(fine, np.linalg.cholesky(P[:3, :3]))
        for name, of_kind in errors.items():
            for kind, root in ROOTS.items():
                got = mean(rules(config.level)[name], root(P))
                of_kind[kind].append(float(np.linalg.norm(got - exact) / np.linalg.norm(exact)))
    return {name: {kind: float(np.median(values)) for kind, values in of_kind.items()} for name, of_kind in errors.items()}


def first_fix(rule: Any, sigma_deg: float, config: Config) -> tuple[float, float]:
    """Smallest eigenvalues after a star fix of an isotropic prior: of the posterior misalignment covariance relative to the
    prior, and of the sampled innovation covariance without R, relative to its largest.
    """
    sigma = np.radians(sigma_deg)
    n = 13 if getattr(rule, "n", 13) == 13 else 3
    root = np.diag(np.concatenate([np.full(3, sigma), config.sigma0[3:]]))[:n, :n]
    epoch = first_epoch(config)

    (points,) = rule.points(np.zeros(n), root)
    seen = measurement(np.concatenate([points, np.zeros((len(points), 13 - n))], -1), epoch)[..., :6]
    A = np.concatenate([rule.image(seen, EUCLIDEAN, root).columns, rule.kept(root, ())])
    C = (A * rule.sign) @ A.T
    sampled = C[:6, :6]
    S = sampled + config.sigma_star**2 * np.eye(6)
    posterior = C[6:, 6:] - C[6:, :6] @ np.linalg.solve(S, C[:6, 6:])
    values = np.linalg.eigvalsh(sampled)
    return float(np.linalg.eigvalsh(posterior[:3, :3] / sigma**2)[0]), float(values[0] / values[-1])


def first_fixes(config: Config) -> dict[str, Array]:
    """`first_fix` of every rule over `MISALIGNMENTS_DEG`, ``(angles, 2)`` each; "exact" by a fine tensor rule."""
    known: dict[str, Any] = {**rules(config.level), "exact": gauss_hermite(3, 20)}
    return {name: np.array([first_fix(rule, s, config) for s in MISALIGNMENTS_DEG]) for name, rule in known.items()}


def growth() -> dict[str, Array]:
    """Points and sums of absolute weights of isotropic sparse grids of level 3 and 4 over `DIMENSIONS`, ``(n, 2)`` each."""
    out = {}
    for level, most in ((3, 40), (4, 30)):
        grids = [smolyak(n, level) for n in DIMENSIONS if n <= most]
        out[f"level {level}"] = np.array([[rule.num_sigmas(), np.abs(rule.wm).sum()] for rule in grids])
    return out


def adapted(config: Config, tolerance: float = 1e-3) -> Adapted:
    """The sparse grid that adapts itself to the star residuals of the prior."""
    epoch = first_epoch(config)
    return adapt(lambda x: measurement(x, epoch)[..., :6], np.zeros(13), np.diag(config.sigma0), tolerance=tolerance)


def small_misalignment(config: Config) -> float:
    """Largest difference of the filters' first steps to the Kalman filter at 1e-5 rad, in units of the prior's deviations."""
    small = replace(config, misalignment_deg=(float(np.degrees(1e-5)),) * 3, steps=20)
    sim = simulate(small, [generator(0, 99, r) for r in range(2)])
    known = filters(small)
    means = {}
    for name in ("ekf", "ukf", "sghqf", "aasghqf", "nonlinear", "ckf", "ghqf3"):
        means[name] = run(known[name], sim.prior, sim.epochs(), keep="mean").mean
    reference = means.pop("ekf")
    return float(max(np.abs((mean - reference) / small.sigma0).max() for mean in means.values()))
