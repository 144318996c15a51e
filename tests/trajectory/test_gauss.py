"""Coefficients of collocation to all the digits that they are kept in, twice those of a double and more.

A coefficient that is wrong in its seventeenth digit shows in no order of convergence, only in what drifts over
millions of steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from lagrange.trajectory.tableaux.gauss import BITS, collocation_tableau, gauss_tableau, lagrange_basis

CLOSE = Fraction(1, 2 ** (BITS - 10))
"""Some thousand roundings to so many bits."""


def moments(weights: Sequence[Any], points: Sequence[Any], end: Any, most: int) -> list[Any]:
    """Return by how much the integrals of 1, x, x^2, ... from 0 to `end` are missed."""
    pairs = list(zip(weights, points, strict=True))
    return [abs(sum(w * x**k for w, x in pairs) - end ** (k + 1) / Fraction(k + 1)) for k in range(most)]


@pytest.mark.parametrize("stages", [1, 2, 3, 4, 5])
def test_gauss_integrates_twice_as_many_powers_as_it_has_stages(stages: int) -> None:
    A, b, c = gauss_tableau(stages)
    assert all(isinstance(entry, Fraction) for entry in (*b, *c, *(entry for row in A for entry in row)))
    assert max(moments(b, c, Fraction(1), 2 * stages)) < CLOSE
    assert moments(b, c, Fraction(1), 2 * stages + 1)[-1] > Fraction(1, 10**7)
    assert max(miss for row, end in zip(A, c, strict=True) for miss in moments(row, c, end, stages)) < CLOSE
    assert [float(x) for x in c] == pytest.approx((1 + np.polynomial.legendre.leggauss(stages)[0]) / 2, rel=1e-15)


@pytest.mark.parametrize("points", [(Fraction(1, 3), Fraction(1)), (Fraction(0), Fraction(1, 5), Fraction(4, 7))])
def test_collocation_is_exact_in_fractions(points: tuple[Fraction, ...]) -> None:
    A, b, c = collocation_tableau(points)
    assert tuple(c) == points
    assert moments(b, c, Fraction(1), len(points)) == [0] * len(points)
    for row, end in zip(A, c, strict=True):
        assert moments(row, c, end, len(points)) == [0] * len(points)


def test_a_basis_is_one_at_its_own_point_and_zero_at_the_others() -> None:
    points = (Fraction(0), Fraction(1, 5), Fraction(4, 7), Fraction(1))
    values = [[sum(a * x**k for k, a in enumerate(line)) for x in points] for line in lagrange_basis(points)]
    assert values == [[int(i == j) for j in range(4)] for i in range(4)]
