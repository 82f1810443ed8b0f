"""``index.html`` of the papers and of campaigns, as rendered by a browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from itertools import pairwise
from types import SimpleNamespace
from urllib.parse import unquote

import numpy as np
import pytest

from celnav.campaign import campaign
from celnav.campaign.figures import figures
from celnav.campaign.missions import study
from celnav.campaign.page import write
from celnav.commands.index import _notebook, index, verdicts
from celnav.files import Outputs
from celnav.show.claims import OTHER, SIGNS, dumps, written
from celnav.show.draw import figure as empty
from celnav.show.drawing import render
from celnav.study.ledger import Number, Row

BROWSER = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)
PROBE = """<script>addEventListener("load", () => { const images = [...document.images];
document.title = [images.length, images.filter(i => i.complete && i.naturalWidth > 0).length,
document.documentElement.scrollWidth, getComputedStyle(document.documentElement).colorScheme].join("|") })</script>"""


def seen(page, tmp_path, width):
    """What a browser reports for a page: images, loaded images, width of the contents, color
    scheme, and console messages.
    """
    probed = tmp_path / "probed.html"  # beside its pictures
    probed.write_text(page.replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", f"--window-size={width},900",
               f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=20000", "--dump-dom", probed.as_uri()]  # fmt: skip
    found = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    title = re.search(r"<title>(\d+)\|(\d+)\|(\d+)\|([^<]*)</title>", found.stdout)
    assert title is not None
    return (
        int(title[1]),
        int(title[2]),
        int(title[3]),
        title[4],
        [line for line in found.stderr.splitlines() if "CONSOLE" in line],
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The page of csrukf and aukf, with invented claims, a real figure and a real table."""
    out = tmp_path_factory.mktemp("out")
    for paper in ("csrukf", "aukf"):
        outputs = Outputs(out / paper)
        rows = [
            Row("statement", "a", "It is <so> & long, " + "so " * 60 + "long", lambda _: Number("x", 1.0, (0.0, 1.5)), "§1",
                "because", "It is {0}.", "1 & 2", figure="figure_01"),
            Row("statement", "b", "It is so too", lambda _: Number("y", 2.0, (0.0, 1.5), (1.9, 2.1)), revised="2026-01-01: wider"),
            Row("statement", "c", "Nobody knows", lambda _: Number("z", 1.5, (0.0, 1.5), (1.0, 2.0))),
            Row("erratum", "d", "1 < 0"),
            Row("finding", "e", "It was never said", lambda _: [Number("u", 1.0), Number("v", 0.5, (None, 1.0))]),
            Row("check", "f", "It holds", lambda _: Number("w", 1.0, (0.5, 2.0))),
        ]  # fmt: skip
        claims = [row.judged(None) for row in rows]
        outputs.text("claims.json", dumps(claim for claim in claims if claim.kind != "check"))
        outputs.text("checks.json", dumps(claim for claim in claims if claim.kind == "check"))
        outputs.text(
            "timings.json",
            json.dumps(
                {"about": {"numpy": "2.2"}, "effort": 1.0, "seed": 7, "cpu_s": 12.3, "timings": {}}
            ),
        )
        for number in (1, 10):
            fig, ax = empty(4.0, 3.0)
            ax.plot(np.arange(5))
            outputs.bytes(f"figures/figure_{number:02d}.png", render(fig, "png"))
        outputs.text("tables/table_1.csv", "a,b\n1,<2>\n")
    return out


@pytest.fixture(scope="module")
def page(folder):
    return index(folder)


def test_it_opens_with_sentences_and_has_every_row_and_needs_nothing_else(page):
    head = page[: page.index("<main>")]
    assert "of 2 papers and judges 6 statements" in head
    assert "All runs, seed 7." in head
    assert head.count('class="sign"') == 6 + 3  # squares and their legend
    assert page.index('id="found"') < page.index("<section")
    assert page.index("The paper: ") < page.index("We find:</b>")
    assert page.count("<img ") == 6  # four in all, and two behind their rows
    assert page.count("3 statements: 1 reproduced, 1 not reproduced, 1 undecided") == 4
    assert page.count("2 not as expected.") == 2
    assert page.count("Checks: 1<") == 2
    for text in (
        "1 &lt; 0", "&lt;2&gt;", "The criterion: because", "Accepted range revised: 2026-01-01: wider", "2.00 [1.90, 2.10]",
        "The paper prints 1 &amp; 2.", "numpy 2.2; 12 s of CPU time", "2 numbers<", "1 number and a figure<",
    ):  # fmt: skip
        assert text in page, text
    for paper in ("csrukf", "aukf"):
        assert f'href="#{paper}"' in page
        assert f'id="{paper}"' in page
        assert page.count(f'href="{paper}/figures/figure_01.svg"') == 2
    assert not re.search(r'(src|href)="(https?:)?//', page)


def test_ids_are_of_one_place_and_squares_lead_to_their_rows(page):
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    targets = re.findall(r'href="#([^"]+)"', page)
    assert set(targets) <= set(ids)
    assert {f"{paper}-{row}" for paper in ("csrukf", "aukf") for row in "abc"} <= set(targets)


def test_headings_are_in_order_and_the_page_has_its_landmarks(page):
    levels = [int(level) for level in re.findall(r"<h([1-6])", page)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))
    for landmark in ("header", "nav", "main"):
        assert len(re.findall(rf"<{landmark}[ >]", page)) == 1


class Shown(HTMLParser):
    """What of a page is shown before anything is unfolded: texts, and tables and pictures."""

    def __init__(self, page):
        super().__init__()
        self.folded, self.summary, self.words, self.tags = 0, 0, [], []
        self.feed(page[page.index("<body") :])

    def handle_starttag(self, tag, attributes):
        self.folded += tag == "details"
        self.summary += tag in ("summary", "script")
        if not self.folded:
            self.tags.append(tag)
        assert tag != "details" or "open" not in dict(attributes)

    def handle_endtag(self, tag):
        self.folded -= tag == "details"
        self.summary -= tag in ("summary", "script")

    def handle_data(self, data):
        if not self.folded and not self.summary:
            self.words += data.split()


def test_a_page_is_short_since_all_but_its_heads_is_folded(page):
    """Eight screens with six papers: their answers and one figure each, and the first screen."""
    shown = Shown(page)
    assert shown.tags.count("table") == 1  # the counts
    assert shown.tags.count("img") == 0  # these papers have no figure that decides
    assert shown.tags.count("section") == 2
    sections = page.split("<section")[1:]
    for paper, text in zip(("csrukf", "aukf"), sections, strict=True):
        (answer,) = re.findall("<b>We find:</b>(.*)</p>", text)
        (said,) = re.findall("<p[^>]*>The paper:(.*)</p>", text)
        assert len(Shown(f"<body>{text}").words) < len((answer + said).split()) + 40, paper
    assert len(shown.words) < 40 * len(sections) + 600


def test_text_is_large_enough(page):
    """13 px at least on a screen, and 9 px on paper, where a px is larger."""
    css = page[page.index("<style>") : page.index("</style>")]
    screen, paper = css.split("@media print{")
    units = {"px": 1.0, "rem": 16.0}
    for text, least in ((screen, 13.0), (paper, 9.0)):
        sizes = re.findall(r"font(?:-size)?:(?:[^;}]*? )?([\d.]+)(px|rem)", text)
        assert len(sizes) >= 2
        assert min(float(size) * units[unit] for size, unit in sizes) >= least


def test_the_text_of_figures_on_cards_is_large_enough(page):
    """A figure is as wide as its card, so tall figures do not shrink. Text of 9 points in a figure
    of 6.5 inches then has 9 px at least where two cards stand side by side.
    """
    css = page[page.index("<style>") : page.index("</style>")]
    (rule,) = re.findall(r"\.card img\{([^}]*)\}", css)
    assert rule == "width:100%"
    body, padding = 16.0 * float(re.search(r"body\{[^}]*max-width:(\d+)rem", css)[1]), 16.0
    card = (body - 3.0 * padding) / 2.0 - 2.0 * padding
    assert 9.0 / 72.0 * card / 6.5 >= 9.0


@pytest.mark.parametrize(("side", "ground"), [(0, "#ffffff"), (1, "#121212")])
def test_verdicts_and_small_print_have_contrast(page, side, ground):
    """At least 4.5, in light and in dark mode [WCAG 2.2]."""
    pairs = dict(re.findall(r"--(\w+):light-dark\((#\w+,#\w+)\)", page))
    assert {"bad", "good", "part", "error", "open", "muted"} <= pairs.keys()
    for name, pair in pairs.items():
        light, dark = sorted(map(luminance, (pair.split(",")[side], ground)), reverse=True)
        assert (light + 0.05) / (dark + 0.05) >= 4.5, name


def test_signs_have_contrast():
    """White on each color, on the page and in the picture of the README."""
    for color, _ in (*SIGNS.values(), OTHER):
        assert 1.05 / (luminance(color) + 0.05) >= 4.5, color


def luminance(color):
    """Relative luminance of #rgb or #rrggbb."""
    digits = color[1:] if len(color) == 7 else "".join(2 * digit for digit in color[1:])
    channels = np.array([int(digits[i : i + 2], 16) for i in (0, 2, 4)]) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize(
    ("verdict", "style"),
    [
        ("reproduced", "good"),
        ("shown", "good"),
        ("not reproduced", "bad"),
        ("undecided", "open"),
        ("paper in error", "error"),
    ],
)
def test_only_what_holds_is_green(page, verdict, style):
    assert re.search(rf'<td role="cell" class="{style}">{verdict}', page)
    assert not re.search(rf'<td role="cell" class="(?!{style})[a-z]+">{verdict}', page)


def test_verdicts_of_statements_are_counted():
    row = written(
        Row("statement", "a", "It is so", lambda _: Number("x", 1.0, (0.0, 1.5))).judged(None)
    )
    assert verdicts({"one": [row, row | {"kind": "check"}], "two": []}).splitlines() == [
        "| paper | statements | reproduced |", "| --- | ---: | ---: |", "| `one` | 1 | 1 |", "| `two` | 0 |  |",
    ]  # fmt: skip


def test_nothing_reproduced_is_said(tmp_path):
    assert "Nothing reproduced yet." in index(tmp_path)


@pytest.mark.skipif(BROWSER is None, reason="no browser is installed")
@pytest.mark.parametrize("width", [390, 1200])
def test_a_browser_finds_every_image_no_error_and_nothing_beside_the_screen(page, folder, width):
    images, loaded, needed, scheme, said = seen(page, folder, width)
    assert images == loaded == 6
    assert needed <= max(width, 500)  # the least that a headless window has
    assert "dark" in scheme
    assert said == []


@pytest.mark.skipif(BROWSER is None, reason="no browser is installed")
def test_a_browser_finds_every_image_of_a_campaign(tmp_path):
    outcome = campaign(
        study({"paper": "csrukf", "filters": ["srukf"], "runs": 3, "config": {"steps": 4}}),
        tmp_path / "store",
    )
    drawn = {
        name: figure for name, figure in figures(outcome).items() if name.startswith("accuracy")
    }
    write(outcome, drawn, Outputs(tmp_path / "store"))
    content = (tmp_path / "store" / "index.html").read_text(encoding="utf-8")
    images, loaded, needed, _, said = seen(content, tmp_path, 390)
    assert images == loaded == 2
    assert needed <= 500
    assert said == []


def test_notebooks_are_those_of_the_site_if_it_is_there(folder, page, tmp_path):
    """Else the files of the checkout."""
    assert re.search(r'href="[^"]*notebooks/01_csrukf.ipynb">01_csrukf.ipynb</a>', page)
    assert "The site" not in page
    out = tmp_path / "out"
    shutil.copytree(folder, out)
    for name in ("index.html", "notebooks/index.html", "notebooks/01_csrukf.html"):
        (out / "site" / name).parent.mkdir(parents=True, exist_ok=True)
        (out / "site" / name).touch()
    links = re.findall(r'href="([^"#]*\.(?:html|ipynb))"', index(out))
    assert links[:2] == ["site/index.html", "site/notebooks/index.html"]
    assert "site/notebooks/01_csrukf.html" in links
    assert any(link.endswith("notebooks/05_aukf.ipynb") for link in links)  # not on the site


def test_the_link_to_a_study_of_any_folder_leads_there(tmp_path):
    study = tmp_path / "a#b 50%20" / "study.py"
    study.parent.mkdir()
    study.touch()
    link = _notebook(tmp_path / "out", "study", SimpleNamespace(file=str(study)))
    assert not set(link["href"]) & set("# ")
    assert unquote(link["href"]) == "../a#b 50%20/study.py"
