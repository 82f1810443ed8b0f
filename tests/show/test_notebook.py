"""Parts of notebooks: tables of parameters, and what is folded."""

from __future__ import annotations

from dataclasses import fields

from celnav.papers import csrukf
from celnav.show.claims import Ledger
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
