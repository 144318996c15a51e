"""Print a procedure as Python source, and load it: plain floats and integers, arrays by place, nothing else needed.

Names are made here and literals are exact, so no text of a user's is ever run. What has no value is NaN or infinite, as
in machine code: where Python would raise, a function of `interpreter.OPERATIONS` stands. Products and sums are rounded
one by one, so the digits of `fma` are those of two operations.
"""

from __future__ import annotations

import keyword
import math
import re
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from lagrange.procedure.form import (
    CONSTANT,
    PARTIAL,
    REAL,
    SUMS,
    Array,
    Block,
    Call,
    Declare,
    Each,
    Fold,
    Get,
    Kind,
    Leave,
    Let,
    Load,
    Loop,
    Note,
    Part,
    Procedure,
    Read,
    Record,
    Repeat,
    Reserve,
    Set,
    Statement,
    Store,
    When,
    Write,
    inner,
)
from lagrange.procedure.interpreter import OPERATIONS, Span

SPELLED: Mapping[str, tuple[int, str]] = {
    "select": (1, "{1} if {0} else {2}"),
    "or": (2, "{0} or {1}"),
    "and": (3, "{0} and {1}"),
    "not": (4, "not {0}"),
    "less": (5, "{0} < {1}"),
    "less_equal": (5, "{0} <= {1}"),
    "equal": (5, "{0} == {1}"),
    "add": (6, "{0} + {1}"),
    "sub": (6, "{0} - {1}"),
    "fma": (6, "{0} * {1} + {2}"),
    "mul": (7, "{0} * {1}"),
    "neg": (8, "-{0}"),
    "abs": (9, "abs({0})"),
    "real": (9, "float({0})"),
    "whole": (9, "int({0})"),
}
"""Python operators: their precedence and their text. The other operations are functions."""

OPERANDS: Mapping[str, tuple[int, ...]] = {
    "select": (2, 2, 1),
    "or": (2, 3),
    "and": (3, 4),
    "not": (4,),
    "less": (6, 6),
    "less_equal": (6, 6),
    "equal": (6, 6),
    "add": (6, 7),
    "sub": (6, 7),
    "fma": (7, 8, 7),
    "mul": (7, 8),
    "neg": (8,),
}
"""The least precedence of each operand that needs no parentheses."""

TURNED = {"less": ">", "less_equal": ">="}
"""Comparisons with the operands exchanged, for a constant that comes first."""

ATOM = 10

INDICES = ("i", "j", "k", "l", "i5", "i6", "i7", "i8")
"""Names of loop indices, from the outermost on."""

LONGEST_VALUE = 60
"""A value of this many characters gets a name."""


def source(procedure: Procedure) -> str:
    """Return Python source of a procedure and of all that it calls: one function each, callees first."""
    return "\n\n".join(Printer(one).function() for one in (*procedure.callees, procedure))


def loaded(procedure: Procedure) -> Callable[..., Any]:
    """Return a procedure as a Python function.

    Arrays are memory views, which are quickest, or anything with places, or a `Span` of one. It returns nothing, a
    value or a tuple of values.
    """
    names: dict[str, Any] = {f"_{op}": function for op, function in OPERATIONS.items() if op not in SPELLED}
    names |= {"_part": part_of, "_reals": _reals, "_wholes": _wholes, "nan": math.nan, "inf": math.inf}
    made = defined(source(procedure), procedure.name, names)
    arrays = [isinstance(parameter.type, Array) for parameter in procedure.parameters]

    def run(*args: Any) -> Any:
        pairs = zip(args, arrays, strict=True)
        return made(*[Span(arg) if array and not isinstance(arg, AS_THEY_ARE) else arg for arg, array in pairs])

    return run


def defined(text: str, name: str, names: Mapping[str, Any]) -> Callable[..., Any]:
    """Return the function of a name that printed source defines, which may use other names."""
    known = dict(names)
    exec(compile(text, f"<{name}>", "exec"), known)
    made: Callable[..., Any] = known[name]
    return made


AS_THEY_ARE = (memoryview, Span)
"""Arrays of which a part is an array."""


def part_of(array: Any, start: int) -> Any:
    """Return an array from one of its places on."""
    return array[start:] if isinstance(array, memoryview) else array.part(start)


def _reals(count: int) -> memoryview:
    return memoryview(array("d", [math.nan]) * count)


def _wholes(count: int) -> memoryview:
    return memoryview(array("q", [0]) * count)


class Printer:
    """Prints one procedure. A value that is used once stands where it is used, unless what it reads changes before."""

    def __init__(self, procedure: Procedure) -> None:
        self.procedure = procedure
        self.lines: list[str] = []
        self.texts: dict[int, tuple[int, str]] = {}
        """The text of each value, and how tightly it binds."""
        self.taken: dict[str, None] = {}
        self.uses = _uses(procedure.body)
        self.waiting: dict[int, None] = {}
        """The values that have been printed nowhere yet."""
        self.constants: dict[int, None] = {}
        self.depth = 1
        self.loops = 0
        self.taken |= dict.fromkeys((*INDICES, *(callee.name for callee in procedure.callees)))

    def function(self) -> str:
        """Return the function."""
        given = []
        for parameter in self.procedure.parameters:
            self.name(parameter.ref, parameter.name)
            given.append(self.texts[parameter.ref][1])
        self.block(self.procedure.body)
        head = [f"def {self.procedure.name}({', '.join(given)}):", f'    """{self.procedure.about}"""']
        return "\n".join([*head, *self.lines, ""])

    def name(self, ref: int, stem: str = "") -> str:
        """Choose an unused name for a value."""
        wanted = re.sub(r"\W", "_", stem or self.procedure.names.get(ref, f"x{ref}"))
        while wanted in self.taken or keyword.iskeyword(wanted) or wanted.startswith("_"):
            wanted = f"{wanted.strip('_')}{ref}"
        self.taken[wanted] = None
        self.texts[ref] = ATOM, wanted
        return wanted

    def write(self, line: str) -> None:
        """Print a statement, and before it the values that it might change."""
        self.settle()
        self.lines.append("    " * self.depth + line)

    def settle(self) -> None:
        """Assign every pending value to a name here."""
        for ref in list(self.waiting):
            _, text = self.texts[ref]
            self.lines.append("    " * self.depth + f"{self.name(ref)} = {text}")
        self.waiting.clear()

    def text(self, ref: int, least: int = 0) -> str:
        """Return a value as an operand, in parentheses where it binds less tightly than it must."""
        self.waiting.pop(ref, None)
        level, found = self.texts[ref]
        return found if level >= least else f"({found})"

    def block(self, block: Block) -> None:
        """Print statements."""
        before = len(self.lines)
        for statement in block:
            self.statement(statement)
        self.waiting.clear()
        if all(line.lstrip().startswith("#") for line in self.lines[before:]):
            self.write("pass")

    def inside(self, block: Block) -> None:
        """Print statements one level deeper."""
        self.depth += 1
        self.block(block)
        self.depth -= 1

    def statement(self, statement: Statement) -> None:
        """Print a statement."""
        match statement:
            case Let():
                self.let(statement)
            case Reserve(ref=ref, array=held):
                kind = "reals" if held.kind is REAL else "wholes"
                self.write(f"{self.name(ref)} = _{kind}({(held.size or 0) + held.room})")
            case Part(ref=ref, array=array, start=start):
                self.write(f"{self.name(ref)} = _part({self.text(array)}, {self.text(start)})")
            case Load() | Store() | Read() | Write():
                self.memory(statement)
            case Declare(ref=ref, value=value):
                self.write(f"{self.name(ref)} = {self.text(value)}")
            case Get(ref=ref, variable=variable):
                self.made(ref, ATOM, self.text(variable))
            case Set(variable=variable, value=value):
                self.write(f"{self.text(variable)} = {self.text(value)}")
            case Call():
                self.call(statement)
            case Leave(values=values):
                self.write(f"return {', '.join(self.text(value) for value in values)}".rstrip())
            case Note(text=text):
                self.write(f"# {text}")
            case When() | Loop() | Repeat() | Each():
                self.control(statement)

    def let(self, let: Let) -> None:
        """Print or keep an operation."""
        if let.op == CONSTANT:
            self.constants[let.ref] = None
            self.texts[let.ref] = literal(let.kind, let.data)
            return
        level, spelled = SPELLED.get(let.op, (9, f"_{let.op}({', '.join(f'{{{i}}}' for i in range(len(let.args)))})"))
        least = OPERANDS.get(let.op, (0,) * len(let.args))
        args = [self.text(arg, one) for arg, one in zip(let.args, least, strict=True)]
        if let.op in TURNED and let.args[0] in self.constants:
            spelled = f"{{1}} {TURNED[let.op]} {{0}}"
        found = spelled.format(*args)
        self.made(let.ref, level, found)

    def made(self, ref: int, level: int, text: str) -> None:
        """Keep a value for the place where it is used, or print it here: where it has a name, or is used more."""
        if self.uses.get(ref, 0) == 1 and len(text) < LONGEST_VALUE and ref not in self.procedure.names:
            self.texts[ref], self.waiting[ref] = (level, text), None
        elif ref in self.uses:
            self.lines.append("    " * self.depth + f"{self.name(ref)} = {text}")

    def memory(self, statement: Load | Store | Read | Write) -> None:
        """Print what is read or written."""
        match statement:
            case Load(ref=ref, array=array, place=index):
                self.made(ref, ATOM, f"{self.text(array)}[{self.text(index)}]")
            case Store(array=array, place=index, value=value):
                self.write(f"{self.text(array)}[{self.text(index)}] = {self.text(value)}")
            case Read(ref=ref, record=record, field=field):
                self.made(ref, ATOM, f"{self.text(record)}.{field}")
            case Write(record=record, field=field, value=value):
                self.write(f"{self.text(record)}.{field} = {self.text(value)}")

    def call(self, call: Call) -> None:
        """Print a call and name its results."""
        target = call.callee.name if isinstance(call.callee, Procedure) else self.text(call.callee)
        made = f"{target}({', '.join(self.text(arg) for arg in call.args)})"
        names = ", ".join(self.name(ref) for ref in call.refs)
        self.write(f"{names} = {made}" if names else made)

    def control(self, statement: When | Loop | Repeat | Each) -> None:
        """Print a branch or a loop."""
        match statement:
            case When(condition=condition, then=then, otherwise=otherwise):
                self.write(f"if {self.text(condition)}:")
                self.inside(then)
                if otherwise:
                    self.write("else:")
                    self.inside(otherwise)
            case Loop(place=index, start=start, stop=stop, step=step, body=body):
                places = [self.text(start), self.text(stop), *([str(step)] if step != 1 else [])]
                shown = places if places[0] != "0" or step != 1 else places[1:]
                self.iterations(index, ", ".join(shown), body)
            case Repeat(test=test, condition=condition, body=body):
                self.repeat(test, condition)
                self.inside(body)
            case Each():
                self.each(statement)

    def repeat(self, test: Block, condition: int) -> None:
        """Print the head of a loop under a condition, which stands inside where it takes more than a line."""
        self.settle()
        before = len(self.lines)
        self.depth += 1
        for statement in test:
            self.statement(statement)
        if len(self.lines) > before:
            self.write(f"if not {self.text(condition, 4)}:")
            self.lines += ["    " * (self.depth + 1) + "break"]
        self.depth -= 1
        head = "while True:" if len(self.lines) > before else f"while {self.text(condition)}:"
        self.lines.insert(before, "    " * self.depth + head)

    def iterations(self, index: int, places: str, body: Block) -> None:
        """Print a loop over places."""
        self.texts[index] = ATOM, INDICES[self.loops]
        self.write(f"for {INDICES[self.loops]} in range({places}):")
        self.loops += 1
        self.inside(body)
        self.loops -= 1

    def each(self, each: Each) -> None:
        """Print an `each` as a loop."""
        for fold in each.folds:
            start = {"add": f"[0.0] * {PARTIAL}", "dot": f"[0.0] * {PARTIAL}", "magnitude": "0.0"}.get(fold.op, "-inf")
            self.write(f"{self.name(fold.ref)} = {start}")
        self.iterations(each.place, self.text(each.iterations), each.body)
        self.depth += 1
        for fold in each.folds:
            self.write(self.folded(fold, self.text(each.place)))
        self.depth -= 1
        for fold in each.folds:
            name = self.text(fold.ref)
            if fold.op in SUMS:
                self.write(f"{name} = ({name}[0] + {name}[1]) + ({name}[2] + {name}[3])")

    def folded(self, fold: Fold, index: str) -> str:
        """Return the line that takes one more value of a fold."""
        name = self.text(fold.ref)
        if fold.op in ("max", "magnitude"):
            return f"{name} = _{fold.op}({name}, {self.text(fold.value)})"
        if fold.op == "most":
            value = self.text(fold.value)
            return f"{name} = {value} if {value} > {name} else {name}"
        factors = [self.text(fold.value)]
        if fold.factor is not None:
            factors = [self.text(fold.value, 7), self.text(fold.factor, 8)]
        return f"{name}[{index} % {PARTIAL}] += {' * '.join(factors)}"


def literal(kind: Kind, data: Any) -> tuple[int, str]:
    """Return a constant and how tightly it binds."""
    if kind is not REAL or math.isfinite(data):
        return (8 if not isinstance(data, bool) and data < 0 else ATOM), repr(data)
    return (8, "-inf") if data < 0 else (ATOM, "inf" if data > 0 else "nan")


def _uses(block: Block) -> dict[int, int]:
    """Count how often each value is used; what is used inside of a loop that does not make it counts as often."""
    found: dict[int, int] = {}

    def use(refs: Sequence[int]) -> None:
        for ref in refs:
            found[ref] = found.get(ref, 0) + 1

    for statement in block:
        match statement:
            case Let(args=args) | Call(args=args) | Leave(values=args):
                use(args)
            case Part(start=one) | Load(place=one) | Write(value=one) | Declare(value=one) | Set(value=one):
                use([one])
            case Store(place=index, value=value):
                use([index, value])
            case When(condition=one):
                use([one])
            case Loop(start=start, stop=stop):
                use([start, stop])
            case Each(iterations=count, folds=folds):
                use([count, *(ref for fold in folds for ref in (fold.value, fold.factor) if ref is not None)])
            case Repeat(condition=condition):
                use([condition])
            case Record() | Read() | Get() | Reserve() | Note():
                continue
        loops = isinstance(statement, (Loop, Repeat, Each))
        for body in inner(statement):
            made = _defined(body)
            for ref, count in _uses(body).items():
                found[ref] = found.get(ref, 0) + (count if ref in made or not loops else 2 * count)
    return found


def _defined(block: Block) -> frozenset[int]:
    """Return the values that a block defines."""
    here = (one.ref for one in block if isinstance(one, (Let, Load, Read, Get)))
    return frozenset(here).union(*(_defined(body) for one in block for body in inner(one)))
