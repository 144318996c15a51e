"""Empty panels for what a user draws."""

from __future__ import annotations

from typing import Any

import pytest

import lagrange as lg
from lagrange.show.figures.style import DARK, LIGHT


def test_panels_are_in_order_and_in_the_style_of_the_figure() -> None:
    figure = lg.figure(2, 3, style="dark")
    assert len(figure.axes) == 6
    places = [place.colspan.start for axis in figure.axes if (place := axis.get_subplotspec()) is not None]
    assert places == [0, 1, 2, 0, 1, 2]
    line = figure.axes[0].plot([0, 1], [1, 0])[0]
    assert line.get_color() == DARK.colours[0]
    assert figure.get_facecolor() == figure.axes[5].get_facecolor() != lg.figure().get_facecolor()
    assert lg.figure().axes[0].plot([0, 1])[0].get_color() == LIGHT.colours[0]


def test_the_size_is_in_inches() -> None:
    assert tuple(lg.figure(size=(5, 2.5)).get_size_inches()) == (5, 2.5)
    one, two = lg.figure(), lg.figure(columns=2)
    assert one.get_figwidth() < two.get_figwidth() < 2 * one.get_figwidth()


def test_a_notebook_shows_it() -> None:
    shown: Any = lg.figure()
    data, size = shown._repr_png_()
    assert data.startswith(b"\x89PNG")
    assert size["width"] > size["height"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"style": "drak"}, r"style = 'drak' is not known: give one of light and dark\. Did you mean 'dark'\?"),
        ({"rows": 0}, r"rows = 0: give a whole number from 1 to 8\."),
        ({"columns": 9}, r"columns = 9: give a whole number from 1 to 8\."),
        ({"size": (7, 0.5)}, r"size = \(7, 0\.5\): give \(width, height\) in inches, each from 1 to 40\."),
        ({"size": 7}, r"size = 7: give \(width, height\) in inches, each from 1 to 40\."),
        ({"size": (7, float("nan"))}, r"size = \(7, nan\): give \(width, height\) in inches"),
    ],
)
def test_what_cannot_be_drawn_on_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(lg.StatementError, match=message):
        lg.figure(**options)
