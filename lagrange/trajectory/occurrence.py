"""What happened at events so far, and how close together changes of the motion came."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

TOGETHER = 4 * 2.0**-52
"""Roots closer than this part of the time happen at once."""

CLOSEST = 64 * 2.0**-52
"""An event or surface that is met again and again closer than this part of the time accumulates."""

AGAIN = 3
"""How often in a row that is."""


@dataclass(frozen=True)
class Occurrence:
    """An event: when, the state there (2n,), and the accepted steps without which it has not happened."""

    t: float
    y: FloatArray
    steps: int


def times_of(occurrences: Iterable[Sequence[Occurrence]], steps: int) -> tuple[FloatArray, ...]:
    """Return the times (k,) of each event up to an accepted step."""
    return tuple(np.array([one.t for one in found if one.steps <= steps]) for found in occurrences)


def states_of(occurrences: Iterable[Sequence[Occurrence]], steps: int, size: int) -> tuple[FloatArray, ...]:
    """Return the states (k, 2n) at each event up to an accepted step."""
    return tuple(np.array([one.y for one in found if one.steps <= steps]).reshape(-1, size) for found in occurrences)


class Crowd:
    """Tells whether changes of the motion follow one another so closely that time stands still."""

    def __init__(self) -> None:
        self.last = -math.inf
        self.counts: Counter[int] = Counter()

    def accumulates(self, t: float, which: Iterable[int]) -> bool:
        """Count changes of what is watched, by number, at a time."""
        if abs(t - self.last) > CLOSEST * max(abs(t), 1e-290):
            self.counts.clear()
        self.last = t
        self.counts.update(which)
        return max(self.counts.values()) > AGAIN
