"""The order of states and of parameters is the user's: that of declaration, or of what is listed."""

from __future__ import annotations

import random

import pytest
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.statement.coordinate import DeclaredOrder


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


def order(*calls: str, names: str) -> str:
    """Return the order of names, one letter each, after calls that declare letters."""
    known = DeclaredOrder()
    for call in calls:
        known.declare(list(call))
    return "".join(known.of((name, name) for name in sorted(names, reverse=True)))


def test_the_latest_calls_that_declare_all_names_count() -> None:
    assert order("xy", "z", names="xyz") == "xyz" and order("z", "xy", names="xyz") == "zxy"
    assert order("xy", "yx", names="xy") == "yx" and order("xy", "x", names="xy") == "xy"
    assert order("abcd", "ac", "bd", names="abcd") == "acbd"
    assert order("abcd", "ca", names="abcd") == "abcd" and order("abcd", "ca", names="ac") == "ca"
    assert order("xy", "azx", names="xy") == "xy"


def test_earlier_declarations_have_no_effect() -> None:
    draw = random.Random(5)
    letters = "abcdefgh"
    for _ in range(200):
        before, program = (["".join(draw.sample(letters, draw.randint(1, 4))) for _ in range(6)] for _ in range(2))
        program.append("".join(set(letters).difference(*program)))
        names = "".join(draw.sample(letters, 5))
        assert order(*before, *program, names=names) == order(*program, names=names)
        assert order(*before, *letters, names=letters) == letters


def test_calls_are_kept_while_they_hold_the_latest_declaration_of_a_name() -> None:
    known = DeclaredOrder()
    for _ in range(100):
        known.declare(["x", "y"])
        known.declare(["y"])
    assert [*known.calls.values()] == [("x", "y"), ("y",)]


def test_states_follow_this_program_whatever_was_declared_before() -> None:
    """Another program in this process declared some of the names, and in another order."""
    lg.coordinates("u_2 u_1 u_3")
    lg.parameters("c_3 c_2")
    coordinates = [lg.coordinate(f"u_{i}") for i in range(5)]
    stiffness = [lg.parameters(f"c_{i}") for i in range(5)]
    springs = [c * q**2 for c, q in zip(stiffness, coordinates, strict=True)]
    system = lg.System(sum(q.dot**2 for q in coordinates), sum(springs))
    assert system.statement.names == ("u_0", "u_1", "u_2", "u_3", "u_4")
    assert [p.name for p in system.statement.parameters] == ["c_0", "c_1", "c_2", "c_3", "c_4"]


def test_names_that_were_not_declared_come_last() -> None:
    known = DeclaredOrder()
    known.declare(["b"])
    assert known.of((name, name) for name in "zab") == ["b", "z", "a"]
