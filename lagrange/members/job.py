"""What all members of an ensemble have in common, as a record that goes to other processes, and chunks of the work."""

from __future__ import annotations

import hashlib
import pickle
import time
from collections import OrderedDict
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from lagrange.errors import StatementError
from lagrange.members.chunk import INTERRUPTED, Ends, Engine, Starts, Stopped, Table
from lagrange.members.keep import Column, Keep
from lagrange.members.lanes import lane_engine
from lagrange.members.singly import Explained, RunEngine, flow_engine
from lagrange.statement.number import whole_number
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.plan import Planned

ENGINES_KEPT = 4
"""So many jobs stay compiled in a worker."""


@dataclass(frozen=True, eq=False)
class Job:
    """The run of the first member, the options of all, what is kept, and whether each has parameters of its own."""

    problem: Problem
    options: RunOptions
    keep: Keep
    varying: bool

    @property
    def columns(self) -> tuple[Column, ...]:
        """What is kept of each member."""
        problem = self.problem
        outputs = None if problem.t_eval is None else len(problem.t_eval)
        return self.keep.columns(problem.model.layout.size, outputs, len(problem.events), INTERRUPTED)

    def engine(self) -> Engine:
        """Return what runs members: side by side where there is machine code for them, else one after the other."""
        problem, method, alone = self.problem, self.options.method, self.alone
        if not isinstance(method, Planned) or problem.t0 == problem.t1:
            return alone
        return lane_engine(alone, method.plan(problem), problem, varying=self.varying) or flow_engine(alone) or alone

    @property
    def alone(self) -> RunEngine:
        """What runs members one after the other."""
        problem = self.problem
        span = problem.t0, problem.t1
        return RunEngine(problem.model, span, self.options, problem.t_eval, self.keep, self.columns)

    def explained(self, table: Table, member: int) -> Explained:
        """Return how a run of one member ends, in words. Raises StatementError for a number that no member has."""
        chosen = whole_number(member, "member", 0, len(table) - 1)
        return self.alone.explained(table.starts(np.array([chosen])))

    def packed(self) -> bytes:
        """Return the job for another process. Raises StatementError for what cannot be sent."""
        try:
            return pickle.dumps(replace(self, problem=replace(self.problem, progress=None)))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise StatementError(
                f"the ensemble cannot be sent to other processes: {error}. A function that a method or an event is "
                "made of must be one of a module, not a lambda or one inside another function."
            ) from error


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """What came of a chunk: the seconds that its members took, how they were run, and what they were compiled for.

    `side_by_side` is how many members take as long as one. `processor` is empty where that is the processor of this
    process, or none.
    """

    ends: Ends
    seconds: float
    form: str
    side_by_side: int
    processor: str = ""


_ENGINES: OrderedDict[bytes, tuple[Engine, str]] = OrderedDict()
_LOCK = Lock()


def run_chunk(job: bytes, starts: Starts) -> ChunkResult:
    """Run members in the process that this is called in, which compiles a job when it first comes."""
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
    """Run members, and note how long that takes."""
    began = time.perf_counter()
    ends = engine.run(starts, stopped)
    return ChunkResult(ends, time.perf_counter() - began, engine.form, engine.side_by_side)
