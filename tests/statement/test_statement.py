"""The record that every later stage reads."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import sympy

from lagrange.statement.coordinate import coordinates, parameters
from lagrange.statement.declare import declare
from lagrange.statement.run_settings import RunSettings
from lagrange.statement.statement import Statement
from lagrange.system import System

x, y = coordinates("x y")


@pytest.fixture
def statement() -> Statement:
    return declare(kinetic=x.dot**2 + y.dot**2, potential=x * y)


def test_names_and_velocities(statement: Statement) -> None:
    assert statement.names == ("x", "y")
    assert statement.velocities == (x.dot, y.dot)
    assert statement.velocities is statement.velocities, "a check reads them for each of its programs"
    assert "velocities" not in statement.__getstate__()
    assert statement.run == RunSettings(10.0, None, None, None, None)


def test_unused_parameters_are_known() -> None:
    m, k, b = parameters("m k b")
    stated = declare(kinetic=m * x.dot**2, parameters={m: 1, k: 2, b: 3}, positions={"p": (b, x)})
    assert stated.unused == (k,)
    said = System.from_statement(stated).structure
    assert said[-1] == "The parameter k stands in no energy, force, constraint or position."


def test_plain_symbols_are_real_and_differentiate(statement: Statement) -> None:
    plain = statement.plain
    assert [str(plain[q]) for q in (x, x.dot, x.ddot, y)] == ["x", "x_dot", "x_ddot", "y"]
    assert all(symbol.is_real for symbol in plain.values())
    assert (x.dot**2 + x).xreplace(plain).diff(plain[x.dot]) == 2 * sympy.Symbol("x_dot", real=True)


def test_a_statement_cannot_be_changed(statement: Statement) -> None:
    opened: Any = statement
    with pytest.raises(dataclasses.FrozenInstanceError):
        opened.kinetic = 0
    with pytest.raises(TypeError):
        opened.defaults["m"] = 1.0
