"""Loops whose iterations run in LLVM's vector lanes, and statements on vectors.

An `each` loop takes as many iterations at once as fit into a vector.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from lagrange.machine.llvm.emitter import Emitter, literal, suffix
from lagrange.machine.llvm.operations import KINDS, LIBRARY, call_library, largest_magnitude, spell, splat, type_of
from lagrange.procedure import form
from lagrange.procedure.form import ANGLES, FLAG, PARTIAL, REAL, SUMS, WHOLE, Block, Kind, Vector, walk

if TYPE_CHECKING:
    from lagrange.machine.llvm.procedures import Printer

UNROLLED_VECTORS = 2
"""Largest number of vectors, each with several iterations, up to which an `each` loop is printed without a loop."""


@dataclass(frozen=True)
class IterationBlock:
    """Iterations of the loop `each` that are printed as one vector: `lanes` of them, from iteration `offset` on.

    Iterations where `mask` is false are after the last one. `mask` is "" if all exist, or if the others do no harm.
    """

    each: form.Each
    lanes: int
    offset: str
    mask: str
    indices: str
    """The vector of the indices of the iterations, as an LLVM operand."""


class Lanes:
    """Prints an `each` loop as LLVM IR, with `lanes` iterations at once: one in each lane of a vector."""

    def __init__(self, printer: Printer, each: form.Each, lanes: int) -> None:
        self.printer, self.e, self.each, self.lanes = printer, printer.e, each, lanes
        self.stride = max(lanes, PARTIAL) if any(fold.op in SUMS for fold in each.folds) else lanes
        """Number of iterations of `each` in one pass of the printed loop. With a sum, there is at least one for each
        partial sum.
        """

    def run(self) -> None:
        """Print the LLVM IR of the loop: its iterations, then the results of its reductions, such as a sum.

        A few iterations are written out one after the other; many are printed as a loop.
        """
        printer, each = self.printer, self.each
        count = printer.values[each.iterations]
        for ref in self.outside():
            printer.spread[ref] = splat(self.e, printer.values[ref], printer.kinds[ref], self.lanes)
        start = [splat(self.e, literal(fold.first), REAL, self.lanes) for fold in each.folds]
        sums = [[value] * (self.stride // self.lanes) for value in start]
        known = number(count)
        if known is None:
            self.looped(sums, count)
        elif self.each.unrolled or -(-known // self.stride) <= UNROLLED_VECTORS:
            self.rest(sums, 0, known)
        else:
            whole = known - known % self.stride
            self.looped(sums, str(whole))
            self.rest(sums, whole, known)
        printer.current = None
        printer.spread.clear()
        for fold, partials in zip(each.folds, sums, strict=True):
            printer.define(fold.ref, self.total(fold, partials), REAL)

    def outside(self) -> list[int]:
        """Return the ids of the numbers that the iterations use but that are defined before the loop."""
        if self.lanes == 1:
            return []
        refs: dict[int, None] = {}
        for statement in walk(self.each.body):
            stored = (statement.value,) if isinstance(statement, (form.Store, form.Declare, form.Set)) else ()
            for ref in statement.args if isinstance(statement, form.Let) else stored:
                if ref in self.printer.values and ref in self.printer.kinds:
                    refs[ref] = None
        return list(refs)

    def rest(self, sums: list[list[str]], begin: int, count: int) -> None:
        """Print the iterations from `begin` up to, but not including, `count` without a loop.

        `sums` has, for each reduction, the operands of its partial results. They are replaced by operands that include
        these iterations.
        """
        for offset in range(begin, count, self.lanes):
            inside = [k < count - offset for k in range(self.lanes)]
            mask = "" if all(inside) else "<" + ", ".join(f"i1 {str(flag).lower()}" for flag in inside) + ">"
            self.take(str(offset), mask)
            self.collect(sums, offset, mask)

    def looped(self, sums: list[list[str]], count: str) -> None:
        """Print the iterations below `count` as a loop that takes `stride` iterations at a time.

        `sums` has, for each reduction, the operands of its partial results. The loop carries them, and they are
        replaced by the operands of their values after the loop.
        """
        e = self.e
        flat = [(i, k) for i, partials in enumerate(sums) for k in range(len(partials))]
        carried = [(type_of(REAL, self.lanes), sums[i][k]) for i, k in flat]
        with e.carry(0, count, carried, self.stride) as loop:
            for (i, k), value in zip(flat, loop.values, strict=True):
                sums[i][k] = value
            for offset in range(0, self.stride, self.lanes):
                mask = self.mask(loop.index, count)
                self.take(e.value(f"add nsw i64 {loop.index}, {offset}") if offset else loop.index, mask)
                self.collect(sums, offset, mask)
            loop.following = [sums[i][k] for i, k in flat]
        for (i, k), value in zip(flat, loop.values, strict=True):
            sums[i][k] = value

    def mask(self, index: str, count: str) -> str:
        """Return the operand of the mask of one vector of iterations, which begins at the operand `index`.

        The mask is true for iterations below `count`, which exist. The result is "", for no mask, if all iterations of
        the vector exist, or if the extra ones do no harm.
        """
        stores = not self.each.spill and any(
            isinstance(statement, form.Store) for statement in accesses(self.each.body)
        )
        if self.lanes == 1 or not count.startswith("%") or not (stores or self.each.folds):
            return ""
        e, kind = self.e, type_of(WHOLE, self.lanes)
        return e.value(f"icmp slt {kind} {self.places(index)}, {splat(e, count, WHOLE, self.lanes)}")

    def places(self, offset: str) -> str:
        """Return the operand of a vector with the indices `offset`, `offset` + 1 and so on of its iterations."""
        if self.lanes == 1:
            return offset
        if not offset.startswith("%"):
            return "<" + ", ".join(f"i64 {int(offset) + k}" for k in range(self.lanes)) + ">"
        steps = "<" + ", ".join(f"i64 {k}" for k in range(self.lanes)) + ">"
        kind = type_of(WHOLE, self.lanes)
        return self.e.value(f"add nsw {kind} {splat(self.e, offset, WHOLE, self.lanes)}, {steps}")

    def take(self, offset: str, mask: str) -> None:
        """Print the loop's body for one vector of iterations, from `offset` on. `mask` is true for those that exist."""
        printer = self.printer
        printer.current = IterationBlock(self.each, self.lanes, offset, mask, self.places(offset))
        printer.define(self.each.place, offset, WHOLE, wide=self.lanes > 1)
        outside = dict(printer.variables)
        printer.block(self.each.body)
        printer.variables = {variable: printer.variables[variable] for variable in outside}

    def collect(self, sums: list[list[str]], begin: int, mask: str) -> None:
        """Add one vector of iterations to each reduction: combine its values with a partial result in `sums`.

        The vector begins at iteration `begin`. Iterations for which the mask is false are left out.
        """
        kind = type_of(REAL, self.lanes)
        for fold, partials in zip(self.each.folds, sums, strict=True):
            slot = begin // self.lanes % len(partials)
            value, before = self.printer.operand(fold.value, self.lanes), partials[slot]
            if fold.factor is None:
                partials[slot] = joined(self.e, fold.op, before, value, self.lanes)
            else:
                factor = self.printer.operand(fold.factor, self.lanes)
                partials[slot] = spell(self.e, "fma", (REAL,) * 3, [value, factor, before], self.lanes)
            if mask:
                both = f"{kind} {partials[slot]}, {kind} {before}"
                partials[slot] = self.e.value(f"select <{self.lanes} x i1> {mask}, {both}")

    def total(self, fold: form.Fold, partials: list[str]) -> str:
        """Print the combination of partial results of the reduction `fold`, in a fixed order. Return its operand."""
        e = self.e
        if fold.op == "magnitude" and self.lanes > 1:
            return largest_magnitude(e, partials[0], self.lanes)
        if self.lanes > 1:
            kind = type_of(REAL, self.lanes)
            partials = [e.value(f"extractelement {kind} {partials[0]}, i64 {k}") for k in range(self.lanes)]
        op = "add" if fold.op == "dot" else fold.op
        while len(partials) > 1:
            partials = [joined(e, op, *pair) for pair in zip(partials[::2], partials[1::2], strict=True)]
        return partials[0]


def joined(e: Emitter, op: str, total: str, value: str, lanes: int = 1) -> str:
    """Print the combination of a partial result `total` with one more value, and return the operand of the result.

    `op` is the operation of the reduction, such as "add". With `lanes` above 1 both operands are vectors.
    """
    if op != "most":
        return spell(e, op, (REAL, REAL), [total, value], lanes)
    larger = spell(e, "less", (REAL, REAL), [total, value], lanes)
    return spell(e, "select", (FLAG, REAL, REAL), [larger, value, total], lanes)


def accesses(block: Block) -> Iterator[form.Load | form.Store]:
    """Yield the statements of a block, nested ones included, that read or write an array entry."""
    return (statement for statement in walk(block) if isinstance(statement, (form.Load, form.Store)))


def number_of_angles(block: Block) -> int:
    """Return the number of sines and cosines in a block. A statement that computes both of one angle counts once."""
    operations = (statement for statement in walk(block) if isinstance(statement, (form.Let, form.VectorLet)))
    angles = sum(operation.op in ANGLES for operation in operations)
    return angles + sum(isinstance(statement, form.SineCosine) for statement in walk(block))


def widest(block: Block) -> int:
    """Return the largest width of a vector or of an `each` loop in a block, at least 1."""
    vectors = (
        statement.vector.width
        for statement in walk(block)
        if isinstance(statement, (form.VectorLet, form.VectorLoad, form.Gather))
    )
    return max([1, *(each.width for each in walk(block) if isinstance(each, form.Each)), *vectors])


def base_arrays(block: Block) -> dict[int, int]:
    """Return {id of a part: id of the whole array} for each part of an array that a block defines."""
    bases: dict[int, int] = {}
    for statement in walk(block):
        if isinstance(statement, form.Part):
            bases[statement.ref] = bases.get(statement.array, statement.array)
    return bases


def number(value: str) -> int | None:
    """Return the integer of a constant operand, or None for a value known only at run time."""
    return None if value.startswith("%") else int(value)


def _vector(printer: Printer, ref: int) -> Vector:
    """Return the type of the vector with the id `ref`, in the procedure that `printer` prints."""
    vector = printer.types[ref]
    assert isinstance(vector, Vector)
    return vector


def operation(printer: Printer, let: form.VectorLet) -> str:
    """Print the operation on vectors that `let` states, and return the operand of its result."""
    e, (_, width) = printer.e, let.vector
    if let.op == "permute":
        return _permuted(printer, let)
    kinds, args = tuple(_vector(printer, arg).kind for arg in let.args), [printer.values[arg] for arg in let.args]
    return call_library(e, let.op, args, width) if let.op in LIBRARY else spell(e, let.op, kinds, args, width)


def _permuted(printer: Printer, let: form.VectorLet) -> str:
    """Emit a vector whose entries come from other vectors or are single values, and return its operand.

    The statement `let` has the operation `permute` and states where each entry comes from.
    """
    e, (kind, width), begin = printer.e, let.vector, 0
    single: dict[int, str] = {}
    made, filled = "", frozenset[int]()
    for arg in let.args:
        held = printer.types[arg]
        count = held.width if isinstance(held, Vector) else 1
        sources = {k: source - begin for k, source in enumerate(let.places) if begin <= source < begin + count}
        begin += count
        if not sources or not isinstance(held, Vector):
            single |= dict.fromkeys(sources, printer.values[arg])
            continue
        part = _moved(e, kind, printer.values[arg], count, sources, width)
        made = _merged(e, kind, made, part, frozenset(sources), width) if made else part
        filled |= frozenset(sources)
    return _inserted(e, kind, made, filled, single, width) if single else made


def _moved(e: Emitter, kind: Kind, vector: str, count: int, sources: Mapping[int, int], width: int) -> str:
    """Emit a new vector of `width` entries that are taken from `vector`, and return its operand.

    `sources` maps an index in the new vector to an index in `vector`, which has `count` entries of the given
    `kind`. Entries of the new vector without a source are undefined.
    """
    if width == count and all(k == source for k, source in sources.items()):
        return vector
    mask = ", ".join(f"i32 {sources[k]}" if k in sources else "i32 poison" for k in range(width))
    vector_type = type_of(kind, count)
    return e.value(f"shufflevector {vector_type} {vector}, {vector_type} poison, <{width} x i32> <{mask}>")


def _merged(e: Emitter, kind: Kind, a: str, b: str, chosen: frozenset[int], width: int) -> str:
    """Emit a vector with the entries of `b` at the indices `chosen` and those of `a` elsewhere; return its operand."""
    vector_type = type_of(kind, width)
    mask = ", ".join(f"i32 {width + k if k in chosen else k}" for k in range(width))
    return e.value(f"shufflevector {vector_type} {a}, {vector_type} {b}, <{width} x i32> <{mask}>")


def _inserted(e: Emitter, kind: Kind, made: str, filled: frozenset[int], single: Mapping[int, str], width: int) -> str:
    """Emit the vector `made` with single values inserted, and return its operand.

    `single` maps an index to the value for this entry. `filled` are the indices of the entries of `made` that are
    defined. `made` is "" if there are none. All constants are inserted by one instruction.
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


def reduced(printer: Printer, reduce: form.Reduce) -> str:
    """Emit one number from a vector, and return its operand: an entry, or a flag that is true if any entry is true."""
    e, value, (kind, width) = printer.e, printer.values[reduce.vector], _vector(printer, reduce.vector)
    if reduce.op == "entry":
        return e.value(f"extractelement {type_of(kind, width)} {value}, i64 {reduce.place}")
    mask = e.value(f"bitcast <{width} x i1> {value} to i{width}")
    return e.value(f"icmp ne i{width} {mask}, 0")


def gathered(printer: Printer, gather: form.Gather) -> str:
    """Emit a gather, the read of array entries at the indices in a vector, and return the operand of the result."""
    kind, width = gather.vector
    vector, name = type_of(kind, width), f"llvm.masked.gather.{suffix(type_of(kind, width))}.v{width}p0"
    arguments = f"{_pointers(printer, gather, kind, width)}, i32 8, <{width} x i1> {printer.values[gather.mask]}"
    return printer.e.value(f"call {vector} @{name}(<{width} x ptr> {arguments}, {vector} zeroinitializer)")


def _pointers(printer: Printer, statement: form.Gather | form.Scatter, kind: Kind, width: int) -> str:
    """Emit the addresses of the array entries that a gather reads or a scatter writes, as a vector of pointers."""
    indices = f"{type_of(WHOLE, width)} {printer.values[statement.places]}"
    return printer.e.value(f"getelementptr {KINDS[kind]}, ptr {printer.values[statement.array]}, {indices}")


def scatter(printer: Printer, scatter: form.Scatter) -> None:
    """Print a scatter: the entries of a vector, where the mask is true, are stored at the indices in another vector."""
    kind, width = _vector(printer, scatter.value)
    vector, mask = type_of(kind, width), f"<{width} x i1> {printer.values[scatter.mask]}"
    arguments = f"{vector} {printer.values[scatter.value]}, <{width} x ptr> {_pointers(printer, scatter, kind, width)}"
    printer.e.do(f"call void @llvm.masked.scatter.{suffix(vector)}.v{width}p0({arguments}, i32 8, {mask})")


def store(printer: Printer, store: form.VectorStore) -> None:
    """Print the store of a vector to adjacent entries of an array. Where its mask, if any, is false, none changes."""
    (kind, width), value = _vector(printer, store.value), printer.values[store.value]
    vector = type_of(kind, width)
    address = printer.e.address(printer.values[store.array], printer.values[store.place], KINDS[kind])
    if store.mask is not None:
        # Without `freeze` LLVM makes this a masked store, and later loads then wait until it has reached the cache.
        before = printer.e.value(f"freeze {vector} {printer.e.load(address, vector)}")
        value = printer.e.value(
            f"select <{width} x i1> {printer.values[store.mask]}, {vector} {value}, {vector} {before}"
        )
    printer.e.store(value, address, vector)
