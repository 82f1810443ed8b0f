"""Build the site: ``python -m docs [OUT] [--results DIR] [--live DIR]``. It needs no net, and a
warning is an error. ``--results`` is a folder of ``celnav reproduce``: the site then has all its
figures, and its recordings. ``--live`` is a folder with Pyodide: programs then run in the browser.

The pages of this folder and the notebooks, as they were executed, are gathered in a folder of their
own, so that Sphinx finds them side by side and leaves nothing behind here.
"""

from __future__ import annotations

import argparse
import io
import json
import re
import shutil
import sys
import tempfile
from contextlib import chdir, redirect_stdout
from pathlib import Path

from sphinx.cmd.build import main

import celnav
from celnav.papers import PAPERS
from docs.live import LiveError, add_live
from docs.pages import errata, judged, sources
from docs.papers import copy_recordings, recording_picture, write_pages
from docs.squares import square_list

HERE = Path(__file__).resolve().parent


def within(notebook: str, static: Path, results: Path | None) -> str:
    """A notebook with its links to anchors that its own outputs make as HTML, of which Sphinx knows
    nothing. Anchors of headings, which Jupyter spells with capitals, are in lower case here. The
    picture of a recording is written to ``static``. A page has one title: what follows under a
    second title is a section, or the list of pages would name it as a page.
    """
    content = json.loads(notebook)
    cells = [cell for cell in content["cells"] if cell["cell_type"] == "markdown"]
    text = "\n".join("".join(cell["source"]) for cell in cells)
    headings = {
        re.sub(r"[^\w-]", "", head.lower().replace(" ", "-"))
        for head in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    }

    def link(found: re.Match[str]) -> str:
        anchor = found[2].lower() if found[2].lower() in headings else found[2]
        return f'<a href="#{anchor}">{found[1]}</a>'

    for i, cell in enumerate(cells):
        source = "".join(cell["source"])
        if i:
            source = re.sub(r"^# ", "## ", source)
        if pictures := cell.pop("attachments", None):
            source = recording_picture(source, pictures, static, results)
        cell["source"] = re.sub(r"\[([^\]]*)\]\(#([^)]*)\)", link, source)
    return json.dumps(content)


def linked(page: str) -> str:
    """A page with every name such as `celnav.run` as a link to the reference, outside of programs."""
    parts = re.split(r"(```.*?```)", page, flags=re.DOTALL)
    return "".join(
        part if i % 2 else re.sub(r"`(celnav(?:\.\w+)+)`", r"{py:obj}`\1`", part)
        for i, part in enumerate(parts)
    )


def drawn(page: str) -> str:
    """A page whose pictures of `docs` stand in it as SVG or HTML: their text is text, their squares
    are links, and both have the colors of the page.
    """

    def inline(image: re.Match[str]) -> str:
        if image[1] == "verdicts.svg":
            claims = {paper: judged(paper) for paper in PAPERS}
            picture = square_list(claims, lambda paper, id: f"papers/{paper}.html#{paper}-{id}")
        else:
            picture = (HERE / image[1]).read_text(encoding="utf-8")
        return f'```{{raw}} html\n<div class="picture">\n{picture}</div>\n```'

    return re.sub(r"!\[[^\]]*\]\((?:\.\./)?(verdicts\.svg|time_axis\.svg)\)", inline, page)


def conventions(text: str) -> str:
    """The second chapter of ``help(celnav)`` as a table: a word, and what holds for it."""
    chapter = re.split(r"^-{4,}\n", text, flags=re.MULTILINE)[-1]
    rows = re.findall(r"^(\w+) {2,}(.*(?:\n {8,}.*)*)", chapter, re.MULTILINE)
    lines = ["| | |", "|---|---|"]
    for word, said in rows:
        said = re.sub(r"\s+", " ", said).replace("|", "\\|")
        said = re.sub(r"(?<!`)`(\w+)`(?!`)", r"{py:obj}`\1 <celnav.\1>`", said).replace("``", "`")
        lines.append(f"| {word} | {said} |")
    return "\n".join(lines) + "\n"


def run_programs(path: Path) -> None:
    """Run the programs of a page whose figures they write, in the folder of the page."""
    page = path.read_text(encoding="utf-8")
    if ".savefig(" in page:
        programs = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
        with chdir(path.parent), redirect_stdout(io.StringIO()):
            exec(compile("\n".join(programs), str(path), "exec"), {})


def build(out: Path, results: Path | None = None, live: Path | None = None) -> int:
    """Write the site to a folder; the exit status of Sphinx. results: of ``celnav reproduce``.
    live: with Pyodide and celnav's wheel; LiveError if a file is missing.
    """
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "source"
        shutil.copytree(HERE, source, ignore=shutil.ignore_patterns("__pycache__"))
        if live is not None:
            for sentence in add_live(live, source / "_static"):
                print(f"--live: {sentence}", file=sys.stderr)
        for path in source.rglob("*.md"):
            page = drawn(path.read_text(encoding="utf-8"))
            path.write_text(linked(page), encoding="utf-8")
        write_pages(source, results)
        for path in sorted((HERE.parent / "notebooks").glob("*.ipynb")):
            (source / "notebooks" / path.name).write_text(
                within(path.read_text(encoding="utf-8"), source / "_static", results),
                encoding="utf-8",
            )
        (source / "sources.md").write_text(sources(), encoding="utf-8")
        (source / "errata.md").write_text(errata(), encoding="utf-8")
        (source / "conventions.txt").write_text(conventions(celnav.__doc__ or ""), encoding="utf-8")
        run_programs(source / "index.md")
        status = main(
            [
                "-b",
                "html",
                "-W",
                "--keep-going",
                "-q",
                "-d",
                str(Path(temporary) / "doctrees"),
                *(["-D", "html_js_files=live/run.js"] if live is not None else []),
                str(source),
                str(out),
            ]
        )
    if results is not None and status == 0:
        copy_recordings(results, out)
    return status


if __name__ == "__main__":
    parser = argparse.ArgumentParser("python -m docs", description="Build the site.")
    parser.add_argument("out", nargs="?", type=Path, default="out/site", help="its folder")
    parser.add_argument("--results", type=Path, metavar="DIR", help="a folder of celnav reproduce")
    parser.add_argument("--live", type=Path, metavar="DIR", help="a folder with Pyodide")
    options = parser.parse_args()
    out, results = options.out, options.results
    if results is not None and not any((results / paper).is_dir() for paper in PAPERS):
        parser.error(f"--results: expected a folder of celnav reproduce, got {results}")
    try:
        status = build(out, results, options.live)
    except LiveError as error:
        parser.error(str(error))
    print(
        f"{out / 'index.html'}" if status == 0 else "the site has faults, above",
        file=sys.stdout if status == 0 else sys.stderr,
    )
    sys.exit(status)
