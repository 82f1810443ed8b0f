"""The filters that the paper and this study compare, for several cases at once (see `scenario`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from celnav.filters.model import Motion, Sensor
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


class Timings(NamedTuple):
    """The timings as filters see them, km, with the Earth where they believe it: ``(mean (..., 6 or more), epoch) -> array``."""

    measure: Callable[[Array, Epoch], Array]
    Gamma: Callable[[Array, Epoch], Array]

    def H(self, mean: Array, epoch: Epoch) -> Array:
        """``[Gamma 0]``."""
        Gamma = self.Gamma(mean, epoch)
        return np.concatenate([Gamma, np.zeros_like(Gamma)], -1)


def timings(config: Config) -> Timings:
    """``Gamma (..., m, 3)`` is the slope with respect to the position, and to an error of the Earth's."""
    timing = config.timing
    return Timings(
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


def kalman(config: Config, white: White, pulled: bool = False) -> Sequential:
    """An EKF that takes all noise for white."""
    Q, R = white
    motion, root, seen = Orbit(pulled), np.linalg.cholesky(Q), timings(config)

    def f(x: Array, epoch: Epoch) -> Array:
        return motion(x[0], epoch).state[None]

    def noise(mean: Array, epoch: Epoch) -> Array:
        return motion(mean, epoch).G @ root

    believed = Motion(f, sqrt_Q=noise, jacobian=lambda x, epoch: motion(x, epoch).Phi)
    return ekf(believed, Sensor(seen.measure, R, jacobian=seen.H), form="covariance")


def driving(config: Config) -> White:
    """The covariances of the driving noise, the paper's (inferred) choice."""
    return np.diag(config.process_std**2), np.diag(config.sigma_km**2)


def stationary(config: Config) -> White:
    """The covariances that the noises really have."""
    noise = noise_of(config)
    return noise.Q + noise.J @ noise.V @ noise.J.mT, noise.V


def two_stages(cases: Sequence[Config], runs: Runs, whites: Sequence[White], pulled: bool = False) -> Filter:
    """TKF, whose first stage is EKF, of several cases with covariances of their own."""
    first = Plain(kalman(cases[0], _of_all(whites, runs), pulled))
    return TwoStage.of(first, timings(cases[0]).Gamma, bias_prior(cases, runs))


def differencing(config: Config, noise: Noise) -> Differenced:
    """The first stage of TDKF and TSTDKF."""
    seen = timings(config)
    return Differenced(lambda mean, epoch: flow(mean, epoch.dt), seen.measure, seen.H, noise)


def boosted(
    cases: Config | Sequence[Config], runs: Runs = 1, *, also_plain: bool = False, first: Differenced | None = None
) -> Filter:
    """TSTDKF. With ``also_plain`` TDKF too: the filters lie along a leading axis, TDKF first. ``first``: another first stage."""
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
    stage = first or differencing(c, noises(together, runs))
    return TwoStage.of(stage, timings(c).Gamma, bias_prior(together, runs), boost=strong_tracking(rho, c.tau, factor=form))


def filters(cases: Config | Sequence[Config], runs: Runs = 1) -> dict[str, Filter]:
    """The filters by name, for priors ``(all runs, 6)``; for one case of any batch shape.

    ekf, tkf: ignorance and two stages, with the covariances of the driving noise; the first stage of tkf is ekf. ekf-fair,
    tkf-fair: the same with the stationary covariances. tdkf, tstdkf: two stages on differenced measurements, without and with
    strong tracking. aug: all noises and the bias among the states, exact. Beliefs of ekf are about ``(r, v)``, of aug about
    ``(r, v, V, Q, b)``, of the others about ``(r, v, b)``.
    """
    together = as_cases(cases)
    c, own, fair = together[0], [driving(case) for case in together], [stationary(case) for case in together]
    return {
        "ekf": kalman(c, _of_all(own, runs)),
        "ekf-fair": kalman(c, _of_all(fair, runs)),
        "tkf": two_stages(together, runs, own),
        "tkf-fair": two_stages(together, runs, fair),
        "tdkf": TwoStage.of(differencing(c, noises(together, runs)), timings(c).Gamma, bias_prior(together, runs)),
        "tstdkf": boosted(together, runs),
        "aug": augmented(together, runs),
    }


def augmented(cases: Config | Sequence[Config], runs: Runs = 1, *, noise: Noise | None = None) -> Filter:
    """The exact filter: 18 states ``(x, V, Q, b)``, the bias a random walk, and no noise left in the measurement.

    ``noise``: other noises than those of the cases.

    In square-root form: after an update V is known from the rest, so the covariance is singular.
    """
    together = as_cases(cases)
    n, seen = noise or noises(together, runs), timings(together[0])
    motion, JF, bias = Orbit(), n.J @ n.F, bias_prior(together, runs)

    def f(x: Array, epoch: Epoch) -> Array:
        mean = x[0]
        moved = motion(mean, epoch)
        V, Q, b = mean[..., 6:9], mean[..., 9:15], mean[..., 15:]
        rates = matvec(JF, V) + matvec(n.L, Q)
        return np.concatenate([moved.state + matvec(moved.G, rates), matvec(n.F, V), matvec(n.L, Q), b], -1)[None]

    walk = _each(together, runs, "walk_km")[..., None] * np.eye(3)
    fixed = block([[np.eye(6), 0, 0, 0], [0, n.F, 0, 0], [0, 0, n.L, 0], [0, 0, 0, np.eye(3)]])
    driving = block([[np.zeros((6, 3)), 0, 0], [np.sqrt(n.Xi), 0, 0], [0, np.sqrt(n.E), 0], [0, 0, walk]])
    into, through = side_by_side([JF, n.L]), side_by_side([n.J @ np.sqrt(n.Xi), np.sqrt(n.E)])

    def transition(x: Array, epoch: Epoch) -> Array:
        Phi, G = motion(x, epoch)[1:]
        A = np.broadcast_to(fixed, (*Phi.shape[:-2], 18, 18)).copy()
        A[..., :6, :6], A[..., :6, 6:15] = Phi, G @ into
        return A

    def columns(mean: Array, epoch: Epoch) -> Array:
        G = motion(mean, epoch).G
        B = np.broadcast_to(driving, (*G.shape[:-2], 18, 12)).copy()
        B[..., :6, :9] = G @ through
        return B

    def h(x: Array, epoch: Epoch) -> Array:
        return np.asarray(seen.measure(x, epoch) + x[..., 6:9] + matvec(seen.Gamma(x, epoch), x[..., 15:]))

    def jacobian(x: Array, epoch: Epoch) -> Array:
        Gamma = seen.Gamma(x, epoch)
        rest = np.broadcast_to(np.hstack([np.zeros((3, 3)), np.eye(3), np.zeros((3, 6))]), (*Gamma.shape[:-1], 12))
        return np.concatenate([Gamma, rest, Gamma], -1)

    exact = ekf(Motion(f, sqrt_Q=columns, jacobian=transition), Sensor(h, sqrt_R=np.zeros((3, 1)), jacobian=jacobian))

    def start(prior: Gaussian) -> State:
        batch = prior.mean.shape[:-1]
        mean = np.concatenate([prior.mean, np.zeros((*batch, 12))], -1)
        parts = [np.asarray(part) for part in (prior.cov, n.V, n.Q, bias.cov)]
        P = block([[part if i == j else 0 for j in range(4)] for i, part in enumerate(parts)])
        return exact.start(Gaussian(mean, np.broadcast_to(P, (*batch, 18, 18))))

    return FromFunctions(start, exact.step)
