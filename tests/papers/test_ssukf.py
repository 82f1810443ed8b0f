"""The attitude paper: its filters agree, settle at the theoretical values, and differ if a single
vector is measured.
"""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace
from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
from once import once
from readable import faults

from benchmarks import attitude as benchmark
from benchmarks.attitude import dense_filters
from celnav import run
from celnav.files import Outputs
from celnav.filters.model import Motion, Sensor
from celnav.filters.records import Epoch
from celnav.filters.sequential import sigma_point, ukf
from celnav.gaussian import attitude
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.rules import unscented
from celnav.models.gyro import Gyro, preintegrate, steady_state
from celnav.papers.ssukf import PRESETS, STUDY, filters, show, simulate, study
from celnav.papers.ssukf.scenario import (
    ARCSEC,
    DEG_PER_H,
    RADIUS_KM,
    STANDARD,
    Scenario,
    augmentations,
    dynamics,
    noise_root,
    spread,
    star,
    state_space,
)
from celnav.show.claims import dumps
from celnav.study.ledger import KINDS
from celnav.study.montecarlo import generator, normals

SHORT = replace(STANDARD, duration_s=10.0)


def apart(a, b):
    """Largest angle between two sequences of attitudes after the start, arcsec."""
    turned = attitude.multiply(a.mean[1:, ..., :4], attitude.inverse(b.mean[1:, ..., :4]))
    return attitude.angle(turned).max() / ARCSEC


@pytest.fixture(scope="module")
def sim():
    return simulate(SHORT, [generator(0, 0, r) for r in range(6)])


def tracks(sim, **options):
    return {
        name: run(filter, sim.prior, sim.epochs())
        for name, filter in filters(sim.config, **options).items()
    }


def test_the_filters_are_one_filter(sim):
    track = tracks(sim)
    assert apart(track["aukf"], track["ssukf"]) < 1e-6
    for other in ("aukf-1", "pa", "ma", "additive", "usque", "mekf"):
        assert apart(track["aukf"], track[other]) < 1e-3, other


@pytest.mark.parametrize("c", [15.0, 7.0, 0.15])
def test_at_equal_spread_switching_is_full_augmentation(sim, c):
    known = filters(sim.config, c=c)
    a = run(known["aukf"], sim.prior, sim.epochs())
    # In modified Rodrigues parameters a star's noise angle is 4 tan(angle / 4), and Q is a series
    # in the interval.
    for name, most, rtol in (("ssukf", 1e-7, 1e-9), ("pa", 1e-7, 1e-8), ("ma", 1e-4, 1e-5)):
        b = run(known[name], sim.prior, sim.epochs())
        assert apart(a, b) < most, name
        np.testing.assert_allclose(a.std, b.std, rtol=rtol, err_msg=name)


def test_transport_hardly_matters_where_attitude_is_measured_whole(sim):
    plain, moved = (filters(sim.config, transported=t)["ssukf"] for t in (False, True))
    a, b = (run(filter, sim.prior, sim.epochs()) for filter in (plain, moved))
    assert 1e-6 < apart(a, b) < 0.5
    np.testing.assert_allclose(a.std[-1], b.std[-1], rtol=0.01)


def test_preintegrated_samples_do_what_single_ones_do():
    short = replace(SHORT, duration_s=4.0)
    full, sim = (
        simulate(replace(short, preintegrated=p), [generator(0, 0, r) for r in range(3)])
        for p in (False, True)
    )
    few = run(filters(sim.config)["ssukf"], sim.prior, sim.epochs())
    many = run(filters(full.config)["ssukf"], full.prior, full.epochs())
    turned = attitude.multiply(few.mean[1:, ..., :4], attitude.inverse(many.mean[25::25, ..., :4]))
    assert attitude.angle(turned).max() < 2e-3 * ARCSEC


def test_samples_may_be_integrated_about_any_drift():
    full = simulate(replace(SHORT, preintegrated=False), [generator(0, 0, r) for r in range(3)])
    each = full.gyro.reshape(-1, 25, 3, 3).swapaxes(0, 1)
    drifts = (np.zeros(3), np.full(3, DEG_PER_H), np.array([1.0, -2.0, 3.0]) * DEG_PER_H)
    rates = [preintegrate(each, drift, full.config.step_s) for drift in drifts]
    assert max(np.abs(rate - rates[0]).max() for rate in rates) * 0.25 < 1e-12


def test_the_error_is_the_sensors_after_the_first_star(sim):
    track = run(filters(sim.config)["ssukf"], sim.prior, sim.epochs())
    error = (
        attitude.log(attitude.multiply(sim.truth[..., :4], attitude.inverse(track.mean[..., :4])))
        / ARCSEC
    )
    np.testing.assert_allclose(np.degrees(error[0] * ARCSEC)[:, 2], 10.0, atol=0.1)
    assert 12.0 < np.sqrt(np.square(error[1]).mean()) < 30.0
    assert np.sqrt(np.square(error[-1]).mean()) < 8.0


def test_drawn_errors_are_those_of_the_prior():
    sim = simulate(replace(SHORT, duration_s=0.25), [generator(1, 0, r) for r in range(400)])
    error = attitude.log(
        attitude.multiply(sim.truth[0][:, :4], attitude.inverse(sim.drawn.mean[:, :4]))
    )
    scatter = 4.0 / np.sqrt(2.0 * 400)  # four deviations of a deviation of 400 samples, relative
    np.testing.assert_allclose(error.std(0), SHORT.sigma0[:3], rtol=scatter)
    np.testing.assert_allclose(
        (sim.truth[0] - sim.drawn.mean)[:, 4:].std(0), SHORT.sigma0[3:], rtol=scatter
    )


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"star_hz": 3.0}, "gyro_hz"),
        ({"gyro_hz": 1.0}, "gyro_hz"),
        ({"tau_s": 0.0}, "tau_s"),
        ({"star_arcsec": -1.0}, "star_arcsec"),
        ({"prior_deg": (1.0, 0.0, 1.0)}, "prior_deg"),
        ({"inertia": ((1.0, 0.0), (0.0, 1.0))}, "inertia"),
        ({"alpha": 0.0}, "alpha"),
        ({"runs": 1.5}, "runs"),
    ],
)
def test_a_configuration_that_cannot_be_is_refused_by_name(change, name):
    with pytest.raises(ValueError, match=f"^{name}"):
        replace(PRESETS["standard"], **change)


# -- the study -------------------------------------------------------------------------------------
PRINTED = {
    "third-less-time": "1/3",
    "small-errors-fast": [1, 2],
    "large-error-faster": 10,
    "numbers-of-points": "4n + 2m + 1, 4n + 1, 2n + 2m + 1",
}
SAYS = {
    "equal-accuracy": "reproduced",
    "third-less-time": "in part",
    "small-errors-fast": "reproduced",
    "large-error-faster": "not reproduced",
    "numbers-of-points": "reproduced",
    "measurement-noise-idle": "reproduced",
    "augmentation-more-accurate": "in part",
    "component-mean-fails": "reproduced",
    "mrp-switch-cures": "in part",
    "quaternions-cheaper-to-propagate": "in part",
}


@pytest.fixture(scope="module")
def result():
    return once(STUDY)


def test_every_figure_draws_what_its_axes_say(result):
    assert list(show.FIGURES) == [f"figure_{i:02d}" for i in range(1, 9)]
    for stem, (caption, draw) in show.FIGURES.items():
        fig = draw(result)
        assert caption, stem
        number, beyond = int(stem[-2:]), " (not in the paper)" if stem > "figure_03" else ""
        assert fig.get_suptitle().startswith(f"Figure {number}{beyond}: "), stem
        assert not faults(fig), stem
        assert all(ax.get_xlabel() or ax.get_ylabel() or ax.get_title() for ax in fig.axes), stem


def test_figures_draw_euler_angles(result):
    np.testing.assert_allclose(
        np.abs(show.euler(result, "ssukf")[0]) / 3600.0, [[1.0, 2.0, 10.0]] * 6, rtol=1e-9
    )


def test_table_1_counts_points(result):
    (rows,) = (table(result) for _, table in show.TABLES.values())
    points = {(row["updates of time to measurement"], row["filter"]): row["points"] for row in rows}
    names = ("AUKF", "SSUKF", "PA", "MA", "ADDITIVE")
    assert [points["1:1", name] for name in names] == [62, 44, 38, 32, 26]
    assert [points["25:1", name] for name in names] == [806, 644, 638, 344, 338]


def test_what_settles_depends_on_how_the_gyro_is_read(result):
    settled = [[0.858, 0.0033], [14.4, 0.10], [1.031, 0.00695]]
    np.testing.assert_allclose(result.get("facts", "limits"), settled, rtol=5e-3)


def test_filters_report_the_exact_deviation(result):
    std, exact = (
        result.error("runs", "ssukf", "attitude", "std")[1:, 0, 2],
        result.get("facts", "exact")[1:, 0],
    )
    np.testing.assert_allclose(std, exact[: len(std)], rtol=2e-3)


def test_the_ledger_has_every_statement_as_printed():
    statements = {row.id: row for row in STUDY.rows if row.kind == "statement"}
    assert {id: row.expected or "reproduced" for id, row in statements.items()} == SAYS
    assert {id: row.printed for id, row in statements.items() if row.printed is not None} == PRINTED
    assert all(row.why for row in statements.values() if row.decide)


def test_what_has_no_sampling_error_is_decided_by_any_number_of_runs(result):
    listed = json.loads(dumps(result.claims()))["claims"]
    assert {c["kind"] for c in listed} == set(KINDS)
    found = {c["id"]: c for c in listed}
    exact = """third-less-time large-error-faster numbers-of-points measurement-noise-idle component-mean-fails equal-accuracy
        erratum-lambda gyro-numbers ordinary-cheaper quaternions-cheaper-to-propagate sign-not-norm"""
    for id in exact.split():
        assert found[id]["verdict"] == found[id]["expected"], id


def test_no_method_that_is_accurate_enough_is_told(result):
    row = next(row for row in STUDY.rows if row.id == "quaternions-cheaper-to-propagate")
    operations = result.data["operations"] | {"accuracy": np.ones((2, 3))}
    assert (
        row.judged(replace(result, data={**result.data, "operations": operations})).verdict
        == "no number"
    )


def test_the_block_size_changes_nothing():
    work, config = partial(study.run_filters, ("ssukf",)), replace(STANDARD, duration_s=3.0)
    whole, *parts = (
        work(config, [generator(0, 0, r) for r in runs])
        for runs in (range(3), range(2), range(2, 3))
    )
    for name in ("ssukf/error", "ssukf/nees"):
        np.testing.assert_allclose(
            np.concatenate([part[name] for part in parts], 1), whole[name], rtol=1e-6, atol=1e-9
        )


def test_a_run_does_not_depend_on_how_many_there_are():
    three, one = (simulate(SHORT, [generator(5, 0, r) for r in runs]) for runs in (range(3), (2,)))
    for name in ("truth", "gyro", "stars"):
        np.testing.assert_array_equal(getattr(three, name)[:, 2], getattr(one, name)[:, 0])


def test_the_full_rate_is_a_preset_and_changes_nothing():
    config = replace(PRESETS["100 Hz"], duration_s=1.0)
    difference = study.changes(config, [generator(0, 0, r) for r in range(3)])
    assert difference["ssukf"][0].max() < 1e-4
    full = simulate(config, [generator(0, 0, r) for r in range(3)])
    a, b = (study.means(full, name) for name in ("aukf", "ssukf"))
    assert a.shape == (5, 3, 7)
    assert study.apart(a, b)[0].max() < 1e-6


def test_a_recording_holds_what_the_filters_gave(result, tmp_path):
    assert show.record(result, Outputs(tmp_path)) == ["ssukf.rrd"]
    (found,) = rr.chunk.RrdReader(tmp_path / "ssukf.rrd").recordings()
    assert found.application_id == "celnav-ssukf"
    chunks = {
        str(c.entity_path): c
        for c in rr.chunk.RrdReader(tmp_path / "ssukf.rrd").stream().to_chunks()
        if not c.is_static
    }
    drift = chunks["/plots/drift/y/ssukf"].to_record_batch().column("Scalars:scalars").to_pylist()
    truth = simulate(result.parts["runs"].config, [generator(0, 0, 0)]).truth[:, 0, 5] / DEG_PER_H
    np.testing.assert_allclose(
        np.array(drift)[:, 0],
        truth + result.error("runs", "ssukf", "drift")[:, 0, 1],
        rtol=1e-9,
        atol=1e-12,
    )
    assert {"/world/sat", "/body/aukf", "/error/mekf/ellipsoid", "/plots/drift/y/mekf"} <= set(
        chunks
    )


def test_points_along_noise_that_a_function_ignores_are_the_center_again():
    sim = simulate(replace(SHORT, duration_s=0.25), [generator(0, 0, 0)])
    epoch, noises = (
        list(sim.epochs())[-1],
        (noise_root(STANDARD.gyro, 0.25), STANDARD.sigma_n * np.eye(3)),
    )
    x, *noise = spread(15, STANDARD).points(
        sim.prior.mean[0], sim.prior.sqrt_cov, state_space(), noises
    )
    for y, copies in (
        (dynamics(STANDARD.gyro)(x, epoch, *noise), 6),
        (np.hstack([star(x, epoch, *noise), x]), 12),
    ):
        assert (y[1:] == y[0]).all(-1).sum() == copies


def test_the_orbit_at_800_km_turns_faster_than_is_printed():
    assert np.sqrt(398600.4418 / RADIUS_KM**3) == pytest.approx(1.0381e-3, rel=1e-4)


def test_filters_are_the_linear_kalman_filter_where_all_is_small():
    """A satellite at rest and errors of an arc minute."""
    c, gyro, T, runs = STANDARD, STANDARD.gyro, 101, 3
    initial, white, walk, noise = normals(
        [generator(0, 7, r) for r in range(runs)], (6,), (T - 1, 3), (T - 1, 3), (T, 3)
    )
    deviation = np.concatenate([np.full(3, 60.0 * ARCSEC), c.sigma0[3:]])
    drift = gyro.drift(deviation[3:] * initial[:, 3:], walk, 0.25)
    q = np.broadcast_to(attitude.IDENTITY, (T, runs, 4))
    samples, turned = gyro.measure(q, drift, white, 0.25), c.sigma_n * noise
    start, zero = -deviation[:3] * initial[:, :3], np.zeros((runs, 3))
    prior = Gaussian(np.concatenate([attitude.exp(start), zero], -1), np.diag(deviation**2))
    sim = Scenario(
        replace(c, duration_s=25.0),
        np.concatenate([q, drift], -1),
        samples,
        attitude.exp(turned),
        prior,
        prior,
    )

    def f(x, epoch):
        return np.concatenate(
            [x[..., :3] + (epoch.u - x[..., 3:]) * epoch.dt, gyro.factor(0.25) * x[..., 3:]], -1
        )

    exact = ukf(
        Motion(f, gyro.process_noise(0.25)),
        Sensor(np.eye(3, 6), sqrt_R=c.sigma_n * np.eye(3)),
        form="covariance",
    )
    epochs = [
        Epoch(
            k, 0.25 * k, 0.25 if k else 0.0, samples[k - 1] if k else None, turned[k] if k else None
        )
        for k in range(T)
    ]
    flat = run(
        exact, Gaussian(np.concatenate([start, zero], -1), np.diag(deviation**2)), epochs
    ).mean
    reference = np.concatenate([attitude.exp(flat[..., :3]), flat[..., 3:]], -1)
    for name in ("aukf", "ssukf", "additive", "usque", "mekf"):
        found, drifts = study.apart(reference, study.means(sim, name))
        assert found.max() < 1e-3, name
        assert drifts.max() < 2e-4, name


# -- one side augmented, operations, heads, means: closed forms and counts made otherwise ----------
SQUARE = {"rule": lambda n: unscented(n, kappa=3.0 - n), "form": "covariance"}


@pytest.mark.parametrize("through", ["process", "measurement"])
def test_the_side_that_is_augmented_knows_the_square_of_its_noise(through):
    """The scalar ``x + w^2`` has mean ``x + q`` and variance ``P + 2 q^2``; linearized about
    ``w = 0`` the noise vanishes.
    """
    prior, q = Gaussian(np.array([2.0]), np.array([[0.5]])), 0.3

    def model(x, _epoch, *noise):
        return x + (noise[0] if through == "process" else noise[-1]) ** 2 if noise else x

    root, nothing = np.array([[np.sqrt(q)]]), np.zeros((1, 1))
    motion, sensor = Motion(model, nothing), Sensor(model, np.array([[1e-9]]))
    for name, filter in augmentations(motion, sensor, root, root, **SQUARE).items():
        state = filter.start(prior)
        if through == "process":
            after = filter.predict(state, Epoch(1, 1.0, 1.0)).belief
            mean, variance, sides = after.mean[0], after.cov[0, 0], ("aukf", "ssukf", "pa")
        else:
            _, (info,) = filter.step(state, Epoch(0, 0.0, 0.0, None, np.array([2.7])))
            mean, variance, sides = (
                2.7 - info.innovation[0],
                info.sqrt_S[0, 0] ** 2,
                ("aukf", "ssukf", "ma"),
            )
        expected = (2.3, 0.5 + 2.0 * q**2) if name in sides else (2.0, 0.5)
        np.testing.assert_allclose((mean, variance), expected, rtol=1e-7, err_msg=name)


def test_noise_of_a_turning_gyros_scales_tells_no_side_from_another():
    """The rate is ``1 + s`` times the measurement minus drift and noise; ``s`` with σ 0.01 is drawn
    for each sample.
    """
    config, runs = replace(study.COARSE, duration_s=20.0), [generator(0, 31, r) for r in range(50)]
    sim, gyro, dt = simulate(config, runs), config.gyro, config.step_s
    turns = (
        attitude.log(
            attitude.multiply(sim.truth[1:, :, :4], attitude.inverse(sim.truth[:-1, :, :4]))
        )
        / dt
    )
    s = 0.01 * np.random.default_rng(3).standard_normal(turns.shape)
    sim, plain = sim._replace(gyro=sim.gyro - turns * s / (1.0 + s)), dynamics(gyro)
    W, V = np.diag([*noise_root(gyro, dt).diagonal(), 0.01, 0.01, 0.01]), config.sigma_n * np.eye(3)

    def f(x, epoch, *noise):
        if not noise:
            return plain(x, epoch)
        white, drift, s = np.split(noise[0], 3, -1)
        return plain(
            x, epoch, np.concatenate([white - (epoch.u - x[..., 4:] - white) * s, drift], -1)
        )

    def columns(x, epoch):
        scales = 0.01 * dt * (epoch.u - x[..., 4:])[..., None] * np.eye(6, 3)[:3]
        root = np.broadcast_to(np.linalg.cholesky(gyro.process_noise(dt)), (*x.shape[:-1], 6, 6))
        return np.concatenate([root, np.concatenate([scales, np.zeros_like(scales)], -2)], -1)

    motion, seen = (
        Motion(f, sqrt_Q=columns, space=state_space()),
        Sensor(star, sqrt_R=V, space=attitude.attitude()),
    )
    known = augmentations(
        motion, seen, W, V, rule=lambda n: spread(n, config, c=15.0), form="covariance"
    )
    error = {
        name: study.errors(sim.truth, run(one, sim.drawn, sim.epochs(), keep="mean").mean)
        for name, one in known.items()
    }
    size = {name: np.sqrt(np.square(each[40:, :, :3]).mean()) for name, each in error.items()}
    assert np.ptp(list(size.values())) < 1e-3 * size["ssukf"]
    assert size["ssukf"] < np.radians(2.0)


class Counting(float):
    """A float that counts its operations."""

    count = 0


def _counting(name):
    def operate(self, *others):
        Counting.count += name not in ("__neg__",)
        result = getattr(float, name)(self, *others)
        return result if result is NotImplemented else Counting(result)

    return operate


for _name in ("add", "radd", "sub", "rsub", "mul", "rmul", "truediv", "rtruediv", "neg"):
    setattr(Counting, f"__{_name}__", _counting(f"__{_name}__"))


def plain_python(noise, dense, per, monkeypatch):
    """Operations of the benchmark's filter on floats from star to star."""
    filter = benchmark.Scalar(*noise, dense=dense)
    filter.P = [[Counting(x) for x in row] for row in filter.P]
    filter.sigma_time, filter.sigma_measured = (
        [Counting(x) for x in s] for s in (filter.sigma_time, filter.sigma_measured)
    )
    filter.q, filter.b, filter.dt = (
        [Counting(x) for x in filter.q],
        [Counting(x) for x in filter.b],
        Counting(filter.dt),
    )
    known = {
        name: lambda *x, f=getattr(math, name): counted(f, *x)
        for name in ("sqrt", "sin", "cos", "copysign")
    }

    def counted(function, *x):
        Counting.count += 1
        return Counting(function(*x))

    monkeypatch.setattr(benchmark, "math", SimpleNamespace(**known))
    Counting.count = 0
    for _ in range(per):
        filter.predict([1e-4, 2e-4, 3e-4])
    filter.update([0.0, 0.0, 0.0, 1.0])
    return Counting.count


def test_operations_are_those_that_plain_python_does(result, monkeypatch):
    """In another form, point by point on floats, it takes other numbers of operations, but saves
    the same fraction.
    """
    each = {}
    for roots in study.ROOTS:
        for per in (1, 25):
            own = {
                name: result.value("operations", f"{name}, {per}:1, {roots}", 0)
                for name in benchmark.POINTWISE
            }
            other = {
                name: plain_python(noise, roots == "whole", per, monkeypatch)
                for name, noise in benchmark.POINTWISE.items()
            }
            assert own["ssukf"] / own["aukf"] == pytest.approx(
                other["ssukf"] / other["aukf"], abs=0.02
            ), (roots, per)
            for name in benchmark.POINTWISE:
                each[name, roots, per] = own[name], other[name]
                # Only the tape counts selections of a sign and of invalid roots.
                assert 1.0 < own[name] / other[name] < 1.25
    # Each prediction takes as many operations as any other. Factoring the whole joint covariance
    # costs the AUKF as much in an update as in a prediction, for it has the same noise in both.
    for name, roots in product(benchmark.POINTWISE, study.ROOTS):
        for many, one in zip(each[name, roots, 25], each[name, roots, 1], strict=True):
            assert (many - one) % 24 == 0
    for way in (0, 1):
        many, one = (
            each["aukf", "whole", per][way] - each["aukf", "block", per][way] for per in (25, 1)
        )
        assert 2 * many == 26 * one > 0
    lower, whole = (2 * n * (n * n - 1) // 6 + n * (n - 1) // 2 + n for n in (6, 15))
    assert each["aukf", "whole", 1][1] - each["aukf", "block", 1][1] == 2 * (whole - lower + 9)
    assert [
        benchmark.calls(noise, per) for noise in benchmark.POINTWISE.values() for per in (1, 25)
    ] == [62, 806, 44, 644]


def test_a_tape_counts_what_is_done():
    assert study.counted(lambda a, b: a @ b, (3, 4), (4, 2)).tolist() == [42, 42]
    assert study.counted(lambda x: np.sqrt(x) / x[0], (2,)).tolist() == [4, 80]
    n = 15  # products and sums, divisions, roots and the choice of what is no root
    assert study.counted(study.cholesky, (n, n))[0] == (n**3 - n) // 3 + n * (n - 1) // 2 + 3 * n


def test_parameters_are_integrated_to_their_order():
    p, turn = np.array([[0.3, -0.2, 0.5]]), np.array([[0.02, 0.01, -0.03]])
    exact = attitude.to_rodrigues(
        attitude.multiply(attitude.exp(turn), attitude.from_rodrigues(p, 1.0, 1.0)), 1.0, 1.0
    )
    half = attitude.to_rodrigues(
        attitude.multiply(attitude.exp(turn / 2.0), attitude.from_rodrigues(p, 1.0, 1.0)), 1.0, 1.0
    )
    for order in study.SLOPES:
        errors = [
            np.abs(study.integrated(order, p, step) - to).max()
            for step, to in ((turn, exact), (turn / 2.0, half))
        ]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.2)
    assert np.sqrt(1e-9 / study.propagations(0.01)["accuracy"][1, 0]) == pytest.approx(
        0.4, abs=0.05
    )  # deg/s, of Euler's step


def test_means_of_quaternions_have_their_closed_forms(result):
    q = attitude.exp(np.array([[0.0, 0.0, 0.0], [0.0, 0.8, 0.0]]))
    for sign, norm in (
        (1.0, np.cos(0.2)),
        (-1.0, np.sin(0.2)),
    ):  # one sign turns the direction by half a turn: 0.8 / 2 + pi
        mean = 0.5 * (q[0] + sign * q[1])
        assert np.linalg.norm(mean) == pytest.approx(norm)
        assert attitude.angle(mean / norm) == pytest.approx(0.4 if sign > 0.0 else np.pi - 0.4)
    c, s = np.array([[0.12], [0.09]]), np.radians(study.AVERAGED_DEG)
    half = 2.0 * np.arctan(np.sqrt(c) * s / 4.0)  # of the angle of a point on an axis
    np.testing.assert_allclose(
        result.get("facts", "norm"), (3.0 / c * (1.0 - np.cos(half))).max(0), rtol=1e-5
    )
    # The eigenvector leaves the center where the square of an axis exceeds the square of the
    # scalar.
    assert ((4.0 * np.sin(half) ** 2 / c > 1.0) == (result.get("facts", "eigen") > 1.0)).all()


@pytest.mark.parametrize("ratio", [5.0, 8.0, 16.0])
def test_heads_at_right_angles_have_no_weak_axis(ratio, monkeypatch):
    """The combined information of both heads in closed form, and the steady state with it, for any
    assumed noise about the line of sight.
    """
    monkeypatch.setattr(study, "ABOUT", ratio)
    settled = {}
    for degrees, count in ((0.0, 1), (30.0, 2), (60.0, 2), (90.0, 2)):
        h, variances = np.radians(degrees / 2.0), []
        for along in (np.cos(h) ** 2, np.sin(h) ** 2, 0.0):
            variances.append(1.0 / (count * (along / ratio**2 + 1.0 - along)))
        worst = 1.0 / (2.0 - (1.0 - ratio**-2) * (1.0 + np.cos(2.0 * h)))
        assert count == 1 or variances[0] == pytest.approx(worst)
        gyro = replace(STANDARD.gyro, tau=np.inf)
        each = [
            steady_state(STANDARD.sigma_n * np.sqrt(v), gyro, 0.25).attitude_after
            for v in variances
        ]
        settled[degrees] = max(each) / min(each)
    assert settled[90.0] < 1.3 < settled[60.0] < settled[30.0] < settled[0.0]
    if ratio == 8.0:
        two = STANDARD.sigma_n / ARCSEC * np.array([1.0 / np.sqrt(1.0 / 64.0 + 1.0), np.sqrt(0.5)])
        np.testing.assert_allclose(two, [19.85, 14.14], atol=0.01)


def test_two_heads_one_after_the_other_are_one_with_their_noise_together(sim):
    """And the SSUKF gives the result of the MEKF."""
    roots = [sim.config.sigma_n * np.diag(d) for d in ([8.0, 1.0, 1.0], [1.0, 8.0, 1.0])]
    weights = [np.linalg.solve(root @ root, np.eye(3)) for root in roots]
    together = np.linalg.solve(sum(weights), np.eye(3))
    v = np.random.default_rng(5).standard_normal((2, len(sim.truth), 6, 3))
    seen = [
        attitude.multiply(attitude.exp(noise @ root), sim.truth[..., :4])
        for noise, root in zip(v, roots, strict=True)
    ]
    whole = (
        sum(noise @ root @ weight for noise, root, weight in zip(v, roots, weights, strict=True))
        @ together
    )
    fused = attitude.multiply(attitude.exp(whole), sim.truth[..., :4])
    prior = Gaussian(sim.truth[0], np.diag([60.0 * ARCSEC] * 3 + [DEG_PER_H] * 3) ** 2)
    tracks = []
    for name in ("mekf", "ssukf"):
        one = filters(sim.config)[name]
        sensor = replace(one.sensors[0], augment=(), sqrt_R=roots[0])
        for sensors in (
            [replace(sensor, sqrt_R=root) for root in roots],
            [replace(sensor, sqrt_R=None, R=together)],
        ):
            epochs = [
                e._replace(
                    z=(tuple(z[k] for z in seen) if len(sensors) == 2 else fused[k]) if k else None
                )
                for k, e in enumerate(sim.epochs())
            ]
            tracks.append(
                run(
                    sigma_point(one.motion, *sensors, rule=one.rule, form="covariance"),
                    prior,
                    epochs,
                )
            )
    for track in tracks[1:]:
        assert apart(tracks[0], track) < 0.01
        np.testing.assert_allclose(track.std[-1], tracks[0].std[-1], rtol=1e-4)


# -- against forms written down anew ---------------------------------------------------------------
def textbook_usque(sim, run_index, steps):
    """USQUE for one run, in plain loops over points, with its own quaternion algebra [Crassidis &
    Markley 2003, Table 1].
    """
    c, gyro, T = sim.config, sim.config.gyro, 1.0 / sim.config.star_hz

    def product(q, p):
        v = p[:3] * q[3] + q[:3] * p[3] - np.cross(q[:3], p[:3])
        return np.append(v, q[3] * p[3] - q[:3] @ p[:3])

    def conjugate(q):
        return np.append(-q[:3], q[3])

    def to_p(q):
        q = q if q[3] >= 0.0 else -q
        return 4.0 * q[:3] / (1.0 + q[3])

    def to_q(p):
        q4 = (16.0 - p @ p) / (16.0 + p @ p)
        return np.append((1.0 + q4) / 4.0 * p, q4)

    half = 0.5 * np.diag(
        np.repeat([gyro.sigma_v**2 * T - gyro.sigma_u**2 * T**3 / 6.0, gyro.sigma_u**2 * T], 3)
    )
    R, n, lam = c.sigma_n**2 * np.eye(3), 6, 1.0
    w0, w = lam / (n + lam), 0.5 / (n + lam)

    def points(P):
        root = np.sqrt(n + lam) * np.linalg.cholesky(P)
        return [np.zeros(6), *root.T, *(-root.T)]

    q, b, P, out = sim.prior.mean[run_index, :4], sim.prior.mean[run_index, 4:], sim.prior.cov, []
    for k in range(1, steps + 1):
        moved = []
        for s in points(P + half):
            rate = sim.gyro[k - 1, run_index] - (b + s[3:])
            angle = np.linalg.norm(rate) * T
            turn = np.append(rate / np.linalg.norm(rate) * np.sin(angle / 2.0), np.cos(angle / 2.0))
            moved.append(
                (product(turn, product(to_q(s[:3]), q)), np.exp(-T / gyro.tau) * (b + s[3:]))
            )
        center = moved[0][0]
        chi = np.array([np.append(to_p(product(m, conjugate(center))), d) for m, d in moved])
        mean = w0 * chi[0] + w * chi[1:].sum(0)
        spread = chi - mean
        P = w0 * np.outer(spread[0], spread[0]) + w * spread[1:].T @ spread[1:] + half
        q, b = product(to_q(mean[:3]), center), mean[3:]
        chi = np.array(points(P))
        z = to_p(product(sim.stars[k, run_index], conjugate(q)))
        seen = np.array([to_p(to_q(s[:3])) for s in chi])
        expected = w0 * seen[0] + w * seen[1:].sum(0)
        dz = seen - expected
        S = w0 * np.outer(dz[0], dz[0]) + w * dz[1:].T @ dz[1:] + R
        cross = w0 * np.outer(chi[0], dz[0]) + w * chi[1:].T @ dz[1:]
        K = np.linalg.solve(S, cross.T).T
        d = K @ (z - expected)
        q, b, P = product(to_q(d[:3]), q), b + d[3:], P - K @ S @ K.T
        out.append((q, b, P))
    return out


def test_usque_is_that_of_the_textbook(sim):
    track = run(filters(sim.config)["usque"], sim.prior, sim.epochs(), keep="cov")
    for k, (q, b, P) in enumerate(textbook_usque(sim, 2, 30), start=1):
        turned = attitude.multiply(track.mean[k, 2, :4], attitude.inverse(q))
        assert attitude.angle(turned) < 1e-7 * ARCSEC + 1e-13
        np.testing.assert_allclose(track.mean[k, 2, 4:], b, rtol=1e-7, atol=1e-15)
        np.testing.assert_allclose(
            np.sqrt(np.diag(track.cov[k, 2])), np.sqrt(np.diag(P)), rtol=1e-6
        )


def careless_mekf(sim, *, gibbs):
    """A multiplicative extended filter, 4 Hz; ``gibbs``: whether residual and update use the same
    parameters.
    """
    c, gyro, T = sim.config, sim.config.gyro, 1.0 / sim.config.star_hz
    runs = len(sim.prior.mean)
    q, b, P = sim.prior.mean[:, :4].copy(), sim.prior.mean[:, 4:].copy(), np.array(sim.prior.cov)
    H, R, Q, out = np.eye(3, 6), c.sigma_n**2 * np.eye(3), gyro.process_noise(T), []
    for k in range(1, len(sim.truth)):
        turn = (sim.gyro[k - 1] - b) * T
        F = np.zeros((runs, 6, 6))
        F[:, :3, :3] = np.eye(3) - attitude.cross(turn)
        F[:, :3, 3:] = -T * np.eye(3)
        F[:, 3:, 3:] = gyro.factor(T) * np.eye(3)
        q, b, P = attitude.multiply(attitude.exp(turn), q), gyro.factor(T) * b, F @ P @ F.mT + Q
        error = attitude.positive(attitude.multiply(sim.stars[k], attitude.inverse(q)))
        y = 2.0 * error[:, :3] / (error[:, 3:] if gibbs else 1.0)
        K = np.linalg.solve(P[:, :3, :3] + R, H @ P).mT
        d = (K @ y[..., None])[..., 0]
        moved = np.concatenate([0.5 * d[:, :3], np.ones((runs, 1))], -1)
        q = attitude.multiply(moved / np.linalg.norm(moved, axis=-1, keepdims=True), q)
        b, P = b + d[:, 3:], (np.eye(6) - K @ H) @ P
        out.append(np.concatenate([q, b], -1))
    return np.array(out)


def test_mekf_is_that_of_the_textbook_and_its_usual_mistake_costs_two_minutes(sim):
    track = run(filters(sim.config)["mekf"], sim.prior, sim.epochs())
    right, wrong = (careless_mekf(sim, gibbs=gibbs) for gibbs in (True, False))
    assert (
        attitude.angle(
            attitude.multiply(track.mean[1:, :, :4], attitude.inverse(right[..., :4]))
        ).max()
        < 1e-3 * ARCSEC
    )
    error = (
        attitude.log(attitude.multiply(sim.truth[1, :, :4], attitude.inverse(wrong[0, :, :4])))
        / ARCSEC
    )
    assert 120.0 < np.sqrt(np.square(error[:, 2]).mean()) < 165.0  # 20 are expected
    error = (
        attitude.log(attitude.multiply(sim.truth[1, :, :4], attitude.inverse(right[0, :, :4])))
        / ARCSEC
    )
    assert np.sqrt(np.square(error[:, 2]).mean()) < 35.0


def test_jacobians_of_the_gyro_are_the_differences():
    rng, gyro = np.random.default_rng(5), Gyro(1e-4, 1e-5, 50.0)
    x = np.concatenate([attitude.exp(rng.normal(size=3)), [1e-3, -2e-3, 3e-3]])
    rate, dt, space = np.array([0.3, -0.5, 0.4]), 1.5, state_space(a=0.0, b=2.0)
    for scale in (1.0, 1e-4):
        tangents = 1e-6 * np.vstack([np.eye(6), -np.eye(6)])
        y = gyro.propagate(space.plus(x, tangents), scale * rate, dt)
        d = space.minus(y, gyro.propagate(x, scale * rate, dt))
        np.testing.assert_allclose(
            gyro.transition(x, scale * rate, dt), (d[:6] - d[6:]).T / 2e-6, atol=1e-8
        )


def total_prior(sim):
    root = np.linalg.solve(study.to_tangent(sim.prior.mean[:, :4]), sim.prior.sqrt_cov)
    return Gaussian(sim.prior.mean, root @ root.mT)


def test_dense_roots_and_total_attitudes_are_the_same_filters(sim):
    known = filters(sim.config)
    plain = {name: run(known[name], sim.prior, sim.epochs()) for name in ("aukf", "ssukf")}
    for name, filter in dense_filters(sim.config).items():
        assert apart(plain[name], run(filter, sim.prior, sim.epochs())) < 1e-6
    total = run(study.total_filter(sim.config), total_prior(sim), sim.epochs(), keep="cov")
    assert 1e-4 < apart(plain["ssukf"], total) < 0.2
    G, local = (
        study.to_tangent(total.mean[-1, :, :4]),
        run(known["ssukf"], sim.prior, sim.epochs(), keep="cov").cov[-1],
    )
    scale = np.sqrt(local.diagonal(0, -2, -1))
    assert (
        np.abs(G @ total.cov[-1] @ G.mT - local) / (scale[..., :, None] * scale[..., None, :])
    ).max() < 1e-3


def test_variants_give_the_same_in_square_root_form(sim):
    """With a covariance in place of a root all runs failed, or the error was ten times larger."""

    def total(config, form):
        return {"ssukf": study.total_filter(config, form=form)}

    for made, prior in ((dense_filters, sim.prior), (total, total_prior(sim))):
        in_forms = [made(sim.config, form=form) for form in ("covariance", "square root")]
        for name in in_forms[0]:
            one, other = (run(filters[name], prior, sim.epochs()) for filters in in_forms)
            assert apart(one, other) < 1e-6, name
            np.testing.assert_allclose(one.std, other.std, rtol=1e-6)


def test_one_vector_separates_the_filters_and_equal_spread_unites_them():
    rngs, config = [generator(3, 70, r) for r in range(4)], replace(study.VECTOR, duration_s=30.0)
    wide, same = (
        study.vector(replace(config, beta=beta), rngs, c=c) for c, beta in ((15.0, 2.0), (7.0, 0.0))
    )
    for degrees in (10, 30):
        for out, name, other in ((wide, "aukf", "ssukf"), (same, "usque", "ssukf")):
            a, b = (out[f"{one}, {degrees}/error"][..., :3] for one in (name, other))
            np.testing.assert_allclose(a, b, atol=4e-3)  # arcsec
        assert (
            np.abs(same[f"mekf, {degrees}/error"] - same[f"usque, {degrees}/error"])[
                5:, :, :3
            ].max()
            > 36.0
        )


def test_the_field_is_a_dipoles():
    u = 0.3
    up = np.array([np.cos(u), np.sin(u) * 0.5, np.sin(u) * np.sqrt(0.75)])
    field = study.field(0.3)
    assert np.linalg.norm(field) == pytest.approx(1.0)
    # tan(dip) = 2 tan(latitude).
    assert field @ up / np.linalg.norm(field - (field @ up) * up) == pytest.approx(
        2.0 * np.tan(np.arcsin(up[2]))
    )


def test_filters_warn_of_points_that_wrap():
    with pytest.warns(RuntimeWarning, match="232 deg from the mean, and wrap at 180"):
        filters(replace(STANDARD, prior_deg=(60.0, 60.0, 60.0), alpha=1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        filters(replace(STANDARD, prior_deg=(40.0, 40.0, 40.0), alpha=1.0))


def test_the_total_form_switches_its_parameters_with_the_covariance():
    total, local = study.total_attitude(), attitude.attitude()
    q = attitude.exp(np.radians([179.0, 0.0, 0.0]))
    step = attitude.exp(np.radians([2.0, 0.0, 0.0]))
    deviations = 1e-5 * np.array(
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]
    )
    points = total.plus(q, deviations)
    moved = attitude.positive(attitude.multiply(step, points))
    # The center has switched to the parameters of -179 deg. Differences are taken on the same side.
    assert moved[0] @ attitude.multiply(step, points)[0] < 0.0
    differences = total.minus(moved, moved[0])
    assert np.abs(differences).max() < 2e-5
    tangents = (
        differences @ (4.0 * attitude.transport(moved[0, :3] / (1.0 + moved[0, 3]), 1.0, 1.0)).T
    )
    np.testing.assert_allclose(tangents, local.minus(moved, moved[0]), atol=1e-9)
    covariance = tangents.T @ tangents
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_a_total_form_leads_back():
    total = study.total_attitude()
    q = attitude.exp(np.array([[0.5, -1.0, 2.0], [0.0, 0.0, 0.0]]))
    t = 1e-3 * np.array([[1.0, 2.0, 3.0], [-1.0, 0.5, 0.0]])
    np.testing.assert_allclose(total.minus(total.plus(q, t), q), t, atol=1e-14)
    np.testing.assert_allclose(total.minus(-total.plus(q, t), q), t, atol=1e-14)
