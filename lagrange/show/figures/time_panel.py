"""A panel of a quantity over time: curves of one run or of several, within a pixel of their dense output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lagrange.show.figures.blow_up import Window, clipped, limits_of, window_of
from lagrange.show.figures.colours import colours
from lagrange.show.figures.curve import MOST_ROUNDS, Pixels, first_times, outputs_alone, over_time, thinned
from lagrange.show.figures.quantities import Quantity
from lagrange.show.figures.style import LINES, Style, dress, few_ticks, legend
from lagrange.show.figures.subtracted import base_of, less, level
from lagrange.show.units import unit_of, with_unit
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROUND_OFF = 1e-15
"""A relative drift below this is round-off, and does not fill a panel."""

_MORE = 2.0
"""Dense output that drifts so many times as far as the steps is told apart from them: it is not the method's drift."""

_DRIFT_ROUNDS = 3
"""Halvings of the samples of a drift, which is round-off at the end, where no curve is smooth."""

_FEW = 3
"""Fewer points than this are dots, for there is no line to see."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Lines (2, K) of a quantity of one run, whether they are dots at the steps, and what is said of them.

    `window` is what a panel shows of them where that is not all.
    """

    lines: list[FloatArray]
    dots: bool = False
    note: str = ""
    window: Window | None = None


@dataclass(frozen=True, eq=False)
class TimePanel:
    """A quantity of some runs of systems with the same coordinates; `labels` tell the runs apart."""

    quantities: tuple[Quantity, ...]
    solutions: tuple[Solution, ...]
    labels: tuple[str, ...]
    wide: bool = False

    @property
    def height(self) -> float:
        """The height relative to that of a coordinate."""
        return 1.3 if self.wide else 1.0

    def draw(self, axis: Axes, pixels: Pixels, style: Style) -> None:
        """Draw all curves, with a legend where there are several."""
        runs = [curves(one, run, pixels) for one, run in zip(self.quantities, self.solutions, strict=True)]
        values = np.concatenate([np.empty(0), *map(_values, runs)])
        values = values[np.isfinite(values)]
        quantity = self.quantities[0]
        base = 0.0 if quantity.drift else base_of(values)
        start = base_of(np.array([time for run in self.solutions for time in (run.t[0], run.t[-1])]))
        dress(axis, style)
        for place, run in enumerate(runs):
            self._draw_run(axis, place, run, (start, base), style)
        statement = self.solutions[0].model.statement
        axis.set_xlabel(with_unit(less("t", start), unit_of(statement, "t")), labelpad=2.0)
        axis.margins(x=0.0)
        few_ticks(axis)
        _widen(axis, values - base, _ROUND_OFF if quantity.drift else 0.0)
        if limits := limits_of([run.window for run in runs], [_values(run) for run in runs]):
            axis.set_ylim(limits[0] - base, limits[1] - base)
        axis.locator_params(axis="y", nbins=4 if self.wide else 3)
        self._name(axis, base, "; ".join(dict.fromkeys(run.note for run in runs if run.note)), style)

    def _draw_run(self, axis: Axes, place: int, run: Curves, origin: tuple[float, float], style: Style) -> None:
        """Draw the lines of a run: runs have a colour each, or a kind of line where the rows have the colours."""
        several, count = len(self.solutions) > 1, len(run.lines)
        own = colours(len(self.solutions), style.colours)[place]
        shades = (style.ink,) if self.quantities[0].drift else colours(1, style.colours)
        if count > 1:
            shades = colours(count, style.colours)
        elif several:
            shades = (own,)
        kind = LINES[place % len(LINES)] if several and count > 1 else "-"
        for line, shade, label in zip(run.lines, shades, self.quantities[place].labels, strict=False):
            dots = run.dots or line.shape[1] < _FEW
            name = " ".join(
                part for part in (label if count > 1 else "", self.labels[place] if several else "") if part
            )
            axis.plot(
                line[0] - origin[0],
                line[1] - origin[1],
                color=shade,
                linewidth=1.0 if self.quantities[0].drift else 1.3,
                linestyle="none" if run.dots else kind,
                marker="o" if dots else "",
                markersize=2.0 if run.dots else 3.0,
                label=name or "_nolegend_",
            )

    def _name(self, axis: Axes, base: float, notes: str, style: Style) -> None:
        """Say what is drawn: beside the panel if it is short, else above it, and in a legend if there are several."""
        quantity = self.quantities[0]
        title = notes
        if quantity.name or len(quantity.labels) != 1:
            title = "\n".join(filter(None, (with_unit(less(quantity.name, base), quantity.unit), notes)))
        else:
            text = with_unit(less(quantity.labels[0], base), quantity.unit)
            axis.set_ylabel(text, rotation=0, ha="right", va="center", labelpad=6.0, color=style.ink)
        size = 10.0 if self.wide else 9.0
        axis.set_title(title, loc="left", fontsize=size, color=style.ink)
        if len(quantity.labels) > 1 or len(self.solutions) > 1:
            legend(axis, style, title, size)


def curves(quantity: Quantity, solution: Solution, pixels: Pixels) -> Curves:
    """Return a quantity of a run as lines within a pixel, in a panel of some size.

    A drift is that of the dense output, which agrees with the steps at the steps. Where it moves much further between
    them than the steps do it is an error of the dense output and not of the method: then there are dots at the steps,
    and a note has the largest value between them.
    """
    run = solution.trajectory
    window = None if quantity.drift else window_of(solution, lambda t: quantity.values(solution.sampled(t)))
    if outputs_alone(run):
        lines = [thinned(run.t, row, pixels) for row in clipped([window], quantity.values(solution)[None])[0]]
        said = "the outputs, joined by straight lines"
        return Curves(lines, note=f"{said}; {window.note}" if window else said, window=window)
    lines = over_time(
        lambda t: clipped([window], quantity.values(solution.sampled(t))[None])[0],
        first_times(run),
        pixels,
        rounds=_DRIFT_ROUNDS if quantity.drift else MOST_ROUNDS,
    )
    if not quantity.drift or len(run.t) < _FEW:
        return Curves(lines, note=window.note if window else "", window=window)
    own = quantity.values(solution)
    at_steps, between = (_largest(rows) for rows in (own, np.concatenate([line[1] for line in lines])))
    if between <= max(_MORE * at_steps, _ROUND_OFF):
        return Curves(lines)
    steps = [thinned(run.t, row, pixels) for row in own]
    return Curves(steps, dots=True, note=f"at the steps (the dense output between them: up to {between:.1e})")


def _values(run: Curves) -> FloatArray:
    """Return all values of the lines of a run, (N,)."""
    return np.concatenate([np.empty(0), *(line[1] for line in run.lines)])


def _largest(rows: FloatArray) -> float:
    return float(np.max(np.abs(rows), initial=0.0, where=np.isfinite(rows)))


def _widen(axis: Axes, values: FloatArray, least: float) -> None:
    """Keep round-off from filling a panel: what stays put, or moves by less than the least, is a level line."""
    size = _largest(values)
    if size < least:
        axis.set_ylim(-2 * least, 2 * least)
    elif limits := level(values):
        axis.set_ylim(*limits)
