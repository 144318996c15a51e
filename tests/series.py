"""Series in multiple precision, and their residuals in the equations of motion: an independent judge of recurrences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import mpmath
import sympy as sp

from lagrange.equations.euler_lagrange import Equations, euler_lagrange
from lagrange.evidence.precise import Precise
from lagrange.machine.kernel.interpreted import Arithmetic
from lagrange.machine.numpy_machine import Jet
from lagrange.program.series import SeriesProgram
from lagrange.program.taylor import assemblies, series_program, switched_equations
from lagrange.statement.coordinate import t
from lagrange.statement.statement import Statement
from tests.operations import operations

DIGITS = 200
"""Enough for a coefficient of order 12 to be seen in a motion over 1e-12, see `right_orders`."""

CONTEXT: Any = mpmath.MPContext()
CONTEXT.dps = DIGITS
NUMBER = CONTEXT.mpf

MANY_DIGITS = Arithmetic(operations(CONTEXT), NUMBER, object)
"""The operations of a program on numbers of `DIGITS` digits."""


def numbers(values: Sequence[Any]) -> list[Any]:
    return [NUMBER(value) for value in values]


def jet(program: SeriesProgram, parameters: Sequence[Any]) -> Jet:
    return Jet(program, numbers(parameters), MANY_DIGITS)


def values(statement: Statement) -> list[Any]:
    """Return the parameters' default values."""
    return [statement.defaults[p] for p in statement.parameters]


def sides(program: SeriesProgram, parameters: Sequence[Any], time: Any, y: Sequence[Any]) -> list[Any]:
    """Return the signs of the switching surfaces at a state. A surface may depend on the signs of others."""
    result: list[Any] = [NUMBER(1)] * program.sides
    for _ in range(program.sides + 1):
        x = jet(program, [*parameters, *result]).coefficients(NUMBER(time), numbers(y), 0)
        result = [CONTEXT.sign(x[0, surface]) for surface in program.watched[: program.sides]]
    return result


def series(statement: Statement, order: int, time: Any = 0.25, start: Sequence[Any] | None = None) -> Any:
    """Return the coefficients of q and v at a time and a state, (order + 1, 2n)."""
    program, _ = series_program(euler_lagrange(statement))
    return coefficients(program, statement, order, time, start)


def coefficients(
    program: SeriesProgram, statement: Statement, order: int, time: Any = 0.25, start: Sequence[Any] | None = None
) -> Any:
    """Return the Taylor coefficients of q and v by a program, (order + 1, 2n)."""
    y = statement.initial if start is None else start
    parameters = values(statement)
    parameters += sides(program, parameters, time, y)
    result = jet(program, parameters).coefficients(NUMBER(time), numbers(y), order)
    return result[:, : 2 * program.dimension]


def all_forms(equations: Equations) -> list[SeriesProgram]:
    """Return the programs of all forms of the equations, with rates of sums whole and separate."""
    result = assemblies(equations, *switched_equations(equations))
    return [assembly.program("series") for assembly in result]


def right_orders(statement: Statement, result: Any, time: Any = 0.25) -> float:
    """Return the order up to which coefficients of q are right, from the residual of the equations of motion.

    A motion that is right up to order p, with an error d at the next order, has the residual p (p+1) d h^(p-1) at the
    time h. The power follows from doubling h from 1e-12, where later terms are smaller by a factor of 1e-12.
    """
    near, far = (residual(statement, result, time, NUMBER(h) * NUMBER(10) ** -12) for h in (1, 2))
    if near < NUMBER(10) ** (10 - DIGITS):  # a series that ends, as that of an oscillator at rest
        return math.inf
    return float(CONTEXT.log(far / near, 2)) + 1


def residual(statement: Statement, result: Any, time: Any, h: Any) -> Any:
    """Return |d/dt dL/dv - dL/dq - Q + dD/dv| at time + h for the polynomial with these coefficients.

    SymPy differentiates and mpmath evaluates, independent of the graph.
    """
    n = len(statement.coordinates)
    powers = [h**k for k in range(len(result))]
    q = [sum(c * s for c, s in zip(result[:, i], powers, strict=True)) for i in range(n)]
    v = [sum(k * c * powers[k - 1] for k, c in enumerate(result[:, i]) if k) for i in range(n)]
    a = [sum(k * (k - 1) * c * powers[k - 2] for k, c in enumerate(result[:, i]) if k > 1) for i in range(n)]
    parameters = dict(zip(statement.parameters, values(statement), strict=True))
    rows = _law(statement)(q, v, NUMBER(time) + h, parameters)
    width = 2 * n + 1
    left = [rows[i * width : (i + 1) * width] for i in range(n)]
    return max(abs(row[-1] + sum(c * x for c, x in zip(row, (*v, *a), strict=False))) for row in left)


@cache
def _law(statement: Statement) -> Precise:
    """Return, for each coordinate, the coefficients of v and a in the equation of motion, and its other terms."""
    q, v = statement.coordinates, statement.velocities
    moving = [sp.Dummy(real=True) for _ in (*v, *q)]
    there = dict(zip((*v, *q), moving, strict=True))
    back = {symbol: leaf for leaf, symbol in there.items()}

    def plain(expression: Any) -> Any:
        return expression.xreplace({leaf: there[leaf] for leaf in v}).xreplace({leaf: there[leaf] for leaf in q})

    lagrangian, dissipation = plain(statement.lagrangian), plain(statement.dissipation)
    outputs = []
    for place, speed, force in zip(q, v, statement.forces, strict=True):
        momentum = lagrangian.diff(there[speed])
        outputs += [momentum.diff(there[leaf]) for leaf in (*q, *v)]
        outputs.append(momentum.diff(t) - lagrangian.diff(there[place]) - plain(force) + dissipation.diff(there[speed]))
    # SymPy's slope of Max is Heaviside's step, and that of sign an impulse on the surface itself.
    outputs = [output.replace(sp.Heaviside, lambda a, *_: (1 + sp.sign(a)) / 2) for output in outputs]
    outputs = [output.replace(sp.DiracDelta, lambda *_: sp.S.Zero) for output in outputs]
    return Precise([output.xreplace(back) for output in outputs], statement, DIGITS)
