"""Constants of step control, the same on every machine; what a method may choose is in `Control`.

Source of `PI_SHARE`, `LEAST_PREVIOUS` and `DAMPING`: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential
Equations I, 2nd ed., 1993, II.4 and II.10, and its programs DOPRI5 and DOP853.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

STRETCH_TO_END = 1.01
"""A step that reaches the end of the run within one percent is stretched to the end."""

SPACING, EARLIEST = 16 * 2.0**-52, 1e-290
"""The shortest step as a fraction of the time: a shorter one is lost in the rounding of the time. The second number
replaces a time that is closer to zero, where nothing is lost.
"""

LEAST_FLOOR = 1e-307
"""Floor of an entry without a known size: positive, and smaller than any state."""

REJECTIONS_BEFORE_SURVEY = 3
"""Number of consecutive rejections after which a driver asks for the sizes of the entries. It also asks after one
rejection if a step moved an entry that was zero and has no floor. A Taylor driver, whose steps are rejected rarely,
asks at the second, fourth, eighth, ... rejection of a run.
"""

ROUNDED = 2.0**-46
"""An entry may be rounding if its tolerance is below this fraction of the largest entry of its kind: 128 units of
rounding. Kinds are coordinates and velocities. `rounding_noise` then computes whether it is rounding.
"""

SMALL_FLOOR = 2.0**-24
"""In lanes and other packages, an entry may be rounding if its floor is below this fraction of the largest of its kind.
"""

MOST_SURVEYS = 8
"""Largest number of estimates of the sizes in a run. If steps still decrease after them, the motion requires it."""

SHORTEST_LAST_STEP = 1e-6
"""A last step below this fraction of h results from rounding of the grid. It is merged with the previous step."""

FAR_FROM_ZERO = 1e-6
"""If a step is below this fraction of the time, rounding the time changes the step by a relative 1e-10."""

AFTER_DIVERGED, AFTER_BROKEN = 0.5, 0.25
"""Factors of the step length after a failure. The first is for Newton's method, which may converge at half the length.
The second is for a state or slope that is not finite: the step must become shorter to stay in the domain.
"""

LARGEST_CORRECTION = 100.0
"""Largest displacement, in tolerances, by which a projection onto constraints may end a step with error control. The
step's distance from the constraints is part of its error, which is below one tolerance by estimate. A larger
displacement is a change of the motion within the step that was not noticed.
"""

ROUNDED_START, SHORTENINGS = 2.0**-20, 8
"""Largest distance of a state from the constraints, relative to its size, at the start of a step, such as after an
event. This displacement does not decrease with the step. It is accepted after the second number of shortenings of the
step.
"""

LARGEST_RETRY = 0.95
"""Upper bound of the factor of the step length after a rejection by the error norm."""

LEAST_NORM, LEAST_PREVIOUS = 1e-10, 1e-4
"""Lower bounds of the error norm, and of the previous error norm. A step without an error does not predict the next
error.
"""

PI_SHARE = 0.75
"""PI control: the exponent of the current norm is 1/k - `PI_SHARE` * memory. So the step still follows the norm where
the norm changes slowly.
"""

DAMPING = 0.01
"""Weight of the second error vector's sum of squares in the norm of DOP853."""

FIRST_SHARE = 0.01
"""First step: bound of the relative change of the state in the Euler step of the trial length. The error of the first
step is aimed at the same fraction of the tolerance.
"""

CANCELLATION = 2.0**-12
"""An acceleration may be rounding of cancelling terms if it is below this fraction of its sensitivity. The sensitivity
is the change of the acceleration when each entry of the state changes by about its size.
"""

RELATIVE_PERTURBATION = 2.0**-26
"""Relative perturbation of the state for estimating sensitivities: the square root of the unit of round-off."""

SLOPE_NOISE = 2.0**-44
"""Relative rounding of a slope, as a fraction of its sensitivity, over the natural period. Slopes are rounded to a few
units of 2**-52 of their terms.
"""

CANCELLATION_DOMINANCE = 16.0
"""Accelerations that may be rounding must not determine the first step. If their squared rate exceeds this multiple of
that of the others, the sizes of the entries are estimated.
"""

LEAST_FIRST = 2.0**-44
"""Least floor of an entry that is zero, as a fraction of its change in the first step. Newton's method has to converge
below the floor.
"""

LEAST_SPACINGS = 64.0
"""The first step is at least this multiple of the shortest step. It is only an estimate, and must not end the run as
too small.
"""

FIRST_TRIAL, DEFAULT_FIRST = 2.0**-20, 1e-3
"""Fractions of the run. The first is the trial length if no nonzero entry has a slope, as in a state at rest. The
second is the first step if neither slopes nor their changes determine one.
"""


@lru_cache(maxsize=64)
def perturbation_factors(size: int) -> NDArray[np.float64]:
    """Return different numbers (size,) from 1 to 2, one for each entry.

    With equal factors the difference of two equal entries would not change.
    """
    return np.asarray(1 + np.arange(size) * 0.6180339887498949 % 1)
