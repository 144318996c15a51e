"""How step control decides, on every machine; what a method may choose of it is `Control`.

Source of `PI_SHARE`, `LEAST_PREVIOUS` and `DAMPING`: E. Hairer, S. P. Norsett, G. Wanner, Solving
Ordinary Differential Equations I, 2nd ed., 1993, II.4 and II.10, and its programs DOPRI5 and DOP853.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

NEAR_END = 1.01
"""A step within one percent of the end goes to the end, so that no sliver is left over."""

SPACING, EARLIEST = 16 * 2.0**-52, 1e-290
"""A step shorter than the first part of the time is lost in the round-off of the time; a time nearer to zero counts as
the second, for at zero nothing is lost."""

LEAST_FLOOR = 1e-307
"""The floor of an entry that nothing is known of: it can have an error, and no state is as small."""

REJECTIONS_BEFORE_SURVEY = 3
"""After so many rejected trials of a step in a row, or one that moved an entry that was zero and has no floor, a driver
asks how large the entries are. A Taylor driver, whose steps are rejected seldom, asks at the second, fourth, eighth
rejection of a run, and so on."""

MOST_SURVEYS = 8
"""A run asks so often at most: where it has to shrink its steps again and again it is the motion that wants it."""

SHORTEST_LAST_STEP = 1e-6
"""A last one of equal steps that is shorter than this part of the step is round-off of the grid, and joins the step
before it."""

FAR_FROM_ZERO = 1e-6
"""Below this part of the time, rounding the time changes the length of a step by more than 1e-10 of it."""

AFTER_DIVERGED, AFTER_BROKEN = 0.5, 0.25
"""The parts of its length at which a step is tried again: one that did not converge may then, and one that met a state
or a slope that is no number has to shrink further."""

LARGEST_RETRY = 0.95
"""A step whose error is too large is tried again at this part of its length at most."""

LEAST_NORM, LEAST_PREVIOUS = 1e-10, 1e-4
"""An error norm below the first counts as that, and that of the step before below the second: a step without an error
says nothing about the next."""

PI_SHARE = 0.75
"""By this part of the exponent of the previous norm that of the present one is less, so that h still follows the norm
where it changes slowly."""

DAMPING = 0.01
"""The share of the second error vector's sum of squares in the norm of DOP853."""

FIRST_SHARE = 0.01
"""For a first step: an Euler step of the trial length changes the state by this part at most, and the first step aims
at this part of the tolerance."""

CANCELLATION = 2.0**-12
"""An acceleration that is less than this part of what it owes to the entries of the state may be round-off of what
cancels."""

PERTURBATION = 2.0**-26
"""What an expression owes to the entries of the state shows where each is moved by about this part of itself: half of
the digits."""

SLOPE_NOISE = 2.0**-44
"""Slopes are rounded to a few units of round-off of what they are made of, 2**-52: this part of it, over the natural
period, is no more than noise."""

CANCELLATION_DOMINANCE = 16.0
"""Coordinates that such accelerations move must not be the ones that a first step follows: what they say of the square
of the rate may be so many times what the others do."""

LEAST_FIRST = 2.0**-44
"""Where an entry is zero its floor begins with this part, at least, of what the first step reaches: Newton's method has
to get below it."""

LEAST_SPACINGS = 64.0
"""A first step is not shorter than so many of the shortest: it is a guess, and no reason to give up."""

FIRST_TRIAL, DEFAULT_FIRST = 2.0**-20, 1e-3
"""Parts of the run. The first is the trial length where no entry that is not zero has a slope, as in a state at rest;
the second is the first step where neither slopes nor their change say anything about its length."""


@lru_cache(maxsize=64)
def perturbation_factors(size: int) -> NDArray[np.float64]:
    """Return numbers from 1 to 2, all different: else the difference of two equal entries would owe nothing to them."""
    return np.asarray(1 + np.arange(size) * 0.6180339887498949 % 1)
