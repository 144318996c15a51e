"""Search a run for steps on which a constraint jumps, has a corner, or loses its effect, so that the run must end.

Velocities on y = abs(x) jump at x = 0, and the constraint does not define them after the corner. A step over such a
corner is projected onto the constraints on the other side, without any error. A constraint that is nonlinear in the
velocities has no effect where all its derivatives by the velocities are zero. For example, where x.dot**2 + y.dot**2 =
(1 - t)**2 reaches 0, every direction is possible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.equations.singular import Singular, dependent_rows
from lagrange.errors import formula
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.trajectory.constraints.residuals import ON_SURFACE, ConstraintResiduals, residuals_of

HALVINGS = 50
"""Number of bisections that locate a switching surface on the straight line between the states at both ends of a step.
They locate it to the spacing of floating-point numbers."""

SURFACE_DISTANCE = 1e-6
"""Distance before and after a switching surface at which constraints are compared, as a fraction of the step."""

CONTINUOUS = 4.0
"""Largest change of a continuous constraint over a switching surface, as a multiple of its change over an equal
distance beside the surface. With a larger change the constraint jumps."""

LONGEST_SURFACE = 80
"""Longest expression that a message shows, in characters."""

CHANGE_NOISE = 1e-9
"""Largest change of a constraint over a switching surface that counts as rounding, as a fraction of its terms. The
surface is located to 1e-15 of a step."""

VANISHING_GRADIENT = 1e-2
"""Largest size of a row of the constraint gradient G that counts as zero inside a step, as a fraction of its size at
the ends of the step. The constraint must hold there to the same fraction of its terms. While a velocity only changes
its direction, the row does not become so small."""

SEARCH_AHEAD = 1e-6
"""Time, as a fraction of the run, over which the motion ahead is searched for a discontinuity of a constraint after the
steps have become too small."""


@dataclass(frozen=True, eq=False)
class Discontinuity:
    """A discontinuity of a constraint inside a step of a run.

    The step begins at the state `y` (2n,) at the time `t` and ends at the time `after`. The discontinuity is at the
    fraction `part` of the step. `what` is the message about it. `steps` is the number of steps from `t` to the last
    state that was searched.
    """

    t: float
    y: FloatArray
    after: float
    part: float
    what: str
    steps: int


class Discontinuities:
    """Finds the corners and jumps of constraints in runs of one model with parameters (k,).

    It searches steps that were taken, or a straight line ahead of a state. At a corner or a jump a constraint has no
    derivatives, and so no force. `span` is the duration of the run.
    """

    def __init__(self, model: Model, parameters: FloatArray, span: float) -> None:
        self.model, self.parameters, self.span = model, parameters, span
        self.residuals: ConstraintResiduals = residuals_of(model)

    def on(self, times: FloatArray, states: FloatArray) -> Discontinuity | None:
        """Return the first discontinuity on the steps between states (k, 2n) of a run at times (k,), or None."""
        candidates = self._switched(times, states), self._vanishing(times, states)
        row, part, what = min(filter(None, candidates), key=lambda candidate: candidate[:2], default=(0, 0.0, ""))
        if not what:
            return None
        steps = int(np.count_nonzero(np.diff(times[row:])))
        return Discontinuity(float(times[row]), states[row], float(times[row + 1]), part, what, steps)

    def ahead(self, t: float, y: FloatArray, step: float) -> str:
        """Return a message if the motion soon meets a discontinuity of a constraint, else "".

        The motion from the state y (2n,) at time t is replaced by a straight line along its slope. The search extends
        over two steps of the size `step`, or over a small fraction of the run if `step` is 0.
        """
        h = 2 * step if step else SEARCH_AHEAD * self.span
        try:
            slope = self.model.kernel("rhs")(t, y, self.parameters)
        except SingularMassMatrix:
            return ""
        if not np.isfinite(slope).all():
            return ""
        discontinuity = self.on(np.array([t, t + h]), np.array([y, y + h * slope]))
        return "" if discontinuity is None else discontinuity.what

    def _switched(self, times: FloatArray, states: FloatArray) -> tuple[int, float, str] | None:
        """Return the first switching surface at which a constraint jumps or has a corner, or None.

        `times` is (k,), `states` is (k, 2n). The result is the index of the state before the surface, the fraction of
        the step at which the surface is reached, and a message.
        """
        g = self.residuals.surfaces(times, states.T, self.parameters)
        begins, ends = g[:, :-1], g[:, 1:]
        reached = np.abs(ends) <= ON_SURFACE * np.abs(begins)
        changes = ((np.sign(begins) * np.sign(ends) <= 0) | reached) & (begins != ends) & (np.diff(times) != 0)
        surfaces, rows = np.nonzero(changes)
        if not len(rows):
            return None
        order = np.argsort(rows, kind="stable")
        surfaces, rows = surfaces[order], rows[order]
        parts = self._zeros(times, states, rows, surfaces)
        before, near, after, far = (
            _Surface.at(self.residuals, *_chord(times, states, rows, parts + share * SURFACE_DISTANCE), self.parameters)
            for share in (-2, -1, 1, 2)
        )
        with np.errstate(all="ignore"):
            over, beside = after.change(near), np.maximum(near.change(before), far.change(after))
            # Rows: the constraints phi, then psi with rows of G. Columns: crossings of surfaces.
            jumping = over > CONTINUOUS * beside + CHANGE_NOISE
        # The velocity of a coordinate without inertia jumps with a force in its equation, and the motion goes on.
        jumping[len(jumping) - self.residuals.settled :] = False
        passed = np.flatnonzero(jumping.any(axis=0))
        if not len(passed):
            return None
        first = min(passed.tolist(), key=lambda column: (rows[column], parts[column]))
        which = int(np.argmax(jumping[:, first]))
        return int(rows[first]), float(parts[first]), self._told(which, int(surfaces[first]))

    def _told(self, which: int, surface: int) -> str:
        """Return the message for a jump or corner of a constraint at a switching surface.

        `which` is the index of the constraint in `residuals.labels`, and `surface` the index of the surface.
        """
        name, node = self.residuals.labels[which], self.residuals.switched.expressions[surface]
        zero = self.model.equations.express(node).xreplace(dict(self.model.statement.plain))
        where = formula(-zero if zero.could_extract_minus_sign() else zero, LONGEST_SURFACE)
        if which < self.residuals.places:
            return (
                f"the constraint {name!r} jumps where {where} = 0, and no motion continues beyond it. End the run "
                "before it by an event, or state the constraint without the jump."
            )
        return (
            f"the constraint {name!r} has a corner where {where} = 0: velocities jump there, in a way that is not "
            "stated. End the run before it by an event, or write the constraint smoothly."
        )

    def _zeros(
        self, times: FloatArray, states: FloatArray, rows: NDArray[np.intp], surfaces: NDArray[np.intp]
    ) -> FloatArray:
        """Return for k pairs of a step and a surface the fractions (k,) of the step at which the surface is crossed.

        Pair i is the step that begins at the state with index `rows[i]`, and the surface with index `surfaces[i]`. On a
        step, the states lie on the straight line to the next state.
        """
        columns = np.arange(len(rows))

        def values(parts: FloatArray) -> FloatArray:
            surface_values = self.residuals.surfaces(*_chord(times, states, rows, parts), self.parameters)
            return np.asarray(surface_values[surfaces, columns])

        low, high = np.zeros(len(rows)), np.ones(len(rows))
        begin = values(low)
        # If a step starts on the surface, its start is the zero.
        high[begin == 0] = 0.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            before = np.sign(values(middle)) == np.sign(begin)
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        return high

    def _vanishing(self, times: FloatArray, states: FloatArray) -> tuple[int, float, str] | None:
        """Return the first step on which a row of G that depends on velocities becomes zero, or None.

        G is the gradient of the constraints by the velocities. The result is the index of the state before the step,
        the fraction of the step at which the row is zero, and a message.
        """
        if not len(self.residuals.turning):
            return None
        g = self.residuals.gradients(times, states.T, self.parameters)[self.residuals.turning]
        before, change = g[:, :, :-1], np.diff(g, axis=2)
        with np.errstate(all="ignore"):
            parts = np.clip(-(before * change).sum(axis=1) / (change**2).sum(axis=1), 0.0, 1.0)
            least = np.linalg.norm(before + parts[:, None] * change, axis=1)
            ends = np.maximum(np.linalg.norm(before, axis=1), np.linalg.norm(g[:, :, 1:], axis=1))
            which, rows = np.nonzero((least <= VANISHING_GRADIENT * ends) & (np.diff(times) != 0))
        for row, index in sorted(zip(rows.tolist(), which.tolist(), strict=True)):
            constraint, part = int(self.residuals.turning[index]), float(parts[index, row])
            # The constraint must hold there, relative to its terms at both ends of the step.
            t, y = _chord(times, states, np.full(3, row), np.array([0.0, 1.0, part]))
            values, sizes = self.residuals.of_many(t, y, self.parameters)
            of_velocity = self.residuals.places + constraint
            if abs(values[of_velocity, 2]) <= VANISHING_GRADIENT * max(sizes[of_velocity, :2]):
                dependent = Singular(0.0, rows=((constraint, 1.0),))
                relation = dependent_rows(self.model.equations.constraints.names, dependent)
                message = (
                    f"{relation} on the step from there, and does not determine how the motion continues. End the run "
                    "before it by an event, or state the constraint in another way."
                )
                return row, part, message
        return None


@dataclass(frozen=True, eq=False)
class _Surface:
    """Constraints at k states on one side of a switching surface, scaled so that two sides can be compared.

    `values` (p + m, k) are the p constraints on positions, phi, and the m on velocities, psi. `sizes` (p + m, k) are
    the sums of magnitudes of their terms. `rows` (m, n, k) is the gradient G. `positions` (p,) are the indices of the
    rows of G that belong to phi. Everything is divided by the lengths of the rows of G, so that the two sides agree
    although a constraint is multiplied by another factor on the other side.
    """

    values: FloatArray
    sizes: FloatArray
    rows: FloatArray
    positions: NDArray[np.intp]

    @classmethod
    def at(cls, residuals: ConstraintResiduals, t: FloatArray, y: FloatArray, parameters: FloatArray) -> _Surface:
        """Return the scaled constraints at times (k,) and states (2n, k). `residuals` evaluates them."""
        values, sizes = residuals.of_many(t, y, parameters)
        rows = residuals.gradients(t, y, parameters)
        lengths = np.linalg.norm(rows, axis=1)
        lengths = np.where(lengths > 0, lengths, 1.0)
        positions = np.flatnonzero(residuals.holonomic)
        units = np.concatenate([lengths[positions], lengths])
        return cls(values / units, sizes / units, rows / lengths[:, None], positions)

    def change(self, other: _Surface) -> FloatArray:
        """Return the relative difference (p + m, k) of each constraint between this side and the `other` one.

        First come the p constraints phi on positions: the difference of their values, relative to their terms. Then
        come the m constraints psi on velocities: the same difference, or that of the row of G if it is larger.
        """
        signs = np.where((self.rows * other.rows).sum(axis=1) < 0, -1.0, 1.0)
        turned = np.abs(self.rows - signs[:, None] * other.rows).max(axis=1)
        signs = np.concatenate([signs[self.positions], signs])
        values = np.abs(self.values - signs * other.values) / (self.sizes + other.sizes)
        values[len(self.positions) :] = np.maximum(values[len(self.positions) :], turned)
        return values


def may_be_discontinuous(model: Model) -> bool:
    """Return True if constraints of a model may jump, have a corner, or lose their effect at some state."""
    if not len(model.equations.constraints):
        return False
    return bool(residuals_of(model).switched.stated) or len(residuals_of(model).turning) > 0


def _chord(
    times: FloatArray, states: FloatArray, rows: NDArray[np.intp], parts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return times (k,) and states (2n, k) on straight lines between successive states of a run.

    Line i begins at the state with index `rows[i]`. Result i is the point at the fraction `parts[i]` of this line.
    """
    t = times[rows] + parts * (times[rows + 1] - times[rows])
    return t, (states[rows] + parts[:, None] * (states[rows + 1] - states[rows])).T
