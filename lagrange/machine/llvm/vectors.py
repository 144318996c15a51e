"""Print statements on short vectors of a procedure as operations on LLVM's vectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lagrange.machine.llvm.emitter import Emitter, suffix
from lagrange.machine.llvm.operations import KINDS, LIBRARY, spell, splat, type_of
from lagrange.machine.llvm.processor import call_library
from lagrange.procedure import form
from lagrange.procedure.form import WHOLE, Kind, Type, Vector


@dataclass(frozen=True)
class PrinterState:
    """What the printer of a procedure has defined: its emitter, and the operand and type of each value by id."""

    e: Emitter
    values: Mapping[int, str]
    types: Mapping[int, Type]


def printed(known: PrinterState, statement: form.VectorLet | form.Reduce | form.VectorLoad | form.Gather) -> str:
    """Print a statement that defines a vector, or a single value from a vector, and return its operand."""
    match statement:
        case form.VectorLet():
            return _operation(known, statement)
        case form.Reduce():
            return _reduced(known, statement)
        case form.Gather():
            return _gathered(known, statement)
        case form.VectorLoad():
            return _loaded(known, statement)


def _vector(known: PrinterState, ref: int) -> Vector:
    """Return the type of a vector."""
    vector = known.types[ref]
    assert isinstance(vector, Vector)
    return vector


def _operation(known: PrinterState, let: form.VectorLet) -> str:
    """Print an operation on vectors and return its operand."""
    e, (_, width) = known.e, let.vector
    if let.op == "permute":
        return _permuted(known, let)
    kinds, args = tuple(_vector(known, arg).kind for arg in let.args), [known.values[arg] for arg in let.args]
    return call_library(e, let.op, args, width) if let.op in LIBRARY else spell(e, let.op, kinds, args, width)


def _permuted(known: PrinterState, let: form.VectorLet) -> str:
    """Emit a vector made of entries of other vectors and of single values, and return its operand.

    The operation `permute` says which ones. Entries of each vector are moved and merged; single values are inserted.
    """
    e, (kind, width), begin = known.e, let.vector, 0
    single: dict[int, str] = {}
    made, filled = "", frozenset[int]()
    for arg in let.args:
        held = known.types[arg]
        count = held.width if isinstance(held, Vector) else 1
        sources = {k: source - begin for k, source in enumerate(let.places) if begin <= source < begin + count}
        begin += count
        if not sources or not isinstance(held, Vector):
            single |= dict.fromkeys(sources, known.values[arg])
            continue
        part = _moved(e, kind, known.values[arg], count, sources, width)
        made = _merged(e, kind, made, part, frozenset(sources), width) if made else part
        filled |= frozenset(sources)
    return _inserted(e, kind, made, filled, single, width) if single else made


def _moved(e: Emitter, kind: Kind, vector: str, count: int, sources: Mapping[int, int], width: int) -> str:
    """Emit a vector of `width` entries, taken from those of `vector`, and return its operand.

    `sources` maps an index in the new vector to an index in `vector`, which has `count` entries. Other entries are
    undefined.
    """
    if width == count and all(k == source for k, source in sources.items()):
        return vector
    mask = ", ".join(f"i32 {sources[k]}" if k in sources else "i32 poison" for k in range(width))
    vector_type = type_of(kind, count)
    return e.value(f"shufflevector {vector_type} {vector}, {vector_type} poison, <{width} x i32> <{mask}>")


def _merged(e: Emitter, kind: Kind, a: str, b: str, chosen: frozenset[int], width: int) -> str:
    """Return vector a with the entries at the indices `chosen` replaced by those of vector b."""
    vector_type = type_of(kind, width)
    indices = [width + k if k in chosen else k for k in range(width)]
    return e.value(f"shufflevector {vector_type} {a}, {vector_type} {b}, {_listed(indices)}")


def _inserted(e: Emitter, kind: Kind, made: str, filled: frozenset[int], single: Mapping[int, str], width: int) -> str:
    """Emit the vector `made` with single values inserted, and return its operand.

    `single` maps an index to a value; constants are inserted at once. The entries of `made` at the indices `filled`
    are defined. `made` may be empty.
    """
    values, name = list(dict.fromkeys(single.values())), KINDS[kind]
    if len(values) == 1 and not filled:
        return splat(e, values[0], kind, width)
    constants = {k: value for k, value in single.items() if not value.startswith("%")}
    if constants:
        entries = ", ".join(f"{name} {constants.get(k, 'poison')}" for k in range(width))
        made = _merged(e, kind, made, f"<{entries}>", frozenset(constants), width) if made else f"<{entries}>"
    vector = type_of(kind, width)
    for k, value in single.items():
        if k not in constants:
            made = e.value(f"insertelement {vector} {made or 'poison'}, {name} {value}, i64 {k}")
    return made


def _reduced(known: PrinterState, reduce: form.Reduce) -> str:
    """Emit what a `Reduce` statement takes from a vector, and return its operand.

    It is the sum of the entries, one entry, or the flag that is true if any entry is true.
    """
    e, value, (kind, width) = known.e, known.values[reduce.vector], _vector(known, reduce.vector)
    if reduce.op == "entry":
        return e.value(f"extractelement {type_of(kind, width)} {value}, i64 {reduce.place}")
    if reduce.op == "any":
        mask = e.value(f"bitcast <{width} x i1> {value} to i{width}")
        return e.value(f"icmp ne i{width} {mask}, 0")
    return _total(e, kind, value, width)


def _total(e: Emitter, kind: Kind, vector: str, width: int) -> str:
    """Emit the sum of the entries of a vector, in the order that `Reduce` defines, and return its operand."""
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


def _listed(indices: Sequence[int]) -> str:
    """Return indices of entries as the mask operand of LLVM's `shufflevector`."""
    return f"<{len(indices)} x i32> <{', '.join(f'i32 {index}' for index in indices)}>"


def _gathered(known: PrinterState, gather: form.Gather) -> str:
    """Emit the read of the entries of an array at the indices in a vector, and return the operand of the result."""
    e, (kind, width), made = known.e, gather.vector, "poison"
    if gather.mask is not None:
        vector = type_of(kind, width)
        arguments = f"{_pointers(known, gather, kind, width)}, i32 8, <{width} x i1> {known.values[gather.mask]}"
        name = f"llvm.masked.gather.{suffix(vector)}.v{width}p0"
        return e.value(f"call {vector} @{name}(<{width} x ptr> {arguments}, {vector} zeroinitializer)")
    for k in range(width):
        index = e.value(f"extractelement <{width} x i64> {known.values[gather.places]}, i64 {k}")
        value = e.get(known.values[gather.array], index, KINDS[kind])
        made = e.value(f"insertelement {type_of(kind, width)} {made}, {KINDS[kind]} {value}, i64 {k}")
    return made


def _pointers(known: PrinterState, statement: form.Gather | form.Scatter, kind: Kind, width: int) -> str:
    """Emit the addresses of the array entries that a gather reads or a scatter writes, as a vector of pointers."""
    indices = f"{type_of(WHOLE, width)} {known.values[statement.places]}"
    return known.e.value(f"getelementptr {KINDS[kind]}, ptr {known.values[statement.array]}, {indices}")


def _place(known: PrinterState, access: form.VectorLoad | form.VectorStore, vector: Vector) -> tuple[str, str]:
    """Return the address of the first entry that is read or written, and the mask as an operand.

    Without a mask the operand is an empty string.
    """
    address = known.e.address(known.values[access.array], known.values[access.place], KINDS[vector.kind])
    return address, "" if access.mask is None else f"<{vector.width} x i1> {known.values[access.mask]}"


def _loaded(known: PrinterState, load: form.VectorLoad) -> str:
    """Emit the read of adjacent entries of an array as a vector, and return the operand of the result."""
    address, mask = _place(known, load, load.vector)
    vector = type_of(*load.vector)
    if not mask:
        return known.e.load(address, vector)
    arguments = f"ptr {address}, i32 8, {mask}, {vector} zeroinitializer"
    return known.e.value(f"call {vector} @llvm.masked.load.{suffix(vector)}.p0({arguments})")


def scatter(known: PrinterState, scatter: form.Scatter) -> None:
    """Print the store of a vector to the entries of an array at the indices in another vector."""
    kind, width = _vector(known, scatter.value)
    vector, mask = type_of(kind, width), f"<{width} x i1> {known.values[scatter.mask]}"
    arguments = f"{vector} {known.values[scatter.value]}, <{width} x ptr> {_pointers(known, scatter, kind, width)}"
    known.e.do(f"call void @llvm.masked.scatter.{suffix(vector)}.v{width}p0({arguments}, i32 8, {mask})")


def store(known: PrinterState, store: form.VectorStore) -> None:
    """Print the store of a vector to adjacent entries of an array."""
    kind, value = _vector(known, store.value), known.values[store.value]
    address, mask = _place(known, store, kind)
    vector = type_of(*kind)
    if not mask:
        known.e.store(value, address, vector)
    elif store.all_there:
        # Without `freeze` LLVM makes this a masked store, and later loads then wait until it has reached the cache.
        before = known.e.value(f"freeze {vector} {known.e.load(address, vector)}")
        merged = known.e.value(f"select {mask}, {vector} {value}, {vector} {before}")
        known.e.store(merged, address, vector)
    else:
        name = f"llvm.masked.store.{suffix(vector)}.p0"
        known.e.do(f"call void @{name}({vector} {value}, ptr {address}, i32 8, {mask})")
