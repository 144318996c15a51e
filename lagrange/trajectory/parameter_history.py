"""Parameter values over a run whose events set some."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lagrange.errors import StatementError
from lagrange.machine.backend import FloatArray
from lagrange.statement.number import real_array


@dataclass(frozen=True, eq=False)
class ParameterHistory:
    """The parameters of each segment of a run, from one event that sets parameters to the next.

    `begins` (s,) are the times at which the segments begin, in the direction of the run, and `values` (s, k) their
    parameters in the statement's order. `added` (s,) is the energy that the events before have added to the first.
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
                f"a history has begins {begins.shape}, values {values.shape} and added {added.shape}: give the shapes "
                "(s,), (s, k) and (s,)."
            )

    def segments(self, times: FloatArray, *, forward: bool) -> NDArray[np.intp]:
        """Return the number of the segment at each of some times (K,).

        The later segment begins at the time of an event. Where that time stands twice, as it does among the outputs of
        a run, the first is the state before the event.
        """
        sign = 1.0 if forward else -1.0
        found = np.searchsorted(sign * self.begins[1:], sign * times, side="right")
        before = np.flatnonzero(times[:-1] == times[1:])
        found[before] -= np.isin(times[before], self.begins[1:])
        return found

    def changes(self, names: Sequence[str]) -> list[tuple[float, dict[str, float]]]:
        """Return the begin of each segment but the first, with the new values of parameters, by their `names` (k,)."""
        new = zip(self.begins[1:].tolist(), self.values[1:], self.values[1:] != self.values[:-1], strict=True)
        return [
            (begin, {names[i]: float(row[i]) for i in np.flatnonzero(changed).tolist()}) for begin, row, changed in new
        ]
