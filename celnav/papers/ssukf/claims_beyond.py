"""Claims on what the paper leaves out: identities, exact theory, consistency, a scenario that separates filters, what is lost."""

from __future__ import annotations

import numpy as np

from celnav.analysis.metrics import ratio, rms
from celnav.gaussian.linalg import Array
from celnav.models.gyro import Gyro, steady_state
from celnav.papers.ssukf.checks import ALPHAS, COMPARED, PRIORS_DEG
from celnav.papers.ssukf.config import ARCSEC, DEG_PER_H
from celnav.papers.ssukf.draws import CORRELATIONS
from celnav.papers.ssukf.evidence import ATTITUDE, Evidence
from celnav.papers.ssukf.theory import EPOCHS_S, limit
from celnav.study.claims import Bounds, Claim, order


def beyond_claims(j: Evidence) -> list[Claim]:
    """Everything beyond the paper."""
    parts = (_identities, _rates, _variants, _exact, _settled, _consistency, _vector, _lost, _sensitivity, _total)
    return [claim for part in parts for claim in part(j)]


def _identities(j: Evidence) -> list[Claim]:
    """The same filter in several guises, at 100 Hz unless said otherwise; in square-root form."""
    out = []
    pairs: tuple[tuple[str, str, Bounds, Bounds], ...] = (
        ("ssukf, c = 15", "AUKF and SSUKF at equal spread c = 15", (None, 1e-9), (None, 1e-11)),
        ("ssukf, c = 7", "AUKF and SSUKF at equal spread c = 7", (None, 1e-7), (None, 1e-8)),
        ("ssukf, c = 0.15", "AUKF and SSUKF at equal spread c = 0.15", (None, 1e-7), (None, 1e-8)),
        ("ssukf, alpha = 0.1", "AUKF and SSUKF with the paper's scaling, alpha = 0.1", (None, 1e-6), (None, 1e-6)),
        ("ssukf, alpha = 1", "AUKF and SSUKF with the paper's scaling, alpha = 1", (None, 1e-6), (None, 1e-6)),
        ("aukf-1, c = 15", "AUKF and the same drawn once, c = 15", (None, 1e-6), (None, 1e-6)),
        ("additive, c = 15", "AUKF and additive UKF, c = 15", (None, 1e-6), (None, 1e-6)),
        ("usque, c = 7", "AUKF and USQUE, c = 7", (None, 1e-6), (None, 1e-6)),
        (
            "ssukf, covariance form",
            "AUKF and SSUKF at c = 15 in covariance form, which the first star costs digits",
            (None, 1e-7),
            (None, 1e-8),
        ),
    )
    for name, text, attitude, drift in pairs:
        id = "identity-" + name.replace(", ", "-").replace(" = ", "-").replace(" ", "-")
        first, second = (order(value) for value in j.worst("identities", name))
        out.append(j.number(f"{id}-attitude", "beyond", f"{text} (largest difference, power of ten, arcsec)", first, attitude))
        out.append(j.number(f"{id}-drift", "beyond", f"{text} (largest difference, power of ten, deg/h)", second, drift))
    error = [j.result.data["paper"][f"{name}/error"][1:] for name in ("aukf", "mekf")]
    apart = np.abs(error[0] - error[1]).max((0, 1))
    text = "MEKF and AUKF, 4 Hz, all runs (largest difference, power of ten"
    out.append(j.number("identity-mekf-attitude", "beyond", f"{text}, arcsec)", order(apart[:3].max()), (None, 1e-3)))
    out.append(j.number("identity-mekf-drift", "beyond", f"{text}, deg/h)", order(apart[3:].max()), (None, 1e-5)))
    for name in COMPARED:
        values = j.worst("linear", name)
        text = (
            f"A satellite at rest: {name.upper()} and the exact linear Kalman filter, {j.seconds('linear'):g} s (largest difference"
        )
        out.append(j.number(f"linear-{name}-attitude", "beyond", f"{text}, arcsec)", values[0], (None, 1e-3)))
        out.append(j.number(f"linear-{name}-drift", "beyond", f"{text}, deg/h)", values[1], (None, 2e-4)))
    return out


def _rates(j: Evidence) -> list[Claim]:
    """The paper's 100 Hz."""
    out = []
    for name in ("aukf", "ssukf"):
        attitude, drift = j.worst("rates", f"{name}/apart")
        text = f"{name.upper()} at 100 Hz and with gyro samples integrated to 4 Hz, the same samples (largest difference"
        out.append(j.number(f"rates-{name}-attitude", "beyond", f"{text}, arcsec)", attitude, (None, 2e-3)))
        out.append(j.number(f"rates-{name}-drift", "beyond", f"{text}, deg/h)", drift, (None, 5e-4)))
        error = np.square(j.result.data["rates"][f"{name}/error"][1][:, ATTITUDE])
        text = f"{name.upper()} at 100 Hz: error after the first star sample, three axes (arcsec)"
        out.append(j.statistic(f"rates-{name}-first", "calibrated", text, rms, [error], (17.0, 24.0)))
    return out


def _variants(j: Evidence) -> list[Claim]:
    out = []
    same: tuple[tuple[str, str, str], ...] = (
        ("dense-ssukf", "dense ssukf", "SSUKF with the augmented covariance factored whole and block by block"),
        ("dense-aukf", "dense aukf", "AUKF with the augmented covariance factored whole and block by block"),
        ("total-pair", "total", "AUKF and SSUKF on the total MRP"),
        ("total-local-first", "total to local, first", "SSUKF on the total MRP and in local form at the first star sample"),
    )
    for id, name, text in same:
        value = order(j.worst("variants", name)[0])
        out.append(j.number(id, "beyond", f"{text} (largest difference, power of ten, arcsec)", value, (None, 1e-6)))
    apart: tuple[tuple[str, str, str], ...] = (
        ("total-local", "total to local", "The same afterwards: transients differ, a little"),
        ("transport-star", "transported", "Transport of the covariance where whole attitudes are measured"),
    )
    for id, name, text in apart:
        # The largest of 50 runs is about 0.09, and scatters by a third. Lengths of Gaussian vectors of one to three components have
        # means 3.2 to 2.2 times below their largest of 50.
        text = f"{text}, {j.seconds('variants'):g} s (largest difference of a run, mean of the runs, arcsec)"
        out.append(j.statistic(id, "beyond", text, np.mean, [j.result.data["variants"][name][0]], (0.02, 0.055)))
    return out


def _exact(j: Evidence) -> list[Claim]:
    """The deviations that the model implies, against those that the filters report and those that the errors have."""
    exact, out = j.result.facts["exact"], []
    for name in ("aukf", "ssukf"):
        std = j.result.data["paper"][f"{name}/std"][1:, 0]
        apart = order(float(np.abs(std[:, 2] / exact[1:, 0] - 1.0).max()))
        text = f"Deviation of yaw that {name.upper()} reports, against the exact one (largest relative difference, power of ten)"
        out.append(j.number(f"exact-{name}", "beyond", text, apart, (None, 0.002)))
    printed = (10.007, 4.790, 2.567, 1.997, 1.432, 1.205, 1.099, 1.053, 1.037)
    for seconds, value in zip(EPOCHS_S, printed, strict=True):
        if seconds <= j.times[-1]:
            text = f"Exact deviation of an angle after {seconds:g} s (arcsec)"
            bounds = (value - 1e-3, value + 1e-3)
            out.append(j.number(f"exact-{seconds:g}", "beyond", text, float(exact[j.result.at(seconds), 0]), bounds))
    for seconds in (10.0, 100.0, 600.0):
        k = j.result.at(seconds)
        samples = [j.squares("ssukf", ATTITUDE, first=j.times[k], last=j.times[k]) / exact[k, 0] ** 2]
        text = f"RMSE of SSUKF against the exact deviation after {seconds:g} s, three axes (ratio)"
        out.append(j.statistic(f"exact-ratio-{seconds:g}", "beyond", text, rms, samples, (0.9, 1.1)))
    return out


def _settled(j: Evidence) -> list[Claim]:
    """Farrenkopf's closed form and the Riccati equation."""
    config, out = j.result.config, []
    dt, gyro = 1.0 / config.star_hz, config.gyro
    walk = Gyro(gyro.sigma_v, gyro.sigma_u)
    closed, solved = steady_state(config.sigma_n, walk, dt), limit(walk, config.sigma_n, dt)
    apart = np.abs(np.array(closed).reshape(2, 2).T / solved - 1.0).max()
    text = "Farrenkopf's closed form against the Riccati equation (relative difference, power of ten)"
    out.append(j.number("farrenkopf", "beyond", text, order(float(apart)), (None, 1e-9)))
    for text, value, bounds in (
        ("attitude before a star sample (arcsec)", closed.attitude_before / ARCSEC, (1.04577, 1.04579)),
        ("attitude after it (arcsec)", closed.attitude_after / ARCSEC, (1.04434, 1.04436)),
        ("drift after it (deg/h)", closed.drift_after / DEG_PER_H, (0.0071733, 0.0071735)),
    ):
        out.append(j.number(f"farrenkopf-{text[:8]}-{text.split()[1]}", "beyond", f"Farrenkopf: {text}", value, bounds))
    finite = limit(gyro, config.sigma_n, dt)[1] / [ARCSEC, DEG_PER_H]
    out.append(j.number("riccati-attitude", "beyond", "Riccati, tau = 1 h: attitude (arcsec)", finite[0], (1.03125, 1.03129)))
    out.append(j.number("riccati-drift", "beyond", "Riccati, tau = 1 h: drift (deg/h)", finite[1], (0.0069480, 0.0069482)))
    slow = steady_state(config.sigma_n, walk, 1.0).attitude_after / ARCSEC
    out.append(j.number("farrenkopf-1-s", "beyond", "Farrenkopf: attitude at 1 Hz (arcsec)", slow, (1.705, 1.707)))
    for name in ("aukf", "ssukf"):
        std = j.result.data["paper"][f"{name}/std"][-1, 0]
        text = f"Deviation of {name.upper()} at the end against the Riccati equation (largest of the axes, relative)"
        out.append(j.number(f"riccati-{name}", "beyond", text, np.abs(std[:3] / finite[0] - 1.0).max(), (None, 0.01)))
    return out


def _consistency(j: Evidence) -> list[Claim]:
    """Initial errors drawn from the prior."""
    out, drawn = [], j.result.data["drawn"]
    # Errors of the drift last for minutes: ten minutes of 200 runs are about three independent samples of their mean, whose
    # deviation is sqrt(12 / 600) = 0.14. Three of them are allowed, to the samples in the band as well.
    rows: tuple[tuple[str, int, Bounds, tuple[float, float], float], ...] = (
        ("nees", 6, (5.58, 6.42), (5.53, 6.49), 0.65),
        ("nis", 3, (2.97, 3.03), (2.67, 3.35), 0.92),
    )
    for kind, dof, mean, band, least in rows:
        values = drawn[f"ssukf/{kind}"][1:].T
        text = f"{kind.upper()} of SSUKF over all star samples ({dof} if consistent)"
        out.append(j.statistic(f"{kind}-ssukf", "beyond", text, np.mean, [values.mean(1)], mean))
        if j.full:
            average = values.mean(0)
            inside = float(((average > band[0]) & (average < band[1])).mean())
            text = f"The same: part of the samples in the 95 % band of {len(values)} runs"
            out.append(j.number(f"{kind}-band-ssukf", "beyond", text, inside, (least, None)))
        for name, bound in (("aukf", 1e-6), ("usque", 0.02), ("mekf", 0.02)):
            part = drawn[f"{name}/{kind}"][1:]
            apart = np.abs(part - drawn[f"ssukf/{kind}"][1 : len(part) + 1]).mean()
            text = f"{kind.upper()} of {name.upper()} is that of SSUKF, {len(part) / j.result.config.star_hz:g} s"
            text += " (mean absolute difference, power of ten)"
            out.append(j.number(f"{kind}-{name}", "beyond", text, order(float(apart)), (None, bound)))
    return out


def _squares(j: Evidence, name: str, degrees: float, seconds: int = 100) -> Array:
    return np.asarray(np.square(j.result.data["vector"][f"{name}/{degrees:g}/error"][seconds]))


def _vector(j: Evidence) -> list[Claim]:
    """One unit vector instead of the attitude: here the filters differ."""
    out = []
    rows: tuple[tuple[str, str, float, Bounds], ...] = (
        ("usque, transported", "usque", 10.0, (None, 0.85)),
        ("usque, transported", "usque", 30.0, (None, 0.85)),
        ("mekf", "usque", 10.0, (1.3, None)),
        ("mekf", "usque", 30.0, (5.0, None)),
        ("mekf, transported", "mekf", 10.0, (None, 0.75)),
        ("mekf, transported", "mekf", 30.0, (None, 0.75)),
    )
    for one, two, degrees, bounds in rows:
        text = f"One vector, prior {degrees:g} deg: {one.upper()} against {two.upper()} after 100 s (RMS error, ratio)"
        id = f"vector-{degrees:g}-{one}-{two}".replace(", ", "-")
        samples = [_squares(j, name, degrees) for name in (one, two)]
        out.append(j.statistic(id, "beyond", text, ratio, samples, bounds))
    short = j.result.data["vector, short"]
    for one, two, degrees in (("ssukf, c = 15", "aukf", 10.0), ("ssukf, c = 15", "aukf", 30.0)):
        a, b = (np.sqrt(np.square(short[f"{name}/{degrees:g}/error"][-1]).mean()) for name in (one, two))
        text = (
            f"One vector, prior {degrees:g} deg: SSUKF and AUKF at equal spread after 100 s (relative difference of the RMS error)"
        )
        out.append(j.number(f"vector-{degrees:g}-equal", "beyond", text, order(abs(a / b - 1.0)), (None, 1e-6)))
    a, b = (np.stack([short[f"{name}/{d:g}/error"] for d in (10.0, 30.0)]) for name in ("usque", "ssukf, c = 7"))
    text = "One vector: USQUE and SSUKF at c = 7, priors of 10 and 30 deg over 100 s (largest difference, power of ten, deg)"
    out.append(j.number("vector-usque-ssukf", "beyond", text, order(float(np.abs(a - b).max())), (None, 1e-6)))
    return out


def _lost(j: Evidence) -> list[Claim]:
    """What is given up by drawing anew: noise common to both parts; and what single draws are worth otherwise."""
    out = []
    reference = {0.5: 0.5653, 0.8: 0.3609, -0.8: 0.9849}
    for rho in CORRELATIONS:
        found, id = j.result.facts["correlated"][rho], f"correlated-{rho:g}"
        text = f"Noise correlated by {rho:g}: exact deviation"
        out.append(j.number(f"{id}-exact", "beyond", text, found.exact, (reference[rho] - 5e-5, reference[rho] + 5e-5)))
        text = f"Noise correlated by {rho:g}: covariance of a single draw against the exact one (largest difference, power of ten)"
        out.append(j.number(f"{id}-apart", "beyond", text, order(found.apart), (None, 1e-9)))
        text = f"Noise correlated by {rho:g}: RMSE of a single draw against the exact deviation (ratio)"
        out.append(j.number(f"{id}-once", "beyond", text, found.once / found.exact, (0.99, 1.01)))
        least = {0.5: 1.015, 0.8: 1.1, -0.8: 1.025}[rho]
        text = f"Noise correlated by {rho:g}: RMSE of the SSUKF against a single draw (ratio)"
        out.append(j.number(f"{id}-lost", "beyond", text, found.switching / found.once, (least, None)))
        text = f"Noise correlated by {rho:g}: the AUKF that draws anew loses it as well (RMSE to SSUKF, relative, power of ten)"
        out.append(j.number(f"{id}-redrawn", "beyond", text, order(abs(found.redrawn / found.switching - 1.0)), (None, 1e-9)))
    for rho, bounds in ((0.8, (0.2, 0.36)), (-0.8, (1.6, 1.85))):
        text = f"Noise correlated by {rho:g}: NEES of the SSUKF (1 if consistent)"
        out.append(j.number(f"correlated-{rho:g}-nees", "beyond", text, j.result.facts["correlated"][rho].nees, bounds))
    rms, apart = j.result.facts["multiplied"]
    once, additive = rms["aukf-1"] / rms["ssukf"], rms["additive"] / rms["ssukf"]
    rows: tuple[tuple[str, str, float, Bounds], ...] = (
        (
            "multiplied-equal",
            "Noise in an exponential: AUKF and SSUKF at c = 6 (largest difference, power of ten)",
            order(apart),
            (None, 1e-10),
        ),
        (
            "multiplied-once",
            "The same: a single draw against drawing anew (RMSE, ratio)",
            once,
            (0.998, 1.002),
        ),
        (
            "multiplied-additive",
            "The same: linearized noise against augmentation (RMSE, ratio)",
            additive,
            (1.0, 1.03),
        ),
    )
    return out + [j.number(id, "beyond", text, value, bounds) for id, text, value, bounds in rows]


def _sensitivity(j: Evidence) -> list[Claim]:
    out = []

    def error(degrees: float, seconds: float) -> float:
        values = j.result.data["priors"][f"{degrees:g}"][j.result.at(seconds), :, :3]
        return float(np.sqrt(np.square(values).mean()))

    wide = [d for d in PRIORS_DEG if d >= 1.0]
    for seconds, bounds in ((0.25, (None, 1.03)), (10.0, (None, 1.005)), (60.0, (None, 1.001))):
        values = [error(d, seconds) for d in wide]
        text = f"Prior of 1 to 180 deg: error after {seconds:g} s, largest to smallest (ratio)"
        if j.full:  # of few runs the ratio scatters, and it has no interval
            out.append(j.number(f"prior-{seconds:g}", "beyond", text, max(values) / min(values), bounds))
    tight = PRIORS_DEG[-1]
    text = "A prior of 20 arcsec for an error of 10 deg: error at the end against that of a wide one (ratio)"
    out.append(j.number("prior-overconfident", "beyond", text, error(tight, 60.0) / error(10.0, 60.0), (20.0, None)))
    limits = {1.0: 5e-6, 0.01: 5e-6, 1e-3: 1e-3, 1e-4: 0.1}
    for alpha in ALPHAS:
        if alpha != j.result.config.alpha:
            text = f"alpha = {alpha:g} instead of 0.1: change over {j.seconds('alphas'):g} s (largest, power of ten, arcsec)"
            value = order(j.worst("alphas", f"{alpha:g}")[0])
            out.append(j.number(f"alpha-{alpha:g}", "beyond", text, value, (None, limits[alpha])))
    return out


def _total(j: Evidence) -> list[Claim]:
    spin, out = j.result.facts["spin"], []
    text = "A spin past 360 deg: largest error of the total form with the switch against the local form (ratio)"
    out.append(j.number("spin-switched", "beyond", text, spin.settled("switched") / spin.settled("local"), (0.99, 1.01)))
    text = "Switches of the total form to its shadow set, in a run that starts beyond 180 deg and turns to 370 deg"
    out.append(j.number("spin-switches", "beyond", text, spin.switches, (1.0, 1.0)))
    text = "Covariance of the total form in the tangent space against the local one (largest difference, in deviations)"
    out.append(j.number("total-covariance", "beyond", text, j.result.facts["total covariance"], (None, 1e-3)))
    return out
