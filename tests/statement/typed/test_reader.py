"""Equations as people type them: what is read, in which of two ways, and what is refused with all its faults."""

import random
from pathlib import Path

import pytest
import sympy as sp

from lagrange.errors import LagrangeError, StatementError
from lagrange.statement.typed.reader import TypedReader
from tests.covering import Share
from tests.refusals import refusal

NAMES = ("m", "m1", "m2", "g", "l", "l1", "k", "M", "R", "omega", "mu_s")
COORDINATES = ("theta", "theta1", "x", "x_block")


def reader(*extra: str) -> TypedReader:
    rates = [f"{q}{ending}" for q in COORDINATES for ending in ("", "_dot", "_ddot")]
    names = (*rates, *NAMES, "lambda_rod", *extra)
    return TypedReader({name: sp.Symbol(name, real=True) for name in names}, {"lambda": "lambda_rod"})


READINGS = Path(__file__).with_name("readings.txt").read_text("utf-8").splitlines()[1:]
"""Typed texts and the equations that are read from them, one text a line."""


@pytest.mark.parametrize("line", READINGS)
def test_what_is_typed_is_read(line: str) -> None:
    """Lines are joined, labels and remarks left out, definitions used, and rows of vectors taken apart."""
    text, *equations = line.split("\t")
    result = [item for item in reader().equations(text.replace("⏎", "\n")) if not item.aside]
    assert [item.read for item in result] == equations


@pytest.mark.parametrize(
    ("text", "readings"),
    [
        ("g/2l", ["g/(2*l)", "g/2*l"]),
        ("d/dt m l^2 theta'", ["d/dt(m*l**2*theta_dot)", "d/dt(m)*l**2*theta_dot"]),
        ("d/dt (m l^2) theta'", ["d/dt(m*l**2)*theta_dot", "d/dt(m*l**2*theta_dot)"]),
        ("sin theta^2", ["sin(theta**2)", "sin(theta)**2"]),
        ("g/(m l)(x - theta)", ["g/(m*l)*(x - theta)", "g/(m*l*(x - theta))"]),
        ("cos omega/(m + M)", ["cos(omega)/(m + M)", "cos(omega/(m + M))"]),
    ],
)
def test_of_two_readings_both_are_returned(text: str, readings: list[str]) -> None:
    (equation,) = reader().equations(text)
    assert [item.read for item in (equation, *equation.others)] == readings


def test_a_constant_angle_is_the_whole_argument_of_a_function() -> None:
    (equation,) = reader("alpha").equations("sin alpha x'")
    assert [item.read for item in (equation, *equation.others)] == ["sin(alpha)*x_dot", "sin(alpha*x_dot)"]


def test_a_word_is_the_symbol_of_that_name_before_it_is_a_product() -> None:
    (equation,) = reader().equations("l1 t")
    assert [item.read for item in (equation, *equation.others)] == ["l1*t"]
    (equation,) = reader("ml").equations("ml x''")
    assert [item.read for item in (equation, *equation.others)] == ["ml*x_ddot"]
    (equation,) = reader("d").equations("dx")
    assert [item.read for item in (equation, *equation.others)] == ["x_dot", "d*x"]


PAIR = r"\begin{pmatrix} x \\ \theta \end{pmatrix}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (r"\begin{pmatrix} x \end{vmatrix} = 0", "an answer has a matrix in an unknown notation"),
        (rf"{PAIR} = \begin{{pmatrix}} x \\ x \\ x \end{{pmatrix}}", "a column has 3 rows, and the column before it 2"),
        (r"\begin{pmatrix} x & m \end{pmatrix} = 0", "column 1: matrices that do not fit: expected is a column"),
        (rf"{PAIR}^2 = 0", "a column has no powers"),
        (r"\begin{pmatrix} x \\ & m \end{pmatrix} = 0", "an entry that is empty or a matrix"),
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
    assert f"'{text.split(maxsplit=1)[0]}' is not a symbol" in refusal(reader().equations, text)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("m x'' = -k x mu", "mu"),
        ("l tehta'' + g x = 0\nx'' = 0", "tehta"),
        ("x'' = 0\nc*theta_dot = 0", "c"),
        ("m x'' = -k x Newton's law", "Newton\u02bcs"),
    ],
)
def test_an_unknown_factor_is_no_remark(text: str, word: str) -> None:
    assert f"'{word}' is not a symbol of this system" in refusal(reader().equations, text)


def test_a_name_that_is_a_factor_of_both_sides_is_read_as_one() -> None:
    """The radius of a pulley cancels; a name that does not, or that only one term has, is a fault."""
    (equation,) = reader().equations("(m g - m x'') r = 1/2 M r^2 x''/r")
    m, M, g, a = sp.symbols("m M g x_ddot", real=True)
    assert sp.expand(equation.zero - (m * g - m * a - M * a / 2)) == 0
    for text in ("(m g - m x'') r = 1/2 M r^2 x''", "r x'' = 0"):
        assert "'r' is not a symbol of this system" in refusal(reader().equations, text)


def test_derivatives_of_expressions_are_taken_along_the_motion() -> None:
    (equation,) = reader().equations("d/dt(m x^2 theta') + d/dt(sin x)")
    m, x, v, w, a = sp.symbols("m x x_dot theta_dot theta_ddot", real=True)
    assert sp.expand(equation.zero - (2 * m * x * v * w + m * x**2 * a + sp.cos(x) * v)) == 0


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("thetaa' + foo = x", ["column 1: 'thetaa'", "Did you mean 'theta'?", "column 11: 'foo'"]),
        ("x + l3", ["'l3' is not a symbol of this system. For a power write l^3."]),
        ("x) + m", ["column 2: ')' closes nothing"]),
        ("m'' = x", ["'m' has no derivative of this order here"]),
        ("m x'' = m x - q", ["column 15: 'q'", "Before the first fault it is read as m*x_ddot = m*x. The symbols"]),
        (r"x + \frac{d}{dt", ["'{' is never closed"]),
        (r"\foo x", [r"column 1: the LaTeX command \foo is not known here"]),
        ("x\x1b = 0", ["the character U+001B (control character) cannot stand in an equation"]),
        ("m(x'') = l x') = -k x", ["column 14: ')' closes nothing"]),
        ("x = ", ["nothing stands right of the sign of equality"]),
        ("2 sin", ["has no symbol of this system. An answer is an equation such as theta'' = ... The symbols are"]),
        ("d/dt(x'') = 0", ["equations of motion do not contain the time derivative of x_ddot: write the equation"]),
        ("x**1001 + 2 x", ["the exponent 1001 is out of bounds"]),
        ("x'' = Piecewise((x, x > 0))", ["the cases do not say what holds elsewhere: end with (value, True), or"]),
        ("x'' = Piecewise((x, 0 < x < l), (0, x > l))", ["the cases do not say what holds elsewhere"]),
        ("x'' = Piecewise((x, x > 0 and), (0, True))", ["column 30: a value is missing before ')'"]),
        ("x'' = Piecewise((x, theta), (0, True))", ["column 26: '<' or '<=' or '>' or '>=' is expected"]),
    ],
)
def test_refusals_have_all_faults_with_their_places(text: str, parts: list[str]) -> None:
    message = refusal(reader().equations, text)
    assert all(part in message for part in parts), message
    assert len(message) <= 400 and message.isprintable()


@pytest.mark.parametrize("word", ["m_g", "xdotdotdot", "ddot", "mQ"])
def test_no_hint_offers_another_derivative_or_drops_a_factor(word: str) -> None:
    assert "Did you mean" not in refusal(reader().equations, f"{word} + x = 0")


PIECES = (
    *("\\frac", "\\dot", "{", "}", "(", ")", "'", "^", "_", "\\", "&", "\\\\", "\n", "=", "sin", "cos^2", "θ", "̈", "½"),
    *("√", "|", "d", "dt", "/", "9" * 50, "__import__('os')", "lambda", "if", ":", ";", "\x00", "\u202e", "0**0"),
    *("9**9**9**9", "1/0", "exp(exp(exp(9)))", "mgl", "⁻¹", "\\mathrm{a b}", "(" * 50, "{" * 300, "sin " * 30),
    *("x", "''", "x'' = Piecewise((", ", ", "), (", ", True))", " and ", " or ", "not ", "And(", "<", ">=", "&", "||"),
)


def test_random_texts_are_read_or_refused(share: Share) -> None:
    """No text raises anything but a refusal of at most 400 printable characters."""
    dice, typed = random.Random(1), reader()
    for _ in range(share(400)):
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
    assert refusal(reader().equations, "x" * 30_000).startswith("line 1 has 30000 characters, more than the 8")
    with pytest.raises(StatementError, match=r"^the text has 70000 characters, and an answer may have 60000"):
        reader().equations("x'' = 0\n" * 8_750)


ENDLESS = {
    "units": ("theta'' = 0 " + "3 g- " * 60 + "!", "the number 3 follows a number without a sign"),
    "fractions": ("x = " + r"\frac{1}{" * 100 + "x" + "}" * 100, "more than 40 brackets, functions or exponents"),
    "commands": ("x = " + r"\frac" * 900, "more than 40 brackets, functions or exponents"),
    "functions": ("theta'' = " + "sin " * 900 + "x", "more than 40 brackets, functions or exponents"),
    "exponents": ("x = " + "e^" * 500, "more than 40 brackets, functions or exponents"),
    "dots": (r"\dot{" * 400 + "x" + "}" * 400, "a prime, a dot or an exponent has no symbol"),
    "brackets": ("x = " + "(" * 1000 + "x" + ")" * 1000, "more than 40 brackets, functions or exponents"),
    "derivatives": ("diff(" * 600 + "x" + ", t)" * 600, "'diff' is not a symbol"),
    "conditions": ("x'' = Piecewise((" + "(" * 900 + "x < l" + ")" * 900 + ", x))", "more than 40 brackets"),
    "comparisons": ("x'' = Piecewise((x, " + "x < l and " * 9 + "x < l), (0, True))", "more than 8 comparisons"),
    "opposites": ("x'' = Piecewise((x, not (" + "x < l < m or " * 3 + "m < x < M)), (0, True))", "more than 8 compar"),
    "open cases": ("x'' = Piecewise(" + "(x, x < l < m), " * 30 + "(0, m > M))", "do not say what holds elsewhere"),
    "blanks": ("x" + " " * 50_000 + "x", "of an equation: shorten it"),
}
"""Texts on which a reader without bounds does not end, or recurses too deeply, and a part of each refusal."""


@pytest.mark.few(4)
@pytest.mark.parametrize("name", ENDLESS)
def test_long_and_deep_texts_are_refused(name: str) -> None:
    text, said = ENDLESS[name]
    message = refusal(reader().equations, text)
    assert said in message and len(message) <= 400
