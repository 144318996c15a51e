"""Scene files: their contents, and all refusals."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import sympy

from lagrange.errors import SceneError, StatementError
from lagrange.statement.coordinate import coordinate, t, velocity_of
from lagrange.statement.run_settings import RunSettings
from lagrange.statement.scene import scene_reader as module
from lagrange.statement.scene.library import library, library_path, load
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.statement import Link
from tests.statement.scenes import DROP, write

theta = coordinate("theta")
m, l, g, c = (sympy.Symbol(name, real=True) for name in "mlgc")


def test_a_scene_becomes_a_statement(tmp_path: Path) -> None:
    result = read_scene(
        write(
            tmp_path,
            about="swings\n to and fro",
            source="a book",
            dissipation="k*theta_dot**2",
            parameters={"m": 1, "l": "1/2", "g": 9.81, "c": "pi/6", "k": 0, "unused": 3},
            initial={"theta": "pi/2", "theta_dot": -1},
            run={"t_end": "2*pi", "method": "dop853", "rtol": 1e-9, "atol": 0, "step": 0.1},
        )
    )
    assert result.names == ("theta",)
    assert result.kinetic == m * l**2 * velocity_of(theta) ** 2 / 2
    assert result.potential == -m * g * l * sympy.cos(theta)
    assert result.lagrangian == result.kinetic - result.potential
    assert result.forces == (-c * velocity_of(theta),)
    assert result.dissipation == sympy.Symbol("k", real=True) * velocity_of(theta) ** 2
    assert {symbol.name: value for symbol, value in result.defaults.items()} == {
        "m": 1.0, "l": 0.5, "g": 9.81, "c": float(sympy.pi / 6), "k": 0.0, "unused": 3.0,
    }  # fmt: skip
    assert result.initial == (float(sympy.pi / 2), -1.0)
    assert dict(result.positions) == {"bob": (l * sympy.sin(theta), -l * sympy.cos(theta))}
    assert result.links == (Link("origin", "bob"),)
    assert (result.name, result.about, result.source) == ("pendulum", "swings to and fro", "a book")
    assert result.run == RunSettings(float(2 * sympy.pi), "dop853", 1e-9, 0.0, 0.1)


def test_most_of_a_scene_may_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "my-scene.toml"
    path.write_text('coordinates = ["x"]\nlagrangian = "x_dot**2/2 - x*t"\nconstraints = []\n', encoding="utf-8")
    result = read_scene(path)
    assert result.name == "my-scene"
    assert result.lagrangian == velocity_of(coordinate("x")) ** 2 / 2 - coordinate("x") * t
    assert result.initial == (0.0, 0.0)
    assert result.run == RunSettings()
    path = path.rename(tmp_path / "-.toml")
    assert read_scene(path).name == "scene"


def test_energies_may_be_numbers(tmp_path: Path) -> None:
    assert read_scene(write(tmp_path, potential=0)).potential == 0
    assert read_scene(write(tmp_path, dissipation=0)).dissipation == 0
    assert read_scene(write(tmp_path, forces={"theta": -3})).forces == (-3,)


def test_names_may_be_greek_letters(tmp_path: Path) -> None:
    energies = {"kinetic": "m*θ_dot**2/2", "potential": "-Ω*cos(2*θ)"}
    result = read_scene(write(tmp_path, energies, coordinates=["θ"], parameters={"m": 1, "Ω": 2}, initial={"θ_dot": 2}))
    assert result.names == ("θ",) and result.initial == (0.0, 2.0)
    assert result.potential == -sympy.Symbol("Ω", real=True) * sympy.cos(2 * coordinate("θ"))


# --- refusals: field, its value, line, column, reason ------------------------------------------------------------

Bad = tuple[dict[str, Any], int, int, str]
FIELDS: list[Bad] = [
    # the scene (one field per line: name, coordinates, kinetic, potential, forces, parameters, initial, ...)
    ({"kinetc": "x"}, 11, 1, "'kinetc' is not a key of a scene; there are name, about, source, coordinates, kinetic,"),
    ({"name": 3}, 1, 8, "name is an integer: give a text in quotation marks."),
    ({"name": "../etc"}, 1, 8, "a scene's name must have 1 to 64 printable characters"),
    ({"about": "\x1b[2J"}, 11, 9, "about contains a control character: write plain text."),
    ({"constraints": "theta"}, 11, 15, "constraints is a text: write a table [constraints] of names and values."),
    ({"constraints": ["theta >= 1"]}, 11, 16, "constraints[0] is an inequality. Constraints are equations"),
    ({"constraints": ["theta = 1"]}, 11, 23, "for an equation or a comparison write =="),
    # coordinates
    ({"coordinates": DROP}, 1, 1, 'there are no coordinates: write coordinates = ["theta"].'),
    ({"coordinates": []}, 2, 15, "there are no coordinates"),
    ({"coordinates": ["theta", "theta"]}, 2, 25, "'theta' cannot name a coordinate, because it is a coordinate"),
    ({"coordinates": ["x", "x_dot"]}, 2, 21, "'x_dot' cannot name a coordinate, because it is taken: x_dot"),
    # energies
    ({"kinetic": "m*l**2*thta_dot**2/2"}, 3, 19, "kinetic: 'thta_dot' is not declared: add it to [parameters] or"),
    ({"kinetic": ["m"]}, 3, 11, 'kinetic is a list: give an expression as a text, such as "2*x".'),
    ({"kinetic": "m*l**2"}, 3, 11, "kinetic does not contain theta_dot, so theta has no inertia and its"),
    ({"dissipation": "m"}, 11, 15, "the dissipation is m, without a velocity"),
    ({"constraints": ["m - 1"]}, 11, 15, "constraint 'constraint_1' contains no coordinate and no velocity (m - 1"),
    ({"constraints": {"rod": "m - 1"}}, 11, 24, "constraint 'rod' contains no coordinate and no velocity"),
    ({"redundant": "drop"}, 11, 13, "redundant is 'drop': give one of refuse and allow."),
    ({"simultaneous": "both"}, 11, 16, "simultaneous is 'both': give one of"),
    ({"dimensions": {"m": "kgg"}}, 11, 14, "the dimension of m is 'kgg', which is neither a dimension nor a unit."),
    ({"lagrangian": "m", "kinetic": DROP, "potential": DROP}, 9, 14, "lagrangian does not contain theta_dot"),
    ({"potential": "-m*g*l*cos(phi)"}, 4, 25, "potential: 'phi' is not declared"),
    ({"potential": True}, 4, 13, "potential is true or false: give an expression as a text"),
    ({"dissipation": "theta_dot^2"}, 11, 25, "dissipation: '^' is not allowed in an expression: write ** for a power."),
    # forces
    ({"forces": {"phi": "1"}}, 5, 11, "'phi' is not a coordinate of this scene; there are theta."),
    # parameters
    ({"parameters": {"m": True}}, 6, 21, 'parameters.m is true or false: give a number, or a constant'),
    ({"parameters": {"theta": 1}}, 6, 15, "'theta' cannot name a parameter, because it is a coordinate already"),
    # initial state
    ({"initial": {"phi": 1}}, 7, 12, "'phi' is not a coordinate or velocity of this scene; there are theta and"),
    # positions and links
    ({"positions": {"bob": ["0", "l*sin(phi)"]}}, 8, 35, "positions.bob[1]: 'phi' is not declared"),
    ({"links": [["origin", "bobb"]]}, 9, 21, "links names 'bobb', which is not a position; they are origin and bob."),
    # run
    ({"run": {"t_end": 0}}, 10, 18, "t_end is 0: give the time at which the run ends, other than the start."),
    ({"run": {"method": "rm -rf /"}}, 10, 19, "method is not a name of a method: write one such as 'dop853'."),
]  # fmt: skip


@pytest.mark.parametrize("bad", FIELDS, ids=lambda bad: f"{next(iter(bad[0]))}-{bad[3][:24]}")
def test_a_refusal_says_where_and_why(bad: Bad, tmp_path: Path) -> None:
    fields, line, column, reason = bad
    path = write(tmp_path, **fields)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert reason in caught.value.reason
    assert (caught.value.line, caught.value.column) == (line, column)
    assert str(caught.value).startswith(f"{path}:{line}:{column}: ")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_numbers_are_finite(value: str, tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text("utf-8").replace("9.81", value), encoding="utf-8")
    with pytest.raises(SceneError, match=r"parameters.g is -?(nan|inf): give a finite number") as caught:
        read_scene(path)
    assert caught.value.line == 6


def test_what_only_the_statement_can_see_is_refused_with_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(**_: Any) -> None:
        raise StatementError("no.")

    monkeypatch.setattr(module, "declare", refuse)
    path = write(tmp_path)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert str(caught.value) == f"{path}:1:1: no."


def test_a_misspelt_scene_of_the_library() -> None:
    with pytest.raises(StatementError, match=r"no scene 'pendulm'; it has .* Did you mean 'pendulum'\?"):
        load("pendulm")


@pytest.mark.parametrize("name", ["../scenes/pendulum", "/etc/passwd", "", "pendulum.toml", "\x00"])
def test_the_library_holds_names_and_not_paths(name: str) -> None:
    with pytest.raises(StatementError, match="the library has no scene"):
        library_path(name)


@pytest.mark.parametrize("path", ["my.toml", "scenes/mine", Path("my.toml"), "pendulum.toml", "a scene"])
def test_a_file_is_not_a_scene_of_the_library(path: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a scene").touch()
    with pytest.raises(StatementError, match=re.escape(f"lg.System.from_scene('{path}')")):
        library_path(path)


def test_the_library_lists_what_it_loads() -> None:
    entries = library()
    for entry in entries:
        assert library_path(entry.name) == entry.path
    for entry in entries[::12]:  # every scene is loaded by tests of its own
        assert load(entry.name).about == entry.about


def test_constraints_are_expressions_or_equations_with_two_sides(tmp_path: Path) -> None:
    """A condition inside an expression is not an equation."""
    forms = ["theta**2 - 1", "theta**2 == 1", "theta**2 - (1 if theta == theta else 2)"]
    held = [read_scene(write(tmp_path, constraints=[form])).constraints[0].expression for form in forms]
    assert held[0] == held[1] and held[2].has(held[0].args[0])
