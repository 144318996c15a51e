"""Energy along a run: test of its conservation (status UNRELIABLE), and drift, also of conserved momenta."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagrange.errors import RunError
from lagrange.machine.backend import one_state, quickly
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import Parameters, some_of
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.dense_output import OutputPath
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

LARGEST_LOSS, LOSS_WITH_CONTROL = 1.0, 1e3
"""Largest change of a conserved energy in a reliable run, as a fraction of the kinetic energy at the mean speed. The
first number is for fixed steps. With error control the fraction is at most the second number times sqrt(rtol). This is
3 % at the default rtol of 1e-9, which a million oscillations by dop853 do not reach. The kinetic energy at the mean
speed is a quarter of the final one in a fall from rest, and two fifths of the largest one in an oscillation. Two bodies
that pass through one another change the energy by 0.5 to 100 times the kinetic energy at the mean speed."""

NOTABLE_CHANGE, SMALL_CHANGE = 1e-5, 1e-2
"""Largest changes of a conserved energy that need no further test: as a fraction of the energy, and of the kinetic
energy at the start or the end of the run. At default tolerances the energy changes by 1e-12 to 1e-7, so that the test
costs one evaluation. The first number is small because the energy may be large only by the choice of its zero."""

SPEED_SAMPLES = 64
"""Number of equal parts of a time span. The mean speed over the span is computed from the speeds at their ends."""

ROUND_OFF_DISPLACEMENT = 1e-10
"""Change of an entry of the initial state, as a fraction of the largest entry, that counts as rounding or as an error
within the tolerance. The energy that it causes for a body at rest in equilibrium is not conserved by any method."""

FIRST_DISPLACEMENT = 1e-3
"""Displacement of the initial coordinates along the first acceleration, as a fraction of the largest coordinate. The
change of the energy by it counts as rounding of the initial energy, because the motion has hardly begun there.
After one Euler step from rest the kinetic energy has a relative error of 1, but the error of the state is only half of
the squared step."""

DIRECTIONS = 8
"""Number of displacements of the initial state from which the rounding error of its energy is estimated."""


def verified(problem: Problem, trajectory: Trajectory, before: float, *, adaptive: bool) -> Trajectory:
    """Return the trajectory of a run, with the status UNRELIABLE if it does not conserve its initial energy `before`.

    The status changes only if the equations of motion conserve the energy. `adaptive` is False for fixed steps, which
    may jump over a collision or a singular configuration without an error. If an event reset the state, the energy just
    before the first reset is tested.
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
    change, small = abs(after - before), min(share, SMALL_CHANGE)
    with np.errstate(all="ignore"):
        # Cheap tests come first: whether the change is small relative to kinetic energies, or is rounding.
        if math.isfinite(after):
            momenta = quickly(model.kernel("momenta"), problem.parameter_array, problem.t0, end)
            if (
                (momenta is not None and change <= small * abs(float(momenta @ end[model.layout.v])) / 2)
                or change <= small * float(_kinetic(problem, np.stack([problem.y0, end], axis=1)).max())
                or change <= share * _mean_kinetic_energy(problem, trajectory, until)
                or change <= _noise(problem, before)
            ):
                return trajectory
    # The proof of conservation may take a second, so it comes last.
    if not model.conservative:
        return trajectory
    remedy = "Shorten the step, or take an adaptive method such as dop853."
    if adaptive:
        method = DEFAULT_METHOD if trajectory.method != DEFAULT_METHOD else "dop853"
        now = "" if trajectory.rtol is None else f" (now {trajectory.rtol:g})"
        remedy = f"Lower rtol{now} and atol, or take another method, such as {method}."
    note = (
        f"The energy, which the equations of motion conserve, went from {before:.6g} to {after:.6g}: the run does not "
        f"follow the motion. {remedy}"
    )
    return replace(trajectory, status=Status.UNRELIABLE, message=f"{trajectory.message} {note}")


def energy(problem: Problem, y: FloatArray) -> float:
    """Return the energy of a state (2n,), with time and parameters as at the start of the run."""
    return float(one_state(problem.model.kernel("energy"), problem.parameter_array)(problem.t0, y))


def _last(problem: Problem, trajectory: Trajectory) -> tuple[FloatArray, float]:
    """Return the state (2n,) just before the first reset by an event, or the last state of the run, and its time."""
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
    """Return the kinetic energy at the mean speed of a run from its start to the time `until`.

    The speed of the system is here the square root of its kinetic energy. Unlike the energy, the result does not depend
    on the zero of the potential. Unlike the kinetic energy of one state, it is not zero at a turning point, and a close
    encounter does not dominate it.
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
    """Return |v.p| / 2 (K,) for states (2n, K) with velocities v and momenta p.

    It is the kinetic energy if that is quadratic in the velocities.
    """
    q, v = problem.model.layout.split(y)
    momenta = problem.model.momenta(q, v, problem.t0, problem.parameter_array)
    return np.asarray(np.abs(np.sum(v * momenta, axis=0)) / 2)


def _noise(problem: Problem, before: float) -> float:
    """Return an estimate of the rounding error of the initial energy `before`.

    It is the largest change of the energy if the initial state changes by rounding, in one of several directions, or by
    a tiny first step.
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


_NEAR_ZERO = 1e-3
"""Magnitude of the initial energy, as a fraction of the largest |v.p| / 2, below which it is not a scale for changes of
the energy. It is then only the small difference of larger energies."""


@dataclass(frozen=True, repr=False)
class EnergyDrift:
    """The energy E along a run: `first` is E0 at the start, or at the first output if no start is known.

    `last` is E at the end, `absolute` is max |E - E0|, and `relative` is `absolute` / `scale`. The scale is |E0|. If E0
    is close to zero, the scale is the largest |v.p| / 2, for most systems the largest kinetic energy. `against` names
    the scale in words. `conserved` is True if the equations conserve the energy, and None if that is not known. The
    drift measures accuracy only if `conserved` is True.
    """

    conserved: bool | None
    first: float
    last: float
    absolute: float
    scale: float
    against: str

    def __repr__(self) -> str:
        return f"<EnergyDrift: {self.sentence()}>"

    @property
    def relative(self) -> float:
        """The largest change of the energy divided by its scale, or the change itself if the scale is zero."""
        return self.absolute / self.scale if self.scale > 0 else self.absolute

    @property
    def unkept(self) -> str:
        """Remark in words that the system does not conserve the energy, or is not known to conserve it."""
        return "the system does not conserve it" if self.conserved is False else "not found to be conserved"

    def sentence(self) -> str:
        """Return a sentence with the relative drift of the energy.

        For an energy that is not known to be conserved it has the first and the last energy instead.
        """
        if not self.conserved:
            return f"from {self.first:.6g} to {self.last:.6g} ({self.unkept})"
        return f"{self.relative:.1e} of {self.against}"


def since_start(run: Trajectory) -> tuple[FloatArray, FloatArray, bool]:
    """Return the times (N,) and states (2n, N) of a run's outputs, beginning with the start of the run, and True.

    If the outputs do not contain the start, it is added before them. If its state cannot be computed, the outputs alone
    and False are returned.
    """
    first, t, y = run.span[0], run.t, run.y
    if not len(t) or t[0] == first:
        return t, y, True
    try:
        start = run.dense(np.array([first]))
    except RunError:
        return t, y, False
    return np.append(first, t), np.column_stack([start, y]), True


def energy_drift(
    model: Model,
    t: FloatArray,
    y: FloatArray,
    from_start: bool,
    start: Mapping[Any, float],
    run: Trajectory,
    lost: FloatArray,
) -> EnergyDrift:
    """Return the drift of the energy of states y (2n, N) at times t (N,).

    `from_start` is True if the first state is the start of the `run`. `start` has the parameters at the start. Energy
    that events add by setting parameters is subtracted. The energy `lost` (N,) up to each time at contacts is added.
    """
    parameters, (q, v) = run.parameters_at(t, start), model.layout.split(y)
    with np.errstate(all="ignore"):  # The run reports states that are not finite.
        energy = np.asarray(model.energy(q, v, t, parameters)) - run.added_energy(t) + lost
        momenta = np.asarray(model.momenta(q, v, t, parameters))
        exchanged = 0.5 * float(np.max(np.abs(np.sum(v * momenta, axis=0))))
        first, absolute = float(energy[0]), float(np.max(np.abs(energy - energy[0])))
    scale, against = abs(first), "the initial energy" if from_start else "the energy at the first output"
    if abs(first) < _NEAR_ZERO * exchanged:
        scale, against = exchanged, "the largest |v.p|/2"
    kept = False if model.statement.surfaces_move else model.equations.structure.energy_kept
    return EnergyDrift(kept, first, float(energy[-1]), absolute, scale, against)


# --- momenta

MOST_COORDINATES = 12
"""Largest number of coordinates of a system whose conserved momenta are on the status card of a run. For a chain of 30
links the test for such momenta takes 0.3 s."""

SIZE_SAMPLES = 200  # Largest number of output times at which the sizes of terms are evaluated
MOST_LINES = 3  # Largest number of momenta on the status card and in the plot


def momentum_drifts(model: Model, t: FloatArray, y: FloatArray, parameters: Parameters) -> Mapping[str, FloatArray]:
    """Return the relative changes of the momenta of ignorable coordinates since the first time, (N,) each, by name.

    A change is relative to the largest magnitude of the momentum or of its terms M_ij v_j, since a momentum may be
    zero. States y are (2n, N), and times t (N,). Momenta of other symmetries are left out, because they would have to
    be searched for.
    """
    structure = model.equations.structure
    indices = list(structure.cyclic) if len(structure.names) <= MOST_COORDINATES else []
    if not indices or not len(t):
        return {}
    q, v = model.layout.split(y)
    with np.errstate(all="ignore"):
        momenta = np.asarray(model.momenta(q, v, t, parameters))[indices]
        some = np.unique(np.linspace(0, len(t) - 1, SIZE_SAMPLES).astype(int))
        kernel = model.interpreted("mass_matrix")
        mass = model.called(kernel, t[some], y[:, some], some_of(parameters, some))[indices]
        terms = np.abs(mass * v[:, some]).sum(axis=1).max(axis=1, keepdims=True)
        scale = np.maximum(np.abs(momenta).max(axis=1, keepdims=True), terms)
        drifts = np.divide(momenta - momenta[:, :1], scale, out=np.zeros_like(momenta), where=scale > 0)
    return {f"p_{structure.names[i]}": drift for i, drift in zip(indices, drifts, strict=True)}


def drift_lines(drifts: Mapping[str, FloatArray]) -> list[tuple[str, str]]:
    """Return lines (label, text) for the status card of a run: the largest drift of each momentum.

    At most `MOST_LINES` momenta are listed; a last line then says how many are omitted.
    """
    lines = [(f"{name} drift", f"{np.abs(drift).max():.1e} of its largest term") for name, drift in drifts.items()]
    left = len(lines) - MOST_LINES
    return lines[:MOST_LINES] + ([("other momenta", f"{left} in solution.invariants")] if left > 0 else [])
