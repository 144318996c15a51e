"""Answers as people type them: what the package prints is read back, ambiguous texts, common slips, short verdicts."""

from __future__ import annotations

import random
from collections.abc import Callable
from fractions import Fraction

import mpmath
import pytest
import sympy as sp

import lagrange as lg
from lagrange.mechanics import plain_form
from lagrange.mechanics.grading import budget, one_change, term_difference, wrong_term
from lagrange.mechanics.grading.student_equations import read_equations
from lagrange.show.derivation_page import NO_HEADING, PAGES, render
from lagrange.show.notation.sections import sections
from tests.mechanics.answered_systems import (
    cart,
    chain,
    coupled,
    disc,
    driven,
    morse,
    orbit,
    oscillator,
    pulley,
    rod,
    rolling,
    spun,
    strung,
    table,
    top,
    wedge,
    yoyo,
)
from tests.models import shared_scene, stated_in

LONG = [name for name in lg.scenes() if stated_in(name) >= {"rotations", "constraints"}]
SCENES = [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in lg.scenes()]


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
        expected, found = (float(sp.N(one.xreplace(values))) for one in (zero, read.zero))
        # Both are sums of the same terms, of order one to a hundred, added in another order.
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("style", ["text", "unicode", "latex", "markdown"])
@pytest.mark.parametrize("name", ["pendulum", "cartesian-pendulum", "atwood-machine"])
def test_a_whole_derivation_is_an_answer(name: str, style: str) -> None:
    system = shared_scene(name)
    assert system.compare(render(system.derivation(), style))


def test_below_a_heading_of_a_whole_derivation_a_wrong_term_is_named() -> None:
    system = shared_scene("pendulum")
    wrong = str(system.derivation()).replace("theta_ddot + m*g*l", "theta_ddot - m*g*l")
    assert "has the wrong sign" in system.compare(wrong).message
    with pytest.raises(lg.StatementError, match="'foo' is not a symbol"):
        system.compare("Equations of motion\ntheta_ddot + foo = 0")


def test_formulas_in_prose_are_an_answer() -> None:
    prose = (
        r"The function is $L = T - V$; with $\omega^2 = g/l$ we have \[ \ddot\theta = %s\omega^2\sin\theta \] q.e.d."
    )
    assert shared_scene("pendulum").compare(prose % "-")
    assert not shared_scene("pendulum").compare(prose % "+")


@pytest.mark.parametrize(
    "remark",
    [
        ", so the equilibrium is at cos theta = g/(2 l)",
        "\nAt equilibrium theta'' = 0.",
        "\nSo the bottom is stable for g > 0.",
        "\nIt is stable if $0 \\leq g/l$.",
    ],
)
def test_remarks_on_equilibria_and_inequalities_are_not_judged(remark: str) -> None:
    assert shared_scene("pendulum").compare("theta'' = -(g/l) sin(theta)" + remark)
    wrong = shared_scene("pendulum").compare("theta'' = (g/l) sin(theta)" + remark)
    assert (not wrong and "sign" in wrong.message) or "place of g" in wrong.message


SLIPS = {
    "theta'' - g/l sin theta": "All is right with -g in place of g",
    "theta'' + (g/l) cos theta = 0": "All is right with sine and cosine exchanged.",
    "theta'' + (g/l) theta = 0": "These are the equations for small motions",
    "l theta'' = -g sin(pi theta/180)": "All is right with angles in radians",
    "2 l theta'' + g sin(2 theta)": "All is right for 1/2*theta in place of theta.",
    "theta'' = -(g/l) sin(theta - pi)": "All is right with -g in place of g",
}


@pytest.mark.parametrize("text", SLIPS)
def test_a_common_slip_is_named(text: str) -> None:
    result = shared_scene("pendulum").compare(text)
    assert not result and SLIPS[text] in result.message


@pytest.mark.parametrize(
    "text",
    ["l theta'' + 2 g sin theta", "theta'' - (g/l) theta'^2 + (g/l) sin theta", "m l theta'' + m g cos(2 theta)"],
)
def test_one_wrong_factor_is_told_as_a_term_alone(text: str) -> None:
    assert "All is right" not in shared_scene("pendulum").compare(text).message


def test_a_stiffness_has_no_direction() -> None:
    result = shared_scene("mass-on-spring").compare("m x'' + c x' - k (x - rest) = 0")
    assert result.message.endswith("the term -k*(x - rest) has the wrong sign: it should be k*(x - rest).")


def test_a_friction_coefficient_has_no_direction() -> None:
    """Nor has g where it is a factor of friction; a force and a magnetic field have one."""
    assert "All is right" not in table().compare("m x'' = mu m g sign(x')\ny'' = 0\ny = 0").message
    assert "All is right with -F in place of F" in oscillator().compare("m x'' + c x' + k x = m g - F cos(w t)").message
    x, y = lg.coordinates("x y")
    m, q, B = lg.parameters("m q B")
    charge = lg.System(m * (x.dot**2 + y.dot**2) / 2, 0, forces={x: q * B * y.dot, y: -q * B * x.dot})
    assert "All is right with -" in charge.compare("m x'' = -q B y'\nm y'' = q B x'").message


NAMED = {
    "x'' = (m1 - m2) g/(m1 + m2 + 2 I/R^2)": "the denominator 2*I/R**2 + m1 + m2 is wrong: it should be I/R**2",
    "R^2 (m1 + m2) x'' + I x'' = R^2 (m1 + m2) g": "on the right side the term m2*g*R**2 has the wrong sign",
    "0 = m2 g - m1 g + (m1 + m2) x'' + I x''/(2R^2)": "the term I*x_ddot/(2*R**2) has the wrong factor: it is",
    "x'' = (m1 - m2) g/(m1 + m2)": "the denominator m1 + m2 is wrong: it should be I/R**2 + m1 + m2.",
    "x'' = (m1 - 2 m2) g/(m1 + m2 + I/R^2)": "on the right side the term",
    "(m1 + m2 + I/R^2) x'' - m1 g = m2 g": "on the right side the term m2*g has the wrong sign: it should be",
    "x'' = -(m1 - m2) g/(m1 + m2 + I/R^2)": "has the wrong sign: it is ",
    "(m1 + m2) x'' = (m1 - m2) g": "the term I*x_ddot/R**2 is missing.",
    "(m1 + m2 + I/R^2) x'' = (m2 - m1) g": "has the wrong sign: it should be (m1 - m2)*g.",
    "(m1 + m2 + I/R^2) x'' = -(m1 - m2) g": "has the wrong sign: it should be (m1 - m2)*g.",
    "x'' = (m2 - m1) g R^2/((m1 + m2) R^2 + I)": "the right side has the wrong sign",
}
"""Wrong equations of two masses on a pulley with inertia, and what is said of each: form and signs as typed."""


@pytest.mark.few(4)
@pytest.mark.parametrize("text", NAMED)
def test_the_wrong_term_is_named_as_it_was_typed(text: str) -> None:
    x, (m1, m2, inertia, R, g) = lg.coordinate("x"), lg.parameters("m1 m2 I R g")
    pulley = lg.System((m1 + m2 + inertia / R**2) * x.dot**2 / 2, -(m1 - m2) * g * x)
    message = pulley.compare(text).message
    assert NAMED[text] in message, message


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3/2 m (R - r)^2 theta'' + m g R sin theta = 0", "the term -m*g*r*sin(theta) is missing."),
        (
            "1/2 m (R - r)^2 theta'' + m g (R - r) sin theta = 0",
            "the term m*(R - r)**2*theta_ddot/2 has the wrong factor",
        ),
        ("3/2 R theta'' + g sin theta = 0", "the term -3*r*theta_ddot/2 is missing."),
        (
            "3 (R - r) theta'' = -2 g cos theta",
            "on the right side the term -2*g*cos(theta) is wrong: it should be -2*g*sin",
        ),
        ("theta'' = -2 g sin theta/(3 (R + r))", "the denominator 3*R + 3*r is wrong: it should be 3*R - 3*r."),
    ],
)
def test_a_factor_that_is_a_difference_stays_one(text: str, said: str) -> None:
    theta, (m, R, r, g) = lg.coordinate("theta"), lg.parameters("m R r g")
    bowl = lg.System(sp.Rational(3, 4) * m * (R - r) ** 2 * theta.dot**2, -m * g * (R - r) * sp.cos(theta))
    message = bowl.compare(text).message
    assert said in message, message


ROUNDED = {
    "theta'' = -0.6667 g sin(theta)/(R - r)": "Equation 1 is right to 4 digits: 0.6667 stands for 2/3.",
    "theta'' = -0.667 g sin(theta)/(R - r)": "Equation 1 is right to 3 digits: 0.667 stands for 2/3.",
    "theta'' = -0.5*1.333 g sin(theta)/(R - r)": "Equation 1 is right to 4 digits: 0.6665 stands for 2/3.",
    "0.75 (R - r) theta'' = -0.500 g sin(theta)": "The equations are right",
    "1.500 (R - r) theta'' + 1.414*0.707 g sin(theta) = 0": "0.999698 stands for 1.",
}
"""Answers that are right but for rounded numbers, and what is said of these."""

COARSE = {
    "theta'' = -0.67 g sin(theta)/(R - r)": "To 2 digits 0.67 stands for 2/3: give at least 3, or the exact number.",
    "theta'' = -0.666 g sin(theta)/(R - r)": "(3*(R - r)). 0.666 is not 2/3 rounded: 0.667.",
    "theta'' = -0.667 g sin(theta)": "is wrong: it should be -2*g*sin(theta)/(3*",
    "theta'' = -0.668 g sin(theta)/(R - r)": "it is 501/500 times what it should be, -2*g*sin(theta)/(3*(R - r)).",
    "1.001 (R - r) theta'' + 0.6667 g sin(theta) = 0": "is wrong",
    "1.500 (R - r) theta'' + 0.999 g sin(theta) = 0": "it is 999/1000 times what it should be, g*sin(theta).",
    "theta'' = 0.6667 g sin(theta)/(R - r)": "is wrong",
}
"""Answers with too few digits, with digits that are cut off or wrong, or with another error."""


@pytest.mark.few(6)
@pytest.mark.parametrize("text", [*ROUNDED, *COARSE])
def test_a_decimal_stands_for_the_number_that_it_is_rounded_from(text: str) -> None:
    theta, (m, R, r, g) = lg.coordinate("theta"), lg.parameters("m R r g")
    bowl = lg.System(sp.Rational(3, 4) * m * (R - r) ** 2 * theta.dot**2, -m * g * (R - r) * sp.cos(theta))
    result = bowl.compare(text)
    assert bool(result) == (text in ROUNDED), result.message
    assert (ROUNDED | COARSE)[text] in result.message, result.message


def test_a_decimal_may_stand_for_a_root_or_a_longer_decimal() -> None:
    x, (m, k) = lg.coordinate("x"), lg.parameters("m k")
    driven = lg.System(m * x.dot**2 / 2, k * x**2 / 2, forces={x: sp.sqrt(2) * sp.cos(lg.t)})
    assert driven.compare("m x'' + k x = 1.414 cos(t)").message.endswith("1.414 stands for 1.414214.")
    assert not driven.compare("m x'' + k x = 1.42 cos(t)")
    falling = lg.System(m * x.dot**2 / 2, 9.80665 * m * x)
    assert falling.compare("x'' = -9.81").message.endswith("right to 3 digits: 9.81 stands for 9.80665.")
    assert not falling.compare("x'' = -9.8")


def test_of_two_readings_only_that_of_the_wrong_equation_is_quoted() -> None:
    found = shared_scene("double-pendulum")
    result = found.compare(
        "l2 theta2'' + l1 theta1'' cos(theta1 - theta2) - l1 theta1'^2 sin(theta1 - theta2) + g sin theta2 = 0\n"
        "(m1 + m2) l1 theta1'' + m2 l2 theta2'' cos(theta1 - theta2) + (m1 + m2) g sin(theta1) = 0"
    )
    assert result.wrong == (1,) and "Read as" not in result.message


def test_an_error_of_another_kind_is_no_slip() -> None:
    result = shared_scene("pendulum").compare("theta'' + (g/l) sin theta + theta'")
    assert result.message == "In equation 1, that of theta, the term theta_dot should not be there."


def test_of_two_readings_the_right_one_is_taken_and_shown() -> None:
    pendulum = shared_scene("pendulum")
    result = pendulum.compare("theta'' + g/l sin theta = 0")
    assert result and result.message.endswith("Read as theta_ddot + g/l*sin(theta) = 0.")
    result = pendulum.compare("theta''/2g = -sin theta/2l")
    assert result and result.read == "theta_ddot/(2*g) = -sin(theta)/(2*l)"
    assert not pendulum.compare("theta''/2g = -sin theta/3l")


def test_a_right_answer_in_two_lines_is_right() -> None:
    result = shared_scene("double-pendulum").compare(
        """(1) (m1 + m2) l1 theta1'' + m2 l2 theta2'' cos(theta1 - theta2)
                + m2 l2 theta2'^2 sin(theta1 - theta2) + (m1 + m2) g sin theta1 = 0;
           (2) l2 θ̈₂ + l1 θ̈₁ cos(θ₁ − θ₂)
                = l1 θ̇₁² sin(θ₁ − θ₂) − g sin θ₂."""
    )
    assert result and result.read.count("\n") == 1


def test_verdicts_are_short() -> None:
    """A wrong equation of many terms is told in 400 characters; the rest is in details."""
    name = "elastic-pendulum"
    system = shared_scene(name)
    names = system.statement.names
    wrong = " + ".join(
        f"{k}*{a}*{b}_dot*sin({a})*exp({b})" for k, (a, b) in enumerate([(x, y) for x in names for y in names] * 12, 2)
    )
    result = system.compare([f"{names[0]}_ddot + {wrong} = 0", f"{names[1]}_ddot = {wrong}"])
    assert not result and len(result.message) <= 400 and result.details


def test_constraints_beside_the_equations_are_right_if_they_hold() -> None:
    """The derivation lists them, and a multiple of a multiplier is still another name for it."""
    pendulum = shared_scene("cartesian-pendulum")
    equations = "m x'' = lambda x\nm y'' = -m g + lambda y\n"
    assert pendulum.compare(equations + "x^2 + y^2 = l^2")
    wrong = pendulum.compare(equations + "x^2 + y^2 = 2 l^2")
    assert not wrong and 2 in wrong.wrong


def test_a_letter_for_the_force_of_the_only_constraint_is_its_multiplier() -> None:
    pendulum = shared_scene("cartesian-pendulum")
    assert pendulum.compare("T = 1/2 m (x'^2 + y'^2)\nV = m g y\nm x'' = -T x/l\nm y'' = -T y/l - m g\nx^2 + y^2 = l^2")
    assert not pendulum.compare("m x'' = -T x/l\nm y'' = T y/l - m g")


def test_a_constraint_on_accelerations_beside_a_tension_of_the_other_sign_is_right() -> None:
    x, y = lg.coordinates("x y")
    m, M, g, l = lg.parameters("m M g l")
    pulley = lg.System(m * x.dot**2 / 2 + M * y.dot**2 / 2, -m * g * x - M * g * y, constraints={"string": x + y - l})
    assert pulley.compare("m x'' = m g - T, M y'' = M g - T, x'' = -y''")
    assert not pulley.compare("m x'' = m g - T, M y'' = M g - T, x'' = y''")
    wrong = pulley.compare("m x'' = m g - T\nM y'' = 2 M g - T").message
    assert wrong.startswith("In equation 2, that of y, on the right side the term 2*M*g has the wrong factor"), wrong


def test_a_remark_may_state_a_constraint_and_a_wrong_one_is_told() -> None:
    s, phi = lg.coordinates("s phi")
    m, R, g = lg.parameters("m R g")
    disc = lg.System(m * (s.dot**2 + R**2 * phi.dot**2 / 2) / 2, -m * g * s, constraints={"roll": s.dot - R * phi.dot})
    forces = "m s'' = m g - F\n1/2 m R^2 phi'' = F R".replace("F", "lambda")
    assert disc.compare(f"{forces}\nwith the rolling condition s' = R phi'")
    assert disc.compare(f"{forces}\ns'' = R phi''\nIn equilibrium s = 0")
    assert disc.compare(forces)
    wrong = disc.compare(f"{forces}\nwith the rolling condition s' = 2 R phi'")
    assert wrong.message.startswith("The equations hold, but the constraint roll is missing: add ")


@pytest.mark.parametrize("term", ["1e-16 x", "x/10^20", "1e-13*0.001 x"])
def test_a_term_too_small_to_be_tested_is_no_part_of_a_right_answer(term: str) -> None:
    result = oscillator().compare(f"m x'' + c x' + k x = m g + F cos(w t) + {term}")
    assert not result and result.message.startswith("In equation 1 the number 1e-")


def test_a_tension_with_the_sign_of_a_force_is_right_beside_a_constant_length() -> None:
    """The multiplier of r - l is the opposite of the tension."""
    r, theta = lg.coordinates("r theta")
    m, g, l = lg.parameters("m g l")
    energies = m * (r.dot**2 + r**2 * theta.dot**2) / 2, -m * g * r * sp.cos(theta)
    pendulum = lg.System(*energies, constraints={"rod": r - l}, parameters={m: 0.8, g: 9.81, l: 1.3}, initial={r: 1.3})
    assert pendulum.compare("m r'' = m r θ'^2 + m g cos θ - T\nm r^2 θ'' + 2 m r r' θ' = -m g r sin θ\nr = l")
    assert not pendulum.compare("m r'' = m r θ'^2 + 2 m g cos θ - T\nm r^2 θ'' + 2 m r r' θ' = -m g r sin θ\nr = l")


def test_the_right_equation_has_no_number_as_a_factor() -> None:
    """Of two factors that mend an equation, the one that leaves a product of symbols times a right equation."""
    phi, (m, R, g) = lg.coordinate("phi"), lg.parameters("m R g")
    ball = lg.System(7 * m * R**2 * phi.dot**2 / 10, -m * g * R * sp.cos(phi))
    assert "the term 7*R*phi_ddot/10 has the wrong factor" in ball.compare("7/10 R phi'' + g sin phi = 0").message
    half = orbit().compare("(m + M) r'' = m r phi'^2 - M g\nr phi''/2 + 2 r' phi' = 0").message
    assert "the term r*phi_ddot/2 has the wrong factor" in half


def test_solved_terms_are_not_expanded_to_find_them_among_those_of_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their denominators are sums that no right term has; expanding them takes seconds."""
    expanded: list[sp.Expr] = []

    def recorded(expression: sp.Expr) -> tuple[sp.Expr, ...]:
        expanded.append(expression)
        return (expression,)

    monkeypatch.setattr(one_change, "expanded", recorded)
    assert not pulley().compare("x'' = (m1 - 2 m2) g/(m1 + m2 + I/R^2)")
    assert expanded and not any(power.base.is_Add for x in expanded for power in x.atoms(sp.Pow))


def test_an_abbreviation_holds_for_the_lines_after_it() -> None:
    kepler = shared_scene("kepler")
    assert kepler.compare("r = sqrt(x^2 + y^2)\nx'' = -mu x/r^3\ny'' = -mu y/r^3")
    assert not kepler.compare("r = sqrt(x^2 + y^2)\nx'' = -mu x/r^2\ny'' = -mu y/r^3")
    with pytest.raises(lg.StatementError, match="'tehta_dd' is not a symbol"):
        shared_scene("pendulum").compare("tehta_dd = -g/l sin(theta)")


def test_an_equation_without_a_value_somewhere_is_wrong() -> None:
    drag = "D^2 gamma/m"
    result = shared_scene("thrown-ball").compare(
        f"x'' = -({drag}) x' sqrt(x'^2 - y'^2)\ny'' = -g - ({drag}) y' sqrt(x'^2 + y'^2)"
    )
    assert not result and result.wrong == (0,)


LARGER: list[tuple[Callable[[], lg.System], str, str]] = [
    (
        oscillator,
        "x'' = -k x - c x' + m g + F cos(w t)",
        "the right side has the wrong denominator: it should be divided by m.",
    ),
    (
        oscillator,
        "x'' = -k x/m^2 - c x'/m^2 + g/m + F cos(w t)/m^2",
        "the right side has the wrong denominator: it should be multiplied by m.",
    ),
    (
        oscillator,
        "x'' = -k x - c x' + g + F cos(w t)",
        "on the right side the term",
    ),
    (oscillator, "x'' = (k x + c x' - m g - F cos(w t))/m", "the right side has the wrong sign"),
    (
        cart,
        "x'' = m l theta'^2 sin theta + m g sin theta cos theta",
        "the right side has the wrong denominator: it should be divided by M + m*sin(theta)**2.",
    ),
    (
        chain,
        "M x2'' + k (x2 - x1 - b) + k (x3 - x2 - b) = 0",
        "the term k*(x3 - x2 - b) has the wrong sign: it should be -k*(x3 - x2 - b).",
    ),
    (
        top,
        "I1 phi'' sin^2 theta + I1 phi' theta' sin theta cos theta = I3 (psi' + phi' cos theta) theta' sin theta",
        "that of phi and psi together, the term I1*phi_dot*theta_dot*sin(theta)*cos(theta) has the wrong factor",
    ),
    (orbit, "d/dt(m r phi') = 0\nr'' = 0", "the term d/dt(m*r*phi_dot) is wrong: it should be d/dt(m*r**2*phi_dot)."),
    (orbit, "M g - m r phi'^2 = -d/dt(m r')", "the term d/dt(m*r_dot) is wrong: it should be d/dt((M + m)*r_dot)."),
    (wedge, "(M - m) X'' + m s'' cos a = 0", "the term -m*X_ddot has the wrong sign: it should be"),
    (wedge, "(M + 2m) X'' + m s'' cos a = 0", "the term 2*m*X_ddot has the wrong factor: it is 2 times"),
    (morse, "m r'' = -D a (1 - e^(-a r)) e^(-a r)", "the term -D*a*(1 - exp(-a*r))*exp(-a*r) has the wrong factor"),
    (morse, "m r'' = 2 a D (1 - e^(-a r)) e^(-a r)", "the term 2*D*a*(1 - exp(-a*r))*exp(-a*r) has the wrong sign"),
    (morse, "m r'' + 2 D (1 - e^(-a r)) e^(-a r) = 0", "the term 2*D*(1 - exp(-a*r))*exp(-a*r) is wrong"),
    (orbit, "d/dt(m r^2 phi') = 0\nd/dt((M + m) r') = m r phi'^2 + M g", "the term M*g has the wrong sign"),
    (wedge, "s'' = g sin a\n(M + m) X'' + m s'' cos a = 0", "the term X_ddot*cos(a) is missing"),
    (strung, "m1 x'' = m1 g - T\nm2 y'' = m2 g + T", "the term T has the wrong sign: it should be -T."),
    (wedge, "X'' = -m s'' cos(a)/M\ns'' = g sin a - X'' cos a", "the denominator M is wrong: it should be M + m."),
    (wedge, "X'' = -m s'' cos(a)/(M - m)", "the denominator M - m is wrong: it should be M + m."),
    (wedge, "s'' = (m + M) g sin a/(m + M sin(a)^2)", "the denominator M*sin(a)**2 + m is wrong: it should be M + m*"),
    (wedge, "m (X'' + s'') = m g sin a", "the term m*X_ddot is wrong: it should be m*X_ddot*cos(a)."),
    (strung, "m1 x'' + m2 y'' = m1 g - m2 g + 2 T", "the term -m2*g has the wrong sign: it should be"),
    (driven, "l theta'' = 3 A cos(theta - gamma t)^2", "the term 3*A*cos(theta - gamma*t)**2"),
    (driven, "l theta'' = 3 A sin(theta - gamma t)", "the term 3*A*sin(theta - gamma*t)"),
    (driven, "l theta'' = 3 A sin(gamma t - theta)", "the term 3*A*sin(gamma*t - theta)"),
    (oscillator, "m x'' + c x + k x = m g + F cos(w t)", "the term c*x is wrong: it should be c*x_dot."),
    (oscillator, "m x'' + c x' + 2 k x = m g + F cos(w t)", "2 times what it should be, k*x."),
    (orbit, "(m - M) g + (m + M) r'' = m r phi'^2", "the term (m - M)*g is wrong"),
    (
        table,
        "m x'' = mu N sign(x')\nm y'' = N - m g",
        "the term mu*N*sign(x_dot) has the wrong sign: it should be -mu*N",
    ),
    (table, "m x'' = mu N sign(x')\nN = m g", "the term mu*N*sign(x_dot) has the wrong sign: it should be -mu*N"),
    (table, "m x'' = -mu N sign(x')\nm y'' = N + m g", "the term m*g has the wrong sign: it should be -m*g."),
    (rolling, "(m + I/R) s'' = m g sin(alpha)\ns = R phi", "the term I*s_ddot/R is wrong: it should be I*s_ddot/R**2."),
    (rolling, "(m R + I) s'' = m g R^2 sin(alpha)\ns = R phi", "the term m*R*s_ddot is wrong: it should be m*R**2*s_"),
    (
        spun,
        "J1 R_body_x' = (J2 + J3) R_body_y R_body_z",
        "the term J3*R_body_y*R_body_z has the wrong sign: it should be -",
    ),
    (spun, "J2 R_body_y' = (J3 - J1) R_body_x", "is wrong: it should be (J3 - J1)*R_body_x*R_body_z."),
    (
        spun,
        "2 J3 R_body_z' = (J1 - J2) R_body_x R_body_y",
        "the term 2*J3*R_body_z_dot has the wrong factor",
    ),
    (rod, "m x'' = lambda x\nm y'' = m g + lambda y", "In equation 2, that of y, on the right side the term m*g has"),
    (rod, "m x'' = -T x/l\nm y'' = -T y/l + m g", "In equation 2, that of y, on the right side the term m*g has the"),
    (rod, "m x'' = 2 lambda x\nx^2 + y^2 = 2 l^2", "In equation 2, that of the constraint rod, on the right side the"),
    (rod, "m x'' = 2 lambda x\nx^2 = y + l", "not a constraint: the constraint is rod, x**2 + y**2 - l**2 = 0."),
    (strung, "x'' = g/2 + lambda/m1\ny'' = g + lambda/m2", "on the right side the term g/2 has the wrong factor"),
    (
        strung,
        "x'' = y''\nm1 x'' + m2 y'' = (m1 - m2) g",
        "that of the constraint string, on the right side the term",
    ),
    (rolling, "s'' = 2 R phi''", "that of the constraint rolling, on the right side the term 2*R*phi_ddot has the"),
    (pulley, "(m1 + m2 - I/R^2) x'' = (m1 - m2) g", "the term -I*x_ddot/R**2 has the wrong sign"),
    (pulley, "x'' = (m1 - m2) g R^2/(m1 R^2 + 2 m2 R^2 + I)", "the denominator I + m1*R**2 + 2*m2*R**2 is wrong"),
    (coupled, "m1 x1'' + k x1 = 0\nm2 x2'' + k x2 + kappa(x2 - x1) = 0", "the term -kappa*(x2 - x1) is missing."),
    (disc, "m s'' + f = m g\n0 = f R", "In equation 2, that of phi, the term -I*phi_ddot is missing."),
    (yoyo, "y'' = m g R^2/(m R^2)", "the term I*y_ddot/(m*R**2) is missing."),
    (oscillator, "m x' + c x' + k x = m g + F cos(w t)", "the term m*x_dot is wrong: it should be m*x_ddot."),
    (orbit, "d/dt((M + m) r') = -M g\nd/dt(m r^2 phi') = 0", "on the right side the term m*r*phi_dot**2 is missing."),
    (strung, "lambda = -m1 m2 g/(m1 + m2)\nm1 x'' = m1 g + lambda\nm2 y'' = m2 g + lambda", "is 1/2 times what"),
    (strung, "x'' = g\ny'' = -g", "the term -lambda_string/m1, the force of the constraint string, is missing."),
]
"""Wrong answers, and what is said of a part that is larger than a term, or of a force of a constraint."""


@pytest.mark.few(12)
@pytest.mark.parametrize(("system", "text", "said"), LARGER)
def test_a_wrong_factor_momentum_or_force_is_named_as_a_whole(
    system: Callable[[], lg.System], text: str, said: str
) -> None:
    message = system().compare(text).message
    assert said in message.replace("w*t", "t*w"), message


@pytest.mark.parametrize("right", ["C", "p_phi", "L_z", "const", "h_0"])
def test_a_momentum_equated_with_an_unknown_name_is_constant(right: str) -> None:
    result = orbit().compare(f"m r^2 phi' = {right}\n(m + M) r'' = m r phi'^2 - M g")
    assert result and result.read.startswith("d/dt(m*r**2*phi_dot)\n")
    assert not orbit().compare(f"m r phi' = {right}\n(m + M) r'' = m r phi'^2 - M g")


@pytest.mark.parametrize("text", ["(m + M) r'' = C", "r phi = C", "m r^2 phi' = C D"])
def test_no_other_equation_has_an_unknown_constant(text: str) -> None:
    with pytest.raises(lg.StatementError, match="'C' is not a symbol"):
        orbit().compare(text)


def test_a_line_at_the_indentation_of_an_equation_with_indented_lines_is_a_new_one() -> None:
    hanging = "(m + M) r''\n    - m r phi'^2\n    = -M g\n- m r phi'' - 2 m r' phi'\n    = 0"
    assert orbit().compare(hanging)
    flush = "(m + M) r'' = m r phi'^2\n- M g\nr phi'' + 2 r' phi' = 0"
    assert orbit().compare(flush)


def test_coordinates_in_brackets_before_several_equations_are_labels() -> None:
    assert orbit().compare("(r) (m + M) r'' = m r phi'^2\n  - M g\n(φ) r phi'' + 2 r' phi' = 0")
    assert not orbit().compare("(r) r phi'' + 2 r' phi' = 0\n(m + M) r'' = m r phi'^2 + M g")


def test_nested_functions_are_not_differentiated_to_find_small_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second derivatives of 24 squares of sines in one another take SymPy seconds."""
    statement = oscillator().statement
    (equation,) = read_equations("m x'' = " + "sin^2 " * 24 + "x", statement)
    monkeypatch.setattr(sp, "diff", lambda *_: pytest.fail("a derivative was taken"))
    assert wrong_term._small_angles([equation.zero], statement) == ""


def test_a_factor_of_a_high_power_is_not_factored() -> None:
    """Factors of x**729 + 1 take SymPy some 20 seconds."""
    result = oscillator().compare("m x'' + c x' + x^9^9^9kx = m g + F cos(w t)")
    assert "the term k*x**730 is wrong: it should be k*x." in result.message


def test_a_sum_with_an_exponent_of_many_digits_is_not_factored(monkeypatch: pytest.MonkeyPatch) -> None:
    """The factors of x**(3001/1000) + x are those of a polynomial of degree 3001, which takes SymPy minutes."""
    x, k, m = sp.symbols("x k m")
    monkeypatch.setattr(sp, "factor", lambda *_: pytest.fail("a sum was factored"))
    typed = (k * x + m * x**3.001) / (k * x + m * x**3)
    assert plain_form.simplest(typed).has(x)


LARGE = ("exp(-1e9 x^2)", "exp(1e6 x)", "cosh(1e6 x)", "*".join(f"(x + {i} c)" for i in range(25)))
"""Factors with which the search for a wrong term takes SymPy minutes in a single call."""


@pytest.mark.parametrize("factor", LARGE, ids=range(len(LARGE)))
def test_the_wrong_term_of_an_equation_of_large_numbers_is_not_searched(factor: str) -> None:
    result = oscillator().compare(f"m x'' + c x' + k x {factor} = m g + F cos(w t)")
    assert result.wrong == (0,) and budget.UNNAMED in result.message


def test_a_spent_budget_leaves_the_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "SECONDS", 0.0)
    assert oscillator().compare("m x'' + c x' + k x = m g + F cos(w t)")
    result = oscillator().compare("m x'' + c x' - k x = m g + F cos(w t)")
    assert not result and result.message == f"Equation 1 does not hold. {budget.UNNAMED}" and result.details


def test_equations_in_rates_are_as_long_as_in_quaternions(monkeypatch: pytest.MonkeyPatch) -> None:
    """An equation of few rates may have hundreds of terms in quaternions, and trying a slip takes a second."""
    monkeypatch.setattr(wrong_term, "LONGEST_SLIP", 40)
    monkeypatch.setattr(wrong_term, "_slips", lambda *_, **__: pytest.fail("slips are tried"))
    assert not shared_scene("free-top").compare("J1*R_body_x_dot = -2*(J2 - J3)*R_body_y*R_body_z")


def test_a_spent_budget_ends_every_expansion(monkeypatch: pytest.MonkeyPatch) -> None:
    with budget.limited(0.0), pytest.raises(budget.BudgetSpent):
        term_difference.expanded(sp.Symbol("x"))


def test_a_fraction_of_a_number_with_a_large_exponent_is_not_built() -> None:
    assert term_difference.constant_of([mpmath.mpf(10) ** -(10**8)]) is None
    assert term_difference.constant_of([mpmath.mpf(2) / 3]) == Fraction(2, 3)


def test_a_high_power_of_a_sum_is_not_expanded() -> None:
    """The thousand terms of (x + g)**999, each evaluated alone, take two seconds."""
    power = (sp.Symbol("x") + sp.Symbol("g")) ** 999
    assert term_difference.expanded(power) == (power,)
