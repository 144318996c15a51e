"""The loops over steps in machine code: equal steps, and steps that follow the error.

The second does what `lagrange.machine.steps.interpreted_driver` does, which is the place to read it.
"""

from __future__ import annotations

from typing import Any

from lagrange.machine.llvm.counts_and_exits import bump, leave_if, leave_unscaled
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import EARLIEST, NEAR_END, SPACING, STUCK, DriverState, Outcome
from lagrange.machine.steps.control_constants import (
    AFTER_BROKEN,
    AFTER_DIVERGED,
    FAR,
    INTEGRAL,
    LEAST_NORM,
    LEAST_PREVIOUS,
    SHRUNK,
)
from lagrange.machine.steps.llvm_calls import LAW, RECORDS
from lagrange.machine.steps.llvm_error_norm import raise_floors, some_blank
from lagrange.machine.steps.llvm_layout import finite
from lagrange.machine.steps.llvm_step import accept, attempt, run_arguments, take_entries
from lagrange.procedure.step.memory import Layout
from lagrange.program.step import StepProgram


def equal_loop(layout: Layout) -> str:
    """Emit equal steps, which are a procedure."""
    e = Emitter()
    given = f"{run_arguments(e, layout)}, i64 %budget, ptr %times, ptr %rows"
    outcome = e.value(f"call i64 @equal_steps({given})")
    e.do(f"ret i32 {e.value(f'trunc i64 {outcome} to i32')}")
    return e.function(_SIGNATURE)


def adaptive_loop(step: StepProgram, layout: Layout) -> str:
    """Emit steps whose size follows the error."""
    e = Emitter()
    e.do(f"call void @begin({run_arguments(e, layout)})")
    take_entries(e, layout)
    end = e.get("%reals", DriverState.END)
    direction = _first_step(e, end)
    with e.loop(0, "%budget"):
        t, h = e.get("%reals", DriverState.T), e.get("%reals", DriverState.H)
        h = e.real("fmul", direction, e.smaller(e.fabs(h), e.get("%reals", DriverState.LONGEST)))
        leave_if(e, e.real("fcmp oeq", t, end), Outcome.DONE)
        least = e.real("fmul", e.larger(e.fabs(t), literal(EARLIEST)), literal(SPACING))
        left = e.real("fsub", end, t)
        final = e.real("fcmp oge", e.real("fmul", e.fabs(h), literal(NEAR_END)), e.fabs(left))
        small = e.real("fcmp ult", e.fabs(h), least)
        stuck = e.value(f"and i1 {small}, {e.value(f'xor i1 {final}, true')}")
        rejected = e.value(f"icmp ne i64 {e.get('%counts', DriverState.AFTER_REJECT, 'i64')}, 0")
        hopeless = e.value(f"or i1 {stuck}, {e.value(f'and i1 {small}, {rejected}')}")
        leave_if(e, hopeless, Outcome.STEP_TOO_SMALL)
        after = e.choose(final, end, e.real("fadd", t, h))
        # Far from time zero a step is as long as times allow; elsewhere it keeps its length, and a matrix made for it.
        far = e.real("fcmp olt", e.fabs(h), e.real("fmul", e.fabs(t), literal(FAR)))
        exact = e.value(f"or i1 {final}, {far}")
        length = e.choose(exact, e.real("fsub", after, t), h)
        _trial(e, step, layout, length, after, rejected)
    _come_back(e, end)
    return e.function(_SIGNATURE)


_SIGNATURE = f"define i32 @drive({LAW}, {RECORDS}, i64 %budget, ptr noalias %times, ptr noalias %rows)"


def _come_back(e: Emitter, end: str) -> None:
    """Return when the budget is used up."""
    reached = e.real("fcmp oeq", e.get("%reals", DriverState.T), end)
    e.do(f"ret i32 {e.value(f'select i1 {reached}, i32 {int(Outcome.DONE)}, i32 {int(Outcome.PAUSED)}')}")


def _first_step(e: Emitter, end: str) -> str:
    """Choose the size of the first step if none is given; return the direction of time, 1 or -1."""
    t = e.get("%reals", DriverState.T)
    distance = e.real("fsub", end, t)
    direction = e.choose(e.real("fcmp olt", distance, literal(0.0)), literal(-1.0), literal(1.0))
    with e.when(e.real("fcmp oeq", e.get("%reals", DriverState.H), literal(0.0))):
        arguments = f"ptr %rhs, ptr %p, double {t}, double {e.fabs(distance)}, double {direction}"
        size = e.value(f"call double @first_step({arguments}, ptr %reals, ptr %counts, ptr %work)")
        bump(e, DriverState.EVALUATIONS, 3)
        leave_if(e, e.real("fcmp olt", size, literal(0.0)), Outcome.UNSCALED)
        e.put(e.real("fmul", size, direction), "%reals", DriverState.H)
    return direction


def _trial(e: Emitter, step: StepProgram, layout: Layout, length: str, after: str, rejected: str) -> None:
    """Take a trial step; reject it where it fails or something in it is not a number, else judge it by its error."""
    status = attempt(e, layout, e.get("%reals", DriverState.T), length)
    done = e.value(f"icmp eq i32 {status}, {int(Outcome.DONE)}")
    good = finite(e, layout, [layout.new, *(layout.errors + i for i in range(len(step.errors)))])
    name = e.fresh("trial")
    e.do(f"br i1 {e.value(f'and i1 {good}, {done}')}, label %{name}.measure, label %{name}.broken")
    e.label(f"{name}.broken")
    failure = e.value(f"sitofp i32 {status} to double")
    cause = e.choose(done, literal(float(Outcome.NON_FINITE)), failure)
    unsolved = e.real("fcmp oeq", cause, literal(float(Outcome.DIVERGED)))
    part = e.choose(unsolved, literal(AFTER_DIVERGED), literal(AFTER_BROKEN))
    _reject(e, layout, cause, e.real("fmul", length, part), moved=False)
    e.jump(f"{name}.end")
    e.label(f"{name}.measure")
    _judge(e, step, layout, name, length, after, rejected)
    e.label(f"{name}.end")


def _judge(e: Emitter, step: StepProgram, layout: Layout, name: str, length: str, after: str, rejected: str) -> None:
    """Accept or reject a finite trial step by its error norm, and set the next step."""
    control: Any = step.control
    norm = e.value("call double @norm(ptr %reals, ptr %work)")
    shrink = e.power(e.larger(norm, literal(LEAST_NORM)), -(1 / control.exponent - INTEGRAL * control.memory))
    factor = e.real("fmul", shrink, literal(control.safety))
    accepted = e.real("fcmp ole", norm, literal(1.0))
    e.do(f"br i1 {accepted}, label %{name}.accept, label %{name}.reject")
    e.label(f"{name}.reject")
    bounded = e.smaller(e.larger(factor, literal(control.least)), literal(SHRUNK))
    _reject(e, layout, literal(float(Outcome.STEP_TOO_SMALL)), e.real("fmul", length, bounded), moved=True)
    e.jump(f"{name}.end")
    e.label(f"{name}.accept")
    if control.memory:
        factor = e.real("fmul", factor, e.power(e.get("%reals", DriverState.PREVIOUS), control.memory))
    e.put(e.larger(norm, literal(LEAST_PREVIOUS)), "%reals", DriverState.PREVIOUS)
    most = e.choose(rejected, literal(1.0), literal(control.most))
    factor = e.larger(e.smaller(factor, most), literal(control.least))
    if control.hold > 1:
        little = e.real("fcmp olt", factor, literal(control.hold))
        steady = e.value(f"and i1 {e.real('fcmp oge', factor, literal(1.0))}, {little}")
        factor = e.choose(steady, literal(1.0), factor)
    e.put(e.real("fmul", length, factor), "%reals", DriverState.H)
    e.put("0", "%counts", DriverState.AFTER_REJECT, "i64")
    raise_floors(e, layout)
    accept(e, layout, after)
    e.jump(f"{name}.end")


def _reject(e: Emitter, layout: Layout, cause: str, h: str, *, moved: bool) -> None:
    """Try again with a step of h; ask how large entries are if it is not the first try, or one has no size yet.

    Where the trial `moved` the state, an entry that it left at zero does not count.
    """
    e.put(cause, "%reals", DriverState.CAUSE)
    e.put(h, "%reals", DriverState.H)
    bump(e, DriverState.AFTER_REJECT, 1)
    bump(e, DriverState.REJECTED, 1)
    stuck = e.value(f"icmp eq i64 {e.get('%counts', DriverState.AFTER_REJECT, 'i64')}, {STUCK}")
    leave_unscaled(e, e.value(f"or i1 {stuck}, {some_blank(e, layout, moved=moved)}"))
