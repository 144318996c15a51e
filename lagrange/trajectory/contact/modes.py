"""Modes of a run with contacts: the constraints and forces of closed contacts, and the events that end a mode."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import sympy

from lagrange.equations.euler_lagrange import node_of
from lagrange.machine.backend import Kernel
from lagrange.machine.model import Model
from lagrange.statement.contact import Contact
from lagrange.statement.coordinate import multiplier, velocity_of
from lagrange.statement.coordinate import t as time
from lagrange.statement.event import Event
from lagrange.statement.statement import ALLOW, Constraint, Statement
from lagrange.trajectory.contact.complementarity import CLOSED, OPEN, SLIDING, STICKING
from lagrange.trajectory.contact.kinematics import MODELS_KEPT, quick_function
from lagrange.trajectory.contact.resets import WrittenFriction, WrittenImpacts, written_friction, written_impacts
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray, Trajectory

RELEASE, GAP, SLIP, CONE = "released", "met", "stopped", "freed"
"""Events that end a mode: the normal force becomes zero, the gap or the slip becomes zero, friction reaches its cone.
Each value is also the name of the argument of `Transitions.after` that lists the contacts with this event.
"""

SLOWEST = 1e-12
"""Slip in a plane, as a fraction of the largest so far, that counts as zero, because its direction is not smooth there.
`rtol` is used if it is larger: steps pass over a slip that is smaller than their errors, and reverse it again and
again. An impulse removes the rest of the slip.
"""

EVENTS_KEPT = 8
"""Largest number of lists of events that are cached with a mode, so that its runs use the same drivers."""

Way = int | None
"""Direction of sliding along a single slip component, 1 or -1. None in a plane, and for contacts that do not slide."""


@dataclass(frozen=True)
class Mode:
    """The mode of a run: `states` has the state of each contact, such as "open" or "sliding".

    `ways` has the direction of each contact that slides along a line, 1 or -1. `kept` are the indices of independent
    constraints, or None if all constraints are independent. `bouncing` are the contacts that count as closed while
    their impacts accumulate. `slowest` is the slip in a plane up to which a contact counts as sticking. If `still`,
    nothing can move: contacts that would slide by their forces are at rest.
    """

    states: tuple[str, ...]
    ways: tuple[Way, ...]
    kept: tuple[int, ...] | None = None
    bouncing: tuple[int, ...] = ()
    slowest: float = 0.0
    still: bool = False

    @property
    def closed(self) -> list[int]:
        """The indices of the contacts that are not open."""
        return [i for i, state in enumerate(self.states) if state != OPEN]

    @property
    def labels(self) -> tuple[str, ...]:
        """The state of each contact as results report it.

        It is that of the mode, with two exceptions: "sticking" instead of "sliding" if `still`, and "open" for
        contacts in `bouncing`.
        """
        states = (STICKING if self.still and state == SLIDING else state for state in self.states)
        return tuple(OPEN if i in self.bouncing else state for i, state in enumerate(states))

    def going(self, which: int, way: int) -> Mode:
        """Return this mode, but with contact `which` sliding in direction `way`, 1 or -1, or sticking if `way` is 0."""
        states, ways = list(self.states), list(self.ways)
        states[which], ways[which] = SLIDING if way else STICKING, way or None
        return replace(self, states=tuple(states), ways=tuple(ways))


@dataclass(frozen=True, eq=False)
class PreparedMode:
    """A compiled mode: its `model`, and its `events`.

    The user's events come first. The events that end the mode follow; for each of them `ends` has the index of its
    contact and its kind. With `friction`, the events between sliding and sticking come last: they are handled inside
    the loop over steps.
    """

    model: Model
    events: tuple[Event, ...]
    ends: tuple[tuple[int, str], ...]
    friction: WrittenFriction | None

    @property
    def mode_events(self) -> slice:
        """Indices of the events that end the mode, among all events of its runs."""
        last = len(self.events) - (0 if self.friction is None else len(self.friction.events))
        return slice(last - len(self.ends), last)

    def plain(self, y: FloatArray) -> FloatArray:
        """Return states (2n,) or (2n, N) of the system from those of the mode's model, which may be longer."""
        return y if self.friction is None else self.friction.plain(y)

    def plain_run(self, part: Trajectory) -> Trajectory:
        """Return a run of the system from a run of the mode's model."""
        return part if self.friction is None else self.friction.plain_run(part)

    @cached_property
    def zeros(self) -> Kernel:
        """A function of time and state that evaluates the expressions of the events that end the mode, (k,)."""
        events = self.events[self.mode_events]
        return quick_function(
            self.model,
            "ends",
            tuple(node_of(event.expression, self.model.statement, self.model.equations) for event in events),
        )


class Modes:
    """The modes of a model with contacts, each compiled at its first use."""

    def __init__(self, model: Model) -> None:
        self.model, self.contacts = model, model.statement.contacts
        self._models: dict[Mode, Model] = {}
        self._frictions: dict[int, WrittenFriction | None] = {}
        self._prepared: dict[tuple[Any, ...], PreparedMode] = {}

    @cached_property
    def written(self) -> WrittenImpacts | None:
        """The impacts as resets by formulas, for the mode with only open contacts; None without formulas."""
        return written_impacts(self.model)

    def friction(self, mode: Mode) -> WrittenFriction | None:
        """Return the friction of the only closed contact of a mode as a model with events, or None if not possible."""
        closed = mode.closed
        if len(closed) != 1 or mode.states[closed[0]] == CLOSED or mode.bouncing or mode.kept is not None:
            return None
        which = closed[0]
        if which not in self._frictions:
            self._frictions[which] = written_friction(self.model, which)
        return self._frictions[which]

    def prepared(
        self, mode: Mode, problem: Problem, written: WrittenImpacts | None, friction: WrittenFriction | None, most: int
    ) -> PreparedMode:
        """Return `mode` compiled, for a problem that continues in it.

        The user's events come before those of the mode. `written` has formulas of the impacts, or is None. With it
        impacts are resets inside the loop over steps, up to `most` impacts of a contact. With `friction`, changes
        between sliding and sticking are resets inside this loop, too.
        """
        plain = mode if friction is None else mode.going(friction.which, 0)
        key = replace(plain, bouncing=()), friction, problem.events, 0 if written is None else most
        if key not in self._prepared:
            model = self.model_of(mode) if friction is None else friction.model
            if len(self._prepared) > EVENTS_KEPT * (1 + len(self._models)):
                self._prepared.clear()
            mode_events, ends = _ends(self.contacts, mode)
            absent = {contact.normal: sympy.S.Zero for i, contact in enumerate(self.contacts) if mode.states[i] == OPEN}
            if written is not None:
                mode_events = tuple(
                    event if reset is None else replace(event, terminal=most, reset=reset)
                    for event, reset in zip(mode_events, written.resets, strict=True)
                )
            if friction is not None:
                absent[self.contacts[friction.which].normal] = friction.normal
                pairs = [(_present(event, absent), end) for event, end in zip(mode_events, ends, strict=True)]
                # If the normal force is constant, it never ends the mode.
                pairs = [pair for pair in pairs if pair[1][1] in (RELEASE, GAP) and pair[0].expression.has(time)]
                mode_events = (*(event for event, _ in pairs), *friction.events)
                ends = tuple(end for _, end in pairs)
            stated = tuple(_present(event, absent) for event in problem.events)
            self._prepared[key] = PreparedMode(model, (*stated, *mode_events), ends, friction)
        return self._prepared[key]

    def without_time(self, expressions: Iterable[Any]) -> bool:
        """Return True if expressions depend on time through coordinates and velocities only."""
        stated = self.model.statement
        rates, positions = ({x: sympy.Dummy() for x in symbols} for symbols in (stated.velocities, stated.coordinates))
        return not any(expression.xreplace(rates).xreplace(positions).has(time) for expression in expressions)

    def leaves_no_freedom(self, mode: Mode) -> bool:
        """Return True if the constraints of a mode allow no motion, so that all bodies stay at rest forever.

        The accelerations that an integrator would follow are then only rounding errors.
        """
        count = self.constraint_count(mode) if mode.kept is None else len(mode.kept)
        if count < self.model.dimension:
            return False
        return self._holds_rest[-1] and all(
            rests for rests, state in zip(self._holds_rest, mode.states, strict=False) if state == STICKING
        )

    @cached_property
    def _holds_rest(self) -> list[bool]:
        """For each contact, True if its slip is zero when all velocities are zero; this is false on a moving belt.

        The list has one more entry, the last. It is True if the constraints stated in velocities also hold when all
        velocities are zero. All entries are False if the system or a contact depends on time explicitly.
        """
        stated = self.model.statement
        relations = (constraint.expression for constraint in stated.constraints)
        surfaces = (part for contact in self.contacts for part in (contact.gap, *contact.slip))
        if not self.without_time((stated.lagrangian, stated.dissipation, *stated.forces, *relations, *surfaces)):
            return [False] * (len(self.contacts) + 1)
        at_rest = dict.fromkeys(stated.velocities, sympy.S.Zero)
        rates = [
            *(contact.slip for contact in self.contacts),
            [c.expression for c in stated.constraints if not c.holonomic],
        ]
        return [all(sympy.expand(rate.xreplace(at_rest)).is_zero for rate in group) for group in rates]

    def constraint_count(self, mode: Mode) -> int:
        """Return the number of constraints of a mode: stated ones, and those of closed contacts."""
        pairs = zip(self.contacts, mode.states, strict=True)
        counts = [1 + (state == STICKING) * len(contact.slip) for contact, state in pairs if state != OPEN]
        return len(self.model.statement.constraints) + sum(counts)

    def model_of(self, mode: Mode) -> Model:
        """Return the compiled model of a mode."""
        plain = replace(mode, bouncing=(), slowest=0.0, still=False)
        if plain not in self._models:
            stated = mode_statement(self.model.statement, mode)
            self._models[plain] = self.model.on_same_machine(stated, mode.kept)
        return self._models[plain]


@lru_cache(maxsize=MODELS_KEPT)
def modes_of(model: Model) -> Modes:
    """Return the modes of a model, cached in the model."""
    return Modes(model)


def mode_statement(statement: Statement, mode: Mode) -> Statement:
    """Return the statement of a mode, without contacts: closed gaps are constraints, and friction is a force.

    For a contact that sticks, its slips are constraints on velocities. A contact that slides has the force
    -mu lambda dslip/dv against its slip, with the multiplier lambda of its gap.
    """
    constraints, forces = list(statement.constraints), list(statement.forces)
    for contact, state, way in zip(statement.contacts, mode.states, mode.ways, strict=True):
        if state == OPEN:
            continue
        constraints.append(Constraint(contact.name, contact.gap, holonomic=True))
        if state == STICKING:
            slips = zip(contact.slip_names, contact.slip, strict=True)
            constraints += [Constraint(name, slip, holonomic=False) for name, slip in slips]
        if state == SLIDING:
            pushes = sliding_friction(contact, way)
            for i, q in enumerate(statement.coordinates):
                rate = velocity_of(q)
                slopes = [push * slip.diff(rate) for push, slip in zip(pushes, contact.slip, strict=True)]
                forces[i] = sympy.Add(forces[i], *slopes)
    return replace(
        statement,
        constraints=tuple(constraints),
        forces=tuple(forces),
        redundant=ALLOW if mode.kept is not None else statement.redundant,
        contacts=(),
    )


def sliding_friction(contact: Contact, way: Way) -> list[Any]:
    """Return the friction forces of a sliding contact, one for each slip component.

    `way` is the direction of sliding along a line, 1 or -1. In a plane it is not used.
    """
    size = contact.friction[1] * contact.normal
    if len(contact.slip) == 1:
        return [-size * way]
    return [-size * slip / _speed(contact) for slip in contact.slip]


def _speed(contact: Contact) -> Any:
    return sympy.sqrt(sympy.Add(*(slip**2 for slip in contact.slip)))


def _ends(contacts: Sequence[Contact], mode: Mode) -> tuple[tuple[Event, ...], tuple[tuple[int, str], ...]]:
    """Return the events that end a mode, and for each event the index of its contact and its kind.

    The kinds are a gap that closes, a contact that is released, a slip that stops, and a friction force that leaves
    its cone.
    """
    zeros: list[Any] = []
    ends = []
    for i, (contact, state, way) in enumerate(zip(contacts, mode.states, mode.ways, strict=True)):
        if state == OPEN:
            zeros.append(contact.gap)
            ends.append((i, GAP))
            continue
        zeros.append(contact.normal)
        ends.append((i, RELEASE))
        if state == SLIDING:
            zeros.append(contact.slip[0] * way if len(contact.slip) == 1 else _speed(contact) - mode.slowest)
            ends.append((i, SLIP))
        if state == STICKING:
            slip_forces = [multiplier(name) ** 2 for name in contact.slip_names]
            zeros.append(contact.friction[0] ** 2 * contact.normal**2 - sympy.Add(*slip_forces))
            ends.append((i, CONE))
    return tuple(Event(zero, direction=-1, terminal=1) for zero in zeros), tuple(ends)


def _present(event: Event, absent: dict[Any, Any]) -> Event:
    """Return an event in whose expression the normal forces of open contacts are replaced by zero.

    `absent` maps symbols of such forces to zero. If the expression is then constant, the result is an event that
    never occurs.
    """
    zero = event.expression.xreplace(absent)
    if zero == event.expression:
        return event
    return replace(event, expression=zero if zero.free_symbols else sympy.S.One)
