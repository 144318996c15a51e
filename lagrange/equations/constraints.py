"""Constraints as graph nodes: psi = 0 on velocities, G a + gamma = 0 on accelerations, and forces +G^T lambda.

The sign of a multiplier is chosen here for compiled equations, and in `derivation.py` for printed ones.

A holonomic constraint phi(q, t) = 0 is differentiated: psi = dphi/dt = (dphi/dq) v + dphi/dt. If a constraint is stated
in velocities, psi is the stated expression. Then G = dpsi/dv, and gamma is dpsi/dt without the term G a. The
generalized forces of a constraint are G^T lambda. For constraints that are linear in velocities this is d'Alembert's
principle, for others Chetaev's rule. Source: J. G. Papastavridis, Analytical Mechanics, 2nd ed., 2014, sections 2.4,
3.5 and 5.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.equations.solve_plan import value_somewhere
from lagrange.errors import StatementError
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node, substitute
from lagrange.statement.statement import Constraint

TERM_ROUND_OFF = 1e-12  # Rounding threshold: values below this fraction of their terms count as zero


@dataclass(frozen=True, eq=False)
class ConstraintEquations:
    """Equations of m constraints on n coordinates, as nodes.

    `positions` has phi of each holonomic constraint phi(q, t) = 0, and None for the others. `velocities` has psi, which
    is dphi/dt or the constraint as stated in velocities. `gradient` has the m rows of G = dpsi/dv, and `bias` has
    gamma, which is dpsi/dt without the term of accelerations G a. `rest` is psi with all velocities zero.
    """

    names: tuple[str, ...] = ()
    positions: tuple[Node | None, ...] = ()
    velocities: tuple[Node, ...] = ()
    gradient: tuple[tuple[Node, ...], ...] = ()
    bias: tuple[Node, ...] = ()
    rest: tuple[Node, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    @property
    def workless(self) -> bool:
        """True if all constraints are linear and homogeneous in the velocities, so that their forces do no work."""
        return not self.nonlinear and all(rest is rest.graph.zero for rest in self.rest)

    @property
    def nonlinear(self) -> tuple[str, ...]:
        """Names of the constraints that are not linear in the velocities."""
        moving = [any(entry.binding >= Binding.VELOCITY for entry in row) for row in self.gradient]
        return tuple(name for name, depends in zip(self.names, moving, strict=True) if depends)

    def part(self, rows: Sequence[int]) -> ConstraintEquations:
        """Return the equations of the constraints with the indices `rows`."""
        chosen = [[entries[i] for i in rows] for entries in self._entries]
        return ConstraintEquations(*map(tuple, chosen))

    def last(self, count: int) -> ConstraintEquations:
        """Return the equations of the last `count` constraints."""
        return self.part(range(len(self) - count, len(self)))

    def joined(self, other: ConstraintEquations) -> ConstraintEquations:
        """Return the equations of these constraints, followed by those of the constraints `other`."""
        return ConstraintEquations(*(a + b for a, b in zip(self._entries, other._entries, strict=True)))

    @property
    def _entries(self) -> tuple[tuple[Any, ...], ...]:
        return self.names, self.positions, self.velocities, self.gradient, self.bias, self.rest

    def forces(self, multipliers: Sequence[Node]) -> list[Node]:
        """Return the generalized forces of the constraints with these multipliers: G^T lambda, n nodes."""
        graph = multipliers[0].graph
        return [
            graph.sum([(1, row[i] * multiplier) for row, multiplier in zip(self.gradient, multipliers, strict=True)])
            for i in range(len(self.gradient[0]))
        ]


def check_rows(stated: Sequence[Constraint], constraints: ConstraintEquations) -> None:
    """Raise StatementError for a constraint in `stated` that no velocity changes: its row of the gradient is zero.

    `constraints` are the equations of the stated constraints.
    """
    for constraint, row in zip(stated, constraints.gradient, strict=True):
        if all(entry is entry.graph.zero for entry in row):
            raise StatementError(empty_constraint(constraint.name, value_somewhere(constraint.expression), 1.0))


def empty_constraint(name: str, value: float, size_of_terms: float) -> str:
    """Return the error message for the constraint `name`, which contains no coordinate and no velocity.

    `value` is the value of the constraint at a state. If it is zero on the scale `size_of_terms`, the message calls the
    constraint always true, else never true.
    """
    if abs(value) <= TERM_ROUND_OFF * size_of_terms:
        return (
            f"the constraint {name!r} is always true: it is zero at every state tried, and constrains nothing. Leave "
            "it out."
        )
    return (
        f"the constraint {name!r} is never true: no coordinate and no velocity changes its value, which is {value:.6g} "
        "where it was tried. Correct the constraint, or leave it out."
    )


def constraint_equations(
    zeros: Mapping[str, Node], holonomic: Sequence[bool], q: Sequence[Node], v: Sequence[Node], time: Node
) -> ConstraintEquations:
    """Return the equations of the constraints in `zeros`, {name of the constraint: node that stays zero}.

    A node is phi(q, t) if its flag in `holonomic` is true, else psi(q, v, t), with the symbols of coordinates,
    velocities and time.
    """
    if not zeros:
        return ConstraintEquations()
    moved = tangents(zeros.values(), {**dict(zip(q, v, strict=True)), **time.graph.rates})
    pairs = list(zip(zeros.items(), holonomic, strict=True))
    velocities = {name: moved(node) if is_holonomic else node for (name, node), is_holonomic in pairs}
    return velocity_equations(
        velocities, q, v, time, [node if is_holonomic else None for (_, node), is_holonomic in pairs]
    )


def velocity_equations(
    zeros: Mapping[str, Node], q: Sequence[Node], v: Sequence[Node], time: Node, positions: Sequence[Node | None] = ()
) -> ConstraintEquations:
    """Return the equations of the constraints in `zeros`, {name of the constraint: psi(q, v, t), which stays zero}.

    `positions` has phi of each holonomic constraint, whose psi is dphi/dt, and None for the others. () means all None.
    """
    graph, velocities = time.graph, tuple(zeros.values())
    columns = [tangents(velocities, {symbol: graph.one}) for symbol in v]
    rate = tangents(velocities, {**dict(zip(q, v, strict=True)), **graph.rates})
    return ConstraintEquations(
        names=tuple(zeros),
        positions=tuple(positions) or (None,) * len(zeros),
        velocities=velocities,
        gradient=tuple(tuple(column(psi) for column in columns) for psi in velocities),
        bias=tuple(map(rate, velocities)),
        rest=tuple(substitute(velocities, dict.fromkeys(v, graph.zero))),
    )
