"""Random plain procedures as Python text, in which branches, loops and reductions assign names in all ways."""

import importlib.util
import math
import random
import struct
from pathlib import Path
from typing import Any

HEAD = '''"""Random plain procedures."""

import math
from typing import Annotated

from lagrange.procedure.form import REAL, Array
from lagrange.procedure.front.decorators import inline, procedure
from lagrange.procedure.front.vocabulary import *

Rows = Annotated[Writable[float], Array(REAL, room=8)]


@record
class Kept:
    x: float
    count: int


@procedure
def exchange(x: float, data: Rows) -> tuple[float, bool]:
    before = data[2]
    if x != before:
        data[2] = x
        return before, True
    return x, False


@procedure(noinline=True)
def exchanged(x: float, data: Rows) -> tuple[float, bool]:
    return exchange(x, data)


@inline
def bounded(x: float, bound: float) -> float:
    if x > bound:
        return bound
    return -bound if x < -bound else x


@inline
def scaled(x):
    """The mantissa of NaN has no digits of its own."""
    return mantissa(x if x == x else 1.0) * two_to(min(max(exponent(x), -1022), 1023))


@inline
def copysign(x, y):
    """The form does not define the sign of a NaN."""
    return operation("copysign", x, y if y == y else 1.0)


@inline
def every_other(n):
    for i in range(0, n, 2):
        if i != 2:
            yield i


@procedure
def example(x: float, y: float, n: int, data: Rows, table: In, kept: Kept, *, option: bool) -> tuple[float, int, bool]:
'''

SIZE = 11
"""Places of the arrays that are used."""

DATA = [0.5, -1.25, 0.1, 0.0, -0.0, 1e200, -1e-200, 2.0, 7 / 3, -4.0, 1.0]
TABLE = DATA[::-1]
"""What the arrays hold before a call."""


def bits(value: Any) -> Any:
    """Return the bits of a number, so that -0 differs from 0. All NaN are equal."""
    if isinstance(value, float):
        return "nan" if math.isnan(value) else struct.pack("<d", value)
    return value


class RandomFunction:
    """Writes one function from a seed. A name is read only if all paths assign it.

    Without `fused` there is no `fma`.
    """

    def __init__(self, seed: int, *, fused: bool) -> None:
        self.random, self.fused = random.Random(seed), fused
        self.lines: list[str] = []
        self.reals, self.wholes, self.flags = ["x", "y"], ["n"], ["option"]
        self.count = 0

    def text(self) -> str:
        for _ in range(3):
            value = self.real()
            self.put(1, f"{self.fresh(self.reals)} = {value}")
        self.body(1, 9, 0)
        self.put(1, f"return {self.real()}, {self.whole()}, {self.flag()}")
        return HEAD + "\n".join(self.lines) + "\n"

    def put(self, depth: int, line: str) -> None:
        self.lines.append("    " * depth + line)

    def fresh(self, names: list[str]) -> str:
        """Return a new name, or one that is assigned already."""
        fixed = ("x", "y", "n", "option")
        if self.random.random() < 0.4 and (old := [name for name in names if name not in fixed and name[0] != "i"]):
            return self.random.choice(old)
        self.count += 1
        made = f"{'rwf'[[self.reals, self.wholes, self.flags].index(names)]}{self.count}"
        names.append(made)
        return made

    # --- expressions

    def real(self, depth: int = 0) -> str:
        way = self.random.randrange(11 if depth < 3 else 3)
        more = depth + 1
        if way < 2:
            return self.random.choice(self.reals)
        if way == 2:
            return self.random.choice(("0.5", "-2.25", "3.0", "0.0", "-0.0", "math.inf", "1e300"))
        a, b = self.real(more), self.real(more)
        return [
            lambda: f"({a} {self.random.choice('+-*/')} {b})",
            lambda: f"{self.random.choice(('max', 'min', 'larger', 'smaller', 'magnitude'))}({a}, {b})",
            lambda: f"fma({a}, {b}, {self.real(more)})" if self.fused else f"({a} * {b} + {self.real(more)})",
            lambda: f"({a} if {self.flag(more)} else {b})",
            lambda: f"data[{self.place(more)}]",
            lambda: f"{self.random.choice(('abs', 'math.sqrt', 'sign', 'nearest', '-'))}(x * {a})",
            lambda: f"copysign({a}, {b})",
            lambda: f"scaled({a})",
        ][way - 3]()

    def whole(self, depth: int = 0) -> str:
        way = self.random.randrange(6 if depth < 3 else 2)
        if way < 2:
            return self.random.choice((*self.wholes, "3", "-2"))
        a, b = self.whole(depth + 1), self.whole(depth + 1)
        # Products would leave the range of 64 bits.
        return [
            lambda: f"({a} {self.random.choice('+-')} {b})",
            lambda: f"({a} {self.random.choice(('//', '%'))} {self.random.choice(('3', '-4', '7'))})",
            lambda: f"({a} if {self.flag(depth + 1)} else {b})",
            lambda: f"exponent({self.real(depth + 1)})",
        ][way - 2]()

    def flag(self, depth: int = 0) -> str:
        way = self.random.randrange(6 if depth < 3 else 2)
        more = depth + 1
        if way == 0:
            return self.random.choice(self.flags)
        if way < 3 or depth >= 3:
            return f"({self.real(more)} {self.random.choice(('<', '<=', '>', '>=', '==', '!='))} {self.real(more)})"
        if way == 3:
            return f"({self.whole(more)} {self.random.choice(('<', '>=', '==', '!='))} {self.whole(more)})"
        if way == 4:
            return f"(not {self.flag(more)})"
        return f"({self.flag(more)} {self.random.choice(('and', 'or'))} {self.flag(more)})"

    def place(self, depth: int = 0) -> str:
        return f"min(max({self.whole(depth)}, 0), {SIZE - 1})"

    # --- statements

    def body(self, depth: int, count: int, loops: int) -> None:
        for _ in range(count):
            ways = [self.assign] * 5 + [self.store, self.record, self.call, self.splice]
            if depth < 4:
                ways += [self.branch] * 3
            if depth < 4 and loops < 2:
                ways += [self.loop, self.each, self.repeat, self.written, self.generated]
            self.random.choice(ways)(depth, loops)

    def assign(self, depth: int, loops: int) -> None:
        way = self.random.randrange(4)
        if way == 0:
            value = self.whole()
            self.put(depth, f"{self.fresh(self.wholes)} = min(max({value}, -1000), 1000)")
        elif way == 1:
            value = self.flag()
            self.put(depth, f"{self.fresh(self.flags)} = {value}")
        else:
            value = self.real()
            self.put(depth, f"{self.fresh(self.reals)} = {value}")

    def store(self, depth: int, loops: int) -> None:
        if self.random.random() < 0.3:
            i, j = self.place(), self.place()
            self.put(depth, f"data[{i}], data[{j}] = data[{j}], {self.real()}")
        else:
            self.put(depth, f"data[{self.place()}] {self.random.choice(('', '+', '*'))}= {self.real()}")

    def record(self, depth: int, loops: int) -> None:
        self.put(
            depth, self.random.choice((f"kept.x = {self.real()}", f"kept.count = {self.place()}", "kept.count += 1"))
        )
        self.put(depth, f"{self.fresh(self.reals)} = kept.x")

    def call(self, depth: int, loops: int) -> None:
        value, called = self.real(), self.random.choice(("exchange", "exchanged"))
        self.put(depth, f"{self.fresh(self.reals)}, {self.fresh(self.flags)} = {called}({value}, data)")

    def splice(self, depth: int, loops: int) -> None:
        value = self.real()
        self.put(depth, f"{self.fresh(self.reals)} = bounded({value}, 2.0)")

    def known(self) -> list[list[str]]:
        return [list(self.reals), list(self.wholes), list(self.flags)]

    def forget(self, known: list[list[str]]) -> None:
        """Forget names that were first assigned inside a block."""
        self.reals[:], self.wholes[:], self.flags[:] = known

    def branch(self, depth: int, loops: int) -> None:
        both = self.random.random() < 0.5
        name = f"b{depth}_{len(self.lines)}"
        self.put(depth, f"if {self.random.choice(('', '', 'likely', 'unlikely'))}({self.flag()}):")
        before = self.known()
        for word in ("else:", None):
            self.body(depth + 1, self.random.randint(1, 3), loops)
            if both:
                self.put(depth + 1, f"{name} = {self.real()}")
            if word and not both and self.random.random() < 0.2:
                self.put(depth + 1, f"return {self.real()}, {self.whole()}, {self.flag()}")
            self.forget([list(names) for names in before])
            if word:
                self.put(depth, word)
        if both:
            self.reals.append(name)

    def loop(self, depth: int, loops: int) -> None:
        index = f"i{len(self.lines)}"
        self.put(depth, f"for {index} in range({self.random.choice(('4', 'n', '1, 5', '0, 7, 3'))}):")
        self.inside(depth, loops, index)

    def generated(self, depth: int, loops: int) -> None:
        index = f"i{len(self.lines)}"
        self.put(depth, f"for {index} in every_other(6):")
        self.inside(depth, loops, index)

    def written(self, depth: int, loops: int) -> None:
        index = f"i{len(self.lines)}"
        self.put(depth, f"for {index} in unrolled(3):")
        self.inside(depth, loops, index)

    def inside(self, depth: int, loops: int, index: str) -> None:
        before = self.known()
        self.wholes.append(index)
        self.body(depth + 1, self.random.randint(1, 3), loops + 1)
        self.forget(before)

    def repeat(self, depth: int, loops: int) -> None:
        counter = f"c{len(self.lines)}"
        self.put(depth, f"{counter} = 0")
        self.put(depth, f"while {counter} < 3 and {self.flag()}:")
        before = self.known()
        self.put(depth + 1, f"{counter} += 1")
        self.body(depth + 1, self.random.randint(1, 2), loops + 1)
        self.forget(before)

    def each(self, depth: int, loops: int) -> None:
        outside = self.random.choice(self.reals)
        first, number = self.fresh(self.reals), len(self.lines)
        self.put(depth, f"{first} = {self.random.choice(('0.0', '0.75', outside))}")
        width = self.random.choice((1, 2, 4, 8))
        self.put(depth, f"for i{number} in each({self.random.choice(('7', '8', 'n', '11'))}, width={width}):")
        self.put(depth + 1, f"v{number} = data[i{number}] * {self.random.choice(('0.5', '-2.0', 'x'))}")
        self.put(depth + 1, f"data[i{number}] = v{number} if v{number} < y else -v{number}")
        self.put(depth + 1, f"for j in range(2):\n{'    ' * (depth + 2)}v{number} = v{number} + table[j]")
        kinds = ("{0} += {1}", "{0} = max({0}, {1})", "{0} = min({0}, {1})", "{0} = larger({0}, {1})")
        kind = self.random.choice((*kinds, "{0} = magnitude({0}, {1})", *["{0} = fma({1}, {1}, {0})"] * self.fused))
        self.put(depth + 1, kind.format(first, f"v{number}"))


def example(seed: int, folder: Path, *, fused: bool = True) -> Any:
    """Return the random function of a seed, imported from its own file."""
    path = folder / f"random_{seed}.py"
    path.write_text(RandomFunction(seed, fused=fused).text())
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.example
