"""Coordinates, velocities, parameters and time."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest
import sympy
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.statement.coordinate import (
    DeclaredOrder,
    acceleration_of,
    check_name,
    coordinate,
    coordinates,
    is_ours,
    name_of,
    parameters,
    t,
    velocity_of,
)


def test_a_coordinate_is_a_function_of_time_with_velocity_and_acceleration() -> None:
    x = coordinate("x")
    assert x == sympy.Function("x")(t) == dynamicsymbols("x")
    assert hash(x) == hash(dynamicsymbols("x"))
    assert x.dot == x.diff(t) == velocity_of(dynamicsymbols("x"))
    assert x.ddot == x.diff(t, 2) == acceleration_of(dynamicsymbols("x"))
    assert name_of(x) == "x"
    assert str(x) == "x(t)"


def test_a_coordinate_has_its_rates_whatever_sympy_has_made_before() -> None:
    earlier = dynamicsymbols("q_made_before")
    assert coordinate("q_made_before").dot == earlier.diff(t)


def test_functions_of_numpy_name_those_of_sympy() -> None:
    with pytest.raises(StatementError, match=r"works on numbers, and x is a coordinate: write sympy.cos\(x\)"):
        np.cos(coordinate("x"))
    with pytest.raises(StatementError, match=r"write sympy.atan\(x\), with from sympy import atan"):
        np.arctan(coordinate("x"))


def test_several_names_give_a_tuple_and_one_gives_itself() -> None:
    assert coordinates("x y") == coordinates("x, y") == (coordinate("x"), coordinate("y"))
    assert coordinates("x") == coordinate("x") != coordinate("y")
    assert coordinates("x y")[0].dot == coordinate("x").dot


def test_parameters_are_real_and_positive_unless_told_otherwise() -> None:
    m, k = parameters("m k")
    assert m.is_positive and k.is_positive
    free = parameters("k", positive=False)
    assert free.is_real
    assert free.is_positive is None
    assert isinstance(free, sympy.Symbol)


@pytest.mark.parametrize("name", ["", "1x", "_x", "x-y", "x.y", "é", "x" * 65, "x y", "__import__", "x\n", None, 5])
def test_a_name_is_an_identifier(name: Any) -> None:
    with pytest.raises(StatementError, match="cannot name a point: a name starts with a letter"):
        check_name(name, "point")


@pytest.mark.parametrize("names", ["", " ", ",", None, 3, ["x"]])
def test_no_names(names: Any) -> None:
    with pytest.raises(StatementError, match=r"names no coordinate: give a text such as 'x y'"):
        coordinates(names)
    with pytest.raises(StatementError, match=r"names no parameter: give a text such as 'x y'"):
        parameters(names)


def test_functions_of_ours_and_of_sympy_are_told_apart_whatever_is_in_the_cache() -> None:
    ours = coordinate("cached_before")
    assert is_ours(ours.func(t))
    assert not is_ours(dynamicsymbols("cached_before"))
    theirs = dynamicsymbols("cached_after")
    rebuilt = coordinate("cached_after").func(t)
    assert is_ours(rebuilt) and not is_ours(theirs) and rebuilt == theirs


# --- The order of states and of parameters is the user's ---


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
    first, second = dynamicsymbols("a_other_1 b_other_1")
    assert lg.System(second.diff() ** 2 + first.diff() ** 2).statement.names == ("a_other_1", "b_other_1")


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
