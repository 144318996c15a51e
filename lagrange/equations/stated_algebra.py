"""What was stated as sums of monomials: the Lagrangian, its momenta and its mass matrix, merged."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import sympy
from sympy import Dummy, Float, Rational, S

from lagrange.equations.monomials import MonomialSum
from lagrange.equations.terms import Algebra, differentiable
from lagrange.statement.coordinate import acceleration_of, t
from lagrange.statement.statement import Statement

JUMPING = (sympy.Piecewise, sympy.sign, sympy.Heaviside, sympy.Max, sympy.Min)
"""Functions that may jump, or whose derivatives may, while those are zero on either side."""


class StatedAlgebra:
    """A statement in `MonomialSum`, each part computed once; coordinates and velocities are plain real symbols here.

    The symbols are dummies, so that a parameter or coordinate named like a velocity cannot be taken for it. `budget`
    bounds the monomials that are made; what needs more raises TooLargeError.
    """

    def __init__(self, statement: Statement, budget: int) -> None:
        self.statement = statement
        self.q, self.v, self.a = (
            tuple(Dummy(name + ending, real=True) for name in statement.names) for ending in ("", "_dot", "_ddot")
        )
        self.time = Dummy("t", real=True)
        self.plain: dict[Any, Any] = {t: self.time}
        for i, coordinate in enumerate(statement.coordinates):
            self.plain[coordinate] = self.q[i]
            self.plain[statement.velocities[i]] = self.v[i]
            self.plain[acceleration_of(coordinate)] = self.a[i]
        self.decimal = False
        self.algebra = Algebra(budget)

    @cached_property
    def lagrangian(self) -> MonomialSum:
        """L, merged."""
        return self.algebra.merge_angles(self.read(self.statement.lagrangian))

    @cached_property
    def momenta(self) -> list[MonomialSum]:
        """The momenta dL/dv."""
        return [self.algebra.differentiate(self.lagrangian, v) for v in self.v]

    @cached_property
    def mass(self) -> list[list[MonomialSum]]:
        """The rows of M = dp/dv, merged."""
        upper = {
            (i, j): self.algebra.merge_angles(self.algebra.differentiate(p, self.v[j]))
            for i, p in enumerate(self.momenta)
            for j in range(i, len(self.v))
        }
        return [[upper[min(i, j), max(i, j)] for j in range(len(self.v))] for i in range(len(self.v))]

    @cached_property
    def energy(self) -> MonomialSum:
        """The energy v . p - L, merged."""
        work = (self.algebra.multiply(p, self.symbol(v)) for p, v in zip(self.momenta, self.v, strict=True))
        return self.algebra.merge_angles(self.algebra.add(self.algebra.scale(self.lagrangian, S.NegativeOne), *work))

    def read(self, expression: Any) -> MonomialSum:
        """Return a stated expression as terms, its decimals exact: 0.1 is one tenth."""
        plain = expression.xreplace(self.plain)
        decimals = sorted(plain.atoms(Float), key=str)
        if decimals:
            self.decimal = True
            plain = plain.xreplace({number: Rational(repr(float(number))) for number in decimals})
        return self.algebra.read(differentiable(plain))

    def jumps(self, *symbols: Any, twice: bool = False) -> bool:
        """Return whether a symbol stands in a choice, whose derivative says nothing of a jump.

        With `twice` also where the second derivative says nothing of one of the first, as of |x|.
        """
        statement = self.statement
        stated = (statement.lagrangian, statement.dissipation, *statement.forces)
        kinds = (*JUMPING, sympy.Abs) if twice else JUMPING
        plain = [given.xreplace(self.plain) for given in stated]
        return any(any(node.has(*symbols) for node in given.atoms(*kinds)) for given in plain)

    def symbol(self, symbol: Any) -> MonomialSum:
        """Return one of the symbols as a sum."""
        return self.algebra.read(symbol)
