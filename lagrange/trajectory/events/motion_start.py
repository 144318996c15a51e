"""What is known of events where a motion starts: which are zero there, and which have just changed it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, eq=False)
class MotionStart:
    """A motion that has just begun: events known to be zero there, to a size, and the directions of those just met.

    `rested` are those with a reset that stayed at zero on the steps since: what they leave to is still to be seen.
    `jumped` are those that were met where they jump over zero: rounding decides on which side of that the motion
    starts, so that they may jump again at once, which is the same jump.
    """

    first: bool = False
    stayed: Mapping[int, float] = field(default_factory=dict)
    zeros: Mapping[int, int] = field(default_factory=dict)
    rested: frozenset[int] = frozenset()
    jumped: frozenset[int] = frozenset()
