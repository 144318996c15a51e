"""Memory of a Taylor step: layout of its work array, state of a run, tolerances and lowest order of steps.

A machine that computes on blocks of numbers pads each vector to whole blocks. On other machines a block is one number.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import WIDEST_VECTOR, whole_blocks
from lagrange.procedure.form import FLAG, READ, REAL, WHOLE, Array, Callee
from lagrange.procedure.front.decorators import inline
from lagrange.procedure.front.vocabulary import In, each, form_of, magnitude, record
from lagrange.program.series import SeriesProgram

STEP_MARGIN = 0.1
"""Truncation error at which Taylor steps aim, as a fraction of the tolerance. Errors add up along a run."""

TIGHT_RTOL, LEAST_MARGIN = 1e-15, 0.01
"""Below the tolerance `TIGHT_RTOL` steps aim at the fraction `LEAST_MARGIN` of it. The truncation error has the same
sign at every step. The error of one step must be far below rounding, for the energy error to grow like the square root
of time. Over 100,000 Kepler orbits (e = 0.6) it stays below 500 units of rounding; with a tenth of the tolerance it
reaches 2,900.
"""

QUATERNION_MARGIN = 0.125
"""Further factor on the tolerances of a system with rotations. Errors of steps change the lengths of quaternions. With
this factor the lengths stay within 1e-13 of 1 over 1e5 steps at the default tolerance.
"""


@inline
def step_margin(rtol: float, rotations: bool) -> float:
    """Return the truncation error at which Taylor steps aim, as a fraction of the relative tolerance `rtol`.

    `rotations` is true if the coordinates of the system contain quaternions.
    """
    margin = STEP_MARGIN if rtol >= TIGHT_RTOL else LEAST_MARGIN
    return margin * QUATERNION_MARGIN if rotations else margin


SMALLEST_RTOL = 2.0**-53
"""Smallest relative tolerance: the precision of doubles."""

LOWEST_ORDER = 4
"""Lowest order of a Taylor series for steps."""

RADIUS_FRACTION = -1.0
"""log2 of the largest step as a fraction of the estimated radius of convergence. The bound holds even if the last rows
are tiny: far from a wall exp(200 (x - 1)) the rows are below all tolerances, and only their growth shows the wall.
There is no such bound for systems with constraints and without such functions. At a crossing of two motions, a
violation e of the constraints, from rounding, is a term like e / t in the time t to the crossing. The rows then grow
with the radius t from below rounding. Steps of half of that radius would never pass the crossing.
"""

ROW_DISTANCE = 4
"""Distance in orders between the rows from which the radius of convergence is estimated. In a series in the fourth
power of time the rows in between are zero.
"""

PROBES, STEP_GROWTH = 32, 2.0
"""Test of long steps of series that terminate. `STEP_GROWTH`: ratio of a step to the previous step above which the
defect is tested along the whole step. `PROBES`: number of parts into which the points of this test divide the step. The
test is needed because a series that terminates does not bound its step.
"""

EVENT_SLACK = 64.0
"""Truncation error of an event function's series, in units of the state's tolerance. It is above 1, because the
function may contain products.
"""

MOST_SURFACES = 3
"""Largest number of switching surfaces that the compiled loop crosses without its caller. The loop stores the prepared
numbers for each combination of the surfaces' signs, so memory doubles with each surface.
"""


JET = Callee((REAL, REAL, READ, READ, READ, Array(), WHOLE), (FLAG,))
"""Type of the function that computes a series. Arguments: the time; the scale of time; the state followed by its
compensation; two arrays of numbers that the machine has prepared; the rows; the order. It returns True for a singular
matrix.
"""


@record
class TaylorState:
    """The state of a run by Taylor series, in addition to the fields of `Run` and `Counts`.

    low         Rounding error of the time (compensated summation).
    scale       The unit of time of the series, signed.
    next_limit  Bound of the next step, in time; or infinity.
    limit       Bound of all further steps, set by rejected steps.
    rescalings  Number of changes of the time unit in which the series of this step was computed again.
    failures    Number of consecutive steps that the defect test rejected.
    inspect     1 if the event functions must be inspected on the next step, even if their bounds exclude zeros.
    """

    low: float
    scale: float
    next_limit: float
    limit: float
    rescalings: int
    failures: int
    inspect: int


@record
class Held:
    """Record of the start of the last step, to which a rejected step returns. Its state is in the work array.

    unproven  1 until the last step has passed the defect test.
    t         Time at the start of the step.
    low       Rounding error of the time.
    scale     The unit of time of the series.
    h         Length of the step.
    """

    unproven: int
    t: float
    low: float
    scale: float
    h: float


@record
class OutputCounts:
    """Counts of the output times whose states are written.

    Output times are sorted along the run, and end with NaN.

    done   Number of output times whose states are written, on proven steps.
    ahead  The same number including the last step, which is not proven yet.
    """

    done: int
    ahead: int


TAYLOR, HELD, OUTPUTS = form_of(TaylorState), form_of(Held), form_of(OutputCounts)
"""Record types of `TaylorState`, `Held` and `OutputCounts`, by which machine code lays them out in memory."""


@record
class Sizes:
    """The sizes of a `TaylorLayout` as a record, read by procedures that work for every layout."""

    dimension: int
    padded: int
    width: int
    watched: int
    watched_at: int
    scratch: int
    chains: int
    """1 if states are summed in four independent partial sums, 0 if row by row."""


SIZES = form_of(Sizes)


class Offsets:
    """Offsets of the parts of the work array, computed from the sizes of a layout."""

    padded: Any
    width: Any
    scratch: Any

    @property
    def lost(self) -> Any:
        """Offset of the rounding errors of the state, which compensated summation adds in the next step."""
        return self.padded

    @property
    def held(self) -> Any:
        """Offset of the saved start of the last step: the state and its rounding errors."""
        return self.padded * 2

    @property
    def slope(self) -> Any:
        """Offset of the derivative of the series at the end of the step."""
        return self.padded * 4

    @property
    def rows(self) -> Any:
        """Offset of the rows of the series, one row of coefficients per order."""
        return self.padded * 5

    @inline
    def ahead(self, order: int) -> Any:
        """Return the offset of a second state and its rows, where series are evaluated at points along a step."""
        return (order + 1) * self.width + (self.rows + self.scratch)


@dataclass(frozen=True)
class TaylorLayout(Offsets):
    """Memory layout of a Taylor step: offsets of its parts in the work array, and options of its code.

    `dimension` is 2n. Rows of coefficients, one for each order, are `width` doubles apart. A row begins with q
    and v; its coefficients of the event functions begin at `watched_at`. Vectors are computed on `block`
    entries at once. `scratch` doubles follow the rows. With `chains` a series is summed in four partial sums,
    with `by_rows` row by row, for compilers that vectorize only innermost loops. With `projected` the state is
    moved onto the constraints after each step. With `crossing` the radius of convergence does not bound the
    step. With `observes` all watched functions are events without resets: the loop returns when one of them
    ends the run.
    """

    dimension: int
    width: int
    watched: int
    watched_at: int
    block: int
    scratch: int = 0
    chains: bool = False
    projected: bool = False
    crossing: bool = False
    by_rows: bool = False
    observes: bool = False

    @classmethod
    def of(cls, program: SeriesProgram, width: int = 0, *, block: int = 1, **parts: Any) -> TaylorLayout:
        """Return the memory layout of the series of a program. Rows have the length `width`.

        By default (0) a row has space for the state and the watched functions. Vectors are computed on `block`
        entries at once. `parts` are other fields, such as `scratch`.
        """
        dimension, watched = program.states, len(program.watched)
        end = whole_blocks(dimension, block)
        ways = {"projected": program.projection is not None, "crossing": program.may_cross}
        return cls(dimension, width or end + watched, watched, end, block, **ways, **parts)

    @cached_property
    def padded(self) -> int:
        """Length of the state, rounded up to whole blocks."""
        return whole_blocks(self.dimension, self.block)

    @property
    def loop(self) -> dict[str, Any]:
        """Keyword options of an `each` loop over vectors, such as the number of entries at a time."""
        return {"width": self.block, "spill": True, "unrolled": self.chains, "disjoint": True}

    @property
    def moving(self) -> int:
        """Index of the first entry of the first block of the state that contains velocities."""
        return self.dimension // 2 // self.block * self.block

    def coefficients(self, work: NDArray[np.float64], order: int) -> NDArray[np.float64]:
        """Return the Taylor coefficients (order + 1, 2n + watched) from an array that begins with their rows.

        The watched functions are the last columns.
        """
        rows = work[: (order + 1) * self.width].reshape(order + 1, self.width)
        watched = slice(self.watched_at, self.watched_at + self.watched)
        return np.concatenate([rows[:, : self.dimension], rows[:, watched]], axis=1)

    def size(self, order: int) -> int:
        """Return the length of the work array for a series of an `order`: two states and their rows."""
        return 2 * int(self.ahead(order)) + 8

    @cached_property
    def sizes(self) -> Any:
        """The sizes of this layout as a `Sizes` record, for procedures that work for every layout."""
        return SIZES.structure(**{name: int(getattr(self, name)) for name in SIZES.places})


@dataclass(frozen=True)
class RecordedLayout(Offsets):
    """The layout of a Taylor step whose sizes are read at run time from a `Sizes` record."""

    dimension: int
    padded: int
    width: int
    watched: int
    watched_at: int
    scratch: int
    chains: int


@inline
def layout_of(sizes: Sizes) -> Any:
    """Return the memory layout of a Taylor step that has the sizes in a record. Each size is read once."""
    vectors = sizes.dimension, sizes.padded, sizes.width
    return RecordedLayout(*vectors, sizes.watched, sizes.watched_at, sizes.scratch, sizes.chains)


def work_type() -> Array:
    """Return the type of an array that is accessed in whole vectors, also beyond its end, such as the work array."""
    return Array(room=WIDEST_VECTOR)


def rows_type(layout: TaylorLayout) -> Array:
    """Return the type of a parameter that is an array of states, one after the other."""
    return Array(room=layout.block)


def weights_type(layout: TaylorLayout) -> Array:
    """Return the type of the weights parameter: 1 / tolerance of each entry of the state."""
    return Array(size=layout.padded, room=layout.block)


def floors_type(layout: TaylorLayout) -> Array:
    """Return the type of the floors parameter: the least tolerance of each entry of the state."""
    return Array(size=layout.dimension, room=layout.block)


@inline
def row(work: Any, k: int, layout: Any) -> Any:
    """Return the row of the work array that has the Taylor coefficients of order k."""
    return work[k * layout.width + layout.rows :]


@inline
def less(order: int, count: int) -> int:
    """Return order - count, but at least 1. `count` is known at compile time, and the order is at least 4."""
    return max(order - count, 1) if count > 1 else order - count


@inline
def minus_one_over(k: int) -> float:
    """Return -1 / k for an order k."""
    return -1.0 / float(k)


@inline
def ratio(coefficients: In, weights: In, layout: TaylorLayout) -> float:
    """Return the largest |coefficient| * weight in a row of Taylor coefficients; NaN if one is not finite."""
    largest = 0.0
    for i in each(layout.padded, **layout.loop):
        largest = magnitude(largest, coefficients[i] * weights[i])
    return largest
