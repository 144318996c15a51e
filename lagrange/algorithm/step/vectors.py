"""The parts of a procedure of a step: its arguments, its numbers, and combinations of its vectors.

A vector has its place in the work array. A combination of vectors is computed entry by entry, in whole blocks; the
entries beyond the end of a vector are arbitrary.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.step.memory import EFFORT, NEWTON, Layout, SolveLayout
from lagrange.graph.node import Node
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, Array, Callee
from lagrange.procedure.values import Flag, Memory, Real, Variable, Whole
from lagrange.program.actions import LAWS, Combination, LawCall, in_doubles, parts

READ = Array(read=True)

BY_PLACE = Callee((REAL, READ, READ, Array()), (FLAG,))
"""A law between arrays: of a time, a state and the parameters, to the results; it says whether a matrix is singular."""


def in_registers(layout: Layout) -> Callee:
    """Return the type of a law that takes and returns numbers, and whether a matrix is singular."""
    results = LAWS[layout.step.law].results * (layout.dimension // 2)
    return Callee((REAL,) * (1 + layout.dimension) + (READ,), (REAL,) * results + (FLAG,))


def law_of(layout: Layout) -> Callee:
    """Return the type of the law that steps call."""
    return in_registers(layout) if layout.in_registers else BY_PLACE


def floors_of(p: Builder, layout: Layout, *, read: bool = True) -> Memory:
    """Return the parameter with the absolute tolerance of each entry of the state."""
    return p.array("floors", size=layout.dimension, room=layout.block, read=read)


def newton_records(p: Builder, layout: Layout, prefix: str = "") -> list[Any]:
    """Return the records of the solves of a step, as parameters."""
    return [p.record(f"{prefix}newton{solve.index}", NEWTON) for solve in layout.solves]


class Laws:
    """The law of a step and its derivative, each with its parameters."""

    def __init__(self, p: Builder, layout: Layout) -> None:
        self.law, self.parameters = p.function("law", law_of(layout)), p.array("parameters", read=True)
        self.jacobian, self.constants = p.function("jacobian", BY_PLACE), p.array("constants", read=True)

    @property
    def handed(self) -> tuple[Any, ...]:
        """The arguments for another procedure of the same step."""
        return self.law, self.parameters, self.jacobian, self.constants


class Given:
    """The arguments of a procedure of a step, which it passes on to other procedures of the same step.

    These are the law and its derivative, each with its parameters; time, length of the step, relative tolerance and
    floors; the cost of the step; the records of all solves, or of the one that the procedure is for; and the work
    array.
    """

    def __init__(self, p: Builder, layout: Layout, solve: SolveLayout | None = None) -> None:
        self.p, self.layout, self.solve = p, layout, solve
        self.laws = Laws(p, layout)
        self.t, self.h = p.given("t", REAL), p.given("h", REAL)
        self.rtol = p.given("rtol", REAL)
        self.floors = floors_of(p, layout)
        self.effort = p.record("effort", EFFORT)
        self.newtons = newton_records(p, layout) if solve is None else [p.record(f"newton{solve.index}", NEWTON)]
        self.work = p.array("work", size=layout.size, room=layout.block)

    @property
    def newton(self) -> Any:
        """The record of the solve that the procedure is for."""
        return self.newtons[0]

    def handed(self, *newtons: Any) -> tuple[Any, ...]:
        """Return the arguments for another procedure of the same solve, or of some of the step."""
        numbers = self.t, self.h, self.rtol, self.floors
        return (*self.laws.handed, *numbers, self.effort, *(newtons or self.newtons), self.work)

    def leave_unless_done(self, outcome: Whole) -> None:
        """Return an outcome of another procedure unless it is DONE."""
        self.p.leave_if(~outcome.equals(Outcome.DONE), outcome)


class Vectors:
    """The vectors of a step in a procedure, and the numbers that they are combined with.

    Numbers depend on t, h and the ratio of steps: those of `nodes` are known, and all in `combinations`. `state` has
    the entries of the state, if they are kept. `known` has those of vectors that have just been computed: reading them
    back from memory takes some cycles.
    """

    def __init__(
        self,
        given: Given,
        combinations: Iterable[Combination],
        nodes: Iterable[Node] = (),
        *,
        ratio: Real | None = None,
        state: Memory | None = None,
    ) -> None:
        self.state = state
        self.known: dict[int, list[Real]] = {}
        self.given, self.p, self.layout, self.work = given, given.p, given.layout, given.work
        step = self.layout.step
        factors = [factor for one in combinations for _, factor in one if factor is not step.graph.one]
        wanted = list(dict.fromkeys([*factors, *nodes, step.graph.one]))
        program = step.scalars(wanted)
        values: list[Real] = []
        inputs = {"h": given.h, "ratio": ratio}
        for op, args, place, value, *_ in program.instructions:
            if op == "time":
                values.append(given.t)
            elif op == "state":
                values.append(self.p.real(inputs[program.inputs[place].name]))
            elif op == "constant":
                values.append(self.p.constant(float(value), REAL))
            else:
                values.append(self.p.operation(op, *(values[arg] for arg in args)))
        self.numbers = {node: values[ref] for node, ref in zip(wanted, program.outputs, strict=True)}

    def at(self, vector: int) -> Memory:
        """Return a vector."""
        return self.work.at(self.layout.place(vector))

    def combine(self, combination: Combination, target: Memory, *, sizes: bool = False) -> None:
        """Write a linear combination of vectors, or with `sizes` that of their absolute values."""
        sum_ = Sum(self, combination, sizes=sizes)
        with self.p.each(self.layout.width, spill=True) as i:
            target[i] = sum_[i]

    def entries(self, combination: Combination) -> list[Real]:
        """Return the entries of a linear combination, each in a register of its own.

        What was computed last is added last, entry by entry, so that no addition waits for a value that it does not
        need.
        """
        step = self.layout.step
        known = [] if step.exact else [term for term in combination if term[0] in self.known]
        last = max(known, default=None, key=lambda term: term[0])
        before = tuple(term for term in combination if term is not last)
        totals = self._apart(before) if last is None or before else []
        if last is None:
            return totals
        values, node = self.known[last[0]], last[1]
        if node is step.graph.one:
            return [a + b for a, b in zip(totals, values, strict=True)] if totals else values
        factor = self.numbers[node]
        if not totals:
            return [factor * value for value in values]
        return [self.p.fma(factor, value, total) for value, total in zip(values, totals, strict=True)]

    def _apart(self, combination: Combination) -> list[Real]:
        """Return the entries of a combination that is computed in blocks, or read if it is one vector."""
        length, one = self.layout.length, self.layout.step.graph.one
        if len(combination) == 1 and combination[0][1] is one:
            vector = combination[0][0]
            kept = self.state is not None and vector < self.layout.step.states
            found = self.state.at(vector * length) if self.state is not None and kept else self.at(vector)
        else:
            found = self.p.reserve(self.layout.width, room=self.layout.block)
            self.combine(combination, found)
        return [found[i] for i in range(length)]

    def keep_entries(self, values: Sequence[Real], target: Memory) -> None:
        """Write entries from registers as a vector, padded with zeros."""
        block = self.p.reserve(self.layout.width, room=self.layout.block)
        for i in range(self.layout.width):
            block[i] = values[i] if i < len(values) else 0.0
        self.p.copy(block, target, self.layout.width)

    def evaluate(self, call: LawCall, singular: Variable, *, always: bool = False) -> None:
        """Evaluate the law, keep its results as vectors, and record whether a matrix is singular.

        Results that are `always` computed can be used by all that follows.
        """
        failed = self._by_number(call, always=always) if self.layout.in_registers else self._by_place(call)
        singular.value = singular.value | failed

    def arguments(self, call: LawCall) -> Memory:
        """Write the arguments of a call one after the other."""
        for i, argument in enumerate(call.arguments):
            self.combine(argument, self.work.at(self.layout.argument + i * self.layout.length))
        return self.work.at(self.layout.argument)

    def _by_place(self, call: LawCall) -> Flag:
        layout, step, given = self.layout, self.layout.step, self.given
        where, out = self.arguments(call), self.work.at(layout.result)
        failed = given.laws.law(self.numbers[call.time], where, given.laws.parameters, out)
        first = layout.result + (layout.length if step.law == "accelerations" else 0)
        for i in range(LAWS[step.law].results):
            self.p.copy(self.work.at(first + i * layout.length), self.at(call.first + i), layout.width)
        return Flag.of(failed)

    def _by_number(self, call: LawCall, *, always: bool) -> Flag:
        layout, law, half = self.layout, LAWS[self.layout.step.law], self.layout.dimension // 2
        state = [value for argument in call.arguments for value in self.entries(argument)]
        zeros = [self.p.constant(0.0, REAL)] * (layout.dimension - len(state))
        laws = self.given.laws
        *found, failed = laws.law(self.numbers[call.time], *state, *zeros, laws.parameters)
        values = [*state[half:], *found] if law.states == 1 else found
        for i in range(law.results):
            found = values[i * layout.length : (i + 1) * layout.length]
            self.keep_entries(found, self.at(call.first + i))
            if always:
                self.known[call.first + i] = found
        return Flag.of(failed)


class Sum:
    """A linear combination of vectors, entry by entry inside an `each`.

    For a step that keeps its rounding errors random (Brouwer's law), h multiplies the sum of its terms once, in two
    doubles.
    """

    def __init__(self, vectors: Vectors, combination: Combination, *, sizes: bool = False) -> None:
        self.p, step, self.sizes = vectors.p, vectors.layout.step, sizes
        self.h = vectors.given.h
        one = step.graph.one
        plain, scaled = parts(combination, step.h) if step.exact and not sizes else (combination, ())
        terms = sorted(plain, key=lambda term: term[1] is not one)
        self.terms: list[tuple[Memory, Real | None]] = []
        for vector, node in terms:
            factor = None if node is one else vectors.numbers[node]
            self.terms.append((vectors.at(vector), abs(factor) if sizes and factor is not None else factor))
        self.scaled = [(vectors.at(vector), in_doubles(factor)) for vector, factor in scaled]

    def __getitem__(self, i: Whole) -> Real:
        """Return an entry."""
        p, total = self.p, None
        for memory, factor in self.terms:
            value = abs(memory[i]) if self.sizes else memory[i]
            if factor is None:
                total = value if total is None else total + value
            else:
                total = factor * value if total is None else p.fma(factor, value, total)
        slope = self._slope(i)
        if slope is not None:
            total = self.h * slope if total is None else p.fma(self.h, slope, total)
        return p.real(0.0 if total is None else total)

    def _slope(self, i: Whole) -> Real | None:
        """Return the sum of the terms that h multiplies."""
        sums: list[Real | None] = [None, None]
        for memory, doubles in self.scaled:
            value = memory[i]
            for k, part in enumerate(doubles):
                if part:
                    before = sums[k]
                    sums[k] = value * part if before is None else self.p.fma(self.p.constant(part, REAL), value, before)
        first, second = sums
        return first if first is None or second is None else first + second
