"""Constants of the search for events: noise, limits of root isolation, and when events count as simultaneous."""

from __future__ import annotations

EPSILON = 2.0**-52

POLYNOMIAL_NOISE = 8 * EPSILON
"""Least noise of a polynomial on a step, relative to sum |c[k] h**k|. Measured 30 halvings deep around roots of random
polynomials, simple, double and close, to degree 40 (64): Bernstein coefficients are wrong by 3.6 (4.6) EPSILON at most,
and those that are within 64 EPSILON of zero by 0.9 (1.2)."""

DEEPEST_HALVING = 50
"""Largest number of halvings of a step; a narrower interval is a single point."""

MOST_COEFFICIENTS = 65
"""Largest number of coefficients of an event function on a step."""

MOST_ROOTS = MOST_COEFFICIENTS + 1
"""Largest number of roots on a step: those of the polynomial, and one if it does not meet the step before."""

MODEST = 40
"""Largest exponent for which powers of a step between 1e-6 and 1e6 are computed without scaling."""

SMALLEST = 2.0**-1022
"""Smallest normal double."""

LEAST_POWER = -(2**20)
"""An exponent smaller than that of any coefficient: the start of a maximum."""

CONVERGED = EPSILON / 1024
"""Newton's method ends if its next step is below this fraction of the root."""

NARROWEST = 2.0**-DEEPEST_HALVING
"""Width of the smallest part of a step; it is not halved again."""

SURELY = 1.001
"""Safety factor in comparisons of two sums: covers the rounding errors of both."""

UNFIT, TOO_MANY = -1, -2
"""Codes in place of the number of roots: coefficients that are not finite, and more roots than the arrays can hold."""

NOISE = 4 * 2.0**-52
"""Rounding error of the state, here and at the end of the step before, as a factor of an expression's sensitivity."""

DENSE_ROUND_OFF = 64 * EPSILON
"""Round-off of a dense output relative to the variation of the function on a step.

The weights of DOP853 leave 5e-14 where the state moves by 1 (a pendulum, h = 1).
"""

CERTAINTY = 1.001
"""Safety factor of the test that a function keeps its sign: its mean must outweigh all other terms by this factor."""

TAIL = 8.0
"""Estimate of the unresolved part of a function, as a multiple of its last coefficients."""

TINY = 64 * 2.0**-1074
"""Smallest size that is distinguished from zero: some spacings of the smallest doubles."""

LARGEST_NOISE = 1e-8
"""Noise above this fraction of a function is treated as the function itself."""

STEP_HALVINGS = 500
"""Largest number of halvings of one step; then the function is left to the caller. It suffices for some tens of
roots."""

TOGETHER = 4 * 2.0**-52
"""Zeros at a distance below this fraction of the time count as simultaneous."""

CLEAR_FACTOR = 16.0
"""An event function within rounding of zero at its start is compared with that value until it is this factor larger.

A ball that lies below the floor by rounding would otherwise meet the floor again while it rises."""

CLOSEST = 64 * 2.0**-52
"""Changes by one event or surface at intervals below this fraction of the time count as an accumulation."""

NOISE_HALVES = 8.0
"""Noise of one state, in half spacings of doubles."""

LONGEST_LOOK = 256
"""Largest number of steps between two reviews if an event may end the motion: steps after that event are discarded."""

FIRST_LOOK = 4
"""Number of steps before the first review if an event resets the state: steps after the reset are discarded."""

RESTART_FACTOR = 2.0
"""After a reset an adaptive method starts with a step of this many times the interval since the last reset: such
intervals are alike."""

SHORTEST_RESTART = 256 * 2.0**-52
"""Lower bound of that first step as a fraction of the time. If even shorter steps are needed, the events report that
time stands still."""

ALONG = 2.0**-16
"""Fraction of a step over which it is tested that the motion passes zero in the same direction as its path."""

CLEARLY = 8.0
"""In that test an event function must change by more than this multiple of its noise."""

JUMP = 1e-4
"""Values of a watched function above this fraction of its largest term differ from zero: the function has jumped."""
