"""How compiled things are copied: a copy is the thing itself, and a pickle is the program, compiled when first used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

from lagrange.machine.backend import FloatArray, Kernel
from lagrange.program.program import Program


class Shared:
    """What never changes: a copy is the thing itself, for machine code cannot be copied and need not be."""

    def __copy__(self) -> Any:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return self


class UnpickledKernel(Shared):
    """A kernel that came out of a pickle: its program, compiled when it is first used."""

    def __init__(self, load: Callable[[Program], Kernel], program: Program) -> None:
        self._load, self.program = load, program

    def __reduce__(self) -> tuple[Any, ...]:
        return UnpickledKernel, (self._load, self.program)

    @cached_property
    def _kernel(self) -> Kernel:
        return self._load(self.program)

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Evaluate the program; see `Kernel`."""
        return self._kernel(t, y, parameters)

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Evaluate every column; see `Kernel`."""
        return self._kernel.columns(t, inputs, parameters)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._kernel, name)  # what a machine's kernels have beside the protocol, such as an address
