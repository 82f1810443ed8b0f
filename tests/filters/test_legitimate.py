"""What looks odd and is meant is accepted, with right numbers: those of the Kalman filter of the textbooks, one run at a time."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import consider, fallback, gate
from celnav.filters.colored import augmented, colored
from celnav.gaussian.belief import covariance, square_root

RUNS, T = 2, 6  # as many runs as states
RNG = np.random.default_rng(1)
DT = np.array([0.0, 1.0, 0.5, 2.0, 1.0, 0.25])
Z = RNG.normal(size=(T, RUNS, 1))
X0, P0 = RNG.normal(size=(RUNS, 2)), np.array([[2.0, 0.3], [0.3, 1.0]])
H, R, Q = np.array([[1.0, 0.5]]), np.array([[0.2]]), np.array([[0.3, 0.1], [0.1, 0.4]])
FORMS = pytest.mark.parametrize("form", [square_root, covariance], ids=["root", "cov"])
RULES = {"points": celnav.unscented(2), "differences": celnav.Taylor(), "Jacobian": None}


def transition(dt):
    return np.array([[1.0, dt], [0.0, 1.0]])


def move(x, epoch):
    return np.stack([x[..., 0] + epoch.dt * x[..., 1], x[..., 1]], -1)


def kalman(x, P, dt=DT, z=Z[:, 0], H=H, R=R, Q=Q):
    """Means ``(T, n)`` and covariances ``(T, n, n)`` of one run."""
    found = []
    for step, measured in zip(dt, z, strict=True):
        if step:
            x, P = transition(step) @ x, transition(step) @ P @ transition(step).T + Q
        seen = ~np.isnan(measured)
        if seen.any():
            h = H[seen]
            K = np.linalg.solve(h @ P @ h.T + R[np.ix_(seen, seen)], h @ P).T
            x, P = x + K @ (measured[seen] - h @ x), (np.eye(2) - K @ h) @ P
        found.append((x, P))
    return map(np.array, zip(*found, strict=True))


def compare(track, x=X0, P=P0, **given):
    """A track of two runs with the textbook's, each argument of which may be one for each run."""
    for run in range(RUNS):
        own = {name: value[run] for name, value in given.items()}
        mean, cov = kalman(x[run], P[run] if np.ndim(P) == 3 else P, z=own.pop("z", Z[:, run]), **own)
        np.testing.assert_allclose(track.mean[:, run], mean, atol=1e-7)
        np.testing.assert_allclose(track.cov[:, run], cov, atol=1e-7)


def flown(form, rule=RULES["points"], f=move, h=H, x=X0, P=P0, z=Z, epochs=None, updates=(), **noise):
    noise = {"Q": Q, "R": R} | noise
    motion = {name: noise.pop(name) for name in ("Q", "sqrt_Q") if name in noise and noise[name] is not None}
    sensor = {name: noise.pop(name) for name in ("R", "sqrt_R", "hooks") if name in noise and noise[name] is not None}
    rules = (rule, rule)
    if rule is None:
        rules = celnav.Taylor(lambda x, e: (transition(e.dt),)), celnav.Taylor(lambda x, e: (H,))
    filter = celnav.sequential(celnav.predict(f, rules[0], **motion), *(updates or (celnav.update(h, rules[1], **sensor),)))
    return celnav.run(filter, form(x, P), epochs or celnav.epochs(np.cumsum(DT), z), keep="spread")


@FORMS
@pytest.mark.parametrize("rule", RULES)
def test_perfect_measurements(form, rule):
    for none in ({"R": np.zeros((1, 1))}, {"R": None, "sqrt_R": np.zeros((1, 0))}, {"R": None, "sqrt_R": np.zeros((1, 3))}):
        compare(flown(form, RULES[rule], **none), R=np.zeros((RUNS, 1, 1)))
        compare(flown(form, RULES[rule], h=lambda x, e: x @ H.T, **none), R=np.zeros((RUNS, 1, 1)))


@FORMS
@pytest.mark.parametrize("rule", RULES)
def test_singular_covariances(form, rule):
    """A process noise of one direction, a state that is known in part or altogether, no process noise."""
    drive = np.array([[0.5], [1.0]])
    known, nothing = np.diag([0.0, 1.0]), np.zeros((2, 2))
    compare(flown(form, RULES[rule], Q=drive @ drive.T, P=known), P=known, Q=[drive @ drive.T] * RUNS)
    compare(flown(form, RULES[rule], Q=None, sqrt_Q=drive, P=nothing), P=nothing, Q=[drive @ drive.T] * RUNS)
    compare(flown(form, RULES[rule], Q=None, sqrt_Q=np.zeros((2, 0)), P=known), P=known, Q=[nothing] * RUNS)
    compare(flown(form, RULES[rule], Q=nothing, P=nothing), P=nothing, Q=[nothing] * RUNS)


@FORMS
def test_no_components_at_all(form):
    """A sensor that measures nothing, beside one that does, and alone."""
    nothing = celnav.update(np.zeros((0, 2)), RULES["points"], np.zeros((0, 0)))
    both = flown(form, updates=(celnav.update(H, RULES["points"], R), nothing), z=(Z, np.zeros((T, 0))))
    compare(both)
    compare(flown(form, updates=(nothing,), z=np.zeros((T, 0))), z=np.full((RUNS, T, 1), np.nan))


@FORMS
@pytest.mark.parametrize("rule", ["points", "differences"])
def test_noise_matrices_and_intervals_of_each_run(form, rule):
    Rs, Qs, Hs = np.array([[[0.2]], [[3.0]]]), np.array([Q, 5.0 * Q]), np.array([H, [[-1.0, 2.0]]])
    Ps = np.array([P0, 3.0 * P0])
    compare(flown(form, RULES[rule], R=Rs, Q=Qs, h=Hs, P=Ps), R=Rs, Q=Qs, H=Hs, P=Ps)
    per_run = lambda x, e: np.einsum("...ri,rmi->...rm", x, Hs)  # noqa: E731
    compare(flown(form, RULES[rule], R=lambda mean, e: Rs, Q=lambda mean, e: Qs, h=per_run), R=Rs, Q=Qs, H=Hs)
    dts = DT[:, None] * [1.0, 3.0]
    when = [celnav.Epoch(k, float(k), dts[k], z=Z[k]) for k in range(T)]
    compare(flown(form, RULES[rule], epochs=when), dt=dts.T)


@dataclass
class Sensor:
    """A callable object, which knows more than a function."""

    H: np.ndarray

    def __call__(self, x, epoch):
        return x @ self.H.T

    def noise(self, mean, epoch):
        return R

    @staticmethod
    def move(x, epoch):
        return move(x, epoch)


def by_keyword(scale, x, epoch, *, offset=0.0):
    return scale * move(x, epoch) + offset


def anything(*arguments, **named):
    return move(*arguments)


KINDS_OF_FUNCTION = [move, Sensor.move, Sensor(H).move, partial(by_keyword, 1.0, offset=0.0), anything]


@FORMS
@pytest.mark.parametrize("f", KINDS_OF_FUNCTION, ids=["function", "static", "bound", "partial", "of anything"])
def test_models_of_every_kind(form, f):
    for h in (Sensor(H), Sensor(H).__call__, partial(lambda own, x, e: x @ own.T, H), lambda x, e, own=H: x @ own.T):
        compare(flown(form, f=f, h=h, R=Sensor(H).noise, Q=partial(lambda q, mean, e: q, Q)))


@FORMS
def test_angles_at_the_seam(form):
    """A heading near pi, whose measurements jump by a turn, is one that does not, wrapped."""
    x, z = np.array([[np.pi, 0.1], [-np.pi, -0.1]]), np.array([[np.pi], [-np.pi]]) + 0.3 * Z
    state, seen = celnav.angles([0]), celnav.angles([0])
    heading = np.array([[1.0, 0.0]])
    for turn in (celnav.gaussian.spaces.wrap(z), z, z + 2.0 * np.pi, np.full_like(z, np.pi), np.full_like(z, -np.pi)):
        motion = celnav.predict(move, RULES["points"], 0.01 * Q, space=state)
        for h in (heading, lambda x, e: x[..., :1]):
            sensor = celnav.update(h, RULES["points"], R, space=state, measurement_space=seen)
            track = celnav.run(
                celnav.sequential(motion, sensor), form(x, 0.01 * P0), celnav.epochs(np.cumsum(DT), turn), keep="spread"
            )
            for run in range(RUNS):
                near = x[run, 0] + celnav.gaussian.spaces.wrap(turn[:, run] - x[run, 0])
                mean, cov = kalman(x[run], 0.01 * P0, z=near, H=heading, Q=0.01 * Q)
                np.testing.assert_allclose(celnav.gaussian.spaces.wrap(track.mean[:, run, 0] - mean[:, 0]), 0.0, atol=1e-9)
                np.testing.assert_allclose(track.mean[:, run, 1], mean[:, 1], atol=1e-9)
                np.testing.assert_allclose(track.cov[:, run], cov, atol=1e-9)


@FORMS
def test_the_sign_of_a_quaternion_is_nothing(form):
    space, rule = celnav.gaussian.attitude.attitude(), celnav.unscented(3)
    filter = celnav.sequential(
        celnav.predict(lambda q, e: q, rule, 1e-4 * np.eye(3), space=space),
        celnav.update(lambda q, e: q, rule, 1e-3 * np.eye(3), space=space, measurement_space=space),
    )
    q = RNG.normal(size=4)
    z = q / np.linalg.norm(q) + 0.02 * RNG.normal(size=(T, RUNS, 4))
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    flips = RNG.choice([-1.0, 1.0], size=(T, RUNS, 1))
    tracks = [
        celnav.run(
            filter, form(np.tile(sign * z[0, 0], (RUNS, 1)), 0.01 * np.eye(3)), celnav.epochs(np.arange(T), zs), keep="spread"
        )
        for sign, zs in ((1.0, z), (-1.0, z), (1.0, flips * z))
    ]
    for other in tracks[1:]:
        np.testing.assert_allclose(np.abs(np.vecdot(other.mean, tracks[0].mean)), 1.0, atol=1e-12)
        np.testing.assert_allclose(other.cov, tracks[0].cov, atol=1e-12)


def _strided(a):
    """Every other number of an array twice as large, in Fortran's order."""
    wide = np.full([2 * length for length in a.shape], 7.0, order="F")
    view = wide[tuple(slice(None, None, 2) for _ in a.shape)]
    view[...] = a
    return view


def _locked(a):
    a = a.copy()
    a.flags.writeable = False
    return a


KINDS = {
    "read-only": _locked,
    "not contiguous": _strided,
    "backward": lambda a: a[..., ::-1].copy()[..., ::-1],
    "broadcast": lambda a: np.broadcast_to(a, a.shape),
    "lists": lambda a: a.tolist(),
    "masked": np.ma.array,
    "big-endian": lambda a: a.astype(">f8"),
    "objects": lambda a: a.astype(object),
}


@FORMS
@pytest.mark.parametrize("kind", KINDS)
def test_arrays_of_every_kind(form, kind):
    as_kind = KINDS[kind]
    z, x, P, q, r, h = (as_kind(a) for a in (Z, X0, P0, Q, R, H))
    compare(flown(form, x=x, P=P, z=z, Q=q, R=r, h=h))
    model = lambda x, e: as_kind(move(x, e))  # noqa: E731
    compare(flown(form, f=model, h=lambda x, e: as_kind(x @ H.T), R=lambda mean, e: r))
    for given, kept in ((z, Z), (x, X0), (P, P0), (q, Q), (r, R), (h, H)):
        np.testing.assert_array_equal(np.asarray(given, float), kept)


@FORMS
def test_whole_numbers_and_scalars_of_numpy(form):
    whole = celnav.sequential(
        celnav.predict(lambda x, e: x, celnav.unscented(np.int64(2), alpha=np.float32(1.0)), [[1, 0], [0, 1]]),
        celnav.update([[1, 0]], RULES["points"], [[1]], hooks=[gate(np.float64(1e3))]),
    )
    track = celnav.run(whole, form([1, 2], [[2, 0], [0, 1]]), celnav.epochs([0, 1], [[1], [3]]), every=np.int64(1), keep="spread")
    np.testing.assert_allclose(track.cov[0], np.diag([2.0 / 3.0, 1.0]))
    np.testing.assert_allclose(track.mean[1], [1.0 + 2.0 * (5.0 / 3.0) / (8.0 / 3.0), 2.0])
    np.testing.assert_allclose(
        track.mean[1], celnav.run(whole, form([1, 2], [[2, 0], [0, 1]]), iter(celnav.epochs([0, 1], [[1], [3]]))).mean[1]
    )


@FORMS
def test_other_parts_take_the_same(form):
    """Gains, fallbacks, colored noise of each run: what is unusual there too."""
    part = celnav.update(H, RULES["points"], R)
    compare(flown(form, updates=(fallback(part, celnav.update(H, celnav.Taylor(), R)),)))
    compare(flown(form, updates=(celnav.update(H, RULES["points"], R, gain=consider(2, 0)),)))
    Phi = np.array([[[0.5]], [[-0.2]]])
    filters = [
        colored(move, H, RULES["points"], Phi, Q=Q, R=R, Sigma0=R),
        augmented(move, H, celnav.unscented(3), Phi, Q=Q, R=R, Sigma0=R),
        augmented(move, H, celnav.unscented(3), lambda e: Phi, Q=Q, R=R, Sigma0=R),
    ]
    tracks = [celnav.run(filter, form(X0, P0), celnav.epochs(np.cumsum(DT), Z), keep="spread") for filter in filters]
    for track in tracks[1:]:
        np.testing.assert_allclose(track.mean[..., :2], tracks[0].mean, atol=1e-8)
        np.testing.assert_allclose(track.cov[..., :2, :2], tracks[0].cov, atol=1e-8)
    alone = celnav.run(filters[1], form(X0[0], P0), celnav.epochs(np.cumsum(DT), Z[:, 0]))  # runs come from Phi
    np.testing.assert_allclose(alone.mean[:, 0, :2], tracks[0].mean[:, 0], atol=1e-8)
