"""Calls of the law from the code of a step, the counts that they leave, and the ways out."""

from __future__ import annotations

from lagrange.machine.driver import DriverState, Outcome
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.vectors import (
    BLOCK,
    KIND,
    UNROLLED_BLOCKS,
    Layout,
    Scalars,
    blocks,
    combine,
    in_work,
    pieces,
)
from lagrange.program.actions import LAWS, Call

LAW = "ptr %rhs, ptr %p, ptr %jacobian, ptr %jp"
"""The law that a step calls and its derivative, each with its prepared parameters."""

RECORDS = "ptr noalias %reals, ptr noalias %counts, ptr noalias %work"
"""The state of a run, and the memory of its steps."""


def place_arguments(e: Emitter, layout: Layout, scalars: Scalars, call: Call) -> str:
    """Store the arguments of a call one behind the other and return their address."""
    for i, argument in enumerate(call.arguments):
        combine(e, layout, scalars, argument, layout.argument + i * layout.length)
    return e.address("%work", layout.argument)


def evaluate(e: Emitter, layout: Layout, scalars: Scalars, call: Call, status: str, *, always: bool = False) -> None:
    """Evaluate the law, keep its results as vectors, and note in the memory `status` if a matrix was singular.

    What is computed `always` stays in registers, too.
    """
    where, out = place_arguments(e, layout, scalars, call), e.address("%work", layout.result)
    failed = e.value(f"call i32 %rhs(double {scalars.names[call.time]}, ptr {where}, ptr %p, ptr {out})")
    e.store(e.value(f"or i32 {e.load(status, 'i32')}, {failed}"), status, "i32")
    law = LAWS[layout.step.law]
    first = layout.result + (layout.length if layout.step.law == "accelerations" else 0)
    for i in range(law.results):
        found = fetch(e, layout, first + i * layout.length, layout.place(call.first + i))
        if always:
            scalars.fresh.update({(call.first + i, block): value for block, value in found.items()})


def fetch(e: Emitter, layout: Layout, source: int, target: int) -> dict[int, str]:
    """Copy a result of the law, in the pieces in which a small kernel stores it; return the blocks of a small one.

    See `kernel.FEW`.
    """
    if layout.width > UNROLLED_BLOCKS * BLOCK:
        copy(e, layout, source, target)
        return {}
    found = dict.fromkeys(range(0, layout.width, BLOCK), "zeroinitializer")
    for begin, width in pieces(layout.length):
        part = e.load(in_work(e, source, begin), f"<{width} x double>")
        block, first = begin // BLOCK * BLOCK, begin % BLOCK
        if width == BLOCK:
            found[block] = part
            continue
        lanes = ", ".join(f"i32 {i if i < width else 'poison'}" for i in range(BLOCK))
        wide = e.value(f"shufflevector <{width} x double> {part}, <{width} x double> poison, <{BLOCK} x i32> <{lanes}>")
        chosen = ", ".join(f"i32 {BLOCK + i - first if first <= i < first + width else i}" for i in range(BLOCK))
        found[block] = e.value(f"shufflevector {KIND} {found[block]}, {KIND} {wide}, <{BLOCK} x i32> <{chosen}>")
    for block, value in found.items():
        e.store(value, in_work(e, target, block), KIND)
    return found


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
