"""The loop of the projection: when a state moves, how far, and what becomes of a state that cannot be projected."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.outcome import Outcome
from lagrange.algorithm.projection import MOST_CORRECTIONS, RESOLVED, ROUND_OFF, project
from lagrange.machine.printed_run import called
from lagrange.procedure.interpreter import run

Found = tuple[list[float], float, float]
"""Corrections, the violation, and what is left of it."""


def projected(
    answers: list[Found | None], state: list[float], lost: list[float] | None = None
) -> tuple[Outcome, bool, list[float], list[float], int]:
    """Run the loop on a state with corrections that are given; return what it says, the state, what is lost, calls."""
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


def test_a_state_whose_violation_is_round_off_stays_as_it_is() -> None:
    found = projected([([1e-17, 2e-17], ROUND_OFF, 0.0)], [1.0, 2.0])
    assert found == (Outcome.DONE, False, [1.0, 2.0], [0.0, 0.0], 1)


def test_the_state_and_what_rounding_took_from_it_move_as_one_number() -> None:
    """Not a bit is lost: neither of the correction, which is below the spacing of the state, nor of what was lost."""
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


def test_corrections_are_repeated_until_what_they_leave_is_round_off() -> None:
    answers: list[Found | None] = [([0.1], 1e-2, 1e-4), ([0.01], 1e-4, 1e-8), ([1e-3], 1e-8, 1e-16), ([9.0], 1.0, 0.0)]
    outcome, moved, after, _, asked = projected(answers, [1.0])
    assert (outcome, moved, asked) == (Outcome.DONE, True, 3)
    assert after == [pytest.approx(1.111)]


@pytest.mark.parametrize(("violation", "outcome"), [(RESOLVED, Outcome.DONE), (2 * RESOLVED, Outcome.UNPROJECTED)])
def test_a_correction_that_leaves_more_than_half_is_not_made(violation: float, outcome: Outcome) -> None:
    """A small violation stays as it is, a large one makes the step fail."""
    assert projected([([5.0], violation, 0.6 * violation)], [1.0]) == (outcome, False, [1.0], [0.0], 1)


def test_a_state_that_does_not_come_near_is_given_up() -> None:
    outcome, moved, _, _, asked = projected([([1e-3], 1e-2, 4e-3)], [1.0])
    assert (outcome, moved, asked) == (Outcome.UNPROJECTED, True, MOST_CORRECTIONS)


@pytest.mark.parametrize("answer", [([0.1], float("nan"), 0.0), ([0.1], 1.0, float("nan"))])
def test_a_violation_that_is_no_number_is_no_success(answer: Found) -> None:
    assert projected([answer], [1.0]) == (Outcome.UNPROJECTED, False, [1.0], [0.0], 1)


def test_a_state_where_the_matrix_is_singular_stays_as_it_is() -> None:
    """The next slope is singular there too, and the run ends with the state and the constraints that are dependent."""
    assert projected([None], [1.0]) == (Outcome.DONE, False, [1.0], [0.0], 1)


def test_printed_python_does_the_same() -> None:
    def corrections(_: float, __: Any, ___: Any, out: Any) -> bool:
        out[0], out[1], out[2] = 0.25, 1e-6, 1e-17
        return False

    made: Callable[..., Any] = called(project.form(dimension=1, block=1))
    state, lost = np.array([1.0]), np.array([0.0])
    assert made(corrections, np.empty(0), 0.0, state, lost) == (Outcome.DONE, True)
    assert state == [1.25]
