"""Half a day of a station: filters on its log, with and without an added noise burst, and the
broadcast orbits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from celnav.files import InputError
from celnav.gaussian.linalg import Array
from celnav.models.gnss import ROTATION_RATE, TILT, Broadcast, satellites, tilted, turned
from celnav.receiver.constellation import GEOSTATIONARY, TOE_S, geostationary, synthetic
from celnav.receiver.fixes import GIVEN
from celnav.receiver.position import Log, prepare
from celnav.receiver.report import STILL, Positioned, position
from celnav.receiver.rinex import Navigation, Observations, read_navigation, read_observations
from celnav.show.draw import Line, Panel, curve, panels
from celnav.study.study import Rngs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HALF_DAY_S = 43200.0
EPOCHS, AFTER = 40, 10
"""Epochs of the added noise burst, and epochs after it that are judged too."""
CONSECUTIVE_S = (1800.0, 5400.0)
"""Least and largest interval between the reference times of consecutive sets. Their positions are
compared half-way.
"""


class Files(NamedTuple):
    """A station's pair of RINEX files."""

    observations: Path
    navigation: Path


def found(folder: Path | None) -> Files | None:
    """The files in a folder, or in ``rinex`` here if no folder is given; None if that is absent.
    FileNotFoundError if the given folder has no such files.
    """
    where = Path("rinex") if folder is None else Path(folder)
    pair = (
        [sorted(where.glob(pattern)) for pattern in ("*_MO.*", "*_MN.*")]
        if where.is_dir()
        else [[], []]
    )
    if all(pair):
        return Files(pair[0][0], pair[1][0])
    if folder is None:
        return None
    raise FileNotFoundError(
        f"{where}: expected a RINEX observation file (*_MO.*) and a navigation file (*_MN.*)"
    )


def _read(files: Files) -> tuple[Observations, Navigation, Array]:
    """BeiDou observations of the first half day, broadcast elements, and the header's position
    ``(3,)`` m.
    """
    observations = read_observations(files.observations, strict=True).of("C")
    navigation = read_navigation(files.navigation, strict=True)
    reference = observations.reference()
    if reference is None:
        raise InputError(
            f"{files.observations}: expected the receiver's position in the header to compare "
            "with, got none"
        )
    half = observations.part(observations.times < observations.times[0] + HALF_DAY_S)
    return half, navigation, reference


def _prepared(half: Observations, navigation: Navigation, mask_deg: float) -> Log:
    """The log for filters that have to cope with a burst by themselves. No measurement is excluded,
    the noise has the assumed size, and no step of the clock counts as a reset.
    """
    log = prepare(half, navigation, mask_deg=mask_deg, sigma=GIVEN, false_alarm=0.0)
    return replace(log, clock=None)


def positioned(files: Files, filter: str, mask_deg: float) -> Positioned:
    """The receiver's track by a filter.

    Raises
    ------
    OSError, InputError: naming the file, if one cannot be read or has no position in its header.
    """
    half, navigation, reference = _read(files)
    return _positioned(_prepared(half, navigation, mask_deg), filter, reference)


def _positioned(log: Log, filter: str, reference: Array) -> Positioned:
    return position(log, filter, reference, acceleration=STILL, clock="crystal", false_alarm=0.0)


def run_filters(
    files: Files, rngs: Rngs, names: Sequence[str], sigma: float, mask_deg: float
) -> dict[str, Array]:
    """Errors of filters on the half day, without and with a burst: noise of ``sigma`` m on all
    ranges for `EPOCHS` in its middle.

    Returns
    -------
    times: ``(T,)`` s of BDT. during: ``(T,)``, the burst and `AFTER` epochs more.
    ``<filter>`` and ``burst/<filter>``, also for ls: east, north, up ``(T, 3)`` m from the header's
        position to that of the filter. nis: ``(1,)``, of the first filter, per degree of freedom.
    consecutive: distances (m) between positions of geostationary satellites by consecutive sets.
    others: distances (m) between their positions by the formula of other satellites and by their
        own formula, half an hour after the reference time.

    Raises
    ------
    OSError, InputError: naming the file, if one cannot be read or has no position in its header.
    """
    half, navigation, reference = _read(files)
    k, first, out = np.arange(len(half.times)), len(half.times) // 2, dict[str, Array]()
    noise = (
        sigma
        * rngs[0].standard_normal(half.code.shape)
        * ((k >= first) & (k < first + EPOCHS))[:, None]
    )
    for label, part in (("", half), ("burst/", replace(half, code=half.code + noise))):
        log = _prepared(part, navigation, mask_deg)
        tracks = {name: _positioned(log, name, reference) for name in ("ls", *names)}
        out |= {label + name: track.local(track.mean) for name, track in tracks.items()}
        if not label:
            during = half.times[(k >= first) & (k < first + EPOCHS + AFTER)]
            nis = np.array([tracks[names[0]].nis])
            out |= {"times": log.times, "during": np.isin(log.times, during), "nis": nis}
    own = navigation.sets.chosen(navigation.sets.geostationary & (navigation.sets.health == 0.0))
    own = own.chosen(np.lexsort((own.toe, own.number)))
    apart = np.where(np.diff(own.number) == 0.0, np.diff(own.toe), 0.0)
    k = np.flatnonzero((apart >= CONSECUTIVE_S[0]) & (apart <= CONSECUTIVE_S[1]))
    before, after = (
        satellites(own.chosen(rows), 0.5 * (own.toe[k] + own.toe[k + 1])).position
        for rows in (k, k + 1)
    )
    misplaced = as_others(own, own.toe + 1800.0) - satellites(own, own.toe + 1800.0).position
    out |= {
        "consecutive": np.linalg.norm(after - before, axis=-1),
        "others": np.linalg.norm(misplaced, axis=-1),
    }
    return out | judged(out)


def as_others(broadcast: Broadcast, t: Array | float) -> Array:
    """Positions ``(S, 3)`` m of geostationary satellites by the formula of other satellites: the
    Earth's rotation enters the node, and no plane is tilted.
    """
    return satellites(replace(broadcast, number=np.full(len(broadcast), 19.0)), t).position


def formulas(times: Sequence[float], _rngs: Rngs = ()) -> dict[str, Array]:
    """Distances ``(..., 5)`` m of the synthetic geostationary satellites, by several formulas, from
    their two-body orbits.

    others: by the formula of other satellites, at ``times`` (s) from half an hour after the
        reference time. minute, half hour: by that formula and one more rotation, so long after the
        reference time. right: with the node held in space, half an hour after the reference time.
    """
    own = synthetic()
    own = own.chosen(own.geostationary)

    def off(t: float, position: Array) -> Array:
        exact = [
            turned(1e3 * geostationary(n, t)[:3], ROTATION_RATE * np.array(t))
            for n in GEOSTATIONARY
        ]
        return np.asarray(np.linalg.norm(position - exact, axis=-1))

    def rotated(t: float) -> Array:
        return off(t, turned(tilted(as_others(own, TOE_S + t), -TILT), ROTATION_RATE * np.array(t)))

    along = np.add(1800.0, times).tolist()
    return {
        "others": np.stack([off(t, as_others(own, TOE_S + t)) for t in along]),
        "minute": rotated(60.0),
        "half hour": rotated(1800.0),
        "right": off(1800.0, satellites(own, TOE_S + 1800.0).position),
    }


def rms(found: Mapping[str, Array], key: str) -> float:
    """Root mean square distance (m) from the header's position. With the burst only the epochs in
    it and shortly after it count.
    """
    chosen = found["during"] if key.startswith("burst") else slice(None)
    return float(np.sqrt(np.nanmean(np.square(found[key][chosen]).sum(-1))))


JUDGED: dict[str, tuple[str, tuple[float | None, float | None]]] = {
    "ls": ("LS, RMS distance from the position in the header (m)", (None, 2.5)),
    "ekf": ("RMS distance of the EKF over that of LS", (None, 1.0)),
    "ukf": ("RMS distance of the UKF over that of LS", (None, 1.0)),
    "aukf": ("RMS distance of the AUKF over that of LS", (None, 1.0)),
    "group": ("RMS distance of group parity over that of LS", (None, 1.0)),
    "same": ("largest difference of EKF and UKF (m)", (None, 1e-3)),
    "burst": ("RMS distance of the AUKF over the UKF's in an added burst", (None, 0.5)),
    "nis": ("NIS of the EKF per measurement, with a generous R (1 if consistent)", (None, 0.1)),
    "consecutive": (
        "geostationary satellites, largest distance between consecutive sets (m)",
        (None, 2.0),
    ),
    "formula": (
        "geostationary satellites, least error of the other satellites' formula (km)",
        (1e3, None),
    ),
}
"""Quantities that are judged from the results of `run_filters`: label and accepted range."""


def judged(found: Mapping[str, Array]) -> dict[str, Array]:
    """Values ``(1,)`` of `JUDGED`; nan where the log has no such satellites."""
    ls = rms(found, "ls")
    values = {name: rms(found, name) / ls for name in ("ekf", "ukf", "aukf", "group")} | {
        "ls": ls,
        "nis": float(found["nis"][0]),
    }
    values |= {
        "burst": rms(found, "burst/aukf") / rms(found, "burst/ukf"),
        "same": np.abs(found["ekf"] - found["ukf"]).max(),
    }
    values |= {
        "consecutive": found["consecutive"].max(initial=-np.inf),
        "formula": 1e-3 * found["others"].min(initial=np.inf),
    }
    return {
        f"judged/{name}": np.array([value if np.isfinite(value) else np.nan])
        for name, value in values.items()
    }


def drawn(found: Mapping[str, Array], lines: Mapping[str, Line], sigma: float) -> Figure:
    """Figure of the half day and of the burst; ``lines``: how each filter is drawn."""
    hours, late = (found["times"] - found["times"][0]) / 3600.0, np.flatnonzero(found["during"])
    shown = slice(max(late[0] - 10, 0), late[-1] + 20)
    known = {name: line for name, line in lines.items() if name in found}
    two = {name: lines[name] for name in ("ls", "aukf")}
    dots = dict[str, Any](linestyle="", marker=".", ms=3, label=None)
    return panels(
        Panel(
            "position from the header's",
            [
                curve(found[name][:, 0], found[name][:, 1], line, **dots)
                for name, line in two.items()
            ],
            "east (m)",
            "north (m)",
            more={"aspect": "equal"},
        ),
        Panel(
            f"height; the RMS error of LS is {rms(found, 'ls'):.2f} m",
            [curve(hours, found[name][:, 2], line) for name, line in two.items()],
            "time (h)",
            "up (m)",
        ),
        Panel(
            f"{sigma:g} m of noise added to the ranges",
            [
                curve(hours[shown], np.linalg.norm(found[f"burst/{name}"][shown], axis=-1), line)
                for name, line in known.items()
            ],
            "time (h)",
            "distance (m)",
            "y",
        ),
        title="Figure 14 (not in the paper): half a day of a real receiver",
    )
