"""Answers as people type them: what the package prints is read back, ambiguous texts, common slips, short verdicts."""

from __future__ import annotations

import random
from fractions import Fraction
from pathlib import Path

import mpmath
import pytest
import sympy as sp

import lagrange as lg
from lagrange.mechanics import plain_form
from lagrange.mechanics.grading import one_change, term_difference, wrong_term
from lagrange.mechanics.grading.student_equations import read_equations
from lagrange.show.derivation_page import NO_HEADING, PAGES, render
from lagrange.show.notation.sections import sections
from tests.mechanics.answered_systems import answered, orbit, oscillator, pulley, table
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


ANSWERS = Path(__file__).with_name("answers.txt").read_text("utf-8").splitlines()[1:]
"""Answers, one a line: the system, right or wrong, a part of the message, and the text."""


@pytest.mark.few(24)
@pytest.mark.parametrize("line", ANSWERS)
def test_an_answer_is_judged_and_its_wrong_term_is_named(line: str) -> None:
    system, verdict, said, text = line.split("\t")
    result = answered(system).compare(text.replace("⏎", "\n"))
    assert bool(result) == (verdict == "right"), result.message
    assert said in result.message.replace("w*t", "t*w"), result.message


def test_mutated_answers_are_judged_or_refused() -> None:
    """Of an answer with a part missing, doubled or replaced nothing is run, and every message is short."""
    dice, systems = random.Random(2), ("scene:pendulum", "oscillator", "table", "pulley", "typed:damped")
    rows = [line.split("\t") for line in ANSWERS]
    answers = [(row[0], row[3].replace("⏎", "\n")) for row in rows if row[0] in systems]
    for _ in range(40):
        name, text = dice.choice(answers)
        begin, scrap = (
            dice.randrange(len(text)),
            dice.choice(("", "\\dot{", "__import__('os')", "²", "=", "\n", "(", "θ")),
        )
        text = text[:begin] + scrap + text[begin + dice.randrange(4) :]
        try:
            message = answered(name).compare(text).message
        except lg.StatementError as refusal:
            message = str(refusal)
        assert 0 < len(message) <= 400, text


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
    assert result.wrong == (0,) and term_difference.UNNAMED in result.message


def test_a_spent_budget_leaves_the_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(term_difference, "SECONDS", 0.0)
    assert oscillator().compare("m x'' + c x' + k x = m g + F cos(w t)")
    result = oscillator().compare("m x'' + c x' - k x = m g + F cos(w t)")
    assert not result and result.message == f"Equation 1 does not hold. {term_difference.UNNAMED}" and result.details


def test_equations_in_rates_are_as_long_as_in_quaternions(monkeypatch: pytest.MonkeyPatch) -> None:
    """An equation of few rates may have hundreds of terms in quaternions, and trying a slip takes a second."""
    monkeypatch.setattr(wrong_term, "LONGEST_SLIP", 40)
    monkeypatch.setattr(wrong_term, "_slips", lambda *_, **__: pytest.fail("slips are tried"))
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
