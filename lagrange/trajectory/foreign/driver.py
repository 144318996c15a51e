"""Solvers of other packages, driven step by step, so that every run ends and every failure has a message."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from lagrange.algorithm.step.constants import FAR_FROM_ZERO, FIRST_SHARE, LEAST_FLOOR, MOST_SURVEYS
from lagrange.errors import StatementError, shown
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.statement.expression import real_number
from lagrange.trajectory.events.event_loop import WatchedEvents
from lagrange.trajectory.events.step_watch import StepWatch
from lagrange.trajectory.foreign.guarded_rhs import Fault, GuardedRhs, StopError
from lagrange.trajectory.integrator import Problem, Tolerances
from lagrange.trajectory.methods.tolerances import adaptive_settings
from lagrange.trajectory.paths.known import PiecewisePath
from lagrange.trajectory.paths.sampled import SampledPath, StepInterpolant, StepInterpolants
from lagrange.trajectory.run_loop import drive
from lagrange.trajectory.sizes import first_floors, noise_floors, slopes_of, some_rounded
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

S = DriverState

FIRST_STEP_SPACINGS = 64
"""Shortest first step, in spacings of floating-point times. SciPy fails below ten."""

MOST_UNMOVED = 20
"""Largest number of successive steps that do not change the time. LSODA begins with two at t = 1e9."""

INTERPOLANT_BYTES = 300
"""Measured size of the path over a step in bytes, without its values."""

UNREAD_BYTES, UNREAD_ENTRIES = 1400, 10
"""Size of a path that is still SciPy's object: bytes, and further numbers for each entry of the state. It takes 1,310
to 1,540 bytes with 2 entries, and up to 2,850 with 20.
"""

_ACCEPTED = np.zeros(S.SURVEYED + 1, dtype=np.int64)
_ACCEPTED[[S.ROWS, S.STEPS]] = 1
"""Increments of the counts for an accepted step, added in one operation: an interruption never finds a part of them."""


Unread = partial[StepInterpolant]
"""A function that reads the path over a step when it is first called."""


class Stepper(Protocol):
    """Protocol of a solver of another package, between two of its steps."""

    @property
    def t(self) -> float:
        """The time that the solver has reached."""

    @property
    def y(self) -> FloatArray:
        """The state (2n,) at the time `t` that the solver has reached, in an array that the solver does not change."""

    @property
    def rejected(self) -> int:
        """Number of rejected trials of the last step; 0 if it is not known."""

    def advance(self, t: float, y: FloatArray) -> Fault | None:
        """Take one step from the accepted state (t, y). Return the fault if it fails, else None."""

    def interpolant(self, t: float, y: FloatArray) -> StepInterpolant | Unread:
        """Return the path over the last step, which began at (t, y), or a function that makes it when needed."""


StartSolver = Callable[[GuardedRhs, Tolerances, FloatArray, float, FloatArray, float], Stepper]
"""Constructor of a solver, from absolute tolerances (2n,), a time, a state, and a bound of the first step. The solver
runs to the end of the law's problem. If the bound is infinite, it chooses the first step. The tolerances may be raised
in place during the run.
"""


def check_bounds(name: str, max_step: float, first_step: float | None) -> None:
    """Raise StatementError for bounds of steps that are not positive times."""
    for option, value in (("max_step", max_step), ("first_step", first_step)):
        if value is None and option == "first_step":
            continue
        size = value if isinstance(value, float) else real_number(value, option)
        if not size > 0 or (option == "first_step" and size == np.inf):
            raise StatementError(f"{option} = {shown(value)} cannot bound a step of {name}: give a positive time.")


def drive_stepwise(
    problem: Problem,
    name: str,
    package: str,
    start: StartSolver,
    listening: AbstractContextManager[Sequence[Any]],
    first: int = 0,
) -> Trajectory:
    """Return the trajectory of a problem, run step by step by the solvers that `start` makes.

    `name` is the method's name, and `package` the package of the solver. The error of a first step h grows like
    h**`first`; `first` = 0 means that the solver chooses the first step well. `listening` is a context that collects
    warnings and messages of the package; the last message explains a divergence.
    """
    tolerances = adaptive_settings(name, problem, None, None, None)
    with np.errstate(all="ignore"), listening as messages:
        return drive(problem, SolverPlan(problem, tolerances, package, start, messages, first), name)


@dataclass(eq=False)
class SolverPlan:
    """The plan of one run by solvers of another package: tolerances, driver, and dense output. Implements `Plan`.

    `start` makes a solver. `messages` are the messages of the package, and `interpolants` the paths over the steps.
    """

    problem: Problem
    tolerances: Tolerances
    package: str
    start: StartSolver
    messages: Sequence[Any]
    writes_outputs = False
    first: int = 0
    """Power of the first step with which its error grows, or 0 if the solver chooses that step well."""
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
        """Return the object that searches the steps of the run for events, or None if the problem has no events."""
        return StepWatch(problem, driver, self._latest, fixed=False, memory=memory) if problem.events else None

    def _latest(self, times: FloatArray, states: FloatArray) -> SampledPath:
        """Return the path over the most recent steps, with accepted times (S+1,) and states (S+1, 2n)."""
        return SampledPath(times, states, StepInterpolants(self.interpolants, len(self.interpolants) - len(times) + 1))

    def path(self, problem: Problem, times: FloatArray, states: FloatArray, watch: StepWatch | None) -> PiecewisePath:
        """Return the dense output of the run, made of the solver's own paths over the steps, with jumps at resets.

        `times` (S+1,) and `states` (S+1, 2n) are the accepted states. `watch` has the resets, or is None without
        events.
        """
        jumps = set() if watch is None else set(watch.breaks.since(0)[0].tolist())
        steps = iter(self.interpolants)
        interpolants = [_Standing(states[i + 1]) if i in jumps else next(steps) for i in range(len(times) - 1)]
        return PiecewisePath(times, states[0], StepInterpolants(interpolants))

    def failed(self, problem: Problem, state: DriverState) -> FloatArray:
        """Return the last accepted state (2n,) of a failed run. The fault is stored in the `GuardedRhs`."""
        return state.y


@dataclass(frozen=True, eq=False)
class _Standing:
    """Constant interpolant for an interval of no duration, at a reset."""

    y: FloatArray

    def __call__(self, times: FloatArray) -> FloatArray:
        return np.repeat(self.y[:, None], len(times), axis=1)


class SolverDriver:
    """Advances a run by a solver, and restarts it after resets and switches of the motion: implements `Driver`."""

    def __init__(self, plan: SolverPlan, law: GuardedRhs) -> None:
        self._plan, self._law = plan, law
        self._solver: Stepper | None = None
        self._unmoved = 0
        self._begun = 0
        self._asked: FloatArray = np.empty(0)
        self._vanished: Fault | None = None
        """Fault for which the solver requested a survey of sizes. It ends the run if the survey changes nothing."""

    def adopt(self, state: DriverState) -> None:
        """Do nothing: the driver state has its own memory."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Take up to `budget` trial steps, write the accepted states, and return how the call ended.

        The accepted times and states are written to `times` and to the rows (2n,) of `rows`.
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
            return Outcome.UNSCALED if self._asks(state, fault) else Outcome.BROKEN
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
        # Otherwise flights between contacts that are shorter than the solver's first step would get its length.
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

    def _asks(self, state: DriverState, fault: Fault) -> bool:
        """Return True if steps became too small because an entry has no known size, so that floors must be raised.

        The floors are the absolute tolerances of the entries. An entry of the state that has only been rounding so
        far has no known size. If the last estimate of sizes changed no floor, the steps are small for another reason.
        """
        vanished = fault.status is Status.STEP_TOO_SMALL and state.reals[S.SHARE] > 0
        if not vanished or state.count(S.SURVEYED) >= MOST_SURVEYS or np.array_equal(state.floors, self._asked):
            return False
        self._solver, self._asked, self._vanished = None, state.floors.copy(), fault
        return True

    def _scale(self, state: DriverState, t: float, y: FloatArray) -> float:
        """Set the absolute tolerances by the sizes of entries at the start (t, y). Return a bound of the first step.

        It is infinity if the solver chooses the step. A solver's own choice depends on the absolute time, while this
        bound follows from the natural period of the system.
        """
        plan, law = self._plan, self._law
        has_floors = (state.floors > LEAST_FLOOR).any() and plan.problem.largest is None
        if not plan.tolerances.share or has_floors:
            return np.inf
        model, left = plan.problem.model, float(state.reals[S.END]) - t
        counted = law.counted(slopes_of(model, law.parameters))
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
        """Take one step and record it if the step, its end and its interpolant are valid; else return the fault."""
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
            # A trial of this step left the domain of the law; the step is accepted if its end did not.
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

        The step is counted by the last statement alone, so an interruption never leaves a partly recorded step.
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
