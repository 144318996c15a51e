"""Runs with contacts that act at one time, as of balls that touch: rounding decides their order.

A contact is an event with a direction and a reset. Where a reset of one makes another one act at the same place, the
value of that one is rounding, and so is its sign. A wrong sign lets a body through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lagrange.procedure.events.constants import TOGETHER
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.paths.known import OutputPath
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

CLEAR = 1e-5
"""A contact is clearly on a side where its value is more than this fraction of the largest of all contacts.

Bodies that rest side by side drift apart, or into one another, by the error of a step: 1e-9 of it and less.
"""

_GAP = "Bodies that touch need a small gap between them, such as a millionth of their distance."


def with_touching_bodies(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """Return a run with the remedy where contacts act at one time, as unreliable if one of them let a body through."""
    contacts = [i for i, event in enumerate(problem.events) if event.reset and event.direction]
    if len(contacts) < 2 or not _coincide([trajectory.t_events[i] for i in contacts]):
        return trajectory
    if trajectory.status in (Status.STEP_TOO_SMALL, Status.NON_FINITE):
        return replace(trajectory, message=f"{trajectory.message} {_GAP}")
    if not trajectory.status.complete:
        return trajectory
    passed = _passed(problem, trajectory, contacts)
    if passed is None:
        return trajectory
    name = str(problem.events[passed].expression.xreplace(dict(problem.model.statement.plain)))[:80]
    note = (
        f"The reset where {name} is zero sent the motion back at some times, and let it through at others: it acts at "
        f"one time with other resets, in an order that rounding decides. {_GAP}"
    )
    return replace(trajectory, status=Status.UNRELIABLE, message=f"{trajectory.message} {note}")


def _coincide(times: Sequence[FloatArray]) -> bool:
    """Whether two events, of times (k,) each, happen at one time."""
    all_times = np.concatenate(times)
    which = np.repeat(np.arange(len(times)), [len(one) for one in times])
    order = np.argsort(all_times, kind="stable")
    all_times, which = all_times[order], which[order]
    close = np.abs(np.diff(all_times)) <= TOGETHER * np.abs(all_times[1:])
    return bool((close & (np.diff(which) != 0)).any())


def _passed(problem: Problem, trajectory: Trajectory, contacts: Sequence[int]) -> int | None:
    """Return the first contact that lets the motion through at some of its zeros only, or None."""
    model, forward = problem.model, 1.0 if problem.t1 >= problem.t0 else -1.0
    t, y = _between_impacts(trajectory, contacts, forward)
    nodes = tuple(model.equations.translate(problem.events[i].expression) for i in contacts)
    with np.errstate(all="ignore"):
        values = model.function("contacts", nodes)(t, np.ascontiguousarray(y), problem.parameter_array)
    clear = np.abs(values) > CLEAR * np.abs(values).max(initial=0.0)
    for i, g, known in zip(contacts, values, clear, strict=True):
        rows = np.flatnonzero(known)
        free = -problem.events[i].direction * g[rows] > 0
        counts = np.searchsorted(forward * trajectory.t_events[i], forward * t[rows])
        if len(rows) and rows[0] > 0:
            # A contact that starts at zero is on the side that it is to stay on.
            free, counts = np.append(True, free), np.append(0, counts)
        acts, passes = np.diff(counts), free[:-1] & ~free[1:]
        # A reset that lets the motion through does so each time: it acts once for each passage.
        if passes.any() and acts[free[:-1]].sum() > passes.sum():
            return i
    return None


def _between_impacts(trajectory: Trajectory, contacts: Sequence[int], forward: float) -> tuple[FloatArray, FloatArray]:
    """Return the output times with those halfway between impacts, (k,), and the states there, (2n, k)."""
    impacts = np.sort(forward * np.concatenate([trajectory.t_events[i] for i in contacts]))
    t = np.sort(np.concatenate([forward * trajectory.t, (impacts[1:] + impacts[:-1]) / 2]))
    if isinstance(trajectory.dense, OutputPath) and trajectory.dense.path is None:
        return trajectory.t, trajectory.y
    return forward * t, trajectory.dense(forward * t)
