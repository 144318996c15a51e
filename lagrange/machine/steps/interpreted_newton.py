"""Newton's method for the unknowns of a step, in plain numpy: the place to read what the compiled drivers do."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from lagrange.graph.node import Node
from lagrange.machine.backend import FloatArray, SingularMassMatrix
from lagrange.machine.kernel.arithmetic import FLOATS
from lagrange.machine.python_source import loaded
from lagrange.machine.state import DriverState, Outcome
from lagrange.machine.steps.newton_constants import (
    AGING,
    ASTRAY,
    FARTHEST,
    FRACTION,
    FRESH_RATE,
    GROWTH,
    HOPELESS,
    LARGEST,
    LEAST_RATE,
    LEAST_ROUND_OFF,
    MOST,
    MOST_TIMES,
    NOISE,
    OLD,
    OLDEST,
    OLDEST_RATE,
    ORDERS,
    REST,
    ROUND_OFF,
    SLOW,
    STALLED,
    STALLED_RATE,
    TURNS,
    Kept,
)
from lagrange.procedure.linear.gauss_jordan import inversion, row_stride
from lagrange.program.actions import LAWS, Call, Combination, Damp, Solve, in_doubles, parts
from lagrange.program.program import Program
from lagrange.program.step import StepProgram

S = DriverState
Evaluate = Callable[[float, FloatArray], FloatArray]


class Failure(Exception):
    """A step that cannot be taken, with the outcome."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome)
        self.outcome = outcome


def numbers_of(step: StepProgram, scalars: Program, t: float, h: float, ratio: float) -> dict[Node, float]:
    """Return every number of a step at a time, for a length and its ratio to that of the step before.

    `scalars` is the program of them all, made once for many steps.
    """
    values = FLOATS.evaluate(scalars, t, [h, ratio], [])
    return dict(zip(step.numbers, map(float, values), strict=True))


class Record:
    """A step program run from its record: vectors by number, and the numbers made of t, h and the ratio of steps."""

    def __init__(self, step: StepProgram, law: Evaluate, jacobian: Evaluate) -> None:
        self.step, self.law, self.jacobian = step, law, jacobian
        self.newtons = [Newton(self, solve) for solve in step.solves]
        self._scalars = step.scalars(step.numbers)
        self.vectors: list[FloatArray] = []
        self.lost: list[Any] = [0.0] * step.states
        """What rounding has taken from each state, and what it takes from them in the step being tried."""
        self.trying = self.lost

    def take(
        self, state: DriverState, states: list[FloatArray], h: float, slope: FloatArray | None
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return the new states and the error vectors; `slope` is the first call's, where it is known.

        Raises Failure and SingularMassMatrix.
        """
        step = self.step
        self.state, self.t, self.h = state, state.t, h
        self.use(1.0)
        self.vectors = [*states, *([states[0]] * (step.vectors - len(states)))]
        newtons = iter(self.newtons)
        for action in step.actions:
            if isinstance(action, Call) and slope is not None and action is step.actions[0]:
                self.vectors[action.first] = slope
            elif isinstance(action, Call):
                self.call(action)
            elif isinstance(action, Damp):
                self.vectors[action.result] = self.newtons[action.of].damp(
                    self.number(action.factor), self.sum(action.vector)
                )
            else:
                next(newtons).solve()
        new, self.trying = map(list, zip(*map(self.sum_up, range(step.states)), strict=True))
        return new, [self.sum(error) for error in step.errors]

    def sum_up(self, state: int) -> tuple[FloatArray, Any]:
        """Return a new state and what rounding takes from it, a compensated sum; Knuth, vol. 2, 4.2.2, theorem B."""
        step = self.step
        if not step.compensated(state):
            return self.sum(step.results[state]), 0.0
        y = self.vectors[state]
        move = self.sum(tuple(t for t in step.results[state] if t != (state, step.graph.one))) + self.lost[state]
        total = y + move
        back = total - y
        return total, (y - (total - back)) + (move - back)

    def use(self, ratio: float) -> None:
        """Compute the numbers for the present t and h and a ratio of steps."""
        self._values = numbers_of(self.step, self._scalars, self.t, self.h, ratio)

    def number(self, node: Node) -> float:
        """Return a number of the step."""
        return self._values[node]

    def sum(self, combination: Combination, *, sizes: bool = False) -> FloatArray:
        """Return a linear combination of vectors, or that of their sizes."""
        part: Callable[[Any], Any] = abs if sizes else lambda value: value
        total: FloatArray = np.zeros_like(self.vectors[0])
        if self.step.exact and not sizes:
            combination, scaled = parts(combination, self.step.h)
            slopes = [[part * self.vectors[i] for part in in_doubles(factor)] for i, factor in scaled]
            slope: Any = sum(map(sum, zip(*slopes, strict=True)))
            total = total + self.h * slope
        for vector, factor in combination:
            total = total + part(self.number(factor)) * part(self.vectors[vector])
        return total

    def place(self, call: Call, *, sizes: bool = False) -> FloatArray:
        """Return the arguments of a call, one behind the other."""
        return np.concatenate([self.sum(argument, sizes=sizes) for argument in call.arguments])

    def call(self, call: Call) -> None:
        """Evaluate the law and keep its results as vectors."""
        self.state.counts[S.EVALUATIONS] += 1
        results = self.law(self.number(call.time), self.place(call))
        count = LAWS[self.step.law].results
        self.vectors[call.first : call.first + count] = np.split(results, count)

    def keep(self) -> None:
        """Keep the unknowns of an accepted step, to extrapolate from, and what rounding took from the states."""
        self.lost = self.trying
        for newton in self.newtons:
            newton.keep()


class Newton:
    """One solve, with what it keeps from step to step."""

    def __init__(self, record: Record, solve: Solve) -> None:
        self.record, self.problem = record, solve
        self.adaptive = record.step.control is not None
        self.unknowns = slice(solve.first, solve.first + solve.count)
        self.history: list[FloatArray] = []
        self.order = 1
        self.derivative = self.inverse = np.empty((0, 0))
        self.weights = np.empty(0)
        self.matrix_step = self.old_step = self.age = 0.0
        self.rate = self.noise = 1.0
        self.solved = self.differentiated = False

    def solve(self) -> None:
        """Predict and iterate; where that fails, start again from the guess with a new matrix."""
        if self.adaptive:
            self.weights = self.tolerated()
        if self.history:
            try:
                self.predict()
                self.iterate()
            except (Failure, SingularMassMatrix):
                self.history = []
        if not self.history:
            self.matrix_step, self.rate, self.differentiated = 0.0, 1.0, False
            self.start()
            self.iterate()
        self.solved = True

    def start(self) -> None:
        """Set the unknowns to their guesses."""
        for call in self.problem.preparation:
            self.record.call(call)
        self.record.vectors[self.unknowns] = [self.record.sum(guess) for guess in self.problem.guesses]

    def predict(self) -> None:
        """Extrapolate the unknowns: as the method states, or by a polynomial through those of the last equal steps."""
        record, old = self.record, self.history
        if self.adaptive:
            record.use(record.h / self.old_step)
            record.vectors[self.unknowns] = list(old[0])
            if self.problem.predicted:
                record.vectors[self.unknowns] = [record.sum(one) for one in self.problem.predicted]
        else:
            record.vectors[self.unknowns] = list(sum(old[: self.order][::-1], np.zeros_like(old[0])))

    def iterate(self) -> None:
        """Correct the unknowns until what is left is too small to matter. Raises Failure."""
        record, problem = self.record, self.problem
        previous, since, moved = 0.0, OLD, 0.0
        for turn in range(MOST_TIMES if self.adaptive else MOST):
            for call in problem.calls:
                record.call(call)
            residual = np.concatenate([record.sum(one) for one in problem.residuals])
            if self.matrix_step != record.h:
                self.renew()
                since = 0
            correction = self.inverse @ residual
            for i, part in enumerate(np.split(correction, problem.count), problem.first):
                record.vectors[i] = record.vectors[i] + part
            norm = float(np.sqrt(np.mean((correction * self.weights) ** 2)))
            unit = record.state.reals[S.RTOL] if self.adaptive else ROUND_OFF
            record.state.reals[S.RESIDUAL] = norm * unit
            if not norm < LARGEST:
                # The law is no number there, unless a large correction before has gone astray.
                raise Failure(Outcome.NON_FINITE if previous * unit < ASTRAY else Outcome.DIVERGED)
            moved += norm * unit
            if moved > FARTHEST and not self.adaptive:
                raise Failure(Outcome.DIVERGED)
            if self.enough(turn, norm, previous, since):
                return
            previous, since = norm, since + 1
        raise Failure(Outcome.DIVERGED)

    def enough(self, turn: int, norm: float, previous: float, since: int) -> bool:
        """Return whether the unknowns are good enough; have the matrix made anew where corrections shrink slowly."""
        rate = norm / previous if turn else self.rate
        bound = FRACTION if self.adaptive else REST * self.noise
        round_off = not self.adaptive and turn > 0 and max(norm, previous) <= self.noise
        if norm * rate <= (1 - rate) * bound or round_off:
            self.rate = max(rate, LEAST_RATE) if turn else min(self.rate * AGING, OLDEST_RATE)
            self.age += 1
            tired = turn > 0 and rate > FRESH_RATE
            if not self.adaptive:
                tired = (turn >= TURNS and self.age >= OLD) or self.age >= OLDEST
            self.noise = max(self.noise * NOISE, 1.0)
            if tired:
                self.matrix_step, self.differentiated = 0.0, False
            return True
        if turn and not rate <= SLOW:
            if self.adaptive and not rate <= HOPELESS:
                raise Failure(Outcome.DIVERGED)
            if not self.adaptive and 1 <= since < OLD and rate >= STALLED_RATE and norm < STALLED:
                # A new matrix no longer shrinks the corrections: they are round-off.
                self.noise = 2 * norm
                return True
            if not self.adaptive and 1 <= since < OLD and rate >= GROWTH and norm >= STALLED:
                raise Failure(Outcome.DIVERGED)
            if not self.adaptive and since >= OLD:
                self.matrix_step, self.differentiated = 0.0, False
        return False

    def renew(self) -> None:
        """Make the Newton matrix for the present step, with the derivative of the law that is known or a new one."""
        record, problem = self.record, self.problem
        law = LAWS[record.step.law]
        n = len(record.vectors[0])
        point = None if self.adaptive else problem.calls[(len(problem.calls) - 1) // 2]
        if not self.differentiated:
            where = np.concatenate(record.vectors[: law.states]) if point is None else record.place(point)
            self.derivative = record.jacobian(record.t if point is None else record.number(point.time), where)
            self.differentiated = True
        block = self.derivative.reshape(law.results, n, law.arguments, n)
        matrix = np.zeros((problem.count, n, problem.count, n))
        for i, residual in enumerate(problem.residuals):
            for j in range(problem.count):
                matrix[i, :, j] = self.factor(residual, problem.first + j) * np.eye(n)
                for call in problem.calls:
                    for r in range(law.results):
                        outer = self.factor(residual, call.first + r)
                        for s, argument in enumerate(call.arguments):
                            matrix[i, :, j] += outer * self.factor(argument, problem.first + j) * block[r, :, s]
        self.inverse, bad = inverse(matrix.reshape(problem.count * n, -1))
        self.inverse = -self.inverse
        if bad and law.results == 2 and inverse(block[0, :, 1])[1]:
            # It is the mass matrix dp/dv that has no inverse, and not what the step makes of it.
            raise Failure(Outcome.SINGULAR)
        if point is not None:
            self.weights = self.rounding(point, block)
            self.rate = self.noise = 1.0
            self.age = 0.0
        self.matrix_step = record.h

    def rounding(self, point: Call, block: FloatArray) -> FloatArray:
        """Return weights of corrections against what rounding a residual and its calls does to the unknowns.

        The sizes of the terms of a residual, and J times those of the arguments, are an error of one unit of
        round-off; the inverse takes it to the unknowns. Whatever the units are, no iteration goes below that.
        """
        record, problem = self.record, self.problem
        arguments = [record.sum(argument, sizes=True) for argument in point.arguments]
        sizes = []
        for residual in problem.residuals:
            size = record.sum(residual, sizes=True)
            for r in range(block.shape[0]):
                share = sum(abs(self.factor(residual, call.first + r)) for call in problem.calls)
                for s, argument in enumerate(arguments):
                    size = size + share * (abs(block[r, :, s]) @ argument)
            sizes.append(size)
        weights: FloatArray = 1 / (ROUND_OFF * (abs(self.inverse) @ np.concatenate(sizes)) + LEAST_ROUND_OFF)
        return weights

    def tolerated(self) -> FloatArray:
        """Return weights of corrections by what they move in the arguments of the calls, against the tolerances."""
        record, problem, reals = self.record, self.problem, self.record.state.reals
        weights = []
        for unknown in range(problem.count):
            factors, where = problem.reach(unknown)
            reach = max((abs(record.number(factor)) for factor in factors), default=0.0)
            weights.append(reach / (reals[S.ATOL] + reals[S.RTOL] * abs(record.vectors[where])))
        return np.concatenate(weights)

    def factor(self, combination: Combination, vector: int) -> float:
        """Return the factor of a vector in a combination."""
        return next((self.record.number(factor) for i, factor in combination if i == vector), 0.0)

    def damp(self, factor: float, vector: FloatArray) -> FloatArray:
        """Return (I - factor J)^-1 vector."""
        return self.damper(factor) @ vector

    def damper(self, factor: float) -> FloatArray:
        """Return (I - factor J)^-1."""
        return inverse(np.eye(len(self.derivative)) - factor * self.derivative)[0]

    def kept(self) -> Kept:
        """Return what is kept; the dampers are made from the derivative where they are used."""
        damped = [damp for damp in self.record.step.damps if self.record.step.solves[damp.of] is self.problem]
        return Kept(
            step=self.matrix_step,
            derivative=self.derivative,
            inverse=-self.inverse,
            dampers=tuple(self.damper(self.record.number(damp.factor)) for damp in damped),
            weights=self.weights,
        )

    def keep(self) -> None:
        """Keep the unknowns of an accepted step."""
        if self.solved:
            self.solved = False
            self.old_step = self.record.h
            if self.adaptive:
                self.history = [np.array(self.record.vectors[self.unknowns])]
            else:
                self.difference()

    def difference(self) -> None:
        """Keep the backward differences of the unknowns; extrapolate next from as many as would have come nearest.

        The polynomial through k values goes on with the sum of k differences, and the next of them is its error.
        """
        known, differences = len(self.history), [np.array(self.record.vectors[self.unknowns])]
        for old in self.history:
            differences.append(differences[-1] - old)
        self.history = differences[: ORDERS[-1]]
        weights = self.weights.reshape(differences[0].shape)
        self.order, least = ORDERS[0], math.inf
        for k in ORDERS:
            if k <= known + 1:
                error = float(np.sum((differences[k] * weights) ** 2)) if k <= known else -1.0
                if not error >= least:
                    self.order, least = k, error


def inverse(matrix: FloatArray) -> tuple[FloatArray, bool]:
    """Return the inverse by the procedure that machine code runs, and whether the matrix is singular."""
    n = len(matrix)
    rows = np.zeros((n, row_stride(n)))
    rows[:, :n] = matrix
    entries = rows.ravel().tolist()
    singular = _inversion(n)(entries, [0.0] * (3 * row_stride(n)))
    return np.array(entries).reshape(rows.shape)[:, :n], singular


@cache
def _inversion(n: int) -> Callable[[list[float], list[float]], bool]:
    return loaded(inversion(n))
