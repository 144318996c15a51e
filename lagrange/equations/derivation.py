"""The equations of motion as a textbook derives them, for people to read; independent of the compiled graph."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any, TypeVar

from sympy import Add, Eq, Float, ImmutableDenseMatrix, Rational, S

from lagrange.equations.collect import Collector
from lagrange.equations.monomials import MonomialSum
from lagrange.equations.solve import NestedCofactors, coupled_blocks, expanded_cofactors, vanishes
from lagrange.equations.stated_algebra import StatedAlgebra
from lagrange.equations.terms import TooLargeError, printable
from lagrange.errors import StatementError, listing
from lagrange.statement.multiplier import multiplier
from lagrange.statement.statement import Statement

Part = TypeVar("Part")

BUDGET = 300_000
"""Monomials that one part may make, 3 to 4 s of them; the equations of a 30-link chain take 200,000."""
EXPANDED_BLOCK = 3
"""Up to this many coupled coordinates are solved with the determinants multiplied out and merged."""
EXPANDED_WITH_MULTIPLIERS = 6
"""As many accelerations and multipliers of one block are: half of their matrix is zero, and what is left often cancels.
Two masses on two rods, six unknowns, take 0.3 s, and their formulas are a third as long as nested ones."""
EXPANDED_TERMS = 10_000
"""What multiplying out may take of the budget, 0.1 s; beyond it the formulas stay nested. Three links need 2,000."""
LONGEST_FORMULA = 20_000
"""Operations in one acceleration above which it is refused, some 50 printed pages."""
LARGEST_FRACTION = 10**6
"""Fractions with larger numbers are shown as decimals, where the statement has decimals."""
NAMED = 8
"""Coordinates that a refusal names."""

ACCELERATIONS = "the solved accelerations"


def derive(statement: Statement) -> Derivation:
    """Return the derivation of the statement's equations of motion, each part computed when first read."""
    return Derivation(statement, _Page(statement))


@dataclass(frozen=True, eq=False)
class Derivation:
    """L = T - V, p = dL/dv, and d/dt dL/dv - dL/dq + dD/dv = Q + G^T lambda for every coordinate, in SymPy.

    Expressions are in q(t), Derivative(q(t), t), Derivative(q(t), (t, 2)), the parameters, t, and the multipliers of
    constraints, `lagrange.multiplier(name)`. They are expanded, their sines and cosines merged by the addition
    theorems, and collected. Every part raises StatementError when it is too large to be written out. Source: Goldstein,
    Classical Mechanics, chapters 1 and 2.
    """

    statement: Statement
    _page: _Page

    def __reduce__(self) -> tuple[Any, ...]:
        return derive, (self.statement,)

    @cached_property
    def lagrangian(self) -> Any:
        """L = T - V, merged and collected."""
        return self._written("the Lagrangian", lambda page: page.show(page.lagrangian))

    @cached_property
    def momenta(self) -> Mapping[Any, Any]:
        """{coordinate: dL/dv}."""
        return self._written("the momenta", lambda page: page.by_coordinate(map(page.show, page.momenta)))

    @cached_property
    def equations(self) -> tuple[Any, ...]:
        """One Eq per coordinate; on the right stand the generalized forces as stated, and those of the constraints."""
        lefts = self._written("the equations of motion", lambda page: [page.show(left) for left in page.left_sides])
        exerted = self.constraint_forces.values()
        rights = [
            Add(force, *(forces[q] for forces in exerted))
            for q, force in zip(self.statement.coordinates, self.statement.forces, strict=True)
        ]
        return tuple(Eq(left, right, evaluate=False) for left, right in zip(lefts, rights, strict=True))

    @cached_property
    def constraints(self) -> tuple[Any, ...]:
        """One Eq per constraint, as stated: what the motion satisfies beside `equations`."""
        return tuple(Eq(one.expression, 0, evaluate=False) for one in self.statement.constraints)

    @cached_property
    def constraint_forces(self) -> Mapping[str, Mapping[Any, Any]]:
        """{constraint: {coordinate: generalized force}}, lambda times the row of G, in lambda, q, v and t.

        A row of G is dphi/dq of a holonomic constraint phi = 0, dpsi/dv of a constraint psi = 0 on velocities.
        """
        gradient = self._written(
            "the constraint forces", lambda page: [[page.show(entry) for entry in row] for row in page.gradient]
        )
        return MappingProxyType(
            {
                one.name: self._page.by_coordinate(multiplier(one.name) * entry for entry in row)
                for one, row in zip(self.statement.constraints, gradient, strict=True)
            }
        )

    @cached_property
    def mass_matrix(self) -> Any:
        """M = d2L/dv2, an immutable Matrix (n, n)."""
        entries = self._written(
            "the mass matrix", lambda page: [[page.show(entry) for entry in row] for row in page.mass]
        )
        return ImmutableDenseMatrix(entries)

    @cached_property
    def energy(self) -> Any:
        """The Jacobi integral v . p - L; T + V where T is quadratic in the velocities."""
        return self._written("the energy", lambda page: page.show(page.energy))

    @cached_property
    def accelerations(self) -> Mapping[Any, Any]:
        """{coordinate: acceleration}, solved by cofactors: the only denominators are determinants of coupled blocks.

        With constraints the multipliers are solved for with them, and the formulas hold on the constraints. Raises
        StatementError for a singular matrix and for formulas that are too long to print.
        """
        return self._written(ACCELERATIONS, lambda page: page.by_coordinate(page.motion[: len(page.q)]))

    @cached_property
    def multipliers(self) -> Mapping[str, Any]:
        """{constraint: multiplier}, as a function of the state; raises StatementError as `accelerations` does."""
        solved = self._written(ACCELERATIONS, lambda page: page.motion[len(page.q) :])
        return MappingProxyType(
            {one.name: value for one, value in zip(self.statement.constraints, solved, strict=True)}
        )

    def _written(self, what: str, part: Callable[[_Page], Part]) -> Part:
        self._page.algebra.budget = BUDGET
        try:
            return part(self._page)
        except (TooLargeError, RecursionError):
            names = self.statement.names
            shown = names if len(names) <= NAMED else (*names[:NAMED], "...")
            raise StatementError(
                f"{self.statement.name} is too large for {what} to be written out in symbols (coordinates: "
                f"{', '.join(shown)}). compile() gives the same as numbers, of any size"
                + ("; equations() gives the equations before they are solved." if what == ACCELERATIONS else ".")
            ) from None


class _Page(StatedAlgebra):
    """The derivation in `MonomialSum`, each part computed once."""

    def __init__(self, statement: Statement) -> None:
        super().__init__(statement, BUDGET)
        self.stated = {symbol: expression for expression, symbol in self.plain.items()}
        self.collector = Collector(self.algebra, frozenset(self.q), frozenset((*self.q, *self.v, *self.a, self.time)))

    @cached_property
    def remainders(self) -> list[MonomialSum]:
        """What stands beside M a on the left: (dp/dq) v + dp/dt - dL/dq + dD/dv, for each coordinate."""
        algebra = self.algebra
        dissipation = self.read(self.statement.dissipation)
        remainders = []
        for i, p in enumerate(self.momenta):
            drift = (
                algebra.multiply(algebra.differentiate(p, q), self.symbol(v))
                for q, v in zip(self.q, self.v, strict=True)
            )
            pull = algebra.scale(algebra.differentiate(self.lagrangian, self.q[i]), S.NegativeOne)
            drag = algebra.differentiate(dissipation, self.v[i])
            remainders.append(
                algebra.merge_angles(algebra.add({}, *drift, algebra.differentiate(p, self.time), pull, drag))
            )
        return remainders

    @cached_property
    def left_sides(self) -> list[MonomialSum]:
        """M a + remainder."""
        return [
            self.algebra.add(
                {}, *(self.algebra.multiply(m, self.symbol(a)) for m, a in zip(row, self.a, strict=True)), rest
            )
            for row, rest in zip(self.mass, self.remainders, strict=True)
        ]

    @cached_property
    def energy(self) -> MonomialSum:
        work = (self.algebra.multiply(p, self.symbol(v)) for p, v in zip(self.momenta, self.v, strict=True))
        return self.algebra.merge_angles(self.algebra.add(self.algebra.scale(self.lagrangian, S.NegativeOne), *work))

    @cached_property
    def gradient(self) -> list[list[MonomialSum]]:
        """The m rows of G: dphi/dq, or dpsi/dv of a constraint on velocities."""
        rows = []
        for one in self.statement.constraints:
            zero, symbols = self.read(one.expression), self.q if one.holonomic else self.v
            rows.append([self.algebra.merge_angles(self.algebra.differentiate(zero, symbol)) for symbol in symbols])
        return rows

    @cached_property
    def constraint_bias(self) -> list[MonomialSum]:
        """The rate of psi at constant velocities, gamma of G a + gamma = 0; psi is dphi/dt, or as stated."""
        return [
            self.at_constant_velocities(self.at_constant_velocities(zero) if one.holonomic else zero)
            for one in self.statement.constraints
            for zero in [self.read(one.expression)]
        ]

    def at_constant_velocities(self, terms: MonomialSum) -> MonomialSum:
        """Return the rate of a sum along dq/dt = v, dv/dt = 0."""
        algebra = self.algebra
        moved = [
            algebra.multiply(algebra.differentiate(terms, q), self.symbol(v))
            for q, v in zip(self.q, self.v, strict=True)
        ]
        return algebra.merge_angles(algebra.add({}, *moved, algebra.differentiate(terms, self.time)))

    @cached_property
    def motion(self) -> list[Any]:
        """The accelerations M^-1 (Q - remainder), or with constraints a and lambda, block by block.

        M a - G^T lambda = Q - remainder, G a = -gamma.
        """
        forces = [self.read(force) for force in self.statement.forces]
        negative = partial(self.algebra.scale, number=S.NegativeOne)
        bias = [self.algebra.add(force, negative(rest)) for force, rest in zip(forces, self.remainders, strict=True)]
        bias += map(negative, self.constraint_bias)
        columns = [[row[i] for row in self.gradient] for i in range(len(self.q))]
        rows = [[*mass, *map(negative, column)] for mass, column in zip(self.mass, columns, strict=True)]
        rows += [[*row, *({} for _ in self.gradient)] for row in self.gradient]
        solved: dict[int, Any] = {}
        for block in coupled_blocks([[bool(entry) for entry in row] for row in rows]):
            matrix = [[rows[i][j] for j in block] for i in block]
            solved.update(zip(block, self.solve(block, matrix, [bias[i] for i in block]), strict=True))
        return [solved[i] for i in range(len(solved))]

    def solve(self, block: list[int], matrix: list[list[MonomialSum]], bias: list[MonomialSum]) -> list[Any]:
        held = any(i >= len(self.q) for i in block)
        if len(block) <= (EXPANDED_WITH_MULTIPLIERS if held else EXPANDED_BLOCK):
            try:
                with self.algebra.at_most(EXPANDED_TERMS):
                    return self.solve_expanded(block, matrix, bias)
            except TooLargeError:
                return self.solve_nested(block, matrix, bias)
        return self.solve_nested(block, matrix, bias)

    def solve_expanded(self, block: list[int], matrix: list[list[MonomialSum]], bias: list[MonomialSum]) -> list[Any]:
        above, determinant = expanded_cofactors(self.algebra, matrix, bias)
        if not determinant:
            raise self.singular(block)
        return [self.finish(self.collector.quotient(terms, determinant)) for terms in above]

    def solve_nested(self, block: list[int], matrix: list[list[MonomialSum]], bias: list[MonomialSum]) -> list[Any]:
        entries = [[self.collector.write(entry) for entry in row] for row in matrix]
        right = [self.collector.write(entry) for entry in bias]
        if vanishes(entries):
            raise self.singular(block)
        return [self.finish(expression) for expression in NestedCofactors(entries, right, LONGEST_FORMULA).solution()]

    def singular(self, block: list[int]) -> StatementError:
        n = len(self.q)
        names = [self.statement.names[i] for i in block if i < n]
        held = [self.statement.constraints[i - n].name for i in block if i >= n]
        still = [self.statement.names[i] for i in block if i < n and not any(self.mass[i])]
        if still and not held:
            return StatementError(
                f"no formula is written out for the accelerations of {listing(names)}: {listing(still)} "
                f"{'has' if len(still) == 1 else 'have'} no inertia. An equation of motion of first order has no "
                "accelerations in it: read it in equations(); what is compiled takes its rate of change."
            )
        if held:
            return StatementError(
                f"the accelerations of {listing(names)} and the multipliers of {listing(held)} are not determined by a "
                "formula, at any state: the constraints depend on one another, or a motion that they allow has no "
                "inertia. Drop a constraint that follows from the others, or add the kinetic energy that is missing."
            )
        return StatementError(
            f"the mass matrix of {listing(names)} is singular at every state, so the accelerations are not determined: "
            "give each coordinate inertia of its own in the kinetic energy, or state fewer coordinates."
        )

    def show(self, terms: MonomialSum) -> Any:
        return self.finish(self.collector.write(terms))

    def finish(self, expression: Any) -> Any:
        """Return the expression in the stated symbols, with decimals again where a fraction is no help."""
        expression = printable(expression).xreplace(self.stated)
        if not self.decimal:
            return expression
        fractions = sorted(expression.atoms(Rational), key=str)
        return expression.xreplace({number: Float(number) for number in fractions if _unreadable(number)})

    def by_coordinate(self, parts: Iterable[Any]) -> Mapping[Any, Any]:
        return MappingProxyType(dict(zip(self.statement.coordinates, parts, strict=True)))


def _unreadable(number: Any) -> bool:
    """Whether a fraction that came from decimals is better shown as one: 981/100 is, 1/2 and 1/3 are not."""
    numerator, denominator = abs(int(number.p)), int(number.q)
    if max(numerator, denominator) > LARGEST_FRACTION:
        return True
    while denominator % 2 == 0:
        denominator //= 2
    while denominator % 5 == 0:
        denominator //= 5
    return denominator == 1 and int(number.q) > 8
