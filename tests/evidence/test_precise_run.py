"""Runs in multiple precision: closed forms to all digits, and independence of compiled code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import pytest
from sympy import Abs, cos

from lagrange.compiler import machine, model_of
from lagrange.errors import RunError
from lagrange.evidence.precise_run import precise_run
from lagrange.export.programs import NoValue, evaluate
from lagrange.machine.model import Model
from lagrange.program.program import Instruction, Program, ProgramBlock
from lagrange.statement.coordinate import t
from tests.models import c, double_pendulum, k, m, stated, x

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


@pytest.mark.parametrize("digits", [18, 25, 40])
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
    there = run(statement, [2.0], digits=22)[0]
    back = run(statement, [0.0], start=there, t0=2.0, digits=22)[0]
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
