"""A drop-in for filterpy's ``UnscentedKalmanFilter``: change one import, keep the rest.

`SquareRootUKF` carries a square root from step to step, `SigmaPointUKF` a covariance. Both are thin
interfaces to `joint` and `condition`. State, covariances and everything else are plain attributes,
as in filterpy 2.0: assign them, or change them in place.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from copy import deepcopy
from math import isfinite
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.linalg import cholesky

from celnav.filters.joint import KEEP, condition, joint, marginal
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch, Info
from celnav.filters.sequential import Sequential
from celnav.filters.smoother import back
from celnav.gaussian.belief import any_lost, symmetric
from celnav.gaussian.checks import finite, numbers
from celnav.gaussian.linalg import Array, Covariance, Form, SquareRoot, outer, whiten
from celnav.gaussian.rules import Rule, from_filterpy
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.lazy import requires_extra

with requires_extra("celnav.filters.dropin", "filterpy"):
    from filterpy.common import pretty_str

__all__ = ["SigmaPointUKF", "SquareRootUKF"]

Function = Callable[..., Any]
"""A filterpy function of one vector."""
MaybeFunction = Function | None
Model = Callable[[Array, Any], Array]
"""``(points (p, n), epoch) -> (p, m)``."""


def _late(name: str, doc: str) -> Any:
    """An attribute that may be assigned; a function that a step has stored is called when the
    attribute is first read.
    """

    def get(self: Any) -> Any:
        value = self._made[name]
        if callable(value):
            value = self._made[name] = value()
        return value

    return property(get, lambda self, value: self._made.update({name: value}), doc=doc)


class SigmaPointUKF:
    """filterpy's UKF in covariance form, its constructor, attributes and methods; see filterpy's
    documentation for their use.

    points: a filterpy sigma-point object or a celnav `Rule`.
    vectorized: ``fx`` and ``hx`` are called with all points ``(p, n)`` at once.

    The points lie along the columns of the lower Cholesky root, as with filterpy's default. Every
    update draws new points (filterpy reuses the points of the prediction), so a second update in a
    row accounts for the first. A number as ``Q`` or ``R`` counts in every element, as in filterpy,
    with a warning; as ``P``, or as the ``R`` of one `update`, it is the variance of every
    component. None means no noise. A call that raises an error changes nothing.
    ``python -m benchmarks.dropin`` measures the speed; for many runs use `celnav.run`.

    >>> points = celnav.unscented(6)
    >>> ukf = celnav.filters.dropin.SquareRootUKF(6, 3, 1.0, lambda x: x[:3], fx, points)
    """

    _form: Form = Covariance

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dt: float,
        hx: Function,
        fx: Function,
        points: Any,
        sqrt_fn: MaybeFunction = None,
        x_mean_fn: MaybeFunction = None,
        z_mean_fn: MaybeFunction = None,
        residual_x: MaybeFunction = None,
        residual_z: MaybeFunction = None,
        state_add: MaybeFunction = None,
        *,
        vectorized: bool = False,
    ):
        self._dim_x, self._dim_z, self._dt, self._vectorized = dim_x, dim_z, dt, vectorized
        # Values computed on first read, and values that are not arrays: filterpy's Saver makes
        # arrays of all other attributes.
        self._made: dict[str, Any] = {
            "log_likelihood": float(np.log(sys.float_info.min)),
            "mahalanobis": 0.0,
        }
        self._roots: dict[
            str, tuple[Any, Array]
        ] = {}  # by name: the matrix as last checked, and its root
        self.points_fn = points
        self.hx, self.fx = hx, fx
        self.msqrt = sqrt_fn or cholesky
        self.x_mean, self.z_mean = x_mean_fn, z_mean_fn
        self.residual_x, self.residual_z = residual_x or np.subtract, residual_z or np.subtract
        self.state_add = state_add or np.add
        self.inv: Function = np.linalg.pinv
        self.x, self.P = np.zeros(dim_x), np.eye(dim_x)
        self.Q, self.R = np.eye(dim_x), np.eye(dim_z)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()
        self.x_post, self.P_post = self.x.copy(), self.P.copy()
        self.sigmas_f, self.sigmas_h = (
            np.zeros((self._num_sigmas, dim_x)),
            np.zeros((self._num_sigmas, dim_z)),
        )
        self.K, self.y = np.zeros((dim_x, dim_z)), np.zeros(dim_z)
        self.S, self.SI = np.zeros((dim_z, dim_z)), np.zeros((dim_z, dim_z))
        self.z: Any = np.array([[None] * dim_z]).T

    K = _late("K", "Gain ``(n, m)`` of the last update.")
    SI = _late("SI", "Inverse ``(m, m)`` of ``S``, by ``inv``.")
    sigmas_f = _late("sigmas_f", "Points ``(p, n)`` of the last prediction.")
    log_likelihood = _late("log_likelihood", "Logarithm of the density of the last measurement.")
    mahalanobis = _late(
        "mahalanobis", "Mahalanobis distance of the last measurement; 0 before the first."
    )

    @property
    def points_fn(self) -> Any:
        """The object that makes the points; assigning one also sets its weights."""
        return self._points_fn

    @points_fn.setter
    def points_fn(self, points: Any) -> None:
        if points.n != self._dim_x:
            raise ValueError(f"points: expected n = dim_x = {self._dim_x}, got {points.n}")
        rule = points if isinstance(points, Rule) else from_filterpy(points)
        # Raises for a rule without points in some dimension.
        rule.points(np.zeros(rule.n), np.eye(rule.n), EUCLIDEAN)
        self._points_fn, self._num_sigmas = points, points.num_sigmas()
        self.Wm, self.Wc = points.Wm, points.Wc
        self._made["rule"] = rule, self.Wm, self.Wc

    @property
    def rule(self) -> Rule:
        """Points and weights as a celnav `Rule`."""
        rule, Wm, Wc = self._made["rule"]
        if Wm is not self.Wm or Wc is not self.Wc:
            Wm, Wc, of = self.Wm, self.Wc, self._points_fn
            rule = from_filterpy(
                SimpleNamespace(n=of.n, sigma_points=of.sigma_points, Wm=Wm, Wc=Wc)
            )
            self._made["rule"] = rule, Wm, Wc
        return rule  # type: ignore[no-any-return]

    def predict(
        self, dt: Any = None, UT: MaybeFunction = None, fx: MaybeFunction = None, **fx_args: Any
    ) -> None:
        """Predict over ``dt``, which is passed to ``fx``; the points are then drawn again, as in
        filterpy 2.0.
        """
        belief, process = self._belief(), self._root("Q", self.Q, self._dim_x)
        function = self._motion(dt, fx, fx_args)
        if UT is None:
            space = self._space()
            ahead = joint(
                self.rule,
                belief,
                lambda x, _: (function(x, None),),
                space=space,
                spaces=(space,),
                process_noise=process,
            )
            after = marginal(self._form, ahead, space)
            self._check(belief, after, "fx", function, "the covariance lost positive definiteness")
            belief = after
        else:
            images = function(self._points(belief), None)
            belief = self._from(*UT(images, self.Wm, self.Wc, self.Q, self.x_mean, self.residual_x))
        self._keep(belief)
        self._made["sigmas_f"] = lambda: self._points(belief)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(
        self,
        z: Any,
        R: Any = None,
        UT: MaybeFunction = None,
        hx: MaybeFunction = None,
        **hx_args: Any,
    ) -> None:
        """Update with ``z (m,)``. None, or all nan, means no measurement; if some components are
        nan, the others are used.
        """
        measured = np.zeros(0) if z is None else numbers("z", z)
        if measured.ndim > 1 and measured.shape != (measured.size, 1):
            raise ValueError(f"z: expected shape (m,), got {measured.shape}")
        measured = measured.ravel()
        if np.isinf(measured).any():
            raise ValueError("z: expected finite numbers or nan, got an infinite one")
        if np.isnan(measured).all():
            self.z = np.array([[None] * self._dim_z]).T
            self.x_post, self.P_post = numbers("x", self.x).copy(), numbers("P", self.P).copy()
            return
        m, n = len(measured), self._dim_z
        if m != n and hx is None and np.shape(self.R if R is None else R) == (n, n):
            raise ValueError(f"z: expected {n} components, got {m}; another sensor has its own R")
        noise = self.R if R is None else numbers("R", R) * np.eye(m) if np.isscalar(R) else R
        root, belief = self._root("R", noise, m), self._belief()
        h = self._model("hx", hx or self.hx, m, hx_args)
        if UT is None:
            after, images, info = self._conditioned(belief, measured, h, root)
        else:
            after, images, info = self._transformed(UT, belief, measured, h, noise)
        self._keep(after)
        S = self.S = outer(info.sqrt_S)
        self.sigmas_h, self.y = np.array(images[-self._num_sigmas :]), np.asarray(info.innovation)
        self._made |= {
            "K": info.gain,
            "SI": lambda: self.inv(S),
            "mahalanobis": lambda: float(np.sqrt(info.nis)),
            "log_likelihood": lambda: float(info.log_likelihood),
        }
        self.z = z.copy() if type(z) is np.ndarray else deepcopy(z)
        self.x_post, self.P_post = self.x.copy(), self.P.copy()

    def _conditioned(self, belief: Any, z: Array, h: Model, root: Array) -> tuple[Any, Array, Any]:
        """The update with celnav's conditioning: the belief, the images of the points ``(p, m)``,
        and the `Info`.
        """
        space, measured = self._space(), _space_of(np.add, self.residual_z, self.z_mean)
        images: list[Array] = []

        def g(points: Array, epoch: Any = None) -> Array:
            images.append(h(points, epoch))
            return images[-1]

        if 0.0 not in root.diagonal().tolist() or root.any(-1).all():
            both = joint(
                self.rule,
                belief,
                lambda x, _: (g(x), KEEP),
                space=space,
                spaces=(measured, space),
                z=z,
                measurement_noise=root,
            )
            after, info, _ = condition(self._form, both, space)
        else:  # a component without noise must not repeat what the prior determines
            motion = Motion(g, sqrt_Q=np.zeros((self._dim_x, 0)), space=space)
            sensor = Sensor(g, sqrt_R=root, space=measured)
            exact = Sequential(motion, (sensor,), rule=self.rule, form=self._form)
            after, info, _ = exact.update_sensor(sensor, belief, z, Epoch(), (), None)
        self._check(belief, after, "hx", h, "the innovation covariance is not positive definite")
        return after, images[0], info

    def _check(self, before: Any, after: Any, name: str, function: Model, why: str) -> None:
        if any_lost(after):
            points = self.rule.points(before.mean, before.sqrt_cov, self._space())[0]
            bad = ~np.isfinite(function(points, None)).all(-1)
            raise ValueError(
                f"{name} is not finite at sigma point {int(np.argmax(bad))}" if bad.any() else why
            )

    def _transformed(
        self, UT: Function, belief: Any, z: Array, h: Model, R: Any
    ) -> tuple[Any, Array, Any]:
        """The update with a user's transform, which returns a mean and a covariance."""
        if np.isnan(z).any():
            raise ValueError("z: expected every component where UT is given, got nan")
        images, predicted, S, gain = self._through(UT, belief, h, R, self.z_mean, self.residual_z)
        L, innovation = symmetric(S, "S", len(z))[1], np.asarray(self.residual_z(z, predicted))
        after = self._from(
            self.state_add(belief.mean, gain @ innovation), belief.cov - gain @ S @ gain.T
        )
        used = np.ones(len(z), bool)
        return after, images, Info(innovation, whiten(L, innovation), used, L, lambda: gain)

    def _through(
        self, UT: Any, belief: Any, function: Model, noise: Any, mean: Any, residual: Any
    ) -> tuple[Any, Any, Any, Any]:
        """The images of the points ``(p, m)``, their mean ``(m,)`` and covariance ``(m, m)`` from a
        transform, and the gain ``(n, m)``.
        """
        points = self._points(belief)
        images = function(points, None)
        y, S = UT(images, self.Wm, self.Wc, noise, mean, residual)
        cross = self.cross_variance(belief.mean, y, points, images, residual)
        return images, y, S, np.linalg.solve(S.T, cross.T).T  # the gain solves K S = cross

    def compute_process_sigmas(self, dt: Any, fx: MaybeFunction = None, **fx_args: Any) -> None:
        """Store the propagated points in ``sigmas_f``. (An update always draws its points from the
        present state.)
        """
        self.sigmas_f = self._motion(dt, fx, fx_args)(self._points(self._belief()), None)

    def cross_variance(
        self,
        x: Array,
        z: Array,
        sigmas_f: Array,
        sigmas_h: Array,
        residual: MaybeFunction = None,
    ) -> Array:
        """Cross covariance ``(n, m)`` of state points and measurement points; ``residual`` replaces
        ``residual_z``.
        """
        dx = _differences(self.residual_x)(sigmas_f, x)
        dz = _differences(residual or self.residual_z)(sigmas_h, z)
        return np.asarray((dx * np.asarray(self.Wc)[:, None]).T @ dz)

    def batch_filter(
        self,
        zs: Any,
        Rs: Any = None,
        dts: Any = None,
        UT: MaybeFunction = None,
        saver: Any = None,
    ) -> tuple[Array, Array]:
        """Predict and update over all ``zs`` (None where missing): means ``(T, n)`` and covariances
        ``(T, n, n)``.
        """
        count = len(zs)
        Rs, dts = (
            self._per_epoch("Rs", Rs, self.R, count),
            self._per_epoch("dts", dts, self._dt, count),
        )
        means, covs = np.zeros((count, self._dim_x)), np.zeros((count, self._dim_x, self._dim_x))
        for k, (z, R, dt) in enumerate(zip(zs, Rs, dts, strict=True)):
            self.predict(dt=dt, UT=UT)
            self.update(z, R, UT=UT)
            means[k], covs[k] = self.x, self.P
            if saver is not None:
                saver.save()
        return means, covs

    def rts_smoother(
        self, Xs: Any, Ps: Any, Qs: Any = None, dts: Any = None, UT: MaybeFunction = None
    ) -> tuple[Array, Array, Array]:
        """Smoothed means ``(T, n)``, covariances and gains ``(T, n, n)``.

        ``dts[k]`` and ``Qs[k]``, which filterpy ignores, belong to the interval from k to k + 1.
        """
        count, n = len(Xs), self._dim_x
        xs, ps = finite("Xs", Xs, (count, n)), finite("Ps", Ps, (count, n, n))
        gains = np.zeros((count, n, n))
        Qs, dts = (
            self._per_epoch("Qs", Qs, self.Q, count),
            self._per_epoch("dts", dts, self._dt, count),
        )
        after = self._from(xs[-1], ps[-1], "Ps")
        for k in reversed(range(count - 1)):
            belief, function = self._from(xs[k], ps[k], "Ps"), self._motion(dts[k], None, {})
            if UT is None:
                motion = Motion(function, sqrt_Q=self._root("Qs", Qs[k], n), space=self._space())
                after, gains[k] = back(
                    Sequential(motion, rule=self.rule, form=self._form), belief, after, Epoch()
                )
            else:
                _, mean, cov, G = self._through(
                    UT, belief, function, Qs[k], self.x_mean, self.residual_x
                )
                smoothed = self.state_add(xs[k], G @ self.residual_x(after.mean, mean))
                # x_s = x + G (x_s' - f), P_s = P + G (P_s' - P') G', with G = cov(x, f) P'^-1.
                after, gains[k] = self._from(smoothed, ps[k] + G @ (after.cov - cov) @ G.T, "Ps"), G
            xs[k], ps[k] = after.mean, after.cov
        return xs, ps, gains

    @property
    def likelihood(self) -> float:
        """Density of the last measurement, or the smallest normal number if it underflows."""
        return float(np.exp(self.log_likelihood)) or sys.float_info.min

    def __repr__(self) -> str:
        names = (
            "x P x_prior P_prior Q R S K y log_likelihood likelihood mahalanobis sigmas_f sigmas_h "
            "Wm Wc residual_x residual_z msqrt hx fx x_mean z_mean"
        )
        rows = (str(pretty_str(name, getattr(self, name))) for name in names.split())
        return "\n".join([f"{type(self).__name__} object", *rows])

    def __getstate__(self) -> Mapping[str, Any]:
        self._made = {
            name: value() if callable(value) else value for name, value in self._made.items()
        }
        return self.__dict__

    def _belief(self) -> Any:
        """The present state, checked; with the stored root, unless P has changed since then."""
        n, x, P = self._dim_x, numbers("x", self.x), numbers("P", self.P)
        if x.shape != (n,) or not isfinite(x.dot(x)):
            x = finite("x", x).ravel()
        if len(x) != n:
            raise ValueError(f"x: expected {n} components, got {len(x)}")
        key, factor = self._roots.get("P", (None, P))
        if key != (P.shape, P.tobytes()):
            factor = self._from(x, P if P.ndim else P * np.eye(n))[1]
            self._roots["P"] = (P.shape, P.tobytes()), factor
        return self._form(x, factor)

    def _root(self, name: str, cov: Any, n: int) -> Array:
        """Lower root ``(n, n)`` of a noise covariance in filterpy's convention, recomputed only if
        it has changed.
        """
        matrix = np.zeros((n, n)) if cov is None else numbers(name, cov)
        present = n, matrix.shape, matrix.tobytes()
        key, root = self._roots.get(name, (None, matrix))
        if key == present:
            return root
        if matrix.size == 1:
            if n > 1 and matrix.any():
                number = f"{matrix.item():g}"
                warnings.warn(
                    f"{name}: the number {number} counts in every element, as in filterpy; "
                    f"{number} * np.eye({n}) is a variance of every component",
                    stacklevel=3,
                )
            matrix = np.full((n, n), matrix.item())
        root = symmetric(matrix, name, n)[1]
        self._roots[name] = present, root
        return root

    def _motion(self, dt: Any, fx: MaybeFunction, options: dict[str, Any]) -> Model:
        dt = self._dt if dt is None else dt
        # Only numbers are checked here, as in filterpy; fx interprets everything else. Numpy's
        # dates are refused, because fx would use them as numbers.
        if isinstance(dt, (np.datetime64, np.timedelta64)) or (
            isinstance(dt, (float, int, np.number)) and not isfinite(dt)
        ):
            raise ValueError(f"dt: expected a finite number, got {dt!r}")
        return self._model("fx", fx or self.fx, self._dim_x, options, dt)

    def _model(
        self, name: str, function: Function, m: int, options: dict[str, Any], *arguments: Any
    ) -> Model:
        """A model ``(p, n) -> (p, m)`` of all points, from filterpy's function of one point or, if
        ``vectorized``, of all.
        """

        def model(points: Array, epoch: Any) -> Array:  # noqa: ARG001
            x = points.copy()  # the function may change its argument
            if self._vectorized:
                images: Any = function(x, *arguments, **options)
            else:
                images = [function(point, *arguments, **options) for point in x]
                if set(map(type, images)) == {np.ndarray}:
                    images = np.asarray(images)
            values = numbers(name, images)
            if values.shape != (len(x), m):
                values = values.reshape(len(x), -1)
                if values.shape[-1] != m:
                    raise ValueError(f"{name} returned shape {values.shape[1:]}, expected ({m},)")
            return values

        return model

    def _per_epoch(self, name: str, values: Any, default: Any, count: int) -> Any:
        """A value for each of ``count`` epochs."""
        if values is None or np.isscalar(values):
            return [default if values is None else values] * count
        if len(values) != count:
            raise ValueError(
                f"{name}: expected {count} entries, one for each epoch, got {len(values)}"
            )
        return values

    def _from(self, mean: Any, cov: Any, name: str = "P") -> Any:
        P, root = symmetric(cov, name, self._dim_x)
        return self._form(finite("x", mean), P if self._form is Covariance else root)

    def _keep(self, belief: Any) -> None:
        self.x, self.P = np.array(belief.mean, dtype=np.float64), np.array(belief.cov)
        self._roots["P"] = (self.P.shape, self.P.tobytes()), belief[1]

    def _points(self, belief: Any) -> Array:
        """The points as in filterpy: without an added center of weight 0."""
        return self.rule.points(belief.mean, belief.sqrt_cov, self._space())[0][-self._num_sigmas :]

    def _space(self) -> Space:
        return _space_of(self.state_add, self.residual_x, self.x_mean)


class SquareRootUKF(SigmaPointUKF):
    """filterpy's UKF in square-root form: a root is carried from step to step, and ``P`` is
    computed from it. See `SigmaPointUKF`.
    """

    _form: Form = SquareRoot

    @property
    def sqrt_P(self) -> Array:
        """Lower root of ``P``, ``(n, n)``."""
        return np.array(self._belief()[1])


# -- filterpy's functions of one vector as functions of all points ---------------------------------
def _space_of(add: Function, residual: Function, mean: MaybeFunction) -> Space:
    """The space with filterpy's ``state_add``, residual and mean (None: the ordinary mean)."""
    if add is np.add and residual is np.subtract and mean is None:
        return EUCLIDEAN

    def plus(point: Array, tangent: Any) -> Array:
        """Sums of a point and all tangents; ``add`` may change its first argument. A scalar 0 for
        the tangents, as after a special mean, leaves the point unchanged.
        """
        return _by_row(lambda row: add(point.copy(), row), tangent) if np.ndim(tangent) else point

    def mean_of(points: Array, weights: Array) -> Array:
        return np.asarray(mean(points, weights), dtype=np.float64)  # type: ignore[misc]

    return Space(
        np.add if add is np.add else plus,
        _differences(residual),
        mean=None if mean is None else mean_of,
    )


def _differences(residual: Function) -> Function:
    """Differences of all points ``b`` from one point ``a``."""
    if residual is np.subtract:
        return np.subtract
    return lambda b, a: _by_row(lambda row: residual(row, a.ravel()), b)


def _by_row(function: Function, rows: Array) -> Array:
    values = [function(row) for row in np.atleast_2d(rows)]
    return np.array(values, dtype=np.float64).reshape(rows.shape)
