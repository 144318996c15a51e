"""Lowering from graph to program: sums, products and powers as binary operations, with operations on parameters first.

Sums become chains of fused multiply-adds. In products the parameters are multiplied first, so that this part is
computed once per run. A power with an integer or half-integer exponent becomes multiplications and square roots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import MAX_EMAX, MIN_EMIN, Decimal, localcontext
from fractions import Fraction
from typing import Any

from lagrange.errors import StatementError
from lagrange.graph.node import Binding, Exact, Graph, Kind, Node, reachable
from lagrange.program.program import Instruction, Program, ProgramBlock, arranged
from lagrange.statement.run_settings import CHECKED_EVERY, check_time

Named = Mapping[str, Sequence[Node]]
"""Nodes in blocks, each under a name."""


def lower(
    name: str,
    results: Named,
    inputs: Named,
    time: Node,
    parameters: Sequence[Node],
    *,
    shape: tuple[int, ...] | None = None,
    returned: tuple[str, ...] = (),
    solved: bool = False,
) -> Program:
    """Return the program that computes the nodes `results` from t, `inputs` and parameters.

    The results fill `shape` in C order; the default is a vector. `returned` names the results that a call from a step
    returns in registers. `solved` is true if results are solutions of a system with the mass matrix.
    """
    outputs, state = ([node for block in named.values() for node in block] for named in (results, inputs))
    lowering = _Lowering(outputs[0].graph, outputs, state, time, parameters)
    refs = [lowering.ref(node) for node in outputs]
    instructions, hoisted, output_refs = arranged(lowering.instructions, refs, lowering.is_early)
    return Program(
        name=name,
        inputs=tuple(ProgramBlock(block, len(nodes)) for block, nodes in inputs.items()),
        parameters=len(parameters),
        instructions=instructions,
        hoisted=hoisted,
        outputs=output_refs,
        results=tuple(ProgramBlock(block, len(nodes)) for block, nodes in results.items()),
        shape=(len(outputs),) if shape is None else shape,
        returned=returned,
        solved=solved,
    )


class _Lowering:
    """Translates graph nodes to the instructions of a program. Equal instructions are emitted once.

    The level of an instruction says what it depends on: nothing (a constant), parameters alone, or the motion.
    """

    def __init__(
        self, graph: Graph, outputs: Sequence[Node], state: Sequence[Node], time: Node, parameters: Sequence[Node]
    ) -> None:
        self.graph = graph
        self.instructions: list[Instruction] = []
        self.levels: list[Binding] = []
        self.numbers: dict[Instruction, int] = {}
        self.done: dict[Node, int] = {}
        self.done[time] = self.emit("time", level=Binding.TIME)
        for i, node in enumerate(state):
            self.done[node] = self.emit("state", place=i, level=node.binding)
        for i, node in enumerate(parameters):
            self.done[node] = self.emit("parameter", place=i, level=node.binding)
        order = reachable(outputs)
        self.uses: dict[Node, int] = dict.fromkeys(outputs, 1)
        self.inner: set[Node] = set()
        for node in order:
            for arg in node.args:
                self.uses[arg] = self.uses.get(arg, 0) + 1
            if node.kind is Kind.PRODUCT:
                self.inner.update(arg for arg in node.args if arg.kind is Kind.PRODUCT)
        for node in _depth_first(outputs):
            # A multiply-add absorbs a product that is used once, as a term of a sum or as a divisor.
            fused = node.kind is Kind.PRODUCT and self.uses.get(node, 0) == 1 and node not in self.inner
            if node not in self.done and not fused:
                self.done[node] = self.compute(node)

    def ref(self, node: Node) -> int:
        """Return the index of the instruction that computes a node. Missing instructions are emitted."""
        if node not in self.done:
            self.done[node] = self.compute(node)
        return self.done[node]

    def emit(self, op: str, *args: int, level: Binding = Binding.CONSTANT, **data: Any) -> int:
        """Return the index of the instruction `op` on the results with the indices `args`.

        An equal instruction is reused; otherwise a new one is added. `level` says on what it depends in addition to its
        operands: nothing, parameters or the motion. `data` are its other fields.
        """
        instruction = Instruction(op, args, **data)
        if instruction not in self.numbers:
            if not len(self.instructions) % CHECKED_EVERY:
                check_time()
            self.numbers[instruction] = len(self.instructions)
            self.instructions.append(instruction)
            self.levels.append(max([level, *(self.levels[arg] for arg in args)]))
        return self.numbers[instruction]

    def constant(self, value: Exact) -> int:
        """Return the index of the instruction for the double nearest to an exact constant.

        Raises StatementError if that double is infinite, or if it is zero and the constant is not.
        """
        try:
            nearest = float(value)
        except OverflowError:
            raise _beyond_doubles(value, "too large for") from None
        if nearest == 0.0 and value:
            raise _beyond_doubles(value, "not zero, and too small for")
        return self.emit("constant", value=nearest)

    def compute(self, node: Node) -> int:
        """Emit the instructions of one node, after those of its arguments, and return the index of its result."""
        if node.kind is Kind.CONSTANT:
            return self.constant(node.data)
        if node.kind is Kind.SUM:
            return self.sum(node)
        if node.kind is Kind.PRODUCT:
            return self.product(1, node.args)
        if node.kind is Kind.POWER:
            return self.power(self.ref(node.args[0]), node.data)
        args = [self.ref(arg) for arg in node.args]
        if node.kind is Kind.CALL:
            return self.call(node.data, args)
        if node.kind is Kind.COMPONENT:
            return self.emit("component", *args, place=node.data)
        if node.kind is Kind.FACTOR:
            order, negative = node.data
            return self.emit("factor", *args, order=order, negative=negative)
        return self.emit(node.kind.value, *args, order=node.data)

    def sum(self, node: Node) -> int:
        """Emit a linear combination, and return the index of its result. Terms of parameters alone come first."""
        constant, coefficients = node.data
        total: int | None = None
        # Positive terms come before negative terms, which then are subtractions.
        terms = zip(coefficients, node.args, strict=True)
        for coefficient, arg in sorted(terms, key=lambda t: (t[1].binding > Binding.PARAMETER, t[0] < 0, t[1].id)):
            total = self.add_term(total, coefficient, arg)
        if total is None or constant:
            return self.add(total, self.constant(constant))
        return total

    def add(self, total: int | None, term: int) -> int:
        return term if total is None else self.emit("add", total, term)

    def add_term(self, total: int | None, coefficient: Exact, arg: Node) -> int:
        """Emit total + coefficient * arg, and return the index of the result.

        `total` is the index of a result, or None for zero.
        """
        negative = coefficient < 0
        if arg.kind is Kind.PRODUCT and arg not in self.done:
            over, under = _split_factors(arg.args, self.uses)
            if not under:
                return self.add_product(total, coefficient, over)
            value = self.product(-coefficient if negative else coefficient, arg.args)
        else:
            value = self.ref(arg)
            if abs(coefficient) != 1:
                return self.fused(total, self.constant(coefficient), value)
        if total is None:
            return self.emit("neg", value) if negative else value
        return self.emit("sub" if negative else "add", total, value)

    def add_product(self, total: int | None, coefficient: Exact, factors: Sequence[Node]) -> int:
        """Emit total + coefficient * product of the factors, and return the index of the result.

        `total` is the index of a result, or None for zero. The last factor enters by a multiply-add.
        """
        *first, last = factors
        if last.binding <= Binding.PARAMETER or total is None:
            value = self.chain(coefficient, factors)
            return self.add(total, value)
        return self.fused(total, self.chain(coefficient, first), self.ref(last))

    def fused(self, total: int | None, a: int, b: int) -> int:
        return self.emit("mul", a, b) if total is None else self.emit("fma", a, b, total)

    def product(self, coefficient: Exact, factors: Sequence[Node]) -> int:
        over, under = _split_factors(factors, self.uses)
        if not under:
            return self.chain(coefficient, over)
        divisors = [self.power(self.ref(node.args[0]), -node.data) for node in under]
        divisor = divisors[0]
        for factor in divisors[1:]:
            divisor = self.emit("mul", divisor, factor)
        return self.emit("div", self.chain(coefficient, over), divisor)

    def chain(self, coefficient: Exact, factors: Sequence[Node]) -> int:
        """Emit coefficient * product of the factors, and return the index of the result.

        The coefficient and the parameters are multiplied first.
        """
        value: int | None = None
        refs = [(node.binding <= Binding.PARAMETER, self.ref(node)) for node in factors]
        for _, ref in (pair for pair in refs if pair[0]):
            value = ref if value is None else self.emit("mul", value, ref)
        if abs(coefficient) != 1 or (value is None and not refs):
            scale = self.constant(coefficient)
            value = scale if value is None else self.emit("mul", scale, value)
        elif coefficient < 0 and value is not None:
            value = self.emit("neg", value)
        negate = coefficient == -1 and value is None
        for _, ref in (pair for pair in refs if not pair[0]):
            value = ref if value is None else self.emit("mul", value, ref)
        if value is None:
            raise AssertionError("a product has no factor: the graph replaces it by its coefficient")
        return self.emit("neg", value) if negate else value

    def power(self, base: int, exponent: Exact) -> int:
        """Emit base ** exponent, where `base` is the index of a result, and return the index of the power.

        Multiplications, square roots and a reciprocal are used where the exponent allows.
        """
        if exponent < 0:
            return self.emit("div", self.constant(1), self.power(base, -exponent))
        if exponent == Fraction(1, 2):
            return self.emit("sqrt", base)
        if isinstance(exponent, int) and exponent <= 64:
            if exponent == 1:
                return base
            half = self.power(base, exponent // 2)
            square = self.emit("mul", half, half)
            return self.emit("mul", square, base) if exponent % 2 else square
        if isinstance(exponent, Fraction) and exponent.denominator == 2 and exponent <= 32:
            whole = self.power(base, int(exponent))
            return self.emit("mul", whole, self.emit("sqrt", base))
        return self.emit("power", base, self.constant(exponent))

    def call(self, name: str, args: list[int]) -> int:
        if name in _CONSTANTS:
            return self.emit("constant", value=_CONSTANTS[name])
        if name == "pow":
            return self.emit("power", *args)
        if name != "piecewise":
            return self.emit(name, *args)
        value = args[-1]
        for condition, chosen in list(zip(args[:-1:2], args[1::2], strict=True))[::-1]:
            value = self.emit("select", condition, chosen, value)
        return value

    def is_early(self, ref: int) -> bool:
        """Return True if instruction number `ref` is placed in the first part of the program.

        This part reads all parameters, and computes all results that depend only on parameters. Results of parameters
        that change along a motion are computed later.
        """
        return self.levels[ref] <= Binding.PARAMETER or self.instructions[ref].op == "parameter"


_CONSTANTS = {"pi": 3.141592653589793, "e": 2.718281828459045, "nan": float("nan")}


def _beyond_doubles(value: Exact, what: str) -> StatementError:
    """Return the error for an exact constant that is infinite or zero as a double.

    `what` is the part of the message that says which. The user need not have written the constant: x/5e-324
    contains 2e323.
    """
    exact = Fraction(value)
    with localcontext(prec=8, Emax=MAX_EMAX, Emin=MIN_EMIN):
        size = Decimal(exact.numerator) / Decimal(exact.denominator)
    return StatementError(
        f"the equations contain the constant {size:.2e}, which is {what} a floating-point number (4.9e-324 to 1.8e+308 "
        "in size). It is a product, quotient or power of numbers in the statement: choose units in which these are "
        "nearer to 1."
    )


def _split_factors(factors: Sequence[Node], uses: dict[Node, int]) -> tuple[list[Node], list[Node]]:
    """Return the factors of a product in two lists: factors to multiply by, and factors to divide by.

    Divisors come from negative powers that are used only in this product, and whose bases depend on more than
    parameters. `uses` counts the uses of each node.
    """
    under = [
        node
        for node in factors
        if node.kind is Kind.POWER and node.data < 0 and node.binding > Binding.PARAMETER and uses.get(node, 0) == 1
    ]
    return [node for node in factors if node not in under], under


def _depth_first(outputs: Sequence[Node]) -> list[Node]:
    """Return all nodes on which the outputs depend, with the arguments of a node before it.

    Nodes of one output are adjacent, so that values have short lives.
    """
    seen: set[Node] = set()
    order: list[Node] = []
    for output in outputs:
        stack = [(output, False)]
        while stack:
            node, expanded = stack.pop()
            if expanded:
                order.append(node)
            elif node not in seen:
                seen.add(node)
                stack.append((node, True))
                stack.extend((arg, False) for arg in reversed(node.args) if arg not in seen)
    return order
