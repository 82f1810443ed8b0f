"""Figures, a table and a recording of the study of [Deng2013]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.ephemeris import DAY_S, de421
from celnav.papers.mars.scenario import Config, cruise
from celnav.papers.mars.study import AREAS, BEST, CASES, PRESSURE, SETTLED
from celnav.show import colors, scenes, showcase
from celnav.show.draw import MARKERS, SERIES, STYLES, Item, Line, Panel, curve, level, note, panels
from celnav.show.estimates import estimates_of
from celnav.show.plots import Curve, Plot
from celnav.study.study import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.figures import Rows
    from celnav.show.recording import Recorder

__all__ = ["FIGURES", "RECORDINGS", "TABLES", "record"]

AU_KM = 149_597_870.7
WEEK = "time since departure (weeks)"
MODES = Line("modes", colors.ESTIMATE)
IGNORING = Line("ignoring", colors.COMPARISON, "--")
LINES = {
    "ignoring": IGNORING,
    "inflated": Line("inflated", colors.OPEN_LOOP, "-."),
    "walk": Line("random walk", colors.REFERENCE, STYLES[4]),
    "modes": MODES,
}
BOUND = Line("Cramér–Rao bound", colors.TRUTH, ":")
SHADES = (colors.MEASUREMENT, colors.ESTIMATE, colors.COMPARISON)
PRINTED = {"position": (20.0, "km"), "velocity": (0.1, "m/s")}


def weeks(r: Results, part: str) -> Array:
    """Evaluated epochs, weeks."""
    return np.asarray(r.times(part) / (7.0 * DAY_S))


def errors(r: Results, part: str, filter: str, line: Line, group: str, **more: Any) -> Item:
    """RMSE of a group's length over the weeks."""
    rmse = np.sqrt(np.square(r.error(part, filter, group)).sum(-1).mean(1))
    return curve(weeks(r, part), rmse, line, **more)


# -- figures ---------------------------------------------------------------------------------------
def route(r: Results) -> Figure:
    """The cruise, and the directions to the pulsars, on the plane of the ecliptic."""
    c = r.parts[BEST].config
    states, _, _ = cruise(c)
    tilt = np.radians(23.4393)
    ecliptic = np.array(
        [[1.0, 0.0, 0.0], [0.0, np.cos(tilt), np.sin(tilt)], [0.0, -np.sin(tilt), np.cos(tilt)]]
    )
    paths = {
        "spacecraft": (states[:, :3], Line("spacecraft", colors.ESTIMATE)),
        "Earth": (orbit(c, "earth"), Line("Earth", colors.COMPARISON, "--")),
        "Mars": (orbit(c, "mars"), Line("Mars", colors.PAPER, "-.")),
    }
    items: list[Item] = []
    for path, line in paths.values():
        x, y, _ = (path @ ecliptic.T / AU_KM).T
        items.append(curve(x, y, line))
        items.append(curve(x[-1:], y[-1:], color=line.color, marker="o"))
    items.append(curve([0.0], [0.0], color=colors.BOUND, marker="o", markersize=9))
    items.append(note(-0.12, 0.0, "Sun", ha="right"))
    flat = scenes.unit((c.timing.directions @ ecliptic.T)[:, :2])
    for name, (x, y) in zip(c.pulsars, flat, strict=True):
        items.append(curve([0.3 * x, 1.7 * x], [0.3 * y, 1.7 * y], color=colors.SIGMA, lw=0.6))
        items.append(note(1.75 * x, 1.75 * y, name))
    limits = {"aspect": "equal", "xlim": (-3.3, 3.3), "ylim": (-1.9, 1.9)}
    title = "Figure 1 (not in the paper): the cruise and four pulsars"
    x, y = "ecliptic x (au)", "ecliptic y (au)"
    return panels(Panel("", items, x, y, more=limits), title=title, height=4.0)


def orbit(config: Config, body: str) -> Array:
    """Heliocentric positions of a planet during the cruise, ``(T + 1, 3)`` km."""
    at, sun = (de421().state(name, config.dates).position for name in (body, "sun"))
    return np.asarray(at - sun)


def accuracy(r: Results) -> Figure:
    """RMSE of position and velocity in the six cases."""
    rows = []
    for group, (most, unit) in PRINTED.items():
        row = []
        for pressure in PRESSURE:
            items: list[Item] = [
                errors(
                    r,
                    f"{area:g} m², {pressure}",
                    "modes",
                    Line(f"{area:g} m²", shade, style),
                    group,
                )
                for area, shade, style in zip(AREAS, SHADES, STYLES, strict=False)
            ]
            items.append(level(most, label="paper", color=colors.PAPER))
            title = f"{group}, pressure {pressure}"
            more = {"xlim": (1, 36)}
            row.append(Panel(title, items, WEEK, f"RMS error ({unit})", "y", more))
        rows.append(row)
    title = "Figure 2 (not in the paper): accuracy for three telescopes"
    return panels(*rows, title=title, sharex=True, sharey="row")


def consistent(r: Results) -> Figure:
    """NEES of four filters, with three timing models."""
    row = []
    for part, title in (
        (BEST, "Fitted to 15 years"),
        ("three years", "Fitted to 3 years"),
        ("ten years old", "15 years, 10 years old"),
    ):
        items: list[Item] = [
            curve(weeks(r, part), r.get(part, f"{name}/nees").mean(1), line)
            for name, line in LINES.items()
        ]
        items.append(level(6.0, label="consistent: 6"))
        row.append(Panel(title, items, WEEK, "mean NEES (-)", "y", {"xlim": (1, 36)}))
    title = "Figure 3 (not in the paper): consistency with 1 m²"
    return panels(row, title=title, height=2.8, sharey=True)


def irregular(r: Results) -> Figure:
    """Spin noise and photon noise of each pulsar, and what ignoring costs with old models."""
    old, c = "ten years old", r.parts[BEST].config
    spin: list[Item] = []
    for i, name in enumerate(c.pulsars):
        shape: Any = {"marker": MARKERS[i], "markevery": 6, "color": SERIES[i]}
        std = r.get(f"bounds/{BEST}", "spin")[:, i]
        spin.append(curve(weeks(r, BEST), std, label=name, linestyle=STYLES[i], **shape))
        spin.append(curve([36.0], [c.sigma_km[i]], fillstyle="none", clip_on=False, **shape))
    price: list[Item] = [
        errors(r, old, "ignoring", IGNORING, "position"),
        errors(r, old, "modes", MODES, "position"),
    ]
    bound = np.linalg.norm(r.get(f"bounds/{old}", "with spin noise")[:, :3], axis=1)
    price.append(curve(weeks(r, old), bound, BOUND))
    more = {"xlim": (1, 36)}
    title = "Figure 4 (not in the paper): spin noise, and what ignoring it costs"
    return panels(
        [
            Panel("Spin noise (open: photon noise)", spin, WEEK, "σ of a delay (km)", "y", more),
            Panel("Timing models 10 years old", price, WEEK, "position RMSE (km)", "y", more),
        ],
        title=title,
        height=2.8,
    )


FIGURES = {
    "figure_01": (
        "Beyond the paper: the cruise from Earth to Mars on the plane of the ecliptic, and the "
        "directions to the four pulsars.",
        route,
    ),
    "figure_02": (
        "Beyond the paper: RMS length of the errors of position and velocity over the cruise, for "
        "three telescopes, with a tenth of the solar radiation pressure not modeled, or all of it.",
        accuracy,
    ),
    "figure_03": (
        "Beyond the paper: mean NEES of four filters with a telescope of 1 m², by the fit of the "
        "timing models.",
        consistent,
    ),
    "figure_04": (
        "Beyond the paper. Left: σ of the spin noise of each pulsar, and of the photon noise with "
        "1 m² (open marks). Right: position error with timing models that are ten years old.",
        irregular,
    ),
}


def table(r: Results) -> Rows:
    """RMSE from the fifth observation on, and NEES, of each filter in each case."""
    rows: Rows = []
    for case in CASES:
        for name in LINES:
            row: dict[str, str | float] = {"case": case, "filter": name}
            for group, (_, unit) in PRINTED.items():
                square = r.squares(case, name, group, SETTLED).sum(-1).mean()
                row[f"{group} RMSE ({unit})"] = float(np.sqrt(square))
            rows.append(row | {"mean NEES": float(r.nees(case, name, SETTLED).mean())})
    return rows


TABLES = {
    "table_1": (
        "Beyond the paper: RMS errors and mean NEES from the fifth observation to arrival.",
        table,
    )
}


# -- the recording ---------------------------------------------------------------------------------
RECORDINGS = ["mars.rrd"]
NOTES = """# From Earth to Mars by four pulsars

**The filter that ignores the spin noise is overconfident: its NEES grows far above the band, and \
that of the filter with modes stays inside.**

Run 1 with a telescope of 1 m². Each week the spacecraft times four millisecond pulsars, which the \
arrows point at. Left: the cruise about the Sun, in astronomical units. Right: errors with 3σ, \
also along the direction to B1937+21, where the spin noise acts.
"""


def record(results: Results, outputs: Outputs) -> list[str]:
    """Write the recording to ``outputs`` and return its name. Needs rerun."""
    c = results.parts[BEST].config
    estimates, truth, z = estimates_of(
        results, BEST, {name: LINES[name] for name in ("modes", "ignoring")}
    )
    place, n = truth[:, :3] / AU_KM, c.timing.directions[0]
    toward = Plot(
        f"error toward {c.pulsars[0]}, km",
        {
            name: Curve(
                e.errors[:, 0, :3] @ n,
                e.color,
                e.label,
                np.sqrt(np.einsum("i,tij,j->t", n, np.asarray(e.cov)[:, :3, :3], n)),
            )
            for name, e in estimates.items()
        },
    )

    def scene(out: Recorder) -> None:
        for body, color in (("earth", colors.COMPARISON), ("mars", colors.PAPER)):
            path = orbit(c, body) / AU_KM
            out.path(f"world/{body}/orbit", [path], color)
            out.points(f"world/{body}/now", path[1:], color, radius=5.0, label=body.capitalize())
        out.points("world/sun", 0.0 * place, colors.STAR, radius=9.0, label="Sun")
        scenes.track(out, "world/truth", place, colors.TRUTH, "spacecraft", radius=4.0)
        for name, direction in zip(c.pulsars, c.timing.directions, strict=True):
            arrow = np.tile(1.2 * direction, (len(place), 1))
            out.arrow(f"world/pulsar/{name}", place, arrow, colors.STAR, name)

    view = showcase.SceneView("world", "scene, au", (0.0, -1.5, 3.6), growing=["world/truth/trail"])
    bound = results.get(f"bounds/{BEST}", "with spin noise")
    return showcase.write(
        {
            RECORDINGS[0]: showcase.Showcase(
                "mars: 1 m², modeled",
                NOTES,
                results.times(BEST),
                estimates,
                results.study.groups,
                truth,
                np.eye(3, 6),
                "km",
                nis_dof=z.shape[-1],
                bound={
                    group.name: np.linalg.norm(bound[:, group.part], axis=1)
                    for group in results.study.groups
                },
                scene=scene,
                spaces=[view],
                plots={"toward": {"first": toward}},
                legend={colors.STAR: "directions to the pulsars"},
                parameters=vars(c),
                facts={"paper": "mars", "case": BEST, "seed": results.seed},
                start_date=c.start_utc,
            )
        },
        outputs,
    )
