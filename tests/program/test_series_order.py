"""The order of a step, without round-off: the error of one step of order p goes like h^(p+1)."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from lagrange.program.series import SeriesProgram
from lagrange.program.taylor import series_program
from lagrange.statement.statement import Statement
from tests.models import SYSTEMS, laws, statement_of
from tests.series import CONTEXT, NUMBER, coefficients

NONLINEAR = (
    "pendulum",
    "Henon-Heiles",
    "Kepler orbit",
    "double pendulum",
    "elastic pendulum",
    "cart and pole",
    "blocks",
)
HIGH = 40
"""An order at which a step of 1/4096 is right to more than 120 digits: the error of order 24 there is about 1e-80."""


@cache
def program(name: str) -> tuple[SeriesProgram, Statement]:
    return series_program(laws(name))[0], statement_of(name)


def start(name: str) -> list[Any]:
    """Return a state with velocities: from rest the error of every other order is smaller by one more power."""
    statement = SYSTEMS[name]()
    n = len(statement.coordinates)
    return [NUMBER(x) for x in statement.initial[:n]] + [NUMBER(0.25) + NUMBER(i) / 8 for i in range(n)]


def summed(rows: Any, h: Any, order: int) -> Any:
    return sum(rows[j] * h**j for j in range(order + 1))


def step(name: str, time: Any, y: Any, h: Any) -> Any:
    return summed(coefficients(*program(name), HIGH, time, list(y)), h, HIGH)


@pytest.mark.few
@pytest.mark.parametrize("name", NONLINEAR)
def test_the_error_of_a_step_is_of_the_claimed_order(name: str) -> None:
    """Against two steps of half the length, each from its own series: c[p+1] h^(p+1) (1 + O(h)), O(h) some 0.01."""
    time, y = NUMBER(0.25), start(name)
    rows = coefficients(*program(name), HIGH, time, y)
    errors: dict[Any, list[Any]] = {}
    for h in (NUMBER(1) / 4096, NUMBER(1) / 8192):
        truth = step(name, time + h / 2, step(name, time, y, h / 2), h / 2)
        errors[h] = [max(abs(summed(rows, h, p) - truth)) for p in range(4, 25)]
    for p, far, near in zip(range(4, 25), *errors.values(), strict=True):
        assert float(CONTEXT.log(far / near, 2)) == pytest.approx(p + 1, abs=0.05), p
