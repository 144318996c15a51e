"""Internal result of a run: states, status, dense output, and the parameters that events have set."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import StatementError, shown
from lagrange.machine.parameter_arrays import Parameters
from lagrange.statement.expression import real_array, real_number

FloatArray = NDArray[np.float64]

Record = TypeVar("Record")


@dataclass(frozen=True, eq=False)
class ParameterHistory:
    """The parameters of each segment of a run, from one event that sets parameters to the next.

    `begins` (s,) are the times at which the segments begin, in the direction of the run. `values` (s, k) are their
    parameters in the statement's order. `added` (s,) is the total energy that the events before each segment added.
    """

    begins: FloatArray
    values: FloatArray
    added: FloatArray

    def __post_init__(self) -> None:
        begins, values, added = (
            real_array(getattr(self, name), f"{name} of a history") for name in ("begins", "values", "added")
        )
        if begins.ndim != 1 or not len(begins) or added.shape != begins.shape or values.shape[:-1] != begins.shape:
            raise StatementError(
                f"the arrays of a history have the shapes {begins.shape} (begins), {values.shape} (values) and "
                f"{added.shape} (added): give (s,), (s, k) and (s,) for s segments with k values each."
            )

    def changes(self, names: Sequence[str]) -> list[tuple[float, dict[str, float]]]:
        """Return for each segment but the first the time at which it begins, and the parameters that changed then.

        The parameters are a dict from name to new value. `names` (k,) are all names in the statement's order.
        """
        new = zip(self.begins[1:].tolist(), self.values[1:], self.values[1:] != self.values[:-1], strict=True)
        return [
            (begin, {names[i]: float(row[i]) for i in np.flatnonzero(changed).tolist()}) for begin, row, changed in new
        ]


def segment_numbers(begins: FloatArray, times: FloatArray, *, forward: bool) -> NDArray[np.intp]:
    """Return the index of the segment at each of the times `times` (K,). `begins` (s,) are the starts of segments.

    A time at which a segment begins belongs to this segment. If several begin at this time, it belongs to the last of
    them. If the time occurs twice in succession in `times`, the first occurrence belongs to the segment before.
    `forward` is False for a run backwards in time.
    """
    sign = 1.0 if forward else -1.0
    numbers = np.searchsorted(sign * begins[1:], sign * times, side="right")
    before = np.flatnonzero(times[:-1] == times[1:])
    first = np.searchsorted(sign * begins[1:], sign * times[before], side="left")
    numbers[before] = np.where(np.isin(times[before], begins[1:]), first, numbers[before])
    return numbers


class Status(enum.Enum):
    """The way in which a run ended.

    UNRELIABLE: the run reached its end but violated a conservation law, so it does not follow the motion.
    """

    SUCCESS = "success"
    EVENT = "event"
    UNRELIABLE = "unreliable"
    MAX_STEPS = "max_steps"
    MAX_WALL = "max_wall"
    MAX_MEMORY = "max_memory"
    NON_FINITE = "non_finite"
    SINGULAR = "singular"
    STEP_TOO_SMALL = "step_too_small"
    DIVERGED = "diverged"
    INTERRUPTED = "interrupted"

    @property
    def complete(self) -> bool:
        """True if the run reached its end or event, and passed all tests."""
        return self is _SUCCESS or self is _EVENT

    @property
    def at_end(self) -> bool:
        """True if the run reached its end, reliable or not."""
        return self.complete or self is Status.UNRELIABLE


_SUCCESS, _EVENT = Status.SUCCESS, Status.EVENT
"""Members of `Status` as globals: every run compares with them, and access by the class takes longer than that."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States at the output times, the dense output, and the cost of the run.

    `t` has shape (N,), `y` (2n, N) with rows as in the right-hand side, [q, v]. `span` is the first and the last
    accepted time, and `dense` maps times (K,) between them to states (2n, K). `steps` and `rejected` are the numbers of
    accepted and rejected steps. `evaluations` is the number of evaluations of the right-hand side, or of the series.
    `wall` is the duration in seconds without compilation. `form` says how the method computed its steps, if it has a
    choice. For each event, `t_events` has its times (k,) and `y_events` the states there, (k, 2n), before any reset.
    `step` is the length of fixed steps, or None with step control. `rtol` and `atol` are the tolerances of an adaptive
    method, or None. `history` has the parameters of each segment if events set some. `contacts` is the history of
    contacts.
    """

    t: FloatArray
    y: FloatArray
    status: Status
    message: str
    method: str
    steps: int
    rejected: int
    evaluations: int
    wall: float
    span: tuple[float, float]
    dense: Callable[[FloatArray], FloatArray]
    form: str = ""
    t_events: tuple[FloatArray, ...] = ()
    y_events: tuple[FloatArray, ...] = ()
    step: float | None = None
    rtol: float | None = None
    atol: float | None = None
    history: ParameterHistory | None = None
    contacts: Any = None

    def __repr__(self) -> str:
        method = self.method if isinstance(self.method, str) else shown(self.method)
        reached = f"{shown(self.steps)} steps of {method} from t = {self.span[0]:g} to {self.span[1]:g}"
        return f"<Trajectory: {reached}, {len(self.t)} outputs, {self.status.value}>"

    def __post_init__(self) -> None:
        t, y = real_array(self.t, "t of a trajectory"), real_array(self.y, "y of a trajectory")
        if t.ndim != 1 or y.ndim != 2 or y.shape[1] != len(t):
            raise StatementError(
                f"a trajectory has t of shape {t.shape} and y of shape {y.shape}: give (N,) and (2n, N)."
            )
        if not isinstance(self.status, Status) or not callable(self.dense):
            raise StatementError(
                f"a trajectory has the status {shown(self.status)} and the dense output {shown(self.dense)}: give an "
                "lg.Status and a function of times."
            )
        if not isinstance(self.span, tuple) or len(self.span) != 2:
            raise StatementError(f"a trajectory has the span {shown(self.span)}: give its first and last time.")
        begin, end = self.span
        if not (type(begin) is type(end) is float and math.isfinite(begin) and math.isfinite(end)):
            self._hold("span", (real_number(begin, "span"), real_number(end, "span")))
        if t is not self.t or y is not self.y:
            self._hold("t", t)
            self._hold("y", y)
        for name, value in (("step", self.step), ("rtol", self.rtol), ("atol", self.atol)):
            if value is not None and not (type(value) is float and math.isfinite(value)):
                self._hold(name, real_number(value, f"{name} of a trajectory"))

    def parameters_at(self, times: FloatArray, start: Parameters) -> Parameters:
        """Return the parameters (k, K) at times (K,), one column for each time.

        Return `start`, the parameters at the start of the run, if no event sets parameters.
        """
        times = real_array(times, "times")
        if self.history is None:
            return start
        numbers = segment_numbers(self.history.begins, times, forward=self.span[1] >= self.span[0])
        return np.ascontiguousarray(self.history.values[numbers].T)

    def added_energy(self, times: FloatArray) -> FloatArray:
        """Return the energy (K,) that events added by setting parameters, from the start up to `times` (K,)."""
        times = real_array(times, "times")
        if self.history is None:
            return np.zeros(times.shape)
        return self.history.added[segment_numbers(self.history.begins, times, forward=self.span[1] >= self.span[0])]

    def _hold(self, name: str, value: Any) -> None:
        """Replace the field `name` of this frozen object by its checked `value`."""
        object.__setattr__(self, name, value)


def with_fields(record: Record, **fields: Any) -> Record:
    """Return a copy of a frozen record with new values of some fields. Unlike by `replace`, they are not checked.

    The record must not have cached properties: their values would be copied.
    """
    copy = object.__new__(type(record))
    copy.__dict__.update(record.__dict__, **fields)
    return copy


def run_until(run: Trajectory, end: float) -> Trajectory:
    """Return a run cut at an earlier time `end`, with its outputs and events until then."""
    forward = 1.0 if run.span[1] >= run.span[0] else -1.0
    before = forward * (run.t - end) <= 0
    events = [forward * (times - end) <= 0 for times in run.t_events]
    return replace(
        run,
        t=run.t[before],
        y=run.y[:, before],
        span=(run.span[0], end),
        t_events=tuple(times[rows] for times, rows in zip(run.t_events, events, strict=True)),
        y_events=tuple(states[rows] for states, rows in zip(run.y_events, events, strict=True)),
    )
