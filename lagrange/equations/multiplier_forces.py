"""Forces that contain multipliers of constraints, such as Coulomb friction: multipliers as functions of the state.

With forces Q + B lambda the equations are M a = h + (G^T + B) lambda and G a + gamma = 0. They are solved for lambda.
If the solution is inserted into the forces, these depend on positions, velocities and time alone, and the constraints
have the same multipliers.
Source: P. Painleve, Lecons sur le frottement, 1895; F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral
Contacts, 1996, section 5.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import sympy

from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.equations.solve_plan import eliminated
from lagrange.errors import StatementError, listing
from lagrange.graph.differentiate import tangents
from lagrange.graph.generic import generic_rank
from lagrange.graph.node import Node, reachable
from lagrange.graph.rebuild import substitute
from lagrange.statement.coordinate import check_multipliers, constraint_of, multiplier
from lagrange.statement.statement import REFUSE, Statement

MOST_WRITTEN_OPERATIONS = 20_000_000
"""Largest number of operations of the multipliers, counted without sharing. SymPy shares parts of expressions but
compares them one by one, in a time that grows with this number. A chain of ten links on a rough rail compiles in 10 s;
each further link doubles that."""


def with_solved_multipliers(statement: Statement) -> Statement:
    """Return the statement with each multiplier in its forces replaced by a function of the state.

    A statement without multipliers in its forces is returned unchanged. Raises StatementError for multipliers of
    unknown constraints, for forces that are not linear in the multipliers, for redundant constraints, for coordinates
    without inertia, and if the multipliers are not determined.
    """
    free = sorted(sympy.Tuple(*statement.forces).free_symbols, key=str)
    names = [name for symbol in free if (name := constraint_of(symbol)) is not None]
    if not names:
        return statement
    check_multipliers(names, "a force", [constraint.name for constraint in statement.constraints], statement.name)
    if statement.redundant != REFUSE:
        raise StatementError(
            f"the forces of {statement.name} contain multipliers, which redundant constraints share in many ways: "
            "leave out the constraints that follow from others, and redundant='allow'."
        )
    symbols = [multiplier(name) for name in names]
    _check_linear(statement, symbols)
    equations = euler_lagrange(replace(statement, parameters=(*statement.parameters, *symbols)))
    nodes = _multipliers(equations, statement.name, names)
    if (size := _written_out(nodes)) > MOST_WRITTEN_OPERATIONS:
        raise StatementError(
            f"the multipliers in the forces of {statement.name} have {size:.2g} operations when written out, more than "
            f"{MOST_WRITTEN_OPERATIONS:.0e}: state fewer coordinates, or a force in coordinates and velocities."
        )
    values = dict(zip(symbols, map(equations.express, nodes), strict=True))
    return replace(statement, forces=tuple(force.xreplace(values) for force in statement.forces))


def _written_out(nodes: Sequence[Node]) -> int:
    """Return the number of operations in the formulas of nodes; a shared node counts as often as it is used."""
    sizes: dict[Node, int] = {}
    for node in reachable(nodes):
        sizes[node] = len(node.args) + sum(sizes[arg] for arg in node.args)
    return sum(sizes[node] for node in nodes)


def _check_linear(statement: Statement, symbols: Sequence[Any]) -> None:
    """Raise StatementError for a force that is not linear in the multipliers `symbols`."""
    for name, force in zip(statement.names, statement.forces, strict=True):
        if any(force.diff(symbol).has(*symbols) for symbol in symbols):
            used = [str(symbol) for symbol in symbols if force.has(symbol)]
            raise StatementError(
                f"the force on {name} is not linear in {listing(used)}: give a coefficient in coordinates, velocities "
                f"and parameters times a multiplier, such as -mu*{used[0]}*sign({name}.dot), and end the run by an "
                "event where the multiplier changes sign."
            )


def _multipliers(equations: Equations, system_name: str, constraint_names: Sequence[str]) -> list[Node]:
    """Return the multipliers of constraints as functions of the state.

    The symbols of these multipliers are the last parameters of the equations.
    """
    e = equations
    n, zero, symbols = len(e.q), e.graph.zero, e.parameters[-len(constraint_names) :]
    right = [*e.motion.bias, *(-gamma for gamma in e.constraints.bias)]
    relations = any(psi.depends & symbol.depends for psi in e.constraints.velocities for symbol in symbols)
    if relations or generic_rank(e.matrix) < len(e.matrix):
        raise StatementError(
            f"the forces of {system_name} contain multipliers, and its mass matrix d2L/dv2 is singular: give every "
            "coordinate kinetic energy, or state the force in coordinates and velocities."
        )
    indices = [n + e.stated.names.index(name) for name in constraint_names]
    matrix = [list(row) for row in e.matrix]
    for symbol, index in zip(symbols, indices, strict=True):
        slope = tangents(right, {symbol: e.graph.one})
        for row, entry in zip(matrix, right, strict=True):
            row[index] = row[index] + slope(entry)
    if generic_rank(matrix) < len(matrix):
        raise StatementError(
            f"the multipliers of {system_name} are not determined: its constraints depend on one another, or the "
            "forces cancel those of a constraint. Change the forces that contain multipliers."
        )
    order = [unknown for block in e.plan.blocks for unknown in block]
    solution = eliminated(matrix, substitute(right, dict.fromkeys(symbols, zero)), order)
    return [-solution[index] for index in indices]
