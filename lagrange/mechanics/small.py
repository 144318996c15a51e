"""Systems expanded about a point: the Lagrangian as a polynomial in small changes of coordinates and velocities."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import sympy

from lagrange.equations.terms import printable
from lagrange.errors import StatementError, formula, listing, shown
from lagrange.mechanics.corners import edges
from lagrange.mechanics.plain_form import simplest
from lagrange.mechanics.point import StatedPoint, stated_point
from lagrange.mechanics.reduction import rewritten
from lagrange.statement.number import whole_number
from lagrange.statement.statement import Statement

HIGHEST = 8
"""Largest order of an expansion: order 8 of a double pendulum's energy takes about 1 s."""

_SIZE = sympy.Dummy("size", real=True)
"""The size of the changes, by powers of which an expression is expanded."""


def small(statement: Statement, about: Any, order: Any) -> Statement:
    """Return the statement expanded to an order in changes of coordinates and velocities; see `Analysis.small`."""
    return _Expansion(stated_point(statement, about), whole_number(order, "order", 2, HIGHEST)).statement()


class _Expansion:
    """L, D and the constraints to one order, forces to one less: then the equations of motion have that order."""

    def __init__(self, point: StatedPoint, order: int) -> None:
        self.point, self.form, self.order = point, point.form, order
        self.symbols = (*self.form.q, *self.form.v)
        self.values = tuple(point.table[symbol] for symbol in self.symbols)
        self.changes = tuple(sympy.Dummy(f"d{symbol}", real=True) for symbol in self.symbols)

    def statement(self) -> Statement:
        """Return the expanded statement, which says in its description what it is."""
        stated = self.form.statement
        self.check_constraints()
        table = {
            expression: self.expanded(expression, what, self.order)
            for expression, what in (
                (stated.kinetic, "the kinetic energy"),
                (stated.potential, "the potential energy"),
                (stated.lagrangian, "the Lagrangian"),
                (stated.dissipation, "the dissipation"),
                *((one.expression, f"the constraint {one.name!r}") for one in stated.constraints),
            )
        }
        self.check_inertia(table[stated.lagrangian])
        forces = {
            q: self.expanded(force, f"the force on {name}", self.order - 1)
            for q, name, force in zip(stated.coordinates, stated.names, stated.forces, strict=True)
        }
        made = rewritten(stated, lambda given: table.get(given, given), forces=forces)
        about = " ".join(part for part in (stated.about, self.note) if part)
        return replace(made, positions=stated.positions, about=about)

    def expanded(self, stated: Any, what: str, order: int) -> Any:
        """Return a stated expression as a polynomial of that degree in the changes."""
        given = self.form.read(stated)
        self.check_smooth(given, what)
        moved = {
            symbol: value + _SIZE * change
            for symbol, value, change in zip(self.symbols, self.values, self.changes, strict=True)
        }
        along = given.xreplace({**self.point.table, **moved})
        total = sympy.S.Zero
        for power in range(order + 1):
            term = along.xreplace({_SIZE: sympy.S.Zero}) / sympy.factorial(power)
            if term.has(sympy.nan, sympy.zoo, sympy.oo, sympy.AccumBounds):
                raise StatementError(
                    f"{what} has no expansion about {self.where}: it, or a derivative up to order {order}, is not "
                    "finite there. Choose another point, or coordinates that are regular at it."
                )
            total += self.collected(term)
            along = along.diff(_SIZE) if power < order else along
        return self.form.written(total)

    def collected(self, term: Any) -> Any:
        """Return a polynomial in the changes in coordinates and velocities, its coefficients in their shortest form."""
        found = sympy.Poly(sympy.expand(term), *self.changes)
        differences = [symbol - value for symbol, value in zip(self.symbols, self.values, strict=True)]
        return sympy.Add(
            *(
                simplest(factor) * sympy.Mul(*(x**k for x, k in zip(differences, powers, strict=True)))
                for powers, factor in found.terms()
            )
        )

    def check_smooth(self, given: Any, what: str) -> None:
        """Refuse an expression with a corner or a jump at the point."""
        here = dict(zip(self.symbols, self.values, strict=True))
        for edge in edges(given):
            if edge.has(*self.symbols) and simplest(edge.xreplace({**self.point.table, **here})) == 0:
                raise StatementError(
                    f"{what} has no expansion about {self.where}: it has a corner or a jump where "
                    f"{formula(printable(edge), 60)} is zero, which is there. Choose a point beside it."
                )

    def check_constraints(self) -> None:
        """Refuse a point that is not on the constraints."""
        for one in self.form.statement.constraints:
            here = simplest(self.form.read(one.expression).xreplace(self.point.table))
            if not self.point.is_zero(here, ()):
                raise StatementError(
                    f"the point is not on the constraint {one.name!r}, which is {formula(printable(here), 80)} there "
                    "and not zero: give values of all coordinates in it."
                )

    def check_inertia(self, lagrangian: Any) -> None:
        """Refuse an expansion in which a coordinate has no inertia any more."""
        stated = self.form.statement
        lost = [
            name
            for name, v in zip(stated.names, stated.velocities, strict=True)
            if stated.lagrangian.has(v) and not lagrangian.has(v)
        ]
        if lost:
            raise StatementError(
                f"about {self.where} the Lagrangian to order {self.order} has no velocity of {listing(lost)} in it, "
                "whose inertia vanishes there: choose coordinates that are regular at that point, or another point."
            )

    @property
    def where(self) -> str:
        """The point in words: every coordinate, and the velocities that are not zero."""
        names = self.form.statement.state_names
        n = len(self.form.q)
        pairs = zip(names, self.values, strict=True)
        return listing(f"{name} = {shown(x)}" for i, (name, x) in enumerate(pairs) if i < n or x != 0)

    @property
    def note(self) -> str:
        """Description of the expansion; it says if the point is not an equilibrium."""
        done = f"Expanded about {self.where} to order {self.order} in changes of coordinates and velocities."
        if self.balanced:
            return done
        return (
            f"{done} That is no equilibrium: terms of first order remain, and accelerations are those of the system at "
            "the point alone."
        )

    @cached_property
    def balanced(self) -> bool:
        """True if the point is an equilibrium, possibly with constraint forces."""
        if any(x != 0 for x in self.values[len(self.form.q) :]):
            return False
        still = {**self.point.table, **dict.fromkeys(self.form.a, sympy.S.Zero)}
        rest = [simplest(r.xreplace(still)) for r in self.form.residuals]
        rows = [
            [
                simplest(self.form.read(one.expression).diff(x).xreplace(self.point.table))
                for x in (self.form.q if one.holonomic else self.form.v)
            ]
            for one in self.form.statement.constraints
        ]
        if not rows:
            return all(self.point.is_zero(r, ()) for r in rest)
        held = sympy.Matrix(rows).T
        return bool(held.row_join(sympy.Matrix(rest)).rank(simplify=simplest) == held.rank(simplify=simplest))
