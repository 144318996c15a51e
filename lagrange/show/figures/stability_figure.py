"""The picture of stability regions: where a step does not amplify, in the plane of rate times step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.errors import StatementError
from lagrange.evidence.stability import GROWTH_TOLERANCE, growth, step_of
from lagrange.show.figures.colours import colours
from lagrange.show.figures.shown_figure import new_figure
from lagrange.show.figures.style import dress, mixed, on_paper, style_of
from lagrange.statement.number import real_number
from lagrange.trajectory.methods.registry import find

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 401


def plot_stability(
    *methods: Any, left: float = -8.0, right: float = 4.0, top: float = 7.0, style: str = "light"
) -> Figure:
    """Return a figure of the borders of stability of methods, named or given, for rates between left and right.

    A step is stable on the left of, or inside, its line; shaded is where every method is. Raises StatementError for a
    splitting, which knows no damping and is stable on a part of the imaginary axis alone (see
    `lg.methods.stability`), and for a method without a step of its own.
    """
    look = style_of(style)
    left, right, top = real_number(left, "left"), real_number(right, "right"), real_number(top, "top")
    if not (left < right and top > 0):
        raise StatementError(f"left = {left:g}, right = {right:g} and top = {top:g}: give left < right and top > 0.")
    if not methods:
        raise StatementError("name at least one method, such as lg.methods.plot_stability('rk4', 'radau5').")
    x, y = np.linspace(left, right, _POINTS), np.linspace(-top, top, _POINTS | 1)
    grid = x + 1j * y[:, None]
    # On the real axis a rate has no conjugate: the row next to it stands for it.
    plane = np.where(grid.imag == 0, grid + 1e-6j, grid)
    figure = new_figure(figsize=(7.2, 6.4), layout="constrained")
    axis = figure.add_subplot()
    dress(axis, look, "A step does not amplify on the left of, or inside, its line")
    lines, names = [], []
    everywhere = np.ones(grid.shape, dtype=bool)
    for method, colour in zip(methods, colours(len(methods), look.colours), strict=True):
        sizes = growth(step_of(method), plane)
        axis.contour(x, y, sizes, levels=[1.0 + GROWTH_TOLERANCE], colors=[colour], linewidths=1.6)
        everywhere &= sizes <= 1.0 + GROWTH_TOLERANCE
        lines.append(axis.plot([], [], color=colour, linewidth=1.6)[0])
        names.append(find(method).name)
    axis.contourf(x, y, everywhere, levels=[0.5, 1.5], colors=[mixed(look.colours[0], look.paper, 0.12)])
    axis.axhline(0.0, color=look.quiet, linewidth=0.7)
    axis.axvline(0.0, color=look.quiet, linewidth=0.7)
    axis.set(xlabel="real part of rate times step", ylabel="imaginary part", aspect="equal")
    axis.legend(lines, names, loc="upper left", frameon=False, labelcolor=look.ink)
    return on_paper(figure, look)
