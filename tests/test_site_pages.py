"""The built site: links, headings, pictures, contrast and search, without a browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from base64 import b64encode
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import celnav
from celnav.papers import PAPERS, load

pytest.importorskip("sphinx")
from docs import conf, papers
from docs.__main__ import within

ROOT = Path(__file__).parents[1]
RECORDING = "csrukf/csrukf_P_I"
DOCS = ROOT / "docs"
NODE = shutil.which("node")
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if path.name != "index.md"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built in a separate process, as by a user."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "docs", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return out


class Page(HTMLParser):
    """Links, anchors, headings and images of a page; only headings inside the article are included."""

    def __init__(self, text):
        super().__init__()
        self.links, self.anchors, self.headings, self.images, self.inside = [], set(), [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.inside |= tag == "article"
        self.anchors |= {given["id"]} if given.get("id") else set()
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag == "img" and self.inside:
            self.images.append(given)
        if re.fullmatch("h[1-6]", tag) and self.inside:
            self.headings.append(int(tag[1]))

    def handle_endtag(self, tag):
        self.inside &= tag != "article"


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}


def test_links_lead_somewhere(site, pages):
    """Pages and anchors of the site; notebooks may link to what `celnav reproduce` writes."""
    lost = []
    for path, page in pages.items():
        for link in page.links:
            if re.match(r"[a-z]+:", link) or link == "#":
                continue
            name, _, anchor = link.split("?")[0].partition("#")
            target = (path.parent / name).resolve() if name else path
            if not target.exists() or (
                anchor and target in pages and anchor not in pages[target].anchors
            ):
                lost.append((path.name, link))
    assert lost == []


def test_headings_are_in_order(pages):
    for path, page in pages.items():
        assert page.headings.count(1) == 1, path
        assert page.headings[0] == 1, path
        assert np.diff(page.headings).max(initial=0) <= 1, (path, page.headings)


def test_pictures_are_there_and_say_what_they_show(site, pages):
    for path, page in pages.items():
        for image in page.images:
            assert image.get("alt"), (path, image)
            assert image["src"].startswith("data:") or (path.parent / image["src"]).exists(), image


def test_the_front_page_draws_what_its_program_draws(site):
    """The figure is made while the site is built."""
    assert not (DOCS / "report.svg").exists()
    text = (site / "index.html").read_text(encoding="utf-8")
    figure = re.search(r'src="(_images/report[^"]*\.svg)"', text)[1]
    assert (site / figure).stat().st_size > 10_000
    assert "howto/inertial.html" in text
    assert "glossary.html" in text


# -- the pages of papers ---------------------------------------------------------------------------
def test_the_page_of_a_paper_shows_the_figure_that_decides_and_folds_the_others(site):
    for paper in PAPERS:
        text = (site / "papers" / f"{paper}.html").read_text(encoding="utf-8")
        shown, folded = text.split("<details><summary>")
        decides = f"_static/papers/{paper}/{load(paper).STUDY.figure}.png"
        assert re.findall(r'<img [^>]*src="\.\./([^"]*)"', shown) == [decides]
        count, rest = folded.split(" other figures</summary>", 1)
        assert rest[: rest.index("</details>")].count("<img ") == int(count) >= 3
        assert text.count('class="sign"') == sum(
            row.kind == "statement" for row in load(paper).STUDY.rows
        )
        assert "viewer.html" not in text  # no recordings are given


def test_each_square_leads_to_its_row(site, pages):
    links = [link for link in pages[site / "verdicts.html"].links if link.startswith("papers/")]
    rows = [link.partition("#")[2] for link in links]
    counts = {
        paper: sum(row.kind == "statement" for row in load(paper).STUDY.rows) for paper in PAPERS
    }
    for paper, count in counts.items():
        assert sum(row.startswith(f"{paper}-") for row in rows) == count


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('FIGURES["figure_02b"][1](results)', ["figure_02b"]),
        ("display(*figures(8, 5))", ["figure_08", "figure_05"]),
        ("figure(7)", ["figure_07"]),
        ('display(figure("02b"), figure("13"))', ["figure_02b", "figure_13"]),
        ('for number in (1, 2):\n    FIGURES[f"figure_{number:02d}"]', ["figure_01", "figure_02"]),
        ("plt.plot(x)", []),
    ],
)
def test_the_figures_of_a_cell_are_those_that_it_draws(source, found):
    assert papers.stems(source) == found


def test_results_give_their_figures_and_recordings(tmp_path):
    """Of each paper that was reproduced; a recording has a link if the viewer is there."""
    results, source, out = (tmp_path / name for name in ("results", "source", "out"))
    for name in ("csrukf/figures/figure_08.png", "csrukf/csrukf_P_I.rrd.js", "viewer.html"):
        (results / name).parent.mkdir(parents=True, exist_ok=True)
        (results / name).write_bytes(b"a" * 2_000_000)
    source.mkdir()
    for viewed in (False, True):
        if viewed:
            (results / "viewer.js").write_text("")
        shutil.rmtree(source)
        source.mkdir()
        shutil.copy(DOCS / "verdicts.md", source)
        papers.write_pages(source, results)
        page = (source / "papers" / "csrukf.md").read_text(encoding="utf-8")
        assert page.count("<img ") == 1
        link = '<a href="../viewer.html?csrukf/csrukf_P_I">▶\u00a0csrukf_P_I</a> (2.0 MB)'
        assert (link in page) == viewed
    assert (source / "_static/papers/csrukf/figure_08.png").stat().st_size == 2_000_000
    assert (source / "papers" / "ssukf.md").read_text(encoding="utf-8").count("<img ") > 6
    out.mkdir()
    papers.copy_recordings(results, out)
    assert sorted(path.name for path in out.rglob("*.*")) == [
        "csrukf_P_I.rrd.js",
        "viewer.html",
        "viewer.js",
    ]


def test_the_picture_of_a_recording_opens_it_if_the_site_has_it(tmp_path):
    pictures = {"a.png": {"image/png": b64encode(b"png").decode()}}
    name = f"../out/viewer.html?{RECORDING}"
    cell = f"## The recording\n\n[![Blue](attachment:a.png)]({name})\n\nA click."
    alone = papers.recording_picture(cell, pictures, tmp_path, None)
    assert alone == '## The recording\n\n<img alt="Blue" src="../_static/a.png">\n\nA click.'
    assert (tmp_path / "a.png").read_bytes() == b"png"
    for file in ("viewer.js", f"{RECORDING}.rrd.js"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_text("")
    both = papers.recording_picture(cell, pictures, tmp_path, tmp_path)
    assert f'<a href="../viewer.html?{RECORDING}"><img ' in both


def test_figures_that_a_notebook_folds_are_found():
    own = {"data": {"image/png": "QQ==", "text/html": '<img src="data:image/png;base64,Qg==">'}}
    folded = {"data": {"text/html": 2 * '<p><img alt="" src="data:image/png;base64,Qg=="></p>'}}
    found = [papers.pictures_of(output) for output in (own, folded, {"text": "QQ=="})]
    assert found == [["QQ=="], ["Qg==", "Qg=="], []]


def test_a_second_title_of_a_notebook_is_a_section(tmp_path):
    """The list of pages would name each title as a page."""
    texts = ["# A filter\n\n## The idea", "# What holds\n\n## Errata", "## Try it"]
    cells = [{"cell_type": "markdown", "source": text} for text in texts]
    cells.append({"cell_type": "code", "source": "# a comment"})
    shown = json.loads(within(json.dumps({"cells": cells}), tmp_path, None))["cells"]
    assert [cell["source"] for cell in shown] == [
        texts[0],
        "## What holds\n\n## Errata",
        texts[2],
        "# a comment",
    ]


def test_an_operator_of_two_signs_is_one():
    text = conf.mathml(r"\operatorname{cov}(v) =: R, a := b, H^{\mathsf T}", "block")
    for part in ("<mo>=:</mo>", "<mo>:=</mo>", "<mi>cov</mi>", "&#x022A4;"):
        assert part in text
    assert "sans-serif" not in text


def luminance(color):
    """Relative luminance of "#rgb" or "#rrggbb"."""
    digits = color[1:] if len(color) == 7 else "".join(2 * c for c in color[1:])
    c = np.array([int(digits[i : i + 2], 16) for i in (0, 2, 4)]) / 255.0
    return np.where(c <= 0.03928, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [
        0.2126,
        0.7152,
        0.0722,
    ]


def contrast(a, b):
    light, dark = sorted((luminance(a), luminance(b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def test_text_has_contrast(site):
    """At least 4.5 for links, marked words and code, in light and dark mode."""
    assert contrast("#000", "#fff") == pytest.approx(21.0)
    links = re.findall(r"--color-brand-content: (#\w+)", (site / "index.html").read_text("utf-8"))
    assert contrast(links[0], "#ffffff") >= 4.5
    assert contrast(links[1], "#131416") >= 4.5
    mark = re.search(
        r"mark \{ background: (#\w+); color: (#\w+)", (DOCS / "_static/site.css").read_text()
    )
    assert contrast(mark[1], mark[2]) >= 4.5
    code = (site / "_static" / "pygments.css").read_text(encoding="utf-8")
    light, dark = re.split(r"@media not print|@media \(prefers-color-scheme: dark\)", code)[::2]
    for part in (light, dark):
        background = re.search(r"\.highlight \{ background: (#\w+)", part)[1]
        colors = re.findall(
            r"\.highlight \.(?!w )[a-z]\w* \{ color: (#\w+)(?![^}]*background)", part
        )
        assert len(colors) > 30
        assert min(contrast(color, background) for color in colors) >= 4.5


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_line_of_code_fits_the_page(path):
    """At most 100 characters in a program line, 112 in its output."""
    text = path.read_text(encoding="utf-8")
    for kind, block in re.findall(r"```(python|text|toml)\n(.*?)```", text, re.DOTALL):
        longest = max(len(line) for line in block.splitlines())
        assert longest <= (112 if kind == "text" else 100), block


# -- the time axis ---------------------------------------------------------------------------------
def test_the_time_axis_is_that_of_epochs():
    """It has the labels of four epochs, and its text is selectable text."""
    picture = ElementTree.parse(DOCS / "time_axis.svg").getroot()
    labels = [node.text for node in picture.iter("{http://www.w3.org/2000/svg}text")]
    times = [label for label in labels if label.startswith("times[")]
    epochs = celnav.epochs(np.arange(float(len(times))), z=np.zeros((4, 1)), u=np.arange(3.0))
    assert len(epochs) == len(times) == sum(label.startswith("mean[") for label in labels) == 4
    assert [label for label in labels if label.startswith("u[")] == ["u[0]", "u[1]", "u[2]"]
    assert epochs[0].dt == 0.0
    assert "dt = 0" in labels
    assert labels.count("predict") == 3
    assert [epoch.u for epoch in epochs[1:]] == [0.0, 1.0, 2.0]
    classes = {node.get("class") for node in picture.iter("{http://www.w3.org/2000/svg}text")}
    assert all("name" in value.split() for value in classes)  # the site gives them its own color


# -- the search ------------------------------------------------------------------------------------
FIRST = {
    "IMU": "howto/inertial.html",
    "colored noise": "howto/colored_noise.html",
    "coloured noise": "howto/colored_noise.html",
    "missing data": "howto/missing_data.html",
    "late": "howto/late_samples.html",
    "outlier": "howto/outliers.html",
    "NEES": "howto/consistency.html",
    "NIS": "howto/consistency.html",
    "smooth": "howto/smoothing.html",
    "IMM": "howto/imm.html",
    "tuning": "howto/tuning.html",
    "filterpy": "howto/filterpy.html",
    "RINEX": "howto/receiver.html",
    "install": "start.html",
    "time axis": "reference/conventions.html",
    "compare": "reference/studies.html",
}
SCRIPT = """
const {search, excerpt} = require(process.argv[1]);
const fs = require("fs");
const index = JSON.parse(fs.readFileSync(process.argv[2], "utf8"));
const queries = JSON.parse(process.argv[3]);
const answer = queries.map((query) => search(index, query).map((page) => ({
  ...page, excerpts: page.sections.map((entry) => excerpt(entry[3] || entry[4], query)),
})));
console.log(JSON.stringify(answer));
"""


@pytest.fixture(scope="module")
def search(site, tmp_path_factory):
    """Ask the script of the search page."""
    if NODE is None:
        pytest.skip("needs node")
    text = (site / "_static" / "search_index.js").read_text(encoding="utf-8")
    built = json.loads(text.removeprefix("var SEARCH_INDEX = ").rstrip(";\n"))
    folder = tmp_path_factory.mktemp("search")

    def ask(*queries, index=built):
        (folder / "index.json").write_text(json.dumps(index), encoding="utf-8")
        script = str(site / "_static" / "search.js")
        command = [NODE, "-e", SCRIPT, script, str(folder / "index.json"), json.dumps(queries)]
        return json.loads(
            subprocess.run(command, capture_output=True, text=True, check=True).stdout
        )

    return ask


def test_the_search_finds_the_page_of_a_task_first(search):
    found = dict(zip(FIRST, (pages[0]["address"] for pages in search(*FIRST)), strict=True))
    assert found == FIRST


def test_an_excerpt_shows_the_word_marked(search):
    for query, (first, *_) in zip(FIRST, search(*FIRST), strict=True):
        words = query.lower().replace("coloured", "colored").split()
        marked = {
            piece.lower()
            for pieces in first["excerpts"]
            for piece, is_marked in pieces
            if is_marked
        }
        heads = " ".join(section[2] for section in first["sections"]).lower()
        assert any(word in text for word in words for text in marked | {heads}), query
    (imu,) = search("IMU")
    assert any(["IMU", True] in pieces for pieces in imu[0]["excerpts"])


def entry(page, heading, text, title="A page"):
    return [title, page, heading, text, ""]


def test_a_whole_word_comes_before_a_part(search):
    index = [
        entry("a.html", "Simulation, simulated", "simulate simulates simulation"),
        entry("b.html", "Another", "an IMU in the text"),
        entry("c.html", "The IMUs", ""),
    ]
    (found,) = search("imu", index=index)
    assert [page["address"] for page in found] == ["c.html", "b.html"]
    ((only,),) = search("mulat", index=index)
    assert only["address"] == "a.html"  # parts are found where nothing else is
    assert search("nothing of the kind", "", index=index) == [[], []]


def test_each_public_name_can_be_found(search):
    names = sorted(set(celnav.__all__) - {"Filter"})
    for name, found in zip(names, search(*(f"celnav.{name}" for name in names)), strict=True):
        shown = {section[2] for page in found for section in page["sections"]}
        assert f"celnav.{name}" in shown, name
