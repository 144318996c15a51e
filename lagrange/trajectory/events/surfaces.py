"""Continue a run from a switching surface, and take short steps over points where the motion has no Taylor series.

A motion that reaches a surface g = 0, or starts on it, continues where g is positive, or where g is negative. The
forces depend on the sign of g, and the motion determines the sign. A choice of signs is consistent if the motion with
the forces of these signs leads to them: the first nonzero time derivative of g has the chosen sign. If no choice is
consistent, the motion slides along a surface. Source: A. F. Filippov, Differential Equations with Discontinuous
Righthand Sides, 1988, section 4.

At some points a motion has no Taylor series, although its forces hardly change. With drag -|v|v a body at rest, or at
its turning point, is at the zero of a square root. The run passes such a point by a leap: one step of a method without
series, so short that the accelerations are nearly constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, field
from itertools import islice, product

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.events.constants import JUMP
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.kernel.interpreted import FLOATS
from lagrange.machine.state import DriverState
from lagrange.program.series import SeriesProgram
from lagrange.trajectory.dense_output import hermite_path
from lagrange.trajectory.events.series_at_state import leaving
from lagrange.trajectory.integrator import Integrator, Problem, part_of
from lagrange.trajectory.trajectory import FloatArray, Status

MOST_TRIALS = 3**8
"""Largest number of choices of signs (1, -1 or 0) that are tried where several switching surfaces are zero. It admits
all choices for up to eight surfaces."""

Surfaces = Callable[[FloatArray], FloatArray]
"""Type of a function from the signs of all surfaces to their Taylor series at a state, (order + 1, surfaces)."""


class Sliding(Exception):
    """Error: the motion would slide along the switching surface with index `surface`. The equations do not say how."""

    def __init__(self, surface: int) -> None:
        super().__init__(surface)
        self.surface = surface


def stated_sides(program: SeriesProgram, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return the sign (1, -1 or 0) of every switching surface at a state (2n,), from the value of its expression.

    The mass matrix is not computed, since it depends on these signs: with wrong signs it may be singular.
    """
    with np.errstate(all="ignore"):
        values = FLOATS.evaluate(program.surfaces, t, y, parameters)
        return np.asarray(np.sign(np.array(values[: program.sides], dtype=float)))


def settled_sides(surfaces: Surfaces, sides: FloatArray, choices: Mapping[int, tuple[int, ...]]) -> FloatArray:
    """Return the first consistent choice of signs at a state on switching surfaces.

    A choice is consistent if the forces of the chosen signs move the state to the sides with these signs. `surfaces`
    maps the signs of all surfaces to their Taylor series. `sides` are the present signs, 1 or -1. `choices` maps the
    index of each surface on which the state lies to the signs to try, the likely one first. The sign 0 means that the
    motion stays on the surface.

    If no choice is consistent, the result is the first choice with which a series is not finite, so that the run ends.
    If there is no such choice either, raises Sliding, or SingularMassMatrix if a choice has a singular mass matrix.
    """
    undefined: FloatArray | None = None
    singular: SingularMassMatrix | None = None
    for combination in islice(product(*choices.values()), MOST_TRIALS):
        trial = sides.copy()
        trial[list(choices)] = combination
        try:
            g = _reread(surfaces, trial, choices)
        except SingularMassMatrix as error:
            singular = error
            continue
        if not np.isfinite(g).all():
            undefined = trial if undefined is None else undefined
        elif all(leaving(g[:, i])[0] == side for i, side in zip(choices, combination, strict=True)):
            return trial
    if undefined is not None:
        return undefined
    raise Sliding(next(iter(choices))) if singular is None else singular


def _reread(surfaces: Surfaces, trial: FloatArray, chosen: Container[int]) -> FloatArray:
    """Return the Taylor series of all surfaces (order + 1, surfaces), and correct the sides `trial` in place.

    `surfaces` maps sides to the series. A side (1, -1 or 0) is corrected if the value of its surface is clearly not
    zero and has another sign. This happens because a surface may depend on the sides of other surfaces. The sides of
    the surfaces with indices in `chosen` are kept.
    """
    g = surfaces(trial)
    for _ in trial:
        wrong = [i for i in np.flatnonzero(clear(g) & (np.sign(g[0]) != trial)) if i not in chosen]
        if not wrong:
            break
        trial[wrong] = np.sign(g[0, wrong])
        g = surfaces(trial)
    return g


def clear(g: FloatArray) -> NDArray[np.bool_]:
    """Return a mask (...): True for functions whose value is clearly not zero, from their series g (order + 1, ...).

    The value, g[0], has to exceed the fraction `JUMP` of the largest Taylor coefficient.
    """
    return np.asarray(np.abs(g[0]) > JUMP * np.where(np.isfinite(g), np.abs(g), 0.0).max(axis=0))


LEAP_SHARE = 1e-6
"""Largest length of a leap, as a fraction of the run. A leap is a short step over a point without a Taylor series."""

CHANGE = 0.01
"""Largest relative change of an acceleration over a leap. A larger change may be a jump or a pole, which no leap may
pass. The change is divided by the acceleration, or by the velocity over the length of the run if this is larger. A leap
with a larger change, as at rest, needs the test of `GROWTH`."""

EARLY, GROWTH = 1 / 16, 0.5
"""Test of a leap with a large relative change of the acceleration, as at rest. The leap is accepted if at most half
(`GROWTH`) of the change occurs in its first 1/16 (`EARLY`). The acceleration then grows as a power of time of at least
1/4, like the force on a bead that another one touches. Near a pole, or like log(t), it grows otherwise."""

OFF_SURFACE = 2.0**-10
"""Fraction of a leap after which the motion has left the switching surface on which the leap began."""

IN_A_ROW = 3
"""Largest number of successive leaps (steps without a Taylor series) with no Taylor step between them."""

SHORTER, ATTEMPTS = 1 / 16, 6
"""Factor of the length of a leap after it was rejected, and largest number of leaps that are tried at one point."""

MOST_LEAP_STEPS = 2000
"""Largest number of steps that the other method takes in one leap. One is usual. A force that acts only for a short
time requires a thousand."""


@dataclass
class Continuations:
    """The leaps of a run so far. A leap is a short step, by another method, over a point without a Taylor series.

    `method` makes the integrator that takes the leaps; its default tolerances are used. `rows` are the indices of the
    accepted states at which leaps begin. `landed` is the time at which the last leap ended. `continuations_in_a_row`
    is the number of successive leaps without a Taylor step between them.
    """

    problem: Problem
    method: Callable[[], Integrator]
    rows: list[int] = field(default_factory=list)
    landed: float = math.nan
    continuations_in_a_row: int = 0

    def ahead(self, state: DriverState) -> list[float]:
        """Return the end times to try for a leap from the driver's state, the latest first.

        The list is empty at the end of the run, and after too many successive leaps.
        """
        span, left = abs(self.problem.t1 - self.problem.t0), float(state.reals[DriverState.END]) - state.t
        if not left or (state.t == self.landed and self.continuations_in_a_row >= IN_A_ROW):
            return []
        lengths = [LEAP_SHARE * span * SHORTER**k for k in range(ATTEMPTS)]
        least = 64 * 2.0**-52 * max(abs(state.t), 2.0**-60 * span)
        return [state.t + math.copysign(min(x, abs(left)), left) for x in lengths if x > least]

    def landing(self, state: DriverState, end: float, *, switched: Callable[[float], bool]) -> FloatArray | None:
        """Return the state (2n,) after a leap to the time `end`, or None if the forces change too much for a leap.

        A leap is a short step without a Taylor series. The forces at the end of the leap are compared with the forces
        at its start. `switched` takes a duration and returns True if the equations switch at a surface within this
        time. If they switch at once, the forces just after the start are compared instead. None is also returned if
        the method of the leap fails.
        """
        options = {"rtol": None, "atol": None, "max_steps": MOST_LEAP_STEPS}
        run = self.method().integrate(part_of(self.problem, state.t, end, state.y.copy(), **options))
        y = run.y[:, -1]
        if run.status is not Status.SUCCESS:
            return None
        begun, start = state.t + OFF_SURFACE * (end - state.t), (state.t, state.y)
        if switched(abs(begun - state.t) / 2):
            start = begun, run.dense(np.array([begun]))[:, 0]
        early = state.t + EARLY * (end - state.t)
        between = early, run.dense(np.array([early]))[:, 0]
        return y if self._changes_gradually(start, between, (end, y)) else None

    def land(self, state: DriverState, end: float, y: FloatArray, row: int) -> None:
        """Record a short step without a Taylor series from the accepted state with index `row`.

        The driver is set to the end of the step: the time `end` and the state y (2n,).
        """
        taylor = state.taylor
        self.rows.append(row)
        self.continuations_in_a_row = self.continuations_in_a_row + 1 if state.t == self.landed else 1
        self.landed, length = end, end - state.t
        path = hermite_path(4)(self.problem, np.array([state.t, end]), np.array([state.y, y]))
        state.outputs.write(end, length, path)
        state.reals[DriverState.T] = end
        taylor.low, taylor.scale = 0.0, length
        taylor.next_limit = taylor.limit = math.inf
        taylor.rescalings = taylor.failures = 0
        state.y[:] = y

    def _changes_gradually(self, *points: tuple[float, FloatArray]) -> bool:
        """Return True if the accelerations at both ends of a leap are nearly equal, or change gradually.

        `points` are pairs of time and state (2n,) at the start of the leap, early in it, and at its end. The change is
        gradual if at most the share `GROWTH` of it happens before the early point.
        """
        model, parameters = self.problem.model, self.problem.parameter_array
        kernel, v = model.kernel("rhs"), model.layout.v
        try:
            first, early, last = (kernel(t, y, parameters)[v] for t, y in points)
        except SingularMassMatrix:
            return False
        sizes = np.maximum(np.abs(first), np.abs(last))
        slow = np.maximum(np.abs(points[0][1][v]), np.abs(points[-1][1][v])) / abs(self.problem.t1 - self.problem.t0)
        change = np.abs(last - first)
        steady = (change <= CHANGE * np.maximum(sizes, slow)) | (np.abs(early - first) <= GROWTH * change)
        return bool(np.isfinite(sizes).all() and steady.all())
