"""Tableaus of implicit collocation methods: their coefficients from the collocation points.

Coefficients are exact for exact points; Gauss's points are computed to many digits. A compiled step gets the
coefficients as exact numbers, because a tableau conserves only as well as they are accurate. Source: E. Hairer, C.
Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., 2006, II.1.2 and II.1.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

Abscissa = float | Fraction
Tableau = tuple[tuple[tuple[Any, ...], ...], tuple[Any, ...], tuple[Any, ...]]
"""A, b and c of a Runge-Kutta method."""

BITS = 200
"""Precision of Gauss's points and their coefficients, in bits."""


def lagrange_basis(points: Sequence[Abscissa]) -> list[list[Any]]:
    """Return the Lagrange polynomials of the points: each is 1 at one point and 0 at the others.

    A polynomial is the list of its coefficients, the constant first.
    """
    basis = []
    for point in points:
        line: list[Any] = [1]
        for other in points:
            if other != point:
                shifted = zip([0, *line], [*line, 0], strict=True)
                line = [(high - other * low) / (point - other) for high, low in shifted]
        basis.append(line)
    return basis


def collocation_tableau(points: Sequence[Abscissa]) -> Tableau:
    """Return the tableau A, b, c of collocation at the `points` c of [0, 1].

    A has the integrals of the Lagrange polynomials of the points from 0 to c_i, and b those from 0 to 1.
    """
    basis = lagrange_basis(points)

    def integral(line: Sequence[Any], end: Any) -> Any:
        return sum(factor * end**k / k for k, factor in enumerate(line, 1))

    A = tuple(tuple(integral(line, c) for line in basis) for c in points)
    return A, tuple(integral(line, 1) for line in basis), tuple(points)


def gauss_tableau(stages: int) -> Tableau:
    """Return the tableau A, b, c of Gauss's method: collocation at the zeros of the Legendre polynomial on [0, 1]."""
    zeros = [_zero(x, stages) for x in np.polynomial.legendre.leggauss(stages)[0]]
    A, b, c = collocation_tableau([(1 + x) / 2 for x in zeros])
    return tuple(tuple(map(_rounded, row)) for row in A), tuple(map(_rounded, b)), c


def lobatto_pair(stages: int) -> tuple[Any, ...]:
    """Return A, b, c of the method Lobatto IIIA with 2 or 3 stages, then the matrix A of Lobatto IIIB.

    The two methods are a symplectic pair, with the same b and c. Source: E. Hairer, C. Lubich, G. Wanner, Geometric
    Numerical Integration, 2nd ed., 2006, II.1.4 and VI.4.2.
    """
    A, b, c = collocation_tableau([Fraction(i, stages - 1) for i in range(stages)])
    conjugate = tuple(tuple(bj - bj * A[j][i] / bi for j, bj in enumerate(b)) for i, bi in enumerate(b))
    return A, b, c, conjugate


def _zero(near: float, degree: int) -> Fraction:
    """Return the zero, rounded to 200 bits, of the Legendre polynomial of a `degree` that is nearest to `near`.

    `near` is the zero as a double. Newton's method takes three steps in fractions, each of which doubles the number
    of correct digits.
    """
    x = Fraction(near)
    for _ in range(3):
        before, value = Fraction(1), x
        for n in range(1, degree):
            before, value = value, ((2 * n + 1) * x * value - n * before) / (n + 1)
        x = _rounded(x - value * (x**2 - 1) / (degree * (x * value - before)))
    return x


def _rounded(x: Fraction) -> Fraction:
    return Fraction(round(x * 2**BITS), 2**BITS)
