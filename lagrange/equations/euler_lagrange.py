"""The laws of motion as graph nodes: p = dL/dv, f = dL/dq + Q - dD/dv, M a = h + G^T lambda, G a + gamma = 0."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from lagrange.equations.constraints import ConstraintEquations, check_rows, constraint_equations
from lagrange.equations.decisions import StatedLaws
from lagrange.equations.solve_plan import SolvePlan, plan_of
from lagrange.equations.state_layout import StateLayout
from lagrange.equations.structure import Structure, find_structure
from lagrange.errors import StatementError
from lagrange.graph.differentiate import gradient, tangents
from lagrange.graph.from_sympy import Translator
from lagrange.graph.generic import generic_rank
from lagrange.graph.node import Binding, Graph, Kind, Node
from lagrange.graph.rebuild import substitute
from lagrange.graph.share import share_sums
from lagrange.graph.to_sympy import to_sympy
from lagrange.statement.coordinate import acceleration_of, t
from lagrange.statement.energy import first_order_remedy
from lagrange.statement.multiplier import multiplier
from lagrange.statement.statement import Statement

Matrix = Sequence[Sequence[Node]]


@dataclass(frozen=True, eq=False)
class MotionForm:
    """The momenta and forces, n each, of dp/dt = f + G^T lambda as they are solved, and h of M a = h + G^T lambda."""

    momenta: tuple[Node, ...]
    forces: tuple[Node, ...]
    bias: tuple[Node, ...]


def augmentation(
    mass: Matrix, constraints: ConstraintEquations, q: Sequence[Node], v: Sequence[Node], time: Node
) -> tuple[list[Node], list[Node]] | None:
    """Return what is added to momenta and forces, None for a mass matrix that is regular by itself."""
    linear = [name not in constraints.nonlinear for name in constraints.names]
    if not any(linear) or generic_rank(mass) == len(q):
        return None
    graph = time.graph
    momenta, forces = [graph.zero] * len(q), [graph.zero] * len(q)
    along = {**dict(zip(q, v, strict=True)), **graph.rates}
    for psi, row, chosen in zip(constraints.velocities, constraints.gradient, linear, strict=True):
        if not chosen:
            continue
        pushed = psi * _weight(mass, row, (*q, *v, time))
        moved = tangents(row, along)
        for i, entry in enumerate(row):
            momenta[i] = momenta[i] + pushed * entry
            forces[i] = forces[i] + pushed * moved(entry)
    return momenta, forces


def _weight(mass: Matrix, row: Sequence[Node], symbols: Sequence[Node]) -> Node:
    """Return the size of the mass matrix over that of G^T G, with all that moves replaced by one."""
    graph = symbols[0].graph
    inertia = graph.sum([(1, mass[i][i]) for i in range(len(row))])
    square = graph.sum([(1, entry * entry) for entry in row])
    try:
        above, below = substitute([inertia, square], dict.fromkeys(symbols, graph.one))
        weight = above / below
    except StatementError:  # a pole at one
        return graph.one
    return weight if weight.binding <= Binding.PARAMETER and weight is not graph.zero else graph.one


RELATION = "equation of "
"""How the names of relations begin; no name of a user's has a space."""


def first_order_coordinates(
    mass: Sequence[Sequence[Node]], bias: Sequence[Node], v: Sequence[Node], constraints: ConstraintEquations
) -> tuple[int, ...]:
    """Return the coordinates without inertia that no constraint holds and whose equations determine velocities.

    `bias` is h of M a = h: of these coordinates 0 = h is the relation. What is left out has no inertia at all.
    """
    graph = v[0].graph
    chosen = [
        i
        for i, row in enumerate(mass)
        if all(entry is graph.zero for entry in (*row, *(line[i] for line in constraints.gradient)))
    ]
    while True:
        columns = {j: tangents([bias[i] for i in chosen], {v[j]: graph.one}) for j in chosen}
        alone = [
            i
            for i in chosen
            if all(columns[j](bias[i]) is graph.zero for j in chosen)
            or all(columns[i](bias[j]) is graph.zero for j in chosen)
        ]
        if not alone:
            return tuple(chosen)
        chosen = [i for i in chosen if i not in alone]


def without(chosen: Sequence[int], motion: MotionForm) -> MotionForm:
    """Return the equations to be solved without those of the coordinates chosen, for which relations stand."""

    def cleared(entries: Sequence[Node]) -> tuple[Node, ...]:
        return tuple(entry.graph.zero if i in chosen else entry for i, entry in enumerate(entries))

    return MotionForm(cleared(motion.momenta), cleared(motion.forces), cleared(motion.bias))


def with_ones(chosen: Sequence[int], mass: Matrix) -> Matrix:
    """Return a mass matrix with an inertia of one for the coordinates chosen, to see whether the others have theirs."""
    return [
        [entry.graph.one if i == j and i in chosen else entry for j, entry in enumerate(row)]
        for i, row in enumerate(mass)
    ]


def with_relations(
    constraints: ConstraintEquations,
    chosen: Sequence[int],
    names: Sequence[str],
    bias: Sequence[Node],
    q: Sequence[Node],
    v: Sequence[Node],
    time: Node,
) -> ConstraintEquations:
    """Return the constraints with the relations of the coordinates chosen behind them."""
    if not chosen:
        return constraints
    graph = time.graph
    relations = tuple(bias[i] for i in chosen)
    columns = [tangents(relations, {symbol: graph.one}) for symbol in v]
    rate = tangents(relations, {**dict(zip(q, v, strict=True)), **graph.rates})
    return constraints.joined(
        ConstraintEquations(
            names=tuple(f"{RELATION}{names[i]}" for i in chosen),
            positions=tuple(None for _ in chosen),
            velocities=relations,
            gradient=tuple(tuple(column(psi) for column in columns) for psi in relations),
            bias=tuple(map(rate, relations)),
            rest=tuple(substitute(relations, dict.fromkeys(v, graph.zero))),
        )
    )


def least_norm(stated: ConstraintEquations, kept: Sequence[int], multipliers: Sequence[Node]) -> list[Node]:
    """Return the multipliers of all constraints from those of the constraints kept, whose rows span all rows."""
    others = [i for i in range(len(stated)) if i not in kept]
    if not others:
        return list(multipliers)
    graph = multipliers[0].graph
    rows = [stated.gradient[i] for i in kept]

    def products(row: Sequence[Node]) -> list[Node]:
        return [_dot(row, other) for other in rows]

    square = [products(row) for row in rows]
    shares = [graph.solve(square, products(stated.gradient[i])) for i in others]
    one = graph.one
    gram = [
        [graph.sum([(int(a == b), one), *((1, c[a] * c[b]) for c in shares)]) for b in range(len(rows))]
        for a in range(len(rows))
    ]
    weights = graph.solve(gram, list(multipliers))
    found = dict(zip(kept, weights, strict=True))
    found |= {i: _dot(c, weights) for i, c in zip(others, shares, strict=True)}
    return [found[i] for i in range(len(stated))]


def _dot(a: Sequence[Node], b: Sequence[Node]) -> Node:
    return a[0].graph.sum([(1, x * y) for x, y in zip(a, b, strict=True)])


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
