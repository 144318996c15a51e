"""What a picture of an ensemble shows: one number for each member, its name with its unit, and which members failed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lagrange.dynamics.angles import is_angle, wrapped
from lagrange.errors import StatementError, formula
from lagrange.members.chunk import INTERRUPTED, STATUSES
from lagrange.members.keep import DRIFT, OUTPUTS, STATE, STATUS, TIME, end_row, event_times
from lagrange.show.figures.panel import label_of_entry
from lagrange.show.notation.names import letter_of
from lagrange.show.units import unit_of, with_unit
from lagrange.statement.statement import Statement
from lagrange.trajectory.trajectory import FloatArray

if TYPE_CHECKING:
    from lagrange.show.ensemble import Ensemble

COMPLETE = np.array([status.complete for status in STATUSES])
"""Whether a run got to its end, by the code of its status."""

_REDUCED = re.compile(r"(max|min|mean)\((.*)\)")
_WORDS = {"max": "largest", "min": "least", "mean": "mean"}
_EVENT = re.compile(r"t_event_([0-9]+)")


@dataclass(frozen=True, eq=False)
class Quantity:
    """A number for each member, (members,): NaN where it failed, and where there is none.

    `angle` says that it is one, between -pi and pi.
    """

    name: str
    label: str
    values: FloatArray
    failed: NDArray[np.bool_]
    unrun: int
    angle: bool

    @property
    def remark(self) -> str:
        """The sentence about members that are not in the picture, empty where all are."""
        said, members = [], len(self.values)
        lost = int(self.failed.sum()) - self.unrun
        none = int((~np.isfinite(self.values) & ~self.failed).sum())
        if lost:
            said.append(f"{lost:,} of {members:,} members failed")
        if self.unrun:
            said.append(f"{self.unrun:,} of {members:,} members were not run")
        if none:
            said.append(f"{none:,} of {members:,} members have none")
        return "; ".join(said)


def quantity(runs: Ensemble, name: str) -> Quantity:
    """Return what is drawn by a name. Raises StatementError for what has more than a number for each member."""
    statement = runs.model.statement
    codes = np.asarray(runs.results.column(STATUS))
    row = runs.names.index(name) if name in runs.names else None
    if row is not None:
        found = runs.y[row] if runs.problem.t_eval is None else runs.y[row, -1]
        label = f"{label_of_entry(statement, name)} at the end"
    elif name not in runs.table.labels and (row := end_row(name, runs.names)) is not None:
        found = runs[name]
        label = f"{label_of_entry(statement, runs.names[row])} at the end"
    else:
        found = np.asarray(runs[name], dtype=float)
        label = label_of(runs, name)
    if _EVENT.fullmatch(name):
        found = found[:, 0]
    if found.ndim != 1:
        raise StatementError(f"{name} has {found[0].size} numbers for each member, and a picture shows one.")
    angle = row is not None and is_angle(statement, row)
    values = np.where(COMPLETE[codes], wrapped(found, -np.pi) if angle else found, np.nan)
    unrun = int(np.count_nonzero((codes == INTERRUPTED) & np.isnan(runs.results.column(TIME))))
    return Quantity(name, label, values, ~COMPLETE[codes], unrun, angle)


def label_of(runs: Ensemble, name: str) -> str:
    """Return what varies or was kept as a label of an axis, with its unit."""
    statement = runs.model.statement
    if name in runs.names:
        return label_of_entry(statement, name)
    if name in (TIME, "t"):
        return with_unit("time of the end" if name == TIME else "$t$", unit_of(statement, "t"))
    if name == DRIFT:
        return "energy drift, relative"
    if (match := _REDUCED.fullmatch(name)) and match[2] in runs.names:
        return f"{_WORDS[match[1]]} {label_of_entry(statement, match[2])}"
    if match := _EVENT.fullmatch(name):
        event = runs.problem.events[int(match[1])]
        written = formula(event.expression.xreplace(dict(statement.plain)), 40)
        return with_unit(f"first time of {written} = 0", unit_of(statement, "t"))
    return with_unit(_parameter(statement, name), unit_of(statement, name))


def _parameter(statement: Statement, name: str) -> str:
    """Return a parameter as mathematics, anything else as it is."""
    return f"${letter_of(name)}$" if any(one.name == name for one in statement.parameters) else name


def first_drawn(runs: Ensemble) -> str:
    """Return the name of what is drawn where nobody says it: what was kept beside states, else the first coordinate."""
    kept = [column.name for column in runs.columns if column.name not in (STATE, OUTPUTS, STATUS, TIME)]
    numbers = [column.name for column in runs.columns if column.name in kept and not column.shape]
    if numbers:
        return numbers[0]
    if any(column.name in (STATE, OUTPUTS) for column in runs.columns):
        return runs.names[0]
    return event_times(0) if event_times(0) in kept else TIME
