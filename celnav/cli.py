"""The command line: ``celnav list | reproduce | verdicts | view | run | campaign | position``."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import sys
from collections.abc import Sequence

import celnav
from celnav.commands.arguments import UsageError
from celnav.files import InputError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        options = _parser().parse_args(arguments)
        status: int = importlib.import_module(f"celnav.commands.{options.module}").run(options)
        sys.stdout.flush()
        return status
    except UsageError as error:
        print(f"celnav: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (OSError, ImportError, InputError) as error:
        print(f"celnav: {_told(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("celnav: interrupted", file=sys.stderr)
        return 130


def _told(error: Exception) -> str:
    """The error as a sentence, with the file first: without numbers of the operating system."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror[0].lower()}{error.strerror[1:]}"
    return str(error)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="celnav", description=(celnav.__doc__ or "").partition("\n")[0])
    parser.add_argument("--version", action="version", version=f"celnav {celnav.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, help: str, module: str | None = None) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=help, description=help)
        added.set_defaults(module=module or name)
        return added

    lists = command("list", "papers, figures, filters and rules, or the parameters of a paper")
    lists.add_argument("paper", nargs="?", metavar="PAPER", help="whose parameters (none: everything else)")

    reproduce = command("reproduce", "run papers; write figures, tables, claims and recordings")
    reproduce.add_argument("papers", nargs="*", metavar="PAPER", help="which papers (none: all)")
    reproduce.add_argument("--seed", default="0", metavar="S", help="seed, a whole number that is not negative (default: 0)")
    reproduce.add_argument("--out", default="out", metavar="DIR", help="where to write (default: out)")
    reproduce.add_argument("--strict", action="store_true", help="exit 1 if a claim is not as expected")
    reproduce.add_argument("--rinex", metavar="DIR", help="folder of a receiver's RINEX files, for aukf (default: rinex, if there)")

    mission = command("run", "fly a mission: figures, a table and a recording", "mission")
    mission.add_argument("mission", metavar="MISSION.toml", help="a paper's parameters with your changes; see data/missions")
    mission.add_argument("--out", metavar="DIR", help="where to write (default: out/missions/NAME, NAME of the file)")

    campaign = command("campaign", "sweep a study's lists: table, figures and a page; run again to resume")
    campaign.add_argument("study", metavar="STUDY.toml", help="a mission with lists of values")
    campaign.add_argument("--out", metavar="DIR", help="its store and results (default: out/campaigns/NAME)")
    campaign.add_argument(
        "--executor", default="processes", choices=("processes", "dask"), help="where to work (default: processes)"
    )
    campaign.add_argument("--address", metavar="tcp://HOST:PORT", help="a running Dask scheduler (default: one is started here)")

    for each in (reproduce, mission, campaign):
        each.add_argument("--jobs", metavar="N", help="processes (default: one for each core)")
        each.add_argument(
            "--effort", metavar="F", help="fraction of the Monte-Carlo runs, 0 < F <= 1 (default: CELNAV_EFFORT, or 1)"
        )

    verdicts = command("verdicts", "count what holds in the papers that were reproduced, as a table")
    verdicts.add_argument("--out", default="out", metavar="DIR", help="where reproduce wrote (default: out)")

    view = command("view", "open a recording in the Rerun viewer, offline")
    view.add_argument("paper", metavar="PAPER|FILE.rrd", help="a paper that was reproduced, or a file")
    view.add_argument("--out", default="out", metavar="DIR", help="where reproduce wrote (default: out)")
    view.add_argument(
        "--recording", metavar="NAME", help="which of a paper's recordings (default: the one that the page shows first)"
    )
    view.add_argument("--picture", metavar="FILE.png", help="write a picture instead of opening a window; needs no display")
    view.add_argument("--at", metavar="S", help="time in the recording that a picture shows, s (default: its end)")

    position = command("position", "position a BeiDou receiver from its RINEX 3 files")
    position.add_argument("observations", metavar="OBS", help="observation file, plain, .gz or .crx")
    position.add_argument("navigation", metavar="NAV", help="navigation file of the same day")
    position.add_argument(
        "--filter",
        default="aukf",
        metavar="NAME",
        help="ls, ekf, ukf, aukf, group, channel, gate, huber, student or sage-husa (default: aukf)",
    )
    position.add_argument(
        "--position",
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="known position of the marker, m, Earth-fixed; the header's offset of the antenna is added (default: the header's)",
    )
    position.add_argument("--mask", default="10", metavar="DEG", help="least elevation of satellites (default: 10)")
    position.add_argument(
        "--acceleration-noise", default="0.01", metavar="Q", help="m^2/s^3; a^2 T for accelerations a each T s (default: 0.01)"
    )
    position.add_argument(
        "--sigma",
        nargs=2,
        metavar=("RANGE", "RATE"),
        help="deviations at the zenith, m and m/s, that grow by 1/sin(elevation) (default: estimated from residuals)",
    )
    position.add_argument(
        "--false-alarm",
        default="1e-5",
        metavar="P",
        help="probability that a sound epoch fails the test for faulty satellites; 0: no test (default: 1e-5)",
    )
    position.add_argument("--out", default="out/position", metavar="DIR", help="where to write (default: out/position)")
    return parser
