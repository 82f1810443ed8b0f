"""A user's study: the template from `celnav new` runs, and faults in a file are reported before
anything runs.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_cli import tiny

import celnav
from celnav import cli, papers
from celnav.campaign import campaign
from celnav.campaign.missions import MissionError, read
from celnav.files import InputError, data
from celnav.papers import own
from celnav.show.claims import read_claims

TEMPLATE = data("own/study.py").read_text(encoding="utf-8")
FEW = ["--effort", "0.02", "--jobs", "1"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with the template."""
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "study.py"]) == 0
    return tmp_path


def reproduce(*words):
    return cli.main(["reproduce", *words, *FEW])


def units(folder, name="study"):
    return {
        path.name: path.stat().st_mtime_ns
        for path in (folder / "out" / name / ".results/units").iterdir()
    }


def test_the_template_runs_as_it_is(folder, capsys):
    assert len([line for line in TEMPLATE.splitlines() if line.strip()]) <= 40
    imported = re.findall(r"(?m)^\s*(?:import|from) (\S+)", TEMPLATE)
    assert imported == ["dataclasses", "numpy", "celnav"]
    assert reproduce("study.py") == 0
    out = folder / "out" / "study"
    (claim,) = read_claims(out / "claims.json")
    assert claim["ci"][0] < claim["value"] < claim["ci"][1]
    assert {
        p.name
        for p in out.rglob("*")
        if p.is_file() and p.name[0] != "." and p.parent.name != "units"
    } == {
        "claims.json",
        "checks.json",
        "timings.json",
        "result.npz",
        "study.json",
        "figure_01.png",
        "figure_01.svg",
        "manifest.json",
    }
    page = (folder / "out/index.html").read_text()
    for text in (
        "A vehicle by range and bearing",
        'href="../study.py"',
        "study/figures/figure_01.png",
        "judges 1 statement by numbers",
    ):
        assert text in page
    assert "We find" not in page  # a study without such sentences has no empty ones
    assert "The claim:" not in page
    capsys.readouterr()
    assert cli.main(["verdicts"]) == 0
    shown = capsys.readouterr().out
    assert "| `study` | 1 |" in shown
    assert shown.endswith("**A vehicle by range and bearing** (`study`).\n")
    assert cli.main(["list", "study.py"]) == 0
    listed = capsys.readouterr().out
    assert all(
        text in listed for text in ("bearing_deg", "figure_01", "ekf, ukf", "limits.position")
    )
    assert cli.main(["view", "study.py"]) == 2
    assert "study.py: has no recordings" in capsys.readouterr().err


def test_the_page_on_studies_shows_what_is_written():
    page = Path(__file__).parents[2] / "docs" / "howto" / "own_study.md"
    (shown, *_) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert shown == TEMPLATE


def test_papers_are_made_of_the_same_names():
    """``celnav.study`` defines no names: the template imports the same names as the papers."""
    names = set(re.findall(r"celnav\.study\.(?:numbers\.)?(\w+)", TEMPLATE)) - {"numbers"}
    assert names >= {"Study", "Timed", "consistency", "monte_carlo", "param", "statement"}
    rows = {"statement"}  # of papers, in ledger.toml
    texts = [path.read_text() for path in Path(papers.__file__).parent.rglob("*.py")]
    for name in names - rows:
        of = celnav.study.numbers if name == "consistency" else celnav.study
        assert getattr(of, name).__module__.startswith("celnav.study.")
        assert any(re.search(rf"\b{name}\b", text) for text in texts), name


def test_the_template_runs_where_nothing_of_celnav_lies(folder):
    """As a user runs it: in a separate process and folder."""
    command = [
        sys.executable,
        "-m",
        "celnav",
        "reproduce",
        "study.py",
        "--effort",
        "0.1",
        "--strict",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    last = done.stdout.splitlines()[-1]
    assert re.fullmatch(r"wrote out/index.html in \d+ s: every verdict is the expected one", last)


def test_the_statement_of_the_template_is_decided_by_a_tenth_of_the_runs(folder):
    assert cli.main(["reproduce", "study.py", "--effort", "0.1", "--jobs", "1", "--strict"]) == 0
    assert read_claims(folder / "out/study/claims.json")[0]["verdict"] == "reproduced"


def test_results_are_kept_as_long_as_the_file_says_the_same(folder):
    reproduce("study.py")
    first = units(folder)
    (folder / "study.py").write_text(f"# a comment\n{TEMPLATE}")
    reproduce("study.py")
    assert units(folder) == first
    (folder / "study.py").write_text(
        TEMPLATE.replace(
            "bearing_deg: float = celnav.study.param(3.0",
            "bearing_deg: float = celnav.study.param(4.0",
        )
    )
    reproduce("study.py")
    assert not set(units(folder)) & set(first)


def test_modules_beside_the_file_belong_to_it(folder):
    (folder / "study.py").write_text(
        TEMPLATE.replace("import celnav\n", "import celnav\nimport ground_km\n", 1)
    )
    (folder / "ground_km.py").write_text("HEIGHT = 1\n")
    first = own.load("study.py").STUDY.source
    (folder / "ground_km.py").write_text("HEIGHT = 20\n")
    assert own.load("study.py").STUDY.source != first
    (folder / "other.py").write_text("nobody imports it\n")
    assert own.identity("study.py") == f"study.py, {own.load('study.py').STUDY.source}"


def test_processes_give_the_same_and_refuse_a_file_that_has_changed(folder):
    """Real processes: functions of the file are sent as the file's path and hash."""
    for jobs, out in (("1", "one"), ("2", "two")):
        words = ["reproduce", "study.py", "--effort", "0.5", "--jobs", jobs, "--out", out]
        subprocess.run([sys.executable, "-m", "celnav", *words], check=True, capture_output=True)
    assert (folder / "one/study/claims.json").read_bytes() == (
        folder / "two/study/claims.json"
    ).read_bytes()
    name = own.load("study.py").__name__
    (folder / "study.py").write_text(
        TEMPLATE.replace(
            "bearing_deg: float = celnav.study.param(3.0",
            "bearing_deg: float = celnav.study.param(4.0",
        )
    )
    del sys.modules[name]
    with pytest.raises(
        ImportError, match="changed while the work was running; run the same command again"
    ):
        own.import_module(name)


def test_papers_and_own_studies_go_together(folder, monkeypatch, capsys):
    module = tiny()
    monkeypatch.setattr(papers, "PAPERS", {"tiny": "tiny"})
    monkeypatch.setattr(
        "celnav.papers.import_module", lambda name: own if name == "celnav.papers.own" else module
    )
    (folder / "other.py").write_text(TEMPLATE.replace("A vehicle by", "Another by"))
    assert reproduce("study.py", "tiny", "other.py") == 0
    (folder / "other.py").unlink()  # the page's data are stored
    assert reproduce("tiny") == 0
    page = (folder / "out/index.html").read_text()
    assert all(
        text in page
        for text in ("Tiny &lt;study&gt;", "A vehicle by", "Another by", "What we find")
    )
    capsys.readouterr()
    cli.main(["verdicts"])
    assert [
        line.split("`")[1]
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("| `")
    ] == [
        "tiny",
        "other",
        "study",
    ]


BROKEN = """
from celnav.study.ledger import statement
from celnav.study.study import Part, Study
TITLE = 3
FIGURES = {"a": lambda r: 1}
RECORDINGS = ["x.rrd"]
PRESETS = {}


def parts(effort):
    def work(config, rngs):
        return {}

    return {"inner": Part(work, None), "short": Part(len, None)}


ROWS = [statement("one", "It is so.", 3, figure="zz"), statement("one", "It is not.", needs="c")]
STUDY = Study("x", (1,), None, parts, ROWS, figure="nope")
"""


def test_all_that_is_missing_is_told_at_once(folder, capsys):
    (folder / "study.py").write_text(BROKEN)
    assert reproduce("study.py") == 2
    head, *lines = capsys.readouterr().err.splitlines()
    assert (
        head
        == "celnav: study.py: 12 things are missing or not as expected (celnav new FILE.py writes a study that has all):"
    )
    assert [line.split(": expected ")[0].strip() for line in lines] == [
        "TITLE",
        "PRESETS",
        "FIGURES",
        "record",
        "STUDY.groups",
        "STUDY.parts 'inner'",
        "STUDY.parts 'short'",
        "STUDY.figure",
        "STUDY.rows",
        "STUDY.rows 'one'",
        "STUDY.rows 'one'",
        "STUDY.rows 'one'",
    ]
    assert all(", got " in line for line in lines)
    assert not (folder / "out").exists()
    with pytest.raises(
        InputError,
        match=r"14 things are missing(.|\n)*filters: expected a function \(config\)(.|\n)*STUDY.trial",
    ):
        own.load("study.py", mission=True)


def test_an_empty_file_misses_what_is_always_needed(folder):
    (folder / "study.py").write_text("")
    with pytest.raises(InputError) as error:
        own.load("study.py")
    assert str(error.value).splitlines()[1:] == [
        "  TITLE: expected a text, what the study is about, got none",
        "  STUDY: expected a celnav.study.Study(name, groups, trial, parts, rows), got none",
    ]


@pytest.mark.parametrize(
    ("old", "new", "status", "line", "said"),
    [
        ("import numpy as np\n", "import numpy as\n", 2, "import numpy as", "SyntaxError: "),
        (
            "TITLE = ",
            "TITLE = 1 / 0\n_ = ",
            2,
            "TITLE = 1 / 0",
            "ZeroDivisionError: division by zero",
        ),
        (
            "import numpy as np\n",
            "import numpie as np\n",
            2,
            "import numpie as np",
            "ModuleNotFoundError: No module named",
        ),
        (
            "lambda effort: PARTS",
            "lambda effort: PORTS",
            2,
            "PORTS",
            "NameError: name 'PORTS' is not defined",
        ),
        (
            "    models = problem(config).motion, problem(config).sensor",
            "    _, _, _ = models = problem(config).motion, problem(config).sensor",
            1,
            "_, _, _ = models",
            "ValueError: ",
        ),
        (
            "    return celnav.show.panels(",
            "    return panelz(",
            1,
            "return panelz(",
            "NameError: name 'panelz' is not defined",
        ),
        (
            "FIGURES = ",
            'TABLES = {"rmse": ("", lambda r: 0 + [])}\nFIGURES = ',
            1,
            "0 + []",
            "TypeError: unsupported operand",
        ),
    ],
)
def test_errors_in_the_file_are_told_with_their_line(folder, capsys, old, new, status, line, said):
    assert old in TEMPLATE
    (folder / "study.py").write_text(TEMPLATE.replace(old, new))
    number = 1 + next(
        i for i, text in enumerate((folder / "study.py").read_text().splitlines()) if line in text
    )
    assert reproduce("study.py") == status
    error = capsys.readouterr().err
    for text in (f"study.py, line {number}: ", line, said):
        assert text in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            ["new", "study.py"],
            "study.py: exists already and is not overwritten; choose another name, or move it away",
        ),
        (["new", "study"], "study: expected the name of a file that ends in .py, such as study.py"),
        (["new", "csrukf.py"], "csrukf.py: expected a name other than csrukf, which celnav uses"),
        (["new", "absent/study.py"], "absent: no such folder; make it first"),
        (["new"], "the following arguments are required: FILE.py; see celnav new --help"),
        (["reproduce", "absent.py"], "absent.py: no such file or directory"),
        (
            ["reproduce", "csrukf.py"],
            "csrukf.py: expected a name other than csrukf, which celnav uses; rename the file",
        ),
        (
            ["reproduce", "study.py", "./sub/study.py"],
            "study.py, ./sub/study.py: expected files of different names; rename one",
        ),
        (["view", "study.py"], "study.py: has no recordings; a mission of it (celnav run) has one"),
    ],
)
def test_what_cannot_be_is_one_line_and_changes_nothing(folder, capsys, words, text):
    (folder / "sub").mkdir()
    (folder / "sub" / "study.py").write_text(TEMPLATE)
    (folder / "study.py").write_text(f"{TEMPLATE}\nMINE = 1\n")
    capsys.readouterr()
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert text in error
    assert (folder / "study.py").read_text().endswith("MINE = 1\n")
    assert not (folder / "out").exists()


def test_a_mission_takes_a_study_beside_it(folder, capsys, monkeypatch):
    missions = folder / "missions"
    missions.mkdir()
    text = 'paper = "../study.py"\nruns = 6\n[config]\nsteps = 10\nbearing_deg = 1.0\n'
    (missions / "good.toml").write_text(text)
    assert cli.main(["run", "missions/good.toml", "--jobs", "1", "--effort", "1"]) == 0
    out = capsys.readouterr().out
    assert "A vehicle by range and bearing: 100%: 6/6 runs" in out
    assert "ukf: position" in out
    monkeypatch.chdir(missions)
    (missions / "sweep.toml").write_text(text.replace("1.0", "[0.5, 1.0]"))
    study = read("sweep.toml")
    assert [point.config.bearing_deg for point in study.configurations] == [0.5, 1.0]
    assert study.to_dict()["paper"] == own.identity("../study.py")
    first = campaign(study, folder / "store").rows
    (folder / "elsewhere").mkdir()
    (folder / "study.py").rename(
        folder / "elsewhere" / "study.py"
    )  # its results depend on its contents, not its path
    (missions / "sweep.toml").write_text(
        text.replace("1.0", "[0.5, 1.0]").replace("../", "../elsewhere/")
    )
    before = {path: path.stat().st_mtime_ns for path in (folder / "store/units").iterdir()}
    again = campaign(read("sweep.toml"), folder / "store").rows
    assert {path: path.stat().st_mtime_ns for path in (folder / "store/units").iterdir()} == before
    assert str(again) == str(first)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            ("bearing_deg = 1.0", "bearing = 1.0"),
            "config.bearing: unknown key; did you mean config.bearing_deg?",
        ),
        (
            ("bearing_deg = 1.0", "bearing_deg = -1.0"),
            "config.bearing_deg (deg): expected a positive number, got -1.0",
        ),
        (("study.py", "absent.py"), "absent.py"),
    ],
)
def test_a_mission_that_does_not_go_with_its_study_is_told(folder, change, text):
    (folder / "m.toml").write_text(
        'paper = "study.py"\nruns = 6\n[config]\nbearing_deg = 1.0\n'.replace(*change)
    )
    with pytest.raises((MissionError, FileNotFoundError)) as error:
        read("m.toml")
    assert text in str(error.value)


def test_a_study_without_presets_flies_no_missions_but_is_reproduced(folder, capsys):
    (folder / "study.py").write_text(
        TEMPLATE.replace("PRESETS", "CASES")
        .replace("def filters(", "def them(")
        .replace("filters(config)", "them(config)")
    )
    assert reproduce("study.py") == 0
    (folder / "m.toml").write_text('paper = "study.py"\n')
    assert cli.main(["run", "m.toml"]) == 2
    error = capsys.readouterr().err
    assert "PRESETS: expected" in error
    assert "filters: expected" in error
    assert cli.main(["list", "study.py"]) == 0


def test_it_is_a_study_like_any_other(folder):
    module = own.load("study.py")
    results = module.STUDY.reproduce(effort=0.01)
    assert results.get("usual", "ekf/error").shape == (61, 4, 4)
    assert module.STUDY.name == "study"
    assert papers.load("study.py") is module
    assert isinstance(
        module.filters(module.Config())["ukf"],
        type(celnav.ukf(celnav.Motion(np.eye(2), np.eye(2)))),
    )
