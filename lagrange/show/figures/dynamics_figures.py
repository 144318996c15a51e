"""Draw phase portraits, Poincare sections, bifurcations, modes, eigenvalues, and stability regions of methods."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.dynamics.axes import is_angle, row_of, wrapped
from lagrange.dynamics.equilibrium_branches import BranchesData
from lagrange.dynamics.orbits import Orbit
from lagrange.dynamics.portrait import PortraitData
from lagrange.dynamics.section import SectionData, surface
from lagrange.dynamics.sweep import SweepData
from lagrange.errors import StatementError, counted
from lagrange.evidence.method_stability import GROWTH_TOLERANCE, growth, step_of
from lagrange.mechanics.modes import ModeShapes
from lagrange.mechanics.stability import EigenvaluePath
from lagrange.show.figures import line_widths as widths
from lagrange.show.figures.curve import Pixels, first_times, in_plane, with_neighbours
from lagrange.show.figures.panel import (
    entry,
    label_of_entry,
    panel_on,
    say_below,
    turned_lines,
)
from lagrange.show.figures.paths import spring, view_of
from lagrange.show.figures.style import (
    FigureStyle,
    angle_ticks,
    colours,
    dress,
    mixed,
    new_figure,
    on_paper,
    style_of,
    with_unit,
)
from lagrange.show.notation.latex_mathml import LatexNotation
from lagrange.statement.declare import ORIGIN
from lagrange.statement.expression import real_number
from lagrange.statement.statement import SPRING, Statement, corners, unit_of
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.trajectory import FloatArray, Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PANEL_WIDTH, PANEL_HEIGHT = 1000.0, 800.0  # Size of the panel in pixels, at 160 dots per inch
ARROW = 0.62  # Length of an arrow of the field, as a fraction of the distance between arrows

_MARKERS = {
    "saddle": ("X", "quiet"),
    "centre": ("o", "paper"),
    "linear centre": ("o", "quiet"),
    "stable spiral": ("o", "ink"),
    "stable node": ("s", "ink"),
    "unstable spiral": ("o", "paper"),
    "unstable node": ("s", "paper"),
    "degenerate": ("D", "quiet"),
}
"""Matplotlib's marker of each kind of equilibrium, and the colour that fills it, as the name of a field of
`FigureStyle`."""


def plot_portrait(portrait: PortraitData, ax: Any = None, style: Any = "light") -> Figure:
    """Return the figure of a phase portrait, drawn on the axes `ax` if they are given. `style` is "light" or "dark"."""
    look = style_of(style)
    figure, axis = panel_on(ax, look, (8.2, 5.4))
    _field(axis, portrait, look)
    for (name, lines), colour in zip(portrait.nullclines.items(), (look.colours[2], look.colours[4]), strict=True):
        label = f"${entry(portrait.statement, name, rate=True)} = 0$"
        for nullcline in lines:
            axis.plot(*nullcline.T, color=colour, linewidth=widths.PLANE, linestyle=":", label=label, zorder=1.5)
            label = "_"
    for orbit in portrait.orbits:
        axis.plot(*_line(portrait, orbit), color=look.colours[0], linewidth=widths.THIN, zorder=2)
    for stable, colour in ((False, look.colours[1]), (True, look.colours[3])):
        label = "separatrix to the saddle" if stable else "separatrix from the saddle"
        for branch in portrait.separatrices:
            if branch.stable == stable:
                line = _line(portrait, branch.orbit)
                dashes = (4, 4) if stable else (1, 0)
                axis.plot(*line, color=colour, linewidth=widths.SEPARATRIX, dashes=dashes, label=label, zorder=3)
                label = "_"
    _equilibria(axis, portrait, look)
    _frame(axis, ax, portrait, look)
    say_below(figure, ax, look, portrait.message)
    return figure


def _field(axis: Axes, portrait: PortraitData, look: FigureStyle) -> None:
    """Draw the vector field of `portrait` as arrows of equal length, which show in which direction orbits go."""
    ranges = np.array([axis_range.width for axis_range in portrait.plane])
    u, v = portrait.u / ranges[0], portrait.v / ranges[1]
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.hypot(u, v)
        u, v = np.where(size > 0, u / size, 0.0), np.where(size > 0, v / size, 0.0)
    spacing = ranges / [len(portrait.x), len(portrait.y)]
    scale = ARROW * min(spacing / ranges)
    axis.quiver(
        portrait.x,
        portrait.y,
        u * scale * ranges[0],
        v * scale * ranges[1],
        angles="xy",
        scale_units="xy",
        scale=1.0,
        pivot="mid",
        color=look.quiet,
        alpha=0.55,
        width=0.0016,
        headwidth=4.5,
        headlength=5.0,
        headaxislength=4.5,
        zorder=1,
    )


def _line(portrait: PortraitData, orbit: Orbit) -> tuple[FloatArray, FloatArray]:
    """Return an orbit as a line on the plane of the portrait, exact within a pixel: its coordinates x and y, (k,) each.

    The line is cut where an angle wraps; NaN separates its pieces.
    """
    first, second = portrait.plane
    rows = [first.row, second.row]
    pieces = []
    for part in orbit.parts:
        begin = first_times(part)
        extent = np.ptp(part.dense(begin)[rows], axis=1)
        # The panel shows the window of the portrait, which an angle may cross several times.
        pixels = Pixels(PANEL_WIDTH * extent[0] / first.width, PANEL_HEIGHT * extent[1] / second.width)
        _, points = in_plane(partial(_points, part, rows), begin, pixels)
        x, y = points[0]
        for line in turned_lines(x, y, first.low, first.high) if portrait.turns else [(x, y)]:
            pieces += [np.column_stack(line), np.full((1, 2), np.nan)]
    whole = np.vstack(pieces[:-1])
    return whole[:, 0], whole[:, 1]


def _points(run: Trajectory, rows: list[int], t: FloatArray) -> FloatArray:
    """Return the entries `rows` of the state of a run at times t (K,), as one point of the plane, (1, 2, K)."""
    return np.asarray(run.dense(t)[rows][None])


def _equilibria(axis: Axes, portrait: PortraitData, look: FigureStyle) -> None:
    first, second = portrait.plane
    seen: set[str] = set()
    for equilibrium in portrait.equilibria:
        marker, fill = _MARKERS[equilibrium.kind]
        axis.plot(
            [equilibrium.state[first.row]],
            [equilibrium.state[second.row]],
            marker=marker,
            markersize=8.5 if marker != "X" else 9.5,
            markerfacecolor=getattr(look, fill),
            markeredgecolor=look.ink,
            markeredgewidth=1.2,
            linestyle="none",
            label="_" if equilibrium.kind in seen else equilibrium.kind,
            clip_on=False,
            zorder=5,
        )
        seen.add(equilibrium.kind)


def _frame(axis: Axes, ax: Any, portrait: PortraitData, look: FigureStyle) -> None:
    statement, (first, second) = portrait.statement, portrait.plane
    fixed = ", ".join(f"${entry(statement, name)}$ = {value:g}" for name, value in portrait.held.items())
    title = statement.name + (f" at {fixed}" if fixed else "")
    dress(axis, look, title + (f", t = {portrait.time:g}" if portrait.time is not None else ""))
    axis.grid(visible=False)
    axis.set(xlim=(first.low, first.high), ylim=(second.low, second.high))
    axis.set_xlabel(label_of_entry(statement, first.name))
    axis.set_ylabel(label_of_entry(statement, second.name))
    if portrait.turns:
        angle_ticks(axis.xaxis, first.low, first.high)
    if not axis.get_legend_handles_labels()[0]:
        return
    frame = {"facecolor": look.paper, "edgecolor": look.grid, "framealpha": 0.85}
    place: dict[str, Any] = {"fontsize": 7, "loc": "upper right", **frame}
    if ax is None:  # the width of a user's axes must not change
        place = {"fontsize": 8, "loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
    axis.legend(labelcolor=look.ink, handlelength=3.0, **place)


LARGEST_POINT, SMALLEST_POINT = 6.0, 0.5
"""Largest and smallest diameter of the dots of a section, in typographic points. Many crossings have small dots."""


def plot_section(section: SectionData, x: Any, y: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of a Poincaré section: a colour for each orbit, and the border of the region of its energy.

    `x` and `y` are the entries of the state on the axes, None for the defaults. `ax` are axes of the user, None for a
    new figure. `style` is "light" or "dark". Raises StatementError for a section without points.
    """
    look, statement = style_of(style), section.statement
    if not len(section.points):
        raise StatementError(f"there is nothing to draw: {section.message}")
    names = statement.state_names
    stated = (section.axes[0] if x is None else x, "x"), (section.axes[1] if y is None else y, "y")
    columns = [row_of(statement, entry, what) for entry, what in stated]
    figure, axis = panel_on(ax, look, (7.0, 6.0))
    size = float(np.clip(LARGEST_POINT * (100 / max(len(section.points), 1)) ** 0.25, SMALLEST_POINT, LARGEST_POINT))
    for states, colour in zip(section.states, colours(len(section.states), look.colours), strict=True):
        axis.plot(*_wrapped(statement, states, columns), ".", color=colour, markersize=size, markeredgewidth=0.0)
    if (names[columns[0]], names[columns[1]]) == section.axes:
        for line in section.border:
            axis.plot(*line.T, color=look.quiet, linewidth=widths.THIN)
    dress(axis, look, f"{statement.name}: {_where(section)}")
    axis.set_xlabel(label_of_entry(statement, names[columns[0]]))
    axis.set_ylabel(label_of_entry(statement, names[columns[1]]))
    for side, k in zip((axis.xaxis, axis.yaxis), columns, strict=True):
        if is_angle(statement, k) and np.ptp(wrapped(section.points[..., k], -np.pi)) > np.pi:
            angle_ticks(side, -np.pi, np.pi)
    say_below(figure, ax, look, "" if section.status.complete else section.message)
    return figure


def _wrapped(statement: Statement, states: FloatArray, columns: list[int]) -> list[FloatArray]:
    """Return the entries with the indices `columns` of states (..., 2n), (...,) each, with angles from -pi to pi."""
    return [wrapped(states[..., k], -np.pi) if is_angle(statement, k) else states[..., k] for k in columns]


def _where(section: SectionData) -> str:
    statement = section.statement
    if section.event is None:
        unit = unit_of(statement, "t")
        return f"every {section.period:.6g}{' ' + unit if unit else ''}"
    side = {1: ", rising", -1: ", falling"}.get(section.event.direction, "")
    at = f" at the energy {section.energy:g}" if section.energy is not None else ""
    return f"{surface(section.event, statement)}{side}{at}"


def plot_sweep(sweep: SweepData, entry: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of the bifurcation diagram `sweep`: sampled states against the parameter.

    `entry` is the entry of the state to draw, None for the default. `ax` are axes of the user, None for a new figure.
    `style` is "light" or "dark". Raises StatementError for a diagram without states.
    """
    look, statement = style_of(style), sweep.statement
    row = row_of(statement, sweep.axes[0] if entry is None else entry, "entry")
    valid = np.isfinite(sweep.states[..., row])
    if not valid.any():
        raise StatementError(f"there is nothing to draw: {sweep.message}")
    figure, axis = panel_on(ax, look, (8.6, 5.2))
    size = max(0.35, min(2.0, 2.0 * (4000 / valid.sum()) ** 0.5))
    for k, colour in enumerate(colours(sweep.states.shape[1], look.colours)):
        (points,) = _wrapped(statement, sweep.states[:, k], [row])
        abscissae = np.broadcast_to(sweep.values[:, None], points.shape)
        axis.plot(
            abscissae.ravel(),
            points.ravel(),
            ".",
            color=colour,
            markersize=2 * size,
            markeredgewidth=0.0,
            rasterized=True,
        )
    name = statement.state_names[row]
    sampled = "after each period of the driving" if sweep.event is None else surface(sweep.event, statement)
    dress(axis, look, f"{statement.name}: {sampled}")
    _parameter_axis(axis, statement, sweep.parameter, sweep.values)
    axis.set_ylabel(label_of_entry(statement, name))
    say_below(figure, ax, look, "" if sweep.status.complete else sweep.message)
    return figure


def _parameter_axis(axis: Axes, statement: Statement, parameter: str, values: FloatArray) -> None:
    axis.set_xlabel(with_unit(f"${LatexNotation().letter(parameter)}$", unit_of(statement, parameter)))
    low, high = float(values.min()), float(values.max())
    if low < high:
        axis.set_xlim(low, high)


def plot_branches(data: BranchesData, entry: Any, ax: Any, style: Any) -> Figure:
    """Return the figure of equilibria: a coordinate against the parameter, dashed where an equilibrium is unstable.

    `entry` is the coordinate, None for the default. `ax` are axes of the user, None for a new figure. `style` is
    "light" or "dark". Raises StatementError for a velocity, and for data without branches.
    """
    look, statement = style_of(style), data.statement
    row = row_of(statement, data.axis if entry is None else entry, "entry")
    if row >= len(statement.names) or not data.branches:
        raise StatementError(
            f"there is nothing to draw: {data.message}"
            if not data.branches
            else f"velocities are zero at equilibria: give a coordinate, such as {statement.names[0]}."
        )
    figure, axis = panel_on(ax, look, (7.6, 5.0))
    for stable, colour, dashes, label in (
        (1.0, look.colours[0], (1, 0), "no eigenvalue with a positive real part"),
        (0.0, look.colours[1], (5, 3), "unstable"),
    ):
        for branch in data.branches:
            line = np.where(with_neighbours(branch.stable == stable), branch.coordinates[:, row], np.nan)
            if np.isfinite(line).any():
                axis.plot(branch.values, line, color=colour, linewidth=widths.BRANCH, dashes=dashes, label=label)
                label = "_"
    dress(axis, look, f"{statement.name}: equilibria")
    _parameter_axis(axis, statement, data.parameter, data.values)
    axis.set_ylabel(label_of_entry(statement, statement.names[row]))
    if is_angle(statement, row):
        low, high = axis.get_ylim()
        angle_ticks(axis.yaxis, low, high)
    axis.legend(fontsize=8, frameon=False, labelcolor=look.ink)
    say_below(figure, ax, look, "" if data.status.complete else data.message)
    return figure


MOST_MODES = 8  # Largest number of modes in a figure: more would make it taller than a page

LARGEST_DISPLACEMENT = 0.22  # Largest displacement in the figure, as a part of the extent of the positions at rest


def plot_modes(shapes: ModeShapes, ax: Any, style: Any) -> Figure:
    """Return the figure of modes: a row for each, with its components as bars, and its shape if positions are stated.

    `shapes` are the modes in numbers. On axes `ax` of the user the components of all modes are bars side by side.
    `style` is "light" or "dark". Raises StatementError for a system without modes.
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
    for k in range(count):
        _bars(grid[k, 0], shapes, k, look)
    if shapes.points:
        projected = _seen(shapes)
        for k in range(count):
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
    _frame_bars(axis, shapes, _title(shapes, k), look)
    axis.set(ylim=(-1.15, 1.15), yticks=[-1, 0, 1])


def _frame_bars(axis: Axes, shapes: ModeShapes, title: str, look: FigureStyle) -> None:
    """Draw the `title` of a panel of bars, a line at zero, and the names of the coordinates below the bars.

    `shapes` has the names of the coordinates.
    """
    axis.axhline(0.0, color=look.quiet, linewidth=widths.FLOOR)
    dress(axis, look, title)
    axis.grid(visible=False, axis="x")
    ticks = np.arange(len(shapes.names))
    letter = LatexNotation(shapes.names).letter
    step = 1 + (len(ticks) - 1) // 12
    axis.set_xticks(ticks[::step], [f"${letter(name)}$" for name in shapes.names][::step])


def _all_bars(axis: Axes, shapes: ModeShapes, look: FigureStyle) -> None:
    count, n = shapes.components.shape
    positions, width = np.arange(n), 0.8 / count
    for k, colour in enumerate(colours(count, look.colours)):
        shift = (k - (count - 1) / 2) * width
        axis.bar(positions + shift, shapes.components[k], width=0.9 * width, color=colour, label=_title(shapes, k))
    _frame_bars(axis, shapes, f"{shapes.statement.name}: shapes of modes", look)
    axis.legend(fontsize=8, frameon=False, labelcolor=look.ink)


def _seen(shapes: ModeShapes) -> tuple[dict[str, FloatArray], dict[str, FloatArray], float]:
    """Return three values, all projected to the plane of the picture, from which the shapes of m modes are drawn.

    The first value has the positions at rest by name, (2,) each. The second one has the displacements of each point in
    all modes by name, (m, 2) each. The third one is the extent of the positions at rest.
    """
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
    """Draw mode number `k` of `shapes`: positions at rest in a pale colour, displaced positions with arrows.

    `seen` is the result of `_seen`: positions at rest, displacements, and extent.
    """
    points, moved, extent = seen
    largest = max(float(np.linalg.norm(rows[k])) for rows in moved.values())
    scale = LARGEST_DISPLACEMENT * extent / largest if largest > 1e-12 else 0.0
    at = {name: point + scale * moved[name][k] for name, point in points.items()}
    for positions, colour, width in ((points, look.grid, widths.AT_REST), (at, look.quiet, widths.BOLD)):
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
            arrow = {
                "arrowstyle": "-|>",
                "color": look.colours[1],
                "linewidth": widths.BOLD,
                "shrinkA": 0,
                "shrinkB": 0,
            }
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
    """Return a figure of the real and imaginary parts of eigenvalues along a parameter; `style` is "light" or "dark".

    The equilibrium is unstable where a real part is positive.
    """
    look = style_of(style)
    figure = new_figure(figsize=(7.2, 6.0), layout="constrained")
    growth, frequency = figure.subplots(2, 1, sharex=True)
    dress(growth, look, "The equilibrium is unstable where a real part is positive")
    dress(frequency, look)
    for column, colour in zip(path.eigenvalues.T, colours(path.eigenvalues.shape[1], look.colours), strict=True):
        growth.plot(path.values, column.real, color=colour, linewidth=widths.BOLD)
        frequency.plot(path.values, column.imag, color=colour, linewidth=widths.BOLD)
    growth.axhline(0.0, color=look.quiet, linewidth=widths.FRAME)
    growth.set(ylabel="real part")
    frequency.set(xlabel=str(path.parameter), ylabel="imaginary part")
    return on_paper(figure, look)


_POINTS = 401


def plot_stability(
    *methods: Any, left: float = -8.0, right: float = 4.0, top: float = 7.0, style: str = "light"
) -> Figure:
    """Return a figure of the stability boundaries of methods in the complex plane of the eigenvalue times the step.

    `methods` are names or instances of methods. The eigenvalue is that of a linear system y' = A y. The real part is
    shown between `left` and `right`, the imaginary part between -`top` and `top`. A method is stable to the left of its
    boundary, or inside it. The region where every method is stable is shaded. Raises StatementError for a splitting,
    for the Taylor method, and for solvers of SciPy and SUNDIALS. A splitting has no damping and is stable only on a
    part of the imaginary axis, which `lg.methods.stability` returns.
    """
    look = style_of(style)
    left, right, top = real_number(left, "left"), real_number(right, "right"), real_number(top, "top")
    if not (left < right and top > 0):
        raise StatementError(f"left = {left:g}, right = {right:g} and top = {top:g}: give left < right and top > 0.")
    if not methods:
        raise StatementError("name at least one method, such as lg.methods.plot_stability('rk4', 'radau5').")
    x, y = np.linspace(left, right, _POINTS), np.linspace(-top, top, _POINTS | 1)
    grid = x + 1j * y[:, None]
    # A real eigenvalue would be paired with itself: points on the real axis are moved 1e-6 above it.
    plane = np.where(grid.imag == 0, grid + 1e-6j, grid)
    figure = new_figure(figsize=(7.2, 6.4), layout="constrained")
    axis = figure.add_subplot()
    dress(axis, look, "A step does not amplify on the left of, or inside, its line")
    lines, names = [], []
    everywhere = np.ones(grid.shape, dtype=bool)
    for method, colour in zip(methods, colours(len(methods), look.colours), strict=True):
        sizes = growth(step_of(method), plane)
        axis.contour(x, y, sizes, levels=[1.0 + GROWTH_TOLERANCE], colors=[colour], linewidths=widths.BOLD)
        everywhere &= sizes <= 1.0 + GROWTH_TOLERANCE
        lines.append(axis.plot([], [], color=colour, linewidth=widths.BOLD)[0])
        names.append(find(method).name)
    axis.contourf(x, y, everywhere, levels=[0.5, 1.5], colors=[mixed(look.colours[0], look.paper, 0.12)])
    axis.axhline(0.0, color=look.quiet, linewidth=widths.FRAME)
    axis.axvline(0.0, color=look.quiet, linewidth=widths.FRAME)
    axis.set(xlabel="real part of rate times step", ylabel="imaginary part", aspect="equal")
    axis.legend(lines, names, loc="upper left", frameon=False, labelcolor=look.ink)
    return on_paper(figure, look)
