"""Constants of step control, the same on every machine; what a method may choose is in `Control`.

Source of `PI_SHARE`, `LEAST_PREVIOUS` and `DAMPING`: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential
Equations I, 2nd ed., 1993, II.4 and II.10, and its programs DOPRI5 and DOP853.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

STRETCH_TO_END = 1.01
"""Stretch a step to the end of the run when it reaches within one percent of it."""

SPACING, EARLIEST = 16 * 2.0**-52, 1e-290
"""The shortest step as a fraction of the time: a shorter one is lost in the round-off of the time.

The second number replaces a time that is closer to zero, where nothing is lost.
"""

LEAST_FLOOR = 1e-307
"""Floor of an entry without a known size: positive, and below every state."""

REJECTIONS_BEFORE_SURVEY = 3
"""A driver asks for the sizes of the entries after this many consecutive rejections.

It also asks after one rejection if a step moved an entry that was zero and has no floor. A Taylor driver, whose steps
are rejected rarely, asks at the second, fourth, eighth, ... rejection of a run.
"""

ROUNDED = 2.0**-46
"""An entry may be rounding if its tolerance is below this part of the largest entry of its kind: 128 units of it.

Kinds are the coordinates and the velocities. Whether it is rounding is then computed; see `rounding_noise`.
"""

SMALL_FLOOR = 2.0**-24
"""An entry may be rounding if its floor is below this part of the largest of its kind, in lanes and other packages."""

MOST_SURVEYS = 8
"""Largest number of surveys of the sizes in a run. If steps still shrink, the motion requires it."""

SHORTEST_LAST_STEP = 1e-6
"""A final step below this fraction of h is grid round-off; merge it with the previous step."""

FAR_FROM_ZERO = 1e-6
"""For a step below this fraction of the time, rounding the time changes its length by a relative 1e-10."""

AFTER_DIVERGED, AFTER_BROKEN = 0.5, 0.25
"""Factors of the step length after a failure: of Newton's method, and of a state or slope that is not finite.

A step that did not converge may do so at half its length; a step out of the domain has to shrink further.
"""

LARGEST_CORRECTION = 100.0
"""Largest displacement by which a projection onto constraints may end a step with error control, in tolerances.

What a step errs from the constraints is a part of its error, which is below one by its estimate. A larger displacement
is a change that the step has passed over.
"""

ROUNDED_START, SHORTENINGS = 2.0**-20, 8
"""A state may begin a step off the constraints, as behind an event, by this part of its size at most.

The displacement does not shrink with the step then: it is accepted when the step has been shortened so many times.
"""

LARGEST_RETRY = 0.95
"""Upper bound of the factor of the step length after a rejection by the error norm."""

LEAST_NORM, LEAST_PREVIOUS = 1e-10, 1e-4
"""Lower bounds of the error norm and of the previous error norm.

A step without an error does not predict the next one.
"""

PI_SHARE = 0.75
"""PI control: the exponent of the current norm is 1/k - `PI_SHARE` * memory.

Then the step still follows the norm where that changes slowly.
"""

DAMPING = 0.01
"""The weight of the second error vector's sum of squares in the norm of DOP853."""

FIRST_SHARE = 0.01
"""First step: bound of the relative change of the state in the Euler step of the trial length.

The first step also aims at this fraction of the tolerance.
"""

CANCELLATION = 2.0**-12
"""An acceleration may be round-off of cancelling terms if it is below this number times its sensitivity.

The sensitivity is the change of the acceleration when each entry of the state changes by about its own size.
"""

RELATIVE_PERTURBATION = 2.0**-26
"""Relative perturbation of the state for estimating sensitivities: the square root of the unit of round-off."""

SLOPE_NOISE = 2.0**-44
"""Relative round-off of a slope, as a fraction of its sensitivity, over the natural period.

Slopes are rounded to a few units of 2**-52 of their terms.
"""

CANCELLATION_DOMINANCE = 16.0
"""Accelerations that may be round-off must not determine the first step.

Sizes are asked for when their squared rate exceeds this multiple of the others'.
"""

LEAST_FIRST = 2.0**-44
"""The floor of an entry that is zero begins at this fraction, at least, of what the first step adds to it.

Newton's method has to converge below the floor.
"""

LEAST_SPACINGS = 64.0
"""The first step is at least this multiple of the shortest step.

It is an estimate, so it must not end the run as too small.
"""

FIRST_TRIAL, DEFAULT_FIRST = 2.0**-20, 1e-3
"""Fractions of the run.

The first is the trial length if no nonzero entry has a slope, as in a state at rest. The second is the first step if
neither the slopes nor their change determine one.
"""


@lru_cache(maxsize=64)
def perturbation_factors(size: int) -> NDArray[np.float64]:
    """Return different numbers from 1 to 2, one for each entry.

    With equal factors the difference of two equal entries would not change.
    """
    return np.asarray(1 + np.arange(size) * 0.6180339887498949 % 1)
