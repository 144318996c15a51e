"""Layout of the prepared array: the parameters, then all values that depend on them alone, each once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lagrange.algorithm.linear.symmetric import factor_size
from lagrange.program.elimination import Elimination
from lagrange.program.program import Instruction, Program

LARGEST_IN_SOURCE = 20
"""Largest matrix that is written out: compilers optimize such source text better than loops."""


@dataclass(frozen=True, eq=False)
class PreparedLayout:
    """Layout of an array with parameters, then the results of programs that depend on parameters alone.

    `size` is the length of the array. `program` computes these results, and `saved` maps its instructions to
    indices in the array. `slots` has such a map for each of the `programs`. A written-out factorization stores
    the nonzero entries of L by rows with 1/d on the diagonal, then the flag that its pivots are large enough.
    Other factorizations store the factors of `factor_dense`.
    """

    programs: tuple[Program, ...]
    program: Program
    saved: Mapping[int, int]
    slots: tuple[Mapping[int, int], ...]
    size: int
    largest: int = LARGEST_IN_SOURCE
    """Largest matrix whose factors are stored as entries, if its elimination is written out."""

    @classmethod
    def of(cls, programs: Sequence[Program], largest: int = LARGEST_IN_SOURCE) -> PreparedLayout:
        """Return the layout for programs with the same parameters.

        Factors of matrices up to the size `largest` are stored as entries.
        """
        count = max((program.parameters for program in programs), default=0)
        merged: dict[Instruction, int] = {}
        moved = [_merged(program, merged) for program in programs]
        merged_program = Program("prepare", (), count, tuple(merged), len(merged), (), (), (0,))
        begin, saved = count, dict[int, int]()
        for program, table in zip(programs, moved, strict=True):
            for ref in program.saved:
                if table[ref] not in saved:
                    saved[table[ref]] = begin
                    begin += width_of(merged_program, table[ref], largest)
        slots = [
            {ref: saved[table[ref]] for ref in program.saved} for program, table in zip(programs, moved, strict=True)
        ]
        return cls(tuple(programs), merged_program, saved, tuple(slots), begin, largest)

    def of_program(self, program: Program) -> Mapping[int, int]:
        """Return the indices of a program's saved results in the array, by index of the instruction."""
        return self.slots[self.programs.index(program)]


def _merged(program: Program, merged: dict[Instruction, int]) -> list[int]:
    """Add the hoisted instructions of a program, which depend on parameters alone, to `merged`, each once.

    `merged` maps instructions to their indices. Return these indices for the program's hoisted instructions, in
    order.
    """
    table: list[int] = []
    for instruction in program.instructions[: program.hoisted]:
        moved = instruction._replace(args=tuple(table[arg] for arg in instruction.args))
        table.append(merged.setdefault(moved, len(merged)))
    return table


def written_out(plan: Elimination, largest: int = LARGEST_IN_SOURCE) -> bool:
    """Return True if the elimination `plan` is written out, operation by operation, without loops."""
    return plan.order <= largest or plan.written_out


def width_of(program: Program, ref: int, largest: int = LARGEST_IN_SOURCE) -> int:
    """Return the number of doubles that the result of instruction `ref` occupies in the prepared array."""
    instruction = program.instructions[ref]
    if instruction.op == "factor":
        plan = program.eliminations[ref]
        return len(plan.places) + 1 if written_out(plan, largest) else factor_size(instruction.order)
    return instruction.order if instruction.op == "solve" else 1
