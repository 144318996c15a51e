"""Constants of event location: noise thresholds, limits of root isolation, simultaneous events, steps after a reset."""

from __future__ import annotations

EPSILON = 2.0**-52

POLYNOMIAL_NOISE = 8 * EPSILON
"""Least noise of a polynomial on a step, relative to sum |c[k] h**k|. The value was measured after 30 halvings around
simple, double and close roots of random polynomials up to degree 64. Bernstein coefficients then have errors of at most
4.6 EPSILON. Coefficients within 64 EPSILON of zero have errors of at most 1.2 EPSILON.
"""

DEEPEST_HALVING = 50
"""Largest number of halvings of a step in the search for roots. An interval of this depth counts as a single point."""

MOST_COEFFICIENTS = 65
"""Largest number of coefficients of an event function on a step."""

MOST_ROOTS = MOST_COEFFICIENTS + 1
"""Largest number of roots on a step: those of the polynomial, and one if its sign contradicts the previous step."""

MODEST = 40
"""Largest exponent k for which the power h**k of a step length h between 1e-6 and 1e6 is computed without scaling."""

SMALLEST = 2.0**-1022
"""Smallest normal double."""

LEAST_POWER = -(2**20)
"""Initial value of a search for the largest exponent of two. Every coefficient has a larger exponent."""

CONVERGED = EPSILON / 1024
"""Length of a step of Newton's method for a root below which the iteration ends, as a fraction of the root."""

NARROWEST = 2.0**-DEEPEST_HALVING
"""Width of the smallest part of a step, which is not halved again."""

SURELY = 1.001
"""Safety factor of the tests that one term of a sum exceeds the sum of all others. It covers the rounding errors."""

UNFIT, TOO_MANY = -1, -2
"""Codes in place of the number of roots: coefficients that are not finite; more roots than the arrays can hold."""

NOISE = 4 * 2.0**-52
"""Rounding error of an event function at an accepted state, as a multiple of its sensitivity to relative changes of the
state. It covers the rounding of this step and of the previous one.
"""

DENSE_ROUND_OFF = 64 * EPSILON
"""Rounding error of a dense output, relative to the variation of the function on a step. The weights of DOP853 leave
an error of 5e-14 if the state changes by 1 (a pendulum, h = 1).
"""

TAIL = 8.0
"""Estimate of the part of an event function that its polynomial on a step does not resolve, as a multiple of the last
coefficients of the polynomial.
"""

TINY = 64 * 2.0**-1074
"""Least error of a computed value, by underflow: 64 times the smallest positive double."""

LARGEST_NOISE = 1e-8
"""Largest size of the last coefficients, as a fraction of the function, that may count as noise."""

STEP_HALVINGS = 500
"""Largest number of halvings of one step in the search for roots of one event function. If more are needed, the roots
cannot be resolved, and the caller examines the step. Some tens of roots need fewer.
"""

TOGETHER = 4 * 2.0**-52
"""Distance of two zeros in time below which they count as simultaneous, as a fraction of the time."""

CROSSING = 2
"""Code in place of a direction: zeros count in both directions, but a touch of zero does not count."""

CLEAR_FACTOR = 16.0
"""Factor by which an event function must exceed its initial value before its zeros count again. It applies to functions
that are within rounding of zero at the start of a motion. Otherwise a ball that is below the floor by rounding would
meet the floor again while it rises.
"""

CLOSEST = 64 * 2.0**-52
"""Interval between two changes of the motion by one event or switching surface below which the changes accumulate, as a
fraction of the time. For example, the impacts of a ball accumulate before it comes to rest.
"""

NOISE_HALVES = 8.0
"""The constant `NOISE` as a multiple of 2**-53. This unit is the rounding error of a state in one step, as a fraction
of the state.
"""

MOST_BETWEEN_REVIEWS = 256
"""Largest number of steps between two searches for events if an event may end the run. The steps after such an event
are discarded.
"""

FIRST_REVIEW = 4
"""Number of steps before the first search for events if an event resets the state. The number is small, because the
steps after a reset are discarded.
"""

RESTART_FACTOR = 2.0
"""Largest first step after a reset of a method with error control, as a multiple of the interval between the last two
resets. Successive intervals are similar.
"""

SHORTEST_RESTART = 256 * 2.0**-52
"""Lower bound of the first step after a reset, as a fraction of the time. If shorter steps are needed, the run reports
that time does not advance.
"""

ALONG = 2.0**-16
"""Fraction of a step by which a state is moved along its slope, to test whether an event function passes zero there in
the direction that the dense output shows.
"""

CLEARLY = 8.0
"""Least change of an event function over twice the fraction `ALONG` of a step, as a multiple of its noise. A smaller
change leaves its direction open.
"""

JUMP = 1e-4
"""Largest value of an event function or switching surface at a zero, as a fraction of its largest term. If the sign
changes at a larger value, the function has jumped.
"""
