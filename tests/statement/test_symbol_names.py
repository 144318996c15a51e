"""One rule for names of coordinates and parameters: scenes and Python accept the same names."""

from __future__ import annotations

import keyword
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sympy
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.errors import SceneError, StatementError
from lagrange.statement.coordinate import PREDEFINED
from lagrange.statement.scene import expressions as text
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.vocabulary.functions import ALIASES, WORDS
from tests.models import shared_scene
from tests.statement.scenes import write

MEANT = {
    **PREDEFINED,
    **dict.fromkeys([*WORDS, *ALIASES], "a function"),
    **dict.fromkeys(keyword.kwlist, "a reserved word of Python"),
}
FREE = [
    *("x", "lambda_1", "lambda_", "lamda", "pi_1", "E", "I", "S", "gamma", "match", "type", "self", "dot", "time"),
    "ceil",
]
MALFORMED = ["", "2x", "_x", "x-y", "x.y", "x\n", "é", "x" * 65]

x_0 = lg.coordinate("x_0")


def test_what_is_predefined_is_what_a_text_may_use() -> None:
    assert PREDEFINED.keys() == text.PREDEFINED_VALUES.keys()


def as_coordinate(name: str) -> list[Callable[[Path], Any]]:
    return [
        lambda _: lg.coordinate(name),
        lambda _: lg.System(kinetic=dynamicsymbols(name).diff(sympy.Symbol("t")) ** 2 / 2, potential=0),
        lambda folder: read_scene(write(folder, {}, coordinates=[name], kinetic=f"{name}_dot**2/2")),
    ]


def as_parameter(name: str) -> list[Callable[[Path], Any]]:
    energies = {"coordinates": ["x_0"], "kinetic": f"{name}*x_0_dot**2/2"}
    return [
        lambda _: lg.parameters(name),
        lambda _: lg.System(kinetic=sympy.Symbol(name, real=True) * x_0.dot**2 / 2, potential=0),
        lambda _: lg.System(kinetic=x_0.dot**2 / 2, potential=0, parameters={name: 1}),
        lambda folder: read_scene(write(folder, energies, parameters={name: 1})),
    ]


@pytest.mark.parametrize("name", FREE)
def test_a_free_name_is_taken_everywhere(name: str, tmp_path: Path) -> None:
    for state in (*as_coordinate(name), *as_parameter(name)):
        state(tmp_path)


@pytest.mark.parametrize("name", MEANT)
def test_a_name_with_a_meaning_is_refused_everywhere(name: str, tmp_path: Path) -> None:
    for what, states in (("coordinate", as_coordinate(name)), ("parameter", as_parameter(name))):
        sentence = f"{name!r} cannot name a {what}, because it is {MEANT[name]}: choose another name, such as {name}_1."
        for state in states:
            with pytest.raises(StatementError) as refusal:
                state(tmp_path)
            reason = refusal.value.reason if isinstance(refusal.value, SceneError) else str(refusal.value)
            clash = f"parameter {name!r} clashes with" if name in PREDEFINED and what == "parameter" else sentence
            assert reason == sentence or reason.startswith(clash)


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_name_is_refused_everywhere(name: str, tmp_path: Path) -> None:
    for state in (as_coordinate(name)[-1], as_parameter(name)[-1], as_parameter(name)[-2], *as_coordinate(name)[:1]):
        with pytest.raises(StatementError, match=r"cannot name a (coordinate|parameter): a name starts with a letter"):
            state(tmp_path)


def test_a_symbol_called_pi_is_probably_the_constant() -> None:
    with pytest.raises(StatementError, match=r"parameter 'pi' clashes with the constant: use sympy\.pi for the const"):
        lg.System(kinetic=x_0.dot**2 / 2, potential=sympy.Symbol("pi") * x_0)


def test_the_origin_is_no_position_of_ones_own(tmp_path: Path) -> None:
    with pytest.raises(StatementError, match=r"^'origin' is the point at zero already: choose another name\.$"):
        lg.System(kinetic=x_0.dot**2 / 2, potential=0, positions={"origin": (x_0, 1)})
    with pytest.raises(SceneError, match=r"'origin' is the point at zero already: choose another name\.$"):
        read_scene(write(tmp_path, positions={"origin": ["theta", "1"]}))


# --- Parameters of `lg.parameters` are those of a scene by their names, though SymPy takes them for others ---


theta = lg.coordinate("theta")
l = lg.parameters("l")


def test_a_parameter_is_known_by_its_name() -> None:
    scene = shared_scene("pendulum")
    (own,) = (p for p in scene.statement.parameters if p.name == "l")
    assert own != l
    asked: list[Callable[[Any], Any]] = [
        lambda length: scene.linearize({theta: length / 9}).K,
        lambda length: scene.run(2.0, events=[theta - length]).t_events[0].tolist(),
        lambda length: scene.transform({theta: lg.coordinate("u") / length}).lagrangian,
    ]
    for ask in asked:
        assert ask(l) == ask(own)
