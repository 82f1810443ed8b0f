"""Filters against the Kalman filter, filterpy, and the joint Gaussian of all variables, written out
here.
"""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import (
    JulierSigmaPoints,
    MerweScaledSigmaPoints,
    SimplexSigmaPoints,
    UnscentedKalmanFilter,
)

import celnav
from celnav.filters.adaptive import gate
from celnav.filters.colored import decorrelation
from celnav.models import orbit

FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
RULES = {
    "unscented": celnav.unscented(4),
    "negative center": celnav.unscented(4, 0.5, 2.0, -1.0),
    "small alpha": celnav.unscented(4, 1e-3, 2.0, 0.0),
    "simplex": celnav.simplex(4),
    "cubature 3": celnav.cubature(4),
    "cubature 5": celnav.cubature(4, 5),
    "gauss-hermite": celnav.gauss_hermite(4, 3),
    "taylor": celnav.Taylor(),
}


def linear(seed=1, n=4, m=2):
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(m, m))
    return {
        "A": np.eye(n) + 0.1 * rng.normal(size=(n, n)),
        "H": rng.normal(size=(m, n)),
        "Q": np.diag([0.1, 0.2, 0.0, 0.3][:n]) ** 2,
        "R": half @ half.T + 0.1 * np.eye(m),
        "z": rng.normal(size=(20, m)),
    }


def sensor(s, matrix=True):
    return celnav.Sensor(s["H"] if matrix else lambda x, epoch: x @ s["H"].T, s["R"])


def motion(s, matrix=False):
    return celnav.Motion(s["A"] if matrix else lambda x, epoch: x @ s["A"].T, s["Q"])


def kalman(s, x, P, missing=()):
    means, covs = [], []
    for k, z in enumerate(s["z"]):
        if k:
            x, P = s["A"] @ x, s["A"] @ P @ s["A"].T + s["Q"]
        rows = [i for i in range(len(z)) if (k, i) not in missing]
        if rows:
            H, R = s["H"][rows], s["R"][np.ix_(rows, rows)]
            S = H @ P @ H.T + R
            K = np.linalg.solve(S, H @ P).T
            x, P = x + K @ (z[rows] - H @ x), P - K @ S @ K.T
        means.append(x)
        covs.append(P)
    return np.array(means), np.array(covs)


MATRICES = pytest.mark.parametrize(
    ("f", "h"), [(True, True), (False, True), (False, False)], ids=["f and h", "h", "none"]
)


@FORMS
@pytest.mark.parametrize("rule", RULES)
@MATRICES
def test_every_rule_is_the_kalman_filter_in_the_linear_case(form, rule, f, h):
    s = linear()
    filter = celnav.sigma_point(motion(s, f), sensor(s, h), rule=RULES[rule], form=form)
    track = celnav.run(
        filter, celnav.Gaussian(np.ones(4), np.eye(4)), np.arange(20.0), s["z"], keep="cov"
    )
    means, covs = kalman(s, np.ones(4), np.eye(4))
    tolerance = 1e-6 if rule in ("small alpha", "taylor") else 1e-9
    np.testing.assert_allclose(track.mean, means, atol=tolerance)
    np.testing.assert_allclose(track.cov, covs, atol=tolerance)


@FORMS
@MATRICES
def test_missing_components_are_marginalized_in_each_run_by_itself(form, f, h):
    s = linear()
    z = np.repeat(s["z"][:, None], 3, 1)
    gaps = [(), {(3, 0), (7, 1)}, {(4, 0), (4, 1), (0, 0)}]
    for run, missing in enumerate(gaps):
        for k, i in missing:
            z[k, run, i] = np.nan
    filter = celnav.ukf(motion(s, f), sensor(s, h), form=form)
    track = celnav.run(
        filter, celnav.Gaussian(np.ones((3, 4)), np.eye(4)), np.arange(20.0), z, keep="cov"
    )
    for run, missing in enumerate(gaps):
        means, covs = kalman(s, np.ones(4), np.eye(4), missing)
        np.testing.assert_allclose(track.mean[:, run], means, atol=1e-10)
        np.testing.assert_allclose(track.cov[:, run], covs, atol=1e-10)
    np.testing.assert_array_equal(track.events["missing"], [0, 2, 3])


def test_the_log_likelihood_is_the_density_of_all_measurements():
    from scipy.stats import multivariate_normal

    s = linear()
    track = celnav.run(
        celnav.ukf(motion(s), sensor(s)),
        celnav.Gaussian(np.zeros(4), np.eye(4)),
        np.arange(20.0),
        s["z"],
    )
    X = joint_states(s, np.eye(4))
    big = np.kron(np.eye(20), s["H"])
    cov = big @ X @ big.T + np.kron(np.eye(20), s["R"])
    np.testing.assert_allclose(
        track.log_likelihood,
        multivariate_normal(np.zeros(40), cov).logpdf(s["z"].ravel()),
        rtol=1e-10,
    )


def joint_states(s, P0):
    """Covariance of all states, block by block."""
    N, n = len(s["z"]), len(P0)
    diagonal = [P0]
    for _ in range(N - 1):
        diagonal.append(s["A"] @ diagonal[-1] @ s["A"].T + s["Q"])
    X = np.zeros((N * n, N * n))
    for i in range(N):
        for j in range(i + 1):
            block = np.linalg.matrix_power(s["A"], i - j) @ diagonal[j]
            X[n * i : n * i + n, n * j : n * j + n] = block
            X[n * j : n * j + n, n * i : n * i + n] = block.T
    return X


def spectral(matrix, radius):
    return matrix * (radius / np.abs(np.linalg.eigvals(matrix)).max())


@FORMS
@pytest.mark.parametrize("radius", [0.7, 1.0])
@pytest.mark.parametrize("known", [True, False])
def test_colored_filters_are_batch_conditioning_for_a_full_coefficient(form, radius, known):
    s = linear(3)
    m, n, N = 2, 4, 12
    s["z"] = s["z"][:N]
    Phi = spectral(np.random.default_rng(5).normal(size=(m, m)), radius)
    Sigma0 = 0.5 * np.eye(m) + 0.1 if known else None
    seen = celnav.Sensor(s["H"], Sigma0 if known else s["R"])
    options = {"increments": s["R"], "first": known, "form": form}
    given = celnav.Gaussian(np.zeros(n), np.eye(n)), np.arange(float(N)), s["z"]
    single = celnav.run(celnav.colored(motion(s), seen, Phi, **options), *given, keep="cov")
    lagged = {
        "also": lambda epoch, state, infos: {"mean": state.lagged.mean, "cov": state.lagged.cov}
    }
    paper = celnav.run(
        celnav.decorrelated(motion(s), seen, Phi, **options), *given, keep="cov", **lagged
    )
    # All variables are linear in (states, V_0, zetas): condition on z, or only on differences if
    # V_0 is unknown.
    noise = np.zeros((N * m, N * m))
    V = [Sigma0 if known else np.zeros((m, m))]
    for _ in range(N - 1):
        V.append(Phi @ V[-1] @ Phi.T + s["R"])
    for i in range(N):
        for j in range(i + 1):
            block = np.linalg.matrix_power(Phi, i - j) @ V[j]
            noise[m * i : m * i + m, m * j : m * j + m] = block
            noise[m * j : m * j + m, m * i : m * i + m] = block.T
    X, big = joint_states(s, np.eye(n)), np.kron(np.eye(N), s["H"])
    whiten = np.eye(N * m) - np.kron(np.eye(N, k=-1), Phi)
    if not known:
        whiten = whiten[m:]
    for k in range(0 if known else 1, N):
        for track, at, last in ((single, "mean", k), (paper, "mean", k), (paper, "lagged", k)):
            if at == "lagged" and k == 0:
                continue
            state = k - (at == "lagged")
            rows = slice(0, (last + (1 if known else 0)) * m)
            D = (whiten @ big)[rows]
            S = D @ X @ D.T + (whiten @ noise @ whiten.T)[rows, rows]
            cross = X[n * state : n * state + n] @ D.T
            K = np.linalg.solve(S, cross.T).T
            mean = K @ (whiten @ s["z"].ravel())[rows]
            cov = X[n * state : n * state + n, n * state : n * state + n] - K @ S @ K.T
            ours = (
                (track.extra["mean"][k], track.extra["cov"][k])
                if at == "lagged"
                else (track.mean[k], track.cov[k])
            )
            np.testing.assert_allclose(ours[0], mean, atol=1e-8)
            np.testing.assert_allclose(ours[1], cov, atol=1e-8)


@FORMS
def test_a_coefficient_for_each_run_and_one_that_is_a_function_of_time(form):
    s = linear(3)
    Phi = np.stack([spectral(np.random.default_rng(i).normal(size=(2, 2)), 0.8) for i in range(3)])
    options = {"increments": s["R"], "first": False, "form": form}
    for make in (celnav.colored, celnav.decorrelated):
        filter = make(motion(s), sensor(s), Phi, **options)
        together = celnav.run(
            filter, celnav.Gaussian(np.zeros((3, 4)), np.eye(4)), np.arange(20.0), s["z"]
        ).mean
        for i in range(3):
            alone = make(motion(s), sensor(s), lambda epoch, i=i: Phi[i], **options)
            one = celnav.run(
                alone, celnav.Gaussian(np.zeros(4), np.eye(4)), np.arange(20.0), s["z"]
            ).mean
            np.testing.assert_allclose(together[:, i], one, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("make", [celnav.colored, celnav.decorrelated, celnav.augmented])
def test_noise_is_stationary_unless_its_increments_are_given(make):
    """``R = Phi R Phi' + increments``, whichever of them are functions, also for a scalar
    coefficient.
    """
    s, steps = linear(), np.arange(20.0)
    R, prior = s["R"], celnav.Gaussian(np.zeros(4), np.eye(4))
    for Phi in (np.array([[0.8, 0.1], [-0.2, 0.5]]), 0.6 * np.eye(2)):
        given = make(motion(s), sensor(s), Phi, increments=R - Phi @ R @ Phi.T)
        expected = celnav.run(given, prior, steps, s["z"], keep="cov")
        by_function = celnav.Sensor(s["H"], lambda _mean, _epoch: R)
        for seen, phi in (
            (sensor(s), Phi),
            (sensor(s), lambda _epoch, Phi=Phi: Phi),
            (by_function, Phi),
        ):
            if seen is by_function and make is celnav.augmented:
                continue  # its V is a state with one initial covariance
            found = celnav.run(make(motion(s), seen, phi), prior, steps, s["z"], keep="cov")
            np.testing.assert_allclose(found.mean, expected.mean, rtol=0, atol=1e-10)
            np.testing.assert_allclose(found.cov, expected.cov, rtol=0, atol=1e-10)


def test_a_gap_costs_two_differences_and_partly_missing_ones_agree_between_structures():
    s = linear(3)
    s["z"][5, 0] = s["z"][9] = np.nan
    given = celnav.Gaussian(np.zeros(4), np.eye(4)), np.arange(20.0), s["z"]
    Phi = np.diag([0.8, 0.6])
    options = {"increments": s["R"], "first": False}
    tracks = [
        celnav.run(make(motion(s), sensor(s), Phi, **options), *given)
        for make in (celnav.colored, celnav.decorrelated)
    ]
    np.testing.assert_allclose(tracks[0].mean, tracks[1].mean, atol=1e-10)
    np.testing.assert_allclose(tracks[0].std, tracks[1].std, atol=1e-10)
    assert tracks[0].events["missing"] == 6
    unknown = celnav.Sensor(s["H"], 1e8 * np.eye(2))
    full = celnav.run(celnav.augmented(motion(s), unknown, Phi, increments=s["R"]), *given)
    assert (full.std[-1, :4] <= tracks[0].std[-1] * (1 + 1e-6)).all()


def test_decorrelation_keeps_the_digits_that_subtraction_loses():
    H, q, sigma = np.eye(3, 6), 1e6, 1.0
    star = decorrelation(H, np.diag([q] * 3 + [1e-3] * 3), sigma * np.eye(3))
    exact = q**2 * sigma**2 / (q**2 + sigma**2)
    np.testing.assert_allclose((star.sqrt_Q @ star.sqrt_Q.T)[0, 0], exact, rtol=1e-9)
    none = decorrelation(H, np.diag([0.0] * 3 + [1e-3] * 3), sigma * np.eye(3))
    assert not none.J.any()
    np.testing.assert_array_equal(none.sqrt_R, np.eye(3))


P0 = np.diag([0.15**2] * 3 + [3.5e-5**2] * 3)
Q = np.diag([7.5e-3**2] * 3 + [1e-8**2] * 3)
R = 0.04 * np.eye(3)
START = orbit.from_elements(7136.635, 0.001, *np.radians([65, 30, 30, 0]))


def sightings(runs, steps):
    rng = np.random.default_rng(7)
    x = np.broadcast_to(START, (runs, 6))
    z = [x[:, :3]]
    for _ in range(steps):
        x = orbit.step(x, 1.0) + rng.normal(size=(runs, 6)) * np.sqrt(Q.diagonal())
        z.append(x[:, :3])
    return np.array(z) + 0.2 * rng.normal(size=(steps + 1, runs, 3)), START + rng.normal(
        size=(runs, 6)
    ) * np.sqrt(P0.diagonal())


@pytest.mark.parametrize(
    "points",
    [
        MerweScaledSigmaPoints(6, 1.0, 0.0, 0.0),
        MerweScaledSigmaPoints(6, 0.5, 2.0, -1.0),
        JulierSigmaPoints(6, 1.0),
        SimplexSigmaPoints(6),
    ],
    ids=lambda p: type(p).__name__,
)
@FORMS
def test_orbit_filters_equal_filterpy(points, form):
    z, means = sightings(1, 25)
    peer = UnscentedKalmanFilter(
        6, 3, 1.0, lambda x: x[:3], lambda x, dt: orbit.step(x, dt), points
    )
    peer.x, peer.P, peer.Q, peer.R = means[0].copy(), P0, Q, R
    theirs = []
    for k in range(1, 26):
        peer.predict()
        peer.update(z[k, 0])
        theirs.append(peer.x)
    z[0] = np.nan
    filter = celnav.sigma_point(
        celnav.Motion(lambda x, epoch: orbit.step(x, epoch.dt), Q),
        celnav.Sensor(lambda x, epoch: x[..., :3], R),
        rule=celnav.from_filterpy(points),
        form=form,
    )
    track = celnav.run(filter, celnav.Gaussian(means[0], P0), np.arange(26.0), z[:, 0])
    np.testing.assert_allclose(track.mean[1:], theirs, atol=1e-7)


@pytest.mark.parametrize("name", ["cubature 3", "cubature 5", "gauss-hermite", "unscented"])
def test_rules_work_inside_filterpy(name):
    s = linear()
    rule = RULES[name]
    peer = UnscentedKalmanFilter(4, 2, 1.0, lambda x: s["H"] @ x, lambda x, dt: s["A"] @ x, rule)
    peer.Q, peer.R = s["Q"], s["R"]
    means, _ = kalman(s, np.zeros(4), np.eye(4))
    peer.x, peer.P = means[0], kalman(s, np.zeros(4), np.eye(4))[1][0]
    for k in range(1, 20):
        peer.predict()
        peer.update(s["z"][k])
    np.testing.assert_allclose(peer.x, means[-1], atol=1e-9)


@FORMS
@pytest.mark.parametrize("kind", ["white", "colored", "decorrelated"])
def test_a_batch_is_its_single_runs(form, kind):
    z, means = sightings(4, 15)
    of, Phi = (
        (celnav.Motion(lambda x, epoch: orbit.step(x, 1.0), Q), celnav.Sensor(np.eye(3, 6), R)),
        0.8 * np.eye(3),
    )
    filter = {
        "white": celnav.ukf(*of, form=form),
        "colored": celnav.colored(*of, Phi, increments=R, form=form),
        "decorrelated": celnav.decorrelated(*of, Phi, increments=R, first=False, form=form),
    }[kind]
    times = np.arange(16.0)
    batch = celnav.run(filter, celnav.Gaussian(means, P0), times, z).mean
    shaped = celnav.run(
        filter, celnav.Gaussian(means.reshape(2, 2, 6), P0), times, z.reshape(-1, 2, 2, 3)
    ).mean
    np.testing.assert_array_equal(shaped.reshape(batch.shape), batch)
    for i in range(4):
        one = celnav.run(filter, celnav.Gaussian(means[i], P0), times, z[:, i]).mean
        np.testing.assert_allclose(batch[:, i], one, rtol=1e-12)


def test_a_stream_is_the_run_bit_for_bit_and_can_be_resumed():
    z, means = sightings(2, 10)
    filter = celnav.ukf(
        celnav.Motion(lambda x, epoch: orbit.step(x, 1.0), Q), celnav.Sensor(np.eye(3, 6), R)
    )
    prior, epochs = celnav.Gaussian(means, P0), celnav.epochs(np.arange(11.0), z)
    state = filter.start(prior)
    for epoch in epochs:
        state, _ = filter.step(state, epoch)
    np.testing.assert_array_equal(celnav.run(filter, prior, epochs).mean[-1], state.belief.mean)


def test_noise_through_the_points_is_additive_noise_in_the_linear_case():
    s = linear()
    root = np.diag([0.1, 0.2, 0.05, 0.3])
    added = celnav.Motion(lambda x, epoch: x @ s["A"].T, sqrt_Q=root)
    through = celnav.Motion(lambda x, epoch, w: x @ s["A"].T + w, augment=(root,))
    prior = celnav.Gaussian(np.ones((3, 4)), np.eye(4))
    filters = [celnav.ukf(of) for of in (added, through)]
    one, other = (
        filter.predict(filter.start(prior), celnav.Epoch(1, 1.0, 1.0)).belief for filter in filters
    )
    np.testing.assert_allclose(one.cov, other.cov, atol=1e-12)
    np.testing.assert_allclose(one.mean, other.mean, atol=1e-12)


def test_a_lost_run_is_flagged_and_its_neighbors_go_on():
    def f(x, epoch):
        return np.where((x[0, ..., :1] > 50.0) & (epoch.k == 2), np.nan, x)

    filter = celnav.ukf(celnav.Motion(f, np.eye(2)), celnav.Sensor(np.eye(2), np.eye(2)))
    means = np.array([[0.0, 0.0], [100.0, 0.0], [1.0, 1.0]])
    prior, times, z = celnav.Gaussian(means, np.eye(2)), np.arange(5.0), np.tile(means, (5, 1, 1))
    track = celnav.run(filter, prior, times, z, on_failure="flag")
    np.testing.assert_array_equal(track.failed_at, [-1, 2, -1])
    others = celnav.run(filter, celnav.Gaussian(means[[0, 2]], np.eye(2)), times, z[:, [0, 2]])
    np.testing.assert_allclose(track.mean[:, [0, 2]], others.mean, rtol=1e-13)
    with pytest.raises(
        celnav.FilterError, match=r"step 2, .*run \(1,\): f is not finite at sigma point"
    ):
        celnav.run(filter, prior, times, z)


GROWING = np.array([[1.05, 0.1], [0.0, 1.02]])


@pytest.mark.parametrize("matrix", [False, True])
def test_an_extended_filter_in_covariance_form_stays_symmetric_where_modes_grow(matrix):
    """Feedback keeps the state near 0; asymmetric parts of P would grow with the modes, 1e15-fold
    in 500 steps.
    """
    motion = celnav.Motion(
        lambda x, epoch: 0.5 * x, 0.01 * np.eye(2), jacobian=lambda x, epoch: GROWING
    )
    h = np.eye(1, 2) if matrix else lambda x, epoch: x[..., :1]
    sensor = celnav.Sensor(h, [[1.0]], jacobian=lambda x, epoch: np.eye(1, 2))
    z, prior = (
        np.random.default_rng(0).normal(size=(1000, 1)),
        celnav.Gaussian(np.zeros(2), np.eye(2)),
    )
    cov, root = (
        celnav.run(celnav.ekf(motion, sensor, form=form), prior, np.arange(1000.0), z, keep="cov")
        for form in ("covariance", "square root")
    )
    np.testing.assert_allclose(cov.cov, root.cov, rtol=1e-9)
    np.testing.assert_array_equal(cov.cov, cov.cov.mT)


@pytest.mark.parametrize("name", ["ekf", "jacobian", "ukf", "alpha"])
@pytest.mark.parametrize("hooked", [False, True])
def test_precise_sensors_cost_a_covariance_no_definiteness(name, hooked):
    """The standard deviation is 1e5 before and 1e-7 after: the variances differ by more digits than
    a float has. The neighboring run is not affected.
    """
    H, P = np.eye(1, 3), 1e10 * (0.5 * np.eye(3) + 0.5)
    rule = {
        "ekf": celnav.Taylor(),
        "jacobian": celnav.Taylor(),
        "alpha": celnav.unscented(3, 0.1, 2.0),
    }.get(name, celnav.unscented)
    known = {"f": lambda x, epoch: np.eye(3), "h": lambda x, epoch: H} if name == "jacobian" else {}
    still = celnav.Motion(
        lambda x, epoch: x, 1e-4 * np.diag([0.0, 1.0, 1.0]), jacobian=known.get("f")
    )

    def filter(form="covariance", **noise):
        seen = celnav.Sensor(lambda x, epoch: x @ H.T, **noise, jacobian=known.get("h"))
        return celnav.sigma_point(
            still, seen, rule=rule, form=form, hooks=[gate(1e6)] if hooked else ()
        )

    runs = np.array([[1e-7], [1.0]])[..., None]
    cov, root = (
        celnav.run(
            filter(form, sqrt_R=runs),
            celnav.Gaussian(np.zeros((2, 3)), P),
            np.arange(40.0),
            np.zeros((40, 2, 1)),
            keep="cov",
        )
        for form in ("covariance", "square root")
    )
    np.testing.assert_allclose(cov.std, root.std, rtol=1e-5)
    alone = celnav.run(
        filter(R=[[1.0]]), celnav.Gaussian(np.zeros(3), P), [0.0], np.zeros((1, 1)), keep="cov"
    )
    np.testing.assert_allclose(cov.cov[0, 1], alone.cov[0], rtol=1e-9)


def test_noise_of_each_run_gives_points_their_runs():
    """Models with parameters for each run, from one prior: each run equals a single run with its
    parameters.
    """
    phi, q, r = np.array([[0.5], [0.6]]), np.array([[[1.0]], [[2.0]]]), np.array([[[0.5]], [[0.7]]])
    prior, times, z = celnav.Gaussian([0.0], [[1.0]]), np.arange(4.0), np.ones((4, 1))

    def track(phi, q, r):
        motion = celnav.Motion(lambda x, epoch: phi * x, sqrt_Q=q)
        return celnav.run(
            celnav.ukf(motion, celnav.Sensor(lambda x, epoch: phi * x, sqrt_R=r)), prior, times, z
        )

    together = track(phi, q, r)
    for i in range(2):
        alone = track(phi[i], q[i], r[i])
        np.testing.assert_allclose(together.mean[:, i], alone.mean, rtol=1e-12)
        np.testing.assert_allclose(together.std[:, i], alone.std, rtol=1e-12)
