"""Fortran 2008: one source file with a module of subroutines and its test."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lagrange.export.comments import wrapped
from lagrange.export.descriptions import TEST, about_of, places, sizes, statement_comment
from lagrange.export.identifiers import LONGEST, distinct
from lagrange.export.lines import continued
from lagrange.export.module import Check, SourceModule
from lagrange.export.offset_printer import OffsetPrinter
from lagrange.export.programs import compiled, macro, tested
from lagrange.export.target import Target, register
from lagrange.procedure.form import CONSTANT, FLAG, PARTIAL, REAL, WHOLE, Array, Call, Kind, Let, Procedure
from lagrange.procedure.interpreter import OPERATIONS
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM, WORDS, Literals, Operator, call
from lagrange.procedure.spelling import OPERATORS as COMMON
from lagrange.statement.elementary import ELEMENTARY

KINDS: Mapping[Kind, str] = {REAL: "real(dp)", WHOLE: "integer(int64)", FLAG: "logical"}

OPERATORS: Mapping[str, Operator] = {
    **COMMON,
    "or": WORDS["or"]._replace(text="{0} .or. {1}"),
    "and": WORDS["and"]._replace(text="{0} .and. {1}"),
    "not": WORDS["not"]._replace(text=".not. {0}"),
    "neg": Operator(6, "-{0}", (7,)),
    "quotient": COMMON["div"],
    "power": Operator(8, "{0}**{1}", (9, 9)),
    "select": call("merge({1}, {2}, {0})"),
}
"""Operators with precedences; a signed number binds like a sum, since no sign may follow an operator."""


def _finite(value: float) -> str:
    """Return a finite double; one below the normal numbers by its bits, since compilers warn of it."""
    if 0.0 < abs(value) < 2.0**-1022:
        (bits,) = struct.unpack("<q", struct.pack("<d", abs(value)))
        return f"{'-' if value < 0 else ''}transfer({bits}_int64, 1.0_dp)"
    return f"{value!r}_dp"


LITERALS = Literals("infinity", "not_a_number", (".false.", ".true."), 6, "{}_int64".format, _finite)

FUNCTIONS: Mapping[str, str] = {
    **{name: name for name in (*ELEMENTARY, "sqrt", "atan2", "abs")},
    "copysign": "sign",
}
"""Intrinsic functions."""

CONVERSIONS: Mapping[tuple[str, Kind], str] = {
    ("real", WHOLE): "real({0}, dp)",
    ("real", FLAG): "merge(1.0_dp, 0.0_dp, {0})",
    ("whole", REAL): "int({0}, int64)",
    ("whole", FLAG): "merge(1_int64, 0_int64, {0})",
    ("min", WHOLE): "min({0}, {1})",
    ("max", WHOLE): "max({0}, {1})",
    ("equal", REAL): "equal({0}, {1})",
}
"""Operations that depend on the kind of the argument. Compilers warn of == between reals: a function compares them."""


def _helper(kind: str, name: str, given: str, body: str, local: str = "") -> tuple[str, str]:
    """Return a function of reals (or of a whole number, n) that sets its result r."""
    lines = [f"  elemental function {name}({given}) result(r)"]
    lines.append(f"    {'integer(int64)' if given == 'n' else 'real(dp)'}, intent(in) :: {given}")
    lines += [f"    {kind} :: r", *([f"    {local}"] if local else []), *(f"    {one}" for one in body.splitlines())]
    return name, "\n".join([*lines, f"  end function {name}", ""])


HELPERS: Mapping[str, tuple[str, str]] = {
    "equal": _helper("logical", "equal", "a, b", "r = a <= b .and. a >= b"),
    "min": _helper("real(dp)", "smaller", "a, b", "r = b\nif (a < b .or. .not. (a <= a)) r = a"),
    "max": _helper("real(dp)", "larger", "a, b", "r = b\nif (a > b .or. .not. (a <= a)) r = a"),
    "magnitude": _helper("real(dp)", "magnitude", "a, b", "r = abs(b)\nif (abs(a) > r .or. .not. (a <= a)) r = abs(a)"),
    "sign": _helper("real(dp)", "sign_of", "x", "r = x\nif (x > 0.0_dp) r = 1.0_dp\nif (x < 0.0_dp) r = -1.0_dp"),
    "round": _helper(
        "real(dp)",
        "rounded",
        "x",
        "r = x\nif (abs(x) < two_to_52) r = sign((abs(x) + two_to_52) - two_to_52, x)",
        "real(dp), parameter :: two_to_52 = 4503599627370496.0_dp",
    ),
    "two_to": _helper("real(dp)", "two_to", "n", "r = scale(1.0_dp, int(n))"),
    "exponent": _helper(
        "integer(int64)",
        "exponent_of",
        "x",
        "r = 1024_int64\nif (abs(x) < tiny(x)) then\n  r = -1023_int64\n"
        "else if (abs(x) <= huge(x)) then\n  r = int(exponent(x), int64) - 1_int64\nend if",
    ),
    "mantissa": _helper("real(dp)", "mantissa", "x", "r = 2.0_dp * fraction(abs(x))"),
}
"""Operations that Fortran has no function for: a name, and its definition. NaN stays NaN in all."""

CONSTANTS: Mapping[str, str] = {
    "infinity": "transfer(9218868437227405312_int64, 1.0_dp)",
    "not_a_number": "transfer(9221120237041090560_int64, 1.0_dp)",
}
"""Values that have no literal."""

_STATEMENTS = """
    abstract allocatable allocate assign associate asynchronous backspace bind block call case character class close
    codimension common complex concurrent contains contiguous continue critical cycle data deallocate default deferred
    dimension do double elemental else elsewhere end endassociate endblock enddo endenum endfile endforall endfunction
    endif endinterface endmodule endprocedure endprogram endselect endsubmodule endsubroutine endtype endwhere entry
    enum enumerator equivalence error exit extends external final flush forall format function generic go goto if
    implicit import impure in include inout inquire integer intent interface intrinsic is kind lock logical memory
    module namelist non_overridable none nopass nullify only open operator optional out parameter pass pause pointer
    precision print private procedure program protected public pure read real recursive result return rewind rewrite
    save select selectcase selecttype sequence stop subroutine submodule sync target then to type unformatted unlock use
    value volatile wait where while write
"""
_INTRINSICS = """
    abs atan2 exponent fraction huge int max merge min mod sign
    scale sqrt tiny transfer dp int64 real64 iso_fortran_env
"""
_OWN = "y p t h parameters unused default_parameters"

RESERVED = (*_STATEMENTS.split(), *_INTRINSICS.split(), *ELEMENTARY, *_OWN.split(), *CONSTANTS)
"""Words that cannot be names of values: keywords, functions, and names of parameters of procedures."""


WIDTH, LONGEST_LINE = 110, 132
"""Largest length of a line of comment, and of any line of Fortran."""

LARGE = 4096
"""Numbers in local arrays from which on a compiler might keep them where two threads share them."""


@dataclass(frozen=True)
class Names:
    """Names and helpers that the procedures of a module share.

    `abouts` are the descriptions of public procedures. `needed` collects the operations whose
    definitions the module needs.
    """

    module: str
    abouts: Mapping[Procedure, str]
    needed: dict[str, None] = field(default_factory=dict)


def comment(text: str, indent: str = "  ") -> list[str]:
    """Return the lines of a comment."""
    return [f"{indent}! {line}".rstrip() for line in wrapped(text, WIDTH)]


def subroutine(procedure: Procedure, names: Names) -> str:
    """Return a procedure as a subroutine; what it needs of the module is noted in the names."""
    return _FortranPrinter(procedure, names).function()


def short(line: str) -> list[str]:
    """Return a statement or a comment on lines that are short enough."""
    if line.lstrip().startswith("!"):
        return comment(line.lstrip()[1:].strip(), " " * (len(line) - len(line.lstrip())))
    return continued(line, LONGEST_LINE, "&")


def listed(head: str, names: Sequence[str], room: int = WIDTH) -> Iterator[str]:
    """Yield statements with a list of names, as many as fit on each."""
    line = ""
    for name in names:
        if line and len(head) + len(line) + len(name) > room:
            yield head + line
            line = ""
        line += f", {name}" if line else name
    if line:
        yield head + line


class _FortranPrinter(OffsetPrinter):
    """Prints one procedure."""

    language = "Fortran"
    operators = OPERATORS
    literals = LITERALS
    functions = FUNCTIONS
    helpers = HELPERS
    indent = "  "

    def __init__(self, procedure: Procedure, names: Names) -> None:
        self.names = names
        super().__init__(procedure, names.needed, (*RESERVED, names.module, procedure.name))
        self.depth = 2
        self.local: dict[str, list[str]] = {}
        """The local names of each type."""
        self.reserved = 0
        stem = "singular" if procedure in names.abouts else "found"
        self.found = [self.name(-1 - k, f"{stem}{k or ''}") for k in range(len(procedure.results))]

    def broken(self, line: str) -> list[str]:
        return short(line)

    def key(self, name: str) -> str:
        return name.lower()

    def head(self) -> list[str]:
        if self.lines and self.lines[-1] == f"{self.indent * 2}return":
            self.lines.pop()
        given = [*(self.text(one.ref) for one in self.procedure.parameters), *self.found]
        recursive = " recursive" if self.reserved > LARGE else ""
        lines = [f"  pure{recursive} subroutine {self.procedure.name}({', '.join(given)})"]
        lines += comment(self.names.abouts.get(self.procedure, self.procedure.about), "    ")
        for one in self.procedure.parameters:
            lines.append(f"    {self._given(one.type, self.text(one.ref))}")
        for kind, name in zip(self.procedure.results, self.found, strict=True):
            lines.append(f"    {KINDS[kind]}, intent(out) :: {name}")
        for type_name, names in self.local.items():
            lines += listed(f"    {type_name} :: ", names)
        return [*lines, *self._ignored()]

    def _given(self, kind: Any, name: str) -> str:
        if isinstance(kind, Kind):
            return f"{KINDS[kind]}, intent(in) :: {name}"
        return f"{KINDS[kind.kind]}, intent({'in' if kind.read else 'inout'}) :: {name}(0:*)"

    def _ignored(self) -> list[str]:
        """Return statements that use unused parameters, so that compilers do not warn of them."""
        shown = [f"{self.text(one.ref)}{'(0)' * isinstance(one.type, Array)}" for one in self.unused]
        if not shown:
            return []
        pairs = ", ".join(f"unused{k or ''} => {one}" for k, one in enumerate(shown))
        return [f"    associate ({pairs})", "    end associate"]

    def tail(self) -> list[str]:
        return [f"  end subroutine {self.procedure.name}"]

    def let(self, let: Let) -> None:
        if let.args and all(arg in self.constants for arg in let.args):
            # A compiler refuses 1.0/0.0 and what overflows, where all of it is constant.
            data = OPERATIONS[let.op](*(self.constants[arg] for arg in let.args))
            super().let(Let(let.ref, let.kind, CONSTANT, (), data))
        else:
            super().let(let)

    def operation(self, let: Let) -> tuple[int, str]:
        kind = self.kind(let.args[0])
        special = CONVERSIONS.get((let.op, kind))
        if special is None:
            return super().operation(let)
        if special.startswith("equal"):
            self.function_of("equal")
        return ATOM, special.format(*(self.text(one) for one in let.args))

    def define(self, name: str, kind: Kind, text: str) -> str:
        self._local(KINDS[kind], name)
        return f"{name} = {text}"

    def _local(self, kind: str, name: str) -> None:
        self.local.setdefault(kind, []).append(name)

    def assign(self, target: str, text: str) -> str:
        return f"{target} = {text}"

    def element(self, array: int, place: int) -> str:
        whole, index = self.index(array, place)
        return f"{self.text(whole)}({index})"

    def whole_text(self, text: str) -> str:
        return text if "(" in text else text.replace("_int64", "")

    def reserve(self, ref: int, array: Array) -> None:
        count = array.length
        self.reserved += count
        self._local(KINDS[array.kind], f"{self.name(ref)}(0:{count - 1})")

    def passed(self, ref: int) -> str:
        """Return an argument of a call: an array by its first element."""
        if not isinstance(self.types.get(ref), Array):
            return self.text(ref)
        whole, begin = self.beginning(ref)
        return self.text(whole) if begin is None else f"{self.text(whole)}({begin})"

    def call(self, call: Call) -> None:
        target = self.function_name(call.callee) if isinstance(call.callee, Procedure) else self.text(call.callee)
        given = [self.passed(one) for one in call.args]
        self.settle()
        for ref, kind in zip(call.refs, results_of(self, call), strict=True):
            self.types[ref] = kind
            self._local(KINDS[kind], self.name(ref))
            given.append(self.text(ref))
        self.put(f"call {target}({', '.join(given)})")

    def leave(self, values: Sequence[int]) -> None:
        texts = [self.text(value) for value in values]
        self.settle()
        for name, text in zip(self.found, texts, strict=True):
            self.put(self.assign(name, text))
        self.put("return")

    def comment(self, text: str) -> str:
        return f"! {text}".rstrip()

    def opening(self, kind: str, *texts: str) -> str:
        match kind, texts:
            case "for", (index, start, stop, step):
                names = self.local.setdefault(KINDS[Kind.WHOLE], [])
                if index not in names:
                    names.append(index)
                count = stop.removesuffix("_int64")
                last = f"{int(count) - 1}_int64" if count.isdigit() else f"{stop} - 1_int64"
                return f"do {index} = {start}, {last}{'' if step == '1' else f', {step}'}"
            case "forever", _:
                return "do"
            case "while", (condition,):
                return f"do while ({condition})"
            case "else", _:
                return "else"
            case _:
                return f"if ({texts[0]}) then"

    def closing(self, kind: str) -> str:
        return "end if" if kind == "if" else "end do"

    def leaving_loop(self) -> str:
        return "exit"

    def partial_sums(self, ref: int) -> None:
        self.reserve(ref, Array(REAL, PARTIAL))
        self.put(f"{self.text(ref)} = 0.0_dp")

    def partial(self, ref: int, place: str) -> str:
        return f"{self.text(ref)}({place})"

    def modulo(self, index: str) -> str:
        return f"mod({index}, {PARTIAL}_int64)"


CHUNK = 120
"""Numbers of a table in one statement, of which a compiler need not take more than 256 lines."""

ENVIRONMENT = "use, intrinsic :: iso_fortran_env, only: dp => real64, int64"


def _table(name: str, rows: Sequence[Sequence[float]]) -> Iterator[str]:
    """Yield the lines that assign a table of numbers, row by row."""
    values = [LITERALS.real(value) for row in rows for value in row]
    for k in range(0, len(values), CHUNK):
        part = values[k : k + CHUNK]
        yield from short(f"    {name}({k + 1}:{k + len(part)}) = [{', '.join(part)}]")


COMPARE = """\
  subroutine compare(name, state, found, wanted, allowed)
    character(*), intent(in) :: name
    integer, intent(in) :: state
    real(dp), intent(in) :: found(:), wanted(:), allowed(:)
    integer :: i
    do i = 1, size(found)
      checked = checked + 1
      if (.not. abs(found(i) - wanted(i)) <= allowed(i)) then
        failures = failures + 1
        write (*, '(2a, i0, a, i0, a, es25.16e3, a, es25.16e3)') &
          name, ', state ', state, ', result ', i, ': ', found(i), ' instead of ', wanted(i)
      end if
    end do
  end subroutine compare

  subroutine missing(name, count)
    character(*), intent(in) :: name
    integer, intent(in) :: count
    write (*, '(a)') name
    checked = checked + count
    failures = failures + count
  end subroutine missing
"""


def test_program(module: SourceModule, name: str) -> Iterator[str]:
    """Yield the test: a program that compares results with those of multiple precision."""
    yield ""
    yield f"#ifdef {macro(module, 'test')}"
    yield from comment(f"{TEST} Exit status 0 if all are right.", "")
    yield f"program {name}_test"
    yield f"  {ENVIRONMENT}"
    yield f"  use {name}"
    yield "  implicit none"
    yield "  real(dp) :: p(prepared_size)"
    yield "  integer :: failures = 0, checked = 0"
    yield "  logical :: no_values"
    yield "  call prepare(default_parameters, p, no_values)"
    yield "  if (no_values) call missing('prepare: a matrix is singular', 1)"
    yield from (f"  call test_{one}()" for one in tested(module))
    text = f"'{name}: ', checked - failures, ' of ', checked, ' results are right'"
    yield "  write (*, '(a, i0, a, i0, a)') &"
    yield f"    {text}"
    yield "  if (failures > 0) stop 1"
    yield ""
    yield "contains"
    yield ""
    yield COMPARE
    for check in module.checks:
        yield from _quantity_test(module, check)
    yield f"end program {name}_test"
    yield "#endif"


def _quantity_test(module: SourceModule, check: Check) -> Iterator[str]:
    """Yield the test of one subroutine."""
    count, states, size = len(check.results[0]), len(check.times), len(module.state)
    yield f"  subroutine test_{check.name}()"
    yield f"    real(dp), save :: times({states}), states({states * size})"
    yield f"    real(dp), save :: wanted({states * count}), allowed({states * count}), out({count})"
    yield "    logical :: singular"
    yield "    integer :: k"
    yield from _table("times", [check.times])
    for name, table in (("states", check.states), ("wanted", check.results), ("allowed", check.allowed)):
        yield from _table(name, table)
    yield f"    do k = 0, {states - 1}"
    yield f"      call {check.name}(times(k + 1), states({size} * k + 1), p, out, singular)"
    yield "      if (singular) then"
    yield f"        call missing('{check.name}: a matrix is singular', {count})"
    yield "      else"
    rows = f"wanted({count} * k + 1:{count} * (k + 1)), allowed({count} * k + 1:{count} * (k + 1))"
    yield from short(f"        call compare('{check.name}', k + 1, out, {rows})")
    yield "      end if"
    yield "    end do"
    yield f"  end subroutine test_{check.name}"
    yield ""


@register
class Fortran(Target):
    """Fortran 2008; see `Target`."""

    name = "fortran"
    about = "Fortran 2008: a module of pure subroutines in one source file, no dependencies, quantities only"
    contents = frozenset()

    def files(self, module: SourceModule) -> Mapping[str, str]:
        """Return the source file; the test is switched on by a macro."""
        return {f"{module.name}.F90": source(module)}

    def commands(self, module: SourceModule) -> list[str]:
        """Return the shell lines that compile and run the test."""
        return compiled(module, "test", "gfortran -std=f2008 -O2", f"{module.name}.F90")


def module_name(module: SourceModule) -> str:
    """Return the name of the Fortran module, which no other name of the file has."""
    taken = (*RESERVED, *CONSTANTS, *(one.name for one in module.procedures), *(name for name, _ in HELPERS.values()))
    stem = module.name[: LONGEST - len("_test")]
    return distinct([stem], taken, key=str.lower)[0]


def names_of(module: SourceModule) -> Names:
    """Return the names and helpers that the procedures of a module share."""
    return Names(module_name(module), {one: about_of(module, one) for one in module.public})


def source(module: SourceModule) -> str:
    """Return the source file."""
    names = names_of(module)
    printed = [subroutine(one, names) for one in module.procedures]
    lines = [
        *statement_comment(module, "!"),
        "",
        f"module {names.module}",
        "  use, intrinsic :: iso_fortran_env, only: dp => real64, int64",
        "  implicit none",
        "  private",
        *_public(module.public),
        "",
        *_constants(module),
        "",
        "contains",
        "",
        *printed,
        *(HELPERS[op][1] for op in sorted(names.needed)),
        f"end module {names.module}",
        *test_program(module, names.module),
    ]
    return "\n".join(lines).rstrip("\n") + "\n"


def _public(procedures: Sequence[Procedure]) -> Iterator[str]:
    yield from listed("  public :: ", [one.name for one in procedures])


def _constants(module: SourceModule) -> Iterator[str]:
    """Yield the lengths of all arrays, the default parameters, and what has no literal."""
    yield from comment("Arrays begin at 1 where you call, whatever they do here.")
    yield from comment(places("y", module.state, "{0}({1})", 1))
    yield from comment(places("parameters", module.parameters, "{0}({1})", 1))
    yield from comment(
        "Each subroutine of t, y and p says whether a matrix is singular to round-off: out is then not to be used."
    )
    yield ""
    for name, count, about in sizes(module):
        yield f"  integer, parameter, public :: {name}_size = {count} ! {about}"
    count = len(module.values)
    values = ", ".join(map(LITERALS.real, module.values))
    given = f"[real(dp) :: {values}]" if count else "[real(dp) ::]"
    yield from short(f"  real(dp), parameter, public :: default_parameters({count}) = {given}")
    for name, value in CONSTANTS.items():
        yield f"  real(dp), parameter :: {name} = {value}"
