"""Broadcast orbits: against two-body motion, finite differences, and independent formulas."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from celnav.models import gnss
from celnav.models.gnss import GRAVITY_PARAMETER, ROTATION_RATE, Broadcast, satellites
from celnav.receiver.constellation import synthetic

TOE = 345600.0


def broadcast(**changes):
    """One MEO, one IGSO and one GEO with every correction different from zero."""
    S = 3
    values = {f.name: np.zeros(S) for f in fields(Broadcast)}
    values |= {
        "number": np.array([21.0, 38.0, 3.0]),
        "toe": np.full(S, TOE),
        "toc": np.full(S, TOE),
        "sqrt_a": np.sqrt([27906100.0, 42164000.0, 42164000.0]),
        "e": np.array([5e-4, 2e-3, 3e-4]),
        "i0": np.radians([55.0, 55.0, 6.3]),
        "Omega0": np.array([0.5, 1.5, 2.5]),
        "omega": np.array([0.7, 3.3, 0.5]),
        "M0": np.array([0.3, 1.2, 2.1]),
        "delta_n": np.full(S, 4e-9),
        "Omega_dot": np.full(S, -7e-9),
        "i_dot": np.full(S, 3e-10),
        "cuc": np.full(S, 5e-6),
        "cus": np.full(S, 8e-6),
        "crc": np.full(S, 200.0),
        "crs": np.full(S, -90.0),
        "cic": np.full(S, 7e-8),
        "cis": np.full(S, -4e-8),
        "a0": np.array([1e-4, -2e-4, 3e-4]),
        "a1": np.array([1e-11, 2e-11, -3e-11]),
        "a2": np.full(S, 1e-18),
        "tgd": np.array([1e-8, 5e-9, 1.4e-8]),
    }
    return Broadcast(**(values | changes))


def test_velocities_and_drifts_are_derivatives():
    b, h = broadcast(system=np.array([1.0, 0.0, 0.0])), 0.5
    for t in (TOE - 3000.0, TOE, TOE + 1234.5):
        steps = [satellites(b, t + k * h) for k in (-2, -1, 1, 2)]
        for value, rate, size in (("position", "velocity", 1e-5), ("clock", "drift", 1e-17)):
            a, c, d, e = (getattr(s, value) for s in steps)
            difference = (a - 8.0 * c + 8.0 * d - e) / (12.0 * h)
            np.testing.assert_allclose(
                getattr(satellites(b, t), rate), difference, rtol=0, atol=size
            )


def textbook(b, s, t):
    """The interface document's table, for one satellite."""
    A = b.sqrt_a[s] ** 2
    tk = t - b.toe[s]
    M = b.M0[s] + (np.sqrt(GRAVITY_PARAMETER / A**3) + b.delta_n[s]) * tk
    E = M
    for _ in range(30):
        E = M + b.e[s] * np.sin(E)
    nu = np.arctan2(np.sqrt(1.0 - b.e[s] ** 2) * np.sin(E), np.cos(E) - b.e[s])
    phi = nu + b.omega[s]
    u = phi + b.cus[s] * np.sin(2 * phi) + b.cuc[s] * np.cos(2 * phi)
    r = A * (1.0 - b.e[s] * np.cos(E)) + b.crs[s] * np.sin(2 * phi) + b.crc[s] * np.cos(2 * phi)
    i = b.i0[s] + b.i_dot[s] * tk + b.cis[s] * np.sin(2 * phi) + b.cic[s] * np.cos(2 * phi)
    x, y = r * np.cos(u), r * np.sin(u)
    geo = b.number[s] < 6
    node = (
        b.Omega0[s]
        + (b.Omega_dot[s] - (0.0 if geo else ROTATION_RATE)) * tk
        - ROTATION_RATE * (b.toe[s] % 604800.0)
    )
    P = np.array(
        [
            x * np.cos(node) - y * np.cos(i) * np.sin(node),
            x * np.sin(node) + y * np.cos(i) * np.cos(node),
            y * np.sin(i),
        ]
    )
    if geo:
        a, w = np.radians(-5.0), ROTATION_RATE * tk
        Rx = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
        Rz = np.array([[np.cos(w), np.sin(w), 0], [-np.sin(w), np.cos(w), 0], [0, 0, 1]])
        P = Rz @ Rx @ P
    return P


def by_rotations(b, s, t, mu, relativity):
    """A satellite of GPS [IS-GPS-200, Table 20-IV] or Galileo [Galileo-OS-SIS-ICD, 5.1.1] by
    rotations of its radius, t and toe in seconds of the system's week.
    """
    earth = 7.2921151467e-5
    toe, A = (b.toe[s] + 14.0) % 604800.0, b.sqrt_a[s] ** 2
    tk = (t - toe + 302400.0) % 604800.0 - 302400.0
    M = b.M0[s] + (np.sqrt(mu / A**3) + b.delta_n[s]) * tk
    E = brentq(lambda E: E - b.e[s] * np.sin(E) - M, M - 1.0, M + 1.0, xtol=1e-15, rtol=1e-15)
    anomaly = 2.0 * np.arctan(np.sqrt((1.0 + b.e[s]) / (1.0 - b.e[s])) * np.tan(E / 2.0))
    wave = np.exp(2j * (anomaly + b.omega[s]))
    u, r, i = (
        base + cosine * wave.real + sine * wave.imag
        for base, cosine, sine in (
            (anomaly + b.omega[s], b.cuc[s], b.cus[s]),
            (A * (1.0 - b.e[s] * np.cos(E)), b.crc[s], b.crs[s]),
            (b.i0[s] + b.i_dot[s] * tk, b.cic[s], b.cis[s]),
        )
    )
    node = b.Omega0[s] + b.Omega_dot[s] * tk - earth * (tk + toe)
    clock = (
        b.a0[s]
        + b.a1[s] * tk
        + b.a2[s] * tk**2
        + relativity * b.e[s] * b.sqrt_a[s] * np.sin(E)
        - b.tgd[s]
    )
    return Rotation.from_euler("ZXZ", [node, i, u]).apply([r, 0.0, 0.0]), clock


@pytest.mark.parametrize("toe", [345600.0, 0.0, -14.0, 604786.0, 604800.0 * 955 + 597600.0 - 14.0])
@pytest.mark.parametrize("after", [-7200.0, 0.0, 5400.0])
@pytest.mark.parametrize(
    ("system", "letter", "mu", "relativity"),
    [(1.0, "G", 3.986005e14, -4.442807633e-10), (2.0, "E", 3.986004418e14, -4.442807309e-10)],
)
def test_satellites_are_those_of_their_interface_documents(
    toe, after, system, letter, mu, relativity
):
    """Also at the ends of the system's week, which are 14 s before BeiDou's."""
    when = np.full(3, toe)
    b = broadcast(
        system=np.full(3, system),
        e=np.array([0.01, 2e-3, 3e-4]),
        sqrt_a=np.full(3, 5153.7),
        toe=when,
        toc=when,
    )
    found = satellites(b, toe + after)
    for s in range(3):
        place, clock = by_rotations(b, s, (toe + 14.0 + after) % 604800.0, mu, relativity)
        np.testing.assert_allclose(found.position[s], place, rtol=0, atol=1e-5)
        np.testing.assert_allclose(
            found.clock[s], clock, rtol=0, atol=1e-17
        )  # the constant has ten digits
    assert b.names == [f"{letter}21", f"{letter}38", f"{letter}03"]
    assert not b.geostationary.any()


@pytest.mark.parametrize("week", [0, 756])
def test_positions_are_those_of_the_interface_document(week):
    shift = 604800.0 * week
    b = broadcast(toe=np.full(3, shift + TOE), toc=np.full(3, shift + TOE))
    t = TOE + 2500.0
    found = satellites(b, shift + t).position
    for s in range(3):
        np.testing.assert_allclose(found[s], textbook(broadcast(), s, t), rtol=0, atol=1e-5)


def test_a_reference_time_in_the_other_week_is_near():
    late = broadcast(toe=np.full(3, 604800.0 - 100.0), toc=np.full(3, 604800.0 - 100.0))
    before, after = (satellites(late, t).position for t in (604800.0 + 500.0, 500.0))
    np.testing.assert_allclose(before, after, rtol=0, atol=1e-5)


def test_a_geostationary_satellite_by_the_other_formula_is_far_off():
    b = broadcast()
    wrong = replace(b, number=np.array([21.0, 38.0, 21.0]))
    apart = np.linalg.norm(
        satellites(b, TOE + 1800.0).position - satellites(wrong, TOE + 1800.0).position, axis=-1
    )
    assert apart[:2].max() == 0.0
    assert apart[2] > 1e5


def two_body(r, v, dt):
    """Kepler motion with universal variables."""
    r0, mu = np.linalg.norm(r), GRAVITY_PARAMETER
    alpha, along = 2.0 / r0 - v @ v / mu, r @ v / np.sqrt(mu)
    x = np.sqrt(mu) * dt * alpha
    for _ in range(50):
        z = alpha * x * x
        C, S = (1 - np.cos(np.sqrt(z))) / z, (np.sqrt(z) - np.sin(np.sqrt(z))) / z**1.5
        F = along * x * x * C + (1 - alpha * r0) * x**3 * S + r0 * x - np.sqrt(mu) * dt
        x = x - F / (along * x * (1 - z * S) + (1 - alpha * r0) * x * x * C + r0)
    z = alpha * x * x
    C, S = (1 - np.cos(np.sqrt(z))) / z, (np.sqrt(z) - np.sin(np.sqrt(z))) / z**1.5
    return (1 - x * x / r0 * C) * r + (dt - x**3 / np.sqrt(mu) * S) * v


def test_synthetic_satellites_move_as_two_bodies():
    """Elements from a position and a velocity reproduce the motion, also for geostationary
    satellites.
    """
    b = synthetic(TOE)
    start = satellites(b, TOE)
    spin = ROTATION_RATE * np.stack(
        [-start.position[:, 1], start.position[:, 0], 0.0 * start.position[:, 2]], -1
    )
    for dt in (-900.0, 1800.0, 5400.0):
        later = satellites(b, TOE + dt).position
        for s in range(len(b)):
            inertial = two_body(start.position[s], start.velocity[s] + spin[s], dt)
            c, n = np.cos(ROTATION_RATE * dt), np.sin(ROTATION_RATE * dt)
            fixed = np.array(
                [c * inertial[0] + n * inertial[1], c * inertial[1] - n * inertial[0], inertial[2]]
            )
            np.testing.assert_allclose(later[s], fixed, rtol=0, atol=1e-6, err_msg=b.names[s])


def test_geostationary_satellites_stand_over_their_longitudes():
    b = synthetic(TOE)
    at = {name: satellites(b, TOE).position[k] for k, name in enumerate(b.names)}
    for name, longitude in (
        ("C01", 140.0),
        ("C02", 80.0),
        ("C03", 110.5),
        ("C04", 160.0),
        ("C05", 58.75),
    ):
        assert np.degrees(np.arctan2(at[name][1], at[name][0])) == pytest.approx(longitude, abs=0.2)
    assert len(b) == 5 + 3 + 24
    assert {"C38", "C39", "C40"} <= set(at)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"e": np.array([0.0, 1.0, 0.0])}, "e"),
        ({"sqrt_a": np.zeros(3)}, "sqrt_a"),
        ({"M0": np.zeros(2)}, "M0"),
        ({"crs": np.array([0.0, np.nan, 0.0])}, "crs"),
        ({"system": np.array([0.0, 3.0, 1.0])}, "system"),
    ],
)
def test_elements_that_cannot_be_are_refused_by_name(changes, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        broadcast(**changes)


def test_names_and_kinds():
    b = broadcast()
    assert b.names == ["C21", "C38", "C03"]
    np.testing.assert_array_equal(b.geostationary, [False, False, True])
    assert b.chosen(b.geostationary).names == ["C03"]
    assert {1, 5, 59, 63} <= gnss.GEO_NUMBERS
    assert 6 not in gnss.GEO_NUMBERS
