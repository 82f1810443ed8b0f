"""``celnav position``: where a receiver was, from its files."""

from __future__ import annotations

import argparse
import sys

from celnav.commands.arguments import UsageError, number
from celnav.files import InputError, Outputs


def run(options: argparse.Namespace) -> int:
    """Everything is computed before anything is written."""
    import numpy as np

    from celnav import positioning, positioning_filters, positioning_report, rinex
    from celnav.filters.driver import FilterError
    from celnav.models.receiver import on_earth

    mask, noise = number("mask", options.mask), number("acceleration-noise", options.acceleration_noise)
    given = None if options.position is None else np.array([number("position", text) for text in options.position])
    try:
        positioning.mask(mask)
        names = ["ls", *positioning_filters.filters(4, acceleration=noise)]
        if given is not None:
            on_earth("position", given)
    except ValueError as error:
        raise UsageError(error) from None
    if options.filter not in names:
        raise UsageError(f"unknown filter {options.filter!r}: expected one of {', '.join(names)}")
    outputs = Outputs(options.out)
    outputs.check([*positioning_report.FILES, positioning_report.RECORDING])
    navigation, observations = rinex.read_navigation(options.navigation), rinex.read_observations(options.observations)
    log = positioning.prepare(observations, navigation, mask_deg=mask)
    reference = observations.reference(given)
    try:
        found = positioning_report.position(log, options.filter, reference, acceleration=noise)
    except FilterError as error:
        raise InputError(f"{options.filter} is lost on {options.observations}: {str(error).partition(' (on_failure')[0]}") from None
    print(positioning_report.summary(found))
    positioning_report.write(found, outputs)
    try:
        with outputs.path_for(positioning_report.RECORDING) as path:
            positioning_report.record_positioned(found, path)
    except (ImportError, OSError, RuntimeError, ValueError) as error:  # of one epoch there is none
        print(f"celnav: no recording ({error}); everything else is written", file=sys.stderr)
    print(f"wrote {outputs.directory}")
    return 0
