"""Wrong values raise an error that names the argument: every argument of every public function is
replaced by typical mistakes.
"""

# ruff: noqa: C408 (arguments read as in a call)
from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from copy import deepcopy
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from pkgutil import iter_modules

import numpy as np
import pytest
import rerun as rr
from matplotlib.figure import Figure

import celnav
from celnav.analysis import bounds, metrics, observability
from celnav.gaussian import attitude, rules, spaces
from celnav.models import earth, ephemeris, gravity, gyro, inertial, noise, orbit, pulsar, sightings
from celnav.show import recording, views
from celnav.study import montecarlo, problem, trial

PACKAGES = ("gaussian", "models", "analysis", "study", "show")
MODULES = {
    name: import_module(f"celnav.{package}.{name}")
    for package in PACKAGES
    for _, name, _ in iter_modules([f"{celnav.__path__[0]}/{package}"])
} | {
    "constellation": import_module("celnav.receiver.constellation"),
}
HOT = """
attitude: multiply inverse positive matrix rotate exp log angle to_euler to_rodrigues from_rodrigues cross transport
attitude: cross_product turn_coefficients renormalized
spaces: wrap component_major components_first points_last Space.part Space.places
rules: Rule.points Rule.image Rule.state_columns Rule.num_sigmas Taylor.points Taylor.image Taylor.state_columns
earth: meridian_radius transverse_radius radii normal_gravity earth_rate transport_rate inertial_forces fixed_position
gravity: Gravity.potential Gravity.acceleration Gravity.gradient
orbit: acceleration third_body step transition gradient advance flow
sightings: angles visible observe
misalignment: derivative advance star_residuals misalignment_matrix misalignment_angles
gyro: Gyro.factor Gyro.rate_std Gyro.drift_std Gyro.process_noise Gyro.propagate Gyro.transition
gyro: Body.nadir Body.rates
pulsar: Timing.delay Timing.shapiro Timing.shapiro_exact Timing.gradient
gnss: satellites ahead_s eccentric_anomaly tilted turned spun
pseudorange: sources emitted emitted_each measure jacobian undetermined
linalg: block cholesky downdate present sigma_deviations matvec outer semidefinite_root side_by_side solve_lower is_concretely_true
    solve_positive solve_right tria whiten SquareRoot.lost Covariance.lost
recorded: cholesky outer present semidefinite_root solve_lower tria
belief: any_lost nees mask_failed
trial: check_groups scales squares Noiseless.standard_normal
"""
"""Functions that a filter calls at every step do not check arrays, because a check would take
longer than the computation.
"""
INSIDE = """
checks: as_matrix numbers finite number integer integers as_integer choice function sequence together
    broadcast_batches instance describe unmasked accepts
drawing: Drawing.draw Drawing.set legend_below render styled
rules: check_point_count AnyDimension
sparse_grid: check_orders univariate
views: blueprint
draw: band bars components curve grid interval level look note panels picture_names pictures quantiles
figures: consistency errors rmse rmse_table sigma
ephemeris: de421
pulsar: known
orbit: warn_of_degrees
gnss: Broadcast Broadcast.chosen
belief: symmetric
extended_pose: extended_pose
inertial: Strapdown
montecarlo: Draws Draws.close blocks effort generators renewed run_of steps
claims: accepted answer Ledger cells columns counted decisive dumps ledger mark markdown meaning notes ours outcome plain
    printed read_claims style tally written
gyro: Gyro.drift
ledger: Claim Row Row.judged estimate order read_ledger read_printed
operations: counted step_operations
numbers: all_of consistency constant correlation count_holding entries lagged of operations over
    over_time ratio rmse settling some tiers
parameters: Parameters.check param
store: Store Store.forget_all_but Store.has Store.path Store.read Store.write code existing open_store resumed
sightings: limb
study: concatenated
study: Results Results.at Results.claims Results.error Results.first Results.get Results.group Results.nees Results.squares
    Results.times Results.value Study Study.at_hand Study.reproduce Study.results Study.units Unit.check Unit.do evaluate_filters
    evaluate_from_priors monte_carlo
page: aligned_left macro render
notebook: Folded Table parameters
picture: picture
viewer: address as_script is_current is_script_of page script_name viewer
progress: Progress Progress.add Progress.close Progress.runs
estimates: Estimate Estimate.error Estimate.sigma estimates_of measurement_states sensor_states
window: Viewer Viewer.ask Viewer.open command require_display show start viewer
plots: draw legend_place
diagnose: Diagnosis.biased Diagnosis.white autocorrelation first_order forgotten_wraps grid_index
diagnosis_text: consistency laid_out page
diagnosis: figure size
history: figure
reading: Entity Recorded read
recording: new_file open_stream typed
streaming: live
report: Report.figure component_names errors
scenes: arc behind beside constellation flight sigma_points sightings track turning unit
showcase: Showcase record write
"""
"""Functions that check arguments, that have none, that only celnav calls, or that pass arguments to
a library with its own checks.
"""

LOG = np.random.default_rng(0).standard_normal((60, 2))
I2, I3, I6 = np.eye(2), np.eye(3), np.eye(6)
Q4 = attitude.IDENTITY
X6 = np.array([7000.0, 0.0, 0.0, 0.0, 7.5, 0.0])
TIMES = np.arange(5.0)
FLIGHT = dict(
    longitude=0.1,
    latitude=0.5,
    height_m=1e3,
    speed=100.0,
    heading=0.0,
    acceleration=0.0,
    turn_rate=0.0,
    substep=0.5,
)
FLOWN = earth.turning_flight(TIMES, **FLIGHT)
GYRO = gyro.Gyro(1e-6, 1e-9)
IMU = dict(
    gyro_noise=1e-4,
    accelerometer_noise=1e-3,
    gyro_bias=0.1,
    accelerometer_bias=0.1,
    gyro_walk=0.1,
    accelerometer_walk=0.1,
)
SYSTEM = inertial.strapdown(0.5, 10.0, inertial.Imu(**IMU))
BODY = gyro.Body(np.diag([1.0, 2.0, 2.5]))
PULSARS = pulsar.pulsars(["B0531+21"])
STARS = sightings.star_directions(1.0)
TDB = ephemeris.from_utc("2015-10-17T04:00:00")
RULE = rules.unscented(2)
MOTION, SENSOR = celnav.Motion(0.9 * I2, I2), celnav.Sensor(I2, I2)
PRIOR = celnav.Gaussian(np.zeros(2), I2)
RNGS = [montecarlo.generator(0, 0, run) for run in range(2)]
LAYOUT = views.text(origin="a")
DOUBT = dict(
    motion=MOTION, sensor=SENSOR, prior=PRIOR, times=TIMES, u=np.zeros((4, 1)), phi=0.5, outliers=0.1,
    groups=[trial.Group("all", "m", slice(0, 2))],
)  # fmt: skip
OWN = problem.Problem(**DOUBT)
TRIAL = OWN.trial({"ukf": celnav.ukf(OWN.motion, OWN.sensor)}, RNGS, "ukf")
FLOWN_TRACK = celnav.run(TRIAL.filters["ukf"], TRIAL.prior, TRIAL.epochs("ukf"), keep="cov")


def square(x):
    return x * x


def built(parameters):
    return celnav.ukf(MOTION, celnav.Sensor(I2, sqrt_R=parameters[0] * I2)), PRIOR


def record(**arguments):
    with recording.recording(**arguments):
        pass


CALLS = {
    "rules.unscented": dict(n=3, alpha=1.0, beta=0.0, kappa=0.0),
    "rules.simplex": dict(n=3),
    "rules.cubature": dict(n=3, degree=5),
    "rules.gauss_hermite": dict(n=2, order=3),
    "rules.tensor_product": (lambda rules: MODULES["rules"].tensor_product(RULE, rules), dict(rules=RULE)),
    "rules.from_filterpy": dict(points=RULE),
    "rules.Rule": dict(nodes=[[0.0], [1.0], [-1.0]], wm=[0.0, 0.5, 0.5], wc=[0.0, 0.5, 0.5]),
    "rules.Rule.sigma_points": (RULE.sigma_points, dict(x=np.zeros(2), P=I2)),
    "belief.Gaussian": (
        lambda mean, cov, sqrt_cov: (celnav.Gaussian(mean, cov), celnav.Gaussian(mean, sqrt_cov=sqrt_cov)),
        dict(mean=np.zeros(2), cov=I2, sqrt_cov=I2),
    ),
    "belief.Gaussian.sample": (PRIOR.sample, dict(rng=RNGS[0], size=(3,))),
    "rules.Taylor": dict(step=1e-3),
    "tuning.maximize_likelihood": dict(
        build=built, start=np.ones(1), epochs=celnav.epochs(TIMES, np.ones((5, 2))), domain="positive", factor=10.0, tolerance=1e-3,
        max_iterations=2, engine="numpy",
    ),
    "diagnose.diagnose": dict(residuals=LOG, times=np.arange(60.0), std=np.ones(2), names=["a", "b"], lags=5, level=0.9),
    "report.report": dict(
        track=FLOWN_TRACK, truth=np.zeros((5, 2, 2)), names=["a", "b"], start=1.0, space=spaces.EUCLIDEAN, level=0.9
    ),
    "tuning.likelihood_gradient": dict(
        build=built, parameters=np.ones(1), epochs=celnav.epochs(TIMES, np.ones((5, 2))), engine="numpy"
    ),
    "problem.compare": dict(problems={"own": OWN}, filters={"EKF": lambda p: celnav.ekf(p.motion, p.sensor)}, runs=2, seed=0),
    "montecarlo.generator": dict(seed=1, study=2, run=3),
    "montecarlo.normals": dict(rngs=RNGS),
    "montecarlo.run_count": (montecarlo.run_count, dict(full=10, runs=5, effort=0.5)),
    "problem.Problem": (lambda **arguments: problem.Problem(**arguments).draw(deepcopy(RNGS)), DOUBT),
    "problem.Problem.draw": (OWN.draw, dict(rngs=RNGS)),
    "problem.Problem.trial": (OWN.trial, dict(filters=TRIAL.filters, rngs=RNGS, reference="ukf")),
    "trial.trial_from_arrays": dict(
        groups=OWN.groups, filters=TRIAL.filters, prior=PRIOR, times=TIMES, z=np.zeros((5, 2, 2)), truth=np.zeros((5, 2, 2)),
        u=np.zeros((4, 1)), space=spaces.EUCLIDEAN, reference="ukf",
    ),
    "trial.evaluate_filter": dict(trial=TRIAL, name="ukf", every=2),
    "trial.bound": dict(trial=TRIAL, every=2),
    "simulate.simulate": dict(
        motion=MOTION, sensor=SENSOR, prior=PRIOR, times=TIMES, runs=2, seed=0, u=np.zeros((4, 1)), Phi=0.5 * I2
    ),
    "sparse_grid.smolyak": dict(n=2, level=2, weights=[1, 2], orders=(1, 3, 7)),
    "sparse_grid.point_count": dict(n=2, level=2, weights=[1, 2], orders=(1, 3, 7)),
    "sparse_grid.integrates": dict(powers=[2, 4], level=2, weights=[1, 2], orders=(1, 3, 7)),
    "sparse_grid.index_set": dict(level=2, weights=[1, 2]),
    "attitude.unit": dict(q=Q4),
    "attitude.from_euler": dict(angles=np.zeros(3)),
    "attitude.attitude": dict(a=1.0, b=4.0),
    "spaces.angles": dict(components=[0]),
    "spaces.product": (lambda factors: spaces.product(factors), dict(factors=(spaces.EUCLIDEAN, 2, 2))),
    "metrics.rmse": dict(error=np.ones((2, 3, 2)), axis=1),
    "metrics.rms": dict(squares=np.ones(3)),
    "metrics.ratio": dict(a=np.ones(3), b=np.ones(3)),
    "metrics.rmse_interval": dict(error=np.ones((2, 3, 2)), level=0.9, axis=1),
    "metrics.chi_square_band": dict(dof=2, runs=10, level=0.9),
    "metrics.bootstrap": (
        lambda statistic, samples, **more: metrics.bootstrap(statistic, samples, **more),
        dict(statistic=np.mean, samples=np.ones(3), block=1, level=0.9, resamples=10, seed=0),
    ),
    "observability.jacobian": dict(function=square, x=np.ones(2)),
    "observability.lie_gradients": dict(f=square, h=square, x=np.ones(2), order=1, window=0.1),
    "observability.information_degree": dict(P0=I2, F=np.stack([I2]), H=np.stack([I2, I2]), R=I2),
    "observability.nonlinearity_degree": dict(function=square, mean=np.ones(2), std=np.ones(2), scale=np.ones(2)),
    "observability.observability_matrix": dict(A=I2, H=I2, order=1),
    "observability.state_singular_values": dict(matrix=I2, cov=I2),
    "observability.hysteresis": dict(degree=np.ones(2), threshold=5.0, before=np.ones(2), band=1.1),
    "observability.threshold_weights": dict(degree=[1.0, 9.0], threshold=5.0),
    "observability.nonlinearity_weights": dict(functions=[square], mean=np.ones(2), std=np.ones(2), tolerance=1e-6, coarse=2),
    "bounds.riccati": dict(F=np.stack([I2]), H=I2, Q=I2, R=I2, P0=I2),
    "bounds.actual_covariance": dict(
        F=np.stack([I2]), H=I2, gains=np.stack([0.5 * I2]), Q=I2, Phi=0.5 * I2, R=I2, P0=I2, Sigma0=I2
    ),
    "bounds.colored_bound": dict(F=np.stack([I2]), H=I2, Phi=0.5 * I2, Q=I2, R=I2, P0=I2, Sigma0=I2),
    "recording.rgba": dict(color="#112233", alpha=0.5),
    "recording.ellipsoid_axes": dict(covariance=I3, sigmas=3.0),
    "recording.recording": (record, dict(path="@", times=TIMES, name="a", layout=LAYOUT, properties={}, counter="k")),
    "recording.Recorder.text": dict(entity="a", markdown="text"),
    "recording.Recorder.curve": dict(entity="a", values=TIMES, color="#112233", name="a", width=1.0),
    "recording.Recorder.curves": dict(
        entity="a", values=np.ones((5, 2)), color="#112233", names=["a", "b"], widths=[1.0] * 2, shown=[True] * 2
    ),
    "recording.Recorder.states": dict(entity="a", names=["used"] * 5, colors={"used": "#112233"}),
    "recording.Recorder.bounds": dict(entity="a", sigma=TIMES, name="a", center=0.0, color="#112233"),
    "recording.Recorder.level": dict(entity="a", value=1.0, name="a", color="#112233"),
    "recording.Recorder.trail": dict(entity="a", points=np.ones((5, 3)), color="#112233", radius=1.0),
    "recording.Recorder.path": dict(entity="a", strips=[np.ones((2, 3))], color="#112233", radius=1.0),
    "recording.Recorder.strips": dict(entity="a", strips=np.ones((5, 1, 2, 3)), colors=["#112233"], labels=["a"], radius=1.0),
    "recording.Recorder.arrow": dict(entity="a", origins=np.ones((5, 3)), vectors=np.ones((5, 3)), color="#112233", label="a"),
    "recording.Recorder.pose": dict(entity="a", origins=np.ones((5, 3)), quaternions=np.tile(Q4, (5, 1))),
    "recording.Recorder.axes": dict(entity="a", length=1.0, colors=["#112233"] * 3, labels=["x", "y", "z"], radius=1.0),
    "recording.Recorder.points": dict(entity="a", points=np.ones((5, 3)), color="#112233", alpha=1.0, radius=1.0, label="a"),
    "recording.Recorder.ellipsoids": dict(
        entity="a", centers=np.ones((5, 3)), covariance=np.tile(I3, (5, 1, 1)), color="#112233", sigmas=3.0, alpha=0.5
    ),
    "recording.Recorder.globe": dict(entity="a", radius=1.0),
    "recording.Recorder.bars": dict(entity="a", values=TIMES, color="#112233"),
    "recording.Recorder.exact": dict(entity="a", a=TIMES),
    "views.space": dict(origin="a", name="a", eye=[1.0, 0.0, 0.0], target=[0.0, 0.0, 0.0], up=[0.0, 0.0, 1.0], growing={"a": 1.0}),
    "views.states": dict(origin="a", name="a"),
    "views.plot": dict(origin="a", name="a", limits=(0.0, 1.0), legend="LeftTop"),
    "draw.figure": dict(width=3.0, height=2.0, rows=1, columns=2),
    "constellation.geostationary": dict(number=1, elapsed_s=60.0),
    "constellation.synthetic": dict(toe=345600.0),
    "ephemeris.Kernel": dict(path=str(ephemeris.de421().path)),
    "ephemeris.Kernel.state": (ephemeris.de421().state, dict(body="sun", date=TDB)),
    "gyro.Gyro": dict(sigma_v=1e-6, sigma_u=1e-9, tau=100.0),
    "motion.constant_velocity": dict(dim=2, q=0.1),
    "motion.constant_acceleration": dict(dim=2, q=0.1),
    "motion.known_turn": dict(rate=0.1, q=0.1),
    "motion.coordinated_turn": dict(q=0.1, q_rate=1e-3),
    "gyro.Gyro.measure": (GYRO.measure, dict(q=np.tile(Q4, (3, 1)), drift=np.zeros((2, 3)), noise=np.zeros((2, 3)), dt=1.0)),
    "gyro.preintegrate": dict(measured=np.zeros((2, 3)), drift=np.zeros(3), dt=1.0),
    "inertial.Imu": IMU,
    "inertial.level": dict(force=np.array([0.1, 0.2, -9.8])),
    "inertial.standing": dict(
        t=TIMES, rate=np.ones((5, 3)), force=np.ones((5, 3)), window_s=2.0, most_rate=2.0, rate_spread=0.1, force_spread=0.1
    ),
    "inertial.strapdown": dict(latitude=0.5, height_m=10.0, imu=SYSTEM.imu, states=("lag",), error="body"),
    "inertial.Strapdown.prior": (
        SYSTEM.prior,
        dict(
            level=np.array([0.1, 0.2]), heading=0.3, sigma_level=0.1, sigma_heading=0.2, velocity=np.ones(3), position=np.ones(3),
            sigma_velocity=0.1, sigma_position=0.1,
        ),
    ),
    "inertial.Strapdown.gnss": (SYSTEM.gnss, dict(lever=np.ones(3), sigma_position=np.ones(3), sigma_velocity=np.ones(3))),
    "inertial.Strapdown.standstill": (SYSTEM.standstill, dict(sigma_velocity=np.ones(3), sigma_rate=np.ones(3))),
    "inertial.Strapdown.sideways": (SYSTEM.sideways, dict(sigma=np.ones(2), lever=np.ones(3))),
    "inertial.Strapdown.wheel_speed": (SYSTEM.wheel_speed, dict(sigma=0.1, lever=np.ones(3))),
    "noise.allan_deviation": dict(t=TIMES, samples=np.ones((5, 2)), interval_s=1.0),
    "earth.north_east_down": dict(latitude=0.5, longitude=0.1),
    "earth.local_position": dict(
        latitude=np.array([0.5, 0.51]), longitude=np.array([0.1, 0.2]), height_m=np.array([1.0, 2.0]), origin=(0.5, 0.1, 1.0)
    ),
    "gyro.steady_state": dict(sigma_n=1e-5, gyro=GYRO, interval=1.0),
    "misalignment.navigation": dict(flight=FLOWN, at=[1], phi=np.zeros(3), bias=np.zeros(3)),
    "misalignment.wahba_misalignment": dict(z=np.zeros(6), attitude=I3, stars=STARS),
    "misalignment.mechanize": dict(flight=FLOWN, attitude=I3, drift=np.zeros(3), bias=np.zeros(3)),
    "noise.stationary_covariance": dict(Phi=0.5 * I2, R=I2),
    "noise.effective_covariance": dict(Phi=0.5 * I2, R=I2),
    "noise.ar1": dict(Phi=0.5 * I2, increments=np.ones((3, 2)), first=np.ones(2)),
    "noise.van_loan": dict(F=I2, G=I2, spectral_density=I2, dt=1.0),
    "noise.ar1_noise": dict(F=0.5 * I2, L=0.5 * I2, J=0.1 * I2, Xi=I2, E=I2),
    "orbit.Earth": dict(mu=398600.4418, radius_km=6378.137, j2=1e-3),
    "orbit.check_orbit": dict(state=X6, earth=orbit.EARTH),
    "orbit.propagate": dict(state=X6, dt=1.0, steps=2, earth=orbit.EARTH),
    "orbit.from_elements": dict(a=7000.0, e=0.1, i=0.1, raan=0.1, argp=0.1, true_anomaly=0.1, earth=orbit.EARTH),
    "orbit.to_elements": dict(state=X6, earth=orbit.EARTH),
    "pulsar.Pulsar": dict(
        name="a", right_ascension_deg=1.0, declination_deg=1.0, distance_kpc=1.0, period_s=1.0, width_s=1.0, flux=1.0,
        pulsed_fraction=0.5,
    ),
    "pulsar.Pulsar.timing_std": (PULSARS[0].timing_std, dict(seconds=1.0, area_cm2=1.0, background=0.1)),
    "pulsar.pulsars": dict(names=["B0531+21"]),
    "pulsar.Timing": dict(pulsars=PULSARS),
    "gyro.Body": dict(inertia=BODY.inertia, wheels=np.zeros(3), torque=np.zeros(3), orbit_rate=0.0),
    "gyro.Body.propagate": (BODY.propagate, dict(x=np.r_[Q4, 0.0, 0.0, 0.0], dt=1.0, steps=2)),
    "sightings.star_directions": dict(separation=1.0),
    "sightings.position": dict(A=np.array([1.2, 1.2, 2.0]), separation=1.0, hemisphere=1.0, radius_km=6378.0),
    "sightings.jacobian": dict(A=np.array([1.2, 1.2, 2.0]), separation=1.0, hemisphere=1.0, radius_km=6378.0),
    "sightings.pseudo_position_covariance": dict(position_km=np.array([4e3, 3e3, 5e3]), separation=1.0, sigma=np.full(3, 1e-4)),
    "earth.orientation": dict(tt=[2454679.5, 0.1], ut1=[2454679.5, 0.1], pole=[1e-6, 2e-6]),
    "earth.spin": dict(orientations=np.stack([I3, I3]), interval=1.0),
    "gravity.Gravity": dict(gm=1.0, radius=1.0, C=np.eye(2), S=np.zeros((2, 2))),
    "gravity.Gravity.truncated": (gravity.Gravity(1.0, 1.0, I2, I2).truncated, dict(degree=1)),
    "gravity.read": dict(path="@field", degree=1),
    "ephemeris.Tdb.after": (TDB.after, dict(seconds=1.0)),
    "ephemeris.Tdb.since": (TDB.since, dict(other=TDB)),
    "ephemeris.from_tt": dict(day=2457300.5, rest=0.1),
    "ephemeris.from_utc": dict(instant="2015-10-17"),
    "earth.turning_flight": dict(times=TIMES, **FLIGHT),
}  # fmt: skip

GAPS = """curves.values curve.values bounds.sigma bounds.center trail.points strips.strips arrow.origins arrow.vectors
pose.origins pose.quaternions points.points ellipsoids.centers ellipsoids.covariance exact.a"""
MEANT = {
    "simulate.simulate times": "dates",
    "trial.trial_from_arrays times": "dates",
    "attitude.from_euler angles": "nan, infinite",
    "belief.Gaussian mean": "deep",
    "belief.Gaussian.sample size": "empty",
    "observability.state_singular_values matrix": "deep",
    "observability.observability_matrix A": "deep",
    "observability.observability_matrix H": "deep",
    "observability.observability_matrix order": "a billion",
    "observability.hysteresis degree": "deep",
    "observability.hysteresis before": "deep",
    "observability.jacobian x": "deep",
    "observability.nonlinearity_degree mean": "deep",
    "problem.compare runs": "a billion",
    "problem.compare seed": "a billion",
    "montecarlo.generator seed": "a billion",
    "montecarlo.generator study": "a billion",
    "montecarlo.generator run": "a billion",
    "montecarlo.run_count full": "a billion",
    "montecarlo.run_count runs": "a billion, None",
    "problem.Problem groups": "empty",
    "problem.Problem u": "nan, infinite, complex",
    "trial.trial_from_arrays groups": "empty",
    "trial.trial_from_arrays z": "None, nan",
    "trial.trial_from_arrays u": "nan, infinite, complex",
    "simulate.simulate seed": "a billion",
    "simulate.simulate Phi": "a function",
    "simulate.simulate u": "nan, infinite, complex",
    "trial.bound every": "a billion",
    "trial.evaluate_filter every": "a billion",
    "tuning.maximize_likelihood max_iterations": "a billion",
    "attitude.unit q": "nan",
    "gyro.Gyro tau": "infinite",
    "gyro.Gyro.measure q": "nan",
    "misalignment.navigation at": "empty",
    "inertial.strapdown states": "empty",
    "inertial.Strapdown.prior heading": "empty, several",
    **dict.fromkeys(
        (f"earth.local_position {name}" for name in ("latitude", "longitude", "height_m")), "empty"
    ),
    "metrics.bootstrap seed": "a billion",
    "report.report truth": "nan",
    "motion.constant_velocity q": "several",
    "motion.constant_acceleration q": "several",
    "metrics.chi_square_band dof": "a billion, a half",
    "metrics.chi_square_band runs": "a billion, a half",
    **dict.fromkeys(
        ("metrics.rms squares", "metrics.ratio a", "metrics.ratio b"), "nan, infinite, deep"
    ),
    **dict.fromkeys(
        ("metrics.rmse error", "metrics.rmse_interval error", "metrics.bootstrap samples"),
        "nan, infinite, deep",
    ),
    **dict.fromkeys(
        ("orbit.Earth mu", "orbit.Earth radius_km", "orbit.Earth j2"), "several, empty"
    ),
    "observability.nonlinearity_weights coarse": "a billion",
    "pulsar.pulsars names": "empty, array",
    "recording.Recorder.axes labels": "empty",
    "recording.Recorder.strips labels": "empty",
    "recording.Recorder.bars values": "empty, nan, infinite",
    "recording.Recorder.path strips": "empty, nan, infinite",
    "recording.Recorder.level value": "empty, several",
    **{f"recording.Recorder.{place.replace('.', ' ')}": "nan, infinite" for place in GAPS.split()},
    "sightings.jacobian A": "nan",
    "sightings.position A": "nan",
    "spaces.angles components": "empty",
    "ephemeris.Tdb.after seconds": "empty, several, nan, infinite",
    "ephemeris.from_tt day": "empty, several",
    "ephemeris.from_tt rest": "empty, several",
}
"""Values in the lists below that are valid: nan for unknown values, an empty
batch, a large limit.
"""
NUMBERS = {
    "None": None, "text": "x", "no text": "", "digits": "1", "empty": [], "complex": 1j, "nan": np.nan, "infinite": np.inf,
    "table": {}, "several": [1.0, 2.0], "a date": datetime(2026, 1, 1, tzinfo=UTC), "an object": object(), "a function": square,
}  # fmt: skip
ARRAYS = {
    "None": None, "text": "x", "texts": ["x", "y"], "empty": [], "table": {}, "ragged": [[1.0], [2.0, 3.0]], "an object": object(),
    "dates": np.array(["2026-01-01"], "datetime64[s]"), "deep": np.ones((2, 3, 5, 7)), "a function": square,
}  # fmt: skip
FUNCTIONS = {
    "None": None,
    "text": "x",
    "number": 1.0,
    "array": np.ones(2),
    "returns nothing": lambda *_: None,
    "returns text": lambda *_: "x",
}
OBJECTS = {
    "None": None,
    "text": "x",
    "number": 1.5,
    "array": np.ones(2),
    "empty": [],
    "a function": square,
    "an object": object(),
}
WORDS = {
    "None": None,
    "number": 1.5,
    "array": np.ones(2),
    "empty": [],
    "an object": object(),
    "a function": square,
}
MANY = {"a billion": 10**9, "negative": -(10**9), "a half": 1.5}


def numeric(value):
    """Whether a value is an array, or a list of numbers or arrays."""
    return (
        type(value) in (np.ndarray, list, tuple)
        and len(value)
        and isinstance(value[0], int | float | list | np.ndarray)
    )


def wrong(value):
    """Wrong values in place of a value of this kind."""
    if isinstance(value, str):
        return WORDS
    if callable(value) and not isinstance(value, rules.Rule):
        return FUNCTIONS
    if isinstance(value, int) and not isinstance(value, bool):
        return NUMBERS | MANY
    if isinstance(value, float):
        return NUMBERS
    if numeric(value):
        array = np.asarray(value, float)
        return ARRAYS | {
            "complex": array + 1j,
            "nan": np.full(array.shape, np.nan),
            "infinite": np.full(array.shape, np.inf),
        }
    return OBJECTS


def resolve(name, tmp_path):
    """The function with this name, and a valid call."""
    given = CALLS[name]
    call, arguments = given if isinstance(given, tuple) else (None, given)
    if name.startswith("recording.Recorder."):
        stream = rr.RecordingStream("a test")
        stream.memory_recording()
        call = getattr(recording.Recorder(stream, TIMES), name.rpartition(".")[2])
    module, *path = name.split(".")
    found = MODULES[module]
    for part in path:
        found = getattr(found, part)
    if "path" in arguments and arguments["path"] == "@":
        arguments = arguments | {"path": str(tmp_path / "a.rrd")}
    if "path" in arguments and arguments["path"] == "@field":
        (tmp_path / "a.gfc").write_text(
            "earth_gravity_constant 1\nradius 1\nend_of_head\ngfc 0 0 1 0\ngfc 1 0 0 0\n"
        )
        arguments = arguments | {"path": str(tmp_path / "a.gfc")}
    return call or found, found, arguments


def judge(call, arguments, name, value):
    """None if a wrong value raises an error with the argument's name, else the outcome."""
    try:
        call(**arguments | {name: value})
    except (ValueError, TypeError, OSError, KeyError) as error:
        named = re.search(rf"(?<![\w']){name}\b(, \w+)*: ", str(error))
        return None if named else f"{type(error).__name__}: {error!s:.100}"
    except Exception as error:
        return f"{type(error).__name__}: {error!s:.100}"
    return "accepted"


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.filterwarnings("ignore")
def test_what_cannot_be_meant_is_refused_by_name(name, tmp_path):
    call, function, arguments = resolve(name, tmp_path)
    call(**arguments)
    defaults = {k: p.default for k, p in inspect.signature(function).parameters.items()}
    found = {}
    for argument, value in arguments.items():
        for label, other in wrong(value).items():
            if (other is None and defaults.get(argument, 0) is None) or label in MEANT.get(
                f"{name} {argument}", ""
            ).split(", "):
                continue
            said = judge(call, arguments, argument, other)
            if said is not None:
                found[f"{argument} {label}"] = said
    assert not found


def other_forms(value):
    """The same value in other forms: other number types, lists, read-only or
    non-contiguous memory.
    """
    if isinstance(value, int | float):
        yield from (np.float64(value), np.array(value), float(value))
        if value == int(value):
            yield from (int(value), np.int64(value), np.array(int(value)))
    elif numeric(value):
        array = np.asarray(value)
        sparse = np.repeat(array, 2, 0)[::2]
        frozen = array.copy()
        frozen.flags.writeable = False
        yield from (
            array,
            array.tolist(),
            sparse,
            frozen,
            np.asfortranarray(array),
            np.ma.array(array),
        )


def lively(call, arguments, name):
    """Valid arguments in which the numbers of an array differ from each other if possible: a
    transposed matrix or a wrong stride then changes the result.
    """
    value = arguments[name]
    if numeric(value) and np.ndim(value):
        array = np.array(value, float)
        tilt = 1.0 + 0.01 * np.sin(1.0 + np.arange(array.size).reshape(array.shape))
        even = (
            tilt + np.swapaxes(tilt, -1, -2)
            if array.ndim > 1 and len({*array.shape[-2:]}) == 1
            else 2.0
        )
        for other in ((array + 0.1) * tilt, array + 0.01 * even, array * tilt):
            try:
                call(**copied(arguments | {name: other}))
            except (ValueError, np.linalg.LinAlgError):
                continue
            return arguments | {name: other}
    return arguments


def copied(arguments):
    """Copies of arguments, with copies of random generators in the same state."""
    return {
        key: deepcopy(value) if key in ("rng", "rngs") else value
        for key, value in arguments.items()
    }


def numbers_in(result, seen=()):
    """Every array, number and word in a result: in containers, records and functions."""
    if isinstance(result, np.ndarray | int | float | complex | np.generic):
        yield np.asarray(result)
    elif isinstance(result, str | bytes | type | None):
        yield result
    elif id(result) in seen:
        return
    elif isinstance(result, np.random.Generator):
        yield deepcopy(result).random(3)
    else:
        seen = (*seen, id(result))
        if isinstance(result, Figure):
            parts = [*result.get_size_inches(), len(result.axes)]
        elif hasattr(result, "as_component_batches"):
            parts = [one.as_arrow_array().to_pylist() for one in result.as_component_batches()]
        elif isinstance(result, Mapping):
            parts = [part for item in result.items() for part in item]
        elif isinstance(result, list | tuple | set):
            parts = list(result)
        elif isinstance(result, partial):
            parts = [result.args, result.keywords]
        elif callable(result) and hasattr(result, "__code__"):
            parts = [cell.cell_contents for cell in result.__closure__ or ()]
        else:
            parts = list(getattr(result, "__dict__", {}).values())
        for part in parts:
            yield from numbers_in(part, seen)


def assert_same_numbers(found, expected, what):
    """Equal up to the order of summation, which may depend on the memory layout."""
    found, expected = list(numbers_in(found)), list(numbers_in(expected))
    assert len(found) == len(expected), what
    for mine, plain in zip(found, expected, strict=True):
        if isinstance(plain, np.ndarray) and plain.dtype.kind in "fiucb":
            np.testing.assert_allclose(
                mine, plain, rtol=1e-11, atol=1e-13, err_msg=what, strict=False
            )
            assert mine.shape == plain.shape, what
        elif isinstance(plain, np.ndarray):
            assert (mine.dtype, mine.shape) == (plain.dtype, plain.shape), what
        else:
            assert mine == plain, what


LOGGED = []


class Listening(rr.RecordingStream):
    """A stream that stores what is logged."""

    def log(self, entity, *parts, **_options):
        LOGGED.append((entity, parts))

    def send_columns(self, entity, _times, columns, **_options):
        LOGGED.append((entity, [column.as_arrow_array().to_pylist() for column in columns]))


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.filterwarnings("ignore")
def test_what_may_be_meant_gives_the_same_numbers(name, tmp_path, monkeypatch):
    """Other number types, lists, arrays with any memory layout, and masked arrays with nothing
    masked.
    """
    monkeypatch.setattr(problem, "process_time", lambda: 0.0)
    monkeypatch.setattr(rr, "RecordingStream", Listening)
    call, _, arguments = resolve(name, tmp_path)

    def result(arguments):
        LOGGED.clear()
        return call(**copied(arguments)), tuple(LOGGED)

    compared = 0
    for argument in arguments:
        some = lively(call, arguments, argument)
        for other in other_forms(some[argument]):
            if argument == "u" and type(other) is list:  # a model gets each item as it is
                continue
            plain, found = result(some), result(some | {argument: other})
            assert_same_numbers(found, plain, f"{argument}={other!r}")
            compared += len(list(numbers_in(plain)))
    silent = name in (
        "recording.recording",
        "rules.tensor_product",
        "pulsar.pulsars",
        "pulsar.Timing",
    )
    assert compared or silent or not any(True for x in arguments.values() for _ in other_forms(x))


@pytest.mark.parametrize("name", ["gyro.Body", "gravity.Gravity", "rules.Rule", "pulsar.Timing"])
def test_records_of_arrays_are_compared_by_identity(name, tmp_path):
    """An array has no single truth value, so two records are two keys of a dictionary."""
    call, _, arguments = resolve(name, tmp_path)
    one, other = call(**arguments), call(**arguments)
    assert one == one
    assert one != other
    assert {one: 1, other: 2}[one] == 1


def test_what_only_looks_wrong_is_accepted():
    """Values for each run, shapes that broadcast, lazy sequences, missing values."""
    each = orbit.Earth(mu=np.array([398600.0, 398601.0]))
    assert orbit.propagate(np.tile(X6, (2, 1)), -1.0, 2, each).shape == (3, 2, 6)
    assert orbit.propagate(np.zeros((0, 6)), 1.0, 2).shape == (3, 0, 6)
    assert spaces.angles(i for i in (0, 2)).minus(np.full(3, 7.0), np.zeros(3))[1] == 7.0
    assert spaces.product((spaces.EUCLIDEAN, 2.0, 2.0)).plus(np.ones(2), np.ones(2)).tolist() == [
        2.0,
        2.0,
    ]
    assert metrics.rmse(np.ones((0, 3, 2))).shape == (0, 2)
    assert np.isnan(metrics.rmse([[[1.0], [np.nan]]])).all()
    assert metrics.chi_square_band(2, 2.5)[0] > 0.0
    assert bounds.riccati([I2], I2, 0.0 * I2, I2, np.stack([I2, 0.0 * I2])).gains.shape == (
        1,
        2,
        2,
        2,
    )
    assert noise.ar1(np.stack([I2, 0.5 * I2]), np.zeros((3, 1, 2)), np.ones(2)).shape == (4, 2, 2)
    assert GYRO.measure(np.tile(Q4, (3, 2, 1)), np.zeros(3), np.zeros((2, 2, 3)), 1.0).shape == (
        2,
        2,
        3,
    )
    assert observability.jacobian(lambda x: np.ones((len(x), 1), int), [1.0, 2.0]).tolist() == [
        [0.0, 0.0]
    ]
    assert BODY.propagate(np.r_[Q4, 0.0, 0.0, 0.1], -1.0, 1).shape == (2, 7)
    assert views.plot("a", "a", limits=[0, 1]) is not None


def public():
    """Names of all public functions, classes that users create, and methods of the modules."""
    for short, module in MODULES.items():
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", "") != module.__name__:
                continue
            if inspect.isfunction(thing) or hasattr(thing, "__wrapped__"):
                yield f"{short}.{name}"
            elif (
                inspect.isclass(thing)
                and not getattr(thing, "_is_protocol", False)
                and not issubclass(thing, Warning)
            ):
                if (
                    name != "Recorder"
                    and ("__init__" in vars(thing))
                    and not issubclass(thing, tuple)
                ):
                    yield f"{short}.{name}"
                yield from (
                    f"{short}.{name}.{m}"
                    for m, f in vars(thing).items()
                    if not m.startswith("_") and inspect.isfunction(f)
                )


def listed(text):
    modules = re.findall(r"(\w+):((?:\s+[\w.]+(?!:)\b)+)", text)
    return {f"{module}.{name}" for module, names in modules for name in names.split()}


def test_every_public_function_is_here():
    assert set(public()) == set(CALLS) | listed(HOT) | listed(INSIDE)
