"""Project a state onto the constraints of its model, and refuse an initial state that violates them, with a message."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from lagrange.algorithm.projection import KEPT_VIOLATION
from lagrange.equations.euler_lagrange import RELATION
from lagrange.equations.singular import RANK, balanced
from lagrange.errors import StatementError, listing
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.coordinate import name_of
from lagrange.statement.expression import TYPED_ROUNDING
from lagrange.statement.rotation import symbols_of_entries
from lagrange.statement.statement import Constraint
from lagrange.trajectory.constraints.residuals import ON_SURFACE, ConstraintResiduals, Residuals, residuals_of, units_of

NAMED_CONSTRAINTS = 3
"""Largest number of constraints that an error message names."""

MOST_ENTRIES = 4
"""Largest number of entries of a state that an error message lists in full. If there are more, it lists only those that
differ from the initial values of the statement."""

LONGEST_EXPRESSION = 60
"""Longest expression that a message shows, in characters."""

CONVERGED = KEPT_VIOLATION / 2
"""Largest residual of a constraint, as a fraction of its size, that a projection leaves. It is smaller than the
violation that steps of a run leave uncorrected, so that the first step does not move a projected start."""

NEAREST_CORRECTIONS = 60
"""Largest number of corrections of a start by Newton's method, which converges within ten from a nearby state."""

SHARES = tuple(2.0**-k for k in range(11))
"""Fractions of a correction that the search for a state on the constraints tries in turn. The first one with a smaller
error is taken. If none has a smaller error, the search ends."""

MOST_DESCENTS = 200
"""Largest number of steps along a surface in the search for the point nearest to a start. A step multiplies the
remaining distance by about the curvature of the surface times the distance of the start from it."""

NEAREST = 1e-9
"""Length of a step along a surface at which the search for the point nearest to a start ends, as a fraction of the
distance from the start. The search also ends if the step is rounding."""

Surface = Callable[[FloatArray], Residuals]


class Nearest:
    """Search for the point of a surface that is nearest to a start: the set on which all residuals are zero.

    `surface` maps a point (k,) to its residuals. `metric` (k, k) is the symmetric matrix that measures distances. It
    may be singular if it is definite on the tangents of the surface. Only the `free` entries (a mask) of the start may
    change.
    """

    def __init__(self, surface: Surface, metric: FloatArray, free: FloatArray) -> None:
        self._surface, self._metric = surface, metric
        self._free = np.flatnonzero(free)

    def of(self, start: FloatArray) -> tuple[FloatArray, Residuals]:
        """Return the point of the surface nearest to `start` (k,), and its residuals.

        If the search fails, the point is its last iterate, which is not on the surface.
        """
        x, residuals = self.restored(start)
        if residuals.largest > ON_SURFACE:
            return x, residuals
        for _ in range(MOST_DESCENTS):
            along = self._step(residuals, start - x, np.zeros_like(residuals.values))
            if self._length(along) <= max(NEAREST * self._length(x - start), CONVERGED * self._length(x)):
                break
            before = self._length(x - start)
            for share in SHARES:
                trial, trial_residuals = self.restored(x + share * along)
                if trial_residuals.largest <= ON_SURFACE and self._length(trial - start) < before:
                    break
            else:
                break
            x, residuals = trial, trial_residuals
        return x, residuals

    def restored(self, start: FloatArray) -> tuple[FloatArray, Residuals]:
        """Return a point of the surface close to `start` (k,), and its residuals.

        Newton's method takes the shortest step that solves the linearized equations. Unlike `of`, it does not look for
        the nearest point. If it fails, the point is its last iterate.
        """
        x, residuals = start, self._surface(start)
        for _ in range(NEAREST_CORRECTIONS):
            if not CONVERGED < residuals.largest < math.inf or not np.isfinite(residuals.gradient).all():
                break
            correction = self._step(residuals, np.zeros_like(x), -residuals.values)
            for share in SHARES:
                trial_residuals = self._surface(x + share * correction)
                if trial_residuals.largest < residuals.largest:
                    break
            else:
                break
            x, residuals = x + share * correction, trial_residuals
        return x, residuals

    def _step(self, residuals: Residuals, towards: FloatArray, right: FloatArray) -> FloatArray:
        """Return the displacement d (k,) nearest to `towards` (k,) that solves G d = `right` (m,).

        G (m, k) is the gradient of the `residuals`. Distances are measured by the metric. The result is zero if d
        overflows.
        """
        free, n = self._free, len(self._free)
        gradient = residuals.gradient[:, free]
        matrix = np.block([[self._metric[np.ix_(free, free)], gradient.T], [gradient, np.zeros((len(right),) * 2)]])
        step = np.zeros_like(towards)
        with np.errstate(all="ignore"):
            scaled, scale = balanced(matrix)
            right_side = np.concatenate([(self._metric @ towards)[free], right]) / scale
            if not (np.isfinite(scaled).all() and np.isfinite(right_side).all()):
                return step
            solution = np.linalg.lstsq(scaled, right_side, rcond=RANK)[0] / scale
        if np.isfinite(solution).all():
            step[free] = solution[:n]
        return step

    def _length(self, displacement: FloatArray) -> float:
        with np.errstate(over="ignore", invalid="ignore"):  # the square of a large distance may overflow
            square = float(displacement @ self._metric @ displacement)
        return math.sqrt(max(square, 0.0)) if not math.isnan(square) else math.inf


class Projection:
    """Projects states of one model at time t onto its constraints: first the coordinates, then the velocities.

    The entries of the state with the indices `held` keep their values.
    """

    def __init__(self, model: Model, t: float, parameters: FloatArray, held: Sequence[int] = ()) -> None:
        self.model, self.t, self.parameters = model, t, parameters
        self.residuals: ConstraintResiduals = residuals_of(model)
        self.free = np.ones(model.layout.size, dtype=bool)
        self.free[list(held)] = False

    def metric(self, y: FloatArray) -> FloatArray:
        """Return the mass matrix (n, n) at a state (2n,). Raises StatementError if it is not finite."""
        with np.errstate(all="ignore"):
            mass = self.residuals.mass_matrix(self.t, y, self.parameters)
        if not np.isfinite(mass).all():
            raise StatementError(
                f"the mass matrix is not finite at the initial state ({self.place(y)}): give another initial state."
            )
        return mass

    def is_off(self, y: FloatArray) -> bool:
        """Return True if a state (2n,) is off the constraints by more than rounding."""
        return self.share(y) > ON_SURFACE

    def share(self, y: FloatArray) -> float:
        """Return the largest violation of a constraint at a state (2n,), relative to the size of its residual.

        The size is the sum of the magnitudes of the constraint's terms, or the gradient times the largest entry of the
        state if that is larger.
        """
        units = units_of(self.metric(y))
        return max(self._at(part, y, units).largest for part in (0, 1))

    def completed(self, y: FloatArray) -> FloatArray:
        """Return a state y (2n,) with the velocities of coordinates without inertia computed from their equations.

        Only velocities that are zero are computed. Other velocities were chosen by the user, and `check` tests them.
        Raises StatementError if the equations have no solution, or several.
        """
        rows = self.model.equations.following
        if not rows:
            return y
        alone = np.zeros(len(y), dtype=bool)
        alone[rows] = True
        completed_state = self.solved_for(rows, y)
        if completed_state is None:
            # Equations such as 1 - e = abs(e.dot)*e.dot have no slope at rest: the guesses 1 and -1 must agree.
            starts = (np.where(alone & (y == 0.0), sign, y) for sign in (1.0, -1.0))
            ends = [end for start in starts if (end := self.solved_for(rows, start)) is not None]
            unique = ends and np.allclose(ends[0], ends[-1], rtol=TYPED_ROUNDING, atol=0.0)
            completed_state = ends[0] if unique else None
        if completed_state is None:
            names = listing(self.model.statement.names[i] for i in self.model.equations.first_order)
            raise StatementError(
                f"the velocities of {names}, without inertia, are not determined at the initial state "
                f"({self.place(y)}): the first-order equations of motion have no solution for them, or several. Give "
                "velocities that satisfy these equations, or another initial state."
            )
        return np.where(alone & (y == 0.0), completed_state, y)

    def solved_for(self, rows: Sequence[int], y: FloatArray) -> FloatArray | None:
        """Return the state y (2n,) with its entries `rows` (indices) computed from all others, or None.

        The equations are the constraints, and the equations of motion of coordinates without inertia. None means that
        no solution was found.
        """
        fixed = [row for row in range(len(y)) if row not in rows]
        return Projection(self.model, self.t, self.parameters, fixed).reached(y)

    def check(self, y: FloatArray) -> None:
        """Raise StatementError if a state y (2n,) violates a constraint by more than the rounding of typed numbers."""
        units = units_of(self.metric(y))
        for part in (0, 1):
            residuals = self._at(part, y, units)
            self.differentiable(residuals, part, y)
            if far := _far(residuals):
                raise StatementError(self._violated(residuals, far, part, y))

    def violated(self, y: FloatArray, before: FloatArray) -> str | None:
        """Return a sentence on the constraints that a state y (2n,) violates by more than rounding, or None.

        Coordinates are compared after scaling by the roots of their inertias at the state `before` (2n,), where the
        mass matrix is finite.
        """
        units = units_of(self.metric(before))
        for part in (0, 1):
            residuals = self._at(part, y, units)
            if far := _far(residuals):
                return f"{self._values(residuals, far, part)}."
        return None

    def of(self, y: FloatArray) -> FloatArray:
        """Return the state (2n,) on the constraints that is nearest to y (2n,).

        Raises StatementError if none is found.
        """
        units, after = units_of(self.metric(y)), y
        for part in (0, 1):
            self.differentiable(self._at(part, after, units), part, after)
            after, residuals = self._nearest(part, after, units)
            if not residuals.largest <= ON_SURFACE:
                raise StatementError(self._not_met(residuals, part, after))
        return after

    def reached(self, y: FloatArray, *, nearest: bool = True) -> FloatArray | None:
        """Return the state (2n,) on the constraints that is nearest to y (2n,), or None if none is found.

        If `nearest` is False, return a state that is close to y but not the nearest. This takes a tenth of the time.
        """
        units, after = units_of(self.metric(y)), y
        for part in (0, 1):
            after, residuals = self._nearest(part, after, units, nearest=nearest)
            if not residuals.largest <= ON_SURFACE:
                return None
        return after

    def _nearest(
        self, part: int, y: FloatArray, units: FloatArray, *, nearest: bool = True
    ) -> tuple[FloatArray, Residuals]:
        """Move the coordinates (part 0) or the velocities (part 1) of a state y (2n,) by least onto the constraints.

        Return the new state and its residuals. `units` (n,) are the scales of displacements, the square roots of
        inertia. If the search fails, the state is the last iterate. If `nearest` is False, a state is returned that is
        close to y but not the nearest. This takes less time.
        """
        rows = (self.model.layout.q, self.model.layout.v)[part]

        def moved(entries: FloatArray) -> FloatArray:
            after = y.copy()
            after[rows] = entries
            return after

        search = Nearest(lambda entries: self._at(part, moved(entries), units), self.metric(y), self.free[rows])
        point, residuals = search.of(y[rows]) if nearest else search.restored(y[rows])
        return moved(point), residuals

    def differentiable(self, residuals: Residuals, part: int, y: FloatArray) -> None:
        """Raise StatementError if a constraint has no value, or no derivative, at the state y (2n,).

        `residuals` are the constraints' residuals at this state. `part` is 0 for constraints on coordinates, 1 for
        constraints on velocities.
        """
        all_stated, corner = self.residuals.stated, self.residuals.at_corner(self.t, y, self.parameters)
        if corner is not None:
            raise StatementError(self._not_differentiable(all_stated[corner], y))
        for row, stated in enumerate(self._stated(part)):
            if not np.isfinite(residuals.values[row]):
                raise StatementError(
                    f"the constraint {stated.name!r}, {_text(stated, self.model)} = 0, has no finite value at the "
                    f"initial state ({self.place(y)}): look for a division by zero, or a sqrt or log outside its "
                    "domain, or give another initial state."
                )
            if not np.isfinite(residuals.gradient[row]).all():
                raise StatementError(self._not_differentiable(stated, y))

    def _not_differentiable(self, stated: Constraint, y: FloatArray) -> str:
        return (
            f"the constraint {stated.name!r}, {_text(stated, self.model)} = 0, is not differentiable at the initial "
            f"state ({self.place(y)}): give another initial state, or write it smoothly, such as "
            "x**2 + y**2 - l**2 for sqrt(x**2 + y**2) - l."
        )

    def place(self, y: FloatArray) -> str:
        """Return the entries of a state (2n,) as text for a message, such as "x = 1 and x.dot = 0"."""
        return listing(f"{name} = {x:.6g}" for name, x in zip(self.model.layout.names(".dot"), y, strict=True))

    def _at(self, part: int, y: FloatArray, units: FloatArray) -> Residuals:
        return self.residuals.of_part(part, self.t, y, self.parameters, units)

    def _stated(self, part: int) -> list[Constraint]:
        """Return the stated constraints on coordinates (part 0), or on velocities (part 1)."""
        return [constraint for constraint in self.residuals.stated if part or constraint.holonomic]

    def _values(self, residuals: Residuals, rows: list[int], part: int) -> str:
        """Return a text with the values of some constraints, for a message.

        `rows` are their indices among the constraints on coordinates (part 0), or among all constraints on velocities
        (part 1). `residuals` has the values.
        """
        stated = self._stated(part)
        values = [
            f"{stated[row].name!r} ({_zero(stated[row], part, self.model)}) is {residuals.values[row]:.6g}, with terms "
            f"of size {residuals.terms[row]:.3g}"
            for row in rows[:NAMED_CONSTRAINTS]
        ]
        more = f", and {len(rows) - NAMED_CONSTRAINTS} more are violated" if len(rows) > NAMED_CONSTRAINTS else ""
        return f"{listing(values)}{more}"

    def _violated(self, residuals: Residuals, rows: list[int], part: int, y: FloatArray) -> str:
        stated = self._stated(part)
        entered = any(stated[row].name.startswith(RELATION) for row in rows)
        leave_out = ", leave out the velocities of coordinates without inertia, which follow" if entered else ""
        what = "velocities do" if part else "state does"
        many = "constraints" if len(rows) > 1 else "constraint"
        return (
            f"the initial {what} not satisfy the {many} at t = {self.t:g}: {self._values(residuals, rows, part)}. "
            f"Give values that satisfy {'them' if len(rows) > 1 else 'it'} to {TYPED_ROUNDING:g}{leave_out}"
            f"{self._nearest_in_words(y)}."
        )

    def _nearest_in_words(self, y: FloatArray) -> str:
        """Return text for a message: the call of `System.consistent` that computes the nearest state, or other advice.

        The advice is for a state y (2n,) from which no nearest state on the constraints is found.
        """
        if self.reached(y) is None:
            return ": no nearest state is found from this one, so give initial values, of coordinates first"
        statement, names = self.model.statement, self.model.layout.names()
        entries = list(zip(names, y.tolist(), statement.initial, strict=True))
        # Entries that the call omits have the values of the statement.
        quaternions = symbols_of_entries(statement.rotations)
        values = [(name, x) for name, x, stated in entries if x != stated or (x and name not in quaternions)]
        if len(values) > MOST_ENTRIES:
            values = [(name, x) for name, x, stated in entries if x != stated]
        pairs = zip(statement.parameters, self.parameters.tolist(), strict=True)
        changed = ", ".join(f"{str(p)!r}: {x!r}" for p, x in pairs if statement.defaults.get(p) != x)
        arguments = [f"{{{', '.join(f'{name!r}: {x:.12g}' for name, x in values)}}}"]
        arguments += [f"parameters={{{changed}}}"] * bool(changed)
        arguments += [f"t={self.t!r}"] * bool(self.t)
        return f", or take the nearest ones, system.consistent({', '.join(arguments)}).initial"

    def _not_met(self, residuals: Residuals, part: int, y: FloatArray) -> str:
        stated = self._stated(part)
        with np.errstate(all="ignore"):
            shares = np.abs(residuals.values) / np.where(residuals.sizes > 0, residuals.sizes, 1.0)
        left = [stated[row].name for row in range(len(stated)) if not shares[row] <= ON_SURFACE]
        row = int(np.nanargmax(shares))
        fixed = [name for name, free in zip(self.model.layout.names(".dot"), self.free, strict=True) if not free]
        remedy = (
            f"Hold fewer values (held: {listing(fixed)}), or give others"
            if fixed
            else "All its derivatives vanish there: give a state away from it"
            if not residuals.gradient[row].any()
            else "Give values that are nearer to them, and look for constraints that contradict one another"
        )
        many = "constraints" if len(left) > 1 else "constraint"
        what = "velocities satisfy" if part else "state near the one given satisfies"
        return (
            f"no {what} the {many} {listing(map(repr, left))}: {stated[row].name!r} "
            f"({_zero(stated[row], part, self.model)}) stays at {residuals.values[row]:.6g}, at {self.place(y)}. "
            f"{remedy}."
        )


def _far(residuals: Residuals) -> list[int]:
    """Return the indices of the residuals that are larger than the rounding of typed numbers, or not finite."""
    near = np.abs(residuals.values) <= np.maximum(TYPED_ROUNDING * residuals.terms, ON_SURFACE * residuals.sizes)
    return np.flatnonzero(~near).tolist()


def _zero(stated: Constraint, part: int, model: Model) -> str:
    """Return, for a message, the text of the expression that is zero where a stated constraint holds.

    For `part` 0, constraints on coordinates, this is the constraint. For `part` 1, constraints on velocities, it is the
    rate of change of the constraint. A constraint that is stated in velocities has the same text in both parts.
    """
    text = _text(stated, model)
    return f"the rate of change of {text}" if part and stated.holonomic else text


def _text(stated: Constraint, model: Model) -> str:
    read = model.statement.reading or model.statement
    typed = next(
        (constraint.expression for constraint in read.constraints if constraint.name == stated.name), stated.expression
    )
    plain = typed.xreplace(dict(model.statement.plain))
    text = str(plain.xreplace({function: sympy.Symbol(name_of(function)) for function in plain.atoms(AppliedUndef)}))
    return text if len(text) <= LONGEST_EXPRESSION else text[: LONGEST_EXPRESSION - 3] + "..."
