"""Symmetric banded systems, solved with pivoting, compared with LAPACK and with the same matrix as a full one."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.linear.gauss_jordan import UNROLLED_ORDER, invert_matrix, row_stride
from lagrange.algorithm.linear.symmetric import band_size, factor_pivoted, pivoted_size, solve_pivoted
from lagrange.machine.backend import FloatArray
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module as printed

SHAPES = [(1, 0), (2, 1), (5, 0), (7, 2), (9, 8), (9, 9), (30, 4), (40, 13), (40, 14)]
"""Orders and bands; those of three bands are as wide as the matrix, or just not."""


@cache
def compiled() -> tuple[Module, Any, Any]:
    module = Module(printed([factor_pivoted.form(), solve_pivoted.form()]))
    whole, memory = ctypes.c_int64, ctypes.c_void_p
    kinds = (whole, whole, memory, memory)
    factor = ctypes.CFUNCTYPE(ctypes.c_bool, *kinds)(module.address("factor_pivoted"))
    return module, factor, ctypes.CFUNCTYPE(None, *kinds)(module.address("solve_pivoted"))


def solve(matrix: FloatArray, band: int, right: FloatArray) -> tuple[FloatArray, bool]:
    """Return the solution, and True if the matrix is singular. Work memory is NaN at first."""
    n = len(matrix)
    given, factors = np.zeros(n * n if band == n else band_size(n, band)), np.full(pivoted_size(n, band), np.nan)
    for j in range(n):
        for i in range(j, min(n, j + band + 1)):
            given[j * band + i] = matrix[i, j]
    x = right.copy()
    _, factor, substitute = compiled()
    singular = factor(n, band, address(given), address(factors))
    substitute(n, band, address(factors), address(x))
    return x, bool(singular)


def banded(n: int, band: int, seed: int) -> FloatArray:
    """Return a random indefinite matrix whose rows have different units, with some zeros on the diagonal."""
    draw = np.random.default_rng(seed)
    matrix = draw.normal(size=(n, n))
    matrix = np.tril(np.triu(matrix + matrix.T, -band), band)
    if band:
        matrix[np.diag_indices(n)] *= draw.random(n) < 0.5
    units = 2.0 ** draw.integers(-6, 7, n).astype(float)
    return np.asarray(units[:, None] * matrix * units)


@pytest.mark.parametrize(("n", "band"), SHAPES)
def test_solutions_are_those_of_lapack(n: int, band: int) -> None:
    for seed in range(10):
        matrix, right = banded(n, band, seed), np.random.default_rng(seed).normal(size=n)
        if np.linalg.cond(matrix / np.abs(matrix).max(axis=1)[:, None]) > 1e8:
            continue
        x, singular = solve(matrix, band, right)
        # Partial pivoting leaves a residual of some n units of round-off of the terms.
        terms = np.abs(matrix) @ np.abs(x) + np.abs(right)
        assert not singular and (np.abs(matrix @ x - right) <= 20 * n * 2.0**-52 * terms.max(initial=0.0)).all()
        assert x == pytest.approx(np.linalg.solve(matrix, right), rel=1e-6, abs=1e-6 * np.abs(x).max())


@pytest.mark.parametrize(("n", "band"), SHAPES)
def test_a_band_changes_no_digit(n: int, band: int) -> None:
    """Pivots and operations equal those for the full matrix."""
    for seed in range(5):
        matrix, right = banded(n, band, 50 + seed), np.random.default_rng(seed).normal(size=n)
        (x, singular), (full, also) = solve(matrix, band, right), solve(matrix, n, right)
        assert singular == also and x.tobytes() == full.tobytes()


@pytest.mark.parametrize(("n", "band"), [(2, 1), (7, 2), (30, 4)])
def test_a_dependent_row_is_found_and_a_nan_is_not_called_one(n: int, band: int) -> None:
    matrix, right = banded(n, band, 3), np.ones(n)
    matrix[n // 2] = matrix[:, n // 2] = 0.0
    assert solve(matrix, band, right)[1]
    matrix[n // 2, n // 2] = np.nan
    x, singular = solve(matrix, band, right)
    assert not singular and np.isnan(x).any()


# --- pivoting -------------------------------------------------------------------------------------------------
# The inverse that Newton's method uses, against LAPACK: every order, any units, zeros on the diagonal, no inverse.

ORDERS = [1, 2, 3, 4, 5, 8, 12, UNROLLED_ORDER, UNROLLED_ORDER + 1, 30]


@cache
def compiled_inverse(n: int) -> tuple[Module, Callable[[int, int], bool]]:
    module = Module(printed([invert_matrix.form(n=n)]), optimize=True)
    return module, ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)(
        module.address(invert_matrix.form(n=n).name)
    )


def invert(matrix: FloatArray) -> tuple[FloatArray, bool]:
    """Return the inverse, and True if the matrix is singular. Work memory is NaN at first."""
    n = len(matrix)
    stride = row_stride(n)
    rows, scratch = np.full((n, stride), np.nan), np.full(3 * stride, np.nan)
    rows[:, :n] = matrix
    singular = compiled_inverse(n)[1](address(rows), address(scratch))
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
            result, singular = invert(matrix)
            expected = np.linalg.inv(matrix)
            # Gauss-Jordan with pivots errs by some n units of round-off times the condition number.
            bound = 10 * n * 2.0**-52 * np.linalg.cond(matrix)
            assert not singular and np.abs(result - expected).max() <= bound * np.abs(expected).max()


@pytest.mark.few(3)
@pytest.mark.parametrize("n", ORDERS)
def test_a_matrix_without_an_inverse_is_told(n: int) -> None:
    matrix = np.random.default_rng(n).normal(size=(n, n))
    matrix[-1] = matrix[0] if n > 1 else 0.0
    assert invert(matrix)[1]
    assert invert(np.zeros((n, n)))[1]
