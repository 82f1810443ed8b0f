"""The parts of a release agree, and it is refused while the owner's part is missing."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from dataclasses import replace
from datetime import date
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest
import yaml

import celnav
from benchmarks.report import MEASURED, ratio_of, value_of
from celnav.papers import PAPERS, REAL
from docs.pages import judged

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SPEC = spec_from_file_location("metadata", ROOT / "packaging" / "metadata.py")
sys.modules["metadata"] = metadata = module_from_spec(SPEC)  # dataclasses look for it there
SPEC.loader.exec_module(metadata)

TOP = [path for path in ROOT.iterdir() if path.is_file() and path.name != ".git"]
FOLDERS = (
    ".ci",
    ".github",
    "binder",
    "packaging",
    "paper",
    "data",
    "docs",
    "benchmarks",
    "celnav",
    "tests",
)
FILES = [
    *TOP,
    *(
        path
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    ),
]
FORMATS = {
    ".yml": yaml.safe_load,
    ".yaml": yaml.safe_load,
    ".cff": yaml.safe_load,
    ".json": json.loads,
    ".toml": tomllib.loads,
}


def read(path):
    return (ROOT / path).read_text(encoding="utf-8")


# -- versions and formats --------------------------------------------------------------------------
@pytest.mark.parametrize(
    "path", [path for path in FILES if path.suffix in FORMATS], ids=lambda p: p.name
)
def test_a_file_can_be_parsed(path):
    assert FORMATS[path.suffix](path.read_text(encoding="utf-8"))


def test_versions_agree():
    recipe = yaml.safe_load(read("packaging/recipe.yaml"))
    citation = yaml.safe_load(read("CITATION.cff"))
    found = {
        "celnav": celnav.__version__,
        "recipe": recipe["context"]["version"],
        "citation": citation["version"],
        "codemeta": json.loads(read("codemeta.json"))["version"],
        "zenodo": json.loads(read(".zenodo.json"))["version"],
        "changes": re.search(r"^## (\d\S*)", read("CHANGELOG.md"), re.MULTILINE)[1],
    }
    assert set(found.values()) == {PROJECT["version"]}, found
    assert citation["preferred-citation"]["type"] in ("software", "article")


def test_every_version_has_a_date():
    """Only changes that are not released stand above them, without one."""
    headings = re.findall(r"^## (.*)$", read("CHANGELOG.md"), re.MULTILINE)
    if headings[0] == "Unreleased":
        headings = headings[1:]
    found = [
        re.fullmatch(r"(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)(, not published)?\)", h)
        for h in headings
    ]
    assert len(found) >= 2
    assert all(found), headings
    days = [date.fromisoformat(each[2]) for each in found]
    numbers = [[int(n) for n in each[1].split(".")] for each in found]
    assert days == sorted(days, reverse=True)
    assert numbers == sorted(numbers, reverse=True)


def test_the_recipe_asks_for_what_the_package_does():
    requirements = yaml.safe_load(read("packaging/recipe.yaml"))["requirements"]
    needed = [line.replace(" ", "") for line in requirements["run"]]
    assert needed[1:] == PROJECT["dependencies"]
    python = PROJECT["requires-python"]
    assert needed[0] == "python>=${{python_min}}"
    assert f'python_min: "{python.removeprefix(">=")}"' in read("packaging/recipe.yaml")
    built_by = tomllib.loads(read("pyproject.toml"))["build-system"]["requires"]
    assert [line.replace(" ", "") for line in requirements["host"][2:]] == built_by


def test_links_of_the_description_are_absolute():
    """The page of a package index has neither the pictures nor the pages of the repository."""
    hooks = tomllib.loads(read("pyproject.toml"))["tool"]["hatch"]["metadata"]["hooks"]
    text = read("README.md")
    for pair in hooks["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(pair["pattern"], pair["replacement"], text)
    targets = re.findall(r"\]\((.*?)\)", text)
    assert len(targets) == len(re.findall(r"\]\((.*?)\)", read("README.md"))) > 10
    repository = metadata.load().owner["repository"]
    local = [target for target in targets if target.startswith(repository)]
    assert {target for target in targets if "//" not in target or "(" in target} == set()
    for target in local:
        path = target.removeprefix(repository).partition("/main/")[2]
        assert (ROOT / path.partition("#")[0]).exists(), target
    assert f"{repository}/raw/main/docs/csrukf.png" in local
    assert f"{repository}/raw/main/docs/verdicts.svg" in local


# -- what only the owner can state -----------------------------------------------------------------
def test_metadata_is_up_to_date():
    """``python packaging/metadata.py`` writes it."""
    assert metadata.stale(metadata.load()) == []


def test_a_placeholder_is_in_the_list_and_nowhere_else():
    release = metadata.load()
    places = {*metadata.MARKED, *metadata.WHOLE}
    explained = {"packaging/owner.toml", "packaging/metadata.py", "RELEASING.md"}
    explained.add("PKG-INFO")  # of a source archive, made of pyproject.toml
    for path in FILES:
        name = path.relative_to(ROOT).as_posix()
        if path.suffix in (".npz", ".png", ".pyc") or path == Path(__file__):
            continue
        if metadata.PLACEHOLDER in path.read_text(encoding="utf-8", errors="replace"):
            assert name in places | explained, name
    listed = {line.split()[1] for line in metadata.missing(release) if "owner.toml" in line}
    empty = {
        name
        for name, value in release.owner.items()
        if not value or metadata.PLACEHOLDER in str(value)
    }
    assert listed == empty - metadata.OPTIONAL


OWNER = """
authors = [
    { given = "Ada", family = "Lovelace", affiliation = "Here", orcid = "0000-0002-1825-0097" },
    { given = "Émilie", family = "du Châtelet", affiliation = "There" },
    { given = "Mary", family = "Somerville", affiliation = "Here" },
]
repository = "https://example.org/celnav"
documentation = "https://example.org/site"
reports = "reports@example.org"
conda_maintainers = ["ada"]
ai_usage = "None was used."
funding = "There was none."
software_doi = "10.5281/zenodo.1"
paper_doi = ""
codechecker = "Grace Hopper"
codecheck_report = "https://example.org/report"
"""


@pytest.fixture
def copy(tmp_path):
    """A checkout whose owner has filled in the list, and a function that runs the command in it."""
    for path in {*metadata.MARKED, *metadata.WHOLE, *metadata.VERSIONED, "CHANGELOG.md"}:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, tmp_path / path)
    for path in ("packaging/metadata.py", "data/references.bib", "celnav/commands/crate.py"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, tmp_path / path)
    (tmp_path / "packaging" / "owner.toml").write_text(OWNER, encoding="utf-8")

    def run(*words):
        command = [sys.executable, str(tmp_path / "packaging" / "metadata.py"), *words]
        return subprocess.run(command, capture_output=True, encoding="utf-8", check=False)

    return tmp_path, run


def test_a_release_takes_two_commands(copy):
    folder, run = copy
    changes = folder / "CHANGELOG.md"
    if "## Unreleased" not in changes.read_text(encoding="utf-8"):
        changes.write_text(
            changes.read_text(encoding="utf-8").replace(
                "\n## ", "\n## Unreleased\n\n- New.\n\n## ", 1
            ),
            encoding="utf-8",
        )
    before = run("--ready")
    assert before.returncode == 1
    assert "CITATION.cff is not up to date" in before.stderr
    assert '"Unreleased" is not empty' in before.stderr
    assert run("--version", "9.8.7").returncode == 0
    assert run("--check").returncode == 0
    ready = run("--ready", "--tag", "v9.8.7")
    assert (ready.returncode, ready.stderr) == (0, "")
    wrong = run("--ready", "--tag", "v9.8.6")
    assert "tag: expected v9.8.7, got v9.8.6" in wrong.stderr
    texts = {path: path.read_text(encoding="utf-8") for path in folder.rglob("*") if path.is_file()}
    left = [
        path.name
        for path, text in texts.items()
        if metadata.PLACEHOLDER in text and path.name != "metadata.py"
    ]
    assert left == []
    citation = yaml.safe_load(texts[folder / "CITATION.cff"])
    assert [author["family-names"] for author in citation["authors"]] == [
        "Lovelace",
        "du Châtelet",
        "Somerville",
    ]
    assert (citation["version"], citation["doi"]) == ("9.8.7", "10.5281/zenodo.1")
    project = tomllib.loads(texts[folder / "pyproject.toml"])["project"]
    assert project["authors"][1] == {"name": "Émilie du Châtelet"}
    assert project["urls"]["Issues"] == "https://example.org/celnav/issues"
    head = yaml.safe_load(texts[folder / "paper" / "paper.md"].split("---\n")[1])
    assert [author["affiliation"] for author in head["authors"]] == ["1", "2", "1"]
    assert "None was used." in texts[folder / "paper" / "paper.md"]
    assert "<reports@example.org>" in texts[folder / "SECURITY.md"]
    assert json.loads(texts[folder / ".zenodo.json"])["creators"][0]["name"] == "Lovelace, Ada"


# -- notebooks on other people's machines ----------------------------------------------------------
NOTEBOOKS = sorted(path.name for path in (ROOT / "notebooks").glob("*.ipynb"))
SERVICES = "mybinder.org", "colab.research.google.com"


def try_page(repository):
    """What `docs/try.md` says if this is the address of the repository."""
    release = metadata.load()
    return metadata.try_notebooks(
        replace(release, owner=release.owner | {"repository": repository})
    )


def test_without_an_address_nothing_links_to_a_notebook():
    if metadata.PLACEHOLDER not in metadata.load().owner["repository"]:
        pytest.skip("the owner has stated the address")
    assert "](" not in try_page("https://owner.invalid/celnav")
    for path in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        assert not any(f"{name}/" in path.read_text(encoding="utf-8") for name in SERVICES), path


def test_with_an_address_every_notebook_opens_on_binder_and_colab():
    page = try_page("https://github.com/ada/celnav")
    links = re.findall(r"\]\((.*?)\)", page)
    assert len(NOTEBOOKS) == 10
    assert links == [
        link
        for name in NOTEBOOKS
        for link in (
            f"https://mybinder.org/v2/gh/ada/celnav/main?urlpath=lab/tree/notebooks/{name}",
            f"https://colab.research.google.com/github/ada/celnav/blob/main/notebooks/{name}",
        )
    ]
    assert "!git clone --quiet --depth 1 https://github.com/ada/celnav celnav\n" in page
    extras = re.search(r'"\./celnav\[(.*)\]"', page)[1].split(",")
    assert set(extras) <= set(PROJECT["optional-dependencies"])


@pytest.mark.parametrize(
    ("repository", "place"),
    [
        ("https://gitlab.com/ada/nav/celnav", "gl/ada%2Fnav%2Fcelnav"),
        ("https://example.org/celnav", "git/https%3A%2F%2Fexample.org%2Fcelnav"),
    ],
)
def test_a_repository_elsewhere_opens_on_binder_only(repository, place):
    page = try_page(repository)
    assert page.count(f"](https://mybinder.org/v2/{place}/main?") == len(NOTEBOOKS)
    assert "Colab" not in page
    assert "colab" not in page


def test_binder_installs_what_the_notebooks_need():
    lines = read("binder/requirements.txt").splitlines()
    assert "-c ../constraints.txt" in lines
    (own,) = [line for line in lines if line.startswith(".[")]
    extras = set(own[2:-1].split(","))
    (notebooks,) = [
        line for line in PROJECT["optional-dependencies"]["notebooks"] if line.startswith("celnav[")
    ]
    assert set(notebooks[7:-1].split(",")) == extras
    pinned = {line.partition("==")[0] for line in read("constraints.txt").splitlines()}
    others = [line for line in lines if line[0] not in "-#."]
    assert {"pandas", "xarray", "rerun-notebook"} == set(others) <= pinned
    version = read("binder/runtime.txt").strip().removeprefix("python-")
    assert f"Programming Language :: Python :: {version}" in PROJECT["classifiers"]


@pytest.mark.parametrize("version", ["1.2", "v1.2.3", "1.2.3.dev0"])
def test_a_version_that_is_none_is_refused(copy, version):
    folder, run = copy
    changes = (folder / "CHANGELOG.md").read_bytes()
    done = run("--version", version)
    assert done.returncode == 1
    assert f"--version: expected X.Y.Z or X.Y.ZrcN, got {version!r}" in done.stderr
    assert (folder / "CHANGELOG.md").read_bytes() == changes


UNPICKLE = {"pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}


def test_no_file_is_unpickled():
    """`SECURITY.md` says so."""
    loads = 0
    for path in (ROOT / "celnav").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                assert not {name.name.split(".")[0] for name in node.names} & UNPICKLE, path
            elif isinstance(node, ast.ImportFrom):
                assert (node.module or "").split(".")[0] not in UNPICKLE, path
            elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.load", "numpy.load"):
                given = {word.arg: ast.unparse(word.value) for word in node.keywords}
                assert given.get("allow_pickle") == "False", (path, node.lineno)
                loads += 1
    assert loads
    assert "(`allow_pickle=False`)" in read("SECURITY.md")


@pytest.mark.parametrize(
    ("line", "instead", "said"),
    [
        ('affiliation = "There"', 'affiliation = ""', "expected given, family and affiliation"),
        ("reports =", "report =", "expected ai_usage, authors, "),
    ],
)
def test_a_list_that_is_not_complete_is_refused(copy, line, instead, said):
    folder, run = copy
    (folder / "packaging" / "owner.toml").write_text(OWNER.replace(line, instead), encoding="utf-8")
    done = run()
    assert done.returncode == 1
    assert f"packaging/owner.toml: {said}" in done.stderr


# -- workflows and sessions ------------------------------------------------------------------------
NOX = read("noxfile.py")
SESSIONS = set(re.findall(r"^def (\w+)\(session", NOX, re.MULTILINE))


def test_nox_runs_what_ci_runs():
    """Each program of `.ci/run`, with what it is given."""
    commands = re.findall(r'^"\.venv/\$bin/(\w+)" (.*?)(?: #.*)?$', read(".ci/run"), re.MULTILINE)
    assert len(commands) == 7
    called = [
        " ".join(re.findall(r'"([^"]+)"', line))
        for line in re.findall(r"session\.run\((.*)\)", NOX)
    ]
    for program, words in commands:
        words = re.sub(r' "\$work.*', "", words)
        if program != "pip":  # nox builds with build
            assert any(line.startswith(f"{program} {words}") for line in called), (program, words)
    assert "pytest" in called[0]


def test_what_is_said_of_sessions_is_there():
    """In the guide, in the steps of a release, and in the workflows."""
    guide = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", read("CONTRIBUTING.md"), re.MULTILINE)
    assert {name for names in guide for name in re.findall(r"\w+", names)} >= SESSIONS
    pages = [read("RELEASING.md"), *(p.read_text() for p in ROOT.glob(".github/workflows/*.yml"))]
    named = {
        name
        for page in pages
        for names in re.findall(r"nox -s ([a-z ]+)", page)
        for name in names.split()
    }
    assert named <= SESSIONS
    assert {"oldest", "metadata", "ready"} <= named


@pytest.mark.parametrize("path", sorted(ROOT.glob(".github/workflows/*.yml")), ids=lambda p: p.stem)
def test_a_workflow_is_safe_and_complete(path):
    """Actions are pinned to commits, tokens are not kept, and every supported Python is there."""
    text = path.read_text(encoding="utf-8")
    used = re.findall(r"uses: (\S+)( # v\d+\.\d+\.\d+)?$", text, re.MULTILINE)
    assert used
    for action, version in used:
        assert re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", action), action
        assert version, action
    assert text.count("actions/checkout@") == text.count("persist-credentials: false")
    workflow = yaml.safe_load(text)
    assert workflow["permissions"] in ({}, {"contents": "read"})
    assert all("timeout-minutes" in job for job in workflow["jobs"].values())
    versions = [c.rsplit(" ", 1)[1] for c in PROJECT["classifiers"] if ":: 3." in c]
    for job in workflow["jobs"].values():
        matrix = job.get("strategy", {}).get("matrix", {})
        assert matrix.get("python", versions) == versions


@pytest.mark.parametrize(
    "path", sorted(ROOT.glob(".github/ISSUE_TEMPLATE/[!c]*.yml")), ids=lambda p: p.stem
)
def test_a_form_asks_each_thing_once(path):
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    counted = Counter(field["id"] for field in form["body"])
    assert set(counted.values()) == {1}
    assert any(field.get("validations", {}).get("required") for field in form["body"])


def test_the_guide_names_every_room():
    guide = read("CONTRIBUTING.md")
    rooms = {path.name for path in (ROOT / "celnav").iterdir() if path.is_dir()} - {"__pycache__"}
    table = re.findall(r"^\| (`[^|]*`) \|", guide, re.MULTILINE)
    named = {name for cell in table for name in re.findall(r"`([\w.]+)`", cell)}
    assert rooms <= named, rooms - named


# -- the paper -------------------------------------------------------------------------------------
PAPER = read("paper/paper.md")
BODY = re.sub(r"<!--.*?-->", "", PAPER.split("---\n", 2)[2])
PLAIN = " ".join(BODY.split())
SECTIONS = [
    "Summary",
    "Statement of need",
    "State of the field",
    "Software design",
    "Research impact statement",
    "AI usage disclosure",
    "Acknowledgements",
    "References",
]
"""What the Journal of Open Source Software asks for."""


def test_the_paper_has_the_sections_and_the_length_of_the_journal():
    assert re.findall(r"^# (.*)$", BODY, re.MULTILINE) == SECTIONS
    assert 750 <= len(BODY.split()) <= 1750
    head = yaml.safe_load(PAPER.split("---\n")[1])
    assert head["title"] == metadata.TITLE
    assert head["bibliography"] == "paper.bib"


def test_the_paper_cites_what_its_bibliography_has():
    cited = set(re.findall(r"@(\w+)", BODY))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", read("paper/paper.bib"), re.MULTILINE))
    assert {"Tronarp2024", "Yaghoobi2022", "Labbe2014", "Hiscocks2023", "Linderman2025"} <= cited
    assert {"Cuthbert2026", "Navlie"} <= cited


def test_the_paper_counts_the_verdicts_of_the_notebooks():
    count = Counter(row["verdict"] for paper in PAPERS for row in judged(paper))
    fitted = count["reproduced with fitted parameters"]
    assert (
        PLAIN.count(
            f"The six papers make {count.total()} statements. "
            f"We reproduce {count['reproduced']} of them, and {fitted} more with fitted parameters. "
            f"In {count['level only']} cases only the level agrees, {count['in part']} hold in part, "
            f"{count['not reproduced']} do not hold, "
            f"and {count['not addressed']} needs data that we do not have."
        )
        == 1
    )
    assert count.total() == sum(
        count[verdict]
        for verdict in (
            "reproduced",
            "reproduced with fitted parameters",
            "level only",
            "in part",
            "not reproduced",
            "not addressed",
        )
    )
    assert len(REAL) == 5
    assert "Five more studies use measurements" in PLAIN


def test_the_paper_says_what_was_measured():
    """Its table is quoted as those of other pages are; these are its sentences."""
    result = json.loads(MEASURED.read_text(encoding="utf-8"))
    numpy = [
        value_of(result, "filtering", runs, "celnav numpy, square root")
        for runs in ("1 run, 300 epochs", "100 runs, 240 epochs")
    ]
    assert 100 * numpy[1] < 3 * numpy[0]
    assert "of a hundred runs in numpy takes less than three times as long as one" in PLAIN
    many = "filtering", "4,096 runs, 48 epochs"
    assert ratio_of(result, *many, "celnav numpy, covariance", "celnav numpy, square root") < 1
    linear = "shared", "n = 30, m = 15"
    assert ratio_of(result, *linear, "dynamax", "celnav compiled") < 1
    assert "A linear system with 30 states and 512 runs is faster in `dynamax`" in PLAIN


def test_the_paper_says_of_real_data_what_the_readme_says():
    errors = re.search(
        r"`celnav\.colored`: (\S+) m RMS on GRACE-A, (\S+) m predicted; white: (\S+), (\S+) \|",
        read("README.md"),
    )
    colored, predicted, white, too_small = errors.groups()
    assert (
        f"RMS error of {colored} m, and {predicted} m are predicted; a filter that assumes white "
        f"noise has {white} m, and predicts {too_small} m."
    ) in PLAIN
