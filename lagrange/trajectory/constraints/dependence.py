"""Find linearly dependent constraints: at a state, at all nearby states on the constraints, or along a run.

Two motions may cross at a configuration with dependent constraints. For example, a parallelogram linkage continues as a
parallelogram, or with crossed rods. A long step over the crossing follows the smooth motion, but short steps towards
the crossing may not. The constraints are violated by some e, from rounding and the tolerance. Near the crossing the
distance of the two motions is only sqrt(e), so e decides which of them the run follows. Where s is the least singular
value of the constraints relative to the start, the violation e changes velocities by the fraction e / s**2.
"""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

import numpy as np

from lagrange.equations.singular import DEPENDENT, Singular, dependent_everywhere, least_regular, scales
from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.statement import REFUSE
from lagrange.trajectory.constraints.projection import Projection
from lagrange.trajectory.constraints.residuals import residuals_of, units_of

AROUND = 1e-2
"""Distance of sample states from a state at which constraints are dependent, as a fraction of the largest coordinate.
If they are dependent only at this state, their least singular value at the samples is of about this size."""

NEARBY_SAMPLES = 4
"""Number of sample states near a state at which constraints are dependent. The samples are moved onto the constraints.
If the constraints are dependent at all of them, they count as dependent everywhere."""

CLEARLY = 1e-4
"""Least singular value of the constraints' gradients, as a fraction of the largest one, above which they are certainly
independent. The entries of a typed start may be rounded to 1e-6, so that dependent gradients differ by about 1e-6."""

VANISHING_RATIO = 1e-3
"""Largest size of a constraint's gradient that counts as zero where the constraint holds, as a fraction of its size at
a nearby state where it does not hold. For a squared constraint, such as x**2 = 0, this fraction is 1e-6 / AROUND."""


def dependence_around(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> Singular | None:
    """Return the constraints that are dependent at a state y (2n,) and at all nearby states on the constraints.

    Constraints are dependent if their rows of the gradient G are linearly dependent. The result is None if there are
    no such constraints.
    """
    projection, first = Projection(model, t, parameters), None
    units = units_of(projection.metric(y))
    random, (q, v) = np.random.default_rng(11), model.layout.split(y)
    size = AROUND * (np.abs(units * q).max(initial=0.0) or 1.0) / units
    tried = [y, *(np.concatenate([q + size * random.uniform(-1.0, 1.0, len(q)), v]) for _ in range(NEARBY_SAMPLES))]
    for state in tried:
        reached = projection.reached(state)
        if reached is None:
            continue
        # A state on the constraint surface is compared with a nearby state off it.
        off = tried[1] if state is y else state
        gradient, off_gradient = (residuals_of(model).gradient(t, point, parameters) for point in (reached, off))
        vanishing = np.flatnonzero(np.abs(gradient).max(axis=1) < VANISHING_RATIO * np.abs(off_gradient).max(axis=1))
        if len(vanishing):
            # A squared constraint, such as x**2 = 0, has a gradient that vanishes where it holds.
            dependent: Singular | None = Singular(0.0, rows=((int(vanishing[0]), 1.0),))
        else:
            # Masses do not matter here, so the metric is the identity.
            dependent = least_regular(np.eye(gradient.shape[1]), gradient)
            if dependent is None or not dependent.rows or not dependent.regularity <= DEPENDENT:
                return None
        first = dependent if first is None else first
    return first


_INDEPENDENT: WeakKeyDictionary[Model, bytes] = WeakKeyDictionary()
"""The parameters, as bytes, for which the constraints of each model were last found independent at some state. With the
same parameters they are not dependent at all states on the constraints, so that the test need not be repeated."""


def check_independent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> None:
    """Raise StatementError if constraints are dependent at a start and at all nearby states that satisfy them.

    Without this test, rounding may make the rows of their gradient look independent, with multipliers of 1e16. The test
    is left out if the last start of the model had the same parameters.
    """
    if model.statement.redundant != REFUSE or _INDEPENDENT.get(model) == parameters.tobytes():
        return
    if not _clearly_independent(model, t, y, parameters):
        refuse_dependent(model, t, y, parameters)
    _INDEPENDENT[model] = parameters.tobytes()


def _clearly_independent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> bool:
    """Return True if a quick test shows that the rows of the gradient G are independent at a state y (2n,).

    The test also fails if a row at y is much smaller than at a nearby state. It takes 0.02 ms for a four-bar linkage.
    After a failure `dependence_around` decides, in 0.8 ms.
    """
    q = model.layout.split(y)[0]
    beside = y.copy()
    beside[model.layout.q] += AROUND * (np.abs(q).max(initial=0.0) or 1.0) * np.cos(np.arange(len(q)))
    rows = residuals_of(model).gradient(t, y, parameters)
    around = residuals_of(model).gradient(t, beside, parameters)
    if not (np.isfinite(rows).all() and np.isfinite(around).all()):
        return False
    sizes = np.abs(rows).max(axis=1)
    if not (sizes > VANISHING_RATIO * np.abs(around).max(axis=1)).all():
        return False
    values = np.linalg.svd(rows / sizes[:, None], compute_uv=False)
    return len(rows) <= rows.shape[1] and bool(values[-1] > CLEARLY * values[0])


def refuse_dependent(model: Model, t: float, y: FloatArray, parameters: FloatArray) -> None:
    """Raise StatementError if a state y (2n,) has no accelerations because its constraints are dependent.

    The error is raised only if they are dependent also at all nearby states that satisfy the constraints.
    """
    dependent = dependence_around(model, t, y, parameters)
    if dependent is not None:
        allowed = model.statement.redundant != REFUSE
        raise StatementError(dependent_everywhere(residuals_of(model).names, dependent, allowed=allowed))


SHORT_STEP = 0.1
"""Length of a step, as a fraction of the mean step, below which its ends are tested for dependent constraints. Towards
a crossing of two motions steps shrink to 1e-2 to 1e-4 of the mean step."""

FIRST_STEPS = 3
"""Number of steps at the start of a run that are not tested for dependent constraints. They are short because the step
size is still being determined."""

MOST_SHORT_STEPS = 5_000
"""Largest number of short steps that are tested for dependent constraints. If there are more, the shortest are tested.
The test of both ends of a step takes 20 us."""

MANY_STEPS = 10_000
"""Smallest number of steps of a run whose shortest step is always tested for dependent constraints, even if it is not
much shorter than the others. The test then takes a small part of the time of the run."""

DEPENDENCE_FACTOR = 3.0
"""Largest least singular value at which constraints count as dependent in a run, in units of sqrt(rtol). It is relative
to the value at the start. Runs of four methods over crossings had values of 1e-6 to 5e-5 at rtol = 1e-9."""

SURELY_FAR = 1e2
"""Factor of the threshold in a quick test for dependent constraints, which does not scale the coordinates. Scaling
changes the least singular value of normalised rows of the gradient by less than this factor. Only states below the
threshold times this factor are tested again, with scaled coordinates."""

AWAY, STATES_AFTER = 0.1, 32
"""Test that a motion has moved away from a state with dependent constraints: the relative least singular value above
which it has, and the number of later states at which this value is computed."""


def dependent_passage(
    model: Model, times: FloatArray, states: FloatArray, parameters: FloatArray, rtol: float, *, stopped: bool = False
) -> tuple[int, Singular] | None:
    """Find the first state at which constraints are dependent, so that rounding decides the motion after it.

    `times` (S+1,) and `states` (S+1, 2n) are those of S accepted steps. Only states at short steps are searched.
    Returns the dependent constraints and the index of an earlier state, the last one at which the velocities are
    accurate to sqrt(rtol), or None if no constraints are dependent. If the run has `stopped` early, a dependence counts
    only if the motion moved away from it afterwards: a run may end where constraints are dependent.
    """
    count = len(times) - 1 - FIRST_STEPS
    if count < 2 or not rtol:
        return None
    # The last step is ignored too: its length is only the remaining time of the run.
    sizes = np.abs(times[FIRST_STEPS + 1 : -1] - times[FIRST_STEPS:-2])
    if count < MANY_STEPS and sizes.min() * count > SHORT_STEP * abs(times[-1] - times[FIRST_STEPS]):
        return None
    few = np.argsort(sizes, kind="stable")[:MOST_SHORT_STEPS]
    short = few[sizes[few] <= max(SHORT_STEP * float(sizes.mean()), float(sizes.min()))]
    rows = FIRST_STEPS + np.unique(np.append(short, short + 1))
    near, bound = _Nearness(model, parameters, times, states), DEPENDENCE_FACTOR * math.sqrt(rtol)
    for row in rows[near.at(times[rows], states[rows]) <= SURELY_FAR * bound].tolist():
        after = slice(row, None, -(-(len(times) - row) // STATES_AFTER))
        if stopped and near.at(times[after], states[after]).max() <= AWAY:
            return None
        dependent = near.dependent(float(times[row]), states[row])
        if dependent is not None and dependent.motion is None and dependent.regularity <= bound:
            # A violation rtol of the constraints changes the velocities by at most sqrt(rtol) at the earlier state.
            while row > 0 and near.at(times[[row]], states[[row]])[0] < rtol**0.25:
                row -= 1
            return row, dependent
    return None


class _Nearness:
    """Measures how near the constraints are to dependence at states of a run: by the least singular value of G.

    G is the gradient of the constraints. Its rows are divided by their largest lengths at the start, the middle and the
    end of the run. The value is relative to the largest of its values at these three states, since a motion may begin
    or end near dependent constraints.
    """

    def __init__(self, model: Model, parameters: FloatArray, times: FloatArray, states: FloatArray) -> None:
        self._residuals, self._parameters = residuals_of(model), parameters
        self._rows = [self._residuals.names.index(name) for name in model.equations.constraints.names]
        samples = [0, len(times) // 2, -1]
        gradients = self._gradients(times[samples], states[samples])
        sizes = np.sqrt((gradients**2).sum(axis=2))
        sizes[~np.isfinite(sizes)] = 0.0
        self._longest = gradients[sizes.argmax(axis=0), np.arange(len(self._rows))]
        lengths = sizes.max(axis=0)
        self._lengths, self._unit = np.where(lengths > 0, lengths, 1.0)[:, None], 1.0
        values = self.at(times[samples], states[samples])
        self._unit = float(values[np.isfinite(values)].max(initial=0.0))

    def _gradients(self, times: FloatArray, states: FloatArray) -> FloatArray:
        """Return the constraint gradients G (k, m, n) at times (k,) and states (k, 2n)."""
        with np.errstate(all="ignore"):
            return np.moveaxis(self._residuals.gradients(times, states.T, self._parameters)[self._rows], 2, 0)

    def at(self, times: FloatArray, states: FloatArray) -> FloatArray:
        """Return the relative least singular values (k,) of G at times (k,) and states (k, 2n).

        A value is infinite if G is not finite.
        """
        matrices = self._gradients(times, states) / self._lengths
        finite = np.isfinite(matrices).all(axis=(1, 2))
        values = np.full(len(times), np.inf)
        # If constraints are dependent everywhere, the reference is zero and cannot scale the values.
        if self._unit:
            values[finite] = np.linalg.svd(matrices[finite], compute_uv=False)[:, -1] / self._unit
        return values

    def dependent(self, t: float, y: FloatArray) -> Singular | None:
        """Return the combination of constraints that is nearest to dependence at time t and state y (2n,).

        The result is None if the gradient G is not finite.
        """
        unit = np.eye(self._longest.shape[1])
        gradient = self._residuals.gradient(t, y, self._parameters)[self._rows]
        return least_regular(unit, gradient, scales(unit, self._longest))
