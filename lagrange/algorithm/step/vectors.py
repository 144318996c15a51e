"""Vectors of a step in the work array: linear combinations of them, and evaluations of the right-hand side.

The law is the function that a step evaluates, such as the right-hand side. A combination is computed entry by
entry, in whole blocks. Entries beyond the end of a vector are arbitrary.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagrange.algorithm.step.memory import Layout, Running
from lagrange.graph.node import Node
from lagrange.procedure.front.decorators import inline
from lagrange.procedure.front.vocabulary import In, Out, each, fma, operation, reals, unrolled
from lagrange.program.program import Program
from lagrange.program.step import LAWS, Combination, LawCall, in_doubles, parts

Registers = Mapping[int, Sequence[float]]
"""Entries of vectors that have just been computed, by number of the vector. Reading them from memory would take some
processor cycles.
"""

NO_REGISTERS: Registers = {}
"""Registers before any evaluation: empty."""


@inline
def vectors_of(
    arguments: Running,
    t: float,
    h: float,
    layout: Layout,
    calls: Sequence[LawCall] = (),
    combinations: Iterable[Combination] = (),
    nodes: Iterable[Node] = (),
    *,
    ratio: float = 1.0,
    state: Out | None = None,
) -> StepVectors:
    """Return the vectors of a step in the work array, with the values of coefficients in its formulas.

    The coefficients are those in `calls` of the law and in linear `combinations`, and also `nodes`. They depend
    on the time t, the step length h and the `ratio` of h to the length of the previous step. `state` has the
    entries of the old state if they are kept in registers, else it is None.
    """
    combined = [*[argument for call in calls for argument in call.arguments], *combinations]
    factors = [factor for combination in combined for _, factor in combination]
    numbers = list(dict.fromkeys([*factors, *[call.time for call in calls], *nodes, layout.step.graph.one]))
    values = evaluated(layout.step.scalars(numbers), t, h, ratio)
    return StepVectors(arguments, layout, h, dict(zip(numbers, values, strict=True)), state)


@inline
def evaluated(program: Program, t: float, h: float, ratio: float) -> list[float]:
    """Return the results of a straight-line program whose inputs are three numbers.

    The numbers are the time t, the step length h, and the `ratio` of h to the length of the previous step.
    """
    values: list[float] = []
    for instruction in program.instructions:
        if instruction.op == "time":
            value = t
        elif instruction.op == "state":
            value = h if program.inputs[instruction.place].name == "h" else ratio
        elif instruction.op == "constant":
            value = float(instruction.value)
        else:
            value = operation(instruction.op, *[values[arg] for arg in instruction.args])
        values = [*values, value]
    return [values[ref] for ref in program.outputs]


@inline
def plus(total: float | None, factor: float | None, value: float) -> float:
    """Return total + factor * value, rounded once. A total of None is zero, and a factor of None is one."""
    if total is None:
        return value if factor is None else factor * value
    return total + value if factor is None else fma(factor, value, total)


@inline
def copy_vector(source: In, target: Out, width: int) -> None:
    """Copy the first `width` entries of a vector from `source` to `target`, in whole blocks."""
    for i in each(width, spill=True, disjoint=True):
        target[i] = source[i]


@dataclass(frozen=True)
class StepVectors:
    """The vectors of a step in the work array, and values of the coefficients in its formulas.

    `running` are the arguments of the loop over steps. `numbers` has the value of each coefficient, by node.
    `state` has the entries of the old state if they are kept in registers, else it is None.
    """

    running: Running
    layout: Layout
    h: float
    numbers: Mapping[Node, float]
    state: Out | None

    @inline
    def at(self, vector: int) -> Out:
        """Return vector number `vector` of the step, a part of the work array."""
        return self.running.work[self.layout.place(vector) :]

    @inline
    def factor(self, node: Node, *, size: bool = False) -> float | None:
        """Return the value of the coefficient `node`, or its magnitude if `size`; None if it is exactly one."""
        is_one = node is self.layout.step.graph.one
        return None if is_one else abs(self.numbers[node]) if size else self.numbers[node]

    @inline
    def terms(self, combination: Combination, *, sizes: bool = False) -> Terms:
        """Return the terms of a linear combination of vectors. Terms with the factor one come first.

        With `sizes` they are for the sum of the terms' magnitudes.
        """
        step, one = self.layout.step, self.layout.step.graph.one
        plain, scaled = parts(combination, step.h) if step.exact and not sizes else (combination, ())
        ordered = [*[term for term in plain if term[1] is one], *[term for term in plain if term[1] is not one]]
        return Terms(
            [(self.at(vector), self.factor(node, size=sizes)) for vector, node in ordered],
            [(self.at(vector), in_doubles(share)) for vector, share in scaled],
            self.h,
            sizes,
        )

    @inline
    def combine(self, combination: Combination, target: Out, *, sizes: bool = False) -> None:
        """Write a linear combination of vectors to `target`; with `sizes`, the sum of its terms' magnitudes."""
        terms = self.terms(combination, sizes=sizes)
        for i in each(self.layout.width, spill=True, disjoint=True):
            target[i] = terms.entry(i)

    @inline
    def arguments(self, call: LawCall) -> Out:
        """Write the arguments of a call of the law to the work array, one after the other, and return them."""
        arguments = self.running.work[self.layout.argument :]
        for i, argument in enumerate(call.arguments):
            self.combine(argument, arguments[i * self.layout.length :])
        return arguments

    @inline
    def evaluate(self, call: LawCall, registers: Registers = NO_REGISTERS) -> tuple[bool, Registers]:
        """Evaluate the law in a `call`. Return True if a matrix is singular, and the results in registers.

        The results are also stored in the work array. `registers` has the results of earlier calls as single numbers,
        by number of the vector. The second result has the results of this call in the same form; it is empty unless the
        layout keeps results in registers.
        """
        layout, running, law = self.layout, self.running, LAWS[self.layout.step.law]
        time, length = self.numbers[call.time], layout.length
        if layout.in_registers:
            state = [entry for argument in call.arguments for entry in self.entries(argument, registers)]
            zeros = [0.0] * (layout.dimension - len(state))
            results = running.law(time, *state, *zeros, running.parameters)
            values = [*(state[layout.dimension // 2 :] if law.states == 1 else ()), *results[:-1]]
            vectors = [values[i * length : (i + 1) * length] for i in unrolled(law.results)]
            for i, vector in enumerate(vectors):
                self.store(vector, self.at(call.first + i))
            return results[-1], dict(zip(unrolled(call.first, call.first + law.results), vectors, strict=True))
        arguments, results = self.arguments(call), running.work[layout.result :]
        is_singular = running.law(time, arguments, running.parameters, results)
        first = length if layout.step.law == "accelerations" else 0
        for i in unrolled(law.results):
            target = self.at(call.first + i)
            copy_vector(results[first + i * length :], target, layout.width)
            for k in unrolled(length, layout.width if law.results > 1 else length):
                target[k] = 0.0  # padding: whole blocks were copied
        return is_singular, NO_REGISTERS

    @inline
    def evaluate_all(self, calls: Sequence[LawCall]) -> bool:
        """Evaluate the law for calls that do not depend on each other. Return True if a matrix is singular."""
        is_singular = False
        for call in calls:
            failed, _ = self.evaluate(call)
            is_singular = is_singular or failed
        effort = self.running.effort
        effort.evaluations += len(calls)
        return is_singular

    @inline
    def entries(self, combination: Combination, registers: Registers) -> Sequence[float]:
        """Return the entries of a linear combination of vectors as single numbers.

        `registers` has entries that need not be read from memory, by number of the vector. The vector that was
        computed last is added last: the other terms need not wait for it.
        """
        step = self.layout.step
        present = [] if step.exact else [term for term in combination if term[0] in registers]
        if not present:
            return self.loaded(combination)
        vector, node = max(present)
        rest = tuple([term for term in combination if term[0] != vector])
        factor, values = self.factor(node), registers[vector]
        totals = self.loaded(rest) if rest else [None] * len(values)
        return [plus(total, factor, value) for total, value in zip(totals, values, strict=True)]

    @inline
    def loaded(self, combination: Combination) -> Sequence[float]:
        """Return the entries of a linear combination as single numbers; its vectors are read from memory."""
        layout = self.layout
        if len(combination) != 1 or combination[0][1] is not layout.step.graph.one:
            source = reals(layout.width, room=layout.block)
            self.combine(combination, source)
        elif self.state is not None and combination[0][0] < layout.step.states:
            source = self.state[combination[0][0] * layout.length :]
        else:
            source = self.at(combination[0][0])
        return [source[i] for i in unrolled(layout.length)]

    @inline
    def store(self, values: Sequence[float], target: Out) -> None:
        """Write the entries `values` to the vector `target`, padded with zeros."""
        padded = reals(self.layout.width, room=self.layout.block)
        for i in unrolled(self.layout.width):
            padded[i] = values[i] if i < len(values) else 0.0
        copy_vector(padded, target, self.layout.width)


@dataclass(frozen=True)
class Terms:
    """The terms of a linear combination: those in `plain`, and those in `scaled`, whose sum is multiplied by `h`.

    A term is (vector, factor); the factor None is one. In `scaled` a factor is the sum of two doubles. `scaled` is
    empty except in a step whose rounding errors must be random (Brouwer's law).
    """

    plain: Sequence[tuple[In, float | None]]
    scaled: Sequence[tuple[In, tuple[float, float]]]
    h: float
    sizes: bool
    """True if the magnitudes of terms are added."""

    @inline
    def entry(self, i: int) -> float:
        """Return entry i of the linear combination; with `sizes`, the sum of the magnitudes of its terms."""
        total, high, low = None, None, None
        for vector, factor in self.plain:
            total = plus(total, factor, abs(vector[i]) if self.sizes else vector[i])
        for vector, (first, second) in self.scaled:
            value = vector[i]
            high = plus(high, first, value) if first else high
            low = plus(low, second, value) if second else low
        slope: Any = high if low is None else low if high is None else high + low
        if self.scaled:
            total = plus(total, self.h, slope)
        return 0.0 if total is None else total
