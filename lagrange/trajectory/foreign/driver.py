"""Loop over the steps of solvers of other packages, so that every run ends and every failure has a message."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from lagrange.algorithm.constants import FAR_FROM_ZERO, FIRST_SHARE, LEAST_FLOOR, MOST_SURVEYS
from lagrange.errors import StatementError, shown
from lagrange.machine.backend import SingularMassMatrix, nothing, one_state
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.statement.expression import real_number
from lagrange.trajectory.dense_output import PiecewisePath, SampledPath, StepInterpolant, StepInterpolants
from lagrange.trajectory.events.compiled_loop import WatchedEvents
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.integrator import Problem, Tolerances
from lagrange.trajectory.methods.tolerances import adaptive_settings
from lagrange.trajectory.plan import PreparedPlan
from lagrange.trajectory.run_loop import drive
from lagrange.trajectory.sizes import first_floors, noise_floors, slopes_of, some_rounded
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory


@dataclass(frozen=True, eq=False)
class Fault:
    """The status and time at which a run ends, with the data of the message.

    `y` is the state (2n,). `slope` is its derivative dy/dt if this is not finite, else None. `detail` is a further
    sentence on the cause, or "".
    """

    status: Status
    t: float
    y: FloatArray
    slope: FloatArray | None = None
    detail: str = ""


EVALUATIONS_PER_STEP = 5_000
"""A step with more evaluations of the right-hand side counts as an endless loop. The largest measured number is 136:
DOP853 started with a step 1e6 times too long before a right-hand side that is NaN."""


class StopError(Exception):
    """Exception raised inside a solver's callback to end the run, with the `fault` as its cause."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.detail)
        self.fault = fault


class GuardedRhs:
    """The model's right-hand side as a callback: it counts calls, checks the time limit, and records the last fault."""

    def __init__(self, problem: Problem, package: str, parameters: FloatArray, deadline: float) -> None:
        self.problem, self.package = problem, package
        self.parameters, self.deadline = parameters, deadline
        self.evaluations = 0
        self.fault: Fault | None = None
        self.last_fault: Fault | None = None
        self.fault_at = 0
        self.raised: Exception | None = None
        self.last_jacobian: FloatArray | None = None
        self._timed = deadline < math.inf
        self._kernel = problem.model.kernel("rhs")
        try:
            quick = self._kernel.quick(self.parameters)
        except SingularMassMatrix:
            quick = None
        self._quick: Callable[[float, FloatArray], FloatArray | None] = nothing if quick is None else quick.whole
        self._step_began, self._most = 0, EVALUATIONS_PER_STEP

    @property
    def in_step(self) -> int:
        """Number of evaluations of the right-hand side since the step began."""
        return self.evaluations - self._step_began

    def forget(self) -> None:
        """Discard the recorded faults, because a new motion begins, for example after a reset by an event."""
        self.last_fault = None
        self.begin_step()

    def begin_step(self) -> None:
        """Discard the fault of the last step, and restart the count of evaluations in a step."""
        self._step_began = self.evaluations
        self._most = self._step_began + EVALUATIONS_PER_STEP
        self.fault = None

    def rhs(self, t: float, y: FloatArray) -> FloatArray:
        """Return dy/dt, (2n,), or NaN if the model raises an error, so that the solver tries a shorter step."""
        self.evaluations = count = self.evaluations + 1
        if count > self._most or self._timed:
            self._check_limits(t, y)
        slope = self._quick(t, y)
        return self._slope(t, y) if slope is None else slope

    def _check_limits(self, t: float, y: FloatArray) -> None:
        """Raise StopError if the time limit is reached, or if a step needs too many evaluations."""
        if time.perf_counter() > self.deadline:
            raise StopError(Fault(Status.MAX_WALL, t, y.copy()))
        if self.evaluations > self._most:
            detail = f"{self.package}'s solver made {EVALUATIONS_PER_STEP} evaluations inside one step."
            raise StopError(self.fault or Fault(Status.DIVERGED, t, y.copy(), detail=detail))

    def _slope(self, t: float, y: FloatArray) -> FloatArray:
        """Return dy/dt, and record a fault if it is not finite."""
        try:
            slope = self._kernel(t, y, self.parameters)
        except SingularMassMatrix:
            self._refused(t, y)
            return np.full(y.shape, np.nan)
        except Exception as error:
            self.raised = error
            raise
        if not np.isfinite(slope).all():
            self._remember(Fault(Status.NON_FINITE, t, y.copy(), slope))
        return slope

    def jacobian(self, t: float, y: FloatArray) -> FloatArray:
        """Return the Jacobian of the right-hand side by the state, (2n, 2n), at (t, y).

        If it is not finite, return the last finite one, so that Newton's method continues.
        """
        try:
            jacobian = one_state(self.problem.model.kernel("jacobian"), self.parameters)(float(t), y)
        except SingularMassMatrix:
            self._refused(t, y)
        except Exception as error:
            self.raised = error
            raise
        else:
            if np.isfinite(jacobian).all():
                self.last_jacobian = jacobian
            elif self.fault is None:
                self._remember(Fault(Status.NON_FINITE, t, y.copy(), detail="Its derivative there is not finite."))
        if self.last_jacobian is None:
            raise StopError(self.fault or Fault(Status.NON_FINITE, t, y.copy()))
        return self.last_jacobian

    def _refused(self, t: float, y: FloatArray) -> None:
        if np.isfinite(y).all():
            detail = self.problem.model.singular_message(t, y, None, self.problem.parameter_array)
            self._remember(Fault(Status.SINGULAR, t, y.copy(), detail=detail))
        else:
            self._remember(Fault(Status.NON_FINITE, t, y.copy()))

    def _remember(self, fault: Fault) -> None:
        """Record a fault, for the message if the run ends.

        A fault at a state that is not finite is ignored if the step already has a fault, which is then its cause.
        """
        if self.fault is None or np.isfinite(fault.y).all():
            self.fault = self.last_fault = fault
            self.fault_at = self.evaluations

    def recent_fault(self) -> Fault | None:
        """Return the last fault, the probable cause of no progress, if it is at most 100 evaluations old."""
        return self.last_fault if self.evaluations - self.fault_at <= 100 else None


S = DriverState

FIRST_STEP_SPACINGS = 64
"""Shortest first step of a solver, in spacings of floating-point times. SciPy's solvers fail below ten spacings."""

MOST_UNMOVED = 20
"""Largest number of successive steps that do not change the time. LSODA begins with two at t = 1e9."""

INTERPOLANT_BYTES = 300
"""Measured size in bytes of the object for the dense output of one step, without its numbers. It is for the limit of
memory."""

UNREAD_BYTES, UNREAD_ENTRIES = 1400, 10
"""Size of the dense output of one step that is still SciPy's object, for the limit of memory: a number of bytes, and a
number of doubles for each entry of the state. The measured size is 1,310 to 1,540 bytes with 2 entries of the state,
and up to 2,850 with 20."""

_ACCEPTED = np.zeros(S.SURVEYED + 1, dtype=np.int64)
_ACCEPTED[[S.ROWS, S.STEPS]] = 1
"""Increments of a driver's counts for an accepted step, added in one operation, which Ctrl-C cannot divide."""

Unread = partial[StepInterpolant]
"""A function that makes the dense output of one step when it is needed, from the solver's own object."""


class Stepper(Protocol):
    """Protocol of a solver of another package that takes one step at each call."""

    @property
    def t(self) -> float:
        """The time that the solver has reached."""

    @property
    def y(self) -> FloatArray:
        """The state (2n,) at the time `t` that the solver has reached, in an array that the solver does not change."""

    @property
    def rejected(self) -> int:
        """Number of rejected trials of the last step, or 0 if it is not known."""

    def advance(self, t: float, y: FloatArray) -> Fault | None:
        """Take one step from the accepted state (t, y). Return the fault if it fails, else None."""

    def interpolant(self, t: float, y: FloatArray) -> StepInterpolant | Unread:
        """Return the path over the last step, which began at (t, y), or a function that makes it when needed."""


StartSolver = Callable[[GuardedRhs, Tolerances, FloatArray, float, FloatArray, float], Stepper]
"""Constructor of a solver, from absolute tolerances (2n,), a time, a state, and a bound of the first step. The solver
runs to the end of the problem of the right-hand side. If the bound is infinite, the solver chooses the first step. The
tolerances may be raised in place during the run."""


def check_bounds(name: str, max_step: float, first_step: float | None) -> None:
    """Raise StatementError if `max_step` or `first_step` of the method `name` is not a positive time."""
    for option, value in (("max_step", max_step), ("first_step", first_step)):
        if value is None and option == "first_step":
            continue
        size = value if isinstance(value, float) else real_number(value, option)
        if not size > 0 or (option == "first_step" and size == np.inf):
            raise StatementError(f"{option} = {shown(value)}, the length of a step of {name}: give a positive time.")


def drive_stepwise(
    problem: Problem,
    name: str,
    package: str,
    start: StartSolver,
    listening: AbstractContextManager[Sequence[Any]],
    first: int = 0,
) -> Trajectory:
    """Return the trajectory of a problem, run step by step by the solvers that `start` makes.

    `name` is the method's name, and `package` the package of the solver. `listening` is a context that collects
    warnings of the package; the last one explains a divergence. The error of the first step h grows with h**`first`,
    from which h is chosen. `first` is 0 if the solver chooses h well.
    """
    tolerances = adaptive_settings(name, problem, None, None, None)
    with np.errstate(all="ignore"), listening as messages:
        plan = SolverPlan(problem, tolerances, package, start, messages, first)
        return drive(problem, name, lambda: PreparedPlan(plan))


@dataclass(eq=False)
class SolverPlan:
    """The plan of one run by solvers of another package: tolerances, driver, and dense output. Implements `Plan`.

    `start` makes a solver. `messages` are the messages of the package so far, and `interpolants` the paths over steps.
    """

    problem: Problem
    tolerances: Tolerances
    package: str
    start: StartSolver
    messages: Sequence[Any]
    writes_outputs = False
    first: int = 0
    """Power p of the first step h, whose error grows as h**p. It is 0 if the solver chooses h well."""
    form: str = ""
    watched: bool = False
    interpolants: list[StepInterpolant | Unread] = field(default_factory=list)
    """Dense output of each accepted step. There may be further entries, of steps that were discarded."""

    def driver(self, model: Model, parameters: FloatArray) -> SolverDriver:
        """Return a driver of the solver, and start the time limit of the run."""
        limit = self.problem.max_wall
        deadline = np.inf if limit is None else time.perf_counter() + limit
        return SolverDriver(self, GuardedRhs(self.problem, self.package, parameters, deadline))

    def watch(self, problem: Problem, driver: SolverDriver, memory: WatchedEvents | None = None) -> StepWatch | None:
        """Return the watcher, which searches the steps of the run for events, or None if the problem has no events.

        `memory` is the memory of the watcher in a former run, which is used again, or None.
        """
        return StepWatch(problem, self._latest, fixed=False, memory=memory) if problem.events else None

    def _latest(self, times: FloatArray, states: FloatArray) -> SampledPath:
        """Return the path over the most recent steps, with accepted times (S+1,) and states (S+1, 2n)."""
        return SampledPath(times, states, StepInterpolants(self.interpolants, len(self.interpolants) - len(times) + 1))

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: StepWatch | None) -> PiecewisePath:
        """Return the dense output of the run, made of the solver's own paths over the steps, with jumps at resets."""
        jumps = set() if watch is None else set(watch.breaks.since(0)[0].tolist())
        steps = iter(self.interpolants)
        # At a reset, which takes no time, the path is constant.
        interpolants = [
            StepInterpolant(times[i], 1.0, states[[i + 1, i + 1]]) if i in jumps else next(steps)
            for i in range(len(times) - 1)
        ]
        return PiecewisePath(times, states[0], StepInterpolants(interpolants))


class SolverDriver:
    """Advances a run by a solver, and restarts it after resets and switches of the motion: implements `Driver`."""

    def __init__(self, plan: SolverPlan, law: GuardedRhs) -> None:
        self._plan, self._law = plan, law
        self._solver: Stepper | None = None
        self._unmoved = 0
        self._begun = 0
        self._asked: FloatArray = np.empty(0)
        self._vanished: Fault | None = None
        """Fault after which the solver requested a new estimate of sizes. It ends the run if the estimate
        changes no tolerance."""

    def adopt(self, state: DriverState) -> None:
        """Do nothing. Only a driver by Taylor series replaces the array `state.y` by its own."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Take up to `budget` trial steps, write the accepted states, and return how the call ended.

        Times are written to `times` (c,), and states to `rows` (c, 2n), where c is the capacity.
        """
        law, plan = self._law, self._plan
        try:
            fault = self._advance(state, budget, times, rows)
        except StopError as stopped:
            fault = stopped.fault
            if fault.status is Status.MAX_WALL:
                fault = Fault(fault.status, state.t, state.y.copy())
        finally:
            state.counts[S.EVALUATIONS] = law.evaluations
        if fault is not None and fault.status is Status.DIVERGED and plan.messages:
            fault = replace(fault, detail=f"{plan.package} says: {plan.messages[-1].message}")
        state.fault = fault
        if fault is not None:
            return Outcome.UNSCALED if self._needs_sizes(state, fault) else Outcome.BROKEN
        return Outcome.DONE if state.t == state.reals[S.END] else Outcome.PAUSED

    def _advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Fault | None:
        if state.t == state.reals[S.END]:
            return None
        fault, self._vanished = self._vanished, None
        if fault is not None and np.array_equal(state.floors, self._asked):
            return fault
        solver = self._solver
        if solver is None or not state.count(S.KEPT):
            state.counts[S.KEPT] = 1
            solver = self._begin(state)
            if solver is None:
                return self._law.fault
        left, floats, end = budget, state.floats, state.floats[S.END]
        while left > 0 and floats[S.T] != end:
            fault = self._step(solver, state, times, rows)
            if fault is not None:
                return fault
            left -= 1 + solver.rejected
        return None

    def _begin(self, state: DriverState) -> Stepper | None:
        """Return a new solver that starts at the driver's state, or None if the right-hand side has a fault there."""
        law, t, y, steps = self._law, state.t, state.y.copy(), state.count(S.STEPS)
        # Use the requested first step: a longer one would pass over a short flight between two contacts.
        requested = abs(float(state.reals[S.H]))
        first = requested if requested and steps == self._begun + 1 else np.inf
        del self._plan.interpolants[steps:]
        self._begun, self._unmoved = steps, 0
        law.forget()
        law.rhs(t, y)
        if law.fault is not None:
            return None
        first = min(first, self._scale(state, t, y))
        self._solver = self._plan.start(law, self._plan.tolerances, state.floors, t, y, first)
        return self._solver if law.fault is None else None

    def _needs_sizes(self, state: DriverState, fault: Fault) -> bool:
        """Return True if steps became too small because an entry has no known size, so that floors must be raised.

        A floor is the least absolute tolerance of an entry. An entry that has only been rounding so far has no known
        size. If the last estimate of sizes changed no floor, the steps are small for another reason. `fault` is the
        failed step's fault.
        """
        vanished = fault.status is Status.STEP_TOO_SMALL and state.reals[S.SHARE] > 0
        if not vanished or state.count(S.SURVEYED) >= MOST_SURVEYS or np.array_equal(state.floors, self._asked):
            return False
        self._solver, self._asked, self._vanished = None, state.floors.copy(), fault
        return True

    def _scale(self, state: DriverState, t: float, y: FloatArray) -> float:
        """Set the absolute tolerances by the sizes of entries at the start (t, y). Return a bound of the first step.

        The bound follows from the natural period of the system, since a solver's own choice would depend on the
        absolute time. It is infinity if the solver chooses the step.
        """
        plan, law = self._plan, self._law
        has_floors = (state.floors > LEAST_FLOOR).any() and plan.problem.largest is None
        if not plan.tolerances.share or has_floors:
            return np.inf
        model, left = plan.problem.model, float(state.reals[S.END]) - t
        slopes = slopes_of(model, law.parameters)

        def counted(t: float, y: FloatArray) -> FloatArray:
            law.evaluations += 1
            return slopes(t, y)

        floors, period = first_floors(counted, model.layout, t, y, left, plan.tolerances.share)
        state.floors[:] = np.maximum(state.floors, floors)
        if some_rounded(model.layout, state.floors):
            state.floors[:] = np.maximum(state.floors, noise_floors(model, law.parameters, t, y, left))
        if not plan.first:
            return np.inf
        first = float((FIRST_SHARE * plan.tolerances.rtol) ** (1 / plan.first)) * period
        if first < FAR_FROM_ZERO * abs(t):
            # SciPy treats a step as changed if rounding of the times changes its length.
            spacing = float(np.spacing(abs(t)))
            first = spacing * 2.0 ** math.ceil(math.log2(max(first / spacing, FIRST_STEP_SPACINGS)))
        return first

    def _step(self, solver: Stepper, state: DriverState, times: FloatArray, rows: FloatArray) -> Fault | None:
        """Take one step by `solver`. Record the step if its end and its interpolant are valid, else return the fault.

        A valid step is counted in `state`, and written to the arrays `times` and `rows` of accepted states.
        """
        law, begin, before = self._law, state.floats[S.T], state.y.copy()
        law.begin_step()
        fault = solver.advance(begin, before)
        if solver.rejected:
            state.integers[S.REJECTED] += solver.rejected
        if fault is not None:
            return fault
        t, y = solver.t, solver.y
        if t == begin:
            # LSODA may begin with some steps that do not change a large time, or continue like that forever.
            self._unmoved += 1
            stuck = self._unmoved > MOST_UNMOVED
            return law.recent_fault() or (Fault(Status.STEP_TOO_SMALL, t, y) if stuck else None)
        self._unmoved = 0
        if not (math.isfinite(y.dot(y)) or np.isfinite(y).all()):
            return law.fault or Fault(Status.NON_FINITE, t, y)
        if law.fault is not None:
            # A trial of this step left the domain of the equations. The step is accepted if its end is inside.
            law.fault = None
            law.rhs(t, y)
        path = solver.interpolant(begin, before)
        if law.fault is None:
            self._keep(state, t, y, path, times, rows)
        return law.fault

    def _keep(
        self,
        state: DriverState,
        t: float,
        y: FloatArray,
        path: StepInterpolant | Unread,
        times: FloatArray,
        rows: FloatArray,
    ) -> None:
        """Record the step to y (2n,) at time t with its `path`, in the arrays `times` and `rows` of accepted states.

        The last statement alone counts the step, so an interruption never leaves a partly recorded step.
        """
        row, floats = state.integers[S.ROWS], state.floats
        self._plan.interpolants.append(path)
        if isinstance(path, StepInterpolant):
            state.kept += INTERPOLANT_BYTES + path.values.nbytes
        else:
            state.kept += UNREAD_BYTES + UNREAD_ENTRIES * y.nbytes
        times[row] = t
        rows[row] = y
        floats[S.T] = t
        state.y[:] = y
        if floats[S.SHARE]:
            np.maximum(state.floors, floats[S.SHARE] * abs(y), out=state.floors)
        state.counts += _ACCEPTED
