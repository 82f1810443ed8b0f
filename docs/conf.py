"""How Sphinx makes the site."""

from __future__ import annotations

import re
from collections.abc import Iterator
from inspect import signature
from typing import Any

from docutils.nodes import SkipNode, Text, document, field_name
from latex2mathml.converter import convert
from sphinx.application import Sphinx

import celnav

project, author, copyright = "celnav", "the celnav authors", "the celnav authors"
version = release = celnav.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "docs.search"]
templates_path = ["_templates"]
exclude_patterns = ["README.md"]

nb_execution_mode = "off"  # they are shown as they were executed, with all runs
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
myst_url_schemes = ["http", "https", "mailto"]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # shapes and units are in the text; the signature has the types
autodoc_preserve_defaults = True
add_module_names = False
python_use_unqualified_type_names = True
default_role = "py:obj"  # a name in single ticks is a link where there is something to link to

html_theme = "furo"
html_title = "celnav"
pygments_dark_style = "github-dark"  # that of the theme underlines the names of modules
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072b2", "color-brand-content": "#0072b2"},
    "dark_css_variables": {"color-brand-primary": "#56b4e9", "color-brand-content": "#56b4e9"},
}
html_math_renderer = "mathml"  # the browser's own: no script, no net

CITED = re.compile(r"\[([A-Z][A-Za-z]+\d{4}\b[^\]]*)\]")
KEY = re.compile(r"\b([A-Z][A-Za-z]+\d{4})\b")
ARGUMENT = re.compile(r"^(\w+(?:, \w+)*): (?=\S)")
ANOTHER = re.compile(r"(?:^ +|(?<=[.)`]) )(?=(\w+(?:, \w+)*): \S)")
TRANSPOSE = r"\mathsf T", r"\top"  # MathML makes an italic letter of the first
SMALL = "\u2060"  # before a field's name, whose first letter Sphinx would make a capital


def parameters(thing: Any) -> set[str]:
    """Names of what a function takes, or of the fields of a class."""
    try:
        taken = set(signature(thing).parameters)
    except (TypeError, ValueError):
        taken = set()
    return taken | set(getattr(thing, "__annotations__", ()))


def each_begins(names: set[str], lines: list[str]) -> Iterator[str]:
    """The lines, parted where one goes on to the next of some ``names``: each begins a line of its
    own.
    """
    for line in lines:
        start = 0
        for found in ANOTHER.finditer(line):
            if names.issuperset(found[1].split(", ")):
                if found.start():
                    yield line[start : found.start()]
                start = found.end()
        yield line[start:]


def sentence_ends(made: list[str]) -> bool:
    """Whether the text so far ends a sentence, so that the next line may begin with an argument."""
    return not made or not made[-1].strip() or made[-1].rstrip().endswith((".", ":", ")", "`"))


def written(
    _app: Sphinx, what: str, _name: str, thing: Any, _options: Any, lines: list[str]
) -> None:
    """Docstrings, in which ``name: what it is`` speaks of an argument, as fields of
    reStructuredText.
    """
    made: list[str] = []
    for line in each_begins(parameters(thing), lines):
        if made and line and not line.strip("-"):  # a heading of a docstring, such as Raises
            made[-1], line = f"**{made[-1]}**", ""
        line = CITED.sub(lambda cited: "[" + KEY.sub(r":ref:`\1 <\1>`", cited[1]) + "]", line)
        argument = ARGUMENT.match(line) if sentence_ends(made) and what != "module" else None
        if line.startswith(">>> ") and made and made[-1].strip() and ">>> " not in made[-1]:
            made.append("")
        if argument:
            before = next((old for old in reversed(made) if old.strip()), "")
            if made and made[-1].strip() and not before.startswith((":", " ")):
                made.append("")
            line = f":{SMALL}{argument[1]}: {line[argument.end() :]}"
        elif line[:1].strip() and made and made[-1].startswith((":", " ")):
            if sentence_ends(made) and not line[0].islower():
                made.append("")  # a paragraph begins right after an argument
            else:
                line = f"    {line}"  # it goes on, although it is not indented
        made.append(line)
    lines[:] = made


def small(_app: Sphinx, doctree: document) -> None:
    """Names of arguments as they are written."""
    for name in doctree.findall(field_name):
        name[:] = [Text(name.astext().removeprefix(SMALL))]


def unsaid(
    _app: Sphinx, _what: str, _name: str, thing: Any, _skip: bool, _options: Any
) -> bool | None:
    """Leave out fields of named tuples, which the docstring of the whole speaks of."""
    return (
        True
        if (getattr(thing, "__doc__", None) or "").startswith("Alias for field number")
        else None
    )


def plain_signature(
    _app: Sphinx, _what: str, _name: str, _thing: Any, _options: Any, arguments: str, result: str
) -> tuple[str, str] | None:
    """A signature whose default is a space has its name."""
    if not arguments:
        return None
    return re.sub(r"space=\(<ufunc 'add'>.*?\(\)\)", "space=EUCLIDEAN", arguments), result


def mathml(formula: str, display: str) -> str:
    """A formula, in which the signs := and =: are one operator each, and names are no operators."""
    text = convert(formula.replace(*TRANSPOSE), display=display)
    text = text.replace("<mo>&#x0003D;</mo><mi>:</mi>", "<mo>=:</mo>")
    text = text.replace("<mi>:</mi><mo>&#x0003D;</mo>", "<mo>:=</mo>")
    return re.sub(r"<mo>([a-z]{2,})</mo>", r"<mi>\1</mi>", text)


def inline(translator: Any, node: Any) -> None:
    """A formula within a line."""
    translator.body.append(mathml(node.astext(), "inline"))
    raise SkipNode


def display(translator: Any, node: Any) -> None:
    """A formula of its own."""
    translator.body.append(mathml(node.astext(), "block"))
    raise SkipNode


def setup(app: Sphinx) -> None:
    """What Sphinx asks for."""
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    app.connect("autodoc-process-docstring", written)
    app.connect("autodoc-process-signature", plain_signature)
    app.connect("doctree-read", small)
    app.connect("autodoc-skip-member", unsaid)
