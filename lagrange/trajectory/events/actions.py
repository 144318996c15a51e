"""Events as a run needs them: which zeros count, when they end it, and the reset as a program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lagrange.equations.euler_lagrange import Equations
from lagrange.errors import listing
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Kind, Node, reachable
from lagrange.machine.backend import Kernel
from lagrange.machine.model import Model
from lagrange.statement.declare import state_rows
from lagrange.statement.event import Event
from lagrange.trajectory.constraints.projection import Projection
from lagrange.trajectory.constraints.residuals import residuals_of
from lagrange.trajectory.events.ending import EventResult, nowhere, off_constraints
from lagrange.trajectory.trajectory import FloatArray

JUMPING = frozenset(("sign", "atan2", "piecewise"))
"""Functions that jump where they are defined."""

ALIKE = 1e-9
"""Two resets of one entry at one time agree to this part: they are rounded, and so is the time."""


@dataclass(frozen=True, eq=False)
class Impact:
    """An event of a model, whose expression is `node`.

    The `rows` of the state are reset to what `kernel` gives, from `first` on. A `root` is none of the user's: it is a
    square root in the equations of motion, whose series ends where it is zero. The `model` is that of a reset.
    """

    node: Node
    direction: int
    terminal: int
    rows: tuple[int, ...]
    kernel: Kernel | None
    parameters: FloatArray
    first: int = 0
    root: bool = False
    model: Model | None = None

    @property
    def reset(self) -> bool:
        """Whether the state jumps."""
        return self.kernel is not None

    @property
    def smooth(self) -> bool:
        """Whether the expression does not jump from one side of zero to the other."""
        calls = (one.data for one in reachable([self.node]) if one.kind is Kind.CALL)
        return not self.root and JUMPING.isdisjoint(calls)

    @property
    def contact(self) -> bool:
        """Whether the state jumps where this is met in one direction: it is to stay on the side that it is met from."""
        return self.reset and self.direction != 0

    @property
    def constrained(self) -> bool:
        """Whether the state behind a reset is to be on constraints."""
        return self.reset and self.model is not None and len(self.model.equations.constraints) > 0

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
                given = self.kernel(t, before, self.parameters)[self.first : self.first + len(rows)]
            agreed = np.isclose(given, state[rows], rtol=ALIKE, atol=0.0)
            state[rows] = np.where((state[rows] == before[rows]) | agreed, given, np.nan)


def reset_state(
    resets: Mapping[Impact, int], names: Callable[[], Sequence[str]], t: float, before: FloatArray
) -> tuple[FloatArray, EventResult]:
    """Return the state (2n,) behind resets, of events by number, and how the run ends if it is not one.

    Every reset is computed from the state before. With constraints the new state is treated as an initial one is. The
    path of a step is on them up to its error only, which is no error of the reset: that is judged by what it does to
    the nearest state on them.
    """
    after = _reset(resets, t, before)
    if not np.isfinite(after).all():
        return after, nowhere(names()[next(iter(resets.values()))])
    first = next(iter(resets))
    if first.model is None or not first.constrained:
        return after, EventResult()
    hold = residuals_of(first.model).hold
    left = _left_open(first.model, resets)
    if not left and hold(t, before, first.parameters) and hold(t, after, first.parameters):
        return after, EventResult()
    projection = Projection(first.model, t, first.parameters)
    if left:
        solved = projection.solved_for(left, after)
        after = after if solved is None else solved
    exact = projection.reached(before) if projection.off(before) else before
    judged = after if exact is None or exact is before else _reset(resets, t, exact)
    if left and judged is not after:
        solved = projection.solved_for(left, judged)
        judged = judged if solved is None else solved
    if not np.isfinite(judged).all():
        return after, nowhere(names()[next(iter(resets.values()))])
    off = projection.violated(judged, before)
    if off is not None:
        return after, off_constraints(listing(names()[which] for which in resets.values()), off)
    reached = projection.reached(after) if exact is before and projection.off(after) else None
    return after if reached is None else reached, EventResult()


def _left_open(model: Model, resets: Iterable[Impact]) -> list[int]:
    """Return the rows of velocities of coordinates without inertia that no reset names: they follow from the rest."""
    named = [row for one in resets for row in one.rows]
    return [row for row in (model.layout.v.start + i for i in model.equations.first_order) if row not in named]


def _reset(resets: Iterable[Impact], t: float, before: FloatArray) -> FloatArray:
    after = before.copy()
    for impact in resets:
        impact.apply(t, before, after)
    return after


def root_of(node: Node) -> Impact:
    """Return a square root as an event that ends the run: behind its zero a series would go on with the wrong sign."""
    return Impact(node, 0, 1, (), None, np.empty(0), root=True)


def impacts(model: Model, events: Sequence[Event], parameters: FloatArray) -> tuple[Impact, ...]:
    """Return the events of a model; one kernel computes all resets."""
    equations, rows = model.equations, state_rows(model.statement.coordinates)
    values = [value for event in events for value in event.reset.values()]
    kernel = model.function("reset", tuple(map(equations.translate, values))) if values else None
    found, first = [], 0
    for event in events:
        places = tuple(rows[key] for key in event.reset)
        own = kernel if places else None
        node = equations.translate(event.expression)
        found.append(Impact(node, event.direction, event.terminal, places, own, parameters, first, model=model))
        first += len(places)
    return tuple(found)


@lru_cache(maxsize=64)
def rates(equations: Equations, nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    """Return the derivatives of nodes by time along the motion."""
    ahead = dict(zip((*equations.q, *equations.v), (*equations.rate, *equations.accelerations), strict=True))
    along = tangents(nodes, {**ahead, equations.time: equations.graph.one})
    return tuple(along(node) for node in nodes)
