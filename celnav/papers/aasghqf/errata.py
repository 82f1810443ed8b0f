"""What the paper prints where it is wrong: the list, and what follows from it, as running code."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from celnav.gaussian.linalg import Array, matvec
from celnav.gaussian.sparse_grid import ORDERS
from celnav.models import earth, inertial
from celnav.models.inertial import Navigation, mechanize
from celnav.papers.aasghqf.config import Config

ERRATA = (
    ("Table 4: 99 points", "75 for the weights of Table 2; 99 is what a merge at the origin only gives, or a 14th state"),
    ("Eq. 18: the lower bound of the index set", "is strict, and indices of coefficient 0 are dropped before the union of points"),
    ("the example set for n = 2, L = 3 holds (1,1)", "its coefficient is 0; the reference should be to Eq. 13, not Eq. 8"),
    ("Eqs. 12, 14: weights of a point", "a point of several index sets gets the sum over them; products, not lists"),
    ("Eq. 10", "lacks + R_k, and the updates of gain, state and covariance are missing"),
    (
        "exactness of degree 2L - 1 after Eq. 11",
        "of the isotropic rule only; with two weights the total degree is 3, as the UKF's",
    ),
    ("Eq. 22: (d_omega_ie + d_omega_en)", "(2 d_omega_ie + d_omega_en), and the bias as (C_n^n')' C_b^n' nabla"),
    ("Eqs. 26-28", "the matrix in front is C_n'^b, the attitude that the system computes"),
    ("Eq. 15, Table 2: degree of observability", "depends on the units; misalignment in degrees turns the classes over"),
    ("weights by that degree", "spend points on longitude and latitude, which are linear, and save them on phi_z, which is not"),
    ("Table 3 as estimation accuracy", "it averages over the transient; one star fix gives 0.005 deg"),
)
"""What is printed and what is right, in the order of their numbers (from 1)."""


def points_merged_at_the_origin(level: int, weights: Sequence[int]) -> int:
    """Number of points if tensor rules that meet elsewhere than at the origin are counted twice (erratum 1)."""
    budget, n = (level - 1) * min(weights), len(weights)
    inside = _indices(budget, weights)
    total = 1
    for index in inside:
        active = [j for j in range(n) if index[j]]
        if active and _coefficient(index, inside):
            total += int(np.prod([ORDERS[index[j]] for j in active])) - 1
    return total


def printed_count(level: int, weights: Sequence[int], *, strict: bool) -> int:
    """Points of the union over the printed index set, its lower bound strict or not (erratum 2)."""
    budget, low = (level - 1) * min(weights), (level - 1) * min(weights) - sum(weights)
    points: set[tuple[tuple[int, int], ...]] = set()
    for index in _indices(budget, weights):
        cost = sum(i * g for i, g in zip(index, weights, strict=True))
        if cost > low or (not strict and cost == low):
            points.update(product(*(_nodes(i) for i in index)))
    return len(points)


def _indices(budget: int, weights: Sequence[int]) -> set[tuple[int, ...]]:
    """Multi-indices from 0 whose cost fits the budget."""
    found = {(0,) * len(weights)}
    border = set(found)
    while border:
        raised = {(*i[:j], i[j] + 1, *i[j + 1 :]) for i in border for j in range(len(weights))}
        border = {i for i in raised - found if sum(a * g for a, g in zip(i, weights, strict=True)) <= budget}
        found |= border
    return found


def _coefficient(index: tuple[int, ...], inside: set[tuple[int, ...]]) -> int:
    n, out = len(index), 0
    # Indices one up in more channels than fit the budget are outside: few subsets matter.
    reach = [j for j in range(n) if (*index[:j], index[j] + 1, *index[j + 1 :]) in inside]
    for size in range(len(reach) + 1):
        for up in combinations(reach, size):
            raised = tuple(i + (j in up) for j, i in enumerate(index))
            out += (-1) ** size * (raised in inside)
    return out


def _nodes(level: int) -> list[tuple[int, int]]:
    """Ids of the nodes of a one-dimensional rule; 0 is the same in all."""
    order = ORDERS[level]
    return [(0, 0) if i == order // 2 else (order, i) for i in range(order)]


def printed_advance(x: Array, nav: Navigation, dt: float) -> Array:
    """The step with Eq. 22 as printed: the error of the Earth's rate counted once, the bias turned by the wrong matrix."""
    y = np.array(inertial.advance(x, nav, dt))
    d_ie = earth.ROTATION_RATE * np.cos(nav.latitude) * x[..., 6]
    y[..., 3] -= dt * d_ie * nav.velocity[..., 1]
    y[..., 4] += dt * d_ie * nav.velocity[..., 0]
    bias = matvec(nav.attitude, x[..., inertial.BIAS])
    turned = matvec(np.swapaxes(inertial.misalignment_matrix(x[..., inertial.PHI]), -1, -2), bias)
    return np.asarray(np.concatenate([y[..., :3], y[..., 3:5] + dt * (bias - turned)[..., :2], y[..., 5:]], -1))


def against_mechanization(config: Config, misalignment_deg: Sequence[float], duration: int = 60) -> dict[str, float]:
    """Largest difference of the error model, corrected and printed, to a whole navigation system after ``duration`` s.

    Steps of 0.05 s; keys "attitude_arcsec", "velocity_m_per_s", "position_m" and "printed_velocity_m_per_s".
    """
    dt = 0.05
    flight = config.flight_at(0.5 * dt * np.arange(2 * round(duration / dt) + 1))
    phi, sigma = np.radians(np.asarray(misalignment_deg, dtype=np.float64)), config.sigma0
    drift, bias = sigma[inertial.DRIFT], sigma[inertial.BIAS]
    solved = mechanize(flight, inertial.misalignment_matrix(phi) @ flight.attitude[0], drift, bias)
    error = np.concatenate(
        [
            inertial.misalignment_angles(solved.attitude[-1] @ flight.attitude[-1].T),
            solved.velocity[-1] - flight.velocity[-1, :2],
            [solved.longitude[-1] - flight.longitude[-1], solved.latitude[-1] - flight.latitude[-1]],
        ]
    )
    x = np.concatenate([phi, np.zeros(4), drift, bias])
    corrected, printed = x, x
    for k in range(1, len(flight.times), 2):
        corrected = inertial.advance(corrected, inertial.navigation(flight, k, corrected[:3], bias), dt)
        printed = printed_advance(printed, inertial.navigation(flight, k, printed[:3], bias), dt)
    apart = np.abs(corrected[:7] - error)
    return {
        "attitude_arcsec": float(np.degrees(apart[:3].max()) * 3600.0),
        "velocity_m_per_s": float(apart[3:5].max()),
        "position_m": float((apart[5:7] * config.meters).max()),
        "printed_velocity_m_per_s": float(np.abs(printed[3:5] - error[3:5]).max()),
    }
