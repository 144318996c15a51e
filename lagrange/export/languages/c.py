"""Export to C99: header, source file, self-test and run; also the printer that C and JavaScript share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from lagrange.errors import LagrangeError
from lagrange.export.module import (
    TEXT_WIDTH,
    SourceModule,
    about_of,
    ascii_name,
    continued,
    indices,
    outcome_codes,
    places,
    plain,
    records_of,
    sizes,
    statuses,
    wrapped,
)
from lagrange.export.programs import Script, main_text, named_helpers, test_text, words
from lagrange.export.target import Target, register
from lagrange.procedure.form import (
    FLAG,
    PARTIAL,
    REAL,
    WHOLE,
    Array,
    Call,
    Fold,
    Kind,
    Let,
    Part,
    Procedure,
    Record,
    Type,
)
from lagrange.procedure.source_printer import SourcePrinter, results_of
from lagrange.procedure.spelling import ATOM, Literals, Operator
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.statement.vocabulary.functions import ELEMENTARY


class BracedPrinter(SourcePrinter):
    """Prints a procedure as a function in a language with braces, C or JavaScript; subclasses define declarations.

    `index_type` is the type of a loop index. `functions` maps an operation to the name of a function of the language.
    `helpers` maps each other operation to the name and the definition of a function that the file must contain.
    `needed` collects the operations whose definitions the file needs. `taken` are names that variables may not have.
    """

    language: ClassVar[str]
    functions: Mapping[str, str] = {}
    helpers: ClassVar[Mapping[str, tuple[str, str]]]
    index_type: str
    end_binds = COMMON["less"].operands[1]

    def __init__(self, procedure: Procedure, needed: dict[str, None], taken: Iterable[str]) -> None:
        self.needed = needed
        super().__init__(procedure, (*taken, *(name for name, _ in self.helpers.values())))

    def legal(self, stem: str) -> str:
        """Return a legal name of the language for `stem`; another variable may already have this name."""
        return ascii_name(stem)

    def function_of(self, op: str) -> str:
        """Return the name of the function for the operation `op`; if it is a helper function, add `op` to `needed`."""
        if op in self.functions:
            return self.functions[op]
        if op not in self.helpers:
            raise LagrangeError(f"{self.language} has no function for {op}.")
        self.needed[op] = None
        return self.helpers[op][0]

    def tail(self) -> list[str]:
        """Return the lines that end a function, after its body."""
        return ["}"]

    def broken(self, line: str) -> list[str]:
        """Return a line, broken into several if it is long; a comment is not broken."""
        return [line] if line.lstrip().startswith(("//", "/*")) else continued(line)

    def assign(self, target: str, text: str) -> str:
        """Return a statement that assigns the value `text` to the variable `target`."""
        return f"{target} = {text};"

    def comment(self, text: str) -> str:
        """Return a comment of one line."""
        return f"// {text}"

    def opening(self, kind: str, *texts: str) -> str:
        """Return the line that opens a block; `kind` is such as "for", and `texts` are its bounds or condition."""
        match kind, texts:
            case "for", (index, start, stop, step):
                moved = f"{index}++" if step == "1" else f"{index} += {step}"
                return f"for ({self.index_type} {index} = {start}; {index} < {stop}; {moved}) {{"
            case "forever", _:
                return "for (;;) {"
            case "else", _:
                return "} else {"
            case _:
                return f"{kind} ({texts[0]}) {{"

    def closing(self, kind: str) -> str:
        """Return the line that closes a block of the kind `kind`."""
        return "}"

    def leaving_loop(self) -> str:
        """Return the statement that leaves a loop."""
        return "break;"

    def partial(self, ref: int, index: str) -> str:
        """Return the text of one of the four partial sums of the sum number `ref`, which a loop computes.

        `index` is the text of the index of the partial sum, 0 to 3.
        """
        return f"{self.text(ref)}[{index}]"

    def modulo(self, index: str) -> str:
        """Return the text of the expression `index` modulo 4."""
        return f"{index} & {PARTIAL - 1}"


KINDS: Mapping[Kind, str] = {REAL: "double", WHOLE: "int64_t", FLAG: "int"}

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "select": Operator(1, "{0} ? {1} : {2}", (4, 2, 2)),
    "or": COMMON["or"]._replace(operands=(4, 4)),
    "and": COMMON["and"]._replace(operands=(4, 4)),
    "quotient": COMMON["div"],
    "real": Operator(8, "(double){0}", (9,)),
    "whole": Operator(8, "(int64_t){0}", (9,)),
}
"""Operators with precedences. Operands of || and && have extra parentheses, because compilers warn without them."""

LITERALS = Literals("HUGE_VAL", 'nan("")', ("0", "1"))

FUNCTIONS: Mapping[str, str] = {
    **{name: name for name in (*ELEMENTARY, "sqrt", "atan2", "copysign")},
    "abs": "fabs",
    "power": "pow",
    "round": "rint",
}
"""Functions of the C library."""

HELPERS = named_helpers("c")
"""Helper functions for operations that C lacks: name and definition by operation. All return NaN for NaN. Functions
that read bits assume IEEE 754 doubles. Absolute values are compared by their bits; NaN is the largest."""

_CONSTANTS = "E LOG2E LOG10E LN2 LN10 PI PI_2 PI_4 1_PI 2_PI 2_SQRTPI SQRT2 SQRT1_2"
_KINDS = ("", "f", "l", "f32", "f64", "f128", "f32x", "f64x")
_INTEGERS = (
    *(f"{sign}INT{kind}{bits}" for sign in ("", "U") for kind in ("", "_LEAST", "_FAST") for bits in (8, 16, 32, 64)),
    *("INTMAX", "UINTMAX", "INTPTR", "UINTPTR", "PTRDIFF", "SIG_ATOMIC", "SIZE", "WCHAR", "WINT"),
)

RESERVED = (
    *(f"M_{stem}{kind}" for stem in _CONSTANTS.split() for kind in _KINDS),
    *(f"{stem}_{what}" for stem in _INTEGERS for what in ("MAX", "MIN", "WIDTH")),
    *words("c", "macros"),
    *words("c", "reserved"),
)
"""Words that cannot be names of values: keywords, macros, and names of function parameters."""


@dataclass(frozen=True)
class CNames:
    """Names of a module in C: the names of all functions and records begin with `prefix`.

    `needed` collects the operations whose definitions the file needs.
    """

    prefix: str
    needed: dict[str, None] = field(default_factory=dict)

    def definitions(self) -> list[str]:
        """Return the definitions of the helper functions that the file needs."""
        return [f"static {HELPERS[op][1]}\n" for op in sorted(self.needed)]

    def function(self, name: str) -> str:
        """Return the C name of the function `name` of the module."""
        spelled = f"{self.prefix}{name}"
        return f"{spelled}_" if spelled in RESERVED else spelled

    def record(self, record: Record) -> str:
        """Return the name of the C type of a record."""
        return f"{self.prefix}{record.name.lower()}"

    def type_of(self, kind: Type, name: str, *, qualified: bool = True) -> str:
        """Return the C declaration of the parameter `name` of type `kind`; pointers are "restrict" if `qualified`."""
        if isinstance(kind, Kind):
            return f"{KINDS[kind]} {name}"
        restrict = "restrict " if qualified else ""
        if isinstance(kind, Array):
            return f"{'const ' if kind.read else ''}{KINDS[kind.kind]} *{restrict}{name}"
        assert isinstance(kind, Record)
        return f"{self.record(kind)} *{restrict}{name}"

    def result(self, procedure: Procedure) -> str:
        """Return the type that the C function of a procedure returns."""
        if len(procedure.results) > 1:
            return f"{self.function(procedure.name)}_results"
        return KINDS[procedure.numbers[0]] if procedure.results else "void"

    def signature(
        self, procedure: Procedure, names: Sequence[str], *, qualified: bool = True, before: str = ""
    ) -> list[str]:
        """Return the lines of the head of a function: the text `before`, its type, its name and its parameters.

        `names` are the names of the parameters. Pointers are "restrict" if `qualified`.
        """
        declarations = [
            self.type_of(parameter.type, name, qualified=qualified)
            for parameter, name in zip(procedure.parameters, names, strict=True)
        ]
        head = f"{before}{self.result(procedure)} {self.function(procedure.name)}("
        line = f"{head}{', '.join(declarations) or 'void'})"
        return [line] if len(line) <= TEXT_WIDTH else [head, *broken(declarations, "    ", TEXT_WIDTH)]


def broken(parts: Sequence[str], indent: str, width: int) -> list[str]:
    """Return list items, with commas and a closing parenthesis, on indented lines of at most `width` characters."""
    lines, line = [], indent
    for part in [*(f"{part}," for part in parts[:-1]), f"{parts[-1]})"]:
        if len(line) + len(part) > width and line.strip():
            lines.append(line.rstrip())
            line = indent
        line += f"{part} "
    return [*lines, line.rstrip()]


def comment(text: str) -> list[str]:
    """Return a text as the lines of a C comment."""
    first, *rest = wrapped(text, TEXT_WIDTH - 6)
    lines = [f"/* {first}", *(f"   {line}" for line in rest)]
    return [*lines[:-1], f"{lines[-1]} */"]


class _CPrinter(BracedPrinter):
    """Prints a procedure as a C function. `c_names` are the C names of the exported module's functions and types.

    A `hidden` function is static: other C files cannot call it.
    """

    language = "C"
    helpers = HELPERS
    operators = OPERATORS
    literals = LITERALS
    index_type = KINDS[Kind.WHOLE]
    functions = FUNCTIONS

    def __init__(self, procedure: Procedure, c_names: CNames, *, hidden: bool) -> None:
        self.c_names, self.hidden = c_names, hidden
        super().__init__(procedure, c_names.needed, (*RESERVED, *FUNCTIONS.values()))

    def function_name(self, procedure: Procedure) -> str:
        return self.c_names.function(procedure.name)

    def head(self) -> list[str]:
        names = [self.text(parameter.ref) for parameter in self.procedure.parameters]
        *lines, last = self.c_names.signature(self.procedure, names, before="static " if self.hidden else "")
        ignored = [f"{self.indent}(void){self.text(parameter.ref)};" for parameter in self.unused]
        return [*comment(self.procedure.about), *lines, f"{last} {{", *ignored]

    def operation(self, let: Let) -> tuple[int, str]:
        if let.kind is Kind.WHOLE and let.op in ("min", "max"):
            return ATOM, f"{self.function_of(f'{let.op}_whole')}({', '.join(self.text(arg) for arg in let.args)})"
        return super().operation(let)

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"const {KINDS[kind]} {name} = {text};"

    def declare(self, name: str, kind: Kind, text: str) -> str:
        return f"{KINDS[kind]} {name} = {text};"

    def element(self, array: int, index: int) -> str:
        return f"{self.text(array)}[{self.text(index)}]"

    def reserve(self, ref: int, array: Array) -> None:
        self.put(f"{KINDS[array.kind]} {self.name(ref)}[{array.length}];")

    def reserve_record(self, ref: int, record: Record) -> None:
        name = self.name(ref)
        self.put(f"{self.c_names.record(record)} {name}_record = {{0}};")
        self.put(f"{self.c_names.record(record)} *const {name} = &{name}_record;")

    def member(self, record: int, field: str) -> str:
        return f"{self.text(record)}->{field}"

    def part(self, part: Part) -> None:
        array = self.array(part.array)
        const = "const " if array.read else ""
        kind = KINDS[array.kind]
        self.write(
            f"{const}{kind} *const {self.name(part.ref)} = {self.text(part.array)} + {self.text(part.start, 7)};"
        )

    def call(self, call: Call) -> None:
        target = self.function_name(call.callee) if isinstance(call.callee, Procedure) else self.text(call.callee)
        called = f"{target}({', '.join(self.text(arg) for arg in call.args)})"
        kinds = results_of(self, call)
        if len(kinds) > 1:
            whole = f"found{call.refs[0]}"
            self.write(f"const {target}_results {whole} = {called};")
            for k, (ref, kind) in enumerate(zip(call.refs, kinds, strict=True)):
                self.types[ref], self.texts[ref] = kind, (ATOM, f"{whole}.r{k}")
        elif not kinds:
            self.write(f"{called};")
        elif call.refs[0] in self.uses:
            self.types[call.refs[0]] = kinds[0]
            self.settle()
            self.put(self.define(self.name(call.refs[0]), kinds[0], called))
        else:
            self.write(f"(void){called};")

    def leave(self, values: Sequence[int]) -> None:
        if len(values) < 2:
            self.write(f"return {self.text(values[0])};" if values else "return;")
            return
        self.write(f"{self.c_names.result(self.procedure)} results;")
        for k, value in enumerate(values):
            self.put(f"results.r{k} = {self.text(value)};")
        self.put("return results;")

    def comment(self, text: str) -> str:
        return f"/* {text} */"

    def begin_fold(self, fold: Fold) -> None:
        if fold.op != "magnitude":
            super().begin_fold(fold)
            return
        # Compilers take the largest of whole numbers in vectors, but not that of doubles, which may be NaN.
        self.put(self.declare(self.name(fold.ref, f"bits{fold.ref}"), Kind.WHOLE, "0"))

    def folded(self, fold: Fold, index: int) -> tuple[str, str]:
        if fold.op != "magnitude":
            return super().folded(fold, index)
        name, value = self.text(fold.ref), self.text(fold.value)
        return name, f"{self.function_of('max_whole')}({name}, {self.function_of('size_bits')}({value}))"

    def end_fold(self, fold: Fold) -> None:
        if fold.op != "magnitude":
            super().end_fold(fold)
            return
        bits = self.text(fold.ref)
        self.put(self.define(self.name(fold.ref), Kind.REAL, f"{self.function_of('of_bits')}({bits})"))


@register
class C(Target):
    """Target `c`: a header and a source file in C99, a test, and the run of the initial state."""

    name = "c"
    about = "C99: a source file and its header, no dependencies, no allocation, re-entrant"
    contents = frozenset(("steps", "main", "taylor"))
    shell = ("cc -std=c99 -O2 -o {name}_{program} {name}.c {name}_{program}.c -lm", "./{name}_{program}")

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the exported files by file name: header, source, self-test and, if exported, `main`."""
        return {f"{module.name}.h": header(module), f"{module.name}.c": source(module), **programs(module)}


def numbers(values: Sequence[float]) -> str:
    """Return C literals of numbers as one comma-separated list."""
    return ", ".join(map(LITERALS.real, values))


# --- the header


def header(module: SourceModule) -> str:
    """Return the text of the C header: array sizes, indices of states, codes of integrators, and prototypes."""
    c_names, before = CNames(f"{module.name}_"), module.name.upper()
    named = [f"    {before}_{name} = {k}," for name, k in indices(module)]
    codes = [f"    {before}_{name} = {code}, /* {text} */" for name, code, text in outcome_codes()]
    lines = [
        *statement_comment(module),
        "",
        f"#ifndef {before}_H",
        f"#define {before}_H",
        "",
        "#include <stdint.h>",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        *(f"#define {before}_{name.upper()} {count} /* {about} */" for name, count, about in sizes(module)),
        "",
        *comment(places("y", module.state)),
        *comment(places("parameters", module.parameters)),
        *(["enum {", *named, "};"] if named else []),
        *([f"enum {module.name}_outcome {{", *codes, "};"] if module.integrators else []),
        f"extern const double {module.name}_default_parameters[];",
        "",
        *comment(statuses("0", "1")),
        "",
    ]
    for procedure in module.public:
        names = [parameter.name for parameter in procedure.parameters]
        *head, last = c_names.signature(procedure, names, qualified=False)
        lines += [*comment(about_of(module, procedure)), *head, f"{last};", ""]
    return "\n".join([*lines, "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])


def statement_comment(module: SourceModule) -> list[str]:
    """Return the lines of the comment at the top of a file: the statement of the system."""
    lines = [plain(line) for line in module.statement]
    return [f"/* {lines[0]}", *(f"   {line}".rstrip() for line in lines[1:]), "*/"]


# --- the source file


def source(module: SourceModule) -> str:
    """Return the text of the C source file."""
    c_names, public = CNames(f"{module.name}_"), dict.fromkeys(module.public)
    printers = (_CPrinter(procedure, c_names, hidden=procedure not in public) for procedure in module.procedures)
    functions = [printer.function() for printer in printers]
    # C has no empty arrays: without parameters there is one number.
    values = numbers(module.values) or "0.0"
    lines = [
        *statement_comment(module),
        "",
        f'#include "{module.name}.h"',
        "",
        "#include <math.h>",
        *(["#include <string.h>"] if any("memcpy" in HELPERS[op][1] for op in c_names.needed) else []),
        "",
        *c_names.definitions(),
        *records(module.procedures, c_names),
        *continued(f"const double {module.name}_default_parameters[] = {{{values}}};"),
        "",
        *functions,
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def records(procedures: Sequence[Procedure], c_names: CNames) -> Iterator[str]:
    """Yield definitions of C structs: for records, and for results of functions that return several numbers."""
    structures: dict[str, Sequence[tuple[str, Kind]]] = {
        c_names.record(record): record.fields for record in records_of(procedures)
    }
    for procedure in procedures:
        if len(procedure.results) > 1:
            structures[c_names.result(procedure)] = [(f"r{k}", kind) for k, kind in enumerate(procedure.numbers)]
    for name, fields in structures.items():
        declarations = (f"    {KINDS[kind]} {field};" for field, kind in fields)
        yield "\n".join(["typedef struct {", *declarations, f"}} {name};", ""])


# --- the programs


def programs(module: SourceModule) -> dict[str, str]:
    """Return the C sources of the self-test and, if exported, of `main`, by file name."""
    files = {f"{module.name}_test.c": test_text(module, SCRIPT)}
    if module.run is not None:
        text = main_text(module, SCRIPT).splitlines()
        files[f"{module.name}_main.c"] = "\n".join([*(part for line in text for part in continued(line)), ""])
    return files


SCRIPT = Script("c", comment=comment, literals=LITERALS, time="t")
