"""Pages that open from disk, from the templates in ``pages`` with embedded styles. jinja2 is
imported when a page is made.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from celnav.lazy import requires_extra
from celnav.show import claims


@cache
def _templates() -> Any:
    """The templates. Their values are escaped, and a missing value is an error."""
    with requires_extra("a page", "papers"):
        from jinja2 import Environment, FileSystemLoader, StrictUndefined

    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "pages"),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    names = "accepted cells columns counted mark meaning notes ours outcome printed style"
    templates.filters |= {name: getattr(claims, name) for name in names.split()}
    return templates


def render(template: str, **values: Any) -> str:
    """A whole page from a template, such as "index.html"."""
    return str(_templates().get_template(template).render(**values))


def macro(name: str, *arguments: Any, **options: Any) -> str:
    """A part of a page: a macro of ``parts.html``."""
    module = _templates().get_template("parts.html").module
    return str(getattr(module, name)(*arguments, **options))


def aligned_left(html: str) -> str:
    """A part of a notebook whose tables are aligned to the left. JupyterLab aligns them to the
    right, which suits numbers but not sentences.
    """
    style = ".celnav td,.celnav th{text-align:left!important;vertical-align:top}"
    return f'<style>{style}</style><div class="celnav">{html}</div>'
