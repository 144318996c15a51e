"""Run members of an ensemble in vector lanes, one member in each lane: generate, compile and call the code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple
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
from lagrange.algorithm.members.queue import COUNTED, Observed, SystemNumbers, energy_and_momenta
from lagrange.algorithm.members.reductions import MemberDenseOutput, Sampled, lobatto
from lagrange.algorithm.members.steps import StepEvents, StepMembers
from lagrange.algorithm.members.taylor import MemberJet, TaylorEvents, TaylorMembers
from lagrange.algorithm.series.exported_integrator import TaylorProcedures
from lagrange.algorithm.series.jets import WrittenJet
from lagrange.algorithm.series.order_by_cost import single_operations
from lagrange.algorithm.series.packing import pack
from lagrange.algorithm.taylor.memory import SIZES
from lagrange.equations.euler_lagrange import node_of
from lagrange.graph.node import Node
from lagrange.machine.backend import MemberRuns
from lagrange.machine.drivers import EventMemory
from lagrange.machine.model import Model
from lagrange.machine.state import Reaction
from lagrange.members.results import (
    DRIFT,
    OUTPUTS,
    STATE,
    STATUS,
    STATUSES,
    SUCCESS,
    TIME,
    Reduction,
    Results,
    Starts,
    Stopped,
    event_states,
    event_times,
)
from lagrange.members.singly import Energies, RunEngine
from lagrange.procedure.form import Procedure
from lagrange.procedure.interpreter import run as interpret
from lagrange.procedure.rewrite import Pruner
from lagrange.program.program import Program
from lagrange.program.step import LAWS, StepProgram
from lagrange.trajectory.endings import DOMAIN_PROBE, slope_ahead
from lagrange.trajectory.events.model_events import model_events
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.taylor import TaylorPlan
from lagrange.trajectory.plan import Plan, StepPlan
from lagrange.trajectory.trajectory import FloatArray, Status

MOST_WRITTEN_OUT = 3500
"""Largest number of operations of a Taylor series whose code is unrolled over its orders. The unrolled code takes 0.97
times as long as a loop for a triple pendulum (2,900 operations), 1.03 times for a chain of four links (4,000), and 1.17
times for a chain of ten (10,600). It takes twice as long to compile."""

ABOUT = "Write the parameters, then all values that depend only on them."


@dataclass(frozen=True)
class MemberTasks:
    """What the machine code that runs members of an ensemble computes besides steps: reductions and events.

    `reductions` are expressions that are reduced to one number along the steps. `path` is the dense output that
    reductions and events use, or None. `varying` is True if each member has its own parameters. `watched` are the event
    functions, and `reactions` has for each the direction of its crossings, the number of occurrences that ends a run,
    and its reset. The first `events` functions are events of the user. The others are square roots in the equations of
    motion. A zero of such a root ends the run of the member, since no Taylor series is valid after it.
    """

    reductions: tuple[Reduction, ...]
    path: StepPolynomial | None
    varying: bool
    watched: tuple[Node, ...]
    reactions: tuple[Reaction, ...]
    events: int


@dataclass(frozen=True, eq=False)
class Compiled:
    """The machine code that runs members of a model in vector lanes, with the constant arrays that it reads.

    `prepare` computes an array of `size` values: the parameters, then all values that depend only on them. It is None
    if each member has its own parameters, since `code` then computes these values. `observed` is 1 + n: the energy and
    the n momenta, which the code computes at the start and the end of each run. `read` has the constant arrays by
    argument name. `events` is the number of the user's events.
    """

    code: MemberRuns
    prepare: Procedure | None
    size: int
    observed: int
    read: Mapping[str, Any]
    events: int


class _Parts(NamedTuple):
    """The procedures from which the code that runs members is generated.

    `kernels` evaluate the programs that `_programs` returns, by the same names. `numbers` computes the values that
    depend only on parameters, and `observed` the energy and momenta. `sampled` computes the expressions that are
    reduced along the run; it is None if there are none.
    """

    kernels: Mapping[str, Procedure]
    numbers: SystemNumbers
    observed: Observed
    sampled: Sampled | None


def compiled_members(model: Model, plan: Plan, tasks: MemberTasks) -> Compiled:
    """Return the machine code that runs members of an ensemble of `model` by the method of `plan`.

    `tasks` are the reductions and events that the code computes besides steps.
    """
    nodes = tuple(node_of(reduction.expression, model.statement, model.equations) for reduction in tasks.reductions)
    programs = _programs(model, plan, tasks, tuple(dict.fromkeys(nodes)))

    # All programs share the values that depend only on parameters. A Taylor series adds values of its own.
    prepared = PreparedLayout.of([*programs.values()])
    kernels = {name: kernel(program, prepared, name, f"The quantity {name}.") for name, program in programs.items()}
    preparing, size = prepare(prepared, ABOUT), prepared.size
    generator: Callable[[MemberTasks, _Parts, int], tuple[TaylorMembers | StepMembers, dict[str, Any]]]
    if isinstance(plan, TaylorPlan):
        series = TaylorProcedures(plan.series.program, prepared.size, watches=bool(tasks.watched))
        preparing, size = series.prepare(preparing), prepared.size + series.numbers.size
        generator = partial(_taylor_members, plan, series)
    else:
        assert isinstance(plan, StepPlan)
        generator = partial(_step_members, plan.step)
    numbers = SystemNumbers(size, len(model.statement.parameters), preparing if tasks.varying else None)

    observing = energy_and_momenta.form(energy=kernels["energy"], momenta=kernels["momenta"])
    observed = Observed(observing, 1 + len(model.layout.rates))
    sampled = _sampled(tasks.reductions, nodes, programs["expressions"], kernels["expressions"]) if nodes else None
    members, arrays = generator(tasks, _Parts(kernels, numbers, observed, sampled), model.layout.size)

    code = model.machine.members(members.build())
    assert code is not None, f"{model.target} runs no members side by side"
    preparation = None if tasks.varying else Pruner().pruned(preparing)
    return Compiled(
        code, preparation, size, observed.size, {"points": np.concatenate(lobatto()), **arrays}, tasks.events
    )


def _programs(model: Model, plan: Plan, tasks: MemberTasks, expressions: tuple[Node, ...]) -> dict[str, Program]:
    """Return {name: program} for all quantities that the machine code of members evaluates.

    They are "rhs", "energy" and "momenta". If they are needed, there are also "step" (the accelerations or forces that
    the steps of the method evaluate), "watched" (the event functions) and "expressions" (the reduced expressions).
    """
    programs = {name: model.law(name).program for name in ("rhs", "energy", "momenta")}
    if isinstance(plan, StepPlan):
        programs["step"] = model.law(LAWS[plan.step.law].quantity).program
    if expressions:
        programs["expressions"] = model.function("expressions", expressions).program
    if tasks.watched:
        along = plan.series.program.values if isinstance(plan, TaylorPlan) else None
        programs["watched"] = along or model.function("events", tasks.watched).program
    return programs


def _sampled(
    reductions: Sequence[Reduction], nodes: Sequence[Node], program: Program, evaluating: Procedure
) -> Sampled:
    """Return the data by which code evaluates the expressions of all `reductions` at points of a step, each only once.

    `nodes` are the expressions as nodes of the equations' graph, one for each reduction. `program` computes the
    different expressions among them, and `evaluating` is the procedure made from this program.
    """
    different = list(dict.fromkeys(nodes))
    places = tuple((reduction.how, different.index(node)) for reduction, node in zip(reductions, nodes, strict=True))
    entries = dict.fromkeys(instruction.place for instruction in program.instructions if instruction.op == "state")
    return Sampled(evaluating, len(different), tuple(entries), places)


def _taylor_members(
    plan: TaylorPlan, series: TaylorProcedures, tasks: MemberTasks, parts: _Parts, dimension: int
) -> tuple[TaylorMembers, dict[str, Any]]:
    """Return the generator of code that runs members by Taylor series, and {argument: constant array} for this code.

    `plan` has the order, and `series` the procedures of the series. `tasks` are reductions and events, `parts` the
    procedures that the code calls, and `dimension` is the number of entries of the state.
    """
    jet: WrittenJet | MemberJet
    if single_operations(series.packing, plan.order) > MOST_WRITTEN_OUT:
        jet = MemberJet(series.single, series.numbers, plan.order)
    else:
        jet = WrittenJet(series.single, series.numbers, plan.order)
    events, arrays = None, dict[str, Any]()
    if tasks.watched:
        program = plan.series.program
        changing = any(reaction.terminal for reaction in tasks.reactions)
        flags = {"hides_growth": program.hides_growth, "steep": program.watched_degree > plan.order}
        events = TaylorEvents(parts.kernels["watched"], len(tasks.watched), tasks.events, changing=changing, **flags)
        memory = EventMemory(dimension, 0, tasks.reactions)
        sizes = np.array([getattr(jet.layout, name) for name in SIZES.places], dtype=np.int64)
        arrays = {"sizes": sizes, "settings": memory.settings, "tilts": memory.tilts}
    _, numbers, observed, sampled = parts
    return TaylorMembers(jet.layout, plan.order, jet.build(), numbers, observed, sampled, events), arrays


def _step_members(
    step: StepProgram, tasks: MemberTasks, parts: _Parts, dimension: int
) -> tuple[StepMembers, dict[str, Any]]:
    """Return the generator of code that runs members by step programs, and {argument: constant array} for this code.

    `step` is one step of the method. `tasks` are reductions and events, `parts` the procedures that the code calls, and
    `dimension` is the number of entries of the state.
    """
    kernels, numbers, observed, sampled = parts
    dense, watch, arrays = None, None, dict[str, Any]()
    if tasks.path is not None:
        dense = MemberDenseOutput(tasks.path, kernels["rhs"])
        arrays["table"] = tasks.path.table
        if tasks.watched:
            screened = step.control is not None and tasks.path.degree > hermite_polynomial(3).degree
            watch = StepEvents(kernels["watched"], tasks.events, screened)
            for name in ("direction", "terminal"):
                arrays[name] = np.array([getattr(reaction, name) for reaction in tasks.reactions], dtype=np.int64)
            arrays["factors"] = 1 + RELATIVE_PERTURBATION * perturbation_factors(dimension + 1)
    return StepMembers(step, dimension, kernels["step"], numbers, observed, dense, sampled, watch), arrays


_COMPILED: WeakKeyDictionary[Model, dict[Any, Compiled]] = WeakKeyDictionary()

MOST_LANE_OPERATIONS = 30_000
"""Largest number of operations of a Taylor series with which members run in lanes. Above it, the coefficients of eight
members exceed the cache. Time in lanes relative to single runs: 0.6 for five bodies in space (10,000 to 16,000
operations), 0.8 to 0.95 for seven (21,000 to 33,000), 1.1 for nine (40,000 to 56,000)."""

UNDECIDED = 255
"""Temporary status code of a member that has to run again alone, because the code in lanes cannot tell its status."""

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
"""Status codes of members: the entry at index i is for a compiled run that returned the outcome i. The last entry is
for `ENDED_BY_EVENT`, the outcome after those of `Outcome`."""


@dataclass(frozen=True, eq=False)
class LaneEngine:
    """Runs members of an ensemble in vector lanes, several at the same time, by the machine code `compiled`.

    `plan` has the tolerances and limits of the runs. `single` runs members that the code cannot finish.
    """

    compiled: Compiled
    plan: Plan
    single: RunEngine

    @property
    def form(self) -> str:
        """Phrase that describes how members are run, for the printed summary: "8 members side by side"."""
        return f"{self.side_by_side} members side by side"

    @property
    def side_by_side(self) -> int:
        """The number of members that run at the same time: the lanes of a vector."""
        return self.compiled.code.lanes

    def run(self, starts: Starts, stopped: Stopped) -> Results:
        """Run a chunk of members from the initial values `starts`, and return their results.

        The callback `stopped` is not called: machine code runs to the end of a chunk, which is short.
        """
        m, n = starts.states.shape
        single, compiled = self.single, self.compiled
        output_times = np.empty(0) if single.times is None else single.times
        events, most = compiled.events, max(single.keep.events, 1)
        first, last = np.zeros((2, m, compiled.observed))
        states, times, outcomes = np.zeros((m, n)), np.zeros(m), np.zeros(m, dtype=np.int64)
        counts = {name: np.zeros(m, dtype=np.int64) for name in COUNTED}
        outputs, reduced = np.full((m, len(output_times), n), np.nan), np.zeros((m, len(single.keep.reductions)))
        event_t, event_y = np.full((m, events, most), np.nan), np.full((m, events, most, n), np.nan)
        numbers = np.ascontiguousarray(starts.parameters)
        if compiled.prepare is not None:
            numbers = np.zeros(compiled.size + 1)
            interpret(compiled.prepare, starts.parameters[0].tolist(), numbers)
        arrays: dict[str, Any] = {"starts": np.ascontiguousarray(starts.states), "numbers": numbers}
        arrays |= {"ends": states, "times": times, "outcomes": outcomes, "first": first, "last": last, **counts}
        arrays |= {"output_times": np.append(output_times, np.nan), "outputs": outputs, "reduced": reduced}
        arrays |= {"occurrence_times": event_t, "occurrence_states": event_y}
        arrays |= {"output_count": len(output_times), "most": single.keep.events}
        compiled.code({**self.settings(m), **arrays, "points": np.zeros(1), "table": np.zeros(1), **compiled.read})
        codes = _CODES[outcomes]
        self.complete(outputs, output_times, states, times)
        columns = {STATE: states, TIME: times, STATUS: codes, OUTPUTS: outputs, **counts}
        columns |= {reduction.name: reduced[:, k] for k, reduction in enumerate(single.keep.reductions)}
        columns |= {event_times(k): event_t[:, k] for k in range(events)}
        columns |= {event_states(k): event_y[:, k] for k in range(events)}
        energies = Energies(starts.states, states, first, last)
        if single.keep.drift:
            columns[DRIFT] = energies.drift
        doubtful = (codes == UNDECIDED) | self.unexplained(starts, states, times, codes)
        if single.model.conservative:
            doubtful |= ((codes == SUCCESS) | (codes == EVENT)) & energies.moved
        ends = Results({column.name: columns[column.name] for column in single.columns})
        return single.again(starts, ends, np.flatnonzero(doubtful))

    def complete(self, outputs: FloatArray, output_times: FloatArray, states: FloatArray, times: FloatArray) -> None:
        """Write to `outputs` (m, K, 2n) what is not known before m runs have ended: entries at and after their ends.

        `outputs` has the states at `output_times` (K,). The runs ended at `times` (m,) in `states` (m, 2n). If a run
        ended exactly at an output time, its last state is written there. After the end of a run NaN is written.
        """
        t0, t1 = self.single.span
        for index in np.flatnonzero((output_times == times[:, None]).any(axis=0)):
            ended = times == output_times[index]
            outputs[ended, index] = states[ended]
        after_end = (output_times - times[:, None]) * (1.0 if t1 >= t0 else -1.0) > 0
        outputs[after_end] = np.nan

    def unexplained(
        self, starts: Starts, states: FloatArray, times: FloatArray, codes: NDArray[np.uint8]
    ) -> NDArray[np.bool_]:
        """Return a mask (m,) of members that ended early for an unknown cause, and have to run again one by one.

        The runs ended in `states` (m, 2n) at `times` (m,) with status `codes` (m,). With events, the mask is True for
        members that ended early without an event, except those that reached the step limit. Without events, it is True
        for members that took no step, and for those whose mass matrix may have become singular. Codes are changed in
        place: STUCK (steps too small) becomes LOST (not finite) if a small step along the slope leaves the domain of
        the equations.
        """
        model, (t0, t1) = self.single.model, self.single.span
        stuck = codes == STUCK
        for i in np.flatnonzero(stuck):
            parameters = starts.parameters[i if len(starts.parameters) > 1 else 0]
            if not np.isfinite(slope_ahead(model, times[i], states[i], parameters, DOMAIN_PROBE * (t1 - t0))).all():
                codes[i] = LOST
        if self.compiled.events:
            # These members run again: a single run with events may continue after a point that has no Taylor series.
            return np.asarray((codes != SUCCESS) & (codes != EVENT) & (codes != UNFINISHED))
        lost = stuck & (codes == STUCK) & (not model.equations.structure.constant_mass)
        return np.asarray(lost | ((times == t0) & (codes != SUCCESS)))

    def settings(self, count: int) -> dict[str, Any]:
        """Return the scalar arguments of the machine code for `count` members: time span, tolerances and limits."""
        tolerances, (t0, t1) = self.plan.tolerances, self.single.span
        return {
            "count": count,
            "budget": self.single.options.step_limit,
            "t0": t0,
            "t1": t1,
            "rtol": tolerances.margin * tolerances.rtol,
            "floor": max(tolerances.margin * tolerances.atol, LEAST_FLOOR),
            "share": tolerances.margin * tolerances.share,
            "step": tolerances.step if t1 >= t0 else -tolerances.step,
            "longest": tolerances.longest,
        }


def lane_engine(single: RunEngine, plan: Plan, problem: Problem, *, varying: bool) -> LaneEngine | None:
    """Return the object that runs members in lanes, or None if the model, the method or the events do not allow it.

    `plan` and `problem` are those of the first member, and `single` runs members one by one. `varying` is True if each
    member has its own parameters. The machine code is cached for later ensembles of the model.
    """
    if not _runs_in_lanes(single, plan, problem):
        return None
    # A series also watches the square roots in the equations of motion.
    events = plan.events if isinstance(plan, TaylorPlan) else model_events(problem.model, problem.events)
    path = None
    if isinstance(plan, StepPlan) and (single.times is not None or single.keep.reductions or problem.events):
        path = plan.path_of(problem, np.array([problem.t0]), problem.y0[None]).kind
    reactions = tuple(Reaction(each.direction, each.terminal, root=each.root, smooth=each.smooth) for each in events)
    users = sum(not event.root for event in events)
    nodes = tuple(event.node for event in events)
    tasks = MemberTasks(single.keep.reductions, path, varying, nodes, reactions, users)
    cache = _COMPILED.setdefault(single.model, {})
    # The code depends on the order of the series, or on the step program.
    key = plan.order if isinstance(plan, TaylorPlan) else plan.step if isinstance(plan, StepPlan) else None, tasks
    if key not in cache:
        cache[key] = compiled_members(single.model, plan, tasks)
    return LaneEngine(cache[key], plan, single)


def _runs_in_lanes(single: RunEngine, plan: Plan, problem: Problem) -> bool:
    """Return True if members can run in vector lanes, for this system, target, method (in `plan`) and events.

    The code in lanes does not support constraints, contacts, known functions of time, resets, events that set
    parameters, and implicit methods.
    """
    model = single.model
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
