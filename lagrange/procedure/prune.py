"""Procedures without statements whose results nobody reads."""

from __future__ import annotations

from dataclasses import replace

from lagrange.procedure.bind import reads
from lagrange.procedure.form import (
    Block,
    Call,
    Declare,
    Each,
    Get,
    Let,
    Load,
    Loop,
    Part,
    Procedure,
    Read,
    Repeat,
    Reserve,
    ReserveRecord,
    Set,
    Statement,
    When,
    inner,
)

MADE = (Let, Load, Read, Part, Reserve, ReserveRecord, Get)
"""Statements that make a value or memory, and do nothing else."""


class Pruner:
    """Prunes procedures that call each other, each once."""

    def __init__(self) -> None:
        self.known: dict[Procedure, Procedure] = {}

    def pruned(self, procedure: Procedure) -> Procedure:
        """Return a procedure without what is never read, here and in all that it calls."""
        if procedure not in self.known:
            body, before = procedure.body, None
            while body != before:
                before, read, got = body, reads(body), _variables_read(body)
                body = self.block(body, read, got)
            found = self.known[procedure] = replace(procedure, body=body)
            self.known[found] = found
        return self.known[procedure]

    def block(self, block: Block, read: frozenset[int], got: frozenset[int]) -> Block:
        """Return a block without values that are not read and variables that nobody gets."""
        return tuple(self.statement(one, read, got) for one in block if not _idle(one, read, got))

    def statement(self, statement: Statement, read: frozenset[int], got: frozenset[int]) -> Statement:
        """Return a statement with pruned blocks and callees."""
        match statement:
            case Call(callee=Procedure() as callee):
                return statement._replace(callee=self.pruned(callee))
            case When(then=then, otherwise=otherwise):
                return statement._replace(then=self.block(then, read, got), otherwise=self.block(otherwise, read, got))
            case Loop(body=body) | Each(body=body):
                return statement._replace(body=self.block(body, read, got))
            case Repeat(test=test, body=body):
                return statement._replace(test=self.block(test, read, got), body=self.block(body, read, got))
            case _:
                return statement


def _idle(statement: Statement, read: frozenset[int], got: frozenset[int]) -> bool:
    """Whether nobody would miss a statement."""
    match statement:
        case Declare(ref=ref):
            return ref not in got
        case Set(variable=variable):
            return variable not in got
        case When(then=(), otherwise=()):
            return True
        case _:
            return isinstance(statement, MADE) and statement.ref not in read


def _variables_read(block: Block) -> frozenset[int]:
    """Return the variables that a block reads."""
    here = frozenset(one.variable for one in block if isinstance(one, Get))
    return here.union(*(_variables_read(body) for one in block for body in inner(one)))
