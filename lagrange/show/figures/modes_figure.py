"""Pictures of modes, of eigenvalues along a parameter, and of the stability of methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lagrange.dynamics.mode_shapes import ModeShapes
from lagrange.errors import StatementError, counted
from lagrange.evidence.method_stability import GROWTH_TOLERANCE, growth, step_of
from lagrange.mechanics.stability import EigenvaluePath
from lagrange.show.figures.new_figure import new_figure
from lagrange.show.figures.panel import panel_on, say_below
from lagrange.show.figures.space import spring, view_of
from lagrange.show.figures.style import FigureStyle, colours, dress, mixed, on_paper, style_of
from lagrange.show.notation.symbols import letters
from lagrange.statement.declare import ORIGIN
from lagrange.statement.expression import real_number
from lagrange.statement.statement import SPRING, corners
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_MODES = 8
"""Largest number of modes in a figure: more would make it taller than a page."""

LARGEST_DISPLACEMENT = 0.22
"""Largest displacement in the figure, as a part of the extent of the positions at rest."""


def plot_modes(shapes: ModeShapes, ax: Any, style: Any) -> Figure:
    """Return the figure of modes: a row for each, with its components as bars and, if positions are stated, its shape.

    On axes `ax` of the user the components of all modes are bars side by side.
    """
    look = style_of(style)
    if not len(shapes.components):
        raise StatementError(f"{shapes.statement.name} has no mode to draw.")
    if ax is not None:
        figure, axis = panel_on(ax, look, (6.0, 4.0))
        _all_bars(axis, shapes, look)
        return figure
    count = min(MOST_MODES, len(shapes.components))
    columns = 2 if shapes.points else 1
    figure = on_paper(
        new_figure(figsize=(8.6 if columns == 2 else 6.0, 0.8 + 1.75 * count), layout="constrained"), look
    )
    grid = figure.subplots(count, columns, squeeze=False, width_ratios=(1.0, 1.6)[:columns])
    projected = _seen(shapes)
    for k in range(count):
        _bars(grid[k, 0], shapes, k, look)
        if columns == 2:
            _shape(grid[k, 1], shapes, projected, k, look)
    left = len(shapes.components) - count
    say_below(figure, None, look, f"{counted(left, 'more mode')} not drawn." if left else "")
    return figure


def _title(shapes: ModeShapes, k: int) -> str:
    value, decay = complex(shapes.frequencies[k]), float(shapes.decay[k])
    if value == 0:
        return f"mode {k + 1}: moves freely" if not decay else f"mode {k + 1}: decays, rate {decay:.4g}"
    if abs(value.imag) > abs(value.real):
        word = "grows" if abs(value.imag) > decay else "decays"
        return f"mode {k + 1}: {word}, rate {abs(abs(value.imag) - decay):.4g}"
    rate = f", decay {decay:.3g}" if decay else ""
    return rf"mode {k + 1}: $\omega$ = {value.real:.5g}{rate}"


def _bars(axis: Axes, shapes: ModeShapes, k: int, look: FigureStyle) -> None:
    values = shapes.components[k]
    positions = np.arange(len(values))
    axis.bar(positions, values, width=0.6, color=[look.colours[0] if v >= 0 else look.colours[1] for v in values])
    axis.axhline(0.0, color=look.quiet, linewidth=0.8)
    dress(axis, look, _title(shapes, k))
    axis.grid(visible=False, axis="x")
    axis.set(ylim=(-1.15, 1.15), yticks=[-1, 0, 1])
    _name_coordinates(axis, shapes, positions)


def _name_coordinates(axis: Axes, shapes: ModeShapes, ticks: NDArray[Any]) -> None:
    symbols = letters(shapes.names)
    step = 1 + (len(ticks) - 1) // 12
    axis.set_xticks(ticks[::step], [f"${symbols[name]}$" for name in shapes.names][::step])


def _all_bars(axis: Axes, shapes: ModeShapes, look: FigureStyle) -> None:
    count, n = shapes.components.shape
    positions, width = np.arange(n), 0.8 / count
    for k, colour in enumerate(colours(count, look.colours)):
        shift = (k - (count - 1) / 2) * width
        axis.bar(positions + shift, shapes.components[k], width=0.9 * width, color=colour, label=_title(shapes, k))
    axis.axhline(0.0, color=look.quiet, linewidth=0.8)
    dress(axis, look, f"{shapes.statement.name}: shapes of modes")
    axis.grid(visible=False, axis="x")
    _name_coordinates(axis, shapes, positions)
    axis.legend(fontsize=8, frameon=False, labelcolor=look.ink)


def _seen(shapes: ModeShapes) -> tuple[dict[str, FloatArray], dict[str, FloatArray], float]:
    """Return the points at rest by name, (2,) each, their displacements (m, 2) in m modes, and the points' extent.

    Points and displacements are projected to the plane.
    """
    if not shapes.points:
        return {}, {}, 0.0
    swept = {
        name: np.column_stack([point, point[:, None] + shapes.displacements[name].T])
        for name, point in shapes.points.items()
    }
    view = view_of(swept)
    points = {name: view.of(point[:, None])[:, 0] for name, point in shapes.points.items()}
    changes = {name: view.of(rows.T).T for name, rows in shapes.displacements.items()}
    return points, changes, float(np.ptp(np.array(list(points.values())), axis=0).max()) or 1.0


def _shape(
    axis: Axes,
    shapes: ModeShapes,
    seen: tuple[Mapping[str, FloatArray], Mapping[str, FloatArray], float],
    k: int,
    look: FigureStyle,
) -> None:
    """Draw mode number `k`: the positions at rest in a pale colour, and the displaced positions with arrows.

    `seen` has the points at rest by name, (2,) each, their displacements in all modes, (m, 2) each, and the extent of
    the points.
    """
    points, moved, extent = seen
    largest = max(float(np.linalg.norm(rows[k])) for rows in moved.values())
    scale = LARGEST_DISPLACEMENT * extent / largest if largest > 1e-12 else 0.0
    at = {name: point + scale * moved[name][k] for name, point in points.items()}
    for positions, colour, width in ((points, look.grid, 1.4), (at, look.quiet, 1.6)):
        for start, end, kind in shapes.statement.links:
            ends = positions[start], positions[end]
            line = spring(*ends, 0.05 * extent) if kind == SPRING else np.array(ends).T
            axis.plot(*line, color=colour, linewidth=width, zorder=1 if colour == look.grid else 2)
    for name, point in points.items():
        if name in corners(shapes.statement.links):
            continue
        if name == ORIGIN:
            axis.plot(*point, "s", color=look.ink, markersize=4, zorder=3)
            continue
        axis.plot(*point, "o", markerfacecolor=look.paper, markeredgecolor=look.quiet, markersize=9, zorder=3)
        axis.plot(*at[name], "o", color=look.colours[0], markersize=9, zorder=4)
        if np.linalg.norm(at[name] - point) > 0.02 * extent:
            arrow = {"arrowstyle": "-|>", "color": look.colours[1], "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
            axis.annotate("", (at[name][0], at[name][1]), (point[0], point[1]), arrowprops=arrow, zorder=5)
    dress(axis, look)
    axis.grid(visible=False)
    axis.set(xticks=[], yticks=[], aspect="equal")
    axis.spines[["left", "bottom"]].set_visible(False)
    whole = np.array(list(points.values()))
    middle = (whole.max(axis=0) + whole.min(axis=0)) / 2
    half = np.maximum((whole.max(axis=0) - whole.min(axis=0)) / 2, 0.12 * extent) + 1.15 * LARGEST_DISPLACEMENT * extent
    still = np.array([np.abs(rows).max(axis=0) for rows in moved.values()]).max(axis=0) <= 1e-12
    half = np.where(still, half - 0.85 * LARGEST_DISPLACEMENT * extent, half)
    axis.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))


def plot_eigenvalues(path: EigenvaluePath, style: Any = "light") -> Figure:
    """Return a figure of the real and imaginary parts of eigenvalues along a parameter.

    A real part above zero means that the equilibrium is unstable.
    """
    look = style_of(style)
    figure = new_figure(figsize=(7.2, 6.0), layout="constrained")
    growth, frequency = figure.subplots(2, 1, sharex=True)
    dress(growth, look, "The equilibrium is unstable where a real part is positive")
    dress(frequency, look)
    for column, colour in zip(path.eigenvalues.T, colours(path.eigenvalues.shape[1], look.colours), strict=True):
        growth.plot(path.values, column.real, color=colour, linewidth=1.6)
        frequency.plot(path.values, column.imag, color=colour, linewidth=1.6)
    growth.axhline(0.0, color=look.quiet, linewidth=0.7)
    growth.set(ylabel="real part")
    frequency.set(xlabel=str(path.parameter), ylabel="imaginary part")
    return on_paper(figure, look)


_POINTS = 401


def plot_stability(
    *methods: Any, left: float = -8.0, right: float = 4.0, top: float = 7.0, style: str = "light"
) -> Figure:
    """Return a figure of the stability boundaries of methods, by name or instance, for rates between left and right.

    A step is stable to the left of its boundary, or inside it. The region where every method is stable is shaded.
    Raises StatementError for a method without steps of its own, and for a splitting. A splitting has no damping and is
    stable only on a part of the imaginary axis, which `lg.methods.stability` returns.
    """
    look = style_of(style)
    left, right, top = real_number(left, "left"), real_number(right, "right"), real_number(top, "top")
    if not (left < right and top > 0):
        raise StatementError(f"left = {left:g}, right = {right:g} and top = {top:g}: give left < right and top > 0.")
    if not methods:
        raise StatementError("name at least one method, such as lg.methods.plot_stability('rk4', 'radau5').")
    x, y = np.linspace(left, right, _POINTS), np.linspace(-top, top, _POINTS | 1)
    grid = x + 1j * y[:, None]
    # On the real axis a rate has no conjugate: the next row is used instead.
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
