"""Figures: the same data give the same bytes."""

from __future__ import annotations

import numpy as np
import pytest
from readable import faults

from celnav.show.draw import Panel, band, figure, panels
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


@pytest.mark.parametrize("width", [3.0, 7.0])
def test_a_legend_has_as_many_columns_as_there_is_room_for(width):
    labels = [f"filter number {i}" for i in range(8)]
    items = [lambda ax, label=label: ax.plot(np.arange(3.0), label=label) for label in labels]
    fig = panels(Panel("a", items, "time (s)", "error (m)"), size=(width, 4.0))
    assert [text.get_text() for text in fig.legends[0].get_texts()] == labels
    assert not faults(fig)
    left = {text.get_window_extent().x0 for text in fig.legends[0].get_texts()}
    assert (len(left) > 2) == (width > 5.0)
