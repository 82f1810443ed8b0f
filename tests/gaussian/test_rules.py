"""Rules are exact to their degree, equal filterpy's, work inside filterpy, and transform any
function correctly.
"""

from itertools import product as cartesian

import numpy as np
import pytest
from filterpy.kalman import (
    JulierSigmaPoints,
    MerweScaledSigmaPoints,
    SimplexSigmaPoints,
    UnscentedKalmanFilter,
)
from hypothesis import given, settings
from hypothesis import strategies as st

import celnav
from celnav.gaussian.rules import (
    MAX_POINTS,
    Rule,
    Taylor,
    cubature,
    from_filterpy,
    gauss_hermite,
    simplex,
    tensor_product,
    unscented,
)
from celnav.gaussian.spaces import EUCLIDEAN

BATCHES = [(), (3,), (2, 3)]


def monomials(n, degree):
    """All exponents of n variables up to a degree."""
    return [e for e in cartesian(range(degree + 1), repeat=n) if sum(e) <= degree]


def gaussian_moment(exponents):
    """E[x^e] of a unit Gaussian: the product of (e - 1)!! over even exponents."""
    value = 1.0
    for e in exponents:
        value *= 0.0 if e % 2 else float(np.prod(np.arange(e - 1, 0, -2))) if e else 1.0
    return value


def moment(rule, exponents):
    return rule.wm @ np.prod(rule.nodes ** np.array(exponents), -1)


EXACT = {
    "unscented": (lambda n: unscented(n), 3),
    "unscented scaled": (lambda n: unscented(n, 0.5, 2.0, -1.0 if n > 1 else 1.0), 3),
    "unscented kappa = 3 - n": (lambda n: unscented(n, 1.0, 0.0, 3.0 - n), 3),
    "simplex": (simplex, 2),
    "cubature 3": (cubature, 3),
    "cubature 5": (lambda n: cubature(n, 5), 5),
    "gauss-hermite 2": (lambda n: gauss_hermite(n, 2), 3),
    "gauss-hermite 3": (lambda n: gauss_hermite(n, 3), 5),
    "gauss-hermite 4": (lambda n: gauss_hermite(n, 4), 7),
}


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize(("make", "degree"), EXACT.values(), ids=EXACT)
def test_rules_are_exact_to_their_degree(make, degree, n):
    rule = make(n)
    for exponents in monomials(n, degree):
        assert moment(rule, exponents) == pytest.approx(gaussian_moment(exponents), abs=1e-12)


@pytest.mark.parametrize(("make", "degree"), EXACT.values(), ids=EXACT)
def test_rules_are_not_exact_beyond_their_degree(make, degree):
    rule = make(2)
    worst = max(
        abs(moment(rule, e) - gaussian_moment(e))
        for e in monomials(2, degree + 1)
        if sum(e) == degree + 1
    )
    assert worst > 1e-3


@pytest.mark.parametrize("n", [6, 13])
def test_cubature_of_degree_five_is_exact_in_many_dimensions(n):
    rule = cubature(n, 5)
    assert rule.num_sigmas() == 2 * n * n + 1
    assert (rule.wm < 0.0).sum() == 2 * n
    x, w = rule.nodes, rule.wm
    fourth = np.einsum("p,pi,pj,pk,pl->ijkl", w, x, x, x, x, optimize=True)
    delta = np.eye(n)
    pairs = np.einsum("ij,kl->ijkl", delta, delta)
    expected = pairs + pairs.transpose(0, 2, 1, 3) + pairs.transpose(0, 3, 2, 1)
    np.testing.assert_allclose(fourth, expected, atol=1e-11)
    np.testing.assert_allclose(np.einsum("p,pi,pj,pk->ijk", w, x, x, x), 0.0, atol=1e-11)


def test_gauss_hermite_in_one_dimension_is_exact_to_twice_its_order():
    for order in range(2, 9):
        rule = gauss_hermite(1, order)
        for k in range(2 * order):
            assert moment(rule, (k,)) == pytest.approx(gaussian_moment((k,)), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize(("order", "n"), [(2, 3), (3, 3), (5, 2), (100, 1)])
def test_gauss_hermite_counts_its_points(order, n):
    rule = gauss_hermite(n, order)
    assert rule.num_sigmas() == order**n
    assert rule.wm.sum() == pytest.approx(1.0, abs=1e-12)


def test_counts_of_points():
    assert unscented(6).num_sigmas() == 12  # lambda = 0: the center has no weight
    assert unscented(6, 1.0, 2.0).num_sigmas() == 13
    assert cubature(6).num_sigmas() == 12
    assert simplex(6).num_sigmas() == 7


def test_small_alpha_keeps_the_mean_of_a_constant_and_its_digits():
    rule = unscented(3, 1e-3, 2.0, 0.0)
    assert rule.wm[0] < -1e5
    image = rule.image(np.full((7, 1), 7000.123456789), EUCLIDEAN, np.eye(3))
    assert image.center[0] + image.shift[0] == 7000.123456789
    assert not image.columns.any()


@pytest.mark.parametrize("alpha", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
def test_unscented_rules_of_small_alpha_are_accepted(alpha):
    assert unscented(6, alpha, 2.0, 0.0).num_sigmas() == 13


FILTERPY = {
    "merwe": lambda n: MerweScaledSigmaPoints(n, 0.5, 2.0, 3.0 - n),
    "merwe alpha 1e-3": lambda n: MerweScaledSigmaPoints(n, 1e-3, 2.0, 0.0),
    "julier": lambda n: JulierSigmaPoints(n, 1.0),
    "julier kappa < 0": lambda n: JulierSigmaPoints(n, -0.5),
    "simplex": SimplexSigmaPoints,
}


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("make", FILTERPY.values(), ids=FILTERPY)
def test_from_filterpy_keeps_nodes_and_weights(make, n):
    points = make(n)
    rule = from_filterpy(points)
    theirs = points.sigma_points(np.zeros(n), np.eye(n))

    def table(nodes, wm, wc):
        rows = np.column_stack([nodes, np.ravel(wm), np.ravel(wc)])
        return rows[np.lexsort(np.round(rows, 9).T)]

    ours = table(rule.nodes[-len(theirs) :], rule.wm[-len(theirs) :], rule.wc[-len(theirs) :])
    np.testing.assert_allclose(ours, table(theirs, points.Wm, points.Wc), atol=1e-9, rtol=1e-12)


class Points:
    """Four points of two states; the class has all the names that its objects have."""

    n, Wm, Wc = 2, np.full(4, 0.25), np.full(4, 0.25)

    def sigma_points(self, x, P):
        root = np.sqrt(2.0) * np.linalg.cholesky(P)
        return x + np.concatenate([root.T, -root.T])


def test_a_class_of_points_is_not_taken_for_an_object_of_it():
    np.testing.assert_array_equal(from_filterpy(Points()).wm[-4:], Points.Wm)
    for points in (Points, MerweScaledSigmaPoints, unscented, None):
        with pytest.raises(ValueError, match=r"^points: expected a filterpy sigma-point object"):
            from_filterpy(points)


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"), [(1.0, 0.0, 0.0), (0.5, 2.0, -1.0), (1e-3, 2.0, 0.0)]
)
def test_unscented_is_merwes(alpha, beta, kappa):
    x, P = np.array([1.0, -2.0, 3.0]), np.array([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 0.5]])
    theirs, ours = MerweScaledSigmaPoints(3, alpha, beta, kappa), unscented(3, alpha, beta, kappa)
    points = theirs.sigma_points(x, P)
    c = alpha**2 * (3 + kappa)
    digits = 8.0 * np.finfo(float).eps * max(1.0, 3.0 / c)  # filterpy forms c as (c - n) + n
    np.testing.assert_allclose(
        ours.sigma_points(x, P), points[-ours.num_sigmas() :], rtol=digits, atol=digits
    )
    np.testing.assert_allclose(ours.Wm, theirs.Wm[-ours.num_sigmas() :], rtol=digits)
    np.testing.assert_allclose(ours.Wc, theirs.Wc[-ours.num_sigmas() :], rtol=digits)


def turn(x, dt):
    """A nonlinear model of four states, for one point or many."""
    px, py, speed, heading = np.moveaxis(x, -1, 0)
    return np.stack(
        [
            px + dt * speed * np.cos(heading),
            py + dt * speed * np.sin(heading),
            0.99 * speed,
            heading + 0.1 * dt,
        ],
        -1,
    )


def radar(x):
    return np.stack([np.hypot(x[..., 0], x[..., 1]), x[..., 0] * x[..., 1] / 100.0], -1)


RULES = {
    "unscented": unscented(4),
    "negative center": unscented(4, 0.5, 2.0, -1.0),
    "alpha 1e-3": unscented(4, 1e-3, 2.0, 0.0),
    "simplex": simplex(4),
    "cubature 3": cubature(4),
    "cubature 5": cubature(4, 5),
    "gauss-hermite 2": gauss_hermite(4, 2),
    "gauss-hermite 3": gauss_hermite(4, 3),
}
MEAN, P0 = np.array([30.0, 40.0, 2.0, 0.3]), np.diag([4.0, 4.0, 0.1, 0.01])
Q, R = np.diag([0.1, 0.1, 0.01, 1e-4]), np.diag([0.5, 0.2])


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
def test_every_rule_works_inside_filterpy_and_gives_what_our_filter_gives(rule):
    kf = UnscentedKalmanFilter(4, 2, 1.0, hx=radar, fx=turn, points=rule)
    kf.x, kf.P, kf.Q, kf.R = MEAN.copy(), P0.copy(), Q, R
    truth, zs, theirs = MEAN + 0.5, [np.full(2, np.nan)], []
    rng = np.random.default_rng(2)
    for _ in range(15):
        truth = turn(truth, 1.0)
        zs.append(radar(truth) + np.sqrt(R.diagonal()) * rng.normal(size=2))
        kf.predict()
        kf.update(zs[-1])
        theirs.append(np.r_[kf.x, kf.P.ravel()])
    motion, sensor = (
        celnav.Motion(lambda x, epoch: turn(x, epoch.dt), Q),
        celnav.Sensor(lambda x, epoch: radar(x), R),
    )
    for form in ("square root", "covariance"):
        filter = celnav.sigma_point(motion, sensor, rule=rule, form=form)
        track = celnav.run(
            filter, celnav.Gaussian(MEAN, P0), np.arange(16.0), np.array(zs), keep="cov"
        )
        ours = np.concatenate([track.mean, track.cov.reshape(16, 16)], -1)[1:]
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
def test_images_are_the_weighted_sums_written_out(rule, batch):
    rng = np.random.default_rng(3)
    mean, root = (
        MEAN + rng.normal(size=(*batch, 4)),
        np.linalg.cholesky(P0) * np.ones((*batch, 1, 1)),
    )
    (points,), kept = rule.points(mean, root), rule.state_columns(root, ())
    image = rule.image(turn(points, 1.0), EUCLIDEAN, root)
    assert image.columns.shape == kept.shape
    assert len(rule.sign) in (1, kept.shape[-1])
    x = mean + np.einsum("...ij,pj->p...i", root, rule.nodes)
    y = turn(x, 1.0)
    y0 = np.broadcast_to(y[0], y.shape)
    expected_mean = y[0] + np.einsum("p,p...i->...i", rule.wm, y - y0)
    d = y - expected_mean
    expected = np.einsum("p,p...i,p...j->...ij", rule.wc, d, d)
    cross = np.einsum("p,p...i,p...j->...ij", rule.wc, d, x - mean)
    np.testing.assert_allclose(image.center + image.shift, expected_mean, rtol=1e-12)
    signed = image.columns * rule.sign
    np.testing.assert_allclose(signed @ image.columns.mT, expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(signed @ kept.mT, cross, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose((kept * rule.sign) @ kept.mT, root @ root.mT, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(image.jacobian() @ (root @ root.mT), cross, rtol=1e-7, atol=1e-8)


JACOBIAN = np.array([[1.0, 0.2, 0.0], [0.0, 1.0, -0.3]])


@pytest.mark.parametrize("about", [None, 0.3], ids=["the mean", "another point"])
@pytest.mark.parametrize("batch", BATCHES)
def test_taylor_has_the_jacobian(batch, about):
    rng = np.random.default_rng(4)
    mean, root = (
        rng.normal(size=(*batch, 3)),
        np.tril(rng.normal(size=(*batch, 3, 3))) + 3.0 * np.eye(3),
    )
    taylor = Taylor(about=None if about is None else mean + about)
    (points,) = taylor.points(mean, root)
    image = taylor.image(points @ JACOBIAN.T, EUCLIDEAN, root)
    np.testing.assert_allclose(
        image.jacobian(), np.broadcast_to(JACOBIAN, (*batch, 2, 3)), atol=1e-9
    )
    np.testing.assert_allclose(image.columns, JACOBIAN @ root, atol=1e-9)
    np.testing.assert_allclose(image.center + image.shift, mean @ JACOBIAN.T, atol=1e-9)


def turned(mean, epoch):
    """Jacobian of `turn` over a second."""
    one, zero, speed, c, s = (
        np.ones(mean.shape[:-1]),
        np.zeros(mean.shape[:-1]),
        mean[..., 2],
        np.cos(mean[..., 3]),
        np.sin(mean[..., 3]),
    )
    rows = (
        [one, zero, c, -speed * s],
        [zero, one, s, speed * c],
        [zero, zero, 0.99 * one, zero],
        [zero, zero, zero, one],
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


@pytest.mark.parametrize("batch", BATCHES)
def test_taylor_by_differences_is_taylor_by_jacobian(batch):
    """For a motion and for a sensor."""
    root, mean = np.linalg.cholesky(P0), MEAN + np.random.default_rng(6).normal(size=(*batch, 4))
    (points,) = Taylor().points(mean, root)
    image = Taylor().image(turn(points, 1.0), EUCLIDEAN, root)
    np.testing.assert_allclose(image.columns, turned(mean, None) @ root, atol=1e-8)
    f, prior = lambda x, epoch: turn(x, 1.0), celnav.Gaussian(mean, P0)
    at, no = celnav.Epoch(1, 1.0, 1.0, z=turn(MEAN, 1.0) + 0.1), np.zeros((4, 4))
    for known in ({"jacobian": turned}, {}):
        moving = celnav.ekf(celnav.Motion(f, Q, **known))
        state = moving.predict(moving.start(prior), at).belief
        np.testing.assert_allclose(state.mean, turn(mean, 1.0), rtol=1e-12)
        np.testing.assert_allclose(
            state.cov, turned(mean, None) @ P0 @ turned(mean, None).mT + Q, atol=1e-8
        )
        seeing = celnav.ekf(celnav.Motion(np.eye(4), no), celnav.Sensor(f, Q, **known))
        state, (info,) = seeing.update(seeing.start(prior), at)
        np.testing.assert_allclose(info.jacobian(), turned(mean, None), atol=1e-8)
        S = info.jacobian() @ P0 @ info.jacobian().mT + Q
        np.testing.assert_allclose(info.gain() @ S, P0 @ info.jacobian().mT, atol=1e-8)


def test_a_jacobian_says_what_shape_it_must_have():
    for wrong in (np.ones((2, 3)), np.ones(4)):
        filter = celnav.ekf(
            celnav.Motion(lambda x, epoch: turn(x, 1.0), Q, jacobian=lambda mean, epoch, J=wrong: J)
        )
        with pytest.raises(
            ValueError, match=r"jacobian: expected shape \(\.\.\., 4, n\) to go with f, got"
        ):
            filter.predict(filter.start(celnav.Gaussian(MEAN, P0)), celnav.Epoch(1, 1.0, 1.0))


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(BATCHES), st.integers(1, 4), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_points_have_the_moments_of_state_and_noise(batch, n, k, seed):
    rng = np.random.default_rng(seed)
    mean, root = rng.normal(size=(*batch, n)), np.tril(rng.normal(size=(*batch, n, n)))
    noise = [rng.normal(size=(2, k))] if k else []
    rule = unscented(n + k)
    X, *W = rule.points(mean, root, EUCLIDEAN, noise)
    assert X.shape == (len(rule.wm), *batch, n)
    d = X - mean
    np.testing.assert_allclose(
        np.einsum("p,p...i,p...j->...ij", rule.wm, d, d), root @ root.mT, atol=1e-10
    )
    if k:
        assert W[0].shape == (len(rule.wm), *batch, 2)
        np.testing.assert_allclose(
            np.einsum("p,p...i,p...j->...ij", rule.wm, W[0], W[0]),
            np.broadcast_to(noise[0] @ noise[0].T, (*batch, 2, 2)),
            atol=1e-10,
        )
        np.testing.assert_allclose(
            np.einsum("p,p...i,p...j->...ij", rule.wm, d, W[0]), 0.0, atol=1e-10
        )


def test_a_rule_of_the_wrong_dimension_says_so():
    with pytest.raises(ValueError, match=r"rule: expected 4 dimensions.*got 3"):
        unscented(3).points(np.zeros(2), np.eye(2), EUCLIDEAN, [np.eye(2)])


def test_rules_cannot_be_changed():
    rule = unscented(2)
    with pytest.raises(ValueError, match="read-only"):
        rule.nodes[0, 0] = 1.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: unscented(0), "n: expected a positive integer"),
        (lambda: unscented(-2), "n: expected a positive integer"),
        (lambda: unscented(1.5), "n: expected a positive integer"),
        (lambda: unscented(True), "n: expected a positive integer"),
        (lambda: unscented(float("nan")), "n: expected a positive integer"),
        (lambda: unscented(float("inf")), "n: expected a positive integer"),
        (lambda: unscented("two"), "n: expected a positive integer"),
        (lambda: unscented(2, 0.0), "alpha"),
        (lambda: unscented(2, -1.0), "alpha"),
        (lambda: unscented(2, float("nan")), "alpha"),
        (
            lambda: unscented(2, 1e-7, 2.0),
            "^alpha, kappa, wm: expected weights that leave three digits",
        ),
        (
            lambda: unscented(2, 1.0, 2.0, 1e-13 - 2.0),
            "^alpha, kappa, wm: expected weights that leave",
        ),
        (
            lambda: from_filterpy(MerweScaledSigmaPoints(2, 1e-8, 2.0, 0.0)),
            "^alpha, kappa, wm: expected weights that leave three digits of a mean, got 9.01e.15 "
            "times",
        ),
        (lambda: unscented(2, 1.0, float("inf")), "beta"),
        (lambda: unscented(2, 1.0, 0.0, -2.0), "kappa: expected a number above -2, got -2"),
        (lambda: unscented(2, 1.0, 0.0, -3.0), "kappa"),
        (lambda: cubature(2, 4), "degree: expected one of 3, 5, got 4"),
        (lambda: gauss_hermite(2, 0), "order"),
        (lambda: gauss_hermite(2, 1), "order"),
        (lambda: gauss_hermite(2, 2.5), "order"),
        (lambda: gauss_hermite(2, float("nan")), "order"),
        (lambda: gauss_hermite(2, 101), "order"),
        (lambda: gauss_hermite(9, 7), "7\\*\\*9 = 40353607 points"),
        (lambda: Rule(np.zeros((0, 2)), []), "nodes"),
        (lambda: Rule([[1.0], [-1.0]], [0.5, 0.5]), "nodes: expected the center first"),
        (lambda: Rule([[0.0], [1.0], [-1.0]], [0.0, 0.5, 0.4]), "wm: expected a sum of 1"),
        (lambda: Rule([[0.0], [1.0], [-1.0]], [0.0, 0.75, 0.25]), "wm: expected sum wm nodes = 0"),
        (lambda: Rule([[0.0], [2.0], [-2.0]], [0.0, 0.5, 0.5]), "wc"),
        (lambda: Rule([[0.0], [1.0]], [0.0, 0.5, 0.5]), "wm: expected shape"),
        (lambda: Taylor(step=0.0), "step"),
        (lambda: unscented(2).sigma_points([0.0], np.eye(2)), "x: expected 2 components, got 1"),
        (
            lambda: unscented(2).sigma_points([0.0, 0.0], -np.eye(2)),
            "P: expected a positive semidefinite",
        ),
    ],
)
def test_rules_refuse_and_say_what(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_the_limit_of_points_is_checked_before_they_are_made():
    assert MAX_POINTS < 10**10
    with pytest.raises(ValueError, match=f"expected at most {MAX_POINTS} points"):
        gauss_hermite(50, 10)


def test_a_product_leaves_out_only_nodes_without_any_weight():
    """Only nodes with both weights 0, not with one; the moments equal the factors' moments."""
    sides = np.array([[0.0], [1.0], [-1.0], [2.0], [-2.0], [3.0], [-3.0]])
    wm = np.array([0.5, 0.25, 0.25, 0.0, 0.0, 0.0, 0.0])
    wc = np.array([0.75, 0.0, 0.0, 0.125, 0.125, 0.0, 0.0])
    mixed = Rule(sides, wm, wc)
    other = gauss_hermite(1, 3)
    product = tensor_product(mixed, other)
    assert product.num_sigmas() == 5 * 3
    for i, j in cartesian(range(5), repeat=2):
        x, y = product.nodes.T
        for weights, own in ((product.wm, wm), (product.wc, wc)):
            expected = (own @ sides[:, 0] ** i) * (other.wm @ other.nodes[:, 0] ** j)
            np.testing.assert_allclose(weights @ (x**i * y**j), expected, atol=1e-12)


def test_a_rule_cannot_be_written_into():
    nodes, wm = np.array([[0.0], [1.0], [-1.0]]), np.array([0.0, 0.5, 0.5])
    rule = Rule(nodes, wm)
    for array in (rule.nodes, rule.wm, rule.wc, rule.sign):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
    nodes[:], wm[:] = 7.0, 7.0
    assert rule.nodes.tolist() == [[0.0], [1.0], [-1.0]]
    assert rule.wm.tolist() == [0.0, 0.5, 0.5]
