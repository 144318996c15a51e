"""The start of a series in machine code: statements of a procedure, printed into the function of a jet.

Order 0 is a straight-line program, and small matrices are eliminated as those of kernels are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from lagrange.machine.kernel.llvm_module import SCALAR
from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.procedures import INLINE_ANGLES, Printer
from lagrange.procedure.builder import Builder
from lagrange.procedure.form import REAL, Array, Procedure, Type
from lagrange.procedure.kernel import elimination
from lagrange.procedure.kernel.body import Body, Inputs
from lagrange.procedure.kernel.prepared import Prepared
from lagrange.procedure.operations import ANGLES
from lagrange.procedure.values import Memory, Real
from lagrange.program.elimination import WRITTEN_OUT, Elimination
from lagrange.program.program import Program

ALONE = replace(SCALAR, systems=1)
"""Each system is solved alone."""


def angles(program: Program) -> list[int]:
    """Return the results whose sine or cosine is computed, each once."""
    return list(dict.fromkeys(i.args[0] for i in program.instructions if i.op in ANGLES))


def shares_angle_function(program: Program) -> bool:
    """Return whether sine and cosine are a function of the module."""
    return len(angles(program)) > INLINE_ANGLES


class LlvmStart:
    """Emits instructions of a program for one state, and what else a jet needs on its way."""

    def __init__(self, program: Program) -> None:
        self.program, self.e = program, Emitter()
        self.p = Builder(program.name, "The start of a series.")
        self.printer = Printer(self.p.finish(), e=self.e, angles=len(angles(program)))
        self.printed = 0
        prepared = Prepared.of([program], WRITTEN_OUT)
        held = Memory(self.p, self.known("%p", kind := Array(read=True)), kind)
        slots = prepared.of_program(program)
        self.body = Body(self.p, program, Inputs(held, slots, self.real("%t"), largest=WRITTEN_OUT), ALONE)
        self.by_code = {instruction: i for i, instruction in enumerate(program.instructions)}
        self.singular: list[str] = []
        self.called: dict[Procedure, None] = {}
        """The procedures of other modules that are called by name, in order."""
        self.reserved: dict[tuple[str, str, int], str] = {}

    def known(self, operand: str, kind: Type) -> int:
        """Print the statements added so far, and return a new number for an operand."""
        self.print()
        ref = self.p.unused()
        self.printer.define(ref, operand, kind)
        return ref

    def real(self, operand: str) -> Real:
        """Return an operand as a value."""
        return Real(self.p, self.known(operand, REAL))

    def print(self) -> None:
        """Print the statements that were added."""
        for statement in self.p.current[self.printed :]:
            self.printer.statement(statement)
        self.printed = len(self.p.current)

    def text(self, ref: int) -> str:
        """Return the operand of a number."""
        self.print()
        return self.printer.values[ref]

    @property
    def there(self) -> Iterable[int]:
        """The instructions with a value."""
        return self.body.values

    def give(self, i: int, operand: str) -> None:
        """Set the value of an instruction."""
        self.body.values[i] = self.real(operand)

    def ref(self, i: int) -> str:
        """Return the value of an instruction."""
        return self.text(self.body.value(i).ref)

    def run(self, refs: Iterable[int]) -> None:
        """Emit some instructions, each after those that it reads."""
        self.body.run(refs)
        self.print()

    def factor(self, plan: Elimination, lower: Mapping[tuple[int, int], str]) -> tuple[list[str], str]:
        """Return the entries of L by `places` of the plan, with 1/d on its diagonal, and whether pivots are trusted."""
        entries, trusted = elimination.factored(self.p, plan, {place: self.real(a) for place, a in lower.items()})
        found = [self.text(entries[place].ref) if place in entries else literal(0.0) for place in plan.places]
        return found, self.text(trusted.ref)

    def solve(self, plan: Elimination, entry: Callable[[int, int], str], right: Sequence[str]) -> list[str]:
        """Return the solution with an L whose entries a function gives, each where it is used."""
        given = [None if value == literal(0.0) else self.real(value) for value in right]
        found = elimination.solved(self.p, plan, _Entries(self, plan, entry), given)
        return [self.text(x.ref) for x in found]

    def name_of(self, procedure: Procedure) -> str:
        """Return the name of a procedure of another module, to be called."""
        self.called[procedure] = None
        return procedure.name

    def scratch(self, purpose: str, kind: str, count: int) -> str:
        """Return memory for one purpose, written before every use."""
        key = (purpose, kind, count)
        if key not in self.reserved:
            self.reserved[key] = self.e.reserve(kind, count)
        return self.reserved[key]

    def status(self) -> str:
        """Return 1 if any matrix was singular."""
        failed = [] if self.body.singular is None else [self.text(self.body.singular.value.ref)]
        tests = [*failed, *self.singular]
        if not tests:
            return "0"
        total = tests[0]
        for other in tests[1:]:
            total = self.e.value(f"or i1 {total}, {other}")
        return self.e.value(f"zext i1 {total} to i32")


class _Entries(Mapping[tuple[int, int], Real]):
    """The entries of L, each an operand of its own wherever it is read."""

    def __init__(self, start: LlvmStart, plan: Elimination, entry: Callable[[int, int], str]) -> None:
        self.start, self.places, self.entry = start, dict.fromkeys(plan.places), entry

    def __getitem__(self, place: tuple[int, int]) -> Real:
        if place not in self.places:
            raise KeyError(place)
        self.start.print()
        operand = self.entry(*place)
        if operand == literal(0.0) and place[0] != place[1]:
            raise KeyError(place)
        return self.start.real(operand)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)
