"""The loop over Taylor steps in machine code. It calls a series by its address, so all series of a layout share it.

The procedures that find events are the same for all layouts, and are compiled once per process.
"""

from __future__ import annotations

import threading
from functools import cache, lru_cache

import llvmlite.binding as llvm

from lagrange.algorithm.taylor.events_on_step import inspect_step
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.resets import begin_sides, cross_surface, reset_state
from lagrange.machine.llvm.called import CompiledProcedure
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import function, joined
from lagrange.procedure.form import Procedure, transitive_callees

_BUILDING = threading.RLock()
"""Locked while a loop is built and linked, so that two threads do not do it twice."""


@lru_cache(maxsize=64)
def compiled_steps(layout: TaylorLayout) -> CompiledProcedure:
    """Return the compiled loop over Taylor steps for a layout."""
    with _BUILDING:
        loop = taylor_steps.form(layout=layout)
        if not layout.watched:
            return CompiledProcedure(loop, tiers=True)
        return CompiledProcedure(loop, tiers=True, elsewhere=event_procedures(), needs=link_events)


def event_procedures() -> tuple[Procedure, ...]:
    """Return the procedures that the loop calls to find events and crossings of switching surfaces."""
    return inspect_step.form(), begin_sides.form(), reset_state.form(), cross_surface.form()


def link_events(*, well: bool) -> None:
    """Make the event procedures available to modules loaded later: optimized if `well`, else compiled quickly."""
    with _BUILDING:
        if well or not _events.cache_info().currsize:
            _events(well)


@cache
def _events(well: bool) -> Module:
    """Compile the event procedures and register their addresses under their names. `well` asks for optimization."""
    reached = transitive_callees(event_procedures())
    texts = [function(each, hidden=each not in event_procedures(), merged=not each.apart) for each in reached]
    module = Module(joined(texts), merge=well, quickly=not well)
    for procedure in event_procedures():
        llvm.add_symbol(procedure.name, module.address(procedure.name))
    return module
