"""Zeros that a watch finds on a step, and its plan for the step."""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.trajectory.events.roots import Root, Side


@dataclass(frozen=True)
class EventZero:
    """A root of an event function: the index of the function, and the root, in units of the time scale."""

    which: int
    root: Root


@dataclass(frozen=True)
class PlannedStep:
    """The number of the next step of a run, with the sides and the occurrences before it, in case it is taken back."""

    steps: int = 0
    zero_sides: tuple[Side, ...] = ()
    starting: frozenset[int] = frozenset()
    counts: tuple[int, ...] = ()
