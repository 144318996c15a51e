"""The programs that a model offers, by name, each lowered from the equations when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lagrange.equations.euler_lagrange import Equations
from lagrange.graph.differentiate import tangents
from lagrange.graph.node import Binding, Node
from lagrange.graph.rebuild import substitute
from lagrange.program.lower import Named, lower
from lagrange.program.program import Program


@dataclass(frozen=True)
class Quantity:
    """What a model offers: the nodes of its results by name, and how many indices each entry has.

    For `solved` and `returned` see `Program`.
    """

    results: Callable[[Equations], Named]
    indices: int = 1
    solved: bool = False
    returned: tuple[str, ...] = ()


def rhs(equations: Equations) -> Named:
    """Return d[q, v]/dt = [v, a]."""
    return {"rate": equations.rate, "acceleration": equations.accelerations}


def jacobian(equations: Equations) -> Named:
    """Return d rhs / dy, (2n, 2n).

    With r = M a - h as a function of y at fixed a, the lower rows solve M da/dy = -dr/dy; r is one forward
    sweep over p along (v, a, 1), so no entry of M is differentiated.
    """
    graph = equations.graph
    # Symbols stand for the accelerations while differentiating: M times the solution of M a = h would cancel.
    a = [graph.symbol(f"acceleration {i}", Binding.ACCELERATION) for i in range(len(equations.v))]
    direction = dict(zip((*equations.q, *equations.v), (*equations.rate, *a), strict=True))
    along = tangents(equations.momenta, {**direction, equations.time: graph.one})
    residual = [along(p) - f for p, f in zip(equations.momenta, equations.forces, strict=True)]
    known = dict(zip(a, equations.accelerations, strict=True))
    columns = []
    for symbol in (*equations.q, *equations.v):
        column = tangents([*equations.rate, *residual], {symbol: graph.one})
        slopes = substitute([-column(entry) for entry in residual], known)
        columns.append([*map(column, equations.rate), *equations.plan.solved(equations.mass, slopes)])
    return {"jacobian": [entry for row in zip(*columns, strict=True) for entry in row]}


def momentum(equations: Equations) -> Named:
    """Return [p, f], p = dL/dv and f = dL/dq + Q - dD/dv, so that dp/dt = f."""
    return {"momenta": equations.momenta, "forces": equations.forces}


def momentum_jacobian(equations: Equations) -> Named:
    """Return d[p, f] / d[q, v], (2n, 2n); its upper right block is the mass matrix."""
    rows = [*equations.momenta, *equations.forces]
    columns = [tangents(rows, {symbol: equations.graph.one}) for symbol in (*equations.q, *equations.v)]
    return {"momentum_jacobian": [column(row) for row in rows for column in columns]}


QUANTITIES: dict[str, Quantity] = {
    "rhs": Quantity(rhs, solved=True, returned=("acceleration",)),
    "jacobian": Quantity(jacobian, 2, solved=True),
    "accelerations": Quantity(lambda e: {"acceleration": e.accelerations}, solved=True),
    "mass_matrix": Quantity(lambda e: {"mass_matrix": [entry for row in e.mass for entry in row]}, 2),
    "energy": Quantity(lambda e: {"energy": [e.energy]}, 0),
    "momenta": Quantity(lambda e: {"momenta": e.momenta}),
    "lagrangian": Quantity(lambda e: {"lagrangian": [e.lagrangian]}, 0),
    "forces": Quantity(lambda e: {"forces": e.forces}),
    "bias": Quantity(lambda e: {"bias": e.bias}),
    "momentum": Quantity(momentum, returned=("momenta", "forces")),
    "momentum_jacobian": Quantity(momentum_jacobian, 2),
}
"""Every quantity by name; `forces` is f = dL/dq + Q - dD/dv, `bias` is h of M a = h."""


def program_of(name: str, equations: Equations) -> Program:
    """Return the program of a quantity of `QUANTITIES`."""
    quantity = QUANTITIES[name]
    results = quantity.results(equations)
    count = sum(map(len, results.values()))
    shape = (round(count ** (1 / quantity.indices)),) * quantity.indices if quantity.indices else ()
    return lower(
        name,
        results,
        equations.state,
        equations.time,
        equations.parameters,
        shape=shape,
        returned=quantity.returned,
        solved=quantity.solved,
    )


def lower_nodes(
    name: str, nodes: Sequence[Node], equations: Equations, shape: tuple[int, ...] | None = None
) -> Program:
    """Return the program of any nodes of the equations' graph, as a function of t, q, v and parameters."""
    return lower(name, {name: nodes}, equations.state, equations.time, equations.parameters, shape=shape)
