"""One trial step in machine code, and what accepting it does."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.steps.llvm_calls import GIVEN, LAW, RECORDS, bump, copy, count_calls, evaluate
from lagrange.machine.steps.llvm_layout import (
    KIND,
    Scalars,
    blocks,
    combine,
    entries,
    in_work,
    keep_entries,
)
from lagrange.procedure.step.memory import EFFORT, Layout
from lagrange.program.actions import Combination
from lagrange.program.step import StepProgram

_TRIED = f"{RECORDS}, ptr noalias %entries, i64 %slope_known"


def step_function(layout: Layout) -> str:
    """Emit step(law, t, h, reals, counts, work, entries, slope_known) -> an outcome, DONE where nothing went wrong."""
    step, e = layout.step, Emitter()
    arguments = [argument for call in step.calls for argument in call.arguments]
    scalars = Scalars(e, step, [*arguments, *step.results, *step.errors], [call.time for call in step.calls])
    scalars.state = "%entries" if layout.keeps_entries else ""
    status = e.reserve("i32")
    e.store("0", status, "i32")
    reused = "%slope_known" if step.starts_with_slope else "0"
    count_calls(e, e.value(f"sub nsw i64 {len(step.calls)}, {reused}"))
    for i, call in enumerate(step.calls):
        if i == 0 and step.starts_with_slope:
            with e.when(e.value("icmp eq i64 %slope_known, 0")):
                evaluate(e, layout, scalars, call, status)
        else:
            evaluate(e, layout, scalars, call, status, always=True)
    for i, result in enumerate(step.results):
        _keep_result(e, layout, scalars, i, result)
    for i, error in enumerate(step.errors):
        combine(e, layout, scalars, error, layout.place(layout.errors + i))
    singular = e.value(f"icmp ne i32 {e.load(status, 'i32')}, 0")
    e.do(f"ret i32 {e.value(f'select i1 {singular}, i32 {int(Outcome.SINGULAR)}, i32 {int(Outcome.DONE)}')}")
    return e.function(f"define internal i32 @step({LAW}, double %t, double %h, {_TRIED})")


def _keep_result(e: Emitter, layout: Layout, scalars: Scalars, i: int, result: Combination) -> None:
    """Store a new state."""
    if not layout.keeps_entries:
        combine(e, layout, scalars, result, layout.place(layout.new + i))
        return
    values = entries(e, layout, scalars, result)
    keep_entries(e, layout, values, layout.place(layout.new + i))
    for k, value in enumerate(values):
        e.put(value, "%entries", layout.dimension + i * layout.length + k)


def implicit_function(layout: Layout, prefix: str = "") -> str:
    """Emit step as above, which calls the procedure of a step that solves."""
    e = Emitter()
    effort = e.address("%work", layout.effort)
    e.put("0", effort, EFFORT.places["evaluations"], "i64")
    tolerances = f"double {e.get('%reals', DriverState.RTOL)}, ptr {e.address('%reals', DriverState.FLOORS)}"
    known = e.value("icmp ne i64 %slope_known, 0")
    given = f"{LAW}, double %t, double %h, {tolerances}, ptr {effort}, {_newtons(e, layout)}ptr %work, i1 {known}"
    outcome = e.value(f"call i64 @{prefix}take({given})")
    count_calls(e, e.get(effort, EFFORT.places["evaluations"], "i64"))
    e.put(e.get(effort, EFFORT.places["residual"]), "%reals", DriverState.RESIDUAL)
    e.do(f"ret i32 {e.value(f'trunc i64 {outcome} to i32')}")
    return e.function(f"define internal i32 @{prefix}step({LAW}, double %t, double %h, {_TRIED}) alwaysinline")


def _newtons(e: Emitter, layout: Layout) -> str:
    """Return what the solves know, as arguments."""
    return "".join(f"ptr {e.address('%work', solve.flags)}, " for solve in layout.solves)


def record_function(layout: Layout) -> str:
    """Emit accept(counts, work, entries, t, times, rows): the new state is the state, and a row if rows are kept."""
    e = Emitter()
    step = layout.step
    if step.starter is not None:
        e.put(e.get("%work", layout.flags + 1), "%work", layout.flags)
    if layout.by_procedures:
        e.do(f"call void @accept_step({_newtons(e, layout)}ptr %work)")
    else:
        for i in range(step.states):
            copy(e, layout, layout.place(layout.new + i), layout.place(i))
    if layout.keeps_entries:
        for i in range(layout.dimension):
            e.put(e.get("%entries", layout.dimension + i), "%entries", i)
    if step.ends_with_slope:
        copy(e, layout, layout.place(step.calls[-1].first), layout.place(step.calls[0].first))
    e.put("1" if step.ends_with_slope else "0", "%counts", DriverState.SLOPE_KNOWN, "i64")
    bump(e, DriverState.STEPS, 1)
    kept = e.value(f"icmp ne i64 {e.get('%counts', DriverState.RECORD, 'i64')}, 0")
    with e.when(kept):
        row = e.get("%counts", DriverState.ROWS, "i64")
        e.put("%t", "%times", row)
        start = e.address("%rows", e.value(f"mul nsw i64 {row}, {layout.dimension}"))
        for i in range(step.states):
            base = e.address(start, i * layout.length)
            for offset in blocks(e, layout.width):
                value = e.load(in_work(e, layout.place(i), offset), KIND)
                e.store(value, e.address(base, offset), KIND)
        bump(e, DriverState.ROWS, 1)
    e.do("ret void")
    return e.function(
        "define internal void @accept(ptr noalias %counts, ptr noalias %work, ptr noalias %entries, double %t, "
        "ptr noalias %times, ptr noalias %rows) alwaysinline"
    )


def attempt(e: Emitter, step: StepProgram, t: str, h: str) -> str:
    """Take a trial step and return its outcome."""
    known = e.get("%counts", DriverState.SLOPE_KNOWN, "i64")
    name = "step" if step.starter is None else "either"
    status = e.value(f"call i32 @{name}({LAW}, double {t}, double {h}, {GIVEN}, ptr %entries, i64 {known})")
    if step.starts_with_slope:
        e.put("1", "%counts", DriverState.SLOPE_KNOWN, "i64")
    return status


def either_function(layout: Layout) -> str:
    """Emit either, called as step is: a step from two states, or one of the starter."""
    e = Emitter()
    starter = layout.starting
    equal = e.real("fcmp oeq", "%h", e.get("%reals", DriverState.STEP))
    e.put(e.value(f"uitofp i1 {equal} to double"), "%work", layout.flags + 1)
    known = e.real("fcmp oeq", e.get("%work", layout.flags), literal(1.0))
    e.do(f"br i1 {e.value(f'and i1 {equal}, {known}')}, label %both, label %one")
    arguments = f"{LAW}, double %t, double %h, ptr %reals, ptr %counts"
    e.label("both")
    e.do(f"ret i32 {e.value(f'call i32 @step({arguments}, ptr %work, ptr null, i64 0)')}")
    e.label("one")
    for i in range(layout.step.states):
        copy(e, layout, layout.place(i), layout.end + starter.place(i))
    status = e.value(f"call i32 @starter_step({arguments}, ptr {e.address('%work', layout.end)}, ptr null, i64 0)")
    for i in range(layout.step.states):
        copy(e, layout, layout.end + starter.place(starter.new + i), layout.place(layout.new + i))
    e.do(f"ret i32 {status}")
    return e.function(f"define internal i32 @either({LAW}, double %t, double %h, {_TRIED})")


def accept(e: Emitter, t: str) -> None:
    """Make the trial step the state, at time t."""
    e.put(t, "%reals", DriverState.T)
    e.do(f"call void @accept(ptr %counts, ptr %work, ptr %entries, double {t}, ptr %times, ptr %rows)")


def take_entries(e: Emitter, layout: Layout) -> None:
    """Reserve the memory %entries of the single numbers of the state and the new state, and read the state."""
    e.entry.append(f"  %entries = alloca double, i64 {2 * layout.dimension if layout.keeps_entries else 0}, align 64")
    if layout.keeps_entries:
        for i in range(layout.step.states):
            for k in range(layout.length):
                e.put(e.get("%work", layout.place(i) + k), "%entries", i * layout.length + k)
