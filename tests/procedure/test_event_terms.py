"""The sums of terms on a step tell of its only zero what the isolation of all its zeros finds, or nothing."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest

from lagrange.algorithm.events.constants import MOST_COEFFICIENTS, MOST_ROOTS
from lagrange.algorithm.events.polynomial import PADDED
from lagrange.algorithm.events.roots import roots
from lagrange.algorithm.taylor.event_series import event_terms, only_passage, only_zero
from lagrange.algorithm.taylor.watching import TERM_SUMS
from lagrange.machine.llvm_machine import LlvmMachine
from lagrange.machine.numpy_machine import NumpyMachine

MACHINES = [LlvmMachine(), NumpyMachine()]
EPSILON = 2.0**-52


def told(machine: Any, c: Any, s: float, sign: int, noise: float) -> tuple[int, float]:
    """Return the sign that a series takes on for the only time, 0 for none and 2 for unknown; and the time."""
    order = len(c) - 1
    terms, slopes, sums = np.full(PADDED, math.nan), np.full(PADDED, math.nan), np.empty(len(TERM_SUMS))
    machine.called(event_terms.form())(np.ascontiguousarray(c), 1, order, s, terms, slopes, sums)
    answer = int(machine.called(only_zero.form())(s, order, sign, noise, terms, sums))
    if answer in (0, 2):
        return answer, math.nan
    return answer, s * float(machine.called(only_passage.form())(terms, slopes, sums, order, answer))


@pytest.mark.parametrize("machine", MACHINES, ids=("llvm", "numpy"))
@pytest.mark.parametrize("seed", range(2))
def test_the_only_zero_is_the_one_that_isolation_finds(machine: Any, seed: int) -> None:
    """Slow and fast series, ends near zero, sides that do not fit, terms out of range: where it tells, it is right."""
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
        found, after, near = isolate(c, len(c), s, noise, *side, times, rising, MOST_ROOTS)
        assert (after, near) == (answer or sign, False)
        assert rising[:found].tolist() == ([answer] if answer else [])
        if answer:
            slope = np.polynomial.polynomial.polyval(time, np.polynomial.polynomial.polyder(c))
            sizes = np.abs(c) @ abs(s) ** np.arange(order + 1)
            assert abs(time - times[0]) <= 8 * EPSILON * (sizes / abs(slope) + s)
    assert min(answers.values()) > 20 and len(answers) == 4


def test_places_that_are_near_are_found_from_any_start() -> None:
    """As many coefficients as there may be: the last ones are in no whole block."""
    for count in (4, 5, 6, 7, MOST_COEFFICIENTS):
        c = np.zeros(count)
        c[:3] = -0.5, 0.75, 0.25
        c[-1] += 0.01
        answer, time = told(LlvmMachine(), c, 1.0, -1, 0.0)
        unknown = count > 41
        assert answer == (2 if unknown else 1)
        assert unknown or abs(np.polynomial.polynomial.polyval(time, c)) < 1e-15
