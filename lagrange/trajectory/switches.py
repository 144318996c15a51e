"""Switching surfaces of coordinates and velocities: steps end on them, and the equations go on with the other side.

A step across a kink of the forces loses the order of the method. Each side of a surface is a parameter here, so the
equations are smooth, and a surface is an event that sets its side. Series locate surfaces by themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import sympy

from lagrange.equations.euler_lagrange import Equations, MotionForm
from lagrange.graph.node import Binding, Kind, Node, reachable
from lagrange.machine.backend import SingularMassMatrix
from lagrange.machine.model import Model
from lagrange.program.switching import SWITCHES, Switched, switch
from lagrange.statement.event import Event
from lagrange.trajectory.events.actions import rates
from lagrange.trajectory.events.end_messages import EventResult, accumulating, sliding
from lagrange.trajectory.events.event_log import ChangeCounter
from lagrange.trajectory.events.surfaces import Sliding, clear, settled_sides
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import message
from lagrange.trajectory.parts import joined, last_state, point_of, rest_of, status_at_end
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

HIGHEST_RATE = 3
"""Highest derivative of a surface by time that decides the side on which the motion leaves it."""

FIRST_SCALE = 1e-3
"""Time scale of these derivatives at the start of a run, as a fraction of the run."""


FAILED = (Status.NON_FINITE, Status.SINGULAR, Status.STEP_TOO_SMALL, Status.DIVERGED)
"""Statuses of a segment that is run again, to the end of the run, with the equations as stated.

A branch may have no value beyond its surface, such as (-x)**1.5: no step with the old side reaches the surface.
"""


@dataclass(frozen=True, eq=False)
class SideModel:
    """A model whose parameters end with the sides `symbols` of its switching surfaces.

    `leaving` has the event at which the motion leaves each side, by (surface, side). `derivatives` are the surfaces and
    their rates up to order `HIGHEST_RATE`, each divided by the factorial of its order.
    """

    model: Model
    switched: Switched
    symbols: tuple[sympy.Symbol, ...]
    leaving: Mapping[tuple[int, int], Event]
    derivatives: tuple[Node, ...]

    def settled(self, problem: Problem, before: FloatArray, met: Iterable[int], scale: float) -> FloatArray | None:
        """Return the sides with which a motion leaves the surfaces `met` at its start, None if values contradict them.

        `before` has the sides until then, and `scale` is a time in which the motion changes. Raises Sliding if the
        motion stays on a surface.
        """
        kernel, powers = self.model.function("surfaces", self.derivatives), scale ** np.arange(HIGHEST_RATE + 1)

        def series(sides: FloatArray) -> FloatArray:
            values = kernel(problem.t0, problem.y0, np.concatenate([problem.parameter_array, sides]))
            return np.asarray(values.reshape(HIGHEST_RATE + 1, -1) * powers[:, None])

        with np.errstate(all="ignore"):
            g = series(before)
            touched = {*met, *np.flatnonzero((np.sign(g[0]) * before <= 0) & ~clear(g)).tolist()}
            try:
                sides = settled_sides(series, before, {i: _tried(before[i]) for i in sorted(touched)})
            except Sliding as stays:
                if _leads_back(series, before, stays.surface):
                    raise
                return None
            g = series(sides)
        others = np.delete(np.arange(len(sides)), sorted(touched))
        agree = np.isfinite(g).all() and (np.sign(g[0, others]) == sides[others]).all()
        return sides if agree else None

    def segment(self, problem: Problem, sides: FloatArray) -> tuple[Problem, list[int]]:
        """Return a problem with sides that ends where the motion leaves one of them, and the surfaces of these events.

        The events of the problem come first.
        """
        watched = np.flatnonzero(sides).tolist()
        crossings = [self.leaving[i, int(sides[i])] for i in watched]
        values = {**problem.parameters, **dict(zip(self.symbols, sides.tolist(), strict=True))}
        events = (*problem.events, *crossings)
        return replace(problem, model=self.model, parameters=values, events=events), watched

    def stated(self, problem: Problem) -> FloatArray:
        """Return the side of each surface at the start of a problem, 0 on the surface."""
        kernel = problem.model.function("stated_surfaces", self.switched.stated)
        with np.errstate(all="ignore"):
            return np.asarray(np.sign(np.nan_to_num(kernel(problem.t0, problem.y0, problem.parameter_array), nan=1.0)))


def _leads_back(series: Callable[[FloatArray], FloatArray], before: FloatArray, surface: int) -> bool:
    """Return True if the rates of a surface on its two sides lead to it; higher derivatives may be infinite there."""
    both = np.stack([before, before])
    both[:, surface] = 1.0, -1.0
    return all(float(side[surface] * series(side)[1, surface]) < 0 for side in both)


def _tried(side: float) -> tuple[int, ...]:
    """Return the sides to try for a surface that was on a `side`."""
    return (-int(side), int(side), 0) if side else (0, 1, -1)


_MODELS: WeakKeyDictionary[Model, SideModel | None] = WeakKeyDictionary()


def side_model(model: Model) -> SideModel | None:
    """Return the model with sides, or None for a model without switching surfaces of coordinates or velocities.

    Constraints with switches, and surfaces of accelerations or multipliers, are left to other methods.
    """
    if model not in _MODELS:
        _MODELS[model] = _with_sides(model)
    return _MODELS[model]


def _with_sides(model: Model) -> SideModel | None:
    equations, statement = model.equations, model.statement
    fields = {name: getattr(equations, name) for name in ("rate", "momenta", "forces", "bias", "accelerations")}
    fields |= {name: getattr(equations, name) for name in ("multipliers", "impulses")}
    fields |= {"scalars": (equations.lagrangian, equations.energy)}
    fields |= {f"mass {i}": row for i, row in enumerate(equations.mass)}
    fields |= {f"matrix {i}": row for i, row in enumerate(equations.matrix)}
    fields |= {f"motion {name}": getattr(equations.motion, name) for name in ("momenta", "forces", "bias")}
    outputs = [node for row in fields.values() for node in row]
    held = (*equations.stated.velocities, *(g for g in equations.stated.positions if g is not None))
    if not any(node.kind is Kind.CALL and node.data in SWITCHES for node in reachable(outputs)) or statement.inputs:
        return None
    switched = switch(equations.graph, (), outputs, above=Binding.TIME)
    late = any(g.binding > Binding.VELOCITY for g in switched.expressions)
    if not switched.sides or late or switch(equations.graph, held).sides:
        return None
    nodes = iter(switched.outputs)
    new = {name: tuple(next(nodes) for _ in row) for name, row in fields.items()}
    symbols = tuple(sympy.Dummy(f"side_{i}", real=True) for i in range(len(switched.sides)))
    smooth = _restated(equations, new, symbols, switched)
    parameters = (*statement.parameters, *symbols)
    defaults = {**statement.defaults, **dict.fromkeys(symbols, 1.0)}
    other = model.restated(replace(statement, parameters=parameters, defaults=defaults), smooth)
    derivatives, order = [switched.surfaces], 1
    while order <= HIGHEST_RATE:
        derivatives.append(tuple(rate / order for rate in rates(smooth, derivatives[-1])))
        order += 1
    expressions = list(map(smooth.express, switched.surfaces))
    leaving = {(i, side): Event(g, -side, 1) for i, g in enumerate(expressions) for side in (1, -1)}
    return SideModel(other, switched, symbols, leaving, tuple(node for row in derivatives for node in row))


def _restated(
    equations: Equations, new: Mapping[str, tuple[Node, ...]], symbols: tuple[sympy.Symbol, ...], switched: Switched
) -> Equations:
    """Return equations with other nodes, by name, whose parameters end with the sides."""
    lagrangian, energy = new["scalars"]
    names = ("rate", "momenta", "forces", "bias", "accelerations", "multipliers", "impulses")
    rows: dict[str, Any] = {name: new[name] for name in names}
    return replace(
        equations,
        **rows,
        lagrangian=lagrangian,
        energy=energy,
        mass=tuple(new[f"mass {i}"] for i in range(len(equations.mass))),
        matrix=tuple(new[f"matrix {i}"] for i in range(len(equations.matrix))),
        motion=MotionForm(*(new[f"motion {name}"] for name in ("momenta", "forces", "bias"))),
        parameters=(*equations.parameters, *switched.sides),
        leaves={**equations.leaves, **dict(zip(symbols, switched.sides, strict=True))},
    )


def run_over_switches(run: Callable[[Problem], Trajectory], problem: Problem) -> Trajectory:
    """Return the run of a problem by a method without series, in segments that end on switching surfaces of the state.

    `run` runs a problem whose equations are smooth. Each segment takes the events of the problem, too.
    """
    found = side_model(problem.model)
    if found is None:
        return run(problem)
    rest = replace(problem, whole=problem)
    count, counter, parts = len(problem.events), ChangeCounter(), list[Trajectory]()
    before, met, length = found.stated(problem), list[int](), FIRST_SCALE * (problem.t1 - problem.t0)
    while True:
        ended, sides, part = EventResult(), None, None
        try:
            sides = found.settled(rest, before, met, length)
        except Sliding as stays:
            ended = sliding(_name(found, problem, stays.surface), rest.t0)
        except SingularMassMatrix:
            ended = EventResult(Status.SINGULAR)
        if met and ended.status is None and counter.accumulates(rest.t0, met):
            ended = accumulating(_name(found, problem, met[0]))
        if ended.status is not None and parts:
            told = message(ended.status, problem, rest.t0, rest.y0, parts[-1].method, cause=ended.detail)
            parts[-1] = replace(parts[-1], status=ended.status, message=told)
            break
        if sides is not None:
            segment, watched = found.segment(rest, sides)
            part, before = run(segment), sides
        if part is None or part.status in FAILED:
            parts.append(run(rest))
            break
        end, zeros = part.span[1], zip(watched, part.t_events[count:], strict=True)
        met = [i for i, times in zeros if len(times) and times[-1] == end]
        parts.append(replace(part, t_events=part.t_events[:count], y_events=part.y_events[:count]))
        if not met or part.status not in (Status.EVENT, Status.SUCCESS):
            break
        y, last = last_state(part), status_at_end(problem, parts)
        if last is not None:
            if part.status is not last:
                parts.append(point_of(problem, parts[-1], y, last))
            break
        length = float(part.t[-1] - part.t[-2] if len(part.t) > 1 else end - part.span[0])
        rest = rest_of(problem, parts, end, y)
    return joined(problem, parts) if len(parts) > 1 else parts[0]


def _name(found: SideModel, problem: Problem, surface: int) -> str:
    """Return a surface in the user's symbols."""
    return problem.model.statement.quote(problem.model.equations.express(found.switched.expressions[surface]))
