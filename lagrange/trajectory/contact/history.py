"""The history of contacts along a run: modes with their times, impacts, forces, and the energy that is lost."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from lagrange.errors import StatementError
from lagrange.machine.model import Model
from lagrange.statement.contact import Contact
from lagrange.statement.coordinate import check_multipliers, constraint_of, multiplier
from lagrange.statement.expression import ByName
from lagrange.statement.expression import expression as expression_of
from lagrange.trajectory.contact.impacts_as_resets import sliding_friction
from lagrange.trajectory.contact.modes import Mode, modes_of
from lagrange.trajectory.contact.stick_or_slide import CLOSED, OPEN, SLIDING, STICKING
from lagrange.trajectory.trajectory import FloatArray, Trajectory, segment_numbers

GAUSS_POINTS = 12
"""Number of points of Gauss's rule on each interval over which the power of friction is integrated. The rule is exact
for polynomials of degree 23."""

MOST_HALVINGS, AGREEMENT = 8, 1e-13
"""Limits of the halving of intervals over which the power of friction is integrated: the largest number of halvings,
and the error, as a fraction of the dissipated energy, below which no interval is halved."""

TIME, IMPULSE, LOST, FRICTION = range(4)
"""Columns of impacts: time, normal impulse, energy that is lost, and first component of the friction impulse."""


@dataclass(frozen=True)
class Impact:
    """An impact of one contact: time, normal impulse, friction impulse (components,), and the energy that is lost."""

    t: float
    impulse: float
    friction_impulse: tuple[float, ...]
    energy_lost: float


@dataclass(frozen=True, eq=False)
class ContactHistory:
    """The history of contacts along a run: the segments, each with its mode, and the impacts.

    `begins` (s,) are the times at which segments begin, and `modes` their modes (the state of each contact). `impacts`
    has an array (k, 3 + slips) for each contact: time, normal impulse, energy lost, friction impulse. `rests` has for
    each contact the times at which accumulating impacts end. `rubbed` (N,) is the energy that sliding has dissipated up
    to each output, in a run that was read from a file. In other runs it is None, and the energy is computed.
    """

    begins: FloatArray
    modes: tuple[Mode, ...]
    impacts: tuple[FloatArray, ...]
    rests: tuple[tuple[float, ...], ...]
    rubbed: FloatArray | None = None


def stored_history(arrays: Mapping[str, Any], contacts: Sequence[Contact]) -> ContactHistory:
    """Return the history of contacts from the arrays in a file, by name, as `ContactRun.arrays` returned them.

    Raises StatementError if the arrays do not fit the contacts.
    """
    modes = tuple(
        Mode(tuple(states), tuple(ways), None if independent is None else tuple(independent), tuple(bouncing), *others)
        for states, ways, independent, bouncing, *others in json.loads(str(arrays["modes"]))
    )
    if not {state for mode in modes for state in mode.states} <= {OPEN, CLOSED, SLIDING, STICKING}:
        raise StatementError("the contact modes in the file have states that are not known.")
    impacts = tuple(np.asarray(arrays[f"impacts_{i}"]) for i in range(len(contacts)))
    matching = {len(mode.states) == len(contacts) == len(mode.ways) for mode in modes}
    wide = [rows.shape[1:] == (FRICTION + len(stated.slip),) for rows, stated in zip(impacts, contacts, strict=True)]
    if matching != {True} or len(arrays["begins"]) != len(modes) or not all(wide):
        raise StatementError("the contact modes in the file do not fit the contacts of its system.")
    rests = tuple(tuple(arrays[f"rests_{i}"].tolist()) for i in range(len(contacts)))
    return ContactHistory(arrays["begins"], modes, impacts, rests, arrays["rubbed"])


@dataclass(frozen=True, eq=False)
class ContactRun:
    """The contacts along a run of a `model` with parameters (k,).

    `trajectory` is the run, with N output times, and `history` has its modes and impacts.
    """

    model: Model
    trajectory: Trajectory
    history: ContactHistory
    parameters: FloatArray

    @cached_property
    def by_name(self) -> ByName[ContactResult]:
        """The results of each contact by its name."""
        stated = self.model.statement.contacts
        return ByName("contact", ((contact.name, ContactResult(self, i, contact)) for i, contact in enumerate(stated)))

    def _segments(self, times: FloatArray) -> Iterator[tuple[Mode, NDArray[np.bool_]]]:
        """Yield each mode that occurs at the times (K,), with a mask (K,) that is True at its times."""
        numbers = segment_numbers(self.history.begins, times, forward=True)
        modes = self.history.modes
        for mode in dict.fromkeys(modes[i] for i in np.unique(numbers)):
            mine = [i for i, other in enumerate(modes) if other == mode]
            yield mode, np.isin(numbers, mine)

    def evaluate(self, expression: Any) -> FloatArray:
        """Return the values (N,) of an expression at the outputs, with the accelerations and forces of the mode then.

        The expression may contain gaps and normal forces of contacts, besides all that `Solution.evaluate` allows.
        """
        statement, symbols = self.model.statement, expression_of(expression, "the expression").free_symbols
        names = [name for symbol in symbols if (name := constraint_of(symbol)) is not None]
        kind = "constraint or contact" if statement.constraints else "contact"
        check_multipliers(names, "the expression", statement.multiplier_names, statement.name, kind)
        values = np.empty(len(self.trajectory.t))
        for mode, where in self._segments(self.trajectory.t):
            values[where] = self._in_mode(mode, expression, self.trajectory.t[where], self.trajectory.y[:, where])
        return values

    def _in_mode(self, mode: Mode, expression: Any, times: FloatArray, y: FloatArray) -> FloatArray:
        """Return the values (K,) of an expression at times (K,) and states y (2n, K), with the equations of a mode."""
        statement = self.model.statement
        plain = expression_of(expression, "the expression").xreplace(statement.gaps)
        pairs = zip(statement.contacts, mode.states, strict=True)
        absent = {contact.normal: sympy.S.Zero for contact, state in pairs if state == OPEN}
        model = modes_of(self.model).model_of(mode)
        return np.asarray(model.evaluate_expression(plain.xreplace(absent), times, y, self.parameters))

    @cached_property
    def energy_lost(self) -> FloatArray:
        """The energy that impacts and friction have dissipated, (N,) at the output times.

        If two outputs have the same time, the first is before an impact and the second after it, unless their states
        are equal.
        """
        lost = self.lost_at(self.trajectory.t)
        y = self.trajectory.y
        same = (self.trajectory.t[:-1] == self.trajectory.t[1:]) & (y[:, :-1] == y[:, 1:]).all(axis=0)
        for i in np.flatnonzero(same)[::-1]:
            lost[i] = lost[i + 1]
        return lost

    def arrays(self) -> dict[str, Any]:
        """Return the history as arrays by name, to be stored in a file. The function `stored_history` reads them."""
        history = self.history
        arrays: dict[str, Any] = {"begins": history.begins, "rubbed": self._rubbed(self.trajectory.t)}
        arrays["modes"] = np.array(json.dumps([astuple(mode) for mode in history.modes]))
        for i, (impacts, rests) in enumerate(zip(history.impacts, history.rests, strict=True)):
            arrays[f"rests_{i}"], arrays[f"impacts_{i}"] = np.array(rests), impacts
        return arrays

    def lost_at(self, times: FloatArray) -> FloatArray:
        """Return the energy (K,) that impacts and friction have dissipated up to times (K,)."""
        booked = np.concatenate([impacts[:, [TIME, LOST]] for impacts in self.history.impacts])
        when, lost = booked[np.argsort(booked[:, 0], kind="stable")].T
        begins = np.concatenate([self.history.begins[:1], when])
        numbers = segment_numbers(begins, times, forward=True)
        return np.asarray(np.cumsum(np.append(0.0, lost))[numbers] + self._rubbed(times))

    def _rubbed(self, times: FloatArray) -> FloatArray:
        """Return the energy (K,) that sliding friction has dissipated up to times (K,): the integral of its power."""
        begins, modes = self.history.begins, self.history.modes
        if self.history.rubbed is not None:
            return np.asarray(np.interp(times, self.trajectory.t, self.history.rubbed))
        if not len(times) or not any(SLIDING in mode.states for mode in modes):
            return np.zeros(len(times))
        ends = np.unique(np.concatenate([begins, times, [self.trajectory.span[0]]]))
        ends = ends[ends <= times.max()]
        begin, end, which, before = ends[:-1], ends[1:], np.arange(len(ends) - 1), np.full(len(ends) - 1, np.inf)
        works, whole = np.zeros(len(which)), self._work(begin, end)
        # Errors of intervals have either sign: their sum grows like the square root of their number.
        enough = AGREEMENT * np.abs(whole).sum() / math.sqrt(max(len(which), 1))
        for left in reversed(range(MOST_HALVINGS)):
            middle = (begin + end) / 2
            first, second = self._work(begin, middle), self._work(middle, end)
            error = np.abs(first + second - whole)
            # An error that halving does not reduce is rounding noise.
            off = (error > enough) & (error < before / 4) & (left > 0)
            np.add.at(works, which[~off], (first + second)[~off])
            begin, end = np.append(begin[off], middle[off]), np.append(middle[off], end[off])
            which, whole = np.tile(which[off], 2), np.append(first[off], second[off])
            before = np.tile(error[off], 2)
            if not len(which):
                break
        return np.asarray(np.interp(times, ends, np.append(0.0, np.cumsum(works))))

    def _work(self, begin: FloatArray, end: FloatArray) -> FloatArray:
        """Return the energy that friction dissipates in each interval from `begin` to `end` (K,), by Gauss's rule."""
        nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        halves, middles = (end - begin) / 2, (begin + end) / 2
        times = (middles[:, None] + halves[:, None] * nodes).ravel()
        power = np.zeros(len(times))
        for mode, where in self._segments(times):
            y = self.trajectory.dense(times[where]) if SLIDING in mode.states else None
            for contact, state, way in zip(self.model.statement.contacts, mode.states, mode.ways, strict=True):
                if y is not None and state == SLIDING:
                    pairs = zip(sliding_friction(contact, way), contact.slip, strict=True)
                    dissipated = sympy.Add(*(-force * slip for force, slip in pairs))
                    power[where] += self._in_mode(mode, dissipated, times[where], y)
        return np.asarray((power.reshape(len(halves), GAUSS_POINTS) @ weights) * halves)


class ContactResult:
    """One contact along a run: its state, forces and impacts."""

    def __init__(self, run: ContactRun, which: int, stated: Contact) -> None:
        self._run, self._which, self._stated = run, which, stated

    def __repr__(self) -> str:
        return f"<Contact {self._stated.name}: {len(self.impacts)} impacts, {', '.join(dict.fromkeys(self.mode))}>"

    @cached_property
    def mode(self) -> NDArray[Any]:
        """The state at the output times, (N,): "open", "closed", "sliding" or "sticking"."""
        states = np.full(len(self._run.trajectory.t), OPEN, dtype="<U8")
        for mode, where in self._run._segments(self._run.trajectory.t):
            states[where] = mode.labels[self._which]
        return states

    @cached_property
    def gap(self) -> FloatArray:
        """The gap at the output times, (N,)."""
        return self._run.evaluate(self._stated.gap)

    @cached_property
    def force(self) -> FloatArray:
        """The normal force at the output times, (N,). It is zero while the contact is open."""
        return np.where(self.mode == OPEN, 0.0, self._run.evaluate(self._stated.normal))

    @cached_property
    def friction(self) -> FloatArray:
        """The friction force at the output times, (N,), or (2, N) in a plane. It is positive along the stated slip."""
        run, stated = self._run.trajectory, self._stated
        forces = np.zeros((len(stated.slip), len(run.t)))
        for mode, where in self._run._segments(run.t):
            if mode.labels[self._which] in (SLIDING, STICKING):
                stuck = mode.states[self._which] == STICKING
                held = [multiplier(name) for name in stated.slip_names]
                expressions = held if stuck else sliding_friction(stated, mode.ways[self._which])
                t, y = run.t[where], run.y[:, where]
                forces[:, where] = [self._run._in_mode(mode, force, t, y) for force in expressions]
        return forces[0] if len(forces) == 1 else forces

    @cached_property
    def impacts(self) -> tuple[Impact, ...]:
        """The impacts in order, each with `.t`, `.impulse`, `.friction_impulse` and `.energy_lost`."""
        rows = self._run.history.impacts[self._which].tolist()
        return tuple(Impact(t, impulse, tuple(friction), lost) for t, impulse, lost, *friction in rows)

    @property
    def rests(self) -> tuple[float, ...]:
        """The times at which infinitely many impacts end. After each the contact may open, and have impacts again."""
        return self._run.history.rests[self._which]
