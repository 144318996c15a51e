"""Parts of a language that printers of procedures need: operators, constants and statements."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from lagrange.procedure.form import FLAG, WHOLE, Array, Call, Kind, Part, Record
from lagrange.procedure.visit import visits

ATOM = 10
"""Binding strength of a name or a call. Operators have lower numbers."""


class Operator(NamedTuple):
    """An operator: its binding strength, its text, and the least binding strength of each operand without parentheses.

    If `operands` is empty, no operand needs parentheses.
    """

    binds: int
    text: str
    operands: tuple[int, ...] = ()

    def applied(self, operand: Callable[[int, int], str], args: Sequence[int]) -> str:
        """Return the text of the operation on operands with the ids `args`.

        `operand(arg, least)` returns the text of an operand, in parentheses if its binding strength is below `least`.
        """
        least = self.operands or (0,) * len(args)
        return self.text.format(*(operand(arg, strength) for arg, strength in zip(args, least, strict=True)))


def call(text: str) -> Operator:
    """Return the operator of a function call, printed from the template `text`. Its arguments need no parentheses."""
    return Operator(ATOM, text)


OPERATORS: Mapping[str, Operator] = {
    "or": Operator(2, "{0} || {1}", (2, 3)),
    "and": Operator(3, "{0} && {1}", (3, 4)),
    "equal": Operator(5, "{0} == {1}", (6, 6)),
    "less": Operator(5, "{0} < {1}", (6, 6)),
    "less_equal": Operator(5, "{0} <= {1}", (6, 6)),
    "add": Operator(6, "{0} + {1}", (6, 7)),
    "sub": Operator(6, "{0} - {1}", (6, 7)),
    "fma": Operator(6, "{0} * {1} + {2}", (7, 8, 7)),
    "fnma": Operator(6, "{2} - {0} * {1}", (7, 8, 6)),
    "mul": Operator(7, "{0} * {1}", (7, 8)),
    "div": Operator(7, "{0} / {1}", (7, 8)),
    "neg": Operator(8, "-{0}", (9,)),
    "not": Operator(8, "!{0}", (9,)),
}
"""Operators that most languages share. A conditional expression has binding strength 1, below all of these."""

WORDS: Mapping[str, Operator] = {
    "or": Operator(2, "{0} or {1}", (2, 3)),
    "and": Operator(3, "{0} and {1}", (3, 4)),
    "not": Operator(4, "not {0}", (4,)),
}
"""Logical operators of languages that use words for them."""


@dataclass(frozen=True)
class Literals:
    """Spelling of constants in a language: infinity, NaN, and the two flags (false, true).

    `signed` is the binding strength of a number with a sign. `whole` and `finite` print an integer and a finite double.
    """

    infinity: str
    nan: str
    flags: tuple[str, str] = ("false", "true")
    signed: int = 8
    whole: Callable[[int], str] = str
    finite: Callable[[float], str] = repr

    def real(self, value: float) -> str:
        """Return the text of a double with all its digits; infinity and NaN have their own spelling."""
        if math.isfinite(value):
            return self.finite(value)
        return self.nan if math.isnan(value) else f"{'-' * (value < 0)}{self.infinity}"

    def spelled(self, kind: Kind, data: Any) -> tuple[int, str]:
        """Return the binding strength of a constant, and its text. `data` is the value of the constant."""
        if kind is FLAG:
            return ATOM, self.flags[bool(data)]
        text = self.whole(data) if kind is WHOLE else self.real(data)
        return (self.signed if text.startswith("-") else ATOM), text


class Syntax(ABC):
    """Base class of printers: how a language spells the parts of a procedure.

    `operators` has the operations that are printed as operators; all other operations are functions. `literals`
    prints constants. `greater` has the spelling of comparisons with exchanged operands, such as b > a for a < b.
    This spelling is used if the first operand is a constant.
    """

    operators: Mapping[str, Operator]
    literals: Literals
    greater: ClassVar[Mapping[str, str]] = {"less": "{1} > {0}", "less_equal": "{1} >= {0}"}
    indent: ClassVar[str] = "    "
    longest: ClassVar[int] = 63
    """Largest number of significant characters of a name in many languages."""
    widest: ClassVar[int] = 118
    """Longest line, in characters, in languages that break lines."""
    end_binds: ClassVar[int] = 0
    """Least binding strength of the end of a loop that needs no parentheses."""

    @abstractmethod
    def head(self) -> list[str]:
        """Return the lines of the function before its body. The names of the parameters are already chosen."""

    def tail(self) -> list[str]:
        """Return the lines of the function after its body."""
        return []

    def broken(self, line: str) -> list[str]:
        """Return a line as several lines if it is too long for the language."""
        return [line]

    @abstractmethod
    def legal(self, stem: str) -> str:
        """Return a valid name of the language that begins with `stem`. Another value may have this name already."""

    @abstractmethod
    def function_of(self, op: str) -> str:
        """Return the name of the function that computes the operation `op`, which is not an operator."""

    @abstractmethod
    def define(self, name: str, kind: Kind, text: str) -> str:
        """Return the statement that defines the value `name` of a kind by the text of an expression."""

    def declare(self, name: str, kind: Kind, text: str) -> str:
        """Return the statement that declares the variable `name` of a kind. `text` is its first value."""
        return self.define(name, kind, text)

    @abstractmethod
    def assign(self, target: str, text: str) -> str:
        """Return the statement that assigns the text of a value to a target."""

    @abstractmethod
    def element(self, array: int, index: int) -> str:
        """Return the text of the element at an index of an array. `array` and `index` are ids."""

    @abstractmethod
    def reserve(self, ref: int, array: Array) -> None:
        """Print the declaration of a local array, and choose its name."""

    @abstractmethod
    def reserve_record(self, ref: int, record: Record) -> None:
        """Print the declaration of a local record of zeros, and choose its name."""

    @abstractmethod
    def part(self, part: Part) -> None:
        """Print the definition of a part of an array. A language may keep its text until its use instead."""

    def member(self, record: int, field: str) -> str:
        """Return the text of a field of a record."""
        return f"{self.text(record, ATOM)}.{field}"

    @visits(Call)
    @abstractmethod
    def call(self, call: Call) -> None:
        """Print a call and name its results."""

    @abstractmethod
    def leave(self, values: Sequence[int]) -> None:
        """Print the return from the procedure with results."""

    @abstractmethod
    def comment(self, text: str) -> str:
        """Return the text as a comment of one line."""

    @abstractmethod
    def opening(self, kind: str, *texts: str) -> str:
        """Return the line that opens a block.

        The kind of the block is `if` (texts: a condition), `else`, `while` (a condition), `forever`, or `for` (an
        index, its first value, its upper bound, which is excluded, and its step).
        """

    @abstractmethod
    def closing(self, kind: str) -> str:
        """Return the line that closes a block of the given kind, or "" if no line is needed.

        After "" for an `if`, its `else` follows directly.
        """

    @abstractmethod
    def leaving_loop(self) -> str:
        """Return the statement that leaves a loop."""

    def empty(self) -> str:
        """Return the placeholder statement for a block without statements."""
        return ""

    @abstractmethod
    def partial(self, ref: int, index: str) -> str:
        """Return the text of a partial sum of the reduction with the id `ref`.

        `index` is the text of its index, 0 to 3.
        """

    @abstractmethod
    def modulo(self, index: str) -> str:
        """Return the text of an index modulo four."""

    @abstractmethod
    def text(self, ref: int, least: int = 0) -> str:
        """Return the text of a value as an operand, in parentheses if its binding strength is below `least`."""
