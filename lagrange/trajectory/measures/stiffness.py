"""Stiffness of a run: steps of an explicit method that stability limited, not accuracy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from lagrange.errors import counted
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.trajectory.dense_output import OutputPath, SeriesPath, StepPath
from lagrange.trajectory.ending_messages import number
from lagrange.trajectory.tableaux.butcher import ButcherTableau
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

SAMPLED_STEPS = 20
"""Number of accepted steps that are examined, equally spaced. A run needs three times as many steps."""

MODE_GROWTH = 1e-5
"""Relative growth of a mode per step that defines the limit of stability. Over the 1e5 steps of a stiff run this growth
is a factor e. On the imaginary axis the limit depends much on this number. The amplification |R| of dopri5 exceeds 1
from |z| = 1.0 on, and 1.01 from 1.7 on. For tsit5, |R| exceeds 1 from 0.48 on, and 1 + 1e-5 from 0.75 on. The steps of
runs have |z| = 0.9 to 1.0 for dopri5, and 0.64 to 0.85 for tsit5."""

NEAR_LIMIT = 0.6
"""A step is at the limit of stability if its length exceeds this fraction of the limit. The library's scenes reach at
most 0.7, and only at rtol = 1e-3. The steps of stiff runs vary from about 0.7 to 1."""

MOST_OVERSHOOT = 1.5
"""Length of a step, as a multiple of the limit of stability, from which on the message on a stiff run says "beyond" the
limit and not "near" it. Steps with step control are shorter. Longer fixed steps are possible, but the run then fails.
"""

SLOWER = 30.0
"""Smallest factor by which the solution of a stiff run changes more slowly than the mode that limits the steps. With a
smaller factor the steps resolve the mode, as they have to."""

NEGLIGIBLE = 1e-4
"""Smallest scale to which changes of a velocity are relative, as a fraction of the speed of the whole system. Both are
weighted by the square roots of masses. The stiff spring of a pendulum moves so little that its velocity is only the
error that the tolerance allows."""

LET_THROUGH = 10.0
"""Change of a velocity over a step that may be an error within the tolerance, in units of rtol times the speed. An
undamped oscillation that the steps do not resolve grows to 1 to 7 of these units for dopri5 and tsit5."""

REMEDY = "radau5"
"""Recommended method for stiff runs."""

LIMITS = {
    Status.MAX_STEPS: "max_steps is used up",
    Status.MAX_WALL: "max_wall is used up",
    Status.MAX_MEMORY: "max_memory is used up",
    Status.STEP_TOO_SMALL: "the next step is below the spacing of floating-point times",
}
"""Statuses of runs that ended early and may be stiff, since too many steps or too short ones ended them, each with its
text for the message."""

Polynomial = tuple[float, ...]
"""Coefficients of a polynomial, lowest power first."""


@dataclass(frozen=True)
class Stiffness:
    """Medians over the steps of a stiff run that were at the limit of stability.

    `share` is the fraction of the examined steps at the limit. `rate` is the magnitude of the eigenvalue of the
    Jacobian that limits the step, per unit of time. `product` is `rate` times the step, and `limit` is the largest
    stable product in the direction of this eigenvalue. `slower` is the ratio of `rate` to the rate of change of the
    solution. `method` is the name of the method.
    """

    method: str
    share: float
    rate: float
    product: float
    limit: float
    slower: float

    def __repr__(self) -> str:
        return f"<Stiffness: {self.sentence()}>"

    def sentence(self) -> str:
        """Return a sentence with the numbers that show the stiffness, and with the method to use."""
        where = "near" if self.product < MOST_OVERSHOOT * self.limit else "beyond"
        return (
            f"stiff: at {self.share:.0%} of the examined steps, h * {self.rate:.2g} = {self.product:.2g} is {where} "
            f"the stability limit {self.limit:.2g} of {self.method}, while the solution changes {self.slower:.2g} "
            f"times more slowly; use {REMEDY}."
        )


def stiffness(model: Model, trajectory: Trajectory, parameters: Mapping[Any, Any]) -> Stiffness | None:
    """Return the stiffness of a run, or None if it is not stiff, too short, or by a method without a known limit.

    The stability limit is known for explicit Runge-Kutta methods and Taylor series. The Jacobian is evaluated at 20
    accepted steps, and only if the solution changes little over most of them.
    """
    path = trajectory.dense.path if isinstance(trajectory.dense, OutputPath) else trajectory.dense
    if isinstance(path, SeriesPath):
        polynomial = taylor_polynomial(path.order)
    elif isinstance(path, StepPath) and path.tableau is not None:
        polynomial = stability_polynomial(path.tableau)
    else:
        return None
    if len(path.times) <= 3 * SAMPLED_STEPS:
        return None
    steps = np.linspace(0, len(path.times) - 2, SAMPLED_STEPS + 2).astype(int)[1:-1]
    values = model.parameter_array(dict(parameters))
    h = path.times[steps + 1] - path.times[steps]
    with np.errstate(all="ignore"):
        try:
            masses = _kernel(model, "mass_matrix", path, steps, values)
            least = max(NEGLIGIBLE, SLOWER * LET_THROUGH * (trajectory.rtol or 0.0))
            changes = _changes(masses, path.states[:, model.layout.v], steps, least) / np.abs(h)
            longest = max(stability_limit(polynomial, angle) for angle in np.linspace(np.pi / 2, np.pi, 7))
            if np.mean(np.abs(h) * changes * SLOWER < 2 * longest) <= 0.5:
                return None
            jacobians = _kernel(model, "jacobian", path, steps, values)
        except SingularMassMatrix:
            return None
        return _found(trajectory.method, polynomial, h, changes, jacobians)


def with_stiff_end(model: Model, trajectory: Trajectory, parameters: Mapping[Any, Any], towards: float) -> Trajectory:
    """Return a run that ended early. If stiffness was the cause, its message says so.

    `towards` is the end of the time span. The steps of a stiff run may have become so short that the status reports a
    singularity, although the solution has none.
    """
    if trajectory.status not in LIMITS or (result := stiffness(model, trajectory, parameters)) is None:
        return trajectory
    begin, end = trajectory.span
    return replace(
        trajectory,
        message=f"{trajectory.method} stopped at t = {number(end)} on the way from {number(begin)} to "
        f"{number(towards)}, after {counted(trajectory.steps, 'step')}: {LIMITS[trajectory.status]}. The run is "
        f"{result.sentence()} {REMEDY} is an implicit method, whose steps stability does not limit.",
    )


def _kernel(model: Model, name: str, path: StepPath | SeriesPath, steps: FloatArray, values: FloatArray) -> FloatArray:
    """Return a matrix of the model, such as "jacobian", at the starts of k steps of a path, (k, rows, columns).

    `name` is the name of the matrix. `steps` (k,) are the indices of the steps, and `values` the parameters. The
    program is interpreted, because compiling takes longer.
    """
    states = path.states[steps].T
    kernel = model.interpreted(name)
    values_at = kernel.columns(path.times[steps], model.layout.split(states), values)
    return np.moveaxis(np.broadcast_to(values_at, (*values_at.shape[:2], len(steps))), -1, 0)


def _changes(masses: FloatArray, velocities: FloatArray, steps: FloatArray, least: float) -> FloatArray:
    """Return the largest relative change of a velocity over each of k steps, (k,).

    `steps` (k,) are the indices of the states before the steps, and `velocities` (S+1, n) the velocities in all
    accepted states. A change is relative to the largest value of the velocity along the run. If `least` times the speed
    of the system is larger, it is relative to that. `masses` (k, n, n) are the mass matrices at the k steps; their
    diagonals weight the velocities in the speed.
    """
    weights = np.abs(np.diagonal(masses, axis1=1, axis2=2)).mean(axis=0)
    speed = math.sqrt(float(np.mean(np.sum(velocities[steps] ** 2 * weights, axis=1))))
    ranges = np.maximum(np.abs(velocities).max(axis=0), least * speed / np.sqrt(weights))
    changes: FloatArray = np.max(np.abs(velocities[steps + 1] - velocities[steps]) / ranges, axis=1)
    return changes


def _found(
    method: str, polynomial: Polynomial, h: FloatArray, changes: FloatArray, jacobians: FloatArray
) -> Stiffness | None:
    """Return the `Stiffness` of a run from k sampled steps of signed lengths `h` (k,), or None if it is not stiff.

    `method` is the name of the method, and `polynomial` its stability polynomial. `changes` (k,) are the relative
    changes of the velocity per unit of time, and `jacobians` (k, 2n, 2n) the Jacobians at the starts of the steps.
    """
    at_limit = []
    for step, change, jacobian in zip(h, changes, jacobians, strict=True):
        # In a run backwards a mode that grows in time decays.
        eigenvalues = np.sign(step) * (np.linalg.eigvals(jacobian) if np.isfinite(jacobian).all() else np.zeros(1))
        sizes = np.abs(eigenvalues)
        # A growing mode belongs to the solution. Rounding moves oscillations away from the imaginary axis.
        decaying = (eigenvalues.real <= 1e-6 * sizes) & (sizes > 0)
        limits = np.array(
            [stability_limit(polynomial, abs(float(np.angle(eigenvalue)))) for eigenvalue in eigenvalues[decaying]]
        )
        near = abs(step) * sizes[decaying] / limits
        if near.size and near.max() > NEAR_LIMIT and sizes[decaying][near.argmax()] > SLOWER * change:
            rate = float(sizes[decaying][near.argmax()])
            at_limit.append((rate, abs(step) * rate, limits[near.argmax()], rate / max(change, 1e-12 * rate)))
    share = len(at_limit) / len(h)
    if share <= 0.5:
        return None
    return Stiffness(method, share, *map(float, np.median(at_limit, axis=0)))


@lru_cache(maxsize=64)
def stability_polynomial(tableau: ButcherTableau) -> Polynomial:
    """Return the coefficients 1, b.1, b.A.1, b.A^2.1, ... of the stability polynomial R(z) of a Runge-Kutta tableau.

    In b.A.1 the last factor is a vector of ones. A step of length h multiplies y by R(z) if y' = y z/h. Source: E.
    Hairer, G. Wanner, Solving ODE II, 2nd ed., 1996, IV.2, (2.7).
    """
    A = np.zeros((tableau.stages, tableau.stages))
    for i, row in enumerate(tableau.A):
        A[i, : len(row)] = [float(a) for a in row]
    b, power = np.array([float(w) for w in tableau.b]), np.ones(tableau.stages)
    coefficients = [1.0]
    for _ in range(tableau.stages):
        coefficients.append(float(b @ power))
        power = A @ power
    return tuple(coefficients)


def taylor_polynomial(order: int) -> Polynomial:
    """Return the stability polynomial of a Taylor step: the exponential series up to the power `order`."""
    return tuple(1 / math.factorial(k) for k in range(order + 1))


@lru_cache(maxsize=4096)
def _limit(polynomial: Polynomial, angle: float) -> float:
    def grows(r: FloatArray) -> FloatArray:
        return np.asarray(np.abs(np.polyval(polynomial[::-1], r * np.exp(1j * angle))) > 1 + MODE_GROWTH)

    # Beyond twice the degree |R| > 1 certainly: the last term exceeds the sum of all others.
    r = np.linspace(0, 4.0 * len(polynomial), 4001)
    first = int(grows(r).argmax())
    fine = np.linspace(r[first - 1], r[first], 101)
    return float(fine[grows(fine).argmax()])


def stability_limit(polynomial: Polynomial, angle: float) -> float:
    """Return the largest |z| up to which |R(z)| <= 1, for complex z of the argument `angle`.

    `polynomial` has the coefficients of the stability polynomial R. The angle is between pi/2, for an oscillation, and
    pi, for a decay.
    """
    # An angle within 5e-4 of the imaginary axis counts as on the axis: damping would hide the growth there.
    return _limit(polynomial, math.pi / 2 + round(angle - math.pi / 2, 3))
