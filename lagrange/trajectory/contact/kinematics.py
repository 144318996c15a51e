"""Gaps, slips and their directions at a state, and the rates that contact forces and impulses cause."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sympy import Float

from lagrange.equations.constraints import constraint_equations
from lagrange.errors import StatementError, formula
from lagrange.graph.node import Node
from lagrange.machine.backend import Kernel
from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.kernel.straight_lines import fits
from lagrange.machine.model import Model
from lagrange.statement.contact import impact_speed
from lagrange.trajectory.contact.complementarity import DEPENDENT, OPEN, STICKING, Friction
from lagrange.trajectory.trajectory import FloatArray

TOUCHING = 1e-13
"""A gap counts as zero below this fraction of the largest terms of any gap so far, which is far above rounding. The
terms of all gaps are used, because balls that rest at coordinates of zero have no terms.
"""

HELD = 1e-12
"""Largest gap of a closed contact without projection, relative to the terms of gaps."""

STILL = 1e-11
"""A gap rate or slip counts as zero below this fraction of the largest terms of the contact's rates so far."""

ROUND_OFF = 2.0**-50
"""A velocity in a closed contact is rounding if its kinetic energy is below the square of this fraction times the
largest. Impulses transmit it from contact to contact. Tolerances relative to it would be far too small.
"""

FEW_STATES = 16
"""Below this number of states, calls of a function for one state are faster than one call for all."""

MODELS_KEPT = 16
"""Largest number of models whose contact functions and modes are cached."""

SLOW_SHARE = 1e-3
"""Fraction of the largest rates of all contacts that serves as the scale of a contact at rest."""


@lru_cache(maxsize=MODELS_KEPT)
def _coefficients(model: Model, parameters: tuple[float, ...]) -> tuple[list[Any], list[tuple[float, float]]]:
    """Return for each contact the restitution, an expression in the impact speed, and the coefficients of friction.

    `parameters` (k,) are the values of the model's parameters. Raises StatementError for values out of range.
    """
    values = dict(zip(model.statement.parameters, map(Float, parameters), strict=True))
    restitutions, frictions = [], []
    for contact in model.statement.contacts:
        static, kinetic = (float(mu.xreplace(values)) for mu in contact.friction)
        if kinetic < 0 or kinetic > static:
            raise StatementError(
                f"the friction of the contact {contact.name!r} is {static:g} (static) and {kinetic:g} (kinetic): "
                "give coefficients that are not negative, the static one at least the kinetic one."
            )
        e = contact.restitution.xreplace(values)
        if e.is_number and not 0 <= float(e) <= 1:
            raise StatementError(
                f"the restitution of the contact {contact.name!r} is {float(e):g}: give a number between 0 and 1."
            )
        restitutions.append(e)
        frictions.append((static, kinetic))
    return restitutions, frictions


@dataclass(frozen=True, eq=False)
class Touch:
    """The contacts at a time `t` and a state `y` (2n,): gaps (k,), rates (dgap/dt and slips), and their derivatives.

    A row is a rate: each contact has a row for dgap/dt, then one for each slip. `rates` (rows,) are the values,
    `directions` (rows, n) their derivatives by the velocities, and `bias` (rows,) their derivatives by time at zero
    acceleration. Gaps count as zero up to `near`, rates up to `noise` (rows,). `inertia` computes the pair of
    `responses` and `still` at its first call.
    """

    t: float
    y: FloatArray
    gaps: FloatArray
    rates: FloatArray
    directions: FloatArray
    bias: FloatArray
    near: float
    noise: FloatArray
    inertia: Callable[[], tuple[FloatArray, FloatArray]]

    @property
    def responses(self) -> FloatArray:
        """Accelerations by a unit force along each row, under the stated constraints, (n, rows)."""
        return self.inertia()[0]

    @property
    def still(self) -> FloatArray:
        """Sizes (n,) up to which velocities count as zero."""
        return self.inertia()[1]

    @cached_property
    def compliance(self) -> FloatArray:
        """Change of each rate that a unit force (or impulse) along each row causes, (rows, rows)."""
        return self.directions @ self.responses

    def least_motion(self, rows: Sequence[int], changes: ArrayLike) -> FloatArray:
        """Return the velocities (n,), least by the kinetic energy, that change the rates `rows` by `changes` (k,)."""
        square, right = self.compliance[np.ix_(rows, rows)], np.asarray(changes)
        return np.asarray(self.responses[:, rows] @ np.linalg.lstsq(square, right, rcond=DEPENDENT)[0])


@lru_cache(maxsize=MODELS_KEPT)
def contact_function(model: Model) -> Kernel:
    """Return a function, cached by model, that evaluates the gaps, rates, biases and directions of the contacts.

    Rates are dgap/dt and the slips. Biases are their time derivatives at zero acceleration. Directions are their
    derivatives by the velocities.
    """
    equations = model.equations
    stated: dict[str, Any] = {}
    holonomic = []
    for contact in model.statement.contacts:
        stated[contact.name] = equations.translate(contact.gap)
        stated |= dict(zip(contact.slip_names, map(equations.translate, contact.slip), strict=True))
        holonomic += [True] + [False] * len(contact.slip)
    constraints = constraint_equations(stated, holonomic, equations.q, equations.v, equations.time)
    gaps = [gap for gap in constraints.positions if gap is not None]
    gradient = [entry for row in constraints.gradient for entry in row]
    return quick_function(model, "contacts", (*gaps, *constraints.velocities, *constraints.bias, *gradient))


def quick_function(model: Model, name: str, nodes: tuple[Node, ...]) -> Kernel:
    """Return a function that evaluates `nodes`; if short, it is printed as Python, fastest for a few calls."""
    kernel = model.function(name, nodes)
    return PythonKernel(kernel.program) if fits(kernel.program) else kernel


class Kinematics:
    """Evaluates the contacts of a model for the parameters of a run.

    `rows` has the row indices of each contact in a `Touch`: first dgap/dt, then its slips. `normals` has the row index
    of dgap/dt of each contact, and `owners` (rows,) the index of the contact of each row. `restitutions` are the values
    of the contacts, None for those that depend on the impact speed.
    """

    def __init__(self, model: Model, parameters: FloatArray) -> None:
        self.model, self.parameters, self.contacts = model, parameters, model.statement.contacts
        sizes = [1 + len(contact.slip) for contact in self.contacts]
        self.normals = [sum(sizes[:i]) for i in range(len(sizes))]
        self.rows = [list(range(row, row + size)) for row, size in zip(self.normals, sizes, strict=True)]
        self.owners = np.repeat(np.arange(len(sizes)), sizes)
        self._places, self._speeds, self._momentum = np.zeros(len(sizes)), np.zeros(sum(sizes)), 0.0
        self._kernel = contact_function(model)
        self._restitution, self._friction = _coefficients(model, tuple(parameters.tolist()))
        self.restitutions = [float(e) if e.is_number else None for e in self._restitution]

    def gaps(self, times: FloatArray, states: FloatArray) -> tuple[FloatArray, float]:
        """Return the gaps (k, N) at times (N,) and states (2n, N), and the size up to which they are zero."""
        k = len(self.normals)
        if len(times) < FEW_STATES:
            pairs = zip(times.tolist(), np.ascontiguousarray(states.T), strict=True)
            values = np.array([self._kernel(t, y, self.parameters)[:k] for t, y in pairs]).T
        else:
            values = np.array(self._kernel(times, states, self.parameters)[:k])
        return values, TOUCHING * max(self._places.max(), np.abs(values).max())

    def held(self, contact: int, times: FloatArray, states: FloatArray, sticking: NDArray[np.bool_]) -> bool:
        """Return True if a contact is closed at all states (2n, N): gap and gap rate are zero up to rounding.

        `contact` is its index. At states in the mask `sticking` (N,) its slips must also be zero.
        """
        k, mine = len(self.normals), self.rows[contact]
        values = np.asarray(self._kernel(times, states, self.parameters))
        gap, rate, slips = values[contact], values[k + mine[0]], values[[k + row for row in mine[1:]]] * sticking
        near, still = HELD * self._places.max(), STILL * self._speeds[mine].max()
        return bool((np.abs(gap) <= near).all() and (np.abs(rate) <= still).all() and (np.abs(slips) <= still).all())

    def at(self, t: float, y: FloatArray, before: Touch | None = None) -> Touch:
        """Return the contacts at a state y (2n,), an array that is not changed afterwards.

        With `before`, the contacts at another state, its `inertia` is reused, which saves time. Both states must have
        the same coordinates, up to rounding. Velocities may differ.
        """
        k, rows = len(self.normals), len(self._speeds)
        values = np.asarray(self._kernel(t, y, self.parameters))
        gaps, rates, bias, gradient = (
            values[:k],
            values[k : k + rows],
            values[k + rows : k + 2 * rows],
            values[k + 2 * rows :],
        )
        directions = gradient.reshape(rows, -1)
        q, v = self.model.layout.split(y)
        slopes = np.abs(directions)
        lengths = slopes[self.normals] @ np.abs(q) + np.abs(gaps)
        speeds = slopes @ np.abs(v) + np.abs(rates - directions @ v)
        self._places, self._speeds = np.maximum(self._places, lengths), np.maximum(self._speeds, speeds)
        fastest = np.maximum.reduceat(self._speeds, self.normals)[self.owners]
        noise = STILL * np.maximum(fastest, SLOW_SHARE * self._speeds.max())
        near = TOUCHING * float(self._places.max())
        inertia = cache(partial(self._inertia, t, y, directions)) if before is None else before.inertia
        return Touch(t, y, gaps, rates, directions, bias, near, noise, inertia)

    def _inertia(self, t: float, y: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `responses` and `still` of a `Touch` with these `directions` (rows, n) at a state y (2n,)."""
        n, v = self.model.dimension, y[self.model.layout.v]
        mass = np.asarray(self.model.kernel("mass_matrix")(t, y, self.parameters)).reshape(n, n)
        inertia = np.sqrt(np.abs(np.diag(mass)))
        self._momentum = max(self._momentum, float((inertia * np.abs(v)).max()))
        still = np.where(inertia > 0, ROUND_OFF * self._momentum / np.where(inertia > 0, inertia, 1.0), 0.0)
        if len(stated := self.stated_directions(t, y)):
            whole = np.block([[mass, -stated.T], [stated, np.zeros((len(stated), len(stated)))]])
            right = np.vstack([directions.T, np.zeros((len(stated), len(directions)))])
            return np.asarray(np.linalg.lstsq(whole, right, rcond=1e-13)[0][:n]), still
        try:
            return np.asarray(np.linalg.solve(mass, directions.T)), still
        except np.linalg.LinAlgError:  # The mass matrix is singular, and the next step ends the run.
            return np.asarray(np.linalg.lstsq(mass, directions.T)[0]), still

    def held_rows(self, states: Sequence[str]) -> list[int]:
        """Return the indices of the rows (gap rates and slips) that are zero if the contacts have these `states`.

        A closed gap is constant, and a contact that sticks has no slip.
        """
        pairs = zip(self.rows, states, strict=True)
        return [row for mine, state in pairs if state != OPEN for row in (mine if state == STICKING else mine[:1])]

    def closed(self, touch: Touch, contacts: Sequence[int], unchanged: Sequence[int] = ()) -> FloatArray:
        """Return the state of `touch` changed so that the gaps of `contacts` (indices) are closed, by one Newton step.

        The change is the least, measured by the kinetic energy. The gaps of the contacts `unchanged` (indices) do not
        change.
        """
        both = [*contacts, *(i for i in unchanged if i not in contacts)]
        y, changes = touch.y.copy(), [*touch.gaps[contacts], *np.zeros(len(both) - len(contacts))]
        y[self.model.layout.q] -= touch.least_motion([self.normals[i] for i in both], changes)
        return y

    def stated_directions(self, t: float, y: FloatArray) -> FloatArray:
        """Return the gradients (m, n) of the stated constraints by the velocities."""
        n = self.model.dimension
        if not self.model.statement.constraints:
            return np.empty((0, n))
        return np.asarray(self.model.kernel("constraint_gradient")(t, y, self.parameters)).reshape(-1, n)

    def restitution(self, contact: int, speed: float) -> float:
        """Return the restitution of a contact at an impact speed. Raises StatementError outside of [0, 1]."""
        value = float(self._restitution[contact].xreplace({impact_speed: Float(speed, 17)}))
        if not 0 <= value <= 1:
            stated = self.contacts[contact]
            raise StatementError(
                f"the restitution of the contact {stated.name!r}, {formula(stated.restitution, 60)}, is {value:g} at "
                f"the impact speed {speed:g}: it must lie between 0 and 1."
            )
        return value

    def friction(self, contact: int, slip: FloatArray, noise: FloatArray) -> Friction:
        """Return the friction of contact number `contact`, for slip velocities `slip` (components,).

        The contact slides if these velocities exceed `noise` (components,).
        """
        static, kinetic = self._friction[contact]
        if not len(slip) or static == 0:
            return Friction()
        size = float(np.linalg.norm(slip))
        return Friction(len(slip), static, kinetic, slip / size if size > float(noise.max()) else None)
