"""Declare the events of a run: expressions whose zeros are located, and which may end the run or reset the state."""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.errors import StatementError, formula, listing, shown, with_type
from lagrange.statement.coordinate import check_multipliers, t
from lagrange.statement.declare import state_rows
from lagrange.statement.expression import entries, expression, real_number
from lagrange.statement.parameters import Survey, in_own_parameters, label_of
from lagrange.statement.rotation import reset_of_coordinates
from lagrange.statement.statement import Statement
from lagrange.statement.units.dimension_check import check_event_dimensions

MOST_OCCURRENCES = 2**31  # Largest `terminal` of an event, far more occurrences than a run stores


@dataclass(frozen=True, eq=False, repr=False)
class Event:
    """Event of a run: a zero of an expression in coordinates, velocities, accelerations, multipliers, parameters and t.

    `direction` is 1 for zeros at which the expression rises in the direction of the run, and -1 for zeros at which it
    falls. With 0 all zeros count, also touches, which are zeros without change of sign. The run ends at occurrence
    number `terminal`, or never if `terminal` is 0. `reset` maps coordinates and velocities to expressions of the state
    before the event. `settings` does the same for parameters. A user gives both tables as one, in `reset`.
    """

    expression: Any
    direction: int = 0
    terminal: int = 0
    reset: Mapping[Any, Any] = field(default_factory=dict)
    settings: Mapping[Any, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        terminal = self.terminal
        if not isinstance(terminal, (numbers.Integral, bool, np.bool_)) or not 0 <= terminal <= MOST_OCCURRENCES:
            raise StatementError(
                f"terminal = {shown(terminal)}: give True, or the number of the occurrence that ends the run."
            )
        values: dict[str, Any] = {}
        for name, table in (("reset", self.reset), ("settings", self.settings)):
            if not isinstance(table, Mapping):
                raise StatementError(
                    f"{name} is {shown(table, 80)}: give a dict from coordinates, velocities and parameters to "
                    "expressions, such as {y.dot: -0.9*y.dot}."
                )
            in_coordinates = reset_of_coordinates(table)
            values[name] = MappingProxyType({key: _value(value) for key, value in in_coordinates.items()})
        for name, value in (
            ("expression", _zero(self.expression)),
            ("direction", _sign(self.direction)),
            ("terminal", int(terminal)),
            *values.items(),
        ):
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        stated = (("reset", self.reset), ("settings", self.settings))
        tables = "".join(f", {name}={shown(dict(table))}" for name, table in stated if table)
        return f"<Event: {shown(self.expression)} = 0, direction={self.direction}, terminal={self.terminal}{tables}>"


def event(
    expression: Any, *, direction: float = 0, terminal: bool | int = False, reset: Mapping[Any, Any] | None = None
) -> Event:
    """Return an event for `events=[...]` of a run.

    `expression` is a SymPy expression or equation in coordinates, velocities, accelerations such as x.ddot, the
    multipliers of constraints, parameters and t. The event is where it becomes zero. `direction` is positive for rising
    zeros only, negative for falling zeros only, as in SciPy's solve_ivp. With `terminal=True` the run ends at the
    event, with a whole number k at its k-th occurrence. `reset` maps coordinates, velocities and parameters, or their
    names, to expressions of the state before the event, such as {y.dot: -0.9*y.dot} for an impact, or {k: 0} for a
    spring that breaks. Quantities without an entry keep their values. A rotation R and its rates may be keys, as in
    {R.body: -0.8*R.body}.

    Raises StatementError for an expression, a direction, a `terminal` or a reset of the wrong type.
    """
    return Event(expression, _sign(direction), terminal, {} if reset is None else reset)


def _sign(direction: float) -> int:
    number = direction if type(direction) is int else real_number(direction, "direction")
    return (number > 0) - (number < 0)


def _zero(argument: Any) -> Any:
    """Return the expression whose zero is the event: `argument` itself, or left minus right side of an equation."""
    if isinstance(argument, sympy.Eq):
        return expression(argument.lhs, "the left side of the event") - expression(
            argument.rhs, "the right side of the event"
        )
    if not isinstance(argument, sympy.Expr) or argument.is_Matrix:
        raise StatementError(f"the event is {_instead_of(argument)}")
    return expression(argument, "the event")


def _instead_of(argument: Any) -> str:
    """Return the end of the message for an `argument` that is not an event: its text, its type, and the remedy."""
    written = formula(argument, 80) if isinstance(argument, (str, sympy.Basic)) else shown(argument)
    match argument:
        case str() | bytes():
            return f"{written!r}, a text: give the symbol or the expression itself, such as theta or theta.dot - 1."
        case bool() | np.bool_() | sympy.logic.boolalg.BooleanAtom():
            return f"{written}, which Python makes of a comparison such as theta.dot == 0: give theta.dot alone."
        case sympy.core.relational.Relational():
            zero = formula(sympy.Add(argument.lhs, sympy.Mul(-1, argument.rhs)), 80)
            return (
                f"{written!r}, a relation: give the difference of its sides, {zero}, whose zero is the event, and "
                "direction=1 if it rises there, or -1 if it falls."
            )
        case numbers.Number() | np.ndarray():
            return (
                f"{written}, a number, which is constant along a run: give an expression in coordinates or velocities."
            )
    hidden = " A Python function hides its formula, and its roots could be missed." if callable(argument) else ""
    return f"{written!r}: give a SymPy expression whose zero is the event, such as theta - 1.{hidden}"


def _value(value: Any) -> Any:
    """Return a number or an expression in a reset as a SymPy expression. Raises StatementError for other types."""
    if isinstance(value, sympy.Expr):
        return expression(value, "the value of a reset")
    if isinstance(value, (numbers.Number, np.ndarray)):
        return sympy.Float(real_number(value, "the value of a reset"))
    raise StatementError(
        f"the value of a reset is {with_type(value)}: give an expression of the state "
        "before, such as -0.9*y.dot, or a number."
    )


def declare_events(events: Any, statement: Statement, *, constant: str = "") -> tuple[Event, ...]:
    """Return the user's `events` of a run as a tuple of events that are checked against a statement.

    A bare expression is an event in both directions. If `constant` is not empty, events must not set parameters. The
    text `constant`, such as "a section", then names in the message what has constant parameters.
    """
    # Usually there are no events. This case returns first, because the checks of types below take longer.
    if events is None or (isinstance(events, tuple) and not events):
        return ()
    alone = (Event, sympy.Basic, str, bytes, numbers.Number, np.bool_)
    if isinstance(events, alone) or callable(events):
        events = [events]
    listed = entries(events, "events")
    if listed is None:
        raise StatementError(f"events is {shown(events)}: give a list of expressions, or of lg.event(...).")
    checked = tuple(_declared(entry, statement) for entry in listed)
    for index, e in enumerate(checked):
        survey = _check(e.expression, f"event {index}", statement, motion=True)
        if not survey.coordinates and not survey.multipliers and not e.expression.has(t):
            raise StatementError(
                f"event {index} is {formula(e.expression, 80)}, which is constant along a run: give an expression "
                "in coordinates, velocities and t that becomes zero on the way."
            )
        _check_resets(index, e, statement)
        if constant and e.settings:
            name = next(iter(e.settings)).name
            raise StatementError(
                f"the reset of event {index} sets the parameter {name}, and {constant} has constant parameters: leave "
                f"{name} out of the reset, or call system.run(), whose events set parameters."
            )
    return checked


def _check_resets(index: int, e: Event, statement: Statement) -> None:
    """Raise StatementError if the reset of the event `e`, number `index` in the list, is not valid.

    It must not name an unknown quantity, or one quantity twice. New values must not contain symbols that are not in the
    statement, and their dimensions must be right.
    """
    rows = state_rows(statement.coordinates)
    if len({rows[key] for key in e.reset if key in rows}) < sum(key in rows for key in e.reset):
        raise StatementError(f"the reset of event {index} names the same coordinate or velocity twice.")
    for key in e.reset:
        if key not in rows:
            known = [label for label in rows if isinstance(label, str)]
            raise StatementError(
                f"the reset of event {index} names {formula(key, 80)!r}, which is not a coordinate or velocity of "
                f"this system; they are {listing(known)}, and its parameters are "
                f"{listing(p.name for p in statement.parameters) or 'none'}."
            )
    symbols = (*statement.coordinates, *statement.velocities)
    resets = [*((symbols[rows[key]], value) for key, value in e.reset.items()), *e.settings.items()]
    for _, value in resets:
        _check(value, f"the reset of event {index}", statement)
    if statement.dimensions:
        check_event_dimensions(index, e.expression, tuple(resets), statement)


def _declared(entry: Any, statement: Statement) -> Event:
    """Return `entry` of a list of events as an event in the symbols of the statement.

    The gaps of contacts replace their symbols, and the statement's parameters replace other symbols of the same names.
    A bare expression is an event in both directions.
    """
    if not isinstance(entry, Event):
        entry = _kept(entry) if isinstance(entry, sympy.Expr) else event(entry)
    zero = entry.expression.xreplace(statement.gaps) if statement.contacts else entry.expression
    return _in_own_parameters(
        entry if zero == entry.expression else replace(entry, expression=zero), statement.parameters
    )


_kept = lru_cache(maxsize=256)(event)
"""Return the event of a bare expression. Equal expressions give the same object, because other caches have events as
keys."""


@lru_cache(maxsize=256)
def _in_own_parameters(e: Event, parameters: tuple[Any, ...]) -> Event:
    """Return the event `e` with the system's `parameters` in place of other symbols of the same names.

    Entries of its reset that set parameters move to `settings`. The result is cached: the same event gives the same
    object, which can be the key of other caches.
    """
    by_name = {p.name: p for p in parameters}
    zero = in_own_parameters(e.expression, parameters)
    values = {key: in_own_parameters(value, parameters) for key, value in e.reset.items()}
    settings = {key: value for key, value in values.items() if label_of(key) in by_name}
    if len({label_of(key) for key in settings}) < len(settings):
        raise StatementError(f"a reset names the parameter {label_of(next(iter(settings)))} twice.")
    reset = {key: value for key, value in values.items() if key not in settings}
    if zero == e.expression and reset == e.reset:
        return e
    own_settings = {by_name[label_of(key)]: value for key, value in settings.items()}
    return Event(zero, e.direction, e.terminal, reset, {**e.settings, **own_settings})


@lru_cache(maxsize=256)
def _surveyed(expression: Any, what: str, *, motion: bool) -> Survey:
    """Return the coordinates, parameters and functions in an expression. Cached for runs with the same events.

    `what` is the name of the expression in messages. If `motion` is true, the expression may contain accelerations and
    multipliers.
    """
    return Survey().add(expression, what, accelerations=motion, multipliers=motion)


def _check(expression: Any, what: str, statement: Statement, *, motion: bool = False) -> Survey:
    """Return the coordinates, parameters and functions in an expression.

    Raises StatementError if one is not the statement's. `what` is the name of the expression in messages. If `motion`
    is true, it may contain accelerations and multipliers.
    """
    survey = _surveyed(expression, what, motion=motion)
    declared = (*statement.coordinates, *statement.given, *statement.parameters)
    allowed = listing(["its coordinates", "their velocities", "t", *(p.name for p in statement.parameters)])
    survey.require(declared, what, f"; it may contain {allowed}.")
    check_multipliers(survey.multipliers, what, statement.multiplier_names, statement.name)
    return survey
