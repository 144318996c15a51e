"""Copies of compiled objects: a copy is the object itself. A pickle contains the program, compiled on first use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

from lagrange.machine.backend import FloatArray, Kernel
from lagrange.program.program import Program


class Shared:
    """Base class of immutable objects whose copy is the object itself, because machine code cannot be copied."""

    def __copy__(self) -> Any:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return self


class UnpickledKernel(Shared):
    """A kernel from a pickle: its program, compiled on first use."""

    def __init__(self, load: Callable[[Program], Kernel], program: Program) -> None:
        self._load, self.program = load, program

    def __reduce__(self) -> tuple[Any, ...]:
        return UnpickledKernel, (self._load, self.program)

    @cached_property
    def _kernel(self) -> Kernel:
        return self._load(self.program)

    def __call__(self, t: float | FloatArray, y: FloatArray, parameters: FloatArray) -> FloatArray:
        """Return the result of the program for a state (2n,) or many (2n, batch)."""
        return self._kernel(t, y, parameters)

    def columns(self, t: float | FloatArray, inputs: Sequence[FloatArray], parameters: FloatArray) -> FloatArray:
        """Return the result of the program for many states. `inputs` has an array (size, batch) for each input."""
        return self._kernel.columns(t, inputs, parameters)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._kernel, name)  # attributes of kernels that are not in the protocol, such as `address`
