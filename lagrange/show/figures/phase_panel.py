"""The panel of a phase plane: the velocity of a coordinate over the coordinate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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
        for run, label, shade in zip(
            self.solutions, self.labels, colours(len(self.solutions), style.colours), strict=True
        ):
            line = _line(run, keys, pixels)
            axis.plot(*line, color=shade, linewidth=1.1, zorder=2)
            axis.plot(*line[:, 0], "o", mfc=style.paper, mec=shade, ms=5, zorder=4)
            axis.plot(*line[:, -1], "o", color=shade, ms=6, zorder=5, label=label or "_nolegend_")
        statement = self.solutions[0].model.statement
        x, y = (label_of_entry(statement, key) for key in keys)
        axis.set_xlabel(x, labelpad=2.0)
        axis.set_ylabel(y, labelpad=2.0)
        axis.margins(0.06)
        title = "phase plane; open circles: start"
        axis.set_title(title, loc="left", fontsize=10, color=style.ink)
        if len(self.solutions) > 1:
            legend(axis, style, title, 10)


def _line(run: Solution, keys: tuple[str, str], pixels: Pixels) -> FloatArray:
    """Return the path of a run in the phase plane, (2, K)."""
    rows = [run.names.index(key) for key in keys]
    if outputs_alone(run.trajectory):
        return run.y[rows]
    points = in_plane(lambda t: run.at(t)[rows][None], first_times(run.trajectory), pixels, equal=False)[1]
    return np.asarray(points[0])
