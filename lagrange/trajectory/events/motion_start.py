"""Events at the start of a smooth piece of motion: those that are zero there, and those that just changed it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, eq=False)
class MotionStart:
    """A motion that has just begun, with the events that are zero there.

    `first` is True at the start of the run. `stayed` are the sizes of event functions that count as zero, and `zeros`
    the directions of the events that just occurred. `rested` are events with a reset that stayed at zero on the steps
    since; their side is still open. `jumped` are events that occurred at a jump over zero: rounding decides on which
    side of it the motion starts, so a second jump at once is the same jump.
    """

    first: bool = False
    stayed: Mapping[int, float] = field(default_factory=dict)
    zeros: Mapping[int, int] = field(default_factory=dict)
    rested: frozenset[int] = frozenset()
    jumped: frozenset[int] = frozenset()
