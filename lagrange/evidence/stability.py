"""Linear stability of a step: its effect on an oscillation whose rates are z and its conjugate.

A step program only combines vectors and calls the right-hand side, so on a linear system it is a matrix, and the
unknowns of an implicit step solve linear equations. Tableaus and formulas are not used.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.2, IV.3 and V.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lagrange.errors import StatementError
from lagrange.machine.steps.numbers import numbers_of
from lagrange.program.actions import LAWS, Combination, LawCall, Solve
from lagrange.program.step import StepProgram
from lagrange.statement.number import complex_array
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.plan import Stepped

FloatArray = NDArray[np.float64]

GROWTH_TOLERANCE = 1e-9
"""A growth by less than this is none, per step: eigenvalues of matrices that are not normal lose some digits."""

SEEN = 1e-13
"""Growth of a step that is more than the rounding of its matrix and of its eigenvalues."""

LARGEST_EXTENT, BISECTIONS = 1e4, 60
"""Largest extent that is searched, in units of one over the step, and the number of bisections."""


@dataclass(frozen=True)
class Stability:
    """Where a step does not amplify an oscillation or a decay.

    `real` and `imaginary` are the lengths of the stable parts of the negative real and of the imaginary axis, in units
    of one over the step, infinite if they do not end. A symplectic splitting has no damping; its `real` is NaN.
    """

    real: float
    imaginary: float

    def __repr__(self) -> str:
        return f"<Stability: to {self.real:.6g} on the negative real, {self.imaginary:.6g} on the imaginary axis>"


class _Map:
    """The vectors of a step as linear maps of its initial state: arrays (Z, n, m) for Z systems at once.

    The system is q'' = -k q - c v with the rates z and its conjugate, and a step of 1. n is 2 for a step of y = [q, v],
    else 1, and m is the size of the state.
    """

    def __init__(self, step: StepProgram, z: NDArray[np.complex128]) -> None:
        self.step, self.law = step, LAWS[step.law]
        # A real rate is paired with a slightly smaller one: a double eigenvalue has only half of the digits.
        other = np.where(z.imag == 0, 0.99 * z, z.conj())
        self.k, self.c = (z * other).real, -(z + other).real
        self.length = 2 // self.law.states
        states = self.law.states * (1 if step.starter is None else 2)
        self.size = states * self.length
        self.vectors: dict[int, FloatArray] = {}
        for i in range(states):
            unit = np.zeros((len(z), self.length, self.size))
            unit[:, range(self.length), range(i * self.length, (i + 1) * self.length)] = 1.0
            self.vectors[i] = unit
        # The coefficients of a step of length 1 at t = 0 after one of the same length.
        self.numbers = numbers_of(step, step.scalars(step.numbers), 0.0, 1.0, 1.0)

    def whole(self) -> FloatArray:
        """Return the matrix of the step (Z, m, m); with memory, the state that it starts from comes second."""
        for action in self.step.actions:
            if isinstance(action, LawCall):
                self.call(action)
            elif isinstance(action, Solve):
                self.solve(action)
        results = [self.combined(result) for result in self.step.results]
        if self.step.starter is not None:
            results += [self.vectors[i] for i in range(self.law.states)]
        return np.concatenate(results, axis=1)

    def combined(self, combination: Combination) -> FloatArray:
        """Return a combination of vectors."""
        zero = np.zeros((len(self.k), self.length, self.vectors[0].shape[2]))
        return sum((self.numbers[c] * self.vectors[i] for i, c in combination), zero)

    def call(self, call: LawCall) -> None:
        """Evaluate the law."""
        k, c = self.k[:, None], self.c[:, None]
        arguments = [self.combined(argument) for argument in call.arguments]
        if self.step.law == "rhs":
            q, v = arguments[0][:, 0], arguments[0][:, 1]
            self.vectors[call.first] = np.stack([v, -k * q - c * v], axis=1)
        elif self.step.law == "accelerations":
            self.vectors[call.first] = -k[:, None] * arguments[0]
        else:
            q, v, *multipliers = arguments
            found = [v, -k[:, None] * q - c[:, None] * v]
            # There are no constraints: no force of any, and each is its multiplier; see `lagrange.program.constrained`.
            found += [part for push in multipliers for part in (0.0 * push, push, push)]
            for i, vector in enumerate(found):
                self.vectors[call.first + i] = vector

    def solve(self, solve: Solve) -> None:
        """Find the unknowns: the residuals are linear in columns that stand for them, added to those of the state."""
        given, fresh = self.vectors[0].shape[2], solve.count * self.length
        before = dict(self.vectors)
        for i, vector in before.items():
            self.vectors[i] = np.concatenate([vector, np.zeros((*vector.shape[:2], fresh))], axis=2)
        for j in range(solve.count):
            unknown = np.zeros((len(self.k), self.length, given + fresh))
            columns = range(given + j * self.length, given + (j + 1) * self.length)
            unknown[:, range(self.length), columns] = 1.0
            self.vectors[solve.first + j] = unknown
        for call in solve.calls:
            self.call(call)
        residual = np.concatenate([self.combined(one) for one in solve.residuals], axis=1)
        found = -_solved(residual[:, :, given:], residual[:, :, :given])
        self.vectors = before
        for j in range(solve.count):
            self.vectors[solve.first + j] = found[:, j * self.length : (j + 1) * self.length]


def _solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solutions of systems (Z, m, m), infinite where there is none: at a pole of the step."""
    try:
        return np.asarray(np.linalg.solve(matrices, right), dtype=float)
    except np.linalg.LinAlgError:
        poles = np.linalg.matrix_rank(matrices) < matrices.shape[-1]
        solvable = np.where(poles[:, None, None], np.eye(matrices.shape[-1]), matrices)
        return np.where(poles[:, None, None], np.inf, np.linalg.solve(solvable, right))


def growth(method: Any, z: ArrayLike) -> FloatArray:
    """Return the factor by which a step of a method grows the oscillation of rates z times its length, in z's shape.

    `method` is a registered name, an instance, or its step program; `z` are complex numbers, and one with its conjugate
    is what counts. The factor is the spectral radius of the step's matrix. A splitting knows no damping: its z must be
    imaginary, or a StatementError is raised. At a pole of an implicit step the factor is infinite.
    """
    step = method if isinstance(method, StepProgram) else step_of(method)
    rates = complex_array(z, "z")
    if step.law == "accelerations" and (np.abs(rates.real) > 1e-12 * np.abs(rates)).any():
        raise StatementError(f"{step.name} takes no damping: its stability is a matter of imaginary rates alone.")
    with np.errstate(invalid="ignore"):
        steps = _Map(step, rates.ravel()).whole()
    finite: Any = np.isfinite(steps).all(axis=(1, 2))
    radii = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], steps, 0.0))).max(axis=1)
    return np.where(finite, radii, np.inf).reshape(rates.shape)


def stability(method: Any) -> Stability:
    """Return how far along the negative real and the imaginary axis the step of a method is stable; see `growth`.

    Raises StatementError for a method without a step of its own, such as SciPy's.
    """
    step = method if isinstance(method, StepProgram) else step_of(method)
    real = np.nan if step.law == "accelerations" else _extent(step, -1.0 + 0.0j)
    return Stability(real, _extent(step, 1.0j))


def _extent(step: StepProgram, direction: complex) -> float:
    """Return the first place along a direction behind which a step amplifies."""
    grid = np.concatenate([np.linspace(0.01, 20.0, 2000), np.geomspace(20.0, LARGEST_EXTENT, 400)])
    unstable = growth(step, direction * grid) > 1.0 + GROWTH_TOLERANCE * np.maximum(1.0, grid)
    if not unstable.any():
        return np.inf
    first = int(np.argmax(unstable))
    low, high = (grid[first - 1] if first else 0.0), grid[first]
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        bad = growth(step, [direction * middle])[0] > 1.0 + GROWTH_TOLERANCE * max(1.0, middle)
        low, high = (low, middle) if bad else (middle, high)
    # A step that amplifies from zero on, if only slightly, is stable nowhere.
    before = growth(step, direction * low * np.array([0.5, 0.7, 0.9]))
    return 0.0 if (before > 1.0 + SEEN).all() else float(low)


def step_of(method: Any) -> StepProgram:
    """Return the step of a registered method or an instance. Raises StatementError for one that is no step program."""
    integrator = find(method)
    if not isinstance(integrator, Stepped) or not isinstance(integrator.program, StepProgram):
        raise StatementError(
            f"{integrator.name} has no step of its own that could be looked at: the series of taylor and the solvers "
            "of SciPy and SUNDIALS change their orders on the way. Give a method such as rk4 or radau5."
        )
    return integrator.program
