"""The loop over Taylor steps as Python calls it: with one argument, for a call through ctypes takes 0.1 us for each."""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter


class RUN:
    """The places of the loop's arguments in memory."""

    PREPARED, CONSTANTS, REALS, COUNTS, WORK, BUDGET, TIMES, STATES, ORDER = range(9)
    COUNT = 9


def run_function() -> str:
    """Return the IR of the loop with its arguments in memory: i32 run(ptr arguments)."""
    e = Emitter()
    kinds = ["i64" if place in (RUN.BUDGET, RUN.ORDER) else "ptr" for place in range(RUN.COUNT)]
    arguments = [f"{kind} {e.get('%arguments', place, kind)}" for place, kind in enumerate(kinds)]
    result = e.value(f"call i32 @drive({', '.join(arguments)})")
    e.do(f"ret i32 {result}")
    return e.function("define i32 @run(ptr readonly %arguments) #0")
