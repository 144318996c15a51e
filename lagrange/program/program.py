"""Straight-line programs: the operations of a computation as a list, in order, without unneeded ones.

A program maps time t, named blocks of inputs such as q and v, and the parameters to named blocks of results. Its
instructions are in static single assignment form. The first `hoisted` instructions depend only on parameters and run
once for each set of parameters. A program can be printed, checked, and interpreted by any machine.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from lagrange.errors import LagrangeError
from lagrange.program.elimination import Elimination, elimination
from lagrange.statement.vocabulary.functions import ELEMENTARY

GIVEN = ("time", "state", "parameter", "constant")
"""Operations that read an input or a constant and compute nothing."""

ARITY: dict[str, int | None] = {
    **dict.fromkeys(GIVEN, 0),
    **dict.fromkeys(("neg", "sqrt", *ELEMENTARY, "abs", "sign", "not", "component"), 1),
    **dict.fromkeys(("add", "sub", "mul", "div", "power", "atan2", "min", "max"), 2),
    **dict.fromkeys(("less", "less_equal", "equal", "and", "or"), 2),
    **dict.fromkeys(("fma", "select"), 3),
    **dict.fromkeys(("factor", "solve")),
}
"""Every operation and its number of operands (None: any).

`fma` is a*b + c rounded once; `select` is c ? a : b. `factor` takes the lower triangle of a symmetric matrix by rows
and gives its factors. `solve` takes factors and a right-hand side and gives a vector; `component` is one entry of this
vector. If a matrix cannot be factored, the whole evaluation is marked as singular.
"""

SYSTEMS = ("factor", "solve")
"""Operations of linear systems with a matrix of a given order."""


class Instruction(NamedTuple):
    """One operation `op` on earlier results, whose indices are `args`.

    `place` is the index of an input, a parameter or a component; `value` is a constant; `order` is the size of a
    matrix. `negative` are the indices of the negative pivots of that matrix; its other pivots are positive.
    """

    op: str
    args: tuple[int, ...] = ()
    place: int = 0
    value: float = 0.0
    order: int = 0
    negative: tuple[int, ...] = ()


class ProgramBlock(NamedTuple):
    """The name and the size of a block of inputs or results, such as the coordinates or the momenta."""

    name: str
    size: int


@dataclass(frozen=True)
class Program:
    """A straight-line program.

    The first `hoisted` instructions depend only on parameters. `shape` is the shape of its result, and `outputs` are
    the instructions that compute its entries, in C order. `inputs` are the blocks of numbers that "state"
    instructions read, in order. `results` divides the outputs into blocks. `returned` names the results that a call
    from a step returns in registers; the caller knows the other results already. `solved` is true if results are
    solutions of a system with the mass matrix: with a zero inertia they are infinite or NaN.
    """

    name: str
    inputs: tuple[ProgramBlock, ...]
    parameters: int
    instructions: tuple[Instruction, ...]
    hoisted: int
    outputs: tuple[int, ...]
    results: tuple[ProgramBlock, ...]
    shape: tuple[int, ...]
    returned: tuple[str, ...] = ()
    solved: bool = False

    @property
    def states(self) -> int:
        """Total number of entries of the program's input blocks, such as the coordinates and velocities."""
        return sum(block.size for block in self.inputs)

    def part(self, name: str) -> tuple[int, ...]:
        """Return the indices of the instructions that compute the entries of the result block `name`."""
        start = 0
        for block in self.results:
            if block.name == name:
                return self.outputs[start : start + block.size]
            start += block.size
        raise LagrangeError(f"program {self.name} has no result {name}")

    @cached_property
    def eliminations(self) -> Mapping[int, Elimination]:
        """The elimination of the matrix of each "factor" instruction, by the index of the instruction.

        Matrix entries that are always zero are left out.
        """
        code, result = self.instructions, {}
        for ref, instruction in enumerate(code):
            if instruction.op == "factor":
                positions = ((i, j) for i in range(instruction.order) for j in range(i + 1))
                pairs = zip(positions, instruction.args, strict=True)
                pattern = frozenset(
                    position for position, arg in pairs if code[arg].op != "constant" or code[arg].value != 0.0
                )
                result[ref] = elimination(instruction.order, pattern, instruction.negative)
        return result

    @property
    def saved(self) -> tuple[int, ...]:
        """Indices of hoisted instructions that the rest of the program reads, except constants and parameters.

        Matrix entries of a hoisted factor are included: a solve may have to factor the matrix again with pivoting.
        """
        read = {arg for instruction in self.instructions[self.hoisted :] for arg in instruction.args}
        read.update(self.outputs)
        for i in range(self.hoisted):
            if i in read and self.instructions[i].op == "factor":
                read.update(self.instructions[i].args)
        return tuple(
            i for i in range(self.hoisted) if i in read and self.instructions[i].op not in ("constant", "parameter")
        )


def arranged(
    instructions: Sequence[Instruction], outputs: Sequence[int], is_early: Callable[[int], bool]
) -> tuple[tuple[Instruction, ...], int, tuple[int, ...]]:
    """Return the instructions that the outputs need, early ones first, with operands renumbered accordingly.

    `outputs` are indices of instructions, and `is_early` is a function that returns True for the index of an early
    instruction. Also return the number of early instructions, and the new indices of the outputs.
    """
    needed = bytearray(len(instructions))
    for ref in outputs:
        needed[ref] = True
    for ref in range(len(instructions) - 1, -1, -1):
        if needed[ref]:
            for arg in instructions[ref].args:
                needed[arg] = True
    kept = [ref for ref, mark in enumerate(needed) if mark]
    first = [ref for ref in kept if is_early(ref)]
    order = [*first, *(ref for ref in kept if not is_early(ref))]
    renumbered = {old: new for new, old in enumerate(order)}
    moved = (instructions[ref]._replace(args=tuple(renumbered[arg] for arg in instructions[ref].args)) for ref in order)
    return tuple(moved), len(first), tuple(renumbered[output] for output in outputs)


def uses_of(program: Program, twice: Container[str] = (*SYSTEMS, "select")) -> list[int]:
    """Return for each instruction the least number of times that generated code reads its result.

    Operands of the operations `twice` count twice, and each output adds one.
    """
    uses = [0] * len(program.instructions)
    for instruction in program.instructions:
        for arg in instruction.args:
            uses[arg] += 2 if instruction.op in twice else 1
    for ref in program.outputs:
        uses[ref] += 1
    return uses


class SolveGroup(NamedTuple):
    """Solves with one factorization that run together. All right-hand sides are known before the first solution.

    `factor` is the index of the factor instruction, and `solves` are the indices of the solve instructions, in
    order. No right-hand side depends on another solution of the group. A Jacobian has a group with one solve for
    each entry of the state.
    """

    factor: int
    solves: tuple[int, ...]


def scheduled(program: Program, refs: Iterable[int], most: Callable[[int], int]) -> list[int | SolveGroup]:
    """Return the instructions `refs` in an order in which systems with the same matrix are solved together.

    Such solves are joined to a `SolveGroup`, of at most `most(factor)` solves with the matrix of the instruction
    `factor`. At the index of a solve in a group its right-hand side is known. Its solution is known after the
    group. Instructions are sorted by the number of successive solves on which they depend, then by index. Without
    groups the order is unchanged.
    """
    refs = list(refs)
    factors = [program.instructions[i].args[0] for i in refs if program.instructions[i].op == "solve"]
    if len(factors) == len(dict.fromkeys(factors)):
        return list(refs)
    known: dict[int, int] = {}
    """Number of successive solves that each instruction's operands depend on."""
    depth: dict[int, int] = {}
    alike: dict[tuple[int, int], list[int]] = {}
    for i in refs:
        instruction = program.instructions[i]
        known[i] = max((depth.get(arg, 0) for arg in instruction.args), default=0)
        depth[i] = known[i] + (instruction.op == "solve")
        if instruction.op == "solve":
            alike.setdefault((instruction.args[0], known[i]), []).append(i)
    groups = [
        SolveGroup(factor, part) for (factor, _), solves in alike.items() for part in _parts(solves, most(factor))
    ]
    if not groups:
        return list(refs)
    grouped = dict.fromkeys(i for group in groups for i in group.solves)
    steps: list[tuple[int, int, int | SolveGroup]] = [(known[i] if i in grouped else depth[i], 2 * i, i) for i in refs]
    steps += [(known[group.solves[0]], 2 * group.solves[-1] + 1, group) for group in groups]
    return [step for _, _, step in sorted(steps, key=lambda step: step[:2])]


def _parts(solves: list[int], most: int) -> list[tuple[int, ...]]:
    """Divide the indices of solves with one matrix into groups of similar size, at most `most` each.

    Groups of one solve are omitted.
    """
    if min(len(solves), most) < 2:
        return []
    size = -(-len(solves) // -(-len(solves) // most))
    parts = [tuple(solves[begin : begin + size]) for begin in range(0, len(solves), size)]
    return [part for part in parts if len(part) > 1]
