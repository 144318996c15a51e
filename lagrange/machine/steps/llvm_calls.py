"""Calls of the law from the code of a step, the counts that they leave, and the ways out."""

from __future__ import annotations

from lagrange.machine.kernel import llvm_calling
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import SURVEYS, DriverState, Outcome
from lagrange.machine.steps.llvm_layout import (
    KIND,
    Scalars,
    blocks,
    combine,
    entries,
    in_work,
    keep_entries,
)
from lagrange.procedure.step.memory import Layout
from lagrange.program.actions import LAWS, Call

LAW = "ptr %rhs, ptr %p, ptr %jacobian, ptr %jp"
"""The law that a step calls and its derivative, each with its prepared parameters."""

RECORDS = "ptr noalias %reals, ptr noalias %counts, ptr noalias %work"
"""The state of a run, and the memory of its steps."""

GIVEN = "ptr %reals, ptr %counts, ptr %work"
"""The same, handed on to another function."""


def place_arguments(e: Emitter, layout: Layout, scalars: Scalars, call: Call) -> str:
    """Store the arguments of a call one behind the other and return their address."""
    for i, argument in enumerate(call.arguments):
        combine(e, layout, scalars, argument, layout.argument + i * layout.length)
    return e.address("%work", layout.argument)


def evaluate(e: Emitter, layout: Layout, scalars: Scalars, call: Call, status: str, *, always: bool = False) -> None:
    """Evaluate the law, keep its results as vectors, and note in the memory `status` if a matrix was singular.

    What is computed `always` stays in registers, too.
    """
    if layout.in_registers:
        _evaluate_in_registers(e, layout, scalars, call, status, always)
        return
    where, out = place_arguments(e, layout, scalars, call), e.address("%work", layout.result)
    failed = e.value(f"call i32 %rhs(double {scalars.names[call.time]}, ptr {where}, ptr %p, ptr {out})")
    e.store(e.value(f"or i32 {e.load(status, 'i32')}, {failed}"), status, "i32")
    law = LAWS[layout.step.law]
    first = layout.result + (layout.length if layout.step.law == "accelerations" else 0)
    for i in range(law.results):
        copy(e, layout, first + i * layout.length, layout.place(call.first + i))


def evaluate_in_place(e: Emitter, layout: Layout, t: str, source: int, target: int) -> None:
    """Evaluate the right-hand side between two offsets of the work array; whether it is singular does not matter."""
    if layout.in_registers:
        given = [e.get("%work", source + i) for i in range(layout.dimension)]
        half = layout.dimension // 2
        found, _ = llvm_calling.call(e, "%rhs", t, given, half)
        keep_entries(e, layout, [*given[half:], *found], target)
    else:
        where, out = e.address("%work", source), e.address("%work", target)
        e.value(f"call i32 %rhs(double {t}, ptr {where}, ptr %p, ptr {out})")


def _evaluate_in_registers(e: Emitter, layout: Layout, scalars: Scalars, call: Call, status: str, always: bool) -> None:
    given = [value for argument in call.arguments for value in entries(e, layout, scalars, argument)]
    given += [literal(0.0)] * (layout.dimension - len(given))
    law, half = LAWS[layout.step.law], layout.dimension // 2
    found, failed = llvm_calling.call(e, "%rhs", scalars.names[call.time], given, law.results * half)
    e.store(e.value(f"or i32 {e.load(status, 'i32')}, {failed}"), status, "i32")
    found = [*given[half:], *found] if law.states == 1 else found
    for i in range(law.results):
        values = found[i * layout.length : (i + 1) * layout.length]
        kept = keep_entries(e, layout, values, layout.place(call.first + i))
        if always:
            scalars.entries[call.first + i] = values
            scalars.fresh.update({(call.first + i, block): value for block, value in kept.items()})


def copy(e: Emitter, layout: Layout, source: int, target: int) -> None:
    """Copy a vector from one offset of the work array to another."""
    for offset in blocks(e, layout.width):
        e.store(e.load(in_work(e, source, offset), KIND), in_work(e, target, offset), KIND)


def bump(e: Emitter, which: int, by: int | str) -> None:
    """Add to one of the counts."""
    value = e.get("%counts", which, "i64")
    e.put(e.value(f"add nsw i64 {value}, {by}"), "%counts", which, "i64")


def count_calls(e: Emitter, calls: int | str) -> None:
    """Count evaluations of the law."""
    if calls:
        bump(e, DriverState.EVALUATIONS, calls)


def leave_if(e: Emitter, condition: str, outcome: Outcome) -> None:
    """Return an outcome if a condition holds."""
    name = e.fresh("leave")
    e.do(f"br i1 {condition}, label %{name}.out, label %{name}.on")
    e.label(f"{name}.out")
    e.do(f"ret i32 {int(outcome)}")
    e.label(f"{name}.on")


def leave_with(e: Emitter, status: str) -> None:
    """Return a status unless it is DONE."""
    name = e.fresh("leave")
    e.do(f"br i1 {e.value(f'icmp ne i32 {status}, {int(Outcome.DONE)}')}, label %{name}.out, label %{name}.on")
    e.label(f"{name}.out")
    e.do(f"ret i32 {status}")
    e.label(f"{name}.on")


def leave_unscaled(e: Emitter, asked: str) -> None:
    """Come back on a condition for a look at how large the entries are, where floors follow them; see `Outcome`."""
    follows = e.real("fcmp ogt", e.get("%reals", DriverState.SHARE), literal(0.0))
    some = e.value(f"icmp slt i64 {e.get('%counts', DriverState.SURVEYED, 'i64')}, {SURVEYS}")
    leave_if(e, e.value(f"and i1 {asked}, {e.value(f'and i1 {follows}, {some}')}"), Outcome.UNSCALED)
