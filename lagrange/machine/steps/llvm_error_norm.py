"""What step control measures: the scaled error of a step, and a first step from two slopes."""

from __future__ import annotations

from lagrange.machine.kernel.llvm_calling import BLOCK
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import LEAST_FLOOR, SPACING, DriverState
from lagrange.machine.steps.control_constants import (
    ALONE,
    CANCELLED,
    DAMPING,
    FIRST_SHARE,
    FIRST_TRIAL,
    FLAT,
    LEAST_FIRST,
    NOISE,
    RESOLVED,
    TILT,
    tilts,
)
from lagrange.machine.steps.llvm_calls import evaluate_in_place
from lagrange.machine.steps.llvm_layout import KIND, TRUTH, blocks, in_floors, in_work, largest, splat, total
from lagrange.procedure.step.memory import Layout
from lagrange.program.step import StepProgram


def norm_function(step: StepProgram, layout: Layout) -> str:
    """Emit norm(reals, work): the scaled error of the trial step."""
    e = Emitter()
    sums = [e.reserve(KIND) for _ in step.errors]
    for memory in sums:
        e.store("zeroinitializer", memory, KIND)
    rtol = splat(e, e.get("%reals", DriverState.RTOL))
    for offset in blocks(e, layout.width):
        old = e.load(in_work(e, 0, offset), KIND)
        new = e.load(in_work(e, layout.place(layout.new), offset), KIND)
        sizes = f"{KIND} {e.fabs(old, KIND)}, {KIND} {e.fabs(new, KIND)}"
        size = e.value(f"call {KIND} @llvm.maximum.v{BLOCK}f64({sizes})")
        scale = e.fma(rtol, size, e.load(in_floors(e, offset), KIND), KIND)
        for i, memory in enumerate(sums):
            error = e.load(in_work(e, layout.place(layout.errors + i), offset), KIND)
            ratio = e.value(f"fdiv {KIND} {error}, {scale}")
            e.store(e.fma(ratio, ratio, e.load(memory, KIND), KIND), memory, KIND)
    totals = [total(e, e.load(memory, KIND)) for memory in sums]
    dimension = literal(float(layout.dimension))
    if step.control and step.control.damped:
        mixed = e.fma(literal(DAMPING), totals[1], totals[0])
        positive = e.value(f"fcmp ogt double {mixed}, {literal(0.0)}")
        product = e.value(f"fmul double {mixed}, {dimension}")
        safe = e.value(f"select i1 {positive}, double {product}, double {literal(1.0)}")
        root = e.value(f"call double @llvm.sqrt.f64(double {safe})")
        e.do(f"ret double {e.value(f'fdiv double {totals[0]}, {root}')}")
    else:
        mean = e.value(f"fdiv double {totals[0]}, {dimension}")
        e.do(f"ret double {e.value(f'call double @llvm.sqrt.f64(double {mean})')}")
    return e.function("define internal double @norm(ptr noalias readonly %reals, ptr noalias %work)")


def raise_floors(e: Emitter, layout: Layout) -> None:
    """Raise the floors to their share of the new state; see `DriverState`."""
    share = splat(e, e.get("%reals", DriverState.SHARE))
    for offset in blocks(e, layout.width):
        new = e.fabs(e.load(in_work(e, layout.place(layout.new), offset), KIND), KIND)
        _raise(e, in_floors(e, offset), e.value(f"fmul {KIND} {share}, {new}"))


def _raise(e: Emitter, place: str, value: str) -> None:
    """Let a block of floors be no lower than a value."""
    floor = e.load(place, KIND)
    higher = e.value(f"fcmp ogt {KIND} {value}, {floor}")
    e.store(e.value(f"select {TRUTH} {higher}, {KIND} {value}, {KIND} {floor}"), place, KIND)


def some_blank(e: Emitter, layout: Layout, *, moved: bool) -> str:
    """Return whether some entry has no floor yet, of those that the trial step has `moved` from zero if that is set."""
    memory = e.reserve(KIND)
    e.store("zeroinitializer", memory, KIND)
    least = splat(e, literal(LEAST_FLOOR))
    for offset in blocks(e, layout.width):
        floor = e.load(in_floors(e, offset), KIND)
        value = e.load(in_work(e, layout.place(layout.new), offset), KIND) if moved else floor
        blank = e.value(f"fcmp ole {KIND} {floor}, {least}")
        found = e.value(f"select {TRUTH} {blank}, {KIND} {e.fabs(value, KIND)}, {KIND} zeroinitializer")
        both = f"{KIND} {e.load(memory, KIND)}, {KIND} {found}"
        e.store(e.value(f"call {KIND} @llvm.maximum.v{BLOCK}f64({both})"), memory, KIND)
    return e.real("fcmp ogt", largest(e, e.load(memory, KIND)), literal(0.0))


def first_step_function(step: StepProgram, layout: Layout) -> str:
    """Emit first_step: the size of a first step, from how slopes change over a short one; see the numpy driver.

    It is negative where the driver is to ask how large the entries are.
    """
    e = Emitter()
    slope = layout.place(layout.vectors - 1)
    evaluate_in_place(e, layout, "%t", 0, layout.result)
    for offset in blocks(e, layout.width):
        e.store(e.load(in_work(e, layout.result, offset), KIND), in_work(e, slope, offset), KIND)
    rate = _trial_rate(e, layout, slope)
    moving = e.real("fcmp ogt", rate, literal(0.0))
    given = e.real("fmul", literal(FIRST_TRIAL), "%span")
    trial = e.smaller(e.choose(moving, e.real("fdiv", literal(FIRST_SHARE), rate), given), "%span")
    _second_slope(e, layout, slope, e.real("fmul", trial, "%direction"))
    scratch, later = layout.place(layout.new), layout.place(layout.errors)
    for offset in blocks(e, layout.width):
        e.store(e.load(in_work(e, layout.result, offset), KIND), in_work(e, later, offset), KIND)
    follows = e.real("fcmp ogt", e.get("%reals", DriverState.SHARE), literal(0.0))
    squared, asked = _squares(e, layout, slope, later, trial, scratch)
    new = e.value(f"icmp eq i64 {e.get('%counts', DriverState.SURVEYED, 'i64')}, 0")
    with e.when(e.value(f"and i1 {e.value(f'and i1 {follows}, {new}')}, {asked}")):
        e.do(f"br i1 {asked}, label %ask, label %known")
        e.label("ask")
        e.do(f"ret double {literal(-1.0)}")
        e.label("known")
    change = e.value(f"call double @llvm.sqrt.f64(double {squared})")
    some = e.real("fcmp ogt", change, literal(0.0))
    known = e.value(f"and i1 {some}, {e.real('fcmp olt', change, literal(float('inf')))}")
    rate = e.choose(known, change, rate)
    exponent = 1.0 / (step.control.exponent if step.control else 1)
    aim = e.power(e.real("fmul", literal(FIRST_SHARE), e.get("%reals", DriverState.RTOL)), exponent)
    moving = e.real("fcmp ogt", rate, literal(0.0))
    flat = e.real("fmul", literal(FLAT), "%span")
    least = e.real("fmul", e.fabs("%t"), literal(RESOLVED * SPACING))
    h = e.smaller(e.larger(e.choose(moving, e.real("fdiv", aim, rate), flat), least), "%span")
    with e.when(follows):
        _first_floors(e, layout, slope, later, h, e.real("fdiv", h, trial))
        _noise_floors(e, layout, scratch, e.choose(moving, e.real("fdiv", literal(1.0), rate), literal(0.0)))
    e.do(f"ret double {h}")
    return e.function(
        "define internal double @first_step(ptr %rhs, ptr %p, double %t, double %span, double %direction, "
        "ptr noalias %reals, ptr noalias %counts, ptr noalias %work)"
    )


def _sizes(e: Emitter, place: str) -> tuple[str, str, str]:
    """Return the size of an entry, what counts as that beside its floor, and whether it is not zero."""
    size = e.fabs(e.get("%work", place))
    floor = e.get(e.address("%reals", DriverState.FLOORS), place)
    whole = e.real("fadd", size, e.real("fdiv", floor, e.get("%reals", DriverState.RTOL)))
    return size, whole, e.real("fcmp ogt", size, literal(0.0))


def _trial_rate(e: Emitter, layout: Layout, slope: int) -> str:
    """Return the rate by which the trial length is found, from accelerations alone."""
    half, found = layout.dimension // 2, e.reserve("double")
    e.store(literal(0.0), found)
    base = e.address("%work", slope)
    with e.loop(0, half) as i:
        below = e.value(f"add nsw i64 {i}, {half}")
        force = e.fabs(e.get(base, below))
        (_, far, at), (_, speed, moves) = _sizes(e, i), _sizes(e, below)
        by_place = e.value(f"call double @llvm.sqrt.f64(double {e.real('fdiv', force, far)})")
        other = e.choose(moves, e.real("fdiv", force, speed), literal(0.0))
        e.store(e.larger(e.load(found), e.choose(at, by_place, other)), found)
    return e.load(found)


def _squares(e: Emitter, layout: Layout, slope: int, later: int, trial: str, scratch: int) -> tuple[str, str]:
    """Return the square of the rate that the first step follows, and whether to ask for sizes; see the numpy driver.

    What accelerations that may be round-off owe to the state is kept in the second half of a vector.
    """
    for k, tilt in enumerate(tilts(layout.dimension).tolist()):
        tilted = e.real("fmul", e.get("%work", k), literal(1 + TILT * tilt))
        e.put(tilted, "%work", layout.argument + k)
    evaluate_in_place(e, layout, "%t", layout.argument, layout.result)
    cells = doubtful, others, moving, paired = [e.reserve("double") for _ in range(4)]
    for cell in cells:
        e.store(literal(0.0), cell)
    half, zero, infinite = layout.dimension // 2, literal(0.0), literal(float("inf"))
    first, second, third, kept = (e.address("%work", place) for place in (slope, later, layout.result, scratch))
    with e.loop(0, half) as i:
        below = e.value(f"add nsw i64 {i}, {half}")
        here = e.get(first, below)
        force = e.fabs(here)
        owed = e.real("fdiv", e.fabs(e.real("fsub", e.get(third, below), here)), literal(TILT))
        doubt = e.real("fcmp olt", force, e.real("fmul", literal(CANCELLED), owed))
        (_, far, at), (_, speed, moves) = _sizes(e, i), _sizes(e, below)
        jerk = e.real("fdiv", e.real("fdiv", e.fabs(e.real("fsub", e.get(second, below), here)), trial), speed)
        jerk = e.choose(moves, jerk, zero)
        part = e.real("fdiv", force, speed)
        by_place = e.choose(at, e.real("fdiv", force, far), infinite)
        other = e.smaller(by_place, e.choose(moves, e.real("fmul", part, part), infinite))
        some = e.value(f"or i1 {at}, {moves}")
        square = e.choose(e.real("fcmp ogt", jerk, zero), jerk, e.choose(some, other, zero))
        counts = e.value(f"and i1 {doubt}, {at}")
        values = (
            (doubtful, e.choose(doubt, square, zero)),
            (others, e.choose(doubt, zero, square)),
            (moving, e.larger(force, e.fabs(e.get(first, i)))),
            (paired, e.choose(counts, e.real("fdiv", owed, far), zero)),
        )
        for cell, value in values:
            e.store(e.larger(e.load(cell), value), cell)
        e.put(e.choose(doubt, owed, zero), kept, below)
    largest_one = e.larger(e.larger(e.load(doubtful), e.load(others)), e.load(paired))
    alone = e.real("fcmp ogt", e.load(doubtful), e.real("fmul", literal(ALONE), e.load(others)))
    return largest_one, e.value(f"or i1 {alone}, {e.real('fcmp oeq', e.load(moving), zero)}")


def _noise_floors(e: Emitter, layout: Layout, squares: int, period: str) -> None:
    """Let floors lie above round-off of accelerations that cancel, over a period."""
    half, owed = layout.dimension // 2, e.address("%work", squares)
    floors = e.address("%reals", DriverState.FLOORS)
    part = e.real("fmul", period, literal(NOISE))
    with e.loop(0, half) as i:
        below = e.value(f"add nsw i64 {i}, {half}")
        noise = e.real("fmul", part, e.get(owed, below))
        for place, least in ((i, e.real("fmul", period, noise)), (below, noise)):
            e.put(e.larger(e.get(floors, place), least), floors, place)


def _second_slope(e: Emitter, layout: Layout, slope: int, h: str) -> None:
    """Evaluate the right-hand side after an Euler step of h."""
    factor = splat(e, h)
    for offset in blocks(e, layout.width):
        moved = e.fma(factor, e.load(in_work(e, slope, offset), KIND), e.load(in_work(e, 0, offset), KIND), KIND)
        e.store(moved, in_work(e, layout.argument, offset), KIND)
    evaluate_in_place(e, layout, e.real("fadd", "%t", h), layout.argument, layout.result)


def _first_floors(e: Emitter, layout: Layout, slope: int, second: int, h: str, longer: str) -> None:
    """Let the floors of entries that are zero begin with what a step of h reaches by its slopes."""
    share = e.larger(e.get("%reals", DriverState.SHARE), literal(LEAST_FIRST))
    factor, times = splat(e, e.real("fmul", share, h)), splat(e, longer)
    infinite = splat(e, literal(float("inf")))
    for offset in blocks(e, layout.width):
        here, later = (e.load(in_work(e, place, offset), KIND) for place in (slope, second))
        change = e.value(f"fsub {KIND} {later}, {here}")
        one, two = e.fabs(here, KIND), e.fabs(e.fma(change, times, here, KIND), KIND)
        below = e.value(f"fcmp olt {KIND} {two}, {infinite}")
        still = e.value(f"fcmp oeq {KIND} {one}, zeroinitializer")
        both = e.value(f"and {TRUTH} {below}, {still}")
        speed = e.value(f"select {TRUTH} {both}, {KIND} {two}, {KIND} {one}")
        zero = e.value(f"fcmp oeq {KIND} {e.load(in_work(e, 0, offset), KIND)}, zeroinitializer")
        reach = e.value(f"fmul {KIND} {factor}, {speed}")
        _raise(e, in_floors(e, offset), e.value(f"select {TRUTH} {zero}, {KIND} {reach}, {KIND} zeroinitializer"))
