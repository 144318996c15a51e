"""A job: what all members of an ensemble share, pickled for other processes, and the run of a chunk of members."""

from __future__ import annotations

import hashlib
import pickle
import time
from collections import OrderedDict
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from lagrange.errors import StatementError
from lagrange.members.chunk import INTERRUPTED, Ends, Starts, Stopped
from lagrange.members.kept_results import Column, Keep
from lagrange.members.lanes import LaneEngine, lane_engine
from lagrange.members.singly import BY_FLOW, Explained, FlowEngine, RunEngine
from lagrange.members.table import MemberTable
from lagrange.statement.expression import whole_number
from lagrange.trajectory.flow import Flow
from lagrange.trajectory.integrator import Problem, RunOptions
from lagrange.trajectory.plan import Planned

Engine = RunEngine | FlowEngine | LaneEngine
"""Object that runs members, `side_by_side` at the same time. A member's result depends only on its initial values."""

ENGINES_KEPT = 4
"""Largest number of jobs that a worker keeps compiled. The oldest is dropped."""


@dataclass(frozen=True, eq=False)
class Job:
    """The data that all members of an ensemble share: problem, options, and the selection of results to store.

    `problem` is the problem of the first member; others differ in initial state and parameters. `keep` is the
    selection. `varying` is True if each member has its own parameters.
    """

    problem: Problem
    options: RunOptions
    keep: Keep
    varying: bool

    @property
    def columns(self) -> tuple[Column, ...]:
        """The descriptions of the result columns that are stored for the members."""
        problem = self.problem
        outputs = None if problem.t_eval is None else len(problem.t_eval)
        return self.keep.columns(problem.model.layout.size, outputs, len(problem.events), INTERRUPTED)

    def engine(self) -> Engine:
        """Return the object that runs members: in vector lanes if possible, else by a `Flow`, else one by one."""
        problem, method, alone = self.problem, self.options.method, self.alone
        if not isinstance(method, Planned) or problem.t0 == problem.t1:
            return alone
        lanes = lane_engine(alone, method.plan(problem), problem, varying=self.varying)
        # Events may end a run, or change its state and parameters; a flow has none.
        flows = alone.options.events is None and BY_FLOW.issuperset(column.name for column in alone.columns)
        return lanes or (FlowEngine(alone, Flow(alone.model, alone.options)) if flows else alone)

    @property
    def alone(self) -> RunEngine:
        """The object that runs members one by one, each as a separate run."""
        problem = self.problem
        span = problem.t0, problem.t1
        return RunEngine(problem.model, span, self.options, problem.t_eval, self.keep, self.columns)

    def explained(self, table: MemberTable, member: int) -> Explained:
        """Run the member with index `member` again, and return the status, time and message of its end.

        Raises StatementError for an index outside the table.
        """
        chosen = whole_number(member, "member", 0, len(table) - 1)
        return self.alone.explained(table.starts(np.array([chosen])))

    def packed(self) -> bytes:
        """Return the pickled job for another process. Raises StatementError for a function that cannot be pickled."""
        try:
            return pickle.dumps(replace(self, problem=replace(self.problem, progress=None)))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise StatementError(
                f"the ensemble cannot be sent to other processes: {error}. Define the functions of methods and "
                "events at the top level of a module: lambdas and nested functions cannot be pickled."
            ) from error


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """The results of a chunk, the seconds that it took, and how its members were run.

    `side_by_side` is the number of members that run at the same time. `processor` names the processor for which
    another process compiled the code. It is "" for chunks of this process, and for runs without compiled code.
    """

    ends: Ends
    seconds: float
    form: str
    side_by_side: int
    processor: str = ""


_ENGINES: OrderedDict[bytes, tuple[Engine, str]] = OrderedDict()
_LOCK = Lock()


def run_chunk(job: bytes, starts: Starts) -> ChunkResult:
    """Run a chunk of members in a worker process, for a pickled `job`. The process compiles each job once."""
    key = hashlib.sha256(job).digest()
    with _LOCK:
        if key not in _ENGINES:
            loaded: Job = pickle.loads(job)
            _ENGINES[key] = loaded.engine(), loaded.problem.model.machine.processor
            while len(_ENGINES) > ENGINES_KEPT:
                _ENGINES.popitem(last=False)
        engine, processor = _ENGINES[key]
    return replace(timed(engine, starts, lambda: False), processor=processor)


def timed(engine: Engine, starts: Starts, stopped: Stopped) -> ChunkResult:
    """Run a chunk of members from their initial values `starts`. Return their results and the time that it took.

    `stopped` is a function without arguments; when it returns True, no further member may begin.
    """
    began = time.perf_counter()
    ends = engine.run(starts, stopped)
    return ChunkResult(ends, time.perf_counter() - began, engine.form, engine.side_by_side)
