"""Each step as it was written, in many digits: its order, its symmetry and its symplecticity, as they are claimed."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
import pytest

from lagrange.program.step import StepProgram
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.methods.verner9 import MATRIX, B
from tests.models import model
from tests.trajectory.runs import SPLITTINGS, STEPPED, stepped

Rhs = Callable[[float, Any], Any]

EXPLICIT = tuple(name for name in STEPPED if find(name).claims.explicit)

PROBLEM = Problem(model("oscillator"), {}, 0.0, 1.0, np.zeros(2))
COARSE = 2
"""A step that is long enough for order 9 to be visibly not symplectic."""


def driven_pendulum(t: Any, y: Any) -> Any:
    return np.array([y[1], -mpmath.sin(y[0]) * (1 + t)])


def henon_heiles(t: Any, y: Any) -> Any:
    return np.array([y[2], y[3], -y[0] - 2 * y[0] * y[1], -y[1] - y[0] ** 2 + y[1] ** 2])


def double_pendulum(t: Any, y: Any) -> Any:
    """Two equal masses and rods: the kinetic energy does not separate."""
    a, b, va, vb = y
    c, s = mpmath.cos(a - b), mpmath.sin(a - b)
    f, g = -(vb**2) * s - 2 * mpmath.sin(a), va**2 * s - mpmath.sin(b)
    return np.array([va, vb, (f - c * g) / (2 - c**2), (2 * g - c * f) / (2 - c**2)])


def accelerations_of(law: Rhs) -> Rhs:
    return lambda t, q: law(t, np.concatenate([q, q * 0]))[len(q) :]


def precise_step(step: StepProgram, law: Rhs, t: Any, y: Any, h: Any) -> Any:
    """Take the step as it was written, in the arithmetic of its arguments."""
    n = len(y) // 2
    if step.partitioned:
        return np.concatenate(step.function(accelerations_of(law), t, y[:n], y[n:], h))
    return step.function(law, t, y, h)


def precise_start(law: Rhs) -> Any:
    return np.array([mpmath.mpf(x) for x in ("0.4", "0.3", "0.2", "-0.5")[: 2 if law is driven_pendulum else 4]])


PRECISE = [
    (name, law)
    for name in EXPLICIT
    for law in (driven_pendulum, henon_heiles if name in SPLITTINGS else double_pendulum)
]


def verner9_in_digits(f: Rhs, t: Any, y: Any, h: Any) -> Any:
    """The step with the coefficients as they are published: rounded to doubles they hide its order."""
    slopes: list[Any] = []
    for words in map(str.split, MATRIX):
        row = [mpmath.mpf(word) for word in words]
        moved = sum((a * s for a, s in zip(row, slopes, strict=True) if a), y * 0)
        slopes.append(f(t + sum(row) * h, y + h * moved))
    return y + h * sum(mpmath.mpf(b) * s for b, s in zip(B.split(), slopes, strict=True))


@pytest.mark.parametrize(("name", "law"), PRECISE)
def test_the_order_without_round_off(name: str, law: Rhs) -> None:
    """At 60 digits, one step less two of half the size is of order p + 1, in the mean over six places.

    What is measured approaches p as the step goes to 0, in proportion to it, and is extrapolated by that. It ends
    where the coefficients are felt that were rounded to doubles.
    """
    step: Any = stepped(name, 1.0).plan(PROBLEM).step
    if name == "verner9":
        step, floor = replace(step, function=verner9_in_digits), 1e-25
    else:
        floor = 3e-16
    rng, changes = np.random.default_rng(1), []
    with mpmath.workdps(60):
        size = 2 if law is driven_pendulum else 4
        starts = [np.array([mpmath.mpf(x) for x in rng.uniform(-0.5, 0.5, size)]) for _ in range(6)]
        for power in range(1, 10):
            t, h = mpmath.mpf("0.3"), mpmath.mpf(2) ** -power
            total = mpmath.mpf(0)
            for y in starts:
                half = precise_step(step, law, t + h / 2, precise_step(step, law, t, y, h / 2), h / 2)
                total += sum((precise_step(step, law, t, y, h) - half) ** 2)
            if mpmath.sqrt(total) < floor * h:
                break
            changes.append(mpmath.sqrt(total))
        orders = [float(mpmath.log(a / b, 2)) - 1 for a, b in itertools.pairwise(changes)]
    assert len(orders) >= 2
    assert 2 * orders[-1] - orders[-2] == pytest.approx(find(name).claims.order, abs=0.15), orders


def precise_defect(step: StepProgram, law: Rhs, h: Any, y: Any) -> float:
    """Return how far the Jacobian J of the step is from J^T W J = W in (q, p = v), by differences at 60 digits."""
    d = mpmath.mpf(10) ** -18
    columns = []
    for e in np.eye(len(y), dtype=int):
        there, back = (precise_step(step, law, mpmath.mpf(0), y + side * d * e, h) for side in (1, -1))
        columns.append((there - back) / (2 * d))
    jacobian, n = np.array(columns).T, len(y) // 2
    w = np.block([[np.zeros((n, n), int), np.eye(n, dtype=int)], [-np.eye(n, dtype=int), np.zeros((n, n), int)]])
    return float(np.abs(jacobian.T @ w @ jacobian - w).max())


@pytest.mark.parametrize("law", [driven_pendulum, henon_heiles])
@pytest.mark.parametrize("name", EXPLICIT)
def test_the_step_itself_is_symplectic_or_clearly_not(name: str, law: Rhs) -> None:
    step = stepped(name, 1.0).plan(PROBLEM).step
    with mpmath.workdps(60):
        error = precise_defect(step, law, mpmath.mpf(COARSE), precise_start(law))
    if find(name).claims.symplectic:
        assert error < 1e-12  # it is 1e-16: the fractions of the steps are doubles, and each flow is symplectic itself
    else:
        assert error > 1e-6


@pytest.mark.parametrize("name", EXPLICIT)
def test_a_step_back_undoes_a_step_where_that_is_claimed(name: str) -> None:
    step = stepped(name, 1.0).plan(PROBLEM).step
    with mpmath.workdps(60):
        start, h = precise_start(henon_heiles), mpmath.mpf(1)
        there = precise_step(step, henon_heiles, mpmath.mpf(0), start, h)
        error = float(max(abs(precise_step(step, henon_heiles, h, there, -h) - start)))
    if find(name).claims.symmetric:
        assert error < 1e-50
    else:
        assert error > 1e-9
