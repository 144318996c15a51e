"""Review of many steps for events, block by block: functions that keep their sign are excluded, zeros isolated.

An irregular event ends the review before its step: an event without a value; one that is not resolved; one that starts
at zero and does not leave it at once; or several that change the motion at one time.
"""

from __future__ import annotations

from lagrange.algorithm.blocks import WIDEST_VECTOR
from lagrange.algorithm.events.step_samples import Lines, Samples, samples_type
from lagrange.algorithm.events.step_zeros import ENDED, IRREGULAR, ReviewedEvents, step_zeros
from lagrange.procedure.front.plain import Bundle, inline, procedure
from lagrange.procedure.front.vocabulary import WholesOut, unlikely, wholes

QUEUE = 256
"""Number of steps that are screened before those that may contain zeros are examined."""


@procedure(samples=samples_type, watch=lambda: Bundle(ReviewedEvents, {}))
def review(samples: Samples, watch: ReviewedEvents) -> int:
    """Search the steps of a run for events. Return a code, such as `ENDED`: why the search ended.

    The run has times (S+1,) and states (S+1, 2n). The event, the time and the state of each zero that counts
    are written to `watch`. If a zero that changes the motion ended the search, it is written after them and not
    counted.
    """
    lines, end, reached = samples.lines(), watch.review.end, watch.review.begin
    queue, step_numbers = wholes(QUEUE), wholes(WIDEST_VECTOR)
    zeros = step_zeros(samples, lines, watch)
    while reached < end:
        filled = 0
        while reached < end and filled <= QUEUE - WIDEST_VECTOR:
            filled = queue_block(samples, lines, watch, step_numbers, reached, queue, filled)
            reached += WIDEST_VECTOR
        for first in range(0, filled, WIDEST_VECTOR):
            for b in range(WIDEST_VECTOR):
                step_numbers[b] = queue[min(first + b, filled - 1)]
            is_bad, is_resolved = samples.follow(lines, step_numbers), False
            if unlikely(is_bad or zeros.begin_at_zero(step_numbers[0])):
                watch.review.step = step_numbers[0]
                return IRREGULAR
            for b in range(min(filled - first, WIDEST_VECTOR)):
                if zeros.some_may_vanish(b):
                    if not is_resolved:
                        is_bad, is_resolved = samples.sample_fully(lines), True
                    why = zeros.visit(step_numbers[b], b, is_bad)
                    if unlikely(why != ENDED):
                        watch.review.step = step_numbers[b]
                        return why
    watch.review.step = end
    return ENDED


@inline
def queue_block(
    samples: Samples,
    lines: Lines,
    watch: ReviewedEvents,
    step_numbers: WholesOut,
    first: int,
    queue: WholesOut,
    filled: int,
) -> int:
    """Append to the queue those steps of a block on which an event function may be zero; return the new length.

    The first step of all is always appended. `first` is the number of the first step of the block, and `step_numbers`
    is memory for the numbers of its steps. `filled` is the length of the queue before.
    """
    end, is_bad = watch.review.end, False
    for b in range(WIDEST_VECTOR):
        step_numbers[b] = min(first + b, end - 1)
    if samples.screens:
        is_bad = samples.sift(lines, step_numbers)
    for b in range(min(end - first, WIDEST_VECTOR)):
        is_close = is_bad or first + b == watch.review.begin or not samples.screens
        if is_close or samples.some_doubtful(lines, b):
            queue[filled] = first + b
            filled += 1
    return filled
