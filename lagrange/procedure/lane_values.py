"""Values of a procedure that differ between members of an ensemble, and values that all members share.

A member is one of several runs of the original procedure; each lane of a vector holds the value of one member. A value
is varying if it depends on a varying argument, or if members may have taken different branches. All other values are
uniform: they are computed once for all members.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import (
    CONSTANT,
    FLAG,
    Array,
    Block,
    Kind,
    Procedure,
    Statement,
    Vector,
    inner,
    of_width,
    walk,
)
from lagrange.procedure.visit import defined, operands


class Variation(NamedTuple):
    """Variation of an argument between members: `varying` is true if each has its own value, false if all share one.

    An array is `shifted` if the part that a member uses begins at a different index for each member.
    """

    varying: bool
    shifted: bool = False


UNIFORM, VARYING = Variation(varying=False), Variation(varying=True)

Signature = tuple[Variation, ...]


def signature_of(call: form.Call, differing: Container[int], shifted: Container[int]) -> Signature:
    """Return the `Variation` of each argument of a call.

    `differing` has the ids of values that differ between members, `shifted` the ids of arrays whose parts begin at
    different indices.
    """
    assert isinstance(call.callee, Procedure)
    return tuple(
        Variation(arg in differing, not isinstance(parameter.type, Kind) and arg in shifted)
        for parameter, arg in zip(call.callee.parameters, call.args, strict=True)
    )


@dataclass(frozen=True)
class ProcedureVariation:
    """Variation of a procedure: `varying` has the ids of values, variables and memory that differ between members.

    Arrays in `shifted` begin at a different index for each member. With `returns_early`, members may return at
    different statements. `results` has a flag for each result: true if it differs.
    """

    varying: frozenset[int]
    shifted: frozenset[int]
    returns_early: bool
    results: tuple[bool, ...]


Analyses = dict[tuple[Procedure, Signature], ProcedureVariation]
"""Cache of the analyses of procedures, by procedure and signature."""


def variation_of(procedure: Procedure, signature: Signature, known: Analyses) -> ProcedureVariation:
    """Return the values, arrays and results of a procedure that differ between members.

    `signature` says which arguments differ. `known` caches the analyses of all procedures so far.
    """
    key = procedure, signature
    if key not in known:
        known[key] = _VariationSearch(known, procedure, signature).result()
    return known[key]


class _VariationSearch:
    """Fixed-point iteration over a procedure: passes are repeated until none marks a further value as varying.

    One pass is not enough, because variables carry values to the next iteration of a loop.
    """

    def __init__(self, analyses: Analyses, procedure: Procedure, signature: Signature) -> None:
        self.analyses, self.procedure = analyses, procedure
        self.varying: set[int] = set()
        self.shifted: set[int] = set()
        self.written: set[int] = set()
        """Ids of the arrays among the parameters that the procedure may write, and of their parts."""
        self.returns_early = False
        self.results = [False] * len(procedure.results)
        for parameter, variation in zip(procedure.parameters, signature, strict=True):
            self.mark(parameter.ref, differs=variation.varying, shifted=variation.shifted)
            if isinstance(parameter.type, Array) and not parameter.type.read:
                self.written.add(parameter.ref)

    def result(self) -> ProcedureVariation:
        """Run passes until no further value differs between members, and return the values that differ."""
        before = None
        # The counts of ids and results that differ grow until the iteration ends.
        while before != (before := (len(self.varying), len(self.shifted), self.returns_early, sum(self.results))):
            self.block(self.procedure.body, masked=False)
        results = tuple(self.returns_early or differs for differs in self.results)
        return ProcedureVariation(frozenset(self.varying), frozenset(self.shifted), self.returns_early, results)

    def mark(self, ref: int, *, differs: bool, shifted: bool = False) -> None:
        """Record that the value `ref` differs between members if `differs`.

        If `shifted`, record that the parts of the array `ref` begin at a different index for each member.
        """
        if differs:
            self.varying.add(ref)
        if shifted:
            self.shifted.add(ref)

    def block(self, block: Block, *, masked: bool) -> None:
        """Record the ids in a block that differ between members. `masked` is true if only some members reach it."""
        for statement in block:
            self.statement(statement, masked=masked)

    def statement(self, statement: Statement, *, masked: bool) -> None:
        """Record the ids that a statement defines or sets and that differ between members.

        `masked` is true if only some of the members reach the statement.
        """
        match statement:
            case form.Load(ref=ref, array=array, place=index):
                common = (
                    self.varying.isdisjoint((array, index)) and array not in self.shifted and array not in self.written
                )
                self.mark(ref, differs=not common)
            case form.Reserve(ref=ref) | form.ReserveRecord(ref=ref):
                self.mark(ref, differs=True)
            case form.Part(ref=ref, array=array, start=start):
                self.mark(ref, differs=array in self.varying, shifted=array in self.shifted or start in self.varying)
                if array in self.written:
                    self.written.add(ref)
            case form.Declare(ref=ref, value=value) | form.Get(ref=ref, variable=value):
                self.mark(ref, differs=value in self.varying)
            case form.Set(variable=variable, value=value):
                self.mark(variable, differs=masked or value in self.varying)
            case form.Leave(values=values):
                self.returns_early |= masked
                self.results = [
                    differs or ref in self.varying for differs, ref in zip(self.results, values, strict=True)
                ]
            case form.When(condition=condition) | form.Repeat(condition=condition):
                for body in inner(statement):
                    self.block(body, masked=masked or condition in self.varying)
            case form.Loop(place=index, start=start, stop=stop, body=body):
                self.mark(index, differs=start in self.varying)
                self.block(body, masked=masked or not self.varying.isdisjoint((start, stop)))
            case form.Each(iterations=count, body=body, folds=folds):
                self.block(body, masked=masked or count in self.varying)
                for fold in folds:
                    self.mark(fold.ref, differs=not self.varying.isdisjoint((count, fold.value, fold.factor)))
            case form.Call():
                self.call(statement)
            case _:
                # An operation: its results differ if an operand does. Other statements define nothing.
                for ref in defined(statement):
                    self.mark(ref, differs=not self.varying.isdisjoint(operands(statement)))

    def call(self, call: form.Call) -> None:
        """Record which results of a call differ between members."""
        if not isinstance(call.callee, Procedure):
            raise LagrangeError(f"procedure {self.procedure.name} calls a parameter: bind a function to it before.")
        variation = variation_of(call.callee, signature_of(call, self.varying, self.shifted), self.analyses)
        for ref, differs in zip(call.refs, variation.results, strict=True):
            self.mark(ref, differs=differs)


SHORT_BRANCH = 8
"""Largest number of operations in a branch statement for which both branches are computed for all members."""

_ARITHMETIC = ("add", "sub", "mul", "neg", "abs", "min", "max", "fma", "fnma", "copysign", "sign", "magnitude", "real")
CHEAP = frozenset((*_ARITHMETIC, "less", "less_equal", "equal", "and", "or", "not", "select", CONSTANT))
"""Operations that cost less than a branch. None of them has side effects."""


@dataclass(frozen=True)
class MemberMemory:
    """An array or a record of the new procedure, which runs all members at once.

    `varying` is true if each member has its own values; the values of all members at one index are then adjacent.
    `starts` is the id of a vector of first indices, one for each member, or None if they are equal. `level` is the
    number of enclosing branches that only some members take, at the allocation, or -1 for an array of the caller.
    """

    ref: int
    varying: bool
    starts: int | None = None
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
        """Return a new id: of a value of the given kind, a vector if `wide`; or of memory, if `kind` is None."""
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

        `kind` is the kind of the result. The result is a vector if an operand is a vector, or if `wide` is true.
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
        """Return the id of the intersection of two masks. `other` may be undefined outside `mask`."""
        return self.put("select", FLAG, mask, other, self.constant(FLAG, value=False))

    def without(self, mask: int, gone: int) -> int:
        """Return the id of the mask `mask` without the members in the mask `gone`."""
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


def leaves(block: Block) -> bool:
    """Return True if a block contains a return from the procedure."""
    return any(isinstance(statement, form.Leave) for statement in walk(block))


def is_cheap(when: form.When) -> bool:
    """Return True if it is faster to compute both branches than to test whether any member takes each of them."""
    both = (*when.then, *when.otherwise)
    operations = [statement for statement in both if isinstance(statement, form.Let)]
    simple = all(isinstance(statement, (form.Let, form.Get, form.Set, form.Note)) for statement in both)
    return simple and len(operations) <= SHORT_BRANCH and all(statement.op in CHEAP for statement in operations)
