"""Emit a part of the instructions of a program, for one state or for a vector of states."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain

from lagrange.machine.kernel import llvm_ldl
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import LIBRARY
from lagrange.machine.llvm.sine_cosine import call_sine_and_cosine, sine_and_cosine
from lagrange.machine.llvm.spelling import BOOLEAN, element, flag_type, number, spell
from lagrange.procedure.form import Procedure
from lagrange.procedure.linear.ldl import factor_size
from lagrange.procedure.linear.pivoted import band_size, pivoted_size
from lagrange.program.elimination import Elimination
from lagrange.program.program import Instruction, Program

LARGEST_ON_STACK = 50_000
"""Most doubles on the stack for a sparse matrix that is solved with pivoting, and for its factors: 400 kB."""

MOSTLY_ZERO = 4
"""A triangle with this many times as many places as entries is cleared in a loop."""

ANGLES = ("sin", "cos")

INLINE_ANGLES = 8
"""Up to this many different angles, sine and cosine are written out for each.

Beyond it they are a function, which bounds the compile time of a long chain.
"""


def shares_angle_function(program: Program) -> bool:
    """Return whether sine and cosine are a function of the module."""
    return len(angles(program)) > INLINE_ANGLES


def angles(program: Program) -> list[int]:
    """Return the results whose sine or cosine is computed, each once."""
    return list(dict.fromkeys(i.args[0] for i in program.instructions if i.op in ANGLES))


def work_size(n: int) -> int:
    """Return how many doubles `solve_lanes` works with."""
    return n * n + n + factor_size(n)


def pivoted_work_size(plan: Elimination) -> int:
    """Return the number of doubles in the work array of `solve_lanes_pivoted`."""
    n, band = plan.order, plan.band
    return int(band_size(n, band)) + n + pivoted_size(n, band)


def saved_slots(program: Program) -> dict[int, int]:
    """Return the position of each saved result behind the given parameters."""
    slots: dict[int, int] = {}
    position = program.parameters
    for ref in program.saved:
        slots[ref] = position
        position += width_of(program, ref)
    return slots


def prepared_size(program: Program) -> int:
    """Return the length of the parameter array with the saved results."""
    return program.parameters + sum(width_of(program, ref) for ref in program.saved)


def width_of(program: Program, ref: int) -> int:
    """Return how many doubles a result takes."""
    one = program.instructions[ref]
    if one.op == "factor":
        plan = program.eliminations[ref]
        return len(plan.places) + 1 if plan.written_out else factor_size(one.order)
    return one.order if one.op == "solve" else 1


class Body:
    """Emits a part of the instructions of a program over `lanes` lanes."""

    def __init__(self, program: Program, lanes: int, vector_names: dict[str, str]) -> None:
        self.program = program
        self.lanes = lanes
        self.kind = element(lanes)
        self.vector_names = vector_names
        self.e = Emitter()
        self.values: dict[int, str] = {}
        self.vectors: dict[int, list[str]] = {}
        self.held: dict[int, tuple[str, int]] = {}
        """Results that stand in memory and are loaded on first use: the array and the index."""
        self.singular: list[str] = []
        self.called: dict[Procedure, None] = {}
        """The procedures of other modules that are called by name, in order."""
        self.slots = saved_slots(program)
        self.reserved: dict[tuple[str, str, int], str] = {}
        self.free = ""
        """Where memory on the heap is free, if scratch memory is taken from there."""
        self.inline = not shares_angle_function(program)
        self.by_code = {instruction: i for i, instruction in enumerate(program.instructions)}

    def ref(self, i: int) -> str:
        """Return the value of an instruction; what stands in memory is loaded on first use."""
        if i not in self.values:
            one = self.program.instructions[i]
            if one.op == "constant":
                return number(one.value, self.lanes)
            if one.op == "parameter":
                self.values[i] = self.given(one.place)
            elif i in self.held:
                self.values[i] = self.e.get(*self.held[i], self.kind)
            else:
                self.restore(i, self.slots[i])
        return self.values[i]

    def vector(self, i: int) -> list[str]:
        """Return the entries of a factor or a solution."""
        if i not in self.vectors:
            self.restore(i, self.slots[i])
        return self.vectors[i]

    def given(self, place: int) -> str:
        """Return a parameter or a saved number, in every lane."""
        return self.e.splat(self.e.get("%p", place), self.kind)

    def name_of(self, procedure: Procedure) -> str:
        """Return the name of a procedure of another module, to be called."""
        self.called[procedure] = None
        return procedure.name

    def restore(self, ref: int, slot: int) -> None:
        """Read a result that `prepare` left behind the parameters."""
        one = self.program.instructions[ref]
        op = one.op
        if op == "factor" and not self.program.eliminations[ref].written_out:
            self.values[ref] = self.e.address("%p", slot)
        elif op in ("factor", "solve"):
            width = width_of(self.program, ref)
            self.vectors[ref] = [self.given(slot + k) for k in range(width)]
            if op == "factor":
                self.vectors[ref][-1] = self.as_flag(self.vectors[ref][-1])
        else:
            value = self.given(slot)
            self.values[ref] = self.as_flag(value) if op in BOOLEAN else value

    def as_flag(self, value: str) -> str:
        """Return the condition that was saved as a number."""
        return self.e.value(f"fcmp une {self.kind} {value}, {number(0.0, self.lanes)}")

    def run(self, refs: Iterable[int]) -> None:
        """Emit some instructions, each after those that it reads."""
        for i in refs:
            instruction = self.program.instructions[i]
            op = instruction.op
            if op in ("constant", "parameter", "state", "time"):
                continue
            if op == "factor":
                self.factor(i, instruction)
            elif op == "solve":
                self.solve(i, instruction)
            elif op == "component":
                self.values[i] = self.vector(instruction.args[0])[instruction.place]
            elif op in LIBRARY:
                self.values[i] = self.library(i, instruction)
            else:
                self.values[i] = spell(self.e, op, [self.ref(arg) for arg in instruction.args], self.lanes)

    def library(self, i: int, instruction: Instruction) -> str:
        """Call the C library; sine and cosine of one angle together."""
        if i in self.values:
            return self.values[i]
        op, args = instruction.op, instruction.args
        operands = [self.ref(arg) for arg in args]
        if op in ANGLES:
            return self.angle(op, args, operands[0])
        if self.lanes > 1:
            return self.vector_call(op, operands)
        typed = ", ".join(f"double {operand}" for operand in operands)
        return self.e.value(f"call double @{LIBRARY[op]}({typed})")

    def angle(self, op: str, args: tuple[int, ...], x: str) -> str:
        """Return the sine or cosine of an angle, and keep the other if the program has it."""
        make = sine_and_cosine if self.inline else call_sine_and_cosine
        pair = dict(zip(ANGLES, make(self.e, x, self.lanes), strict=True))
        for name, value in pair.items():
            place = self.by_code.get(Instruction(name, args))
            if place is not None:
                self.values[place] = value
        return pair[op]

    def vector_call(self, op: str, operands: list[str]) -> str:
        """Call a vector routine, or the scalar one for each lane."""
        if op in self.vector_names:
            typed = ", ".join(f"{self.kind} {operand}" for operand in operands)
            return self.e.value(f"call {self.kind} @{self.vector_names[op]}({typed}) #0")
        result = "poison"
        for lane in range(self.lanes):
            picked = [self.e.value(f"extractelement {self.kind} {operand}, i64 {lane}") for operand in operands]
            typed = ", ".join(f"double {one}" for one in picked)
            called = self.e.value(f"call double @{LIBRARY[op]}({typed})")
            result = self.e.value(f"insertelement {self.kind} {result}, double {called}, i64 {lane}")
        return result

    def scratch(self, purpose: str, kind: str, count: int) -> str:
        """Return memory for one purpose, written before every use: the stack has no room for one per solve."""
        key = (purpose, kind, count)
        if self.free:
            memory = self.free
            self.free = self.e.address(memory, count, kind)
            return memory
        if key not in self.reserved:
            self.reserved[key] = self.e.reserve(kind, count)
        return self.reserved[key]

    @contextmanager
    def heap(self, doubles: int) -> Iterator[None]:
        """Take scratch memory from the heap inside, so many doubles; from the stack with none."""
        if not doubles:
            yield
            return
        memory = self.e.value(f"call ptr @malloc(i64 {8 * doubles})")
        self.free = memory
        yield
        self.free = ""
        self.e.do(f"call void @free(ptr {memory})")

    def entries(self, factor: Instruction) -> dict[tuple[int, int], str]:
        """Return the entries (i, j), i >= j, that are not identically zero."""
        n = factor.order
        found = {}
        for i in range(n):
            for j in range(i + 1):
                arg = factor.args[i * (i + 1) // 2 + j]
                one = self.program.instructions[arg]
                if one.op != "constant" or one.value != 0.0:
                    found[i, j] = self.ref(arg)
        return found

    def factor(self, i: int, instruction: Instruction) -> None:
        """Factor a matrix: written out if that is short, by the linear solver if not, in lanes when it is solved."""
        n, plan = instruction.order, self.program.eliminations[i]
        if plan.written_out:
            self.vectors[i] = llvm_ldl.factor(self.e, self.lanes, plan, self.entries(instruction))
        elif self.lanes == 1:
            matrix = self.matrix(instruction)
            self.values[i] = self.e.reserve("double", factor_size(n))
            self.singular.append(self.e.value(f"call i1 @factor_dense(i64 {n}, ptr {matrix}, ptr {self.values[i]})"))

    def matrix(self, factor: Instruction) -> str:
        """Write the lower triangle to memory, by columns, lanes innermost, and return its address."""
        n, zero = factor.order, number(0.0, self.lanes)
        entries = self.entries(factor)
        memory = self.scratch("matrix", self.kind, n * n)
        places = [(i, j) for j in range(n) for i in range(j, n)]
        if len(entries) * MOSTLY_ZERO < len(places):
            with self.e.loop(0, n * n) as index:
                self.e.put(zero, memory, index, self.kind)
            places = list(entries)
        for i, j in places:
            self.e.put(entries.get((i, j), zero), memory, j * n + i, self.kind)
        return memory

    def solve(self, i: int, instruction: Instruction) -> None:
        """Solve a system with a factored matrix."""
        factor, plan = self.program.instructions[instruction.args[0]], self.program.eliminations[instruction.args[0]]
        n = instruction.order
        right = [self.ref(arg) for arg in instruction.args[1:]]
        if plan.written_out:
            *entries, trusted = self.vector(instruction.args[0])
            x = llvm_ldl.solve(self.e, self.lanes, plan, llvm_ldl.by_place(plan, entries), right)
            (self.vectors[i],) = self.with_pivoting(factor, trusted, [x], [right])
            return
        memory = self.scratch("right", self.kind, n)
        for k, value in enumerate(right):
            self.e.put(value, memory, k, self.kind)
        if self.lanes == 1:
            factors = self.ref(instruction.args[0])
            self.e.do(f"call void @solve_factored(i64 {n}, ptr {factors}, ptr {memory})")
        else:
            self.singular.append(self.solve_lanes(n, self.matrix(factor), memory))
        self.vectors[i] = [self.e.get(memory, k, self.kind) for k in range(n)]

    def solve_lanes(self, n: int, matrix: str, right: str, count: int = 1) -> str:
        """Solve the systems of all lanes in memory, so many in each, and return whether one is singular."""
        work = self.scratch("work", "double", work_size(n))
        arguments = f"i64 {n}, i64 {self.lanes}, i64 {count}, ptr {matrix}, ptr {right}, ptr {work}"
        return self.e.value(f"call i1 @solve_lanes({arguments})")

    def solve_pivoted(self, factor: Instruction, plan: Elimination, right: str, count: int) -> str:
        """Solve sparse systems in memory, rows by `ranks` of the plan; return whether a matrix is singular."""
        e, zero, size = self.e, number(0.0, self.lanes), band_size(plan.order, plan.band)
        matrix, work = self.scratch("band", self.kind, size), self.scratch("work", "double", pivoted_work_size(plan))
        with e.loop(0, size) as index:
            e.put(zero, matrix, index, self.kind)
        for (i, j), entry in self.entries(factor).items():
            e.put(entry, matrix, plan.band_place(i, j), self.kind)
        numbers = f"i64 {plan.order}, i64 {self.lanes}, i64 {count}, i64 {plan.band}"
        return e.value(f"call i1 @solve_lanes_pivoted({numbers}, ptr {matrix}, ptr {right}, ptr {work})")

    def with_pivoting(
        self, factor: Instruction, trusted: str, x: Sequence[list[str]], right: Sequence[list[str]]
    ) -> list[list[str]]:
        """Return the solutions x for some right-hand sides where all pivots could be trusted, else those with pivoting.

        All must be known by now: both ways meet behind the branch.
        """
        e, kind, n, count = self.e, self.kind, factor.order, len(right)
        name = e.fresh("pivot")
        every = trusted = self.satisfied(factor, trusted, x, right)
        if self.lanes > 1:
            bits = e.value(f"bitcast {flag_type(self.lanes)} {trusted} to i{self.lanes}")
            every = e.value(f"icmp eq i{self.lanes} {bits}, -1")
        before = e.block
        e.do(f"br i1 {every}, label %{name}.join, label %{name}.cold, !prof !0")
        e.label(f"{name}.cold")
        known = dict(self.values)  # values loaded on the cold path are not known on the other
        plan = self.program.eliminations[self.by_code[factor]]
        size = self.lanes * (band_size(n, plan.band) + count * n) + pivoted_work_size(plan)
        with self.heap(size if size > LARGEST_ON_STACK else 0):
            memory = self.scratch("right", kind, count * n)
            places = [k * n + rank for k in range(count) for rank in plan.ranks]
            for place, value in zip(places, chain(*right), strict=True):
                e.put(value, memory, place, kind)
            if plan.negative:
                singular = self.solve_pivoted(factor, plan, memory, count)
            else:
                # A lane whose matrix is definite keeps its factors without pivoting, whatever its units.
                singular = self.solve_lanes(n, self.matrix(factor), memory, count)
            slow = [e.get(memory, place, kind) for place in places]
        self.values = known
        cold = e.block
        e.jump(f"{name}.join")
        e.label(f"{name}.join")
        bad = e.value(f"phi i1 [ false, %{before} ], [ {singular}, %{cold} ]")
        self.singular.append(bad)
        found = [
            e.value(f"phi {kind} [ {a}, %{before} ], [ {b}, %{cold} ]") for a, b in zip(chain(*x), slow, strict=True)
        ]
        return [found[k * n : (k + 1) * n] for k in range(count)]

    def satisfied(self, factor: Instruction, trusted: str, x: Sequence[list[str]], right: Sequence[list[str]]) -> str:
        """Return whether pivots are trusted, and the rows of multipliers satisfied by every solution."""
        plan = self.program.eliminations[self.by_code[factor]]
        if not plan.negative:
            return trusted
        entries = self.entries(factor)
        for solution, wanted in zip(x, right, strict=True):
            for good in llvm_ldl.satisfied(self.e, self.lanes, plan, entries, solution, wanted):
                trusted = self.e.value(f"and {flag_type(self.lanes)} {trusted}, {good}")
        return trusted

    def status(self) -> str:
        """Return 1 if any matrix was singular."""
        if not self.singular:
            return "0"
        total = self.singular[0]
        for other in self.singular[1:]:
            total = self.e.value(f"or i1 {total}, {other}")
        return self.e.value(f"zext i1 {total} to i32")
