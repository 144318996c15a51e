"""The terms of a sum by the coordinates and velocities in them: a derivative needs only the terms with its variable.

In a net of springs a derivative then costs only a few terms. The cost of a check is proportional to the number of
non-zero entries of the Jacobian.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.evidence.precise import Precise, children
from lagrange.statement.statement import Statement

LOCAL_FROM = 13
"""Smallest number of coordinates for which terms are separated. For fewer, one program for all terms is as fast."""


@dataclass(frozen=True)
class LocalTerms:
    """Programs for the terms of L and D that contain one variable.

    `by_velocity` and `by_place` have a program of L for each velocity and for each coordinate; `dissipation` has one of
    D for each velocity. `touched` is described in `local_terms`.
    """

    by_velocity: Sequence[Precise]
    by_place: Sequence[Precise]
    dissipation: Sequence[Precise]
    touched: Sequence[Sequence[int]]


def local_terms(statement: Statement, digits: int) -> LocalTerms | None:
    """Return programs for the separated terms of a statement, or None if it has few coordinates.

    `touched` has 2n lists: for each coordinate, then for each velocity, the rows of the equations of motion that
    contain it.
    """
    n = len(statement.coordinates)
    if n < LOCAL_FROM:
        return None
    lagrangian = _terms(statement.lagrangian, statement)
    by_velocity = [Precise([part], statement, digits) for part in _by(statement.velocities, lagrangian)]
    by_place = [Precise([part], statement, digits) for part in _by(statement.coordinates, lagrangian)]
    drag = _by(statement.velocities, _terms(statement.dissipation, statement))
    dissipation = [Precise([part], statement, digits) for part in drag]
    touched: list[list[int]] = [[] for _ in range(2 * n)]
    for i, force in enumerate(statement.forces):
        parts = (by_velocity[i], by_place[i], dissipation[i], Precise([force], statement, digits))
        # If p_i contains a coordinate, dp_i/dt contains its velocity.
        rates = {k + n for k in by_velocity[i].entries if k < n}
        for k in sorted(rates.union(*(part.entries for part in parts))):
            touched[k].append(i)
    return LocalTerms(by_velocity, by_place, dissipation, touched)


def _terms(expression: Any, statement: Statement) -> list[tuple[Any, frozenset[Any]]]:
    """Return pairs (term, its coordinates and velocities) of an expression; c (a + b) counts as two terms."""
    moving = frozenset((*statement.coordinates, *statement.velocities))
    found = []
    stack = list(sympy.Add.make_args(expression))
    while stack:
        term = stack.pop()
        factors = [part for part in sympy.Mul.make_args(term) if leaves(part) & moving]
        if term.is_Mul and len(factors) == 1 and factors[0].is_Add:
            rest = term / factors[0]
            stack.extend(rest * part for part in factors[0].args)
        else:
            found.append((term, leaves(term) & moving))
    return found


def _by(variables: Sequence[Any], terms: Sequence[tuple[Any, frozenset[Any]]]) -> list[Any]:
    """Return for each variable the sum of the terms that contain it."""
    parts: dict[Any, list[Any]] = {variable: [] for variable in variables}
    for term, moving in terms:
        for variable in moving & parts.keys():
            parts[variable].append(term)
    return [sympy.Add(*parts[variable]) for variable in variables]


def leaves(expression: Any) -> frozenset[Any]:
    """Return the leaves of an expression: coordinates, velocities, symbols and numbers."""
    seen, stack = {expression}, [expression]
    while stack:
        fresh = [child for child in children(stack.pop()) if child not in seen]
        seen.update(fresh)
        stack.extend(fresh)
    return frozenset(node for node in seen if not children(node))
