"""The plot of a single run."""

from __future__ import annotations

import numpy as np
import pytest
from test_report import faults, flown

import celnav


@pytest.fixture(scope="module")
def pair():
    return flown(runs=3)


def axes(fig):
    return [ax for ax in fig.axes if ax.axison]


def test_errors_and_innovations_of_the_run_that_is_asked_for(pair):
    track, truth = pair
    fig = track.plot(truth, run=2, names=["x (m)", "y (m)", "u (m/s)", "v (m/s)"])
    drawn = axes(fig)
    labels = [ax.get_ylabel() for ax in drawn]
    assert labels == ["x (m)", "y (m)", "u (m/s)", "v (m/s)", *["innovation / σ"] * 2]
    for i, ax in enumerate(drawn[:4]):
        upper, lower, error = (line.get_ydata() for line in ax.lines)
        np.testing.assert_allclose(upper, 3.0 * track.std[:, 2, i])
        np.testing.assert_allclose(lower, -upper)
        np.testing.assert_allclose(error, (track.mean - truth)[:, 2, i], atol=1e-9)
    dots = {line.get_label(): line for line in drawn[4].lines}
    np.testing.assert_allclose(dots["z1"].get_ydata(), track.whitened[:, 2, 1])
    assert fig.get_figwidth() <= 6.5
    assert not faults(fig)


def test_what_a_gate_rejects_is_marked(pair):
    from test_report import GPS, MOTION, PRIOR, RADAR, TIMES

    truth, z = celnav.simulate(MOTION, [RADAR, GPS], PRIOR, TIMES, runs=2)
    z[1][20, 0] += 1000.0
    gated = celnav.ukf(MOTION, RADAR, GPS, hooks=[celnav.filters.adaptive.gate(0.001)])
    track = celnav.run(gated, PRIOR, TIMES, z)
    marks = [
        line.get_xdata().tolist()
        for ax in axes(track.plot(truth))
        for line in ax.lines
        if line.get_label() == "rejected"
    ]
    assert marks
    assert all(TIMES[20] in times for times in marks[-2:])


def test_without_a_truth_there_are_deviations(pair):
    track, _ = pair
    drawn = axes(track.plot())
    assert [len(ax.lines) for ax in drawn[:4]] == [2] * 4


def test_parts_of_a_product_keep_their_names():
    space = celnav.product(q=celnav.attitude(), p=1)
    motion = celnav.Motion(lambda x, epoch: x, sqrt_Q=1e-3 * np.eye(4), space=space)
    start = celnav.Gaussian(np.array([0.0, 0.0, 0.0, 1.0, 5.0]), 0.1 * np.eye(4))
    sensor = celnav.Sensor(lambda x, epoch: space.part(x, "p"), R=np.eye(1))
    track = celnav.run(celnav.ukf(motion, sensor), start, np.arange(4.0), np.full((4, 1), 5.0))
    truth = np.tile([0.0, 0.0, 0.0, 1.0, 5.0], (4, 1))
    assert [ax.get_ylabel() for ax in axes(track.plot(truth))][:4] == ["q0", "q1", "q2", "p"]
    names = track.to_dataframe().columns
    assert [*names] == [
        "t",
        "run",
        "q0",
        "q1",
        "q2",
        "q3",
        "p",
        *_std("q0", "q1", "q2", "p"),
        "nis",
    ]
    data = track.to_xarray()
    assert data["state"].values.tolist() == ["q0", "q1", "q2", "q3", "p"]
    assert data["error"].values.tolist() == ["q0", "q1", "q2", "p"]


def _std(*names):
    return [f"std_{name}" for name in names]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"run": 3}, "run: expected an integer from 0 to 2, got 3"),
        ({"names": ["x"]}, "names: expected 4 words"),
        ({"space": "R"}, "space: expected a Space"),
    ],
)
def test_wrong_arguments(pair, options, text):
    track, truth = pair
    with pytest.raises((TypeError, ValueError), match=text):
        track.plot(truth, **options)
