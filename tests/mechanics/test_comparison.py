"""Students' equations: equivalent equations are right, and in others the wrong term is named."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
import sympy as sp

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.mechanics.grading.student_equations import spelled
from lagrange.mechanics.grading.term_difference import expanded
from tests.models import shared_scene
from tests.refusals import nested, refusal

RIGHT = re.compile(r"The equations are right: they are equivalent to those of the system, at the \d+ states tried\.")
SCENES = ("pendulum", "double-pendulum", "elastic-pendulum", "bead-on-hoop", "swinging-atwood-machine", "henon-heiles")


@cache
def rows(name: str) -> tuple[Any, ...]:
    """Return the left-hand sides of the equations of a scene (right-hand sides are zero), in plain symbols."""
    result = shared_scene(name)
    return tuple((law.lhs - law.rhs).xreplace(result.statement.plain) for law in result.equations())


@cache
def solved(name: str) -> tuple[Any, ...]:
    plain = shared_scene(name).statement.plain
    pairs = shared_scene(name).accelerations().items()
    return tuple(plain[q.diff(lg.t, 2)] - a.xreplace(plain) for q, a in pairs)


def texts(zeros: Any) -> list[str]:
    return [f"{spelled(zero)} = 0" for zero in zeros]


def sides(zero: Any) -> str:
    """Return an equation with its negative terms on the right-hand side."""
    terms = sp.Add.make_args(sp.expand(zero))
    left = [item for item in terms if not item.could_extract_minus_sign()]
    right = [-item for item in terms if item.could_extract_minus_sign()]
    return f"{spelled(sp.Add(*left))} == {spelled(sp.Add(*right))}"


def first_parameter(name: str) -> Any:
    return shared_scene(name).statement.parameters[0] if shared_scene(name).statement.parameters else sp.Integer(3)


def mixed(name: str) -> list[Any]:
    """Return linear combinations of the equations, with coefficients that depend on the state."""
    result, (x, *_) = rows(name), shared_scene(name).statement.plain.values()
    return [zero + (2 + sp.cos(x)) * result[0] for zero in result]


REWRITINGS: dict[str, Callable[[str], Any]] = {
    "reversed and on two sides": lambda name: [sides(zero) for zero in reversed(rows(name))],
    "scaled": lambda name: texts(-3 * zero / first_parameter(name) for zero in rows(name)),
    "solved": lambda name: texts(solved(name)),
    "mixed": lambda name: texts(mixed(name)),
    "sines of sums written out": lambda name: texts(sp.expand_trig(sp.expand(zero)) for zero in rows(name)),
}


@pytest.mark.parametrize("how", REWRITINGS)
@pytest.mark.parametrize("name", SCENES)
def test_equivalent_equations_are_right(name: str, how: str) -> None:
    result = shared_scene(name).compare(REWRITINGS[how](name))
    assert result and RIGHT.fullmatch(result.message)
    assert not result.wrong and not result.counterexample


def test_equations_with_switches_of_the_system_are_right() -> None:
    theta, k = lg.coordinate("theta"), lg.parameters("k")
    stop = lg.System(theta.dot**2 / 2, k * sp.Max(0, theta - 40) ** 2 / 2, parameters={k: 1})
    result = stop.compare("theta_ddot = -k*max(0, theta - 40)")
    assert result and int(re.findall(r"(\d+) states", result.message)[0]) > 5
    assert not stop.compare("theta_ddot = 0")


def test_the_counterexample_is_one() -> None:
    """The pendulum's equation with a wrong sign has the residual 2 g sin(theta)."""
    result = shared_scene("pendulum").compare("l*theta_ddot = g*sin(theta)")
    example = dict(result.counterexample)
    motion = -example["g"] / example["l"] * math.sin(example["theta"])
    assert example["theta_ddot"] == pytest.approx(motion, rel=1e-12)
    left = example["l"] * motion - example["g"] * math.sin(example["theta"])
    assert result.details.startswith("At theta = ") and result.details.endswith(f"differ by {left:.5g}.")
    assert "differ by" not in result.message


def test_all_wrong_equations_are_told() -> None:
    first, second = rows("double-pendulum")
    result = shared_scene("double-pendulum").compare([first + 1, second - 1])
    assert result.wrong == (0, 1) and result.message.endswith(" Equation 2 is wrong, too.")


def test_equations_must_determine_the_accelerations() -> None:
    one, _ = rows("double-pendulum")
    whole = shared_scene("double-pendulum")
    assert str(whole.compare([one])) == (
        "The equation holds, but 1 equation is given and 2 are needed: the accelerations of theta1 and theta2 are "
        "left open."
    )
    assert str(whole.compare([one, 2 * one])).startswith("The equations hold, but not all are independent: ")


def test_a_sum_of_equations_with_a_wrong_term() -> None:
    first, second = rows("double-pendulum")
    theta2 = sp.Symbol("theta2", real=True)
    g, l2, m2 = (
        p for n in ("g", "l2", "m2") for p in shared_scene("double-pendulum").statement.parameters if p.name == n
    )
    result = shared_scene("double-pendulum").compare([first + second - 2 * g * l2 * m2 * sp.sin(theta2), second])
    assert result.message.startswith(
        "In equation 1, for theta1 and theta2 together, the term -m2*g*l2*sin(theta2) has the wrong sign: it "
        "should be m2*g*l2*sin(theta2)."
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("sign", [1, -1])
def test_equations_with_multipliers(sign: int) -> None:
    """Multipliers may have either sign, or be eliminated."""
    actual = shared_scene("cartesian-pendulum")
    plain = actual.statement.plain
    zeros = [(law.lhs - law.rhs).xreplace(plain) for law in actual.equations()]
    multipliers = {item.multiplier: sign * item.multiplier for item in actual.statement.constraints}
    result = actual.compare([zero.xreplace(multipliers) for zero in zeros])
    assert result and result.message.endswith("opposite sign." if sign < 0 else "states tried.")
    assert actual.compare("x*y_ddot - y*x_ddot + g*x = 0")
    wrong = actual.compare("x*y_ddot - y*x_ddot - g*x = 0")
    assert not wrong and wrong.wrong == (0,)


def test_sympy_and_text_are_read_alike() -> None:
    theta, (m, g, l) = lg.coordinate("theta"), sp.symbols("m g l")
    pendulum = shared_scene("pendulum")
    assert pendulum.compare(sp.Eq(m * l * theta.ddot, -m * g * sp.sin(theta)))
    assert pendulum.compare([l * sp.Symbol("theta_ddot") + g * sp.sin(sp.Symbol("theta"))])
    assert pendulum.compare({theta: "l*theta_ddot == -g*sin(theta)"})
    wrong = pendulum.compare({"theta": "l*theta_ddot + g*cos(theta)"}).message
    assert wrong.endswith("In the theta equation the term g*cos(theta) is wrong: it should be g*sin(theta).")
    assert pendulum.compare("# by hand\n\nl*theta_ddot = -g*sin(theta)  # the only one\n")


@pytest.mark.parametrize("number", [5e-324, 1.7976931348623157e308, sp.Float("1e-400"), "theta_ddot + 1e-320"])
def test_numbers_that_doubles_do_not_resolve_are_no_rounded_numbers(number: Any) -> None:
    assert not shared_scene("pendulum").compare(number)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([], "no equation is given: give a list with one for each coordinate."),
        (["heaviside(theta_ddot) = 1"], "equation 1 is not linear in theta_ddot: equations of motion are compared"),
        (["k*theta_ddot"], "equation 1, column 1: 'k' is not a symbol of this system. The symbols are theta, m, g"),
        (["g = g = g"], "equation 1, column 7: there are 2 signs of equality: write one equation with two sides."),
        ("d/dt(heaviside(theta)) = g", "equation 1 has the derivative of a jump, such as heaviside"),
        ([lg.multiplier("rod")], "equation 1 contains the multiplier of 'rod', which is not a constraint here; the"),
        ([lg.coordinate("theta") ** (10**30)], "equation 1 contains the exponent 10000000000000000000"),
        ([lg.coordinate("theta") ** sp.Rational(10**9, 3)], "equation 1 contains the exponent 1000000000/3, which is"),
        ([nested(lg.coordinate("theta"), 350)], "equation 1 is nested too deeply to be compared: multiply it out"),
        (["x" * 30_000], "equation 1 has 30000 characters, more than the 8000 of an equation: shorten it."),
    ],
)
def test_refusals(given: Any, message: str) -> None:
    assert refusal(shared_scene("pendulum").compare, given).startswith(message)


def test_a_name_in_letters_of_other_alphabets_is_named_whole() -> None:
    for word in ("φ_ddot", "thêta", "θ\u0301_ddot", "φ1"):
        with pytest.raises(StatementError, match=rf"^equation 1, column 3: '{word}' is not a symbol of this system"):
            shared_scene("pendulum").compare([f"2*{word} + g = 0"])


def test_a_filter_of_first_order() -> None:
    e = lg.coordinate("e")
    delay = lg.System(0, 0, coordinates=[e], forces={e: 1 - e}, dissipation=e.dot**2 / 2)
    assert delay.compare("e' = 1 - e") and delay.compare("e'' = -e'")
    assert "the term e has the wrong sign" in delay.compare("e' = 1 + e").message


def test_the_sine_of_a_large_multiple_is_one_term() -> None:
    """sin(1000 theta) is not expanded, since a polynomial of this degree takes twenty seconds."""
    x = sp.Symbol("x")
    assert expanded(sp.sin(1000 * x)) == (sp.sin(1000 * x),)
    assert set(expanded(sp.sin(2 * x))) == {2 * sp.sin(x) * sp.cos(x)}
