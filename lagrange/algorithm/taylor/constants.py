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

PROBES, STEP_GROWTH = 32, 2.0
"""A series that terminates does not bound the next step. If a step exceeds the second number times the previous step,
its defect is tested at the first number of points along it.
"""

EVENT_SLACK = 64.0
"""Truncation error of an event function's series, in units of the state's tolerance; it is larger because of products.
"""

MOST_SURFACES = 3
"""Largest number of surfaces whose sides the loop changes. The numbers for all combinations of sides are stored."""
