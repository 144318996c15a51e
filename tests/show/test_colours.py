"""The colours of lines that are drawn together differ."""

from __future__ import annotations

import pytest
from matplotlib.colors import to_rgb

from lagrange.show.figures import modes_figure
from lagrange.show.figures.style import COLOURS, colours
from lagrange.show.methods import names, plot_stability


@pytest.mark.parametrize("count", [0, 1, 8, 9, 39, 100])
def test_no_colour_comes_twice(count: int) -> None:
    found = colours(count)
    assert len(found) == len(set(found)) == count and all(len(to_rgb(colour)) == 3 for colour in found)
    assert count > 8 or found == COLOURS[:count]


def test_regions_of_stability_of_more_than_eight_methods_can_be_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modes_figure, "_POINTS", 41)
    explicit = ("euler", "heun", "midpoint", "rk4", "bs3", "dopri5", "tsit5", "verner9", "dop853", "radau5")
    assert set(explicit) <= set(names())
    legend = plot_stability(*explicit).axes[0].get_legend()
    assert legend is not None
    assert len({line.get_color() for line in legend.get_lines()}) == len(explicit)
