"""What a model cannot be asked is refused in the system's own names."""

from __future__ import annotations

import runpy
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.errors import StatementError
from lagrange.machine.model import Model
from tests.models import TARGETS, VALUES, build, m, model, r, shared_scene, z


class TestRefusals:
    """What cannot be meant is refused in the system's own names."""

    @pytest.fixture(params=TARGETS)
    def pendulums(self, request: pytest.FixtureRequest) -> Model:
        return model("double pendulum", request.param)

    @pytest.mark.parametrize(
        ("q", "v", "message"),
        [
            (
                [1.0],
                [1.0],
                r"q has shape \(1,\); this system has 2 coordinates \(a0, a1\): give \(2,\), or \(2, batch\)",
            ),
            ([1.0, 2.0], [1.0], r"v has shape \(1,\); this system has 2 coordinates"),
            (np.ones((2, 2)), np.ones((2, 3)), r"q has shape \(2, 2\) and v \(2, 3\): give both the same shape"),
            (np.ones((2, 2, 2)), np.ones((2, 2, 2)), r"q has shape \(2, 2, 2\)"),
            (1.0, 1.0, r"q has shape \(\)"),
            ([1j, 0], [0, 0], "q has entries of type complex128: give real numbers"),
            ([sp.Symbol("a"), 0], [0, 0], "q has entries of type object: give real numbers"),
            (["a", "b"], [0, 0], "q has entries of type <U1: give real numbers"),
            ([0, 0], [True, False], "v has entries of type bool: give real numbers"),
            ([None, 0], [0, 0], "q has entries of type object"),
        ],
    )
    def test_states(self, pendulums: Model, q: Any, v: Any, message: str) -> None:
        with pytest.raises(StatementError, match=message):
            pendulums.accelerations(q, v)

    def test_whole_states(self, pendulums: Model) -> None:
        with pytest.raises(StatementError, match=r"y has shape \(3,\): give \[q, v\] of shape \(4,\), or \(4, batch\)"):
            pendulums.rhs(0.0, [1, 2, 3])
        with pytest.raises(StatementError, match="y has entries of type complex128"):
            pendulums.jacobian(0.0, np.ones(4) * 1j)

    def test_ragged_lists(self, pendulums: Model) -> None:
        with pytest.raises(StatementError, match=r"q is not an array: .* Give rows of one length"):
            pendulums.accelerations([[1, 2], [3]], [[1, 2], [3]])

    @pytest.mark.parametrize(
        ("t", "message"),
        [
            (np.zeros(3), r"t has shape \(3,\) and the states have \(2,\) columns: give one time, or one per column"),
            (np.zeros((2, 1)), r"t has shape \(2, 1\)"),
            (1j, "the time t is 1j, a complex number"),
            ("now", "the time t is 'now'"),
            (sp.Symbol("t"), "the time t is t, an expression with symbols in it"),
            (np.array([1j, 0]), "the time t has entries of type complex128"),
        ],
    )
    def test_times(self, pendulums: Model, t: Any, message: str) -> None:
        with pytest.raises(StatementError, match=message):
            pendulums.accelerations(np.ones((2, 2)), np.ones((2, 2)), t)

    def test_a_time_per_column_without_columns(self, pendulums: Model) -> None:
        with pytest.raises(StatementError, match=r"t has shape \(1,\) and the states have no columns"):
            pendulums.accelerations(np.ones(2), np.ones(2), [0.0])

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"mass": 1}, "'mass' is not a parameter of this system; its parameters are"),
            ({"m": float("nan")}, "parameter m is nan: give a finite number"),
            ({"m": 1j}, "parameter m is 1j, a complex number"),
            ({"m": "heavy"}, r"parameter m is 'heavy' \(str\): give a number"),
            ({"m": sp.Symbol("a")}, "parameter m is a, an expression with symbols in it"),
        ],
    )
    def test_parameters(self, pendulums: Model, given: Any, message: str) -> None:
        with pytest.raises(StatementError, match=message):
            pendulums.accelerations([0.1, 0.2], [0, 0], parameters=given)

    def test_a_missing_parameter(self) -> None:
        free = build(kinetic=m * r.dot**2 / 2, potential=sp.Symbol("stiffness", real=True) * r**2)
        with pytest.raises(
            StatementError, match=r"no value for parameter stiffness: give one, for example parameters="
        ):
            free.accelerations([0.1], [0.0])
        assert free.accelerations([0.1], [0.0], parameters={"stiffness": 2})[0] == pytest.approx(-0.4 / VALUES[m])

    def test_a_quantity_that_is_not_there(self, pendulums: Model) -> None:
        with pytest.raises(StatementError, match="'speed' is not a quantity of a model: they are rhs, jacobian"):
            pendulums.evaluate("speed", [0, 0], [0, 0])

    def test_an_expression_with_a_stranger(self, pendulums: Model) -> None:
        with pytest.raises(StatementError, match=r"the expression contains z\(t\), which this system does not have"):
            pendulums.evaluate_expression(z, 0.0, np.ones((4, 2)))


@pytest.mark.parametrize(("name", "count"), [("none", 0), ("two words", 1), ("", 1)])
def test_a_function_has_a_name_and_a_node(name: str, count: int) -> None:
    compiled = model("oscillator")
    with pytest.raises(StatementError, match=f"there is no function '{name}' of {count} nodes: name it, and give a"):
        compiled.function(name, compiled.equations.q[:count])


def test_python_has_no_address_and_says_where_one_is() -> None:
    kernel = shared_scene("pendulum").compile("numpy").kernel("rhs")
    with pytest.raises(StatementError, match=r"no address: take that of the llvm target, system\.compile\('llvm'\)"):
        attrgetter("address")(kernel)


def test_the_source_runs_as_it_is_printed(tmp_path: Path) -> None:
    compiled = shared_scene("double-pendulum").compile()
    text, file = compiled.source("rhs"), tmp_path / "rhs.py"
    assert "p = model.parameter_array()" in text
    file.write_text(text)
    made = runpy.run_path(str(file))
    state = [0.3, 0.2, 0.1, -0.4]
    assert made["rhs"](compiled.parameter_array())(0.0, state) == pytest.approx(compiled.rhs(0.0, state))
