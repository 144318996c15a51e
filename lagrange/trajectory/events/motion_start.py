"""Determine the signs of event functions at the start of a run or after a reset, and find contacts that act at once.

The sign of a function is known from earlier points. It is never taken from a value within rounding of zero:

1. A function that a reset does not change, up to rounding, keeps its sign. If it is within rounding of zero when
   another event acts, it has not crossed zero. If the new motion leads to the opposite sign, the function crosses zero
   at the time of the reset: this event counts, ends the run, or resets the state again, at once.
2. The function of an event that occurred at this point has no sign afterwards: the motion decides it. The event does
   not occur twice.
3. After a reset that changes the function, and at the start of a run, the sign is unknown. A value beyond rounding
   gives the sign: a jump over zero is not an event. A value of zero is not an event either, except for a contact, an
   event with a direction and a reset. A contact has the sign from which its direction leads to zero. It acts at once if
   its function moves through zero in this direction, unless the motion would pass zero after the reset as well.

If the function is within its noise of zero at the first accepted point after a reset, its time derivative decides the
sign, as between any two steps.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lagrange.algorithm.events.constants import DENSE_ROUND_OFF, EPSILON
from lagrange.machine.backend import Kernel
from lagrange.machine.model import Model
from lagrange.trajectory.events.array_search import EventZero, Side
from lagrange.trajectory.events.model_events import ModelEvent
from lagrange.trajectory.events.step_batch import Sample, StepBatch
from lagrange.trajectory.trajectory import FloatArray


@dataclass(frozen=True, eq=False)
class MotionStart:
    """Event functions at the start of a smooth piece of motion: which ones are zero there, and why.

    `first` is True at the start of the run. Events are given by index. `zero_sizes` maps each event that counts as zero
    to the size of its function. `zeros` maps each event that has just occurred to its direction: 1, -1, or 0 for a
    touch without crossing. `rested` are events with a reset that have stayed zero on all steps since the start; their
    sign is undecided. `jumped` are events that occurred at a jump over zero. Rounding decides on which side of a jump
    the motion starts, so a second jump at once is the same jump.
    """

    first: bool = False
    zero_sizes: Mapping[int, float] = field(default_factory=dict)
    zeros: Mapping[int, int] = field(default_factory=dict)
    rested: frozenset[int] = frozenset()
    jumped: frozenset[int] = frozenset()


def sides_after_events(
    sides: Sequence[Side],
    events: Sequence[ModelEvent],
    change: tuple[FloatArray, FloatArray],
    noise: FloatArray,
    occurred_now: Container[int],
) -> list[Side]:
    """Return the sides of zero (known signs) of event functions after a reset, from `sides` before it.

    A side of sign 0 is undecided. `change` has the values of the event functions before and after the reset, (E,) each.
    The side of a function that changes by more than `noise` (E,), its rounding error, is undecided. So is the side of
    each event in `occurred_now` (indices), which has just occurred. A contact that came near zero before the reset does
    not count as near it afterwards, since it must not act without crossing zero.
    """
    sides_after = []
    for i, (side, event, before, after) in enumerate(zip(sides, events, *change, strict=True)):
        stays = i not in occurred_now and not event.root and abs(after - before) <= noise[i]
        sides_after.append(Side(side.sign, side.near and not event.reset) if stays else Side())
    return sides_after


SMALL_FRACTION = 2.0**-26
"""Fraction of a step over which the slope of an event function just after a reset is measured by differences. The slope
counts as zero if it would change the function on the whole step by less than this fraction of its largest value."""


def still_passes(model: Model, kernel: Kernel, events: Sequence[ModelEvent], index: int, sample: Sample) -> bool:
    """Return True if the motion after the reset of event `index` still passes zero in the event's direction.

    The reset is then useless. `kernel` evaluates the event functions, and `events` are all events. `sample` is the step
    that begins at the event.
    """
    t, y, event, parameters = sample.t, sample.state(0.0), events[index], sample.batch.parameters
    after = y.copy()
    event.apply(t, y, parameters, after)
    slope = model.rhs(t, after, parameters)
    h = SMALL_FRACTION * sample.h
    around = [float(kernel(t + s * h, after + s * h * slope, parameters)[index]) for s in (-1, 0, 1)]
    rise = (around[2] - around[0]) / (2 * SMALL_FRACTION)
    return event.direction * rise > SMALL_FRACTION * float(np.abs(sample.values[index]).max())


def wrong_side_reset(
    rates: Kernel,
    zeros: Iterable[EventZero],
    parameters: FloatArray,
    t: float,
    states: tuple[FloatArray, FloatArray],
    along: float,
) -> EventZero | None:
    """Return the first zero in `zeros` at which the reset would send the motion through zero, or None.

    The polynomial of a long step may bring a ball to the floor although its velocity there already points upwards. A
    reset would then send it downwards. `rates` computes the time derivatives of the event functions. `states` are the
    states (2n,) before and after the reset. `along` is 1, or -1 for a run backwards in time.
    """
    coming, going = along * rates(np.full(2, t), np.column_stack(states), parameters).T
    for m in zeros:
        if coming[m.which] * m.root.rising < 0 < going[m.which] * m.root.rising:
            return m
    return None


def zero_size(batch: StepBatch, step: int, index: int, span: float) -> float:
    """Return the size up to which the event function of contact `index` counts as zero at the start of a step.

    `step` is the index of the step in the batch. The size is the noise of the event function, or its change within the
    rounding error of a time if this is larger. This error is 2**-52 times `span`, the duration of the run.
    """
    steps = abs(span / (batch.path.times[step + 1] - batch.path.times[step]))
    return float(max(batch.noise[index, step], batch.sensitive[index, step] * (EPSILON / DENSE_ROUND_OFF) * steps))


def resting_contacts(begun: MotionStart, events: Sequence[ModelEvent], sample: Sample) -> set[int]:
    """Return the indices of the contacts that are at rest on the first step of a smooth piece of motion.

    The function of such a contact is zero at the start without a new event, and changes only by rounding on the step
    `sample`. Example: a ball that has transferred its velocity to the next ball and touches it. `begun` describes the
    start, and `events` are all events.
    """
    margins = {i: 4 * size for i, size in begun.zero_sizes.items() if i not in begun.zeros and events[i].contact}
    moves = np.abs(sample.values - sample.values[:, :1]).max(axis=1)
    return {i for i, margin in margins.items() if moves[i] <= margin}
