"""The filters that the paper and this study compare, for several cases at once (see `scenario`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from celnav.filters.model import Linear, Motion, Sensor
from celnav.filters.records import Epoch, Filter, FromFunctions, State
from celnav.filters.sequential import Sequential, ekf
from celnav.filters.two_stage import Plain, TwoStage
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, block, matvec, side_by_side
from celnav.models.orbit import Flow, flow
from celnav.papers.tstdkf.config import Config
from celnav.papers.tstdkf.method import Differenced, Noise, excess, proportional, strong_tracking
from celnav.papers.tstdkf.scenario import as_cases, noise_of, pull

FORMS = {"excess": excess, "proportional": proportional}
Runs = int | Sequence[int]
"""Of each case."""
White = tuple[Array, ...]
"""Covariances ``(..., 6, 6)`` and ``(..., m, m)`` of rates and timings, for a filter that takes all noise for white."""


class Orbit:
    """The orbit's flow about the last state asked for: what follows, Jacobian and noise input come from one integration.

    ``pulled``: whether Sun and Moon are part of it.
    """

    def __init__(self, pulled: bool = False) -> None:
        self._pulled = pulled
        self._last: tuple[Array, int, Flow] | None = None

    def __call__(self, mean: Array, epoch: Epoch) -> Flow:
        """Flow of an interval from the orbit in ``mean (..., 6 or more)``."""
        x = mean[..., :6]
        if self._last is None or self._last[1] != epoch.k or not np.array_equal(self._last[0], x):
            self._last = x.copy(), epoch.k, flow(x, epoch.dt, extra=pull(epoch.u[2] if self._pulled else None))
        return self._last[2]


class Models(NamedTuple):
    """Orbit and timings (km, with the Earth where it is believed to be) as filters see them, of ``(mean (..., 6 or more), epoch)``.

    ``Gamma (..., m, 3)`` is the slope with respect to the position, and to an error of the Earth's. ``linear``: whether they are
    products with their derivatives, which are then the same for every mean.
    """

    move: Callable[[Array, Epoch], Flow]
    measure: Callable[[Array, Epoch], Array]
    Gamma: Callable[[Array, Epoch], Array]
    linear: bool = False

    def H(self, mean: Array, epoch: Epoch) -> Array:
        """``[Gamma 0]``."""
        Gamma = self.Gamma(mean, epoch)
        return np.concatenate([Gamma, np.zeros_like(Gamma)], -1)


def models(config: Config, pulled: bool = False) -> Models:
    """The models of a configuration; those along its nominal orbit are `celnav.papers.tstdkf.linear.LINEAR`."""
    timing = config.timing
    return Models(
        Orbit(pulled),
        lambda x, epoch: timing.delay(epoch.u[0] + x[..., :3], epoch.u[1]),
        lambda x, epoch: timing.gradient(epoch.u[0] + x[..., :3], epoch.u[1]),
    )


def noises(cases: Sequence[Config], runs: Runs) -> Noise:
    """Noises of several cases, ``(all runs, ...)``; of one case without that axis."""
    return Noise(*_of_all([noise_of(case) for case in cases], runs))


def _of_all(each: Sequence[tuple[Array, ...]], runs: Runs) -> tuple[Array, ...]:
    """Matrices of each case with an axis of all runs; of one case without."""
    return each[0] if len(each) == 1 else tuple(np.repeat(np.stack(same), runs, 0) for same in zip(*each, strict=True))


def _each(cases: Sequence[Config], runs: Runs, name: str) -> Array:
    """A parameter of each case: ``(..., 1)`` or ``(..., 3)``, with an axis of all runs if there are several cases."""
    values = np.stack([np.atleast_1d(getattr(case, name)) for case in cases])
    return values[0] if len(cases) == 1 else np.repeat(values, runs, 0)


def bias_prior(cases: Sequence[Config], runs: Runs) -> Gaussian:
    """Belief about the ephemeris error at the start."""
    std = _each(cases, runs, "bias_prior_km")
    return Gaussian(np.zeros((*std.shape[:-1], 3)), std[..., None] ** 2 * np.eye(3))


def kalman(seen: Models, white: White) -> Sequential:
    """An EKF that takes all noise for white."""
    Q, R = white
    move, root = seen.move, np.linalg.cholesky(Q)

    def f(x: Array, epoch: Epoch) -> Array:
        return move(x[0], epoch).state[None]

    def noise(mean: Array, epoch: Epoch) -> Array:
        return move(mean, epoch).G @ root

    def transition(mean: Array, epoch: Epoch) -> Array:
        return move(mean, epoch).Phi

    motion = _differentiated(Motion, seen, f, transition, sqrt_Q=noise)
    return ekf(motion, _differentiated(Sensor, seen, seen.measure, seen.H, R=R), form="covariance")


def _differentiated(kind: Any, seen: Models, function: Any, jacobian: Any, **noise: Any) -> Any:
    """A `Motion` or `Sensor` of a function and its Jacobian, which is all of it where it is linear."""
    if seen.linear:
        return kind(Linear(partial(jacobian, np.zeros(6))), **noise)
    return kind(function, jacobian=jacobian, **noise)


def driving(config: Config) -> White:
    """The covariances of the driving noise, the paper's (inferred) choice."""
    return np.diag(config.process_std**2), np.diag(config.sigma_km**2)


def stationary(config: Config) -> White:
    """The covariances that the noises really have."""
    noise = noise_of(config)
    return noise.Q + noise.J @ noise.V @ noise.J.mT, noise.V


def two_stages(cases: Sequence[Config], runs: Runs, whites: Sequence[White], seen: Models | None = None) -> Filter:
    """TKF, whose first stage is EKF, of several cases with covariances of their own. ``seen``: other models."""
    seen = seen or models(cases[0])
    return TwoStage.of(Plain(kalman(seen, _of_all(whites, runs))), seen.Gamma, bias_prior(cases, runs))


def differencing(seen: Models, noise: Noise) -> Differenced:
    """The first stage of TDKF and TSTDKF."""
    return Differenced(seen.move, seen.measure, seen.H, noise)


def boosted(
    cases: Config | Sequence[Config],
    runs: Runs = 1,
    *,
    also_plain: bool = False,
    first: Differenced | None = None,
    seen: Models | None = None,
) -> Filter:
    """TSTDKF. With ``also_plain`` TDKF too: the filters lie along a leading axis, TDKF first.

    ``first``: another first stage. ``seen``: other models.
    """
    together = as_cases(cases)
    c = together[0]
    rho = _each(together, runs, "rho")
    if also_plain:
        rho = np.stack([np.zeros_like(rho), rho]).reshape(2, -1, 3)
    forms = np.array([case.factor == "proportional" for case in together])
    chosen = forms[:1] if len(together) == 1 else np.repeat(forms, runs)

    def factor(ratios: Array, weights: Array) -> Array:
        return np.where(chosen[:, None], proportional(ratios, weights), excess(ratios, weights))

    form = FORMS[c.factor] if (forms == forms[0]).all() else factor
    seen = seen or models(c)
    stage = first or differencing(seen, noises(together, runs))
    return TwoStage.of(stage, seen.Gamma, bias_prior(together, runs), boost=strong_tracking(rho, c.tau, factor=form))


def filters(cases: Config | Sequence[Config], runs: Runs = 1, seen: Models | None = None) -> dict[str, Any]:
    """The filters by name, for priors ``(all runs, 6)``; for one case of any batch shape. ``seen``: other models.

    ekf, tkf: ignorance and two stages, with the covariances of the driving noise; the first stage of tkf is ekf. ekf-fair,
    tkf-fair: the same with the stationary covariances. tdkf, tstdkf: two stages on differenced measurements, without and with
    strong tracking. aug: all noises and the bias among the states, exact. Beliefs of ekf are about ``(r, v)``, of aug about
    ``(r, v, V, Q, b)``, of the others about ``(r, v, b)``.
    """
    together = as_cases(cases)
    own, fair = [driving(case) for case in together], [stationary(case) for case in together]
    seen = seen or models(together[0])
    return {
        "ekf": kalman(seen, _of_all(own, runs)),
        "ekf-fair": kalman(seen, _of_all(fair, runs)),
        "tkf": two_stages(together, runs, own, seen),
        "tkf-fair": two_stages(together, runs, fair, seen),
        "tdkf": TwoStage.of(differencing(seen, noises(together, runs)), seen.Gamma, bias_prior(together, runs)),
        "tstdkf": boosted(together, runs, seen=seen),
        "aug": augmented(together, runs, seen=seen),
    }


def augmented(
    cases: Config | Sequence[Config], runs: Runs = 1, *, noise: Noise | None = None, seen: Models | None = None
) -> Filter:
    """The exact filter: 18 states ``(x, V, Q, b)``, the bias a random walk, and no noise left in the measurement.

    ``noise``: other noises than those of the cases. ``seen``: other models.

    In square-root form: after an update V is known from the rest, so the covariance is singular.
    """
    together = as_cases(cases)
    n, seen = noise or noises(together, runs), seen or models(together[0])
    move, JF, bias = seen.move, n.J @ n.F, bias_prior(together, runs)

    def f(x: Array, epoch: Epoch) -> Array:
        mean = x[0]
        moved = move(mean, epoch)
        V, Q, b = mean[..., 6:9], mean[..., 9:15], mean[..., 15:]
        rates = matvec(JF, V) + matvec(n.L, Q)
        return np.concatenate([moved.state + matvec(moved.G, rates), matvec(n.F, V), matvec(n.L, Q), b], -1)[None]

    walk = _each(together, runs, "walk_km")[..., None] * np.eye(3)
    color, steps, constant = block([[n.F, 0], [0, n.L]]), block([[np.sqrt(n.Xi), 0], [0, np.sqrt(n.E)]]), np.eye(3)
    into, through = side_by_side([JF, n.L]), side_by_side([n.J @ np.sqrt(n.Xi), np.sqrt(n.E)])

    def transition(x: Array, epoch: Epoch) -> Array:
        Phi, G = move(x, epoch)[1:]
        return block([[Phi, G @ into, 0], [0, color, 0], [0, 0, constant]])

    def columns(mean: Array, epoch: Epoch) -> Array:
        return block([[move(mean, epoch).G @ through, 0], [steps, 0], [0, walk]])

    def h(x: Array, epoch: Epoch) -> Array:
        return np.asarray(seen.measure(x, epoch) + x[..., 6:9] + matvec(seen.Gamma(x, epoch), x[..., 15:]))

    def jacobian(x: Array, epoch: Epoch) -> Array:
        Gamma = seen.Gamma(x, epoch)
        H = np.zeros((*Gamma.shape[:-1], 18))
        H[..., :3], H[..., 6:9], H[..., 15:] = Gamma, np.eye(3), Gamma
        return H

    motion = _differentiated(Motion, seen, f, transition, sqrt_Q=columns)
    exact = ekf(motion, _differentiated(Sensor, seen, h, jacobian, sqrt_R=np.zeros((3, 1))))

    def start(prior: Gaussian) -> State:
        batch = prior.mean.shape[:-1]
        mean = np.concatenate([prior.mean, np.zeros((*batch, 12))], -1)
        parts = [np.asarray(part) for part in (prior.cov, n.V, n.Q, bias.cov)]
        P = block([[part if i == j else 0 for j in range(4)] for i, part in enumerate(parts)])
        return exact.start(Gaussian(mean, P))

    return FromFunctions(start, exact.step)
