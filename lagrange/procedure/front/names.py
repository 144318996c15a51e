"""Names while a procedure is built. A name that a branch or loop sets again is a variable, which is read after it."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from lagrange.errors import LagrangeError
from lagrange.procedure.builder import Builder, GivenFunction
from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind, Statement
from lagrange.procedure.values import Flag, Memory, RecordFields, Value, Variable, Whole

ZERO: Mapping[Kind, Any] = {REAL: 0.0, WHOLE: 0, FLAG: False}


class Ended(Exception):
    """Exception for a block that has returned from the procedure: the builder skips the statements after it."""


@dataclasses.dataclass(frozen=True)
class Missing:
    """Placeholder for a name before it has a value, or after the branch or loop in which it was first set."""

    name: str
    where: str = ""


@dataclasses.dataclass(frozen=True)
class Weighed:
    """A condition that was passed to the function likely or unlikely; `likely` is true for the former."""

    condition: Any
    likely: bool


class Error(LagrangeError):
    """An error without its location; the front end adds file and line."""


def leaves(value: Any) -> Iterator[Any]:
    """Yield the numbers and arrays inside a dataclass or tuple, in the order of its fields, also nested ones.

    A number or array yields itself; None yields nothing.
    """
    if value is None:
        return
    if isinstance(value, (tuple, list)):
        for entry in value:
            yield from leaves(entry)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from leaves(getattr(value, field.name))
    else:
        yield value


def is_dynamic(value: Any) -> bool:
    """Return True if a value, or a part of it, is known at run time only."""
    if isinstance(value, (tuple, list)):
        return any(map(is_dynamic, value))
    return isinstance(value, (Value, Memory, RecordFields, GivenFunction))


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
    """The part of the tracer, which builds a procedure, that manages Python names and their values."""

    missing = Missing

    def __init__(self, p: Builder, results: Sequence[Kind]) -> None:
        self.p, self.results, self.note = p, results, p.note
        self.iterations: Any = None
        self.handed: list[Variable] = []
        """Variables of the open branches and loops. After one has ended, setting a name creates a new value."""

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
        if isinstance(before, Variable) and before in self.handed:
            before.value = self.number(value, before.kind, f"`{name}`")
            return before
        if is_varied(before) and before[0] in self.handed:
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
        if isinstance(value, Weighed):
            value = value.condition
        actual = kind_of(value)
        if actual is None:
            raise Error(f"{what} is a number; {described(value)} is given.")
        if isinstance(value, Value):
            if actual is not kind:
                instead = {(REAL, WHOLE): ": write float(n)", (WHOLE, REAL): ": write int(x)"}.get((kind, actual), "")
                raise Error(f"{what} is {NAMES[kind]}, and {NAMES[actual]} is given{instead}.")
            return value
        if actual is not kind and (kind, actual) != (REAL, WHOLE):
            raise Error(f"{what} is {NAMES[kind]}, and {value!r} is given.")
        made: Value = self.p.constant(int(value) if isinstance(value, enum.IntEnum) else value, kind)
        return made

    def unpacked(self, value: Any, count: int) -> Sequence[Any]:
        """Return a tuple or list of `count` values unchanged. Raises Error for any other object."""
        if not isinstance(value, (tuple, list)) or len(value) != count:
            raise Error(f"{count} values are expected; {described(value)} is given.")
        return value

    def varied(self, name: str, value: Any) -> Any:
        """Return a new variable that has the number `value` at first. Its Python name is set in a branch or loop.

        A tuple of numbers gives a tuple of variables. Other objects are returned unchanged.
        """
        if is_varied(value):
            return value
        if isinstance(value, tuple) and value and all(kind_of(entry) is not None for entry in value):
            return tuple(self.varied(f"{name}{i}", entry) for i, entry in enumerate(value))
        return value if isinstance(value, Variable) or kind_of(value) is None else self.p.variable(value, name)

    def is_flag(self, value: Any) -> Flag:
        """Return a condition as a flag. Raises Error for a value that is not a flag."""
        if not isinstance(value, Flag):
            raise Error(f"a condition is true or false; {described(value)} is given: compare it.")
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
            raise Error(f"`{function.__name__}` takes numbers of one kind.")
        best, *rest = [self.number(arg, kind, f"an argument of `{function.__name__}`") for arg in args]
        for candidate in rest:
            pair = (best, candidate) if function is max else (candidate, best)
            best = self.p.choose(self.p.operation("less", *pair), candidate, best)
        return best
