"""The coefficients of a step as functions of the time t, the step h and the ratio of successive steps."""

from __future__ import annotations

from lagrange.graph.node import Node
from lagrange.machine.kernel.arithmetic import FLOATS
from lagrange.program.program import Program
from lagrange.program.step import StepProgram


def numbers_of(step: StepProgram, scalars: Program, t: float, h: float, ratio: float) -> dict[Node, float]:
    """Return every coefficient of a step at time t with step size h. `ratio` is h divided by the step before.

    `scalars` is the program of all coefficients, built once for many steps.
    """
    values = FLOATS.evaluate(scalars, t, [h, ratio], [])
    return dict(zip(step.numbers, map(float, values), strict=True))
