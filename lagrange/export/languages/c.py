"""C99: one source file and its header."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.comments import plain
from lagrange.export.descriptions import about_of, outcomes, places, records_of, sizes, statuses
from lagrange.export.languages.c_printer import CNames, comment, function
from lagrange.export.languages.c_programs import numbers, programs
from lagrange.export.languages.c_spelling import KINDS
from lagrange.export.lines import continued
from lagrange.export.module import SourceModule
from lagrange.export.programs import compiled
from lagrange.export.target import Target, register
from lagrange.procedure.form import Kind, Procedure


@register
class C(Target):
    """C99; see `Target`."""

    name = "c"
    about = "C99: a source file and its header, no dependencies, no allocation, re-entrant"
    contents = frozenset(("steps", "main", "taylor"))

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the source file and its header; macros enable the test and the run."""
        return {f"{module.name}.h": header(module), f"{module.name}.c": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell lines that compile and run the test."""
        return compiled(module, "test", "cc -std=c99 -O2", f"{module.name}.c -lm")

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return the shell lines that compile and run `main`."""
        return compiled(module, "main", "cc -std=c99 -O2", f"{module.name}.c -lm")


def names_of(procedure: Procedure) -> list[str]:
    """Return the names of the parameters of a public function."""
    return [one.name for one in procedure.parameters]


# --- the header


def header(module: SourceModule) -> str:
    """Return the header: sizes, names and prototypes."""
    c_names, guard = CNames(f"{module.name}_"), f"{module.name.upper()}_H"
    lines = [
        *statement_comment(module),
        "",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <stdint.h>",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        *defined_sizes(module),
        "",
        *comment(places("y", module.state)),
        *comment(places("parameters", module.parameters)),
        f"extern const double {module.name}_default_parameters[];",
        "",
        *comment(statuses("0", "1")),
        *(comment(outcomes()) if module.integrators else []),
        "",
    ]
    for procedure in module.public:
        *head, last = c_names.signature(procedure, names_of(procedure), qualified=False)
        lines += [*comment(about_of(module, procedure)), *head, f"{last};", ""]
    return "\n".join([*lines, "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])


def defined_sizes(module: SourceModule) -> Iterator[str]:
    """Yield the lengths of all arrays."""
    for name, count, about in sizes(module):
        yield f"#define {module.name.upper()}_{name.upper()} {count} /* {about} */"


def statement_comment(module: SourceModule) -> list[str]:
    """Return the comment at the top: the statement of the system."""
    lines = [plain(line) for line in module.statement]
    return [f"/* {lines[0]}", *(f"   {line}".rstrip() for line in lines[1:]), "*/"]


# --- the source file


def source(module: SourceModule) -> str:
    """Return the source file."""
    c_names = CNames(f"{module.name}_")
    defaults = continued(f"const double {module.name}_default_parameters[] = {{{values(module)}}};")
    functions = definitions(module, c_names, *defaults, "")
    lines = [
        *statement_comment(module),
        "",
        f'#include "{module.name}.h"',
        "",
        "#include <math.h>",
        *(["#include <string.h>"] if c_names.copies_bits else []),
        "",
        *functions,
        programs(module, c_names),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def values(module: SourceModule) -> str:
    """Return the default parameters as a list, "0.0" without any, since C has no empty arrays."""
    return numbers(module.values) or "0.0"


def definitions(module: SourceModule, c_names: CNames, *more: str) -> list[str]:
    """Return the text of helpers, types and all functions; `more` is inserted before the functions."""
    public = dict.fromkeys(module.public)
    functions = [function(one, c_names, hidden=one not in public) for one in module.procedures]
    return [*c_names.definitions(), *records(module.procedures, c_names), *more, *functions]


def records(procedures: Sequence[Procedure], c_names: CNames) -> Iterator[str]:
    """Yield the types of records and of several results."""
    for record in records_of(procedures):
        yield structure(c_names.record(record), record.fields)
    for procedure in procedures:
        if len(procedure.results) > 1:
            results = [(f"r{k}", kind) for k, kind in enumerate(procedure.results)]
            yield structure(c_names.result(procedure), results)


def structure(name: str, fields: Sequence[tuple[str, Kind]]) -> str:
    """Return a type of named numbers."""
    return "\n".join(["typedef struct {", *(f"    {KINDS[kind]} {one};" for one, kind in fields), f"}} {name};", ""])
