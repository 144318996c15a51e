"""The panel of a phase plane: the velocity of a coordinate over the coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lagrange.show.figures.blow_up import Window, clipped, cut, limits_of, notes_of, row_of, window_of
from lagrange.show.figures.colours import colours
from lagrange.show.figures.curve import Pixels, first_times, in_plane, outputs_alone
from lagrange.show.figures.panel import entry
from lagrange.show.figures.style import Style, dress, few_ticks, legend
from lagrange.show.figures.subtracted import base_of, less, level
from lagrange.show.units import unit_of, with_unit
from lagrange.trajectory.solution import Solution
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class PhasePanel:
    """The phase plane of one coordinate, by its name, of some runs."""

    name: str
    solutions: tuple[Solution, ...]
    labels: tuple[str, ...]
    shape: str = "square"

    def draw(self, axis: Axes, pixels: Pixels, style: Style) -> None:
        """Draw velocities over coordinates, open circles where runs begin, and dots where they end."""
        dress(axis, style)
        keys = (self.name, f"{self.name}_dot")
        shades = colours(len(self.solutions), style.colours)
        statement = self.solutions[0].model.statement
        windows = [_windows(run, keys) for run in self.solutions]
        lines = [_line(run, keys, pixels, shown) for run, shown in zip(self.solutions, windows, strict=True)]
        values = [row[np.isfinite(row)] for row in np.concatenate(lines, axis=1)]
        origin = np.array([base_of(row) for row in values])
        for line, label, shade in zip([line - origin[:, None] for line in lines], self.labels, shades, strict=True):
            axis.plot(*line, color=shade, linewidth=1.1, zorder=2)
            axis.plot(*line[:, 0], "o", mfc=style.paper, mec=shade, ms=5, zorder=4)
            axis.plot(*line[:, -1], "o", color=shade, ms=6, zorder=5, label=label or "_nolegend_")
        x, y = (
            with_unit(less(f"${entry(statement, key)}$", base), unit_of(statement, key))
            for key, base in zip(keys, origin, strict=True)
        )
        axis.set_xlabel(x, labelpad=2.0)
        axis.set_ylabel(y, labelpad=6.0)
        axis.margins(0.06)
        for k, side in enumerate("xy"):
            seen = limits_of([shown[k] for shown in windows], [line[k] for line in lines]) or level(values[k])
            if seen:
                axis.set(**{f"{side}lim": (seen[0] - origin[k], seen[1] - origin[k])})
        few_ticks(axis)
        notes = [notes_of(shown[k] for shown in windows) for k in range(2)]
        said = "".join(f"\n{name}: {note}" for name, note in zip(("right", "up"), notes, strict=True) if note)
        title = f"phase plane; open circles: start{said}"
        axis.set_title(title, loc="left", fontsize=10, color=style.ink)
        if len(self.solutions) > 1:
            legend(axis, style, title, 10)


def _states(run: Solution, keys: tuple[str, str], t: FloatArray) -> FloatArray:
    """Return a coordinate and its velocity at times (K,), (2, K)."""
    return run.at(t)[[run.names.index(key) for key in keys]]


def _windows(run: Solution, keys: tuple[str, str]) -> list[Window | None]:
    """Return what is shown to the right and upwards of a run that leaves the panel."""
    return [window_of(run, row_of(lambda t: _states(run, keys, t), k)) for k in range(2)]


def _line(run: Solution, keys: tuple[str, str], pixels: Pixels, windows: Sequence[Window | None]) -> FloatArray:
    """Return the path of a run in the phase plane, (2, K)."""

    def states(t: FloatArray) -> FloatArray:
        return clipped(windows, _states(run, keys, t))

    if outputs_alone(run.trajectory):
        return cut(windows, states(run.t))
    line = in_plane(lambda t: states(t)[None], first_times(run.trajectory), pixels, equal=False)[1][0]
    return cut(windows, line)
