"""The instructions of a program as statements of a procedure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL
from lagrange.procedure.kernel import elimination
from lagrange.procedure.kernel.prepared import width_of, written_out
from lagrange.procedure.linear.ldl import factor_dense, factor_size, solve_factored
from lagrange.procedure.operations import OPERATIONS
from lagrange.procedure.values import Flag, Memory, Real, Variable
from lagrange.program.program import Instruction, Program
from lagrange.program.solve_groups import SolveGroup, scheduled

CONDITIONS = frozenset(op for op, signatures in OPERATIONS.items() if signatures[0][1] is FLAG)
"""Operations that give true or false."""

MOST_TOGETHER = 64
"""So many systems with one matrix are solved together at most."""


MOST_SUBSTITUTED = 800
"""Multiplications of substitutions with one matrix, side by side, up to which they are written out."""


@dataclass(frozen=True)
class Inputs:
    """What the instructions of a program read: time, state, parameters and, behind them, prepared numbers."""

    parameters: Memory
    slots: Mapping[int, int]
    time: Real | None = None
    state: Memory | None = None
    state_names: Sequence[str] = ()
    parameter_names: Sequence[str] = ()


@dataclass(frozen=True)
class Factored:
    """A factorization: its entries by place where it is written out, else the array of its factors."""

    entries: Mapping[tuple[int, int], Real]
    trusted: Flag | None
    memory: Memory | None


class Body:
    """Adds a part of the instructions of a program to a procedure."""

    def __init__(self, p: Builder, program: Program, inputs: Inputs) -> None:
        self.p, self.program, self.inputs = p, program, inputs
        self.values: dict[int, Any] = {}
        self.vectors: dict[int, list[Real]] = {}
        self.factors: dict[int, Factored] = {}
        self.singular: Variable | None = None
        """Whether a matrix was singular, if there is one."""

    def fails(self) -> Variable:
        """Return the variable that says whether a matrix was singular; it is declared before the first branch."""
        if self.singular is None:
            self.singular = self.p.variable(self.p.false, "singular")
        return self.singular

    def load_inputs(self, refs: Iterable[int]) -> None:
        """Read the inputs that instructions read, in order, outside of all branches."""
        code, read = self.program.instructions, dict[int, None]()
        for ref in refs:
            read |= dict.fromkeys(code[ref].args)
        for ref in sorted(read):
            if code[ref].op in ("state", "parameter") or ref in self.inputs.slots:
                self.loaded(ref)

    def loaded(self, ref: int) -> None:
        """Read an input or a prepared result, once."""
        one, inputs = self.program.instructions[ref], self.inputs
        if one.op == "state" and ref not in self.values:
            assert inputs.state is not None
            names = inputs.state_names
            self.values[ref] = self._named(inputs.state[one.place], names[one.place] if names else "")
        elif one.op == "parameter" and ref not in self.values:
            names = inputs.parameter_names
            self.values[ref] = self._named(inputs.parameters[one.place], names[one.place] if names else "")
        elif ref in inputs.slots and not self.known(ref):
            self.restore(ref, one, inputs.slots[ref])

    def known(self, ref: int) -> bool:
        """Return whether a result has been read or computed."""
        return ref in self.values or ref in self.vectors or ref in self.factors

    @staticmethod
    def _named(value: Real, name: str) -> Real:
        return value.called(name) if name else value

    def value(self, ref: int) -> Any:
        """Return a number or a condition."""
        one = self.program.instructions[ref]
        if one.op == "constant":
            return self.p.constant(float(one.value), REAL)
        if one.op == "time":
            assert self.inputs.time is not None
            return self.inputs.time
        if ref not in self.values:
            self.loaded(ref)
        return self.values[ref]

    def restore(self, ref: int, one: Instruction, slot: int) -> None:
        """Read a result that was prepared."""
        held = self.inputs.parameters
        if one.op == "factor" and not written_out(self.program.eliminations[ref]):
            self.factors[ref] = Factored({}, None, held.at(slot))
        elif one.op == "factor":
            places = self.program.eliminations[ref].places
            entries = {place: held[slot + k] for k, place in enumerate(places)}
            self.factors[ref] = Factored(entries, ~held[slot + len(places)].equals(0.0), None)
        elif one.op == "solve":
            self.vectors[ref] = [held[slot + k] for k in range(one.order)]
        else:
            value = held[slot]
            self.values[ref] = ~value.equals(0.0) if one.op in CONDITIONS else value

    def save(self, ref: int, out: Memory, slot: int) -> None:
        """Write a prepared result."""
        one, width = self.program.instructions[ref], width_of(self.program, ref)
        if one.op == "factor":
            held = self.factors[ref]
            if held.memory is None:
                places = self.program.eliminations[ref].places
                for k, place in enumerate(places):
                    out[slot + k] = held.entries.get(place, 0.0)
                assert held.trusted is not None
                out[slot + len(places)] = self.p.real(held.trusted)
            else:
                target, source = out.at(slot), held.memory
                with self.p.loop(0, width) as i:
                    target[i] = source[i]
        elif one.op == "solve":
            for k, value in enumerate(self.vectors[ref]):
                out[slot + k] = value
        else:
            out[slot] = self.p.real(self.value(ref))

    def run(self, refs: Iterable[int]) -> None:
        """Add instructions, each after those that it reads; systems with one matrix are solved together."""
        refs = list(refs)
        self.load_inputs(refs)
        steps = scheduled(self.program, refs, lambda _: MOST_TOGETHER)
        grouped = frozenset(ref for step in steps if isinstance(step, SolveGroup) for ref in step.solves)
        for step in steps:
            if isinstance(step, SolveGroup):
                self.solve(step.factor, step.solves)
            elif step not in grouped:
                self.instruction(step)

    def instruction(self, ref: int) -> None:
        """Add one instruction."""
        one = self.program.instructions[ref]
        if one.op in ("constant", "parameter", "state", "time") or self.known(ref):
            return
        if one.op == "factor":
            self.factor(ref, one)
        elif one.op == "solve":
            self.solve(one.args[0], (ref,))
        elif one.op == "component":
            self.values[ref] = self.vector(one.args[0])[one.place]
        else:
            self.values[ref] = self.p.operation(one.op, *(self.value(arg) for arg in one.args))

    def vector(self, ref: int) -> list[Real]:
        """Return a solution."""
        if ref not in self.vectors:
            self.loaded(ref)
        return self.vectors[ref]

    def entries(self, one: Instruction) -> dict[tuple[int, int], Real]:
        """Return the entries (i, j), i >= j, of a matrix that are not identically zero."""
        found = {}
        for i in range(one.order):
            for j in range(i + 1):
                arg = one.args[i * (i + 1) // 2 + j]
                entry = self.program.instructions[arg]
                if entry.op != "constant" or entry.value != 0.0:
                    found[i, j] = self.value(arg)
        return found

    def matrix(self, one: Instruction) -> Memory:
        """Write the lower triangle of a matrix to memory, by columns."""
        n, entries = one.order, self.entries(one)
        memory = self.p.reserve(n * n, name="matrix")
        for j in range(n):
            for i in range(j, n):
                memory[j * n + i] = entries.get((i, j), 0.0)
        return memory

    def factor(self, ref: int, one: Instruction) -> None:
        """Factor a matrix: written out where that is short, else in memory."""
        plan, p = self.program.eliminations[ref], self.p
        if written_out(plan):
            entries, trusted = elimination.factored(p, plan, self.entries(one))
            self.factors[ref] = Factored(entries, trusted, None)
            return
        failed = self.fails()
        factors = p.reserve(factor_size(one.order), name="factors")
        bad = p.call(factor_dense(), one.order, self.matrix(one), factors)
        failed.value = failed.value | bad
        self.factors[ref] = Factored({}, None, factors)

    def solve(self, factor: int, solves: Sequence[int]) -> None:
        """Solve systems with one factored matrix."""
        if factor not in self.factors:
            self.loaded(factor)
        right = [[self.value(arg) for arg in self.program.instructions[ref].args[1:]] for ref in solves]
        held, order = self.factors[factor], self.program.instructions[factor].order
        if held.memory is None and len(solves) * order * order > MOST_SUBSTITUTED:
            held = self.factors[factor] = self.kept_in_memory(factor, held)
        found = self.in_memory(factor, held, right) if held.memory else self.written_out(factor, held, right)
        for ref, x in zip(solves, found, strict=True):
            self.vectors[ref] = x

    def kept_in_memory(self, factor: int, held: Factored) -> Factored:
        """Return a factorization for loops over right-hand sides, which are shorter than written-out operations."""
        one, failed = self.program.instructions[factor], self.fails()
        factors = self.p.reserve(factor_size(one.order), name="factors")
        failed.value = failed.value | self.p.call(factor_dense(), one.order, self.matrix(one), factors)
        return Factored(held.entries, held.trusted, factors)

    def in_memory(self, factor: int, held: Factored, right: Sequence[Sequence[Real]]) -> list[list[Real]]:
        """Return the solutions with factors in memory."""
        p, n = self.p, self.program.instructions[factor].order
        vector = p.reserve(n * len(right), name="vector")
        for k, value in enumerate(entry for one in right for entry in one):
            vector[k] = value
        with p.loop(0, len(right)) as column:
            p.call(solve_factored(), n, held.memory, vector.at(column * n))
        return [[vector[k * n + i] for i in range(n)] for k in range(len(right))]

    def written_out(self, factor: int, held: Factored, right: Sequence[Sequence[Real]]) -> list[list[Real]]:
        """Return the solutions by the written-out factors where these can be trusted, else with pivoting."""
        p, one, plan = self.p, self.program.instructions[factor], self.program.eliminations[factor]
        failed = self.fails()
        entries = self.entries(one)
        found = [elimination.solved(p, plan, held.entries, b) for b in right]
        assert held.trusted is not None
        good = held.trusted
        for x, b in zip(found, right, strict=True):
            for satisfied in elimination.satisfied(p, plan, entries, x, b):
                good = good & satisfied
        held_x = [[p.variable(value) for value in x] for x in found]
        with p.when(~good, likely=False):
            factors = p.reserve(factor_size(one.order), name="factors")
            failed.value = failed.value | p.call(factor_dense(), one.order, self.matrix(one), factors)
            slow = self.in_memory(factor, Factored({}, None, factors), right)
            for variables, values in zip(held_x, slow, strict=True):
                for variable, value in zip(variables, values, strict=True):
                    variable.value = value
        return [[variable.value for variable in x] for x in held_x]
