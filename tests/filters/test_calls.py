"""How many functions of the package an epoch calls, in how many files: the path that a reader
follows.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

import celnav

ROOT = Path(celnav.__file__).parent
ATTITUDE = celnav.attitude()
BIASED = celnav.product((ATTITUDE, 4, 3), (celnav.EUCLIDEAN, 3, 3))
UKF = celnav.ukf(
    celnav.Motion(lambda x, epoch: x + epoch.dt * x[..., ::-1], Q=np.eye(2)),
    celnav.Sensor([[1.0, 0.0]], R=[[1.0]]),
)
MEKF = celnav.ekf(
    celnav.Motion(lambda x, epoch: x.copy(), Q=1e-8 * np.eye(6), space=BIASED),
    celnav.Sensor(lambda x, epoch: x[..., :4], R=1e-6 * np.eye(3), space=ATTITUDE),
)
TURN = np.array([0.0, 0.0, 0.0, 1.0])
STILL = celnav.Gaussian(np.concatenate([TURN, np.zeros(3)]), 1e-4 * np.eye(6))


@pytest.mark.parametrize(
    ("filter", "prior", "z", "calls", "files"),
    [
        (UKF, celnav.Gaussian(np.zeros(2), np.eye(2)), np.zeros(1), 50, 5),
        (MEKF, STILL, TURN, 112, 8),
    ],
    ids=["ukf with a matrix", "mekf"],
)
def test_an_epoch_is_a_short_walk(filter, prior, z, calls, files):
    state, walked = filter.start(prior), []

    def profile(frame, event, argument):
        if event == "call" and Path(frame.f_code.co_filename).is_relative_to(ROOT):
            walked.append(frame.f_code.co_filename)

    for k in range(4):
        if k == 3:  # models are checked, and rules made, in the first epochs
            sys.setprofile(profile)
        try:
            state, _ = filter.step(state, celnav.Epoch(k=k, t=float(k), dt=1.0, z=z))
        finally:
            sys.setprofile(None)
    assert len(walked) <= calls
    assert len(set(walked)) <= files
