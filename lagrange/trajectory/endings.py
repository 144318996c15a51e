"""Find why a run failed, for its message: vanishing inertia, dependent constraints, the end of a table, corners."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lagrange.algorithm.events.constants import TOGETHER
from lagrange.equations.singular import (
    Singular,
    dependent_rows,
    least_regular,
    matrices_at,
    motion_along,
    scales,
    shortened_list,
)
from lagrange.errors import RunError
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.statement.given.motion import ranges
from lagrange.trajectory.constraints.dependence import dependent_passage
from lagrange.trajectory.constraints.discontinuities import Discontinuity
from lagrange.trajectory.dense_output import OutputPath
from lagrange.trajectory.ending_messages import message, number
from lagrange.trajectory.integrator import Problem, part_of
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory, run_until

DOMAIN_PROBE = 1e-6
"""Distance, as a fraction of the run, at which the right-hand side is evaluated after the step became too small. It
shows whether the equations have a value there."""


def slope_ahead(model: Model, t: float, y: FloatArray, parameters: FloatArray, h: float) -> FloatArray:
    """Return dy/dt (2n,) after a step h along the slope from (t, y), to test whether the equations have a value there.

    Near the edge of the domain of a root or a logarithm, accepted steps become small before any value is NaN, while the
    value after a fraction `DOMAIN_PROBE` of the run is NaN. The result is dy/dt at (t, y) itself if that is not finite,
    and ones if the mass matrix is singular.
    """
    kernel = model.kernel("rhs")
    with np.errstate(all="ignore"):
        try:
            slope = kernel(t, y, parameters)
            return kernel(t + h, y + h * slope, parameters) if np.isfinite(slope).all() else slope
        except SingularMassMatrix:
            return np.ones_like(y)


LOST_INERTIA = 2.0**-20
"""A mass matrix counts as singular if its smallest eigenvalue is below this fraction of that at the start.
Accelerations then grow without bound. Steps become too small at 1e-8 to 1e-11 (eight systems, four methods)."""

DOMINANT_SHARE = 0.5
"""Smallest part of the acceleration that has the direction without inertia, as a fraction of the acceleration, for
which a singular mass matrix counts as the cause of a failure. In a fall to the centre of polar coordinates it is
zero."""


def lost_inertia(problem: Problem, t: float, y: FloatArray) -> str:
    """Return the message for a run that ends at t and y (2n,) because the inertia of a motion vanishes, else ""."""
    model, parameters = problem.model, problem.parameter_array
    if len(model.equations.constraints):
        (singular,) = remaining_regularity(problem, [t], y)
        return rank_lost(problem, y, singular) if singular is not None and singular.regularity < LOST_INERTIA else ""
    kernel = model.kernel("mass_matrix")
    initial_mass, mass = kernel(problem.t0, problem.y0, parameters), kernel(t, y, parameters)
    sizes = np.abs(np.diag(initial_mass))
    units = np.sqrt(np.where(sizes > 0, sizes, 1.0))
    if not (np.isfinite(initial_mass).all() and np.isfinite(mass).all()):
        return ""
    least = float(np.abs(np.linalg.eigvalsh(initial_mass / np.outer(units, units))).min())
    values, vectors = np.linalg.eigh(mass / np.outer(units, units))
    which = int(np.argmin(np.abs(values)))
    left, null = float(abs(values[which])), vectors[:, which]
    if not left < LOST_INERTIA * least or not _moves_along(problem, t, y, null / units, units**2):
        return ""
    state, motion = _named(model.layout.names(), y), motion_along(model.layout, y, null / units)
    return (
        f"the mass matrix d2L/dv2 becomes singular there, at {state}: the inertia of a motion with "
        f"{motion} is {left / least:.2g} times the least inertia at the "
        "start, and its acceleration grows beyond all bounds. End the run before, or state a Lagrangian whose inertia "
        "does not vanish."
    )


def remaining_regularity(problem: Problem, t: Sequence[float], y: FloatArray) -> list[Singular | None]:
    """Return the nearness of k states of a run to dependent constraints or to a singular mass matrix.

    `t` are k times, and y (2n, k) the states there. A result has the most dependent rows of the constraint gradients G,
    or the velocities with the least inertia. Its `regularity` is the least singular value of G or of the mass matrix M,
    divided by the value at the start. A result is None if a matrix is not finite. All are None if a matrix is singular
    at the start.
    """
    model, y = problem.model, np.column_stack([problem.y0, y])
    mass, gradient = matrices_at(model, model.equations, np.array([problem.t0, *t]), y, problem.parameter_array)
    if not (np.isfinite(mass[:, :, 0]).all() and np.isfinite(gradient[:, :, 0]).all()):
        return [None] * len(t)
    scale = scales(mass[:, :, 0], gradient[:, :, 0])
    first, *others = (least_regular(mass[:, :, k], gradient[:, :, k], scale) for k in range(y.shape[1]))
    if first is None or not first.regularity:
        return [None] * len(t)
    return [
        None if singular is None else replace(singular, regularity=singular.regularity / first.regularity)
        for singular in others
    ]


PLACES_AHEAD, MUCH_NEARER = 65, 0.1
"""Number of points on the next two steps at which dependent constraints, where two motions cross, are searched for.
They are found if the least singular value of the constraint gradients decreases to the second number times its present
value."""


def dependent_ahead(problem: Problem, t: float, y: FloatArray, step: float) -> str:
    """Return the message for a run with fixed steps that fails because two motions cross ahead of y (2n,), else "".

    The next two steps of the signed length `step` are searched.
    """
    if not len(problem.model.equations.constraints):
        return ""
    try:
        slope = problem.model.kernel("rhs")(t, y, problem.parameter_array)
    except SingularMassMatrix:
        return ""
    h = step * np.linspace(0.0, 2.0, PLACES_AHEAD)
    ahead = remaining_regularity(problem, (t + h).tolist(), y[:, None] + h * slope[:, None])
    present, nearest = ahead[0], min(filter(None, ahead), key=lambda singular: singular.regularity, default=None)
    if present is None or nearest is None or not nearest.rows:
        return ""
    return crossing(problem, nearest, y) if nearest.regularity <= MUCH_NEARER * present.regularity else ""


NEARLY_DEPENDENT = 1e-2
"""A run with constraints may end as singular if the regularity of its state is below this number: the least singular
value of constraint gradients or mass matrix, relative to that at the start."""

SHRUNK, TREND_STEPS = 0.5, 32
"""Test after failed fixed steps, which decides whether a singular state ahead is searched for with step control. The
regularity is the least singular value of the constraint gradients or of the mass matrix, relative to the start. It must
be below the first number, and must have decreased during the last steps, whose number is the second. A turn of a
constraint gradient changes the regularity by up to sqrt(2), which may hide the decrease during fewer steps."""

SEARCH_SECONDS, SEARCH_MEMORY = 5.0, 2.0**28
"""Limits of the search for a singular state ahead, in seconds and bytes."""


def with_singular_state_ahead(problem: Problem, run: Trajectory, follow: Callable[[Problem], Trajectory]) -> Trajectory:
    """Return a run that diverged, with the status SINGULAR if its steps are equal and a singular state is the cause.

    For example a mass on a rod that shrinks to a point turns faster and faster, and fixed steps fail long before the
    point. `follow` runs a problem with step control. It continues the run for twice the time in which the regularity
    would decrease to zero at its present rate.
    """
    if run.step is None or not run.steps:
        return run
    t, elapsed = run.span[1], min(TREND_STEPS, run.steps) * math.copysign(run.step, problem.t1 - problem.t0)
    try:
        states = run.dense(np.array([t - elapsed, t]))
    except RunError:  # The run has no dense output.
        return run
    before, present = remaining_regularity(problem, [t - elapsed, t], states)
    if before is None or present is None or not present.regularity < min(SHRUNK, before.regularity):
        return run
    y = np.ascontiguousarray(states[:, 1])
    reach = 2.0 * elapsed * present.regularity / (before.regularity - present.regularity)
    limits = {"max_wall": min(SEARCH_SECONDS, problem.max_wall or math.inf), "max_memory": SEARCH_MEMORY}
    t1 = t + min(reach, problem.t1 - t, key=abs)
    ahead = follow(part_of(problem, t, t1, y, began=time.perf_counter(), **limits))
    end, last = ahead.span[1], np.ascontiguousarray(ahead.y[:, -1])
    (singular,) = remaining_regularity(problem, [end], last) if ahead.status is Status.SINGULAR else (None,)
    if singular is None or singular.regularity > NEARLY_DEPENDENT:
        return run
    detail = (
        f"its steps are too long for the motion ahead, which ends at t = {number(end)}: "
        f"{rank_lost(problem, last, singular, fixed_steps=True)}"
    )
    return replace(
        run, status=Status.SINGULAR, message=message(Status.SINGULAR, problem, t, y, run.method, detail=detail)
    )


def rank_lost(problem: Problem, y: FloatArray, singular: Singular, *, fixed_steps: bool = False) -> str:
    """Return the message for a run that ends at a state (2n,) where constraints or inertia become singular.

    `singular` has the dependent constraints, or the velocities without inertia. Its `regularity` is their least
    singular value, divided by the value at the start. `fixed_steps` is True if the run failed with fixed steps before
    this state: then the message does not advise fixed steps, and names the coordinates without the velocities.
    """
    layout = problem.model.layout
    state = _named(layout.coordinates if fixed_steps else layout.names(), y)
    share = singular.regularity
    left = f"{share:.2g} times its value at the start"
    if singular.motion is not None:
        return (
            f"the inertia of a motion with {motion_along(layout, y, singular.motion)}, which "
            f"satisfies the constraints, vanishes there, at {state}: it is {left}. End the run before, or state a "
            "Lagrangian whose inertia does not vanish."
        )
    what = f"their least singular value is {left}"
    if len(singular.rows) == 1:
        what = f"these derivatives are {share:.2g} times their values at the start"
    other = "" if fixed_steps else ", or, if the motion is smooth there, pass it with fixed steps, such as those of rk4"
    return (
        f"{dependent_rows(problem.model.equations.constraints.names, singular)} there, at {state}: {what}, and the "
        f"accelerations grow beyond all bounds. End the run before it{other}."
    )


def crossing(problem: Problem, dependent: Singular, y: FloatArray) -> str:
    """Return the message for a run that ends at a state (2n,) from which the motion may continue in two ways.

    Errors as small as the tolerance would select one. `dependent` has the constraints with dependent gradients.
    """
    names, state = problem.model.equations.constraints.names, _named(problem.model.layout.names(), y)
    return (
        f"{dependent_rows(names, dependent)} near there, and an error as small as the tolerance decides how the motion "
        f"goes on. The state is {state}. End the run before it, or pass it with fixed steps, such as those of rk4."
    )


def _named(names: Sequence[str], y: FloatArray) -> str:
    """Return entries of a state y (2n,) as text for a message, such as "x = 1.5, y = 0". Of many only some are listed.

    `names` are the names of the first entries of the state. Entries without a name are left out.
    """
    return shortened_list([f"{name} = {number(x)}" for name, x in zip(names, y, strict=False)])


def _moves_along(problem: Problem, t: float, y: FloatArray, null: FloatArray, metric: FloatArray) -> bool:
    """Return True if the acceleration at a state y (2n,) is mostly along the direction `null` (n,).

    `metric` (n,) are the inertias of the coordinates. Lengths are measured with them as weights.
    """
    try:
        rate = problem.model.kernel("rhs")(t, y, problem.parameter_array)[problem.model.layout.v]
    except SingularMassMatrix:
        return True
    size = float(np.sqrt(metric @ rate**2))
    return not np.isfinite(size) or abs(float((metric * null) @ rate)) >= DOMINANT_SHARE * size


NEAR_TABLE_END = 1e-6
"""Distance from the end of a table, as a fraction of its range, at which a failed run counts as ended by the table.
Adaptive steps come closer."""


def table_left(problem: Problem, t: float, y: FloatArray, step: float = 0.0) -> str:
    """Return a sentence if a table of a given function of time has no value at a state y (2n,), else "".

    The state after one more `step` (a signed duration) is also tested. The sentence is part of the message of a run
    that ends. It names the variable and the range of the table.
    """
    model, statement = problem.model, problem.model.statement
    stated = (statement.lagrangian, statement.dissipation, *statement.forces)
    tables = dict.fromkeys(table for expression in stated for table in ranges(expression))
    if not tables or not np.isfinite(y).all():
        return ""
    q, v = model.layout.split(y)
    states = np.stack([y, np.concatenate([q + step * v, v])], axis=1)
    nodes = tuple(model.equations.translate(variable) for variable, _, _ in tables)
    values = model.function("ranges", nodes)(np.array([t, t + step]), states, problem.parameter_array)
    for (variable, low, high), row in zip(tables, values, strict=True):
        margin = NEAR_TABLE_END * (high - low)
        if not (low + margin < row.min() and row.max() < high - margin):
            name = statement.quote(variable, 60)
            return (
                f"{name} = {row[0]:.6g} leaves its table, which has values from {low:.6g} to {high:.6g}: nothing is "
                "extrapolated. Give a longer table, or end the run before by a terminal event."
            )
    return ""


AT_THE_END = 1e-6
"""A discontinuity of a constraint in this last fraction of a Taylor step counts as at the end of the step."""


def until_dependent(
    problem: Problem, rtol: float, run: Trajectory, accepted: tuple[FloatArray, FloatArray]
) -> Trajectory:
    """Return `run`, cut before the first state after which rounding errors decide its motion.

    There the constraints are dependent, and the motion may continue in several ways. `accepted` has the times (S+1,)
    and states (S+1, 2n) of the accepted steps. `rtol` is the relative tolerance.
    """
    times, states = accepted
    stopped = not run.status.complete and run.status is not Status.STEP_TOO_SMALL
    passed = dependent_passage(problem.model, times, states, problem.parameter_array, rtol, stopped=stopped)
    if passed is None:
        return run
    row, dependent = passed
    detail = crossing(problem, dependent, states[row])
    return _shortened(problem, run, (float(times[row]), states[row]), row, detail)


def until_discontinuity(problem: Problem, run: Trajectory, passed: Discontinuity, *, series: bool) -> Trajectory:
    """Return `run`, cut at the last state before a constraint jumps or has a corner.

    `passed` is this discontinuity of the constraint. If the steps are Taylor `series`, a step that ends at the
    discontinuity is kept, since the dense output of this step is valid up to there.
    """
    steps = run.steps - passed.steps
    if not series or passed.part < 1.0 - AT_THE_END:
        return _shortened(problem, run, (passed.t, passed.y), steps, passed.what)
    end = math.nextafter(passed.after, passed.t)
    y = run.dense(np.array([end]))[:, 0]
    short = _shortened(problem, run, (end, y), steps + 1, passed.what)
    if problem.t_eval is not None:
        return short
    return replace(short, t=np.append(short.t, end), y=np.column_stack([short.y, y]))


def _shortened(problem: Problem, run: Trajectory, end: tuple[float, FloatArray], steps: int, detail: str) -> Trajectory:
    """Return `run`, cut at `end` (a time and a state), with the status SINGULAR.

    `steps` is the number of steps up to `end`, and `detail` the cause for the message.
    """
    t, y = end
    text = message(Status.SINGULAR, problem, t, y, run.method, detail=detail)
    return replace(run_until(run, t), status=Status.SINGULAR, message=text, steps=steps)


CLEAR = 1e-5
"""A contact is clearly open or overlapping if its event function exceeds this fraction of the largest one of all
contacts. For bodies that rest side by side, the errors of steps are at most 1e-9 of the largest."""

_GAP = "Bodies that touch need a small gap between them, such as a millionth of their distance."


def with_touching_bodies(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """Return a run whose message says so if several resets with a direction (contacts) act at the same time.

    The status becomes UNRELIABLE if a body passed through a contact.
    """
    contacts = [i for i, event in enumerate(problem.events) if event.reset and event.direction]
    counts = [len(trajectory.t_events[i]) for i in contacts]
    if len(contacts) < 2 or not sum(counts):
        return trajectory
    which, times = np.repeat(contacts, counts), np.concatenate([trajectory.t_events[i] for i in contacts])
    order = np.argsort(times, kind="stable")
    which, times = which[order], times[order]
    close = np.abs(np.diff(times)) <= TOGETHER * np.abs(times[1:])
    if not (close & (np.diff(which) != 0)).any():
        return trajectory
    if trajectory.status in (Status.STEP_TOO_SMALL, Status.NON_FINITE):
        return replace(trajectory, message=f"{trajectory.message} {_GAP}")
    if not trajectory.status.complete:
        return trajectory
    passed = _passed(problem, trajectory, contacts)
    if passed is None:
        return trajectory
    name = problem.model.statement.quote(problem.events[passed].expression)
    note = (
        f"The reset where {name} is zero sent the motion back at some times, and let it pass at others: it happens at "
        f"the same time as other resets, and rounding decides the order. {_GAP}"
    )
    return replace(trajectory, status=Status.UNRELIABLE, message=f"{trajectory.message} {note}")


def _passed(problem: Problem, trajectory: Trajectory, contacts: Sequence[int]) -> int | None:
    """Return the index of the first event that reset the motion at some of its zeros but let it pass at others.

    `contacts` are the indices of the events to test. None is returned if there is no such event. A reset that lets the
    motion through on purpose does not count.
    """
    model, forward = problem.model, 1.0 if problem.t1 >= problem.t0 else -1.0
    if isinstance(trajectory.dense, OutputPath) and trajectory.dense.path is None:
        t, y = trajectory.t, trajectory.y
    else:
        # Test the states at the outputs, and at the midpoints between impacts.
        impacts = np.sort(forward * np.concatenate([trajectory.t_events[i] for i in contacts]))
        t = forward * np.sort(np.concatenate([forward * trajectory.t, (impacts[1:] + impacts[:-1]) / 2]))
        y = trajectory.dense(t)
    nodes = tuple(model.equations.translate(problem.events[i].expression) for i in contacts)
    with np.errstate(all="ignore"):
        values = model.function("contacts", nodes)(t, np.ascontiguousarray(y), problem.parameter_array)
    clear = np.abs(values) > CLEAR * np.abs(values).max(initial=0.0)
    for i, g, is_clear in zip(contacts, values, clear, strict=True):
        rows = np.flatnonzero(is_clear)
        free = -problem.events[i].direction * g[rows] > 0
        counts = np.searchsorted(forward * trajectory.t_events[i], forward * t[rows])
        if len(rows) and rows[0] > 0:
            # A contact that starts at zero counts as open.
            free, counts = np.append(True, free), np.append(0, counts)
        acts, passes = np.diff(counts), free[:-1] & ~free[1:]
        # A reset that intentionally lets bodies pass acts once for each passage.
        if passes.any() and acts[free[:-1]].sum() > passes.sum():
            return i
    return None


SMALL_CHANGE = 2.0**-42
"""Relative change of a coordinate over the run below which it may be unresolved: a thousand spacings of doubles."""

ROUGH = 2.0**-8
"""Forces are unresolved if they change over one spacing of a coordinate's doubles by more than this fraction of their
variation. The variation is the change over displacements up to 2**-12 of the coordinate. The fraction is 2**-40 for
smooth forces. At theta = 1e14, where the spacing is 1/64, the energy of a pendulum has an error of a tenth."""

ROUNDING_PART = 2.0**-46
"""Fraction of the largest acceleration below which a change of an acceleration is rounding (64 units). Even an
acceleration of zero may change by this amount."""

NEIGHBOURS, OCTAVES = 8, 40
"""Displacements of a coordinate at which forces are evaluated, to test whether its doubles resolve the forces: the
number of nearest doubles, and the number of displacements by 1, 2, 4, ... spacings of doubles."""


def with_resolution(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """Return a run, with the status UNRELIABLE if a coordinate's doubles are too far apart to resolve the forces.

    The test uses the median difference of the forces between neighbouring doubles. At a jump of the forces only one
    difference is large, so jumps are not reported.
    """
    if not trajectory.status.complete or not trajectory.y.size:
        return trajectory
    layout = problem.model.layout
    begin, end = problem.y0.tolist(), trajectory.y[:, -1].tolist()
    for i in range(layout.q.stop):
        first, last = begin[i], end[i]
        if first and abs(last - first) <= SMALL_CHANGE * abs(first) and math.isfinite(first):
            ends = (problem.t0, problem.y0), (float(trajectory.t[-1]), trajectory.y[:, -1])
            if all(_is_rough(problem, t, y, i) for t, y in ends):
                name = layout.coordinates[i]
                note = (
                    f"{name} is {last:.4g}, where doubles are {math.ulp(last):.2g} apart, and forces change much over "
                    f"that: the run does not follow the motion. Start {name} nearer to zero, or an angle within one "
                    "turn."
                )
                return replace(trajectory, status=Status.UNRELIABLE, message=f"{trajectory.message} {note}")
    return trajectory


def _is_rough(problem: Problem, t: float, y: FloatArray, i: int) -> bool:
    """Return True if accelerations at a state y (2n,) change much between neighbouring doubles of coordinate `i`."""
    steps = np.concatenate([np.arange(NEIGHBOURS + 1.0), 2.0 ** np.arange(OCTAVES)])
    states = np.repeat(y[:, None], len(steps), axis=1)
    states[i] += steps * np.spacing(abs(y[i])) * (-1.0 if y[i] > 0 else 1.0)
    with np.errstate(all="ignore"):
        slopes = problem.model.kernel("rhs")(t, states, problem.parameter_array)[problem.model.layout.v]
    near = np.median(np.abs(np.diff(slopes[:, : NEIGHBOURS + 1], axis=1)), axis=1)
    whole = np.abs(slopes - slopes[:, :1]).max(axis=1)
    noise = ROUNDING_PART * np.abs(slopes).max()
    return bool((near > np.maximum(ROUGH * whole, noise)).any())
