"""Members side by side in machine code: their compiled steps, and the lanes that take them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lagrange.equations.expressions import node_of
from lagrange.graph.node import Node
from lagrange.machine.backend import MemberRuns
from lagrange.machine.event_memory import EventMemory, Reaction
from lagrange.machine.model import Model
from lagrange.members.chunk import STATUSES, SUCCESS, Ends, Starts, Stopped
from lagrange.members.keep import DRIFT, OUTPUTS, STATE, STATUS, TIME, Reduction, event_states, event_times
from lagrange.members.singly import Energies, RunEngine
from lagrange.procedure.builder import Builder
from lagrange.procedure.dense.block import StepPolynomial
from lagrange.procedure.dense.hermite import hermite_polynomial
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.interpreter import run as interpret
from lagrange.procedure.kernel.kernels import kernel, prepare
from lagrange.procedure.kernel.prepared import Prepared
from lagrange.procedure.members.along import Sampled, table_of_points
from lagrange.procedure.members.occurrences import Events
from lagrange.procedure.members.paths import DenseOutput
from lagrange.procedure.members.queue import COUNTED, Members, Numbers, Observed
from lagrange.procedure.members.step_review import StepEvents
from lagrange.procedure.members.steps import StepMembers
from lagrange.procedure.members.taylor import TaylorMembers
from lagrange.procedure.outcome import Outcome
from lagrange.procedure.prune import Pruner
from lagrange.procedure.series.by_order import ByOrderJet
from lagrange.procedure.series.cost import single_operations
from lagrange.procedure.series.integrator import LANES as PACKED
from lagrange.procedure.series.integrator import TaylorProcedures
from lagrange.procedure.series.packing import pack
from lagrange.procedure.series.written_out import WrittenJet
from lagrange.procedure.step.constants import LEAST_FLOOR, RELATIVE_PERTURBATION, perturbation_factors
from lagrange.procedure.taylor.memory import SIZES
from lagrange.program.actions import LAWS
from lagrange.trajectory.endings import slope_ahead
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.events.actions import impacts as impacts_of
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.taylor import TaylorPlan
from lagrange.trajectory.plan import Plan, StepPlan
from lagrange.trajectory.trajectory import FloatArray, Status

MOST_WRITTEN_OUT = 3500
"""Most operations of a series that is written out, since longer code takes long to compile.

A triple pendulum has 2,900 and takes 0.97 of the time that a loop over orders takes; a chain of four links has 4,000
and takes 1.03, one of ten 10,600 and takes 1.17. Twice as long to compile are all of them.
"""

ABOUT = "Write the parameters, and behind them what depends on them alone."


@dataclass(frozen=True)
class Watched:
    """What members watch: nodes, of which the first are the `events` of the user, and what they do."""

    nodes: tuple[Node, ...]
    reactions: tuple[Reaction, ...]
    events: int

    @classmethod
    def of(cls, impacts: Sequence[Impact]) -> Watched | None:
        """Return what a run with some impacts watches, None where there are none."""
        if not impacts:
            return None
        reactions = [Reaction(one.direction, one.terminal, root=one.root, smooth=one.smooth) for one in impacts]
        nodes = tuple(one.node for one in impacts)
        return cls(nodes, tuple(reactions), sum(not one.root for one in impacts))

    def arrays(self, dimension: int) -> dict[str, Any]:
        """Return the arrays that the loop over steps only reads."""
        memory = EventMemory(dimension, 0, self.reactions)
        return {"settings": memory.settings, "tilts": memory.tilts}

    def arrays_of_steps(self, dimension: int) -> dict[str, Any]:
        """Return the arrays that the review of steps only reads."""
        direction, terminal = np.array([(one.direction, one.terminal) for one in self.reactions], dtype=np.int64).T
        factors = 1 + RELATIVE_PERTURBATION * perturbation_factors(dimension + 1)
        whole = {"direction": np.ascontiguousarray(direction), "terminal": np.ascontiguousarray(terminal)}
        return {"factors": factors, **whole}


@dataclass(frozen=True)
class Wanted:
    """What machine code does beside steps: expressions along them, their paths, and parameters of each member's own."""

    reductions: tuple[Reduction, ...]
    path: StepPolynomial | None
    varying: bool
    watched: Watched | None = None


@dataclass(frozen=True, eq=False)
class Compiled:
    """Machine code for members, which observes so many numbers of a state, the energy and the momenta.

    `prepare` makes the `size` numbers that all members have, unless each has its own. `read` has arrays that are only
    read, by the names of arguments; so many `events` are watched.
    """

    code: MemberRuns
    prepare: Procedure | None
    size: int
    observed: int
    read: Mapping[str, Any]
    events: int


def compiled_members(model: Model, plan: Plan, wanted: Wanted) -> Compiled:
    """Compile the members of a model for a plan."""
    laws = {name: model.law(name).program for name in ("rhs", "energy", "momenta")}
    step = plan.step if isinstance(plan, StepPlan) else None
    if step is not None:
        laws["step"] = model.law(LAWS[step.law].quantity).program
    nodes = tuple(node_of(one.expression, model.statement, model.equations) for one in wanted.reductions)
    different = tuple(dict.fromkeys(nodes))
    if nodes:
        laws["expressions"] = model.function("expressions", different).program
    if wanted.watched is not None:
        along = plan.series.program.values if isinstance(plan, TaylorPlan) else None
        laws["watched"] = along or model.function("events", wanted.watched.nodes).program
    prepared = Prepared.of([*laws.values()])
    kernels = {name: kernel(program, prepared, name, f"The quantity {name}.") for name, program in laws.items()}
    preparing, size = prepare(prepared, ABOUT), prepared.size
    observed = _observed(kernels, model.dimension)
    sampled = None
    if nodes:
        reductions = tuple((one.how, different.index(node)) for one, node in zip(wanted.reductions, nodes, strict=True))
        entries = dict.fromkeys(one.place for one in laws["expressions"].instructions if one.op == "state")
        sampled = Sampled(kernels["expressions"], len(different), tuple(entries), reductions)
    read: dict[str, Any] = {"points": table_of_points()}
    parameters = len(model.statement.parameters)
    members: Members
    if isinstance(plan, TaylorPlan):
        series = TaylorProcedures(plan.series.program, prepared.size, watches=wanted.watched is not None)
        preparing, size = series.prepare(preparing), prepared.size + series.numbers.size
        jet = _jet(series, plan.order)
        numbers = Numbers(size, parameters, preparing if wanted.varying else None)
        events = None if wanted.watched is None else _events(plan, wanted.watched, kernels["watched"])
        members = TaylorMembers(jet.layout, plan.order, jet.build(), numbers, observed, sampled, events)
        if wanted.watched is not None:
            sizes = np.array([getattr(jet.layout, name) for name in SIZES.places], dtype=np.int64)
            read |= {"sizes": sizes, **wanted.watched.arrays(2 * model.dimension)}
    else:
        assert step is not None
        numbers = Numbers(size, parameters, preparing if wanted.varying else None)
        dense = None if wanted.path is None else DenseOutput(wanted.path, kernels["rhs"])
        watch = None
        if wanted.path is not None:
            read["table"] = wanted.path.table
        if wanted.path is not None and wanted.watched is not None:
            screened = step.control is not None and wanted.path.degree > hermite_polynomial(3).degree
            watch = StepEvents(kernels["watched"], wanted.watched.events, screened)
            read |= wanted.watched.arrays_of_steps(2 * model.dimension)
        members = StepMembers(step, 2 * model.dimension, kernels["step"], numbers, observed, dense, sampled, watch)
    made = None if wanted.varying else Pruner().pruned(preparing)
    code = model.machine.members(members.build())
    assert code is not None, f"{model.target} runs no members side by side"
    return Compiled(code, made, size, observed.size, read, 0 if wanted.watched is None else wanted.watched.events)


def _events(plan: TaylorPlan, watched: Watched, values: Procedure) -> Events:
    """Return what members watch."""
    program = plan.series.program
    changing = any(one.terminal for one in watched.reactions)
    flags = {"hides_growth": program.hides_growth, "steep": program.watched_degree > plan.order}
    return Events(values, len(watched.reactions), watched.events, changing=changing, **flags)


def _jet(series: TaylorProcedures, order: int) -> WrittenJet | ByOrderJet:
    """Return what builds the series: written out, or in a loop over orders where there are many operations."""
    if single_operations(series.packing, order) > MOST_WRITTEN_OUT:
        return ByOrderJet(pack(series.program, 1), series.numbers)
    return WrittenJet(series.packing, series.numbers, order)


def _observed(kernels: Mapping[str, Procedure], dimension: int) -> Observed:
    """Return the energy and the momenta of a state."""
    p = Builder("observed", "The energy and the momenta.")
    t, y = p.given("t", REAL), p.array("y", size=2 * dimension, read=True)
    held, out = p.array("p", read=True), p.array("out", size=1 + dimension)
    singular = p.call(kernels["energy"], t, y, held, out)
    p.leave(singular | p.call(kernels["momenta"], t, y, held, out.at(1)))
    return Observed(p.finish(FLAG), 1 + dimension)


_COMPILED: WeakKeyDictionary[Model, dict[Any, Compiled]] = WeakKeyDictionary()

MOST_OPERATIONS = 30_000
"""Series with more operations are computed member by member: the coefficients of eight do not stay in the cache.

Five bodies in space have 10,000 to 16,000 operations and take 0.6 of the time that runs alone take, seven have 21,000
to 33,000 and take 0.8 to 0.95, nine have 40,000 to 56,000 and take 1.1.
"""

UNDECIDED = 255
"""The code of an outcome that a run alone has to explain."""

_STATUSES = {
    Outcome.DONE: Status.SUCCESS,
    Outcome.PAUSED: Status.MAX_STEPS,
    Outcome.NON_FINITE: Status.NON_FINITE,
    Outcome.SINGULAR: Status.SINGULAR,
    Outcome.STEP_TOO_SMALL: Status.STEP_TOO_SMALL,
}
STUCK, LOST = STATUSES.index(Status.STEP_TOO_SMALL), STATUSES.index(Status.NON_FINITE)
"""Codes of members whose steps became too small, and of those that left the domain of their equations."""

EVENT, UNFINISHED = STATUSES.index(Status.EVENT), STATUSES.index(Status.MAX_STEPS)
"""Codes of members that an event ended, and of those that took as many steps as they may."""

_OUTCOMES = [STATUSES.index(_STATUSES[one]) if one in _STATUSES else UNDECIDED for one in Outcome]
_CODES = np.array([*_OUTCOMES, EVENT], dtype=np.uint8)
"""The code of the status of each outcome, and behind them that of `ENDED_BY_EVENT`."""


@dataclass(frozen=True, eq=False)
class LaneEngine:
    """Runs members by machine code; `alone` runs those that need more than that."""

    compiled: Compiled
    plan: Plan
    alone: RunEngine

    @property
    def form(self) -> str:
        """How members are run."""
        return f"{self.side_by_side} members side by side"

    @property
    def side_by_side(self) -> int:
        """The lanes of a vector."""
        return self.compiled.code.lanes

    def run(self, starts: Starts, stopped: Stopped) -> Ends:
        """Run members to their ends, all of them: machine code is not stopped, and chunks are short."""
        m, n = starts.states.shape
        alone, observed = self.alone, self.compiled.observed
        count = 0 if alone.times is None else len(alone.times)
        first, last = np.zeros((m, observed)), np.zeros((m, observed))
        outputs = np.full((m, count, n), np.nan)
        states, times, outcomes = np.zeros((m, n)), np.zeros(m), np.zeros(m, dtype=np.int64)
        counts = {name: np.zeros(m, dtype=np.int64) for name in COUNTED}
        given: dict[str, Any] = {"outputs": outputs, "ends": states, "times": times, "outcomes": outcomes, **counts}
        given |= {"first": first, "last": last, "starts": np.ascontiguousarray(starts.states)}
        given |= {"numbers": self.numbers(starts), "wanted": count}
        reduced = np.zeros((m, len(alone.keep.reductions)))
        given |= {"reduced": reduced, "points": np.zeros(1), "table": np.zeros(1), **self.compiled.read}
        events, most = self.compiled.events, max(alone.keep.events, 1)
        event_t, event_y = np.full((m, events, most), np.nan), np.full((m, events, most, n), np.nan)
        given |= {"most": alone.keep.events, "occurrence_times": event_t, "occurrence_states": event_y}
        given["output_times"] = np.append([] if alone.times is None else alone.times, np.nan)
        self.compiled.code({**self.settings(m), **given})
        codes = _CODES[outcomes]
        if alone.times is not None:
            self.complete(outputs, alone.times, states, times)
        found = {STATE: states, TIME: times, STATUS: codes, OUTPUTS: outputs, **counts}
        found |= {one.name: reduced[:, k] for k, one in enumerate(alone.keep.reductions)}
        found |= {event_times(k): event_t[:, k] for k in range(events)}
        found |= {event_states(k): event_y[:, k] for k in range(events)}
        energies = Energies(starts.states, states, first, last)
        if alone.keep.drift:
            found[DRIFT] = energies.drift
        doubtful = (codes == UNDECIDED) | self.unexplained(starts, states, times, codes)
        if alone.model.conservative:
            doubtful |= ((codes == SUCCESS) | (codes == EVENT)) & energies.moved
        ends = Ends({column.name: found[column.name] for column in alone.columns})
        return alone.again(starts, ends, np.flatnonzero(doubtful))

    def complete(self, outputs: FloatArray, wanted: FloatArray, states: FloatArray, times: FloatArray) -> None:
        """Write the last states at an output time where a run ended, and nothing behind the last accepted step."""
        t0, t1 = self.alone.span
        for place in np.flatnonzero((wanted == times[:, None]).any(axis=0)):
            ended = times == wanted[place]
            outputs[ended, place] = states[ended]
        behind = (wanted - times[:, None]) * (1.0 if t1 >= t0 else -1.0) > 0
        outputs[behind] = np.nan

    def unexplained(
        self, starts: Starts, states: FloatArray, times: FloatArray, codes: NDArray[np.uint8]
    ) -> NDArray[np.bool_]:
        """Return which members ended for a reason that a run alone has to find, and find the others.

        These did not begin, or their inertia may have been lost. Where steps shrank ahead of a state without slopes, a
        domain ends there.
        """
        model, (t0, t1) = self.alone.model, self.alone.span
        stuck = codes == STUCK
        for i in np.flatnonzero(stuck):
            parameters = starts.parameters[i if len(starts.parameters) > 1 else 0]
            if not np.isfinite(slope_ahead(model, times[i], states[i], parameters, t1 - t0)).all():
                codes[i] = LOST
        if self.compiled.events:
            # A run that watches may go on where no series begins.
            return np.asarray((codes != SUCCESS) & (codes != EVENT) & (codes != UNFINISHED))
        lost = stuck & (codes == STUCK) & (not model.equations.structure.constant_mass)
        return np.asarray(lost | ((times == t0) & (codes != SUCCESS)))

    def settings(self, count: int) -> dict[str, Any]:
        """Return the numbers that all members have; see `Tolerances.begin`."""
        own, (t0, t1) = self.plan.tolerances, self.alone.span
        return {
            "count": count,
            "budget": self.alone.options.step_limit,
            "t0": t0,
            "t1": t1,
            "rtol": own.margin * own.rtol,
            "floor": max(own.margin * own.atol, LEAST_FLOOR),
            "share": own.margin * own.share,
            "step": own.step if t1 >= t0 else -own.step,
            "longest": own.longest,
        }

    def numbers(self, starts: Starts) -> FloatArray:
        """Return the parameters of all members, or what is prepared of those that all have."""
        if self.compiled.prepare is None:
            return np.ascontiguousarray(starts.parameters)
        made = np.zeros(self.compiled.size + 1)
        interpret(self.compiled.prepare, starts.parameters[0].tolist(), made)
        return made


def lane_engine(alone: RunEngine, plan: Plan, problem: Problem, *, varying: bool) -> LaneEngine | None:
    """Return the engine that runs members side by side, None where there is none for the model and the method.

    With `varying` each member has its own parameters. What is compiled is kept for the next ensemble of the model.
    """
    if not _runs_in_lanes(alone, plan, problem):
        return None
    watched = Watched.of(_impacts(plan, problem))
    wanted = Wanted(alone.keep.reductions, _path_kind(plan, problem, alone), varying, watched)
    kept = _COMPILED.setdefault(alone.model, {})
    key = _kind(plan), wanted
    if key not in kept:
        kept[key] = compiled_members(alone.model, plan, wanted)
    return LaneEngine(kept[key], plan, alone)


def _impacts(plan: Plan, problem: Problem) -> tuple[Impact, ...]:
    """Return what runs watch: the events, and of series what else ends them."""
    return plan.impacts if isinstance(plan, TaylorPlan) else impacts_of(problem.model, problem.events, np.empty(0))


def _path_kind(plan: Plan, problem: Problem, alone: RunEngine) -> StepPolynomial | None:
    """Return the dense output of a step program, where something is wanted inside of its steps."""
    outside = alone.times is None and not alone.keep.reductions and not problem.events
    if not isinstance(plan, StepPlan) or outside:
        return None
    return plan.path_of(problem, np.array([problem.t0]), problem.y0[None]).kind


def _kind(plan: Plan) -> Any:
    """Return what machine code is made for: an order, or a step."""
    return plan.order if isinstance(plan, TaylorPlan) else plan.step if isinstance(plan, StepPlan) else None


def _runs_in_lanes(alone: RunEngine, plan: Plan, problem: Problem) -> bool:
    """Return whether there is machine code for all that a run needs."""
    model = alone.model
    if any(event.settings for event in problem.events):
        return False
    if model.target != "llvm" or len(model.equations.constraints) or model.statement.given:
        return False
    if isinstance(plan, TaylorPlan):
        small = single_operations(pack(plan.series.program, PACKED), plan.order) <= MOST_OPERATIONS
        resets = any(one.reset for one in plan.impacts)
        return small and not resets and not plan.series.program.sides and plan.series.program.projection is None
    resets = any(event.reset for event in problem.events)
    return isinstance(plan, StepPlan) and not resets and not plan.step.solves and plan.step.starter is None
