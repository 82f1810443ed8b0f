"""Position of a satellite along the line of sight to a pulsar, from its X-ray photons alone.

The data are an hour of PSR B1509-58, observed by RXTE on 15 January 2011 [Luo2021]. The time of a
photon is transformed to the barycenter with the delay of `celnav.models.pulsar.Timing` (Roemer,
parallax, Shapiro) and from TT to TDB (Einstein). Three positions of the satellite are compared:
none (uncorrected times), the Earth's center, and its orbit. The H-test measures which of them gives
the sharpest folded pulse [DeJager1989].

We wrote these rules before we saw any result. The hour is divided into pieces of two minutes. Every
other piece contributes to a light curve, with the satellite on its orbit and as many harmonics as
the H-test selects. The remaining pieces are then shifted relative to the Earth's center, by maximum
likelihood with that light curve. The two sets of pieces then exchange their roles. The predicted
variance of a shift follows from the Fisher information of the light curve and the number of
photons. It includes the uncertainty of the light curve itself. A shift does not use the orbit. Only
channels 5 to 49 are used.

The timing model comes from a .par file: direction, spin and its derivatives. Pulsars with
companions are not supported.
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
from celnav.show.draw import MARKERS, Line, Panel, curve, level, panels
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

TITLE = "Position of a satellite from the photons of a pulsar"
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
    """Sums over the photons of each block, ``(blocks, 1 + 2 k)``: number of photons, then cosines
    and sines of all harmonics.
    """
    angle = 2.0 * np.pi * np.outer(cycles % 1.0, ORDERS)
    values = np.concatenate([np.ones((len(angle), 1)), np.cos(angle), np.sin(angle)], 1)
    return np.stack([values[block == b].sum(0) for b in range(block.max() + 1)])


def power(sums: Array) -> Array:
    """``Z^2_m - 4 m + 4 (..., k)`` of summed `harmonics`; the H-test uses the largest
    [DeJager1989].
    """
    squares = np.square(sums[..., 1:]).reshape(*sums.shape[:-1], 2, MOST_HARMONICS).sum(-2)
    return np.asarray(np.cumsum(2.0 * squares / sums[..., :1], -1) - 4.0 * ORDERS + 4.0)


def h_test(blocks: Array) -> float:
    """Statistic H of the H-test, from blocks of `harmonics`."""
    return float(power(blocks.sum(0)).max())


class Light(NamedTuple):
    """A light curve with mean 1: complex coefficients ``(m,)``; number of photons."""

    coefficients: Array
    photons: float

    @classmethod
    def of(cls, sums: Array) -> Light:
        """Light curve from summed `harmonics`, as many as the H-test selects."""
        m = int(power(sums).argmax()) + 1
        return cls(
            (sums[1 : m + 1] - 1j * sums[1 + MOST_HARMONICS : 1 + MOST_HARMONICS + m]) / sums[0],
            float(sums[0]),
        )

    def __call__(self, phase: Array, slope: bool = False) -> Array:
        """Values, at least 0.001, or the derivative."""
        k = 2.0j * np.pi * np.arange(1, len(self.coefficients) + 1)
        waves = np.exp(phase[..., None] * k) * self.coefficients
        return np.asarray(
            2.0 * (waves * k).sum(-1).real
            if slope
            else np.maximum(1.0 + 2.0 * waves.sum(-1).real, 1e-3)
        )

    @property
    def information(self) -> float:
        """Fisher information of one photon about the phase (1 / cycles^2)."""
        phase = np.arange(1024) / 1024.0
        return float((np.square(self(phase, slope=True)) / self(phase)).mean())


SHIFTS = np.arange(-0.5, 0.5, 1.0 / 512.0)


def shifted(light: Light, phase: Array) -> tuple[float, Array]:
    """Maximum-likelihood shift (cycles), interpolated between `SHIFTS` by a parabola; and the
    log-likelihoods of `SHIFTS` minus the largest.
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


# -- parts -----------------------------------------------------------------------------------------
def folded(folder: Path, _rngs: Rngs) -> Arrays:
    """`harmonics` of short blocks for each of `PLACES`, and for fractions of the way from the
    Earth's center to the orbit.
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
    """Position from each piece, with the light curve of the other set.

    Returns arrays ``(T,)``: middle of the piece (s); position, truth and predicted σ (km); the
    largest log-likelihood minus the log-likelihood of the truth; the number of photons.
    """
    p = read(folder)
    piece = (p.t // PIECE_S).astype(int)
    center, orbit, km = p.cycles(0.0), p.cycles(1.0), LIGHT_KM_S * p.spin.pulsar.period_s
    sums = harmonics(orbit, piece)
    lights = [
        Light.of(sums[1 - i :: 2].sum(0)) for i in range(2)
    ]  # from the odd pieces for the even ones, and from the even pieces for the odd ones
    rows = []
    for k in range(int(p.t[-1] // PIECE_S)):  # complete pieces
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


# -- rows ------------------------------------------------------------------------------------------
BLOCK, PIECES = 4, 3
"""Block lengths of the bootstrap: of short blocks, and of pieces."""


def parts(_effort: float = 1.0, rxte: Path | None = None) -> dict[str, Part]:
    """All parts of the study; ``rxte``: folder of photons, orbit and timing model."""
    if rxte is None:
        return {}
    read(rxte)  # raises for a wrong folder before anything is computed
    return {"folded": Part(folded, rxte, cost=5.0), "placed": Part(placed, rxte, cost=3.0)}


def sharper(one: str, other: str) -> Decided:
    """Difference of H between two of `PLACES`."""
    label = f"H, {one} minus {other}"

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
    """Fraction of the way to the orbit at which photons ``(blocks, scales, ...)`` fold best."""
    return float(PARTS[power(scales.sum(0)).max(-1).argmax()])


def place(
    label: str, statistic: Any, low: float | None, most: float | None, *names: str
) -> Decided:
    """A statistic of arrays of the pieces."""
    return lambda r: estimate(
        label, statistic, [r.get("placed", name) for name in names], (low, most), PIECES
    )


def inside(below: float) -> Any:
    """Fraction of the pieces whose truth lies within the likelihood interval."""
    return lambda logs: float((2.0 * logs <= below).mean())


def rms(*arrays: Array) -> float:
    """RMS difference of the first two arrays, in units of the third array if there is one."""
    a, b, *by = (*arrays, 1.0)
    return float(np.sqrt(np.square((a - b) / by[0]).mean()))


ROWS = (
    finding(
        "rxte-sharper",
        "Photons fold better at the Earth's center than with the satellite's clock alone. They "
        "fold best at its true position.",
        all_of(sharper("Earth's center", "own clock"), sharper("orbit", "Earth's center")),
        figure="figure_01",
        expected="undecided",
        why="H increases in both steps",
        found="H increases by {0} with the Earth's position, and by another {1} with the orbit.",
    ),
    finding(
        "rxte-scale",
        "The photons show the size of the orbit.",
        lambda r: estimate(
            "fraction of the orbit that folds best",
            best,
            [r.get("folded", "scales")],
            (0.5, 1.5),
            BLOCK,
        ),
        figure="figure_02",
        expected="undecided",
        why="the best fraction is nearer to the orbit (1) than to the Earth's center (0) or to "
        "twice the orbit (2)",
        found="The photons fold best at {0} times the orbit.",
    ),
    finding(
        "rxte-place",
        "Two minutes of photons give the satellite's position along the line of sight to better "
        "than the radius of the Earth.",
        place("RMS error (km)", rms, None, 6378.0, "place", "truth"),
        figure="figure_03",
        why="RMS error below 6378 km; a larger one would not separate the two sides of the Earth",
        found="The RMS error is {0} km.",
    ),
    finding(
        "rxte-claims",
        "The errors of the positions agree with the prediction from the Fisher information.",
        place("RMS of error over predicted σ", rms, 0.7, 1.4, "place", "truth", "std"),
        figure="figure_03",
        expected="undecided",
        why="half to twice the predicted variance",
        found="The errors are {0} times their predicted σ.",
    ),
    finding(
        "rxte-likelihood",
        "Likelihood intervals contain the truth with their nominal frequency.",
        all_of(
            place("truth inside the 68 % interval", inside(1.0), 0.5, 0.85, "below"),
            place("truth inside the 95 % interval", inside(3.84), 0.85, 1.0, "below"),
        ),
        figure="figure_03",
        expected="undecided",
        why="within two binomial standard deviations for thirty pieces",
        found="The 68 % and 95 % intervals contain the truth in fractions {0} and {1} of the "
        "pieces.",
    ),
)

STUDY = Study(
    "rxte",
    GROUPS,
    None,
    parts,
    ROWS,
    says="RXTE counted photons of a young pulsar for an hour. Do they give the satellite's "
    "position, and how accurately?",
    found=(
        Sentence(
            "Two minutes of photons give its position along the line of sight with an RMS error "
            "of {rxte-place[0]:.0f} km.",
            {"rxte-place": "shown"},
        ),
        Sentence(
            "The errors are {rxte-claims[0]:.2f} times their predicted σ; one hour does not decide "
            "whether they agree with it. It also does not decide whether the orbit sharpens the "
            "pulse more than the Earth's position alone.",
            {"rxte-claims": "undecided", "rxte-sharper": "undecided"},
        ),
    ),
    figure="figure_03",
)


# -- figures, table, recording ---------------------------------------------------------------------
LOOKS = dict(zip(PLACES, (colors.OPEN_LOOP, colors.COMPARISON, colors.TRUTH), strict=True))


def pulse(r: Results) -> Figure:
    """Light curve with the orbit, and the H-test for each position."""
    phase, counts = r.get("folded", "phase"), r.get("folded", "counts")
    steps = np.append(counts, counts[0]) / counts.mean()
    light = [
        curve(phase[::2], steps, label="photons", color=colors.SIGMA, drawstyle="steps-post"),
        curve(phase, r.get("folded", "light"), Line("light curve", LOOKS["orbit"], "--")),
    ]
    sums = {k: r.get("folded", k) for k in PLACES}
    tests = [
        curve(
            ORDERS, power(x.sum(0)), Line(f"{k}: H = {h_test(x):.0f}", LOOKS[k]), marker=MARKERS[i]
        )
        for i, (k, x) in enumerate(sums.items())
    ]
    return panels(
        [
            Panel(
                "Folded at the true position",
                light,
                "phase (cycles)",
                "photons over their mean (-)",
            ),
            Panel("The H-test", tests, "harmonics m", "Z² − 4 m + 4"),
        ],
        height=2.6,
    )


def scaled(r: Results) -> Figure:
    """H for satellite positions on the way from the Earth's center to the orbit and beyond."""
    h = power(r.get("folded", "scales").sum(0)).max(-1)
    marks = [
        level(0.0, label="Earth's center", color=LOOKS["Earth's center"], upright=True),
        level(1.0, label="orbit", color=LOOKS["orbit"], style="--", upright=True),
    ]
    return panels(
        Panel(
            "H-test with a scaled orbit",
            [curve(PARTS, h, color="black"), *marks],
            "fraction of the orbit (-)",
            "H",
        ),
        height=2.6,
    )


def sighted(r: Results) -> Figure:
    """Position along the line of sight from each piece, and from the orbit."""
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
        height=3.0,
    )


def table(r: Results) -> Rows:
    """Positions of all pieces."""
    names = {
        "middle": "middle (s)",
        "place": "position (km)",
        "truth": "truth (km)",
        "std": "predicted σ (km)",
        "photons": "photons",
    }
    each = [r.get("placed", name).tolist() for name in names]
    return [dict(zip(names.values(), row, strict=True)) for row in zip(*each, strict=True)]


FIGURES = {
    "figure_01": (
        "The pulse, and the H-test with the satellite's clock alone, at the Earth's center and on "
        "the orbit.",
        pulse,
    ),
    "figure_02": ("H-test with a scaled orbit: photons fold best near the true orbit.", scaled),
    "figure_03": (
        "Positions along the line of sight every two minutes, with their predicted σ.",
        sighted,
    ),
}
TABLES = {"table_1": ("Position from each piece of two minutes.", table)}
RECORDINGS = ["rxte.rrd"]


def record(r: Results, outputs: Outputs) -> list[str]:
    """The orbit around the Earth, the direction of the pulsar, and the position along it from each
    piece.
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
            label="from two minutes of photons",
        )

    found, truth = (r.get("placed", what) / 1e3 for what in ("place", "truth"))
    curves = {
        "orbit": Curve(truth, colors.TRUTH, "orbit"),
        "found": Curve(found, colors.ESTIMATE, "from photons", r.get("placed", "std") / 1e3, found),
    }
    plots = {"line": Plot("toward the pulsar, 1000 km from the Earth's center", curves)}
    notes = (
        "# Position of a satellite from the photons of a pulsar\nThe ray points to PSR B1509-58. "
        "Unit: 1000 km. Photons do not measure the position across the ray."
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
