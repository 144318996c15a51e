"""A procedure in machine code as a Python function. One array of 8-byte words holds its arguments and results.

An ordinary call through ctypes takes 0.1 us for each argument, and cannot return several results.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.machine.copies import Shared
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import Module, TieredModule
from lagrange.machine.llvm.operations import argument_type, result_type, separated
from lagrange.machine.llvm.procedures import declaration, function, joined
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure, transitive_callees

_CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


@lru_cache(maxsize=256)
def _function_at(code_address: int) -> Any:
    """Return the function at a code address as a ctypes function, from a cache.

    To make such an object takes about as long as a call.
    """
    return _CALL(code_address)


STEPS = ("budget", "times", "rows")
"""Names of the last parameters of loops over steps; see `CompiledProcedure.steps`."""


class CompiledProcedure(Shared):
    """A procedure in machine code, called with numbers, arrays, records, and addresses of functions.

    With `tiers` it is compiled quickly at first, and again with optimization after many steps. With `optimize` LLVM
    runs more of its optimization passes. The callees in `elsewhere` are compiled in other modules. `needs` is called
    before the code is compiled, to compile these modules.
    """

    def __init__(
        self,
        procedure: Procedure,
        *,
        tiers: bool = False,
        optimize: bool = False,
        elsewhere: Sequence[Procedure] = (),
        needs: Callable[..., None] | None = None,
    ) -> None:
        kinds = [parameter.type for parameter in procedure.parameters]
        self.places = {parameter.name: index for index, parameter in enumerate(procedure.parameters)}
        self.reals = frozenset(parameter.name for parameter in procedure.parameters if parameter.type is REAL)
        self.results = [(len(kinds) + i, kind) for i, kind in enumerate(procedure.results)]
        self.only_whole = len(kinds) if procedure.results == (WHOLE,) else None
        """Word of the result if it is one whole number, such as the outcome of a loop over steps."""
        text = called_ir(procedure, elsewhere)
        passes = {"optimize": optimize, "merge": not optimize}
        self.module = TieredModule(text, "run", needs=needs, **passes) if tiers else Module(text, **passes)

    @property
    def run(self) -> Any:
        """The compiled function, called with the address of the array of 8-byte words for arguments and results.

        The function changes when code is compiled again.
        """
        return _function_at(self._address("run"))

    @property
    def steps(self) -> int:
        """Address of the compiled function `steps`, by which another compiled loop calls this loop over steps."""
        return self._address("steps")

    def _address(self, name: str) -> int:
        """Return the address of the function `name` in the best code that is compiled so far."""
        module = self.module
        return module.address_of(name) if isinstance(module, TieredModule) else module.address(name)

    def bound(self) -> CompiledCall:
        """Return an object that keeps arguments of the procedure between calls, and runs it when called."""
        return CompiledCall(self)

    def __call__(self, *args: Any) -> Any:
        """Run the procedure. Arrays must be contiguous and of the parameter's type."""
        call = self.bound()
        call.give(**dict(zip(self.places, args, strict=True)))
        return call()


class CompiledCall:
    """Arguments of a compiled procedure, kept between calls. Calling the object runs the procedure with them."""

    def __init__(self, code: CompiledProcedure) -> None:
        self.code, self._run = code, code.run
        self.words = np.zeros(len(code.places) + len(code.results), dtype=np.int64)
        self._wholes: Any = self.words.data
        self._reals: Any = self.words.view(np.float64).data
        self._address = address(self.words)
        self._kept: dict[str, Any] = {}
        self._quick = isinstance(code.module, TieredModule) and not code.module.is_final

    def give(self, **arguments: Any) -> None:
        """Set arguments of the procedure by name, as `BoundCall` says."""
        indices, reals, references, words = self.code.places, self.code.reals, self._kept, self._wholes
        for name, value in arguments.items():
            if name in reals:
                self._reals[indices[name]] = value
            elif name in indices:
                references[name], words[indices[name]] = value, _word(value)

    def __call__(self) -> Any:
        """Run the procedure with the present arguments; return None, a value or a tuple of values."""
        self._run(self._address)
        if self.code.only_whole is not None:
            return self._wholes[self.code.only_whole]
        results = [self._result(index, kind) for index, kind in self.code.results]
        return results[0] if len(results) == 1 else tuple(results) or None

    def _result(self, index: int, kind: Any) -> Any:
        """Return the result in the word `index` as a Python float, int or bool. `kind` is the type of the result."""
        if kind is REAL:
            return self._reals[index]
        return bool(self._wholes[index]) if kind is FLAG else self._wholes[index]

    @property
    def is_final(self) -> bool:
        """True if the code will not be compiled again."""
        return not self._quick

    def count(self, steps: int) -> bool:
        """Count `steps` more steps. Return True if optimized code replaces the quickly compiled code from now on."""
        tiers = self.code.module
        if not self._quick or not isinstance(tiers, TieredModule):
            return False
        tiers.count(steps)
        if tiers.is_final:
            self._run, self._quick = self.code.run, False
        return tiers.is_final


def _word(value: Any) -> int:
    """Return the 8-byte word that passes an argument: the address of an array or record, an integer, or 0."""
    if isinstance(value, np.ndarray):
        return address(value)
    if isinstance(value, ctypes.Structure):
        return ctypes.addressof(value)
    return 0 if value is None else int(value)


@lru_cache(maxsize=64)
def compiled(procedure: Procedure) -> CompiledProcedure:
    """Return a procedure compiled to machine code, from a cache if possible."""
    return CompiledProcedure(procedure)


def called_ir(procedure: Procedure, elsewhere: Sequence[Procedure] = ()) -> str:
    """Return the IR of a procedure with the function `run`, whose only argument is an array of 8-byte words.

    The words hold arguments and results. Callees in `elsewhere` are declared but not defined. Other callees are
    inlined unless they are marked `apart`. A loop over steps also has the function `steps`.
    """
    callees = transitive_callees([procedure], elsewhere)
    functions = [function(callee, hidden=True, merged=not (callee is procedure or callee.apart)) for callee in callees]
    functions.append(_run(procedure))
    if [parameter.name for parameter in procedure.parameters][-len(STEPS) :] == list(STEPS):
        functions.append(_steps(procedure))
    return joined(functions, [declaration(callee) for callee in elsewhere])


def _steps(procedure: Procedure) -> str:
    """Return the IR of the function `steps`, of the type `TAKE_STEPS`, by which another compiled loop takes steps.

    Its first argument is the address of the words that hold the arguments of `run`. Its next three arguments are
    arrays whose addresses are also among the words. They tell LLVM, in the caller, that the steps change these
    arrays.
    """
    e = Emitter()
    indices = {parameter.name: index for index, parameter in enumerate(procedure.parameters)}
    for name in STEPS:
        e.put(f"%{name}", "%words", indices[name], "i64" if name == "budget" else "ptr")
    e.do("call void @run(ptr %words)")
    e.do(f"ret i64 {e.get('%words', len(indices), 'i64')}")
    return e.function(
        "define i64 @steps(ptr %words, ptr %reals, ptr %counts, ptr %work, i64 %budget, ptr %times, ptr %rows)"
    )


def _run(procedure: Procedure) -> str:
    """Return the IR of the function `run`, which reads a procedure's arguments from 8-byte words.

    It writes the results into the words after them. A flag is stored as an integer.
    """
    e = Emitter()
    arguments = []
    for index, parameter in enumerate(procedure.parameters):
        kind = argument_type(WHOLE if parameter.type is FLAG else parameter.type)
        word = e.get("%words", index, kind)
        arguments.append(f"i1 {e.value(f'icmp ne i64 {word}, 0')}" if parameter.type is FLAG else f"{kind} {word}")
    call = f"call {result_type(procedure.results)} @{procedure.name}({', '.join(arguments)})"
    if procedure.results:
        results = separated(e, [argument_type(kind) for kind in procedure.results], e.value(call))
        for i, (result_kind, result) in enumerate(zip(procedure.results, results, strict=True)):
            is_flag = result_kind is FLAG
            word = e.value(f"zext i1 {result} to i64") if is_flag else result
            e.put(word, "%words", len(arguments) + i, argument_type(WHOLE if is_flag else result_kind))
    else:
        e.do(call)
    e.do("ret void")
    return e.function("define void @run(ptr %words) #0")
