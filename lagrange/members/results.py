"""Results of the members of an ensemble: columns, arrays in memory, and reductions along a single run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, count
from typing import Any, NamedTuple

import numpy as np

from lagrange.algorithm.members.queue import COUNTED
from lagrange.algorithm.members.reductions import SIGNS, lobatto, raised
from lagrange.errors import StatementError, formula, listing, shown, suggestion
from lagrange.machine.model import Model
from lagrange.machine.parameter_arrays import Parameters
from lagrange.machine.python_source import called
from lagrange.statement.expression import entries, one_of, whole_number
from lagrange.statement.run_settings import REDUCTIONS
from lagrange.trajectory.trajectory import FloatArray, Status, Trajectory

END, COUNTS, DRIFT, EVENTS = "end", "counts", "drift", "events"
DEFAULT = (END,)

STATE, TIME, STATUS, OUTPUTS = "state", "t_end", "status", "outputs"
"""Names of result columns: last states, their times, status codes, and states at output times."""

OUTPUT_TIME = "t"
"""Name, in a store of results, of the dimension of output times and of the variable that contains these times."""


class Column(NamedTuple):
    """The description of a result column, an array with a row for each member.

    `name` is the name of the column. A row has the shape `shape` and the dtype `kind`. Rows without a result have the
    value `blank`.
    """

    name: str
    shape: tuple[int, ...]
    kind: str
    blank: float

    def empty(self, members: int) -> Any:
        """Return the array of the column for a number of members, with the value `blank` in every row."""
        return np.full((members, *self.shape), self.blank, dtype=self.kind)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """The names of the dimensions of the array in a store, without the first, which counts the members.

        A column of states has no dimension for the entries of a state, because each entry is stored as a separate
        variable.
        """
        if self.name in (STATE, OUTPUTS):
            return (OUTPUT_TIME,) if self.name == OUTPUTS else ()
        return ("occurrence", "row")[: len(self.shape)]

    @property
    def bytes(self) -> int:
        """The number of bytes that the column takes for one member."""
        return int(np.prod(self.shape, dtype=np.int64)) * np.dtype(self.kind).itemsize


class Reduction(NamedTuple):
    """An expression that is reduced to one number along a run, such as its largest value.

    `name` is the name of the result column, and `how` the name of the reduction, such as "max".
    """

    name: str
    how: str
    expression: Any


@dataclass(frozen=True)
class Keep:
    """The selection of results that are stored for each member of an ensemble.

    Three flags are True if a result is stored: `end`, the last state; `counts`, the numbers of steps and evaluations;
    `drift`, the drift of the energy. `events` is the largest number of stored occurrences of each event. `reductions`
    are expressions along the run, each reduced to one number.
    """

    end: bool
    counts: bool
    drift: bool
    events: int
    reductions: tuple[Reduction, ...]

    def columns(self, dimension: int, outputs: int | None, events: int, interrupted: int) -> tuple[Column, ...]:
        """Return the descriptions of the columns in which the selected results are stored.

        `dimension` is the length 2n of a state, `outputs` the number of output times or None, and `events` the number
        of the user's events. `interrupted` is the status code that marks a member without result.
        """
        selected = [Column(TIME, (), "f8", np.nan), Column(STATUS, (), "u1", interrupted)]
        if self.end:
            selected.append(Column(STATE, (dimension,), "f8", np.nan))
        if outputs is not None:
            selected.append(Column(OUTPUTS, (outputs, dimension), "f8", np.nan))
        if self.counts:
            selected += [Column(name, (), "i8", 0) for name in COUNTED]
        if self.drift:
            selected.append(Column(DRIFT, (), "f8", np.nan))
        selected += [Column(reduction.name, (), "f8", np.nan) for reduction in self.reductions]
        for k in range(events if self.events else 0):
            selected.append(Column(event_times(k), (self.events,), "f8", np.nan))
            selected.append(Column(event_states(k), (self.events, dimension), "f8", np.nan))
        return tuple(selected)


def event_times(k: int) -> str:
    """Return the name of the result column with the times at which event number k, from 0 on, occurred."""
    return f"t_event_{k}"


def event_states(k: int) -> str:
    """Return the name of the result column with the states in which event number k, from 0 on, occurred."""
    return f"y_event_{k}"


def keep_of(keep: Any, model: Model, events: Sequence[Any]) -> Keep:
    """Return the checked selection of results for the user's option `keep`, such as ("end", ("max", theta)).

    `events` are the events of the ensemble. Raises StatementError for unknown or invalid entries.
    """
    listed = entries((keep,) if isinstance(keep, str) or _is_reduction(keep) or _is_first(keep) else keep, "keep")
    if not listed:
        raise StatementError(f'keep is {shown(keep)}: give at least one result, such as ("end", ("max", theta)).')
    names: dict[str, None] = {}
    occurrences = 0
    reductions: list[Reduction] = []
    for entry in listed:
        if isinstance(entry, str) and entry in (END, COUNTS, DRIFT):
            names[entry] = None
        elif entry == EVENTS or _is_first(entry):
            occurrences = 1 if entry == EVENTS else whole_number(entry[1], "the number of occurrences that are kept", 1)
            if not events:
                raise StatementError("keep has events, and the ensemble has none: give events=[...].")
        elif _is_reduction(entry):
            _add(reductions, _reduction(entry[0], entry[1], model))
        else:
            keywords = [END, COUNTS, DRIFT, EVENTS]
            hint = suggestion(entry, keywords) if isinstance(entry, str) else ""
            has_formula = _is_pair(entry) and hasattr(entry[1], "xreplace")
            quoted = f"({shown(entry[0])}, {_written(entry[1], model)})" if has_formula else shown(entry)
            raise StatementError(
                f"keep has {quoted}, which is none of {listing(keywords)}, nor a pair such as "
                f"('max', theta), ('min', theta), ('mean', theta) or ('events', 3).{hint}"
            )
    return Keep(END in names, COUNTS in names, DRIFT in names, occurrences, tuple(reductions))


def _add(reductions: list[Reduction], added: Reduction) -> None:
    """Append the reduction `added` to `reductions`, unless the list has it.

    If another expression has the same name, a number is appended to the new name, such as "max(x) 2".
    """
    if any((reduction.how, reduction.expression) == (added.how, added.expression) for reduction in reductions):
        return
    names = {reduction.name for reduction in reductions}
    numbered = (f"{added.name} {k}" for k in count(2))
    reductions.append(added._replace(name=next(name for name in chain([added.name], numbered) if name not in names)))


def reduction_label(key: Any, model: Model) -> str | None:
    """Return the name "max(theta)" of the column for the entry `key` = ("max", theta) of the user's option `keep`.

    The reductions "min" and "mean" have such names, too. Returns None for any other entry.
    """
    return f"{key[0]}({_written(key[1], model)})" if _is_reduction(key) else None


def entry_for(label: str) -> str:
    """Return the entry of the user's `keep` option, as text for a message, that creates the column `label`.

    The text is "" if no entry creates it.
    """
    if label == DRIFT or label in COUNTED:
        return f'"{DRIFT if label == DRIFT else COUNTS}"'
    how, bracket, rest = label.partition("(")
    return f'("{how}", {rest[:-1]})' if how in REDUCTIONS and bracket and rest.endswith(")") else ""


def end_row(label: str, names: Sequence[str]) -> int | None:
    """Return the index in `names`, the names of the state's entries, of the entry whose last value is called `label`.

    For the label "theta_end" it is the index of "theta". It is None for any other label.
    """
    name = label.removesuffix("_end")
    return names.index(name) if name != label and name in names else None


def _is_pair(entry: Any) -> bool:
    return isinstance(entry, (tuple, list)) and len(entry) == 2 and isinstance(entry[0], str)


def _is_first(entry: Any) -> bool:
    """Return True for a pair such as ("events", 3), which selects the first 3 occurrences of each event."""
    return _is_pair(entry) and entry[0] == EVENTS and not isinstance(entry[1], (str, list, tuple))


def _is_reduction(entry: Any) -> bool:
    return _is_pair(entry) and entry[0] in REDUCTIONS


def _reduction(how: str, quantity: Any, model: Model) -> Reduction:
    """Return the reduction `how`, such as "max", of `quantity`: an expression, or the name of a coordinate or velocity.

    Raises StatementError for an unknown name or symbol.
    """
    statement = model.statement
    expression = quantity
    if isinstance(quantity, str):
        names = statement.state_names
        one_of(quantity, names, "{given} in keep is neither a coordinate nor a velocity; these are {known}.")
        expression = (*statement.coordinates, *statement.velocities)[names.index(quantity)]
    # Raise an error for an unknown symbol here, not in the run of the first member.
    model.evaluate_expression(
        expression, np.zeros(1), np.array(statement.initial)[:, None], np.ones(len(statement.parameters))
    )
    return Reduction(f"{how}({_written(expression, model)})", how, expression)


def _written(expression: Any, model: Model) -> str:
    """Return an expression as text, cut to about 80 characters, with plain symbols: theta for theta(t)."""
    plain = dict(model.statement.plain)
    return formula(expression.xreplace(plain) if hasattr(expression, "xreplace") else expression, 80)


STEPS_AT_ONCE = 16384
"""Largest number of steps whose sample points are evaluated in one call, to limit the memory for a long run."""

OVERSHOOT = 2.5
"""Assumed bound of the excess of an expression within a step over its values at sample points, in units of the largest
change between neighbouring samples. A step is searched for a maximum only if such an excess would give a new maximum of
the run. The search `raised` assumes that a slope is at most twice the slope between neighbouring samples. The distances
of samples in time differ by at most a factor of 2.3."""

NONE = np.empty(0)
"""Empty array for arguments of the search `raised` that are not used here: polynomials of a step. Here the search
evaluates the dense output of a run by a callback."""


@dataclass(frozen=True, eq=False)
class SampledRun:
    """A run of one member with all its accepted states, from which reductions such as a maximum are computed.

    `parameters` (k,) are those of this member.
    """

    model: Model
    run: Trajectory
    parameters: FloatArray

    def reduced(self, reductions: Sequence[Reduction]) -> dict[str, float]:
        """Return {column name: number} for the results of `reductions` along the run."""
        if not reductions:
            return {}
        t, results = self.run.t, dict[str, float]()
        firsts = [float(self._values(each.expression, t[:1], self.run.y[:, :1])[0]) for each in reductions]
        signs = [SIGNS.get(each.how) for each in reductions]  # None for a mean
        # Integrals, and largest values of sign * expression, up to the steps so far.
        totals = [
            0.0 if sign is None else sign * first if first == first else -np.inf
            for sign, first in zip(signs, firsts, strict=True)
        ]
        for times, states, parameters in self._steps():
            for k, (reduction, sign) in enumerate(zip(reductions, signs, strict=True)):
                values = self._values(reduction.expression, times.ravel(), states, parameters).reshape(times.shape)
                if sign is None:
                    totals[k] += float(np.sum(values @ lobatto()[1] * (times[:, -1] - times[:, 0])))
                else:
                    totals[k] = self._largest(reduction.expression, sign, times, values, totals[k])
        duration = float(t[-1] - t[0])
        for reduction, sign, first, total in zip(reductions, signs, firsts, totals, strict=True):
            mean = total / duration if duration else first
            results[reduction.name] = mean if sign is None else float("nan") if total == -np.inf else sign * total
        return results

    def _largest(self, expression: Any, sign: float, times: FloatArray, values: FloatArray, best: float) -> float:
        """Return the largest value of sign * expression so far: on k steps, or `best`, that on the steps before.

        `times` and `values` (k, SAMPLE_POINTS) are the sample times of each step, and the values of the expression
        there. If a step may have a value above `best` between these times, the dense output is searched.
        """
        signed = values * sign
        best = max(best, float(np.max(signed, where=signed == signed, initial=-np.inf)))
        with np.errstate(all="ignore"):
            reach = np.fmax.reduce(signed, axis=1) + OVERSHOOT * np.fmax.reduce(np.abs(np.diff(signed)), axis=1)
        search, points = called(raised.form()), lobatto()[0]
        for k in np.flatnonzero(reach > best).tolist():
            value = partial(self._inside, expression, times[k, 0], times[k, -1] - times[k, 0])
            best = float(search(value, 0.0, 0.0, 0.0, 0, NONE, NONE, 0, sign, best, values[k], points))
        return best

    def _inside(self, expression: Any, begin: float, length: float, fraction: float, *_: Any) -> float:
        """Return the value of an expression within the step that starts at the time `begin` and lasts `length`.

        `fraction`, from 0 to 1, is the time since the start of the step as a fraction of `length`. Further arguments,
        which the search `raised` passes, are ignored.
        """
        times = np.array([begin + fraction * length])
        return float(self._values(expression, times, self.run.dense(times))[0])

    def _values(
        self, expression: Any, times: FloatArray, states: FloatArray, parameters: Parameters = None
    ) -> FloatArray:
        """Return the values (K,) of an expression at times (K,) and states (2n, K) of the run.

        `parameters` are (p, K), one column for each time, or (p,). None means the parameters of the member, with the
        values that its events have set.
        """
        values = self.run.parameters_at(times, self.parameters) if parameters is None else parameters
        return self.model.evaluate_expression(expression, times, states, values)

    def _parameters(self, low: int, high: int) -> Parameters:
        """Return the parameters at the sample points of the steps with the indices `low` to `high` - 1.

        The shape is (p, steps * points) for p parameters and equally many points in each step, or (p,) if no event sets
        parameters.
        """
        begin = self.run.parameters_at(self.run.t, self.parameters)
        if not (isinstance(begin, np.ndarray) and begin.ndim == 2):
            return begin
        points = np.repeat(begin[:, low:high, None], len(lobatto()[0]), axis=2)
        # A step ends with the parameters before an event at its end. A reset ends with the parameters after the event.
        resets = low + np.flatnonzero(np.diff(self.run.t[low : high + 1]) == 0)
        points[:, resets - low, -1] = begin[:, resets + 1]
        return points.reshape(len(begin), -1)

    def _steps(self) -> Iterator[tuple[FloatArray, FloatArray, Parameters]]:
        """Yield samples of the run in groups of k successive steps, at K points of each step, which `lobatto` defines.

        A group has the times (k, K), the states (2n, k * K), and the parameters, (p, k * K), or (p,) if they do not
        change. A reset counts as a step of length zero.
        """
        t, y, points = self.run.t, self.run.y, lobatto()[0][1:-1]
        for low in range(0, len(t) - 1, STEPS_AT_ONCE):
            high = min(low + STEPS_AT_ONCE, len(t) - 1)
            begins, lengths = t[low:high], np.diff(t[low : high + 1])
            times = begins[:, None] + lengths[:, None] * points
            inner = self.run.dense(times.ravel()).reshape(len(y), *times.shape)
            times = np.concatenate([begins[:, None], times, t[low + 1 : high + 1, None]], axis=1)
            ends = y[:, low:high, None], inner, y[:, low + 1 : high + 1, None]
            yield times, np.concatenate(ends, axis=2).reshape(len(y), -1), self._parameters(low, high)


STATUSES = tuple(Status)
"""All statuses of a run. Results store the index of a status in this tuple as its code."""

SUCCESS, INTERRUPTED = STATUSES.index(Status.SUCCESS), STATUSES.index(Status.INTERRUPTED)
"""Codes of the statuses of a run that reached its end, and of a member not run because the ensemble was interrupted."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Initial values of m members: states (m, 2n) and parameters (m, k), or (1, k) if all members share them."""

    states: FloatArray
    parameters: FloatArray

    def __len__(self) -> int:
        return len(self.states)

    def of(self, which: Any) -> Starts:
        """Return the initial values of the members `which`, a slice or indices."""
        shared = len(self.parameters) == 1
        return Starts(self.states[which], self.parameters if shared else self.parameters[which])


Stopped = Callable[[], bool]
"""Type of a callback without arguments that returns True if no further member may begin, as after Ctrl-C."""


@dataclass(frozen=True, eq=False)
class Results:
    """The results of m members, of a chunk or of an ensemble in memory: `columns` by name, each with m rows.

    `Keep.columns` defines the columns. `messages` maps the index of each member that did not succeed, counted from the
    first of the m members, to the message of its run.
    """

    columns: dict[str, Any]
    messages: dict[int, str] = field(default_factory=dict)

    @property
    def members(self) -> int:
        """The number of members that have rows in the columns."""
        return len(next(iter(self.columns.values())))

    @classmethod
    def empty(cls, members: int, columns: Sequence[Column]) -> Results:
        """Return results in which all rows, one for each of `members` members, have the blank value of their column."""
        return cls({column.name: column.empty(members) for column in columns})

    def column(self, name: str) -> Any:
        """Return the results `name` of all members, an array with a row for each member."""
        return self.columns[name]

    def row(self, name: str, member: int) -> Any:
        """Return the result `name` of one member, given by its index."""
        return self.columns[name][member]

    @property
    def left(self) -> Sequence[tuple[int, int]]:
        """Bounds (first, end) of the blocks of members that are still to be run: all members, as one block."""
        return [(0, self.members)]

    def close(self) -> None:
        """Do nothing: arrays need no closing."""

    def take(self, first: int, ends: Results) -> None:
        """Copy the results `ends` of a chunk of members to the rows from `first` on."""
        for name in sorted(ends.columns, key=STATUS.__eq__):
            rows = ends.columns[name]
            self.columns[name][first : first + len(rows)] = rows
        self.messages.update({first + row: text for row, text in ends.messages.items()})
