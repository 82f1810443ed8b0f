"""Filters that predict over an interval, then update with one sensor after the other: `ukf`, `ekf`,
`ckf`, `ghkf`, `sigma_point`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Any

import numpy as np

from celnav.filters.joint import (
    KEEP,
    Gain,
    Hook,
    Joint,
    broadcast_belief,
    broadcast_to_runs,
    by_matrix,
    condition,
    evaluate,
    joint,
    marginal,
)
from celnav.filters.model import Motion, Sensor, check_matrices, check_prior, check_roots
from celnav.filters.records import Epoch, Info, State
from celnav.filters.regression import regressed
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.checks import (
    accepts,
    choice,
    describe,
    finite,
    function,
    instance,
    integer,
    number,
    numbers,
)
from celnav.gaussian.linalg import EPS, FORMS, Array, Belief, Form, is_concretely_true
from celnav.gaussian.rules import AnyDimension, Taylor, cubature, gauss_hermite, unscented
from celnav.gaussian.spaces import EUCLIDEAN, Space
from celnav.gaussian.sparse_grid import smolyak

__all__ = [
    "Iterated",
    "SingleDraw",
    "ckf",
    "ekf",
    "ghkf",
    "sigma_point",
    "sparse_grid_filter",
    "ukf",
]

MOST_ITERATIONS = 10_000  # in each update


@dataclass(frozen=True, eq=False, repr=False)
class Sequential:
    """A filter as data: its models, its rule and the form of its covariance, made by `ukf`, `ekf`,
    `ckf`, `ghkf` or `sigma_point`.

    ``start(prior)`` returns a state, ``step(state, epoch)`` the next state and an `Info` of each
    sensor; ``state.belief`` has ``mean``, ``cov`` and ``std``. An epoch with ``dt == 0`` has no
    prediction: the first epoch updates the prior.
    """

    motion: Motion
    sensors: tuple[Sensor, ...] = ()
    _: KW_ONLY
    rule: Any
    form: Form
    hooks: tuple[tuple[Hook, ...], ...] = ()
    gain: Gain | None = None

    def __repr__(self) -> str:
        form = next(name for name, form in FORMS.items() if form is self.form)
        sensors = ", ".join(describe(sensor.h) for sensor in self.sensors)
        name = type(self).__name__
        return f"{name}({describe(self.motion.f)}; {sensors}; {self.rule!r}, {form})"

    def start(self, prior: Gaussian) -> State:
        """State before the first epoch."""
        check_prior(prior)
        belief = self.form.of(prior)
        N, n = belief.mean.shape[-1], belief[1].shape[-1]
        if n != N and self.motion.space == EUCLIDEAN:
            raise ValueError(
                f"space: expected a space for {N} components, {n} differences, got vectors"
            )
        space = self.motion.space
        if space.check is not None:
            space.check(belief.mean, "prior")
        # n is the dimension of differences, which may differ from N: 3 for a quaternion with N = 4.
        if (tangent := space.minus(belief.mean, belief.mean).shape[-1]) != n:
            raise ValueError(
                f"prior: expected a covariance ({tangent}, {tangent}) of differences of states "
                f"of {N} components, got ({n}, {n})"
            )
        check_matrices(N, n, self.motion, *self.sensors)
        # Runs can share one covariance only if they share all matrices.
        if not all(by_matrix(model, self.rule) for model in (self.motion, *self.sensors)):
            belief = broadcast_belief(self.form, *belief)
        return State(belief, (None,) * len(self.sensors))

    def step(self, state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        """State after an epoch, and an `Info` of each sensor."""
        return self.update(self.predict(state, epoch), epoch)

    def predict(self, state: State, epoch: Epoch) -> State:
        """State at the end of the interval, before the measurement."""
        if not isinstance(state, State):
            raise ValueError(
                "state: expected what the filter's start(prior) or last step gave, got "
                f"{describe(state)}"
            )
        if not hasattr(epoch, "dt"):
            raise ValueError(f"epoch: expected a record like celnav.Epoch, got {describe(epoch)}")
        if is_zero_interval(epoch):
            return state
        return state._replace(
            belief=marginal(self.form, self.predicted(state.belief, epoch), self.motion.space)
        )

    def update(self, state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        """State given the measurements at the end of an epoch, and an `Info` of each sensor."""
        # One sensor after the other: the belief after one is the prior of the next.
        belief, memory, infos = state.belief, list(state.memory), []
        for i, (sensor, z) in enumerate(
            zip(self.sensors, measurements(epoch.z, len(self.sensors)), strict=True)
        ):
            if is_missing(z):
                infos.append(missing_info(sensor, z))
                # A missing measurement may have more axes of runs than the belief.
                belief = belief if z is None else broadcast_to_runs("z", z.shape[:-1], belief)
                continue
            hooks = self.hooks[i] if self.hooks else ()
            belief, info, memory[i] = self.update_sensor(
                sensor, belief, as_measurement(z, sensor), epoch, hooks, memory[i]
            )
            infos.append(info)
        return State(belief, tuple(memory)), tuple(infos)

    def predicted(self, belief: Belief, epoch: Epoch) -> Joint:
        """The joint of a prediction: the state after the interval."""
        motion = self.motion
        return joint(
            self.rule,
            belief,
            (motion,),
            epoch,
            space=motion.space,
            process_noise=motion.noise,
            augment=motion.augment,
        )

    def measured(
        self, model: Motion | Sensor, belief: Belief, z: Array, epoch: Epoch, rule: Any = None
    ) -> Joint:
        """The joint of a sensor's measurement ``z`` and the state; ``rule`` replaces the filter's
        rule. For smoothing the model is the motion, and ``z`` the state after the interval.
        """
        return joint(
            self.rule if rule is None else rule,
            belief,
            (model, KEEP),
            epoch,
            space=self.motion.space,
            z=z,
            measurement_noise=model.noise,
            augment=model.augment,
        )

    def update_sensor(
        self,
        sensor: Sensor,
        belief: Belief,
        z: Array,
        epoch: Epoch,
        hooks: tuple[Hook, ...],
        memory: Any,
    ) -> tuple[Belief, Info, Any]:
        """The belief given one measurement, an `Info`, and the memory of the hooks."""
        joint = self.measured(sensor, belief, z, epoch)
        after, info, memory = condition(
            self.form,
            joint,
            self.motion.space,
            hooks=hooks,
            memory=memory,
            epoch=epoch,
            gain=self.gain,
        )
        if not sensor.noisy and self.gain is None:
            after = self._reject_redundant(sensor, belief, joint, after, info, epoch)
        return after, info, memory

    def _reject_redundant(
        self, sensor: Sensor, belief: Belief, joint: Joint, after: Belief, info: Info, epoch: Epoch
    ) -> Belief:
        """The belief, with nan in runs where a measurement without noise repeats what the prior
        already determines.
        """
        # S_ii is the standard deviation of component i given the prior and the components before i.
        V, measured = joint.measurement_noise, joint.measurement
        # (..., m): a component whose row of V is zero has no noise.
        exact = np.ones(1, bool) if V is None else np.asanyarray(~V.any(-1))
        if is_concretely_true(~exact.any()):
            return after
        if by_matrix(sensor, self.rule):
            deviation, size = (
                (np.abs(measured.jacobian()) * belief.std[..., None, :]).max(-1),
                np.zeros(1),
            )
        else:
            # axes (n, ..., n): one standard deviation along each axis of the state; y[0] is the
            # image of the mean.
            axes = np.moveaxis(belief.std[..., None] * np.eye(belief[1].shape[-1]), -1, 0)
            y = evaluate(
                sensor,
                self.motion.space.plus(belief.mean, np.concatenate([0.0 * axes[:1], axes])),
                epoch,
            )
            # (n, ..., m), then (..., m): the largest along the axes of the state.
            deviation = np.abs(sensor.space.minus(y[1:], y[:1])).max(0)
            size = (
                np.abs(measured.center) if measured.center.shape == deviation.shape else np.zeros(1)
            )
        # S below this size is the round-off that remains after cancellation.
        least = 16.0 * (self.form.rounding() * deviation + EPS * size)
        # (...), bool for each run: one redundant component is enough.
        redundant = (
            exact
            & np.asanyarray(info.used)
            & (np.asanyarray(info.sqrt_S).diagonal(0, -2, -1) <= least)
        ).any(-1)
        if is_concretely_true(~redundant.any()):
            return after
        return self.form(
            np.where(redundant[..., None], np.nan, after.mean),
            np.where(redundant[..., None, None], np.nan, after[1]),
        )


def is_zero_interval(epoch: Any) -> bool:
    """Whether the interval of an epoch is known to be zero in every run."""
    return epoch.dt == 0.0 if isinstance(epoch.dt, float) else is_concretely_true(~np.any(epoch.dt))


def measurements(z: Any, sensors: int) -> tuple[Any, ...]:
    """The measurement of each sensor, from the ``z`` of an epoch."""
    samples = z if isinstance(z, tuple) else (None,) * sensors if z is None or not sensors else (z,)
    if len(samples) != sensors and sensors:
        raise ValueError(f"z: expected {sensors} measurements, one a sensor, got {len(samples)}")
    return samples[:sensors]


def as_measurement(z: Any, sensor: Sensor) -> Array:
    """A measurement ``(..., m)`` as floats."""
    if type(z) is not np.ndarray or z.dtype != np.float64:
        z = numbers("z", z)
    if z.ndim == 0:
        raise ValueError(f"z: expected shape (..., m), got the number {z}; one component is [z]")
    check = sensor.space.check
    measurement: Array = z if check is None or z.dtype.hasobject else check(z, "z")
    return measurement


def is_missing(z: Any) -> bool:
    """Whether nothing was measured, in any run."""
    return z is None or (
        type(z) is np.ndarray and z.dtype == np.float64 and bool(np.isnan(z).all())
    )


def missing_info(sensor: Sensor, z: Any) -> Info:
    """The `Info` of a measurement of which every component is missing."""
    if z is None:
        return Info(silent=True)
    # The innovation has as many components as a difference of measurements: 3 for a quaternion.
    nan_z = np.full(z.shape[-1], np.nan)
    shape = (*z.shape[:-1], sensor.space.minus(nan_z, nan_z).shape[-1])
    return Info(np.full(shape, np.nan), np.zeros(shape), np.zeros(shape, bool))


# -- made ------------------------------------------------------------------------------------------
def sigma_point(
    motion: Motion,
    *sensors: Sensor,
    rule: Any,
    form: str = "square root",
    hooks: Sequence[Any] = (),
    gain: Gain | None = None,
    iterations: int = 1,
) -> Sequential:
    """A filter with any rule, for `celnav.run`.

    motion, sensors: the models. Without sensors the filter only predicts (open loop). With several
        sensors ``z`` is a tuple with an entry for each sensor, nan where the sensor has no sample;
        sensors with different rates need nothing else.
    rule: a `Rule`, `Taylor`, or a function ``n -> rule`` of the dimension of the state and of the
        noise that goes through the points.
    form: "square root" (QR, needs half the digits) or "covariance" (fewer operations).
    hooks: ``(memory, joint, epoch) -> (memory, joint)``, one after the other at each sensor: each
        gets the `Joint` of measurement and state and may replace it. `celnav.filters.adaptive` has
        hooks ready for use. A list of lists has the hooks of each sensor.
    gain: a prescribed gain ``(..., n, m)`` instead of the optimal gain, or a function
        ``(A, sign, m) -> gain``; only with one sensor.
    iterations: number of iterations of each update. From the second on, the update is relinearized
        over the posterior of the previous iteration: the posterior linearization filter
        [Garcia2015]; with Taylor's rule the iterated EKF [Bell1993]. It makes errors larger where a
        measurement fits two states.

    ValueError names an argument that does not fit.

    >>> hooks = [celnav.filters.adaptive.gate(4.0)]
    >>> celnav.sigma_point(motion, gps, rule=lambda n: celnav.smolyak(n, 3), hooks=hooks)
    """
    instance("motion", motion, Motion, "celnav.Motion(f, Q)")
    for sensor in sensors:
        instance("sensors", sensor, Sensor, "celnav.Sensor(h, R)")
    if gain is not None and len(sensors) != 1:
        raise ValueError(f"gain: expected one sensor with a prescribed gain, got {len(sensors)}")
    gain = (
        function("gain", gain, "(A, sign, m)")
        if callable(gain)
        else None
        if gain is None
        else finite("gain", gain)
    )
    if isinstance(rule, type) or not (hasattr(rule, "image") or callable(rule)):
        hint = " (celnav.from_filterpy makes it one)" if hasattr(rule, "sigma_points") else ""
        raise ValueError(
            "rule: expected a rule, such as celnav.unscented(n) or celnav.unscented, got "
            f"{describe(rule)}{hint}"
        )
    rule = rule if hasattr(rule, "image") or isinstance(rule, AnyDimension) else AnyDimension(rule)
    plain = Sequential(
        motion,
        sensors,
        rule=rule,
        form=FORMS[choice("form", form, FORMS)],
        hooks=_hooks_of_each_sensor(hooks, len(sensors)),
        gain=gain,
    )
    count = integer("iterations", iterations, 1, MOST_ITERATIONS)
    return plain if count == 1 else Iterated(**vars(plain), iterations=count)


def ukf(
    motion: Motion,
    *sensors: Sensor,
    alpha: float = 1.0,
    beta: float = 0.0,
    kappa: float = 0.0,
    **options: Any,
) -> Sequential:
    """The unscented Kalman filter; ``alpha, beta, kappa`` as in `celnav.unscented`, ``options`` as
    in `sigma_point`.

    The defaults have no negative weight: points and weights equal those of `ckf`.

    >>> filter = celnav.ukf(celnav.Motion(f, Q), celnav.Sensor(h, R))
    """
    # Checks the three numbers; a negative kappa may be valid for the dimension of the state.
    unscented(1, alpha, beta, max(number("kappa", kappa), 0.0))
    return sigma_point(
        motion, *sensors, rule=partial(unscented, alpha=alpha, beta=beta, kappa=kappa), **options
    )


def ckf(motion: Motion, *sensors: Sensor, degree: int = 3, **options: Any) -> Sequential:
    """The cubature Kalman filter, of degree 3 or 5; ``options`` as in `sigma_point`. With degree 3
    it equals the default `ukf`.

    >>> filter = celnav.ckf(motion, gps, degree=5)
    """
    return sigma_point(
        motion, *sensors, rule=partial(cubature, degree=choice("degree", degree, (3, 5))), **options
    )


def ghkf(motion: Motion, *sensors: Sensor, order: int = 3, **options: Any) -> Sequential:
    """The Gauss-Hermite Kalman filter with ``order ** n`` points; ``options`` as in `sigma_point`.

    >>> filter = celnav.ghkf(motion, gps, order=3)  # 729 points for six states
    """
    # Checks the order before the dimension is known.
    gauss_hermite(1, order)
    return sigma_point(motion, *sensors, rule=partial(gauss_hermite, order=order), **options)


def sparse_grid_filter(
    motion: Motion,
    *sensors: Sensor,
    level: int = 3,
    weights: Sequence[int] | None = None,
    **options: Any,
) -> Sequential:
    """The sparse-grid Gauss-Hermite filter; ``level, weights`` as in `celnav.smolyak`, ``options``
    as in `sigma_point`.

    >>> filter = celnav.sparse_grid_filter(motion, gps, weights=[1, 1, 1, 2, 2, 2])
    """
    return sigma_point(
        motion, *sensors, rule=partial(smolyak, level=level, weights=weights), **options
    )


def ekf(motion: Motion, *sensors: Sensor, **options: Any) -> Sequential:
    """The extended Kalman filter, iterated with, for example, ``iterations=6``; ``options`` as in
    `sigma_point`.

    It linearizes with the ``jacobian`` of motion and sensors, or with numerical differences if
    there is none.

    >>> filter = celnav.ekf(celnav.Motion(f, Q, jacobian=lambda x, epoch: F), gps, iterations=3)
    """
    return sigma_point(motion, *sensors, rule=Taylor(), **options)


def require_sequential(name: str, filter: Any) -> Sequential:
    """The filter, if it only predicts and updates; ValueError for any other filter."""
    sequential: Sequential = instance(name, filter, Sequential, "celnav.ukf(motion, sensor)")
    if type(sequential).step is not Sequential.step:
        raise ValueError(
            f"{name}: expected a filter that predicts, then updates, such as celnav.ukf, got "
            f"{describe(filter)}"
        )
    return sequential


def _hooks_of_each_sensor(hooks: Any, sensors: int) -> tuple[tuple[Hook, ...], ...]:
    """Hooks for each sensor."""
    if isinstance(hooks, str) or not isinstance(hooks, Sequence):
        raise ValueError(
            "hooks: expected a list of hooks, such as [celnav.filters.adaptive.gate(4.0)], got "
            f"{describe(hooks)}"
        )
    lists = [hook for hook in hooks if isinstance(hook, list | tuple)]
    if lists and not len(lists) == len(hooks) == sensors:
        raise ValueError(
            f"hooks: expected hooks, or {sensors} lists of them, one for each sensor, got "
            f"{len(lists)} lists"
        )
    per_sensor = tuple(tuple(group) for group in hooks) if lists else (tuple(hooks),) * sensors
    wrong = [hook for group in per_sensor for hook in group if not accepts(hook, 3)]
    if wrong:
        raise ValueError(
            f"hooks: expected functions (memory, joint, epoch), got {describe(wrong[0])}"
        )
    return per_sensor


# -- variants --------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False, repr=False)
class Iterated(Sequential):
    """A filter that relinearizes each update about the posterior of the previous iteration.

    An extended filter expands about the posterior's mean: its updates are Gauss-Newton steps to the
    mode [Bell1993]. A sigma-point filter makes a statistical linear regression over the whole
    posterior, whose residual is noise [Garcia2015]. If the posterior is narrow, this noise is
    small, and a nonlinearity across the prior's points has no effect.

    iterations: number of linearizations in each update. With ``first`` and one iteration, the
        update is linearized about another point, such as a closed-form solution from the
        measurements; the prior keeps its full weight.
    first: ``(belief, z, epoch) -> (..., N)``, the first point of linearization; None: the mean of
        the prior.
    """

    _: KW_ONLY
    iterations: int = 6
    first: Callable[[Belief, Array, Epoch], Array] | None = None

    def __post_init__(self) -> None:
        integer("iterations", self.iterations, 1, MOST_ITERATIONS)
        if self.first is not None:
            function("first", self.first, "(belief, z, epoch)")

    def update_sensor(
        self,
        sensor: Sensor,
        belief: Belief,
        z: Array,
        epoch: Epoch,
        hooks: tuple[Hook, ...],
        memory: Any,
    ) -> tuple[Belief, Info, Any]:

        about = belief
        if self.first is not None:
            about = about._replace(
                mean=numbers("first", self.first(belief, z, epoch), (..., belief.mean.shape[-1]))
            )
        # Each iteration conditions the prior `belief` again; only the point of linearization
        # changes.
        for _ in range(self.iterations):
            joint, space = self.relinearized(about, sensor, belief, z, epoch), self.motion.space
            # Hooks start from the same memory in each iteration, so that a sample enters it once.
            about, info, remembered = condition(
                self.form, joint, space, hooks=hooks, memory=memory, epoch=epoch, gain=self.gain
            )
        return about, info, remembered

    def relinearized(
        self, about: Belief, sensor: Sensor, belief: Belief, z: Array, epoch: Epoch
    ) -> Joint:
        """The joint of the measurement and the state with the prior ``belief``, from a regression
        over the belief ``about``.
        """
        space = self.motion.space
        return linearized_over(
            about,
            self.rule,
            belief,
            sensor,
            space,
            lambda rule, belief: self.measured(sensor, belief, z, epoch, rule),
        )


def linearized_over(
    about: Belief,
    rule: Any,
    belief: Belief,
    model: Motion | Sensor,
    space: Space,
    draw: Callable[[Any, Belief], Joint],
) -> Joint:
    """The joint from ``draw(rule, belief)``, with the prior ``belief`` for the state and the model
    linearized over ``about``.
    """
    if isinstance(rule, Taylor):
        return draw(
            Taylor(rule.step, about=about.mean),
            broadcast_to_runs("about", about.mean.shape[:-1], belief),
        )
    # The matrix of a linear model is the same everywhere.
    if about is belief or by_matrix(model, rule):
        return draw(rule, belief)
    # The regression is over `about`; the offset moves its linear function to the mean of the prior.
    return regressed(draw(rule, about), belief, space.minus(belief.mean, about.mean))


@dataclass(frozen=True, eq=False, repr=False)
class SingleDraw(Sequential):
    """Predict and update with one set of points: the augmented form of [Merwe2004], which draws no
    new points before the update.

    Noise goes through the points: ``f(x, epoch, *noise)`` and ``h(f(x), epoch, *noise)`` both get
    all noises of the motion and then of its only sensor. Additive process noise is an error,
    because it would not reach the measurement. An epoch with ``dt == 0`` is an ordinary update.
    ``SingleDraw.of(celnav.ukf(motion, sensor))`` makes one from a filter.

    joint_noise: roots of noises that both functions get instead, for correlated process and
        measurement noise.

    >>> filter = celnav.ukf(celnav.Motion(f, augment=[np.eye(6)]), gps)
    >>> filter = celnav.filters.sequential.SingleDraw.of(filter)
    """

    _: KW_ONLY
    joint_noise: tuple[Array, ...] = ()

    def __post_init__(self) -> None:
        check_roots("joint_noise", self.joint_noise)

    @classmethod
    def of(cls, filter: Sequential) -> SingleDraw:
        """The same filter with a single draw of points; ValueError if it does not allow that."""
        require_sequential("filter", filter)
        if (
            len(filter.sensors) != 1
            or filter.motion.Q is not None
            or filter.motion.sqrt_Q is not None
        ):
            raise ValueError(
                "filter: expected one sensor, and process noise through the points (augment) only"
            )
        if isinstance(filter, Iterated):
            raise ValueError("filter: expected iterations=1, because points are drawn once")
        return cls(
            filter.motion,
            filter.sensors,
            rule=filter.rule,
            form=filter.form,
            hooks=filter.hooks,
            gain=filter.gain,
        )

    @property
    def noises(self) -> tuple[Array, ...]:
        """Roots of the noises that both functions get."""
        return self.joint_noise or (*self.motion.augment, *self.sensors[0].augment)

    def step(self, state: State, epoch: Epoch) -> tuple[State, tuple[Info, ...]]:
        (z,) = measurements(epoch.z, 1)
        if is_zero_interval(epoch):
            return super().step(state, epoch)
        if z is not None:
            z = as_measurement(z, self.sensors[0])
            state = state._replace(belief=broadcast_to_runs("z", z.shape[:-1], state.belief))
        (sensor,), belief, space = self.sensors, state.belief, self.motion.space
        if is_missing(z):
            ahead = joint(
                self.rule,
                belief,
                self.moves,
                epoch,
                space=space,
                spaces=(space,),
                augment=self.noises,
            )
            return state._replace(belief=marginal(self.form, ahead, space)), (
                missing_info(sensor, z),
            )
        # The columns of z = h(f(x, w), w) + v and of x' = f(x, w), from the same points of (x, w).
        both = joint(
            self.rule,
            belief,
            self.outputs,
            epoch,
            space=space,
            spaces=(sensor.space, space),
            z=z,
            measurement_noise=sensor.noise,
            augment=self.noises,
        )
        hooks = self.hooks[0] if self.hooks else ()
        after, info, memory = condition(
            self.form, both, space, hooks=hooks, memory=state.memory[0], epoch=epoch, gain=self.gain
        )
        return State(after, (memory,)), (info,)

    def moves(self, x: Array, epoch: Epoch, *noise: Array) -> tuple[Array]:
        """The state at the end of the interval."""
        return (evaluate(self.motion, x, epoch, noise),)

    def outputs(self, x: Array, epoch: Epoch, *noise: Array) -> tuple[Array, Array]:
        """The measurement and the state at the end of the interval, both from the points at the
        start.
        """
        y = evaluate(self.motion, x, epoch, noise)
        return evaluate(self.sensors[0], y.copy(order="K"), epoch, noise), y
