"""Runs over configurations where constraints become dependent: steps of equal length lead over where motions cross.

At a distance d before the crossing rounding e of a position leaves e/d of the motion that branches off there, and
e/d**2 of its velocity. A method with error control takes that for an error of its steps, and shortens them towards the
crossing, where it grows. But it does not last: behind the crossing the constraints determine the motion as well as
before. So the run goes back to a state that is well determined. Equal steps lead from there over the crossing to a
state as far behind it; the crossing lies inside a step, and on no stage. Steps of half the length must lead to the same
state; a motion that is not smooth at the crossing does not, and the run ends as it did.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagrange.errors import listing
from lagrange.trajectory.constraints.approach import NEAR, Independence, regularity
from lagrange.trajectory.constraints.discontinuities import may_be_discontinuous
from lagrange.trajectory.integrator import Integrator, Problem, run_by
from lagrange.trajectory.messages import number
from lagrange.trajectory.methods.explicit import RK4
from lagrange.trajectory.parts import joined, last_state, rest_of
from lagrange.trajectory.paths.known import OutputPath
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory, run_until

FAR = 0.03
"""Equal steps begin where the least singular value of the constraints is this part of that at the start.

Rounding leaves velocities errors of 1e-13 there."""

FIRST_DISTANCE, FARTHER = 1e-6, 1.5
"""The place is sought from this part of the run before its end on, each time so much farther away."""

SAMPLES, NEAREST_SAMPLE = 8, 0.25
"""The crossing is where the singular value vanishes, as so many values say, from that distance to this part of it."""

OFFSET = 0.3
"""The part of a step at which the crossing lies: the stages of rk4 are at 0, 1/2 and 1."""

FEWEST_STEPS, DOUBLINGS = 8, 6
"""Steps to the crossing; twice as many until two ways agree to the tolerance, or better than the next two. With 64 and
128 errors were 1e-13 to 1e-12."""

AGREEMENT, LEAST_AGREEMENT = 10.0, 1e-11
"""Two ways agree if their ends differ by so many tolerances of the largest coordinate, and velocity, or by rounding."""

MOST_NAMED = 3
"""A note names no more crossings, and constraints."""

MOST_CROSSINGS = 1000
"""So many crossings are passed in one run."""

ENDS = (Status.SINGULAR, Status.STEP_TOO_SMALL, Status.DIVERGED)
"""How a run may end on the way to a crossing."""


@dataclass(frozen=True, eq=False)
class _Crossing:
    """Where equal steps begin, a time and a state (2n,), when motions cross, and the constraints dependent there."""

    begin: float
    y: FloatArray
    time: float
    names: tuple[str, ...]


def run_over_crossings(integrator: Integrator, problem: Problem) -> Trajectory:
    """Run a problem by a method with error control, and by equal steps over crossings of motions; see the module."""
    found = run_by(integrator, problem)
    constrained = len(problem.model.equations.constraints) > 0
    if not constrained or found.status not in ENDS or not found.rtol or may_be_discontinuous(problem.model):
        return found
    parts, crossings = [found], list[_Crossing]()
    while len(crossings) < MOST_CROSSINGS and parts[-1].status in ENDS:
        crossing = _crossing_at_end(problem, parts[-1])
        if crossing is None:
            break
        over = _led_over(rest_of(problem, parts, crossing.begin, crossing.y), crossing, found.rtol)
        if over is None:
            break
        crossings.append(crossing)
        parts = [*parts[:-1], run_until(parts[-1], crossing.begin), over]
        if over.status is Status.SUCCESS and over.span[1] != problem.t1:
            parts.append(run_by(integrator, rest_of(problem, parts, over.span[1], last_state(over))))
    if not crossings:
        return found
    whole = joined(problem, parts, _told(crossings))
    return whole if problem.t_eval is not None else replace(whole, steps=len(whole.t) - 1)


def _crossing_at_end(problem: Problem, part: Trajectory) -> _Crossing | None:
    """Return the crossing towards which a run ended, or None if there is none, or no path to go back on."""
    path = part.dense.path if isinstance(part.dense, OutputPath) else part.dense
    (begin, end), near = part.span, Independence(problem.model, problem.parameter_array, (problem.t0, problem.y0))
    if path is None or near.at(end, last_state(part)) > NEAR:
        return None

    def values(times: list[float]) -> FloatArray:
        return np.array([near.at(t, y) for t, y in zip(times, part.dense(np.array(times)).T, strict=True)])

    distance = FIRST_DISTANCE * (end - problem.t0)
    while abs(distance) < abs(end - begin) and values([end - distance])[0] < FAR:
        distance *= FARTHER
    shares = np.linspace(1.0, NEAREST_SAMPLE, SAMPLES)
    if not abs(distance) < abs(end - begin):
        return None
    polynomial = np.polyfit(shares, values((end - shares * distance).tolist()), 3)
    roots = [root.real for root in np.roots(polynomial) if abs(root.imag) < NEAREST_SAMPLE]
    if not roots or min(map(abs, roots)) > NEAREST_SAMPLE:
        return None
    found = regularity(problem.model, problem.parameter_array, near.start, (end, last_state(part)))
    if found is None or not found[1].rows:
        return None
    names = tuple(problem.model.equations.constraints.names[i] for i, _ in found[1].rows)
    at_begin = np.ascontiguousarray(part.dense(np.array([end - distance]))[:, 0])
    return _Crossing(end - distance, at_begin, end - min(roots, key=abs) * distance, names)


def _led_over(rest: Problem, crossing: _Crossing, rtol: float) -> Trajectory | None:
    """Return the run by equal steps over a crossing, or None if no two ways over it agree."""
    before, best, least = None, None, math.inf
    for way in _ways(rest, crossing):
        apart = math.inf if before is None else _apart(rest, before, way)
        if apart > least:
            break
        best, least, before = way, apart, way
        if apart <= rtol:
            break
    return best if least <= max(AGREEMENT * rtol, LEAST_AGREEMENT) else None


def _ways(rest: Problem, crossing: _Crossing) -> Iterator[Trajectory]:
    """Yield runs over a crossing by more and more equal steps."""
    ahead = crossing.time - crossing.begin
    end = crossing.begin + 2.0 * ahead
    end = min(end, rest.t1) if ahead > 0 else max(end, rest.t1)
    wanted = rest.t_eval
    outputs = None if wanted is None else wanted[np.abs(wanted - crossing.begin) <= abs(end - crossing.begin)]
    for doubling in range(DOUBLINGS):
        step = abs(ahead) / (FEWEST_STEPS * 2**doubling + OFFSET)
        yield RK4().integrate(replace(rest, t1=end, t_eval=outputs, step=step, rtol=None, atol=None))


def _apart(rest: Problem, one: Trajectory, other: Trajectory) -> float:
    """Return how far apart two runs end, relative to the largest coordinate, and velocity; infinity if one failed."""
    if not (one.status.complete and one.status is other.status):
        return math.inf
    a, b = (rest.model.layout.split(last_state(part)) for part in (one, other))
    return max(float(np.abs(x - y).max() / (np.abs(y).max() or 1.0)) for x, y in zip(a, b, strict=True))


def _told(crossings: Sequence[_Crossing]) -> str:
    """Return the note on a run over crossings."""
    places = [f"t = {number(one.time)}" for one in crossings[:MOST_NAMED]]
    places += [f"{len(crossings) - MOST_NAMED} later times"] * (len(crossings) > MOST_NAMED)
    names = list(map(repr, crossings[0].names[:MOST_NAMED]))
    names += [f"{len(crossings[0].names) - MOST_NAMED} more"] * (len(crossings[0].names) > MOST_NAMED)
    return (
        f"Equal steps of rk4 led over {listing(places)}, where constraints become dependent and other motions cross: "
        f"{listing(names)}."
    )
