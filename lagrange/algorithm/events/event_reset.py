"""Reset the state at an event that steps have reached, and start a new motion."""

from __future__ import annotations

import math

from lagrange.algorithm.dense.block import LANES
from lagrange.algorithm.events.constants import ALONG, CLEARLY, CLOSEST
from lagrange.algorithm.events.event_run import (
    RESET_AT,
    RESET_SIZE,
    SETTINGS,
    UNTIL_END,
    EventRun,
    count,
    number,
)
from lagrange.algorithm.events.step_zeros import ANYHOW, UNKNOWN
from lagrange.algorithm.step.constants import EARLIEST
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.shared import shared
from lagrange.procedure.values import Flag, Memory, Real, Whole


@shared
def reset() -> Procedure:
    """Return the procedure that applies the reset that is due at the state, if it is regular.

    Its result is true if the reset was applied. If it is false, nothing has changed.
    """
    return _Reset().build()


class _Reset:
    """Builds the procedure. Its `scratch` holds the new state, the events before and after, and all resets."""

    def __init__(self) -> None:
        self.p = p = Builder("reset_at_event", "Reset the state at an event, if that is regular.", apart=True)
        self.given = EventRun(p)
        self.run, self.samples = self.given.run, self.given.samples
        self.reals, self.counts = self.given.reals, self.given.counts

    def build(self) -> Procedure:
        p, run, given = self.p, self.run, self.given
        self.samples.lay_out()
        event: Whole = (run.due - 1).called("event")
        self.t: Real = self.reals[number("t")].called("time")
        self.after, self.before_values = given.scratch, given.scratch.at(given.dimension)
        self.values = self.before_values.at(self.samples.events)
        size = given.setting(RESET_SIZE, event)[0]
        self.leave_if(size.equals(0) | run.resets.equals(0) | given.setting(UNTIL_END, event)[0].equals(1))
        since = abs(self.t - run.changed)
        self.leave_if((run.jumps > 0) & ~(since > CLOSEST * p.larger(abs(self.t), EARLIEST)))
        self.write_new_state(event, size)
        self.leave_if(given.values(self.t, given.y, given.value_numbers, self.before_values))
        self.leave_if(given.values(self.t, self.after, given.value_numbers, self.values))
        total = p.variable(0.0, "total")
        with p.loop(0, self.samples.events) as e:
            total.value = p.fma(0.0, self.values[e], total.value)
        self.leave_if(~total.value.equals(0.0))
        self.leave_unless_passing(event)
        self.commit(event)
        p.leave(p.true)
        return p.finish(FLAG)

    def leave_if(self, condition: Flag) -> None:
        """Return false on a condition, so that the caller handles the event."""
        self.p.leave_if(condition, self.p.false, likely=False)

    def write_new_state(self, event: Whole, size: Whole) -> None:
        """Write the state after the reset."""
        given, found = self.given, self.values.at(self.samples.events)
        given.copy(given.y, self.after, given.dimension)
        self.leave_if(given.resets(self.t, given.y, given.reset_numbers, found))
        first, entries = given.setting(RESET_AT, event)[0], given.settings.at(self.samples.events * SETTINGS)
        with self.p.loop(first, first + size) as j:
            self.after[entries[j]] = found[j]
            self.leave_if(~(abs(found[j]) < math.inf))

    def leave_unless_passing(self, event: Whole) -> None:
        """Return false unless the motion passes zero as its path does, and if the mass matrix is singular after it.

        The path of a long step may come down to the floor with a velocity that rises already: reset, it would fall.
        """
        p, run, given, samples = self.p, self.run, self.given, self.samples
        line, slopes = samples.own.y, samples.state
        half = given.dimension // 2 * LANES
        with p.loop(0, LANES) as b:
            samples.time[b] = self.t
            with p.loop(0, given.dimension) as j:
                line[j * LANES + b] = p.choose(b.equals(1), self.after[j], given.y[j])
        self.leave_if(samples.law(LANES, samples.time, line, line.at(half), samples.law_parameters, slopes) >= 0)
        h: Real = (self.step_length() * ALONG).called("h")
        with p.loop(0, LANES) as b:
            along = p.choose(b.equals(0), -h, p.choose(b.equals(1), h, 0.0))
            tilted = b.equals(2)
            samples.time[b] = p.choose(tilted, self.t * samples.moved(-1), self.t + along)
            with p.loop(0, given.dimension) as j:
                y, slope = given.y[j], slopes[j * LANES]
                line[j * LANES + b] = p.choose(tilted, y * samples.moved(j), y + along * slope)
        found = samples.lines["missed"]
        given_to = samples.time, line, line.at(half), samples.parameters, found
        self.leave_if(samples.kernel(LANES, *given_to) >= 0)
        mine = found.at(event * LANES)
        noise = samples.edge(self.before_values[event], mine[2])
        passes = (mine[1] - mine[0]) * p.real(run.way) > CLEARLY * noise
        self.leave_if(~(run.way.equals(0) | passes))

    def step_length(self) -> Real:
        """Return the length of a step from here, in the direction of the run."""
        p, fixed = self.p, ~self.run.fixed.equals(0)
        return p.real(p.choose(fixed, self.reals[number("step")], self.reals[number("h")]))

    def commit(self, event: Whole) -> None:
        """Keep the event and the new state, and begin a motion there."""
        p, run, given, review = self.p, self.run, self.given, self.given.review
        review.which[review.record.found] = event
        review.record.found = review.record.found + 1
        left: Memory = given.setting(UNTIL_END, event)
        left[0] = left[0] - 1
        row = self.counts[count("rows")]
        given.row_times[row] = self.t
        given.copy(self.after, given.row_states.at(row * given.dimension), given.dimension)
        given.copy(self.after, given.y, given.dimension)
        self.counts[count("rows")] = row + 1
        run.interval = abs(self.t - run.changed)
        run.changed, run.changed_at = self.t, self.counts[count("steps")]
        run.jumps, run.breaks, run.left = run.jumps + 1, run.breaks + 1, run.left - 1
        with p.loop(0, self.samples.events) as e:
            mine = e.equals(event)
            self.begin_side(e, mine)
            review.stayed[e] = p.choose(mine, abs(self.before_values[e]), 0.0)
            others = p.choose(given.setting(RESET_SIZE, e)[0].equals(0), p.whole(ANYHOW), p.whole(UNKNOWN))
            review.came[e] = p.choose(mine, run.way + 2, others)
        run.starts, run.due = 1, 0

    def begin_side(self, e: Whole, mine: Flag) -> None:
        """Leave an event its side if the reset leaves it where it was; a passage that is still to count is looked for.

        See `lagrange.trajectory.events.motion_start` for the rule.
        """
        p, given, review = self.p, self.given, self.given.review
        before, after, sign, near = self.before_values[e], self.values[e], review.sign[e], review.near[e]
        noise = self.samples.edge(before, self.samples.lines["missed"][e * LANES + 2])
        stays = ~mine & (abs(after - before) <= noise)
        near = p.choose(given.setting(RESET_SIZE, e)[0].equals(0), near, 0)
        near = p.choose(p.real(sign) * after < 0.0, p.whole(1), near)
        review.sign[e], review.near[e] = p.choose(stays, sign, 0), p.choose(stays, near, 0)
