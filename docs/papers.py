"""The pages of the six papers: what we find, the verdicts, the figures and the recordings.

The text is that of the page of verdicts. The figures are those that the executed notebook holds, or
all those of a folder of ``celnav reproduce``, which also has the recordings and their viewer.
"""

from __future__ import annotations

import re
import shutil
from base64 import b64decode
from html import escape
from pathlib import Path

import nbformat

from celnav.papers import PAPERS, load
from celnav.show import viewer
from docs.pages import notebook_of
from docs.squares import sign_html

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"
FOLDER = "_static/papers"


def stems(source: str) -> list[str]:
    """Stems of the figures that a cell of a notebook draws, in its order.

    >>> stems('FIGURES["figure_01"][1](results)'), stems("display(*figures(8, 5))")
    (['figure_01'], ['figure_08', 'figure_05'])
    """
    found = re.findall(r'"(figure_\d+\w*)"', source)
    if "figure(" in source:
        found += [f"figure_{stem}" for stem in re.findall(r'"(\d\d[a-z]?)"', source)]
    for numbers in re.findall(r"(?:figures?|for number in )\(([\d, ]+)\)", source):
        found += [f"figure_{int(number):02d}" for number in re.findall(r"\d+", numbers)]
    return found


def pictures_of(output: nbformat.NotebookNode) -> list[str]:
    """The pictures (PNG, base64) of an output of a cell: its own, or those in its HTML, where
    figures may be folded.
    """
    data = output.get("data", {})
    if "image/png" in data:
        return [data["image/png"]]
    return re.findall(r'src="data:image/png;base64,([^"]*)"', data.get("text/html", ""))


def notebook_figures(paper: str) -> dict[str, bytes]:
    """The figures (PNG) that the executed notebook of a paper holds, by stem."""
    figures = dict[str, bytes]()
    for cell in nbformat.read(NOTEBOOKS / notebook_of(paper), as_version=4).cells:
        pictures = [png for output in cell.get("outputs", ()) for png in pictures_of(output)]
        names = stems(cell.source)
        if len(names) == len(pictures):
            figures |= dict(zip(names, map(b64decode, pictures), strict=True))
    return dict(sorted(figures.items()))


def result_figures(paper: str, results: Path) -> dict[str, bytes]:
    """The figures (PNG) of a paper in a folder of ``celnav reproduce``, by stem."""
    paths = sorted((results / paper / "figures").glob("*.png"))
    return {path.stem: path.read_bytes() for path in paths}


def figure_html(paper: str, stem: str) -> str:
    """A figure with its caption, as HTML of a page of a paper; a click enlarges it."""
    caption = escape(load(paper).FIGURES.get(stem, (stem,))[0])
    file = f"../{FOLDER}/{paper}/{stem}.png"
    image = f'<img alt="{caption}" loading="lazy" src="{file}">'
    return f'<figure><a href="{file}">{image}</a><figcaption>{caption}</figcaption></figure>'


def recordings(paper: str, results: Path | None) -> dict[str, Path]:
    """Recordings that a browser opens: address from the top of the site, and file of the script."""
    if results is None or not (results / viewer.SCRIPT).is_file():
        return {}
    scripts = {
        viewer.address(f"{paper}/{name}"): results / paper / viewer.script_name(name)
        for name in load(paper).RECORDINGS
    }
    return {address: path for address, path in scripts.items() if path.is_file()}


def recording_picture(
    source: str, pictures: dict[str, dict[str, str]], static: Path, results: Path | None
) -> str:
    """The text of a notebook's cell whose attached picture opens a recording, with the picture in
    ``static`` and a link to the viewer of the site, if the results have it.
    """

    def image(found: re.Match[str]) -> str:
        alt, name, address = found.groups()
        (static / name).write_bytes(b64decode(pictures[name]["image/png"]))
        picture = f'<img alt="{escape(alt)}" src="../_static/{name}">'
        paper = address.partition("?")[2].partition("/")[0]
        known = paper in PAPERS and address in recordings(paper, results)
        return f'<a href="../{address}">{picture}</a>' if known else picture

    return re.sub(r"\[!\[([^\]]*)\]\(attachment:([^)]*)\)\]\(\.\./out/([^)]*)\)", image, source)


def pictures_html(paper: str, figures: dict[str, bytes], results: Path | None) -> str:
    """The figure that decides, links to the recordings, and the other figures behind a fold."""
    decides = load(paper).STUDY.figure
    links = [
        f'<a href="../{address}">▶\u00a0{path.name.partition(".")[0]}</a> '
        f"({path.stat().st_size / 1e6:.1f} MB)"
        for address, path in recordings(paper, results).items()
    ]
    others = [figure_html(paper, stem) for stem in figures if stem != decides]
    parts = [figure_html(paper, decides)] if decides in figures else []
    if links:
        parts.append(f"<p>Recordings, in the browser: {', '.join(links)}.</p>")
    if others:
        parts += [f"<details><summary>{len(others)} other figures</summary>", *others, "</details>"]
    lines = ["```{raw} html", '<div class="figures">', *parts, "</div>", "```", ""]
    return "\n".join(lines)


def with_signs(page: str) -> str:
    """A page of verdicts whose rows and explanations have the signs of the squares."""

    def signed(found: re.Match[str]) -> str:
        return f"{found[1]}{sign_html(found[2])} {found[2]}{found[3]}"

    page = re.sub(r"^(- \*\*)([^*]*)(\*\*:)", signed, page, flags=re.MULTILINE)
    return re.sub(r'^(\| <a id="[^"]*"></a>)([^|]*?)( \|)', signed, page, flags=re.MULTILINE)


def write_pages(source: Path, results: Path | None = None) -> None:
    """Part the page of verdicts in ``source`` into an overview and a page for each paper.

    results: a folder of ``celnav reproduce``, or None.
    """
    path = source / "verdicts.md"
    head, *parts = re.split(r"^## (\w+)\n", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    (source / "papers").mkdir()
    for paper, section in zip(parts[::2], parts[1::2], strict=True):
        figures = (results and result_figures(paper, results)) or notebook_figures(paper)
        folder = source / FOLDER / paper
        folder.mkdir(parents=True)
        for stem, png in figures.items():
            (folder / f"{stem}.png").write_bytes(png)
        # The title is the page's: "**Title** (`id`: authors (year)). ..." begins with the id.
        section = re.sub(r"\*\*[^*]*\*\* \((.*?)\)\. ", r"\1. ", section, count=1)
        section = with_signs(section).replace("\n*We find:*", "\n\n**We find:**")
        said, rows = section.split("\nNumbers and figures are in ")
        links, table = rows.split("\n", 1)
        links = links.replace("](", "](../").replace("the errata", "[the errata](../errata.md)")
        (source / "papers" / f"{paper}.md").write_text(
            f"# {load(paper).TITLE}\n\n{said}\n{pictures_html(paper, figures, results)}\n"
            f"Numbers are in {links}\n\n:::{{container}} verdicts\n{table}\n:::\n",
            encoding="utf-8",
        )
    top, table = re.split(r"^(?=\| verdict )", head, flags=re.MULTILINE)
    names, *rows = table.split("\n")
    names = re.sub(rf"\b({'|'.join(PAPERS)})\b", r"[\1](papers/\1.md)", names)
    table, meanings = "\n".join([names, *rows]).split("\n\n", 1)
    head = f"{top}:::{{container}} counts\n{table}\n:::\n\n{with_signs(meanings)}"
    listed = "\n".join(f"- [{load(paper).TITLE}](papers/{paper}.md)" for paper in PAPERS)
    tree = "\n".join(f"papers/{paper}" for paper in PAPERS)
    path.write_text(
        f"{head}\nThe statements of each paper, with figures:\n\n{listed}\n\n"
        f"```{{toctree}}\n:hidden:\n\n{tree}\n```\n",
        encoding="utf-8",
    )


def copy_recordings(results: Path, out: Path) -> None:
    """Copy the recordings of the papers, and their viewer, to the top of the site."""
    scripts = {paper: recordings(paper, results).values() for paper in PAPERS}
    for paper, paths in scripts.items():
        for path in paths:
            (out / paper).mkdir(exist_ok=True)
            shutil.copy(path, out / paper)
    if any(scripts.values()):
        for name in (viewer.PAGE, viewer.SCRIPT):
            shutil.copy(results / name, out)
