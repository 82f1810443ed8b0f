"""dynamax: filters and smoothers in JAX, 64 bits, compiled as a whole and mapped over runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from dynamax import linear_gaussian_ssm as linear
from dynamax import nonlinear_gaussian_ssm as nonlinear

from benchmarks.problems import linear_matrix, measurements, problem

Work = Callable[[], Any]
CHUNK = 128
"""Runs that are mapped over at once: more leave the cache and cost several times as much."""
HYPER = nonlinear.UKFHyperParams(alpha=1.0, beta=0.0, kappa=0.0)


def parameters(name: str) -> Any:
    """Of a nonlinear problem."""
    given = problem(name)
    H = jnp.asarray(given.H)
    return nonlinear.ParamsNLGSSM(
        initial_mean=jnp.asarray(given.mean),
        initial_covariance=jnp.asarray(given.P),
        dynamics_function=given.step(jnp),
        dynamics_covariance=jnp.asarray(given.Q),
        emission_function=lambda x: H @ x,
        emission_covariance=jnp.asarray(given.R),
    )


def unscented(name: str, runs: int, epochs: int) -> Work:
    """An unscented filter, of which the means are asked for."""
    params = parameters(name)

    def one(z: Any) -> Any:
        fields = ["filtered_means"]
        found = nonlinear.unscented_kalman_filter(params, z, HYPER, output_fields=fields)
        return found.filtered_means

    return mapped(one, measurements(problem(name), runs, epochs))


def smooth(runs: int, epochs: int) -> Work:
    """An unscented filter and smoother."""
    params = parameters("orbit")

    def one(z: Any) -> Any:
        return nonlinear.unscented_kalman_smoother(params, z, HYPER).smoothed_means

    return mapped(one, measurements(problem("orbit"), runs, epochs))


def kalman(name: str, runs: int, epochs: int) -> Work:
    """A Kalman filter: means, and the variances that celnav gives as well."""
    given = problem(name)
    n, m = len(given.mean), len(given.H)
    params = linear.ParamsLGSSM(
        initial=linear.ParamsLGSSMInitial(jnp.asarray(given.mean), jnp.asarray(given.P)),
        dynamics=linear.ParamsLGSSMDynamics(
            jnp.asarray(linear_matrix(n)), jnp.zeros(n), jnp.zeros((n, 0)), jnp.asarray(given.Q)
        ),
        emissions=linear.ParamsLGSSMEmissions(
            jnp.asarray(given.H), jnp.zeros(m), jnp.zeros((m, 0)), jnp.asarray(given.R)
        ),
    )

    def one(z: Any) -> Any:
        found = linear.lgssm_filter(params, z)
        return found.filtered_means, found.filtered_covariances.diagonal(0, -2, -1)

    return mapped(one, measurements(given, runs, epochs))


def mapped(one: Callable[[Any], Any], z: Any) -> Work:
    """One run ``z (epochs, m)``, or runs ``z (epochs, runs, m)`` in chunks, compiled once."""
    if z.ndim == 2:
        single, data = jax.jit(one), jnp.asarray(z)
        return lambda: means(jax.block_until_ready(single(data)))
    every = jax.jit(jax.vmap(one, in_axes=1, out_axes=1))
    parts = [jnp.asarray(z[:, i : i + CHUNK]) for i in range(0, z.shape[1], CHUNK)]

    def work() -> Any:
        found = [means(jax.block_until_ready(every(part))) for part in parts]
        return found[0] if len(found) == 1 else np.concatenate(found, 1)

    return work


def means(found: Any) -> Any:
    """The first of what was asked for, as numpy's."""
    return np.asarray(found[0] if isinstance(found, tuple) else found)
