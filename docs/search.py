"""The index of the search page: one entry for each section of the site and each public name.

``_static/search.js`` ranks the entries. The index is a script, so that the search works from a
folder as well as from a server.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

SKIPPED = (nodes.section, addnodes.desc, nodes.raw, nodes.math_block, nodes.title, nodes.comment)
OUTPUTS = {"cell_output", "output"}
"""Classes of what the cells of notebooks have printed or drawn."""


def texts(node: Any) -> tuple[list[str], list[str]]:
    """Prose and code of a node without its sections, entries of the reference and outputs."""
    prose: list[str] = []
    code: list[str] = []
    for child in node.children:
        if isinstance(child, SKIPPED) or OUTPUTS.intersection(
            getattr(child, "get", dict)("classes", ())
        ):
            continue
        if isinstance(child, nodes.literal_block | nodes.doctest_block):
            code.append(child.astext())
        elif isinstance(child, nodes.TextElement | nodes.Text):
            hidden = nodes.raw, nodes.comment
            shown = (
                text for text in child.findall(nodes.Text) if not isinstance(text.parent, hidden)
            )
            prose.append("".join(shown) if isinstance(child, nodes.Element) else child.astext())
        else:
            inner = texts(child)
            prose += inner[0]
            code += inner[1]
    return prose, code


def entries(app: Sphinx) -> Iterator[list[str]]:
    """Title of the page, address, heading, prose and code of each section and public name."""
    for page in sorted(app.env.found_docs):
        title = app.env.titles[page].astext()
        address = app.builder.get_target_uri(page)
        for node in app.env.get_doctree(page).findall():
            if isinstance(node, nodes.section):
                heading = node.next_node(nodes.title)
                name, body = heading.astext() if heading else title, node
            elif isinstance(node, addnodes.desc):
                signature = node.next_node(addnodes.desc_signature)
                body = node.next_node(addnodes.desc_content)
                name = ".".join((signature.get("module") or "", signature.get("fullname") or ""))
                node = signature
            else:
                continue
            prose, code = texts(body)
            anchor = f"#{node['ids'][0]}" if node["ids"] and name != title else ""
            yield [
                title,
                address + anchor,
                name.strip("."),
                " ".join(" ".join(prose).split()),
                " ".join(" ".join(code).split()),
            ]


def write(app: Sphinx, exception: Exception | None) -> None:
    """Write the index beside the script that reads it."""
    if exception is None and app.builder.name == "html":
        index = json.dumps(list(entries(app)), ensure_ascii=False, separators=(",", ":"))
        path = app.outdir / "_static" / "search_index.js"
        path.write_text(f"var SEARCH_INDEX = {index};\n", encoding="utf-8")


def page(_app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """The search page, in the place of Sphinx's own."""
    yield "search", {}, "search.html"


def without_sphinx_index(app: Sphinx) -> None:
    """Sphinx's own index and page are not written."""
    app.builder.search = False


def setup(app: Sphinx) -> None:
    """Connect the index to the build."""
    app.connect("builder-inited", without_sphinx_index)
    app.connect("html-collect-pages", page)
    app.connect("build-finished", write)
