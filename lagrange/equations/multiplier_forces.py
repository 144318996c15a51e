"""Forces that contain multipliers of constraints, such as Coulomb friction: multipliers as functions of the state.

With forces Q + B lambda the equations are M a = h + (G^T + B) lambda and G a + gamma = 0, so that
G M^-1 (G^T + B) lambda = -(gamma + G M^-1 h). Put into the forces, these multipliers make a system whose forces depend
on positions, velocities and time alone, and whose constraints have the same multipliers.
Source: P. Painleve, Lecons sur le frottement, 1895; F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral
Contacts, 1996, section 5.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import sympy

from lagrange.equations.terms import differentiable, printable
from lagrange.errors import StatementError, listing
from lagrange.statement.coordinate import check_multipliers, constraint_of, t
from lagrange.statement.statement import REFUSE, Statement

LONGEST = 20_000
"""Most operations of the multipliers: the series of longer ones takes seconds to compile."""


def with_solved_multipliers(statement: Statement) -> Statement:
    """Return the statement with the multipliers in its forces as functions of the state.

    A statement without such forces is returned unchanged. Raises StatementError for multipliers of unknown constraints,
    for forces that are not linear in them, for redundant constraints, for coordinates without inertia, and if the
    multipliers are not determined.
    """
    free = sorted(sympy.Tuple(*statement.forces).free_symbols, key=str)
    names = [name for symbol in free if (name := constraint_of(symbol)) is not None]
    if not names:
        return statement
    check_multipliers(names, "a force", [constraint.name for constraint in statement.constraints], statement.name)
    if statement.redundant != REFUSE:
        raise StatementError(
            f"the forces of {statement.name} contain multipliers, which redundant constraints share in many ways: "
            "leave out the constraints that follow from others, and redundant='allow'."
        )
    table = dict(zip(_names(statement), _multipliers(statement), strict=True))
    stated = {symbol: leaf for leaf, symbol in statement.plain.items()}
    values = {symbol: printable(value).xreplace(stated) for symbol, value in table.items()}
    if sum(int(value.count_ops()) for value in values.values()) > LONGEST:
        raise StatementError(
            f"the multipliers in the forces of {statement.name} are too long to be put in: state fewer coordinates, or "
            "a force in coordinates and velocities."
        )
    return replace(statement, forces=tuple(force.xreplace(values) for force in statement.forces))


def _names(statement: Statement) -> list[Any]:
    return [constraint.multiplier for constraint in statement.constraints]


def split_forces(statement: Statement, forces: Sequence[Any]) -> tuple[list[Any], list[list[Any]]]:
    """Return Q and the rows of B of forces Q + B lambda. Raises StatementError for forces that are not linear."""
    symbols = _names(statement)
    slopes = [[force.diff(s) for s in symbols] for force in forces]
    for name, force, row in zip(statement.names, forces, slopes, strict=True):
        if any(slope.has(*symbols) for slope in row):
            used = listing(str(s) for s in symbols if force.has(s))
            raise StatementError(
                f"the force on {name} is not linear in {used}: give a coefficient in coordinates, velocities and "
                f"parameters times the multiplier, as -mu*{used}*sign({name}_dot), and end the run by an event where "
                "it changes sign."
            )
    return [force.xreplace(dict.fromkeys(symbols, sympy.S.Zero)) for force in forces], slopes


def _multipliers(statement: Statement) -> list[Any]:
    """Return the multipliers in plain symbols, m of them."""
    plain = statement.plain
    q, v = ([plain[x] for x in leaves] for leaves in (statement.coordinates, statement.velocities))

    def read(expression: Any) -> Any:
        return differentiable(expression.xreplace(plain))

    def drift(expression: Any) -> Any:
        """Return the rate at constant velocities."""
        rates = [expression.diff(x) * speed for x, speed in zip(q, v, strict=True)]
        inputs = [expression.diff(u) * rate for u, rate in statement.inputs if rate is not None]
        return sympy.Add(expression.diff(t), *rates, *inputs)

    lagrangian, dissipation = read(statement.lagrangian), read(statement.dissipation)
    applied, pushes = split_forces(statement, [read(force) for force in statement.forces])
    momenta = [lagrangian.diff(speed) for speed in v]
    mass = [[p.diff(speed) for speed in v] for p in momenta]
    bias = [
        lagrangian.diff(x) + force - dissipation.diff(speed) - drift(p)
        for x, speed, force, p in zip(q, v, applied, momenta, strict=True)
    ]
    zeros = [read(constraint.expression) for constraint in statement.constraints]
    rates = [
        drift(phi) if constraint.holonomic else phi
        for constraint, phi in zip(statement.constraints, zeros, strict=True)
    ]
    gradient = [[psi.diff(speed) for speed in v] for psi in rates]
    along = [[line[i] + push for line, push in zip(gradient, row, strict=True)] for i, row in enumerate(pushes)]
    solved = _solved(mass, [[h, *row] for h, row in zip(bias, along, strict=True)])
    if solved is None:
        raise StatementError(
            f"the forces of {statement.name} contain multipliers, and its mass matrix d2L/dv2 is singular: give every "
            "coordinate kinetic energy, or state the force in coordinates and velocities."
        )
    columns = list(zip(*solved, strict=True))
    right = [[-drift(psi) - _dot(line, columns[0])] for psi, line in zip(rates, gradient, strict=True)]
    square = [[_dot(line, column) for column in columns[1:]] for line in gradient]
    multipliers = _solved(square, right)
    if multipliers is None:
        raise StatementError(
            f"the multipliers of {statement.name} are not determined: its constraints depend on one another, or the "
            "forces cancel those of a constraint. Change the forces that contain multipliers."
        )
    return [row[0] for row in multipliers]


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sympy.Add(*(x * y for x, y in zip(a, b, strict=True)))


def _solved(matrix: Sequence[Sequence[Any]], right: Sequence[Sequence[Any]]) -> list[list[Any]] | None:
    """Return X of A X = R by elimination with exchange of rows, or None if a column has no pivot."""
    rows = [[*row, *others] for row, others in zip(matrix, right, strict=True)]
    n = len(rows)
    for k in range(n):
        pivot = next((i for i in range(k, n) if not _is_zero(rows[i][k])), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(n):
            if i != k and rows[i][k] != 0:
                rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


def _is_zero(given: Any) -> bool:
    """Return True if an expression vanishes at a point where its symbols have distinct values."""
    if not given.args:
        return bool(given == 0)
    symbols = sorted(given.free_symbols, key=str)
    value = given.xreplace({s: sympy.Rational(17 + 3 * k, 23 + 5 * k) for k, s in enumerate(symbols)})
    return bool(abs(sympy.N(value, 20)) < 1e-12) if value.is_number else False
