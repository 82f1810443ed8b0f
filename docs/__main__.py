"""Build the site: ``python -m docs [OUT]``. It needs no net, and a warning is an error.

The pages of this folder and the notebooks, as they were executed, are gathered in a folder of their
own, so that Sphinx finds them side by side and leaves nothing behind here.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import tempfile
from pathlib import Path

from sphinx.cmd.build import main

import celnav
from docs.pages import errata, sources

HERE = Path(__file__).resolve().parent


def within(notebook: str) -> str:
    """A notebook with its links to anchors that its own outputs make as HTML, of which Sphinx knows
    nothing.
    """
    content = json.loads(notebook)
    for cell in content["cells"]:
        if cell["cell_type"] == "markdown":
            cell["source"] = re.sub(
                r"\[([^\]]*)\]\((#[^)]*)\)", r'<a href="\2">\1</a>', "".join(cell["source"])
            )
    return json.dumps(content)


def linked(page: str) -> str:
    """A page with every name such as `celnav.run` as a link to the reference, outside of programs."""
    parts = re.split(r"(```.*?```)", page, flags=re.DOTALL)
    return "".join(
        part if i % 2 else re.sub(r"`(celnav(?:\.\w+)+)`", r"{py:obj}`\1`", part)
        for i, part in enumerate(parts)
    )


def drawn(page: str) -> str:
    """A page whose picture of verdicts stands in it as SVG, so that its squares are links."""
    picture = (HERE / "verdicts.svg").read_text(encoding="utf-8")
    return re.sub(r"!\[[^\]]*\]\(verdicts\.svg\)", f"```{{raw}} html\n{picture}```", page)


def build(out: Path) -> int:
    """Write the site to a folder; the exit status of Sphinx."""
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "source"
        shutil.copytree(HERE, source, ignore=shutil.ignore_patterns("__pycache__"))
        for path in source.rglob("*.md"):
            page = drawn(path.read_text(encoding="utf-8"))
            path.write_text(linked(page), encoding="utf-8")
        for path in sorted((HERE.parent / "notebooks").glob("*.ipynb")):
            (source / "notebooks" / path.name).write_text(
                within(path.read_text(encoding="utf-8")), encoding="utf-8"
            )
        (source / "sources.md").write_text(sources(), encoding="utf-8")
        (source / "errata.md").write_text(errata(), encoding="utf-8")
        (source / "conventions.txt").write_text(celnav.__doc__ or "", encoding="utf-8")
        return main(
            [
                "-b",
                "html",
                "-W",
                "--keep-going",
                "-q",
                "-d",
                str(Path(temporary) / "doctrees"),
                str(source),
                str(out),
            ]
        )


if __name__ == "__main__":
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/site")
    status = build(out)
    print(
        f"{out / 'index.html'}" if status == 0 else "the site has faults, above",
        file=sys.stdout if status == 0 else sys.stderr,
    )
    sys.exit(status)
