"""Live variables: names that a branch or loop sets, and that are read after it or in its next iteration.

Only such names may have to be variables of a procedure. Every other name is a value inside its block. Source: A. V. Aho
et al., Compilers, 2nd ed., 2006, section 9.2.5 (live variables), applied to a syntax tree.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import NamedTuple

Names = frozenset[str]
NOTHING: Names = frozenset()


class Carried(NamedTuple):
    """Names that a branch or loop sets, and that are read after it or in its next iteration.

    `on` has all these names, which are called carried.
    """

    on: Names
    anew: Names = NOTHING
    """Carried names that all branches set, so that their values before the statement do not matter."""

    across: Names = NOTHING
    """Carried names that one branch sets, and another branch reads before it sets them."""


def carried(body: Sequence[ast.stmt]) -> Mapping[ast.stmt, Carried]:
    """Return for each branch and loop of a function the names that it sets and that are read later."""
    if not any(isinstance(statement, (ast.If, ast.For, ast.While)) for statement in body):
        return {}
    kept = frozenset(name for statement in body for name in mentions(statement).later)
    names: dict[ast.stmt, Carried] = {}
    _Walk(kept, names).block(body, kept)
    return names


class Mentions(NamedTuple):
    """The names that a node of the syntax tree reads and sets."""

    loaded: Names = NOTHING
    """Names that are read, or set in place, without the targets of comprehensions and functions."""

    stored: tuple[str, ...] = ()
    """Names that are set, in order, without the names that functions and comprehensions inside set."""

    later: Names = NOTHING
    """Names that functions inside read when they are called later."""

    returns: bool = False
    """True if the node contains a `return`."""


@cache
def mentions(node: ast.AST) -> Mentions:
    """Return the names that a node of the syntax tree reads and sets, including the nodes inside it."""
    if isinstance(node, ast.Name):
        if isinstance(node.ctx, ast.Load):
            return Mentions(frozenset((node.id,)))
        return Mentions(stored=(node.id,))
    inside = [mentions(child) for child in _children(node)]
    if not inside:
        return RETURNS if isinstance(node, ast.Return) else EMPTY
    read = NOTHING.union(*[part.loaded for part in inside])
    later = NOTHING.union(*[part.later for part in inside])
    names = tuple(dict.fromkeys([name for part in inside for name in part.stored]))
    match node:
        case ast.ListComp() | ast.GeneratorExp():
            return Mentions(read - frozenset(names), (), later)
        case ast.Lambda():
            read -= {arg.arg for arg in node.args.args}
            return Mentions(read, (), later | read)
        case ast.FunctionDef():
            read -= {arg.arg for arg in node.args.args}
            return Mentions(read, (node.name,), later | read)
        case ast.AugAssign(target=ast.Name(id=name)):
            read |= {name}
    return Mentions(read, names, later, isinstance(node, ast.Return) or any(part.returns for part in inside))


EMPTY, RETURNS = Mentions(), Mentions(returns=True)
LEAVES = ("ctx", "op", "ops", "annotation", "returns")
"""Fields of syntax nodes without names that are read or set at run time."""


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the direct children of a node of the syntax tree. Fields that cannot contain names are left out."""
    for field in node._fields:
        if field not in LEAVES:
            value = getattr(node, field, None)
            if isinstance(value, ast.AST):
                yield value
            elif isinstance(value, list):
                for child in value:
                    if isinstance(child, ast.AST):
                        yield child


def loaded(nodes: Iterable[ast.AST]) -> Names:
    """Return the names that nodes of the syntax tree read, or change by an augmented assignment such as `x += 1`.

    Targets of comprehensions and parameters of inner functions are left out.
    """
    return NOTHING.union(*[mentions(node).loaded for node in nodes])


def stored(nodes: Iterable[ast.AST]) -> list[str]:
    """Return the names that nodes of the syntax tree set, in order, without those of inner functions.

    Targets of comprehensions are not included either.
    """
    return list(dict.fromkeys([name for node in nodes for name in mentions(node).stored]))


class _Walk:
    """Live-variable analysis of a function, backwards from its end.

    `kept` are names that inner functions may read at any time. The names that each branch or loop sets for later are
    written to `carried`.
    """

    def __init__(self, kept: Names, carried: dict[ast.stmt, Carried]) -> None:
        self.kept, self.carried = kept, carried

    def block(self, body: Sequence[ast.stmt], live: Names) -> Names:
        """Return the names that are live before a block: they may be read before they are set again.

        `live` are the names that are live after the block.
        """
        for statement in reversed(body):
            live = self.statement(statement, live)
        return live

    def statement(self, s: ast.stmt, live: Names) -> Names:
        match s:
            case ast.If(test=test, body=body, orelse=orelse):
                otherwise = self.block(orelse, live)
                front = self.block(body, live) | otherwise
                on = frozenset(stored([s])) & live
                self.carried[s] = Carried(on, on - front, frozenset(stored(body)) & otherwise - live)
                return loaded([test]) | front
            case ast.For(target=target, iter=iterable, body=body):
                targets = frozenset(stored([target]))
                return loaded([iterable]) | self.loop(s, body, live, loaded([target]), targets)
            case ast.While(test=test, body=body):
                return self.loop(s, body, live, loaded([test]), NOTHING)
            case ast.Return(value=value):
                return loaded([value]) | self.kept if value is not None else self.kept
            case ast.FunctionDef(name=name):
                return live - {name} | self.kept
        return (live - frozenset(stored([s]))) | loaded([s]) | self.kept

    def loop(self, s: ast.stmt, body: Sequence[ast.stmt], after: Names, read: Names, targets: Names) -> Names:
        """Return the names that are live before the loop `s`: they may be read before they are set again.

        `after` are the names that are live after the loop. `read` are the names that the head of the loop reads, and
        `targets` the names that each iteration sets at its start.
        """
        live = after | read
        while True:
            before = self.block(body, live) - targets
            if before <= live:
                break
            live |= before
        self.carried[s] = Carried(frozenset(stored([s])) & live)
        return live
