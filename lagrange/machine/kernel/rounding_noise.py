"""The rounding noise of a program's outputs: rounding errors of its operations, propagated through the program.

Each number has an error bound. The error of a result is its own rounding plus its change when its arguments change
by their errors. A linear system carries the noise of its right-hand side through the inverse of its matrix.
Source: N. J. Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, 3.3 and 7.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lagrange.machine.kernel.interpreted import OPERATIONS, Arithmetic
from lagrange.program.program import Program

FloatArray = NDArray[np.float64]

UNIT = 2.0**-53
"""Unit of round-off of doubles, 2**-53."""

NO_PIVOT = 1e-12
"""Smallest pivot, relative to the terms that it is a sum of, that needs no row exchange."""

EXACT_OPERATIONS = frozenset(("neg", "abs", "min", "max", "select"))
"""Operations that do not round."""

JUMPING = frozenset(("sign", "less", "less_equal", "equal", "and", "or", "not"))
"""Operations whose noise is set to zero, because their values jump. A jump of a force is not rounding, even for a state
on its surface.
"""


class Noisy(NamedTuple):
    """A number, or the entries of a vector or matrix, with a bound of its rounding error: the noise."""

    value: Any
    noise: Any


def _noisy(name: str) -> Callable[..., Noisy]:
    """Return a function that applies the operation `name` to numbers with error bounds.

    An argument lies in the interval of its value plus or minus its error. The error that it causes in the result is
    the change of the result at the ends of this interval.
    """
    operation, rounding = OPERATIONS[name], 0.0 if name in EXACT_OPERATIONS else UNIT

    def apply(*args: Noisy) -> Noisy:
        values = [number.value for number in args]
        value = operation(*values)
        if name in JUMPING:
            return Noisy(value, 0.0)
        noise = rounding * abs(float(value))
        for k, number in enumerate(args):
            if number.noise:
                ends = [
                    operation(*values[:k], number.value + sign * number.noise, *values[k + 1 :]) for sign in (-1, 1)
                ]
                # The change may be lost in rounding, as in 1 + x. So the error also includes the distance of each end
                # from the value.
                noise += float(np.fmax(abs(float(ends[1]) - float(value)), abs(float(ends[0]) - float(value))))
        return Noisy(value, noise)

    return apply


def _linear(name: str) -> Callable[..., Noisy]:
    """Return a function that adds, subtracts, multiplies or divides numbers with error bounds.

    `name` is the operation. The bound of the result comes from a formula. Unlike a difference of values, the formula
    also gives errors below the spacing of doubles.
    """
    operation = OPERATIONS[name]

    def apply(*args: Noisy) -> Noisy:
        (a, da), (b, db) = args[:2]
        value = operation(*(number.value for number in args))
        if name == "div":
            carried = (da + abs(value) * db) / abs(b) if b else np.inf
        elif name in ("mul", "fma"):
            carried = abs(b) * da + abs(a) * db + sum(number.noise for number in args[2:])
        else:
            carried = da + db
        return Noisy(value, UNIT * abs(value) + carried)

    return apply


def _factor(order: int, *entries: Noisy) -> Noisy:
    """Return the symmetric matrix with the lower triangle `entries` by rows, with an error bound for each entry."""
    rows = np.tril_indices(order)
    value, noise = np.zeros((2, order, order))
    value[rows], noise[rows] = [number.value for number in entries], [number.noise for number in entries]
    low = np.tril_indices(order, -1)
    value[low[::-1]], noise[low[::-1]] = value[low], noise[low]
    return Noisy(value, noise)


def _factorization_sizes(matrix: FloatArray) -> FloatArray:
    """Return |L| |D| |L^T| (n, n) for a symmetric matrix M = L D L^T (n, n).

    Return |M| if a pivot is too small for these factors. An entry may be zero in M but not in the factors: a
    constraint adds G M^-1 G^T to the zero block of M. Source: Higham, theorem 10.3.
    """
    sizes, remainder = abs(matrix), matrix.copy()
    for k in range(len(matrix)):
        if abs(remainder[k, k]) <= NO_PIVOT * sizes[k, k]:
            return abs(matrix)
        terms = np.outer(remainder[k + 1 :, k], remainder[k, k + 1 :] / remainder[k, k])
        remainder[k + 1 :, k + 1 :] -= terms
        sizes[k + 1 :, k + 1 :] += abs(terms)
    return sizes


def _solve(order: int, matrix: Noisy, *right: Noisy) -> list[Noisy]:
    """Return the solution of a linear system with error bounds: |M^-1| times the error bounds of the residual.

    `order` is the size of the matrix M, and `matrix` has its entries. `right` are the entries of the right-hand side.
    The errors include the rounding errors of the factorization of M.
    """
    value, noise = np.array([number.value for number in right]), np.array([number.noise for number in right])
    inverse = np.linalg.inv(matrix.value)
    solution = inverse @ value
    left = noise + (matrix.noise + order * UNIT * _factorization_sizes(matrix.value)) @ abs(solution)
    return list(map(Noisy, solution, abs(inverse) @ left))


_LINEAR = ("add", "sub", "mul", "div", "fma")
_NOISY = Arithmetic(
    {name: _linear(name) if name in _LINEAR else _noisy(name) for name in OPERATIONS},
    lambda value: Noisy(np.float64(value), 0.0),
    object,
    {"factor": _factor, "solve": _solve},
)
"""Arithmetic table for numbers with noise."""


def rounding_noise(program: Program, t: float, y: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return a bound of the rounding error of each output of a program at a state y (2n,).

    It is NaN if a matrix in the program is singular.
    """
    state = [Noisy(value, abs(value) * UNIT) for value in y]
    try:
        outputs = _NOISY.evaluate(program, Noisy(t, 0.0), state, [Noisy(value, 0.0) for value in parameters])
    except (np.linalg.LinAlgError, ArithmeticError, ValueError):
        return np.full(len(y), np.nan)
    return np.array([output.noise for output in outputs])
