"""Build a procedure from a rewritten function: each step of the function adds statements to the procedure.

Values known at build time (numbers, options, layouts, tuples) remain Python values. A condition on such values selects
a branch, and a loop over them is unrolled. If a branch or loop sets the number of a name again, the name becomes a
variable, declared before the branch or loop.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import GeneratorType, MethodType
from typing import Any

from lagrange.procedure.builder import FunctionParameter
from lagrange.procedure.form import FLAG, REAL, WHOLE, Get, Kind, Let, Procedure, Read, Set, Statement, When
from lagrange.procedure.front.control import (
    ZERO,
    Branches,
    EachBlock,
    Ended,
    Error,
    KnownBlock,
    LikelyCondition,
    LoopBlock,
    Names,
    common_kind,
    described,
    is_dynamic,
)
from lagrange.procedure.front.vocabulary import (
    OPERATION_OF,
    clear,
    generated,
    leaves,
    likely,
    operation,
    reals,
    record_of,
    unlikely,
    wholes,
)
from lagrange.procedure.interpreter import OPERATIONS as EXACT
from lagrange.procedure.values import Flag, Memory, RecordFields, Value, Whole

UNSAFE = ("quotient", "whole")
"""Operations that may stop a processor for some operands. In a conditional expression they are computed only if their
branch is taken.
"""

CONTAINERS: tuple[Any, ...] = (tuple, list, dict, zip, enumerate, reversed, len, dataclasses.replace, clear)
"""Python functions that rearrange a container, bundle or record without computing with the values in it."""


class Local:
    """A function defined inside a procedure, which is inlined into its callers."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function


class Tracer(Names):
    """Builds a procedure: a rewritten function calls a method of the tracer for each step, which adds statements.

    `results` are the kinds of the procedure's results.
    """

    Ended, local = Ended, Local

    # --- control flow

    def branches(self, test: Any) -> Branches | KnownBlock:
        """Return the branches of an `if` statement with the condition `test`.

        If the condition is known at build time, return only the branch to build.
        """
        weighed = test if isinstance(test, LikelyCondition) else LikelyCondition(test, likely=True)
        condition = weighed.condition
        if not isinstance(condition, Value):
            return KnownBlock([bool(condition)])
        if self.iterations is not None:
            raise Error("`each` cannot contain `if` statements: write `a if condition else b`.")
        self.as_flag(condition)
        return Branches(self, condition, weighed.likely if weighed is test else None)

    def loop(self, *bounds: Any) -> LoopBlock:
        """Return the loop of a `for` statement over `range(*bounds)`."""
        start, stop, step = bounds if len(bounds) == 3 else (*bounds, 1) if len(bounds) == 2 else (0, *bounds, 1)
        if not isinstance(step, int) or step <= 0:
            raise Error("give `range` a step that is a whole number above zero and known when the procedure is built.")
        first, last = (self.number(bound, WHOLE, "a bound of `range`") for bound in (start, stop))

        def index() -> Iterator[Whole]:
            with self.p.loop(first, last, step) as counter:
                yield counter

        return LoopBlock(self, index())

    def repeat(self) -> LoopBlock:
        """Return the loop of a `while` statement."""
        if self.iterations is not None:
            raise Error("`each` cannot contain `while`: use `range` instead of `each`.")
        return LoopBlock(self, iter(()))

    def sequence(self, values: Any) -> LoopBlock | KnownBlock:
        """Return an unrolled loop over values known at build time, or a loop over the values of an inline generator."""
        if isinstance(values, GeneratorType):
            return LoopBlock(self, values)
        if isinstance(values, (Value, Memory)):
            raise Error(f"a loop runs over `range`, `each` or a tuple, not over {described(values)}.")
        return KnownBlock(values)

    def each(self, count: Any, *, disjoint: bool = False, **options: Any) -> EachBlock:
        """Return the loop of an `each` with `count` iterations, which may run in any order.

        With `disjoint` the function promises that parts of an array do not overlap if one of them is written. The
        options are `width` (the most iterations at a time), `spill` (iterations may write beyond `count`) and
        `unrolled`.
        """
        if self.iterations is not None:
            raise Error("an `each` is inside another `each`: use `range` for the inner one.")
        return EachBlock(self, self.number(count, WHOLE, "the count of `each`"), options, disjoint=disjoint)

    def leave(self, value: Any) -> None:
        """Add the return from the procedure; `value` is its result, a tuple of results, or None."""
        values = () if value is None else value if isinstance(value, tuple) else (value,)
        if len(values) != len(self.results):
            raise Error(f"the procedure must return {len(self.results)} values, not {len(values)}.")
        self.p.leave(
            *[self.number(result, kind, "the result") for result, kind in zip(values, self.results, strict=True)]
        )
        raise Ended

    # --- operations

    def divide(self, a: Any, b: Any) -> Any:
        """Return the value of a / b."""
        for operand in (a, b):
            if isinstance(operand, Whole):
                raise Error("`/` divides reals: write float(n), or `//`.")
        if isinstance(a, Value) or isinstance(b, Value):
            return a / b
        return EXACT["div"](a, b)

    def floor_divide(self, a: Any, b: Any) -> Any:
        """Return the value of a // b for whole numbers: the quotient rounded down."""
        if not isinstance(a, Value) and not isinstance(b, Value):
            return a // b
        toward_zero = self.p.operation("quotient", a, b)
        rest = a - toward_zero * b
        off = ~rest.equals(0) & self.differ(
            (rest < 0), self.p.operation("less", b, 0) if isinstance(b, Value) else b < 0
        )
        return toward_zero - self.p.whole(off)

    def remainder(self, a: Any, b: Any) -> Any:
        """Return the value of a % b for whole numbers: a - (a//b)*b, which has the sign of b."""
        if not isinstance(a, Value) and not isinstance(b, Value):
            return a % b
        return a - self.floor_divide(a, b) * b

    def power(self, a: Any, b: Any) -> Any:
        """Return the value of a ** b."""
        if isinstance(a, Whole) or isinstance(b, Whole):
            raise Error("`**` takes reals: write float(n).")
        if isinstance(b, Value) and not isinstance(a, Value):
            a = self.number(a, REAL, "a base")
        return a**b

    def equal(self, a: Any, b: Any) -> Any:
        """Return the flag a == b, or a bool if both operands are known at build time."""
        if isinstance(a, Flag) or isinstance(b, Flag):
            return self.opposite(self.differ(a, b))
        return self.p.operation("equal", a, b) if isinstance(a, Value) or isinstance(b, Value) else a == b

    def differ(self, a: Any, b: Any) -> Any:
        """Return the flag a != b, or a bool if both operands are known at build time."""
        if isinstance(a, Flag) or isinstance(b, Flag):
            first, second = (self.number(operand, FLAG, "a flag") for operand in (a, b))
            return self.p.choose(Flag.of(first), self.opposite(second), second)
        return self.opposite(self.equal(a, b))

    def opposite(self, condition: Any) -> Any:
        """Return the negated condition, a flag or a bool."""
        condition = condition.condition if isinstance(condition, LikelyCondition) else condition
        return ~self.as_flag(condition) if isinstance(condition, Value) else not condition

    def joined(self, op: str, left: Any, right: Callable[[], Any]) -> Any:
        """Return the value of `left op right`, with `op` "and" or "or". The function `right` computes its operand.

        The operation becomes a branch, in which `right` runs only if needed, if `right` loads, calls or stores.
        """
        left = left.condition if isinstance(left, LikelyCondition) else left
        if not isinstance(left, Value):
            return right() if bool(left) == (op == "and") else left
        with self.p.block() as body:
            made = self.number(right(), FLAG, f"a side of `{op}`")
        condition = self.as_flag(left)
        if self.add_if_pure([body], "the right side of `and` and `or`"):
            return self.p.operation(op, condition, made)
        outcome = self.p.variable(condition)
        branch = (*body, Set(outcome.ref, made.ref))
        self.p.add(When(condition.ref, branch) if op == "and" else When(condition.ref, (), branch))
        return outcome.value

    def choose(self, test: Any, then: Callable[[], Any], otherwise: Callable[[], Any]) -> Any:
        """Return `then()` if a condition holds, else `otherwise()`.

        Both values are computed if neither function loads, calls or stores. Otherwise a branch selects the function to
        run.
        """
        condition = test.condition if isinstance(test, LikelyCondition) else test
        if not isinstance(condition, Value):
            return then() if condition else otherwise()
        bodies, values = [], []
        for way in (then, otherwise):
            with self.p.block() as body:
                values.append(way())
            bodies.append(body)
        if values[0] is values[1] and not bodies[0] and not bodies[1]:
            return values[0]
        kind = common_kind(values)
        if kind is None:
            raise Error(f"`if` chooses between numbers, not between {' and '.join(map(described, values))}.")
        for i, body in enumerate(bodies):
            with self.resumed(body):
                values[i] = self.number(values[i], kind, "the choice")
        if self.add_if_pure(bodies, "a choice"):
            return self.p.operation("select", self.as_flag(condition), *values)
        outcome = self.p.variable(ZERO[kind])
        ways = [(*body, Set(outcome.ref, value.ref)) for body, value in zip(bodies, values, strict=True)]
        self.p.add(When(self.as_flag(condition).ref, ways[0], ways[1]))
        return outcome.value

    def add_if_pure(self, bodies: Sequence[list[Statement]], construct: str) -> bool:
        """Add the statements of `bodies` to the present block if they only compute values. Return True if they do.

        `construct` names the expression in the error message: inside an `each` other blocks are not allowed.
        """
        statements = [statement for body in bodies for statement in body]
        pure = all(isinstance(s, (Get, Read)) or (isinstance(s, Let) and s.op not in UNSAFE) for s in statements)
        if not pure and self.iterations is not None:
            raise Error(f"{construct} loads or divides inside an `each`: give the value a name first.")
        if pure:
            self.p.current.extend(statements)
        return pure

    # --- memory

    def item(self, owner: Any, index: Any) -> Any:
        """Return the element at index `index` of `owner`: an array, or a tuple that is known at build time."""
        if isinstance(owner, Memory):
            return owner[self.place(owner, index, stored=False)]
        if isinstance(index, Value):
            raise Error(f"the index into {described(owner)} is known only at run time: use an array.")
        return owner[index]

    def place(self, array: Memory, index: Any, *, stored: bool) -> Value:
        """Return the index of an array element as a value. Raises Error if an `each` forbids access at this index.

        `stored` is true if the element is written.
        """
        if not isinstance(index, Value) and isinstance(index, int) and index < 0:
            raise Error(
                f"the index {index} counts from the end, and the length of an array is not known: count from 0."
            )
        number = self.number(index, WHOLE, "an index")
        if self.iterations is not None:
            self.iterations.visit(array, number, stored=stored)
        return number

    def part(self, owner: Any, lower: Any, upper: Any) -> Any:
        """Return the part of an array from index `lower` on, or the slice `lower:upper` of a tuple.

        Raises Error for a part of an array with an end `upper`.
        """
        if not isinstance(owner, Memory):
            return owner[lower:upper]
        if upper is not None:
            raise Error("a slice that is an argument has no end: write a[i:], or copy with b[:n] = a[:n].")
        if lower is None or (not isinstance(lower, Value) and lower == 0):
            return owner
        return owner.at(self.number(lower, WHOLE, "an index"))

    def store(self, owner: Any, index: Any, value: Any) -> None:
        """Set the element of an array at an index."""
        if not isinstance(owner, Memory):
            raise Error(f"{described(owner)} is known when the procedure is built: only arrays can be set.")
        if owner.array.read:
            raise Error("an array of type In cannot be written: declare it as Out.")
        owner[self.place(owner, index, stored=True)] = self.number(value, owner.array.kind, "the element")

    def write(self, owner: Any, field: str, value: Any) -> None:
        """Set a field of a record."""
        if not isinstance(owner, RecordFields):
            raise Error(f"{described(owner)} is not a record: its field {field} cannot be set.")
        setattr(owner, field, self.number(value, owner.kind_of(field), f"the field {field}"))

    def copy(self, target: Any, lower: Any, upper: Any, source: Any, first: Any, last: Any) -> None:
        """Copy the elements `first:last` of the array `source` to the elements `lower:upper` of the array `target`."""
        count = self.extent(lower, upper)
        source_count = None if last is None else self.extent(first, last)
        if isinstance(count, int) and isinstance(source_count, int) and count != source_count:
            raise Error(f"{source_count} numbers are copied to {count} elements: give slices of the same length.")
        values, part = self.part(source, first, None), self.part(target, lower, None)
        with self.p.each(count) as i:
            part[i] = values[i]

    def fill(self, target: Any, lower: Any, upper: Any, value: Any) -> None:
        """Set each of the elements `lower:upper` of an array to a value."""
        part = self.part(target, lower, None)
        number = self.number(value, part.array.kind, "the element")
        with self.p.each(self.extent(lower, upper)) as i:
            part[i] = number

    def extent(self, lower: Any, upper: Any) -> Any:
        """Return the number of elements from index `lower` up to, but not including, index `upper`."""
        if upper is None:
            raise Error("give the slice that is written an end: write b[:n] = a[:n].")
        return upper if lower is None or (not isinstance(lower, Value) and lower == 0) else upper - lower

    # --- calls

    def call(self, function: Any, /, *args: Any, **options: Any) -> Any:
        """Return the result of a call.

        A call of a procedure becomes a statement, an inline function is inlined, and a function of known values is
        computed.
        """
        if function in (likely, unlikely):
            return LikelyCondition(args[0], function is likely) if isinstance(args[0], Value) else args[0]
        if isinstance(function, Local):
            return function.function(*args, **options)
        if function is generated:
            return self.call_procedure(args[0], [leaf for arg in args[1:] for leaf in leaves(arg)])
        if isinstance(function, FunctionParameter):
            self._outside_each("a function parameter")
            return function(*[leaf for arg in args for leaf in leaves(arg)])
        if isinstance(function, MethodType) and hasattr(function.__func__, "traced"):
            return function.__func__.traced(self, function.__self__, *args, **options)
        if hasattr(function, "traced"):
            return function.traced(self, *args, **options)
        stated = record_of(function)
        if stated is not None:
            return self.p.reserve_record(stated)
        if function is reals or function is wholes:
            return self.p.reserve(args[0], REAL if function is reals else WHOLE, **options)
        if not any(is_dynamic(arg) for arg in (*args, *options.values())):
            known = EXACT[OPERATION_OF[function]] if function in OPERATION_OF else function
            return known(*args, **options)
        return self._of_values(function, args, options)

    def call_procedure(self, callee: Procedure, args: list[Any]) -> Any:
        """Add a call of a procedure, and return its results: None, a value or a tuple of values.

        `args` are the arguments; a bundle (a dataclass) is replaced by its fields.
        """
        self._outside_each(callee.name)
        if len(args) != len(callee.parameters):
            raise Error(f"{callee.name} takes {len(callee.parameters)} arguments; {len(args)} are given.")
        pairs = zip(args, callee.parameters, strict=True)
        passed = [
            self.number(arg, parameter.type, f"{parameter.name} of {callee.name}")
            if isinstance(parameter.type, Kind)
            else arg
            for arg, parameter in pairs
        ]
        return self.p.call(callee, *passed)

    def _outside_each(self, callee: str) -> None:
        if self.iterations is not None:
            raise Error(f"`each` cannot contain the call of {callee}: use `range`.")

    def _of_values(self, function: Any, args: Sequence[Any], options: Mapping[str, Any]) -> Any:
        """Return the result of a Python function such as `max`, for arguments that are known at run time only."""
        if function is float:
            return self.p.real(*args)
        if function is int:
            return self.p.whole(*args)
        if function is max or function is min:
            return self.extreme(function, args)
        if function in OPERATION_OF:
            return self.p.operation(OPERATION_OF[function], *args)
        if function is operation:
            return self.p.operation(*args)
        if function in CONTAINERS or (isinstance(function, type) and dataclasses.is_dataclass(function)):
            return function(*args, **options)
        name = getattr(function, "__name__", repr(function))
        raise Error(f"`{name}` is not a procedure: declare it with @inline or @procedure.")
