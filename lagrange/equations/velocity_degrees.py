"""Whether the energy v.p - L is T + V: the degrees of T, or of L, in the velocities."""

from __future__ import annotations

import random
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.equations.identities import canonical, is_identity
from lagrange.equations.monomials import Monomial
from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement

SECOND = 2
DIGITS = 30
ZERO = sympy.Float("1e-15", DIGITS)
"""Of numbers of 30 digits, a difference below this part of them is taken for rounding."""


def visibly_homogeneous(statement: Statement) -> bool:
    """Whether T is seen to be of second degree in every term, without algebra."""
    return _degree(statement.kinetic, statement.velocities) == SECOND


def _degree(node: Any, velocities: tuple[Any, ...]) -> int | None:
    """Return the degree in the velocities that all terms have; None where it is not seen."""
    if node in velocities:
        return 1
    if node.is_Mul or node.is_Add:
        degrees = [_degree(part, velocities) for part in node.args]
        known = [degree for degree in degrees if degree is not None]
        if len(known) < len(degrees):
            return None
        return sum(known) if node.is_Mul else known[0] if known.count(known[0]) == len(known) else None
    if node.is_Pow and node.exp.is_Integer:
        degree = _degree(node.base, velocities)
        return None if degree is None else degree * int(node.exp)
    return None if node.has(*velocities) else 0


def proven_homogeneous(stated: StatedAlgebra) -> bool:
    """Whether v . dT/dv = 2 T is proven."""
    algebra, kinetic = stated.algebra, stated.read(stated.statement.kinetic)
    slopes = [algebra.multiply(algebra.differentiate(kinetic, v), stated.symbol(v)) for v in stated.v]
    return is_identity(algebra, algebra.add(algebra.scale(kinetic, sympy.Integer(-2)), *slopes))


def seen_mixed(statement: Statement) -> bool:
    """Whether T at doubled velocities differs from 4 T at some state, by number; open functions have none."""
    draw = random.Random(1)
    fixed = {leaf: sympy.Float(draw.uniform(0.6, 1.6), DIGITS) for leaf in (*statement.parameters, t)}
    places = {q: sympy.Float(draw.uniform(0.3, 1.5), DIGITS) for q in statement.coordinates}
    moving = {v: sympy.Float(draw.uniform(0.1, 0.5), DIGITS) for v in statement.velocities}
    ends = [
        statement.kinetic.xreplace({**places, **{v: k * x for v, x in moving.items()}}) for k in (sympy.S.One, SECOND)
    ]
    if any(end.has(AppliedUndef) for end in ends):
        return False
    once, twice = (end.xreplace(fixed).evalf(DIGITS) for end in ends)
    if not (once.is_Number and twice.is_Number and once.is_finite and twice.is_finite):
        return False
    return bool(abs(twice - 4 * once) > ZERO * max(abs(once), abs(twice)))


def has_all_degrees(stated: StatedAlgebra) -> bool:
    """Whether L is of second degree in the velocities, with terms of first degree and without velocities."""
    terms = canonical(stated.algebra, stated.lagrangian)
    degrees = [_monomial_degree(stated, one) for one in terms]
    return all(degree in (0, 1, SECOND) for degree in degrees) and all(k in degrees for k in (0, 1, SECOND))


def _monomial_degree(stated: StatedAlgebra, monomial: Monomial) -> int | None:
    """Return the degree of a monomial; None where a velocity stands in a function or under a root."""
    degree = 0
    for number, exponent in monomial:
        if stated.algebra.free(number).isdisjoint(stated.v):
            continue
        if stated.algebra.power(((number, 1),)) not in stated.v or not isinstance(exponent, int):
            return None
        degree += exponent
    return degree
