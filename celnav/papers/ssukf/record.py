"""The recording: the first run, satellite and sensors as they turn, the errors as if under a microscope, plots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.analysis.metrics import chi_square_band
from celnav.gaussian import attitude
from celnav.gaussian.linalg import Array
from celnav.papers.ssukf.config import ARCSEC, UNITS
from celnav.papers.ssukf.errata import RADIUS_M
from celnav.papers.ssukf.evidence import AXES
from celnav.papers.ssukf.figures import COLORS, LABELS
from celnav.papers.ssukf.study import Result
from celnav.show import colors

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.show.recording import Recorder

RECORDINGS = ["ssukf.rrd"]
SHOWN = ("aukf", "ssukf", "mekf")
EARTH_KM, ORBIT_KM = 6378.0, RADIUS_M / 1e3
ARM_KM = 1500.0
"""Length of the drawn axes."""
EXAGGERATION = 1000.0
"""By how much errors are exaggerated in the view of the body."""


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recording among ``outputs``; returns its name. Needs rerun."""
    from celnav.show import recording

    times = result.times
    facts = {"paper": "ssukf", "seed": result.seed, "runs": result.runs, "exaggeration": EXAGGERATION}
    with outputs.path_for(RECORDINGS[0]) as path:
        layout = _layout(times)
        with recording.recording(path, times, name="ssukf", layout=layout, properties=facts, counter="star_epoch") as out:
            out.text("info", _notes(result))
            _world(out, result)
            _errors(out, result)
            _plots(out, result)
            for filter in SHOWN:
                data = result.data["paper"]
                out.exact(f"state/{filter}", mean=data[f"{filter}/mean"][:, 0], covariance=data[f"{filter}/cov"][:, 0])
    return RECORDINGS


def _layout(times: Array) -> Any:
    from celnav.show import views

    scene = views.space("world", "orbit, km (inertial axes)", eye=(11e3, -9e3, -15e3), target=(1e3, 0.0, -2e3), up=(0.0, -1.0, 0.0))
    body = views.space("body", "axes: truth, and estimates with errors x1000", eye=(3.0, -2.0, 2.0), up=(0.0, 0.0, -1.0))
    errors = views.space("error_view", "attitude error (arcsec) with 3σ ellipsoid, truth in the middle", eye=(22.0, -22.0, 16.0))
    plots = views.rows(
        views.tabs(*(views.plot(f"err/{a}", f"{a} error, arcsec", times, limits=(-12.0, 12.0)) for a in AXES)),
        views.tabs(*(views.plot(f"drift/{a}", f"drift {a}, deg/h", times) for a in "xyz")),
        views.tabs(views.plot("nees", "log10 NEES", times), views.plot("nis", "NIS", times, limits=(0.0, 16.0))),
        views.plot("diff", "log10 of the difference of SSUKF and AUKF, arcsec", times),
        views.plot("cost", "points evaluated at 100 Hz, thousands", times),
    )
    below = views.tabs(views.text("info", "about"), body)
    return views.columns(views.rows(scene, views.columns(errors, below), shares=(5, 4)), plots, shares=(6, 5))


def _notes(result: Result) -> str:
    c, counted = result.config, result.facts["evaluations"]
    one, many = (1.0 - sum(counted[per]["ssukf"]) / sum(counted[per]["aukf"]) for per in (1, c.ratio))
    return f"""# Wu et al. (2012): state-switching UKF for attitude

* **Equal accuracy of SSUKF and AUKF: true, and an identity.** At equal spread they are one filter to round-off.
* **A third less time: counted in points {one:.0%} at 1:1, {many:.0%} at the paper's {c.ratio}:1.** In arrays one run
  gains hardly anything.
* **Faster convergence: not so.** In filter time both converge alike, to the sample.

A satellite turns freely at 800 km. Gyros and a star sensor give attitude (left above: axes red, green, blue are roll, pitch, yaw;
white: the two sight lines of the star sensor; blue: nadir). The first star sample takes an error of
{max(c.attitude_deg):g} deg to {c.star_arcsec:g} arcsec, so everything after it
is shown under a microscope: errors in arcsec with their 3σ ellipsoids, or exaggerated
{EXAGGERATION:g} times. Blue: AUKF. Orange: SSUKF. Purple: MEKF.

| | |
|---|---|
| gyro | {c.gyro_hz:g} Hz, {c.gyro_deg_per_h:g} deg/h white, {c.drift_deg_per_h:g} deg/h drift, tau {c.tau_s:g} s |
| star sensor | {c.star_hz:g} Hz, {c.star_arcsec:g} arcsec on each axis |
| initial error | {", ".join(f"{v:g}" for v in c.attitude_deg)} deg, drift {", ".join(f"{v:g}" for v in c.bias_deg_per_h)} deg/h |
| alpha, kappa, beta | {c.alpha:g}, {c.kappa:g}, {c.beta:g} |
| runs, seed | {result.runs}, {result.seed} |
"""


def _world(out: Recorder, result: Result) -> None:
    rate, t = result.config.orbit_rate_rad_per_s, result.times
    at = rate * t[:, None]
    nadir = np.concatenate([-np.sin(at), np.zeros_like(at), np.cos(at)], -1)
    around = np.linspace(0.0, 2.0 * np.pi, 181)
    out.globe("world/earth", EARTH_KM)
    circle = ORBIT_KM * np.stack([np.sin(around), np.zeros_like(around), -np.cos(around)], -1)
    out.path("world/orbit", [circle], colors.FAINT)
    truth = result.data["paper"]["truth"][:, 0, :4]
    place = -ORBIT_KM * nadir
    out.pose("world/sat", place, truth)
    shades = ("#E63946", "#2A9D8F", "#457B9D")
    out.axes("world/sat/body", ARM_KM, shades, AXES)
    for k, direction in enumerate(np.array([[0.0, 1.0, -1.0], [0.0, -1.0, -1.0]]) / np.sqrt(2.0), start=1):
        line = np.stack([np.zeros(3), 2.0 * ARM_KM * direction])
        out.path(f"world/sat/boresight_{k}", [line], "#FFFFFF", radius=1.0)
    out.arrow("world/nadir", place, 0.6 * ARM_KM * nadir, colors.MEASUREMENT, "nadir")
    origin = np.zeros((len(t), 3))
    out.axes("body/truth", 1.0, ["#FFFFFF"] * 3, AXES, radius=1.0)
    for filter in ("aukf", "ssukf"):
        mean = result.data["paper"][f"{filter}/mean"][:, 0, :4]
        error = attitude.log(attitude.multiply(mean, attitude.inverse(truth)))
        # In the frame of the truth; what would turn by more than a right angle is not shown.
        turned = EXAGGERATION * error
        small = np.linalg.norm(turned, axis=1, keepdims=True) < 0.5 * np.pi
        out.pose(f"body/est_{filter}", origin, attitude.exp(np.where(small, turned, 0.0)))
        out.axes(f"body/est_{filter}", 0.9, [COLORS[filter]] * 3)
        out.pose(f"world/sat/est_{filter}", origin, attitude.exp(error))
        out.axes(f"world/sat/est_{filter}", 0.8 * ARM_KM, [COLORS[filter]] * 3, radius=0.7)


def _errors(out: Recorder, result: Result) -> None:
    origin = np.zeros((len(result.times), 3))
    out.path("error_view/axes", [np.array([[0.0, 0.0, 0.0], row]) for row in 10.0 * np.eye(3)], colors.FAINT)
    out.points("error_view/truth", origin, colors.TRUTH, radius=5.0)
    for filter in SHOWN:
        data = result.data["paper"]
        error = data[f"{filter}/error"][:, 0, :3]
        near = (np.abs(error) < 60.0).all(1, keepdims=True)
        shown = np.where(near, error, np.nan)
        covariance = data[f"{filter}/cov"][:, 0, :3, :3] / ARCSEC**2
        out.ellipsoids(f"error_view/ellipsoid_{filter}", shown, covariance, COLORS[filter], alpha=0.2)
        out.points(f"error_view/estimate_{filter}", shown, COLORS[filter], radius=3.5)
        out.arrow(f"error_view/error_{filter}", origin, shown, COLORS[filter], "", radius=0.8)


def _plots(out: Recorder, result: Result) -> None:
    data = result.data["paper"]
    truth = data["truth"][:, 0, 4:] / UNITS[3:]
    for i, (axis, letter) in enumerate(zip(AXES, "xyz", strict=True)):
        out.curve(f"drift/{letter}/true", truth[:, i], colors.TRUTH, "truth")
        for filter in SHOWN:
            std = data[f"{filter}/std"][:, 0]
            out.curve(f"err/{axis}/{filter}", data[f"{filter}/euler"][:, 0, i], COLORS[filter], LABELS[filter])
            out.bounds(f"err/{axis}/{filter}", std[:, i], LABELS[filter], shown=filter == "ssukf", color=COLORS[filter])
            estimate = data[f"{filter}/mean"][:, 0, 4 + i] / UNITS[3]
            out.curve(f"drift/{letter}/{filter}/est", estimate, COLORS[filter], LABELS[filter])
            out.bounds(
                f"drift/{letter}/{filter}",
                std[:, 3 + i],
                LABELS[filter],
                center=estimate,
                shown=filter == "ssukf",
                color=COLORS[filter],
            )
    for filter in SHOWN:
        out.log_curve(f"nees/{filter}", data[f"{filter}/nees"][:, 0], COLORS[filter], LABELS[filter])
        out.curve(
            f"nis/{filter}", np.where(result.times > 0.0, data[f"{filter}/nis"][:, 0], np.nan), COLORS[filter], LABELS[filter]
        )
    for name, low_high in (("nees", np.log10(chi_square_band(6, 1))), ("nis", chi_square_band(3, 1))):
        for side, level in zip(("low", "high"), low_high, strict=True):
            out.level(f"{name}/{side}", float(level), "95 % band")
    apart = np.abs(data["ssukf/error"] - data["aukf/error"])[:, 0, :3].max(1)
    out.log_curve("diff/ssukf_minus_aukf", apart, colors.ESTIMATE, "SSUKF - AUKF")
    counted = result.facts["evaluations"][result.config.ratio]
    for filter in ("aukf", "ssukf", "mekf"):
        points = sum(counted[filter]) * np.arange(len(result.times)) / 1e3
        out.curve(f"cost/points_cumulative/{filter}", points, COLORS[filter], LABELS[filter])
