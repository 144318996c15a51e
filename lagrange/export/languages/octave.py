"""MATLAB and Octave: a file for each function that users call, and one for the test.

Arrays are passed by value: a function returns the arrays that it computes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.descriptions import (
    LONGEST_NAME,
    about_of,
    commented,
    continued,
    number_lines,
    places,
    statement_comment,
)
from lagrange.export.module import SourceModule
from lagrange.export.programs import Script, marked, test_text
from lagrange.export.straight_line import Language, PrintedFunction, PrintedFunctions
from lagrange.export.target import Target, register
from lagrange.procedure.spelling import OPERATORS, Literals, Operator, call
from lagrange.statement.vocabulary.elementary import ELEMENTARY

LITERALS = Literals("Inf", "NaN")


def _helper(head: str, text: str) -> str:
    """Return the text of an Octave function with the head `head`; its body, `text`, sets the result r."""
    return "\n".join([f"function r = {head}", *(f"    {line}" for line in text.splitlines()), "end", ""])


def _real(name: str, outside: str) -> str:
    """Return the text of a helper function of x: NaN if the condition `outside` holds, else the function `name` of x.

    Under that condition Octave's function has complex values.
    """
    return _helper(f"{name}_of(x)", f"if {outside}\n    r = NaN;\nelse\n    r = {name}(x);\nend")


def _choice(head: str, condition: str) -> str:
    return _helper(head, f"if {condition}\n    r = a;\nelse\n    r = b;\nend")


HELPERS: Mapping[str, str] = {
    **{name: _real(name, "x < 0") for name in ("sqrt", "log")},
    **{name: _real(name, "abs(x) > 1") for name in ("asin", "acos", "atanh")},
    "acosh": _real("acosh", "x < 1"),
    "power": _helper(
        "power_of(x, y)",
        "if x < 0 && isfinite(x) && y ~= fix(y)\n    r = NaN;\nelse\n    r = abs(x)^y;\n"
        "    if (x < 0 || (x == 0 && 1 / x < 0)) && mod(y, 2) == 1\n        r = -r;\n    end\nend",
    ),
    "select": _choice("pick(condition, a, b)", "condition"),
    "min": _choice("smaller(a, b)", "a < b || a ~= a"),
    "max": _choice("larger(a, b)", "a > b || a ~= a"),
    "sign": _helper("sign_of(x)", "if x > 0\n    r = 1;\nelseif x < 0\n    r = -1;\nelse\n    r = x;\nend"),
}
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
"""Templates of operations. A function of the language is used where its values are real for real numbers."""

_KEYWORDS = """
    arguments break case catch classdef continue do else elseif end end_try_catch end_unwind_protect endclassdef
    endenumeration endevents endfor endfunction endif endmethods endparfor endproperties endspmd endswitch endwhile
    enumeration events for function global if methods otherwise parfor persistent properties return spmd switch try
    until unwind_protect unwind_protect_cleanup while
"""
_BUILT_IN = """
    abs atan2 double false fix Inf inf isfinite isinf mod NaN nan numel sqrt struct true zeros ans
"""
_OWN = "y p t h out parameters singular factored solved pick smaller larger power_of"

RESERVED = (*_KEYWORDS.split(), *_BUILT_IN.split(), *ELEMENTARY, *_OWN.split(), *(f"{op}_of" for op in HELPERS))
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
    made = [f"{array} = zeros({size}, 1);", *function.lines, f"singular = {function.status};"]
    if function.status != "false":
        made += ["if singular", f"    {array}(:) = NaN;", "end"]
    lines += [f"    {part}" for line in made for part in continued(line, LONGEST_LINE - 4, "...")]
    lines += ["end", "", *LANGUAGE.definitions(function.needed), *LANGUAGE.systems(function.needed)]
    return "\n".join(lines)


def files_of(module: SourceModule) -> Iterator[tuple[str, str]]:
    """Yield the name, without its suffix, and the text of each Octave file: defaults, functions, and the test."""
    prefix, functions = prefix_of(module), PrintedFunctions(module, LANGUAGE)
    yield f"{prefix}default_parameters", _defaults(module, prefix)
    about = [module.prepare.about, places("parameters", module.parameters, "{0}({1})", 1)]
    head = f"[p, singular] = {prefix}prepare(parameters)"
    yield f"{prefix}prepare", _text(module, head, about, functions.prepare(), functions.hoisted.size)
    state = places("y", module.state, "{0}({1})", 1)
    for quantity in module.quantities:
        head = f"[out, singular] = {prefix}{quantity.name}(t, y, p)"
        about = [about_of(module, quantity.procedure), state]
        yield (
            f"{prefix}{quantity.name}",
            _text(module, head, about, functions.quantity(quantity), len(quantity.results)),
        )
    yield f"{prefix}test", test_text(module, TEST, prefix=prefix)


TEST = Script(
    comment=marked("%"),
    head="""\
function failures = {prefix}test()
% failures = {prefix}test(): how many results are wrong; 0 is right.
    [p, singular] = {prefix}prepare({prefix}default_parameters());
    failures = double(singular);
    if singular
        fprintf('prepare: a matrix is singular\\n');
    end
""",
    quantity="""\
    failures = failures + wrong( ...
        {quoted}, ...
        @{prefix}{name}, ...
        p, ...
{tables}    {states});
""",
    table="        [ ...\n{numbers} ...\n        ], ...\n",
    tail="""\
    fprintf('{module}: %d of %d results are right\\n', {count} - failures, {count});
end

function failures = wrong(name, evaluate, p, times, states, expected, allowed, size)
    failures = 0;
    count = numel(expected) / numel(times);
    for k = 1:numel(times)
        [out, singular] = evaluate(times(k), states(size * (k - 1) + 1:size * k).', p);
        if singular
            fprintf('%s, state %d: a matrix is singular\\n', name, k);
        end
        for i = 1:count
            j = count * (k - 1) + i;
            if ~(abs(out(i) - expected(j)) <= allowed(j))
                fprintf('%s, state %d, result %d: %.17g instead of %.17g\\n', name, k, i, out(i), expected(j));
                failures = failures + 1;
            end
        end
    end
end
""",
    literals=LITERALS,
    more=" ...",
    quoted="'{}'".format,
)


@register
class Octave(Target):
    """Target `octave`: functions for MATLAB and Octave, one file each, and a test."""

    name = "octave"
    about = "MATLAB and Octave: one file for each function, no toolboxes, quantities only"
    contents = frozenset()

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return a file for each function that users call, and a file for the test, by name."""
        return {f"{name}.m": f"{text.rstrip()}\n" for name, text in files_of(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell line that runs the test in Octave."""
        return [f'octave-cli --quiet --no-history --eval "exit({prefix_of(module)}test() > 0)"']
