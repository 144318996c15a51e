"""Constraints as stated: named expressions that are zero along the motion, with or without velocities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import sympy
from sympy.core.relational import Relational
from sympy.logic.boolalg import BooleanAtom

from lagrange.errors import StatementError, formula, shown
from lagrange.statement.coordinate import check_name
from lagrange.statement.expression import TEXTS, entries, expression
from lagrange.statement.multiplier import multiplier
from lagrange.statement.survey import Survey


@dataclass(frozen=True)
class Constraint:
    """An expression that is zero along the motion; `holonomic` if it is free of velocities."""

    name: str
    expression: Any
    holonomic: bool

    @property
    def multiplier(self) -> Any:
        """Symbol of its multiplier."""
        return multiplier(self.name)


def declare_constraints(given: Any, survey: Survey) -> tuple[Constraint, ...]:
    """Return the constraints of a list, or of a dict by name, and add their symbols and functions to the survey.

    In a list they are named constraint_1, constraint_2, ... Raises StatementError for an entry that is not an
    equation or an expression, or that contains no coordinate.
    """
    constraints: dict[str, Constraint] = {}
    for name, stated in _named(given):
        what = f"constraint {name!r}"
        zero = _zero(stated, what)
        leaves = Survey()
        leaves.add(zero, what)
        survey.add(zero, what)
        if not leaves.coordinates:
            raise StatementError(_without_coordinates(what, zero))
        constraints[name] = Constraint(name, zero, not leaves.velocities)
    return tuple(constraints.values())


def _named(given: Any) -> Iterator[tuple[str, Any]]:
    """Yield each constraint with its name."""
    if isinstance(given, Mapping):
        for name, stated in given.items():
            yield check_name(name, "constraint"), stated
        return
    listed = entries(given, "constraints")
    if listed is None:
        raise StatementError(
            f"constraints is {shown(given)}: give a list such as [x**2 + y**2 - l**2], or a dict such as "
            "{'rod': x**2 + y**2 - l**2}."
        )
    for i, stated in enumerate(listed, 1):
        yield f"constraint_{i}", stated


def _zero(stated: Any, what: str) -> Any:
    """Return the expression that is zero: the expression itself, or left minus right side of an equation."""
    if isinstance(stated, sympy.Eq):
        return expression(stated.lhs, f"the left side of {what}") - expression(stated.rhs, f"the right side of {what}")
    if isinstance(stated, (BooleanAtom, bool)):
        verdict = "always true: it constrains nothing. Leave it out" if stated else "never true: no motion satisfies it"
        raise StatementError(f"{what} is {verdict}. Where == was meant, write sympy.Eq(left, right).")
    if isinstance(stated, Relational):
        raise StatementError(
            f"{what} is {shown(str(stated))}, an inequality. Constraints are equations: state the equation that holds, "
            "and end the run by an event where the multiplier changes sign, lg.multiplier(name)."
        )
    if isinstance(stated, TEXTS):
        raise StatementError(f"{what} is the text {shown(stated, 60)}: give a SymPy expression that is zero, or an Eq.")
    return expression(stated, what)


def _without_coordinates(what: str, zero: Any) -> str:
    """Return the message for a constraint that contains no coordinate and no velocity."""
    if zero.is_zero:
        return f"{what} is 0 = 0, which always holds: leave it out."
    if zero.is_number:
        return f"{what} is {formula(zero, 60)} = 0, which never holds: no motion satisfies it."
    return (
        f"{what} contains no coordinate and no velocity ({formula(zero, 60)} = 0): a constraint relates coordinates or "
        "velocities. A relation of parameters belongs into the values of parameters."
    )
