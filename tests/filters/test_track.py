"""What a track exports."""

from __future__ import annotations

import numpy as np
import pytest

import celnav


def test_a_track_exports_itself(tmp_path):
    filter = celnav.sequential(
        celnav.predict(lambda x, e: x, celnav.unscented(2), np.eye(2)), celnav.update(np.eye(2), celnav.unscented(2), np.eye(2))
    )
    track = celnav.run(filter, celnav.square_root(np.zeros((3, 2)), np.eye(2)), celnav.epochs([0.0, 1.0], np.ones((2, 3, 2))))
    frame = track.to_dataframe(["a", "b"])
    assert list(frame.columns) == ["t", "run", "a", "b", "std_a", "std_b", "nis"]
    assert len(frame) == 6
    track.to_csv(tmp_path / "t.csv", ["a", "b"])
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "t.csv", delimiter=",", skiprows=1), frame.to_numpy(float))


EYE, RULE = np.eye(2), celnav.unscented(2)
MOTION = celnav.predict(lambda x, e: x, RULE, EYE)
FORMS = pytest.mark.parametrize("form", [celnav.square_root, celnav.covariance], ids=["root", "cov"])


@FORMS
def test_a_measurement_may_have_more_components_at_some_epochs(form):
    """Satellites come and go. What is not there is what nan is in a measurement of all."""
    H = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    h = lambda x, e: x @ H[: len(e.u)].T  # noqa: E731
    R = lambda mean, e: np.diag([1.0, 2.0, 3.0][: len(e.u)])  # noqa: E731
    filter = celnav.sequential(MOTION, celnav.update(h, RULE, R))
    z = [np.arange(1.0, 1.0 + m) for m in (2, 3, 1, 0)]
    track = celnav.run(filter, form(np.zeros(2), EYE), [celnav.Epoch(k, float(k), float(k > 0), v, v) for k, v in enumerate(z)])
    whole = np.full((4, 3), np.nan)
    for k, v in enumerate(z):
        whole[k, : len(v)] = v
    both = celnav.sequential(MOTION, celnav.update(H, RULE, np.diag([1.0, 2.0, 3.0])))
    expected = celnav.run(both, form(np.zeros(2), EYE), celnav.epochs(np.arange(4.0), whole))
    np.testing.assert_array_equal(track.used, expected.used)
    for name in ("mean", "std", "innovation", "white", "log_likelihood"):
        np.testing.assert_allclose(getattr(track, name), getattr(expected, name), atol=1e-12)
    assert track.nis.shape == track.dof.shape == (4,)


@FORMS
def test_none_is_missing_as_nan_is(form):
    """Two sensors, runs; what has no measurement counts by the components that its sensor has otherwise."""
    filter = celnav.sequential(MOTION, celnav.update([[1.0, 0.0]], RULE, [[1.0]]), celnav.update(EYE, RULE, EYE))
    none = [(np.ones(1), None), None, (None, np.ones((3, 2))), (None, np.array([np.nan, 1.0]))]
    blank = [(np.ones(1) if z and z[0] is not None else [np.nan], z[1] if z and z[1] is not None else [np.nan] * 2) for z in none]
    found, expected = (
        celnav.run(filter, form(np.zeros((3, 2)), EYE), [celnav.Epoch(k, float(k), float(k > 0), z=z) for k, z in enumerate(given)])
        for given in (none, blank)
    )
    for name in found.events:
        np.testing.assert_array_equal(found.events[name], expected.events[name])
    np.testing.assert_array_equal(found.events["missing"], 2 + 3 + 1 + 2)
    for name in ("mean", "innovation", "white", "used"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-14)


def test_a_bias_and_a_fix_count_what_is_missing_too():
    part = celnav.filters.two_stage.plain(MOTION, celnav.update(EYE, RULE, EYE))
    filters = [
        celnav.filters.two_stage.two_stage(part, EYE, celnav.square_root(np.zeros(2), EYE)),
        celnav.filters.least_squares.least_squares(lambda x, e: x, lambda x, e: np.broadcast_to(EYE, (*x.shape, 2)), [1.0, 1.0]),
    ]
    when = [celnav.Epoch(0, 0.0, 0.0, z=np.ones(2)), celnav.Epoch(1, 1.0, 1.0), celnav.Epoch(2, 2.0, 1.0, z=np.ones(2))]
    for filter in filters:
        track = celnav.run(filter, celnav.square_root(np.zeros(2), EYE), when, on_failure="flag")
        assert track.events["missing"] == 2


@FORMS
@pytest.mark.parametrize("linear", [True, False])
def test_no_components_and_no_runs(form, linear):
    nothing = celnav.update(np.zeros((0, 2)) if linear else lambda x, e: x[..., :0], RULE, np.zeros((0, 0)))
    track = celnav.run(celnav.sequential(MOTION, nothing), form(np.zeros((3, 2)), EYE), celnav.epochs([0.0, 1.0], np.zeros((2, 0))))
    np.testing.assert_allclose(track.std[-1], np.sqrt(2.0))
    assert track.innovation.shape == (2, 3, 0)
    see = celnav.update(EYE if linear else lambda x, e: x.copy(), RULE, EYE)
    track = celnav.run(celnav.sequential(MOTION, see), form(np.zeros((0, 2)), EYE), celnav.epochs([0.0, 1.0], np.ones((2, 0, 2))))
    assert (track.mean.shape, track.innovation.shape, track.failed_at.shape) == ((2, 0, 2), (2, 0, 2), (0,))
