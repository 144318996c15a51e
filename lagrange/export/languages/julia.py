"""Julia: a module of functions, the names of which end with ! as they write to their arguments, and its test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from lagrange.export.comments import plain, wrapped
from lagrange.export.descriptions import TEST, about_of, places, sizes, statement_comment
from lagrange.export.ended import EndedPrinter
from lagrange.export.identifiers import distinct
from lagrange.export.module import Check, SourceModule
from lagrange.export.offset_printer import written
from lagrange.export.programs import results_tested, tested
from lagrange.export.target import Target, register
from lagrange.procedure.form import FLAG, PARTIAL, REAL, WHOLE, Array, Call, Kind, Let, Parameter, Procedure
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM, Literals, Operator, call
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.statement.elementary import ELEMENTARY

KINDS: Mapping[Kind, str] = {REAL: "Float64", WHOLE: "Int64", FLAG: "Bool"}

OPERATORS: Mapping[str, Operator] = {**COMMON, "select": call("ifelse({0}, {1}, {2})")}

LITERALS = Literals("Inf", "NaN")

FUNCTIONS: Mapping[str, str] = {
    **{
        one.name: one.name
        for one in ELEMENTARY.values()
        if one.everywhere and one.spread != "periodic" and one.name != "erf"
    },
    **{name: name for name in ("abs", "copysign", "min", "max")},
    "atan2": "atan",
    "quotient": "div",
    "round": "round",
}
"""Functions that have a value for all numbers; Julia's own modules have no error function. `min` and `max` are NaN if
an argument is NaN."""

CONVERSIONS: Mapping[tuple[str, Kind], str] = {
    ("real", WHOLE): "Float64({0})",
    ("real", FLAG): "Float64({0})",
    ("whole", REAL): "trunc(Int64, {0})",
    ("whole", FLAG): "Int64({0})",
}
"""Operations that depend on the kind of the argument: templates by operation and kind."""


def _helper(name: str, given: str, body: str) -> tuple[str, str]:
    """Return a function of numbers with a body of one expression."""
    return name, f"{name}({given}) = {body}\n"


def _real(name: str, outside: str) -> tuple[str, str]:
    """Return a function of x that is NaN where the function of the language raises an error."""
    return _helper(f"{name}_of", "x", f"{outside} ? oftype(x, NaN) : {name}(x)")


HELPERS: Mapping[str, tuple[str, str]] = {
    **{name: _real(name, "isinf(x)") for name in ("sin", "cos", "tan")},
    "sqrt": _real("sqrt", "x < 0"),
    "log": _real("log", "x < 0"),
    "asin": _real("asin", "abs(x) > 1"),
    "acos": _real("acos", "abs(x) > 1"),
    "acosh": _real("acosh", "x < 1"),
    "atanh": _real("atanh", "abs(x) > 1"),
    "power": _helper(
        "power_of",
        "x, y",
        "x < 0 && isfinite(y) && y != trunc(y) ? (isinf(x) ? abs(x)^y : oftype(x^0 * y, NaN)) : x^y",
    ),
    "magnitude": _helper("magnitude", "a, b", "max(abs(a), abs(b))"),
    "sign": _helper("sign_of", "x", "x > 0 ? one(x) : x < 0 ? -one(x) : x"),
    "two_to": _helper("two_to", "n", "ldexp(1.0, n)"),
    "exponent": _helper("exponent_of", "x", "isfinite(x) ? (abs(x) < floatmin(Float64) ? -1023 : exponent(x)) : 1024"),
    "mantissa": _helper("mantissa", "x", "isfinite(x) && x != 0 ? significand(abs(x)) : abs(x)"),
}
"""Functions that are defined in the file: a name, and the definition. NaN stays NaN in all."""

_KEYWORDS = """
    abstract baremodule begin break catch const continue do else elseif end export false finally for function global if
    import in isa let local macro module mutable primitive public quote return struct true try type using where while
"""
_FROM_BASE = """
    Inf NaN Float64 Int64 Bool Vector AbstractVector DimensionMismatch abs copysign div exponent floatmin ifelse im
    isfinite isinf lastindex ldexp length max min nothing oftype one pi round significand sqrt throw trunc undef view
    zero zeros
"""
_OWN = "y p t h out parameters"

KEYWORDS = (*_KEYWORDS.split(),)
RESERVED = (*KEYWORDS, *_FROM_BASE.split(), *ELEMENTARY, *_OWN.split())
"""Words that cannot be names of values: keywords, functions, and names of parameters of functions."""

_LIBRARY = """
    Base Core Main Artifacts Dates Distributed Downloads Future Libdl Logging Markdown Mmap Pkg Printf Profile Random
    Serialization Sockets Statistics Tar Test Unicode
    Any Array Channel Char Cmd Colon Complex Condition Dict Enum Event Exception Expr Float16 Float32 Function Int Int8
    Int16 Int32 Integer Iterators Lockable Matrix Meta Method Missing Module Number Nothing Pair Pairs Ptr Rational Real
    Ref Regex Returns Set Signed Some String Symbol Sys Task Text Threads Timer Tuple Type Union Unsigned Val Vector
    Version
"""
MODULES = (*_LIBRARY.split(), *_FROM_BASE.split())
"""Words that are not names of modules: modules of the standard library, and types."""


WIDTH = 110
"""Largest length of a line of comment or of a table."""


@dataclass(frozen=True)
class Names:
    """Texts on the public functions of a module, and the helpers that its functions need."""

    abouts: Mapping[Procedure, str]
    needed: dict[str, None] = field(default_factory=dict)


def comment(text: str, indent: str = "") -> list[str]:
    """Return the lines of a comment."""
    return [f"{indent}# {line}".rstrip() for line in wrapped(text, WIDTH)]


def in_order(procedure: Procedure) -> list[Parameter]:
    """Return the parameters in the order of Julia: first those that the function writes to."""
    first = written(procedure)
    return [*first, *(one for one in procedure.parameters if one not in first)]


def signature(procedure: Procedure) -> str:
    """Return the call of a function with its parameters, such as "rhs!(out, t, y, p)"."""
    return f"{procedure.name}!({', '.join(one.name for one in in_order(procedure))})"


def function(procedure: Procedure, names: Names) -> str:
    """Return a procedure as a function; the helpers that it needs are recorded in `names`."""
    return _JuliaPrinter(procedure, names).function()


class _JuliaPrinter(EndedPrinter):
    """Prints one procedure."""

    language = "Julia"
    operators = OPERATORS
    literals = LITERALS
    functions = FUNCTIONS
    helpers = HELPERS
    among = "in"

    def __init__(self, procedure: Procedure, names: Names) -> None:
        self.names = names
        super().__init__(procedure, names.needed, RESERVED)

    def function_name(self, procedure: Procedure) -> str:
        return f"{procedure.name}!"

    def head(self) -> list[str]:
        about = self.names.abouts.get(self.procedure)
        given = ", ".join(self.text(one.ref) for one in in_order(self.procedure))
        head = f"function {self.function_name(self.procedure)}({given})"
        if about is None:
            return [*comment(self.procedure.about), head]
        shown = [line.replace('"', "'").replace("$", "") for line in wrapped(about, WIDTH)]
        return ['"""', f"    {signature(self.procedure)}", "", *shown, '"""', head, *self._lengths()]

    def _lengths(self) -> list[str]:
        """Return checks of the lengths of arrays."""
        least = {
            self.text(one.ref): one.type.size
            for one in self.procedure.parameters
            if isinstance(one.type, Array) and one.type.size
        }
        return [
            f'{self.indent}length({name}) < {size} && throw(DimensionMismatch("{name} has fewer than {size} numbers"))'
            for name, size in least.items()
        ]

    def operation(self, let: Let) -> tuple[int, str]:
        special = CONVERSIONS.get((let.op, self.kind(let.args[0])))
        return super().operation(let) if special is None else (ATOM, special.format(self.text(let.args[0])))

    def define(self, name: str, kind: Kind, text: str) -> str:
        return f"{name} = {text}"

    def assign(self, target: str, text: str) -> str:
        return f"{target} = {text}"

    def element(self, array: int, place: int) -> str:
        whole, index = self.index(array, place)
        return f"{self.text(whole)}[{index}]"

    def reserve(self, ref: int, array: Array) -> None:
        self.put(f"{self.name(ref)} = zeros({KINDS[array.kind]}, {array.length})")

    def passed(self, ref: int) -> str:
        """Return an argument of a call: the part of an array that begins at a place as a view."""
        if not isinstance(self.types.get(ref), Array):
            return self.text(ref)
        whole, begin = self.beginning(ref)
        name = self.text(whole)
        return name if begin is None else f"view({name}, {begin}:length({name}))"

    def call(self, call: Call) -> None:
        args = list(call.args)
        if isinstance(call.callee, Procedure):
            places = {one.ref: k for k, one in enumerate(call.callee.parameters)}
            args = [call.args[places[one.ref]] for one in in_order(call.callee)]
        target = self.function_name(call.callee) if isinstance(call.callee, Procedure) else self.text(call.callee)
        made = f"{target}({', '.join(self.passed(arg) for arg in args)})"
        self.settle()
        found = []
        for ref, kind in zip(call.refs, results_of(self, call), strict=True):
            self.types[ref] = kind
            found.append(self.name(ref) if ref in self.uses else "_")
        named = any(one != "_" for one in found)
        self.put(f"{', '.join(found)} = {made}" if named else made)

    def leave(self, values: Sequence[int]) -> None:
        self.write(f"return {', '.join(self.text(value) for value in values) or 'nothing'}")

    def comment(self, text: str) -> str:
        return f"# {plain(text)}".rstrip()

    def partial(self, ref: int, place: str) -> str:
        return f"{self.text(ref)}[{self.partial_index(place)}]"

    def modulo(self, index: str) -> str:
        return f"{index} % {PARTIAL}"


COMPARE = """\
function compare(name, state, found, wanted, allowed)
    failures = 0
    for i in 1:length(wanted)
        if !(abs(found[i] - wanted[i]) <= allowed[i])
            println("$name, state $state, result $i: $(found[i]) instead of $(wanted[i])")
            failures += 1
        end
    end
    return failures
end
"""


def _table(name: str, values: Sequence[float]) -> Iterator[str]:
    """Yield a list of numbers."""
    yield f"    {name} = ["
    line = " " * 8
    for value in values:
        text = f"{LITERALS.real(value)}, "
        if len(line) + len(text) > WIDTH:
            yield line.rstrip()
            line = " " * 8
        line += text
    yield line.rstrip()
    yield "    ]"


def _rows(name: str, rows: Sequence[Sequence[float]]) -> Iterator[str]:
    """Yield a list of lists of numbers."""
    yield f"    {name} = ["
    for row in rows:
        _, *lines, last = _table("", row)
        yield "        ["
        yield from (f"    {line}" for line in lines)
        yield f"    {last},"
    yield "    ]"


def test_file(module: SourceModule, name: str) -> str:
    """Return the program that compares results with those of multiple precision."""
    count = results_tested(module)
    lines = [
        *comment(f"{TEST} Exit status 0 if all are right."),
        "",
        f'include(joinpath(@__DIR__, "{module.name}.jl"))',
        "",
        COMPARE,
    ]
    for check in module.checks:
        lines += _quantity_test(check, name)
    lines += [
        "function test_all()",
        f"    p = zeros({name}.PREPARED_SIZE)",
        f"    if {name}.prepare!(p, {name}.DEFAULT_PARAMETERS)",
        '        println("prepare: a matrix is singular")',
        "        return 1",
        "    end",
        "    failures = 0",
        *(f"    failures += test_{one}(p)" for one in tested(module)),
        f'    println("{module.name}: ", {count} - failures, " of ", {count}, " results are right")',
        "    return failures",
        "end",
        "",
        "exit(test_all() > 0 ? 1 : 0)",
        "",
    ]
    return "\n".join(lines)


def _quantity_test(check: Check, name: str) -> Iterator[str]:
    """Yield the test of one function."""
    yield f"function test_{check.name}(p)"
    yield from _table("times", check.times)
    for table, rows in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from _rows(table, rows)
    yield f"    out = zeros({len(check.results[0])})"
    yield "    failures = 0"
    yield f"    for k in 1:{len(check.times)}"
    yield f"        if {name}.{check.name}!(out, times[k], states[k], p)"
    yield f'            println("{check.name}, state $k: a matrix is singular")'
    yield "            out .= NaN"
    yield "        end"
    yield f'        failures += compare("{check.name}", k, out, wanted[k], allowed[k])'
    yield "    end"
    yield "    return failures"
    yield "end"
    yield ""


@register
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
        """Return the shell line that runs the test."""
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
