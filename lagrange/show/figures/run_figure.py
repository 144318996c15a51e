"""`lagrange.plot` and `solution.plot`: choose panels by `what` and `of`, label runs, and lay out the figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice
from math import ceil, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.errors import StatementError, counted, listing, shown, suggestion
from lagrange.show.figures import panel as quantities
from lagrange.show.figures.curve import Pixels
from lagrange.show.figures.panel import PanelQuantity, PhasePanel, TimePanel, figure_of
from lagrange.show.figures.paths import PathPanel, common_view
from lagrange.show.figures.style import FigureStyle, new_figure, on_paper, size_of, style_of
from lagrange.show.files.picture import LEAST_DPI, MOST_DPI
from lagrange.statement.coordinate import name_of, row_label
from lagrange.statement.expression import entries, one_of, refusing_deep, whole_number
from lagrange.statement.rotation import rotation_of, shorthands
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


Panel = TimePanel | PhasePanel | PathPanel

_MOST_PHASES = 9  # Largest number of phase planes in one figure


class Contents:
    """Chooses the panels of a figure of runs.

    `labels` are the names of the runs. `of` is a coordinate or a list of coordinates, by symbol or name, or None for
    all. With `merged` all coordinates share one panel, and so do all velocities. Raises StatementError for anything in
    `of` that is not a coordinate.
    """

    def __init__(self, solutions: Sequence[Solution], labels: Sequence[str], of: Any, *, merged: bool) -> None:
        self.solutions, self.labels, self.merged = tuple(solutions), tuple(labels), merged
        statement = solutions[0].model.statement
        keys = [*(of if isinstance(of, (list, tuple)) else [of])]
        if not keys:
            raise StatementError(f"of = [] chooses no coordinate; they are {listing(statement.names)}.")
        refusal = "of = {given} is not a coordinate of this system; they are {known}."
        self.chosen = (
            [*statement.names] if of is None else [one_of(row_label(key), statement.names, refusal) for key in keys]
        )
        self.turned = list(map(rotation_of, statement.rotations if of is None else ()))

    def overview(self) -> list[Panel]:
        """Return the panels of coordinates, of conserved quantities, and of paths if points are named.

        The panels of a body show its rates about its axes instead of the entries of its quaternion.
        """
        entries = {name_of(q) for rotation in self.turned for q in rotation.quaternion}
        rest = [name for name in self.chosen if name not in entries]
        rates = [panel for rotation in self.turned for rate in rotation.body for panel in self.of(rate)]
        momenta = self._over_time(quantities.momenta, wide=True)
        drift = self.named("drift") if self.solutions[0].model.statement.lagrangian != 0 else []
        return [*self._rows(rest), *rates, *drift, *momenta, *self._paths()]

    def of(self, what: Any) -> list[Panel]:
        """Return the panels for `what`, a name such as "energies" or "theta", or an expression.

        Raises StatementError for an unknown name, and for anything that is not an expression.
        """
        if isinstance(what, str):
            if what in WHAT:
                return self.named(what)
            names, turned = self.solutions[0].names, shorthands(self.solutions[0].model.statement.rotations)
            if what in turned:
                return self.of(turned[what])
            if what not in names and (synonym := OTHER_NAMES.get(" ".join(what.replace("_", " ").split()))):
                return self.named(synonym)
            if what not in names:
                raise StatementError(
                    f"what = {shown(what)} is not a quantity to plot: give {listing(WHAT)}, a coordinate or a velocity "
                    f"({listing(names[:8])}), or a SymPy expression.{suggestion(what, [*WHAT, *names])}"
                )
        return self._over_time(lambda run: quantities.expression(run, what))

    def named(self, name: str) -> list[Panel]:
        """Return the panels of a quantity with a name in `WHAT`. Raises StatementError if the runs do not have it."""
        match name:
            case "coordinates" | "velocities":
                return self._rows(self.chosen, rate=name == "velocities")
            case "phase" if len(self.chosen) > _MOST_PHASES:
                raise StatementError(
                    f"there are {len(self.chosen)} phase planes, and a figure has up to {_MOST_PHASES}: choose "
                    f"coordinates with of=, such as of={self.chosen[0]!r}."
                )
            case "phase":
                return [PhasePanel(name, self.solutions, self.labels) for name in self.chosen]
            case "invariants" | "multipliers":
                return self._each(quantities.invariants if name == "invariants" else quantities.multipliers)
            case "path":
                if paths := self._paths():
                    return paths
                raise StatementError(
                    f"{self.solutions[0].model.statement.name} has no named points: state positions="
                    "{'bob': (x, y)} to see their paths, or draw its coordinates with what='coordinates'."
                )
        row = {"energies": quantities.energies, "drift": quantities.energy, "violation": quantities.violation}[name]
        return self._over_time(row, wide=True)

    def _paths(self) -> list[Panel]:
        view = common_view(self.solutions)
        return [] if view is None else [PathPanel(self.solutions, self.labels, view)]

    def _over_time(self, of: Callable[[Solution], PanelQuantity | None], *, wide: bool = False) -> list[Panel]:
        """Return a list with one panel for all runs, of the quantity that `of(run)` returns.

        The list is empty if a run lacks the quantity. A `wide` panel is higher, with a larger title.
        """
        quantities = [of(run) for run in self.solutions]
        kept = [quantity for quantity in quantities if quantity is not None]
        return [TimePanel(tuple(kept), self.solutions, self.labels, wide)] if len(kept) == len(quantities) else []

    def _rows(self, names: Sequence[str], *, rate: bool = False) -> list[Panel]:
        """Return the panels of the coordinates with these `names`, or of their velocities if `rate` is True."""
        return self._each(lambda run: quantities.entries(run, names, merged=self.merged, rate=rate)) if names else []

    def _each(self, of: Callable[[Solution], list[PanelQuantity]]) -> list[Panel]:
        """Return one panel for each of the quantities that `of(run)` returns; every panel shows all runs."""
        rows = zip(*(of(run) for run in self.solutions), strict=True)
        return [TimePanel(row, self.solutions, self.labels) for row in rows]


WHAT = (
    *("coordinates", "velocities", "phase", "energies", "drift", "invariants", "path"),
    *("multipliers", "violation"),
)
"""Names of quantities that the argument `what` of a plot accepts."""

OTHER_NAMES = {"phase plane": "phase", "phase planes": "phase", "energy": "energies", "paths": "path"}
"""Synonyms of names in `WHAT`; a coordinate with such a name has precedence."""


DPI = 200  # Least resolution for which curves are computed, in dots per inch: files have 150, notebooks 160

_LEFT, _RIGHT, _NARROW = 6.0, 4.6, 1.9
"""Widths in inches of panels over time, of a phase plane, and of paths along a vertical line."""

_LEAST, _LEAST_PLANE, _BESIDE, _NARROWEST = 0.45, 1.5, 0.8, 0.4
"""Least sizes of panels, since smaller ones would collapse. The first three are heights in inches: of a panel over
time, of a phase plane, and of title and axis labels together. The last one is a width, as a fraction of the default
width."""

MOST_QUANTITIES = 100  # Largest number of entries of what=. A panel takes 30 ms, and 100 panels are 100 inches high

_ONE_COLUMN = 4  # More coordinates than this are in two columns


def labels_of(solutions: Sequence[Solution], requested: Sequence[str] | None) -> list[str]:
    """Return a name for each of the runs `solutions`: the texts `requested`, or a property in which they differ.

    The property is the method, a parameter or an initial value. It is used if `requested` is None. A single run then
    has the name "".
    """
    if requested is not None:
        labels = [requested] if isinstance(requested, str) else entries(requested, "labels")
        if labels is None or len(labels) != len(solutions) or not all(isinstance(label, str) for label in labels):
            raise StatementError(
                f"labels are {shown(requested)}: give a text for each of {counted(len(solutions), 'run')}."
            )
        return [label.replace("$", r"\$") for label in labels]
    if len(solutions) == 1:
        return [""]
    methods = [run.method for run in solutions]
    if len(set(methods)) == len(methods):
        return methods
    # Rates of bodies come before the entries of their quaternions.
    rates = [rate for body in map(rotation_of, solutions[0].model.statement.rotations) for rate in body.body]
    firsts = [
        {name_of(rate): float(run[rate][0]) for rate in rates} | dict(zip(run.names, run.y[:, 0].tolist(), strict=True))
        for run in solutions
    ]
    for values in ([dict(run.parameters) for run in solutions], firsts):
        keys = [key for key in values[0] if len({label.get(key) for label in values}) == len(values)]
        if keys:
            return [f"{keys[0]} = {label[keys[0]]:.6g}" for label in values]
    return [f"run {k}" for k in range(1, len(solutions) + 1)]


def _check_alike(solutions: Sequence[Solution]) -> None:
    first = solutions[0].model.statement
    for run in solutions[1:]:
        other = run.model.statement
        if other.names != first.names:
            raise StatementError(
                f"{first.name} has the coordinates {listing(first.names)} and {other.name} {listing(other.names)}: "
                "runs in one figure must have the same ones. Draw each into its own axes with ax=."
            )


def _draw_into(ax: Any, panels: Sequence[Panel], style: FigureStyle, dpi: int) -> Figure:
    """Draw each panel into one of the user's axes `ax`, and return the figure of the axes.

    `dpi` is the resolution of the curves in dots per inch. Raises StatementError unless there are as many axes as
    panels.
    """
    several, axes = isinstance(ax, (list, tuple, np.ndarray)), [ax]
    if several:
        axes = [*islice(ax.flat if isinstance(ax, np.ndarray) else ax, len(panels))]
    figures = [figure_of(axis) for axis in axes]
    count = np.size(ax) if isinstance(ax, np.ndarray) else len(ax) if several else 1
    if count != len(panels):
        raise StatementError(
            f"ax has {counted(count, 'panel')}, but the figure needs {len(panels)}: choose fewer with what= and of=, "
            f"or give {len(panels)} axes."
        )
    for axis, figure, panel in zip(axes, figures, panels, strict=True):
        box, share = axis.get_window_extent(), dpi / figure.dpi
        panel.draw(axis, Pixels(max(box.width * share, 1.0), max(box.height * share, 1.0)), style)
    return figures[0]


def _laid_out(panels: Sequence[Panel], size: tuple[float, float] | None, style: FigureStyle, dpi: int) -> Figure:
    """Return a new figure: panels over time and wide paths on the left, phase planes and other paths on the right.

    `size` is the width and height in inches, None for a size that fits the panels. `dpi` is the resolution of the
    curves in dots per inch.
    """
    left = [panel for panel in panels if isinstance(panel, TimePanel)]
    rows = [panel for panel in panels if not isinstance(panel, TimePanel) and panel.shape == "row"]
    right = [panel for panel in panels if not isinstance(panel, TimePanel) and panel.shape != "row"]
    left_part = _Left(left, rows)
    columns = ceil(sqrt(len(right))) if not (left or rows) else 1
    down = ceil(len(right) / max(columns, 1))
    upright = bool(right) and all(panel.shape == "column" for panel in right)
    widths = (_LEFT * bool(left or rows), columns * (_NARROW if upright else _RIGHT) * bool(right))
    width, height = size or (sum(widths), round(max(left_part.height, down * 4.2 if right else 0.0), 1))
    least = max(
        _BESIDE + _LEAST * sum(left_part.ratios) if left_part.ratios else 0.0, _LEAST_PLANE * down if right else 0.0
    )
    if width < _NARROWEST * sum(widths) or height < least:
        raise StatementError(
            f"size = ({width:g}, {height:g}) leaves no room for {counted(len(panels), 'panel')}: give a width of "
            f"{_NARROWEST * sum(widths):.2g} and a height of {least:.2g} or more, or choose less with what=."
        )
    figure = new_figure(figsize=(width, height), layout="constrained")
    share = width / sum(widths)
    if not right:
        left_part.draw(figure, (width, height), style, dpi)
        return figure
    halves = figure.add_gridspec(1, 2, width_ratios=widths) if left or rows else None
    if halves is not None:
        left_part.draw(figure.add_subfigure(halves[0]), (widths[0] * share, height), style, dpi)
    side = figure if halves is None else figure.add_subfigure(halves[1])
    for panel, axis in zip(right, side.subplots(down, columns, squeeze=False).flat, strict=False):
        panel.draw(axis, Pixels(widths[1] * share / columns * dpi, height / down * dpi), style)
    for axis in side.axes[len(right) :]:
        axis.set_visible(False)
    return figure


class _Left:
    """Left part of a figure: panels over time with a common time axis, above panels of paths along a horizontal line.

    More than `_ONE_COLUMN` panels of coordinates are in two columns.
    """

    def __init__(self, panels: Sequence[TimePanel], rows: Sequence[Panel]) -> None:
        narrow = [panel for panel in panels if not panel.wide]
        self.columns = 1 if len(narrow) <= _ONE_COLUMN else 2
        self.narrow = narrow if self.columns == 2 else []
        self.wide = [panel for panel in panels if panel.wide or self.columns == 1]
        self.rows = rows
        self.down = ceil(len(self.narrow) / 2)

    @property
    def ratios(self) -> list[float]:
        """Heights of the rows of panels, relative to the height of a panel of a coordinate."""
        return [1.0] * self.down + [1.3 if panel.wide else 1.0 for panel in self.wide] + [0.55] * len(self.rows)

    @property
    def height(self) -> float:
        """Height in inches at which all panels are readable."""
        return max(2.6, 0.9 + (1.15 if self.down <= _ONE_COLUMN else 0.85) * sum(self.ratios))

    def draw(self, figure: Figure | SubFigure, size: tuple[float, float], style: FigureStyle, dpi: int) -> None:
        """Draw all panels into a part of a figure.

        `size` is the width and height of this part in inches, and `dpi` the resolution of the curves in dots per inch.
        """
        grid = figure.add_gridspec(len(self.ratios), self.columns, height_ratios=self.ratios)
        pixels = Pixels(size[0] * dpi, size[1] * max(self.ratios) / sum(self.ratios) * dpi)
        cells = [grid[k % self.down, k // self.down] for k in range(len(self.narrow))]
        cells += [grid[self.down + k, :] for k in range(len(self.wide))]
        axes = [figure.add_subplot(cell) for cell in cells]
        for panel, axis in zip([*self.narrow, *self.wide], axes, strict=True):
            panel.draw(axis, pixels, style)
        named = {len(axes) - 1, *(k * self.down - 1 for k in (1, 2) if self.down)}
        for k, axis in enumerate(axes):
            if k not in named:
                axis.tick_params(labelbottom=False)
                axis.set_xlabel("")
            if k:
                axis.sharex(axes[0])
        for k, row in enumerate(self.rows):
            row.draw(figure.add_subplot(grid[self.down + len(self.wide) + k, :]), pixels, style)


def _title(solutions: Sequence[Solution]) -> str:
    first = solutions[0]
    if len(solutions) > 1:
        early = [run for run in solutions if not run.status.complete]
        ended = f"   {counted(len(early), 'run')} not complete" if early else ""
        return f"{first.model.statement.name}   {counted(len(solutions), 'run')}{ended}"
    title = f"{first.model.statement.name}   {first.method}, {counted(first.steps, 'step')}"
    if first.status.complete:
        return title
    what = "not the motion" if first.status is Status.UNRELIABLE else "ended early"
    return f"{title}   {what}: {first.status.value}"


@refusing_deep
def plot(
    solutions: Solution | Sequence[Solution],
    what: Any = None,
    *,
    labels: Sequence[str] | None = None,
    of: Any = None,
    ax: Any = None,
    size: Any = None,
    style: str = "light",
    dpi: int | None = None,
) -> Figure:
    """Return a Matplotlib figure of several runs of systems with the same coordinates, as `Solution.plot` draws one.

    `what` is the name of a quantity such as "energies" or "path", a coordinate, an expression, or a list of them;
    without it the panels are an overview. `of` chooses coordinates. `ax` are axes to draw on, `size` is (width,
    height) in inches, `style` is "light" or "dark", and `dpi` is the resolution of the curves. `labels` are the names
    of the runs, one text each; by default their methods, or a parameter or a first value that differs. In a panel
    with one row each run has its own colour, else its own line style. Raises StatementError for arguments that are
    not solutions, for runs without output, and for quantities that a system does not have.
    """
    runs = [solutions] if isinstance(solutions, Solution) else entries(solutions, "the solutions")
    if not runs or not all(isinstance(run, Solution) for run in runs):
        raise StatementError(
            f"lg.plot got {shown(solutions)}: give one solution, or a list of solutions, such as "
            "lg.plot([first, second])."
        )
    look, dpi = style_of(style), max(DPI if dpi is None else whole_number(dpi, "dpi", LEAST_DPI, MOST_DPI), DPI)
    for run in runs:
        if not len(run.t):
            raise StatementError(
                "there is nothing to plot: the run ended before the first of its output times. Its message says why."
            )
    _check_alike(runs)
    names = labels_of(runs, labels)
    items = [*what] if isinstance(what, (list, tuple)) else [what]
    contents = Contents(runs, names, of, merged=ax is not None)
    if not items:
        raise StatementError("what = [] contains no quantity to plot: give a name, an expression, or a list of them.")
    if len(items) > MOST_QUANTITIES:
        raise StatementError(f"what = [...] has {len(items)} quantities: one figure shows at most {MOST_QUANTITIES}.")
    panels = [panel for item in items for panel in (contents.overview() if item is None else contents.of(item))]
    if ax is not None:
        if size is not None:
            raise StatementError("size is for a new figure, and ax is in a figure already: give one of the two.")
        return _draw_into(ax, panels, look, dpi)
    figure = _laid_out(panels, None if size is None else size_of(size), look, dpi)
    figure.suptitle(_title(runs), x=0.01, ha="left", fontsize=11, color=look.ink)
    return on_paper(figure, look)
