"""Open inputs in exported files: entries of the parameters that may change along a motion; FMU variables of causality
input.
"""

from __future__ import annotations

import ctypes
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import lagrange as lg
from tests.statement.inputs import VALUES, X, at, driven, theta, u

STATE, TIME = [0.7, -1.3], 0.4


@pytest.fixture(scope="module")
def expected() -> list[float]:
    """Return the right-hand side at a state for values of the inputs."""
    result: list[float] = driven().substitute(VALUES).compile("numpy").rhs(TIME, STATE).tolist()
    return result


@pytest.mark.parametrize("target", [target for target in lg.targets() if target != "fmu"])
def test_every_target_takes_inputs(target: str, tmp_path: Path) -> None:
    made = driven().export(target, tmp_path, ["rhs"], parameters=at(TIME))
    texts = [path.read_text() for path in made.files]
    assert any("inputs: X, X_dot, X_ddot, u:" in text for text in texts)
    if target == "modelica":
        assert any("  input Real u(start = " in text for text in texts)


def test_an_input_is_written_into_what_was_prepared(tmp_path: Path, expected: list[float]) -> None:
    driven().export("c", tmp_path, ["rhs"])
    command = ["cc", "-shared", "-fPIC", "-O1", "-o", "driven.so", "driven.c", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "driven.so"))
    prepared, out = (ctypes.c_double * 100)(), (ctypes.c_double * 2)()
    assert library.driven_prepare((ctypes.c_double * 7)(1.5, 9.81, 2.0), prepared) == 0
    prepared[3:7] = list(at(TIME).values())
    assert library.driven_rhs(ctypes.c_double(TIME), (ctypes.c_double * 2)(*STATE), prepared, out) == 0
    np.testing.assert_allclose(list(out), expected, rtol=1e-13)


def test_an_fmu_has_variables_of_causality_input(tmp_path: Path) -> None:
    made = driven().export("fmu", tmp_path, ["rhs", "jacobian"])
    for path in made.files:
        with zipfile.ZipFile(path) as packed:
            root = ElementTree.fromstring(packed.read("modelDescription.xml"))
        scalars = [*root.iter("ScalarVariable"), *root.iter("Float64")]
        inputs = [item for item in scalars if item.get("causality") == "input"]
        assert [item.get("name") for item in inputs] == ["X", "X_dot", "X_ddot", "u"]
        assert {item.get("variability") for item in inputs} == {"continuous"}
        assert {item.get("initial") for item in inputs} == {None}
        exchange = root.find("ModelExchange")
        assert exchange is not None
        key = "providesDirectionalDerivative" + "s" * ("fmi3" in path.name)
        assert exchange.get(key) == "false"


def test_a_series_of_an_open_input_is_refused(tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match="taylor needs every derivative of X and u, which has no formula"):
        driven().export("c", tmp_path, ["taylor"])


@pytest.mark.slow
def test_casadi_and_jax_take_inputs_in_the_parameters(expected: list[float]) -> None:
    model = driven().compile("numpy")
    p = model.parameter_array(at(TIME))
    casadi = pytest.importorskip("casadi", reason="CasADi is not installed")
    rhs, symbol = model.as_casadi("rhs"), casadi.SX.sym("p", 7)
    np.testing.assert_allclose(rhs(TIME, STATE, p.tolist()).full().ravel(), expected, rtol=1e-13)
    slope = casadi.Function("B", [symbol], [casadi.jacobian(rhs(TIME, STATE, symbol), symbol[6])])
    np.testing.assert_allclose(slope(p.tolist()).full().ravel(), [0, 1 / (1.5 * 4)], rtol=1e-13)
    jax = pytest.importorskip("jax", reason="JAX is not installed")
    jax.config.update("jax_enable_x64", val=True)
    np.testing.assert_allclose(model.as_jax("rhs")(TIME, STATE, p), expected, rtol=1e-13)


def test_a_run_without_values_of_inputs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match=r"its inputs X and u have no value: give a constant value") as refusal:
        driven().export("c", tmp_path, ["main"])
    assert len(str(refusal.value)) <= 400 and list(tmp_path.iterdir()) == []
    driven().export("c", tmp_path, ["main"], parameters={"X": 0, "u": 0.5})  # the rates of X are zero
    subprocess.run(["cc", "-O1", "-o", "main", "driven.c", "driven_main.c", "-lm"], cwd=tmp_path, check=True)
    rows = subprocess.run(["./main", "1.0"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout.split()
    other = driven().substitute({X: 0, u: 0.5}).run(1.0, rtol=1e-10)
    # main has a tolerance of 1e-8.
    assert float(rows[-1].split(",")[1]) == pytest.approx(other[theta][-1], rel=1e-6)


def test_the_rate_of_a_constant_input_is_zero(tmp_path: Path) -> None:
    i, voltage = lg.coordinate("i"), lg.given("u")
    circuit = lg.System(kinetic=0, forces={i: voltage - i}, dissipation=i.dot**2 / 2, name="circuit")
    assert "u_dot" in [symbol.name for symbol in circuit.compile("numpy").statement.parameters]
    with pytest.raises(lg.StatementError, match="its input u has no value: give"):
        circuit.export("python", tmp_path, ["main"])
    texts = []
    for held in ({voltage: 12.0}, {voltage: 12.0, voltage.dot: 0.0}):
        made = circuit.export("python", tmp_path, ["rhs", "dop853", "main"], parameters=held)
        texts.append([path.read_text() for path in made.files])
    assert texts[0] == texts[1]
