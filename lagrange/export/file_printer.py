"""Print procedures into a file, with definitions of the operations that the language does not have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from lagrange.errors import LagrangeError
from lagrange.export.identifiers import ascii_name
from lagrange.procedure.form import Procedure, Record
from lagrange.procedure.source_printer import SourcePrinter


class FilePrinter(SourcePrinter):
    """Prints one procedure.

    `functions` are the names of the functions that the language has, by operation; `helpers` the names and definitions
    of others. `needed` collects the operations whose definitions the file needs.
    """

    language: ClassVar[str]
    functions: Mapping[str, str] = {}
    helpers: ClassVar[Mapping[str, tuple[str, Any]]]

    def __init__(self, procedure: Procedure, needed: dict[str, None], taken: Iterable[str]) -> None:
        self.needed = needed
        super().__init__(procedure, (*taken, *(name for name, _ in self.helpers.values())))

    def legal(self, stem: str) -> str:
        """Return a legal name of the language for a stem; it may be taken."""
        return ascii_name(stem)

    def reserve_record(self, ref: int, record: Record) -> None:
        """Raise LagrangeError for a local record, which only integrators have."""
        raise LagrangeError(f"{self.language} has no record {record.name}: integrators are printed in other languages.")

    def function_of(self, op: str) -> str:
        """Return the name of the function for an operation, and record that the file needs its definition."""
        if op in self.functions:
            return self.functions[op]
        if op not in self.helpers:
            raise LagrangeError(f"{self.language} has no function for {op}.")
        self.needed[op] = None
        return self.helpers[op][0]
