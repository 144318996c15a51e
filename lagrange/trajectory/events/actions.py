"""Events as a run needs them: which zeros count, when they end it, and the reset as a program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lagrange.graph.node import Node
from lagrange.machine.backend import Kernel
from lagrange.machine.model import Model
from lagrange.statement.declare import state_rows
from lagrange.statement.event import Event
from lagrange.trajectory.trajectory import FloatArray

ALIKE = 1e-9
"""Two resets of one entry at one time agree to this part: they are rounded, and so is the time."""


@dataclass(frozen=True, eq=False)
class Impact:
    """An event of a model: `node` is its expression; `rows` of the state are reset to what `kernel` gives.

    A `root` is none of the user's: it is a square root in the equations of motion, whose series ends where it is zero.
    """

    node: Node
    direction: int
    terminal: int
    rows: tuple[int, ...]
    kernel: Kernel | None
    parameters: FloatArray
    root: bool = False

    @property
    def reset(self) -> bool:
        """Whether the state jumps."""
        return self.kernel is not None

    def counts(self, rising: int) -> bool:
        """Whether a zero of that direction is an event; a touch is one for either direction."""
        return self.direction in (0, rising)

    def apply(self, t: float, before: FloatArray, state: FloatArray) -> None:
        """Enter the reset entries of the state (2n,), computed from the state before.

        An entry that another event at the same time has reset to another value becomes nan: there is none to prefer.
        """
        if self.kernel is not None:
            rows = list(self.rows)
            with np.errstate(all="ignore"):
                given = self.kernel(t, before, self.parameters)
            agreed = np.isclose(given, state[rows], rtol=ALIKE, atol=0.0)
            state[rows] = np.where((state[rows] == before[rows]) | agreed, given, np.nan)


def root_of(node: Node) -> Impact:
    """Return a square root as an event that ends the run: behind its zero a series would go on with the wrong sign."""
    return Impact(node, 0, 1, (), None, np.empty(0), root=True)


def impact(model: Model, event: Event, parameters: FloatArray) -> Impact:
    """Return an event of a model."""
    equations = model.equations
    rows = state_rows(model.statement.coordinates)
    nodes = tuple(equations.translate(value) for value in event.reset.values())
    kernel = model.function("reset", nodes) if nodes else None
    places = tuple(rows[key] for key in event.reset)
    return Impact(equations.translate(event.expression), event.direction, event.terminal, places, kernel, parameters)
