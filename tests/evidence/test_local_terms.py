"""Terms by the coordinates in them: a check of many coordinates costs as much as its neighbours do."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
import sympy as sp
from mpmath import libmp

import lagrange as lg
from lagrange.evidence import laws as module
from lagrange.evidence.laws import LOCAL_FROM, local_terms
from lagrange.evidence.reference import Reference
from lagrange.evidence.sample import SAMPLE_KINDS, Sampler
from lagrange.statement.declare import declare
from lagrange.statement.statement import Statement


def row(length: int) -> Statement:
    """Masses in a row with springs, drag between neighbours and a force on the last."""
    x = [lg.coordinate(f"x{i}") for i in range(length)]
    k, m, c = lg.parameters("k m c")
    pairs = list(itertools.pairwise(x))
    return declare(
        kinetic=m / 2 * sum(one.dot**2 * (1 + x[0] ** 2 / 9) for one in x),
        potential=k * sum(sp.sqrt(1 + (a - b) ** 2) for a, b in pairs),
        dissipation=c / 2 * sum((a.dot - b.dot) ** 2 for a, b in pairs),
        forces={x[-1]: sp.sin(lg.t) * x[-2]},
        coordinates=x,
    )


def test_rows_are_those_that_a_variable_stands_in() -> None:
    length = LOCAL_FROM + 2
    local = local_terms(row(length), 30)
    assert local is not None and local_terms(row(LOCAL_FROM - 1), 30) is None
    assert local.touched[0] == list(range(length))
    assert local.touched[4] == [3, 4, 5] and local.touched[length + 4] == [0, 3, 4, 5]
    assert local.touched[length - 2] == [length - 3, length - 2, length - 1]


def test_local_terms_give_the_same_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    statement = row(5)
    point, columns = Sampler(statement, 0).point(SAMPLE_KINDS[1]), list(range(10))
    whole = Reference(statement).at(point, columns)
    monkeypatch.setattr(module, "LOCAL_FROM", 2)
    local = Reference(statement).at(point, columns)
    for name, entries in whole.items():
        for a, b, size in zip(entries.value, local[name].value, entries.size, strict=True):
            # Differences leave 36 of 90 digits.
            assert abs(a - b) <= 1e-30 * size + 1e-50, name


def test_a_column_of_the_jacobian_costs_few_evaluations_of_each_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = 8
    x = [[lg.coordinate(f"{axis}{i}") for axis in "xyz"] for i in range(bodies)]
    pairs = list(itertools.combinations(x, 2))
    statement = declare(
        kinetic=sum(rate.dot**2 for place in x for rate in place) / 2,
        potential=-sum(1 / sp.sqrt(sum((a - b) ** 2 for a, b in zip(*pair, strict=True))) for pair in pairs),
    )
    point, columns = Sampler(statement, 0).point(SAMPLE_KINDS[1]), range(3 * bodies)
    power, count = libmp.mpf_pow, 0

    def counted(*arguments: Any) -> Any:
        nonlocal count
        count += 1
        return power(*arguments)

    reference = Reference(statement)
    reference.at(point, [])
    monkeypatch.setattr(libmp, "mpf_pow", counted)
    reference.at(point, columns)
    # Rows outside columns: 31. With columns outside rows a force repeats all its pairs for each column: 98.
    assert count < 40 * len(columns) * len(pairs)


@pytest.mark.slow
def test_columns_that_are_left_out_are_told() -> None:
    system = lg.System.from_statement(row(LOCAL_FROM))
    report = system.check(points=1)
    assert report and "The Jacobian is checked in 24 of its 26 columns: points=2 checks all of them." in report.notes
