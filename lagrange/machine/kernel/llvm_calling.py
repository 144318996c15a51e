"""Kernels of small models that take a state in registers and return their results there.

    {double, ..., i32} NAME_registers(double t, double y0, ..., ptr parameters)

The last number is 1 if a matrix is singular, else 0. A program says what it returns so, `Program.returned`.

A step passes a state on from one call to the next; through memory each way costs some ten cycles, which for a small
model is as long as the call, and a block of coordinates and velocities waits there for the slowest of its entries,
where sines of the next coordinates could be on their way. A right-hand side returns the accelerations alone.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.machine.llvm.emitter import Emitter
from lagrange.program.program import Program

BLOCK = 4
"""Doubles that kernels and steps load and store at once."""

MOST_IN_REGISTERS = 8
"""Most numbers of a state, and most results, that are passed in registers."""

_CONVENTION = "swiftcc"
"""A calling convention that returns four doubles in registers, where C has two, and saves none that hold doubles."""


def fit(dimension: int) -> bool:
    """Whether states of that dimension are passed in registers: by kernels, and by the steps that call them."""
    return dimension <= MOST_IN_REGISTERS


def hold(program: Program) -> bool:
    """Whether a program is called by steps, and has few enough numbers."""
    return bool(program.returned) and fit(program.states)


def results(program: Program) -> tuple[int, ...]:
    """Return the outputs that are returned: not the velocities that a right-hand side was given."""
    return tuple(ref for block in program.results if block.name in program.returned for ref in program.part(block.name))


def signature(program: Program, state: Sequence[str]) -> str:
    """Return what a kernel's definition begins with, from its result to its arguments."""
    given = _doubles(["%t", *state])
    return f"{_CONVENTION} {_kind(len(results(program)))} @{program.name}_registers({given}, ptr noalias readonly %p)"


def call(e: Emitter, function: str, t: str, state: Sequence[str], count: int) -> tuple[list[str], str]:
    """Call a kernel with the parameters %p that returns so many results; return them and its status."""
    kind = _kind(count)
    made = e.value(f"call {_CONVENTION} {kind} {function}({_doubles([t, *state])}, ptr %p)")
    found = [e.value(f"extractvalue {kind} {made}, {i}") for i in range(count)]
    return found, e.value(f"extractvalue {kind} {made}, {count}")


def give_back(e: Emitter, found: Sequence[str], status: str) -> None:
    """Return results and status."""
    kind, made = _kind(len(found)), "poison"
    for i, result in enumerate(found):
        made = e.value(f"insertvalue {kind} {made}, double {result}, {i}")
    e.do(f"ret {kind} {e.value(f'insertvalue {kind} {made}, i32 {status}, {len(found)}')}")


def _kind(count: int) -> str:
    """Return the type of so many results with a status."""
    return "{" + "double, " * count + "i32}"


def _doubles(values: Sequence[str]) -> str:
    return ", ".join(f"double {value}" for value in values)
