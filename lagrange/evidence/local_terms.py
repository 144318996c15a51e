"""The terms of a sum by the coordinates and velocities in them: a derivative needs only the terms with its variable.

In a net of springs a derivative then costs as much as its few neighbours, and a check grows as the number of entries
of the Jacobian that are not zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from lagrange.evidence.precise import Precise, children
from lagrange.statement.statement import Statement

LOCAL_FROM = 13
"""Number of coordinates from which terms are taken apart. For fewer, one program for all terms is as fast."""


@dataclass(frozen=True)
class LocalTerms:
    """L by each velocity and by each coordinate, and D by each velocity, as programs; `touched` see `local_terms`."""

    by_velocity: Sequence[Precise]
    by_place: Sequence[Precise]
    dissipation: Sequence[Precise]
    touched: Sequence[Sequence[int]]


def local_terms(statement: Statement, digits: int) -> LocalTerms | None:
    """Return the terms of a statement taken apart, or None for a small one.

    `touched` has for each coordinate, then for each velocity, the rows of the equations of motion in which it stands.
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
        # A coordinate in p_i has its velocity in dp_i/dt.
        rates = {k + n for k in by_velocity[i].entries if k < n}
        for k in sorted(rates.union(*(part.entries for part in parts))):
            touched[k].append(i)
    return LocalTerms(by_velocity, by_place, dissipation, touched)


def _terms(expression: Any, statement: Statement) -> list[tuple[Any, frozenset[Any]]]:
    """Return the terms of a sum, each with the coordinates and velocities in it; c (a + b) has two terms."""
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
    """Return for each variable the sum of the terms in which it stands."""
    found: dict[Any, list[Any]] = {variable: [] for variable in variables}
    for term, moving in terms:
        for variable in moving & found.keys():
            found[variable].append(term)
    return [sympy.Add(*found[variable]) for variable in variables]


def leaves(expression: Any) -> frozenset[Any]:
    """Return the coordinates, velocities, symbols and numbers that an expression is computed from."""
    seen, stack = {expression}, [expression]
    while stack:
        fresh = [child for child in children(stack.pop()) if child not in seen]
        seen.update(fresh)
        stack.extend(fresh)
    return frozenset(node for node in seen if not children(node))
