"""Runs of the members of an ensemble in vector lanes: each lane runs its members one after the other.

A lane is one entry of the vectors in which machine code runs several members at once. It runs the members whose index
is the number of the lane, from 0 on, plus a multiple of the number of lanes. The results of a member depend on its own
numbers only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.constants import MOST_SURVEYS, SMALL_FLOOR, Outcome
from lagrange.algorithm.members.reductions import RunReductions
from lagrange.algorithm.step.memory import FUNCTION, Counts, Run
from lagrange.procedure.form import FLAG, READ, Array, Callee, Procedure
from lagrange.procedure.front.decorators import Bundle, Stated, inline, procedure
from lagrange.procedure.front.vocabulary import (
    In,
    Out,
    WholesOut,
    clear,
    each,
    generated,
    larger,
    reals,
    unlikely,
    unrolled,
    wholes,
)
from lagrange.procedure.rewrite import bound

ENDED_BY_EVENT = len(Outcome)
"""Code in addition to the outcomes: an event ended the member."""

LANE = "lane"
"""Name of the argument that differs from lane to lane; all other arguments are the same for all lanes."""

COUNTED = ("steps", "rejected", "evaluations")
"""Names of the counts that are returned for each member."""

PREPARE = Callee((READ, Array()), (FLAG,))
"""Type of a function that writes the prepared numbers of a system: the parameters, then all values that depend only on
them. The flag is true for a singular matrix.
"""


@dataclass(frozen=True)
class SystemNumbers:
    """Prepared numbers of a system: the parameters, followed by the values that depend only on parameters.

    `size` is their total number, and `parameters` the number of parameters. With the procedure `prepare` each member
    has parameters of its own, and computes all numbers from them. Otherwise all members share one array.
    """

    size: int
    parameters: int
    prepare: Procedure | None = None


@dataclass(frozen=True)
class Observed:
    """Values of a state, such as the energy, that are recorded at the start and end of a run.

    `size` is their number. The procedure `kernel` computes them from time, state, and the parameters with all
    values that depend only on them.
    """

    kernel: Procedure
    size: int


@dataclass(frozen=True)
class OccurrenceArrays:
    """Results of the search for events: the times and states of the first `most` occurrences of each event."""

    most: int
    occurrence_times: Out
    occurrence_states: Out


@dataclass(frozen=True)
class FirstOccurrences:
    """Storage of the first occurrences of events in a member's run.

    `kept` is the number of events, and `dimension` the length of a state.
    """

    kept: int
    dimension: int

    @inline
    def memory(self) -> WholesOut:
        """Return memory for the number of occurrences of each event."""
        return wholes(max(self.kept, 1))

    @inline
    def begin(self, seen: WholesOut) -> None:
        """Set the counts of occurrences, `seen`, to zero at the start of a member's run."""
        for event in unrolled(self.kept):
            seen[event] = 0

    @inline
    def keep(self, arrays: Any, seen: WholesOut, index: int, event: int, t: float, state: In) -> None:
        """Store the time t and the state of an occurrence of an event, if it is among the first `arrays.most`.

        `index` is the index of the member, and `event` that of the event. `seen` has the number of stored
        occurrences of each event, and is updated.
        """
        number = seen[min(event, max(self.kept - 1, 0))]
        if event < self.kept and number < arrays.most:
            slot = (index * self.kept + event) * arrays.most + number
            arrays.occurrence_times[slot] = t
            target = arrays.occurrence_states[slot * self.dimension :]
            for i in each(self.dimension, width=1):
                target[i] = state[i]
            seen[event] = number + 1


@procedure
def energy_and_momenta(t: float, y: In, numbers: In, out: Out, *, energy: Procedure, momenta: Procedure) -> bool:
    """Write the energy and then the conserved momenta of a state to `out`. Return True if one has no value.

    t and y are the time and the state, and `numbers` are the parameters with all values that depend on them
    alone. The procedures `energy` and `momenta` compute the values.
    """
    is_singular = generated(energy, t, y, numbers, out)
    others_are: bool = generated(momenta, t, y, numbers, out[1:])
    return is_singular or others_are


@dataclass(frozen=True)
class MemberJob:
    """The members of a call, their common settings, and the arrays of their results, a row for each member.

    There are `count` members, which run from t0 to t1 with at most `budget` trial steps each. `starts` has
    their states [q, v]. `numbers` has the parameters of each member, or the parameters that all members share,
    with all values that depend only on them. `ends`, `times` and `outcomes` are the last states, their times
    and the outcomes: a member whose outcome is not DONE is at the point where its run stopped.

    output_count  Number of output times.
    output_times  The output times, with NaN after the last one.
    outputs       The states at the output times, (count, output_count, 2n).
    first         The observed values at the start.
    last          The observed values at the end.
    points        The sample points of a step, for reductions of expressions along the run.
    table         The coefficients of the method's dense output.
    reduced       The reductions of expressions.
    law           The law of motion as the steps call it, or the series.
    prepare       The function that computes all values that depend only on a member's parameters, or None.
    values        The function that evaluates the watched functions of a Taylor run, or None.
    watched       Further arguments of the search for events, or None.
    """

    lane: int
    lanes: int
    count: int
    budget: int
    t0: float
    t1: float
    rtol: float
    floor: float
    share: float
    step: float
    longest: float
    starts: In
    numbers: In
    output_count: int
    output_times: In
    outputs: Out
    ends: Out
    times: Out
    first: Out
    last: Out
    outcomes: WholesOut
    steps: WholesOut
    rejected: WholesOut
    evaluations: WholesOut
    points: In
    table: In
    reduced: Out
    law: Callable[..., Any]
    observe: Callable[..., bool]
    prepare: Any
    values: Any
    watched: Any


@dataclass(frozen=True)
class Member:
    """Memory for the member that runs in a lane, one entry of the vectors of machine code.

    The state is in `parts`, vectors of equal length; `state` is memory for a copy of it as one vector.
    """

    numbers: In
    run: Run
    counts: Counts
    floors: Out
    parts: tuple[Out, ...]
    state: Out
    observed: Out
    reduced: Any
    """Results of the reductions of expressions so far, a `Reduced`, or None without reductions."""

    method_memory: Any
    """Memory of the method in addition to the state, as `MemberMethod.memory` returns it."""


class MemberMethod(ABC):
    """An integration method for members of an ensemble: its memory, the start of a run, and its steps.

    `functions` maps names of functions of a `MemberJob` to procedures: `law` and, for Taylor runs with events,
    `values`. `law_type` is the type of `law`. `watched_type` is the class of the arguments of the search for
    events, None without events.
    """

    law_type: Callee = FUNCTION
    watched_type: type | None = None
    functions: Mapping[str, Procedure]

    def __init__(
        self, dimension: int, numbers: SystemNumbers, observed: Observed, reductions: RunReductions | None
    ) -> None:
        self.dimension, self.numbers, self.observed, self.reductions = dimension, numbers, observed, reductions

    @abstractmethod
    def memory(self, job: MemberJob, numbers: In) -> tuple[tuple[Out, ...], Any]:
        """Return memory for the state, as one or several vectors, and an object with the other memory of the method.

        `job` has the settings, and `numbers` is memory for the prepared numbers of the member.
        """

    @abstractmethod
    def begin(self, job: MemberJob, member: Member) -> None:
        """Initialize the data that the method stores for the run of `member`, at the start of this run."""

    @abstractmethod
    def advance(self, job: MemberJob, member: Member, index: int, last: bool) -> int:
        """Take a trial step of member `index`. Return PAUSED if the run continues, else why it ends.

        `last` is true if the budget allows no step after this one.
        """

    @abstractmethod
    def attempts(self, job: MemberJob, member: Member) -> int:
        """Return the number of trial steps of a member so far. The budget of the job limits it."""

    def build(self) -> Procedure:
        """Return the procedure that runs members by this method."""
        functions = {**self.functions, "observe": self.observed.kernel}
        if self.numbers.prepare is not None:
            functions["prepare"] = self.numbers.prepare
        return bound(run_members.form(method=self), functions, prefix="member_")


def job_type(method: MemberMethod) -> Bundle:
    """Return the type of a procedure's parameter of the class `MemberJob`, for a `method`."""
    values = FUNCTION if "values" in method.functions else None
    types: dict[str, Stated] = {"law": method.law_type, "observe": FUNCTION, "values": values}
    types["prepare"] = None if method.numbers.prepare is None else PREPARE
    types["watched"] = None if method.watched_type is None else Bundle(method.watched_type, {})
    return Bundle(MemberJob, types)


@procedure(job=job_type)
def run_members(job: MemberJob, *, method: MemberMethod) -> None:
    """Run the members of one lane of an ensemble, one after the other, and write their results.

    A lane is one entry of the vectors in which machine code runs several members at once.
    """
    member = memory_of_member(job, method)
    index, tried, is_fresh = job.lane, 0, True
    while index < job.count:
        if is_fresh:
            begin_member(job, member, index, method)
            tried = 0
        is_last = tried >= job.budget
        outcome = without_sizes(method.advance(job, member, index, is_last), member, method)
        tried = method.attempts(job, member)
        is_fresh = outcome != Outcome.PAUSED or is_last
        if is_fresh:
            end_member(job, member, index, outcome, method)
            index += job.lanes


@inline
def memory_of_member(job: MemberJob, method: MemberMethod) -> Member:
    """Return memory for one member. The next member in the same lane uses it again."""
    n, reductions = method.dimension, method.reductions
    numbers: Any = job.numbers if job.prepare is None else reals(method.numbers.size)
    reduced = None if reductions is None else reductions.memory()
    vectors = reals(n), reals(method.observed.size)
    run, counts, floors = Run(), Counts(), reals(n)
    parts, method_memory = method.memory(job, numbers)
    return Member(numbers, run, counts, floors, parts, *vectors, reduced, method_memory)


@inline
def begin_member(job: MemberJob, member: Member, index: int, method: MemberMethod) -> None:
    """Initialize the run of member `index`: its numbers, its state, and the records of the run."""
    run, n = member.run, method.dimension
    if job.prepare is not None:
        job.prepare(job.numbers[index * method.numbers.parameters :], member.numbers)
    clear(run)
    clear(member.counts)
    run.t, run.start, run.end = job.t0, job.t0, job.t1
    run.h, run.step = job.step, job.step
    run.rtol, run.share, run.longest, run.previous = job.rtol, job.share, job.longest, 1.0
    run.cause = float(Outcome.STEP_TOO_SMALL)
    for i in each(n, width=1):
        member.floors[i] = job.floor
    move_to(member, job.starts[index * n :], method.dimension)
    observe(job, member, job.t0, job.first, index, method)
    if method.reductions is not None:
        method.reductions.begin(member.reduced, job.t0, member.state, member.numbers)
    method.begin(job, member)


@inline
def move_to(member: Member, state: In, dimension: int) -> None:
    """Set the state of a member, vector by vector, to `state`, which has `dimension` entries."""
    length = dimension // len(member.parts)
    for k, part in enumerate(member.parts):
        entries = state[k * length :]
        for i in each(length, width=1):
            part[i] = entries[i]


@inline
def copy_state(member: Member, to: Out, dimension: int) -> None:
    """Copy the state of a member to an array, as one vector."""
    length = dimension // len(member.parts)
    for k, part in enumerate(member.parts):
        entries = to[k * length :]
        for i in each(length, width=1):
            entries[i] = part[i]


@inline
def observe(job: MemberJob, member: Member, t: float, results: Out, index: int, method: MemberMethod) -> None:
    """Write the observed values, such as the energy, of a member's state at time t to row `index` of `results`."""
    size = method.observed.size
    copy_state(member, member.state, method.dimension)
    job.observe(t, member.state, member.numbers, member.observed)
    target = results[index * size :]
    for i in each(size, width=1):
        target[i] = member.observed[i]


@inline
def without_sizes(outcome: int, member: Member, method: MemberMethod) -> int:
    """Return the outcome of a step, with PAUSED in place of UNSCALED if the run can continue without sizes.

    UNSCALED asks for estimates of the sizes of the state's entries. Estimates only raise the absolute
    tolerances. Without estimates, steps are at most shorter. A run ends if it cannot begin without sizes. A run also
    ends if an entry may be rounding noise, because its steps would shrink to nothing.
    """
    counts = member.counts
    is_asked = outcome == Outcome.UNSCALED and counts.steps > 0 and counts.surveyed < MOST_SURVEYS
    goes_on = is_asked
    if unlikely(is_asked):
        counts.surveyed += 1
        goes_on = not some_rounded(member.floors, method.dimension // 2)
    return Outcome.PAUSED if goes_on else outcome


@inline
def some_rounded(floors: In, coordinate_count: int) -> bool:
    """Return True if an absolute tolerance is below `SMALL_FLOOR` times the largest of its kind.

    `floors` are the absolute tolerances of the state's entries. The first `coordinate_count` are those of the
    coordinates, the others those of the velocities.
    """
    is_rounded = False
    for begin in (0, coordinate_count):
        largest = 0.0
        for i in range(coordinate_count):
            largest = larger(largest, floors[begin + i])
        for i in range(coordinate_count):
            floor = floors[begin + i]
            is_rounded = is_rounded or floor < SMALL_FLOOR * largest
    return is_rounded


@inline
def end_member(job: MemberJob, member: Member, index: int, outcome: int, method: MemberMethod) -> None:
    """Write the last state of member `index`, the outcome of its run, counts and reductions to the results.

    `outcome` is the outcome of its last step.
    """
    run, counts, n = member.run, member.counts, method.dimension
    copy_state(member, job.ends[index * n :], n)
    observe(job, member, run.t, job.last, index, method)
    job.times[index] = run.t
    job.outcomes[index] = explained(outcome, run, counts)
    job.steps[index] = counts.steps
    job.rejected[index] = counts.rejected
    job.evaluations[index] = counts.evaluations
    if method.reductions is not None:
        method.reductions.write(member.reduced, run.t - job.t0, job.reduced[index * method.reductions.count :])


@inline
def explained(outcome: int, run: Run, counts: Counts) -> int:
    """Return the reason for the end of a run, by the outcome of its last step.

    The reason is NON_FINITE or SINGULAR if the step became too small because of trial steps with this outcome.
    Otherwise it is the given `outcome`.
    """
    is_stuck = outcome == Outcome.STEP_TOO_SMALL and counts.after_reject > 0
    for cause in (Outcome.NON_FINITE, Outcome.SINGULAR):
        outcome = cause if is_stuck and run.cause == float(cause) else outcome
    return outcome
