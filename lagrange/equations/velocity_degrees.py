"""Degrees of T, or of L, in the velocities. They decide whether the energy v.p - L is T + V."""

from __future__ import annotations

import random
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from lagrange.equations.identities import canonical, is_identity
from lagrange.equations.terms import Monomial
from lagrange.equations.textbook_algebra import StatedAlgebra
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement

SECOND = 2

MOST_TURNING = 4
"""Most coordinates of a Lagrangian whose mass matrix is solved to search for centrifugal terms."""

DIGITS = 30
ZERO = sympy.Float("1e-15", DIGITS)
"""Differences of numbers of 30 digits below this fraction of them are taken for rounding."""


def visibly_homogeneous(statement: Statement) -> bool:
    """Return True if every term of T as stated is of second degree; no algebra is done."""
    return _degree(statement.kinetic, statement.velocities) == SECOND


def _degree(node: Any, velocities: tuple[Any, ...]) -> int | None:
    """Return the common degree of all terms in the velocities; None if terms differ or it is not visible."""
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
    """Return True if v . dT/dv = 2 T is proven."""
    algebra, kinetic = stated.algebra, stated.read(stated.statement.kinetic)
    slopes = [algebra.multiply(algebra.differentiate(kinetic, v), stated.symbol(v)) for v in stated.v]
    return is_identity(algebra, algebra.add(algebra.scale(kinetic, sympy.Integer(-2)), *slopes))


def seen_mixed(statement: Statement) -> bool:
    """Return True if a number shows that T has terms of other degrees than 1 and 2 in the velocities.

    The sum T(v) + T(-v) has no terms of first degree, which are allowed: a charge in a field has them. Terms of second
    degree become four times as large at doubled velocities; any other factor shows other terms. False if T contains
    undefined functions.
    """
    draw = random.Random(1)
    fixed = {leaf: sympy.Float(draw.uniform(0.6, 1.6), DIGITS) for leaf in (*statement.parameters, t)}
    places = {q: sympy.Float(draw.uniform(0.3, 1.5), DIGITS) for q in statement.coordinates}
    moving = {v: sympy.Float(draw.uniform(0.1, 0.5), DIGITS) for v in statement.velocities}
    ends = [
        statement.kinetic.xreplace({**places, **{v: k * x for v, x in moving.items()}})
        for k in (1, -1, SECOND, -SECOND)
    ]
    if any(end.has(AppliedUndef) for end in ends):
        return False
    values = [end.xreplace(fixed).evalf(DIGITS) for end in ends]
    once, twice = values[0] + values[1], values[2] + values[3]
    if not (once.is_Number and twice.is_Number and once.is_finite and twice.is_finite):
        return False
    return bool(abs(twice - 4 * once) > ZERO * max(abs(once), abs(twice)))


def seen_turning(stated: StatedAlgebra) -> bool:
    """Return True if L has the terms of a moving frame: v M v/2 + a v + a M^-1 a/2, of which the last are centrifugal.

    L of a charge in a field also has terms of first degree and of degree zero, but not the centrifugal ones. Terms are
    compared one by one: a centrifugal term that was merged with another term is not recognised.
    """
    algebra, n = stated.algebra, len(stated.q)
    terms = canonical(algebra, stated.lagrangian)
    degrees = [_monomial_degree(stated, one) for one in terms]
    if n > MOST_TURNING or any(degree not in (0, 1, SECOND) for degree in degrees) or not {0, 1, SECOND} <= {*degrees}:
        return False
    still = dict.fromkeys(stated.v, sympy.S.Zero)
    a = sympy.Matrix([algebra.write(p).xreplace(still) for p in stated.momenta])
    mass = sympy.Matrix(n, n, lambda i, j: algebra.write(stated.mass[i][j]))
    if not any(a) or not mass.det():
        return False
    centrifugal = algebra.merge_angles(algebra.read(sympy.cancel((a.T * mass.LUsolve(a))[0, 0] / 2)))
    whole = algebra.merge_angles(stated.lagrangian)
    return all(whole.get(monomial) == coefficient for monomial, coefficient in centrifugal.items())


def _monomial_degree(stated: StatedAlgebra, monomial: Monomial) -> int | None:
    """Return the degree of a monomial in the velocities; None if a velocity is inside a function or a root."""
    degree = 0
    for number, exponent in monomial:
        if stated.algebra.free(number).isdisjoint(stated.v):
            continue
        if stated.algebra.power(((number, 1),)) not in stated.v or not isinstance(exponent, int):
            return None
        degree += exponent
    return degree
