"""Gates reject outliers and count them, the window follows its formula, considered states keep
their uncertainty.
"""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from celnav import (
    Epoch,
    Gaussian,
    Motion,
    Sensor,
    colored,
    decorrelated,
    epochs,
    run,
    sigma_point,
    steps,
)
from celnav.filters.adaptive import (
    chi_square_gate,
    consider,
    gate,
    innovation_window,
    sage_husa,
    underweighting,
    variational_bayes,
)
from celnav.gaussian.rules import Taylor, unscented

A = np.array([[1.0, 0.2], [-0.1, 0.9]])
H = np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 2.0]])
Q = np.array([[0.1, 0.02], [0.02, 0.05]])
R = np.array([[0.5, 0.1, 0.0], [0.1, 0.4, 0.1], [0.0, 0.1, 0.3]])
P0 = np.array([[1.0, 0.3], [0.3, 0.6]])
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
RULES = pytest.mark.parametrize(
    "rule", [unscented(2), unscented(2, 1.0, 0.0, -0.5), Taylor()], ids=repr
)


def make(hooks=(), rule=unscented, form="square root", gain=None):
    """Models as functions, not matrices, so that a rule cannot use their linearity."""
    motion, sensor = Motion(lambda x, epoch: x @ A.T, Q), Sensor(lambda x, epoch: x @ H.T, R)
    return sigma_point(motion, sensor, rule=rule, form=form, hooks=hooks, gain=gain)


def prior(*batch):
    return Gaussian(np.zeros((*batch, 2)), P0)


def seen(filter, known, z):
    """The belief given a measurement, and the `Info`."""
    state, (info,) = filter.update(filter.start(known), Epoch(z=z))
    return state.belief, info


def simulate(rng, steps, *batch):
    x = rng.normal(size=(*batch, 2)) @ np.linalg.cholesky(P0).T
    z = []
    for k in range(steps):
        if k:
            x = x @ A.T + rng.normal(size=(*batch, 2)) @ np.linalg.cholesky(Q).T
        z.append(x @ H.T + rng.normal(size=(*batch, 3)) @ np.linalg.cholesky(R).T)
    return np.array(z)


def kalman(z, inflate=None, rejects=None):
    """The textbook filter of one run: ``inflate(k, e, S0) -> A``, ``rejects(e, S) -> bool (m,)``."""
    x, P, means = np.zeros(2), P0, []
    for k, measured in enumerate(z):
        if k:
            x, P = A @ x, A @ P @ A.T + Q
        e, S0 = measured - H @ x, H @ P @ H.T
        root = np.sqrt(np.ones(3) if inflate is None else inflate(k, e, S0))
        S = S0 + root[:, None] * R * root
        used = ~np.isnan(e)
        if rejects is not None:
            used &= ~rejects(e, S)
        K = np.linalg.solve(S[np.ix_(used, used)], (H @ P)[used]).T
        x, P = x + K @ e[used], P - K @ (H @ P)[used]
        means.append(x)
    return np.array(means)


@RULES
@FORMS
def test_gate_leaves_out_components(form, rule):
    """The textbook filter without those components, and the count of them in the track."""
    z = simulate(np.random.default_rng(1), 30, 3)
    z[5, 0, 1] += 50.0
    z[9, 1] += [40.0, 0.0, -40.0]
    z[9, 0, 2] = np.nan
    rejected = np.zeros(3, int)

    def rejects(e, S):
        beyond = np.abs(e) > 4.0 * np.sqrt(np.diag(S))
        rejected[i] += beyond.sum()
        return beyond

    expected = []
    for i in range(3):
        expected.append(kalman(z[:, i], rejects=rejects))
    track = run(make([gate(4.0)], rule, form), prior(3), epochs(np.arange(30), z))
    np.testing.assert_allclose(track.mean, np.stack(expected, 1), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(track.events["rejected"], rejected)
    np.testing.assert_array_equal(track.events["missing"], [1, 0, 0])
    assert rejected[0] >= 1
    assert rejected[1] >= 2
    assert track.innovation[5, 0, 1] > 40.0  # recorded, though not used
    assert not track.used[5, 0, 1]


def test_gate_rejects_as_often_as_it_should():
    """For data without faults and a single component, the share of a Gaussian beyond 1.5 standard
    deviations.
    """
    gamma, runs = 1.5, 4000
    z = simulate(np.random.default_rng(2), 1, runs)[0]
    _, info = seen(make([gate(gamma)]), prior(runs), z)
    share = 2.0 * norm.sf(gamma)
    assert abs((~info.used).mean(0) - share).max() < 4.0 * np.sqrt(share * (1.0 - share) / runs)


@RULES
@FORMS
def test_chi_square_gate_leaves_out_runs(form, rule):
    """The whole vector of a run is left out, by a bound for its number of measured components."""
    z = simulate(np.random.default_rng(3), 30, 3)
    z[5, 0] += [8.0, -6.0, 0.0]
    z[6, 1] = [np.nan, np.nan, 60.0]
    z[7, 2] = np.nan
    rejected = np.zeros(3, int)

    def rejects(e, S):
        used = ~np.isnan(e)
        if not used.any():
            return ~used
        d2 = e[used] @ np.linalg.solve(S[np.ix_(used, used)], e[used])
        beyond = d2 > chi2.ppf(0.99, used.sum())
        rejected[i] += beyond * used.sum()
        return np.full(3, beyond)

    expected = []
    for i in range(3):
        expected.append(kalman(z[:, i], rejects=rejects))
    track = run(make([chi_square_gate(0.99)], rule, form), prior(3), epochs(np.arange(30), z))
    np.testing.assert_allclose(track.mean, np.stack(expected, 1), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(track.events["rejected"], rejected)
    assert not track.used[5, 0].any()
    assert not track.used[6, 1].any()
    np.testing.assert_array_equal(track.events["missing"], [0, 2, 3])


def test_chi_square_gate_sees_correlation():
    """Two components whose contradiction is too small for a gate by component."""
    known, still = Gaussian([0.0], [[100.0]]), Motion(np.eye(1), np.zeros((1, 1)))
    opposed, agreeing = np.array([8.0, -8.0]), np.array([8.0, 8.0])
    for hook, bad in ((gate(3.0), True), (chi_square_gate(0.999), False)):
        filter = sigma_point(still, Sensor([[1.0], [1.0]], np.eye(2)), rule=unscented, hooks=[hook])
        assert seen(filter, known, opposed)[1].used.all() == bad
        assert seen(filter, known, agreeing)[1].used.all()


@FORMS
@pytest.mark.parametrize("hook", [gate(2.0), chi_square_gate(0.9)], ids=["gate", "chi-square"])
def test_gates_do_not_mind_how_the_noise_comes_in(hook, form):
    """With noise through the points or additive: for a linear measurement both reject the same
    components, and many of them.
    """
    added = Sensor(lambda x, epoch: x @ H.T, R)
    through = Sensor(lambda x, epoch, w: x @ H.T + w, augment=(np.linalg.cholesky(R),))
    z = simulate(np.random.default_rng(4), 40, 3)
    one, other = (
        run(
            sigma_point(Motion(A, Q), sensor, rule=unscented, form=form, hooks=[hook]),
            prior(3),
            epochs(np.arange(40), z),
        )
        for sensor in (added, through)
    )
    np.testing.assert_array_equal(other.used, one.used)
    np.testing.assert_allclose(other.mean, one.mean, rtol=0, atol=1e-11)
    assert 0.02 < (~one.used).mean() < 0.5


def test_chi_square_gate_counts_what_was_measured():
    """A deviation of three σ in one component is rejected if measured alone (bound at 0.99: 2.6),
    not among three components (3.4).
    """
    S = H @ P0 @ H.T + R
    alone = np.array([np.nan, np.nan, 3.0 * np.sqrt(S[2, 2])])
    among = 3.0 * np.linalg.cholesky(S)[:, 0]
    _, info = seen(make([chi_square_gate(0.99)]), prior(2), np.array([alone, among]))
    np.testing.assert_array_equal(info.used, [[False] * 3, [True] * 3])


@FORMS
@RULES
def test_a_window_never_filled_changes_no_bit(form, rule):
    z = simulate(np.random.default_rng(4), 20, 4)
    z[3, 1, 0] = np.nan
    plain, hooked = (
        run(make(hooks, rule, form), prior(4), epochs(np.arange(20), z), keep="cov")
        for hooks in ((), (innovation_window(21),))
    )
    np.testing.assert_array_equal(hooked.mean, plain.mean)
    np.testing.assert_array_equal(hooked.belief[1], plain.belief[1])
    np.testing.assert_array_equal(hooked.log_likelihood, plain.log_likelihood)


@FORMS
@RULES
@pytest.mark.parametrize("gaps", ["restart", "skip"])
def test_window_follows_its_formula(form, rule, gaps):
    """``A = max(1, (C - S0) / R)`` for each component, also with full R; gaps restart the window or
    are skipped.
    """
    M, z = 4, simulate(np.random.default_rng(5), 40)
    z[15:25] *= 6.0
    z[18, 1] = np.nan
    z[30, 0] = np.nan
    past = [[], [], []]
    largest = 0.0

    def inflate(k, e, S0):
        nonlocal largest
        factor = np.ones(3)
        for i in range(3):
            if np.isnan(e[i]):
                past[i] = [] if gaps == "restart" else past[i]
            else:
                past[i].append(e[i])
            if len(past[i]) >= M:
                factor[i] = max(1.0, (np.mean(np.square(past[i][-M:])) - S0[i, i]) / R[i, i])
        largest = max(largest, factor.max())
        return factor

    expected = kalman(z, inflate)
    assert largest > 10.0
    track = run(make([innovation_window(M, gaps)], rule, form), prior(), epochs(np.arange(40), z))
    np.testing.assert_allclose(track.mean, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "hooks",
    [(innovation_window(3),), (innovation_window(3, "skip"),), (gate(2.0), innovation_window(2))],
)
def test_runs_do_not_know_each_other(hooks):
    """A run in a batch adapts as it would alone, also if all runs or only this run have no
    measurement.
    """
    z = simulate(np.random.default_rng(6), 30, 3)
    z[10:20, 1] *= 8.0
    z[12, 1] = np.nan  # alone, this epoch is skipped altogether; in the batch the hook sees nan
    z[16] = np.nan
    z[22, 0, 1] = np.nan
    batch = run(make(hooks), prior(3), epochs(np.arange(30), z))
    plain = run(make(), prior(3), epochs(np.arange(30), z))
    assert np.abs(batch.mean - plain.mean)[:, 1].max() > 0.1
    for i in range(3):
        alone = run(make(hooks), prior(), epochs(np.arange(30), z[:, i]))
        np.testing.assert_allclose(alone.mean, batch.mean[:, i], rtol=0, atol=1e-11)


def test_hooks_act_in_order_with_their_own_memory():
    """A gate before the window keeps outliers out of it; the states can be resumed midway."""
    z = simulate(np.random.default_rng(7), 12)
    z[4, 0] = 500.0
    filter = make([gate(5.0), innovation_window(3)])
    states = [state for _, state, _ in steps(filter, prior(), epochs(np.arange(12), z))]
    ((gated, window),) = states[4].memory
    assert gated is None
    assert np.isnan(window.samples[-1, 0])
    state = states[5]
    for epoch in epochs(np.arange(12), z)[6:]:
        state, _ = filter.step(state, epoch)
    np.testing.assert_array_equal(state.belief.mean, states[-1].belief.mean)


def test_adaptation_helps_in_a_burst():
    """With ten times the noise for a while, the window's error is below the error of the plain
    filter.
    """
    rng = np.random.default_rng(8)
    runs, steps_ = 30, 80
    x, truth, z = np.zeros((runs, 2)), [], []
    for k in range(steps_):
        x = x @ A.T + rng.normal(size=(runs, 2)) @ np.linalg.cholesky(Q).T
        truth.append(x)
        scale = 10.0 if 30 <= k < 60 else 1.0
        z.append(x @ H.T + scale * rng.normal(size=(runs, 3)) @ np.linalg.cholesky(R).T)
    when = epochs(np.arange(steps_), np.array(z))
    burst = slice(36, 60)
    error = [
        np.sqrt(np.mean((run(make(hooks), prior(runs), when).mean - np.array(truth))[burst] ** 2))
        for hooks in ((), (innovation_window(5),))
    ]
    assert error[1] < 0.7 * error[0]


@RULES
@FORMS
@pytest.mark.parametrize("share", [0.0, 0.6, 0.75])
def test_underweighting_follows_its_formula(form, rule, share):
    """``K = P H' ((1 + beta) H P H' + R)^-1`` if the prior has the larger share, with Joseph's
    covariance for this gain and the underweighting as noise; missing components and runs are left
    out.
    """
    beta, poor = 0.3, []
    z = simulate(np.random.default_rng(11), 20, 2)
    z[3, 0, 1] = z[4, 1] = np.nan
    z[5, 0, :2] = np.nan
    track = run(
        make([underweighting(beta, share)], rule, form),
        prior(2),
        epochs(np.arange(20), z),
        keep="cov",
    )
    for i in range(2):
        x, P = np.zeros(2), P0
        for k in range(20):
            if k:
                x, P = A @ x, A @ P @ A.T + Q
            u = ~np.isnan(z[k, i])
            if u.any():
                S0, Ru = H[u] @ P @ H[u].T, R[np.ix_(u, u)]
                poor.append((np.diag(S0) / np.diag(S0 + Ru) > share).any())
                extra = beta * S0 if poor[-1] else 0.0 * S0
                K = P @ H[u].T @ np.linalg.inv(S0 + extra + Ru)
                J = np.eye(2) - K @ H[u]
                x, P = x + K @ (z[k, i, u] - H[u] @ x), J @ P @ J.T + K @ (Ru + extra) @ K.T
            np.testing.assert_allclose(track.mean[k, i], x, rtol=0, atol=1e-9)
            np.testing.assert_allclose(track.cov[k, i], P, rtol=0, atol=1e-9)
    assert any(poor)
    assert all(poor) == (share == 0.0)


def ranges(x, _epoch=None):
    """Distances from two stations."""
    return np.stack(
        [np.hypot(x[..., 0], x[..., 1]), np.hypot(x[..., 0] - 6.0, x[..., 1] - 1.0)], -1
    )


def test_underweighting_leaves_room_for_curvature():
    """Precise ranges and a poor prior: an extended filter's predicted σ is a hundred times too
    small; with underweighting it agrees with the error.
    """
    rng, runs = np.random.default_rng(12), 2000
    center = np.array([3.0, 0.0])
    truth = center + rng.normal(size=(runs, 2))
    z = ranges(truth) + 0.01 * rng.normal(size=(runs, 2))
    nees = []
    for hooks in ((), (underweighting(),)):
        filter = sigma_point(
            Motion(np.eye(2), np.eye(2)),
            Sensor(ranges, 1e-4 * np.eye(2)),
            rule=Taylor(),
            hooks=hooks,
        )
        belief, _ = seen(filter, Gaussian(np.tile(center, (runs, 1)), np.eye(2)), z)
        error = belief.mean - truth
        nees.append(
            np.median(np.vecdot(error, np.linalg.solve(belief.cov, error[..., None])[..., 0]))
        )
    assert nees[0] > 100.0
    assert nees[1] < 2.0 * chi2.median(2)


def test_a_lost_run_is_not_underweighted_for_its_neighbors():
    z = simulate(np.random.default_rng(13), 5, 2)
    alone = run(make([underweighting()]), prior(), epochs(np.arange(5), z[:, 0]))
    far = Gaussian([[0.0, 0.0], [1e308, 1e308]], P0)
    with np.errstate(all="ignore"):
        both = run(make([underweighting()]), far, epochs(np.arange(5), z), on_failure="flag")
    np.testing.assert_array_equal(both.failed_at >= 0, [False, True])
    np.testing.assert_allclose(both.mean[:, 0], alone.mean, rtol=0, atol=1e-12)


@RULES
@FORMS
@pytest.mark.parametrize("missing", [False, True])
def test_consider_is_schmidt_kalman(form, rule, missing):
    """The Schmidt-Kalman equations in blocks: states x with P_x, considered p with P_p, and their
    cross-covariance C.
    """
    rng = np.random.default_rng(9)
    F, Hp = 0.8, np.array([[0.3], [-0.5], [0.2]])
    B = np.array([[0.4], [-0.2]])
    z = rng.normal(size=(25, 3))
    if missing:
        z[4, 1] = np.nan
        z[8:10, [0, 2]] = np.nan
        z[13] = np.nan
    three = {
        "Rule": unscented(3, 1.0, 0.0, -0.5 if "negative weights=1" in repr(rule) else 0.0)
    }.get(type(rule).__name__, rule)

    def dynamics(x, epoch):
        return np.concatenate([x[..., :2] @ A.T + x[..., 2:] @ B.T, F * x[..., 2:]], -1)

    def measure(x, epoch):
        return x[..., :2] @ H.T + x[..., 2:] @ Hp.T

    noise = np.zeros((3, 3))
    noise[:2, :2], noise[2, 2] = Q, 0.05
    start = np.zeros((3, 3))
    start[:2, :2], start[2, 2] = P0, 0.7
    filter = sigma_point(
        Motion(dynamics, noise), Sensor(measure, R), rule=three, form=form, gain=consider(2, 1)
    )
    track = run(filter, Gaussian([0.0, 0.0, 0.4], start), epochs(np.arange(25), z), keep="cov")

    x, p, P, C, Pp = np.zeros(2), np.array([0.4]), P0, np.zeros((2, 1)), np.array([[0.7]])
    for k in range(25):
        if k:
            x, p = A @ x + B @ p, F * p
            P = A @ P @ A.T + A @ C @ B.T + B @ C.T @ A.T + B @ Pp @ B.T + Q
            C = A @ C * F + B @ Pp * F
            Pp = F * Pp * F + 0.05
        there = ~np.isnan(z[k])
        if there.any():
            Hx, Hc, Rk = H[there], Hp[there], R[np.ix_(there, there)]
            S = Hx @ P @ Hx.T + Hx @ C @ Hc.T + Hc @ C.T @ Hx.T + Hc @ Pp @ Hc.T + Rk
            K = (P @ Hx.T + C @ Hc.T) @ np.linalg.inv(S)
            x = x + K @ (z[k][there] - Hx @ x - Hc @ p)
            P = P - K @ S @ K.T
            C = C - K @ (Hx @ C + Hc @ Pp)
        np.testing.assert_allclose(track.mean[k], [*x, *p], rtol=0, atol=1e-10)
        np.testing.assert_allclose(track.cov[k], np.block([[P, C], [C.T, Pp]]), rtol=0, atol=1e-10)


@FORMS
def test_fixed_gain(form):
    """The covariance of a filter with a prescribed gain has Joseph's form, for any gain."""
    K = np.array([[0.3, 0.1, 0.0], [0.0, 0.1, 0.2]])
    z = simulate(np.random.default_rng(10), 15)
    track = run(make(gain=K, form=form), prior(), epochs(np.arange(15), z), keep="cov")
    x, P = np.zeros(2), P0
    for k in range(15):
        if k:
            x, P = A @ x, A @ P @ A.T + Q
        J = np.eye(2) - K @ H
        x, P = x + K @ (z[k] - H @ x), J @ P @ J.T + K @ R @ K.T
    np.testing.assert_allclose(track.mean[-1], x, rtol=0, atol=1e-11)
    np.testing.assert_allclose(track.cov[-1], P, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("bad", "name"),
    [
        (lambda: gate(0.0), "gamma"),
        (lambda: gate(np.nan), "gamma"),
        (lambda: chi_square_gate(1.0), "probability"),
        (lambda: innovation_window(0), "M"),
        (lambda: innovation_window(2.5), "M"),
        (lambda: innovation_window(3, "ignore"), "gaps"),
        (lambda: underweighting(0.0), "beta"),
        (lambda: underweighting(0.2, 1.0), "share"),
        (lambda: underweighting(0.2, -0.1), "share"),
        (lambda: consider(0, 2), "n"),
        (lambda: consider(2, -1), "k"),
        (lambda: seen(make(gain=consider(2, 2)), prior(), np.zeros(3)), "consider"),
    ],
)
def test_bad_input_is_refused_by_name(bad, name):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        bad()


@pytest.mark.parametrize("how", ["in place", "anew"])
@pytest.mark.parametrize("h", [np.eye(1, 2), lambda x, e: x[..., :1]], ids=["matrix", "function"])
def test_a_hook_may_write_into_the_joint(how, h):
    """Inflating the prior, including the rows of the state: the same in both forms, and the
    recorded innovation does not change.
    """

    def inflate(memory, joint, epoch):
        if how == "in place":
            for image in (joint.measurement, joint.state):
                image.columns[...] *= 2.0
            joint.innovation[...] *= 0.5
            joint.measurement_noise[...] *= 1.0 + (epoch.k > 0)  # the sensor's own stays as it is
            return memory, joint
        both = (
            image._replace(columns=2.0 * image.columns)
            for image in (joint.measurement, joint.state)
        )
        measurement, state = both
        return memory, joint._replace(
            measurement=measurement, state=state, innovation=0.5 * joint.innovation
        )

    P, motion, sensor = (
        np.array([[2.0, 0.5], [0.5, 1.0]]),
        Motion(np.eye(2), np.eye(2)),
        Sensor(h, [[1.0]]),
    )
    expected, _ = seen(
        sigma_point(motion, sensor, rule=unscented), Gaussian(np.zeros(2), 4.0 * P), [1.0]
    )
    for form in ("square root", "covariance"):
        prior = Gaussian(np.zeros(2), P)
        filter = sigma_point(motion, sensor, rule=unscented, form=form, hooks=[inflate])
        filter.update(filter.start(prior), Epoch(1, z=[2.0]))
        belief, info = seen(filter, prior, [2.0])
        np.testing.assert_allclose(belief.mean, expected.mean, atol=1e-14)
        np.testing.assert_allclose(belief.cov, expected.cov, atol=1e-14)
        np.testing.assert_array_equal(info.innovation, [2.0])
        np.testing.assert_array_equal(prior.cov, P)


def test_the_track_has_the_variances_that_each_update_used():
    """Three components, four runs: for each hook by its definition."""
    z, T = simulate(np.random.default_rng(9), 12, 4), 12
    z[5, 2, 0], z[7, :, 1], z[9] = np.nan, np.nan, np.nan
    nominal, times = np.diag(R), np.arange(12.0)
    runs = prior(4)

    def states(hook):
        return [(state, info) for _, state, (info,) in steps(make([hook]), runs, epochs(times, z))]

    track = run(make([variational_bayes(0.9)]), runs, times, z)
    assert track.extra["R"].shape == (T, 4, 3)
    assert np.isnan(track.extra["R"][9]).all()  # nothing was measured
    # R = beta / alpha, before the last of the rounds brings the next one.
    once = run(make([variational_bayes(0.9, rounds=1)]), runs, times, z).extra["R"]
    memories = [state.memory[0][0] for state, _ in states(variational_bayes(0.9, rounds=1))]
    before = (np.full((4, 3), 1.0), np.full((4, 3), 1.0))
    for k in [k for k in range(T) if k != 9]:
        used = ~np.isnan(z[k])
        alpha = np.where(used, 0.9 * before[0] + 0.5, before[0])
        beta = np.where(used, 0.9 * before[1], before[1])
        np.testing.assert_allclose(once[k], beta / alpha * nominal)
        before = memories[k]

    found = run(make([sage_husa(0.9)]), runs, times, z).extra["R"]
    for k, (state, info) in enumerate(states(sage_husa(0.9))):
        if info.R is not None:
            estimate = np.maximum(state.memory[0][0].noise, 0.25 * nominal)
            np.testing.assert_allclose(found[k], estimate)

    found = run(make([innovation_window(3)]), runs, times, z).extra["R"]
    for k, (state, info) in enumerate(states(innovation_window(3))):
        if info.R is not None:
            C = np.square(state.memory[0][0].samples).mean(0)
            S = info.sqrt_S @ info.sqrt_S.mT
            S0 = np.where(info.used, S.diagonal(0, -2, -1) - info.R, np.nan)
            expected = np.where(nominal < C - S0, C - S0, nominal)
            np.testing.assert_allclose(found[k][info.used], expected[info.used])
    assert (found > nominal + 1e-9).any()


def test_variances_of_sensors_stand_side_by_side():
    z = simulate(np.random.default_rng(10), 6, 2)
    motion, first, second = (
        Motion(A, Q),
        Sensor(H[:1], R[:1, :1]),
        Sensor(lambda x, e: x @ H[1:].T, R[1:, 1:]),
    )
    both, times = (z[..., :1], z[..., 1:]), np.arange(6.0)

    def track(hooks, **options):
        filter = sigma_point(motion, first, second, rule=unscented, hooks=hooks)
        return run(filter, prior(2), times, both, **options)

    np.testing.assert_allclose(
        track([gate(9.0)]).extra["R"], np.broadcast_to(np.diag(R), (6, 2, 3))
    )
    lists = track([[], [gate(9.0)]])
    np.testing.assert_allclose(lists.extra["R"], np.broadcast_to(np.diag(R)[1:], (6, 2, 2)))
    assert track([]).extra == {}
    assert track([gate(9.0)], keep="nothing").extra == {}
    mine = track([gate(9.0)], also=lambda epoch, state, infos: {"R": np.zeros(1)})
    assert not mine.extra["R"].any()
    np.testing.assert_array_equal(
        track([gate(9.0)], every=2).extra["R"], track([gate(9.0)]).extra["R"][::2]
    )


THREE = np.diag([0.9, 0.5, -0.3])
SEEN_BY_HOOKS = {
    "added": lambda hook, form: make([hook], form=form),
    "negative weights": lambda hook, form: make(
        [hook], rule=unscented(2, 0.5, 2.0, -1.0), form=form
    ),
    "colored": lambda hook, form: colored(
        Motion(A, Q), Sensor(H, R), THREE, hooks=[hook], form=form
    ),
    "colored, one": lambda hook, form: colored(
        Motion(A, Q), Sensor(H[:1], R[:1, :1]), THREE[:1, :1], hooks=[hook], form=form
    ),
    "decorrelated": lambda hook, form: decorrelated(
        Motion(A, Q), Sensor(H, R), THREE, hooks=[hook], form=form
    ),
}


@FORMS
@pytest.mark.parametrize("name", SEEN_BY_HOOKS)
def test_covariances_that_a_hook_sees_are_those_of_the_columns(name, form):
    """Covariances of the innovation without noise, of state and innovation, and of each component's
    noise.
    """
    seen = []

    def look(memory, joint, _epoch):
        seen.append(joint)
        return memory, joint

    z = simulate(np.random.default_rng(2), 4, 3)
    z = z[..., :1] if name == "colored, one" else z
    run(SEEN_BY_HOOKS[name](look, form), prior(3), epochs(np.arange(4), z))
    assert len(seen) >= 3  # a colored filter has its first measurement in its start
    for joint in seen:
        (columns, sign), m = joint.columns(), joint.innovation.shape[-1]
        V = np.zeros((m, 1)) if joint.measurement_noise is None else joint.measurement_noise
        whole = (columns * sign) @ columns.mT
        S0, cross = joint.covariances()
        np.testing.assert_allclose(S0 + V @ V.mT, whole[..., :m, :m], rtol=0, atol=1e-12)
        np.testing.assert_allclose(cross, whole[..., m:, :m], rtol=0, atol=1e-12)
        before, noise = joint.variances()
        np.testing.assert_allclose(before, S0.diagonal(0, -2, -1), rtol=0, atol=1e-12)
        np.testing.assert_allclose(noise, (V @ V.mT).diagonal(0, -2, -1), rtol=0, atol=1e-12)
