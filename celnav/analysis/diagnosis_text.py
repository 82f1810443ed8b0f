"""A diagnosis in plain words."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

__all__ = ["page"]

TELLS = 3.0  # of a log-likelihood, that one explanation is better by
WIDTH = 110

if TYPE_CHECKING:
    from celnav.analysis.diagnose import Component, Diagnosis, Model, Sensed


def page(found: Diagnosis) -> str:
    """A table of the components, then what it means: size, bias, whiteness, and the noise that would explain it."""
    T, t = len(found.times), found.times
    spaced = (
        "at irregular times: a lag is an epoch"
        if found.step is None
        else f"{found.step:.6g} s apart"
    )
    runs = "one run" if found.runs == 1 else f"{found.runs} runs"
    missing = found.runs * T * len(found.components) - sum(c.samples for c in found.components)
    gaps = f"; {missing} components missing" if missing else ""
    said = [("size", _size(sensor, found)) for sensor in found.sensors]
    said += [("bias", line) for line in _bias(found)] + [("white", line) for line in _white(found)]
    if found.model is not None:
        said += [("take", line) for line in _taken(found.model, found.level)]
    else:
        said += [
            ("noise", line)
            for c in found.components
            if found.white(c) == "colored"
            for line in _noise(c, found)
        ]
        said += [("take", found.why)] if found.why else []
    lines = [
        textwrap.fill(f"{head:8} {line}", WIDTH, subsequent_indent=9 * " ") for head, line in said
    ]
    return "\n".join(
        [
            f"{runs}, {T} epochs over {t[-1] - t[0]:.6g} s, {spaced}{gaps}",
            "",
            *_table(found),
            "",
            *lines,
        ]
    )


def _table(found: Diagnosis) -> list[str]:
    lag, percent = (
        "lag 1" if found.step is None else f"{found.step:.4g} s",
        f"({100 * found.level:.3g} %)",
    )
    rows = [
        [
            "component",
            "samples",
            "rms",
            "claimed",
            "mean",
            percent,
            f"correlation at {lag}",
            "p if white",
        ]
    ]
    for c in found.components:
        claimed, (low, high) = "-" if c.claimed is None else f"{c.claimed:.4g}", c.bias_interval
        correlation = f"{c.autocorrelation[0]:.3f} (white: ±{c.band[0]:.3f})"
        rows.append(
            [
                c.name,
                str(c.samples),
                f"{c.rms:.4g}",
                claimed,
                f"{c.bias:.3g}",
                f"{low:.3g} to {high:.3g}",
                correlation,
                _p(c.p),
            ]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            [
                row[0].ljust(widths[0]),
                *(x.rjust(n) for x, n in zip(row[1:], widths[1:], strict=True)),
            ]
        )
        for row in rows
    ]


def _p(p: float) -> str:
    return "< 1e-15" if p < 1e-15 else f"{p:.2g}"


def _size(sensor: Sensed, found: Diagnosis) -> str:
    names, (low, high) = ", ".join(sensor.names), sensor.band
    sizes = [
        f"{c.name} {np.sqrt(c.size):.3g}"
        for c in found.components
        if c.name in sensor.names and c.size is not None
    ]
    if np.isnan(sensor.nis):
        return f"{names}: no deviations are claimed, so nothing is said of it"
    said = "" if low <= sensor.nis <= high else f"{np.sqrt(sensor.nis):.3g} times "
    band = f"{low:.3g} to {high:.3g} ({100 * found.level:.3g} %, correlation counted) if claims are right"
    each = f" ({', '.join(sizes)})" if len(sizes) > 1 else ""
    return f"{names}: {said}as large as claimed{each}; NIS over its degrees of freedom is {sensor.nis:.3g}, {band}"


def _bias(found: Diagnosis) -> list[str]:
    lines, clean = [], ", ".join(c.name for c in found.components if not found.biased(c))
    for c in (c for c in found.components if found.biased(c)):
        known = (
            f"a mean of {c.samples} samples is known as one of {c.effective:.0f} independent ones"
        )
        low, high = c.bias_interval
        lines.append(
            f"{c.name}: {c.bias:.3g} ({low:.3g} to {high:.3g}), {abs(c.bias) / c.rms:.0%} of its rms; {known}"
        )
    return lines + ([f"{clean}: none to be seen"] if clean else [])


def _white(found: Diagnosis) -> list[str]:
    lines, answers = (
        [],
        {
            "white": "yes",
            "nearly white": "nearly: detectably not, to little effect",
            "colored": "no",
        },
    )
    for verdict, c in sorted(
        ((found.white(c), c) for c in found.components),
        key=lambda pair: list(answers).index(pair[0]),
    ):
        out = int((np.abs(c.autocorrelation) > c.band).sum())
        test = f"Ljung-Box {c.ljung_box:.4g} of {len(c.band)} lags, p {_p(c.p)}; {out} lags beyond the band"
        effect = (
            ""
            if verdict == "white"
            else f"; a mean of it is {c.longer:.3g} times as uncertain as one of white noise"
        )
        lines.append(f"{c.name}: {answers[verdict]} ({test}){effect}")
    return lines


def _noise(c: Component, found: Diagnosis) -> list[str]:
    fit, percent = c.coloring, f"{100 * found.level:.3g} %"
    assert fit is not None
    (low, high), (least, most) = fit.phi_interval, fit.sigma_interval
    slow = found.step is not None and 0.0 < fit.phi < 1.0
    time = f", a correlation time of {-found.step / np.log(fit.phi):.3g} s," if slow else ""  # type: ignore[operator]
    rest = (
        "leaves white noise over"
        if fit.rest_p >= found.doubt
        else "does not explain all: what it leaves over is not white"
    )
    lines = [f"{c.name}: a first-order noise {rest} (p {_p(fit.rest_p)})"]
    if c.size is not None and c.claimed is None:  # innovations are not the noise itself
        return [
            f"{c.name}: Phi of the innovations is {fit.phi:.3f} ({low:.3f} to {high:.3f}, {percent}){time.rstrip(',')}",
            *lines,
        ]
    R, sigma = f"{fit.sigma**2:.4g}", f"{fit.sigma:.4g} ({least:.4g} to {most:.4g})"
    claim, white = (fit.sigma / np.sqrt(n) for n in (c.effective, c.samples))
    take = f"celnav.colored(motion, sensor, Phi=[[{fit.phi:.3f}]]) with R=[[{R}]]"
    return [
        f"{c.name}: Phi = {fit.phi:.3f} ({low:.3f} to {high:.3f}, {percent}){time} and R = {R}, a deviation of {sigma}",
        *lines,
        f"{c.name}: take {take}: of the mean of these samples it would claim {claim:.3g} instead of {white:.3g}",
    ]


def _taken(model: Model, level: float) -> list[str]:
    phi, R = ", ".join(f"{x:.3f}" for x in model.Phi.diagonal()), model.R
    plain = np.array_equal(R, np.diag(R.diagonal()))
    noise = (
        f"np.diag([{', '.join(f'{x:.4g}' for x in R.diagonal())}])"
        if plain
        else f"np.array({np.round(R, 12).tolist()})"
    )
    claims, before = (
        ", ".join(f"{x:.3g}" for x in part) for part in (model.claims, model.white_claims)
    )
    ends = [
        ", ".join(f"{a:.4g} to {b:.4g}" for a, b in part)
        for part in (model.phi_interval, model.sigma_interval)
    ]
    told = model.gain > model.white_gain + TELLS
    other = "it is color" if told else "these data do not tell color from wrong dynamics"
    lines = [
        f"celnav.colored(motion, sensor, Phi=np.diag([{phi}])) with R={noise}: at the end it would claim deviations of {claims} "
        f"instead of {before}",
        f"Phi lies in {ends[0]}, the deviations of its noise in {ends[1]} ({100 * level:.3g} %)",
        f"the log-likelihood grows by {model.gain:.4g} with it, by {model.white_gain:.4g} with other Q and R alone: {other}",
    ]
    return (
        lines
        if model.converged
        else [*lines, "the likelihood has no clear maximum there: take these numbers with care"]
    )
