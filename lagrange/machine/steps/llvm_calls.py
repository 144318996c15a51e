"""Calls of the law from the code of a step, the counts that they leave, and the ways out."""

from __future__ import annotations

from lagrange.machine.kernel import llvm_calling
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import SURVEYS, DriverState, Outcome
from lagrange.machine.steps.llvm_layout import (
    keep_entries,
)
from lagrange.procedure.step.memory import Layout

LAW = "ptr %rhs, ptr %p, ptr %jacobian, ptr %jp"
"""The law that a step calls and its derivative, each with its prepared parameters."""

RECORDS = "ptr noalias %reals, ptr noalias %counts, ptr noalias %work"
"""The state of a run, and the memory of its steps."""


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


def bump(e: Emitter, which: int, by: int | str) -> None:
    """Add to one of the counts."""
    value = e.get("%counts", which, "i64")
    e.put(e.value(f"add nsw i64 {value}, {by}"), "%counts", which, "i64")


def leave_if(e: Emitter, condition: str, outcome: Outcome) -> None:
    """Return an outcome if a condition holds."""
    name = e.fresh("leave")
    e.do(f"br i1 {condition}, label %{name}.out, label %{name}.on")
    e.label(f"{name}.out")
    e.do(f"ret i32 {int(outcome)}")
    e.label(f"{name}.on")


def leave_unscaled(e: Emitter, asked: str) -> None:
    """Come back on a condition for a look at how large the entries are, where floors follow them; see `Outcome`."""
    follows = e.real("fcmp ogt", e.get("%reals", DriverState.SHARE), literal(0.0))
    some = e.value(f"icmp slt i64 {e.get('%counts', DriverState.SURVEYED, 'i64')}, {SURVEYS}")
    leave_if(e, e.value(f"and i1 {asked}, {e.value(f'and i1 {follows}, {some}')}"), Outcome.UNSCALED)
