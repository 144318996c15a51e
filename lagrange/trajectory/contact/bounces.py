"""Impacts without friction as resets of events, so that a compiled loop over steps handles many of them.

With the direction W = dgap/dq, gap rate u and the mass matrix M, an impact with restitution e has the impulse P = -(1 +
e) u / (W M^-1 W^T). It changes the velocities by M^-1 W^T P. It dissipates the energy (1 - e^2) u^2 / (2 W M^-1 W^T).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from lagrange.machine.backend import Kernel
from lagrange.machine.model import Model
from lagrange.statement.contact import Contact, impact_speed
from lagrange.statement.coordinate import t as time
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

SMALLEST_BOUNCE = 1e-7
"""Speed of an impact, relative to the largest of a series of decreasing impacts, below which the rest of the series is
summed. The height of the omitted bounces is 1e-14 of the first. Times of flight then have 8 digits.
"""

FEWEST_FLIGHTS = 3
"""Smallest number of flights, each shorter than the one before, that count as an accumulation."""

UNKNOWN_IMPACTS, ELASTIC_IMPACTS = 16, 2**16
"""Largest number of impacts in one call of a compiled loop. The first is for a restitution that depends on the speed,
the second for impacts without loss of energy.
"""

LARGEST_COUPLED = 3
"""Largest number of coordinates coupled by the mass matrix for which impacts are written out as resets."""

LONGEST = 2_000
"""Largest number of operations of the velocities after an impact that is written out."""


@dataclass(frozen=True, eq=False)
class WrittenImpacts:
    """Impacts without friction as resets of events: `resets` has one reset for each contact, or None.

    A reset is a dict from symbol to new value. It is None if the restitution is zero, the formulas are too long, or
    the gap is not a polynomial. `kernel` returns three numbers for each contact at a state: the impulse, the energy
    lost and the impact speed.
    """

    resets: tuple[dict[Any, Any] | None, ...]
    kernel: Kernel


def written_impacts(model: Model) -> WrittenImpacts | None:
    """Return the impacts of a model as formulas; None with constraints, friction or many coupled coordinates."""
    statement = model.statement
    if statement.constraints or any(contact.slip and not contact.friction[0].is_zero for contact in statement.contacts):
        return None
    if all(contact.restitution.is_zero for contact in statement.contacts):
        return None
    mass, resets, results = coupling(statement), [], []
    if mass is None:
        return None
    for contact in statement.contacts:
        written, impulse, lost, speed = _impact(contact, statement.coordinates, statement.velocities, mass)
        # A series locates the zero of another gap only to the tolerance of the run, which is not enough.
        exact = contact.gap.is_polynomial(*statement.coordinates, time)
        long = sum(int(value.count_ops()) for value in written.values()) > LONGEST
        resets.append(None if contact.restitution.is_zero or long or not exact else written)
        results += [impulse, lost, speed]
    nodes = tuple(map(model.equations.translate, results))
    return WrittenImpacts(tuple(resets), model.function("impacts", nodes)) if any(resets) else None


def coupling(statement: Statement) -> Any:
    """Return the mass matrix as a SymPy matrix, or None if the impact law cannot use it in symbols.

    This is so if it depends on velocities, or if it is not diagonal for more than `LARGEST_COUPLED` coordinates.
    """
    # Derivatives by symbols are a hundred times faster than those by functions of time.
    symbols = {rate: sympy.Dummy() for rate in statement.velocities}
    rates = list(symbols.values())
    lagrangian = statement.lagrangian.xreplace(symbols)
    momenta = [lagrangian.diff(rate) for rate in rates]
    mass = sympy.Matrix([[p.diff(rate) for rate in rates] for p in momenta])
    return None if mass.has(*rates) or not (mass.is_diagonal() or len(rates) <= LARGEST_COUPLED) else mass


def response_of(mass: Any, direction: Any) -> Any:
    """Return the accelerations M^-1 W (n,) due to a unit force along a direction W (n,)."""
    if mass.is_diagonal():
        return sympy.Matrix([w / mass[i, i] for i, w in enumerate(direction)])
    return mass.LUsolve(direction)


def _impact(
    contact: Contact, q: Sequence[Any], rates: Sequence[Any], mass: Any
) -> tuple[dict[Any, Any], Any, Any, Any]:
    """Return the reset of an impact of a contact, its impulse, its energy loss and its impact speed.

    All are expressions; the reset is a dict from symbol to new value, and also closes the gap exactly. `q` are the
    coordinates, `rates` the velocities, and `mass` is the mass matrix.
    """
    direction = sympy.Matrix([contact.gap.diff(x) for x in q])
    speed = -sympy.Add(partial_rate(contact.gap, q), *(w * v for w, v in zip(direction, rates, strict=True)))
    response = response_of(mass, direction)
    compliance = (direction.T * response)[0]
    e = contact.restitution.xreplace({impact_speed: speed})
    impulse = (1 + e) * speed / compliance
    lost = (1 - e**2) * speed**2 / (2 * compliance)
    moved = [(x, v, change) for x, v, change in zip(q, rates, response, strict=True) if change != 0]
    behind = {v: v + change * impulse for _, v, change in moved}
    # Rounding of the gap would not be small compared with the last flights.
    behind |= {x: x - change * contact.gap / compliance for x, _, change in moved}
    return behind, impulse, lost, speed


def partial_rate(gap: Any, q: Sequence[Any]) -> Any:
    """Return the partial derivative of a gap by time at fixed coordinates."""
    symbols = {x: sympy.Dummy() for x in q}
    return gap.xreplace(symbols).diff(time).xreplace({dummy: x for x, dummy in symbols.items()})


class Bounces:
    """The present series of impacts with ever shorter flights between them. It may accumulate at a finite time.

    `times` and `speeds` (k,) are those of the impacts in the series. `contacts` has the last `FEWEST_FLIGHTS`
    impacts: the set of the contacts that take part in each.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Remove all impacts from the series."""
        self.times, self.speeds = np.empty(0), np.empty(0)
        self.contacts: list[frozenset[int]] = []

    def add(self, times: FloatArray, speeds: FloatArray, contacts: Sequence[frozenset[int]]) -> None:
        """Add impacts with `times` and `speeds` (k,) to the series.

        `contacts` has, for each of the last impacts, the set of contacts that take part in it. A flight that is not
        shorter than the previous one begins a new series.
        """
        whole = np.append(self.times, times)
        again = np.flatnonzero(np.diff(whole, 2) >= 0)
        first = int(again[-1]) + 1 if len(again) else 0
        self.times, self.speeds = whole[first:], np.append(self.speeds, speeds)[first:]
        self.contacts = [*self.contacts, *contacts][-FEWEST_FLIGHTS:]

    def most(self, restitutions: Sequence[float | None]) -> int:
        """Return the number of impacts that a compiled loop may handle before the run tests for an accumulation.

        `restitutions` has the value of each contact, None if it depends on the speed. After this number of impacts
        the speed of a bouncing ball has decreased to about `SMALLEST_BOUNCE` of the largest speed in the series.
        """
        constants = [e for e in restitutions if e is not None and e > 0]
        weakest = min(constants, default=1.0)
        if len(constants) < len(restitutions) or weakest == 1.0:
            return UNKNOWN_IMPACTS if None in restitutions else ELASTIC_IMPACTS
        share = self.speeds[-1] / self.speeds.max() if len(self.speeds) else 1.0
        return max(1, math.ceil(math.log(SMALLEST_BOUNCE / share) / math.log(weakest)))

    @property
    def end(self) -> float | None:
        """The time at which the impacts accumulate, from the ratio of successive flights; None if they do not yet.

        None is also the result as long as the impact speed has not decreased to `SMALLEST_BOUNCE` of the largest.
        """
        few = not len(self.speeds) or self.speeds[-1] > SMALLEST_BOUNCE * self.speeds.max()
        return None if few else self.limit

    @property
    def limit(self) -> float | None:
        """The limit of the times of impact, if each of the last flights is shorter by the same ratio; else None."""
        if len(self.times) < FEWEST_FLIGHTS + 1:
            return None
        a, b, c = self.times[-3:].tolist()
        ratio = (c - b) / (b - a)
        return c + (c - b) * ratio / (1 - ratio) if ratio < 1 else None


def in_order(
    times: Sequence[FloatArray], states: Sequence[FloatArray]
) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
    """Return the occurrences of several events in order of time.

    `times` (k,) and `states` (k, 2n) have one array for each event. The results are the times (N,), the index of the
    event (N,), and the states (N, 2n) of all occurrences.
    """
    if len(times) == 1:
        return times[0], np.zeros(len(times[0]), dtype=np.intp), states[0]
    when, which = np.concatenate(times), np.repeat(np.arange(len(times)), list(map(len, times)))
    order = np.lexsort((which, when))
    return when[order], which[order], np.concatenate(states)[order]
