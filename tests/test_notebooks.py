"""Notebooks were executed in order, their outputs are committed, and lessons contain the algorithm,
not only figures.
"""

from __future__ import annotations

import re
from base64 import b64decode
from datetime import datetime
from html import unescape
from pathlib import Path

import nbformat
import numpy as np
import pytest

from celnav import real
from celnav.papers import PAPERS, load
from celnav.study.ledger import WORDS

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_is_read_in_one_sitting_and_executed(path):
    assert path.stat().st_size < 1_000_000
    notebook = nbformat.read(path, as_version=4)
    assert notebook.metadata.kernelspec.name == "python3"
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    lines = [line for cell in cells for line in cell.source.splitlines() if line.strip()]
    assert len(lines) <= 260
    assert not any(line.lstrip().startswith(("class ", "%", "!")) for line in lines)
    assert not any(output.output_type == "error" for cell in cells for output in cell.outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_begins_with_an_equation_or_a_picture_and_is_as_wide_as_a_page(path):
    """No line of code runs out of its cell, and figures have the width of the page's text."""
    cells = nbformat.read(path, as_version=4).cells
    assert any(
        "$$" in cell.source
        or any("image/png" in output.get("data", {}) for output in cell.get("outputs", ()))
        for cell in cells[:3]
    )
    code = [cell.source for cell in cells if cell.cell_type == "code"]
    assert not [line for source in code for line in source.splitlines() if len(line) > 100]
    assert not [source for source in code if re.search(r"\bsize=\(", source)]


LESSONS = [path for path in NOTEBOOKS if path.stem[3:] in PAPERS]


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_has_the_algorithm_and_something_to_try(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    (by_hand, *_) = [i for i, cell in enumerate(cells) if "allclose" in cell.source]
    assert any("def " in cell.source for cell in cells[: by_hand + 1])
    assert "celnav.run(" in cells[by_hand].source
    lines = [line for cell in cells for line in cell.source.splitlines() if line.strip()]
    assert sum("FIGURES" in line or "figures(" in line for line in lines) < 0.5 * len(lines)
    (one,) = [
        cell.metadata.execution for cell in cells if "try-it" in cell.metadata.get("tags", ())
    ]
    begun, ended = (
        datetime.fromisoformat(one[when]) for when in ("iopub.execute_input", "shell.execute_reply")
    )
    assert (ended - begun).total_seconds() < 5.0


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_begins_with_the_idea_and_ends_with_what_holds(path):
    """An equation and a picture first, the algorithm before the ledger, questions with answers."""
    cells = nbformat.read(path, as_version=4).cells
    assert cells[0].source.count("$$") >= 2
    assert any("image/png" in output.get("data", {}) for output in cells[1].outputs)
    (second,) = [i for i, cell in enumerate(cells) if cell.source.startswith("## What holds")]
    lesson, rest = cells[:second], cells[second:]
    assert any("allclose" in cell.source for cell in lesson[: len(lesson) // 2 + 1])
    assert not any("Ledger(" in cell.source for cell in lesson)
    assert any("Folded(" in cell.source for cell in rest)
    prose = "".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert prose.count("<summary>Answer</summary>") >= 2
    assert not [text for text, id in re.findall(r"\[([^\]]+)\]\(#([\w-]+)\)", prose) if text == id]


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_shows_a_recording_that_a_click_opens(path):
    cells = nbformat.read(path, as_version=4).cells
    (shown,) = [cell for cell in cells if cell.get("attachments")]
    ((name, images),) = shown.attachments.items()
    assert images["image/png"].startswith("iVBOR")
    (recording,) = re.findall(
        rf"\]\(attachment:{name}\)\]\(\.\./out/viewer\.html\?(\S+)\)", shown.source
    )
    assert f"{recording}.rrd".removeprefix(f"{path.stem[3:]}/") in load(path.stem[3:]).RECORDINGS


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_each_verdict_leads_to_the_cell_that_decides_it(path):
    cells = nbformat.read(path, as_version=4).cells
    statements = sorted(row.id for row in load(path.stem[3:]).STUDY.rows if row.kind == "statement")
    told = [
        i
        for i, cell in enumerate(cells)
        if cell.cell_type == "markdown" and "<a id=" in cell.source
    ]
    assert (
        sorted(id for i in told for id in re.findall(r'<a id="say-([\w-]+)"></a>', cells[i].source))
        == statements
    )
    assert all(cells[i + 1].cell_type == "code" for i in told)
    shown = [
        output.get("data", {}).get("text/html", "")
        for cell in cells
        for output in cell.get("outputs", ())
    ]
    assert (
        sorted(id for text in shown for id in re.findall(r'href="#say-([\w-]+)"', text))
        == statements
    )


def verdicts(path):
    """Verdicts by id in the ledgers of an executed notebook."""
    cells = nbformat.read(path, as_version=4).cells
    shown = "".join(
        output.get("data", {}).get("text/html", "")
        for cell in cells
        for output in cell.get("outputs", ())
    )
    return dict(re.findall(r'<tr id="([^"]*)" data-verdict="([^"]*)"', shown))


@pytest.mark.parametrize("path", LESSONS, ids=lambda p: p.stem)
def test_a_lesson_has_the_verdicts_that_are_expected(path):
    """It was executed with all runs."""
    expected = {
        row.id: row.expected or WORDS[row.kind][0] for row in load(path.stem[3:]).STUDY.rows
    }
    found = verdicts(path)
    assert found
    assert found == {id: expected[id] for id in found}


@pytest.mark.parametrize("study", real.STUDIES)
def test_the_notebook_on_real_data_has_the_verdicts_that_are_expected(study):
    """Its outputs come from the real files, which are not available in tests."""
    found = verdicts(next(path for path in NOTEBOOKS if path.stem[3:] == "real_data"))
    for row in real.load(study).STUDY.rows:
        # Without the package that a row compares with, no verdict is expected.
        if row.kind == "finding" and row.expected != "no number":
            assert found[row.id] in ("undecided", row.expected or "shown"), row.id


def test_the_notebook_on_real_data_says_once_why_ranges_were_revised():
    """Each study's rows that were revised for one reason share one note, which counts them."""
    (path,) = [path for path in NOTEBOOKS if path.stem[3:] == "real_data"]
    cells = nbformat.read(path, as_version=4).cells
    html = "".join(
        output.get("data", {}).get("text/html", "")
        for cell in cells
        for output in cell.get("outputs", ())
    )
    notes = re.findall(r"Accepted range revised: (.*?)(?:<|$)", html, re.MULTILINE)
    assert notes
    assert len(notes) == len(set(notes))
    others = [int(count) for note in notes for count in re.findall(r"this and (\d+) other", note)]
    rows = [row for study in real.STUDIES for row in real.load(study).STUDY.rows]
    assert len(notes) + sum(others) == sum(
        row.revised is not None and row.kind == "finding" for row in rows
    )


def notebook(stem):
    """A notebook by its name."""
    return nbformat.read(NOTEBOOKS[0].with_name(f"{stem}.ipynb"), as_version=4)


RECORDED = {
    "00_tour": "tour/falling_body",
    "06_campaign": "campaign/camera",
    "08_methods": "methods/imm",
}
"""Recordings that notebooks write themselves, below the folder of `celnav reproduce`."""


@pytest.mark.parametrize("stem", RECORDED)
def test_a_notebook_shows_the_recording_that_its_next_cell_writes(stem):
    cells = notebook(stem).cells
    (i,) = [i for i, cell in enumerate(cells) if cell.get("attachments")]
    ((name, images),) = cells[i].attachments.items()
    png = b64decode(images["image/png"])
    assert png.startswith(b"\x89PNG")
    assert len(png) <= 150_000
    link = f"](attachment:{name})](../out/viewer.html?{RECORDED[stem]})"
    assert link in cells[i].source
    assert f'recordings.place("{RECORDED[stem]}")' in cells[i + 1].source
    assert cells[i + 1].source.endswith("recordings.for_browser(file)")


def test_what_a_notebook_records_opens_in_the_browser(tmp_path, monkeypatch):
    pytest.importorskip("rerun")
    monkeypatch.syspath_prepend(NOTEBOOKS[0].parent)
    from plots import recordings

    from celnav.show import recording, viewer, views

    monkeypatch.setattr(recordings, "OUT", tmp_path)
    monkeypatch.setattr(viewer, "available", lambda: True)
    monkeypatch.setattr(viewer, "viewer", lambda: {viewer.PAGE: b"page", viewer.SCRIPT: b"code"})
    monkeypatch.setattr(viewer, "is_current", lambda folder: False)
    file = recordings.place("tour/a")
    assert file == tmp_path / "tour" / "a.rrd"
    times, layout = np.arange(3.0), views.plot("x", "x")
    with recording.recording(file, times, name="a", layout=layout, start=1.0) as out:
        out.curve("x", times, "#000000", "x")
    recordings.for_browser(file)
    script = viewer.as_script(file.read_bytes(), 1.0)
    assert (tmp_path / "tour" / "a.rrd.js").read_bytes() == script
    assert (tmp_path / viewer.PAGE).read_bytes() == b"page"
    assert (tmp_path / viewer.SCRIPT).read_bytes() == b"code"


def prose_of(stem):
    """The text of a notebook, on one line."""
    cells = notebook(stem).cells
    texts = [cell.source for cell in cells if cell.cell_type == "markdown"]
    return " ".join(" ".join(texts).split())


def folded_tables(stem):
    """Numbers of the folded tables of a notebook, by title, row and column; without intervals."""
    tables = {}
    for cell in notebook(stem).cells:
        for output in cell.get("outputs", ()):
            page = output.get("data", {}).get("text/html", "")
            for title, body in re.findall(r"<summary><b>(.*?)</b></summary>(.*)", page, re.DOTALL):
                head, *rows = [
                    re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)
                    for row in re.findall(r"<tr>(.*?)</tr>", body, re.DOTALL)
                ]
                tables[title] = {
                    unescape(name): {
                        column: float(text.split(" [")[0]) if text else np.nan
                        for column, text in zip(head[1:], texts, strict=True)
                    }
                    for name, *texts in rows
                }
    return tables


ONE_TURN, ALWAYS = "Straight with one turn: RMSE and NEES / 8", "Always turning: RMSE and NEES / 8"
CIRCLE, MODEL, NOISY = "Truth on the circle", "Truth from the model", "10 m, 3 assumed"
FLIGHT = "straight", "turn", "straight again"
PARTS = "before", "burst", "5 s after it", NOISY
ITERATED, ITERATIONS = "Errors and NEES / 13 of all filters", ("1 iteration", "2 iterations")


def test_numbers_in_the_text_on_methods_are_those_of_its_tables():
    """Each phrase, with its numbers computed from the tables and rounded as they stand there."""
    tables, prose = folded_tables("08_methods"), prose_of("08_methods")

    def value(title, row, column):
        return tables[title][row][column]

    def over(title, a, b, column="burst"):
        rows = (f"position, m: {name}" for name in (a, b))
        return np.divide(*(value(title, row, column) for row in rows))

    def informed(title, name, column="burst"):
        return value(title, f"position error over UKF, true noise: {name}", column)

    def span(values, digits):
        low, high = (f"{f(values):.{digits}f}" for f in (min, max))
        return f"{low} to {high}"

    config = load("aukf").PRESETS["burst"]
    density = config.acceleration_noise
    times_noise = density * config.interval_s / config.sigma_rate_m_per_s**2
    ukf, window, sage, bayes = "UKF", "window of 10 (AUKF)", "Sage-Husa", "variational Bayes"
    aukf, over_q, over_both = "AUKF, Q turn", "IMM over Q", "IMM over Q and R"
    straight = "velocity, m/s: UKF, Q straight"
    nees = [value(ONE_TURN, f"NEES / 8: {over_q}", part) for part in FLIGHT]
    noisy = {
        name: [informed(title, name, NOISY) for title in (CIRCLE, MODEL)]
        for name in (ukf, window, sage, bayes)
    }
    (twice,) = {
        round(
            value(ONE_TURN, f"velocity, m/s: {aukf}", part)
            / value(ONE_TURN, f"velocity, m/s: {over_q}", part)
        )
        for part in ("straight", "straight again")
    }
    assert twice == 2  # "its velocity error in straight flight is twice as large"
    thousands = value(ONE_TURN, "NEES / 8: UKF, Q straight", "turn")
    errors = {n: value(ITERATED, f"UKF, {n}", "RMSE at 0 s, arcsec") for n in ITERATIONS}
    (linearized,) = re.findall(r"The third linearizes at (\d+)″", prose)
    assert abs(float(linearized) - errors["2 iterations"]) < 0.55  # the table has three digits
    degrees = errors["1 iteration"] / 3600.0
    left = 3600.0 * np.degrees(0.5 * np.radians(degrees) ** 2)
    second = 3600.0 * np.degrees(0.5 * np.radians(errors["2 iterations"] / 3600.0) ** 2)
    assert 0.002 < second < 0.005  # "half of the square is a few thousandths of an arcsecond"
    assert 50.0 < left < 75.0  # "about a minute of arc"
    bayes_over = [value(MODEL, f"NEES / 8: {bayes}", part) for part in PARTS]
    assert all(1.2 <= ratio <= 1.34 for ratio in bayes_over)  # "by a quarter to a third in NEES"
    sage_nees = {
        title: [value(title, f"NEES / 8: {sage}", part) for part in PARTS]
        for title in (CIRCLE, MODEL)
    }
    assert min(sage_nees[CIRCLE]) > 2.0  # "NEES / 8 is above 2 on the circle"
    assert all(0.4 < ratio < 0.7 for ratio in sage_nees[MODEL])  # "and about 0.5 with ..."
    gain = 1.0 - over(ALWAYS, over_both, aukf)
    assert round(1.0 / gain) == 8
    loss = over(ALWAYS, over_both, aukf, "before") - 1.0
    assert round(over(ALWAYS, over_q, aukf)) == 10
    assert round(informed(CIRCLE, ukf)) == 12
    assert round(informed(MODEL, ukf)) == 5
    for phrase in (
        f"($a^2 T$ = {density:.0f} m²/s³",
        f"= {round(times_noise, -1):.0f} times the noise",
        f"its velocity error is {value(ONE_TURN, straight, 'turn'):.0f} m/s",
        f"its NEES is {round(thousands, -3):.0f} times too large",
        "its velocity error in straight flight is twice as large",
        f"NEES / 8 is {span(nees, 1)} in all three parts",
        f"its error in the burst is {over(ONE_TURN, over_q, aukf):.1f} times that of the AUKF",
        "with ten times the AUKF's error in the burst",
        f"its error in the burst is {over(ONE_TURN, over_both, aukf):.1f} times that of the AUKF",
        f"it gains an eighth in the burst and loses {100.0 * loss:.0f} % before",
        f"half of ({degrees:.1f}°)², in radians, is about a minute of arc",
        "half of the square is a few thousandths of an arcsecond",
        "overconfident with the second truth, by a quarter to a third in NEES",
        "NEES / 8 is above 2 on the circle, and about 0.5 with the second truth",
        "twelve times that of the filter with the true noise, or five times",
        f"({informed(CIRCLE, window):.2f} times on the circle)",
        f"({informed(MODEL, sage):.2f} times with the second truth)",
        f"the error of the UKF is {span(noisy[ukf], 1)} times",
        f"The window has {np.mean(noisy[window]):.1f} times",
        f"variational Bayes {span(noisy[bayes], 1)} times",
        f"Husa's recursion {span(noisy[sage], 1)} times",
    ):
        assert phrase in prose, phrase


def test_there_are_notebooks():
    assert NOTEBOOKS
