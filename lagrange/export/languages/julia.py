"""Export to Julia: a module of functions, whose names end with ! because they write to their arguments, and a test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lagrange.export.module import (
    TEXT_WIDTH,
    SourceModule,
    about_of,
    commented,
    distinct,
    indices,
    places,
    sizes,
    statement_comment,
    wrapped,
)
from lagrange.export.programs import Script, helpers, marked, test_text, words
from lagrange.export.straight_line import Language, PrintedFunction, PrintedFunctions
from lagrange.export.target import QUANTITIES, Target, register
from lagrange.procedure.spelling import OPERATORS, Literals, Operator, call
from lagrange.statement.vocabulary.functions import ELEMENTARY

LITERALS = Literals("Inf", "NaN")

HELPERS = {op: f"{text}\n" for op, text in helpers("julia").items()}
"""Helper functions that the file defines. All return NaN for NaN."""

MISSING = ("erf",)  # Elementary functions that Julia does not have

OPERATIONS: Mapping[str, Operator] = {
    **OPERATORS,
    **{op: call(f"{op}({{0}})") for op in ("abs", *ELEMENTARY) if op not in MISSING},
    **{op: call(f"{op}({{0}}, {{1}})") for op in ("min", "max")},
    **{op: call(f"{op}_of({{0}})") for op in HELPERS},
    "atan2": call("atan({0}, {1})"),
    "power": call("power_of({0}, {1})"),
    "select": call("ifelse({0}, {1}, {2})"),
}
"""Templates of operations. `min` and `max` are NaN if an argument is NaN."""

RESERVED = (
    *words("julia", "reserved"),
    *words("julia", "base"),
    *ELEMENTARY,
    *(f"{op}_of" for op in HELPERS),
    *QUANTITIES,
)
"""Words that cannot be names of values: keywords, functions, and names of parameters of functions."""

MODULES = (*words("julia", "library"), *words("julia", "base"), *ELEMENTARY)
"""Words that must not be the module's name: modules of the standard library, and types."""

LANGUAGE = Language(
    name="Julia",
    operations=OPERATIONS,
    literals=LITERALS,
    helpers=HELPERS,
    first=1,
    condition=Operator(5, "{0} != 0.0", (6,)),
    number=call("Float64({0})"),
    matrix="{name} = zeros({rows}, {order})",
    factor="{other} = factored!({order}, {name})",
    solve="{name} = zeros({order})\nsolved!({order}, {other}, [{entries}], {name})",
    needs={"factor": ("sqrt",)},
    reserved=RESERVED,
    entry="{0}[{1}, {2}]",
    loop="for {0} in {1}:{2}",
    back="for {0} in {2}:-1:{1}",
    when="if {0}",
    end_loop="end",
    end_when="end",
    to_index="Int({0})",
    leave="return {0}",
    factored=("function factored!(n, a)", "end"),
    solved=("function solved!(n, a, right, x)", "end"),
)


def source(module: SourceModule) -> str:
    """Return the text of the Julia file: a module with a function for each quantity."""
    functions = PrintedFunctions(module, LANGUAGE)
    size = functions.hoisted.size
    least = {"p": size, "parameters": len(module.parameters)}
    printed = [*_function("prepare!(p, parameters)", module.prepare.about, functions.prepare(), least)]
    for quantity in module.quantities:
        least = {"y": len(module.state), "p": size, "out": len(quantity.results)}
        about = about_of(module, quantity.procedure)
        printed += _function(f"{quantity.name}!(out, t, y, p)", about, functions.quantity(quantity), least)
    lines = [
        *statement_comment(module, "#"),
        "",
        f"module {module_name(module)}",
        "",
        *_constants(module, size),
        "",
        *LANGUAGE.definitions(functions.needed),
        *LANGUAGE.systems(functions.needed),
    ]
    return "\n".join([*lines, *printed, "end", ""])


def _function(head: str, about: str, function: PrintedFunction, least: Mapping[str, int]) -> Iterator[str]:
    """Yield the lines of a Julia function with the name and arguments `head` and the description `about`.

    `least` has the least length of each array argument by name, which the function checks.
    """
    yield from ('"""', f"    {head}", "")
    yield from (line.replace('"', "'").replace("$", "") for line in wrapped(about, TEXT_WIDTH))
    yield from ('"""', f"function {head}")
    for name, size in least.items():
        if size:
            yield f'    length({name}) < {size} && throw(DimensionMismatch("{name} has fewer than {size} numbers"))'
    yield from (f"    {line}" for line in (*function.lines, f"return {function.status}"))
    yield "end"
    yield ""


def _constants(module: SourceModule, prepared: int) -> Iterator[str]:
    """Yield lines with the lengths of all arrays, and the default parameters.

    `prepared` is the length of p, the array of values that depend on parameters alone.
    """
    yield from commented(places("y", module.state, "{0}[{1}]", 1), "#")
    yield from commented(places("parameters", module.parameters, "{0}[{1}]", 1), "#")
    yield from commented(
        "Each function of t, y and p returns whether a matrix is singular to round-off: out is then not to be used.",
        "#",
    )
    yield ""
    for name, count, about in sizes(module, prepared):
        yield f"const {name.upper()}_SIZE = {count} # {about}"
    yield from (f"const {name} = {k}" for name, k in indices(module, 1))
    yield f"const DEFAULT_PARAMETERS = Float64[{', '.join(map(LITERALS.real, module.values))}]"


TEST = Script("julia", comment=marked("#"), literals=LITERALS)


@register
class Julia(Target):
    """Target `julia`: a module, and its test."""

    name = "julia"
    about = "Julia: a module of functions f!(out, t, y, p), no packages, quantities only"
    contents = frozenset()
    inexpressible = frozenset(MISSING)
    shell = ("julia {name}_{program}.jl",)

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the module and of the self-test by file name."""
        test = test_text(module, TEST, module_name=module_name(module))
        return {f"{module.name}.jl": source(module), f"{module.name}_test.jl": test}


def module_name(module: SourceModule) -> str:
    """Return the name of the Julia module in camel case, such as DoublePendulum for double_pendulum."""
    name = "".join(part.capitalize() for part in module.name.split("_"))
    return distinct([name], MODULES)[0]
