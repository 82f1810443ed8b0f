"""What others read and check: the schema of a ledger, the RO-Crate of a run, and the manifest for
CODECHECK.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from email.message import Message
from hashlib import sha256
from pathlib import Path

import pytest
import yaml
from jsonschema import Draft202012Validator
from test_cli import tiny
from test_notebooks import NOTEBOOKS, verdicts

import celnav
from celnav import cli, papers
from celnav.commands import crate
from celnav.files import data
from celnav.papers import PAPERS, load
from celnav.show.claims import PARTS, SCHEMA, TYPES, dumps, read_claims
from celnav.study.ledger import BETWEEN, KINDS, OPEN, VERDICTS, Number, Row
from docs.pages import codecheck, manifest

ROOT = Path(__file__).parents[1]
SCHEMA_FILE = json.loads(data("claims.schema.json").read_text(encoding="utf-8"))
VALIDATOR = Draft202012Validator(SCHEMA_FILE)


def claims():
    """A document with each kind, verdict and form of a number."""
    rows = [
        Row("statement", f"is-{n}", "It is so", lambda _, word=word: {word: [Number("x", 1.0)]})
        for n, word in enumerate(VERDICTS)
    ]
    rows += [Row(kind, kind, "It is so", expected="undecided") for kind in KINDS]
    forms = [
        Number("x", 1.0, (0.0, None), (0.5, 1.5), 2.0, runs=10, printed_runs=5, printed_count=3),
        Number("x", float("nan"), (None, 3.0), (float("nan"), float("inf")), strict=True),
    ]
    printed = (1, 0.5, "12 %", [1.0, "a"], {"a": [1.0, None]})
    rows += [
        Row("finding", f"form-{n}", "It is so", lambda _: forms, printed=value, revised=revised)
        for n, value in enumerate(printed)
        for revised in ["2026-01-01: more runs. 2026-01-02: wider"]
    ]
    return json.loads(dumps([row.judged(None) for row in rows]))


def test_the_schema_is_one_and_describes_what_is_written():
    Draft202012Validator.check_schema(SCHEMA_FILE)
    assert SCHEMA_FILE["$id"] == SCHEMA == f"urn:celnav:claims:{SCHEMA_FILE['version']}"
    parts = SCHEMA_FILE["$defs"]
    assert set(parts["claim"]["properties"]) == set(TYPES)
    assert set(parts["claim"]["required"]) < set(TYPES)
    assert set(parts["number"]["required"]) == PARTS
    assert set(parts["number"]["properties"]) == PARTS | set(Number._fields)
    assert parts["claim"]["properties"]["kind"]["enum"] == list(KINDS)
    assert set(parts["verdict"]["enum"]) == set(VERDICTS)
    assert set(parts["claim"]["if"]["properties"]["verdict"]["enum"]) == set(OPEN)
    document = claims()
    VALIDATOR.validate(document)
    assert {claim["verdict"] for claim in document["claims"]} >= {*VERDICTS, *BETWEEN} - {
        "no number"
    }


def _without(key):
    def change(claim):
        del claim[key]

    return change


WRONG = {
    "missing verdict": _without("verdict"),
    "missing revisions": _without("revised"),
    "unknown verdict": lambda claim: claim.update(verdict="true"),
    "unknown kind": lambda claim: claim.update(kind="opinion"),
    "unknown key": lambda claim: claim.update(verdct="reproduced"),
    "revision without a date": lambda claim: claim.update(revised="wider"),
    "no accepted range": lambda claim: claim["numbers"][0].pop("accept"),
    "interval with one end": lambda claim: claim["numbers"][0].update(ci=[0.5]),
    "text as a number": lambda claim: claim["numbers"][0].update(value="1.0"),
    "half a run": lambda claim: claim["numbers"][0].update(runs=0.5),
    "open and true": lambda claim: claim.update(verdict="undecided", holds=True),
    "closed and open": lambda claim: claim.update(holds=None),
}


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG)
def test_a_wrong_document_is_refused(change):
    document = claims()
    document["claims"] = document["claims"][:1]
    VALIDATOR.validate(document)
    change(document["claims"][0])
    assert not VALIDATOR.is_valid(document)


def test_a_document_names_its_schema_and_extensions_have_a_prefix():
    document = claims()
    assert not VALIDATOR.is_valid(document["claims"])
    assert not VALIDATOR.is_valid(document | {"schema": "urn:celnav:claims:0.9"})
    assert not VALIDATOR.is_valid(document | {"author": "me"})
    document["x-author"] = document["claims"][0]["x-author"] = "me"
    VALIDATOR.validate(document)


@pytest.mark.parametrize("name", ["ci", "accept"])
def test_ends_in_the_wrong_order_are_refused_before_they_are_written(name):
    number = Number("x", 1.0)._replace(**{name: (2.0, 1.0)})
    with pytest.raises(ValueError, match=rf"one: {name}: expected .* low <= high, got \(2.0, 1.0"):
        Row("finding", "one", "It is so", lambda _: number).judged(None)


def test_a_revision_has_a_date():
    with pytest.raises(ValueError, match="revised: expected a date and a reason"):
        Row("finding", "one", "It is so", revised="wider")


def test_the_page_on_the_ledger_shows_a_valid_one(tmp_path):
    page = (ROOT / "docs" / "ledger.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"```json\n(.*?)```", page, re.DOTALL)
    document = json.loads(shown)
    VALIDATOR.validate(document)
    required = SCHEMA_FILE["$defs"]["claim"]["required"]
    assert all(f"`{name}`" in page for name in (*required, *PARTS))
    (claim,) = document["claims"]
    assert set(claim) == set(required)
    ((low, high), (least, most)) = (claim["numbers"][0][name] for name in ("ci", "accept"))
    assert claim["verdict"] == "undecided"
    assert least is None
    assert low < most < high


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_verdicts_of_notebooks_are_in_the_schema(path):
    assert set(verdicts(path).values()) <= set(SCHEMA_FILE["$defs"]["verdict"]["enum"])


# -- RO-Crate --------------------------------------------------------------------------------------
@pytest.fixture
def study(monkeypatch):
    module = tiny()
    module.CITATION = load("tstdkf").CITATION
    monkeypatch.setattr(papers, "PAPERS", {"tiny": "tiny"})
    monkeypatch.setattr("celnav.papers.import_module", lambda name: module)
    return module


def entities(folder):
    document = json.loads((folder / crate.NAME).read_text(encoding="utf-8"))
    graph = {entity["@id"]: entity for entity in document["@graph"]}
    assert len(graph) == len(document["@graph"])
    return graph


def references(value):
    """All values of ``@id`` within an entity."""
    if isinstance(value, dict):
        yield from [value["@id"]] if set(value) == {"@id"} else ()
        value = list(value.values())
    if isinstance(value, list):
        for part in value:
            yield from references(part)


def check_crate(folder):
    """The rules of RO-Crate 1.1 and Process Run Crate 0.5, and the hashes of all files."""
    graph = entities(folder)
    assert graph[crate.NAME]["about"] == {"@id": "./"}
    root, run = graph["./"], graph["#run"]
    assert {"name", "description", "datePublished", "license"} <= set(root)
    assert (root["@type"], run["@type"]) == ("Dataset", "CreateAction")
    assert root["conformsTo"]["@id"] == crate.PROFILE in graph
    assert graph[run["instrument"]["@id"]]["@type"] == "SoftwareApplication"
    outside = {crate.SPECIFICATION}
    assert {id for entity in graph.values() for id in references(entity)} <= {*graph} | outside
    files = {id for id, entity in graph.items() if entity["@type"] == "File"}
    assert set(references(root["hasPart"])) == set(references(run["result"])) == files
    for id in files:
        content = (folder / id).read_bytes()
        if crate.CHANGING.search(id):
            assert "sha256" not in graph[id]
        else:
            assert graph[id]["contentSize"] == str(len(content))
            assert graph[id]["sha256"] == sha256(content).hexdigest()
    return graph


def test_a_run_describes_itself_and_all_its_files(study, tmp_path):
    assert cli.main(["reproduce", "--out", str(tmp_path), "--jobs", "1", "--effort", "1"]) == 0
    graph = check_crate(tmp_path)
    written = {
        path.relative_to(tmp_path).as_posix()
        for path in tmp_path.rglob("*")
        if path.is_file() and not any(part.startswith(".") for part in path.parts)
    }
    assert written - {crate.NAME} == {id for id, e in graph.items() if e["@type"] == "File"}
    assert graph["tiny/figures/figure_01.png"]["encodingFormat"] == "image/png"
    assert graph["#run"]["name"] == "celnav reproduce tiny --effort 1 --seed 0 --engine auto"
    assert graph["#celnav"]["softwareVersion"].startswith(f"{celnav.__version__}+code.")
    for package in references(graph["#celnav"]["softwareRequirements"]):
        assert re.fullmatch(r"https://\S+/|pkg:pypi/\S+@\S+", package)
        assert graph[package]["url"].startswith("https://")
        assert graph[package]["softwareVersion"] in package
    paper = graph["./"]["citation"]["@id"]  # the only one, so it is not a list
    assert paper == "https://doi.org/10.7527/S1000-6893.2021.26120"
    assert graph[paper]["name"].startswith("Two-stage strong tracking differential Kalman filter")
    assert len(graph[paper]["author"]) == 5
    assert (
        graph["#input/pulsars.toml"]["sha256"]
        == sha256(data("pulsars.toml").read_bytes()).hexdigest()
    )


def test_the_same_command_writes_the_same_crate(study, tmp_path):
    for out, jobs in (("one", "1"), ("two", "2"), ("one", "1")):
        words = ["reproduce", "--out", str(tmp_path / out), "--jobs", jobs, "--effort", "1"]
        assert cli.main(words) == 0
    one, two = ((tmp_path / out / crate.NAME).read_bytes() for out in ("one", "two"))
    assert one == two


@pytest.mark.parametrize(
    ("address", "url"),
    [("https://a.invalid/celnav", None), ("https://example.org/celnav",) * 2],
)
def test_the_address_of_celnav_is_written_once_it_is_known(monkeypatch, address, url):
    fields = Message()
    fields["Project-URL"] = f"Homepage, {address}"
    monkeypatch.setattr(crate.metadata, "metadata", lambda name: fields)
    assert crate._software("celnav", "1.2.3").get("url") == url


def test_a_crate_of_others_is_not_replaced(study, tmp_path, capsys):
    (tmp_path / crate.NAME).write_text("mine")
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 2
    assert crate.NAME in capsys.readouterr().err
    assert (tmp_path / crate.NAME).read_text() == "mine"


def test_the_files_of_a_folder_that_a_study_takes_are_inputs(study, tmp_path):
    folder, parts = tmp_path / "log", study.STUDY.parts
    folder.mkdir()
    (folder / "day.obs").write_text("a receiver's log")
    study.INPUTS = ("rinex",)
    study.STUDY = replace(study.STUDY, parts=lambda effort, rinex=None: parts(effort))
    words = ["reproduce", "--out", str(tmp_path / "out"), "--jobs", "1", "--effort", "1"]
    assert cli.main([*words, "--rinex", str(folder)]) == 0
    graph = check_crate(tmp_path / "out")
    content = (folder / "day.obs").read_bytes()
    assert graph["#input/log/day.obs"]["sha256"] == sha256(content).hexdigest()
    assert {"@id": "#input/log/day.obs"} in graph["#run"]["object"]
    assert graph["#run"]["name"].endswith("--engine auto --rinex log")


def test_a_new_study_has_a_valid_ledger_and_a_crate(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "study.py"]) == 0
    assert cli.main(["reproduce", "study.py", "--effort", "0.02", "--jobs", "1"]) == 0
    graph = check_crate(Path("out"))
    assert graph["#input/study.py"]["sha256"] == sha256(Path("study.py").read_bytes()).hexdigest()
    assert graph["#license"]["description"].endswith("its author states the license.")
    for name in ("claims", "checks"):
        VALIDATOR.validate(json.loads(Path(f"out/study/{name}.json").read_text()))
    assert read_claims("out/study/claims.json")


def test_the_date_of_a_crate_is_that_of_the_release():
    heading = rf"^## {re.escape(celnav.__version__)} \((\d{{4}}-\d\d-\d\d)"
    dated = re.search(heading, (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", crate.RELEASED)
    assert dated is None or dated[1] == crate.RELEASED


# -- CODECHECK -------------------------------------------------------------------------------------
def test_the_manifest_has_each_numbered_figure_and_table_of_a_paper():
    check = yaml.safe_load((ROOT / "codecheck.yml").read_text(encoding="utf-8"))
    assert check["version"] == "https://codecheck.org.uk/spec/config/1.0/"
    assert check["manifest"] == manifest()
    assert codecheck() == (ROOT / "codecheck.yml").read_text(encoding="utf-8")
    # The validator of the CODECHECK register refuses a file that begins with anything else.
    assert codecheck().startswith("---\n")
    assert check["paper"]["reference"].startswith("https://")
    files = {item["file"] for item in manifest()}
    for paper in PAPERS:
        module = load(paper)
        for stem, (caption, _) in module.FIGURES.items():
            listed = f"out/{paper}/figures/{stem}.png" in files
            assert listed == (not caption.startswith("Beyond the paper")), caption
        for stem, (caption, _) in module.TABLES.items():
            listed = f"out/{paper}/tables/{stem}.csv" in files
            assert listed == (not caption.startswith("Beyond the paper")), caption
    titles = [re.sub(r"[{}]", "", title) for title in check["celnav_papers"]]
    for paper, title in zip(PAPERS, titles, strict=True):
        (said,) = re.findall(r"title\s*=\s*\{(.*?)\},?\n  \w", load(paper).CITATION, re.DOTALL)
        assert title == " ".join(re.sub(r"[{}]", "", said).split())


def test_what_only_the_owner_can_state_has_placeholders():
    check = yaml.safe_load((ROOT / "codecheck.yml").read_text(encoding="utf-8"))
    assert check["codechecker"][0]["name"]
    assert check["report"]
    assert check["paper"]["authors"][0]["name"] in (ROOT / "CITATION.cff").read_text("utf-8")
    assert check["paper"]["title"] in (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")
