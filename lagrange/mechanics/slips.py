"""Common slips in equations of motion: a sign or a factor of one symbol, sine for cosine, degrees, small angles."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.errors import StatementError
from lagrange.mechanics.equation_row import row_of
from lagrange.mechanics.motion_samples import MotionSample, motion_samples
from lagrange.mechanics.small import small
from lagrange.mechanics.student_equations import StudentEquation
from lagrange.statement.statement import Statement

LONGEST = 400
"""Operations of all equations together up to which slips are tried: each one is a few evaluations more."""

MOST_SYMBOLS = 12
"""Symbols of a system up to which slips are tried."""

SIGNS_TRIED = 12
"""Random values at which a sign is looked at."""

_CIRCULAR = (sympy.sin, sympy.cos, sympy.tan)

Slip = tuple[str, Mapping[Any, Any]]
"""A sentence, and what each symbol or function of the equations is replaced by to undo the slip."""


def slip_of(
    equations: Sequence[StudentEquation], statement: Statement, samples: Sequence[MotionSample], *, alone: bool
) -> str:
    """Return a sentence on the one slip without which all equations would be right, "" where none is found.

    `alone` is true if one term is wrong: no factor and no direction of a coordinate is told then, since the term is.
    """
    if sum(int(one.zero.count_ops()) for one in equations) > LONGEST:
        return ""
    if len(statement.names) + len(statement.parameters) > MOST_SYMBOLS:
        return ""
    for sentence, table in _slips(equations, statement, alone=alone):
        if _all_hold([replace(one, zero=one.zero.xreplace(table)) for one in equations], statement, samples):
            return sentence
    return _small_angles(equations, statement)


def _all_hold(equations: Sequence[StudentEquation], statement: Statement, samples: Sequence[MotionSample]) -> bool:
    try:
        return all(row_of(one, statement).holds(samples) for one in equations)
    except StatementError:
        return False


def _small_angles(equations: Sequence[StudentEquation], statement: Statement) -> str:
    """Return a sentence if the equations are those of small motions about the coordinates' zero."""
    moving = set(statement.plain.values())
    if any(sympy.diff(one.zero, x, y) != 0 for one in equations for x in moving for y in moving if x.name <= y.name):
        return ""
    try:
        linear = small(statement, None, 2)
        held = _all_hold(equations, linear, motion_samples(linear, 2))
    except StatementError:
        return ""
    return "These are the equations for small motions: the exact ones are asked for." if held else ""


def _has_direction(parameter: Any, statement: Statement) -> bool:
    """Return whether a parameter may be counted in two directions, as g and a force but no mass, length or stiffness.

    It is a factor of terms of the potential or of forces, of either sign, and does not stand in the kinetic energy.
    """
    if statement.kinetic.has(parameter):
        return False
    slopes = [sympy.diff(one, parameter) for one in (statement.potential, *statement.forces)]
    if any(slope.has(parameter) for slope in slopes):
        return False
    if any(slope != 0 for slope in slopes[1:]):
        return True
    below = sympy.fraction(sympy.together(slopes[0]))[1]
    return not below.has(*statement.coordinates) and slopes[0] != 0 and not _has_one_sign(slopes[0])


def _has_one_sign(expression: Any) -> bool:
    """Return whether an expression has the same sign at random values of what stands in it."""
    dice = random.Random(1)
    leaves = sorted(expression.atoms(sympy.Symbol, AppliedUndef, sympy.Derivative), key=str)
    values = (
        sympy.N(expression.xreplace({x: sympy.Float(dice.choice((-1, 1)) * dice.uniform(0.3, 3)) for x in leaves}))
        for _ in range(SIGNS_TRIED)
    )
    signs = {value > 0 for value in values if value.is_real}
    return len(signs) < 2


def _slips(equations: Sequence[StudentEquation], statement: Statement, *, alone: bool) -> Iterator[Slip]:
    """Yield the slips that may be in equations, the commonest first."""
    found = {symbol for one in equations for symbol in one.zero.free_symbols}
    parameters = [p for p in statement.parameters if p in found]
    plain = list(statement.plain.values())
    coordinates = [tuple(plain[i : i + 3]) for i in range(0, len(plain), 3)]
    for p in (p for p in parameters if _has_direction(p, statement)):
        yield f"All is right with -{p} in place of {p}: check the direction in which {p} is counted.", {p: -p}
    for q, v, a in coordinates if not alone else ():
        turned = {q: -q, v: -v, a: -a}
        yield f"All is right for -{q} in place of {q}: check the direction in which {q} is counted.", turned
    circular = sorted({f for one in equations for f in one.zero.atoms(*_CIRCULAR)}, key=str)
    if circular:
        swapped = {f: sympy.cos(f.args[0]) if f.func is sympy.sin else sympy.sin(f.args[0]) for f in circular}
        yield "All is right with sine and cosine exchanged.", swapped
        degrees = {f: f.func(f.args[0] * 180 / sympy.pi) for f in circular}
        yield "All is right with angles in radians: they are in degrees here.", degrees
        for q, v, a in coordinates:
            if any(f.has(q) for f in circular):
                quarter = {q: sympy.pi / 2 - q, v: -v, a: -a}
                yield f"All is right if {q} is counted from the other axis, as pi/2 - {q}.", quarter
                yield f"All is right if {q} is counted from the opposite direction, as {q} + pi.", {q: q + sympy.pi}
    for factor, word in ((2, "2*"), (sympy.Rational(1, 2), "1/2*")):
        for p in parameters if not alone else ():
            yield f"All is right with {word}{p} in place of {p}.", {p: factor * p}
        for q, v, a in coordinates:
            yield f"All is right for {word}{q} in place of {q}.", {q: factor * q, v: factor * v, a: factor * a}
