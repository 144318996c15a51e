"""Members that run by the steps of an explicit step program, with error control or equal."""

from __future__ import annotations

from typing import Any

from lagrange.procedure.bind import bound
from lagrange.procedure.form import Procedure
from lagrange.procedure.members.queue import Members, Numbers, Observed
from lagrange.procedure.step.controlled_steps import steps_of
from lagrange.procedure.step.memory import EFFORT, Layout
from lagrange.procedure.values import Flag, Memory, Whole
from lagrange.program.step import StepProgram


class StepMembers(Members):
    """Runs by the steps that the driver of single runs takes, with the law of the step program in a function."""

    def __init__(
        self,
        step: StepProgram,
        dimension: int,
        law: Procedure,
        numbers: Numbers,
        observed: Observed,
    ) -> None:
        super().__init__(dimension, numbers, observed)
        p = self.p
        self.program, self.law = step, law
        self.layout = Layout(step, dimension, block=1)
        self.work = p.reserve(self.layout.size, name="work")
        self.effort: Any = p.reserve_record(EFFORT)
        self.none = p.reserve(1, name="none")
        self.trials = self.budget if step.control is None else p.whole(1)

    @property
    def state(self) -> list[Memory]:
        """The state, or coordinates and velocities apart."""
        return [self.work.at(self.layout.place(k)) for k in range(self.program.states)]

    def begin(self) -> None:
        """Clear what the law reads and a step does not write: velocities, where it moves coordinates alone."""
        if self.program.law == "accelerations":
            velocities = self.work.at(self.layout.argument + self.layout.length)
            with self.p.each(self.layout.length, width=1) as i:
                velocities[i] = 0.0

    def advance(self, last: Flag) -> Whole:
        """Take a trial step, or all of equal length: then all members are done at once."""
        p = self.p
        given = {"parameters": self.held, "constants": self.held, "run": self.run, "counts": self.counts}
        given |= {"floors": self.floors, "effort": self.effort, "work": self.work}
        given |= {"budget": self.trials, "times": self.none, "rows": self.none}
        steps = bound(steps_of(self.layout), {"law": self.law, "jacobian": self.law}, prefix="run_")
        found: Whole = p.call(steps, *(given[one.name] for one in steps.parameters))
        return found
