"""On which side of zero an event function stands where a motion starts, and behind a reset: one rule for all methods.

The side is what is known of an event function between two places, and it is never read off a value that is round-off:

1. A reset that leaves the event function where it was, to its rounding, leaves its side too. What stood at zero but for
   rounding when another event acted has not passed. It passes where the new motion leads to the other side, and that
   is an event at the place of the reset: it counts, ends the run, or resets the state again, at once.
2. An event that happened at this place begins anew behind it: its side is where it leaves to. It does not happen twice.
3. A reset that moves the event function, and the start of a run, leave no side. Then a value beyond doubt has the sign
   that it has: a jump over zero is no event. A value of zero is no event either, but for a contact: an event with a
   direction and a reset. Its side is the one that it is reached from. Where its rate leads through, it acts at once,
   unless the motion would pass it behind its reset as well.

The first place after the change tells by the rate where a value within its noise goes to, as at any joint of two steps.
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
    """Return the sides of event functions behind a reset, from those in front of it; without a sign they begin anew.

    `change` has their values in front and behind, (E,), `noise` how much rounding may make of that. Events that
    `happened` begin anew. That a contact came near without a passage is forgotten: it is not to act on a touch.
    """
    kept = []
    for i, (side, impact, before, after) in enumerate(zip(sides, impacts, *change, strict=True)):
        stays = i not in happened and not impact.root and abs(after - before) <= noise[i]
        kept.append(Side(side.sign, side.near and not impact.reset) if stays else Side())
    return kept
