"""``celnav position``: the positions of a receiver, from its files."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from celnav.commands.arguments import UsageError, number, warn
from celnav.commands.terminal import paragraph
from celnav.files import InputError, Outputs
from celnav.lazy import require

if TYPE_CHECKING:
    from celnav.gaussian.linalg import Array

NO_TRACKS = (".kml", ".gpx", ".json", ".txt")
"""Suffixes that are an error, because they are neither a format nor a likely folder name."""


def run(options: argparse.Namespace) -> int:
    """Compute a receiver's positions, then write the outputs."""
    import numpy as np

    from celnav.filters.records import FilterError
    from celnav.receiver import filters as positioning_filters
    from celnav.receiver import position as positioning
    from celnav.receiver import report as positioning_report
    from celnav.receiver import rinex
    from celnav.receiver.integrity import probability
    from celnav.receiver.sky import on_earth
    from celnav.receiver.tracks import FORMATS

    mask, noise = number("mask", options.mask), None
    if options.acceleration_noise != "auto":
        noise = number("acceleration-noise", options.acceleration_noise)
        density = noise
        _checked(
            "--acceleration-noise", lambda: positioning_filters.filters(4, acceleration=density)
        )
    alarm = number("false-alarm", options.false_alarm)
    antenna = (
        None
        if options.position is None
        else np.array([number("position", text) for text in options.position])
    )
    sigma = None if options.sigma is None else [number("sigma", text) for text in options.sigma]
    _checked("--mask", lambda: positioning.mask(mask))
    _checked("--false-alarm", lambda: probability(alarm))
    _checked("--sigma", lambda: positioning.deviations(sigma))
    if antenna is not None:
        _checked("--position", partial(on_earth, "position", antenna))
    names = ["ls", *positioning_filters.filters(4)]
    if options.filter not in names:
        raise UsageError(f"--filter: expected one of {', '.join(names)}, got {options.filter!r}")
    clocks = [*positioning_filters.CLOCKS, "auto"]
    if options.clock not in clocks:
        raise UsageError(f"--clock: expected one of {', '.join(clocks)}, got {options.clock!r}")
    systems = None if options.systems is None else options.systems.replace(",", "").upper()
    _checked("--systems", lambda: positioning.chosen(systems))
    out = Path(options.out)
    track = FORMATS.get(out.suffix.lower())
    if out.suffix.lower() in NO_TRACKS:
        raise UsageError(
            f"--out: expected a folder, or a file with one of {', '.join(FORMATS)}, got "
            f"{options.out!r}"
        )
    if track is None:
        require("position with figures", "papers", "matplotlib", "PIL")
    outputs = Outputs(out if track is None else out.parent)
    outputs.check(
        [*positioning_report.FILES, positioning_report.RECORDING] if track is None else [out.name]
    )
    ionosphere = None if options.ion is None else _ionosphere(options.ion)
    navigation, observations = (
        rinex.read_navigation(*options.navigation, strict=options.strict),
        rinex.read_observations(options.observations, strict=options.strict),
    )
    if ionosphere is not None:
        navigation = replace(navigation, klobuchar=ionosphere)
    log = positioning.prepare(
        observations, navigation, systems=systems, mask_deg=mask, sigma=sigma, false_alarm=alarm
    )
    # A moving receiver cannot be compared with the single position in its header.
    reference = None
    if antenna is not None or not log.moved:
        reference = observations.reference(antenna)
    east, north, up = observations.antenna
    source = "the header" if antenna is None else "--position"
    of = f"the marker's by {source} and the header's offset, {east:.3f} m east, "
    of += f"{north:.3f} north, {up:.3f} up"
    try:
        result = positioning_report.position(
            log,
            options.filter,
            reference,
            acceleration=noise,
            clock=options.clock,
            false_alarm=alarm,
            of=of,
        )
    except FilterError as error:
        raise InputError(
            f"{options.filter} failed on {options.observations}: "
            f"{str(error).partition(' (on_failure')[0]}"
        ) from None
    paragraph(positioning_report.summary(result), 13)
    status = 0
    if options.strict:
        status = 3 if result.distrusted.any() else int(result.doubtful.any())
    if track is not None:
        outputs.text(out.name, track(result))
        print(f"wrote {out}")
        return status
    positioning_report.write(result, outputs)
    try:
        with outputs.path_for(positioning_report.RECORDING) as path:
            positioning_report.record_positioned(result, path)
    except (ImportError, OSError, RuntimeError, ValueError) as error:  # e.g. a single epoch
        warn(f"no recording ({error}); everything else is written")
    print(f"wrote {outputs.directory}")
    return status


def _ionosphere(text: str) -> tuple[Array, Array]:
    """Klobuchar's coefficients from a file's header or from eight numbers."""
    from celnav.receiver.rinex import ionosphere, read_ionosphere

    parts = text.split(",")
    if len(parts) == 1 or Path(text).exists():
        return read_ionosphere(text)
    if len(parts) != 8:
        raise UsageError(
            "--ion: expected a navigation file, or eight numbers with commas between, got "
            f"{len(parts)}"
        )
    return ionosphere("--ion", [number("ion", part) for part in parts])


def _checked(option: str, check: Callable[[], object]) -> None:
    """Run a check, and raise its ValueError as a UsageError that names the option."""
    try:
        check()
    except ValueError as error:
        raise UsageError(f"{option}: {str(error).partition(': ')[2]}") from None
