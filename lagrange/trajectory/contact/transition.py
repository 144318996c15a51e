"""Transitions between modes: impacts that close a gap, and the mode that follows."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import sympy

from lagrange.equations.regularity import independent_rows
from lagrange.errors import RunError, listing
from lagrange.machine.model import Model
from lagrange.statement.contact import SEQUENCE
from lagrange.trajectory.contact.complementarity import (
    OPEN,
    SLIDING,
    STICKING,
    Balance,
    Friction,
    least_solution,
    solutions,
)
from lagrange.trajectory.contact.kinematics import STILL, TOUCHING, Kinematics, Touch
from lagrange.trajectory.contact.modes import SLOWEST, Mode, Modes
from lagrange.trajectory.contact.resets import SHORT, SLIGHT, coupling, response_of
from lagrange.trajectory.trajectory import FloatArray

MOST_IN_SEQUENCE = 500
"""Largest number of impacts in a sequence at one instant. The rates that remain after them are stopped at once."""

IMPACT_NOISE = 1e-13
"""A gap rate after an impact is rounding if it is below this fraction of the speed of the impact."""

UNCOUPLED = 1e-12
"""Two contacts are uncoupled if the response of one to the other is below this fraction of the largest response."""

SMALLEST_GAP = 64 * 2.0**-52
"""A contact whose gap would remain below this fraction of its terms does not open: the run could not detect its
closing.
"""


LONGEST_REGION = 120
"""Largest number of characters of the condition of Painleve's paradox in a message."""


class Undetermined(RunError):
    """Error: the laws of contact allow no consistent next motion, or several."""


@dataclass(frozen=True, eq=False)
class Transition:
    """Result of a transition: the state `y` (2n,) and the mode after it, and the impacts.

    `before` (2n,) is the state before the impacts, in which overlaps of bodies are removed. `impacts` maps the index
    of a contact to a row: time, normal impulse, energy lost, friction impulse. `speeds` are the impact speeds of the
    contacts whose gap closed. `unseen` are the indices of contacts that open and would close again while their gap is
    still within rounding.
    """

    y: FloatArray
    before: FloatArray
    mode: Mode
    impacts: dict[int, FloatArray] = field(default_factory=dict)
    speeds: tuple[float, ...] = ()
    unseen: frozenset[int] = frozenset()


class Transitions:
    """Computes the state and the mode of a run after a mode has ended.

    `shared` is a sentence on contacts whose forces the laws did not determine, or "".
    """

    def __init__(self, modes: Modes, kinematics: Kinematics, span: float, rtol: float) -> None:
        self.modes, self.kinematics = modes, kinematics
        self._layout, self._slowest, self._moment = modes.model.layout, 0.0, SHORT * span
        self._slow_share = max(SLOWEST, rtol)
        self.shared, count = "", len(modes.contacts)
        flying = Mode((OPEN,) * count, (None,) * count)
        self._open = replace(flying, still=modes.leaves_no_freedom(flying))

    def after(
        self,
        t: float,
        y: FloatArray,
        mode: Mode,
        *,
        met: Collection[int] = (),
        released: Collection[int] = (),
        stopped: Collection[int] = (),
        freed: Collection[int] = (),
        plastic: Collection[int] = (),
    ) -> Transition:
        """Return the result of the transition after a mode that ends at a state (2n,).

        The mode is ended by contacts whose gap (`met`), normal force (`released`) or slip (`stopped`) became zero, or
        whose friction force reached the largest value that sticking allows (`freed`). Impacts of `plastic` contacts
        have no restitution, and these contacts stay closed. Raises `Undetermined` if the laws of contact do not
        determine the result.
        """
        kin = self.kinematics
        touch = kin.at(t, y)
        normals = kin.normals
        near = [i for i in range(len(normals)) if i in met or touch.gaps[i] <= touch.near[i]]
        if overlapping := [i for i in near if touch.gaps[i] < 0]:
            y = kin.closed(y, touch, overlapping, near)
            touch = kin.at(t, y, touch)
        before = y
        lasting = [i for i in mode.closed if i not in released]
        touching = sorted({*near, *lasting} - set(released))
        if not touching and not released:
            return Transition(y, y, self._open)
        closing = [i for i in touching if touch.rates[normals[i]] < -touch.noise[normals[i]] and i not in lasting]
        impacts: dict[int, FloatArray] = {}
        speeds: tuple[float, ...] = ()
        ways = self._freed_ways(t, y, mode, freed) if freed else {}
        if closing:
            y, impacts, speeds = self._impact(t, y, touch, touching, closing, plastic)
            touch = kin.at(t, y, touch)
        still = touch.noise + IMPACT_NOISE * max(speeds, default=0.0)
        resting = [i for i in touching if touch.rates[normals[i]] <= still[normals[i]] or i in plastic]
        entered, following, pulls = self._next(t, y, touch, resting, stopped, ways, released, near)
        if turned := self._turned(y, entered, touch, following):
            stopped = {*stopped, *turned}
            entered, following, pulls = self._next(t, y, touch, resting, stopped, ways, released, near)
        y = entered
        unseen = frozenset(
            i
            for i in touching
            if i not in following.closed
            and 0 < touch.rates[normals[i]] ** 2 < -2 * pulls[normals[i]] * SMALLEST_GAP / TOUCHING * touch.near[i]
        )
        return Transition(y, before, following, impacts, speeds, unseen)

    def _freed_ways(self, t: float, y: FloatArray, mode: Mode, freed: Collection[int]) -> dict[int, FloatArray]:
        """Return the direction (components,) in which each contact of `freed` begins to slide, by its index.

        It is opposite to the friction force that held the contact in `mode`, at the state y (2n,).
        """
        model = self.modes.model_of(mode)
        forces = dict(
            zip(
                (constraint.name for constraint in model.statement.constraints),
                model.multipliers(*self._layout.split(y), t, self.kinematics.parameters),
                strict=True,
            )
        )
        ways = {}
        for i in freed:
            force = np.array([forces[name] for name in self.kinematics.contacts[i].slip_names])
            ways[i] = -force / np.linalg.norm(force)
        return ways

    def _impact(
        self,
        t: float,
        y: FloatArray,
        touch: Touch,
        touching: Sequence[int],
        closing: Sequence[int],
        plastic: Collection[int],
    ) -> tuple[FloatArray, dict[int, FloatArray], tuple[float, ...]]:
        """Return the state after an impact, the impacts as in `Transition`, and the speeds of `closing` contacts.

        `touching` are the indices of all contacts with zero gap, which may exchange impulses. `closing` are those
        whose gap decreases. `plastic` contacts have no restitution. `touch` has the contacts at the state y (2n,)
        before the impact.
        """
        kin, v = self.kinematics, self._layout.v
        matrix, law = touch.compliance, self.modes.model.statement.simultaneous
        if not law and self._coupled(matrix, touching):
            names = listing(kin.contacts[i].name for i in touching)
            raise Undetermined(
                f"{names} meet at one instant, and the result depends on the law of simultaneous impacts: state "
                "simultaneous='newton', all at once, or 'sequence', one after the other, on the system."
            )
        rates, impulses, lost = touch.rates, np.zeros(len(touch.rates)), np.zeros(len(touch.rates))
        rounds = 0
        while True:
            approaching = [i for i in touching if rates[kin.normals[i]] < -touch.noise[kin.normals[i]]]
            if not approaching or rounds > (MOST_IN_SEQUENCE if law == SEQUENCE else 0):
                break
            last = law != SEQUENCE or rounds == MOST_IN_SEQUENCE
            chosen = list(touching) if last else [min(approaching, key=lambda i: rates[kin.normals[i]])]
            added = self._impulses(y, touch, rates, chosen, touching if rounds and last else plastic)
            impulses, before = impulses + added, rates
            rates = touch.rates + matrix @ impulses
            lost -= added * (before + rates) / 2
            rounds += 1
        after = y.copy()
        after[v] += touch.responses @ impulses
        impacts = {}
        for i in touching:
            push, *friction = impulses[kin.rows[i]]
            if push:
                impacts[i] = np.array([t, push, lost[kin.rows[i]].sum(), *friction])
        return after, impacts, tuple(float(-touch.rates[kin.normals[i]]) for i in closing)

    def _coupled(self, matrix: FloatArray, touching: Sequence[int]) -> bool:
        """Return True if an impulse at one of the contacts `touching` changes the gap rate or the slip of another.

        `matrix` (rows, rows) has the change of each of these rates by each unit impulse.
        """
        kin = self.kinematics
        rows = [row for i in touching for row in kin.rows[i]]
        others = np.abs(matrix)[np.ix_(rows, rows)]
        others[np.equal.outer(kin.owners[rows], kin.owners[rows])] = 0.0
        return bool(others.max() > UNCOUPLED * np.abs(matrix).max())

    def _impulses(
        self,
        y: FloatArray,
        touch: Touch,
        rates: FloatArray,
        chosen: Sequence[int],
        plastic: Collection[int],
    ) -> FloatArray:
        """Return the impulses (rows,) of one impact, by Newton's law of restitution and Coulomb's law of friction.

        Only the `chosen` contacts have impulses. `touch` has the contacts at the state y (2n,), and `rates` (rows,) are
        their gap rates and slips before the impact. `plastic` contacts have no restitution.
        """
        kin, laws, bias = self.kinematics, {}, rates.copy()
        for i in chosen:
            normal, *along = kin.rows[i]
            speed = max(-float(rates[normal]), 0.0)
            if speed and i not in plastic:
                bias[normal] -= kin.restitution(i, speed) * speed
            laws[i] = kin.friction(i, np.zeros(len(along)), np.zeros(1))
            if along and np.linalg.norm(rates[along]) > touch.noise[along].max():
                # Kinetic friction stops surfaces that slide into an impact; static friction acts at rest.
                laws[i] = replace(laws[i], static=laws[i].kinetic)
        rows, balance = self._balance(y, touch, laws, bias, "impact")
        impulses = np.zeros(len(rates))
        impulses[rows] = balance.forces
        return impulses

    def _balance(
        self, y: FloatArray, touch: Touch, laws: dict[int, Friction], bias: FloatArray, what: str
    ) -> tuple[list[int], Balance]:
        """Return the forces, or impulses, of contacts at rest in `touch`, and the rows to which they belong.

        `laws` has the friction of each of these contacts by its index. `bias` (rows,) are the rates without these
        forces. Raises `Undetermined` if there is no solution, or more than one: its message names the state y (2n,)
        and `what` is undetermined, "motion" or "impact".
        """
        kin = self.kinematics
        rows = [row for i, law in laws.items() for row in kin.rows[i][: 1 + law.components]]
        matrix = touch.compliance[np.ix_(rows, rows)]
        balances = solutions(matrix, bias[rows], list(laws.values()), kin.model.machine)
        if len(balances) != 1:
            raise _undetermined(kin, touch, y, list(laws), len(balances), what)
        if balances[0].shared and not self.shared:
            shared = [list(laws)[i] for i in sorted(balances[0].shared)]
            directions = touch.directions[[row for i in shared for row in kin.rows[i]]]
            self.shared = (
                f"The contacts {listing(repr(kin.contacts[i].name) for i in shared)} depend on each other (rank "
                f"{len(independent_rows(directions))} of {len(directions)}): of their possible forces, those with the "
                "fewest sliding contacts are given."
            )
        return rows, balances[0]

    def _next(
        self,
        t: float,
        y: FloatArray,
        touch: Touch,
        resting: Sequence[int],
        stopped: Collection[int],
        ways: dict[int, FloatArray],
        released: Collection[int],
        near: Sequence[int],
    ) -> tuple[FloatArray, Mode, FloatArray]:
        """Return the state and the mode after a transition, for contacts `resting` with zero gap and gap rate.

        Contacts in `near` have zero gap, in `stopped` zero slip, in `released` zero normal force. `ways` has the
        directions of beginning slips. The third result (rows,) has the time derivatives of gap rates and slips.
        """
        kin, count = self.kinematics, len(self.kinematics.contacts)
        states, kept_ways = [OPEN] * count, list[int | None]([None] * count)
        slides: dict[int, FloatArray] = {}
        free = np.asarray(kin.model.kernel("rhs")(t, y, kin.parameters))[self._layout.v]
        pulls = touch.directions @ free + touch.bias
        terms = np.abs(touch.directions) @ np.abs(free) + np.abs(touch.bias)
        if resting:
            laws = {}
            for i in resting:
                along = kin.rows[i][1:]
                slip = np.zeros(len(along)) if i in stopped else touch.rates[along]
                laws[i] = kin.friction(i, slip, np.maximum(touch.noise[along], 0.0) if along else np.zeros(1))
                if i in ways:
                    laws[i] = replace(laws[i], way=ways[i])
            rows, balance = self._balance(y, touch, laws, pulls, "motion")
            pulls = pulls + touch.compliance[:, rows] @ balance.forces
            terms[rows] += np.abs(touch.compliance[np.ix_(rows, rows)]) @ np.abs(balance.forces)
            for i, state, way in zip(resting, balance.states, balance.ways, strict=True):
                states[i] = state
                if state == SLIDING and way is not None:
                    slides[i] = way
                    kept_ways[i] = round(float(way[0])) if len(way) == 1 else None
        if any(len(way) > 1 for way in slides.values()) and not self._slowest:
            self._slowest = self._slow_share / STILL * float(touch.noise.max())
        plane = any(state == SLIDING and len(kin.contacts[i].slip) > 1 for i, state in enumerate(states))
        independent = self._independent(t, y, touch, states)
        mode = Mode(tuple(states), tuple(kept_ways), independent, slowest=self._slowest if plane else 0.0)
        mode = replace(mode, still=self.modes.leaves_no_freedom(mode))
        slight = SLIGHT * float(terms.max()) * max(abs(t), self._moment)
        begins = {kin.normals[i]: slight for i in {*resting, *released} if states[i] == OPEN}
        for i, way in slides.items():
            along = kin.rows[i][1:]
            if np.linalg.norm(touch.rates[along]) <= touch.noise[along].max():
                slow = 0.0 if len(way) == 1 else 2 * max(mode.slowest, float(touch.noise[along].max()))
                begins |= dict(zip(along, (max(slow, slight) * way).tolist(), strict=True))
        if any(touch.gaps[i] for i in mode.closed):
            y = kin.closed(y, touch, mode.closed, near)
        return self._entered(y, touch, mode, begins), mode, pulls

    def _turned(self, y: FloatArray, entered: FloatArray, touch: Touch, mode: Mode) -> list[int]:
        """Return the contacts whose slip in the state `entered` (2n,) is zero or opposite to the direction in `mode`.

        Their slip in the state y (2n,) was only rounding, which the change to `entered` removed. So they are at rest.
        `touch` has the contacts at y.
        """
        change = entered[self._layout.v] - y[self._layout.v]
        turned = []
        for i, way in enumerate(mode.ways):
            if way is not None:
                row = self.kinematics.rows[i][1]
                if way * (touch.rates[row] + touch.directions[row] @ change) <= 0:
                    turned.append(i)
        return turned

    def _independent(self, t: float, y: FloatArray, touch: Touch, states: Sequence[str]) -> tuple[int, ...] | None:
        """Return the indices of independent constraints in a mode, or None if all are independent.

        `states` are the states of the contacts in the mode, `touch` has the contacts at the state y (2n,).
        """
        gradient = touch.directions[self._held_rows(states)]
        if len(gradient) < 2:
            return None
        stated = self.kinematics.stated_directions(t, y)
        rows = independent_rows(np.vstack([stated, gradient]))
        return None if len(rows) == len(stated) + len(gradient) else rows

    def _held_rows(self, states: Sequence[str]) -> list[int]:
        """Return the indices of the rows (gap rates and slips) that are zero in a mode.

        `states` are the states of the contacts: a closed gap is constant, and a contact that sticks has no slip.
        """
        kin = self.kinematics
        rows = []
        for i, state in enumerate(states):
            if state != OPEN:
                mine = kin.rows[i]
                rows += mine if state == STICKING else mine[:1]
        return rows

    def _entered(self, y: FloatArray, touch: Touch, mode: Mode, begins: dict[int, float]) -> FloatArray:
        """Return the state y (2n,) with velocities changed to satisfy the constraints of a mode.

        The change is the least, measured by the kinetic energy. Velocities that are rounding become zero. `begins`
        maps rows of gap rates and slips that begin to grow to small initial values. Without these values, rounding of
        the accelerations could end the growth at once.
        """
        held_rows = self._held_rows(mode.states)
        if not held_rows and not begins:
            return y
        if mode.still:
            return np.where(np.arange(len(y)) < self._layout.q.stop, y, 0.0)
        y, rows = y.copy(), [*held_rows, *begins]
        changes = np.array([*np.zeros(len(held_rows)), *begins.values()]) - touch.rates[rows]
        v = y[self._layout.v].copy()
        v += touch.responses[:, rows] @ least_solution(touch.compliance[np.ix_(rows, rows)], changes)
        v[touch.directions[held_rows].any(axis=0) & (np.abs(v) <= touch.still)] = 0.0
        y[self._layout.v] = v
        return y


def _undetermined(
    kin: Kinematics, touch: Touch, y: FloatArray, chosen: Sequence[int], count: int, what: str
) -> Undetermined:
    """Return the error for contacts `chosen` at a state y (2n,) at which the laws allow `count` motions.

    `what` is "motion" or "impact". If there are several motions, the cause is contacts that depend on each other.
    """
    names = listing(repr(kin.contacts[i].name) for i in chosen)
    rows = touch.directions[[kin.normals[i] for i in chosen]]
    if count and (rank := len(independent_rows(rows))) < len(rows):
        return Undetermined(
            f"The contacts {names} depend on each other (rank {rank} of {len(rows)}) and have friction, so the motion "
            "depends on how they share their forces, which the laws do not determine: state fewer contacts, or equal "
            "friction."
        )
    allowed = f"{count} different motions after this {what}" if count else f"no {what}"
    return Undetermined(
        f"Coulomb's law allows {allowed} at {names} (Painleve's paradox), {_where(kin, touch, y, chosen)}. Lower "
        "the friction, or end the run before."
    )


def _where(kin: Kinematics, touch: Touch, y: FloatArray, chosen: Sequence[int]) -> str:
    """Return where Painleve's paradox occurs at `chosen` contacts: a condition in symbols, or the coordinates."""
    for i in chosen:
        normal, *along = kin.rows[i]
        for way in (1, -1) if len(along) == 1 else ():
            mu = kin.friction(i, touch.rates[along], touch.noise[along]).kinetic
            value = touch.compliance[normal, normal] - mu * way * touch.compliance[normal, along[0]]
            if value <= 0 and way * touch.rates[along[0]] >= -touch.noise[along[0]]:
                region = _region(kin.model, i, way)
                if region:
                    return f"as friction presses {kin.contacts[i].name!r} together where {region} <= 0"
    layout = kin.model.layout
    coordinates = zip(layout.coordinates, layout.split(y)[0].tolist(), strict=False)
    return f"at {listing(f'{name} = {value:.6g}' for name, value in coordinates)}"


def _region(model: Model, which: int, way: int) -> str:
    """Return, as text, the acceleration of a gap due to a unit normal force and the sliding friction that it causes.

    The contact with index `which` slides in the direction `way`, 1 or -1. Where this acceleration is not positive, a
    normal force does not open the gap. The text is "" if it is too long, or if the system has constraints.
    """
    statement, contact = model.statement, model.statement.contacts[which]
    mass = None if statement.constraints else coupling(statement)
    if mass is None:
        return ""
    normal = sympy.Matrix([contact.gap.diff(q) for q in statement.coordinates])
    along = sympy.Matrix([contact.slip[0].diff(rate) for rate in statement.velocities])
    change = normal.dot(response_of(mass, normal - way * contact.friction[1] * along))
    region = statement.quote(sympy.together(sympy.expand(change)), LONGEST_REGION + 1)
    return region if len(region) <= LONGEST_REGION else ""
