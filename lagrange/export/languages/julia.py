"""Julia: a module, and a file that tests it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lagrange.export.descriptions import about_of, places, sizes, statement_comment
from lagrange.export.identifiers import distinct
from lagrange.export.languages.julia_printer import Names, comment, function
from lagrange.export.languages.julia_programs import test_file
from lagrange.export.languages.julia_spelling import HELPERS, LITERALS, MODULES
from lagrange.export.module import SourceModule
from lagrange.export.target import Target


class Julia(Target):
    """Julia; see `Target`."""

    name = "julia"
    about = "Julia: a module of functions f!(out, t, y, p), no packages, quantities only"
    contents = frozenset()
    inexpressible = frozenset(("erf",))

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the file of the module, and that of its test."""
        return {
            f"{module.name}.jl": source(module),
            f"{module.name}_test.jl": test_file(module, module_name(module)),
        }

    def commands(self, module: SourceModule) -> list[str]:
        """Return what runs the test."""
        return [f"julia {module.name}_test.jl"]


def module_name(module: SourceModule) -> str:
    """Return the name of the Julia module: double_pendulum is DoublePendulum."""
    name = "".join(part.capitalize() for part in module.name.split("_"))
    return distinct([name], MODULES)[0]


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
    yield ""
    for name, count, about in sizes(module):
        yield f"const {name.upper()}_SIZE = {count} # {about}"
    yield f"const DEFAULT_PARAMETERS = Float64[{', '.join(map(LITERALS.real, module.values))}]"
