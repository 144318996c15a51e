"""Numbers, vectors, memory and variables of a procedure that runs many members at once.

A member is one of several runs of the original procedure; each lane of a vector holds the value of one member.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

from lagrange.procedure import form
from lagrange.procedure.form import CONSTANT, FLAG, Block, Kind, Procedure, Statement, Vector, of_width, walk

SHORT_BRANCH = 8
"""Largest number of operations of a branch for which both sides are computed for all members."""

_ARITHMETIC = ("add", "sub", "mul", "neg", "abs", "min", "max", "fma", "fnma", "copysign", "sign", "magnitude", "real")
CHEAP = frozenset((*_ARITHMETIC, "less", "less_equal", "equal", "and", "or", "not", "select", CONSTANT))
"""Operations that cost less than a branch. None of them has side effects."""


@dataclass(frozen=True)
class MemberMemory:
    """An array or a record of the new procedure, which runs all members at once.

    `own` is true if each member has its own values: the values of all members at one index are then adjacent in
    memory. `apart` is None if the array begins at the same index for all members, else the id of a vector of their
    first indices. `level` is the number of enclosing branches that only some members take, at the allocation, or -1
    for an array of the caller.
    """

    ref: int
    own: bool
    apart: int | None = None
    level: int = -1


class MemberVariable(NamedTuple):
    """A variable of the new procedure, which runs all members at once.

    `level` is the number of enclosing branches, at its declaration, that only some members take.
    """

    ref: int
    kind: Kind
    level: int


class MemberStatements:
    """Collects the statements of a new procedure, with the kind and width (single or vector) of each id."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.out: list[Statement] = []
        self.unused = count()
        self.kinds: dict[int, Kind] = {}
        self.vectors: set[int] = set()
        self.constants: dict[int, float | int | bool] = {}

    def new(self, kind: Kind | None = None, *, wide: bool = False) -> int:
        """Return a new id: of a value of the given kind, a vector if `wide`; or, if `kind` is None, of memory."""
        ref = next(self.unused)
        if kind is not None:
            self.kinds[ref] = kind
        if wide:
            self.vectors.add(ref)
        return ref

    def vector(self, kind: Kind) -> Vector:
        """Return the type of a vector with one entry for each member."""
        return Vector(kind, self.lanes)

    def constant(self, kind: Kind, value: float) -> int:
        """Add a constant of a kind and return its id."""
        ref = self.new(kind)
        self.constants[ref] = value
        self.out.append(form.Let(ref, kind, CONSTANT, (), value))
        return ref

    def wide(self, ref: int) -> int:
        """Return the id of a value as a vector. A single number is copied to all entries."""
        if ref in self.vectors:
            return ref
        made = self.new(self.kinds[ref], wide=True)
        self.out.append(form.VectorLet(made, self.vector(self.kinds[ref]), "permute", (ref,), (0,) * self.lanes))
        return made

    def put(self, op: str, kind: Kind, *args: int, wide: bool = False) -> int:
        """Add the operation `op` on the values with the ids `args`, and return the id of its result.

        `kind` is the kind of the result. It is a vector if an operand is one, or if `wide` is true.
        """
        if not wide and self.vectors.isdisjoint(args):
            ref = self.new(kind)
            self.out.append(form.Let(ref, kind, op, args))
            return ref
        vectors = tuple(self.wide(arg) for arg in args)
        ref = self.new(kind, wide=True)
        self.out.append(form.VectorLet(ref, self.vector(kind), op, vectors))
        return ref

    def loaded(self, array: int, index: int, kind: Kind) -> int:
        """Add the read of a vector, one array entry for each member, and return its id.

        The entries are adjacent. `array` is the id of the array, and `index` the id of the index of the first entry.
        """
        ref = self.new(kind, wide=True)
        self.out.append(form.VectorLoad(ref, self.vector(kind), array, index))
        return ref

    def call(self, callee: Procedure, args: Sequence[int]) -> tuple[int, ...]:
        """Add a call of a procedure for all lanes, and return the ids of its results."""
        refs = []
        for result in callee.results:
            kind, wide = (result.kind, True) if isinstance(result, Vector) else (result, False)
            refs.append(self.new(kind, wide=wide))
        self.out.append(form.Call(tuple(refs), callee, tuple(args)))
        return tuple(refs)

    # --- masks and variables

    def both(self, mask: int, other: int) -> int:
        """Return the id of the mask of the members that are in two masks. `other` may be undefined outside `mask`."""
        return self.put("select", FLAG, mask, other, self.constant(FLAG, value=False))

    def without(self, mask: int, gone: int) -> int:
        """Return the id of the mask of those members of `mask` that are not in the mask `gone`."""
        return self.put("select", FLAG, gone, self.constant(FLAG, value=False), mask)

    def some(self, mask: int) -> int:
        """Return the id of a flag that is true if the mask contains any member."""
        ref = self.new(FLAG)
        self.out.append(form.Reduce(ref, FLAG, "any", mask))
        return ref

    def got(self, variable: MemberVariable) -> int:
        """Add the read of a variable and return the id of its value."""
        wide = variable.ref in self.vectors
        ref = self.new(variable.kind, wide=wide)
        self.out.append(form.Get(ref, of_width(variable.kind, self.lanes if wide else 1), variable.ref))
        return ref

    def set(self, variable: MemberVariable, value: int) -> None:
        """Add an assignment to a variable for all members."""
        self.out.append(form.Set(variable.ref, value))


def leaves(block: Block) -> bool:
    """Return True if a block contains a return from the procedure."""
    return any(isinstance(statement, form.Leave) for statement in walk(block))


def is_cheap(when: form.When) -> bool:
    """Return True if it is faster to compute both branches than to test whether any member takes each of them."""
    both = (*when.then, *when.otherwise)
    operations = [statement for statement in both if isinstance(statement, form.Let)]
    simple = all(isinstance(statement, (form.Let, form.Get, form.Set, form.Note)) for statement in both)
    return simple and len(operations) <= SHORT_BRANCH and all(statement.op in CHEAP for statement in operations)
