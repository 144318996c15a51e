"""Members in vector lanes, one member in each: their compiled code, and the object that runs it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lagrange.algorithm.constants import (
    LEAST_FLOOR,
    RELATIVE_PERTURBATION,
    WIDEST_VECTOR,
    Outcome,
    perturbation_factors,
)
from lagrange.algorithm.dense.block import StepPolynomial
from lagrange.algorithm.dense.polynomials import hermite_polynomial
from lagrange.algorithm.kernel.body import PreparedLayout
from lagrange.algorithm.kernel.kernels import kernel, prepare
from lagrange.algorithm.members.along import MemberDenseOutput, Sampled, table_of_points
from lagrange.algorithm.members.queue import COUNTED, MemberMethod, Observed, SystemNumbers, energy_and_momenta
from lagrange.algorithm.members.steps import StepEvents, StepMembers
from lagrange.algorithm.members.taylor import TaylorEvents, TaylorMembers
from lagrange.algorithm.series.integrator import TaylorProcedures
from lagrange.algorithm.series.jets import ByOrderJet, WrittenJet
from lagrange.algorithm.series.packing import pack, single_operations
from lagrange.algorithm.taylor.memory import SIZES
from lagrange.equations.euler_lagrange import node_of
from lagrange.graph.node import Node
from lagrange.machine.backend import MemberRuns
from lagrange.machine.drivers import EventMemory
from lagrange.machine.model import Model
from lagrange.machine.state import Reaction
from lagrange.members.chunk import STATUSES, SUCCESS, Ends, Starts, Stopped
from lagrange.members.kept_results import DRIFT, OUTPUTS, STATE, STATUS, TIME, Reduction, event_states, event_times
from lagrange.members.singly import Energies, RunEngine
from lagrange.procedure.form import Procedure
from lagrange.procedure.interpreter import run as interpret
from lagrange.procedure.rewrite import Pruner
from lagrange.program.step import LAWS
from lagrange.trajectory.endings import DOMAIN_PROBE, slope_ahead
from lagrange.trajectory.events.actions import ModelEvent, model_events
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.taylor import TaylorPlan
from lagrange.trajectory.plan import Plan, StepPlan
from lagrange.trajectory.trajectory import FloatArray, Status

MOST_WRITTEN_OUT = 3500
"""Largest number of operations of a series that is printed without a loop over orders. Time without the loop relative
to that with it: 0.97 for a triple pendulum (2,900 operations), 1.03 for a chain of four links (4,000), 1.17 for a chain
of ten (10,600). All of them take twice as long to compile."""

ABOUT = "Write the parameters, and after them what depends on them alone."


@dataclass(frozen=True)
class MemberEvents:
    """The event functions of members: their `nodes`, and for each the reaction (direction, terminal count, reset).

    The first `events` nodes are events of the user. The others are square roots in the equations of motion. A zero of
    such a root ends the run of the member, since no Taylor series is valid after it.
    """

    nodes: tuple[Node, ...]
    reactions: tuple[Reaction, ...]
    events: int

    @classmethod
    def of(cls, events: Sequence[ModelEvent]) -> MemberEvents | None:
        """Return the event functions of `events` with their reactions, or None if there are none."""
        if not events:
            return None
        reactions = [
            Reaction(event.direction, event.terminal, root=event.root, smooth=event.smooth) for event in events
        ]
        nodes = tuple(event.node for event in events)
        return cls(nodes, tuple(reactions), sum(not event.root for event in events))

    def arrays_of_steps(self, dimension: int) -> dict[str, Any]:
        """Return the constant arrays that the search for events on steps reads, by argument name.

        `dimension` is the length 2n of a state.
        """
        direction, terminal = np.array(
            [(reaction.direction, reaction.terminal) for reaction in self.reactions], dtype=np.int64
        ).T
        factors = 1 + RELATIVE_PERTURBATION * perturbation_factors(dimension + 1)
        whole = {"direction": np.ascontiguousarray(direction), "terminal": np.ascontiguousarray(terminal)}
        return {"factors": factors, **whole}


@dataclass(frozen=True)
class MemberTasks:
    """Tasks of the machine code of members besides steps: reductions and events.

    `reductions` are expressions that are reduced to one number along the steps. `path` is the dense output that
    reductions and events use, or None. `varying` is True if each member has its own parameters. `watched` has the
    event functions, or is None.
    """

    reductions: tuple[Reduction, ...]
    path: StepPolynomial | None
    varying: bool
    watched: MemberEvents | None = None


@dataclass(frozen=True, eq=False)
class Compiled:
    """The machine code that runs members of a model in vector lanes, with the constant arrays that it reads.

    `prepare` computes an array of `size` values: the parameters, then all values that depend on them alone. It is
    None if each member has its own parameters, since the code then computes these values. `observed` is the number of
    values that are computed for a state: the energy and the momenta. `read` has the constant arrays by argument name.
    `events` is the number of the user's events.
    """

    code: MemberRuns
    prepare: Procedure | None
    size: int
    observed: int
    read: Mapping[str, Any]
    events: int


def compiled_members(model: Model, plan: Plan, tasks: MemberTasks) -> Compiled:
    """Return the compiled code that runs members of a model by the method of a `plan`, with additional `tasks`."""
    laws = {name: model.law(name).program for name in ("rhs", "energy", "momenta")}
    step = plan.step if isinstance(plan, StepPlan) else None
    if step is not None:
        laws["step"] = model.law(LAWS[step.law].quantity).program
    nodes = tuple(node_of(reduction.expression, model.statement, model.equations) for reduction in tasks.reductions)
    different = tuple(dict.fromkeys(nodes))
    if nodes:
        laws["expressions"] = model.function("expressions", different).program
    if tasks.watched is not None:
        along = plan.series.program.values if isinstance(plan, TaylorPlan) else None
        laws["watched"] = along or model.function("events", tasks.watched.nodes).program
    prepared = PreparedLayout.of([*laws.values()])
    kernels = {name: kernel(program, prepared, name, f"The quantity {name}.") for name, program in laws.items()}
    preparing, size = prepare(prepared, ABOUT), prepared.size
    observing = energy_and_momenta.form(energy=kernels["energy"], momenta=kernels["momenta"])
    observed = Observed(observing, 1 + len(model.layout.rates))
    sampled = None
    if nodes:
        pairs = zip(tasks.reductions, nodes, strict=True)
        reductions = tuple((reduction.how, different.index(node)) for reduction, node in pairs)
        instructions = laws["expressions"].instructions
        entries = dict.fromkeys(instruction.place for instruction in instructions if instruction.op == "state")
        sampled = Sampled(kernels["expressions"], len(different), tuple(entries), reductions)
    read: dict[str, Any] = {"points": table_of_points()}
    parameters = len(model.statement.parameters)
    members: MemberMethod
    if isinstance(plan, TaylorPlan):
        series = TaylorProcedures(plan.series.program, prepared.size, watches=tasks.watched is not None)
        preparing, size = series.prepare(preparing), prepared.size + series.numbers.size
        jet: WrittenJet | ByOrderJet
        if single_operations(series.packing, plan.order) > MOST_WRITTEN_OUT:
            jet = ByOrderJet(series.single, series.numbers)
        else:
            jet = WrittenJet(series.single, series.numbers, plan.order)
        numbers = SystemNumbers(size, parameters, preparing if tasks.varying else None)
        events = None if tasks.watched is None else _events(plan, tasks.watched, kernels["watched"])
        members = TaylorMembers(jet.layout, plan.order, jet.build(), numbers, observed, sampled, events)
        if tasks.watched is not None:
            sizes = np.array([getattr(jet.layout, name) for name in SIZES.places], dtype=np.int64)
            memory = EventMemory(model.layout.size, 0, tasks.watched.reactions)
            read |= {"sizes": sizes, "settings": memory.settings, "tilts": memory.tilts}
    else:
        assert step is not None
        numbers = SystemNumbers(size, parameters, preparing if tasks.varying else None)
        dense = None if tasks.path is None else MemberDenseOutput(tasks.path, kernels["rhs"])
        watch = None
        if tasks.path is not None:
            read["table"] = tasks.path.table
        if tasks.path is not None and tasks.watched is not None:
            screened = step.control is not None and tasks.path.degree > hermite_polynomial(3).degree
            watch = StepEvents(kernels["watched"], tasks.watched.events, screened)
            read |= tasks.watched.arrays_of_steps(model.layout.size)
        members = StepMembers(step, model.layout.size, kernels["step"], numbers, observed, dense, sampled, watch)
    preparation = None if tasks.varying else Pruner().pruned(preparing)
    code = model.machine.members(members.build())
    assert code is not None, f"{model.target} runs no members side by side"
    event_count = 0 if tasks.watched is None else tasks.watched.events
    return Compiled(code, preparation, size, observed.size, read, event_count)


def _events(plan: TaylorPlan, watched: MemberEvents, values: Procedure) -> TaylorEvents:
    """Return the data from which the code of members for the event functions `watched` is generated.

    `values` is the procedure that evaluates the event functions.
    """
    program = plan.series.program
    changing = any(reaction.terminal for reaction in watched.reactions)
    flags = {"hides_growth": program.hides_growth, "steep": program.watched_degree > plan.order}
    return TaylorEvents(values, len(watched.reactions), watched.events, changing=changing, **flags)


_COMPILED: WeakKeyDictionary[Model, dict[Any, Compiled]] = WeakKeyDictionary()

MOST_LANE_OPERATIONS = 30_000
"""Largest number of operations of a series that lanes compute: above it the coefficients of eight members leave the
cache. Time in lanes relative to single runs: 0.6 for five bodies in space (10,000 to 16,000 operations), 0.8 to 0.95
for seven (21,000 to 33,000), 1.1 for nine (40,000 to 56,000)."""

UNDECIDED = 255
"""Code of an outcome after which only a single run can determine the status."""

_STATUSES = {
    Outcome.DONE: Status.SUCCESS,
    Outcome.PAUSED: Status.MAX_STEPS,
    Outcome.NON_FINITE: Status.NON_FINITE,
    Outcome.SINGULAR: Status.SINGULAR,
    Outcome.STEP_TOO_SMALL: Status.STEP_TOO_SMALL,
}
STUCK, LOST = STATUSES.index(Status.STEP_TOO_SMALL), STATUSES.index(Status.NON_FINITE)
"""Status codes of members whose steps became too small, and of members that left the domain of their equations."""

EVENT, UNFINISHED = STATUSES.index(Status.EVENT), STATUSES.index(Status.MAX_STEPS)
"""Status codes of members that an event ended, and of members that reached the step limit."""

_OUTCOMES = [STATUSES.index(_STATUSES[outcome]) if outcome in _STATUSES else UNDECIDED for outcome in Outcome]
_CODES = np.array([*_OUTCOMES, EVENT], dtype=np.uint8)
"""Status code by outcome; the last entry is for `ENDED_BY_EVENT`."""


@dataclass(frozen=True, eq=False)
class LaneEngine:
    """Runs members in vector lanes, several at the same time. `alone` runs members that the lanes cannot finish."""

    compiled: Compiled
    plan: Plan
    alone: RunEngine

    @property
    def form(self) -> str:
        """The way in which members are run, in words."""
        return f"{self.side_by_side} members side by side"

    @property
    def side_by_side(self) -> int:
        """The number of members that run at the same time: the lanes of a vector."""
        return self.compiled.code.lanes

    def run(self, starts: Starts, stopped: Stopped) -> Ends:
        """Run a chunk of members from the initial values `starts`, and return their results.

        `stopped` is not used: machine code does not stop, and chunks are short.
        """
        m, n = starts.states.shape
        alone, observed = self.alone, self.compiled.observed
        count = 0 if alone.times is None else len(alone.times)
        first, last = np.zeros((m, observed)), np.zeros((m, observed))
        outputs = np.full((m, count, n), np.nan)
        states, times, outcomes = np.zeros((m, n)), np.zeros(m), np.zeros(m, dtype=np.int64)
        counts = {name: np.zeros(m, dtype=np.int64) for name in COUNTED}
        arrays: dict[str, Any] = {"outputs": outputs, "ends": states, "times": times, "outcomes": outcomes, **counts}
        arrays |= {"first": first, "last": last, "starts": np.ascontiguousarray(starts.states)}
        arrays |= {"numbers": self.numbers(starts), "output_count": count}
        reduced = np.zeros((m, len(alone.keep.reductions)))
        arrays |= {"reduced": reduced, "points": np.zeros(1), "table": np.zeros(1), **self.compiled.read}
        events, most = self.compiled.events, max(alone.keep.events, 1)
        event_t, event_y = np.full((m, events, most), np.nan), np.full((m, events, most, n), np.nan)
        arrays |= {"most": alone.keep.events, "occurrence_times": event_t, "occurrence_states": event_y}
        arrays["output_times"] = np.append([] if alone.times is None else alone.times, np.nan)
        self.compiled.code({**self.settings(m), **arrays})
        codes = _CODES[outcomes]
        if alone.times is not None:
            self.complete(outputs, alone.times, states, times)
        columns = {STATE: states, TIME: times, STATUS: codes, OUTPUTS: outputs, **counts}
        columns |= {reduction.name: reduced[:, k] for k, reduction in enumerate(alone.keep.reductions)}
        columns |= {event_times(k): event_t[:, k] for k in range(events)}
        columns |= {event_states(k): event_y[:, k] for k in range(events)}
        energies = Energies(starts.states, states, first, last)
        if alone.keep.drift:
            columns[DRIFT] = energies.drift
        doubtful = (codes == UNDECIDED) | self.unexplained(starts, states, times, codes)
        if alone.model.conservative:
            doubtful |= ((codes == SUCCESS) | (codes == EVENT)) & energies.moved
        ends = Ends({column.name: columns[column.name] for column in alone.columns})
        return alone.again(starts, ends, np.flatnonzero(doubtful))

    def complete(self, outputs: FloatArray, output_times: FloatArray, states: FloatArray, times: FloatArray) -> None:
        """Correct the states `outputs` (m, K, 2n) of m members at `output_times` (K,) in place.

        The runs ended at `times` (m,) in `states` (m, 2n). If a run ended exactly at an output time, its last state
        is written there. After the end of a run NaN is written.
        """
        t0, t1 = self.alone.span
        for index in np.flatnonzero((output_times == times[:, None]).any(axis=0)):
            ended = times == output_times[index]
            outputs[ended, index] = states[ended]
        after_end = (output_times - times[:, None]) * (1.0 if t1 >= t0 else -1.0) > 0
        outputs[after_end] = np.nan

    def unexplained(
        self, starts: Starts, states: FloatArray, times: FloatArray, codes: NDArray[np.uint8]
    ) -> NDArray[np.bool_]:
        """Return a mask (m,) of members that ended early for an unknown cause, and have to run again one by one.

        `states` (m, 2n), `times` (m,) and status `codes` (m,) are the ends of the runs. With events, the mask has all
        members that ended early without an event, except those that reached the step limit. Without events, it has
        those that took no step, and those whose mass matrix may have become singular. Codes are changed in place:
        STUCK (steps too small) becomes LOST (not finite) where a small step along the slope leaves the domain of the
        equations.
        """
        model, (t0, t1) = self.alone.model, self.alone.span
        stuck = codes == STUCK
        for i in np.flatnonzero(stuck):
            parameters = starts.parameters[i if len(starts.parameters) > 1 else 0]
            if not np.isfinite(slope_ahead(model, times[i], states[i], parameters, DOMAIN_PROBE * (t1 - t0))).all():
                codes[i] = LOST
        if self.compiled.events:
            # A single run with events may continue where no series begins.
            return np.asarray((codes != SUCCESS) & (codes != EVENT) & (codes != UNFINISHED))
        lost = stuck & (codes == STUCK) & (not model.equations.structure.constant_mass)
        return np.asarray(lost | ((times == t0) & (codes != SUCCESS)))

    def settings(self, count: int) -> dict[str, Any]:
        """Return the scalar arguments of the machine code for `count` members: time span, tolerances and limits."""
        tolerances, (t0, t1) = self.plan.tolerances, self.alone.span
        return {
            "count": count,
            "budget": self.alone.options.step_limit,
            "t0": t0,
            "t1": t1,
            "rtol": tolerances.margin * tolerances.rtol,
            "floor": max(tolerances.margin * tolerances.atol, LEAST_FLOOR),
            "share": tolerances.margin * tolerances.share,
            "step": tolerances.step if t1 >= t0 else -tolerances.step,
            "longest": tolerances.longest,
        }

    def numbers(self, starts: Starts) -> FloatArray:
        """Return the parameters (m, k) of all members.

        If the members share them, return the array that `Compiled.prepare` computes: the parameters, then all values
        that depend on them alone.
        """
        if self.compiled.prepare is None:
            return np.ascontiguousarray(starts.parameters)
        prepared = np.zeros(self.compiled.size + 1)
        interpret(self.compiled.prepare, starts.parameters[0].tolist(), prepared)
        return prepared


def lane_engine(alone: RunEngine, plan: Plan, problem: Problem, *, varying: bool) -> LaneEngine | None:
    """Return the object that runs members in lanes, or None if the model or the method does not allow it.

    `alone` runs members one by one. With `varying` each member has its own parameters. The machine code is cached for
    the next ensemble of the model.
    """
    if not _runs_in_lanes(alone, plan, problem):
        return None
    # A series also watches the square roots in the equations of motion.
    events = plan.events if isinstance(plan, TaylorPlan) else model_events(problem.model, problem.events)
    path = None
    if isinstance(plan, StepPlan) and (alone.times is not None or alone.keep.reductions or problem.events):
        path = plan.path_of(problem, np.array([problem.t0]), problem.y0[None]).kind
    watched = MemberEvents.of(events)
    tasks = MemberTasks(alone.keep.reductions, path, varying, watched)
    cache = _COMPILED.setdefault(alone.model, {})
    key = _kind(plan), tasks
    if key not in cache:
        cache[key] = compiled_members(alone.model, plan, tasks)
    return LaneEngine(cache[key], plan, alone)


def _kind(plan: Plan) -> Any:
    """Return the property of a plan on which its compiled code depends: the series order, or the step program."""
    return plan.order if isinstance(plan, TaylorPlan) else plan.step if isinstance(plan, StepPlan) else None


def _runs_in_lanes(alone: RunEngine, plan: Plan, problem: Problem) -> bool:
    """Return True if lanes support the system, the method and the events of a problem."""
    model = alone.model
    if any(event.settings for event in problem.events):
        return False
    if model.target != "llvm" or len(model.equations.constraints) or model.statement.given or model.statement.contacts:
        return False
    if isinstance(plan, TaylorPlan):
        small = single_operations(pack(plan.series.program, WIDEST_VECTOR), plan.order) <= MOST_LANE_OPERATIONS
        resets = any(event.reset for event in plan.events)
        return small and not resets and not plan.series.program.sides and plan.series.program.projection is None
    resets = any(event.reset for event in problem.events)
    return isinstance(plan, StepPlan) and not resets and not plan.step.solves and plan.step.starter is None
