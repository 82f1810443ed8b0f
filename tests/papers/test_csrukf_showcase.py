"""The recording of the study of colored noise, read back and compared with what went in."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from celnav.models.orbit import EARTH, from_elements, propagate
from celnav.models.sightings import angles, star_directions
from celnav.papers.csrukf.showcase import Estimate, Showcase, record_showcase

KEYS = ("srukf", "csrukf", "openloop")


def showcase(steps=60, seed=0):
    rng = np.random.default_rng(seed)
    truth = propagate(from_elements(7136.635, 1e-3, *np.deg2rad([65.0, 30.0, 30.0]), 0.0), 1.0, steps)
    n = steps + 1
    scale = np.repeat([0.2, 4e-5], 3)

    def estimate():
        A = scale[:, None] * rng.standard_normal((n, 6, 6))
        P = A @ A.mT
        nis = rng.chisquare(3, n)
        nis[0] = np.nan
        return Estimate(truth + scale * rng.standard_normal((n, 6)), P, rng.chisquare(6, n), nis)

    noise = np.cumsum(0.2 * rng.standard_normal((n, 3)), 0)
    measurements = truth[:, :3] + noise
    measurements[20:25] = np.nan
    return Showcase(
        title="Φ = I",
        notes="**synthetic**",
        times=np.arange(n, dtype=float),
        truth=truth,
        measurements=measurements,
        noise=noise,
        noise_mean=noise + 0.01 * rng.standard_normal((n, 3)),
        noise_std=np.full((n, 3), 0.01),
        estimates={key: estimate() for key in KEYS},
        ensemble={key: rng.standard_normal((n, 8, 3)) for key in KEYS},
        rmse={key: 0.1 + rng.random(n) for key in KEYS},
        bound=np.full(n, 0.1),
        separation=np.pi / 2,
        radius_km=EARTH.radius_km,
        nees_band=(5.34, 6.7),
        nis_band=(2.54, 3.5),
    )


@pytest.fixture(scope="module")
def case():
    return showcase()


@pytest.fixture(scope="module")
def path(case, tmp_path_factory):
    rr.set_strict_mode(True)
    return record_showcase(case, tmp_path_factory.mktemp("csrukf") / "showcase.rrd")


@pytest.fixture(scope="module")
def content(path):
    """Entity -> component -> (times, rows)."""
    found = {}
    for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
        if chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        times = batch.column("t").cast("int64").to_numpy() * 1e-9
        for name in batch.schema.names:
            if name != "t":
                found.setdefault(str(chunk.entity_path), {})[name] = (times, batch.column(name))
    return found


def rows(content, entity, component):
    return [np.array(row.as_py() or []) for row in content[entity][component][1]]


def test_the_file_is_whole_and_holds_a_layout(path):
    reader = rr.chunk.RrdReader(path)
    assert [entry.recording_id for entry in reader.recordings()] == ["csrukf-Phi-I"]
    assert len(reader.blueprints()) == 1
    command = [Path(sys.executable).with_name("rerun"), "rrd", "verify"]
    assert subprocess.run([*command, path], capture_output=True, timeout=60).returncode == 0
    short = path.with_name("short.rrd")
    short.write_bytes(path.read_bytes()[:-100_000])
    assert subprocess.run([*command, short], capture_output=True, timeout=60).returncode != 0


def test_lines_of_the_scene(case, content):
    for entity, line in (("truth", case.truth), *((key, case.estimates[key].mean) for key in KEYS)):
        segments = rows(content, f"/world/{entity}", "LineStrips3D:strips")
        assert len(segments) == len(case.times)
        assert len(segments[0]) == 0
        together = np.concatenate(segments[1:])
        np.testing.assert_allclose(together[:, 0], line[:-1, :3], rtol=1e-6)
        np.testing.assert_allclose(together[:, 1], line[1:, :3], rtol=1e-6)
    points = rows(content, "/world/z", "Points3D:positions")
    assert [len(p) for p in points] == np.isfinite(case.measurements).all(1).astype(int).tolist()
    np.testing.assert_allclose(points[30][0], case.measurements[30], rtol=1e-6)


def test_sight_lines_touch_the_earth_at_the_measured_angle(case, content):
    lines = np.array(rows(content, "/world/sight/earth_limb", "LineStrips3D:strips"), float)
    start, direction = lines[:, :, 0], lines[:, :, 1] - lines[:, :, 0]
    np.testing.assert_allclose(start, np.repeat(case.truth[:, None, :3], 2, 1), rtol=1e-6)
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    # The distance of the Earth's center from the line is its radius.
    np.testing.assert_allclose(np.linalg.norm(np.cross(start, unit), axis=-1), case.radius_km, rtol=1e-6)
    A = angles(case.truth[:, :3], star_directions(case.separation))
    np.testing.assert_allclose(np.arccos(np.sum(unit[:, 0] * unit[:, 1], -1)), A[:, 2], atol=1e-5)
    arcs = np.array(rows(content, "/world/angles", "LineStrips3D:strips"), float) - case.truth[:, None, None, :3]
    ends = arcs[:, :, [0, -1]] / np.linalg.norm(arcs[:, :, [0, -1]], axis=-1, keepdims=True)
    np.testing.assert_allclose(np.arccos(np.sum(ends[:, :, 0] * ends[:, :, 1], -1)), A, atol=1e-5)
    stars = star_directions(case.separation)
    for label, star in zip(("i1", "i2"), stars, strict=True):
        arrow = np.array(rows(content, f"/world/stars/{label}", "Arrows3D:vectors"))[:, 0]
        np.testing.assert_allclose(arrow / np.linalg.norm(arrow, axis=-1, keepdims=True), np.tile(star, (len(arrow), 1)), atol=1e-6)


@pytest.mark.parametrize("key", KEYS)
def test_ellipsoids_are_three_sigma_about_the_errors(case, content, key):
    estimate = case.estimates[key]
    half = np.array(rows(content, f"/error/{key}/ellipsoid", "Ellipsoids3D:half_sizes"))[:, 0]
    centers = np.array(rows(content, f"/error/{key}/ellipsoid", "Ellipsoids3D:centers"))[:, 0]
    expected = 3.0 * np.linalg.svd(np.linalg.cholesky(estimate.cov[:, :3, :3]), compute_uv=False)[:, ::-1]
    np.testing.assert_allclose(half, expected, rtol=1e-5)
    np.testing.assert_allclose(centers, (estimate.mean - case.truth)[:, :3], rtol=1e-6)
    cloud = np.array(rows(content, f"/error/{key}/ensemble", "Points3D:positions"))
    np.testing.assert_allclose(cloud, case.ensemble[key], rtol=1e-6)


@pytest.mark.parametrize("key", KEYS)
def test_states_come_back_exactly(case, content, key):
    times, _ = content[f"/state/{key}"]["mean"]
    np.testing.assert_allclose(times, case.times)
    np.testing.assert_array_equal(np.array(rows(content, f"/state/{key}", "mean")), case.estimates[key].mean)
    cov = np.array(rows(content, f"/state/{key}", "covariance")).reshape(-1, 6, 6)
    np.testing.assert_array_equal(cov, case.estimates[key].cov)


def scalars(content, entity):
    return np.array([row[0] if len(row) else np.nan for row in rows(content, entity, "Scalars:scalars")])


def test_plots(case, content):
    for key in KEYS:
        estimate = case.estimates[key]
        for i, axis in enumerate("xyz"):
            for quantity, j, unit in (("pos_err", i, 1.0), ("vel_err", i + 3, 1000.0)):
                entity = f"/plots/{quantity}/{axis}/{key}"
                np.testing.assert_allclose(scalars(content, entity), unit * (estimate.mean - case.truth)[:, j], rtol=1e-12)
                sigma = unit * np.sqrt(estimate.cov[:, j, j])
                np.testing.assert_allclose(scalars(content, f"{entity}/\\+3s"), 3.0 * sigma, rtol=1e-12)
                np.testing.assert_allclose(scalars(content, f"{entity}/-3s"), -3.0 * sigma, rtol=1e-12)
        np.testing.assert_allclose(10.0 ** scalars(content, f"/plots/nees/{key}"), estimate.nees)
        np.testing.assert_allclose(10.0 ** scalars(content, f"/plots/nis/{key}"), estimate.nis)
        np.testing.assert_allclose(10.0 ** scalars(content, f"/plots/rmse/{key}"), case.rmse[key])
    np.testing.assert_allclose(10.0 ** scalars(content, "/plots/rmse/pcrb"), case.bound)
    np.testing.assert_allclose(10.0 ** scalars(content, "/plots/nees/band/high"), case.nees_band[1])
    np.testing.assert_array_equal(scalars(content, "/plots/V/y/truth"), case.noise[:, 1])
    np.testing.assert_allclose(scalars(content, "/plots/V/y/augmented/-3s"), (case.noise_mean - 3.0 * case.noise_std)[:, 1])


def test_a_failed_filter_leaves_gaps(case, tmp_path):
    estimate = case.estimates["srukf"]
    mean, cov = estimate.mean.copy(), estimate.cov.copy()
    mean[40:], cov[40:] = np.nan, np.nan
    estimates = {**case.estimates, "srukf": dataclasses.replace(estimate, mean=mean, cov=cov)}
    path = record_showcase(dataclasses.replace(case, estimates=estimates), tmp_path / "a.rrd")
    (chunk,) = (
        c for c in rr.chunk.RrdReader(path).stream().filter(content="/error/srukf/ellipsoid").to_chunks() if not c.is_static
    )
    sizes = chunk.to_record_batch().column("Ellipsoids3D:half_sizes")
    assert [len(row.as_py() or []) for row in sizes] == [1] * 40 + [0] * 21


def test_filters_that_failed_from_the_start(case, tmp_path):
    nothing = {
        key: Estimate(*(np.full_like(array, np.nan) for array in dataclasses.astuple(e))) for key, e in case.estimates.items()
    }
    clouds = {key: np.full_like(cloud, np.nan) for key, cloud in case.ensemble.items()}
    path = record_showcase(dataclasses.replace(case, estimates=nothing, ensemble=clouds), tmp_path / "a.rrd")
    assert len(rr.chunk.RrdReader(path).recordings()) == 1


def test_an_indefinite_covariance_is_told(case, tmp_path):
    estimate = case.estimates["csrukf"]
    wrong = {**case.estimates, "csrukf": dataclasses.replace(estimate, cov=-estimate.cov)}
    with pytest.raises(ValueError, match="positive semidefinite"):
        record_showcase(dataclasses.replace(case, estimates=wrong), tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


def test_a_full_run_stays_small(tmp_path):
    assert record_showcase(showcase(600), tmp_path / "a.rrd").stat().st_size < 6_000_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"truth": np.zeros((3, 6))}, r"truth: expected shape \(61, 6\), got \(3, 6\)"),
        ({"truth": np.full((61, 6), np.nan)}, "truth: expected finite"),
        ({"estimates": {}}, r"estimates: expected the filters \['csrukf', 'openloop', 'srukf'\], got \[\]"),
        ({"noise": np.zeros((61, 2))}, r"noise: expected shape \(61, 3\), got \(61, 2\)"),
        ({"bound": np.zeros(5)}, r"bound: expected shape \(61,\), got \(5,\)"),
        ({"nis_band": (0.0, 1.0)}, "nis_band: expected 0 < low < high"),
    ],
)
def test_what_does_not_fit_is_named(case, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        record_showcase(dataclasses.replace(case, **change), tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


def test_an_earth_that_holds_the_satellite_is_told(case, tmp_path):
    with pytest.raises(ValueError, match="radius_km: expected less than"):
        record_showcase(dataclasses.replace(case, radius_km=8000.0), tmp_path / "a.rrd")
