"""How Newton's method decides, in numbers."""

ORDERS = (1, 3, 6, 12)
"""From so many steps the unknowns of equal steps are extrapolated, from as many as have come nearest: the most where
steps are short against the motion, few where they are long, or where all but rounding is zero."""

HISTORY = ORDERS[-1]
"""So many steps are kept."""

MOST_CORRECTIONS = 50
"""Corrections of one step before it counts as not converging."""

MOST_CORRECTIONS_ADAPTIVE = 10
"""The same where the step can be shortened instead."""

ROUND_OFF_FRACTION = 2.0**-6
"""Equal steps may leave this part of round-off in an unknown: what is left has the same sign at every step, and adds
up. Where two corrections in a row are round-off there is nothing left to correct. With all of it galerkin6 drifts 15
times as much; this part costs up to a quarter more evaluations, and a second correction of very short steps."""

TOLERANCE_FRACTION = 0.02
"""Steps that follow the error leave this part of the tolerance to Newton's method."""

SLOW_RATE = 0.25
"""Corrections that shrink by less than this want a new matrix."""

DIVERGENCE_RATE = 0.9
"""Where steps follow the error, corrections that shrink by less than this want a shorter step."""

RATE_INCREASE, LARGEST_RATE = 1.2, 0.9
"""The rate at which corrections shrink is taken to rise by the first factor at each step that does not measure it, up
to the second number."""

LEAST_RATE = 1e-4
"""A rate below this counts as this at the next step: one good correction promises no more."""

FRESH_RATE = 1e-3
"""Where steps follow the error, corrections that shrink by less than this have the next step begin with a new matrix.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.8."""

FEW_CORRECTIONS = 2
"""A step of more than this many corrections has the next one begin with a new matrix."""

MATRIX_AGE = 3
"""A matrix is old enough to be made anew after so many corrections of one step, or after so many steps."""

LARGEST_MATRIX_AGE = 64
"""After so many equal steps a matrix is made anew, whatever its use, so that one that has become singular is seen."""

STAGNATION_NORM, STAGNATION_RATE = 2.0**10, 0.5
"""Corrections that shrink by less than the second number with a new matrix are round-off below the first one times the
round-off that was estimated."""

DIVERGENCE_GROWTH = 2.0
"""Large corrections that grow so much with a new matrix wander, and might end at a root that is not the motion."""

NOISE_DECAY = 0.9
"""What round-off was observed is forgotten by this factor per step."""

UNIT_ROUND_OFF, LEAST_ROUND_OFF = 2.0**-52, 1e-100
"""One unit of round-off, which corrections of equal steps are measured in. The second number is added to what it makes
of an unknown: where that is zero, as of a coordinate at rest, any correction has a finite weight."""

LARGEST_CORRECTION = 1e150
"""A weighted correction beyond this is no number to go on with."""

LARGE_CORRECTION = 0.25
"""A law that is no number after a correction of more than this part of the unknowns says nothing about the motion."""

LARGEST_DISTANCE = 8.0
"""Corrections of a step with equal steps may add up to so many times the size of what the residuals are made of, taken
to the unknowns. Newton's first correction from the guess is at most that size, and those of a step that converges
shrink: what goes farther ends at another root, or at none."""
