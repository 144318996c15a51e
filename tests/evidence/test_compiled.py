"""The check and the quick check on models that were really compiled."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lagrange.compiler import model_of
from lagrange.equations.euler_lagrange import euler_lagrange
from lagrange.evidence.check import check
from lagrange.evidence.quick import quick_check
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.statement.statement import Statement
from tests.evidence import statements

HONEST = 1e-13
"""Rounding errors seen here are below 1e-14 of the size; the limit of the check is 2e-12."""


@pytest.mark.few(1)
@pytest.mark.parametrize("make", statements.ALL, ids=lambda make: make.__name__)
def test_compiled_systems_hold_on_both_targets(make: Callable[[], Statement]) -> None:
    statement = make()
    equations = euler_lagrange(statement)
    model, other = model_of(statement, LlvmMachine(), equations), model_of(statement, NumpyMachine(), equations)
    report = check(model, other=other, points=3, seed=2)
    assert report, str(report)
    assert all(0 <= row.error < HONEST for row in report.rows), str(report)
    quick_check(model)
    quick_check(other)


@pytest.mark.slow
def test_a_chain_holds() -> None:
    statement = statements.pendulum_chain(4)
    model = model_of(statement, LlvmMachine())
    quick_check(model)
    report = check(model, points=1)
    assert report, str(report)
