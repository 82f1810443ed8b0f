"""What the SSUKF gives up: noise common to dynamics and sensor, and what one draw of points keeps. Two small examples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Filter
from celnav.filters.run import run
from celnav.filters.sequential import Sequential, SingleDraw, sigma_point, ukf
from celnav.filters.track import Track
from celnav.gaussian.belief import Gaussian, nees
from celnav.gaussian.linalg import Array
from celnav.gaussian.rules import Rule, unscented

CORRELATIONS = (0.5, 0.8, -0.8)
DECAY = 0.98


class Correlated(NamedTuple):
    """The scalar example at one correlation: deviation of the exact filter, and what each filter reaches."""

    exact: float
    once: float
    switching: float
    redrawn: float
    nees: float
    apart: float


def correlated(
    rngs: Sequence[np.random.Generator], *, runs: int = 400, steps: int = 350, burn: int = 50
) -> dict[float, Correlated]:
    """``x' = 0.98 x + w``, ``z = x' + v``, unit variances, ``w`` and ``v`` correlated; one generator for each of `CORRELATIONS`.

    ``apart`` is the largest difference of the single-draw covariance from the exact one; ``nees`` that of the SSUKF.
    """
    roots = np.linalg.cholesky([[[1.0, rho], [rho, 1.0]] for rho in CORRELATIONS])
    count = len(CORRELATIONS)
    noise = np.concatenate([r.standard_normal((steps, runs, 2)) @ root.T for r, root in zip(rngs, roots, strict=True)], 1)
    truth = np.empty((steps + 1, count * runs, 1))
    truth[0] = np.concatenate([r.standard_normal((runs, 1)) for r in rngs])
    for k in range(steps):
        truth[k + 1] = DECAY * truth[k] + noise[k, :, :1]
    z = truth[1:] + noise[:, :, 1:]
    epochs = [Epoch(k + 1, k + 1.0, 1.0, None, z[k], truth[k + 1]) for k in range(steps)]
    prior = Gaussian(np.zeros((count * runs, 1)), np.eye(1))

    def f(x: Array, _epoch: Any, *w: Array) -> Array:
        return np.asarray(DECAY * x + w[0][..., :1])

    def h(x: Array, _epoch: Any, *v: Array) -> Array:
        return np.asarray(x + v[-1][..., -1:])

    one, both = np.eye(1), np.repeat(roots, runs, 0)

    def added(motion: tuple[Array, ...], sensor: tuple[Array, ...]) -> Sequential:
        return ukf(Motion(f, augment=motion), Sensor(h, augment=sensor), form="covariance")

    single = added((one,), (one,))
    known: dict[str, Filter] = {
        "once": replace(SingleDraw.of(single), joint_noise=(both,)),
        "switching": single,
        "redrawn": added((one, one), (one, one)),
    }
    tracks = {name: run(filter, prior, epochs, keep="cov") for name, filter in known.items()}
    error = {name: truth[1:] - _mean(track) for name, track in tracks.items()}
    squares = {name: np.split(np.square(e[burn:]), count, 1) for name, e in error.items()}
    ratios = np.split(nees(error["switching"], tracks["switching"].sqrt_cov)[burn:], count, 1)
    stds = np.split(tracks["once"].sqrt_cov[..., 0, 0], count, 1)
    out = {}
    for i, rho in enumerate(CORRELATIONS):
        deviations = exact(rho, steps)
        once, switching, redrawn = (float(np.sqrt(squares[name][i].mean())) for name in known)
        apart = float(np.abs(stds[i] - deviations[:, None]).max())
        out[rho] = Correlated(float(deviations[-1]), once, switching, redrawn, float(ratios[i].mean()), apart)
    return out


def exact(correlation: float, steps: int) -> Array:
    """Posterior deviations ``(steps,)`` of the Kalman filter of correlated noise."""
    P, out = 1.0, []
    for _ in range(steps):
        before = DECAY**2 * P + 1.0
        P = before - (before + correlation) ** 2 / (before + 1.0 + 2.0 * correlation)
        out.append(np.sqrt(P))
    return np.array(out)


def multiplied(rng: np.random.Generator, *, runs: int = 2000, steps: int = 60) -> tuple[dict[str, float], float]:
    """``x1' = x1 + exp(x2 + w1)``, ``x2' = 0.95 x2 + w2``, ``z = x1 exp(v)``: RMSE of x1, and how far AUKF and SSUKF are apart."""
    sigma, sensor = np.array([0.4, 0.2]), np.array([[0.15]])
    start, P = np.array([1.0, 0.0]), np.diag([0.1**2, 0.2**2])
    truth = np.empty((steps + 1, runs, 2))
    truth[0] = start + rng.standard_normal((runs, 2)) @ np.sqrt(P)
    w, v = sigma * rng.standard_normal((steps, runs, 2)), rng.standard_normal((steps, runs, 1)) * sensor

    def f(x: Array, _epoch: Any, *noise: Array) -> Array:
        by = np.concatenate(noise, -1)[..., :2] if noise else np.zeros(2)
        return np.stack([x[..., 0] + np.exp(x[..., 1] + by[..., 0]), 0.95 * x[..., 1] + by[..., 1]], -1)

    def h(x: Array, _epoch: Any, *noise: Array) -> Array:
        return x[..., :1] * np.exp(noise[-1]) if noise else x[..., :1]

    for k in range(steps):
        truth[k + 1] = f(truth[k], None, w[k])
    z = h(truth[1:], None, v)
    epochs = [Epoch(k + 1, k + 1.0, 1.0, None, z[k], truth[k + 1]) for k in range(steps)]

    def rule(L: int) -> Rule:
        return unscented(L, kappa=6.0 - L)

    def process(mean: Array, _epoch: Any) -> Array:
        slope = np.stack([np.exp(mean[..., 1]), np.ones_like(mean[..., 1])], -1)
        return np.asarray((slope * sigma)[..., None] * np.eye(2))

    def measured(mean: Array, _epoch: Any) -> Array:
        return np.asarray(mean[..., :1, None] * sensor)

    W = np.diag(sigma)

    def through(time: tuple[Array, ...], seen: tuple[Array, ...]) -> Sequential:
        motion = Motion(f, augment=time) if time else Motion(f, sqrt_Q=process)
        return sigma_point(motion, Sensor(h, augment=seen) if seen else Sensor(h, sqrt_R=measured), rule=rule, form="covariance")

    ssukf = through((W,), (sensor,))
    known: dict[str, Filter] = {
        "aukf": through((W, sensor), (W, sensor)),
        "ssukf": ssukf,
        "aukf-1": SingleDraw.of(ssukf),
        "additive": through((), ()),
    }
    prior = Gaussian(np.tile(start, (runs, 1)), P)
    means = {name: _mean(run(filter, prior, epochs, keep="mean")) for name, filter in known.items()}
    rms = {name: float(np.sqrt(np.square(mean - truth[1:])[..., 0].mean())) for name, mean in means.items()}
    return rms, float(np.abs(means["aukf"] - means["ssukf"]).max())


def _mean(track: Track) -> Array:
    assert track.mean is not None
    return track.mean
