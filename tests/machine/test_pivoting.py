"""The inverse that Newton's method uses, against LAPACK: every order, any units, zeros on the diagonal, no inverse."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from lagrange.algorithm.linear.gauss_jordan import WRITTEN_OUT, inversion, row_stride
from lagrange.machine.backend import FloatArray
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module as printed

ORDERS = [1, 2, 3, 4, 5, 8, 12, WRITTEN_OUT, WRITTEN_OUT + 1, 30]


@cache
def compiled(n: int) -> tuple[Module, Callable[[int, int], bool]]:
    module = Module(printed([inversion(n)]), optimize=True)
    return module, ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)(module.address(inversion(n).name))


def invert(matrix: FloatArray) -> tuple[FloatArray, bool]:
    """Return the inverse and whether there is none; memory beside the matrix holds no numbers."""
    n = len(matrix)
    stride = row_stride(n)
    rows, scratch = np.full((n, stride), np.nan), np.full(3 * stride, np.nan)
    rows[:, :n] = matrix
    singular = compiled(n)[1](address(rows), address(scratch))
    return rows[:, :n], singular


@pytest.mark.few
@pytest.mark.parametrize("n", ORDERS)
def test_the_inverse_is_that_of_lapack(n: int) -> None:
    draw = np.random.default_rng(n)
    for hollow in (False, True):
        if hollow and n < 3:
            continue
        for _ in range(20):
            matrix = draw.normal(size=(n, n))
            if hollow:
                np.fill_diagonal(matrix, 0.0)
            found, singular = invert(matrix)
            expected = np.linalg.inv(matrix)
            # Gauss-Jordan with pivots errs by some n units of round-off times the condition number.
            bound = 10 * n * 2.0**-52 * np.linalg.cond(matrix)
            assert not singular and np.abs(found - expected).max() <= bound * np.abs(expected).max()


@pytest.mark.parametrize("n", ORDERS)
def test_units_do_not_matter(n: int) -> None:
    """Rows in one unit and columns in another: the inverse is as exact as without."""
    draw = np.random.default_rng(100 + n)
    for _ in range(20):
        matrix = draw.normal(size=(n, n))
        rows, columns = (2.0 ** draw.integers(-6, 7, n).astype(float) for _ in range(2))
        found, singular = invert(rows[:, None] * matrix * columns)
        plain = np.linalg.inv(matrix)
        bound = 10 * n * 2.0**-52 * np.linalg.cond(matrix)
        assert not singular
        assert np.abs(columns[:, None] * found * rows - plain).max() <= bound * np.abs(plain).max()


@pytest.mark.parametrize("n", ORDERS)
def test_a_matrix_without_an_inverse_is_told(n: int) -> None:
    matrix = np.random.default_rng(n).normal(size=(n, n))
    matrix[-1] = matrix[0] if n > 1 else 0.0
    assert invert(matrix)[1]
    assert invert(np.zeros((n, n)))[1]


@pytest.mark.parametrize("n", ORDERS)
def test_what_is_no_number_is_no_verdict_on_the_matrix(n: int) -> None:
    matrix = np.random.default_rng(n).normal(size=(n, n))
    matrix[n // 2, n // 3] = np.nan
    found, singular = invert(matrix)
    assert not singular and np.isnan(found).any()
