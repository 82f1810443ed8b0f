"""Exports of a track."""

from __future__ import annotations

import numpy as np
import pytest

import celnav
from celnav.analysis.diagnose import diagnose


def test_a_track_exports_itself(tmp_path):
    filter = celnav.ukf(
        celnav.Motion(lambda x, e: x, np.eye(2)), celnav.Sensor(np.eye(2), np.eye(2))
    )
    track = celnav.run(
        filter, celnav.Gaussian(np.zeros((3, 2)), np.eye(2)), [0.0, 1.0], np.ones((2, 3, 2))
    )
    frame = track.to_dataframe(["a", "b"])
    assert list(frame.columns) == ["t", "run", "a", "b", "std_a", "std_b", "nis"]
    assert len(frame) == 6
    track.to_csv(tmp_path / "t.csv", ["a", "b"])
    np.testing.assert_array_equal(
        np.loadtxt(tmp_path / "t.csv", delimiter=",", skiprows=1), frame.to_numpy(float)
    )


EYE = np.eye(2)
MOTION, PRIOR = celnav.Motion(lambda x, e: x, EYE), celnav.Gaussian(np.zeros(2), EYE)
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])


@FORMS
def test_a_measurement_may_have_more_components_at_some_epochs(form):
    """Satellites rise and set. A missing satellite has the same effect as nan in a measurement with
    all satellites.
    """
    H, R = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]), np.diag([1.0, 2.0, 3.0])
    z = [np.arange(1.0, 1.0 + m) for m in (2, 3, 1, 0)]
    whole = np.full((4, 3), np.nan)
    for k, v in enumerate(z):
        whole[k, : len(v)] = v
    sensor = celnav.Sensor(
        lambda x, e: x @ H[: len(e.u)].T, lambda mean, e: R[: len(e.u), : len(e.u)]
    )
    when = [celnav.Epoch(k, float(k), float(k > 0), v, v) for k, v in enumerate(z)]
    track = celnav.run(celnav.ukf(MOTION, sensor, form=form), PRIOR, when)
    expected = celnav.run(
        celnav.ukf(MOTION, celnav.Sensor(H, R), form=form), PRIOR, np.arange(4.0), whole
    )
    np.testing.assert_array_equal(track.used, expected.used)
    for name in ("mean", "std", "innovation", "whitened", "log_likelihood"):
        np.testing.assert_allclose(getattr(track, name), getattr(expected, name), atol=1e-12)
    assert track.nis.shape == track.dof.shape == (4,)


@FORMS
def test_none_is_missing_as_nan_is(form):
    """Two sensors and several runs: an epoch without a measurement counts the sensor's usual number
    of components as missing.
    """
    filter = celnav.ukf(
        MOTION, celnav.Sensor([[1.0, 0.0]], [[1.0]]), celnav.Sensor(EYE, EYE), form=form
    )
    none = [(np.ones(1), None), None, (None, np.ones((3, 2))), (None, np.array([np.nan, 1.0]))]
    blank = [
        (
            np.ones(1) if z and z[0] is not None else [np.nan],
            z[1] if z and z[1] is not None else [np.nan] * 2,
        )
        for z in none
    ]
    prior = celnav.Gaussian(np.zeros((3, 2)), EYE)
    found, expected = (
        celnav.run(
            filter,
            prior,
            [celnav.Epoch(k, float(k), float(k > 0), z=z) for k, z in enumerate(given)],
        )
        for given in (none, blank)
    )
    for name in found.events:
        np.testing.assert_array_equal(found.events[name], expected.events[name])
    np.testing.assert_array_equal(found.events["missing"], 2 + 3 + 1 + 2)
    for name in ("mean", "innovation", "whitened", "used"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-14)


def test_a_bias_a_fix_and_what_is_drawn_once_count_what_is_missing_too():
    noisy = (
        celnav.Motion(lambda x, e, *w: x + w[0], augment=(EYE,)),
        celnav.Sensor(lambda x, e, *w: x + w[-1], augment=(EYE,)),
    )
    filters = [
        celnav.two_stage(MOTION, celnav.Sensor(EYE, EYE), EYE, PRIOR),
        celnav.receiver.least_squares.least_squares(celnav.Sensor(EYE, EYE)),
        celnav.filters.sequential.SingleDraw.of(celnav.ukf(*noisy)),
        celnav.colored(MOTION, celnav.Sensor(EYE, EYE), 0.5 * EYE),
        celnav.augmented(MOTION, celnav.Sensor(EYE, EYE), 0.5 * EYE),
    ]
    missing = [2, 2, 2, 4, 2]  # `colored` loses the difference after it, too
    z = [None if k == 1 else np.ones(2) for k in range(3)]
    when = [celnav.Epoch(k, float(k), float(k > 0), z=z[k]) for k in range(3)]
    for filter, count in zip(filters, missing, strict=True):
        assert celnav.run(filter, PRIOR, when, on_failure="flag").events["missing"] == count


@FORMS
@pytest.mark.parametrize("linear", [True, False])
def test_no_components_and_no_runs(form, linear):
    nothing = celnav.Sensor(
        np.zeros((0, 2)) if linear else lambda x, e: x[..., :0], np.zeros((0, 0))
    )
    prior = celnav.Gaussian(np.zeros((3, 2)), EYE)
    track = celnav.run(celnav.ukf(MOTION, nothing, form=form), prior, [0.0, 1.0], np.zeros((2, 0)))
    np.testing.assert_allclose(track.std[-1], np.sqrt(2.0))
    assert track.innovation.shape == (2, 3, 0)
    see = celnav.Sensor(EYE if linear else lambda x, e: x.copy(), EYE)
    prior = celnav.Gaussian(np.zeros((0, 2)), EYE)
    track = celnav.run(celnav.ukf(MOTION, see, form=form), prior, [0.0, 1.0], np.ones((2, 0, 2)))
    assert (track.mean.shape, track.innovation.shape, track.failed_at.shape) == (
        (2, 0, 2),
        (2, 0, 2),
        (0,),
    )


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@pytest.mark.parametrize(
    "keep", [("mean",), ("std", "mean"), ["innovation", "std"], ("cov",), {"innovation"}, ()]
)
def test_only_rows_that_are_asked_for_are_kept(engine, keep):
    """They equal the rows of a full track. Covariances are stored with means and standard
    deviations.
    """
    times, z = np.arange(12.0), np.random.default_rng(0).standard_normal((12, 5, 2))
    z[3, 2], z[5] = np.nan, np.nan
    filter = celnav.ukf(MOTION, celnav.Sensor(EYE, EYE))
    whole = celnav.run(filter, PRIOR, times, z, keep="cov", engine=engine)
    track = celnav.run(filter, PRIOR, times, z, keep=keep, engine=engine)
    wanted = {*keep, *(("mean", "std") if "cov" in keep else ())}
    wanted |= {"whitened", "used"} if "innovation" in keep else set()
    for name in ("mean", "std", "innovation", "whitened", "used"):
        row = getattr(track, name)
        assert (row is not None) == (name in wanted)
        if row is not None:
            np.testing.assert_array_equal(row, getattr(whole, name))
            assert row.dtype == getattr(whole, name).dtype
    assert (track.belief is not None) == ("cov" in keep)
    np.testing.assert_array_equal(track.log_likelihood, whole.log_likelihood)
    assert track.sensors == ((2,) if "innovation" in keep else ())


def test_rows_that_are_no_rows_are_refused():
    filter = celnav.ukf(MOTION, celnav.Sensor(EYE, EYE))
    for keep in (("mean", "nis"), ["cow"]):
        with pytest.raises(
            ValueError, match=r"keep: expected a word, or some of \(mean, std, cov, innovation"
        ):
            celnav.run(filter, PRIOR, [0.0], keep=keep)
    with pytest.raises(ValueError, match="keep: expected one of std, cov, mean, nothing, got 3"):
        celnav.run(filter, PRIOR, [0.0], keep=3)


def test_reports_and_diagnoses_of_a_few_rows():
    times, z = np.arange(40.0), np.random.default_rng(3).standard_normal((40, 5, 2))
    filter = celnav.ukf(MOTION, celnav.Sensor(EYE, EYE))
    whole = celnav.run(filter, PRIOR, times, z, engine="numpy")
    for keep in (("mean", "std"), ("mean", "std", "innovation")):
        track = celnav.run(filter, PRIOR, times, z, keep=keep, engine="numpy")
        report = track.report(np.zeros((40, 2)))
        assert report.components == whole.report(np.zeros((40, 2))).components
    few = celnav.run(filter, PRIOR, times, z, keep=("innovation",))
    assert str(diagnose(few)) == str(diagnose(whole))


def test_dates_are_kept():
    """In every time zone, and for stored epochs only."""
    pd = pytest.importorskip("pandas")
    filter = celnav.ukf(MOTION, celnav.Sensor(EYE, EYE))
    zone = pd.date_range("2026-01-01", periods=5, freq="500ms", tz="Europe/Berlin")
    forms = [zone, zone.to_pydatetime(), list(zone), zone.tz_convert(None).to_numpy()]
    for times in forms:
        track = celnav.run(filter, PRIOR, times, np.ones((5, 2)), every=2)
        assert track.start == np.datetime64("2025-12-31T23:00")
        np.testing.assert_array_equal(track.dates, zone.tz_convert(None).to_numpy()[::2])
        frame = track.to_dataframe()
        assert list(frame.columns[:3]) == ["t", "date", "run"]
        np.testing.assert_array_equal(frame["date"].to_numpy(), track.dates)
    plain = celnav.run(filter, PRIOR, np.arange(5.0), np.ones((5, 2)))
    assert plain.start is plain.dates is None
    assert "date" not in plain.to_dataframe()


def test_dates_are_those_that_were_passed():
    """With nanoseconds, in a time zone too, and in years that nanoseconds do not reach."""
    pd = pytest.importorskip("pandas")
    filter = celnav.ukf(MOTION, celnav.Sensor(EYE, EYE))
    fine = pd.DatetimeIndex([f"2026-01-01 00:00:0{k}.123456789" for k in range(3)])
    far = np.array(["2500-01-01T00:00:00.25", "2500-01-02", "2500-01-03"], "datetime64[ms]")
    for times, dates in (
        (fine, fine.to_numpy()),
        (fine.tz_localize("UTC"), fine.to_numpy()),
        (list(fine), fine.to_numpy()),
        (far, far),
        (far.tolist(), far),
    ):
        track = celnav.run(filter, PRIOR, times, np.ones((3, 2)))
        np.testing.assert_array_equal(track.dates, dates)
        np.testing.assert_array_equal(track.to_dataframe()["date"].to_numpy(), dates)
        assert track.to_xarray()["date"].values.tolist() == track.dates.tolist()


@pytest.mark.parametrize("names", [["x", "x"], ["t", "x"], ["x", "run"]])
def test_no_column_of_a_table_hides_another(names, tmp_path):
    track = celnav.run(celnav.ukf(MOTION, celnav.Sensor(EYE, EYE)), PRIOR, [0.0], np.ones((1, 2)))
    text = "^names: expected 2 different ones, none of them t, run, got "
    with pytest.raises(ValueError, match=text):
        track.to_csv(tmp_path / "track.csv", names)
    assert not list(tmp_path.iterdir())


def test_a_data_set_has_what_the_track_has():
    pytest.importorskip("xarray")
    filter = celnav.ukf(MOTION, celnav.Sensor(EYE, EYE))
    prior = celnav.Gaussian(np.zeros((3, 2)), EYE)
    track = celnav.run(filter, prior, np.arange(4.0), np.ones((4, 3, 2)), keep="cov")
    data = track.to_xarray(["east", "north"])
    np.testing.assert_array_equal(data["std"].sel(error="north").isel(run=1), track.std[:, 1, 1])
    assert data["cov"].dims == ("time", "run", "error", "error_")
    for name in ("mean", "cov", "innovation", "used", "nis", "log_likelihood", "failed_at"):
        np.testing.assert_array_equal(data[name].to_numpy(), getattr(track, name))
    assert data["time"].attrs == {"units": "s"}
    several = celnav.Gaussian(np.zeros((2, 3, 2)), EYE)
    track = celnav.run(filter, several, np.arange(4.0), np.ones((4, 1, 1, 2)), keep="nothing")
    data = track.to_xarray()
    assert set(data.data_vars) == {*track.events, "log_likelihood", "failed_at"}
    assert data["failed_at"].dims == ("run0", "run1")
