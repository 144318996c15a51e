"""Events of scene files: [[events]] is read, located in refusals, run by default, and written back; tables are too."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import numpy as np
import pytest

import lagrange as lg
from lagrange.errors import SceneError
from lagrange.statement.scene.scene_reader import scene_from_text
from lagrange.statement.scene.writer import scene_text

BALL = """\
name = "ball"
coordinates = ["y"]
kinetic = "m*y_dot**2/2"
potential = "m*g*y"

[parameters]
m = 1.0
g = 9.81
e = 0.9

[initial]
y = 1.0

[run]
t_end = 2.0

[[events]]
when = "y"
direction = -1
reset = { y_dot = "-e*y_dot", e = "e/2" }

[[events]]
when = "y_dot == 0"
direction = -1
terminal = 1
"""


def test_the_events_of_a_scene_act_on_its_runs_and_on_copies_of_it() -> None:
    ball = lg.System.from_statement(scene_from_text(BALL))
    first = math.sqrt(2 / 9.81)
    for system in (ball, pickle.loads(pickle.dumps(ball))):
        run = system.run(2.0, method="dop853", target="numpy")
        assert run.status is lg.Status.EVENT
        assert run.t_events[0][0] == pytest.approx(first, rel=1e-6)
        assert run.t[-1] == pytest.approx(first + 0.9 * first, rel=1e-6), "it is at the top of the first bounce"
        assert [dict(values) for _, values in run.parameter_changes] == [{"e": 0.45}]
    assert ball.run(2.0, events=[], target="numpy").t[-1] == 2.0


def test_what_is_written_states_the_same_events() -> None:
    stated = scene_from_text(BALL)
    again = scene_from_text(scene_text(stated))
    for one, other in zip(again.run.events, stated.run.events, strict=True):
        for name in ("expression", "direction", "terminal", "reset", "settings"):
            assert getattr(one, name) == getattr(other, name), name


def test_a_derived_system_has_no_events_of_the_scene() -> None:
    ball = lg.System.from_statement(scene_from_text(BALL))
    assert ball.substitute({"m": 2}).statement.run.events == ()


@pytest.mark.parametrize(
    ("right", "wrong", "line", "words"),
    [
        ('when = "y"\n', 'wen = "y"\n', 18, "'wen' is not a key of an event"),
        ('when = "y"\n', 'when = "z"\n', 18, "events[0].when: 'z' is not declared"),
        ('"-e*y_dot"', '"-e*y_dot*"', 20, "events[0].reset.y_dot: the expression ends"),
        ("y_dot == 0", "m", 17, "event 1 is m, which is constant along a run"),
        ("terminal = 1", "terminal = -1", 22, "terminal = -1: give True"),
        ("terminal = 1", 'again = "x"', 25, "'again' is not a key of an event"),
        ('when = "y_dot == 0"\n', "", 22, "an event has no key `when`: write"),
        ('reset = { y_dot = "-e*y_dot", e = "e/2" }', "reset = 1", 17, "reset is not a table of names and new values"),
    ],
)
def test_a_wrong_event_is_refused_at_its_line(right: str, wrong: str, line: int, words: str) -> None:
    with pytest.raises(SceneError) as refusal:
        scene_from_text(BALL.replace(right, wrong))
    assert words in str(refusal.value)
    assert refusal.value.line == line, refusal.value


def test_a_table_over_an_expression_is_written_as_its_numbers(tmp_path: Path) -> None:
    x, y = lg.coordinates("x y")
    m, a = lg.parameters("m a")
    points, values = [0.1, 1.0, 2.5, 4.0], [0.0, 0.3, 0.3, -0.7]
    measured, linear = lg.table((x - y) / a, points, values), lg.table(y, [0, 1, 2, 3], [0, 1, 2, 3])
    stated = lg.System(
        m * (x.dot**2 + y.dot**2) / 2, forces={x: -measured, y: measured + linear}, parameters={m: 1, a: 1}
    )
    text = stated.to_scene(tmp_path / "table.toml").read_text("utf-8")
    assert f"points = {points}, values = {values}" in text
    assert " if " not in text, "no cubic is written out"
    assert lg.System.from_scene(tmp_path / "table.toml").statement.forces == stated.statement.forces
    start = {x: 1.0, y: 0.5}
    assert np.isfinite(pickle.loads(pickle.dumps(stated)).run(0.1, start, target="numpy").y).all()
