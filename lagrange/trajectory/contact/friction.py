"""Friction along a line as resets of events: one model slides both ways and sticks, in one compiled loop over steps.

The state has one more coordinate, the way w: 1 or -1 while the contact slides, 0 while it sticks. The equations are M a
= h + W N + D f, with constant M, W = dgap/dq and D = dslip/dv, and W M^-1 D = 0. The normal force then is N = -(W M^-1
h + d2gap/dt2) / (W M^-1 W^T). The force that holds the slip at zero is F = -(D M^-1 h + dslip/dt) / (D M^-1 D^T). The
friction force is f = (1 - w^2) F - mu w N.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy

from lagrange.equations.euler_lagrange import StateLayout
from lagrange.machine.model import Model
from lagrange.statement.contact import Contact
from lagrange.statement.coordinate import coordinate_of, velocity_of
from lagrange.statement.coordinate import t as time
from lagrange.statement.event import Event
from lagrange.trajectory.contact.bounces import coupling, in_order, partial_rate, response_of
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray, Trajectory

SLIGHT, SHORT = 2.0**-48, 1e-3
"""Initial slip or gap after a change: the first number times the change by the largest acceleration terms, during the
time so far or a short part (the second number) of the run. It is 16 units of their rounding.
"""

UNCOUPLED = 1e-14
"""Two directions are uncoupled if their product is below this fraction of its terms: rounding of the stated numbers."""


@dataclass(frozen=True, eq=False)
class WrittenFriction:
    """The friction of the contact `which`, as a `model` whose state has one more coordinate, the way.

    The way is 1 or -1, the direction of sliding, or 0 while the contact sticks. `moment` is a parameter of that
    model, a short time. `normal` is the expression of the normal force. `events` end sticking and sliding, and reset
    the way and the velocities.
    """

    which: int
    model: Model
    moment: Any
    normal: Any
    events: tuple[Event, ...]

    def of_whole(self, problem: Problem, way: int, moment: float) -> Problem:
        """Return a problem of the system as a problem of this model, whose state has one more coordinate, the way.

        `way` is its initial value: the direction of sliding, 1 or -1, or 0 for sticking. `moment` is the value of the
        parameter `moment`, a short time.
        """
        indices = [self.model.layout.q.stop - 1, len(problem.y0)]
        y0 = np.insert(problem.y0, indices, [way, 0.0])
        largest = None if problem.largest is None else np.insert(problem.largest, indices, [1.0, 0.0])
        parameters = {**problem.parameters, self.moment: moment}
        return replace(problem, model=self.model, y0=y0, largest=largest, parameters=parameters)

    def plain(self, y: FloatArray) -> FloatArray:
        """Return states of the system, (2n,) or (2n, N), from states of this model, without the way and its rate."""
        return plain_states(self.model.layout, y)

    def plain_run(self, part: Trajectory) -> Trajectory:
        """Return a run of this model as a run of the system: the way is removed from its states."""
        events = tuple(self.plain(states.T).T for states in part.y_events)
        dense = PlainPath(part.dense, self.model.layout)
        return replace(part, y=self.plain(part.y), dense=dense, y_events=events)

    def ways(self, part: Trajectory, last: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the changes between sliding and sticking in the run `part`, whose last state is `last` (2n + 2,).

        The results are the times (k,), the states before the changes (k, 2n + 2), and the ways after them (k,). A way
        is the direction of sliding, 1 or -1, or 0 for sticking.
        """
        first, row = -len(self.events), self.model.layout.q.stop - 1
        times, _, states = in_order(part.t_events[first:], part.y_events[first:])
        return times, states, np.append(states[:, row], last[row])[1:]


@dataclass(frozen=True)
class PlainPath:
    """Dense output of a system, computed from the dense output `path` of a model with one more coordinate.

    `layout` is the layout of the model's states.
    """

    path: Callable[[FloatArray], FloatArray]
    layout: StateLayout

    def __call__(self, times: FloatArray) -> FloatArray:
        """Return the states (2n - 2, K) of the system at times (K,). The states of the model have length 2n."""
        return plain_states(self.layout, self.path(times))


def plain_states(layout: StateLayout, y: FloatArray) -> FloatArray:
    """Return states without the last coordinate and its velocity."""
    return np.delete(y, [layout.q.stop - 1, layout.v.stop - 1], axis=0)


def written_friction(model: Model, which: int) -> WrittenFriction | None:
    """Return the friction of the contact with index `which` as a model with events, or None if that is not possible.

    It is possible for friction along a line that is not coupled to the gap, with constant mass matrix.
    """
    statement, contact = model.statement, model.statement.contacts[which]
    q, rates = statement.coordinates, statement.velocities
    mass = coupling(statement)
    if len(contact.slip) != 1 or mass is None or statement.constraints or statement.inputs:
        return None
    normal, along = (
        [expression.diff(x) for x in of] for expression, of in ((contact.gap, q), (contact.slip[0], rates))
    )
    rows = sympy.Matrix([*mass, *normal, *along])
    if rows.has(time, *q, *rates) or any(contact.slip[0].diff(x) != 0 for x in q) or mass.det() == 0:
        return None
    lines = [sympy.Matrix(line) for line in (normal, along)]
    responses = [response_of(mass, line) for line in lines]
    if _coupled(lines[0], responses[1], statement.parameters):
        return None
    free = [model.equations.express(node) for node in model.equations.bias]
    stated = contact.slip[0].xreplace(dict.fromkeys(rates, sympy.S.Zero))
    drifts = partial_rate(partial_rate(contact.gap, q), q), stated.diff(time)
    sizes = [line.dot(response) for line, response in zip(lines, responses, strict=True)]
    force, hold = (
        -sympy.Add(drift, *(x * y for x, y in zip(response, free, strict=True))) / size
        for drift, response, size in zip(drifts, responses, sizes, strict=True)
    )
    return _written(model, which, _Forces(contact, force, hold, lines, responses, sizes))


def _coupled(line: Any, response: Any, parameters: Sequence[Any]) -> bool:
    """Return True if the product of the vectors `line` and `response` is not zero.

    `line` is one direction, such as that of the gap. `response` are the accelerations due to a force along another
    one, such as the slip. The product is tested at irrational values of the parameters.
    """
    values = {symbol: sympy.sqrt(sympy.prime(k + 1)) for k, symbol in enumerate(parameters)}
    terms = [float((x * y).xreplace(values)) for x, y in zip(line, response, strict=True)]
    return abs(math.fsum(terms)) > UNCOUPLED * sum(map(abs, terms))


@dataclass(frozen=True, eq=False)
class _Forces:
    """A contact with its `normal` force N and the force `hold` that keeps its slip at zero, as expressions.

    `lines` are W = dgap/dq and D = dslip/dv, `responses` are M^-1 W and M^-1 D with the mass matrix M, and `sizes`
    are W M^-1 W^T and D M^-1 D^T.
    """

    contact: Contact
    normal: Any
    hold: Any
    lines: list[Any]
    responses: list[Any]
    sizes: list[Any]


def _written(model: Model, which: int, forces: _Forces) -> WrittenFriction:
    statement, contact = model.statement, forces.contact
    names = {*statement.names, *(symbol.name for symbol in statement.parameters)}
    name = contact.name + "_"
    while name + "way" in names or name + "moment" in names:
        name += "_"
    way, moment = coordinate_of(name + "way"), sympy.Symbol(name + "moment", real=True)
    slides, rate = way**2, velocity_of(way)
    friction = (1 - slides) * forces.hold - contact.friction[1] * way * forces.normal
    applied = [
        force + w * forces.normal + d * friction for force, w, d in zip(statement.forces, *forces.lines, strict=True)
    ]
    stated = replace(
        statement,
        coordinates=(*statement.coordinates, way),
        kinetic=statement.kinetic + rate**2 / 2,
        lagrangian=statement.lagrangian + rate**2 / 2,
        forces=(*applied, sympy.S.Zero),
        parameters=(*statement.parameters, moment),
        defaults=MappingProxyType({**statement.defaults, moment: 0.0}),
        initial=tuple(np.insert(statement.initial, [model.layout.q.stop, model.layout.v.stop], 0.0).tolist()),
        contacts=(),
    )
    cone = (contact.friction[0] * forces.normal) ** 2 - forces.hold**2
    onwards = -sympy.sign(forces.hold)
    after = sympy.Piecewise((0, cone >= 0), (1, True)) * onwards
    events = (
        Event((1 - slides) * cone + slides, direction=-1, reset=_behind(statement, forces, moment, way, onwards)),
        Event(way * contact.slip[0] + 1 - slides, direction=-1, reset=_behind(statement, forces, moment, way, after)),
    )
    return WrittenFriction(which, model.on_same_machine(stated), moment, forces.normal, events)


def _behind(statement: Any, forces: _Forces, moment: Any, way: Any, onwards: Any) -> dict[Any, Any]:
    """Return the reset at a change between sliding and sticking, as a dict from symbols to their new values.

    Gap and gap rate become zero. `onwards` is the new way: 0 makes the slip zero, 1 or -1 makes it small in this
    direction. `way` is the coordinate for the way. `forces` are those of the contact, and `moment` is the parameter
    that is a short time.
    """
    contact, q = forces.contact, statement.coordinates
    pace = 2 * SLIGHT * abs(forces.hold) * forces.sizes[1] * sympy.Max(abs(time), moment)
    rate = partial_rate(contact.gap, q) + forces.lines[0].dot(sympy.Matrix(statement.velocities))
    errors = contact.gap / forces.sizes[0], rate / forces.sizes[0], (contact.slip[0] - onwards * pace) / forces.sizes[1]
    behind = {way: onwards}
    for x, v, up, along in zip(q, statement.velocities, *forces.responses, strict=True):
        if up != 0:
            behind[x] = x - up * errors[0]
        if up != 0 or along != 0:
            behind[v] = v - up * errors[1] - along * errors[2]
    return behind
