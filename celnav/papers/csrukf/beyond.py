"""Claims on what the paper leaves out: consistency, bounds, sweeps, stress, sensors."""

from __future__ import annotations

import numpy as np

from celnav.claims import Claim
from celnav.linalg import Array
from celnav.papers.csrukf import theory
from celnav.papers.csrukf.judge import Judge, ratio3, rms3
from celnav.papers.csrukf.study import PHIS


def beyond_claims(j: Judge) -> list[Claim]:
    """Everything beyond the paper."""
    return [*_consistency(j), *_bounds(j), *_sweeps(j), *_stress(j), *_sensors(j)]


def _consistency(j: Judge) -> list[Claim]:
    out = []
    for name in ("0", "0.8", "I"):
        out.append(
            j.sampled(
                f"nees-csrukf-{name}",
                "beyond",
                f"Final NEES of CSRUKF at Phi = {name} (6 if consistent)",
                np.mean,
                [j.get(f"P/{name}", "csrukf/nees")[-1]],
                (5.0, 7.1),
            )
        )
        nis = j.get(f"P/{name}", "csrukf/nis")[1:].mean(0)
        out.append(
            j.sampled(
                f"nis-csrukf-{name}", "beyond", f"Mean NIS of CSRUKF at Phi = {name} (3 if consistent)", np.mean, [nis], (2.8, 3.2)
            )
        )
    for name, accept in (("0.8", (28.0, 55.0)), ("I", (5e3, None))):
        out.append(
            j.sampled(
                f"nees-srukf-{name}",
                "beyond",
                f"Final NEES of SRUKF at Phi = {name}: color destroys the covariance",
                np.mean,
                [j.get(f"P/{name}", "srukf/nees")[-1]],
                accept,
            )
        )
    fair, own = j.final("P/0.8", "srukf-reff"), j.final("P/0.8", "csrukf")
    out += [
        j.sampled(
            "reff-position",
            "beyond",
            "Phi = 0.8 I: SRUKF with R / (1 - 0.8)^2 is as good as CSRUKF (3-D ratio)",
            ratio3,
            [fair[:, :3], own[:, :3]],
            (0.9, 1.1),
        ),
        j.sampled("reff-nees", "beyond", "The same: final NEES", np.mean, [j.get("P/0.8", "srukf-reff/nees")[-1]], (4.8, 7.1)),
    ]
    return out


def _bounds(j: Judge) -> list[Claim]:
    expected, out = j.result.theory["P"], []
    for i, name in enumerate(("0", "0.8", "I")):
        bound = float(theory.position(expected.csrukf[-1, i]))
        out.append(
            j.sampled(
                f"pcrb-{name}",
                "beyond",
                f"Phi = {name}: final 3-D position RMSE of CSRUKF against the posterior Cramer-Rao bound",
                lambda e, b=bound: rms3(e) / b,
                [j.final(f"P/{name}", "csrukf")[:, :3]],
                (0.85, 1.15),
            )
        )
    exact = max(
        np.abs(j.get(f"P/{n}", "csrukf+z0/error") - j.get(f"P/{n}", "augmented/error"))[..., :3].max() * 1e3
        for n in ("0", "0.8", "I")
    )
    long = j.result.theory["long"]
    t = min(3000, len(long["srukf"]) - 1)
    return [
        *out,
        j.fixed(
            "exact-augmented",
            "beyond",
            "The single transform with the first sample equals the augmented filter (m, all Phi)",
            exact,
            (None, 1e-4),
        ),
        j.fixed(
            "exact-filterpy", "beyond", "SRUKF equals filterpy's UKF over one run (m)", j.result.facts["filterpy_m"], (None, 1e-5)
        ),
        j.fixed(
            "long-arc-walk",
            "beyond",
            "Phi = I, 3000 s, poor prior, first sample used: SRUKF against the bound (3-D)",
            long["srukf"][t, 0] / long["bound"][t, 0],
            (1.5, 2.5),
        ),
        j.fixed(
            "long-arc-mild",
            "beyond",
            "Phi = 0.8 I, 3000 s: ignoring the color costs nothing in accuracy (SRUKF against the bound)",
            long["srukf"][t, 1] / long["bound"][t, 1],
            (1.0, 1.05),
        ),
    ]


def _sweeps(j: Judge) -> list[Claim]:
    poor = {n: j.final("D/I", n)[:, :3] for n in ("srukf", "csrukf", "csrukf+z0")}
    sweep = j.result.theory["sweep/D"]
    walk = [float(theory.position(s[-1, -1])) for s in sweep[:3]]
    note = f"linear theory: SRUKF {walk[0]:.3g}, CSRUKF {walk[1]:.3g}, with the first sample {walk[2]:.3g} km"
    out = [
        j.sampled(
            "poor-prior-csrukf",
            "beyond",
            "Poor prior (10 km, 10 m/s), Phi = I: the paper's filter is worse than SRUKF (3-D ratio)",
            ratio3,
            [poor["csrukf"], poor["srukf"]],
            (1.3, None),
            note=note,
        ),
        j.sampled(
            "poor-prior-first-sample",
            "beyond",
            "The same with the first sample used: better than SRUKF (3-D ratio)",
            ratio3,
            [poor["csrukf+z0"], poor["srukf"]],
            (None, 0.85),
            note=note,
        ),
    ]
    for study, phi, accept, text in (
        ("wrong/I", "0.95", (50.0, None), "true I, assumed 0.95: underestimating Phi ruins consistency"),
        ("wrong/I", "0.99", (6.0, 12.0), "true I, assumed 0.99"),
        ("wrong/0.8", "1", (4.9, 7.3), "true 0.8, assumed I: overestimating Phi stays consistent"),
    ):
        nees = j.get(study, f"{phi}/nees")[1:].mean(0)
        out.append(j.sampled(f"wrong-phi-{study[6:]}-{phi}", "beyond", f"Time-mean NEES, {text}", np.mean, [nees], accept))
    cost = j.final("wrong/0.8", "1")[:, :3], j.final("wrong/0.8", "0.8")[:, :3]
    out.append(
        j.sampled(
            "wrong-phi-cost",
            "beyond",
            "True 0.8, assumed I: what overestimating costs in position (3-D ratio)",
            ratio3,
            list(cost),
            (2.0, 4.0),
        )
    )
    return out


def _stress(j: Judge) -> list[Claim]:
    half = len(j.get("stress/I", "srukf/error")) // 2

    def later(name: str, filter: str) -> Array:
        return np.asarray(np.sqrt(np.square(j.get(f"stress/{name}", f"{filter}/error")[half:, :, :3]).sum(-1).mean(0)))

    def ratio(a: Array, b: Array) -> float:
        return float(np.sqrt(np.mean(a**2) / np.mean(b**2)))

    def nees(name: str, filter: str) -> Array:
        return np.asarray(j.get(f"stress/{name}", f"{filter}/nees")[1:].mean(0))

    return [
        j.sampled(
            "stress-decorrelation",
            "beyond",
            "Strong process noise, Phi = I: without J the error grows (3-D position, second half)",
            ratio,
            [later("I", "without_correlation"), later("I", "csrukf")],
            (1.2, None),
        ),
        j.sampled(
            "stress-nees",
            "beyond",
            "Strong process noise, Phi = I: mean NEES of CSRUKF",
            np.mean,
            [nees("I", "csrukf")],
            (5.0, 7.0),
        ),
        j.sampled("stress-srukf-nees", "beyond", "The same of SRUKF", np.mean, [nees("I", "srukf")], (300.0, None)),
        j.sampled(
            "stress-printed-nees",
            "erratum",
            "The same with the printed roots",
            np.mean,
            [nees("I", "printed_roots")],
            (50.0, None),
            paper=6.0,
        ),
        j.sampled(
            "stress-redraw",
            "erratum",
            "Strong process noise, Phi = 0: reusing the points costs accuracy (3-D ratio)",
            ratio,
            [later("0", "no_redraw"), later("0", "srukf")],
            (1.005, 1.05),
            paper=1.0,
        ),
        j.sampled(
            "stress-lagged",
            "erratum",
            "Strong process noise, Phi = 0: the lagged estimate is a smoothed one (3-D ratio to the filter)",
            ratio,
            [np.sqrt(np.square(j.get("stress/0", "lagged/error")[half:, :, :3]).sum(-1).mean(0)), later("0", "csrukf")],
            (0.8, 0.95),
            paper=1.0,
        ),
    ]


def _sensors(j: Judge) -> list[Claim]:
    out = []
    for phi, name in zip(PHIS, ("0", "0.8", "I"), strict=True):
        a, b = (j.final(f"sensor/P/{name}", f"csrukf-{r}")[:, :3] for r in ("jacobian", "isotropic"))
        accept = (0.85, 1.0) if phi < 1.0 else (0.95, 1.05)
        out.append(
            j.sampled(
                f"sensor-anisotropy-{name}",
                "beyond",
                f"Angles measured, Phi = {name}: the true covariance of the pseudo-position against an isotropic one (3-D ratio)",
                ratio3,
                [a, b],
                accept,
            )
        )
    a, b = (j.final("sensor/D/0", n)[:, :3] for n in ("angles", "csrukf-jacobian"))
    out.append(
        j.sampled(
            "sensor-angles-white",
            "beyond",
            "Poor prior, white noise: angles used directly are as good as converted ones (3-D ratio)",
            ratio3,
            [a, b],
            (0.97, 1.03),
        )
    )
    a, b = (j.final("sensor/D/I", n)[:, :3] for n in ("angles", "csrukf-isotropic"))
    out.append(
        j.sampled(
            "erratum-23-angle-space",
            "erratum",
            "Noise that walks in angle space must be whitened there: 3-D error against whitening "
            "pseudo-positions, poor prior, Phi = I",
            ratio3,
            [a, b],
            (None, 0.95),
            paper=1.0,
        )
    )
    return out
