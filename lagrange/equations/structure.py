"""What kind of system it is: findings that choose code, allow methods, and are told to the user in words.

A finding is made from the expressions as they stand, so it is never wrong but can be missed: a Lagrangian
that depends on a coordinate only through cosh(q)**2 - sinh(q)**2 counts as depending on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lagrange.equations.constraints import ConstraintEquations
from lagrange.equations.solve_plan import plan_of
from lagrange.errors import listing
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable


@dataclass(frozen=True)
class Structure:
    """The findings; `blocks` are the groups of coordinates that the mass matrix couples.

    `position_only`: the accelerations are free of velocities. `brief`: time stands in some other function than a
    polynomial, a sine or a cosine, so that a force may act briefly and leave no trace before and after.
    `constraints` are the names of the constraints, `nonlinear` of those that are not linear in the velocities.
    `workless`: the forces of no constraint do work. `first_order` are the coordinates without inertia.
    """

    names: tuple[str, ...]
    blocks: tuple[tuple[int, ...], ...]
    constant_mass: bool
    separable: bool
    autonomous: bool
    forced: bool
    cyclic: tuple[int, ...]
    position_only: bool
    brief: bool
    constraints: tuple[str, ...] = ()
    nonlinear: tuple[str, ...] = ()
    workless: bool = True
    first_order: tuple[int, ...] = ()

    @property
    def conservative(self) -> bool:
        """Whether the energy v.p - L is conserved: no explicit time, no forces, no dissipation.

        Constraints that depend on time, or are not homogeneous in the velocities, may do work.
        """
        return self.autonomous and not self.forced and self.workless

    def sentences(self) -> list[str]:
        """Return the findings in words, one sentence each."""
        return [
            self._mass(),
            "The momenta depend on velocities alone: all else in the Lagrangian acts as a potential."
            if self.separable
            else "The momenta depend on more than the velocities: the Lagrangian does not separate.",
            *self._first_order(),
            *self._constraints(),
            self._energy(),
            *self._momenta(),
        ]

    def _first_order(self) -> list[str]:
        names = [self.names[i] for i in self.first_order]
        if not names:
            return []
        if len(names) == 1:
            return [f"{names[0]} has no inertia: its equation of motion is of first order."]
        return [f"{listing(names)} have no inertia: their equations of motion are of first order."]

    def _constraints(self) -> list[str]:
        count = len(self.constraints)
        if not count:
            return []
        free = len(self.names) - count
        held = "constraint {} leaves" if count == 1 else "constraints {} leave"
        work = f" {'Its' if count == 1 else 'Their'} forces do no work." if self.workless else ""
        sentences = [
            f"The {held.format(listing(self.constraints))} {free or 'none'} of {len(self.names)} velocities free.{work}"
        ]
        for name in self.nonlinear:
            sentences.append(
                f"The constraint {name} is not linear in the velocities: its force is along its derivative in the "
                "velocities (Chetaev's rule)."
            )
        return sentences

    def _mass(self) -> str:
        kind = "constant" if self.constant_mass else "changes along the motion"
        if len(self.blocks) == len(self.names):
            return f"The mass matrix is diagonal and {kind}."
        if len(self.blocks) == 1:
            return f"The mass matrix couples all coordinates and {kind.replace('constant', 'is constant')}."
        groups = listing("(" + ", ".join(self.names[i] for i in block) + ")" for block in self.blocks)
        return f"The mass matrix falls into blocks {groups} and {kind.replace('constant', 'is constant')}."

    def _energy(self) -> str:
        if self.conservative:
            return "Nothing depends on time explicitly and no force acts beside the potential: the energy is conserved."
        causes = ["the Lagrangian depends on time"] * (not self.autonomous) + [
            "forces or dissipation act"
        ] * self.forced
        causes += ["constraints that depend on time, or on velocities other than in proportion, may do work"] * (
            not self.workless
        )
        return f"The energy is not conserved: {listing(causes)}."

    def _momenta(self) -> list[str]:
        return [
            f"{self.names[i]} does not appear in the Lagrangian: its conjugate momentum is conserved."
            for i in self.cyclic
        ]


def find_structure(
    graph: Graph,
    names: tuple[str, ...],
    q: Sequence[Node],
    time: Node,
    lagrangian: Node,
    momenta: Sequence[Node],
    extra: Sequence[Node],
    mass: Sequence[Sequence[Node]],
    constraints: ConstraintEquations,
    accelerations: Sequence[Node],
    first_order: tuple[int, ...] = (),
) -> Structure:
    """Find the structure; `extra` are the generalized forces less dissipation, Q - dD/dv."""
    free = [force is graph.zero for force in extra]
    held = [any(row[i] is not graph.zero for row in constraints.gradient) for i in range(len(q))]
    inertia = plan_of(mass)
    return Structure(
        names=names,
        blocks=inertia.blocks,
        constant_mass=not inertia.moving,
        separable=not any(p.binding in (Binding.TIME, Binding.CONFIGURATION) or _mixed(p, q, time) for p in momenta),
        autonomous=not lagrangian.depends & time.depends,
        forced=not all(free),
        cyclic=tuple(i for i, x in enumerate(q) if not lagrangian.depends & x.depends and free[i] and not held[i]),
        position_only=all(a.binding <= Binding.CONFIGURATION for a in accelerations),
        constraints=constraints.names,
        nonlinear=constraints.nonlinear,
        workless=constraints.workless,
        first_order=first_order,
        brief=any(_is_brief(node) for node in reachable([lagrangian, *extra], time.depends)),
    )


def _is_brief(node: Node) -> bool:
    """Whether the function of time that the node applies may be all but zero except for a moment."""
    if node.kind is Kind.CALL:
        return node.data not in ("sin", "cos")
    return node.kind is Kind.POWER and not (isinstance(node.data, int) and node.data > 0)


def _mixed(momentum: Node, q: Sequence[Node], time: Node) -> bool:
    mask = time.depends
    for x in q:
        mask |= x.depends
    return bool(momentum.depends & mask)
