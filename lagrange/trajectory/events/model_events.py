"""Translate the events of a run: their functions become graph nodes, and their resets compiled functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lagrange.equations.euler_lagrange import Equations
from lagrange.errors import listing
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Kind, Node, reachable
from lagrange.machine.backend import Kernel
from lagrange.machine.model import Model
from lagrange.machine.state import Reaction
from lagrange.statement.declare import state_rows
from lagrange.statement.event import Event
from lagrange.trajectory.constraints.projection import Projection
from lagrange.trajectory.constraints.residuals import residuals_of
from lagrange.trajectory.events.end_messages import EventResult, not_finite_after_reset, off_constraints
from lagrange.trajectory.trajectory import FloatArray

JUMPING = frozenset(("sign", "atan2", "piecewise"))
"""Names of the functions with jumps inside their domain."""

ALIKE = 1e-9
"""Largest relative difference of two values that agree if two events reset the same entry of the state at one time. The
values differ by rounding, also of the time."""


@dataclass(frozen=True, eq=False)
class ModelEvent:
    """An event of a model: the zeros of the expression `node` with a direction, a terminal count and a reset.

    `direction` is the sign of the crossings that count, 0 for both. The run ends at occurrence number `terminal`, never
    if it is 0. The reset replaces the entries `rows` of the state by results of `kernel`, from result `first` on.
    `kernel` is None without a reset. A `root` is not an event of the user, but a square root in the equations of
    motion: the Taylor series ends at its zero. `model` is the model whose constraints hold after the reset.
    """

    node: Node
    direction: int
    terminal: int
    rows: tuple[int, ...]
    kernel: Kernel | None
    first: int = 0
    root: bool = False
    model: Model | None = None

    @property
    def reset(self) -> bool:
        """True if the event resets the state."""
        return self.kernel is not None

    @cached_property
    def smooth(self) -> bool:
        """True if the expression contains no function that may jump over zero."""
        calls = (call.data for call in reachable([self.node]) if call.kind is Kind.CALL)
        return not self.root and JUMPING.isdisjoint(calls)

    @property
    def contact(self) -> bool:
        """True for a reset in one direction only, like an impact: the sign of the event function must not change."""
        return self.reset and self.direction != 0

    @property
    def constrained(self) -> bool:
        """True if the event resets the state and the new state has to satisfy constraints."""
        return self.reset and self.model is not None and len(self.model.equations.constraints) > 0

    @property
    def reaction(self) -> Reaction:
        """The event's direction, terminal count and reset, as the memory of a compiled loop stores them."""
        return Reaction(self.direction, self.terminal, self.first, self.rows, self.root, self.smooth)

    def counts(self, rising: int) -> bool:
        """Return True if a zero of the event function with direction `rising` (1, -1, or 0 for a touch) counts."""
        return self.direction in (0, rising)

    def apply(self, t: float, before: FloatArray, parameters: FloatArray, state: FloatArray) -> None:
        """Write the entries that the event resets to `state` (2n,), computed from the state `before` (2n,).

        `before` is the state before all events at time t, and `parameters` is (k,). An entry that another event at this
        time has reset to a different value becomes nan.
        """
        if self.kernel is not None:
            rows = list(self.rows)
            with np.errstate(all="ignore"):
                values = self.kernel(t, before, parameters)[self.first : self.first + len(rows)]
            agreed = np.isclose(values, state[rows], rtol=ALIKE, atol=0.0)
            state[rows] = np.where((state[rows] == before[rows]) | agreed, values, np.nan)


def reset_state(
    resets: Mapping[ModelEvent, int],
    names: Callable[[], Sequence[str]],
    t: float,
    before: FloatArray,
    parameters: FloatArray,
) -> tuple[FloatArray, EventResult]:
    """Return the state (2n,) after resets, and a result that ends the run if this state is not valid.

    `resets` maps events to their indices in `names()`. Every reset is computed from the state `before` (2n,). If
    constraints hold after a reset, the new state must satisfy them, like an initial state. Since `before` satisfies the
    constraints only up to the error of the step, the test uses the nearest state that satisfies them exactly.
    """
    after = _reset(resets, t, before, parameters)
    if not np.isfinite(after).all():
        return after, not_finite_after_reset(names()[next(iter(resets.values()))])
    first = next(iter(resets))
    if first.model is None or not first.constrained:
        return after, EventResult()
    are_zero = residuals_of(first.model).are_zero
    # Velocities of coordinates without inertia follow from the equations unless a reset sets them.
    named = [row for event in resets for row in event.rows]
    left = [row for row in first.model.equations.following if row not in named]
    if not left and are_zero(t, before, parameters) and are_zero(t, after, parameters):
        return after, EventResult()
    projection = Projection(first.model, t, parameters)
    if left:
        solved = projection.solved_for(left, after)
        after = after if solved is None else solved
    exact = projection.reached(before) if projection.is_off(before) else before
    judged = after if exact is None or exact is before else _reset(resets, t, exact, parameters)
    if left and judged is not after:
        solved = projection.solved_for(left, judged)
        judged = judged if solved is None else solved
    if not np.isfinite(judged).all():
        return after, not_finite_after_reset(names()[next(iter(resets.values()))])
    off = projection.violated(judged, before)
    if off is not None:
        return after, off_constraints(listing(names()[which] for which in resets.values()), off)
    reached = projection.reached(after) if exact is before and projection.is_off(after) else None
    return after if reached is None else reached, EventResult()


def _reset(resets: Iterable[ModelEvent], t: float, before: FloatArray, parameters: FloatArray) -> FloatArray:
    after = before.copy()
    for event in resets:
        event.apply(t, before, parameters, after)
    return after


def model_events(model: Model, events: Sequence[Event]) -> tuple[ModelEvent, ...]:
    """Translate the events that the user stated into nodes of the model's graph. One kernel computes all resets."""
    equations, rows = model.equations, state_rows(model.statement.coordinates)
    values = [value for event in events for value in event.reset.values()]
    kernel = model.function("reset", tuple(map(equations.translate, values))) if values else None
    translated, first = [], 0
    for event in events:
        indices = tuple(rows[key] for key in event.reset)
        reset = kernel if indices else None
        node = equations.translate(event.expression)
        translated.append(ModelEvent(node, event.direction, event.terminal, indices, reset, first, model=model))
        first += len(indices)
    return tuple(translated)


@lru_cache(maxsize=64)
def rates(equations: Equations, nodes: tuple[Node, ...]) -> tuple[Node, ...]:
    """Return the time derivatives of nodes along the motion, as nodes, with the accelerations of the equations."""
    ahead = dict(zip((*equations.q, *equations.v), (*equations.rate, *equations.accelerations), strict=True))
    along = tangents(nodes, {**ahead, equations.time: equations.graph.one})
    return tuple(along(node) for node in nodes)
