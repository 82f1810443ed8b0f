"""Figures and Table 1 with the numbers of [Wu2012], further figures, and the recording."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from celnav.gaussian import attitude
from celnav.gaussian.linalg import Array
from celnav.gaussian.spaces import wrap
from celnav.papers.ssukf.scenario import ARCSEC, DEG_PER_H, GROUPS, RADIUS_KM, STANDARD, path
from celnav.papers.ssukf.study import AXES, FIELD, FIELD_DEG, ROOTS, TIMED, points
from celnav.show import colors, scenes, showcase
from celnav.show.draw import STYLES, Item, Line, Panel, curve, level, panels
from celnav.show.estimates import estimates_of
from celnav.show.figures import Rows, consistency, rmse
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

__all__ = ["FIGURES", "RECORDINGS", "TABLES", "euler", "record"]

LINES = {
    "ssukf": Line("SSUKF", colors.ESTIMATE, "--", 1.2),
    "aukf": Line("AUKF", colors.COMPARISON, width=2.2),
    "mekf": Line("MEKF", colors.OPEN_LOOP, STYLES[2]),
    "usque": Line("USQUE", colors.TRUTH, STYLES[5]),
}
FORMS = {
    "unswitched": Line("total attitude, never switched", colors.PAPER, STYLES[2]),
    "switched": Line("total attitude, switched", colors.COMPARISON, width=2.2),
    "local": Line("error of the attitude", colors.ESTIMATE, "--"),
}
EXACT = Line("exact σ (Riccati)", colors.BOUND, width=5.0)
SIZE, NEW = "RMSE (arcsec)", "Figure {} (not in the paper): {}"


def euler(results: Results, filter: str) -> Array:
    """Errors ``(T, runs, 3)`` arcsec of roll, pitch and yaw, as the paper draws them."""
    config = results.parts["runs"].config
    q = path(config)[:: config.ratio, None]
    mean = attitude.multiply(attitude.exp(results.error("runs", filter, "attitude") * ARCSEC), q)
    return np.asarray(wrap(attitude.to_euler(mean) - attitude.to_euler(q)) / ARCSEC)


def angle(axis: int, results: Results) -> Figure:
    """Error of an Euler angle: the first run, as in the paper; the RMSE over time; and the RMSE
    over operations."""
    names = ("aukf", "ssukf")
    t = results.times("runs")[1:]
    exact = results.get("facts", "exact")[1:, 0]
    errors = {name: euler(results, name)[1:, ..., axis] for name in names}
    size = {name: np.sqrt(np.square(errors[name]).mean(1)) for name in names}
    spent = {
        name: results.value("operations", f"{name}, {STANDARD.ratio}:1, {ROOTS[0]}", 0)
        * np.arange(1, len(t) + 1)
        for name in names
    }
    first = [curve(t, errors[name][:, 0], LINES[name]) for name in names]
    sizes = [
        curve(t, exact[: len(t)], EXACT),
        *(curve(t, size[name], LINES[name]) for name in names),
        level(10.0, 5.0, 2.0, label="10, 5 and 2 arcsec"),
    ]
    start = f"One run, from {STANDARD.attitude_deg[axis]:g}°"
    runs = f"RMSE of {errors['aukf'].shape[1]} runs"
    label = f"{AXES[axis]} error (arcsec)"
    span = {"xlim": (t[0], t[-1])}
    return panels(
        Panel(start, first, "time (s)", label, more={"ylim": (-30.0, 30.0)} | span),
        Panel(runs, sizes, "time (s)", SIZE, "xy", more=span),
        Panel(
            f"{runs}, over operations",
            [curve(spent[name], size[name], LINES[name]) for name in names],
            f"operations of one run at 100 Hz, {ROOTS[0]} roots",
            SIZE,
            "xy",
        ),
        height=1.75,
        title=f"Figure {axis + 1}: {AXES[axis]}",
    )


def accuracy(results: Results) -> Figure:
    """RMSE of attitude and drift, and their exact standard deviation."""
    t = results.times("runs")[1:]
    exact = results.get("facts", "exact")[1:]
    limits = results.get("facts", "limits")[-1]

    def items(i: int, group: str) -> list[Item]:
        reached = [
            rmse(results, "runs", name, LINES[name], group, each=True, start=1)
            for name in ("mekf", "aukf", "ssukf")
        ]
        return [
            curve(t, exact[: len(t), i], EXACT),
            *reached,
            level(limits[i], label="steady σ (Riccati)"),
        ]

    return panels(
        [
            Panel(
                group.name,
                items(i, group.name),
                "time (s)",
                f"RMSE on an axis ({group.unit})",
                "xy",
            )
            for i, group in enumerate(GROUPS)
        ],
        title=NEW.format(4, "RMSE and exact standard deviation"),
    )


def consistent(results: Results) -> Figure:
    """NEES and NIS of the SSUKF in two forms, with initial errors drawn from the prior."""
    both = {name: FORMS[name] for name in ("switched", "local")}
    return panels(
        [
            Panel(
                what.upper(),
                [consistency(results, "drawn", both, what, dof)],
                "time (s)",
                "mean over the runs (-)",
            )
            for what, dof in (("nees", 6), ("nis", 3))
        ],
        title=NEW.format(5, "consistency"),
    )


def one_vector(results: Results) -> Figure:
    """Filters with one measured vector. Those with dots transport the covariance."""

    def item(name: str, degrees: float) -> Item:
        base, _, moved = name.partition(" ")
        error = results.error("vector", f"{name}, {degrees:g}", "attitude")[1:] / 3600.0
        line = LINES[base]._replace(label=f"{LINES[base].label} {moved}".strip())
        marks = {"marker": "o", "markersize": 3.0, "markevery": 0.12} if moved else {}
        rms = np.sqrt(np.square(error).sum(-1).mean(1))
        return curve(results.times("vector")[1:], rms, line, **marks)

    return panels(
        [
            Panel(
                f"prior {d:g}° on each axis",
                [item(name, d) for name in FIELD],
                "time (s)",
                "attitude RMSE (deg)",
                "xy",
            )
            for d in FIELD_DEG
        ],
        title=NEW.format(6, "one measured vector"),
    )


def differences(results: Results) -> Figure:
    """Differences between filters that should agree: SSUKF and MEKF from AUKF."""
    t = results.times("runs")[1:]
    error = {
        name: results.error("runs", name, "attitude")[1:] for name in ("aukf", "ssukf", "mekf")
    }
    apart = {
        LINES[name].label: np.abs(error[name] - error["aukf"]).max(2) for name in ("ssukf", "mekf")
    }
    looks = Line("largest of all runs", colors.ESTIMATE), Line("median", colors.SIGMA, "--")
    return panels(
        [
            Panel(
                f"{label} and AUKF",
                [curve(t, each.max(1), looks[0]), curve(t, np.median(each, 1), looks[1])],
                "time (s)",
                "difference (arcsec)",
                "y",
            )
            for label, each in apart.items()
        ],
        title=NEW.format(7, "differences between filters"),
        sharey=True,
    )


def spinning(results: Results) -> Figure:
    """The total attitude as the state in a spin past 360 deg, with and without the switch."""
    t = results.times("crossing")
    errors = {name: results.error("crossing", name, "attitude") for name in FORMS}
    items = [
        curve(t, np.linalg.norm(errors[name], axis=-1).max(1), line) for name, line in FORMS.items()
    ]
    return panels(
        Panel("", items, "time (s); 360° at 10 s", "largest error of all runs (arcsec)", "y"),
        title=NEW.format(8, "a spin past 360°"),
    )


def table(results: Results) -> Rows:
    """Sigma points, and operations of code that takes one point after the other, from star sample
    to star sample; with the root of the whole augmented covariance (whole), or of the state's alone
    (block)."""
    rows: Rows = []
    for per in (1, STANDARD.ratio):
        for name in TIMED:
            label = "MEKF (and Jacobians)" if name == "mekf" else name.upper()
            count = points(results, name, per)
            row: dict[str, str | float] = {
                "updates of time to measurement": f"{per}:1",
                "filter": label,
                "points": int(count),
                "points to AUKF": count / points(results, "aukf", per),
            }
            for roots in ROOTS if name != "mekf" else ():
                row[f"operations, {roots} roots"] = int(
                    results.value("operations", f"{name}, {per}:1, {roots}", 0)
                )
            rows.append(row)
    return rows


FIGURES = {
    **{
        f"figure_{i + 1:02d}": (
            f"Fig. {i + 1}: error of {axis}. (a) One run, as in the paper; AUKF and SSUKF "
            "coincide. (b) RMSE over time. (c) RMSE over counted operations.",
            partial(angle, i),
        )
        for i, axis in enumerate(AXES)
    },
    "figure_04": (
        "Beyond the paper: RMSE of the filters and the exact standard deviation.",
        accuracy,
    ),
    "figure_05": (
        "Beyond the paper: NEES and NIS, with initial errors drawn from the prior.",
        consistent,
    ),
    "figure_06": (
        "Beyond the paper: filters with one measured vector; with dots, the covariance is "
        "transported to the new reference.",
        one_vector,
    ),
    "figure_07": ("Beyond the paper: differences between filters that should agree.", differences),
    "figure_08": (
        "Beyond the paper: the total attitude as the state in a spin past 360°.",
        spinning,
    ),
}
TABLES = {
    "table_1": (
        "Table 1: cost from star sample to star sample. The paper's numbers are lost; its text "
        "says about 1/3 less.",
        table,
    )
}


# -- the recording: the first run, with the turning satellite and enlarged errors ------------------
RECORDINGS = ["ssukf.rrd"]
ARM_KM = 1500.0
EXAGGERATION = 1000.0
SPACES = (
    showcase.SceneView(
        "world",
        "orbit, km (inertial axes)",
        (11e3, -9e3, -15e3),
        (1e3, 0.0, -2e3),
        (0.0, -1.0, 0.0),
    ),
    showcase.SceneView(
        "body",
        f"axes of the truth, and of estimates with errors x {EXAGGERATION:g}",
        (3.0, -2.0, 2.0),
        up=(0.0, 0.0, -1.0),
    ),
)
NOTES = """# Wu et al. (2012): state-switching UKF for attitude

**The state-switching UKF (SSUKF), the augmented UKF and the MEKF give the same estimates: their \
curves coincide.**

A satellite turns freely at a height of 800 km. Gyros and a star sensor give its attitude. Red, \
green and blue axes: roll, pitch and yaw.
The first star sample reduces an error of degrees to 20 arcsec. Later errors are shown enlarged.
"""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recording to ``outputs`` and return its name. Needs rerun."""
    lines = {name: LINES[name] for name in ("ssukf", "aukf", "mekf")}
    found, truth, _ = estimates_of(results, "runs", lines)
    t = results.times("runs")
    c = results.parts["runs"].config
    turn, drift = GROUPS
    errors = {name: (found[name].errors[:, 0, :3], line.color) for name, line in lines.items()}
    shown = showcase.Showcase(
        "ssukf",
        NOTES,
        t,
        found,
        (turn._replace(axes=AXES), drift),
        truth,
        np.eye(3, 6) / ARCSEC,
        "arcsec",
        nis_dof=3,
        truths={"drift": truth[:, 4:] / DEG_PER_H},
        spaces=SPACES,
        counter="star_epoch",
        parameters=vars(c),
        scene=lambda out: scene(out, c.orbit_rate_rad_per_s * t, truth[:, :4], errors),
        legend={colors.MEASUREMENT: "nadir", colors.STAR: "lines of sight of the star sensor"},
        facts={
            "paper": "ssukf",
            "seed": results.seed,
            "exaggeration": EXAGGERATION,
        },
    )
    return showcase.write({RECORDINGS[0]: shown}, outputs)


def scene(
    out: Recorder, angles: Array, truth: Array, errors: Mapping[str, tuple[Array, str]]
) -> None:
    """Draw the satellite at ``angles (T,)`` along its orbit with attitudes ``truth (T, 4)``, and
    the estimates by their errors ``(T, 3)`` and colors."""
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    place, orbit = (
        RADIUS_KM * np.stack([np.sin(at), 0.0 * at, -np.cos(at)], -1) for at in (angles, turn)
    )
    out.globe("world/earth", 6378.0)
    out.path("world/orbit", [orbit], colors.FAINT)
    out.arrow("world/nadir", place, -0.6 * ARM_KM / RADIUS_KM * place, colors.MEASUREMENT, "nadir")
    out.pose("world/sat", place, truth)
    out.axes("world/sat/body", ARM_KM, ("#E63946", "#2A9D8F", "#457B9D"))
    sights = (
        np.sqrt(2.0)
        * ARM_KM
        * np.array([[[0.0, 0.0, 0.0], [0.0, sign, -1.0]] for sign in (1.0, -1.0)])
    )
    out.path("world/sat/boresights", list(sights), colors.STAR, radius=1.0)
    out.axes("body/truth", 1.0, [colors.TRUTH] * 3, AXES, radius=1.0)
    scenes.turning(out, "world/sat", errors, 0.8 * ARM_KM)
    scenes.turning(out, "body", errors, 0.9, EXAGGERATION)
