"""Spelling of the statements of a procedure in a language."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

from lagrange.procedure.form import Array, Call, Kind, Part, Record
from lagrange.procedure.spelling import ATOM, Literals, Operator


class Syntax(ABC):
    """Spelling of a procedure in a language.

    `operators` has the operations that are operators; the others are functions. `literals` prints constants. `greater`
    has the comparisons with operands exchanged, used if the first operand is a constant.
    """

    operators: Mapping[str, Operator]
    literals: Literals
    greater: ClassVar[Mapping[str, str]] = {"less": "{1} > {0}", "less_equal": "{1} >= {0}"}
    indent: ClassVar[str] = "    "
    longest: ClassVar[int] = 63
    """Largest number of significant characters of a name in many languages."""
    widest: ClassVar[int] = 118
    """Longest line in languages that break lines."""
    end_binds: ClassVar[int] = 0
    """Least binding strength of the end of a loop without parentheses."""

    @abstractmethod
    def head(self) -> list[str]:
        """Return the lines before the body; the parameters have names already."""

    def tail(self) -> list[str]:
        """Return the lines after the body."""
        return []

    def broken(self, line: str) -> list[str]:
        """Return a line as several if it is too long for the language."""
        return [line]

    @abstractmethod
    def legal(self, stem: str) -> str:
        """Return a valid name made of a stem; it may be in use."""

    @abstractmethod
    def function_of(self, op: str) -> str:
        """Return the name of the function of an operation that is not an operator."""

    @abstractmethod
    def define(self, name: str, kind: Kind, text: str) -> str:
        """Return the statement that names a value."""

    def declare(self, name: str, kind: Kind, text: str) -> str:
        """Return the statement that declares a variable with its first value."""
        return self.define(name, kind, text)

    @abstractmethod
    def assign(self, target: str, text: str) -> str:
        """Return an assignment."""

    @abstractmethod
    def element(self, array: int, place: int) -> str:
        """Return an element of an array."""

    @abstractmethod
    def reserve(self, ref: int, array: Array) -> None:
        """Print a local array, and choose its name."""

    @abstractmethod
    def reserve_record(self, ref: int, record: Record) -> None:
        """Print a local record of zeros."""

    @abstractmethod
    def part(self, part: Part) -> None:
        """Print or keep the part of an array from an index on."""

    def member(self, record: int, field: str) -> str:
        """Return a field of a record."""
        return f"{self.text(record, ATOM)}.{field}"

    @abstractmethod
    def call(self, call: Call) -> None:
        """Print a call and name its results."""

    @abstractmethod
    def leave(self, values: Sequence[int]) -> None:
        """Print the end of the procedure."""

    @abstractmethod
    def comment(self, text: str) -> str:
        """Return a comment of one line."""

    @abstractmethod
    def opening(self, kind: str, *texts: str) -> str:
        """Return the line that opens a block.

        Its kind is `if` (a condition), `else`, `while` (a condition), `forever`, or `for` (an index, its first value,
        the value that it stays below, its step).
        """

    @abstractmethod
    def closing(self, kind: str) -> str:
        """Return the line that closes a block, or ""; an `else` then follows the `if` directly."""

    @abstractmethod
    def leaving_loop(self) -> str:
        """Return the statement that leaves a loop."""

    def empty(self) -> str:
        """Return the placeholder in a block without statements."""
        return ""

    @abstractmethod
    def partial(self, ref: int, place: str) -> str:
        """Return a partial sum, whose index is a number or the text of an index below four."""

    @abstractmethod
    def modulo(self, index: str) -> str:
        """Return an index modulo four."""

    @abstractmethod
    def text(self, ref: int, least: int = 0) -> str:
        """Return a value as an operand, in parentheses if it binds less tightly than `least`."""
