"""A smoother that relinearizes its models over its own result: the posterior linearization
smoother, and its extended variant.

A filter linearizes over the beliefs available on the way. The smoothed beliefs are more accurate:
linearize motion and sensors over them, filter and smooth with these linearizations, and repeat.
With sigma points this is the iterated posterior linearization smoother [Garcia2017]; [Yaghoobi2022]
give a square-root form that runs in parallel in time. With Taylor's rule it is the iterated
extended Kalman smoother, the Gauss-Newton method for the most probable trajectory [Bell1994].
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.joint import Joint
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Epochs
from celnav.filters.run import ENGINE, ENGINES, as_epochs, run
from celnav.filters.sequential import (
    MOST_ITERATIONS,
    Sequential,
    linearized_over,
    require_sequential,
)
from celnav.filters.smoother import smooth
from celnav.filters.track import Track
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import choice, integer
from celnav.gaussian.linalg import Array, Belief

__all__ = ["iterated_smoother"]


def iterated_smoother(
    filter: Sequential,
    prior: Gaussian,
    times: ArrayLike | Iterable[Epoch],
    z: Any = None,
    u: Any = None,
    *,
    iterations: int = 10,
    gains: bool = False,
    on_failure: str = "raise",
    engine: str | None = None,
    jobs: int = 1,
) -> Track:
    """Estimates of all states given all measurements, with models linearized over these estimates.

    filter: one that predicts, then updates, such as `celnav.ukf` or `celnav.ekf`. prior, times, z,
        u: as in `celnav.run`.
    iterations: number of forward and backward passes; one pass is `celnav.smooth` of the filter's
        track. It is a count, not a tolerance, so that the result of a run does not depend on the
        other runs. Check whether more iterations change the result.
    gains, on_failure: as in `celnav.smooth`.
    engine, jobs: for all passes, as in `celnav.run`; gains need numpy.

    Returns the smoothed `Track` of the last iteration. Its innovations, likelihood and events come
    from the last forward pass.

    >>> filter = celnav.ukf(motion, radar)
    >>> smoothed = celnav.iterated_smoother(filter, prior, times, z, iterations=5)
    """
    require_sequential("filter", filter)
    count = integer("iterations", iterations, 1, MOST_ITERATIONS)
    by, why = choice("engine", ENGINE.get() if engine is None else engine, ENGINES), ""
    epochs: Any = as_epochs(times, z, u)
    epochs = epochs if isinstance(epochs, Epochs) else list(epochs)
    linearized: Any = filter
    for left in range(count - 1, -1, -1):
        track = run(
            linearized, prior, epochs, keep="cov", on_failure=on_failure, engine=by, jobs=jobs
        )
        if track.engine.startswith("numpy: "):  # do not try again an engine that could not compile
            by, why = "numpy", track.engine
        # Only the last pass stores gains, which need numpy.
        last = gains and not left
        back = "numpy" if last else by
        track = smooth(track, gains=last, on_failure=on_failure, engine=back, jobs=jobs)
        # The next pass linearizes over the smoothed beliefs.
        epochs, linearized = _with_about(epochs, _ends(prior, track)), relinearized(filter)
    return replace(
        track, filter=filter, epochs=_with_about(track.epochs, None), engine=why or track.engine
    )


def _ends(prior: Gaussian, track: Track) -> tuple[Belief, Belief]:
    """The beliefs at the start and at the end of each interval; the prior is at the start of the
    first.
    """
    after: Any = track.belief
    form = type(after)
    first = form.of(prior)
    before = (np.broadcast_to(a, b[:1].shape) for a, b in zip(first, after, strict=True))
    pairs = zip(before, after, strict=True)
    return form(*(np.concatenate([a, b[:-1]]) for a, b in pairs)), after


def _with_about(epochs: Any, about: Any) -> Any:
    """The epochs with ``about`` filled in: the rows of a tuple of beliefs, or None."""
    if isinstance(epochs, Epochs):
        return epochs.with_about(about)
    rows = [None] * len(epochs) if about is None else zip(*(map(type(x), *x) for x in about))
    return [epoch._replace(about=row) for epoch, row in zip(epochs, rows, strict=True)]


@lru_cache(maxsize=16)
def relinearized(filter: Sequential) -> Relinearized:
    """The relinearized filter; cached, so that its machine code is kept."""
    return Relinearized.of(filter)


@dataclass(frozen=True, eq=False, repr=False)
class Relinearized(Sequential):
    """A filter whose models are linearized over the beliefs in ``epoch.about`` instead of the
    present belief.

    The first belief is at the start of the interval, the second at its end.
    """

    @classmethod
    def of(cls, filter: Sequential) -> Relinearized:
        """The same filter, linearized over the beliefs of the epochs."""
        return cls(
            filter.motion,
            filter.sensors,
            rule=filter.rule,
            form=filter.form,
            hooks=filter.hooks,
            gain=filter.gain,
        )

    def predicted(self, belief: Belief, epoch: Epoch) -> Joint:
        """The joint of a prediction: the state after the interval."""
        both = self.measured(self.motion, belief, epoch.about[1].mean, epoch)
        noise = both.measurement_noise
        return both._replace(
            innovation=None,
            measurement=None,
            state=both.measurement,
            process_noise=None if noise is None else (0, noise),
            measurement_noise=None,
            prior_factor=None,
        )

    def measured(
        self, model: Motion | Sensor, belief: Belief, z: Array, epoch: Epoch, rule: Any = None
    ) -> Joint:
        """The joint of a model's values and the state."""
        # The motion starts from the first belief; a sensor measures at the end of the interval.
        start, end = epoch.about
        return linearized_over(
            start if model is self.motion else end,
            rule or self.rule,
            belief,
            model,
            self.motion.space,
            lambda rule, belief: super(Relinearized, self).measured(model, belief, z, epoch, rule),
        )
