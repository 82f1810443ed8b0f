"""A day of a real receiver: what the filters do with it, what a burst that is added does, and the orbits it was sent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from celnav.files import InputError
from celnav.filters.run import run
from celnav.gaussian.linalg import Array
from celnav.models.beidou import GEO_NUMBERS, Broadcast, satellites
from celnav.papers.aukf.config import Config
from celnav.receiver.filters import filters
from celnav.receiver.fixes import GIVEN
from celnav.receiver.position import Log, prepare
from celnav.receiver.report import Positioned
from celnav.receiver.rinex import Navigation, Observations, read_navigation, read_observations

OBSERVATIONS, NAVIGATION = "*_MO.*", "*_MN.*"
"""Names of a station's files."""
FOLDER = Path("rinex")
"""Where the files are looked for if no folder is named."""
HALF_DAY_S = 43200.0
FILTERS = ("ekf", "ukf", "aukf", "group")
EPOCHS = 40
"""Length of the burst that is added to the ranges; ten more epochs are judged."""
CONSECUTIVE_S = (1800.0, 5400.0)
"""How far apart reference times of consecutive sets may be; positions are compared half-way."""


class Real(NamedTuple):
    """Of the first half day, times in s of BDT.

    Attributes
    ----------
    log: what the filters took. reference: ``(3,)`` m, of the header. tracks: means ``(T, 8)`` by filter, also "ls"; cov:
        ``(T, 3, 3)`` of AUKF's positions. nis: of the EKF, per degree of freedom. burst: means with the burst added.
    during: mask ``(T,)`` of the burst and the ten epochs after it. apart: distances (m) between positions by consecutive sets, by
        satellite. wrong: distances (m) between positions of geostationary satellites by the others' formula and by their own.
    """

    log: Log
    reference: Array
    tracks: dict[str, Array]
    cov: Array
    nis: float
    burst: dict[str, Array]
    during: Array
    apart: dict[str, Array]
    wrong: Array

    def positioned(self) -> Positioned:
        """As `celnav.receiver.report.position` has it, by AUKF."""
        return Positioned(self.log, "aukf", self.tracks["aukf"], self.cov, self.reference)


def found(folder: Path | None) -> tuple[Path, Path] | None:
    """A station's two files in a folder; None if no folder is named and there is none of the usual name.

    Raises
    ------
    FileNotFoundError: if a folder is named that has no such files.
    """
    where = FOLDER if folder is None else Path(folder)
    pair = [sorted(where.glob(pattern)) for pattern in (OBSERVATIONS, NAVIGATION)] if where.is_dir() else [[], []]
    if all(pair):
        return pair[0][0], pair[1][0]
    if folder is None:
        return None
    raise FileNotFoundError(f"{where}: expected a RINEX observation file ({OBSERVATIONS}) and a navigation file ({NAVIGATION})")


def real(config: Config, rng: np.random.Generator, folder: Path | None = None) -> Real | None:
    """Position the receiver; None if its files are absent.

    Raises
    ------
    OSError, InputError: naming the file, if one cannot be read or has no position in its header.
    """
    files = found(folder)
    if files is None:
        return None
    observations, navigation = read_observations(files[0]), read_navigation(files[1])
    reference = observations.reference()
    if reference is None:
        raise InputError(f"{files[0]}: expected the receiver's position in the header to compare with, got none")
    half = observations.part(observations.times < observations.times[0] + HALF_DAY_S)
    hit, during = disturbed(half, config.burst_sigma, rng)
    # What a burst does is the filters' to weather: nothing is excluded, and the noise is what is taken for it.
    log, other = (prepare(part, navigation, mask_deg=config.mask_deg, sigma=GIVEN, false_alarm=0.0) for part in (half, hit))
    known = filters(len(log.names), window=config.window)
    out: dict[str, Any] = {"tracks": {"ls": log.fixes}, "burst": {"ls": other.fixes}}
    for name in FILTERS:
        track = run(known[name], log.prior(), log.epochs(), keep="cov")
        out["tracks"][name] = track.mean
        if name == "aukf":
            out["cov"] = track.cov[:, :3, :3]
        elif name == "ekf":
            out["nis"] = float(track.nis.sum() / track.dof.sum())
        out["burst"][name] = run(known[name], other.prior(), other.epochs(), keep="mean").mean
    during = np.isin(log.times, half.times[during])
    return Real(log, reference, during=during, apart=consecutive(navigation), wrong=misplaced(navigation), **out)


def disturbed(observations: Observations, sigma: float, rng: np.random.Generator) -> tuple[Observations, Array]:
    """The log with noise added to all ranges for `EPOCHS` in its middle, and the mask of what is judged."""
    k, first = np.arange(len(observations.times)), len(observations.times) // 2
    hit = (k >= first) & (k < first + EPOCHS)
    noise = sigma * rng.standard_normal(observations.code.shape) * hit[:, None]
    return replace(observations, code=observations.code + noise), (k >= first) & (k < first + EPOCHS + 10)


def consecutive(navigation: Navigation) -> dict[str, Array]:
    """Distances (m) between positions half-way by consecutive healthy sets, by satellite."""
    out = {}
    for name in sorted(set(navigation.sets.names)):
        own = navigation.sets.chosen((np.array(navigation.sets.names) == name) & (navigation.sets.health == 0.0))
        apart = np.diff(own.toe)
        k = np.flatnonzero((apart >= CONSECUTIVE_S[0]) & (apart <= CONSECUTIVE_S[1]))
        if k.size:
            middle = 0.5 * (own.toe[k] + own.toe[k + 1])
            before, after = (satellites(own.chosen(rows), middle).position for rows in (k, k + 1))
            out[name] = np.linalg.norm(after - before, axis=-1)
    return out


def as_others(broadcast: Broadcast, t: Array | float) -> Array:
    """Positions ``(S, 3)`` of geostationary satellites by the formula of the others: the Earth's turn in the node, no tilt."""
    state = satellites(replace(broadcast, number=np.full(len(broadcast), 19.0)), t)
    return state.position


def misplaced(navigation: Navigation) -> Array:
    """Distances (m) between positions of geostationary satellites by the others' formula and by their own, half an hour on."""
    sets = navigation.sets
    own = sets.chosen(np.isin(sets.number, sorted(GEO_NUMBERS)) & (sets.health == 0.0))
    t = own.toe + 1800.0
    return np.asarray(np.linalg.norm(as_others(own, t) - satellites(own, t).position, axis=-1))
