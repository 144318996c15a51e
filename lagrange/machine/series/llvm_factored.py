"""A sparse matrix of a stage, factored once per step and solved with at every order; both are written out.

Memory for a block of n unknowns: L by `places`, and where its pivots cannot be trusted the dense factors with pivoting
in their place, then the matrix, a right-hand side and n reals to work with.
"""

from __future__ import annotations

from lagrange.equations.solve_plan import SolvePlan
from lagrange.machine.kernel import llvm_ldl
from lagrange.machine.kernel.llvm_body import Body
from lagrange.machine.llvm.emitter import literal
from lagrange.procedure.linear.ldl import factor_dense, factor_size, solve_factored
from lagrange.program.elimination import Elimination, block_eliminations


def factored_size(plan: SolvePlan) -> int:
    """Return how many doubles the factors of a stage take, with what is needed on the way to them."""
    return sum(_size(block) for block in block_eliminations(plan))


def _size(block: Elimination) -> int:
    return len(block.places) + factor_size(block.order) + block.order**2 + 2 * block.order


class FactoredStage:
    """The factors of a stage's matrix in memory from an address on."""

    def __init__(self, body: Body, plan: SolvePlan, entries: list[dict[tuple[int, int], str]], memory: str) -> None:
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
        self, body: Body, unknowns: tuple[int, ...], plan: Elimination, lower: dict[tuple[int, int], str], memory: str
    ) -> None:
        self.body, self.e, self.unknowns, self.plan = body, body.e, unknowns, plan
        e, n = body.e, plan.order
        self.memory, self.places = memory, {place: k for k, place in enumerate(plan.places)}
        self.factors = e.address(memory, len(plan.places))
        matrix = e.address(self.factors, factor_size(n))
        self.right = e.address(matrix, n * n)
        *found, self.trusted = llvm_ldl.factor(e, 1, plan, lower)
        for k, value in enumerate(found):
            e.put(value, memory, k)
        e.put(literal(0.0), self.right, 0)
        with e.when(e.value(f"xor i1 {self.trusted}, true")):
            with e.loop(0, n * n) as index:
                e.put(literal(0.0), matrix, index)
            for (i, j), value in lower.items():
                e.put(value, matrix, j * n + i)
            arguments = f"i64 {n}, ptr {matrix}, ptr {self.factors}"
            singular = e.value(f"call i1 @{body.name_of(factor_dense())}({arguments})")
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
        for unknown, value in zip(self.unknowns, llvm_ldl.solve(e, 1, self.plan, self.entry, given), strict=True):
            e.put(value, right, unknown)
        e.jump(f"{name}.end")
        e.label(f"{name}.pivoted")
        for i, unknown in enumerate(self.unknowns):
            e.put(e.get(right, unknown), self.right, i)
        spare = e.address(self.right, n)
        arguments = f"i64 {n}, ptr {self.factors}, ptr {self.right}, ptr {spare}"
        e.do(f"call void @{self.body.name_of(solve_factored())}({arguments})")
        for i, unknown in enumerate(self.unknowns):
            e.put(e.get(self.right, i), right, unknown)
        e.jump(f"{name}.end")
        e.label(f"{name}.end")
