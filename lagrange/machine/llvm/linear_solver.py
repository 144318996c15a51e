"""Solve symmetric systems inside machine code.

A matrix is kept as its lower triangle by columns: entry (i, j), i >= j, at j*n + i. It is factored as L D L^T
without pivoting, which is stable for a positive definite mass matrix. Where a pivot vanishes against its diagonal
entry, at the same `PIVOT`, the matrix is factored again as P A = L U with scaled partial pivoting, which serves every
regular matrix, and only a pivot that vanishes there too is called singular.
Source: G. H. Golub, C. F. Van Loan, Matrix Computations, 4th ed., 2013, sections 3.4 and 4.1.

Factors are kept in an array of `factor_size(n)` doubles: [kind, 1/d (n), permutation (n), columns (n*n)], kind 0
for L D L^T and 1 for L U.
"""

from __future__ import annotations

from lagrange.machine.backend import PIVOT
from lagrange.machine.llvm.emitter import Emitter, literal


def factor_size(n: int) -> int:
    """Return the number of doubles that the factors of an n x n matrix take."""
    return 1 + 2 * n + n * n


def library() -> str:
    """Return the IR of `factor_dense`, `solve_factored`, `solve_lanes` and `invert_dense`, for any order."""
    return "\n".join(
        [
            "declare double @llvm.fabs.f64(double)",
            "declare double @llvm.fma.f64(double, double, double)",
            _factor_symmetric(),
            _factor_pivoted(),
            _factor_dense(),
            _solve_factored(),
            _solve_lanes(),
            _invert_dense(),
        ]
    )


def _at(e: Emitter, n: str, row: str, column: str) -> str:
    return e.value(f"add nsw i64 {e.value(f'mul nsw i64 {column}, {n}')}, {row}")


def _parts(e: Emitter) -> tuple[str, str, str]:
    """Return the addresses of 1/d, the permutation and the columns inside the factors %f."""
    perm = e.value("add nsw i64 %n, 1")
    columns = e.value(f"add nsw i64 {perm}, %n")
    return e.address("%f", 1), e.address("%f", perm), e.address("%f", columns)


def _factor_symmetric() -> str:
    """L D L^T by columns: each finished column is subtracted from the columns behind it."""
    e = Emitter()
    inverse, _, columns = _parts(e)
    with e.loop(0, "%n") as j, e.loop(j, "%n") as i:
        at = _at(e, "%n", i, j)
        e.put(e.get("%a", at), columns, at)
    good = e.reserve("i32")
    e.store("1", good, "i32")
    with e.loop(0, "%n") as j:
        diagonal = _at(e, "%n", j, j)
        d = e.get(columns, diagonal)
        least = e.value(f"fmul double {e.fabs(e.get('%a', diagonal))}, {literal(PIVOT)}")
        trusted = e.value(f"fcmp ogt double {d}, {least}")
        e.store(e.value(f"and i32 {e.load(good, 'i32')}, {e.value(f'zext i1 {trusted} to i32')}"), good, "i32")
        reciprocal = e.value(f"fdiv double {literal(1.0)}, {d}")
        e.put(reciprocal, inverse, j)
        after = e.value(f"add nsw i64 {j}, 1")
        with e.loop(after, "%n") as k:
            entry = e.get(columns, _at(e, "%n", k, j))
            minus = e.value(f"fneg double {e.value(f'fmul double {entry}, {reciprocal}')}")
            source = e.address(columns, _at(e, "%n", "0", j))
            target = e.address(columns, _at(e, "%n", "0", k))
            with e.loop(k, "%n") as i:
                e.put(e.fma(minus, e.get(source, i), e.get(target, i)), target, i)
        with e.loop(after, "%n") as i:
            at = _at(e, "%n", i, j)
            e.put(e.value(f"fmul double {e.get(columns, at)}, {reciprocal}"), columns, at)
    e.do(f"ret i32 {e.load(good, 'i32')}")
    return e.function("define internal i32 @factor_symmetric(i64 %n, ptr noalias %a, ptr noalias %f)")


def _factor_pivoted() -> str:
    """P A = L U with rows scaled by their largest entry; returns 1 if the matrix is singular to round-off."""
    e = Emitter()
    scale, perm, columns = _parts(e)
    with e.loop(0, "%n") as j, e.loop(j, "%n") as i:
        entry = e.get("%a", _at(e, "%n", i, j))
        e.put(entry, columns, _at(e, "%n", i, j))
        e.put(entry, columns, _at(e, "%n", j, i))
    with e.loop(0, "%n") as i:
        e.put(e.value(f"sitofp i64 {i} to double"), perm, i)
        largest = e.reserve("double")
        e.store(literal(0.0), largest)
        with e.loop(0, "%n") as j:
            size = e.fabs(e.get(columns, _at(e, "%n", i, j)))
            above = e.value(f"fcmp ogt double {size}, {e.load(largest)}")
            e.store(e.value(f"select i1 {above}, double {size}, double {e.load(largest)}"), largest)
        e.put(e.value(f"fdiv double {literal(1.0)}, {e.load(largest)}"), scale, i)
    singular = e.reserve("i32")
    e.store("0", singular, "i32")
    with e.loop(0, "%n") as j:
        _exchange(e, j, scale, perm, columns)
        pivot = e.get(columns, _at(e, "%n", j, j))
        size = e.value(f"fmul double {e.fabs(pivot)}, {e.get(scale, j)}")
        # A NaN is no verdict on the matrix: it passes through to the solution. An all-zero row gives 0 * inf.
        vanishes = e.value(f"fcmp ole double {size}, {literal(PIVOT)}")
        zero = e.value(f"fcmp oeq double {pivot}, {literal(0.0)}")
        bad = e.value(f"zext i1 {e.value(f'or i1 {vanishes}, {zero}')} to i32")
        e.store(e.value(f"or i32 {e.load(singular, 'i32')}, {bad}"), singular, "i32")
        reciprocal = e.value(f"fdiv double {literal(1.0)}, {pivot}")
        after = e.value(f"add nsw i64 {j}, 1")
        with e.loop(after, "%n") as i:
            at = _at(e, "%n", i, j)
            e.put(e.value(f"fmul double {e.get(columns, at)}, {reciprocal}"), columns, at)
        with e.loop(after, "%n") as k:
            minus = e.value(f"fneg double {e.get(columns, _at(e, '%n', j, k))}")
            with e.loop(after, "%n") as i:
                at = _at(e, "%n", i, k)
                e.put(e.fma(minus, e.get(columns, _at(e, "%n", i, j)), e.get(columns, at)), columns, at)
    e.do(f"ret i32 {e.load(singular, 'i32')}")
    return e.function("define internal i32 @factor_pivoted(i64 %n, ptr noalias %a, ptr noalias %f)")


def _exchange(e: Emitter, j: str, scale: str, perm: str, columns: str) -> None:
    """Bring the row with the largest scaled entry of column j to row j."""
    best, row = e.reserve("double"), e.reserve("i64")
    e.store(literal(-1.0), best)
    e.store(j, row, "i64")
    with e.loop(j, "%n") as i:
        size = e.value(f"fmul double {e.fabs(e.get(columns, _at(e, '%n', i, j)))}, {e.get(scale, i)}")
        with e.when(e.value(f"fcmp ogt double {size}, {e.load(best)}")):
            e.store(size, best)
            e.store(i, row, "i64")
    chosen = e.load(row, "i64")
    for vector in (scale, perm):
        here, there = e.get(vector, j), e.get(vector, chosen)
        e.put(there, vector, j)
        e.put(here, vector, chosen)
    with e.loop(0, "%n") as k:
        first, second = _at(e, "%n", j, k), _at(e, "%n", chosen, k)
        here, there = e.get(columns, first), e.get(columns, second)
        e.put(there, columns, first)
        e.put(here, columns, second)


def _factor_dense() -> str:
    e = Emitter()
    good = e.value("call i32 @factor_symmetric(i64 %n, ptr %a, ptr %f)")
    e.store(literal(0.0), "%f")
    e.do(f"br i1 {e.value(f'icmp ne i32 {good}, 0')}, label %done, label %pivot")
    e.label("done")
    e.do("ret i32 0")
    e.label("pivot")
    e.store(literal(1.0), "%f")
    e.do(f"ret i32 {e.value('call i32 @factor_pivoted(i64 %n, ptr %a, ptr %f)')}")
    return e.function("define i32 @factor_dense(i64 %n, ptr noalias %a, ptr noalias %f)")


def _solve_factored() -> str:
    """Overwrite b by the solution; %w is a work array of n doubles."""
    e = Emitter()
    inverse, perm, columns = _parts(e)
    pivoted = e.value(f"fcmp une double {e.load('%f')}, {literal(0.0)}")
    with e.when(pivoted):
        with e.loop(0, "%n") as i:
            e.put(e.get("%b", i), "%w", i)
        with e.loop(0, "%n") as i:
            e.put(e.get("%w", e.value(f"fptosi double {e.get(perm, i)} to i64")), "%b", i)
    with e.loop(0, "%n") as j:
        minus = e.value(f"fneg double {e.get('%b', j)}")
        column = e.address(columns, _at(e, "%n", "0", j))
        with e.loop(e.value(f"add nsw i64 {j}, 1"), "%n") as i:
            e.put(e.fma(minus, e.get(column, i), e.get("%b", i)), "%b", i)
    e.do(f"br i1 {pivoted}, label %upper, label %symmetric")
    e.label("upper")
    with e.loop(0, "%n") as back:
        j = e.value(f"sub nsw i64 {e.value('sub nsw i64 %n, 1')}, {back}")
        x = e.value(f"fdiv double {e.get('%b', j)}, {e.get(columns, _at(e, '%n', j, j))}")
        e.put(x, "%b", j)
        minus = e.value(f"fneg double {x}")
        with e.loop(0, j) as i:
            e.put(e.fma(minus, e.get(columns, _at(e, "%n", i, j)), e.get("%b", i)), "%b", i)
    e.do("ret void")
    e.label("symmetric")
    with e.loop(0, "%n") as i:
        e.put(e.value(f"fmul double {e.get('%b', i)}, {e.get(inverse, i)}"), "%b", i)
    with e.loop(0, "%n") as back:
        j = e.value(f"sub nsw i64 {e.value('sub nsw i64 %n, 1')}, {back}")
        total = e.reserve("double")
        e.store(e.get("%b", j), total)
        column = e.address(columns, _at(e, "%n", "0", j))
        with e.loop(e.value(f"add nsw i64 {j}, 1"), "%n") as i:
            minus = e.value(f"fneg double {e.get(column, i)}")
            e.store(e.fma(minus, e.get("%b", i), e.load(total)), total)
        e.put(e.load(total), "%b", j)
    e.do("ret void")
    return e.function("define void @solve_factored(i64 %n, ptr noalias %f, ptr noalias %b, ptr noalias %w)")


def _solve_lanes() -> str:
    """Solve one system per lane; entry k of lane l stands at k*lanes + l. Returns 1 if any is singular.

    %work takes the matrix (n*n), the right-hand side (n), a work array (n) and the factors of one lane.
    """
    e = Emitter()
    square = e.value("mul nsw i64 %n, %n")
    right = e.address("%work", square)
    spare = e.address(right, "%n")
    factors = e.address(spare, "%n")
    status = e.reserve("i32")
    e.store("0", status, "i32")
    with e.loop(0, "%lanes") as lane:
        with e.loop(0, square) as k:
            e.put(e.get("%a", _at(e, "%lanes", lane, k)), "%work", k)
        with e.loop(0, "%n") as k:
            e.put(e.get("%b", _at(e, "%lanes", lane, k)), right, k)
        singular = e.value(f"call i32 @factor_dense(i64 %n, ptr %work, ptr {factors})")
        e.store(e.value(f"or i32 {e.load(status, 'i32')}, {singular}"), status, "i32")
        e.do(f"call void @solve_factored(i64 %n, ptr {factors}, ptr {right}, ptr {spare})")
        with e.loop(0, "%n") as k:
            e.put(e.get(right, k), "%b", _at(e, "%lanes", lane, k))
    e.do(f"ret i32 {e.load(status, 'i32')}")
    return e.function("define i32 @solve_lanes(i64 %n, i64 %lanes, ptr noalias %a, ptr noalias %b, ptr noalias %work)")


def _invert_dense() -> str:
    """Write the inverse to %out, by columns; %work takes the factors and n doubles. Returns 1 if it is singular."""
    e = Emitter()
    square = e.value("mul nsw i64 %n, %n")
    spare = e.address("%work", e.value(f"add nsw i64 {e.value(f'add nsw i64 {square}, 1')}, {_twice(e, '%n')}"))
    status = e.value("call i32 @factor_dense(i64 %n, ptr %a, ptr %work)")
    with e.loop(0, "%n") as j:
        column = e.address("%out", e.value(f"mul nsw i64 {j}, %n"))
        with e.loop(0, "%n") as i:
            e.put(literal(0.0), column, i)
        e.put(literal(1.0), column, j)
        e.do(f"call void @solve_factored(i64 %n, ptr %work, ptr {column}, ptr {spare})")
    e.do(f"ret i32 {status}")
    return e.function("define i32 @invert_dense(i64 %n, ptr noalias %a, ptr noalias %out, ptr noalias %work)")


def _twice(e: Emitter, n: str) -> str:
    return e.value(f"shl nsw i64 {n}, 1")
