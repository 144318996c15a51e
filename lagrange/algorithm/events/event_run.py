"""State of a run by a step program with events between its steps, and the arguments of the loop over them."""

from __future__ import annotations

from typing import Any

from lagrange.algorithm.dense.block import LANES
from lagrange.algorithm.events.step_samples import Samples
from lagrange.algorithm.events.step_zeros import ReviewArguments
from lagrange.algorithm.step.run import COUNTS, RUN
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Record
from lagrange.procedure.values import Memory, Whole

READ = Array(read=True)

STEPS = Callee((Array(WHOLE, read=True), Array(), Array(WHOLE), Array(), WHOLE, Array(), Array()), (WHOLE,))
"""A function that takes steps and returns an `Outcome`.

Its arguments: data that the machine has prepared, the numbers and counts of the run, work memory, the number of tries,
and the arrays for times and states."""

FUNCTION = Callee((REAL, READ, READ, Array()), (FLAG,))
"""A function of a time, a state and numbers that the machine has prepared; it says whether it has no value."""

MOST_STEPS = 1024
"""Steps that are taken, at most, before they are reviewed: their times and states are kept until then."""

LOOK, READ_EVENTS = 16, 17
"""Codes beside those of `Outcome`: a step is irregular; the arrays of events or of changes of the motion are full."""

EVENT_RUN = Record.of(
    "EventRun",
    count=WHOLE,
    begin=WHOLE,
    before=WHOLE,
    outcome=WHOLE,
    rows=WHOLE,
    proven=WHOLE,
    budget=WHOLE,
    left=WHOLE,
    longest=WHOLE,
    ahead=WHOLE,
    since=WHOLE,
    fixed=WHOLE,
    both=WHOLE,
    resets=WHOLE,
    starts=WHOLE,
    jumps=WHOLE,
    changed_at=WHOLE,
    breaks=WHOLE,
    break_room=WHOLE,
    due=WHOLE,
    way=WHOLE,
    changed=REAL,
    interval=REAL,
    final=REAL,
)
"""State of a run with events.

    count        how many steps were taken since all were reviewed; step i of them leads from row i to the next
    begin        the first of them, from 1 on, that is to be reviewed
    before       1 where row 0 is the state before row 1, of the same motion
    outcome      their `Outcome`
    rows         how many rows were written before them
    proven       how many zeros were written before them
    budget       number of steps that the caller allows, of which `left` are left
    longest      how many steps may be taken before they are reviewed
    ahead        how many are next, and `since` how many the motion has
    fixed        1 for steps of equal length
    both         1 if the dense output of a step needs the next step: the first step of a motion waits for the second
    resets       1 where the state may be reset in the loop
    starts       1 where the motion starts at row 1
    jumps        how often the state was reset
    changed      when the motion began, or changed last, and `changed_at` how many steps there were by then
    interval     the time between the last two resets
    final        end of the run: a function that comes to zero within its noise there counts as zero
    breaks       how many changes of the motion are written, with `break_room` for so many
    due          1 + the index of the event that changes the motion at the state, or 0; `way` is its direction
"""

RESET_AT, RESET_SIZE, UNTIL_END, SETTINGS = range(4)
"""For each event: where among the results of all resets its own begin, how many there are, and how often it has to
count until the run ends, or 0. Behind them, at `SETTINGS` blocks, stand the entries of the state that are reset."""


class EventRun:
    """The arguments of the loop: samples of events, what the review is given, the driver, and where results go.

    The samples have the memory for the steps that wait: rows of times and states, from row 0 on.
    """

    def __init__(self, p: Builder) -> None:
        self.p, self.samples, self.review = p, Samples(p, written=True), ReviewArguments(p)
        self.run: Any = p.record("event_run", EVENT_RUN)
        self.drive, self.laws = p.function("drive", STEPS), p.array("laws", WHOLE, read=True)
        self.reals, self.counts = p.array("reals"), p.array("counts", WHOLE)
        self.kept_reals, self.kept_counts = p.array("kept_reals"), p.array("kept_counts", WHOLE)
        self.driver_work, self.entries = p.array("driver_work"), p.array("entries", WHOLE, read=True)
        self.y = p.array("y")
        self.values, self.value_numbers = p.function("values", FUNCTION), p.array("value_numbers", read=True)
        self.resets, self.reset_numbers = p.function("resets", FUNCTION), p.array("reset_numbers", read=True)
        self.settings, self.scratch = p.array("settings", WHOLE), p.array("scratch")
        self.row_times, self.row_states = p.array("row_times"), p.array("row_states", room=LANES)
        self.break_rows, self.break_times = p.array("break_rows", WHOLE), p.array("break_times")
        self.break_states = p.array("break_states")

    @property
    def handed(self) -> tuple[Any, ...]:
        """The arguments for another procedure."""
        path = self.samples.handed(self.samples.times, self.samples.states, self.samples.steps)
        own = self.drive, self.laws, self.reals, self.counts, self.kept_reals, self.kept_counts, self.driver_work
        functions = self.values, self.value_numbers, self.resets, self.reset_numbers
        rest = self.settings, self.scratch, self.row_times, self.row_states
        breaks = self.break_rows, self.break_times, self.break_states
        return (*path, *self.review.handed, self.run, *own, self.entries, self.y, *functions, *rest, *breaks)

    @property
    def dimension(self) -> Whole:
        """The length 2n of a state."""
        found: Whole = self.samples.dimension
        return found

    @property
    def times(self) -> Memory:
        """The times of the steps that wait."""
        return self.samples.times

    def row(self, number: Any) -> Memory:
        """Return the state in a row of the steps that wait."""
        return self.samples.states.at(number * self.dimension)

    def setting(self, block: int, event: Whole) -> Memory:
        """Return where a setting of an event stands."""
        return self.settings.at(event + self.samples.events * block)

    def copy(self, source: Memory, target: Memory, count: Any) -> None:
        """Copy some numbers."""
        with self.p.loop(0, count) as i:
            target[i] = source[i]


NUMBERS, COUNTED = len(RUN.fields), len(COUNTS.fields)
"""Number of reals and counts of a run. The floors follow the reals."""


def number(name: str) -> int:
    """Return the place of a number of a run."""
    return RUN.places[name]


def count(name: str) -> int:
    """Return the place of a count of a run."""
    return COUNTS.places[name]
