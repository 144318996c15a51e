"""Derive the equations of motion as graph nodes: p = dL/dv, M a = h + G^T lambda, G a + gamma = 0.

p are the momenta, f = dL/dq + Q - dD/dv the forces with the stated forces Q and the dissipation function D, M the mass
matrix, and h the terms of the equations without accelerations a and multipliers lambda. G and gamma are explained in
`constraints`. This module also has the layout of a state, translates a user's expressions into nodes, and selects the
inputs that equations contain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from lagrange.equations.body_rates import Turning, turning
from lagrange.equations.constraints import (
    ConstraintEquations,
    check_rows,
    constraint_equations,
    velocity_equations,
)
from lagrange.equations.decisions import StatedLaws
from lagrange.equations.solve_plan import SolvePlan, eliminated, plan_of
from lagrange.equations.structure import Structure, find_structure
from lagrange.errors import StatementError
from lagrange.graph.differentiate import gradient, tangents
from lagrange.graph.evaluate import generic_rank
from lagrange.graph.node import Binding, Graph, Kind, Node, share_sums, substitute
from lagrange.graph.sympy_nodes import Translator, to_sympy
from lagrange.statement.coordinate import acceleration_of, check_multipliers, multiplier, t
from lagrange.statement.energy import first_order_remedy
from lagrange.statement.expression import expression as expression_of
from lagrange.statement.expression import in_full
from lagrange.statement.parameters import Survey, in_own_parameters
from lagrange.statement.rotation import quaternion_rows
from lagrange.statement.statement import Statement


@dataclass(frozen=True)
class StateLayout:
    """Layout of the state y = [q, v].

    `coordinates` are the names of q. `rates` are the names of the quantities whose time derivatives are v, which are
    `coordinates` if v = dq/dt. `rotations` are the names of the rotations whose quaternions are among the coordinates.
    """

    coordinates: tuple[str, ...]
    rates: tuple[str, ...]
    rotations: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Number 2n of entries of a state."""
        return len(self.coordinates) + len(self.rates)

    @cached_property
    def q(self) -> slice:
        """Slice of the coordinates in a state."""
        return slice(0, len(self.coordinates))

    @cached_property
    def v(self) -> slice:
        """Slice of the velocities in a state."""
        return slice(len(self.coordinates), self.size)

    def split(self, y: Any) -> tuple[Any, Any]:
        """Return the coordinates and the velocities of a state (2n,), or of many states (2n, batch)."""
        return y[self.q], y[self.v]

    def names(self, ending: str = "_dot") -> tuple[str, ...]:
        """Return the names of a state's entries. `ending` is the suffix of velocities, as in theta and theta_dot."""
        return (*self.coordinates, *(f"{name}{ending}" for name in self.rates))


Matrix = Sequence[Sequence[Node]]


@dataclass(frozen=True, eq=False)
class MotionForm:
    """Equations of motion in the form that is solved: momenta p, forces f and bias h, with n entries each.

    The equations are dp/dt = f + G^T lambda, and M a = h + G^T lambda. M is the mass matrix, a are the accelerations,
    and G^T lambda the forces of constraints with the multipliers lambda.
    """

    momenta: tuple[Node, ...]
    forces: tuple[Node, ...]
    bias: tuple[Node, ...]


def with_inertia(
    laws: StatedLaws, motion: MotionForm, first_order: Sequence[int], constraints: ConstraintEquations
) -> tuple[MotionForm, tuple[tuple[Node, ...], ...]]:
    """Return the equations and their mass matrix M. If M is singular, terms are added that make it regular.

    `laws` are the stated equations, and `motion` the form to be solved. Each constraint psi that is linear in the
    velocities adds w psi G^T to the momenta and w psi dG^T/dt to the forces, where G is its gradient. These terms
    vanish on the constraint. The weight w is `_weight`. Coordinates of first order (indices `first_order`) need no
    inertia.
    """
    linear = [name not in constraints.nonlinear for name in constraints.names]
    q, v, time, mass, graph = laws.q, laws.v, laws.time, laws.mass, laws.time.graph
    with_ones = [
        [graph.one if i == j and i in first_order else entry for j, entry in enumerate(row)]
        for i, row in enumerate(mass)
    ]
    if not any(linear) or generic_rank(with_ones) == len(q):
        return motion, mass
    momenta, forces = [graph.zero] * len(q), [graph.zero] * len(q)
    along = {**dict(zip(q, v, strict=True)), **graph.rates}
    for psi, row, chosen in zip(constraints.velocities, constraints.gradient, linear, strict=True):
        if not chosen:
            continue
        pushed = psi * _weight(with_ones, row, (*q, *v, time))
        moved = tangents(row, along)
        for i, entry in enumerate(row):
            momenta[i] = momenta[i] + pushed * entry
            forces[i] = forces[i] + pushed * moved(entry)
    p = [a + b for a, b in zip(motion.momenta, momenta, strict=True)]
    f = [a + b for a, b in zip(motion.forces, forces, strict=True)]
    return MotionForm(tuple(p), tuple(f), tuple(bias_forces(f, p, q, v, time))), mass_matrix(p, v)


def _weight(mass: Matrix, gradient_row: Sequence[Node], symbols: Sequence[Node]) -> Node:
    """Return the weight w of a constraint, with which the added inertia w G^T G has the trace of the mass matrix M.

    G is here the constraint's row `gradient_row`, and w is trace(M)/|G|^2 with coordinates, velocities and the time
    (`symbols`) set to 1. If this is zero, has no value, or is not constant, the weight is 1.
    """
    graph = symbols[0].graph
    inertia = graph.sum([(1, mass[i][i]) for i in range(len(gradient_row))])
    square = graph.sum([(1, entry * entry) for entry in gradient_row])
    try:
        above, below = substitute([inertia, square], dict.fromkeys(symbols, graph.one))
        weight = above / below
    except StatementError:  # A denominator is zero where all symbols are 1
        return graph.one
    return weight if weight.binding <= Binding.PARAMETER and weight is not graph.zero else graph.one


RELATION = "equation of "  # Prefix of the names of first-order equations. Names of users have no spaces.


def first_order_coordinates(laws: StatedLaws) -> tuple[int, ...]:
    """Return the indices of the coordinates without inertia whose equations in `laws` determine their velocities.

    They are called coordinates of first order. Coordinates in constraints are not among them. The equations of such
    coordinates are the relations 0 = h. If the relation of a coordinate determines no velocity, the coordinate is left
    out, and `check_inertia` raises an error for it.
    """
    v, bias, graph = laws.v, laws.bias, laws.time.graph
    chosen = [
        i
        for i, row in enumerate(laws.mass)
        if all(entry is graph.zero for entry in (*row, *(line[i] for line in laws.constraints.gradient)))
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


def without_first_order(first_order: Sequence[int], motion: MotionForm, rates: Mapping[Node, Node]) -> MotionForm:
    """Return the equations `motion` with zero momenta, forces and bias for the coordinates of first order.

    These coordinates have no inertia. `first_order` has their indices. Their equations are relations between
    velocities, and are added to the constraints. `rates` maps their velocities to the values from these relations.
    These values replace the velocities in the other entries.
    """
    if not first_order:
        return motion

    def cleared(entries: Sequence[Node]) -> tuple[Node, ...]:
        settled = enumerate(substitute(entries, rates))
        return tuple(entry.graph.zero if i in first_order else entry for i, entry in settled)

    return MotionForm(cleared(motion.momenta), cleared(motion.forces), cleared(motion.bias))


def with_relations(
    laws: StatedLaws, constraints: ConstraintEquations, first_order: Sequence[int], names: Sequence[str]
) -> tuple[ConstraintEquations, dict[Node, Node]]:
    """Return the constraints, followed by the first-order equations 0 = h as relations between velocities.

    Coordinates of first order have no inertia. `first_order` has their indices, `laws` the stated equations with h, and
    `names` the names of all coordinates. The second result maps the velocities of coordinates of first order to their
    values from these equations. It is empty if the equations cannot be solved for the velocities as formulas.
    """
    if not first_order:
        return constraints, {}
    relations = {f"{RELATION}{names[i]}": laws.bias[i] for i in first_order}
    solved = constraints.joined(velocity_equations(relations, laws.q, laws.v, laws.time))
    rates = first_order_rates(solved, first_order, laws.v)
    return replace(solved, bias=tuple(substitute(solved.bias, rates))), rates


MOST_SETTLED = 12
"""Largest number n of coupled first-order equations that are solved as formulas, which takes n**3/3 operations."""


def first_order_rates(solved: ConstraintEquations, first_order: Sequence[int], v: Sequence[Node]) -> dict[Node, Node]:
    """Return {velocity: formula} for the coordinates of first order, solved from their equations.

    These coordinates have no inertia. `first_order` has their indices, and `v` the symbols of all velocities. Their
    equations are the last ones of `solved`, in this order. The velocities in a state may differ from the formulas after
    a jump of a force, or if the start leaves them at zero. The result is {} if the equations are not linear in the
    velocities, do not determine them, or are coupled and more than `MOST_SETTLED`.
    """
    count = len(first_order)
    square = [[row[i] for i in first_order] for row in solved.gradient[-count:]]
    coupled = any(entry is not entry.graph.zero for i, row in enumerate(square) for entry in (*row[:i], *row[i + 1 :]))
    if (coupled and count > MOST_SETTLED) or generic_rank(square) < count:
        return {}
    at_zero = dict.fromkeys((v[i] for i in first_order), v[0].graph.zero)
    entries = [entry for row in square for entry in row]
    if substitute(entries, at_zero) != entries:
        return {}
    rest = [-relation for relation in substitute(solved.velocities[-count:], at_zero)]
    return dict(zip((v[i] for i in first_order), eliminated(square, rest, range(count)), strict=True))


def least_norm(stated: ConstraintEquations, kept: Sequence[int], multipliers: Sequence[Node]) -> list[Node]:
    """Return multipliers of all constraints `stated` that give the same forces as those of independent constraints.

    `kept` has the indices of the independent constraints, and `multipliers` their multipliers. The forces can be shared
    among dependent constraints in many ways. The result has the least norm.
    """
    others = [i for i in range(len(stated)) if i not in kept]
    if not others:
        return list(multipliers)
    graph = multipliers[0].graph
    rows = [stated.gradient[i] for i in kept]

    def products(row: Sequence[Node]) -> list[Node]:
        return [_dot(row, other) for other in rows]

    square = [products(row) for row in rows]
    order = range(len(rows))
    shares = [eliminated(square, products(stated.gradient[i]), order) for i in others]
    gram = [
        [graph.sum([(int(a == b), graph.one), *((1, c[a] * c[b]) for c in shares)]) for b in range(len(rows))]
        for a in range(len(rows))
    ]
    weights = eliminated(gram, list(multipliers), order)
    by_index = dict(zip(kept, weights, strict=True))
    by_index |= {i: _dot(c, weights) for i, c in zip(others, shares, strict=True)}
    return [by_index[i] for i in range(len(stated))]


def _dot(a: Sequence[Node], b: Sequence[Node]) -> Node:
    return a[0].graph.sum([(1, x * y) for x, y in zip(a, b, strict=True)])


@dataclass(frozen=True, eq=False)
class Equations:
    """All equations of one system, as nodes of one graph: M a = h + G^T lambda, and G a + gamma = 0.

    - `q`, `v` and `parameters` are symbols: n, n and k of them. `leaves` maps the statement's SymPy symbols to nodes.
    - `rate` (dq/dt), `momenta` (dL/dv), `forces` (dL/dq + Q - dD/dv), `bias` (h) and `accelerations` (a) have n entries
      each. `mass` has the n rows of M.
    - `stated` are the constraints of the statement, and `multipliers` their multipliers.
    - `constraints` are the constraints that are solved, and `impulses` their multipliers lambda. Redundant constraints
      are left out. The relations of coordinates without inertia, whose indices are `first_order`, are added.
    - `motion` has momenta, forces and h as solved. If M is singular, terms that vanish on the constraints are added.
    - `matrix` is the M of `motion`, or with constraints [[M, G^T], [G, 0]]. `plan` solves linear systems with it. The
      unknowns are the accelerations, followed by `impulses` with the opposite sign.
    - `turning` are the equations in angular velocities of bodies, None without rotations or with constraints.
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
    turning: Turning | None

    @property
    def state(self) -> dict[str, Sequence[Node]]:
        """Symbols of the coordinates, with the key "q", and of the velocities, with the key "v"."""
        return {"q": self.q, "v": self.v}

    @cached_property
    def rates_are_solved(self) -> bool:
        """True if dq/dt of the coordinates of first order (without inertia) is computed from their equations.

        Then the velocities of these coordinates in a state are not used. False if there are no such coordinates, or if
        their equations cannot be solved for the velocities as formulas.
        """
        return any(rate is not v for rate, v in zip(self.rate, self.v, strict=True))

    @property
    def has_unsolved_rates(self) -> bool:
        """True if there are coordinates without inertia whose velocities are not computed by formulas.

        These velocities are then taken from the state, which must satisfy the equations of these coordinates.
        """
        return bool(self.first_order) and not self.rates_are_solved

    @cached_property
    def following(self) -> list[int]:
        """Indices in a state (2n,) of the velocities of coordinates of first order, which follow from other entries."""
        return [self.layout.v.start + i for i in self.first_order]

    @cached_property
    def quaternions(self) -> list[list[int]]:
        """Indices in q of the four entries of each quaternion, a list for each rotation."""
        coordinates = {node: leaf for leaf, node in self.leaves.items()}
        return [rows for _, rows, _ in quaternion_rows(tuple(coordinates[node] for node in self.q))]

    @property
    def solution(self) -> tuple[Node, ...]:
        """Unknowns for which `plan` solves: accelerations, then the multipliers `impulses` with the opposite sign."""
        return (*self.accelerations, *(-impulse for impulse in self.impulses))

    def translate(self, expression: Any) -> Node:
        """Return a SymPy expression in q, v, accelerations, parameters, t and entries of rotations as a node."""
        return self._translator(in_full(expression))

    @cached_property
    def programs(self) -> dict[str, Any]:
        """Cache {name: program} of programs that compute quantities, for all targets. `program_of` fills it."""
        return {}

    @cached_property
    def _translator(self) -> Translator:
        return Translator(self.graph, self.leaves)

    def express(self, node: Node) -> Any:
        """Return a node as a SymPy expression in the statement's symbols: the formula that compiled code evaluates."""
        symbols = {leaf: name for name, leaf in self.leaves.items() if leaf.kind is Kind.SYMBOL}
        return to_sympy(node, symbols)


def euler_lagrange(statement: Statement, kept: Sequence[int] | None = None) -> Equations:
    """Return the equations of motion of a statement; `kept` are the indices of independent constraints (None: all)."""
    graph = Graph()
    q, v, time, parameters = _symbols(graph, statement)
    symbols = (*statement.coordinates, *statement.velocities, t, *statement.parameters)
    leaves = dict(zip(symbols, (*q, *v, time, *parameters), strict=True))
    translate = Translator(graph, leaves)
    stated = [translate(e) for e in (statement.kinetic, statement.potential, statement.dissipation, *statement.forces)]
    kinetic, potential, dissipation, *applied = share_sums(graph, stated)
    lagrangian = kinetic - potential
    zeros = {c.name: translate(c.expression) for c in statement.constraints}
    constraints = constraint_equations(zeros, [c.holonomic for c in statement.constraints], q, v, time)
    check_rows(statement.constraints, constraints)
    momenta = conjugate_momenta(lagrangian, v)
    extra = applied_forces(applied, dissipation, v)
    forces = generalized_forces(lagrangian, q, extra)
    mass = mass_matrix(momenta, v)
    bias = bias_forces(forces, momenta, q, v, time)
    laws = StatedLaws(q, v, time, parameters, lagrangian, forces, momenta, extra, bias, mass, constraints)
    first_order = first_order_coordinates(laws)
    check_inertia(statement.names, laws, first_order)
    kept = range(len(constraints)) if kept is None else kept
    solved, rates = with_relations(laws, constraints.part(kept), first_order, statement.names)
    motion = without_first_order(first_order, MotionForm(tuple(momenta), tuple(forces), tuple(bias)), rates)
    motion, inertia = with_inertia(laws, motion, first_order, constraints.part(kept))
    matrix = system_matrix(inertia, solved)
    plan = plan_of(matrix, tuple(range(len(q), len(matrix))))
    accelerations, impulses = solve_motion(plan, matrix, motion.bias, solved)
    multipliers = least_norm(constraints, kept, impulses[: len(kept)])
    structure = find_structure(statement, laws, accelerations, first_order)
    prescribed = {leaf: translate(value) for leaf, value in statement.prescribed}
    prescribed |= zip(map(acceleration_of, statement.coordinates), accelerations, strict=True)
    prescribed |= dict(zip(map(multiplier, constraints.names), multipliers, strict=True))
    return Equations(
        graph=graph,
        q=q,
        v=v,
        rate=tuple(rates.get(velocity, velocity) for velocity in v),
        time=time,
        parameters=parameters,
        leaves=leaves | prescribed,
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
        layout=StateLayout(statement.names, statement.names, statement.rotations),
        turning=turning(statement, graph, leaves | prescribed),
    )


def conjugate_momenta(lagrangian: Node, v: Sequence[Node]) -> list[Node]:
    """Return the momenta p = dL/dv of the `lagrangian` L, one for each of the velocities `v`."""
    return gradient(lagrangian, v)


def applied_forces(forces: Sequence[Node], dissipation: Node, v: Sequence[Node]) -> list[Node]:
    """Return the stated `forces` Q less the forces dD/dv of the dissipation D, one for each of the velocities `v`."""
    return [force - drag for force, drag in zip(forces, gradient(dissipation, v), strict=True)]


def generalized_forces(lagrangian: Node, q: Sequence[Node], applied: Sequence[Node]) -> list[Node]:
    """Return the forces dL/dq + `applied` of the `lagrangian` L, one for each of the coordinates `q`."""
    return [slope + force for slope, force in zip(gradient(lagrangian, q), applied, strict=True)]


def mass_matrix(momenta: Sequence[Node], v: Sequence[Node]) -> tuple[tuple[Node, ...], ...]:
    """Return the mass matrix M = dp/dv, n rows, from the momenta p and the velocities `v`.

    M is symmetric: its upper triangle is copied from the lower one.
    """
    n = len(v)
    rows: list[list[Node]] = [[] for _ in range(n)]
    for j in range(n):
        column = tangents(momenta[j:], {v[j]: v[j].graph.one})
        for i in range(j, n):
            rows[i].append(column(momenta[i]))
    return tuple(tuple(rows[max(i, j)][min(i, j)] for j in range(n)) for i in range(n))


def check_inertia(names: Sequence[str], laws: StatedLaws, first_order: Sequence[int]) -> None:
    """Raise StatementError for a coordinate without inertia and without constraints, unless it is of first order.

    `names` are those of all coordinates, `laws` has the mass matrix, and `first_order` the indices of coordinates of
    first order.
    """
    for i, (name, row) in enumerate(zip(names, laws.mass, strict=True)):
        column = (line[i] for line in laws.constraints.gradient)
        if i not in first_order and all(entry is entry.graph.zero for entry in (*column, *row)):
            raise StatementError(no_inertia(name))


def no_inertia(name: str) -> str:
    """Return the error message for a coordinate `name` without inertia in the Lagrangian."""
    return (
        f"the Lagrangian has no term of second order in {name}.dot, so {name} has no inertia and its acceleration is "
        f"not determined: the mass matrix d2L/dv2 is singular. Add the kinetic energy of {name}, or make {name} a "
        f"parameter. {first_order_remedy(f'{name}.dot')}"
    )


def bias_forces(
    forces: Sequence[Node], momenta: Sequence[Node], q: Sequence[Node], v: Sequence[Node], time: Node
) -> list[Node]:
    """Return the right-hand sides h = f - (dp/dq) v - dp/dt of the equations M a = h, n nodes.

    f are the `forces`, p the `momenta`, q, v and t the symbols of coordinates, velocities and time. M is the mass
    matrix, and a are the accelerations.
    """
    along = tangents(momenta, {**dict(zip(q, v, strict=True)), **time.graph.rates})
    return [force - along(momentum) for force, momentum in zip(forces, momenta, strict=True)]


def jacobi_integral(lagrangian: Node, momenta: Sequence[Node], v: Sequence[Node]) -> Node:
    """Return the Jacobi integral v.p - L of the Lagrangian L, where p are the `momenta`.

    It is T + V if the kinetic energy T is quadratic in the velocities `v`, and the potential V does not contain them.
    """
    graph = lagrangian.graph
    powers = [(1, graph.product(pair)) for pair in zip(v, momenta, strict=True)]
    return graph.sum([*powers, (-1, lagrangian)])


def system_matrix(mass: tuple[tuple[Node, ...], ...], constraints: ConstraintEquations) -> tuple[tuple[Node, ...], ...]:
    """Return the matrix [[M, G^T], [G, 0]] of the linear system for accelerations and multipliers.

    M is the mass matrix, which is the result without constraints. G has the gradients of the constraints.
    """
    if not len(constraints):
        return mass
    gradient, zero = constraints.gradient, mass[0][0].graph.zero
    upper = [(*row, *(line[i] for line in gradient)) for i, row in enumerate(mass)]
    return (*upper, *((*line, *(zero for _ in gradient)) for line in gradient))


def solve_motion(
    plan: SolvePlan, matrix: Sequence[Sequence[Node]], bias: Sequence[Node], constraints: ConstraintEquations
) -> tuple[list[Node], list[Node]]:
    """Return the accelerations a and the multipliers lambda of M a = h + G^T lambda and G a + gamma = 0.

    `matrix` is [[M, G^T], [G, 0]], `plan` is the plan to solve it, and `bias` is h. `constraints` has gamma.
    """
    unknowns = plan.solved(matrix, [*bias, *(-gamma for gamma in constraints.bias)])
    n = len(bias)
    return unknowns[:n], [-unknown for unknown in unknowns[n:]]


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


def node_of(expression: Any, statement: Statement, equations: Equations) -> Node:
    """Return a user's expression as a node of the statement's equations. Raises StatementError for unknown symbols."""
    stated = expression_of(expression, "the expression")
    expression = in_own_parameters(stated, statement.parameters)
    survey = Survey().add(expression, "the expression", accelerations=True, multipliers=True)
    check_multipliers(
        survey.multipliers, "the expression", [constraint.name for constraint in statement.constraints], statement.name
    )
    survey.require(equations.leaves, "the expression", ".")
    return equations.translate(expression)


def with_needed_inputs(statement: Statement, equations: Equations) -> tuple[Statement, Equations]:
    """Return a statement and its equations, without time derivatives of inputs that occur in neither of the two."""
    e = equations
    nodes = [e.lagrangian, e.energy, *e.momenta, *e.forces, *e.bias, *e.accelerations, *e.multipliers, *e.impulses]
    nodes += [*e.motion.momenta, *e.motion.forces, *e.motion.bias, *(entry for row in e.matrix for entry in row)]
    for equations_of_constraints in (e.constraints, e.stated):
        nodes += [
            *(phi for phi in equations_of_constraints.positions if phi is not None),
            *equations_of_constraints.velocities,
            *equations_of_constraints.bias,
        ]
    depends = 0
    for node in nodes:
        depends |= node.depends
    drawn = {s for point in statement.drawn.values() for entry in point for s in entry.free_symbols}
    pairs = zip(statement.parameters, e.parameters, strict=True)
    rates = dict(statement.inputs)
    dropped = {
        symbol for symbol, node in pairs if symbol in rates and symbol not in drawn and not node.depends & depends
    }

    def has(expression: Any) -> bool:
        return bool(expression.free_symbols & dropped)

    prescribed = dict(statement.prescribed)
    lost = {leaf for leaf in e.leaves if leaf in dropped or (leaf in prescribed and has(prescribed[leaf]))}
    kept = [index for index, symbol in enumerate(statement.parameters) if symbol not in dropped]
    return (
        replace(
            statement,
            parameters=tuple(statement.parameters[index] for index in kept),
            inputs=tuple((s, rate if rate not in dropped else None) for s, rate in rates.items() if s not in dropped),
            prescribed=tuple((leaf, value) for leaf, value in statement.prescribed if not has(value)),
        ),
        replace(
            e,
            parameters=tuple(e.parameters[index] for index in kept),
            leaves={leaf: node for leaf, node in e.leaves.items() if leaf not in lost},
        ),
    )
