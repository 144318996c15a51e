"""Answers as people type them: printed equations read back, ambiguous texts, common slips, short verdicts."""

from __future__ import annotations

import random
from fractions import Fraction
from pathlib import Path

import mpmath
import pytest
import sympy as sp

import lagrange as lg
from lagrange.mechanics import plain_form
from lagrange.mechanics.grading import one_change, slips, term_difference
from lagrange.mechanics.grading.student_equations import read_equations
from lagrange.show.derivation_page import NO_HEADING, PAGES
from lagrange.show.notation.sections import sections
from tests.mechanics.answered_systems import answered
from tests.models import SCENE_NAMES, shared_scene, stated_in

LONG = [name for name in SCENE_NAMES if stated_in(name) >= {"rotations", "constraints"}]
SCENES = [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in SCENE_NAMES]


@pytest.mark.few
@pytest.mark.parametrize("style", ["text", "unicode", "latex"])
@pytest.mark.parametrize("name", SCENES)
def test_printed_equations_are_read_back(name: str, style: str) -> None:
    """The equations of a derivation are read as they are printed, with their broken lines."""
    system = shared_scene(name)
    derivation = system.derivation()
    section = next(part for part in sections(derivation) if part.heading == "Equations of motion")
    printed = PAGES[style](system.statement, NO_HEADING).write([section])
    text = printed.split("Equations of motion")[1].partition("\n")[2].removesuffix("\\end{document}\n")
    if system.statement.rotations:  # printed in rates, which are short for expressions in quaternions
        assert system.compare(text)
        return
    laws = [*derivation.equations, *derivation.constraints]
    dice = random.Random(name)
    for law, read in zip(laws, read_equations(text, system.statement), strict=True):
        zero = (law.lhs - law.rhs).xreplace(system.statement.plain)
        values = {
            symbol: dice.uniform(0.5, 1.5) for symbol in sorted(zero.free_symbols | read.zero.free_symbols, key=str)
        }
        expected, result = (float(sp.N(item.xreplace(values))) for item in (zero, read.zero))
        # Both are sums of the same terms, of order one to a hundred, added in another order.
        assert result == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("style", ["text", "unicode", "latex", "markdown"])
@pytest.mark.parametrize("name", ["pendulum", "cartesian-pendulum", "atwood-machine"])
def test_a_whole_derivation_is_an_answer(name: str, style: str) -> None:
    system = shared_scene(name)
    assert system.compare(system.derivation().written(style))


@pytest.mark.parametrize("style", ["text", "latex", "markdown"])
def test_a_derivation_with_a_case_distinction_is_an_answer(style: str) -> None:
    x, (m, k, l) = lg.coordinate("x"), lg.parameters("m k l")
    potential = k * sp.Piecewise(((x + l) ** 2, x < -l), (0, x < l), ((x - l) ** 2, True)) / 2
    printed = lg.System(m * x.dot**2 / 2, potential, name="gap").derivation().written(style)
    assert lg.System(m * x.dot**2 / 2, potential, name="gap").compare(printed)
    assert not lg.System(m * x.dot**2 / 2, 2 * potential, name="gap").compare(printed)


def test_below_a_heading_of_a_whole_derivation_a_wrong_term_is_named() -> None:
    system = shared_scene("pendulum")
    wrong = str(system.derivation()).replace("theta_ddot + m*g*l", "theta_ddot - m*g*l")
    assert "has the wrong sign" in system.compare(wrong).message


UNREAD = [
    ("scene:pendulum", "Equations of motion\ntheta_ddot + foo = 0", "'foo' is not a symbol"),
    ("scene:pendulum", "<!DOCTYPE html><html>theta'' = 0", "the text is an HTML page, which is not read"),
    ("scene:pendulum", "theta_dott = -g/l sin(theta)", "'theta_dott' is not a symbol"),
    ("typed:pendulum", "θ⃛ = 0\nθ̈ = -g/l sin θ", "'θ' has no derivative of this order here"),
    ("typed:pendulum", r"\ddot\theta = -g \over l \sin\theta", r"over is not known here: write \\frac\{\}\{\}"),
    *(("orbit", text, "'C' is not a symbol") for text in ("(m + M) r'' = C", "r phi = C", "m r^2 phi' = C D")),
    ("strung", "m1 x'' = m1 g - F\nm2 y'' = m2 g - T", r"'F' is not a symbol of this system.* 'T' is not a symbol"),
]


@pytest.mark.parametrize(("name", "text", "said"), UNREAD)
def test_what_stands_for_nothing_is_not_read(name: str, text: str, said: str) -> None:
    with pytest.raises(lg.StatementError, match=said):
        answered(name).compare(text)


ANSWERS = Path(__file__).with_name("answers.txt").read_text("utf-8").splitlines()[1:]
"""Answers, one a line: the system, right or wrong, a part of the message, and the text."""


@pytest.mark.few(6)
@pytest.mark.parametrize("line", ANSWERS)
def test_an_answer_is_judged_and_its_wrong_term_is_named(line: str) -> None:
    system, verdict, said, text = line.split("\t")
    result = answered(system).compare(text.replace("⏎", "\n"))
    assert bool(result) == (verdict == "right"), result.message
    assert said in result.message.replace("w*t", "t*w"), result.message


def test_a_parameter_with_the_name_of_a_force_is_no_multiplier() -> None:
    x, y, (m, g, length, drive) = lg.coordinate("x"), lg.coordinate("y"), lg.parameters("m g l T1")
    system = lg.System(
        m * (x.dot**2 + y.dot**2) / 2, m * g * y - drive * x, constraints={"rod": x**2 + y**2 - length**2}
    )
    result = system.compare("m x'' = T1 + 2 F x\nm y'' = -m g + 2 F y\nx^2 + y^2 = l^2")
    assert result and "force" not in result.message, result.message


def test_a_decimal_may_stand_for_a_root_or_a_longer_decimal() -> None:
    x, (m, k) = lg.coordinate("x"), lg.parameters("m k")
    driven = lg.System(m * x.dot**2 / 2, k * x**2 / 2, forces={x: sp.sqrt(2) * sp.cos(lg.t)})
    assert driven.compare("m x'' + k x = 1.414 cos(t)").message.endswith("1.414 stands for 1.414214.")
    assert not driven.compare("m x'' + k x = 1.42 cos(t)")
    falling = lg.System(m * x.dot**2 / 2, 9.80665 * m * x)
    assert falling.compare("x'' = -9.81").message.endswith("right to 3 digits: 9.81 stands for 9.80665.")
    assert not falling.compare("x'' = -9.8")


def test_of_two_readings_only_that_of_the_wrong_equation_is_quoted() -> None:
    actual = shared_scene("double-pendulum")
    result = actual.compare(
        "l2 theta2'' + l1 theta1'' cos(theta1 - theta2) - l1 theta1'^2 sin(theta1 - theta2) + g sin theta2 = 0\n"
        "(m1 + m2) l1 theta1'' + m2 l2 theta2'' cos(theta1 - theta2) + (m1 + m2) g sin(theta1) = 0"
    )
    assert result.wrong == (1,) and "Read as" not in result.message


def test_a_tension_with_the_sign_of_a_force_is_right_beside_a_constant_length() -> None:
    """The multiplier of r - l is the opposite of the tension."""
    r, theta = lg.coordinates("r theta")
    m, g, l = lg.parameters("m g l")
    energies = m * (r.dot**2 + r**2 * theta.dot**2) / 2, -m * g * r * sp.cos(theta)
    pendulum = lg.System(*energies, constraints={"rod": r - l}, parameters={m: 0.8, g: 9.81, l: 1.3}, initial={r: 1.3})
    assert pendulum.compare("m r'' = m r θ'^2 + m g cos θ - T\nm r^2 θ'' + 2 m r r' θ' = -m g r sin θ\nr = l")
    assert not pendulum.compare("m r'' = m r θ'^2 + 2 m g cos θ - T\nm r^2 θ'' + 2 m r r' θ' = -m g r sin θ\nr = l")


def test_solved_terms_are_not_expanded_to_find_them_among_those_of_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their denominators are sums that no right term has; expanding them takes seconds."""
    expanded: list[sp.Expr] = []

    def recorded(expression: sp.Expr) -> tuple[sp.Expr, ...]:
        expanded.append(expression)
        return (expression,)

    monkeypatch.setattr(one_change, "expanded", recorded)
    assert not answered("pulley").compare("x'' = (m1 - 2 m2) g/(m1 + m2 + I/R^2)")
    assert expanded and not any(power.base.is_Add for x in expanded for power in x.atoms(sp.Pow))


def test_nested_functions_are_not_differentiated_to_find_small_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second derivatives of 24 squares of sines in one another take SymPy seconds."""
    statement = answered("oscillator").statement
    (equation,) = read_equations("m x'' = " + "sin^2 " * 24 + "x", statement)
    monkeypatch.setattr(sp, "diff", lambda *_: pytest.fail("a derivative was taken"))
    assert slips._small_angles([equation.zero], statement) == ""


def test_a_sum_with_an_exponent_of_many_digits_is_not_factored(monkeypatch: pytest.MonkeyPatch) -> None:
    """The factors of x**(3001/1000) + x are those of a polynomial of degree 3001, which takes SymPy minutes."""
    x, k, m = sp.symbols("x k m")
    monkeypatch.setattr(sp, "factor", lambda *_: pytest.fail("a sum was factored"))
    typed = (k * x + m * x**3.001) / (k * x + m * x**3)
    assert plain_form.simplest(typed).has(x)


def test_a_spent_budget_leaves_the_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(term_difference, "SECONDS", 0.0)
    assert answered("oscillator").compare("m x'' + c x' + k x = m g + F cos(w t)")
    result = answered("oscillator").compare("m x'' + c x' - k x = m g + F cos(w t)")
    assert not result and result.message == f"Equation 1 does not hold. {term_difference.UNNAMED}" and result.details


def test_equations_in_rates_are_as_long_as_in_quaternions(monkeypatch: pytest.MonkeyPatch) -> None:
    """An equation of few rates may have hundreds of terms in quaternions, and trying a slip takes a second."""
    monkeypatch.setattr(slips, "LONGEST_SLIP", 40)
    monkeypatch.setattr(slips, "_slips", lambda *_, **__: pytest.fail("slips are tried"))
    assert not shared_scene("free-top").compare("J1*R_body_x_dot = -2*(J2 - J3)*R_body_y*R_body_z")


def test_a_spent_budget_ends_every_expansion(monkeypatch: pytest.MonkeyPatch) -> None:
    with term_difference.limited(0.0), pytest.raises(term_difference.BudgetSpent):
        term_difference.expanded(sp.Symbol("x"))


def test_a_fraction_of_a_number_with_a_large_exponent_is_not_built() -> None:
    assert term_difference.constant_of([mpmath.mpf(10) ** -(10**8)]) is None
    assert term_difference.constant_of([mpmath.mpf(2) / 3]) == Fraction(2, 3)


def test_a_high_power_of_a_sum_is_not_expanded() -> None:
    """The thousand terms of (x + g)**999, each evaluated alone, take two seconds."""
    power = (sp.Symbol("x") + sp.Symbol("g")) ** 999
    assert term_difference.expanded(power) == (power,)


@pytest.mark.parametrize(
    ("answer", "verdict"),
    [
        ("m x'' = Piecewise((-k x, 0 < x < d), (0, True))", "right"),
        ("m x'' = Piecewise((0, x < 0 or x > d), (-k x, True))", "right"),
        (r"m \ddot x = \begin{cases} 0 & x < 0 \\ -k x & 0 \le x \le d \\ 0 & x > d \end{cases}", "right"),
        ("m x'' = Piecewise((k x, x > 0 and x < d), (0, True))", "has the wrong sign: it should be -Piecewise((k*x"),
        ("m x'' = Piecewise((-3 k x, x > 0 and x < d), (0, True))", "has the wrong factor: it is 3 times what it"),
        ("m x'' = Piecewise((-k x, x > 0), (0, True))", "Piecewise((-k*x, x > 0), (0, True)) is wrong: it should be"),
        ("m x'' = -k x", "the term -k*x is wrong: it should be Piecewise((-k*x, (d > x) and (x > 0)), (0, True))"),
        ("m x'' = 0", "the term -Piecewise((-k*x, (d > x) and (x > 0)), (0, True)) is missing"),
        ("m x'' = -k sqrt(-1 - x^2)", "the term -k*sqrt(-x**2 - 1) has no value at some states: square root of a neg"),
    ],
)
def test_a_force_of_one_range_is_graded(answer: str, verdict: str) -> None:
    """The force is zero at some of the tried states; the wrong term is named all the same."""
    x, (m, k, d) = lg.coordinate("x"), lg.parameters("m k d")
    force = sp.Piecewise((-k * x, (x > 0) & (x < d)), (0, True))
    result = lg.System(m * x.dot**2 / 2, 0, forces={x: force}).compare(answer)
    assert bool(result) == (verdict == "right") and verdict in result.message


def test_a_term_is_not_corrected_to_an_identity() -> None:
    """Without its acceleration the equation has no right term but the others, in any form."""
    answer = (
        "m R^2 Omega^2 sin(theta) cos(theta) - m g R sin(theta) cos(tilt) + m g R sin(tilt) cos(theta) cos(Omega t) = 0"
    )
    message = shared_scene("bead-on-hoop").compare(answer).message
    assert message.endswith("contains no acceleration such as theta'' or theta_ddot: it is not an equation of motion.")
