"""How much of a study to run: the one place where ``CELNAV_EFFORT`` is read."""

from __future__ import annotations

import os


def effort(value: str | float | None = None) -> float:
    """A fraction in (0, 1] of the Monte-Carlo runs: the argument, else ``CELNAV_EFFORT``, else 1.

    Raises
    ------
    ValueError: naming where a bad value came from.
    """
    name, given = ("effort", value) if value is not None else ("CELNAV_EFFORT", os.environ.get("CELNAV_EFFORT", "1"))
    try:
        fraction = float(given)
    except (TypeError, ValueError):
        fraction = 0.0
    if not 0.0 < fraction <= 1.0:
        raise ValueError(f"{name}: expected a number in (0, 1], got {given!r}")
    return fraction
