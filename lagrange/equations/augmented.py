"""The laws of motion as they are solved: where constraints alone make the motion determined, they add to the inertia.

A mass matrix may be singular while every motion that the constraints allow has inertia, as that of a unit quaternion.
With p + S psi G in place of p, and f + S psi dG/dt in place of f, the equations differ by S G dpsi/dt, which is zero:
accelerations and multipliers are the same, and the mass matrix M + G^T S G is definite. S is any positive number for
each constraint; here it makes both terms of a size, at coordinates of one.
Source: E. Bayo, J. Garcia de Jalon, M. A. Serna, A modified Lagrangian formulation for the dynamic analysis of
constrained mechanical systems, Comput. Methods Appl. Mech. Eng. 71, 1988.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lagrange.equations.constraints import ConstraintEquations
from lagrange.errors import StatementError
from lagrange.graph.differentiate import tangents
from lagrange.graph.generic import generic_rank
from lagrange.graph.node import Binding, Node
from lagrange.graph.rebuild import substitute

Matrix = Sequence[Sequence[Node]]


@dataclass(frozen=True, eq=False)
class MotionForm:
    """The momenta and forces, n each, of dp/dt = f + G^T lambda as they are solved, and h of M a = h + G^T lambda."""

    momenta: tuple[Node, ...]
    forces: tuple[Node, ...]
    bias: tuple[Node, ...]


def augmentation(
    mass: Matrix, constraints: ConstraintEquations, q: Sequence[Node], v: Sequence[Node], time: Node
) -> tuple[list[Node], list[Node]] | None:
    """Return what is added to momenta and forces, None for a mass matrix that is regular by itself."""
    linear = [name not in constraints.nonlinear for name in constraints.names]
    if not any(linear) or generic_rank(mass) == len(q):
        return None
    graph = time.graph
    momenta, forces = [graph.zero] * len(q), [graph.zero] * len(q)
    along = {**dict(zip(q, v, strict=True)), **graph.rates}
    for psi, row, chosen in zip(constraints.velocities, constraints.gradient, linear, strict=True):
        if not chosen:
            continue
        pushed = psi * _weight(mass, row, (*q, *v, time))
        moved = tangents(row, along)
        for i, entry in enumerate(row):
            momenta[i] = momenta[i] + pushed * entry
            forces[i] = forces[i] + pushed * moved(entry)
    return momenta, forces


def _weight(mass: Matrix, row: Sequence[Node], symbols: Sequence[Node]) -> Node:
    """Return the size of the mass matrix over that of G^T G, with all that moves replaced by one."""
    graph = symbols[0].graph
    inertia = graph.sum([(1, mass[i][i]) for i in range(len(row))])
    square = graph.sum([(1, entry * entry) for entry in row])
    try:
        above, below = substitute([inertia, square], dict.fromkeys(symbols, graph.one))
        weight = above / below
    except StatementError:  # a pole at one
        return graph.one
    return weight if weight.binding <= Binding.PARAMETER and weight is not graph.zero else graph.one
