"""Coordinates without inertia whose equation of motion is of first order.

Where the Lagrangian is linear in the velocity of a coordinate, its Euler-Lagrange equation has no accelerations: it is
a relation of velocities, r(q, v, t) = 0, as for point vortices or for a charge without mass in a magnetic field. Its
rate of change, A a + gamma = 0 with A = dr/dv, gives the acceleration. So it enters the solve as a constraint on the
velocities, and in the row of the coordinate stands A^T mu = 0. Where A is regular mu is zero: nothing acts on the other
coordinates, and the accelerations are right.
Source: L. D. Faddeev, R. Jackiw, Hamiltonian reduction of unconstrained and constrained systems, Physical Review
Letters 60, 1988.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.equations.augmented import Matrix, MotionForm
from lagrange.equations.constraints import ConstraintEquations
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Node
from lagrange.graph.rebuild import substitute

RELATION = "equation of "
"""How the names of relations begin; no name of a user's has a space."""


def first_order_coordinates(
    mass: Sequence[Sequence[Node]], bias: Sequence[Node], v: Sequence[Node], constraints: ConstraintEquations
) -> tuple[int, ...]:
    """Return the coordinates without inertia that no constraint holds and whose equations determine velocities.

    `bias` is h of M a = h: of these coordinates 0 = h is the relation. What is left out has no inertia at all.
    """
    graph = v[0].graph
    chosen = [
        i
        for i, row in enumerate(mass)
        if all(entry is graph.zero for entry in (*row, *(line[i] for line in constraints.gradient)))
    ]
    while True:
        columns = {j: tangents([bias[i] for i in chosen], {v[j]: graph.one}) for j in chosen}
        alone = [
            i
            for i in chosen
            if all(columns[j](bias[i]) is graph.zero for j in chosen)
            or all(columns[i](bias[j]) is graph.zero for j in chosen)
        ]
        if not alone:
            return tuple(chosen)
        chosen = [i for i in chosen if i not in alone]


def without(chosen: Sequence[int], motion: MotionForm) -> MotionForm:
    """Return the equations to be solved without those of the coordinates chosen, for which relations stand."""

    def cleared(entries: Sequence[Node]) -> tuple[Node, ...]:
        return tuple(entry.graph.zero if i in chosen else entry for i, entry in enumerate(entries))

    return MotionForm(cleared(motion.momenta), cleared(motion.forces), cleared(motion.bias))


def with_ones(chosen: Sequence[int], mass: Matrix) -> Matrix:
    """Return a mass matrix with an inertia of one for the coordinates chosen, to see whether the others have theirs."""
    return [
        [entry.graph.one if i == j and i in chosen else entry for j, entry in enumerate(row)]
        for i, row in enumerate(mass)
    ]


def with_relations(
    constraints: ConstraintEquations,
    chosen: Sequence[int],
    names: Sequence[str],
    bias: Sequence[Node],
    q: Sequence[Node],
    v: Sequence[Node],
    time: Node,
) -> ConstraintEquations:
    """Return the constraints with the relations of the coordinates chosen behind them."""
    if not chosen:
        return constraints
    graph = time.graph
    relations = tuple(bias[i] for i in chosen)
    columns = [tangents(relations, {symbol: graph.one}) for symbol in v]
    rate = tangents(relations, {**dict(zip(q, v, strict=True)), **graph.rates})
    return constraints.joined(
        ConstraintEquations(
            names=tuple(f"{RELATION}{names[i]}" for i in chosen),
            positions=tuple(None for _ in chosen),
            velocities=relations,
            gradient=tuple(tuple(column(psi) for column in columns) for psi in relations),
            bias=tuple(map(rate, relations)),
            rest=tuple(substitute(relations, dict.fromkeys(v, graph.zero))),
        )
    )
