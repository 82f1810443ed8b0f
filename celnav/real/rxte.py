"""X-ray photons of a pulsar and the satellite that caught them: where it was along the line of
sight, by its photons alone.

RXTE and PSR B1509-58, an hour of 15 January 2011 [Luo2021]. The time of a photon is carried to the
barycenter by the delay of `celnav.models.pulsar.Timing` (Roemer, parallax, Shapiro), with TT made
TDB (Einstein), for a place where the satellite may have been: none (its own clock), the Earth's
center, its orbit. Which folds best is told by the H-test [DeJager1989].

Written down before a result was seen: the hour is cut into pieces of two minutes. A light curve, of
as many harmonics as the H-test takes, is made of every other piece, with the satellite where it
was; by it the pieces between are shifted, for largest likelihood, from where they fold at the
Earth's center. Then the other way round. A shift claims what Fisher's information of the light
curve says of so many photons, and what the light curve itself may be off. No orbit is used for a
shift. Channels 5 to 49 are taken.

The timing model is that of a .par file: direction, spin and its derivatives. Pulsars with
companions are left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.gaussian.linalg import Array
from celnav.models.pulsar import LIGHT_KM_S
from celnav.papers import citation
from celnav.real.photons import read
from celnav.show import colors
from celnav.show.draw import Line, Panel, curve, level, panels
from celnav.show.figures import Rows
from celnav.show.plots import Curve, Plot
from celnav.show.showcase import SceneView, Showcase, write
from celnav.study.ledger import Number, Sentence, estimate, finding
from celnav.study.numbers import Decided, all_of
from celnav.study.study import Part, Results, Rngs, Study
from celnav.study.trial import Group

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celnav.files import Outputs
    from celnav.show.recording import Recorder

TITLE = "A satellite by the photons of a pulsar"
CITATION = citation("Luo2021")
INPUTS = ("rxte",)
Arrays = dict[str, Array]
PIECE_S, SHORT_S, MOST_HARMONICS = 120.0, 30.0, 20
PARTS = np.linspace(-1.0, 3.0, 81)
PLACES = ("own clock", "Earth's center", "orbit")
GROUPS = (Group("line of sight", "km", slice(0, 1)),)


# -- folding ---------------------------------------------------------------------------------------
ORDERS = np.arange(1, MOST_HARMONICS + 1)


def harmonics(cycles: Array, block: Array) -> Array:
    """Sums over the photons of each block, ``(blocks, 1 + 2 k)``: how many, cosines and sines of
    all harmonics.
    """
    angle = 2.0 * np.pi * np.outer(cycles % 1.0, ORDERS)
    values = np.concatenate([np.ones((len(angle), 1)), np.cos(angle), np.sin(angle)], 1)
    return np.stack([values[block == b].sum(0) for b in range(block.max() + 1)])


def power(sums: Array) -> Array:
    """``Z^2_m - 4 m + 4 (..., k)`` of summed `harmonics`, of which the H-test takes the largest
    [DeJager1989].
    """
    squares = np.square(sums[..., 1:]).reshape(*sums.shape[:-1], 2, MOST_HARMONICS).sum(-2)
    return np.asarray(np.cumsum(2.0 * squares / sums[..., :1], -1) - 4.0 * ORDERS + 4.0)


def h_test(blocks: Array) -> float:
    """Of blocks of `harmonics`."""
    return float(power(blocks.sum(0)).max())


class Light(NamedTuple):
    """A light curve, mean 1: complex coefficients ``(m,)``; how many photons made it."""

    coefficients: Array
    photons: float

    @classmethod
    def of(cls, sums: Array) -> Light:
        """Of summed `harmonics`, as many as the H-test takes."""
        m = int(power(sums).argmax()) + 1
        return cls(
            (sums[1 : m + 1] - 1j * sums[1 + MOST_HARMONICS : 1 + MOST_HARMONICS + m]) / sums[0],
            float(sums[0]),
        )

    def __call__(self, phase: Array, slope: bool = False) -> Array:
        """Its values, not below a thousandth, or its derivative."""
        k = 2.0j * np.pi * np.arange(1, len(self.coefficients) + 1)
        waves = np.exp(phase[..., None] * k) * self.coefficients
        return np.asarray(
            2.0 * (waves * k).sum(-1).real
            if slope
            else np.maximum(1.0 + 2.0 * waves.sum(-1).real, 1e-3)
        )

    @property
    def information(self) -> float:
        """Fisher's, of one photon about the phase (1 / cycles^2)."""
        phase = np.arange(1024) / 1024.0
        return float((np.square(self(phase, slope=True)) / self(phase)).mean())


SHIFTS = np.arange(-0.5, 0.5, 1.0 / 512.0)


def shifted(light: Light, phase: Array) -> tuple[float, Array]:
    """Shift (cycles) of largest likelihood, by a parabola between `SHIFTS`; log-likelihoods of all
    of them, less the largest.
    """
    table = np.log(light(np.arange(4096) / 4096.0))
    logs = np.array(
        [table[np.round((phase + s) % 1.0 * 4096.0).astype(int) % 4096].sum() for s in SHIFTS]
    )
    k = int(logs.argmax())
    before, top, after = logs[k - 1], logs[k], logs[(k + 1) % len(logs)]
    bend = before - 2.0 * top + after
    return float(SHIFTS[k] + 0.5 * (before - after) / bend / len(SHIFTS)) if bend < 0.0 else float(
        SHIFTS[k]
    ), logs - top


# -- what is computed ------------------------------------------------------------------------------
def folded(folder: Path, _rngs: Rngs) -> Arrays:
    """`harmonics` of short blocks for each of `PLACES`, and for parts of the way from the Earth's
    center to the orbit.
    """
    p = read(folder)
    block = np.unique((p.t // SHORT_S).astype(int), return_inverse=True)[1]
    out = {
        place: harmonics(p.cycles(part), block)
        for place, part in zip(PLACES, (None, 0.0, 1.0), strict=True)
    }
    scales = np.stack([harmonics(p.cycles(part), block) for part in PARTS])
    phase = np.linspace(0.0, 1.0, 65)
    return out | {
        "scales": np.moveaxis(scales, 0, 1),
        "phase": phase,
        "counts": np.histogram(p.cycles(1.0) % 1.0, phase[::2])[0],
        "light": Light.of(out["orbit"].sum(0))(phase),
    }


def placed(folder: Path, _rngs: Rngs) -> Arrays:
    """Each piece placed by the light curve of the others: middle (s), place, truth, claimed
    deviation (km), ``(T,)``, and by how much the truth's log-likelihood is below the largest."""
    p = read(folder)
    piece = (p.t // PIECE_S).astype(int)
    center, orbit, km = p.cycles(0.0), p.cycles(1.0), LIGHT_KM_S * p.spin.pulsar.period_s
    sums = harmonics(orbit, piece)
    lights = [
        Light.of(sums[1 - i :: 2].sum(0)) for i in range(2)
    ]  # that of the odd pieces for the even ones, and back
    rows = []
    for k in range(int(p.t[-1] // PIECE_S)):  # the whole ones
        there, light = piece == k, lights[k % 2]
        if there.sum() < 100:  # a gap
            continue
        shift, logs = shifted(light, center[there])
        true = float((orbit - center)[there].mean())
        below = -float(np.interp(true, SHIFTS, logs))
        std = np.sqrt((1.0 / there.sum() + 1.0 / light.photons) / light.information)
        rows.append((p.t[there].mean(), km * shift, km * true, km * std, below, there.sum()))
    return dict(
        zip(("middle", "place", "truth", "std", "below", "photons"), np.array(rows).T, strict=True)
    )


# -- what is found ---------------------------------------------------------------------------------
BLOCK, PIECES = 4, 3
"""Short blocks, and pieces, that are drawn together."""


def parts(_effort: float = 1.0, rxte: Path | None = None) -> dict[str, Part]:
    """All that is computed; ``rxte``: folder of photons, orbit and timing model."""
    if rxte is None:
        return {}
    read(rxte)  # what is no such folder is refused before anything is computed
    return {"folded": Part(folded, rxte, cost=5.0), "placed": Part(placed, rxte, cost=3.0)}


def sharper(one: str, other: str) -> Decided:
    """How much more the H-test finds with one of `PLACES` than with another."""
    label = f"H, {one} less {other}"

    def number(r: Results) -> Number:
        return estimate(
            label,
            lambda a, b: h_test(a) - h_test(b),
            [r.get("folded", k) for k in (one, other)],
            (0.0, None),
            BLOCK,
        )

    return number


def best(scales: Array) -> float:
    """The part of the way to the orbit at which photons ``(blocks, scales, ...)`` fold best."""
    return float(PARTS[power(scales.sum(0)).max(-1).argmax()])


def place(
    label: str, statistic: Any, low: float | None, most: float | None, *names: str
) -> Decided:
    """A statistic of arrays of the pieces."""
    return lambda r: estimate(
        label, statistic, [r.get("placed", name) for name in names], (low, most), PIECES
    )


def inside(below: float) -> Any:
    """Share of the pieces in which the truth is as likely as that."""
    return lambda logs: float((2.0 * logs <= below).mean())


def rms(*arrays: Array) -> float:
    """Root mean square of the first less the second, over the third."""
    a, b, *by = (*arrays, 1.0)
    return float(np.sqrt(np.square((a - b) / by[0]).mean()))


ROWS = (
    finding(
        "rxte-sharper",
        "Photons fold better at the Earth's center than by the satellite's clock, and best where "
        "it was.",
        all_of(sharper("Earth's center", "own clock"), sharper("orbit", "Earth's center")),
        figure="figure_01",
        expected="undecided",
        why="More is better.",
        found="H grows by {0} with the Earth's place, by {1} more with the orbit.",
    ),
    finding(
        "rxte-scale",
        "The photons know how large the orbit is.",
        lambda r: estimate(
            "part of the orbit that folds best",
            best,
            [r.get("folded", "scales")],
            (0.5, 1.5),
            BLOCK,
        ),
        figure="figure_02",
        expected="undecided",
        why="Nearer to the orbit than to the Earth's center, or to twice the orbit.",
        found="Best is {0} of it.",
    ),
    finding(
        "rxte-place",
        "Two minutes of photons place the satellite along the line of sight to less than the "
        "radius of the Earth.",
        place("RMS error (km)", rms, None, 6378.0, "place", "truth"),
        figure="figure_03",
        why="Less would not tell one side of the Earth from the other.",
        found="The error is {0} km RMS.",
    ),
    finding(
        "rxte-claims",
        "Places are as good as Fisher's information claims.",
        place("RMS error / claimed", rms, 0.7, 1.4, "place", "truth", "std"),
        figure="figure_03",
        expected="undecided",
        why="Half to twice the claimed variance.",
        found="Errors are {0} times what is claimed.",
    ),
    finding(
        "rxte-likelihood",
        "Intervals of the likelihood hold the truth as often as they should.",
        all_of(
            place("inside 68 %", inside(1.0), 0.5, 0.85, "below"),
            place("inside 95 %", inside(3.84), 0.85, 1.0, "below"),
        ),
        figure="figure_03",
        expected="undecided",
        why="Two binomial deviations of thirty pieces.",
        found="Inside are {0} and {1} of the pieces.",
    ),
)

STUDY = Study(
    "rxte",
    GROUPS,
    None,
    parts,
    ROWS,
    says="RXTE counted photons of a young pulsar for an hour. Do they show where the satellite "
    "was, and how well do they know it?",
    found=(
        Sentence(
            "Two minutes of photons place it to {rxte-place[0]:.0f} km along the line of sight.",
            {"rxte-place": "shown"},
        ),
        Sentence(
            "That this is as good as predicted ({rxte-claims[0]:.2f} times), and that the orbit "
            "sharpens the pulse beyond the "
            "Earth's place, the hour leaves undecided.",
            {"rxte-claims": "undecided", "rxte-sharper": "undecided"},
        ),
    ),
    figure="figure_03",
)


# -- shown -----------------------------------------------------------------------------------------
LOOKS = dict(zip(PLACES, (colors.OPEN_LOOP, colors.COMPARISON, colors.TRUTH), strict=True))


def pulse(r: Results) -> Figure:
    """The light curve at the orbit, and what the harmonics have for each place."""
    phase, counts = r.get("folded", "phase"), r.get("folded", "counts")
    steps = np.append(counts, counts[0]) / counts.mean()
    light = [
        curve(phase[::2], steps, label="photons", color=colors.SIGMA, drawstyle="steps-post"),
        curve(phase, r.get("folded", "light"), label="light curve", color=LOOKS["orbit"]),
    ]
    sums = {k: r.get("folded", k) for k in PLACES}
    tests = [
        curve(ORDERS, power(x.sum(0)), Line(f"{k}: H = {h_test(x):.0f}", LOOKS[k]), marker=".")
        for k, x in sums.items()
    ]
    return panels(
        [
            Panel(
                "Folded where the satellite was",
                light,
                "phase (cycles)",
                "photons, over their mean",
            ),
            Panel("The H-test", tests, "harmonics m", "Z² − 4 m + 4"),
        ],
        size=(10.0, 3.8),
    )


def scaled(r: Results) -> Figure:
    """H for a satellite at a part of its way from the Earth's center."""
    h = power(r.get("folded", "scales").sum(0)).max(-1)
    marks = [
        level(0.0, label="Earth's center", color=LOOKS["Earth's center"], upright=True),
        level(1.0, label="orbit", color=LOOKS["orbit"], upright=True),
    ]
    return panels(
        Panel(
            "What folds best", [curve(PARTS, h, color="black"), *marks], "part of the orbit", "H"
        ),
        size=(6.0, 3.6),
    )


def sighted(r: Results) -> Figure:
    """Each piece's place along the line of sight, and the orbit's."""
    t, at, true, std = (
        r.get("placed", name) / scale
        for name, scale in zip(("middle", "place", "truth", "std"), (60.0, *[1e3] * 3))
    )

    def dots(ax: Axes) -> None:
        ax.errorbar(
            t, at, std, label="two minutes of photons", color=colors.ESTIMATE, fmt="o", markersize=4
        )

    items = [
        curve(t, true, Line("orbit", colors.TRUTH, width=1.9)),
        dots,
        level(-6.378, 6.378, label="radius of the Earth"),
    ]
    return panels(
        Panel("RXTE toward PSR B1509-58", items, "time (min)", "1000 km from the Earth's center"),
        size=(7.5, 4.0),
    )


def table(r: Results) -> Rows:
    """The pieces."""
    names = {
        "middle": "middle (s)",
        "place": "place (km)",
        "truth": "truth (km)",
        "std": "claimed (km)",
        "photons": "photons",
    }
    each = [r.get("placed", name).tolist() for name in names]
    return [dict(zip(names.values(), row, strict=True)) for row in zip(*each, strict=True)]


FIGURES = {
    "figure_01": (
        "The pulse, and how well it folds by the satellite's clock, at the Earth's center and on "
        "the orbit.",
        pulse,
    ),
    "figure_02": ("The orbit, scaled: the photons fold best where the satellite was.", scaled),
    "figure_03": (
        "Places along the line of sight, every two minutes, with what they claim.",
        sighted,
    ),
}
TABLES = {"table_1": ("Every piece.", table)}
RECORDINGS = ["rxte.rrd"]


def record(r: Results, outputs: Outputs) -> list[str]:
    """The orbit around the Earth, the direction of the pulsar, and the plane in which each piece
    puts the satellite.
    """
    p, t = read(r.parts["placed"].config), r.get("placed", "middle")
    n, at = (
        p.spin.pulsar.direction,
        np.stack([np.interp(t, p.t, column) for column in p.place.T], 1) / 1e3,
    )
    off = (r.get("placed", "place") - r.get("placed", "truth"))[:, None] / 1e3 * n

    def scene(out: Recorder) -> None:
        out.globe("sky/earth", 6.378)
        out.path("sky/pulsar", [np.stack([7.0 * n, 16.0 * n])], colors.STAR)
        out.trail("sky/orbit", at, colors.TRUTH)
        out.points("sky/rxte", at, colors.TRUTH, radius=5.0, label="RXTE")
        out.strips("sky/fix", np.stack([at, at + off], 1)[:, None], [colors.ESTIMATE])
        out.points(
            "sky/by_photons",
            at + off,
            colors.ESTIMATE,
            radius=4.0,
            label="by two minutes of photons",
        )

    found, truth = (r.get("placed", what) / 1e3 for what in ("place", "truth"))
    curves = {
        "orbit": Curve(truth, colors.TRUTH, "orbit"),
        "found": Curve(found, colors.ESTIMATE, "by photons", r.get("placed", "std") / 1e3, found),
    }
    plots = {"line": Plot("toward the pulsar, 1000 km from the Earth's center", curves)}
    notes = (
        "# A satellite by the photons of a pulsar\nThe ray points to PSR B1509-58, in 1000 km. "
        "Across it photons say nothing."
    )
    space = SceneView("sky", "RXTE and a pulsar", (-14.0, -22.0, 8.0), growing=("sky/orbit",))
    show = Showcase(
        "rxte",
        notes,
        t,
        scene=scene,
        spaces=[space],
        legend={colors.STAR: "pulsar"},
        plots={"place": plots},
    )
    return write({"rxte.rrd": show}, outputs)
