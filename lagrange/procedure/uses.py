"""What the statements of a procedure read, and how often its values are used."""

from __future__ import annotations

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
    Procedure,
    Read,
    Repeat,
    Set,
    SineCosine,
    Statement,
    Store,
    When,
    Write,
    inner,
)


def operands(statement: Statement) -> tuple[int, ...]:
    """Return the numbers of all that a statement reads itself, without its blocks.

    An angle is read once for its sine and once for its cosine. Parts of arrays and records to which it writes are among
    them, variables are not.
    """
    match statement:
        case Let(args=args) | Leave(values=args):
            return args
        case Call(callee=callee, args=args):
            return args if isinstance(callee, Procedure) else (callee, *args)
        case SineCosine(angle=angle):
            return angle, angle
        case Part(array=array, start=place) | Load(array=array, place=place):
            return array, place
        case Store(array=array, place=place, value=value):
            return array, place, value
        case Read(record=record):
            return (record,)
        case Write(record=record, value=value):
            return record, value
        case Declare(value=value) | Set(value=value):
            return (value,)
        case When(condition=condition) | Repeat(condition=condition):
            return (condition,)
        case Loop(start=start, stop=stop):
            return start, stop
        case Each(iterations=count, folds=folds):
            return count, *(ref for fold in folds for ref in (fold.value, fold.factor) if ref is not None)
        case _:
            return ()


def reads(block: Block) -> frozenset[int]:
    """Return the numbers of all that a block reads."""
    inside = (reads(body) for statement in block for body in inner(statement))
    return frozenset(ref for statement in block for ref in operands(statement)).union(*inside)


def uses_of(block: Block) -> dict[int, int]:
    """Count how often each value is used; what is used inside of a loop that does not make it counts as often."""
    found: dict[int, int] = {}
    for statement in block:
        for ref in operands(statement):
            found[ref] = found.get(ref, 0) + 1
        loops = isinstance(statement, (Loop, Repeat, Each))
        for body in inner(statement):
            made = _defined(body)
            for ref, count in uses_of(body).items():
                found[ref] = found.get(ref, 0) + (count if ref in made or not loops else 2 * count)
    return found


def _defined(block: Block) -> frozenset[int]:
    """Return the values that a block defines."""
    here = (one.ref for one in block if isinstance(one, (Let, Load, Read, Get)))
    pairs = (ref for one in block if isinstance(one, SineCosine) for ref in (one.sine, one.cosine))
    return frozenset(here).union(pairs, *(_defined(body) for one in block for body in inner(one)))


def loop_depth(block: Block) -> int:
    """Return how many loops stand inside one another at most."""
    depths = (loop_depth(body) + isinstance(one, (Loop, Each)) for one in block for body in inner(one))
    return max(depths, default=0)
