"""Forces of contacts with Coulomb friction: the complementarity problem of their normal and friction forces.

With k contacts, forces f have rates w = A f + b: for each contact the normal component, then the friction components.
A contact pushes, f_n >= 0, it does not penetrate, w_n >= 0, and one of both is zero. Friction holds the surfaces,
w_t = 0, as long as |f_t| <= mu f_n with the static coefficient; else f_t = -mu f_n d with the kinetic one, where d is
the direction of sliding. Rates are accelerations of lasting contacts, or velocities after an impact with impulses f.
Sources: C. Glocker, Set-Valued Force Laws, 2001; R. W. Cottle, J.-S. Pang, R. E. Stone, The Linear Complementarity
Problem, 1992, section 4.4; D. E. Stewart, J. C. Trinkle, Int. J. Numer. Meth. Eng. 39 (1996) 2673.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lagrange.trajectory.trajectory import FloatArray

OPEN, CLOSED, SLIDING, STICKING = "open", "closed", "sliding", "sticking"
"""States of a contact; a contact without friction is closed."""

NOISE = 1e-10
"""Forces and rates count as zero below this fraction of the terms that make them: round-off of some ten terms, with a
condition of the mass matrix up to 1e5."""

DEPENDENT = 1e-12
"""Equations follow from others if their singular value is below this part of the largest."""

MOST_CASES = 1024
"""Most combinations of states that are all tried. With more, one solution is found by pivoting."""

TURNS = 200
"""Most iterations for the direction in which a body begins to slide in a plane; each halves the error or better."""


@dataclass(frozen=True, eq=False)
class Friction:
    """The friction of one contact: the number of slip components, the coefficients, and the direction of sliding.

    `way` is a unit vector (components,), or None where the surfaces do not slide yet. Without components there is no
    friction.
    """

    components: int = 0
    static: float = 0.0
    kinetic: float = 0.0
    way: FloatArray | None = None

    def cases(self) -> list[tuple[str, FloatArray | None]]:
        """Return the states that are possible, each with its direction of sliding, None where that is to be found."""
        if not self.components:
            return [(OPEN, None), (CLOSED, None)]
        if self.way is not None:
            return [(OPEN, None), (SLIDING, self.way)]
        slides: list[tuple[str, FloatArray | None]] = [(SLIDING, None)]
        if self.components == 1:
            slides = [(SLIDING, np.ones(1)), (SLIDING, -np.ones(1))]
        return [(OPEN, None), (STICKING, None), *slides]


@dataclass(frozen=True, eq=False)
class Balance:
    """A solution: `forces` and `rates` (rows,), the state of each contact, and the direction of those that slide."""

    forces: FloatArray
    rates: FloatArray
    states: tuple[str, ...]
    ways: tuple[FloatArray | None, ...]


def solutions(matrix: FloatArray, bias: FloatArray, contacts: Sequence[Friction]) -> list[Balance]:
    """Return the solutions of the complementarity problem, those that hold the surfaces first.

    `matrix` (rows, rows) is A, `bias` (rows,) is b. All combinations of states are tried, or one solution is found by
    pivoting if these are many. Of solutions with the same rates the one with the least forces counts. The list is
    empty if there is none.
    """
    count = math.prod(len(contact.cases()) for contact in contacts)
    if count > MOST_CASES:
        found = _by_pivoting(matrix, bias, contacts)
        return [] if found is None else [found]
    kept: list[Balance] = []
    for cases in sorted(itertools.product(*(contact.cases() for contact in contacts)), key=_sliding):
        balance = _balance(matrix, bias, contacts, cases)
        if balance is None:
            continue
        twin = next((i for i, other in enumerate(kept) if _same(balance, other, matrix, bias)), None)
        if twin is None:
            kept.append(balance)
        elif _size(balance) < (1 - NOISE) * _size(kept[twin]) and _sliding(cases) == kept[twin].states.count(SLIDING):
            kept[twin] = balance
    return kept


def rows_of(contacts: Sequence[Friction]) -> Iterator[tuple[int, slice]]:
    """Yield the row of the normal component and the rows of the friction components of each contact."""
    row = 0
    for contact in contacts:
        yield row, slice(row + 1, row + 1 + contact.components)
        row += 1 + contact.components


def _sliding(cases: Sequence[tuple[str, FloatArray | None]]) -> int:
    return sum(state == SLIDING for state, _ in cases)


def _size(balance: Balance) -> float:
    return float(np.linalg.norm(balance.forces))


def _noise(matrix: FloatArray, bias: FloatArray, forces: FloatArray) -> FloatArray:
    """Return the rates (rows,) that count as zero."""
    return np.asarray(NOISE * (np.abs(matrix) @ np.abs(forces) + np.abs(bias) + np.abs(bias).max(initial=0.0)))


def _same(one: Balance, other: Balance, matrix: FloatArray, bias: FloatArray) -> bool:
    """Return whether two solutions have the same rates, or differ only in a contact that holds or begins to slide."""
    close = np.abs(one.rates - other.rates) <= 10 * _noise(matrix, bias, one.forces)
    closed = [state != OPEN for state in one.states] == [state != OPEN for state in other.states]
    return bool(close.all()) or (closed and STICKING in (*one.states, *other.states) and one.states != other.states)


def _balance(
    matrix: FloatArray,
    bias: FloatArray,
    contacts: Sequence[Friction],
    cases: Sequence[tuple[str, FloatArray | None]],
) -> Balance | None:
    """Return the forces of one combination of states, or None if it contradicts a law."""
    states, ways = tuple(state for state, _ in cases), [way for _, way in cases]
    searched = {i: along for i, (_, along) in enumerate(rows_of(contacts)) if states[i] == SLIDING and ways[i] is None}
    for i in searched:
        ways[i] = _first_way(matrix, bias, contacts, states, i)
    for _ in range(TURNS):
        solved = _forces(matrix, bias, contacts, states, ways)
        if solved is None:
            return None
        forces, rates = solved
        turned = 0.0
        for i, along in searched.items():
            size, before = float(np.linalg.norm(rates[along])), np.asarray(ways[i])
            ways[i] = way = rates[along] / size if size > 0 else before
            turned = max(turned, float(np.abs(way - before).max()))
        if turned <= 4 * np.finfo(float).eps:
            break
    balance = Balance(forces, rates, states, tuple(ways))
    return balance if turned <= NOISE and _obeys(balance, contacts, _noise(matrix, bias, forces)) else None


def _first_way(
    matrix: FloatArray, bias: FloatArray, contacts: Sequence[Friction], states: Sequence[str], which: int
) -> FloatArray:
    """Return the direction against the force that would hold a contact, as a first guess for its sliding."""
    held = tuple(STICKING if state == SLIDING else state for state in states)
    solved = _forces(matrix, bias, contacts, held, [None] * len(contacts))
    _, along = list(rows_of(contacts))[which]
    force = np.zeros(contacts[which].components) if solved is None else solved[0][along]
    size = float(np.linalg.norm(force))
    return -force / size if size else np.eye(len(force))[0]


def _forces(
    matrix: FloatArray,
    bias: FloatArray,
    contacts: Sequence[Friction],
    states: Sequence[str],
    ways: Sequence[FloatArray | None],
) -> tuple[FloatArray, FloatArray] | None:
    """Return forces and rates (rows,) with zero rates where contacts are closed or stick; None without a solution.

    Contacts that depend on each other share their forces, which are then the least ones.
    """
    columns, zero = [], []
    for (normal, along), contact, state, way in zip(rows_of(contacts), contacts, states, ways, strict=True):
        if state == OPEN:
            continue
        push = np.zeros(len(bias))
        push[normal] = 1.0
        if state == SLIDING:
            push[along] = -contact.kinetic * np.asarray(way)
        columns.append(push)
        zero.append(normal)
        for row in range(along.start, along.stop) if state == STICKING else ():
            columns.append(np.eye(len(bias))[row])
            zero.append(row)
    if not columns:
        return np.zeros(len(bias)), bias.copy()
    pushes = np.column_stack(columns)
    square, right = (matrix @ pushes)[zero], -bias[zero]
    sizes = least_solution(square, right)
    sizes += least_solution(square, right - square @ sizes)
    forces = pushes @ sizes
    rates = matrix @ forces + bias
    if (np.abs(rates[zero]) > _noise(matrix, bias, forces)[zero]).any():
        return None
    rates[zero] = 0.0
    return forces, rates


def least_solution(square: FloatArray, right: FloatArray) -> FloatArray:
    """Return the shortest solution (k,) of equations of which some may follow from others."""
    return np.asarray(np.linalg.lstsq(square, right, rcond=DEPENDENT)[0])


def _obeys(balance: Balance, contacts: Sequence[Friction], noise: FloatArray) -> bool:
    """Return whether forces push, rates separate, and friction is inside its cone, within round-off."""
    weak = NOISE * float(np.abs(balance.forces).max(initial=0.0))
    for (normal, along), contact, state, way in zip(
        rows_of(contacts), contacts, balance.states, balance.ways, strict=True
    ):
        push, friction = balance.forces[normal], balance.forces[along]
        if push < -weak or balance.rates[normal] < -noise[normal]:
            return False
        if state == STICKING and np.linalg.norm(friction) > contact.static * push + weak:
            return False
        begins = state == SLIDING and contact.way is None
        if begins and np.dot(np.asarray(way), balance.rates[along]) < -float(noise[along].max()):
            return False
    return True


def _by_pivoting(matrix: FloatArray, bias: FloatArray, contacts: Sequence[Friction]) -> Balance | None:
    """Return a solution found by Lemke's method, or None; friction in a plane is that of a pyramid of four sides.

    A contact that slides along `way` has its friction force in its column. Another has one unknown for each side of its
    pyramid, and the sliding speed as a multiplier, as in Stewart and Trinkle.
    """
    spans, sides, ratios = [], [], []
    for (normal, along), contact in zip(rows_of(contacts), contacts, strict=True):
        push = np.zeros(len(bias))
        push[normal] = 1.0
        free = contact.components and contact.way is None
        if contact.way is not None:
            push[along] = -contact.kinetic * contact.way
        spans.append((push, np.eye(len(bias))[normal]))
        for row in range(along.start, along.stop) if free else ():
            for sign in (1.0, -1.0):
                sides.append(sign * np.eye(len(bias))[row])
                ratios.append((len(spans) - 1, contact.static))
    k, s = len(spans), len(sides)
    owners = sorted({owner for owner, _ in ratios})
    pushes = np.array([push for push, _ in spans] + sides).T
    seen = np.array([row for _, row in spans] + sides)
    square = np.zeros((k + s + len(owners),) * 2)
    square[: k + s, : k + s] = seen @ matrix @ pushes
    for place, (owner, static) in enumerate(ratios):
        speed = k + s + owners.index(owner)
        square[k + place, speed], square[speed, k + place], square[speed, owner] = 1.0, -1.0, static
    right = np.concatenate([seen @ bias, np.zeros(len(owners))])
    found = lemke(square, right)
    if found is None:
        return None
    forces = pushes @ found[: k + s]
    rates = matrix @ forces + bias
    states, ways = [], []
    weak, noise = NOISE * float(np.abs(forces).max(initial=0.0)), _noise(matrix, bias, forces)
    for (normal, along), contact in zip(rows_of(contacts), contacts, strict=True):
        way, slide = contact.way, float(np.linalg.norm(rates[along]))
        if forces[normal] <= weak and rates[normal] > noise[normal]:
            state: str = OPEN
        elif not contact.components:
            state = CLOSED
        else:
            held = way is None and slide <= 10 * float(noise[along].max())
            state = STICKING if held else SLIDING
            way = rates[along] / slide if way is None and not held else way
        states.append(state)
        ways.append(way)
    polished = _forces(matrix, bias, contacts, states, ways)
    return None if polished is None else Balance(*polished, tuple(states), tuple(ways))


def lemke(matrix: FloatArray, right: FloatArray) -> FloatArray | None:
    """Return z (n,) >= 0 with w = M z + q >= 0 and w z = 0, or None if Lemke's method ends on a ray.

    `matrix` (n, n) is M, `right` (n,) is q. Columns are scaled to the same size; among equal ratios the row with the
    largest pivot leaves.
    """
    n = len(right)
    if (right >= 0).all():
        return np.zeros(n)
    table = np.hstack([np.eye(n), -matrix, -np.ones((n, 1)), right[:, None]])
    basis, entering, row = list(range(n)), 2 * n, int(np.argmin(right))
    for _ in range(50 * n + 50):
        table[row] /= table[row, entering]
        for other in range(n):
            if other != row:
                table[other] -= table[other, entering] * table[row]
        leaving, basis[row] = basis[row], entering
        if leaving == 2 * n:
            found = np.zeros(2 * n + 1)
            found[basis] = table[:, -1]
            return found[n : 2 * n]
        entering = leaving + n if leaving < n else leaving - n
        column = table[:, entering]
        able = np.flatnonzero(column > NOISE * max(1.0, float(np.abs(column).max())))
        if not len(able):
            return None
        ratios = table[able, -1] / column[able]
        least = able[ratios <= ratios.min() + NOISE * max(1.0, abs(float(ratios.min())))]
        artificial = [i for i in least if basis[i] == 2 * n]
        row = int(artificial[0] if artificial else least[np.argmax(column[least])])
    return None
