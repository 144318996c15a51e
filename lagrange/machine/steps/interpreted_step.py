"""Implicit steps in plain Python: the procedures that machine code runs, printed as Python source."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.python_source import loaded
from lagrange.machine.state import DriverState, Outcome
from lagrange.procedure.step.implicit import accept_step, take_step
from lagrange.procedure.step.memory import EFFORT, NEWTON, Kept, Layout, kept
from lagrange.program.step import StepProgram

Evaluate = Callable[[float, FloatArray], FloatArray]
"""A law or its derivative, with its parameters. Raises SingularMassMatrix."""


class _Source(NamedTuple):
    """The procedures of a step as Python functions, and where they keep what."""

    layout: Layout
    take: Callable[..., int]
    accept: Callable[..., None]


@lru_cache(maxsize=64)
def _source(step: StepProgram, dimension: int) -> _Source:
    layout = Layout(step, dimension, block=1)
    return _Source(layout, loaded(take_step(layout)), loaded(accept_step(layout)))


class InterpretedStep:
    """Takes the steps of a step program that solves, and keeps what its solves know."""

    def __init__(self, step: StepProgram, dimension: int, law: Evaluate, jacobian: Evaluate) -> None:
        self._source = _source(step, dimension)
        self.layout = self._source.layout
        self._law, self._jacobian = given(law, dimension), given(jacobian, dimension)
        self.work = np.zeros(self.layout.size)
        self._memory = memoryview(self.work.data)
        self._effort: Any = EFFORT.structure()
        self.newtons: list[Any] = [NEWTON.structure() for _ in self.layout.solves]

    def take(
        self, state: DriverState, states: list[FloatArray], h: float, *, slope_known: bool
    ) -> tuple[Outcome, FloatArray, list[FloatArray]]:
        """Try a step from some states; return its outcome, the new state, and the error vectors."""
        layout, effort, reals = self.layout, self._effort, state.reals
        whole = np.concatenate(states)
        self.work[: len(whole)] = whole
        tolerances = float(reals[state.RTOL]), memoryview(state.floors.data)
        nothing = memoryview(array("d"))
        laws = (self._law, nothing, self._jacobian, nothing)
        effort.evaluations = 0
        effort.residual = float(reals[state.RESIDUAL])
        with np.errstate(all="ignore"):
            outcome = self._source.take(
                *laws, state.t, float(h), *tolerances, effort, *self.newtons, self._memory, slope_known
            )
        state.counts[state.EVALUATIONS] += effort.evaluations
        reals[state.RESIDUAL] = effort.residual
        new, errors = layout.place(layout.new), layout.place(layout.errors)
        found = self.work[errors : errors + len(layout.step.errors) * layout.length].copy()
        return (
            Outcome(outcome),
            self.work[new : new + layout.dimension].copy(),
            list(found.reshape(len(layout.step.errors), layout.length)),
        )

    def accept(self) -> None:
        """Make the step that was tried last the state, and keep its unknowns."""
        self._source.accept(*self.newtons, self._memory)

    def kept(self) -> tuple[Kept, ...]:
        """Return what each solve keeps."""
        pairs = zip(self.newtons, self.layout.solves, strict=True)
        return tuple(kept(self.layout, newton.matrix_step, solve, self.work) for newton, solve in pairs)


def given(function: Evaluate, dimension: int) -> Callable[..., bool]:
    """Return a law as procedures call it, between arrays: it says whether a matrix is singular."""

    def evaluate(t: float, y: memoryview, _: memoryview, out: memoryview) -> bool:
        try:
            found = function(t, np.frombuffer(y, count=dimension))
        except SingularMassMatrix:
            return True
        out[: found.size] = np.ascontiguousarray(found).ravel().data
        return False

    return evaluate
