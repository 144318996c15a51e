"""Analysis: which values of a procedure differ between members that run in parallel lanes.

A member is one of several runs of the procedure with different arguments. A value differs if it depends on an argument
that differs, or if members may have taken different branches. All other values are common: they are computed once for
all members.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from typing import NamedTuple

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import Array, Block, Kind, Procedure, Statement, inner
from lagrange.procedure.visit import defined, operands


class Share(NamedTuple):
    """How members share an argument: `own` is true if each member has its own value, false if all have the same.

    An array is also `apart` if the part that a member uses begins at another index for each member.
    """

    own: bool
    apart: bool = False


COMMON, OWN = Share(own=False), Share(own=True)

Signature = tuple[Share, ...]


def signature_of(call: form.Call, differing: Container[int], apart: Container[int]) -> Signature:
    """Return the `Share` of each argument of a call.

    `differing` has the ids of values that differ between members, `apart` the ids of arrays whose parts begin at
    different indices.
    """
    assert isinstance(call.callee, Procedure)
    return tuple(
        Share(arg in differing, not isinstance(parameter.type, Kind) and arg in apart)
        for parameter, arg in zip(call.callee.parameters, call.args, strict=True)
    )


@dataclass(frozen=True)
class Spread:
    """Result of the analysis: `own` has the ids of values, variables and memory that differ between members.

    Arrays in `apart` begin at another index for each member. With `parting`, members may return at different
    statements. `results` has a flag for each result: true if it differs.
    """

    own: frozenset[int]
    apart: frozenset[int]
    parting: bool
    results: tuple[bool, ...]


Spreads = dict[tuple[Procedure, Signature], Spread]
"""Cache of the analyses of procedures, by procedure and signature."""


def spread_of(procedure: Procedure, signature: Signature, known: Spreads) -> Spread:
    """Return which values, arrays and results of a procedure differ between members.

    `signature` says which arguments differ. `known` caches the analyses of all procedures so far.
    """
    key = procedure, signature
    if key not in known:
        known[key] = _SpreadSearch(known, procedure, signature).spread()
    return known[key]


class _SpreadSearch:
    """Fixed-point iteration over a procedure: passes are repeated until no further value differs.

    One pass is not enough, because variables carry values to the next iteration of a loop.
    """

    def __init__(self, spreads: Spreads, procedure: Procedure, signature: Signature) -> None:
        self.spreads, self.procedure = spreads, procedure
        self.own: set[int] = set()
        self.apart: set[int] = set()
        self.written: set[int] = set()
        """Arrays that are written."""
        self.parting = False
        self.results = [False] * len(procedure.results)
        for parameter, share in zip(procedure.parameters, signature, strict=True):
            self.mark(parameter.ref, differs=share.own, apart=share.apart)
            if isinstance(parameter.type, Array) and not parameter.type.read:
                self.written.add(parameter.ref)

    def spread(self) -> Spread:
        """Run passes until no further value differs between members, and return the values that differ."""
        before = None
        # The counts of ids and results that differ grow until the iteration ends.
        while before != (before := (len(self.own), len(self.apart), self.parting, sum(self.results))):
            self.block(self.procedure.body, parted=False)
        results = tuple(self.parting or differs for differs in self.results)
        return Spread(frozenset(self.own), frozenset(self.apart), self.parting, results)

    def mark(self, ref: int, *, differs: bool, apart: bool = False) -> None:
        """Record that the value `ref` differs between members, or that an array begins at different indices.

        `apart` is true for the latter.
        """
        if differs:
            self.own.add(ref)
        if apart:
            self.apart.add(ref)

    def block(self, block: Block, *, parted: bool) -> None:
        """Record which ids in a block differ between members. `parted` is true if only some members reach it."""
        for statement in block:
            self.statement(statement, parted=parted)

    def statement(self, statement: Statement, *, parted: bool) -> None:
        """Record which of the ids that a statement defines or sets differ between members.

        `parted` is true if only some of the members reach the statement.
        """
        match statement:
            case form.Load(ref=ref, array=array, place=index):
                common = self.own.isdisjoint((array, index)) and array not in self.apart and array not in self.written
                self.mark(ref, differs=not common)
            case form.Reserve(ref=ref) | form.ReserveRecord(ref=ref):
                self.mark(ref, differs=True)
            case form.Part(ref=ref, array=array, start=start):
                self.mark(ref, differs=array in self.own, apart=array in self.apart or start in self.own)
                if array in self.written:
                    self.written.add(ref)
            case form.Declare(ref=ref, value=value) | form.Get(ref=ref, variable=value):
                self.mark(ref, differs=value in self.own)
            case form.Set(variable=variable, value=value):
                self.mark(variable, differs=parted or value in self.own)
            case form.Leave(values=values):
                self.parting |= parted
                self.results = [differs or ref in self.own for differs, ref in zip(self.results, values, strict=True)]
            case form.When(condition=condition) | form.Repeat(condition=condition):
                for body in inner(statement):
                    self.block(body, parted=parted or condition in self.own)
            case form.Loop(place=index, start=start, stop=stop, body=body):
                self.mark(index, differs=start in self.own)
                self.block(body, parted=parted or not self.own.isdisjoint((start, stop)))
            case form.Each(iterations=count, body=body, folds=folds):
                self.block(body, parted=parted or count in self.own)
                for fold in folds:
                    self.mark(fold.ref, differs=not self.own.isdisjoint((count, fold.value, fold.factor)))
            case form.Call():
                self.call(statement)
            case _:
                # An operation: its results differ if an operand does. Other statements define nothing.
                for ref in defined(statement):
                    self.mark(ref, differs=not self.own.isdisjoint(operands(statement)))

    def call(self, call: form.Call) -> None:
        """Record which results of a call differ between members."""
        if not isinstance(call.callee, Procedure):
            raise LagrangeError(f"procedure {self.procedure.name} calls a parameter: bind a function to it before.")
        spread = spread_of(call.callee, signature_of(call, self.own, self.apart), self.spreads)
        for ref, differs in zip(call.refs, spread.results, strict=True):
            self.mark(ref, differs=differs)
