"""Machine code for the members of a model: its laws and expressions as procedures, and the steps of a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.equations.expressions import node_of
from lagrange.graph.node import Node
from lagrange.machine.backend import MemberRuns
from lagrange.machine.event_memory import EventMemory, Reaction
from lagrange.machine.model import Model
from lagrange.members.keep import Reduction
from lagrange.procedure.builder import Builder
from lagrange.procedure.dense.block import StepPolynomial
from lagrange.procedure.dense.hermite import hermite_polynomial
from lagrange.procedure.form import FLAG, REAL, Procedure
from lagrange.procedure.kernel.kernels import kernel, prepare
from lagrange.procedure.kernel.prepared import Prepared
from lagrange.procedure.members.along import Sampled, table_of_points
from lagrange.procedure.members.occurrences import Events
from lagrange.procedure.members.paths import DenseOutput
from lagrange.procedure.members.queue import Members, Numbers, Observed
from lagrange.procedure.members.step_review import StepEvents
from lagrange.procedure.members.steps import StepMembers
from lagrange.procedure.members.taylor import TaylorMembers
from lagrange.procedure.prune import Pruner
from lagrange.procedure.series.by_order import ByOrderJet
from lagrange.procedure.series.cost import single_operations
from lagrange.procedure.series.integrator import TaylorProcedures
from lagrange.procedure.series.packing import pack
from lagrange.procedure.series.written_out import WrittenJet
from lagrange.procedure.step.constants import RELATIVE_PERTURBATION, perturbation_factors
from lagrange.procedure.taylor.memory import SIZES
from lagrange.program.actions import LAWS
from lagrange.trajectory.events.actions import Impact
from lagrange.trajectory.methods.taylor import TaylorPlan
from lagrange.trajectory.plan import Plan, StepPlan

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
