"""What is kept of each member: names, and quantities along its run.

    "end"              the last state
    "counts"           steps, rejected steps and evaluations
    "drift"            how far the energy went from its first value, relative to it and to the kinetic energy
    ("events", k)      times and states of the first k occurrences of each event
    ("max", x)         the largest value of an expression along the run, between its steps too; ("min", x) the least
    ("mean", x)        its mean over time

The time of the end and the status are always kept, and the states at output times where there are such.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, count
from typing import Any, NamedTuple

import numpy as np

from lagrange.errors import StatementError, formula, listing, shown, suggestion
from lagrange.machine.model import Model
from lagrange.members.reductions import REDUCTIONS
from lagrange.procedure.members.queue import COUNTED
from lagrange.statement.choice import one_of
from lagrange.statement.expression import entries
from lagrange.statement.number import whole_number

END, COUNTS, DRIFT, EVENTS = "end", "counts", "drift", "events"
DEFAULT = (END,)

STATE, TIME, STATUS, OUTPUTS = "state", "t_end", "status", "outputs"
"""Columns: last states, times, codes of statuses, and states at output times."""

OUTPUT_TIME = "t"
"""The dimension of output times, and the variable that has them."""


class Column(NamedTuple):
    """An array with a row for each member: its name, shape and type of a row, and what stands where nothing does."""

    name: str
    shape: tuple[int, ...]
    kind: str
    blank: float

    def empty(self, members: int) -> Any:
        """Return the array of members of which nothing is known."""
        return np.full((members, *self.shape), self.blank, dtype=self.kind)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """The names of the dimensions behind that of the members; the entries of a state are variables of their own."""
        if self.name in (STATE, OUTPUTS):
            return (OUTPUT_TIME,) if self.name == OUTPUTS else ()
        return ("occurrence", "row")[: len(self.shape)]

    @property
    def bytes(self) -> int:
        """How many bytes a row takes."""
        return int(np.prod(self.shape, dtype=np.int64)) * np.dtype(self.kind).itemsize


class Reduction(NamedTuple):
    """An expression along a run made one number: the name of its column, how, and the expression."""

    name: str
    how: str
    expression: Any


@dataclass(frozen=True)
class Keep:
    """What is kept of each member."""

    end: bool
    counts: bool
    drift: bool
    events: int
    reductions: tuple[Reduction, ...]

    def columns(self, dimension: int, outputs: int | None, events: int, interrupted: int) -> tuple[Column, ...]:
        """Return the columns for states, output times and events; `interrupted` is the code of a status."""
        found = [Column(TIME, (), "f8", np.nan), Column(STATUS, (), "u1", interrupted)]
        if self.end:
            found.append(Column(STATE, (dimension,), "f8", np.nan))
        if outputs is not None:
            found.append(Column(OUTPUTS, (outputs, dimension), "f8", np.nan))
        if self.counts:
            found += [Column(name, (), "i8", 0) for name in COUNTED]
        if self.drift:
            found.append(Column(DRIFT, (), "f8", np.nan))
        found += [Column(one.name, (), "f8", np.nan) for one in self.reductions]
        for k in range(events if self.events else 0):
            found.append(Column(event_times(k), (self.events,), "f8", np.nan))
            found.append(Column(event_states(k), (self.events, dimension), "f8", np.nan))
        return tuple(found)


def event_times(k: int) -> str:
    """Return the name of the column of the times of an event."""
    return f"t_event_{k}"


def event_states(k: int) -> str:
    """Return the name of the column of the states at an event."""
    return f"y_event_{k}"


def keep_of(given: Any, model: Model, events: Sequence[Any]) -> Keep:
    """Return what is to be kept. Raises StatementError for a name that is none, and for an expression that is none."""
    listed = entries((given,) if isinstance(given, str) or _is_reduction(given) or _is_first(given) else given, "keep")
    if not listed:
        raise StatementError(f'keep is {shown(given)}: give names, such as ("end", ("max", theta)).')
    names: dict[str, None] = {}
    occurrences = 0
    reductions: list[Reduction] = []
    for one in listed:
        if isinstance(one, str) and one in (END, COUNTS, DRIFT):
            names[one] = None
        elif one == EVENTS or _is_first(one):
            occurrences = 1 if one == EVENTS else whole_number(one[1], "the number of occurrences that are kept", 1)
            if not events:
                raise StatementError("keep has events, and the ensemble has none: give events=[...].")
        elif _is_reduction(one):
            _add(reductions, _reduction(one[0], one[1], model))
        else:
            known = [END, COUNTS, DRIFT, EVENTS]
            hint = suggestion(one, known) if isinstance(one, str) else ""
            raise StatementError(
                f"keep has {_quoted(one, model)}, which is none of {listing(known)}, nor a pair such as "
                f"('max', theta), ('min', theta), ('mean', theta) or ('events', 3).{hint}"
            )
    return Keep(END in names, COUNTS in names, DRIFT in names, occurrences, tuple(reductions))


def _add(reductions: list[Reduction], given: Reduction) -> None:
    """Add what is made of an expression, once; another one that is written the same has a number behind its name."""
    if any((one.how, one.expression) == (given.how, given.expression) for one in reductions):
        return
    names = {one.name for one in reductions}
    numbered = (f"{given.name} {k}" for k in count(2))
    reductions.append(given._replace(name=next(name for name in chain([given.name], numbered) if name not in names)))


def reduction_label(key: Any, model: Model) -> str | None:
    """Return the name of the column of a pair such as ("max", theta), None for what is no such pair."""
    return f"{key[0]}({_written(key[1], model)})" if _is_reduction(key) else None


def entry_for(label: str) -> str:
    """Return what keep has to name for a column to be there, empty for what is no column."""
    if label == DRIFT or label in COUNTED:
        return f'"{DRIFT if label == DRIFT else COUNTS}"'
    how, bracket, rest = label.partition("(")
    return f'("{how}", {rest[:-1]})' if how in REDUCTIONS and bracket and rest.endswith(")") else ""


def end_row(label: str, names: Sequence[str]) -> int | None:
    """Return the row of the last state that a name such as theta_end means, None for any other name."""
    name = label.removesuffix("_end")
    return names.index(name) if name != label and name in names else None


def _is_pair(one: Any) -> bool:
    return isinstance(one, (tuple, list)) and len(one) == 2 and isinstance(one[0], str)


def _is_first(one: Any) -> bool:
    """Return whether an entry is a pair such as ("events", 3); two names are no such pair."""
    return _is_pair(one) and one[0] == EVENTS and not isinstance(one[1], (str, list, tuple))


def _is_reduction(one: Any) -> bool:
    return _is_pair(one) and one[0] in REDUCTIONS


def _reduction(how: str, given: Any, model: Model) -> Reduction:
    """Return what is kept of an expression, or of a coordinate or a velocity by its name."""
    statement = model.statement
    expression = given
    if isinstance(given, str):
        names = statement.state_names
        one_of(given, names, "{given} in keep is no coordinate and no velocity; these are {known}.")
        expression = (*statement.coordinates, *statement.velocities)[names.index(given)]
    # An expression of something that the system does not have is refused here, not by the first member.
    model.evaluate_expression(
        expression, np.zeros(1), np.array(statement.initial)[:, None], np.ones(len(statement.parameters))
    )
    return Reduction(f"{how}({_written(expression, model)})", how, expression)


def _quoted(one: Any, model: Model) -> str:
    """Return an entry of keep as a message quotes it, its expression by the names of coordinates."""
    formula = _is_pair(one) and hasattr(one[1], "xreplace")
    return f"({shown(one[0])}, {_written(one[1], model)})" if formula else shown(one)


def _written(expression: Any, model: Model) -> str:
    """Return an expression by the names of coordinates."""
    plain = dict(model.statement.plain)
    return formula(expression.xreplace(plain) if hasattr(expression, "xreplace") else expression, 80)
