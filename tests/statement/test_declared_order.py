"""The order of states and of parameters is the user's: that of declaration, or of what is listed."""

from __future__ import annotations

import random

import pytest
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.statement.declared_order import DeclaredOrder


@pytest.mark.parametrize("names", ["alpha_1 beta_1 zeta_1", "zeta_1 beta_1 alpha_1", "beta_1 zeta_1 alpha_1"])
def test_states_follow_the_declaration(names: str) -> None:
    first, second, third = lg.coordinates(names)
    system = lg.System(third.dot**2 / 2 + first.dot**2 / 2 + second.dot**2, first * second**2 + third**2)
    assert list(system.statement.names) == names.split()
    other = lg.System(first.dot**2 + second.dot**2, coordinates=[second, first])
    assert [str(q.func) for q in other.coordinates] == [names.split()[1], names.split(maxsplit=1)[0]]


def test_scenes_and_other_symbols_leave_the_order() -> None:
    theta2, theta1 = lg.coordinates("theta2 theta1")
    assert lg.scene("double-pendulum").statement.names == ("theta1", "theta2")
    assert lg.System(theta1.dot**2 + theta2.dot**2).coordinates == (theta2, theta1)
    lg.coordinates("theta1 theta2")
    assert lg.System(theta1.dot**2 + theta2.dot**2).coordinates == (theta1, theta2)
    one, other = dynamicsymbols("a_other_1 b_other_1")
    assert lg.System(other.diff() ** 2 + one.diff() ** 2).statement.names == ("a_other_1", "b_other_1")


@pytest.mark.parametrize("names", ["m_1 g_1 l_1", "l_1 g_1 m_1"])
def test_parameters_follow_their_values_and_then_the_declaration(names: str) -> None:
    first, second, third = lg.parameters(names)
    x = lg.coordinate("x")
    energy = {"kinetic": first * x.dot**2, "potential": second * x**2 + third * x**4}
    assert [p.name for p in lg.System(**energy).statement.parameters] == names.split()
    valued = lg.System(**energy, parameters={third: 1.0}).statement.parameters
    assert valued == (third, first, second)
    assert list(lg.System(**energy, parameters={third: 1.0}).parameters) == [third]


def order(*calls: str) -> str:
    known = DeclaredOrder()
    for call in calls:
        known.declare(list(call))
    return "".join(
        known.of((name, name) for name in "zyxwvutsrqponmlkjihgfedcba" if any(name in call for call in calls))
    )


def test_the_last_call_counts_and_moves_nothing_else() -> None:
    assert order("xy", "z") == "xyz" and order("z", "xy") == "zxy"
    assert order("xy", "x", "y", "xy") == "xy"
    assert order("abcd", "ac", "bd") == "abcd"
    assert order("abcd", "ca") == "cbad"
    assert order("ab", "xa") == "xab" and order("ab", "ax") == "axb" and order("ab", "xyb") == "axyb"
    draw = random.Random(5)
    calls = ["".join(draw.sample("abcdefgh", draw.randint(1, 5))) for _ in range(40)]
    for k in range(1, 41):
        found = order(*calls[:k])
        assert [name for name in found if name in calls[k - 1]] == list(calls[k - 1])


def test_names_that_were_not_declared_come_last() -> None:
    known = DeclaredOrder()
    known.declare(["b"])
    assert known.of((name, name) for name in "zab") == ["b", "z", "a"]
