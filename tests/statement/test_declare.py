"""The checks that turn a user's arguments into a statement, and statements of events."""

import dataclasses
import math
import pickle
from typing import Any

import numpy as np
import pytest
import sympy
import sympy as sp
from sympy import cos
from sympy.physics.mechanics import dynamicsymbols

import lagrange as lg
from lagrange.errors import SceneError, StatementError
from lagrange.statement.coordinate import (
    DeclaredOrder,
    acceleration_of,
    coordinate,
    coordinates,
    is_ours,
    multiplier,
    name_of,
    parameters,
    t,
    velocity_of,
)
from lagrange.statement.declare import declare, initial_state
from lagrange.statement.event import Event, declare_events, event
from lagrange.statement.parameters import Survey, parameter_values
from lagrange.statement.run_settings import RunSettings
from lagrange.statement.scene.scene_reader import SceneReader
from lagrange.statement.statement import Statement
from lagrange.system import System
from tests.models import stated
from tests.refusals import refusal

theta, x, y = coordinates("theta x y")
m, g, l = parameters("m g l")
T = m * l**2 * theta.dot**2 / 2
V = -m * g * l * cos(theta)


def pendulum(**changes: Any) -> Statement:
    return declare(**{"kinetic": T, "potential": V, **changes})


def test_coordinates_are_inferred_in_order_kinetic_energy_first() -> None:
    assert declare(kinetic=y.dot**2, potential=x * y * 0).names == ("y",)
    assert declare(kinetic=y.dot**2 + y.dot * x.dot, potential=theta**0).names in (("x", "y"), ("y", "x"))
    assert declare(kinetic=x.dot**2 + theta.dot**2, coordinates=[theta, x]).names == ("theta", "x")


def test_dynamicsymbols_are_accepted_everywhere() -> None:
    q = dynamicsymbols("q")
    result = declare(
        kinetic=q.diff(t) ** 2, potential=q**2, coordinates=[q], forces={q: 1}, initial={q: 1, q.diff(): 2}
    )
    assert result.coordinates == (coordinate("q"),)
    assert result.initial == (1.0, 2.0)


def test_symbols_of_one_name_are_one_parameter() -> None:
    free = sympy.Symbol("m")
    result = pendulum(potential=-free * g * l * cos(theta), parameters={sympy.Symbol("m", real=True): 2})
    assert [symbol.name for symbol in result.parameters].count("m") == 1
    assert {symbol.name for symbol in result.lagrangian.free_symbols} == {"m", "g", "l", "t"}
    assert len(result.lagrangian.free_symbols) == 4
    assert next(iter(result.defaults.values())) == 2.0


REFUSALS: list[tuple[dict[str, Any], str]] = [
    # constraints
    ({"constraints": x - y}, "give a list such as [x**2 + y**2 - l**2], or a dict such as {'rod': "),
    ({"constraints": ["x - y"]}, "constraint 'constraint_1' is the text 'x - y': give a SymPy expression that is zero"),
    ({"constraints": {"rod": lambda x, y: 0}}, "(function): give one SymPy expression."),
    ({"constraints": [x > 0]}, "an inequality. Constraints are equations: state the equation that holds, and end the"),
    ({"constraints": [x == y]}, "constraint 'constraint_1' is never true: no motion satisfies it. Where == was meant"),
    ({"constraints": [x - x]}, "constraint 'constraint_1' is 0 = 0, which always holds: leave it out."),
    ({"constraints": {"c": m - 1}}, "constraint 'c' contains no coordinate and no velocity (m - 1 = 0)"),
    ({"constraints": [x.dot.diff(t)]}, "the derivative of order 2 of x. Only coordinates and velocities are allowed"),
    ({"constraints": [theta, theta - 1]}, "there are 2 constraints (constraint_1 and constraint_2) for 1 coordinate ("),
    ({"kinetic": x.dot**2 * multiplier("rod")}, "contains lambda[rod], the multiplier of a constraint"),
    # energies
    ({"kinetic": None}, "no kinetic energy: give kinetic= and potential=, or lagrangian=."),
    ({"lagrangian": T}, "give either lagrangian=, or kinetic= and potential=, not both."),
    ({"kinetic": "m*v**2"}, "the kinetic energy is the text 'm*v**2': give a SymPy expression; texts belong in a scen"),
    ({"kinetic": m}, "the kinetic energy does not contain theta.dot, so theta has no inertia and its acceleration is"),
    ({"kinetic": None, "potential": None, "lagrangian": cos(theta)}, "the Lagrangian does not contain theta.dot, so"),
    ({"potential": 0**theta}, "the potential energy contains 0**theta(t): a power of zero jumps where its exponent"),
    # coordinates
    ({"coordinates": theta}, "coordinates is theta(t): give a list, such as [theta(t)]."),
    ({"coordinates": [theta, m]}, "coordinates contains m, which is not a coordinate: make one with lg.coordinate('x'"),
    ({"coordinates": [theta, x]}, "the kinetic energy does not contain x.dot, so x has no inertia"),
    ({"coordinates": [theta, x]}, "add its kinetic energy, or make x a parameter or a given function of time"),
    ({"potential": V + x, "coordinates": [theta]}, "x is a function of time that is not among the declared"),
    ({"potential": V * coordinate("thet"), "coordinates": [theta]}, "Did you mean 'theta'?"),
    # forces
    ({"forces": {x: 1}}, "does not contain x.dot, so x has no inertia"),
    ({"forces": {x: 1}, "coordinates": [theta]}, "forces names 'x', which is not a coordinate of this system; they ar"),
    ({"kinetic": 0, "potential": 0, "forces": {x: 1 - x}}, "give its rate as the force on it and x.dot**2/2 as diss"),
    ({"forces": {theta: x}}, "Is x a coordinate or a given motion?"),
    ({"forces": {theta: theta.ddot}}, "the force on theta contains the derivative of order 2 of theta"),
    # parameters
    ({"parameters": {m: 1, "m": 2}}, "parameters has m twice, by its symbol and by its name: give it once."),
    ({"parameters": {"theta": 1}}, "theta is both a coordinate and a parameter: rename one."),
    ({"potential": sympy.Symbol("theta")}, "use lg.coordinate('theta') there."),
    ({"parameters": {"theta_dot": 1}}, "parameter theta_dot has the name of a velocity: write theta.dot for the veloc"),
    ({"potential": sympy.Symbol("t", real=True)}, "parameter 't' clashes with time: use lg.t for time, and another na"),
    ({"potential": sympy.Symbol("a b")}, "'a b' cannot name a parameter"),
    # initial state
    ({"initial": np.ones(2)}, "initial is an array: give a dict such as {theta: 1.0}; what is not named keeps its"),
    ({"initial": {"phi": 1}}, "initial names 'phi', which is not a coordinate or velocity of this system; they are th"),
    ({"initial": {theta: "30deg"}}, "theta is '30deg', a text: give a number, in radians, as math.radians(30)."),
    ({"initial": {theta.dot: m}}, "the initial value of theta_dot is m, an expression with symbols in it"),
    # what has no effect, or is not a velocity
    ({"dissipation": m * theta**2}, "the dissipation is m*theta(t)**2, without a velocity, and its force"),
    ({"kinetic": m * sympy.Symbol("thetadot") ** 2, "potential": theta}, "the kinetic energy contains the plain"),
    (
        {"kinetic": m * sympy.Symbol("thetadot") ** 2, "potential": 0, "coordinates": None, "initial": {}},
        "thetadot is a plain symbol, not a velocity: make theta = lg.coordinate('theta'), and write theta.dot for it.",
    ),
    # positions and links
    ({"links": ["origin"]}, "links contains 'origin': give pairs of point names, such as ('origin', 'bob')"),
    ({"positions": {"bob": (0, 0)}, "links": [("origin", "bob", "sprnig")]}, "Did you mean 'spring'?"),
]


@pytest.mark.parametrize(("changes", "message"), REFUSALS, ids=lambda case: str(case)[:40])
def test_refusals(changes: dict[str, Any], message: str) -> None:
    assert message in refusal(pendulum, **changes)
    assert issubclass(StatementError, ValueError)


# --- initial state and parameter values, which runs use too ------------------------------------------------------


def test_the_initial_state_is_overlaid() -> None:
    base = (1.0, 2.0, 3.0, 4.0)
    assert initial_state({}, (x, y), base) == base
    given = {y: 5, "x_dot": np.float64(6), y.dot: sympy.pi}
    assert initial_state(given, (x, y), base) == (1.0, 5.0, 6.0, float(sympy.pi))


def test_parameter_values_are_overlaid() -> None:
    assert parameter_values(None, (m, g), {m: 1.0, g: 2.0}) == {m: 1.0, g: 2.0}
    assert parameter_values({"g": 3, sympy.Symbol("m"): 4}, (m, g), {m: 1.0}) == {m: 4.0, g: 3.0}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mm": 1}, "'mm' is not a parameter of this system; its parameters are m, g and l. Did you mean 'm'?"),
        ({theta: 1}, "'theta' is not a parameter of this system"),
        ({m: 1, g: 1}, "no value for parameter l: give one, for example parameters={'l': 1.0}."),
        ({}, "no value for parameters m, g and l: give one, for example parameters={'m': 1.0}."),
    ],
)
def test_parameter_values_that_are_refused(given: Any, message: str) -> None:
    assert message in refusal(parameter_values, given, (m, g, l), {})


# --- What an expression is made of, and what may not stand in it ---


k = parameters("k")


def survey(*expressions: Any, **options: Any) -> Survey:
    result = Survey()
    for expression in expressions:
        result.add(expression, "the energy", **options)
    return result


def test_leaves_in_order_of_first_appearance() -> None:
    result = survey(m * y.dot**2, k * x**2 + sympy.sin(t * x.dot))
    assert list(result.coordinates) == [y, x]
    assert set(result.velocities) == {y.dot, x.dot}
    assert list(result.parameters) == [m, k]


def test_accelerations_only_where_they_are_asked_for() -> None:
    assert list(survey(x.ddot, accelerations=True).velocities) == [x.dot]
    assert "derivative of order 2 of x" in refusal(survey, x.ddot)
    assert "derivative of order 3 of x" in refusal(survey, x.diff(t, 3), accelerations=True)


def test_long_and_shared_expressions_are_walked_once() -> None:
    shared: Any = x
    for _ in range(300):
        shared = sympy.Mul(sympy.Add(shared, shared, evaluate=False), 2, evaluate=False)  # 2**300 parts as a tree
    assert list(survey(shared).coordinates) == [x]


def test_deep_expressions_are_walked_without_recursion() -> None:
    deep: Any = x
    for i in range(2000):
        deep = sympy.Add(sympy.Mul(deep, i + 2, evaluate=False), 1, evaluate=False)
    assert list(survey(deep).coordinates) == [x]


UNKNOWN = [
    (sympy.Function("é")(x), "'é' cannot name a function"),
    (sympy.Derivative(x * y, t), "a derivative that is not evaluated. Call .doit() on it, or write it out."),
    (x.ddot, "the energy contains the derivative of order 2 of x. Only coordinates and velocities are allowed"),
    (sympy.I * x, "the energy contains the imaginary unit I. Energies and forces are real: write real expressions."),
    (sympy.Pow(0, -1, evaluate=False), "the energy contains 1/0: check for a division by zero."),
    (sympy.Add(x, -sympy.oo, evaluate=False), "the energy contains -oo, which is not a finite number"),
    (sympy.gamma(x), "the energy contains gamma in 'gamma(x(t))', which is not supported. The functions are sin, cos,"),
]


@pytest.mark.parametrize(("expression", "message"), UNKNOWN, ids=lambda case: str(case)[:24])
def test_what_may_not_stand_in_an_expression_is_refused(expression: Any, message: str) -> None:
    assert message in refusal(survey, expression)


# --- The record that every later stage reads ---


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
    assert said[-1] == "The parameter k appears in no energy, force, constraint or position."


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


# --- coordinates ----------------------------------------------------------------------------------------------
# Coordinates, velocities, parameters and time.


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
    assert "works on numbers, and x is a coordinate: write sympy.cos(x)" in refusal(np.cos, coordinate("x"))
    assert "write sympy.atan(x), with from sympy import atan" in refusal(np.arctan, coordinate("x"))


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


@pytest.mark.parametrize("names", ["", " ", ",", None, 3, ["x"]])
def test_no_names(names: Any) -> None:
    assert "names no coordinate: give a text such as 'x y'" in refusal(coordinates, names)
    assert "names no parameter: give a text such as 'x y'" in refusal(parameters, names)


@pytest.mark.parametrize(("make", "what"), [(coordinates, "coordinate"), (parameters, "parameter")])
def test_a_name_is_declared_once_in_a_call(make: Any, what: str) -> None:
    assert f"'m, k m' names the {what} 'm' twice: give each name once" in refusal(make, "m, k m")


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


# --- statements of events: accepted forms, and all refusals ----------------------------------------------------


z = coordinate("z")
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


def test_a_direction_is_a_sign_and_terminal_a_number_of_occurrences() -> None:
    directions: list[Any] = [0, 2.5, -1, np.float64(-0.1), sp.pi]
    assert [event(x, direction=direction).direction for direction in directions] == [0, 1, -1, -1, 1]
    terminals: list[Any] = [False, True, 0, 3, np.int64(2), np.True_]
    assert [event(x, terminal=terminal).terminal for terminal in terminals] == [0, 1, 0, 3, 2, 1]


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
    assert "which this system does not have" in refusal(declare_events, [given], other)


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
    for value, what in (
        (multiplier("wall"), "lambda[wall], the multiplier of a"),
        (x.ddot, "the derivative of order 2"),
    ):
        message = refusal(declare_events, [event(x, reset={x.dot: value})], held)
        assert message.startswith(f"the reset of event 0 contains {what}")


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
