"""Studies on real data: computed if their data are given, otherwise only listed."""

from __future__ import annotations

import re
from types import SimpleNamespace

import pytest
from test_cli import numbers, tiny

from celnav import cli, papers, real
from celnav.show.claims import answer
from celnav.study.ledger import Number, Row, Sentence
from celnav.study.study import Part, Study


def measured():
    """A study that takes no time: its result is the length of its folder's name."""

    def parts(effort, clocks):
        (file,) = real.found(clocks, ["*.txt"])
        return {"all": Part(numbers, len(file.read_text()), 0, 1, 1, 1.0)}

    rows = [
        Row(
            "finding",
            "one",
            "The clock runs",
            lambda r: Number("x", r.get("all", "x/nees").size, (4.0, 4.0), (4.0, 4.0)),
        ),
        Row("check", "two", "It is so", lambda r: Number("x", 1.0, (0.0, 1.5))),
    ]
    study = Study(
        "clocks",
        (),
        None,
        parts,
        rows,
        "How well does it run?",
        [Sentence("It runs {one[0]:.1f} well.", {"one": "shown"})],
        "figure_01",
    )
    plain = tiny()
    return SimpleNamespace(
        TITLE="A real <clock>",
        CITATION="@misc{clock, author = {Harrison, John}, year = {1761}}",
        RECORDINGS=[],
        STUDY=study,
        INPUTS=("clocks",),
        FIGURES={"figure_01": ("A drift.", plain.FIGURES["figure_01"][1])},
        TABLES={},
        record=lambda r, o: [],
    )


@pytest.fixture
def both(monkeypatch):
    """A paper and a study on real data."""
    monkeypatch.setattr(papers, "PAPERS", {"tiny": "tiny"})
    for key in list(real.STUDIES):
        monkeypatch.delitem(real.STUDIES, key)
    monkeypatch.setitem(real.STUDIES, "clocks", "a clock's log")
    modules = {"tiny": tiny, "celnav.real.clocks": measured}
    monkeypatch.setattr("celnav.papers.import_module", lambda name: modules[name]())


@pytest.fixture
def folder(tmp_path):
    """Its data."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "a.txt").write_text("42")
    return str(tmp_path / "data")


def test_with_a_folder_papers_and_study_are_done(both, folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["reproduce", "--clocks", folder, "--out", str(out), "--jobs", "1"]) == 0
    assert (out / "tiny/claims.json").exists()
    assert (out / "clocks/figures/figure_01.png").exists()
    page = (out / "index.html").read_text()
    heading = page.index("<h2>On real data</h2>")
    assert page.index('id="tiny"') < heading < page.index('id="clocks"')
    rest = page[heading:]
    assert "A real &lt;clock&gt;" in rest
    assert "How well does it run?" in rest
    assert "<b>We find:</b> It runs 4.0 well." in rest
    assert "The paper:" not in rest
    assert "reproduced" not in rest
    assert "1 finding: 1 shown" in rest
    assert re.search(r'<td role="cell" class="good">shown', rest)
    assert "<th>printed</th>" not in rest
    assert "--clocks DIR" not in page
    assert "Harrison (1761)" in rest
    assert "07_real_data.ipynb" in rest


def test_claims_of_another_version_leave_no_numbers():
    found = measured().STUDY.found
    claim = {"id": "one", "verdict": "shown", "numbers": [{"value": None}]}
    assert answer(found, [claim]) == "It runs nan well."
    assert answer(found, [claim | {"numbers": []}]).startswith("(a sentence that cannot be made")
    assert answer(found, []).endswith("other verdicts: one (not among these rows).")


def test_without_one_the_page_only_says_what_could_be_added(both, tmp_path):
    assert cli.main(["reproduce", "--out", str(tmp_path), "--jobs", "1"]) == 0
    page = (tmp_path / "index.html").read_text()
    assert page.count("clock") == 2
    assert "<li><code>--clocks DIR</code>: a clock&#39;s log</li>" in page
    assert not (tmp_path / "clocks").exists()


def test_one_study_alone(both, folder, tmp_path):
    assert (
        cli.main(
            [
                "reproduce",
                "clocks",
                "--clocks",
                folder,
                "--out",
                str(tmp_path / "out"),
                "--jobs",
                "1",
            ]
        )
        == 0
    )
    assert not (tmp_path / "out/tiny").exists()
    assert 'id="clocks"' in (tmp_path / "out/index.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (
            ["reproduce", "clocks"],
            "clocks: expected --clocks DIR with it, a folder of a clock's log",
        ),
        (["reproduce", "tiny", "--clocks", "."], "--clocks: expected the study clocks, got tiny"),
        (
            ["reproduce", "--clocks", "nowhere"],
            "--clocks: expected a folder that exists, got 'nowhere'",
        ),
        (
            ["reproduce", "clock"],
            "unknown paper 'clock': expected one of tiny, clocks, a file FILE.py; did you mean "
            "clocks?",
        ),
        (["view", "clocks"], "clocks: has no recordings\n"),
    ],
)
def test_a_mistake_is_one_line(both, tmp_path, monkeypatch, capsys, arguments, text):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


def test_they_are_listed(both, capsys):
    assert cli.main(["list", "clocks"]) == 0
    told = capsys.readouterr().out
    assert "celnav reproduce clocks --clocks DIR: a clock's log" in told
    with pytest.raises(ValueError, match="unknown paper 'grade': expected one of tiny, clocks"):
        real.load("grade")


@pytest.mark.parametrize("study", real.STUDIES)
def test_a_study_has_the_shape_of_a_paper(study):
    module = real.load(study)
    assert list(module.INPUTS) == [study]
    assert module.STUDY.name == study
    assert {row.kind for row in module.STUDY.rows} <= {"finding", "check"}
    assert module.CITATION.startswith("@")
    assert module.TITLE
    assert module.STUDY.says
    assert module.STUDY.found
    assert module.STUDY.figure in module.FIGURES
    assert callable(module.record)
