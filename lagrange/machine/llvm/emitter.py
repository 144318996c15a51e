"""Write the text of LLVM IR functions: fresh names, instructions, loops and branches."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field


def literal(value: float) -> str:
    """Return a double as an exact hexadecimal literal of LLVM, such as 0x3FF0000000000000 for 1.0."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


@dataclass
class LoopValues:
    """Names in a loop that is being printed: its index, the carried values, and these values for the next iteration."""

    index: str
    values: list[str]
    following: list[str] = field(default_factory=list)


MOST_ACCESSES = 256
"""Largest number of loads and stores in one basic block; the next instruction begins another block. LLVM compares them
pairwise: 2,900 stores in one block took 13 s to compile, and 1.2 s in blocks of 256. The blocks of all scenes are
smaller.
"""


class Emitter:
    """Collects the instructions of one LLVM function as text. Emit means to append an instruction.

    Names are numbered, so the same calls always produce the same text.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.entry: list[str] = []
        self.count = 0
        self.block = "entry"
        self.zero = ""
        self.accesses = 0

    def fresh(self, stem: str = "v") -> str:
        """Return an unused name that begins with `stem`, without its % sign."""
        self.count += 1
        return f"{stem}{self.count}"

    def value(self, text: str) -> str:
        """Emit the instruction `text`, which has a result, and return the name of the result, such as %v7."""
        if self.accesses >= MOST_ACCESSES and not text.startswith("phi"):
            self.cut()
        name = "%" + self.fresh()
        self.lines.append(f"  {name} = {text}")
        return name

    def cut(self) -> None:
        """Begin another basic block (instructions without a branch), because LLVM compiles long blocks slowly.

        The branch to the new block is always taken, but depends on a value that LLVM cannot know. Otherwise LLVM would
        join the two blocks.
        """
        if not self.zero:
            self.zero = self.reserve("i8")
            self.entry.append(f"  store volatile i8 0, ptr {self.zero}")
        name, taken = self.fresh("cut"), self.fresh("taken")
        self.lines += [
            f"  %{taken}.byte = load volatile i8, ptr {self.zero}",
            f"  %{taken} = icmp ne i8 %{taken}.byte, 0",
            f"  br i1 %{taken}, label %{name}.never, label %{name}",
            f"{name}.never:",
            "  unreachable",
        ]
        self.label(name)

    def do(self, text: str) -> None:
        """Emit an instruction without a result."""
        self.lines.append("  " + text)

    def reserve(self, kind: str, count: int = 1) -> str:
        """Return a pointer to stack memory for `count` elements of the type `kind`.

        The memory is reserved once, at the function's entry.
        """
        name = "%" + self.fresh("m")
        self.entry.append(f"  {name} = alloca {kind if count == 1 else f'[{count} x {kind}]'}, align 64")
        return name

    def label(self, name: str) -> None:
        """Begin the basic block with this name."""
        self.lines.append(f"{name}:")
        self.block = name
        self.accesses = 0

    def jump(self, name: str) -> None:
        """Emit a branch to the block with this name."""
        self.do(f"br label %{name}")

    def address(self, base: str, index: str | int, kind: str = "double") -> str:
        """Return the address of element `index` of an array that begins at `base`, with elements of type `kind`."""
        return base if index in (0, "0") else self.value(f"getelementptr inbounds {kind}, ptr {base}, i64 {index}")

    def load(self, pointer: str, kind: str = "double") -> str:
        """Emit a load of a value of the LLVM type `kind` from a pointer, and return the name of the value.

        Vectors need the alignment of their elements only.
        """
        loaded = self.value(f"load {kind}, ptr {pointer}, align 8")
        self.accesses += 1
        return loaded

    def store(self, what: str, pointer: str, kind: str = "double") -> None:
        """Emit a store of the operand `what`, of the LLVM type `kind`, to a pointer."""
        self.accesses += 1
        self.do(f"store {kind} {what}, ptr {pointer}, align 8")

    def get(self, base: str, index: str | int, kind: str = "double") -> str:
        """Emit a load of element `index` of the array at `base`, and return the name of the loaded value."""
        return self.load(self.address(base, index, kind), kind)

    def put(self, what: str, base: str, index: str | int, kind: str = "double") -> None:
        """Emit a store of the operand `what` to element `index` of the array at `base`."""
        self.store(what, self.address(base, index, kind), kind)

    def fma(self, a: str, b: str, c: str, kind: str = "double") -> str:
        """Emit a*b + c, rounded once, and return the name of the result."""
        return self.value(f"call {kind} @llvm.fma.{suffix(kind)}({kind} {a}, {kind} {b}, {kind} {c})")

    def fabs(self, a: str, kind: str = "double") -> str:
        """Emit |a|, and return the name of the result."""
        return self.value(f"call {kind} @llvm.fabs.{suffix(kind)}({kind} {a})")

    @contextmanager
    def loop(self, start: str | int, stop: str | int, step: int = 1) -> Iterator[str]:
        """Emit a loop whose body is what the caller emits in the `with` block. Yields the name of the index.

        The index runs from `start` by `step` while it is below `stop`.
        """
        with self.carry(start, stop, (), step) as carried:
            yield carried.index

    @contextmanager
    def carry(
        self, start: str | int, stop: str | int, carried: Sequence[tuple[str, str]], step: int = 1
    ) -> Iterator[LoopValues]:
        """Emit a loop whose body is what the caller emits in the `with` block, with values carried between iterations.

        The index runs from `start` by `step` while it is below `stop`. `carried` has the type and the initial value of
        each carried value. Yields an object with two lists. The `with` block reads the carried values from `values`,
        and must set `following`, their values for the next iteration. After the loop, `values` has the last values.
        """
        name = self.fresh("loop")
        before = self.block
        self.jump(f"{name}.head")
        self.label(f"{name}.head")
        index, following = f"%{name}.i", f"%{name}.next"
        hole = len(self.lines)
        loop = LoopValues(index, [f"%{name}.c{i}" for i in range(len(carried))])
        self.lines += [""] * (len(carried) + 1)
        self.do(f"%{name}.go = icmp slt i64 {index}, {stop}")
        self.do(f"br i1 %{name}.go, label %{name}.body, label %{name}.end")
        self.label(f"{name}.body")
        yield loop
        self.do(f"{following} = add nsw i64 {index}, {step}")
        self.lines[hole] = f"  {index} = phi i64 [ {start}, %{before} ], [ {following}, %{self.block} ]"
        for i, (kind, initial) in enumerate(carried):
            entry = f"[ {initial}, %{before} ], [ {loop.following[i]}, %{self.block} ]"
            self.lines[hole + 1 + i] = f"  {loop.values[i]} = phi {kind} {entry}"
        self.jump(f"{name}.head")
        self.label(f"{name}.end")

    @contextmanager
    def when(self, condition: str) -> Iterator[None]:
        """Emit a branch: what the caller emits in the `with` block runs only if the operand `condition` is true."""
        name = self.fresh("if")
        self.do(f"br i1 {condition}, label %{name}.then, label %{name}.end")
        self.label(f"{name}.then")
        yield
        self.jump(f"{name}.end")
        self.label(f"{name}.end")

    def function(self, signature: str) -> str:
        """Return the IR of the whole function. The signature is a text such as ``define i32 @f(double %t)``."""
        return "\n".join([f"{signature} {{", "entry:", *self.entry, *self.lines, "}", ""])


def suffix(kind: str) -> str:
    """Return the suffix of names of LLVM's intrinsics for a type: f64 for double, v8i64 for <8 x i64>."""
    name = "i64" if "i64" in kind else "f64"
    return f"v{kind[1:].partition(' ')[0]}{name}" if kind.startswith("<") else name
