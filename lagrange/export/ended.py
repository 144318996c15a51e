"""Base class of printers for languages whose blocks end with the word `end` and whose indices begin with 1."""

from __future__ import annotations

from typing import ClassVar

from lagrange.export.offset_printer import OffsetPrinter
from lagrange.procedure.form import PARTIAL, REAL, Array


class EndedPrinter(OffsetPrinter):
    """Prints one procedure; `among` is the text between a loop index and its range."""

    first = 1
    among: ClassVar[str]

    def tail(self) -> list[str]:
        """Return the lines after the body."""
        return ["end"]

    def opening(self, kind: str, *texts: str) -> str:
        """Return the line that opens a block."""
        match kind, texts:
            case "for", (index, start, stop, step):
                last = str(int(stop) - 1) if stop.isdigit() else f"{stop} - 1"
                return f"for {index} {self.among} {start}:{'' if step == '1' else f'{step}:'}{last}"
            case "forever", _:
                return "while true"
            case _:
                return " ".join([kind, *texts])

    def closing(self, kind: str) -> str:
        """Return the line that closes a block."""
        return "end"

    def leaving_loop(self) -> str:
        """Return the statement that leaves a loop."""
        return "break"

    def partial_sums(self, ref: int) -> None:
        """Print the four partial sums of a fold, zeros at first, as new arrays are."""
        self.reserve(ref, Array(REAL, PARTIAL))

    def partial_index(self, place: str) -> str:
        """Return the index of a partial sum."""
        return str(int(place) + 1) if place.isdigit() else f"{place} + 1"
