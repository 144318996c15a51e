"""Hold compiled numbers against reference entries, and remember the worst of each kind."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagrange.errors import RunError
from lagrange.evidence.reference import Entries
from lagrange.evidence.report import Row
from lagrange.evidence.sample import Point
from lagrange.machine.model import Model

LIMIT = 2e-12
"""Largest error that holds, relative to an entry's size: some 10,000 roundings."""

TINY = 1e-290
"""Absolute error that holds anywhere: below it doubles lose their digits one by one."""

LANES = 11
"""Columns of a batch that is held against single evaluations: more than one vector's width, and an odd rest."""


@dataclass
class _Tally:
    """The worst that was seen of one quantity; -1 where nothing was."""

    error: float = -1.0
    entry: str = "-"
    point: int = 0
    points: int = 0
    compiled: float = 0.0
    reference: float = 0.0


class Comparison:
    """Running tallies, one per row of the report."""

    def __init__(self, names: Sequence[str], rows: Sequence[str]) -> None:
        self.names = names
        self.unexplained: list[str] = []
        self._tallies = {row: _Tally() for row in rows}
        self._seen: dict[str, set[int]] = {row: set() for row in rows}
        self._said: set[str] = set()
        self._place = ""
        self._number = 0

    def start(self, point: Point, number: int) -> None:
        """Say at which point the next comparisons are; 0 for one outside the domain."""
        self._place = point.describe(self.names)
        self._number = number

    def add(self, row: str, labels: Sequence[str], values: Sequence[float], part: Entries) -> None:
        """Compare values entry by entry."""
        tally = self._tallies[row]
        self._seen[row].add(self._number)
        tally.points = len(self._seen[row])
        for label, value, expected, error, size in zip(labels, values, part.value, part.error, part.size, strict=True):
            if not (is_finite(value) and is_finite(expected)):
                if is_finite(value) or is_finite(expected):
                    self._add_broken(row, label, value)
                continue
            off = abs(expected - value)
            relative = relative_error(off, size, error)
            if relative > tally.error:
                tally.error = relative
                tally.entry, tally.point = label, self._number
                tally.compiled, tally.reference = float(value), float(expected)

    def report_unexplained(self, sentence: str) -> None:
        """Note a failure at the present point."""
        self.unexplained.append(f"{sentence}, at {self._place}")

    def rows(self) -> tuple[Row, ...]:
        """Return the table."""
        return tuple(
            Row(
                quantity=row,
                error=tally.error,
                entry=tally.entry,
                point=tally.point,
                points=tally.points,
                compiled=tally.compiled,
                reference=tally.reference,
                holds=0.0 <= tally.error <= LIMIT,
            )
            for row, tally in self._tallies.items()
        )

    def _add_broken(self, row: str, label: str, value: float) -> None:
        if row not in self._said:
            self._said.add(row)
            self.report_unexplained(f"{row}, entry {label}: the statement has a value, the compiled code gives {value}")


def relative_error(off: Any, size: Any, uncertainty: Any) -> float:
    """Return an absolute error relative to the entry's size, and to what the reference itself leaves open.

    The latter counts ten times and as if it were just within the limit, so that one number tells the verdict.
    """
    return float(off / (size + (10 * uncertainty + TINY) / LIMIT))


def is_finite(value: Any) -> bool:
    """Return whether a Python, NumPy or mpmath number is finite."""
    return math.isfinite(value) if isinstance(value, float) else bool(abs(value) < math.inf)


def entry_labels(name: str, names: Sequence[str], columns: Sequence[int]) -> list[str]:
    """Return what each entry of a quantity is called, in the order of `computed`."""
    n = len(names)
    if name in ("lagrangian", "energy"):
        return [name]
    if name == "mass_matrix":
        return [f"{a}, {b}" for a in names for b in names]
    if name == "jacobian":
        variables = [*names, *(f"{a}_dot" for a in names)]
        return [f"d {a}_ddot / d {variables[j]}" for j in columns for a in names]
    return list(names) if n else []


def computed(model: Model, name: str, point: Point, columns: Sequence[int]) -> Iterator[list[float]]:
    """Yield the compiled entries of a quantity in a row, once for each way in which the model gives them.

    What the model refuses with a RunError counts as not a number.
    """
    arguments = np.array(point.q), np.array(point.v), point.t, point.parameters
    if name == "jacobian":
        yield _jacobian(model, point, columns)
        return
    length = {"lagrangian": 1, "energy": 1, "mass_matrix": len(point.q) ** 2}.get(name, len(point.q))
    try:
        yield [float(x) for x in np.ravel(model.evaluate(name, *arguments))]
        if name == "accelerations":
            yield accelerations_of(model, point)
            yield _lower_rates(model, point)
    except RunError:
        yield [math.nan] * length


def accelerations_of(model: Model, point: Point) -> list[float]:
    """Return the accelerations, not numbers where the model refuses."""
    try:
        a = model.accelerations(np.array(point.q), np.array(point.v), point.t, point.parameters)
    except RunError:
        return [math.nan] * len(point.q)
    return [float(x) for x in a]


def _lower_rates(model: Model, point: Point) -> list[float]:
    """Return the lower half of the right-hand side; the upper must be v and spoils everything if it is not."""
    n = len(point.q)
    rates = model.rhs(point.t, np.array([*point.q, *point.v]), point.parameters)
    return [float(x) if np.array_equal(rates[:n], point.v) else math.nan for x in rates[n:]]


def _jacobian(model: Model, point: Point, columns: Sequence[int]) -> list[float]:
    """Return those columns' lower halves; the upper half must be (0 1) and spoils everything if it is not."""
    n = len(point.q)
    try:
        whole = model.jacobian(point.t, np.array([*point.q, *point.v]), point.parameters)
    except RunError:
        return [math.nan] * (n * len(columns))
    if not np.array_equal(whole[:n], np.eye(n, 2 * n, n)):
        return [math.nan] * (n * len(columns))
    return [float(whole[n + i, j]) for j in columns for i in range(n)]


def batch_of(
    model: Model, name: str, point: Point, columns: Sequence[int]
) -> Iterator[tuple[list[float], list[float]]]:
    """Yield pairs of a batch's column and the single evaluation of the same state, near the point."""
    near = [_beside(point, 1e-6 * k) for k in range(LANES)]
    singles = [list(computed(model, name, beside, columns))[-1] for beside in near]
    q, v = (np.array([getattr(beside, part) for beside in near]).T for part in ("q", "v"))
    t = np.array([beside.t for beside in near])
    try:
        if name in ("jacobian", "accelerations"):
            y = np.concatenate([q, v])
            function = model.jacobian if name == "jacobian" else model.rhs
            block = function(t, y, point.parameters)[len(point.q) :]
            block = np.moveaxis(block[:, list(columns)], 0, 1) if name == "jacobian" else block
        else:
            block = np.asarray(model.evaluate(name, q, v, t, point.parameters))
    except RunError:
        block = np.full((len(singles[0]), LANES), math.nan)
    lanes = block.reshape(-1, LANES)
    for k, single in enumerate(singles):
        yield [float(x) for x in lanes[:, k]], single


def _beside(point: Point, shift: float) -> Point:
    """Return a point off by a relative shift, so that no two lanes of a batch hold the same numbers."""
    q, v = (tuple(x * (1.0 + shift) for x in values) for values in (point.q, point.v))
    return Point(q, v, point.t * (1.0 + shift), point.parameters, point.kind)
