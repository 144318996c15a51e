"""The meaning of expressions given as text."""

from __future__ import annotations

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
from lagrange.statement.coordinate import t
from lagrange.statement.scene.expressions import number_from_text, read_expression, read_number
from lagrange.statement.scene.guard import CHUNK, Guard, RefusalError, replaced
from lagrange.statement.scene.library import LIBRARY
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.statement import Statement
from lagrange.statement.vocabulary.functions import ALIASES, WORDS
from tests.covering import examples
from tests.graph.trees import KINKED, SMOOTH, SYMBOLS, Forms, expressions
from tests.statement.names import NAMES, PARAMETERS, g, k, m, v, x, y

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
