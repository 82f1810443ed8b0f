"""Spaces: plus and minus are inverse, angles wrap, products act on each part."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import celnav
from celnav.gaussian.attitude import attitude
from celnav.gaussian.spaces import EUCLIDEAN, Space, angles, product, wrap

reals = st.floats(-50.0, 50.0)


@given(st.floats(-1e6, 1e6))
def test_wrap_is_congruent_and_in_range(a):
    w = wrap(a)
    assert -np.pi <= w < np.pi
    assert abs(np.sin(0.5 * (w - a))) < 1e-9


def test_wrap_at_the_edges():
    np.testing.assert_allclose(
        wrap(np.array([np.pi, -np.pi, 3.0 * np.pi, 0.0])), [-np.pi, -np.pi, -np.pi, 0.0], atol=1e-15
    )
    assert wrap(np.nextafter(-np.pi, -10.0)) < np.pi


SPACES = {
    "euclidean": EUCLIDEAN,
    "all angles": angles(),
    "some angles": angles([0, 2]),
    "product": product((angles(), 1, 1), (EUCLIDEAN, 2, 2)),
}


@pytest.mark.parametrize("space", SPACES.values(), ids=SPACES)
@given(st.lists(reals, min_size=6, max_size=6))
def test_minus_leads_back(space, numbers):
    a, b = (
        space.plus(np.zeros(3), np.array(numbers[:3])),
        space.plus(np.zeros(3), np.array(numbers[3:])),
    )
    back = space.plus(a, space.minus(b, a))
    difference = space.minus(back, b)  # on a circle -pi and pi are neighbors
    assert np.abs(difference).max() < 1e-12


def test_angles_wrap_the_named_components_only():
    space = angles([1])
    np.testing.assert_allclose(
        space.minus(np.array([4.0, 3.0]), np.array([-4.0, -3.0])), [8.0, 6.0 - 2.0 * np.pi]
    )
    np.testing.assert_allclose(
        space.plus(np.array([3.0, 3.0]), np.array([1.0, 1.0])), [4.0, 4.0 - 2.0 * np.pi]
    )


def test_spaces_leave_their_arguments_alone():
    a, b = np.array([3.0, 3.0, 3.0]), np.array([1.0, 1.0, 1.0])
    for space in SPACES.values():
        space.plus(a, b)
        space.minus(a, b)
    np.testing.assert_array_equal(a, [3.0, 3.0, 3.0])
    np.testing.assert_array_equal(b, [1.0, 1.0, 1.0])


def circle():
    """Unit vectors of the plane: points of two components, tangents of one."""

    def plus(point, tangent):
        c, s = np.cos(tangent[..., 0]), np.sin(tangent[..., 0])
        x, y = point[..., 0], point[..., 1]
        return np.stack([c * x - s * y, s * x + c * y], -1)

    def minus(b, a):
        cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        return np.arctan2(cross, (a * b).sum(-1))[..., None]

    return Space(plus, minus, lambda tangent: 2.0 * np.ones((*tangent.shape[:-1], 1, 1)))


@pytest.mark.parametrize("batch", [(), (3,), (4, 3)])
def test_a_product_acts_part_by_part(batch):
    rng = np.random.default_rng(1)
    space = product((circle(), 2, 1), (EUCLIDEAN, 2, 2), (angles(), 1, 1))
    angle = rng.uniform(-3.0, 3.0, batch)
    point = np.concatenate(
        [np.stack([np.cos(angle), np.sin(angle)], -1), rng.normal(size=(*batch, 3))], -1
    )
    tangent = rng.normal(size=(*batch, 4))
    moved = space.plus(point, tangent)
    np.testing.assert_allclose(moved[..., :2], circle().plus(point[..., :2], tangent[..., :1]))
    np.testing.assert_allclose(moved[..., 2:4], point[..., 2:4] + tangent[..., 1:3])
    np.testing.assert_allclose(moved[..., 4], wrap(point[..., 4] + tangent[..., 3]))
    np.testing.assert_allclose(
        space.minus(moved, point),
        np.concatenate([tangent[..., :3], wrap(tangent[..., 3:])], -1),
        atol=1e-14,
    )


def test_a_product_transports_its_curved_part_only():
    matrix = product((circle(), 2, 1), (EUCLIDEAN, 2, 2)).transport(np.zeros((5, 3)))
    np.testing.assert_array_equal(matrix, np.broadcast_to(np.diag([2.0, 1.0, 1.0]), (5, 3, 3)))
    assert product((EUCLIDEAN, 1, 1), (angles(), 1, 1)).transport is None


@pytest.mark.parametrize("count", [2, 4])
def test_a_product_has_deviations_of_one_length(count):
    space = product((circle(), 2, 1), (EUCLIDEAN, 2, 2))
    with pytest.raises(ValueError, match=f"^deviations: expected 3 components .*, got {count}$"):
        space.plus(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((5, count)))


def test_a_product_broadcasts_points_against_one_center():
    space = product((circle(), 2, 1), (EUCLIDEAN, 1, 1))
    cloud = space.plus(np.array([1.0, 0.0, 5.0]), np.zeros((7, 3, 2)))
    np.testing.assert_array_equal(cloud, np.broadcast_to([1.0, 0.0, 5.0], (7, 3, 3)))


def test_a_product_refuses_a_part_with_a_mean_of_its_own():
    with pytest.raises(ValueError, match="factors"):
        product((Space(mean=lambda points, weights: points[0]), 1, 1), (EUCLIDEAN, 1, 1))


def test_angles_may_come_as_integers():
    """Also as lists or in half precision: differences are floats."""
    space = celnav.angles([0])
    for make in (
        list,
        np.array,
        lambda v: np.array(v, np.float32),
        lambda v: np.array(v, np.uint8),
    ):
        np.testing.assert_allclose(
            space.minus(make([6, 7]), make([1, 9])), [5.0 - 2.0 * np.pi, -2.0]
        )
        np.testing.assert_allclose(
            space.plus(make([3, 7]), make([1, 9])), [4.0 - 2.0 * np.pi, 16.0]
        )
        np.testing.assert_allclose(
            celnav.angles().minus(np.asarray(make([6, 7])), make([1, 9])), [5.0 - 2.0 * np.pi, -2.0]
        )


@pytest.mark.parametrize(
    ("factor", "message"),
    [
        ((attitude(), 3, 3), r"factors: points of length 3: expected shape \(..., 4\), got \(3,\)"),
        (
            (attitude(), 4, 4),
            r"factors: expected tangents of length 3 to go with points of length 4, "
            r"as in \(space, 4, 3\), got 4",
        ),
        ((EUCLIDEAN, 4, 3), r"factors: expected tangents of length 4 .*, as in \(space, 4, 4\)"),
        ((circle(), 2, 2), r"factors: expected tangents of length 1 .*, as in \(space, 2, 1\)"),
        (
            (angles([5]), 3, 3),
            "angles: expected components below 3, the length of the vector, got 5",
        ),
    ],
)
def test_lengths_that_a_space_does_not_have_are_refused_where_they_are_given(factor, message):
    """The error comes at the call, not in the first run."""
    with pytest.raises(ValueError, match="^" + message):
        product(factor, (EUCLIDEAN, 12, 12))


BY_NAME = product(q=attitude(), v=3, course=(angles(), 1), bias=2)
BY_PLACE = product((attitude(), 4, 3), (EUCLIDEAN, 3, 3), (angles(), 1, 1), (EUCLIDEAN, 2, 2))


def points(count=5, seed=0):
    x = np.random.default_rng(seed).standard_normal((count, 10))
    x[:, :4] /= np.linalg.norm(x[:, :4], axis=1, keepdims=True)
    x[:, 7] = wrap(3.0 * x[:, 7])
    return x


def test_a_product_by_name_is_the_product_by_place():
    a, b = points(), points(seed=1)
    d = BY_NAME.minus(b, a)
    np.testing.assert_array_equal(d, BY_PLACE.minus(b, a))
    np.testing.assert_array_equal(BY_NAME.plus(a, d), BY_PLACE.plus(a, d))
    assert (BY_NAME.size, d.shape[-1]) == (10, 9)


def test_a_part_is_taken_by_its_name_from_points_and_from_deviations():
    x, d = points(), np.arange(9.0)
    np.testing.assert_array_equal(BY_NAME.part(x, "q"), x[:, :4])
    np.testing.assert_array_equal(BY_NAME.part(x, "bias"), x[:, 8:])
    np.testing.assert_array_equal(BY_NAME.part(d, "q"), d[:3])
    np.testing.assert_array_equal(BY_NAME.part(d, "course"), d[6:7])
    assert BY_NAME.labels == ["q0", "q1", "q2", "v0", "v1", "v2", "course", "bias0", "bias1"]
    assert BY_PLACE.labels == []
    nested = product(body=BY_NAME, clock=1)
    assert nested.labels == [*BY_NAME.labels, "clock"]
    np.testing.assert_array_equal(nested.part(np.r_[x[0], 7.0], "clock"), [7.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: BY_NAME.part(points(), "velocity"),
            "name: expected one of q, v, course, bias, got 'velocity'",
        ),
        (lambda: BY_NAME.part(np.zeros(8), "v"), "x: expected points of 10 components or .* of 9"),
        (lambda: BY_PLACE.part(points(), "v"), "space: expected a product with names"),
        (lambda: product(q=attitude(), p=0), "p: expected a positive integer, got 0"),
        (lambda: product(q=attitude(), p="3"), "p: expected a positive integer, got '3'"),
        (lambda: product(course=angles()), r"course: .*, such as \(celnav.angles\(\), 1\)"),
        (lambda: product(q=(attitude(), 3)), r"q: expected shape \(..., 4\), got \(3,\)"),
        (lambda: product((EUCLIDEAN, 3, 3), p=3), "factors: expected all parts .* by name, or non"),
    ],
)
def test_what_has_no_name_or_length_is_refused(make, message):
    with pytest.raises(ValueError, match="^" + message):
        make()


def test_named_vectors_are_vectors():
    """They work with matrices; the number of components is checked."""
    space = product(p=1, v=1)
    assert space == EUCLIDEAN
    assert hash(space) == hash(EUCLIDEAN)
    assert BY_NAME != BY_PLACE
    motion = celnav.Motion([[1.0, 1.0], [0.0, 1.0]], np.eye(2), space=space)
    flt = celnav.ukf(motion, celnav.Sensor([[1.0, 0.0]], 1.0))
    track = celnav.run(flt, celnav.Gaussian(np.zeros(2), 1.0), np.arange(5.0), np.ones((5, 1)))
    plain = celnav.ukf(celnav.Motion(motion.f, motion.Q), *flt.sensors)
    same = celnav.run(plain, celnav.Gaussian(np.zeros(2), 1.0), np.arange(5.0), np.ones((5, 1)))
    np.testing.assert_allclose(track.mean, same.mean, rtol=1e-14)
    with pytest.raises(ValueError, match=r"^prior: expected 2 components for the product space"):
        flt.start(celnav.Gaussian(np.zeros(3), 1.0))


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
def test_a_track_gives_the_belief_of_a_part(engine):
    def f(x, epoch):
        q, v = BY_NAME.part(x, "q"), BY_NAME.part(x, "v")
        return np.concatenate([q, v + epoch.dt, x[..., 7:]], -1)

    motion = celnav.Motion(f, np.eye(9), space=BY_NAME)
    flt = celnav.ekf(motion, celnav.Sensor(lambda x, epoch: BY_NAME.part(x, "v"), np.eye(3)))
    prior = celnav.Gaussian(points(2), np.eye(9))
    z = np.random.default_rng(0).standard_normal((4, 2, 3))
    track = celnav.run(flt, prior, np.arange(4.0), z, keep="cov", engine=engine)
    v = track.part("v")
    np.testing.assert_array_equal(v.mean, track.mean[..., 4:7])
    np.testing.assert_array_equal(v.cov, track.cov[..., 3:6, 3:6])
    np.testing.assert_allclose(v.std, BY_NAME.part(track.std, "v"), rtol=1e-12)
    with pytest.raises(ValueError, match=r"^name: expected one of q, v, course, bias, got 'p'"):
        track.part("p")
