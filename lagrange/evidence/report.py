"""The result of a check: printed as a table, true if everything holds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lagrange.statement.notebook_page import ShownAsPage


@dataclass(frozen=True)
class ReportRow:
    """Comparison of one compiled quantity with its reference.

    `error` is the largest error, relative to the magnitude of the terms of the entry. It is infinite if a value is
    missing, and -1 if nothing was compared. `entry` and `point` (1, 2, ...) locate this error; `compiled` and
    `reference` are the two values there. `points` is the number of points compared.
    """

    quantity: str
    error: float
    entry: str
    point: int
    points: int
    compiled: float
    reference: float
    holds: bool

    def cells(self) -> tuple[str, str, str, str, str, str]:
        """Return the texts of the six cells of the table row."""
        where = self.entry, str(self.point) if self.point else "-"
        return self.quantity, f"{self.error:.1e}", *where, str(self.points), "holds" if self.holds else "FAILS"


HEADINGS = ("quantity", "worst error", "entry", "at point", "points", "verdict")


@dataclass(frozen=True, repr=False)
class Report(ShownAsPage):
    """The result of `system.check()`: true if everything holds.

    `rows` has one row per quantity. `points` describes the points used. `outside` counts rejected points by reason: the
    statement has no value or no derivative there. `unexplained` lists points where only one of statement and compiled
    code has a value. `notes` has remarks on gaps. `limit` is the largest accepted error. `seconds` is the
    duration of the check; it is not printed, so that the printed report is the same in every process.
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
        """Sentences on everything that does not hold; empty if everything holds."""
        sentences = []
        if not self.points:
            sentences.append(
                f"no usable point was found: {self._reasons()}. Give an initial state and parameter values at which "
                "the energies have finite values and the mass matrix an inverse."
            )
        sentences.extend(
            f"{row.quantity}, entry {row.entry}: compiled {row.compiled:.17g}, expected {row.reference:.17g} (error "
            f"{row.error:.1e}, limit {self.limit:.1e}) at {self._point(row.point)}"
            for row in self.rows
            if self.limit < row.error < math.inf
        )
        sentences.extend(f"{row.quantity}: nothing could be compared" for row in self.rows if row.error < 0)
        return (*sentences, *self.unexplained)

    def to_dict(self) -> dict[str, Any]:
        """Return the report, its verdict and its failures as plain data that JSON can store."""
        return {**asdict(self), "outside": dict(self.outside), "holds": bool(self), "failures": list(self.failures)}

    def __str__(self) -> str:
        table = [HEADINGS, *(row.cells() for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        padded = [[cell.ljust(width) for cell, width in zip(line, widths, strict=True)] for line in table]
        lines = ["  ".join(line).rstrip() for line in padded]
        lines.insert(1, "-" * len(max(lines, key=len)))
        return "\n".join([self.title(), "", *lines, "", *self.remarks()])

    def __repr__(self) -> str:
        return str(self)

    def __rich__(self) -> Any:
        from rich.console import Group
        from rich.table import Table

        table = Table(*HEADINGS, title=self.title(), title_justify="left")
        for row in self.rows:
            table.add_row(*row.cells(), style=None if row.holds else "bold red")
        return Group(table, *self.remarks())

    def title(self) -> str:
        """Return the title: the system, the target and the number of points."""
        used = f"{len(self.points)} point" + "s" * (len(self.points) != 1)
        return f"check of {self.system} ({self.target}): {used}"

    def remarks(self) -> Sequence[str]:
        """Return the lines after the table: the verdict, the failures, the rejected points and the notes."""
        verdict = "Everything holds." if self else f"{len(self.failures)} found wrong:"
        aside = f"Points put aside, being outside the domain: {self._reasons()}."
        put_aside = [aside] if self.outside and self.points else []
        return [verdict, *(f"  {failure}" for failure in self.failures), *put_aside, *self.notes]

    def _reasons(self) -> str:
        return ", ".join(f"{count} x {reason}" for reason, count in self.outside.items())

    def _point(self, number: int) -> str:
        return self.points[number - 1]
