"""Print procedures as functions of Julia, the names of which end with ! as they write to their arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lagrange.export.comments import plain, wrapped
from lagrange.export.ended import EndedPrinter
from lagrange.export.languages.julia_spelling import (
    CONVERSIONS,
    FUNCTIONS,
    HELPERS,
    KINDS,
    LITERALS,
    OPERATORS,
    RESERVED,
)
from lagrange.export.offset_printer import written
from lagrange.procedure.form import PARTIAL, Array, Call, Kind, Let, Parameter, Procedure
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM

WIDTH = 110
"""Characters of a line of comment or of a table."""


@dataclass(frozen=True)
class Names:
    """What the functions of a module share: what the public ones do, and the helpers that are needed."""

    abouts: Mapping[Procedure, str]
    needed: dict[str, None] = field(default_factory=dict)


def comment(text: str, indent: str = "") -> list[str]:
    """Return a comment, broken where it is long."""
    return [f"{indent}# {line}".rstrip() for line in wrapped(text, WIDTH)]


def in_order(procedure: Procedure) -> list[Parameter]:
    """Return the parameters as functions of Julia have them: those first that they write to."""
    first = written(procedure)
    return [*first, *(one for one in procedure.parameters if one not in first)]


def signature(procedure: Procedure) -> str:
    """Return how a function is called."""
    return f"{procedure.name}!({', '.join(one.name for one in in_order(procedure))})"


def function(procedure: Procedure, names: Names) -> str:
    """Return a procedure as a function; the helpers that it needs are noted."""
    return _JuliaPrinter(procedure, names).function()


class _JuliaPrinter(EndedPrinter):
    """Prints one procedure."""

    language = "Julia"
    operators = OPERATORS
    literals = LITERALS
    functions = FUNCTIONS
    helpers = HELPERS
    among = "in"

    def __init__(self, procedure: Procedure, names: Names) -> None:
        self.names = names
        super().__init__(procedure, names.needed, RESERVED)

    def function_name(self, procedure: Procedure) -> str:
        return f"{procedure.name}!"

    def head(self) -> list[str]:
        about = self.names.abouts.get(self.procedure)
        given = ", ".join(self.text(one.ref) for one in in_order(self.procedure))
        head = f"function {self.function_name(self.procedure)}({given})"
        if about is None:
            return [*comment(self.procedure.about), head]
        shown = [line.replace('"', "'").replace("$", "") for line in wrapped(about, WIDTH)]
        return ['"""', f"    {signature(self.procedure)}", "", *shown, '"""', head, *self._lengths()]

    def _lengths(self) -> list[str]:
        """Return checks of the lengths of arrays."""
        least = {
            self.text(one.ref): one.type.size
            for one in self.procedure.parameters
            if isinstance(one.type, Array) and one.type.size
        }
        return [
            f'{self.indent}length({name}) < {size} && throw(DimensionMismatch("{name} has fewer than {size} numbers"))'
            for name, size in least.items()
        ]

    def operation(self, let: Let) -> tuple[int, str]:
        special = CONVERSIONS.get((let.op, self.kind(let.args[0])))
        return super().operation(let) if special is None else (ATOM, special.format(self.text(let.args[0])))

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"{name} = {text}"

    def assign(self, target: str, text: str) -> str:
        return f"{target} = {text}"

    def element(self, array: int, place: int) -> str:
        whole, index = self.index(array, place)
        return f"{self.text(whole)}[{index}]"

    def reserve(self, ref: int, array: Array) -> None:
        self.put(f"{self.name(ref)} = zeros({KINDS[array.kind]}, {array.length})")

    def passed(self, ref: int) -> str:
        """Return an argument of a call: the part of an array that begins at a place as a view."""
        if not isinstance(self.types.get(ref), Array):
            return self.text(ref)
        whole, begin = self.beginning(ref)
        name = self.text(whole)
        return name if begin is None else f"view({name}, {begin}:length({name}))"

    def call(self, call: Call) -> None:
        args = list(call.args)
        if isinstance(call.callee, Procedure):
            places = {one.ref: k for k, one in enumerate(call.callee.parameters)}
            args = [call.args[places[one.ref]] for one in in_order(call.callee)]
        target = self.function_name(call.callee) if isinstance(call.callee, Procedure) else self.text(call.callee)
        made = f"{target}({', '.join(self.passed(arg) for arg in args)})"
        self.settle()
        found = []
        for ref, kind in zip(call.refs, results_of(self, call), strict=True):
            self.types[ref] = kind
            found.append(self.name(ref) if ref in self.uses else "_")
        named = any(one != "_" for one in found)
        self.put(f"{', '.join(found)} = {made}" if named else made)

    def leave(self, values: Sequence[int]) -> None:
        self.write(f"return {', '.join(self.text(value) for value in values) or 'nothing'}")

    def comment(self, text: str) -> str:
        return f"# {plain(text)}".rstrip()

    def partial(self, ref: int, place: str) -> str:
        return f"{self.text(ref)}[{self.partial_index(place)}]"

    def modulo(self, index: str) -> str:
        return f"{index} % {PARTIAL}"
