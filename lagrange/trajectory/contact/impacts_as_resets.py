"""Impacts, and sticking or sliding of one contact along a line, as resets that a compiled loop over steps applies.

Impacts without friction have explicit formulas. `transition.py` solves the general case. With the direction W =
dgap/dq, gap rate u, restitution e and mass matrix M, its impulse is P = -(1 + e) u / (W M^-1 W^T). It changes the
velocities by M^-1 W^T P, and dissipates the energy (1 - e^2) u^2 / (2 W M^-1 W^T).

Friction has explicit formulas for one closed contact. The state has one more coordinate, the way w: 1 or -1 while the
contact slides, 0 while it sticks. The equations are M a = h + W N + D f, with constant M, D = dslip/dv and W M^-1 D =
0. The normal force then is N = -(W M^-1 h + d2gap/dt2) / (W M^-1 W^T). The force that holds the slip at zero is F = -(D
   M^-1 h + dslip/dt) / (D M^-1 D^T). The friction force is f = (1 - w^2) F - mu w N.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from lagrange.machine.kernel.python_kernel import PythonKernel
from lagrange.machine.model import Model
from lagrange.statement.contact import Contact, impact_speed
from lagrange.statement.coordinate import coordinate_of, velocity_of
from lagrange.statement.coordinate import t as time
from lagrange.statement.event import Event
from lagrange.statement.statement import Statement
from lagrange.trajectory.contact.kinematics import MODELS_KEPT
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.trajectory import FloatArray, Trajectory

LARGEST_COUPLED = 3
"""Largest number of coordinates coupled by the mass matrix for which impacts are written out as resets."""

LONGEST_RESET = 2_000
"""Largest number of operations in the reset of an impact that is written out."""

SLIGHT, SHORT = 2.0**-48, 1e-3
"""Numbers for the rate with which a gap or a slip begins to grow after a change of the mode. The rate is the first
number (16 times 2**-52) times a velocity. This velocity is the largest term of the accelerations, multiplied by |t|, or
by the second number times the duration of the run if that is longer."""

ORTHOGONAL = 1e-14
"""Largest scalar product of two orthogonal directions, as a fraction of its terms. It is not exactly zero because the
numbers in the statement are rounded."""


@dataclass(frozen=True, eq=False)
class WrittenImpacts:
    """Impacts without friction as resets of events. `resets` has a reset or None for each contact.

    A reset is a dict from coordinates and velocities to their new values. It is None if the restitution is zero, the
    formulas are too long, or the gap is not a polynomial. `kernel` returns for each contact the impulse, the energy
    lost and the impact speed.
    """

    resets: tuple[dict[Any, Any] | None, ...]
    kernel: PythonKernel


@lru_cache(maxsize=MODELS_KEPT)
def written_impacts(model: Model) -> WrittenImpacts | None:
    """Return the impacts of a model's contacts as resets, or None if no reset can be written as a formula.

    The result is also None for a system with constraints, with friction or with many coupled coordinates.
    """
    statement = model.statement
    if statement.constraints or any(contact.slip and not contact.friction[0].is_zero for contact in statement.contacts):
        return None
    if all(contact.restitution.is_zero for contact in statement.contacts):
        return None
    mass, resets, results = coupling(statement), [], []
    if mass is None:
        return None
    q, rates = statement.coordinates, statement.velocities
    for contact in statement.contacts:
        direction = sympy.Matrix([contact.gap.diff(x) for x in q])
        speed = -sympy.Add(partial_rate(contact.gap, q), *(w * v for w, v in zip(direction, rates, strict=True)))
        response = response_of(mass, direction)
        compliance = (direction.T * response)[0]
        e = contact.restitution.xreplace({impact_speed: speed})
        impulse = (1 + e) * speed / compliance
        results += [impulse, (1 - e**2) * speed**2 / (2 * compliance), speed]
        moved = [(x, v, change) for x, v, change in zip(q, rates, response, strict=True) if change != 0]
        reset = {v: v + change * impulse for _, v, change in moved}
        # The gap is set to zero: its rounding would not be small compared with the last flights.
        reset |= {x: x - change * contact.gap / compliance for x, _, change in moved}
        # The zero of a gap that is not a polynomial is located only to the tolerance of the run, which is not enough.
        exact = contact.gap.is_polynomial(*q, time)
        long = sum(int(value.count_ops()) for value in reset.values()) > LONGEST_RESET
        resets.append(None if contact.restitution.is_zero or long or not exact else reset)
    program = model.function("impacts", tuple(map(model.equations.translate, results))).program
    return WrittenImpacts(tuple(resets), PythonKernel(program)) if any(resets) else None


@lru_cache(maxsize=MODELS_KEPT)
def coupling(statement: Statement) -> Any:
    """Return the mass matrix of a system as a SymPy matrix, or None if the formulas of impacts would be too long.

    They are too long if the matrix depends on velocities, or is not diagonal and has more than `LARGEST_COUPLED` rows.
    """
    # Derivatives by symbols are a hundred times faster than those by functions of time.
    symbols = {rate: sympy.Dummy() for rate in statement.velocities}
    rates = list(symbols.values())
    lagrangian = statement.lagrangian.xreplace(symbols)
    momenta = [lagrangian.diff(rate) for rate in rates]
    mass = sympy.Matrix([[p.diff(rate) for rate in rates] for p in momenta])
    return None if mass.has(*rates) or not (mass.is_diagonal() or len(rates) <= LARGEST_COUPLED) else mass


def response_of(mass: Any, direction: Any) -> Any:
    """Return the accelerations M^-1 W (n,) by a unit force along a `direction` W (n,). M is the `mass` matrix."""
    if mass.is_diagonal():
        return sympy.Matrix([w / mass[i, i] for i, w in enumerate(direction)])
    return mass.LUsolve(direction)


def partial_rate(gap: Any, q: Sequence[Any]) -> Any:
    """Return the partial derivative of a gap by time, with the coordinates `q` fixed."""
    symbols = {x: sympy.Dummy() for x in q}
    return gap.xreplace(symbols).diff(time).xreplace({dummy: x for x, dummy in symbols.items()})


def sliding_friction(contact: Contact, way: Any) -> list[Any]:
    """Return the friction forces of a sliding contact, one for each slip component.

    `way` is the direction of sliding along a line: 1, -1 or an expression. In a plane it is not used.
    """
    size = contact.friction[1] * contact.normal
    if len(contact.slip) == 1:
        return [-size * way]
    return [-size * slip / contact.slip_speed for slip in contact.slip]


def friction_margin(contact: Contact, forces: Iterable[Any]) -> Any:
    """Return (mu N)^2 - |f|^2 with the static mu and friction `forces` f: a contact sticks while this is positive."""
    return contact.friction[0] ** 2 * contact.normal**2 - sympy.Add(*(force**2 for force in forces))


@dataclass(frozen=True, eq=False)
class WrittenFriction:
    """The friction of the contact with index `which`, as a `model` whose state has one more coordinate, the way.

    The way is 1 or -1, the direction of sliding, or 0 while the contact sticks. `moment` is a parameter of the model: a
    short time, `SHORT` times the duration of the run. `normal` is the expression of the normal force. `events` end
    sticking and sliding; they reset the way and the velocities.
    """

    which: int
    model: Model
    moment: Any
    normal: Any
    events: tuple[Event, ...]

    def with_way(self, problem: Problem, way: int) -> Problem:
        """Return a problem of the system as a problem of this model. The coordinate of the way starts at `way`."""
        indices = [self.model.layout.q.stop - 1, len(problem.y0)]
        y0 = np.insert(problem.y0, indices, [way, 0.0])
        largest = None if problem.largest is None else np.insert(problem.largest, indices, [1.0, 0.0])
        whole = problem.whole or problem
        parameters = {**problem.parameters, self.moment: SHORT * (whole.t1 - whole.t0)}
        return replace(problem, model=self.model, y0=y0, largest=largest, parameters=parameters)

    def plain(self, y: FloatArray) -> FloatArray:
        """Return states of the system, (2n,) or (2n, N): states y of this model without the way and its velocity."""
        return np.delete(y, [self.model.layout.q.stop - 1, self.model.layout.v.stop - 1], axis=0)

    def plain_at(self, path: Callable[[FloatArray], FloatArray], times: FloatArray) -> FloatArray:
        """Return the states (2n, K) of the system at times (K,), from the dense output `path` of this model."""
        return self.plain(path(times))

    def plain_run(self, part: Trajectory) -> Trajectory:
        """Return a run of this model as a run of the system, with states without the additional coordinate."""
        events = tuple(self.plain(states.T).T for states in part.y_events)
        return replace(part, y=self.plain(part.y), dense=partial(self.plain_at, part.dense), y_events=events)


@lru_cache(maxsize=MODELS_KEPT)
def written_friction(model: Model, which: int) -> WrittenFriction | None:
    """Return a model in which the contact with index `which` is closed and events end its sticking and sliding.

    Return None unless the friction acts along a line, does not change the gap, and has short formulas. The mass matrix,
    dgap/dq and dslip/dv must be constant, and the system must have no constraints and no inputs.
    """
    statement, contact = model.statement, model.statement.contacts[which]
    q, rates, mass = statement.coordinates, statement.velocities, coupling(statement)
    if len(contact.slip) != 1 or mass is None or statement.constraints or statement.inputs:
        return None
    lines = [
        sympy.Matrix([expression.diff(x) for x in variables])
        for expression, variables in ((contact.gap, q), (contact.slip[0], rates))
    ]
    rows = sympy.Matrix([*mass, *lines[0], *lines[1]])
    if rows.has(time, *q, *rates) or any(contact.slip[0].diff(x) != 0 for x in q) or mass.det() == 0:
        return None
    responses = [response_of(mass, line) for line in lines]
    # Friction changes the gap if this product is not zero, at irrational values of the parameters.
    values = {symbol: sympy.sqrt(sympy.prime(k + 1)) for k, symbol in enumerate(statement.parameters)}
    terms = [float((x * y).xreplace(values)) for x, y in zip(lines[0], responses[1], strict=True)]
    if abs(math.fsum(terms)) > ORTHOGONAL * sum(map(abs, terms)):
        return None
    return _written(model, which, lines, responses)


def _written(model: Model, which: int, lines: list[Any], responses: list[Any]) -> WrittenFriction:
    """Return the friction of the contact with index `which` as formulas of the module's docstring.

    `lines` are W = dgap/dq and D = dslip/dv. `responses` are M^-1 W and M^-1 D, with the mass matrix M.
    """
    statement, contact, layout = model.statement, model.statement.contacts[which], model.layout
    q, rates = statement.coordinates, statement.velocities
    names = {*statement.names, *(symbol.name for symbol in statement.parameters)}
    name = contact.name + "_"
    while name + "way" in names or name + "moment" in names:
        name += "_"
    way, moment = coordinate_of(name + "way"), sympy.Symbol(name + "moment", real=True)

    # The normal force N, and the force that keeps the slip at zero.
    free = [model.equations.express(node) for node in model.equations.bias]
    at_rest = contact.slip[0].xreplace(dict.fromkeys(rates, sympy.S.Zero))
    drifts = partial_rate(partial_rate(contact.gap, q), q), at_rest.diff(time)
    sizes = [line.dot(response) for line, response in zip(lines, responses, strict=True)]
    normal, hold = (
        -sympy.Add(drift, *(x * y for x, y in zip(response, free, strict=True))) / size
        for drift, response, size in zip(drifts, responses, sizes, strict=True)
    )
    slides, way_rate = way**2, velocity_of(way)
    with_normal = {contact.normal: normal}
    friction = (1 - slides) * hold + sliding_friction(contact, way)[0].xreplace(with_normal)
    applied = [force + w * normal + d * friction for force, w, d in zip(statement.forces, *lines, strict=True)]
    stated = replace(
        statement,
        coordinates=(*q, way),
        kinetic=statement.kinetic + way_rate**2 / 2,
        lagrangian=statement.lagrangian + way_rate**2 / 2,
        forces=(*applied, sympy.S.Zero),
        parameters=(*statement.parameters, moment),
        defaults=MappingProxyType({**statement.defaults, moment: 0.0}),
        initial=tuple(np.insert(statement.initial, [layout.q.stop, layout.v.stop], 0.0).tolist()),
        contacts=(),
    )

    # Events between sliding and sticking. Gap and gap rate become zero; the slip becomes zero, or small.
    cone = friction_margin(contact, [hold]).xreplace(with_normal)
    slip_direction = -sympy.sign(hold)
    way_after_stop = sympy.Piecewise((0, cone >= 0), (1, True)) * slip_direction
    small_slip = 2 * SLIGHT * abs(hold) * sizes[1] * sympy.Max(abs(time), moment)
    gap_rate = partial_rate(contact.gap, q) + lines[0].dot(sympy.Matrix(rates))
    zeros, events = ((1 - slides) * cone + slides, way * contact.slip[0] + 1 - slides), []
    for zero, new_way in zip(zeros, (slip_direction, way_after_stop), strict=True):
        slip_error, reset = (contact.slip[0] - new_way * small_slip) / sizes[1], {way: new_way}
        for x, v, up, along in zip(q, rates, *responses, strict=True):
            if up != 0:
                reset[x] = x - up * (contact.gap / sizes[0])
            if up != 0 or along != 0:
                reset[v] = v - up * (gap_rate / sizes[0]) - along * slip_error
        events.append(Event(zero, direction=-1, reset=reset))
    return WrittenFriction(which, model.on_same_machine(stated), moment, normal, tuple(events))


def in_order(
    times: Sequence[FloatArray], states: Sequence[FloatArray]
) -> tuple[FloatArray, NDArray[np.intp], FloatArray]:
    """Return the occurrences of several events in order of time.

    `times` and `states` have one array for each event: the times (k,) and states (k, 2n) of its k occurrences. The
    results are the times (N,), the indices of the events (N,), and the states (N, 2n) of all N occurrences.
    """
    if len(times) == 1:
        return times[0], np.zeros(len(times[0]), dtype=np.intp), states[0]
    when, which = np.concatenate(times), np.repeat(np.arange(len(times)), list(map(len, times)))
    order = np.lexsort((which, when))
    return when[order], which[order], np.concatenate(states)[order]
