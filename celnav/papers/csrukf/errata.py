"""What the paper prints where it is wrong: the list, and the variants as running code, so that their consequences can be shown.

Every filter and formula here should *not* be used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.colored import ColoredState, decorrelation, difference
from celnav.filters.joint import condition, evaluate, joint
from celnav.filters.model import Model, Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions, Info, State
from celnav.filters.sequential import sigma_point
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, SquareRoot, matvec
from celnav.gaussian.rules import Rule, unscented
from celnav.gaussian.spaces import EUCLIDEAN
from celnav.models.orbit import EARTH
from celnav.papers.csrukf.config import Config
from celnav.papers.csrukf.scenario import H, dynamics

ERRATA = (
    ("Eq. 41: r = (R_e / 2) sin(A3 / 2)", "r = R_e / sin(A3 / 2)"),
    ("Eq. 42: positive root for z", "the angles do not give its sign; the hemisphere must be known, and z near 0 is weak"),
    ("Eqs. 4-6: H Phi x", "Phi H x; the printed product is undefined"),
    ("Eq. 14, first line", "J (z* - h - V*): the bracket closes too early"),
    ("Eqs. 16, 18, 19", "V* for V; E[w] - J E[V*]; w for w*. The results, Eqs. 17 and 20, are right"),
    ("Eqs. 2, 10, 11: indices of R, no delta_kj", "zeta_k enters V_k+1 and has covariance R_k+1; white: delta_kj"),
    ("Eq. 5 occurs twice", "references in the text are one too high"),
    ("Eqs. 24, 25: column i for i > n; xi_k,i", "column i - n; xi_k-1,i"),
    ("Eqs. 27, 32: Q*, R* inside the QR", "their square roots"),
    ("Eqs. 28, 33: cholupdate(S, v, W0c)", "sqrt(|W0c|) v and the sign; a negative W0c is a downdate, which can fail"),
    ("Eqs. 29-32 reuse the propagated points", "draw them anew from the prediction, or Q* is missing from the cross covariance"),
    ("the loop starts at k = 1", "the first update, with z*_0, belongs at k = 0"),
    ("the absolute information of z_0 is never used", "update with z_0 once"),
    ("x_k is compared with SRUKF at time k", "x_k has seen z_k+1; the prediction is the fair one"),
    ("Eqs. 35-37", "valid for lower roots only, a downdate for each column of U; common routines return upper roots"),
    ("all measurement noise is white (text)", "zeta is white, V is not"),
    ("RMSE of a 6-vector with mixed units", "for each axis; at which instant is not said"),
    ("SRUKF diverges", "its error follows the noise; it is overconfident"),
    ("CSRUKF changes little from Table 1 to 2", "its error grows 4 to 12 times in position, 5 to 8 times in velocity"),
    ("Tables 2 and 3, both Phi = I", "they differ by a factor 6 to 15 for SRUKF"),
    ("Table 3: SRUKF doubles from Phi = 0.8 I to I", "more than tenfold with any parameters that allow Table 1"),
    ("Tables as statistics of 100 runs", "their axes differ as those of a single run do"),
    ("AR(1) noise on pseudo-positions", "sensors measure angles: V = G a has the coefficient G_k+1 Phi G_k^-1"),
    ("Table 1: CSUKF; references 2 and 6 are the same; reference 9 is about visual tracking", "editorial"),
)
"""What is printed and what is right, in the order of their numbers (from 1)."""


def printed_radius(diameter: ArrayLike) -> Array:
    """Radius from the Earth's angular diameter as printed in Eq. 41, ``(R_e / 2) sin(A3 / 2)``, km; see `sightings.position`."""
    return np.asarray(0.5 * EARTH.radius_km * np.sin(0.5 * np.asarray(diameter)))


def reused_points(f: Model, rule: Rule, sqrt_Q: Array, sqrt_R: Array) -> Filter:
    """SRUKF that measures the propagated points without drawing them anew, Eqs. 29-32: process noise misses the cross terms."""

    motion = Motion(f, sqrt_Q=sqrt_Q)

    def g(points: Array, epoch: Epoch) -> tuple[Array, Array]:
        y = evaluate(motion, points, epoch)
        return y[..., :3], y

    def step(state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        if not epoch.dt:
            return state, (Info(),)
        posterior, info = _reused(state.belief, rule, g, epoch, sqrt_Q, sqrt_R)
        return State(posterior), (info,)

    return FromFunctions(sigma_point(motion, rule=rule).start, step)


def _reused(belief: SquareRoot, rule: Rule, g: Model, epoch: Epoch, sqrt_Q: Array, sqrt_R: Array) -> tuple[Any, Info]:
    """Condition on points that went through ``g`` together: the process noise is added to the state rows only."""
    both = joint(rule, belief, g, epoch, z=epoch.z, process_noise=sqrt_Q, measurement_noise=sqrt_R)
    posterior, info, _ = condition(SquareRoot, both, EUCLIDEAN)
    return posterior, info


def _transformed(config: Config, J: Array) -> tuple[Model, Model]:
    """The system ``f*``, ``h*`` of Eqs. 8 and 14; the epoch's ``z`` is the difference ``z*``."""
    f = dynamics(config)

    def h_star(x: Array, epoch: Epoch) -> Array:
        return np.asarray(f(x, epoch)[..., :3] - config.phi * x[..., :3])

    def f_star(x: Array, epoch: Epoch) -> Array:
        y = f(x, epoch)
        return np.asarray(y + matvec(J, epoch.z - (y[..., :3] - config.phi * x[..., :3])))

    return f_star, h_star


def _two_step(config: Config, J: Array, sqrt_Q: Array, sqrt_R: Array, *, from_start: bool = True) -> Filter:
    """The paper's loop with any gain and any "roots": update with ``z*``, then predict."""
    Phi = config.Phi
    f_star, h_star = _transformed(config, J)
    two = sigma_point(Motion(f_star, sqrt_Q=sqrt_Q), Sensor(h_star, sqrt_R=sqrt_R), rule=config.rule)

    def step(state: ColoredState, epoch: Epoch) -> tuple[ColoredState, tuple[Info, ...]]:
        if state.z is None:
            return ColoredState(state.belief, epoch.z, state.lagged), (Info(),)
        star = epoch._replace(z=difference(Phi, state.z, epoch.z))
        infos: tuple[Info, ...] = (Info(),)
        lagged = State(state.belief, (None,))
        if epoch.k > 1 or from_start:
            lagged, infos = two.update(lagged, star)
        return ColoredState(two.predict(lagged, star).belief, epoch.z, lagged.belief), infos

    return FromFunctions(_started(two), step)


def _started(filter: Filter) -> Callable[[Gaussian], ColoredState]:
    """What starts a filter for colored noise from the belief that another one starts with."""

    def start(prior: Gaussian) -> ColoredState:
        belief = filter.start(prior).belief
        return ColoredState(belief, None, belief)

    return start


def printed_roots(config: Config) -> Filter:
    """Eqs. 27 and 32 as printed: ``Q*`` and ``R*`` themselves in the QR, not their roots (units: km)."""
    star = decorrelation(H, config.sqrt_Q, config.sigma_km * np.eye(3))
    return _two_step(config, star.J, star.sqrt_Q @ star.sqrt_Q.T, star.sqrt_R @ star.sqrt_R.T)


def without_correlation(config: Config) -> Filter:
    """Whitened but not decorrelated: ``J = 0`` with ``Q`` and ``R*``."""
    star = decorrelation(H, config.sqrt_Q, config.sigma_km * np.eye(3))
    return _two_step(config, np.zeros((6, 3)), config.sqrt_Q, star.sqrt_R)


def without_first_update(config: Config) -> Filter:
    """The loop as printed, from k = 1: the first difference enters through ``J`` only."""
    star = decorrelation(H, config.sqrt_Q, config.sigma_km * np.eye(3))
    return _two_step(config, star.J, star.sqrt_Q, star.sqrt_R, from_start=False)


def no_redraw(config: Config) -> Filter:
    """CSRUKF that updates with the points of the previous prediction, Eqs. 29-32."""
    star = decorrelation(H, config.sqrt_Q, config.sigma_km * np.eye(3))
    f_star, h_star = _transformed(config, star.J)
    two = sigma_point(Motion(f_star, sqrt_Q=star.sqrt_Q), Sensor(h_star, sqrt_R=star.sqrt_R), rule=config.rule)

    def step(state: ColoredState, epoch: Epoch) -> tuple[ColoredState, tuple[Info, ...]]:
        if state.z is None:
            return ColoredState(state.belief, epoch.z, state.lagged), (Info(),)
        now = epoch._replace(z=difference(config.Phi, state.z, epoch.z))
        before = state.memory
        if before is None:
            after, (info,) = two.update(State(state.belief, (None,)), now)
            lagged = after.belief
        else:

            def g(points: Array, now: Epoch) -> tuple[Array, Array]:
                y = f_star(points, before)
                return h_star(y, now), y

            lagged, info = _reused(state.lagged, config.rule, g, now, star.sqrt_Q, star.sqrt_R)
        return ColoredState(two.predict(State(lagged, (None,)), now).belief, epoch.z, lagged, now), (info,)

    return FromFunctions(_started(two), step)


def redraw_defect(rng: np.random.Generator) -> tuple[float, float]:
    """Largest difference to the Kalman filter in one linear step, without and with redrawn points (means and covariances)."""
    F, z = np.eye(6) + 0.1 * rng.standard_normal((6, 6)), rng.standard_normal(3)
    eye, rule = np.eye(6), unscented(6)

    def f(x: Array, epoch: object) -> Array:  # noqa: ARG001
        return matvec(F, x)

    prior = Gaussian(np.zeros(6), sqrt_cov=eye)
    P = F @ F.T + eye
    S = H @ P @ H.T + np.eye(3)
    K = np.linalg.solve(S, H @ P).T
    mean, cov = K @ z, P - K @ S @ K.T
    differences = []
    for filter in (reused_points(f, rule, eye, np.eye(3)), sigma_point(Motion(f, eye), Sensor(H, np.eye(3)), rule=rule)):
        state, _ = filter.step(filter.start(prior), Epoch(1, 1.0, 1.0, None, z))
        differences.append(max(np.abs(state.belief.mean - mean).max(), np.abs(state.belief.cov - cov).max()))
    return float(differences[0]), float(differences[1])


def variance_by_negative_center() -> float:
    """Variance of ``|x|^2`` of six unit Gaussians (12) by the rule of ``kappa = -3``, whose center is a downdate."""
    rule = unscented(6, kappa=-3.0)
    y = np.square(rule.nodes).sum(-1)
    return float(rule.wc @ np.square(y - rule.wm @ y))


def root_defect(rng: np.random.Generator) -> tuple[float, float]:
    """Relative error of the covariance ``S S'`` of sigma points drawn with an upper and with the lower root (erratum 15)."""
    A = rng.standard_normal((6, 6))
    P = A @ A.T + np.eye(6)
    upper, lower = np.linalg.cholesky(P).T, np.linalg.cholesky(P)
    return tuple(float(np.linalg.norm(S @ S.T - P) / np.linalg.norm(P)) for S in (upper, lower))  # type: ignore[return-value]
