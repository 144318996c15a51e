"""A trial step in machine code, and what accepting it does: how loops in LLVM text call their procedures."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.state import DriverState
from lagrange.machine.steps.llvm_calls import LAW
from lagrange.procedure.step.memory import Layout


def run_arguments(e: Emitter, layout: Layout) -> str:
    """Return the arguments of a procedure that takes steps of a run."""
    effort, newtons = e.address("%work", layout.effort), newton_arguments(e, layout)
    starters = ""
    if layout.step.starter is not None:
        starters = newton_arguments(e, layout.starting, layout.end)
    floors = e.address("%reals", DriverState.FLOORS)
    return f"{LAW}, ptr %reals, ptr %counts, ptr {floors}, ptr {effort}, {newtons}{starters}ptr %work"


def newton_arguments(e: Emitter, layout: Layout, start: int = 0) -> str:
    """Return what the solves know, as arguments, where the memory of a step begins at a place of the work array."""
    return "".join(f"ptr {e.address('%work', start + solve.flags)}, " for solve in layout.solves)


def _entries(layout: Layout) -> str:
    return ", ptr %entries" if layout.keeps_entries else ""


def attempt(e: Emitter, layout: Layout, t: str, h: str) -> str:
    """Take a trial step and return its outcome."""
    given = f"{run_arguments(e, layout)}, double {t}, double {h}{_entries(layout)}"
    return e.value(f"trunc i64 {e.value(f'call i64 @try_step({given})')} to i32")


def accept(e: Emitter, layout: Layout, t: str) -> None:
    """Make the trial step the state, at time t."""
    given = f"ptr %reals, ptr %counts, {newton_arguments(e, layout)}ptr %work{_entries(layout)}"
    e.do(f"call void @accept_step({given}, double {t}, ptr %times, ptr %rows)")


def take_entries(e: Emitter, layout: Layout) -> None:
    """Reserve the memory %entries of the single numbers of the state and the new state, and read the state."""
    e.entry.append(f"  %entries = alloca double, i64 {2 * layout.dimension if layout.keeps_entries else 0}, align 64")
    if layout.keeps_entries:
        for i in range(layout.step.states):
            for k in range(layout.length):
                e.put(e.get("%work", layout.place(i) + k), "%entries", i * layout.length + k)
