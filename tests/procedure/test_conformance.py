"""Printers and the interpreter agree, beside random functions, on sums of products, kernels and projection."""

from __future__ import annotations

import ctypes
import math
import random
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.projection import KEPT_VIOLATION, PROJECTION_CORRECTIONS, RESOLVED, project
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module
from lagrange.machine.python_source import loaded
from lagrange.procedure import form
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, OPERATIONS, REAL, WHOLE, WIDTHS, Kind, Procedure, Vector
from lagrange.procedure.interpreter import run
from lagrange.procedure.values import Entries
from lagrange.statement.vocabulary.functions import ELEMENTARY
from tests.procedure.random_functions import bits


@pytest.mark.parametrize("count", [1, 3, 8, 11, None])
def test_products_that_are_added_up_are_rounded_once(count: int | None) -> None:
    """The remainder of products that cancel is the rounding of one fused operation, in vectors and one by one."""
    p = Builder("scalar_product", "The sum of products.")
    n, a, b = p.given("n", WHOLE), p.array("a", room=4, read=True), p.array("b", room=4, read=True)
    with p.each(n if count is None else count) as i:
        total = p.fold("dot", a[i], b[i])
    p.leave(total)
    procedure = p.finish(REAL)
    small = [(3 + i) * 2.0**-30 for i in range(16)]
    numbers = [1 + x for x in small], [(-1) ** (i // 4) * (1 - x) for i, x in enumerate(small)]
    expected = run(procedure, 11, *numbers)[0]
    code = Module(module([procedure]), optimize=True)
    call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, *[ctypes.c_void_p] * 2)(code.address(procedure.name))
    first, second = (np.array(values) for values in numbers)
    assert call(11, first.ctypes.data, second.ctypes.data) == expected
    assert loaded(procedure)(11, *numbers) == pytest.approx(expected, abs=1e-15)


# --- kernels --------------------------------------------------------------------------------------------------
# Programs as procedures give what the interpreter gives, at singular matrices and with pivoting too.

# --- projection -----------------------------------------------------------------------------------------------
# The loop of the projection: when a state moves, how far, and the outcome if it cannot be projected.

Answer = tuple[list[float], float, float]
"""Corrections, the violation, and the violation that would remain."""


def projected(
    answers: list[Answer | None], state: list[float], lost: list[float] | None = None
) -> tuple[Outcome, bool, list[float], list[float], int]:
    """Run the projection with given corrections. Return its result, the state, the rounding errors, and the calls."""
    asked = 0

    def corrections(_: float, __: Any, ___: Any, out: Any) -> bool:
        nonlocal asked
        answer = answers[min(asked, len(answers) - 1)]
        asked += 1
        for i, value in enumerate([] if answer is None else [*answer[0], answer[1], answer[2]]):
            out[i] = value
        return answer is None

    y, low = list(state), [0.0] * len(state) if lost is None else list(lost)
    outcome, moved = run(project.form(dimension=len(state), block=1), corrections, [], 0.5, y, low)
    return Outcome(outcome), bool(moved), y, low, asked


def test_a_state_and_its_rounding_error_move_as_one_number() -> None:
    """State and rounding errors together lose no bit of a correction below the spacing of the state."""
    state, lost, move = [1.0, -3.0], [2.0**-55, -(2.0**-54)], [2.0**-54 + 2.0**-80, 0.3]
    outcome, moved, after, low, asked = projected([(move, 1e-9, 0.0)], state, lost)
    assert (outcome, moved, asked) == (Outcome.DONE, True, 1)
    for i in range(2):
        total = Fraction(lost[i]) + Fraction(move[i])
        exact = Fraction(state[i]) + total
        # The sum of both small parts is rounded once, where it does not fit into a double.
        assert abs(Fraction(after[i]) + Fraction(low[i]) - exact) <= abs(total) * Fraction(1, 2**53)
    assert after[0] == 1.0
    assert low[0] > 0


MORE: list[Answer | None] = [([0.1], 1e-2, 1e-4), ([0.01], 1e-4, 1e-8), ([1e-3], 1e-8, 1e-16), ([9.0], 1.0, 0.0)]
ENDS: dict[str, tuple[list[Answer | None], Outcome, float, int]] = {
    "a violation of rounding stays": ([([1e-17], KEPT_VIOLATION, 0.0)], Outcome.DONE, 1.0, 1),
    "corrections are repeated until the violation is rounding": (MORE, Outcome.DONE, 1.111, 3),
    "a small violation that is not halved stays": ([([5.0], RESOLVED, 0.6 * RESOLVED)], Outcome.DONE, 1.0, 1),
    "a large one makes the step fail": ([([5.0], 2 * RESOLVED, 1.2 * RESOLVED)], Outcome.UNPROJECTED, 1.0, 1),
    "slow corrections end": (
        [([1e-3], 1e-2, 4e-3)],
        Outcome.UNPROJECTED,
        1 + 1e-3 * PROJECTION_CORRECTIONS,
        PROJECTION_CORRECTIONS,
    ),
    "a violation that is NaN is no success": ([([0.1], math.nan, 0.0)], Outcome.UNPROJECTED, 1.0, 1),
    "a remainder that is NaN is none": ([([0.1], 1.0, math.nan)], Outcome.UNPROJECTED, 1.0, 1),
    "a singular matrix changes nothing": ([None], Outcome.DONE, 1.0, 1),
}
"""Answers of the corrections; the outcome, the state that was 1, and the number of corrections asked for."""


@pytest.mark.parametrize("case", ENDS)
def test_each_end_of_a_projection(case: str) -> None:
    answers, outcome, state, count = ENDS[case]
    result, moved, after, _, asked = projected(answers, [1.0])
    assert (result, moved, asked) == (outcome, state != 1.0, count)
    assert after == ([pytest.approx(state)] if moved else [1.0])


# --- vectors --------------------------------------------------------------------------------------------------
# Short vectors: interpreter and machine code agree to the last bit.


SIZE = 24
FUSED = ("fma", "fnma")
WITHOUT_LIBRARY = frozenset(OPERATIONS) - frozenset(ELEMENTARY) - {"atan2", "power"}
"""Operations with the same bits everywhere."""

UNSAFE = ("quotient", "whole", "two_to")
"""Operations without a value for some operands: they are tried apart."""


class RandomVectors:
    """A procedure of random operations on vectors, which stores all of them."""

    def __init__(self, seed: int, *, fused: bool) -> None:
        self.draw = random.Random(seed)
        self.p = p = Builder("vectors", "Random vectors.")
        self.x, self.n = p.given("x", REAL), p.given("n", WHOLE)
        self.data, self.places = p.array("data", size=SIZE), p.array("places", WHOLE, size=SIZE)
        self.out, self.counts = p.array("out", size=400), p.array("counts", WHOLE, size=400)
        self.made: list[Entries] = []
        self.ops = [op for op in sorted(WITHOUT_LIBRARY) if op not in UNSAFE and (fused or op not in FUSED)]
        for width in WIDTHS[1:]:
            self.made += [self.data.entries(self.n, width), self.places.entries(1, width)]
            self.made += [p.broadcast(self.x, width), self.made[-2] < 0.25]

    def step(self) -> None:
        """Add one vector or a store."""
        draw, some = self.draw, self.draw.choice(self.made)
        match draw.randrange(11):
            case 0:
                alike = [item for item in self.made if item.kind is some.kind]
                parts = [some, *(draw.choice(alike) for _ in range(draw.randrange(3)))]
                parts = [item if draw.random() < 0.7 else item.permuted(draw.randrange(item.width)) for item in parts]
                parts += [self.p.constant(0.5, REAL), self.x] if some.kind is REAL and draw.random() < 0.5 else []
                known = range(sum(item.width if isinstance(item, Entries) else 1 for item in parts))
                self.made.append(self.p.permuted(parts, draw.choices(known, k=draw.choice(WIDTHS[1:]))))
            case 1:
                places = self.pick(WHOLE, some.vector.width)
                inside = self.p.operation("max", self.p.operation("min", places, SIZE - 1), 0)
                array, mask = draw.choice([self.data, self.places]), self.pick(FLAG, some.width).ref
                vector = Vector(array.array.kind, some.width)
                made = self.p.made(vector, lambda ref: form.Gather(ref, vector, array.ref, inside.ref, mask))
                self.made.append(made)
            case 2:
                self.made.append(self.data.entries(draw.randrange(SIZE - 8), some.width))
            case 3 if some.vector.kind is REAL:
                first, mask = self.p.operand(self.n, WHOLE), self.pick(FLAG, some.width).ref
                self.p.add(form.VectorStore(self.data.ref, first, some.ref, mask))
            case 4 if some.vector.kind is REAL:
                places = self.p.operation("max", self.p.operation("min", self.pick(WHOLE, some.width), SIZE - 1), 0)
                self.p.add(form.Scatter(self.data.ref, places.ref, some.ref, self.pick(FLAG, some.width).ref))
            case 6 if some.vector.kind is REAL:
                self.made += self.p.sine_cosine(some * 0.0)
            case 7:
                self.keep(some)
            case 5 if some.vector.kind is FLAG:
                flag = self.p.made(FLAG, lambda ref: form.Reduce(ref, FLAG, "any", some.ref))
                self.made.append(self.p.broadcast(flag, draw.choice(WIDTHS[1:])))
            case _:
                kinds, _ = draw.choice(OPERATIONS[op := draw.choice(self.ops)])
                self.made.append(self.p.operation(op, *(self.pick(kind, some.vector.width) for kind in kinds)))

    def keep(self, some: Entries) -> None:
        """Add a variable that is set in a loop with a branch."""
        variable = self.p.variable(some)
        with self.p.loop(0, self.n), self.p.when(self.x < 1.0):
            variable.value = variable.value.permuted(*range(1, some.width), 0)
        self.made.append(variable.value)

    def pick(self, kind: Kind, width: int) -> Entries:
        """Return a random vector of a type."""
        return self.draw.choice([item for item in self.made if item.vector == Vector(kind, width)])

    def procedure(self) -> Procedure:
        """Return the procedure; one part of it is in a loop."""
        for _ in range(6):
            self.step()
        known = len(self.made)
        with self.p.loop(0, 3):
            for _ in range(6):
                self.step()
            self.data.put(2, self.pick(REAL, 8))
        del self.made[known:]
        for _ in range(12):
            self.step()
        place = 0
        for item in self.made[-30:]:
            width, wide = item.vector.width, item
            if item.vector.kind is FLAG:
                wide = self.p.operation("select", item, 1.0, 0.0)
            (self.counts if wide.vector.kind is WHOLE else self.out).put(place, wide)
            place += width
        self.p.leave()
        return self.p.finish()


def memory() -> list[Any]:
    """Return the arguments: a number, an index, and four arrays."""
    data = np.array([0.5, -1.25, 0.1, 0.0, -0.0, 1e200, -1e-200, 2.0, 7 / 3, -4.0, math.inf, math.nan] * 2)
    return [0.75, 3, data, np.arange(SIZE)[::-1].copy(), np.zeros(400), np.zeros(400, dtype=np.int64)]


def left_in(arguments: list[Any]) -> list[Any]:
    return [bits(value) for array in arguments[2:] for value in array.tolist()]


def in_machine_code(procedure: Procedure, arguments: list[Any], *, optimize: bool) -> list[Any]:
    compiled = Module(module([procedure]), optimize=optimize)
    call = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_int64, *[ctypes.c_void_p] * 4)
    call(compiled.address(procedure.name))(*arguments[:2], *(array.ctypes.data for array in arguments[2:]))
    return left_in(arguments)


def interpreted(procedure: Procedure) -> list[Any]:
    arguments = memory()
    run(procedure, *arguments)
    return left_in(arguments)


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", range(40))
def test_random_vectors_are_the_same_everywhere(seed: int) -> None:
    procedure = RandomVectors(seed, fused=seed % 2 == 0).procedure()
    expected = interpreted(procedure)
    assert in_machine_code(procedure, memory(), optimize=seed % 4 < 2) == expected
