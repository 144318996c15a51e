"""The inverse of a symmetric matrix in machine code, in vectors of eight.

    i32 invert(i64 n, i64 stride, ptr a, ptr out, ptr work)

`a` has the lower triangle by columns, entry (i, j) at j*n + i; the inverse goes to `out` by columns `stride` doubles
apart, a multiple of eight, with zeros or anything behind the n-th row; `work` takes `work_size(n)` doubles.
A = L D L^T, then L D (L^T X) = I for all columns at once. Where a pivot cannot be trusted the matrix is inverted with
pivoting. The result is 1 if it is singular, else 0.
"""

from __future__ import annotations

from lagrange.machine.backend import PIVOT
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.linear_solver import factor_size
from lagrange.machine.llvm.spelling import number

LANES = 8
KIND = f"<{LANES} x double>"


def inverse_module() -> str:
    """Return the IR."""
    declared = """declare double @llvm.fabs.f64(double)
declare <8 x double> @llvm.fma.v8f64(<8 x double>, <8 x double>, <8 x double>)
declare i32 @invert_dense(i64, ptr, ptr, ptr)
attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }
"""
    return "\n".join([declared, _factor(), _solve(), _pivoted(), _invert()])


def _at(e: Emitter, stride: str, row: str, column: str) -> str:
    return e.value(f"add nsw i64 {e.value(f'mul nsw i64 {column}, {stride}')}, {row}")


def _factor() -> str:
    """Turn the columns %l, lower triangle, into those of L below the diagonal, and 1/d into %d; 1 if it is trusted."""
    e = Emitter()
    with e.carry(0, "%n", [("i1", "true")]) as outer:
        j = outer.index
        column = e.address("%l", e.value(f"mul nsw i64 {j}, %stride"))
        pivot = e.get(column, j)
        least = e.real("fmul", e.fabs(e.get("%a", _at(e, "%n", j, j))), literal(PIVOT))
        good = e.real("fcmp ogt", pivot, least)
        outer.following = [e.value(f"and i1 {outer.values[0]}, {good}")]
        reciprocal = e.real("fdiv", literal(1.0), pivot)
        e.put(reciprocal, "%d", j)
        after = e.value(f"add nsw i64 {j}, 1")
        with e.loop(after, "%n") as k:
            minus = e.splat(e.value(f"fneg double {e.real('fmul', e.get(column, k), reciprocal)}"), KIND)
            target = e.address("%l", e.value(f"mul nsw i64 {k}, %stride"))
            with e.loop(e.value(f"and i64 {k}, -{LANES}"), "%n", LANES) as i:
                old = e.load(e.address(target, i), KIND)
                e.store(e.fma(minus, e.load(e.address(column, i), KIND), old, KIND), e.address(target, i), KIND)
        scale = e.splat(reciprocal, KIND)
        with e.loop(e.value(f"and i64 {after}, -{LANES}"), "%n", LANES) as i:
            place = e.address(column, i)
            e.store(e.value(f"fmul {KIND} {e.load(place, KIND)}, {scale}"), place, KIND)
    e.do(f"ret i1 {outer.values[0]}")
    return e.function("define internal i1 @factor(i64 %n, i64 %stride, ptr %a, ptr noalias %l, ptr noalias %d) #0")


def _solve() -> str:
    """Find X of L D L^T X = I; %x has rows, which are columns as well, and begins as the identity."""
    e = Emitter()
    with e.loop(0, "%n") as i:
        row = e.address("%x", e.value(f"mul nsw i64 {i}, %stride"))
        # Row j of the inverse of L ends at column j, and so does what it adds.
        with e.loop(0, e.value(f"add nsw i64 {i}, 1"), LANES) as c:
            with e.carry(c, i, [(KIND, e.load(e.address(row, c), KIND))]) as inner:
                minus = e.value(f"fneg double {e.get('%l', _at(e, '%stride', i, inner.index))}")
                other = e.load(e.address("%x", _at(e, "%stride", c, inner.index)), KIND)
                inner.following = [e.fma(e.splat(minus, KIND), other, inner.values[0], KIND)]
            e.store(inner.values[0], e.address(row, c), KIND)
    with e.loop(0, "%n") as i:
        row, scale = e.address("%x", e.value(f"mul nsw i64 {i}, %stride")), e.splat(e.get("%d", i), KIND)
        with e.loop(0, "%n", LANES) as c:
            place = e.address(row, c)
            e.store(e.value(f"fmul {KIND} {e.load(place, KIND)}, {scale}"), place, KIND)
    with e.loop(0, "%n") as back:
        i = e.value(f"sub nsw i64 {e.value('sub nsw i64 %n, 1')}, {back}")
        row, column = (e.address(base, e.value(f"mul nsw i64 {i}, %stride")) for base in ("%x", "%l"))
        with e.loop(0, "%n", LANES) as c:
            first = e.value(f"add nsw i64 {i}, 1")
            with e.carry(first, "%n", [(KIND, e.load(e.address(row, c), KIND))]) as inner:
                minus = e.value(f"fneg double {e.get(column, inner.index)}")
                other = e.load(e.address("%x", _at(e, "%stride", c, inner.index)), KIND)
                inner.following = [e.fma(e.splat(minus, KIND), other, inner.values[0], KIND)]
            e.store(inner.values[0], e.address(row, c), KIND)
    e.do("ret void")
    return e.function("define internal void @solve(i64 %n, i64 %stride, ptr %l, ptr %d, ptr noalias %x) #0")


def _pivoted() -> str:
    """Invert with pivoting in %work, and spread the columns."""
    e = Emitter()
    square = e.value("mul nsw i64 %n, %n")
    status = e.value(f"call i32 @invert_dense(i64 %n, ptr %a, ptr %work, ptr {e.address('%work', square)})")
    with e.loop(0, "%n") as j, e.loop(0, "%n") as i:
        e.put(e.get("%work", _at(e, "%n", i, j)), "%out", _at(e, "%stride", i, j))
    e.do(f"ret i32 {status}")
    return e.function(
        "define internal i32 @pivoted(i64 %n, i64 %stride, ptr %a, ptr noalias %out, ptr noalias %work) #0"
    )


def _invert() -> str:
    e = Emitter()
    square = e.value("mul nsw i64 %stride, %stride")
    reciprocals = e.address("%work", square)
    zero = number(0.0, LANES)
    with e.loop(0, square, LANES) as i:
        e.store(zero, e.address("%out", i), KIND)
    with e.loop(0, "%n") as j:
        e.put(literal(1.0), "%out", _at(e, "%stride", j, j))
        with e.loop(e.value(f"and i64 {j}, -{LANES}"), "%stride", LANES) as i:
            e.store(zero, e.address("%work", _at(e, "%stride", i, j)), KIND)
        with e.loop(j, "%n") as i:
            e.put(e.get("%a", _at(e, "%n", i, j)), "%work", _at(e, "%stride", i, j))
    good = e.value(f"call i1 @factor(i64 %n, i64 %stride, ptr %a, ptr %work, ptr {reciprocals})")
    e.do(f"br i1 {good}, label %plain, label %hard")
    e.label("plain")
    e.do(f"call void @solve(i64 %n, i64 %stride, ptr %work, ptr {reciprocals}, ptr %out)")
    e.do("ret i32 0")
    e.label("hard")
    e.do(f"ret i32 {e.value('call i32 @pivoted(i64 %n, i64 %stride, ptr %a, ptr %out, ptr %work)')}")
    return e.function("define i32 @invert(i64 %n, i64 %stride, ptr noalias %a, ptr noalias %out, ptr noalias %work) #0")


def work_size(n: int) -> int:
    """Return the length of the work memory: for L and 1/d, or for the inverse with pivoting, its factors and a row."""
    return max(padded(n) ** 2 + n, n * n + factor_size(n) + n)


def padded(n: int) -> int:
    """Return the distance between columns."""
    return -(-n // LANES) * LANES
