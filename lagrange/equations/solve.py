"""Solve M a = h in symbols by cofactors, so that the only divisor is the determinant.

Elimination divides by pivots. A pivot is a function of the state; it can vanish at a state where M is regular, and
then the formula is wrong exactly there, at theta = pi/2 or with straight arms. det M vanishes only where M is singular.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import mpmath
import sympy
from sympy import Add, Derivative, Integer, Mul, Rational, S
from sympy.core.function import AppliedUndef

from lagrange.equations.terms import ONE, Algebra, MonomialSum, TooLargeError, printable


def coupled_blocks(nonzero: Sequence[Sequence[bool]]) -> list[list[int]]:
    """Return the diagonal blocks of a symmetric matrix as index lists, each sorted."""
    blocks: list[list[int]] = []
    left = dict.fromkeys(range(len(nonzero)))
    while left:
        block, frontier = [], [next(iter(left))]
        del left[frontier[0]]
        while frontier:
            i = frontier.pop()
            block.append(i)
            reached = [j for j in left if nonzero[i][j]]
            for j in reached:
                del left[j]
            frontier += reached
        blocks.append(sorted(block))
    return blocks


def expanded_cofactors(
    algebra: Algebra, matrix: Sequence[Sequence[MonomialSum]], bias: Sequence[MonomialSum]
) -> tuple[list[MonomialSum], MonomialSum]:
    """Return the numerators of M^-1 h and the determinant, multiplied out and merged."""
    n = len(matrix)
    cofactors = [
        [_minor(algebra, matrix, _without(n, i), _without(n, j), (-1) ** (i + j)) for j in range(n)] for i in range(n)
    ]
    determinant = algebra.add({}, *(algebra.multiply(matrix[0][j], cofactors[0][j]) for j in range(n)))
    above = [algebra.add({}, *(algebra.multiply(bias[i], cofactors[i][j]) for i in range(n))) for j in range(n)]
    return [algebra.merge_angles(terms) for terms in above], algebra.merge_angles(determinant)


def _without(n: int, left_out: int) -> tuple[int, ...]:
    return tuple(k for k in range(n) if k != left_out)


def _minor(
    algebra: Algebra,
    matrix: Sequence[Sequence[MonomialSum]],
    rows: tuple[int, ...],
    columns: tuple[int, ...],
    sign: int,
) -> MonomialSum:
    if not rows:
        return {ONE: Integer(sign)}
    total: MonomialSum = {}
    for place, column in enumerate(columns):
        entry = matrix[rows[0]][column]
        if entry:
            rest = columns[:place] + columns[place + 1 :]
            total = algebra.add(
                total, algebra.multiply(entry, _minor(algebra, matrix, rows[1:], rest, sign * (-1) ** place))
            )
    return algebra.merge_angles(total)


def vanishes(matrix: Sequence[Sequence[Any]]) -> bool:
    """Return True if the determinant is zero at a generic point, in 50 digits."""
    point = _point(set().union(*(entry.free_symbols for row in matrix for entry in row)))
    with mpmath.workdps(50):
        numbers = mpmath.matrix([[_number(entry.xreplace(point)) for entry in row] for row in matrix])
        bound = mpmath.fprod(mpmath.norm(numbers[i, :]) for i in range(numbers.rows))
        return bool(abs(mpmath.det(numbers)) <= bound * mpmath.mpf(10) ** -30)


def value_somewhere(expression: Any) -> float:
    """Return the value of an expression at a generic point."""
    leaves = sorted(expression.atoms(AppliedUndef, Derivative), key=str)
    plain = expression.xreplace({leaf: sympy.Dummy(str(leaf)) for leaf in leaves})
    return float(sympy.N(plain.xreplace(_point(plain.free_symbols)), 30))


def _point(symbols: Iterable[Any]) -> dict[Any, Any]:
    ordered = sorted(symbols, key=str)
    return {symbol: Rational(2 * i + 3, 2 * i + 7) + Rational(1, i + 11) for i, symbol in enumerate(ordered)}


def _number(entry: Any) -> Any:
    value = sympy.N(printable(entry), 50)
    return mpmath.mpmathify(value) if value.is_finite else mpmath.mpf(1)


class NestedCofactors:
    """M^-1 h with the entries not multiplied out: one shared expression per minor.

    `longest` bounds the operations of each formula as it would be printed; TooLargeError above it.
    """

    def __init__(self, matrix: Sequence[Sequence[Any]], bias: Sequence[Any], longest: int) -> None:
        self._matrix = matrix
        self._bias = bias
        self._longest = longest
        self._entry_sizes = [[entry.count_ops() + 1 for entry in row] for row in matrix]
        self._minors: dict[tuple[tuple[int, ...], tuple[int, ...]], tuple[Any, int]] = {}

    def solution(self) -> list[Any]:
        """Return M^-1 h, n expressions over one determinant."""
        n = len(self._matrix)
        everything = tuple(range(n))
        determinant, below = self._minor(everything, everything)
        solution = []
        for j in range(n):
            parts, size = [], below
            for i in range(n):
                cofactor, length = self._minor(_without(n, i), _without(n, j))
                if cofactor != 0 and self._bias[i] != 0:
                    parts.append(Mul((-1) ** (i + j), cofactor, self._bias[i]))
                    size = self._bounded(size + length + self._bias[i].count_ops() + 1)
            solution.append(Add(*parts) / determinant)
        return solution

    def _minor(self, rows: tuple[int, ...], columns: tuple[int, ...]) -> tuple[Any, int]:
        if not rows:
            return S.One, 0
        key = (rows, columns)
        if key not in self._minors:
            parts, size = [], 0
            for place, column in enumerate(columns):
                entry = self._matrix[rows[0]][column]
                if entry != 0:
                    minor, length = self._minor(rows[1:], columns[:place] + columns[place + 1 :])
                    if minor != 0:
                        parts.append(Mul((-1) ** place, entry, minor))
                        size = self._bounded(size + length + self._entry_sizes[rows[0]][column])
            self._minors[key] = Add(*parts), size
        return self._minors[key]

    def _bounded(self, size: int) -> int:
        if size > self._longest:
            raise TooLargeError
        return size
