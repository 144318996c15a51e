"""The numbers of root isolation."""

from __future__ import annotations

EPSILON = 2.0**-52

ROUND_OFF = 8 * EPSILON
"""Times sum |c[k] h**k|: the least noise.

Measured 30 halvings deep around roots of random polynomials, simple, double and close, to degree 40 (64): Bernstein
coefficients are wrong by 3.6 (4.6) EPSILON at most, and those that are within 64 EPSILON of zero by 0.9 (1.2).
"""

DEEPEST = 50
"""Largest number of halvings of a step; a narrower interval is a single point."""

MOST_COEFFICIENTS = 65
"""Coefficients of an event function on a step, at most."""

MOST_ROOTS = MOST_COEFFICIENTS + 1
"""Roots of an event function on a step, at most: of the polynomial, and one where it does not meet the step before."""

MODEST = 40
"""Powers up to this one of a step between 1e-6 and 1e6 are computed as they are."""

SMALLEST = 2.0**-1022
"""The least normal number."""

LEAST_POWER = -(2**20)
"""An exponent below that of every coefficient."""

CONVERGED = EPSILON / 1024
"""Newton's method ends where the next step would be so small a part of the place that was found."""

NARROWEST = 2.0**-DEEPEST
"""The width of a part that is not halved."""

SURELY = 1.001
"""A sum outweighs another beyond the round-off of both where it does so by this factor."""

UNFIT, TOO_MANY = -1, -2
"""Codes in place of the number of roots: coefficients that are not finite, and more roots than the arrays can hold."""

NOISE = 4 * 2.0**-52
"""Rounding error of the state, here and at the end of the step before, as a factor of an expression's sensitivity."""

DENSE_ROUND_OFF = 64 * EPSILON
"""Round-off of a dense output relative to the variation of the function on a step.

The weights of DOP853 leave 5e-14 where the state moves by 1 (a pendulum, h = 1).
"""

CERTAINTY = 1.001
"""A function keeps its sign where its mean outweighs all else by so much."""

TAIL = 8.0
"""Estimate of the unresolved part of a function, as a multiple of its last coefficients."""

TINY = 64 * 2.0**-1074
"""Some spacings of the smallest doubles."""

LARGEST_NOISE = 1e-8
"""Noise above this fraction of a function is treated as the function itself."""

MOST_HALVINGS = 500
"""Halvings of one step until a function on it is left to others: some tens of roots."""

TOGETHER = 4 * 2.0**-52
"""Zeros closer than this part of the time happen at once."""

CLEAR_FACTOR = 16.0
"""An event function within rounding of zero at its start is compared with that value until it is this factor larger.

A ball that lies below the floor by rounding would otherwise meet the floor again while it rises."""

CLOSEST = 64 * 2.0**-52
"""An event or surface that is met again and again closer than this part of the time accumulates."""

NOISE_HALVES = 8.0
"""Noise of one state, in half spacings of doubles."""

LONGEST_LOOK = 256
"""Most steps between two reviews if an event may end the motion: steps after that event are wasted."""

FIRST_LOOK = 4
"""Steps before the first review if an event resets the state: steps after the reset are wasted."""

AHEAD = 2.0
"""After a reset an adaptive method starts with this part of the time since the last: such intervals are alike."""

CLOSE = 256 * 2.0**-52
"""But with no less than this part of the time: below, it is for the events to say that time stands still."""

ALONG = 2.0**-16
"""The part of a step over which it is seen that the motion passes zero as its path does."""

CLEARLY = 8.0
"""An event function must move by more than this multiple of its noise there."""

JUMP = 1e-4
"""A watched function above this fraction of its largest term is not zero."""
