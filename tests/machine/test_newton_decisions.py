"""Decisions of Newton's method after a correction: converged, continue, update the matrix, or give up.

There is one case for each rule, since runs reach some rules only by chance. All printers of the procedure decide alike.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.constants import Outcome
from lagrange.algorithm.step.memory import NEWTON
from lagrange.algorithm.step.newton_corrections import (
    DIVERGENCE_GROWTH,
    DIVERGENCE_RATE,
    FEW_CORRECTIONS,
    FRESH_RATE,
    LARGEST_MATRIX_AGE,
    LARGEST_RATE,
    LEAST_RATE,
    MATRIX_AGE,
    NOISE_DECAY,
    RATE_INCREASE,
    ROUND_OFF_FRACTION,
    SLOW_RATE,
    STAGNATION_NORM,
    STAGNATION_RATE,
    TOLERANCE_FRACTION,
    assess_correction,
)
from lagrange.machine.llvm.engine import Module
from lagrange.machine.llvm.procedures import module
from lagrange.machine.python_source import loaded
from lagrange.procedure.interpreter import run

FRESH, FAR = 1, 100
"""Corrections since the matrix was made: a new one has been tried, and one that is old."""

VERDICTS = {Outcome.DONE: True, Outcome.PAUSED: False}


@cache
def judgements(adaptive: bool) -> tuple[Callable[..., int], ...]:
    """Return the procedure by each printer, with a reference to its machine code."""
    procedure = assess_correction.form(adaptive=adaptive)
    code = Module(module([procedure]), optimize=True)
    types = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double, ctypes.c_double, ctypes.c_int64
    machine = ctypes.CFUNCTYPE(ctypes.c_int64, *types)(code.address(procedure.name))

    def compiled(newton: Any, *numbers: Any, code: Module = code) -> int:
        return int(machine(ctypes.addressof(newton), *numbers))

    def interpreted(*arguments: Any) -> int:
        return int(run(procedure, *arguments)[0])

    return interpreted, loaded(procedure), compiled


class Solve:
    """A nonlinear solve of a step, with a matrix for steps of 0.5."""

    def __init__(self, *, adaptive: bool = False, rate: float = 0.1, noise: float = 1.0, age: int = 0) -> None:
        self.adaptive = adaptive
        self.known: Any = NEWTON.structure(matrix_step=0.5, differentiated=1, rate=rate, noise=noise, age=age)

    def outcome(self, iteration: int, norm: float, previous: float, since: int) -> Outcome:
        """Return the decision about a correction, after a check that all printers agree on it and on the record."""
        before, result = bytes(self.known), []
        for judgement in judgements(self.adaptive):
            made = NEWTON.structure.from_buffer_copy(before)
            result.append((judgement(made, iteration, norm, previous, since), bytes(made)))
        assert result[0] == result[1] == result[2]
        self.known = NEWTON.structure.from_buffer_copy(result[0][1])
        return Outcome(result[0][0])

    def enough(self, iteration: int, norm: float, previous: float, since: int) -> bool:
        """True if the method has converged, after a check that it has not given up."""
        return VERDICTS[self.outcome(iteration, norm, previous, since)]


def newton(*, adaptive: bool = False, rate: float = 0.1, noise: float = 1.0, age: int = 0) -> Solve:
    return Solve(adaptive=adaptive, rate=rate, noise=noise, age=age)


def renewed(result: Solve) -> bool:
    """Return whether the next correction, or the next step, updates the matrix and the derivative."""
    assert (result.known.matrix_step == 0.0) == (not result.known.differentiated)
    return bool(result.known.matrix_step == 0.0)


# --- enough ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("adaptive", "bound"), [(False, ROUND_OFF_FRACTION), (True, TOLERANCE_FRACTION)])
@pytest.mark.parametrize(("part", "enough"), [(0.9, True), (1.1, False)])
def test_what_is_left_is_the_rest_of_a_geometric_series(
    adaptive: bool, bound: float, part: float, enough: bool
) -> None:
    """The ratio of a first correction is that of the previous step; later ratios are measured."""
    rate = 0.2
    norm = part * bound * (1 - rate) / rate
    assert newton(adaptive=adaptive, rate=rate).enough(0, norm, 0.0, FAR) is enough
    result = newton(adaptive=adaptive, rate=0.9, noise=1.0)
    assert result.enough(1, norm, norm / rate, FAR) is (enough or (not adaptive and norm / rate <= 1))
    if enough:
        assert result.known.rate == pytest.approx(rate)


def test_two_corrections_in_a_row_are_round_off() -> None:
    for norm, previous, enough in ((0.9, 0.95, True), (0.9, 1.1, False), (1.1, 0.95, False)):
        assert newton().enough(1, norm, previous, 0) is enough
        assert newton(noise=2.0).enough(1, 2 * norm, 2 * previous, 0) is enough
        assert newton(adaptive=True).enough(1, norm / 2, norm, 0) is False
    assert newton(rate=0.9).enough(0, 0.9, 0.0, 0) is False, "there is no correction before the first"


def test_a_rate_that_is_not_measured_ages() -> None:
    for before, after in ((0.1, 0.1 * RATE_INCREASE), (0.85, LARGEST_RATE)):
        result = newton(rate=before)
        assert result.enough(0, 1e-6, 0.0, FAR)
        assert result.known.rate == pytest.approx(after)
    result = newton()
    assert result.enough(1, 1e-9, 1.0, FAR)
    assert result.known.rate == LEAST_RATE


def test_noise_is_forgotten_down_to_one() -> None:
    for before, after in ((5.0, 5.0 * NOISE_DECAY), (1.05, 1.0), (1.0, 1.0)):
        result = newton(noise=before)
        assert result.enough(0, 1e-6, 0.0, FAR)
        assert result.known.noise == pytest.approx(after)


@pytest.mark.parametrize(
    ("iteration", "age", "new"),
    [
        (0, 0, False),
        (FEW_CORRECTIONS - 1, MATRIX_AGE, False),
        (FEW_CORRECTIONS, MATRIX_AGE - 2, False),
        (FEW_CORRECTIONS, MATRIX_AGE - 1, True),
        (0, LARGEST_MATRIX_AGE - 2, False),
        (0, LARGEST_MATRIX_AGE - 1, True),
    ],
)
def test_a_step_of_many_corrections_or_an_old_matrix_wants_a_new_one(iteration: int, age: int, new: bool) -> None:
    result = newton(age=age)
    assert result.enough(iteration, 1e-6, 1e-3, FAR)
    assert result.known.age == age + 1 and renewed(result) is new


@pytest.mark.parametrize(
    ("iteration", "rate", "new"), [(0, 0.1, False), (1, 2 * FRESH_RATE, True), (1, FRESH_RATE / 2, False)]
)
def test_where_steps_follow_the_error_a_slow_step_wants_a_new_matrix(iteration: int, rate: float, new: bool) -> None:
    result = newton(adaptive=True)
    assert result.enough(iteration, 1e-6, 1e-6 / rate, FAR)
    assert renewed(result) is new


# --- not enough -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [SLOW_RATE / 2, 2 * SLOW_RATE, 1.5])
def test_corrections_that_shrink_slowly_want_a_new_matrix_where_it_is_old(rate: float) -> None:
    for since, old in ((0, False), (FRESH, False), (MATRIX_AGE - 1, False), (MATRIX_AGE, True), (FAR, True)):
        result = newton()
        assert not result.enough(1, 2 * STAGNATION_NORM, 2 * STAGNATION_NORM / rate, since)
        assert renewed(result) is (old and rate > SLOW_RATE)
        assert not newton(rate=rate).enough(0, 2 * STAGNATION_NORM, 0.0, since), "nothing is measured by the first"


def test_with_a_new_matrix_small_corrections_that_stall_are_round_off() -> None:
    for rate, norm, since, enough in (
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, FRESH, True),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, MATRIX_AGE - 1, True),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, 0, False),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM / 2, MATRIX_AGE, False),
        (1.1 * STAGNATION_RATE, STAGNATION_NORM * 2, FRESH, False),
        (0.9 * STAGNATION_RATE, STAGNATION_NORM / 2, FRESH, False),
        (3 * DIVERGENCE_GROWTH, STAGNATION_NORM / 2, FRESH, True),
    ):
        result = newton()
        assert result.enough(1, norm, norm / rate, since) is enough
        assert result.known.noise == (2 * norm if enough else 1.0)
        assert not newton(adaptive=True).enough(1, norm, norm / min(rate, 0.8), since)


def test_with_a_new_matrix_large_corrections_that_grow_have_no_end() -> None:
    for rate, norm, since, hopeless in (
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, FRESH, True),
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, MATRIX_AGE - 1, True),
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, 0, False),
        (1.1 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, MATRIX_AGE, False),
        (0.9 * DIVERGENCE_GROWTH, 2 * STAGNATION_NORM, FRESH, False),
    ):
        if hopeless:
            assert newton().outcome(1, norm, norm / rate, since) is Outcome.DIVERGED
        else:
            assert not newton().enough(1, norm, norm / rate, since)


def test_where_steps_follow_the_error_slow_corrections_want_a_shorter_one() -> None:
    for rate in (1.1 * DIVERGENCE_RATE, 5.0, np.nan):
        assert newton(adaptive=True).outcome(1, 100.0, 100.0 / rate, FRESH) is Outcome.DIVERGED
    assert not newton(adaptive=True).enough(1, 100.0, 100.0 / (0.9 * DIVERGENCE_RATE), FRESH)
    assert not newton(adaptive=True, rate=5.0).enough(0, 100.0, 0.0, FRESH)
