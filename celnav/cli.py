"""The command line; ``commands/options.toml`` lists the commands and their options."""

from __future__ import annotations

import argparse
import errno
import importlib
import io
import itertools
import os
import re
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import celnav
from celnav.commands.arguments import UsageError, warn
from celnav.files import ForeignFileError, InputError, did_you_mean
from celnav.filters.run import ENGINES
from celnav.lazy import require
from celnav.papers import REAL
from celnav.papers.own import explain_error
from celnav.tape.cuda import CudaError

EXIT = """\
exit status:
  0    done
  1    it could not be done
  2    the input cannot be used
  3    position --strict: track and ranges contradict each other
  130  interrupted"""
BAD_INPUT = (
    InputError,
    ForeignFileError,
    FileNotFoundError,
    IsADirectoryError,
    NotADirectoryError,
    PermissionError,
)
"""Errors of unusable input, including files and folders: the exit status is 2."""
PAPERS = ("papers", "jplephem", "erfa", "skyfield_data", "threadpoolctl")
RESULTS = ("papers", "matplotlib", "PIL", "jinja2", "rich", "filelock", *PAPERS[1:])
NEEDS = {
    "list": PAPERS,
    "verdicts": (*PAPERS, "rich"),
    "reproduce": RESULTS,  # without rerun this command only warns that it writes no recordings
    "run": (*RESULTS, "pyarrow"),
    "campaign": (*RESULTS, "pyarrow"),
    "view": ("record", "rerun", "PIL"),
    "position": ("rinex", "erfa"),
}
"""Commands that need more than numpy and scipy: the extra, and the required packages."""


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
        return _failed(error, 2)
    except (OSError, ImportError, InputError, CudaError) as error:
        if _nobody_reads(error):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        return _failed(
            explain_error(error) or _sentence(error), 2 if isinstance(error, BAD_INPUT) else 1
        )
    except MemoryError as error:
        cure = "fewer runs at once, or fewer --jobs, need less"
        return _failed(f"not enough memory ({error}); {cure}", 1)
    except KeyboardInterrupt:
        return _failed("interrupted", 130)
    except Exception as error:
        if line := explain_error(error):
            return _failed(line, 1)
        raise


def _failed(why: object, status: int) -> int:
    warn(str(why))
    return status


def _nobody_reads(error: Exception) -> bool:
    """Whether an error means that the output pipe is closed; Windows reports an invalid argument
    instead.
    """
    windows = (
        sys.platform == "win32"
        and isinstance(error, OSError)
        and error.errno == errno.EINVAL
        and error.filename is None
    )
    return windows or isinstance(error, BrokenPipeError)


def _sentence(error: Exception) -> str:
    """The error as a sentence, with the file first and without the operating
    system's error number.
    """
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror[0].lower()}{error.strerror[1:]}"
    return str(error)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are a single line, like all other errors."""

    def error(self, message: str) -> NoReturn:
        form = r"argument (\S+): invalid choice: (.*) \(choose from (.*)\)"
        if choice := re.fullmatch(form, message):
            names = choice[3].replace("'", "")
            message = f"{choice[1]}: expected one of {names}, got {choice[2]}"
        raise UsageError(f"{message}; see {self.prog} --help")


def _options(words: Sequence[str]) -> argparse.Namespace:
    """The options of a command line; UsageError for an unknown word names the
    nearest known word.
    """
    parser, commands = _parser()
    if not words:
        parser.print_help()
        raise SystemExit(0)
    name = words[0]
    if not name.startswith("-") and name not in commands:
        raise UsageError(
            f"unknown command {name!r}: expected one of "
            f"{', '.join(commands)}{did_you_mean(name, commands)}"
        )
    command = commands.get(name, parser)
    flags = [flag for flag in command._option_string_actions if flag.startswith("--")]
    for word in itertools.takewhile(lambda word: word != "--", words):
        option = word.partition("=")[0]
        if word.startswith("--") and not any(flag.startswith(option) for flag in flags):
            raise UsageError(
                f"unknown option {option}{did_you_mean(option, flags)}; see {command.prog} --help"
            )
    options, rest = parser.parse_known_args(words)
    if rest:
        raise UsageError(f"expected nothing more, got {rest[0]!r}; see {command.prog} --help")
    return options


def _parser() -> tuple[_Parser, dict[str, _Parser]]:
    """The parser, and the parsers of commands by name, from ``commands/options.toml``."""
    parser = _Parser(
        prog="celnav",
        description="Navigation filters, batched and in square-root form, and six papers judged.",
        epilog=EXIT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"celnav {celnav.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    file = Path(__file__).parent / "commands" / "options.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    computing = tables.pop("computing")
    for name, about in tables.items():
        options = about["options"]
        if name == "reproduce":
            options["--engine"]["choices"] = ENGINES
            for study, holds in REAL.items():
                said = f"for the study {study}: folder of {holds}"
                options[f"--{study}"] = {"metavar": "DIR", "help": said}
        if name in ("reproduce", "run", "campaign"):
            options |= computing
        examples = "\n".join(["examples:", *(f"  {line}" for line in about["examples"])])
        command = commands.add_parser(
            name,
            help=about["help"],
            description=about["help"],
            epilog=examples,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        needs = (name, *NEEDS[name]) if name in NEEDS else ()
        command.set_defaults(module="mission" if name == "run" else name, needs=needs)
        for option, said in options.items():
            metavar = said.get("metavar")
            if isinstance(metavar, list):
                said["metavar"] = tuple(metavar)
            command.add_argument(option, **said)
    return parser, commands.choices
