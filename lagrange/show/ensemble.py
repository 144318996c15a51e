"""The result of an ensemble as a person uses it: ends of all members, how each run ended, and what varied."""

from __future__ import annotations

import html
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import StatementError, counted, listing, suggestion
from lagrange.machine.model import Model
from lagrange.members.chunk import STATUSES, SUCCESS
from lagrange.members.keep import (
    COUNTS,
    END,
    EVENTS,
    OUTPUTS,
    STATE,
    STATUS,
    TIME,
    Column,
    event_states,
    event_times,
)
from lagrange.members.results import Kept
from lagrange.members.singly import Explained
from lagrange.members.table import MemberTable
from lagrange.show.figures.ensemble_figure import plot_ensemble
from lagrange.show.files.atomic_file import write_atomically
from lagrange.show.files.picture import picture
from lagrange.show.files.resolution import FILE_DPI
from lagrange.show.rows import row_label
from lagrange.show.terminal.table import duration
from lagrange.statement.choice import one_of
from lagrange.statement.parameters import label_of
from lagrange.trajectory.integrator import Problem
from lagrange.trajectory.messages import message, number
from lagrange.trajectory.trajectory import FloatArray, Status

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """Runs of one model from many starts, or with many parameters; member i is the same in every array.

    `problem` is the run of the first member, `columns` is what was kept, `form` says how members were run, `wall` is in
    seconds, and `explain` runs one member again to say how it ends.
    """

    table: MemberTable
    results: Kept
    columns: tuple[Column, ...]
    problem: Problem
    method: str
    form: str
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
        """Return the row of a coordinate or a velocity, the values of what varies, or what was kept, by its name."""
        label = self.label(key)
        found: FloatArray
        if label in self.names:
            found = self.y[self.names.index(label)]
        elif label in self.table.labels:
            found = self.given(label)
        else:
            found = self.results.column(label)
        return found

    def label(self, key: Any) -> str:
        """Return what a row, what varies or what was kept is called. Raises StatementError for anything else."""
        label = key if isinstance(key, str) else row_label(key)
        others = [column.name for column in self.columns if column.name not in (STATE, OUTPUTS, STATUS)]
        known = dict.fromkeys([*self.names, *self.table.labels, *others])
        if label not in known:
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
        label = row_label(name)
        one_of(label, self.table.labels, "{given} does not vary between the members; what varies is {known}.")
        key = next(key for key in self.table.varied.keys if label_of(key) == label)
        return self.table.varied.values(key, np.arange(len(self)))

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

        Two axes of a grid give a map, one a curve, samples and arrays a histogram; with t_eval the median and the
        quantiles of a row over time. Draws into `ax` where that is given. Raises StatementError where more varies.
        """
        return plot_ensemble(self, what, ax, style)

    def to_png(self, path: str | os.PathLike[str], *, dpi: int = FILE_DPI) -> Path:
        """Write the picture of `plot()`. Raises StatementError for a path that cannot be written."""
        return write_atomically(path, picture(self.plot, dpi))

    def _repr_html_(self) -> str:
        """Return the card for a notebook."""
        return f"<pre>{html.escape(repr(self))}</pre>"

    def to_xarray(self) -> xarray.Dataset:
        """Return a Dataset: what was kept over what varies, with a dimension for each axis of a grid.

        Raises StatementError without xarray.
        """
        try:
            import xarray
        except ModuleNotFoundError as error:
            raise StatementError(
                "to_xarray() needs xarray, which is not installed: pip install xarray, or in a checkout "
                "pip install '.[data]'."
            ) from error
        axes, labels = self.table.varied.axes, self.table.labels
        shape, dims = self.table.varied.shape, tuple(axes)
        data: dict[str, Any] = {}
        for column in self.columns:
            for name, rows, more in self._variables(column):
                data[name] = ((*dims, *more), rows.reshape(*shape, *rows.shape[1:]))
        coordinates: dict[str, Any] = {name: (name, values) for name, values in axes.items()}
        coordinates |= {name: ("member", self.given(name)) for name in labels if name not in axes}
        if self.problem.t_eval is not None:
            coordinates["t"] = ("t", self.problem.t_eval)
        attributes = {"system": self.model.statement.name, "method": self.method, "form": self.form}
        return xarray.Dataset(data, coords=coordinates, attrs=attributes)

    def _variables(self, column: Column) -> Iterator[tuple[str, Any, tuple[str, ...]]]:
        """Yield the variables of a column: name, rows, and the dimensions behind those of what varies."""
        rows = self.results.column(column.name)
        if column.name == STATUS:
            yield STATUS, np.array([one.value for one in STATUSES])[rows], ()
        elif column.name == OUTPUTS:
            yield from ((name, rows[..., i], ("t",)) for i, name in enumerate(self.names))
        elif column.name == STATE:
            apart = self.problem.t_eval is not None
            for i, name in enumerate(self.names):
                yield f"{name}_end" if apart or name in self.table.labels else name, rows[..., i], ()
        else:
            yield column.name, rows, ("occurrence", "row")[: rows.ndim - 1]

    def __repr__(self) -> str:
        """Return the card of the ensemble."""
        counts = np.bincount(self._codes, minlength=len(STATUSES)).tolist()
        ended = ", ".join(f"{count} {one.value}" for one, count in zip(STATUSES, counts, strict=True) if count)
        shape = [count for count in self.table.varied.shape if count > 1]
        many = f" ({' x '.join(map(str, shape))})" if len(shape) > 1 else ""
        lines = [
            f"{self.model.statement.name}: {counted(len(self), 'member')}{many}, varying {listing(self.table.labels)}",
            f"  {self.method}, {self.form}: {ended}",
            f"  {duration(self.wall)}, {duration(self.wall / max(len(self), 1))} each",
        ]
        return "\n".join(lines)


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

    def __iter__(self) -> Iterator[int]:
        return iter(self.failed)

    def __getitem__(self, member: int) -> str:
        results, ensemble = self.ensemble.results, self.ensemble
        if member in results.messages:
            return results.messages[member]
        status = STATUSES[results.row(STATUS, member)]
        if status is Status.SUCCESS:
            raise KeyError(member)
        t = float(results.row(TIME, member))
        if status is Status.INTERRUPTED and np.isnan(t):
            return "the ensemble was interrupted before this member was run."
        alone = ensemble.explain(member)
        if alone.status is status and number(alone.t) == number(t):
            return alone.message
        kept = any(column.name == STATE for column in ensemble.columns)
        y = results.row(STATE, member) if kept else np.full(len(ensemble.names), np.nan)
        return message(status, ensemble.problem, t, y, ensemble.method, rtol=ensemble.problem.rtol)
