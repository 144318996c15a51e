"""The test of formulas at random states: what counts as agreement, and what a missing value does."""

from __future__ import annotations

import pytest

import lagrange as lg
from lagrange.evidence.agreement import compared, holds, random_points, usable
from lagrange.evidence.sample import SamplePoint


def test_places_without_a_value_are_skipped() -> None:
    assert list(usable(range(6), lambda k: k * k if k % 2 else None)) == [1, 9, 25]


def test_the_first_false_decides_and_too_few_values_decide_nothing() -> None:
    assert holds(range(9), lambda k: True if k % 2 else None, 4) is True
    assert holds(range(9), lambda k: True if k % 2 else None, 5) is None
    assert holds(range(9), lambda k: k < 2, 2) is True
    assert holds(range(9), lambda k: k < 2, 3) is False


def test_a_seed_gives_the_same_points_again() -> None:
    statement = lg.scene("double-pendulum").statement
    assert list(random_points(statement, 3)) == list(random_points(statement, 3))
    assert list(random_points(statement, 3)) != list(random_points(statement, 4))


def test_a_wrong_formula_is_refused_and_one_without_values_is_not() -> None:
    statement = lg.scene("pendulum").statement

    def values(share: float, point: SamplePoint) -> tuple[list[float], list[complex]]:
        return [1.0, point.q[0]], [1.0, point.q[0] * share]

    compared("the formula", statement, lambda point: values(1 + 1e-12, point))
    compared("the formula", statement, lambda point: values(float("nan"), point))
    with pytest.raises(lg.RunError, match="the formula of pendulum is wrong"):
        compared("the formula", statement, lambda point: values(1 + 1e-6, point))
