"""The result of an ensemble as a person uses it: ends of all members, how each run ended, and what varied."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lagrange.errors import StatementError, UnknownKey, counted, listing, suggestion
from lagrange.machine.model import Model, Stated, stated
from lagrange.members.chunk import INTERRUPTED, STATUSES, SUCCESS, MemberResults
from lagrange.members.job import Job
from lagrange.members.keep import (
    COUNTS,
    END,
    EVENTS,
    OUTPUT_TIME,
    OUTPUTS,
    STATE,
    STATUS,
    TIME,
    Column,
    end_row,
    entry_for,
    event_states,
    event_times,
    keep_of,
    reduction_label,
)
from lagrange.members.keep import DEFAULT as DEFAULT_KEEP
from lagrange.members.origin import MEMBER, check_names, start_name
from lagrange.members.singly import Explained
from lagrange.members.storage import ResultStorage, kept_in_memory
from lagrange.members.store import kept_in_store
from lagrange.members.table import MemberTable, member_table
from lagrange.members.work import ExecutorRunner, Runner, ThreadRunner, run_members, threads_of
from lagrange.show.figures.ensemble_figure import COMPLETE, plot_ensemble
from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import write_atomically, write_rows
from lagrange.show.files.picture import picture
from lagrange.show.notebook.html_card import image, pairs, sentences
from lagrange.show.terminal.table import duration, text_table
from lagrange.statement.coordinate import row_label
from lagrange.statement.event import declare_events
from lagrange.statement.given import require_values
from lagrange.statement.number import whole_number
from lagrange.trajectory.integrate import output_times, span_or_end
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import message, number
from lagrange.trajectory.methods.registry import DEFAULT, find
from lagrange.trajectory.options import RunOptions
from lagrange.trajectory.plan import Planned
from lagrange.trajectory.progress import compiling, counter, wanted_progress
from lagrange.trajectory.trajectory import FloatArray, Status

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


MOST_LETTERS = 240
"""Letters on the card of what happened to the first member that failed; `messages` has all."""

MOST_DRAWN = 1_000_000
"""Members of an ensemble whose picture a notebook shows unasked: more take seconds to read and to draw."""


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """Runs of one model from many starts, or with many parameters; member i is the same in every array.

    `problem` is the run of the first member, `columns` is what was kept, `form` says how members were run, `ran` how
    many by this call, the others being stored before or interrupted, `wall` is in seconds, and `explain` runs one
    member again to say how it ends.
    """

    table: MemberTable
    results: MemberResults
    columns: tuple[Column, ...]
    problem: Problem
    method: str
    form: str
    ran: int
    wall: float
    explain: Callable[[int], Explained]

    def __len__(self) -> int:
        return len(self.table)

    @property
    def model(self) -> Model:
        """The model that was run."""
        return self.problem.model

    @property
    def t(self) -> FloatArray:
        """The output times (K,), or the time at which each member ended, (members,), without t_eval."""
        times: FloatArray = self.results.column(TIME)
        return times if self.problem.t_eval is None else self.problem.t_eval

    @property
    def y(self) -> FloatArray:
        """The last states [q, v], (2n, members); with t_eval the states there, (2n, K, members).

        What a run did not reach is NaN in the states at output times; without them a state is the last that was
        reached, and `t` says when.
        """
        if self.problem.t_eval is None:
            return np.asarray(self._kept(STATE, END).T)
        return np.asarray(np.moveaxis(self.results.column(OUTPUTS), 0, -1).swapaxes(0, 1))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the rows of `y`."""
        return self.model.layout.names()

    def __getitem__(self, key: Any) -> FloatArray:
        """Return the row of a coordinate or a velocity, the values of what varies, or what was kept, by its name.

        A name such as theta_end means the last state, with t_eval too; ("max", theta) means what was kept by it.
        """
        label = self.label(key)
        found: FloatArray
        if label in self.names:
            found = self.y[self.names.index(label)]
        elif label in self.table.labels:
            found = self.given(label)
        elif (row := end_row(label, self.names)) is not None:
            found = self._kept(STATE, END)[:, row]
        else:
            found = self.results.column(label)
        return found

    def label(self, key: Any) -> str:
        """Return what a row, what varies or what was kept is called. Raises StatementError for anything else."""
        label = key if isinstance(key, str) else reduction_label(key, self.model) or row_label(key)
        others = [column.name for column in self.columns if column.name not in (STATE, OUTPUTS, STATUS)]
        known = dict.fromkeys([*self.names, *self.table.labels, *others])
        if not isinstance(key, str) and f"{label} 2" in known:
            alike = [name for name in known if name.startswith(label)]
            raise StatementError(f"several expressions are written {label}: give one of the names {listing(alike)}.")
        if label not in known and (row := end_row(label, self.names)) is not None:
            return self.names[row] if self.problem.t_eval is None else label
        if label not in known:
            if entry := entry_for(label):
                raise StatementError(f'{label[:80]} was not kept: add {entry} to keep, as in keep=("end", {entry}).')
            raise StatementError(
                f"{label[:80]!r} is no coordinate, no velocity and nothing that varies or was kept; these are "
                f"{listing(known)}.{suggestion(label[:80], known)}"
            )
        return label

    def _kept(self, column: str, name: str) -> Any:
        """Return a column. Raises StatementError where it was not kept."""
        if all(one.name != column for one in self.columns):
            raise StatementError(f'{column} was not kept: add "{name}" to keep, as in keep=("end", "{name}").')
        return self.results.column(column)

    def given(self, name: Any) -> FloatArray:
        """Return the values with which something varies, (members,). Raises StatementError for what does not."""
        return self.table.varied[name]

    @cached_property
    def _codes(self) -> NDArray[np.uint8]:
        return np.asarray(self.results.column(STATUS))

    @cached_property
    def status(self) -> NDArray[np.object_]:
        """How each run ended, (members,) of `lagrange.Status`."""
        return np.array(STATUSES, dtype=object)[self._codes]

    @property
    def messages(self) -> Mapping[int, str]:
        """A sentence for each member that did not succeed, by its number."""
        return Messages(self)

    @property
    def steps(self) -> NDArray[np.int64]:
        """The accepted steps of each member, (members,), with "counts" in keep."""
        return np.asarray(self._kept("steps", COUNTS))

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """The times of the first k occurrences of each event, (members, k), NaN behind the last."""
        return tuple(self._kept(event_times(k), EVENTS) for k in range(len(self.problem.events)))

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """The states at the first k occurrences of each event, (members, k, 2n)."""
        return tuple(self._kept(event_states(k), EVENTS) for k in range(len(self.problem.events)))

    def plot(self, what: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return a figure of a coordinate, a velocity or what was kept, by name: the first there is unless given.

        Two axes of a grid give a map, the first to the right, one a curve, samples and arrays a histogram; with t_eval
        the median and the quantiles of a row over time. Angles at the end are shown within one turn, members that
        failed are marked. `style` is "light" or "dark". Draws into `ax` where that is given. Raises StatementError
        where more varies, and where no member has a value.
        """
        return plot_ensemble(self, what, ax, style)

    def to_png(
        self, path: str | os.PathLike[str], what: Any = None, *, dpi: int = FILE_DPI, style: str = "light"
    ) -> Path:
        """Write the picture of `plot(what)`. Raises StatementError for a path that cannot be written."""
        return write_atomically(path, picture(lambda: self.plot(what, style=style), dpi))

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write a line for each member: its number, what varies, its status and what was kept; numbers round-trip.

        States at the end are named theta_end, arrays t_event_0[0], t_event_0[1]. Raises StatementError with t_eval,
        for a path that cannot be written, RunError if the disk is full.
        """
        if self.problem.t_eval is not None:
            raise StatementError(
                "a line for each member has no place for states at output times: use to_xarray(), or leave t_eval out."
            )
        columns: dict[str, Any] = {"member": np.arange(len(self))}
        columns |= {name: self.given(name) for name in self.table.labels}
        for column in self.columns:
            for name, rows, _ in self._variables(column):
                if column.name == STATE:
                    columns[f"{name.removesuffix('_end')}_end"] = rows
                elif rows.ndim == 1:
                    columns[name] = rows
                else:
                    for place in np.ndindex(rows.shape[1:]):
                        columns["".join([name, *(f"[{k}]" for k in place)])] = rows[(slice(None), *place)]
        return write_atomically(path, lambda file: write_rows(file, [*columns], [c.tolist() for c in columns.values()]))

    def _repr_html_(self) -> str:
        """Return the card for a notebook, with the picture where there is something to draw."""
        heading, *lines = self._card()
        card = pairs(heading[1], lines)
        if len(self) > MOST_DRAWN:
            return card
        try:
            return card + image(self.plot(), f"plot of {heading[1]}")
        except StatementError as nothing_to_draw:
            return card + sentences([str(nothing_to_draw)])

    def to_xarray(self) -> xarray.Dataset:
        """Return a Dataset: what was kept over what varies, with a dimension for each axis of a grid.

        With t_eval a coordinate theta that varies is named theta_start: theta are the states at output times.
        Raises StatementError without xarray.
        """
        try:
            import xarray
        except ModuleNotFoundError as error:
            raise StatementError(
                "to_xarray() needs xarray, which is not installed: pip install xarray, or in a checkout "
                "pip install '.[data]'."
            ) from error
        axes = {self._start_name(name): values for name, values in self.table.varied.axes.items()}
        labels = {self._start_name(label): label for label in self.table.labels}
        shape, dims = self.table.varied.shape, tuple(axes)
        data: dict[str, Any] = {}
        for column in self.columns:
            for name, rows, more in self._variables(column):
                data[name] = ((*dims, *more), rows.reshape(*shape, *rows.shape[1:]))
        coordinates: dict[str, Any] = {name: (name, values) for name, values in axes.items()}
        coordinates |= {name: (MEMBER, self.given(label)) for name, label in labels.items() if name not in axes}
        if self.problem.t_eval is not None:
            coordinates[OUTPUT_TIME] = (OUTPUT_TIME, self.problem.t_eval)
        attributes = {"system": self.model.statement.name, "method": self.method, "form": self.form}
        return xarray.Dataset(data, coords=coordinates, attrs=attributes)

    def _start_name(self, label: str) -> str:
        """Return the name of what varies in a Dataset, where states at output times may have its own."""
        return label if self.problem.t_eval is None else start_name(label, self.names)

    def _variables(self, column: Column) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
        """Yield the variables of a column: name, rows, and the dimensions behind those of what varies."""
        names, rows = self._variables_of(column), self.results.column(column.name)
        if column.name == STATUS:
            yield STATUS, np.array([one.value for one in STATUSES])[rows], ()
        elif column.name in (OUTPUTS, STATE):
            yield from ((name, rows[..., i], column.dimensions) for i, name in enumerate(names))
        else:
            yield column.name, rows, column.dimensions

    def _variables_of(self, column: Column) -> list[str]:
        """Return the names of the variables of a column: of states one for each entry."""
        if column.name not in (STATE, OUTPUTS):
            return [column.name]
        apart = column.name == STATE and self.problem.t_eval is not None
        taken = () if column.name == OUTPUTS else self.table.labels
        return [f"{name}_end" if apart or name in taken else name for name in self.names]

    def __repr__(self) -> str:
        """Return the card of the ensemble."""
        (_, heading), *lines = self._card()
        return f"{heading}\n{text_table(('', ''), lines)}"

    def _card(self) -> list[tuple[str, str]]:
        """Return the lines of the card, each with a name, the heading first."""
        counts = np.bincount(self._codes, minlength=len(STATUSES))
        ended = listing(f"{count:,} {one.value}" for one, count in zip(STATUSES, counts.tolist(), strict=True) if count)
        shape = [count for count in self.table.varied.shape if count > 1]
        many = f" ({' x '.join(map(str, shape))})" if len(shape) > 1 else ""
        stored = len(self) - int(counts[INTERRUPTED]) - self.ran
        kept = [name for column in self.columns if column.name != STATUS for name in self._variables_of(column)]
        each = f", {duration(self.wall / self.ran)} each" if self.ran else ""
        before = f"; {stored:,} were stored before" if stored > 0 and self.ran else ""
        lines = [
            ("", f"{self.model.statement.name}: {len(self):,} members{many}, varying {listing(self.table.labels)}"),
            ("method", f"{self.method}, {self.form}"),
            ("ended", ended),
            ("kept", listing(kept)),
            ("time", f"{duration(self.wall)}{each}{before}"),
        ]
        failed = np.flatnonzero(~COMPLETE[self._codes] & (self._codes != INTERRUPTED))
        if len(failed):
            said = shorten(self.messages[int(failed[0])], MOST_LETTERS, placeholder=" ...")
            lines.append((f"member {failed[0]}", said))
        return lines


@dataclass(frozen=True, repr=False)
class Messages(Mapping[int, str]):
    """The sentences of members that did not succeed, each made when it is asked for unless its run has left one.

    It is that of a run of the member alone, where that ends at the same time to six digits: rounding differs in lanes.
    """

    ensemble: Ensemble
    failed: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        codes = self.ensemble.results.column(STATUS)
        object.__setattr__(self, "failed", tuple(np.flatnonzero(codes != SUCCESS).tolist()))

    def __repr__(self) -> str:
        """Return how many members did not succeed, and the first of their sentences."""
        if not self.failed:
            return "<messages of 0 members>"
        first = self.failed[0]
        return f"<messages of {counted(len(self.failed), 'member')}, of member {first}: {self[first]}>"

    def __len__(self) -> int:
        return len(self.failed)

    def __contains__(self, member: object) -> bool:
        return member in self.failed

    def __iter__(self) -> Iterator[int]:
        return iter(self.failed)

    def __getitem__(self, member: int) -> str:
        """Return the sentence of a member. Raises StatementError for one that succeeded, and where there is none."""
        results, ensemble = self.ensemble.results, self.ensemble
        member = whole_number(member, "member", 0, len(ensemble) - 1)
        if member in results.messages:
            return results.messages[member]
        status = STATUSES[results.row(STATUS, member)]
        if status is Status.SUCCESS:
            raise UnknownKey(f"member {member} succeeded: the messages are of members that did not.")
        t = float(results.row(TIME, member))
        if status is Status.INTERRUPTED and np.isnan(t):
            return "the ensemble was interrupted before this member was run."
        alone = ensemble.explain(member)
        if alone.status is status and number(alone.t) == number(t):
            return alone.message
        kept = any(column.name == STATE for column in ensemble.columns)
        y = results.row(STATE, member) if kept else np.full(len(ensemble.names), np.nan)
        return message(status, ensemble.problem, t, y, ensemble.method, rtol=ensemble.problem.rtol)


def ensemble(
    system: Stated | Model,
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


def _model(system: Stated | Model, progress: bool | str) -> Model:
    """Return the model of a system. Raises StatementError for what is none."""
    statement = stated(system, "double-pendulum")
    require_values(statement)
    with compiling(statement.name, wanted=bool(progress)):
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
