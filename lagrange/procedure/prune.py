"""Remove statements whose results are never read from procedures."""

from __future__ import annotations

from dataclasses import replace

from lagrange.procedure.form import (
    Block,
    Call,
    Declare,
    Gather,
    Get,
    Let,
    Load,
    Part,
    Procedure,
    Read,
    Reduce,
    Reserve,
    ReserveRecord,
    Set,
    SineCosine,
    Statement,
    VectorLet,
    VectorLoad,
    When,
    rebuilt,
    walk,
)
from lagrange.procedure.visit import defined, operands

MADE = (Let, SineCosine, VectorLet, Reduce, VectorLoad, Gather, Load, Read, Part, Reserve, ReserveRecord, Get)
"""Statements that define a value or memory, without other effects."""


class Pruner:
    """Prunes procedures that call each other, each only once."""

    def __init__(self) -> None:
        self.known: dict[Procedure, Procedure] = {}

    def pruned(self, procedure: Procedure) -> Procedure:
        """Return a procedure without values that are never read, here and in its callees."""
        if procedure not in self.known:
            body, got, before = procedure.body, _variables_read(procedure.body), None
            while got != before:
                body = _Pass(self, got).block(body)
                before, got = got, _variables_read(body)
            found = self.known[procedure] = replace(procedure, body=body)
            self.known[found] = found
        return self.known[procedure]


class _Pass:
    """One backward pass over a procedure. `got` are the variables that are read anywhere."""

    def __init__(self, pruner: Pruner, got: frozenset[int]) -> None:
        self.pruner, self.got = pruner, got
        self.needed: set[int] = set()
        """Numbers that later statements read."""

    def block(self, block: Block) -> Block:
        """Return a block without statements whose results are never read."""
        kept: list[Statement] = []
        for statement in reversed(block):
            if not self.idle(statement):
                kept.append(self.statement(statement))
        return tuple(reversed(kept))

    def statement(self, statement: Statement) -> Statement:
        """Return a statement with pruned blocks and callees, and record the numbers that it reads."""
        self.needed.update(operands(statement))
        if isinstance(statement, Call) and isinstance(statement.callee, Procedure):
            return statement._replace(callee=self.pruner.pruned(statement.callee))
        return rebuilt(statement, self.block)

    def idle(self, statement: Statement) -> bool:
        """Return True if a statement has no effect on results."""
        match statement:
            case Declare(ref=ref):
                return ref not in self.got
            case Set(variable=variable):
                return variable not in self.got
            case When(then=(), otherwise=()):
                return True
            case _:
                return isinstance(statement, MADE) and self.needed.isdisjoint(defined(statement))


def _variables_read(block: Block) -> frozenset[int]:
    """Return the variables that a block reads."""
    return frozenset(one.variable for one in walk(block) if isinstance(one, Get))
