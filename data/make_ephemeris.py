"""Make ``ephemeris_2015.npz``: Earth and Sun by four ephemerides at 1753 instants, every 5 h from 2015-10-17 04:00 UTC.

    python data/make_ephemeris.py FOLDER

FOLDER holds the unpacked source packages de405-1997.1, de406-1997.1, de421-2008.1 and de423-2010.1 of the package index. The
table holds DE421 (from these arrays) and the others less DE421, km, barycentric, ICRS axes.
"""

import sys
from pathlib import Path

import numpy as np

from celnav.models.ephemeris import Arrays
from celnav.models.time import from_utc

PACKAGES = {"de405": "1997.1", "de406": "1997.1", "de421": "2008.1", "de423": "2010.1"}


def main(folder: str) -> None:
    """Read the packages and write the table beside this script."""
    dates = from_utc("2015-10-17T04:00:00").after(18000.0 * np.arange(1753))
    states = {
        name: {body: Arrays(Path(folder) / f"{name}-{version}" / name).state(body, dates).position for body in ("earth", "sun")}
        for name, version in PACKAGES.items()
    }
    table = {"day": np.asarray(dates.day), "rest": np.asarray(dates.rest)}
    for body in ("earth", "sun"):
        table[f"de421/{body}"] = states["de421"][body]
        for name in ("de405", "de406", "de423"):
            table[f"{name}-de421/{body}"] = states[name][body] - states["de421"][body]
    np.savez(Path(__file__).with_name("ephemeris_2015.npz"), allow_pickle=False, **table)


if __name__ == "__main__":
    main(sys.argv[1])
