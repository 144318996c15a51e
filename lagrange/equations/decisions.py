"""Decide whether a Lagrangian and its equations of motion depend on time, coordinates or velocities.

A property is proven, disproven, or undecided. If a Lagrangian is stated through positions, angles and time may occur in
terms that cancel. So there are three tests, in this order. An expression is independent of a symbol that does not occur
in it. Otherwise its derivatives are evaluated at random states in many digits: a value other than zero disproves
independence. If all values are zero, algebra tries to prove independence. If this fails, the question is undecided. The
degrees of T, or of L, in the velocities decide whether the energy v.p - L is T + V.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import sympy
from sympy import S
from sympy.core.function import AppliedUndef

from lagrange.equations.constraints import ConstraintEquations
from lagrange.equations.terms import Monomial, MonomialSum, TooLargeError
from lagrange.equations.textbook_algebra import StatedAlgebra, canonical, is_identity
from lagrange.graph.evaluate import precise, values
from lagrange.graph.node import Node
from lagrange.statement.coordinate import t
from lagrange.statement.random_states import onto_constraints, random_points
from lagrange.statement.statement import Statement

SECOND = 2

MOST_TURNING = 4
"""Largest number of coordinates for which centrifugal terms are searched, since the mass matrix must be inverted."""

LAW_DIGITS = 30
ZERO_DIFFERENCE = sympy.Float("1e-15", LAW_DIGITS)
"""Rounding threshold: smaller differences, relative to the numbers compared, count as zero. Numbers have 30 digits."""


def visibly_homogeneous(statement: Statement) -> bool:
    """Return True if every term of the kinetic energy, as it is stated, has second degree in the velocities."""
    return _degree(statement.kinetic, statement.velocities) == SECOND


def _degree(node: Any, velocities: tuple[Any, ...]) -> int | None:
    """Return the degree in the velocities that all terms of a SymPy expression `node` have in common.

    Returns None if terms differ in degree, or if a degree is not visible without algebra.
    """
    if node in velocities:
        return 1
    if node.is_Mul or node.is_Add:
        degrees = [_degree(part, velocities) for part in node.args]
        visible = [degree for degree in degrees if degree is not None]
        if len(visible) < len(degrees):
            return None
        return sum(visible) if node.is_Mul else visible[0] if visible.count(visible[0]) == len(visible) else None
    if node.is_Pow and node.exp.is_Integer:
        degree = _degree(node.base, velocities)
        return None if degree is None else degree * int(node.exp)
    return None if node.has(*velocities) else 0


def seen_jacobi(statement: Statement, stated: StatedAlgebra) -> bool:
    """Return True if the energies have terms of a rotating frame, so that v.p - L differs from T + V.

    The terms are searched in the kinetic energy T, or in the Lagrangian L if it was stated alone. p are the momenta.
    """
    if visibly_homogeneous(statement):
        return False
    return seen_turning(stated) if statement.lagrangian_alone else seen_mixed(statement)


def seen_mixed(statement: Statement) -> bool:
    """Return True if values of the kinetic energy T show terms whose degree in the velocities v is not 1 or 2.

    Terms of first degree are allowed, since a charge in a field has them. T(v) + T(-v) does not contain them. In this
    sum, terms of second degree become four times as large at doubled velocities. Any other factor shows other terms.
    The result is False if T contains undefined functions.
    """
    draw = random.Random(1)
    fixed = {leaf: sympy.Float(draw.uniform(0.6, 1.6), LAW_DIGITS) for leaf in (*statement.parameters, t)}
    positions = {q: sympy.Float(draw.uniform(0.3, 1.5), LAW_DIGITS) for q in statement.coordinates}
    moving = {v: sympy.Float(draw.uniform(0.1, 0.5), LAW_DIGITS) for v in statement.velocities}
    ends = [
        statement.kinetic.xreplace({**positions, **{v: k * x for v, x in moving.items()}})
        for k in (1, -1, SECOND, -SECOND)
    ]
    if any(end.has(AppliedUndef) for end in ends):
        return False
    values = [end.xreplace(fixed).evalf(LAW_DIGITS) for end in ends]
    once, twice = values[0] + values[1], values[2] + values[3]
    if not (once.is_Number and twice.is_Number and once.is_finite and twice.is_finite):
        return False
    return bool(abs(twice - 4 * once) > ZERO_DIFFERENCE * max(abs(once), abs(twice)))


def seen_turning(stated: StatedAlgebra) -> bool:
    """Return True if the Lagrangian L of `stated` has the terms of a moving frame: v M v/2 + a v + a M^-1 a/2.

    v are the velocities, M is the mass matrix, and a is a vector that depends on coordinates. a M^-1 a/2 are the
    centrifugal terms. L of a charge in a field has terms of first degree and of degree zero, too, but no centrifugal
    terms. Terms are compared one by one. So a centrifugal term that was merged with another term is not recognised.
    """
    algebra, n = stated.algebra, len(stated.q)
    terms = canonical(algebra, stated.lagrangian)
    degrees = [_monomial_degree(stated, monomial) for monomial in terms]
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
    """Return the degree of a monomial in the velocities. None if a velocity is inside a function or a root."""
    degree = 0
    for number, exponent in monomial:
        if stated.algebra.free(number).isdisjoint(stated.v):
            continue
        if stated.algebra.power(((number, 1),)) not in stated.v or not isinstance(exponent, int):
            return None
        degree += exponent
    return degree


BUDGET = 100_000  # Largest number of monomials in all proofs about one system, which take 1 to 2 s
CONTEXT = precise(50)  # Numbers of 50 digits, in which properties are tested
STEP = "1e-15"  # Step of the central difference in time, whose error is about 1e-30 of the function
ZERO_SHARE = CONTEXT.mpf("1e-20")
"""Rounding threshold: a value above this fraction of the largest number in its computation is not zero."""
LAW_SAMPLES = 3  # Number of states at which a property is tested
LAW_DRAWS = 24  # Largest number of states drawn for the samples, since an expression may have no value at some
MOST_HELD = 16
"""Largest number of constraints for which a state that satisfies them is searched. For 16 constraints this takes a
second."""
Verdict = bool | None  # True if proven, False if disproven, None if undecided

Values = dict[Node, Any]


@dataclass(frozen=True, eq=False)
class StatedLaws:
    """Expressions of the equations of motion as graph nodes, in the symbols `q`, `v`, `time` and `parameters`.

    `extra` are the stated forces less those of the dissipation, Q - dD/dv. `forces` is dL/dq + extra, with the
    Lagrangian L. `bias` is the right-hand side h of M a = h, with the mass matrix M and the accelerations a.
    """

    q: tuple[Node, ...]
    v: tuple[Node, ...]
    time: Node
    parameters: tuple[Node, ...]
    lagrangian: Node
    forces: Sequence[Node]
    momenta: Sequence[Node]
    extra: Sequence[Node]
    bias: Sequence[Node]
    mass: tuple[tuple[Node, ...], ...]
    constraints: ConstraintEquations


@dataclass(frozen=True, eq=False)
class Decisions:
    """Properties of the equations of a statement: true, false or undecided. Each is decided when it is first used."""

    statement: Statement
    laws: StatedLaws

    def __reduce__(self) -> tuple[Any, ...]:
        # Decisions are not stored, since numbers of a separate mpmath context cannot be pickled.
        return Decisions, (self.statement, self.laws)

    @cached_property
    def timeless(self) -> Verdict:
        """True if the Lagrangian does not depend on time, False if it does, None if undecided."""

        def slope(point: Values) -> bool | None:
            rate = self._rate(self.laws.lagrangian, point)
            return None if rate is None else abs(rate[0]) > ZERO_SHARE * rate[1]

        absent = not _depends_on(self.laws.lagrangian, [self.laws.time])
        return self._decided(absent, slope, lambda stated: _free_of(stated, stated.time))

    def cyclic(self, i: int) -> Verdict:
        """Return True if the Lagrangian does not depend on coordinate number `i`, False if it does, None if undecided.

        The coordinate must have no force and no dissipation.
        """

        def slope(point: Values) -> bool | None:
            force = values([self.laws.forces[i]], point, CONTEXT)
            return None if force is None else abs(force[0][0]) > ZERO_SHARE * force[1]

        absent = not _depends_on(self.laws.lagrangian, [self.laws.q[i]])
        return self._decided(absent, slope, lambda stated: _free_of(stated, stated.q[i]))

    @cached_property
    def powerless(self) -> Verdict:
        """True if the rate of the energy, -dL/dt + (Q - dD/dv) . v, is zero; False if not, None if undecided.

        L is the Lagrangian, Q are the stated forces, and D is the dissipation.
        """
        if self.power_seen is not None or self._has_power:
            return self.power_seen
        if self._has_no_force and self.timeless is True:
            return True
        return self._by_algebra(
            lambda stated: not stated.jumps(stated.time) and is_identity(stated.algebra, stated.power)
        )

    @cached_property
    def power_seen(self) -> Verdict:
        """True if the rate of the energy is zero, False if it is not, None if that is not known without algebra.

        The rate is zero if there are no forces and no dissipation, and L does not contain the time. It is not zero if
        its value at a random state is not zero. With constraints that do no work, the state must satisfy them.
        """
        laws = self.laws
        if self._has_no_force and not _depends_on(laws.lagrangian, [laws.time]):
            return True
        if not self._has_power:
            return None
        if not len(laws.constraints) or not laws.constraints.workless:
            return False
        # At states that satisfy the constraints, the rate of the energy may be zero.
        states = map(self._on_constraints, self._points) if len(laws.constraints) <= MOST_HELD else ()
        return False if any(self._power(state) for state in states if state is not None) else None

    @property
    def _has_no_force(self) -> bool:
        zero = self.laws.extra[0].graph.zero
        return all(force is zero for force in self.laws.extra)

    @cached_property
    def _has_power(self) -> bool:
        """True if the rate of the energy is not zero at a random state, which need not satisfy the constraints."""
        return any(self._power(point) for point in self._points)

    @cached_property
    def homogeneous(self) -> Verdict:
        """True if the kinetic energy T has second degree in the velocities, so that the energy is T + V.

        The energy is v.p - L, with the Lagrangian L and the momenta p. None means undecided. Terms of first degree, as
        for a charge in a field, are ignored: the energy is then V plus the terms of T of second degree. For a
        Lagrangian stated alone the result is False if it has the terms of a rotating frame, else None.
        """
        if visibly_homogeneous(self.statement):
            return True
        try:
            if seen_jacobi(self.statement, self._stated):
                return False
            if self.statement.lagrangian_alone:
                return None
            stated, algebra = self._stated, self._stated.algebra
            kinetic = stated.read(self.statement.kinetic)  # homogeneous if v . dT/dv = 2 T
            slopes = [algebra.multiply(algebra.differentiate(kinetic, v), algebra.read(v)) for v in stated.v]
            return is_identity(algebra, algebra.add(algebra.scale(kinetic, sympy.Integer(-2)), *slopes)) or None
        except (TooLargeError, RecursionError):
            return None

    @cached_property
    def separable(self) -> Verdict:
        """True if the momenta depend on velocities and parameters alone, False if not, None if undecided."""
        laws, moving = self.laws, [*self.laws.q, self.laws.time]
        absent = not any(_depends_on(p, moving) for p in laws.momenta)
        return self._decided(
            absent,
            lambda point: _changes(laws.momenta, point, moving),
            lambda stated: _proven_independent(stated, stated.momenta, (*stated.q, stated.time)),
        )

    @cached_property
    def constant_mass(self) -> Verdict:
        """True if the mass matrix is constant along every motion, False if not, None if undecided."""
        laws, entries = self.laws, [entry for row in self.laws.mass for entry in row]
        moving = [*laws.q, *laws.v, laws.time]
        absent = not any(_depends_on(entry, moving) for entry in entries)
        return self._decided(
            absent,
            lambda point: _changes(entries, point, moving),
            lambda stated: _proven_independent(
                stated, [entry for row in stated.mass for entry in row], (*stated.q, *stated.v, stated.time)
            ),
        )

    @cached_property
    def position_only(self) -> Verdict:
        """True if accelerations are free of velocities, False if not. None if undecided or with constraints."""
        laws = self.laws
        if len(laws.constraints):
            return None
        if self.constant_mass is not True:
            return self.constant_mass
        absent = not any(_depends_on(h, laws.v) for h in laws.bias)
        return self._decided(absent, lambda point: _changes(laws.bias, point, laws.v), _proven_position_only)

    def _decided(
        self,
        absent: bool,
        number: Callable[[Values], bool | None],
        proof: Callable[[StatedAlgebra], bool],
    ) -> Verdict:
        """Return True if a property is proven, False if it is disproven, None if it is undecided.

        The property is proven if `absent` is true, or if the callable `proof` returns True within the budget. The
        property is disproven if the callable `number` returns True at a random state, which is a counterexample.
        """
        if absent:
            return True
        return False if any(number(point) for point in self._points) else self._by_algebra(proof)

    def _by_algebra(self, proof: Callable[[StatedAlgebra], bool]) -> Verdict:
        """Return True if the callable `proof` returns True within the budget of monomials, else None."""
        try:
            return proof(self._stated) or None
        except (TooLargeError, RecursionError):
            return None

    # --- numbers ----------------------------------------------------------------------------------------------

    @cached_property
    def _points(self) -> list[Values]:
        """Random states, times and parameters at which the Lagrangian has a value, at most `LAW_SAMPLES` of them."""
        laws = self.laws
        symbols = (*laws.q, *laws.v, laws.time, *laws.parameters)
        samples = (
            (*point.q, *point.v, point.t, *point.parameters.values())
            for point in random_points(self.statement, 1, LAW_DRAWS)
        )
        points = (dict(zip(symbols, map(CONTEXT.mpf, sample), strict=True)) for sample in samples)
        return [*islice((point for point in points if values([laws.lagrangian], point, CONTEXT)), LAW_SAMPLES)]

    def _rate(self, node: Node, point: Values) -> tuple[Any, Any] | None:
        """Return the partial time derivative of a node at a point, and the scale for deciding whether it is zero.

        The scale is the largest value that occurs in the evaluation. Returns None if the node has no value.
        """
        step, time = CONTEXT.mpf(STEP), self.laws.time
        ahead, behind = (values([node], {**point, time: point[time] + way * step}, CONTEXT) for way in (1, -1))
        if ahead is None or behind is None:
            return None
        return (ahead[0][0] - behind[0][0]) / (2 * step), ahead[1]

    def _power(self, point: Values) -> bool | None:
        """Return True if the rate of the energy differs from zero at a point. None if it has no value at the point."""
        laws = self.laws
        forces, slope = values(laws.extra, point, CONTEXT), self._rate(laws.lagrangian, point)
        if forces is None or slope is None:
            return None
        terms = [force * point[v] for force, v in zip(forces[0], laws.v, strict=True)]
        return bool(abs(CONTEXT.fsum([*terms, -slope[0]])) > ZERO_SHARE * max(forces[1], slope[1], *map(abs, terms)))

    def _on_constraints(self, point: Values) -> Values | None:
        """Return `point` with its state moved onto the constraints, or None if no such state is found."""
        laws, constraints = self.laws, self.laws.constraints
        indices = range(len(constraints))
        holonomic = [i for i in indices if constraints.positions[i] is not None]
        levels = [(holonomic, constraints.positions), (indices, constraints.velocities)]
        outputs: list[list[Any]] = [
            [*(zeros[i] for i in rows), *(entry for i in rows for entry in constraints.gradient[i])]
            for rows, zeros in levels
        ]

        def moved(q: list[Any], v: list[Any]) -> Values:
            return point | dict(zip((*laws.q, *laws.v), (*q, *v), strict=True))

        def residuals_at(level: int, q: list[Any], v: list[Any]) -> tuple[list[Any], list[list[Any]]]:
            evaluated = values(outputs[level], moved(q, v), CONTEXT)
            if evaluated is None:
                raise ZeroDivisionError  # The same exception as of `lu_solve` for a singular matrix
            count, n = len(levels[level][0]), len(q)
            rest = evaluated[0][count:]
            return evaluated[0][:count], [rest[k : k + n] for k in range(0, len(rest), n)]

        try:
            state = onto_constraints(
                [point[x] for x in laws.q], [point[x] for x in laws.v], residuals_at, CONTEXT.lu_solve, ZERO_SHARE
            )
        except ZeroDivisionError:
            return None
        return None if state is None else moved(*state)

    # --- proofs -----------------------------------------------------------------------------------------------

    @cached_property
    def _stated(self) -> StatedAlgebra:
        return StatedAlgebra(self.statement, BUDGET)


def _proven_position_only(stated: StatedAlgebra) -> bool:
    """Return True if it is proven that the terms other than M a in the equations of motion contain no velocities."""
    algebra, minus = stated.algebra, S.NegativeOne
    sides = [
        algebra.add(
            stated.at_constant_velocities(p),
            algebra.scale(algebra.differentiate(stated.lagrangian, q), minus),
            algebra.scale(force, minus),
        )
        for p, q, force in zip(stated.momenta, stated.q, stated.applied, strict=True)
    ]
    return _proven_independent(stated, sides, stated.v)


def _free_of(stated: StatedAlgebra, symbol: Any) -> bool:
    """Return True if it is proven that the Lagrangian of `stated` does not depend on `symbol`, such as the time."""
    slope = stated.algebra.differentiate(stated.lagrangian, symbol)
    return not stated.jumps(symbol) and is_identity(stated.algebra, slope)


def _proven_independent(stated: StatedAlgebra, sums: Sequence[MonomialSum], symbols: Sequence[Any]) -> bool:
    """Return True if it is proven that none of the sums depends on one of the symbols."""
    slopes = (stated.algebra.differentiate(terms, symbol) for terms in sums for symbol in symbols)
    return not stated.jumps(*symbols, twice=True) and all(is_identity(stated.algebra, slope) for slope in slopes)


def _depends_on(node: Node, symbols: Sequence[Node]) -> bool:
    """Return True if one of the symbols occurs in the expression of a node."""
    return any(node.depends & symbol.depends for symbol in symbols)


def _changes(nodes: Sequence[Node], point: Values, symbols: Sequence[Node]) -> bool | None:
    """Return True if a node has another value at `point` when the values of `symbols` change. None without a value."""
    other = {**point, **{x: point[x] * CONTEXT.mpf("0.87") + CONTEXT.mpf("0.013") for x in symbols}}
    before, after = (values(nodes, at, CONTEXT) for at in (point, other))
    if before is None or after is None:
        return None
    size = max(before[1], after[1])
    return any(abs(a - b) > ZERO_SHARE * size for a, b in zip(before[0], after[0], strict=True))
