"""Transitions between modes of contact: impacts that close a gap, and which contacts are closed after them.

The laws, in the order in which they are applied at one instant t:

1. Impact: a gap that is zero and becomes smaller, u < 0, collides. The impulses P change the rates of gaps and slips by
   A P, with the compliance A = D M^-1 D^T of the contacts. Gaps obey Newton's law of restitution, u+ >= -e u, and slips
   Coulomb's law for impulses. Coordinates do not change.
2. Rest: gaps and gap rates that are zero stay so as long as surfaces press, and surfaces only press: a >= 0, N >= 0 and
   a N = 0 (Signorini). Friction obeys Coulomb's law. The accelerations a = A f + b of gaps and slips determine which
   contacts open, stick and slide: the next mode.
3. Projection: the state is moved onto the constraints of the next mode, by the least change.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import sympy

from lagrange.equations.regularity import independent_rows
from lagrange.errors import RunError, listing
from lagrange.machine.model import Model
from lagrange.statement.contact import SEQUENCE
from lagrange.trajectory.contact.impacts_as_resets import SHORT, SLIGHT, coupling, response_of
from lagrange.trajectory.contact.kinematics import RATE_NOISE, TOUCHING, ContactState, Kinematics
from lagrange.trajectory.contact.modes import SLOWEST, Mode, ModeEnd, Modes
from lagrange.trajectory.contact.stick_or_slide import OPEN, SLIDING, Balance, Friction, solutions
from lagrange.trajectory.trajectory import FloatArray

MOST_IN_SEQUENCE = 500
"""Largest number of impacts, one after the other, at one instant. After them, one impact without restitution stops all
gaps that still become smaller."""

IMPACT_NOISE = 1e-13
"""Largest gap rate after an impact that counts as zero, as a fraction of the largest speed of the impact."""

UNCOUPLED = 1e-12
"""Largest change of one contact's rate by a unit impulse at another contact, as a fraction of the largest change of any
rate, up to which the two contacts do not affect each other."""

SMALLEST_GAP = 64 * 2.0**-52
"""Largest height of a gap between opening and closing, as a fraction of the gap's terms, at which the contact stays
closed instead. The end of so low a flight cannot be detected."""

LONGEST_REGION = 120
"""Largest number of characters of the formula in a message that says where Painleve's paradox occurs."""


class Undetermined(RunError):
    """Error: the laws of contact allow no consistent next motion, or several."""


@dataclass(frozen=True, eq=False)
class Transition:
    """Result of a transition: the state `y` (2n,) and the mode after it, and the impacts.

    `before` (2n,) is the state before the impacts, in which overlaps of bodies are removed. `impacts` maps the index of
    a contact to a row: time, normal impulse, energy lost, friction impulse. `speed` is the largest impact speed.
    `low_flights` are contacts (indices) that open and would close again while their gap is still within rounding.
    """

    y: FloatArray
    before: FloatArray
    mode: Mode
    impacts: dict[int, FloatArray] = field(default_factory=dict)
    speed: float = 0.0
    low_flights: frozenset[int] = frozenset()


class _Rest(NamedTuple):
    """Contacts after the impacts of a transition, at the state of `touch`, by their indices.

    `resting` contacts have zero gap and zero gap rate, and `near` contacts have zero gap. `end` has the contacts whose
    events ended the mode before the transition. `ways` maps contacts that begin to slide to their directions
    (components,).
    """

    touch: ContactState
    resting: Sequence[int]
    near: Sequence[int]
    end: ModeEnd
    ways: dict[int, FloatArray]


class Transitions:
    """Computes the state and the mode that follow after a mode has ended.

    `shared` is a sentence for the run's message if the forces of some contacts were not unique, else "".
    """

    def __init__(self, modes: Modes, kinematics: Kinematics, span: float, rtol: float) -> None:
        self.modes, self.kinematics = modes, kinematics
        self._layout, self._slowest, self._moment = modes.model.layout, 0.0, SHORT * span
        self._slow_share = max(SLOWEST, rtol)
        self.shared = ""

    def after(
        self, touch: ContactState, mode: Mode, end: ModeEnd, plastic: Collection[int] = frozenset()
    ) -> Transition:
        """Return the result of the transition after `mode`, which ends at the state of the contacts `touch`.

        `end` has the contacts whose events end the mode. The contacts `plastic` (indices) have no restitution, and stay
        closed after an impact. Raises `Undetermined` if the laws of contact do not determine the result.
        """
        kin, normals = self.kinematics, self.kinematics.normals
        near = [i for i, gap in enumerate(touch.gaps.tolist()) if i in end.closing or gap <= touch.near]
        if not near and not mode.closed:
            return Transition(touch.y, touch.y, self.modes.all_open)
        if overlapping := [i for i in near if touch.gaps[i] < 0]:
            touch = kin.at(touch.t, kin.closed(touch, overlapping, near), touch)
        before, speed, impacts = touch.y, 0.0, dict[int, FloatArray]()
        lasting = [i for i in mode.closed if i not in end.opening]
        touching = sorted({*near, *lasting}.difference(end.opening))
        ways = self._ways_of_yielding(touch, mode, end.yielding)

        # 1. Impact.
        closing = [i for i in self._approaching(touch, touching, touch.rates) if i not in lasting]
        if closing:
            speed = max(-float(touch.rates[normals[i]]) for i in closing)
            y, impacts = self._impact(touch, touching, plastic)
            touch, rates = kin.at(touch.t, y, touch), touch.rates
            # A slip that the impact changed neither stops nor begins at this instant.
            changed = set(kin.owners[np.abs(touch.rates - rates) > touch.noise].tolist())
            end = end._replace(stopping=tuple({*end.stopping} - changed))
            ways = {i: way for i, way in ways.items() if i not in changed}

        # 2. Rest, and 3. projection.
        noise = touch.noise + IMPACT_NOISE * speed
        resting = [i for i in touching if touch.rates[normals[i]] <= noise[normals[i]] or i in plastic]
        rest = _Rest(touch, resting, near, end, ways)
        y, following, accelerations = self._next(rest)
        # A slip that the projection removed or reversed was an error of the state: it counts as zero.
        slides = [(i, kin.rows[i][1], way) for i, way in enumerate(following.ways) if way is not None]
        rates, noise = kin.rates(touch.t, y) if slides else touch.rates, touch.noise
        if turned := [i for i, row, way in slides if way * rates[row] <= noise[row] < abs(touch.rates[row])]:
            stopping = (*end.stopping, *turned)
            y, following, accelerations = self._next(rest._replace(end=end._replace(stopping=stopping)))
        # A gap with the rate v and the deceleration a grows to the height v^2 / (2 a), which may be rounding.
        smallest_gap, v, a = SMALLEST_GAP / TOUCHING * touch.near, touch.rates[normals], -accelerations[normals]
        opening = (i for i in touching if i not in following.closed)
        low_flights = frozenset(i for i in opening if 0 < v[i] ** 2 < 2 * a[i] * smallest_gap)
        return Transition(y, before, following, impacts, speed, low_flights)

    def _ways_of_yielding(self, touch: ContactState, mode: Mode, yielding: Collection[int]) -> dict[int, FloatArray]:
        """Return a unit vector (components,) for each of the contacts `yielding` (indices), which stuck in `mode`.

        It is the direction in which the contact begins to slide, against its friction force at the state of `touch`.
        """
        if not yielding:
            return {}
        model = self.modes.model_of(mode)
        forces = model.multipliers(*self._layout.split(touch.y), touch.t, self.kinematics.parameters)
        by_name = dict(zip((each.name for each in model.statement.constraints), forces, strict=True))
        held = {i: np.array([by_name[name] for name in self.kinematics.contacts[i].slip_names]) for i in yielding}
        return {i: -force / np.linalg.norm(force) for i, force in held.items()}

    def _impact(
        self, touch: ContactState, touching: Sequence[int], plastic: Collection[int]
    ) -> tuple[FloatArray, dict[int, FloatArray]]:
        """Return the state after an impact, and the impacts as in `Transition`.

        `touching` contacts have zero gap and may exchange impulses; `plastic` ones have no restitution. By the law
        "newton" all contacts collide at once. By the law "sequence" the fastest contact collides, again and again until
        no gap becomes smaller.
        """
        kin = self.kinematics
        self._check_law_of_impacts(touch, touching)
        most = MOST_IN_SEQUENCE if kin.model.statement.simultaneous == SEQUENCE else 0
        rates, impulses, lost = touch.rates, np.zeros(len(touch.rates)), np.zeros(len(touch.rates))
        # One contact at a time, up to `most` times; then all at once, without restitution after a sequence.
        for collision in range(most + 1):
            approaching = self._approaching(touch, touching, rates)
            if not approaching:
                break
            if collision < most:
                colliding, inelastic = [min(approaching, key=lambda i: rates[kin.normals[i]])], plastic
            else:
                colliding, inelastic = list(touching), touching if collision else plastic
            added = self._impulses(touch, rates, colliding, inelastic)
            impulses, before = impulses + added, rates
            rates = touch.rates + touch.compliance @ impulses
            # The work of an impulse is the impulse times the mean of the rates before and after.
            lost -= added * (before + rates) / 2
        after = touch.y.copy()
        after[self._layout.v] += touch.responses @ impulses
        impacts = {}
        for i in touching:
            push, *friction = impulses[kin.rows[i]]
            if push:
                impacts[i] = np.array([touch.t, push, lost[kin.rows[i]].sum(), *friction])
        return after, impacts

    def _approaching(self, touch: ContactState, contacts: Sequence[int], rates: FloatArray) -> list[int]:
        """Return those of `contacts` (indices) whose gaps become smaller at the gap rates in `rates` (rows,).

        A gap rate counts as zero within its noise in the contacts `touch`.
        """
        normals = self.kinematics.normals
        return [i for i in contacts if rates[normals[i]] < -touch.noise[normals[i]]]

    def _check_law_of_impacts(self, touch: ContactState, touching: Sequence[int]) -> None:
        """Raise `Undetermined` if touching contacts affect each other at an impact, and no law is stated for this case.

        `touching` are the indices of the contacts with zero gap, and `touch` has all contacts at the state of the
        impact.
        """
        kin, matrix = self.kinematics, np.abs(touch.compliance)
        rows = [row for i in touching for row in kin.rows[i]]
        # The change of each rate by a unit impulse of another contact.
        coupled = matrix[np.ix_(rows, rows)] * np.not_equal.outer(kin.owners[rows], kin.owners[rows])
        if kin.model.statement.simultaneous or not coupled.max() > UNCOUPLED * matrix.max():
            return
        arriving = self._approaching(touch, touching, touch.rates)
        names = listing(kin.contacts[i].name for i in arriving)
        what = f"{names} meet at one instant"
        if closed := [kin.contacts[i].name for i in touching if i not in arriving]:
            verb, be = "arrives" if len(arriving) == 1 else "arrive", "is" if len(closed) == 1 else "are"
            what = f"{names} {verb} while {listing(closed)} {be} closed"
        raise Undetermined(
            f"{what}, and the result depends on the law of simultaneous impacts: state "
            "simultaneous='newton', all at once, or 'sequence', one after the other, on the system."
        )

    def _impulses(
        self, touch: ContactState, rates: FloatArray, colliding: Sequence[int], plastic: Collection[int]
    ) -> FloatArray:
        """Return the impulses (rows,) of one impact, by Newton's law of restitution and Coulomb's law of friction.

        `touch` has the contacts at the state of the impact, and `rates` (rows,) are their gap rates and slips before
        it. Only the contacts `colliding` (indices) have impulses. The contacts `plastic` (indices) have no restitution.
        """
        kin, laws, free_rates = self.kinematics, {}, rates.copy()
        for i in colliding:
            normal, *along = kin.rows[i]
            speed = max(-float(rates[normal]), 0.0)
            if speed and i not in plastic:
                # Newton's law u+ >= -e u is the law without restitution, w >= 0, for w = u+ + e u.
                free_rates[normal] -= kin.restitution(i, speed) * speed
            laws[i] = kin.friction(i, np.zeros(len(along)), np.zeros(1))
            if along and np.linalg.norm(rates[along]) > touch.noise[along].max():
                # Kinetic friction stops surfaces that slide into an impact; static friction acts at rest.
                laws[i] = replace(laws[i], static=laws[i].kinetic)
        rows, balance = self._balance(touch, laws, free_rates, "impact")
        impulses = np.zeros(len(rates))
        impulses[rows] = balance.forces
        return impulses

    def _balance(
        self, touch: ContactState, laws: dict[int, Friction], free_rates: FloatArray, what: str
    ) -> tuple[list[int], Balance]:
        """Return the row indices of some contacts, and their forces at rest, or their impulses, as a `Balance`.

        `laws` maps the indices of the contacts to their friction. `free_rates` (rows,) are the accelerations of gaps
        and slips without these forces, or the rates after an impact without these impulses. `what` is "motion" for
        forces and "impact" for impulses. Raises `Undetermined`, with `what` in the message, unless there is exactly one
        solution.
        """
        kin = self.kinematics
        rows = [row for i, law in laws.items() for row in kin.rows[i][: 1 + law.components]]
        matrix = touch.compliance[np.ix_(rows, rows)]
        balances = solutions(matrix, free_rates[rows], list(laws.values()), kin.model.machine)
        if len(balances) != 1:
            raise _undetermined(kin, touch, list(laws), len(balances), what)
        if balances[0].shared and not self.shared:
            shared = [list(laws)[i] for i in sorted(balances[0].shared)]
            directions = touch.directions[[row for i in shared for row in kin.rows[i]]]
            self.shared = (
                f"The contacts {listing(repr(kin.contacts[i].name) for i in shared)} depend on each other (rank "
                f"{len(independent_rows(directions))} of {len(directions)}): of their possible forces, those with the "
                "fewest sliding contacts are given."
            )
        return rows, balances[0]

    def _next(self, rest: _Rest) -> tuple[FloatArray, Mode, FloatArray]:
        """Return the state (2n,) and the mode after a transition, and the accelerations (rows,) of gaps and slips.

        `rest` has the contacts after the impacts of the transition.
        """
        (touch, resting, near, end, beginning), kin, count = rest, self.kinematics, len(self.kinematics.contacts)
        states, ways = [OPEN] * count, list[int | None]([None] * count)
        slides: dict[int, FloatArray] = {}
        free = np.asarray(kin.model.kernel("rhs")(touch.t, touch.y, kin.parameters))[self._layout.v]
        accelerations = touch.directions @ free + touch.convective
        terms = np.abs(touch.directions) @ np.abs(free) + np.abs(touch.convective)
        if resting:
            laws = {}
            for i in resting:
                along = kin.rows[i][1:]
                slip = np.zeros(len(along)) if i in end.stopping else touch.rates[along]
                friction = kin.friction(i, slip, np.array([self._slow(touch, along)]))
                laws[i] = replace(friction, way=beginning[i]) if i in beginning else friction
            rows, balance = self._balance(touch, laws, accelerations, "motion")
            accelerations = accelerations + touch.compliance[:, rows] @ balance.forces
            terms[rows] += np.abs(touch.compliance[np.ix_(rows, rows)]) @ np.abs(balance.forces)
            for i, state, way in zip(resting, balance.states, balance.ways, strict=True):
                states[i] = state
                if state == SLIDING and way is not None:
                    slides[i] = way
                    ways[i] = round(float(way[0])) if len(way) == 1 else None
        in_plane = any(len(way) > 1 for way in slides.values())
        if in_plane and not self._slowest:
            # The scale for bodies at rest is the speed that they reach early in the run.
            self._slowest = self._slow_share / RATE_NOISE * float(touch.noise.max())
            self._slowest = self._slowest or self._slow_share * float(terms.max()) * self._moment
        mode = Mode(tuple(states), tuple(ways), slowest=self._slowest if in_plane else 0.0)
        mode = self._with_constraints(touch, mode)
        slight = SLIGHT * float(terms.max()) * max(abs(touch.t), self._moment)
        starts = {kin.normals[i]: slight for i in {*resting, *end.opening} if states[i] == OPEN}
        for i, way in slides.items():
            along = kin.rows[i][1:]
            if i in end.stopping or np.linalg.norm(touch.rates[along]) <= self._slow(touch, along):
                slow = 0.0 if len(way) == 1 else 2 * self._slow(touch, along)
                starts |= dict(zip(along, (max(slow, slight) * way).tolist(), strict=True))
        return self._projected(touch, mode, starts, near), mode, accelerations

    def _slow(self, touch: ContactState, along: Sequence[int]) -> float:
        """Return the speed up to which the slip of one contact counts as zero.

        `along` are the rows of its slip in `touch`. For a slip along a line, this speed is the noise of the slip. For a
        slip in a plane, it is at least `Mode.slowest`.
        """
        noise = float(touch.noise[along].max(initial=0.0))
        return max(self._slowest, noise) if len(along) > 1 else noise

    def _with_constraints(self, touch: ContactState, mode: Mode) -> Mode:
        """Return `mode` with its fields `independent` and `immobile`, from the constraints at the state of `touch`.

        `independent` has the indices of independent constraints. `immobile` is True if they allow no motion.
        """
        kin, independent = self.kinematics, None
        held = kin.held_rows(mode.states)
        count = len(kin.model.statement.constraints) + len(held)
        if len(held) > 1:
            rows = independent_rows(np.vstack([kin.stated_directions(touch.t, touch.y), touch.directions[held]]))
            independent = None if len(rows) == count else rows
        immobile = self.modes.leaves_no_freedom(mode, count if independent is None else len(independent))
        return replace(mode, independent=independent, immobile=immobile)

    def _projected(self, touch: ContactState, mode: Mode, starts: dict[int, float], near: Sequence[int]) -> FloatArray:
        """Return the nearest state (2n,) to that of `touch` that satisfies the constraints of a mode.

        Gaps of closed contacts become zero, and so do slips of sticking contacts. Distances are measured by the kinetic
        energy. Velocities that are rounding become zero. `starts` maps the rows of gap rates and slips that begin to
        grow to small values, so that rounding of the accelerations does not end the growth at once. The gaps of the
        contacts `near` (indices) do not change if they stay open.
        """
        y, held = touch.y, self.kinematics.held_rows(mode.states)
        if any(touch.gaps[i] for i in mode.closed):
            y = self.kinematics.closed(touch, mode.closed, near)
        if not held and not starts:
            return y
        if mode.immobile:
            return np.where(np.arange(len(y)) < self._layout.q.stop, y, 0.0)
        y, rows = y.copy(), [*held, *starts]
        changes = np.array([*np.zeros(len(held)), *starts.values()]) - touch.rates[rows]
        v = y[self._layout.v] + touch.least_motion(rows, changes)
        v[touch.directions[held].any(axis=0) & (np.abs(v) <= touch.velocity_noise)] = 0.0
        y[self._layout.v] = v
        return y


def _undetermined(kin: Kinematics, touch: ContactState, contacts: Sequence[int], count: int, what: str) -> Undetermined:
    """Return the error for a state at which the laws of contact allow no motion, or several.

    `contacts` are the indices of the contacts concerned, and `touch` has all contacts at this state. `count` is the
    number of motions. `what` is "motion" or "impact". If there are several motions, the cause is contacts that depend
    on each other. `kin` evaluates the contacts.
    """
    names = listing(repr(kin.contacts[i].name) for i in contacts)
    rows = touch.directions[[kin.normals[i] for i in contacts]]
    if count and (rank := len(independent_rows(rows))) < len(rows):
        return Undetermined(
            f"The contacts {names} depend on each other (rank {rank} of {len(rows)}) and have friction, so the motion "
            "depends on how they share their forces, which the laws do not determine: state fewer contacts, or equal "
            "friction."
        )
    layout = kin.model.layout
    coordinates = zip(layout.coordinates, layout.split(touch.y)[0].tolist(), strict=False)
    where = f"at {listing(f'{name} = {value:.6g}' for name, value in coordinates)}"
    for i, way in ((i, way) for i in contacts if len(kin.contacts[i].slip) == 1 for way in (1, -1)):
        normal, along = kin.rows[i]
        rate, noise = touch.rates[[along]], touch.noise[[along]]
        mu = kin.friction(i, rate, noise).kinetic
        closes = touch.compliance[normal, normal] <= mu * way * touch.compliance[normal, along]
        if closes and way * rate[0] >= -noise[0] and (region := _region(kin.model, i, way)):
            where = f"as friction presses {kin.contacts[i].name!r} together where {region} <= 0"
            break
    allowed = f"{count} different motions after this {what}" if count else f"no {what}"
    return Undetermined(
        f"Coulomb's law allows {allowed} at {names} (Painleve's paradox), {where}. Lower the friction, or end the run "
        "before."
    )


def _region(model: Model, which: int, way: int) -> str:
    """Return the formula, as text, of a gap's acceleration by a unit normal force and the sliding friction with it.

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
