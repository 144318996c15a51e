"""How step control decides, on every machine; what a method may choose of it is `Control`.

Source of the first step, of `INTEGRAL`, `LEAST_PREVIOUS` and `DAMPING`: E. Hairer, S. P. Norsett, G. Wanner, Solving
Ordinary Differential Equations I, 2nd ed., 1993, II.4 and II.10, and its programs DOPRI5 and DOP853.
"""

SLIVER = 1e-6
"""A last one of equal steps that is shorter than this part of the step is round-off of the grid, and joins the step
before it."""

FAR = 1e-6
"""Below this part of the time, rounding the time changes the length of a step by more than 1e-10 of it."""

AFTER_DIVERGED, AFTER_BROKEN = 0.5, 0.25
"""The parts of its length at which a step is tried again: one that did not converge may then, and one that met a state
or a slope that is no number has to shrink further."""

SHRUNK = 0.95
"""A step whose error is too large is tried again at this part of its length at most."""

LEAST_NORM, LEAST_PREVIOUS = 1e-10, 1e-4
"""An error norm below the first counts as that, and that of the step before below the second: a step without an error
says nothing about the next."""

INTEGRAL = 0.75
"""By this part of the exponent of the previous norm that of the present one is less, so that h still follows the norm
where it changes slowly."""

DAMPING = 0.01
"""The share of the second error vector's sum of squares in the norm of DOP853."""

SMALL, GUESS = 1e-5, 1e-6
"""For a first step: a state or a slope of less than the first of its tolerance says nothing, and h is guessed."""

SHARE = 0.01
"""An Euler step of the first guess changes the state by this part; the second guess aims at this part of the error."""

FLAT, SLOWLY = 1e-15, 1e-3
"""With slopes of less than the first of their tolerance, the second guess is this part of the first one, or `GUESS`."""

LEAP = 100.0
"""The first step is at most so many times the first guess."""
