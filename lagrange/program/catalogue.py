"""The programs that a model offers, by name, each lowered from the equations when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node
from lagrange.graph.rebuild import substitute
from lagrange.program.lower import lower
from lagrange.program.program import Program

Quantity = Callable[[Equations], tuple[Sequence[Node], tuple[int, ...]]]
"""Gives the nodes of a quantity and the shape that they fill."""


def rhs(equations: Equations) -> tuple[Sequence[Node], tuple[int, ...]]:
    """Return d[q, v]/dt = [v, a]."""
    return (*equations.v, *equations.accelerations), (2 * len(equations.q),)


def jacobian(equations: Equations) -> tuple[Sequence[Node], tuple[int, ...]]:
    """Return d rhs / dy, (2n, 2n).

    With r = M a - h as a function of y at fixed a, the lower rows solve M da/dy = -dr/dy; r is one forward
    sweep over p along (v, a, 1), so no entry of M is differentiated.
    """
    graph, n = equations.graph, len(equations.q)
    # Symbols stand for the accelerations while differentiating: M times the solution of M a = h would cancel.
    a = [graph.symbol(f"acceleration {i}", Binding.ACCELERATION) for i in range(n)]
    direction = dict(zip((*equations.q, *equations.v), (*equations.v, *a), strict=True))
    along = tangents(equations.momenta, {**direction, equations.time: graph.one})
    residual = [along(p) - f for p, f in zip(equations.momenta, equations.forces, strict=True)]
    known = dict(zip(a, equations.accelerations, strict=True))
    columns = []
    for symbol in (*equations.q, *equations.v):
        column = tangents(residual, {symbol: graph.one})
        columns.append(_solve(equations, substitute([-column(entry) for entry in residual], known)))
    upper = [graph.one if j == n + i else graph.zero for i in range(n) for j in range(2 * n)]
    return [*upper, *(columns[j][i] for i in range(n) for j in range(2 * n))], (2 * n, 2 * n)


def momentum(equations: Equations) -> tuple[Sequence[Node], tuple[int, ...]]:
    """Return [p, f], p = dL/dv and f = dL/dq + Q - dD/dv, so that dp/dt = f."""
    return (*equations.momenta, *equations.forces), (2 * len(equations.q),)


def momentum_jacobian(equations: Equations) -> tuple[Sequence[Node], tuple[int, ...]]:
    """Return d[p, f] / d[q, v], (2n, 2n); its upper right block is the mass matrix."""
    rows, shape = momentum(equations)
    columns = [tangents(rows, {symbol: equations.graph.one}) for symbol in (*equations.q, *equations.v)]
    return [column(row) for row in rows for column in columns], shape * 2


def _solve(equations: Equations, right: Sequence[Node]) -> list[Node]:
    """Return x of M x = right, block by block; the factors of M are shared by all right-hand sides."""
    found: dict[int, Node] = {}
    for block in equations.structure.blocks:
        matrix = [[equations.mass[i][j] for j in block] for i in block]
        found.update(zip(block, equations.graph.solve(matrix, [right[i] for i in block]), strict=True))
    return [found[i] for i in range(len(right))]


QUANTITIES: dict[str, Quantity] = {
    "rhs": rhs,
    "jacobian": jacobian,
    "accelerations": lambda e: (e.accelerations, (len(e.q),)),
    "mass_matrix": lambda e: ([entry for row in e.mass for entry in row], (len(e.q), len(e.q))),
    "energy": lambda e: ((e.energy,), ()),
    "momenta": lambda e: (e.momenta, (len(e.q),)),
    "lagrangian": lambda e: ((e.lagrangian,), ()),
    "forces": lambda e: (e.forces, (len(e.q),)),
    "bias": lambda e: (e.bias, (len(e.q),)),
    "momentum": momentum,
    "momentum_jacobian": momentum_jacobian,
}
"""Every quantity by name; `forces` is f = dL/dq + Q - dD/dv, `bias` is h of M a = h."""


def program_of(name: str, equations: Equations) -> Program:
    """Return the program of a quantity of `QUANTITIES`."""
    nodes, shape = QUANTITIES[name](equations)
    return lower_nodes(name, nodes, shape, equations)


def lower_nodes(name: str, nodes: Sequence[Node], shape: tuple[int, ...], equations: Equations) -> Program:
    """Return the program of any nodes of the equations' graph, as a function of t, y = [q, v] and parameters."""
    return lower(name, nodes, shape, (*equations.q, *equations.v), equations.time, equations.parameters)
