"""Parts of notebooks: tables of parameters, and what is folded."""

from __future__ import annotations

from dataclasses import fields
from io import BytesIO

import numpy as np
from PIL import Image

from celnav.papers import csrukf
from celnav.show import colors
from celnav.show.claims import Ledger
from celnav.show.draw import figure
from celnav.show.drawing import render
from celnav.show.notebook import Folded, Table, parameters


def test_the_table_of_parameters_has_a_row_for_each_and_is_aligned_to_the_left():
    config = csrukf.PRESETS["P"]
    table = parameters(config)
    lines = table._repr_markdown_().splitlines()
    assert lines[0] == "| parameter | value | source | meaning |"
    assert [line.split(" | ")[0][2:] for line in lines[2:]] == [f.name for f in fields(config)]
    html = table._repr_html_()
    assert "text-align:left" in html
    assert html.count("<tr>") == len(lines) - 1
    assert fields(config)[0].metadata["meaning"] in str(table)


def test_folded_parts_are_closed_and_keep_every_form():
    folded = Folded("A & B", Table(["a"], [["<b>"]]), Ledger([]))
    html = folded._repr_html_()
    assert "<details><summary><b>A &amp; B</b></summary>" in html
    assert "&lt;b&gt;" in html
    assert folded._repr_markdown_().startswith("**A & B**\n\n| a |")
    assert str(folded).startswith("A & B\n\na\n<b>")


def test_a_notebook_shows_rare_curves_in_their_colors():
    """Few colors suffice for a figure, but a thin curve among many shades keeps its own."""
    drawing, ax = figure(6.5, 3.0)
    rng = np.random.default_rng(1)
    ax.pcolormesh(rng.random((60, 60)))
    for color in (colors.ESTIMATE, colors.PAPER, colors.REFERENCE, colors.OPEN_LOOP):
        ax.plot(np.arange(60), 30.0 + 9.0 * rng.standard_normal(60), color=color, linewidth=0.9)
    full = np.asarray(Image.open(BytesIO(render(drawing, "png", dpi=100))).convert("RGB"))
    few = Image.open(BytesIO(drawing._repr_png_())).convert("RGB")
    assert len(few.getcolors()) <= 128
    for color in (colors.ESTIMATE, colors.PAPER, colors.REFERENCE, colors.OPEN_LOOP):
        exact = (full == [int(color[i : i + 2], 16) for i in (1, 3, 5)]).all(-1)
        assert exact.sum() > 10
        apart = np.abs(np.asarray(few)[exact].astype(int) - full[exact]).max()
        assert apart <= 24, color
