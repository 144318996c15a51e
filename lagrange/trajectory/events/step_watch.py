"""Handle the events of all methods but Taylor: record them, reset the state, or end the run.

Accepted steps are searched for events on their dense output: here, or in a compiled loop if there is one. If an event
resets the state or ends the run, the run is set back to it. `EventDriver` takes the steps and calls `StepWatch`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lagrange.algorithm.events.constants import CLEAR_FACTOR, NOISE_HALVES, TOGETHER
from lagrange.algorithm.events.roots import roots
from lagrange.algorithm.events.search import IGNORED, UNKNOWN
from lagrange.machine.backend import Kernel
from lagrange.machine.state import DriverState
from lagrange.trajectory.dense_output import StepPath
from lagrange.trajectory.events.array_search import (
    SAME_JUMP,
    EventZero,
    Isolate,
    Root,
    Side,
    StepZeros,
    ended,
    rests,
    trace,
    velocity,
)
from lagrange.trajectory.events.compiled_loop import WatchedEvents
from lagrange.trajectory.events.end_messages import (
    EventResult,
    accumulating,
    at_rest,
    undefined,
    unresolved,
    without_value,
)
from lagrange.trajectory.events.event_log import Breaks, ChangeCounter, EventLog, ResetIntervals
from lagrange.trajectory.events.model_events import rates, reset_state
from lagrange.trajectory.events.motion_start import (
    SMALL_FRACTION,
    MotionStart,
    resting_contacts,
    sides_after_events,
    still_passes,
    wrong_side_reset,
    zero_size,
)
from lagrange.trajectory.events.step_batch import PathOf, Sample, StepBatch, StepsPath, Window, state_noise
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray, Status

S = DriverState


@dataclass(frozen=True, eq=False)
class Cut:
    """Point to which a run is set back: `steps` steps are kept, the last one up to time t and state y (2n,).

    `length` is the length of the step that contains the point or begins there. `whole` is the end (time and state) of
    the full step if the step is shortened, else None. A `late` cut has no event: the time limit was reached.
    """

    steps: int
    t: float
    y: FloatArray
    length: float
    whole: tuple[float, FloatArray] | None = None
    late: bool = False


class StepWatch(EventLog):
    """Finds the events along one run by a step program. Records them, resets the state, or ends the run."""

    def __init__(self, problem: Problem, path_of: PathOf, memory: WatchedEvents | None = None, *, fixed: bool) -> None:
        super().__init__(len(problem.events), len(problem.y0))
        self.problem, self.parameters = problem, problem.parameter_array
        if memory is None:
            memory = WatchedEvents.of(problem)
        else:
            memory.memory.restart()
        self.memory, self.kernel, self.events = memory, memory.kernel, memory.events
        self.shared, self._path_of = memory.memory, path_of
        self.fixed = fixed
        self.breaks = Breaks(len(problem.y0))
        self.change_counter = ChangeCounter()
        # Resets of the state: their number, the time of the last one, and the number of steps before it.
        self.jumps, self.changed, self._changed_at = 0, problem.t0, 0
        self._intervals = ResetIntervals()
        # The start of the present motion; None after its first step.
        self._start: MotionStart | None = MotionStart(first=True)
        # For each event: the side of zero before the next step; the value at a start at zero, which is subtracted; the
        # size that counts as zero after a reset. Then the events whose functions stay zero.
        self._sides = [Side()] * len(self.events)
        self._levels: dict[int, float] = {}
        self._zero_sizes: Mapping[int, float] = {}
        self._resting: frozenset[int] = frozenset()
        # At the point to which the run is set back: its events, the end of the shortened step, and the end of the run.
        self._pending: list[EventZero] = []
        self.whole: tuple[float, FloatArray] | None = None
        self._verdict: EventResult | None = None
        self._deadline = math.inf

    @cached_property
    def _isolate(self) -> Isolate:
        return self.problem.model.machine.called(roots.form())

    @property
    def resets(self) -> bool:
        """True if an event resets the state."""
        return any(event.reset for event in self.events)

    @property
    def ends(self) -> bool:
        """True if an event may reset the state or end the run: then steps after it are discarded."""
        return any(event.reset or event.terminal for event in self.events)

    def names(self) -> list[str]:
        """Return the text of each event function, in the user's symbols, by which messages name the event."""
        return [self.problem.model.statement.quote(event.expression) for event in self.problem.events]

    def begin(self, state: DriverState) -> EventResult:
        """Begin to watch a run at its start; return the end of the run if an event function has no value there."""
        self.state = state
        limit = self.problem.max_wall
        self._deadline = math.inf if limit is None else time.perf_counter() + limit
        path = self.memory.path(self._path_of, np.array([state.t]), state.y[None].copy())
        self.shared.run.final = self.problem.t1
        # The path over a step may use a slope of the previous step, or, on the first step, of the next step.
        self.shared.run.both = int(isinstance(path, StepPath) and path.kind.derivative)
        return self._defined(state)

    def process(self, state: DriverState) -> EventResult:
        """Record the pending events at the state to which the run was set back, and apply their resets.

        The result says whether the state has jumped, or why the run ends.
        """
        self.breaks.append(state.count(S.STEPS) + self.jumps, self.whole)
        if self._verdict is not None:
            return self._verdict
        pending, self._pending = self._pending, []
        if self.change_counter.accumulates(state.t, (zero.which for zero in pending)):
            return accumulating(self.names()[pending[0].which])
        zeros = [zero for zero in pending if self.events[zero.which].counts(zero.root.rising)]
        ends = self.occur([zero.which for zero in zeros], self.events, state)
        resets = [zero for zero in zeros if self.events[zero.which].reset]
        result = self._jump(resets, pending, state) if resets else EventResult()
        return EventResult(Status.EVENT, jumped=result.jumped) if ends and result.status is None else result

    def end(self, state: DriverState) -> EventResult:
        """Return the result SUCCESS: no event is pending at the end, since the driver stops at each event."""
        return EventResult(Status.SUCCESS)

    def is_due(self, state: DriverState) -> bool:
        """Return False: no event is pending, since the driver stops at each event that has to be processed."""
        return False

    def review(self, times: FloatArray, states: FloatArray, begin: int, end: int, steps_before: int) -> Cut | None:
        """Record the events on some steps up to the first point with a reset or an end of the run; return this point.

        The steps are `begin` to before `end` of times (S+1,) and states (S+1, 2n). The result is None without such a
        point; else the run is set back to it, and `process` handles its events. `steps_before` counts the steps
        before `times[0]`.
        """
        path = self.memory.path(self._path_of, times, states)
        cut = self._ahead(Window(path, begin, end), steps_before + begin)
        return None if cut is None else replace(cut, steps=cut.steps + begin)

    @property
    def regular(self) -> bool:
        """True if no event function is known to be zero at the present state, so that machine code can continue."""
        started = not self._levels if self._start is None else not (self._start.rested or self._start.jumped)
        return started and not self._resting

    def write(self) -> None:
        """Write the known signs of event functions, and event counts, to the memory of the compiled loop."""
        run, begun = self.shared.run, self._start
        run.starts, run.jumps = int(begun is not None), self.jumps
        run.changed, run.changed_at = self.changed, self._changed_at
        zero_sizes, zeros = ({}, {}) if begun is None else (begun.zero_sizes, begun.zeros)
        self.memory.write(self._sides, self.occurrences, zero_sizes, zeros)

    def read(self) -> None:
        """Read events, resets and signs of event functions from the memory of machine code."""
        run, memory = self.shared.run, self.shared
        last = run.breaks
        self.collect()
        if run.jumps > self.jumps:
            self.jumps, self.changed, self._changed_at = int(run.jumps), float(run.changed), int(run.changed_at)
            # The code of an event that is zero at the start is 2 plus the direction in which it reached zero.
            zeros = {i: way - 2 for i, way in enumerate(memory.arrivals.tolist()) if way not in (UNKNOWN, IGNORED)}
            self.change_counter.begin(self.changed, next(iter(zeros), 0))
            self._intervals.begin(float(run.interval))
            self._zero_sizes = {i: float(memory.zero_sizes[i]) for i in zeros}
            self._start = MotionStart(zero_sizes=self._zero_sizes, zeros=zeros)
        pairs = zip(memory.sign.tolist(), memory.near.tolist(), strict=True)
        self._sides, self._levels = [Side(sign, bool(near)) for sign, near in pairs], {}
        self._start = self._start if run.starts else None
        if run.due:
            self._pending, run.due = [EventZero(int(run.due) - 1, Root(0.0, int(run.way)))], 0
            end = float(memory.break_times[last])
            self.whole = None if math.isnan(end) else (end, memory.break_states[last].copy())

    def collect(self) -> None:
        """Read the events and resets that machine code has stored, but not the signs of the event functions."""
        self.memory.collect(self, self.breaks)

    def _ahead(self, path: StepsPath, steps_before: int) -> Cut | None:
        """Record the events on all steps of a path up to the first point with a reset or an end; return this point.

        Return None without such a point. `steps_before` is the number of steps of the run before the path.
        """
        times = path.times
        batch = StepBatch.of(self.kernel, self._rates, self.parameters, path)
        doubtful = ~batch.certain
        coming = iter([*np.flatnonzero(doubtful.any(axis=0)).tolist(), len(times) - 1])
        step, following = 0, next(coming)
        while True:
            while following < step:
                following = next(coming)
            begins = self._start is not None
            unsettled = [i for i, side in enumerate(self._sides) if begins or not side.settled or i in self._levels]
            step = step if unsettled and step < len(times) - 1 else following
            if step == len(times) - 1:
                return None
            watched = [i for i in range(len(self.events)) if i in unsettled or doubtful[i, step]]
            cut = self._step(batch, step, watched, steps_before)
            if cut is not None:
                return cut
            step += 1
            if step < len(times) - 1 and time.perf_counter() > self._deadline:
                return replace(_cut(batch, step - 1, batch.sample(step - 1), 1.0), late=True)

    def _rates(self) -> Kernel:
        """Return the kernel of the time derivatives of the event functions along the motion, compiled at first use."""
        model = self.problem.model
        return model.function("rates", rates(model.equations, tuple(event.node for event in self.events)))

    def _defined(self, state: DriverState) -> EventResult:
        values = self.kernel(state.t, state.y, self.parameters)
        return EventResult() if np.isfinite(values).all() else undefined(self.names(), values[None])

    def _step(self, batch: StepBatch, step: int, watched: Sequence[int], steps_before: int) -> Cut | None:
        """Record the zeros of events on a step up to the first one with a reset or an end; return this point or None.

        `watched` are the indices of the events that may be zero. `steps_before` counts the steps before the batch.
        """
        sample, begun = batch.sample(step), self._start
        last = bool(batch.path.times[step + 1] == self.problem.t1)
        starting = self._at_zero(batch, step, watched)
        candidates = self._resting if begun is None or begun.rested else starting
        still = set() if begun is None else resting_contacts(begun, self.events, sample)
        self._resting = frozenset(i for i in candidates if i in still or rests(batch, step, sample, i))
        traces = {}
        for i in watched:
            if i in self._resting:
                continue
            level, noise = self._levels.get(i, 0.0), float(batch.noise[i, step])
            # Rounding errors of the steps add up, half a spacing each. At the end of the run no later step can decide.
            noise = max(noise, float(batch.edge[i, step + 1]) / NOISE_HALVES * (steps_before + step)) if last else noise
            traces[i] = trace(
                sample, i, noise, self._sides[i], level=level, starting=i in starting, last=last, isolate=self._isolate
            )
            if begun is not None and i in begun.jumped:
                # The jump at which this step begins may be found again at once: it is left out.
                later = (root for root in traces[i].zeros if not root.jump or root.time > SMALL_FRACTION)
                traces[i] = replace(traces[i], zeros=tuple(later))
        if begun is not None and self._changes_at_once(begun, {i: traces[i] for i in starting if i in traces}, sample):
            return _cut(batch, step, sample, 0.0)
        resting = frozenset(i for i in starting if i in self._resting and self.events[i].reset)
        self._start = replace(begun, rested=resting) if begun is not None and resting else None
        zeros = [EventZero(i, root) for i, step_zeros in traces.items() for root in step_zeros.zeros]
        zeros.sort(key=lambda zero: zero.root.time)
        without = min(traces, key=lambda i: traces[i].until, default=0)
        until = traces[without].until if traces else math.inf
        early = [zero for zero in zeros if zero.root.time < until]
        first = self.change_among(early, self.events)
        if first is not None:
            self._part(first, zeros, traces, sample, steps_before + step)
            return _cut(batch, step, sample, first.root.time)
        self._record(early, sample, steps_before + step)
        if until < math.inf:
            value = float(sample.events(np.array([until]))[without, 0])
            self._verdict = without_value(self.names()[without], value)
            return _cut(batch, step, sample, until)
        for i, step_zeros in traces.items():
            self._sides[i] = step_zeros.after
            value = float(batch.ends[i, step + 1])
            if abs(value) > CLEAR_FACTOR * abs(self._levels.get(i, 0.0)) and value * step_zeros.after.sign > 0:
                self._levels.pop(i, None)
        return None

    def _at_zero(self, batch: StepBatch, step: int, watched: Sequence[int]) -> list[int]:
        """Return the indices of the events whose functions are zero at the start of a smooth piece of motion.

        The list is empty if the step does not begin there. `step` is the index of the step in the `batch`, and
        `watched` are the indices of the events to test. The values of the returned events are stored, since `_step`
        subtracts them. An event with a known sign is not returned: its zeros are found as on any other step.
        """
        begun, ends = self._start, batch.ends[:, step]
        if begun is None:
            return []
        if begun.rested:
            starting = [i for i in watched if i in begun.rested]
        else:
            sizes = {i: max(float(batch.edge[i, step]), 4 * begun.zero_sizes.get(i, 0.0)) for i in watched}
            contacts = [i for i in watched if self.events[i].contact and i not in begun.zeros]
            sizes |= {i: max(sizes[i], zero_size(batch, step, i, self.problem.t1 - self.problem.t0)) for i in contacts}
            starting = [i for i in watched if self._sides[i].sign == 0 and abs(ends[i]) <= sizes[i]]
            self._levels = {}
        self._levels.update((i, float(ends[i])) for i in starting)
        return starting

    def _changes_at_once(self, begun: MotionStart, starting: Mapping[int, StepZeros], sample: Sample) -> bool:
        """Return True if an event acts, or the run ends, at the start of a smooth piece of motion.

        There are two cases: the motion passes through the zero of a contact, or it still passes through a zero whose
        reset has just acted. `begun` describes the start, and `sample` is the first step. `starting` maps the index of
        each event that starts at zero with an undecided sign to its zeros on the step.
        """
        for i, found_zeros in starting.items():
            sign, order = found_zeros.leaving
            back = self.events[i].reset and sign == begun.zeros.get(i, 0) != 0
            entered = self.events[i].contact and i not in begun.zeros and self.events[i].direction == sign
            if not (back or entered):
                continue
            # A path of low order, as at the start of multistep methods, may begin opposite to the velocity of the
            # state.
            along = sign * velocity(sample, i) if order == 1 and i not in begun.rested else 0.0
            if along < 0:
                self._verdict = unresolved(self.names()[i])
            elif not back:
                passes = still_passes(self.problem.model, self.kernel, self.events, i, sample)
                self._pending += [] if passes else [EventZero(i, Root(0.0, sign))]
            elif along == 0:
                self._verdict = at_rest(self.names()[i])
        return bool(self._pending) or self._verdict is not None

    def _part(
        self,
        first: EventZero,
        zeros: Sequence[EventZero],
        traces: Mapping[int, StepZeros],
        sample: Sample,
        steps_before: int,
    ) -> None:
        """Record the events on a step before the zero `first`, whose event resets the state or ends the run.

        The events at the time of `first` become pending. `zeros` are all zeros on the step, in order. `traces` has, by
        index of the event, the zeros and signs of each event function on the step. `sample` is the step, and
        `steps_before` is the number of steps before it.
        """
        s = first.root.time
        close = TOGETHER * max(abs(sample.t / sample.h), s)
        jump = max(close, SAME_JUMP) if first.root.jump else close
        simultaneous = [zero for zero in zeros if abs(zero.root.time - s) <= (jump if zero.root.jump else close)]
        mine = {zero.which: zero for zero in reversed(simultaneous)}
        before = [zero for zero in zeros if zero.root.time < s - close and zero not in simultaneous]
        for i, step_zeros in traces.items():
            # A contact within its noise of zero keeps its side: it may act after this change.
            step_roots, side = ended(step_zeros, s, self._isolate, decided=not self.events[i].reset)
            self._sides[i] = side
            at_end = [root for root in step_roots if root.time >= s - close]
            if at_end and i not in mine:
                # Another event within `close` of this time occurs at exactly this time, not before it.
                mine[i] = EventZero(i, Root(s, at_end[0].rising))
            early = [zero for zero in before if zero.which == i][: len(step_roots) - len(at_end)]
            self._record(early, sample, steps_before)
        self._pending = [mine[i] for i in sorted(mine)]

    def _record(self, zeros: Iterable[EventZero], sample: Sample, steps_before: int) -> None:
        """Record the events on a step: the zeros whose direction counts for their event.

        `sample` is the step, and `steps_before` is the number of steps before it.
        """
        for zero in zeros:
            if self.events[zero.which].counts(zero.root.rising):
                s = zero.root.time
                self.occurrences[zero.which].append(sample.t + s * sample.h, sample.state(s), steps_before + 1)

    def _jump(self, zeros: Sequence[EventZero], all_zeros: Sequence[EventZero], state: DriverState) -> EventResult:
        """Reset the state by the events in `zeros`, and begin a new smooth piece of motion.

        `all_zeros` has the zeros of all events at this time. The result says whether the run ends here.
        """
        before, model = state.y.copy(), self.problem.model
        values = self.kernel(state.t, before, self.parameters)
        resets = {self.events[zero.which]: zero.which for zero in zeros}
        after, broken = reset_state(resets, self.names, state.t, before, self.parameters)
        if broken.status is not None:
            return broken
        smooth = [zero for zero in zeros if not zero.root.jump]
        along = math.copysign(1.0, self.problem.t1 - self.problem.t0)
        through = wrong_side_reset(self._rates(), smooth, self.parameters, state.t, (before, after), along)
        # The end of a flight of one step follows from its velocity. Only in a longer flight is the height searched for
        # zeros; it may be within its noise.
        several = state.count(S.STEPS) > self._changed_at + 1
        unseen = several and any(zero.which in self._levels for zero in zeros)
        if self._intervals.idle(abs(state.t - self.changed), unseen=unseen):
            through = zeros[0]
        if through is not None:
            return unresolved(self.names()[through.which])
        state.y[:] = after
        # Events that occurred at this time before, or stay zero, still count as zero, but may occur again.
        earlier = {i: abs(float(values[i])) for i in self._resting if self.events[i].contact}
        earlier |= self._zero_sizes if self.jumps and state.t == self.changed else {}
        self.jumps += 1
        self.changed, self._changed_at = state.t, state.count(S.STEPS)
        met = {zero.which: zero.root.rising for zero in all_zeros if not zero.root.jump}
        self._zero_sizes = {**earlier, **{i: abs(float(values[i])) for i in met}}
        jumped = frozenset(zero.which for zero in all_zeros if zero.root.jump)
        self._start = MotionStart(zero_sizes=self._zero_sizes, zeros=met, jumped=jumped)
        result = self._defined(state)
        moved = self.kernel(state.t, after, self.parameters)
        noise = state_noise(self.kernel, self.parameters, np.array([state.t]), before[:, None], values[:, None])[:, 0]
        occurred_now = {zero.which for zero in all_zeros} | earlier.keys()
        self._sides = sides_after_events(self._sides, self.events, (values, moved), noise, occurred_now)
        where = (state.t, *model.layout.split(after), self.parameters)
        if result.status is None and model.column_without_inertia(*where) is not None:
            return EventResult(Status.SINGULAR, jumped=True)
        return EventResult(result.status, result.detail, jumped=True)


def _cut(batch: StepBatch, step: int, sample: Sample, s: float) -> Cut:
    """Return the point to which a run is set back, at the fraction s of step number `step` of a batch.

    `sample` is this step. At s = 0 and s = 1 the point is an accepted state, and no step is shortened.
    """
    times, states = batch.path.times, batch.path.states
    if s == 0:
        return Cut(step, float(times[step]), states[step], sample.h)
    end = float(times[step + 1])
    if s == 1:
        return Cut(step + 1, end, states[step + 1], sample.h)
    return Cut(step + 1, sample.t + s * sample.h, sample.state(s), sample.h, (end, states[step + 1].copy()))
