"""Filters for colored measurement noise ``V' = Phi V + zeta``: whiten it by differencing, or carry
it in the state.

The difference ``z* = z' - Phi z`` of consecutive measurements has white noise, correlated with the
process noise. `colored` conditions on the difference in one transform. `decorrelated` uses the two
steps of [Sun2015]. `augmented` carries V in the state and is the exact reference. All accept any
rule and both forms. ``Phi`` may be a full matrix, differ from run to run, or be a function of the
epoch.

If only a range of time constants is known, `bounding` gives a noise that bounds all of them.

A missing sample costs `colored` two differences: the one that ends with the sample and the one that
begins with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celnav.filters.joint import (
    KEEP,
    Hook,
    Joint,
    broadcast_to_runs,
    by_matrix,
    condition,
    evaluate,
    joint,
    linear,
    marginal,
    noise_at,
    rule_for,
)
from celnav.filters.model import Motion, Noise, Sensor, check_prior, check_return, noise_of
from celnav.filters.records import Epoch, Info
from celnav.filters.sequential import (
    Sequential,
    as_measurement,
    is_missing,
    is_zero_interval,
    missing_info,
    sigma_point,
)
from celnav.gaussian.belief import Gaussian, symmetric
from celnav.gaussian.checks import (
    Shape,
    as_matrix,
    choice,
    finite,
    function,
    instance,
    numbers,
    together,
    unmasked,
)
from celnav.gaussian.linalg import (
    POSITIVE,
    Array,
    SquareRoot,
    block,
    is_concretely_true,
    matvec,
    present,
    side_by_side,
    solve_right,
    tria,
)
from celnav.gaussian.rules import UNSCENTED
from celnav.gaussian.spaces import EUCLIDEAN

__all__ = ["augmented", "colored", "decorrelated"]

Coloring = ArrayLike | Callable[[Any], Array]
"""``Phi (..., m, m)`` or ``epoch -> Phi``."""


def colored(
    motion: Motion,
    sensor: Sensor,
    Phi: Coloring | None = None,
    *,
    tau: ArrayLike | None = None,
    increments: Any = None,
    first: bool = True,
    rule: Any = UNSCENTED,
    **options: Any,
) -> Colored:
    """A filter for colored measurement noise, in one transform: condition ``x' = f(x) + w`` on
    ``z' - Phi z`` directly.

    motion, sensor: the models; ``sensor.R`` is the covariance ``(m, m)`` of the colored noise
        itself. States and measurements must be vectors, because ``z' - Phi z`` does not wrap
        angles. For a measured angle use `augmented`.
    Phi: ``(..., m, m)``, or a function of the epoch: the transition matrix of the noise from one
        measurement to the next; its spectral radius is at most 1. If R or h is a matrix, a number
        is that multiple of the identity.
    tau: in the place of Phi, the range ``(lo, hi)`` s of an unknown time constant. The noise is a
        stationary Gauss-Markov process with covariance R, or with a smaller one. The predicted
        covariance of a linear filter is then an upper bound for every time constant in the range
        [Langel2021], [GarciaCrespillo2023].
    increments: covariance ``(..., m, m)`` of ``V' - Phi V``, or a function ``(mean, epoch)`` of it;
        None: stationary noise, ``R - Phi R Phi'``. If V is not stationary (``Phi = I`` is a random
        walk), R is the covariance of its first sample.
    first: whether the first measurement updates the prior. Otherwise it only anchors the first
        difference, as in the paper, which is the limit of a large R.
    rule, options: as in `celnav.sigma_point`. If ``h`` is a function, the sigma points cover the
        process noise too.

    Returns a filter whose belief is about the state alone. ValueError names an argument that does
    not fit.

    >>> filter = celnav.colored(motion, celnav.Sensor(H, R), 0.9 * np.eye(3))
    >>> filter = celnav.colored(motion, celnav.Sensor(H, R), tau=(5.0, 80.0))
    """
    sensor, Phi, increments = _noise_model(sensor, Phi, tau, increments)
    plain = sigma_point(motion, sensor, rule=rule, **options)
    if type(plain) is not Sequential:
        raise ValueError(
            "iterations: expected 1, because process and measurement are one function here; for "
            "more use celnav.augmented"
        )
    if motion.space != EUCLIDEAN or sensor.space != EUCLIDEAN:
        raise ValueError(
            "space: expected states and measurements that are vectors; for others use "
            "celnav.augmented, which carries the noise in the state"
        )
    phi, once = coloring(Phi, sensor.m), bool(choice("first", first, (False, True)))
    return Colored(**vars(plain), Phi=phi, zeta=zeta_of(sensor, Phi, increments), first_sample=once)


def decorrelated(motion: Motion, sensor: Sensor, Phi: Coloring, **options: Any) -> Decorrelated:
    """The filter of [Sun2015] with its errata corrected: update the previous state, then predict;
    arguments as in `colored`.

    ``x* = f(x) + J (z* - h(x))`` and ``h(x) = H f(x) - Phi H x`` [Sun2015, Eqs. 8, 14]. The
    filter's state after an epoch has two estimates: ``belief`` of the present state, and ``lagged``
    of the previous state, each given all measurements so far. With a linear model ``belief`` equals
    the estimate that `colored` computes in one step. ``h`` must be a matrix. Hooks may leave
    measurements out, as gates do. Hooks that change the noise need `colored`, because here J,
    through which the measurement enters the prediction, depends on the noise. ValueError names an
    argument that does not fit.

    >>> filter = celnav.decorrelated(motion, gps, 0.9 * np.eye(3))
    """
    if callable(instance("sensor", sensor, Sensor, "celnav.Sensor(h, R)").h):
        raise ValueError(
            "sensor: expected a measurement matrix (m, n), got a function; `colored` accepts one"
        )
    return Decorrelated(**vars(colored(motion, sensor, Phi, **options)))


def _noise_model(
    sensor: Sensor, Phi: Coloring | None, tau: ArrayLike | None, increments: Any
) -> tuple[Sensor, Coloring, Any]:
    """The sensor with the covariance of the first sample, Phi, and the increments."""
    if tau is None:
        if Phi is None:
            raise ValueError(
                "Phi: expected the transition matrix of the noise, or tau; got neither"
            )
        return sensor, Phi, increments
    for name, value in (("Phi", Phi), ("increments", increments)):
        if value is not None:
            raise ValueError(f"tau: expected without {name}, which follows from tau; got both")
    return bounding(sensor, tau)


def bounding(sensor: Sensor, tau: ArrayLike) -> tuple[Sensor, Coloring, Any]:
    """The Gauss-Markov noise that bounds the noise of every time constant in ``tau = (lo, hi)``:
    the sensor with the covariance of its first sample, Phi and the increments.

    Bounds of this kind are in [Langel2021]; tight ones are in [GarciaCrespillo2023].
    With ``r = sqrt(hi / lo)`` the bound has the time constant ``sqrt(lo hi)``, the stationary
    covariance ``r R``, and the covariance ``2 R / (1 + 1 / r)`` of the first sample. At any times,
    its covariance minus the covariance of the noise is positive semidefinite.
    """
    instance("sensor", sensor, Sensor, "celnav.Sensor(h, R)")
    low, high = finite("tau", tau, (2,))
    if not 0.0 < low <= high:
        raise ValueError(f"tau: expected (lo, hi) with 0 < lo <= hi, got ({low:g}, {high:g})")
    if sensor.m is None:
        raise ValueError("R: expected a constant covariance (m, m) with tau, got another form")
    ratio, middle, V = np.sqrt(high / low), np.sqrt(low * high), np.asanyarray(sensor.noise)

    def Phi(epoch: Any) -> Array:
        return np.asanyarray(np.exp(-epoch.dt / middle))

    def increments(_: Array, epoch: Any) -> Array:
        left = -np.expm1(-2.0 * epoch.dt / middle)  # 1 - Phi^2
        return np.asanyarray(ratio * left * (V @ V.mT))

    first = replace(sensor, R=None, sqrt_R=np.sqrt(2.0 / (1.0 + 1.0 / ratio)) * V)
    return first, Phi, increments


def coloring(Phi: Coloring, m: int | None = None) -> Array | Callable[[Any], Array]:
    """Phi ``(..., m, m)``, checked, or a function of the epoch whose values are checked. A random
    walk has spectral radius 1.
    """
    shape = (..., m or "m", m or "m")
    if callable(Phi):
        return partial(_coloring_at, function("Phi", Phi, "(epoch)"), shape)
    matrix = as_matrix("Phi", Phi, m)
    if not matrix.ndim:
        raise ValueError(
            f"Phi: expected a matrix (m, m) where neither R nor h is one, got the number {matrix}"
        )
    matrix = finite("Phi", matrix, shape)
    radius = np.abs(np.linalg.eigvals(matrix)).max()
    if radius > 1.0 + 1e-9:
        raise ValueError(f"Phi: expected a spectral radius of at most 1, got {radius:.6g}")
    return matrix


def _coloring_at(Phi: Callable[[Any], Array], shape: Shape, epoch: Any) -> Array:
    matrix = numbers("Phi", unmasked("Phi", Phi(epoch)))
    if not matrix.ndim and isinstance(shape[-1], int):
        matrix = np.asanyarray(matrix * np.eye(shape[-1]))
    return numbers("Phi", matrix, shape)


def zeta_of(sensor: Sensor, Phi: Coloring, increments: Any) -> Noise:
    """Columns ``(..., m, r)`` of the increments, as passed or from stationary noise with covariance
    R; or a function ``(mean, epoch)`` that returns them.
    """
    if increments is not None:
        columns = noise_of("increments", increments, None, sensor.m)
        if isinstance(columns, np.ndarray) and sensor.m not in (None, columns.shape[-2]):
            raise ValueError(
                f"increments: expected {sensor.m} rows to go with the sensor's R, got "
                f"{columns.shape[-2]}"
            )
        return columns
    phi = coloring(Phi, sensor.m)
    stationary = partial(_stationary, sensor.noise, phi)
    return stationary if callable(phi) or callable(sensor.noise) else stationary(np.zeros(0), None)


def _stationary(noise: Noise, Phi: Any, mean: Array, epoch: Any) -> Array:
    """Root of the covariance ``R - Phi R Phi'`` of the increments of stationary noise."""
    V, phi = noise_at(noise, mean, epoch), Phi(epoch) if callable(Phi) else Phi
    V = V if V.ndim else V * np.eye(phi.shape[-1])
    # With R = V V': R - Phi R Phi' = V V' - (Phi V) (Phi V)'.
    carried = phi @ V
    return symmetric(
        V @ V.mT - carried @ carried.mT, "Phi, R: covariance R - Phi R Phi' of the increments"
    )[1]


def difference(Phi: Array, z: Array, z_next: Array) -> Array:
    """``z_next - Phi z (..., m)``. A missing component of z makes only those differences nan that
    it enters.
    """
    absent = ~present(z)
    if is_concretely_true(~absent.any()):
        return np.asanyarray(z_next - matvec(Phi, z))
    # (..., m): differences in which a missing component has a nonzero coefficient.
    spoiled = matvec((Phi != 0.0).astype(float), absent.astype(float)) > 0.0
    return np.asanyarray(np.where(spoiled, np.nan, z_next - matvec(Phi, np.where(absent, 0.0, z))))


class ColoredState(NamedTuple):
    """State of a filter for colored noise: the estimate, the last measurement, and the memory of
    the hooks.

    ``lagged`` is the estimate of the *previous* state given the present measurement (the prior at
    the first epoch, and where a filter does not compute it).
    """

    belief: Any
    z: Any
    lagged: Any
    memory: Any = None


@dataclass(frozen=True, eq=False, repr=False)
class Colored(Sequential):
    """The filter of `colored`, with the transition matrix ``Phi`` and the columns ``zeta`` of the
    increments, or functions that return them.
    """

    _: KW_ONLY
    Phi: Array | Callable[[Any], Array]
    zeta: Noise
    first_sample: bool

    def start(self, prior: Gaussian) -> Any:
        belief = super().start(prior).belief
        return ColoredState(belief, None, belief)

    def step(self, state: Any, epoch: Epoch) -> tuple[Any, tuple[Info, ...]]:
        (sensor,) = self.sensors
        z = self._measured(state, epoch)
        # The first sample: there is no difference yet.
        if state.z is None:
            belief, info = state.belief, missing_info(sensor, z) if self.first_sample else Info()
            if self.first_sample and not is_missing(z):
                belief, info, _ = self.update_sensor(sensor, belief, z, epoch, (), None)
            return ColoredState(belief, z, state.lagged, state.memory), (info,)
        Phi = self.Phi(epoch) if callable(self.Phi) else self.Phi
        if Phi.ndim > 2:
            state = state._replace(belief=broadcast_to_runs("Phi", Phi.shape[:-2], state.belief))
        return self.advance(state, Phi, difference(Phi, state.z, z), epoch, z)

    def advance(
        self, state: Any, Phi: Array, z_star: Array, epoch: Epoch, z: Array
    ) -> tuple[Any, tuple[Info, ...]]:
        """State after an interval, given the difference ``z_star`` of the measurements at both
        ends.
        """
        both, (hooks,) = self.fused(state.belief, Phi, z_star, epoch), self.hooks
        belief, info, memory = condition(
            self.form,
            both,
            EUCLIDEAN,
            hooks=hooks,
            memory=state.memory,
            epoch=epoch,
            gain=self.gain,
        )
        return ColoredState(belief, z, state.lagged, memory), (info,)

    def fused(self, belief: Any, Phi: Array, z_star: Array, epoch: Epoch) -> Joint:
        """The joint of the difference ``h(f(x) + w) - Phi h(x) + zeta`` and the next state
        ``f(x) + w``.
        """
        motion, (sensor,), mean = self.motion, self.sensors, belief.mean
        W, Z, rule = (
            noise_at(motion.noise, mean, epoch),
            noise_at(self.zeta, mean, epoch),
            rule_for(self.rule, belief),
        )
        outputs: Any = partial(self.rows, Phi)
        augment: tuple[Array, ...] = ()
        if by_matrix(motion, rule) and by_matrix(sensor, rule):
            y, F = linear(motion, rule, mean, epoch)
            # Differenced measurement: H F - Phi H_x for the state, and H W for the process noise.
            # y = f(x): H is at the end of the interval, H_x at its start.
            (h_y, H), (h_x, H_x) = linear(sensor, rule, y, epoch), linear(sensor, rule, mean, epoch)
            outputs, beside = ((h_y - matvec(Phi, h_x), H @ F - Phi @ H_x), (y, F)), (H @ W, W)
        elif not callable(sensor.h):
            # H (f + w) - Phi H x: the process noise enters the difference by H W.
            beside = (sensor.h @ W, W)
        else:  # the process noise enters the measurement through h, so it goes through the points
            outputs, beside, augment, rule = (
                partial(self.through, Phi),
                None,
                (W,),
                rule_for(self.rule, belief, (W,)),
            )
        return joint(
            rule,
            belief,
            outputs,
            epoch,
            z=z_star,
            process_noise=beside,
            measurement_noise=Z,
            augment=augment,
        )

    def rows(self, Phi: Array, x: Array, epoch: Epoch) -> tuple[Array, Array]:
        """``H f(x) - Phi H x`` and ``f(x)``."""
        H = self.sensors[0].h
        y = evaluate(self.motion, x.copy(order="K"), epoch)
        return matvec(H, y) - matvec(Phi @ H, x), y

    def through(self, Phi: Array, x: Array, epoch: Epoch, w: Array) -> tuple[Array, Array]:
        """``h(f(x) + w) - Phi h(x)`` and ``f(x) + w``."""
        (sensor,), m = self.sensors, Phi.shape[-1]
        y = evaluate(self.motion, x.copy(order="K"), epoch) + w
        return evaluate(sensor, y.copy(order="K"), epoch, m=m) - matvec(
            Phi, evaluate(sensor, x, epoch, m=m)
        ), y

    def _measured(self, state: Any, epoch: Epoch) -> Array:
        """The measurement of an epoch, nan where there is none."""
        first = state.z is None
        # The first sample has no interval before it; each later sample ends an interval.
        if is_zero_interval(epoch) is not first:
            expected = (
                "0 at the first epoch (start from a prior at that time)"
                if first
                else "an interval after the first epoch"
            )
            raise ValueError(f"dt: expected {expected}, got {epoch.dt!r}")
        m = self.sensors[0].m
        if epoch.z is None and m is not None:
            return np.full(m, np.nan)
        z = as_measurement(epoch.z[0] if isinstance(epoch.z, tuple) else epoch.z, self.sensors[0])
        if m is not None and z.shape[-1] != m:
            raise ValueError(f"z: expected {m} components to go with h, got {z.shape[-1]}")
        return z


class Decorrelation(NamedTuple):
    """Gain ``J (..., n, m)`` and the roots of ``Q* (..., n, n)`` and ``R* (..., m, m)``
    [Sun2015, Eqs. 10-20].
    """

    J: Array
    sqrt_Q: Array
    sqrt_R: Array


def decorrelation(H: Array, sqrt_Q: Array, sqrt_R: Array) -> Decorrelation:
    """Decorrelate process noise and differenced measurement noise by one QR, without subtraction.

    The lower root of ``[[R^1/2, H Q^1/2], [0, Q^1/2]]`` is ``[[R*^1/2, 0], [J R*^1/2, Q*^1/2]]``.
    Subtracting covariances instead, ``Q* = Q - Q H' R*^-1 H Q``, loses every digit once the process
    noise is 1e8 times the measurement noise.
    """
    # tria of these columns is [[S, 0], [U, rest]] with S = R*^1/2, U = J R*^1/2, rest = Q*^1/2.
    both = block([[sqrt_R, H @ sqrt_Q], [0, sqrt_Q]])
    sqrt_R_star, U, sqrt_Q_star = SquareRoot.condition(both, POSITIVE, H.shape[-2])
    return Decorrelation(solve_right(sqrt_R_star, U), sqrt_Q_star, sqrt_R_star)


@dataclass(frozen=True, eq=False, repr=False)
class Decorrelated(Colored):
    """The filter of `decorrelated`."""

    @cached_property
    def _constant(self) -> Decorrelation | None:
        """The decorrelated noise, if it is the same at every epoch."""
        W, Z = self.motion.noise, self.zeta
        if isinstance(W, np.ndarray) and isinstance(Z, np.ndarray):
            return decorrelation(self.sensors[0].h, W, Z)
        return None

    def advance(
        self, state: Any, Phi: Array, z_star: Array, epoch: Epoch, z: Array
    ) -> tuple[Any, tuple[Info, ...]]:
        """Update the past state [Sun2015, Eqs. 24-32], then predict [Sun2015, Eqs. 33-37]."""
        gates = [partial(_leaving_out, hook) for hook in self.hooks[0]]
        noise = self.system(state.belief.mean, epoch, np.ones(1, bool)).sqrt_R
        # The measurement of the previous state is z* = H f(x) - Phi H x, with noise covariance R*.
        past = joint(
            self.rule,
            state.belief,
            lambda x, epoch: (self.rows(Phi, x, epoch)[0], KEEP),
            epoch,
            z=z_star,
            measurement_noise=noise,
        )
        lagged, info, memory = condition(
            self.form,
            past,
            EUCLIDEAN,
            hooks=gates,
            memory=state.memory,
            epoch=epoch,
            gain=self.gain,
        )
        used = np.asanyarray(info.used)
        # J z* is the mean of the process noise given the difference z*.
        star = self.system(lagged.mean, epoch, used)
        # A component that was not used has a column of zeros in J; z* is 0 there, so that it is not
        # nan.
        z_star = np.where(used, z_star, 0.0)

        def entering(x: Array, epoch: Epoch) -> tuple[Array]:
            """``f(x) + J (z* - h(x))``."""
            h, y = self.rows(Phi, x, epoch)
            return (y + matvec(star.J, z_star - h),)

        ahead = marginal(
            self.form,
            joint(self.rule, lagged, entering, epoch, process_noise=star.sqrt_Q),
            EUCLIDEAN,
        )
        return ColoredState(ahead, z, lagged, memory), (info,)

    def system(self, mean: Array, epoch: Epoch, used: Array) -> Decorrelation:
        """The decorrelated noise; an unmeasured row does not enter ``J``, because it gets an
        independent noise of variance 1.
        """
        if is_concretely_true(used.all()) and self._constant is not None:
            return self._constant
        H, W, Z = (
            self.sensors[0].h,
            noise_at(self.motion.noise, mean, epoch),
            noise_at(self.zeta, mean, epoch),
        )
        if is_concretely_true(used.all()):
            return decorrelation(H, W, Z)
        # (..., m, 1): 1 for rows that were measured, 0 for the others.
        unit = used[..., None] * 1.0
        return decorrelation(
            H * unit, W, np.concatenate([Z * unit, np.eye(H.shape[-2]) * (1.0 - unit)], -1)
        )


def _leaving_out(hook: Hook, memory: Any, joint: Joint, epoch: Any) -> tuple[Any, Joint]:
    """A hook that may only leave measurements out: ValueError if it changes anything else."""
    memory, after = check_return("hooks", hook(memory, joint, epoch), "memory, joint")
    instance("hooks", after, Joint, "hooks that give back (memory, joint)")
    if any(
        getattr(after, field) is not getattr(joint, field)
        for field in joint._fields
        if field != "innovation"
    ):
        raise ValueError(
            "hooks: expected hooks that only leave measurements out, got one that changes noise; "
            "`colored` accepts it"
        )
    return memory, after


# -- the noise among the states --------------------------------------------------------------------
@dataclass(frozen=True, eq=False, repr=False)
class Augmented(Sequential):
    """The filter of `augmented`, on ``[x; V] (n + m)``, started from a prior of x alone."""

    _: KW_ONLY
    sqrt_V: Array
    Phi: Any

    def start(self, prior: Gaussian) -> Any:
        check_prior(prior)
        mean, root, V = prior.mean, prior.sqrt_cov, self.sqrt_V
        runs = () if callable(self.Phi) else self.Phi.shape[:-2]
        batch = together(prior=mean.shape[:-1], R=V.shape[:-2], Phi=runs)
        # [x; V], with V of mean 0 and covariance R, independent of x.
        both = side_by_side([mean, np.zeros((*batch, V.shape[-1]))])
        return super().start(Gaussian(both, sqrt_cov=block([[root, 0], [0, V]])))


def augmented(
    motion: Motion,
    sensor: Sensor,
    Phi: Coloring | None = None,
    *,
    tau: ArrayLike | None = None,
    increments: Any = None,
    rule: Any = UNSCENTED,
    **options: Any,
) -> Augmented:
    """The exact reference for colored noise: a filter on ``[x; V] (n + m)`` with no other
    measurement noise.

    Arguments as in `colored`; the measurement may be an angle, and R is a constant. The filter
    starts from a prior of ``x`` alone; its belief is about ``[x; V]``, and its covariance is
    singular after each measurement. A missing sample loses no other sample. ValueError names an
    argument that does not fit.

    >>> filter = celnav.augmented(motion, gps, 0.9 * np.eye(3))
    """
    instance("motion", motion, Motion, "celnav.Motion(f, Q)")
    instance("sensor", sensor, Sensor, "celnav.Sensor(h, R)")
    if motion.space != EUCLIDEAN or motion.augment or sensor.augment:
        raise ValueError(
            "motion: expected a model of vector states, with no noise through the points"
        )
    sensor, Phi, increments = _noise_model(sensor, Phi, tau, increments)
    if sensor.m is None:
        got = "a function" if callable(sensor.noise) else "a number"
        raise ValueError(f"R: expected a constant covariance (m, m) of the noise, got {got}")
    m, h, phi, zeta = sensor.m, sensor.h, coloring(Phi, sensor.m), zeta_of(sensor, Phi, increments)
    measured = (
        partial(_augmented_h, sensor)
        if callable(h)
        else np.concatenate([h, np.broadcast_to(np.eye(m), (*h.shape[:-2], m, m))], -1)
    )
    augmented_motion = Motion(
        partial(_augmented_f, motion, phi, m), sqrt_Q=partial(_augmented_noise, motion, zeta, m)
    )
    # All the measurement noise is in the state: no noise columns.
    augmented_sensor = Sensor(measured, sqrt_R=np.zeros((m, 0)), space=sensor.space)
    plain = sigma_point(augmented_motion, augmented_sensor, rule=rule, **options)
    return Augmented(**vars(plain), sqrt_V=tria(np.asanyarray(sensor.noise)), Phi=phi)


def _augmented_f(motion: Motion, phi: Any, m: int, x: Array, epoch: Any) -> Array:
    # Components of a point: x (n), then V (m).
    moved = evaluate(motion, x[..., :-m].copy(order="K"), epoch)
    Phi = phi(epoch) if callable(phi) else phi
    if Phi.ndim > 2:
        together(points=x.shape[1:-1], Phi=Phi.shape[:-2])
    return side_by_side([moved, matvec(Phi, x[..., -m:])])


def _augmented_noise(motion: Motion, zeta: Noise, m: int, mean: Array, epoch: Any) -> Array:
    return block(
        # Process noise of x, then increments of V: block diagonal.
        [[noise_at(motion.noise, mean[..., :-m], epoch), 0], [0, noise_at(zeta, mean, epoch)]]
    )


def _augmented_h(sensor: Sensor, x: Array, epoch: Any) -> Array:
    m: int = sensor.m or 0
    return np.asanyarray(sensor.space.plus(sensor.h(x[..., :-m], epoch), x[..., -m:]))
