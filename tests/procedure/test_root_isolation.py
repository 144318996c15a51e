"""Root isolation as a procedure: printers and interpreter agree, for ordinary and extreme polynomials."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.constants import WIDEST_VECTOR
from lagrange.algorithm.events.constants import MOST_COEFFICIENTS, MOST_ROOTS, TOO_MANY, UNFIT
from lagrange.algorithm.events.polynomial import PADDED
from lagrange.algorithm.events.roots import roots
from lagrange.algorithm.taylor.event_series import doubtful_events, event_terms, only_passage, only_zero
from lagrange.algorithm.taylor.memory import TaylorLayout
from lagrange.algorithm.taylor.watched_functions import TERM_SUMS
from lagrange.machine.llvm.engine import compiled
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.machine.python_source import called
from lagrange.procedure.interpreter import run

EPSILON = 2.0**-52

LLVM, PYTHON = LlvmMachine().called(roots.form()), NumpyMachine().called(roots.form())


def interpreted(*args: Any) -> Any:
    return run(roots.form(), *args)


def polynomials(seed: int, count: int) -> Iterator[np.ndarray[Any, np.dtype[np.float64]]]:
    """Yield the coefficients of polynomials on [0, 1]: random, with double or close roots, and of waves."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        degree = int(rng.integers(0, MOST_COEFFICIENTS)) if i % 8 == 0 else int(rng.integers(0, 25))
        c = rng.standard_normal(degree + 1) * rng.choice((0.1, 0.6, 1.0, 1.5)) ** np.arange(degree + 1)
        if i % 3 == 0:
            inside = np.repeat(rng.uniform(-0.1, 1.1, int(rng.integers(0, 6))), rng.integers(1, 4))
            near = inside[:2] + 10 ** rng.uniform(-9, -1)
            c = np.poly(np.concatenate([inside, near, rng.uniform(1.5, 4, 5)]))[::-1].copy()
        if i % 7 == 0:
            c[0] = rng.choice((0.0, 1e-17, -1e-17))
        yield c * rng.choice((1.0, -1.0, 1e-200, 1e250), p=(0.4, 0.4, 0.1, 0.1))


Case = tuple[Any, ...]


def cases(seed: int, count: int) -> Iterator[Case]:
    """Yield cases: coefficients, their number, the step, the noise, the side before, and the flag of a last step."""
    rng = np.random.default_rng(1000 + seed)
    for scaled in polynomials(seed, count):
        h = float(rng.choice((-1, 1)) * rng.choice((1.0, 0.75, 10 ** rng.uniform(-3, 3), 1e-9)))
        with np.errstate(all="ignore"):
            c = scaled / h ** np.arange(len(scaled))
        noise = float(rng.choice((0.0, 1e-12 * np.abs(scaled).max())))
        side = int(rng.choice((-1, 0, 1))), bool(rng.random() < 0.3), bool(rng.random() < 0.3)
        yield c, len(c), h, noise, *side


def outcome(isolate: Callable[..., Any], case: Case, room: int = MOST_ROOTS) -> tuple[Any, list[float], list[int]]:
    times, rising = np.full(MOST_ROOTS + 1, math.nan), np.full(MOST_ROOTS + 1, 7)
    result = isolate(*case, times, rising, room)
    assert np.isnan(times[room:]).all() and (rising[room:] == 7).all(), "nothing is written beyond the room"
    met = max(result[0], 0)
    return tuple(map(int, result)), times[:met].tolist(), rising[:met].tolist()


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(8))
def test_python_decides_as_machine_code_does(seed: int) -> None:
    """Roots differ by the effect of rounded products."""
    for case in cases(seed, 400):
        (sides, places, ways), (others, there, iterations) = outcome(LLVM, case), outcome(PYTHON, case)
        assert (sides, ways) == (others, iterations), case
        with np.errstate(all="ignore"):
            scaled = case[0] * case[2] ** np.arange(case[1])
        if np.isfinite(scaled).all():
            # A step that does not meet the one before has a root at its start, whatever g is there.
            inside = [place / case[2] for place in (*places, *there) if place]
            noise = 40 * EPSILON * np.abs(scaled).sum() + 2 * case[3]
            assert all(abs(np.polynomial.polynomial.polyval(s, scaled)) <= noise for s in inside), case


@pytest.mark.parametrize("isolate", [interpreted, LLVM, PYTHON], ids=["interpreter", "llvm", "python"])
def test_more_roots_than_there_is_room_for_are_told(isolate: Callable[..., Any]) -> None:
    wave = np.array([0.0 if k % 2 else (-1) ** (k // 2) * 10.0**k / math.factorial(k) for k in range(40)])
    case = wave, 40, 1.0, 0.0, 0, False, False
    (result, sign, near), times, rising = outcome(isolate, case)
    assert (result, sign, near) == (3, -1, False) and rising == [-1, 1, -1]
    assert times == pytest.approx([k * math.pi / 20 for k in (1, 3, 5)], rel=1e-13)
    assert outcome(isolate, case, room=3)[0][0] == 3
    for room in (0, 1, 2):
        assert outcome(isolate, case, room=room)[0][0] == TOO_MANY


@pytest.mark.parametrize("isolate", [interpreted, LLVM, PYTHON], ids=["interpreter", "llvm", "python"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_told(isolate: Callable[..., Any], bad: float) -> None:
    for c, h, noise in (([1.0, bad], 1.0, 0.0), ([1.0, 2.0], bad, 0.0), ([1.0, 2.0], 1.0, bad), ([bad], 1.0, 0.0)):
        result, _, _ = outcome(isolate, (np.array(c), len(c), h, noise, 1, False, False))
        assert result[0] == UNFIT


# --- event terms ----------------------------------------------------------------------------------------------
# The sums of terms on a step tell of its only zero what the isolation of all its zeros finds, or nothing.

MACHINES = [LlvmMachine(), NumpyMachine()]


def told(machine: Any, c: Any, s: float, sign: int, noise: float) -> tuple[int, float]:
    """Return the direction of the only zero of a series (0 for none, 2 for unknown) and its time."""
    order = len(c) - 1
    terms, slopes, sums = np.full(PADDED, math.nan), np.full(PADDED, math.nan), np.empty(len(TERM_SUMS))
    machine.called(event_terms.form())(np.ascontiguousarray(c), 1, order, s, terms, slopes, sums)
    answer = int(machine.called(only_zero.form())(s, order, sign, noise, terms, sums))
    if answer in (0, 2):
        return answer, math.nan
    return answer, s * float(machine.called(only_passage.form())(terms, slopes, sums, order, answer))


@pytest.mark.parametrize("order", [4, 5])
@pytest.mark.parametrize("machine", MACHINES, ids=("llvm", "numpy"))
def test_terms_rates_and_their_sums_on_a_step_are_exact(machine: Any, order: int) -> None:
    k, c = np.arange(order + 1), np.array([3.0, -5.0, 7.0, 11.0, -13.0, 17.0])[: order + 1]
    values, rates, sums = np.empty(PADDED), np.empty(PADDED), np.empty(len(TERM_SUMS))
    machine.called(event_terms.form())(c, 1, order, 2.0, values, rates, sums)
    terms, slopes = c * 2.0**k, k * c * 2.0**k
    late = abs(terms[2:]).sum(), abs(slopes[2:]).sum()
    assert [*values[: order + 1], *rates[:order]] == [*terms, *slopes[1:]]
    assert [*sums] == [*late, terms.sum(), slopes.sum(), abs(terms[-2:]).max()]


@pytest.mark.few(1)
@pytest.mark.parametrize("machine", MACHINES, ids=("llvm", "numpy"))
@pytest.mark.parametrize("seed", range(2))
def test_the_only_zero_is_the_one_that_isolation_finds(machine: Any, seed: int) -> None:
    """The quick decision, if it is made, is right: for slow and fast series, ends near zero, and extreme terms."""
    rng, answers = np.random.default_rng(seed), Counter[int]()
    isolate = LlvmMachine().called(roots.form())
    for _ in range(600):
        order, s = int(rng.integers(4, 33)), float(rng.choice((1.0, 0.7, 3.0, 1e-7, 20.0)))
        unit = rng.standard_normal(order + 1) * float(rng.choice((0.1, 0.2, 0.4, 0.9))) ** np.arange(order + 1)
        unit[0] *= float(rng.choice((1.0, 0.3, 1e-15, 0.0), p=(0.7, 0.2, 0.05, 0.05)))
        unit[1] *= float(rng.choice((1.0, 6.0, 0.0), p=(0.3, 0.6, 0.1)))
        unit[0] = float(rng.choice((unit[0], -unit[1] * rng.random())))
        unit[0] -= float(rng.choice((0.0, unit.sum()), p=(0.9, 0.1)))
        unit[order - int(rng.integers(0, order - 3)) :] *= float(rng.choice((1.0, 0.0)))
        unit *= float(rng.choice((1.0, 1e-150, 1e200), p=(0.8, 0.1, 0.1)))
        with np.errstate(all="ignore"):
            c = unit / s ** np.arange(order + 1)
        if not np.isfinite(c).all():
            continue
        sign = int(np.sign(c[0]) * rng.choice((1, 0, -1), p=(0.8, 0.1, 0.1)))
        noise = float(rng.choice((0.0, 1e-12 * np.abs(c[0]))))
        answer, time = told(machine, c, s, sign, noise)
        answers[answer] += 1
        if answer == 2:
            continue
        times, rising = np.empty(MOST_ROOTS), np.empty(MOST_ROOTS, dtype=np.int64)
        side = sign, *(False, False)
        result, after, near = isolate(c, len(c), s, noise, *side, times, rising, MOST_ROOTS)
        assert (after, near) == (answer or sign, False)
        assert rising[:result].tolist() == ([answer] if answer else [])
        if answer:
            slope = np.polynomial.polynomial.polyval(time, np.polynomial.polynomial.polyder(c))
            sizes = np.abs(c) @ abs(s) ** np.arange(order + 1)
            assert abs(time - times[0]) <= 8 * EPSILON * (sizes / abs(slope) + s)
    assert min(answers.values()) > 20 and len(answers) == 4


# --- exclusion ------------------------------------------------------------------------------------------------
# What may vanish on a Taylor step: nothing with a zero there is left out, and what is far from zero is.

PRINTERS: dict[str, Callable[..., Any]] = {"printed as Python": called, "in machine code": compiled}


def asked(machine: str, columns: Any, s: float, *, every: bool = False) -> tuple[list[bool], bool]:
    """Return the flags of series (order + 1, k) that may be zero on a step, and True if any is set."""
    order, count = len(columns) - 1, columns.shape[1]
    layout = TaylorLayout(2, 2 + count, count, 2, block=2)
    work, doubtful = np.zeros(layout.size(order)), np.full(count + WIDEST_VECTOR, np.nan)
    rows = work[layout.rows :][: (order + 1) * layout.width].reshape(order + 1, layout.width)
    rows[:, layout.watched_at :] = columns
    some = PRINTERS[machine](doubtful_events.form(layout=layout))(s, every, doubtful, work, order)
    return doubtful[:count].astype(bool).tolist(), some


@pytest.mark.parametrize("machine", PRINTERS)
@pytest.mark.parametrize("count", [1, 3, 5, 9])
def test_what_has_a_zero_on_the_step_is_doubtful(machine: str, count: int) -> None:
    chance = np.random.default_rng(count)
    for order in (4, 5, 6, 7, 20):
        for _ in range(20):
            columns = chance.normal(size=(order + 1, count)) * 0.3 ** np.arange(order + 1.0)[:, None]
            columns[0] *= 10.0 ** chance.integers(-2, 2, count)
            s = float(chance.uniform(0.1, 2.0))
            values = np.polynomial.polynomial.polyval(np.linspace(0.0, s, 400), columns)
            crosses = (values.min(axis=1) <= 0) & (values.max(axis=1) >= 0)
            # The rest of the series outweighs the smaller end of its linear part, or the part changes its sign.
            rest = np.abs(columns[2:] * s ** np.arange(2.0, order + 1)[:, None]).sum(axis=0)
            ends = columns[0], columns[0] + columns[1] * s
            expected = (np.minimum(*np.abs(ends)) <= rest) | (ends[0] * ends[1] <= 0)
            result, some = asked(machine, columns, s)
            assert result == expected.tolist() and some is bool(expected.any())
            assert not (crosses & ~expected).any()
