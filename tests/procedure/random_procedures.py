"""Random procedures: every operation, kind of memory and way through, on numbers ordinary and extreme."""

from __future__ import annotations

import math
import random
from functools import cache
from typing import Any

from lagrange.procedure.builder import Builder
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Callee, Kind, Procedure, Record

SIZE = 11
"""Entries of the arrays: two blocks of four and three more."""

KEPT = Record.of("Kept", x=REAL, count=WHOLE)

COMPARE = Callee((REAL, REAL), (REAL, FLAG))
"""A function of numbers with several results: the difference, and whether it is below zero."""
REPLACE = Callee((REAL, Array()), (FLAG,))
"""A function between arrays with one result: it puts a number at the first place, and says whether it is below zero."""
MARK = Callee((FLAG, WHOLE, Array()), ())
"""A function without results: where a flag holds it puts a whole number, as a real, at the second place."""


def compare(a: float, b: float) -> tuple[float, bool]:
    return a - b, a - b < 0.0


def replace(x: float, data: Any) -> bool:
    data[0] = x
    return x < 0.0


def mark(flag: bool, n: int, data: Any) -> None:
    if flag:
        data[1] = float(n)


FUNCTIONS = compare, replace, mark

IN_MACHINE_CODE = """
define swiftcc {double, i32} @compare(double %a, double %b) {
  %d = fsub double %a, %b
  %below = fcmp olt double %d, 0.0
  %flag = zext i1 %below to i32
  %one = insertvalue {double, i32} poison, double %d, 0
  %both = insertvalue {double, i32} %one, i32 %flag, 1
  ret {double, i32} %both
}
define i32 @replace(double %x, ptr %data) {
  store double %x, ptr %data
  %below = fcmp olt double %x, 0.0
  %flag = select i1 %below, i32 6, i32 0
  ret i32 %flag
}
define void @mark(i32 %flag, i64 %n, ptr %data) {
  %holds = icmp ne i32 %flag, 0
  br i1 %holds, label %then, label %end
then:
  %x = sitofp i64 %n to double
  %place = getelementptr double, ptr %data, i64 1
  store double %x, ptr %place
  br label %end
end:
  ret void
}
"""
"""The same functions: in C's convention any number but zero is a flag that holds."""


@cache
def exchange(*, apart: bool) -> Procedure:
    """Return a procedure that random ones call: it puts a number into an array and returns what was there."""
    p = Builder(f"exchange_{'apart' if apart else 'merged'}", "Put a number at the third place.", apart=apart)
    x, data = p.given("x", REAL), p.array("data")
    before = data[2]
    with p.when(~x.equals(before)):
        data[2] = x
        p.leave(before, p.true)
    p.leave(x, p.false)
    return p.finish(REAL, FLAG)


# Sine and the like are left out: their last digit is the C library's own.
REAL_UNARY = ("neg", "abs", "sqrt", "sign", "round")
REAL_BINARY = ("add", "sub", "mul", "div", "min", "max", "copysign", "magnitude")
WHOLE_BINARY = ("add", "sub", "min", "max")
COMPARED = ("less", "less_equal", "equal")


class RandomProcedure:
    """Builds one procedure from a seed; with `fused`, multiply-adds are rounded once."""

    def __init__(self, seed: int, *, fused: bool) -> None:
        self.random, self.fused = random.Random(seed), fused
        self.p = p = Builder(f"random{seed}", "A random procedure.")
        x, y = p.given("x", REAL), p.given("y", REAL)
        n = p.given("n", WHOLE)
        self.data = p.array("data", size=SIZE, room=8)
        self.table = p.array("table", size=SIZE, read=True)
        self.kept = p.record("kept", KEPT)
        self.compare, self.replace = p.function("compare", COMPARE), p.function("replace", REPLACE)
        self.mark = p.function("mark", MARK)
        self.variables = [p.variable(x, "first"), p.variable(1.5), p.variable(n), p.variable(n < 3)]
        self.values: dict[Kind, list[Any]] = {REAL: [x, y], WHOLE: [n], FLAG: [x < y]}

    def build(self) -> Procedure:
        self.statements(9, depth=0)
        p = self.p
        p.leave(self.pick(REAL), self.pick(WHOLE), self.pick(FLAG), *(variable.value for variable in self.variables))
        kinds = (variable.kind for variable in self.variables)
        return p.finish(REAL, WHOLE, FLAG, *kinds)

    def pick(self, kind: Kind) -> Any:
        if kind is REAL and self.random.random() < 0.15:
            return self.p.constant(self.random.choice((0.0, -0.0, 0.5, 3.0, -2.25, math.inf, 1e300)), REAL)
        return self.random.choice(self.values[kind])

    def place(self) -> Any:
        """Return a whole number that is a place of the arrays."""
        p = self.p
        return p.operation("min", p.larger(self.pick(WHOLE), 0), SIZE - 1)

    def statements(self, count: int, depth: int) -> None:
        ways = [self.compute] * 6 + [self.memory] * 3 + [self.change] * 3 + [self.call]
        ways += [self.branch, self.iterations, self.each, self.while_small] if depth < 3 else []
        for _ in range(count):
            self.random.choice(ways)(depth)

    def nested(self, depth: int) -> None:
        """Build a body; what it defines is forgotten behind it."""
        before = {kind: list(found) for kind, found in self.values.items()}
        self.statements(self.random.randint(1, 4), depth + 1)
        self.values = before

    def keep(self, value: Any) -> None:
        self.values[value.kind].append(value)

    def compute(self, depth: int) -> None:
        p, way = self.p, self.random.randrange(9)
        if way < 3:
            self.keep(p.operation(self.random.choice(REAL_BINARY), self.pick(REAL), self.pick(REAL)))
        elif way == 3:
            self.keep(p.operation(self.random.choice(REAL_UNARY), self.pick(REAL)))
        elif way == 4:
            a, b, c = (self.pick(REAL) for _ in range(3))
            self.keep(p.fma(a, b, c) if self.fused else a * b + c)
        elif way == 5:
            self.keep(p.operation(self.random.choice(WHOLE_BINARY), self.pick(WHOLE), self.pick(WHOLE)))
        elif way == 6:
            kind = self.random.choice((REAL, WHOLE))
            self.keep(p.operation(self.random.choice(COMPARED), self.pick(kind), self.pick(kind)))
        elif way == 7:
            self.bits()
        else:
            kind = self.random.choice((REAL, WHOLE, FLAG))
            self.keep(p.choose(self.pick(FLAG), self.pick(kind), self.pick(kind)))

    def bits(self) -> None:
        """Take a number apart; the mantissa of NaN has no digits of its own."""
        p, x = self.p, self.pick(REAL)
        exponent = p.operation("exponent", x)
        self.keep(exponent)
        self.keep(p.operation("mantissa", p.choose(x.equals(x), x, 1.0)))
        self.keep(p.operation("two_to", p.operation("min", p.larger(exponent, -1022), 1023)))

    def memory(self, depth: int) -> None:
        way = self.random.randrange(4)
        if way == 0:
            self.data[self.place()] = self.pick(REAL)
        elif way == 1:
            self.keep(self.data[self.place()])
        elif way == 2:
            self.kept.x = self.pick(REAL)
            self.kept.count = self.pick(WHOLE)
        else:
            self.keep(self.kept.x)

    def call(self, depth: int) -> None:
        way = self.random.randrange(4)
        if way == 0:
            self.keep_all(self.compare(self.pick(REAL), self.pick(REAL)))
        elif way == 1:
            self.keep(self.replace(self.pick(REAL), self.data))
        elif way == 2:
            self.mark(self.pick(FLAG), self.pick(WHOLE), self.data)
        else:
            made = exchange(apart=self.random.random() < 0.5)
            self.keep_all(self.p.call(made, self.pick(REAL), self.data))

    def keep_all(self, values: Any) -> None:
        for value in values:
            self.keep(value)

    def change(self, depth: int) -> None:
        variable = self.random.choice(self.variables)
        if self.random.random() < 0.5:
            variable.value = self.pick(variable.kind)
        self.keep(variable.value)

    def branch(self, depth: int) -> None:
        likely = self.random.choice((None, True, False))
        with self.p.when(self.pick(FLAG), likely=likely) as ways:
            self.nested(depth)
        if self.random.random() < 0.5:
            with ways.otherwise():
                self.nested(depth)

    def iterations(self, depth: int) -> None:
        with self.p.loop(0, self.random.randint(0, 4), self.random.choice((1, 2))) as i:
            self.values[WHOLE].append(i)
            self.nested(depth)
            self.values[WHOLE].remove(i)

    def each(self, depth: int) -> None:
        p, outside = self.p, self.pick(REAL)
        count = self.random.choice((1, 4, 7, SIZE, self.place()))
        with p.each(count, width=self.random.choice((1, 2, 4, 8))) as i:
            value = p.operation(self.random.choice(REAL_BINARY), self.data[i], outside)
            inside = p.variable(value)
            with p.loop(0, self.random.randint(0, 3)) as j:
                inside.value = inside.value * 0.5 + self.table[j]
            self.data[i] = p.choose(value < outside, inside.value, -value)
            # A product with -1 is exact, so that it does not matter whether it is rounded before it is added.
            factor = inside.value if self.fused else p.constant(-1.0, REAL)
            sums = [p.fold("add", value), p.fold("dot", value, factor)] if self.random.random() < 0.5 else []
            largest = [p.fold("max", abs(value)), p.fold("most", value), p.fold("magnitude", value)]
            folded = [*sums, *largest]
        for one in folded:
            self.keep(one)

    def while_small(self, depth: int) -> None:
        p, counted = self.p, self.p.variable(0)
        with p.repeat(lambda: counted.value < 3):
            counted.value = counted.value + 1
            self.nested(depth)
