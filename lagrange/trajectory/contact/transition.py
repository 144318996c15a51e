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
from lagrange.trajectory.contact.complementarity import OPEN, SLIDING, Balance, Friction, solutions
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
    of a contact to a row: time, normal impulse, energy lost, friction impulse. `speed` is the largest impact speed of
    the contacts whose gap closed. `unseen` are the indices of contacts that open and would close again while their gap
    is still within rounding.
    """

    y: FloatArray
    before: FloatArray
    mode: Mode
    impacts: dict[int, FloatArray] = field(default_factory=dict)
    speed: float = 0.0
    unseen: frozenset[int] = frozenset()


class Transitions:
    """Computes the state and the mode of a run after a mode has ended.

    `shared` is a sentence on contacts whose forces the laws did not determine, or "".
    """

    def __init__(self, modes: Modes, kinematics: Kinematics, span: float, rtol: float) -> None:
        self.modes, self.kinematics = modes, kinematics
        self._layout, self._slowest, self._moment = modes.model.layout, 0.0, SHORT * span
        self._slow_share = max(SLOWEST, rtol)
        self.shared = ""

    def after(
        self,
        touch: Touch,
        mode: Mode,
        *,
        met: Collection[int] = (),
        released: Collection[int] = (),
        stopped: Collection[int] = (),
        freed: Collection[int] = (),
        plastic: Collection[int] = (),
    ) -> Transition:
        """Return the result of the transition after a mode that ends at the state of `touch`.

        The mode is ended by contacts whose gap (`met`), normal force (`released`) or slip (`stopped`) became zero, or
        whose friction force reached the largest value that sticking allows (`freed`). Impacts of `plastic` contacts
        have no restitution, and these contacts stay closed. Raises `Undetermined` if the laws of contact do not
        determine the result.
        """
        kin = self.kinematics
        normals = kin.normals
        near = [i for i in range(len(normals)) if i in met or touch.gaps[i] <= touch.near]
        if overlapping := [i for i in near if touch.gaps[i] < 0]:
            touch = kin.at(touch.t, kin.closed(touch, overlapping, near), touch)
        before = touch.y
        lasting = [i for i in mode.closed if i not in released]
        touching = sorted({*near, *lasting} - set(released))
        if not touching and not released:
            flying = Mode((OPEN,) * len(normals), (None,) * len(normals))
            return Transition(before, before, self._with_constraints(touch, flying))
        ways = self._freed_ways(touch, mode, freed) if freed else {}
        impacts: dict[int, FloatArray] = {}
        closing = [i for i in touching if touch.rates[normals[i]] < -touch.noise[normals[i]] and i not in lasting]
        speed = max((-float(touch.rates[normals[i]]) for i in closing), default=0.0)
        if closing:
            y, impacts = self._impact(touch, touching, plastic)
            touch, rates = kin.at(touch.t, y, touch), touch.rates
            # A slip that stopped or began at this instant does not any more, if the impact changed it.
            changed = set(kin.owners[np.abs(touch.rates - rates) > touch.noise].tolist())
            stopped, ways = set(stopped) - changed, {i: way for i, way in ways.items() if i not in changed}
        still = touch.noise + IMPACT_NOISE * speed
        resting = [i for i in touching if touch.rates[normals[i]] <= still[normals[i]] or i in plastic]
        y, following, pulls = self._next(touch, resting, stopped, ways, released, near)
        # A slip that was rounding, and that the change to the mode removed or reversed, is zero.
        changes = touch.directions @ (y - touch.y)[self._layout.v]
        slides = [(i, kin.rows[i][1], way) for i, way in enumerate(following.ways) if way is not None]
        if turned := [i for i, row, way in slides if way * (touch.rates[row] + changes[row]) <= 0]:
            y, following, pulls = self._next(touch, resting, {*stopped, *turned}, ways, released, near)
        unseen = frozenset(
            i
            for i in touching
            if i not in following.closed
            and 0 < touch.rates[normals[i]] ** 2 < -2 * pulls[normals[i]] * SMALLEST_GAP / TOUCHING * touch.near
        )
        return Transition(y, before, following, impacts, speed, unseen)

    def _with_constraints(self, touch: Touch, mode: Mode) -> Mode:
        """Return a mode with its independent constraints in `kept`, and `still` if they leave no freedom."""
        kin, kept = self.kinematics, None
        held = kin.held_rows(mode.states)
        count = len(kin.model.statement.constraints) + len(held)
        if len(held) > 1:
            rows = independent_rows(np.vstack([kin.stated_directions(touch.t, touch.y), touch.directions[held]]))
            kept = None if len(rows) == count else rows
        still = self.modes.leaves_no_freedom(mode, count if kept is None else len(kept))
        return replace(mode, kept=kept, still=still)

    def _freed_ways(self, touch: Touch, mode: Mode, freed: Collection[int]) -> dict[int, FloatArray]:
        """Return the direction (components,) in which each contact of `freed` begins to slide, by its index.

        It is opposite to the friction force that held the contact in `mode`.
        """
        model = self.modes.model_of(mode)
        forces = model.multipliers(*self._layout.split(touch.y), touch.t, self.kinematics.parameters)
        by_name = dict(zip((each.name for each in model.statement.constraints), forces, strict=True))
        held = {i: np.array([by_name[name] for name in self.kinematics.contacts[i].slip_names]) for i in freed}
        return {i: -force / np.linalg.norm(force) for i, force in held.items()}

    def _impact(
        self, touch: Touch, touching: Sequence[int], plastic: Collection[int]
    ) -> tuple[FloatArray, dict[int, FloatArray]]:
        """Return the state after an impact, and the impacts as in `Transition`.

        `touching` are the indices of all contacts with zero gap, which may exchange impulses. `plastic` contacts have
        no restitution.
        """
        kin, law, matrix = self.kinematics, self.modes.model.statement.simultaneous, touch.compliance
        rows = [row for i in touching for row in kin.rows[i]]
        # The change of each rate by a unit impulse of another contact.
        coupled = np.abs(matrix)[np.ix_(rows, rows)] * np.not_equal.outer(kin.owners[rows], kin.owners[rows])
        if not law and coupled.max() > UNCOUPLED * np.abs(matrix).max():
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
            added = self._impulses(touch, rates, chosen, touching if rounds and last else plastic)
            impulses, before = impulses + added, rates
            rates = touch.rates + matrix @ impulses
            lost -= added * (before + rates) / 2
            rounds += 1
        after = touch.y.copy()
        after[self._layout.v] += touch.responses @ impulses
        impacts = {}
        for i in touching:
            push, *friction = impulses[kin.rows[i]]
            if push:
                impacts[i] = np.array([touch.t, push, lost[kin.rows[i]].sum(), *friction])
        return after, impacts

    def _impulses(self, touch: Touch, rates: FloatArray, chosen: Sequence[int], plastic: Collection[int]) -> FloatArray:
        """Return the impulses (rows,) of one impact, by Newton's law of restitution and Coulomb's law of friction.

        Only the `chosen` contacts have impulses. `rates` (rows,) are the gap rates and slips before the impact.
        `plastic` contacts have no restitution.
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
        rows, balance = self._balance(touch, laws, bias, "impact")
        impulses = np.zeros(len(rates))
        impulses[rows] = balance.forces
        return impulses

    def _balance(
        self, touch: Touch, laws: dict[int, Friction], bias: FloatArray, what: str
    ) -> tuple[list[int], Balance]:
        """Return the forces, or impulses, of contacts at rest in `touch`, and the rows to which they belong.

        `laws` has the friction of each of these contacts by its index. `bias` (rows,) are the rates without these
        forces. Raises `Undetermined` if there is no solution, or more than one. `what` is "motion" or "impact",
        for its message.
        """
        kin = self.kinematics
        rows = [row for i, law in laws.items() for row in kin.rows[i][: 1 + law.components]]
        matrix = touch.compliance[np.ix_(rows, rows)]
        balances = solutions(matrix, bias[rows], list(laws.values()), kin.model.machine)
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

    def _next(
        self,
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
        free = np.asarray(kin.model.kernel("rhs")(touch.t, touch.y, kin.parameters))[self._layout.v]
        pulls = touch.directions @ free + touch.bias
        terms = np.abs(touch.directions) @ np.abs(free) + np.abs(touch.bias)
        if resting:
            laws = {}
            for i in resting:
                along = kin.rows[i][1:]
                slip = np.zeros(len(along)) if i in stopped else touch.rates[along]
                laws[i] = kin.friction(i, slip, np.array([self._slow(touch, along)]))
                if i in ways:
                    laws[i] = replace(laws[i], way=ways[i])
            rows, balance = self._balance(touch, laws, pulls, "motion")
            pulls = pulls + touch.compliance[:, rows] @ balance.forces
            terms[rows] += np.abs(touch.compliance[np.ix_(rows, rows)]) @ np.abs(balance.forces)
            for i, state, way in zip(resting, balance.states, balance.ways, strict=True):
                states[i] = state
                if state == SLIDING and way is not None:
                    slides[i] = way
                    kept_ways[i] = round(float(way[0])) if len(way) == 1 else None
        in_plane = any(len(way) > 1 for way in slides.values())
        if in_plane and not self._slowest:
            # Bodies at rest have no speeds to compare with, but those that they reach early in the run.
            self._slowest = self._slow_share / STILL * float(touch.noise.max())
            self._slowest = self._slowest or self._slow_share * float(terms.max()) * self._moment
        mode = Mode(tuple(states), tuple(kept_ways), slowest=self._slowest if in_plane else 0.0)
        mode = self._with_constraints(touch, mode)
        slight = SLIGHT * float(terms.max()) * max(abs(touch.t), self._moment)
        begins = {kin.normals[i]: slight for i in {*resting, *released} if states[i] == OPEN}
        for i, way in slides.items():
            along = kin.rows[i][1:]
            if i in stopped or np.linalg.norm(touch.rates[along]) <= self._slow(touch, along):
                slow = 0.0 if len(way) == 1 else 2 * self._slow(touch, along)
                begins |= dict(zip(along, (max(slow, slight) * way).tolist(), strict=True))
        return self._entered(touch, mode, begins, near), mode, pulls

    def _slow(self, touch: Touch, along: Sequence[int]) -> float:
        """Return the speed up to which a slip in the rows `along` counts as zero: in a plane, that of the mode."""
        noise = float(touch.noise[along].max(initial=0.0))
        return max(self._slowest, noise) if len(along) > 1 else noise

    def _entered(self, touch: Touch, mode: Mode, begins: dict[int, float], near: Sequence[int]) -> FloatArray:
        """Return the state of `touch` (2n,) changed to satisfy the constraints of a mode: closed gaps, and no slips.

        The change is the least, measured by the kinetic energy. Velocities that are rounding become zero. `begins`
        maps rows of gap rates and slips that begin to grow to small initial values. Without these values, rounding of
        the accelerations could end the growth at once. The gaps of the contacts `near` (indices) do not change if they
        stay open.
        """
        y, held = touch.y, self.kinematics.held_rows(mode.states)
        if any(touch.gaps[i] for i in mode.closed):
            y = self.kinematics.closed(touch, mode.closed, near)
        if not held and not begins:
            return y
        if mode.still:
            return np.where(np.arange(len(y)) < self._layout.q.stop, y, 0.0)
        y, rows = y.copy(), [*held, *begins]
        changes = np.array([*np.zeros(len(held)), *begins.values()]) - touch.rates[rows]
        v = y[self._layout.v] + touch.least_motion(rows, changes)
        v[touch.directions[held].any(axis=0) & (np.abs(v) <= touch.still)] = 0.0
        y[self._layout.v] = v
        return y


def _undetermined(kin: Kinematics, touch: Touch, chosen: Sequence[int], count: int, what: str) -> Undetermined:
    """Return the error for contacts `chosen` at a state at which the laws allow `count` motions.

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
    layout = kin.model.layout
    coordinates = zip(layout.coordinates, layout.split(touch.y)[0].tolist(), strict=False)
    where = f"at {listing(f'{name} = {value:.6g}' for name, value in coordinates)}"
    for i, way in ((i, way) for i in chosen if len(kin.contacts[i].slip) == 1 for way in (1, -1)):
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
