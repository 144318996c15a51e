"""Constants of events: noise, limits of root isolation, simultaneous and accumulating events, restart after a reset."""

from __future__ import annotations

EPSILON = 2.0**-52

POLYNOMIAL_NOISE = 8 * EPSILON
"""Least noise of a polynomial on a step, relative to sum |c[k] h**k|. It was measured after 30 halvings around simple,
double and close roots of random polynomials up to degree 40 (64). Bernstein coefficients then have errors of at most
3.6 (4.6) EPSILON, those within 64 EPSILON of zero 0.9 (1.2).
"""

DEEPEST_HALVING = 50
"""Largest number of halvings of a step. A narrower interval counts as a single point."""

MOST_COEFFICIENTS = 65
"""Largest number of coefficients of an event function on a step."""

MOST_ROOTS = MOST_COEFFICIENTS + 1
"""Largest number of roots on a step: those of the polynomial, and one if its sign contradicts the previous step."""

MODEST = 40
"""Largest exponent for which powers of a step between 1e-6 and 1e6 are computed without scaling."""

SMALLEST = 2.0**-1022
"""Smallest normal double."""

LEAST_POWER = -(2**20)
"""An exponent below that of any coefficient, as the start of a maximum."""

CONVERGED = EPSILON / 1024
"""Newton's method ends if its next step is below this fraction of the root."""

NARROWEST = 2.0**-DEEPEST_HALVING
"""Width of the smallest part of a step, which is not halved again."""

SURELY = 1.001
"""Safety factor in comparisons of two sums: covers the rounding errors of both."""

UNFIT, TOO_MANY = -1, -2
"""Codes in place of the number of roots: coefficients that are not finite; more roots than the arrays can hold."""

NOISE = 4 * 2.0**-52
"""Rounding error of the state, at a step and at the previous one, as a factor of an expression's sensitivity."""

DENSE_ROUND_OFF = 64 * EPSILON
"""Rounding error of a dense output, relative to the variation of the function on a step. The weights of DOP853 leave
5e-14 if the state changes by 1 (a pendulum, h = 1).
"""

CERTAINTY = 1.001
"""Safety factor of the test that a function keeps its sign: its mean must exceed the sum of all other terms by this
factor.
"""

TAIL = 8.0
"""Estimate of the unresolved part of a function, as a multiple of its last coefficients."""

TINY = 64 * 2.0**-1074
"""Smallest size that differs from zero: 64 spacings of the smallest doubles."""

LARGEST_NOISE = 1e-8
"""If the noise exceeds this fraction of a function, the function counts as noise."""

STEP_HALVINGS = 500
"""Largest number of halvings of one step. Then the caller examines the function. It suffices for some tens of roots."""

TOGETHER = 4 * 2.0**-52
"""Zeros at a distance below this fraction of the time count as simultaneous."""

CROSSING = 2
"""Code in place of a direction: both directions count, but a touch of zero does not."""

CLEAR_FACTOR = 16.0
"""An event function within rounding of zero at its start is compared with this initial value until it is larger by this
factor. Otherwise a ball that is below the floor by rounding would meet the floor again while it rises.
"""

CLOSEST = 64 * 2.0**-52
"""If changes by one event or surface follow each other within this fraction of the time, they count as an accumulation.
"""

NOISE_HALVES = 8.0
"""Noise of one state, in half spacings of doubles."""

MOST_BETWEEN_REVIEWS = 256
"""Largest number of steps between two reviews if an event may end the motion. Steps after that event are discarded."""

FIRST_REVIEW = 4
"""Number of steps before the first review if an event resets the state. Steps after the reset are discarded."""

RESTART_FACTOR = 2.0
"""After a reset an adaptive method starts with a step of this many times the interval between the last two resets,
because successive intervals are similar.
"""

SHORTEST_RESTART = 256 * 2.0**-52
"""Lower bound of that first step, as a fraction of the time. If shorter steps are needed, the run reports that time
does not advance.
"""

ALONG = 2.0**-16
"""Fraction of a step over which the direction of the motion through zero is compared with that of its dense output."""

CLEARLY = 8.0
"""Least change of an event function in that test, as a multiple of its noise."""

JUMP = 1e-4
"""A watched function above this fraction of its largest term is not zero: at a change of its sign it has jumped."""
