"""Parts of figures: empty panels for what a user draws, springs, colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb

import lagrange as lg
from lagrange.show.figures import dynamics_figures
from lagrange.show.figures.paths import SPRING_TURNS, spring
from lagrange.show.figures.style import COLOURS, DARK, LIGHT, colours
from lagrange.show.methods import names, plot_stability


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


# --- The shape of a spring, whatever its length ---


@pytest.mark.parametrize("length", [0.3, 1.0, 40.0])
def test_a_spring_goes_from_end_to_end_and_is_as_wide_as_asked(length: float) -> None:
    start, direction = np.array([0.5, -1.0]), np.array([0.6, 0.8])
    line = spring(start, start + length * direction, 0.1)
    assert np.allclose(line[:, 0], start) and np.allclose(line[:, -1], start + length * direction)
    aside = np.array([-0.8, 0.6]) @ (line - start[:, None])
    assert np.isclose(np.ptp(aside), 0.1)
    assert np.count_nonzero(np.diff(np.sign(aside[np.abs(aside) > 1e-9]))) == 2 * SPRING_TURNS - 2


def test_a_spring_of_no_length_is_a_point() -> None:
    point = np.array([1.0, 2.0])
    assert np.array_equal(spring(point, point, 0.1), np.repeat(point[:, None], 2 * SPRING_TURNS + 3, axis=1))


# --- The colours of lines that are drawn together differ ---


@pytest.mark.parametrize("count", [0, 1, 8, 9, 39, 100])
def test_no_colour_comes_twice(count: int) -> None:
    found = colours(count)
    assert len(found) == len(set(found)) == count and all(len(to_rgb(colour)) == 3 for colour in found)
    assert count > 8 or found == COLOURS[:count]


def test_regions_of_stability_of_more_than_eight_methods_can_be_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamics_figures, "_POINTS", 41)
    explicit = ("euler", "heun", "midpoint", "rk4", "bs3", "dopri5", "tsit5", "verner9", "dop853", "radau5")
    assert set(explicit) <= set(names())
    legend = plot_stability(*explicit).axes[0].get_legend()
    assert legend is not None
    assert len({line.get_color() for line in legend.get_lines()}) == len(explicit)
