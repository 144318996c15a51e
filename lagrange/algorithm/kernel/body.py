"""Code generation for one evaluation: the instructions of a program become statements of a procedure.

Values that depend only on parameters are computed once and stored in the prepared array. The array begins with the
parameters; each of these values follows once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import and_
from typing import Any

from lagrange.algorithm.constants import WIDEST_VECTOR, whole_blocks
from lagrange.algorithm.kernel import elimination
from lagrange.algorithm.linear.symmetric import (
    band_size,
    factor_dense,
    factor_pivoted,
    factor_size,
    pivoted_size,
    solve_columns,
    solve_factored,
    solve_pivoted,
)
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import ANGLES, FLAG, OPERATIONS, REAL
from lagrange.procedure.values import Flag, Memory, Real, Variable
from lagrange.program.elimination import Elimination
from lagrange.program.program import GIVEN, Instruction, Program, SolveGroup, scheduled

LARGEST_IN_SOURCE = 20
"""Largest matrix whose factorization is written out in source text, which compilers optimize better than loops."""


@dataclass(frozen=True, eq=False)
class PreparedLayout:
    """Layout of an array with parameters, then the results of programs that depend only on parameters.

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
    """Size of the largest matrix whose factors are stored as entries, if its elimination is written out."""

    @classmethod
    def of(cls, programs: Sequence[Program], largest: int = LARGEST_IN_SOURCE) -> PreparedLayout:
        """Return the layout for `programs` with the same parameters.

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
    """Add the hoisted instructions of a program, which depend only on parameters, to `merged`, each once.

    `merged` maps instructions to indices. Return the indices of the program's hoisted instructions, in order.
    """
    table: list[int] = []
    for instruction in program.instructions[: program.hoisted]:
        moved = instruction._replace(args=tuple(table[arg] for arg in instruction.args))
        table.append(merged.setdefault(moved, len(merged)))
    return table


def written_out(plan: Elimination, largest: int = LARGEST_IN_SOURCE) -> bool:
    """Return True if the elimination `plan` is written out, operation by operation, without loops.

    Matrices up to the size `largest` are written out, and larger ones if the plan says so.
    """
    return plan.order <= largest or plan.written_out


def width_of(program: Program, ref: int, largest: int = LARGEST_IN_SOURCE) -> int:
    """Return the number of doubles that the result of instruction `ref` occupies in the prepared array."""
    instruction = program.instructions[ref]
    if instruction.op == "factor":
        plan = program.eliminations[ref]
        return len(plan.places) + 1 if written_out(plan, largest) else factor_size(instruction.order)
    return instruction.order if instruction.op == "solve" else 1


CONDITIONS = frozenset(op for op, signatures in OPERATIONS.items() if signatures[0][1] is FLAG)
"""Names of operations whose result is true or false."""

MOSTLY_ZERO = 4
"""Number of entries of a matrix's triangle per nonzero entry, above which generated code first clears the triangle in a
loop and then writes the nonzero entries only.
"""


@dataclass(frozen=True)
class Style:
    """Form of generated code for linear systems: single statements, or calls of procedures.

    Eliminations up to size `largest` are written out, with up to `substituted` multiplications in their
    substitutions. Up to `systems` systems with the same matrix are solved together. Written-out solutions have up
    to `entries` entries in total. Systems in memory are solved as adjacent columns if `side_by_side`, else one
    after the other. Without `pivoting` a system fails if a pivot in the original order is too small. If `early`,
    inputs are read at the start of the procedure, else at their first use.
    """

    largest: int = LARGEST_IN_SOURCE
    substituted: int = 800
    systems: int = 64
    entries: int = 1_000_000
    side_by_side: bool = False
    pivoting: bool = True
    early: bool = True


SOURCE = Style()
"""Style for source text in other languages, whose compilers optimize it."""


@dataclass(frozen=True)
class Inputs:
    """Inputs of a program's instructions: time, state, and the array `parameters`.

    This array has the parameters, then the prepared numbers, which depend only on parameters. `slots` maps the
    indices of instructions to the indices of their results in this array. `names` maps them to the names of
    their results in printed code.
    """

    parameters: Memory
    slots: Mapping[int, int]
    time: Real | None = None
    state: Memory | None = None
    names: Mapping[int, str] = field(default_factory=dict)
    largest: int = LARGEST_IN_SOURCE
    """Size of the largest matrix whose prepared factors are stored as entries, as in `PreparedLayout`."""


@dataclass(frozen=True)
class FactoredMatrix:
    """A factorization L D L^T: its `entries` by index pair, or the `memory` that has its factors.

    If the operations are written out, there are entries, and `trusted` is a flag that is true if all pivots are
    large enough. Else there is only the memory.
    """

    entries: Mapping[tuple[int, int], Real]
    trusted: Flag | None
    memory: Memory | None


class Body:
    """Adds instructions of a program to a procedure as statements. A `ref` is the index of an instruction."""

    def __init__(self, p: Builder, program: Program, inputs: Inputs, style: Style = SOURCE) -> None:
        self.p, self.program, self.inputs, self.style = p, program, inputs, style
        self.values: dict[int, Any] = {}
        self.places = {
            instruction: ref for ref, instruction in enumerate(program.instructions) if instruction.op in ANGLES
        }
        """Index in the program of each instruction that computes a sine or a cosine, by instruction."""
        self.vectors: dict[int, list[Real]] = {}
        self.later: dict[int, list[tuple[Memory, int]]] = {}
        """Memory and index of each entry of a solution, by solve instruction. Entries are read where they are used."""
        self.rows: dict[int, Memory] = {}
        """Memory for the right-hand sides of a group of systems that are solved together, one in each column.

        The key is the index of the group's first solve instruction.
        """
        self.factors: dict[int, FactoredMatrix] = {}
        self.tested: dict[int, None] = {}
        """Factor instructions whose pivots the code has already tested, if the style has no pivoting."""
        self.singular: Variable | None = None
        """Flag of a singular matrix; None before the first matrix."""

    def fails(self) -> Variable:
        """Return the variable that is true for a singular matrix. The variable is declared before the first branch."""
        if self.singular is None:
            self.singular = self.p.variable(self.p.false, "singular")
        return self.singular

    @property
    def failed(self) -> Flag:
        """The flag that is true for a singular matrix, at the present statement."""
        return self.p.false if self.singular is None else Flag.of(self.singular.value)

    def load_inputs(self, refs: Iterable[int]) -> None:
        """Read the inputs that the instructions `refs` need, before all branches.

        Inputs are states, parameters, and prepared numbers, which depend only on parameters.
        """
        code, read = self.program.instructions, dict[int, None]()
        for ref in refs:
            read |= dict.fromkeys(code[ref].args)
        for ref in sorted(read):
            if code[ref].op in ("state", "parameter") or ref in self.inputs.slots:
                self.loaded(ref)

    def loaded(self, ref: int) -> None:
        """Add the read of the result of instruction `ref`, if it is an input or part of a solution in memory.

        Nothing is added if it has been read already, or has to be computed.
        """
        instruction, inputs = self.program.instructions[ref], self.inputs
        if instruction.op == "component" and instruction.args[0] in self.later:
            memory, index = self.later[instruction.args[0]][instruction.place]
            self.values[ref] = memory[index]
        elif instruction.op == "state" and ref not in self.values:
            assert inputs.state is not None
            self.values[ref] = self._named(ref, inputs.state[instruction.place])
        elif instruction.op == "parameter" and ref not in self.values:
            self.values[ref] = self._named(ref, inputs.parameters[instruction.place])
        elif ref in inputs.slots and not self.known(ref):
            self.restore(ref, instruction, inputs.slots[ref])

    def known(self, ref: int) -> bool:
        """Return True if statements that compute or read the result of an instruction are already in the procedure."""
        return any(ref in known for known in (self.values, self.vectors, self.factors, self.later))

    def _named(self, ref: int, value: Any) -> Any:
        name = self.inputs.names.get(ref)
        if name:
            self.p.names[value.ref] = name
        return value

    def value(self, ref: int) -> Any:
        """Return the value that instruction `ref` computes, a number or a condition; an input is read first."""
        instruction = self.program.instructions[ref]
        if instruction.op == "constant":
            return self.p.constant(float(instruction.value), REAL)
        if instruction.op == "time":
            assert self.inputs.time is not None
            return self.inputs.time
        if ref not in self.values:
            self.loaded(ref)
        return self.values[ref]

    def restore(self, ref: int, instruction: Instruction, slot: int) -> None:
        """Read the result of instruction number `ref` from the array of parameters, from index `slot` on.

        After the parameters this array has results that depend only on them. The result of a factor
        `instruction` are the factors of its matrix.
        """
        inputs, held = self.inputs, self.inputs.parameters
        if instruction.op == "factor" and not written_out(self.program.eliminations[ref], inputs.largest):
            self.factors[ref] = self.read_factors(self.program.eliminations[ref], held.at(slot))
        elif instruction.op == "factor":
            places = self.program.eliminations[ref].places
            entries = {entry: held[slot + k] for k, entry in enumerate(places)}
            self.factors[ref] = FactoredMatrix(entries, ~held[slot + len(places)].equals(0.0), None)
        elif instruction.op == "solve":
            self.vectors[ref] = [held[slot + k] for k in range(instruction.order)]
        else:
            value = held[slot]
            self.values[ref] = ~value.equals(0.0) if instruction.op in CONDITIONS else self._named(ref, value)

    def read_factors(self, plan: Elimination, memory: Memory) -> FactoredMatrix:
        """Return the factors that `factor_dense` wrote to `memory`, for a matrix with the elimination `plan`.

        The result has entries if the operations of this elimination are written out, else the memory itself.
        """
        if not written_out(plan, self.style.largest):
            return FactoredMatrix({}, None, memory)
        n = plan.order
        entries = {(i, j): memory[1 + j] if i == j else memory[2 * n + 1 + j * n + i] for i, j in plan.places}
        return FactoredMatrix(entries, memory[0].equals(0.0), None)

    def save(self, ref: int, out: Memory, slot: int) -> None:
        """Write the result of instruction `ref` to the array `out`, from index `slot` on.

        The result depends only on parameters. A matrix factorization or a solution takes several numbers.
        """
        instruction, width = self.program.instructions[ref], width_of(self.program, ref, self.inputs.largest)
        if instruction.op == "factor":
            held = self.factors[ref]
            if held.memory is None:
                places = self.program.eliminations[ref].places
                for k, entry in enumerate(places):
                    out[slot + k] = held.entries.get(entry, 0.0)
                assert held.trusted is not None
                out[slot + len(places)] = self.p.real(held.trusted)
            else:
                target, source = out.at(slot), held.memory
                with self.p.loop(0, width) as i:
                    target[i] = source[i]
        elif instruction.op == "solve":
            for k, value in enumerate(self.vector(ref)):
                out[slot + k] = value
        else:
            out[slot] = self.p.real(self.value(ref))

    def run(self, refs: Iterable[int]) -> None:
        """Add the statements of the instructions `refs`. Systems with the same matrix are solved together."""
        refs = list(refs)
        if self.style.early:
            self.load_inputs(refs)
        steps = scheduled(self.program, refs, self.most_together)
        groups = {ref: step for step in steps if isinstance(step, SolveGroup) for ref in step.solves}
        for step in steps:
            if isinstance(step, SolveGroup):
                self.solve(step.factor, step.solves)
            elif step not in groups:
                self.instruction(step)
            elif self.style.side_by_side:
                # The right-hand sides of a group are adjacent columns in memory, unless the solution is written out.
                plan = self.program.eliminations[groups[step].factor]
                if not written_out(plan, self.style.largest):
                    self.gather(step, groups[step].solves)

    def most_together(self, factor: int) -> int:
        """Return the largest number of systems with one matrix that are solved together.

        `factor` is the index of the instruction that factors the matrix.
        """
        plan = self.program.eliminations[factor]
        joined = self.style.entries // plan.order if written_out(plan, self.style.largest) else self.style.systems
        return min(joined, self.style.systems)

    def instruction(self, ref: int) -> None:
        """Add the statements of one instruction to the procedure."""
        instruction = self.program.instructions[ref]
        if instruction.op in GIVEN or self.known(ref):
            return
        if instruction.op == "factor":
            self.factor(ref, instruction)
        elif instruction.op == "solve":
            self.solve(instruction.args[0], (ref,))
        elif instruction.op == "component":
            if instruction.args[0] not in self.later:
                self.values[ref] = self.vector(instruction.args[0])[instruction.place]
        elif (partner := self.partner(instruction)) is not None:
            sine, cosine = self.p.sine_cosine(self.value(instruction.args[0]))
            self.values[ref], self.values[partner] = (sine, cosine) if instruction.op == "sin" else (cosine, sine)
        else:
            self.values[ref] = self._named(
                ref, self.p.operation(instruction.op, *(self.value(arg) for arg in instruction.args))
            )

    def partner(self, instruction: Instruction) -> int | None:
        """Return the index of the instruction with the cosine of the same angle, for a sine, and the converse.

        The result is None if the program has no such instruction, or if `instruction` is neither a sine nor a cosine.
        """
        if instruction.op not in ANGLES:
            return None
        return self.places.get(instruction._replace(op="cos" if instruction.op == "sin" else "sin"))

    def vector(self, ref: int) -> list[Real]:
        """Return the solution of the solve instruction `ref`, entry by entry."""
        if ref in self.later:
            return [memory[index] for memory, index in self.later[ref]]
        if ref not in self.vectors:
            self.loaded(ref)
        return self.vectors[ref]

    def entries(self, instruction: Instruction) -> dict[tuple[int, int], Real]:
        """Return the lower triangle of a factor instruction's matrix: values by index pair (i, j), i >= j.

        Entries that are identically zero are left out.
        """
        entries = {}
        for i in range(instruction.order):
            for j in range(i + 1):
                arg = instruction.args[i * (i + 1) // 2 + j]
                entry = self.program.instructions[arg]
                if entry.op != "constant" or entry.value != 0.0:
                    entries[i, j] = self.value(arg)
        return entries

    def matrix(self, instruction: Instruction) -> Memory:
        """Return new memory with the lower triangle of a factor instruction's matrix: (i, j) at j*n + i."""
        n, entries = instruction.order, self.entries(instruction)
        memory = self.p.reserve(n * n, name="matrix")
        indices = [(i, j) for j in range(n) for i in range(j, n)]
        if len(entries) * MOSTLY_ZERO < len(indices):
            with self.p.each(n * n, width=1) as k:
                memory[k] = 0.0
            indices = list(entries)
        for i, j in indices:
            memory[j * n + i] = entries.get((i, j), 0.0)
        return memory

    def factor(self, ref: int, instruction: Instruction) -> None:
        """Add the factorization of the matrix of the factor `instruction`, which has the index `ref`.

        The size of the matrix and the style decide whether it is written out, or done in memory by a procedure.
        """
        plan, p = self.program.eliminations[ref], self.p
        if written_out(plan, self.style.largest):
            entries, trusted = elimination.factored(p, plan, self.entries(instruction))
            self.factors[ref] = FactoredMatrix(entries, trusted, None)
        else:
            self.factors[ref] = FactoredMatrix({}, None, self.factored_in_memory(instruction))

    def factored_in_memory(self, instruction: Instruction) -> Memory:
        """Factor the matrix of a factor instruction in memory, and return the memory of the factors."""
        failed = self.fails()
        factors = self.p.reserve(factor_size(instruction.order), name="factors")
        failed.value = failed.value | self.p.call(
            factor_dense.form(), instruction.order, self.matrix(instruction), factors
        )
        return factors

    def right(self, ref: int) -> list[Real | None]:
        """Return the right-hand side of the solve instruction `ref`. An entry that is zero is None."""
        args, code = self.program.instructions[ref].args[1:], self.program.instructions
        return [None if code[arg].op == "constant" and code[arg].value == 0.0 else self.value(arg) for arg in args]

    def solve(self, factor: int, solves: Sequence[int]) -> None:
        """Add the solution of the systems of the instructions `solves`, which have the same matrix.

        `factor` is the index of the instruction that factors this matrix.
        """
        if factor not in self.factors:
            self.loaded(factor)
        instruction = self.program.instructions[factor]
        held = self.factors[factor]
        if held.memory is not None and self.style.side_by_side and len(solves) > 1:
            self.by_rows(held.memory, solves)
            return
        right = [self.right(ref) for ref in solves]
        if held.memory is None and len(solves) * instruction.order**2 > self.style.substituted:
            held = self.factors[factor] = FactoredMatrix(
                held.entries, held.trusted, self.factored_in_memory(instruction)
            )
        if held.memory is None:
            solutions = self.written_out(factor, held, right)
        else:
            solutions = self.in_memory(instruction.order, held.memory, right)
        self.vectors.update(zip(solves, solutions, strict=True))

    def in_memory(self, n: int, factors: Memory, right: Sequence[Sequence[Real | None]]) -> list[list[Real]]:
        """Add the solution of systems of size n by `factors` in memory. Return the solutions.

        `right` has a right-hand side for each system; an entry None is zero.
        """
        p = self.p
        vector = p.reserve(n * len(right), name="vector")
        for k, value in enumerate(entry for right_side in right for entry in right_side):
            vector[k] = 0.0 if value is None else value
        if len(right) == 1:
            p.call(solve_factored.form(), n, factors, vector)
        else:
            with p.loop(0, len(right)) as column:
                p.call(solve_factored.form(), n, factors, vector.at(column * n))
        return [[vector[k * n + i] for i in range(n)] for k in range(len(right))]

    def rows_of(self, solves: Sequence[int]) -> tuple[Memory, int]:
        """Return the memory for the right-hand sides of the instructions `solves`, and the length of a row.

        The right-hand sides are adjacent columns: entry i of right-hand side c is at i * length + c.
        """
        n, width = self.program.instructions[solves[0]].order, whole_blocks(len(solves), WIDEST_VECTOR)
        if solves[0] not in self.rows:
            self.rows[solves[0]] = self.p.reserve(n * width, room=WIDEST_VECTOR, name="rows")
        return self.rows[solves[0]], width

    def gather(self, ref: int, solves: Sequence[int]) -> None:
        """Write the right-hand side of the solve instruction `ref`, one of the group `solves`, to memory.

        The right-hand side is written as soon as it is computed, to free registers.
        """
        (rows, width), column = self.rows_of(solves), solves.index(ref)
        for i, value in enumerate(self.right(ref)):
            rows[i * width + column] = 0.0 if value is None else value

    def by_rows(self, factors: Memory, solves: Sequence[int]) -> None:
        """Add the solution of a group of solve instructions by the `factors` in memory, for all at once.

        Their right-hand sides are adjacent columns in memory. Entries of the solutions are read at their use.
        """
        p, n, count = self.p, self.program.instructions[solves[0]].order, len(solves)
        rows, width = self.rows_of(solves)
        for i in range(n if count < width else 0):
            for column in range(count, width):
                rows[i * width + column] = 0.0
        p.call(solve_columns.form(), n, width, factors, rows, p.reserve(n, name="spare"))
        for column, ref in enumerate(solves):
            self.later[ref] = [(rows, i * width + column) for i in range(n)]

    def written_out(
        self, factor: int, factors: FactoredMatrix, right: Sequence[Sequence[Real | None]]
    ) -> list[list[Real]]:
        """Emit single statements that solve linear systems with a factored matrix, and return the solutions.

        `factor` is the index of the instruction that factors the matrix, `factors` are the entries of the factors, and
        `right` has the right-hand sides. If a pivot is too small, or a solution is inaccurate, the emitted code solves
        the systems again with pivoting. If the style has no pivoting, it records a failure instead.
        """
        p, instruction, plan = self.p, self.program.instructions[factor], self.program.eliminations[factor]
        failed = self.fails()
        entries = self.entries(instruction) if plan.negative else {}
        candidates = [elimination.solved(p, plan, factors.entries, b) for b in right]
        assert factors.trusted is not None
        satisfied = [
            flag
            for x, b in zip(candidates, right, strict=True)
            for flag in elimination.satisfied(p, plan, entries, x, b)
        ]
        if not self.style.pivoting:
            tests = satisfied if factor in self.tested else [factors.trusted, *satisfied]
            self.tested[factor] = None
            if tests:
                failed.value = failed.value | ~reduce(and_, tests)
            return candidates
        good = reduce(and_, satisfied, factors.trusted)
        kept = [[p.variable(value) for value in x] for x in candidates]
        with p.when(~good, likely=False):
            before = dict(self.values)
            if plan.negative:
                solutions = self.in_a_band(instruction, plan, right)
            else:
                # `factor_dense` recognizes definite matrices in any units.
                solutions = self.in_memory(plan.order, self.factored_in_memory(instruction), right)
            for variables, values in zip(kept, solutions, strict=True):
                for variable, value in zip(variables, values, strict=True):
                    variable.value = value
            self.values = before
        return [[variable.value for variable in x] for x in kept]

    def in_a_band(
        self, instruction: Instruction, plan: Elimination, right: Sequence[Sequence[Real | None]]
    ) -> list[list[Real]]:
        """Return the solutions for the right-hand sides `right`, by elimination with pivoting within a band.

        The matrix, that of the factor `instruction`, is sparse. Its unknowns are in the order `ranks` of the
        plan.
        """
        p, n, failed = self.p, plan.order, self.fails()
        matrix = p.reserve(band_size(n, plan.band), name="matrix")
        elimination.write_band(p, plan, self.entries(instruction), matrix)
        factors = p.reserve(pivoted_size(n, plan.band), name="factors")
        failed.value = failed.value | p.call(factor_pivoted.form(), n, plan.band, matrix, factors)
        vector, solutions = p.reserve(n, name="vector"), []
        for b in right:
            for rank, value in zip(plan.ranks, b, strict=True):
                vector[rank] = 0.0 if value is None else value
            p.call(solve_pivoted.form(), n, plan.band, factors, vector)
            solutions.append([vector[rank] for rank in plan.ranks])
        return solutions
