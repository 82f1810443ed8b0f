"""What is judged, from the numbers of this very run: figures here, Tables 4 and 5, errata and the rest in ``claims_*``."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import ratio, rms
from celnav.models.pulsar import LIGHT_KM_S
from celnav.papers.tstdkf.claims_beyond import beyond_claims
from celnav.papers.tstdkf.claims_errata import errata_claims
from celnav.papers.tstdkf.claims_tables import table_claims
from celnav.papers.tstdkf.claims_tracking import figure_9, figure_10
from celnav.papers.tstdkf.config import TABLE_5
from celnav.papers.tstdkf.ephemerides import table
from celnav.papers.tstdkf.evidence import AXES, Evidence
from celnav.papers.tstdkf.study import Result
from celnav.papers.tstdkf.sweeps import LARGER, WHITE_LARGER, WHITE_NONE
from celnav.study.claims import Claim, about, within

INFERRED = "with parameters that were inferred or chosen"


def claims(result: Result) -> list[Claim]:
    """All claims, in the order of the paper, then its errata and what it leaves out."""
    j = Evidence(result)
    return [
        *_figures_1_and_2(j), *_figures_3_and_4(j), *_figures_5_and_6(j), *_figures_7_and_8(j), *figure_9(j), *figure_10(j),
        *table_claims(j), *errata_claims(j), *beyond_claims(j),
    ]  # fmt: skip


def _figures_1_and_2(j: Evidence) -> list[Claim]:
    g, out = j.result.facts["geometry"], []
    text = "Fig. 1: delay of the first pulsar against the drawn vectors with parallax and Shapiro terms (µs)"
    apart = abs(g.delay - g.roemer - g.parallax - g.shapiro) / LIGHT_KM_S * 1e6
    out.append(j.number("figure-1-delay", "paper", text, apart, (None, 1.0)))
    text = "Fig. 2: DE421 as installed against that of the arrays (km)"
    out.append(j.number("figure-2-same", "paper", text, table().apart, (None, 1e-6)))
    earth = table().less_de421["de405"]["earth"]
    rows = {
        "min": (earth.min(0), (-0.5606, -0.3954, -0.8366)),
        "max": (earth.max(0), (0.8037, 1.6712, 1.4104)),
        "first": (earth[0], (-0.1004, 1.6063, -0.4490)),
        "last": (earth[-1], (-0.2636, 1.6712, -0.3754)),
    }
    for name, (values, wanted) in rows.items():
        for axis, value, near in zip(AXES, values, wanted, strict=True):
            text = f"Fig. 2: DE405 - DE421 of the Earth, {axis}, {name} (km)"
            out.append(j.number(f"figure-2-{name}-{axis}", "paper", text, value, within(near, 5e-4)))
    norm = np.linalg.norm(earth, axis=1)
    for name, value, near in (("least", norm.min(), 0.1819), ("largest", norm.max(), 1.7419)):
        text = f"Fig. 2: {name} norm of DE405 - DE421 (km)"
        out.append(j.number(f"figure-2-norm-{name}", "paper", text, value, within(near, 5e-4)))
    text = "Fig. 2: what a constant, a drift, a yearly and a half-yearly wave leave (m, RMS of the worst axis)"
    out.append(j.number("figure-2-fit", "beyond", text, 1e3 * j.result.facts["fit"].max(), (None, 0.65)))
    return out + _figure_2b(j)


def _figure_2b(j: Evidence) -> list[Claim]:
    less, out = table().less_de421, []
    norm = np.linalg.norm(less["de423"]["earth"], axis=1)
    sun = less["de405"]["sun"]
    heliocentric = np.linalg.norm(less["de405"]["earth"] - sun, axis=1)
    rows = (
        ("de423", "DE423 - DE421 of the Earth, norm", norm, 0.3027, 0.4316),
        ("sun", "DE405 - DE421 of the Sun, y", sun[:, 1], 0.593, 0.649),
        ("heliocentric", "DE405 - DE421 of the Earth from the Sun, norm", heliocentric, 0.712, 1.511),
    )
    for id, text, values, low, high in rows:
        digits = 5e-5 if id == "de423" else 5e-4
        for end, value, near in (("least", values.min(), low), ("largest", values.max(), high)):
            out.append(
                j.number(f"figure-2b-{id}-{end}", "beyond", f"Fig. 2b: {text}, {end} (km)", value, within(near, 2.0 * digits))
            )
    apart = np.linalg.norm(less["de405"]["earth"] - less["de406"]["earth"], axis=1).max()
    text = "Fig. 2b: DE406 is a compressed DE405: largest difference (km)"
    out.append(j.number("figure-2b-de406", "beyond", text, apart, (None, 0.01855)))
    return out


def _figures_3_and_4(j: Evidence) -> list[Claim]:
    out = []
    for number, what, unit, scale, here, large in (
        (3, "position", "km", 1.0, within(0.177, 0.01), within(1.16, 0.06)),
        (4, "velocity", "m/s", 1e3, within(0.121, 0.01), within(0.77, 0.05)),
    ):
        white = j.squares("ekf", what, 5) * scale**2
        text = f"Fig. {number}: EKF, white noise, ephemeris error: {what} RMSE of the month ({unit})"
        out.append(j.lengthy(f"figure-{number}-ekf", "calibrated", text, rms, [white], here, note=INFERRED))
        larger = j.of("parameters", f"{WHITE_LARGER}/ekf/{what}") * scale**2
        text = f"Fig. {number}: the same with the ephemeris error {LARGER:.3g} times as large ({unit})"
        out.append(j.lengthy(f"figure-{number}-larger", "calibrated", text, rms, [larger], large))
    both = [j.squares("ekf", "position", 5), j.squares("tkf", "position", 5)]
    text = "Fig. 3: it is dominated by the bias: EKF to TKF (ratio)"
    out.append(j.lengthy("figure-3-dominated", "calibrated", text, ratio, both, (3.5, None)))
    times = TABLE_5.step_s * np.arange(1, j.result.config.steps + 1)
    bias = LARGER * np.sqrt(np.square(j.result.config.bias(times)).sum(1).mean())
    text = "Fig. 3: the position's RMSE to the bias that causes it, both larger (ratio)"
    larger = j.of("parameters", f"{WHITE_LARGER}/ekf/position")
    out.append(j.lengthy("figure-3-ratio", "calibrated", text, lambda s: rms(s) / bias, [larger], within(1.3, 0.1)))
    text = "Fig. 4: EKF, white noise, no ephemeris error: velocity RMSE (m/s)"
    none = j.of("parameters", f"{WHITE_NONE}/ekf/velocity") * 1e6
    out.append(j.lengthy("figure-4-none", "calibrated", text, rms, [none], (None, 0.05)))
    return out


def _figures_5_and_6(j: Evidence) -> list[Claim]:
    c, out = j.result.config, []
    t = np.linspace(0.0, 365.25 * 86400.0, 20001)
    turning = np.asarray(c.amplitude_km) * np.exp(1j * (2.0 * np.pi * t[:, None] / t[-1] + np.asarray(c.phase))).imag
    text = "Fig. 5: ephemeris error against Eq. 17 as the imaginary part of a rotation (km)"
    out.append(j.number("figure-5-same", "calibrated", text, np.abs(c.bias(t) - turning).max(), (None, 1e-12), note=INFERRED))
    for axis, value, near in zip(AXES, np.abs(c.bias(t)).max(0), (0.09, 0.12, 0.075), strict=True):
        text = f"Fig. 5: largest ephemeris error of a year, {axis} (km)"
        out.append(j.number(f"figure-5-{axis}", "calibrated", text, value, about(near, 1e-6)))
    model = j.result.facts["model error"]
    text = "Fig. 6: Γ δr against the difference of delays (km; a delay has seven digits behind the point)"
    out.append(j.number("figure-6-same", "calibrated", text, model.apart, (None, 1e-7)))
    text = "Fig. 6: by how much the rows of Γ are longer than 1"
    out.append(j.number("figure-6-rows", "calibrated", text, model.excess, (0.0, 1e-7)))
    return out


LARGEST_PULLS = {
    "moon": 1.55e-9, "sun": 5.69e-10, "venus": 4.7e-15, "jupiter": 2.6e-15, "saturn": 1.3e-16, "mercury": 8.8e-17,
    "mars": 1.7e-17, "uranus": 3.6e-18, "neptune": 1.1e-18, "pluto": 1.1e-22,
}  # fmt: skip
"""km/s^2, over the month."""


def _figures_7_and_8(j: Evidence) -> list[Claim]:
    pulls, lines, out = j.result.facts["pulls"], j.result.facts["spectrum"], []
    total = np.asarray(sum(pulls.values()))
    sizes = {"RMS": np.sqrt(np.square(total).mean(0)), "largest": np.abs(total).max(0)}
    wanted = {"RMS": (6.92e-10, 6.82e-10, 4.20e-10), "largest": (19.5e-10, 15.4e-10, 9.2e-10)}
    for name, values in sizes.items():
        for axis, value, near in zip(AXES, values, wanted[name], strict=True):
            text = f"Fig. 7: acceleration by third bodies, {axis}, {name} of the month (km/s²)"
            out.append(j.whole(j.number(f"figure-7-{name.lower()}-{axis}", "calibrated", text, value, about(near, 0.01))))
    for body, near in LARGEST_PULLS.items():
        value = np.linalg.norm(pulls[body], axis=1).max()
        text = f"Fig. 7: largest acceleration by {body.capitalize()} (km/s²)"
        rounding = 0.5 * 10.0 ** np.floor(np.log10(near) - (2 if near > 1e-10 else 1)) / near
        out.append(j.whole(j.number(f"figure-7-{body}", "calibrated", text, value, about(near, max(0.01, 1.01 * rounding)))))
    for i, axis in enumerate(AXES):
        text = f"Fig. 8: strongest line, {axis} (cycles/day)"
        out.append(j.whole(j.number(f"figure-8-line-{axis}", "calibrated", text, lines.strongest(i), (14.33, 14.40))))
    second = max(range(3), key=lambda i: lines.power[lines.cycles > 20.0, i].max())
    text = "Fig. 8: strongest line beyond 20 cycles/day (a thirtieth apart)"
    out.append(j.whole(j.number("figure-8-second", "calibrated", text, lines.strongest(second, 20.0), (28.68, 28.82))))
    text = "Fig. 8: power in the strongest hundredth of the frequencies, least axis"
    out.append(j.whole(j.number("figure-8-power", "calibrated", text, lines.concentrated().min(), (0.9999, 1.0))))
    for axis, value in zip(AXES, lines.correlation, strict=True):
        text = f"Fig. 8: correlation of a sample with the next, {axis}"
        out.append(j.whole(j.number(f"figure-8-correlation-{axis}", "calibrated", text, value, within(0.951, 0.002))))
    return out
