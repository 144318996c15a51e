"""Base class of printers into files for languages with loops, braces and semicolons."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from lagrange.errors import LagrangeError
from lagrange.export.identifiers import ascii_name
from lagrange.export.lines import continued
from lagrange.procedure.form import PARTIAL, Procedure
from lagrange.procedure.source_printer import SourcePrinter


class BracedPrinter(SourcePrinter):
    """Prints one procedure. Subclasses define declarations and calls; `index_type` is the type of a loop index.

    `functions` are the names of the functions that the language has, by operation; `helpers` the names and definitions
    of others. `needed` collects the operations whose definitions the file needs.
    """

    language: ClassVar[str]
    functions: Mapping[str, str] = {}
    helpers: ClassVar[Mapping[str, tuple[str, Any]]]
    index_type: str

    def __init__(self, procedure: Procedure, needed: dict[str, None], taken: Iterable[str]) -> None:
        self.needed = needed
        super().__init__(procedure, (*taken, *(name for name, _ in self.helpers.values())))

    def legal(self, stem: str) -> str:
        """Return a legal name of the language for a stem; it may be taken."""
        return ascii_name(stem)

    def function_of(self, op: str) -> str:
        """Return the name of the function for an operation, and record that the file needs its definition."""
        if op in self.functions:
            return self.functions[op]
        if op not in self.helpers:
            raise LagrangeError(f"{self.language} has no function for {op}.")
        self.needed[op] = None
        return self.helpers[op][0]

    def tail(self) -> list[str]:
        """Return the lines after the body."""
        return ["}"]

    def broken(self, line: str) -> list[str]:
        """Return a line as several where it is long; a comment stays whole."""
        return [line] if line.lstrip().startswith(("//", "/*")) else continued(line)

    def assign(self, target: str, text: str) -> str:
        """Return an assignment."""
        return f"{target} = {text};"

    def comment(self, text: str) -> str:
        """Return a comment of one line."""
        return f"// {text}"

    def opening(self, kind: str, *texts: str) -> str:
        """Return the line that opens a block."""
        match kind, texts:
            case "for", (index, start, stop, step):
                moved = f"{index}++" if step == "1" else f"{index} += {step}"
                return f"for ({self.index_type} {index} = {start}; {index} < {stop}; {moved}) {{"
            case "forever", _:
                return "for (;;) {"
            case "else", _:
                return "} else {"
            case _:
                return f"{kind} ({texts[0]}) {{"

    def closing(self, kind: str) -> str:
        """Return the line that closes a block."""
        return "}"

    def leaving_loop(self) -> str:
        """Return the statement that leaves a loop."""
        return "break;"

    def partial(self, ref: int, place: str) -> str:
        """Return a partial sum."""
        return f"{self.text(ref)}[{place}]"

    def modulo(self, index: str) -> str:
        """Return an index modulo four."""
        return f"{index} & {PARTIAL - 1}"
