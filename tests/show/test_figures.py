"""Figures: the same data give the same bytes."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from readable import DISTANCE, color_distance, faults

from celnav.show import colors
from celnav.show.draw import Line, Panel, band, curve, figure, look, panels
from celnav.show.drawing import render


def drawing():
    fig, ax = figure(3.0, 2.0)
    ax.plot(np.arange(5.0), label="a")
    band(ax, np.arange(5.0), np.zeros(5), np.ones(5), color="#888888")
    ax.legend()
    return fig


@pytest.mark.parametrize(("kind", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_the_same_figure_is_the_same_bytes(kind, start):
    one, two = (render(drawing(), kind) for _ in range(2))
    assert one == two
    assert one.startswith(start)


@pytest.mark.parametrize("letters", [4, 40])
def test_a_legend_has_as_many_columns_as_there_is_room_for(letters):
    labels = [f"{i}" * letters for i in range(6)]
    items = [
        curve(np.arange(3.0), i * np.ones(3), label=x, **look(i)) for i, x in enumerate(labels)
    ]
    fig = panels(Panel("a", items, "time (s)", "error (m)"))
    assert [text.get_text() for text in fig.legends[0].get_texts()] == labels
    assert not faults(fig)
    left = {text.get_window_extent().x0 for text in fig.legends[0].get_texts()}
    assert (len(left) > 2) == (letters < 20)


def test_titles_of_several_panels_have_letters():
    two = [Panel(name, [curve(np.arange(3.0), np.arange(3.0))]) for name in ("left", "right")]
    fig = panels(two, title="Figure 3")
    assert [ax.get_title() for ax in fig.axes] == ["(a) left", "(b) right"]
    assert fig.get_suptitle() == "Figure 3"
    assert [ax.get_title() for ax in panels(two[0]).axes] == ["left"]


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([0.01, 1390.0], {"0.01", "1", "100"}),
        ([1200.0, 1500.0], {"1200", "1300", "1400", "1500"}),
        ([3.0, 60.0], {"5", "10", "20", "50"}),
        ([1e-9, 1e-1], {"$10^{-9}$", "$10^{-5}$", "$10^{-1}$"}),
    ],
)
def test_logarithmic_axes_have_plain_numbers_and_no_minor_ticks(values, ticks):
    fig = panels(Panel("", [curve(np.arange(2.0), values)], "time (s)", "error (m)", "y"))
    assert not faults(fig)
    axis = fig.axes[0].yaxis
    shown = {tick.label1.get_text() for tick in axis._update_ticks() if tick.label1.get_text()}
    assert ticks <= shown, shown
    assert not len(axis.get_minorticklocs())


def test_colors_differ_to_every_eye():
    """By 15 in CIELAB at least; black, gray and white aside, which are of texts and bodies."""
    roles = [
        "TRUTH",
        "ESTIMATE",
        "COMPARISON",
        "OPEN_LOOP",
        "REFERENCE",
        "MEASUREMENT",
        "PAPER",
        "BOUND",
        "SIGMA",
    ]
    for a, b in combinations(roles, 2):
        assert color_distance(getattr(colors, a), getattr(colors, b)) >= DISTANCE, (a, b)


def test_a_figure_is_at_fault_whose_curves_look_alike():
    def of(*lines):
        items = [curve(np.arange(2.0), i * np.ones(2), line) for i, line in enumerate(lines)]
        return faults(panels(Panel("", items, "time (s)", "error (m)")))

    first, close = Line("a", "#E69F00"), Line("b", "#DA9A00", "--")
    assert of(first, close) == ["colors 3 apart: 'a' and 'b'"]
    assert of(first, Line("b", colors.COMPARISON)) == ["one style: 'a' and 'b' in ''"]
    assert not of(first, Line("b", colors.COMPARISON, "--"))
