"""Constants of a Taylor series: numbers that depend on parameters alone, and where they are stored."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.kernel.body import SOURCE, Body, Inputs, Style, width_of
from lagrange.algorithm.series.linear_systems import LinearSystem, constant_inverse, constant_size, constant_system
from lagrange.algorithm.series.packing import Packing
from lagrange.algorithm.series.rules import Term, joined
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import ANGLES, FLAG, Procedure
from lagrange.procedure.values import Memory, Real
from lagrange.program.program import Instruction
from lagrange.program.series import SeriesProgram

FloatArray = NDArray[np.float64]


class SeriesNumbers:
    """Layout of the numbers of a series that depend on parameters alone, in the prepared array from `begin` on.

    The prepared array begins with the parameters. The numbers are: constants that are not known at compile time,
    results of order 0 that need no state, and the inverses of constant matrices. With a `packing`, constants joined
    to vectors follow, in the order in which the rules of the packing read them.
    """

    def __init__(self, program: SeriesProgram, begin: int, packing: Packing | None = None) -> None:
        self.program, self.begin = program, begin
        unknown = [index for index, number in enumerate(program.numbers) if number is None]
        self.places = {index: k for k, index in enumerate(unknown)}
        self.slots: dict[int, int] = {}
        """Index in the prepared array of each result of order 0 that needs no state, by index of its instruction."""
        end = begin + len(unknown)
        for ref in program.start.saved:
            self.slots[ref] = end
            end += width_of(program.start, ref)
        self.inverses = end - begin
        constant = [stage.plan for stage in program.stages if not stage.plan.moving]
        self.size = self.inverses + sum(map(constant_size, constant))
        self.vectors: dict[tuple[int, ...], int] = {}
        """Index of adjacent constants in the prepared array, by their indices in the table."""
        for indices in () if packing is None else (c for chunk in packing.computed for c in chunk.coefficients):
            known = all(program.numbers[index] is not None for index in indices)
            if len(dict.fromkeys(indices)) > 1 and not known and indices not in self.vectors:
                self.vectors[indices] = self.size
                self.size += len(indices)

    @property
    def given(self) -> int:
        """Number of parameters, which come first in the prepared array."""
        return self.program.constants.parameters - self.program.sides

    def prepare(self) -> Procedure:
        """Return the procedure that computes the numbers of the series from the parameters, and writes them.

        Its argument is the prepared array, which begins with the parameters.
        """
        program = self.program
        p = Builder("prepare_taylor", "Write the numbers of the series. Return True if a constant matrix is singular.")
        held = p.array("p", size=self.begin + self.size)
        constants = Body(p, program.constants, Inputs(held, {}))
        constants.run(range(len(program.constants.instructions)))
        results = [p.real(constants.value(ref)) for ref in program.constants.outputs]
        to = held.at(self.begin)
        for index, k in self.places.items():
            to[k] = results[index]
        start = Start(p, self, held, results)
        start.run(range(program.start.hoisted))
        for ref, slot in self.slots.items():
            start.save(ref, held, slot)
        entries, flags, begin = iter(results[len(program.numbers) :]), [p.false], self.inverses
        for stage in program.stages:
            if not stage.plan.moving:
                flags += constant_inverse(p, stage.plan, entries, to.at(begin))
                begin += constant_size(stage.plan)
        p.leave(reduce(lambda a, b: a | b, flags))
        return p.finish(FLAG)

    def array(self, parameters: FloatArray, table: FloatArray, inverses: Sequence[FloatArray]) -> FloatArray:
        """Return the prepared array: the parameters and the numbers of the series.

        `table` are the constants of the series program, and `inverses` the inverses (n, n) of its constant matrices.
        The entries for results of order 0 are left zero: the procedure of `prepare_start` computes them.
        """
        prepared = np.zeros(self.begin + self.size + INVERSE_MARGIN)
        prepared[: len(parameters)] = parameters
        numbers = prepared[self.begin :]
        for index, k in self.places.items():
            numbers[k] = table[index]
        for indices, k in self.vectors.items():
            numbers[k : k + len(indices)] = table[list(indices)]
        plans = [stage.plan for stage in self.program.stages if not stage.plan.moving]
        parts = [np.diag(a) if plan.diagonal else a.T.ravel() for a, plan in zip(inverses, plans, strict=True)]
        joined = np.concatenate([np.zeros(0), *parts])
        numbers[self.inverses : self.inverses + len(joined)] = joined
        return prepared

    def prepare_start(self, name: str) -> Procedure:
        """Return the procedure `name` that computes the results of order 0 that need no state.

        It reads the other numbers from the prepared array, and writes the results to this array.
        """
        p = Builder(name, "Write the values of order 0 that depend on parameters alone.")
        held = p.array("p")
        table = [self.constant(held, index) for index in range(len(self.program.numbers))]
        start = Start(p, self, held, table, style=ALONE)
        start.run(range(self.program.start.hoisted))
        for ref, slot in self.slots.items():
            start.save(ref, held, slot)
        p.leave(start.failed)
        return p.finish(FLAG)

    def vector(self, prepared: Memory, indices: tuple[int, ...], constants: Sequence[Real]) -> Term:
        """Return the constants of the series program with these `indices` as one vector.

        The vector is read from the prepared array if it is stored there; else it is joined from the single `constants`.
        """
        if indices in self.vectors:
            return prepared.entries(self.begin + self.vectors[indices], len(indices))
        return joined(prepared.builder, [(constants[index], 0) for index in indices])

    def constant(self, prepared: Memory, index: int) -> Real:
        """Return constant number `index` of the series program: a known number, or one read from `prepared`."""
        known = self.program.numbers[index]
        value: Real = prepared[self.begin + self.places[index]] if known is None else prepared.builder.real(known)
        return value

    def systems(self, p: Builder, prepared: Memory) -> Iterator[LinearSystem | None]:
        """Yield for each linear system of the series: its solver if its matrix is constant, else None.

        The solver uses the inverse of the matrix, which is stored in `prepared`.
        """
        begin = self.begin + self.inverses
        for stage in self.program.stages:
            if stage.plan.moving:
                yield None
            else:
                yield constant_system(p, stage.plan, prepared.at(begin))
                begin += constant_size(stage.plan)


INVERSE_MARGIN = 8
"""Number of doubles after the end of a constant inverse that vector loads may read."""

ALONE = Style(substituted=1_000_000, systems=1, early=False)
"""Style of generated code in which each linear system is solved alone and inputs are read where they are first used."""


class Start(Body):
    """Builder of the code that computes the values of order 0 from the state and the prepared numbers."""

    def __init__(
        self,
        p: Builder,
        numbers: SeriesNumbers,
        prepared: Memory,
        constants: Sequence[Real],
        time: Real | None = None,
        state: Memory | None = None,
        padded: int = 0,
        style: Style = SOURCE,
    ) -> None:
        """Begin the code of order 0, before any instruction.

        `prepared` has the parameters and the values that depend on them alone, and `constants` are the constants of the
        series program. The values are computed at `time` and `state`, which are None if only numbers without a state
        are computed. The rounding error of the state begins at index `padded` of its array. `style` says how the code
        is written.
        """
        slots = {} if state is None else numbers.slots
        super().__init__(p, numbers.program.start, Inputs(prepared, slots, time, state), style)
        self.count, self.constants = numbers.program.constants.parameters, constants
        self.states = numbers.program.states
        self.moved = padded - self.states if padded else 0

    def run_moving(self, width: int) -> None:
        """Add the instructions that depend on the state, with sines and cosines of several angles at once.

        Up to `width` angles are joined to one vector. If an angle itself depends on a sine or cosine, its sine and
        cosine are computed separately.
        """
        code, hoisted = self.program.instructions, self.program.hoisted
        angles = [ref for ref in dict.fromkeys(instruction.args[0] for instruction in self.places) if ref >= hoisted]
        if width > 1:
            late, needed = bytearray(len(code)), bytearray(len(code))
            for i, instruction in enumerate(code):
                late[i] = instruction.op in ANGLES or any(late[arg] for arg in instruction.args)
            angles = [ref for ref in angles if not late[ref]]
            for ref in angles:
                needed[ref] = True
            for i in range(len(code) - 1, hoisted - 1, -1):
                for arg in code[i].args if needed[i] else ():
                    needed[arg] = True
            self.run(i for i in range(hoisted, len(code)) if needed[i])
            self.find_angles(angles, width)
        self.run(range(hoisted, len(code)))

    def find_angles(self, angles: Sequence[int], most: int) -> None:
        """Add the sines and cosines of known angles, up to `most` angles together.

        `angles` are the indices of the instructions that compute the angles.
        """
        while len(angles) > 1:
            width = min(most, 1 << (len(angles) - 1).bit_length())
            taken, angles = angles[:width], angles[width:]
            padded = [*taken, *[taken[-1]] * (width - len(taken))]
            pair = self.p.sine_cosine(joined(self.p, [(self.value(ref), 0) for ref in padded]))
            for op, values in zip(ANGLES, pair, strict=True):
                for lane, ref in enumerate(taken):
                    if (position := self.places.get(Instruction(op, (ref,)))) is not None:
                        self.values[position] = values.permuted(lane)

    def loaded(self, ref: int) -> None:
        """Read the result of instruction `ref` from the inputs, unless it has been read or has to be computed."""
        instruction = self.program.instructions[ref]
        if instruction.op == "parameter" and instruction.place >= self.count:
            self.values[ref] = self.constants[instruction.place - self.count]
        elif instruction.op == "state" and instruction.place >= self.states and ref not in self.values:
            assert self.inputs.state is not None
            self.values[ref] = self.inputs.state[instruction.place + self.moved]
        else:
            super().loaded(ref)
