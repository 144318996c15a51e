"""SymPy in and out: the same value by way of the graph, the same node on the way back, refusals in words."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath
import pytest
import sympy as sp
from hypothesis import given

from lagrange.errors import StatementError
from lagrange.graph.from_sympy import Translator
from lagrange.graph.functions import FUNCTIONS
from lagrange.graph.node import Binding, Graph, Kind, Node
from lagrange.graph.to_sympy import to_sympy
from lagrange.statement.coordinate import coordinate
from lagrange.statement.vocabulary.words import SYMPY_CLASSES
from tests.graph.trees import KINKED, SMOOTH, SYMBOLS, Forms, evaluate, expressions, new_graph

x, y, u, m = (SYMBOLS[name] for name in "xyum")
POINTS = (
    {"m": "1.7", "x": "0.31", "y": "-0.83", "u": "1.21"},
    {"m": "0.4", "x": "-1.9", "y": "0.57", "u": "-0.26"},
)


def translated(expression: Any) -> tuple[Node, dict[str, Node]]:
    graph, symbols = new_graph()
    return Translator(graph, {SYMBOLS[name]: node for name, node in symbols.items()})(expression), symbols


def value(expression: Any, point: dict[str, str]) -> Any:
    node, symbols = translated(expression)
    return evaluate(node, {symbols[name]: mpmath.mpf(text) for name, text in point.items()})


@given(expressions(SMOOTH + KINKED, size=6))
def test_a_translated_expression_keeps_its_value(forms: Forms) -> None:
    expression = forms.sympy()
    with mpmath.workdps(60):
        for point in POINTS:
            expected = forms.value({name: mpmath.mpf(text) for name, text in point.items()})
            assert abs(value(expression, point) - expected) <= mpmath.mpf(10) ** -20 * (1 + abs(expected))


@given(expressions(SMOOTH + KINKED))
def test_there_and_back_keeps_the_value(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    written = to_sympy(node, {symbols[name]: SYMBOLS[name] for name in symbols})
    again = Translator(graph, {SYMBOLS[name]: symbol for name, symbol in symbols.items()})(written)
    with mpmath.workdps(60):
        at = {symbols[name]: mpmath.mpf(text) for name, text in POINTS[0].items()}
        expected = evaluate(node, at)
        assert abs(evaluate(again, at) - expected) <= mpmath.mpf(10) ** -20 * (1 + abs(expected))


SPELLED = {
    sp.sin(x): "sin",
    sp.cos(x): "cos",
    sp.tan(x): "tan",
    sp.asin(x): "asin",
    sp.acos(x): "acos",
    sp.atan(x): "atan",
    sp.atan2(x, y): "atan2",
    sp.exp(x): "exp",
    sp.log(x): "log",
    sp.sinh(x): "sinh",
    sp.cosh(x): "cosh",
    sp.tanh(x): "tanh",
    sp.asinh(x): "asinh",
    sp.acosh(x): "acosh",
    sp.atanh(x): "atanh",
    sp.erf(x): "erf",
    sp.Abs(x): "abs",
    sp.sign(x): "sign",
    sp.Min(x, y): "min",
    sp.Max(x, y): "max",
    x**y: "pow",
    sp.pi: "pi",
    sp.E: "e",
    x < y: "less",
    x <= y: "less_equal",
    sp.Eq(x, y): "equal",
    sp.And(x < y, y < u): "and",
    sp.Or(x < y, y < u): "or",
    sp.Not(sp.Eq(x, y)): "not",
    sp.Piecewise((x, x < y), (y, True)): "piecewise",
}


@pytest.mark.parametrize("expression", SPELLED, ids=str)
def test_every_function_goes_in_and_comes_out_as_itself(expression: Any) -> None:
    node, symbols = translated(expression)
    assert (node.kind, node.data) == (Kind.CALL, SPELLED[expression])
    assert to_sympy(node, {symbols[name]: SYMBOLS[name] for name in symbols}) == expression


def test_the_table_of_spellings_is_complete() -> None:
    assert {*SPELLED.values(), "nan"} == set(FUNCTIONS)
    graph = Graph()
    assert to_sympy(graph.call("nan"), {}) is sp.nan


def test_every_function_that_a_statement_may_use_is_translated() -> None:
    for build in SYMPY_CLASSES - {sp.Piecewise}:
        arguments = (x, y)[: 2 if build in (sp.atan2, sp.Min, sp.Max) else 1]
        translated(build(*arguments))


@pytest.mark.parametrize(
    "expression",
    [
        sp.cot(x),
        sp.sec(x),
        sp.csc(x),
        sp.sinc(x) + sp.sinc(x / 9),
        sp.Heaviside(x) - sp.Heaviside(-y, 0),
        sp.sqrt(x**2 + 1) / (x - y) ** 3,
        x**-2 + 2**x,
        (1 + x**2) ** sp.Rational(-7, 3),
        sp.Piecewise((x, sp.Or(x > 1, sp.And(x < 0, y < 0))), (y, sp.Ne(x, y)), (u, True)),
        sp.Piecewise((sp.log(x), x > 0), (0, True)),
        sp.Max(x, y, u, 1) - sp.Min(x, y, u, 0),
        sp.Rational(1, 10) * x + sp.Rational(1, 3) * y + sp.pi * u - sp.E,
        sp.Mod(7, 4) * x,
        sp.Piecewise((x, sp.Piecewise((y, x > 0), (u, True)) > 1), (y, True)),
        sp.Piecewise((x, sp.Piecewise((y, x > 0), (0, True)) > 1), (y, True)),
    ],
    ids=str,
)
def test_values_of_forms_that_are_spelled_by_others(expression: Any) -> None:
    with mpmath.workdps(40):
        for point in POINTS:
            at = {SYMBOLS[name]: sp.Rational(text) for name, text in point.items()}
            expected = mpmath.mpf(str(sp.N(expression.subs(at), 45)))
            assert abs(value(expression, point) - expected) <= mpmath.mpf(10) ** -30 * (1 + abs(expected))


def test_numbers_come_in_exactly() -> None:
    assert translated(sp.Rational(1, 3))[0].data == Fraction(1, 3)
    assert translated(sp.Float(0.1))[0].data == Fraction(0.1)
    assert translated(sp.Float("-2.5e-3"))[0].data == -Fraction(float("2.5e-3"))
    assert translated(sp.Float(0))[0].data == 0
    assert translated(sp.Float("0.1", 50))[0].data != Fraction(0.1)
    assert isinstance(translated(sp.Integer(7))[0].data, int)
    assert translated(sp.Rational(1, 3) * 3)[0].data == 1


@pytest.mark.parametrize("expression", [sp.true, sp.false])
def test_truth_values_are_one_and_zero(expression: Any) -> None:
    assert translated(expression)[0].data == int(bool(expression))


def test_a_branch_that_never_holds_is_left_out() -> None:
    pair = sp.Piecewise((x, sp.false), (y, x < 1), (u, True), evaluate=False)
    node, symbols = translated(pair)
    assert symbols["x"] not in node.args[1::2] and node.args[-1] is symbols["u"]


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (sp.gamma(x), r"gamma in 'gamma\(x\)' is not supported"),
        (sp.Mod(x, y), r"Mod in 'Mod\(x, y\)' is not supported"),
        (x + sp.I, "ImaginaryUnit in 'I' is not supported"),
        (sp.oo + 0, "contains oo, which is not a finite number"),
        (sp.nan, "contains nan, which is not a finite number"),
        (sp.zoo, "ComplexInfinity in 'zoo' is not supported"),
        (sp.Function("f")(x), r"f\(x\) stands for nothing that this system declares"),
        (coordinate("q"), r"q\(t\) stands for nothing that this system declares"),
        (coordinate("q").dot, r"q\(t\), t\) stands for nothing that this system declares"),
        (sp.Symbol("stranger"), "Symbol in 'stranger' is not supported"),
        (sp.Integral(sp.sin(x), x), "is not supported"),
    ],
)
def test_what_the_graph_has_no_node_for_is_refused(expression: Any, message: str) -> None:
    with pytest.raises(StatementError, match=message):
        translated(expression)


def test_equal_subexpressions_become_one_node() -> None:
    node, _ = translated(sp.sin(x + y) ** 2 + sp.cos(x + y) * sp.sin(x + y))
    sines = [other for other in node.graph.nodes if other.kind is Kind.CALL and other.data == "sin"]
    assert len(sines) == 1


def test_a_solution_of_up_to_four_unknowns_is_written_out() -> None:
    graph = Graph()
    a, b, c, d, e = symbols = [graph.symbol(name, Binding.CONFIGURATION) for name in "abcde"]
    unknowns = graph.solve([[a, b], [b, c]], [d, e])
    table = {node: sp.Symbol(node.data) for node in symbols}
    matrix = sp.Matrix([[table[a], table[b]], [table[b], table[c]]])
    solution = sp.Matrix([to_sympy(unknown, table) for unknown in unknowns])
    assert (matrix * solution - sp.Matrix([table[d], table[e]])).applyfunc(sp.simplify) == sp.zeros(2, 1)
    many = graph.solve([[a if i == j else b for j in range(5)] for i in range(5)], symbols)
    with pytest.raises(StatementError, match="the solution of 5 coupled equations is too large to write out"):
        to_sympy(many[0], table)
