"""A record of a procedure's own: its fields are zero at first, and other procedures may write them."""

from __future__ import annotations

from typing import Any

import pytest

from lagrange.machine.llvm.called import CompiledProcedure
from lagrange.machine.python_source import loaded
from lagrange.procedure import interpreter
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, WHOLE, Procedure, Record

TALLY = Record.of("Tally", total=REAL, count=WHOLE)


def add() -> Procedure:
    p = Builder("add", "Add a number to a tally.")
    tally: Any = p.record("tally", TALLY)
    number = p.given("number", REAL)
    tally.total = tally.total + number
    tally.count = tally.count + 1
    return p.finish()


def mean() -> Procedure:
    p = Builder("mean", "Return the mean of x and of numbers below a count, each added to a tally.")
    x, count = p.given("x", REAL), p.given("count", WHOLE)
    tally = p.reserve_record(TALLY)
    adding = add()
    p.call(adding, tally, x)
    with p.loop(0, count) as i:
        p.call(adding, tally, p.real(i))
    p.leave(tally.total / p.real(tally.count))
    return p.finish(REAL)


@pytest.mark.parametrize("make", [lambda p: lambda *a: interpreter.run(p, *a)[0], loaded, CompiledProcedure])
def test_it_is_empty_at_every_call(make: Any) -> None:
    run = make(mean())
    for _ in range(2):
        assert run(6.0, 4) == (6 + 0 + 1 + 2 + 3) / 5
