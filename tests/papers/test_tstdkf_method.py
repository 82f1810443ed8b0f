"""The differenced stage: the cases in which it is exact, its algebra in joint form, the effect of a
bias, and its boosts.
"""

from __future__ import annotations

import numpy as np
import pytest

from celnav import Epoch, Gaussian, Motion, Sensor, two_stage, ukf
from celnav.filters.sequential import SingleDraw
from celnav.filters.two_stage import Boost, TwoStage
from celnav.models.noise import ar1_noise
from celnav.papers.tstdkf.method import LARGEST, Differenced, strong_tracking

RNG = np.random.default_rng(0)
T, N, M, B = 30, 4, 2, 3
PHI = 0.95 * np.linalg.qr(RNG.normal(size=(N, N)))[0]
G, H = RNG.normal(size=(N, N)), RNG.normal(size=(M, N))
XI, E = np.diag([0.5, 1.0]), 0.1 * np.diag([1.0, 0.5, 2.0, 0.3])
J = 0.2 * RNG.normal(size=(N, M))
GAMMA = RNG.normal(size=(M, B))
P0 = 2.0 * np.eye(N)


BIAS = Gaussian(np.zeros(B), np.eye(B))
WHITE = Motion(lambda x, _epoch: x @ PHI.T, G @ E @ G.T), Sensor(H, XI)


def differenced(noise):
    return Differenced(
        lambda x, _epoch: (x @ PHI.T, PHI, G),
        lambda x, _epoch: x @ H.T,
        lambda _x, _epoch: H,
        noise,
    )


def stage(F=0.0, L=0.0, coupling=0.0):
    noise = ar1_noise(F * np.eye(M), L * np.eye(N), coupling * J, XI, E)
    return noise, differenced(noise)


def measured(runs=2, seed=1):
    return 2.0 * np.random.default_rng(seed).normal(size=(T, runs, M))


def prior(runs=2):
    return Gaussian(np.zeros((runs, N)), np.tile(P0, (runs, 1, 1)))


def at(k, z):
    """The k-th epoch of measurements ``(T, runs, m)``."""
    return Epoch(k, k + 1.0, 1.0, None, z[k])


def alone(first, z):
    """Means and covariances of a first stage without a second."""
    state, out = first.start(prior(runs=z.shape[1])), []
    for k in range(T):
        state, _ = first.predict(state, at(k, z))
        state, _, _ = first.update(state, at(k, z))
        out.append((state.belief.mean, state.belief.cov))
    return tuple(np.stack(values) for values in zip(*out, strict=True))


def followed(filter, z):
    state, out = filter.start(prior(runs=z.shape[1])), []
    for k in range(T):
        state, _ = filter.step(state, at(k, z))
        out.append((state.belief.mean, state.belief.cov))
    return tuple(np.stack(values) for values in zip(*out, strict=True))


def test_without_color_it_is_the_kalman_filter():
    z = measured()
    for a, b in zip(alone(stage()[1], z), followed(ukf(*WHITE), z), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-11)


@pytest.mark.parametrize("coupling", [0.1, 1.0, 10.0])
def test_white_noise_that_is_correlated_is_exact(coupling):
    z = measured()
    noise, first = stage(coupling=coupling)
    # w = G (J v + e) and v, from one draw of (v, e).
    both = np.block([[np.sqrt(XI), np.zeros((M, N))], [np.zeros((N, M)), np.sqrt(E)]])

    def f(x, _epoch, w):
        return x @ PHI.T + (w[..., :M] @ noise.J.T + w[..., M:]) @ G.T

    def h(x, _epoch, w):
        return x @ H.T + w[..., :M]

    exact = SingleDraw.of(ukf(Motion(f, augment=(both,)), Sensor(h, np.zeros((M, M)))))
    for a, b in zip(alone(first, z), followed(exact, z), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize(
    ("F", "L", "coupling"), [(0.5, 0.5, 1.0), (0.8, 0.0, 0.5), (0.0, 0.9, 0.0), (0.5, 0.5, 0.0)]
)
def test_its_covariances_are_those_of_a_consider_filter(F, L, coupling):
    """The joint covariance of (x, V, Q), with a gain that does not change V and Q, gives the same
    numbers without that algebra.
    """
    noise, first = stage(F, L, coupling)
    n, m, q = N, M, N
    joint = np.zeros((n + m + q, n + m + q))
    joint[:n, :n], joint[n : n + m, n : n + m], joint[n + m :, n + m :] = P0, noise.V, noise.Q
    JF, z = noise.J @ noise.F, measured(runs=1)
    state = first.start(prior(runs=1))
    for k in range(8):
        state, _ = first.predict(state, at(k, z))
        state, seen, _ = first.update(state, at(k, z))
        Omega, K = seen.Omega, seen.gain[0]
        D = np.eye(n) - Omega @ H
        sensor = noise.V if k == 0 else noise.Xi
        # (x, V, Q)' = A (x, V, Q) + noise (xi, e); V' and Q' as the model has them. Omega takes all
        # of J V' out of x' where the
        # measurement is not differenced (k = 0), else J xi.
        A = np.block(
            [
                [D @ PHI, D @ G @ JF * (k > 0), D @ G @ noise.L],
                [np.zeros((m, n)), noise.F, np.zeros((m, q))],
                [np.zeros((q, n + m)), noise.L],
            ]
        )
        W = np.block(
            [
                [np.zeros((n, m)), D @ G],
                [np.eye(m), np.zeros((m, q))],
                [np.zeros((q, m)), np.eye(q)],
            ]
        )
        S = np.block([[noise.Xi, np.zeros((m, q))], [np.zeros((q, m)), noise.E]])
        moved = A @ joint @ A.T + W @ S @ W.T
        # The residual is H x + xi (k = 0: + V), and xi is part of V'.
        with_xi = np.vstack([np.zeros((n, m)), sensor, np.zeros((q, m))])
        gain = np.vstack([K, np.zeros((m + q, m))])
        R = np.hstack([H, np.zeros((m, m + q))])
        left = np.eye(n + m + q) - gain @ R
        joint = (
            left @ moved @ left.T
            + gain @ sensor @ gain.T
            - left @ with_xi @ gain.T
            - gain @ with_xi.T @ left.T
        )
        np.testing.assert_allclose(state.belief.cov[0], joint[:n, :n], atol=1e-10)
        np.testing.assert_allclose(
            state.cross[0], np.hstack([joint[:n, n + m :], joint[:n, n : n + m]]), atol=1e-10
        )


@pytest.mark.parametrize(
    ("F", "L", "coupling"), [(0.5, 0.5, 1.0), (0.8, 0.3, 0.5), (0.0, 0.9, 2.0)]
)
def test_conditioning_is_the_filter_that_is_written_out(F, L, coupling):
    """Also the gain, without a joint belief: correlations of the estimate with Q and V from
    separate recursions.
    """
    noise, first = stage(F, L, coupling)
    z, mean, P, DQ, DV = measured(runs=1)[:, 0], np.zeros(N), P0, np.zeros((N, N)), np.zeros((N, M))
    found, last = alone(first, z[:, None]), np.zeros(M)
    for k in range(T):
        color, sensor = (noise.F, noise.Xi) if k else (0.0 * noise.F, noise.V)
        y = z[k] - H @ PHI @ mean - color @ last
        Omega = G @ noise.J @ np.linalg.inv(np.eye(M) + H @ G @ noise.J)
        D, JF = np.eye(N) - Omega @ H, noise.J @ color
        A, B = D @ PHI, D @ G
        cross = A @ (DQ @ noise.L + DV @ JF.T) @ B.T
        P = A @ P @ A.T + B @ (noise.Q + JF @ noise.V @ JF.T) @ B.T + cross + cross.T
        DQ, DV = A @ DQ @ noise.L + B @ noise.Q, A @ DV @ color + B @ JF @ noise.V @ color
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + sensor)
        mean = PHI @ mean + Omega @ y + K @ (y - H @ Omega @ y)
        left = np.eye(N) - K @ H
        P, DQ, DV, last = left @ P, left @ DQ, left @ DV - K @ sensor, z[k] - H @ mean
        np.testing.assert_allclose(found[0][k, 0], mean, atol=1e-9)
        np.testing.assert_allclose(found[1][k, 0], P, atol=1e-9)


@pytest.mark.parametrize(("F", "L"), [(0.8, 0.0), (0.5, 0.9), (-0.9, 0.5)])
def test_the_first_measurement_is_exact(F, L):
    """By conditioning the complete joint of (x, V, Q), for any correlation of the noises."""
    noise, first = stage(F, L, coupling=5.0)
    W = np.hstack([PHI, G @ noise.J, G])  # x' of (x, V', Q')
    C = np.zeros((2 * N + M, 2 * N + M))
    C[:N, :N], C[N : N + M, N : N + M], C[N + M :, N + M :] = P0, noise.V, noise.Q
    seen = H @ W + np.eye(M, 2 * N + M, N)
    K = np.linalg.solve(seen @ C @ seen.T, seen @ C).T
    left = C - K @ seen @ C
    z = measured()
    state, _ = first.predict(first.start(prior()), at(0, z))
    state, stage_, info = first.update(state, at(0, z))
    np.testing.assert_allclose(state.belief.mean, z[0] @ (W @ K).T, atol=1e-12)
    np.testing.assert_allclose(state.belief.cov[0], W @ left @ W.T, atol=1e-12)
    np.testing.assert_allclose(
        state.cross[0], np.hstack([(W @ left)[:, N + M :], (W @ left)[:, N : N + M]]), atol=1e-12
    )
    # The innovation is a linear function of z, so its density follows from the density of z: D z, D
    # = I - H Omega.
    D = np.eye(M) - H @ stage_.Omega
    np.testing.assert_allclose(info.innovation, z[0] @ D.T, atol=1e-12)
    np.testing.assert_allclose(
        info.sqrt_S[0] @ info.sqrt_S[0].T, D @ seen @ C @ seen.T @ D.T, atol=1e-10
    )


def test_the_first_variance_is_that_of_samples():
    """One state, F = 0.8: the true variance is 0.60, not the predicted 1.21."""
    one, runs = np.eye(1), 40_000
    noise = ar1_noise(0.8 * one, 0.0 * one, 2.0 * one, 0.36 * one, 0.5 * one)
    first = Differenced(
        lambda x, _e: (0.9 * x, 0.9 * one, one),
        lambda x, _e: 0.7 * x,
        lambda _x, _e: 0.7 * one,
        noise,
    )
    rng = np.random.default_rng(3)
    x, v, q = (
        std * rng.normal(size=(runs, 1))
        for std in (1.0, noise.V[0, 0] ** 0.5, noise.Q[0, 0] ** 0.5)
    )
    x = 0.9 * x + 2.0 * v + q
    epoch = Epoch(0, 1.0, 1.0, None, 0.7 * x + v)
    state, _ = first.predict(first.start(Gaussian(np.zeros((runs, 1)), one)), epoch)
    state, _, info = first.update(state, epoch)
    assert np.mean((state.belief.mean - x) ** 2 / state.belief.cov[..., 0]) == pytest.approx(
        1.0, abs=4.0 * (2.0 / runs) ** 0.5
    )
    assert np.mean(info.nis) == pytest.approx(1.0, abs=4.0 * (2.0 / runs) ** 0.5)


def test_a_lost_run_does_not_begin_its_neighbors_anew():
    z, (_, first) = measured(), stage(0.5, 0.5, 1.0)
    begun = first.start(prior())
    state = begun._replace(belief=begun.belief._replace(mean=begun.belief.mean * [[np.nan], [1.0]]))
    for k in range(3):
        state, _ = first.predict(state, at(k, z))
        state, _, _ = first.update(state, at(k, z))
    mean, cov = alone(first, z[:, 1:])
    np.testing.assert_allclose(state.belief.mean[1], mean[2, 0], atol=1e-12)
    np.testing.assert_allclose(state.belief.cov[1], cov[2, 0], atol=1e-12)


def test_process_noise_of_one_color_is_nearly_exact():
    """Compared with the filter that has Q in its state; neglecting the
    correlation loses much more.
    """
    z, L = measured(runs=1), 0.9
    noise, first = stage(L=L)
    A = np.block([[PHI, G * L], [np.zeros((N, N)), L * np.eye(N)]])
    columns = np.vstack([G, np.eye(N)]) @ np.sqrt(noise.E)
    exact = ukf(
        Motion(lambda x, _epoch: x @ A.T, sqrt_Q=columns),
        Sensor(np.hstack([H, np.zeros((M, N))]), XI),
    )
    both = np.block([[P0, np.zeros((N, N))], [np.zeros((N, N)), noise.Q]])
    state = exact.start(Gaussian(np.zeros((1, 2 * N)), both[None]))
    for k in range(T):
        state, _ = exact.step(state, at(k, z))
    (_, kept), (_, dropped) = (alone(one, z) for one in (first, Forgetful(**vars(first))))
    best, kept, dropped = (
        np.trace(P) for P in (state.belief.cov[0, :N, :N], kept[-1, 0], dropped[-1, 0])
    )
    assert kept >= best * (1.0 - 1e-9)  # no filter of these measurements can do better
    assert dropped < best  # and no filter can predict it
    assert abs(kept - best) < abs(dropped - best)


class Forgetful(Differenced):
    """The stage without the correlation with the process noise."""

    def update(self, state, epoch):
        state, seen, info = super().update(state, epoch)
        return (
            state._replace(cross=np.hstack([np.zeros((N, N)), state.cross[0, :, N:]])[None]),
            seen,
            info,
        )


def test_the_sensitivity_to_a_bias_is_the_derivative():
    _, first = stage(0.5, 0.5, 1.0)
    filter = TwoStage.of(first, GAMMA, BIAS)
    z, unit = measured(runs=1), np.array([0.7, -1.3, 0.4])
    one, two = filter.start(prior(runs=1)), filter.start(prior(runs=1))
    for k in range(T):
        one, _ = filter.step(one, at(k, z))
        two, _ = filter.step(two, at(k, z + GAMMA @ unit))
        np.testing.assert_allclose(
            two.first.belief.mean - one.first.belief.mean, -(one.Lambda @ unit), atol=1e-12
        )


def test_two_stages_on_white_noise_are_those_on_the_plain_stage():
    z, ordinary = measured(), two_stage(*WHITE, GAMMA, BIAS, form="covariance")
    one, two = (followed(filter, z) for filter in (ordinary, TwoStage.of(stage()[1], GAMMA, BIAS)))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-10)


def test_batches_are_singles():
    z, (_, first) = measured(), stage(0.5, 0.5, 1.0)
    many, one = alone(first, z), alone(first, z[:, 1:])
    np.testing.assert_allclose(many[0][:, 1], one[0][:, 0], rtol=1e-12, atol=1e-12)


def seen(residual, covariance):
    return Boost(
        np.asarray(residual),
        np.asarray(covariance),
        2.0 * np.asarray(residual),
        0.5 * np.asarray(covariance),
    )


def test_factors_compare_a_window_of_residuals_with_their_variances():
    boost = strong_tracking([8.0, 15.0], 2.0)
    residuals = np.array([[1.0, 2.0], [3.0, 0.0], [0.0, 4.0]])
    S = np.diag([2.0, 4.0])
    memory, squares = None, np.zeros(2)
    for k, residual in enumerate(residuals, start=1):
        memory, factors = boost(memory, seen(residual, S))
        squares = squares + (residual**2 - squares) / min(k, 2)
        expected = np.maximum(1.0, 1.0 + np.array([8.0, 15.0]) * (squares / [2.0, 4.0] - 1.0))
        np.testing.assert_allclose(factors, expected)
    assert memory.length == 3


def test_of_consistent_white_residuals_form_c_tends_to_one_and_form_b_to_rho():
    """After a step of their variance the estimate follows 1 - (1 - 1 / tau)^j; the first tau epochs
    use the plain mean.
    """
    residuals, made = np.random.default_rng(4).standard_normal((4000, 2)), {}
    for form in (False, True):
        boost, memory = strong_tracking([8.0, 0.5], 4000.0, proportional=form), None
        for residual in residuals:
            memory, made[form] = boost(memory, seen(residual, np.eye(2)))
        np.testing.assert_allclose(memory.squares, np.square(residuals).mean(0), rtol=1e-9)
    np.testing.assert_allclose(made[False], 1.0, atol=8.0 * 4.0 * np.sqrt(2.0 / 4000.0))
    np.testing.assert_allclose(made[True], [8.0, 1.0], atol=8.0 * 4.0 * np.sqrt(2.0 / 4000.0))
    boost, memory = strong_tracking([1.0], [[5.0], [20.0]]), None
    for k in range(60):
        memory, _ = boost(memory, seen(np.full((2, 1), 1.0 + (k >= 40)), np.eye(1)))
    np.testing.assert_allclose(
        memory.squares[:, 0], 1.0 + 3.0 * (1.0 - (1.0 - 1.0 / np.array([5.0, 20.0])) ** 20)
    )


def test_forms_of_the_factor():
    S, residual = np.diag([1.0, 1.0]), np.array([2.0, 0.5])
    _, c = strong_tracking([8.0, 15.0], 100.0)(None, seen(residual, S))
    _, b = strong_tracking([8.0, 15.0], 100.0, proportional=True)(None, seen(residual, S))
    np.testing.assert_allclose(c, [25.0, 1.0])
    np.testing.assert_allclose(b, [32.0, 3.75])
    _, off = strong_tracking([0.0, 0.0], 1.0, proportional=True)(None, seen(residual, S))
    np.testing.assert_array_equal(off, 1.0)


@pytest.mark.parametrize("residual", [0.0, np.nan, np.inf, 1e200])
def test_factors_stay_between_one_and_the_largest(residual):
    with np.errstate(over="ignore", invalid="ignore"):
        _, factors = strong_tracking([8.0], 10.0)(None, seen([residual], [[1.0]]))
    assert 1.0 <= factors[0] <= LARGEST


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: ar1_noise(np.eye(M), np.zeros((N, N)), J, XI, E), "F"),
        (lambda: ar1_noise(np.zeros((M, M)), 1.5 * np.eye(N), J, XI, E), "L"),
        (lambda: ar1_noise(np.full((M, M), 0.1), np.zeros((N, N)), J, XI, E), "F"),
        (lambda: ar1_noise(np.zeros((M, M)), np.zeros((N, N)), J.T, XI, E), "J"),
        (lambda: ar1_noise(np.zeros((M, M)), np.zeros((N, N)), J, 0.0 * XI, E), "Xi"),
        (lambda: ar1_noise(np.zeros((M, M)), np.zeros((N, N)), J, XI, -E), "E"),
        (lambda: strong_tracking([-1.0], 10.0), "rho"),
        (lambda: strong_tracking(3.0, 10.0), "rho"),
        (lambda: strong_tracking([np.nan], 10.0), "rho"),
        (lambda: strong_tracking([1.0], 0.5), "tau"),
        (lambda: strong_tracking([1.0], np.inf), "tau"),
        (lambda: strong_tracking([1.0], 5.0)(None, seen([1.0, 2.0], np.eye(2))), "rho"),
    ],
)
def test_bad_input_is_refused_by_name(make, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        make()


def test_a_measurement_missing_in_part_and_a_singular_coupling_are_refused():
    _, first = stage(0.5)
    epoch = at(0, np.array([[[np.nan, 1.0], [1.0, 1.0]]]))
    state, _ = first.predict(first.start(prior()), epoch)
    with pytest.raises(ValueError, match=r"^z: expected a complete measurement"):
        first.update(state, epoch)
    singular = -np.linalg.pinv(H @ G)
    bad = differenced(ar1_noise(np.zeros((M, M)), np.zeros((N, N)), singular, XI, E))
    epoch = epoch._replace(z=np.zeros((2, M)))
    state, _ = bad.predict(bad.start(prior()), epoch)
    with pytest.raises(ValueError, match=r"^J: expected"):
        bad.update(state, epoch)
