"""Export to MATLAB and Octave: a file for each function that users call, and a file for the test.

These languages pass arrays by value, so a function returns the arrays that it computes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lagrange.export.module import (
    LONGEST_NAME,
    SourceModule,
    about_of,
    commented,
    continued,
    number_lines,
    places,
    statement_comment,
)
from lagrange.export.programs import Script, helpers, marked, test_text, words
from lagrange.export.straight_line import Language, PrintedFunction, PrintedFunctions
from lagrange.export.target import Target, register
from lagrange.procedure.spelling import OPERATORS, Literals, Operator, call
from lagrange.statement.vocabulary.functions import ELEMENTARY

LITERALS = Literals("Inf", "NaN")

HELPERS = {op: f"{text}\n" for op, text in helpers("octave").items()}
"""Helper functions that a file defines. All return NaN for NaN."""

OPERATIONS: Mapping[str, Operator] = {
    **OPERATORS,
    **{op: call(f"{op}({{0}})") for op in ("abs", *ELEMENTARY)},
    **{op: call(f"{op}_of({{0}})") for op in HELPERS},
    "atan2": call("atan2({0}, {1})"),
    "power": call("power_of({0}, {1})"),
    "min": call("smaller({0}, {1})"),
    "max": call("larger({0}, {1})"),
    "not": OPERATORS["not"]._replace(text="~{0}"),
    "select": call("pick({0}, {1}, {2})"),
}
"""Templates of operations. Functions of the language that are complex for some real numbers are replaced by helpers."""

RESERVED = (*words("octave", "reserved"), *ELEMENTARY, *(f"{op}_of" for op in HELPERS))
"""Words that cannot be names of values: keywords, functions, and parameters and results of functions."""

LONGEST_LINE = 120  # Largest length of a statement, in characters

LANGUAGE = Language(
    name="Octave",
    operations=OPERATIONS,
    literals=LITERALS,
    helpers=HELPERS,
    define="{name} = {value};",
    store="{name} = {value};",
    element="{0}({1})",
    first=1,
    number=call("double({0})"),
    matrix="{name} = zeros({rows}, {order});",
    factor="[{name}, {other}] = factored({order}, {name});",
    solve="{name} = solved({order}, {other}, [{entries}]);",
    needs={"factor": ("sqrt",)},
    reserved=RESERVED,
    entry="{0}({1}, {2})",
    loop="for {0} = {1}:{2}",
    back="for {0} = {2}:-1:{1}",
    when="if {0}",
    end_loop="end",
    end_when="end",
    leave="singular = {0};",
    factored=("function [a, singular] = factored(n, a)", "end"),
    solved=("function x = solved(n, a, right)\n    x = zeros(n, 1);", "end"),
)


def prefix_of(module: SourceModule) -> str:
    """Return the prefix of the names of all functions, shortened if they would be too long."""
    longest = max(map(len, ("default_parameters", *(quantity.name for quantity in module.quantities))))
    return f"{module.name[: LONGEST_NAME - longest - 1]}_"


def _defaults(module: SourceModule, prefix: str) -> str:
    """Return the text of the file with the default parameters."""
    lines = [
        f"function parameters = {prefix}default_parameters()",
        f"% parameters = {prefix}default_parameters(): those of the model, a column.",
        *commented(places("parameters", module.parameters, "{0}({1})", 1), "%"),
        "%",
        *statement_comment(module, "%"),
        "    parameters = [",
        *number_lines((f"{LITERALS.real(value)};" for value in module.values), " " * 8, end=""),
        "    ];",
        "    parameters = parameters(:);",
        "end",
        "",
    ]
    return "\n".join(lines)


def _text(module: SourceModule, head: str, about: Sequence[str], function: PrintedFunction, size: int) -> str:
    """Return the text of a file: a function that returns an array of `size` numbers, and its helper functions.

    `head` is the head of the function: results, name and arguments. `about` are comments on it.
    """
    array = head[1 : head.index(",")]
    lines = [
        f"function {head}",
        f"% {head}",
        *(line for text in about for line in commented(text, "%")),
        *commented(f"singular is true where a matrix is singular to round-off: {array} is NaN then.", "%"),
        "%",
        *statement_comment(module, "%"),
    ]
    body = [f"{array} = zeros({size}, 1);", *function.lines, f"singular = {function.status};"]
    if function.status != "false":
        body += ["if singular", f"    {array}(:) = NaN;", "end"]
    lines += [f"    {part}" for line in body for part in continued(line, LONGEST_LINE - 4, "...")]
    lines += ["end", "", *LANGUAGE.definitions(function.needed), *LANGUAGE.systems(function.needed)]
    return "\n".join(lines)


TEST = Script("octave", comment=marked("%"), literals=LITERALS, more=" ...", quoted="'{}'".format)


@register
class Octave(Target):
    """Target `octave`: functions for MATLAB and Octave, one file each, and a test."""

    name = "octave"
    about = "MATLAB and Octave: one file for each function, no toolboxes, quantities only"
    contents = frozenset()

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the exported files by file name: one for each function that users call, and the test."""
        prefix, functions = prefix_of(module), PrintedFunctions(module, LANGUAGE)
        about = [module.prepare.about, places("parameters", module.parameters, "{0}({1})", 1)]
        head = f"[p, singular] = {prefix}prepare(parameters)"
        texts = {
            "default_parameters": _defaults(module, prefix),
            "prepare": _text(module, head, about, functions.prepare(), functions.hoisted.size),
        }
        state = places("y", module.state, "{0}({1})", 1)
        for quantity in module.quantities:
            about, head = [about_of(module, quantity.procedure), state], f"{prefix}{quantity.name}(t, y, p)"
            printed = functions.quantity(quantity)
            texts[quantity.name] = _text(module, f"[out, singular] = {head}", about, printed, len(quantity.results))
        texts["test"] = test_text(module, TEST, prefix=prefix)
        return {f"{prefix}{name}.m": f"{text.rstrip()}\n" for name, text in texts.items()}

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs the test in Octave."""
        return [f'octave-cli --quiet --no-history --eval "exit({prefix_of(module)}test() > 0)"']
