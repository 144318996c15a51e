"""Constants of Newton's method: how many corrections, when it has converged, and when its matrix is rebuilt."""

ORDERS = (1, 3, 6, 12)
"""Numbers of past steps from which the unknowns of equal steps may be extrapolated. The number with the least error is
used: 12 for steps that are short compared with the motion, few for long steps and for unknowns at rounding level.
"""

HISTORY = ORDERS[-1]
"""Number of past steps whose unknowns are stored."""

MOST_CORRECTIONS = 50
"""Largest number of corrections of an equal step; then Newton's method has not converged."""

MOST_CORRECTIONS_ADAPTIVE = 10
"""Largest number of corrections of a step with error control, which can be shortened instead."""

ROUND_OFF_FRACTION = 2.0**-6
"""Largest error of an unknown after an equal step, as a fraction of its rounding error. The remainder has the same sign
at every step and adds up: with a fraction of 1, galerkin6 drifts 15 times as much. This fraction costs up to a quarter
more evaluations, and a second correction of very short steps. Two corrections in a row at rounding level end the
iteration.
"""

TOLERANCE_FRACTION = 0.02
"""Error of Newton's method in steps with error control, as a fraction of the tolerance."""

SLOW_RATE = 0.25
"""Rebuild the matrix when the contraction rate exceeds this."""

DIVERGENCE_RATE = 0.9
"""With error control, shorten the step when the contraction rate exceeds this."""

RATE_INCREASE, LARGEST_RATE = 1.2, 0.9
"""A step that converges at once does not measure the contraction rate. The stored rate is then multiplied by the first
number per step, up to the second number.
"""

LEAST_RATE = 1e-4
"""Lower bound of the stored contraction rate: one good correction does not predict the next one."""

FRESH_RATE = 1e-3
"""With error control, the next step begins with a new matrix when the contraction rate exceeds this.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.8.
"""

FEW_CORRECTIONS = 2
"""If an equal step needs more corrections than this, the next step begins with a new matrix."""

MATRIX_AGE = 3
"""A matrix may be rebuilt after this many corrections of one step, or after this many steps."""

LARGEST_MATRIX_AGE = 64
"""Rebuild the matrix of equal steps after this many steps, even if it converges.

Otherwise a matrix that has become singular would not be noticed.
"""

STAGNATION_NORM, STAGNATION_RATE = 2.0**10, 0.5
"""With a new matrix, corrections are round-off when their rate exceeds the second number and their norm is below the
first.

The norm is in units of the estimated round-off.
"""

DIVERGENCE_GROWTH = 2.0
"""Give up when large corrections grow by this factor with a new matrix.

The iteration might end at another root.
"""

NOISE_DECAY = 0.9
"""The observed round-off level decays by this factor per step."""

UNIT_ROUND_OFF, LEAST_ROUND_OFF = 2.0**-52, 1e-100
"""The unit of rounding, in which corrections of equal steps are measured. The second number is added to the estimated
rounding error of an unknown. So an unknown that is zero, such as a coordinate at rest, has a finite weight.
"""

LARGEST_CORRECTION = 1e150
"""A weighted correction above this counts as not finite."""

LARGE_CORRECTION = 0.25
"""If the law is not finite after a correction of more than this fraction of the unknowns, the step has diverged. After
a smaller correction the motion itself has left the domain of the law.
"""

LARGEST_DISTANCE = 8.0
"""Largest sum of the corrections of an equal step, as a multiple of the first size estimate. The estimate is the size
of the terms of the residuals, multiplied by the inverse. Newton's first correction is at most that large, and
corrections that converge decrease. A larger sum leads to another root, or to none.
"""
