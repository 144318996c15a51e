"""Steps in plain Python: the procedures that machine code runs, printed as Python source."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.python_source import loaded
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.step.equal_steps import begin, equal_steps
from lagrange.procedure.step.memory import EFFORT, NEWTON, Kept, Layout, kept
from lagrange.procedure.step.run import COUNTS, RUN
from lagrange.procedure.step.trial import accept_step, try_step
from lagrange.program.step import StepProgram

Evaluate = Callable[[float, FloatArray], FloatArray]
"""A law or its derivative, with its parameters. Raises SingularMassMatrix."""

NOTHING = memoryview(array("d"))
"""The place of an array that is not used."""


class _Source(NamedTuple):
    """The procedures of a step as Python functions, and where they keep what; `run` takes steps without control."""

    layout: Layout
    begin: Callable[..., None]
    run: Callable[..., int]
    attempt: Callable[..., int]
    accept: Callable[..., None]


@lru_cache(maxsize=64)
def _source(step: StepProgram, dimension: int) -> _Source:
    layout = Layout(step, dimension, block=1)
    made = begin(layout), equal_steps(layout), try_step(layout), accept_step(layout)
    return _Source(layout, *(loaded(procedure) for procedure in made))


class InterpretedStep:
    """Takes the steps of a step program, and keeps what its solves know."""

    def __init__(self, step: StepProgram, dimension: int, law: Evaluate, jacobian: Evaluate | None) -> None:
        self._source = _source(step, dimension)
        self.layout = self._source.layout
        derivative = None if jacobian is None else between_arrays(jacobian, dimension, dimension**2)
        self._laws = between_arrays(law, dimension, dimension), NOTHING, derivative, NOTHING
        self.work = np.zeros(self.layout.size)
        starting = self.layout.starting if step.starter is not None else None
        self.newtons: list[Any] = [NEWTON.structure() for _ in self.layout.solves]
        self.starters: list[Any] = [NEWTON.structure() for _ in (starting.solves if starting else ())]
        self._kept = EFFORT.structure(), *self.newtons, *self.starters, memoryview(self.work.data)

    @property
    def y(self) -> FloatArray:
        """The state in the work array."""
        return self.work[: self.layout.dimension]

    def begin(self, state: DriverState) -> None:
        """Clear what is kept from the steps of another run."""
        self._source.begin(*self._laws, *run_of(state), *self._kept)

    def run(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Take equal steps; see `Driver`."""
        self.y[:] = state.y
        try:
            outcome = self._source.run(*self._laws, *run_of(state), *self._kept, budget, *arrays(state, times, rows))
        finally:
            state.y[:] = self.y
        return Outcome(outcome)

    def attempt(self, state: DriverState, h: float) -> tuple[Outcome, FloatArray, list[FloatArray]]:
        """Try a step; return its outcome, the new state, and the error vectors."""
        self.y[:] = state.y
        outcome = self._source.attempt(*self._laws, *run_of(state), *self._kept, state.t, float(h))
        layout = self.layout
        new, errors = layout.place(layout.new), layout.place(layout.errors)
        found = self.work[errors : errors + len(layout.step.errors) * layout.length].copy()
        pairs = found.reshape(len(layout.step.errors), layout.length)
        return Outcome(outcome), self.work[new : new + layout.dimension].copy(), list(pairs)

    def accept(self, state: DriverState, t: float, times: FloatArray, rows: FloatArray) -> None:
        """Make the step that was tried last the state."""
        memory = self._kept[-1]
        self._source.accept(*records(state), *self.newtons, memory, float(t), *arrays(state, times, rows))
        state.y[:] = self.y

    def kept(self) -> tuple[Kept, ...]:
        """Return what each solve keeps, and behind them each of the starter."""
        layout, work = self.layout, self.work
        found = [
            kept(layout, newton.matrix_step, solve, work)
            for newton, solve in zip(self.newtons, layout.solves, strict=True)
        ]
        if self.starters:
            pairs = zip(self.starters, layout.starting.solves, strict=True)
            own = work[layout.end :]
            found += [kept(layout.starting, newton.matrix_step, solve, own) for newton, solve in pairs]
        return tuple(found)


def records(state: DriverState) -> tuple[Any, Any]:
    """Return where a run stands as procedures read and write it."""
    return RUN.structure.from_buffer(state.floats), COUNTS.structure.from_buffer(state.integers)


def run_of(state: DriverState) -> tuple[Any, Any, Any]:
    """Return the same, with the floors of the entries of the state behind it."""
    return (*records(state), state.floors.data)


def arrays(state: DriverState, times: FloatArray, rows: FloatArray) -> tuple[Any, Any]:
    """Return the memory for times and rows, if any are kept."""
    if not state.count(state.RECORD):
        return NOTHING, NOTHING
    return times.data, rows.reshape(-1).data


def between_arrays(function: Evaluate, dimension: int, size: int) -> Callable[..., bool]:
    """Return a law as procedures call it, with so many results: it says whether a matrix is singular."""

    def evaluate(t: float, y: memoryview, _: memoryview, out: memoryview) -> bool:
        try:
            found = function(t, np.frombuffer(y, count=dimension))
        except SingularMassMatrix:
            return True
        out[:size] = np.ascontiguousarray(found).reshape(-1).data
        return False

    return evaluate
