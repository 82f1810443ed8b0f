"""filterpy's usual programs, run with filterpy's class and with both of celnav's."""

from __future__ import annotations

import pickle
import sys
from copy import deepcopy

import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise, Saver
from filterpy.kalman import (
    JulierSigmaPoints,
    MerweScaledSigmaPoints,
    SimplexSigmaPoints,
    UnscentedKalmanFilter,
)
from filterpy.kalman.unscented_transform import unscented_transform

import celnav
from celnav.filters.dropin import SigmaPointUKF, SquareRootUKF

OURS = [SquareRootUKF, SigmaPointUKF]


def velocity(x, dt):
    return np.array([x[0] + dt * x[1], x[1], x[2] + dt * x[3], x[3]])


def ranging(x, offset=0.0):
    return np.array([np.hypot(x[0], x[2]) + offset, np.arctan2(x[2], x[0])])


def tracker(cls, points=None, **options):
    kf = cls(
        4, 2, 0.1, ranging, velocity, points or MerweScaledSigmaPoints(4, 0.3, 2.0, -1.0), **options
    )
    kf.x = np.array([10.0, -1.0, 5.0, 1.0])
    kf.P *= 0.2
    kf.R = np.diag([0.1, 0.01]) ** 2
    kf.Q = Q_discrete_white_noise(dim=2, dt=0.1, var=0.01, block_size=2)
    return kf


def measurements(count=20):
    rng = np.random.default_rng(3)
    x = np.array([10.0, -1.0, 5.0, 1.0])
    out = []
    for _ in range(count):
        x = velocity(x, 0.1)
        out.append(ranging(x) + rng.normal(size=2) * [0.1, 0.01])
    return out


def same(a, b, names=("x", "P", "x_prior", "P_prior", "x_post", "P_post", "K", "y", "S", "SI")):
    for name in names:
        np.testing.assert_allclose(
            getattr(a, name), getattr(b, name), rtol=1e-6, atol=1e-9, err_msg=name
        )


@pytest.mark.parametrize("cls", OURS)
@pytest.mark.parametrize(
    "points",
    [
        MerweScaledSigmaPoints(4, 0.3, 2.0, -1.0),
        MerweScaledSigmaPoints(4, 1.0, 0.0, 0.0),
        JulierSigmaPoints(4, 1.0),
        SimplexSigmaPoints(4),
    ],
    ids=lambda p: type(p).__name__,
)
def test_predict_and_update_equal_filterpy(cls, points):
    peer, ours = tracker(UnscentedKalmanFilter, points), tracker(cls, points)
    for z in measurements():
        for kf in (peer, ours):
            kf.predict()
            kf.update(z)
        same(ours, peer)
    np.testing.assert_allclose(ours.log_likelihood, peer.log_likelihood, rtol=1e-7)
    np.testing.assert_allclose(ours.likelihood, peer.likelihood, rtol=1e-6)
    np.testing.assert_allclose(ours.mahalanobis, peer.mahalanobis, rtol=1e-6)
    np.testing.assert_allclose(ours.sigmas_f, peer.sigmas_f, atol=1e-7)
    assert cls.__name__ in repr(ours)


@pytest.mark.parametrize("cls", OURS)
def test_arguments_missing_samples_and_other_sensors(cls):
    kfs = [tracker(UnscentedKalmanFilter), tracker(cls)]
    for kf in kfs:
        kf.predict(dt=0.2)
        kf.update(None)
        kf.predict()
        kf.update(measurements(1)[0], R=0.02, offset=0.1)
        kf.predict()
        kf.update(np.array([10.0]), R=np.array([[0.5]]), hx=lambda x: x[:1])
        kf.predict(UT=unscented_transform)
        kf.update(measurements(2)[1], UT=unscented_transform)
    same(kfs[1], kfs[0])


@pytest.mark.parametrize("cls", OURS)
def test_scalar_measurements(cls):
    kfs = []
    for kind in (UnscentedKalmanFilter, cls):
        kf = kind(
            2,
            1,
            1.0,
            lambda x: x[:1],
            lambda x, dt: np.array([x[0] + x[1] * dt, x[1]]),
            MerweScaledSigmaPoints(2, 0.1, 2.0, 1.0),
        )
        kf.Q *= 0.01
        for z in (1.0, 2.1, 2.9):
            kf.predict()
            kf.update(z)
        kfs.append(kf)
    same(kfs[1], kfs[0], ("x", "P"))


def wrapped(a, b):
    y = a - b
    y[1] = (y[1] + np.pi) % (2 * np.pi) - np.pi
    return y


def mean_angle(sigmas, Wm):
    return np.array(
        [Wm @ sigmas[:, 0], np.arctan2(Wm @ np.sin(sigmas[:, 1]), Wm @ np.cos(sigmas[:, 1]))]
    )


@pytest.mark.parametrize("cls", OURS)
def test_angles_with_own_means_and_residuals(cls):
    kfs = []
    for kind in (UnscentedKalmanFilter, cls):
        kf = tracker(kind, z_mean_fn=mean_angle, residual_z=wrapped)
        kf.x = np.array([-10.0, 0.0, 0.05, 0.1])
        for z in ([10.0, 3.1], [10.1, -3.12], [10.0, -3.1]):
            kf.predict()
            kf.update(np.array(z))
        kfs.append(kf)
    same(kfs[1], kfs[0])


@pytest.mark.parametrize("cls", OURS)
def test_a_residual_of_its_own_meets_a_component_without_noise(cls):
    kf = cls(
        2,
        2,
        1.0,
        lambda x: x,
        lambda x, dt: x,
        MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0),
        residual_z=wrapped,
    )
    kf.R = np.diag([0.0, 0.1])
    kf.predict()
    kf.update([0.3, 0.2])
    np.testing.assert_allclose(kf.x, [0.3, 0.2 * 2.0 / 2.1], atol=1e-12)
    np.testing.assert_allclose(kf.P, np.diag([0.0, 0.2 / 2.1]), atol=1e-12)


@pytest.mark.parametrize("cls", OURS)
def test_batch_filter_and_smoother(cls):
    peer, ours = tracker(UnscentedKalmanFilter), tracker(cls)
    zs, savers = measurements(), []
    for kf in (peer, ours):
        saver = Saver(kf)
        means, covs = kf.batch_filter(zs, Rs=[kf.R] * 20, dts=[0.1] * 20, saver=saver)
        savers.append((means, covs, saver, *kf.rts_smoother(means, covs)))
    for i in (0, 1, 3, 4, 5):
        np.testing.assert_allclose(savers[1][i], savers[0][i], rtol=1e-6, atol=1e-9)
    assert len(savers[1][2].x) == 20
    loop = tracker(cls)
    for z in zs:
        loop.predict()
        loop.update(z)
    np.testing.assert_array_equal(savers[1][0][-1], loop.x)


@pytest.mark.parametrize("cls", OURS)
def test_celnav_rules_and_vectorized_models(cls):
    def all_points(x, dt):
        return np.stack([x[:, 0] + dt * x[:, 1], x[:, 1], x[:, 2] + dt * x[:, 3], x[:, 3]], -1)

    one = tracker(cls, celnav.cubature(4))
    every = cls(
        4,
        2,
        0.1,
        lambda x: np.stack([np.hypot(x[:, 0], x[:, 2]), np.arctan2(x[:, 2], x[:, 0])], -1),
        all_points,
        celnav.cubature(4),
        vectorized=True,
    )
    every.x, every.P, every.Q, every.R = one.x, one.P, one.Q, one.R
    for z in measurements(5):
        for kf in (one, every):
            kf.predict()
            kf.update(z)
    same(every, one)


@pytest.mark.parametrize("cls", OURS)
def test_covariances_changed_in_place_or_singular_are_taken_up(cls):
    kf, peer = tracker(cls), tracker(UnscentedKalmanFilter)
    for f in (kf, peer):
        f.predict()
        f.P[0, 0] = 5.0
        f.P *= 2.0
        f.sigmas_f = f.points_fn.sigma_points(f.x, f.P)
        f.update(measurements(1)[0])
    same(kf, peer, ("x", "P"))
    kf.P = np.diag([1.0, 0.0, 1.0, 0.0])
    kf.predict()
    F = np.kron(np.eye(2), [[1.0, 0.1], [0.0, 1.0]])
    np.testing.assert_allclose(kf.P, F @ np.diag([1.0, 0.0, 1.0, 0.0]) @ F.T + kf.Q, atol=1e-12)


@pytest.mark.parametrize("cls", OURS)
def test_partly_missing_components_are_left_out_exactly(cls):
    kf, only = tracker(cls), tracker(cls)
    for f, z, options in (
        (kf, [10.0, np.nan], {}),
        (only, [10.0], {"hx": lambda x: ranging(x)[:1], "R": np.array([[0.01]])}),
    ):
        f.predict()
        f.update(np.array(z), **options)
    np.testing.assert_allclose(kf.x, only.x, atol=1e-12)
    np.testing.assert_allclose(kf.P, only.P, atol=1e-12)


@pytest.mark.parametrize("cls", OURS)
@pytest.mark.parametrize(
    ("change", "call", "name"),
    [
        ({}, {"z": [1.0, np.inf]}, "z"),
        ({}, {"z": "far"}, "z"),
        ({}, {"z": [1.0, np.nan], "UT": unscented_transform}, "z: expected every component"),
        ({}, {"z": [1.0, 2.0, 3.0]}, "z"),
        ({}, {"z": np.zeros((2, 2))}, "z"),
        ({"R": -np.eye(2)}, {"z": [1.0, 2.0]}, "R"),
        ({"R": np.eye(3)}, {"z": [1.0, 2.0]}, "R"),
        ({"Q": -np.eye(4)}, {}, "Q"),
        ({"P": np.triu(np.ones((4, 4)))}, {}, "P"),
        ({"P": np.eye(3)}, {}, "P"),
        ({"P": np.full((4, 4), np.nan)}, {}, "P"),
        ({"x": np.full(4, np.nan)}, {}, "x"),
        ({"x": np.zeros(3)}, {}, "x"),
        ({}, {"dt": np.nan}, "dt"),
        ({}, {"dt": np.timedelta64(1, "s")}, "dt"),
        (
            {},
            {"z": np.array(["2026-11-22", "2026-11-23"], "datetime64[s]")},
            "z: expected numbers, got dates",
        ),
        (
            {},
            {"z": [np.datetime64("2026-11-22"), np.datetime64("2026-11-23")]},
            "z: expected numbers, got dates",
        ),
        ({}, {"z": [1.0, 2.0], "R": np.timedelta64(1, "s")}, "R: expected numbers, got dates"),
        ({"x": np.zeros(4, "datetime64[s]")}, {}, "x: expected numbers, got dates"),
        ({"P": np.zeros((4, 4), "timedelta64[s]")}, {}, "P: expected numbers, got dates"),
        ({"fx": lambda x, dt: np.zeros(4, "datetime64[s]")}, {}, "fx: expected numbers, got dates"),
        (
            {"hx": lambda x: np.zeros(2, "timedelta64[s]")},
            {"z": [1.0, 2.0]},
            "hx: expected numbers, got dates",
        ),
        ({"Q": [0.1, 0.2, 0.3, 0.4]}, {}, "Q"),
        ({"Q": np.diag([0.1, 0.2, 0.3, 0.4]) + 1e-3 * np.tri(4, k=-1)}, {}, "Q"),
        ({"R": "small"}, {"z": [1.0, 2.0]}, "R"),
        ({"Wm": np.ones(9)}, {}, "wm"),
        ({"fx": lambda x, dt: x[:1]}, {}, r"fx returned shape \(1,\), expected \(4,\)"),
        ({"fx": lambda x, dt: x * np.nan}, {}, "fx is not finite at sigma point 0"),
        ({"hx": lambda x: x}, {"z": [1.0, 2.0]}, "hx returned shape"),
    ],
)
def test_bad_input_is_refused_by_name_and_changes_nothing(cls, change, call, name):
    kf = tracker(cls)
    kf.predict()
    for key, value in change.items():
        setattr(kf, key, value)
    before = np.array(kf.x), np.array(kf.P), kf.x_prior.copy()
    with pytest.raises(ValueError, match=f"^{name}"):
        (kf.update if "z" in call else kf.predict)(**call)
    for now, then in zip((kf.x, kf.P, kf.x_prior), before, strict=True):
        np.testing.assert_array_equal(now, then)


@pytest.mark.parametrize("cls", OURS)
def test_copies_go_on_bit_for_bit_and_share_nothing(cls):
    kf = tracker(cls)
    kf.predict()
    twin = deepcopy(kf)
    x0, P0 = np.zeros(4), np.eye(4)
    kf.update(measurements(1)[0])
    twin.update(measurements(1)[0])
    np.testing.assert_array_equal(kf.x, twin.x)
    a, b = tracker(cls), tracker(cls)
    a.x = b.x = x0
    a.P = b.P = P0
    a.predict()
    np.testing.assert_array_equal(x0, np.zeros(4))
    np.testing.assert_array_equal(P0, np.eye(4))
    np.testing.assert_array_equal(b.P, np.eye(4))
    with pytest.raises(ValueError, match=r"^points"):
        cls(3, 2, 0.1, ranging, velocity, MerweScaledSigmaPoints(4, 1.0, 0.0, 0.0))


def test_the_root_is_kept_and_is_the_covariances():
    kf = tracker(SquareRootUKF)
    for z in measurements(5):
        kf.predict()
        kf.update(z)
    np.testing.assert_allclose(kf.sqrt_P @ kf.sqrt_P.T, kf.P, rtol=1e-12)


def test_a_sum_of_states_is_none_of_measurements():
    """``state_add`` is for states with n components; a measurement with its residual function does
    not use it.
    """

    def add(x, y):
        assert len(x) == len(y) == 2
        return x + y

    def residual(a, b):
        return (a - b + np.pi) % (2.0 * np.pi) - np.pi

    points = MerweScaledSigmaPoints(2, 0.9, 2.0, 1.0)
    options = {"points": points, "state_add": add, "residual_z": residual}
    both = [
        kind(
            2,
            1,
            0.1,
            hx=lambda x: np.array([x[0] + 0.3 * x[1] ** 2]),
            fx=lambda x, dt: x,
            **options,
        )
        for kind in (UnscentedKalmanFilter, SquareRootUKF)
    ]
    for ukf in both:
        ukf.predict()
        ukf.update(np.array([0.4]))
    np.testing.assert_allclose(both[1].x, both[0].x, atol=1e-12)


def attributes(kf):
    """Every public attribute of a filterpy object, including properties."""
    return sorted(
        {name for name in vars(kf) if name[0] != "_"}
        | {"log_likelihood", "likelihood", "mahalanobis"}
    )


def alike(ours, peer):
    """Compare all attributes one by one; only the inverting function differs, because it accepts
    singular matrices.
    """
    for name in attributes(peer):
        own, theirs = getattr(ours, name), getattr(peer, name)
        if name == "inv":
            continue
        if theirs is None or callable(theirs) or name == "points_fn":
            assert own is theirs, name
        elif np.asarray(theirs).dtype == object:
            np.testing.assert_array_equal(own, theirs, err_msg=name)
        else:
            assert np.shape(own) == np.shape(theirs), name
            np.testing.assert_allclose(own, theirs, rtol=1e-7, atol=1e-10, err_msg=name)


@pytest.mark.parametrize("cls", OURS)
def test_every_attribute_is_filterpys_at_every_moment(cls):
    points = MerweScaledSigmaPoints(4, 0.3, 2.0, -1.0)
    peer, ours = tracker(UnscentedKalmanFilter, points), tracker(cls, points)
    alike(ours, peer)
    for z in (*measurements(3), None, measurements(4)[3]):
        for kf in (peer, ours):
            kf.predict()
        alike(ours, peer)
        for kf in (peer, ours):
            kf.update(z)
        alike(ours, peer)
    for kf in (peer, ours):
        kf.compute_process_sigmas(0.1)
    alike(ours, peer)


@pytest.mark.parametrize("cls", OURS)
@pytest.mark.parametrize(("n", "m"), [(2, 1), (6, 3), (9, 4)])
def test_a_step_takes_no_more_than_half_again_of_filterpys_calls(cls, n, m):
    """Number of function calls, in Python and C, which do not depend on the machine; each model is
    called once for each point.
    """
    counts = []
    for kind in (UnscentedKalmanFilter, cls):
        seen, count = [], 0

        def profile(frame, event, argument):
            nonlocal count
            count += event in ("call", "c_call")

        def f(x, dt, seen=seen):
            seen.append("f")
            return x

        def h(x, seen=seen):
            seen.append("h")
            return x[:m]

        kf = kind(n, m, 1.0, h, f, MerweScaledSigmaPoints(n, 0.5, 2.0, 0.0))
        for turn in range(2):
            if turn:  # the first step computes what later steps reuse
                seen.clear()
                sys.setprofile(profile)
            try:
                kf.predict()
                kf.update(np.ones(m))
            finally:
                sys.setprofile(None)
        assert seen == ["f"] * (2 * n + 1) + ["h"] * (2 * n + 1)
        counts.append(count)
    assert counts[1] <= 1.5 * counts[0]


def still(x, dt):
    return x


def first(x):
    return x[:1]


@pytest.mark.parametrize("cls", OURS)
def test_a_filter_can_be_pickled_and_saved(cls):
    kf = cls(2, 1, 1.0, first, still, MerweScaledSigmaPoints(2, 0.5, 2.0, 1.0))
    saver = Saver(kf)
    for z in (0.1, 0.3):
        kf.predict()
        kf.update(z)
        saver.save()
    twin = pickle.loads(pickle.dumps(kf))
    for name in ("K", "SI", "sigmas_f", "log_likelihood"):
        np.testing.assert_array_equal(getattr(twin, name), getattr(kf, name))
    for each in (kf, twin):
        each.predict()
        each.update(0.5)
    np.testing.assert_array_equal(twin.x, kf.x)
    assert not np.array_equal(saver.K[0], saver.K[1])
    saver.to_array()
    assert saver.x.shape == (2, 2)
    assert saver.K.shape == (2, 2, 1)
    assert saver.sigmas_f.shape == (2, 5, 2)
    assert saver.SI.shape == (2, 1, 1)
    assert saver.log_likelihood.shape == (2,)


@pytest.mark.parametrize("cls", OURS)
def test_the_smoother_is_celnavs(cls):
    """It equals `celnav.smooth`, with intervals and noises that differ between epochs, and with a
    singular predicted covariance.
    """
    rng = np.random.default_rng(5)
    times = np.cumsum([0.0, 1.0, 0.5, 2.0, 1.0, 0.3])
    Qs = [
        q * np.outer(g, g)
        for q, g in zip((0.1, 0.2, 0.05, 0.4, 0.1, 0.3), np.array([[0.5, 1.0]] * 6), strict=True)
    ]
    zs = rng.normal(size=(6, 1))
    kf = cls(
        2,
        1,
        1.0,
        first,
        lambda x, dt: np.array([x[0] + dt * x[1], x[1]]),
        MerweScaledSigmaPoints(2, 0.9, 2.0, 1.0),
    )
    kf.P = np.diag([1.0, 0.0])
    xs, Ps = [], []
    for k, z in enumerate(zs):
        if k:
            kf.Q = Qs[k - 1]
            kf.predict(dt=times[k] - times[k - 1])
        kf.update(z)
        xs.append(kf.x)
        Ps.append(kf.P)
    dts = [*np.diff(times), 1.0]
    smoothed, covs, gains = kf.rts_smoother(np.array(xs), np.array(Ps), Qs=Qs, dts=dts)

    def f(x, epoch):
        return np.stack([x[..., 0] + epoch.dt * x[..., 1], x[..., 1]], -1)

    form = "square root" if cls is SquareRootUKF else "covariance"
    motion = celnav.Motion(f, lambda mean, epoch: Qs[epoch.k - 1])
    filter = celnav.sigma_point(
        motion, celnav.Sensor([[1.0, 0.0]], [[1.0]]), rule=kf.rule, form=form
    )
    track = celnav.run(
        filter, celnav.Gaussian(np.zeros(2), np.diag([1.0, 0.0])), times, zs, keep="cov"
    )
    expected = celnav.smooth(track, gains=True)
    np.testing.assert_allclose(smoothed, expected.mean, atol=1e-9)
    np.testing.assert_allclose(covs.diagonal(0, 1, 2), expected.std**2, atol=1e-9)
    np.testing.assert_allclose(gains, expected.extra["gain"], atol=1e-6)
