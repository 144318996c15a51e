"""What a watch finds on a step, and what it plans for it."""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.trajectory.events.roots import Root, Side


@dataclass(frozen=True)
class EventZero:
    """A root of something that is watched: its place among the watched, and when, in units of the scale."""

    which: int
    root: Root


@dataclass(frozen=True)
class PlannedStep:
    """The step that a run is to take next, by number, and what holds before it."""

    steps: int = 0
    zero_sides: tuple[Side, ...] = ()
    starting: frozenset[int] = frozenset()
    counts: tuple[int, ...] = ()
