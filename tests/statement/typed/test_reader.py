"""Equations as people type them: what is read, in which of two ways, and what is refused with all its faults."""

from __future__ import annotations

import random

import pytest
import sympy as sp

from lagrange.errors import LagrangeError, StatementError
from lagrange.statement.typed.reader import TypedReader
from tests.refusals import refusal

NAMES = ("m", "m1", "m2", "g", "l", "l1", "k", "M", "R", "omega", "mu_s")
COORDINATES = ("theta", "theta1", "x", "x_block")


def reader(*extra: str) -> TypedReader:
    rates = [f"{q}{ending}" for q in COORDINATES for ending in ("", "_dot", "_ddot")]
    names = (*rates, *NAMES, "lambda_rod", *extra)
    return TypedReader({name: sp.Symbol(name, real=True) for name in names}, {"lambda": "lambda_rod"})


READINGS = {
    "m l^2 theta''": "m*l**2*theta_ddot",
    "2g": "2*g",
    "mgl sin theta": "m*g*l*sin(theta)",
    "(m1 + m2) g sin(theta1)": "(m1 + m2)*g*sin(theta1)",
    "mR^2": "m*R**2",
    "sin^2 theta": "sin(theta)**2",
    "sin^2(theta) x'": "sin(theta)**2*x_dot",
    "sin omega t": "sin(omega*t)",
    "sin 2theta": "sin(2*theta)",
    "sin 2*theta": "sin(2*theta)",
    "sin theta cos theta1": "sin(theta)*cos(theta1)",
    "thetaddot + thetadotdot + ddtheta + theta_ddot": "theta_ddot + theta_ddot + theta_ddot + theta_ddot",
    "theta1ddot + thetaddot1 + theta_1_ddot": "theta1_ddot + theta1_ddot + theta1_ddot",
    "d2theta/dt2": "theta_ddot",
    "d^2theta/dt^2": "theta_ddot",
    "d^2 x/dt^2": "x_ddot",
    "d²θ/dt²": "theta_ddot",
    "(dtheta/dt)^2": "theta_dot**2",
    "d/dt(m l^2 theta')": "d/dt(m*l**2*theta_dot)",
    "d/dt (x)": "x_dot",
    "diff(x, t, 2) + Derivative(m x(t), (t, 2)) + D[x[t], t]": "x_ddot + d^2/dt^2(m*x) + x_dot",
    "sin2θ + Cos(x)": "sin(2*theta) + cos(x)",
    "theta''(t) + x(t)": "theta_ddot + x",
    "x.ddot + x.dot": "x_ddot + x_dot",
    "x.diff(t, 2) + x(t).diff(t, t) + theta.diff(t)": "x_ddot + x_ddot + theta_dot",
    "x_tt + θ¨ + x˙ + (d^2/dt^2) theta1": "x_ddot + theta_ddot + x_dot + theta1_ddot",
    "θ̈₁ + θ̇²": "theta1_ddot + theta_dot**2",
    "mẍ": "m*x_ddot",
    "½ m l²": "1/2*m*l**2",
    "−ω · x × 2": "-omega*x*2",
    "x’’ + x″": "x_ddot + x_ddot",
    "√(2g) + √2": "sqrt(2*g) + sqrt(2)",
    "|x| x": "abs(x)*x",
    r"\ddot{\theta}_1 + \ddot\theta": "theta1_ddot + theta_ddot",
    r"\dot{x}^2 + \dot\theta_1^2 + \dot\theta^2_1": "x_dot**2 + theta1_dot**2 + theta1_dot**2",
    r"\frac{g}{l} + \tfrac12 m + \frac1{2}": "g/l + 1/2*m + 1/2",
    r"\left( m_1 + m_2 \right) \cdot g \, x": "(m1 + m2)*g*x",
    r"\sin^2\theta + \sqrt{2 g}": "sin(theta)**2 + sqrt(2*g)",
    r"\frac{d^2\theta}{dt^2} + \frac{d\theta}{dt}": "theta_ddot + theta_dot",
    r"\frac{d}{dt}\left( m l^2 \dot\theta \right)": "d/dt(m*l**2*theta_dot)",
    r"\frac{\mathrm{d}^2 x}{\mathrm{d}t^2}": "x_ddot",
    r"\frac{\mathrm d}{\mathrm dt}(m x)": "d/dt(m*x)",
    r"\mu_s g + \mu_{\mathrm{s}} x_{block}": "mu_s*g + mu_s*x_block",
    r"\lambda + \lambda_{rod} + lambda[rod]": "lambda_rod + lambda_rod + lambda_rod",
    "e^{-k x} + e^(-t)": "exp(-k*x) + exp(-t)",
    r"\arctan x + \sin^{-1} x": "atan(x) + asin(x)",
    "1/2 m x": "1/2*m*x",
    "x^-2": "x**(-2)",
    "0,5 m x'' + 1{,}5 k": "0.5*m*x_ddot + 1.5*k",
    "max(0,5) + atan2(1,2)": "max(0, 5) + atan2(1, 2)",
    "1½ x + 2¾": "3/2*x + 11/4",
    "ddot(x) + dot(theta)": "x_ddot + theta_dot",
    "xdd + thetad + theta1dd": "x_ddot + theta_dot + theta1_ddot",
    "a_x + v_x": "x_ddot + x_dot",
    r"\ell_1 + m\ell + mℓ²": "l1 + m*l + m*l**2",
    r"\dv[2]{x}{t} + \dv{\theta}{t}": "x_ddot + theta_dot",
    r"\frac gl + \frac{g}2 + \frac\theta2": "g/l + g/2 + theta/2",
    r"\phantom{-}g": "g",
    "d/dt [m x']": "d/dt(m*x_dot)",
}


@pytest.mark.parametrize(("text", "expected"), READINGS.items())
def test_what_is_typed_is_read(text: str, expected: str) -> None:
    (equation,) = reader().equations(text)
    assert equation.readings[0].read == expected


@pytest.mark.parametrize(
    ("text", "readings"),
    [
        ("g/2l", ["g/(2*l)", "g/2*l"]),
        ("d/dt m l^2 theta'", ["d/dt(m*l**2*theta_dot)", "d/dt(m)*l**2*theta_dot"]),
        ("d/dt (m l^2) theta'", ["d/dt(m*l**2)*theta_dot", "d/dt(m*l**2*theta_dot)"]),
        ("g/l x", ["g/l*x", "g/(l*x)"]),
        ("sin theta^2", ["sin(theta**2)", "sin(theta)**2"]),
        ("sin x/2", ["sin(x)/2", "sin(x/2)"]),
        ("g/(m l)(x - theta)", ["g/(m*l)*(x - theta)", "g/(m*l*(x - theta))"]),
        ("sin omega x", ["sin(omega*x)", "sin(omega)*x"]),
        ("cos omega/(m + M)", ["cos(omega)/(m + M)", "cos(omega/(m + M))"]),
    ],
)
def test_of_two_readings_both_are_returned(text: str, readings: list[str]) -> None:
    (equation,) = reader().equations(text)
    assert [one.read for one in equation.readings] == readings


def test_a_constant_angle_is_the_whole_argument_of_a_function() -> None:
    (equation,) = reader("alpha").equations("sin alpha x'")
    assert [one.read for one in equation.readings] == ["sin(alpha)*x_dot", "sin(alpha*x_dot)"]


def test_a_word_is_the_symbol_of_that_name_before_it_is_a_product() -> None:
    (equation,) = reader().equations("l1 t")
    assert [one.read for one in equation.readings] == ["l1*t"]
    (equation,) = reader("ml").equations("ml x''")
    assert [one.read for one in equation.readings] == ["ml*x_ddot"]
    (equation,) = reader("d").equations("dx")
    assert [one.read for one in equation.readings] == ["x_dot", "d*x"]


LINES = {
    "x'' = 0,5 x, theta'' = 1,5": ["x_ddot = 0.5*x", "theta_ddot = 1.5"],
    "x'' = 1,2 theta'' = 3": ["x_ddot = 1", "2*theta_ddot = 3"],
    "x'' = 0\nand\ntheta'' = 0": ["x_ddot = 0", "theta_ddot = 0"],
    "The equations are $x'' = 0$\nand $theta'' = 0$": ["x_ddot = 0", "theta_ddot = 0"],
    "x'' = -k x | : m": ["x_ddot = -k*x"],
    "d/dt(dL/dx') - dL/dx = m x'' + k x = 0": ["m*x_ddot + k*x = 0"],
    "m x''\n  = -k x": ["m*x_ddot = -k*x"],
    "m x'' =\n -k x": ["m*x_ddot = -k*x"],
    "m x''\n + k x = 0\n\nM theta'' = 0": ["m*x_ddot + k*x = 0", "M*theta_ddot = 0"],
    "(1) m x'' = 0\n(2) M theta'' = 0": ["m*x_ddot = 0", "M*theta_ddot = 0"],
    "x: m x'' = 0;\neq1: M theta'' = 0.": ["m*x_ddot = 0", "M*theta_ddot = 0"],
    "x'' = 0, theta'' = 0": ["x_ddot = 0", "theta_ddot = 0"],
    "# mine\nx'' = 0  # because": ["x_ddot = 0"],
    "**Answer**\n\n1. `x'' = 0`\n2. so `theta'' = 0`": ["x_ddot = 0", "theta_ddot = 0"],
    "1: x'' + k x = 0\n2: -m theta''\n   = M": ["x_ddot + k*x = 0", "-m*theta_ddot = M"],
    "x: x'' = 0,   theta: theta'' = 0": ["x_ddot = 0", "theta_ddot = 0"],
    "x'' = 0   (3)": ["x_ddot = 0"],
    r"\boxed{\ddot{x} = -\frac{k}{m} x} \text{(EOM)}": ["x_ddot = -k/m*x"],
    "{m x'' = k (x - l), theta'' = 0}": ["m*x_ddot = k*(x - l)", "theta_ddot = 0"],
    "[Eq(m*Derivative(x(t), (t, 2)), -k*x(t)), Eq(theta'', 0)]": ["m*x_ddot = -k*x", "theta_ddot = 0"],
    r"\hspace{1cm}\left\{\begin{array}{l} \ddot x = 0 \\ \ddot\theta = 0 \end{array}\right.": [
        "x_ddot = 0",
        "theta_ddot = 0",
    ],
    "a = x'' = -k x": ["x_ddot = -k*x"],
    "v = sqrt(x'^2)\nx'' = -v x' // drag": ["x_ddot = -v*x_dot"],
    "m x''\n+ k x\n- m g x = 0": ["m*x_ddot + k*x - m*g*x = 0"],
    "m x''\n  - k x = 0\nM theta''\n  - k (theta - x) = 0": ["m*x_ddot - k*x = 0", "M*theta_ddot - k*(theta - x) = 0"],
    "- m x'' = 0\n- M theta'' = 0": ["m*x_ddot = 0", "M*theta_ddot = 0"],
    "- k x = m x''": ["-k*x = m*x_ddot"],
    "-k x = m x''\n-k theta = theta''": ["-k*x = m*x_ddot", "-k*theta = theta_ddot"],
    "\\begin{align}\n m \\ddot x &= -k x \\\\\n \\ddot\\theta &= 0 \\label{b}\n\\end{align}": [
        "m*x_ddot = -k*x",
        "theta_ddot = 0",
    ],
}


@pytest.mark.parametrize("text", LINES)
def test_lines_are_joined_and_labels_left_out(text: str) -> None:
    assert [one.readings[0].read for one in reader().equations(text)] == LINES[text]


REMARKS = {
    "x'' = -k x/m   (small angles)": ["x_ddot = -k*x/m"],
    "x'' = -k x/m (counted downwards for m)": ["x_ddot = -k*x/m"],
    "x'' = -g x/l, where g = 9.81 m/s^2": ["x_ddot = -g*x/l"],
    "x'' = -a x, where a = k/m": ["x_ddot = -a*x"],
    "x'' = -w^2 x\n(w^2 = k/m)": ["x_ddot = -w**2*x"],
    "x'' = -w0² x, w0 = sqrt(k/m)": ["x_ddot = -w0**2*x"],
    "x'' = -g x/l  [rad/s^2]": ["x_ddot = -g*x/l"],
    "x'' = -k x/m; k = 30 N/m": ["x_ddot = -k*x/m"],
    "Lagrange (L = T - V): d/dt(dL/dx') = dL/dx\nm x'' = -k x": ["m*x_ddot = -k*x"],
    "L = 1/2 m x'^2 - 1/2 k x^2 => m x'' = -k x": ["m*x_ddot = -k*x"],
    "The equation of motion for x is m x'' = -k x    Q.E.D.": ["m*x_ddot = -k*x"],
    "m x'' = -k x\nso w^2 = k/m for small x": ["m*x_ddot = -k*x"],
    "m x'' = -k x & M theta'' = 0": ["m*x_ddot = -k*x", "M*theta_ddot = 0"],
    "$$m \\ddot x = -k x$$ $$M \\ddot\\theta = 0$$": ["m*x_ddot = -k*x", "M*theta_ddot = 0"],
    "m \\ddot x = -k x \\quad \\text{for all } x": ["m*x_ddot = -k*x"],
    "m x'' = F = -k x": ["m*x_ddot = -k*x"],
    "x'' = -k x/m = -k/m x": ["x_ddot = -k*x/m", "x_ddot = -k/m*x"],
    "p = m x' = const.": ["d/dt(m*x_dot)"],
    "i) m x'' = 0\n(b) M theta'' = 0": ["m*x_ddot = 0", "M*theta_ddot = 0"],
    "m \\ddot x = 0 \\qquad M \\ddot\\theta = 0": ["m*x_ddot = 0", "M*theta_ddot = 0"],
    "m (x'' + g\n  - R x) = 0": ["m*(x_ddot + g - R*x) = 0"],
    "Newton's second law: m x'' = -k x\nSteady state: x = A cos(delta)\nTerminal velocity: x' = g": ["m*x_ddot = -k*x"],
    "x'' = -k x/m   (y = a x^2)": ["x_ddot = -k*x/m"],
    "1.) x'' = -k x/m, (horizontal plane)": ["x_ddot = -k*x/m"],
    "x'' = -k x/m  [Coriolis + centrifugal] ✓": ["x_ddot = -k*x/m"],
    "x'' = -k x/m\nEquilibria: cos(x) = k/m": ["x_ddot = -k*x/m"],
    "x'' = -k x/m; x(0) = R\nThe equilibrium is at x = m g/k.": ["x_ddot = -k*x/m"],
    "It does not slip, thus x'' = r α. Adding gives\nx'' = -k x/m": ["x_ddot = -k*x/m"],
    "Newton: sum of forces = m x'', hence +g - k x = m x'' (x in m, t in s)": ["g - k*x = m*x_ddot"],
    "The wheel rolls, so r φ' = x'\nx'' = 0": ["x_ddot = 0"],
    "The radial one is x'' = 0 [N] and the other one is\ntheta'' = 0": ["x_ddot = 0", "theta_ddot = 0"],
    "x'' = 0   ...(i)\ntheta'' = 0   (ii)": ["x_ddot = 0", "theta_ddot = 0"],
    "x'' = -k sin(x)\nFor small x: x'' = -k x": ["x_ddot = -k*sin(x)"],
    "For small x: x'' = -k x": ["x_ddot = -k*x"],
    "| x: | x'' = k |\n| theta: | theta'' = 0 |": ["x_ddot = k", "theta_ddot = 0"],
    r"A\ddot{q} + Cq = 0 \text{ with } \ddot x = k": ["x_ddot = k"],
    "Because of ∂L/∂φ = 0 the angular momentum J = x^2 theta' is constant\nx'' = J^2": [
        "d/dt(x**2*theta_dot)",
        "x_ddot = J**2",
    ],
    "x'' = -2 d x' // d = k/m": ["x_ddot = -2*d*x_dot"],
    r"\frac{d^{2}x(t)}{dt^{2}} + \frac{dx(t)}{dt} = k": ["x_ddot + x_dot = k"],
    "x'' = -k (k = stiffness), x^2 + theta^2 = l^2": ["x_ddot = -k", "x**2 + theta**2 = l**2"],
}
"""Answers with words around the equations, and the equations."""


REMARKS |= {
    f"{before}x'' = -k x/m{after}": ["x_ddot = -k*x/m"]
    for before, after in [
        ("Newton's second law gives ", ", where m is the mass"),
        ("Die Gleichung für x lautet ", " (ohne Reibung)"),
        ("So, ", ", for small x"),
        ("```\n", "\n```"),
        ("", " -- no friction"),
        ("", " where k is the stiffness of the spring"),
        *(("", f" {words}") for words in ("for all times", "(for all t)", "for any t", "∀ t")),
        ("Let v = x' be the rate.\n", "\nwhich is independent of g."),
        ("L = T - V, ", ", Q.E.D."),
        ("", " (conservation of E = m x'^2/2 + k x^2/2)"),
    ]
}
"""Answers with words that are set apart."""

DEFINED = {
    r"\text{Therefore } \ddot x = -k x": "x_ddot = -k*x",
    "so -k x = m x''": "-k*x = m*x_ddot",
    "x'' = -ω0² x\nω0² = c_1/m\nc_1 = k": "x_ddot = -omega0**2*x",
    r"\ddot x = -\omega_c x, \omega_c = \frac{k}{m}": "x_ddot = -omega_c*x",
    "m x'' plus k x minus g over l = 0": "m*x_ddot + k*x - g/l = 0",
    "m v' = -k x times 2\nv = dx/dt": "m*v_dot = -k*x*2",
    "\ufeff𝑚 𝑥̈ = −𝑘 𝑥": "m*x_ddot = -k*x",
    "θ'' = sen θ - arctg θ": "theta_ddot = sin(theta) - atan(theta)",
    "x'' = -2γx', γ = k/(2m)": "x_ddot = -2*gamma*x_dot",
    "Let D = x - theta and C = m + M. Then\nC x'' = k D": "C*x_ddot = k*D",
    "x' = v\nm v' = -k x": "m*v_dot = -k*x",
    "x_dot = v, v_dot = -k x/m": "v_dot = -k*x/m",
    "y1 = x, y2 = x'\ny1' = y2, y2' = -k y1": "y1_dot = y2",
    "With q1 = x + theta, q2 = x - theta:\nm q1'' = -k q2": "m*q1_ddot = -k*q2",
    "p_x' = -k p_θ²\nx' = p_x/m\nθ' = p_θ/m\np_θ' = 0": "p_x_dot = -k*p_theta**2",
    "With μ := k/m we get x'' = -μ x": "x_ddot = -mu*x",
    "Let γ = k/(2m) and ω0 = sqrt(k/m). Then x'' + 2γx' + ω0²x = 0.": "x_ddot + 2*gamma*x_dot + omega0**2*x = 0",
    "a = x'' and\nm a = -k x": "m*a = -k*x",
    "x'' = -k x/m =: a": "x_ddot = -k*x/m",
    "theta' = const, i.e. d/dt(m theta') = 0": "d/dt(m*theta_dot) = 0",
    "and from the second Lagrange equation 2 x'' = -k x": "2*x_ddot = -k*x",
    "x' = p/m\np' = -k x": "p_dot = -k*x",
    "x'' = h^2/x^3 with x^2 theta' = h": "x_ddot = h**2/x**3",
    "theta' = h/x^2, x'' = h^2/x^3, h = const": "x_ddot = h**2/x**3",
    "h = x^2 theta' is constant, x'' = h^2/x^3": "d/dt(x**2*theta_dot)",
    "p = x^2 theta' = h = const => theta' = h/x^2": "d/dt(x**2*theta_dot)",
    "xpp = -k xp theta1p": "x_ddot = -k*x_dot*theta1_dot",
}
"""Answers with definitions, words for operations, and letters of formula editors, and the first equation."""


@pytest.mark.parametrize("text", DEFINED)
def test_definitions_and_words_for_operations_are_read(text: str) -> None:
    equation = next(one for one in reader().equations(text) if not one.aside)
    assert equation.readings[0].read == DEFINED[text]


PAIR = r"\begin{pmatrix} x \\ \theta \end{pmatrix}"
MATRICES = {
    r"m \begin{pmatrix} \ddot x \\[2pt] \ddot\theta \end{pmatrix} = \begin{bmatrix} -k x \\ m g \end{bmatrix}": [
        "m*x_ddot = -k*x",
        "m*theta_ddot = m*g",
    ],
    rf"\ddot{{{PAIR}}} = -\begin{{pmatrix}} k & -l \\ 0 & k + 1 \end{{pmatrix}}" + f"\n \\cdot {PAIR}": [
        "x_ddot = -(k*x + (-l)*theta)",
        "theta_ddot = -(k + 1)*theta",
    ],
    r"\frac{d}{dt} \left(\begin{array}{c} m \dot x \\ \dot\theta \end{array}\right) = 0": [
        "d/dt(m*x_dot) = 0",
        "theta_ddot = 0",
    ],
    r"A \ddot{q} + g q = 0, A = \begin{pmatrix} m & 0 \\ 0 & k \end{pmatrix}, q = " + PAIR: [
        "m*x_ddot + g*x = 0",
        "k*theta_ddot + g*theta = 0",
    ],
}
"""Vector equations, and the equation of each row."""


@pytest.mark.parametrize("text", MATRICES)
def test_each_row_of_a_vector_equation_is_an_equation(text: str) -> None:
    assert [one.readings[0].read for one in reader().equations(text)] == MATRICES[text]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (r"\begin{pmatrix} x \end{vmatrix} = 0", "an answer has a matrix that is not read"),
        ("Matrix([[x''], [theta'']]) = 0", "an answer has a matrix that is not read"),
        (rf"{PAIR} = \begin{{pmatrix}} x \\ x \\ x \end{{pmatrix}}", "a column has 3 rows, and one before it 2"),
        (r"\begin{pmatrix} x & m \end{pmatrix} = 0", "column 1: matrices that do not fit: expected is a column"),
        (rf"{PAIR}^2 = 0", "a column has no powers"),
        (rf"\begin{{pmatrix}} x & m & g \end{{pmatrix}} {PAIR} = 0", "matrices that do not fit"),
        (r"\begin{pmatrix} x \\ & m \end{pmatrix} = 0", "an entry that is empty or a matrix"),
        (rf"\begin{{pmatrix}} {PAIR} \end{{pmatrix}} = 0", "an answer has a matrix that is not read"),
        (r"\begin{pmatrix} x & x \\ x & x \end{pmatrix}" * 12 + PAIR, "the product of matrices is too long"),
    ],
)
def test_matrices_that_do_not_fit_are_told(text: str, said: str) -> None:
    assert said in refusal(reader().equations, text)


SCRAPS = (
    *("per k", "by m", "of x", "und g", "and x", "with friction g x'", "mit Reibung mu g", "// m", "friction", "F_x"),
    *("for x", "geteilt durch k", ", minus g x", "+ drag", "squared", "- E_kin", "(friction g x')", "= g F_T", ", k x"),
    *(r"\text{ squared }", ", with friction g l", "\nM theta'' = F_R R", "\n+ F_1 + F_2", "mod k", "hence x", "[F_x]"),
)
"""Scraps after a right equation, each of which may be mathematics."""


@pytest.mark.parametrize("scrap", SCRAPS)
def test_no_scrap_of_mathematics_is_a_remark(scrap: str) -> None:
    with pytest.raises(StatementError, match=r"is not a symbol|cannot stand here|a value is missing|mod takes 2"):
        reader().equations(f"x'' = -k x/m {scrap}")


@pytest.mark.parametrize("text", ["not x'' = -k x/m", "mass x'' = -k x", "two x'' = -k x/m"])
def test_words_before_an_equation_end_with_a_connecting_one(text: str) -> None:
    with pytest.raises(StatementError, match=f"'{text.split(maxsplit=1)[0]}' is not a symbol"):
        reader().equations(text)


@pytest.mark.parametrize("text", REMARKS)
def test_remarks_belong_to_no_equation(text: str) -> None:
    equations = [one for one in reader().equations(text) if not one.aside]
    assert [one.readings[0].read for one in equations] == REMARKS[text]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("m x'' = -k x mu", "mu"),
        ("mass x'' = -k x", "mass"),
        ("x'' = -g/l (sin thta)", "thta"),
        ("l tehta'' + g x = 0\nx'' = 0", "tehta"),
        ("x'' = 0\nc*theta_dot = 0", "c"),
        ("x'' = -k (x) (foo + x)", "foo"),
        ("m x'' = -k x Newton's law", "Newton\u02bcs"),
    ],
)
def test_an_unknown_factor_is_no_remark(text: str, word: str) -> None:
    with pytest.raises(StatementError, match=f"'{word}' is not a symbol of this system"):
        reader().equations(text)


def test_a_name_that_is_a_factor_of_both_sides_is_read_as_one() -> None:
    """The radius of a pulley cancels; a name that does not, or that only one term has, is a fault."""
    (equation,) = reader().equations("(m g - m x'') r = 1/2 M r^2 x''/r")
    m, M, g, a = sp.symbols("m M g x_ddot", real=True)
    assert sp.expand(equation.readings[0].zero - (m * g - m * a - M * a / 2)) == 0
    for text in ("(m g - m x'') r = 1/2 M r^2 x''", "r x'' = 0"):
        with pytest.raises(StatementError, match="'r' is not a symbol of this system"):
            reader().equations(text)


def test_derivatives_of_expressions_are_taken_along_the_motion() -> None:
    (equation,) = reader().equations("d/dt(m x^2 theta') + d/dt(sin x)")
    m, x, v, w, a = sp.symbols("m x x_dot theta_dot theta_ddot", real=True)
    assert sp.expand(equation.readings[0].zero - (2 * m * x * v * w + m * x**2 * a + sp.cos(x) * v)) == 0


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("thetaa' + foo = x", ["column 1: 'thetaa'", "Did you mean 'theta'?", "column 11: 'foo'"]),
        ("x + l3", ["'l3' is not a symbol of this system. For a power write l^3."]),
        ("m (x + l", ["column 3: '(' is never closed"]),
        ("x) + m", ["column 2: ')' closes nothing"]),
        ("m'' = x", ["'m' has no derivative of this order here"]),
        (
            "m x'' = m x - q",
            ["column 15: 'q' is not", "Before the first fault it is read as m*x_ddot = m*x. The symbols"],
        ),
        ("x''' = 0", ["'x' has no derivative of this order here"]),
        (r"x + \frac{d}{dt", ["'{' is never closed"]),
        (r"\ddot\psi + x", ["column 1: 'psi' is not a symbol of this system. The symbols"]),
        (r"\foo x", [r"column 1: the LaTeX command \foo is not known here"]),
        ("x\x1b = 0", ["the character U+001B (control character) cannot stand in an equation"]),
        ("x + = 0", ["a value is missing"]),
        ("m(x'') = l x') = -k x", ["column 14: ')' closes nothing"]),
        ("x = ", ["nothing stands right of the sign of equality"]),
        (
            "2 sin",
            ["has no symbol of this system. An answer is an equation such as theta'' = ... The symbols are theta, "],
        ),
        ("d/dt(x'') = 0", ["the time derivative of x_ddot is in no equation of motion"]),
        ("x**1001 + 2 x", ["the exponent 1001 is out of bounds"]),
    ],
)
def test_refusals_have_all_faults_with_their_places(text: str, parts: list[str]) -> None:
    with pytest.raises(StatementError) as refusal:
        reader().equations(text)
    message = str(refusal.value)
    assert all(part in message for part in parts), message
    assert len(message) <= 400 and message.isprintable()


@pytest.mark.parametrize("word", ["m_g", "xdotdotdot", "ddot", "mQ"])
def test_no_hint_offers_another_derivative_or_drops_a_factor(word: str) -> None:
    assert "Did you mean" not in refusal(reader().equations, f"{word} + x = 0")


PIECES = (
    *("\\frac", "\\dot", "{", "}", "(", ")", "'", "^", "_", "\\", "&", "\\\\", "\n", "=", "sin", "cos^2", "θ", "̈", "½"),
    *("√", "|", "d", "dt", "/", "9" * 50, "__import__('os')", "lambda", "if", ":", ";", "\x00", "\u202e", "0**0"),
    *(
        "9**9**9**9",
        "1/0",
        "exp(exp(exp(9)))",
        "mgl",
        "⁻¹",
        "\\mathrm{a b}",
        "(" * 50,
        "{" * 300,
        "sin " * 30,
        "x",
        "''",
    ),
)


def test_random_texts_are_read_or_refused() -> None:
    """No text raises anything but a refusal of at most 400 printable characters."""
    dice, typed = random.Random(1), reader()
    for _ in range(400):
        text = "".join(dice.choice(PIECES) + dice.choice(("", " ")) for _ in range(dice.randrange(1, 25)))
        refusal = refused(typed, text)
        assert len(refusal) <= 400 and (refusal.isprintable() or not refusal), text


def refused(typed: TypedReader, text: str) -> str:
    """Return the message of a refusal, "" for a text that is read."""
    try:
        typed.equations(text)
    except LagrangeError as refusal:
        return str(refusal)
    return ""


def test_a_long_text_is_refused_before_it_is_read() -> None:
    with pytest.raises(StatementError, match=r"^line 1 has 30000 characters, and 8000 are the most of an equation."):
        reader().equations("x" * 30_000)
    with pytest.raises(StatementError, match=r"^the text has 70000 characters, and an answer may have 60000"):
        reader().equations("x'' = 0\n" * 8_750)


ENDLESS = {
    "units": ("theta'' = 0 " + "3 g- " * 60 + "!", "the number 3 follows a number without a sign"),
    "fractions": ("x = " + r"\frac{1}{" * 100 + "x" + "}" * 100, "more than 40 brackets, functions or exponents"),
    "commands": ("x = " + r"\frac" * 900, "a value is missing before '/'"),
    "functions": ("theta'' = " + "sin " * 900 + "x", "more than 40 brackets, functions or exponents"),
    "exponents": ("x = " + "e^" * 900, "more than 40 brackets, functions or exponents"),
    "dots": (r"\dot{" * 900 + "x" + "}" * 900, "a mark follows no symbol"),
    "brackets": ("x = " + "(" * 1000 + "x" + ")" * 1000, "more than 40 brackets, functions or exponents"),
    "derivatives": ("diff(" * 600 + "x" + ", t)" * 600, "'diff' is not a symbol"),
    "blanks": ("x" + " " * 50_000 + "x", "are the most of an equation"),
}
"""Texts on which a reader without bounds does not end, or recurses too deeply, and a part of each refusal."""


@pytest.mark.parametrize("name", ENDLESS)
def test_long_and_deep_texts_are_refused(name: str) -> None:
    text, said = ENDLESS[name]
    with pytest.raises(StatementError) as refusal:
        reader().equations(text)
    assert said in str(refusal.value) and len(str(refusal.value)) <= 400
