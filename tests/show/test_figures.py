"""Figures: the same data give the same bytes."""

from __future__ import annotations

import numpy as np
import pytest

from celnav.show.drawing import render
from celnav.show.figures import band, figure


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
