"""The numbers of a step: functions of t, h and the ratio of steps."""

from __future__ import annotations

from lagrange.graph.node import Node
from lagrange.machine.kernel.arithmetic import FLOATS
from lagrange.program.program import Program
from lagrange.program.step import StepProgram


def numbers_of(step: StepProgram, scalars: Program, t: float, h: float, ratio: float) -> dict[Node, float]:
    """Return every number of a step at a time, for a length and its ratio to that of the step before.

    `scalars` is the program of them all, made once for many steps.
    """
    values = FLOATS.evaluate(scalars, t, [h, ratio], [])
    return dict(zip(step.numbers, map(float, values), strict=True))
