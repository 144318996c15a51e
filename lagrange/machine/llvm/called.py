"""A procedure in machine code as a Python function. One block of memory holds its arguments and results.

An ordinary call through ctypes takes 0.1 us for each argument, and cannot return several results.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.copies import Shared
from lagrange.machine.llvm.address import address
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.operations import KINDS, argument_type, result_type, separated
from lagrange.machine.llvm.procedures import function, joined
from lagrange.procedure.form import FLAG, REAL, WHOLE, Procedure

_CALL = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class CompiledProcedure(Shared):
    """A procedure in machine code, called with numbers, arrays, and addresses of functions or memory."""

    def __init__(self, procedure: Procedure) -> None:
        kinds = [parameter.type for parameter in procedure.parameters]
        self.places = {parameter.name: place for place, parameter in enumerate(procedure.parameters)}
        self._reals = frozenset(place for place, kind in enumerate(kinds) if kind is REAL)
        self._results = [(len(kinds) + i, kind) for i, kind in enumerate(procedure.results)]
        self.size = len(kinds) + len(procedure.results)
        self.module = Module(called_ir(procedure), merge=True)
        self.run = _CALL(self.module.address("run"))

    def __call__(self, *args: Any) -> Any:
        """Run the procedure; return None, a value or a tuple of values, as the procedure printed in Python does.

        Arguments are in the order of the parameters. Arrays must be contiguous and of the parameter's type.
        """
        words = self.words()
        self.give(words, dict(zip(self.places, args, strict=True)))
        found = self.run_on(words)
        return found[0] if len(found) == 1 else found or None

    def words(self) -> NDArray[np.int64]:
        """Return a block of memory for the arguments and results of a call, 8 bytes each."""
        return np.zeros(self.size, dtype=np.int64)

    def give(self, words: NDArray[np.int64], arguments: Mapping[str, Any]) -> None:
        """Write arguments, given by name, into `words`. Arrays are written as addresses and must stay referenced."""
        numbers = words.view(np.float64)
        for name, value in arguments.items():
            place = self.places[name]
            if place in self._reals:
                numbers[place] = value
            else:
                words[place] = address(value) if isinstance(value, np.ndarray) else value

    def run_on(self, words: NDArray[np.int64]) -> tuple[Any, ...]:
        """Run the procedure on the arguments in `words`, and return its results."""
        self.run(address(words))
        return self.results(words)

    def results(self, words: Any) -> tuple[Any, ...]:
        """Return the results, which follow the arguments in `words` after a run."""
        reals = words.view(np.float64)
        found: Sequence[Any] = [(reals if kind is REAL else words)[place].item() for place, kind in self._results]
        return tuple(bool(one) if kind is FLAG else one for one, (_, kind) in zip(found, self._results, strict=True))


@lru_cache(maxsize=64)
def compiled(procedure: Procedure) -> CompiledProcedure:
    """Return a procedure compiled to machine code, from a cache if possible."""
    return CompiledProcedure(procedure)


def called_ir(procedure: Procedure) -> str:
    """Return the IR of a procedure called as run(ptr words). Callees are inlined unless they are marked `apart`."""
    functions = [function(one, hidden=True, merged=not one.apart) for one in procedure.callees]
    functions.append(function(procedure, hidden=True))
    return joined([*functions, _run(procedure)])


def _run(procedure: Procedure) -> str:
    e = Emitter()
    given = [_argument(e, place, parameter.type) for place, parameter in enumerate(procedure.parameters)]
    kind = result_type(procedure.results)
    call = f"call {kind} @{procedure.name}({', '.join(given)})"
    if procedure.results:
        _keep(e, procedure, e.value(call))
    else:
        e.do(call)
    e.do("ret void")
    return e.function("define void @run(ptr %words) #0")


def _argument(e: Emitter, place: int, kind: Any) -> str:
    """Return an argument, read from its 8-byte word in memory. A flag is stored as an integer."""
    if kind is FLAG:
        word = e.get("%words", place, KINDS[WHOLE])
        return f"i1 {e.value(f'icmp ne i64 {word}, 0')}"
    return f"{argument_type(kind)} {e.get('%words', place, argument_type(kind))}"


def _keep(e: Emitter, procedure: Procedure, value: str) -> None:
    """Store the results in the words after the arguments."""
    results = separated(e, [argument_type(one) for one in procedure.results], value)
    for i, (one, found) in enumerate(zip(procedure.results, results, strict=True)):
        word = e.value(f"zext i1 {found} to i64") if one is FLAG else found
        e.put(word, "%words", len(procedure.parameters) + i, KINDS[WHOLE] if one is FLAG else argument_type(one))
