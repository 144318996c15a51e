"""The loop over Taylor steps in machine code. It calls a series by its address, so all series of a layout share it.

The procedures for events are the same for all layouts, and are compiled once per process.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import llvmlite.binding as llvm

from lagrange.algorithm.taylor.events_on_step import inspect_step
from lagrange.algorithm.taylor.loop import taylor_steps
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.resets import begin_sides, cross_surface, reset_state
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.operations import argument_type, declarations, result_type
from lagrange.machine.llvm.procedures import ATTRIBUTES, METADATA, declaration, function
from lagrange.machine.llvm.tiers import TieredModule
from lagrange.procedure.form import Procedure, calls

_RUN = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)
_BUILDING = threading.RLock()
"""Locked while a loop is built and linked, so that two threads do not do it twice."""


class CompiledSteps:
    """The loop for a layout. Its arguments are in memory, since each argument of a ctypes call takes 0.1 us."""

    def __init__(self, layout: TaylorLayout) -> None:
        with _BUILDING:
            procedure, watches = taylor_steps.form(layout=layout), layout.watched > 0
            self.places = {parameter.name: place for place, parameter in enumerate(procedure.parameters)}
            text = steps_ir(procedure, event_procedures() if watches else ())
            self.module = TieredModule(text, "run", merge=True, needs=link_events if watches else None)

    @property
    def run(self) -> Any:
        """The loop as a function of one argument, the address of the array of its arguments."""
        return _RUN(self.module.address)


@lru_cache(maxsize=64)
def compiled_steps(layout: TaylorLayout) -> CompiledSteps:
    """Return the loop for a layout."""
    return CompiledSteps(layout)


def event_procedures() -> tuple[Procedure, ...]:
    """Return the procedures that a loop calls for events and switching surfaces."""
    return inspect_step.form(), begin_sides.form(), reset_state.form(), cross_surface.form()


def link_events(*, well: bool) -> None:
    """Make the procedures of events available to modules loaded later, optimized (`well`) or compiled quickly."""
    with _BUILDING:
        if well or not _events.cache_info().currsize:
            _events(well)


@cache
def _events(well: bool) -> Module:
    """Compile the procedures of events and register their addresses under their names."""
    reached = _reached(event_procedures())
    texts = [function(one, hidden=one not in event_procedures(), merged=not one.apart) for one in reached]
    made = Module("\n".join([declarations(), *texts, METADATA, ATTRIBUTES]), merge=well, quickly=not well)
    for one in event_procedures():
        llvm.add_symbol(one.name, made.address(one.name))
    return made


def steps_ir(procedure: Procedure, elsewhere: Sequence[Procedure] = ()) -> str:
    """Return the IR of a loop and its callees, without the callees that are `elsewhere`, in another module."""
    reached = _reached([procedure], elsewhere)
    functions = [function(one, hidden=True, merged=one is not procedure) for one in reached]
    return "\n".join([declarations(), *map(declaration, elsewhere), *functions, _run(procedure), METADATA, ATTRIBUTES])


def _reached(procedures: Sequence[Procedure], elsewhere: Sequence[Procedure] = ()) -> tuple[Procedure, ...]:
    """Return procedures and their callees, callees first.

    Procedures that are called only from `elsewhere` are left out.
    """
    found: dict[Procedure, None] = {}
    for procedure in procedures:
        called = [call.callee for call in calls(procedure.body) if isinstance(call.callee, Procedure)]
        found |= dict.fromkeys(_reached([one for one in called if one not in elsewhere], elsewhere))
        found[procedure] = None
    return tuple(found)


def _run(procedure: Procedure) -> str:
    """Return the IR of a function that reads the arguments of the loop from memory: i64 run(ptr arguments)."""
    e = Emitter()
    kinds = [argument_type(parameter.type) for parameter in procedure.parameters]
    arguments = [f"{kind} {e.get('%arguments', place, kind)}" for place, kind in enumerate(kinds)]
    kind = result_type(procedure.results)
    result = e.value(f"call {kind} @{procedure.name}({', '.join(arguments)})")
    e.do(f"ret {kind} {result}")
    return e.function(f"define {kind} @run(ptr readonly %arguments) #0")
