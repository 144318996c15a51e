"""Analysis: which values of a procedure differ between members that run in parallel lanes.

A member is one of several runs of the procedure with different arguments. A value differs if it depends on an argument
that differs, or if members may have taken different branches. All other values are common: they are computed once for
all members.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from lagrange.errors import LagrangeError
from lagrange.procedure.form import (
    Array,
    Block,
    Call,
    Declare,
    Each,
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
    Repeat,
    Reserve,
    ReserveRecord,
    Set,
    SineCosine,
    Store,
    When,
    Write,
    inner,
)
from lagrange.procedure.visit import Visitor, defined, operands, visits


class Share(NamedTuple):
    """Whether an argument is the same for all members: `own` is true if it differs between members.

    An array is `apart` if the part that a member uses begins at another index for each member.
    """

    own: bool
    apart: bool = False


COMMON, OWN = Share(own=False), Share(own=True)

Signature = tuple[Share, ...]


def signature_of(call: Call, own: Container[int], apart: Container[int]) -> Signature:
    """Return the `Share` of each argument of a call.

    `own` has the ids of values that differ between members, `apart` the ids of arrays whose parts begin at different
    indices.
    """
    assert isinstance(call.callee, Procedure)
    return tuple(
        Share(arg in own, not isinstance(one.type, Kind) and arg in apart)
        for one, arg in zip(call.callee.parameters, call.args, strict=True)
    )


@dataclass(frozen=True)
class Spread:
    """Result of the analysis: ids in `own` belong to values, variables and memory that differ between members.

    Arrays in `apart` begin at another index for each member. With `parting`, members may return at different
    statements. `results` has a flag for each result: true if it differs.
    """

    own: frozenset[int]
    apart: frozenset[int]
    parting: bool
    results: tuple[bool, ...]


@dataclass
class Spreads:
    """Cache of the analyses of procedures, by procedure and signature."""

    known: dict[tuple[Procedure, Signature], Spread] = field(default_factory=dict)

    def of(self, procedure: Procedure, signature: Signature) -> Spread:
        """Return the analysis of a procedure for a signature, which says which arguments differ between members."""
        key = procedure, signature
        if key not in self.known:
            self.known[key] = _SpreadSearch(self, procedure, signature).spread()
        return self.known[key]


class _SpreadSearch(Visitor):
    """Fixed-point iteration over a procedure: passes are repeated until no further value differs.

    One pass is not enough, because variables carry values to the next iteration of a loop.
    """

    def __init__(self, spreads: Spreads, procedure: Procedure, signature: Signature) -> None:
        self.spreads, self.procedure = spreads, procedure
        self.own: dict[int, None] = {}
        self.apart: dict[int, None] = {}
        self.written: dict[int, None] = {}
        """Arrays that are written."""
        self.parted = self.parting = False
        self.results = [False] * len(procedure.results)
        for parameter, share in zip(procedure.parameters, signature, strict=True):
            self.mark(parameter.ref, own=share.own, apart=share.apart)
            if isinstance(parameter.type, Array) and not parameter.type.read:
                self.written[parameter.ref] = None

    def spread(self) -> Spread:
        """Run passes until nothing changes, and return the result."""
        before = None
        while before != (before := self.size()):
            self.block(self.procedure.body, parted=False)
        results = tuple(self.parting or own for own in self.results)
        return Spread(frozenset(self.own), frozenset(self.apart), self.parting, results)

    def size(self) -> tuple[int, ...]:
        """Return counts of the ids and results that differ. They grow until the iteration ends."""
        return len(self.own), len(self.apart), self.parting, sum(self.results)

    def mark(self, ref: int, *, own: bool, apart: bool = False) -> None:
        """Record that a value differs between members (`own`), or that array parts begin at different indices."""
        if own:
            self.own[ref] = None
        if apart:
            self.apart[ref] = None

    def differs(self, refs: Iterable[int]) -> bool:
        """Return True if the value of one of the ids differs between members."""
        return any(ref in self.own for ref in refs)

    def block(self, block: Block, *, parted: bool) -> None:
        """Visit the statements of a block. `parted` is true if only some of the members reach them."""
        before, self.parted = self.parted, parted
        for statement in block:
            self.statement(statement)
        self.parted = before

    @visits(Note, Store, Write)
    def defines_nothing(self, statement: Note | Store | Write) -> None:
        """Visit a statement without results: there is nothing to record."""

    @visits(Let, SineCosine, Read)
    def operation(self, statement: Let | SineCosine | Read) -> None:
        """Record the results of an operation, which differ between members if an operand does."""
        for ref in defined(statement):
            self.mark(ref, own=self.differs(operands(statement)))

    @visits(Load)
    def load(self, load: Load) -> None:
        """Record whether an element of an array differs between members."""
        array = load.array
        common = array not in self.own and array not in self.apart and array not in self.written
        self.mark(load.ref, own=not common or load.place in self.own)

    @visits(Reserve, ReserveRecord)
    def local(self, one: Reserve | ReserveRecord) -> None:
        """Record whether a local array or record differs between members."""
        self.mark(one.ref, own=True)

    @visits(Part)
    def part(self, part: Part) -> None:
        """Record whether a part of an array differs between members."""
        self.mark(part.ref, own=part.array in self.own, apart=part.array in self.apart or part.start in self.own)
        if part.array in self.written:
            self.written[part.ref] = None

    @visits(Declare, Get, Set)
    def variable(self, statement: Declare | Get | Set) -> None:
        """Record whether a variable, or the value read from it or assigned to it, differs between members."""
        match statement:
            case Declare(ref=ref, value=value) | Get(ref=ref, variable=value):
                self.mark(ref, own=value in self.own)
            case Set(variable=variable, value=value):
                self.mark(variable, own=self.parted or value in self.own)

    @visits(Leave)
    def leave(self, leave: Leave) -> None:
        """Record which results of the procedure differ between members."""
        self.parting |= self.parted
        self.results = [own or ref in self.own for own, ref in zip(self.results, leave.values, strict=True)]

    @visits(When, Loop, Repeat, Each)
    def control(self, statement: When | Loop | Repeat | Each) -> None:
        """Visit the blocks of a branch or a loop."""
        parted = self.parted
        match statement:
            case When(condition=condition) | Repeat(condition=condition):
                for body in inner(statement):
                    self.block(body, parted=parted or condition in self.own)
            case Loop(place=place, start=start, stop=stop, body=body):
                self.mark(place, own=start in self.own)
                self.block(body, parted=parted or self.differs((start, stop)))
            case Each(iterations=count, body=body, folds=folds):
                self.block(body, parted=parted or count in self.own)
                for fold in folds:
                    values = (fold.value,) if fold.factor is None else (fold.value, fold.factor)
                    self.mark(fold.ref, own=count in self.own or self.differs(values))

    @visits(Call)
    def call(self, call: Call) -> None:
        """Record which results of a call differ between members."""
        callee = call.callee
        if not isinstance(callee, Procedure):
            raise LagrangeError(f"procedure {self.procedure.name} calls a function that is not bound.")
        found = self.spreads.of(callee, signature_of(call, self.own, self.apart))
        for ref, own in zip(call.refs, found.results, strict=True):
            self.mark(ref, own=own)
