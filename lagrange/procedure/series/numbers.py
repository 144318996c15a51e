"""The numbers of a series that depend on parameters alone, and where they stand behind the parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, Procedure
from lagrange.procedure.kernel.body import Body, Inputs
from lagrange.procedure.kernel.prepared import width_of
from lagrange.procedure.series.systems import System, constant_inverse, constant_size, constant_system
from lagrange.procedure.values import Memory, Real
from lagrange.program.series import SeriesProgram


class SeriesNumbers:
    """Where the numbers of a series stand from `begin` on in the prepared array, which begins with the parameters.

    First come the constants that are not known now, then what the start has hoisted, then the inverses of constant
    matrices.
    """

    def __init__(self, program: SeriesProgram, begin: int) -> None:
        self.program, self.begin = program, begin
        unknown = [place for place, number in enumerate(program.numbers) if number is None]
        self.places = {place: k for k, place in enumerate(unknown)}
        self.slots: dict[int, int] = {}
        """Where the hoisted results of the start stand in the prepared array."""
        end = begin + len(unknown)
        for ref in program.start.saved:
            self.slots[ref] = end
            end += width_of(program.start, ref)
        self.inverses = end - begin
        constant = [stage.plan for stage in program.stages if not stage.plan.moving]
        self.size = self.inverses + sum(map(constant_size, constant))

    @property
    def given(self) -> int:
        """How many parameters there are."""
        return self.program.constants.parameters - self.program.sides

    def prepare(self) -> Procedure:
        """Return the procedure that writes the numbers behind the parameters, where these stand."""
        program = self.program
        p = Builder("prepare_taylor", "Write the numbers of the series, and say whether a constant matrix is singular.")
        held = p.array("p")
        constants = Body(p, program.constants, Inputs(held, {}))
        constants.run(range(len(program.constants.instructions)))
        found = [p.real(constants.value(ref)) for ref in program.constants.outputs]
        to = held.at(self.begin)
        for place, k in self.places.items():
            to[k] = found[place]
        start = Start(p, self, held, found)
        start.run(range(program.start.hoisted))
        for ref, slot in self.slots.items():
            start.save(ref, held, slot)
        rest, flags, begin = iter(found[len(program.numbers) :]), [p.false], self.inverses
        for stage in program.stages:
            if not stage.plan.moving:
                flags += constant_inverse(p, stage.plan, rest, to.at(begin))
                begin += constant_size(stage.plan)
        p.leave(reduce(lambda a, b: a | b, flags))
        return p.finish(FLAG)

    def constant(self, prepared: Memory, place: int) -> Real:
        """Return a constant of the table."""
        known = self.program.numbers[place]
        found: Real = prepared[self.begin + self.places[place]] if known is None else prepared.builder.real(known)
        return found

    def systems(self, p: Builder, prepared: Memory) -> Iterator[System | None]:
        """Return the constant matrix of each stage, None for one that moves."""
        begin = self.begin + self.inverses
        for stage in self.program.stages:
            if stage.plan.moving:
                yield None
            else:
                yield constant_system(p, stage.plan, prepared.at(begin))
                begin += constant_size(stage.plan)


class Start(Body):
    """The values of order 0, as they are built: the constants of the table are its last parameters."""

    def __init__(
        self,
        p: Builder,
        numbers: SeriesNumbers,
        prepared: Memory,
        constants: Sequence[Real],
        time: Real | None = None,
        state: Memory | None = None,
    ) -> None:
        super().__init__(
            p, numbers.program.start, Inputs(prepared, {} if state is None else numbers.slots, time, state)
        )
        self.count, self.constants = numbers.given, constants

    def loaded(self, ref: int) -> None:
        """Read an input or a prepared result, once."""
        one = self.program.instructions[ref]
        if one.op == "parameter" and one.place >= self.count:
            self.values[ref] = self.constants[one.place - self.count]
        else:
            super().loaded(ref)
