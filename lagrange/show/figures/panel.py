"""Draw one panel of a run's figure: quantities over time, or a phase plane, with labels, legend and limits."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from lagrange.dynamics.axes import TURN
from lagrange.errors import StatementError, listing, shown
from lagrange.mechanics.conserved import invariant_sizes
from lagrange.show.figures import line_widths as widths
from lagrange.show.figures.curve import (
    MOST_ROUNDS,
    AxisWindow,
    Pixels,
    around,
    first_times,
    in_plane,
    limits_of,
    outputs_alone,
    over_time,
    thinned,
    times_in_sight,
    window_of,
)
from lagrange.show.figures.style import (
    LINES,
    FigureStyle,
    colours,
    dress,
    few_ticks,
    legend,
    new_figure,
    of_figure,
    on_paper,
    with_unit,
)
from lagrange.show.notation.formula import Typesetter
from lagrange.show.notation.latex_mathml import LatexNotation
from lagrange.show.notation.text import Notation, upright
from lagrange.statement.coordinate import row_label
from lagrange.statement.expression import as_typed
from lagrange.statement.expression import expression as expression_of
from lagrange.statement.statement import Statement, energy_unit, unit_of
from lagrange.trajectory.measures.conservation import MOST_LINES
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PANELS = 28  # Largest number of coordinates with a panel each; more coordinates share panels
_SHORT = 10  # Longest name, in letters, that is written beside a panel. A longer one is written above it.
_LONGEST, _WIDEST = 120, 50  # Longest formula above a panel, in letters of LaTeX and of plain text

Values = Callable[["Solution"], FloatArray]
"""Function from a solution to r rows of values (r, N) at its N outputs."""


@dataclass(frozen=True, eq=False)
class PanelQuantity:
    """A quantity of r rows for one panel over time: `values(run)` returns the rows at the outputs of a run, (r, N).

    `labels` are the labels of the rows, in mathematics or words, and `unit` is their common unit. `name` is the title
    of the panel; if it is empty, the only label is written beside the panel. `drift` is true if the values are the
    change of a conserved quantity, which is an error of the method.
    """

    name: str
    labels: tuple[str, ...]
    values: Values
    unit: str = ""
    drift: bool = False


def entries(solution: Solution, chosen: Sequence[str], *, merged: bool, rate: bool) -> list[PanelQuantity]:
    """Return the quantities for panels of the coordinates `chosen`, or of their velocities if `rate` is True.

    A panel has one coordinate. With more than `PANELS` coordinates several share a panel, and with `merged` all do.
    """
    together = len(chosen) if merged else ceil(len(chosen) / PANELS)
    groups = [chosen[k : k + together] for k in range(0, len(chosen), together)]
    return [_group(solution.model.statement, group, rate=rate) for group in groups]


def _group(statement: Statement, names: Sequence[str], *, rate: bool) -> PanelQuantity:
    keys = [f"{name}_dot" if rate else name for name in names]
    units = list(dict.fromkeys(unit_of(statement, key) for key in keys))
    if len(names) > 1:
        title = f"{'velocities' if rate else 'coordinates'} {names[0]} to {names[-1]}"
    else:
        title = "" if len(names[0]) <= _SHORT else f"{'velocity of ' if rate else ''}{names[0]}"
    return PanelQuantity(
        title,
        tuple(f"${entry(statement, key)}$" for key in keys),
        lambda run: np.array([run[key] for key in keys]),
        units[0] if len(units) == 1 else "",
    )


def energies(solution: Solution) -> PanelQuantity:
    """Return T, V and the energy v.p - L as one quantity, or only the energy if a Lagrangian was stated."""
    statement = solution.model.statement
    parts = {} if statement.lagrangian_alone else {"T": statement.kinetic, "V": statement.potential}
    return PanelQuantity(
        "energies" if parts else "energy",
        tuple(f"${name}$" for name in (*parts, solution.model.equations.structure.energy_letter)),
        lambda run: np.array([*map(run.evaluate, parts.values()), run.energy]),
        energy_unit(statement),
    )


def energy(solution: Solution) -> PanelQuantity:
    """Return the drift of the energy, its relative change from the start, if it is conserved, else the energy itself.

    The quantity has no row if the energy has no value at some state.
    """
    letter = solution.model.equations.structure.energy_letter
    if not solution.has_energy:
        return PanelQuantity(
            "energy: it has no value at some state of the run", (), lambda run: np.empty((0, len(run.t)))
        )
    drift = solution.drift
    if not drift.conserved:
        unit = energy_unit(solution.model.statement)
        return PanelQuantity(f"energy ({drift.unkept})", (f"${letter}$",), lambda run: run.energy[None], unit)
    scale = drift.scale if drift.scale > 0 else 1.0
    kept = f"{letter} + energy lost" if solution.contacts else letter
    return PanelQuantity(
        f"energy drift: ({kept} − {letter}₀) relative to {drift.against}",
        (f"${letter}$",),
        lambda run: ((run.energy + run.energy_lost)[None] - drift.first) / scale,
        drift=True,
    )


def momenta(solution: Solution) -> PanelQuantity | None:
    """Return the drift of each conserved momentum of an ignorable coordinate, for one panel; None if there is none.

    A drift is the change from the first value, relative to the largest term of the momentum.
    """
    names = list(solution.momentum_drift)[:MOST_LINES]
    if not names:
        return None
    return PanelQuantity(
        f"drift of {listing(names)} relative to the largest term",
        tuple(f"${LatexNotation().letter(name)}$" for name in names),
        lambda run: np.array([run.momentum_drift[name] for name in names]),
        drift=True,
    )


def invariants(solution: Solution) -> list[PanelQuantity]:
    """Return the change of each conserved quantity from its first value, relative to the size of its terms.

    Raises StatementError if no conserved quantity was found.
    """
    if not solution.invariants:
        name = solution.model.statement.name
        raise StatementError(f"no conserved quantity of {name} was found, so there are no invariants to plot.")
    sizes = invariant_sizes(solution.model, solution.t, solution.y, solution.parameters_at(solution.t))
    quantities = []
    for name, along in solution.invariants.items():
        against = " relative to the size of its terms" if sizes[name] > 0 else ", which is 0 at every output"
        first, scale = along[0], sizes[name] if sizes[name] > 0 else 1.0
        quantities.append(
            PanelQuantity(
                f"drift of {name}{against}",
                (name,),
                partial(
                    lambda name, first, scale, run: (run.invariants[name][None] - first) / scale, name, first, scale
                ),
                drift=True,
            )
        )
    return quantities


def multipliers(solution: Solution) -> list[PanelQuantity]:
    """Return one quantity for each constraint: its multiplier over time.

    Raises StatementError for a system without constraints.
    """
    if not solution.multipliers:
        raise StatementError(f"{solution.model.statement.name} has no constraints, and so no multipliers to plot.")
    return [
        PanelQuantity(
            "" if len(name) <= _SHORT else f"multiplier of {name}",
            (rf"$\lambda_{{{upright(name)}}}$",),
            partial(lambda name, run: run.multipliers[name][None], name),
        )
        for name in solution.multipliers
    ]


def violation(solution: Solution) -> PanelQuantity:
    """Return the largest violation of the constraints over time, relative to the sizes of the constraints' terms."""
    statement, title = solution.model.statement, "largest violation of a constraint, relative to its terms"
    if not statement.constraints:
        raise StatementError(f"{statement.name} has no constraints, and so no violation of them to plot.")
    return PanelQuantity(title, ("violation",), lambda run: run.constraint_error[None], drift=True)


def expression(solution: Solution, stated: Any) -> PanelQuantity:
    """Return the quantity for a panel that shows the expression `stated` in the symbols of a system.

    The expression may contain accelerations and multipliers, too.
    """
    label = row_label(stated)
    if label in solution.names:
        return _group(solution.model.statement, [label.removesuffix("_dot")], rate=label.endswith("_dot"))
    formula = expression_of(stated, "what")
    solution.evaluate(formula)  # raises for symbols that the system does not have
    typed, statement = as_typed(stated, "what"), solution.model.statement
    text = f"${Typesetter(statement, LatexNotation()).write(typed)}$"
    if len(text) > _LONGEST or "\\begin" in text:
        text = Typesetter(statement, Notation()).write(typed)
        text = text if len(text) <= _WIDEST else f"{text[:_WIDEST]} ..."
    return PanelQuantity(text, (text,), lambda run: run.evaluate(formula)[None])


def panel_on(ax: Any, style: FigureStyle, size: tuple[float, float]) -> tuple[Figure, Axes]:
    """Return a figure and its axes: the user's axes `ax`, or new axes of a size in inches if `ax` is None."""
    if ax is None:
        figure = new_figure(figsize=size, layout="constrained")
        return on_paper(figure, style), figure.subplots()
    return figure_of(ax), ax


def figure_of(ax: Any) -> Figure:
    """Return the whole figure of `ax`, the user's axes.

    Raises StatementError for anything that is not Matplotlib's axes, and for axes without a figure.
    """
    if getattr(ax, "plot", None) is None or getattr(ax, "get_figure", None) is None:
        raise StatementError(f"ax is {shown(ax)}: give axes of Matplotlib, or leave it out for a new figure.")
    return of_figure(ax)


def say_below(figure: Figure, ax: Any, style: FigureStyle, message: str) -> None:
    """Write the sentence `message` below a figure, unless it is empty or `ax` are axes of the user."""
    if ax is None and message:
        lines = "\n".join(textwrap.wrap(message, round(13 * figure.get_size_inches()[0])))
        figure.supxlabel(lines, x=0.01, ha="left", fontsize=8, color=style.quiet)


def label_of_entry(statement: Statement, name: str) -> str:
    """Return the label of an axis for the entry `name` of the state, with its unit; a velocity has a dot."""
    return with_unit(f"${entry(statement, name)}$", unit_of(statement, name))


def entry(statement: Statement, name: str, *, rate: bool = False) -> str:
    """Return the LaTeX symbol of the entry `name` of the state, or of its time derivative if `rate`."""
    velocity = name not in statement.names
    symbol = LatexNotation(statement.names).letter(name.removesuffix("_dot") if velocity else name, velocity + rate)
    return re.sub(r"ot(\\[A-Za-z]+)", r"ot{\1}", symbol)  # Matplotlib centres dots above a group


def turned_lines(x: FloatArray, y: FloatArray, low: float, high: float) -> list[tuple[FloatArray, FloatArray]]:
    """Wrap a line with an angle `x` (k,) and heights `y` (k,) to angles from `low` to `high`; return the lines.

    A line that leaves the range at one end continues at the other end, after a NaN. If the range is longer than 2 pi,
    the result has a copy of the wrapped line for each further interval of 2 pi.
    """
    turns = np.floor((x - low) / TURN)
    at = np.nonzero(np.diff(turns))[0]
    upwards = turns[at + 1] > turns[at]
    border = low + np.maximum(turns[at], turns[at + 1]) * TURN
    between = y[at] + (border - x[at]) / (x[at + 1] - x[at]) * (y[at + 1] - y[at])
    out, back = low + np.where(upwards, TURN, 0.0), low + np.where(upwards, 0.0, TURN)
    gap = np.full(len(at), np.nan)
    indices = np.repeat(at + 1, 3)
    line = np.insert(x - turns * TURN, indices, np.column_stack([out, gap, back]).ravel())
    heights = np.insert(y, indices, np.column_stack([between, gap, between]).ravel())
    return [(line + k * TURN, heights) for k in range(max(1, math.ceil((high - low) / TURN - 1e-9)))]


_ROUND_OFF = 1e-15  # Relative drift below which the values are rounding noise, and do not fill a panel
_MORE = 2.0  # Factor by which a drift between the steps must exceed the drift at the steps to be an interpolation error

_DRIFT_ROUNDS = 3
"""Largest number of times that intervals between samples are halved for the drift of a conserved quantity. More would
not help, because a drift is rounding noise, which never becomes smooth."""

_FEW = 3  # Fewer points than this are drawn as dots, because they form no line


@dataclass(frozen=True, eq=False)
class Curves:
    """Lines (2, K) of a quantity of one run for one panel, and a note above the panel.

    `dots` is true if the lines are drawn as dots at the steps. `window` has the limits of a panel that does not show
    all values; it is None if the panel shows all.
    """

    lines: list[FloatArray]
    dots: bool = False
    note: str = ""
    window: AxisWindow | None = None


@dataclass(frozen=True, eq=False)
class TimePanel:
    """Panel of one quantity over time, for one or several runs, `solutions`, of systems with the same coordinates.

    `quantities` has the quantity for each run. `labels` are the names of the runs in the legend. A `wide` panel is
    higher and has a larger title.
    """

    quantities: tuple[PanelQuantity, ...]
    solutions: tuple[Solution, ...]
    labels: tuple[str, ...]
    wide: bool = False

    def draw(self, axis: Axes, pixels: Pixels, style: FigureStyle) -> None:
        """Draw the quantity of all runs into the panel `axis`, with a legend if there are several curves."""
        runs = [
            curves(panel_quantity, run, pixels)
            for panel_quantity, run in zip(self.quantities, self.solutions, strict=True)
        ]
        values = np.concatenate([np.empty(0), *map(_values, runs)])
        values = values[np.isfinite(values)]
        quantity = self.quantities[0]
        dress(axis, style)
        for index, run in enumerate(runs):
            self._draw_run(axis, index, run, style)
        statement = self.solutions[0].model.statement
        axis.set_xlabel(with_unit("t", unit_of(statement, "t")), labelpad=2.0)
        axis.margins(x=0.0)
        few_ticks(axis)
        if quantity.drift and _largest(values) < _ROUND_OFF:
            axis.set_ylim(-2 * _ROUND_OFF, 2 * _ROUND_OFF)
        elif limits := limits_of([run.window for run in runs], [_values(run) for run in runs]):
            axis.set_ylim(*limits)
        elif len(values):
            axis.set_ylim(*around(values))
        axis.locator_params(axis="y", nbins=4 if self.wide else 3)
        self._name(axis, "; ".join(dict.fromkeys(run.note for run in runs if run.note)), style)

    def _draw_run(self, axis: Axes, index: int, run: Curves, style: FigureStyle) -> None:
        """Draw the lines of run number `index`.

        Each run has its own colour. If a run has several rows, each row has a colour and each run a line style.
        """
        several, count = len(self.solutions) > 1, len(run.lines)
        run_colour = colours(len(self.solutions), style.colours)[index]
        shades = (style.ink,) if self.quantities[0].drift else colours(1, style.colours)
        if count > 1:
            shades = colours(count, style.colours)
        elif several:
            shades = (run_colour,)
        kind = LINES[index % len(LINES)] if several and count > 1 else "-"
        for line, shade, label in zip(run.lines, shades, self.quantities[index].labels, strict=False):
            dots = run.dots or line.shape[1] < _FEW
            name = " ".join(
                part for part in (label if count > 1 else "", self.labels[index] if several else "") if part
            )
            axis.plot(
                *line,
                color=shade,
                linewidth=widths.MANY if self.quantities[0].drift else widths.CURVE,
                linestyle="none" if run.dots else kind,
                marker="o" if dots else "",
                markersize=2.0 if run.dots else 3.0,
                label=name or "_nolegend_",
            )

    def _name(self, axis: Axes, notes: str, style: FigureStyle) -> None:
        """Write the title of the panel above it, or beside it if the quantity has a single label and no name.

        Several curves get a legend. `notes` are written above the panel.
        """
        quantity = self.quantities[0]
        title = notes
        if quantity.name or len(quantity.labels) != 1:
            title = "\n".join(filter(None, (with_unit(quantity.name, quantity.unit), notes)))
        else:
            text = with_unit(quantity.labels[0], quantity.unit)
            axis.set_ylabel(text, rotation=0, ha="right", va="center", labelpad=6.0, color=style.ink)
        size = 10.0 if self.wide else 9.0
        axis.set_title(title, loc="left", fontsize=size, color=style.ink)
        if len(quantity.labels) > 1 or len(self.solutions) > 1:
            legend(axis, style, title, size)


def curves(quantity: PanelQuantity, solution: Solution, pixels: Pixels) -> Curves:
    """Return a quantity of a run as lines, exact within a pixel, for a panel of the size `pixels`.

    The drift of a conserved quantity is computed from the dense output. If the drift is much larger between the ends of
    steps than at these ends, the difference is an error of the dense output and not of the method. Then dots are drawn
    at the ends of steps, and a note gives the largest drift between them.
    """
    run = solution.trajectory
    window = None if quantity.drift else window_of(solution, lambda t: quantity.values(solution.sampled(t)))

    def shown(rows: FloatArray) -> FloatArray:
        return rows if window is None else window.clipped(rows)

    if outputs_alone(run):
        lines = [thinned(run.t, row, pixels) for row in shown(quantity.values(solution))]
        note = "the outputs, joined by straight lines"
        return Curves(lines, note=f"{note}; {window.note}" if window else note, window=window)
    lines = over_time(
        lambda t: shown(quantity.values(solution.sampled(t))),
        first_times(run),
        pixels,
        rounds=_DRIFT_ROUNDS if quantity.drift else MOST_ROUNDS,
    )
    if not quantity.drift or len(run.t) < _FEW:
        return Curves(lines, note=window.note if window else "", window=window)
    step_values = quantity.values(solution)
    at_steps, between = (_largest(rows) for rows in (step_values, np.concatenate([line[1] for line in lines])))
    if between <= max(_MORE * at_steps, _ROUND_OFF):
        return Curves(lines)
    steps = [thinned(run.t, row, pixels) for row in step_values]
    return Curves(steps, dots=True, note=f"at the steps (the dense output between them: up to {between:.1e})")


def _values(run: Curves) -> FloatArray:
    """Return all values of the lines of a run, as one array (N,)."""
    return np.concatenate([np.empty(0), *(line[1] for line in run.lines)])


def _largest(rows: FloatArray) -> float:
    return float(np.max(np.abs(rows), initial=0.0, where=np.isfinite(rows)))


@dataclass(frozen=True, eq=False)
class PhasePanel:
    """Panel with the phase plane of the coordinate `name` for the runs `solutions`; `labels` are names of the runs."""

    name: str
    solutions: tuple[Solution, ...]
    labels: tuple[str, ...]
    shape: str = "square"

    def draw(self, axis: Axes, pixels: Pixels, style: FigureStyle) -> None:
        """Draw velocities against coordinates, with an open circle at the start of a run and a dot at its end."""
        dress(axis, style)
        keys = (self.name, f"{self.name}_dot")
        shades = colours(len(self.solutions), style.colours)
        statement = self.solutions[0].model.statement
        drawn = [_line(run, keys, pixels) for run in self.solutions]
        lines = [line for line, _ in drawn]
        for line, label, shade in zip(lines, self.labels, shades, strict=True):
            axis.plot(*line, color=shade, linewidth=widths.PLANE, zorder=2)
            axis.plot(*line[:, 0], "o", mfc=style.paper, mec=shade, ms=5, zorder=4)
            axis.plot(*line[:, -1], "o", color=shade, ms=6, zorder=5, label=label or "_nolegend_")
        x, y = (label_of_entry(statement, key) for key in keys)
        axis.set_xlabel(x, labelpad=2.0)
        axis.set_ylabel(y, labelpad=6.0)
        columns, rows = np.concatenate(lines, axis=1)
        axis.set(xlim=around(columns), ylim=around(rows))
        few_ticks(axis)
        title = "\n".join(dict.fromkeys(["phase plane; open circles: start", *(note for _, note in drawn if note)]))
        axis.set_title(title, loc="left", fontsize=10, color=style.ink)
        if len(self.solutions) > 1:
            legend(axis, style, title, 10)


def _line(run: Solution, keys: tuple[str, str], pixels: Pixels) -> tuple[FloatArray, str]:
    """Return the path of a run in the plane of the two entries `keys`, (2, K), and a note if it leaves the panel."""
    rows = [run.names.index(key) for key in keys]
    times, note = times_in_sight(run, lambda t: run.at(t)[rows])
    if outputs_alone(run.trajectory):
        return run.at(times)[rows], note
    return in_plane(lambda t: run.at(t)[rows][None], times, pixels)[1][0], note
