"""A drop-in for filterpy's ``UnscentedKalmanFilter``: change one import, keep the rest.

`SquareRootUKF` carries a root from step to step, `SigmaPointUKF` a covariance; both are thin doors to `predict` and `update`.
State, covariances and everything else are plain attributes, as in filterpy 2.0: assign them, or change them in place.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
from filterpy.common import pretty_str
from filterpy.kalman import unscented_transform
from scipy.linalg import cholesky

from celnav.checks import finite
from celnav.filters.filterpy_models import differences, mean_of, model_of, sums
from celnav.filters.step import predict, update
from celnav.gaussian import COVARIANCE, SQUARE_ROOT, Form, Gaussian, sqrt_cov, symmetric
from celnav.linalg import Array, semidefinite_root
from celnav.points import from_filterpy
from celnav.rule import Rule
from celnav.spaces import Space


class SigmaPointUKF:
    """filterpy's UKF in covariance form: its constructor, attributes and methods; see filterpy's documentation for their use.

    ``points``: a filterpy sigma-point object or a celnav `Rule`. ``vectorized``: ``fx`` and ``hx`` take all points ``(p, n)`` at
    once instead of one point ``(n,)`` after the other. Points lie along the lower Cholesky root, as with filterpy's default.

    Raises
    ------
    ValueError: naming the argument, before anything changes: the object keeps its last good state.
    """

    _form: Form = COVARIANCE

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dt: float,
        hx: Callable[..., Any],
        fx: Callable[..., Any],
        points: Any,
        sqrt_fn: Callable[[Array], Array] | None = None,
        x_mean_fn: Callable[[Array, Array], Array] | None = None,
        z_mean_fn: Callable[[Array, Array], Array] | None = None,
        residual_x: Callable[[Array, Array], Array] | None = None,
        residual_z: Callable[[Array, Array], Array] | None = None,
        state_add: Callable[[Array, Array], Array] | None = None,
        *,
        vectorized: bool = False,
    ):
        if points.n != dim_x:
            raise ValueError(f"points: expected n = dim_x = {dim_x}, got {points.n}")
        self.rule = points if isinstance(points, Rule) else from_filterpy(points)
        self.points_fn, self._vectorized = points, vectorized
        self._dim_x, self._dim_z, self._dt, self._num_sigmas = dim_x, dim_z, dt, points.num_sigmas()
        self.hx, self.fx = hx, fx
        self.msqrt = cholesky if sqrt_fn is None else sqrt_fn
        self.x_mean, self.z_mean = x_mean_fn, z_mean_fn
        self.residual_x = np.subtract if residual_x is None else residual_x
        self.residual_z = np.subtract if residual_z is None else residual_z
        self.state_add = np.add if state_add is None else state_add
        self.inv: Callable[[Array], Array] = np.linalg.pinv
        self.Wm, self.Wc = points.Wm, points.Wc
        self.x, self.P = np.zeros(dim_x), np.eye(dim_x)
        self.Q, self.R = np.eye(dim_x), np.eye(dim_z)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()
        self.sigmas_f, self.sigmas_h = np.zeros((self._num_sigmas, dim_x)), np.zeros((self._num_sigmas, dim_z))
        self.K, self.y = np.zeros((dim_x, dim_z)), np.zeros(dim_z)
        self.S, self.SI = np.zeros((dim_z, dim_z)), np.zeros((dim_z, dim_z))
        self.z: Any = np.array([[None] * dim_z]).T
        self._log_likelihood = float(np.log(sys.float_info.min))
        self._mahalanobis: float | None = None
        self._kept: tuple[Array, Array] | None = None  # P as we left it, and its spread in our form

    # -- steps ---------------------------------------------------------------------------------------------------------
    def predict(
        self,
        dt: float | None = None,
        UT: Callable[..., tuple[Array, Array]] | None = None,
        fx: Callable[..., Any] | None = None,
        **fx_args: Any,
    ) -> None:
        """Predict over ``dt``; the points are then drawn anew, as in filterpy 2.0."""
        step = self._dt if dt is None else dt
        if not (np.isfinite(step) and step >= 0.0):
            raise ValueError(f"dt: expected a non-negative number, got {step!r}")
        belief, process = self._belief(), sqrt_cov(self.Q, "Q", self._dim_x)
        function = model_of(self._vectorized, "fx", self.fx if fx is None else fx, self._dim_x, (step,), fx_args)
        if UT is None:
            belief, info = predict(function, self.rule, sqrt_Q=process, space=self._space())(belief, None)
            self._check(belief, info.failure)
        else:
            images = function(self._points(belief), None)
            mean, cov = UT(images[self._own], self.Wm, self.Wc, self.Q, self.x_mean, self.residual_x)
            belief = self._from(np.asarray(mean), np.asarray(cov))
        self._keep(belief)
        self.sigmas_f = self._points(belief)[self._own]
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(
        self,
        z: Any,
        R: Any = None,
        UT: Callable[..., tuple[Array, Array]] | None = None,
        hx: Callable[..., Any] | None = None,
        **hx_args: Any,
    ) -> None:
        """Update with ``z``: None, or all nan, is no measurement; partly nan uses the rest."""
        if z is None:
            return self._nothing()
        try:
            measured = np.atleast_1d(np.asarray(z, dtype=np.float64))
        except (TypeError, ValueError):
            raise ValueError(f"z: expected numbers or None, got {z!r:.60}") from None
        if measured.ndim != 1 and measured.shape != (measured.size, 1):
            raise ValueError(f"z: expected shape (m,), got {measured.shape}")
        measured = measured.ravel()
        if np.isinf(measured).any():
            raise ValueError("z: expected finite numbers or nan, got an infinite one")
        if np.isnan(measured).all():
            return self._nothing()
        m = len(measured)
        noise = np.asarray(self.R if R is None else R, dtype=np.float64)
        if noise.ndim == 0:
            noise = noise * np.eye(self._dim_z)
        if hx is None and m != self._dim_z:
            raise ValueError(f"z: expected {self._dim_z} components, got {m}")
        root, belief = sqrt_cov(noise, "R", m), self._belief()
        h = model_of(self._vectorized, "hx", self.hx if hx is None else hx, m, (), hx_args)
        if UT is None:
            space = Space(minus=differences(self.residual_z), mean=mean_of(self.z_mean))
            part = update(h, self.rule, sqrt_R=root, space=self._space(), measurement_space=space)
            posterior, info, _ = part(belief, measured)
            self._check(posterior, info.failure)
            L, innovation = np.asarray(info.innovation_root), np.asarray(info.innovation)
            S, K = L @ L.T, np.asarray(info.gain() if info.gain is not None else 0.0)
            likelihood, distance = float(np.asarray(info.log_likelihood)), float(np.asarray(info.nis))
            sigmas = h(self._points(belief), None)[self._own]
        else:
            points = self._points(belief)
            sigmas = h(points, None)[self._own]
            mean, S = UT(sigmas, self.Wm, self.Wc, noise, self.z_mean, self.residual_z)
            K = np.linalg.solve(S.T, self.cross_variance(self.x, mean, points[self._own], sigmas).T).T
            innovation = np.asarray(self.residual_z(measured, mean))
            posterior = self._from(self.state_add(self.x, K @ innovation), self.P - K @ S @ K.T)
            distance = float(innovation @ np.linalg.solve(S, innovation))
            likelihood = -0.5 * (distance + m * float(np.log(2.0 * np.pi)) + float(np.linalg.slogdet(S)[1]))
        self.sigmas_h, self.S, self.SI, self.K, self.y = sigmas, S, self.inv(S), K, innovation
        self._log_likelihood, self._mahalanobis = likelihood, float(np.sqrt(distance))
        self._keep(posterior)
        self.z = deepcopy(z)
        self.x_post, self.P_post = self.x.copy(), self.P.copy()
        return None

    def _nothing(self) -> None:
        self.z = np.array([[None] * self._dim_z]).T
        self.x_post, self.P_post = np.array(self.x, dtype=np.float64), np.array(self.P, dtype=np.float64)

    def compute_process_sigmas(self, dt: float, fx: Callable[..., Any] | None = None, **fx_args: Any) -> None:
        """Put the propagated points in ``sigmas_f``. (An update always draws its points from the present state.)"""
        function = model_of(self._vectorized, "fx", self.fx if fx is None else fx, self._dim_x, (dt,), fx_args)
        self.sigmas_f = function(self._points(self._belief()), None)[self._own]

    def cross_variance(self, x: Array, z: Array, sigmas_f: Array, sigmas_h: Array) -> Array:
        """Cross covariance ``(n, m)`` of points in the state and in the measurement."""
        dx, dz = differences(self.residual_x)(sigmas_f, x), differences(self.residual_z)(sigmas_h, z)
        return np.asarray((dx * np.asarray(self.Wc)[:, None]).T @ dz)

    def batch_filter(
        self, zs: Any, Rs: Any = None, dts: Any = None, UT: Callable[..., Any] | None = None, saver: Any = None
    ) -> tuple[Array, Array]:
        """Predict and update over all ``zs`` (None where missing): means ``(T, n)`` and covariances ``(T, n, n)``."""
        count = len(zs)
        Rs = [self.R] * count if Rs is None else Rs
        dts = [self._dt] * count if dts is None else [dts] * count if np.isscalar(dts) else dts
        for name, values in (("Rs", Rs), ("dts", dts)):
            if len(values) != count:
                raise ValueError(f"{name}: expected {count} entries to go with zs, got {len(values)}")
        means, covs = np.zeros((count, self._dim_x)), np.zeros((count, self._dim_x, self._dim_x))
        for k, (z, R, dt) in enumerate(zip(zs, Rs, dts, strict=True)):
            self.predict(dt=dt, UT=UT)
            self.update(z, R, UT=UT)
            means[k], covs[k] = self.x, self.P
            if saver is not None:
                saver.save()
        return means, covs

    def rts_smoother(
        self, Xs: Array, Ps: Array, Qs: Any = None, dts: Any = None, UT: Callable[..., Any] | None = None
    ) -> tuple[Array, Array, Array]:
        """Smoothed means, covariances and gains from those of `batch_filter`; ``dts[k]`` and ``Qs[k]`` lead from k to k + 1."""
        if len(Xs) != len(Ps):
            raise ValueError(f"Ps: expected {len(Xs)} covariances to go with Xs, got {len(Ps)}")
        count = len(Xs)
        dts = [self._dt] * count if dts is None else [dts] * count if np.isscalar(dts) else dts
        Qs = [self.Q] * count if Qs is None else Qs
        xs, ps, gains = np.array(Xs, dtype=np.float64), np.array(Ps, dtype=np.float64), np.zeros_like(Ps, dtype=np.float64)
        transform = unscented_transform if UT is None else UT
        for k in reversed(range(count - 1)):
            points = self._points(Gaussian(xs[k], semidefinite_root(ps[k]), SQUARE_ROOT))
            ahead = model_of(self._vectorized, "fx", self.fx, self._dim_x, (dts[k],), {})(points, None)[self._own]
            mean, cov = transform(ahead, self.Wm, self.Wc, Qs[k], self.x_mean, self.residual_x)
            cross = self._cross(points[self._own], xs[k], ahead, mean)
            gains[k] = np.linalg.solve(cov.T, cross.T).T
            xs[k] = self.state_add(xs[k], gains[k] @ self.residual_x(xs[k + 1], mean))
            ps[k] += gains[k] @ (ps[k + 1] - cov) @ gains[k].T
        return xs, ps, gains

    def _cross(self, points: Array, x: Array, ahead: Array, mean: Array) -> Array:
        apart = differences(self.residual_x)
        return np.asarray((apart(points, x) * np.asarray(self.Wc)[:, None]).T @ apart(ahead, mean))

    # -- results -------------------------------------------------------------------------------------------------------
    @property
    def log_likelihood(self) -> float:
        """Logarithm of the density of the last measurement."""
        return self._log_likelihood

    @property
    def likelihood(self) -> float:
        """Density of the last measurement, at least the smallest normal number."""
        return max(float(np.exp(self._log_likelihood)), sys.float_info.min)

    @property
    def mahalanobis(self) -> float | None:
        """Mahalanobis distance of the last measurement; None before the first."""
        return self._mahalanobis

    def __repr__(self) -> str:
        names = (
            "x",
            "P",
            "x_prior",
            "P_prior",
            "Q",
            "R",
            "S",
            "K",
            "y",
            "log_likelihood",
            "likelihood",
            "sigmas_f",
            "sigmas_h",
            "Wm",
            "Wc",
        )
        return "\n".join([f"{type(self).__name__} object", *(str(pretty_str(name, getattr(self, name))) for name in names)])

    # -- between filterpy's world and ours -----------------------------------------------------------------------------
    @property
    def _own(self) -> slice:
        """Rows of our points that filterpy knows: not an added center of weight 0."""
        return slice(-self._num_sigmas, None)

    def _belief(self) -> Gaussian:
        """The present state, checked; the spread that we kept, unless P was changed since."""
        x = finite("x", self.x).ravel()
        if len(x) != self._dim_x:
            raise ValueError(f"x: expected {self._dim_x} components, got {len(x)}")
        if self._kept is not None and np.array_equal(self.P, self._kept[0]):
            return Gaussian(x, self._kept[1], self._form)
        P, root = symmetric(self.P, "P", self._dim_x)
        return Gaussian(x, P if self._form is COVARIANCE else root, self._form)

    def _from(self, mean: Array, cov: Array) -> Gaussian:
        P, root = symmetric(cov, "P", self._dim_x)
        return Gaussian(mean, P if self._form is COVARIANCE else root, self._form)

    def _keep(self, belief: Gaussian) -> None:
        self.x, self.P = np.array(belief.mean), np.array(belief.cov)
        self._kept = (self.P.copy(), belief.spread)

    def _check(self, belief: Gaussian, failure: str) -> None:
        if failure or not np.isfinite(belief.mean).all():
            raise ValueError(failure or "P: expected a positive definite covariance")

    def _points(self, belief: Gaussian) -> Array:
        return self.rule.points(belief.mean, belief.root, self._space())[0]

    def _space(self) -> Space:
        return Space(sums(self.state_add), differences(self.residual_x), None, mean_of(self.x_mean))


class SquareRootUKF(SigmaPointUKF):
    """filterpy's UKF in square-root form: a root goes from step to step, ``P`` is made from it. See `SigmaPointUKF`."""

    _form: Form = SQUARE_ROOT

    @property
    def sqrt_P(self) -> Array:
        """Lower root of ``P``, ``(n, n)``."""
        return self._belief().spread
