"""Comparison of two statements: equal names, equal numbers, and mathematically equal expressions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import sympy

from lagrange.statement.coordinate import name_of
from lagrange.statement.motion import motion_of
from lagrange.statement.statement import Statement
from lagrange.statement.text import number_from_text

POINTS, DIGITS = 3, 30
"""Random points at which expressions of different form are compared, and the decimal digits there."""

SAME = 1e-20
"""Largest relative difference of equal values: ten of the digits are left for cancellation."""

_EXACT = ("name", "about", "source", "names", "initial", "links", "redundant", "run")


def difference(one: Statement, other: Statement) -> str:
    """Return the name of the first difference between two statements, as words of a message; empty if they are equal.

    Assumed signs of parameters are not compared.
    """
    for name in _EXACT:
        if getattr(one, name) != getattr(other, name):
            return f"the {name}"
    if {p.name: value for p, value in one.defaults.items()} != {p.name: value for p, value in other.defaults.items()}:
        return "the values of parameters"
    if _dimensions(one) != _dimensions(other):
        return "the dimensions"
    here, there = dict(_expressions(one)), dict(_expressions(other))
    if list(here) != list(there):
        return "what is stated"
    differing = (what for what in here if not _same(_plain(one, here[what]), _plain(other, there[what])))
    return next(differing, "")


def _expressions(statement: Statement) -> Iterator[tuple[str, Any]]:
    """Yield (name for messages, expression) of every part of a statement, and the values of given functions."""
    yield "the kinetic energy", statement.kinetic
    yield "the potential energy", statement.potential
    yield "the dissipation", statement.dissipation
    yield from zip((f"the force on {name}" for name in statement.names), statement.forces, strict=True)
    yield from ((f"the constraint {constraint.name}", constraint.expression) for constraint in statement.constraints)
    for label, point in statement.positions.items():
        yield from ((f"entry {i} of the position of {label}", entry) for i, entry in enumerate(point))
    for function in statement.given:
        motion = motion_of(function)
        yield f"the given function {name_of(function)}", None if motion is None else motion.values


def _dimensions(statement: Statement) -> Mapping[str, Any]:
    return {str(symbol): (dimension.exponents, dimension.unit) for symbol, dimension in statement.dimensions.items()}


def _plain(statement: Statement, expression: Any) -> Any:
    """Return an expression in real symbols, with decimals as `number_from_text` reads them."""
    if not isinstance(expression, sympy.Expr):
        return expression
    table = dict(statement.plain) | {p: sympy.Symbol(p.name, real=True) for p in statement.parameters}
    for function in statement.given:
        table[function] = sympy.Symbol(name_of(function), real=True)
    table |= {number: _number(number) for number in expression.atoms(sympy.Float)}
    return expression.xreplace(table)


@cache
def _number(number: Any) -> Any:
    exact = number_from_text(repr(abs(float(number))))
    return -exact if number < 0 else exact


def _same(one: Any, other: Any) -> bool:
    """Return True if expressions are equal in form, or have equal values at all points where both have values."""
    if one == other:
        return True
    if not isinstance(one, sympy.Expr) or not isinstance(other, sympy.Expr):
        return False
    leaves = sorted(one.free_symbols | other.free_symbols | one.atoms(sympy.Derivative), key=str)
    compared = 0
    for point in range(POINTS):
        values = {leaf: sympy.Rational(300 + (7919 * (k + 31 * point)) % 1009, 701) for k, leaf in enumerate(leaves)}
        here, there = one.xreplace(values).evalf(DIGITS), other.xreplace(values).evalf(DIGITS)
        if (here.is_Float and there.is_Float) or (here.is_number and there.is_number):
            compared += 1
            if not abs(here - there) <= SAME * max(abs(here), abs(there)):
                return False
    return compared > 0
