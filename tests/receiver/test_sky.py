"""Geometry of satellites; atmospheric delays: published sizes, limits, the interface document's
steps.
"""

from __future__ import annotations

import numpy as np
import pytest

from celnav.receiver.sky import dilution, klobuchar, local_axes, look, saastamoinen

ALPHA, BETA = (0.3820e-7, 0.1490e-7, -0.1790e-6, 0.0), (0.1430e6, 0.0, -0.3280e6, 0.1130e6)


def plain(alpha, beta, t, latitude_deg, longitude_deg, elevation_deg, azimuth_deg):
    """One satellite, in the order of the interface document's steps."""
    E, phi_u, lam_u = elevation_deg / 180.0, latitude_deg / 180.0, longitude_deg / 180.0
    A = np.radians(azimuth_deg)
    psi = 0.0137 / (E + 0.11) - 0.022
    phi_i = min(max(phi_u + psi * np.cos(A), -0.416), 0.416)
    lam_i = lam_u + psi * np.sin(A) / np.cos(phi_i * np.pi)
    phi_m = phi_i + 0.064 * np.cos((lam_i - 1.617) * np.pi)
    local = (4.32e4 * lam_i + t) % 86400.0
    amp = max(sum(a * phi_m**k for k, a in enumerate(alpha)), 0.0)
    per = max(sum(b * phi_m**k for k, b in enumerate(beta)), 72000.0)
    x, F = 2 * np.pi * (local - 50400.0) / per, 1.0 + 16.0 * (0.53 - E) ** 3
    return 299792458.0 * F * (5e-9 if abs(x) >= 1.57 else 5e-9 + amp * (1.0 - x**2 / 2 + x**4 / 24))


@pytest.mark.parametrize("t", [0.0, 20700.0, 50400.0, 86400.0 * 3 + 47000.0])
def test_klobuchar_is_the_documents_recipe(t):
    elevation, azimuth = np.array([5.0, 20.0, 60.0, 89.0]), np.array([10.0, 210.0, 300.0, 95.0])
    found = klobuchar(
        ALPHA,
        BETA,
        t,
        np.radians(40.0),
        np.radians(-100.0),
        np.radians(elevation),
        np.radians(azimuth),
    )
    expected = [
        plain(ALPHA, BETA, t, 40.0, -100.0, e, a) for e, a in zip(elevation, azimuth, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_at_night_the_ionosphere_is_five_nanoseconds_at_the_zenith():
    night = klobuchar(ALPHA, BETA, 0.0, 0.9, 0.0, np.array([np.pi / 2]), np.zeros(1))
    assert night[0] == pytest.approx(1.5, abs=0.01)


def test_the_troposphere_is_as_long_as_is_known():
    zenith = saastamoinen(np.radians(45.0), 0.0, np.array([np.pi / 2]))
    assert zenith[0] == pytest.approx(2.307 + 0.087, abs=0.03)  # 2.31 m dry, a decimeter wet
    assert saastamoinen(0.8, 0.0, np.radians([30.0]))[0] == pytest.approx(
        2.0 * saastamoinen(0.8, 0.0, np.array([np.pi / 2]))[0]
    )
    assert (
        saastamoinen(0.8, 5000.0, np.array([1.0]))[0]
        < 0.6 * saastamoinen(0.8, 0.0, np.array([1.0]))[0]
    )


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: saastamoinen(0.0, 2e4, np.ones(1)), "height_m"),
        (lambda: saastamoinen(0.0, 0.0, np.ones(1), humidity=2.0), "humidity"),
        (lambda: klobuchar(ALPHA[:3], BETA, 0.0, 0.0, 0.0, np.ones(1), np.ones(1)), "alpha"),
        (lambda: klobuchar(ALPHA, (np.nan,) * 4, 0.0, 0.0, 0.0, np.ones(1), np.ones(1)), "beta"),
    ],
)
def test_bad_input_is_refused_by_name(call, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        call()


def test_the_sky_and_its_dilution():
    axes = local_axes(0.0, 0.0)
    place = np.array([6378137.0, 0.0, 0.0])
    seen = look(
        place
        + 1e7 * np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 1.0]]),
        place,
        axes,
    )
    np.testing.assert_allclose(np.degrees(seen.elevation), [90.0, 0.0, 0.0, 45.0], atol=1e-9)
    np.testing.assert_allclose(np.degrees(seen.azimuth[1:3]), [0.0, 90.0], atol=1e-9)
    rng = np.random.default_rng(3)
    q = place + 2e7 * rng.normal(size=(5, 7, 3))
    e = (q - place) / np.linalg.norm(q - place, axis=-1, keepdims=True)
    G = np.concatenate([-e, np.ones((5, 7, 1))], -1)
    C = np.linalg.pinv(np.swapaxes(G, 1, 2) @ G)
    found = dilution(q, place, axes)
    np.testing.assert_allclose(found.geometric, np.sqrt(np.trace(C, axis1=1, axis2=2)))
    np.testing.assert_allclose(found.position, np.sqrt(np.trace(C[:, :3, :3], axis1=1, axis2=2)))
    np.testing.assert_allclose(found.vertical, np.sqrt(C[:, 0, 0]))  # up is x here
    np.testing.assert_allclose(found.time, np.sqrt(C[:, 3, 3]))
    few = dilution(q, place, axes, np.arange(7) < 3)
    assert np.isnan(few.position).all()
    one_place = np.concatenate(
        [q, np.broadcast_to(q[:1, :1], (1, 7, 3))]
    )  # an invalid geometry, which does not affect others
    np.testing.assert_allclose(dilution(one_place, place, axes).position, [*found.position, np.nan])
