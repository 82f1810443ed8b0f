"""What a track exports."""

from __future__ import annotations

import numpy as np

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
