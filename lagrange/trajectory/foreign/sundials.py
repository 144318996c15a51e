"""CVODE of the SUNDIALS suite as an integrator, driven step by step. It needs the package scikit-sundae."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property, partial
from numbers import Integral
from typing import Any, final

import numpy as np

from lagrange.errors import StatementError, shown
from lagrange.trajectory.dense_output import StepInterpolant
from lagrange.trajectory.foreign.driver import Fault, GuardedRhs, check_bounds, drive_stepwise
from lagrange.trajectory.integrator import Claims, Problem, Tolerances
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

ORDERS = {"BDF": 5, "Adams": 12}
"""Families of CVODE's formulas, with the highest order of each."""

LAST_STEP_SPACINGS = 4
"""A remaining time of at most this many spacings of floating-point times is one last step. Otherwise CVODE would
continue forever with t + h = t (LLNL/sundials#44), and print warnings from C."""

TINIEST = 1e-140
"""Time spans below this count as zero, because CVODE divides by squares of fractions of the span."""

_REACHED = 1
"""The code that CVODE returns from a step that reached the end of the run."""


@final
@dataclass(frozen=True)
class CVODE:
    """CVODE of SUNDIALS: backward differentiation of variable order up to 5, for stiff systems.

    `method` is 'BDF' or 'Adams', of order up to 12, for systems that are not stiff. `max_step` bounds the steps,
    `first_step` sets the first, both positive times, and `max_order` bounds the order. CVODE uses the model's compiled
    Jacobian. Between its steps the path is CVODE's own interpolant. It is read after each step at as many points as the
    highest order requires. That takes about as long as the step; a lower `max_order` reduces it.
    """

    method: str = "BDF"
    max_step: float = np.inf
    first_step: float | None = None
    max_order: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.method, str) or self.method not in ORDERS:
            raise StatementError(
                f"method = {shown(self.method)} is not a family of CVODE's formulas: give 'BDF' or 'Adams'."
            )
        check_bounds(self.name, self.max_step, self.first_step)
        highest = ORDERS[self.method]
        order = self.max_order
        whole = isinstance(order, Integral) and not isinstance(order, bool)
        if order is not None and not (whole and 1 <= order <= highest):
            raise StatementError(
                f"max_order = {shown(order)} is not an order of {self.method} formulas: give a whole number from 1 to "
                f"{highest}."
            )

    name = "cvode"

    @cached_property
    def claims(self) -> Claims:
        """The claimed properties of the method: the highest allowed order, step control, and events."""
        return Claims(order=self.max_order or ORDERS[self.method], adaptive=True, explicit=False, events=True)

    def integrate(self, problem: Problem) -> Trajectory:
        """Return the trajectory of the problem. Raises StatementError if scikit-sundae is not installed."""
        return drive_stepwise(problem, self.name, "CVODE", partial(_CvodeStepper, _solver(), self), nullcontext([]))


def _solver() -> Callable[..., Any]:
    try:
        from sksundae import cvode
    except ImportError as error:
        raise StatementError(
            f"method 'cvode' needs scikit-sundae, which is not installed ({error}): pip install scikit-sundae, or "
            "take scipy-bdf, which is of the same family."
        ) from error
    solver: Callable[..., Any] = cvode.CVODE
    return solver


class _CvodeStepper:
    """CVODE between two steps: implements `Stepper`.

    CVODE runs in the time s since its start, t = t0 + s, or t0 - s for a run backwards. So small first steps are not
    lost in the spacing of large times, and the package needs no first step backwards.
    """

    def __init__(
        self,
        solver: Callable[..., Any],
        options: CVODE,
        law: GuardedRhs,
        tolerances: Tolerances,
        floors: FloatArray,
        t: float,
        y: FloatArray,
        first: float,
    ) -> None:
        self.law = law
        self.t0, self.t1 = t, law.problem.t1
        self.sign = 1.0 if self.t1 > t else -1.0
        self.s, self.end = 0.0, abs(self.t1 - t)
        self.t, self.y = t, y
        self.reached = False
        self.rejected = 0
        self.trials: list[float] = []
        self.degree = options.claims.order
        first = min(first, float(options.first_step or np.inf))
        longest = min(float(options.max_step), tolerances.longest)
        self.cvode = solver(
            self.rhs,
            method=options.method,
            jacfn=self.jacobian,
            rtol=tolerances.rtol,
            atol=floors.copy(),
            max_step=0.0 if np.isinf(longest) else longest,
            first_step=0.0 if np.isinf(first) else min(first, self.end),
            max_order=options.claims.order,
        )
        self.cvode.init_step(self.s, self.y)
        self.begin = self.s

    def _time(self, s: float) -> float:
        return self.t0 + self.sign * s

    def rhs(self, s: float, y: FloatArray, slope: FloatArray) -> None:
        if not self.trials or s != self.trials[-1]:
            self.trials.append(s)
        slope[:] = self.sign * self.law.rhs(self._time(s), y)

    def jacobian(self, s: float, y: FloatArray, slope: FloatArray, matrix: FloatArray) -> None:
        matrix[:] = self.sign * self.law.jacobian(self._time(s), y)

    def advance(self, t: float, y: FloatArray) -> Fault | None:
        first, self.begin = self.s == 0, self.s
        self.rejected = 0
        self.trials.clear()
        if self.end < TINIEST:
            return Fault(Status.STEP_TOO_SMALL, t, y)
        with _unprinted():
            step = self.cvode.step(self.end, "onestep", self.end)
        if step.status < 0:
            return self.law.fault or Fault(Status.DIVERGED, t, y, detail=f"CVODE says: {step.message}")
        self.reached = step.status == _REACHED
        self.s, self.y = float(step.t), np.array(step.y, dtype=float)
        t_reached = self._time(self.s)
        self.t = self.t1 if self.reached or self.sign * (self.t1 - t_reached) < 0 else t_reached
        if not self.reached and not self.s - self.begin > LAST_STEP_SPACINGS * float(np.spacing(abs(self.begin))):
            return self.law.recent_fault() or Fault(Status.STEP_TOO_SMALL, t, y)
        if not first:
            # Before its first step CVODE evaluates the right-hand side to choose a step size. These are no trial steps.
            self.rejected = len(set(self.trials) - {self.begin}) - 1
        return None

    def interpolant(self, t: float, y: FloatArray) -> StepInterpolant:
        def interpolant(times: FloatArray) -> FloatArray:
            return np.array([self.cvode.step(s, "normal").y for s in times.tolist()]).T

        dense = StepInterpolant.read((t, self.t), (y, self.y), (self.begin, self.s), interpolant, self.degree)
        if not self.reached:
            # The next step starts from the time that was requested last.
            self.cvode.step(self.s, "normal")
        return dense


class _OtherThreads:
    """Substitute for sys.stdout that drops the output of the thread `silent` and passes on all other output.

    `silent` is the number of the thread, and `stream` the original sys.stdout. One object serves the whole process:
    Python's print keeps no reference to the sys.stdout to which it writes.
    """

    stream: Any = None
    silent = 0

    def write(self, text: str) -> int:
        return len(text) if threading.get_ident() == self.silent else int(self.stream.write(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


_OUT: Any = _OtherThreads()
_STEPPING = threading.RLock()
"""Lock that is held during a step whose printing is suppressed, because sys.stdout is replaced meanwhile."""


@contextmanager
def _unprinted() -> Iterator[None]:
    """Context that suppresses the output of scikit-sundae for a failing step: the run's message reports the failure."""
    with _STEPPING:
        if sys.stdout is None:
            yield
            return
        _OUT.stream, _OUT.silent = sys.stdout, threading.get_ident()
        sys.stdout = _OUT
        try:
            yield
        finally:
            sys.stdout, _OUT.silent = _OUT.stream, 0
