"""Memory of members in parallel lanes: entry i of all members is one vector, or members share an array.

An array of each member's own is interleaved: entry i of W members is W adjacent numbers. In a shared array each member
may access its own index.
"""

from __future__ import annotations

from dataclasses import dataclass

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import KINDS, splat, type_of
from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind


@dataclass(frozen=True)
class HeldMemory:
    """An array or a record in memory.

    It begins at `base`. With `apart`, a vector of indices, each member's part begins at its own index. An array of each
    member's `own` is interleaved. `level` is the depth of branches at its allocation, -1 for a caller's array.
    """

    base: str
    own: bool
    apart: str | None = None
    level: int = -1


class MemberMemory:
    """Prints reads and writes of `lanes` members."""

    def __init__(self, e: Emitter, lanes: int) -> None:
        self.e, self.lanes = e, lanes
        self.numbers = "<" + ", ".join(f"i64 {lane}" for lane in range(lanes)) + ">"

    def address(self, held: HeldMemory, place: str, kind: Kind) -> str:
        """Return the address of an index that is the same for all members."""
        if not held.own:
            return self.e.address(held.base, place, KINDS[kind])
        if not place.startswith("%"):
            return self.e.address(held.base, int(place) * self.lanes, KINDS[kind])
        return self.e.address(held.base, self.e.value(f"mul nsw i64 {place}, {self.lanes}"), KINDS[kind])

    def part(self, held: HeldMemory, start: str, kind: Kind, *, spread: bool) -> HeldMemory:
        """Return the part of an array from an index on; `spread` if each member has its own index."""
        if not spread:
            return HeldMemory(self.address(held, start, kind), held.own, held.apart, held.level)
        apart = start if held.apart is None else self.whole("add nsw", held.apart, start)
        return HeldMemory(held.base, held.own, apart, held.level)

    def whole(self, operation: str, a: str, b: str) -> str:
        """Print an integer operation on one number per member, and return the result."""
        return self.e.value(f"{operation} {type_of(WHOLE, self.lanes)} {a}, {b}")

    def pointers(self, held: HeldMemory, place: str, kind: Kind) -> str:
        """Return the vector of each member's address for its index."""
        found = place if held.apart is None else self.whole("add nsw", held.apart, place)
        if held.own:
            found = self.whole("mul nsw", found, splat(self.e, str(self.lanes), WHOLE, self.lanes))
            found = self.whole("add nsw", found, self.numbers)
        return self.e.value(f"getelementptr {KINDS[kind]}, ptr {held.base}, {type_of(WHOLE, self.lanes)} {found}")

    def load(self, held: HeldMemory, place: str, kind: Kind) -> str:
        """Return the entry at an index common to all members: a number of a shared array, else a vector."""
        address = self.address(held, place, kind)
        return self.e.load(address, type_of(kind, self.lanes) if held.own else KINDS[kind])

    def gather(self, held: HeldMemory, places: str, kind: Kind, mask: str) -> str:
        """Return each member's entry at its own index, for the members in the mask."""
        vector, count = type_of(kind, self.lanes), self.lanes
        pointers = self.pointers(held, places, kind)
        zeros = f"{vector} zeroinitializer"
        tail = f"i32 8, <{count} x i1> {mask}, {zeros}"
        return self.e.value(
            f"call {vector} @llvm.masked.gather.{self._suffix(kind)}.v{count}p0(<{count} x ptr> {pointers}, {tail})"
        )

    def store(self, held: HeldMemory, place: str, value: str, kind: Kind, mask: str | None) -> None:
        """Store a vector at an index common to all members, for the members of a mask, or for all without one."""
        address, vector = self.address(held, place, kind), type_of(kind, self.lanes)
        if mask is None:
            self.e.store(value, address, vector)
            return
        # Without `freeze` LLVM makes this a masked store, and later loads then wait until it has reached the cache.
        before = self.e.value(f"freeze {vector} {self.e.load(address, vector)}")
        kept = self.e.value(f"select {type_of(FLAG, self.lanes)} {mask}, {vector} {value}, {vector} {before}")
        self.e.store(kept, address, vector)

    def scatter(self, held: HeldMemory, places: str, value: str, kind: Kind, mask: str) -> None:
        """Store each member's number at its own index, for the members in the mask."""
        vector, count = type_of(kind, self.lanes), self.lanes
        pointers = self.pointers(held, places, kind)
        self.e.do(
            f"call void @llvm.masked.scatter.{self._suffix(kind)}.v{count}p0({vector} {value}, "
            f"<{count} x ptr> {pointers}, i32 8, <{count} x i1> {mask})"
        )

    def _suffix(self, kind: Kind) -> str:
        return f"v{self.lanes}{'f64' if kind is REAL else 'i64'}"
