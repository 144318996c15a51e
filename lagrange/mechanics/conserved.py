"""What a system conserves: the energy, momenta of ignorable coordinates, momenta of symmetries, the Runge-Lenz vector.

Everything here is proven as an identity, and tested by number: along the compiled motion it does not change.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import sympy

from lagrange.equations.terms import TooLargeError
from lagrange.equations.textbook_algebra import TextbookAlgebra
from lagrange.machine.model import Model
from lagrange.mechanics.candidates import body_motions, rotations, shifts
from lagrange.mechanics.places import Place, place
from lagrange.mechanics.quantity_rates import check_constant
from lagrange.mechanics.runge_lenz import runge_lenz
from lagrange.mechanics.symmetries import Symmetry, SymmetryEquation
from lagrange.mechanics.symmetry_names import described, oriented, untaken
from lagrange.statement.notebook_page import ShownAsPage
from lagrange.statement.statement import Statement

MOST_SEARCHED = 24
"""With more coordinates no symmetry is tried beside the ignorable coordinates."""

LARGEST = 60_000
"""Monomials that are made for one symmetry, 1 s of them."""


@dataclass(frozen=True, repr=False)
class Conserved(ShownAsPage):
    """A quantity that stays constant along every motion, in coordinates, velocities, parameters and t.

    `name` is "energy", "p_phi", "angular momentum z" and the like; `reason` says why it is conserved. `statement` is
    that of the system.
    """

    name: str
    expression: Any
    reason: str
    statement: Statement = field(compare=False)

    def __str__(self) -> str:
        return f"{self.name} = {self.expression}: {self.reason}"

    def __repr__(self) -> str:
        return f"<Conserved: {self}>"


def conserved_quantities(model: Model) -> list[Conserved]:
    """Return what is found to be conserved; nothing is claimed of what is not in the list.

    Raises RunError where a proven quantity changes along the compiled motion, which is a fault.
    """
    if "conserved" not in model.prepared:
        found = list(_found(model))
        check_constant(model, {one.name: one.expression for one in found})
        model.prepared["conserved"] = found
    return list(model.prepared["conserved"])


def _found(model: Model) -> Iterator[Conserved]:
    structure, stated = model.equations.structure, TextbookAlgebra(model.statement)
    taken = [f"p_{structure.names[i]}" for i in structure.cyclic]
    if structure.conservative:
        taken.append(structure.energy_name)
        yield Conserved(taken[-1], stated.show(stated.energy), f"{structure.energy_reason()}.", model.statement)
    for name, i in zip(taken, structure.cyclic, strict=False):
        how = "is not in" if structure.decisions.absent(i) else "drops out of"
        reason = f"{structure.names[i]} {how} the Lagrangian."
        yield Conserved(name, stated.show(stated.momenta[i]), reason, model.statement)
    if len(stated.q) > MOST_SEARCHED:
        return
    equation, body = SymmetryEquation(stated), place(stated)
    for one in _symmetries(model, equation, body):
        symmetry, name = oriented(stated, one, body, structure.energy_name)
        taken.append(untaken(name, taken))
        yield Conserved(
            taken[-1],
            stated.show(equation.quantity(symmetry)),
            described(stated, one if one.tau != 0 else symmetry),
            model.statement,
        )
    for name, terms in runge_lenz(stated, body) if body is not None else ():
        yield Conserved(name, stated.show(terms), RUNGE_LENZ, model.statement)


RUNGE_LENZ = "The force falls with the square of the distance, so the axis of the orbit does not turn."


def _symmetries(model: Model, equation: SymmetryEquation, body: Place | None) -> Iterator[Symmetry]:
    """Yield the symmetries that are proven, beside the known ones, without sums of shifts that were yielded before."""
    structure, stated = model.equations.structure, equation.stated
    n = len(stated.q)
    known: list[list[Any]] = [[int(j == i) for j in range(n)] for i in structure.cyclic]
    candidates = [*shifts(stated), *rotations(stated), *(body_motions(stated, body) if body is not None else ())]
    for candidate in candidates:
        shift = [int(xi) if xi in (0, 1) else None for xi in candidate.xi]
        if candidate.tau != 0:
            if structure.conservative or not structure.workless:
                continue
        elif None not in shift and sympy.Matrix([*known, shift]).rank() == len(known):
            continue
        symmetry = _proven(equation, candidate)
        if symmetry is not None:
            known += [shift] if None not in shift and candidate.tau == 0 else []
            yield symmetry


def _proven(equation: SymmetryEquation, candidate: Symmetry) -> Symmetry | None:
    """Return a symmetry with its F, None where no proof is found."""
    try:
        with equation.stated.algebra.at_most(LARGEST):
            symmetry = equation.completed(candidate)
            return symmetry if symmetry is not None and equation.proven(symmetry) else None
    except TooLargeError:
        return None
