"""Runs in parts, one after the other: the problem that is left behind a part, and the parts as one run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lagrange.statement.event import Event
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.paths.known import OutputPath
from lagrange.trajectory.paths.piecewise import PiecewisePath
from lagrange.trajectory.trajectory import FloatArray, Trajectory


def last_state(part: Trajectory) -> FloatArray:
    """Return the state at the end of a run, which is no output of each."""
    known = len(part.t) > 0 and part.t[-1] == part.span[1]
    return np.ascontiguousarray(part.y[:, -1] if known else part.dense(np.array([part.span[1]]))[:, 0])


def rest_of(problem: Problem, parts: Sequence[Trajectory], begin: float, y: FloatArray) -> Problem:
    """Return what is left of a problem behind a time, at which it is in a state."""
    forward = 1.0 if problem.t1 >= problem.t0 else -1.0
    wanted = None if problem.t_eval is None else problem.t_eval[forward * (problem.t_eval - begin) > 0]
    steps = sum(part.steps + part.rejected for part in parts)
    wall = None if problem.max_wall is None else max(problem.max_wall - sum(part.wall for part in parts), 1e-3)
    times = [np.concatenate(times) for times in zip(*(part.t_events for part in parts), strict=True)]
    seen = [int((forward * (each - begin) <= 0).sum()) for each in times]
    return replace(
        problem,
        t0=begin,
        y0=y,
        t_eval=wanted,
        max_steps=max(problem.max_steps - steps, 1),
        max_wall=wall,
        events=tuple(_counted(event, count) for event, count in zip(problem.events, seen, strict=True)),
        began=time.perf_counter(),
    )


def _counted(event: Event, count: int) -> Event:
    """Return an event that has happened so often."""
    return replace(event, terminal=max(event.terminal - count, 1)) if event.terminal else event


def joined(
    problem: Problem, parts: Sequence[Trajectory], note: str = "", *, both_at_joints: bool = False
) -> Trajectory:
    """Return the parts of a run as one, with a note behind its message.

    Without output times each part has its first state, where the one before may end; `both_at_joints` keeps the two.
    """
    first, last = parts[0], parts[-1]
    t, y = np.concatenate([part.t for part in parts]), np.concatenate([part.y for part in parts], axis=1)
    if problem.t_eval is None and not both_at_joints:
        new = np.append(True, np.diff(t) != 0)
        t, y = t[new], y[:, new]
    path = PiecewisePath(
        np.array([part.span[0] for part in parts] + [last.span[1]]), problem.y0, [part.dense for part in parts]
    )
    return replace(
        last,
        t=t,
        y=y,
        message=f"{last.message} {note}".rstrip(),
        method=first.method,
        steps=sum(part.steps for part in parts),
        rejected=sum(part.rejected for part in parts),
        evaluations=sum(part.evaluations for part in parts),
        wall=sum(part.wall for part in parts),
        span=(first.span[0], last.span[1]),
        dense=path if problem.t_eval is None else OutputPath(t, y, path),
        form=first.form,
        step=first.step,
        rtol=first.rtol,
        atol=first.atol,
        t_events=tuple(np.concatenate(times) for times in zip(*(part.t_events for part in parts), strict=True)),
        y_events=tuple(np.concatenate(states) for states in zip(*(part.y_events for part in parts), strict=True)),
    )
