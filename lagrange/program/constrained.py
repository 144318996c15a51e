"""The law of methods whose unknowns are multipliers: momenta, forces, forces of constraints, and the constraints.

The m multipliers of n coordinates are padded to n entries, and so are the constraints: where no constraint stands,
the entry is the multiplier itself. A step that brings all entries to zero has padding multipliers of zero, and the
matrix of Newton's method is square and regular. A constraint on velocities has no phi: its multiplier takes the place
of phi. Momenta and forces are those of the solved form, whose mass matrix is regular.
"""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node
from lagrange.program.lower import Named


def multiplier_symbols(equations: Equations) -> list[Node]:
    """Return the symbols of the padded multipliers, n of them."""
    return [equations.graph.symbol(f"multiplier {i}", Binding.ACCELERATION) for i in range(len(equations.q))]


def constrained_inputs(equations: Equations) -> dict[str, Sequence[Node]]:
    """Return the inputs of the law by part: the state, followed by the multipliers."""
    return {**equations.state, "multipliers": multiplier_symbols(equations)}


def constrained(equations: Equations) -> Named:
    """Return p, f, G^T lambda, phi and psi, n entries each."""
    held, multipliers = equations.constraints, multiplier_symbols(equations)
    count = len(held)
    pushed = held.forces(multipliers[:count]) if count else [equations.graph.zero] * len(equations.q)
    places = [one if phi is None else phi for phi, one in zip(held.positions, multipliers, strict=False)]
    return {
        "momenta": equations.motion.momenta,
        "forces": equations.motion.forces,
        "constraint_forces": pushed,
        "positions": [*places, *multipliers[count:]],
        "velocities": [*held.velocities, *multipliers[count:]],
    }


def constrained_jacobian(equations: Equations) -> Named:
    """Return the derivative of that by q, v and lambda, (5n, 3n)."""
    rows = [node for block in constrained(equations).values() for node in block]
    symbols = [symbol for block in constrained_inputs(equations).values() for symbol in block]
    columns = [tangents(rows, {symbol: equations.graph.one}) for symbol in symbols]
    return {"constrained_jacobian": [column(row) for row in rows for column in columns]}
