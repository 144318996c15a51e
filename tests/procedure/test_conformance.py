"""Printers and the interpreter agree on sums of products; the loop of the projection."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.projection import KEPT_VIOLATION, PROJECTION_CORRECTIONS, RESOLVED, project
from lagrange.machine.llvm.engine import CompiledProcedure
from lagrange.machine.python_source import loaded
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE
from lagrange.procedure.interpreter import run


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
    assert CompiledProcedure(procedure, optimize=True)(11, *map(np.array, numbers)) == expected
    assert loaded(procedure)(11, *numbers) == pytest.approx(expected, abs=1e-15)


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
