"""Build and invert the matrix of Newton's method for the equations of an implicit step.

The law is the function that the step evaluates, such as the right-hand side. A residual of the equations is a linear
combination of the unknown vectors z_j and of results of the law. Each call c of the law has a linear combination of the
z_j as its argument.

The derivative of residual i by z_j is the block beta_ij I + g_ij J. beta_ij is the factor of z_j in the residual. J is
the derivative of the law at one point. g_ij is the sum, over all calls c, of the factor of the result of c in residual
i, times the factor of z_j in the argument of c.

A law of momenta has two results and two arguments. Its J then has four blocks (result, argument), each with its own
g_ij. A law with constraints has five results and three arguments, hence fifteen blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.linear.gauss_jordan import invert_matrix, row_stride
from lagrange.algorithm.step.memory import Layout, Running, SolveLayout, running
from lagrange.algorithm.step.vectors import StepVectors, copy_vector, vectors_of
from lagrange.graph.node import Node
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import In, Out, each, fma, reals, unrolled
from lagrange.program.step import LAWS, Combination, LawCall

UNIT_ROUND_OFF, LEAST_ROUND_OFF = 2.0**-52, 1e-100
"""`UNIT_ROUND_OFF`: the unit of rounding, in which corrections of fixed steps are measured. `LEAST_ROUND_OFF` is added
to the estimated rounding error of an unknown. So an unknown that is zero, such as a coordinate at rest, has a finite
weight.
"""

INERTIA = {"momentum": (((0, 1),),), "constrained": (((0, 1), (2, 2)), ((4, 1), (4, 2)))}
"""Matrix that must not be singular, by the name of a law of momenta. It is stated as rows of blocks (result, argument)
of the law's derivative. The matrix is M = dp/dv. With constraints it is [[M, G^T], [G, 0]], and multipliers that only
pad a vector have ones on its diagonal.
"""


class MatrixCoefficients:
    """The coefficients beta and g of the Newton matrix of a step's equations, by rows (residual, unknown).

    The matrix has the block beta I + g J for each residual and unknown, where J is the derivative of the law,
    the function that the step evaluates. Each coefficient is a node: a formula that is evaluated in each step.
    """

    def __init__(self, layout: Layout, solve: SolveLayout) -> None:
        stated, law, zero = solve.solve, LAWS[layout.step.law], layout.step.graph.zero

        def factor(combination: Combination, vector: int) -> Node:
            return dict(combination).get(vector, zero)

        def product(residual: Combination, r: int, s: int, z: int) -> Node:
            factors = [(factor(residual, call.first + r), factor(call.arguments[s], z)) for call in stated.calls]
            return sum((outer * inner for outer, inner in factors), zero)

        pairs = [(residual, stated.first + j) for residual in stated.residuals for j in range(stated.count)]
        self.identity = [factor(residual, z) for residual, z in pairs]
        """Factor beta of each unknown vector in each residual, by rows (residual, unknown)."""

        blocks = {
            (r, s): [product(residual, r, s, z) for residual, z in pairs]
            for r in range(law.results)
            for s in range(law.arguments)
        }
        self.blocks = {block: nodes for block, nodes in blocks.items() if any(node is not zero for node in nodes)}
        """Factors g for each block (result, argument) of the derivative that occurs in some residual."""

        self.shares = [
            [factor(residual, call.first + r) for call in stated.calls]
            for residual in stated.residuals
            for r in range(law.results)
        ]
        """The factor of each result of each call in each residual, by rows (residual, result)."""

        middle = stated.calls[(len(stated.calls) - 1) // 2]
        self.point: LawCall | None = None if solve.adaptive and law.arguments <= law.states else middle
        """The call at which the law is differentiated, or None for the start of the step."""

    @property
    def nodes(self) -> list[Node]:
        """All coefficients of the matrix, and the factors of the law's results in the residuals, in one list."""
        return [node for nodes in (self.identity, *self.blocks.values(), *self.shares) for node in nodes]


@procedure(noinline=True, arguments=running)
def build_matrix(arguments: Running, t: float, h: float, *, layout: Layout, solve: SolveLayout) -> Outcome:
    """Compute the inverse Newton matrix for steps of length h, and store it in the work array.

    The derivative of the law is read from memory if it is valid, else evaluated. Return DONE, or SINGULAR for a
    singular matrix.
    """
    work, newton, terms = arguments.work, arguments.newtons[solve.index], MatrixCoefficients(layout, solve)
    inverse, point, nodes = work[solve.inverse :], terms.point, [*terms.nodes, *[damp.factor for damp in solve.damped]]
    calls = [] if point is None else [point]
    vectors = vectors_of(arguments, t, h, layout, calls, solve.solve.residuals, nodes)
    matrix = Matrix(layout, solve, work[solve.matrix :], work[solve.derivative :], work[solve.pivots :])
    # Gradients of constraints turn from step to step: with an old derivative more corrections are needed.
    if (solve.adaptive and point is not None) or newton.differentiated == 0:
        if evaluate_derivative(vectors, t, matrix.entries, point):
            return Outcome.SINGULAR
        for a in range(layout.rows):
            for b in range(layout.columns):
                matrix.derivative[b * layout.rows + a] = matrix.entries[a * layout.columns + b]
        newton.differentiated = 1
    identity = table(vectors, terms.identity)
    matrix.fill(identity, [(r, s, table(vectors, factors)) for (r, s), factors in terms.blocks.items()])
    is_singular = invert_matrix(matrix.entries, matrix.pivots, n=solve.unknowns)
    for column in range(solve.unknowns):
        for i in range(solve.solve.count):
            row = matrix.entries[column * solve.stride + i * solve.length :]
            matrix.keep(row, inverse[column * solve.all + i * solve.width :])
    if layout.step.law in INERTIA and is_singular and matrix.inertia_is_singular(INERTIA[layout.step.law]):
        return Outcome.SINGULAR
    for damp in solve.damped:
        matrix.write_damper(vectors.numbers[damp.factor], work[solve.damper(damp) :])
    if point is not None and not solve.adaptive:
        weigh_by_rounding(vectors, solve, point, terms.shares)
        newton.rate = 1.0
        newton.noise = 1.0
        newton.age = 0
    newton.matrix_step = h
    return Outcome.DONE


@inline
def evaluate_derivative(vectors: StepVectors, t: float, out: Out, point: LawCall | None) -> bool:
    """Write the derivative of the law by its arguments to `out`, by rows. Return True if a matrix is singular.

    The derivative is evaluated at the arguments of the call `point`. If `point` is None, it is evaluated at the
    start of the step, at time t.
    """
    running, layout = vectors.running, vectors.layout
    if point is None:
        time, arguments = t, running.work[layout.argument :]
        for i in unrolled(layout.step.states):
            copy_vector(vectors.at(i), arguments[i * layout.length :], layout.width)
    else:
        time, arguments = vectors.numbers[point.time], vectors.arguments(point)
    is_singular: bool = running.jacobian(time, arguments, running.constants, out)
    return is_singular


@inline
def table(vectors: StepVectors, nodes: Sequence[Node]) -> Out:
    """Return an array with the present values of the coefficients `nodes`, in their order."""
    values = reals(len(nodes))
    for i, node in enumerate(nodes):
        values[i] = vectors.numbers[node]
    return values


@dataclass(frozen=True)
class Matrix:
    """The matrix of Newton's method, by rows in the work array, and the derivative of the law, by columns."""

    layout: Layout
    solve: SolveLayout
    entries: Out
    derivative: Out
    pivots: Out

    @inline
    def line(self, column: int, r: int, s: int) -> In:
        """Return column number `column` of block (r, s), the derivative of the law's result r by argument s."""
        length = self.solve.length
        return self.derivative[(column + s * length) * self.layout.rows + r * length :]

    @inline
    def keep(self, row: In, target: Out) -> None:
        """Copy a part of a row of the inverse to `target`, padded with zeros to whole blocks.

        `row` begins at this part, which has as many entries as a vector of unknowns.
        """
        solve = self.solve
        for a in each(solve.width, spill=True, disjoint=True):
            entry = row[a]
            target[a] = entry if solve.width == solve.length or a < solve.length else 0.0

    @inline
    def fill(self, identity: In, blocks: Sequence[tuple[int, int, In]]) -> None:
        """Write the negative Newton matrix to `entries`, transposed: rows of its inverse are stored as columns.

        `identity` has the factors beta by rows (residual, unknown). `blocks` has (result, argument, factors g)
        for each block of the derivative of the law. The last vector of a part of a row may overwrite the start
        of the next part, which is written later.
        """
        solve, count, length = self.solve, self.solve.solve.count, self.solve.length
        for j in range(count):
            for b in range(length):
                for i in range(count):
                    pair = i * count + j
                    diagonal = -identity[pair]
                    row = self.entries[(j * length + b) * solve.stride + i * length :]
                    lines = [(-factors[pair], self.line(b, r, s)) for r, s, factors in blocks]
                    for a in each(solve.width, spill=True, disjoint=True):
                        value = diagonal if a == b else 0.0
                        for factor, line in lines:
                            value = fma(factor, line[a], value)
                        row[a] = value

    @inline
    def inertia_is_singular(self, blocks: Sequence[Sequence[tuple[int, int]]]) -> bool:
        """Return True if the mass matrix is singular. It consists of blocks of the derivative of the law.

        `blocks` has the pair (result, argument) of the law for each block, by rows. `entries` is overwritten.
        """
        length, order = self.solve.length, len(blocks) * self.solve.length
        for i, line in enumerate(blocks):
            for j, (r, s) in enumerate(line):
                for a in range(length):
                    for b in range(length):
                        index = (i * length + a) * row_stride(order) + j * length + b
                        self.entries[index] = self.line(b, r, s)[a]
        return invert_matrix(self.entries, self.pivots, n=order)

    @inline
    def write_damper(self, factor: float, target: Out) -> None:
        """Write (I - factor J)^-1 to `target` by columns, with J the derivative of the right-hand side."""
        solve, length, stride = self.solve, self.solve.length, row_stride(self.solve.length)
        for b in range(length):
            row, line = self.entries[b * stride :], self.line(b, 0, 0)
            for a in each(solve.width, spill=True, disjoint=True):
                row[a] = fma(-factor, line[a], 1.0 if a == b else 0.0)
        invert_matrix(self.entries, self.pivots, n=length)
        for b in range(length):
            self.keep(self.entries[b * stride :], target[b * solve.width :])


@inline
def weigh_by_rounding(
    vectors: StepVectors, solve: SolveLayout, point: LawCall, factors: Sequence[Sequence[Node]]
) -> None:
    """Set the weight of each unknown in the norm of corrections: 1 over the rounding error of the unknown.

    No iteration can reduce this error. The magnitudes of the terms of a residual, plus |J| times the magnitudes of
    the arguments of the call `point`, give the rounding error of the residual. The inverse of the matrix maps it to
    the unknowns. `factors` has for each pair (residual, result of the law) the factors of that result in the
    residual, one for each call.
    """
    work, rows, length, width = vectors.running.work, vectors.layout.rows, solve.length, solve.width
    count, law, shares = solve.solve.count, LAWS[vectors.layout.step.law], reals(len(factors))
    sizes, argument_sizes, derivative = work[solve.sizes :], work[solve.places :], work[solve.derivative :]
    for k, residual in enumerate(solve.solve.residuals):
        vectors.combine(residual, sizes[k * width :], sizes=True)
    for k, argument in enumerate(point.arguments):
        vectors.combine(argument, argument_sizes[k * width :], sizes=True)
    for k, nodes in enumerate(factors):
        share = 0.0
        for node in nodes:
            share += abs(vectors.numbers[node])
        shares[k] = share
    for i in range(count):
        for r in range(law.results):
            share = shares[i * law.results + r]
            for a in range(length):
                total = sizes[i * width + a]
                for s in range(law.arguments):
                    for b in range(length):
                        entry = abs(derivative[(s * length + b) * rows + r * length + a])
                        total = fma(share, entry * argument_sizes[s * width + b], total)
                sizes[i * width + a] = total
    inverse, weights = work[solve.inverse :], work[solve.weights :]
    for i in range(count):
        for a in range(length):
            row = i * width + a
            moved = 0.0
            for j in range(count):
                for b in range(length):
                    entry = abs(inverse[(j * length + b) * solve.all + row])
                    moved = fma(entry, sizes[j * width + b], moved)
            weights[row] = 1.0 / fma(moved, UNIT_ROUND_OFF, LEAST_ROUND_OFF)
