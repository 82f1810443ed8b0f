"""Unusual but valid arguments are accepted, and give the numbers of the textbook Kalman filter, one
run at a time.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest

import celnav
from celnav.filters.adaptive import consider, gate
from celnav.filters.sequential import SingleDraw
from celnav.filters.switching import Fallback
from celnav.gaussian.attitude import attitude
from celnav.gaussian.spaces import wrap
from celnav.receiver.least_squares import least_squares

RUNS, T = 2, 6  # as many runs as states
RNG = np.random.default_rng(1)
DT = np.array([0.0, 1.0, 0.5, 2.0, 1.0, 0.25])
Z = RNG.normal(size=(T, RUNS, 1))
X0, P0 = RNG.normal(size=(RUNS, 2)), np.array([[2.0, 0.3], [0.3, 1.0]])
H, R, Q = np.array([[1.0, 0.5]]), np.array([[0.2]]), np.array([[0.3, 0.1], [0.1, 0.4]])
FORMS = pytest.mark.parametrize("form", ["square root", "covariance"])
RULES = {"points": celnav.unscented, "differences": celnav.Taylor(), "Jacobian": None}


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
    """Compare a track of two runs with the textbook filter; each argument may
    differ between runs.
    """
    for i in range(RUNS):
        own = {name: value[i] for name, value in given.items()}
        mean, cov = kalman(x[i], P[i] if np.ndim(P) == 3 else P, z=own.pop("z", Z[:, i]), **own)
        np.testing.assert_allclose(track.mean[:, i], mean, atol=1e-7)
        np.testing.assert_allclose(track.cov[:, i], cov, atol=1e-7)


def models(rule=RULES["points"], f=move, h=H, **noise):
    """Motion, sensor and rule; without a rule with user-supplied Jacobians."""
    noise = {"Q": Q, "R": R} | noise
    of_f, of_h = (
        {name: noise.get(name) for name in names} for names in (("Q", "sqrt_Q"), ("R", "sqrt_R"))
    )
    if rule is None:
        of_f["jacobian"], of_h["jacobian"], rule = (
            lambda x, e: transition(e.dt),
            lambda x, e: H,
            celnav.Taylor(),
        )
    return celnav.Motion(f, **of_f), celnav.Sensor(h, **of_h), rule


def run(filter, x=X0, P=P0, z=Z, epochs=None):
    return celnav.run(
        filter, celnav.Gaussian(x, P), epochs or celnav.epochs(np.cumsum(DT), z), keep="cov"
    )


def flown(form, *given, x=X0, P=P0, z=Z, epochs=None, **model):
    motion, sensor, rule = models(*given, **model)
    return run(celnav.sigma_point(motion, sensor, rule=rule, form=form), x, P, z, epochs)


@FORMS
@pytest.mark.parametrize("rule", RULES)
def test_perfect_measurements(form, rule):
    for none in (
        {"R": np.zeros((1, 1))},
        {"R": None, "sqrt_R": np.zeros((1, 0))},
        {"R": None, "sqrt_R": np.zeros((1, 3))},
    ):
        compare(flown(form, RULES[rule], **none), R=np.zeros((RUNS, 1, 1)))
        compare(flown(form, RULES[rule], h=lambda x, e: x @ H.T, **none), R=np.zeros((RUNS, 1, 1)))


@FORMS
@pytest.mark.parametrize("rule", RULES)
def test_singular_covariances(form, rule):
    """Process noise in one direction, a state that is exact in part or completely, no process
    noise.
    """
    drive = np.array([[0.5], [1.0]])
    known, nothing = np.diag([0.0, 1.0]), np.zeros((2, 2))
    compare(
        flown(form, RULES[rule], Q=drive @ drive.T, P=known), P=known, Q=[drive @ drive.T] * RUNS
    )
    compare(
        flown(form, RULES[rule], Q=None, sqrt_Q=drive, P=nothing),
        P=nothing,
        Q=[drive @ drive.T] * RUNS,
    )
    compare(
        flown(form, RULES[rule], Q=None, sqrt_Q=np.zeros((2, 0)), P=known),
        P=known,
        Q=[nothing] * RUNS,
    )
    compare(flown(form, RULES[rule], Q=nothing, P=nothing), P=nothing, Q=[nothing] * RUNS)


@FORMS
def test_no_components_at_all(form):
    """A sensor that measures nothing, beside one that does, and alone."""
    (motion, sensor, _), nothing = models(), celnav.Sensor(np.zeros((0, 2)), np.zeros((0, 0)))
    compare(run(celnav.ukf(motion, sensor, nothing, form=form), z=(Z, np.zeros((T, 0)))))
    compare(
        run(celnav.ukf(motion, nothing, form=form), z=np.zeros((T, 0))),
        z=np.full((RUNS, T, 1), np.nan),
    )


@FORMS
@pytest.mark.parametrize("rule", ["points", "differences"])
def test_noise_matrices_and_intervals_of_each_run(form, rule):
    Rs, Qs, Hs = np.array([[[0.2]], [[3.0]]]), np.array([Q, 5.0 * Q]), np.array([H, [[-1.0, 2.0]]])
    Ps = np.array([P0, 3.0 * P0])
    compare(flown(form, RULES[rule], R=Rs, Q=Qs, h=Hs, P=Ps), R=Rs, Q=Qs, H=Hs, P=Ps)
    per_run = lambda x, e: np.einsum("...ri,rmi->...rm", x, Hs)  # noqa: E731
    compare(
        flown(form, RULES[rule], R=lambda mean, e: Rs, Q=lambda mean, e: Qs, h=per_run),
        R=Rs,
        Q=Qs,
        H=Hs,
    )
    dts = DT[:, None] * [1.0, 3.0]
    when = [celnav.Epoch(k, float(k), dts[k], z=Z[k]) for k in range(T)]
    compare(flown(form, RULES[rule], epochs=when), dt=dts.T)


@dataclass
class Antenna:
    """A callable object with data."""

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


KINDS_OF_FUNCTION = [
    move,
    Antenna.move,
    Antenna(H).move,
    partial(by_keyword, 1.0, offset=0.0),
    anything,
]


@FORMS
@pytest.mark.parametrize(
    "f", KINDS_OF_FUNCTION, ids=["function", "static", "bound", "partial", "of anything"]
)
def test_models_of_every_kind(form, f):
    for h in (
        Antenna(H),
        Antenna(H).__call__,
        partial(lambda own, x, e: x @ own.T, H),
        lambda x, e, own=H: x @ own.T,
    ):
        compare(flown(form, f=f, h=h, R=Antenna(H).noise, Q=partial(lambda q, mean, e: q, Q)))


@FORMS
def test_angles_at_the_seam(form):
    """A heading near pi, whose measurements jump by a full turn, gives the wrapped result of a
    heading without jumps.
    """
    x, z = np.array([[np.pi, 0.1], [-np.pi, -0.1]]), np.array([[np.pi], [-np.pi]]) + 0.3 * Z
    angle, heading = celnav.angles([0]), np.array([[1.0, 0.0]])
    motion = celnav.Motion(move, 0.01 * Q, space=angle)
    for turn in (wrap(z), z, z + 2.0 * np.pi, np.full_like(z, np.pi), np.full_like(z, -np.pi)):
        for h in (heading, lambda x, e: x[..., :1]):
            track = run(
                celnav.ukf(motion, celnav.Sensor(h, R, space=angle), form=form), x, 0.01 * P0, turn
            )
            for i in range(RUNS):
                near = x[i, 0] + wrap(turn[:, i] - x[i, 0])
                mean, cov = kalman(x[i], 0.01 * P0, z=near, H=heading, Q=0.01 * Q)
                np.testing.assert_allclose(wrap(track.mean[:, i, 0] - mean[:, 0]), 0.0, atol=1e-9)
                np.testing.assert_allclose(track.mean[:, i, 1], mean[:, 1], atol=1e-9)
                np.testing.assert_allclose(track.cov[:, i], cov, atol=1e-9)


@FORMS
def test_the_sign_of_a_quaternion_is_nothing(form):
    still, space = lambda q, e: q, attitude()
    motion, sensor = (
        celnav.Motion(still, 1e-4 * np.eye(3), space=space),
        celnav.Sensor(still, 1e-3 * np.eye(3), space=space),
    )
    filter = celnav.ukf(motion, sensor, form=form)
    q = RNG.normal(size=4)
    z = q / np.linalg.norm(q) + 0.02 * RNG.normal(size=(T, RUNS, 4))
    z /= np.linalg.norm(z, axis=-1, keepdims=True)
    flips = RNG.choice([-1.0, 1.0], size=(T, RUNS, 1))
    tracks = [
        run(filter, np.tile(sign * z[0, 0], (RUNS, 1)), 0.01 * np.eye(3), zs)
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
    motion, sensor = celnav.Motion(lambda x, e: x, [[1, 0], [0, 1]]), celnav.Sensor([[1, 0]], [[1]])
    rule, prior = (
        celnav.unscented(np.int64(2), alpha=np.float32(1.0)),
        celnav.Gaussian([1, 2], [[2, 0], [0, 1]]),
    )
    whole = celnav.sigma_point(motion, sensor, rule=rule, form=form, hooks=[gate(np.float64(1e3))])
    track = celnav.run(whole, prior, [0, 1], [[1], [3]], every=np.int64(1), keep="cov")
    np.testing.assert_allclose(track.cov[0], np.diag([2.0 / 3.0, 1.0]))
    np.testing.assert_allclose(track.mean[1], [1.0 + 2.0 * (5.0 / 3.0) / (8.0 / 3.0), 2.0])
    np.testing.assert_allclose(
        track.mean[1], celnav.run(whole, prior, iter(celnav.epochs([0, 1], [[1], [3]]))).mean[1]
    )


@FORMS
def test_other_parts_take_the_same(form):
    """The same for gains, fallbacks, and colored noise that differs between runs."""
    motion, sensor, _ = models()
    compare(
        run(Fallback(celnav.ukf(motion, sensor, form=form), celnav.ekf(motion, sensor, form=form)))
    )
    compare(run(celnav.ukf(motion, sensor, gain=consider(2, 0), form=form)))
    Phi, increments = np.array([[[0.5]], [[-0.2]]]), {"increments": R, "form": form}
    filters = [
        celnav.colored(motion, sensor, Phi, **increments),
        celnav.augmented(motion, sensor, Phi, **increments),
        celnav.augmented(motion, sensor, lambda e: Phi, **increments),
    ]
    tracks = [run(filter) for filter in filters]
    for track in tracks[1:]:
        np.testing.assert_allclose(track.mean[..., :2], tracks[0].mean, atol=1e-8)
        np.testing.assert_allclose(track.cov[..., :2, :2], tracks[0].cov, atol=1e-8)
    for filter in filters[:2]:  # Phi has the axis of runs
        np.testing.assert_allclose(
            run(filter, X0[0], z=Z[:, 0]).mean[:, 0, :2], tracks[0].mean[:, 0], atol=1e-8
        )


MOVED, SEEN, FUNCTION = (
    celnav.Motion(move, Q),
    celnav.Sensor(H, R),
    celnav.Sensor(lambda x, e: x @ H.T, R),
)
BIAS, PHI = celnav.Gaussian([0.0], [[4.0]]), [[0.5]]
MATRICES = celnav.Motion(celnav.Linear(lambda e: transition(e.dt)), Q), SEEN
THROUGH = celnav.Motion(lambda x, e, *w: move(x, e) + w[0], augment=(np.linalg.cholesky(Q),))
FILTERS = {
    "function": lambda form: celnav.ukf(MOVED, FUNCTION, form=form),
    "matrices": lambda form: celnav.ukf(*MATRICES, form=form),
    "two sensors": lambda form: celnav.ukf(MOVED, SEEN, FUNCTION, form=form),
    "iterated": lambda form: celnav.ekf(MOVED, FUNCTION, iterations=3, form=form),
    "posterior linearization": lambda form: celnav.ukf(MOVED, FUNCTION, iterations=3, form=form),
    "models": lambda form: celnav.imm(
        [celnav.ukf(MOVED, s, form=form) for s in (SEEN, FUNCTION)], [[0.9, 0.1], [0.2, 0.8]]
    ),
    "fallback": lambda form: Fallback(
        celnav.ukf(MOVED, SEEN, form=form), celnav.ekf(MOVED, SEEN, form=form)
    ),
    "single draw": lambda form: SingleDraw.of(
        celnav.ukf(THROUGH, celnav.Sensor(lambda x, e, *w: x @ H.T, R), form=form)
    ),
    "colored": lambda form: celnav.colored(MOVED, FUNCTION, PHI, form=form),
    "colored matrices": lambda form: celnav.colored(*MATRICES, PHI, form=form),
    "decorrelated": lambda form: celnav.decorrelated(MOVED, SEEN, PHI, form=form),
    "augmented": lambda form: celnav.augmented(MOVED, FUNCTION, PHI, form=form),
    "two stages": lambda form: celnav.two_stage(
        MOVED, SEEN, np.eye(1), BIAS, Qb=np.eye(1), form=form
    ),
    "fixes": lambda form: least_squares(celnav.Sensor(np.array([[1.0], [2.0]]), np.eye(2))),
}
GONE = {
    "nothing": (),
    "all": np.s_[:, :],
    "one run": np.s_[:, 1],
    "the first": np.s_[0],
    "the last": np.s_[-1],
    "a component": np.s_[2, 0, 0],
}


@FORMS
@pytest.mark.parametrize("gone", GONE)
@pytest.mark.parametrize("name", FILTERS)
def test_runs_of_a_batch_are_those_alone_whoever_brings_the_batch(name, gone, form):
    """Whether prior or measurements have the batch axes, with missing data; counts included."""
    filter, m = FILTERS[name](form), 2 if name == "fixes" else 1
    z = RNG.normal(size=(T, RUNS, m))
    if gone != "nothing":
        z[GONE[gone]] = np.nan
    x, P = (np.zeros(1), np.eye(1)) if name == "fixes" else (X0[0], P0)

    def followed(prior, z):
        with np.errstate(all="ignore"):
            return celnav.run(
                filter,
                prior,
                np.cumsum(DT),
                (z, z) if name == "two sensors" else z,
                keep="cov",
                on_failure="flag",
            )

    one = celnav.Gaussian(x, P)
    for prior in (one, celnav.Gaussian(np.tile(x, (RUNS, 1)), P)):
        both = followed(prior, z)
        for i in range(RUNS):
            alone = followed(one, z[:, i])
            for part in ("mean", "cov", "whitened", "used"):
                np.testing.assert_allclose(
                    getattr(both, part)[:, i], getattr(alone, part), atol=1e-9
                )
            np.testing.assert_allclose(both.log_likelihood[i], alone.log_likelihood, atol=1e-9)
            assert {event: count[i] for event, count in both.events.items()} == alone.events
    with pytest.raises(ValueError, match=r"^(z|prior, z): .*\(5,\)"):
        followed(celnav.Gaussian(np.tile(x, (3, 1)), P), np.ones((T, 5, m)))


@FORMS
def test_runs_that_only_the_coefficients_of_colored_noise_have(form):
    Phi = np.array([0.5, -0.2, 0.0])[:, None, None]
    for make in (celnav.colored, celnav.decorrelated, celnav.augmented):
        together = run(make(MOVED, SEEN, Phi, form=form), X0[0], z=Z[:, 0])
        for i in range(3):
            np.testing.assert_allclose(
                together.mean[:, i],
                run(make(MOVED, SEEN, Phi[i], form=form), X0[0], z=Z[:, 0]).mean,
                atol=1e-8,
            )


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
@FORMS
def test_colored_noise_of_a_function_goes_with_a_noise_of_the_interval(form, engine):
    """A motion of the package and a linear measurement as a function: the filter with the noise in
    the state is exact.
    """
    motion = celnav.models.motion.constant_velocity(1, q=0.3)
    sensor, times = celnav.Sensor(lambda x, epoch: x @ H.T, R), np.cumsum(DT)
    prior = celnav.Gaussian(X0, P0)
    found, known = (
        celnav.run(make(motion, sensor, 0.7, form=form), prior, times, Z, keep="cov", engine=engine)
        for make in (celnav.colored, celnav.augmented)
    )
    np.testing.assert_allclose(found.mean, known.mean[..., :2], atol=1e-9)
    np.testing.assert_allclose(found.cov, known.cov[..., :2, :2], atol=1e-9)
