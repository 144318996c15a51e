"""Constants of Taylor steps: scale of time, step size, defect test, and events."""

from __future__ import annotations

STEP_MARGIN = 0.1
"""Fraction of the tolerance at which steps aim: errors add up along a run."""

TIGHT_RTOL, LEAST_MARGIN = 1e-15, 0.01
"""Below this tolerance steps aim at a hundredth of it. The truncation error has the same sign at every step. It must be
far below rounding, for the energy error to grow like the square root of time. Over 100,000 Kepler orbits (e = 0.6) it
stays below 500 units of rounding; with a tenth it reaches 2,900.
"""

SMALLEST_RTOL = 2.0**-53
"""Smallest relative tolerance: the precision of doubles."""

LARGEST_SCALE_RATIO = 10.0
"""The step and the scale of time differ by a factor of at most 2**10; otherwise the series is computed again. The scale
is a power of two near the last step. In this unit coefficients neither overflow nor underflow, whatever the units of
the statement.
"""

START_ROWS = 4
"""Number of rows after the first from which the size of an entry that is zero at the start of a run is estimated. The
fourth derivative includes one coupling between coordinates. Entries whose series begin later have no estimate.
"""

FIRST_SCALE_RATIO = 1.5
"""`LARGEST_SCALE_RATIO` for the first step of a run: a factor of 2**1.5."""

ROWS_USED = 6
GUARD = 0.25
"""Margin of the step beyond the guard, in binary digits. The step follows the last two rows; the `ROWS_USED - 2` rows
before them are the guard. From rest every other coefficient is zero, and the last nonzero one may be small by chance.
Row k of a series of radius r gives the estimate r tolerance**(1/k). The step may exceed this estimate by a quarter of a
binary digit, because the rows of an entire function decrease faster and faster.

Rows below half of the order are not used. If a velocity is zero, its tolerance is relative to its first coefficient,
and the estimate is the unit of time, which follows the step. At order 4 and a tolerance of 1e-12 no step would be long
enough. An order that is low for the tolerance would take steps like tolerance**(1/(p - 1)), from the row before the
last: 18 times as many as tolerance**(1/p) at order 4 and 1e-15. Then the radius of that row is used at the last order,
less GUARD.
"""

LOWEST_ORDER = 4
"""Lowest order of a series for steps."""

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

DEFECT, DEFECT_NOISE = 4.0, 2.0**-40
"""Bound of the defect: the derivative of the series at the end of a step minus the right-hand side there. The bound is
this many tolerances per order, divided by the step, plus a relative rounding of the largest derivative. The truncation
error at order p has a derivative of p tolerances over the step. The largest defect in ten scenes at five tolerances was
1.1 times that.
"""

RETRY_FRACTION, MOST_FAILURES = 0.25, 24
"""A rejected step is repeated at a quarter of its length, up to this many times. Then the step is at rounding level."""

PROBES, STEP_GROWTH = 32, 2.0
"""A series that terminates does not bound the next step. If a step exceeds the second number times the previous step,
its defect is tested at the first number of points along it.
"""

ZERO, ZERO_BOUND = -900.0, -800.0
"""Powers of two, relative to the tolerance: the stand-in for zero in a logarithm, and the bound below which a
coefficient is zero. In a suitable scale the last coefficients are within 2**(LARGEST_SCALE_RATIO * order) of the
tolerance, 2**640 at order 64. So the bound excludes zeros only.
"""

OVERFLOWED = -45.0
"""A step below this power of two, in units of the scale, means that a coefficient has overflowed, or nearly so.
Infinity, as 2**1024 tolerances, gives a step of 2**-51 at order 20.
"""

LONGER_SCALE, SHORTER_SCALE = 20.0, -40.0
"""Powers of two by which the scale changes if the last coefficients are zero, and if one has overflowed. At orders up
to 32 they change the last coefficient by 2**640 and 2**-1280. That is less than the range between zero and overflow: no
change skips the suitable scales.
"""

LARGEST_STEP_EXPONENT = 900.0
"""log2 of the longest step, in units of the scale. A series that terminates may allow a step beyond the range of
doubles.
"""

SHORTEST_SCALE = 1e-280
"""The shortest scale of time: a step of 2**-45 of it is still a normal double."""

MOST_RESCALINGS = 120
"""Largest number of changes of the scale of time for one step. After them the coefficients count as infinite. From a
scale of 1, 24 changes by `SHORTER_SCALE` lead below `SHORTEST_SCALE`, to 1e-289, and 96 by `LONGER_SCALE` from there to
1e289.
"""

EVENT_NOISE = 4 * 2.0**-52 / 2.0**-26
"""Noise of an event function, as a multiple of its change under a perturbation of the state. It is the rounding of the
state, here and at the end of the last step, divided by the relative perturbation (half of the digits).
"""

EVENT_SLACK = 64.0
"""Truncation error of an event function's series, in units of the state's tolerance; it is larger because of products.
"""

BALANCE = 256.0
"""Bound for an event function on a step that the series does not limit: the largest ratio of its higher terms, which
grow with the square of time or faster, to its lower terms. It costs two digits of the roots; runs then take a few more
steps.
"""

DOUBT = 64 * 2.0**-52
"""A coefficient of an event function is zero if it is below this fraction of the sum of all coefficients."""

LEAST_PART = 2.0**-70
"""A step shorter than this fraction of the rest of the run makes no progress."""

MOST_SURFACES = 3
"""Largest number of surfaces whose sides the loop changes. The numbers for all combinations of sides are stored."""
