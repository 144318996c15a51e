"""Energy test of a run. A run is unreliable if it does not conserve an energy that the equations conserve."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lagrange.machine.backend import quickly
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.paths.step_paths import OutputPath
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

LARGEST_LOSS, LOSS_WITH_CONTROL = 1.0, 1e3
"""A run is unreliable if the energy changes by more than the first fraction of the kinetic energy at the mean speed.
With error control the fraction is at most the second number times the root of rtol: 3 % at the default rtol of 1e-9,
which a million oscillations by dop853 do not reach. The kinetic energy at the mean speed is a quarter of the final one
in a fall from rest, and two fifths of the largest one in an oscillation. Two bodies that pass through one another
change the energy by 0.5 to 100 times that.
"""

NOTABLE_CHANGE, SMALL_CHANGE = 1e-5, 1e-2
"""Changes of the energy that need no further test: relative to the energy, and to the kinetic energy at either end. A
run at default tolerances changes the energy by 1e-12 to 1e-7, so that its test costs one evaluation. The first number
is small because the energy may be large only by the choice of its zero.
"""

SPEED_SAMPLES = 64
"""Number of equal parts of the time span at whose ends the speed is evaluated."""

ROUND_OFF_DISPLACEMENT = 1e-10
"""Relative displacement that counts as rounding and error within the tolerance. A body at rest in equilibrium has
energies of that size, which no method conserves.
"""

FIRST_DISPLACEMENT = 1e-3
"""Relative displacement along the first acceleration for which the motion has only begun. After one Euler step from
rest the kinetic energy has a relative error of 1; the error of the state is half of the squared step.
"""

DIRECTIONS = 8
"""Number of random displacements that are tried."""


def verified(problem: Problem, trajectory: Trajectory, before: float, *, adaptive: bool) -> Trajectory:
    """Return the trajectory of a run that began with the energy `before`; UNRELIABLE if the energy is not conserved.

    The status changes only if the equations of motion conserve the energy. `adaptive` is False for equal steps, which
    may jump over a collision or a singular configuration without an error. If an event reset the state, the energy
    just before the first reset is tested.
    """
    model = problem.model
    if not trajectory.status.complete or not model.equations.structure.may_keep_energy or not trajectory.y.size:
        return trajectory
    end, until = _last(problem, trajectory)
    after = energy(problem, end)
    if abs(after - before) <= NOTABLE_CHANGE * abs(before):
        return trajectory
    share = LARGEST_LOSS
    if adaptive and trajectory.rtol:
        share = min(share, LOSS_WITH_CONTROL * math.sqrt(trajectory.rtol))
    with np.errstate(all="ignore"):
        if math.isfinite(after) and _kept(problem, trajectory, end, until, before, after, share):
            return trajectory
    # The proof of conservation may take a second, so it comes last.
    if not model.conservative:
        return trajectory
    note = (
        f"The energy, which the equations of motion conserve, went from {before:.6g} to {after:.6g}: the run does not "
        f"follow the motion. {_remedy(trajectory, adaptive)}"
    )
    return replace(trajectory, status=Status.UNRELIABLE, message=f"{trajectory.message} {note}")


def _kept(
    problem: Problem,
    trajectory: Trajectory,
    end: FloatArray,
    until: float,
    before: float,
    after: float,
    share: float,
) -> bool:
    """Return True if the energy at the end of a run equals that at its start within a tolerance.

    `before` is the energy at the start, and `after` that at the end. `end` is the state (2n,) at the end, and `until`
    its time. The tolerance is the fraction `share` of the kinetic energy at the mean speed of the run, or the
    rounding error of the energy if that is larger. Cheap tests come first.
    """
    change, model = abs(after - before), problem.model
    momenta = quickly(model.kernel("momenta"), problem.parameter_array, problem.t0, end)
    small = min(share, SMALL_CHANGE)
    if momenta is not None and change <= small * abs(float(momenta @ end[model.layout.v])) / 2:
        return True
    if change <= small * float(_kinetic(problem, np.stack([problem.y0, end], axis=1)).max()):
        return True
    return change <= share * _mean_kinetic_energy(problem, trajectory, until) or change <= _noise(problem, before)


def energy(problem: Problem, y: FloatArray) -> float:
    """Return the energy of a state (2n,), with time and parameters as at the start of the run."""
    kernel, parameters = problem.model.kernel("energy"), problem.parameter_array
    quick_result = quickly(kernel, parameters, problem.t0, y)
    return float(kernel(problem.t0, y, parameters) if quick_result is None else quick_result)


def _last(problem: Problem, trajectory: Trajectory) -> tuple[FloatArray, float]:
    """Return the state (2n,) just before the first reset by an event, or the last state of the run, and its time."""
    if not problem.events:
        return trajectory.y[:, -1], float(trajectory.t[-1])
    direction = 1 if problem.t1 >= problem.t0 else -1
    resets = [
        (direction * float(times[0]), states[0])
        for event, times, states in zip(problem.events, trajectory.t_events, trajectory.y_events, strict=False)
        if event.reset and len(times)
    ]
    if not resets:
        return trajectory.y[:, -1], float(trajectory.t[-1])
    time, state = min(resets, key=lambda pair: pair[0])
    return state, direction * time


def _mean_kinetic_energy(problem: Problem, trajectory: Trajectory, until: float) -> float:
    """Return the kinetic energy at the mean speed of the run from its start to the time `until`.

    The speed is the square root of the kinetic energy. Unlike the energy, this value does not depend on the zero of
    the potential. Unlike the kinetic energy of one state, it is not zero at a turning point, and a close encounter
    does not dominate it.
    """
    t, y = trajectory.t, trajectory.y
    times = np.linspace(problem.t0, until, SPEED_SAMPLES + 1)
    alone = isinstance(trajectory.dense, OutputPath) and trajectory.dense.path is None
    if alone or (problem.t_eval is None and len(t) > SPEED_SAMPLES):
        rows = np.minimum(np.searchsorted(np.abs(t - t[0]), np.abs(times - t[0])), len(t) - 1)
        states = y[:, rows]
    else:
        states = trajectory.dense(times)
    speeds = np.sqrt(_finite(_kinetic(problem, states)))
    return float(speeds.sum() / max(len(speeds), 1)) ** 2


def _kinetic(problem: Problem, y: FloatArray) -> FloatArray:
    """Return |v.p| / 2 (K,) of states (2n, K): the kinetic energy, if it is quadratic in the velocities."""
    q, v = problem.model.layout.split(y)
    momenta = problem.model.momenta(q, v, problem.t0, problem.parameter_array)
    return np.asarray(np.abs(np.sum(v * momenta, axis=0)) / 2)


def _noise(problem: Problem, before: float) -> float:
    """Return the rounding error of the initial energy, `before`.

    It is the largest change of the energy if the initial state changes in several directions by rounding, or by a
    tiny first step.
    """
    layout, y0 = problem.model.layout, problem.y0
    sizes = np.concatenate([np.full(len(part), np.abs(part).max()) for part in layout.split(y0)])
    ways = np.cos(np.outer(np.arange(1, layout.size + 1), np.arange(1, DIRECTIONS + 1)))
    rates = problem.model.kernel("rhs")(problem.t0, y0, problem.parameter_array)[layout.v]
    begun = np.append(FIRST_DISPLACEMENT * sizes[layout.q] * rates / (np.abs(rates).max() or 1.0), 0.0 * rates)
    moved = y0[:, None] + np.column_stack([begun, ROUND_OFF_DISPLACEMENT * sizes[:, None] * ways])
    energies = problem.model.energy(*layout.split(moved), problem.t0, problem.parameter_array)
    return float(_finite(np.abs(energies - before)).max(initial=0.0))


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _remedy(trajectory: Trajectory, adaptive: bool) -> str:
    if not adaptive:
        return "Shorten the step, or take an adaptive method such as dop853."
    method = DEFAULT_METHOD if trajectory.method != DEFAULT_METHOD else "dop853"
    now = "" if trajectory.rtol is None else f" (now {trajectory.rtol:g})"
    return f"Lower rtol{now} and atol, or take another method, such as {method}."
