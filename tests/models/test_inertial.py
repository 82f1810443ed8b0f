"""The strapdown system against an integration in inertial space, its sensors against differentiated
trajectories.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import celnav
from celnav.analysis.metrics import bootstrap, chi_square_band
from celnav.gaussian import attitude as at
from celnav.gaussian.belief import nees
from celnav.models import earth, inertial
from celnav.models.noise import allan_deviation

LATITUDE, HEIGHT = 0.7, 250.0
IMU = inertial.Imu(2e-4, 1e-3, 1e-3, 0.02, 1e-6, 1e-5)
ERRORS = ("body", "local", "invariant")
NAMES = ("lag", "lever", "scale", "mount", "axle", "wheel")
SPIN = 7.2921151467e-5


def rates(t):
    """Measurements of ideal gyros, rad/s on body axes."""
    return np.array([0.3 * np.sin(1.1 * t), 0.2 * np.cos(0.7 * t), 0.25 + 0.2 * np.sin(0.5 * t)])


def forces(t):
    return np.array([1.5 * np.cos(0.9 * t), 2.0 * np.sin(0.4 * t), -9.8 + 0.8 * np.cos(1.3 * t)])


def fixed_to_local(latitude):
    """Rotation from Earth-fixed axes to north, east, down at longitude 0."""
    s, c = np.sin(latitude), np.cos(latitude)
    return np.array([[-s, 0.0, c], [0.0, 1.0, 0.0], [-c, 0.0, -s]])


def place(latitude, height):
    a, e2 = 6378137.0, 6.69437999014e-3
    N = a / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    return np.array(
        [(N + height) * np.cos(latitude), 0.0, (N * (1.0 - e2) + height) * np.sin(latitude)]
    )


def gravitation(r):
    """Normal gravity minus the centrifugal acceleration at an Earth-fixed place, from textbook
    formulas.
    """
    a, f, gm, e2 = 6378137.0, 1.0 / 298.257223563, 3.986004418e14, 6.69437999014e-3
    across, latitude, height = np.hypot(r[0], r[1]), np.arctan2(r[2], np.hypot(r[0], r[1])), 0.0
    for _ in range(8):
        N = a / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
        height = across / np.cos(latitude) - N
        latitude = np.arctan2(r[2], across * (1.0 - e2 * N / (N + height)))
    s2 = np.sin(latitude) ** 2
    g = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - e2 * s2)
    m = SPIN**2 * a**2 * a * (1.0 - f) / gm
    g *= 1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s2) * height + 3.0 * height**2 / a**2
    longitude = np.arctan2(r[1], r[0])
    up = [
        np.cos(latitude) * np.cos(longitude),
        np.cos(latitude) * np.sin(longitude),
        np.sin(latitude),
    ]
    return -g * np.array(up) - SPIN**2 * np.array([r[0], r[1], 0.0])


def flown(times, q, v, p):
    """Attitude, velocity and position at the times, from rotation matrices and Newton's law in
    inertial space, by Runge-Kutta.
    """
    local = fixed_to_local(LATITUDE)
    origin, w = place(LATITUDE, HEIGHT), np.array([0.0, 0.0, SPIN])

    def turned(t):  # Earth-fixed to inertial
        return Rotation.from_rotvec(SPIN * t * np.array([0.0, 0.0, 1.0])).as_matrix()

    def rate(t, y):
        C, r, change = y[:9].reshape(3, 3), y[9:12], y[12:]
        x, yy, z = rates(t)
        W = np.array([[0.0, -z, yy], [z, 0.0, -x], [-yy, x, 0.0]])
        fixed = turned(t).T @ r
        return np.r_[(C @ W).ravel(), change, C @ forces(t) + turned(t) @ gravitation(fixed)]

    to_body = Rotation.from_quat(q).as_matrix().T  # of north, east, down
    r = origin + local.T @ p
    start = np.r_[(local.T @ to_body.T).ravel(), r, local.T @ v + np.cross(w, r)]
    y = solve_ivp(rate, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-9).y.T
    out = []
    for t, row in zip(times, y, strict=True):
        back = turned(t).T
        C, r = back @ row[:9].reshape(3, 3), back @ row[9:12]
        change = back @ row[12:] - np.cross(w, r)
        q = Rotation.from_matrix(local @ C).as_quat()
        out.append(np.r_[q, local @ change, local @ (r - origin)])
    return np.array(out)


START = np.r_[at.from_euler([0.1, -0.2, 1.0]), 20.0, -10.0, 1.0, 3000.0, -5000.0, -200.0]


def moved(system, times, x):
    """The motion alone, with the inputs in the middle of each interval."""
    for t, dt in zip(times[:-1], np.diff(times), strict=True):
        middle = t + 0.5 * dt
        epoch = celnav.Epoch(t=t + dt, dt=dt, u=(rates(middle), forces(middle)))
        x = system.motion.f(x, epoch)
    return x


def test_the_motion_against_newton_in_inertial_space():
    """The error is of second order."""
    near = np.r_[START[:7], 0.1 * START[7:]]
    truth = flown(np.array([0.0, 10.0]), near[:4], near[4:7], near[7:])[-1]
    system, errors = inertial.strapdown(LATITUDE, HEIGHT, IMU), []
    for steps in (500, 1000, 2000):
        x = moved(system, np.linspace(0.0, 10.0, steps + 1), np.r_[near, np.zeros(6)])
        turn = at.log(at.multiply(x[:4], at.inverse(truth[:4])))
        errors.append(np.r_[turn, x[4:10] - truth[4:]])
    fine, finer = errors[1:]
    size = np.linalg.norm(np.reshape(errors, (3, 3, 3)), axis=-1)
    np.testing.assert_allclose(size[0] / size[1], 4.0, rtol=0.02)
    assert (size[1] < [1e-5, 1e-4, 1e-3]).all(), size  # rad, m/s, m at 100 Hz
    beyond = np.linalg.norm(((4.0 * finer - fine) / 3.0).reshape(3, 3), axis=-1)
    assert (beyond < [1e-9, 2e-6, 1e-5]).all(), beyond


@pytest.mark.parametrize(("kilometers", "most"), [(6.0, 1.5e-5), (60.0, 1.5e-3)])
def test_gravity_away_from_the_origin(kilometers, most):
    """Its direction and size follow to first order."""
    system, local = inertial.strapdown(LATITUDE, HEIGHT, IMU), fixed_to_local(LATITUDE)
    p = 1e3 * kilometers * np.array([0.6, -0.8, 0.0])
    r = place(LATITUDE, HEIGHT) + local.T @ p
    gravity = local @ (gravitation(r) + SPIN**2 * np.array([r[0], r[1], 0.0]))
    x = np.r_[at.IDENTITY, 0.0, 0.0, 0.0, p, np.zeros(6)]
    after = system.motion.f(x, celnav.Epoch(dt=1e-3, u=(np.zeros(3), np.zeros(3))))
    np.testing.assert_allclose(after[4:7] / 1e-3, gravity, atol=most)
    assert np.abs(gravity - [0.0, 0.0, gravity[2]]).max() > 100.0 * most / kilometers


@pytest.mark.parametrize("error", ERRORS)
def test_the_process_noise_against_an_integral(error):
    """An integral of the errors' linear dynamics with continuous white noise; neglected terms are
    below 1 %.
    """
    system = inertial.strapdown(LATITUDE, HEIGHT, IMU, error=error)
    x = np.r_[START, np.zeros(6)]
    dt, u = 0.01, (rates(0.0), forces(0.0))

    def jacobian(h):
        """Jacobian of the transition over h seconds, by differences of the space."""
        epoch = celnav.Epoch(dt=h, u=u)
        f, space = system.motion.f, system.space
        sides = [f(space.plus(x, s * 1e-4 * np.eye(15)), epoch) for s in (1.0, -1.0)]
        return space.minus(sides[0], sides[1]).T / 2e-4

    F = (jacobian(1e-3) - np.eye(15)) / 1e-3
    density = np.zeros(15)
    density[:3], density[3:6] = IMU.gyro_noise**2, IMU.accelerometer_noise**2
    density[9:12], density[12:] = IMU.gyro_walk**2, IMU.accelerometer_walk**2
    nodes, weights = np.polynomial.legendre.leggauss(6)
    integral = sum(
        0.5 * dt * w * (E := expm(0.5 * dt * (1.0 + s) * F)) @ np.diag(density) @ E.T
        for s, w in zip(nodes, weights, strict=True)
    )
    columns = system.motion.sqrt_Q(x, celnav.Epoch(dt=dt))
    Q = columns @ columns.T
    scale = np.sqrt(np.diag(integral))
    apart = (Q - integral) / np.outer(scale, scale)
    assert np.abs(apart).max() < 0.01
    assert np.abs(apart[3:9, 3:9]).max() < 1e-3


def trajectory(t):
    """Roll, pitch, yaw ``(..., 3)`` and position ``(..., 3)`` of a car that is shaken, north, east, down."""
    t = np.asarray(t)
    angles = [0.2 * np.sin(1.3 * t), 0.1 * np.cos(2.1 * t), 0.5 * np.sin(0.4 * t) + 0.3 * t]
    p = [60.0 * np.sin(0.3 * t), 50.0 * np.cos(0.25 * t), 2.0 * np.sin(0.5 * t)]
    return np.stack(angles, -1), np.stack(p, -1)


def slope(f, t, h=1e-4):
    """Derivative of fifth order."""
    return (f(t - 2 * h) - 8.0 * f(t - h) + 8.0 * f(t + h) - f(t + 2 * h)) / (12.0 * h)


def body(t):
    """C ``(..., 3, 3)`` from north, east, down to the body, by scipy."""
    return Rotation.from_euler("ZYX", trajectory(t)[0][..., ::-1]).as_matrix().swapaxes(-1, -2)


def axial(W):
    return np.stack([W[..., 2, 1], W[..., 0, 2], W[..., 1, 0]], -1)


SPUN = SPIN * np.array([np.cos(LATITUDE), 0.0, -np.sin(LATITUDE)])


def ideal(t):
    """Measurements of ideal units at ``t (...)``: rate and force on body axes, from the
    differentiated trajectory.
    """
    t = np.asarray(t)
    C = body(t)
    rate = axial(C @ slope(lambda s: body(s).swapaxes(-1, -2), t)) + C @ SPUN
    v = slope(lambda s: trajectory(s)[1], t)
    a = slope(lambda s: slope(lambda r: trajectory(r)[1], s, 1e-2), t, 1e-2)
    g = float(earth.normal_gravity(LATITUDE, HEIGHT)) * np.array([0.0, 0.0, 1.0])
    return rate, np.einsum("...ij,...j->...i", C, a - g + 2.0 * np.cross(SPUN, v))


def true_state(t):
    angles, p = trajectory(t)
    return np.concatenate([at.from_euler(angles), slope(lambda s: trajectory(s)[1], t), p], -1)


BIASES = np.r_[0.01, -0.02, 0.03, 0.1, -0.2, 0.3]
EXTRA = {
    "lag": [0.03],
    "lever": [0.2, -0.1, 0.3],
    "scale": [0.01, -0.02, 0.03, -0.01, 0.02, 0.015],
    "mount": [0.03, -0.05],
    "axle": [-0.4],
    "wheel": [0.02],
}
LEVER, AXLE = np.array([0.3, -0.5, -1.2]), np.array([-1.5, 0.2, 0.9])


def with_errors(t, states):
    """A system, its true state at t and the epoch of a unit with these errors."""
    system = inertial.strapdown(LATITUDE, HEIGHT, IMU, states)
    rate, force = ideal(t)
    scale = np.array(EXTRA["scale"]) if "scale" in states else np.zeros(6)
    u = rate * (1.0 + scale[:3]) + BIASES[:3], force * (1.0 + scale[3:]) + BIASES[3:]
    x = np.r_[true_state(t), BIASES, *(EXTRA[name] for name in states)]
    return system, x, celnav.Epoch(t=t, dt=0.01, u=u)


@pytest.mark.parametrize("states", [(), ("lever",), ("lever", "scale")])
@pytest.mark.parametrize("t", [0.0, 2.7, 11.0])
def test_fixes_are_those_of_the_antenna(t, states):
    """They equal the differentiated trajectory of the antenna."""
    system, x, epoch = with_errors(t, states)
    arm = LEVER + (EXTRA["lever"] if "lever" in states else 0.0)

    def antenna(s):
        return trajectory(s)[1] + body(s).swapaxes(-1, -2) @ arm

    found = system.gnss(LEVER, sigma_position=1.0, sigma_velocity=1.0).h(x, epoch)
    np.testing.assert_allclose(found, np.r_[antenna(t), slope(antenna, t)], atol=1e-8)
    np.testing.assert_array_equal(system.gnss(LEVER, sigma_position=1.0).h(x, epoch), found[:3])


@pytest.mark.parametrize("t", [0.9, 2.7, 11.0])
def test_fixes_are_later_by_the_lag(t):
    """To second order in the lag."""
    remaining = []
    for lag in (0.02, 0.01):
        system, x, epoch = with_errors(t, ("scale", "lag"))
        x[-1] = lag
        found = system.gnss(sigma_position=1.0, sigma_velocity=1.0).h(x, epoch)
        remaining.append(found - np.r_[trajectory(t + lag)[1], true_state(t + lag)[4:7]])
    assert np.linalg.norm(remaining[1]) < 1e-3
    np.testing.assert_allclose(remaining[0], 4.0 * np.array(remaining[1]), rtol=0.1, atol=1e-5)


@pytest.mark.parametrize("states", [(), ("mount",), ("axle", "scale"), NAMES])
@pytest.mark.parametrize("t", [0.0, 2.7, 11.0])
def test_the_axle_moves_as_its_trajectory_differentiated(t, states):
    system, x, epoch = with_errors(t, states)
    arm = AXLE + (np.r_[EXTRA["axle"], 0.0, 0.0] if "axle" in states else 0.0)
    v = body(t) @ slope(lambda s: trajectory(s)[1] + body(s).swapaxes(-1, -2) @ arm, t)
    if "mount" in states:
        v = Rotation.from_rotvec([0.0, *EXTRA["mount"]]).as_matrix().T @ v
    np.testing.assert_allclose(system.sideways(0.1, lever=AXLE).h(x, epoch), v[1:], atol=1e-8)
    forward = v[:1] * (1.0 + (EXTRA["wheel"][0] if "wheel" in states else 0.0))
    np.testing.assert_allclose(system.wheel_speed(0.1, lever=AXLE).h(x, epoch), forward, atol=1e-8)


def test_at_the_first_epoch_nothing_is_known_to_turn():
    """There is no interval before it, so there is no input; the filter runs with each engine."""
    system, x, _ = with_errors(0.0, NAMES)
    first = celnav.Epoch()
    sensor = system.gnss(LEVER, sigma_position=1.0, sigma_velocity=1.0)
    arm = body(0.0).T @ (LEVER + EXTRA["lever"])
    v, lag = x[4:7], EXTRA["lag"][0]
    np.testing.assert_allclose(sensor.h(x, first), np.r_[x[7:10] + arm + lag * v, v], rtol=1e-12)
    v = Rotation.from_rotvec([0.0, *EXTRA["mount"]]).as_matrix().T @ body(0.0) @ v
    np.testing.assert_allclose(system.sideways(0.1, lever=AXLE).h(x, first), v[1:], atol=1e-12)


def test_at_rest_gyros_measure_bias_and_the_rotation_of_the_earth():
    system = inertial.strapdown(LATITUDE, HEIGHT, IMU)
    q = at.from_euler([0.1, -0.2, 2.0])
    x = np.r_[q, np.zeros(6), BIASES]
    h = system.standstill(sigma_velocity=0.01, sigma_rate=1e-4).h(x, celnav.Epoch())
    np.testing.assert_allclose(h, np.r_[np.zeros(3), at.matrix(q) @ SPUN + BIASES[:3]], rtol=1e-12)
    force = -at.rotate(q, system._gravity[0])
    u = (h[3:], force + BIASES[3:])
    after = system.motion.f(x, celnav.Epoch(dt=0.01, u=u))
    np.testing.assert_allclose(after, x, atol=1e-14)
    np.testing.assert_allclose(inertial.level(force), [0.1, -0.2], rtol=1e-12)
    np.testing.assert_allclose(inertial.level(np.tile(force, (4, 2, 1)))[3, 1], [0.1, -0.2])


# -- filters ---------------------------------------------------------------------------------------
GNSS = {"sigma_position": 0.5, "sigma_velocity": 0.1}
LOW_COST = inertial.Imu(7e-4, 0.011, 3e-3, 0.1, 1e-6, 1e-4)


def flights(system, runs, seconds, heading, seed=0):
    """Times, inputs, fixes, truth and prior: units with different errors along one trajectory,
    fixes at 4 Hz.
    """
    rng, imu, dt = np.random.default_rng(seed), system.imu, 0.01
    times = dt * np.arange(round(seconds / dt) + 1)
    walks = np.repeat([imu.gyro_walk, imu.accelerometer_walk], 3) * np.sqrt(dt)
    noises = np.repeat([imu.gyro_noise, imu.accelerometer_noise], 3) / np.sqrt(dt)
    bias = rng.standard_normal((len(times), runs, 6)) * walks
    bias[0] = rng.standard_normal((runs, 6)) * np.repeat([imu.gyro_bias, imu.accelerometer_bias], 3)
    bias = np.cumsum(bias, 0)
    errors = bias[1:] + noises * rng.standard_normal((len(times) - 1, runs, 6))
    rate, force = ideal(0.5 * (times[1:] + times[:-1]))
    u = rate[:, None] + errors[..., :3], force[:, None] + errors[..., 3:]
    truth = np.broadcast_to(true_state(times)[:, None], (len(times), runs, 10))
    z = np.full((len(times), runs, 6), np.nan)

    def antenna(s):
        return trajectory(s)[1] + body(s).swapaxes(-1, -2) @ LEVER

    at_fix = times[25::25]
    noise = rng.standard_normal((len(at_fix), runs, 6)) * np.repeat([*GNSS.values()], 3)
    z[25::25] = np.c_[antenna(at_fix), slope(antenna, at_fix)][:, None] + noise
    sigmas = {"sigma_level": 0.02, "sigma_heading": heading}
    start = rng.standard_normal((runs, 9)) * np.r_[[0.02] * 2, heading, [0.1] * 3, [0.5] * 3]
    q = at.multiply(truth[0, 0, :4], at.exp(start[:, :3]))
    angles = at.to_euler(q)
    prior = system.prior(
        angles[:, :2],
        angles[:, 2],
        **sigmas,
        velocity=truth[0, 0, 4:7] + start[:, 3:6],
        position=truth[0, 0, 7:] + start[:, 6:],
        sigma_velocity=0.1,
        sigma_position=0.5,
    )
    return times, u, z, np.concatenate([truth, bias], -1), prior


def squared(track, truth, space):
    """NEES ``(T, runs)``, in the errors of a space."""
    return nees(space.minus(truth, track.mean), track.sqrt_cov)


@pytest.mark.parametrize(
    ("error", "kind", "form"),
    [
        ("invariant", celnav.ekf, "square root"),
        ("body", celnav.ukf, "covariance"),
        ("local", celnav.ekf, "covariance"),
    ],
)
def test_errors_are_as_large_as_predicted(error, kind, form):
    """From a heading known to 5 degrees, in 100 runs: NEES, NIS and the smoother's NEES."""
    system = inertial.strapdown(LATITUDE, HEIGHT, LOW_COST, error=error)
    times, u, z, truth, prior = flights(system, 100, 8.0, np.radians(5.0))
    filter = kind(system.motion, system.gnss(LEVER, **GNSS), form=form)
    track = celnav.run(filter, prior, times, z, u, keep="cov", engine="compiled")
    low, high = chi_square_band(15, 100, 0.99)
    for value in squared(track, truth, system.space)[::200].mean(1):
        assert low < value < high
    count = track.dof.sum()
    assert abs(track.nis.sum() / count - 1.0) < 3.0 * np.sqrt(2.0 / count)
    smoothed = celnav.smooth(track, engine="compiled")
    middle = squared(smoothed, truth, system.space)[400].mean()
    assert low < middle < high, middle
    error_of = [np.sqrt(np.square(t.mean - truth)[400, :, 7:10].mean()) for t in (smoothed, track)]
    assert error_of[0] < 0.8 * error_of[1]


def test_a_poor_heading():
    """60 degrees: the filter with the invariant error is consistent at the end and nearly so
    before; the others are overconfident.
    """
    values = {}
    for error in ERRORS:
        system = inertial.strapdown(LATITUDE, HEIGHT, LOW_COST, error=error)
        times, u, z, truth, prior = flights(system, 100, 10.0, np.radians(60.0))
        filter = celnav.ekf(system.motion, system.gnss(LEVER, **GNSS))
        track = celnav.run(filter, prior, times, z, u, keep="cov", engine="compiled")
        values[error] = squared(track, truth, system.space)[[200, 500, 1000]] / 15.0
    early, _, late = (bootstrap(np.mean, v, seed=0) for v in values["invariant"])
    assert late[0] < 1.1
    assert late[1] < 1.25
    assert early[1] < 2.0  # slightly overconfident in the first seconds
    for error in ("body", "local"):
        for v in values[error]:
            assert bootstrap(np.mean, v, seed=0)[0] > 2.0


@pytest.mark.parametrize("error", ERRORS)
def test_machine_code_equals_numpy_and_runs_do_not_mix(error):
    """With all sensors, a fix at the first epoch, and inputs of each run; numpy takes derivatives by differences."""
    states = NAMES if error == "invariant" else ("lag", "mount")
    system = inertial.strapdown(LATITUDE, HEIGHT, LOW_COST, states, error=error)
    times, u, z, _, prior = flights(system, 3, 0.3, 0.3)
    z = z.copy()
    z[0] = z[25]
    still, wheel = np.full((31, 3, 6), np.nan), np.full((31, 3, 1), np.nan)
    still[7], wheel[::10] = 0.0, 20.0
    side = np.where(np.isnan(wheel), np.nan, np.zeros(2))
    sensors = (
        system.gnss(LEVER, **GNSS),
        system.standstill(sigma_velocity=10.0, sigma_rate=1.0),
        system.sideways(0.5, lever=AXLE),
        system.wheel_speed(0.5, lever=AXLE),
    )
    filter, every = celnav.ekf(system.motion, *sensors), (z, still, side, wheel)
    slow, fast = (
        celnav.run(filter, prior, times, every, u, keep="cov", engine=engine)
        for engine in ("numpy", "compiled")
    )
    apart = np.abs(system.space.minus(fast.mean, slow.mean)) / slow.std
    assert apart.max() < 1e-4
    np.testing.assert_allclose(fast.std, slow.std, rtol=1e-4)
    alone = celnav.Gaussian(prior.mean[1], prior.cov[1] if prior.cov.ndim > 2 else prior.cov)
    one = celnav.run(
        filter,
        alone,
        times,
        tuple(x[:, 1] for x in every),
        tuple(x[:, 1] for x in u),
        engine="numpy",
    )
    np.testing.assert_allclose(one.mean, slow.mean[:, 1], rtol=1e-9, atol=1e-9)


def test_parts_of_the_track_and_of_the_prior():
    """The prior's standard deviations refer to the axes of the error; several headings are runs."""
    angles, heading = [0.1, -0.2], np.radians([0.0, 90.0, 200.0])
    for error in ERRORS:
        system = inertial.strapdown(LATITUDE, HEIGHT, IMU, {"lag": 0.02, "mount": 0.1}, error=error)
        prior = system.prior(
            angles,
            heading,
            sigma_level=0.01,
            sigma_heading=0.5,
            velocity=[1.0, 2.0, 3.0],
            sigma_velocity=0.1,
            sigma_position=2.0,
        )
        np.testing.assert_allclose(
            at.to_euler(prior.mean[:, :4])[:, :2], np.tile(angles, (3, 1)), atol=1e-12
        )
        root = prior.sqrt_cov if error == "local" else prior.sqrt_cov[-1]
        draws = np.random.default_rng(0).standard_normal((4000, 18)) @ root.T
        x = system.space.plus(prior.mean[-1], 1e-3 * draws)
        local = at.attitude(axes="reference").minus(x[:, :4], prior.mean[-1, :4])
        np.testing.assert_allclose(1e3 * local.std(0), [0.01, 0.01, 0.5], rtol=0.05)
        np.testing.assert_allclose(1e3 * x[:, 4:10].std(0), [0.1] * 3 + [2.0] * 3, rtol=0.05)
        std = prior.std if error == "local" else prior.std[0]
        np.testing.assert_allclose(system.space.part(std, "bg"), IMU.gyro_bias)
        np.testing.assert_allclose(system.space.part(std, "lag"), 0.02)
        np.testing.assert_allclose(system.space.part(std, "mount"), 0.1)


# -- noise -----------------------------------------------------------------------------------------
def test_a_datasheet_in_its_units():
    """60 x deg/h^(1/2) is x deg/s/Hz^(1/2); 1 m/s/h^(1/2) is 1/60 m/s^2/Hz^(1/2)."""
    biases = {"gyro_bias_deg_s": 0.5, "accelerometer_bias_mg": 10.0}
    a = inertial.Imu.datasheet(gyro_deg_s_sqrt_hz=0.005, accelerometer_ug_sqrt_hz=100.0, **biases)
    b = inertial.Imu.datasheet(
        gyro_deg_sqrt_h=0.3, accelerometer_m_s_sqrt_h=100e-6 * 9.80665 * 60.0, **biases
    )
    for name, value in vars(a).items():
        assert value == pytest.approx(getattr(b, name)), name
    assert a.gyro_bias == pytest.approx(np.radians(0.5))
    assert a.accelerometer_bias == pytest.approx(0.0980665)
    c = inertial.Imu.datasheet(
        gyro_deg_sqrt_h=0.3,
        accelerometer_ug_sqrt_hz=100.0,
        **biases,
        gyro_instability_deg_h=10.0,
        accelerometer_instability_ug=50.0,
        instability_s=200.0,
    )
    assert c.gyro_walk == pytest.approx(np.radians(10.0) / 3600.0 / 10.0)
    assert c.accelerometer_walk == pytest.approx(50e-6 * 9.80665 / 10.0)


def test_a_log_at_rest_tells_the_white_noise():
    """Within the interval of the Allan deviation; also with random-walk biases."""
    rng, dt = np.random.default_rng(1), 0.01
    t = dt * np.arange(12000)
    rate = 2e-3 / np.sqrt(dt) * rng.standard_normal((12000, 3)) + 0.1
    force = 0.02 / np.sqrt(dt) * rng.standard_normal((12000, 3)) + [0.0, 0.0, -9.8]
    imu = inertial.Imu.at_rest(t, rate, force, gyro_bias=0.01, accelerometer_bias=0.1)
    assert imu.gyro_noise == pytest.approx(2e-3, rel=0.15)
    assert imu.accelerometer_noise == pytest.approx(0.02, rel=0.15)
    assert imu.gyro_bias == 0.01
    allan = allan_deviation(t, rate, 1.0)
    assert ((allan.low < 2e-3) & (allan.high > 2e-3)).all()


def test_the_allan_deviation_against_its_definition():
    """Means of neighboring intervals; coverage of the interval in white noise."""
    rng = np.random.default_rng(0)
    x, t = rng.standard_normal((40, 2)), 0.5 * np.arange(40)
    m = 3
    means = np.array([x[k : k + m].mean(0) for k in range(40 - m + 1)])
    expected = np.sqrt(0.5 * np.square(means[m:] - means[:-m]).mean(0))
    np.testing.assert_allclose(allan_deviation(t, x, 1.5).deviation, expected, rtol=1e-12)
    many = allan_deviation(np.arange(300.0), rng.standard_normal((300, 2000)), 10.0)
    inside = (many.low < np.sqrt(0.1)) & (np.sqrt(0.1) < many.high)
    assert 0.92 < inside.mean() < 0.98


def test_windows_in_which_the_unit_stands():
    """Against a loop; a slow turn and a shaken window do not count as standstill."""
    rng, t = np.random.default_rng(0), 0.01 * np.arange(1000)
    rate, force = 1e-3 * rng.standard_normal((2, 1000, 3))
    rate[300:420, 2] += 0.5
    force[600:610] += 1.0
    limits = {"most_rate": 0.01, "rate_spread": 0.005, "force_spread": 0.01}
    at_times, z = inertial.standing(t, rate, force, window_s=0.5, **limits)
    expected = []
    for k in range(19):  # the last one may not be full
        window = slice(50 * k, 50 * k + 50)
        spread = rate[window].std(0).max() < 0.005 and force[window].std(0).max() < 0.01
        if spread and np.abs(rate[window].mean(0)).max() < 0.01:
            expected.append(np.r_[t[50 * k + 49], 0.0, 0.0, 0.0, rate[window].mean(0)])
    assert len(expected) == 15
    np.testing.assert_allclose(np.c_[at_times, z], expected, rtol=1e-9, atol=1e-15)
    none = inertial.standing(t[:20], rate[:20], force[:20], window_s=0.5, **limits)
    assert [x.shape for x in none] == [(0,), (0, 6)]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: inertial.strapdown(0.5, 0.0, IMU, ("lags",)),
            "states: expected one of lag, lever, scale, mount, axle, wheel, got 'lags'; did you",
        ),
        (lambda: inertial.strapdown(0.5, 0.0, IMU, "lag"), "states: expected a sequence"),
        (lambda: inertial.strapdown(0.5, 0.0, IMU, {"lag": 0.0}), "states: expected a positive"),
        (lambda: inertial.strapdown(40.0, 0.0, IMU), "latitude: expected a number of at least"),
        (
            lambda: inertial.Imu.datasheet(
                gyro_deg_sqrt_h=0.3, gyro_bias_deg_s=0.1, accelerometer_bias_mg=1.0
            ),
            "accelerometer_ug_sqrt_hz, accelerometer_m_s_sqrt_h: expected one of .*, got 0",
        ),
        (
            lambda: inertial.strapdown(0.5, 0.0, IMU).gnss(sigma_position=[1.0, 2.0]),
            "sigma_position: expected a positive number, or 3 positive numbers",
        ),
        (
            lambda: allan_deviation(np.r_[0.0, 1.0, 5.0, 6.0], np.ones(4), 1.0),
            "t: expected increasing times, evenly spaced",
        ),
        (
            lambda: allan_deviation(np.arange(9.0), np.ones(9), 5.0),
            "interval_s: expected 1 to 4 s, from one sample to half of them, got 5.0",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(make, message):
    with pytest.raises(ValueError, match="^" + message):
        make()


def test_of_several_headings_the_likelihood_picks_one():
    """Four runs of a batch, a quarter turn apart; the fixes and the unit are the same."""
    system = inertial.strapdown(LATITUDE, HEIGHT, LOW_COST)
    times, u, z, truth, _ = flights(system, 1, 6.0, 0.0)
    start = truth[0, 0]
    true_heading = at.to_euler(start[:4])[2]
    headings = true_heading + np.radians([20.0, 110.0, 200.0, 290.0])
    prior = system.prior(
        at.to_euler(start[:4])[:2],
        headings,
        sigma_level=0.02,
        sigma_heading=np.radians(30.0),
        velocity=start[4:7],
        position=start[7:10],
        sigma_velocity=0.1,
        sigma_position=0.5,
    )
    filter = celnav.ekf(system.motion, system.gnss(LEVER, **GNSS))
    track = celnav.run(filter, prior, times, z, u, keep="cov", engine="compiled")
    assert track.log_likelihood.argmax() == 0
    heading = at.to_euler(track.mean[-1, 0, :4])[2] - at.to_euler(truth[-1, 0, :4])[2]
    assert abs((heading + np.pi) % (2.0 * np.pi) - np.pi) < np.radians(3.0)


def test_wheel_speeds_hold_the_position_along_the_track():
    """Simulated: fixes for 20 s, then none for 10 s."""
    t = np.arange(0.0, 30.0, 0.05)
    begin = t[:-1]  # of each interval
    zero, turn = 0.0 * begin, 0.2 * np.cos(0.5 * begin)
    u = (
        np.stack([zero, zero, turn], -1),
        np.stack([np.sin(begin), 15.0 * turn, zero - 9.81], -1),
    )
    system = inertial.strapdown(LATITUDE, HEIGHT, LOW_COST, {"wheel": 0.02})
    sensors = system.gnss(LEVER, **GNSS), system.wheel_speed(0.05, lever=AXLE)
    prior = system.prior(
        inertial.level([0.0, 0.0, -9.81]),
        0.5,
        velocity=[13.0, 7.5, 0.0],
        sigma_level=0.02,
        sigma_heading=0.05,
        sigma_velocity=0.3,
        sigma_position=0.5,
    )
    truth, z = celnav.simulate(system.motion, sensors, prior, t, u=u, runs=100, seed=5)
    fixes, wheels = (x.copy() for x in z)
    fixes[np.arange(len(t)) % 4 > 0] = np.nan
    fixes[t > 20.0] = np.nan
    wheels[np.arange(len(t)) % 2 > 0] = np.nan
    filter, error = celnav.ekf(system.motion, *sensors), {}
    for name, rows in {"with": wheels, "without": np.full_like(wheels, np.nan)}.items():
        track = celnav.run(filter, prior, t, (fixes, rows), u, keep="cov", every=20)
        end, true = track.mean[-1], truth[::20][-1]
        forward = at.rotate(at.inverse(system.space.part(true, "q")), np.r_[1.0, 0.0, 0.0])
        apart = system.space.part(end, "p") - system.space.part(true, "p")
        error[name] = np.sqrt(np.mean((apart * forward).sum(-1) ** 2))
    assert error["with"] < 0.5 * error["without"], error
