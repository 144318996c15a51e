"""Test, when a system is stated, that its equations determine the accelerations; give messages in the user's symbols.

Without constraints the mass matrix must be regular at some state. With constraints, each constraint must restrict a
velocity, the constraints must be independent, and every motion that they allow must have inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sympy

from lagrange.equations.constraints import TERM_ROUND_OFF, empty_constraint
from lagrange.equations.euler_lagrange import Equations, euler_lagrange, no_inertia
from lagrange.equations.singular import (
    DEPENDENT,
    RANK,
    FloatArray,
    Singular,
    contradiction,
    dependent_everywhere,
    least_regular,
    motion_along,
    no_inertia_along,
)
from lagrange.equations.solve_plan import eliminated
from lagrange.errors import StatementError, listing
from lagrange.graph.differentiate import tangents
from lagrange.graph.evaluate import doubles, generic_rank, term_sizes
from lagrange.graph.node import Node, reachable, substitute
from lagrange.statement.coordinate import check_multipliers, constraint_of, multiplier
from lagrange.statement.given.function import with_values
from lagrange.statement.random_states import SAMPLE_KINDS, Sampler
from lagrange.statement.statement import REFUSE, Statement

MOST_WRITTEN_OPERATIONS = 20_000_000
"""Largest number of operations of the multipliers, counted without sharing. SymPy shares parts of expressions, but
compares them one by one, in a time that grows with this number. A chain of ten links on a rough rail compiles in 10 s.
Each further link doubles that."""


def with_solved_multipliers(statement: Statement) -> Statement:
    """Return the statement with each multiplier in its forces replaced by a function of the state.

    A statement without multipliers in its forces is returned unchanged. Raises StatementError for multipliers of
    contacts and of unknown constraints, for forces that are not linear in the multipliers, for redundant constraints,
    for coordinates without inertia, and if the multipliers are not determined.
    """
    free = sorted(sympy.Tuple(*statement.forces).free_symbols, key=str)
    names = [name for symbol in free if (name := constraint_of(symbol)) is not None]
    if not names:
        return statement
    for name in {contact.name for contact in statement.contacts}.intersection(names):
        raise StatementError(
            f"a force contains {multiplier(name)}, the normal force of the contact {name!r}, which acts only while the "
            "contact is closed: state friction in the contact, lg.contact(gap, slip=..., friction=...), and other "
            f"forces without {multiplier(name)}."
        )
    check_multipliers(names, "a force", [constraint.name for constraint in statement.constraints], statement.name)
    if statement.redundant != REFUSE:
        raise StatementError(
            f"the forces of {statement.name} contain multipliers, which redundant constraints do not determine: leave "
            "out the constraints that follow from others, and the argument redundant='allow'."
        )
    symbols = [multiplier(name) for name in names]
    _check_linear(statement, symbols)
    equations = euler_lagrange(replace(statement, parameters=(*statement.parameters, *symbols)))
    nodes = _multipliers(equations, statement.name, names)
    sizes: dict[Node, int] = {}  # Operations in the formula of each node; a shared node counts each time it is used
    for node in reachable(nodes):
        sizes[node] = len(node.args) + sum(sizes[arg] for arg in node.args)
    if (size := sum(sizes[node] for node in nodes)) > MOST_WRITTEN_OPERATIONS:
        raise StatementError(
            f"the multipliers in the forces of {statement.name} have {size:.2g} operations when written out, more than "
            f"{MOST_WRITTEN_OPERATIONS:.0e}: state fewer coordinates, or a force in coordinates and velocities."
        )
    values = dict(zip(symbols, map(equations.express, nodes), strict=True))
    return replace(statement, forces=tuple(force.xreplace(values) for force in statement.forces))


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
    """Return the multipliers of the constraints `constraint_names` as functions of the state.

    The symbols of these multipliers are the last parameters of the equations. `system_name` is for messages.
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


RANDOM_STATES = 8
"""Number of random states, and of states near the initial one, at which a new system is tested. The test is passed if
one of them has determined accelerations."""

NEAR_ATTEMPT = 4  # Attempt of the sampler at which its points are about 3 % away from the initial state

Reach = Callable[[Statement, Equations, FloatArray, FloatArray], list[FloatArray]]
"""Function that projects states onto the constraints. It takes statement, equations, states (2n, k) and parameters.

It returns the projected states, without those whose projection failed.
"""


def equations_of(statement: Statement, reach: Reach) -> Equations:
    """Return the equations of motion, without redundant constraints if the statement allows such constraints.

    `reach` projects states onto the constraints; it is called if constraints are dependent. Raises StatementError if
    the accelerations are undetermined at every state tried.
    """
    statement = known_statement(statement)
    equations = allowed_equations(statement, reach)
    check_regularity(equations, statement, reach)
    return equations


def known_statement(statement: Statement) -> Statement:
    """Return the statement with given functions and multipliers in forces replaced by functions of time and state."""
    return with_solved_multipliers(with_values(statement))


def allowed_equations(statement: Statement, reach: Reach) -> Equations:
    """Return the equations of motion, without redundant constraints if the statement allows such constraints.

    `reach` projects states onto the constraints. At the projected states the redundant constraints are identified.
    """
    equations = euler_lagrange(statement)
    if statement.redundant == REFUSE or len(statement.constraints) < 2:
        return equations
    kept = _independent_constraints(statement, equations, reach)
    return equations if len(kept) == len(statement.constraints) else euler_lagrange(statement, kept)


def check_regularity(equations: Equations, statement: Statement, reach: Reach) -> None:
    """Raise StatementError if the accelerations are undetermined at all states and parameters tried.

    States and parameters are random; the initial state and the default parameters are tried as well. The message names
    the constraints, or the combination of velocities that has no inertia. `reach` finds states on the constraints, so
    that the message also says whether dependent constraints contradict each other.
    """
    if len(equations.constraints):
        _check_constraints(RegularityPoints(equations, statement), reach)
    else:
        _check_mass_matrix(equations, statement)


def _check_mass_matrix(equations: Equations, statement: Statement) -> None:
    """Raise StatementError if the mass matrix is singular at all states and parameters tried."""
    coupled = [block for block in equations.structure.blocks if len(block) > 1]
    if not coupled:
        return
    samples, n = RegularityPoints(equations, statement), len(equations.q)
    matrices = samples.values(samples.mass_entries()).reshape(n, n, -1)
    for block in coupled:
        mass = matrices[np.ix_(block, block)]
        singular, point = _common_singular(mass, np.empty((0, *mass.shape[1:])))
        if singular is None:
            continue
        null = np.zeros(n)
        null[[*block]] = singular.motion
        motion = motion_along(equations.layout, samples.points[point], null)
        if "," not in motion and motion.endswith(".dot = 1"):
            raise StatementError(no_inertia(motion.partition(".dot")[0]))
        raise StatementError(
            f"the mass matrix d2L/dv2 is singular at every state tried: {no_inertia_along(motion)}, so these "
            "accelerations are not determined. Add the kinetic energy that is missing, use fewer coordinates, or "
            "constrain this motion."
        )


def _check_constraints(samples: RegularityPoints, reach: Reach) -> None:
    """Raise StatementError for constraints that are empty, dependent, or allow a motion without inertia.

    `samples` are the points at which this is tested, and `reach` projects states onto the constraints.
    """
    equations, constraints = samples.equations, samples.equations.constraints
    entries = [entry for row in constraints.gradient for entry in row]
    shape = (len(constraints), len(equations.q), -1)
    pairs = zip(constraints.positions, constraints.velocities, strict=True)
    stated = [psi if phi is None else phi for phi, psi in pairs]
    # All parts are evaluated at once, since they are computed from the same nodes.
    parts = (entries, term_sizes(entries), stated, term_sizes(stated), samples.mass_entries())
    rows = samples.values([node for part in parts for node in part])
    gradient, sizes, values, terms, mass = np.split(rows, np.cumsum([len(part) for part in parts[:-1]]))
    gradient = gradient.reshape(shape)
    sizes = sizes.reshape(shape)
    for name, slopes, size, value, term in zip(constraints.names, gradient, sizes, values, terms, strict=True):
        finite = np.isfinite(value) & np.isfinite(slopes).all(axis=0)
        if finite.any() and (np.abs(slopes) <= TERM_ROUND_OFF * size)[:, finite].all():
            worst = int(np.argmax(np.where(finite, np.abs(value), -1.0)))
            raise StatementError(empty_constraint(name, float(value[worst]), float(term[worst])))
    singular, point = _common_singular(mass.reshape(len(equations.q), len(equations.q), -1), gradient)
    if singular is None:
        return
    if singular.motion is not None:
        raise StatementError(
            f"a motion with {motion_along(equations.layout, samples.points[point], singular.motion)} satisfies the "
            "constraints and has no inertia at every state tried, so these accelerations are not determined. Add the "
            "kinetic energy that is missing, or use fewer coordinates."
        )
    names, statement = constraints.names, samples.statement
    # Without values for all parameters no state shows whether constraints contradict each other.
    only_stated = all(row < len(equations.stated) for row, _ in singular.rows)
    if not only_stated or len(statement.defaults) < len(statement.parameters) or samples.reached(reach)[0]:
        raise StatementError(dependent_everywhere(names, singular))
    raise StatementError(contradiction(names, singular))


def _independent_constraints(statement: Statement, equations: Equations, reach: Reach) -> tuple[int, ...]:
    """Return the indices of a largest set of independent constraints. The other constraints follow from these.

    `reach` finds the states on the constraints at which this is tested. Raises StatementError if it finds none.
    """
    samples, count = RegularityPoints(equations, statement), len(statement.constraints)
    gradient = [entry for row in equations.stated.gradient for entry in row]
    reached, parameters = samples.reached(reach)
    if not reached:
        names = listing(repr(constraint.name) for constraint in statement.constraints)
        raise StatementError(
            f"no state was found that satisfies the constraints {names} together, so it is not known which of them "
            "follow from others. Give an initial state that satisfies them, and the values of all parameters."
        )
    values = samples.values(gradient, [(*state, *parameters, 0.0) for state in reached]).T
    return max((independent_rows(rows.reshape(count, -1)) for rows in values), key=len)


def independent_rows(rows: FloatArray) -> tuple[int, ...]:
    """Return the indices of independent rows that span the space of all rows (m, n).

    They are chosen one by one: each time the row farthest from the space of the rows already chosen.
    """
    sizes = np.sqrt((rows**2).sum(axis=1))
    left, chosen = rows / np.where(sizes > 0, sizes, 1.0)[:, None], []
    for _ in range(len(rows)):
        lengths = np.sqrt((left**2).sum(axis=1))
        # The first of the longest rows is chosen, so that the choice does not depend on rounding.
        row = int(np.argmax(lengths > (1 - DEPENDENT) * lengths.max()))
        if lengths[row] <= DEPENDENT:
            break
        chosen.append(row)
        along = left[row] / lengths[row]
        left = left - np.outer(left @ along, along)
    return tuple(sorted(chosen))


class RegularityPoints:
    """Points at which the equations are tested: random ones of order one, the initial state, and points near it."""

    def __init__(self, equations: Equations, statement: Statement) -> None:
        self.equations, self.statement, sampler = equations, statement, Sampler(statement, 7)
        near, order_one = SAMPLE_KINDS[:2]
        self._random = [sampler.point(order_one) for _ in range(RANDOM_STATES)]
        self._initial = sampler.initial()
        near_initial = [sampler.point(near, NEAR_ATTEMPT) for _ in range(RANDOM_STATES)]
        every = (*self._random, self._initial, *near_initial)
        self.points = [(*point.q, *point.v, *point.parameters.values(), point.t) for point in every]

    def reached(self, reach: Reach) -> tuple[list[FloatArray], FloatArray]:
        """Return states (2n,) on the constraints, and the parameters (k,) for which they satisfy them.

        `reach` projects the initial state and the random ones onto the constraints.
        """
        states = np.array([(*point.q, *point.v) for point in (self._initial, *self._random)]).T
        parameters = np.array([*self._initial.parameters.values()])
        return reach(self.statement, self.equations, states, parameters), parameters

    def values(self, nodes: Sequence[Node], points: Sequence[tuple[float, ...]] | None = None) -> FloatArray:
        """Return the values of nodes, (nodes, points). A point is (*q, *v, *parameters, t). None means all points."""
        points, e = self.points if points is None else points, self.equations
        rows = zip((*e.q, *e.v, *e.parameters, e.time), np.array(points).T, strict=True)
        return doubles(nodes, dict(rows), len(points))

    def mass_entries(self) -> list[Node]:
        """Return the entries of the mass matrix, row by row."""
        return [entry for row in self.equations.mass for entry in row]


def _common_singular(mass: FloatArray, gradient: FloatArray) -> tuple[Singular | None, int]:
    """Return the cause of undetermined accelerations at the first finite state, and the index of this state.

    `mass` are the mass matrices (n, n, k) and `gradient` the gradients of constraints (m, n, k) at k states. A state is
    finite if these are. The first result is None unless the equations are singular at all finite states.
    """
    first: tuple[Singular | None, int] = None, 0
    for k in range(mass.shape[2]):
        singular = least_regular(mass[:, :, k], gradient[:, :, k])
        if singular is None:
            continue
        if singular.regularity > RANK:
            return None, 0
        first = (singular, k) if first[0] is None else first
    return first
