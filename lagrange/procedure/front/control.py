"""Names, branches and loops while a procedure is built: the values of names inside a block and after it.

A name that a branch or loop sets again becomes a variable, which is read after the branch or loop.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from lagrange.errors import LagrangeError
from lagrange.procedure.builder import Builder, FunctionParameter
from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind, Set, Statement, When
from lagrange.procedure.front.vocabulary import REDUCTIONS
from lagrange.procedure.values import Flag, Memory, Real, RecordFields, Value, Variable, Whole

ZERO: Mapping[Kind, Any] = {REAL: 0.0, WHOLE: 0, FLAG: False}


class Ended(Exception):
    """Exception for a block that has returned from the procedure: the builder skips the statements after it."""


@dataclasses.dataclass(frozen=True)
class Missing:
    """Placeholder for a name before it has a value, or after the branch or loop in which it was first set."""

    name: str
    where: str = ""


@dataclasses.dataclass(frozen=True)
class LikelyCondition:
    """A condition that the function marked as `likely` (true) or unlikely (false)."""

    condition: Any
    likely: bool


class Error(LagrangeError):
    """An error without its location; the front end adds file and line."""


def is_dynamic(value: Any) -> bool:
    """Return True if a value, or a part of it, is known at run time only."""
    if isinstance(value, (tuple, list)):
        return any(map(is_dynamic, value))
    return isinstance(value, (Value, Memory, RecordFields, FunctionParameter))


def kind_of(value: Any) -> Kind | None:
    """Return the kind of a number, or None for another object. The number may be known at run time only."""
    if isinstance(value, (Value, Variable)):
        return value.kind
    for python, kind in ((bool, FLAG), (int, WHOLE), (float, REAL)):
        if isinstance(value, python):
            return kind
    return None


def common_kind(values: Sequence[Any]) -> Kind | None:
    """Return the kind that numbers have in common, or None.

    Python integers count as reals if a real is among the numbers.
    """
    kinds = {kind_of(value) for value in values}
    if kinds == {REAL, WHOLE} and not any(isinstance(value, Whole) for value in values):
        return REAL
    return kinds.pop() if len(kinds) == 1 else None


NAMES = {REAL: "a real", WHOLE: "a whole number", FLAG: "a flag"}
"""Names of kinds in messages."""


def described(value: Any) -> str:
    """Return a description of a value for an error message."""
    kind = kind_of(value)
    if kind is not None:
        return NAMES[kind]
    if isinstance(value, Memory):
        return "an array"
    return "nothing" if value is None else f"an object of type {type(value).__name__}"


def is_varied(value: Any) -> bool:
    """Return True if a value is a tuple of variables."""
    return isinstance(value, tuple) and bool(value) and all(isinstance(entry, Variable) for entry in value)


class Names:
    """Base class of the tracer: manages the Python names of a procedure and their values."""

    missing = Missing

    def __init__(self, p: Builder, results: Sequence[Kind]) -> None:
        self.p, self.results, self.note = p, results, p.note
        self.iterations: Any = None
        self.open_variables: list[Variable] = []
        """Variables of the open branches and loops. After a block has ended, setting a name creates a new value."""

        self.parameters = {parameter.ref for parameter in p.parameters}

    # --- names

    def read(self, value: Any) -> Any:
        """Return the value of a name; if it is a variable, its present value. Raises Error if the name has no value."""
        if isinstance(value, Variable):
            return value.value
        if is_varied(value):
            return tuple(variable.value for variable in value)
        if isinstance(value, Missing):
            raise Error(f"`{value.name}` is read {value.where or 'before it is set'}: set it before.")
        return value

    def assign(self, before: Any, name: str, value: Any) -> Any:
        """Assign `value` to a Python name. Return the object to which the name refers from then on.

        `before` is the object to which it referred. If that is a variable of an enclosing branch or loop, the
        variable is set and returned. Otherwise the result is `value`.
        """
        if isinstance(before, Variable) and before in self.open_variables:
            before.value = self.number(value, before.kind, f"`{name}`")
            return before
        if is_varied(before) and before[0] in self.open_variables:
            for variable, entry in zip(before, self.unpacked(value, len(before)), strict=True):
                variable.value = self.number(entry, variable.kind, f"`{name}`")
            return before
        return self.named(name, value)

    def named(self, name: str, value: Any) -> Any:
        """Return a value unchanged, and record its name for printed code."""
        if name != "_" and isinstance(value, (Value, Memory)) and value.ref not in self.parameters:
            self.p.names.setdefault(value.ref, name)
        return value

    def number(self, value: Any, kind: Kind, what: str) -> Value:
        """Return a number as a value of a kind; a Python integer may become a real. Raises Error for another object.

        `what` names the number in the message.
        """
        if isinstance(value, LikelyCondition):
            value = value.condition
        actual = kind_of(value)
        if actual is None:
            raise Error(f"{what} must be a number, not {described(value)}.")
        if isinstance(value, Value):
            if actual is not kind:
                instead = {(REAL, WHOLE): ": write float(n)", (WHOLE, REAL): ": write int(x)"}.get((kind, actual), "")
                raise Error(f"{what} must be {NAMES[kind]}, not {NAMES[actual]}{instead}.")
            return value
        if actual is not kind and (kind, actual) != (REAL, WHOLE):
            raise Error(f"{what} must be {NAMES[kind]}, not {value!r}.")
        made: Value = self.p.constant(int(value) if isinstance(value, enum.IntEnum) else value, kind)
        return made

    def unpacked(self, value: Any, count: int) -> Sequence[Any]:
        """Return a tuple or list of `count` values unchanged. Raises Error for any other object."""
        if not isinstance(value, (tuple, list)) or len(value) != count:
            raise Error(f"{described(value)} is unpacked to {count} names: give a tuple of {count} values.")
        return value

    def varied(self, name: str, value: Any) -> Any:
        """Return a new variable with the first value `value`, for the Python name `name` that a branch or loop sets.

        A tuple of numbers gives a tuple of variables. Other objects are returned unchanged.
        """
        if is_varied(value):
            return value
        if isinstance(value, tuple) and value and all(kind_of(entry) is not None for entry in value):
            return tuple(self.varied(f"{name}{i}", entry) for i, entry in enumerate(value))
        return value if isinstance(value, Variable) or kind_of(value) is None else self.p.variable(value, name)

    def as_flag(self, value: Any) -> Flag:
        """Return a condition as a flag. Raises Error for a value that is not a flag."""
        if not isinstance(value, Flag):
            raise Error(f"a condition must be true or false, not {described(value)}: compare it.")
        return value

    @contextmanager
    def resumed(self, body: list[Statement]) -> Iterator[None]:
        """Context in which statements are appended to `body`, a block that was built before."""
        with self.p.block() as more:
            yield
        body.extend(more)

    def extreme(self, function: Any, args: Sequence[Any]) -> Any:
        """Return the result of Python's `max` or `min`: the first argument unless a later one is larger (smaller)."""
        kind = common_kind(args)
        if kind not in (REAL, WHOLE):
            raise Error(f"`{function.__name__}` takes only reals or only whole numbers: write float(n) for whole ones.")
        best, *rest = [self.number(arg, kind, f"an argument of `{function.__name__}`") for arg in args]
        for candidate in rest:
            pair = (best, candidate) if function is max else (candidate, best)
            best = self.p.choose(self.p.operation("less", *pair), candidate, best)
        return best


class KnownBlock:
    """A branch or loop that is known at build time: the branch to run is built, or the loop is unrolled."""

    def __init__(self, iterations: Iterable[Any]) -> None:
        self.iterations = iterations
        self.values: Sequence[Any] = ()

    def __iter__(self) -> Iterator[Any]:
        return iter(self.iterations)

    def open(self, names: Sequence[str], anew: Sequence[str], *values: Any) -> Sequence[Any]:
        """Return `values`, the values of the Python names `names` at the start of the block. `anew` is not used."""
        return self.close(*values)

    def close(self, *values: Any) -> Sequence[Any]:
        """Store the values of Python names at the end of a branch or iteration; return them for the next iteration."""
        self.values = values
        return values

    def ended(self) -> None:
        """Raise Ended: the block returns from the procedure, so the statements after it are skipped."""
        raise Ended

    def after(self) -> Sequence[Any]:
        """Return the values after the block of the names passed to `open`; `Missing` for a name without a value."""
        return self.values


class Block:
    """A branch or a loop: a part of a procedure that may not run, or may run several times.

    A name that the block sets becomes a variable of the procedure, or has no value after the block.
    """

    where = ""

    def __init__(self, tracer: Names) -> None:
        self.tracer = tracer
        self.names: Sequence[str] = ()
        self.before: Sequence[Any] = ()
        self.outer: list[Variable] = tracer.open_variables
        self.lost: set[int] = set()
        self.has_ended = False

    def open(self, names: Sequence[str], anew: Sequence[str], *values: Any) -> Sequence[Any]:
        """Return the values of the Python names `names` at the start of the block, with variables for numbers.

        `values` are the values before the block. A number among them becomes a variable of the procedure. `anew` are
        the names that the block sets before it reads them. Such a name has no value at the start, unless it is a
        variable of an enclosing block.
        """
        self.names = names
        self.outer = self.tracer.open_variables
        pairs = zip(names, values, strict=True)
        # A name that is set first, and is not a variable of an enclosing block, needs no value.
        known = [
            Missing(name) if name in anew and (value[0] if is_varied(value) else value) not in self.outer else value
            for name, value in pairs
        ]
        self.before = [self.tracer.varied(name, value) for name, value in zip(names, known, strict=True)]
        inner = [part for value in self.before for part in (value if isinstance(value, tuple) else (value,))]
        self.tracer.open_variables = [*self.outer, *(part for part in inner if isinstance(part, Variable))]
        return self.before

    def ended(self) -> None:
        """Record that the block ends by a return from the procedure."""
        self.has_ended = True

    def close(self, *values: Any) -> Sequence[Any]:
        """Record the values of the block's Python names at its end. Return the values of the names at its start."""
        for i, (old, new) in enumerate(zip(self.before, values, strict=True)):
            if old is not new:
                self.lost.add(i)
        return self.before

    def after(self) -> Sequence[Any]:
        """Return the values after the block of the names passed to `open`; `Missing` for a name without a value."""
        self.tracer.open_variables = self.outer
        pairs = zip(self.names, self.before, strict=True)
        return [Missing(name, self.where) if i in self.lost else old for i, (name, old) in enumerate(pairs)]


class LoopBlock(Block):
    """A loop of the procedure whose body is built once for each item of `iterations`.

    For a loop over a `range` there is one item, the index at run time. An inline generator gives the values that it
    yields, and its statements surround the body.
    """

    where = "after the loop that sets it"

    def __init__(self, tracer: Names, iterations: Iterator[Any]) -> None:
        super().__init__(tracer)
        self.iterations = iterations

    def __iter__(self) -> Iterator[Any]:
        return self.iterations

    def times(self, test: Callable[[], Any]) -> Iterator[None]:
        """Yield once: the body of a `while` loop is built then. `test` builds the condition of the loop."""

        def condition() -> Flag:
            made = test()
            if isinstance(made, Value):
                return self.tracer.as_flag(made)
            return Flag.of(self.tracer.number(bool(made), FLAG, "a condition"))

        with self.tracer.p.repeat(condition):
            yield None


class Branches(Block):
    """The two branches of a condition that is known at run time only."""

    where = "after the branch that sets it"

    def __init__(self, tracer: Names, condition: Value, likely: bool | None) -> None:
        super().__init__(tracer)
        self.condition, self.likely = condition, likely
        self.bodies: list[list[Statement]] = []
        self.ways: list[Sequence[Any] | None] = []
        """The values of the names at the end of each branch; None if the branch ended the procedure."""

    def __iter__(self) -> Iterator[bool]:
        for way in (True, False):
            self.has_ended = False
            with self.tracer.p.block() as body:
                yield way
            self.bodies.append(body)

    def close(self, *values: Any) -> Sequence[Any]:
        """Store the values of the Python names at the end of a branch. Return their values before both branches.

        The second branch begins with the values that are returned.
        """
        self.ways.append(None if self.has_ended else values)
        return super().close(*values) if not self.has_ended else self.before

    def after(self) -> Sequence[Any]:
        """Add the branch statement, and return the values of names after it.

        A name that is first set inside all branches becomes a variable, declared before the statement.
        """
        merged = list(super().after())
        ways = [(body, way) for body, way in zip(self.bodies, self.ways, strict=True) if way is not None]
        for i in sorted(self.lost):
            values = [way[i] for _, way in ways]
            if all(value is values[0] for value in values) and not isinstance(values[0], (Value, Variable)):
                merged[i] = values[0]
            elif (kind := common_kind(values)) is not None:
                merged[i] = self.joined(self.names[i], kind, [(body, way[i]) for body, way in ways])
        self.tracer.p.add(When(self.condition.ref, tuple(self.bodies[0]), tuple(self.bodies[1]), self.likely))
        if not ways:
            raise Ended
        return merged

    def joined(self, name: str, kind: Kind, ways: Sequence[tuple[list[Statement], Any]]) -> Variable:
        """Return a new variable for a Python name; a statement at the end of each branch sets it.

        `kind` is the kind of the variable. `ways` has a pair for each branch: its statements, and the value of the name
        at its end.
        """
        tracer = self.tracer
        variable = tracer.p.variable(ZERO[kind], name)
        for body, value in ways:
            with tracer.resumed(body):
                number = tracer.number(tracer.read(value), kind, f"`{name}`")
                tracer.p.add(Set(variable.ref, number.ref))
        return variable


class EachBlock(Block):
    """A loop whose iterations may run in any order."""

    where = "after the `each` that sets it"

    def __init__(self, tracer: Names, count: Value, options: Mapping[str, Any], *, disjoint: bool) -> None:
        super().__init__(tracer)
        self.count, self.options, self.disjoint = count, options, disjoint
        self.folds: dict[int, tuple[str, Real]] = {}
        self.index: Value | None = None
        self.visits: list[tuple[int, int, bool, bool]] = []
        """For each access: the whole array, the part, True if the index is the loop index, and True if it is written.
        """

    def open(self, names: Sequence[str], anew: Sequence[str], *values: Any) -> Sequence[Any]:
        """Return `values`, the values of the Python names `names` inside an iteration.

        Raises Error if a name has a value before the loop. `anew` is not used.
        """
        for name, value in zip(names, values, strict=True):
            if not isinstance(value, Missing):
                raise Error(
                    f"`{name}` is set by an `each` and read by the next iteration or after the loop: use `range`."
                )
        self.names, self.before = names, values
        return values

    def __iter__(self) -> Iterator[Any]:
        with self.tracer.p.each(self.count, **self.options) as index:
            self.tracer.iterations, self.index = self, index
            try:
                yield index
            finally:
                self.tracer.iterations = None
        self.check()

    def ended(self) -> None:
        """Raise Error, because a return inside an `each` is not allowed."""
        raise Error("`each` cannot contain `return`: use `range`.")

    def visit(self, array: Memory, index: Value, *, stored: bool) -> None:
        """Record an access to an array element at `index` inside an iteration. `stored` is true for a write.

        Raises Error for a write at an index other than the index of the iteration.
        """
        assert self.index is not None
        at_own_index = index.ref == self.index.ref
        if stored and not at_own_index:
            raise Error("an iteration of `each` can write only the element with its own index: use `range`.")
        self.visits.append((array.root, array.ref, at_own_index, stored))

    def check(self) -> None:
        """Raise Error if the result of this `each` may depend on the order of its iterations.

        The result depends on it if one iteration writes an element of an array that another iteration may read or
        write. Each iteration may use the element at its own index, in one part of the array. An `each` that is declared
        disjoint is not checked.
        """
        written = {root: part for root, part, _, stored in self.visits if stored}
        for root, part, at_own_index, _ in self.visits:
            if not self.disjoint and root in written and (part != written[root] or not at_own_index):
                raise Error(
                    "iterations of `each` use other slices of an array that they write: use `range`, or "
                    "each(n, disjoint=True) if the slices do not overlap."
                )

    def fold(self, slot: int, function: Any, *values: Any) -> None:
        """Add `values`, one value or two factors, to the reduction with index `slot`.

        `function` is the reduction, such as `max`, or its name, such as "add".
        """
        op = function if isinstance(function, str) else REDUCTIONS.get(function)
        if op is None or len(values) != (2 if op == "dot" else 1):
            name = getattr(function, "__name__", function)
            raise Error(f"`{name}` is not a reduction of an `each`: use {', '.join(r.__name__ for r in REDUCTIONS)}.")
        numbers: list[Any] = [self.tracer.number(operand, REAL, "a value of a reduction") for operand in values]
        value, *factors = numbers
        # The least value is minus the largest of the negative values.
        number = self.tracer.p.fold("most", -value) if op == "least" else self.tracer.p.fold(op, value, *factors)
        self.folds[slot] = op, number

    def folded(self, slot: int, first: Any) -> Any:
        """Return the result of reduction number `slot` of the loop. `first` is the value of its name before it."""
        tracer = self.tracer
        op, value = self.folds[slot]
        neutral = {"add": 0.0, "dot": 0.0, "magnitude": 0.0, "most": -math.inf, "max": -math.inf}.get(op)
        if not isinstance(first, Value) and first == neutral:
            return value
        if op in ("add", "dot"):
            return first + value
        if op == "least":
            return tracer.extreme(min, (first, -value))
        if op == "most":
            return tracer.extreme(max, (first, value))
        return tracer.p.operation(op, first, value)
