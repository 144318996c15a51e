"""Ensembles of runs: one model, many starts or parameters."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lagrange.errors import StatementError, shown
from lagrange.machine.model import Model
from lagrange.members.job import Job
from lagrange.members.keep import DEFAULT as DEFAULT_KEEP
from lagrange.members.keep import keep_of
from lagrange.members.names import check_names
from lagrange.members.processors import threads_of
from lagrange.members.runners import ExecutorRunner, Runner, ThreadRunner
from lagrange.members.storage import ResultStorage, kept_in_memory
from lagrange.members.store import kept_in_store
from lagrange.members.table import MemberTable, member_table
from lagrange.members.work import run_members
from lagrange.show.ensemble import Ensemble
from lagrange.statement.event import declare_events
from lagrange.statement.given import require_values
from lagrange.system import System
from lagrange.trajectory.integrate import output_times, span_or_end
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.methods.registry import DEFAULT, find
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.plan import Planned
from lagrange.trajectory.progress import compiling, counter, wanted_progress


def ensemble(
    system: System | Model,
    span: float | Sequence[float],
    initial: Any = None,
    *,
    parameters: Any = None,
    method: Any = None,
    rtol: float | None = None,
    atol: float | None = None,
    step: float | None = None,
    t_eval: ArrayLike | None = None,
    events: Any = None,
    max_steps: int | None = None,
    keep: Any = DEFAULT_KEEP,
    workers: int | None = None,
    executor: Any = None,
    store: str | os.PathLike[str] | None = None,
    progress: bool | str = False,
) -> Ensemble:
    """Run one system from many starts, or with many parameters, and return the Ensemble.

    `span` is the end, or (t0, t1). `initial` and `parameters` are dicts whose values are numbers, which all members
    have, or arrays (members,) of one length; or one of them is `lagrange.grid(...)` or `lagrange.sample(...)`. Method,
    tolerances, `t_eval` and `events` are those of a run. `keep` names what is kept of each member: "end", "counts",
    "drift", ("events", k), ("max", x), ("min", x) and ("mean", x) for an expression x.

    Members run side by side in machine code where the method is explicit, the system has no constraints or switching
    surfaces and no event has a reset; else one after the other. They do so on as many threads as `workers` says, by
    default one for each core. With an `executor`, of `concurrent.futures` or a
    `dask.distributed.Client`, they run where that has its workers. With a `store`, the name of a folder such as
    "runs.zarr", results are written there block by block and not kept in memory; the same call goes on where another
    one stopped. `progress` shows members done, their rate and the time left, in a terminal and in a notebook; "lines"
    writes a line now and then elsewhere too. What a member gives does not depend on the others, nor on where it runs.
    Its failure is in `.status` and `.messages`; after Ctrl-C members that were not run are INTERRUPTED.

    Raises StatementError for what cannot be meant, RunError where an executor or a disk fails.
    """
    began = time.perf_counter()
    model = _model(system, wanted_progress(progress))
    t0, t1 = span_or_end(span)
    threads = threads_of(workers)
    if workers is not None and executor is not None:
        raise StatementError("workers and executor are both given: the executor has workers of its own. Give one.")
    table = member_table(model, initial, parameters)
    options = RunOptions(find(DEFAULT if method is None else method), rtol, atol, step, None, events, max_steps)
    problem = Problem(
        model=model,
        parameters=dict(zip(model.statement.parameters, table.parameters.tolist(), strict=True)),
        t0=t0,
        t1=t1,
        y0=table.starts(np.zeros(1, dtype=np.int64)).states[0],
        t_eval=output_times(t_eval, t0, t1, model.layout.size),
        rtol=rtol,
        atol=atol,
        step=step,
        max_steps=options.step_limit,
        events=declare_events(events, model.statement),
    )
    job = Job(problem, options, keep_of(keep, model, problem.events), table.varying)
    return _run(job, table, threads, executor, store, began=began, progress=wanted_progress(progress))


def _model(system: Any, progress: bool | str) -> Model:
    """Return the model of a system. Raises StatementError for what is none."""
    if not isinstance(system, (System, Model)):
        raise StatementError(f"{shown(system)} is no system: give an lg.System, such as lg.scene('double-pendulum').")
    require_values(system.statement)
    with compiling(system.statement.name, wanted=bool(progress)):
        return system if isinstance(system, Model) else system.compile()


def _run(
    job: Job, table: MemberTable, threads: int, executor: Any, store: Any, *, began: float, progress: bool | str
) -> Ensemble:
    """Run the members of a job, and return what came of them."""
    problem, method = job.problem, job.options.method
    check_names(job.columns, problem.model.layout.names(), table.labels, store=store is not None)
    plan = method.plan(problem) if isinstance(method, Planned) else None
    aimed = problem if plan is None else replace(problem, rtol=plan.tolerances.rtol or None)
    storage = kept_in_memory(job, table) if store is None else kept_in_store(job, table, store)
    try:
        if storage.left:
            _run_left(job, table, storage, threads, executor, progress=progress)
    finally:
        storage.close()
    wall = time.perf_counter() - began
    explain = partial(job.explained, table)
    return Ensemble(table, storage.results, job.columns, aimed, method.name, storage.form, storage.ran, wall, explain)


def _run_left(
    job: Job, table: MemberTable, storage: ResultStorage, threads: int, executor: Any, *, progress: bool | str
) -> None:
    """Run the members that are left, until all are done or Ctrl-C; a member that was not run counts as INTERRUPTED."""
    with compiling(job.problem.model.statement.name, wanted=bool(progress)):
        runner: Runner = ThreadRunner(job.engine(), threads) if executor is None else ExecutorRunner(executor, job)
    before = len(table) - storage.members_left
    with counter(len(table), "member", wanted=progress, before=before) as report, suppress(KeyboardInterrupt):
        run_members(table, storage.left, runner, storage.reporting(report, before))
