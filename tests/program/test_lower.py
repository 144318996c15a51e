"""Lowering: the program computes the graph's value, what parameters decide is hoisted, and powers come cheap."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given

from lagrange.errors import LagrangeError, StatementError
from lagrange.graph.differentiate import gradient
from lagrange.graph.functions import FUNCTIONS
from lagrange.graph.node import Binding, Graph, Node
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.program.lower import lower
from lagrange.program.program import Program
from tests.graph.trees import SYMBOLS, Forms, evaluate, expressions, new_graph

POINT = {"m": 1.7, "x": 0.31, "y": -0.83, "u": 1.21}


class Bench:
    """A graph with one of each symbol, and lowering with them in place."""

    def __init__(self) -> None:
        self.graph, self.symbols = new_graph()
        self.m, self.x, self.y, self.u = (self.symbols[name] for name in "mxyu")
        self.k = self.graph.symbol("k", Binding.PARAMETER)
        self.t = self.graph.symbol("t", Binding.TIME)

    def program(self, *outputs: Node) -> Program:
        return lower("bench", {"out": outputs}, {"y": [self.x, self.y, self.u]}, self.t, [self.m, self.k])

    def run(self, *outputs: Node, at: Sequence[float] = (0.31, -0.83, 1.21), t: float = 0.7) -> Any:
        return NumpyMachine().load(self.program(*outputs))(t, np.array(at), np.array([1.7, 0.4]))

    def every_time(self, *outputs: Node) -> Counter[str]:
        program = self.program(*outputs)
        return Counter(instruction.op for instruction in program.instructions[program.hoisted :])


@pytest.fixture
def b() -> Bench:
    return Bench()


@given(expressions())
def test_the_interpreted_program_has_the_value_of_the_graph(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    outputs = [node, *gradient(node, list(symbols.values()))]
    state = [symbols[name] for name in "xyu"]
    time = graph.symbol("t", Binding.TIME)
    program = lower("any", {"out": outputs}, {"y": state}, time, [symbols["m"]])
    found = NumpyMachine().load(program)(0.0, np.array([POINT[name] for name in "xyu"]), np.array([POINT["m"]]))
    with mpmath.workdps(30):
        at = {symbols[name]: mpmath.mpf(value) for name, value in POINT.items()}
        expected = [evaluate(output, at) for output in outputs]
    scale = 1 + max(abs(float(value)) for value in expected)
    # Cubes of cubes leave doubles behind; a wrong rule would be wrong for small numbers as well.
    if scale < 1e6:
        assert np.abs(found - [float(value) for value in expected]).max() < 1e-9 * scale


@given(expressions())
def test_nothing_of_time_or_state_is_hoisted_and_all_of_the_parameters_is(forms: Forms) -> None:
    graph, symbols = new_graph()
    outputs = [forms.node(graph, symbols)]
    time = graph.symbol("t", Binding.TIME)
    program = lower("any", {"out": outputs}, {"y": [symbols[name] for name in "xyu"]}, time, [symbols["m"]])
    moving: set[int] = set()
    for i, (op, args, *_) in enumerate(program.instructions):
        if op in ("state", "time") or moving.intersection(args):
            moving.add(i)
    assert moving == set(range(program.hoisted, len(program.instructions)))


@given(expressions())
def test_no_instruction_is_idle_or_done_twice(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    time = graph.symbol("t", Binding.TIME)
    program = lower("any", {"out": [node]}, {"y": [symbols[name] for name in "xyu"]}, time, [symbols["m"]])
    assert len(set(program.instructions)) == len(program.instructions)
    read = {arg for instruction in program.instructions for arg in instruction.args} | set(program.outputs)
    assert read == set(range(len(program.instructions)))


def test_parameters_alone_are_worked_out_once(b: Bench) -> None:
    node = b.graph.call("sin", b.k) * b.m**2 * b.x + b.m * b.k * b.y - (b.k + b.m) ** Fraction(1, 2)
    assert b.every_time(node) == Counter(state=2, mul=1, add=1, fma=1) or b.every_time(node) == Counter(state=2, fma=2)
    assert b.run(node)[0] == pytest.approx(np.sin(0.4) * 1.7**2 * 0.31 + 1.7 * 0.4 * -0.83 - np.sqrt(2.1), rel=1e-14)


def test_time_is_not_hoisted(b: Bench) -> None:
    node = b.graph.call("cos", b.k * b.t)
    assert b.every_time(node) == Counter(time=1, mul=1, cos=1)
    assert b.run(node)[0] == np.cos(0.4 * 0.7)


def test_a_linear_combination_is_a_chain_of_multiply_adds(b: Bench) -> None:
    node = b.graph.sum([(3, b.x), (5, b.y * b.u), (-1, b.u)], 7)
    ops = b.every_time(node)
    assert sum(ops[op] for op in ("mul", "fma", "add", "sub")) <= 5
    assert ops["fma"] >= 1
    assert b.run(node)[0] == pytest.approx(7 + 3 * 0.31 + 5 * -0.83 * 1.21 - 1.21, rel=1e-14)


def test_a_quotient_divides_once(b: Bench) -> None:
    node = b.x * b.u / (b.y * (1 + b.x**2))
    assert b.every_time(node)["div"] == 1
    assert b.run(node)[0] == pytest.approx(0.31 * 1.21 / (-0.83 * (1 + 0.31**2)), rel=1e-14)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("shape", ["quotient", "product", "scaled", "sum"])
def test_signs_survive_every_form(b: Bench, sign: int, shape: str) -> None:
    forms = {
        "quotient": (b.x / b.u, 0.31 / 1.21),
        "product": (b.x * b.m * b.u, 0.31 * 1.7 * 1.21),
        "scaled": (b.graph.sum([(Fraction(-3, 2), b.x * b.y)]), 1.5 * 0.31 * 0.83),
        "sum": (b.x - b.y, 1.14),
    }
    node, value = forms[shape]
    outputs = (sign * node, b.u + sign * node, b.u - 2 * sign * node, sign * node * b.y, -sign * node + 0 * b.u)
    expected = [sign * value, 1.21 + sign * value, 1.21 - 2 * sign * value, sign * value * -0.83, -sign * value]
    assert b.run(*outputs) == pytest.approx(expected, rel=1e-13)


EXPONENTS = (*range(-8, 9), 17, 63, 64, 65, -70)
HALVES = (*(Fraction(k, 2) for k in (-7, -5, -3, -1, 1, 3, 5, 7, 63, 65)), Fraction(1, 3), Fraction(-7, 5))


@pytest.mark.parametrize("exponent", [*EXPONENTS, *HALVES])
@pytest.mark.parametrize("base", [0.31, 1.21])
def test_powers(b: Bench, exponent: int | Fraction, base: float) -> None:
    (found,) = b.run(b.graph.power(b.x, exponent), at=(base, 0, 0))
    assert found == pytest.approx(base ** float(exponent), rel=2e-14)


@pytest.mark.parametrize("exponent", [-3, -2, 2, 3, 7, 64])
def test_whole_powers_of_negative_numbers(b: Bench, exponent: int) -> None:
    assert b.run(b.graph.power(b.x, exponent), at=(-1.3, 0, 0))[0] == pytest.approx((-1.3) ** exponent, rel=1e-14)


def test_powers_are_multiplications_and_roots_where_they_can_be(b: Bench) -> None:
    assert b.every_time(b.x**4) == Counter(state=1, mul=2)
    assert b.every_time(b.x**-2) == Counter(state=1, mul=1, div=1)
    assert b.every_time(b.x ** Fraction(3, 2)) == Counter(state=1, mul=1, sqrt=1)
    assert b.every_time(b.x ** Fraction(1, 3)) == Counter(state=1, power=1)
    assert b.every_time(b.x**65) == Counter(state=1, power=1)


def test_roots_outside_their_domain_are_nan_and_not_zero(b: Bench) -> None:
    for exponent in (Fraction(1, 2), Fraction(-3, 2), Fraction(1, 3)):
        assert np.isnan(b.run(b.graph.power(b.x, exponent), at=(-1.0, 0, 0))).all()
    assert np.isnan(b.run(b.graph.call("log", b.x), at=(-1.0, 0, 0))).all()


def test_every_function_is_lowered(b: Bench) -> None:
    small = b.x / 2
    for name, function in FUNCTIONS.items():
        if name == "piecewise":
            continue
        args = [1 + small if name == "acosh" else small, 1 - small][: function.arity]
        if name in ("and", "or", "not"):
            args = [b.graph.call("less", b.x, arg) for arg in args]
        (found,) = b.run(b.graph.call(name, *args))
        assert np.isfinite(found) or name == "nan", name


def test_constants_that_no_double_holds_are_refused(b: Bench) -> None:
    with pytest.raises(StatementError) as refusal:
        b.program(b.x * -(b.graph.constant(10) ** 400))
    assert str(refusal.value) == (
        "the equations contain the constant -1.00e+400, which is too large for a floating-point number (4.9e-324 to "
        "1.8e+308 in size). It is a product, quotient or power of numbers in the statement: choose units in which "
        "these are nearer to 1."
    )
    with pytest.raises(
        StatementError, match=r"the constant 1\.25e-401, which is not zero, and too small for a floating"
    ):
        b.program(b.x * b.graph.constant(Fraction(1, 8)) * b.graph.constant(10) ** -400)
    smallest, largest = Fraction(5e-324), Fraction(sys.float_info.max)
    assert list(b.run(b.graph.constant(smallest), b.graph.constant(largest))) == [5e-324, sys.float_info.max]


def test_a_shape_must_be_filled(b: Bench) -> None:
    with pytest.raises(LagrangeError, match=r"1 outputs do not fill the shape \(2,\)"):
        lower("bench", {"out": [b.x]}, {"y": [b.x]}, b.t, [], shape=(2,))


def test_outputs_may_repeat_and_be_leaves_or_constants(b: Bench) -> None:
    outputs = (b.x, b.x, b.graph.constant(3), b.m, b.t, b.graph.zero, b.x * b.y, b.x * b.y + 1)
    assert b.run(*outputs) == pytest.approx([0.31, 0.31, 3, 1.7, 0.7, 0, -0.2573, 0.7427], rel=1e-14)


def test_constants_of_nature_are_the_nearest_doubles(b: Bench) -> None:
    assert list(b.run(b.graph.call("pi"), b.graph.call("e"))) == [np.pi, np.e]


def test_the_same_graph_lowers_to_the_same_program() -> None:
    def build() -> Program:
        bench = Bench()
        return bench.program(bench.x * bench.m + bench.graph.call("sin", bench.y) / bench.u, bench.u**3)

    assert build() == build()


def test_symbols_of_the_trees_are_those_of_the_bench() -> None:
    assert set(SYMBOLS) == set(Bench().symbols)


def test_a_long_product_is_lowered_without_depth() -> None:
    graph = Graph()
    symbols = [graph.symbol(f"x{i}", Binding.CONFIGURATION) for i in range(5000)]
    node = graph.one
    for symbol in symbols:
        node = node * symbol
    program = lower("long", {"out": [node]}, {"y": symbols}, graph.symbol("t", Binding.TIME), [])
    found = NumpyMachine().load(program)(0.0, np.linspace(0.9, 1.1, 5000), np.empty(0))
    assert found[0] == pytest.approx(np.prod(np.linspace(0.9, 1.1, 5000)), rel=1e-9)
