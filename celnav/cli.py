"""The command line: ``celnav new | list | reproduce | verdicts | view | run | campaign | position | diagnose``."""

from __future__ import annotations

import argparse
import difflib
import errno
import importlib
import io
import itertools
import os
import sys
from collections.abc import Iterable, Sequence
from typing import NoReturn

import celnav
from celnav import real
from celnav.commands.arguments import UsageError
from celnav.files import ForeignFileError, InputError
from celnav.filters.run import ENGINES
from celnav.lazy import require
from celnav.papers.own import told
from celnav.tape.cuda import CudaError

__all__ = ["NEEDS", "main"]

EXIT = "Exit status: 0, done; 1, it could not be done; 2, what was given cannot be used; 130, interrupted."
BAD_INPUT = (
    InputError,
    ForeignFileError,
    FileNotFoundError,
    IsADirectoryError,
    NotADirectoryError,
    PermissionError,
)
"""What was given cannot be used, files and folders too: the exit status is 2."""
PAPERS = ("papers", "jplephem", "erfa", "skyfield_data", "pymap3d", "threadpoolctl")
RESULTS = ("papers", "matplotlib", "PIL", "tqdm", "filelock", *PAPERS[1:])
NEEDS = {
    "list": PAPERS,
    "verdicts": PAPERS,
    "reproduce": RESULTS,  # without rerun it says that there are no recordings
    "run": (*RESULTS, "pyarrow"),
    "campaign": (*RESULTS, "pyarrow"),
    "view": ("record", "rerun", "PIL"),
    "position": ("rinex", "pymap3d", "erfa"),
}
"""Commands that need more than numpy and scipy: the extra that brings it, and packages without which they would end."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        options = _options(sys.argv[1:] if arguments is None else arguments)
        if options.needs:
            require(*options.needs)
        status: int = importlib.import_module(f"celnav.commands.{options.module}").run(options)
        sys.stdout.flush()
        return status
    except UsageError as error:
        print(f"celnav: {error}", file=sys.stderr)
        return 2
    except (OSError, ImportError, InputError, CudaError) as error:
        if _nobody_reads(error):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        print(f"celnav: {told(error) or _told(error)}", file=sys.stderr)
        return 2 if isinstance(error, BAD_INPUT) else 1
    except MemoryError as error:
        print(
            f"celnav: not enough memory ({error}); fewer runs at once, or fewer --jobs, need less",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print("celnav: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        if not (line := told(error)):
            raise
        print(f"celnav: {line}", file=sys.stderr)
        return 1


def _nobody_reads(error: Exception) -> bool:
    """Whether the pipe that we write to is closed, which Windows calls an invalid argument."""
    windows = (
        sys.platform == "win32"
        and isinstance(error, OSError)
        and error.errno == errno.EINVAL
        and error.filename is None
    )
    return windows or isinstance(error, BrokenPipeError)


def _told(error: Exception) -> str:
    """The error as a sentence, with the file first: without numbers of the operating system."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror[0].lower()}{error.strerror[1:]}"
    return str(error)


class _Parser(argparse.ArgumentParser):
    """Its mistakes are one line, like all others."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")


def _options(words: Sequence[str]) -> argparse.Namespace:
    """What the words ask for; UsageError names what is nearest to one that is unknown."""
    parser, commands = _parser()
    if not words:
        parser.print_help()
        raise SystemExit(0)
    name = words[0]
    if not name.startswith("-") and name not in commands:
        raise UsageError(
            f"unknown command {name!r}: expected one of {', '.join(commands)}{_nearest(name, commands)}"
        )
    told = commands.get(name, parser)
    for word in itertools.takewhile(lambda word: word != "--", words):
        option, flags = (
            word.partition("=")[0],
            [flag for flag in told._option_string_actions if flag.startswith("--")],
        )
        if word.startswith("--") and not any(flag.startswith(option) for flag in flags):
            raise UsageError(
                f"unknown option {option}{_nearest(option, flags)}; see {told.prog} --help"
            )
    options, rest = parser.parse_known_args(words)
    if rest:
        raise UsageError(f"expected nothing more, got {rest[0]!r}; see {told.prog} --help")
    return options


def _nearest(word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, known, 1)
    return f"; did you mean {close[0]}?" if close else ""


def _parser() -> tuple[_Parser, dict[str, _Parser]]:
    """The parser, and those of the commands by name."""
    parser = _Parser(
        prog="celnav", description=(celnav.__doc__ or "").partition("\n")[0], epilog=EXIT
    )
    parser.add_argument("--version", action="version", version=f"celnav {celnav.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, help: str, module: str | None = None) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=help, description=help)
        added.set_defaults(
            module=module or name, needs=(name, *NEEDS[name]) if name in NEEDS else ()
        )
        return added

    new = command("new", "write a study of your own to begin with: one that runs, to be changed")
    new.add_argument("file", metavar="FILE.py", help="where to; nothing is overwritten")

    lists = command("list", "papers, figures, filters and rules, or the parameters of a paper")
    lists.add_argument(
        "paper",
        nargs="?",
        metavar="PAPER",
        help="or FILE.py; whose parameters (none: everything else)",
    )

    reproduce = command(
        "reproduce",
        "run papers, studies of your own or on real data; write figures, tables, claims, recordings",
    )
    reproduce.add_argument(
        "papers",
        nargs="*",
        metavar="PAPER|FILE.py",
        help="which ones, also studies of your own, see celnav new (none: all papers, and the studies whose data are given)",
    )
    reproduce.add_argument(
        "--seed",
        default="0",
        metavar="S",
        help="seed, a whole number that is not negative (default: 0)",
    )
    reproduce.add_argument(
        "--out", default="out", metavar="DIR", help="where to write (default: out)"
    )
    reproduce.add_argument(
        "--engine", default="auto", choices=ENGINES, help="what flies the filters (default: auto)"
    )
    reproduce.add_argument(
        "--strict",
        action="store_true",
        help="exit 1 if a verdict is not the expected one; with all runs this includes undecided verdicts",
    )
    reproduce.add_argument(
        "--rinex",
        metavar="DIR",
        help="folder of a receiver's RINEX files, for aukf (default: rinex, if there)",
    )
    for study, holds in real.STUDIES.items():
        reproduce.add_argument(
            f"--{study}", metavar="DIR", help=f"for the study {study}: folder of {holds}"
        )

    mission = command("run", "fly a mission: figures, a table and a recording", "mission")
    mission.add_argument(
        "mission",
        metavar="MISSION.toml",
        help="parameters of a paper, or of a study of your own, with your changes; see data/missions",
    )
    mission.add_argument(
        "--out", metavar="DIR", help="where to write (default: out/missions/NAME, NAME of the file)"
    )

    campaign = command(
        "campaign",
        "sweep a study's lists: table, figures and a page; run again to resume, or to grow",
    )
    campaign.add_argument("study", metavar="STUDY.toml", help="a mission with lists of values")
    campaign.add_argument(
        "--out", metavar="DIR", help="its store and results (default: out/campaigns/NAME)"
    )
    campaign.add_argument(
        "--executor",
        default="processes",
        choices=("processes", "dask"),
        help="where to work (default: processes)",
    )
    campaign.add_argument(
        "--address",
        metavar="tcp://HOST:PORT",
        help="a running Dask scheduler (default: one is started here)",
    )

    for each in (reproduce, mission, campaign):
        each.add_argument("--jobs", metavar="N", help="processes (default: one for each core)")
        each.add_argument(
            "--effort",
            metavar="F",
            help="fraction of the Monte-Carlo runs, 0 < F <= 1 (default: CELNAV_EFFORT, or 1)",
        )

    verdicts = command(
        "verdicts", "count what holds in the papers that were reproduced, as a table"
    )
    verdicts.add_argument(
        "--out", default="out", metavar="DIR", help="where reproduce wrote (default: out)"
    )

    view = command("view", "open a recording in the Rerun viewer, offline")
    view.add_argument(
        "paper",
        metavar="PAPER|FILE.rrd",
        help="a paper or study (FILE.py) that was reproduced, or a recording",
    )
    view.add_argument(
        "--out", default="out", metavar="DIR", help="where reproduce wrote (default: out)"
    )
    view.add_argument(
        "--recording",
        metavar="NAME",
        help="which of a paper's recordings (default: the one that the page shows first)",
    )
    view.add_argument(
        "--picture",
        metavar="FILE.png",
        help="write a picture instead of opening a window; needs no display",
    )
    view.add_argument(
        "--at", metavar="S", help="time in the recording that a picture shows, s (default: its end)"
    )

    position = command("position", "position a receiver of BeiDou and GPS from its RINEX 3 files")
    position.add_argument(
        "observations", metavar="OBS", help="observation file, plain, .gz or .crx"
    )
    position.add_argument(
        "navigation", metavar="NAV", nargs="+", help="navigation files of the same day"
    )
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
    position.add_argument(
        "--systems",
        metavar="G,C",
        help="GPS, BeiDou or both (default: what has both ranges and orbits)",
    )
    position.add_argument(
        "--ion",
        metavar="FILE",
        help="navigation file whose header corrects the ionosphere, or its eight numbers, A0,A1,...,B3 (default: NAV)",
    )
    position.add_argument(
        "--mask", default="10", metavar="DEG", help="least elevation of satellites (default: 10)"
    )
    position.add_argument(
        "--acceleration-noise",
        default="0.01",
        metavar="Q",
        help="m^2/s^3; a^2 T for accelerations a each T s (default: 0.01)",
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
    position.add_argument(
        "--strict",
        action="store_true",
        help="refuse files with damaged lines; exit 1 if a position is untested or implausible",
    )
    position.add_argument(
        "--out",
        default="out/position",
        metavar="DIR",
        help="folder for everything, or a file for the track: .csv, .pos (RTKLIB), .geojson or .nmea (default: out/position)",
    )

    diagnose = command(
        "diagnose",
        "say whether residuals are white, unbiased and as large as predicted; and which noise they have",
    )
    diagnose.add_argument(
        "residuals",
        metavar="RESIDUALS.csv",
        help="a line of names: t, components x, their predicted σ std_x, run",
    )
    diagnose.add_argument(
        "--time", metavar="NAME", help="column of times, s (default: t, time_..., seconds_...)"
    )
    diagnose.add_argument(
        "--columns",
        nargs="+",
        metavar="NAME",
        help="components (default: those with a predicted σ, or else all)",
    )
    diagnose.add_argument(
        "--lags", default="20", metavar="N", help="of the autocorrelation (default: 20)"
    )
    diagnose.add_argument(
        "--level", default="0.95", metavar="P", help="of intervals and bands (default: 0.95)"
    )
    diagnose.add_argument(
        "--out", metavar="DIR", help="where to write words, numbers and a figure (default: nowhere)"
    )
    return parser, commands.choices
