"""Print procedures as functions of MATLAB and Octave, where arrays are values: what a function writes it returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lagrange.errors import LagrangeError
from lagrange.export.comments import plain, wrapped
from lagrange.export.ended import EndedPrinter
from lagrange.export.languages.octave_spelling import (
    CONVERSIONS,
    FUNCTIONS,
    HELPERS,
    LITERALS,
    OPERATORS,
    RESERVED,
)
from lagrange.export.lines import continued
from lagrange.export.offset_printer import written
from lagrange.procedure.form import PARTIAL, Array, Call, Kind, Let, Parameter, Procedure
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM

WIDTH, LONGEST_LINE = 110, 120
"""Characters of a line of comment or of a table, and those of a statement."""

SINGULAR = "singular"
"""The result of every public function: whether a matrix is singular."""


@dataclass(frozen=True)
class Public:
    """A function that users call: its name, and the length of the array that it makes."""

    name: str
    made: int


@dataclass(frozen=True)
class Names:
    """What the functions of a module share: the public ones, and the helpers that the file at hand needs."""

    public: Mapping[Procedure, Public]
    needed: dict[str, None] = field(default_factory=dict)


def comment(text: str, indent: str = "") -> list[str]:
    """Return a comment, broken where it is long."""
    return [f"{indent}% {line}".rstrip() for line in wrapped(text, WIDTH)]


def short(line: str) -> list[str]:
    """Return a statement or a comment on lines that are short enough."""
    if line.lstrip().startswith("%"):
        return comment(line.lstrip()[1:].strip(), " " * (len(line) - len(line.lstrip())))
    return continued(line, LONGEST_LINE, "...")


def table(name: str, rows: Sequence[Sequence[float]], indent: str = "    ") -> list[str]:
    """Return a matrix, whose rows go on where a line ends with dots."""
    lines = [f"{indent}{name} = ["]
    for row in rows:
        line = indent * 2
        for k, value in enumerate(row):
            text = f"{LITERALS.real(value)}{', ' if k < len(row) - 1 else ''}"
            if len(line) + len(text) > WIDTH:
                lines.append(f"{line}...")
                line = indent * 3
            line += text
        lines.append(line)
    return [*lines, f"{indent}];"]


def given_to(procedure: Procedure, names: Names) -> list[Parameter]:
    """Return the parameters of a function: all but the array that it makes."""
    public = names.public.get(procedure)
    if public is None:
        return list(procedure.parameters)
    return [one for one in procedure.parameters if one not in written(procedure)]


def signature(procedure: Procedure, names: Names) -> str:
    """Return how a public function is called."""
    results = [*(one.name for one in written(procedure)), SINGULAR]
    given = ", ".join(one.name for one in given_to(procedure, names))
    return f"[{', '.join(results)}] = {names.public[procedure].name}({given})"


def function(procedure: Procedure, names: Names) -> str:
    """Return a procedure as a function; the helpers that it needs are noted."""
    return _OctavePrinter(procedure, names).function()


class _OctavePrinter(EndedPrinter):
    """Prints one procedure."""

    language = "Octave"
    operators = OPERATORS
    literals = LITERALS
    functions = FUNCTIONS
    helpers = HELPERS
    among = "="

    def __init__(self, procedure: Procedure, names: Names) -> None:
        self.names = names
        self.public = names.public.get(procedure)
        super().__init__(procedure, names.needed, RESERVED)
        self.found = self._result_names()

    def broken(self, line: str) -> list[str]:
        return short(line)

    def _result_names(self) -> list[str]:
        if self.public is not None:
            return [SINGULAR]
        return [self.name(-1 - k, f"found{k or ''}") for k in range(len(self.procedure.results))]

    def function_name(self, procedure: Procedure) -> str:
        public = self.names.public.get(procedure)
        return procedure.name if public is None else public.name

    def head(self) -> list[str]:
        if self.lines and self.lines[-1] == f"{self.indent}return":
            self.lines.pop()
        results = [*(self.text(one.ref) for one in written(self.procedure)), *self.found]
        given = ", ".join(
            "~" if one in self.unused and one not in written(self.procedure) else self.text(one.ref)
            for one in given_to(self.procedure, self.names)
        )
        lines = [f"function [{', '.join(results)}] = {self.function_name(self.procedure)}({given})"]
        if self.public is None:
            return [*lines, *comment(self.procedure.about, self.indent)]
        return [*lines, f"{self.indent}{results[0]} = zeros({self.public.made}, 1);"]

    def operation(self, let: Let) -> tuple[int, str]:
        special = CONVERSIONS.get((let.op, self.kind(let.args[0])))
        if special == "{0}":
            least = self.texts[let.args[0]][0]
            return least, self.text(let.args[0], least)
        if special is not None:
            return ATOM, special.format(self.text(let.args[0]))
        if let.op == "select":
            self.function_of("select")
        return super().operation(let)

    def folded(self, fold: Any, index: int) -> tuple[str, str]:
        if fold.op == "most":
            self.function_of("select")
        return super().folded(fold, index)

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"{name} = {text};"

    def assign(self, target: str, text: str) -> str:
        return f"{target} = {text};"

    def element(self, array: int, place: int) -> str:
        whole, index = self.index(array, place)
        return f"{self.text(whole)}({index})"

    def reserve(self, ref: int, array: Array) -> None:
        self.put(f"{self.name(ref)} = zeros({array.length}, 1);")

    def passed(self, ref: int) -> str:
        """Return an argument of a call: the part of an array that begins at a place by its numbers."""
        if not isinstance(self.types.get(ref), Array):
            return self.text(ref)
        whole, begin = self.beginning(ref)
        return self.text(whole) if begin is None else f"{self.text(whole)}({begin}:end)"

    def call(self, call: Call) -> None:
        if not isinstance(call.callee, Procedure):
            raise LagrangeError(f"{self.procedure.name} calls a function that is given, which has no name.")
        public, changed = self.names.public.get(call.callee), written(call.callee)
        taken = given_to(call.callee, self.names)
        pairs = list(zip(call.callee.parameters, call.args, strict=True))
        given = [self.passed(ref) for one, ref in pairs if one in taken]
        targets = [self._target(ref, public) for one, ref in pairs if one in changed]
        self._check_apart([self.place_of(ref).array for one, ref in pairs if one in changed])
        self.settle()
        for ref, kind in zip(call.refs, results_of(self, call), strict=True):
            self.types[ref] = kind
            targets.append(self.name(ref) if ref in self.uses else "~")
        while targets and targets[-1] == "~":
            targets.pop()
        left = f"[{', '.join(targets)}] = " if len(targets) > 1 else f"{targets[0]} = " if targets else ""
        self.put(f"{left}{self.function_name(call.callee)}({', '.join(given)});")

    def _target(self, ref: int, public: Public | None) -> str:
        """Return where an array goes that a call returns."""
        if public is None:
            return self.passed(ref)
        whole, begin = self.beginning(ref)
        return f"{self.text(whole)}({begin or 1}:{_last(begin or '1', public.made)})"

    def _check_apart(self, arrays: Sequence[int]) -> None:
        if len(dict.fromkeys(arrays)) < len(arrays):
            raise LagrangeError(f"{self.procedure.name} gives two parts of one array to a function that writes both.")

    def leave(self, values: Sequence[int]) -> None:
        texts = [self.text(value) for value in values]
        self.settle()
        for name, text in zip(self.found, texts, strict=True):
            self.put(self.assign(name, text))
        if self.public is not None and texts != ["false"]:
            array = self.text(written(self.procedure)[0].ref)
            if texts != ["true"]:
                self.put(f"if {SINGULAR}")
            self.put(f"{self.indent * (texts != ['true'])}{array}(:) = NaN;")
            if texts != ["true"]:
                self.put("end")
        self.put("return")

    def comment(self, text: str) -> str:
        return f"% {plain(text)}".rstrip()

    def partial(self, ref: int, place: str) -> str:
        return f"{self.text(ref)}({self.partial_index(place)})"

    def modulo(self, index: str) -> str:
        return f"mod({index}, {PARTIAL})"


def _last(begin: str, count: int) -> str:
    """Return the last of so many places from a first one on."""
    if begin.isdigit():
        return str(int(begin) + count - 1)
    return f"{begin} + {count - 1}"
