"""Modes of a run with contacts: the constraints and forces of closed contacts, and the events that end a mode."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import sympy

from lagrange.equations.euler_lagrange import node_of
from lagrange.machine.backend import Kernel
from lagrange.machine.kernel.python_kernel import kernel_in_python
from lagrange.machine.model import Model
from lagrange.statement.contact import Contact
from lagrange.statement.coordinate import multiplier
from lagrange.statement.coordinate import t as time
from lagrange.statement.event import Event
from lagrange.statement.statement import ALLOW, Constraint, Statement
from lagrange.trajectory.contact.impacts_as_resets import (
    WrittenFriction,
    WrittenImpacts,
    friction_margin,
    sliding_friction,
    written_friction,
)
from lagrange.trajectory.contact.kinematics import MODELS_KEPT
from lagrange.trajectory.contact.stick_or_slide import CLOSED, OPEN, SLIDING, STICKING
from lagrange.trajectory.integrator import Problem


class ModeEnd(NamedTuple):
    """The contacts (indices) whose events end a mode, by the kind of the event.

    The gap of `closing` contacts becomes zero. The normal force of `opening` contacts becomes zero, and so does the
    slip of `stopping` contacts. The friction force of `yielding` contacts, which stick, reaches the largest size that
    static friction allows.
    """

    closing: tuple[int, ...] = ()
    opening: tuple[int, ...] = ()
    stopping: tuple[int, ...] = ()
    yielding: tuple[int, ...] = ()


CLOSING, OPENING, STOPPING, YIELDING = ModeEnd._fields
"""Names of the kinds of events that end a mode. They are the fields of `ModeEnd`, which explains them."""

SLOWEST = 1e-12
"""Largest slip in a plane that counts as zero, as a fraction of the largest terms of slips so far. Near zero the
direction of a slip is not smooth. `rtol` is used if it is larger: steps pass over a slip that is smaller than their
errors, and reverse it again and again. An impulse removes a slip that counts as zero."""

EVENTS_KEPT = 8
"""Largest mean number of compiled modes in the cache for each model of a mode. A mode is compiled again for each list
of the user's events. Runs with the same list use the same compiled code."""


@dataclass(frozen=True)
class Mode:
    """The mode of a run: `states` has the state of each contact, such as "open" or "sliding".

    `ways` has the direction of each contact that slides along a line, 1 or -1. `independent` are the indices of
    independent constraints, or None if all are. `bouncing` are the contacts that count as closed while their impacts
    accumulate. `slowest` is the slip in a plane up to which a contact counts as sticking. If `immobile` is True, the
    constraints leave nothing that can move: also the contacts with the state "sliding" are at rest.
    """

    states: tuple[str, ...]
    ways: tuple[int | None, ...]
    independent: tuple[int, ...] | None = None
    bouncing: tuple[int, ...] = ()
    slowest: float = 0.0
    immobile: bool = False

    @property
    def closed(self) -> list[int]:
        """The indices of the contacts that are not open."""
        return [i for i, state in enumerate(self.states) if state != OPEN]

    @property
    def labels(self) -> tuple[str, ...]:
        """The states of the contacts that results report. They are "open" for contacts in `bouncing`.

        If `immobile` is True, "sliding" is reported as "sticking".
        """
        states = (STICKING if self.immobile and state == SLIDING else state for state in self.states)
        return tuple(OPEN if i in self.bouncing else state for i, state in enumerate(states))

    def going(self, which: int, way: int) -> Mode:
        """Return a copy of this mode: contact `which` slides in direction `way`, 1 or -1, or sticks if it is 0."""
        states, ways = list(self.states), list(self.ways)
        states[which], ways[which] = SLIDING if way else STICKING, way or None
        return replace(self, states=tuple(states), ways=tuple(ways))


@dataclass(frozen=True, eq=False)
class PreparedMode:
    """A compiled mode: its `model`, and its `events`, which begin with the events of the user.

    The events that end the mode follow, at the indices `mode_events`. `ends` has the index of the contact and the kind
    of each of these. If `friction` is given, the last events are the changes between sliding and sticking, which the
    compiled loop over steps handles.
    """

    model: Model
    events: tuple[Event, ...]
    mode_events: slice
    ends: tuple[tuple[int, str], ...]
    friction: WrittenFriction | None

    @cached_property
    def zeros(self) -> Kernel:
        """A function of time and state that evaluates the expressions of the events that end the mode, (k,)."""
        events = self.events[self.mode_events]
        nodes = (node_of(event.expression, self.model.statement, self.model.equations) for event in events)
        return kernel_in_python(self.model.function("ends", tuple(nodes)).program)


class Modes:
    """The modes of a model with contacts, each compiled at its first use."""

    def __init__(self, model: Model) -> None:
        self.model, self.contacts = model, model.statement.contacts
        self._models: dict[Mode, Model] = {}
        self._prepared: dict[tuple[Any, ...], PreparedMode] = {}

    def friction(self, mode: Mode) -> WrittenFriction | None:
        """Return a model in which events reset the only closed contact between sliding and sticking, or None.

        None means that the mode has no such contact, or that the formulas of its friction cannot be written out.
        """
        closed = mode.closed
        if len(closed) != 1 or mode.states[closed[0]] == CLOSED or mode.bouncing or mode.independent is not None:
            return None
        return written_friction(self.model, closed[0])

    def prepared(
        self, mode: Mode, problem: Problem, written: WrittenImpacts | None, friction: WrittenFriction | None, most: int
    ) -> PreparedMode:
        """Return `mode` compiled, for a problem that continues in it.

        The user's events come before the events that end the mode. `written` has formulas of the impacts, or is None.
        With it impacts are resets inside the loop over steps, up to `most` impacts of a contact. With `friction`,
        changes between sliding and sticking are resets inside this loop, too.
        """
        plain = mode if friction is None else mode.going(friction.which, 0)
        plain = replace(plain, bouncing=()) if plain.bouncing else plain
        key = plain, friction, problem.events, 0 if written is None else most
        if key not in self._prepared:
            model = self.model_of(mode) if friction is None else friction.model
            if len(self._prepared) > EVENTS_KEPT * (1 + len(self._models)):
                self._prepared.clear()
            pairs, friction_events = _ends(self.contacts, mode), () if friction is None else friction.events
            absent = {contact.normal: sympy.S.Zero for i, contact in enumerate(self.contacts) if mode.states[i] == OPEN}
            if written is not None:
                pairs = [
                    (event if reset is None else replace(event, terminal=most, reset=reset), end)
                    for (event, end), reset in zip(pairs, written.resets, strict=True)
                ]
            if friction is not None:
                absent[self.contacts[friction.which].normal] = friction.normal
                pairs = [(_present(event, absent), end) for event, end in pairs if end[1] in (OPENING, CLOSING)]
                # If the normal force is constant, it never ends the mode.
                pairs = [pair for pair in pairs if pair[0].expression.has(time)]
            stated = [_present(event, absent) for event in problem.events]
            events = (*stated, *(event for event, _ in pairs), *friction_events)
            mode_events, ends = slice(len(stated), len(stated) + len(pairs)), tuple(end for _, end in pairs)
            self._prepared[key] = PreparedMode(model, events, mode_events, ends, friction)
        return self._prepared[key]

    def is_free_of_time(self, expressions: Iterable[Any]) -> bool:
        """Return True if no expression contains the time, except as the argument of coordinates and velocities."""
        stated = self.model.statement
        rates, positions = ({x: sympy.Dummy() for x in symbols} for symbols in (stated.velocities, stated.coordinates))
        return not any(expression.xreplace(rates).xreplace(positions).has(time) for expression in expressions)

    def leaves_no_freedom(self, mode: Mode, count: int) -> bool:
        """Return True if `count` independent constraints of a mode allow no motion: all bodies stay at rest forever.

        The accelerations that an integrator would follow are then only rounding errors. The result is False if anything
        depends on time explicitly, or if a constraint on velocities does not hold at rest, as on a moving belt.
        """
        stated = self.model.statement
        if count < self.model.dimension or not self._is_timeless:
            return False
        rates = [constraint.expression for constraint in stated.constraints if not constraint.holonomic]
        sticking = (contact for contact, state in zip(self.contacts, mode.states, strict=True) if state == STICKING)
        rates += [slip for contact in sticking for slip in contact.slip]
        at_rest = dict.fromkeys(stated.velocities, sympy.S.Zero)
        return all(sympy.expand(rate.xreplace(at_rest)).is_zero for rate in rates)

    @cached_property
    def all_open(self) -> Mode:
        """The mode in which all contacts are open."""
        mode = Mode((OPEN,) * len(self.contacts), (None,) * len(self.contacts))
        return replace(mode, immobile=self.leaves_no_freedom(mode, len(self.model.statement.constraints)))

    @cached_property
    def _is_timeless(self) -> bool:
        """True if no energy, force, constraint or contact of the system depends on time explicitly."""
        stated = self.model.statement
        relations = (constraint.expression for constraint in stated.constraints)
        surfaces = (part for contact in self.contacts for part in (contact.gap, *contact.slip))
        return self.is_free_of_time((stated.lagrangian, stated.dissipation, *stated.forces, *relations, *surfaces))

    def model_of(self, mode: Mode) -> Model:
        """Return the model of a mode, in which closed contacts are constraints and friction forces. It is cached."""
        plain = replace(mode, bouncing=(), slowest=0.0, immobile=False)
        if plain not in self._models:
            stated = mode_statement(self.model.statement, mode)
            self._models[plain] = self.model.on_same_machine(stated, mode.independent)
        return self._models[plain]


modes_of = lru_cache(maxsize=MODELS_KEPT)(Modes)
"""Function that returns the `Modes` of a model with contacts. The modes of the last models are cached."""


def mode_statement(statement: Statement, mode: Mode) -> Statement:
    """Return the statement of a mode, without contacts: closed gaps are constraints, and friction is a force.

    For a contact that sticks, its slips are constraints on velocities. A contact that slides has the force -mu lambda
    dslip/dv against its slip, with the multiplier lambda of its gap.
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
            pushes = list(zip(sliding_friction(contact, way), contact.slip, strict=True))
            for i, rate in enumerate(statement.velocities):
                forces[i] = sympy.Add(forces[i], *(push * slip.diff(rate) for push, slip in pushes))
    return replace(
        statement,
        constraints=tuple(constraints),
        forces=tuple(forces),
        redundant=ALLOW if mode.independent is not None else statement.redundant,
        contacts=(),
    )


def _ends(contacts: Sequence[Contact], mode: Mode) -> list[tuple[Event, tuple[int, str]]]:
    """Return the events that end a mode, each with the index of its contact and its kind."""
    zeros = list[tuple[Any, int, str]]()
    for i, (contact, state, way) in enumerate(zip(contacts, mode.states, mode.ways, strict=True)):
        zeros.append((contact.gap, i, CLOSING) if state == OPEN else (contact.normal, i, OPENING))
        if state == SLIDING:
            plane = len(contact.slip) > 1
            zeros.append((contact.slip_speed - mode.slowest if plane else contact.slip[0] * way, i, STOPPING))
        if state == STICKING:
            zeros.append((friction_margin(contact, map(multiplier, contact.slip_names)), i, YIELDING))
    return [(Event(zero, direction=-1, terminal=1), (i, kind)) for zero, i, kind in zeros]


def _present(event: Event, absent: dict[Any, Any]) -> Event:
    """Return an event in whose expression some normal forces are replaced, those of open contacts by zero.

    `absent` maps the symbols of these forces to their values. If the expression becomes constant, the event never
    occurs.
    """
    zero = event.expression.xreplace(absent)
    if zero == event.expression:
        return event
    return replace(event, expression=zero if zero.free_symbols else sympy.S.One)
