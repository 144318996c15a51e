"""The side of zero of an event function at the start of a motion and after a reset: one rule for all methods.

The side is the known sign of an event function between two points. It is never taken from a value within rounding:

1. A reset that does not change the event function, up to rounding, keeps its side. An event function within rounding of
   zero when another event acted has not crossed. It crosses if the new motion leads to the other side. That is an event
   at the time of the reset: it counts, ends the run, or resets the state again, at once.
2. An event that occurred at this point has no side after it: the motion decides it. The event does not occur twice.
3. A reset that changes the event function, and the start of a run, leave no side. A value beyond rounding then gives
   the side: a jump over zero is not an event. A value of zero is not an event either, except for a contact, which is
   an event with a direction and a reset. Its side is the one that it is reached from. If its rate leads through, it
   acts at once, unless the motion would pass it after its reset as well.

At the first point after the change the rate decides the side of a value within its noise, as between any two steps.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.roots import Side
from lagrange.trajectory.trajectory import FloatArray


def sides_behind(
    sides: Sequence[Side],
    impacts: Sequence[Impact],
    change: tuple[FloatArray, FloatArray],
    noise: FloatArray,
    happened: Container[int],
) -> list[Side]:
    """Return the sides of event functions after a reset, from the sides before it; sign 0 where the side is open.

    `change` has their values before and after, (E,) each, and `noise` (E,) their rounding. Events that `happened`
    have an open side. A pending touch of a contact is cleared: a contact must not act without crossing.
    """
    kept = []
    for i, (side, impact, before, after) in enumerate(zip(sides, impacts, *change, strict=True)):
        stays = i not in happened and not impact.root and abs(after - before) <= noise[i]
        kept.append(Side(side.sign, side.near and not impact.reset) if stays else Side())
    return kept
