"""Random expressions, random tokens and random texts: read back equal, or refused."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from lagrange.errors import SceneError
from lagrange.statement.coordinate import t
from lagrange.statement.scene.expressions import read_expression
from lagrange.statement.scene.library import LIBRARY
from lagrange.statement.scene.scene_reader import read_scene
from lagrange.statement.statement import Statement
from lagrange.statement.vocabulary.words import WORDS
from tests.covering import examples
from tests.statement.names import NAMES

Pair = tuple[str, Any]
REAL: dict[str, Any] = {name: sympy.Symbol(name, real=True) for name in ("x", "y", "x_dot", "m", "g", "E", "N", "t")}
STAND_FOR = {REAL[name]: NAMES.get(name, t) for name in REAL}


TOKENS = [
    *("x", "y", "m", "pi", "2", "0.5", "1e9", "sin(", "max(", "(", ")", ",", "+", "-", "*", "/", "**", "<", "=="),
    *("if", "else", "not", "j", ".", "[", "'"),
]


def outcome(text: str) -> tuple[Any, SceneError | None]:
    """Return the expression of a text, or its refusal."""
    try:
        return read_expression(text, NAMES), None
    except SceneError as refused:
        return None, refused


def leaf() -> st.SearchStrategy[Pair]:
    names = st.sampled_from(sorted(REAL)).map(lambda name: (name, REAL[name]))
    whole = st.integers(0, 50).map(lambda n: (str(n), sympy.Integer(n)))
    halves = st.integers(1, 99).map(lambda n: (str(n / 4), sympy.Rational(n, 4)))
    return st.one_of(names, names, whole, halves, st.just(("pi", sympy.pi)))


def larger(inner: st.SearchStrategy[Pair]) -> st.SearchStrategy[Pair]:
    def sign(a: Pair) -> Pair:
        return f"-({a[0]})", -a[1]

    def addition(parts: list[Pair]) -> Pair:
        return " + ".join(f"({text})" for text, _ in parts), sympy.Add(*(value for _, value in parts))

    def difference(a: Pair, b: Pair) -> Pair:
        return f"{a[0]} - ({b[0]})", a[1] - b[1]

    def product(parts: list[Pair]) -> Pair:
        return "*".join(f"({text})" for text, _ in parts), sympy.Mul(*(value for _, value in parts))

    def quotient(a: Pair, b: Pair) -> Pair:
        return f"({a[0]})/(2 + ({b[0]})**2)", a[1] / (2 + b[1] ** 2)

    def power(a: Pair, n: int) -> Pair:
        return f"({a[0]})**{n}", a[1] ** n

    def call(name: str, a: Pair) -> Pair:
        return f"{name}({a[0]})", WORDS[name].build(a[1])

    def choice(a: Pair, b: Pair, limit: int) -> Pair:
        return f"(({a[0]}) if x < {limit} else ({b[0]}))", sympy.Piecewise((a[1], REAL["x"] < limit), (b[1], True))

    return st.one_of(
        st.builds(sign, inner),
        st.builds(addition, st.lists(inner, min_size=2, max_size=4)),
        st.builds(difference, inner, inner),
        st.builds(product, st.lists(inner, min_size=2, max_size=4)),
        st.builds(quotient, inner, inner),
        st.builds(power, inner, st.integers(2, 4)),
        st.builds(call, st.sampled_from(["sin", "cos", "exp", "atan", "tanh"]), inner),
        st.builds(choice, inner, inner, st.integers(-3, 3)),
    )


def assert_same(result: Any, value: Any) -> None:
    """Assert that two expressions are equal, or have equal values if SymPy expands one of them."""
    difference = result.xreplace({new: old for old, new in STAND_FOR.items()}) - value
    for shift in (0.3, 0.7) if difference != 0 else ():
        point = {symbol: sympy.Float(shift + 0.1 * i, 30) for i, symbol in enumerate(REAL.values())}
        assert abs(difference.xreplace(point).evalf(30)) <= 1e-12 * (1 + abs(value.xreplace(point).evalf(30)))


@settings(max_examples=examples(150))
@given(st.recursive(leaf(), larger, max_leaves=10))
def test_random_expressions_read_back_equal(pair: Pair) -> None:
    text, value = pair
    result, refused = outcome(text)
    if refused is None:
        assert_same(result, value)
    else:  # random constants overflow, and names cancel
        assert any(word in refused.reason for word in ("finite", "constant", "too", "longer", "divides")), refused


@settings(max_examples=examples(100))
@given(st.recursive(leaf(), larger, max_leaves=8))
def test_what_sympy_prints_reads_back_equal(pair: Pair) -> None:
    value = pair[1]
    if value.has(sympy.Piecewise, sympy.zoo, sympy.nan, sympy.E):
        return
    result, refused = outcome(str(value))
    if refused is None:
        assert_same(result, value)


@given(st.text(max_size=40))
def test_any_text_is_read_or_refused(text: str) -> None:
    result, refused = outcome(text)
    if refused is None:
        assert isinstance(result, sympy.Expr)
    else:
        assert refused.column is not None
        assert 1 <= refused.column <= len(text) + 1


@settings(max_examples=examples(300))
@given(st.lists(st.sampled_from(TOKENS), max_size=14))
def test_any_tokens_are_read_or_refused(tokens: list[str]) -> None:
    result, refused = outcome(" ".join(tokens))
    assert isinstance(result, sympy.Expr) if refused is None else refused.column


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
