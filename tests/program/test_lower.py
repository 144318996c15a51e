"""Programs of equations: how expressions become procedures, and values on both sides of a switch."""

import itertools
import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from fractions import Fraction
from functools import partial
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import given

import lagrange as lg
from lagrange.errors import StatementError
from lagrange.graph.differentiate import gradient
from lagrange.graph.node import Binding, Graph, Kind, Node, reachable
from lagrange.machine.kernel.interpreted import FLOATS, OPERATIONS, InterpretedKernel
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import LIBRARY, spell
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.procedure.form import OPERATIONS as KINDS
from lagrange.program.lower import lower
from lagrange.program.program import ARITY, Instruction, Program, ProgramBlock
from lagrange.program.simplify import LONGEST_PROGRAM, MOST_COMPARED_TERMS, operations, simplified
from lagrange.program.switching import SWITCHES, Switched, switch
from lagrange.statement.vocabulary.functions import FUNCTIONS
from tests.graph.trees import Forms, evaluate, expressions, new_graph
from tests.refusals import refusal

POINT = {"m": 1.7, "x": 0.31, "y": -0.83, "u": 1.21}


class Bench:
    """A graph with one symbol of each kind, and its lowering."""

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
def test_a_program_has_the_values_of_the_graph_hoists_parameters_and_does_nothing_twice(forms: Forms) -> None:
    graph, symbols = new_graph()
    node = forms.node(graph, symbols)
    outputs = [node, *gradient(node, list(symbols.values()))]
    time, state = graph.symbol("t", Binding.TIME), {"y": [symbols[name] for name in "xyu"]}
    program = lower("any", {"out": outputs}, state, time, [symbols["m"]])
    result = NumpyMachine().load(program)(0.0, np.array([POINT[name] for name in "xyu"]), np.array([POINT["m"]]))
    with mpmath.workdps(30):
        at = {symbols[name]: mpmath.mpf(value) for name, value in POINT.items()}
        expected = [evaluate(output, at) for output in outputs]
    scale = 1 + max(abs(float(value)) for value in expected)
    # Cubes of cubes leave doubles behind; a wrong rule would be wrong for small numbers as well.
    if scale < 1e6:
        assert np.abs(result - [float(value) for value in expected]).max() < 1e-9 * scale
    moving: set[int] = set()
    for i, (op, args, *_) in enumerate(program.instructions):
        if op in ("state", "time") or moving.intersection(args):
            moving.add(i)
    assert moving == set(range(program.hoisted, len(program.instructions)))
    assert len(set(program.instructions)) == len(program.instructions)
    read = {arg for instruction in program.instructions for arg in instruction.args} | set(program.outputs)
    assert read == set(range(len(program.instructions)))


def test_parameters_alone_are_worked_out_once(b: Bench) -> None:
    node = b.graph.call("sin", b.k) * b.m**2 * b.x + b.m * b.k * b.y - (b.k + b.m) ** Fraction(1, 2)
    assert b.every_time(node) == Counter(state=2, mul=1, add=1, fma=1) or b.every_time(node) == Counter(state=2, fma=2)
    assert b.run(node)[0] == pytest.approx(np.sin(0.4) * 1.7**2 * 0.31 + 1.7 * 0.4 * -0.83 - np.sqrt(2.1), rel=1e-14)


def test_a_linear_combination_is_a_chain_of_multiply_adds(b: Bench) -> None:
    node = b.graph.sum([(3, b.x), (5, b.y * b.u), (-1, b.u)], 7)
    ops = b.every_time(node)
    assert sum(ops[op] for op in ("mul", "fma", "add", "sub")) <= 5
    assert ops["fma"] >= 1
    assert b.run(node)[0] == pytest.approx(7 + 3 * 0.31 + 5 * -0.83 * 1.21 - 1.21, rel=1e-14)


EXPONENTS = (*range(-8, 9), 17, 63, 64, 65, -70)
HALVES = (*(Fraction(k, 2) for k in (-7, -5, -3, -1, 1, 3, 5, 7, 63, 65)), Fraction(1, 3), Fraction(-7, 5))


@pytest.mark.parametrize("exponent", [*EXPONENTS, *HALVES])
@pytest.mark.parametrize("base", [0.31, 1.21])
def test_powers(b: Bench, exponent: int | Fraction, base: float) -> None:
    (result,) = b.run(b.graph.power(b.x, exponent), at=(base, 0, 0))
    assert result == pytest.approx(base ** float(exponent), rel=2e-14)


def test_powers_are_multiplications_and_roots_where_they_can_be(b: Bench) -> None:
    assert b.every_time(b.x**4) == Counter(state=1, mul=2)
    assert b.every_time(b.x**-2) == Counter(state=1, mul=1, div=1)
    assert b.every_time(b.x ** Fraction(3, 2)) == Counter(state=1, mul=1, sqrt=1)
    assert b.every_time(b.x ** Fraction(1, 3)) == Counter(state=1, power=1)
    assert b.every_time(b.x**65) == Counter(state=1, power=1)
    assert b.every_time(b.x**2 * b.u**3) == Counter(state=2, mul=4)
    assert b.every_time(b.x**2 * b.u**-2) == Counter(state=2, mul=2, div=1)


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
        (result,) = b.run(b.graph.call(name, *args))
        assert np.isfinite(result) or name == "nan", name


def test_constants_that_no_double_holds_are_refused(b: Bench) -> None:
    assert refusal(b.program, b.x * -(b.graph.constant(10) ** 400)) == (
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


def test_a_long_product_is_lowered_without_depth() -> None:
    graph = Graph()
    symbols = [graph.symbol(f"x{i}", Binding.CONFIGURATION) for i in range(2000)]
    node = graph.one
    for symbol in symbols:
        node = node * symbol
    program = lower("long", {"out": [node]}, {"y": symbols}, graph.symbol("t", Binding.TIME), [])
    result = NumpyMachine().load(program)(0.0, np.linspace(0.9, 1.1, 2000), np.empty(0))
    assert result[0] == pytest.approx(np.prod(np.linspace(0.9, 1.1, 2000)), rel=1e-9)


# --- program --------------------------------------------------------------------------------------------------
# Results of hoisted instructions that are saved, and the tables of operations.

I = Instruction
SOUND = Program(
    name="sound",
    inputs=(ProgramBlock("q", 1), ProgramBlock("v", 1)),
    parameters=1,
    instructions=(
        I("parameter", place=0),
        I("constant", value=0.1),
        I("mul", (0, 1)),
        I("state", place=0),
        I("state", place=1),
        I("time"),
        I("fma", (2, 3, 5)),
        I("factor", (3, 1, 4), order=2),
        I("solve", (7, 6, 4), order=2),
        I("component", (8,), 1),
    ),
    hoisted=3,
    outputs=(9, 6, 9),
    results=(ProgramBlock("a", 1), ProgramBlock("b", 2)),
    shape=(3,),
)


def test_what_is_saved_is_what_the_rest_reads() -> None:
    assert SOUND.saved == (2,)
    hoisted = Program(
        name="hoisted",
        inputs=(ProgramBlock("q", 1), ProgramBlock("v", 1)),
        parameters=3,
        instructions=(
            *(I("parameter", place=i) for i in range(3)),
            I("mul", (0, 1)),
            I("mul", (1, 2)),
            I("factor", (3, 4, 2), order=2),
            I("sin", (3,)),
            I("state", place=0),
            I("solve", (5, 7, 7), order=2),
            I("component", (8,), 0),
        ),
        hoisted=7,
        outputs=(9,),
        results=(ProgramBlock("a", 1),),
        shape=(1,),
    )
    # The entries of a saved matrix are kept with its factors, to factor it again with pivoting; sin is read by nobody.
    assert hoisted.saved == (3, 4, 5)


LEAVES = {"time", "state", "parameter", "constant"}
SYSTEMS = {"factor", "solve", "component"}


def test_every_operation_is_spelled_for_numpy() -> None:
    assert set(OPERATIONS) == set(ARITY) - LEAVES - SYSTEMS


@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("op", sorted(set(ARITY) - LEAVES - SYSTEMS))
def test_every_operation_is_spelled_for_llvm(op: str, lanes: int) -> None:
    """Each operation has a text for any number of lanes, except functions of the C library."""
    e, args = Emitter(), [f"%a{i}" for i in range(ARITY[op] or 0)]
    with pytest.raises(NotImplementedError) if lanes > 1 and op in LIBRARY else nullcontext():
        last = spell(e, op, KINDS[op][0][0], args, lanes)
        assert e.lines[-1].startswith(f"  {last} = ")
        assert all(arg in "".join(e.lines) for arg in args)


# --- simplify -------------------------------------------------------------------------------------------------
# A program with fewer operations computes the same.

STATES = 4


def program(*code: Instruction, outputs: tuple[int, ...]) -> Program:
    """Return a program with one parameter, then four entries of the state, as inputs."""
    given = (Instruction("parameter"), *(Instruction("state", place=i) for i in range(STATES)))
    size = len(outputs)
    return Program(
        "made", (ProgramBlock("y", STATES),), 1, (*given, *code), 1, outputs, (ProgramBlock("a", size),), (size,)
    )


def results(of: Program) -> Any:
    with np.errstate(all="ignore"):
        return InterpretedKernel(of)(0.3, np.random.default_rng(3).normal(size=(STATES, 50)), np.array([1.7]))


P, U, V, W, X = range(5)


@pytest.mark.parametrize("first", [1, -1])
@pytest.mark.parametrize("second", ["add", "sub"])
def test_what_does_not_cancel_stays(first: int, second: str) -> None:
    """Only two of four signed sums of x (u - v) and x v simplify to x u or -x u."""
    turned = Instruction("neg", (6,)) if first < 0 else Instruction("add", (6, W))
    given = program(
        Instruction("sub", (U, V)),
        Instruction("mul", (X, 5)),
        turned,
        Instruction("mul", (V, X)),
        Instruction(second, (7, 8)),
        outputs=(9,),
    )
    result = simplified(given)
    assert results(result) == pytest.approx(results(given), rel=1e-13, abs=1e-13)
    code = result.instructions
    differs = any(item.op == "sub" and all(code[arg].op == "state" for arg in item.args) for item in code)
    assert differs == ((first > 0) != (second == "add"))


@pytest.mark.few
@pytest.mark.parametrize("seed", range(40))
def test_random_programs_compute_the_same(seed: int) -> None:
    """Random programs consist of operations on earlier results, mostly sums and products of repeated inputs."""
    rng = np.random.default_rng(seed)
    code: list[Instruction] = []
    names = {"add": 2, "sub": 2, "mul": 2, "neg": 1, "fma": 3, "div": 2, "abs": 1, "cos": 1, "sin": 1, "max": 2}
    chosen = rng.choice(list(names), size=30, p=[0.2, 0.2, 0.2, 0.12, 0.08, 0.04, 0.04, 0.04, 0.04, 0.04])
    for k, op in enumerate(chosen.tolist()):
        here = len(code) + 1 + STATES
        args = tuple(int(arg) for arg in rng.integers(max(0, here - 9) if k % 2 else 0, here, names[op]))
        code.append(Instruction(op, args))
    last = 1 + STATES + len(code)
    given = program(*code, outputs=(last - 1, last - 2, last - 7, last - 12))
    result, expected = results(simplified(given)), results(given)
    finite = np.isfinite(expected) & (np.abs(expected) < 1e6)
    assert operations(simplified(given)) <= operations(given)
    assert result[finite] == pytest.approx(expected[finite], rel=1e-6, abs=1e-6)


def test_the_double_pendulum_has_no_products_that_cancel() -> None:
    """With this simplification there are 20 operations instead of 27; in a chain of five 165 instead of 206."""
    kernel = lg.scene("double-pendulum").compile(target="numpy").kernel("rhs")
    assert operations(kernel.program) >= 27 and operations(simplified(kernel.program)) <= 20


def test_long_programs_and_long_sums_are_left_alone() -> None:
    long = program(*(Instruction("neg", (i,)) for i in range(5 - 1, 4 + LONGEST_PROGRAM)), outputs=(LONGEST_PROGRAM,))
    assert simplified(long) is long
    sums = [Instruction("sin", (U,))]
    for k in range(3 * MOST_COMPARED_TERMS):
        sums += [Instruction("mul", (5 + 2 * k, U)), Instruction("add", (6 + 2 * k, V))]
    wide = program(*sums, outputs=(5 + 6 * MOST_COMPARED_TERMS,))
    assert results(simplified(wide)) == pytest.approx(results(wide), rel=1e-12)


# --- switches become sides of surfaces: none is left, and with the right sides the values are the same ---------


GRAPH = Graph()
x, y = (GRAPH.symbol(name, Binding.CONFIGURATION) for name in "xy")
v, w = (GRAPH.symbol(name, Binding.VELOCITY) for name in "vw")
t, c = GRAPH.symbol("t", Binding.TIME), GRAPH.symbol("c", Binding.PARAMETER)
SWITCHED_STATES = [*itertools.product((-0.5, 0.25, 1.0), (-0.5, 1.0), (-1.0, 0.0), (2.0,), (-1.0, 1.5), (-0.5, 2.0))]
"""Values of x, y, v, w, t and c."""


def call(name: str, *args: Any) -> Node:
    return GRAPH.call(name, *(GRAPH.node(arg) for arg in args))


def piecewise(condition: Node, value: Node, otherwise: Node) -> Node:
    return GRAPH.piecewise([(condition, value)], otherwise)


def values(nodes: list[Node], state: Any, sides: list[Node], signs: list[float]) -> list[float]:
    """Return the values of nodes at x, y, v, w, t, c and the signs of surfaces."""
    program = lower("values", {"out": nodes}, {"y": (x, y, v, w)}, t, (c, *sides))
    with np.errstate(invalid="ignore"):  # of branches that are not taken
        return [float(value) for value in FLOATS.evaluate(program, state[4], state[:4], [state[5], *signs])]


def switches(node: Node) -> bool:
    """Return True if a node is a switch that does not depend on parameters and sides alone."""
    return node.kind is Kind.CALL and node.data in SWITCHES and any(a.binding > Binding.PARAMETER for a in node.args)


def same_without_switches(node: Node, surfaces: int) -> Switched:
    """Return the smooth form of a node, after a check that both are equal at all states."""
    result = switch(GRAPH, [node])
    assert len(result.surfaces) == len(result.sides) == surfaces
    assert not any(map(switches, reachable([result.smooth[node]])))
    for state in SWITCHED_STATES:
        signs = [0.0] * surfaces
        for i, surface in enumerate(result.surfaces):  # a surface depends on those before it
            signs[i] = float(sp.sign(values([surface], state, list(result.sides), signs)[0]))
        assert values([result.smooth[node]], state, list(result.sides), signs) == values([node], state, [], []), state
    return result


def first_or_second_branch() -> Node:
    """Return an expression with log(x) in two branches, which both have x > 0."""
    positive, slope = call("less", 0, x), call("log", x)
    high = call("and", positive, call("less", 0, y))
    return piecewise(high, call("abs", slope), piecewise(positive, call("sign", slope), v))


def both_sides(name: str) -> Node:
    """Return two expressions with a condition: on a coordinate, and on a parameter and a coordinate."""
    return piecewise(call(name, x, y), v, w) + piecewise(call(name, c, y), v, t)


EXPRESSIONS: dict[str, tuple[Callable[[], Node], int]] = {
    **{f"{name}(x)": (partial(call, name, x), 1) for name in ("abs", "sign")},
    **{f"{name} of both": (partial(call, name, x, y), 1) for name in ("min", "max")},
    **{f"{name} of a parameter": (partial(call, name, x, c), 1) for name in ("min", "max")},
    **{name: (partial(both_sides, name), 2) for name in ("less", "less_equal", "equal")},
    "and": (lambda: piecewise(call("and", call("less", x, 0), call("less_equal", y, c)), v, t), 2),
    "or not": (lambda: piecewise(call("or", call("less", x, 0), call("not", call("less_equal", y, c))), v, t), 2),
    "a switch inside a switch": (lambda: call("max", call("abs", x - y), call("min", x, v)), 3),
    "a magnitude of a magnitude": (lambda: call("abs", call("abs", x - y) - c), 2),
    "a condition on magnitudes": (
        lambda: piecewise(call("less", call("abs", x - y), call("abs", v)), call("abs", x - y), call("abs", v)),
        3,
    ),
    "a function and its negative": (lambda: call("abs", x) * call("sign", -x), 1),
    "a difference and its negative": (lambda: call("sign", x - y) * call("abs", y - x), 1),
    "both orders": (lambda: piecewise(call("less", x, y), v, w) + piecewise(call("less", y, x), w, t), 1),
    "both extremes": (lambda: call("min", x, y) + 2 * call("max", x, y), 1),
    "a function in two branches": (first_or_second_branch, 3),
    "an angle and its sign": (lambda: call("atan2", y, x) + call("sign", call("atan2", y, x)), 2),
    "an angle to the right": (lambda: call("atan2", y, 2), 0),
    "an angle to the left": (lambda: call("atan2", y, -2), 1),
    "an angle of a fixed height": (lambda: call("atan2", c, x), 0),
}
"""An expression, and the number of its surfaces."""


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_each_switch_is_a_side(name: str) -> None:
    expression, surfaces = EXPRESSIONS[name]
    same_without_switches(expression(), surfaces)


def test_an_angle_on_its_cut_has_the_limit_from_the_side() -> None:
    result = switch(GRAPH, [call("atan2", y, x)])
    (start,) = result.starts.values()
    for height, (side, limit) in itertools.product((1e-17, -1e-17, 0.0), ((1.0, math.pi), (-1.0, -math.pi))):
        assert values([start], [-1.0, height, 0, 0, 0, 1], list(result.sides), [side]) == [limit]


def test_the_angle_of_an_event_has_a_surface() -> None:
    """The angle in an event has the surface of the same angle in the equations; a switch adds one for its sign."""
    angle = call("atan2", y, x)
    assert switch(GRAPH, [v, angle - 3]).surfaces == (y,)
    assert len(switch(GRAPH, [v + angle, angle - 3]).surfaces) == 1
    assert len(switch(GRAPH, [v, call("abs", angle) - 3]).surfaces) == 2


def test_a_whole_turn_within_a_period_needs_no_surface() -> None:
    """cos(3 a) is smooth at a jump of a by 2 pi; cos(a / 2), cos(c a) and a sum with the angle are not."""
    angle = call("atan2", y, x)
    for name, smooth in itertools.product(("sin", "cos", "tan"), (3 * angle, t - 2 * angle + 1)):
        assert not switch(GRAPH, [call(name, smooth) * v]).surfaces
    for jumping in (angle / 2, (angle + t) / 2, angle * c, angle**2, call("abs", angle)):
        assert switch(GRAPH, [call("cos", jumping)]).surfaces[0] is y
    assert len(switch(GRAPH, [call("sin", 3 * angle) * angle]).surfaces) == 1
