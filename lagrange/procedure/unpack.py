"""Rewrite procedures without short vectors: each entry becomes a value."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

from lagrange.procedure.form import (
    CONSTANT,
    REAL,
    VECTOR_STATEMENTS,
    WHOLE,
    Block,
    Declare,
    Gather,
    Get,
    Kind,
    Let,
    Load,
    Procedure,
    Reduce,
    Set,
    SineCosine,
    Statement,
    Store,
    Vector,
    VectorLet,
    VectorLoad,
    VectorStore,
    When,
    rebuilt,
    walk,
)
from lagrange.procedure.visit import defined, renamed


def unpacked(procedure: Procedure) -> Procedure:
    """Return a procedure with numbers and flags in the place of vectors, or the procedure itself without vectors.

    Callees are not unpacked here; their printers do that.
    """
    statements = list(walk(procedure.body))
    if not any(isinstance(one, VECTOR_STATEMENTS) for one in statements):
        return procedure
    refs = [parameter.ref for parameter in procedure.parameters]
    refs += [ref for one in statements for ref in (*defined(one), *((one.ref,) if isinstance(one, Declare) else ()))]
    return replace(procedure, body=_Unpacker(max(refs) + 1).block(procedure.body))


class _Unpacker:
    """Rewrites blocks; `entries` are the numbers of the entries of each vector."""

    def __init__(self, first: int) -> None:
        self.unused = count(first)
        self.entries: dict[int, tuple[int, ...]] = {}
        self.same: dict[int, int] = {}
        """The entries that are read as single values, by the number of that."""
        self.out: list[Statement] = []

    def block(self, block: Block) -> Block:
        """Return a block without vectors."""
        outside, self.out = self.out, []
        for statement in block:
            statement = renamed(statement, self.same)
            match statement:
                case SineCosine(angle=angle) if angle in self.entries:
                    pairs = [SineCosine(next(self.unused), next(self.unused), one) for one in self.entries[angle]]
                    self.out += pairs
                    self.entries[statement.sine] = tuple(pair.sine for pair in pairs)
                    self.entries[statement.cosine] = tuple(pair.cosine for pair in pairs)
                case Declare(ref=ref, kind=Vector(kind=kind)):
                    first, self.entries[ref] = self.entries[statement.value], self.numbers(statement.kind)
                    self.out += [Declare(one, kind, x) for one, x in zip(self.entries[ref], first, strict=True)]
                case Get(ref=ref, kind=Vector(kind=kind)):
                    self.entries[ref] = self.numbers(statement.kind)
                    pairs_of = zip(self.entries[ref], self.entries[statement.variable], strict=True)
                    self.out += [Get(one, kind, variable) for one, variable in pairs_of]
                case Set(variable=variable, value=value) if value in self.entries:
                    pairs_of = zip(self.entries[variable], self.entries[value], strict=True)
                    self.out += [Set(one, x) for one, x in pairs_of]
                case VectorLet():
                    self.entries[statement.ref] = self.vector(statement)
                case Reduce(op="entry"):
                    self.same[statement.ref] = self.entries[statement.vector][statement.place]
                case Reduce():
                    self.reduce(statement)
                case VectorLoad(vector=vector, place=place, mask=mask):
                    places = self.side_by_side(place, vector.width)
                    flags = None if mask is None else self.entries[mask]
                    self.entries[statement.ref] = self.loaded(statement, places, flags)
                case Gather(places=wanted):
                    self.entries[statement.ref] = self.loaded(statement, self.entries[wanted], None)
                case VectorStore():
                    self.store(statement)
                case _:
                    self.out.append(rebuilt(statement, self.block))
        made, self.out = tuple(self.out), outside
        return made

    def let(self, kind: Kind, op: str, args: tuple[int, ...], data: float | None = None) -> int:
        """Add an operation, and return the number of its result."""
        ref = next(self.unused)
        self.out.append(Let(ref, kind, op, args, data))
        return ref

    def numbers(self, vector: Kind | Vector) -> tuple[int, ...]:
        """Return new numbers for the entries of a vector."""
        return tuple(next(self.unused) for _ in range(vector.width if isinstance(vector, Vector) else 1))

    def vector(self, let: VectorLet) -> tuple[int, ...]:
        """Return the entries of an operation."""
        args = [self.entries.get(arg, (arg,)) for arg in let.args]
        if let.op == "permute":
            entries = [entry for arg in args for entry in arg]
            return tuple(entries[place] for place in let.places)
        return tuple(self.let(let.vector.kind, let.op, operands) for operands in zip(*args, strict=True))

    def reduce(self, reduce: Reduce) -> None:
        """Add the operations of a sum, or of the test whether any flag is true."""
        op, left = "or" if reduce.op == "any" else "add", list(self.entries[reduce.vector])
        while len(left) > 1:
            half = len(left) // 2
            refs = [reduce.ref] if half == 1 else [next(self.unused) for _ in range(half)]
            pairs = zip(refs, left[:half], left[half:], strict=True)
            self.out += [Let(ref, reduce.kind, op, (a, b)) for ref, a, b in pairs]
            left = refs

    def side_by_side(self, place: int, width: int) -> tuple[int, ...]:
        """Return `width` successive indices, the first of which is `place`."""
        steps = [self.let(WHOLE, CONSTANT, (), k) for k in range(1, width)]
        return place, *(self.let(WHOLE, "add", (place, step)) for step in steps)

    def loaded(
        self, load: VectorLoad | Gather, places: tuple[int, ...], flags: tuple[int, ...] | None
    ) -> tuple[int, ...]:
        """Return entries of an array, zero where a flag is false."""
        kind, refs = load.vector.kind, []
        for k, place in enumerate(places):
            ref = next(self.unused)
            refs.append(ref)
            read = Load(ref, kind, load.array, place)
            if flags is None:
                self.out.append(read)
                continue
            variable, inside = next(self.unused), next(self.unused)
            zero = self.let(kind, CONSTANT, (), 0.0 if kind is REAL else 0)
            then = (read._replace(ref=inside), Set(variable, inside))
            self.out += [Declare(variable, kind, zero), When(flags[k], then), Get(ref, kind, variable)]
        return tuple(refs)

    def store(self, store: VectorStore) -> None:
        """Write the entries of a vector."""
        entries = self.entries[store.value]
        for k, (place, value) in enumerate(zip(self.side_by_side(store.place, len(entries)), entries, strict=True)):
            written = Store(store.array, place, value)
            self.out.append(written if store.mask is None else When(self.entries[store.mask][k], (written,)))
