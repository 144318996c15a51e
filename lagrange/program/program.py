"""Straight-line programs: in which order it is computed.

A program maps time t, the state y = [q, v] and the parameters to an array of numbers. It is a list of
instructions in static single assignment form; the first `hoisted` of them need parameters alone and run once
per set of parameters. It can be printed, checked, and interpreted by any machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from lagrange.errors import LagrangeError

ARITY: dict[str, int | None] = {
    "time": 0,
    "state": 0,
    "parameter": 0,
    "constant": 0,
    "neg": 1,
    "add": 2,
    "sub": 2,
    "mul": 2,
    "div": 2,
    "fma": 3,
    "sqrt": 1,
    "power": 2,
    "sin": 1,
    "cos": 1,
    "tan": 1,
    "asin": 1,
    "acos": 1,
    "atan": 1,
    "atan2": 2,
    "exp": 1,
    "log": 1,
    "sinh": 1,
    "cosh": 1,
    "tanh": 1,
    "abs": 1,
    "sign": 1,
    "min": 2,
    "max": 2,
    "less": 2,
    "less_equal": 2,
    "equal": 2,
    "and": 2,
    "or": 2,
    "not": 1,
    "select": 3,
    "factor": None,
    "solve": None,
    "component": 1,
}
"""Every operation and its number of operands (None: any). `fma` is a*b + c rounded once; `select` is c ? a : b.

`factor` takes the lower triangle of a symmetric matrix by rows and gives its factors; `solve` takes factors and
a right-hand side and gives a vector; `component` picks one entry of it. A matrix that cannot be factored marks
the whole evaluation as singular.
"""

SCALAR_DATA = frozenset(("state", "parameter", "constant", "component", "factor", "solve"))


class Instruction(NamedTuple):
    """One operation on earlier results; `data` is an index, a value, or the order n of a matrix."""

    op: str
    args: tuple[int, ...] = ()
    data: float = 0


@dataclass(frozen=True)
class Program:
    """A checked straight-line program; `shape` is the shape of its result, `outputs` its entries in C order."""

    name: str
    states: int
    parameters: int
    instructions: tuple[Instruction, ...]
    hoisted: int
    outputs: tuple[int, ...]
    shape: tuple[int, ...]

    def __post_init__(self) -> None:
        verify(self)

    def __str__(self) -> str:
        lines = [f"{self.name}: t, y[{self.states}], p[{self.parameters}] -> {list(self.shape)}"]
        for i, instruction in enumerate(self.instructions):
            if i in (0, self.hoisted):
                lines.append("once per parameters:" if i < self.hoisted else "every time:")
            data = f" {instruction.data:.17g}" if instruction.op in SCALAR_DATA else ""
            lines.append(f"  %{i} = {instruction.op}{data}" + "".join(f" %{arg}" for arg in instruction.args))
        return "\n".join([*lines, "return " + " ".join(f"%{output}" for output in self.outputs)])

    @property
    def saved(self) -> tuple[int, ...]:
        """The hoisted results that the rest of the program reads, in order, but for constants and parameters.

        Who solves with a hoisted factor may need the matrix as well, to factor it again with pivoting.
        """
        read = {arg for instruction in self.instructions[self.hoisted :] for arg in instruction.args}
        read.update(self.outputs)
        for i in range(self.hoisted):
            if i in read and self.instructions[i].op == "factor":
                read.update(self.instructions[i].args)
        return tuple(
            i for i in range(self.hoisted) if i in read and self.instructions[i].op not in ("constant", "parameter")
        )


def verify(program: Program) -> None:
    """Raise LagrangeError unless every operand is an earlier result and every operation is known and complete."""
    for problem in _problems(program):
        raise LagrangeError(f"program {program.name} is malformed: {problem}")


def _problems(program: Program) -> Iterator[str]:
    for i, (op, args, data) in enumerate(program.instructions):
        if op not in ARITY:
            yield f"%{i} has the unknown operation {op}"
        elif ARITY[op] not in (None, len(args)):
            yield f"%{i} = {op} has {len(args)} operands"
        if any(not 0 <= arg < i for arg in args):
            yield f"%{i} = {op} reads a later result"
        if i < program.hoisted and op in ("time", "state"):
            yield f"%{i} = {op} is hoisted but depends on the state"
        if op == "factor" and len(args) != data * (data + 1) / 2:
            yield f"%{i} factors a matrix of order {data} from {len(args)} entries"
        if op == "solve" and len(args) != data + 1:
            yield f"%{i} solves a system of order {data} with {len(args) - 1} right-hand sides"
    if len(program.outputs) != math.prod(program.shape):
        yield f"{len(program.outputs)} outputs do not fill the shape {program.shape}"
    if any(not 0 <= output < len(program.instructions) for output in program.outputs):
        yield "an output is no result"
