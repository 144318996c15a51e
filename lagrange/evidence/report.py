"""The report of `system.check()`: comparison of compiled values with reference values, and the printed table.

For each quantity it has the largest error of its entries, and the limit for this error. A report is true if all
quantities are right.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lagrange.errors import RunError
from lagrange.evidence.differences import Numbers
from lagrange.evidence.precise import OutsideDomain
from lagrange.machine.backend import FloatArray
from lagrange.machine.model import Model
from lagrange.statement.display import ShownAsPage, text_table
from lagrange.statement.random_states import SamplePoint
from lagrange.statement.statement import Statement


@dataclass(frozen=True)
class ReportRow:
    """Comparison of one compiled quantity, such as the mass matrix, with its reference values.

    `error` is the largest error, relative to the magnitude of the terms of the entry. It is infinite if a value is
    missing, and -1 if nothing was compared. `entry` and `point` (1, 2, ...) are the entry and the point with the
    largest error; `compiled` and `reference` are its two values. `points` is the number of points compared.
    """

    quantity: str
    error: float = -1.0
    entry: str = "-"
    point: int = 0
    points: int = 0
    compiled: float = 0.0
    reference: float = 0.0
    holds: bool = False

    def cells(self) -> tuple[str, str, str, str, str, str]:
        """Return the texts of the six cells of this row in the printed table."""
        where = self.entry, str(self.point) if self.point else "-"
        return self.quantity, f"{self.error:.1e}", *where, str(self.points), "holds" if self.holds else "FAILS"


HEADINGS = ("quantity", "worst error", "entry", "at point", "points", "verdict")


@dataclass(frozen=True, repr=False)
class Report(ShownAsPage):
    """The result of `system.check()`; it is true if all quantities are right.

    - `rows` has one row per quantity.
    - `points` describes the points used.
    - `outside` counts rejected points by reason; at such points the statement has no value or no derivative.
    - `unexplained` lists points at which either only the statement or only the compiled code has a value.
    - `notes` are remarks on what was not checked.
    - `limit` is the largest accepted error.
    - `seconds` is the duration of the check. It is not printed, so that the printed report is the same in every
      process.
    """

    system: str
    target: str
    rows: tuple[ReportRow, ...]
    points: tuple[str, ...]
    outside: Mapping[str, int]
    unexplained: tuple[str, ...]
    notes: tuple[str, ...]
    limit: float
    seconds: float

    def __bool__(self) -> bool:
        return not self.failures

    @property
    def failures(self) -> tuple[str, ...]:
        """Sentences on all quantities that are wrong or could not be compared; empty if all are right."""
        sentences = []
        if not self.points:
            sentences.append(
                f"no usable point was found: {self._reasons()}. Give an initial state and parameter values at which "
                "the energies have finite values and the mass matrix an inverse."
            )
        sentences.extend(
            f"{row.quantity}, entry {row.entry}: compiled {row.compiled:.17g}, expected {row.reference:.17g} (error "
            f"{row.error:.1e}, limit {self.limit:.1e}) at {self.points[row.point - 1]}"
            for row in self.rows
            if self.limit < row.error < math.inf
        )
        sentences.extend(f"{row.quantity}: nothing could be compared" for row in self.rows if row.error < 0)
        return (*sentences, *self.unexplained)

    def to_dict(self) -> dict[str, Any]:
        """Return the report, its verdict and its failures as plain data that JSON can store."""
        return {**asdict(self), "outside": dict(self.outside), "holds": bool(self), "failures": list(self.failures)}

    def __str__(self) -> str:
        table = text_table(HEADINGS, [row.cells() for row in self.rows])
        return "\n".join([self.title(), "", table, "", *self.remarks()])

    def __repr__(self) -> str:
        return str(self)

    def title(self) -> str:
        """Return the title of the report: the system, the target of the compiled code and the number of points."""
        used = f"{len(self.points)} point" + "s" * (len(self.points) != 1)
        return f"check of {self.system} ({self.target}): {used}"

    def remarks(self) -> Sequence[str]:
        """Return the lines after the table: the verdict, the failures, the rejected points and the notes."""
        verdict = "Everything holds." if self else f"{len(self.failures)} found wrong:"
        aside = f"Points left out because they are outside the domain: {self._reasons()}."
        put_aside = [aside] if self.outside and self.points else []
        return [verdict, *(f"  {failure}" for failure in self.failures), *put_aside, *self.notes]

    def _reasons(self) -> str:
        return ", ".join(f"{count} x {reason}" for reason, count in self.outside.items())


class Direction(NamedTuple):
    """A direction in the space of states (q, v), along which the mass matrix and the Jacobian are compared.

    `weights` are the 2n entries of the direction. `mass` is the compiled mass matrix (n, n) at the point, which may be
    wrong.
    """

    weights: Sequence[float]
    mass: FloatArray


Columns = Sequence[int] | Direction
"""Indices of columns of the Jacobian, or a direction."""


SMOOTHNESS = 1e-14
"""Largest error of the numerical derivatives, relative to the size of an entry, at a usable point."""


@dataclass(frozen=True)
class ReferenceEntries:
    """Reference values of the entries of one quantity, flattened, with error bounds and sizes.

    `error` bounds the errors of the numerical differentiation that gave `value`. `size` is the magnitude of the
    terms of each entry; `lagrange.evidence.reference` defines it.
    """

    value: Numbers
    error: Numbers
    size: Numbers

    @cached_property
    def doubles(self) -> tuple[FloatArray, FloatArray]:
        """The nearest double of each value, and the remainder of the value as another double."""
        near = [float(x) for x in self.value]
        return np.array(near), np.array([float(x - y) if x else 0.0 for x, y in zip(self.value, near, strict=True)])

    @cached_property
    def allowance(self) -> tuple[FloatArray, FloatArray]:
        """The sizes and the error bounds of the entries, as two arrays of doubles."""
        return np.array([float(x) for x in self.size]), np.array([float(x) for x in self.error])

    def part(self, start: int, length: int) -> ReferenceEntries:
        """Return the `length` reference values from the index `start` on, with their error bounds and sizes."""
        where = slice(start, start + length)
        return ReferenceEntries(self.value[where], self.error[where], self.size[where])

    def __add__(self, other: ReferenceEntries) -> ReferenceEntries:
        return ReferenceEntries(self.value + other.value, self.error + other.error, self.size + other.size)

    def around(self, values: Sequence[Any] | FloatArray) -> ReferenceEntries:
        """Return entries with other `values`, which are exact, and with the sizes of the present entries."""
        entries, zeros = ReferenceEntries(list(values), [0.0] * len(self.size), self.size), np.zeros(len(self.size))
        # Reuse the sizes: their conversion takes 0.1 s for a mass matrix of 86,000 entries.
        entries.__dict__["allowance"] = self.allowance[0], zeros
        if isinstance(values, np.ndarray):
            entries.__dict__["doubles"] = values, zeros
        return entries

    def check_smooth(self) -> None:
        """Raise OutsideDomain if the differences did not converge, because of a kink or a jump within the steps."""
        least = max(filter(None, self.size), default=0) * SMOOTHNESS
        pairs = zip(self.error, self.size, strict=True)
        if any(error > SMOOTHNESS * (size + least) for error, size in pairs if error):
            raise OutsideDomain("the energies have no derivative here")


LIMIT = 2e-12
"""Largest accepted error, relative to the size of an entry: about 10,000 roundings.

The largest error of correct code was 1e-14, in a batch of 30-link chains. It was 4e-15 in the scenes, and in 41 small
systems with 10 seeds each.
"""

TINY_ERROR = 1e-290
"""Absolute error that is always accepted, since smaller doubles lose digits (subnormal numbers)."""

LANES = 11
"""Number of states in a batch that is compared with single evaluations: odd, and above the width of registers."""


class Comparison:
    """Collects the comparisons of a check: the largest error of each row of the report, and failures.

    `names` are the coordinates, and `rows` the names of the rows. Values that cannot be compared are recorded as
    failures.
    """

    def __init__(self, names: Sequence[str], rows: Sequence[str]) -> None:
        self.names = names
        self.unexplained: list[str] = []
        self._rows = {row: ReportRow(row) for row in rows}
        self._seen: dict[str, set[int]] = {row: set() for row in rows}
        self._said: set[str] = set()
        self._place = ""
        self._number = 0

    def start(self, point: SamplePoint, number: int) -> None:
        """Set the sample point of the next comparisons. `number` counts points from 1; it is 0 outside the domain."""
        self._place = point.describe(self.names)
        self._number = number

    def add(
        self, row: str, labels: Sequence[str], values: Sequence[float] | FloatArray, part: ReferenceEntries
    ) -> None:
        """Compare compiled `values` with the reference entries `part`, and update the largest error of the row `row`.

        `labels` are the names of the entries.
        """
        self._seen[row].add(self._number)
        error = self._rows[row].error
        compiled, near, rest = np.asarray(values, dtype=float), *part.doubles
        with np.errstate(all="ignore"):
            relative = relative_error(np.abs((near - compiled) + rest), *part.allowance)
        finite = np.isfinite(compiled), np.isfinite(near)
        for i in map(int, np.flatnonzero(finite[0] != finite[1])):
            error = math.inf
            if row not in self._said:
                self._said.add(row)
                sentence = f"entry {labels[i]}: the statement has a value, the compiled code gives {values[i]}"
                self.report_unexplained(f"{row}, {sentence}")
        relative[~(finite[0] & finite[1])] = -1.0
        self._rows[row] = replace(self._rows[row], error=error, points=len(self._seen[row]))
        worst = int(np.argmax(relative)) if relative.size else -1
        if worst >= 0 and relative[worst] > error:
            self._rows[row] = replace(
                self._rows[row],
                error=float(relative[worst]),
                entry=labels[worst],
                point=self._number,
                compiled=float(values[worst]),
                reference=float(part.value[worst]),
            )

    def report_unexplained(self, sentence: str) -> None:
        """Record a failure at the present sample point; `sentence` describes it."""
        self.unexplained.append(f"{sentence}, at {self._place}")

    def rows(self) -> tuple[ReportRow, ...]:
        """Return the rows of the report, one for each compared quantity."""
        return tuple(replace(row, holds=0.0 <= row.error <= LIMIT) for row in self._rows.values())


def relative_error(off: Any, size: Any, uncertainty: Any) -> Any:
    """Return the error `off` of an entry, relative to its `size`; an entry is right if this is at most LIMIT.

    Ten times the `uncertainty` of the reference value are accepted in addition.
    """
    return off / (size + (10 * uncertainty + TINY_ERROR) / LIMIT)


def entry_labels(name: str, statement: Statement, columns: Columns) -> list[str]:
    """Return the names of the entries of the quantity `name`, in the order of the array from `computed`.

    `columns` are the indices of the compared columns of the Jacobian, or the direction along which it is compared.
    """
    names, constraints = statement.names, [constraint.name for constraint in statement.constraints]
    velocities = [f"{a}_dot" for a in names]
    rates = [*velocities, *(f"{a}_ddot" for a in names)]
    match name:
        case "lagrangian" | "energy":
            return [name]
        case "mass_matrix" if not isinstance(columns, Direction):
            return [f"{a}, {b}" for a in names for b in names]
        case "rhs":
            return rates
        case "jacobian":
            if isinstance(columns, Direction):
                return [f"change of {rate}" for rate in rates]
            variables = [*names, *velocities]
            return [f"d {rate} / d {variables[j]}" for j in columns for rate in rates]
        case "constraints":
            return [*constraints, *(f"rate of {constraint}" for constraint in constraints)]
        case "constraint_gradient" | "constraint_forces":
            return [f"{constraint}, {a}" for constraint in constraints for a in names]
        case "constraint_bias" | "multipliers":
            return constraints
    return list(names)


def computed(model: Model, name: str, point: SamplePoint, columns: Columns) -> FloatArray:
    """Return the compiled entries of the quantity `name` at a point, flattened.

    All entries are NaN if the model raises RunError. `columns` are the indices of the columns of the Jacobian to
    return, or a direction: then the mass matrix and the Jacobian are multiplied by it.
    """
    q, v = np.array(point.q), np.array(point.v)
    try:
        block = _evaluate(model, name, q, v, point.t, point.parameters, columns)
    except RunError:
        return np.full(len(entry_labels(name, model.statement, columns)), math.nan)
    return np.ravel(block).astype(float)


def computed_batch(
    model: Model, name: str, point: SamplePoint, columns: Columns
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield (entries from a batch, entries from a single evaluation) for each of `LANES` states near the point.

    `name` is the quantity, and `columns` are the indices of the columns of the Jacobian to return, or a direction.
    """
    near = []
    for factor in (1.0 + 1e-6 * k for k in range(LANES)):
        q, v = (tuple(x * factor for x in values) for values in (point.q, point.v))
        near.append(replace(point, q=q, v=v, t=point.t * factor))
    singles = [computed(model, name, shifted, columns) for shifted in near]
    qs, vs = (np.array([getattr(shifted, part) for shifted in near]).T for part in ("q", "v"))
    t = np.array([shifted.t for shifted in near])
    try:
        block = _evaluate(model, name, qs, vs, t, point.parameters, columns)
    except RunError:
        block = np.full((len(singles[0]), LANES), math.nan)
    lanes = block.reshape(-1, LANES)
    for k, single in enumerate(singles):
        yield lanes[:, k], single


def _evaluate(
    model: Model, name: str, q: Any, v: Any, t: Any, parameters: Mapping[Any, float], columns: Columns
) -> Any:
    """Return the entries of the quantity `name`, computed by its compiled function, as an array.

    For a batch, `q`, `v` and the result have a last axis for the states. `columns` are the indices of the columns of
    the Jacobian to return. If it is a direction, the Jacobian is multiplied by it, and the mass matrix by its
    velocities.
    """
    if name == "rhs":
        return model.called(model.kernel("rhs"), t, np.concatenate([q, v]), parameters)
    if name == "jacobian":
        whole = model.jacobian(t, np.concatenate([q, v]), parameters)
        if isinstance(columns, Direction):
            return np.tensordot(whole, columns.weights, axes=(1, 0))
        return np.moveaxis(whole[:, list(columns)], 0, 1)
    entries = np.asarray(model.evaluate(name, q, v, t, parameters))
    if name == "mass_matrix" and isinstance(columns, Direction):
        return np.tensordot(entries, columns.weights[len(q) :], axes=(1, 0))
    return entries
