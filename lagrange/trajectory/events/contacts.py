"""Classification of contacts at the start of a motion: zero within noise, resting, or passed in spite of the reset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from lagrange.machine.backend import Kernel
from lagrange.machine.model import Model
from lagrange.procedure.events.constants import DENSE_ROUND_OFF, EPSILON
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.motion_start import MotionStart
from lagrange.trajectory.events.planned_step import EventZero
from lagrange.trajectory.events.step_batch import Sample, StepBatch
from lagrange.trajectory.trajectory import FloatArray

SMALL_FRACTION = 2.0**-26
"""Fraction of a step over which the slope of an event is measured at the start of a motion.

A slope below this fraction of the largest value on the step counts as zero.
"""


def passes_anyhow(model: Model, kernel: Kernel, impacts: Sequence[Impact], place: int, sample: Sample) -> bool:
    """Return True if the motion passes an event in its direction even after its reset."""
    t, y, one, parameters = sample.t, sample.state(0.0), impacts[place], sample.batch.parameters
    after = y.copy()
    one.apply(t, y, parameters, after)
    slope = model.rhs(t, after, parameters)
    h = SMALL_FRACTION * sample.h
    around = [float(kernel(t + s * h, after + s * h * slope, parameters)[place]) for s in (-1, 0, 1)]
    rise = (around[2] - around[0]) / (2 * SMALL_FRACTION)
    return one.direction * rise > SMALL_FRACTION * float(np.abs(sample.values[place]).max())


def sent_through(
    rates: Kernel,
    zeros: Iterable[EventZero],
    parameters: FloatArray,
    t: float,
    states: tuple[FloatArray, FloatArray],
    along: float,
) -> EventZero | None:
    """Return a zero whose reset would send the motion through it, or None.

    The path of a long step may reach the floor although the velocity there already points upwards; a reset would
    reverse it. `states` are those before and after the reset, `along` is the sign of the run's direction.
    """
    coming, going = along * rates(np.full(2, t), np.column_stack(states), parameters).T
    for m in zeros:
        if coming[m.which] * m.root.rising < 0 < going[m.which] * m.root.rising:
            return m
    return None


def entry(batch: StepBatch, step: int, place: int, span: float) -> float:
    """Return the size up to which a contact counts as zero: noise, or its change in a spacing of the run's times."""
    steps = abs(span / (batch.path.times[step + 1] - batch.path.times[step]))
    return float(max(batch.noise[place, step], batch.sensitive[place, step] * (EPSILON / DENSE_ROUND_OFF) * steps))


def lie(begun: MotionStart, impacts: Sequence[Impact], sample: Sample) -> set[int]:
    """Return resting contacts: zero since an earlier event at the start of the motion, and constant on the step.

    An example is a ball that has passed on its velocity and rests beside the next one; rounding moves them only.
    """
    margins = {i: 4 * size for i, size in begun.stayed.items() if i not in begun.zeros and impacts[i].contact}
    moves = np.abs(sample.values - sample.values[:, :1]).max(axis=1)
    return {i for i, margin in margins.items() if moves[i] <= margin}
