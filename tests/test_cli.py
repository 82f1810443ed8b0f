"""The command line from a user's view: exit codes, one-line messages, files written by celnav."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import celnav
from celnav import cli, papers
from celnav.campaign.missions import flat
from celnav.campaign.typed import described, unit_of
from celnav.papers import load
from celnav.show.claims import read_claims
from celnav.show.draw import figure
from celnav.study.ledger import Number, Row, Sentence
from celnav.study.study import Part, Study


def numbers(size, rngs):
    """Arrays of a part: ``size`` numbers per run, under a name that is stored."""
    return {
        "times": np.arange(3.0),
        "kf/nees": np.stack([rng.random((3, size)).mean(1) for rng in rngs], 1),
        "x/nees": np.ones((size, 2)),
    }


SAID = [Sentence("It is so.", {"one": "reproduced"})]


def tiny(failing=False, undecided=False, work=numbers, size=4, blocks=2):
    """A paper whose study takes no time."""

    def draw(results):
        fig, ax = figure(2.0, 2.0)
        ax.plot([0, 1])
        return fig

    def record(results, outputs):
        with outputs.path_for("tiny.rrd") as path:
            path.write_bytes(b"RRF2")

    value, ci = 2.0 if failing else 1.0, (0.5, 2.0) if undecided else None
    rows = [
        Row("statement", "one", "It is so", lambda _: Number("x", value, (0.0, 1.5), ci)),
        Row("erratum", "two", "1 < 0"),
        Row(
            "check",
            "three",
            "It is so",
            lambda r: Number("x", float(r.get("all", "kf/nees").mean()), (0.0, 1.0)),
        ),
    ]
    parts = {"all": Part(work, size, 0, 2 * blocks, 2, 1.0)}
    return SimpleNamespace(
        TITLE="Tiny <study>", CITATION="@tiny", PRESETS={"P": None}, RECORDINGS=["tiny.rrd"], record=record,
        STUDY=Study("tiny", (), None, lambda effort: parts, rows, "It says so.", SAID),
        FIGURES={"figure_01": ("A figure.", draw), "figure_02b": ("Another.", draw)},
        TABLES={"table_1": ("A table.", lambda results: [{"a": 1.0, "b": "x"}])}, filters=lambda config: {"kf": None},
    )  # fmt: skip


@pytest.fixture
def study(monkeypatch):
    def use(**options):
        module = tiny(**options)
        monkeypatch.setattr(papers, "PAPERS", {"tiny": "tiny"})
        monkeypatch.setattr("celnav.papers.import_module", lambda name: module)

    use()
    return use


def test_reproduce_tells_the_share_and_the_time_left_of_figures_and_recordings_too(
    study, tmp_path, capsys
):
    assert cli.main(["reproduce", "--out", str(tmp_path), "--effort", "1", "--jobs", "1"]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if line.startswith("celnav: ")]
    found = [re.fullmatch(r"celnav: (\d+)%(, \d+ s left)?: (.*)", line) for line in told]
    assert [
        (int(share), bool(left), what) for share, left, what in (m.groups() for m in found)
    ] == [
        (8, False, "tiny: all"),  # two CPU seconds of runs, ten of what is made of them
        (17, False, "tiny: all"),
        (17, False, "tiny: ledger"),
        (25, True, "tiny: figures"),
        (67, True, "tiny: recordings"),
    ]


def test_reproduce_writes_everything_and_replaces_its_own(study, tmp_path, capsys):
    out = tmp_path / "a folder"
    for _ in range(2):
        assert cli.main(["reproduce", "--out", str(out)]) == 0
    written = {
        str(p.relative_to(out))
        for p in out.rglob("*")
        if p.is_file() and not p.name.startswith(".")
    }
    written = {name for name in written if ".results/" not in name}  # kept for the next time
    assert written == {
        "index.html", "ro-crate-metadata.json",
        "tiny/claims.json", "tiny/checks.json", "tiny/timings.json", "tiny/result.npz", "tiny/tiny.rrd",
        "tiny/tables/table_1.csv",
        "tiny/figures/figure_01.png", "tiny/figures/figure_01.svg", "tiny/figures/figure_02b.png", "tiny/figures/figure_02b.svg",
    }  # fmt: skip
    assert read_claims(out / "tiny/claims.json")[0]["verdict"] == "reproduced"
    page = (out / "index.html").read_text()
    assert "Tiny &lt;study&gt;" in page
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")  # a name, not a link
    assert {p.name for p in tmp_path.iterdir()} == {"a folder"}


def test_strict_fails_where_a_claim_is_not_as_expected(study, tmp_path, capsys):
    study(failing=True)
    assert cli.main(["reproduce", "tiny", "--out", str(tmp_path), "--jobs", "1"]) == 0
    assert cli.main(["reproduce", "tiny", "--out", str(tmp_path), "--jobs", "1", "--strict"]) == 1
    assert "not as expected: one" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (["reproduce", "tinny"], 2, "did you mean tiny"),
        (["reproduce", "--effort", "0"], 2, "effort"),
        (["reproduce", "--effort", "2"], 2, "effort"),
        (["reproduce", "--effort", "much"], 2, "effort"),
        (["reproduce", "--seed", "-1"], 2, "seed"),
        (["reproduce", "--jobs", "0"], 2, "jobs"),
        (["view", "tinny"], 2, "unknown paper"),
        (["view", "tiny"], 2, "celnav reproduce tiny"),
        (["view", "absent.rrd"], 2, "absent.rrd: no such recording"),
        (["verdicts"], 2, "no paper was reproduced here"),
        (["reproduse"], 2, "unknown command 'reproduse': expected one of new, list, reproduce, "),
        (["reproduse"], 2, "; did you mean reproduce?"),
        (
            ["reproduce", "--efort", "0.1"],
            2,
            "unknown option --efort; did you mean --effort?; see celnav reproduce --help",
        ),
        (["run", "--efort=0.1"], 2, "unknown option --efort; did you mean --effort?"),
        (
            ["run", "mission.toml", "another"],
            2,
            "expected nothing more, got 'another'; see celnav run --help",
        ),
        (["--versoin"], 2, "unknown option --versoin; did you mean --version?"),
        (["run"], 2, "the following arguments are required: MISSION.toml; see celnav run --help"),
        (
            ["reproduce", "--jobs", "none"],
            2,
            "--jobs: expected a whole number of at least 1, got 'none'",
        ),
        (["reproduce", "--seed", "x"], 2, "--seed: expected a whole number"),
        (
            ["reproduce", "--engine", "x"],
            2,
            "--engine: expected one of numpy, compiled, cuda, auto, got 'x'; see celnav",
        ),
        (
            ["reproduce", "--effort", "x"],
            2,
            "celnav: --effort: expected a number in (0, 1], got 'x'",
        ),
        (["reproduce", "--rinex", "."], 2, "--rinex: expected a paper that takes a receiver's log"),
        (
            ["view", "mission.toml"],
            2,
            "mission.toml: expected a paper that was reproduced, or a recording, FILE.rrd",
        ),
        (["run", "absent.toml"], 2, "celnav: absent.toml: no such file or directory"),
    ],
)
def test_a_mistake_is_one_line_and_an_exit_code(
    study, tmp_path, monkeypatch, capsys, arguments, status, text
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == status
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there_is_told_before_computing(tmp_path, capsys):
    words = ["reproduce", "ins", "--ins", "absent", "--out", str(tmp_path / "out")]
    assert cli.main(words) == 2
    assert capsys.readouterr().err == "celnav: --ins: expected a folder that exists, got 'absent'\n"
    assert not (tmp_path / "out").exists()


def test_a_foreign_file_is_refused_before_computing(study, tmp_path, capsys):
    (tmp_path / "tiny").mkdir()
    (tmp_path / "tiny" / "claims.json").write_text("mine")
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 2
    assert "claims.json" in capsys.readouterr().err
    assert (tmp_path / "tiny" / "claims.json").read_text() == "mine"
    assert not (tmp_path / "tiny" / "result.npz").exists()


def test_an_output_that_is_a_file_is_refused(study, tmp_path, capsys):
    (tmp_path / "out").write_text("mine")
    assert cli.main(["reproduce", "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_environment_sets_the_effort_and_is_checked(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("CELNAV_EFFORT", "lots")
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 2
    assert "CELNAV_EFFORT" in capsys.readouterr().err
    assert cli.main(["reproduce", "--out", str(tmp_path), "--jobs", "1", "--effort", "0.5"]) == 0
    assert json.loads((tmp_path / "tiny/timings.json").read_text())["effort"] == 0.5


def test_recordings_that_fail_leave_the_rest(study, tmp_path, monkeypatch, capsys):
    module = load("tiny")

    def broken(result, outputs):
        raise RuntimeError("no viewer library")

    monkeypatch.setattr(module, "record", broken)
    assert cli.main(["reproduce", "--out", str(tmp_path), "--jobs", "1"]) == 0
    assert "no recordings (no viewer library)" in capsys.readouterr().err
    assert (tmp_path / "tiny/claims.json").exists()


def test_view_without_a_display_says_what_to_do(study, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    cli.main(["reproduce", "--out", str(tmp_path), "--jobs", "1"])
    capsys.readouterr()
    assert cli.main(["view", "tiny", "--out", str(tmp_path)]) == 1
    assert "no display" in capsys.readouterr().err
    assert cli.main(["view", "tiny", "--out", str(tmp_path), "--recording", "other"]) == 2


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--picture", "a.jpg"], "--picture: expected the name of a .png file, got 'a.jpg'"),
        (["--picture", "a.png", "--at", "soon"], "--at: expected a number, got 'soon'"),
        (
            ["--picture", "a.png", "--at", "-1"],
            "--at: expected a time of the recording, from 0 to 2 s, got -1",
        ),
        (
            ["--picture", "a.png", "--at", "nan"],
            "--at: expected a time of the recording, from 0 to 2 s, got nan",
        ),
        (
            ["--picture", "a.png", "--at", "2.5"],
            "--at: expected a time of the recording, from 0 to 2 s, got 2.5",
        ),
    ],
)
def test_a_picture_that_cannot_be_is_one_line(tmp_path, monkeypatch, capsys, options, text):
    from celnav.show import recording, views

    monkeypatch.chdir(tmp_path)
    with recording.recording(
        tmp_path / "a.rrd", np.arange(3.0), name="a", layout=views.text(origin="info")
    ) as out:
        out.curve("x", np.arange(3.0), "#000000", "x")
    assert cli.main(["view", "a.rrd", *options]) == 2
    assert capsys.readouterr().err == f"celnav: {text}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


@pytest.fixture
def terminal(monkeypatch):
    """Make standard output a terminal with this many columns."""

    def use(columns):
        monkeypatch.setenv("COLUMNS", str(columns))
        monkeypatch.setenv("TERM", "xterm-256color")
        monkeypatch.delenv("NO_COLOR", raising=False)
        monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)

    return use


def plain(text):
    """The text that a terminal shows, without control codes."""
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


@pytest.mark.parametrize("width", [80, 120])
def test_list_has_a_line_for_each_study_and_says_how_to_see_more(terminal, capsys, width):
    terminal(width)
    assert cli.main(["list"]) == 0
    *studies, more = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in studies] == [*papers.PAPERS, *papers.REAL]
    assert "celnav list NAME" in more
    assert max(map(len, [*studies, more])) <= width


@pytest.mark.parametrize("width", [1, 9, 12])
def test_list_works_in_a_narrow_terminal(terminal, capsys, width):
    terminal(width)
    assert cli.main(["list"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(papers.PAPERS) + len(papers.REAL) + 1


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("name", [*papers.PAPERS, "ins"])
def test_list_of_a_study_fits_the_terminal(terminal, capsys, name, width):
    terminal(width)
    assert cli.main(["list", name]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert width - 10 < max(map(len, lines)) <= width


def test_list_of_a_study_has_figures_tables_and_rows_each_on_one_line_of_a_pipe(capsys):
    assert cli.main(["list", "csrukf"]) == 0
    text = capsys.readouterr().out
    assert "\x1b" not in text
    lines, study = text.splitlines(), load("csrukf")
    drawn = [caption for caption, _ in [*study.FIGURES.values(), *study.TABLES.values()]]
    for said in [*drawn, *(row.says for row in study.STUDY.rows)]:
        assert [line for line in lines if line.endswith(f" {said}")], said
    figures = [line.split()[0] for line in lines if line.startswith("  figure_")]
    assert figures == sorted(study.FIGURES)
    assert "augmented" in text


@pytest.mark.parametrize("width", [80, 120, None])
def test_lines_of_a_summary_are_wrapped_in_a_terminal_only(terminal, capsys, width):
    from celnav.commands.terminal import paragraph

    if width is not None:
        terminal(width)
    rows = [f"row {i}: " + "position 0.6636 km, velocity 10.64 m/s, " * 4 for i in range(2)]
    paragraph("\n".join(rows), 4)
    lines = capsys.readouterr().out.splitlines()
    if width is None:
        assert lines == [row.rstrip() for row in rows]
    else:
        assert width - 20 < max(map(len, lines)) <= width
        assert {line[:4] for line in lines} == {"row ", "    "}
        assert " ".join(" ".join(lines).split()) == " ".join(" ".join(rows).split())


def ledger_of(folder):
    """Studies for `celnav verdicts`, with every kind of verdict."""
    from celnav.show.claims import dumps

    words = {"reproduced": 1.0, "not reproduced": 9.0, "no number": np.nan}
    rows = [
        Row(
            "statement",
            id,
            "It is so [say, at [a] :x:], whatever else there may be.",
            lambda _, v=v: Number("x", v, (0.0, 2.0)),
        )
        for id, v in words.items()
    ]
    claims = [row.judged(None) for row in rows]
    assert [claim.verdict for claim in claims] == list(words)
    for name in ("csrukf", "aukf"):
        (folder / name).mkdir()
        (folder / name / "claims.json").write_text(dumps(claims))
        (folder / name / "checks.json").write_text(dumps([]))


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("paper", [[], ["csrukf"]])
def test_verdicts_are_a_table_with_signs_and_colors_in_a_terminal(
    terminal, tmp_path, capsys, paper, width
):
    ledger_of(tmp_path)
    terminal(width)
    assert cli.main(["verdicts", *paper, "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "\x1b[32m" in text  # green
    assert "\x1b[31m" in text  # red
    lines = plain(text).splitlines()
    for sign, verdict in [("✓", "reproduced"), ("✗", "not reproduced"), ("?", "no number")]:
        assert any(re.search(rf"{re.escape(sign)} (1 )?{verdict}", line) for line in lines)
    assert max(len(line.rstrip()) for line in lines) <= width
    words = " ".join(" ".join(lines).split())
    assert not paper or ("[say," in words and "[a]" in words and ":x:]" in words)
    assert ("aukf" in plain(text)) == (not paper)


@pytest.mark.parametrize("paper", [[], ["csrukf"]])
def test_verdicts_are_markdown_in_a_pipe(tmp_path, capsys, paper):
    ledger_of(tmp_path)
    assert cli.main(["verdicts", *paper, "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "\x1b" not in text
    head, line, *_ = text.splitlines()
    assert head.startswith("| Verdict |" if paper else "| paper | statements |")
    assert re.fullmatch(r"[| :-]+", line)
    assert any(line.startswith("**") for line in text.splitlines())


def test_verdicts_of_what_was_not_reproduced_is_one_line(tmp_path, capsys):
    ledger_of(tmp_path)
    assert cli.main(["verdicts", "csrukg", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"celnav: PAPER: expected a paper reproduced in {tmp_path} (csrukf, aukf), "
        "got 'csrukg'; did you mean csrukf?\n"
    )


COMMANDS = cli._parser()[1]
OPTIONS = tomllib.loads(
    (Path(celnav.__file__).parent / "commands" / "options.toml").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_help_fits_a_terminal_of_80_columns(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    parser, commands = cli._parser()
    text = (commands[name] if name else parser).format_help()
    assert max(map(len, text.splitlines())) <= 80
    assert "examples:" in text or not name


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_of_help_run(name, tmp_path, monkeypatch, capsys):
    """All are parsed; examples that need no results and no data are run."""
    monkeypatch.chdir(tmp_path)
    for example in OPTIONS[name]["examples"]:
        celnav_, *words = shlex.split(re.split(r" [|>] ", example)[0])
        assert celnav_ == "celnav"
        module = cli._options(words).module
        assert module == ("mission" if name == "run" else words[0])
        if module in ("new", "list"):
            assert cli.main(words) == 0


def test_the_page_on_the_command_line_has_every_command_and_exit_status():
    page = (Path(celnav.__file__).parents[1] / "docs/command_line.md").read_text(encoding="utf-8")
    overview = page.split("```")[1]
    assert re.findall(r"(?m)^celnav (\w+)", overview) == list(COMMANDS)
    assert max(map(len, overview.splitlines())) <= 80
    for status in re.findall(r"(?m)^  (\d+) ", cli.EXIT):
        assert f"\n| {status} | " in page


def call(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "celnav", *arguments],
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


def test_version_help_and_an_unknown_command(tmp_path):
    assert call("--version", cwd=tmp_path).stdout.strip() == f"celnav {celnav.__version__}"
    assert "reproduce" in call("--help", cwd=tmp_path).stdout
    wrong = call("reproduse", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "Traceback" not in wrong.stderr


def test_a_closed_pipe_is_quiet(tmp_path):
    shell = f"{sys.executable} -m celnav list csrukf | head -1"
    piped = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {shell}"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert piped.stdout.startswith("csrukf: ")
    assert piped.stdout.count("\n") == 1
    assert piped.stderr == ""


def test_an_ascii_locale_does_not_stop_the_listing(tmp_path):
    import os

    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"}
    assert call("list", cwd=tmp_path, env=environment).returncode == 0


def test_what_only_computes_starts_without_what_draws():
    code = (
        "import sys; from celnav import papers; import celnav.campaign; [papers.load(paper) for paper in papers.PAPERS]; "
        "print(*{'rerun', 'matplotlib', 'scipy.stats', 'pandas', 'filterpy', 'distributed'} & set(sys.modules))"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout
        == "\n"
    )


def test_nothing_in_the_package_reads_pickles_or_names_a_host():
    for path in Path(celnav.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "allow_pickle=True" not in text
        assert "import pickle" not in text
        assert "urlopen" not in text
        assert "shell=True" not in text


def test_view_takes_the_first_recording_of_the_paper_and_names_with_or_without_their_end(
    study, tmp_path, monkeypatch, capsys
):
    """The order is the paper's, not the alphabet's."""
    shown = []
    recorded = SimpleNamespace(start=6.0, end=10.0)
    monkeypatch.setattr("celnav.show.reading.read", lambda path: recorded)
    monkeypatch.setattr(
        "celnav.show.picture.picture", lambda path, target, at: shown.append((path.name, at))
    )
    monkeypatch.setattr(load("tiny"), "RECORDINGS", ["b.rrd", "a.rrd"])
    (tmp_path / "tiny").mkdir()
    for name in ("a", "b"):
        (tmp_path / "tiny" / f"{name}.rrd").write_bytes(b"")
    picture = ["--out", str(tmp_path), "--picture", str(tmp_path / "a.png")]
    assert cli.main(["view", "tiny", *picture]) == 0
    for name in ("a", "a.rrd"):
        assert cli.main(["view", "tiny", *picture, "--recording", name, "--at", "3"]) == 0
    assert shown == [("b.rrd", 6.0), ("a.rrd", 3.0), ("a.rrd", 3.0)]
    capsys.readouterr()
    assert cli.main(["view", "tiny", *picture, "--recording", "c"]) == 2
    assert (
        capsys.readouterr().err == "celnav: unknown recording 'c': expected one of b.rrd, a.rrd\n"
    )


def test_less_than_the_whole_effort_is_told(study, tmp_path, capsys):
    assert cli.main(["reproduce", "--out", str(tmp_path), "--jobs", "1", "--effort", "0.5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("celnav: 0.5 of the runs: intervals are wide")
    page = (tmp_path / "index.html").read_text()
    assert "tiny: only 0.5 of the runs: intervals are wide" in page.split('<div class="grid">')[0]
    assert cli.main(["verdicts", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.startswith("tiny: only 0.5 of the runs")


@pytest.mark.parametrize(("effort", "status", "ending"), [
    ("1", 1, "1 not as expected, see above"),
    ("0.5", 0, "1 undecided with 0.5 of the runs"),
])  # fmt: skip
def test_what_is_undecided_is_a_surprise_with_all_runs_and_told_with_fewer(
    study, tmp_path, capsys, effort, status, ending
):
    study(undecided=True)
    command = ["reproduce", "tiny", "--out", str(tmp_path), "--jobs", "1", "--strict"]
    assert cli.main([*command, "--effort", effort]) == status
    last = capsys.readouterr().out.splitlines()[-1]
    assert re.search(rf"index.html in \d+ s: {ending}$", last)


@pytest.mark.parametrize("paper", papers.PAPERS)
def test_list_says_what_each_parameter_means_and_its_unit(paper, capsys):
    """Also nested parameters. If the name does not end in the unit, the meaning states the unit, or
    the value is a pure number, a count or a word.
    """
    assert cli.main(["list", paper]) == 0
    listed = " ".join(capsys.readouterr().out.partition("[config]")[2].split())
    start = next(iter(load(paper).PRESETS.values()))
    said = {name: meaning for name, (meaning, _, _) in described(type(start)).items()}
    for name in flat(asdict(start)):
        assert said[name]
        assert name == "runs" or f"{unit_of(name)} {said[name]}".strip() in listed
    units = {
        "inertia": "kg m^2",
        "wheels": "N m s",
        "torque": "N m",
        "elements": "(km)",
        "phase": "rad",
        "deviation": "(m)",
    }
    for name, unit in (units | {"burst_sigma": "m/s", "days": "days"}).items():
        assert name not in said or unit in said[name]


def value_after(text, key):
    """The value after a name, as TOML; None if it is missing."""
    rest = re.split(rf"\b{re.escape(key)} = ", text, maxsplit=1)[1]
    ends = [n for n in range(1, len(rest) + 1) if rest[:n].count("[") == rest[:n].count("]")]
    simple = re.match(r'"[^"]*"|\(left out\)|[^\s,]+', rest)
    word = rest[: ends[0]] if rest[0] == "[" else simple[0]
    return None if word == "(left out)" else tomllib.loads(f"value = {word}")["value"]


def values_of(preset):
    return json.loads(json.dumps(flat(asdict(preset))))


@pytest.mark.parametrize("paper", papers.PAPERS)
def test_list_prints_the_values_of_each_preset(paper, capsys):
    assert cli.main(["list", paper]) == 0
    top, _, config = capsys.readouterr().out.partition("\n[config] of a mission")
    values, *others = config.split("\n\n")
    heading, _, values = values.partition("\n")
    (first, preset), *presets = load(paper).PRESETS.items()
    assert heading == f", with the values of preset {first}"
    runs = re.search(r"of each configuration \((\d+)\)", top)[1]
    values = f"  runs = {runs}\n{values}"
    printed = {key: value_after(values, key) for key in values_of(preset)}
    assert printed == values_of(preset)
    for text, (name, preset) in zip(others, presets, strict=False):
        other = {k: v for k, v in values_of(preset).items() if v != printed[k]}
        changes = text.removeprefix(f"preset {name}: ")
        assert changes != text
        assert {key: value_after(changes, key) for key in other} == other
        assert changes.count(" = ") == len(other)


def test_list_says_what_missions_begin_with_instead(capsys):
    assert cli.main(["list", "csrukf"]) == 0
    text = capsys.readouterr().out
    assert '\na mission has instead, whatever its preset: noise_level = "stationary"\n' in text
    assert cli.main(["list", "aukf"]) == 0
    assert "whatever its preset" not in capsys.readouterr().out


def test_bare_celnav_shows_the_help(capsys):
    with pytest.raises(SystemExit, match="0"):
        cli.main([])
    shown = capsys.readouterr().out
    assert "campaign" in shown
    assert "exit status:\n  0    done\n" in shown


def test_a_lack_of_memory_is_one_line(study, tmp_path, monkeypatch, capsys):
    def parts(_effort):
        raise MemoryError("Unable to allocate 80 GiB")

    monkeypatch.setattr(load("tiny"), "STUDY", replace(load("tiny").STUDY, parts=parts))
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == (
        "celnav: not enough memory (Unable to allocate 80 GiB); fewer runs at once, or fewer --jobs, need less\n"
    )


def test_list_says_what_a_parameter_can_be_and_how_many_runs_there_are(capsys):
    assert cli.main(["list", "csrukf"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert 'One of "R", "stationary", "zero".' in text
    assert "of each configuration (100)" in text
