"""Equations of motion that somebody else derived, as text or SymPy, in the symbols of a statement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import sympy

from lagrange.errors import StatementError, listing, suggestion
from lagrange.statement.coordinate import name_of
from lagrange.statement.expression import TEXTS, entries, expression
from lagrange.statement.multiplier import constraint_of
from lagrange.statement.parameters import coordinate_name
from lagrange.statement.statement import Statement
from lagrange.statement.survey import Survey
from lagrange.statement.typed.reader import TypedEquation, TypedReader

MULTIPLIER = "lambda_"
"""What the name of a constraint has before it where its multiplier is meant."""

FORCES = ("T", "N", "S")
"""Letters of a force of a constraint: the multiplier, or each of them with its number, where no symbol has the name."""


@dataclass(frozen=True)
class StudentEquation:
    """An equation of motion: what it says is zero, in the plain symbols of `Statement.plain`.

    `label` names it in messages. `right` is its right side. `read` is the equation as it was understood. `others` are
    further readings of a text that can be understood in several ways.
    """

    label: str
    zero: Any
    right: Any = sympy.S.Zero
    read: str = ""
    others: tuple[StudentEquation, ...] = ()


def read_equations(given: Any, statement: Statement) -> list[StudentEquation]:
    """Return the equations of a list, of a dict by coordinate, or of one text, expression or Eq.

    A text says what is zero, or has = or == between two sides; q_dot and q_ddot are the derivatives of q, lambda_name
    is the multiplier of a constraint. Raises StatementError, with the equation's place, for what cannot be read.
    """
    reader = _EquationReader(statement)
    if isinstance(given, str):
        return reader.text(given)
    if isinstance(given, Mapping):
        listed = [(f"the {coordinate_name(key, statement.names)} equation", value) for key, value in given.items()]
    else:
        single = isinstance(given, (*TEXTS, sympy.Basic)) and not isinstance(given, sympy.Tuple)
        parts = None if single else entries(given, "the equations")
        listed = [(f"equation {k}", value) for k, value in enumerate([given] if parts is None else parts, 1)]
    if not listed:
        raise StatementError("no equation is given: give a list with one for each coordinate.")
    return [reader.read(value, label) for label, value in listed]


def spelled(expression: Any) -> str:
    """Return an expression in plain symbols as the text of an equation spells it."""
    named = {symbol: constraint_of(symbol) for symbol in expression.free_symbols}
    multipliers = {symbol: sympy.Symbol(f"{MULTIPLIER}{name}") for symbol, name in named.items() if name is not None}
    return str(sympy.sstr(expression.xreplace(multipliers)))


class _EquationReader:
    """Reads equations in the symbols of one statement."""

    def __init__(self, statement: Statement) -> None:
        self.statement = statement
        self.plain = dict(statement.plain)
        self.names = {symbol.name: symbol for symbol in self.plain.values()}
        self.names |= {p.name: p for p in statement.parameters}
        self.given = dict(statement.prescribed)
        self.names |= {_given_name(leaf): value for leaf, value in self.given.items()}
        multipliers = {f"{MULTIPLIER}{one.name}": one.multiplier for one in statement.constraints}
        self.names = multipliers | self.names
        held = [one.name for one in statement.constraints]
        letters = [letter for letter in FORCES if letter not in self.names]
        spellings = {f"{one}{k}": name for k, name in enumerate(multipliers, 1) for one in ("lambda", *letters)}
        if len(held) == 1:
            spellings |= dict.fromkeys(("lambda", "lam", *letters), next(iter(multipliers)))
        self.typed = TypedReader(self.names, spellings)

    def text(self, given: str) -> list[StudentEquation]:
        """Return the equations of a text, which may have several lines."""
        equations = [one for one in self.typed.equations(given) if not self._is_kinetic_energy(one)]
        if not equations:
            raise StatementError("there is no equation: write one a line, such as  theta_ddot + g/l*sin(theta) = 0.")
        return [_equation(f"equation {k}", one) for k, one in enumerate(equations, 1)]

    def _is_kinetic_energy(self, equation: TypedEquation) -> bool:
        """Return whether an equation says what T is, where T may be the force of a constraint."""
        if not self.statement.constraints or not equation.readings[0].read.startswith(MULTIPLIER):
            return False
        return bool(sympy.expand(equation.readings[0].right - self.statement.kinetic.xreplace(self.plain)) == 0)

    def read(self, given: Any, what: str) -> StudentEquation:
        """Return one equation: a text, an expression that is zero, or an Eq."""
        if isinstance(given, str):
            equations = self.typed.equations(given, what)
            if len(equations) != 1:
                raise StatementError(f"{what} is a text with {len(equations)} equations: give one in each entry.")
            return _equation(what, equations[0])
        if isinstance(given, sympy.Eq):
            left, right = (self.symbols(expression(side, what), what) for side in given.args)
            return StudentEquation(what, left - right, right, f"{spelled(left)} = {spelled(right)}")
        if isinstance(given, bool) or given in (sympy.true, sympy.false):
            raise StatementError(f"{what} is {given}: where == was meant, write sympy.Eq(left, right).")
        zero = self.symbols(expression(given, what), what)
        return StudentEquation(what, zero, read=f"{spelled(zero)} = 0")

    def unknown(self, name: str, what: str) -> str:
        """Return the refusal of a name."""
        return (
            f"{what} contains {name[:60]!r}, which this system does not have; its symbols are {listing(self.names)}."
            + suggestion(name, list(self.names))
        )

    def symbols(self, stated: Any, what: str) -> Any:
        """Return SymPy's expression in the symbols of the statement: parameters are the same by their names."""
        survey = Survey()
        survey.add(stated, what, accelerations=True, multipliers=True)
        table: dict[Any, Any] = {}
        for q in survey.coordinates:
            if q not in self.plain:
                coordinate_name(name_of(q), self.statement.names)
        for symbol in survey.parameters:
            if symbol.name not in self.names:
                raise StatementError(self.unknown(symbol.name, what))
            table[symbol] = self.names[symbol.name]
        known = [one.name for one in self.statement.constraints]
        for name in survey.multipliers:
            if name not in known:
                raise StatementError(
                    f"{what} contains the multiplier of {name!r}, which is no constraint here; the constraints are "
                    f"{listing(known)}."
                )
        for function in survey.given:
            if function not in self.given:
                raise StatementError(self.unknown(name_of(function), what))
        return stated.xreplace(self.given).xreplace(self.plain | table)


def _equation(label: str, typed: TypedEquation) -> StudentEquation:
    """Return a typed equation with its other readings."""
    first, *others = (StudentEquation(label, one.zero, one.right, one.read) for one in typed.readings)
    return replace(first, others=tuple(others))


def _given_name(leaf: Any) -> str:
    """Return the name of a given function or of its derivative: X, X_dot, X_ddot."""
    if not isinstance(leaf, sympy.Derivative):
        return name_of(leaf)
    return f"{name_of(leaf.expr)}_{'d' * len(leaf.variables)}ot"
