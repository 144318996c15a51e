"""Tolerances and step sizes of a run: checks of the user's values, default fixed step, longest adaptive step.

The default relative tolerance is in `statement/run_settings.py`, the default absolute one (`FLOOR_SHARE`) in
`trajectory/integrator.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from lagrange.algorithm.constants import LEAST_FLOOR
from lagrange.errors import StatementError, listing, shown
from lagrange.machine.model import Model
from lagrange.statement.expression import positive_number, real_number
from lagrange.statement.run_settings import DEFAULT_RTOL
from lagrange.trajectory.integrator import FLOOR_SHARE, LEAST_ATOL, LEAST_SHARE, Problem, Tolerances

FIXED_STEPS = 1000
"""Number of fixed steps of a run if no step is stated. The status card reports this number."""

STEPS_UNDER_BRIEF_FORCE = 1000
"""Smallest number of adaptive steps of a run if a force may act for a short time (`Structure.brief`). Longer steps of a
system at rest would pass over such a force without an error."""

LEAST_RTOL = 100 * 2.0**-52
"""Smallest relative tolerance of an adaptive method. The rounding errors of a step would exceed a smaller one."""


def check_options(step: Any = None, rtol: Any = None, atol: Any = None) -> None:
    """Raise StatementError for a step size or tolerance of a method that no run could use. None is not checked."""
    for what, value in (("step", step), ("rtol", rtol), ("atol", atol)):
        if value is not None:
            _number(what, value)


def adaptive_settings(
    name: str,
    problem: Problem,
    step: float | None,
    rtol: float | None,
    atol: float | None,
    *,
    least: float = LEAST_RTOL,
    margin: Callable[[float], float] = lambda rtol: 1.0,
) -> Tolerances:
    """Return the tolerances of an adaptive method: the tolerances of the run, else of the method, else the defaults.

    `name` is the method's name. `step`, `rtol` and `atol` are the method's own options, None if not given; a step is
    refused. If the run and the method both state a tolerance, the two must be equal. The default absolute tolerance of
    an entry is a fraction of its size, by `FLOOR_SHARE`. `least` is the smallest relative tolerance that the method can
    use. `margin` maps rtol to the factor by which the driver multiplies the tolerances.
    """
    check_problem(name, problem)
    if problem.step is not None or step is not None:
        raise StatementError(
            f"{name} chooses its steps by itself: give rtol and atol, or a fixed-step method such as rk4."
        )
    requested, absolute = _option(name, "rtol", problem.rtol, rtol), _option(name, "atol", problem.atol, atol)
    relative = DEFAULT_RTOL if requested is None else requested
    notes: tuple[str, ...] = ()
    if relative < least:
        notes = (f"rtol = {relative:g} is below round-off and was raised to {least:.3g}.",)
    span = abs(problem.t1 - problem.t0)
    longest = span / STEPS_UNDER_BRIEF_FORCE if problem.model.equations.structure.brief and span else math.inf
    relative = max(relative, least)
    share = max(FLOOR_SHARE * relative, LEAST_SHARE) if absolute is None else 0.0
    begins = LEAST_FLOOR if absolute is None else max(absolute, LEAST_ATOL)
    return Tolerances(relative, begins, share, longest=longest, margin=margin(relative), notes=notes)


def fixed_settings(
    name: str, problem: Problem, step: float | None, rtol: float | None, atol: float | None
) -> Tolerances:
    """Return the step of a fixed-step method: the step of the run, else of the method, else a thousandth of the span.

    `name` is the method's name. `step`, `rtol` and `atol` are the method's own options or None; tolerances are refused.
    """
    check_problem(name, problem)
    if problem.rtol is not None or problem.atol is not None or rtol is not None or atol is not None:
        raise StatementError(
            f"{name} takes fixed steps and cannot aim at a tolerance: give step= in place of rtol and atol, or an "
            "adaptive method such as dop853."
        )
    span = abs(problem.t1 - problem.t0)
    size = _option(name, "step", problem.step, step)
    if size is None:
        note = f"No step was given: {FIXED_STEPS} fixed steps of {span / FIXED_STEPS:.6g} were taken."
        return Tolerances(step=span / FIXED_STEPS, notes=(note,))
    if span / size > 1e15 or problem.t0 + size == problem.t0:
        raise StatementError(
            f"step = {size:g} is below the spacing of floating-point times near t = {problem.t0:g}: give a longer step."
        )
    return Tolerances(step=size)


def check_problem(name: str, problem: Problem) -> None:
    """Raise StatementError if `problem`, the argument of method `name`, is not a `Problem`."""
    if not isinstance(problem, Problem):
        raise StatementError(f"{name} cannot run {shown(problem)}: give an lg.Problem, or call lg.integrate().")


def check_holonomic(name: str, model: Model) -> None:
    """Raise StatementError if a model has constraints stated in velocities, or coordinates without inertia.

    The method `name` supports neither.
    """
    equations = model.equations
    constraints = equations.stated
    stated = [repr(label) for label, phi in zip(constraints.names, constraints.positions, strict=True) if phi is None]
    if stated:
        many = "are" if len(stated) > 1 else "is"
        raise StatementError(
            f"{name} is for constraints on coordinates, and {listing(stated)} {many} stated in velocities: take "
            "radau5-index2, taylor or dop853, or state the constraint in coordinates, if it is the rate of one."
        )
    if equations.first_order:
        names = listing([model.statement.names[i] for i in equations.first_order])
        raise StatementError(
            f"{name} finds velocities from momenta, and the Lagrangian has no term of second order in the velocities "
            f"of {names}: take radau5-index2, taylor or dop853."
        )


def check_unconstrained(name: str, model: Model) -> None:
    """Raise StatementError if a model has constraints, or coordinates without inertia.

    The method `name` supports neither.
    """
    if model.equations.first_order:
        raise StatementError(
            f"{name} finds velocities from momenta, and {model.statement.name} has coordinates without "
            "inertia, whose equations are of first order. Use taylor, dop853 or radau5."
        )
    if names := model.equations.constraints.names:
        raise StatementError(
            f"{name} leaves out the forces of constraints, and {model.statement.name} has constraints "
            f"({listing(list(map(repr, names)))}): use rattle, which has these forces and is symplectic, or taylor or "
            "dop853."
        )


def _option(name: str, what: str, run_value: Any, method_value: Any) -> float | None:
    """Return the value of the option `what`, "step", "rtol" or "atol", that the run or the method `name` states.

    The result is None if neither states it. Raises StatementError if they state different values.
    """
    both = [_number(what, value) for value in (run_value, method_value) if value is not None]
    if len(both) == 2 and both[0] != both[1]:
        raise StatementError(
            f"{what} is given twice, {both[0]:g} for the run and {both[1]:g} for {name} itself: leave one of them out."
        )
    return both[0] if both else None


def _number(what: str, value: Any) -> float:
    """Return the user's value of the option `what`, "step", "rtol" or "atol", as a float.

    Raises StatementError for a value that is not a number in the range of this option.
    """
    if what == "step":
        return positive_number(value, "step", "give a positive size; the direction follows from the time span")
    if type(value) is float and 0 < value < 1:
        return value
    single = isinstance(value, (str, bytes)) or (isinstance(value, np.ndarray) and value.ndim == 0)
    if isinstance(value, Collection) and not single:
        raise StatementError(
            f"{what} is {shown(value)}: give one number, which holds for all entries of the state. Choose units in "
            "which these entries are of similar size."
        )
    if isinstance(value, (float, np.floating)) and not math.isfinite(value):
        raise StatementError(f"{what} = {value}: give a finite tolerance that is not negative.")
    number = real_number(value, what)
    if math.copysign(1.0, number) < 0:
        raise StatementError(f"{what} = {number:g}: give a finite tolerance that is not negative.")
    if what == "rtol" and number >= 1:
        raise StatementError(
            f"rtol = {number:g} allows errors as large as the state itself: give a smaller number, such as "
            f"{DEFAULT_RTOL:g}."
        )
    return number
