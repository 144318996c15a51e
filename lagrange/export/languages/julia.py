"""Julia: a module, a file that tests it, and a file that runs the initial state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lagrange.export.descriptions import about_of, outcomes, places, records_of, run_of, sizes, statement_comment
from lagrange.export.identifiers import distinct, unreserved
from lagrange.export.languages.julia_printer import Names, comment, function, record_type
from lagrange.export.languages.julia_programs import main_file, test_file
from lagrange.export.languages.julia_spelling import HELPERS, KEYWORDS, KINDS, LITERALS, MODULES
from lagrange.export.module import SourceModule
from lagrange.export.target import Target
from lagrange.procedure.form import Record


class Julia(Target):
    """Julia; see `Target`."""

    name = "julia"
    about = "Julia: a module of functions f!(out, t, y, p), no packages"
    inexpressible = frozenset(("erf",))

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the file of the module, and those of its test and of a run."""
        name = module_name(module)
        texts = {f"{module.name}.jl": source(module), f"{module.name}_test.jl": test_file(module, name)}
        if run_of(module) is not None:
            texts[f"{module.name}_main.jl"] = main_file(module, name)
        return texts

    def commands(self, module: SourceModule) -> list[str]:
        """Return what runs the test."""
        return [f"julia {module.name}_test.jl"]

    def run_commands(self, module: SourceModule) -> list[str]:
        """Return what runs the integration of the initial state."""
        return [f"julia {module.name}_main.jl"]


def module_name(module: SourceModule) -> str:
    """Return the name of the Julia module: double_pendulum is DoublePendulum."""
    name = "".join(part.capitalize() for part in module.name.split("_"))
    return distinct([name], (*MODULES, *(record_type(one) for one in records_of(module.procedures))))[0]


def source(module: SourceModule) -> str:
    """Return the file of the module."""
    names = Names({one: about_of(module, one).replace("t[0]", "t[1]") for one in module.public})
    printed = [function(one, names) for one in module.procedures]
    lines = [
        *statement_comment(module, "#"),
        "",
        f"module {module_name(module)}",
        "",
        *_constants(module),
        "",
        *(line for record in records_of(module.procedures) for line in _type(record)),
        *(HELPERS[op][1] for op in sorted(names.needed)),
        *printed,
        "end",
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def _constants(module: SourceModule) -> Iterator[str]:
    """Yield the lengths of all arrays, and the default parameters."""
    yield from comment(places("y", module.state, "{0}[{1}]", 1))
    yield from comment(places("parameters", module.parameters, "{0}[{1}]", 1))
    yield from comment(
        "Each function of t, y and p returns whether a matrix is singular to round-off: out is then not to be used."
    )
    if module.integrators:
        yield from comment(outcomes())
    yield ""
    for name, count, about in sizes(module):
        yield f"const {name.upper()}_SIZE = {count} # {about}"
    yield f"const DEFAULT_PARAMETERS = Float64[{', '.join(map(LITERALS.real, module.values))}]"


def _type(record: Record) -> Iterator[str]:
    """Yield the type of a record of zeros."""
    name = record_type(record)
    yield f"mutable struct {name}"
    for one, kind in record.fields:
        yield f"    {unreserved(one, KEYWORDS)}::{KINDS[kind]}"
    yield f"    {name}() = new({', '.join('0' for _ in record.fields)})"
    yield "end"
    yield ""
