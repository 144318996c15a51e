"""MATLAB and Octave: a file for each function that users call, and one for the test.

Arrays are values there: what a function writes it returns.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lagrange.errors import LagrangeError
from lagrange.export.comments import plain, wrapped
from lagrange.export.descriptions import TEST, about_of, places, statement_comment
from lagrange.export.ended import EndedPrinter
from lagrange.export.identifiers import LONGEST
from lagrange.export.lines import continued
from lagrange.export.module import Check, SourceModule
from lagrange.export.offset_printer import written
from lagrange.export.programs import results_tested, tested
from lagrange.export.target import Target, register
from lagrange.procedure.form import FLAG, PARTIAL, REAL, WHOLE, Array, Call, Kind, Let, Parameter, Procedure
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM, Literals, Operator, call
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.statement.elementary import ELEMENTARY

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "not": COMMON["not"]._replace(text="~{0}"),
    "quotient": Operator(ATOM, "fix({0} / {1})", COMMON["div"].operands),
    "select": call("pick({0}, {1}, {2})"),
}

LITERALS = Literals("Inf", "NaN")

FUNCTIONS: Mapping[str, str] = {
    name: name for name in (*(one.name for one in ELEMENTARY.values() if one.everywhere), "atan2", "abs")
}
"""Functions that are real wherever they are given real numbers."""

CONVERSIONS: Mapping[tuple[str, Kind], str] = {
    ("real", WHOLE): "{0}",
    ("real", FLAG): "double({0})",
    ("whole", REAL): "fix({0})",
    ("whole", FLAG): "double({0})",
}
"""Operations that depend on the kind of the argument: templates by operation and kind."""


def _helper(name: str, given: str, body: str) -> tuple[str, str]:
    """Return a function that sets its result r."""
    lines = [f"    {line}" for line in body.splitlines()]
    return name, "\n".join([f"function r = {name}({given})", *lines, "end", ""])


def _real(name: str, outside: str) -> tuple[str, str]:
    """Return a function of x that is NaN where the one of the language has complex values."""
    return _helper(f"{name}_of", "x", f"if {outside}\n    r = NaN;\nelse\n    r = {name}(x);\nend")


HELPERS: Mapping[str, tuple[str, str]] = {
    "sqrt": _real("sqrt", "x < 0"),
    "log": _real("log", "x < 0"),
    "asin": _real("asin", "abs(x) > 1"),
    "acos": _real("acos", "abs(x) > 1"),
    "acosh": _real("acosh", "x < 1"),
    "atanh": _real("atanh", "abs(x) > 1"),
    "power": _helper(
        "power_of",
        "x, y",
        "if x < 0 && isfinite(x) && y ~= fix(y)\n    r = NaN;\nelse\n    r = abs(x)^y;\n"
        "    if (x < 0 || (x == 0 && 1 / x < 0)) && mod(y, 2) == 1\n        r = -r;\n    end\nend",
    ),
    "select": _helper("pick", "condition, a, b", "if condition\n    r = a;\nelse\n    r = b;\nend"),
    "min": _helper("smaller", "a, b", "if a < b || a ~= a\n    r = a;\nelse\n    r = b;\nend"),
    "max": _helper("larger", "a, b", "if a > b || a ~= a\n    r = a;\nelse\n    r = b;\nend"),
    "magnitude": _helper(
        "magnitude", "a, b", "if abs(a) > abs(b) || a ~= a\n    r = abs(a);\nelse\n    r = abs(b);\nend"
    ),
    "sign": _helper("sign_of", "x", "if x > 0\n    r = 1;\nelseif x < 0\n    r = -1;\nelse\n    r = x;\nend"),
    "copysign": _helper("copy_sign", "a, b", "r = abs(a);\nif b < 0 || (b == 0 && 1 / b < 0)\n    r = -r;\nend"),
    "round": _helper(
        "rounded",
        "x",
        "r = x;\nif abs(x) < 4503599627370496\n    r = (abs(x) + 4503599627370496) - 4503599627370496;\n"
        "    if x < 0\n        r = -r;\n    end\nend",
    ),
    "two_to": _helper("two_to", "n", "r = pow2(1, n);"),
    "exponent": _helper(
        "exponent_of",
        "x",
        "if ~(abs(x) < Inf)\n    r = 1024;\nelseif abs(x) < realmin\n    r = -1023;\nelse\n    [~, r] = log2(x);\n"
        "    r = r - 1;\nend",
    ),
    "mantissa": _helper("mantissa", "x", "[r, ~] = log2(abs(x));\nr = 2 * r;"),
}
"""Functions that are defined in a file: a name, and the definition. NaN stays NaN in all."""

_KEYWORDS = """
    arguments break case catch classdef continue do else elseif end end_try_catch end_unwind_protect endclassdef
    endenumeration endevents endfor endfunction endif endmethods endparfor endproperties endspmd endswitch endwhile
    enumeration events for function global if methods otherwise parfor persistent properties return spmd switch try
    until unwind_protect unwind_protect_cleanup while
"""
_BUILT_IN = """
    abs atan2 double false fix Inf inf isinf log2 mod NaN nan
    numel pow2 realmin sqrt struct true zeros ans
"""

_OWN = "y p t h out parameters singular outcome"

KEYWORDS = (*_KEYWORDS.split(),)
RESERVED = (*KEYWORDS, *_BUILT_IN.split(), *ELEMENTARY, *_OWN.split())
"""Words that are not names of values: keywords, functions, and what parameters and results of functions are called."""


WIDTH, LONGEST_LINE = 110, 120
"""Characters of a line of comment or of a table, and those of a statement."""

SINGULAR = "singular"
"""The result of every public function: whether a matrix is singular."""


@dataclass(frozen=True)
class Public:
    """A function that users call: its name, and the length of the array that it makes."""

    name: str
    made: int


@dataclass(frozen=True)
class Names:
    """The public functions of a module, and the helpers that the present file needs."""

    public: Mapping[Procedure, Public]
    needed: dict[str, None] = field(default_factory=dict)


def comment(text: str, indent: str = "") -> list[str]:
    """Return the lines of a comment."""
    return [f"{indent}% {line}".rstrip() for line in wrapped(text, WIDTH)]


def short(line: str) -> list[str]:
    """Return a statement or a comment on lines that are short enough."""
    if line.lstrip().startswith("%"):
        return comment(line.lstrip()[1:].strip(), " " * (len(line) - len(line.lstrip())))
    return continued(line, LONGEST_LINE, "...")


def table(name: str, rows: Sequence[Sequence[float]], indent: str = "    ") -> list[str]:
    """Return a matrix, whose rows go on where a line ends with dots."""
    lines = [f"{indent}{name} = ["]
    for row in rows:
        line = indent * 2
        for k, value in enumerate(row):
            text = f"{LITERALS.real(value)}{', ' if k < len(row) - 1 else ''}"
            if len(line) + len(text) > WIDTH:
                lines.append(f"{line}...")
                line = indent * 3
            line += text
        lines.append(line)
    return [*lines, f"{indent}];"]


def given_to(procedure: Procedure, names: Names) -> list[Parameter]:
    """Return the parameters of a function: all but the array that it makes."""
    public = names.public.get(procedure)
    if public is None:
        return list(procedure.parameters)
    return [one for one in procedure.parameters if one not in written(procedure)]


def signature(procedure: Procedure, names: Names) -> str:
    """Return the call of a public function with its results and parameters."""
    results = [*(one.name for one in written(procedure)), SINGULAR]
    given = ", ".join(one.name for one in given_to(procedure, names))
    return f"[{', '.join(results)}] = {names.public[procedure].name}({given})"


def function(procedure: Procedure, names: Names) -> str:
    """Return a procedure as a function; the helpers that it needs are noted."""
    return _OctavePrinter(procedure, names).function()


class _OctavePrinter(EndedPrinter):
    """Prints one procedure."""

    language = "Octave"
    operators = OPERATORS
    literals = LITERALS
    functions = FUNCTIONS
    helpers = HELPERS
    among = "="

    def __init__(self, procedure: Procedure, names: Names) -> None:
        self.names = names
        self.public = names.public.get(procedure)
        super().__init__(procedure, names.needed, RESERVED)
        self.found = self._result_names()

    def broken(self, line: str) -> list[str]:
        return short(line)

    def _result_names(self) -> list[str]:
        if self.public is not None:
            return [SINGULAR]
        return [self.name(-1 - k, f"found{k or ''}") for k in range(len(self.procedure.results))]

    def function_name(self, procedure: Procedure) -> str:
        public = self.names.public.get(procedure)
        return procedure.name if public is None else public.name

    def head(self) -> list[str]:
        if self.lines and self.lines[-1] == f"{self.indent}return":
            self.lines.pop()
        results = [*(self.text(one.ref) for one in written(self.procedure)), *self.found]
        given = ", ".join(
            "~" if one in self.unused and one not in written(self.procedure) else self.text(one.ref)
            for one in given_to(self.procedure, self.names)
        )
        lines = [f"function [{', '.join(results)}] = {self.function_name(self.procedure)}({given})"]
        if self.public is None:
            return [*lines, *comment(self.procedure.about, self.indent)]
        return [*lines, f"{self.indent}{results[0]} = zeros({self.public.made}, 1);"]

    def operation(self, let: Let) -> tuple[int, str]:
        special = CONVERSIONS.get((let.op, self.kind(let.args[0])))
        if special == "{0}":
            least = self.texts[let.args[0]][0]
            return least, self.text(let.args[0], least)
        if special is not None:
            return ATOM, special.format(self.text(let.args[0]))
        if let.op == "select":
            self.function_of("select")
        return super().operation(let)

    def folded(self, fold: Any, index: int) -> tuple[str, str]:
        if fold.op == "most":
            self.function_of("select")
        return super().folded(fold, index)

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"{name} = {text};"

    def assign(self, target: str, text: str) -> str:
        return f"{target} = {text};"

    def element(self, array: int, place: int) -> str:
        whole, index = self.index(array, place)
        return f"{self.text(whole)}({index})"

    def reserve(self, ref: int, array: Array) -> None:
        self.put(f"{self.name(ref)} = zeros({array.length}, 1);")

    def passed(self, ref: int) -> str:
        """Return an argument of a call: the part of an array that begins at a place by its numbers."""
        if not isinstance(self.types.get(ref), Array):
            return self.text(ref)
        whole, begin = self.beginning(ref)
        return self.text(whole) if begin is None else f"{self.text(whole)}({begin}:end)"

    def call(self, call: Call) -> None:
        if not isinstance(call.callee, Procedure):
            raise LagrangeError(f"{self.procedure.name} calls a function that is given, which has no name.")
        public, changed = self.names.public.get(call.callee), written(call.callee)
        taken = given_to(call.callee, self.names)
        pairs = list(zip(call.callee.parameters, call.args, strict=True))
        given = [self.passed(ref) for one, ref in pairs if one in taken]
        targets = [self._target(ref, public) for one, ref in pairs if one in changed]
        self._check_apart([self.place_of(ref).array for one, ref in pairs if one in changed])
        self.settle()
        for ref, kind in zip(call.refs, results_of(self, call), strict=True):
            self.types[ref] = kind
            targets.append(self.name(ref) if ref in self.uses else "~")
        while targets and targets[-1] == "~":
            targets.pop()
        left = f"[{', '.join(targets)}] = " if len(targets) > 1 else f"{targets[0]} = " if targets else ""
        self.put(f"{left}{self.function_name(call.callee)}({', '.join(given)});")

    def _target(self, ref: int, public: Public | None) -> str:
        """Return where an array goes that a call returns."""
        if public is None:
            return self.passed(ref)
        whole, begin = self.beginning(ref)
        return f"{self.text(whole)}({begin or 1}:{_last(begin or '1', public.made)})"

    def _check_apart(self, arrays: Sequence[int]) -> None:
        if len(dict.fromkeys(arrays)) < len(arrays):
            raise LagrangeError(f"{self.procedure.name} gives two parts of one array to a function that writes both.")

    def leave(self, values: Sequence[int]) -> None:
        texts = [self.text(value) for value in values]
        self.settle()
        for name, text in zip(self.found, texts, strict=True):
            self.put(self.assign(name, text))
        if self.public is not None and texts != ["false"]:
            array = self.text(written(self.procedure)[0].ref)
            if texts != ["true"]:
                self.put(f"if {SINGULAR}")
            self.put(f"{self.indent * (texts != ['true'])}{array}(:) = NaN;")
            if texts != ["true"]:
                self.put("end")
        self.put("return")

    def comment(self, text: str) -> str:
        return f"% {plain(text)}".rstrip()

    def partial(self, ref: int, place: str) -> str:
        return f"{self.text(ref)}({self.partial_index(place)})"

    def modulo(self, index: str) -> str:
        return f"mod({index}, {PARTIAL})"


def _last(begin: str, count: int) -> str:
    """Return the index of the last of some elements, from their first index and their number."""
    if begin.isdigit():
        return str(int(begin) + count - 1)
    return f"{begin} + {count - 1}"


COMPARE = """\
function failures = compare(name, state, found, wanted, allowed)
    failures = 0;
    for i = 1:numel(wanted)
        if ~(abs(found(i) - wanted(i)) <= allowed(i))
            fprintf('%s, state %d, result %d: %.17g instead of %.17g\\n', name, state, i, found(i), wanted(i));
            failures = failures + 1;
        end
    end
end
"""


def test_file(module: SourceModule, prefix: str) -> str:
    """Return the function that compares results with those of multiple precision, and returns the failures."""
    count = results_tested(module)
    lines = [
        f"function failures = {prefix}test()",
        f"% failures = {prefix}test(): how many results are wrong; 0 is right.",
        *comment(f"{TEST} Those that are not right are printed."),
        f"    [p, singular] = {prefix}prepare({prefix}default_parameters());",
        "    failures = double(singular);",
        "    if singular",
        "        fprintf('prepare: a matrix is singular\\n');",
        "    end",
        *(f"    failures = failures + test_{one}_results(p);" for one in tested(module)),
        f"    fprintf('{module.name}: %d of %d results are right\\n', {count} - failures, {count});",
        "end",
        "",
        COMPARE,
    ]
    for check in module.checks:
        lines += _quantity_test(check, prefix)
    return "\n".join(lines).rstrip("\n") + "\n"


def _quantity_test(check: Check, prefix: str) -> Iterator[str]:
    """Yield the test of one function."""
    yield f"function failures = test_{check.name}_results(p)"
    yield from table("times", [check.times])
    for name, rows in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from table(name, rows)
    yield "    failures = 0;"
    yield f"    for k = 1:{len(check.times)}"
    yield f"        [out, singular] = {prefix}{check.name}(times(k), states(k, :).', p);"
    yield "        if singular"
    yield f"            fprintf('{check.name}, state %d: a matrix is singular\\n', k);"
    yield "        end"
    yield f"        failures = failures + compare('{check.name}', k, out, wanted(k, :), allowed(k, :));"
    yield "    end"
    yield "end"
    yield ""


@register
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
        """Return the shell line that runs the test in Octave."""
        return [f'octave-cli --quiet --no-history --eval "exit({prefix_of(module)}test() > 0)"']


def prefix_of(module: SourceModule) -> str:
    """Return the prefix of the names of all functions, shortened if they would be too long."""
    longest = max(map(len, ("default_parameters", *(one.name for one in module.public))))
    return f"{module.name[: LONGEST - longest - 1]}_"


def names_of(module: SourceModule) -> Names:
    """Return the names that the functions of a module share."""
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
    """Return the file of a public function, followed by the functions that only this one calls."""
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
