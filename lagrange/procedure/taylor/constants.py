"""The numbers that decide how Taylor steps are tried, chosen and proven."""

from __future__ import annotations

LARGEST_SCALE_RATIO = 10.0
"""The series is computed in a time scaled by a power of two near the last step, so that its coefficients neither
overflow nor vanish whatever the units are; a step that differs from the scale by more than 2**10 is computed anew."""

START_ROWS = 4
"""So many rows behind the first say how large an entry becomes that a run begins with at zero: the fourth is that of
what moves what moves it. Series of entries that begin later say nothing about it."""

FIRST_SCALE_RATIO = 1.5
"""The first step of a run is computed anew if it differs from the scale by more than 2**1.5."""

ROWS_USED = 6
GUARD = 0.25
"""The step follows the last two rows, and the four before them as a guard: from rest every other coefficient is zero,
and the last that is not may be small by chance. Row k of a series of radius r shows r tolerance**(1/k); what it shows
of r may be exceeded by a quarter of a binary digit, for the rows of an entire function fall faster and faster."""

RADIUS_FRACTION = -1.0
"""No step is longer than half (this power of two) of the radius of convergence that the growth of the last rows shows,
however small they are: far from a wall exp(200 (x - 1)) they are below all tolerances, and say when it comes."""

ROW_DISTANCE = 4
"""So many orders lie between two rows whose sizes show the radius: of a series in the fourth power of time the others
are zero."""

DEFECT, DEFECT_NOISE = 4.0, 2.0**-40
"""How far the derivative of a series at the end of a step may be from what the equations say there: it is so many
tolerances for each order, over the step, and a part of the largest derivative for round-off. What is left out at
order p has a derivative of p tolerances over the step; in ten scenes at five tolerances the most was 1.1 of that."""

RETRY_FRACTION, MOST_FAILURES = 0.25, 24
"""A step that fails is tried again at a quarter of its length, so many times: then it is as short as round-off."""

PROBES, STEP_GROWTH = 32, 2.0
"""A series that terminates says nothing about what lies ahead: it is compared with the equations at so many places of a
step that is so many times as long as the one before."""

ZERO, NEGLIGIBLE = -900.0, -800.0
"""Powers of two, as parts of the tolerance: the first stands for zero where a logarithm is taken, and a coefficient
below the second counts as zero. A series in a fitting scale has none there but zeros: its last coefficients lie within
2**(LARGEST_SCALE_RATIO order) of the tolerance, 2**640 at order 64."""

OVERFLOWED = -45.0
"""A step below this power of two, in units of the scale, means no more than that a coefficient has overflowed or is
about to: infinity, as 2**1024 tolerances, asks for a step of 2**-51 at order 20."""

LONGER_SCALE, SHORTER_SCALE = 20.0, -40.0
"""Powers of two by which the scale changes where the last coefficients are zero, and where one has overflowed. At
orders up to 32 the last coefficient changes by 2**640 or 2**-1280: less than lies between one that counts as zero and
one that overflows, so that no try leaps over the scales that fit."""

LARGEST_EXPONENT = 900.0
"""Power of two, in units of the scale, of the longest step: a series that terminates may ask for one beyond all
doubles."""

SHORTEST_SCALE = 1e-280
"""The shortest scale of time that is tried: a step of 2**-45 of it is still a normal double."""

MOST_RESCALINGS = 120
"""Most changes of the scale of time for one step; beyond them the coefficients count as infinite.

From a scale of 1, 24 changes by `SHORTER_SCALE` lead below `SHORTEST_SCALE`, to 1e-289, and 96 by `LONGER_SCALE` from
there to 1e289.
"""
