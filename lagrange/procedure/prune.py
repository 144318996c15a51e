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
            body, got, before = procedure.body, _variables_read(procedure.body), None
            while got != before:
                body = _Pass(self, got).block(body)
                before, got = got, _variables_read(body)
            found = self.known[procedure] = replace(procedure, body=body)
            self.known[found] = found
        return self.known[procedure]


class _Pass:
    """One pass from the end of a procedure to its begin; `got` are the variables that somebody reads."""

    def __init__(self, pruner: Pruner, got: frozenset[int]) -> None:
        self.pruner, self.got = pruner, got
        self.needed: set[int] = set()
        """What the statements behind the present one read."""

    def block(self, block: Block) -> Block:
        """Return a block without what nobody reads."""
        kept: list[Statement] = []
        for statement in reversed(block):
            if not self.idle(statement):
                kept.append(self.statement(statement))
        return tuple(reversed(kept))

    def statement(self, statement: Statement) -> Statement:
        """Return a statement with pruned blocks and callees, and note what it reads."""
        match statement:
            case Call(callee=Procedure() as callee):
                statement = statement._replace(callee=self.pruner.pruned(callee))
            case When(then=then, otherwise=otherwise):
                statement = statement._replace(then=self.block(then), otherwise=self.block(otherwise))
            case Loop(body=body):
                statement = statement._replace(body=self.block(body))
            case Each(folds=folds, body=body):
                self.needed |= {ref for fold in folds for ref in (fold.value, fold.factor) if ref is not None}
                statement = statement._replace(body=self.block(body))
            case Repeat(test=test, condition=condition, body=body):
                self.needed.add(condition)
                body = self.block(body)
                statement = statement._replace(test=self.block(test), body=body)
            case _:
                self.needed.update(reads((statement,)))
                return statement
        self.needed.update(_operands(statement))
        return statement

    def idle(self, statement: Statement) -> bool:
        """Whether nobody would miss a statement."""
        match statement:
            case Declare(ref=ref):
                return ref not in self.got
            case Set(variable=variable):
                return variable not in self.got
            case When(then=(), otherwise=()):
                return True
            case _:
                return isinstance(statement, MADE) and statement.ref not in self.needed


def _operands(statement: Statement) -> tuple[int, ...]:
    """Return what a call, a branch or a loop reads itself, without its blocks."""
    match statement:
        case Call(callee=callee, args=args):
            return args if isinstance(callee, Procedure) else (callee, *args)
        case When(condition=condition) | Repeat(condition=condition):
            return (condition,)
        case Loop(start=start, stop=stop):
            return start, stop
        case Each(iterations=count):
            return (count,)
        case _:
            return ()


def _variables_read(block: Block) -> frozenset[int]:
    """Return the variables that a block reads."""
    found: set[int] = set()
    for one in block:
        if isinstance(one, Get):
            found.add(one.variable)
        for body in inner(one):
            found |= _variables_read(body)
    return frozenset(found)
