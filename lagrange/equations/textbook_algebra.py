"""Derive equations of motion as in a textbook, as sums of monomials, and prove that such a sum is zero.

This module also has the limits of size above which formulas are not multiplied out, or are refused.

A sum is proven zero for all values of its symbols as follows. Roots and quotients are multiplied out. Sines and cosines
of sums and multiples are expanded to sines and cosines of their smallest parts. Even powers of sines are written in
cosines. The result is a polynomial in nearly independent factors: if all its coefficients are zero, so is the sum. A
sum whose polynomial is not zero may still vanish: it is undecided.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from itertools import starmap
from math import gcd, lcm
from types import MappingProxyType
from typing import Any, NamedTuple

import sympy
from sympy import Dummy, Float, Rational, S

from lagrange.equations.collect import SumWriter, shortened
from lagrange.equations.solve_plan import (
    NestedCofactors,
    coupled_blocks,
    expanded_cofactors,
    has_large_block,
    vanishes,
)
from lagrange.equations.terms import (
    ONE,
    Algebra,
    Monomial,
    MonomialSum,
    TooLargeError,
    differentiable,
    printable,
)
from lagrange.errors import StatementError, listing
from lagrange.statement.coordinate import acceleration_of, name_of, t
from lagrange.statement.statement import Statement

JUMPING = (sympy.Piecewise, sympy.sign, sympy.Heaviside, sympy.Max, sympy.Min)
"""SymPy functions whose value or slope may jump. Their derivatives, as computed here, do not show the jumps."""


class SmallTurn(NamedTuple):
    """Small turn of a body about one of its own axes, which is a quasi-coordinate.

    `coordinate` is the index of the turn among the coordinates. `others` are the indices of turns about the next two
    axes in cyclic order. `entries` are the nine symbols of the rotation matrix R by rows. `axis` is 0, 1 or 2.
    """

    coordinate: int
    others: tuple[int, int]
    entries: tuple[Any, ...]
    axis: int


class StatedAlgebra:
    """Stated energies, forces and constraints of a system as sums of monomials in real symbols.

    Coordinates and velocities are dummy symbols, so that a parameter or coordinate with the name of a velocity differs
    from the velocity. Each part is computed once. `budget` is the number of monomials that may be created. A part that
    needs more raises TooLargeError.
    """

    def __init__(self, statement: Statement, budget: int, positive: Collection[str] = ()) -> None:
        self.statement, self.positive = statement, positive
        self.q = tuple(Dummy(name, real=True, positive=name in positive or None) for name in statement.names)
        self.v, self.a = (
            tuple(Dummy(name + ending, real=True) for name in statement.names) for ending in ("_dot", "_ddot")
        )
        self.time = Dummy("t", real=True)
        self.plain: dict[Any, Any] = {t: self.time}
        for i, coordinate in enumerate(statement.coordinates):
            self.plain[coordinate] = self.q[i]
            self.plain[statement.velocities[i]] = self.v[i]
            self.plain[acceleration_of(coordinate)] = self.a[i]
        self.entries = [tuple(Dummy(name_of(f), real=True) for f in entries) for entries in statement.entries]
        """Nine symbols of the entries of each rotation matrix, by rows; empty for a statement without small turns."""
        for functions, symbols in zip(statement.entries, self.entries, strict=True):
            self.plain |= dict(zip(functions, symbols, strict=True))
        self.decimal = False
        self.algebra = Algebra(budget)

    @cached_property
    def lagrangian(self) -> MonomialSum:
        """The Lagrangian L, with like terms merged."""
        return self.algebra.merge_angles(self.read(self.statement.lagrangian))

    @cached_property
    def momenta(self) -> list[MonomialSum]:
        """The momenta dL/dv, one for each coordinate."""
        return [self.algebra.differentiate(self.lagrangian, v) for v in self.v]

    @cached_property
    def mass(self) -> list[list[MonomialSum]]:
        """Rows of the mass matrix M = dp/dv, with like terms merged."""
        upper = {
            (i, j): self.algebra.merge_angles(self.algebra.differentiate(p, self.v[j]))
            for i, p in enumerate(self.momenta)
            for j in range(i, len(self.v))
        }
        return [[upper[min(i, j), max(i, j)] for j in range(len(self.v))] for i in range(len(self.v))]

    @cached_property
    def energy(self) -> MonomialSum:
        """The energy v . p - L, with like terms merged."""
        work = (self.algebra.multiply(p, self.algebra.read(v)) for p, v in zip(self.momenta, self.v, strict=True))
        return self.algebra.merge_angles(self.algebra.add(self.algebra.scale(self.lagrangian, S.NegativeOne), *work))

    @cached_property
    def drags(self) -> list[MonomialSum]:
        """Derivatives dD/dv of the dissipation D, one for each coordinate."""
        dissipation = self.read(self.statement.dissipation)
        return [self.algebra.merge_angles(self.algebra.differentiate(dissipation, v)) for v in self.v]

    @cached_property
    def applied(self) -> list[MonomialSum]:
        """Stated forces less the forces of the dissipation, Q - dD/dv, one for each coordinate."""
        forces = map(self.read, self.statement.forces)
        minus = partial(self.algebra.scale, number=S.NegativeOne)
        return [self.algebra.add(force, minus(drag)) for force, drag in zip(forces, self.drags, strict=True)]

    @cached_property
    def power(self) -> MonomialSum:
        """Rate of the energy without constraints: -dL/dt + (Q - dD/dv) . v.

        L is the Lagrangian, Q are the stated forces, and D is the dissipation.
        """
        algebra = self.algebra
        work = [algebra.multiply(force, self.algebra.read(v)) for force, v in zip(self.applied, self.v, strict=True)]
        return algebra.add(algebra.scale(algebra.differentiate(self.lagrangian, self.time), S.NegativeOne), *work)

    @cached_property
    def turns(self) -> list[SmallTurn]:
        """Small turns of the bodies about their axes, three for each body. They are the last coordinates."""
        first = len(self.q) - 3 * len(self.entries)
        return [
            SmallTurn(begin + k, (begin + (k + 1) % 3, begin + (k + 2) % 3), entries, k)
            for begin, entries in zip(range(first, len(self.q), 3), self.entries, strict=True)
            for k in range(3)
        ]

    def turned(self, terms: MonomialSum, turn: SmallTurn) -> MonomialSum:
        """Return the derivative of a sum of monomials along a small turn of a body.

        The turn changes the rotation matrix R by dR = R E, where E is the cross product with its unit axis.
        """
        algebra, parts = self.algebra, []
        for row in range(3):
            ahead, behind = (turn.entries[3 * row + (turn.axis + step) % 3] for step in (1, 2))
            parts.append(algebra.multiply(algebra.differentiate(terms, ahead), self.algebra.read(behind)))
            slope = algebra.scale(algebra.differentiate(terms, behind), S.NegativeOne)
            parts.append(algebra.multiply(slope, self.algebra.read(ahead)))
        return algebra.add({}, *parts)

    def at_constant_velocities(self, terms: MonomialSum) -> MonomialSum:
        """Return the time derivative of a sum of monomials at constant velocities: dq/dt = v, dv/dt = 0."""
        algebra = self.algebra
        moved = [
            algebra.multiply(algebra.differentiate(terms, q), self.algebra.read(v))
            for q, v in zip(self.q, self.v, strict=True)
        ]
        moved += [
            algebra.multiply(self.turned(terms, turn), self.algebra.read(self.v[turn.coordinate]))
            for turn in self.turns
        ]
        return algebra.merge_angles(algebra.add({}, *moved, algebra.differentiate(terms, self.time)))

    def read(self, expression: Any) -> MonomialSum:
        """Return a stated expression as a sum of monomials. Decimals become fractions: 0.1 is one tenth."""
        plain = expression.xreplace(self.plain)
        decimals = sorted(plain.atoms(Float), key=str)
        if decimals:
            self.decimal = True
            plain = plain.xreplace({number: Rational(repr(float(number))) for number in decimals})
        return self.algebra.read(differentiable(plain))

    def jumps(self, *symbols: Any, twice: bool = False) -> bool:
        """Return True if L, the dissipation or a force has one of `symbols` inside a function that jumps, such as sign.

        If `twice` is true, Abs counts too, whose derivative jumps.
        """
        statement = self.statement
        stated = (statement.lagrangian, statement.dissipation, *statement.forces)
        kinds = (*JUMPING, sympy.Abs) if twice else JUMPING
        plain = [expression.xreplace(self.plain) for expression in stated]
        return any(any(node.has(*symbols) for node in expression.atoms(*kinds)) for expression in plain)


BUDGET = 300_000
"""Largest number of monomials that one part of a derivation creates, such as its energy. They take 3 to 4 s. The
equations of a chain of 30 links have 200,000."""
EXPANDED_BLOCK = 3
"""Largest number of coupled coordinates whose accelerations are solved by determinants that are multiplied out. The
determinants of larger blocks stay nested."""
EXPANDED_WITH_MULTIPLIERS = 6
"""Largest number of coupled accelerations and multipliers that are solved by determinants that are multiplied out. Half
of their matrix is zero, and other terms often cancel. Two masses on two rods, six unknowns, take 0.3 s, with formulas a
third as long as nested ones."""
EXPANDED_TERMS = 10_000
"""Largest number of monomials of a solution by determinants that are multiplied out. They take 0.1 s. The determinants
of longer solutions stay nested. Three links need 2,000."""
LONGEST_FORMULA = 20_000  # Largest number of operations in one acceleration, about 50 printed pages
LONGEST_SLOPES = 5_500
"""Largest number of operations in the derivatives of L by all coordinates together. With more, a derivation is refused.
15 bodies with forces between all pairs have 5,000, and their derivation takes 6 s. A chain of 30 links has 2,000."""
LARGEST_FRACTION = 10**6
"""Largest numerator and denominator of fractions that are shown, if the statement has decimals."""


class TextbookAlgebra(StatedAlgebra):
    """Textbook derivation of a statement as sums of monomials. Each part is computed once."""

    def __init__(self, statement: Statement, positive: Collection[str] = ()) -> None:
        super().__init__(statement, BUDGET, positive)
        self.stated = {symbol: expression for expression, symbol in self.plain.items()}
        self.collector = SumWriter(self.algebra, frozenset(self.q), frozenset((*self.q, *self.v, *self.a, self.time)))

    @cached_property
    def mass(self) -> list[list[MonomialSum]]:
        """Rows of the mass matrix M = dp/dv, merged and shortened."""
        return [[shortened(self.algebra, entry) for entry in row] for row in super().mass]

    @cached_property
    def pulls(self) -> list[MonomialSum]:
        """Generalized forces dL/dq, one for each coordinate.

        For a small turn, the force is the derivative of L along the turn, plus the component of p x w about its axis,
        with the angular momentum p and the rates w of the body.
        """
        self.require_short_slopes()
        slopes = [self.algebra.differentiate(self.lagrangian, q) for q in self.q]
        for turn in self.turns:
            x, y = turn.others
            ahead, behind = (
                self.algebra.multiply(self.momenta[i], self.algebra.read(self.v[j])) for i, j in ((x, y), (y, x))
            )
            slope = self.turned(self.lagrangian, turn)
            slopes[turn.coordinate] = self.algebra.add(slope, ahead, self.algebra.scale(behind, S.NegativeOne))
        return [self.algebra.merge_angles(slope) for slope in slopes]

    def require_short_slopes(self) -> None:
        """Raise TooLargeError if the derivatives dL/dq of all coordinates would be too long, without computing them.

        The operations in each term of L are counted once for each coordinate in the term.
        """
        algebra, operations = self.algebra, 0
        for monomial in self.lagrangian:
            symbols = frozenset().union(*(algebra.free(k) for k, _ in monomial))
            operations += len(symbols.intersection(self.q)) * algebra.size(monomial)
        if operations > LONGEST_SLOPES:
            raise TooLargeError

    @cached_property
    def drifts(self) -> list[MonomialSum]:
        """Rates of the momenta at constant velocities, (dp/dq) v + dp/dt, one for each coordinate."""
        return [self.at_constant_velocities(p) for p in self.momenta]

    @cached_property
    def remainders(self) -> list[MonomialSum]:
        """Terms other than M a on the left side of each equation: (dp/dq) v + dp/dt - dL/dq + dD/dv."""
        algebra = self.algebra
        return [
            algebra.merge_angles(algebra.add({}, drift, algebra.scale(pull, S.NegativeOne), drag))
            for drift, pull, drag in zip(self.drifts, self.pulls, self.drags, strict=True)
        ]

    @cached_property
    def right_sides(self) -> list[MonomialSum]:
        """Right-hand sides h of M a = h + constraint forces, for each coordinate: stated forces less `remainders`."""
        forces = [self.read(force) for force in self.statement.forces]
        return [
            self.algebra.merge_angles(self.algebra.add(force, self.algebra.scale(rest, S.NegativeOne)))
            for force, rest in zip(forces, self.remainders, strict=True)
        ]

    def accelerated(self, rests: Sequence[MonomialSum]) -> list[Any]:
        """Return M a + rest, one expression for each coordinate, in the stated symbols.

        `rests` has one sum of monomials for each coordinate, such as `remainders`. An expression has one term for each
        acceleration.
        """
        return [
            self.finish(
                sympy.Add(
                    *(self.collector.write(m) * a for m, a in zip(row, self.a, strict=True)),
                    self.collector.write(shortened(self.algebra, rest)),
                )
            )
            for row, rest in zip(self.mass, rests, strict=True)
        ]

    @cached_property
    def gradient(self) -> list[list[MonomialSum]]:
        """Gradients of the m constraints: dphi/dq for phi = 0 on positions, and dpsi/dv for psi = 0 on velocities."""
        rows = []
        for constraint in self.statement.constraints:
            zero, symbols = self.read(constraint.expression), self.q if constraint.holonomic else self.v
            row = [self.algebra.differentiate(zero, symbol) for symbol in symbols]
            for turn in self.turns if constraint.holonomic else ():
                row[turn.coordinate] = self.turned(zero, turn)
            rows.append(list(map(self.algebra.merge_angles, row)))
        return rows

    @cached_property
    def constraint_bias(self) -> list[MonomialSum]:
        """Terms gamma of the constraints on accelerations, G a + gamma = 0: rates of psi at constant velocities.

        psi is dphi/dt of a holonomic constraint phi = 0, or the constraint on velocities as stated.
        """
        return [
            self.at_constant_velocities(self.at_constant_velocities(zero) if constraint.holonomic else zero)
            for constraint in self.statement.constraints
            for zero in [self.read(constraint.expression)]
        ]

    @cached_property
    def split_by_multipliers(self) -> tuple[list[MonomialSum], list[list[MonomialSum]]]:
        """Right-hand sides h without the terms that contain multipliers, and the derivatives of h by the multipliers.

        The derivatives are rows, one for each coordinate.
        """
        algebra, symbols = self.algebra, [constraint.multiplier for constraint in self.statement.constraints]
        minus = partial(algebra.scale, number=S.NegativeOne)
        pushes = [[algebra.differentiate(right, s) for s in symbols] for right in self.right_sides]
        parts = [
            [minus(algebra.multiply(push, self.algebra.read(s))) for push, s in zip(row, symbols, strict=True)]
            for row in pushes
        ]
        rest = [algebra.merge_angles(algebra.add(h, *part)) for h, part in zip(self.right_sides, parts, strict=True)]
        return rest, pushes

    @cached_property
    def motion(self) -> list[Any]:
        """The accelerations a, followed by the multipliers lambda if there are constraints, solved block by block.

        They solve M a - (G^T + B) lambda = h and G a = -gamma, where M is the mass matrix and G the gradient of the
        constraints. B lambda is the part of the stated forces that contains multipliers, and h has the other terms.
        """
        if has_large_block([list(map(bool, row)) for row in self.mass]):
            raise TooLargeError
        negative = partial(self.algebra.scale, number=S.NegativeOne)
        right, pushes = self.split_by_multipliers
        bias = [*right, *map(negative, self.constraint_bias)]
        columns = [
            [self.algebra.add(row[i], push[k]) for k, row in enumerate(self.gradient)] for i, push in enumerate(pushes)
        ]
        rows = [[*mass, *map(negative, column)] for mass, column in zip(self.mass, columns, strict=True)]
        rows += [[*row, *({} for _ in self.gradient)] for row in self.gradient]
        solved: dict[int, Any] = {}
        count = range(len(rows))
        for block in coupled_blocks([[bool(rows[i][j] or rows[j][i]) for j in count] for i in count]):
            matrix = [[rows[i][j] for j in block] for i in block]
            solved.update(zip(block, self.solve(block, matrix, [bias[i] for i in block]), strict=True))
        return [solved[i] for i in range(len(solved))]

    def solve(self, block: list[int], matrix: list[list[MonomialSum]], bias: list[MonomialSum]) -> list[Any]:
        """Return the unknowns of one block of matrix * x = bias, as formulas in the stated symbols.

        `block` has the indices of the unknowns. Determinants are multiplied out if this stays short. Raises
        StatementError for a singular matrix.
        """
        has_multipliers = any(i >= len(self.q) for i in block)
        if len(block) <= (EXPANDED_WITH_MULTIPLIERS if has_multipliers else EXPANDED_BLOCK):
            with suppress(TooLargeError), self.algebra.at_most(EXPANDED_TERMS):
                above, determinant = expanded_cofactors(self.algebra, matrix, bias)
                if not determinant:
                    raise self.singular(block)
                return [self.finish(self.collector.quotient(terms, determinant)) for terms in above]
        # Cofactors that are too long stay products of nested minors.
        entries = [[self.collector.write(entry) for entry in row] for row in matrix]
        right = [self.collector.write(entry) for entry in bias]
        if vanishes(entries):
            raise self.singular(block)
        return [self.finish(expression) for expression in NestedCofactors(entries, right, LONGEST_FORMULA).solution()]

    def singular(self, block: list[int]) -> StatementError:
        """Return the StatementError for a block of unknowns (indices) whose matrix is singular at every state."""
        n = len(self.q)
        names = [self.statement.names[i] for i in block if i < n]
        laws = [self.statement.constraints[i - n].name for i in block if i >= n]
        still = [self.statement.names[i] for i in block if i < n and not any(self.mass[i])]
        if still and not laws:
            return StatementError(
                f"{listing(still)} {'has' if len(still) == 1 else 'have'} no inertia, and an equation of motion of "
                "first order has no accelerations in it: read it in equations(). The compiled model uses its time "
                "derivative."
            )
        if laws:
            return StatementError(
                f"the accelerations of {listing(names)} and the multipliers of {listing(laws)} are not determined by a "
                "formula, at any state: the constraints depend on one another, or a motion that they allow has no "
                "inertia. Drop a constraint that follows from the others, or add the kinetic energy that is missing."
            )
        return StatementError(
            f"the mass matrix of {listing(names)} is singular at every state, so the accelerations are not determined: "
            "give each coordinate inertia of its own in the kinetic energy, or state fewer coordinates."
        )

    def show(self, terms: MonomialSum) -> Any:
        """Return a sum as an expression in the stated symbols, collected as in a textbook."""
        return self.finish(self.collector.write(shortened(self.algebra, terms)))

    def finish(self, expression: Any) -> Any:
        """Return an expression with the stated symbols in place of dummies, and decimals for fractions hard to read."""
        expression = printable(expression).xreplace(self.stated)
        if not self.decimal:
            return expression
        fractions = sorted(expression.atoms(Rational), key=str)
        return expression.xreplace({number: Float(number) for number in fractions if _is_unreadable(number)})

    def by_coordinate(self, parts: Iterable[Any]) -> Mapping[Any, Any]:
        """Return {coordinate: part} for `parts`, which has one expression for each coordinate in order."""
        return MappingProxyType(dict(zip(self.statement.coordinates, parts, strict=True)))


def _is_unreadable(number: Any) -> bool:
    """Return True for a fraction that is better shown as a decimal, such as 981/100; False for 1/2 and 1/3."""
    numerator, denominator = abs(int(number.p)), int(number.q)
    if max(numerator, denominator) > LARGEST_FRACTION:
        return True
    while denominator % 2 == 0:
        denominator //= 2
    while denominator % 5 == 0:
        denominator //= 5
    return denominator == 1 and int(number.q) > 8


ROUNDS = 6
"""Largest number of rounds of a proof. Each round multiplies out roots and quotients, and removes one level of them."""

MOST_PROOF_MONOMIALS = 40_000  # Largest number of monomials of one proof, which take half a second
_COMPOSITE = (sympy.sin, sympy.cos, sympy.sinh, sympy.cosh, sympy.tan)
_SQUARES = {sympy.sin: (sympy.cos, -1), sympy.cosh: (sympy.sinh, 1)}  # f**2 = 1 + sign * g**2, by function f


def is_identity(algebra: Algebra, terms: MonomialSum) -> bool:
    """Return True if the sum is proven to be zero, and False if no proof was found."""
    try:
        with algebra.at_most(MOST_PROOF_MONOMIALS):
            return not canonical(algebra, terms)
    except TooLargeError:
        return False


def canonical(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return a multiple of the sum as a polynomial in nearly independent factors. It is empty for a proven zero."""
    terms = algebra.merge_angles(terms)
    for _ in range(ROUNDS):
        if not terms:
            break
        before = terms
        terms = _polynomial(algebra, _with_least_angles(algebra, _cleared(algebra, terms)))
        if terms == before:
            break
    return terms


def _cleared(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return the sum multiplied by its denominators, with powers of sums expanded: x/(y + z) + 1 becomes x + y + z."""
    lowest: dict[int, Any] = {}
    for monomial in terms:
        for k, e in monomial:
            if algebra.factors[k].is_Add or isinstance(algebra.factors[k], _COMPOSITE):
                lowest[k] = min(lowest.get(k, 0), e)

    def cleared(monomial: Monomial, number: Any) -> MonomialSum:
        powers = dict(monomial)
        product: MonomialSum = {tuple((k, e) for k, e in monomial if k not in lowest): number}
        for k, least in lowest.items():
            total = powers.get(k, 0) - least
            whole = int(total // 1)
            if total != whole:
                product = algebra.multiply(product, {((k, Rational(total) - whole),): S.One})
            product = _times(algebra, product, k, whole)
        return product

    return algebra.add({}, *starmap(cleared, terms.items()))


def _times(algebra: Algebra, product: MonomialSum, k: int, exponent: int) -> MonomialSum:
    """Return `product` times factor `k` of the algebra to the power `exponent` >= 0. A sum is multiplied out."""
    factor = algebra.factors[k]
    if not exponent:
        return product
    if not factor.is_Add:
        return algebra.multiply(product, {((k, exponent),): S.One})
    inner = algebra.add({}, *(algebra.read(part) for part in factor.args))
    for _ in range(exponent):
        product = algebra.multiply(product, inner)
    return product


def _with_least_angles(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return the sum with sin, cos and tan expanded in sines and cosines of the smallest parts of all its angles.

    In sin(x) + cos(x/2) the smallest part is x/2, and sin(x) becomes 2 sin(x/2) cos(x/2).
    """
    present = dict.fromkeys(k for monomial in terms for k, _ in monomial)
    angles = [k for k in present if isinstance(algebra.factors[k], (sympy.sin, sympy.cos, sympy.tan))]
    units = _units([algebra.factors[k].args[0] for k in angles])
    table = {k: _expanded(algebra, algebra.factors[k], units) for k in angles}
    table = {k: new for k, new in table.items() if new != algebra.factors[k]}
    if not table:
        return terms

    def expanded(monomial: Monomial, number: Any) -> MonomialSum:
        product: MonomialSum = {tuple(factor for factor in monomial if factor[0] not in table): number}
        for k, e in monomial:
            if k in table:
                above, below = table[k].as_numer_denom()
                for part, power in ((above, e), (below, -e)):
                    product = algebra.multiply(product, algebra.read(part**power))
        return product

    return algebra.add({}, *starmap(expanded, terms.items()))


def _units(arguments: list[Any]) -> dict[Any, Any]:
    """Return {term: number}: the smallest parts number * term, of which all angles `arguments` contain whole multiples.

    For the angles x/2 + y and 3 x the result is {x: 1/2, y: 1}.
    """
    shares: dict[Any, list[Any]] = {}
    for argument in arguments:
        for part in sympy.Add.make_args(argument.expand()):
            number, rest = part.as_coeff_Mul()
            if number.is_Rational:
                shares.setdefault(rest, []).append(number)
    return {
        rest: Rational(gcd(*(int(n.p) for n in numbers)), lcm(*(int(n.q) for n in numbers)))
        for rest, numbers in shares.items()
    }


def _expanded(algebra: Algebra, function: Any, units: dict[Any, Any]) -> Any:
    """Return a sine, cosine or tangent in terms of sines and cosines of the smallest parts of its angle.

    `units` maps a term x to the number c of its smallest part c x. With {x: 1/2}, sin(x) is 2 sin(x/2) cos(x/2). The
    cosine of N c x is a polynomial of degree N, computed in about N^2 operations. The cosine of a sum has as many terms
    as the product of the numbers of terms of its parts. Both costs are subtracted from the algebra's budget in advance.
    """
    symbols: dict[Any, Any] = {}
    argument, terms = S.Zero, 1
    for part in sympy.Add.make_args(function.args[0].expand()):
        number, rest = part.as_coeff_Mul()
        unit = rest * units[rest] if rest in units and number.is_Rational else part
        multiple = number / units.get(rest, number)
        argument += symbols.setdefault(unit, Dummy(real=True)) * multiple
        terms *= 1 + abs(int(multiple))
        algebra.spend(int(multiple) ** 2 + terms)
    expanded = function.func(argument)
    if isinstance(expanded, sympy.tan):
        expanded = sympy.sin(argument) / sympy.cos(argument)
    back = {symbol: unit for unit, symbol in symbols.items()}
    return sympy.expand_trig(expanded).xreplace(back)


def _polynomial(algebra: Algebra, terms: MonomialSum) -> MonomialSum:
    """Return the sum with sin^2 replaced by 1 - cos^2, and cosh^2 by 1 + sinh^2, so that equal sums look equal."""

    def reduced(monomial: Monomial, number: Any) -> MonomialSum:
        product: MonomialSum = {ONE: number}
        for k, e in monomial:
            factor = algebra.factors[k]
            other = _SQUARES.get(factor.func)
            if other is None or not isinstance(e, int) or e < 2:
                product = algebra.multiply(product, {((k, e),): S.One})
                continue
            function, sign = other
            square = algebra.read(1 + sign * function(factor.args[0]) ** 2)
            for _ in range(e // 2):
                product = algebra.multiply(product, square)
            if e % 2:
                product = algebra.multiply(product, {((k, 1),): S.One})
        return product

    return algebra.add({}, *starmap(reduced, terms.items()))
