"""Decide which contacts stick, slide or open, and with which forces, by Coulomb's law: a complementarity problem.

Forces f of k contacts cause rates w = A f + b: for each contact the normal component, then the friction components. A
contact pushes, f_n >= 0. It does not penetrate, w_n >= 0. One of both is zero. Friction holds the surfaces, w_t = 0, as
long as |f_t| <= mu f_n with the static coefficient. Otherwise f_t = -mu f_n d with the kinetic coefficient, where d is
the direction of sliding. Rates are accelerations of lasting contacts, or velocities after an impact with impulses f.
Sources: C. Glocker, Set-Valued Force Laws, 2001; R. W. Cottle, J.-S. Pang, R. E. Stone, The Linear Complementarity
Problem, 1992, section 4.4; D. E. Stewart, J. C. Trinkle, Int. J. Numer. Meth. Eng. 39 (1996) 2673.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.linear.complementarity import lemke
from lagrange.machine.backend import FloatArray, Machine

OPEN, CLOSED, SLIDING, STICKING = "open", "closed", "sliding", "sticking"
"""States of a contact. A closed contact without friction is "closed". A closed contact with friction slides or sticks.
"""

NOISE = 1e-10
"""Largest force or rate that counts as zero, as a fraction of its terms. It fits mass matrices with condition numbers
up to 1e5."""

DEPENDENT = 1e-12
"""Largest singular value that counts as zero where forces are computed, as a fraction of the largest singular value."""

SHARED = 1e-6
"""Largest difference of a force between two solutions with the same rates, as a fraction of the larger solution. With a
larger difference the force is not unique."""

MOST_CASES = 1024
"""Largest number of combinations of contact states (open, closed, sliding, sticking) that are all tried. For more
combinations, Lemke's method of pivoting finds one solution."""

TURNS, LEAST_TURN = 300, 2.0**-12
"""Largest number of iterations for the direction in which a body begins to slide in a plane, and smallest relaxation
factor of their steps. The factor is halved if a step overshoots, as with many contacts or near the edge of the friction
cone."""

TURNS_BETWEEN = 20
"""Number of iterations for directions of sliding between two tests for an early end. The iteration ends if at least one
combination of contact states obeys all laws of contact, and all such combinations have converged."""


@dataclass(frozen=True, eq=False)
class Friction:
    """The friction of one contact: the number of slip components, the coefficients, and the direction of sliding.

    `static` and `kinetic` are the coefficients of friction. `way` is a unit vector (components,), or None if the
    surfaces do not slide yet. Without components there is no friction.
    """

    components: int = 0
    static: float = 0.0
    kinetic: float = 0.0
    way: FloatArray | None = None

    def cases(self) -> list[tuple[str, FloatArray]]:
        """Return the possible states of the contact, such as "sliding", each with its direction of sliding.

        A direction has an entry for each row of the contact: zero for the normal row, then one for each slip. All
        entries are zero in the other states, and for sliding in a plane in an unknown direction.
        """
        no_way = np.zeros(1 + self.components)
        if not self.components:
            return [(OPEN, no_way), (CLOSED, no_way)]
        if self.way is not None:
            return [(OPEN, no_way), (SLIDING, np.append(0.0, self.way))]
        ways = [no_way] if self.components > 1 else [np.array([0.0, 1.0]), np.array([0.0, -1.0])]
        return [(OPEN, no_way), (STICKING, no_way), *((SLIDING, way) for way in ways)]


@dataclass(frozen=True, eq=False)
class Balance:
    """A solution of the complementarity problem: `forces` and `rates` (rows,).

    `states` has the state of each contact: open, closed, sliding or sticking. `ways` has the direction of sliding of
    each contact (a unit vector), or None. `shared` are the indices of contacts whose forces are not unique: others
    cause the same rates.
    """

    forces: FloatArray
    rates: FloatArray
    states: tuple[str, ...]
    ways: tuple[FloatArray | None, ...]
    shared: frozenset[int] = frozenset()


def solutions(
    matrix: FloatArray, free: FloatArray, contacts: Sequence[Friction], machine: Machine | None = None
) -> list[Balance]:
    """Return the solutions of the complementarity problem of some contacts, the ones with the fewest sliding first.

    `matrix` (rows, rows) is A, and `free` (rows,) are the rates b without forces. All combinations of contact states
    are tried. If these are too many, Lemke's method finds one solution; `machine` compiles it, or it is plain Python if
    None. Of solutions with the same rates, only the one with the least forces is returned. Surfaces at rest stay so if
    they can. The list is empty if there is no solution.
    """
    rows, cases = _Rows(contacts), [contact.cases() for contact in contacts]
    if math.prod(map(len, cases)) > MOST_CASES:
        return _by_pivoting(matrix, free, rows, machine)
    balances: list[Balance] = []
    for balance in _balances(matrix, free, rows, cases):
        close = 10 * _noise(matrix, free, balance.forces)
        same = (i for i, other in enumerate(balances) if (np.abs(balance.rates - other.rates) <= close).all())
        twin = next(same, None)
        if twin is None:
            balances.append(balance)
            continue
        other = balances[twin]
        size, other_size = (float(np.linalg.norm(solution.forces)) for solution in (balance, other))
        differ = np.abs(balance.forces - other.forces) > SHARED * max(size, other_size)
        shared = other.shared.union(rows.contact[differ].tolist())
        least = balance.states.count(SLIDING) == other.states.count(SLIDING) and size < (1 - NOISE) * other_size
        balances[twin] = replace(balance if least else other, shared=shared)
    return [balance for balance in balances if not any(_displaces(other, balance, rows) for other in balances)]


def _noise(matrix: FloatArray, free: FloatArray, forces: FloatArray) -> FloatArray:
    """Return the sizes (..., rows) below which the rates A f + b count as zero, because they are rounding errors.

    `matrix` (rows, rows) is A, `free` (rows,) is b, and `forces` (..., rows) are f.
    """
    return np.asarray(NOISE * (np.abs(forces) @ np.abs(matrix).T + np.abs(free) + np.abs(free).max(initial=0.0)))


def _displaces(balance: Balance, other: Balance, rows: _Rows) -> bool:
    """Return True if the solution `balance` excludes the solution `other`.

    By Coulomb's law a surface at rest slides only if no force in its friction cone holds it. So `other` is excluded if
    a surface slides in `other` that `balance` holds at rest, and if all surfaces that stick in `other` stick in
    `balance`. The states of further contacts may differ only if kinetic friction is too weak to hold the surface.
    """
    states, other_states = np.array(balance.states), np.array(other.states)
    held = (states == STICKING) & (other_states == SLIDING)
    if not held.any() or ((other_states == STICKING) & (states != STICKING)).any():
        return False
    friction, push = np.sqrt((balance.forces**2) @ rows.members), balance.forces[rows.normals]
    by_static = friction > (rows.kinetic + NOISE * rows.static) * push
    return bool((by_static & held).any() or (states != other_states).sum() == held.sum())


class _Rows:
    """The rows of the complementarity problem of k contacts: a normal row for each contact, then its friction rows.

    A row is a component of the contact force, and the rate along it. `contact` (rows,) is the index of the contact of
    each row. `along` (rows,) is True for friction rows. `normals` (k,) are the indices of the normal rows. `members`
    (rows, k) is True for the friction rows of each contact. `static` and `kinetic` (k,) are coefficients of friction.
    `slides` (k,) is True for contacts that slide already, and `ways` (rows,) are their directions of sliding.
    """

    def __init__(self, contacts: Sequence[Friction]) -> None:
        sizes = [1 + contact.components for contact in contacts]
        self.contact = np.repeat(np.arange(len(contacts)), sizes)
        self.normals = np.cumsum([0, *sizes[:-1]])
        self.along = np.ones(len(self.contact), dtype=bool)
        self.along[self.normals] = False
        self.members = (self.contact[:, None] == np.arange(len(contacts))) & self.along[:, None]
        self.static, self.kinetic = np.array([(surface.static, surface.kinetic) for surface in contacts]).T
        self.slides = np.array([surface.way is not None for surface in contacts])
        ways = [np.zeros(surface.components) if surface.way is None else surface.way for surface in contacts]
        self.ways = np.concatenate([np.append(0.0, way) for way in ways])

    def moving(self, ways: FloatArray) -> NDArray[np.bool_]:
        """Return a mask (C, rows): True for all rows of the contacts whose directions of sliding are not zero.

        `ways` (C, rows) has these directions, for each of C combinations of contact states.
        """
        return np.asarray(((ways != 0) @ self.members)[:, self.contact])

    def directions(self, values: FloatArray) -> FloatArray:
        """Return the direction of the friction components of `values` (C, rows), a unit vector for each contact.

        The result is (C, rows), with C combinations of contact states. It is zero in normal rows, and for contacts
        whose friction components are zero.
        """
        sizes = np.sqrt((values**2) @ self.members)[:, self.contact]
        return np.where(self.along & (sizes > 0), values / np.where(sizes > 0, sizes, 1.0), 0.0)

    def balance(self, forces: FloatArray, rates: FloatArray, states: NDArray[np.str_], ways: FloatArray) -> Balance:
        """Return one solution as a `Balance`: `forces` (rows,), `rates` (rows,), and the `states` (k,) of the contacts.

        `ways` (rows,) has the directions of sliding.
        """
        directions = (ways[self.members[:, i]] if state == SLIDING else None for i, state in enumerate(states))
        return Balance(forces, rates, tuple(states.tolist()), tuple(directions))


def _balances(
    matrix: FloatArray, free: FloatArray, rows: _Rows, cases: Sequence[Sequence[tuple[str, FloatArray]]]
) -> Iterator[Balance]:
    """Yield the solutions among all combinations of contact states, in order of the number of sliding contacts.

    `matrix` (rows, rows) is A, and `free` (rows,) is b. `cases` has the possible states and directions of each contact.
    """
    combinations = sorted(itertools.product(*cases), key=lambda pairs: sum(state == SLIDING for state, _ in pairs))
    states = np.array([[state for state, _ in pairs] for pairs in combinations])
    ways = np.array([np.concatenate([way for _, way in pairs]) for pairs in combinations])
    searched = rows.along & (states == SLIDING)[:, rows.contact] & ~rows.moving(ways)
    if searched.any():
        # First guesses are opposite to forces that would hold all surfaces, or else along the first slip.
        held = np.where(states == SLIDING, STICKING, states)
        forces, _, solved = _forces(matrix, free, rows, held, np.zeros(len(free)))
        first = np.zeros(len(free))
        first[rows.normals[np.bincount(rows.contact) > 1] + 1] = 1.0
        against = -rows.directions(forces)
        ways = np.where(searched, np.where(solved[:, None] & rows.moving(against), against, first), ways)
    share, change, error = np.ones((len(combinations), 1)), np.full(len(combinations), np.inf), np.zeros(ways.shape)
    for turn in range(TURNS):
        forces, rates, solved = _forces(matrix, free, rows, states, ways)
        moving = searched & (rows.directions(rates) != 0)
        turned = np.where(moving, rows.directions(rates), ways)
        last, error, before, change = error, turned - ways, change, np.abs(turned - ways).max(axis=1)
        # A step that overshoots is shortened.
        share[((error * last).sum(axis=1) < 0) | (change > before)] /= 2
        ways = np.where(searched, rows.directions(ways + np.maximum(share, LEAST_TURN) * error), ways)
        turning = solved & (change > 4 * np.finfo(float).eps)
        if not turning.any():
            break
        if turn and turn % TURNS_BETWEEN == 0:
            good = solved & _obeys(rows, states, ways, forces, rates, _noise(matrix, free, forces))
            if good.any() and not (good & turning).any():
                break
    good = solved & (change <= NOISE) & _obeys(rows, states, ways, forces, rates, _noise(matrix, free, forces))
    for c in np.flatnonzero(good).tolist():
        yield rows.balance(forces[c], rates[c], states[c], ways[c])


def _forces(
    matrix: FloatArray, free: FloatArray, rows: _Rows, states: NDArray[np.str_], ways: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return forces and rates (C, rows) for C combinations of contact states, and a mask (C,) of the solvable ones.

    `matrix` (rows, rows) is A, and `free` (rows,) is b. `states` (C, k) are the states of the contacts, and `ways`
    (C, rows) their directions of sliding. The rates of closed gaps, and of slips that stick, are zero. If contacts
    depend on each other, the forces are not unique; the shortest force vector is returned.
    """
    contact_states = states[:, rows.contact]
    active = np.where(rows.along, contact_states == STICKING, contact_states != OPEN)
    pushes = np.eye(len(free)) * active[:, None, :]
    along = np.flatnonzero(rows.along)
    rubs = -rows.kinetic[rows.contact] * ways * (contact_states == SLIDING)
    pushes[:, along, rows.normals[rows.contact[along]]] = rubs[:, along]
    square, right = (matrix @ pushes) * active[:, :, None], (-free * active)[..., None]
    inverse = np.linalg.pinv(square, rcond=DEPENDENT)
    sizes = inverse @ right
    sizes += inverse @ (right - square @ sizes)
    forces = (pushes @ sizes)[..., 0]
    rates = forces @ matrix.T + free
    solved = (~active | (np.abs(rates) <= _noise(matrix, free, forces))).all(axis=1)
    rates[active] = 0.0
    return forces, rates, solved


def _obeys(
    rows: _Rows, states: NDArray[np.str_], ways: FloatArray, forces: FloatArray, rates: FloatArray, noise: FloatArray
) -> NDArray[np.bool_]:
    """Return a mask (C,): True for the combinations of contact states that obey the laws of contact.

    By these laws normal forces push, gap rates are not negative, and friction forces lie in their cones. `states`
    (C, k) are the states of the contacts. `ways` are the directions of sliding, and `noise` the errors of the `rates`.
    These two, `forces` and `rates` are (C, rows).
    """
    weak = NOISE * np.abs(forces).max(axis=1, keepdims=True)
    push, apart = forces[:, rows.normals], rates[:, rows.normals]
    friction = np.sqrt((forces**2) @ rows.members)
    back = (ways * rates) @ rows.members < -(noise[:, :, None] * rows.members).max(axis=1)
    wrong = (push < -weak) | (apart < -noise[:, rows.normals])
    wrong |= (states == STICKING) & (friction > rows.static * push + weak)
    wrong |= (states == SLIDING) & ~rows.slides & back
    return np.asarray(~wrong.any(axis=1))


def _by_pivoting(matrix: FloatArray, free: FloatArray, rows: _Rows, machine: Machine | None) -> list[Balance]:
    """Return a list with one solution by Lemke's method, or an empty list.

    `matrix` (rows, rows) is A, and `free` (rows,) is b. `machine` compiles the method; it is plain Python if None. The
    cone of friction in a plane becomes a pyramid with four sides. A contact that slides already has one unknown: the
    normal force, to which its friction force is proportional. Another contact has one more unknown for each side of its
    pyramid, and its sliding speed as a multiplier, as in Stewart and Trinkle.
    """
    units = np.eye(len(free))
    normals, side_rows = units[rows.normals], np.repeat(np.flatnonzero(rows.along & ~rows.slides[rows.contact]), 2)
    sides, owners = units[side_rows], rows.contact[side_rows]
    sides[1::2] *= -1.0
    resting, index = np.unique(owners, return_inverse=True)
    pushes = np.vstack([normals - rows.kinetic[:, None] * rows.members.T * rows.ways, sides])
    lines = np.vstack([normals, sides])
    k, count = len(normals), len(lines)
    square = np.zeros((count + len(resting),) * 2)
    square[:count, :count] = lines @ matrix @ pushes.T
    side, speed = np.arange(k, count), count + index
    square[side, speed], square[speed, side], square[speed, owners] = 1.0, -1.0, rows.static[owners]
    right = np.concatenate([lines @ free, np.zeros(len(resting))])
    size, solution = len(right), np.empty(len(right))
    memory = np.empty(size * (2 * size + 2)), np.empty(size, dtype=np.int64)
    pivoting: Any = lemke if machine is None else machine.called(lemke.form())
    if not pivoting(size, square.ravel(), right, *memory, solution):
        return []
    forces = solution[:count] @ pushes
    rates = matrix @ forces + free
    noise, weak = _noise(matrix, free, forces), NOISE * float(np.abs(forces).max(initial=0.0))
    slip, errors = np.sqrt((rates**2) @ rows.members), (noise[:, None] * rows.members).max(axis=0)
    is_open = (forces[rows.normals] <= weak) & (rates[rows.normals] > noise[rows.normals])
    cases = [is_open, ~rows.members.any(axis=0), ~rows.slides & (slip <= 10 * errors)]
    states = np.select(cases, [OPEN, CLOSED, STICKING], SLIDING)
    ways = np.where(rows.slides[rows.contact], rows.ways, rows.directions(rates[None])[0])
    polished, exact, solved = _forces(matrix, free, rows, states[None], ways)
    return [rows.balance(polished[0], exact[0], states, ways)] if solved[0] else []
