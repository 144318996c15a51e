"""Print procedures as subroutines of Fortran."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lagrange.export.comments import wrapped
from lagrange.export.languages.fortran_spelling import (
    CONVERSIONS,
    FUNCTIONS,
    HELPERS,
    KINDS,
    LITERALS,
    OPERATORS,
    RESERVED,
)
from lagrange.export.lines import continued
from lagrange.export.offset_printer import OffsetPrinter
from lagrange.procedure.form import CONSTANT, PARTIAL, REAL, Array, Call, Kind, Let, Procedure
from lagrange.procedure.interpreter import OPERATIONS
from lagrange.procedure.source_printer import results_of
from lagrange.procedure.spelling import ATOM

WIDTH, LONGEST_LINE = 110, 132
"""Characters of a line of comment, and those that a line of Fortran may have."""

LARGE = 4096
"""Numbers in local arrays from which on a compiler might keep them where two threads share them."""


@dataclass(frozen=True)
class Names:
    """What the procedures of a module share.

    `abouts` says what those do that users call. `needed` collects the operations whose definitions the module needs.
    """

    module: str
    abouts: Mapping[Procedure, str]
    needed: dict[str, None] = field(default_factory=dict)


def comment(text: str, indent: str = "  ") -> list[str]:
    """Return a comment, broken where it is long."""
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
        """Return what keeps compilers from warning of parameters that are not used."""
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
