from __future__ import annotations

import sympy as sp

from lagrange.evidence.precise import all_ways, describe_way
from lagrange.statement.coordinate import coordinate
from lagrange.statement.declare import declare

x, y = coordinate("x"), coordinate("y")
STATEMENT = declare(kinetic=x.dot**2 + y.dot**2, potential=x * y, coordinates=[x, y])


def test_every_kind_of_switch_has_its_ways_and_words() -> None:
    most = sp.Max(x, 2 * y)
    assert all_ways(most) == (0, 1)
    i = most.args.index(2 * y)
    assert describe_way(most, i, STATEMENT) == "2*y is the one that Max(x, 2*y) takes"
    assert all_ways(sp.Abs(x)) == (-1, 1) == all_ways(sp.sign(x))
    assert describe_way(sp.Abs(x.dot), -1, STATEMENT) == "x_dot is negative"
    assert describe_way(sp.sign(x), 1, STATEMENT) == "x is positive"
    assert all_ways(x > 1) == (0, 1)
    assert describe_way(x > 1, 1, STATEMENT) == "x > 1 holds"
    assert describe_way(x <= y, 0, STATEMENT) == "x <= y does not hold"


def test_long_conditions_are_cut() -> None:
    text = describe_way(sum(sp.sin(i * x) for i in range(40)) > 0, 1, STATEMENT)
    assert len(text) < 100 and text.endswith("... holds")
