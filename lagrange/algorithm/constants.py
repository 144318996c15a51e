"""Constants on which all loops over steps agree, on every machine: outcomes, block sizes, and numbers of step control.

Safety factor and growth limits, which a method may choose, are in lagrange/program/step_size_control.py.
"""

from __future__ import annotations

import enum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


class Outcome(enum.IntEnum):
    """Reason for the end of a run, of a step, or of the solution of a step's equations.

    BROKEN: `DriverState.fault` has the error. UNPROJECTED: the new state is too far from the constraints for a
    projection onto them. UNSCALED: the caller must estimate the sizes of the state's entries, and can then
    continue. The absolute tolerances of some entries, of unknown size or at rounding level, are too low, so
    that steps become shorter.
    """

    DONE = 0
    PAUSED = 1
    NON_FINITE = 2
    SINGULAR = 3
    STEP_TOO_SMALL = 4
    WATCHED = 5
    DIVERGED = 6
    BROKEN = 7
    UNSCALED = 8
    UNPROJECTED = 9


WIDEST_VECTOR = 8
"""Number of doubles in the widest vector registers. Compiled code computes this number of values, steps or ensemble
members at once.
"""


def whole_blocks(count: int, block: int) -> int:
    """Return the least multiple of `block` that is at least `count`."""
    return -(-count // block) * block


STRETCH_TO_END = 1.01
"""Largest factor by which the last step of a run is stretched to reach the end of the run."""

SPACING, EARLIEST = 16 * 2.0**-52, 1e-290
"""`SPACING`: length of the shortest step, as a fraction of the time. A shorter step is lost in the rounding of the
time. `EARLIEST`: smallest time for this fraction. It replaces times closer to zero, where no step is lost.
"""

LEAST_FLOOR = 1e-307
"""Floor (least absolute tolerance) of a state entry whose size is unknown: positive, and smaller than any state."""

SMALL_FLOOR = 2.0**-24
"""Floor (least absolute tolerance) of an entry of the state below which the entry may be only rounding noise, as a
fraction of the largest floor of its kind, coordinates or velocities. It is used in ensembles and with other libraries.
"""

MOST_SURVEYS = 8
"""Largest number of times that a run estimates the sizes of the state's entries. If the steps still become shorter
after that, the solution requires short steps.
"""

FAR_FROM_ZERO = 1e-6
"""Step length, as a fraction of the time, below which rounding of the time changes the length of the step by more than
a relative 1e-10.
"""

AFTER_DIVERGED, AFTER_BROKEN = 0.5, 0.25
"""Factors of the step length after a failed step. `AFTER_DIVERGED`: Newton's method did not converge; it may do so at
half the length. `AFTER_BROKEN`: a state or slope is not finite, so the step must become shorter to stay in the domain.
"""

FIRST_SHARE = 0.01
"""Bound of the relative change of the state in the trial Euler step, which determines the length of the first step. The
error of the first step is aimed at the same fraction of the tolerance.
"""

RELATIVE_PERTURBATION = 2.0**-26
"""Relative perturbation of the state for estimating sensitivities: the square root of the unit of round-off."""

SLOPE_NOISE = 2.0**-44
"""Rounding error of an acceleration whose terms cancel, as a fraction of its sensitivity to the state. Slopes are
rounded to a few units of 2**-52 of their terms.
"""

FIRST_TRIAL, DEFAULT_FIRST = 2.0**-20, 1e-3
"""Step lengths as fractions of the run. `FIRST_TRIAL`: the trial length if no nonzero entry has a slope, as in a state
at rest. `DEFAULT_FIRST`: the first step if neither slopes nor their changes determine one.
"""


@lru_cache(maxsize=64)
def perturbation_factors(size: int) -> NDArray[np.float64]:
    """Return different factors (size,) from 1 to 2 by which the entries of a state are perturbed.

    With equal factors the difference of two equal entries would not change.
    """
    return np.asarray(1 + np.arange(size) * 0.6180339887498949 % 1)
