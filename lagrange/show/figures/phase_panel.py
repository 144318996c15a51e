"""The panel of a phase plane: the velocity of a coordinate over the coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lagrange.show.figures.blow_up import Window, clipped, cut, limits_of, notes_of, row_of, window_of
from lagrange.show.figures.colours import colours
from lagrange.show.figures.curve import Pixels, first_times, in_plane, outputs_alone
from lagrange.show.figures.panel import label_of_entry
from lagrange.show.figures.style import Style, dress, legend
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from lagrange.show.solution import Solution


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
        windows = [_windows(run, keys) for run in self.solutions]
        lines = [_line(run, keys, pixels, shown) for run, shown in zip(self.solutions, windows, strict=True)]
        for line, label, shade in zip(lines, self.labels, shades, strict=True):
            axis.plot(*line, color=shade, linewidth=1.1, zorder=2)
            axis.plot(*line[:, 0], "o", mfc=style.paper, mec=shade, ms=5, zorder=4)
            axis.plot(*line[:, -1], "o", color=shade, ms=6, zorder=5, label=label or "_nolegend_")
        statement = self.solutions[0].model.statement
        x, y = (label_of_entry(statement, key) for key in keys)
        axis.set_xlabel(x, labelpad=2.0)
        axis.set_ylabel(y, labelpad=2.0)
        axis.margins(0.06)
        right, up = (limits_of([shown[k] for shown in windows], [line[k] for line in lines]) for k in range(2))
        if right:
            axis.set_xlim(*right)
        if up:
            axis.set_ylim(*up)
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
