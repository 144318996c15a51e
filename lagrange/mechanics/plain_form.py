"""Replace functions of time such as x(t) by SymPy symbols, and simplify, evaluate and compare expressions.

Analyses whose formulas get too long are refused.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice, pairwise
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.equations.terms import Algebra, TooLargeError, differentiable, printable
from lagrange.errors import StatementError
from lagrange.statement.coordinate import acceleration_of, t
from lagrange.statement.given.motion import motion_of
from lagrange.statement.random_states import ALL_KINDS, MOST_DRAWS, SampleKind, SamplePoint, holds, random_points
from lagrange.statement.statement import Statement

LONGEST_FACTORED = 400
"""Largest number of operations in an expression that is expanded and factored: about 0.2 s of work."""

MOST_TERMS = 2_000  # Largest number of terms, after expansion, of an expression that is factored. 1,300 terms take 1 s

MOST_SYMBOLS = 12
"""Largest number of symbols, functions and roots in an expression that is factored: with more it takes long."""

HIGHEST_DEGREE = 100
"""Largest numerator or denominator of an exponent in an expression that is factored: x**3.001 has degree 3001."""

MERGED_TERMS = 20_000  # Largest number of products in merging sines and cosines: about 0.2 s

LARGEST_FRACTION = 10
"""Largest numerator and denominator of a fraction in an expression with decimals. Other fractions become decimals."""

_ANGLES = (sympy.sin, sympy.cos, sympy.tan)
_INVERSES = (sympy.asin, sympy.acos, sympy.atan)


def simplest(expression: Any) -> Any:
    """Return the shortest of several equivalent forms of an expression, by number of operations."""
    if not expression.args or expression.is_Piecewise or expression.has(sympy.Piecewise):
        return expression
    if expression.has(sympy.Float):  # polynomials of decimals have no factors
        return in_decimals(simplest(in_fractions(expression)))
    best = expression
    exponents = [power.exp for power in best.atoms(sympy.Pow) if power.exp.is_Rational]
    few = _generators(best) <= MOST_SYMBOLS and all(max(abs(e.p), e.q) <= HIGHEST_DEGREE for e in exponents)
    if size(best) <= LONGEST_FACTORED:
        best = min((best, multiplied_out(best), sympy.factor_terms(best)), key=size)
        if few and term_count(best) <= MOST_TERMS:
            best = min((best, sympy.factor(best)), key=size)
    if any(f.args[0].has(*_INVERSES) for f in best.atoms(*_ANGLES)):
        best = min((best, sympy.expand_trig(best), sympy.factor(sympy.expand_trig(best))), key=size)
    if best.has(*_ANGLES) and size(best) <= LONGEST_FACTORED:
        merged = _merged(best)
        best = min((best, merged, sympy.factor(merged) if few else sympy.factor_terms(merged)), key=size)
    return best


def rational_below(expression: Any) -> Any:
    """Return an expression without square roots in its denominator.

    An expression is returned unchanged if it is long, or has roots within roots or functions, as |sqrt(a) - b|. A root
    of a base b is replaced by a symbol r with r^2 = b, and the fraction is multiplied by the conjugate of its
    denominator.
    """
    powers = [x for x in sorted(expression.atoms(sympy.Pow), key=str) if x.exp.is_Rational and x.exp.q == 2]
    roots = {base: sympy.Dummy("r") for base in dict.fromkeys(x.base for x in powers)}
    around = [*roots, *expression.atoms(sympy.Function)]
    nested = any(outer.has(*powers) for outer in around) if powers else True
    if nested or size(expression) > LONGEST_FACTORED or _generators(expression) > MOST_SYMBOLS:
        return expression
    replaced = expression.xreplace({x: roots[x.base] ** x.exp.p for x in powers})
    above, below = sympy.fraction(sympy.together(replaced))
    for base, root in roots.items():
        if below.has(root):
            conjugate = below.xreplace({root: -root})
            above, below = above * conjugate, below * conjugate
        above, below = (sympy.rem(sympy.expand(x), root**2 - base, root) for x in (above, below))
    short = sympy.factor(sympy.cancel(above / below))
    return short.xreplace({root: sympy.sqrt(base) for base, root in roots.items()})


def root_of_square(expression: Any) -> Any:
    """Return the square root of an expression: for positive a, b and a - 2 sqrt(a b) + b it is |sqrt(a) - sqrt(b)|."""
    powers = [x for x in expression.atoms(sympy.Pow) if x.base.is_Symbol and x.base.is_positive and x.exp.is_Rational]
    bases = sorted({x.base for x in powers if not x.exp.is_Integer}, key=str)
    if not bases or size(expression) > LONGEST_FACTORED or _generators(expression) > MOST_SYMBOLS:
        return sympy.sqrt(expression)
    degree = {base: math.lcm(*(x.exp.q for x in powers if x.base == base)) for base in bases}
    roots = {base: sympy.Dummy(base.name, positive=True) for base in bases}
    table = {x: roots[x.base] ** (x.exp * degree[x.base]) for x in powers if x.base in roots}
    table |= {base: root ** degree[base] for base, root in roots.items()}
    result = sympy.sqrt(sympy.factor(expression.xreplace(table)))
    return result.xreplace({root: base ** sympy.Rational(1, degree[base]) for base, root in roots.items()})


def in_fractions(expression: Any) -> Any:
    """Return an expression with each decimal replaced by the fraction that its digits state: 0.1 becomes 1/10."""
    decimals = sorted(expression.atoms(sympy.Float), key=str)
    return expression.xreplace({x: sympy.Rational(repr(float(x))) for x in decimals})


def in_decimals(expression: Any) -> Any:
    """Return an expression with decimals in place of fractions that contain numbers above LARGEST_FRACTION."""
    fractions = [x for x in sorted(expression.atoms(sympy.Rational), key=str) if max(abs(x.p), x.q) > LARGEST_FRACTION]
    return expression.xreplace({x: sympy.Float(float(x)) for x in fractions if x.q > 1})


def _merged(expression: Any) -> Any:
    """Return an expression simplified by sin^2 + cos^2 = 1 and addition theorems, in numerator and denominator."""
    above, below = sympy.fraction(sympy.together(expression))
    algebra = Algebra(MERGED_TERMS)
    try:
        above, below = (algebra.write(algebra.merge_angles(algebra.read(part))) for part in (above, below))
    except TooLargeError:
        return expression
    return above / below


def _generators(expression: Any) -> int:
    """Return the number of symbols, trigonometric functions and roots in an expression."""
    roots = [power for power in expression.atoms(sympy.Pow) if not power.exp.is_Integer]
    return len(expression.free_symbols) + len(expression.atoms(*_ANGLES)) + len(roots)


def term_count(expression: Any) -> int:
    """Return the largest number of terms that an expression may have after expansion; a function is one term."""
    if expression.is_Add:
        return sum(map(term_count, expression.args))
    if expression.is_Mul:
        return math.prod(map(term_count, expression.args))
    if expression.is_Pow and expression.exp.is_Integer:
        exponent = abs(int(expression.exp))
        return math.comb(term_count(expression.base) + exponent - 1, exponent)
    return 1


def multiplied_out(expression: Any) -> Any:
    """Return an expression after expansion of its products, or unchanged if it is long or would become long."""
    few = size(expression) <= LONGEST_FACTORED and term_count(expression) <= MOST_TERMS
    return sympy.expand(expression) if few else expression


def size(expression: Any) -> int:
    """Return the number of operations of an expression."""
    return int(sympy.count_ops(expression))


def is_zero(expression: Any) -> bool:
    """Return True if SymPy can show that an expression is identically zero."""
    return bool(simplest(expression).is_zero if expression.is_zero is None else expression.is_zero)


STATES = 3  # Number of random states at which an expression must be zero to count as identically zero

RESIDUAL = 1e-20
"""Largest value of an expression that counts as zero, relative to its terms, with FORMULA_DIGITS digits."""


def vanishes(form: PlainForm, expression: Any, kinds: Sequence[SampleKind] = ALL_KINDS) -> bool:
    """Return True if an expression is zero at random states of the system `form`.

    `kinds` are the rules by which states are drawn, such as near the initial state. If the expression has a value at
    too few states, SymPy decides.
    """
    if expression == 0:
        return True
    points = random_points(form.statement, seed=7, kinds=kinds)
    zero = holds(points, lambda point: _is_rounding(expression, form.at(point)), STATES)
    return is_zero(expression) if zero is None else zero


def vanishes_in_symbols(expression: Any) -> bool:
    """Return True if an expression is zero at random values of its symbols; False if it cannot be evaluated."""
    values = random_values(expression.free_symbols)
    return expression == 0 or bool(holds(values, lambda numbers: _is_rounding(expression, numbers), STATES))


def random_values(symbols: Iterable[Any]) -> Iterator[dict[Any, Any]]:
    """Yield `MOST_DRAWS` tables {symbol: random fraction from 1/2 to 2}, the same ones in each call."""
    draw, ordered = random.Random(7), sorted(symbols, key=str)
    return ({x: sympy.Rational(draw.randrange(64, 256), 128) for x in ordered} for _ in range(MOST_DRAWS))


def _is_rounding(expression: Any, values: Mapping[Any, Any]) -> bool | None:
    """Return True if the value of an expression is zero within rounding errors; None if it has no value."""
    value, terms = number(expression, values), size_of_terms(expression, values)
    return None if value != value or terms != terms else abs(value) <= RESIDUAL * terms


def size_of_terms(expression: Any, values: Mapping[Any, Any]) -> float:
    """Return the magnitude of the terms of an expression, to which its rounding error is proportional.

    Each sum in the expression is replaced by the sum of the magnitudes of its terms: (x - y) z has (|x| + |y|) |z|.
    """
    if expression.is_Add:
        return sum(size_of_terms(term, values) for term in expression.args)
    if expression.is_Mul and expression.has(sympy.Add):
        return math.prod(size_of_terms(factor, values) for factor in expression.args)
    if expression.is_Pow and expression.base.is_Add and expression.exp.is_Integer and expression.exp.is_positive:
        return size_of_terms(expression.base, values) ** int(expression.exp)
    return abs(number(expression, values))


MOST_NODES = 15_000  # Largest number of nodes, in all expression trees, that one analysis shortens: about 15 s of work


class Shortener:
    """Shortens the expressions of one analysis. Methods raise StatementError if these are too long altogether.

    `what` names the expressions in the error message. The function `vanishes` returns True for an expression that is
    identically zero.
    """

    def __init__(self, what: str, vanishes: Callable[[Any], bool]) -> None:
        self.what, self.vanishes, self.nodes = what, vanishes, 0

    def short(self, expression: Any) -> Any:
        """Return the shortest form of an expression, 0 if it vanishes.

        Raises StatementError if the expressions shortened so far exceed MOST_NODES nodes.
        """
        if not expression.args:
            return expression
        tree = sympy.preorder_traversal(expression)
        self.nodes += sum(1 for _ in islice(tree, MOST_NODES + 1 - self.nodes))
        if self.nodes > MOST_NODES:
            raise StatementError(
                f"{self.what} would be formulas of more than {MOST_NODES:,} symbols and operations: give numbers "
                "in place of parameters, by substitute({parameter: number}), or choose a point with more zeros."
            )
        return sympy.S.Zero if self.vanishes(expression) else simplest(expression)

    def product(self, *factors: Any) -> Any:
        """Return the product of the matrices `factors`, with simplified entries."""
        result = factors[0]
        for factor in factors[1:]:
            result = (result * factor).applyfunc(self.short)
        return result

    def solved(self, matrix: Any, right: Any) -> Any:
        """Return the matrix X with `matrix` X = `right`, by elimination. Raises ZeroDivisionError if it is singular."""
        m, short = matrix.rows, self.short
        wide = sympy.Matrix.hstack(matrix, right)
        for j in range(m):
            candidates = [i for i in range(j, m) if wide[i, j] != 0]
            if not candidates:
                raise ZeroDivisionError
            if wide.has(sympy.Float):
                candidates = [max(candidates, key=lambda i: abs(complex(wide[i, j])) if wide[i, j].is_number else 1.0)]
            wide.row_swap(j, min(candidates, key=lambda i: (size(wide[i, j]), i)))
            wide[j, :] = (wide[j, :] / wide[j, j]).applyfunc(short)
            for i in range(m):
                if i != j and wide[i, j] != 0:
                    wide[i, :] = (wide[i, :] - wide[i, j] * wide[j, :]).applyfunc(short)
        return wide[:, m:]


IMAGINARY = 1e-20  # Largest imaginary part, relative to the real part, that is rounding

FORMULA_DIGITS = 30  # Decimal digits of an evaluated formula: compared with doubles, its own rounding is negligible


@dataclass(frozen=True, eq=False)
class PlainForm:
    """Energies, momenta and equations of a statement, in SymPy symbols q, v, a instead of functions of time.

    q are coordinates, v velocities and a accelerations. The residual of the equation of motion of coordinate i is
    dp_i/dt - dL/dq_i + dD/dv_i - Q_i, without the forces of constraints.
    """

    statement: Statement

    @cached_property
    def plain(self) -> Mapping[Any, Any]:
        """Mapping of coordinates, velocities and accelerations, as functions of time, to symbols in their place."""
        return self.statement.plain

    @cached_property
    def q(self) -> tuple[Any, ...]:
        """SymPy symbols of the n coordinates, in place of functions of time."""
        return tuple(self.plain[q] for q in self.statement.coordinates)

    @cached_property
    def v(self) -> tuple[Any, ...]:
        """SymPy symbols of the n velocities, in place of first derivatives of functions of time."""
        return tuple(self.plain[v] for v in self.statement.velocities)

    @cached_property
    def a(self) -> tuple[Any, ...]:
        """SymPy symbols of the n accelerations, in place of second derivatives of functions of time."""
        return tuple(self.plain[acceleration_of(q)] for q in self.statement.coordinates)

    @cached_property
    def lagrangian(self) -> Any:
        """The Lagrangian L as an expression in the symbols `q` and `v`."""
        return self.read(self.statement.lagrangian)

    @cached_property
    def forces(self) -> tuple[Any, ...]:
        """The n generalized forces without a potential, Q - dD/dv, where D is the dissipation."""
        dissipation = self.read(self.statement.dissipation)
        return tuple(
            self.read(force) - dissipation.diff(v) for force, v in zip(self.statement.forces, self.v, strict=True)
        )

    @cached_property
    def momenta(self) -> tuple[Any, ...]:
        """The n momenta dL/dv as expressions in the symbols `q` and `v`."""
        return tuple(self.lagrangian.diff(v) for v in self.v)

    @cached_property
    def initial_momenta(self) -> tuple[float | None, ...]:
        """The n momenta at the initial state; None for one that has no real value, as without values of parameters."""
        statement = self.statement
        values = dict(zip((*self.q, *self.v), statement.initial, strict=True)) | dict(statement.defaults) | {t: 0.0}
        complete = all(p in statement.defaults for p in statement.parameters)
        momenta = [number(p, values) if complete else complex("nan") for p in self.momenta]
        return tuple(value.real if value == value and not value.imag else None for value in momenta)

    @cached_property
    def mass(self) -> Any:
        """The mass matrix d2L/dv2 (n, n), a SymPy matrix."""
        return sympy.Matrix([[simplest(p.diff(v)) for v in self.v] for p in self.momenta])

    @cached_property
    def residuals(self) -> tuple[Any, ...]:
        """The n residuals of the equations of motion, in the symbols q, v and a, without constraint forces."""
        return tuple(
            time_derivative(p, self.plain) - self.lagrangian.diff(q) - force
            for p, q, force in zip(self.momenta, self.q, self.forces, strict=True)
        )

    def read(self, expression: Any) -> Any:
        """Return a stated expression with symbols for functions of time, in a form that SymPy can differentiate."""
        return differentiable(expression.xreplace(self.plain))

    def written(self, expression: Any) -> Any:
        """Return an expression with the symbols q, v and a replaced by the user's functions of time."""
        return printable(expression).xreplace(self.stated)

    @cached_property
    def stated(self) -> Mapping[Any, Any]:
        """Mapping of the symbols q, v and a to the user's functions of time; the inverse of `plain`."""
        return {symbol: leaf for leaf, symbol in self.plain.items()}

    def at(self, point: SamplePoint) -> dict[Any, Any]:
        """Return {symbol: exact fraction} for the coordinates, velocities, parameters and t at a sample point."""
        numbers = [*zip(self.q, point.q, strict=True), *zip(self.v, point.v, strict=True)]
        numbers += [*point.parameters.items(), (t, point.t)]
        return {symbol: sympy.Rational(x) for symbol, x in numbers}


def time_derivative(expression: Any, plain: Mapping[Any, Any]) -> Any:
    """Return the total time derivative of an expression in t and symbols for coordinates, velocities, accelerations.

    The values of `plain` are the symbols of each coordinate, its velocity and its acceleration, in this order.
    """
    symbols = list(plain.values())
    rates = [pair for i in range(0, len(symbols), 3) for pair in pairwise(symbols[i : i + 3])]
    return sympy.Add(expression.diff(t), *(expression.diff(x) * rate for x, rate in rates))


def number(expression: Any, values: Mapping[Any, Any]) -> complex:
    """Return the value of an expression at `values`, {symbol: number}.

    The result is NaN if the expression has no value, or contains a function of time that is not known.
    """
    formula = prescribed(printable(expression))
    if formula.has(AppliedUndef):
        return complex("nan")
    # Symbols are matched by name, since the value of a function of time may contain another symbol of the same name.
    by_name = {symbol.name: sympy.Rational(x) if isinstance(x, float) else x for symbol, x in values.items()}
    result = formula.xreplace({s: by_name[s.name] for s in formula.free_symbols if s.name in by_name}).evalf(
        FORMULA_DIGITS
    )
    return complex(result) if result.is_number and result.is_finite else complex("nan")


def prescribed(expression: Any) -> Any:
    """Return an expression with known functions of time, and their derivatives, replaced by formulas in t."""
    if not expression.has(AppliedUndef):
        return expression
    table: dict[Any, Any] = {}
    for node in sorted(expression.atoms(AppliedUndef, sympy.Derivative), key=str):
        function = node.expr if node.is_Derivative else node
        motion = motion_of(function)
        if motion is not None and motion.values is not None:
            table[node] = motion.derivative(len(node.variables) if node.is_Derivative else 0)
    return expression.xreplace(table)


def real(expression: Any, values: Mapping[Any, Any]) -> float:
    """Return the value of an expression at `values`, {symbol: number}, or NaN if it has no value or is not real."""
    value = number(expression, values)
    return value.real if abs(value.imag) <= IMAGINARY * abs(value.real) else float("nan")


def numeric(matrix: Any, values: Any) -> Any:
    """Return the SymPy matrix at `values`, {symbol: number}: an array of doubles, or complex if an entry is complex."""
    entries = np.array([number(x, values) for x in matrix], dtype=complex).reshape(matrix.shape)
    return entries.real if not entries.imag.any() else entries


def momentum_names(statement: Statement, coordinates: Iterable[str]) -> list[str]:
    """Return a name for the momentum of each coordinate: p_x for x, with underscores appended if p_x is in use."""
    taken = [*statement.names, *(p.name for p in statement.parameters)]
    names: list[str] = []
    for coordinate in coordinates:
        name = f"p_{coordinate}"[:64]
        while name in (*taken, *names):
            name += "_"
        names.append(name)
    return names
