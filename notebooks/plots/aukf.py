"""Drawings of notebook 05."""

from __future__ import annotations

import base64
import io

import numpy as np
from PIL import Image

import celnav
from celnav.papers.aukf.scenario import filters, noise_factors
from celnav.show import colors
from celnav.show.draw import Line, Panel, band, curve, interval, level, panels
from celnav.show.notebook import Folded

UKF = Line("UKF", colors.COMPARISON, "--")
AUKF = Line("AUKF", colors.ESTIMATE)
TRUE = Line("true noise", colors.TRUTH, ":", 2.0)
GROUP = Line("group parity", colors.OPEN_LOOP, "-.")


class Picture:
    """A figure that can be folded: a PNG in HTML, elsewhere its title."""

    def __init__(self, figure) -> None:
        image, small = Image.open(io.BytesIO(figure._repr_png_())).convert("RGB"), io.BytesIO()
        image.quantize(32, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
        data = base64.b64encode(small.getvalue()).decode()
        self._address, self._title = f"data:image/png;base64,{data}", figure.get_suptitle()

    def __str__(self) -> str:
        return self._title

    def _repr_markdown_(self) -> str:
        return self._title

    def _repr_html_(self) -> str:
        return f'<img alt="{self._title}" src="{self._address}">'


def folded(title, *figures):
    """Figures behind a title; a click on it opens them."""
    return Folded(title, *map(Picture, figures))


def idea(sim, channel=0):
    """One range in the first run: its innovations, the AUKF's factor, and errors without and with
    adaptation.
    """
    c, S, known = sim.config, len(sim.satellites.names), filters(sim.config)

    def innovation(_epoch, _state, infos):
        first = infos[0]
        sigma = np.sqrt(np.square(first.sqrt_S).sum(-1))
        return {"e": first.innovation[..., channel], "sigma": sigma[..., channel]}

    tracks = {}
    for name in ("ukf", "aukf"):
        tracks[name] = celnav.run(known[name], sim.prior, sim.epochs(), also=innovation)
    t, (start, end) = c.times, c.burst_s
    shown = (t >= start - 5.0) & (t <= end + 10.0)
    t = t[shown]
    factor = noise_factors(tracks["aukf"], c, S)[shown, 0, channel]
    values = {name: track.extra for name, track in tracks.items()}
    e = values["aukf"]["e"][shown, 0]
    sigma = {name: 2.0 * extra["sigma"][shown, 0] for name, extra in values.items()}
    errors = {name: (track.mean - sim.truth)[shown, 0, :3] for name, track in tracks.items()}
    size = {name: np.linalg.norm(error, axis=-1) for name, error in errors.items()}

    def adapted(ax):
        wide = sigma["aukf"]
        band(ax, t, -wide, wide, color=colors.ESTIMATE, label="±2σ with adapted noise")

    noise = interval(start, end, "burst", colors.SIGMA)
    right = 1.0 + (c.burst_sigma / c.sigma_range_m) ** 2
    assumed = UKF._replace(label="±2σ with assumed noise")
    dots = {"color": colors.FAINT, "marker": ".", "linestyle": "", "markersize": 4.0}
    more = {"xmargin": 0.0, "xticks": np.arange(start - 5.0, end + 11.0, 5.0)}
    rows = [
        Panel(
            f"innovation of the range to {sim.satellites.names[channel]}",
            [
                noise,
                adapted,
                curve(t, sigma["ukf"], assumed),
                curve(t, -sigma["ukf"], assumed),
                curve(t, e, label="innovation", **dots),
            ],
            y="ε (m)",
            more=more,
        ),
        Panel(
            "factor of its noise variance",
            [
                noise,
                level(right, label=f"correct: {right:.0f}", color=colors.TRUTH),
                curve(t, factor, AUKF),
            ],
            y="A (-)",
            log="y",
            more=more,
        ),
        Panel(
            "position error",
            [noise, curve(t, size["ukf"], UKF), curve(t, size["aukf"], AUKF)],
            "time (s)",
            "error (m)",
            more=more,
        ),
    ]
    title = "Innovations that are too large raise the noise that the filter assumes"
    return panels(*rows, height=1.4, title=title, sharex=True)


def compared(cases):
    """Factors of the noise and position RMSE over time for each case: ``times``, then by filter
    ``factors`` and ``rmse``.
    """
    lines = {"UKF": UKF, "AUKF": AUKF, "true noise": TRUE, "group parity": GROUP}

    def pair(name, times, factors, rmse):
        more = {"xlim": (10.0, times[-1])}
        left = [curve(times, values, lines[key]) for key, values in factors.items()]
        right = [curve(times, rmse[key], line) for key, line in lines.items()]
        return [
            Panel(f"{name}: factor", left, "time (s)", "factor (-)", "y", more),
            Panel("position RMSE", right, "time (s)", "RMSE (m)", "y", more),
        ]

    rows = [pair(name, *values) for name, values in cases.items()]
    title = "The factor, and the factor there should be"
    return panels(*rows, height=1.6, title=title, sharex=True)
