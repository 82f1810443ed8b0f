"""A diagnosis as text."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

__all__ = ["WIDTH", "consistency", "laid_out", "page"]

WIDTH = 110

if TYPE_CHECKING:
    from celnav.analysis.diagnose import Component, Diagnosis, Factors, Model


def page(diagnosis: Diagnosis, width: int = WIDTH) -> str:
    """The diagnosis as text: a table of the components, then size, bias, whiteness, and the fitted
    noise.
    """
    T, t = len(diagnosis.times), diagnosis.times
    spaced = "at irregular times" if diagnosis.step is None else f"{diagnosis.step:.6g} s apart"
    runs = "one run" if diagnosis.runs == 1 else f"{diagnosis.runs} runs"
    missing = diagnosis.runs * T * len(diagnosis.components) - sum(
        c.samples for c in diagnosis.components
    )
    gaps = f"; {missing} components missing" if missing else ""
    said = [("wrap", line) for line in diagnosis.wraps]
    said += [("size", _size(k, diagnosis)) for k in range(len(diagnosis.sensors))]
    said += [("bias", line) for line in _bias(diagnosis)] + [
        ("white", line) for line in _white(diagnosis)
    ]
    if diagnosis.model is not None:
        said += [("model", line) for line in _fitted(diagnosis.model, diagnosis)]
    else:
        colored = [c for c in diagnosis.components if diagnosis.white(c) == "colored"]
        said += [line for c in colored for line in _noise(c, diagnosis) if not diagnosis.wraps]
        said += [("model", diagnosis.why)] if diagnosis.why else []
    head = f"{runs}, {T} epochs over {t[-1] - t[0]:.6g} s, {spaced}{gaps}"
    return laid_out(head, _table(diagnosis), said, width)


def laid_out(
    head: str,
    table: Sequence[Sequence[str]],
    said: Iterable[tuple[str, str]],
    width: int = WIDTH,
) -> str:
    """Text with a first line, a table, and lines that start with a keyword.

    The first column of the table is left-aligned. A table wider than ``width`` is transposed.
    """
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    if sum(widths) + 2 * len(widths) - 2 > width:
        table = list(zip(*table, strict=True))
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    rows = [
        [row[0].ljust(widths[0]), *(x.rjust(n) for x, n in zip(row[1:], widths[1:], strict=True))]
        for row in table
    ]
    lines = [_filled(f"{word:8} {line}", width) for word, line in said]
    return "\n".join([head, "", *map("  ".join, rows), "", *lines])


def consistency(ratio: float, band: tuple[float, float]) -> str:
    """Return "consistent", "overconfident" or "conservative", for a ratio that is 1 if consistent,
    and its band.
    """
    if ratio > band[1]:
        return "overconfident"
    return "conservative" if ratio < band[0] else "consistent"


def _filled(line: str, width: int) -> str:
    """Wrap a line at ``width`` columns, but not between a number and its unit."""
    protected = re.sub(r"(?<=\d) (?=%|s\b)", "\0", line)
    filled = textwrap.fill(protected, width, subsequent_indent=9 * " ", break_on_hyphens=False)
    return filled.replace("\0", " ")


def _table(diagnosis: Diagnosis) -> list[list[str]]:
    rows = [
        [
            "component",
            "samples",
            "rms",
            "predicted σ",
            "mean",
            f"({100 * diagnosis.level:.3g} %)",
            "lag 1",
            "correlation at lag 1",
            "p if white",
        ]
    ]
    for c in diagnosis.components:
        low, high = c.bias_interval
        has_pairs = np.isfinite(c.band[0])
        rows.append(
            [
                c.name,
                str(c.samples),
                f"{c.rms:.4g}",
                "-" if c.predicted is None else f"{c.predicted:.4g}",
                f"{c.bias:.3g}",
                f"{low:.3g} to {high:.3g}",
                _lag(c),
                f"{c.autocorrelation[0]:.3f} (white: ±{c.band[0]:.3f})"
                if has_pairs
                else "no pairs",
                _p(c.p),
            ]
        )
    return rows


def _lag(c: Component) -> str:
    return "1 sample" if c.step is None else f"{c.step:.4g} s"


def _plain(x: float, digits: int) -> str:
    return np.format_float_positional(x, precision=digits, unique=False, fractional=False, trim="-")


def _p(p: float) -> str:
    return "-" if np.isnan(p) else "< 1e-15" if p < 1e-15 else f"{p:.2g}"


def _size(k: int, diagnosis: Diagnosis) -> str:
    sensor = diagnosis.sensors[k]
    names = ", ".join(sensor.names)
    if np.isnan(sensor.nis):
        return f"{names}: no predicted σ is given, so nothing is said of the size"
    sizes = [
        f"{c.name} {np.sqrt(c.size):.3g}"
        for c in diagnosis.components
        if c.sensor == k and c.size is not None
    ]
    detail = f" ({', '.join(sizes)})" if len(sizes) > 1 else ""
    low, high = sensor.band
    return (
        f"{names}: {_verdict(k, diagnosis)}{detail}; NIS per degree of freedom is "
        f"{_plain(sensor.nis, 3)}, expected {low:.3g} to {high:.3g} "
        f"({100 * diagnosis.level:.3g} %, correlation counted)"
    )


def _verdict(k: int, diagnosis: Diagnosis) -> str:
    """Size of the innovations in words; small but correlated innovations are not called
    conservative.
    """
    nis, word = (
        diagnosis.sensors[k].nis,
        consistency(diagnosis.sensors[k].nis, diagnosis.sensors[k].band),
    )
    if word == "consistent":
        return "as large as predicted"
    white = all(diagnosis.white(c) != "colored" for c in diagnosis.components if c.sensor == k)
    named = f"{word}, " if white or word == "overconfident" else ""
    return f"{named}{_plain(np.sqrt(nis), 3)} times as large as predicted"


def _bias(diagnosis: Diagnosis) -> list[str]:
    unbiased = ", ".join(c.name for c in diagnosis.components if not diagnosis.biased(c))
    lines = [
        f"{c.name}: {c.bias:.3g} ({c.bias_interval[0]:.3g} to {c.bias_interval[1]:.3g}), "
        f"{abs(c.bias) / c.rms:.0%} of its rms; its {c.samples} samples count as {c.effective:.0f} "
        "independent ones"
        for c in diagnosis.components
        if diagnosis.biased(c)
    ]
    return lines + ([f"{unbiased}: none detected"] if unbiased else [])


ANSWERS = {
    "white": "yes",
    "nearly white": "nearly: detectably not, to little effect",
    "colored": "no",
}


def _white(diagnosis: Diagnosis) -> list[str]:
    order = [*ANSWERS, "unknown"]
    lines = []
    for verdict, c in sorted(
        ((diagnosis.white(c), c) for c in diagnosis.components),
        key=lambda pair: order.index(pair[0]),
    ):
        lags = int(np.isfinite(c.band).sum())
        if verdict == "unknown":
            lines.append(
                f"{c.name}: cannot tell: too few pairs of its samples lie within {len(c.band)} lags"
                f" of {_lag(c)}; bias and size assume independent samples"
            )
            continue
        out = int((np.abs(c.autocorrelation) > c.band).sum())
        test = (
            f"Ljung-Box {_plain(c.ljung_box, 4)} of {lags} lags of {_lag(c)}, p {_p(c.p)}; "
            f"{out} beyond the band"
        )
        effect = f"; σ of its mean is {c.longer:.3g} times that of white noise"
        lines.append(f"{c.name}: {ANSWERS[verdict]} ({test}){effect * (verdict != 'white')}")
    return lines


def _noise(c: Component, diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Lines on the first-order noise, the mixture with white noise if needed, and advice."""
    fit, percent = c.coloring, f"{100 * diagnosis.level:.3g} %"
    assert fit is not None
    (low, high), (least, most) = fit.phi_interval, fit.sigma_interval
    time = ""
    if c.step is not None and 0.0 < fit.phi < 1.0:
        time = f", a correlation time of {-c.step / np.log(fit.phi):.3g} s"
    innovations = c.size is not None and c.predicted is None  # not the noise itself
    size = "" if innovations else f", σ = {fit.sigma:.4g} ({least:.4g} to {most:.4g})"
    of = "of its innovations " if innovations else ""
    lines = [
        f"Phi {of}from sample to sample = {_coefficient(fit.phi)} "
        f"({_coefficient(low)} to {_coefficient(high)}, {percent})"
        f"{time}{size}"
    ]
    accepted, mixture = fit.p >= diagnosis.doubt, fit.mixture
    lines.append(f"first-order noise is {_judged(fit.p, accepted)}")
    if not accepted and mixture is not None:
        lines.append(
            "with white noise beside it, it is "
            f"{_judged(mixture.p, mixture.p >= diagnosis.doubt)}; "
            f"the log-likelihood grows by {_plain(mixture.gain, 4)}"
        )
    said = [("noise", f"{c.name}: {line}") for line in lines]
    return said if innovations else [*said, ("model", f"{c.name}: {_advice(c, diagnosis)}")]


def _judged(p: float, accepted: bool) -> str:
    verdict, are = ("accepted", "are") if accepted else ("rejected", "are not")
    return f"{verdict}: its innovations {are} white (p {_p(p)})"


def _advice(c: Component, diagnosis: Diagnosis) -> str:
    fit = c.coloring
    assert fit is not None
    white = f"white noise {fit.sigma / np.sqrt(c.samples):.3g}"
    spaced = "" if c.step == diagnosis.step or c.step is None else f", an epoch each {c.step:.4g} s"
    filter = f"celnav.colored(motion, sensor, Phi=[[{_coefficient(fit.phi)}]])"
    filter = f"{filter} with R=[[{fit.sigma**2:.4g}]]{spaced}"
    mean = f"for the mean of these samples it predicts σ = {fit.mean_sigma:.3g}"
    if fit.p >= diagnosis.doubt:
        return f"suggested: {filter}; {mean}, {white}"
    mixture = fit.mixture
    if mixture is not None and mixture.p >= diagnosis.doubt:
        driving = mixture.sigma**2 * (1.0 - mixture.phi**2)
        return (
            f"suggested: a state V' = {_coefficient(mixture.phi)} V + zeta{spaced}, zeta of "
            f"variance {driving:.4g} and V of {mixture.sigma**2:.4g}, measured as h(x) + V with "
            f"R=[[{mixture.white_sigma**2:.4g}]]; for the mean of these samples it predicts σ = "
            f"{mixture.mean_sigma:.3g}, the first-order noise alone {fit.mean_sigma:.3g}, {white}"
        )
    measured = f"{fit.sigma / np.sqrt(c.effective):.3g}"
    return (
        f"none suggested; {filter}: {mean}, {white}, the autocorrelation of the samples {measured}"
    )


def _fitted(model: Model, diagnosis: Diagnosis) -> list[str]:
    """Lines on the filter fitted to the track's data, or other Q and R, and on its reliability."""
    factors, name = model.factors, f"celnav.{model.name}"
    grows = f"the log-likelihood grows by {_plain(model.gain, 4)} with it"
    if factors is None:
        lines, compared = [], f"other Q and R alone were not compared ({model.not_compared})"
    else:
        # Colored noise that is the better explanation, and is determined, stands alone.
        alone = model.is_color and not model.degenerate
        lines = [] if alone else _scaled(factors, model, diagnosis)
        compared = f"by {_plain(factors.gain, 4)} with other Q and R alone"
    if model.degenerate:
        left_out = (
            f"{name} is left out: the likelihood has no clear maximum in Phi and R "
            f"({model.degenerate}); {grows}"
        )
        return [*lines, left_out if lines else f"{left_out}; {compared}"]
    if model.is_white:
        return [*lines, f"{name} is not suggested: {grows}, {compared}"]
    if factors is None:
        compared = f"{grows}; {compared}"
    elif model.is_color:
        compared = f"{grows}, {compared}: the noise is colored"
    else:
        compared = f"{grows}, {compared}: these data do not distinguish color from wrong dynamics"
    return [*lines, *_colored(model, compared, diagnosis)]


def _scaled(factors: Factors, model: Model, diagnosis: Diagnosis) -> list[str]:
    """Lines on the original filter with other Q and R."""
    rest = not (factors.p < diagnosis.doubt).any()
    suggested = rest and not factors.degenerate and model.is_white
    (a, b), (c, d) = factors.Q_interval, factors.R_interval
    lines = [
        f"{'suggested' if suggested else 'fitted, not suggested'}: the given filter with Q times "
        f"{factors.Q:.4g} and R times {factors.R:.4g}; at the end it predicts σ = "
        f"{_listed(factors.predicted)}, the given filter {_listed(model.white_predicted)}",
        f"the factor of Q lies in {a:.4g} to {b:.4g}, that of R in {c:.4g} to {d:.4g} "
        f"({100 * diagnosis.level:.3g} %)",
        f"the log-likelihood grows by {_plain(factors.gain, 4)} with them; "
        f"{_rest(rest, factors.p)}",
    ]
    if factors.degenerate:
        lines[1] = f"the likelihood has no clear maximum there ({factors.degenerate})"
    return lines


def _listed(values: Iterable[float]) -> str:
    return ", ".join(f"{x:.3g}" for x in values)


def _rest(white: bool, p: Iterable[float]) -> str:
    return (
        f"its innovations are {'white' if white else 'still not white'} (p {', '.join(map(_p, p))})"
    )


def _colored(model: Model, compared: str, diagnosis: Diagnosis) -> list[str]:
    """Lines on the filter for colored noise."""
    phi, R = ", ".join(map(_coefficient, model.Phi.diagonal())), model.R
    diagonal = np.array_equal(R, np.diag(R.diagonal()))
    noise = (
        f"np.diag([{', '.join(f'{x:.4g}' for x in R.diagonal())}])"
        if diagonal
        else f"np.array({[[float(f'{x:.4g}') for x in row] for row in R]})"
    )
    ends = [
        ", ".join(f"{a:.4g} to {b:.4g}" for a, b in values)
        for values in (model.phi_interval, model.sigma_interval)
    ]
    rest = not (model.p < diagnosis.doubt).any()
    suggested = model.is_color and rest
    return [
        f"{'suggested' if suggested else 'fitted, not suggested'}: "
        f"celnav.{model.name}(motion, sensor, Phi=np.diag([{phi}])) with R={noise}; at the end it "
        f"predicts σ = {_listed(model.predicted)}, the given filter "
        f"{_listed(model.white_predicted)}",
        f"Phi lies in {ends[0]}, σ of its noise in {ends[1]} ({100 * diagnosis.level:.3g} %)",
        compared,
        _rest(rest, model.p),
    ]


def _coefficient(phi: float) -> str:
    """A coefficient, with three digits of its distance to 1."""
    distance = 1.0 - abs(phi) or 1.0
    return f"{phi:.{max(3, 2 - int(np.floor(np.log10(distance))))}f}"
