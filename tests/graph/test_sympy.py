"""Conversion from and to SymPy: equal values, equal nodes after a round trip, and refusals."""

import sys
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import given

from lagrange.errors import StatementError
from lagrange.graph.differentiate import gradient, tangents
from lagrange.graph.evaluate import values
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.graph.sympy_nodes import Translator, to_sympy
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.program.lower import lower
from lagrange.program.program import Program
from lagrange.statement.coordinate import coordinate
from lagrange.statement.vocabulary.functions import CONDITIONS, FUNCTIONS, SYMPY_CLASSES
from tests.graph.trees import KINKED, SMOOTH, SYMBOLS, Forms, evaluate, expressions, new_graph
from tests.refusals import refusal

x, y, u, m = (SYMBOLS[name] for name in "xyum")
POINTS = ({"m": "1.7", "x": "0.31", "y": "-0.83", "u": "1.21"}, {"m": "0.4", "x": "-1.9", "y": "0.57", "u": "-0.26"})


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


SPELLED = (
    {
        getattr(sp, name)(x): name
        for name in ["sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "sinh", "cosh", "tanh"]
    }
    | {getattr(sp, name)(x): name for name in ["asinh", "acosh", "atanh", "erf", "sign"]}
    | {sp.atan2(x, y): "atan2", sp.Abs(x): "abs", sp.Min(x, y): "min", sp.Max(x, y): "max", x**y: "pow"}
    | {sp.pi: "pi", sp.E: "e", x < y: "less", x <= y: "less_equal", sp.Eq(x, y): "equal"}
    | {sp.And(x < y, y < u): "and", sp.Or(x < y, y < u): "or", sp.Not(sp.Eq(x, y)): "not"}
    | {sp.Piecewise((x, x < y), (y, True)): "piecewise"}
)


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
        *(sp.cot(x), sp.sec(x), sp.csc(x), sp.sinc(x) + sp.sinc(x / 9), sp.Heaviside(x) - sp.Heaviside(-y, 0)),
        *(sp.sqrt(x**2 + 1) / (x - y) ** 3, x**-2 + 2**x, (1 + x**2) ** sp.Rational(-7, 3)),
        sp.Piecewise((x, sp.Or(x > 1, sp.And(x < 0, y < 0))), (y, sp.Ne(x, y)), (u, True)),
        *(sp.Piecewise((sp.log(x), x > 0), (0, True)), sp.Max(x, y, u, 1) - sp.Min(x, y, u, 0)),
        *(sp.Rational(1, 10) * x + sp.Rational(1, 3) * y + sp.pi * u - sp.E, sp.Mod(7, 4) * x),
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


@pytest.mark.parametrize(
    ("expression", "number"),
    [
        *((sp.Rational(1, 3), Fraction(1, 3)), (sp.Float(0.1), Fraction(0.1)), (sp.Float(0), 0), (sp.Integer(7), 7)),
        *((sp.Float("-2.5e-3"), -Fraction(float("2.5e-3"))), (sp.true, 1), (sp.false, 0)),
    ],
)
def test_numbers_come_in_exactly(expression: Any, number: Any) -> None:
    result = translated(expression)[0].data
    assert result == number and type(result) is type(number)
    assert translated(sp.Float("0.1", 50))[0].data != Fraction(0.1)


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
        (sp.Function("f")(x), r"f\(x\) is not declared in this system"),
        (coordinate("q"), r"q\(t\) is not declared in this system"),
        (coordinate("q").dot, r"q\(t\), t\) is not declared in this system"),
        (sp.Symbol("stranger"), "Symbol in 'stranger' is not supported"),
    ],
)
def test_what_the_graph_has_no_node_for_is_refused(expression: Any, message: str) -> None:
    with pytest.raises(StatementError, match=message):
        translated(expression)


def test_a_solution_of_up_to_four_unknowns_is_written_out() -> None:
    graph = Graph()
    a, b, c, d, e = symbols = [graph.symbol(name, Binding.CONFIGURATION) for name in "abcde"]
    unknowns = graph.solve([[a, b], [b, c]], [d, e])
    table = {node: sp.Symbol(node.data) for node in symbols}
    matrix = sp.Matrix([[table[a], table[b]], [table[b], table[c]]])
    solution = sp.Matrix([to_sympy(unknown, table) for unknown in unknowns])
    assert (matrix * solution - sp.Matrix([table[d], table[e]])).applyfunc(sp.simplify) == sp.zeros(2, 1)
    many = graph.solve([[a if i == j else b for j in range(5)] for i in range(5)], symbols)
    assert "the solution of 5 coupled equations is too large to write out" in refusal(to_sympy, many[0], table)


# --- differentiate --------------------------------------------------------------------------------------------
# Derivatives: reverse against forward against numerical differentiation, and nothing leaks from untaken branches.


def two(graph: Graph) -> tuple[Node, Node]:
    return graph.symbol("x", Binding.CONFIGURATION), graph.symbol("y", Binding.CONFIGURATION)


def slope(f: Callable[..., Any], at: tuple[Any, ...], i: int) -> Any:
    """Return df/dx_i by central differences with two Richardson steps: error about 1e-36 at 60 digits."""

    def central(h: Any) -> Any:
        moved = [[*at[:i], at[i] + sign * h, *at[i + 1 :]] for sign in (1, -1)]
        return (f(*moved[0]) - f(*moved[1])) / (2 * h)

    h = mpmath.mpf(10) ** -7
    rows = [central(h / 2**k) for k in range(3)]
    finer = [(4 * rows[k + 1] - rows[k]) / 3 for k in range(2)]
    return (16 * finer[1] - finer[0]) / 15


@given(expressions())
def test_gradient_and_tangents_agree_with_numerical_differentiation(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    names = sorted(symbols)
    reverse = gradient(node, [symbols[name] for name in names])
    with mpmath.workdps(60):
        at = tuple(mpmath.mpf(POINTS[0][name]) for name in names)
        values = dict(zip((symbols[name] for name in names), at, strict=True))
        for i, name in enumerate(names):
            expected = slope(lambda *x: forms.value(dict(zip(names, x, strict=True))), at, i)
            forward = tangents([node], {symbols[name]: graph.one})(node)
            for result in (evaluate(reverse[i], values), evaluate(forward, values)):
                assert abs(result - expected) <= mpmath.mpf(10) ** -15 * (1 + abs(expected))


ARGUMENTS: dict[str, tuple[str, ...]] = {
    "asin": ("0.4",),
    "acos": ("-0.3",),
    "acosh": ("1.7",),
    "log": ("2.3",),
    "atan2": ("-0.7", "-1.1"),
    "min": ("0.7", "1.9"),
    "max": ("0.7", "1.9"),
    "pow": ("1.3", "-0.6"),
}
CHOICES = ("min", "max", "piecewise")
ELEMENTARY = [name for name, function in FUNCTIONS.items() if function.partials or function.first]


@pytest.mark.parametrize("swapped", [False, True], ids=["", "swapped"])
@pytest.mark.parametrize("name", ELEMENTARY)
def test_every_rule_of_the_table(name: str, swapped: bool) -> None:
    graph = Graph()
    arity = FUNCTIONS[name].arity
    symbols = two(graph)[:arity]
    texts = ARGUMENTS.get(name, ("-0.8",))
    with mpmath.workdps(60):
        at = tuple(map(mpmath.mpf, texts[::-1] if swapped and name != "pow" else texts))
        node = graph.call(name, *symbols)
        values = dict(zip(symbols, at, strict=True))
        for i, symbol in enumerate(symbols):
            expected = slope(lambda *x: evaluate(node, dict(zip(symbols, x, strict=True))), at, i)
            assert abs(evaluate(gradient(node, [symbol])[0], values) - expected) < 1e-18
            assert abs(evaluate(tangents([node], {symbol: graph.one})(node), values) - expected) < 1e-18


def test_every_function_but_the_conditions_and_constants_has_a_rule_per_argument() -> None:
    for name, function in FUNCTIONS.items():
        if name in CONDITIONS or function.arity == 0 or name in CHOICES:  # choices go branch by branch, see below
            assert not function.partials
        else:
            assert len(function.partials) == function.arity


def derivatives(node: Node, symbol: Node, at: dict[Node, Any]) -> list[Any]:
    graph = node.graph
    outcome = (gradient(node, [symbol])[0], tangents([node], {symbol: graph.one})(node))
    return [evaluate(part, at) for part in outcome]


def test_derivatives_of_long_products_grow_with_their_length() -> None:
    sizes = []
    for length in (100, 200):
        graph = Graph()
        x, y = two(graph)
        factors = [graph.call("cos", graph.sum([(Fraction(1, k + 1), x)])) for k in range(length)]
        whole = graph.product([y, *factors])
        slopes = gradient(whole, (x, y))
        sizes.append(sum(len(node.args) for node in reachable(slopes)))
        point = {x: mpmath.mpf("0.02"), y: mpmath.mpf("1.5")}
        result = values([*slopes, whole], point, mpmath.mp)
        assert result is not None
        by_x, by_y, value = result[0]
        assert mpmath.almosteq(by_y * point[y], value, 1e-13)
        tangent = -sum(mpmath.tan(point[x] / (k + 1)) / (k + 1) for k in range(length))
        assert mpmath.almosteq(by_x, value * tangent, 1e-13)
    assert sizes[1] < 2.2 * sizes[0]


def test_nothing_leaks_from_the_branch_not_taken() -> None:
    graph = Graph()
    x, y = two(graph)
    at_zero = graph.call("equal", x, graph.zero)
    safe = graph.piecewise([(at_zero, y**2)], 1 / x + graph.call("log", x))
    assert derivatives(safe, x, {x: mpmath.mpf(0), y: mpmath.mpf(3)}) == [0, 0]
    assert derivatives(safe, y, {x: mpmath.mpf(0), y: mpmath.mpf(3)}) == [6, 6]
    assert derivatives(safe, x, {x: mpmath.mpf(2), y: mpmath.mpf(3)}) == [0.25, 0.25]
    deep = graph.call("exp", safe * graph.call("sin", safe)) * 3
    assert all(map(mpmath.isfinite, derivatives(deep, y, {x: mpmath.mpf(0), y: mpmath.mpf(3)})))


@pytest.mark.parametrize("name", ["min", "max"])
def test_nothing_leaks_from_the_side_that_min_and_max_drop(name: str) -> None:
    graph = Graph()
    x, y = two(graph)
    sign = 1 if name == "min" else -1
    infinite = sign / x**2  # min(1/x^2, y) at x = 0 is y, max(-1/x^2, y) as well
    for node in (graph.call(name, infinite, y), graph.call(name, y, infinite)):
        # What a division by zero gives on a machine; the reference would stop at it.
        at = {x: mpmath.mpf(0), y: mpmath.mpf(3), infinite: sign * mpmath.inf}
        for part in (gradient(node, [x])[0], tangents([node], {x: graph.one})(node)):
            assert evaluate(part, at | {x**-3: mpmath.inf}) == 0
        assert derivatives(node, y, at) == [1, 1]


def test_the_derivative_is_undefined_where_the_expression_is() -> None:
    graph = Graph()
    x, _ = two(graph)
    bounded = graph.piecewise([(graph.call("less", x, graph.one), x**2)])
    assert derivatives(bounded, x, {x: mpmath.mpf("0.5")}) == [1, 1]
    assert all(mpmath.isnan(part) for part in derivatives(bounded, x, {x: mpmath.mpf(2)}))
    flat = graph.piecewise([(graph.call("less", x, graph.one), graph.constant(4))])
    assert all(mpmath.isnan(part) for part in derivatives(flat, x, {x: mpmath.mpf(2)}))


def test_a_coordinate_may_be_called_nan() -> None:
    graph = Graph()
    x, nan = graph.symbol("x", Binding.CONFIGURATION), graph.symbol("nan", Binding.CONFIGURATION)
    node = graph.piecewise([(graph.call("less", x, graph.zero), x)], nan)
    assert derivatives(node, nan, {x: mpmath.mpf(1), nan: mpmath.mpf(5)}) == [1, 1]


def test_what_does_not_depend_has_the_zero_node_as_its_derivative() -> None:
    graph = Graph()
    x, y = two(graph)
    assert gradient(graph.call("sin", x), [y]) == [graph.zero]
    assert tangents([x * 3], {y: graph.one})(x * 3) is graph.zero
    assert gradient(graph.one, [x]) == [graph.zero]
    assert gradient(graph.call("sign", x) + y, [x, y]) == [graph.zero, graph.one]


def test_derivatives_come_out_simple() -> None:
    graph = Graph()
    x, y = two(graph)
    assert gradient(x * y**2, [x, y]) == [y**2, 2 * (x * y)]
    assert gradient(x ** Fraction(1, 2), [x]) == [x ** Fraction(-1, 2) * Fraction(1, 2)]
    assert tangents([x * y], {x: y})(x * y) is y**2


def test_the_tangent_of_a_solution_solves_again_with_the_same_factors() -> None:
    graph = Graph()
    x, y = two(graph)
    matrix = [[2 + x**2, x * y], [x * y, 3 + graph.call("cos", y)]]
    solution = graph.solve(matrix, [graph.call("sin", x), x + y**3])
    with mpmath.workdps(60):
        at = (mpmath.mpf("0.7"), mpmath.mpf("-1.3"))
        for i, symbol in enumerate((x, y)):
            along = tangents(solution, {symbol: graph.one})
            for unknown in solution:
                expected = slope(lambda *p, u=unknown: evaluate(u, {x: p[0], y: p[1]}), at, i)
                assert abs(evaluate(along(unknown), dict(zip((x, y), at, strict=True))) - expected) < 1e-18
            factors = [node for node in reachable([along(u) for u in solution]) if node.kind is Kind.FACTOR]
            assert len(factors) == 1


# --- depth ----------------------------------------------------------------------------------------------------
# Very long and very deep expressions pass every walk: no recursion limit, no quadratic surprise.


def program_of(outputs: list[Node], state: list[Node]) -> Program:
    graph = outputs[0].graph
    return lower("deep", {"out": outputs}, {"y": state}, graph.symbol("t", Binding.TIME), [])


@pytest.fixture(autouse=True)
def shallow() -> None:
    """Set a recursion limit far below the depth of the expressions in these tests."""
    assert sys.getrecursionlimit() < 5_000 / 4


@pytest.mark.slow
def test_a_deep_choice_is_walked_too() -> None:
    graph = Graph()
    x = graph.symbol("x", Binding.CONFIGURATION)
    node = x
    for k in range(300):
        node = graph.piecewise([(graph.call("less", x, graph.constant(k)), node * x)], node + 1)
    (slope,) = gradient(node, [x])
    forward = tangents([node], {x: graph.one})(node)
    result = NumpyMachine().load(program_of([slope, forward], [x]))(0.0, np.array([0.9]), np.empty(0))
    assert result[0] == pytest.approx(result[1], rel=1e-12)
    assert len(reachable([slope])) < 10 * len(reachable([node]))
