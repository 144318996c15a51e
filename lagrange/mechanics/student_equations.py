"""Equations of motion that somebody else derived, as text or SymPy, in the symbols of a statement."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.errors import SceneError, StatementError, listing, suggestion
from lagrange.statement.choice import text
from lagrange.statement.coordinate import name_of
from lagrange.statement.expression import TEXTS, entries, expression
from lagrange.statement.letters import WORD
from lagrange.statement.multiplier import constraint_of
from lagrange.statement.parameters import coordinate_name
from lagrange.statement.statement import Statement
from lagrange.statement.survey import Survey
from lagrange.statement.text import read_expression
from lagrange.statement.vocabulary import FUNCTIONS

LONGEST_LINE = 20_000
"""Characters of one equation; a line with more is no equation that a person wrote."""

SIGN = re.compile(r"(?<![<>=!])={1,2}(?!=)")
"""The sign between the sides of an equation, = or ==."""

MULTIPLIER = "lambda_"
"""What the name of a constraint has before it where its multiplier is meant."""

TYPED = str.maketrans("\u2212\u00b7\u22c5\u00d7", "-***")
"""Signs that a printed formula has: a minus and three of multiplication."""

NAME = re.compile(rf"(?<![\w.]){WORD.pattern}")
"""A name in the text of an equation; the e of 1e-3 is none."""

KNOWN_WORDS = frozenset((*FUNCTIONS, "t", "pi", "if", "else"))
"""The names that a text may have beside those of the system."""


@dataclass(frozen=True)
class StudentEquation:
    """What an equation says is zero, in the plain symbols of `Statement.plain`, and what it is called in messages."""

    label: str
    zero: Any
    moved: bool = False
    """Whether terms of a right side were moved to the left one."""


def read_equations(given: Any, statement: Statement) -> list[StudentEquation]:
    """Return the equations of a list, of a dict by coordinate, or of one text, expression or Eq.

    A text says what is zero, or has = or == between two sides; q_dot and q_ddot are the derivatives of q, lambda_name
    is the multiplier of a constraint. Raises StatementError, with the equation's place, for what cannot be read.
    """
    reader = _EquationReader(statement)
    if isinstance(given, Mapping):
        listed = [(f"the {coordinate_name(key, statement.names)} equation", value) for key, value in given.items()]
    else:
        single = isinstance(given, (*TEXTS, sympy.Basic)) and not isinstance(given, sympy.Tuple)
        found = None if single else entries(given, "the equations")
        listed = [(f"equation {k}", value) for k, value in enumerate([given] if found is None else found, 1)]
    if not listed:
        raise StatementError("no equation is given: give a list with one for each coordinate.")
    return [StudentEquation(label, *reader.read(value, label)) for label, value in listed]


def equations_of_text(given: str, statement: Statement) -> list[StudentEquation]:
    """Return the equations of a file, one a line; # begins a comment. A refusal has the line and the column."""
    reader = _EquationReader(statement)
    found: list[StudentEquation] = []
    for number, whole in enumerate(text(given, "the text of the equations").splitlines(), 1):
        line = whole.partition("#")[0].rstrip()
        if line.strip():
            found.append(StudentEquation(f"equation {len(found) + 1}", *reader.text(line, f"line {number}")))
    if not found:
        raise StatementError("there is no equation: write one a line, such as  theta_ddot + g/l*sin(theta) = 0.")
    return found


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

    def read(self, given: Any, what: str) -> tuple[Any, bool]:
        """Return what one equation says is zero, in plain symbols, and whether it has a right side."""
        if isinstance(given, str):
            return self.text(given, what)
        if isinstance(given, sympy.Eq):
            left, right = (self.symbols(expression(side, what), what) for side in given.args)
            return left - right, bool(right != 0)
        if isinstance(given, bool) or given in (sympy.true, sympy.false):
            raise StatementError(f"{what} is {given}: where == was meant, write sympy.Eq(left, right).")
        return self.symbols(expression(given, what), what), False

    def text(self, line: str, what: str) -> tuple[Any, bool]:
        """Return what a text says is zero, and whether it has a right side."""
        line = line.translate(TYPED)
        if len(line) > LONGEST_LINE:
            raise StatementError(f"{what} has {len(line)} characters, and {LONGEST_LINE} are the most of an equation.")
        signs = list(SIGN.finditer(line))
        if len(signs) > 1:
            raise StatementError(f"{what} has {len(signs)} signs of equality: write one equation with two sides.")
        bounds = [(0, signs[0].start()), (signs[0].end(), len(line))] if signs else [(0, len(line))]
        sides = [self.side(line, *bound, what) for bound in bounds]
        return sympy.Add(sides[0], *(-side for side in sides[1:])), any(side != 0 for side in sides[1:])

    def side(self, line: str, begin: int, end: int, what: str) -> Any:
        """Return one side of an equation. Raises SceneError with the column in the whole line."""
        self.check_names(line[begin:end], what)
        try:
            return read_expression(line[begin:end], self.names)
        except SceneError as error:
            column = None if error.column is None else error.column + begin
            place = "" if column is None else f", column {column}"
            raise StatementError(f"{what}{place}: {error.reason}") from None

    def check_names(self, text: str, what: str) -> None:
        """Refuse a name that the system does not have."""
        for found in NAME.finditer(text):
            name = found.group()
            if name not in self.names and name not in KNOWN_WORDS:
                raise StatementError(self.unknown(name, what))

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


def _given_name(leaf: Any) -> str:
    """Return the name of a given function or of its derivative: X, X_dot, X_ddot."""
    if not isinstance(leaf, sympy.Derivative):
        return name_of(leaf)
    return f"{name_of(leaf.expr)}_{'d' * len(leaf.variables)}ot"
