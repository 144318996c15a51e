"""The meaning of expressions given as text, and refused expressions."""

import math
import tempfile
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from lagrange.errors import SceneError
from lagrange.statement.coordinate import coordinate, t, velocity_of
from lagrange.statement.scene.expressions import number_from_text, read_expression, read_number
from lagrange.statement.scene.guard import CHUNK, Guard, RefusalError, replaced
from lagrange.statement.scene.library import LIBRARY
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.statement import Statement
from lagrange.statement.vocabulary.functions import ALIASES, WORDS
from tests.covering import examples
from tests.graph.trees import KINKED, SMOOTH, SYMBOLS, Forms, expressions

x, y = coordinate("x"), coordinate("y")
v = velocity_of(x)
ODD = ["E", "S", "N", "I", "Q", "O", "gamma", "beta", "zeta", "lamda", "pi_0", "m2"]
PARAMETERS = {name: sympy.Symbol(name, real=True) for name in ["m", "g", "k", *ODD]}
NAMES: dict[str, Any] = {"x": x, "y": y, "x_dot": v, **PARAMETERS}
m, g, k = (PARAMETERS[name] for name in ("m", "g", "k"))


half = sympy.Rational(1, 2)


MEANINGS = {
    "x": x,
    "m*x_dot**2/2 - m*g*x": m * v**2 / 2 - m * g * x,
    "-x**2": -(x**2),
    "2**3**2": sympy.Integer(512),
    "2**-1*x": x / 2,
    "x**0.5": sympy.sqrt(x),
    "1e-3*x": sympy.Float(0.001) * x,
    "sqrt(2)/2": sympy.sqrt(2) / 2,
    "sin(pi/6)": half,
    "cos(x)*tan(y) + atan2(y, x)": sympy.cos(x) * sympy.tan(y) + sympy.atan2(y, x),
    "ln(m) + log(k)": sympy.log(m) + sympy.log(k),
    "abs(x) + Abs(y)": sympy.Abs(x) + sympy.Abs(y),
    "min(x, y, 1) + Max(x, 2)": sympy.Min(x, y, 1) + sympy.Max(x, 2),
    "E*I + S*N*gamma + beta - Q/O": PARAMETERS["E"] * PARAMETERS["I"]
    + PARAMETERS["S"] * PARAMETERS["N"] * PARAMETERS["gamma"]
    + PARAMETERS["beta"]
    - PARAMETERS["Q"] / PARAMETERS["O"],
    "sin(\n  x\t)": sympy.sin(x),
    "\n  x\n  + y": x + y,
    "x if y < 1 else 2": sympy.Piecewise((x, y < 1), (2, True)),
    "x if y >= m else 2 if y > g else 3": sympy.Piecewise((x, y >= m), (2, y > g), (3, True), evaluate=False),
    "x if 0 < y <= 1 else 0": sympy.Piecewise((x, sympy.And(y > 0, y <= 1)), (0, True)),
    "x if x == y else m if x != 1 else k": sympy.Piecewise((x, sympy.Eq(x, y)), (m, sympy.Ne(x, 1)), (k, True)),
    "x if 0 < x < 1 or not (y < 2 and x > y) else 0": sympy.Piecewise(
        (x, sympy.Or(sympy.And(x > 0, x < 1), sympy.Not(sympy.And(y < 2, x > y)))), (0, True)
    ),
    "x if x < 1 else x if y < 2 else y": sympy.Piecewise((x, sympy.Or(x < 1, y < 2)), (y, True)),
    "2*(x if x < 0 else -x) + 1": 2 * sympy.Piecewise((x, x < 0), (-x, True)) + 1,
    "1 if 1 < 2 else x": sympy.Integer(1),
    "sqrt(2) if 2 < 1 else sqrt(3)": sympy.sqrt(3),
}


@pytest.mark.parametrize("text", MEANINGS)
def test_a_text_means_what_it_says(text: str) -> None:
    assert read_expression(text, NAMES) == MEANINGS[text]


def test_coordinates_are_real_numbers() -> None:
    # SymPy alone does not take x(t) for real, and would leave the root, or ask for its real part.
    assert read_expression("sqrt(x**2)", NAMES) == sympy.Abs(x)
    assert read_expression("abs(exp(x))", NAMES) == sympy.exp(x)
    assert read_expression("abs(x)**2", NAMES) == x**2


def test_a_part_that_sympy_cannot_prove_real_stays_as_it_is_written() -> None:
    result = read_expression("abs(exp(sqrt(x)))", NAMES)
    assert result == sympy.Abs(sympy.exp(sympy.sqrt(x)), evaluate=False)


def test_names_stand_for_any_sympy_object() -> None:
    positive = sympy.Symbol("q", positive=True)
    names = {"a": positive, "b": sympy.Integer(3), "q": sympy.Symbol("a", real=True), "c": sympy.Symbol("c")}
    assert read_expression("sqrt(a**2)*b + q*c", names) == 3 * positive + names["q"] * names["c"]


def test_t_and_pi_are_what_they_are() -> None:
    assert read_expression("t*pi", {"t": x, "pi": y}) == t * sympy.pi


@pytest.mark.parametrize("word", WORDS.values(), ids=WORDS)
def test_every_function_is_built(word: Any) -> None:
    arguments = ["x", "y"][: word.fewest]
    expected = word.build(*(NAMES[name] for name in arguments))
    for name in [word.name, *(alias for alias, name in ALIASES.items() if name == word.name)]:
        assert read_expression(f"{name}({', '.join(arguments)})", NAMES) == expected


def test_every_function_is_computed_for_constants_too() -> None:
    for name, word in WORDS.items():
        given = ["13/10" if name == "acosh" else "3/10", "4/10"][: word.fewest]
        value = read_number(f"{name}({', '.join(given)})")
        assert value == pytest.approx(float(word.build(*map(sympy.Rational, given))), rel=1e-15)


# --- numbers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [("2", 2), ("2.0", 2), ("0.5", half), ("0.0625", half**4), ("0", 0), ("0.0", 0), ("0e5", 0), ("1e3", 1000)],
)
def test_short_fractions_are_exact(text: str, value: Any) -> None:
    assert number_from_text(text) == value
    assert isinstance(number_from_text(text), sympy.Rational)


@given(st.floats(min_value=0, allow_infinity=False, allow_nan=False))
def test_a_number_is_the_double_it_says(value: float) -> None:
    assert float(number_from_text(repr(value))) == value
    assert Fraction(float(number_from_text(repr(value)))) == Fraction(value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("pi/6", math.pi / 6),
        ("-2*pi*0.1", -0.2 * math.pi),
        ("6.02214076e23", 6.02214076e23),
        ("7850*4/3*pi*0.01**3", 7850 * 4 / 3 * math.pi * 0.01**3),
        ("1 if 1 < 2 else 3", 1.0),
    ],
)
def test_constants_are_numbers(text: str, value: float) -> None:
    result = read_number(text)
    assert type(result) is float
    assert result == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("name", ["x", "t", "g"])
def test_a_constant_holds_no_names(name: str) -> None:
    with pytest.raises(
        SceneError, match=f"'{name}' is not allowed in a constant: write numbers, pi and functions only"
    ) as e:
        read_number(f"2*{name}")
    assert e.value.column == 3


# --- size ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_long_sums_and_products_read_fast() -> None:
    sums = " + ".join(f"{i}*x**{i % 7}" for i in range(700))
    start = time.process_time()
    assert len(read_expression(sums, NAMES).args) == 7
    assert read_expression("+".join(["x"] * 2000), NAMES) == 2000 * x
    assert read_expression("+".join(["(" + "+".join(["x"] * 400) + ")"] * 12), NAMES) == 4800 * x
    assert read_expression("x if x < 1 else " + "-".join(["2*x"] * 2000), NAMES).args[1].args[0] == -3996 * x
    assert read_expression("*".join(["x"] * 900), NAMES) == x**900
    assert len(read_expression("-".join(f"sin(x+{i})" for i in range(900)), NAMES).args) == 900
    assert time.process_time() - start < 60  # a hang guard: joined two by two, these take minutes


def test_nesting_up_to_the_bound_is_read() -> None:
    text = "x"
    for _ in range(63):
        text = f"sin({text})"
    result = read_expression(text, NAMES)
    for _ in range(63):
        result = result.args[0]
    assert result == x


# --- Bounds on what SymPy is asked to compute ---


a, b = sympy.symbols("a b", real=True)


@pytest.mark.parametrize("build", [sympy.Add, sympy.Mul])
def test_long_chains_are_joined_in_chunks_to_the_same_result(build: Any) -> None:
    parts = [sympy.Symbol(f"s{i % 70}", real=True) ** (i % 3 + 1) for i in range(3 * CHUNK + 7)]
    assert Guard().join(build, parts) == build(*parts)
    assert Guard().join(build, [a, b]) == build(a, b)


def test_coefficients_are_checked_between_chunks() -> None:
    parts = [a / (10**30 + i) for i in range(20 * CHUNK)]
    with pytest.raises(RefusalError, match="longer than 77 digits"):
        Guard().join(sympy.Add, parts)


@pytest.mark.parametrize(
    "expression",
    [
        *(a * b + 2 * b + sympy.Rational(1, 3), sympy.sin(b) * sympy.cos(a) ** 2 / (a + b) ** sympy.Rational(3, 2)),
        *(-2 * (a + b) * b, sympy.Max(a, b, 1) - sympy.Abs(b - a), sympy.atan2(b, a) * sympy.exp(-a)),
        *(sympy.Piecewise((a, a < b), (b, sympy.And(a > 1, b > 2)), (1, True)), a, sympy.pi, sympy.Integer(2)),
    ],
)
def test_replacing_gives_what_sympy_builds(expression: Any) -> None:
    table = {a: y, b: x.dot}  # in the other order: y(t) is sorted after Derivative(x(t), t)
    assert replaced(expression, dict(table)) == expression.xreplace(table)
    assert hash(replaced(expression, dict(table))) == hash(expression.xreplace(table))


def test_replacing_evaluates_nothing() -> None:
    assert replaced(sympy.Abs(a), {a: x}) == sympy.Abs(x)
    assert replaced(sympy.sqrt(a), {a: x**2}) == sympy.Pow(x**2, sympy.Rational(1, 2), evaluate=False)
    assert replaced(a - b, {a: x, b: x}) != 0


# --- random texts ---------------------------------------------------------------------------------------------
# Random expressions, random tokens and random texts: read back equal, or refused.


LEAVES = {"m": m, "x": x, "y": y, "u": v}
"""What the leaves of random expressions stand for in a text: coordinates, and a velocity."""


TOKENS = [
    *("x", "y", "m", "pi", "2", "0.5", "1e9", "sin(", "max(", "(", ")", ",", "+", "-", "*", "/", "**", "<", "=="),
    *("if", "else", "not", "j", ".", "[", "'"),
]


def outcome(text: str, names: dict[str, Any] = NAMES) -> tuple[Any, SceneError | None]:
    """Return the expression of a text, or its refusal."""
    try:
        return read_expression(text, names), None
    except SceneError as refused:
        return None, refused


def assert_same(result: Any, value: Any) -> None:
    """Assert that two expressions are equal, or have equal values if SymPy expands one of them."""
    difference = result.xreplace({leaf: SYMBOLS[name] for name, leaf in LEAVES.items()}) - value
    for shift in (0.3, 0.7) if difference != 0 else ():
        point = {symbol: sympy.Float(shift + 0.1 * i, 30) for i, symbol in enumerate(SYMBOLS.values())}
        assert abs(difference.xreplace(point).evalf(30)) <= 1e-12 * (1 + abs(value.xreplace(point).evalf(30)))


@settings(max_examples=examples(100))
@given(expressions(SMOOTH + KINKED))
def test_what_sympy_prints_reads_back_equal(forms: Forms) -> None:
    value = forms.sympy()
    if value.has(sympy.zoo, sympy.nan, sympy.E):
        return
    result, refused = outcome(str(value), LEAVES)
    if refused is None:
        assert_same(result, value)


@settings(max_examples=examples(300))
@given(st.one_of(st.text(max_size=40), st.lists(st.sampled_from(TOKENS), max_size=14).map(" ".join)))
def test_any_text_is_read_or_refused(text: str) -> None:
    result, refused = outcome(text)
    if refused is None:
        assert isinstance(result, sympy.Expr)
    else:
        assert refused.column is not None
        assert 1 <= refused.column <= len(text) + 1


# --- Scenes damaged at random: read, or refused with a place ---


TEXTS = [path.read_text("utf-8") for path in sorted(LIBRARY.glob("*.toml")) if path.stat().st_size < 2000]
PIECES = ["\n", "**", "[run]\n", "", *" \"'[]{}=#.,\\1xt()é\x00"]


@settings(max_examples=examples(150))
@given(
    st.sampled_from(TEXTS),
    st.integers(0, 2000),
    st.integers(0, 12),
    st.one_of(st.sampled_from(PIECES), st.text(max_size=6).filter(lambda text: text.isprintable())),
)
def test_a_damaged_scene_is_read_or_refused(text: str, start: int, length: int, piece: str) -> None:
    start %= len(text)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text[:start] + piece + text[start + length :], encoding="utf-8")
        try:
            result: Statement | SceneError = read_scene(path)
        except SceneError as refused:
            result = refused
    if isinstance(result, SceneError):
        assert result.line is not None
        assert result.file == str(path)
        assert result.reason.endswith((".", "?"))


# --- refused expressions: the position and the words of each message -------------------------------------------


def refusal(text: str, names: dict[str, Any] = NAMES) -> tuple[int | None, str]:
    with pytest.raises(SceneError) as caught:
        read_expression(text, names)
    return caught.value.column, caught.value.reason


REFUSALS = {
    # what is misspelt
    "2*thta": (3, "'thta' is not declared: add it to [parameters] or coordinates."),
    "x_dto": (1, "Did you mean 'x_dot'?"),
    "x + gama": (5, "Did you mean 'gamma'?"),
    "cosh(x) + cso(x)": (11, "'cso' is not a function here; the functions are sin, cos, tan,"),
    "2*sin": (3, "'sin' is a function: write sin(...)."),
    "_x": (1, "'_x' cannot be a name: a name starts with a letter"),
    "a" * 65: (1, "at most 64 characters"),
    "lambda": (1, "'lambda' is a reserved word: choose another name."),
    "x and y": (1, "a condition compares two values: write it as in a if x < 0 else b."),
    "x | y": (3, "'|' is not allowed in an expression: write or between two conditions."),
    # what other languages write
    "x^2": (2, "'^' is not allowed in an expression: write ** for a power."),
    "2x": (1, "2x is not a number: write decimals such as 12.5 or 1.5e-3, and a product with *, as in 2*x."),
    "2 x": (3, "an operator is missing before 'x': write a product with *, as in 2*x."),
    "2(x)": (2, "an operator is missing before '(': write a product with *, as in 2*(x + y)."),
    "x//2": (2, "'//' is not allowed in an expression: write / for a division."),
    "x.dot": (2, "the velocity of x is x_dot"),
    "x = 1": (3, "assigns nothing; for an equation or a comparison write =="),
    "x'' + 1": (2, "a prime is not a derivative here: the velocity of x is x_dot, its acceleration x_ddot."),
    "x << 2": (3, "the operators are + - * / ** and the comparisons < <= > >= == !="),
    "9,81": (2, "',' separates the arguments of a function only: write decimals with a point, as in 9.81."),
    "2*é": (3, "the character U+00E9 (LATIN SMALL LETTER E WITH ACUTE) is not allowed in an expression"),
    "e\u0301*2": (2, "'e\u0301' cannot be a name: the character U+0301 (COMBINING ACUTE ACCENT)"),
    "ά": (1, "write letters A to Z, a to z and Greek ones without accents"),
    "x\x00": (2, "the character U+0000 (control character)"),
    "ｐｉ": (1, "U+FF50 (FULLWIDTH LATIN SMALL LETTER P)"),
    # what is not finished
    "": (1, "the expression is empty: write 0 if there is nothing."),
    "x +": (4, "the expression ends where a value is expected."),
    "2*(x + y": (3, "'(' is never closed: add ')'."),
    "x if y < 1": (3, "an 'if' has no 'else': write a condition as in a if x < 0 else b."),
    # numbers
    "2j*x": (1, "2j is a complex number: energies and forces are real."),
    "x + 007": (5, "007 starts with a zero: write the number without it."),
    "1" * 101: (1, "a number of 101 characters is longer than 100: shorten it."),
    "1" * 99: (1, "an exact number here is longer than 77 digits: write a decimal, such as 1.5e100."),
    "x*1e999": (3, "1e999 is too large for a floating-point number."),
    # functions and conditions
    "1 + atan2(x)": (5, "atan2 takes 2 arguments, not 1."),
    "max(" + ",".join("x" * 17) + ")": (1, "max takes 1 to 16 arguments, not 17."),
    "x < y": (1, "a comparison has no value of its own: write a condition as in a if x < 0 else b."),
    "1 if x else 2": (1, "a condition compares two values: write it as in a if x < 0 else b."),
    "1 if (1 if x < 2 else 3) < 2 else 3": (6, "a condition cannot compare a value that has conditions itself."),
    "x" + " if x < 1 else y" * 33: (1, "a condition has at most 32 branches."),
    " or ".join(f"x < {k}" for k in range(65)): (1, "a condition has more than 64 comparisons: state fewer."),
    # what has no value
    "exp(-1000)": (1, "exp(-1000) is too small for a floating-point number."),
    "1e-9**99": (1, "1e-09**99 is too small for a floating-point number."),
    "sqrt(-1)": (1, "sqrt(-1) has no finite real value."),
    "sqrt(2)*x/x": (1, "the names cancel and leave a constant: write the constant."),
    "max(sqrt(-x**2 - 1), 0)": (1, "this part has no finite real value."),
    "(-1 - x**2)**0.5*(-1)**0.5": (18, "-1**0.5 has no finite real value."),
    # what would take too long
    "x" * 10_001: (10_001, "the expression has 10001 characters, more than 10000: state it in parts."),
    "(" * 65 + "x" + ")" * 65: (65, "the expression is nested more than 64 deep: state it in parts."),
    "9**9**9": (1, "the exponent 3.8742e+08 is out of bounds: at most 1000 in size."),
    "exp(y + 10**9*log(2*x))": (1, "the exponent 1e+09 is out of bounds"),
    "7**999": (1, "7**999 is too long for an exact number: write a decimal, such as 1.5e100."),
    "(2*x)**1000": (1, "an exact number here is longer than 77 digits"),
    "tanh(" + "sqrt(1 + " * 6 + "x" + ")" * 7: (1, "the argument of tanh has more than 5 parts that may be complex"),
    "abs(" + "+".join(f"1/(x+{i})" for i in range(99)) + ")": (1, "more than 200 parts in the argument of abs"),
    "x if " + "+".join(f"x**{i}" for i in range(99)) + " < 1 else y": (6, "more than 200 parts in the compared values"),
    "min(" + ",".join(f"sin(x+{i}*y) + cos(x-{i}*m) + k" for i in range(16)) + ")": (
        1,
        "there are more than 200 parts in the arguments of min: write something shorter.",
    ),
}  # fmt: skip


@pytest.mark.parametrize("text", REFUSALS, ids=lambda text: text[:30])
def test_a_refusal_says_where_and_why(text: str) -> None:
    column, reason = REFUSALS[text]
    result = refusal(text)
    assert result[0] == column
    assert reason in result[1]


def test_min_and_max_flatten_within_bounds() -> None:
    inner = ",".join(f"x*{i}" for i in range(15))
    assert "min and max take at most 16 arguments" in refusal(f"max(max({inner}),y,m,g,k)")[1]


@pytest.mark.parametrize("value", [None, 1, b"x", ["x"], x])
def test_only_a_text_is_read(value: Any) -> None:
    with pytest.raises(SceneError, match="an expression must be a text such as"):
        read_expression(value, NAMES)


def test_what_nests_too_deeply_for_python_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lagrange.statement.scene.expressions.DEEPEST_NESTING", 10_000)
    assert refusal("(" * 2000 + "x" + ")" * 2000)[1].startswith("the expression is nested too deeply")


def test_no_warning_is_shown() -> None:
    assert refusal("1if x < 2 else 3")[0] == 1


def test_columns_count_letters() -> None:
    with pytest.raises(SceneError) as caught:
        read_expression("θ*Ω + 2.5*log(0)", {"θ": x, "Ω": y})
    assert caught.value.column == 11
    assert read_expression("θ*Ω + 2.5*θ", {"θ": x, "Ω": y}) == x * y + 5 * x / 2
