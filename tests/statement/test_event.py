"""Statements of events: accepted forms, and all refusals."""

import math
import pickle
from typing import Any

import numpy as np
import pytest
import sympy as sp

import lagrange as lg
from lagrange.errors import SceneError, StatementError
from lagrange.statement.coordinate import coordinate, coordinates, multiplier, parameters, t
from lagrange.statement.declare import declare
from lagrange.statement.event import Event, declare_events, event
from lagrange.statement.parameters import Survey
from lagrange.statement.scene.scene_reader import SceneReader
from tests.models import stated
from tests.refusals import refusal

x, y, z = coordinate("x"), coordinate("y"), coordinate("z")
a, b = parameters("a b")
STATEMENT = stated(kinetic=(x.dot**2 + y.dot**2) / 2, potential=a * x, parameters={a: 1.0})


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (None, []),
        (x - 1, [x - 1]),
        (event(x), [x]),
        ([x, event(y.dot), t - a], [x, y.dot, t - a]),
        (sp.Eq(x, y), [x - y]),
    ],
)
def test_one_expression_or_many(given: Any, expected: list[Any]) -> None:
    assert [result.expression for result in declare_events(given, STATEMENT)] == expected


@pytest.mark.parametrize(("direction", "expected"), [(0, 0), (2.5, 1), (-1, -1), (np.float64(-0.1), -1), (sp.pi, 1)])
def test_a_direction_is_a_sign(direction: Any, expected: int) -> None:
    assert event(x, direction=direction).direction == expected


@pytest.mark.parametrize(
    ("terminal", "expected"), [(False, 0), (True, 1), (0, 0), (3, 3), (np.int64(2), 2), (np.True_, 1)]
)
def test_terminal_is_a_number_of_occurrences(terminal: Any, expected: int) -> None:
    assert event(x, terminal=terminal).terminal == expected


def test_a_reset_is_by_symbol_or_by_name() -> None:
    result = declare_events(event(x, reset={"x_dot": -x.dot, y: 0.5, "y_dot": 1, "x": a}), STATEMENT)[0]
    assert isinstance(result, Event)
    assert result.reset == {"x_dot": -x.dot, y: sp.Float(0.5), "y_dot": sp.Float(1.0), "x": a}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"expression": "x - 1"}, "the event is 'x - 1', a text: give the symbol or the expression itself, such as"),
        ({"expression": lambda t, y: y[0]}, "A Python function hides its formula, and its roots could be missed"),
        ({"expression": x > 1}, "the event is 'x(t) > 1', a relation: give the difference of its sides, x(t) - 1, who"),
        ({"expression": 3}, "the event is 3, a number, which is constant along a run: give an expression"),
        ({"terminal": -1}, "terminal = -1: give True, or the number of the occurrence that ends the run"),
        ({"direction": "up"}, "direction is 'up' (str): give a number"),
        ({"reset": [x]}, "reset is [x(t)]: give a dict from coordinates, velocities and parameters to expressions"),
        ({"reset": {x: "-x_dot"}}, "the value of a reset is '-x_dot' (str): give an expression of the state before, s"),
        ({"reset": {x: float("inf")}}, "the value of a reset is inf: give a finite number"),
    ],
)
def test_what_cannot_be_meant_is_refused_when_it_is_written(given: dict[str, Any], words: str) -> None:
    assert words in refusal(event, **{"expression": x} | given)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (Ellipsis, "events is Ellipsis: give a list of expressions, or of lg.event(...)"),
        ([x, z - 1], "event 1 contains z(t), which this system does not have"),
        ([x - b], "event 0 contains b, which this system does not have; it may contain its coordinates, their "),
        ([a - 1], "event 0 is a - 1, which is constant along a run"),
        ([event(x, reset={z: 0})], "the reset of event 0 names 'z(t)', which is not a coordinate or velocity of this "),
        ([event(x, reset={x: z})], "the reset of event 0 contains z(t), which this system does not have"),
        ([event(x, reset={x: 0, "x": 1})], "the reset of event 0 names the same coordinate or velocity twice"),
    ],
)
def test_what_the_system_does_not_have_is_refused(given: Any, words: str) -> None:
    assert words in refusal(declare_events, given, STATEMENT)


def test_an_expression_is_surveyed_once_for_many_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    given = event(x**2 + 3 * x.dot - 17, reset={x.dot: -x.dot / 17})
    other = stated(kinetic=z.dot**2 / 2)
    (first,) = declare_events([given], STATEMENT)

    def walked(*_: object) -> None:
        raise AssertionError("the expression is walked again")

    monkeypatch.setattr(Survey, "add", walked)
    assert declare_events([given], STATEMENT) == (first,)
    # Whether a system has what it contains is asked for each system.
    with pytest.raises(StatementError, match="which this system does not have"):
        declare_events([given], other)


def test_multipliers_of_constraints_that_are_none_are_refused() -> None:
    x, y = coordinates("x y")
    held = declare(kinetic=x.dot**2 + y.dot**2, constraints={"wall": x - y, "floor": x + y})
    free = declare(kinetic=x.dot**2, name="free")
    declare_events([multiplier("wall"), x.ddot - multiplier("floor")], held)
    for given, statement, end in (
        (multiplier("wal"), held, "lambda[wal], but the constraints are wall and floor. Did you mean 'wall'?"),
        (multiplier("wall"), free, "lambda[wall], but free has no constraints."),
    ):
        assert refusal(declare_events, [given], statement) == f"event 0 contains {end}"


def test_multipliers_and_accelerations_are_no_values_of_resets() -> None:
    x, y = coordinates("x y")
    held = declare(kinetic=x.dot**2 + y.dot**2, constraints={"wall": x - y})
    with pytest.raises(StatementError, match=r"the reset of event 0 contains lambda\[wall\], the multiplier of a"):
        declare_events([event(x, reset={x.dot: multiplier("wall")})], held)
    with pytest.raises(StatementError, match="the reset of event 0 contains the derivative of order 2 of x"):
        declare_events([event(x, reset={x.dot: x.ddot})], held)


# --- Events of scene files ---


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
    ball = lg.System.from_statement(SceneReader("", BALL).statement())
    first = math.sqrt(2 / 9.81)
    for system in (ball, pickle.loads(pickle.dumps(ball))):
        run = system.run(2.0, method="dop853", target="numpy")
        assert run.status is lg.Status.EVENT
        assert run.t_events[0][0] == pytest.approx(first, rel=1e-6)
        assert run.t[-1] == pytest.approx(first + 0.9 * first, rel=1e-6), "it is at the top of the first bounce"
        assert [dict(values) for _, values in run.parameter_changes] == [{"e": 0.45}]
    assert ball.run(2.0, events=[], target="numpy").t[-1] == 2.0


@pytest.mark.parametrize(
    ("right", "wrong", "line", "words"),
    [
        ('when = "y"\n', 'wen = "y"\n', 18, "'wen' is not a key of an event"),
        ('when = "y"\n', 'when = "z"\n', 18, "events[0].when: 'z' is not declared"),
        ('"-e*y_dot"', '"-e*y_dot*"', 20, "events[0].reset.y_dot: the expression ends"),
        ("y_dot == 0", "m", 17, "event 1 is m, which is constant along a run"),
        ('when = "y_dot == 0"\n', "", 22, "an event has no key `when`: write"),
    ],
)
def test_a_wrong_event_is_refused_at_its_line(right: str, wrong: str, line: int, words: str) -> None:
    with pytest.raises(SceneError) as refusal:
        SceneReader("", BALL.replace(right, wrong)).statement()
    assert words in str(refusal.value)
    assert refusal.value.line == line, refusal.value
