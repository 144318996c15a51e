"""Run a rewritten function on numbers, with the arithmetic of the form: the reference for tests of all machines.

Operations never raise, as in a processor (1/0 is infinite). A sum over an `each` is added in the order that `form.Fold`
defines. With a seed, the iterations of an `each` run in a shuffled order.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from lagrange.procedure.form import PARTIAL
from lagrange.procedure.front.kinds import Missing
from lagrange.procedure.front.vocabulary import OPERATION_OF, REDUCTIONS, record_of
from lagrange.procedure.interpreter import LARGER, OPERATIONS, Span


class Returned(Exception):
    """Exception that carries the result of a `return` out of nested blocks."""

    def __init__(self, value: Any) -> None:
        super().__init__()
        self.value = value


class Exact:
    """The receiver that computes. With a `seed`, the iterations of each `each` run in a shuffled order."""

    Ended = Returned

    def __init__(self, seed: int | None = None) -> None:
        self.random = None if seed is None else random.Random(seed)

    def run(self, function: Callable[..., Any], /, *args: Any, **options: Any) -> Any:
        """Return the result of a rewritten function for its arguments."""
        try:
            function(self, *args, **options)
        except Returned as returned:
            return returned.value
        return None

    def missing(self, name: str) -> Missing:
        """Return the placeholder for a name without a value."""
        return Missing(name)

    def read(self, value: Any) -> Any:
        """Return the value of a name. Raises an error if the name has no value."""
        assert not isinstance(value, Missing), f"{value.name} is read before it is set"
        return value

    def assign(self, before: Any, name: str, value: Any) -> Any:
        """Return `value`, the new value of a name. The builder's method of this name sets a variable."""
        return value

    def named(self, name: str, value: Any) -> Any:
        """Return a value unchanged. The builder's method of this name records the name for printed code."""
        return value

    def unpacked(self, value: Any, count: int) -> Any:
        """Return the `count` values of a tuple."""
        return value

    def note(self, said: str) -> None:
        """Ignore a comment, because no code is printed."""

    def leave(self, value: Any) -> None:
        """End the function with a result, by raising `Returned`."""
        raise Returned(value)

    # --- control flow

    def branches(self, test: Any) -> Ways:
        """Return the branch to run, as values to loop over: True, or False."""
        return Ways([bool(test)])

    def loop(self, *bounds: int) -> Ways:
        """Return the loop over `range(*bounds)`."""
        return Ways(range(*bounds))

    def sequence(self, values: Any) -> Ways:
        """Return the iterable of a `for` loop over a tuple, or over the values of an inline generator."""
        return Ways(values)

    def repeat(self) -> Ways:
        """Return the loop of a `while` statement."""
        return Ways(())

    def each(self, count: int, **options: Any) -> Iterations:
        """Return the loop of an `each` with `count` iterations."""
        order = list(range(count))
        if self.random is not None:
            self.random.shuffle(order)
        return Iterations(order)

    # --- operations

    def divide(self, a: Any, b: Any) -> Any:
        """Return a / b, infinite or NaN for b = 0."""
        return OPERATIONS["div"](a, b)

    def floor_divide(self, a: Any, b: Any) -> Any:
        """Return a // b of whole numbers."""
        return a // b

    def remainder(self, a: Any, b: Any) -> Any:
        """Return a % b of whole numbers."""
        return a % b

    def power(self, a: Any, b: Any) -> Any:
        """Return a ** b, computed as the builder does."""
        return OPERATIONS["power"](float(a), float(b))

    def equal(self, a: Any, b: Any) -> bool:
        """Return a == b."""
        return bool(a == b)

    def differ(self, a: Any, b: Any) -> bool:
        """Return a != b."""
        return bool(a != b)

    def opposite(self, condition: Any) -> bool:
        """Return `not condition`."""
        return not condition

    def both(self, left: Any, right: Callable[[], Any]) -> Any:
        """Return `left and right`. The function `right` computes the second operand."""
        return left and right()

    def either(self, left: Any, right: Callable[[], Any]) -> Any:
        """Return `left or right`. The function `right` computes the second operand."""
        return left or right()

    def choose(self, test: Any, then: Callable[[], Any], otherwise: Callable[[], Any]) -> Any:
        """Return `then()` if the condition holds, else `otherwise()`."""
        return then() if test else otherwise()

    # --- memory

    def item(self, owner: Any, place: Any) -> Any:
        """Return the element at index `place` of an array or tuple."""
        value = owner[place]
        return value.item() if isinstance(value, np.generic) else value

    def part(self, owner: Any, lower: Any, upper: Any) -> Any:
        """Return the part of an array from index `lower` on, or a slice of a tuple."""
        if isinstance(owner, Span):
            return owner.part(lower or 0)
        return owner[lower:upper]

    def store(self, owner: Any, place: Any, value: Any) -> None:
        """Set the element of an array at index `place`."""
        owner[place] = value

    def write(self, owner: Any, field: str, value: Any) -> None:
        """Set a field of a record."""
        setattr(owner, field, value)

    def copy(self, target: Any, lower: Any, upper: Any, source: Any, first: Any, last: Any) -> None:
        """Copy the elements `first:last` of the array `source` to the elements `lower:upper` of the array `target`."""
        for i in range(upper - (lower or 0)):
            target[(lower or 0) + i] = source[(first or 0) + i]

    def fill(self, target: Any, lower: Any, upper: Any, value: Any) -> None:
        """Set each of the elements `lower:upper` of an array to a value."""
        for i in range(lower or 0, upper):
            target[i] = value

    # --- calls

    def local(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that is defined inside another one, unchanged."""
        return function

    def call(self, function: Any, /, *args: Any, **options: Any) -> Any:
        """Return the result of a call of a procedure, inline function or Python function."""
        if hasattr(function, "computed"):
            return function.computed(self, *args, **options)
        stated = record_of(function)
        if stated is not None:
            return stated.structure()
        if function in OPERATION_OF:
            return OPERATIONS[OPERATION_OF[function]](*args)
        return function(*args, **options)


class Ways:
    """A branch or loop that runs: the values to loop over, or the flag of the branch."""

    def __init__(self, values: Any) -> None:
        self.source = values
        self.values: Sequence[Any] = ()

    def __iter__(self) -> Iterator[Any]:
        return iter(self.source)

    def times(self, test: Callable[[], Any]) -> Iterator[None]:
        """Yield once for each iteration of a `while`, as long as the test holds."""
        while test():
            yield None

    def open(self, names: Sequence[str], anew: Sequence[str], *values: Any) -> Sequence[Any]:
        """Return the values of names inside the loop or branch, which are the values before it."""
        self.values = values
        return values

    def close(self, *values: Any) -> Sequence[Any]:
        """Store the values of names at the end of an iteration or branch. Return the values for the next iteration."""
        self.values = values
        return values

    def ended(self, ended: Exception) -> None:
        """Raise `ended`, the exception that carries the result of a return inside the block."""
        raise ended

    def after(self) -> Sequence[Any]:
        """Return the values of names after the block."""
        return self.values


class Iterations(Ways):
    """The iterations of an `each`.

    Values of names set in an iteration are dropped. Reductions are computed at the end.
    """

    def __init__(self, order: Sequence[int]) -> None:
        super().__init__(order)
        self.index = 0
        self.folds: dict[int, tuple[str, dict[int, tuple[float, ...]]]] = {}
        self.first: Sequence[Any] = ()

    def __iter__(self) -> Iterator[int]:
        for index in self.source:
            self.index = index
            yield index

    def open(self, names: Sequence[str], anew: Sequence[str], *values: Any) -> Sequence[Any]:
        """Return the values of names inside an iteration, which are the values before the loop."""
        self.first = values
        return super().open(names, anew, *values)

    def close(self, *values: Any) -> Sequence[Any]:
        """Return the values of names for the next iteration, which are the values before the loop."""
        return self.first

    def fold(self, slot: int, function: Any, *values: float) -> None:
        """Store `values`, one value or two factors, for the reduction with index `slot`.

        `function` is the reduction or its name.
        """
        op = function if isinstance(function, str) else REDUCTIONS[function]
        self.folds.setdefault(slot, (op, {}))[1][self.index] = values

    def folded(self, slot: int, first: float) -> float:
        """Return the result of the reduction with index `slot`. `first` is the value of its name before the loop."""
        if slot not in self.folds:
            return first
        op, by_index = self.folds[slot]
        values = [by_index[i] for i in sorted(by_index)]
        if op in ("add", "dot"):
            sums = [0.0] * PARTIAL
            for i, given in enumerate(values):
                before = sums[i % PARTIAL]
                sums[i % PARTIAL] = before + given[0] if op == "add" else OPERATIONS["fma"](*given, before)
            return first + ((sums[0] + sums[1]) + (sums[2] + sums[3]))
        sign = -1.0 if op == "least" else 1.0
        result = 0.0 if op == "magnitude" else -math.inf
        for (value,) in values:
            result = LARGER["most" if op == "least" else op](result, sign * value)
        if op in ("most", "least"):
            return LARGER["most"](sign * first, result) * sign
        return LARGER[op](first, result)
