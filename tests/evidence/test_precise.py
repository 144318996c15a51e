"""Expressions and runs in multiple precision: closed forms to all digits, independent of compiled code."""

from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from sympy import Abs, cos

from lagrange.compiler import machine, model_of
from lagrange.errors import RunError
from lagrange.evidence.precise import BeyondDoubles, OutsideDomain, Precise, _no_value
from lagrange.evidence.precise_run import precise_run
from lagrange.export.programs import NoValue, evaluate
from lagrange.machine.model import Model
from lagrange.program.program import Instruction, Program, ProgramBlock
from lagrange.statement.coordinate import t
from lagrange.statement.declare import declare
from lagrange.statement.vocabulary.functions import SYMPY_CLASSES, WORDS
from tests.models import c, double_pendulum, k, m, stated, x, y

STATEMENT = declare(kinetic=x.dot**2 + y.dot**2, potential=k * x * c, coordinates=[x, y])
HIGH = mpmath.MPContext()
HIGH.dps = 60


def value(expression: Any, q: Any = (0.3, 0.7), v: Any = (1.1, -0.4), time: Any = 2.0, digits: int = 50) -> Any:
    return Precise([expression], STATEMENT, digits)(q, v, time, {k: 1.7, c: 0.6})[0]


AT_03 = [
    *("sin", "cos", "tan", "cot", "sec", "csc", "asin", "acos", "atan", "exp", "log", "sqrt"),
    *("sinh", "cosh", "tanh", "asinh", "atanh", "erf", "sinc"),
]
FUNCTIONS = {getattr(sp, name)(x): getattr(HIGH, name)(0.3) for name in AT_03} | {
    sp.atan2(x, -y): HIGH.atan2(0.3, -0.7),
    sp.acosh(x + 1): HIGH.acosh(HIGH.mpf(0.3) + 1),
    sp.sinc(sp.Min(x, 0)): HIGH.mpf(1),
    sp.Heaviside(x) - sp.Heaviside(-y) + sp.Heaviside(sp.Min(x, 0), 3): HIGH.mpf(4),
    sp.Abs(-x): HIGH.mpf(0.3),
    sp.sign(-x): HIGH.mpf(-1),
    sp.Min(x, y, k): HIGH.mpf(0.3),
    sp.Max(x, y, k): HIGH.mpf(1.7),
    sp.Piecewise((x, y < 0), (-x, True)): HIGH.mpf(-0.3),
    x**y: HIGH.power(0.3, 0.7),
    x ** sp.Rational(2, 3): HIGH.power(0.3, HIGH.mpf(2) / 3),
    x**-3: HIGH.power(0.3, -3),
    (-x) ** sp.Float(2.0): HIGH.mpf(0.3) ** 2,
    x / 3: HIGH.mpf(0.3) / 3,
    sp.pi * x: HIGH.pi * 0.3,
    sp.E * x: HIGH.e * 0.3,
    sp.GoldenRatio * x: HIGH.phi * 0.3,
    sp.EulerGamma * x: HIGH.euler * 0.3,
    sp.Catalan * x: HIGH.catalan * 0.3,
    x.dot * y.dot: HIGH.mpf(1.1) * HIGH.mpf(-0.4),
    t + k: HIGH.mpf(2) + HIGH.mpf(1.7),
    x + sp.Float("0.1", 40): HIGH.mpf(0.3) + HIGH.mpf(1) / 10,
}


@pytest.mark.parametrize("expression", list(FUNCTIONS), ids=str)
def test_every_function_has_50_digits(expression: Any) -> None:
    digits = 40 if expression.has(sp.Float) else 50
    assert abs(value(expression) - FUNCTIONS[expression]) <= abs(FUNCTIONS[expression]) * HIGH.mpf(10) ** (1 - digits)


def test_the_list_above_is_the_whole_vocabulary() -> None:
    tried = {type(node) for expression in FUNCTIONS for node in sp.preorder_traversal(expression)}
    assert set(SYMPY_CLASSES) <= tried
    assert [name for name, word in WORDS.items() if word.build not in tried] == ["sqrt", "mod"]
    assert sp.sqrt(x) in FUNCTIONS  # a remainder is written with atan2 where it is stated


@pytest.mark.parametrize(
    "expression",
    [
        *(sp.sqrt(-x), sp.log(-x), sp.log(x - x.dot * 0 - sp.Float(0.3)), 1 / (x - sp.Float(0.3)), sp.asin(1 + x)),
        *(sp.acos(-1 - x), (-x) ** sp.Rational(1, 3), (-x) ** y, (x - sp.Float(0.3)) ** (-y)),
        *(sp.atan2(x - sp.Float(0.3), sp.Float(0.7) - y), sp.exp(1 / (x - sp.Float(0.3)))),
        *(sp.atan(sp.log(x - sp.Float(0.3))), sp.Min(sp.sqrt(-x), 1), sp.Piecewise((1, x > 1))),
        sp.Piecewise((1, sp.sqrt(-x) > 1), (2, True)),
    ],
    ids=str,
)
def test_what_has_no_value_is_said(expression: Any) -> None:
    with pytest.raises(OutsideDomain):
        value(expression)


def test_a_branch_not_taken_need_not_have_a_value() -> None:
    guarded = sp.Piecewise((sp.log(-x), x < 0), (1 / (x - sp.Float(0.3)), x > 1), (x, True))
    assert value(guarded) == HIGH.mpf(0.3)
    assert value(2 * guarded + sp.sin(guarded)) > 0


def test_conditions_follow_logic() -> None:
    outside = sp.sqrt(-x) > 1
    for condition, expected in [
        (sp.And(x > 0, y > 0), 1),
        (sp.And(x > 1, outside), 0),
        (sp.Or(x > 0, outside), 1),
        (sp.Not(sp.And(x > 0, y < 0)), 1),
        (sp.Eq(x, y), 0),
        (sp.Ne(x, y), 1),
        (x <= sp.Float(0.3), 1),
        (x < sp.Float(0.3), 0),
        (x >= sp.Float(0.3), 1),
        (x > sp.Float(0.3), 0),
    ]:
        assert value(sp.Piecewise((1, condition), (0, True))) == expected, condition


def test_numbers_beyond_any_range_do_not_take_for_ever() -> None:
    for function in (sp.exp, sp.sinh, sp.cosh, lambda u: 2 ** sp.exp(u)):
        with pytest.raises(BeyondDoubles):
            value(function(sp.exp(sp.exp(sp.exp(3 * x + 2)))))


def test_equal_subexpressions_are_computed_once() -> None:
    expression = x
    for _ in range(60):
        expression = sp.sin(expression) * expression + expression
    tape = Precise([expression], STATEMENT)
    assert len(tape._code) <= 200
    assert tape((0.3, 0.1), (0, 0), 0, {k: 1, c: 1})[0] > 0


@pytest.mark.slow
def test_neither_depth_nor_width_meets_a_recursion_limit() -> None:
    deep = x
    for _ in range(3000):
        deep = sp.sin(deep, evaluate=False)
    assert 0 < value(deep) < 0.04
    wide = sp.Add(*(sp.Integer(i) * sp.cos(x + i) for i in range(1000)))
    assert abs(value(wide) - sum(i * HIGH.cos(HIGH.mpf(0.3) + i) for i in range(1000))) < 1e-40


def test_a_perturbed_copy_is_off_by_its_size_and_reproducible() -> None:
    tape = Precise([sp.sin(x) * k + x**2], STATEMENT, 60)
    point = ((0.3, 0.7), (0, 0), 0, {k: 1.7, c: 0.6})
    exact = tape(*point)[0]
    off = [abs(tape.perturbed(1e-20, seed)(*point)[0] / exact - 1) for seed in range(20)]
    assert all(1e-23 < change < 1e-19 for change in off)
    assert tape.perturbed(1e-20, 3)(*point) == tape.perturbed(1e-20, 3)(*point)
    assert tape(*point)[0] == exact


def test_perturbation_shows_cancellation() -> None:
    near = Precise([1 - sp.cos(x)], STATEMENT, 60)
    point = ((1e-6, 0.0), (0, 0), 0, {k: 1, c: 1})
    change = abs(near.perturbed(1e-20, 1)(*point)[0] / near(*point)[0] - 1)
    assert 1e11 < change / 1e-20 < 1e13


@given(st.lists(st.tuples(*[st.sampled_from([-0.5, 0.0, 0.5, 2.0])] * 4), min_size=2, max_size=6))
def test_what_was_computed_before_does_not_matter(states: list[tuple[float, ...]]) -> None:
    expressions = [sp.sqrt(x) + y * k, sp.Piecewise((1 / y, y > 0), (x.dot, True)) + sp.sin(3), t * y.dot]
    used = Precise(expressions, STATEMENT)

    def outcome(tape: Precise, a: float, b: float, c_: float, d: float) -> Any:
        try:
            return tape((a, b), (c_, d), b, {k: a, c: 1.0})
        except OutsideDomain as reason:
            return str(reason)

    for state in states:
        assert outcome(used, *state) == outcome(Precise(expressions, STATEMENT), *state)


def test_a_mistake_of_ours_is_not_taken_for_a_missing_value() -> None:
    missing = OutsideDomain("square root of a negative number")
    assert _no_value(TypeError("cannot unpack"), [HIGH.one._mpf_, missing]) is missing
    with pytest.raises(TypeError, match="takes 2 arguments"):
        _no_value(TypeError("takes 2 arguments"), [HIGH.one._mpf_])


def test_what_the_system_does_not_have_is_said() -> None:
    with pytest.raises(OutsideDomain, match="stranger has no value here"):
        Precise([sp.Symbol("stranger") * x], STATEMENT)
    with pytest.raises(OutsideDomain, match="gamma cannot be evaluated"):
        Precise([sp.gamma(x)], STATEMENT)


@pytest.mark.parametrize("function", [sp.sin, sp.cos, sp.tan, sp.cot, sp.sec, sp.csc, sp.sinc])
def test_angles_beyond_doubles_have_no_value(function: Any) -> None:
    with pytest.raises(BeyondDoubles, match="angle beyond the range of double precision"):
        value(function(sp.cosh(10**9 * x)))
    assert abs(value(sp.cos(sp.exp(700 * y)) ** 2 + sp.sin(sp.exp(700 * y)) ** 2) - 1) < 1e-40


# --- runs -----------------------------------------------------------------------------------------------------
# Runs in multiple precision: closed forms to all digits, and independence of compiled code.


NUMBER = mpmath.MPContext()
NUMBER.dps = 60


def run(statement: Any, times: Any, start: Any = None, t0: float = 0.0, **options: Any) -> Any:
    values = {p: statement.defaults[p] for p in statement.parameters}
    return precise_run(
        model_of(statement, machine("numpy")),
        values,
        t0,
        statement.initial if start is None else start,
        times,
        **options,
    )


def oscillator(**more: Any) -> Any:
    given = {"kinetic": m * x.dot**2 / 2, "potential": k * x**2 / 2, "parameters": {m: 1, k: 4, c: 0.5}, **more}
    return stated(**given, initial={x: 1.0})


def off(state: Any, expected: Any) -> float:
    return max(abs(float(a - b)) for a, b in zip(state, expected, strict=True))


def swing(time: float) -> list[Any]:
    time = NUMBER.mpf(time)
    return [NUMBER.cos(2 * time), -2 * NUMBER.sin(2 * time)]


def damped(time: float) -> list[Any]:
    """Return the system x'' = -4 x - x'/2, released at x = 1."""
    time, rate = NUMBER.mpf(time), NUMBER.mpf(1) / 4
    w = NUMBER.sqrt(4 - rate**2)
    decay = NUMBER.exp(-rate * time)
    return [decay * (NUMBER.cos(w * time) + rate / w * NUMBER.sin(w * time)), -4 * decay * NUMBER.sin(w * time) / w]


def driven(time: float) -> list[Any]:
    """Return the system x'' = -4 x + cos t, released at x = 1."""
    time = NUMBER.mpf(time)
    return [(2 * NUMBER.cos(2 * time) + NUMBER.cos(time)) / 3, -(4 * NUMBER.sin(2 * time) + NUMBER.sin(time)) / 3]


@pytest.mark.parametrize("digits", [18, 25, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("statement", "exact"),
    [
        (oscillator(), swing),
        (oscillator(dissipation=c * x.dot**2 / 2), damped),
        (oscillator(forces={x: -c * x.dot}), damped),
        (oscillator(forces={x: cos(t)}), driven),
        (oscillator(potential=k * x**2 / 2 - x * cos(t)), driven),
    ],
    ids=["free", "dissipation", "force", "driven by a force", "driven by a potential"],
)
def test_closed_forms_to_all_digits(statement: Any, exact: Callable[[float], Any], digits: int) -> None:
    times = [0.3, 5.0]
    for time, state in zip(times, run(statement, times, digits=digits), strict=True):
        assert off(state, exact(time)) < 10.0 ** (1 - digits)


def test_a_run_backwards_comes_home() -> None:
    statement = double_pendulum()
    there = run(statement, [0.5], digits=22)[0]
    back = run(statement, [0.0], start=there, t0=0.5, digits=22)[0]
    assert off(back, statement.initial) < 1e-20


@pytest.mark.slow
def test_what_doubles_propose_does_not_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    statement = double_pendulum()
    expected = run(statement, [0.5], digits=20)[0]
    right = Model.rhs
    monkeypatch.setattr(Model, "rhs", lambda *arguments: right(*arguments) * (1 + 1e-4))
    result = run(statement, [0.5], digits=20)[0]
    assert off(result, expected) < 1e-19


def test_the_start_is_there_at_its_own_time() -> None:
    assert run(oscillator(), [0.0, 0.0])[1] == [1, 0]


def test_a_jump_of_the_forces_is_not_passed() -> None:
    with pytest.raises(RunError, match=r"passes t = 1\.4142.*derivatives, jump there"):
        run(oscillator(potential=Abs(x)), [3.0], digits=20)


@pytest.mark.few(1)
@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_units_of_time_do_not_matter(unit: float) -> None:
    """Limits on intervals and times are relative to the whole run, not in seconds."""
    (state,) = run(oscillator(parameters={m: 1, k: 4 / unit**2}), [0.3 * unit], digits=20)
    assert off([state[0], state[1] * unit], swing(0.3)) < 1e-15
    with pytest.raises(
        RunError, match=rf"passes t = {1.4142 * unit:.0e}".replace("1e", "1\\.414.*e").replace("+", r"\+")
    ):
        run(oscillator(potential=Abs(x) / unit**2), [3.0 * unit], digits=20)


@pytest.mark.slow
def test_a_bend_of_the_forces_is() -> None:
    """A bend of the forces is allowed: x'' = -x - x/2 for x > 0 and -x + x/2 below, half a period of each."""
    statement = oscillator(potential=x**2 / 2, forces={x: -Abs(x) / 2})
    high, low = NUMBER.sqrt(1.5), NUMBER.sqrt(0.5)
    time = float((NUMBER.pi / 2) / high + (NUMBER.pi / 2) / low)
    inside = low * (time - (NUMBER.pi / 2) / high)
    expected = [-high / low * NUMBER.sin(inside), -high * NUMBER.cos(inside)]
    assert off(run(statement, [time], digits=20)[0], expected) < 1e-16


def test_the_clock_is_looked_at() -> None:
    with pytest.raises(RunError, match="time limit: it was at t = 0"):
        run(oscillator(), [1.0], max_wall=1e-9)


# --- Systems whose pivots vanish in their order ---


def solving(lower: Sequence[float]) -> Program:
    """Return a program that solves A x = y for two unknowns; `lower` is the triangle of A by rows."""
    code = [Instruction("constant", value=value) for value in lower]
    code.append(Instruction("factor", (0, 1, 2), order=2))
    code += [Instruction("state", place=0), Instruction("state", place=1), Instruction("solve", (3, 4, 5), order=2)]
    code += [Instruction("component", (6,), place=0), Instruction("component", (6,), place=1)]
    return Program("f", (ProgramBlock("y", 2),), 0, tuple(code), 0, (7, 8), (ProgramBlock("x", 2),), (2,))


@pytest.mark.parametrize(
    ("lower", "x"),
    [
        ((4.0, 2.0, 3.0), [-0.125, 0.75]),
        ((0.0, 2.0, 0.0), [1.0, 0.5]),
        ((1e-300, 2.0, 0.0), [1.0, 0.5]),
        ((0.0, 1.0, 5.0), [-3.0, 1.0]),
    ],
)
def test_pivots_that_vanish(lower: Sequence[float], x: list[float]) -> None:
    assert [float(item) for item in evaluate(solving(lower), 0.0, [1.0, 2.0], [])] == x


def test_a_singular_matrix_has_no_solution() -> None:
    with pytest.raises(NoValue, match="a matrix is singular"):
        evaluate(solving((1.0, 1.0, 1.0)), 0.0, [1.0, 2.0], [])
