"""Emit systems with one factored matrix together: right-hand sides side by side in memory, or one test of pivots."""

from __future__ import annotations

from collections.abc import Iterable

from lagrange.machine.kernel import llvm_ldl
from lagrange.machine.kernel.llvm_body import Body
from lagrange.machine.llvm.spelling import element
from lagrange.procedure.blocks import whole_blocks
from lagrange.procedure.linear.ldl import COLUMNS_AT_ONCE, solve_columns
from lagrange.program.solve_groups import SolveGroup, scheduled

LARGEST_GROUP = 32
"""Most systems that are solved together: four vectors of eight reals for each row. It bounds the memory they take."""

MOST_JOINED = 32
"""Most entries of solutions that are written out and meet behind one test of pivots: all of them are live there."""


class GroupedSolves:
    """Emits instructions of a body."""

    def __init__(self, body: Body) -> None:
        self.body, self.e = body, body.e
        self.solutions: dict[int, list[str]] = {}
        """Solutions of systems that are written out, before the pivots are tested."""
        self.columns: dict[int, tuple[str, range]] = {}
        """Where solutions stand that are loaded entry by entry: an array and its indices."""

    def run(self, refs: Iterable[int]) -> None:
        """Emit some instructions, each after those that it reads."""
        code, refs = self.body.program.instructions, list(refs)
        steps = scheduled(self.body.program, refs, self.most)
        groups = {i: step for step in steps if isinstance(step, SolveGroup) for i in step.solves}
        if not groups:
            self.body.run(refs)
            return
        for step in steps:
            if isinstance(step, SolveGroup):
                self.solve(step)
            elif step in groups:
                self.gather(step, groups[step])
            elif code[step].op == "component" and code[step].args[0] in self.columns:
                memory, places = self.columns[code[step].args[0]]
                self.body.held[step] = memory, places[code[step].place]
            else:
                self.body.run([step])

    def most(self, factor: int) -> int:
        """Return how many systems with a factor are solved together at most."""
        plan = self.body.program.eliminations[factor]
        if not plan.written_out:
            return LARGEST_GROUP
        return MOST_JOINED // plan.order if self.body.lanes == 1 else 1

    def written_out(self, group: SolveGroup) -> bool:
        """Return whether the matrix of a group is eliminated by operations one by one."""
        return self.body.program.eliminations[group.factor].written_out

    def right(self, i: int) -> list[str]:
        """Return a right-hand side."""
        return [self.body.ref(arg) for arg in self.body.program.instructions[i].args[1:]]

    def gather(self, i: int, group: SolveGroup) -> None:
        """Emit what can be done as soon as a right-hand side is known."""
        body, right = self.body, self.right(i)
        if self.written_out(group):
            plan = body.program.eliminations[group.factor]
            *entries, _ = body.vector(group.factor)
            self.solutions[i] = llvm_ldl.solve(self.e, body.lanes, plan, llvm_ldl.by_place(plan, entries), right)
            return
        memory = self.memory_of(group)
        for place, value in zip(self.places(group, i), right, strict=True):
            self.e.put(value, memory, place, body.kind)
        self.e.cut()  # LLVM would mix the right-hand sides, and takes a third longer to compile that

    def places(self, group: SolveGroup, i: int) -> range:
        """Return where the entries of a right-hand side stand: by rows for one state, behind each other for many."""
        n, column = self.order(group), group.solves.index(i)
        if self.body.lanes > 1:
            return range(column * n, column * n + n)
        width = self.width(group)
        return range(column, column + n * width, width)

    def order(self, group: SolveGroup) -> int:
        """Return the order of the matrix."""
        return self.body.program.instructions[group.factor].order

    def width(self, group: SolveGroup) -> int:
        """Return how many columns there is memory for: whole vectors of them for one state."""
        count = len(group.solves)
        return whole_blocks(count, COLUMNS_AT_ONCE) if self.body.lanes == 1 else count

    def memory_of(self, group: SolveGroup) -> str:
        """Return the memory of right-hand sides and solutions, which is the group's own where these stay there."""
        owner = group.solves[0] if self.body.lanes == 1 else group.factor
        return self.body.scratch(f"columns {owner}", self.body.kind, self.order(group) * self.width(group))

    def solve(self, group: SolveGroup) -> None:
        """Solve the systems of a group."""
        body = self.body
        factor = body.program.instructions[group.factor]
        if self.written_out(group):
            x, right = [self.solutions.pop(i) for i in group.solves], [self.right(i) for i in group.solves]
            found = body.with_pivoting(factor, body.vector(group.factor)[-1], x, right)
            body.vectors |= dict(zip(group.solves, found, strict=True))
            return
        memory = self.memory_of(group)
        if body.lanes == 1:
            self.solve_columns(group, memory)
            self.columns |= {i: (memory, self.places(group, i)) for i in group.solves}
            return
        body.singular.append(body.solve_lanes(factor.order, body.matrix(factor), memory, len(group.solves)))
        for i in group.solves:
            body.vectors[i] = [self.e.get(memory, place, body.kind) for place in self.places(group, i)]

    def solve_columns(self, group: SolveGroup, memory: str) -> None:
        """Solve the systems of one state, as lanes of vectors; the lanes that are left over are zero."""
        e, n, count, width = self.e, self.order(group), len(group.solves), self.width(group)
        if count < width:
            for k in range(n):
                e.store("zeroinitializer", e.address(memory, k * width + count), element(width - count))
        solver = self.body.name_of(solve_columns())
        spare, factors = self.body.scratch("spare", "double", n), self.body.ref(group.factor)
        e.do(f"call void @{solver}(i64 {n}, i64 {width}, ptr {factors}, ptr {memory}, ptr {spare})")
