"""The loop over Taylor steps in machine code, which takes a series by its address: one for all series of a layout."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import declarations
from lagrange.machine.llvm.procedures import ATTRIBUTES, METADATA, argument_type, function, result_type
from lagrange.machine.llvm.tiers import TieredModule
from lagrange.procedure.form import Procedure
from lagrange.procedure.taylor.loop import taylor_steps
from lagrange.procedure.taylor.memory import TaylorLayout

_RUN = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)


class CompiledSteps:
    """The loop for a layout. Its arguments stand in memory, for a call through ctypes takes 0.1 us for each."""

    def __init__(self, layout: TaylorLayout) -> None:
        procedure = taylor_steps(layout)
        self.places = {parameter.name: place for place, parameter in enumerate(procedure.parameters)}
        self.module = TieredModule(steps_ir(procedure), "run", merge=True)

    @property
    def run(self) -> Any:
        """The loop, as a function of the address of its arguments."""
        return _RUN(self.module.address)


@lru_cache(maxsize=64)
def compiled_steps(layout: TaylorLayout) -> CompiledSteps:
    """Return the loop for a layout."""
    return CompiledSteps(layout)


def steps_ir(procedure: Procedure) -> str:
    """Return the IR of a loop: what it calls is merged into it, but for what stands apart."""
    functions = [function(one, hidden=True, merged=True) for one in procedure.callees]
    functions.append(function(procedure, hidden=True))
    return "\n".join([declarations(), *functions, _run(procedure), METADATA, ATTRIBUTES])


def _run(procedure: Procedure) -> str:
    """Return the IR of the loop with its arguments in memory: i64 run(ptr arguments)."""
    e = Emitter()
    kinds = [argument_type(parameter.type) for parameter in procedure.parameters]
    arguments = [f"{kind} {e.get('%arguments', place, kind)}" for place, kind in enumerate(kinds)]
    kind = result_type(procedure.results)
    result = e.value(f"call {kind} @{procedure.name}({', '.join(arguments)})")
    e.do(f"ret {kind} {result}")
    return e.function(f"define {kind} @run(ptr readonly %arguments) #0")
