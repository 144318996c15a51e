"""The matrix of Newton's method: built from the derivative of the law, and inverted.

With unknowns z_j and the calls c of a solve, the derivative of residual i by unknown j is beta_ij I + g_ij J. J is the
derivative of the law at one point, and g_ij is the sum over c of the factor of c in residual i times that of z_j in the
argument of c. A law of momenta has J in four blocks, each with its own g, and one of constraints has it in fifteen.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.algorithm.linear.gauss_jordan import inversion, row_stride
from lagrange.algorithm.newton.rounding import weigh_by_rounding
from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.memory import Layout, SolveLayout
from lagrange.algorithm.step.vectors import Given, Vectors
from lagrange.graph.node import Node
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import WHOLE, Procedure
from lagrange.procedure.values import Flag, Memory, Real, Whole
from lagrange.program.actions import LAWS, Combination, LawCall, Solve


def build_matrix(layout: Layout, solve: SolveLayout, prefix: str) -> Procedure:
    """Return the construction of the matrix of a step, with the known derivative of the law or a new one."""
    return _MatrixBuilder(layout, solve, prefix).build()


def factor_of(combination: Combination, vector: int) -> Node | None:
    """Return the factor of a vector in a combination, or None."""
    return next((factor for i, factor in combination if i == vector), None)


def coefficients(layout: Layout, solve: Solve) -> tuple[list[Node], list[Node]]:
    """Return beta by rows (i, j), and g by rows (i, j, result, argument)."""
    zero, law = layout.step.graph.zero, LAWS[layout.step.law]
    unknowns = range(solve.first, solve.first + solve.count)
    identity = [factor_of(residual, z) or zero for residual in solve.residuals for z in unknowns]
    factors = []
    for residual in solve.residuals:
        for z in unknowns:
            for result in range(law.results):
                for argument in range(law.arguments):
                    total = zero
                    for call in solve.calls:
                        outer = factor_of(residual, call.first + result)
                        inner = factor_of(call.arguments[argument], z)
                        total = total if outer is None or inner is None else total + outer * inner
                    factors.append(total)
    return identity, factors


def shares_of(layout: Layout, solve: Solve) -> list[Node]:
    """Return the factor of each result of each call in each residual, by rows (i, result, call)."""
    zero, results = layout.step.graph.zero, range(LAWS[layout.step.law].results)
    return [
        factor_of(residual, call.first + result) or zero
        for residual in solve.residuals
        for result in results
        for call in solve.calls
    ]


_INERTIA = {"momentum": (((0, 1),),), "constrained": (((0, 1), (2, 2)), ((4, 1), (4, 2)))}
"""The matrix that must be regular for a law to determine the motion: rows of blocks by result and argument.

It is M = dp/dv, and with constraints [[M, G^T], [G, 0]], which has ones on its diagonal where multipliers are padding.
"""


class _MatrixBuilder:
    """Builds the procedure. Matrices are in the work array, the derivative by columns."""

    def __init__(self, layout: Layout, solve: SolveLayout, prefix: str) -> None:
        self.p = p = Builder(
            f"{prefix}build_matrix{solve.index}",
            "Make the matrix of corrections anew, and return an outcome.",
            apart=True,
        )
        self.layout, self.solve, self.law = layout, solve, LAWS[layout.step.law]
        self.given = Given(p, layout, solve)
        stated = solve.solve
        middle = stated.calls[(len(stated.calls) - 1) // 2]
        given_by_state = self.law.arguments <= self.law.states
        self.point: LawCall | None = None if solve.adaptive and given_by_state else middle
        self.identity, self.factors = coefficients(layout, stated)
        self.shares = shares_of(layout, stated)
        blocks = [(r, s) for r in range(self.law.results) for s in range(self.law.arguments)]
        zero = layout.step.graph.zero
        used = [any(factor is not zero for factor in self.factors[k :: len(blocks)]) for k in range(len(blocks))]
        self.blocks = [(k, *block) for k, block in enumerate(blocks) if used[k]]
        """The number, the result and the argument of each block of the derivative that stands in a residual."""
        self.pairs = len(blocks)
        combined = [*stated.residuals, *(self.point.arguments if self.point else ())]
        nodes = [*self.identity, *self.factors, *self.shares, *(damp.factor for damp in solve.damped)]
        self.vectors = Vectors(self.given, combined, [*nodes, *([self.point.time] if self.point else [])])
        self.matrix = self.given.work.at(solve.matrix)
        self.derivative = self.given.work.at(solve.derivative)

    def build(self) -> Procedure:
        p, given, solve = self.p, self.given, self.solve
        newton = given.newton
        if self.point is not None and solve.adaptive:
            p.note("Gradients of constraints turn from step to step: a derivative of a step before costs corrections.")
            self.differentiate()
        else:
            with p.when(newton.differentiated.equals(0)):
                self.differentiate()
        self.fill(self.table(self.identity), self.table(self.factors))
        singular = self.invert(solve.unknowns)
        self.spread()
        if self.layout.step.law in _INERTIA:
            with p.when(singular):
                self.leave_if_inertia_singular(_INERTIA[self.layout.step.law])
        for damp in solve.damped:
            self.damper(self.vectors.numbers[damp.factor], given.work.at(solve.damper(damp)))
        if self.point is not None and not solve.adaptive:
            weigh_by_rounding(self.vectors, solve, self.point, self.table(self.shares, size=True))
            newton.rate = 1.0
            newton.noise = 1.0
            newton.age = 0
        newton.matrix_step = given.h
        p.leave(Outcome.DONE)
        return p.finish(WHOLE)

    def table(self, values: Sequence[Node], *, size: bool = False) -> Memory:
        """Return numbers of the step, or their absolute values, as an array."""
        memory = self.p.reserve(len(values))
        for i, value in enumerate(values):
            number = self.vectors.numbers[value]
            memory[i] = abs(number) if size else number
        return memory

    def differentiate(self) -> None:
        """Evaluate the derivative of the law: at the middle call of the residuals, or at the start of the step."""
        given, layout, rows, columns = self.given, self.layout, self.layout.rows, self.layout.columns
        if self.point is None:
            time, where = given.t, given.work.at(layout.argument)
            for i in range(layout.step.states):
                self.p.copy(self.vectors.at(i), where.at(i * layout.length), layout.width)
        else:
            time, where = self.vectors.numbers[self.point.time], self.vectors.arguments(self.point)
        failed = given.laws.jacobian(time, where, given.laws.constants, self.matrix)
        self.p.leave_if(failed, Outcome.SINGULAR)
        with self.p.loop(0, rows) as a, self.p.loop(0, columns) as b:
            self.derivative[b * rows + a] = self.matrix[a * columns + b]
        given.newton.differentiated = 1

    def line(self, column: Whole, r: int, s: int) -> Memory:
        """Return a column of a block of the derivative: of result r by argument s."""
        length = self.solve.length
        return self.derivative.at((column + s * length) * self.layout.rows + r * length)

    def fill(self, identity: Memory, factors: Memory) -> None:
        """Write the negative transposed matrix by rows; the rows of its inverse are the columns that are kept.

        The last block of a part may overwrite what follows, which is written later.
        """
        p, solve, count, length = self.p, self.solve, self.solve.solve.count, self.solve.length
        with p.loop(0, count) as j, p.loop(0, length) as b, p.loop(0, count) as i:
            pair = i * count + j
            own = [-factors[pair * self.pairs + k] for k, _, _ in self.blocks]
            one = -identity[pair]
            row = self.matrix.at((j * length + b) * solve.stride + i * length)
            lines = [self.line(b, r, s) for _, r, s in self.blocks]
            with p.each(solve.width, spill=True) as a:
                value = p.choose(a.equals(b), one, 0.0)
                for factor, line in zip(own, lines, strict=True):
                    value = p.fma(factor, line[a], value)
                row[a] = value

    def invert(self, order: int) -> Flag:
        """Invert the matrix in place; return whether it is singular."""
        singular = self.p.call(inversion(order), self.matrix, self.given.work.at(self.solve.pivots))
        return Flag.of(singular)

    def spread(self) -> None:
        """Write the inverse by padded columns: its product with a residual is the correction."""
        solve, inverse = self.solve, self.given.work.at(self.solve.inverse)
        with self.p.loop(0, solve.unknowns) as column, self.p.loop(0, solve.solve.count) as i:
            source = self.matrix.at(column * solve.stride + i * solve.length)
            self.keep_column(source, inverse.at(column * solve.all + i * solve.width))

    def keep_column(self, source: Memory, target: Memory) -> None:
        """Copy a column, padded with zeros to whole blocks."""
        p, solve = self.p, self.solve
        with p.each(solve.width, spill=True) as a:
            target[a] = source[a] if solve.width == solve.length else p.choose(a < solve.length, source[a], 0.0)

    def leave_if_inertia_singular(self, blocks: Sequence[Sequence[tuple[int, int]]]) -> None:
        """Leave if the matrix of these blocks of the derivative is singular, and not only the matrix of the step."""
        length, order = self.solve.length, len(blocks) * self.solve.length
        for i, line in enumerate(blocks):
            for j, (r, s) in enumerate(line):
                with self.p.loop(0, length) as a, self.p.loop(0, length) as b:
                    place = (i * length + a) * row_stride(order) + j * length + b
                    self.matrix[place] = self.line(b, r, s)[a]
        self.p.leave_if(self.invert(order), Outcome.SINGULAR)

    def damper(self, factor: Real, target: Memory) -> None:
        """Write (I - factor J)^-1 by columns."""
        p, solve, length, stride = self.p, self.solve, self.solve.length, row_stride(self.solve.length)
        with p.loop(0, length) as b:
            row, line = self.matrix.at(b * stride), self.line(b, 0, 0)
            with p.each(solve.width, spill=True) as a:
                row[a] = p.fma(-factor, line[a], p.choose(a.equals(b), 1.0, 0.0))
        self.invert(length)
        with p.loop(0, length) as b:
            self.keep_column(self.matrix.at(b * stride), target.at(b * solve.width))
