"""Students' equations: what is equivalent is accepted, what is not is refused with the term that is wrong."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import pytest
import sympy
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
def system(name: str) -> lg.System:
    return shared_scene(name)


@cache
def rows(name: str) -> tuple[Any, ...]:
    """What each equation of a scene says is zero, in plain symbols."""
    found = system(name)
    return tuple((law.lhs - law.rhs).xreplace(found.statement.plain) for law in found.equations())


@cache
def solved(name: str) -> tuple[Any, ...]:
    plain = system(name).statement.plain
    pairs = system(name).accelerations().items()
    return tuple(plain[q.diff(lg.t, 2)] - a.xreplace(plain) for q, a in pairs)


def texts(zeros: Any) -> list[str]:
    return [f"{spelled(zero)} = 0" for zero in zeros]


def sides(zero: Any) -> str:
    """An equation with its negative terms on the right."""
    terms = sp.Add.make_args(sp.expand(zero))
    left = [one for one in terms if not one.could_extract_minus_sign()]
    right = [-one for one in terms if one.could_extract_minus_sign()]
    return f"{spelled(sp.Add(*left))} == {spelled(sp.Add(*right))}"


def first_parameter(name: str) -> Any:
    return system(name).statement.parameters[0] if system(name).statement.parameters else sp.Integer(3)


def mixed(name: str) -> list[Any]:
    """Sums of the equations with coefficients that depend on the state."""
    found, (x, *_) = rows(name), system(name).statement.plain.values()
    return [zero + (2 + sp.cos(x)) * found[0] for zero in found]


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
    result = system(name).compare(REWRITINGS[how](name))
    assert result and RIGHT.fullmatch(result.message)
    assert not result.wrong and not result.counterexample


HIDDEN = {
    "behind a switch": "g*sin(theta)*heaviside(theta - 3)",
    "between switches": "g*heaviside(theta - 3)*heaviside(3.001 - theta)",
    "far away": "g*heaviside(theta - 1e6)",
    "of a parameter": "max(0, l - 5)",
    "small": "1e-12",
}
"""Terms that vanish, or nearly, at states of order one."""


@pytest.mark.parametrize("term", HIDDEN.values(), ids=HIDDEN)
def test_terms_that_vanish_at_most_states_are_found(term: str) -> None:
    result = system("pendulum").compare(f"m*l**2*theta_ddot + m*g*l*sin(theta) + {term} = 0")
    assert not result and "should not be there" in result.message


def test_branches_that_no_state_takes_are_told() -> None:
    result = system("pendulum").compare("l*theta_ddot + g*sin(theta) + g*max(0, sin(theta) - 2) = 0")
    assert result and "No state was found where sin(theta) - 2 is the one that" in result.message


def test_equations_with_switches_of_the_system_are_right() -> None:
    theta, k = lg.coordinate("theta"), lg.parameters("k")
    stop = lg.System(theta.dot**2 / 2, k * sp.Max(0, theta - 40) ** 2 / 2, parameters={k: 1})
    result = stop.compare("theta_ddot = -k*max(0, theta - 40)")
    assert result and int(re.findall(r"(\d+) states", result.message)[0]) > 5
    assert not stop.compare("theta_ddot = 0")


def test_arguments_beyond_doubles_have_no_value() -> None:
    assert not system("pendulum").compare("l*theta_ddot + g*sin(theta) + cos(cosh(1e9*theta)) = 0")


def swapped(term: Any) -> Any:
    """A term with sine for cosine and cosine for sine, or its first factor of higher power squared."""
    table = {f: (sp.cos if isinstance(f, sp.sin) else sp.sin)(f.args[0]) for f in term.atoms(sp.sin, sp.cos)}
    return term.xreplace(table) if table else None


MUTATIONS: dict[str, Callable[[Any], Any]] = {
    "sign": lambda term: -term,
    "twice": lambda term: 2 * term,
    "half": lambda term: term / 2,
    "left out": lambda term: sp.Integer(0),
    "sine for cosine": swapped,
}


def mutants() -> Iterator[tuple[str, int, str, Any, Any]]:
    """Yield scene, equation, mutation, term and mutated equation, some of them scaled."""
    for name in SCENES:
        for place, zero in enumerate(rows(name)):
            terms = sp.Add.make_args(sp.expand(zero))
            for k, term in enumerate(terms):
                for number, (how, change) in enumerate(MUTATIONS.items()):
                    if (k + number + place) % 2:  # half of them
                        continue
                    other = change(term)
                    if other not in (None, term):
                        factor = 1 if k % 2 else 5 / first_parameter(name)
                        yield name, place, how, term, factor * (sp.expand(zero) - term + other)


def leaves(name: str, term: Any) -> list[str]:
    """The factors of a term that depend on the state, or the parameters of one that does not."""
    plain = tuple(system(name).statement.plain.values())
    depends = term.as_independent(*plain, as_Add=False)[1]
    if depends != 1:
        return [spelled(one) for one in sp.Mul.make_args(depends)]
    return sorted({spelled(one) for one in term.free_symbols} - {spelled(first_parameter(name))})[:1]


@pytest.mark.slow
def test_wrong_terms_are_named() -> None:
    """At least five of six by the mutated term; the others as another one where a factor may be meant either way."""
    mutated = list(mutants())
    assert len(mutated) >= 60 and {how for _, _, how, _, _ in mutated} == set(MUTATIONS)
    missed = []
    for name, place, how, term, zero in mutated:
        given = [zero if i == place else other for i, other in enumerate(rows(name))]
        result = system(name).compare(texts(given))
        assert not result and result.wrong == (place,)
        message = result.message
        if not all(one in message for one in leaves(name, term)):
            missed.append((name, how, term, message))
    assert len(missed) <= len(mutated) / 6, missed


def test_the_counterexample_is_one() -> None:
    """The equation of the pendulum with the wrong sign leaves 2 g sin(theta) of the motion."""
    result = system("pendulum").compare("l*theta_ddot = g*sin(theta)")
    example = dict(result.counterexample)
    motion = -example["g"] / example["l"] * math.sin(example["theta"])
    assert example["theta_ddot"] == pytest.approx(motion, rel=1e-12)
    left = example["l"] * motion - example["g"] * math.sin(example["theta"])
    assert result.details.startswith("At theta = ") and result.details.endswith(f"differ by {left:.5g}.")
    assert "differ by" not in result.message


PENDULUM = "theta_ddot + g/l*sin(theta)"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            f"{PENDULUM}*2",
            "In equation 1, that of theta, the term 2*g*sin(theta)/l has the wrong factor: it is 2 "
            "times what it should be, g*sin(theta)/l.",
        ),
        (
            {"theta": "l*theta_ddot + g*cos(theta)"},
            "In the theta equation the term g*cos(theta) is wrong: it should be g*sin(theta).",
        ),
        (
            "theta_ddot = g/l*sin(theta)",
            "In equation 1, that of theta, on the right side the term g*sin(theta)/l has the wrong sign: it "
            "should be -g*sin(theta)/l.",
        ),
        (
            "theta_ddot = \u2212g/l\u00b7(theta - theta**3/6)",
            "In equation 1, that of theta, on the right side the term -g*(theta - theta**3/6)/l is wrong: it "
            "should be -g*sin(theta)/l.",
        ),
        (
            "theta_dot**2*l/2 - g*cos(theta) = 0",
            "Equation 1 does not hold, and contains no acceleration such as theta''",
        ),
        ("l*theta_ddot", "In equation 1, that of theta, the term g*sin(theta) is missing."),
        (f"{PENDULUM} - theta_dot", "In equation 1, that of theta, the term -theta_dot should not be there."),
        (
            [PENDULUM, "theta_dot = 0"],
            "Equation 2 does not hold, and contains no acceleration such as theta'' or theta_ddot: it is not an",
        ),
    ],
)
def test_messages(given: Any, message: str) -> None:
    result = system("pendulum").compare(given)
    assert not result and str(result).startswith(message)


def test_a_term_that_stands_for_another_is_named_with_it() -> None:
    one, two = rows("double-pendulum")
    v = sp.Symbol("theta1_dot", real=True)
    result = system("double-pendulum").compare([one, two.subs(v**2, v)])
    assert (
        " the term -m2*l1*l2*theta1_dot*sin(theta1 - theta2) is wrong: it should be -m2*l1*l2*theta1_dot**2*sin("
        in str(result)
    )


def test_all_wrong_equations_are_told() -> None:
    one, two = rows("double-pendulum")
    result = system("double-pendulum").compare([one + 1, two - 1])
    assert result.wrong == (0, 1) and result.message.endswith(" Equation 2 is wrong, too.")


def test_equations_must_determine_the_accelerations() -> None:
    one, _ = rows("double-pendulum")
    whole = system("double-pendulum")
    assert str(whole.compare([one])) == (
        "The equation holds, but 1 equation is given and 2 are needed: the accelerations of theta1 and theta2 are "
        "left open."
    )
    assert str(whole.compare([one, 2 * one])).startswith("The equations hold, but not all are independent: ")


def test_a_sum_of_equations_with_a_wrong_term() -> None:
    one, two = rows("double-pendulum")
    theta2 = sp.Symbol("theta2", real=True)
    g, l2, m2 = (p for n in ("g", "l2", "m2") for p in system("double-pendulum").statement.parameters if p.name == n)
    result = system("double-pendulum").compare([one + two - 2 * g * l2 * m2 * sp.sin(theta2), two])
    assert result.message.startswith(
        "In equation 1, that of theta1 and theta2 together, the term -m2*g*l2*sin(theta2) has the wrong sign: it "
        "should be m2*g*l2*sin(theta2)."
    )


@pytest.mark.parametrize(
    "name",
    [
        "charge-in-field",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("four-bar-change-point", "chain-of-springs")),
    ],
)
def test_accelerations_of_zero_and_states_near_a_crossing(name: str) -> None:
    """One coordinate moves freely, one comes near zero; of five coordinates a message tells no state."""
    found = system(name)
    assert found.compare(texts(rows(name)))
    result = found.compare(texts([*rows(name)[:-1], rows(name)[-1] + 1]))
    assert "the term 1 should not be there." in result.message
    assert ("At the state in .counterexample the two" in result.details) == (name == "chain-of-springs")


@pytest.mark.parametrize("sign", [1, -1])
def test_equations_with_multipliers(sign: int) -> None:
    """With either sign of them; and the motion along the rod alone, without any."""
    found = system("cartesian-pendulum")
    plain = found.statement.plain
    zeros = [(law.lhs - law.rhs).xreplace(plain) for law in found.equations()]
    multipliers = {one.multiplier: sign * one.multiplier for one in found.statement.constraints}
    result = found.compare([zero.xreplace(multipliers) for zero in zeros])
    assert result and result.message.endswith("opposite sign." if sign < 0 else "states tried.")
    assert found.compare("x*y_ddot - y*x_ddot + g*x = 0")
    wrong = found.compare("x*y_ddot - y*x_ddot - g*x = 0")
    assert not wrong and wrong.wrong == (0,)


def test_sympy_and_text_are_read_alike() -> None:
    theta, (m, g, l) = lg.coordinate("theta"), sp.symbols("m g l")
    pendulum = system("pendulum")
    assert pendulum.compare(sp.Eq(m * l * theta.ddot, -m * g * sp.sin(theta)))
    assert pendulum.compare([l * sp.Symbol("theta_ddot") + g * sp.sin(sp.Symbol("theta"))])
    assert pendulum.compare({theta: "l*theta_ddot == -g*sin(theta)"})
    assert pendulum.compare("# by hand\n\nl*theta_ddot = -g*sin(theta)  # the only one\n")


@pytest.mark.parametrize("number", [5e-324, 1.7976931348623157e308, sp.Float("1e-400"), "theta_ddot + 1e-320"])
def test_numbers_that_doubles_do_not_resolve_are_no_rounded_numbers(number: Any) -> None:
    assert not system("pendulum").compare(number)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([], "no equation is given: give a list with one for each coordinate."),
        (["heaviside(theta_ddot) = 1"], "equation 1 is not linear in theta_ddot: equations of motion are compared"),
        (["theta_ddot**2 = 1"], "equation 1 is not linear in theta_ddot: equations of motion are compared as linear"),
        (
            ["k*theta_ddot"],
            "equation 1, column 1: 'k' is not a symbol of this system. The symbols are theta, m, g and l, with",
        ),
        ([lg.coordinate("phi").ddot], "'phi' is not a coordinate of this system; they are theta."),
        ([sp.Symbol("k") * sp.sin(1)], "equation 1 contains 'k', which this system does not have; its symbols are"),
        ({"phi": "theta_ddot"}, "'phi' is not a coordinate of this system; they are theta."),
        (["g = g = g"], "equation 1, column 7: there are 2 signs of equality: write one equation with two sides."),
        (["theta_ddot + (g = 0"], "equation 1, column"),
        (
            "m max(theta'', 0) = -g",
            "equation 1 is not linear in theta_ddot: equations of motion are compared as linear",
        ),
        ("abs(theta'') = -g", "equation 1 is not linear in theta_ddot"),
        ("d/dt(heaviside(theta)) = g", "equation 1 has the derivative of a jump, such as heaviside"),
        (["__import__('os')"], "equation 1"),
        ([True], "equation 1 is True: where == was meant, write sympy.Eq(left, right)."),
        (
            [lg.multiplier("rod")],
            "equation 1 contains the multiplier of 'rod', which is not a constraint here; the constraints are none.",
        ),
        ([lg.coordinate("theta") ** (10**30)], "equation 1 contains the exponent 10000000000000000000"),
        (
            [lg.coordinate("theta") ** sp.Rational(10**9, 3)],
            "equation 1 contains the exponent 1000000000/3, which is out of bounds: at most",
        ),
        ([nested(lg.coordinate("theta"), 350)], "equation 1 is nested too deeply to be compared: multiply it out"),
        (["x" * 30_000], "equation 1 has 30000 characters, and 8000 are the most of an equation."),
    ],
)
def test_refusals(given: Any, message: str) -> None:
    assert refusal(system("pendulum").compare, given).startswith(message)


def test_files_are_refused_by_line() -> None:
    with pytest.raises(StatementError, match=r"^line 3, column 1: 'c' is not a symbol of this system"):
        system("pendulum").compare("theta_ddot + g/l*sin(theta)\n\nc*theta_dot = 0\n")
    with pytest.raises(StatementError, match=r"^there is no equation: write one a line"):
        system("pendulum").compare("# nothing\n")


@pytest.mark.parametrize(
    ("spring", "message"),
    [
        ("+ k*(sin(a) - sin(b))*cos(b)", "the term k*(sin(a) - sin(b))*cos(b) has the wrong sign: it should be "),
        ("- 2*k*(sin(a) - sin(b))*cos(b)", "the term -2*k*(sin(a) - sin(b))*cos(b) has the wrong factor: it is "),
        ("- k*(a - b)", "the term -k*(a - b) is wrong: it should be -k*(sin(a) - sin(b))*cos(b)."),
        ("", "the term -k*(sin(a) - sin(b))*cos(b) is missing."),
    ],
)
def test_of_a_sum_only_the_part_that_is_wrong_is_named(spring: str, message: str) -> None:
    a, b = lg.coordinates("a b")
    m, g, k = lg.parameters("m g k")
    pendulums = lg.System(
        kinetic=m * (a.dot**2 + b.dot**2) / 2,
        potential=-m * g * (sp.cos(a) + sp.cos(b)) + k * (sp.sin(a) - sp.sin(b)) ** 2 / 2,
    )
    right = "m*a_ddot + m*g*sin(a) + k*(sin(a) - sin(b))*cos(a) = 0"
    result = pendulums.compare([right, f"m*b_ddot + m*g*sin(b) {spring} = 0"])
    assert result.message.startswith(f"In equation 2, that of b, {message}"), result.message


def test_a_name_in_letters_of_other_alphabets_is_named_whole() -> None:
    for word in ("φ_ddot", "thêta", "θ\u0301_ddot", "φ1"):
        with pytest.raises(StatementError, match=rf"^equation 1, column 3: '{word}' is not a symbol of this system"):
            system("pendulum").compare([f"2*{word} + g = 0"])


def on_rod(factor: str) -> list[str]:
    """Return the equations of a pendulum on a rod, with its multiplier times a factor."""
    return [f"m*x_ddot - 2*x*{factor}*lambda_rod = 0", f"m*y_ddot + m*g = 2*y*{factor}*lambda_rod"]


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        ("1", "states tried."),
        ("1/2", "Their multipliers are 2 times those of the system."),
        ("(-3)", "Their multipliers are -1/3 times those of the system."),
        ("1/l", "Their multipliers are multiples of those of the system."),
        ("(1 + x**2)", "Their multipliers are multiples of those of the system."),
    ],
)
def test_a_multiple_of_a_multiplier_is_another_name_for_it(factor: str, said: str) -> None:
    result = system("cartesian-pendulum").compare(on_rod(factor))
    assert result and result.message.endswith(said)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "equations",
    [
        [on_rod("1")[0], on_rod("1/2")[1]],  # two names for one multiplier
        [on_rod("1/2")[0], "m*y_ddot + 2*m*g = y*lambda_rod"],
        ["2*m*x_ddot - 2*x*lambda_rod = 0", on_rod("1")[1]],
        [on_rod("1")[0], "m*y_ddot + m*g = 0"],
    ],
)
def test_no_multiple_of_a_multiplier_hides_another_error(equations: list[str]) -> None:
    assert not system("cartesian-pendulum").compare(equations)


@pytest.mark.parametrize(("weight", "right"), [("m*g", True), ("2*m*g", False), ("-m*g", False)])
def test_a_wrong_weight_on_a_table_is_no_other_multiplier(weight: str, right: bool) -> None:
    y, (mass, g) = lg.coordinate("y"), lg.parameters("m g")
    table = lg.System(mass * y.dot**2 / 2, mass * g * y, constraints={"table": y}, parameters={mass: 1, g: 9.81})
    assert bool(table.compare([f"m*y_ddot + {weight} = lambda_table"])) == right
    assert bool(table.compare([f"m*y_ddot + {weight} = -3*m*lambda_table"])) == right


VORTICES = (
    "x1' = -Gamma2 (y1 - y2)/(2 pi s)",
    "y1' = Gamma2 (x1 - x2)/(2 pi s)",
    "x2' = Gamma1 (y1 - y2)/(2 pi s)",
    "y2' = -Gamma1 (x1 - x2)/(2 pi s)",
    "s = (x1 - x2)^2 + (y1 - y2)^2",
)
"""Kirchhoff's equations of two point vortices: Saffman, Vortex Dynamics (1992), section 7.1."""


@pytest.mark.slow
def test_equations_of_first_order() -> None:
    vortices = system("two-point-vortices")
    assert vortices.compare(vortices.equations()) and vortices.compare("\n".join(VORTICES))
    assert vortices.compare("\n".join(VORTICES[1:])).message.endswith("the motion of x1 is left open.")
    turned = "\n".join(VORTICES).replace("x1' = -", "x1' = ")
    assert " has the wrong sign: it should be -Gamma2*(y1 - y2)/(2*pi*(" in vortices.compare(turned).message
    assert not vortices.compare("\n".join(VORTICES).replace("2 pi", "pi"))


def test_a_filter_of_first_order() -> None:
    e = lg.coordinate("e")
    delay = lg.System(0, 0, coordinates=[e], forces={e: 1 - e}, dissipation=e.dot**2 / 2)
    assert delay.compare("e' = 1 - e") and delay.compare("e'' = -e'")
    assert "the term e has the wrong sign" in delay.compare("e' = 1 + e").message


def test_the_sine_of_a_large_multiple_is_one_term() -> None:
    """Expanded, it is a polynomial of that degree: the thousandth takes twenty seconds."""
    x = sympy.Symbol("x")
    assert expanded(sympy.sin(1000 * x)) == (sympy.sin(1000 * x),)
    assert set(expanded(sympy.sin(2 * x))) == {2 * sympy.sin(x) * sympy.cos(x)}


SIDES = {
    "polar": (
        "m r'' - m r theta'^2 = -k (r - l)\nd/dt(m r^2 theta') = 0",
        "The equations are right where r > 0: they are equivalent to those of the system, at the ",
    ),
    "polar, another term": (
        "m r'' - m r theta'^2 = -k (r - 2 l)\nd/dt(m r^2 theta') = 0",
        "In equation 1, that of r, on the right side the term 2*k*l has the wrong factor: it is 2 times what it should",
    ),
    "polar, with abs": (
        "m r'' - m r theta'^2 = -k (abs(r) - l)\nd/dt(m r^2 theta') = 0",
        "The equations are right where r > 0: ",
    ),
    "polar, one missing": (
        "m r'' - m r theta'^2 = -k (r - l)",
        "The equation holds, but 1 equation is given and 2 are",
    ),
    "line": ("m x'' = -k (x - l)", "The equations hold only where x > 0. In equation 1, that of x, on the right side"),
    "two": ("m x'' = -k (x - y + l)\nm y'' = k (x - y + l)", "The equations hold only where x - y < 0. In equation 1,"),
    "friction": ("m x'' = -mu m g", "The equations hold only where x_dot > 0. In equation 1, that of x,"),
}


@pytest.mark.parametrize("name", SIDES)
def test_an_answer_for_one_side_of_a_kink_says_on_which_it_is_right(name: str) -> None:
    r, theta, x, y = lg.coordinates("r theta x y")
    k, l, m, mu, g = lg.parameters("k l m mu g")
    line, between = m * x.dot**2 / 2, m * (x.dot**2 + y.dot**2) / 2
    systems = {
        "polar": lg.System(
            m * (r.dot**2 + r**2 * theta.dot**2) / 2, lg.spring(k, (r * sp.cos(theta), r * sp.sin(theta)), None, l)
        ),
        "line": lg.System(line, lg.spring(k, (x,), rest_length=l)),
        "two": lg.System(between, lg.spring(k, (x, 0), (y, 0), l)),
        "friction": lg.System(line, 0, forces={x: -mu * m * g * sp.sign(x.dot)}),
    }
    answer, message = SIDES[name]
    result = systems[name.partition(",")[0]].compare(answer)
    assert result.message.startswith(message)
    assert bool(result) == (name in ("polar", "polar, with abs"))


PENDULUM_ON_A_SPRING = (
    "m r'' - m r theta'^2 + k (r - l) - m g cos theta = 0",
    "r theta'' + 2 r' theta' + g sin theta = 0",
)

BESIDE_A_DISTANCE = [  # what is typed in place of what, and the message
    ("- m r theta'^2", "", "In equation 1, that of r, the term -m*r*theta_dot**2 is missing."),
    (
        "2 r'",
        "r'",
        "In equation 2, that of theta, the term r_dot*theta_dot has the wrong factor: it is 1/2 times what it should "
        "be, 2*r_dot*theta_dot.",
    ),
    (
        "- m r theta",
        "+ m r theta",
        "In equation 1, that of r, the term m*r*theta_dot**2 has the wrong sign: it should be -m*r*theta_dot**2.",
    ),
    (
        "- m r theta",
        "- m theta",
        "In equation 1, that of r, the term -m*theta_dot**2 is wrong: it should be -m*r*theta_dot**2.",
    ),
    ("(r - l)", "r", "In equation 1, that of r, the term -k*l is missing."),
]


@pytest.mark.parametrize(("right", "wrong", "message"), BESIDE_A_DISTANCE)
def test_a_wrong_term_is_named_where_the_distance_is_positive(right: str, wrong: str, message: str) -> None:
    """The spring's force has sign(r): the answer has r - l, which is right where r > 0, and is not blamed."""
    r, theta = lg.coordinates("r theta")
    k, l, m, g = lg.parameters("k l m g")
    spring = lg.spring(k, (r * sp.cos(theta), r * sp.sin(theta)), None, l)
    swinging = lg.System(m * (r.dot**2 + r**2 * theta.dot**2) / 2, spring - m * g * r * sp.cos(theta))
    assert swinging.compare(PENDULUM_ON_A_SPRING)
    typed = "\n".join(PENDULUM_ON_A_SPRING)
    assert typed.count(right) == 1
    assert swinging.compare(typed.replace(right, wrong)).message == message


def test_a_term_missing_beside_a_momentum_that_is_constant() -> None:
    r, theta = lg.coordinates("r theta")
    k, l, m = lg.parameters("k l m")
    spring = lg.spring(k, (r * sp.cos(theta), r * sp.sin(theta)), None, l)
    central = lg.System(m * (r.dot**2 + r**2 * theta.dot**2) / 2, spring)
    result = central.compare("m r'' + k (r - l) = 0; m r^2 theta' = const")
    assert result.message.startswith("In equation 1, that of r, the term -m*r*theta_dot**2 is missing.")


def test_an_extra_term_with_a_decimal_is_named() -> None:
    theta = lg.coordinate("theta")
    m, g, l = lg.parameters("m g l")
    pendulum = lg.System(m * l**2 * theta.dot**2 / 2, -m * g * l * sp.cos(theta))
    result = pendulum.compare("theta'' = -g/l sin theta + 0.1 theta'")
    assert "on the right side the term 0.1*theta_dot should not be there." in result.message


NUMBERS = [  # an answer with numbers in place of symbols, and the start of the message
    ("3 x'' + 30 (x - 2) = 0", "The equations are right for k = 30, d = 2, m = 3 and c = 0, but they are asked for in"),
    ("m x'' + k (x - 2) + 4 c x^3 = 0", "The equations are right for d = 2, but they are asked for in symbols."),
    ("m x'' + k (x - 4) + 4 c x^3 = 0", "In equation 1, that of x, the term -4"),
    ("m x'' + k (x - d) = 0", "In equation 1, that of x, the term 4*c*x**3 is missing."),
]


@pytest.mark.parametrize(("answer", "message"), NUMBERS)
def test_an_answer_with_numbers_is_asked_for_symbols(answer: str, message: str) -> None:
    x = lg.coordinate("x")
    k, d, m, c = lg.parameters("k d m c")
    values = {k: 30, d: 2, m: 3, c: 0}
    result = lg.System(m * x.dot**2 / 2, k * (x - d) ** 2 / 2 + c * x**4, parameters=values).compare(answer)
    assert not result
    assert result.message.startswith(message)
