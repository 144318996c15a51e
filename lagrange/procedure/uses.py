"""How often the values of a procedure are used."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.procedure.form import (
    Block,
    Call,
    Declare,
    Each,
    Get,
    Leave,
    Let,
    Load,
    Loop,
    Part,
    Read,
    Repeat,
    Set,
    Store,
    When,
    Write,
    inner,
)


def uses_of(block: Block) -> dict[int, int]:
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
            case _:
                continue
        loops = isinstance(statement, (Loop, Repeat, Each))
        for body in inner(statement):
            made = _defined(body)
            for ref, count in uses_of(body).items():
                found[ref] = found.get(ref, 0) + (count if ref in made or not loops else 2 * count)
    return found


def _defined(block: Block) -> frozenset[int]:
    """Return the values that a block defines."""
    here = (one.ref for one in block if isinstance(one, (Let, Load, Read, Get)))
    return frozenset(here).union(*(_defined(body) for one in block for body in inner(one)))


def loop_depth(block: Block) -> int:
    """Return how many loops stand inside one another at most."""
    depths = (loop_depth(body) + isinstance(one, (Loop, Each)) for one in block for body in inner(one))
    return max(depths, default=0)
