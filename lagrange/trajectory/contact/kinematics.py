"""Evaluate gaps and slips of contacts at a state, and decide by thresholds which of them count as zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sympy import Float

from lagrange.equations.constraints import constraint_equations
from lagrange.errors import StatementError, formula
from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.model import Model
from lagrange.statement.contact import LARGEST_FRICTION, impact_speed
from lagrange.trajectory.contact.stick_or_slide import DEPENDENT, OPEN, STICKING, Friction
from lagrange.trajectory.trajectory import FloatArray

TOUCHING = 1e-13
"""Largest size of a gap that counts as zero, as a fraction of the largest sum of magnitudes of a gap's terms so far. It
is far above rounding. All gaps have this one scale, because the terms of a ball that rests at coordinate 0 vanish."""

HELD = 1e-12
"""Largest gap of a contact that counts as closed throughout a segment, on the same scale as `TOUCHING`. It is larger
than `TOUCHING` because the states of this segment are not projected onto zero gaps."""

RATE_NOISE = 1e-11
"""Largest gap rate or slip of a contact that counts as zero, as a fraction of the largest terms of its rates so far."""

ROUND_OFF = 2.0**-50
"""Threshold of a velocity in a closed contact, below which it counts as zero. The square of this number is the kinetic
energy of the velocity, as a fraction of the largest kinetic energy so far. Impulses transmit such rounding errors from
contact to contact. Tolerances of a run that are relative to them would be far too small."""

MODELS_KEPT = 16
"""Largest number of models whose contact functions and modes are cached."""

SLOW_SHARE = 1e-3
"""Smallest scale of the rates of a contact, as a fraction of the largest terms of the rates of all contacts. A contact
at rest has no scale of its own, so this scale decides which of its rates count as zero."""


@lru_cache(maxsize=MODELS_KEPT)
def _coefficients(model: Model, parameters: tuple[float, ...]) -> tuple[list[Any], list[float | None], list[Any]]:
    """Return three lists of coefficients of a model's contacts, for the values `parameters` (k,) of its parameters.

    The lists have one entry for each contact: the restitution as an expression in the impact speed, its value (None if
    it depends on the speed), and the static and the kinetic coefficient of friction. Raises StatementError for values
    out of range.
    """
    values = dict(zip(model.statement.parameters, map(Float, parameters), strict=True))
    restitutions, frictions = [], []
    for contact in model.statement.contacts:
        static, kinetic = (float(mu.xreplace(values)) for mu in contact.friction)
        if not 0 <= kinetic <= static <= LARGEST_FRICTION:
            raise StatementError(
                f"the friction of the contact {contact.name!r} is {static:g} (static) and {kinetic:g} (kinetic): "
                f"give coefficients from 0 to {LARGEST_FRICTION:g}, the static one at least the kinetic one."
            )
        e = contact.restitution.xreplace(values)
        if e.is_number and not 0 <= float(e) <= 1:
            raise StatementError(
                f"the restitution of the contact {contact.name!r} is {float(e):g}: give a number between 0 and 1."
            )
        restitutions.append(e)
        frictions.append((static, kinetic))
    return restitutions, [float(e) if e.is_number else None for e in restitutions], frictions


@lru_cache(maxsize=MODELS_KEPT)
def _rows(model: Model) -> tuple[list[list[int]], list[int], NDArray[np.intp]]:
    """Return the row indices of each contact, the index of its row dgap/dt, and the contact index of each row.

    A row is a rate of a contact: dgap/dt or a slip. The results are `rows`, `normals` and `owners` of `Kinematics`.
    """
    sizes = [1 + len(contact.slip) for contact in model.statement.contacts]
    normals = [sum(sizes[:i]) for i in range(len(sizes))]
    rows = [list(range(row, row + size)) for row, size in zip(normals, sizes, strict=True)]
    return rows, normals, np.repeat(np.arange(len(sizes)), sizes)


@dataclass(frozen=True, eq=False)
class ContactState:
    """The contacts at a time `t` and a state `y` (2n,): gaps (k,), rates (dgap/dt and slips), and their derivatives.

    A row is a rate: each contact has a row for dgap/dt, then one for each slip. `rates` (rows,) are the values.
    `directions` (rows, n) are the derivatives of the rates by the velocities, and `convective` (rows,) the derivatives
    by time at zero acceleration. `terms` (rows,) are the largest sums of magnitudes of the rates' terms so far. Gaps
    count as zero up to `near`. `before` is a state with the same coordinates, whose mass matrix is used, or None.
    """

    kinematics: Kinematics
    t: float
    y: FloatArray
    gaps: FloatArray
    rates: FloatArray
    directions: FloatArray
    convective: FloatArray
    terms: FloatArray
    near: float
    before: ContactState | None

    @cached_property
    def noise(self) -> FloatArray:
        """Size (rows,) of each rate, a gap rate or a slip, up to which this rate counts as zero."""
        fastest = np.maximum.reduceat(self.terms, self.kinematics.normals)[self.kinematics.owners]
        return np.asarray(RATE_NOISE * np.maximum(fastest, SLOW_SHARE * self.terms.max()))

    @cached_property
    def _inertia(self) -> tuple[FloatArray, FloatArray]:
        """The pair (`responses`, `velocity_noise`): accelerations by unit forces, and rounding errors of velocities."""
        return self.kinematics.inertia(self) if self.before is None else self.before._inertia

    @property
    def responses(self) -> FloatArray:
        """Accelerations (n, rows) that a unit force along each row causes, under the stated constraints.

        A row is a gap or a slip, and a force along it acts in the direction of its gradient.
        """
        return self._inertia[0]

    @property
    def velocity_noise(self) -> FloatArray:
        """Size (n,) of each velocity up to which this velocity counts as zero."""
        return self._inertia[1]

    @cached_property
    def compliance(self) -> FloatArray:
        """Accelerations (rows, rows) of gaps and slips: entry (i, j) is that of row i by a unit force along row j.

        For unit impulses the entries are changes of gap rates and slips.
        """
        return self.directions @ self.responses

    def least_motion(self, rows: Sequence[int], changes: ArrayLike) -> FloatArray:
        """Return the velocities (n,) of least kinetic energy that change gap rates and slips by given amounts.

        `changes` (k,) are the changes of the rates with the indices `rows`.
        """
        square, right = self.compliance[np.ix_(rows, rows)], np.asarray(changes)
        return np.asarray(self.responses[:, rows] @ np.linalg.lstsq(square, right, rcond=DEPENDENT)[0])


@lru_cache(maxsize=MODELS_KEPT)
def _contact_functions(model: Model) -> tuple[PythonKernel, PythonKernel]:
    """Return two functions of a state, cached by model: one evaluates the contacts, the other the gaps alone.

    The results of the first function are the gaps (k,) and their sizes, the rates (rows,) and their sizes, the
    derivatives of the rates by time at zero acceleration, and the derivatives of the rates by the velocities. A size is
    the sum of the absolute values of the terms.
    """
    equations, size = model.equations, partial(model.equations.graph.call, "abs")
    q, v = equations.q, equations.v
    stated: dict[str, Any] = {}
    holonomic = []
    for contact in model.statement.contacts:
        stated[contact.name] = equations.translate(contact.gap)
        stated |= dict(zip(contact.slip_names, map(equations.translate, contact.slip), strict=True))
        holonomic += [True] + [False] * len(contact.slip)
    equation = constraint_equations(stated, holonomic, q, v, equations.time)
    lengths, speeds = [], []
    for position, rate, row in zip(equation.positions, equation.velocities, equation.gradient, strict=True):
        if position is not None:
            lengths.append(sum((size(d * x) for d, x in zip(row, q, strict=True)), size(position)))
        moved = [d * speed for d, speed in zip(row, v, strict=True)]
        speeds.append(sum(map(size, moved), size(rate - sum(moved, equations.graph.zero))))
    gaps = tuple(gap for gap in equation.positions if gap is not None)
    gradient = [entry for row in equation.gradient for entry in row]
    nodes = (*gaps, *lengths, *equation.velocities, *speeds, *equation.bias, *gradient)
    return PythonKernel(model.function("contacts", nodes).program), PythonKernel(model.function("gaps", gaps).program)


class Kinematics:
    """Evaluates the contacts of a model for the parameters of a run.

    `rows` has the row indices of each contact in a `ContactState`, and `normals` the first of them, the row of dgap/dt.
    `owners` (rows,) has the index of the contact of each row. `restitutions` has the restitution of each contact, or
    None for a contact whose restitution depends on the impact speed.
    """

    def __init__(self, model: Model, parameters: FloatArray) -> None:
        self.model, self.parameters, self.contacts = model, parameters, model.statement.contacts
        self.rows, self.normals, self.owners = _rows(model)
        self._lengths, self._terms, self._momentum = 0.0, np.zeros(len(self.owners)), 0.0
        self._contacts, self._gaps = _contact_functions(model)
        self._restitution, self.restitutions, self._friction = _coefficients(model, tuple(parameters.tolist()))

    def gaps(self, times: FloatArray, states: FloatArray) -> tuple[FloatArray, float]:
        """Return the gaps (k, N) at times (N,) and states (2n, N), and the size up to which a gap counts as zero."""
        gaps = self._gaps.at_times(times, states, self.parameters)
        return gaps, TOUCHING * max(self._lengths, float(np.abs(gaps).max()))

    def held(self, contact: int, times: FloatArray, states: FloatArray, sticking: NDArray[np.bool_]) -> bool:
        """Return True if a contact is closed at all states (2n, N): gap and gap rate are zero up to rounding.

        `contact` is its index. At states in the mask `sticking` (N,) its slips must also be zero.
        """
        k, mine = len(self.contacts), self.rows[contact]
        values = self._contacts.at_times(times, states, self.parameters)
        gap, rate, slips = values[contact], values[2 * k + mine[0]], values[[2 * k + i for i in mine[1:]]] * sticking
        near, noise = HELD * self._lengths, RATE_NOISE * self._terms[mine].max()
        return bool((np.abs(gap) <= near).all() and (np.abs(rate) <= noise).all() and (np.abs(slips) <= noise).all())

    def rates(self, t: float, y: FloatArray) -> FloatArray:
        """Return the gap rates and slips (rows,) at a state y (2n,)."""
        return self._contacts(t, y, self.parameters)[2 * len(self.contacts) :][: len(self.owners)]

    def at(self, t: float, y: FloatArray, before: ContactState | None = None) -> ContactState:
        """Return the contacts at a state y (2n,), an array that is not changed afterwards.

        `before` may be the contacts at a state with the same coordinates up to rounding. The mass matrix of that state
        is then used again.
        """
        k, rows = len(self.contacts), len(self._terms)
        values = self._contacts(t, y, self.parameters)
        rates, terms, convective = values[2 * k : 2 * k + 3 * rows].reshape(3, rows)
        directions = values[2 * k + 3 * rows :].reshape(rows, -1)
        self._lengths = float(values[k : 2 * k].max(initial=self._lengths))
        self._terms = np.maximum(self._terms, terms)
        near = TOUCHING * self._lengths
        return ContactState(self, t, y, values[:k], rates, directions, convective, self._terms, near, before)

    def inertia(self, touch: ContactState) -> tuple[FloatArray, FloatArray]:
        """Return the `responses` and the `velocity_noise` of a `ContactState`, from the mass matrix at its state."""
        n, v = self.model.dimension, touch.y[self.model.layout.v]
        mass = np.asarray(self.model.kernel("mass_matrix")(touch.t, touch.y, self.parameters)).reshape(n, n)
        inertia = np.sqrt(np.abs(np.diag(mass)))
        self._momentum = max(self._momentum, float((inertia * np.abs(v)).max()))
        noise = np.where(inertia > 0, ROUND_OFF * self._momentum / np.where(inertia > 0, inertia, 1.0), 0.0)
        directions = touch.directions
        if len(stated := self.stated_directions(touch.t, touch.y)):
            whole = np.block([[mass, -stated.T], [stated, np.zeros((len(stated), len(stated)))]])
            right = np.vstack([directions.T, np.zeros((len(stated), len(directions)))])
            return np.asarray(np.linalg.lstsq(whole, right, rcond=1e-13)[0][:n]), noise
        try:
            return np.asarray(np.linalg.solve(mass, directions.T)), noise
        except np.linalg.LinAlgError:  # The mass matrix is singular, and the next step ends the run.
            return np.asarray(np.linalg.lstsq(mass, directions.T)[0]), noise

    def held_rows(self, states: Sequence[str]) -> list[int]:
        """Return the indices of the rows that are zero: gap rates of closed contacts, and slips of sticking contacts.

        `states` are the states of the contacts, such as "open".
        """
        pairs = zip(self.rows, states, strict=True)
        return [row for mine, state in pairs if state != OPEN for row in (mine if state == STICKING else mine[:1])]

    def closed(self, touch: ContactState, contacts: Sequence[int], unchanged: Sequence[int] = ()) -> FloatArray:
        """Return the state of `touch` with the gaps of `contacts` (indices) closed by one Newton step.

        The change is the least, measured by the kinetic energy. The gaps of `unchanged` contacts do not change.
        """
        both = [*contacts, *(i for i in unchanged if i not in contacts)]
        y, changes = touch.y.copy(), [*touch.gaps[contacts], *np.zeros(len(both) - len(contacts))]
        y[self.model.layout.q] -= touch.least_motion([self.normals[i] for i in both], changes)
        return y

    def stated_directions(self, t: float, y: FloatArray) -> FloatArray:
        """Return the gradients (m, n) of the system's stated constraints by the velocities, at a state y (2n,)."""
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
