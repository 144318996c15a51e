"""Whether the motion is determined at all; tested when a system is stated, in the user's symbols.

Without constraints the mass matrix must not be singular by construction. With constraints each must restrict something,
they must be independent, and no motion that they allow may be without inertia.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.equations.constraints import empty_constraint
from lagrange.equations.euler_lagrange import Equations, no_inertia
from lagrange.errors import StatementError, listing
from lagrange.graph.node import Node
from lagrange.graph.term_size import term_sizes
from lagrange.machine.backend import FloatArray, Kernel, KernelProvider
from lagrange.machine.model import Model
from lagrange.machine.singular import RANK, Singular, balanced, least_regular, motion_along
from lagrange.statement.statement import Statement
from lagrange.trajectory.constraints.dependence import (
    contradiction,
    contradictory,
    dependent_everywhere,
    independent_rows,
)

POINTS = 8
"""Random states at which the rank is tested, beside the stated one; one regular point clears a block."""

ROUND_OFF = 1e-12
"""A value that vanishes at every state is below this part of its terms at each."""


def check_regularity(
    equations: Equations, provider: Callable[[], KernelProvider], statement: Statement | None = None
) -> None:
    """Raise StatementError if the accelerations are undetermined at every state and for all parameters that are tried.

    These are random ones and, of a statement, its initial state with its default parameters. The message names the
    constraints, or the combination of velocities that has no inertia. `provider` gives the kernels, if any are needed.
    """
    if len(equations.constraints):
        check_constraints(equations, provider(), statement)
    else:
        check_mass_matrix(equations, provider, statement)


def check_mass_matrix(
    equations: Equations, provider: Callable[[], KernelProvider], statement: Statement | None = None
) -> None:
    """Raise StatementError if the mass matrix is singular at every state and for all parameters that are tried."""
    names = equations.structure.names
    coupled = [block for block in equations.structure.blocks if len(block) > 1]
    if not coupled:
        return
    matrices = Tried(equations, statement).values(provider().kernel("mass_matrix"))
    for block in coupled:
        null = _common_null_vector(matrices[np.ix_(block, block)])
        if null is not None:
            raise StatementError(_no_inertia_along([names[i] for i in block], null))


def check_constraints(equations: Equations, provider: KernelProvider, statement: Statement | None = None) -> None:
    """Raise StatementError for constraints that are empty, dependent, or leave a motion without inertia."""
    held, tried = equations.constraints, Tried(equations, statement)
    n, m = len(equations.q), len(held)

    def values(nodes: Sequence[Node]) -> FloatArray:
        return tried.values(provider.function("constraints", tuple(nodes)))

    entries = [entry for row in held.gradient for entry in row]
    gradient = values(entries).reshape(m, n, -1)
    sizes = values(term_sizes(entries)).reshape(m, n, -1)
    stated = [psi if phi is None else phi for phi, psi in zip(held.positions, held.velocities, strict=True)]
    _check_empty(held.names, gradient, sizes, values(stated), values(term_sizes(stated)))
    singular = _common_singular(tried.values(provider.interpreted("mass_matrix")), gradient)
    if singular is None:
        return
    if singular.motion is not None:
        raise StatementError(_undetermined(equations, singular.motion))
    raise StatementError(_dependent(equations, provider, tried, singular))


def independent_constraints(model: Model) -> tuple[int, ...]:
    """Return constraints that are independent where all of them hold, and that the others follow from.

    Raises StatementError where no state is found that satisfies them.
    """
    statement, tried = model.statement, Tried(model.equations, model.statement)
    parameters = tried.some_parameters(statement)
    states = np.array([statement.initial, *tried.random_states().T]).T
    found = independent_rows(model, 0.0, states, parameters)
    if found is None:
        names = listing(repr(one.name) for one in statement.constraints)
        raise StatementError(
            f"no state was found that satisfies the constraints {names} together, so it is not known which of them "
            "follow from others. Give an initial state that satisfies them, and the values of all parameters."
        )
    return found


def _dependent(equations: Equations, provider: KernelProvider, tried: Tried, singular: Singular) -> str:
    """Return the refusal of constraints that are dependent wherever they were tried."""
    names, statement = equations.constraints.names, tried.statement
    # Without values for its parameters no state says whether constraints contradict one another.
    only_stated = all(row < len(equations.stated) for row, _ in singular.rows)
    if only_stated and statement is not None and len(statement.defaults) == len(statement.parameters):
        model = Model(statement, equations, provider)
        states = np.array([statement.initial, *tried.random_states().T]).T
        if contradictory(model, 0.0, states, model.parameter_array()):
            return contradiction(names, singular)
    return dependent_everywhere(names, singular)


@dataclass(frozen=True, eq=False)
class Tried:
    """The states and parameters at which regularity is tested."""

    equations: Equations
    statement: Statement | None

    def random_states(self) -> FloatArray:
        """Return random states, (2n, POINTS)."""
        return np.random.default_rng(7).uniform(0.2, 1.2, (self.equations.layout.size, POINTS))

    def some_parameters(self, statement: Statement | None) -> FloatArray:
        """Return values of the parameters: the defaults of a statement, and random ones where there are none."""
        some = np.random.default_rng(9).uniform(0.5, 2.0, len(self.equations.parameters))
        if statement is None:
            return some
        return np.array([statement.defaults.get(p, x) for p, x in zip(statement.parameters, some, strict=True)])

    def values(self, kernel: Kernel) -> FloatArray:
        """Return what a kernel gives at every state, the states as the last axis."""
        statement = self.statement
        random, state = np.random.default_rng(8), self.random_states()
        some = self.some_parameters(None)
        with np.errstate(all="ignore"):
            found = [kernel(random.uniform(0.2, 1.2, POINTS), state, some)]
            if statement is not None:
                stated = self.some_parameters(statement)
                initial = np.array(statement.initial)[:, None]
                around = initial + (1e-2 * np.abs(initial) + 1e-3) * random.uniform(-1.0, 1.0, state.shape)
                found.append(kernel(0.0, np.concatenate([initial, around], axis=1), stated))
        return np.concatenate(found, axis=-1)


def _check_empty(
    names: Sequence[str], gradient: FloatArray, sizes: FloatArray, values: FloatArray, terms: FloatArray
) -> None:
    """Refuse constraints whose derivatives by the velocities, (m, n, states), vanish at every state with values."""
    for name, rows, size, value, term in zip(names, gradient, sizes, values, terms, strict=True):
        finite = np.isfinite(value) & np.isfinite(rows).all(axis=0)
        if finite.any() and (np.abs(rows) <= ROUND_OFF * size)[:, finite].all():
            worst = int(np.argmax(np.where(finite, np.abs(value), -1.0)))
            raise StatementError(empty_constraint(name, float(value[worst]), float(term[worst])))


def _common_singular(mass: FloatArray, gradient: FloatArray) -> Singular | None:
    """Return what is singular at the first state if something is at every one with finite numbers."""
    first = None
    for k in range(mass.shape[2]):
        found = least_regular(mass[:, :, k], gradient[:, :, k])
        if found is None:
            continue
        if found.regularity > RANK:
            return None
        first = found if first is None else first
    return first


def _undetermined(equations: Equations, motion: FloatArray) -> str:
    return (
        f"a motion with {motion_along(equations.layout.rates, motion)} satisfies the constraints and has no "
        "inertia at every state tried, so these accelerations are not determined. Add the kinetic energy that is "
        "missing, or use fewer coordinates."
    )


def _common_null_vector(matrices: FloatArray) -> FloatArray | None:
    """Return the null vector of the first matrix if every finite one is singular."""
    found = None
    for k in range(matrices.shape[2]):
        matrix = matrices[:, :, k]
        if not np.isfinite(matrix).all():
            continue
        scaled, scale = balanced(matrix)
        _, values, vectors = np.linalg.svd(scaled)
        if values[-1] > RANK * values[0]:
            return None
        found = vectors[-1] / scale if found is None else found
    return found


def _no_inertia_along(names: list[str], null: FloatArray) -> str:
    motion = motion_along(names, null)
    if "," not in motion:
        return no_inertia(motion.partition(".dot")[0])
    return (
        f"the mass matrix d2L/dv2 is singular at every state tried: a motion with {motion} has no inertia, so "
        "these accelerations are not determined. Add the kinetic energy that is missing, or use fewer coordinates."
    )
