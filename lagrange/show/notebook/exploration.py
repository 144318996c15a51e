"""What sliders move: a system that is run again for other values, and its picture; without any widget."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from lagrange.errors import LagrangeError
from lagrange.show.figures.style import Style
from lagrange.show.notebook.explored_picture import ExploredPicture
from lagrange.show.sliders import PARAMETER, Slider
from lagrange.statement.statement import Statement
from lagrange.trajectory.solution import Solution

Run = Callable[[Mapping[str, float], Mapping[str, float]], Solution]
"""A run from initial values by name, with parameters by name."""


class Exploration:
    """A system at the values of its sliders: `picture` is a PNG, `message` says how the run ended.

    A run that fails changes the message, and the picture as far as the run got.
    """

    def __init__(self, statement: Statement, sliders: Sequence[Slider], run: Run, style: Style) -> None:
        self.statement, self.sliders = statement, tuple(sliders)
        self.values = {slider.name: slider.value for slider in sliders}
        self.share = 0.0
        self.message = ""
        self.complete = False
        self._run = run
        self._note = "" if statement.positions else "No positions are stated: the coordinates are drawn."
        self._drawn = ExploredPicture(statement, style)
        self.picture = b""
        self.change({})

    def change(self, values: Mapping[str, float]) -> None:
        """Give sliders values, run again and draw."""
        self.values |= values
        parameters = {slider.name: self.values[slider.name] for slider in self.sliders if slider.kind == PARAMETER}
        initial = {slider.name: self.values[slider.name] for slider in self.sliders if slider.kind != PARAMETER}
        try:
            solution = self._run(initial, parameters)
        except LagrangeError as refusal:
            self.message, self.complete = str(refusal), False
        else:
            self._drawn.show(solution)
            self.complete = solution.status.complete
            self.message = " ".join(filter(None, (solution.message, _drift(solution), self._note)))
        self.move(self.share)

    def move(self, share: float) -> None:
        """Draw another part of the run, between 0 and 1."""
        self.share = min(max(share, 0.0), 1.0)
        self.picture = self._drawn.png(self.share)


def _drift(solution: Solution) -> str:
    """Return how far the energy moved, where the system keeps it."""
    if not solution.has_energy or not solution.drift.conserved:
        return ""
    return f"Energy drift {solution.drift.sentence()}."
