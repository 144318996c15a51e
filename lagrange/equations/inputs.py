"""Removal of inputs that the equations do not contain. Inputs are parameters whose values change, and their rates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lagrange.equations.euler_lagrange import Equations
from lagrange.statement.statement import Statement


def with_needed_inputs(statement: Statement, equations: Equations) -> tuple[Statement, Equations]:
    """Return a statement and its equations without the inputs that neither contains.

    Equations are formed with more rates of each input than most of them contain.
    """
    e = equations
    nodes = [e.lagrangian, e.energy, *e.momenta, *e.forces, *e.bias, *e.accelerations, *e.multipliers, *e.impulses]
    nodes += [*e.motion.momenta, *e.motion.forces, *e.motion.bias, *(entry for row in e.matrix for entry in row)]
    for held in (e.constraints, e.stated):
        nodes += [*(phi for phi in held.positions if phi is not None), *held.velocities, *held.bias]
    depends = 0
    for node in nodes:
        depends |= node.depends
    drawn = {s for point in statement.positions.values() for entry in point for s in entry.free_symbols}
    pairs = zip(statement.parameters, e.parameters, strict=True)
    rates = dict(statement.inputs)
    dropped = {
        symbol for symbol, node in pairs if symbol in rates and symbol not in drawn and not node.depends & depends
    }

    def has(expression: Any) -> bool:
        return bool(expression.free_symbols & dropped)

    known = dict(statement.prescribed)
    lost = {leaf for leaf in e.leaves if leaf in dropped or (leaf in known and has(known[leaf]))}
    kept = [place for place, symbol in enumerate(statement.parameters) if symbol not in dropped]
    return (
        replace(
            statement,
            parameters=tuple(statement.parameters[place] for place in kept),
            inputs=tuple((s, rate if rate not in dropped else None) for s, rate in rates.items() if s not in dropped),
            prescribed=tuple((leaf, value) for leaf, value in statement.prescribed if not has(value)),
        ),
        replace(
            e,
            parameters=tuple(e.parameters[place] for place in kept),
            leaves={leaf: node for leaf, node in e.leaves.items() if leaf not in lost},
        ),
    )
