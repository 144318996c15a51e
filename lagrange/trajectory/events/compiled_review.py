"""The compiled review of steps for a run: whether it is worth compiling, what it is told, and what it finds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lagrange.machine.backend import DensePath
from lagrange.machine.review import Review, Reviewed, WatchedEvents
from lagrange.procedure.dense.hermite import hermite_polynomial
from lagrange.program.program import Program
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.event_log import Occurrences
from lagrange.trajectory.events.roots import Side
from lagrange.trajectory.events.step_batch import Path
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.paths.step_paths import StepPath
from lagrange.trajectory.trajectory import FloatArray

WORTH_COMPILING = 512
"""Steps that a run may be expected to take from which on the review is compiled: that takes as long as to look at some
thousands of them on arrays, once for a process, and as long as some hundreds for each other event."""


ENOUGH = 16
"""Steps of a burst, at least, that tell how many a run will take: the first of all are short, and so are flights that a
reset ends soon, for which the review has nothing to go through."""


class KnownPath:
    """Makes the paths of bursts through their accepted states: the dense output of steps is made once for all."""

    def __init__(self, path_of: Callable[[FloatArray, FloatArray], Path]) -> None:
        self._path_of = path_of
        self._known: StepPath | None = None

    def __call__(self, times: FloatArray, states: FloatArray) -> Path:
        """Return the path through accepted times (S+1,) and states (S+1, 2n)."""
        if self._known is not None:
            return replace(self._known, times=times, states=states)
        made = self._path_of(times, states)
        self._known = made if isinstance(made, StepPath) else None
        return made


class CompiledReview:
    """What goes through the steps of a run where nothing is irregular, made at the first steps that are looked at."""

    def __init__(self, problem: Problem, program: Program, *, fixed: bool) -> None:
        self._problem, self._program, self._fixed = problem, program, fixed
        self._made: tuple[Review | None] | None = None

    @property
    def ready(self) -> bool:
        """Whether steps are reviewed by it."""
        return self._made is not None and self._made[0] is not None

    def review(self, path: Path) -> Review | None:
        """Return the review if the machine has one and the run seems long enough by its first steps."""
        if self._made is None and len(path.times) > ENOUGH:
            problem, covered = self._problem, abs(path.times[-1] - path.times[0])
            long = (len(path.times) - 1) * abs(problem.t1 - problem.t0) >= WORTH_COMPILING * covered
            self._made = (self._compiled(path.dense) if long and isinstance(path, StepPath) else None,)
        return None if self._made is None else self._made[0]

    def _compiled(self, dense: DensePath) -> Review | None:
        """Return the review, with the cubic through both ends as a screen where the error of steps is under control."""
        model, parameters = self._problem.model, self._problem.parameter_array
        cubic = hermite_polynomial(3)
        screened = not self._fixed and dense.degree > cubic.degree
        screen = model.machine.dense(cubic, model.kernel("rhs"), parameters) if screened else None
        return model.machine.review(self._program, parameters, dense, screen)


def watched_events(
    impacts: Sequence[Impact],
    zero_sides: Sequence[Side],
    occurrences: Sequence[Occurrences],
    stayed: Mapping[int, float] | None,
) -> WatchedEvents:
    """Return what a review is told of events; `stayed` are those at zero where the motion starts, None behind."""
    left = [1 if one.reset else one.terminal - len(zeros) for one, zeros in zip(impacts, occurrences, strict=True)]
    return WatchedEvents(
        sign=np.array([side.sign for side in zero_sides]),
        near=np.array([int(side.near) for side in zero_sides]),
        direction=np.array([one.direction for one in impacts]),
        remaining=np.array(
            [count if one.reset or one.terminal else 0 for one, count in zip(impacts, left, strict=True)]
        ),
        stayed=np.array([(stayed or {}).get(i, 0.0) for i in range(len(impacts))]),
        starts=stayed is not None,
    )


def sides(events: WatchedEvents) -> list[Side]:
    """Return the sides that a review left."""
    return [Side(sign, bool(near)) for sign, near in zip(events.sign.tolist(), events.near.tolist(), strict=True)]


def keep(found: Reviewed, occurrences: Sequence[Occurrences], taken: int) -> None:
    """Keep the events that a review found; the run had taken so many steps before."""
    for which, zeros in enumerate(occurrences):
        rows = np.flatnonzero(found.which == which)
        if len(rows):
            zeros.extend(found.when[rows], found.there[rows], taken + int(found.where[rows[-1]]) + 1)
