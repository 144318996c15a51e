"""Export to JavaScript: an ES module for browsers and node, its test, and the run. Web pages use it, too."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from lagrange.export.languages.c import OPERATORS as C_OPERATORS
from lagrange.export.languages.c import BracedPrinter
from lagrange.export.module import (
    SourceModule,
    about_of,
    columns,
    commented,
    continued,
    indices,
    lengths,
    outcome_codes,
    places,
    sizes,
    statement_comment,
    statuses,
)
from lagrange.export.programs import Script, filled, main_text, marked, named_helpers, test_text, words
from lagrange.export.target import Target, register
from lagrange.procedure.form import FLAG, WHOLE, Array, Block, Call, Kind, Let, Part, Procedure, Record, calls, inner
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM, Literals, Operator
from lagrange.statement.vocabulary.functions import ELEMENTARY

OPERATORS: Mapping[str, Operator] = {
    **C_OPERATORS,
    "equal": C_OPERATORS["equal"]._replace(text="{0} === {1}"),
    "quotient": Operator(ATOM, "Math.trunc({0} / {1})", C_OPERATORS["div"].operands),
}

LITERALS = Literals("Infinity", "NaN")

MISSING = ("erf",)  # Elementary functions that JavaScript does not have

_MATH = ("abs", "sqrt", "atan2", "min", "max", "sign")
FUNCTIONS: Mapping[str, str] = {name: f"Math.{name}" for name in (*_MATH, *ELEMENTARY) if name not in MISSING}
"""Functions of JavaScript by operation. They return NaN or infinity outside of their domain."""

_BITS = "const bits = new DataView(new ArrayBuffer(8));"

HELPERS = named_helpers("javascript")
"""Helper functions for operations that JavaScript lacks: name and definition."""


def helper_lines(ops: Mapping[str, None]) -> list[str]:
    """Return the definitions of the helper functions that the operations `ops` need."""
    lines = [_BITS, ""] if any("bits." in HELPERS[op][1] for op in ops) else []
    return [*lines, *(line for op in sorted(ops) for line in (*HELPERS[op][1].splitlines(), ""))]


RESERVED = tuple(words("javascript", "reserved"))
"""Words that cannot be names of values: keywords, names that the file uses, and parameters of functions."""

Shifted = Mapping[Procedure, frozenset[int]]
"""Indices of the array parameters of each procedure for which the caller also passes an offset into the array."""


def shifted_parameters(procedures: Sequence[Procedure], always: Shifted) -> Shifted:
    """Return for each procedure the indices of the array parameters for which callers also pass an offset.

    A parameter needs an offset if some call passes a subarray, or if it is in `always`. `procedures` has callees before
    their callers.
    """
    shifted = {procedure: always.get(procedure, frozenset[int]()) for procedure in procedures}
    for caller in reversed(procedures):
        own_refs = [parameter.ref for index, parameter in enumerate(caller.parameters) if index in shifted[caller]]
        moved = frozenset((*own_refs, *(part.ref for part in _parts(caller.body))))
        for call in calls(caller.body):
            if isinstance(call.callee, Procedure):
                shifted[call.callee] |= {index for index, arg in enumerate(call.args) if arg in moved}
    return shifted


def _parts(block: Block) -> Iterator[Part]:
    for statement in block:
        if isinstance(statement, Part):
            yield statement
        for body in inner(statement):
            yield from _parts(body)


class Place(NamedTuple):
    """Begin of a subarray: its offset in the whole array is the sum of the variables `names` and of `number`.

    `array` is the number of the whole array in the procedure.
    """

    array: int
    names: tuple[str, ...] = ()
    number: int = 0


@dataclass(frozen=True)
class File:
    """Data that the functions of an exported file share: names, array lengths, local memory, and helper functions.

    - `shifted` has for each procedure the indices of its array parameters with an offset.
    - `public` are the procedures that users call, and `functions` the names of all functions.
    - `lengths` has the checked lengths of array arguments, for procedures that check them.
    - `memory` collects the declarations of local arrays and records by name.
    - `needed` collects the operations whose definitions the file needs.
    """

    shifted: Shifted
    public: Sequence[Procedure]
    functions: Sequence[str]
    lengths: Mapping[Procedure, Mapping[str, int]] = field(default_factory=dict)
    memory: dict[str, str] = field(default_factory=dict)
    needed: dict[str, None] = field(default_factory=dict)


def results_name(procedure: Procedure) -> str:
    """Return the name of the object into which a procedure with several results writes them."""
    return f"{procedure.name}_results"


class _JavaScriptPrinter(BracedPrinter):
    language = "JavaScript"
    operators = OPERATORS
    literals = LITERALS
    functions = FUNCTIONS
    helpers = HELPERS
    index_type = "let"

    def __init__(self, procedure: Procedure, file: File) -> None:
        self.file = file
        self.offsets: list[str] = []
        self.places: dict[int, Place] = {}
        super().__init__(procedure, file.needed, (*RESERVED, *map(results_name, procedure.callees)))

    def head(self) -> list[str]:
        public = self.procedure in self.file.public
        texts = [self.text(parameter.ref) for parameter in self.procedure.parameters]
        texts += [f"{parameter}{' = 0' if public else ''}" for parameter in self.offsets]
        about = commented(self.procedure.about, "//")
        head = f"{'export ' if public else ''}function {self.procedure.name}({', '.join(texts)}) {{"
        lengths = self.file.lengths.get(self.procedure, {}).items()
        return [*about, head, *(f'{self.indent}check_length("{name}", {name}, {least});' for name, least in lengths)]

    def name_parameters(self) -> None:
        super().name_parameters()
        for k, parameter in enumerate(self.procedure.parameters):
            if k in self.file.shifted[self.procedure]:
                self.offsets.append(self.name(-1 - parameter.ref, f"{parameter.name}_at"))
                self.places[parameter.ref] = Place(parameter.ref, (self.offsets[-1],))

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

    def element(self, array: int, index: int) -> str:
        begin, terms = self.place_of(array), tuple[str, ...]()
        if index not in self.constants:
            terms = (self.text(index, self.operators["add"].binds),)
        subscript = summed((*begin.names, *terms), begin.number + self.constants.get(index, 0))
        return f"{self.text(begin.array)}[{subscript}]"

    def reserve(self, ref: int, array: Array) -> None:
        name = self.memory_name(ref)
        self.file.memory[name] = f"const {name} = new Float64Array({array.length});"

    def reserve_record(self, ref: int, record: Record) -> None:
        name = self.memory_name(ref)
        fields = [field for field, _ in record.fields]
        self.file.memory[name] = f"const {name} = {{ {', '.join(f'{field}: 0' for field in fields)} }};"
        for name_of_field in fields:
            self.put(f"{name}.{name_of_field} = 0;")

    def memory_name(self, ref: int) -> str:
        """Return a name for the local array or record number `ref`, which differs from all other names in the file."""
        stem = self.procedure.names.get(ref, f"x{ref}")
        name = self.name(ref, f"{self.procedure.name}_{stem}")
        while name in self.file.memory or name in self.file.functions:
            name = self.name(ref, f"{name}_{ref}")
        return name

    def call(self, call: Call) -> None:
        callee = call.callee
        assert isinstance(callee, Procedure)
        subarrays = [self.place_of(arg) for arg in call.args]
        args = [self.text(subarray.array) for subarray in subarrays]
        args += [
            summed(subarray.names, subarray.number)
            for k, subarray in enumerate(subarrays)
            if k in self.file.shifted[callee]
        ]
        called = f"{callee.name}({', '.join(args)})"
        kinds = results_of(self, call)
        if len(kinds) != 1 or call.refs[0] not in self.uses:
            self.write(f"{called};")
        for k, (ref, kind) in enumerate(zip(call.refs, kinds, strict=True)):
            self.types[ref] = kind
            if ref in self.uses:
                self.write(
                    self.define(self.name(ref), kind, called if len(kinds) == 1 else f"{results_name(callee)}.r{k}")
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

    def part(self, part: Part) -> None:
        """Record the whole array and the offset of a subarray; an offset that is not constant becomes a variable."""
        whole = self.place_of(part.array)
        if part.start in self.constants:
            self.places[part.ref] = whole._replace(number=whole.number + self.constants[part.start])
            return
        text = self.text(part.start)
        self.write(self.define(self.name(part.ref), WHOLE, text))
        self.places[part.ref] = whole._replace(names=(*whole.names, self.text(part.ref)))

    def place_of(self, array: int) -> Place:
        """Return the whole array of a subarray, and its offset in the whole array; 0 for a whole array."""
        return self.places.get(array, Place(array))


def summed(terms: tuple[str, ...], number: int) -> str:
    """Return the text of a sum of terms and a whole number: ("i", "j + 1") and 2 give "i + j + 3"."""
    if not terms:
        return str(number)
    *rest, last = terms
    match = re.fullmatch(r"(.*\S) \+ (\d+)", last)
    if match:
        last, number = match.group(1), number + int(match.group(2))
    text = " + ".join([*rest, last])
    return text if number == 0 else f"{text} {'+' if number > 0 else '-'} {abs(number)}"


@register
class JavaScript(Target):
    """Target `javascript`: an ES module, its test, and the run of the initial state."""

    name = "javascript"
    about = "JavaScript: one ES module for browsers and node, no dependencies, calls that allocate nothing"
    inexpressible = frozenset(MISSING)
    shell = ("node {name}_{program}.mjs",)

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the exported files by file name: the module, the self-test and, if exported, `main`."""
        texts = {f"{module.name}.mjs": source(module), f"{module.name}_test.mjs": test_text(module, SCRIPT)}
        if module.run is not None:
            text = main_text(module, SCRIPT, head=json.dumps(columns(module))).splitlines()
            texts[f"{module.name}_main.mjs"] = "\n".join([*(part for line in text for part in continued(line)), ""])
        return texts


def source(module: SourceModule) -> str:
    """Return the text of the JavaScript module.

    Functions that are called once per run check the lengths of arrays. The functions of quantities do not, because the
    checks would take 3% of their time.
    """
    quantities = [quantity.procedure for quantity in module.quantities]
    # Users may pass an offset for y and out of each quantity.
    names = {quantity: [parameter.name for parameter in quantity.parameters] for quantity in quantities}
    shifted = {
        quantity: frozenset((names[quantity].index("y"), names[quantity].index("out"))) for quantity in quantities
    }
    file = File(
        shifted_parameters(module.procedures, shifted),
        module.public,
        [quantity.name for quantity in module.procedures],
        {quantity: lengths(module, quantity) for quantity in module.public if quantity not in quantities},
    )
    functions = [_JavaScriptPrinter(procedure, file).function() for procedure in module.procedures]
    lines = [
        *statement_comment(module, "//"),
        "",
        *constants(module),
        "",
        *filled("javascript", "check_length").splitlines(),
        "",
        *helper_lines(file.needed),
        *(["// Local arrays and records: calls make none."] if file.memory else []),
        *(line for declaration in file.memory.values() for line in continued(declaration)),
        *([""] if file.memory else []),
        *functions,
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def constants(module: SourceModule) -> Iterator[str]:
    """Yield the lines at the top of the module: array sizes, names, defaults, and comments on functions."""
    for name, count, about in sizes(module):
        yield f"export const {name.upper()} = {count}; // {about}"
    yield ""
    yield from commented(places("y", module.state), "//")
    yield from commented(places("parameters", module.parameters), "//")
    for name, names in (("state_names", module.state), ("parameter_names", module.parameters)):
        yield from continued(f"export const {name} = Object.freeze({json.dumps(list(names))});")
    yield from (f"export const {name} = {k};" for name, k in indices(module))
    values = ", ".join(map(LITERALS.real, module.values))
    yield from continued(f"export const default_parameters = Object.freeze([{values}]);")
    yield ""
    yield from commented(
        f"{statuses('false', 'true')} Arrays are Float64Array. y_at and out_at are the places where state and results "
        "begin. Where an array of such a function is too short, results are NaN or missing.",
        "//",
    )
    if module.integrators:
        yield "// The codes that integrators return:"
        codes = (f"    {name}: {code}, // {text}" for name, code, text in outcome_codes())
        yield from ("export const OUTCOMES = Object.freeze({", *codes, "});")
    for procedure in module.public:
        arguments = ", ".join(parameter.name for parameter in procedure.parameters)
        yield from commented(f"{procedure.name}({arguments}): {about_of(module, procedure)}", "//")


SCRIPT = Script("javascript", comment=marked("//"), literals=LITERALS, time="[{0}]")
