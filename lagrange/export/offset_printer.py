"""Print procedures for languages without subarrays by reference: a subarray is the whole array and an offset."""

from __future__ import annotations

import re
from functools import cached_property
from typing import ClassVar, NamedTuple

from lagrange.export.file_printer import FilePrinter
from lagrange.procedure.form import WHOLE, Array, Parameter, Part, Procedure, Record


class Place(NamedTuple):
    """An index into an array: the sum of some variables, by name, and of a number."""

    array: int
    names: tuple[str, ...] = ()
    number: int = 0


def written(procedure: Procedure) -> list[Parameter]:
    """Return the parameters that a procedure writes to, in order."""
    return [
        one
        for one in procedure.parameters
        if isinstance(one.type, Record) or (isinstance(one.type, Array) and not one.type.read)
    ]


class OffsetPrinter(FilePrinter):
    """Prints one procedure; `first` is the index of the first element of every array."""

    first: ClassVar[int] = 0

    @cached_property
    def _parts(self) -> dict[int, Place]:
        return {}

    def part(self, part: Part) -> None:
        """Record the whole array and the offset of a subarray; print a variable for an offset that is not constant."""
        whole = self.place_of(part.array)
        if part.start in self.constants:
            self._parts[part.ref] = whole._replace(number=whole.number + self.constants[part.start])
            return
        text = self.text(part.start)
        self.write(self.define(self.name(part.ref), WHOLE, text))
        self._parts[part.ref] = whole._replace(names=(*whole.names, self.text(part.ref)))

    def begins(self, array: int, place: Place) -> None:
        """Record the whole array of a subarray, and its offset there."""
        self._parts[array] = place

    def place_of(self, array: int) -> Place:
        """Return the whole array of a subarray with its offset; an array itself has the offset 0."""
        return self._parts.get(array, Place(array))

    def index(self, array: int, place: int) -> tuple[int, str]:
        """Return the whole array of an element, and the text of its index there."""
        begin = self.place_of(array)
        number = begin.number + self.first
        if place in self.constants:
            text, number = "", number + self.constants[place]
        else:
            text = self.whole_text(self.text(place, self.operators["add"].binds))
        return begin.array, summed([*begin.names, *([text] if text else [])], number)

    def beginning(self, array: int) -> tuple[int, str | None]:
        """Return the whole array of a subarray, and the index of its first element, or None if the two begin alike."""
        begin = self.place_of(array)
        if not begin.names and not begin.number:
            return begin.array, None
        return begin.array, summed(begin.names, begin.number + self.first)

    def whole_text(self, text: str) -> str:
        """Return the text of an index as a term of a sum."""
        return text


def summed(terms: list[str] | tuple[str, ...], number: int) -> str:
    """Return a sum of texts and a number, which is merged with a number at the end of the last text."""
    if not terms:
        return str(number)
    *rest, last = terms
    found = re.fullmatch(r"(.*\S) \+ (\d+)", last)
    if found:
        last, number = found.group(1), number + int(found.group(2))
    text = " + ".join([*rest, last])
    return text if number == 0 else f"{text} {'+' if number > 0 else '-'} {abs(number)}"
