"""Detect runs that pass a configuration with dependent constraints, so that rounding decides the motion after it.

Two motions may cross at such a configuration. For example, a parallelogram linkage continues as a parallelogram, or
with crossed rods. A long step over the crossing follows the smooth motion, but short steps towards the crossing may
not. The constraints are violated by some e, from rounding and the tolerance. Near the crossing the two motions are
only sqrt(e) apart, so e decides which of them the run follows. Where s is the least singular value of the constraints
relative to the start, the violation e changes velocities by the fraction e / s**2.
"""

from __future__ import annotations

import math

import numpy as np

from lagrange.equations.singular import Singular, least_regular, scales
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.trajectory.constraints.residuals import residuals_of

SHORT_STEP = 0.1
"""Steps shorter than this fraction of the mean step are inspected. Towards a crossing steps shrink to 1e-2 to 1e-4 of
the mean.
"""

FIRST_STEPS = 3
"""Number of steps at the start that are ignored, because they are short while the step size is determined."""

MOST_SHORT_STEPS = 5_000
"""Largest number of short steps that are inspected, the shortest ones. The states at both ends of one cost some 20 us.
"""

MANY_STEPS = 10_000
"""In runs of at least this many steps the shortest step is always inspected, because the cost is relatively small."""

DEPENDENCE_FACTOR = 3.0
"""Constraints count as dependent if their least singular value, relative to the start, is below this times the square
root of rtol. Runs of four methods over crossings had 1e-6 to 5e-5 at rtol = 1e-9."""

SURELY_FAR = 1e2
"""Margin for unit scaling: units change the least singular value of rows by less than this factor, once the rows are
normalised."""

AWAY, STATES_BEHIND = 0.1, 32
"""Relative singular value above which a motion has moved away from a crossing, and the number of states after the
crossing at which this is tested.
"""


def dependent_passage(
    model: Model, times: FloatArray, states: FloatArray, parameters: FloatArray, rtol: float, *, stopped: bool = False
) -> tuple[int, Singular] | None:
    """Find the first state at which constraints are dependent, so that rounding decides the motion after it.

    `times` (S+1,) and `states` (S+1, 2n) are accepted states. Only states at short steps are searched. Returns the
    index of the last earlier state whose velocities are known to sqrt(rtol), and the dependent constraints, or None.
    If the run has `stopped`, a state counts only if the motion moved away from it: a run may end where constraints are
    dependent.
    """
    count = len(times) - 1 - FIRST_STEPS
    if count < 2 or not rtol:
        return None
    # The last step is ignored too: its length is only what remains of the run.
    sizes = np.abs(times[FIRST_STEPS + 1 : -1] - times[FIRST_STEPS:-2])
    if count < MANY_STEPS and sizes.min() * count > SHORT_STEP * abs(times[-1] - times[FIRST_STEPS]):
        return None
    few = np.argsort(sizes, kind="stable")[:MOST_SHORT_STEPS]
    short = few[sizes[few] <= max(SHORT_STEP * float(sizes.mean()), float(sizes.min()))]
    rows = FIRST_STEPS + np.unique(np.append(short, short + 1))
    near, bound = _Nearness(model, parameters, times, states), DEPENDENCE_FACTOR * math.sqrt(rtol)
    for row in rows[near.at(times[rows], states[rows]) <= SURELY_FAR * bound].tolist():
        behind = slice(row, None, -(-(len(times) - row) // STATES_BEHIND))
        if stopped and near.at(times[behind], states[behind]).max() <= AWAY:
            return None
        dependent = near.dependent(float(times[row]), states[row])
        if dependent is not None and dependent.motion is None and dependent.regularity <= bound:
            # A violation rtol of the constraints changes the velocities by at most sqrt(rtol) at the earlier state.
            while row > 0 and near.at(times[[row]], states[[row]])[0] < rtol**0.25:
                row -= 1
            return row, dependent
    return None


class _Nearness:
    """Computes the least singular value of the constraint gradient G at states, relative to a value of the motion.

    The reference is the largest value among the start, the middle and the end, since a motion may begin or end near
    dependent constraints. The rows of G are scaled by their largest lengths at these three states.
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
        """Return G (k, m, n) at times (k,) and states (k, 2n)."""
        with np.errstate(all="ignore"):
            return np.moveaxis(self._residuals.gradients(times, states.T, self._parameters)[self._rows], 2, 0)

    def at(self, times: FloatArray, states: FloatArray) -> FloatArray:
        """Return the relative least singular values (k,) at times (k,), states (k, 2n); infinity if G is not finite."""
        matrices = self._gradients(times, states) / self._lengths
        finite = np.isfinite(matrices).all(axis=(1, 2))
        values = np.full(len(times), np.inf)
        # If constraints are dependent everywhere, the reference is zero and cannot scale the values.
        if self._unit:
            values[finite] = np.linalg.svd(matrices[finite], compute_uv=False)[:, -1] / self._unit
        return values

    def dependent(self, t: float, y: FloatArray) -> Singular | None:
        """Return the most dependent combination of constraints at a state (2n,); None if G is not finite."""
        unit = np.eye(self._longest.shape[1])
        gradient = self._residuals.gradient(t, y, self._parameters)[self._rows]
        return least_regular(unit, gradient, scales(unit, self._longest))
