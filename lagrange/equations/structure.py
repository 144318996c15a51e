"""Properties of the equations that select code, allow methods, and are reported to the user, such as a constant mass.

Properties that select code are found without algebra. So a property may be missed, but is never claimed wrongly.
Reported properties are decided by proof or counterexample in `lagrange.equations.decisions`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from lagrange.equations.decisions import Decisions, StatedLaws, Verdict
from lagrange.equations.solve_plan import plan_of
from lagrange.errors import listing
from lagrange.graph.node import Binding, Kind, Node, reachable
from lagrange.statement.statement import Statement


@dataclass(frozen=True, eq=False)
class Structure:
    """Properties of the equations. Coordinates are listed by index.

    - `blocks` are groups of coordinates that the mass matrix couples.
    - `constant_mass`, `forced` (forces or dissipation act) and `position_only` (accelerations do not depend on
      velocities) are found without algebra.
    - `free` are coordinates without force, dissipation and constraint.
    - `brief` is true if time is in a function other than a polynomial, a sine or a cosine. So a force may act for a
      moment only.
    - `constraints` are the names of the constraints, and `nonlinear` the names of those not linear in velocities.
    - `workless` is true if constraint forces do no work.
    - `first_order` are coordinates without inertia.
    - `freedoms` is the number of independent velocities. A rotation has three, although its quaternion has four.
    """

    names: tuple[str, ...]
    blocks: tuple[tuple[int, ...], ...]
    constant_mass: bool
    forced: bool
    free: tuple[int, ...]
    position_only: bool
    brief: bool
    constraints: tuple[str, ...]
    nonlinear: tuple[str, ...]
    workless: bool
    first_order: tuple[int, ...]
    freedoms: int
    decisions: Decisions

    @cached_property
    def cyclic(self) -> tuple[int, ...]:
        """Indices of cyclic coordinates: L does not depend on them, and no force, drag or constraint acts on them."""
        return tuple(i for i in self.free if self.decisions.cyclic(i))

    @property
    def energy_kept(self) -> Verdict:
        """True if the energy v.p - L is conserved, False if not, None if undecided.

        The energy is conserved if explicit time, forces and dissipation together do no work. Constraints that depend on
        time, or are not homogeneous in the velocities, may do work. Then the result is None.
        """
        return self.decisions.powerless if self.workless else None

    @property
    def may_keep_energy(self) -> bool:
        """False if constraints may do work, or if numbers show that the energy changes; else True, without a proof."""
        return self.workless and self.decisions.power_seen is not False

    @property
    def conservative(self) -> bool:
        """True if the energy v.p - L is proven to be conserved."""
        return self.energy_kept is True

    def sentences(self) -> list[str]:
        """Return the properties of the equations of motion in words, one sentence each."""
        return [self._mass(), *self._separation(), *self.remarks()]

    def remarks(self) -> list[str]:
        """Return sentences as in a textbook: on coordinates without inertia, constraints, and conserved quantities."""
        momenta = [
            f"{self.names[i]} does not appear in L: it is cyclic, so p_{self.names[i]} is conserved."
            for i in self.cyclic
        ]
        return [*self._first_order(), *self._constraints(), *self._energy(), *momenta]

    def _separation(self) -> list[str]:
        if self.decisions.separable:
            return ["The momenta depend on velocities alone: all else in the Lagrangian acts as a potential."]
        if self.decisions.separable is False:
            return ["The momenta depend on more than the velocities: the Lagrangian does not separate."]
        return []

    def _first_order(self) -> list[str]:
        names = [self.names[i] for i in self.first_order]
        predicate = "has no inertia: its equation" if len(names) == 1 else "have no inertia: their equations"
        of_motion = "of motion is" if len(names) == 1 else "of motion are"
        return [f"{listing(names)} {predicate} {of_motion} of first order."] if names else []

    def _constraints(self) -> list[str]:
        count = len(self.constraints)
        if not count:
            return []
        free = self.freedoms - count
        verb = "constraint {} leaves" if count == 1 else "constraints {} leave"
        work = f" {'Its' if count == 1 else 'Their'} forces do no work." if self.workless else ""
        sentences = [
            f"The {verb.format(listing(self.constraints))} {free or 'none'} of {self.freedoms} velocities free.{work}"
        ]
        for name in self.nonlinear:
            sentences.append(
                f"The constraint {name} is not linear in the velocities: its force is along its derivative in the "
                "velocities (Chetaev's rule)."
            )
        return sentences

    def _mass(self) -> str:
        constant = self.decisions.constant_mass
        kind = "" if constant is None else " and is constant" if constant else " and changes along the motion"
        if len(self.blocks) == len(self.names):
            return f"The mass matrix is diagonal{kind.replace('is constant', 'constant')}."
        if len(self.blocks) == 1:
            return f"The mass matrix couples all coordinates{kind}."
        groups = listing("(" + ", ".join(self.names[i] for i in block) + ")" for block in self.blocks)
        return f"The mass matrix falls into blocks {groups}{kind}."

    def _energy(self) -> list[str]:
        if self.decisions.statement.lagrangian == 0:
            return []
        if self.conservative:
            kept = "energy" if self.energy_name == "energy" else "Jacobi integral v.p - L"
            stated_alone = self.decisions.statement.lagrangian_alone
            other = " (T + V is not this integral)" if kept != "energy" and not stated_alone else ""
            return [f"{self.energy_reason()}: the {kept} is conserved{other}."]
        verdict = "is not" if self.energy_kept is False else "was not found to be"
        timeless = self.decisions.timeless
        time = "depends" if timeless is False else "may depend"
        causes = [] if timeless else [f"the Lagrangian {time} on time"]
        causes += ["forces or dissipation act"] * self.forced
        causes += ["constraints that depend on time, or on velocities other than in proportion, may do work"] * (
            not self.workless
        )
        return [f"The energy {verdict} conserved: {listing(causes)}."]

    @property
    def energy_name(self) -> str:
        """Name of v.p - L, with velocities v, momenta p and the Lagrangian L.

        It is "energy", or "Jacobi integral" if the kinetic energy is not of second degree in v, as in a rotating frame.
        """
        return "Jacobi integral" if self.decisions.homogeneous is False else "energy"

    @property
    def energy_letter(self) -> str:
        """Letter for the energy in formulas: J for a Jacobi integral that differs from T + V, else E."""
        return "J" if self.energy_name == "Jacobi integral" else "E"

    def energy_reason(self) -> str:
        """Return the reason why the energy is conserved, if it is, as the beginning of a sentence."""
        if not self.forced:
            return "Nothing depends on time explicitly and no force acts besides the potential"
        if self.decisions.timeless:
            return "Nothing depends on time explicitly and the forces besides the potential do no work"
        return "The forces besides the potential do the work that explicit time takes"


def find_structure(
    statement: Statement,
    laws: StatedLaws,
    accelerations: Sequence[Node],
    first_order: tuple[int, ...] = (),
) -> Structure:
    """Return the structure of a system from the stated expressions `laws` and the solved `accelerations`.

    `first_order` are the indices of coordinates without inertia. Properties that are only reported are decided when
    they are first used.
    """
    constraints, inertia, graph = laws.constraints, plan_of(laws.mass), laws.time.graph
    free = [force is graph.zero for force in laws.extra]
    constrained = [any(row[i] is not graph.zero for row in constraints.gradient) for i in range(len(laws.q))]
    return Structure(
        names=statement.names,
        blocks=inertia.blocks,
        constant_mass=not inertia.moving,
        forced=not all(free),
        free=tuple(i for i in range(len(laws.q)) if free[i] and not constrained[i]),
        position_only=all(a.binding <= Binding.CONFIGURATION for a in accelerations),
        constraints=constraints.names,
        nonlinear=constraints.nonlinear,
        workless=constraints.workless,
        first_order=first_order,
        freedoms=len(laws.q) - len(statement.rotations),
        brief=any(map(_is_brief, reachable([laws.lagrangian, *laws.extra], laws.time.depends))),
        decisions=Decisions(statement, laws),
    )


def _is_brief(node: Node) -> bool:
    """Return True if a function of time, such as exp or 1/t, may be a pulse that is zero except for a moment."""
    if node.kind is Kind.CALL:
        return node.data not in ("sin", "cos")
    return node.kind is Kind.POWER and not (isinstance(node.data, int) and node.data > 0)
