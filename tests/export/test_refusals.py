"""Exports that are not possible are refused with a message, and leave no files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

import pytest
from sympy import erf, sqrt

import lagrange as lg
from lagrange.export.target import REGISTERED, Target, find, register


def pendulum(**stated: Any) -> lg.System:
    theta = lg.coordinate("theta")
    m, k = lg.parameters("m k")
    known: dict[str, Any] = {
        "kinetic": m * theta.dot**2 / 2,
        "potential": k * theta**2 / 2,
        "parameters": {m: 1, k: 2},
        "name": "spring",
    }
    return lg.System(**(known | stated))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"target": "basic"}, "there is no target 'basic'; the targets are c"),
        ({"target": "cc"}, "Did you mean 'c'?"),
        ({"contents": ["multipliers"]}, "spring has no constraints, and so no multipliers"),
        ({"contents": ["positions"]}, "spring states no positions to export: state them"),
        ({"contents": ["events"]}, "spring has no events to export: give them"),
        ({"contents": ["jacobain"]}, "Did you mean 'jacobian'?"),
        ({"contents": ["radau5"]}, "the method 'radau5' cannot be exported"),
        ({"contents": "rhs"}, "contents is 'rhs': give a list of names"),
        ({"contents": []}, "contents is []: give a list of names"),
        ({"contents": [3]}, "contents is [3]: give a list of names"),
        ({"parameters": {"z": 1}}, "z"),
        ({"parameters": {"m": 0}}, "the mass matrix of spring is singular in every state with m = 0"),
        ({"target": "fmu", "contents": ["rk4"]}, "runs with error control, which rk4 does not have"),
        ({"target": "fmu", "contents": ["dop853", "tsit5"]}, "one method, and contents has dop853 and tsit5"),
    ],
)
def test_a_wrong_argument(given: dict[str, Any], said: str, tmp_path: Path) -> None:
    arguments = {"target": "c", "path": tmp_path / "out", **given}
    with pytest.raises(lg.StatementError, match=r".") as caught:
        pendulum().export(**arguments)
    assert said in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_energies_of_a_system_that_states_its_lagrangian_alone(tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match="two-point-vortices states its Lagrangian alone, not T and V"):
        lg.scene("two-point-vortices").export("c", tmp_path, ["energies"])


def test_a_parameter_without_a_value(tmp_path: Path) -> None:
    theta = lg.coordinate("theta")
    m, k = lg.parameters("m k")
    system = lg.System(kinetic=m * theta.dot**2 / 2, potential=k * theta**2 / 2, parameters={m: 1})
    with pytest.raises(lg.StatementError, match="k"):
        system.export("c", tmp_path)
    assert system.export("c", tmp_path, parameters={k: 3.0}).files


def test_a_parameter_that_leaves_no_values_anywhere(tmp_path: Path) -> None:
    system = lg.scene("double-pendulum")
    with pytest.raises(lg.StatementError, match="near the initial one with l2 = 0, which the self-test needs"):
        system.export("c", tmp_path, parameters={"l2": 0.0})


def test_a_splitting_of_a_system_that_does_not_split(tmp_path: Path) -> None:
    with pytest.raises(lg.StatementError, match="its mass matrix changes along the motion"):
        lg.scene("double-pendulum").export("c", tmp_path, ["verlet"])


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(lg.StatementError, match="cannot be made"):
        pendulum().export("c", tmp_path / "out")


def test_a_file_in_the_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(lg.StatementError, match="cannot be made"):
        pendulum().export("c", tmp_path / "out")
    assert (tmp_path / "out").read_text() == "mine"


class Plain(Target):
    """A user's target that has no error function (erf)."""

    name = "plain"
    about = "one line"
    contents = frozenset[str]()
    inexpressible = frozenset(("erf",))

    def files(self, module: Any) -> dict[str, str | bytes]:
        return {f"{module.name}.txt": "\n".join(quantity.name for quantity in module.quantities) + "\n"}

    def commands(self, module: Any) -> list[str]:
        return [f"test -f {module.name}.txt"]


@pytest.fixture
def plain() -> Any:
    register(Plain)
    yield find("plain")
    del REGISTERED["plain"]


@pytest.mark.usefixtures("plain")
def test_a_target_of_a_users_own(tmp_path: Path) -> None:
    assert lg.targets()["plain"] == "one line"
    made = pendulum().export("plain", tmp_path, ["rhs", "momenta"])
    assert (tmp_path / "spring.txt").read_text() == "rhs\nmomenta\n"
    assert made.commands == ("test -f spring.txt",)
    with pytest.raises(lg.StatementError, match="target 'plain' has no rk4: leave it out of contents, or take c"):
        pendulum().export("plain", tmp_path, ["rk4"])


@pytest.mark.usefixtures("plain")
def test_a_function_that_a_target_does_not_have(tmp_path: Path) -> None:
    theta = lg.coordinate("theta")
    with pytest.raises(lg.StatementError, match="contains erf, which target 'plain' has no function for: c"):
        lg.System(kinetic=theta.dot**2 / 2, potential=erf(theta), name="spring").export("plain", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_target() -> None:
    with pytest.raises(lg.StatementError, match="is not a target"):
        register(cast("Any", dict))
    with pytest.raises(lg.StatementError, match="there is a target 'fortran' already: give another name"):
        register(type("Mine", (Plain,), {"name": "fortran"}))


def test_a_step_is_tested_elsewhere_where_there_is_no_motion_from_the_initial_state(tmp_path: Path) -> None:
    x, y = lg.coordinates("x y")
    kepler = lg.System(kinetic=(x.dot**2 + y.dot**2) / 2, potential=-1 / sqrt(x**2 + y**2), name="kepler")
    assert kepler.export("c", tmp_path, ["rk4", "dop853"]).files
