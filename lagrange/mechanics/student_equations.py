"""Equations of motion that somebody else derived: read in the symbols of a statement, and taken apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy

from lagrange.errors import StatementError, listing, suggestion
from lagrange.evidence.precise import OutsideDomain, Precise
from lagrange.evidence.sample import Point
from lagrange.mechanics.agreement import vanishes_in_symbols as vanishes
from lagrange.mechanics.motion_samples import MotionSample
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


DIGITS = 40
"""Digits of the values; the motion is known to some 30 of them."""

ZERO = 1e-12
"""An acceleration counts as zero below this part of the largest one, or of 1."""

HELD = 1e-14
"""Residual, relative to the terms, up to which an equation holds: numbers in it may be results of some 50 operations on
doubles. A term of another size would have to be smaller than that at every state."""


@dataclass(frozen=True, eq=False)
class EquationRow:
    """zero = sum of slopes[z] * z over the unknowns z, plus rest; all in the plain symbols of the statement.

    `right` is the right side as it was typed, whose terms have the other sign in `zero`.
    """

    statement: Statement
    label: str
    zero: Any
    slopes: Mapping[Any, Any]
    rest: Any
    right: Any = sympy.S.Zero

    @cached_property
    def _tape(self) -> Precise:
        return tape([*self.slopes.values(), self.rest, *self._parts], self.statement)

    @property
    def _parts(self) -> tuple[Any, ...]:
        """The terms of an equation without accelerations, such as a constraint: rounding is relative to their sizes."""
        return () if any(self.slopes.values()) else sympy.Add.make_args(self.rest)

    @property
    def switches(self) -> tuple[Any, ...]:
        """The conditions, Abs, sign, Min and Max in the equation, in the user's symbols."""
        return self._tape.switches

    def ways(self, point: Point) -> tuple[int | None, ...]:
        """Return the outcome of each switch at a point. Raises OutsideDomain."""
        return self._tape.inspect(point.q, point.v, point.t, point.parameters).outcomes

    def with_symbols(self, table: Mapping[Any, Any]) -> EquationRow:
        """Return the equation with a multiple of a multiplier in place of each that a table has."""
        slopes = {
            symbol: slope * sympy.diff(table.get(symbol, symbol), symbol) for symbol, slope in self.slopes.items()
        }
        zero, right = (one.xreplace(table) for one in (self.zero, self.right))
        return EquationRow(self.statement, self.label, zero, slopes, self.rest, right)

    def numbers(self, sample: MotionSample) -> tuple[list[Any], Any]:
        """Return the coefficients and the rest at a state. Raises OutsideDomain."""
        values = values_at(self._tape, sample)
        return values[: len(self.slopes)], values[len(self.slopes)]

    def leading(self, sample: MotionSample) -> list[Any]:
        """Return the coefficients of accelerations and multipliers at a state, of a first-order equation of its rate.

        Raises OutsideDomain.
        """
        if any(self.slopes.values()) or not sample.first_order:
            return self.numbers(sample)[0]
        velocities = list(self.statement.plain.values())[1::3]
        slopes = values_at(tape([sympy.diff(self.zero, v) for v in velocities], self.statement), sample)
        return [*slopes, *[0] * len(sample.multipliers)]

    def residual(self, sample: MotionSample) -> tuple[Any, Any]:
        """Return what the equation leaves for the motion, and the size of its terms."""
        values, count = values_at(self._tape, sample), len(self.slopes)
        slopes, rest, parts = values[:count], values[count], values[count + 1 :]
        solved = [*sample.accelerations, *sample.multipliers]
        terms = [slope * x for slope, x in zip(slopes, solved, strict=True)]
        # An acceleration that is zero is known to as many digits as the others are, and not to more.
        floor = ZERO * (1 + max(map(abs, solved))) * sum(map(abs, slopes))
        return sum(terms) + rest, sum(map(abs, terms)) + max(abs(rest), sum(map(abs, parts))) + floor

    def holds(self, samples: Sequence[MotionSample]) -> bool:
        """Return whether the motion satisfies the equation at all states where it has a value."""
        found = []
        for sample in samples:
            try:
                found.append(self.residual(sample))
            except OutsideDomain:
                continue
        return bool(found) and all(abs(left) <= HELD * size for left, size in found)


def unknowns_of(statement: Statement) -> list[Any]:
    """Return the accelerations in plain symbols, and the multipliers."""
    return [*list(statement.plain.values())[2::3], *(one.multiplier for one in statement.constraints)]


def row_of(equation: StudentEquation, statement: Statement) -> EquationRow:
    """Return an equation taken apart. Raises StatementError where it is not linear in accelerations and multipliers."""
    unknowns = unknowns_of(statement)
    found = [symbol for symbol in unknowns if equation.zero.has(symbol)]
    slopes = {symbol: sympy.diff(equation.zero, symbol) if symbol in found else sympy.S.Zero for symbol in unknowns}
    bent = [symbol for symbol in found if any(not vanishes(sympy.diff(slopes[symbol], other)) for other in found)]
    if bent:
        raise StatementError(
            f"{equation.label} is not linear in {listing(map(str, bent))}: equations of motion are compared as linear "
            "equations for the accelerations. Solve it for them, or clear what stands around them."
        )
    nothing = dict.fromkeys(found, sympy.S.Zero)
    slopes = {symbol: slope.xreplace(nothing) for symbol, slope in slopes.items()}
    rest = equation.zero.xreplace(nothing)
    return EquationRow(statement, equation.label, equation.zero, slopes, rest, equation.right)


def tape(expressions: Sequence[Any], statement: Statement) -> Precise:
    """Return expressions in plain symbols, ready to be evaluated. Raises OutsideDomain for numbers without a value."""
    stated = {symbol: leaf for leaf, symbol in statement.plain.items()}
    return Precise([expression.xreplace(stated) for expression in expressions], statement, DIGITS)


def values_at(expressions: Precise, sample: MotionSample) -> list[Any]:
    """Return the values at a state. Raises OutsideDomain."""
    point, number = sample.point, expressions.context.mpf
    return expressions(point.q, point.v, point.t, {p: number(x) for p, x in point.parameters.items()})
