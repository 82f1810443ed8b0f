"""Showcases read back and compared with what went in."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

import celnav
from celnav.analysis.metrics import chi_square_band
from celnav.models.orbit import EARTH, from_elements, propagate
from celnav.models.sightings import star_directions
from celnav.show import colors, scenes
from celnav.show.estimates import Estimate, measurement_states
from celnav.show.plots import Curve, Plot, legend_place
from celnav.show.showcase import Showcase, record
from celnav.study.trial import Group

KEYS = ("own", "other", "third")
SHADES = (colors.ESTIMATE, colors.COMPARISON, colors.OPEN_LOOP)
SCALES = {"position": 1.0, "velocity": 1e3}


def showcase(steps=60, seed=0):
    """A satellite about the Earth, km and km/s."""
    rng = np.random.default_rng(seed)
    truth = propagate(
        from_elements(7136.635, 1e-3, *np.deg2rad([65.0, 30.0, 30.0]), 0.0), 1.0, steps
    )
    n = steps + 1
    scale = np.repeat([0.2, 4e-5], 3)
    found = {}
    for key, color in zip(KEYS, SHADES, strict=True):
        A = scale[:, None] * rng.standard_normal((n, 6, 6))
        nis = rng.chisquare(3, n)
        nis[0] = np.nan
        found[key] = Estimate(
            key.upper(),
            color,
            scale * rng.standard_normal((n, 9, 6)),
            A @ A.mT,
            rng.chisquare(6, n),
            nis,
        )
    noise = np.cumsum(0.2 * rng.standard_normal((n, 3)), 0)
    measured = noise.copy()
    measured[20:25] = np.nan

    def scene(out):
        scenes.sightings(
            out, "world", truth[:, :3], truth[:, 3:], star_directions(np.pi / 2), EARTH.radius_km
        )
        scenes.track(
            out, "world/own", truth[:, :3] + found["own"].errors[:, 0, :3], colors.ESTIMATE
        )

    return Showcase(
        "test: Φ = I",
        "**synthetic**",
        np.arange(n, dtype=float),
        found,
        (Group("position", "km", slice(0, 3)), Group("velocity", "m/s", slice(3, 6), 1e3)),
        truth,
        np.eye(3, 6),
        "km",
        measured,
        3,
        {"position": np.full(n, 0.1)},
        scene,
        [scenes.beside("world", "scene", truth[0], EARTH.radius_km, ["world/own/trail"])],
        {
            "colored noise": {
                "x": Plot(
                    "V", {"truth": Curve(noise[:, 0], colors.TRUTH, "V", np.ones(n), noise[:, 0])}
                )
            }
        },
        bars={"some bars": np.ones(3)},
        legend={colors.STAR: "stars"},
        parameters={"steps": steps},
        facts={"seed": seed},
        counter="step",
    )


def changed(case, key, **changes):
    return dataclasses.replace(
        case, estimates={**case.estimates, key: dataclasses.replace(case.estimates[key], **changes)}
    )


@pytest.fixture(scope="module")
def case():
    return showcase()


@pytest.fixture(scope="module")
def path(case, tmp_path_factory):
    found = tmp_path_factory.mktemp("showcase") / "showcase.rrd"
    record(case, found)
    return found


def chunks(path):
    return rr.chunk.RrdReader(path).stream().to_chunks()


@pytest.fixture(scope="module")
def content(path):
    """Entity -> component -> (times, rows)."""
    found = {}
    for chunk in chunks(path):
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


def scalars(content, entity):
    """Curves ``(T, k)``: a curve, and its bounds."""
    found = rows(content, entity, "Scalars:scalars")
    k = max(map(len, found))
    return np.array([row if len(row) else np.full(k, np.nan) for row in found])


def test_the_file_is_whole_and_holds_a_layout(path):
    reader = rr.chunk.RrdReader(path)
    assert [entry.recording_id for entry in reader.recordings()] == ["test-Phi-I"]
    assert len(reader.blueprints()) == 1
    command = [Path(sys.executable).with_name("rerun"), "rrd", "verify"]
    assert subprocess.run([*command, path], capture_output=True, timeout=60).returncode == 0


def test_the_same_showcase_is_recorded_the_same(path, tmp_path):
    record(showcase(), tmp_path / "again.rrd")
    command = [
        Path(sys.executable).with_name("rerun"),
        "rrd",
        "compare",
        path,
        tmp_path / "again.rrd",
    ]
    assert subprocess.run(command, capture_output=True, timeout=60).returncode == 0


def test_columns_are_whole(path):
    """No entity is logged row by row: each has one chunk with its times."""
    entities = [str(chunk.entity_path) for chunk in chunks(path) if not chunk.is_static]
    assert len(entities) == len(set(entities))


def test_the_text_says_what_colors_mean(path):
    (chunk,) = (c for c in chunks(path) if str(c.entity_path) == "/info")
    (text,) = chunk.to_record_batch().column("TextDocument:text")[0].as_py()
    for words in (
        "**synthetic**",
        "green: truth",
        "orange: OWN",
        "purple: THIRD",
        "stars",
        "khaki: Cramér–Rao",
        "| steps | 60 |",
    ):
        assert words in text


@pytest.mark.parametrize("key", KEYS)
def test_errors_are_about_the_origin_with_three_sigma(case, content, key):
    estimate = case.estimates[key]
    half = np.array(rows(content, f"/error/{key}/ellipsoid", "Ellipsoids3D:half_sizes"))[:, 0]
    centers = np.array(rows(content, f"/error/{key}/ellipsoid", "Ellipsoids3D:centers"))[:, 0]
    expected = (
        3.0 * np.linalg.svd(np.linalg.cholesky(estimate.cov[:, :3, :3]), compute_uv=False)[:, ::-1]
    )
    np.testing.assert_allclose(half, expected, rtol=1e-5)
    np.testing.assert_allclose(centers, estimate.errors[:, 0, :3], rtol=1e-6)
    cloud = np.array(rows(content, f"/error/{key}/ensemble", "Points3D:positions"))
    np.testing.assert_allclose(cloud, estimate.errors[:, 1:, :3], rtol=1e-6)
    segments = np.concatenate(rows(content, f"/error/{key}/trail", "LineStrips3D:strips")[1:])
    np.testing.assert_allclose(segments[:, 1], estimate.errors[1:, 0, :3], rtol=1e-6)
    points = rows(content, "/error/measured/points", "Points3D:positions")
    assert [len(p) for p in points] == np.isfinite(case.measured).all(1).astype(int).tolist()


@pytest.mark.parametrize("key", KEYS)
def test_states_come_back_exactly(case, content, key):
    times, _ = content[f"/state/{key}"]["error"]
    np.testing.assert_allclose(times, case.times)
    np.testing.assert_array_equal(
        np.array(rows(content, f"/state/{key}", "error")), case.estimates[key].errors[:, 0]
    )
    cov = np.array(rows(content, f"/state/{key}", "covariance")).reshape(-1, 6, 6)
    np.testing.assert_array_equal(cov, case.estimates[key].cov)
    np.testing.assert_array_equal(np.array(rows(content, "/state/truth", "mean")), case.truth)


def test_plots(case, content):
    for key in KEYS:
        e = case.estimates[key]
        for i, axis in enumerate("xyz"):
            for quantity, j in (("position", i), ("velocity", i + 3)):
                unit, sigma = SCALES[quantity], np.sqrt(e.cov[:, j, j])
                expected = unit * np.stack([e.errors[:, 0, j], -3.0 * sigma, 3.0 * sigma], 1)
                found = scalars(content, f"/plots/{quantity}/{axis}/{key}")
                np.testing.assert_allclose(found, expected, rtol=1e-12)
        size = np.linalg.norm(e.errors[:, 0, :3], axis=1)
        reach = 3.0 * np.sqrt(np.trace(e.cov[:, :3, :3], axis1=1, axis2=2))
        found = scalars(content, f"/plots/position/size/{key}")
        np.testing.assert_allclose(10.0**found, np.stack([size, reach], 1))
        for name, values in (("nees", e.nees / 6.0), ("nis", e.nis / 3.0)):
            found = scalars(content, f"/plots/consistency/{name}/{key}")[:, 0]
            np.testing.assert_allclose(10.0**found, values)
        rmse = np.sqrt(np.square(1e3 * e.errors[..., 3:]).sum(-1).mean(1))
        found = scalars(content, f"/plots/rmse/velocity/{key}")[:, 0]
        np.testing.assert_allclose(10.0**found, rmse)
    bound = scalars(content, "/plots/rmse/position/bound")[:, 0]
    np.testing.assert_allclose(10.0**bound, case.bound["position"])
    for name, dof in (("nees", 6), ("nis", 3)):
        ends = 10.0 ** scalars(content, f"/plots/consistency/{name}/band")
        np.testing.assert_allclose(ends, [np.array(chi_square_band(dof, 1)) / dof] * 2)
    V = case.plots["colored noise"]["x"].curves["truth"].values
    found = scalars(content, "/plots/colored_noise/x/truth")
    np.testing.assert_allclose(found, np.stack([V, V - 3.0, V + 3.0], 1))


def test_a_curve_with_other_gaps_than_its_bounds_is_drawn_where_it_is(case, tmp_path):
    cov = case.estimates["own"].cov.copy()
    cov[:5] = np.nan
    record(changed(case, "own", cov=cov), tmp_path / "a.rrd")
    found = celnav.show.read(tmp_path / "a.rrd")
    curve, bounds = (found[f"plots/position/x/own{end}"]["scalars"] for end in ("", "/3s"))
    np.testing.assert_allclose(curve, case.estimates["own"].errors[:, 0, 0])
    assert np.isnan(bounds[:5]).all()
    assert np.isfinite(bounds[5:]).all()


def test_states_of_estimates_and_others_are_lanes(case, tmp_path):
    nothing = np.full((61, 1), np.nan)
    innovation, used = np.hstack([case.measured, nothing]), np.ones((61, 4), bool)
    innovation[20:25], innovation[3] = np.nan, 1.0
    used[30:33], used[40, 0] = False, False
    held = measurement_states(innovation, used)
    expected = np.array(["used"] * 61, "U12")
    expected[20:25], expected[30:33], expected[40] = "missing", "rejected", "used in part"
    np.testing.assert_array_equal(held, expected)
    model = ["turn"] * 30 + ["straight"] * 31
    shades = {"turn": colors.ESTIMATE, "straight": colors.COMPARISON}
    more = {"states": {"model": model}, "shades": shades}
    record(dataclasses.replace(changed(case, "own", states=held), **more), tmp_path / "a.rrd")
    found = celnav.show.read(tmp_path / "a.rrd")
    lane = found["states/OWN"]
    np.testing.assert_array_equal(lane.times, [0.0, 20.0, 25.0, 30.0, 33.0, 40.0, 41.0])
    assert lane["state"].tolist() == expected[lane.times.astype(int)].tolist()
    assert found["states/model"]["state"].tolist() == ["turn", "straight"]


@pytest.mark.parametrize(
    ("values", "corner"),
    [
        (np.linspace(0.0, 1.0, 50), "LeftTop"),
        (np.linspace(1.0, 0.0, 50), "RightTop"),
        (np.where(np.arange(50) < 10, np.arange(50) % 2, 1), "RightBottom"),
        (np.where(np.arange(50) > 40, np.arange(50) % 2, 1), "LeftBottom"),
    ],
)
def test_a_legend_has_the_corner_that_is_free(values, corner):
    times = np.arange(50.0)
    found, (low, high) = legend_place(
        Plot("a", {"a": Curve(1.0 * values, colors.TRUTH, "a")}), times, 200.0
    )
    assert found == corner
    assert (low, high) == (values.min(), values.max())


def test_limits_leave_a_legend_free_where_no_corner_is():
    """Two bounds over the whole run: the legend of 47.5 of 190 rows is above them."""
    times, band = np.arange(50.0), np.full(50, 1.0)
    curves = {k: Curve(0.0 * times, colors.TRUTH, k, band / 3.0) for k in "ab"}
    corner, (low, high) = legend_place(Plot("a", curves, limits=(-1.0, 1.0)), times, 190.0)
    assert (corner, low) == ("RightTop", -1.0)
    np.testing.assert_allclose((high - 1.0) / (high - low), 2.5 * 19.0 / 190.0)


def test_a_group_about_its_truth_shows_the_states(case, tmp_path):
    """And a filter that does not estimate the group is left out."""
    truth = 1e3 * case.truth[:, 3:]
    few = changed(
        case,
        "third",
        errors=case.estimates["third"].errors[..., :3],
        cov=case.estimates["third"].cov[:, :3, :3],
    )
    groups = (Group("velocity", "m/s", slice(3, 6), 1e3),)
    record(
        dataclasses.replace(few, groups=groups, truths={"velocity": truth}, scene=None, bound={}),
        tmp_path / "a.rrd",
    )
    found = {
        str(c.entity_path): c.to_record_batch()
        for c in chunks(tmp_path / "a.rrd")
        if not c.is_static
    }
    drawn = found["/plots/velocity/y/own"].column("Scalars:scalars")
    np.testing.assert_allclose(
        [row.as_py()[0] for row in drawn], truth[:, 1] + 1e3 * case.estimates["own"].errors[:, 0, 4]
    )
    assert "/plots/velocity/y/truth" in found
    assert "/plots/velocity/y/third" not in found
    assert "/error/third/ellipsoid" in found


def test_variances_alone_have_bounds_and_no_ellipsoids(case, tmp_path):
    e = case.estimates["own"]
    record(changed(case, "own", cov=e.cov.diagonal(0, -2, -1)), tmp_path / "a.rrd")
    found = {
        (str(c.entity_path), name)
        for c in chunks(tmp_path / "a.rrd")
        for name in c.to_record_batch().schema.names
    }
    assert len(celnav.show.read(tmp_path / "a.rrd")["plots/position/x/own"]["scalars"][0]) == 3
    assert ("/state/own", "variance") in found
    assert not any(entity == "/error/own/ellipsoid" for entity, _ in found)


def test_a_failed_filter_leaves_gaps(case, tmp_path):
    errors, cov = case.estimates["own"].errors.copy(), case.estimates["own"].cov.copy()
    errors[40:], cov[40:] = np.nan, np.nan
    record(changed(case, "own", errors=errors, cov=cov), tmp_path / "a.rrd")
    (chunk,) = (
        c
        for c in chunks(tmp_path / "a.rrd")
        if str(c.entity_path) == "/error/own/ellipsoid" and not c.is_static
    )
    sizes = chunk.to_record_batch().column("Ellipsoids3D:half_sizes")
    assert [len(row.as_py() or []) for row in sizes] == [1] * 40 + [0] * 21


def test_filters_that_failed_from_the_start(case, tmp_path):
    nothing = case
    for key, e in case.estimates.items():
        lost = {
            name: np.full_like(getattr(e, name), np.nan)
            for name in ("errors", "cov", "nees", "nis")
        }
        nothing = changed(nothing, key, **lost)
    record(dataclasses.replace(nothing, scene=None), tmp_path / "a.rrd")
    assert len(rr.chunk.RrdReader(tmp_path / "a.rrd").recordings()) == 1


def test_the_space_of_errors_is_as_large_as_they_are(case, path, tmp_path):
    large = case
    for key, e in case.estimates.items():
        large = changed(large, key, errors=1e3 * e.errors, cov=1e6 * e.cov)
    record(large, tmp_path / "a.rrd")

    def axes(file):
        (chunk,) = (c for c in chunks(file) if str(c.entity_path) == "/error/axes")
        return np.array(chunk.to_record_batch().column("LineStrips3D:strips")[0].as_py())

    np.testing.assert_allclose(axes(tmp_path / "a.rrd"), 1e3 * axes(path), rtol=1e-6)


def test_a_large_start_leaves_the_rest_to_be_seen(case, tmp_path):
    """Values far outside the view are left out; the limits come from the rest of the run."""
    e = case.estimates["own"]
    errors, cov = e.errors.copy(), e.cov.copy()
    errors[:5] *= 1e6
    cov[:5] *= 1e12
    record(changed(case, "own", errors=errors, cov=cov), tmp_path / "a.rrd")
    (chunk,) = (
        c
        for c in chunks(tmp_path / "a.rrd")
        if str(c.entity_path) == "/error/own/estimate" and not c.is_static
    )
    positions = chunk.to_record_batch().column("Points3D:positions")
    assert [len(row.as_py() or []) for row in positions] == [0] * 5 + [1] * 56


def test_plots_alone_need_no_scene(tmp_path):
    times = np.arange(5.0)
    record(
        Showcase(
            "plots",
            "text",
            times,
            plots={"a": {"b": Plot("b", {"c": Curve(times, colors.TRUTH, "c")})}},
        ),
        tmp_path / "a.rrd",
    )
    assert "/plots/a/b/c" in {str(c.entity_path) for c in chunks(tmp_path / "a.rrd")}


def test_an_indefinite_covariance_is_told(case, tmp_path):
    with pytest.raises(ValueError, match="positive semidefinite"):
        record(changed(case, "own", cov=-case.estimates["own"].cov), tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


def test_a_full_run_stays_small(tmp_path):
    record(showcase(600), tmp_path / "a.rrd")
    assert (tmp_path / "a.rrd").stat().st_size < 6_000_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"truth": np.zeros((3, 6))}, "state/truth mean: expected 61 rows, got shape"),
        (
            {"measured": np.zeros((61, 2))},
            r"error/measured/points points: expected shape \(61, any, 3\), got",
        ),
        (
            {"bound": {"position": np.zeros(5)}},
            r"plots/rmse/position/bound values: expected shape \(61,\), got \(5,\)",
        ),
        ({"axes": np.full((3, 6), np.nan)}, "axes: expected finite numbers"),
        ({"times": np.zeros(61)}, "times: expected two or more finite, increasing seconds"),
    ],
)
def test_what_does_not_fit_is_named(case, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        record(dataclasses.replace(case, **change), tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"errors": np.zeros((61, 6))},
            r"estimates own errors: expected shape \(61, runs, n\), got \(61, 6\)",
        ),
        (
            {"cov": np.zeros((61, 5, 5))},
            r"estimates own cov: expected shape \(61, 6, 6\), got \(61, 5, 5\)",
        ),
        (
            {"nees": np.zeros(5)},
            r"plots/consistency/nees/own values: expected shape \(61,\), got \(5,\)",
        ),
    ],
)
def test_an_estimate_that_does_not_fit_is_named(case, tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        record(changed(case, "own", **change), tmp_path / "a.rrd")
    assert list(tmp_path.iterdir()) == []


def test_a_parameter_keeps_its_digits(case, tmp_path):
    given = {"semi_major_axis_km": 7136.635, "elements": (7136.635, 1.809e-3), "step_s": 0.1}
    record(dataclasses.replace(case, parameters=given), tmp_path / "a.rrd")
    told = "".join(
        str(chunk.to_record_batch().to_pydict())
        for chunk in chunks(tmp_path / "a.rrd")
        if chunk.is_static
    )
    for name, value in (("semi_major_axis_km", "7136.635"), ("elements", "7136.635, 0.001809")):
        assert f"| {name} | {value} |" in told
    assert "| step_s | 0.1 |" in told
