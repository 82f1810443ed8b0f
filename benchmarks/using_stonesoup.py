"""Stone Soup: one run at a time, all sigma points in one call of the model."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.nonlinear import GaussianTransitionModel
from stonesoup.predictor.kalman import UnscentedKalmanPredictor
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.prediction import GaussianStatePrediction
from stonesoup.updater.kalman import UnscentedKalmanUpdater

from benchmarks.problems import measurements, problem
from celnav.models import orbit

GIVEN = problem("orbit")


class Orbit(GaussianTransitionModel):  # type: ignore[misc]
    """The motion; Stone Soup's columns are the model's rows."""

    @property
    def ndim_state(self) -> int:
        return 6

    def function(self, state: Any, noise: Any = None, **_: Any) -> Any:  # noqa: ARG002
        return StateVectors(orbit.step(np.asarray(state.state_vector, dtype=float).T, 1.0).T)

    def covar(self, **_: Any) -> Any:
        return GIVEN.Q

    def rvs(self, *args: Any, **kwargs: Any) -> Any:
        raise NotImplementedError("nothing is drawn here")

    def pdf(self, *args: Any, **kwargs: Any) -> Any:
        raise NotImplementedError("nothing is drawn here")


def unscented(epochs: int) -> Callable[[], Any]:
    """An unscented filter of one orbit."""
    z = measurements(GIVEN, 1, epochs)
    weights = {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}
    start, second = datetime(2000, 1, 1), timedelta(seconds=1)

    def work() -> Any:
        sensor = LinearGaussian(ndim_state=6, mapping=(0, 1, 2), noise_covar=GIVEN.R)
        predictor = UnscentedKalmanPredictor(Orbit(), **weights)
        updater = UnscentedKalmanUpdater(sensor, **weights)
        belief = GaussianStatePrediction(GIVEN.mean[:, None], GIVEN.P, timestamp=start)
        means = []
        for k in range(epochs):
            now = start + k * second
            if k:
                belief = predictor.predict(belief, timestamp=now)
            detection = Detection(z[k][:, None], timestamp=now, measurement_model=sensor)
            belief = updater.update(SingleHypothesis(belief, detection))
            means.append(np.asarray(belief.state_vector, dtype=float)[:, 0])
        return np.array(means)

    return work
