"""The laws of motion as graph nodes: p = dL/dv, f = dL/dq + Q - dD/dv, M a = h + G^T lambda, G a + gamma = 0.

M = d2L/dv2 and h = f - (d2L/dv dq) v - d2L/dv dt. The bias in h is one forward sweep over p along (v, 0, 1);
nothing is expanded and nothing is simplified beyond what the graph does by itself.
Source: H. Goldstein, C. Poole, J. Safko, Classical Mechanics, 3rd ed., 2002, sections 1.4, 1.5 and 2.7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from lagrange.equations.augmented import MotionForm, augmentation
from lagrange.equations.constraints import ConstraintEquations, check_rows, constraint_equations
from lagrange.equations.decisions import StatedLaws
from lagrange.equations.first_order import first_order_coordinates, with_ones, with_relations, without
from lagrange.equations.redundant import least_norm
from lagrange.equations.solve_plan import SolvePlan, plan_of
from lagrange.equations.state_layout import StateLayout
from lagrange.equations.structure import Structure, find_structure
from lagrange.errors import StatementError
from lagrange.graph.differentiate import gradient, tangents
from lagrange.graph.from_sympy import Translator
from lagrange.graph.node import Binding, Graph, Kind, Node
from lagrange.graph.share import share_sums
from lagrange.graph.to_sympy import to_sympy
from lagrange.statement.coordinate import acceleration_of, t
from lagrange.statement.inertia import first_order_remedy
from lagrange.statement.multiplier import multiplier
from lagrange.statement.statement import Statement


@dataclass(frozen=True, eq=False)
class Equations:
    """Every law of one system, as nodes of one graph.

    `q`, `v` and `parameters` are the symbols, n, n and k of them; `rate`, which is dq/dt, `momenta`, `forces`, `bias`
    and `accelerations` have n entries, `mass` n rows. `matrix` is M, or with m constraints [[M, G^T], [G, 0]], and
    `plan` solves with it: for the accelerations and behind them the `multipliers`, m of them, with the other sign. The
    equations are solved in the form `motion`, which has other momenta where M is singular; `matrix` has its M then.
    `leaves` maps the statement's SymPy leaves to symbols.
    `stated` are the constraints of the statement, with their `multipliers`; `constraints`, which are solved for, with
    `impulses` as theirs, lack those that are redundant, and also have the relations of the coordinates of
    `first_order`, which have no inertia.
    """

    graph: Graph
    q: tuple[Node, ...]
    v: tuple[Node, ...]
    rate: tuple[Node, ...]
    time: Node
    parameters: tuple[Node, ...]
    leaves: Mapping[Any, Node]
    lagrangian: Node
    momenta: tuple[Node, ...]
    forces: tuple[Node, ...]
    mass: tuple[tuple[Node, ...], ...]
    bias: tuple[Node, ...]
    energy: Node
    accelerations: tuple[Node, ...]
    multipliers: tuple[Node, ...]
    impulses: tuple[Node, ...]
    constraints: ConstraintEquations
    stated: ConstraintEquations
    first_order: tuple[int, ...]
    motion: MotionForm
    matrix: tuple[tuple[Node, ...], ...]
    plan: SolvePlan
    structure: Structure
    layout: StateLayout

    @property
    def state(self) -> dict[str, Sequence[Node]]:
        """The symbols of the state by part, as programs read them."""
        return {"q": self.q, "v": self.v}

    @property
    def solution(self) -> tuple[Node, ...]:
        """The unknowns that `plan` solves for: the accelerations, and the multipliers with the other sign."""
        return (*self.accelerations, *(-one for one in self.impulses))

    def translate(self, expression: Any) -> Node:
        """Return the node of a SymPy expression in q, v, accelerations, parameters and t."""
        return self._translator(expression)

    @cached_property
    def _translator(self) -> Translator:
        return Translator(self.graph, self.leaves)

    def express(self, node: Node) -> Any:
        """Return a node as SymPy, in the statement's symbols; what compiled code computes, to be read."""
        symbols = {leaf: name for name, leaf in self.leaves.items() if leaf.kind is Kind.SYMBOL}
        return to_sympy(node, symbols)


def euler_lagrange(statement: Statement, kept: Sequence[int] | None = None) -> Equations:
    """Form the equations of motion of a statement; of its constraints those `kept` are solved for, all unless given."""
    graph = Graph()
    q, v, time, parameters = _symbols(graph, statement)
    rate = v  # dq/dt
    leaves = dict(zip((*statement.coordinates, *statement.velocities), (*q, *v), strict=True))
    leaves |= {t: time, **dict(zip(statement.parameters, parameters, strict=True))}
    translate = Translator(graph, leaves)
    stated = [translate(e) for e in (statement.kinetic, statement.potential, statement.dissipation, *statement.forces)]
    kinetic, potential, dissipation, *applied = share_sums(graph, stated)
    lagrangian = kinetic - potential
    held = {one.name: translate(one.expression) for one in statement.constraints}
    constraints = constraint_equations(held, [one.holonomic for one in statement.constraints], q, v, time)
    check_rows(statement.constraints, constraints)
    momenta = conjugate_momenta(lagrangian, v)
    extra = applied_forces(applied, dissipation, v)
    forces = generalized_forces(lagrangian, q, extra)
    mass = mass_matrix(momenta, v)
    bias = bias_forces(forces, momenta, q, rate, time)
    first_order = first_order_coordinates(mass, bias, v, constraints)
    check_inertia(statement.names, mass, constraints, first_order)
    kept = range(len(constraints)) if kept is None else kept
    solved = with_relations(constraints.part(kept), first_order, statement.names, bias, q, v, time)
    motion = without(first_order, MotionForm(tuple(momenta), tuple(forces), tuple(bias)))
    motion, inertia = with_inertia(motion, mass, with_ones(first_order, mass), constraints.part(kept), q, v, time)
    matrix = system_matrix(inertia, solved)
    plan = plan_of(matrix, tuple(range(len(q), len(matrix))))
    accelerations, impulses = solve_motion(plan, matrix, motion.bias, solved)
    multipliers = least_norm(constraints, kept, impulses[: len(kept)])
    laws = StatedLaws(q, v, time, parameters, lagrangian, forces, momenta, extra, bias, mass, constraints)
    structure = find_structure(statement, laws, accelerations, first_order)
    known = {leaf: translate(value) for leaf, value in statement.prescribed}
    known |= zip(map(acceleration_of, statement.coordinates), accelerations, strict=True)
    known |= dict(zip(map(multiplier, constraints.names), multipliers, strict=True))
    return Equations(
        graph=graph,
        q=q,
        v=v,
        rate=rate,
        time=time,
        parameters=parameters,
        leaves=leaves | known,
        lagrangian=lagrangian,
        momenta=tuple(momenta),
        forces=tuple(forces),
        mass=mass,
        bias=tuple(bias),
        energy=jacobi_integral(lagrangian, momenta, v),
        accelerations=tuple(accelerations),
        multipliers=tuple(multipliers),
        impulses=tuple(impulses),
        constraints=solved,
        stated=constraints,
        first_order=first_order,
        motion=motion,
        matrix=matrix,
        plan=plan,
        structure=structure,
        layout=StateLayout(statement.names, statement.names),
    )


def with_inertia(
    motion: MotionForm,
    mass: tuple[tuple[Node, ...], ...],
    complete: Sequence[Sequence[Node]],
    constraints: ConstraintEquations,
    q: Sequence[Node],
    v: Sequence[Node],
    time: Node,
) -> tuple[MotionForm, tuple[tuple[Node, ...], ...]]:
    """Return the motion and its mass matrix, the inertia of constraints added where `complete` is singular."""
    added = augmentation(complete, constraints, q, v, time)
    if added is None:
        return motion, mass
    pairs = zip((motion.momenta, motion.forces), added, strict=True)
    p, f = ([a + b for a, b in zip(*pair, strict=True)] for pair in pairs)
    return MotionForm(tuple(p), tuple(f), tuple(bias_forces(f, p, q, v, time))), mass_matrix(p, v)


def conjugate_momenta(lagrangian: Node, v: Sequence[Node]) -> list[Node]:
    """Return p = dL/dv."""
    return gradient(lagrangian, v)


def applied_forces(forces: Sequence[Node], dissipation: Node, v: Sequence[Node]) -> list[Node]:
    """Return Q - dD/dv."""
    return [force - drag for force, drag in zip(forces, gradient(dissipation, v), strict=True)]


def generalized_forces(lagrangian: Node, q: Sequence[Node], applied: Sequence[Node]) -> list[Node]:
    """Return f = dL/dq + Q - dD/dv."""
    return [slope + force for slope, force in zip(gradient(lagrangian, q), applied, strict=True)]


def mass_matrix(momenta: Sequence[Node], v: Sequence[Node]) -> tuple[tuple[Node, ...], ...]:
    """Return M = dp/dv, n rows; the upper triangle mirrors the lower."""
    n = len(v)
    rows: list[list[Node]] = [[] for _ in range(n)]
    for j in range(n):
        column = tangents(momenta[j:], {v[j]: v[j].graph.one})
        for i in range(j, n):
            rows[i].append(column(momenta[i]))
    return tuple(tuple(rows[max(i, j)][min(i, j)] for j in range(n)) for i in range(n))


def check_inertia(
    names: Sequence[str],
    mass: Sequence[Sequence[Node]],
    constraints: ConstraintEquations,
    first_order: Sequence[int] = (),
) -> None:
    """Raise StatementError for a coordinate whose row of the mass matrix is zero, if nothing else holds it."""
    for i, (name, row) in enumerate(zip(names, mass, strict=True)):
        if i in first_order:
            continue
        alone = all(line[i] is line[i].graph.zero for line in constraints.gradient)
        if alone and all(entry is entry.graph.zero for entry in row):
            raise StatementError(no_inertia(name))


def no_inertia(name: str) -> str:
    """Return the sentence for a coordinate that the Lagrangian gives no inertia."""
    return (
        f"the Lagrangian has no term of second order in {name}.dot, so {name} has no inertia and its acceleration is "
        f"not determined: the mass matrix d2L/dv2 is singular. Add the kinetic energy of {name}, or make {name} a "
        f"parameter. {first_order_remedy(f'{name}.dot')}"
    )


def bias_forces(
    forces: Sequence[Node], momenta: Sequence[Node], q: Sequence[Node], v: Sequence[Node], time: Node
) -> list[Node]:
    """Return h = f - (dp/dq) v - dp/dt, so that M a = h."""
    along = tangents(momenta, {**dict(zip(q, v, strict=True)), **time.graph.rates})
    return [force - along(momentum) for force, momentum in zip(forces, momenta, strict=True)]


def jacobi_integral(lagrangian: Node, momenta: Sequence[Node], v: Sequence[Node]) -> Node:
    """Return v.p - L, which is T + V where T is quadratic in the velocities and V free of them."""
    graph = lagrangian.graph
    powers = [(1, graph.product(pair)) for pair in zip(v, momenta, strict=True)]
    return graph.sum([*powers, (-1, lagrangian)])


def system_matrix(mass: tuple[tuple[Node, ...], ...], constraints: ConstraintEquations) -> tuple[tuple[Node, ...], ...]:
    """Return [[M, G^T], [G, 0]], which is M itself without constraints."""
    if not len(constraints):
        return mass
    gradient, zero = constraints.gradient, mass[0][0].graph.zero
    upper = [(*row, *(line[i] for line in gradient)) for i, row in enumerate(mass)]
    return (*upper, *((*line, *(zero for _ in gradient)) for line in gradient))


def solve_motion(
    plan: SolvePlan, matrix: Sequence[Sequence[Node]], bias: Sequence[Node], constraints: ConstraintEquations
) -> tuple[list[Node], list[Node]]:
    """Return a and lambda of M a = h + G^T lambda and G a + gamma = 0."""
    found = plan.solved(matrix, [*bias, *(-gamma for gamma in constraints.bias)])
    n = len(bias)
    return found[:n], [-one for one in found[n:]]


def _symbols(graph: Graph, statement: Statement) -> tuple[tuple[Node, ...], tuple[Node, ...], Node, tuple[Node, ...]]:
    rates = dict(statement.inputs)
    parameters = tuple(
        graph.symbol(f"parameter {p.name}", Binding.TIME if p in rates else Binding.PARAMETER)
        for p in statement.parameters
    )
    time = graph.symbol("t", Binding.TIME)
    by_symbol = dict(zip(statement.parameters, parameters, strict=True))
    graph.rates = {time: graph.one, **{by_symbol[p]: by_symbol[rate] for p, rate in rates.items() if rate is not None}}
    q = tuple(graph.symbol(name, Binding.CONFIGURATION) for name in statement.names)
    v = tuple(graph.symbol(f"{name}.dot", Binding.VELOCITY) for name in statement.names)
    return q, v, time, parameters
