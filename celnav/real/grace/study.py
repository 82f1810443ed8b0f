"""A satellite's GPS fixes, whose errors are correlated from one to the next: what filters claim,
and where it really was.

GRACE-A, 1 to 3 August 2008. The fixes of 2 and 3 August decide all that is set
(`celnav.real.grace.settings`); then filters fly 1 August, for which there are positions good to 3
to 6 cm. This is a second look. In the first, all filters had a gate of 5 deviations, and settings
by a likelihood without the fixes that were far off; bursts of the fixes' errors locked filters out,
and what was found was the gate's. So the truth had been looked at when this was written: that there
are bursts was known. Settings are of 2 and 3 August still. Ranges are those of the first look;
those of rows that it did not have were written before these were computed. Units: m, s; errors
radial, along and across the track.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from celnav.analysis.metrics import ratio, rms
from celnav.filters.adaptive import gate, student_t
from celnav.filters.colored import augmented, colored
from celnav.filters.joint import Hook, Joint
from celnav.filters.records import Filter
from celnav.filters.run import run
from celnav.filters.track import Track
from celnav.gaussian.belief import Gaussian
from celnav.gaussian.linalg import Array, matvec
from celnav.models import gravity
from celnav.real import found
from celnav.real.grace.positions import STEP_S, aligned, axes, read
from celnav.real.grace.settings import (
    DEGREE,
    DOF,
    SETTINGS,
    TRAINED,
    Training,
    around,
    believed,
    prior,
    trained,
    training,
)
from celnav.study.ledger import Bounds, Number, Row, Sentence, check
from celnav.study.numbers import Decided, all_of, correlation, lagged, of, over_time
from celnav.study.study import Part, Results, Rngs, Study
from celnav.study.trial import Group

__all__ = [
    "BEST",
    "CITATION",
    "DEGREES",
    "FIELD",
    "FIXES",
    "HOOKED",
    "INPUTS",
    "NAMES",
    "REVOLUTION",
    "SEARCHED",
    "STUDY",
    "TITLE",
    "TRUTH",
    "column",
    "flights",
]

CITATION = """@misc{GRACE2008,
  author = {Zhang, Shoujian},
  title  = {KineOrbits: kinematic and single-point positions of GRACE-A,
            of Level-1B data of NASA and GFZ},
  year   = {2008},
  note   = {gravity: Pavlis et al., EGM2008}
}"""
TITLE = "GPS fixes of a satellite: GRACE-A"
INPUTS = ("grace",)
FIXES = tuple(f"*2008-08-0{day}*.pos.spp*" for day in (1, 2, 3))
TRUTH, FIELD = "*2008-08-01*.svr.*", "*.gfc"


# -- what is flown ---------------------------------------------------------------------------------
GATE = 5.0
"""Deviations of an innovation: the gate of the first look."""
WHITE = ("white", "white, inflated", "white, by NIS", "white, by likelihood")
COLORED = ("colored", "screened", "normal", "by correlation")
HOOKED = {"white, gated": gate(GATE), "robust": student_t(DOF)}
NAMES = (*WHITE, *COLORED, *HOOKED, "without z_0", "augmented")


def flights(field: gravity.Gravity, names: Sequence[str]) -> dict[tuple[str, ...], Filter]:
    """Filters by the names that they fly as runs of one batch: a white one has a coefficient of 0.
    "augmented" flies alone.
    """
    own = tuple(name for name in names if name != "augmented")
    hooks = [
        of_runs(hook, np.array([one == name for one in own]))
        for name, hook in HOOKED.items()
        if name in own
    ]
    sigma, phi, q = np.transpose([SETTINGS[name] for name in own])
    increments = (np.square(sigma) * (1.0 - np.square(phi)))[:, None, None] * np.eye(3)
    first = np.where(
        [name == "without z_0" for name in own], 1e6, sigma
    )  # m: a first fix that says nothing
    M, S, Phi = believed(field, np.stack([first, phi, q]))
    out: dict[tuple[str, ...], Filter] = {
        own: colored(M, S, Phi, increments=increments, hooks=hooks)
    }
    if "augmented" in names:
        out["augmented",] = augmented(*believed(field, np.transpose([SETTINGS["augmented"]])))
    return out


def of_runs(hook: Hook, here: Array) -> Hook:
    """A hook that does to some runs ``(runs,)`` what another does to all."""

    def some(memory: Any, joint: Joint, epoch: Any) -> tuple[Any, Joint]:
        memory, done = hook(memory, joint, epoch)
        innovation = np.where(here[:, None], done.innovation, joint.innovation)
        before: Any = joint.measurement_noise
        after: Any = done.measurement_noise
        V = np.asarray(np.where(here[:, None, None], after, before))
        return memory, joint._replace(innovation=innovation, measurement_noise=V)

    return some


class Files(NamedTuple):
    """Fixes of three days, positions of the first, gravity."""

    fixes: tuple[Path, ...]
    truth: Path
    field: Path


def run_filters(names: Sequence[str], degree: int, files: Files, _rngs: Rngs) -> dict[str, Array]:
    """Filters over 1 August with gravity to a degree, and the fixes themselves.

    Returns
    -------
    times ``(T,)`` s; errors of the fixes ``fixes (T, 3)`` m, radial, along and across. Of each
    filter ``<name>/error`` and ``<name>/std (T, 1, 3)`` on these axes, ``<name>/cov (T, 1, 3, 3)``;
    ``<name>/nees``, ``<name>/nis (T, 1)``, of three components, nan where there is none;
    ``<name>/white (T, 3)``, whitened innovations; ``<name>/rejected (1,)``, the share of components
    that the gate left out.
    """
    log, field = read(files.fixes[0]), gravity.read(files.field, degree)
    truth, times = aligned(log, read(files.truth)), log.times - log.times[0]
    frame, start, u = axes(truth), prior(log), around(log.times)
    out = {"times": times, "fixes": matvec(frame, log.z - truth)}
    for own, filter in flights(field, names).items():
        runs = Gaussian(np.tile(start.mean, (len(own), 1)), start.cov)
        track = run(filter, runs, times, np.tile(log.z[:, None], (1, len(own), 1)), u, keep="cov")
        for i, name in enumerate(own):
            error, cov = (
                matvec(frame, track.mean[:, i, :3] - truth),
                frame @ track.cov[:, i, :3, :3] @ frame.mT,
            )
            used = track.used[:, i]
            out |= {
                f"{name}/error": error[:, None],
                f"{name}/cov": cov[:, None],
                f"{name}/std": np.sqrt(cov.diagonal(0, -2, -1))[:, None],
                f"{name}/nees": np.vecdot(error, np.linalg.solve(cov, error[..., None])[..., 0])[
                    :, None
                ],
                f"{name}/nis": np.where(used.all(-1), track.nis[:, i], np.nan)[:, None],
                f"{name}/white": np.where(used, track.whitened[:, i], np.nan),
                f"{name}/rejected": np.array(
                    [track.events["rejected"][i] / np.isfinite(log.z).sum()]
                ),
            }
    return out


SEARCHED = {
    "robust": "tails",
    "screened": "colored",
    "normal": "colored",
    "white, by likelihood": "white",
}
"""Settings that a likelihood has found, and its kind."""


def judged(files: Files, _rngs: Rngs) -> dict[str, Array]:
    """How probable settings make 2 and 3 August: those that were found first, then each of their
    parts by a fifth less and more.

    Returns
    -------
    Of each of `SEARCHED` ``<name> (7,)``, of the white one ``(5,)``: logarithms. nis ``(1,)``: of
    the white filter whose R is set by it, over its degrees of freedom.
    """
    field, factors = gravity.read(files.field, DEGREE), np.ones((7, 3))
    data = training(files.fixes[1:], field, TRAINED)
    for i, factor in product(range(3), (0, 1)):
        factors[1 + 2 * i + factor, i] = (1.0 / 1.2, 1.2)[factor]

    def track(settings: Array, kind: str, data: Training) -> Track:
        count, (F, c) = len(settings), data.u
        u, start = (
            (np.tile(F, (1, count, 1, 1)), np.tile(c, (1, count, 1))),
            np.tile(data.prior.mean, (count, 1)),
        )
        filter = trained(field, np.repeat(settings, 2, 0).T, kind)
        return run(
            filter,
            Gaussian(start, data.prior.cov),
            data.times,
            np.tile(data.z, (1, count, 1)),
            u,
            keep="mean",
        )

    out: dict[str, Array] = {}
    for name, kind in SEARCHED.items():
        sigma, _, q = np.array(SETTINGS[name])[:, None] * factors.T
        # A correlation is changed in its distance from 1.
        phi = 1.0 - (1.0 - SETTINGS[name].phi) * factors[:, 1]
        fixes = data.screened() if name == "screened" else data
        tried = np.stack([sigma, phi, q], -1)[[0, 1, 2, 5, 6] if kind == "white" else slice(None)]
        out[name] = track(tried, kind, fixes).log_likelihood.reshape(len(tried), 2).sum(1)
    white = track(np.array([SETTINGS["white, by NIS"]]), "white", data)
    return out | {"nis": np.array([white.nis.sum() / white.dof.sum()])}


DEGREES = (2, 8, DEGREE)


def parts(_effort: float, grace: Path) -> dict[str, Part]:
    """Flights by degree of gravity, and what the settings were found by; ``grace``: the folder."""
    *fixes, truth, field = found(grace, (*FIXES, TRUTH, FIELD))
    files = Files(tuple(fixes), truth, field)
    out = {
        f"degree {n}": Part(
            partial(run_filters, NAMES if n == DEGREE else ("white", "colored"), n),
            files,
            cost=20.0,
        )
        for n in DEGREES
    }
    return out | {"settings": Part(judged, files, cost=25.0)}


# -- the ledger ------------------------------------------------------------------------------------
BEST, OUTLIER_M, REVOLUTION, CHI_SQUARE_MEDIAN = f"degree {DEGREE}", 30.0, 564, 2.36597
"""Epochs of a revolution: nothing is judged before the first is over, and the bootstrap draws whole
ones.
"""
Columns = Callable[[Results], Sequence[Array]]


def column(r: Results, part: str, name: str, what: str) -> Array:
    """``(T,)`` of a filter: length of its error or of its std, squared; NEES or NIS over their 3;
    nan where there is no truth.
    """
    if name == "fixes":
        return np.asarray(np.square(r.get(part, name)).sum(1))
    values = r.get(part, f"{name}/{what}")[:, 0]
    return np.asarray(values / 3.0 if what in ("nees", "nis") else np.square(values).sum(-1))


def over_day(
    label: str, statistic: Callable[..., float], columns: Columns, accept: Bounds = (None, None)
) -> Decided:
    """A statistic of columns after the first revolution."""
    return lambda r: over_time(
        label, statistic, columns, accept, start=REVOLUTION, block=REVOLUTION
    )(r)


def mean(a: Array) -> float:
    """Of all epochs."""
    return float(a.mean())


def claims(name: str, accept: Bounds) -> Decided:
    """What a filter errs over what it claims."""
    label = f"RMSE over claimed deviation, {name}"
    return over_day(
        label, ratio, lambda r: [column(r, BEST, name, what) for what in ("error", "std")], accept
    )


def honest(name: str, accept: Bounds = (None, None), part: str = BEST) -> Decided:
    """NEES of a position over its 3 components, which is 1 of a consistent filter."""
    return over_day(
        f"NEES / 3, {part}, {name}", mean, lambda r: [column(r, part, name, "nees")], accept
    )


def typical(name: str, accept: Bounds) -> Decided:
    """Median of NEES over that of a consistent filter."""
    return over_day(
        f"median NEES over a consistent one's, {name}",
        lambda a: float(np.median(a)) / (CHI_SQUARE_MEDIAN / 3.0),
        lambda r: [column(r, BEST, name, "nees")],
        accept,
    )


def inside(name: str) -> Decided:
    """Share of the components, in all directions, within the predicted 95 % intervals."""

    def columns(r: Results) -> list[Array]:
        error, std = (r.get(BEST, f"{name}/{what}")[:, 0] for what in ("error", "std"))
        return [np.where(np.isfinite(error), np.abs(error) < 1.96 * std, np.nan)]

    return over_day(f"components within the predicted 95 % intervals, {name}", mean, columns)


def against(a: str, b: str, accept: Bounds = (None, None), part: str = BEST) -> Decided:
    """RMSE of one filter over that of another, or of the fixes, with the best gravity."""
    label = f"RMSE of {a} over that of {b}"
    return over_day(
        label, ratio, lambda r: [column(r, part, a, "error"), column(r, BEST, b, "error")], accept
    )


def size(name: str) -> Decided:
    """RMSE of a position, m."""
    return over_day(f"RMSE of {name}, m", rms, lambda r: [column(r, BEST, name, "error")])


def whiteness(name: str, accept: Bounds) -> Decided:
    """Correlation of whitened innovations from one epoch to the next."""
    return over_day(
        f"of {name}", correlation, lambda r: lagged(r.get(BEST, f"{name}/white")), accept
    )


def autocorrelation(lag: int, accept: Bounds = (None, None)) -> Decided:
    """Correlation of the fixes' errors so many epochs apart, without outliers."""

    def near(r: Results) -> Array:
        error = r.get(BEST, "fixes")
        return np.where(np.linalg.norm(error, axis=1, keepdims=True) < OUTLIER_M, error, np.nan)

    return over_day(
        f"after {lag * STEP_S:g} s", correlation, lambda r: lagged(near(r), lag), accept
    )


HONEST = (0.5, 2.0)
"""Of NEES over its dimension."""
finding = partial(
    Row,
    "finding",
    revised="2026-11-23: a second look, without a gate; the truth had been looked at with one",
)
FINDINGS = [
    finding(
        "fixes-colored",
        "Errors of real fixes are correlated from one to the next: of those that err less than 30 "
        "m.",
        all_of(autocorrelation(1, (0.9, None)), autocorrelation(30), autocorrelation(90)),
        figure="figure_03",
        expected="undecided",
        why="0.9 from one fix to the next is far from white",
        found="By {0} after 10 s, {1} after 5 min, {2} after 15.",
    ),
    finding(
        "white-overconfident",
        "A UKF that takes them for white errs by a multiple of what it claims.",
        all_of(claims("white", (2.0, None)), honest("white", (4.0, None)), size("white")),
        figure="figure_01",
        expected="undecided",
        why="twice the claim, four times the NEES",
        found="{0} times its claim, NEES/3 {1}; RMSE {2} m.",
    ),
    finding(
        "colored-honest",
        "Told of the correlation, the same UKF is honest.",
        all_of(honest("colored", HONEST), claims("colored", (0.71, 1.41)), size("colored")),
        figure="figure_01",
        expected="undecided",
        why="NEES within a factor 2 of its dimension",
        found="NEES/3 {0}, {1} times its claim; RMSE {2} m.",
    ),
    finding(
        "colored-better",
        "It is the better estimate as well, and better than the fixes.",
        all_of(against("colored", "white", (None, 1.0)), against("colored", "fixes", (None, 1.0))),
        expected="undecided",
        why="below 1",
        found="{0} of the white filter's RMSE, {1} of the fixes'.",
        figure="figure_04",
    ),
    finding(
        "typical",
        "In a typical epoch the filter that is told of the correlation is honest, the other is "
        "not.",
        all_of(
            typical("colored", HONEST),
            typical("white", (2.0, None)),
            inside("colored"),
            inside("white"),
        ),
        figure="figure_01",
        why="the median of NEES within a factor 2 of that of a consistent filter; beyond twice "
        "that",
        expected="not shown",
        found="Median NEES {0} and {1} times a consistent filter's. {2:.0%} and {3:.0%} of the "
        "components (radial, along and across the track) lie within the predicted 95 % intervals.",
    ),
    finding(
        "inflated",
        "An R as large as the correlation costs makes an honest filter of the white one, and one "
        "as good.",
        all_of(
            honest("white, inflated", HONEST), against("white, inflated", "colored", (0.95, 1.05))
        ),
        figure="figure_04",
        why="as for the colored one; within 5 %",
        expected="not shown",
        found="NEES/3 {0}, and {1} of the colored one's RMSE.",
    ),
    finding(
        "misleads",
        "Neither the R that makes NIS right nor the most probable R and Q make an honest filter of "
        "a white one.",
        all_of(
            honest("white, by NIS", (4.0, None)),
            claims("white, by NIS", (2.0, None)),
            honest("white, by likelihood", (4.0, None)),
            claims("white, by likelihood", (2.0, None)),
        ),
        figure="figure_04",
        why="as for the white one",
        found="By NIS NEES/3 {0}, {1} times its claim; by likelihood {2} and {3}.",
    ),
    finding(
        "innovations-tell",
        "Innovations tell which is right without any truth: those of white filters are correlated.",
        all_of(whiteness("white", (0.3, None)), whiteness("colored", (-0.2, 0.2))),
        figure="figure_03",
        expected="undecided",
        why="clearly correlated, and next to not",
        found="By {0} from one to the next; those of the colored one by {1}.",
    ),
    finding(
        "augmented-same",
        "Carrying the noise in the state, the exact reference, gives the same.",
        all_of(against("augmented", "colored", (0.95, 1.05)), honest("augmented")),
        why="within 5 %",
        figure="figure_04",
        found="{0} times the RMSE, NEES/3 {1}.",
    ),
    finding(
        "first-sample",
        "Without the first fix, as the differences alone have it, the position is known much "
        "later.",
        lambda r: [
            Number(
                "RMSE of the first revolution, over that with it",
                early(r, "without z_0") / early(r, "colored"),
                (1.5, None),
            ),
            against("without z_0", "colored")(r),
        ],
        expected="not shown",
        why="half as much again",
        found="{0} times the RMSE in the first revolution, {1} afterwards.",
    ),
    finding(
        "tail",
        "With settings of a normal likelihood the filter is overconfident, with all fixes or "
        "without those far off.",
        all_of(
            honest("screened", (2.0, None)),
            honest("normal", (2.0, None)),
            honest("by correlation"),
            *(against(name, "colored") for name in ("screened", "normal", "by correlation")),
        ),
        expected="undecided",
        why="NEES beyond twice its dimension",
        figure="figure_04",
        found="NEES/3 is {0} without fixes that are 6 m off, {1} with all, {2} by the correlation "
        "of residuals; RMSE {3}, {4} and "
        "{5} times that of Student's t.",
    ),
    finding(
        "robust",
        "A filter with Student's t for the noise weathers the bursts: it errs less, and is honest.",
        all_of(
            against("robust", "colored", (None, 1.0)),
            honest("robust", HONEST),
            typical("robust", HONEST),
        ),
        figure="figure_02",
        why="below 1; as for the colored one",
        expected="not shown",
        found="{0} of the colored one's RMSE; NEES/3 {1}, its median {2}.",
    ),
    finding(
        "gate-locks",
        "A gate of 5 deviations locks the white filter out of its fixes.",
        all_of(
            against("white, gated", "white", (2.0, None)),
            of(BEST, "white, gated/rejected", "share of components left out"),
        ),
        expected="undecided",
        why="twice the error",
        figure="figure_02",
        found="{0} times the RMSE without; it leaves out {1:.1%} of the components.",
    ),
    finding(
        "gravity-matters",
        "Gravity to degree 2 is a motion that errs more than its process noise: neither is honest "
        "then.",
        all_of(
            honest("colored", (2.0, None), "degree 2"),
            honest("white", (2.0, None), "degree 2"),
            against("colored", "colored", (1.0, None), "degree 2"),
            honest("colored", HONEST, "degree 8"),
        ),
        why="out of the range of an honest one",
        expected="not shown",
        figure="figure_04",
        found="NEES/3 {0} and {1}, {2} times the RMSE; with degree 8 NEES/3 is {3}.",
    ),
]


def lost(likelihood: Array) -> float:
    """Of the first, over the others."""
    return float((likelihood[0] - likelihood[1:]).min())


CHECKS = [
    check(
        "settings-likely",
        "On 2 and 3 August no setting a fifth off in one parameter is more probable",
        all_of(
            *(
                of("settings", name, f"log-likelihood lost at least, {name}", (-0.5, None), lost)
                for name in SEARCHED
            )
        ),
        revised="2026-11-23: by more than half of its unit, which is what a standard error loses; "
        "was 0",
    ),
    check(
        "settings-nis",
        "NIS of the white filter whose R is set by it, on 2 and 3 August",
        of("settings", "nis", "NIS per component", (0.97, 1.03)),
    ),
]


def early(r: Results, name: str) -> float:
    """RMSE in the first revolution, m."""
    return float(np.sqrt(np.nanmean(column(r, BEST, name, "error")[:REVOLUTION])))


STUDY = Study(
    "grace",
    (Group("position", "m", slice(0, 3)),),
    None,
    parts,
    [*FINDINGS, *CHECKS],
    figure="figure_01",
    says="A satellite's GPS fixes have errors that follow one another. Is a filter honest that "
    "takes them for white, and one that "
    "is told?",
    found=(
        Sentence(
            "In the mean of the day the filter that was told, by a likelihood that knows of "
            "bursts, is nearest to consistent: "
            "NEES/3 {colored-honest[0]:.2f} at {colored-honest[2]:.1f} m RMSE. The white one errs "
            "{white-overconfident[2]:.1f} m, "
            "{white-overconfident[0]:.1f} times what it predicts. But a few bursts of the fixes' "
            "errors, up to 40 m, rule that "
            "mean, so that intervals leave both undecided. This is a second look at that day.",
            {"colored-honest": "undecided", "white-overconfident": "undecided"},
        ),
        Sentence(
            "Told by normal likelihoods, with the bursts or without, it is overconfident by its "
            "NEES/3 ({tail[0]:.1f} and "
            "{tail[1]:.1f}), undecided as well.",
            {"tail": "undecided"},
        ),
        Sentence(
            "Student's t in the filter does not weather them: its RMSE is {robust[0]:.2f} times as "
            "large.",
            {"robust": "not shown"},
        ),
        Sentence(
            "A gate leaves {gate-locks[1]:.0%} of the components out, at {gate-locks[0]:.1f} times "
            "the RMSE, undecided.",
            {"gate-locks": "undecided"},
        ),
    ),
)
