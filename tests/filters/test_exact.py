"""Filters against the Kalman filter, filterpy, and the joint Gaussian of everything, written out here."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import JulierSigmaPoints, MerweScaledSigmaPoints, SimplexSigmaPoints, UnscentedKalmanFilter

import celnav
from celnav.filters.adaptive import gate
from celnav.filters.colored import augmented, colored
from celnav.filters.decorrelated import decorrelated, decorrelation
from celnav.gaussian.belief import covariance, square_root
from celnav.gaussian.taylor import Taylor
from celnav.models import orbit

FORMS = {"square root": celnav.square_root, "covariance": celnav.covariance}
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


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("matrix", [True, False])
def test_every_rule_is_the_kalman_filter_in_the_linear_case(form, rule, matrix):
    s = linear()
    h = s["H"] if matrix else lambda x, epoch: x @ s["H"].T
    filter = celnav.sequential(
        celnav.predict(lambda x, epoch: x @ s["A"].T, RULES[rule], s["Q"]), celnav.update(h, RULES[rule], s["R"])
    )
    prior = FORMS[form](np.ones(4), np.eye(4))
    track = celnav.run(filter, prior, celnav.epochs(np.arange(20.0), s["z"]), keep="spread")
    means, covs = kalman(s, np.ones(4), np.eye(4))
    tolerance = 1e-6 if rule in ("small alpha", "taylor") else 1e-9
    np.testing.assert_allclose(track.mean, means, atol=tolerance)
    np.testing.assert_allclose(track.cov, covs, atol=tolerance)


@pytest.mark.parametrize("form", FORMS)
def test_missing_components_are_marginalized_in_each_run_by_itself(form):
    s = linear()
    z = np.repeat(s["z"][:, None], 3, 1)
    gaps = [(), {(3, 0), (7, 1)}, {(4, 0), (4, 1), (0, 0)}]
    for run, missing in enumerate(gaps):
        for k, i in missing:
            z[k, run, i] = np.nan
    rule = RULES["unscented"]
    filter = celnav.sequential(celnav.predict(lambda x, epoch: x @ s["A"].T, rule, s["Q"]), celnav.update(s["H"], rule, s["R"]))
    prior = FORMS[form](np.ones((3, 4)), np.eye(4))
    track = celnav.run(filter, prior, celnav.epochs(np.arange(20.0), z), keep="spread")
    for run, missing in enumerate(gaps):
        means, covs = kalman(s, np.ones(4), np.eye(4), missing)
        np.testing.assert_allclose(track.mean[:, run], means, atol=1e-10)
        np.testing.assert_allclose(track.cov[:, run], covs, atol=1e-10)
    np.testing.assert_array_equal(track.events["missing"], [0, 2, 3])


def test_the_log_likelihood_is_the_density_of_all_measurements():
    from scipy.stats import multivariate_normal

    s = linear()
    rule = RULES["unscented"]
    filter = celnav.sequential(celnav.predict(lambda x, epoch: x @ s["A"].T, rule, s["Q"]), celnav.update(s["H"], rule, s["R"]))
    track = celnav.run(filter, celnav.square_root(np.zeros(4), np.eye(4)), celnav.epochs(np.arange(20.0), s["z"]))
    X = joint_states(s, np.eye(4))
    big = np.kron(np.eye(20), s["H"])
    cov = big @ X @ big.T + np.kron(np.eye(20), s["R"])
    np.testing.assert_allclose(track.log_likelihood, multivariate_normal(np.zeros(40), cov).logpdf(s["z"].ravel()), rtol=1e-10)


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


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("radius", [0.7, 1.0])
@pytest.mark.parametrize("known", [True, False])
def test_colored_filters_are_batch_conditioning_for_a_full_coefficient(form, radius, known):
    s = linear(3)
    m, n, N = 2, 4, 12
    s["z"] = s["z"][:N]
    Phi = spectral(np.random.default_rng(5).normal(size=(m, m)), radius)
    Sigma0 = 0.5 * np.eye(m) + 0.1 if known else None
    f, rule = (lambda x, epoch: x @ s["A"].T), RULES["unscented"]
    options = {"Q": s["Q"], "R": s["R"], "Sigma0": Sigma0}
    prior = FORMS[form](np.zeros(n), np.eye(n))
    epochs = celnav.epochs(np.arange(float(N)), s["z"])
    single = celnav.run(colored(f, s["H"], rule, Phi, **options), prior, epochs, keep="spread")
    lagged = {"also": lambda epoch, state, info: {"mean": state.lagged.mean, "cov": state.lagged.cov}}
    paper = celnav.run(decorrelated(f, s["H"], rule, Phi, **options), prior, epochs, keep="spread", **lagged)
    # Everything is linear in (states, V_0, zetas): condition on z, or on differences alone where V_0 is not known.
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
            ours = (track.extra["mean"][k], track.extra["cov"][k]) if at == "lagged" else (track.mean[k], track.cov[k])
            np.testing.assert_allclose(ours[0], mean, atol=1e-8)
            np.testing.assert_allclose(ours[1], cov, atol=1e-8)


@pytest.mark.parametrize("form", FORMS)
def test_a_coefficient_for_each_run_and_one_that_is_a_function_of_time(form):
    s = linear(3)
    Phi = np.stack([spectral(np.random.default_rng(i).normal(size=(2, 2)), 0.8) for i in range(3)])
    f, rule = (lambda x, epoch: x @ s["A"].T), RULES["unscented"]
    epochs = celnav.epochs(np.arange(20.0), s["z"])
    prior = FORMS[form](np.zeros((3, 4)), np.eye(4))
    for make in (colored, decorrelated):
        together = celnav.run(make(f, s["H"], rule, Phi, Q=s["Q"], R=s["R"]), prior, epochs).mean
        for i in range(3):
            alone = make(f, s["H"], rule, lambda epoch, i=i: Phi[i], Q=s["Q"], R=s["R"])
            one = celnav.run(alone, FORMS[form](np.zeros(4), np.eye(4)), epochs).mean
            np.testing.assert_allclose(together[:, i], one, rtol=1e-10, atol=1e-12)


def test_a_gap_costs_two_differences_and_partly_missing_ones_agree_between_structures():
    s = linear(3)
    s["z"][5, 0] = s["z"][9] = np.nan
    f, rule = (lambda x, epoch: x @ s["A"].T), RULES["unscented"]
    prior = celnav.square_root(np.zeros(4), np.eye(4))
    epochs = celnav.epochs(np.arange(20.0), s["z"])
    Phi = np.diag([0.8, 0.6])
    tracks = [celnav.run(make(f, s["H"], rule, Phi, Q=s["Q"], R=s["R"]), prior, epochs) for make in (colored, decorrelated)]
    np.testing.assert_allclose(tracks[0].mean, tracks[1].mean, atol=1e-10)
    np.testing.assert_allclose(tracks[0].std, tracks[1].std, atol=1e-10)
    assert tracks[0].events["missing"] == 6
    full = celnav.run(augmented(f, s["H"], celnav.unscented(6), Phi, Q=s["Q"], R=s["R"], Sigma0=1e8 * np.eye(2)), prior, epochs)
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
    return np.array(z) + 0.2 * rng.normal(size=(steps + 1, runs, 3)), START + rng.normal(size=(runs, 6)) * np.sqrt(P0.diagonal())


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
@pytest.mark.parametrize("form", FORMS)
def test_orbit_filters_equal_filterpy(points, form):
    z, means = sightings(1, 25)
    peer = UnscentedKalmanFilter(6, 3, 1.0, lambda x: x[:3], lambda x, dt: orbit.step(x, dt), points)
    peer.x, peer.P, peer.Q, peer.R = means[0].copy(), P0, Q, R
    theirs = []
    for k in range(1, 26):
        peer.predict()
        peer.update(z[k, 0])
        theirs.append(peer.x)
    z[0] = np.nan
    rule = celnav.from_filterpy(points)
    filter = celnav.sequential(
        celnav.predict(lambda x, epoch: orbit.step(x, epoch.dt), rule, Q), celnav.update(lambda x, epoch: x[..., :3], rule, R)
    )
    track = celnav.run(filter, FORMS[form](means[0], P0), celnav.epochs(np.arange(26.0), z[:, 0]))
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


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["white", "colored", "decorrelated"])
def test_a_batch_is_its_single_runs(form, kind):
    z, means = sightings(4, 15)
    rule, f, H = celnav.unscented(6), (lambda x, epoch: orbit.step(x, 1.0)), np.eye(3, 6)
    filter = {
        "white": celnav.sequential(celnav.predict(f, rule, Q), celnav.update(H, rule, R)),
        "colored": colored(f, H, rule, 0.8 * np.eye(3), Q=Q, R=R, Sigma0=R),
        "decorrelated": decorrelated(f, H, rule, 0.8 * np.eye(3), Q=Q, R=R),
    }[kind]
    times = np.arange(16.0)
    batch = celnav.run(filter, FORMS[form](means, P0), celnav.epochs(times, z)).mean
    shaped = celnav.run(filter, FORMS[form](means.reshape(2, 2, 6), P0), celnav.epochs(times, z.reshape(-1, 2, 2, 3))).mean
    np.testing.assert_array_equal(shaped.reshape(batch.shape), batch)
    for i in range(4):
        one = celnav.run(filter, FORMS[form](means[i], P0), celnav.epochs(times, z[:, i])).mean
        np.testing.assert_allclose(batch[:, i], one, rtol=1e-12)


def test_a_stream_is_the_run_bit_for_bit_and_can_be_resumed():
    z, means = sightings(2, 10)
    rule = celnav.unscented(6)
    filter = celnav.sequential(celnav.predict(lambda x, epoch: orbit.step(x, 1.0), rule, Q), celnav.update(np.eye(3, 6), rule, R))
    prior, epochs = celnav.square_root(means, P0), celnav.epochs(np.arange(11.0), z)
    state = filter.start(prior)
    for epoch in epochs:
        state, _ = filter.step(state, epoch)
    np.testing.assert_array_equal(celnav.run(filter, prior, epochs).mean[-1], state.belief.mean)


def test_noise_through_the_points_is_additive_noise_in_the_linear_case():
    s = linear()
    root = np.diag([0.1, 0.2, 0.05, 0.3])
    added = celnav.predict(lambda x, epoch: x @ s["A"].T, celnav.unscented(4), sqrt_Q=root)
    through = celnav.predict(lambda x, epoch, w: x @ s["A"].T + w, celnav.unscented(8), extra=(root,))
    prior = celnav.square_root(np.ones((3, 4)), np.eye(4))
    np.testing.assert_allclose(added(prior)[0].cov, through(prior)[0].cov, atol=1e-12)
    np.testing.assert_allclose(added(prior)[0].mean, through(prior)[0].mean, atol=1e-12)


def test_a_lost_run_is_flagged_and_its_neighbors_go_on():
    def f(x, epoch):
        return np.where((x[0, ..., :1] > 50.0) & (epoch.k == 2), np.nan, x)

    rule = celnav.unscented(2)
    filter = celnav.sequential(celnav.predict(f, rule, np.eye(2)), celnav.update(np.eye(2), rule, np.eye(2)))
    prior = celnav.square_root(np.array([[0.0, 0.0], [100.0, 0.0], [1.0, 1.0]]), np.eye(2))
    epochs = celnav.epochs(np.arange(5.0), np.tile(prior.mean, (5, 1, 1)))
    track = celnav.run(filter, prior, epochs, on_failure="flag")
    np.testing.assert_array_equal(track.failed_at, [-1, 2, -1])
    others = celnav.run(
        filter,
        celnav.square_root(prior.mean[[0, 2]], np.eye(2)),
        celnav.epochs(np.arange(5.0), np.tile(prior.mean[[0, 2]], (5, 1, 1))),
    )
    np.testing.assert_allclose(track.mean[:, [0, 2]], others.mean, rtol=1e-13)
    with pytest.raises(celnav.FilterError, match=r"step 2, .*run \(1,\): f is not finite at sigma point"):
        celnav.run(filter, prior, epochs)


GROWING = np.array([[1.05, 0.1], [0.0, 1.02]])


@pytest.mark.parametrize("matrix", [False, True])
def test_an_extended_filter_in_covariance_form_stays_symmetric_where_modes_grow(matrix):
    """Feedback keeps the state near 0; what is not symmetric in P would grow as the modes do, 1e15-fold in 500 steps."""
    moved, seen = Taylor(lambda x, epoch: (GROWING,)), Taylor(lambda x, epoch: (np.eye(1, 2),))
    back = GROWING - 0.5 * np.eye(2)
    z = np.random.default_rng(0).normal(size=(1000, 1))
    tracks = []
    for form in (covariance, square_root):
        h = np.eye(1, 2) if matrix else lambda x, epoch: x[..., :1]
        predict = celnav.predict(lambda x, epoch: x @ (GROWING - back).T, moved, 0.01 * np.eye(2))
        filter = celnav.sequential(predict, celnav.update(h, seen, [[1.0]]))
        tracks.append(celnav.run(filter, form(np.zeros(2), np.eye(2)), celnav.epochs(np.arange(1000.0), z), keep="spread"))
    np.testing.assert_allclose(tracks[0].cov, tracks[1].cov, rtol=1e-9)
    np.testing.assert_array_equal(tracks[0].cov, tracks[0].cov.mT)


@pytest.mark.parametrize(
    ("moved", "seen"),
    [
        (Taylor(lambda x, epoch: (np.eye(3),)), Taylor(lambda x, epoch: (np.eye(1, 3),))),
        (celnav.unscented(3), celnav.unscented(3)),
        (celnav.unscented(3, 0.1, 2.0), celnav.unscented(3, 0.1, 2.0)),
    ],
    ids=["ekf", "ukf", "alpha"],
)
@pytest.mark.parametrize("hooked", [False, True])
def test_precise_sensors_cost_a_covariance_no_definiteness(moved, seen, hooked):
    """Deviations of 1e5 before and 1e-7 after: as variances, more digits apart than there are. Its neighbor stays as it is."""
    H, prior, runs = np.eye(1, 3), 1e10 * (0.5 * np.eye(3) + 0.5), np.array([[1e-7], [1.0]])
    filter = celnav.sequential(
        celnav.predict(lambda x, epoch: x, moved, 1e-4 * np.diag([0.0, 1.0, 1.0])),
        celnav.update(lambda x, epoch: x @ H.T, seen, sqrt_R=runs[..., None], hooks=[gate(1e6)] if hooked else ()),
    )
    z = np.zeros((40, 2, 1))
    cov, root = (
        celnav.run(filter, form(np.zeros((2, 3)), prior), celnav.epochs(np.arange(40.0), z), keep="spread")
        for form in (covariance, square_root)
    )
    np.testing.assert_allclose(cov.std, root.std, rtol=1e-5)
    alone = celnav.update(lambda x, epoch: x @ H.T, seen, [[1.0]])(covariance(np.zeros(3), prior), [0.0])[0]
    np.testing.assert_allclose(cov.cov[0, 1], alone.cov, rtol=1e-9)
