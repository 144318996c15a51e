"""Students' equations: equivalent ones are right, in others the wrong term is named; answers as people type them."""

import math
import re
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import mpmath
import pytest
import sympy as sp

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.mechanics import plain_form
from lagrange.mechanics.grading import one_change, slips, term_difference, time_limit
from lagrange.mechanics.grading.student_equations import read_equations, spelled
from lagrange.mechanics.grading.term_difference import expanded
from lagrange.show.derivation_page import NO_HEADING, PAGES
from lagrange.show.notation.sections import sections
from tests.models import SCENE_NAMES, shared_scene, stated_in
from tests.refusals import nested, refusal

m, g, l, M, k, R, F, c, m1, m2, l1, l2, omega, Omega, alpha, a, b, beta, gamma, I1, I3, r0, L0, ma, mb, mu = (
    lg.parameters("m g l M k R F c m1 m2 l1 l2 omega Omega alpha a b beta gamma I1 I3 r_0 L_0 m_A m_B mu")
)
inertia, w, kappa, D, A, L, J1, J2, J3, r_ = lg.parameters("I w kappa D A L J1 J2 J3 r")
x1, x2, X = lg.coordinates("x1 x2 X")
theta, phi, psi, x, y, z, r, s, theta1, theta2, rho, th1, th2, q1, q2, xa, xb = lg.coordinates(
    "theta phi psi x y z r s theta1 theta2 rho theta_1 theta_2 q1 q2 x_A x_B"
)
K, sin, cos, half = lg.kinetic_energy, sp.sin, sp.cos, sp.Rational(1, 2)
polar = half * m * (r.dot**2 + r**2 * phi.dot**2)
plane = half * m * (x.dot**2 + y.dot**2)
bob = half * m * l**2 * theta.dot**2, -m * g * l * cos(theta)
inner = l1 * sin(theta1), -l1 * cos(theta1)
outer = inner[0] + l2 * sin(theta2), inner[1] - l2 * cos(theta2)
twin = k * l**2 * (sin(th1) - sin(th2)) ** 2 / 2 - m * g * l * (cos(th1) + cos(th2))
rotor = I1 * (theta.dot**2 + sin(theta) ** 2 * phi.dot**2) / 2 + I3 * (psi.dot + phi.dot * cos(theta)) ** 2 / 2
turning = half * m * ((x.dot - omega * y) ** 2 + (y.dot + omega * x) ** 2) - k * (x**2 + y**2) / 2
swinging = half * m * (r.dot**2 + r**2 * theta.dot**2)
speed = sp.sqrt(x.dot**2 + y.dot**2)
stretched = lg.spring(k, (r * cos(theta), r * sin(theta)), None, l)
rolled = half * m * s.dot**2 + half * inertia * phi.dot**2
body = lg.rotation("R").body
swaying = a * cos(omega * lg.t) + l * sin(theta), -l * cos(theta)

TYPED: dict[str, Callable[[], lg.System]] = {
    "oscillator": lambda: lg.System(
        half * m * x.dot**2, k * x**2 / 2 - m * g * x, forces={x: F * cos(w * lg.t)}, dissipation=c * x.dot**2 / 2
    ),
    "morse": lambda: lg.System(half * m * r.dot**2, D * (1 - sp.exp(-a * r)) ** 2),
    "orbit": lambda: lg.System(
        half * (m + M) * r.dot**2 + half * m * r**2 * phi.dot**2, M * g * r, coordinates=[r, phi]
    ),
    "slope": lambda: lg.System(
        half * (M + m) * X.dot**2 + half * m * s.dot**2 + m * X.dot * s.dot * cos(a), -m * g * s * sin(a)
    ),
    "cart": lambda: lg.System(K(M, x) + K(m, (x + l * sin(theta), -l * cos(theta))), -m * g * l * cos(theta)),
    "driven": lambda: lg.System(
        half * m * l**2 * theta.dot**2, -m * l * (g + A * sin(theta - gamma * lg.t)) * cos(theta)
    ),
    "floor": lambda: lg.System(plane, m * g * y, constraints={"table": y}, forces={x: -mu * m * g * sp.sign(x.dot)}),
    "rolling": lambda: lg.System(rolled, -m * g * s * sin(alpha), constraints={"rolling": s - R * phi}),
    "disc": lambda: lg.System(rolled, -m * g * s, constraints={"roll": s.dot - R * phi.dot}),
    "strung": lambda: lg.System(K(m1, x) + K(m2, y), -m1 * g * x - m2 * g * y, constraints={"string": x + y - L}),
    "spun": lambda: lg.System(half * (J1 * body[0] ** 2 + J2 * body[1] ** 2 + J3 * body[2] ** 2)),
    "rod": lambda: lg.System(plane, m * g * y, constraints={"rod": x**2 + y**2 - l**2}),
    "pulley": lambda: lg.System(half * (m1 + m2 + inertia / R**2) * x.dot**2, -(m1 - m2) * g * x),
    "yoyo": lambda: lg.System(half * (m + inertia / R**2) * y.dot**2, -m * g * y),
    "coupled": lambda: lg.System(K(m1, x1) + K(m2, x2), k * (x1**2 + x2**2) / 2 + kappa * (x2 - x1) ** 2 / 2),
    "bowl": lambda: lg.System(sp.Rational(3, 4) * m * (R - r_) ** 2 * theta.dot**2, -m * g * (R - r_) * cos(theta)),
    "pendulum": lambda: lg.System(*bob),
    "damped": lambda: lg.System(*bob, dissipation=b * theta.dot**2 / 2),
    "coupledpend": lambda: lg.System(half * m * l**2 * (th1.dot**2 + th2.dot**2), twin),
    "cone": lambda: lg.System(
        half * m * (r.dot**2 / sin(alpha) ** 2 + r**2 * phi.dot**2), m * g * r / sp.tan(alpha), coordinates=[r, phi]
    ),
    "parabola": lambda: lg.System(K(m, (x, beta * x**2)), m * g * beta * x**2),
    "top": lambda: lg.System(rotor, m * g * l * cos(theta)),
    "wedge": lambda: lg.System(K(M, (x, 0)) + K(m, (x + s * cos(alpha), -s * sin(alpha))), -m * g * s * sin(alpha)),
    "pivot": lambda: lg.System(K(m, swaying), -m * g * l * cos(theta)),
    "double_pendulum": lambda: lg.System(K(m1, inner) + K(m2, outer), g * (m1 * inner[1] + m2 * outer[1])),
    "table": lambda: lg.System(
        half * m1 * (r.dot**2 + r**2 * phi.dot**2) + half * m2 * r.dot**2, m2 * g * r, coordinates=[r, phi]
    ),
    "foucault": lambda: lg.System(plane + m * Omega * (x * y.dot - y * x.dot), m * g * (x**2 + y**2) / (2 * l)),
    "duffing": lambda: lg.System(
        half * m * x.dot**2, k * x**2 / 2 + beta * x**4 / 4, forces={x: F * cos(omega * lg.t) - c * x.dot}
    ),
    "side": lambda: lg.System(half * m * x.dot**2, k * (sp.sqrt(x**2 + l**2) - r0) ** 2 / 2),
    "rhoz": lambda: lg.System(
        half * m * (rho.dot**2 + rho**2 * phi.dot**2 + z.dot**2), m * g * z + k * (rho**2 + z**2) / 2
    ),
    "yukawa": lambda: lg.System(polar, -k / sp.sqrt(r)),
    "normal": lambda: lg.System(half * m * (q1.dot**2 + q2.dot**2), k * (q1**2 + q2**2 - q1 * q2) / 2),
    "helix": lambda: lg.System(half * m * (R**2 + a**2) * phi.dot**2, m * g * a * phi),
    "cycloid": lambda: lg.System(half * m * s.dot**2, m * g * s**2 / (8 * R)),
    "AB": lambda: lg.System(
        K(ma, (xa, 0)) + K(mb, (xb, 0)), k * (xb - xa - L0) ** 2 / 2, dissipation=c * (xb.dot - xa.dot) ** 2 / 2
    ),
    "relat": lambda: lg.System(polar, gamma * r**2 / 2 - alpha / r),
    "springhoop": lambda: lg.System(K(m, (R * theta, 0)), k * R**2 * (1 - cos(theta)) - m * g * R * sin(theta)),
    "rotframe": lambda: lg.System(lagrangian=turning),
    "weighed": lambda: lg.System(half * m * y.dot**2, m * g * y, constraints={"table": y}, parameters={m: 1, g: 9.81}),
    "polar": lambda: lg.System(swinging, stretched),
    "hanging": lambda: lg.System(swinging, stretched - m * g * r * cos(theta)),
    "line": lambda: lg.System(half * m * x.dot**2, lg.spring(k, (x,), rest_length=l)),
    "two": lambda: lg.System(plane, lg.spring(k, (x, 0), (y, 0), l)),
    "friction": lambda: lg.System(half * m * x.dot**2, 0, forces={x: -mu * m * g * sp.sign(x.dot)}),
    "drag": lambda: lg.System(plane, m * g * y, forces={x: -c * speed * x.dot, y: -c * speed * y.dot}),
    "valued": lambda: lg.System(
        half * m * x.dot**2, k * (x - b) ** 2 / 2 + c * x**4, parameters={k: 30, b: 2, m: 3, c: 0}
    ),
    "sprung": lambda: lg.System(
        half * m * (theta.dot**2 + phi.dot**2),
        k * (sin(theta) - sin(phi)) ** 2 / 2 - m * g * (cos(theta) + cos(phi)),
        coordinates=[theta, phi],
    ),
}
"""Systems of answers in many styles, by name."""


@cache
def answered(name: str) -> lg.System:
    """Return the system of an answer: `scene:name`, or a name in the table of this file, also as `typed:name`."""
    kind, _, rest = name.rpartition(":")
    return shared_scene(rest) if kind == "scene" else TYPED[rest]()


# --- students' equations: equivalent equations are right, and in others the wrong term is named ----------------


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


@pytest.mark.slow
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
    answer = "m1 x1'' + k x1 + kappa (x1 - x2) = 1\nm2 x2'' + k x2 + kappa (x2 - x1) = 1"
    result = answered("coupled").compare(answer)
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
    result = answered("coupled").compare("m1 x1'' + m2 x2'' + k x1 - k x2 = 0\nm2 x2'' + k x2 + kappa (x2 - x1) = 0")
    start = "In equation 1, for x1 and x2 together, the term -k*x2 has the wrong sign: it should be k*x2."
    assert result.message.startswith(start)


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


def test_the_sine_of_a_large_multiple_and_a_high_power_are_one_term() -> None:
    """A polynomial of degree 1000 takes twenty seconds, and a sum of a thousand terms two to evaluate."""
    x = sp.Symbol("x")
    for term in (sp.sin(1000 * x), (x + 1) ** 999):
        assert expanded(term) == (term,)
    assert set(expanded(sp.sin(2 * x))) == {2 * sp.sin(x) * sp.cos(x)}


# --- answers as people type them: printed equations read back, ambiguous texts, common slips, short verdicts ---


TURNING = [name for name in SCENE_NAMES if "rotations" in stated_in(name)]
"""Scenes whose equations are printed in rates; `tests/show/test_formula.py` reads back those of the others."""


@pytest.mark.slow
@pytest.mark.parametrize("style", ["text", "unicode", "latex"])
@pytest.mark.parametrize("name", TURNING)
def test_equations_printed_in_rates_are_an_answer(name: str, style: str) -> None:
    system = shared_scene(name)
    section = next(part for part in sections(system.derivation()) if part.heading == "Equations of motion")
    text = PAGES[style](system.statement, NO_HEADING).write([section]).split("Equations of motion")[1]
    assert system.compare(text.partition("\n")[2].removesuffix("\\end{document}\n"))


@pytest.mark.parametrize("style", ["text", "unicode", "latex", "markdown"])
@pytest.mark.parametrize(
    "name", ["pendulum", "cartesian-pendulum", pytest.param("atwood-machine", marks=pytest.mark.slow)]
)
def test_a_whole_derivation_is_an_answer(name: str, style: str) -> None:
    system = shared_scene(name)
    assert system.compare(system.derivation().written(style))


@pytest.mark.slow
@pytest.mark.few(1)
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
    assert re.search(said, refusal(answered(name).compare, text))


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


@pytest.mark.slow
def test_of_two_readings_only_that_of_the_wrong_equation_is_quoted() -> None:
    actual = shared_scene("double-pendulum")
    result = actual.compare(
        "l2 theta2'' + l1 theta1'' cos(theta1 - theta2) - l1 theta1'^2 sin(theta1 - theta2) + g sin theta2 = 0\n"
        "(m1 + m2) l1 theta1'' + m2 l2 theta2'' cos(theta1 - theta2) + (m1 + m2) g sin(theta1) = 0"
    )
    assert result.wrong == (1,) and "Read as" not in result.message


@pytest.mark.slow
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
    monkeypatch.setattr(time_limit, "SECONDS", 0.0)
    assert answered("oscillator").compare("m x'' + c x' + k x = m g + F cos(w t)")
    result = answered("oscillator").compare("m x'' + c x' - k x = m g + F cos(w t)")
    assert not result and result.message == f"Equation 1 does not hold. {time_limit.UNNAMED}" and result.details
    with time_limit.limited(0.0), pytest.raises(time_limit.BudgetSpent):
        expanded(sp.Symbol("x"))


@pytest.mark.slow
def test_equations_in_rates_are_as_long_as_in_quaternions(monkeypatch: pytest.MonkeyPatch) -> None:
    """An equation of few rates may have hundreds of terms in quaternions, and trying a slip takes a second."""
    monkeypatch.setattr(slips, "LONGEST_SLIP", 40)
    monkeypatch.setattr(slips, "_slips", lambda *_, **__: pytest.fail("slips are tried"))
    assert not answered("spun").compare("J1*R_body_x_dot = -2*(J2 - J3)*R_body_y*R_body_z")


def test_a_fraction_of_a_number_with_a_large_exponent_is_not_built() -> None:
    assert term_difference.constant_of([mpmath.mpf(10) ** -(10**8)]) is None
    assert term_difference.constant_of([mpmath.mpf(2) / 3]) == Fraction(2, 3)


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
