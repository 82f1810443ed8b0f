"""Peers: filterpy, Stone Soup, dynamax. Each is imported only when it is measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.engines import Engine, Work
from benchmarks.workload import P0, SQRT_Q, X0, H, R
from celnav.gaussian.linalg import Array
from celnav.models import orbit

Q = SQRT_Q @ SQRT_Q
CHUNK = 128
"""Runs that dynamax maps over at once: more leave the cache and cost several times as much."""


def peer_engines(counts: Sequence[int]) -> Iterator[Engine]:
    """One run of each, and dynamax mapped over runs."""
    yield Engine(
        "filterpy, numpy model", 1, lambda z: _filterpy(z, lambda x, dt: orbit.step(x, dt))
    )
    yield Engine("filterpy, numba model", 1, lambda z: _filterpy(z, numba_model()), compiles=True)
    yield Engine("Stone Soup, numpy model", 1, _stonesoup)
    for runs in counts:
        yield Engine(
            "dynamax, jit" if runs == 1 else "dynamax, vmap", runs, _dynamax, compiles=True
        )


def numba_model() -> Callable[..., Array]:
    """``orbit.step`` for one state, compiled."""
    njit: Any = import_module("numba").njit
    mu, c = orbit.EARTH.mu, orbit.EARTH.j2 * orbit.EARTH.radius_km**2

    @njit
    def gravity(x, y, z):  # type: ignore[no-untyped-def]
        inverse = 1.0 / (x * x + y * y + z * z)
        k = -mu * inverse * np.sqrt(inverse)
        oblate = c * k * inverse
        common = k - oblate * (7.5 * z * z * inverse - 1.5)
        return x * common, y * common, z * (common + 3.0 * oblate)

    @njit
    def step(s, dt):  # type: ignore[no-untyped-def]
        x, y, z, u, v, w = s
        h = 0.5 * dt
        a1, b1, c1 = gravity(x, y, z)
        x2, y2, z2 = x + h * u, y + h * v, z + h * w
        a2, b2, c2 = gravity(x2, y2, z2)
        a3, b3, c3 = gravity(x2 + h * h * a1, y2 + h * h * b1, z2 + h * h * c1)
        x4, y4, z4 = x + dt * u, y + dt * v, z + dt * w
        a4, b4, c4 = gravity(x4 + h * dt * a2, y4 + h * dt * b2, z4 + h * dt * c2)
        p, q = dt * dt / 6.0, dt / 6.0
        out = np.empty(6)
        out[0], out[1], out[2] = (
            x4 + p * (a1 + a2 + a3),
            y4 + p * (b1 + b2 + b3),
            z4 + p * (c1 + c2 + c3),
        )
        out[3] = u + q * (a1 + 2.0 * (a2 + a3) + a4)
        out[4] = v + q * (b1 + 2.0 * (b2 + b3) + b4)
        out[5] = w + q * (c1 + 2.0 * (c2 + c3) + c4)
        return out

    compiled: Callable[..., Array] = step
    return compiled


def _filterpy(z: Array, fx: Callable[..., Array]) -> Work:
    kalman: Any = import_module("filterpy.kalman")

    def work() -> Array:
        points = kalman.MerweScaledSigmaPoints(6, 1.0, 0.0, 0.0)
        ukf = kalman.UnscentedKalmanFilter(6, 3, 1.0, hx=lambda x: x[:3], fx=fx, points=points)
        ukf.x, ukf.P, ukf.Q, ukf.R = X0.copy(), P0.copy(), Q, R
        ukf.sigmas_f = points.sigma_points(
            ukf.x, ukf.P
        )  # an update before the first predict needs them
        means = []
        for k, measured in enumerate(z[:, 0]):
            if k:
                ukf.predict()
            ukf.update(measured)
            means.append(ukf.x.copy())
        return np.array(means)[:, None]

    return work


def _stonesoup(z: Array) -> Work:
    base: Any = import_module("stonesoup.models.transition.nonlinear")
    linear: Any = import_module("stonesoup.models.measurement.linear")
    arrays: Any = import_module("stonesoup.types.array")
    types: Any = {
        name: import_module(f"stonesoup.types.{name}")
        for name in ("state", "prediction", "hypothesis", "detection")
    }
    predictor: Any = import_module("stonesoup.predictor.kalman").UnscentedKalmanPredictor
    updater: Any = import_module("stonesoup.updater.kalman").UnscentedKalmanUpdater
    datetime: Any = import_module("datetime")

    class Orbit(base.GaussianTransitionModel):  # type: ignore[misc]
        @property
        def ndim_state(self) -> int:
            return 6

        def function(self, state: Any, _noise: Any = None, **_: Any) -> Any:
            """All points at once: Stone Soup's columns are the model's rows."""
            return arrays.StateVectors(
                orbit.step(np.asarray(state.state_vector, dtype=float).T, 1.0).T
            )

        def covar(self, **_: Any) -> Any:
            return Q

        def rvs(self, *args: Any, **kwargs: Any) -> Any:
            raise NotImplementedError("only the mean and the covariance are used here")

        def pdf(self, *args: Any, **kwargs: Any) -> Any:
            raise NotImplementedError("only the mean and the covariance are used here")

    def work() -> Array:
        model = linear.LinearGaussian(ndim_state=6, mapping=(0, 1, 2), noise_covar=R)
        weights = {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}
        predict, update = predictor(Orbit(), **weights), updater(model, **weights)
        start, second = datetime.datetime(2000, 1, 1), datetime.timedelta(seconds=1)
        belief = types["prediction"].GaussianStatePrediction(X0[:, None], P0, timestamp=start)
        means = []
        for k, measured in enumerate(z[:, 0]):
            if k:
                belief = predict.predict(belief, timestamp=start + k * second)
            detection = types["detection"].Detection(
                measured[:, None], timestamp=start + k * second, measurement_model=model
            )
            belief = update.update(types["hypothesis"].SingleHypothesis(belief, detection))
            means.append(np.asarray(belief.state_vector, dtype=float)[:, 0])
        return np.array(means)[:, None]

    return work


def jax_orbit() -> Callable[[Any], Any]:
    """``orbit.step`` for one state, in JAX."""
    jnp: Any = import_module("jax.numpy")
    mu, c = orbit.EARTH.mu, orbit.EARTH.j2 * orbit.EARTH.radius_km**2

    def gravity(r: Any) -> Any:
        inverse = 1.0 / (r * r).sum()
        k = -mu * inverse * jnp.sqrt(inverse)
        oblate = c * k * inverse
        return r * (
            k - oblate * (7.5 * r[2] * r[2] * inverse - 1.5) + oblate * jnp.array([0.0, 0.0, 3.0])
        )

    def step(x: Any) -> Any:
        r, v = x[:3], x[3:]
        ahead = r + 0.5 * v
        a1, a2 = gravity(r), gravity(ahead)
        a3, a4 = gravity(ahead + 0.25 * a1), gravity(r + v + 0.5 * a2)
        return jnp.concatenate(
            [r + v + (a1 + a2 + a3) / 6.0, v + (a1 + 2.0 * (a2 + a3) + a4) / 6.0]
        )

    return step


def _dynamax(z: Array) -> Work:
    jax: Any = import_module("jax")
    jnp: Any = import_module("jax.numpy")
    ssm: Any = import_module("dynamax.nonlinear_gaussian_ssm")
    prior = {"initial_mean": jnp.asarray(X0), "initial_covariance": jnp.asarray(P0)}
    noise = {"dynamics_covariance": jnp.asarray(Q), "emission_covariance": jnp.asarray(R)}
    matrix = jnp.asarray(H)
    params = ssm.ParamsNLGSSM(
        dynamics_function=jax_orbit(), emission_function=lambda x: matrix @ x, **prior, **noise
    )
    hyper = ssm.UKFHyperParams(1.0, 0.0, 0.0)

    def one(measured: Any) -> Any:
        return ssm.unscented_kalman_filter(
            params, measured, hyper, output_fields=["filtered_means"]
        ).filtered_means

    runs = z.shape[1]
    if runs == 1:
        single, measured = jax.jit(one), jnp.asarray(z[:, 0])
        return lambda: np.asarray(single(measured))[:, None]
    mapped = jax.jit(jax.vmap(one, in_axes=1, out_axes=1))
    chunks = [jnp.asarray(z[:, first : first + CHUNK]) for first in range(0, runs, CHUNK)]
    return lambda: np.concatenate([np.asarray(mapped(chunk)) for chunk in chunks], 1)
