"""Rewrite a program with fewer operations, for machines on which each operation is a call. Only rounding differs.

Signs are moved to operations that absorb them without cost. A multiply-add becomes two operations, so that products can
be shared. Derivatives of an angle between two links give sums with F*(u - v) and F*v; these sums become F*u.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from lagrange.program.program import GIVEN, Instruction, Program, arranged, uses_of

LONGEST_PROGRAM = 4000
"""Largest number of instructions of a program that is simplified. Simplification takes 10 us for each instruction."""

MOST_COMPARED_TERMS = 40
"""Largest number of terms of a sum, or factors of a product, that are searched for savings, because each is compared
with all others.
"""

ODD, EVEN = ("mul", "div"), ("abs", "cos")
"""Operations whose result changes its sign with an operand, and operations that ignore the sign of their operand."""

SUMS = ("add", "sub")
NO_OPERATION = (*GIVEN, "component")


class Signed(NamedTuple):
    """A signed result of the simplified program: the result with the index `ref`, or its negative if `negative`."""

    ref: int
    negative: bool = False


Term = tuple[bool, tuple[int, ...]]
"""A product in a sum: True if it is subtracted, and its factors, sorted."""


def simplified(program: Program) -> Program:
    """Return an equivalent program with fewer operations.

    The result is `program` itself if no operation can be saved, or if it has more than `LONGEST_PROGRAM`
    instructions.
    """
    if len(program.instructions) > LONGEST_PROGRAM:
        return program
    shorter = _Simplifier(program).finish()
    return shorter if operations(shorter) < operations(program) else program


def operations(program: Program) -> int:
    """Return the number of operations of one evaluation; a multiply-add counts as two."""
    moving = program.instructions[program.hoisted :]
    return sum(instruction.op not in NO_OPERATION for instruction in moving) + sum(
        instruction.op == "fma" for instruction in moving
    )


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

    def finish(self) -> Program:
        """Return the new, simplified program."""
        for instruction, uses in zip(self.program.instructions, uses_of(self.program, twice=()), strict=True):
            value = self.translate(instruction)
            self.values.append(value)
            if uses > 1:
                self.sums.pop(value.ref, None)
        outputs = [self.unsigned(self.values[ref]) for ref in self.program.outputs]
        instructions, hoisted, refs = arranged(self.code, outputs, self.hoisted.__getitem__)
        return replace(self.program, instructions=instructions, hoisted=hoisted, outputs=refs)

    def emit(self, op: str, *args: int, **data: Any) -> int:
        """Return the index of the instruction `op` on the results `args` of the new program; an equal one is reused.

        The new program is the simplified one. `data` has the other fields of the instruction.
        """
        instruction = Instruction(op, args, **data)
        if instruction not in self.numbers:
            ref = self.numbers[instruction] = len(self.code)
            self.code.append(instruction)
            self.hoisted.append(op not in ("time", "state") and all(self.hoisted[arg] for arg in args))
            self.reads.append(0)
            factors = tuple(sorted(f for arg in args for f in self.factors[arg])) if op == "mul" else (ref,)
            self.factors.append(factors if len(factors) <= MOST_COMPARED_TERMS else (ref,))
            for arg in args:
                self.reads[arg] += 1
        return self.numbers[instruction]

    def translate(self, instruction: Instruction) -> Signed:
        """Emit the simplified form of an instruction of the old program, and return its signed new result."""
        if instruction.op == "constant" and instruction.value < 0.0:
            return Signed(self.emit("constant", value=-instruction.value), negative=True)
        if instruction.op == "neg":
            value = self.values[instruction.args[0]]
            return Signed(value.ref, not value.negative)
        operands = [self.values[arg] for arg in instruction.args]
        if instruction.op in ODD:
            return self.signed_product(instruction.op, *operands)
        if instruction.op == "fma":
            return self.sum(self.signed_product("mul", *operands[:2]), operands[2])
        if instruction.op in SUMS:
            first, second = operands
            return self.sum(first, Signed(second.ref, second.negative != (instruction.op == "sub")))
        args = [value.ref if instruction.op in EVEN else self.unsigned(value) for value in operands]
        data = {name: getattr(instruction, name) for name in ("place", "value", "order", "negative")}
        return Signed(self.emit(instruction.op, *args, **data))

    def signed_product(self, op: str, a: Signed, b: Signed) -> Signed:
        """Emit the product or quotient of two signed values, and return its signed result.

        `op` is "mul" or "div". The result is negative if exactly one operand is.
        """
        return Signed(self.emit(op, a.ref, b.ref), a.negative != b.negative)

    def sum(self, a: Signed, b: Signed) -> Signed:
        """Emit the sum of two signed values, without terms that cancel, and return its signed value."""
        terms = [*self.terms(a), *self.terms(b)]
        if len(terms) > MOST_COMPARED_TERMS:
            return self.added(a, b)
        left = self.cancelled(terms)
        result = self.added(a, b) if len(left) == len(terms) else self.total(left)
        if self.code[result.ref].op in SUMS:
            self.sums[result.ref] = [(negative != result.negative, factors) for negative, factors in left]
        return result

    def added(self, a: Signed, b: Signed) -> Signed:
        """Emit one addition or subtraction of two signed values, and return its signed result."""
        if a.negative == b.negative:
            return Signed(self.emit("add", a.ref, b.ref), a.negative)
        return Signed(self.emit("sub", *((b.ref, a.ref) if a.negative else (a.ref, b.ref))))

    def unsigned(self, value: Signed) -> int:
        """Return the index of an instruction that computes a signed value; its sign may take a further operation."""
        if not value.negative:
            return value.ref
        free = self.negative_of(value.ref, 0)
        return self.emit("neg", value.ref) if free is None else free

    def negative_of(self, ref: int, readers: int) -> int | None:
        """Return the index of a result that is the negative of the result `ref` without a further operation.

        Return None if the negative needs an operation, or if more than `readers` instructions read the result.
        """
        instruction = self.code[ref]
        if instruction.op == "constant":
            return self.emit("constant", value=-instruction.value)
        if self.hoisted[ref]:
            return self.emit("neg", ref)
        if self.reads[ref] > readers:
            return None
        if instruction.op == "sub":
            return self.emit("sub", *reversed(instruction.args))
        if instruction.op not in ("add", *ODD):
            return None
        first, second = instruction.args
        negated = self.negative_of(first, 1)
        if negated is not None:
            return self.emit("sub" if instruction.op == "add" else instruction.op, negated, second)
        negated = self.negative_of(second, 1)
        if negated is None:
            return None
        return (
            self.emit("sub", negated, first) if instruction.op == "add" else self.emit(instruction.op, first, negated)
        )

    def addends(self, ref: int) -> list[Signed]:
        """Return the signed operands of `ref` if it is a sum or difference; an empty list for other instructions."""
        instruction = self.code[ref]
        if instruction.op not in SUMS:
            return []
        return [Signed(instruction.args[0]), Signed(instruction.args[1], instruction.op == "sub")]

    def terms(self, value: Signed) -> list[Term]:
        """Return a value as a list of terms (True if subtracted, indices of the factors).

        A sum that no other instruction reads has several terms; any other value is one term.
        """
        terms = self.sums.get(value.ref, [(False, self.factors[value.ref])])
        return [(negative != value.negative, factors) for negative, factors in terms]

    def cancelled(self, terms: list[Term]) -> list[Term]:
        """Return the terms of a sum after F*u has replaced each pair of terms F*(u - v) and F*v."""
        for i, (negative, factors) in enumerate(terms):
            for difference in factors:
                rest = list(factors)
                rest.remove(difference)
                products = [
                    (negative != part.negative, tuple(sorted([*rest, *self.factors[part.ref]])))
                    for part in self.addends(difference)
                ]
                for (sign, product), kept in zip(products, reversed(products), strict=True):
                    if (not sign, product) in terms:
                        remaining = [term for k, term in enumerate(terms) if k != i]
                        remaining.remove((not sign, product))
                        return self.cancelled([*remaining, kept])
        return terms

    def total(self, terms: Sequence[Term]) -> Signed:
        """Emit the sum of `terms`, signed products of factors, and return its signed value."""
        result = None
        for negative, factors in terms:
            value = Signed(self.product(factors), negative)
            result = value if result is None else self.added(result, value)
        if result is None:
            return Signed(self.emit("constant", value=0.0))
        return result

    def product(self, factors: Sequence[int]) -> int:
        """Emit the product of the results with the indices `factors`, and return its index.

        Factors that depend only on parameters come first, and inputs come last. Products that differ only in inputs
        then share the product of their other factors.
        """
        order = sorted(factors, key=lambda ref: (not self.hoisted[ref], self.code[ref].op == "state", ref))
        made = order[0]
        for ref in order[1:]:
            made = self.emit("mul", made, ref)
        return made
