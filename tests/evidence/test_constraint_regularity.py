"""Empty, dependent or contradictory constraints, and motions without inertia, are refused; messages name them."""

from typing import Any

import pytest
from sympy import cos, sin

import lagrange as lg
from lagrange.errors import RunError
from tests.models import c, g, k, l, m, theta, x, y, z
from tests.refusals import refusal

METHODS = ("taylor", "dop853", "tsit5", "radau5")
a, b, s = lg.coordinates("a b s")


def system(constraints: Any, kinetic: Any = None, **options: Any) -> lg.System:
    return lg.System(
        kinetic=m * (x.dot**2 + y.dot**2) / 2 if kinetic is None else kinetic,
        potential=m * g * y,
        constraints=constraints,
        **{"parameters": {m: 1.3, g: 9.81, l: 0.7}, **options},
    )


@pytest.mark.parametrize("always", [cos(x) ** 2 + sin(x) ** 2 - 1, sin(2 * x) - 2 * sin(x) * cos(x)])
def test_a_constraint_that_is_always_true(always: Any) -> None:
    text = refusal(system, {"line": x - y, "empty": always})
    assert text == (
        "the constraint 'empty' is always true: it is zero at every state tried, and constrains nothing. Leave it out."
    )


@pytest.mark.parametrize("never", [cos(x) ** 2 + sin(x) ** 2 + 1, sin(2 * x) - 2 * sin(x) * cos(x) + 2])
def test_a_constraint_that_is_never_true(never: Any) -> None:
    text = refusal(system, {"false": never})
    assert "the constraint 'false' is never true: no coordinate and no velocity changes its value, which is 2" in text


def test_constraints_that_are_dependent_everywhere() -> None:
    text = refusal(system, {"a": x - y, "b": z, "c": 2 * x - 2 * y}, coordinates=[x, y, z])
    assert text.startswith("the constraints 'a' and 'c' are dependent here: where 'a' holds, 'c' restricts no further.")
    assert "Drop one of them" in text and "'b'" not in text
    text = refusal(system, {"a": x - y, "b": y - z, "c": x - z}, coordinates=[x, y, z])
    assert "the constraints 'a', 'b' and 'c' are dependent here: where 'a' and 'b' hold, 'c' restricts" in text


def test_a_velocity_constraint_that_is_the_rate_of_a_position() -> None:
    assert "the constraints 'place' and 'speed' are dependent" in refusal(
        system, {"place": x - y, "speed": x.dot - y.dot}
    )


def test_constraints_that_contradict_one_another() -> None:
    text = refusal(system, {"small": x**2 + y**2 - 1, "large": x**2 + y**2 - 4})
    assert text.startswith("the constraints 'small' and 'large' are dependent and contradict one another: no state was")
    # Whether they do is known only with the values of all parameters.
    assert "are dependent here" in refusal(system, {"a": x + y - c, "b": x + y - k})


def test_constraints_that_are_dependent_where_they_hold() -> None:
    stated = system({"line": x - y, "square": x**2 - y**2})
    text = refusal(stated.run, 1.0, {x: 1.0, y: 1.0}, check=False)
    assert text.startswith("the constraints 'line' and 'square' are dependent here: where 'line' holds, 'square'")


def test_a_motion_without_inertia_that_the_constraints_allow() -> None:
    text = refusal(system, {"a": x}, m * (x.dot**2 + (y.dot + z.dot) ** 2) / 2, coordinates=[x, y, z])
    assert text.startswith("a motion with y.dot = 1, z.dot = -1 satisfies the constraints and has no inertia at every")
    text = refusal(system, {"a": y - z}, m * x.dot**2 / 2, coordinates=[x, y, z])
    assert text.startswith("a motion with y.dot = 1, z.dot = 1 satisfies the constraints and has no inertia")


def test_a_singular_mass_matrix_is_no_refusal_where_the_constraints_make_it_definite() -> None:
    held = system({"a": y - z}, m * (x.dot**2 + (y.dot + z.dot) ** 2) / 2, coordinates=[x, y, z])
    assert held.run(0.1, check=False).status is lg.Status.SUCCESS


def test_one_configuration_where_constraints_are_dependent_is_named() -> None:
    bars = system({"a": x * y, "b": z - x}, m * (x.dot**2 + y.dot**2 + z.dot**2) / 2, coordinates=[x, y, z])
    solution = bars.run(1.0, check=False)
    assert solution.status is lg.Status.SINGULAR
    assert (
        "the constraint 'a' restricts no velocity, as all its velocity derivatives vanish, at t = 0, x = 0, y = 0, "
        in (solution.message)
    )
    assert "the multipliers, and with them the accelerations, are not determined there." in solution.message
    model = bars.compile(check=False)
    with pytest.raises(RunError, match="the constraint 'a' restricts no velocity"):
        model.accelerations([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def test_a_configuration_without_inertia_is_named_with_the_motion() -> None:
    stated = system({"a": x - y * z}, m * (x.dot**2 + (y.dot + z.dot) ** 2) / 2, coordinates=[x, y, z])
    solution = stated.run(1.0, check=False)
    assert solution.status is lg.Status.SINGULAR
    assert "a motion with y.dot = 1, z.dot = -1 satisfies the constraints and has no inertia at t = 0, x = 0" in (
        solution.message
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
def test_an_arm_that_is_pulled_straight_ends_with_the_configuration(method: str) -> None:
    arm = lg.System(
        kinetic=(a.dot**2 + b.dot**2) / 2,
        coordinates=[a, b],
        constraints={"reach": cos(a) + cos(b) - 1 - lg.t},
        initial={a: 1.0, b: -1.0},
    )
    solution = arm.run(3.0, arm.consistent().initial, method=method, check=False)
    assert solution.status is lg.Status.SINGULAR and solution.t[-1] == pytest.approx(1.0, abs=1e-5)
    assert "the constraint 'reach' restricts no velocity, as all its velocity derivatives vanish, there, at a = " in (
        solution.message
    )
    assert "these derivatives are" in solution.message and "their least" not in solution.message
    assert "times their values at the start, and the accelerations grow beyond all bounds." in solution.message


def test_units_do_not_matter() -> None:
    big, small = 1e9, 1e-9
    sound = system({"a": big * (x - y)}, m * (big * x.dot**2 + small * theta.dot**2) / 2, coordinates=[x, y, theta])
    assert sound.run(0.1, sound.consistent().initial, check=False).status is lg.Status.SUCCESS
    scaled = {"a": x - y, "b": 1e-9 * (x + 2 * y), "c": 1e9 * (x - y)}
    assert "the constraints 'a' and 'c' are dependent" in refusal(
        system, scaled, coordinates=[x, y, z], kinetic=(x.dot**2 + y.dot**2 + z.dot**2) / 2
    )


@pytest.mark.parametrize("angle", [0.0, 0.5, 0.6435011087932844, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("method", METHODS)
def test_a_square_is_refused_whatever_rounding_leaves_of_it(angle: float, method: str) -> None:
    twice = system({"twice": (x**2 + y**2 - l**2) ** 2})
    start = {x: 0.7 * float(cos(angle)), y: -0.7 * float(sin(angle))}
    text = refusal(twice.run, 0.1, start, method=method, check=False)
    assert "the constraint 'twice' restricts no velocity, as all its velocity derivatives vanish, wherever it" in text
    flow = lg.flow(twice.compile(check=False), method=method)
    assert "state it without the square" in refusal(flow, [*start.values(), 0.0, 0.0], 0.0, 0.1)
