"""Derive the equations of motion as in a textbook, in SymPy, for people to read: `lagrange.System.equations`.

The derivation is independent of the compiled graph.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from types import MappingProxyType
from typing import Any, TypeVar

from sympy import (
    Abs,
    Add,
    Dummy,
    Eq,
    Function,
    Heaviside,
    ImmutableDenseMatrix,
    Max,
    Min,
    Mul,
    Piecewise,
    Rational,
    S,
    default_sort_key,
    expand,
    factor_terms,
    fraction,
    preorder_traversal,
    sign,
)

from lagrange.equations.decisions import seen_jacobi
from lagrange.equations.terms import MonomialSum, TooLargeError, common_factor
from lagrange.equations.textbook_algebra import BUDGET, TextbookAlgebra
from lagrange.errors import StatementError
from lagrange.statement.coordinate import acceleration_of, multiplier, t
from lagrange.statement.given.motion import OVERHANG, table_range
from lagrange.statement.statement import Statement, corners

HALF = Rational(1, 2)


@dataclass(frozen=True)
class MassPoint:
    """Named point of `positions` with a mass: its position and velocity, (2,) or (3,), and its kinetic energy.

    The energy is `mass` * `squared_speed` / 2. The velocity is simplified, and the position is shown as it was stated.
    """

    name: str
    mass: Any
    position: tuple[Any, ...]
    velocity: tuple[Any, ...]
    squared_speed: Any


def moving_points(page: TextbookAlgebra) -> tuple[MassPoint, ...]:
    """Return the named points whose kinetic energy, half a mass times speed squared, is a term of the stated T.

    `page` is the algebra of the statement. Each term is the energy of at most one point. If each component of all
    velocities is a constant times the velocity of a coordinate, the result is empty, since such velocities explain
    nothing.
    """
    left = [page.algebra.merge_angles(page.read(term)) for term in Add.make_args(page.statement.kinetic)]
    points, plain = [], True
    hidden = corners(page.statement.links)
    for name, position in page.statement.positions.items():
        if name in hidden:
            continue
        rates = [page.at_constant_velocities(page.read(entry)) for entry in position]
        squares = (page.algebra.multiply(rate, rate) for rate in rates)
        squared = page.algebra.merge_angles(page.algebra.add({}, *squares))
        mass, index = next(_masses(page, squared, left), (None, 0))
        if mass is not None:
            del left[index]
            for rate in rates:  # A plain rate is zero, or a constant times the velocity of a coordinate
                factors = [page.algebra.factors[k] for monomial in rate for k, _ in monomial]
                constant = (x in page.v or not x.free_symbols & page.collector.moving for x in factors)
                plain = plain and len(rate) <= 1 and all(constant)
            points.append(MassPoint(name, mass, tuple(position), tuple(map(page.show, rates)), page.show(squared)))
    return () if plain else tuple(points)


def _masses(page: TextbookAlgebra, squared: MonomialSum, terms: list[MonomialSum]) -> Iterator[tuple[Any, int]]:
    """Yield (mass, index) for each of the terms that equals mass * squared / 2 with a constant mass.

    `squared` is the squared speed of a point, and `index` is the index of the term.
    """
    if not squared:
        return
    number, monomial, rest = common_factor(squared)
    for index, term in enumerate(terms):
        other_number, other, other_rest = common_factor(term)
        for factor in (S.One, S.NegativeOne):
            if {key: factor * value for key, value in other_rest.items()} == rest:
                ratio = factor * other_number / number / HALF
                mass = Mul(ratio, page.algebra.power(other), 1 / page.algebra.power(monomial))
                constant = not mass.free_symbols & page.collector.moving
                if constant and all(part.is_Symbol or part.is_Number for part in Add.make_args(mass)):
                    yield page.finish(mass), index


Part = TypeVar("Part")

STATED = 200
"""Largest number of operations of a Lagrangian that SymPy also differentiates as it is stated, in 0.1 ms for each."""

KINKED = (Abs, sign, Heaviside, Max, Min, Piecewise)
"""Functions with kinks, at which their second derivatives contain Dirac deltas in SymPy."""

NAMED = 8  # Largest number of coordinates that a message names

ACCELERATIONS = "the solved accelerations"

TABLE_LETTER = "S"  # Letter of a table. Several tables are S1, S2, ...


def derive(statement: Statement, positive: Collection[str] = ()) -> Derivation:
    """Return the derivation of the statement's equations of motion. Each part is computed when it is first used.

    Coordinates whose names are in `positive` count as positive, so that abs(r) becomes r.
    """
    return Derivation(statement, TextbookAlgebra(statement, positive))


@dataclass(frozen=True, eq=False)
class Derivation:
    """Textbook derivation in SymPy: L = T - V, p = dL/dv, and d/dt dL/dv - dL/dq + dD/dv = Q + G^T lambda.

    Expressions are in q(t), Derivative(q(t), t), Derivative(q(t), (t, 2)), the parameters, t, and the multipliers of
    constraints, `lagrange.multiplier(name)`. The expressions are expanded, their sines and cosines are merged by the
    addition theorems, and terms are collected. Every part raises StatementError if it is too large to be written out.
    Source: Goldstein, Classical Mechanics, chapters 1 and 2.
    """

    statement: Statement
    _page: TextbookAlgebra

    def __reduce__(self) -> tuple[Any, ...]:
        return derive, (self.statement, self._page.positive)

    def with_named_tables(self) -> tuple[Derivation, tuple[str, ...]]:
        """Return the derivation with each function given by a table written as S(argument), and a sentence on each."""
        statement = self.statement
        expressions = (statement.kinetic, statement.potential, statement.dissipation, *statement.forces)
        expressions += tuple(constraint.expression for constraint in statement.constraints)
        nodes = [sorted(expression.atoms(Piecewise), key=default_sort_key) for expression in expressions]
        tables = [(node, bounds) for node in dict.fromkeys(chain(*nodes)) if (bounds := table_range(node))]
        if not tables:
            return self, ()
        taken = {*statement.names, *(p.name for p in statement.parameters)}
        names = (
            [TABLE_LETTER]
            if len(tables) == 1 and TABLE_LETTER not in taken
            else [f"{TABLE_LETTER}{i + 1}" for i in range(len(tables))]
        )
        named: dict[Any, Any] = {}
        sentences = []
        for name, (table, (argument, low, high)) in zip(names, tables, strict=True):
            named[table] = Function(name, real=True)(argument)
            knots = [float(pair.cond.rhs) for pair in table.args[0].expr.args[:-1]]
            pairs = (low, knots[0]), (high, knots[-1])
            first, last = ((end + OVERHANG * knot) / (1 + OVERHANG) for end, knot in pairs)
            sentences.append(f"{name} is a table of {len(knots) + 2} points from {first:.6g} to {last:.6g}.")
        written = statement.mapped(lambda expression: expression.xreplace(named))
        written = replace(written, unknown=(*statement.unknown, *named.values()))
        return derive(written, self._page.positive), tuple(sentences)

    @cached_property
    def refusal(self) -> str:
        """Message that the equations of motion are too large to be written out, or "" if they are not."""
        try:
            self._written("the equations of motion", TextbookAlgebra.require_short_slopes)
        except StatementError as error:
            return str(error)
        return ""

    @cached_property
    def lagrangian(self) -> Any:
        """The Lagrangian L = T - V, with like terms merged and collected."""
        collected = self._written("the Lagrangian", lambda page: page.show(page.lagrangian))
        return _shorter_of(collected, self.kinetic - self.potential) if self._is_quoted else collected

    @cached_property
    def momenta(self) -> Mapping[Any, Any]:
        """Conjugate momenta, {coordinate: dL/dv}."""
        return self._short(
            "the momenta",
            lambda page: map(page.show, page.momenta),
            lambda: self._stated_slopes(self.statement.velocities),
        )

    @cached_property
    def kinetic(self) -> Any:
        """The kinetic energy T, with like terms merged and collected. If L was stated alone, it is L."""
        return self._merged("the kinetic energy", self.statement.kinetic)

    @cached_property
    def potential(self) -> Any:
        """The potential energy V, with like terms merged and collected."""
        return self._merged("the potential energy", self.statement.potential)

    @cached_property
    def points(self) -> tuple[MassPoint, ...]:
        """Named points whose kinetic energy is a term of T, with their velocities."""
        return self._written("the velocities of the points", moving_points)

    @cached_property
    def momentum_rates(self) -> Mapping[Any, Any]:
        """Rates of the momenta, {coordinate: d/dt dL/dv}, collected in the accelerations."""
        return self._short(
            "the rates of the momenta",
            lambda page: page.accelerated(page.drifts),
            lambda: [_by_terms(p.diff(t)) for p in self.momenta.values()],
        )

    @cached_property
    def gradient(self) -> Mapping[Any, Any]:
        """Derivatives of L by the coordinates, {coordinate: dL/dq}."""
        return self._short(
            "the derivatives of the Lagrangian",
            lambda page: map(page.show, page.pulls),
            lambda: self._stated_slopes(self.statement.coordinates),
        )

    @cached_property
    def drag(self) -> Mapping[Any, Any]:
        """Derivatives of the dissipation D by the velocities, {coordinate: dD/dv}."""
        return self._each("the derivatives of the dissipation", lambda page: map(page.show, page.drags))

    @cached_property
    def right_sides(self) -> Mapping[Any, Any]:
        """Right-hand sides h, {coordinate: expression}, of (mass matrix) * accelerations = h + constraint forces."""
        return self._each("the equations of motion", lambda page: map(page.show, page.right_sides))

    @cached_property
    def equations(self) -> tuple[Any, ...]:
        """The equations of motion, one SymPy Eq for each coordinate.

        The right side has the generalized forces as stated and the constraint forces.
        """
        left_sides = self._short(
            "the equations of motion",
            lambda page: page.accelerated(page.remainders),
            lambda: [self.momentum_rates[q] - self.gradient[q] + self.drag[q] for q in self.statement.coordinates],
        ).values()
        exerted = self.constraint_forces.values()
        right_sides = [
            Add(force, *(forces[q] for forces in exerted))
            for q, force in zip(self.statement.coordinates, self.statement.forces, strict=True)
        ]
        return tuple(Eq(left, right, evaluate=False) for left, right in zip(left_sides, right_sides, strict=True))

    @cached_property
    def constraints(self) -> tuple[Any, ...]:
        """One SymPy Eq for each constraint, as stated. The constraints hold in addition to `equations`."""
        return tuple(Eq(constraint.expression, 0, evaluate=False) for constraint in self.statement.constraints)

    @cached_property
    def constraint_forces(self) -> Mapping[str, Mapping[Any, Any]]:
        """Generalized forces of the constraints, {constraint: {coordinate: multiplier times derivative}}.

        The derivative is dphi/dq of a holonomic constraint phi = 0, or dpsi/dv of a constraint psi = 0 on velocities.
        The forces contain the multipliers lambda, coordinates q, velocities v and the time t.
        """
        gradient = self._written(
            "the constraint forces", lambda page: [[page.show(entry) for entry in row] for row in page.gradient]
        )
        return MappingProxyType(
            {
                constraint.name: self._page.by_coordinate(multiplier(constraint.name) * entry for entry in row)
                for constraint, row in zip(self.statement.constraints, gradient, strict=True)
            }
        )

    @cached_property
    def mass_matrix(self) -> Any:
        """The mass matrix M = d2L/dv2, an immutable SymPy Matrix (n, n)."""
        entries = self._written(
            "the mass matrix", lambda page: [[page.show(entry) for entry in row] for row in page.mass]
        )
        return ImmutableDenseMatrix(entries)

    @cached_property
    def energy(self) -> Any:
        """The Jacobi integral v . p - L, which is T + V if T is quadratic in the velocities."""
        collected = self._written("the energy", lambda page: page.show(page.energy))
        return _shorter_of(collected, self.kinetic + self.potential) if self._keeps_its_sum else collected

    @cached_property
    def accelerations(self) -> Mapping[Any, Any]:
        """The accelerations, {coordinate: expression}, solved by cofactors.

        So the only denominators are determinants of coupled blocks. With constraints the multipliers are solved for at
        the same time, and the formulas hold on the constraints. Raises StatementError for a singular matrix and for
        formulas that are too long to print.
        """
        solved = self._written(ACCELERATIONS, lambda page: page.by_coordinate(page.motion[: len(page.q)]))
        return MappingProxyType(
            {q: _shorter_of(value, self._divided_by_mass(i, value)) for i, (q, value) in enumerate(solved.items())}
        )

    def _divided_by_mass(self, index: int, solved: Any) -> Any:
        """Return an acceleration, each term of its equation of motion divided by the mass, such as g - k*(s - d)/m.

        `index` is the index of the coordinate. Returns the formula `solved` instead if the equation has other
        accelerations or multipliers, or if L is long.
        """
        q, row = self.statement.coordinates[index], self.mass_matrix.row(index)
        mass = row[index]
        if self.statement.constraints or not self._is_short or mass == 0 or any(row[:index]) or any(row[index + 1 :]):
            return solved
        equation = self.equations[index]
        rest = equation.lhs.xreplace({acceleration_of(q): 0})
        return Add(equation.rhs / mass, *(-term / mass for term in Add.make_args(rest)))

    @cached_property
    def multipliers(self) -> Mapping[str, Any]:
        """The multipliers, {constraint: function of the state}.

        Raises StatementError for a singular matrix and for formulas that are too long to print.
        """
        solved = self._written(ACCELERATIONS, lambda page: page.motion[len(page.q) :])
        return MappingProxyType(
            {constraint.name: value for constraint, value in zip(self.statement.constraints, solved, strict=True)}
        )

    @cached_property
    def energy_is_sum(self) -> bool:
        """True unless the energy v.p - L is known to differ from T + V, as in a rotating frame.

        This is decided by terms or values of the kinetic energy T.
        """
        try:
            return not seen_jacobi(self.statement, self._page)
        except (TooLargeError, RecursionError):
            return True

    @cached_property
    def _is_quoted(self) -> bool:
        """True if L as stated is short and without kinks, so that parts of it may be shown as the user stated them."""
        stated = self.statement.lagrangian
        return not stated.has(*KINKED) and bool(stated.count_ops() <= STATED)

    @cached_property
    def _is_short(self) -> bool:
        """True if L is short and has no rotations, so that SymPy can also differentiate it as stated."""
        return self._is_quoted and not self.statement.entries

    @cached_property
    def _keeps_its_sum(self) -> bool:
        """True if the energy is shown as the stated sum T + V, because L is short and this sum equals v . p - L.

        This is so if every term of T has degree two in the velocities and V contains no velocities.
        """
        scale = Dummy("scale", positive=True)
        stretched = {v: scale * v for v in self.statement.velocities}
        kinetic, potential = self.statement.kinetic, self.statement.potential
        if not self._is_quoted or potential.has(*stretched):
            return False
        return bool(expand(kinetic.subs(stretched, simultaneous=True) - scale**2 * kinetic) == 0)

    def _stated_slopes(self, symbols: Sequence[Any]) -> list[Any]:
        """Return dL/dx for each of the symbols x, from L as stated and not expanded: I*(a + b) for I*(a + b)**2/2."""
        plain = self.statement.plain
        stated = {symbol: leaf for leaf, symbol in plain.items()}
        lagrangian = self.statement.lagrangian.xreplace(plain)
        return [_by_terms(lagrangian.diff(symbol.xreplace(plain)).xreplace(stated)) for symbol in symbols]

    def _short(
        self,
        label: str,
        parts: Callable[[TextbookAlgebra], Iterable[Any]],
        as_stated: Callable[[], Sequence[Any]],
    ) -> Mapping[Any, Any]:
        """Return {coordinate: expression}, each expression in the shorter of two forms.

        `parts` returns the collected forms from sums of monomials. `as_stated` returns the forms without expanding L.
        The latter are not used if L is long, nor where they have kinks. `label` names the expressions in messages.
        """
        collected = self._each(label, parts)
        if not self._is_short:
            return collected
        pairs = zip(collected.items(), as_stated(), strict=True)
        return MappingProxyType({q: v if other.has(*KINKED) else _shorter_of(v, other) for (q, v), other in pairs})

    def _merged(self, what: str, stated: Any) -> Any:
        merged = self._written(what, lambda page: page.show(page.algebra.merge_angles(page.read(stated))))
        if not self._is_quoted:
            return merged
        page = self._page
        return _shorter_of(
            _shorter_of(merged, stated), page.finish(page.algebra.tidy_roots(stated.xreplace(page.plain)))
        )

    def _each(self, what: str, parts: Callable[[TextbookAlgebra], Iterable[Any]]) -> Mapping[Any, Any]:
        return self._written(what, lambda page: page.by_coordinate(parts(page)))

    def _written(self, what: str, part: Callable[[TextbookAlgebra], Part]) -> Part:
        self._page.algebra.budget = BUDGET
        try:
            return part(self._page)
        except (TooLargeError, RecursionError):
            raise too_large(self.statement, what) from None


def too_large(statement: Statement, what: str = ACCELERATIONS) -> StatementError:
    """Return the StatementError for a system whose formulas are too long to print. `what` names the formulas."""
    names = statement.names
    shown = names if len(names) <= NAMED else (*names[:NAMED], "...")
    return StatementError(
        f"{statement.name} is too large for {what} to be written out in symbols (coordinates: "
        f"{', '.join(shown)}). compile() gives the same as numbers, of any size"
        + ("; equations() gives the equations before they are solved." if what == ACCELERATIONS else ".")
    )


def _shorter_of(collected: Any, stated: Any) -> Any:
    """Return `stated` if it has fewer operations, or as many operations and fewer terms. Else return `collected`."""
    return stated if _length(stated) < _length(collected) else collected


def _length(form: Any) -> tuple[int, int]:
    """Return the numbers of operations and of terms of an expression.

    A term counts one operation more if its numerator has a symbol that is a denominator, as m in (m*g - k*s)/m.
    """
    nodes = [*preorder_traversal(form)]
    below = [node.base for node in nodes if node.is_Pow and node.base.is_Symbol and node.exp.is_negative]
    terms = [fraction(term)[0] for node in nodes if node.is_Add for term in node.args] if below else []
    return int(form.count_ops()) + sum(term.has(*below) for term in terms), len(Add.make_args(form))


def _by_terms(expression: Any) -> Any:
    """Return a sum with common factors taken out in each term: m*(2*a + 2*b)/2 becomes m*(a + b)."""
    return Add(*map(factor_terms, Add.make_args(expression)))
