"""cuthbert: square-root filters in JAX. It has no unscented filter; nonlinear problems are its extended one's.

It predicts before every measurement, so the prediction of the first epoch is made to change nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cuthbert
import jax.numpy as jnp
import numpy as np
from cuthbert.gaussian import kalman as exact
from cuthbert.gaussian import moments

from benchmarks.problems import linear_matrix, measurements, problem
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


def kalman(name: str, runs: int, epochs: int) -> Work:
    """A Kalman filter, step by step."""
    given = problem(name)
    n, m = len(given.mean), len(given.H)
    F, H, I = jnp.asarray(linear_matrix(n)), jnp.asarray(given.H), jnp.eye(n)  # noqa: E741
    sqrt_Q, sqrt_R = jnp.sqrt(jnp.asarray(given.Q)), jnp.sqrt(jnp.asarray(given.R))

    def dynamics(inputs: Any) -> Any:
        return (
            jnp.where(inputs[0], I, F),
            jnp.zeros(n),
            jnp.where(inputs[0], 0.0, sqrt_Q),
        )

    def observation(inputs: Any) -> Any:
        return H, jnp.zeros(m), sqrt_R, inputs[1]

    filter = exact.build_filter(
        jnp.asarray(given.mean), jnp.asarray(np.sqrt(given.P)), dynamics, observation
    )

    def one(z: Any) -> Any:
        states = cuthbert.filter(filter, (jnp.arange(epochs) == 0, z), filter.init_prepare())
        return states.mean[1:]

    return mapped(one, measurements(given, runs, epochs))
