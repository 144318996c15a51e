"""Newton's method in machine code, for the unknowns of a step.

They are predicted from the steps before and corrected with a matrix that is kept from step to step, until the
corrections are lost in round-off (equal steps) or far below the tolerance (steps that follow the error). Where they
shrink slowly the matrix is made anew. `lagrange.machine.steps.interpreted_newton` does the same, and is the place to
read it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.steps.llvm_calls import GIVEN, LAW, RECORDS, bump, evaluate, leave_if, leave_with
from lagrange.machine.steps.llvm_layout import (
    BLOCK,
    KIND,
    Layout,
    Newton,
    Scalars,
    blocks,
    combine,
    in_work,
    splat,
    total,
)
from lagrange.machine.steps.llvm_prediction import predict
from lagrange.machine.steps.newton_constants import (
    AGING,
    ASTRAY,
    FARTHEST,
    FRACTION,
    FRESH_RATE,
    GROWTH,
    HOPELESS,
    LARGEST,
    LEAST_RATE,
    MOST,
    MOST_TIMES,
    NOISE,
    OLD,
    OLDEST,
    OLDEST_RATE,
    REST,
    ROUND_OFF,
    SLOW,
    STALLED,
    STALLED_RATE,
    TURNS,
)

UNROLLED_PRODUCT = 64
"""A product of matrix and vector is written out up to this many blocks."""


def newton_functions(layout: Layout, prefix: str = "") -> list[str]:
    """Emit newton0, newton1, ... of a step: newton(law, t, h, reals, counts, work) -> an outcome."""
    made = []
    for newton in layout.solves:
        made += [_start(layout, newton, prefix), _iterate(layout, newton, prefix), _solve(layout, newton, prefix)]
    return made


def _solve(layout: Layout, newton: Newton, prefix: str) -> str:
    """Predict and iterate; where that fails, start again from the guess with a new matrix."""
    e = Emitter()
    flags = e.address("%work", newton.flags)
    if newton.adaptive:
        e.put("%h", flags, Newton.TRIED_STEP)
        e.do(f"%ratio = fdiv double %h, {e.get(flags, Newton.OLD_STEP)}")
        _tolerated(e, layout, newton)
    known = e.get(flags, Newton.KNOWN, "i64")
    name = f"{prefix}newton{newton.index}"
    again = f"@{prefix}iterate{newton.index}({LAW}, double %t, double %h, {GIVEN})"
    begin = f"@{prefix}start{newton.index}({LAW}, double %t, double %h, {GIVEN})"
    e.do(f"br i1 {e.value(f'icmp sgt i64 {known}, 0')}, label %predict, label %fresh")
    e.label("predict")
    predict(e, layout, newton)
    outcome = e.value(f"call i32 {again}")
    e.do(f"br i1 {e.value(f'icmp eq i32 {outcome}, 0')}, label %done, label %fresh")
    e.label("fresh")
    e.put(literal(0.0), flags, Newton.DERIVATIVE)
    e.put(literal(0.0), flags, Newton.MATRIX_STEP)
    e.put(literal(1.0), flags, Newton.RATE)
    e.put("0", flags, Newton.KNOWN, "i64")
    leave_with(e, e.value(f"call i32 {begin}"))
    leave_with(e, e.value(f"call i32 {again}"))
    e.jump("done")
    e.label("done")
    e.put(literal(1.0), flags, Newton.SOLVED)
    e.do("ret i32 0")
    return e.function(f"define internal i32 @{name}({LAW}, double %t, double %h, {RECORDS})")


def _start(layout: Layout, newton: Newton, prefix: str) -> str:
    """Set the unknowns to their guesses."""
    solve, step, e = newton.solve, layout.step, Emitter()
    calls = [argument for call in solve.preparation for argument in call.arguments]
    scalars = Scalars(e, step, [*calls, *solve.guesses], [call.time for call in solve.preparation])
    status = e.reserve("i32")
    e.store("0", status, "i32")
    for call in solve.preparation:
        evaluate(e, layout, scalars, call, status)
    bump(e, DriverState.EVALUATIONS, len(solve.preparation))
    for i, guess in enumerate(solve.guesses):
        combine(e, layout, scalars, guess, layout.place(solve.first + i))
    leave_if(e, e.value(f"icmp ne i32 {e.load(status, 'i32')}, 0"), Outcome.SINGULAR)
    e.do("ret i32 0")
    return e.function(
        f"define internal i32 @{prefix}start{newton.index}({LAW}, double %t, double %h, {RECORDS}) noinline"
    )


def _tolerated(e: Emitter, layout: Layout, newton: Newton) -> None:
    """Weigh corrections by what they move in the arguments of the calls, against the tolerances."""
    solve = newton.solve
    reached = [solve.reach(i) for i in range(solve.count)]
    scalars = Scalars(e, layout.step, [], [factor for factors, _ in reached for factor in factors])
    rtol, atol = (splat(e, e.get("%reals", which)) for which in (DriverState.RTOL, DriverState.ATOL))
    for i, (factors, argument) in enumerate(reached):
        largest = literal(0.0)
        for factor in factors:
            largest = e.larger(largest, e.fabs(scalars.names[factor]))
        weight = splat(e, largest)
        for offset in blocks(e, newton.width):
            size = e.fabs(e.load(in_work(e, layout.place(argument), offset), KIND), KIND)
            value = e.value(f"fdiv {KIND} {weight}, {e.fma(rtol, size, atol, KIND)}")
            e.store(value, in_work(e, newton.weights + i * newton.width, offset), KIND)


def _iterate(layout: Layout, newton: Newton, prefix: str) -> str:
    """Correct the unknowns until what is left is too small to matter."""
    solve, e = newton.solve, Emitter()
    calls = [argument for call in solve.calls for argument in call.arguments]
    scalars = Scalars(e, layout.step, [*calls, *solve.residuals], [call.time for call in solve.calls])
    flags = e.address("%work", newton.flags)
    status = e.reserve("i32")
    previous, since, moved = e.reserve("double"), e.reserve("double"), e.reserve("double")
    e.store(literal(0.0), previous)
    e.store(literal(0.0), moved)
    e.store(literal(float(OLD)), since)
    most = MOST_TIMES if newton.adaptive else MOST
    with e.loop(0, most) as turn:
        e.store("0", status, "i32")
        for call in solve.calls:
            evaluate(e, layout, scalars, call, status, always=True)
        bump(e, DriverState.EVALUATIONS, len(solve.calls))
        leave_if(e, e.value(f"icmp ne i32 {e.load(status, 'i32')}, 0"), Outcome.SINGULAR)
        for i, residual in enumerate(solve.residuals):
            combine(e, layout, scalars, residual, newton.residual + i * newton.width)
        with e.when(e.real("fcmp une", e.get(flags, Newton.MATRIX_STEP), "%h")):
            renewed = f"call i32 @{prefix}renew{newton.index}({LAW}, double %t, double %h, {GIVEN})"
            leave_with(e, e.value(renewed))
            e.store(literal(0.0), since)
        norm = _correct(e, layout, newton)
        unit = e.get("%reals", DriverState.RTOL) if newton.adaptive else literal(ROUND_OFF)
        e.put(e.real("fmul", norm, unit), "%reals", DriverState.RESIDUAL)
        _leave_broken(e, norm, e.load(previous), unit)
        if not newton.adaptive:
            e.store(e.fma(norm, unit, e.load(moved)), moved)
            leave_if(e, e.real("fcmp ogt", e.load(moved), literal(FARTHEST)), Outcome.DIVERGED)
        _judge(e, newton, turn, norm, e.load(previous), since)
        e.store(norm, previous)
        e.store(e.real("fadd", e.load(since), literal(1.0)), since)
    e.do(f"ret i32 {int(Outcome.DIVERGED)}")
    return e.function(
        f"define internal i32 @{prefix}iterate{newton.index}({LAW}, double %t, double %h, {RECORDS}) noinline"
    )


def _leave_broken(e: Emitter, norm: str, previous: str, unit: str) -> None:
    """Return where a correction is no number: the law is not, unless a large correction before it went astray."""
    bad = e.value(f"xor i1 {e.real('fcmp olt', norm, literal(LARGEST))}, true")
    near = e.real("fcmp olt", e.real("fmul", previous, unit), literal(ASTRAY))
    leave_if(e, e.value(f"and i1 {bad}, {near}"), Outcome.NON_FINITE)
    leave_if(e, bad, Outcome.DIVERGED)


def _judge(e: Emitter, newton: Newton, turn: str, norm: str, previous: str, since: str) -> None:
    """Return where the unknowns are good enough, and have the matrix made anew where the corrections shrink slowly."""
    flags = e.address("%work", newton.flags)
    first = e.value(f"icmp eq i64 {turn}, 0")
    kept = e.get(flags, Newton.RATE)
    measured = e.real("fdiv", norm, previous)
    rate = e.choose(first, kept, measured)
    enough = literal(FRACTION) if newton.adaptive else e.get(flags, Newton.NOISE)
    left = e.real("fmul", norm, rate)
    part = enough if newton.adaptive else e.real("fmul", enough, literal(REST))
    small = e.real("fcmp ole", left, e.real("fmul", e.real("fsub", literal(1.0), rate), part))
    if not newton.adaptive:
        both = e.real("fcmp ole", e.larger(norm, e.choose(first, literal(math.inf), previous)), enough)
        small = e.value(f"or i1 {small}, {both}")
    with e.when(small):
        aged = e.smaller(e.real("fmul", kept, literal(AGING)), literal(OLDEST_RATE))
        e.put(e.choose(first, aged, e.larger(measured, literal(LEAST_RATE))), flags, Newton.RATE)
        _plan_matrix(e, newton, turn, measured)
        e.do("ret i32 0")
        e.label(e.fresh("never"))
    slow = e.real("fcmp ugt", rate, literal(SLOW))
    slow = e.value(f"and i1 {slow}, {e.value(f'xor i1 {first}, true')}")
    with e.when(slow):
        if newton.adaptive:
            leave_if(e, e.real("fcmp ugt", rate, literal(HOPELESS)), Outcome.DIVERGED)
        else:
            _stall(e, flags, norm, rate, since)


def _plan_matrix(e: Emitter, newton: Newton, turn: str, measured: str) -> None:
    """Decide whether the next step is to have a new matrix, and let the noise of round-off be forgotten slowly."""
    flags = e.address("%work", newton.flags)
    age = e.real("fadd", e.get(flags, Newton.AGE), literal(1.0))
    e.put(age, flags, Newton.AGE)
    if newton.adaptive:
        many = e.value(f"icmp sgt i64 {turn}, 0")
        tired = e.value(f"and i1 {many}, {e.real('fcmp ogt', measured, literal(FRESH_RATE))}")
    else:
        many = e.value(f"icmp sge i64 {turn}, {TURNS}")
        tired = e.value(f"and i1 {many}, {e.real('fcmp oge', age, literal(float(OLD)))}")
        tired = e.value(f"or i1 {tired}, {e.real('fcmp oge', age, literal(float(OLDEST)))}")
        noise = e.real("fmul", e.get(flags, Newton.NOISE), literal(NOISE))
        e.put(e.larger(noise, literal(1.0)), flags, Newton.NOISE)
    with e.when(tired):
        e.put(literal(0.0), flags, Newton.MATRIX_STEP)
        e.put(literal(0.0), flags, Newton.DERIVATIVE)


def _stall(e: Emitter, flags: str, norm: str, rate: str, since: str) -> None:
    """Take the unknowns where a new matrix no longer shrinks small corrections; give up where large ones grow."""
    turns = e.load(since)
    old = e.real("fcmp oge", turns, literal(float(OLD)))
    young = e.real("fcmp oge", turns, literal(1.0))
    fresh = e.value(f"and i1 {young}, {e.value(f'xor i1 {old}, true')}")
    stuck = e.value(
        f"and i1 {e.real('fcmp oge', rate, literal(STALLED_RATE))}, {e.real('fcmp olt', norm, literal(STALLED))}"
    )
    with e.when(e.value(f"and i1 {fresh}, {stuck}")):
        e.put(e.real("fmul", literal(2.0), norm), flags, Newton.NOISE)
        e.do("ret i32 0")
        e.label(e.fresh("never"))
    large = e.real("fcmp oge", norm, literal(STALLED))
    grown = e.value(f"and i1 {large}, {e.real('fcmp oge', rate, literal(GROWTH))}")
    leave_if(e, e.value(f"and i1 {fresh}, {grown}"), Outcome.DIVERGED)
    with e.when(old):
        e.put(literal(0.0), flags, Newton.MATRIX_STEP)
        e.put(literal(0.0), flags, Newton.DERIVATIVE)


def _correct(e: Emitter, layout: Layout, newton: Newton) -> str:
    """Add the correction to the unknowns and return its weighted RMS norm."""
    first = layout.place(newton.solve.first)
    squares = e.reserve(KIND)
    e.store("zeroinitializer", squares, KIND)
    for offset, correction in product(e, newton, newton.inverse, newton.solve.count):
        place = in_work(e, first, offset)
        e.store(e.value(f"fadd {KIND} {e.load(place, KIND)}, {correction}"), place, KIND)
        weighted = e.value(f"fmul {KIND} {correction}, {e.load(in_work(e, newton.weights, offset), KIND)}")
        e.store(e.fma(weighted, weighted, e.load(squares, KIND), KIND), squares, KIND)
    mean = e.real("fmul", total(e, e.load(squares, KIND)), literal(1.0 / newton.unknowns))
    return e.value(f"call double @llvm.sqrt.f64(double {mean})")


def multiply(e: Emitter, newton: Newton, matrix: int, vectors: int, target: int) -> None:
    """Store the product of a matrix of a solve with its residuals."""
    for offset, value in product(e, newton, matrix, vectors):
        e.store(value, in_work(e, target, offset), KIND)


def product(e: Emitter, newton: Newton, matrix: int, vectors: int) -> Iterator[tuple[str | int, str]]:
    """Yield the product of a matrix, by columns, with the first residuals, block by block with its offset."""
    width = vectors * newton.width
    columns = vectors * newton.length
    if columns * width <= UNROLLED_PRODUCT * BLOCK:
        places = [i * newton.width + a for i in range(vectors) for a in range(newton.length)]
        entries = [splat(e, e.get("%work", newton.residual + place)) for place in places]
        for offset in range(0, width, BLOCK):
            sums = ["", ""]
            for j, entry in enumerate(entries):
                column = e.load(in_work(e, matrix + j * width, offset), KIND)
                old = sums[j % 2]
                sums[j % 2] = e.fma(column, entry, old, KIND) if old else e.value(f"fmul {KIND} {column}, {entry}")
            yield offset, e.value(f"fadd {KIND} {sums[0]}, {sums[1]}") if sums[1] else sums[0]
        return
    cell = e.reserve(KIND)
    with e.loop(0, width, BLOCK) as row:
        e.store("zeroinitializer", cell, KIND)
        with e.loop(0, vectors) as i, e.loop(0, newton.length) as a:
            at = e.value(f"add nsw i64 {e.value(f'mul nsw i64 {i}, {newton.width}')}, {a}")
            column = e.value(f"add nsw i64 {e.value(f'mul nsw i64 {i}, {newton.length}')}, {a}")
            entry = splat(e, e.get(e.address("%work", newton.residual), at))
            start = e.address(e.address("%work", matrix), e.value(f"mul nsw i64 {column}, {width}"))
            e.store(e.fma(e.load(e.address(start, row), KIND), entry, e.load(cell, KIND), KIND), cell, KIND)
        yield row, e.load(cell, KIND)
