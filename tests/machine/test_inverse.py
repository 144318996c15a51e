"""The inverse of a symmetric matrix in machine code: every size, definite or not, graded, singular."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.linear.inverse import padded, work_size
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.engine import inversion
from tests.machine.matrices import REGULAR, SINGULAR, Matrix, indefinite, positive, scaled

SIZES = range(1, 41)
EPS = 2.0**-52

_INVERT = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_int64, ctypes.c_int64, *([ctypes.c_void_p] * 3))


def invert(a: Any) -> tuple[int, Any]:
    """Return the status and the inverse; what is not the lower triangle, and all memory to write to, is NaN before."""
    n = len(a)
    stride = padded(n)
    given = np.full((n, n), np.nan)
    given[np.tril_indices(n)] = a[np.tril_indices(n)]
    columns = given.T.ravel().copy()  # entry (i, j) at j*n + i
    before = columns.copy()
    out, work = np.full(stride * stride + 8, np.nan), np.full(work_size(n) + 8, np.nan)
    function = _INVERT(inversion().address("invert"))
    status = function(n, stride, address(columns), address(out), address(work))
    assert np.array_equal(columns, before, equal_nan=True)
    assert np.isnan(out[stride * stride :]).all() and np.isnan(work[-8:]).all()
    return status, out[: stride * stride].reshape(stride, stride)[:n, :n].T


@pytest.mark.parametrize("kind", [kind for kind in REGULAR if kind is not scaled], ids=lambda kind: kind.__name__)
def test_every_size(kind: Matrix) -> None:
    """A stable inverse is off by a condition number of round-offs, times a modest function of n."""
    rng = np.random.default_rng(1)
    for n in SIZES:
        a = kind(rng, n)
        status, found = invert(a)
        expected = np.linalg.inv(a)
        assert status == 0, n
        bound = 100 * n * EPS * np.linalg.cond(a) * np.abs(expected).max()
        assert np.abs(found - expected).max() < bound, n


def test_units_that_differ_by_many_orders() -> None:
    """S A S is inverted as well as A: elimination without exchanges does not see a scaling by powers of two."""
    rng = np.random.default_rng(2)
    for n in SIZES:
        a = positive(rng, n)
        scale = 2.0 ** np.round(np.linspace(-40, 40, n))
        plain, graded = invert(a), invert(a * np.outer(scale, scale))
        assert plain[0] == graded[0] == 0
        assert (graded[1] * np.outer(scale, scale) == plain[1]).all(), n


def test_a_pivot_that_cancels_is_not_trusted() -> None:
    """Well conditioned, but elimination in the given order passes through 1e-14: exchanges keep all digits."""
    rng = np.random.default_rng(3)
    for n in (2, 3, 8, 9, 17, 40):
        a = positive(rng, n)
        a[:2, :2] = [[1.0, 1.0], [1.0, 1.0 + 1e-14]]
        a[2:, :2] = a[:2, 2:] = 0.0
        a[0, n - 1] = a[n - 1, 0] = a[0, n - 1] + 3.0
        if n == 2:
            a = np.array([[1e-17, 1.0], [1.0, 1.0]])
        status, found = invert(a)
        assert status == 0
        residual = np.abs(a @ found - np.eye(n)).max()
        assert residual < 1e-12 * max(1.0, np.abs(found).max() * np.abs(a).max()), n


@pytest.mark.parametrize("kind", SINGULAR, ids=lambda kind: kind.__name__)
def test_a_singular_matrix_is_told(kind: Matrix) -> None:
    rng = np.random.default_rng(5)
    for n in SIZES:
        assert invert(kind(rng, n))[0] == 1, n


def test_the_same_bits_twice() -> None:
    rng = np.random.default_rng(6)
    for n in (1, 7, 8, 9, 33):
        a = positive(rng, n)
        first = invert(a)[1]
        invert(indefinite(rng, 12))
        assert (invert(a)[1] == first).all()


def test_what_is_not_finite_is_no_verdict_and_no_inverse_in_silence() -> None:
    for bad in (np.nan, np.inf):
        for n in (2, 3, 9):
            for i, j in ((n - 1, 0), (n // 2, n // 2)):
                a = np.eye(n)
                a[i, j] = a[j, i] = bad
                status, found = invert(a)
                assert status == 0 and (not np.isfinite(found).all() or found[i, j] == 0.0)
