"""Quantities that a model offers, by name, as programs; programs of constraints, such as the projection onto them.

Each program is lowered from the equations at its first use. In the programs of constraints, phi(q, t) = 0 are
constraints on positions, psi = 0 are constraints on velocities, and G = dpsi/dv. The projection makes the least change
in the metric of the mass matrix. One Newton step from (q, v): dq minimises dq^T M dq / 2 with phi + (dphi/dq) dq = 0,
and dv minimises dv^T M dv / 2 with psi + (dpsi/dq) dq + G dv = 0. dq and dv are both solved for with the matrix of the
accelerations, [[M, G^T], [G, 0]], which is factored once. A constraint on velocities determines no coordinates: dq is a
displacement that it admits. Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996,
section VII.2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce

from lagrange.equations.constraints import ConstraintEquations
from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.differentiate import tangents
from lagrange.graph.evaluate import term_sizes
from lagrange.graph.node import Binding, Node, substitute
from lagrange.program.lower import Named, lower
from lagrange.program.program import Program
from lagrange.statement.space import conjugate, length_excess, product

LEAST_TERM_SIZE = Fraction(1, 2**1000)
"""Number added to the sizes of terms, so that a relative violation is zero if all its terms are zero."""


def constraint_positions(constraints: ConstraintEquations) -> list[Node]:
    """Return phi of each constraint phi(q, t) = 0; zero for a constraint that is stated in velocities."""
    pairs = zip(constraints.positions, constraints.velocities, strict=True)
    return [psi.graph.zero if phi is None else phi for phi, psi in pairs]


def projection(equations: Equations) -> Named:
    """Return the nodes of the corrections [dq, dv] of a state onto the constraints, and of two error measures.

    The violation is the error before the correction: the largest |phi| or |psi|, relative to the size of its terms.
    The remainder estimates the error after the correction: the sum over all constraints of the second-order terms
    along the corrections, again relative to the sizes of terms. Near a configuration with dependent constraints the
    corrections are large, and the remainder may exceed the violation. The unit length of a quaternion counts as a
    constraint.

    Some constraints may only determine the velocities of coordinates without inertia. Then a second violation
    follows: the violation of the other constraints alone.
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
    # At rest all terms of a velocity constraint are rounding. So the scale includes the terms of its change by this
    # correction.
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
    """Change the part of each correction along its quaternion q so that q . correction = -error, in place.

    `corrections` are corrections of coordinates or of velocities, and `errors` has an error for each quaternion.
    The length of q is nearly one. Forces and constraints do not depend on this length, so they do not change.
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
    multipliers and constraints are padded to n entries. A padding entry of the constraints is the padding
    multiplier itself. A step makes all entries zero, hence also the padding multipliers, and the matrix of Newton's
    method is square and regular. A constraint on velocities has no phi: its multiplier takes the place of phi.
    Momenta and forces are those of `Equations.motion`, whose mass matrix is regular.
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

    The quantities are the momenta p, the forces f, the constraint forces c = G^T lambda, the constraints phi and
    their rates of change psi, padded to n entries each.
    """
    rows = [node for block in constrained(equations).values() for node in block]
    symbols = [symbol for block in constrained_inputs(equations).values() for symbol in block]
    columns = [tangents(rows, {symbol: equations.graph.one}) for symbol in symbols]
    return {"constrained_jacobian": [column(row) for row in rows for column in columns]}


HALF = Fraction(1, 2)


def local_inputs(equations: Equations) -> dict[str, Sequence[Node]]:
    """Return the inputs of the program `local` by name: a local state (Q, V), then the coordinates `start`.

    A step integrates a local state about the coordinates `start` at its beginning. Q and V equal q and v except for
    quaternions: there q is Q / |Q|, and V is the velocity that the quaternion in `start` has for the same angular
    rates of the body.
    """
    start = [equations.graph.symbol(f"start {i}", Binding.CONFIGURATION) for i in range(len(equations.q))]
    return {**equations.state, "start": start}


def local(equations: Equations) -> Named:
    """Return the nodes of dQ/dt, dV/dt, q and v for a local state (Q, V), n nodes of each.

    Q and V equal q and v except for quaternions: there q is Q / |Q|, and v is perpendicular to q. V is the velocity
    that the quaternion at the start of the step has for the same angular rates of the body.
    """
    e, graph, start = equations, equations.graph, local_inputs(equations)["start"]
    rates, coordinates, velocities, known = [*e.rate], [*e.q], [*e.v], {}
    for rows in e.quaternions:
        q, Q, V = ([part[i] for i in rows] for part in (start, e.q, e.v))
        w = [2 * rate for rate in _quotient(V, q)]
        along = graph.sum([(1, a * b) for a, b in zip(_quotient(Q, q), w, strict=True)])
        spin = [HALF * entry for entry in product(Q, (graph.zero, *w))]
        unit = graph.power(_square(Q), -HALF)
        for k, i in enumerate(rows):
            known[e.v[i]] = spin[k]
            rates[i] = spin[k] + HALF * along * Q[k]
            coordinates[i], velocities[i] = unit * Q[k], unit * spin[k]
    accelerations = substitute(e.accelerations, known)
    for rows in e.quaternions:
        q, Q, pushed = ([part[i] for i in rows] for part in (start, e.q, accelerations))
        for i, entry in zip(rows, product(q, (graph.zero, *_quotient(pushed, Q))), strict=True):
            accelerations[i] = entry
    return {"rates": rates, "accelerations": accelerations, "coordinates": coordinates, "velocities": velocities}


def _quotient(a: Sequence[Node], q: Sequence[Node]) -> list[Node]:
    """Return the three nodes of the vector part of q^-1 a, for quaternions q and a of four nodes each."""
    square = _square(q)
    _, *vector = product(conjugate(q), a)
    return [entry / square for entry in vector]


def _square(q: Sequence[Node]) -> Node:
    return q[0].graph.sum([(1, entry**2) for entry in q])


@dataclass(frozen=True)
class Quantity:
    """A quantity that a model evaluates, such as the right-hand side or the energy.

    `results` is a function from the equations to the result nodes, by name. `indices` is 0 for a number, 1 for a
    vector, 2 for a matrix. A matrix has `rows` rows, or is square without `rows`. `inputs` is a function from the
    equations to the input nodes, except t. `solved` is true if results are solutions of a system with the mass
    matrix. `returned` names the results that a call from a step returns in registers.
    """

    results: Callable[[Equations], Named]
    indices: int = 1
    solved: bool = False
    returned: tuple[str, ...] = ()
    inputs: Callable[[Equations], Named] = lambda e: e.state
    rows: Callable[[Equations], int] | None = None


def jacobian(equations: Equations) -> Named:
    """Return the nodes of the Jacobian d[dq/dt, a] / d[q, v] of the right-hand side by rows, (2n, 2n).

    The upper rows are the derivatives of dq/dt, and the lower rows the derivatives of the accelerations a. These
    follow from the residual r = [M a - h - G^T lambda, G a + gamma] as a function of y = [q, v] at fixed a and
    lambda: they solve [[M, G^T], [G, 0]] d[a, -lambda]/dy = -dr/dy. The residual is computed as the rate of change
    of the momenta and constraints along (v, a), so that no entry of M is differentiated.
    """
    graph, held = equations.graph, equations.constraints
    n, m = len(equations.v), len(equations.constraints)
    # Accelerations must be symbols: the derivative of M times the solution of M a = h would be zero.
    a = [graph.symbol(f"acceleration {i}", Binding.ACCELERATION) for i in range(n)]
    direction = dict(zip((*equations.q, *equations.v), (*equations.rate, *a), strict=True))
    along = tangents([*equations.motion.momenta, *held.velocities], {**direction, **graph.rates})
    residual = [along(p) - f for p, f in zip(equations.motion.momenta, equations.motion.forces, strict=True)]
    known = dict(zip(a, equations.accelerations, strict=True))
    if m:
        multipliers = [graph.symbol(f"multiplier {i}", Binding.ACCELERATION) for i in range(m)]
        residual = [r - force for r, force in zip(residual, held.forces(multipliers), strict=True)]
        residual += [along(psi) for psi in held.velocities]
        known |= dict(zip(multipliers, equations.impulses, strict=True))
    if equations.rates_are_solved:
        # The other entries of the state determine velocities without inertia: the residual uses these velocities.
        residual = substitute(residual, dict(zip(equations.v, equations.rate, strict=True)))
    columns, solve = [], equations.plan.solver(equations.matrix)
    for symbol in (*equations.q, *equations.v):
        column = tangents([*equations.rate, *residual], {symbol: graph.one})
        slopes = substitute([-column(entry) for entry in residual], known)
        columns.append([*map(column, equations.rate), *solve(slopes)[:n]])
    return {"jacobian": [entry for row in zip(*columns, strict=True) for entry in row]}


def momentum_jacobian(equations: Equations) -> Named:
    """Return the nodes of d[p, f] / d[q, v] by rows, (2n, 2n), with momenta p and forces f.

    The upper right block is the mass matrix.
    """
    rows = [*equations.momenta, *equations.forces]
    columns = [tangents(rows, {symbol: equations.graph.one}) for symbol in (*equations.q, *equations.v)]
    return {"momentum_jacobian": [column(row) for row in rows for column in columns]}


def constraint_forces(equations: Equations) -> Named:
    """Return the nodes of the generalized force G_i^T lambda_i of each constraint i, n nodes for each.

    G_i is the gradient of the constraint, and lambda_i its multiplier.
    """
    forces = [
        entry * multiplier
        for row, multiplier in zip(equations.stated.gradient, equations.multipliers, strict=True)
        for entry in row
    ]
    return {"constraint_forces": forces}


def constraint_sizes(equations: Equations) -> Named:
    """Return the size of each constraint: the sum of the magnitudes of its terms.

    First come the sizes of the constraints phi(q, t), then those of their rates of change psi.
    """
    held = equations.stated
    sizes = term_sizes([*constraint_positions(held), *held.velocities])
    return {"positions": sizes[: len(held)], "velocities": sizes[len(held) :]}


QUANTITIES: dict[str, Quantity] = {
    "rhs": Quantity(
        lambda e: {"rate": e.rate, "acceleration": e.accelerations}, solved=True, returned=("acceleration",)
    ),
    "jacobian": Quantity(jacobian, 2, solved=True),
    "accelerations": Quantity(lambda e: {"acceleration": e.accelerations}, solved=True),
    "mass_matrix": Quantity(lambda e: {"mass_matrix": [entry for row in e.mass for entry in row]}, 2),
    "energy": Quantity(lambda e: {"energy": [e.energy]}, 0),
    "momenta": Quantity(lambda e: {"momenta": e.momenta}),
    "lagrangian": Quantity(lambda e: {"lagrangian": [e.lagrangian]}, 0),
    "forces": Quantity(lambda e: {"forces": e.forces}),
    "bias": Quantity(lambda e: {"bias": e.bias}),
    "momentum": Quantity(lambda e: {"momenta": e.momenta, "forces": e.forces}, returned=("momenta", "forces")),
    "momentum_jacobian": Quantity(momentum_jacobian, 2),
}
"""Quantities of every system, by name. `forces` is f = dL/dq + Q - dD/dv; `bias` is h in M a = h + G^T lambda.
`momentum` is [p, f], so that dp/dt = f.
"""


CONSTRAINT_QUANTITIES: dict[str, Quantity] = {
    "multipliers": Quantity(lambda e: {"multipliers": e.multipliers}, solved=True),
    "constraint_forces": Quantity(constraint_forces, 2, solved=True, rows=lambda e: len(e.stated)),
    "constraints": Quantity(lambda e: {"positions": constraint_positions(e.stated), "velocities": e.stated.velocities}),
    "constraint_gradient": Quantity(
        lambda e: {"constraint_gradient": [entry for row in e.stated.gradient for entry in row]},
        2,
        rows=lambda e: len(e.stated),
    ),
    "constraint_bias": Quantity(lambda e: {"constraint_bias": e.stated.bias}),
    "constraint_sizes": Quantity(constraint_sizes),
}
"""Quantities of systems with constraints, by name. `constraints` is phi, followed by psi = dphi/dt.
`constraint_gradient` is G = dpsi/dv, a row for each constraint. `constraint_bias` is gamma in G a + gamma = 0.
`constraint_sizes` has the sizes of the terms of phi and psi.
"""


LAW_QUANTITIES: dict[str, Quantity] = {
    "constrained": Quantity(constrained, inputs=constrained_inputs),
    "constrained_jacobian": Quantity(constrained_jacobian, 2, inputs=constrained_inputs, rows=lambda e: 5 * len(e.q)),
    "projection": Quantity(projection, solved=True),
    "local": Quantity(local, solved=True, inputs=local_inputs),
}
"""Quantities that only steps evaluate, by name: `constrained` and `local` are the functions of these laws
(`lagrange.program.step`), and `projection` has the corrections of a state [q, v] onto the constraints, with the
violation before and after.
"""


def quantities_of(equations: Equations) -> dict[str, Quantity]:
    """Return the quantities that a system offers, by name, such as its energy.

    Only a system with constraints has quantities of constraints.
    """
    return {**QUANTITIES, **(CONSTRAINT_QUANTITIES if equations.stated.names else {})}


def program_of(name: str, equations: Equations) -> Program:
    """Return the program that computes the quantity `name` of a system, built at the first call."""
    if name in equations.programs:
        program: Program = equations.programs[name]
        return program
    quantity = {**quantities_of(equations), **LAW_QUANTITIES}[name]
    results = quantity.results(equations)
    inputs = quantity.inputs(equations)
    count = sum(map(len, results.values()))
    rows = math.isqrt(count) if quantity.rows is None else quantity.rows(equations)
    shape = {0: (), 1: (count,), 2: (rows, count // rows)}[quantity.indices]
    # A kernel returns some results only if all others are inputs. Otherwise it writes all results.
    symbols = {symbol for block in inputs.values() for symbol in block}
    unreturned = (node for block, nodes in results.items() if block not in quantity.returned for node in nodes)
    returned = quantity.returned if all(node in symbols for node in unreturned) else ()
    arguments = name, results, inputs, equations.time, equations.parameters
    equations.programs[name] = program = lower(*arguments, shape=shape, returned=returned, solved=quantity.solved)
    return program


def lower_nodes(name: str, nodes: Sequence[Node], equations: Equations) -> Program:
    """Return the program `name`, which computes nodes of the graph of the equations from t, q, v and parameters."""
    return lower(name, {name: nodes}, equations.state, equations.time, equations.parameters)
