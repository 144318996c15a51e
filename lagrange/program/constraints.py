"""Programs of constraints: the projection of a state onto them, and equations for methods with unknown multipliers.

The projection makes the least change in the metric of the mass matrix. One Newton step from (q, v): dq minimises
dq^T M dq / 2 with phi + (dphi/dq) dq = 0, and dv minimises dv^T M dv / 2 with psi + (dpsi/dq) dq + G dv = 0. Both are
solved with the matrix of the accelerations, [[M, G^T], [G, 0]], which is factored once. A constraint on velocities
determines no coordinates: dq is a displacement that it admits.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, section VII.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import reduce

from lagrange.equations.constraints import ConstraintEquations
from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node, substitute
from lagrange.graph.term_size import term_sizes
from lagrange.program.lower import Named
from lagrange.statement.space import conjugate, length_excess, product

LEAST_TERM_SIZE = Fraction(1, 2**1000)
"""Added to the sizes of terms, so that a violation is zero if all its terms are zero."""


def constraint_positions(constraints: ConstraintEquations) -> list[Node]:
    """Return phi of each constraint phi(q, t) = 0; zero for those that are stated as equations of velocities."""
    pairs = zip(constraints.positions, constraints.velocities, strict=True)
    return [psi.graph.zero if phi is None else phi for phi, psi in pairs]


def projection(equations: Equations) -> Named:
    """Return the nodes of the corrections [dq, dv] that move a state onto the constraints, and of two error measures.

    The violation is the error before the correction: the largest |phi| or |psi|, relative to the size of its terms.
    The remainder estimates the error after it: the sum over all constraints of the second-order terms along the
    corrections, again relative to the sizes of terms. Near a configuration with dependent constraints the corrections
    are large, and the remainder may exceed the violation. That quaternions have length one counts as a constraint.

    Some constraints may be relations that determine the velocities of coordinates of first order. Then a second
    violation follows, that of the other constraints alone.
    """
    graph, held = equations.graph, equations.constraints
    n, zero = len(equations.q), equations.graph.zero
    phi, (lengths, rates) = constraint_positions(held), _lengths(equations)
    dq, dv = ([graph.symbol(f"correction {what} {i}", Binding.ACCELERATION) for i in range(n)] for what in ("q", "v"))
    moved = list(equations.plan.solved(equations.matrix, [*[zero] * n, *(-residual for residual in phi)])[:n])
    _restore(equations, moved, [excess / 2 for excess in lengths])
    known = dict(zip(dq, moved, strict=True))
    along = tangents([*held.velocities, *rates], dict(zip(equations.q, dq, strict=True)))
    missing = [graph.sum([(-1, psi), (-1, along(psi))]) for psi in held.velocities]
    turned = list(equations.plan.solved(equations.matrix, [*[zero] * n, *substitute(missing, known)])[:n])
    _restore(equations, turned, substitute([rate + along(rate) for rate in rates], known))
    known |= dict(zip(dv, turned, strict=True))

    positions = [value for value in phi if value is not zero]
    velocities = [value for value in held.velocities if value is not zero]
    values = [*lengths, *positions, *rates, *velocities]
    direction = dict(zip((*equations.q, *equations.v), (*dq, *dv), strict=True))
    first = tangents(values, direction)
    slopes = list(map(first, values))
    second = tangents(slopes, direction)
    left = substitute([graph.sum([(Fraction(1, 2), second(slope))]) for slope in slopes], known)
    # At rest the terms of velocity constraints are only rounding: add the sizes of their changes.
    added = substitute(term_sizes(slopes[len(lengths) + len(positions) :]), known)
    coordinates_alone = [*([graph.one] * len(lengths)), *term_sizes(positions)]
    speeds = [graph.sum([(1, graph.call("abs", equations.v[i])) for i in rows]) for rows in equations.quaternions]
    sizes = [*coordinates_alone, *speeds, *term_sizes(velocities)]
    count = len(coordinates_alone)
    later = [*sizes[:count], *(size + more for size, more in zip(sizes[count:], added, strict=True))]
    shares, rest = _shares(values, sizes), _shares(left, later)

    def worst(of: Sequence[Node]) -> Node:
        return reduce(lambda a, b: graph.call("max", a, b), of, zero)

    # A sum instead of a maximum: it is NaN if one of its terms is NaN.
    remainder = graph.sum([(1, share) for share in rest])
    results = {"coordinates": moved, "velocities": turned, "violation": [worst(shares)], "remainder": [remainder]}
    relations = len(equations.first_order)
    return results | {"stated": [worst(shares[:-relations])]} if relations else results


def _lengths(equations: Equations) -> tuple[list[Node], list[Node]]:
    """Return |q|**2 - 1 and half of its rate of change, q . v, for the quaternion q of each rotation."""
    bodies = [[[part[i] for i in rows] for part in (equations.q, equations.v)] for rows in equations.quaternions]
    return [length_excess(q) for q, _ in bodies], [product(conjugate(q), v)[0] for q, v in bodies]


def _restore(equations: Equations, corrections: list[Node], errors: Sequence[Node]) -> None:
    """Change the corrections of coordinates, or of velocities, along each quaternion q so that they cancel `errors`.

    An error is what the product of q with the correction must cancel. The length of q is nearly one, and physics does
    not depend on it: forces and constraints do not change.
    """
    graph = equations.graph
    for rows, error in zip(equations.quaternions, errors, strict=True):
        q = [equations.q[i] for i in rows]
        along = graph.sum([(1, error), *((1, x * corrections[i]) for x, i in zip(q, rows, strict=True))])
        for x, i in zip(q, rows, strict=True):
            corrections[i] = graph.sum([(1, corrections[i]), (-1, along * x)])


def _shares(values: Sequence[Node], sizes: Sequence[Node]) -> list[Node]:
    """Return the nodes |value| / size for the constraint `values` and the `sizes` of their terms."""
    graph = values[0].graph
    return [graph.call("abs", value) / (size + LEAST_TERM_SIZE) for value, size in zip(values, sizes, strict=True)]


def multiplier_symbols(equations: Equations) -> list[Node]:
    """Return the symbols of n multipliers: one for each of the m constraints, then n - m for padding."""
    return [equations.graph.symbol(f"multiplier {i}", Binding.ACCELERATION) for i in range(len(equations.q))]


def constrained_inputs(equations: Equations) -> dict[str, Sequence[Node]]:
    """Return the input nodes of the program `constrained` by name: the state [q, v], then n multipliers lambda."""
    return {**equations.state, "multipliers": multiplier_symbols(equations)}


def constrained(equations: Equations) -> Named:
    """Return the nodes of p, f, G^T lambda, phi and psi, n of each, for methods whose unknowns are the multipliers.

    These are the momenta, the forces, the constraint forces, the constraints and their rates of change. The m
    multipliers and constraints are padded to n entries. A padding entry of the constraints is the padding multiplier
    itself. A step makes all entries zero, hence also the padding multipliers, and the matrix of Newton's method is
    square and regular. A constraint on velocities has no phi: its multiplier takes the place of phi. Momenta and
    forces are those of the solved form, whose mass matrix is regular.
    """
    held, multipliers = equations.constraints, multiplier_symbols(equations)
    count = len(held)
    pushed = held.forces(multipliers[:count]) if count else [equations.graph.zero] * len(equations.q)
    positions = [
        multiplier if phi is None else phi for phi, multiplier in zip(held.positions, multipliers, strict=False)
    ]
    return {
        "momenta": equations.motion.momenta,
        "forces": equations.motion.forces,
        "constraint_forces": pushed,
        "positions": [*positions, *multipliers[count:]],
        "velocities": [*held.velocities, *multipliers[count:]],
    }


def constrained_jacobian(equations: Equations) -> Named:
    """Return the nodes of d[p, f, c, phi, psi] / d[q, v, lambda] by rows, (5n, 3n).

    These are the momenta p, the forces f, the constraint forces c = G^T lambda, the constraints phi and their rates
    of change psi, padded to n entries each.
    """
    rows = [node for block in constrained(equations).values() for node in block]
    symbols = [symbol for block in constrained_inputs(equations).values() for symbol in block]
    columns = [tangents(rows, {symbol: equations.graph.one}) for symbol in symbols]
    return {"constrained_jacobian": [column(row) for row in rows for column in columns]}
