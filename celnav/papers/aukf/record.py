"""Recordings: the first run with the burst, and, where its files are given, the receiver's half day."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pymap3d import geodetic2ecef

from celnav.models import pseudorange
from celnav.models.beidou import ELLIPSOID, GRAVITY_PARAMETER, ROTATION_RATE, satellites, turned
from celnav.papers.aukf.constellation import synthetic
from celnav.papers.aukf.evidence import LABELS
from celnav.papers.aukf.figures import COLORS
from celnav.papers.aukf.scenario import START_S, TOE_S, axes, circle, visible
from celnav.papers.aukf.study import Result
from celnav.receiver.report import KIND_COLORS, kinds, record_positioned
from celnav.show import colors, scenes, showcase
from celnav.show.estimates import Group, estimates
from celnav.show.plots import Plot, curves
from celnav.show.showcase import Showcase, Space

if TYPE_CHECKING:
    from celnav.files import Outputs
    from celnav.papers.aukf.config import Config
    from celnav.show.recording import Recorder

RECORDINGS = ["aukf_burst.rrd", "aukf_real.rrd"]
NAMES = {"aukf": ("AUKF", COLORS["aukf"]), "ekf": ("EKF, as UKF", COLORS["ukf"]), "group": (LABELS["group"], COLORS["group"]),
         "ls": ("each epoch by itself", COLORS["ls"])}  # fmt: skip
GROUPS = (Group("position", "m", slice(0, 3), axes="XYZ"), Group("velocity", "m/s", slice(3, 6), axes="XYZ"))
SPACES = (
    Space("world", "satellites, 1000 km (Earth-fixed)", (-45.0, 68.0, 40.0)),
    Space("track", "track, m (east, north, up)", (0.0, -9e3, 9e3), growing=[f"track/{name}/trail" for name in ("truth", *NAMES)]),
)


def record(result: Result, outputs: Outputs) -> list[str]:
    """Write the recordings among ``outputs``; returns their names. Needs rerun."""
    if result.real is not None:
        with outputs.path_for(RECORDINGS[1]) as path:
            record_positioned(result.real.positioned(), path)
    return showcase.write({RECORDINGS[0]: _burst(result)}, outputs) + RECORDINGS[1:] * (result.real is not None)


def _burst(result: Result) -> Showcase:
    c, t, (start, end) = result.config, result.times(), result.config.burst_s
    names, dilution = result.facts["geometry"].names, result.facts["geometry"].dilution._asdict()
    data = {key.removeprefix("ranges/"): array for key, array in result.data["main"].items() if key.startswith("ranges/")}
    found, local, S = estimates(data, NAMES), axes(c), len(names)
    factor, shades = data["aukf/factor"][:, 0].T.reshape(2, S, -1), [KIND_COLORS[kind] for kind in kinds(names)]
    adapt = {
        name: Plot(f"log10 A of the {name}", curves(names, A, shades), log=True) for name, A in zip(("ranges", "rates"), factor)
    }
    palette = (colors.SIGMA, colors.COMPARISON, colors.TRUTH, colors.ESTIMATE, colors.OPEN_LOOP)
    values = [v[: len(t)] for v in dilution.values()]
    adapt["dilution"] = Plot(f"dilution of precision, {S} satellites", curves(dilution, values, palette))

    def scene(out: Recorder) -> None:
        _sky(out, c)
        middle = np.array(geodetic2ecef(c.latitude_deg, c.longitude_deg, c.height_m, ell=ELLIPSOID))
        truth = (circle(c)[0] - middle) @ local.T
        out.trail("track/truth/trail", truth, colors.TRUTH, radius=2.0)
        for key, e in found.items():
            cov = None if e.cov is None else local @ e.cov[:, :3, :3] @ local.T
            scenes.track(out, f"track/{key}", truth + e.errors[:, 0, :3] @ local.T, e.color, e.label, cov=cov)

    return Showcase(
        "aukf: burst", NOTES.format(c), t, found, GROUPS, None, np.concatenate([local, np.zeros((3, 5))], 1), "m, east, north, up",
        nis_dof=2 * S, scene=scene, spaces=SPACES, plots={"adaptation": adapt},
        events=[(start, f"{c.burst_sigma:g} m of noise on all ranges begin"), (end, "they end")], parameters=vars(c),
        facts={"paper": "aukf", "preset": "burst", "seed": result.seed, "runs": result.runs},
    )  # fmt: skip


def _sky(out: Recorder, c: Config) -> None:
    """Lengths in 1000 km: those of the ground are lost in the picture anyway."""
    (position, velocity), broadcast = circle(c), synthetic(TOE_S)
    places = pseudorange.sources(broadcast, START_S + c.times, position, velocity).q
    period = 2.0 * np.pi * broadcast.sqrt_a**3 / np.sqrt(GRAVITY_PARAMETER)
    away = np.linspace(0.0, 1.0, 91)[:, None] * period  # orbits as they lie in space, on axes that are Earth-fixed at the start
    orbits = turned(satellites(broadcast, START_S + away).position, -ROTATION_RATE * away)
    seen, shades = np.isin(broadcast.names, visible(c).names), [KIND_COLORS[kind] for kind in kinds(broadcast.names)]
    out.globe("world/earth", ELLIPSOID.semimajor_axis / 1e6)
    scenes.constellation(out, "world", places / 1e6, orbits / 1e6, position / 1e6, seen, broadcast.names, shades)


NOTES = """# Fan et al., {0.burst_sigma:g} m of noise on all ranges from {0.burst_s[0]:g} to {0.burst_s[1]:g} s

**Adapting the noise of the measurement shrugs the burst off; the EKF, which equals the UKF, takes it for position.**

A receiver circles with {0.acceleration_g:g} g at {0.speed_m_per_s:g} m/s. Group parity knows the noise from what no position
explains, and needs no window. Satellites: GEO red, IGSO orange, MEO blue.
"""
