"""Print statements on short vectors, which become LLVM vectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lagrange.machine.llvm.emitter import Emitter, suffix
from lagrange.machine.llvm.operations import KINDS, spell, splat, type_of
from lagrange.procedure.form import Gather, Kind, Reduce, Type, Vector, VectorLet, VectorLoad, VectorStore


@dataclass(frozen=True)
class Vectors:
    """State of a printer: its emitter, and the operand and type of each number."""

    e: Emitter
    values: Mapping[int, str]
    types: Mapping[int, Type]


def printed(known: Vectors, statement: VectorLet | Reduce | VectorLoad | Gather) -> str:
    """Print a statement that defines a vector, or a single value from a vector, and return its operand."""
    match statement:
        case VectorLet():
            return _operation(known, statement)
        case Reduce():
            return _reduced(known, statement)
        case Gather():
            return _gathered(known, statement)
        case VectorLoad():
            return _loaded(known, statement)


def _vector(known: Vectors, ref: int) -> Vector:
    """Return the type of a vector."""
    found = known.types[ref]
    assert isinstance(found, Vector)
    return found


def _operation(known: Vectors, let: VectorLet) -> str:
    """Print an operation on vectors and return its operand."""
    e, (kind, width), first = known.e, let.vector, known.values[let.args[0]]
    if let.op == "broadcast":
        return splat(e, first, kind, width)
    if let.op == "permute":
        given = type_of(kind, _vector(known, let.args[0]).width)
        return e.value(f"shufflevector {given} {first}, {given} poison, {_listed(let.places)}")
    kinds = tuple(_vector(known, arg).kind for arg in let.args)
    return spell(e, let.op, kinds, [known.values[arg] for arg in let.args], width)


def _reduced(known: Vectors, reduce: Reduce) -> str:
    """Return the sum of a vector, or the flag whether any of its entries is true."""
    e, value, (kind, width) = known.e, known.values[reduce.vector], _vector(known, reduce.vector)
    if reduce.op == "any":
        mask = e.value(f"bitcast <{width} x i1> {value} to i{width}")
        return e.value(f"icmp ne i{width} {mask}, 0")
    return _total(e, kind, value, width)


def _total(e: Emitter, kind: Kind, vector: str, width: int) -> str:
    """Return the sum of the entries of a vector; see `Reduce`."""
    while width > 1:
        whole, width = type_of(kind, width), width // 2
        halves = [
            e.value(f"extractelement {whole} {vector}, i64 {first}")
            if width == 1
            else e.value(f"shufflevector {whole} {vector}, {whole} poison, {_listed(range(first, first + width))}")
            for first in (0, width)
        ]
        vector = spell(e, "add", (kind, kind), halves, width)
    return vector


def _listed(places: Sequence[int]) -> str:
    """Return the mask of a `shufflevector`."""
    return f"<{len(places)} x i32> <{', '.join(f'i32 {place}' for place in places)}>"


def _gathered(known: Vectors, gather: Gather) -> str:
    """Return the entries of an array at the indices in a vector."""
    e, (kind, width), made = known.e, gather.vector, "poison"
    for k in range(width):
        place = e.value(f"extractelement <{width} x i64> {known.values[gather.places]}, i64 {k}")
        value = e.get(known.values[gather.array], place, KINDS[kind])
        made = e.value(f"insertelement {type_of(kind, width)} {made}, {KINDS[kind]} {value}, i64 {k}")
    return made


def _place(known: Vectors, one: VectorLoad | VectorStore, vector: Vector) -> tuple[str, str]:
    """Return the address of the first entry, and the mask as an operand, or an empty string without a mask."""
    place = known.e.address(known.values[one.array], known.values[one.place], KINDS[vector.kind])
    return place, "" if one.mask is None else f"<{vector.width} x i1> {known.values[one.mask]}"


def _loaded(known: Vectors, load: VectorLoad) -> str:
    """Return adjacent entries of an array as a vector."""
    place, mask = _place(known, load, load.vector)
    vector = type_of(*load.vector)
    if not mask:
        return known.e.load(place, vector)
    given = f"ptr {place}, i32 8, {mask}, {vector} zeroinitializer"
    return known.e.value(f"call {vector} @llvm.masked.load.{suffix(vector)}.p0({given})")


def store(known: Vectors, store: VectorStore) -> None:
    """Print the store of a vector to adjacent entries of an array."""
    kind, value = _vector(known, store.value), known.values[store.value]
    place, mask = _place(known, store, kind)
    vector = type_of(*kind)
    if not mask:
        known.e.store(value, place, vector)
    else:
        name = f"llvm.masked.store.{suffix(vector)}.p0"
        known.e.do(f"call void @{name}({vector} {value}, ptr {place}, i32 8, {mask})")
