"""Symmetric linear systems inside kernels: all sizes, definite or not, singular or not, single and in columns."""

import ctypes
from functools import cache
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.kernel.body import width_of
from lagrange.algorithm.linear import symmetric
from lagrange.algorithm.linear.gauss_jordan import UNROLLED_ORDER, invert_matrix, row_stride
from lagrange.algorithm.linear.symmetric import (
    band_size,
    factor_pivoted,
    padded,
    pivoted_size,
    solve_pivoted,
    work_size,
)
from lagrange.compiler import machine
from lagrange.graph.node import Binding, Graph
from lagrange.machine.backend import FloatArray, Kernel, SingularMassMatrix
from lagrange.machine.kernel.llvm_kernel import KernelCode
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.engine import calling_solver, compiled
from lagrange.program.elimination import LARGEST_IN_LINE
from lagrange.program.lower import lower
from tests.machine.matrices import REGULAR, SINGULAR, Matrix, hollow, indefinite, positive, scaled
from tests.models import TARGETS

SIZES = (2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 30)
FEW = (2, 3, 6, 7, 12)
WIDTHS = (1, 2, 7, 8, 9, 11, 64)


@cache
def solver(target: str, n: int, where: str = "state", extra: int = 1, multipliers: int = 0) -> Kernel:
    """Return a kernel that solves A x = b; A comes from the state or the parameters, b from the state."""
    graph = Graph()
    hoisted = where == "parameters"
    binding = Binding.PARAMETER if hoisted else Binding.CONFIGURATION
    entries = [graph.symbol(f"a{i}", binding) for i in range(n * (n + 1) // 2)]
    right = [graph.symbol(f"b{i}", Binding.CONFIGURATION) for i in range(n * extra)]
    factor = 2 if hoisted else 1  # not the parameters themselves, which are at hand anyway
    rows = [[factor * entries[i * (i + 1) // 2 + j] for j in range(i + 1)] for i in range(n)]
    sides = [[factor * entry for entry in right[k * n : (k + 1) * n]] for k in range(extra)]
    outputs = [x for side in sides for x in graph.solve(rows, side, tuple(range(n - multipliers, n)))]
    states = right if hoisted else [*entries, *right]
    return machine(target).load(
        lower(f"solve{n}", {"x": outputs}, {"y": states}, graph.symbol("t", Binding.TIME), entries * hoisted)
    )


def solve(target: str, a: Any, b: Any, where: str = "state", extra: int = 1) -> Any:
    """Return x of a x = b for one matrix (n, n), or for a batch (n, n, k)."""
    n = len(a)
    i, j = np.tril_indices(n)
    kernel = solver(target, n, where, extra)
    if where == "parameters":
        return kernel(0.0, b, a[i, j])
    return kernel(0.0, np.concatenate([a[i, j], b]), np.empty(0))


def backward_error(a: Any, x: Any, b: Any) -> float:
    """Return |a x - b| row by row against |a| |x| + |b|: of order round-off for a stable solution."""
    return float(np.max(np.abs(a @ x - b) / (np.abs(a) @ np.abs(x) + np.abs(b))))


@pytest.mark.few(1)
@pytest.mark.parametrize("where", ["state", "parameters"])
@pytest.mark.parametrize("kind", REGULAR, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("target", TARGETS)
def test_one_system(target: str, kind: Matrix, where: str) -> None:
    rng = np.random.default_rng(1)
    for n in SIZES:
        a, b = kind(rng, n), rng.normal(size=n)
        x = solve(target, a, b, where)
        assert backward_error(a, x, b) < 1e-11 * n, n


@pytest.mark.few(1)
@pytest.mark.parametrize("where", ["state", "parameters"])
@pytest.mark.parametrize("target", TARGETS)
def test_columns_of_mixed_kinds(target: str, where: str) -> None:
    rng = np.random.default_rng(2)
    for n in FEW:
        for width in WIDTHS:
            b = rng.normal(size=(n, width))
            if where == "parameters":
                a = indefinite(rng, n)
                x = solve(target, a, b, where)
                assert backward_error(a, x, b) < 1e-11 * n, (n, width)
            else:
                matrices = [REGULAR[k % len(REGULAR)](rng, n) for k in range(width)]
                x = solve(target, np.array(matrices).transpose(1, 2, 0), b)
                errors = [backward_error(a, x[:, k], b[:, k]) for k, a in enumerate(matrices)]
                assert max(errors) < 1e-11 * n, (n, width)
                if target == "llvm":  # a column whose pivots are not trusted does not affect the others
                    assert all((x[:, k] == solve(target, a, b[:, k])).all() for k, a in enumerate(matrices)), (n, width)


@pytest.mark.parametrize("where", ["state", "parameters"])
@pytest.mark.parametrize("kind", SINGULAR, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("target", TARGETS)
def test_a_singular_matrix_is_said_to_be(target: str, kind: Matrix, where: str) -> None:
    rng = np.random.default_rng(3)
    for n in SIZES:
        with pytest.raises(SingularMassMatrix) as raised:
            solve(target, kind(rng, n), rng.normal(size=n), where)
        assert raised.value.column is None


@pytest.mark.parametrize("target", TARGETS)
def test_the_singular_column_is_found(target: str) -> None:
    rng = np.random.default_rng(4)
    for n in FEW:
        for width in WIDTHS:
            for bad in {0, width // 2, width - 1}:
                matrices = [positive(rng, n) for _ in range(width)]
                matrices[bad] = SINGULAR[bad % len(SINGULAR)](rng, n)
                with pytest.raises(SingularMassMatrix) as raised:
                    solve(target, np.array(matrices).transpose(1, 2, 0), rng.normal(size=(n, width)))
                assert raised.value.column == bad, (n, width)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("target", TARGETS)
def test_an_entry_that_is_not_finite_is_no_verdict_wherever_it_stands(target: str, bad: float) -> None:
    """Also if the other rows are zero in its column, so that zero would be the pivot."""
    for n in SIZES:
        for i, j in ((n - 1, 0), (n // 2, 0), (n - 1, n // 2)):
            a = np.eye(n)
            a[i, j] = a[j, i] = bad
            assert not np.isfinite(solve(target, a, np.ones(n))).all() or i == j, (n, i, j)
            a[:, i] = a[i] = bad
            assert not np.isfinite(solve(target, a, np.ones(n))).all(), (n, i, j)
            a = np.eye(n)
            a[i, i] = bad  # nothing moves what is infinitely heavy, unless it counts as no number
            result = solve(target, a, np.ones(n))
            assert not np.isfinite(result).all() or abs(result[i]) == 0.0, (n, i)


@pytest.mark.parametrize("target", TARGETS)
def test_a_call_leaves_nothing_behind(target: str) -> None:
    """The memory of the factors is reused: after a singular and a NaN system the first one solves as before."""
    rng = np.random.default_rng(7)
    for n in SIZES:
        a, b = hollow(rng, n), rng.normal(size=n)
        first = solve(target, a, b)
        assert np.isnan(solve(target, np.full((n, n), np.nan), b)).all()
        with pytest.raises(SingularMassMatrix):
            solve(target, np.zeros((n, n)), b)
        assert (solve(target, a, b) == first).all()
        many = np.repeat(a[:, :, None], 9, axis=2)
        columns = np.repeat(b[:, None], 9, axis=1)
        before = solve(target, many, columns)
        assert np.isnan(solve(target, many * np.nan, columns)).all()
        assert (solve(target, many, columns) == before).all()


@pytest.mark.parametrize("where", ["state", "parameters"])
@pytest.mark.parametrize("target", TARGETS)
def test_one_factorization_serves_several_right_hand_sides(target: str, where: str) -> None:
    rng = np.random.default_rng(8)
    for n in (2, 6, 7, 12):
        for kind in (positive, hollow):
            a, b = kind(rng, n), rng.normal(size=3 * n)
            x = solve(target, a, b, where, extra=3)
            for k in range(3):
                part = slice(k * n, (k + 1) * n)
                assert backward_error(a, x[part], b[part]) < 1e-11 * n


def test_a_system_too_large_for_lanes() -> None:
    """Columns are solved one by one, because the memory of many lanes does not fit on the stack."""
    n = 66
    graph = Graph()
    diagonal, other, right, _ = symbols = [graph.symbol(name, Binding.CONFIGURATION) for name in "abcd"]
    matrix = [[diagonal if i == j else other for j in range(i + 1)] for i in range(n)]
    outputs = graph.solve(matrix, [right, *[graph.one] * (n - 1)])
    program = lower("large", {"x": outputs}, {"y": symbols}, graph.symbol("t", Binding.TIME), [])
    kernel = machine("llvm").load(program)
    states = np.array([np.linspace(3, 4, 9), np.linspace(0.5, 0.9, 9), np.linspace(-1, 1, 9), np.zeros(9)])
    result = kernel(0.0, states, np.empty(0))
    for k, (a, b, c, _) in enumerate(states.T):
        x = np.linalg.solve(np.full((n, n), b) + (a - b) * np.eye(n), np.append(c, np.ones(n - 1)))
        assert result[:, k] == pytest.approx(x, rel=1e-10)
        assert kernel(0.0, states[:, k], np.empty(0)) == pytest.approx(x, rel=1e-10)
    states[0, 5] = states[1, 5] = 1.0
    with pytest.raises(SingularMassMatrix) as raised:
        kernel(0.0, states, np.empty(0))
    assert raised.value.column == 5


def bordered(rng: np.random.Generator, n: int, m: int) -> Any:
    """Return [[M, G^T], [G, 0]] with M (n, n) positive definite and m orthogonal rows G (m, n)."""
    border = np.linalg.qr(rng.normal(size=(n, m)))[0].T
    return np.block([[positive(rng, n), border.T], [border, np.zeros((m, m))]])


def trusted(kernel: Any, values: Any) -> bool:
    """Return True if every pivot was trusted, from the last entry of the factors."""
    slots = KernelCode(kernel.program).prepared.of_program(kernel.program)
    (factor,) = (ref for ref in slots if kernel.program.instructions[ref].op == "factor")
    return bool(kernel.prepare(values)[slots[factor] + width_of(kernel.program, factor, LARGEST_IN_LINE) - 1])


@pytest.mark.parametrize(("n", "m"), [(2, 1), (3, 1), (4, 2), (3, 3)])
def test_a_pivot_of_a_multiplier_is_below_zero_and_trusted(n: int, m: int) -> None:
    """Otherwise each such system would be solved again with pivoting."""
    rng = np.random.default_rng(n + 10 * m)
    size = n + m
    stated_so, plain = (solver("llvm", size, "parameters", multipliers=count) for count in (m, 0))
    for _ in range(20):
        a, b = bordered(rng, n, m), rng.normal(size=size)
        values = a[np.tril_indices(size)]
        x = stated_so(0.0, b, values)
        assert backward_error(a, x, b) < 1e-11
        assert trusted(stated_so, values) and not trusted(plain, values)
        for other in (plain, solver("numpy", size, "parameters", multipliers=m)):
            assert other(0.0, b, values) == pytest.approx(x, rel=1e-9, abs=1e-11)


def test_constraints_that_depend_on_one_another_are_not_trusted() -> None:
    rng = np.random.default_rng(5)
    a = bordered(rng, 4, 2)
    nearly = 3 * a[4, :4] + 1e-3 * a[5, :4]
    a[5, :4] = a[:4, 5] = 3 * a[4, :4]
    kernel, values = solver("llvm", 6, "parameters", multipliers=2), a[np.tril_indices(6)]
    assert not trusted(kernel, values)
    with pytest.raises(SingularMassMatrix):
        kernel(0.0, np.ones(6), values)
    a[5, :4] = a[:4, 5] = nearly
    values = a[np.tril_indices(6)]
    assert not trusted(kernel, values)
    # With pivots in their order six digits would be lost; with pivoting it is growth of rounding errors alone.
    assert backward_error(a, kernel(0.0, np.ones(6), values), np.ones(6)) < 1e-13


# --- inverse --------------------------------------------------------------------------------------------------
# The inverse of a symmetric matrix in machine code: every size, definite or not, graded, singular.

ORDERS = range(1, 41)
EPS = 2.0**-52

_INVERT = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_int64, ctypes.c_int64, *([ctypes.c_void_p] * 3))


def invert(a: Any) -> tuple[int, Any]:
    """Return the status and the inverse. The upper triangle and all work memory are NaN before."""
    n = len(a)
    stride = padded(n)
    given = np.full((n, n), np.nan)
    given[np.tril_indices(n)] = a[np.tril_indices(n)]
    columns = given.T.ravel().copy()  # entry (i, j) at j*n + i
    before = columns.copy()
    out, work = np.full(stride * stride + 8, np.nan), np.full(work_size(n) + 8, np.nan)
    function = _INVERT(calling_solver(symmetric.invert.form()).address("invert"))
    status = function(n, stride, address(columns), address(out), address(work))
    assert np.array_equal(columns, before, equal_nan=True)
    assert np.isnan(out[stride * stride :]).all() and np.isnan(work[-8:]).all()
    return status, out[: stride * stride].reshape(stride, stride)[:n, :n].T


@pytest.mark.parametrize("kind", [kind for kind in REGULAR if kind is not scaled], ids=lambda kind: kind.__name__)
def test_every_size(kind: Matrix) -> None:
    """The error of a stable inverse is the condition number times round-off times a small factor."""
    rng = np.random.default_rng(1)
    for n in ORDERS:
        a = kind(rng, n)
        status, result = invert(a)
        expected = np.linalg.inv(a)
        assert status == 0, n
        bound = 100 * n * EPS * np.linalg.cond(a) * np.abs(expected).max()
        assert np.abs(result - expected).max() < bound, n


def test_units_that_differ_by_many_orders() -> None:
    """S A S is inverted as accurately as A, since scaling by powers of two changes no rounding."""
    rng = np.random.default_rng(2)
    for n in ORDERS:
        a = positive(rng, n)
        scale = 2.0 ** np.round(np.linspace(-40, 40, n))
        plain, graded = invert(a), invert(a * np.outer(scale, scale))
        assert plain[0] == graded[0] == 0
        assert (graded[1] * np.outer(scale, scale) == plain[1]).all(), n


def test_a_pivot_that_cancels_is_not_trusted() -> None:
    """The matrix is well conditioned, but without exchanges a pivot is 1e-14."""
    rng = np.random.default_rng(3)
    for n in (2, 3, 8, 9, 17, 40):
        a = positive(rng, n)
        a[:2, :2] = [[1.0, 1.0], [1.0, 1.0 + 1e-14]]
        a[2:, :2] = a[:2, 2:] = 0.0
        a[0, n - 1] = a[n - 1, 0] = a[0, n - 1] + 3.0
        if n == 2:
            a = np.array([[1e-17, 1.0], [1.0, 1.0]])
        status, result = invert(a)
        assert status == 0
        residual = np.abs(a @ result - np.eye(n)).max()
        assert residual < 1e-12 * max(1.0, np.abs(result).max() * np.abs(a).max()), n


@pytest.mark.parametrize("kind", SINGULAR, ids=lambda kind: kind.__name__)
def test_a_singular_matrix_is_told(kind: Matrix) -> None:
    rng = np.random.default_rng(5)
    for n in ORDERS:
        assert invert(kind(rng, n))[0] == 1, n


# --- bands ----------------------------------------------------------------------------------------------------
# Symmetric banded systems, solved with pivoting, compared with LAPACK and with the same matrix as a full one.


SHAPES = [(1, 0), (2, 1), (5, 0), (7, 2), (9, 8), (9, 9), (30, 4), (40, 13), (40, 14)]
"""Orders and bands; those of three bands are as wide as the matrix, or just not."""


def solve_banded(matrix: FloatArray, band: int, right: FloatArray) -> tuple[FloatArray, bool]:
    """Return the solution, and True if the matrix is singular. Work memory is NaN at first."""
    n = len(matrix)
    given, factors = np.zeros(n * n if band == n else band_size(n, band)), np.full(pivoted_size(n, band), np.nan)
    for j in range(n):
        for i in range(j, min(n, j + band + 1)):
            given[j * band + i] = matrix[i, j]
    x = right.copy()
    singular = compiled(factor_pivoted.form())(n, band, given, factors)
    compiled(solve_pivoted.form())(n, band, factors, x)
    return x, singular


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
        x, singular = solve_banded(matrix, band, right)
        # Partial pivoting leaves a residual of some n units of round-off of the terms.
        terms = np.abs(matrix) @ np.abs(x) + np.abs(right)
        assert not singular and (np.abs(matrix @ x - right) <= 20 * n * 2.0**-52 * terms.max(initial=0.0)).all()
        assert x == pytest.approx(np.linalg.solve(matrix, right), rel=1e-6, abs=1e-6 * np.abs(x).max())


@pytest.mark.parametrize(("n", "band"), SHAPES)
def test_a_band_changes_no_digit(n: int, band: int) -> None:
    """Pivots and operations equal those for the full matrix."""
    for seed in range(5):
        matrix, right = banded(n, band, 50 + seed), np.random.default_rng(seed).normal(size=n)
        (x, singular), (full, also) = solve_banded(matrix, band, right), solve_banded(matrix, n, right)
        assert singular == also and x.tobytes() == full.tobytes()


@pytest.mark.parametrize(("n", "band"), [(2, 1), (7, 2), (30, 4)])
def test_a_dependent_row_is_found_and_a_nan_is_not_called_one(n: int, band: int) -> None:
    matrix, right = banded(n, band, 3), np.ones(n)
    matrix[n // 2] = matrix[:, n // 2] = 0.0
    assert solve_banded(matrix, band, right)[1]
    matrix[n // 2, n // 2] = np.nan
    x, singular = solve_banded(matrix, band, right)
    assert not singular and np.isnan(x).any()


# --- pivoting -------------------------------------------------------------------------------------------------
# The inverse that Newton's method uses, against LAPACK: every order, any units, zeros on the diagonal, no inverse.

INVERTED = [1, 2, 3, 4, 5, 8, 12, UNROLLED_ORDER, UNROLLED_ORDER + 1, 30]


def inverse_of(matrix: FloatArray) -> tuple[FloatArray, bool]:
    """Return the inverse, and True if the matrix is singular. Work memory is NaN at first."""
    n = len(matrix)
    stride = row_stride(n)
    rows, scratch = np.full((n, stride), np.nan), np.full(3 * stride, np.nan)
    rows[:, :n] = matrix
    singular = compiled(invert_matrix.form(n=n))(rows, scratch)
    return rows[:, :n], singular


@pytest.mark.few
@pytest.mark.parametrize("n", INVERTED)
def test_the_inverse_is_that_of_lapack(n: int) -> None:
    draw = np.random.default_rng(n)
    for zero_diagonal in (False, True):
        if zero_diagonal and n < 3:
            continue
        for _ in range(20):
            matrix = draw.normal(size=(n, n))
            if zero_diagonal:
                np.fill_diagonal(matrix, 0.0)
            result, singular = inverse_of(matrix)
            expected = np.linalg.inv(matrix)
            # Gauss-Jordan with pivots errs by some n units of round-off times the condition number.
            bound = 10 * n * 2.0**-52 * np.linalg.cond(matrix)
            assert not singular and np.abs(result - expected).max() <= bound * np.abs(expected).max()
            matrix[-1] = matrix[0] if n > 1 else 0.0
            assert inverse_of(matrix)[1]
    assert inverse_of(np.zeros((n, n)))[1]
