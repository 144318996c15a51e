"""Refused expressions: the position and the words of each message."""

from __future__ import annotations

from typing import Any

import pytest

from lagrange.errors import SceneError
from lagrange.statement.scene.expressions import read_expression
from tests.statement.names import NAMES, x, y


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
    "x and y": (3, "'and' is a reserved word: chain comparisons, as in 0 < x < 1."),
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
    "x if 0<x<1 else " * 5 + "y": (1, "more than 4 chained comparisons in a row have the same value."),
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
