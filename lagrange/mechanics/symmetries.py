"""The condition of a point symmetry, and the quantity that it conserves (Noether's theorem).

Moved along xi(q) and in time by tau, a motion keeps p . xi - tau E - F if

    xi . (dL/dq + Q - dD/dv) + (dxi/dt) . p - tau (dE/dt) = dF/dt

at every state, F being a function of q and t. With constraints xi is along them, G xi = 0, so that their forces do no
work. Source: J. V. Jose, E. J. Saletan, Classical Dynamics, 1998, sections 3.2 and 3.4.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import sympy
from sympy import Rational, S

from lagrange.equations.identities import canonical, is_identity
from lagrange.equations.monomials import MonomialSum
from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.equations.terms import printable

DIGITS = 30
"""Digits of a defect at a state: 20 are compared."""

LONGEST_GAUGE = 400
"""Operations of a total derivative that is integrated; those of symmetries that people state have ten."""


@dataclass(frozen=True, eq=False)
class Symmetry:
    """xi (n of them), tau and F in the plain symbols of a statement."""

    xi: tuple[Any, ...]
    tau: Any = S.Zero
    gauge: Any = S.Zero


@dataclass(frozen=True, eq=False)
class SymmetryEquation:
    """The condition of a symmetry, with the laws of a statement as monomials."""

    stated: StatedAlgebra
    forces: Sequence[MonomialSum] = field(init=False)
    power: MonomialSum = field(init=False)

    def __post_init__(self) -> None:
        stated, algebra = self.stated, self.stated.algebra
        drag = stated.read(stated.statement.dissipation)
        applied = [
            algebra.add(stated.read(force), algebra.scale(algebra.differentiate(drag, v), S.NegativeOne))
            for force, v in zip(stated.statement.forces, stated.v, strict=True)
        ]
        slopes = [algebra.differentiate(stated.lagrangian, q) for q in stated.q]
        object.__setattr__(self, "forces", [algebra.add(*pair) for pair in zip(slopes, applied, strict=True)])
        work = [algebra.multiply(q, stated.symbol(v)) for q, v in zip(applied, stated.v, strict=True)]
        lost = algebra.scale(algebra.differentiate(stated.lagrangian, stated.time), S.NegativeOne)
        object.__setattr__(self, "power", algebra.add(lost, *work))

    def defect(self, symmetry: Symmetry) -> MonomialSum:
        """Return the rate at which p . xi - tau E - F changes beside the forces of constraints, merged."""
        stated, algebra = self.stated, self.stated.algebra
        parts: list[MonomialSum] = [{}]
        for given, force, p in zip(symmetry.xi, self.forces, stated.momenta, strict=True):
            if given != 0:
                xi = algebra.read(given)
                parts += [algebra.multiply(xi, force), algebra.multiply(self.rate(xi), p)]
        if symmetry.tau != 0:
            parts.append(algebra.multiply(algebra.read(-symmetry.tau), self.power))
        if symmetry.gauge != 0:
            parts.append(algebra.scale(self.rate(algebra.read(symmetry.gauge)), S.NegativeOne))
        return algebra.merge_angles(algebra.add(*parts))

    def completed(self, symmetry: Symmetry) -> Symmetry | None:
        """Return a symmetry with the F whose rate is its defect, zero where none is found.

        Return None where its defect at one state shows that there is no F.
        """
        defect = self.defect(symmetry)
        if not self._differs(defect):
            return symmetry
        gauge = self._gauge(defect)
        return None if gauge == 0 else replace(symmetry, gauge=gauge)

    def _differs(self, terms: MonomialSum) -> bool:
        """Return whether a sum has another value than zero at a random state; False where it has none."""
        expression = printable(self.stated.algebra.write(terms))
        draw = random.Random(7)
        symbols = sorted(expression.free_symbols, key=str)
        values = {symbol: Rational(draw.randint(300, 1400), 1000) for symbol in symbols}
        parts = [term.xreplace(values).evalf(DIGITS) for term in sympy.Add.make_args(expression)]
        if not all(part == 0 or (part.is_Float and part.is_finite) for part in parts):
            return False
        return bool(abs(sum(parts)) > 10.0 ** (10 - DIGITS) * sum(abs(part) for part in parts))

    def _gauge(self, defect: MonomialSum) -> Any:
        """Return F(q, t) with dF/dt equal to the defect, zero where there is none.

        The slopes of F are the factors of the velocities; they are integrated one after the other.
        """
        stated, algebra = self.stated, self.stated.algebra
        gauge, left = S.Zero, defect
        slopes = [algebra.merge_angles(algebra.differentiate(defect, v)) for v in stated.v]
        if not self._total(defect, slopes):
            return S.Zero
        for q, v in (*zip(stated.q, stated.v, strict=True), (stated.time, None)):
            slope = left if v is None else algebra.differentiate(left, v)
            slope = algebra.merge_angles(slope)
            if not slope or any(algebra.free(k) & frozenset(stated.v) for monomial in slope for k, _ in monomial):
                continue
            integrand = algebra.write(slope)
            if integrand.count_ops() > LONGEST_GAUGE:
                continue
            part = sympy.integrate(integrand, q)
            if part.has(sympy.Integral):
                continue
            gauge += part
            rate = self.rate(algebra.read(part))
            left = algebra.merge_angles(algebra.add(left, algebra.scale(rate, S.NegativeOne)))
        return gauge if not canonical(algebra, left) else S.Zero

    def _total(self, defect: MonomialSum, slopes: Sequence[MonomialSum]) -> bool:
        """Return False where F cannot be: its slopes have velocities, or its mixed derivatives in q and t differ."""
        stated, algebra = self.stated, self.stated.algebra
        if any(algebra.free(k) & frozenset(stated.v) for terms in slopes for monomial in terms for k, _ in monomial):
            return False
        moved = [algebra.multiply(slope, stated.symbol(v)) for slope, v in zip(slopes, stated.v, strict=True)]
        rest = algebra.add(defect, algebra.scale(algebra.add({}, *moved), S.NegativeOne))
        for q, slope in zip(stated.q, slopes, strict=True):
            mixed = algebra.scale(algebra.differentiate(slope, stated.time), S.NegativeOne)
            if self._differs(algebra.merge_angles(algebra.add(algebra.differentiate(rest, q), mixed))):
                return False
        return True

    def rate(self, terms: MonomialSum) -> MonomialSum:
        """Return the total rate of a function of q and t."""
        stated, algebra = self.stated, self.stated.algebra
        moved = [
            algebra.multiply(algebra.differentiate(terms, q), stated.symbol(v))
            for q, v in zip(stated.q, stated.v, strict=True)
        ]
        return algebra.add(algebra.differentiate(terms, stated.time), *moved)

    def across(self, symmetry: Symmetry) -> list[MonomialSum]:
        """Return G xi, how fast each constraint would be left."""
        stated, algebra = self.stated, self.stated.algebra
        found = []
        for one in stated.statement.constraints:
            zero, symbols = stated.read(one.expression), stated.q if one.holonomic else stated.v
            parts = [
                algebra.multiply(algebra.differentiate(zero, symbol), algebra.read(xi))
                for symbol, xi in zip(symbols, symmetry.xi, strict=True)
                if xi != 0
            ]
            found.append(algebra.merge_angles(algebra.add({}, *parts)))
        return found

    def proven(self, symmetry: Symmetry) -> bool:
        """Return whether the symmetry is proven; False says that no proof was found."""
        stated = self.stated
        moved = [q for q, xi in zip(stated.q, symmetry.xi, strict=True) if xi != 0]
        moved += [stated.time] if symmetry.tau != 0 else []
        if stated.jumps(*moved):
            return False
        conditions = (self.defect(symmetry), *self.across(symmetry))
        return all(is_identity(stated.algebra, terms) for terms in conditions)

    def quantity(self, symmetry: Symmetry) -> MonomialSum:
        """Return p . xi - tau E - F."""
        stated, algebra = self.stated, self.stated.algebra
        parts = [algebra.multiply(algebra.read(xi), p) for xi, p in zip(symmetry.xi, stated.momenta, strict=True)]
        if symmetry.tau != 0:
            parts.append(algebra.multiply(algebra.read(-symmetry.tau), stated.energy))
        parts.append(algebra.read(-symmetry.gauge))
        return algebra.merge_angles(algebra.add({}, *parts))
