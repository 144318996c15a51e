"""Rewrite a program with fewer operations, for machines on which each operation is a call. Only rounding differs.

Signs are moved to operations that absorb them without cost. A multiply-add becomes two operations, so that products can
be shared. Derivatives of an angle between two links give sums with F*(u - v) and F*v; these become F*u.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from lagrange.program.program import GIVEN, Instruction, Program

LONGEST_PROGRAM = 4000
"""Largest number of instructions of a program that is simplified: 10 us each."""

MOST_COMPARED_TERMS = 40
"""Largest number of terms of a sum, or factors of a product, that is searched, because each term is compared with all
others.
"""

ODD, EVEN = ("mul", "div"), ("abs", "cos")
"""Operations whose result changes its sign with an operand, and operations that ignore the sign of their operand."""

SUMS = ("add", "sub")
NO_OPERATION = (*GIVEN, "component")


class Signed(NamedTuple):
    """The result with the index `ref` in the new program, or its negative."""

    ref: int
    negative: bool = False


Term = tuple[bool, tuple[int, ...]]
"""A product in a sum: True if it is subtracted, and its factors, sorted."""


def simplified(program: Program) -> Program:
    """Return the program with fewer operations.

    It is unchanged if none can be saved or if it has more than `LONGEST_PROGRAM` instructions.
    """
    if len(program.instructions) > LONGEST_PROGRAM:
        return program
    found = _Simplifier(program).made()
    return found if operations(found) < operations(program) else program


def operations(program: Program) -> int:
    """Return the number of operations of one evaluation; a multiply-add counts as two."""
    moving = program.instructions[program.hoisted :]
    return sum(one.op not in NO_OPERATION for one in moving) + sum(one.op == "fma" for one in moving)


class _Simplifier:
    """Rewrites a program: the sign of each value is stored separately, and each operation occurs once."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.code: list[Instruction] = []
        self.hoisted: list[bool] = []
        self.reads: list[int] = []
        """Number of reads of each new instruction so far."""
        self.factors: list[tuple[int, ...]] = []
        """The factors of each new instruction, sorted; the instruction itself unless it is a product."""
        self.numbers: dict[Instruction, int] = {}
        self.values: list[Signed] = []
        self.sums: dict[int, list[Term]] = {}
        """Terms of each new sum that has no reader yet."""

    def made(self) -> Program:
        """Return the new, simplified program."""
        for one, uses in zip(self.program.instructions, _uses(self.program), strict=True):
            value = self.again(one)
            self.values.append(value)
            if uses > 1:
                self.sums.pop(value.ref, None)
        outputs = [self.plain(ref) for ref in self.program.outputs]
        needed = self.needed(outputs)
        order = [ref for wanted in (True, False) for ref in needed if self.hoisted[ref] is wanted]
        place = {old: new for new, old in enumerate(order)}
        instructions = tuple(self.code[i]._replace(args=tuple(place[a] for a in self.code[i].args)) for i in order)
        return replace(
            self.program,
            instructions=instructions,
            hoisted=sum(self.hoisted[ref] for ref in needed),
            outputs=tuple(place[ref] for ref in outputs),
        )

    def needed(self, outputs: Sequence[int]) -> list[int]:
        """Return the indices of the instructions of the new program that the outputs need, in order."""
        marked = [False] * len(self.code)
        for ref in outputs:
            marked[ref] = True
        for ref in reversed(range(len(self.code))):
            if marked[ref]:
                for arg in self.code[ref].args:
                    marked[arg] = True
        return [ref for ref, mark in enumerate(marked) if mark]

    def emit(self, op: str, *args: int, **data: Any) -> int:
        """Return the index in the new program of an instruction; an equal instruction is reused."""
        one = Instruction(op, args, **data)
        if one not in self.numbers:
            ref = self.numbers[one] = len(self.code)
            self.code.append(one)
            self.hoisted.append(op not in ("time", "state") and all(self.hoisted[arg] for arg in args))
            self.reads.append(0)
            found = tuple(sorted(f for arg in args for f in self.factors[arg])) if op == "mul" else (ref,)
            self.factors.append(found if len(found) <= MOST_COMPARED_TERMS else (ref,))
            for arg in args:
                self.reads[arg] += 1
        return self.numbers[one]

    def again(self, one: Instruction) -> Signed:
        """Emit `one`, an instruction of the old program, and return its signed result in the new program."""
        if one.op == "constant" and one.value < 0.0:
            return Signed(self.emit("constant", value=-one.value), negative=True)
        if one.op == "neg":
            value = self.values[one.args[0]]
            return Signed(value.ref, not value.negative)
        given = [self.values[arg] for arg in one.args]
        if one.op in ODD:
            return self.odd(one.op, *given)
        if one.op == "fma":
            return self.sum(self.odd("mul", *given[:2]), given[2])
        if one.op in SUMS:
            first, second = given
            return self.sum(first, Signed(second.ref, second.negative != (one.op == "sub")))
        args = [value.ref if one.op in EVEN else self.plain_of(value) for value in given]
        data = {name: getattr(one, name) for name in ("place", "value", "order", "negative")}
        return Signed(self.emit(one.op, *args, **data))

    def odd(self, op: str, a: Signed, b: Signed) -> Signed:
        """Emit a product or quotient (`op`); return its signed result, negative if one operand is negative."""
        return Signed(self.emit(op, a.ref, b.ref), a.negative != b.negative)

    def sum(self, a: Signed, b: Signed) -> Signed:
        """Emit the sum of two signed values, without terms that cancel, and return its signed value."""
        terms = [*self.terms(a), *self.terms(b)]
        if len(terms) > MOST_COMPARED_TERMS:
            return self.added(a, b)
        left = self.cancelled(terms)
        found = self.added(a, b) if len(left) == len(terms) else self.total(left)
        if self.code[found.ref].op in SUMS:
            self.sums[found.ref] = [(negative != found.negative, factors) for negative, factors in left]
        return found

    def added(self, a: Signed, b: Signed) -> Signed:
        """Return the signed sum of two values, by one addition or subtraction."""
        if a.negative == b.negative:
            return Signed(self.emit("add", a.ref, b.ref), a.negative)
        return Signed(self.emit("sub", *((b.ref, a.ref) if a.negative else (a.ref, b.ref))))

    def plain(self, ref: int) -> int:
        """Return the index in the new program of the old result `ref`, with its sign applied."""
        return self.plain_of(self.values[ref])

    def plain_of(self, value: Signed) -> int:
        """Return the index of a signed value, with its sign applied."""
        if not value.negative:
            return value.ref
        free = self.turned(value.ref, 0)
        return self.emit("neg", value.ref) if free is None else free

    def turned(self, ref: int, readers: int) -> int | None:
        """Return the index of the negative of the result `ref`, if the negation costs no operation.

        Return None if it costs one, or if more than `readers` instructions read the result.
        """
        one = self.code[ref]
        if one.op == "constant":
            return self.emit("constant", value=-one.value)
        if self.hoisted[ref]:
            return self.emit("neg", ref)
        if self.reads[ref] > readers:
            return None
        if one.op == "sub":
            return self.emit("sub", *reversed(one.args))
        if one.op not in ("add", *ODD):
            return None
        first, second = one.args
        found = self.turned(first, 1)
        if found is not None:
            return self.emit("sub" if one.op == "add" else one.op, found, second)
        found = self.turned(second, 1)
        if found is None:
            return None
        return self.emit("sub", found, first) if one.op == "add" else self.emit(one.op, first, found)

    def parts(self, ref: int) -> list[Signed]:
        """Return the signed operands of `ref` if it is a sum or difference; an empty list for other instructions."""
        one = self.code[ref]
        if one.op not in SUMS:
            return []
        return [Signed(one.args[0]), Signed(one.args[1], one.op == "sub")]

    def terms(self, value: Signed) -> list[Term]:
        """Return a value as a list of products: several for a sum that nothing else reads, otherwise one."""
        found = self.sums.get(value.ref, [(False, self.factors[value.ref])])
        return [(negative != value.negative, factors) for negative, factors in found]

    def cancelled(self, terms: list[Term]) -> list[Term]:
        """Return terms in which F*u replaces F*(u - v) and F*v, as often as such pairs occur."""
        for i, (negative, factors) in enumerate(terms):
            for difference in factors:
                rest = list(factors)
                rest.remove(difference)
                products = [
                    (negative != part.negative, tuple(sorted([*rest, *self.factors[part.ref]])))
                    for part in self.parts(difference)
                ]
                for (sign, product), kept in zip(products, reversed(products), strict=True):
                    if (not sign, product) in terms:
                        others = [one for k, one in enumerate(terms) if k != i]
                        others.remove((not sign, product))
                        return self.cancelled([*others, kept])
        return terms

    def total(self, terms: Sequence[Term]) -> Signed:
        """Emit the sum of the products `terms`, and return its signed value."""
        found = None
        for negative, factors in terms:
            value = Signed(self.product(factors), negative)
            found = value if found is None else self.added(found, value)
        if found is None:
            return Signed(self.emit("constant", value=0.0))
        return found

    def product(self, factors: Sequence[int]) -> int:
        """Emit the product of `factors`, and return its index.

        Factors of parameters alone come first. Inputs come last, because products differ most in them.
        """
        order = sorted(factors, key=lambda ref: (not self.hoisted[ref], self.code[ref].op == "state", ref))
        made = order[0]
        for ref in order[1:]:
            made = self.emit("mul", made, ref)
        return made


def _uses(program: Program) -> list[int]:
    """Return the number of instructions that read each result, counting an output as one more."""
    found = [0] * len(program.instructions)
    for one in program.instructions:
        for arg in one.args:
            found[arg] += 1
    for ref in program.outputs:
        found[ref] += 1
    return found
