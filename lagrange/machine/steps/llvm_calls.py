"""Calls of the law from the code of a step."""

from __future__ import annotations

from lagrange.machine.kernel import llvm_calling
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.steps.llvm_layout import keep_entries
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
