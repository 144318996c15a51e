"""Print procedures as functions of Rust.

An array that is written is a slice of cells, so that parts of one array may be read and written in one call without
unsafe code. An array that is only read is of either kind, numbers or cells: the trait `Reals` has both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from lagrange.errors import LagrangeError
from lagrange.export.braced import BracedPrinter
from lagrange.export.comments import commented
from lagrange.export.languages.rust_spelling import HELPERS, KINDS, LIBRARY, LITERALS, OPERATORS, RESERVED
from lagrange.procedure.form import FLAG, REAL, SUMS, Array, Block, Call, Fold, Kind, Let, Part, Procedure
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM

SUFFIX = "_cells"
"""Suffix of the private function of a public one, which takes slices of cells."""


@dataclass(frozen=True)
class File:
    """What the functions of one file share; `needed` collects the operations whose definitions the file needs."""

    public: Sequence[Procedure]
    needed: dict[str, None] = field(default_factory=dict)

    def name(self, procedure: Procedure) -> str:
        """Return the name of the function that works on cells."""
        return f"{procedure.name}{SUFFIX}" if procedure in self.public else procedure.name


def result_type(procedure: Procedure) -> str:
    """Return the results of a function, with the arrow."""
    kinds = [KINDS[kind] for kind in procedure.results]
    if not kinds:
        return ""
    return f" -> {kinds[0]}" if len(kinds) == 1 else f" -> ({', '.join(kinds)})"


def function(procedure: Procedure, file: File) -> str:
    """Return a procedure as a function; what it needs of the file is noted there."""
    return _RustPrinter(procedure, file).function()


class _RustPrinter(BracedPrinter):
    language = "Rust"
    operators = OPERATORS
    literals = LITERALS
    helpers = HELPERS

    def __init__(self, procedure: Procedure, file: File) -> None:
        self.file = file
        self.counts = True
        """Whether the loop that begins uses its index."""
        super().__init__(procedure, file.needed, RESERVED)

    def function_name(self, procedure: Procedure) -> str:
        return self.file.name(procedure)

    def head(self) -> list[str]:
        given: list[str] = []
        types: list[str] = []
        for one in self.procedure.parameters:
            name, kind = self.text(one.ref), one.type
            if isinstance(kind, Array) and kind.read:
                types.append(f"A{len(types)}: Reals + ?Sized")
                given.append(f"{name}: &{types[-1].partition(':')[0]}")
            elif isinstance(kind, Array):
                given.append(f"{name}: &[Cell<f64>]")
            else:
                assert isinstance(kind, Kind)
                given.append(f"{name}: {KINDS[kind]}")
        generic = f"<{', '.join(types)}>" if types else ""
        head = f"fn {self.function_name(self.procedure)}{generic}("
        return [
            *commented(self.procedure.about, "//"),
            head,
            *(f"{self.indent}{one}," for one in given),
            f"){result_type(self.procedure)} {{",
            *(f"{self.indent}let _ = {self.text(one.ref)};" for one in self.unused),
        ]

    def function_of(self, op: str) -> str:
        if op not in LIBRARY:
            return super().function_of(op)
        self.needed[op] = None
        return f"math::{op}"

    def operation(self, let: Let) -> tuple[int, str]:
        kind = let.kind
        if let.op in ("real", "whole") and self.types[let.args[0]] is FLAG:
            of, (one, zero) = self.text(let.args[0]), ("1.0", "0.0") if kind is REAL else ("1", "0")
            return 1, f"if {of} {{ {one} }} else {{ {zero} }}"
        if let.op in ("min", "max") and kind is not REAL:
            return ATOM, f"i64::{let.op}({', '.join(self.text(arg) for arg in let.args)})"
        return super().operation(let)

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"let {name}: {KINDS[kind]} = {text};"

    def declare(self, name: str, kind: Kind, text: str) -> str:
        return f"let mut {name}: {KINDS[kind]} = {text};"

    def assign(self, target: str, text: str) -> str:
        return f"{target[:-6]}.set({text});" if target.endswith(".get()") else f"{target} = {text};"

    def element(self, array: int, place: int) -> str:
        if self.array(array).read:
            return f"{self.text(array)}.at({self.text(place)})"
        at = str(self.constants[place]) if place in self.constants else self.text(place)
        return f"{self.text(array)}[{at}].get()" if place in self.constants else f"cell({self.text(array)}, {at}).get()"

    def part(self, part: Part) -> None:
        held = self.array(part.array)
        text = f"{self.text(part.array)}.part({self.text(part.start)})"
        if not held.read:
            text = f"cells({self.text(part.array)}, {self.text(part.start)})"
        self.write(f"let {self.name(part.ref)} = {text};")

    def reserve(self, ref: int, array: Array) -> None:
        if array.kind is not REAL:
            raise LagrangeError("Rust has no local arrays of whole numbers here.")
        size, name = array.length, self.name(ref)
        self.put(f"let mut {name} = [0.0; {size}];")
        self.put(f"let {name} = Cell::from_mut(&mut {name}[..]).as_slice_of_cells();")

    def call(self, call: Call) -> None:
        callee = call.callee
        assert isinstance(callee, Procedure)
        made = f"{self.function_name(callee)}({', '.join(self.text(arg) for arg in call.args)})"
        kinds = results_of(self, call)
        for ref, kind in zip(call.refs, kinds, strict=True):
            self.types[ref] = kind
        self.settle()
        names = [self.name(ref) if ref in self.uses else "_" for ref in call.refs]
        if not names:
            self.put(f"{made};")
        else:
            held = ", ".join(names)
            self.put(f"let {held if len(names) == 1 else f'({held})'} = {made};")

    def leave(self, values: Sequence[int]) -> None:
        found = ", ".join(self.text(value) for value in values)
        self.write(f"return ({found});" if len(values) > 1 else f"return {found};" if values else "return;")

    def partial(self, ref: int, place: str) -> str:
        return f"cell({self.text(ref)}, {place}).get()"

    def iterations(self, index: int, places: tuple[str, str, str], body: Block, folds: Sequence[Fold]) -> None:
        self.counts = index in self.uses or any(fold.op in SUMS for fold in folds)
        super().iterations(index, places, body, folds)

    def opening(self, kind: str, *texts: str) -> str:
        match kind, texts:
            case "for", (index, start, stop, step):
                places = f"{start}..{stop}" if step == "1" else f"({start}..{stop}).step_by({step})"
                return f"for {index if self.counts else '_'} in {places} {{"
            case "forever", _:
                return "loop {"
            case "else", _:
                return "} else {"
            case _:
                return f"{kind} {texts[0]} {{"
