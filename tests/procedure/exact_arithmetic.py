"""Execution of a rewritten function on numbers, with the arithmetic of the form, instead of building a procedure.

Operations never raise errors, as in a processor (1/0 is infinite). A sum over an `each` is added in the order that
`form.Fold` defines. With a seed, the iterations of an `each` run in a shuffled order.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from types import MethodType
from typing import Any

import numpy as np

from lagrange.procedure.form import PARTIAL
from lagrange.procedure.front.decorators import Inline, Plain, PlainFunction
from lagrange.procedure.front.names import Missing
from lagrange.procedure.front.vocabulary import OPERATION_OF, REDUCTIONS, record_of
from lagrange.procedure.interpreter import LARGER, OPERATIONS, Span


class Returned(Exception):
    """Exception that carries the result of a `return` out of nested blocks."""

    def __init__(self, value: Any) -> None:
        super().__init__()
        self.value = value


class Exact:
    """The receiver of a rewritten function that computes.

    With a `seed`, iterations of `each` run in a shuffled order.
    """

    Ended = Returned

    def __init__(self, seed: int | None = None) -> None:
        self.random = None if seed is None else random.Random(seed)

    def run(self, plain: PlainFunction[Any, Any], /, *args: Any, **options: Any) -> Any:
        try:
            plain.rewritten(self, **plain.bound(args, options))
        except Returned as returned:
            return returned.value
        return None

    def missing(self, name: str) -> Missing:
        return Missing(name)

    def read(self, value: Any) -> Any:
        assert not isinstance(value, Missing), f"{value.name} is read before it is set"
        return value

    def assign(self, before: Any, name: str, value: Any) -> Any:
        return value

    def named(self, name: str, value: Any) -> Any:
        return value

    def unpacked(self, value: Any, count: int) -> Any:
        return value

    def note(self, said: str) -> None:
        pass

    def leave(self, value: Any) -> None:
        raise Returned(value)

    # --- control flow

    def branches(self, test: Any) -> Ways:
        return Ways([bool(test)])

    def loop(self, *bounds: int) -> Ways:
        return Ways(range(*bounds))

    def sequence(self, values: Any) -> Ways:
        return Ways(values)

    def repeat(self) -> Ways:
        return Ways(())

    def each(self, count: int, **options: Any) -> Iterations:
        order = list(range(count))
        if self.random is not None:
            self.random.shuffle(order)
        return Iterations(order)

    # --- operations

    def divide(self, a: Any, b: Any) -> Any:
        return OPERATIONS["div"](a, b)

    def floor_divide(self, a: Any, b: Any) -> Any:
        return a // b

    def remainder(self, a: Any, b: Any) -> Any:
        return a % b

    def power(self, a: Any, b: Any) -> Any:
        return OPERATIONS["power"](float(a), float(b))

    def equal(self, a: Any, b: Any) -> bool:
        return bool(a == b)

    def differ(self, a: Any, b: Any) -> bool:
        return bool(a != b)

    def opposite(self, condition: Any) -> bool:
        return not condition

    def joined(self, op: str, left: Any, right: Callable[[], Any]) -> Any:
        return left and right() if op == "and" else left or right()

    def choose(self, test: Any, then: Callable[[], Any], otherwise: Callable[[], Any]) -> Any:
        return then() if test else otherwise()

    # --- memory

    def item(self, owner: Any, place: Any) -> Any:
        value = owner[place]
        return value.item() if isinstance(value, np.generic) else value

    def part(self, owner: Any, lower: Any, upper: Any) -> Any:
        if isinstance(owner, Span):
            return owner.part(lower or 0)
        return owner[lower:upper]

    def store(self, owner: Any, place: Any, value: Any) -> None:
        owner[place] = value

    def write(self, owner: Any, field: str, value: Any) -> None:
        setattr(owner, field, value)

    def copy(self, target: Any, lower: Any, upper: Any, source: Any, first: Any, last: Any) -> None:
        for i in range(upper - (lower or 0)):
            target[(lower or 0) + i] = source[(first or 0) + i]

    def fill(self, target: Any, lower: Any, upper: Any, value: Any) -> None:
        for i in range(lower or 0, upper):
            target[i] = value

    # --- calls

    def local(self, function: Callable[..., Any]) -> Callable[..., Any]:
        return function

    def call(self, function: Any, /, *args: Any, **options: Any) -> Any:
        if isinstance(function, MethodType) and isinstance(function.__func__, Inline):
            function, args = function.__func__, (function.__self__, *args)
        if isinstance(function, Inline):
            return function.rewritten(self, **function.bound(args, options))
        if isinstance(function, Plain):
            return self.run(function, *args, **options)
        stated = record_of(function)
        if stated is not None:
            return stated.structure()
        if function in OPERATION_OF:
            return OPERATIONS[OPERATION_OF[function]](*args)
        return function(*args, **options)


class Ways:
    """A branch or loop: the values of the loop, or the condition of the branch."""

    def __init__(self, values: Any) -> None:
        self.source = values
        self.values: Sequence[Any] = ()

    def __iter__(self) -> Iterator[Any]:
        return iter(self.source)

    def times(self, test: Callable[[], Any]) -> Iterator[None]:
        while test():
            yield None

    def open(self, names: Sequence[str], anew: Sequence[str], *values: Any) -> Sequence[Any]:
        self.values = values
        return values

    def close(self, *values: Any) -> Sequence[Any]:
        self.values = values
        return values

    def ended(self) -> None:
        active = sys.exc_info()[1]
        assert active is not None
        raise active

    def after(self) -> Sequence[Any]:
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
        self.first = values
        return super().open(names, anew, *values)

    def close(self, *values: Any) -> Sequence[Any]:
        return self.first

    def fold(self, slot: int, function: Any, *values: float) -> None:
        op = function if isinstance(function, str) else REDUCTIONS[function]
        self.folds.setdefault(slot, (op, {}))[1][self.index] = values

    def folded(self, slot: int, first: float) -> float:
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
