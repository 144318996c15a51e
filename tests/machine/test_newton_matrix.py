"""Newton's matrix of all implicit methods: with the right matrix, one correction solves a linear law.

A wrong matrix costs corrections, which results do not show. So evaluations are counted.
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.algorithm.step.memory import NEWTON
from lagrange.graph.sympy_nodes import to_sympy
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState, Outcome
from lagrange.program.step import Control
from lagrange.statement.coordinate import coordinate, t
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.implicit import ImplicitMethod
from tests.models import TARGETS, build
from tests.trajectory.runs import CONSTRAINED, IMPLICIT, implicit

STEP = 0.5
"""Long beside the times of the motion: a matrix without one of its terms needs many corrections."""


@cache
def linear(target: str, n: int, *, constrained: bool) -> Model:
    """Return coupled oscillators with friction, a gyroscopic term, and forces that depend on time."""
    q = [coordinate(f"q{i}") for i in range(n)]
    kinetic = sum((2 + i) * a.dot**2 for i, a in enumerate(q)) / 2 + sum(a.dot * b.dot for a, b in pairwise(q)) / 3
    potential = sum(sp.Rational(5 + i, 4) * a**2 for i, a in enumerate(q)) + sum(a * b for a, b in pairwise(q)) / 4
    return build(
        target,
        lagrangian=kinetic - potential + q[0] * q[-1].dot,
        coordinates=q,
        forces={a: -sp.Rational(3 + i, 10) * a.dot + sp.cos(t) for i, a in enumerate(q)},
        constraints={"slide": q[0] + 2 * q[1] - q[2] / 3} if constrained else {},
        initial=dict.fromkeys(q, 0.0),
    )


# --- methods of one's own, for what no registered one has -----------------------------------------------------


def two_solves(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    """A step with two solves. The second has two unknowns, each in all residuals and arguments."""
    a = solve(lambda a: f(t + h / 4, y + a * (h / 4)) * 2 - a * 3, lambda: f(t, y))

    def residuals(b: Any, c: Any) -> tuple[Any, Any]:
        first, second = f(t + h / 2, y + b * (h / 3) + c * (h / 5) + a * h), f(t + h, y - b * (h / 7) + c * (h / 2))
        third = f(t, y + b * h)
        return b * 2 - c - first + third * h, c * Fraction(5, 3) + second * 2 - third * 4 + a + b * (h / 3)

    b, c = solve(residuals, (a, a))
    return y + a * (h / 4) + b * (h / 4) + c * (h / 2)


def damped(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    """A step with two solves, error control, and vectors damped by each solve."""
    z = solve(lambda z: f(t + h, y + z) * h - z * 2, y * 0)
    far = solve.damp(h * 2, z)
    w = solve(lambda w: (f(t + h / 2, y + w / 3) + f(t + h, y - w * 2)) * h - w * 5, lambda: f(t, y) * h)
    return y + w, (solve.damp(h / 3, w - z) + solve.damp(-h, far)) * h


def momenta(g: Any, t: Any, q: Any, v: Any, h: Any, solve: Any) -> Any:
    """A step with unknowns in both arguments; both residuals contain momenta and forces with different factors."""
    before, force = g(t, q, v)

    def residuals(a: Any, b: Any) -> tuple[Any, Any]:
        p0, f0 = g(t, q + a * (h / 3) - b * (h / 5), a * 2 - b)
        p1, f1 = g(t + h / 2, q + a * h, b + a / 7)
        p2, f2 = g(t + h, q + b * h, a / 2 + b)
        return p0 + before * 2 - p1 * 3 + f0 * h - f2 * (2 * h), p2 * 2 - force * h + f1 * (h / 2) - p0 + a

    a, b = solve(residuals, (v, v))
    return q + a * h, b


def two_steps(f: Any, t: Any, y: Any, before: Any, h: Any, solve: Any) -> Any:
    k = solve(lambda k: f(t + h, y * 2 - before + k * h) - k * 2 + f(t, before), lambda: f(t, y))
    return y + k * h


def start(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    k, _ = solve(
        lambda k, m: (f(t + h, y + k * (h / 2) + m * (h / 2)) - k, f(t, y + m * h) * 2 - m * 3 + k), (y * 0, y * 0)
    )
    return y + k * h


OWN = {
    "two-solves": ImplicitMethod("two-solves", Claims(1, explicit=False), two_solves),
    "damped": ImplicitMethod("damped", Claims(1, adaptive=True, explicit=False), damped, control=Control(2)),
    "momenta": ImplicitMethod("momenta", Claims(1, explicit=False), momenta, law="momentum"),
    "two-steps": ImplicitMethod("two-steps", Claims(1, explicit=False), two_steps, starter=start),
}
EVERY = (*IMPLICIT, *OWN)


def method_of(name: str) -> ImplicitMethod:
    return OWN[name] if name in OWN else implicit(name)


# --- tests ----------------------------------------------------------------------------------------------------


class Steps:
    """Steps of a method for a linear law, from a random state that satisfies the constraint."""

    def __init__(self, method: ImplicitMethod, model: Model) -> None:
        n, self.size = model.dimension, 2 * model.dimension
        start = np.random.default_rng(1).uniform(-1.0, 1.0, self.size)
        if model.equations.constraints:
            start[[2, n + 2]] = 3 * (start[[0, n]] + 2 * start[[1, n + 1]])
        problem = Problem(model, model.parameter_values(), 0.0, 9.0, start)
        plan = method.plan(problem)
        self.step = plan.step
        self.driver: Any = plan.driver(model, model.parameter_array())
        self.state = DriverState(0.0, 9.0, start, 1e-9, 1e-9, STEP)

    def take(self) -> int:
        """Take a step, and return the number of evaluations of the law."""
        before = self.state.count(DriverState.EVALUATIONS)
        self.state.counts[DriverState.ROWS] = 0
        outcome = self.driver.advance(self.state, 1, np.empty(1), np.empty((5, self.size)))
        # Its equations are solved: an adaptive method may find that its error is above the tolerance.
        solved = self.state.count(DriverState.ROWS) == 1 or self.state.cause is Outcome.STEP_TOO_SMALL
        assert outcome is Outcome.PAUSED and solved
        return self.state.count(DriverState.EVALUATIONS) - before


CASES = [(name, constrained) for name in EVERY for constrained in (False, True)[: 1 + (name in CONSTRAINED)]]


@pytest.mark.few(2)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("n", [3, 5])
@pytest.mark.parametrize(("name", "constrained"), CASES)
def test_a_linear_law_is_solved_by_one_correction(name: str, constrained: bool, n: int, target: str) -> None:
    """A second correction confirms the first one. The slope of a guess is one more evaluation."""
    steps = Steps(method_of(name), linear(target, n, constrained=constrained))
    first, program = steps.step.starter or steps.step, steps.step
    assert steps.take() <= 2 * sum(len(solve.calls) for solve in first.solves) + len(first.calls) + 1
    for _ in range(3):
        assert steps.take() <= 2 * sum(len(solve.calls) for solve in program.solves) + len(program.calls) + 1


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", ["radau3", "radau5", "damped"])
def test_dampers_are_inverses_of_the_identity_less_a_multiple_of_the_derivative(name: str, target: str) -> None:
    model = linear(target, 3, constrained=False)
    steps = Steps(method_of(name), model)
    steps.take()
    layout, work = steps.driver._layout, steps.driver._work
    dampers = [
        work[solve.damper(damp) :][: solve.length * solve.width].reshape(solve.length, solve.width)[:, : solve.length].T
        for solve in layout.solves
        for damp in solve.damped
    ]
    length = work[layout.solves[0].flags + NEWTON.places["matrix_step"]]
    jacobian = model.jacobian(0.0, np.zeros(6))
    assert len(dampers) == len(steps.step.damps) > 0
    for damper, damp in zip(dampers, steps.step.damps, strict=True):
        factor = float(to_sympy(damp.factor, {steps.step.h: sp.Float(length)}))
        assert damper @ (np.eye(6) - factor * jacobian) == pytest.approx(np.eye(6), abs=1e-10)
