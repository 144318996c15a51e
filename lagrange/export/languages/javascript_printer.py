"""Print procedures as functions of JavaScript: numbers, and typed arrays from a place on.

No call makes an object: local arrays and records belong to the file, and a part of an array is the array with the place
where it begins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lagrange.export.braced import BracedPrinter
from lagrange.export.comments import commented
from lagrange.export.languages.javascript_spelling import FUNCTIONS, HELPERS, LITERALS, OPERATORS, RESERVED
from lagrange.export.offset_printer import OffsetPrinter, Place
from lagrange.export.offsets import Shifted
from lagrange.procedure.form import FLAG, Array, Call, Kind, Let, Procedure, Record
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM


@dataclass(frozen=True)
class File:
    """Names and helpers that the functions of one file share.

    `shifted` has the array parameters with an offset. `functions` has the names of all functions, and `lengths`
    those that check the lengths of their array arguments. `memory` collects the declarations of local
    arrays and records by name, and `needed` the operations whose definitions the file needs.
    """

    shifted: Shifted
    public: Sequence[Procedure]
    functions: Sequence[str]
    lengths: Mapping[Procedure, Mapping[str, int]] = field(default_factory=dict)
    memory: dict[str, str] = field(default_factory=dict)
    needed: dict[str, None] = field(default_factory=dict)


def function(procedure: Procedure, file: File) -> str:
    """Return a procedure as a function; what it needs of the file is noted there."""
    return _JavaScriptPrinter(procedure, file).function()


def results_name(procedure: Procedure) -> str:
    """Return the name of the object that takes several results of a procedure."""
    return f"{procedure.name}_results"


class _JavaScriptPrinter(BracedPrinter, OffsetPrinter):
    language = "JavaScript"
    operators = OPERATORS
    literals = LITERALS
    functions = FUNCTIONS
    helpers = HELPERS
    index_type = "let"

    def __init__(self, procedure: Procedure, file: File) -> None:
        self.file = file
        self.offsets: list[str] = []
        super().__init__(procedure, file.needed, (*RESERVED, *map(results_name, procedure.callees)))

    def head(self) -> list[str]:
        public = self.procedure in self.file.public
        given = [self.text(one.ref) for one in self.procedure.parameters]
        given += [f"{one}{' = 0' if public else ''}" for one in self.offsets]
        about = commented(self.procedure.about, "//")
        head = f"{'export ' if public else ''}function {self.procedure.name}({', '.join(given)}) {{"
        lengths = self.file.lengths.get(self.procedure, {}).items()
        return [*about, head, *(f'{self.indent}check_length("{name}", {name}, {least});' for name, least in lengths)]

    def name_parameters(self) -> None:
        super().name_parameters()
        for k, parameter in enumerate(self.procedure.parameters):
            if k in self.file.shifted[self.procedure]:
                self.offsets.append(self.name(-1 - parameter.ref, f"{parameter.name}_at"))
                self.begins(parameter.ref, Place(parameter.ref, (self.offsets[-1],)))

    def operation(self, let: Let) -> tuple[int, str]:
        if let.op in ("real", "whole"):
            (arg,), (level, _) = let.args, self.texts[let.args[0]]
            if self.types[arg] is FLAG:
                return ATOM, f"Number({self.text(arg)})"
            return (level, self.text(arg)) if let.op == "real" else (ATOM, f"Math.trunc({self.text(arg)})")
        return super().operation(let)

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"const {name} = {text};"

    def declare(self, name: str, kind: Kind, text: str) -> str:
        return f"let {name} = {text};"

    def element(self, array: int, place: int) -> str:
        whole, index = self.index(array, place)
        return f"{self.text(whole)}[{index}]"

    def reserve(self, ref: int, array: Array) -> None:
        name = self.memory_name(ref)
        self.file.memory[name] = f"const {name} = new Float64Array({array.length});"

    def reserve_record(self, ref: int, record: Record) -> None:
        name = self.memory_name(ref)
        fields = [one for one, _ in record.fields]
        self.file.memory[name] = f"const {name} = {{ {', '.join(f'{one}: 0' for one in fields)} }};"
        for one in fields:
            self.put(f"{name}.{one} = 0;")

    def memory_name(self, ref: int) -> str:
        """Return the name of a local array or record in the file."""
        stem = self.procedure.names.get(ref, f"x{ref}")
        name = self.name(ref, f"{self.procedure.name}_{stem}")
        while name in self.file.memory or name in self.file.functions:
            name = self.name(ref, f"{name}_{ref}")
        return name

    def call(self, call: Call) -> None:
        callee = call.callee
        assert isinstance(callee, Procedure)
        args = [self.text(self.place_of(arg).array) for arg in call.args]
        args += [self.beginning(arg)[1] or "0" for k, arg in enumerate(call.args) if k in self.file.shifted[callee]]
        made = f"{callee.name}({', '.join(args)})"
        kinds = results_of(self, call)
        if len(kinds) != 1 or call.refs[0] not in self.uses:
            self.write(f"{made};")
        for k, (ref, kind) in enumerate(zip(call.refs, kinds, strict=True)):
            self.types[ref] = kind
            if ref in self.uses:
                self.write(
                    self.define(self.name(ref), kind, made if len(kinds) == 1 else f"{results_name(callee)}.r{k}")
                )

    def leave(self, values: Sequence[int]) -> None:
        if len(values) < 2:
            self.write(f"return {self.text(values[0])};" if values else "return;")
            return
        name = results_name(self.procedure)
        zeros = [f"r{k}: {'false' if kind is FLAG else 0}" for k, kind in enumerate(self.procedure.results)]
        self.file.memory[name] = f"const {name} = {{ {', '.join(zeros)} }};"
        for k, value in enumerate(values):
            self.write(f"{name}.r{k} = {self.text(value)};")
        self.put("return;")
