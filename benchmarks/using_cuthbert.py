"""cuthbert: square-root filters in JAX. It has no unscented filter; this is its extended one.

It predicts before every measurement; the prediction of the first epoch is made to change nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cuthbert
import jax.numpy as jnp
from cuthbert.gaussian import moments

from benchmarks.problems import measurements, problem
from benchmarks.using_dynamax import mapped

Work = Callable[[], Any]


def smooth(runs: int, epochs: int) -> Work:
    """The extended filter, then the smoother."""
    given = problem("orbit")
    step, H = given.step(jnp), jnp.asarray(given.H)
    sqrt_P, sqrt_Q, sqrt_R = (jnp.sqrt(jnp.asarray(each)) for each in (given.P, given.Q, given.R))

    def dynamics(state: Any, inputs: Any) -> Any:
        first, _ = inputs

        def moved(x: Any) -> Any:
            return jnp.where(first, x, step(x)), jnp.where(first, 0.0, sqrt_Q)

        return moved, state.mean

    def observation(state: Any, inputs: Any) -> Any:
        return lambda x: (H @ x, sqrt_R), state.mean, inputs[1]

    filter = moments.build_filter(jnp.asarray(given.mean), sqrt_P, dynamics, observation)
    smoother = moments.build_smoother(dynamics)

    def one(z: Any) -> Any:
        states = cuthbert.filter(filter, (jnp.arange(epochs) == 0, z), filter.init_prepare())
        return cuthbert.smoother(smoother, states).mean[1:]

    return mapped(one, measurements(given, runs, epochs))
