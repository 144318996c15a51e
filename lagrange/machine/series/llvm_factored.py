"""A sparse matrix of a stage, factored once per step and solved with at every order; both are written out.

Memory for a block of n unknowns: L by `places`, and where its pivots cannot be trusted the factors with pivoting
in their place, then the matrix and a right-hand side.
"""

from __future__ import annotations

from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.llvm.emitter import literal
from lagrange.machine.series.llvm_start import LlvmStart
from lagrange.procedure.linear.pivoted import band_size, factor_pivoted, pivoted_size, solve_pivoted
from lagrange.program.elimination import Elimination, block_eliminations


def factored_size(plan: SolvePlan) -> int:
    """Return how many doubles the factors of a stage take, with what is needed on the way to them."""
    return sum(_size(block) for block in block_eliminations(plan))


def _size(block: Elimination) -> int:
    n, band = block.order, block.band
    return len(block.places) + pivoted_size(n, band) + int(band_size(n, band)) + n


class FactoredStage:
    """The factors of a stage's matrix in memory from an address on."""

    def __init__(
        self, body: LlvmStart, plan: SolvePlan, entries: list[dict[tuple[int, int], str]], memory: str
    ) -> None:
        self.body, self.e, self.plan = body, body.e, plan
        self.blocks = []
        for block, elimination, lower in zip(plan.blocks, block_eliminations(plan), entries, strict=True):
            self.blocks.append(_FactoredBlock(body, block, elimination, lower, memory))
            memory = self.e.address(memory, _size(elimination))
        self.end = memory

    def solve(self, right: str) -> None:
        """Replace a right-hand side in memory, in the order of the unknowns, by the solution."""
        for block in self.blocks:
            block.solve(right)


class _FactoredBlock:
    """The factors of one block."""

    def __init__(
        self,
        body: LlvmStart,
        unknowns: tuple[int, ...],
        plan: Elimination,
        lower: dict[tuple[int, int], str],
        memory: str,
    ) -> None:
        self.body, self.e, self.unknowns, self.plan = body, body.e, unknowns, plan
        e, n, band = body.e, plan.order, plan.band
        self.memory, self.places = memory, {place: k for k, place in enumerate(plan.places)}
        self.factors = e.address(memory, len(plan.places))
        matrix = e.address(self.factors, pivoted_size(n, band))
        self.right = e.address(matrix, band_size(n, band))
        found, self.trusted = body.factor(plan, lower)
        for k, value in enumerate(found):
            e.put(value, memory, k)
        e.put(literal(0.0), self.right, 0)
        with e.when(e.value(f"xor i1 {self.trusted}, true")):
            with e.loop(0, band_size(n, band)) as index:
                e.put(literal(0.0), matrix, index)
            for (i, j), value in lower.items():
                e.put(value, matrix, plan.band_place(i, j))
            arguments = f"i64 {n}, i64 {band}, ptr {matrix}, ptr {self.factors}"
            singular = e.value(f"call i1 @{body.name_of(factor_pivoted.form())}({arguments})")
            e.put(e.value(f"uitofp i1 {singular} to double"), self.right, 0)
        body.singular.append(e.value(f"fcmp une double {e.get(self.right, 0)}, {literal(0.0)}"))

    def entry(self, i: int, j: int) -> str:
        """Return an entry of L, read where it is used: they are more than there are registers."""
        return self.e.get(self.memory, self.places[i, j])

    def solve(self, right: str) -> None:
        """Solve with one of the two kinds of factors; see `FactoredStage`."""
        e, n = self.e, self.plan.order
        name = e.fresh("solve")
        e.do(f"br i1 {self.trusted}, label %{name}.ordered, label %{name}.pivoted, !prof !0")
        e.label(f"{name}.ordered")
        given = [e.get(right, unknown) for unknown in self.unknowns]
        for unknown, value in zip(self.unknowns, self.body.solve(self.plan, self.entry, given), strict=True):
            e.put(value, right, unknown)
        e.jump(f"{name}.end")
        e.label(f"{name}.pivoted")
        places = list(zip(self.plan.ranks, self.unknowns, strict=True))
        for rank, unknown in places:
            e.put(e.get(right, unknown), self.right, rank)
        arguments = f"i64 {n}, i64 {self.plan.band}, ptr {self.factors}, ptr {self.right}"
        e.do(f"call void @{self.body.name_of(solve_pivoted.form())}({arguments})")
        for rank, unknown in places:
            e.put(e.get(self.right, rank), right, unknown)
        e.jump(f"{name}.end")
        e.label(f"{name}.end")
