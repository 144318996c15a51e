"""Events along the steps of a step program, located on the dense output of each step.

Some steps are taken first and then reviewed, that is, searched for events. If an event on them resets the state or
ends the run, the run is set back to it, and later steps are discarded. In long runs machine code handles all regular
events. Other steps are reviewed on arrays.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lagrange.algorithm.events.constants import CLEAR_FACTOR, FIRST_LOOK, LONGEST_LOOK, NOISE_HALVES, TOGETHER
from lagrange.algorithm.events.event_steps import GO_ON, LOOK, MOST_WAITING, READ_EVENTS, Waiting
from lagrange.algorithm.events.roots import roots
from lagrange.algorithm.events.step_zeros import IGNORED, UNKNOWN
from lagrange.errors import formula
from lagrange.machine.backend import Driver, Kernel
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.step_events import EventSteps
from lagrange.trajectory.events.actions import rates, reset_state
from lagrange.trajectory.events.end_messages import (
    EventResult,
    accumulating,
    at_rest,
    undefined,
    unresolved,
    without_value,
)
from lagrange.trajectory.events.event_log import Breaks, ChangeCounter, EventLog, ResetIntervals
from lagrange.trajectory.events.event_loop import WatchedEvents
from lagrange.trajectory.events.motion_start import (
    SMALL_FRACTION,
    MotionStart,
    entry,
    lie,
    sent_through,
    sides_after_events,
    still_passes,
)
from lagrange.trajectory.events.step_batch import PathOf, Sample, StepBatch, StepsPath, Window, state_noise
from lagrange.trajectory.events.zeros_on_step import (
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
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.paths.step_paths import StepPath
from lagrange.trajectory.trajectory import FloatArray, Status

S = DriverState


@dataclass(frozen=True, eq=False)
class Cut:
    """Point to which a run is set back: `steps` steps are kept, the last one up to time t and state y (2n,).

    `length` is the length of the step that contains the point or begins there. `whole` is the former end (time and
    state) of a step that is shortened, or None. A `late` cut has no event: the time limit was reached.
    """

    steps: int
    t: float
    y: FloatArray
    length: float
    whole: tuple[float, FloatArray] | None = None
    late: bool = False


class EventDriver:
    """Advances a run like the driver of its steps, but only up to an event that resets the state or ends the run."""

    def __init__(self, driver: Driver, watch: StepWatch, *, fixed: bool) -> None:
        self._driver, self._watch, self._fixed = driver, watch, fixed
        self._memory, self._run = watch.shared, watch.shared.run
        self._run.ahead = FIRST_LOOK if watch.resets else LONGEST_LOOK
        self._run.fixed = int(fixed)
        self._compiled: EventSteps | None = None
        self._next_left, self._left_to_arrays, self._reviewed = 1, 0, 0
        self._first = self._stale = True

    def adopt(self, state: DriverState) -> None:
        """Do nothing. Only a driver by Taylor series replaces the array `state.y` by its own."""

    def advance(self, state: DriverState, budget: int, times: FloatArray, rows: FloatArray) -> Outcome:
        """Advance a run by at most `budget` steps; write accepted times and states to `times` (k,), `rows` (k, 2n).

        The outcome is WATCHED if the state is at an event that resets it or ends the run.
        """
        run = self._run
        run.budget = run.left = budget
        self._memory.keep(state)
        try:
            while True:
                few = self._watch.ends or self._compiled is None
                run.longest = LONGEST_LOOK if few else MOST_WAITING
                compiled = self._compiled is not None and not self._left_to_arrays and self._watch.regular
                outcome = (self._in_loop if compiled else self._on_arrays)(state, times, rows)
                if outcome is not None:
                    return outcome
        except KeyboardInterrupt:
            self._watch.collect()
            self._forget(state)
            raise
        finally:
            self._first = False

    def _in_loop(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Advance the run by machine code. Return an outcome, or None after a step that must be searched on arrays.

        Accepted times and states are written to `times` (k,) and `rows` (k, 2n); k is their capacity.
        """
        if self._compiled is None:
            raise AssertionError("there is machine code")
        if self._stale:
            self._watch.write()
        code = self._compiled(state, self._memory, times, rows)
        self._watch.read()
        self._stale = code in (LOOK, Outcome.WATCHED)
        if code == READ_EVENTS:
            return None
        if code != LOOK:
            return Outcome(code)
        if self._memory.reviewed > self._reviewed:
            self._next_left = 1
        self._leave_to_arrays()
        return None

    def _leave_to_arrays(self) -> None:
        """Choose the number of next steps to search on arrays, not by machine code: 1, then twice the last number."""
        self._left_to_arrays, self._next_left = self._next_left, min(2 * self._next_left, LONGEST_LOOK)

    def _on_arrays(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Outcome | None:
        """Take steps if all earlier ones are searched, and search some steps for events on NumPy arrays.

        Return an outcome, or None to continue. Accepted times and states are written to `times` (k,) and `rows` (k,
        2n).
        """
        memory, run, waiting = self._memory, self._run, self._waiting(state, times, rows)
        if not memory.waits:
            if run.starts and self._is_compiled(state.t, state.count(S.STEPS)):
                return None
            code = waiting.take()
            if code != GO_ON:
                return Outcome(code)
            if self._first and self._is_compiled(memory.times[run.count + 1], memory.taken + run.count):
                return None
        if self._compiled is not None and not self._left_to_arrays and memory.waits:
            self._leave_to_arrays()
        count = run.count - run.begin + 1
        count = min(count, self._left_to_arrays) if self._compiled is not None else count
        self._left_to_arrays = max(0, self._left_to_arrays - count)
        return self._look(state, run.begin + count - 1, waiting)

    def _is_compiled(self, t: float, steps: int) -> bool:
        """Return True if this call compiled the loop over steps with events. It does so if that saves time.

        This is decided only in the first call and at the start of a smooth piece of motion. The number of steps in
        other calls depends on measured times, but the digits of events must not depend on measured times.
        """
        if self._compiled is None:
            watch, driver = self._watch, self._driver
            self._compiled = watch.memory.compiled(
                watch.problem, driver, float(t), steps, watch.jumps, fixed=self._fixed
            )
            return self._compiled is not None
        return False

    def _waiting(self, state: DriverState, times: FloatArray, rows: FloatArray) -> Waiting:
        """Return the steps not yet searched for events, the driver, and the arrays for accepted steps, as one object.

        The procedures of the event loop take this object. The arrays are `times` (k,) and `rows` (k, 2n).
        """
        memory, size = self._memory, len(state.y)

        def drive(*arguments: Any) -> Outcome:
            try:
                return self._driver.advance(state, arguments[4], memory.times[2:], memory.states[2:])
            except KeyboardInterrupt:
                state.counts[:], state.reals[:], state.y[:] = memory.kept_counts, memory.kept_reals, memory.states[1]
                raise

        steps = self._run, size, memory.times, memory.states.reshape(-1), drive, state.counts
        numbers = state.floats, state.integers, memory.kept_reals, memory.kept_counts
        arguments: Any = *steps, *numbers, state.y, np.arange(size), state.y, times, rows.reshape(-1)
        return Waiting(*arguments)

    def _forget(self, state: DriverState) -> None:
        """Discard the steps not yet searched for events. The driver state is set back to the time before them."""
        memory, run = self._memory, self._run
        if memory.waits:
            state.reals[:], state.counts[:], state.y[:] = memory.kept_reals, memory.kept_counts, memory.states[1]
            run.count, run.begin, run.before = 0, 1, 0
            state.fault = None

    def _look(self, state: DriverState, last: int, waiting: Waiting) -> Outcome | None:
        """Find the events on the steps up to number `last`, on arrays. Return an outcome, or None to continue.

        When all steps are searched, they are accepted. If an event resets the state or ends the run, the run is set
        back to this event. `waiting` has the steps.
        """
        memory, run = self._memory, self._run
        if not memory.waits:
            return None
        shift = 1 - run.before
        rows = slice(shift, run.count + 2)
        path = memory.times[rows].copy(), memory.states[rows].copy()
        cut = self._watch.review(*path, run.begin - shift, last + 1 - shift, memory.taken - 1 + shift)
        if cut is not None:
            self._set_back(state, cut, cut.steps - 1 + shift, waiting)
            return Outcome.PAUSED if cut.late else Outcome.WATCHED
        run.begin, run.starts = last + 1, 0
        self._reviewed = self._memory.reviewed
        if memory.waits:
            return None
        code = waiting.accept()
        return None if code == GO_ON else Outcome(code)

    def _set_back(self, state: DriverState, cut: Cut, steps: int, waiting: Waiting) -> None:
        """Set the driver state back to the point `cut`, where the next smooth piece of motion begins.

        `waiting` has the steps not yet accepted. Its first `steps` steps are kept, and later ones are discarded.
        """
        memory, run, count = self._memory, self._run, len(state.floors)
        state.fault = None
        run.changed = self._watch.changed
        waiting.go_back(steps, cut.t, cut.y, cut.length)
        sizes = np.abs(memory.states[2 : steps + 2, :count]).max(axis=0, initial=0.0)
        np.maximum(memory.kept_reals[S.FLOORS :][:count], state.reals[S.SHARE] * sizes, out=state.floors)
        run.starts, self._next_left, self._left_to_arrays = 1, 1, 0
        self._watch.whole = cut.whole


class StepWatch(EventLog):
    """Finds the events along one run by a step program, and handles them: records, resets, ends of the run."""

    def __init__(
        self, problem: Problem, driver: Driver, path_of: PathOf, memory: WatchedEvents | None = None, *, fixed: bool
    ) -> None:
        super().__init__(len(problem.events), len(problem.y0))
        self.problem, self.parameters = problem, problem.parameter_array
        if memory is None:
            memory = WatchedEvents.of(problem)
        else:
            memory.memory.restart()
        self.memory, self.kernel, self.impacts = memory, memory.kernel, memory.impacts
        self.shared, self._path_of = memory.memory, path_of
        self.driver = EventDriver(driver, self, fixed=fixed)
        self.breaks = Breaks(len(problem.y0))
        self.change_counter = ChangeCounter()
        self.jumps = 0
        self.changed = problem.t0
        self._changed_at = 0
        self._intervals = ResetIntervals()
        self._sides = [Side()] * len(self.impacts)
        self._levels: dict[int, float] = {}
        self._stayed: Mapping[int, float] = {}
        self._resting: frozenset[int] = frozenset()
        self._start: MotionStart | None = MotionStart(first=True)
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
        return any(impact.reset for impact in self.impacts)

    @property
    def ends(self) -> bool:
        """True if an event may reset the state or end the run: then steps after it are discarded."""
        return any(impact.reset or impact.terminal for impact in self.impacts)

    def names(self) -> list[str]:
        """Return the names of the events, in the user's symbols."""
        plain = dict(self.problem.model.statement.plain)
        return [formula(event.expression.xreplace(plain), 80) for event in self.problem.events]

    def begin(self, state: DriverState) -> EventResult:
        """Begin to watch a run at its start; return the end of the run if an event function has no value there."""
        self.state = state
        limit = self.problem.max_wall
        self._deadline = math.inf if limit is None else time.perf_counter() + limit
        path = self.memory.path(self._path_of, np.array([state.t]), state.y[None].copy())
        self.shared.run.final = self.problem.t1
        # The path over a step may also use a slope of the previous step, and that over the first one of the next step.
        self.shared.run.both = int(isinstance(path, StepPath) and path.kind.derivative)
        return self._defined(state)

    def process(self, state: DriverState) -> EventResult:
        """Apply the pending events at the state to which the run was set back: record, reset the state, or end."""
        self.breaks.append(state.count(S.STEPS) + self.jumps, self.whole)
        if self._verdict is not None:
            return self._verdict
        pending, self._pending = self._pending, []
        if self.change_counter.accumulates(state.t, (m.which for m in pending)):
            return accumulating(self.names()[pending[0].which])
        zeros = [m for m in pending if self.impacts[m.which].counts(m.root.rising)]
        ends = self.occur([m.which for m in zeros], self.impacts, state)
        resets = [m for m in zeros if self.impacts[m.which].reset]
        result = self._jump(resets, pending, state) if resets else EventResult()
        return EventResult(Status.EVENT, jumped=result.jumped) if ends and result.status is None else result

    def end(self, state: DriverState) -> EventResult:
        """Return the result SUCCESS: no event is pending at the end, since the driver stops at each event."""
        return EventResult(Status.SUCCESS)

    def is_due(self, state: DriverState) -> bool:
        """Return False: the driver stops at each event that has to be processed, so none is pending elsewhere."""
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
        """True if no event function is known to be zero at the present state."""
        started = not self._levels if self._start is None else not (self._start.rested or self._start.jumped)
        return started and not self._resting

    def write(self) -> None:
        """Write the known signs of event functions, and event counts, to the memory of the compiled loop."""
        run, begun = self.shared.run, self._start
        run.starts, run.jumps = int(begun is not None), self.jumps
        run.changed, run.changed_at = self.changed, self._changed_at
        stayed, zeros = ({}, {}) if begun is None else (begun.stayed, begun.zeros)
        self.memory.write(self._sides, self.occurrences, stayed, zeros)

    def read(self) -> None:
        """Read events, resets and signs of event functions from the memory of machine code."""
        run, memory = self.shared.run, self.shared
        last = run.breaks
        self.collect()
        if run.jumps > self.jumps:
            self.jumps, self.changed, self._changed_at = int(run.jumps), float(run.changed), int(run.changed_at)
            # An event that is zero at the start has 2 plus the direction in which zero was reached.
            zeros = {i: way - 2 for i, way in enumerate(memory.came.tolist()) if way not in (UNKNOWN, IGNORED)}
            self.change_counter.begin(self.changed, next(iter(zeros), 0))
            self._intervals.begin(float(run.interval))
            self._stayed = {i: float(memory.stayed[i]) for i in zeros}
            self._start = MotionStart(stayed=self._stayed, zeros=zeros)
        pairs = zip(memory.sign.tolist(), memory.near.tolist(), strict=True)
        self._sides, self._levels = [Side(sign, bool(near)) for sign, near in pairs], {}
        self._start = self._start if run.starts else None
        if run.due:
            self._pending, run.due = [EventZero(int(run.due) - 1, Root(0.0, int(run.way)))], 0
            end = float(memory.break_times[last])
            self.whole = None if math.isnan(end) else (end, memory.break_states[last].copy())

    def collect(self) -> None:
        """Read only the events and resets from the memory of machine code."""
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
            watched = [i for i in range(len(self.impacts)) if i in unsettled or doubtful[i, step]]
            cut = self._step(batch, step, watched, steps_before)
            if cut is not None:
                return cut
            step += 1
            if step < len(times) - 1 and time.perf_counter() > self._deadline:
                return replace(_cut(batch, step - 1, batch.sample(step - 1), 1.0), late=True)

    def _rates(self) -> Kernel:
        """Return the kernel of the time derivatives of the event functions along the motion, compiled at first use."""
        model = self.problem.model
        return model.function("rates", rates(model.equations, tuple(impact.node for impact in self.impacts)))

    def _defined(self, state: DriverState) -> EventResult:
        values = self.kernel(state.t, state.y, self.parameters)
        return EventResult() if np.isfinite(values).all() else undefined(self.names(), values[None])

    def _step(self, batch: StepBatch, step: int, watched: Sequence[int], steps_before: int) -> Cut | None:
        """Record the zeros of events on a step up to the first one with a reset or an end; return this point or None.

        `watched` are the indices of the events that may be zero. `steps_before` counts the steps before the batch.
        """
        sample, begun = batch.sample(step), self._start
        last = bool(batch.path.times[step + 1] == self.problem.t1)
        zero = self._at_zero(batch, step, watched)
        candidates = self._resting if begun is None or begun.rested else zero
        lying = set() if begun is None else lie(begun, self.impacts, sample)
        self._resting = frozenset(i for i in candidates if i in lying or rests(batch, step, sample, i))
        traces = {}
        for i in watched:
            if i in self._resting:
                continue
            level, noise = self._levels.get(i, 0.0), float(batch.noise[i, step])
            # Rounding errors of the steps add up, half a spacing each. At the end of the run no later step can decide.
            noise = max(noise, float(batch.edge[i, step + 1]) / NOISE_HALVES * (steps_before + step)) if last else noise
            traces[i] = trace(
                sample, i, noise, self._sides[i], level=level, zero=i in zero, last=last, isolate=self._isolate
            )
            if begun is not None and i in begun.jumped:
                # An earlier jump repeats in the first fraction of the step.
                later = (root for root in traces[i].zeros if not root.jump or root.time > SMALL_FRACTION)
                traces[i] = replace(traces[i], zeros=tuple(later))
        if begun is not None and self._changes_at_once(begun, {i: traces[i] for i in zero if i in traces}, sample):
            return _cut(batch, step, sample, 0.0)
        resting = frozenset(i for i in zero if i in self._resting and self.impacts[i].reset)
        self._start = replace(begun, rested=resting) if begun is not None and resting else None
        zeros = [EventZero(i, root) for i, step_zeros in traces.items() for root in step_zeros.zeros]
        zeros.sort(key=lambda m: m.root.time)
        without = min(traces, key=lambda i: traces[i].until, default=0)
        until = traces[without].until if traces else math.inf
        first = self.first_change((m for m in zeros if m.root.time < until), self.impacts)
        if first is not None:
            self._part(first, zeros, traces, sample, steps_before + step)
            return _cut(batch, step, sample, first.root.time)
        self._record((m for m in zeros if m.root.time < until), sample, steps_before + step)
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
        """Return the events that are zero at the start of a smooth piece of motion, if the step begins there.

        `watched` are the indices of the events to test. The values of their functions are stored. An event with a
        known sign at the start is not included: its zeros are found as on any other step.
        """
        begun, ends = self._start, batch.ends[:, step]
        if begun is None:
            return []
        if begun.rested:
            zero = [i for i in watched if i in begun.rested]
        else:
            sizes = {i: max(float(batch.edge[i, step]), 4 * begun.stayed.get(i, 0.0)) for i in watched}
            contacts = [i for i in watched if self.impacts[i].contact and i not in begun.zeros]
            sizes |= {i: max(sizes[i], entry(batch, step, i, self.problem.t1 - self.problem.t0)) for i in contacts}
            zero = [i for i in watched if self._sides[i].sign == 0 and abs(ends[i]) <= sizes[i]]
            self._levels = {}
        self._levels.update((i, float(ends[i])) for i in zero)
        return zero

    def _changes_at_once(self, begun: MotionStart, zero: Mapping[int, StepZeros], sample: Sample) -> bool:
        """Return True if an event acts, or the run ends, at the start of a smooth piece of motion.

        There are two cases: the motion passes through the zero of a contact, or it still passes through a zero whose
        reset has just acted. `begun` describes the start, and `sample` is the first step. `zero` maps the index of
        each event that starts at zero with an undecided sign to its zeros on the step.
        """
        for i, found_zeros in zero.items():
            sign, order = found_zeros.leaving
            back = self.impacts[i].reset and sign == begun.zeros.get(i, 0) != 0
            entered = self.impacts[i].contact and i not in begun.zeros and self.impacts[i].direction == sign
            if not (back or entered):
                continue
            # A path of low order, as at the start of multistep methods, may begin opposite to the velocity of the
            # state.
            along = sign * velocity(sample, i) if order == 1 and i not in begun.rested else 0.0
            if along < 0:
                self._verdict = unresolved(self.names()[i])
            elif not back:
                passes = still_passes(self.problem.model, self.kernel, self.impacts, i, sample)
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

        The events at the time of `first` become pending. `zeros` are all zeros on the step, in order. `traces` has,
        by index of the event, the zeros and signs of each event function on the step.
        """
        s = first.root.time
        close = TOGETHER * max(abs(sample.t / sample.h), s)
        jump = max(close, SAME_JUMP) if first.root.jump else close
        simultaneous = [m for m in zeros if abs(m.root.time - s) <= (jump if m.root.jump else close)]
        mine = {m.which: m for m in reversed(simultaneous)}
        before = [m for m in zeros if m.root.time < s - close and m not in simultaneous]
        for i, step_zeros in traces.items():
            # A contact within its noise of zero keeps its side, and may act after this change.
            step_roots, side = ended(step_zeros, s, self._isolate, decided=not self.impacts[i].reset)
            self._sides[i] = side
            at_end = [root for root in step_roots if root.time >= s - close]
            if at_end and i not in mine:
                # Another event that is zero at this time occurs at this time, and is not recorded before it.
                mine[i] = EventZero(i, Root(s, at_end[0].rising))
            early = [m for m in before if m.which == i][: len(step_roots) - len(at_end)]
            self._record(early, sample, steps_before)
        self._pending = [mine[i] for i in sorted(mine)]

    def _record(self, zeros: Iterable[EventZero], sample: Sample, steps_before: int) -> None:
        """Record those zeros on a step at which an event occurs: their direction is one that counts for the event.

        `sample` is the step, and `steps_before` is the number of steps before it.
        """
        for m in zeros:
            if self.impacts[m.which].counts(m.root.rising):
                s = m.root.time
                self.occurrences[m.which].append(sample.t + s * sample.h, sample.state(s), steps_before + 1)

    def _jump(self, zeros: Sequence[EventZero], all_zeros: Sequence[EventZero], state: DriverState) -> EventResult:
        """Reset the state by the events in `zeros`, and start a new motion. `all_zeros` are all at this time."""
        before, model = state.y.copy(), self.problem.model
        values = self.kernel(state.t, before, self.parameters)
        resets = {self.impacts[m.which]: m.which for m in zeros}
        after, broken = reset_state(resets, self.names, state.t, before, self.parameters)
        if broken.status is not None:
            return broken
        smooth = [m for m in zeros if not m.root.jump]
        along = math.copysign(1.0, self.problem.t1 - self.problem.t0)
        through = sent_through(self._rates(), smooth, self.parameters, state.t, (before, after), along)
        # A flight of one step ends where its velocity says; the end of a longer flight depends on rounded heights.
        several = state.count(S.STEPS) > self._changed_at + 1
        unseen = several and any(m.which in self._levels for m in zeros)
        if self._intervals.idle(abs(state.t - self.changed), unseen=unseen):
            through = zeros[0]
        if through is not None:
            return unresolved(self.names()[through.which])
        state.y[:] = after
        # Events that occurred here before, or rest, still count as zero, but may occur again.
        earlier = {i: abs(float(values[i])) for i in self._resting if self.impacts[i].contact}
        earlier |= self._stayed if self.jumps and state.t == self.changed else {}
        self.jumps += 1
        self.changed, self._changed_at = state.t, state.count(S.STEPS)
        met = {m.which: m.root.rising for m in all_zeros if not m.root.jump}
        self._stayed = {**earlier, **{i: abs(float(values[i])) for i in met}}
        self._start = MotionStart(
            stayed=self._stayed,
            zeros=met,
            jumped=frozenset(m.which for m in all_zeros if m.root.jump),
        )
        result = self._defined(state)
        moved = self.kernel(state.t, after, self.parameters)
        noise = state_noise(self.kernel, self.parameters, np.array([state.t]), before[:, None], values[:, None])[:, 0]
        happened = {m.which for m in all_zeros} | earlier.keys()
        self._sides = sides_after_events(self._sides, self.impacts, (values, moved), noise, happened)
        where = (state.t, *model.layout.split(after), self.parameters)
        if result.status is None and model.column_without_inertia(*where) is not None:
            return EventResult(Status.SINGULAR, jumped=True)
        return EventResult(result.status, result.detail, jumped=True)


def _cut(batch: StepBatch, step: int, sample: Sample, s: float) -> Cut:
    """Return the point to which a run is set back, at the fraction s of step number `step`."""
    times, states = batch.path.times, batch.path.states
    if s == 0:
        return Cut(step, float(times[step]), states[step], sample.h)
    end = float(times[step + 1])
    if s == 1:
        return Cut(step + 1, end, states[step + 1], sample.h)
    return Cut(step + 1, sample.t + s * sample.h, sample.state(s), sample.h, (end, states[step + 1].copy()))
