"""Export to Fortran 2008: one source file with a module of subroutines, and a test."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence

from lagrange.export.module import (
    LONGEST_NAME,
    TEXT_WIDTH,
    SourceModule,
    about_of,
    commented,
    continued,
    distinct,
    indices,
    places,
    sizes,
    statement_comment,
)
from lagrange.export.programs import Script, filled, helpers, marked, test_text, words
from lagrange.export.straight_line import Language, PrintedFunction, PrintedFunctions
from lagrange.export.target import QUANTITIES, Target, register
from lagrange.procedure.spelling import OPERATORS, WORDS, Literals, Operator, call
from lagrange.statement.vocabulary.functions import ELEMENTARY

OPERATIONS: Mapping[str, Operator] = {
    **OPERATORS,
    **{op: call(f"{op}({{0}})") for op in (*ELEMENTARY, "sqrt", "abs")},
    "atan2": call("atan2({0}, {1})"),
    "or": WORDS["or"]._replace(text="{0} .or. {1}"),
    "and": WORDS["and"]._replace(text="{0} .and. {1}"),
    "not": WORDS["not"]._replace(text=".not. {0}"),
    "neg": Operator(6, "-{0}", (7,)),
    "power": Operator(8, "{0}**{1}", (9, 9)),
    "select": call("merge({1}, {2}, {0})"),
    "equal": call("equal({0}, {1})"),
    "min": call("smaller({0}, {1})"),
    "max": call("larger({0}, {1})"),
    "sign": call("sign_of({0})"),
}
"""Templates and precedences of operations. A signed number has the precedence of a sum, because a sign must not follow
an operator. A function compares reals, because compilers warn of ==."""


def _finite(value: float) -> str:
    """Return the literal of a finite double. A subnormal number is given by its bits, since compilers warn of it."""
    if 0.0 < abs(value) < 2.0**-1022:
        (bits,) = struct.unpack("<q", struct.pack("<d", abs(value)))
        return f"{'-' if value < 0 else ''}transfer({bits}_int64, 1.0_dp)"
    return f"{value!r}_dp"


LITERALS = Literals("infinity", "not_a_number", (".false.", ".true."), 6, str, _finite)

HELPERS = {op: f"{text}\n" for op, text in helpers("fortran").items()}
"""Helper functions for operations that Fortran lacks. All return NaN for NaN."""

CONSTANTS: Mapping[str, str] = {
    "infinity": "transfer(9218868437227405312_int64, 1.0_dp)",
    "not_a_number": "transfer(9221120237041090560_int64, 1.0_dp)",
}
"""Definitions of constants for the values that have no literal in Fortran."""

RESERVED = (*words("fortran", "reserved"), *ELEMENTARY, *CONSTANTS, *QUANTITIES)
"""Words that cannot be names of values: keywords, functions, and names of parameters of procedures."""

LONGEST_LINE = 132  # Largest length of a line of Fortran

LARGE = 4096
"""Total size of local arrays, in numbers, from which a subroutine is marked recursive. Otherwise a compiler might store
the arrays in memory that threads share."""

LANGUAGE = Language(
    name="Fortran",
    operations=OPERATIONS,
    literals=LITERALS,
    helpers=HELPERS,
    element="{0}({1})",
    first=1,
    condition=WORDS["not"]._replace(text=".not. equal({0}, 0.0_dp)", operands=(0,)),
    number=call("merge(1.0_dp, 0.0_dp, {0})"),
    matrix="{name} = 0.0_dp",
    factor="call factored({order}, {name}, {other})",
    solve="call solved({order}, {other}, [{entries}], {name})",
    needs={"factor": ("equal",), "condition": ("equal",)},
    reserved=RESERVED,
    key=str.lower,
    entry="{0}({1}, {2})",
    loop="do {0} = {1}, {2}",
    back="do {0} = {2}, {1}, -1",
    when="if ({0}) then",
    end_loop="end do",
    end_when="end if",
    to_real="real({0}, dp)",
    to_index="int({0})",
    leave="singular = {0}",
    factored=(filled("fortran", "factored"), "  end subroutine factored"),
    solved=(filled("fortran", "solved"), "  end subroutine solved"),
)


def short(line: str) -> list[str]:
    """Return a Fortran statement as one line, or as several lines with & if it is too long."""
    return continued(line, LONGEST_LINE, "&")


def _comment(text: str, indent: str = "  ") -> list[str]:
    return [f"{indent}{line}" for line in commented(text, "!")]


def listed(head: str, names: Sequence[str]) -> Iterator[str]:
    """Yield statements that begin with `head` and list names, as many names as fit on each line."""
    line = ""
    for name in names:
        if line and len(head) + len(line) + len(name) > TEXT_WIDTH:
            yield head + line
            line = ""
        line += f", {name}" if line else name
    if line:
        yield head + line


def module_name(module: SourceModule) -> str:
    """Return the name of the Fortran module; it differs from all other names in the file."""
    return distinct([module.name[: LONGEST_NAME - len("_test")]], RESERVED, key=str.lower)[0]


def source(module: SourceModule) -> str:
    """Return the text of the Fortran source file."""
    name, functions = module_name(module), PrintedFunctions(module, LANGUAGE)
    lines = [
        *statement_comment(module, "!"),
        "",
        f"module {name}",
        "  use, intrinsic :: iso_fortran_env, only: dp => real64, int64",
        "  implicit none",
        "  private",
        *listed("  public :: ", ["prepare", *(quantity.name for quantity in module.quantities)]),
        "",
        *_constants(module, functions.hoisted.size),
        "",
        "contains",
        "",
        *_subroutine("prepare", "parameters, p", module.prepare.about, functions.prepare()),
    ]
    for quantity in module.quantities:
        lines += _subroutine(
            quantity.name, "t, y, p, out", about_of(module, quantity.procedure), functions.quantity(quantity)
        )
    lines += LANGUAGE.systems(functions.needed)
    return "\n".join([*lines, *LANGUAGE.definitions(functions.needed), f"end module {name}", ""])


def _subroutine(name: str, arguments: str, about: str, function: PrintedFunction) -> Iterator[str]:
    """Yield the lines of a subroutine. `arguments` are the names of its arguments; the last one is the computed array.

    A further argument, `singular`, receives True if a matrix is singular. `about` is the comment on the subroutine.
    """
    *arrays, result = arguments.split(", ")
    size = 1
    for _, _, dimensions in function.declared:
        size += dimensions[0] * dimensions[-1] if dimensions else 1
    recursive = " recursive" if size > LARGE else ""
    yield f"  pure{recursive} subroutine {name}({arguments}, singular)"
    yield from _comment(about, "    ")
    if "t" in arrays:
        yield "    real(dp), intent(in) :: t"
    yield f"    real(dp), intent(in) :: {', '.join(f'{array}(*)' for array in arrays if array != 't')}"
    yield f"    real(dp), intent(inout) :: {result}(*)"
    yield "    logical, intent(out) :: singular"
    for kind, head in (("real", "    real(dp) :: "), ("flag", "    logical :: ")):
        names = [
            f"{variable}({', '.join(map(str, sizes))})" if sizes else variable
            for type_name, variable, sizes in function.declared
            if type_name == kind
        ]
        yield from listed(head, names)
    unused = [
        argument if argument == "t" else f"{argument}(1)"
        for argument in function.unused
        if argument in (*arrays, result)
    ]
    if unused:
        # Compilers warn of arguments that are not used.
        pairs = ", ".join(f"unused{k or ''} => {argument}" for k, argument in enumerate(unused))
        yield from (f"    associate ({pairs})", "    end associate")
    for line in (*function.lines, f"singular = {function.status}"):
        yield from short(f"    {line}")
    yield f"  end subroutine {name}"
    yield ""


def _constants(module: SourceModule, prepared: int) -> Iterator[str]:
    """Yield lines with the lengths of all arrays, the default parameters, and numbers without a literal, such as NaN.

    `prepared` is the length of p, the array of values that depend on parameters alone.
    """
    yield from _comment(places("y", module.state, "{0}({1})", 1))
    yield from _comment(places("parameters", module.parameters, "{0}({1})", 1))
    yield from _comment(
        "Each subroutine of t, y and p says whether a matrix is singular to round-off: out is then not to be used."
    )
    yield ""
    for name, count, about in sizes(module, prepared):
        yield f"  integer, parameter, public :: {name}_size = {count} ! {about}"
    yield from (f"  integer, parameter, public :: {name.lower()} = {k}" for name, k in indices(module, 1))
    values = ", ".join(map(LITERALS.real, module.values))
    defaults = f"[real(dp) :: {values}]" if values else "[real(dp) ::]"
    yield from short(f"  real(dp), parameter, public :: default_parameters({len(module.values)}) = {defaults}")
    for name, value in CONSTANTS.items():
        yield f"  real(dp), parameter :: {name} = {value}"


TEST = Script("fortran", comment=marked("!"), literals=LITERALS, more=" &", chunk=120, quoted="'{}'".format)
"""The self-test. It assigns lists in parts, because compilers may refuse statements of more than 256 lines."""


@register
class Fortran(Target):
    """Target `fortran`: a module in Fortran 2008, and its test."""

    name = "fortran"
    about = "Fortran 2008: a module of pure subroutines in one source file, no dependencies, quantities only"
    contents = frozenset()
    shell = ("gfortran -std=f2008 -O2 -o {name}_{program} {name}.f90 {name}_{program}.f90", "./{name}_{program}")

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the texts of the source file and of the self-test by file name."""
        calls = "\n".join(f"  call test_{check.name}()" for check in module.checks)
        test = test_text(module, TEST, fortran=module_name(module), calls=calls)
        return {f"{module.name}.f90": source(module), f"{module.name}_test.f90": test}
