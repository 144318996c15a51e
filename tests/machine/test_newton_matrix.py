"""Newton's matrix itself, of every implicit method on both machines, against differences of the step's own residuals.

A wrong matrix only costs corrections, so runs do not show it. Here the step function is called in plain Python, with
arrays, and what it gives to `solve` is differentiated by numbers, without the record that the machines work from. The
law is replaced by its tangent at the point where a machine takes the derivative, for that is what Newton's matrix is
the derivative of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp

from lagrange.algorithm.newton.matrix import LEAST_ROUND_OFF, UNIT_ROUND_OFF
from lagrange.algorithm.step.memory import Kept
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.machine.state import DriverState
from lagrange.program.step import LAWS, Control
from lagrange.statement.coordinate import coordinate, t
from lagrange.trajectory.integrator import Claims, Problem
from lagrange.trajectory.methods.implicit import ImplicitMethod
from tests.models import TARGETS, build
from tests.trajectory.runs import CONSTRAINED, IMPLICIT, implicit

Law = Callable[..., FloatArray]
RTOL, ATOL, START = 1e-6, 3e-7, 0.3
FLOORS: FloatArray = ATOL * np.arange(1.0, 13.0)
"""Absolute tolerances of entries, each another."""


@cache
def coupled(target: str, n: int) -> Model:
    """Return n coordinates with nothing alike in their law: a mass matrix that moves, friction, time, a linear term."""
    q = [coordinate(f"q{i}") for i in range(n)]
    kinetic = sum((2 + sp.sin(a) * sp.Rational(i + 1, 3)) * a.dot**2 for i, a in enumerate(q)) / 2
    kinetic += sum((a.dot * b.dot * sp.cos(a - 2 * b) for a, b in pairwise(q)), sp.S.Zero) / 3
    return build(
        target,
        lagrangian=kinetic
        - sum(sp.Rational(5 + i, 2) * sp.cos(a * (1 + i)) for i, a in enumerate(q))
        + q[0] * q[-1].dot,
        coordinates=q,
        forces={a: -sp.Rational(3 + i, 10) * a.dot * (1 + q[0] ** 2) + sp.cos(t) * q[-1] for i, a in enumerate(q)},
        initial=dict.fromkeys(q, 0.1),
    )


def held(target: str, y: FloatArray) -> Model:
    """Return 3 coordinates held by a constraint that a state satisfies, with a velocity that is changed so."""
    free, symbols = coupled("numpy", 3).statement, sp.symbols("a b c s")
    q, (a, b, c, s) = free.coordinates, symbols
    phi = a**2 + sp.sin(b) * (1 + s / 4) + a * c / 3
    here = dict(zip(symbols, (*y[:3], START), strict=True))
    slopes = [float(sp.diff(phi, symbol).subs(here)) for symbol in symbols]
    y[4] = -(slopes[0] * y[3] + slopes[2] * y[5] + slopes[3]) / slopes[1]
    return build(
        target,
        lagrangian=free.kinetic - free.potential,
        coordinates=list(q),
        forces=dict(zip(q, free.forces, strict=True)),
        constraints={"slide": (phi - phi.subs(here)).subs(dict(zip(symbols, (*q, t), strict=True)))},
        initial=dict.fromkeys(q, 0.1),
    )


# --- methods of one's own, for what no registered one has -----------------------------------------------------


def two_solves(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    """Two solves, the second of two unknowns that both stand in each residual and each argument."""
    a = solve(lambda a: f(t + h / 4, y + a * (h / 4)) * 2 - a * 3, lambda: f(t, y))

    def residuals(b: Any, c: Any) -> tuple[Any, Any]:
        first, second = f(t + h / 2, y + b * (h / 3) + c * (h / 5) + a * h), f(t + h, y - b * (h / 7) + c * (h / 2))
        third = f(t, y + b * h)
        return b * 2 - c - first + third * h, c * Fraction(5, 3) + second * 2 - third * 4 + a + b * (h / 3)

    b, c = solve(residuals, (a, a))
    return y + a * (h / 4) + b * (h / 4) + c * (h / 2)


def damped(f: Any, t: Any, y: Any, h: Any, solve: Any) -> Any:
    """Two solves with control, and vectors that each of them damps, the second one two."""
    z = solve(lambda z: f(t + h, y + z) * h - z * 2, y * 0)
    far = solve.damp(h * 2, z)
    w = solve(lambda w: (f(t + h / 2, y + w / 3) + f(t + h, y - w * 2)) * h - w * 5, lambda: f(t, y) * h)
    return y + w, (solve.damp(h / 3, w - z) + solve.damp(-h, far)) * h


def momenta(g: Any, t: Any, q: Any, v: Any, h: Any, solve: Any) -> Any:
    """Unknowns in both arguments, and momenta and forces in both residuals, each with a number of its own."""
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


# --- the step function in plain Python ------------------------------------------------------------------------


def central(function: Callable[[FloatArray], FloatArray], x: FloatArray, size: float) -> FloatArray:
    """Return the derivative of a function by columns, from differences of order 4."""
    columns = []
    for e in size * np.eye(len(x)):
        near, far = (function(x + k * e) - function(x - k * e) for k in (1, 2))
        columns.append((8 * near - far) / (12 * size))
    return np.array(columns).T


@dataclass
class Solve:
    """What one solve of a step is, by numbers: the point of the law's derivative, that of residuals, and weights."""

    derivative: FloatArray
    matrix: FloatArray
    weights: Callable[[], FloatArray]
    dampers: list[FloatArray]


class Factors:
    """Runs a step function on numbers for vectors, all 0 but one that is 1: with which factors it enters each solve.

    Vectors are numbered as they come: states, results of calls, unknowns. `residuals` and `places` are those of the
    solve `wanted`, by residual, and by call and argument.
    """

    def __init__(self, method: ImplicitMethod, t: float, h: float, one: int, wanted: int) -> None:
        self.results, self.one, self.wanted = LAWS[method.law].results, one, wanted
        self.vectors = self.solved = 0
        self.residuals: tuple[float, ...] = ()
        self.places: list[tuple[float, ...]] = []
        states = LAWS[method.law].states * (1 if method.starter is None else 2)
        method.function(self.f, t, *(self.new() for _ in range(states)), h, self)

    def new(self) -> float:
        self.vectors += 1
        return float(self.vectors - 1 == self.one)

    def f(self, t: float, *arguments: float) -> Any:
        if self.solved == self.wanted:
            self.places.append(arguments)
        made = tuple(self.new() for _ in range(self.results))
        return made if self.results > 1 else made[0]

    def __call__(self, residual: Callable[..., Any], guess: Any, predict: Any = None) -> Any:
        found = guess() if callable(guess) else guess
        several = isinstance(found, (tuple, list))
        unknowns = tuple(self.new() for _ in range(len(found) if several else 1))
        if self.solved == self.wanted:
            self.places = []
        residuals = residual(*unknowns)
        if self.solved == self.wanted:
            self.residuals = tuple(residuals) if several else (residuals,)
        self.solved += 1
        return unknowns if several else unknowns[0]

    def damp(self, factor: float, vector: float) -> float:
        return self.new()


class Reading:
    """Stands for f or g and for `solve` while a step function runs on arrays; finds what each solve is."""

    def __init__(self, method: ImplicitMethod, law: Law, t: float, states: Sequence[FloatArray], h: float) -> None:
        self.method, self.law, self.results = method, law, LAWS[method.law].results
        self.t, self.h, self.vectors = t, h, list(states)
        self.start = np.concatenate(states[: LAWS[method.law].states])
        self.calls: list[tuple[float, FloatArray]] = []
        self.replaced: Law | None = None
        self.solves: list[Solve] = []
        self.starts_with_slope = False
        method.function(self.f, t, *states, h, self)

    def f(self, t: float, *arguments: FloatArray) -> Any:
        """Evaluate the law, or what has taken its place."""
        self.calls.append((float(t), np.concatenate(arguments).astype(float)))
        if not self.solves and self.replaced is None and len(self.vectors) == 1:
            self.starts_with_slope = float(t) == self.t and np.array_equal(self.calls[-1][1], self.start)
        values = np.split((self.replaced or self.law)(*self.calls[-1]), self.results)
        self.vectors += values
        return tuple(values) if self.results > 1 else values[0]

    def __call__(self, residual: Callable[..., Any], guess: Any, predict: Any = None) -> Any:
        found = guess() if callable(guess) else guess
        several = isinstance(found, (tuple, list))
        z = np.array(found if several else [found])
        known, self.vectors = self.vectors, [*self.vectors, *z]

        def off(unknowns: FloatArray) -> FloatArray:
            self.calls, self.vectors = [], [*known, *z]
            returned = residual(*unknowns.reshape(z.shape))
            return np.array(returned, dtype=float).ravel()

        off(z.ravel())
        by_state = self.method.control and self.method.law != "constrained"
        where = (self.t, self.start) if by_state else self.calls[(len(self.calls) - 1) // 2]
        derivative = central(lambda y: self.law(where[0], y), where[1], 1e-3)
        vectors = self.vectors
        self.replaced = lambda _, y: derivative @ y
        matrix = central(off, z.ravel(), 0.1)
        self.replaced = None
        weigh = self.tolerated if self.method.control else self.rounding
        weights = partial(weigh, len(self.solves), vectors, len(known), derivative, matrix)
        self.solves.append(Solve(derivative, matrix, weights, []))
        for _ in range(12):
            z = z - np.linalg.solve(matrix, off(z.ravel())).reshape(z.shape)
        off(z.ravel())
        return tuple(z) if several else z[0]

    def damp(self, factor: float, vector: FloatArray) -> FloatArray:
        """Return (I - factor J)^-1 vector."""
        derivative = self.solves[-1].derivative
        damper = np.array(np.linalg.inv(np.eye(len(derivative)) - factor * derivative), dtype=float)
        self.solves[-1].dampers.append(damper)
        made: FloatArray = damper @ vector
        self.vectors.append(made)
        return made

    def factors(self, count: int, wanted: int) -> list[Factors]:
        """Return the factors of so many vectors in a solve."""
        return [Factors(self.method, self.t, self.h, one, wanted) for one in range(count)]

    def rounding(self, wanted: int, vectors: Any, first: int, derivative: FloatArray, matrix: FloatArray) -> FloatArray:
        """Return weights against what rounding does, to the terms of residuals and to the arguments of calls."""
        factors = self.factors(len(vectors), wanted)
        count, middle = len(factors[0].residuals), (len(factors[0].places) - 1) // 2

        def sizes(entering: list[float]) -> FloatArray:
            made: FloatArray = sum(abs(float(factor) * v) for factor, v in zip(entering, vectors, strict=True))
            return made

        arguments = range(LAWS[self.method.law].arguments)
        moved = abs(derivative) @ np.concatenate([sizes([one.places[middle][s] for one in factors]) for s in arguments])
        terms = [sizes([one.residuals[i] for one in factors]) for i in range(count)]
        for k, one in enumerate(factors[first + count :]):
            part = np.split(moved, self.results)[k % self.results]
            terms = [term + abs(float(one.residuals[i])) * part for i, term in enumerate(terms)]
        off = abs(np.linalg.inv(matrix)) @ np.concatenate(terms)
        weights: FloatArray = 1 / (UNIT_ROUND_OFF * off + LEAST_ROUND_OFF)
        return weights

    def tolerated(self, wanted: int, vectors: Any, first: int, derivative: Any, matrix: FloatArray) -> FloatArray:
        """Return weights of what the unknowns move in the arguments of calls, against the tolerances."""
        states = LAWS[self.method.law].states
        count = len(matrix) * states // len(self.start)
        unknowns = self.factors(len(vectors), wanted)[first : first + count]
        # What a step moves an entry by is a part of its size: an entry may pass through zero.
        moved = abs(self.h * self.law(self.t, self.start)) if self.starts_with_slope else 0.0
        sizes = np.split(FLOORS[: len(self.start)] + RTOL * np.maximum(abs(self.start), moved), states)
        reached = [[max(abs(float(place[s])) for place in one.places) for s in range(states)] for one in unknowns]
        weights: FloatArray = np.concatenate(
            [np.max([reach / size for reach, size in zip(one, sizes, strict=True)], axis=0) for one in reached]
        )
        return weights


# --- what the machines keep -----------------------------------------------------------------------------------


class Steps:
    """Steps of a method from a random state, on a machine, with what it keeps."""

    def __init__(self, name: str, target: str, n: int, seed: int, *, constrained: bool = False) -> None:
        random = np.random.default_rng([n, seed])
        self.h = random.choice([-1, 1]) * random.uniform(0.01, 0.02)
        self.y = [random.uniform(-1, 1, 2 * n)]
        self.method, self.model = method_of(name), held(target, self.y[0]) if constrained else coupled(target, n)
        problem = Problem(self.model, self.model.parameter_values(), START, START + 1, self.y[0])
        plan = self.method.plan(problem)
        self.solves = len(plan.step.solves)
        self.driver: Any = plan.driver(self.model, self.model.parameter_array())
        self.state = DriverState(START, START + np.sign(self.h), self.y[0], RTOL, ATOL, self.h)
        self.state.floors[:] = FLOORS[: 2 * n]
        kernel = self.model.law(LAWS[self.method.law].quantity)
        self.law: Law = lambda t, y: kernel(t, y, self.model.parameter_array())

    def take(self) -> list[Kept]:
        """Try a step."""
        times, rows = np.empty(1), np.empty((5, len(self.y[0])))
        self.state.counts[DriverState.ROWS] = 0
        self.driver.advance(self.state, 1, times, rows)
        self.y += [rows[0].copy()] * self.state.count(DriverState.ROWS)
        return list(self.driver.kept())

    def reading(
        self, method: ImplicitMethod, t: float, *states: FloatArray, law: Any = None, h: float = 0.0
    ) -> Reading:
        parts = [part for y in states for part in np.split(y, LAWS[method.law].states)]
        return Reading(method, law or self.law, t, parts, h or self.h)


def assert_kept(kept: Kept, found: Solve) -> None:
    scale = abs(found.derivative).max()
    assert kept.derivative == pytest.approx(found.derivative, rel=1e-7, abs=1e-8 * scale)
    assert_inverse(kept.inverse, found.matrix)
    assert len(kept.dampers) == len(found.dampers)
    for ours, theirs in zip(kept.dampers, found.dampers, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-7, abs=1e-8)
    assert kept.weights == pytest.approx(found.weights(), rel=1e-6)


def assert_inverse(inverse: FloatArray, matrix: FloatArray) -> None:
    """The derivative of the law is known to 1e-9 from differences, and the matrices are well conditioned."""
    assert inverse.shape == matrix.shape
    assert inverse @ matrix == pytest.approx(np.eye(len(matrix)), abs=1e-7)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("n", "target"), [(1, "numpy"), (2, "numpy"), (1, "llvm"), (2, "llvm"), (3, "llvm"), (5, "llvm")]
)
@pytest.mark.parametrize("name", EVERY)
def test_the_first_matrix_is_the_derivative_of_the_residuals(name: str, n: int, target: str) -> None:
    steps = Steps(name, target, n, seed=1)
    kept, method = steps.take(), steps.method
    if method.starter is not None:
        first = ImplicitMethod("first", method.claims, method.starter)
        starting = steps.reading(first, START, steps.y[0]).solves
        assert len(kept) == 1 + len(starting)
        for ours, theirs in zip(kept[1:], starting, strict=True):
            assert_kept(ours, theirs)
        kept = steps.take()[:1]
        found = steps.reading(method, START + steps.h, steps.y[1], steps.y[0]).solves
    else:
        found = steps.reading(method, START, steps.y[0]).solves
    assert len(kept) == len(found)
    for ours, theirs in zip(kept, found, strict=True):
        assert_kept(ours, theirs)


@pytest.mark.few(2)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", CONSTRAINED)
def test_the_first_matrix_has_the_gradients_of_constraints(name: str, target: str) -> None:
    steps = Steps(name, target, 3, seed=1, constrained=True)
    kept, found = steps.take(), steps.reading(steps.method, START, steps.y[0]).solves
    assert len(steps.y) == 2 and len(kept) == len(found) == 2
    # The second solve begins at multipliers of the first, which error control leaves at its tolerance.
    for ours, theirs in list(zip(kept, found, strict=True))[: 1 if steps.method.control else 2]:
        assert_kept(ours, theirs)


def linear(matrix: FloatArray, _: float, y: FloatArray) -> FloatArray:
    """Return a law that is its own tangent."""
    return matrix @ y


@pytest.mark.few(2)
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("name", EVERY)
def test_a_matrix_that_is_kept_is_that_of_its_step(name: str, target: str) -> None:
    """Whenever it was made, for steps of whatever length, from a derivative of the step or of one before."""
    steps, seen = Steps(name, target, 2, seed=2), 0
    zero = [np.zeros(4)] * (1 if steps.method.starter is None else 2)
    for _ in range(16):
        for i, kept in enumerate(steps.take()[: steps.solves]):
            if kept.step:
                law = partial(linear, kept.derivative)
                found = steps.reading(steps.method, 0.0, *zero, law=law, h=kept.step).solves[i]
                assert_inverse(kept.inverse, found.matrix)
                seen += 1
    assert seen >= 8
