"""One trial step in machine code, and what accepting it does."""

from __future__ import annotations

from lagrange.machine.driver import DriverState
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.vectors import KIND, Layout, Scalars, blocks, combine, in_work
from lagrange.program.step import Combination, StepProgram


def step_function(step: StepProgram, layout: Layout) -> str:
    """Emit step(rhs, parameters, t, h, work, slope_known) -> 1 if the mass matrix was singular."""
    e = Emitter()
    nodes = [c for call in step.calls for _, c in call.argument] + [call.time for call in step.calls]
    nodes += [c for combination in (*step.results, *step.errors) for _, c in combination]
    scalars = Scalars(e, step, nodes)
    for combination in (*(call.argument for call in step.calls), *step.results, *step.errors):
        for _, coefficient in combination:
            if coefficient is not step.graph.one:
                scalars.splat(e, coefficient)
    status = e.reserve("i32")
    e.store("0", status, "i32")
    for i, call in enumerate(step.calls):
        if i == 0 and step.starts_with_slope:
            with e.when(e.value("icmp eq i64 %slope_known, 0")):
                _call(e, layout, scalars, call.argument, scalars.names[call.time], step.states, status)
        else:
            _call(e, layout, scalars, call.argument, scalars.names[call.time], step.states + i, status)
    for i, result in enumerate(step.results):
        combine(e, layout, scalars, result, layout.place(layout.new + i))
    for i, error in enumerate(step.errors):
        combine(e, layout, scalars, error, layout.place(layout.errors + i))
    e.do(f"ret i32 {e.load(status, 'i32')}")
    signature = "define internal i32 @step(ptr %rhs, ptr %p, double %t, double %h, ptr noalias %work, i64 %slope_known)"
    return e.function(signature)


def _call(
    e: Emitter, layout: Layout, scalars: Scalars, argument: Combination, time: str, target: int, status: str
) -> None:
    """Evaluate the right-hand side at a combination and keep the slope (or the accelerations) as a vector."""
    combine(e, layout, scalars, argument, layout.argument)
    where, out = e.address("%work", layout.argument), e.address("%work", layout.result)
    failed = e.value(f"call i32 %rhs(double {time}, ptr {where}, ptr %p, ptr {out})")
    e.store(e.value(f"or i32 {e.load(status, 'i32')}, {failed}"), status, "i32")
    source = layout.result + (layout.length if layout.step.partitioned else 0)
    for offset in blocks(e, layout):
        value = e.load(in_work(e, source, offset), KIND)
        e.store(value, in_work(e, layout.place(target), offset), KIND)


def record_function(layout: Layout) -> str:
    """Emit accept(counts, work, t, times, rows): the new state becomes the state, and a row if rows are kept."""
    e = Emitter()
    step = layout.step
    for i in range(step.states):
        for offset in blocks(e, layout):
            value = e.load(in_work(e, layout.place(layout.new + i), offset), KIND)
            e.store(value, in_work(e, layout.place(i), offset), KIND)
    if step.ends_with_slope:
        last = step.states + len(step.calls) - 1
        for offset in blocks(e, layout):
            value = e.load(in_work(e, layout.place(last), offset), KIND)
            e.store(value, in_work(e, layout.place(step.states), offset), KIND)
    e.put("1" if step.ends_with_slope else "0", "%counts", DriverState.SLOPE_KNOWN, "i64")
    bump(e, DriverState.STEPS, 1)
    keep = e.value(f"icmp ne i64 {e.get('%counts', DriverState.RECORD, 'i64')}, 0")
    with e.when(keep):
        row = e.get("%counts", DriverState.ROWS, "i64")
        e.put("%t", "%times", row)
        start = e.address("%rows", e.value(f"mul nsw i64 {row}, {layout.dimension}"))
        for i in range(step.states):
            base = e.address(start, i * layout.length)
            for offset in blocks(e, layout):
                value = e.load(in_work(e, layout.place(i), offset), KIND)
                e.store(value, e.address(base, offset), KIND)
        bump(e, DriverState.ROWS, 1)
    e.do("ret void")
    return e.function(
        "define internal void @accept(ptr noalias %counts, ptr noalias %work, double %t, ptr noalias %times, "
        "ptr noalias %rows)"
    )


def bump(e: Emitter, which: int, by: int | str) -> None:
    """Add to one of the counts."""
    value = e.get("%counts", which, "i64")
    e.put(e.value(f"add nsw i64 {value}, {by}"), "%counts", which, "i64")


def attempt(e: Emitter, step: StepProgram, t: str, h: str) -> str:
    """Take a trial step and return whether the mass matrix was singular on the way."""
    known = e.get("%counts", DriverState.SLOPE_KNOWN, "i64")
    arguments = f"ptr %rhs, ptr %p, double {t}, double {h}, ptr %work, i64 {known}"
    status = e.value(f"call i32 @step({arguments})")
    reused = known if step.starts_with_slope else "0"
    bump(e, DriverState.EVALUATIONS, e.value(f"sub nsw i64 {len(step.calls)}, {reused}"))
    if step.starts_with_slope:
        e.put("1", "%counts", DriverState.SLOPE_KNOWN, "i64")
    return e.value(f"icmp ne i32 {status}, 0")


def accept(e: Emitter, t: str) -> None:
    """Make the trial step the state, at time t."""
    e.put(t, "%reals", DriverState.T)
    e.do(f"call void @accept(ptr %counts, ptr %work, double {t}, ptr %times, ptr %rows)")
