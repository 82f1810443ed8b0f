"""[Wu2012] shown: figures and Table 1 as the paper numbers them, those beyond it, the recording."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.gaussian import attitude
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import wrap
from celnav.papers.ssukf import study
from celnav.papers.ssukf.scenario import ARCSEC, RADIUS_KM, STANDARD, path
from celnav.papers.ssukf.study import ALPHAS, AXES, FIELD, FIELD_DEG, LARGE, PRIORS_DEG, TIMED, TURNS_DEG, UNITS, readings, saved
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Group, first_run
from celnav.show.figures import Line, consistency, figure
from celnav.show.plots import Curve, Plot
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

LINES = {
    "aukf": Line("AUKF", colors.COMPARISON, width=1.2), "ssukf": Line("SSUKF", colors.ESTIMATE, "--", 1.8),
    "mekf": Line("MEKF", colors.OPEN_LOOP), "usque": Line("USQUE", colors.TRUTH), "additive": Line("additive UKF", colors.SIGMA),
}  # fmt: skip
Cells = dict[str, str | float]


def style(name: str) -> dict[str, Any]:
    """How a filter's curve looks."""
    line = LINES[name]
    return {"label": line.label, "color": line.color, "linestyle": line.style, "linewidth": line.width}


def rms(results: Results, part: str, filter: str, group: str = "attitude", length: bool = False) -> Array:
    """RMSE over the runs ``(T,)``: mean over the axes, or of the length."""
    square = np.square(results.error(part, filter, group))
    return np.asarray(np.sqrt((square.sum(-1) if length else square.mean(-1)).mean(1)))


def euler(results: Results, filter: str) -> Array:
    """Errors ``(T, runs, 3)`` arcsec of roll, pitch and yaw, as the paper draws them."""
    config = results.parts["runs"].config
    q = path(config)[:: config.ratio, None]
    mean = attitude.multiply(attitude.exp(results.error("runs", filter, "attitude") * ARCSEC), q)
    return np.asarray(wrap(attitude.to_euler(mean) - attitude.to_euler(q)) / ARCSEC)


def angle(axis: int, results: Results) -> Figure:
    """An Euler angle's error: its RMSE, the first run at its beginning, and the RMSE over computing time."""
    fig, axes = figure(10.0, 3.1, 1, 3)
    t = results.times("runs")
    for name in ("aukf", "ssukf"):
        error = euler(results, name)[..., axis]
        rmse, per = np.sqrt(np.square(error).mean(1)), results.value("timings", f"{name}, {STANDARD.ratio}:1, 1", 0)
        for ax, x, y in zip(axes, (t, t, per * np.arange(len(t))), (rmse, np.abs(error[:, 0]), rmse), strict=True):
            ax.semilogy(x, y, **style(name))
    exact = results.get("facts", "exact")[: len(t), 0]
    axes[0].semilogy(t[1:], exact[1:], color=colors.BOUND, linewidth=3.0, zorder=0, label="exact deviation")
    for level in (10.0, 5.0, 2.0):
        axes[0].axhline(level, color=colors.SIGMA, linewidth=0.6, linestyle=":")
    axes[0].set(xlabel="time (s)", ylabel=f"{AXES[axis]} error (arcsec)", title=f"RMSE of {error.shape[1]} runs")
    axes[1].set(xlabel="time (s)", xlim=(-0.2, 10.0), title="one run, the first 10 s")
    axes[2].set(xlabel="CPU time of one run alone at 100 Hz (s)", title="RMSE over computing time")
    for ax in axes[:2]:
        ax.legend()
    return fig


def accuracy(results: Results) -> Figure:
    """What the model allows, and what is reached: attitude and drift."""
    fig, axes = figure(9.0, 3.2, 1, 2)
    t, exact = results.times("runs")[1:], results.get("facts", "exact")
    for i, (ax, group, unit) in enumerate(zip(axes, ("attitude", "drift"), ("arcsec", "deg/h"), strict=True)):
        ax.loglog(t, exact[1 : len(t) + 1, i], color=colors.BOUND, linewidth=4.0, label="exact deviation")
        for name in ("aukf", "ssukf", "mekf"):
            ax.loglog(t, rms(results, "runs", name, group)[1:], **style(name) | {"label": f"RMSE {LINES[name].label}"})
        ax.set(xlabel="time (s)", ylabel=f"{group} ({unit})")
    axes[0].axhline(results.value("facts", "limits", 0, 0), color=colors.SIGMA, linestyle=":", label="limit (Riccati)")
    axes[0].legend()
    return fig


def consistent(results: Results) -> Figure:
    """NEES and NIS, initial errors drawn from the prior; all but the SSUKF for a minute."""
    fig, axes = figure(9.0, 3.0, 1, 2)
    for ax, what, dof in zip(axes, ("nees", "nis"), (6, 3), strict=True):
        consistency(ax, results, "runs", {"local": LINES["ssukf"]}, what, dof)
        for name in ("aukf", "usque", "mekf"):
            mean = results.get("runs", f"{name} drawn/{what}")[1:].mean(1)
            ax.plot(results.times("runs")[1 : len(mean) + 1], mean, **style(name) | {"linewidth": 0.6})
        ax.set(xlabel="time (s)", ylabel=f"{what.upper()}, mean over the runs (-)", yscale="linear")
    axes[0].margins(y=0.3)
    axes[0].legend(loc="lower right", ncols=3, fontsize=6.5)
    return fig


def one_vector(results: Results) -> Figure:
    """One measured vector separates the filters; dotted: the covariance follows the reference."""
    fig, axes = figure(10.0, 3.4, 1, 3)
    for ax, degrees in zip(axes, FIELD_DEG, strict=True):
        for name in FIELD:
            base, _, rest = name.partition(" ")
            size = rms(results, "vector", f"{name}, {degrees:g}", length=True) / 3600.0
            label = f"{LINES[base].label} {rest}".strip()
            ax.loglog(1.0 + np.arange(len(size)), size, color=LINES[base].color, linestyle=":" if rest else "-", label=label)
        ax.set(xlabel="time (s), from 1", title=f"prior {degrees:g} deg on each axis")
    axes[0].set_ylabel("total attitude error, RMS (deg)")
    axes[2].legend(loc="lower left", fontsize=6.5)
    return fig


def differences(results: Results) -> Figure:
    """How far apart filters are that are the same: SSUKF and MEKF from AUKF."""
    fig, axes = figure(9.0, 3.0, 1, 2, sharey=True)
    for ax, name in zip(axes, ("ssukf", "mekf"), strict=True):
        a, b = (results.error("runs", each, "attitude")[1:] for each in (name, "aukf"))
        apart = np.abs(a - b).max(2)
        ax.semilogy(results.times("runs")[1:], apart.max(1), color=LINES[name].color, label="largest of the runs")
        ax.semilogy(
            results.times("runs")[1:], np.median(apart, 1), color=LINES[name].color, linewidth=0.7, alpha=0.6, label="median"
        )
        ax.set(xlabel="time (s)", title=f"{LINES[name].label} and AUKF")
        ax.legend()
    axes[0].set_ylabel("difference of attitudes (arcsec)")
    return fig


def cost(results: Results) -> Figure:
    """Cost from one star sample to the next, in points and in time."""
    fig, axes = figure(9.0, 3.0, 1, 3)
    for k, per in enumerate((1, STANDARD.ratio)):
        points = [results.get("facts", f"{name}, {per}:1").sum() for name in TIMED[:3]]
        shade = (colors.COMPARISON, colors.MEASUREMENT)[k]
        axes[0].bar(np.arange(3) + 0.38 * k - 0.19, np.array(points) / points[0], 0.36, color=shade, label=f"{per}:1")
    axes[0].set(ylabel="points, to AUKF (-)", title="points", ylim=(0.0, 1.5))
    for ax, key, title in zip(axes[1:], ("1:1, 1", "1:1, 500"), ("arrays, one run", "arrays, 500 runs"), strict=True):
        spent = [results.value("timings", f"{name}, {key}", 0) for name in TIMED]
        ax.bar(range(4), np.array(spent) / spent[0], color=[LINES[name].color for name in TIMED])
        ax.set(title=f"CPU time, {title}", ylabel="to AUKF (-)")
    for ax, shown in zip(axes, (TIMED[:3], TIMED, TIMED), strict=True):
        ax.axhline(2.0 / 3.0, color=colors.PAPER, linestyle="--", label='"about 1/3 less"')
        ax.set_xticks(range(len(shown)), [LINES[name].label for name in shown], fontsize=7)
    axes[0].legend(loc="upper right")
    return fig


def sensitivity(results: Results) -> Figure:
    """What does not matter: the prior, the initial error, and alpha; and from where on it does."""
    fig, axes = figure(10.0, 3.2, 1, 3)
    for k, color in ((1, colors.COMPARISON), (40, colors.ESTIMATE), (240, colors.TRUTH)):
        values = [rms(results, "priors", f"ssukf, {d:g}")[k] for d in sorted(PRIORS_DEG)]
        axes[0].loglog(sorted(PRIORS_DEG), values, color=color, marker="o", label=f"after {k / 4:g} s")
    axes[0].set(xlabel="prior, each axis (deg); the error is 1, 2, 10 deg", ylabel="attitude, RMSE (arcsec)")
    for name, marker in zip(LARGE, "ox+.", strict=True):
        values = [rms(results, "turns", f"{name}, {d:g}")[1] for d in TURNS_DEG]
        axes[1].plot(TURNS_DEG, values, color=LINES[name].color, marker=marker, label=LINES[name].label)
    axes[1].set(xlabel="initial error (deg)", ylabel="after the first star sample (arcsec)", ylim=(0.0, 40.0))
    axes[2].loglog(ALPHAS, [results.get("spreads", f"{a:g}")[0].max() for a in ALPHAS], color=colors.ESTIMATE, marker="o")
    axes[2].set(xlabel="alpha (-)", ylabel="largest change from alpha = 0.1 (arcsec)")
    for ax in axes[:2]:
        ax.legend()
    return fig


def drawing_anew(results: Results) -> Figure:
    """What drawing anew loses: noise common to dynamics and sensor."""
    fig, ax = figure(5.0, 3.2)
    shown = {"exact": ("exact Kalman filter", colors.BOUND), "once": ("AUKF drawn once", colors.TRUTH)}
    shown |= {"ssukf": ("SSUKF", colors.ESTIMATE), "redrawn": ("AUKF drawn anew", colors.COMPARISON)}
    for k, (name, (label, color)) in enumerate(shown.items()):
        heights = np.sqrt(results.get("correlated", name).reshape(3, -1).mean(1))
        ax.bar(np.arange(3) + 0.2 * k - 0.3, heights, 0.18, color=color, label=label)
    ax.set_xticks(range(3), [f"{rho:g}" for rho in study.CORRELATIONS])
    ax.set(xlabel="correlation of the noises (-)", ylabel="RMSE (-)")
    ax.legend()
    return fig


def spinning(results: Results) -> Figure:
    """The total attitude as the state, in a spin past 360 deg, with and without the switch."""
    fig, ax = figure(6.0, 3.0)
    for name, label, look in (
        ("unswitched", "total MRP, never switched", {"color": colors.PAPER}),
        ("switched", "total MRP, switched to its shadow set", {"color": colors.COMPARISON, "linewidth": 3.0, "alpha": 0.5}),
        ("local", "local form", {"color": "black", "linewidth": 0.8}),
    ):
        error = np.linalg.norm(results.error("spin", name, "attitude"), axis=-1).max(1)
        ax.semilogy(results.times("spin"), error, label=label, **look)
    ax.set(xlabel="time (s); 360 deg at 90 s", ylabel="largest error of the runs (arcsec)")
    ax.legend()
    return fig


def costs(results: Results) -> list[Cells]:
    """Points and seconds from star sample to star sample; seconds are those of the machine at hand."""
    rows: list[Cells] = []
    for per in (1, STANDARD.ratio):
        points = {name: results.get("facts", f"{name}, {per}:1").sum() for name in TIMED}
        alone = {name: results.value("timings", f"{name}, {per}:1, 1", 0) for name in TIMED}
        for name in TIMED:
            label = "MEKF (and Jacobians)" if name == "mekf" else name.upper()
            row: Cells = {"updates of time to measurement": f"{per}:1", "filter": label, "points": int(points[name])}
            row |= {
                "points to AUKF": points[name] / points["aukf"],
                "one run alone (s)": alone[name],
                "to AUKF": alone[name] / alone["aukf"],
            }
            rows.append(
                row | ({"one run among 500 (s)": results.value("timings", f"{name}, 1:1, 500", 0) / 500.0} if per == 1 else {})
            )
    return rows


def read(results: Results) -> list[Cells]:
    """Readings of the gyro's numbers, and what settles with each of them."""
    return [
        {"reading": name, "sigma_v (rad/s^0.5)": gyro.sigma_v, "sigma_u (rad/s^1.5)": gyro.sigma_u, "tau (s)": gyro.tau,
         "attitude (arcsec)": float(limit[0]), "drift (deg/h)": float(limit[1]), "remark": remark}
        for (name, gyro, remark), limit in zip(readings(STANDARD), results.get("facts", "limits"), strict=True)
    ]  # fmt: skip


def vectors(results: Results) -> list[Cells]:
    """One measured vector: total attitude error over the runs, by deviation of the prior."""
    rows: list[Cells] = []
    for name in FIELD:
        row: Cells = {"filter": name.upper().replace(" TRANSPORTED", ", transported")}
        for key in (f"{d:g}" for d in FIELD_DEG):
            error = np.linalg.norm(results.error("vector", f"{name}, {key}", "attitude"), axis=-1) / 3600.0
            row[f"{key} deg: RMS after 100 s (deg)"] = float(np.sqrt(np.square(error[100]).mean()))
            row[f"{key} deg: RMS after 1000 s (deg)"] = float(np.sqrt(np.square(error[-1]).mean()))
            row[f"{key} deg: runs above 1 deg at the end"] = float((error[-1] > 1.0).mean())
            row[f"{key} deg: median NEES after 10 s"] = float(np.median(results.get("vector", f"{name}, {key}/nees")[10]))
        rows.append(row)
    return rows


FIGURES = {
    **{f"figure_{i + 1:02d}": (f"Fig. {i + 1}: error of {axis}: AUKF and SSUKF lie on each other; right, over computing time.",
                               partial(angle, i)) for i, axis in enumerate(AXES)},
    "figure_04": ("Beyond the paper: what the model allows, and what is reached.", accuracy),
    "figure_05": ("Beyond the paper: consistency, initial errors drawn from the prior.", consistent),
    "figure_06": ("Beyond the paper: one measured vector; dotted, the covariance follows the reference.", one_vector),
    "figure_07": ("Beyond the paper: how far apart filters are that are the same.", differences),
    "figure_08": ("Beyond the paper: cost from one star sample to the next, in points and in time.", cost),
    "figure_09": ("Beyond the paper: what does not matter: prior, initial error and alpha.", sensitivity),
    "figure_10": ("Beyond the paper: what drawing anew loses: noise common to dynamics and sensor.", drawing_anew),
    "figure_11": ("Beyond the paper: the total attitude as the state, in a spin past 360°.", spinning),
}  # fmt: skip
TABLES = {
    "table_1": ("Table 1: cost from one star sample to the next; the paper's numbers are lost, it says about 1/3 less.", costs),
    "table_2": ("Beyond the paper: readings of its gyro numbers, and what settles with each of them.", read),
    "table_3": ("Beyond the paper: one measured vector, total attitude error by deviation of the prior.", vectors),
}


# -- the recording: the first run, satellite and sensors as they turn, the errors as if under a microscope -------------------
RECORDINGS = ["ssukf.rrd"]
NAMES = {key: (LINES[key].label, LINES[key].color) for key in ("ssukf", "aukf", "mekf")}
ARM_KM, EXAGGERATION = 1500.0, 1000.0
SPACES = (
    showcase.Space("world", "orbit, km (inertial axes)", (11e3, -9e3, -15e3), (1e3, 0.0, -2e3), (0.0, -1.0, 0.0)),
    showcase.Space("body", f"axes: truth, and estimates with errors x{EXAGGERATION:g}", (3.0, -2.0, 2.0), up=(0.0, 0.0, -1.0)),
)
NOTES = """# Wu et al. (2012): state-switching UKF for attitude

* **Equal accuracy of SSUKF and AUKF: true, and an identity.** At equal spread they are one filter to round-off.
* **A third less time: counted in points {0:.0%} at 1:1, {1:.0%} at the paper's {2.ratio}:1.**
* **Faster convergence: not so.** In filter time both converge alike, to the sample.

A satellite turns freely at 800 km. Gyros and a star sensor give attitude; axes red, green, blue: roll, pitch, yaw. The first star
sample takes an error of degrees to {2.star_arcsec:g} arcsec: what follows is shown under a microscope.
"""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recording among ``outputs``; returns its name. Needs rerun."""
    t, c, found = results.times("runs"), results.parts["runs"].config, first_run(results, "runs", NAMES)
    truth = np.array([epoch.truth[0] for epoch in results.first("runs").epochs("")])
    drift = Group("drift", "deg/h", slice(3, 6), 1.0 / UNITS[3], truth=truth[:, 4:] / UNITS[3])
    apart = np.abs(found["ssukf"].errors - found["aukf"].errors)[:, 0, :3].max(1) / ARCSEC
    points = {key: results.get("facts", f"{key}, {c.ratio}:1").sum() * np.arange(len(t)) / 1e3 for key in NAMES}
    cost = {
        "difference": Plot("log10 |SSUKF - AUKF|, arcsec", {"apart": Curve(apart, colors.ESTIMATE, "SSUKF - AUKF")}, log=True),
        "points": Plot("points evaluated at 100 Hz, thousands", {key: Curve(points[key], *NAMES[key][::-1]) for key in NAMES}),
    }
    shown = showcase.Showcase(
        "ssukf", NOTES.format(saved(1)(results).value, saved(c.ratio)(results).value, c), t, found,
        (Group("attitude", "arcsec", slice(0, 3), 1.0 / ARCSEC, AXES), drift), truth, np.eye(3, 6) / ARCSEC, "arcsec", nis_dof=3,
        spaces=SPACES, plots={"cost": cost}, counter="star_epoch", parameters=vars(c),
        scene=lambda out: scene(out, c.orbit_rate_rad_per_s * t, truth[:, :4], {k: found[k].errors[:, 0, :3] for k in NAMES}),
        legend={colors.MEASUREMENT: "nadir", colors.STAR: "sight lines of the star sensor"},
        facts={"paper": "ssukf", "seed": results.seed, "runs": found["ssukf"].errors.shape[1], "exaggeration": EXAGGERATION},
    )  # fmt: skip
    return showcase.write({RECORDINGS[0]: shown}, outputs)


def scene(out: Recorder, angles: Array, truth: Array, errors: dict[str, Array]) -> None:
    """The satellite at ``angles (T,)`` along its orbit, its attitudes ``(T, 4)``, and their errors ``(T, 3)``."""
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    place, orbit = (RADIUS_KM * np.stack([np.sin(at), 0.0 * at, -np.cos(at)], -1) for at in (angles, turn))
    out.globe("world/earth", 6378.0)
    out.path("world/orbit", [orbit], colors.FAINT)
    out.arrow("world/nadir", place, -0.6 * ARM_KM / RADIUS_KM * place, colors.MEASUREMENT, "nadir")
    out.pose("world/sat", place, truth)
    out.axes("world/sat/body", ARM_KM, ("#E63946", "#2A9D8F", "#457B9D"), AXES)
    sights = np.sqrt(2.0) * ARM_KM * np.array([[[0.0, 0.0, 0.0], [0.0, sign, -1.0]] for sign in (1.0, -1.0)])
    out.path("world/sat/boresights", list(sights), colors.STAR, radius=1.0)
    out.axes("body/truth", 1.0, [colors.TRUTH] * 3, AXES, radius=1.0)
    turned = {key: (error, NAMES[key][1]) for key, error in errors.items()}
    scenes.turning(out, "world/sat", turned, 0.8 * ARM_KM)
    scenes.turning(out, "body", turned, 0.9, EXAGGERATION)
