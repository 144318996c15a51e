"""Compute the linear stability of an integration method: growth factors and stability intervals of its step.

A step program only combines vectors and calls the right-hand side. On a linear system it is therefore a matrix, and the
unknowns of an implicit step solve linear equations. Tableaus and formulas of the methods are not used.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, IV.2, IV.3 and V.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lagrange.errors import StatementError
from lagrange.machine.drivers import numbers_of
from lagrange.program.step import LAWS, Combination, LawCall, Solve, StepProgram
from lagrange.statement.expression import complex_array
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.plan import Stepped

FloatArray = NDArray[np.float64]

GROWTH_TOLERANCE = 1e-9
"""Growth per step that counts as rounding. Eigenvalues of matrices that are not normal lose some digits."""

SEEN = 1e-13
"""Smallest growth per step that exceeds the rounding errors of the matrix and of its eigenvalues, for small steps."""

LARGEST_EXTENT, BISECTIONS = 1e4, 60
"""Length of the axis on which a stable interval is searched, in units of 1/step; number of bisections for its end."""


@dataclass(frozen=True)
class Stability:
    """Stability intervals of a step: eigenvalues whose oscillation or decay the step does not amplify.

    `real` and `imaginary` are the lengths of the stable intervals on the negative real and on the imaginary axis, in
    units of 1/step; a length may be infinite. `real` is NaN for a symplectic splitting, which cannot treat damping.
    """

    real: float
    imaginary: float

    def __repr__(self) -> str:
        return f"<Stability: to {self.real:.6g} on the negative real, {self.imaginary:.6g} on the imaginary axis>"


class _Map:
    """The vectors of a step as linear maps of its initial state: arrays (Z, n, m) for Z linear systems at once.

    Each system is q'' = -k q - c v with an eigenvalue z and its conjugate; the step length is 1. n is 2 for a step of y
    = [q, v], else 1, and m is the length of the initial state.
    """

    def __init__(self, step: StepProgram, z: NDArray[np.complex128]) -> None:
        self.step, self.law = step, LAWS[step.law]
        # A real eigenvalue is paired with a slightly smaller one, since a double eigenvalue has only half the digits.
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
        # The coefficients of a step of length 1 at t = 0 after a step of the same length.
        self.numbers = numbers_of(step, step.scalars(step.numbers), 0.0, 1.0, 1.0)

    def whole(self) -> FloatArray:
        """Return the matrices (Z, m, m) of a whole step. For a two-step method they map [new state, previous state]."""
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
        """Return a linear combination of the vectors of the step as a linear map of its initial state, (Z, n, m)."""
        zero = np.zeros((len(self.k), self.length, self.vectors[0].shape[2]))
        return sum((self.numbers[c] * self.vectors[i] for i, c in combination), zero)

    def call(self, call: LawCall) -> None:
        """Evaluate the right-hand sides of the linear systems for the action `call` of a step.

        The results are stored as linear maps of the initial state.
        """
        k, c = self.k[:, None], self.c[:, None]
        arguments = [self.combined(argument) for argument in call.arguments]
        if self.step.law == "rhs":
            q, v = arguments[0][:, 0], arguments[0][:, 1]
            self.vectors[call.first] = np.stack([v, -k * q - c * v], axis=1)
        elif self.step.law == "accelerations":
            self.vectors[call.first] = -k[:, None] * arguments[0]
        else:
            # Without rotations local coordinates are coordinates.
            q, v, *multipliers = arguments[:2] if self.step.law == "local" else arguments
            results = [v, -k[:, None] * q - c[:, None] * v]
            results += [q, v] if self.step.law == "local" else []
            # The test equation has no constraints. So the constraint forces are zero, and phi and psi are padding:
            # each of their entries is the multiplier (`lagrange.program.catalogue`).
            results += [part for multiplier in multipliers for part in (0.0 * multiplier, multiplier, multiplier)]
            for i, vector in enumerate(results):
                self.vectors[call.first + i] = vector

    def solve(self, solve: Solve) -> None:
        """Compute the unknowns of implicit equations of the step, and store them as maps of the initial state.

        For the linear test equation the residuals are linear in the unknowns. All vectors get a column for each entry
        of the unknowns, and these columns of the residuals are the matrix of the linear system.
        """
        width, fresh = self.vectors[0].shape[2], solve.count * self.length
        before = dict(self.vectors)
        for i, vector in before.items():
            self.vectors[i] = np.concatenate([vector, np.zeros((*vector.shape[:2], fresh))], axis=2)
        for j in range(solve.count):
            unknown = np.zeros((len(self.k), self.length, width + fresh))
            columns = range(width + j * self.length, width + (j + 1) * self.length)
            unknown[:, range(self.length), columns] = 1.0
            self.vectors[solve.first + j] = unknown
        for call in solve.calls:
            self.call(call)
        residual = np.concatenate([self.combined(combination) for combination in solve.residuals], axis=1)
        solution = -_solved(residual[:, :, width:], residual[:, :, :width])
        self.vectors = before
        for j in range(solve.count):
            self.vectors[solve.first + j] = solution[:, j * self.length : (j + 1) * self.length]


def _solved(matrices: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solutions of linear systems (Z, m, m).

    Solutions of a singular system, a pole of the step, are infinite.
    """
    try:
        return np.asarray(np.linalg.solve(matrices, right), dtype=float)
    except np.linalg.LinAlgError:
        poles = np.linalg.matrix_rank(matrices) < matrices.shape[-1]
        solvable = np.where(poles[:, None, None], np.eye(matrices.shape[-1]), matrices)
        return np.where(poles[:, None, None], np.inf, np.linalg.solve(solvable, right))


def growth(method: Any, z: ArrayLike) -> FloatArray:
    """Return the growth factors of a step for linear oscillations, in the shape of `z`.

    `method` is a registered name, an instance, or a step program. Each complex number in `z` is an eigenvalue times the
    step length; the oscillation has this eigenvalue and its conjugate. The growth factor is the spectral radius of the
    step's matrix; it is infinite at a pole of an implicit step. Raises StatementError for a splitting, which cannot
    treat damping, unless `z` is imaginary.
    """
    step, rates = step_of(method), complex_array(z, "z")
    if step.law == "accelerations" and (np.abs(rates.real) > 1e-12 * np.abs(rates)).any():
        raise StatementError(
            f"{step.name} moves coordinates and velocities in turn, without damping: give imaginary numbers as z."
        )
    with np.errstate(invalid="ignore"):
        steps = _Map(step, rates.ravel()).whole()
    finite: Any = np.isfinite(steps).all(axis=(1, 2))
    radii = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], steps, 0.0))).max(axis=1)
    return np.where(finite, radii, np.inf).reshape(rates.shape)


def stability(method: Any) -> Stability:
    """Return the lengths of the stable intervals of a method on the negative real and on the imaginary axis.

    `method` is a registered name, an instance, or a step program. Raises StatementError for a method without a step
    program, such as SciPy's.
    """
    step = step_of(method)
    real = np.nan if step.law == "accelerations" else _extent(step, -1.0 + 0.0j)
    return Stability(real, _extent(step, 1.0j))


def _extent(step: StepProgram, direction: complex) -> float:
    """Return the largest distance from 0 in a direction up to which the step is stable.

    The result is 0 if the step is stable nowhere, and infinite if it is stable everywhere.
    """
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
    # A step that amplifies slightly at all distances has no stable interval.
    before = growth(step, direction * low * np.array([0.5, 0.7, 0.9]))
    return 0.0 if (before > 1.0 + SEEN).all() else float(low)


def step_of(method: Any) -> StepProgram:
    """Return the step program of a method. Raises StatementError for a method without one, such as taylor."""
    if isinstance(method, StepProgram):
        return method
    integrator = find(method)
    if not isinstance(integrator, Stepped) or not isinstance(integrator.program, StepProgram):
        raise StatementError(
            f"{integrator.name} has no fixed step function to analyse: the series of taylor and the solvers of SciPy "
            "and SUNDIALS vary their order during a run. Give a method such as rk4 or radau5."
        )
    return integrator.program
