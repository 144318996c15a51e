"""Root isolation as a procedure: printers and interpreter agree, on polynomials ordinary and extreme."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.events.constants import MOST_COEFFICIENTS, MOST_ROOTS, TOO_MANY, UNFIT
from lagrange.algorithm.events.roots import roots
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.numpy_machine import NumpyMachine
from lagrange.procedure.interpreter import OPERATIONS, run
from tests.covering import Share

EPSILON = 2.0**-52

LLVM, PYTHON = LlvmMachine().called(roots.form()), NumpyMachine().called(roots.form())


def interpreted(*args: Any) -> Any:
    return run(roots.form(), *args)


def polynomials(seed: int, count: int) -> Iterator[np.ndarray[Any, np.dtype[np.float64]]]:
    """Coefficients on [0, 1]: any, with roots inside that may be double or close, and those of waves."""
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
    """Coefficients, their number, the length of the step, noise, the side before, and whether no step follows."""
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
    found = isolate(*case, times, rising, room)
    assert np.isnan(times[room:]).all() and (rising[room:] == 7).all(), "nothing is written beyond the room"
    met = max(found[0], 0)
    return tuple(map(int, found)), times[:met].tolist(), rising[:met].tolist()


@pytest.mark.few
@pytest.mark.parametrize("seed", range(8))
def test_machine_code_finds_what_the_interpreter_finds(seed: int, share: Share) -> None:
    for case in cases(seed, share(150)):
        assert outcome(LLVM, case) == outcome(interpreted, case), case


@pytest.mark.few
@pytest.mark.parametrize("seed", range(8))
def test_python_finds_what_the_interpreter_finds(seed: int, monkeypatch: pytest.MonkeyPatch, share: Share) -> None:
    """To the last bit where products and sums are rounded one by one, as in Python."""
    monkeypatch.setattr("lagrange.procedure.interpreter.OPERATIONS", {**OPERATIONS, "fma": lambda a, b, c: a * b + c})
    for case in cases(seed, share(150)):
        assert outcome(PYTHON, case) == outcome(interpreted, case), case


@pytest.mark.few
@pytest.mark.parametrize("seed", range(8))
def test_python_decides_as_machine_code_does(seed: int) -> None:
    """The places differ by what the rounding of products does to a root."""
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
    (found, sign, near), times, rising = outcome(isolate, case)
    assert (found, sign, near) == (3, -1, False) and rising == [-1, 1, -1]
    assert times == pytest.approx([k * math.pi / 20 for k in (1, 3, 5)], rel=1e-13)
    assert outcome(isolate, case, room=3)[0][0] == 3
    for room in (0, 1, 2):
        assert outcome(isolate, case, room=room)[0][0] == TOO_MANY


@pytest.mark.parametrize("isolate", [interpreted, LLVM, PYTHON], ids=["interpreter", "llvm", "python"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_told(isolate: Callable[..., Any], bad: float) -> None:
    for c, h, noise in (([1.0, bad], 1.0, 0.0), ([1.0, 2.0], bad, 0.0), ([1.0, 2.0], 1.0, bad), ([bad], 1.0, 0.0)):
        found, _, _ = outcome(isolate, (np.array(c), len(c), h, noise, 1, False, False))
        assert found[0] == UNFIT
