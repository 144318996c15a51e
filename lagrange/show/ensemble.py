"""Run a system from many starts: `lagrange.ensemble`, and its result with the final states and statuses of all runs."""

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
from lagrange.machine.model import Model, Stated
from lagrange.members.jobs import (
    ExecutorRunner,
    Job,
    ResultCollector,
    Runner,
    ThreadRunner,
    results_in_memory,
    run_members,
    threads_of,
)
from lagrange.members.results import (
    COUNTS,
    END,
    EVENTS,
    INTERRUPTED,
    OUTPUT_TIME,
    OUTPUTS,
    STATE,
    STATUS,
    STATUSES,
    SUCCESS,
    TIME,
    Column,
    Results,
    end_row,
    entry_for,
    event_states,
    event_times,
    keep_of,
    reduction_label,
)
from lagrange.members.results import DEFAULT as DEFAULT_KEEP
from lagrange.members.singly import Explained
from lagrange.members.store import StoredResults, results_in_store
from lagrange.members.store_description import MEMBER, check_names, start_name
from lagrange.members.table import MemberTable, member_table
from lagrange.show.figures.ensemble_figure import COMPLETE, plot_ensemble
from lagrange.show.files import FILE_DPI
from lagrange.show.files.atomic_file import write_atomically, write_rows
from lagrange.show.files.picture import picture
from lagrange.show.files.run_files import optional_package
from lagrange.show.notebook.html_card import pairs, pictured
from lagrange.statement.coordinate import row_label
from lagrange.statement.display import LINES, announced, counter, duration, text_table
from lagrange.statement.event import declare_events
from lagrange.statement.expression import flag_or_word, whole_number
from lagrange.statement.run_settings import DEFAULT_METHOD
from lagrange.trajectory.ending_messages import message, number
from lagrange.trajectory.integrator import Problem, RunOptions
from lagrange.trajectory.methods.registry import find
from lagrange.trajectory.outputs import output_times
from lagrange.trajectory.plan import Planned
from lagrange.trajectory.run import compiled, span_or_end
from lagrange.trajectory.trajectory import FloatArray, Status

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


MOST_LETTERS = 240  # Longest message of a failed member on the card, in characters; `messages` has the whole text

MOST_DRAWN = 1_000_000
"""Largest number of members whose picture a notebook shows automatically: more take seconds to read and to draw."""


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """Runs of one model, the members, from many starts or with many parameters; index i is the same member everywhere.

    `table` has the varied quantities, and `results` the results of all members. `columns` describe the kept
    quantities. `problem` is the run of the first member. `form` is a phrase on how members were run, such as "runs
    one after the other". `ran` is the number of members that this call ran; the other members were in the store
    before, or were not run. `wall` is the time of the call in seconds. `explain(i)` runs member i again for its
    message.
    """

    table: MemberTable
    results: Results | StoredResults
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
        """The compiled model that all members share."""
        return self.problem.model

    @property
    def t(self) -> FloatArray:
        """Output times (K,) with t_eval; else the time at which each member ended, (members,)."""
        times: FloatArray = self.results.column(TIME)
        return times if self.problem.t_eval is None else self.problem.t_eval

    @property
    def y(self) -> FloatArray:
        """Final states [q, v], (2n, members); with t_eval the states at the output times, (2n, K, members).

        Without t_eval the final state of a member is the last one that its run reached, at the time in `t`. With
        t_eval, states at output times that a run did not reach are NaN.
        """
        if self.problem.t_eval is None:
            return np.asarray(self._kept(STATE, END).T)
        return np.asarray(np.moveaxis(self.results.column(OUTPUTS), 0, -1).swapaxes(0, 1))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rows of `y`: the coordinates, then the velocities."""
        return self.model.layout.names()

    def __getitem__(self, key: Any) -> FloatArray:
        """Return the values with the name or symbol `key`: a row of `y`, a varied quantity, or a kept quantity.

        A name such as theta_end is the final state, even with t_eval. The key ("max", theta) is the quantity kept by
        that pair.
        """
        label = self.label(key)
        if label in self.names:
            return np.asarray(self.y[self.names.index(label)])
        if label in self.table.labels:
            return self.given(label)
        row = end_row(label, self.names)
        return np.asarray(self.results.column(label) if row is None else self._kept(STATE, END)[:, row])

    def label(self, key: Any) -> str:
        """Return the name of a row of `y`, of a varied quantity or of a kept quantity.

        `key` is the symbol or the name, or a pair such as ("max", theta). Raises StatementError for any other key.
        """
        label = key if isinstance(key, str) else reduction_label(key, self.model) or row_label(key)
        kept = [column.name for column in self.columns if column.name not in (STATE, OUTPUTS, STATUS)]
        labels = dict.fromkeys([*self.names, *self.table.labels, *kept])
        if not isinstance(key, str) and f"{label} 2" in labels:
            alike = [name for name in labels if name.startswith(label)]
            raise StatementError(
                f"several kept expressions are printed as {label}: give one of the names {listing(alike)}."
            )
        if label not in labels and (row := end_row(label, self.names)) is not None:
            return self.names[row] if self.problem.t_eval is None else label
        if label not in labels:
            if entry := entry_for(label):
                raise StatementError(f'{label[:80]} was not kept: add {entry} to keep, as in keep=("end", {entry}).')
            raise StatementError(
                f"{label[:80]!r} is not a coordinate, a velocity or a quantity that varies or was kept; these are "
                f"{listing(labels)}.{suggestion(label[:80], labels)}"
            )
        return label

    def _kept(self, column: str, name: str) -> Any:
        """Return the values of a kept quantity, `column`. Raises StatementError if it was not kept.

        The message of the error tells the user to add `name` to `keep`.
        """
        if all(kept.name != column for kept in self.columns):
            raise StatementError(f'{column} was not kept: add "{name}" to keep, as in keep=("end", "{name}").')
        return self.results.column(column)

    def given(self, name: Any) -> FloatArray:
        """Return the values of the varied quantity `name`, (members,). Raises StatementError if it does not vary."""
        return self.table.varied[name]

    @cached_property
    def _codes(self) -> NDArray[np.uint8]:
        return np.asarray(self.results.column(STATUS))

    @cached_property
    def status(self) -> NDArray[np.object_]:
        """Status of the run of each member, an array (members,) of `lagrange.Status`."""
        return np.array(STATUSES, dtype=object)[self._codes]

    @property
    def messages(self) -> Mapping[int, str]:
        """Message of each member that did not succeed, by the index of the member."""
        return Messages(self)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Number of accepted steps of each member, (members,). Raises StatementError without "counts" in `keep`."""
        return np.asarray(self._kept("steps", COUNTS))

    @property
    def t_events(self) -> tuple[FloatArray, ...]:
        """Times of the first k occurrences of each event, (members, k), for ("events", k) in `keep`.

        If an event occurred less often, the other times are NaN.
        """
        return tuple(self._kept(event_times(k), EVENTS) for k in range(len(self.problem.events)))

    @property
    def y_events(self) -> tuple[FloatArray, ...]:
        """States at the first k occurrences of each event, (members, k, 2n), for ("events", k) in `keep`.

        If an event occurred less often, the other states are NaN.
        """
        return tuple(self._kept(event_states(k), EVENTS) for k in range(len(self.problem.events)))

    def plot(self, what: Any = None, *, ax: Any = None, style: str = "light") -> Figure:
        """Return a figure of `what`, the name of a coordinate, velocity or kept quantity; by default the first one.

        If two axes of a grid vary, it is a map with the first axis horizontal. If one varies, it is a curve; samples
        and arrays give a histogram. With t_eval the figure shows the median and the quantiles of a row over time. Final
        angles are shown within one turn; failed members are marked. `style` is "light" or "dark". Draws into `ax` if it
        is given. Raises StatementError if more than two axes vary, and if no member has a value.
        """
        return plot_ensemble(self, what, ax, style)

    def to_png(
        self, path: str | os.PathLike[str], what: Any = None, *, dpi: int = FILE_DPI, style: str = "light"
    ) -> Path:
        """Write the figure that `plot(what)` returns as a PNG file with `dpi` dots per inch, and return the path.

        `style` is "light" or "dark". Raises StatementError for a path that cannot be written.
        """
        return write_atomically(path, picture(lambda: self.plot(what, style=style), dpi))

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write a line for each member: its number, varied quantities, status and kept quantities; numbers round-trip.

        Columns of final states have names such as theta_end, and columns of arrays such as t_event_0[0], t_event_0[1].
        Raises StatementError with t_eval and for a path that cannot be written, RunError if the disk is full.
        """
        if self.problem.t_eval is not None:
            raise StatementError(
                "a table with one line per member cannot hold states at output times: use to_xarray(), or leave "
                "t_eval out."
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
                    for index in np.ndindex(rows.shape[1:]):
                        columns["".join([name, *(f"[{k}]" for k in index)])] = rows[(slice(None), *index)]
        return write_atomically(path, lambda file: write_rows(file, [*columns], [c.tolist() for c in columns.values()]))

    def _repr_html_(self) -> str:
        """Return the card of the ensemble as HTML for a notebook, with a picture if one can be drawn."""
        heading, *lines = self._card()
        card = pairs(heading[1], lines)
        return card if len(self) > MOST_DRAWN else pictured(card, self.plot, heading[1])

    def to_xarray(self) -> xarray.Dataset:
        """Return a Dataset: kept quantities as functions of varied ones, with a dimension for each axis of a grid.

        With t_eval the initial values of a varied coordinate theta are named theta_start, because theta are its values
        at the output times. Raises StatementError without xarray.
        """
        with optional_package("xarray", "to_xarray"):
            import xarray
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
        """Return the name of the varied quantity `label` in a Dataset.

        With t_eval the initial values of a coordinate have the suffix _start.
        """
        return label if self.problem.t_eval is None else start_name(label, self.names)

    def _variables(self, column: Column) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
        """Yield (name, values, dimensions) of each variable of a Dataset for a column of results.

        The dimensions of the varied quantities, which come first in the Dataset, are not included.
        """
        names, rows = self._variables_of(column), self.results.column(column.name)
        if column.name == STATUS:
            yield STATUS, np.array([status.value for status in STATUSES])[rows], ()
        elif column.name in (OUTPUTS, STATE):
            yield from ((name, rows[..., i], column.dimensions) for i, name in enumerate(names))
        else:
            yield column.name, rows, column.dimensions

    def _variables_of(self, column: Column) -> list[str]:
        """Return the names of the Dataset's variables for `column`; states have one variable for each entry."""
        if column.name not in (STATE, OUTPUTS):
            return [column.name]
        suffixed = column.name == STATE and self.problem.t_eval is not None
        taken = () if column.name == OUTPUTS else self.table.labels
        return [f"{name}_end" if suffixed or name in taken else name for name in self.names]

    def __repr__(self) -> str:
        """Return the card of the ensemble."""
        (_, heading), *lines = self._card()
        return f"{heading}\n{text_table(('', ''), lines)}"

    def _card(self) -> list[tuple[str, str]]:
        """Return the lines of the ensemble's card as pairs (label, text), the heading first."""
        counts = np.bincount(self._codes, minlength=len(STATUSES))
        ended = listing(f"{count:,} {end.value}" for end, count in zip(STATUSES, counts.tolist(), strict=True) if count)
        shape = [count for count in self.table.varied.shape if count > 1]
        many = f" ({' x '.join(map(str, shape))})" if len(shape) > 1 else ""
        stored = len(self) - int(counts[INTERRUPTED]) - self.ran
        kept = [name for column in self.columns if column.name != STATUS for name in self._variables_of(column)]
        per_run = f", {duration(self.wall / self.ran)} each" if self.ran else ""
        before = f"; {stored:,} were stored before" if stored > 0 and self.ran else ""
        lines = [
            ("", f"{self.model.statement.name}: {len(self):,} members{many}, varying {listing(self.table.labels)}"),
            ("method", f"{self.method}, {self.form}"),
            ("ended", ended),
            ("kept", listing(kept)),
            ("time", f"{duration(self.wall)}{per_run}{before}"),
        ]
        failed = np.flatnonzero(~COMPLETE[self._codes] & (self._codes != INTERRUPTED))
        if len(failed):
            text = shorten(self.messages[int(failed[0])], MOST_LETTERS, placeholder=" ...")
            lines.append((f"member {failed[0]}", text))
        return lines


@dataclass(frozen=True, repr=False)
class Messages(Mapping[int, str]):
    """Messages of members that did not succeed, by index of the member. `failed` are the indices of these members.

    Most messages are computed at first use, by running the member alone. Its rounding errors may then differ. If the
    run then ends at another time, to six digits, the message is derived from the final state of the member in the
    ensemble.
    """

    ensemble: Ensemble
    failed: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        codes = self.ensemble.results.column(STATUS)
        object.__setattr__(self, "failed", tuple(np.flatnonzero(codes != SUCCESS).tolist()))

    def __repr__(self) -> str:
        """Return the number of members that did not succeed, and the first message."""
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
        """Return the message of a member. Raises StatementError for a member that succeeded or does not exist."""
        results, ensemble = self.ensemble.results, self.ensemble
        member = whole_number(member, "member", 0, len(ensemble) - 1)
        if member in results.messages:
            return results.messages[member]
        status = STATUSES[results.row(STATUS, member)]
        if status is Status.SUCCESS:
            raise UnknownKey(f"member {member} succeeded, so it has no message: ask for a member that did not succeed.")
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

    `span` is the end, or (t0, t1). `initial` and `parameters` are dicts of numbers, the same for all members, or of
    arrays (members,) of one length. One of the two may be `lagrange.grid(...)` or `lagrange.sample(...)` instead.
    Method, tolerances, `t_eval` and `events` are those of a run. `keep` names the quantities kept for each member:
    "end", "counts", "drift", ("events", k), ("max", x), ("min", x) and ("mean", x) for an expression x.

    Members run several at a time, in vector registers, if the method is explicit, the system has no constraints or
    switching surfaces and no event has a reset; else one by one. `workers` is the number of threads, by default one
    for each core. With an `executor`, of `concurrent.futures` or a `dask.distributed.Client`, they run on its
    workers. With a `store`, the name of a folder such as "runs.zarr", results are written there block by block and
    not kept in memory; the same call continues where an earlier one stopped. `progress` shows the finished members,
    their rate and the time left, in a terminal and in a notebook; "lines" also prints a line from time to time
    elsewhere. The result of a member does not depend on the others, nor on where it runs. Its failure is in `.status`
    and `.messages`; after Ctrl-C members that were not run are INTERRUPTED.

    Raises StatementError for invalid arguments, RunError if an executor or a disk fails.
    """
    began = time.perf_counter()
    model = compiled(system, "double-pendulum", progress=flag_or_word(progress, "progress", LINES))
    (t0, t1), events = span_or_end(span), declare_events(events, model.statement) or None
    threads = threads_of(workers)
    if workers is not None and executor is not None:
        raise StatementError("workers and executor are both given: the executor has workers of its own. Give one.")
    table = member_table(model, initial, parameters)
    options = RunOptions(find(DEFAULT_METHOD if method is None else method), rtol, atol, step, None, events, max_steps)
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
        events=events or (),
    )
    job = Job(problem, options, keep_of(keep, model, problem.events), table.varying)
    return _run(job, table, threads, executor, store, began=began, progress=flag_or_word(progress, "progress", LINES))


def _run(
    job: Job, table: MemberTable, threads: int, executor: Any, store: Any, *, began: float, progress: bool | str
) -> Ensemble:
    """Run the members that the folder `store` does not have yet, and return the Ensemble. Without a store run all.

    `job` is the run that all members share, and `table` the varied quantities. `threads` is the number of threads
    without an `executor`. `began` is the clock time in seconds at which the call began. `progress` is the user's
    option: False for no progress bar.
    """
    problem, method = job.problem, job.options.method
    check_names(job.columns, problem.model.layout.names(), table.labels, store=store is not None)
    plan = method.plan(problem) if isinstance(method, Planned) else None
    aimed = problem if plan is None else replace(problem, rtol=plan.tolerances.rtol or None)
    results = results_in_memory(job, table) if store is None else results_in_store(job, table, store)
    before = len(table) - sum(end - begin for begin, end in results.left)
    collector = ResultCollector(problem.model.machine.processor, results.take, before)
    try:
        if results.left:
            with announced("compiling", problem.model.statement.name, enabled=bool(progress)):
                alone = executor is None
                runner: Runner = ThreadRunner(job.engine(), threads) if alone else ExecutorRunner(executor, job)
            shown_bar = counter(len(table), "member", enabled=progress, before=before)
            # After Ctrl-C a member that was not run counts as INTERRUPTED.
            with shown_bar as collector.report, suppress(KeyboardInterrupt):
                run_members(table, results.left, runner, collector)
    finally:
        results.close()
    wall = time.perf_counter() - began
    explain = partial(job.explained, table)
    return Ensemble(table, results, job.columns, aimed, method.name, collector.form, collector.ran, wall, explain)
