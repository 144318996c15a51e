"""What Newton's method decides after a correction: enough, go on, a new matrix, or no hope; one case for each rule.

Runs reach some of these rules only by chance. The compiled drivers decide alike: `test_driver_steps.py` holds them to
the steps and corrections of this one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lagrange.machine.state import Outcome
from lagrange.machine.steps.interpreted_newton import Failure, Newton, Record
from lagrange.machine.steps.newton_constants import (
    AGING,
    FRACTION,
    FRESH_RATE,
    GROWTH,
    HOPELESS,
    LEAST_RATE,
    NOISE,
    OLD,
    OLDEST,
    OLDEST_RATE,
    REST,
    SLOW,
    STALLED,
    STALLED_RATE,
    TURNS,
)
from lagrange.program.step import Control, trace

FRESH, FAR = 1, 100
"""Corrections since the matrix was made: a new one has been tried, and one that is old."""


def newton(*, adaptive: bool = False, rate: float = 0.1, noise: float = 1.0, age: float = 0.0) -> Newton:
    """Return a solve in the middle of a step, with a matrix for steps of 0.5."""

    def step(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
        k = solve(lambda k: f(t + h, y + k * h) - k, lambda: f(t, y))
        return (y + k * h, k) if adaptive else y + k * h

    traced = trace("mine", step, implicit=True, control=Control(2) if adaptive else None)
    found = Record(traced, lambda t, y: y, lambda t, y: np.eye(len(y))).newtons[0]
    found.rate, found.noise, found.age = rate, noise, age
    found.matrix_step, found.differentiated = 0.5, True
    return found


def renewed(found: Newton) -> bool:
    """Return whether the next correction, or the next step, is to have a new matrix and a new derivative."""
    assert (found.matrix_step == 0.0) == (not found.differentiated)
    return found.matrix_step == 0.0


# --- enough ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("adaptive", "bound"), [(False, REST), (True, FRACTION)])
@pytest.mark.parametrize(("part", "enough"), [(0.9, True), (1.1, False)])
def test_what_is_left_is_the_rest_of_a_geometric_series(
    adaptive: bool, bound: float, part: float, enough: bool
) -> None:
    """A first correction shrinks as those of the step before did, a later one as it has."""
    rate = 0.2
    norm = part * bound * (1 - rate) / rate
    assert newton(adaptive=adaptive, rate=rate).enough(0, norm, 0.0, FAR) is enough
    found = newton(adaptive=adaptive, rate=0.9, noise=1.0)
    assert found.enough(1, norm, norm / rate, FAR) is (enough or (not adaptive and norm / rate <= 1))
    if enough:
        assert found.rate == pytest.approx(rate)


def test_two_corrections_in_a_row_are_round_off() -> None:
    for norm, previous, enough in ((0.9, 0.95, True), (0.9, 1.1, False), (1.1, 0.95, False)):
        assert newton().enough(1, norm, previous, 0) is enough
        assert newton(noise=2.0).enough(1, 2 * norm, 2 * previous, 0) is enough
        assert newton(adaptive=True).enough(1, norm / 2, norm, 0) is False
    assert newton(rate=0.9).enough(0, 0.9, 0.0, 0) is False, "there is no correction before the first"


def test_a_rate_that_is_not_measured_ages() -> None:
    for before, after in ((0.1, 0.1 * AGING), (0.85, OLDEST_RATE)):
        found = newton(rate=before)
        assert found.enough(0, 1e-6, 0.0, FAR)
        assert found.rate == pytest.approx(after)
    found = newton()
    assert found.enough(1, 1e-9, 1.0, FAR)
    assert found.rate == LEAST_RATE


def test_noise_is_forgotten_down_to_one() -> None:
    for before, after in ((5.0, 5.0 * NOISE), (1.05, 1.0), (1.0, 1.0)):
        found = newton(noise=before)
        assert found.enough(0, 1e-6, 0.0, FAR)
        assert found.noise == pytest.approx(after)


@pytest.mark.parametrize(
    ("turn", "age", "new"),
    [
        (0, 0, False),
        (TURNS - 1, OLD, False),
        (TURNS, OLD - 2, False),
        (TURNS, OLD - 1, True),
        (0, OLDEST - 2, False),
        (0, OLDEST - 1, True),
    ],
)
def test_a_step_of_many_corrections_or_an_old_matrix_wants_a_new_one(turn: int, age: int, new: bool) -> None:
    found = newton(age=age)
    assert found.enough(turn, 1e-6, 1e-3, FAR)
    assert found.age == age + 1 and renewed(found) is new


@pytest.mark.parametrize(
    ("turn", "rate", "new"), [(0, 0.1, False), (1, 2 * FRESH_RATE, True), (1, FRESH_RATE / 2, False)]
)
def test_where_steps_follow_the_error_a_slow_step_wants_a_new_matrix(turn: int, rate: float, new: bool) -> None:
    found = newton(adaptive=True)
    assert found.enough(turn, 1e-6, 1e-6 / rate, FAR)
    assert renewed(found) is new


# --- not enough -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [SLOW / 2, 2 * SLOW, 1.5])
def test_corrections_that_shrink_slowly_want_a_new_matrix_where_it_is_old(rate: float) -> None:
    for since, old in ((0, False), (FRESH, False), (OLD - 1, False), (OLD, True), (FAR, True)):
        found = newton()
        assert not found.enough(1, 2 * STALLED, 2 * STALLED / rate, since)
        assert renewed(found) is (old and rate > SLOW)
        assert not newton(rate=rate).enough(0, 2 * STALLED, 0.0, since), "nothing is measured by the first"


def test_with_a_new_matrix_small_corrections_that_stall_are_round_off() -> None:
    for rate, norm, since, enough in (
        (1.1 * STALLED_RATE, STALLED / 2, FRESH, True),
        (1.1 * STALLED_RATE, STALLED / 2, OLD - 1, True),
        (1.1 * STALLED_RATE, STALLED / 2, 0, False),
        (1.1 * STALLED_RATE, STALLED / 2, OLD, False),
        (1.1 * STALLED_RATE, STALLED * 2, FRESH, False),
        (0.9 * STALLED_RATE, STALLED / 2, FRESH, False),
        (3 * GROWTH, STALLED / 2, FRESH, True),
    ):
        found = newton()
        assert found.enough(1, norm, norm / rate, since) is enough
        assert found.noise == (2 * norm if enough else 1.0)
        assert not newton(adaptive=True).enough(1, norm, norm / min(rate, 0.8), since)


def test_with_a_new_matrix_large_corrections_that_grow_have_no_end() -> None:
    for rate, norm, since, hopeless in (
        (1.1 * GROWTH, 2 * STALLED, FRESH, True),
        (1.1 * GROWTH, 2 * STALLED, OLD - 1, True),
        (1.1 * GROWTH, 2 * STALLED, 0, False),
        (1.1 * GROWTH, 2 * STALLED, OLD, False),
        (0.9 * GROWTH, 2 * STALLED, FRESH, False),
    ):
        if hopeless:
            with pytest.raises(Failure) as raised:
                newton().enough(1, norm, norm / rate, since)
            assert raised.value.outcome is Outcome.DIVERGED
        else:
            assert not newton().enough(1, norm, norm / rate, since)


def test_where_steps_follow_the_error_slow_corrections_want_a_shorter_one() -> None:
    for rate in (1.1 * HOPELESS, 5.0, np.nan):
        with pytest.raises(Failure) as raised:
            newton(adaptive=True).enough(1, 100.0, 100.0 / rate, FRESH)
        assert raised.value.outcome is Outcome.DIVERGED
    assert not newton(adaptive=True).enough(1, 100.0, 100.0 / (0.9 * HOPELESS), FRESH)
    assert not newton(adaptive=True, rate=5.0).enough(0, 100.0, 0.0, FRESH)
