"""Coordinates, velocities, parameters and time."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
import sympy
from sympy.physics.mechanics import dynamicsymbols

from lagrange.errors import StatementError
from lagrange.statement.coordinate import (
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


def test_a_name_may_contain_greek_letters() -> None:
    assert name_of(coordinate("θ_1")) == "θ_1"


def test_functions_of_numpy_name_those_of_sympy() -> None:
    with pytest.raises(StatementError, match=r"works on numbers, and x is a coordinate: write sympy.cos\(x\)"):
        np.cos(coordinate("x"))
    with pytest.raises(StatementError, match=r"write sympy.atan\(x\), with from sympy import atan"):
        np.arctan(coordinate("x"))


def test_time_is_that_of_sympy_mechanics() -> None:
    assert t == dynamicsymbols._t


def test_coordinates_of_one_name_are_equal() -> None:
    assert coordinate("x") == coordinate("x")
    assert coordinate("x") != coordinate("y")
    assert coordinate("x") + dynamicsymbols("x") == 2 * coordinate("x")


def test_several_names_give_a_tuple_and_one_gives_itself() -> None:
    assert coordinates("x y") == coordinates("x, y") == (coordinate("x"), coordinate("y"))
    assert coordinates("x") == coordinate("x")
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


@pytest.mark.parametrize("name", ["x", "X", "x1", "theta_1", "E", "lambda", "x" * 64])
def test_identifiers_are_names(name: str) -> None:
    assert check_name(name, "point") == name


def test_time_cannot_be_a_coordinate_or_a_parameter() -> None:
    with pytest.raises(
        StatementError, match="'t' cannot name a coordinate, it is time: choose another name, such as t_1"
    ):
        coordinate("t")
    with pytest.raises(
        StatementError, match="'t' cannot name a parameter, it is time: choose another name, such as t_1"
    ):
        parameters("m t")


@pytest.mark.parametrize("names", ["", " ", ",", None, 3, ["x"]])
def test_no_names(names: Any) -> None:
    with pytest.raises(StatementError, match=r"names no coordinate: give a text such as 'x y'"):
        coordinates(names)
    with pytest.raises(StatementError, match=r"names no parameter: give a text such as 'x y'"):
        parameters(names)


def test_coordinates_copy() -> None:
    x = coordinate("x")
    assert copy.deepcopy(x) == x
    assert pickle.loads(pickle.dumps(parameters("m"))) == parameters("m")


def test_functions_of_ours_and_of_sympy_are_told_apart_whatever_is_in_the_cache() -> None:
    ours = coordinate("cached_before")
    assert is_ours(ours.func(t))
    assert not is_ours(dynamicsymbols("cached_before"))
    theirs = dynamicsymbols("cached_after")
    rebuilt = coordinate("cached_after").func(t)
    assert is_ours(rebuilt) and not is_ours(theirs) and rebuilt == theirs
