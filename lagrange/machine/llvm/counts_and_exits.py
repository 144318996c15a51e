"""What the loops of all compiled drivers do alike: they add to the counts of a run, and leave with an outcome."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.step.constants import SURVEYS


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
