"""MATLAB and Octave: a file for each function that users call, and one for the test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lagrange.export.descriptions import about_of, places, statement_comment
from lagrange.export.identifiers import LONGEST
from lagrange.export.languages.octave_printer import Names, Public, comment, function, signature, table
from lagrange.export.languages.octave_programs import test_file
from lagrange.export.languages.octave_spelling import HELPERS
from lagrange.export.module import SourceModule
from lagrange.export.target import Target
from lagrange.procedure.form import Procedure


class Octave(Target):
    """MATLAB and Octave; see `Target`."""

    name = "octave"
    about = "MATLAB and Octave: one file for each function, no toolboxes, quantities only"
    contents = frozenset()

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return a file for each function that users call."""
        names = names_of(module)
        prefix = prefix_of(module)
        texts = {f"{prefix}default_parameters": _defaults(module, prefix)}
        for procedure in module.public:
            texts[names.public[procedure].name] = _file(module, procedure, names)
        texts[f"{prefix}test"] = test_file(module, prefix)
        return {f"{name}.m": text for name, text in texts.items()}

    def commands(self, module: SourceModule) -> list[str]:
        """Return what runs the test in Octave."""
        return [f'octave-cli --quiet --no-history --eval "exit({prefix_of(module)}test() > 0)"']


def prefix_of(module: SourceModule) -> str:
    """Return what the names of all functions begin with; it is cut where they would be too long."""
    longest = max(map(len, ("default_parameters", *(one.name for one in module.public))))
    return f"{module.name[: LONGEST - longest - 1]}_"


def names_of(module: SourceModule) -> Names:
    """Return what the functions of a module share."""
    prefix = prefix_of(module)
    public = {one.procedure: Public(prefix + one.name, len(one.results)) for one in module.quantities}
    public[module.prepare] = Public(f"{prefix}prepare", max(module.prepared, 1))
    return Names(public)


def _statement(module: SourceModule) -> list[str]:
    return ["%", *statement_comment(module, "%")]


def _defaults(module: SourceModule, prefix: str) -> str:
    """Return the file with the default parameters."""
    lines = [
        f"function parameters = {prefix}default_parameters()",
        f"% parameters = {prefix}default_parameters(): those of the model, a column.",
        *comment(places("parameters", module.parameters, "{0}({1})", 1)),
        *_statement(module),
        *table("parameters", [[value] for value in module.values]),
        "    parameters = parameters(:);",
        "end",
        "",
    ]
    return "\n".join(lines)


def _file(module: SourceModule, procedure: Procedure, names: Names) -> str:
    """Return the file of a function that users call, behind it those that it alone calls."""
    names.needed.clear()
    local = [one for one in procedure.callees if one not in names.public]
    head, *body = function(procedure, names).splitlines()
    behind = [function(one, names) for one in local]
    lines = [
        head,
        *_about(module, procedure, names),
        *_statement(module),
        *body,
        "",
        *behind,
        *(HELPERS[op][1] for op in sorted(names.needed)),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def _about(module: SourceModule, procedure: Procedure, names: Names) -> Iterator[str]:
    """Yield what a function does and takes."""
    given = dict.fromkeys(one.name for one in procedure.parameters)
    yield f"% {signature(procedure, names)}"
    yield from comment(about_of(module, procedure))
    if procedure is module.prepare:
        yield from comment(places("parameters", module.parameters, "{0}({1})", 1))
    if "y" in given:
        yield from comment(places("y", module.state, "{0}({1})", 1))
    array = "p" if procedure is module.prepare else "out"
    yield from comment(f"singular is true where a matrix is singular to round-off: {array} is NaN then.")
