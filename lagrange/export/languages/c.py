"""C99: a header with its source file, the self-test and the run of the initial state; C++ reads the header, too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.descriptions import (
    about_of,
    continued,
    indices,
    outcome_codes,
    places,
    plain,
    records_of,
    sizes,
    statuses,
)
from lagrange.export.languages.c_printer import HELPERS, KINDS, LITERALS, CNames, comment, function
from lagrange.export.module import SourceModule
from lagrange.export.programs import Script, main_text, test_text
from lagrange.export.target import Target, register
from lagrange.procedure.form import Kind, Procedure


@register
class C(Target):
    """Target `c`: a header and a source file in C99, a test, and the run of the initial state."""

    name = "c"
    about = "C99: a source file and its header, no dependencies, no allocation, re-entrant"
    contents = frozenset(("steps", "main", "taylor"))
    shell = ("cc -std=c99 -O2 -o {name}_{program} {name}.c {name}_{program}.c -lm", "./{name}_{program}")

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the header, the source file, and the programs for the test and for `main`, by file name."""
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
    functions = [function(procedure, c_names, hidden=procedure not in public) for procedure in module.procedures]
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
    """Return the sources of the self-test, and of `main` if it is exported, by file name."""
    files = {f"{module.name}_test.c": test_text(module, SCRIPT)}
    if module.run is not None:
        text = main_text(module, SCRIPT).splitlines()
        files[f"{module.name}_main.c"] = "\n".join([*(part for line in text for part in continued(line)), ""])
    return files


SCRIPT = Script("c", comment=comment, literals=LITERALS, time="t")
