"""Detect runs that pass a configuration with dependent constraints, or approach one without reaching it.

Two motions may cross at such a configuration. For example, a parallelogram linkage continues as a parallelogram, or
with crossed rods. A long step over the crossing follows the smooth motion, but short steps towards the crossing may
not. The constraints are violated by some e, from rounding and the tolerance. Near the crossing the two motions are
only sqrt(e) apart, so e decides which of them the run follows. Where s is the least singular value of the constraints
relative to the start, the violation e changes velocities by the fraction e / s**2.
"""

from __future__ import annotations

import math

import numpy as np

from lagrange.equations.singular import Singular, least_regular, matrices_at, scales
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.trajectory.constraints.residuals import residuals_of

SHORT_STEP = 0.1
"""Steps shorter than this fraction of the mean step are inspected. Towards a crossing steps shrink to 1e-2 to 1e-4 of
the mean.
"""

FIRST_STEPS = 3
"""Number of steps at the start that are ignored, because they are short while the step size is determined."""

SURELY_FAR = 1e2
"""Margin for unit scaling: units change the least singular value of rows by less than this factor, once the rows are
normalised."""

ON_THE_WAY = 0.1
"""Largest singular value at the shortest step, relative to the motion, for which its neighbours are searched. They may
be a hundred times as close to the crossing.
"""

ROWS_AT_ONCE = 32
"""Number of rows of a series of steps that are evaluated at once. The search is then repeated around the best row."""

ONE_BY_ONE = 4
"""Largest number of gradients for which separate evaluation is faster than joint evaluation."""

MANY_STEPS = 10_000
"""In runs of at least this many steps the shortest step is always inspected, because the cost is relatively small."""

DEPENDENCE_FACTOR = 3.0
"""Constraints count as dependent if their least singular value, relative to the start, is below this times the square
root of rtol. Runs of four methods over crossings had 1e-6 to 5e-5 at rtol = 1e-9."""

MOST_PLACES = 16
"""Largest number of series of short steps that are inspected, from the shortest steps on. Each costs some 50 us."""

STEPS_PER_LOOK = 2**14
"""Number of steps after which states that are not stored are inspected, together with as many before them; more than
`MANY_STEPS`.
"""

State = tuple[float, FloatArray]
"""A time and a state (2n,)."""


class StatesPassed:
    """The last accepted states of a motion, at most 2 * `STEPS_PER_LOOK`, and the state before these."""

    def __init__(self, dimension: int) -> None:
        # There are spare rows, because drivers write whole blocks.
        rows = 2 * STEPS_PER_LOOK + 6
        self._times, self._states = np.empty(rows), np.empty((rows, dimension))
        self._count = 1
        self._all = self._times[1:], self._states[1:]

    def begin(self, start: State) -> None:
        """Discard all states, and begin a motion at the time and state `start`."""
        self._times[0], self._states[0] = start
        self._count = 1

    def room(self) -> tuple[FloatArray, FloatArray]:
        """Drop the oldest states; return the arrays for the times and states of the next `STEPS_PER_LOOK` steps."""
        if self._count == 1:
            return self._all
        dropped = self._count - STEPS_PER_LOOK - 1
        if dropped > 0:
            for array in (self._times, self._states):
                array[: STEPS_PER_LOOK + 1] = array[dropped : self._count].copy()
            self._count -= dropped
        return self._times[self._count :], self._states[self._count :]

    def lead_over(self, written: int, model: Model, start: State, parameters: FloatArray, rtol: float) -> bool:
        """Count `written` new states; return True if rounding decided the motion on the stored states.

        This is so if the motion passed dependent constraints by short steps, as tested by `dependent_passage`.
        `start` is the start of the motion.
        """
        self._count += written
        if self._count <= FIRST_STEPS + 2:
            return False
        times, states = self._times[: self._count], self._states[: self._count]
        return dependent_passage(model, times, states, parameters, rtol, start) is not None


def dependent_passage(
    model: Model,
    times: FloatArray,
    states: FloatArray,
    parameters: FloatArray,
    rtol: float,
    start: State | None = None,
    *,
    stopped: bool = False,
) -> tuple[int, Singular] | None:
    """Find the first state at which constraints are dependent, so that rounding decides the motion after it.

    `times` (S+1,) and `states` (S+1, 2n) are accepted states. Only series of short steps are searched. Returns the
    index of the last earlier state whose velocities are known to sqrt(rtol), and the dependent constraints, or None.
    `start` is the start of the motion if it is not the first state. If the run has `stopped`, a state counts only if
    the motion moved away from it: a run may end where constraints are dependent.
    """
    count = len(times) - 1 - FIRST_STEPS
    if count < 2 or not rtol:
        return None
    # The last step is ignored too: its length is only what remains of the run.
    sizes = np.abs(times[FIRST_STEPS + 1 : -1] - times[FIRST_STEPS:-2])
    if count < MANY_STEPS and sizes.min() * count > SHORT_STEP * abs(times[-1] - times[FIRST_STEPS]):
        return None
    near, bound = Nearness(model, parameters, times, states, start), DEPENDENCE_FACTOR * math.sqrt(rtol)
    for shortest, series in _short_steps(sizes):
        if near.at(times, states, [shortest])[0] > max(SURELY_FAR * bound, ON_THE_WAY):
            continue
        row = near.nearest(times, states, series)
        if near.at(times, states, [row])[0] > SURELY_FAR * bound:
            continue
        if stopped and near.at(times, states, _few(range(row, len(times)))).max() <= ON_THE_WAY:
            continue
        dependent = near.found(float(times[row]), states[row])
        if dependent is not None and dependent.motion is None and dependent.regularity <= bound:
            return near.last_known(times, states, row, rtol), dependent
    return None


def _short_steps(sizes: FloatArray) -> list[tuple[int, range]]:
    """Return, for each series of short steps, the index of the state before the shortest step, and the range of states.

    `sizes` are the lengths of all steps except the first `FIRST_STEPS` and the last.
    """
    short = np.flatnonzero(sizes <= SHORT_STEP * sizes.mean())
    if not len(short):
        short = np.array([np.argmin(sizes)])
    series = np.split(short, np.flatnonzero(np.diff(short) > 1) + 1)
    least = [(int(rows[np.argmin(sizes[rows])]), int(rows[0]), int(rows[-1])) for rows in series]
    chosen = sorted(sorted(least, key=lambda entry: float(sizes[entry[0]]))[:MOST_PLACES])
    return [(FIRST_STEPS + row, range(FIRST_STEPS + first, FIRST_STEPS + last + 2)) for row, first, last in chosen]


def _few(rows: range) -> list[int]:
    """Return at most `ROWS_AT_ONCE` of the indices `rows`, equally spaced."""
    return list(rows[:: -(-len(rows) // ROWS_AT_ONCE)])


class Nearness:
    """Computes the least singular value of the constraint gradient G at states, relative to a value of the motion.

    The reference is the largest value among the start, the middle and the end, since a motion may begin or end near
    dependent constraints. The rows of G are scaled by their largest lengths at these three states.
    """

    def __init__(
        self, model: Model, parameters: FloatArray, times: FloatArray, states: FloatArray, start: State | None = None
    ) -> None:
        self._residuals, self._parameters = residuals_of(model), parameters
        self._rows = [self._residuals.names.index(name) for name in model.equations.constraints.names]
        t, y = times[[0, len(times) // 2, -1]], states[[0, len(times) // 2, -1]]
        if start is not None:
            t[0], y[0] = start
        rows = self._gradients(t, y)
        sizes = np.sqrt((rows**2).sum(axis=2))
        sizes[~np.isfinite(sizes)] = 0.0
        self._longest = rows[sizes.argmax(axis=0), np.arange(len(self._rows))]
        lengths = sizes.max(axis=0)
        self._lengths, self._unit = np.where(lengths > 0, lengths, 1.0)[:, None], 1.0
        values = self.at(t, y, [0, 1, 2])
        self._unit = float(values[np.isfinite(values)].max(initial=0.0))

    def _gradients(self, times: FloatArray, states: FloatArray) -> FloatArray:
        """Return G (k, m, n) at times (k,) and states (k, 2n)."""
        if len(times) <= ONE_BY_ONE:
            pairs = zip(times.tolist(), states, strict=True)
            return np.array([self._residuals.gradient(t, y, self._parameters)[self._rows] for t, y in pairs])
        with np.errstate(all="ignore"):
            return np.moveaxis(self._residuals.gradients(times, states.T, self._parameters)[self._rows], 2, 0)

    def at(self, times: FloatArray, states: FloatArray, rows: list[int]) -> FloatArray:
        """Return the relative least singular values at the states with indices `rows`; infinity if G is not finite.

        `times` is (S+1,), `states` is (S+1, 2n).
        """
        matrices = self._gradients(times[rows], states[rows]) / self._lengths
        finite = np.isfinite(matrices).all(axis=(1, 2))
        values = np.full(len(rows), np.inf)
        # If constraints are dependent everywhere, the reference is zero and cannot scale the values.
        if self._unit:
            values[finite] = np.linalg.svd(matrices[finite], compute_uv=False)[:, -1] / self._unit
        return values

    def nearest(self, times: FloatArray, states: FloatArray, series: range) -> int:
        """Return the index of the state in the range `series` at which the relative singular value is least.

        The search assumes that the value decreases towards a crossing and increases after it.
        """
        while True:
            rows = _few(series)
            smallest = int(np.argmin(self.at(times, states, rows)))
            if len(rows) == len(series):
                return rows[smallest]
            series = range(
                rows[max(smallest - 1, 0)], (rows[smallest + 1] if smallest + 1 < len(rows) else series[-1]) + 1
            )

    def last_known(self, times: FloatArray, states: FloatArray, row: int, rtol: float) -> int:
        """Return the last index up to `row` of a state at which the velocities are known to sqrt(rtol).

        This is so if a violation rtol of the constraints changes the velocities by at most this fraction.
        """
        while row > 0 and self.at(times, states, [row])[0] < rtol**0.25:
            row -= 1
        return row

    def found(self, t: float, y: FloatArray) -> Singular | None:
        """Return the most dependent combination of constraints at a state (2n,); None if G is not finite."""
        unit = np.eye(self._longest.shape[1])
        gradient = self._residuals.gradient(t, y, self._parameters)[self._rows]
        return least_regular(unit, gradient, scales(unit, self._longest))


FIRST_TEST = 2**18
"""Number of steps before the first test of a run. Each further test is after twice as many steps. A test takes 0.1 ms.
"""

SLOWER, NEARER = 0.75, 0.75
"""Largest ratios of times, and of distances to the singular state, at successive tests. The number of steps doubles
from test to test. If both ratios are smaller, the run does not reach the state. With steps of equal time the first
ratio is 2.
"""

NEARLY_DEPENDENT = 1e-2
"""Constraints are nearly dependent if their least singular value is at most this fraction of its value at the start."""


def regularity(model: Model, parameters: FloatArray, start: State, end: State) -> tuple[float, Singular] | None:
    """Return how regular the equations are at `end`, relative to `start`, and what is nearly singular there.

    The measure is the least singular value of the gradient G of the constraints and of the mass matrix. Nearly
    singular are rows of G or a motion. Returns None if an entry is not finite.
    """
    before = matrices_at(model, model.equations, *start, parameters)
    scale = scales(*before)
    first = least_regular(*before, scale)
    singular = least_regular(*matrices_at(model, model.equations, *end, parameters), scale)
    if first is None or singular is None or not first.regularity:
        return None
    return singular.regularity / first.regularity, singular


class Approach:
    """Test, made after some steps, whether a run with constraints approaches a singular state without reaching it.

    An example is a mass on a rod whose length r shrinks to zero: the rod turns faster and faster. A step takes a time
    of order r**2, and a run needs about 1/r steps to reach the length r.
    """

    def __init__(self, model: Model, parameters: FloatArray, start: State) -> None:
        self.model, self.parameters, self.start = model, parameters, start
        self.next_test = FIRST_TEST
        self.times = [start[0]]
        self.nearness = [1.0]

    def ends(self, state: DriverState) -> tuple[float, Singular] | None:
        """Return a value and what is singular if the run approaches a singular state and should end here, else None.

        The value is the least singular value of the constraints' gradient or of the mass matrix, relative to the
        start of the run. Singular are dependent constraints, or a motion without inertia.
        """
        steps = int(state.integers[DriverState.STEPS])
        if steps < self.next_test:
            return None
        self.next_test = 2 * steps
        singular = regularity(self.model, self.parameters, self.start, (state.t, state.y))
        share = 1.0 if singular is None else singular[0]
        self.times.append(state.t)
        self.nearness.append(share)
        if len(self.times) < 4 or share > NEARLY_DEPENDENT:
            return None
        last, before = (abs(end - begin) for end, begin in zip(self.times[-1:-3:-1], self.times[-2:-4:-1], strict=True))
        slower = last <= SLOWER * before
        nearer = all(b <= NEARER * a for a, b in zip(self.nearness[-3:-1], self.nearness[-2:], strict=True))
        return singular if slower and nearer else None
