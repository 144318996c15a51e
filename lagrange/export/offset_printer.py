"""Print procedures for languages in which a part of an array is no array: it is the array itself, from a place on."""

from __future__ import annotations

import re
from functools import cached_property
from typing import ClassVar, NamedTuple

from lagrange.export.file_printer import FilePrinter
from lagrange.procedure.form import WHOLE, Array, Parameter, Part, Procedure, Record


class Place(NamedTuple):
    """A place in an array: the sum of some names, and of a number."""

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
        """Keep where a part begins."""
        whole = self.place_of(part.array)
        if part.start in self.constants:
            self._parts[part.ref] = whole._replace(number=whole.number + self.constants[part.start])
            return
        text = self.text(part.start)
        self.write(self.define(self.name(part.ref), WHOLE, text))
        self._parts[part.ref] = whole._replace(names=(*whole.names, self.text(part.ref)))

    def begins(self, array: int, place: Place) -> None:
        """Say where an array begins."""
        self._parts[array] = place

    def place_of(self, array: int) -> Place:
        """Return where an array begins that may be a part of another."""
        return self._parts.get(array, Place(array))

    def index(self, array: int, place: int) -> tuple[int, str]:
        """Return the whole array that an element is in, and its index there."""
        begin = self.place_of(array)
        number = begin.number + self.first
        if place in self.constants:
            text, number = "", number + self.constants[place]
        else:
            text = self.whole_text(self.text(place, self.operators["add"].binds))
        return begin.array, summed([*begin.names, *([text] if text else [])], number)

    def beginning(self, array: int) -> tuple[int, str | None]:
        """Return the whole array that an array is in, and the index at which it begins, None at the first one."""
        begin = self.place_of(array)
        if not begin.names and not begin.number:
            return begin.array, None
        return begin.array, summed(begin.names, begin.number + self.first)

    def whole_text(self, text: str) -> str:
        """Return an index as it stands in a sum."""
        return text


def summed(terms: list[str] | tuple[str, ...], number: int) -> str:
    """Return a sum of texts and a number, which is added to one that ends the last of them."""
    if not terms:
        return str(number)
    *rest, last = terms
    found = re.fullmatch(r"(.*\S) \+ (\d+)", last)
    if found:
        last, number = found.group(1), number + int(found.group(2))
    text = " + ".join([*rest, last])
    return text if number == 0 else f"{text} {'+' if number > 0 else '-'} {abs(number)}"
