"""C++17: one source file and its header, in a namespace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from lagrange.export.descriptions import about_of, outcomes, places
from lagrange.export.identifiers import unreserved
from lagrange.export.languages.c import definitions, names_of, statement_comment
from lagrange.export.languages.c_printer import WIDTH, Dialect, broken, comment
from lagrange.export.languages.c_programs import numbers, programs
from lagrange.export.languages.c_spelling import LITERALS, RESERVED
from lagrange.export.lines import continued
from lagrange.export.module import SourceModule
from lagrange.export.programs import compiled
from lagrange.export.target import Target
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Procedure
from lagrange.procedure.spelling import call

WORDS = (
    *("alignas", "alignof", "and", "and_eq", "bitand", "bitor", "catch", "char16_t", "char32_t", "char8_t", "class"),
    *("co_await", "co_return", "co_yield", "compl", "concept", "const_cast", "consteval", "constexpr", "constinit"),
    *("decltype", "delete", "dynamic_cast", "explicit", "export", "friend", "mutable", "namespace", "new", "noexcept"),
    *("not", "not_eq", "nullptr", "operator", "or", "or_eq", "private", "protected", "public", "reinterpret_cast"),
    *("requires", "static_assert", "static_cast", "template", "this", "thread_local", "throw", "try", "typeid"),
    *("typename", "using", "virtual", "wchar_t", "xor", "xor_eq", "std", "lagrange", "default_parameters"),
    *("State", "Parameters", "Prepared", "Run", "Counts", "Taylor_state", "Held", "Outputs"),
)
"""Words of C++ beside those of C, and the names that the namespace has."""

TRANSLATION = (
    (r"\b(fabs|memcpy|printf|fprintf|snprintf|strtod|strtol)\(", r"std::\1("),
    (r"\bint64_t (outcome|k|exponent|smaller_whole|larger_whole|size_bits|a|b|bits)\b", r"std::int64_t \1"),
    (r"\((int|double)\)(\w+)", r"static_cast<\1>(\2)"),
    (r"const int singular", "const bool singular"),
    (r", NULL\b", ", nullptr"),
    (r"main\(void\)", "main()"),
    (r"static const double (\w+)\[\]", r"static constexpr double \1[]"),
    (r"#include <std(io|lib)\.h>", r"#include <cstd\1>"),
)
"""What C++ writes for the C that is the same in every module."""


class Cpp(Target):
    """C++17; see `Target`."""

    name = "cpp"
    about = "C++17: a source file and its header in a namespace, no dependencies, no allocation, re-entrant"
    contents = frozenset(("steps", "main", "taylor"))

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the source file and its header; the test and the run are switched on by macros."""
        return {f"{module.name}.hpp": header(module), f"{module.name}.cpp": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return what compiles and runs the test."""
        return compiled(module, "test", "c++ -std=c++17 -O2", f"{module.name}.cpp")

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return what compiles and runs the initial state."""
        return compiled(module, "main", "c++ -std=c++17 -O2", f"{module.name}.cpp")


def namespace(module: SourceModule) -> str:
    """Return the namespace of a module: a part of its own, so that no function of the library has its name."""
    return f"lagrange::{unreserved(module.name, (*RESERVED, *WORDS))}"


def dialect_of(module: SourceModule) -> Dialect:
    """Return the dialect of a module."""
    return Dialect(
        prefix="",
        public=f"{namespace(module)}::",
        standard="std::",
        zeros="{}",
        restrict="__restrict ",
        no_parameters="",
        pointer=".data()",
        structure=("struct {} {{", "}};"),
        translation=TRANSLATION,
        kinds={REAL: "double", WHOLE: "std::int64_t", FLAG: "bool"},
        literals=replace(LITERALS, flags=("false", "true")),
        casts={
            "real": call("static_cast<double>({0})"),
            "whole": call("static_cast<std::int64_t>({0})"),
        },
        words=(*RESERVED, *WORDS),
    )


def header(module: SourceModule) -> str:
    """Return the header: types, names, prototypes, and functions of arrays that call those of pointers."""
    dialect, guard = dialect_of(module), f"LAGRANGE_{module.name.upper()}_HPP"
    lines = [
        *statement_comment(module),
        "",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <array>",
        "#include <cstdint>",
        "",
        f"namespace {namespace(module)} {{",
        "",
        *comment("Coordinates, then velocities."),
        f"using State = std::array<double, {len(module.state)}>;",
        *comment(places("y", module.state)),
        f"using Parameters = std::array<double, {len(module.parameters)}>;",
        *comment(places("parameters", module.parameters)),
        *comment("Parameters, and what depends on them alone."),
        f"using Prepared = std::array<double, {max(module.prepared, 1)}>;",
        "",
        *continued(f"inline constexpr Parameters default_parameters = {{{numbers(module.values)}}};"),
        "",
        *comment(
            "A function of t, y and p returns whether a matrix is singular to round-off: out is then not to be used."
        ),
        *(comment(outcomes()) if module.integrators else []),
        "",
    ]
    for procedure in module.public:
        *head, last = dialect.signature(procedure, names_of(procedure), qualified=False, before="[[nodiscard]] ")
        lines += [
            *comment(about_of(module, procedure)),
            *head,
            f"{last};",
            *with_arrays(module, procedure, dialect),
            "",
        ]
    return "\n".join([*lines, f"}} // namespace {namespace(module)}", "", "#endif", ""])


def with_arrays(module: SourceModule, procedure: Procedure, dialect: Dialect) -> Iterator[str]:
    """Yield the function that takes arrays of the right lengths in place of pointers."""
    quantity = next((one for one in module.quantities if one.procedure is procedure), None)
    types = {"y": "State", "p": "Prepared", "parameters": "Parameters", "t": "double"}
    if quantity is not None:
        types["out"] = f"std::array<double, {len(quantity.results)}>"
    given, passed = [], []
    for one in procedure.parameters:
        if isinstance(one.type, Array):
            given.append(f"{'const ' if one.type.read else ''}{types[one.name]} &{one.name}")
            passed.append(f"&{one.name}" if one.name == "t" else f"{one.name}.data()")
        else:
            given.append(dialect.type_of(one.type, one.name))
            passed.append(one.name)
    head = f"[[nodiscard]] inline {dialect.result(procedure)} {dialect.function(procedure.name)}("
    line = f"{head}{', '.join(given)})"
    *before, last = [line] if len(line) < WIDTH else [head, *broken(given, "    ", WIDTH)]
    yield from [*before, f"{last} {{"]
    yield f"    return {dialect.function(procedure.name)}({', '.join(passed)});"
    yield "}"


def source(module: SourceModule) -> str:
    """Return the source file."""
    dialect = dialect_of(module)
    functions = definitions(module, dialect)
    lines = [
        *statement_comment(module),
        "",
        f'#include "{module.name}.hpp"',
        "",
        "#include <cmath>",
        *(["#include <cstring>"] if dialect.copies_bits else []),
        "",
        f"namespace {namespace(module)} {{",
        "",
        *functions,
        f"}} // namespace {namespace(module)}",
        "",
        programs(module, dialect),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"
