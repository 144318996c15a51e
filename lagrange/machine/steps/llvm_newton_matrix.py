"""The matrix of Newton's method in machine code: built from the law's derivative, inverted, and what round-off allows.

With unknowns z_j and the calls c of a solve, the derivative of residual i in unknown j is beta_ij I + g_ij J, where J
is the derivative of the law at one point and g_ij the sum over c of the factor of c in residual i times that of z_j in
the argument of c. A law of momenta has J in four blocks, each with its own g.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.procedures import function
from lagrange.machine.state import Outcome
from lagrange.machine.steps.llvm_calls import LAW, RECORDS, leave_if, place_arguments
from lagrange.machine.steps.llvm_layout import (
    KIND,
    Layout,
    Newton,
    Scalars,
    blocks,
    combine,
    cut_block,
    in_work,
    splat,
    unit_block,
)
from lagrange.machine.steps.newton_constants import LEAST_ROUND_OFF, ROUND_OFF, Kept
from lagrange.procedure.linear.gauss_jordan import inversion
from lagrange.program.actions import LAWS, Call, Combination, Solve


def renew_functions(layout: Layout, prefix: str = "") -> list[str]:
    """Emit renew0, renew1, ... of a step: renew(law, t, h, reals, counts, work) -> an outcome."""
    return [_renew(layout, newton, prefix) for newton in layout.solves]


def inversion_functions(layout: Layout) -> list[str]:
    """Emit the inversions that a step needs, and its starter."""
    orders = {newton.unknowns: None for newton in layout.solves}
    orders |= {newton.length: None for newton in layout.solves if newton.damped or layout.step.law == "momentum"}
    orders |= {newton.unknowns: None for newton in layout.starting.solves}
    return [function(inversion(order), hidden=True) for order in orders]


def _renew(layout: Layout, newton: Newton, prefix: str) -> str:
    e, step, solve = Emitter(), layout.step, newton.solve
    flags = e.address("%work", newton.flags)
    point = None if newton.adaptive else solve.calls[(len(solve.calls) - 1) // 2]
    identity, factors = coefficients(layout, solve)
    shares = _shares(layout, solve)
    spoken = [*solve.residuals, *(point.arguments if point else ())]
    nodes = [*identity, *factors, *shares, *(damp.factor for damp in newton.damped), *([point.time] if point else [])]
    scalars = Scalars(e, step, spoken, nodes)
    with e.when(e.real("fcmp oeq", e.get(flags, Newton.DERIVATIVE), literal(0.0))):
        _differentiate(e, layout, newton, scalars, point)
    tables = [_table(e, scalars, values) for values in (identity, factors)]
    _build(e, layout, newton, tables[0], tables[1])
    singular = _invert(e, newton, newton.unknowns)
    _spread(e, newton)
    if step.law == "momentum":
        with e.when(singular):
            _blame_mass(e, layout, newton)
    for i, damp in enumerate(newton.damped):
        _damper(e, layout, newton, scalars.names[damp.factor], newton.dampers + i * newton.length * newton.width)
    if point is not None:
        _weigh(e, layout, newton, scalars, point, _table(e, scalars, shares, size=True))
        e.put(literal(1.0), flags, Newton.RATE)
        e.put(literal(1.0), flags, Newton.NOISE)
        e.put(literal(0.0), flags, Newton.AGE)
    e.put("%h", flags, Newton.MATRIX_STEP)
    e.do("ret i32 0")
    return e.function(
        f"define internal i32 @{prefix}renew{newton.index}({LAW}, double %t, double %h, {RECORDS}) noinline"
    )


def factor_of(combination: Combination, vector: int) -> Node | None:
    """Return the factor of a vector in a combination, if it is there."""
    return next((factor for i, factor in combination if i == vector), None)


def coefficients(layout: Layout, solve: Solve) -> tuple[list[Node], list[Node]]:
    """Return beta by rows (i, j), and g by rows (i, j, result, argument)."""
    zero, law = layout.step.graph.zero, LAWS[layout.step.law]
    unknowns = range(solve.first, solve.first + solve.count)
    identity = [factor_of(residual, z) or zero for residual in solve.residuals for z in unknowns]
    factors = []
    for residual in solve.residuals:
        for z in unknowns:
            for result in range(law.results):
                for argument in range(law.arguments):
                    total = zero
                    for call in solve.calls:
                        outer = factor_of(residual, call.first + result)
                        inner = factor_of(call.arguments[argument], z)
                        total = total if outer is None or inner is None else total + outer * inner
                    factors.append(total)
    return identity, factors


def _shares(layout: Layout, solve: Solve) -> list[Node]:
    """Return the factor of each result of each call in each residual, by rows (i, result, call)."""
    zero, results = layout.step.graph.zero, range(LAWS[layout.step.law].results)
    return [
        factor_of(residual, call.first + result) or zero
        for residual in solve.residuals
        for result in results
        for call in solve.calls
    ]


def _table(e: Emitter, scalars: Scalars, values: Sequence[Node], *, size: bool = False) -> str:
    """Store numbers, or their sizes, in memory of the function, and return its address."""
    memory = e.reserve("double", len(values))
    for i, value in enumerate(values):
        name = scalars.names[value]
        e.put(e.fabs(name) if size else name, memory, i)
    return memory


def _differentiate(e: Emitter, layout: Layout, newton: Newton, scalars: Scalars, point: Call | None) -> None:
    """Evaluate the derivative of the law: at the middle call of the residuals, or else where the step starts."""
    if point is None:
        time = "%t"
        for i in range(layout.step.states):
            for offset in blocks(e, layout.width):
                value = e.load(in_work(e, layout.place(i), offset), KIND)
                e.store(value, in_work(e, layout.argument + i * layout.length, offset), KIND)
        where = e.address("%work", layout.argument)
    else:
        time = scalars.names[point.time]
        where = place_arguments(e, layout, scalars, point)
    made, kept = e.address("%work", newton.matrix), e.address("%work", newton.derivative)
    status = e.value(f"call i32 %jacobian(double {time}, ptr {where}, ptr %jp, ptr {made})")
    leave_if(e, e.value(f"icmp ne i32 {status}, 0"), Outcome.SINGULAR)
    n = layout.dimension
    with e.loop(0, n) as a, e.loop(0, n) as b:
        e.put(e.get(made, _index(e, (a, None), (b, n))), kept, _index(e, (b, None), (a, n)))
    e.put(literal(1.0), "%work", newton.flags + Newton.DERIVATIVE)


def _index(e: Emitter, *digits: tuple[str | int, int | None]) -> str:
    """Return a number written with digits, each before its base: ((i, None), (j, 3), (k, 5)) is (3 i + j) 5 + k."""
    value = str(digits[0][0])
    for digit, base in digits[1:]:
        value = e.value(f"mul nsw i64 {value}, {base}")
        value = e.value(f"add nsw i64 {value}, {digit}")
    return value


def _build(e: Emitter, layout: Layout, newton: Newton, identity: str, factors: str) -> None:
    """Store the transposed Newton matrix with the other sign by rows: those of its inverse are the columns to keep.

    A last block of a part runs on over what is stored after it.
    """
    count, length, law = newton.solve.count, newton.length, LAWS[layout.step.law]
    matrix, derivative = e.address("%work", newton.matrix), e.address("%work", newton.derivative)
    parts = [(r, s) for r in range(law.results) for s in range(law.arguments)]
    with e.loop(0, count) as j, e.loop(0, length) as b, e.loop(0, count) as i:
        pair = _index(e, (i, None), (j, count))
        own = [_minus(e, e.get(factors, _index(e, (pair, None), (k, len(parts))))) for k in range(len(parts))]
        one = _minus(e, e.get(identity, pair))
        start = e.address(matrix, _index(e, (_index(e, (j, None), (b, length)), None), (0, newton.stride)))
        start = e.address(start, e.value(f"mul nsw i64 {i}, {length}"))
        for a in blocks(e, newton.width):
            value = e.value(f"fmul {KIND} {one}, {unit_block(e, b, a)}")
            for (r, s), factor in zip(parts, own, strict=True):
                line = e.address(
                    derivative,
                    _index(e, (e.value(f"add nsw i64 {b}, {s * length}"), None), (r * length, layout.dimension)),
                )
                value = e.fma(factor, e.load(e.address(line, a), KIND), value, KIND)
            e.store(value, e.address(start, a), KIND)


def _minus(e: Emitter, value: str) -> str:
    """Return a number with the other sign in every entry of a block."""
    return splat(e, e.value(f"fneg double {value}"))


def _damper(e: Emitter, layout: Layout, newton: Newton, factor: str, target: int) -> None:
    """Store (I - factor J)^-1 by columns."""
    length = newton.length
    matrix, derivative = e.address("%work", newton.matrix), e.address("%work", newton.derivative)
    minus = _minus(e, factor)
    with e.loop(0, length) as b:
        start = e.address(matrix, e.value(f"mul nsw i64 {b}, {newton.width}"))
        line = e.address(derivative, e.value(f"mul nsw i64 {b}, {layout.dimension}"))
        for a in blocks(e, newton.width):
            e.store(
                e.fma(minus, e.load(e.address(line, a), KIND), unit_block(e, b, a), KIND), e.address(start, a), KIND
            )
    _invert(e, newton, length)
    with e.loop(0, length) as b:
        place = e.value(f"mul nsw i64 {b}, {newton.width}")
        _keep_column(e, newton, e.address(matrix, place), e.address(e.address("%work", target), place))


def _invert(e: Emitter, newton: Newton, order: int) -> str:
    places = [e.address("%work", place) for place in (newton.matrix, newton.pivots)]
    return e.value(f"call i1 @invert{order}(ptr {places[0]}, ptr {places[1]})")


def _blame_mass(e: Emitter, layout: Layout, newton: Newton) -> None:
    """Return if it is the mass matrix dp/dv that has no inverse, and not what the step makes of it."""
    matrix, derivative = e.address("%work", newton.matrix), e.address("%work", newton.derivative)
    with e.loop(0, newton.length) as a, e.loop(0, newton.length) as b:
        at = _index(e, (e.value(f"add nsw i64 {b}, {newton.length}"), None), (a, layout.dimension))
        e.put(e.get(derivative, at), matrix, _index(e, (a, None), (b, newton.width)))
    leave_if(e, _invert(e, newton, newton.length), Outcome.SINGULAR)


def _spread(e: Emitter, newton: Newton) -> None:
    """Store the inverse by padded columns, with the other sign: a residual then gives its correction."""
    matrix, inverse = e.address("%work", newton.matrix), e.address("%work", newton.inverse)
    with e.loop(0, newton.unknowns) as column, e.loop(0, newton.solve.count) as i:
        source = e.value(
            f"add nsw i64 {_index(e, (column, None), (0, newton.stride))}, {_index(e, (i, None), (0, newton.length))}"
        )
        target = e.value(
            f"add nsw i64 {_index(e, (column, None), (0, newton.all))}, {_index(e, (i, None), (0, newton.width))}"
        )
        _keep_column(e, newton, e.address(matrix, source), e.address(inverse, target))


def _keep_column(e: Emitter, newton: Newton, source: str, target: str) -> None:
    """Copy as many numbers as a vector has, with zeros up to whole blocks."""
    for a in blocks(e, newton.width):
        e.store(cut_block(e, e.load(e.address(source, a), KIND), newton.length, a), e.address(target, a), KIND)


def _weigh(e: Emitter, layout: Layout, newton: Newton, scalars: Scalars, point: Call, shares: str) -> None:
    """Weigh corrections against what rounding a residual and the arguments of its calls does to the unknowns.

    The sizes of the terms of a residual, and J times those of the arguments, are an error of one unit of round-off;
    the inverse takes it to the unknowns. Whatever the units of a system are, it is what no iteration can go below.
    """
    count, length, law = newton.solve.count, newton.length, LAWS[layout.step.law]
    for number, residual in enumerate(newton.solve.residuals):
        combine(e, layout, scalars, residual, newton.sizes + number * newton.width, sizes=True)
    for number, argument in enumerate(point.arguments):
        combine(e, layout, scalars, argument, newton.places + number * newton.width, sizes=True)
    sizes, places = e.address("%work", newton.sizes), e.address("%work", newton.places)
    derivative = e.address("%work", newton.derivative)
    calls = len(newton.solve.calls)
    with e.loop(0, count) as i, e.loop(0, law.results) as r:
        with e.carry(0, calls, [("double", literal(0.0))]) as sum_:
            at = _index(e, (i, None), (r, law.results), (sum_.index, calls))
            sum_.following = [e.real("fadd", sum_.values[0], e.get(shares, at))]
        share = sum_.values[0]
        with e.loop(0, length) as a, e.loop(0, law.arguments) as s, e.loop(0, length) as b:
            line, column = _index(e, (r, None), (a, length)), _index(e, (s, None), (b, length))
            entry = e.fabs(e.get(derivative, _index(e, (column, None), (line, layout.dimension))))
            moved = e.real("fmul", entry, e.get(places, _index(e, (s, None), (b, newton.width))))
            where = _index(e, (i, None), (a, newton.width))
            e.put(e.fma(share, moved, e.get(sizes, where)), sizes, where)
    inverse, weights = e.address("%work", newton.inverse), e.address("%work", newton.weights)
    with e.loop(0, count) as i, e.loop(0, length) as a:
        row = _index(e, (i, None), (a, newton.width))
        cell = e.reserve("double")
        e.store(literal(0.0), cell)
        with e.loop(0, count) as j, e.loop(0, length) as b:
            column = _index(e, (j, None), (b, length))
            entry = e.fabs(e.get(e.address(inverse, row), e.value(f"mul nsw i64 {column}, {newton.all}")))
            e.store(e.fma(entry, e.get(sizes, _index(e, (j, None), (b, newton.width))), e.load(cell)), cell)
        unit = e.fma(e.load(cell), literal(ROUND_OFF), literal(LEAST_ROUND_OFF))
        e.put(e.real("fdiv", literal(1.0), unit), weights, row)


def kept(newton: Newton, dimension: int, work: FloatArray) -> Kept:
    """Return what a solve keeps, read from the work array of the steps, or of those of the starter."""

    def columns(place: int, vectors: int) -> FloatArray:
        """Return the square matrix that stands by columns of so many padded vectors."""
        order = vectors * newton.length
        padded = work[place : place + order * vectors * newton.width].reshape(order, vectors, newton.width)
        return np.array(padded[:, :, : newton.length].reshape(order, order).T)

    size = newton.length * newton.width
    weights = work[newton.weights : newton.weights + newton.all].reshape(-1, newton.width)
    return Kept(
        step=float(work[newton.flags + Newton.MATRIX_STEP]),
        derivative=work[newton.derivative : newton.derivative + dimension**2].reshape(dimension, dimension).T.copy(),
        inverse=-columns(newton.inverse, newton.solve.count),
        dampers=tuple(columns(newton.dampers + i * size, 1) for i in range(len(newton.damped))),
        weights=weights[:, : newton.length].ravel(),
    )
