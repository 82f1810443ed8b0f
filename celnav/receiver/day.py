"""Half a day of a station: filters on its log, with and without an added noise burst, and a
comparison of broadcast orbits.
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
"""Number of epochs in the added noise burst, and of epochs after it that are evaluated too."""
CONSECUTIVE_S = (1800.0, 5400.0)
"""Least and largest interval between the reference times of consecutive sets, s. Their positions
are compared in the middle.
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
    """The log for filters that must handle a burst without other help. No measurement is excluded,
    the noise has the assumed size, and no clock step is treated as a reset.
    """
    log = prepare(half, navigation, mask_deg=mask_deg, sigma=GIVEN, false_alarm=0.0)
    return replace(log, clock=None)


def positioned(files: Files, filter: str, mask_deg: float) -> Positioned:
    """The receiver's track from a filter.

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
    """Errors of filters on the half day, without and with a burst: for `EPOCHS` epochs in the
    middle, all ranges have added noise of ``sigma`` m.

    Returns
    -------
    times: ``(T,)`` s of BDT. during: ``(T,)`` bool, the burst and `AFTER` further epochs.
    ``<filter>`` and ``burst/<filter>``, also for ls: east, north, up ``(T, 3)`` m of the filter's
    position from the header's position. nis: ``(1,)``, NIS of the first filter per degree of
    freedom.
    consecutive: distances (m) between positions of geostationary satellites from consecutive sets.
    others: distances (m) between positions of geostationary satellites from the formula for other
        satellites and from the formula for geostationary satellites, half an hour after the
        reference time.

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
    for label, observations in (("", half), ("burst/", replace(half, code=half.code + noise))):
        log = _prepared(observations, navigation, mask_deg)
        tracks = {name: _positioned(log, name, reference) for name in ("ls", *names)}
        out |= {label + name: track.local(track.mean) for name, track in tracks.items()}
        if not label:
            during = half.times[(k >= first) & (k < first + EPOCHS + AFTER)]
            nis = np.array([tracks[names[0]].nis])
            out |= {"times": log.times, "during": np.isin(log.times, during), "nis": nis}
    sets = navigation.sets.chosen(navigation.sets.geostationary & (navigation.sets.health == 0.0))
    sets = sets.chosen(np.lexsort((sets.toe, sets.number)))
    apart = np.where(np.diff(sets.number) == 0.0, np.diff(sets.toe), 0.0)
    k = np.flatnonzero((apart >= CONSECUTIVE_S[0]) & (apart <= CONSECUTIVE_S[1]))
    before, after = (
        satellites(sets.chosen(rows), 0.5 * (sets.toe[k] + sets.toe[k + 1])).position
        for rows in (k, k + 1)
    )
    misplaced = as_others(sets, sets.toe + 1800.0) - satellites(sets, sets.toe + 1800.0).position
    out |= {
        "consecutive": np.linalg.norm(after - before, axis=-1),
        "others": np.linalg.norm(misplaced, axis=-1),
    }
    return out | judged(out)


def as_others(broadcast: Broadcast, t: Array | float) -> Array:
    """Positions ``(S, 3)`` m of geostationary satellites from the formula for other satellites: the
    Earth's rotation enters the node, and no plane is tilted.
    """
    return satellites(replace(broadcast, number=np.full(len(broadcast), 19.0)), t).position


def formulas(times: Sequence[float], _rngs: Rngs = ()) -> dict[str, Array]:
    """Distances ``(..., 5)`` m between positions of the synthetic geostationary satellites from
    several formulas and their two-body orbits.

    others: the formula for other satellites, at ``times`` (s) counted from half an hour after the
        reference time. minute, half hour: the same formula with one more rotation, one minute and
        half an hour after the reference time. right: the node fixed in inertial space, half an hour
        after the reference time.
    """
    sets = synthetic()
    sets = sets.chosen(sets.geostationary)

    def off(t: float, position: Array) -> Array:
        exact = [
            turned(1e3 * geostationary(n, t)[:3], ROTATION_RATE * np.array(t))
            for n in GEOSTATIONARY
        ]
        return np.asarray(np.linalg.norm(position - exact, axis=-1))

    def rotated(t: float) -> Array:
        return off(
            t, turned(tilted(as_others(sets, TOE_S + t), -TILT), ROTATION_RATE * np.array(t))
        )

    along = np.add(1800.0, times).tolist()
    return {
        "others": np.stack([off(t, as_others(sets, TOE_S + t)) for t in along]),
        "minute": rotated(60.0),
        "half hour": rotated(1800.0),
        "right": off(1800.0, satellites(sets, TOE_S + 1800.0).position),
    }


def rms(results: Mapping[str, Array], key: str) -> float:
    """Root mean square distance (m) from the header's position; with the burst only over the epochs
    in it and shortly after it.
    """
    chosen = results["during"] if key.startswith("burst") else slice(None)
    return float(np.sqrt(np.nanmean(np.square(results[key][chosen]).sum(-1))))


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
"""Quantities from the results of `run_filters` that claims refer to: label and accepted range."""


def judged(results: Mapping[str, Array]) -> dict[str, Array]:
    """Values ``(1,)`` of `JUDGED`; nan where the log has no such satellites."""
    ls = rms(results, "ls")
    values = {name: rms(results, name) / ls for name in ("ekf", "ukf", "aukf", "group")} | {
        "ls": ls,
        "nis": float(results["nis"][0]),
    }
    values |= {
        "burst": rms(results, "burst/aukf") / rms(results, "burst/ukf"),
        "same": np.abs(results["ekf"] - results["ukf"]).max(),
    }
    values |= {
        "consecutive": results["consecutive"].max(initial=-np.inf),
        "formula": 1e-3 * results["others"].min(initial=np.inf),
    }
    return {
        f"judged/{name}": np.array([value if np.isfinite(value) else np.nan])
        for name, value in values.items()
    }


def drawn(results: Mapping[str, Array], lines: Mapping[str, Line], sigma: float) -> Figure:
    """Figure of the half day and of the burst; ``lines``: how each filter is drawn."""
    hours, late = (
        (results["times"] - results["times"][0]) / 3600.0,
        np.flatnonzero(results["during"]),
    )
    shown = slice(max(late[0] - 10, 0), late[-1] + 20)
    styles = {name: line for name, line in lines.items() if name in results}
    two = {name: lines[name] for name in ("ls", "aukf")}
    dots = dict[str, Any](linestyle="", marker=".", ms=3, label=None)
    return panels(
        Panel(
            "position from the header's",
            [
                curve(results[name][:, 0], results[name][:, 1], line, **dots)
                for name, line in two.items()
            ],
            "east (m)",
            "north (m)",
            more={"aspect": "equal"},
        ),
        Panel(
            f"3-D RMS of LS {rms(results, 'ls'):.2f} m",
            [curve(hours, results[name][:, 2], line) for name, line in two.items()],
            "hours",
            "up (m)",
        ),
        Panel(
            f"with {sigma:g} m added to the ranges",
            [
                curve(hours[shown], np.linalg.norm(results[f"burst/{name}"][shown], axis=-1), line)
                for name, line in styles.items()
            ],
            "hours",
            "distance (m)",
            "y",
        ),
        height=2.1,
    )
