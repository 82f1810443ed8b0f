"""Robust and parity hooks follow their formulas for every rule and form, run by run, without
missing components.
"""

from __future__ import annotations

import numpy as np
import pytest

from celnav import Gaussian, Motion, Sensor, colored, epochs, run, sigma_point
from celnav.filters.adaptive import (
    channel_parity,
    correntropy,
    group_parity,
    huber,
    sage_husa,
    student_t,
    variational_bayes,
)
from celnav.gaussian.rules import Taylor, cubature, unscented

A = np.array([[1.0, 0.2], [-0.1, 0.9]])
H = np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 2.0], [1.0, -1.0], [2.0, 0.5], [0.3, 1.0]])
Q = np.array([[0.1, 0.02], [0.02, 0.05]])
R = np.diag([0.5, 0.4, 0.3, 0.2, 0.6, 0.7])
P0 = np.array([[1.0, 0.3], [0.3, 0.6]])
m, T = 6, 40
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
RULES = {
    "unscented": unscented,
    "cubature": cubature,
    "differences": Taylor(),
    "jacobians": Taylor(),
    "matrices": unscented,
}
EVERY_RULE = pytest.mark.parametrize("rule", RULES)
GROUPS = (range(3), range(3, 6))
HOOKS = {
    "huber": huber(),
    "student": student_t(4.0),
    "sage-husa": sage_husa(0.9),
    "group": group_parity(GROUPS, 1, deviations=1.0),
    "channel": channel_parity(4),
    "correntropy": correntropy(2.0),
    "variational": variational_bayes(0.9),
}
ALL = pytest.mark.parametrize("name", HOOKS)


def prior(*batch):
    return Gaussian(np.zeros((*batch, 2)), P0)


def filter_of(hook, rule="unscented", form="square root", F=A, C=H, noise=Q):
    """A linear model as a function, as a function with its Jacobian, or as a matrix."""
    jacobians = (
        {"f": lambda _x, _e: F, "h": lambda _x, _e: C}
        if rule == "jacobians"
        else {"f": None, "h": None}
    )
    f, h = (F, C) if rule == "matrices" else (lambda x, _e: x @ F.T, lambda x, _e: x @ C.T)
    motion, sensor = (
        Motion(f, noise, jacobian=jacobians["f"]),
        Sensor(h, R, jacobian=jacobians["h"]),
    )
    return sigma_point(motion, sensor, rule=RULES[rule], form=form, hooks=[hook])


def measured(*batch, seed=1):
    rng = np.random.default_rng(seed)
    x, z = rng.normal(size=(*batch, 2)) @ np.linalg.cholesky(P0).T, []
    for k in range(T):
        if k:
            x = x @ A.T + rng.normal(size=(*batch, 2)) @ np.linalg.cholesky(Q).T
        noise = rng.normal(size=(*batch, m)) * np.sqrt(R.diagonal())
        z.append(x @ H.T + noise * np.where((15 <= k < 25) & (np.arange(m) < 3), 12.0, 1.0))
    return np.array(z)


def kalman(z, inflate):
    """The textbook filter of one run; ``inflate(k, e, P, used) -> factors (m,)`` of the noise's
    variances.
    """
    x, P, means = np.zeros(2), P0, []
    for k, row in enumerate(z):
        if k:
            x, P = A @ x, A @ P @ A.T + Q
        e = row - H @ x
        used = ~np.isnan(e)
        if used.any():
            S = (H @ P @ H.T + R * inflate(k, e, P, used))[np.ix_(used, used)]
            K = np.linalg.solve(S, (H @ P)[used]).T
            x, P = x + K @ e[used], P - K @ (H @ P)[used]
        means.append(x)
    return np.array(means)


def reweighted(weight):
    def inflate(_k, e, P, used):
        factor = np.ones(m)
        Hu, eu, r = H[used], e[used], R.diagonal()[used]
        W = np.ones(used.sum())
        for _ in range(6):
            S = Hu @ P @ Hu.T + np.diag(r / W)
            fitted = Hu @ P @ Hu.T @ np.linalg.solve(S, eu)
            W = weight(np.abs(eu - fitted) / np.sqrt(r))
        factor[used] = 1.0 / W
        return factor

    return inflate


class Husa:
    def __init__(self, b=0.9):
        self.b, self.R, self.count = b, R.diagonal().copy(), np.zeros(m)

    def __call__(self, _k, e, P, used):
        for i in np.flatnonzero(used):
            d = (1 - self.b) / (1 - self.b ** (self.count[i] + 1))
            self.R[i] = (1 - d) * self.R[i] + d * max(e[i] ** 2 - H[i] @ P @ H[i], 0.01 * R[i, i])
            self.count[i] += 1
        return np.maximum(self.R, 0.25 * R.diagonal()) / R.diagonal()


class Variational:
    """The algorithm of Sarkka and Nummenmaa (2009) for the measured components."""

    def __init__(self, rho=0.9, N=3):
        self.rho, self.N, self.alpha, self.beta = rho, N, np.ones(m), R.diagonal().copy()

    def __call__(self, _k, e, P, used):
        Hu, alpha = H[used], self.rho * self.alpha[used] + 0.5
        beta_ahead = self.rho * self.beta[used]
        beta = beta_ahead.copy()
        for _ in range(self.N):
            noise = beta / alpha
            K = P @ Hu.T @ np.linalg.inv(Hu @ P @ Hu.T + np.diag(noise))
            x, after = K @ e[used], P - K @ Hu @ P
            for i in range(len(beta)):
                beta[i] = (
                    beta_ahead[i]
                    + 0.5 * (e[used][i] - Hu[i] @ x) ** 2
                    + 0.5 * Hu[i] @ after @ Hu[i]
                )
        self.alpha[used], self.beta[used] = alpha, beta
        factor = np.ones(m)
        factor[used] = noise / R.diagonal()[used]
        return factor


def residuals(e, used):
    Hu, W = H[used], np.diag(1.0 / R.diagonal()[used])
    fit = np.linalg.solve(Hu.T @ W @ Hu, Hu.T @ W)
    C = R[np.ix_(used, used)] - Hu @ np.linalg.solve(Hu.T @ W @ Hu, Hu.T)
    return e[used] - Hu @ fit @ e[used], C.diagonal()


def grouped(_k, e, _P, used):
    factor, r = np.ones(m), np.zeros(m)
    r[used] = residuals(e, used)[0]
    for group in GROUPS:
        members = [i for i in group if used[i]]
        spare = len(members) - 1
        if spare >= 2:
            s = sum(r[i] ** 2 / R[i, i] for i in members) / spare
            if s > 1.0 + np.sqrt(2.0 / spare):
                factor[list(group)] = s
    return factor


class Channels:
    def __init__(self, M=4):
        self.M, self.past = M, [[] for _ in range(m)]

    def __call__(self, _k, e, _P, used):
        r, C = residuals(e, used)
        squares = dict(zip(np.flatnonzero(used), r**2 / C, strict=True))
        factor = np.ones(m)
        for i in range(m):
            self.past[i] = [*self.past[i], squares[i]] if i in squares else []
            if len(self.past[i]) >= self.M:
                factor[i] = max(1.0, np.mean(self.past[i][-self.M :]))
        return factor


PLAIN = {
    "huber": lambda: reweighted(lambda u: np.minimum(1.0, 1.345 / u)),
    "student": lambda: reweighted(lambda u: 5.0 / (4.0 + u * u)),
    "sage-husa": Husa,
    "variational": Variational,
    "correntropy": lambda: reweighted(lambda u: np.exp(-u * u / 8.0)),
    "group": lambda: grouped,
    "channel": Channels,
}


@ALL
@EVERY_RULE
@FORMS
def test_hooks_follow_their_formulas(form, rule, name):
    z = measured()
    z[8, 2] = np.nan
    z[18, 0] = np.nan
    z[30, 3:5] = np.nan
    track = run(filter_of(HOOKS[name], rule, form), prior(), epochs(np.arange(T), z))
    np.testing.assert_allclose(track.mean, kalman(z, PLAIN[name]()), rtol=0, atol=1e-7)


@ALL
def test_runs_do_not_know_each_other(name):
    z = measured(3)
    z[12, 1] = np.nan
    z[22, 0, 1] = np.nan
    z[28] = np.nan
    batch = run(filter_of(HOOKS[name]), prior(3), epochs(np.arange(T), z))
    for i in range(3):
        alone = run(filter_of(HOOKS[name]), prior(), epochs(np.arange(T), z[:, i]))
        np.testing.assert_allclose(alone.mean, batch.mean[:, i], rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    "hook", [group_parity(GROUPS, 1), channel_parity(2)], ids=["group", "channel"]
)
def test_parity_does_not_see_what_a_state_explains(hook):
    """A jump of the state by a thousand standard deviations changes no weight: the gain is the
    same, so the estimates differ by the image of the jump.
    """
    z, jump = measured(), np.array([300.0, -200.0])
    jumped = z.copy()
    jumped[10:] += H @ jump
    one, two = (
        run(filter_of(hook), prior(), epochs(np.arange(T), data), keep="cov")
        for data in (z, jumped)
    )
    np.testing.assert_allclose(two.cov, one.cov, rtol=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    "hook", [group_parity(GROUPS, 1), channel_parity(2)], ids=["group", "channel"]
)
def test_parity_does_not_see_what_the_process_noise_explains(hook, sign):
    """For a state with an exact prior; in a filter for colored noise the noise columns follow the
    state columns.
    """
    z, jump = measured(), np.array([300.0, -200.0])
    jumped = z.copy()
    jumped[1:] += H @ jump
    motion = Motion(A, sqrt_Q=sign * np.sqrt(np.diag(Q.diagonal())))
    exact = Gaussian(np.zeros(2), np.zeros((2, 2)))
    one, two, plain = (
        run(
            colored(motion, Sensor(H, R), 0.5 * np.eye(m), hooks=hooks),
            exact,
            epochs(np.arange(T), data),
            keep="cov",
        ).cov
        for hooks, data in (([hook], z), ([hook], jumped), ([], z))
    )
    np.testing.assert_allclose(two, one, rtol=1e-6)
    assert not np.allclose(one, plain)


WIDE, BOTH = (
    np.concatenate([np.zeros((m, 1)), H], 1),
    np.block([[np.eye(1), np.zeros((1, 2))], [np.zeros((2, 1)), A]]),
)


@pytest.mark.parametrize(
    "hook",
    [group_parity((range(6),), 1, deviations=0.0), channel_parity(1)],
    ids=["group", "channel"],
)
@EVERY_RULE
@FORMS
def test_a_state_that_nothing_measures_takes_no_part(form, rule, hook):
    """Its column of H is 0 or round-off, and is the first: the other states are not affected."""
    z = measured()
    noise, cov = np.eye(3), np.eye(3)
    noise[1:, 1:], cov[1:, 1:] = Q, P0
    wide = filter_of(hook, rule, form, BOTH, WIDE, noise)
    mean = run(wide, Gaussian(np.zeros(3), cov), epochs(np.arange(T), z)).mean
    narrow = run(filter_of(hook, form=form), prior(), epochs(np.arange(T), z)).mean
    np.testing.assert_allclose(mean[:, 1:], narrow, rtol=0, atol=1e-6)


@ALL
def test_hooks_help_in_a_burst(name):
    z, left = measured(200), []
    for hook in (lambda memory, joint, _epoch: (memory, joint), HOOKS[name]):
        mean = run(filter_of(hook), prior(200), epochs(np.arange(T), z)).mean
        left.append(
            np.square(z[19:25, :, 3:] - mean[19:25] @ H[3:].T).mean()
        )  # sound components, once the windows are full
    assert left[1] < 0.8 * left[0]


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: huber(0.0), "threshold"),
        (lambda: huber(1.0, 0), "rounds"),
        (lambda: student_t(np.nan), "dof"),
        (lambda: sage_husa(1.0), "forgetting"),
        (lambda: sage_husa(0.9, 0.0), "least"),
        (lambda: group_parity((), 4), "groups"),
        (lambda: correntropy(0.0), "bandwidth"),
        (lambda: variational_bayes(0.0), "forgetting"),
        (lambda: variational_bayes(1.1), "forgetting"),
        (lambda: variational_bayes(0.9, 0.0), "samples"),
        (lambda: variational_bayes(0.9, rounds=0), "rounds"),
        (lambda: group_parity(([0, 1], [1, 2]), 4), "groups"),
        (lambda: group_parity(([0, 1],), 0), "unknowns"),
        (lambda: group_parity(([0, 1],), 1, deviations=-1.0), "deviations"),
        (lambda: channel_parity(0), "M"),
    ],
)
def test_bad_input_is_refused_by_name(make, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        make()


def test_groups_beyond_the_measurement_are_refused():
    with pytest.raises(ValueError, match=r"^groups: expected components below 6, got 7"):
        run(filter_of(group_parity(([0, 7],), 1)), prior(), epochs(np.arange(T), measured()))


def test_correntropy_ends_at_a_stationary_point():
    """For ``(x - x0)' P0^-1 (x - x0) / 2 - b^2 sum exp(-u^2 / (2 b^2))``, with outliers, the
    gradient is 0.
    """
    z, b = 3.0 * measured(50, seed=3)[0], 1.5
    z[:, 2] += 20.0
    z[7, 4] = np.nan
    x = run(filter_of(correntropy(b, 5000)), prior(50), epochs([0.0], z[None])).mean[0]
    u = np.nan_to_num((z - x @ H.T) / np.sqrt(R.diagonal()))
    gradient = x @ np.linalg.inv(P0) - (np.exp(-0.5 * (u / b) ** 2) * u / np.sqrt(R.diagonal())) @ H
    assert np.abs(u).max() > 10.0
    np.testing.assert_allclose(gradient, 0.0, atol=1e-6)


def test_correntropy_of_a_wide_kernel_is_the_plain_filter():
    z = measured()
    plain = run(
        filter_of(lambda memory, joint, _epoch: (memory, joint)), prior(), epochs(np.arange(T), z)
    ).mean
    wide = run(filter_of(correntropy(1e7)), prior(), epochs(np.arange(T), z)).mean
    np.testing.assert_allclose(wide, plain, rtol=0, atol=1e-10)


def bent(x, _epoch=None):
    """A measurement that is not linear."""
    return x @ H.T + 0.4 * np.sin(2.0 * x[..., :1])


def noises(hook, z, h=H):
    """Variances from a hook over the nominal variances, ``(T, runs, m)``, read by a second hook
    after it.
    """
    seen = []

    def look(memory, joint, _epoch):
        seen.append(joint.variances()[1] / R.diagonal())
        return memory, joint

    filter = sigma_point(Motion(A, Q), Sensor(h, R), rule=unscented, hooks=[hook, look])
    run(filter, prior(z.shape[1]), epochs(np.arange(len(z)), z))
    return np.array(seen)


def drawn(scale, runs=100, h=lambda x: x @ H.T):
    """Measurements whose noise has ``scale (T,)`` times the nominal variance."""
    rng = np.random.default_rng(8)
    x, z = rng.normal(size=(runs, 2)) @ np.linalg.cholesky(P0).T, []
    for k, factor in enumerate(scale):
        if k:
            x = x @ A.T + rng.normal(size=(runs, 2)) @ np.linalg.cholesky(Q).T
        z.append(h(x) + rng.normal(size=(runs, m)) * np.sqrt(factor * R.diagonal()))
    return np.array(z)


@pytest.mark.parametrize("true", [0.5, 1.0, 6.0])
def test_the_noise_is_found_and_followed(true):
    """Nominal noise, then ``true`` times its variance: seven time constants later the mean over the
    runs is correct within 10 %.

    That is five standard deviations of a mean over 100 runs.
    """
    found = noises(variational_bayes(0.98), drawn(np.where(np.arange(700) < 350, 1.0, true)))
    np.testing.assert_allclose(found[340:350].mean((0, 1)), 1.0, atol=0.1)
    np.testing.assert_allclose(found[690:].mean((0, 1)), true, rtol=0.1)


def test_the_noise_of_a_bent_measurement_is_found():
    found = noises(variational_bayes(0.98), drawn(np.full(350, 3.0), h=bent), bent)
    np.testing.assert_allclose(found[340:].mean((0, 1)), 3.0, rtol=0.1)


def test_a_constant_noise_is_learned_without_forgetting():
    """With a forgetting factor of 1 the estimate's scatter over the runs shrinks with the number of
    samples, and includes the truth.
    """
    found = noises(variational_bayes(1.0), drawn(np.full(400, 3.0)))
    assert (found[399].std(0) < 0.6 * found[99].std(0)).all()
    np.testing.assert_allclose(found[399].mean(0), 3.0, rtol=0.1)
