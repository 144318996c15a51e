"""Types for values known at build time or at run time: kinds, descriptions for messages, and names without a value."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from lagrange.errors import LagrangeError
from lagrange.procedure.builder import GivenFunction
from lagrange.procedure.form import FLAG, REAL, WHOLE, Kind
from lagrange.procedure.values import Memory, Real, RecordFields, Value, Variable, Whole

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
    """A condition marked by `likely` or `unlikely`."""

    condition: Any
    likely: bool


class Error(LagrangeError):
    """An error without its location; the front end adds file and line."""


def leaves(value: Any) -> Iterator[Any]:
    """Yield the numbers and arrays in a bundle (a dataclass or tuple, also nested), in the order of its fields."""
    if value is None:
        return
    if isinstance(value, (tuple, list)):
        for one in value:
            yield from leaves(one)
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
    """Return the kind of a number, whether known at build time or at run time, or None for another object."""
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


def real(value: Value) -> Real:
    """Return a value as a real. Raises Error for another kind."""
    assert isinstance(value, Real)
    return value


_NAMES = {REAL: "a real", WHOLE: "a whole number", FLAG: "a flag"}


def named_kind(kind: Kind) -> str:
    """Return the name of a kind for an error message."""
    return _NAMES[kind]


def described(value: Any) -> str:
    """Return a description of a value for an error message."""
    kind = kind_of(value)
    if kind is not None:
        return named_kind(kind)
    if isinstance(value, Memory):
        return "an array"
    return "nothing" if value is None else f"an object of type {type(value).__name__}"
