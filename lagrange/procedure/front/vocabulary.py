"""Functions and types for plain procedures in addition to Python's: `each` loops, arithmetic rounded once, arrays.

All of them also work on plain numbers, so that a procedure runs in Python. `docs/dev/procedures.md` defines their
meaning in a compiled procedure.
"""

from __future__ import annotations

import ctypes
import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Protocol, TypeVar, overload

import numpy as np

from lagrange.errors import LagrangeError
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Kind, Procedure, Record
from lagrange.procedure.interpreter import OPERATIONS as EXACT
from lagrange.procedure.interpreter import run
from lagrange.statement.vocabulary.functions import ELEMENTARY

Number_co = TypeVar("Number_co", float, int, covariant=True)
Written = TypeVar("Written", float, int)


class Readable(Protocol[Number_co]):
    """An array that is read: `a[i]` is an element, `a[i:]` the part of the array from index i on."""

    @overload
    def __getitem__(self, index: int) -> Number_co: ...
    @overload
    def __getitem__(self, index: slice) -> Readable[Number_co]: ...


class Writable(Protocol[Written]):
    """An array that is read and written. `a[:n] = b[:n]` copies, `a[:n] = 0.0` fills."""

    @overload
    def __getitem__(self, index: int) -> Written: ...
    @overload
    def __getitem__(self, index: slice) -> Writable[Written]: ...
    @overload
    def __setitem__(self, index: int, value: Written) -> None: ...
    @overload
    def __setitem__(self, index: slice, value: Written | Readable[Written]) -> None: ...


In = Annotated[Readable[float], Array(REAL, read=True)]
"""Type of a parameter that is an array of reals, which is only read."""

Out = Annotated[Writable[float], Array(REAL)]
"""Type of a parameter that is an array of reals, which may be written."""

WholesIn = Annotated[Readable[int], Array(WHOLE, read=True)]
"""Type of a parameter that is an array of whole numbers, which is only read."""

WholesOut = Annotated[Writable[int], Array(WHOLE)]
"""Type of a parameter that is an array of whole numbers, which may be written."""


def each(count: int, **options: Any) -> range:
    """Return the indices below `count`, for a loop whose iterations may run in any order or several at once.

    Of the `options`, `width` is the largest number of iterations at once. With `spill` they may overwrite array
    entries from `count` on. With `unrolled` the iterations are written out. With `disjoint` the function promises
    that parts of an array do not overlap if one of them is written. Python runs one iteration after the other.
    """
    unknown = sorted(set(options) - {"width", "spill", "unrolled", "disjoint"})
    if unknown:
        raise LagrangeError(f"`each` has no option {', '.join(unknown)}.")
    return range(count)


def unrolled(*bounds: int) -> range:
    """Return `range(*bounds)`, for a loop that is written out when the procedure is built."""
    return range(*bounds)


def likely(condition: bool) -> bool:
    """Mark a condition that nearly always holds, and return it. Compilers optimise the code for this case."""
    return condition


def unlikely(condition: bool) -> bool:
    """Mark a condition that hardly ever holds, and return it."""
    return condition


def fma(a: float, b: float, c: float) -> float:
    """Return a*b + c, rounded once."""
    return float(EXACT["fma"](a, b, c))


def larger(a: float, b: float) -> float:
    """Return the larger of two numbers, NaN if either is NaN. Python's `max` returns its first argument for NaN."""
    return float(EXACT["max"](a, b))


def smaller(a: float, b: float) -> float:
    """Return the smaller of two numbers, NaN if either is NaN."""
    return float(EXACT["min"](a, b))


def magnitude(a: float, b: float) -> float:
    """Return the larger of |a| and |b|, NaN if either is NaN. On processors it is faster than `larger`."""
    return float(EXACT["magnitude"](a, b))


def quotient(a: int, b: int) -> int:
    """Return a/b for whole numbers, rounded towards zero; `//` rounds down."""
    return int(EXACT["quotient"](a, b))


def nearest(x: float) -> float:
    """Return the nearest whole number as a real, ties to even."""
    return float(EXACT["round"](x))


def sign(x: float) -> float:
    """Return 1, -1, or x itself if it is zero or NaN."""
    return float(EXACT["sign"](x))


def two_to(k: int) -> float:
    """Return 2**k for -1022 <= k <= 1023."""
    return math.ldexp(1.0, k)


def exponent(x: float) -> int:
    """Return the whole number k for which |x| = m * 2**k and 1 <= m < 2.

    The result is 1024 for infinity and NaN, and -1023 for zero and subnormal numbers.
    """
    return int(EXACT["exponent"](x))


def mantissa(x: float) -> float:
    """Return m for which |x| = m * 2**k, with a whole k and 1 <= m < 2."""
    return float(EXACT["mantissa"](x))


def reals(size: int, *, room: int = 1) -> Writable[float]:
    """Return a local array of `size` reals with undefined values, NaN in Python.

    Another `room` - 1 values follow, because machine code may access `room` values at once.
    """
    made: Any = np.full(size + room - 1, math.nan)
    array: Writable[float] = made
    return array


def wholes(size: int) -> Writable[int]:
    """Return a local array of `size` whole numbers with undefined values, 0 in Python."""
    made: Any = np.zeros(size, dtype=np.int64)
    array: Writable[int] = made
    return array


def clear(record: Any) -> None:
    """Set every field of a record to zero."""
    in_memory = isinstance(record, ctypes.Structure)
    for name in [name for name, *_ in record._fields_] if in_memory else record.names():
        setattr(record, name, 0)


def operation(name: str, *values: Any) -> Any:
    """Return the result of the operation `name` of procedures, such as "sqrt" or "max", on numbers."""
    return EXACT[name](*values)


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


def generated(form: Procedure, *args: Any) -> Any:
    """Call the procedure `form`, which code has built instead of a plain function, and return its results.

    The results are None, a value or a tuple of values.
    """
    results = run(form, *leaves(args))
    return results[0] if len(results) == 1 else results or None


OPERATION_OF: Mapping[Callable[..., Any], str] = {
    fma: "fma",
    larger: "max",
    smaller: "min",
    magnitude: "magnitude",
    quotient: "quotient",
    nearest: "round",
    sign: "sign",
    two_to: "two_to",
    exponent: "exponent",
    mantissa: "mantissa",
    abs: "abs",
    math.pow: "power",
    **{getattr(math, name): name for name in (*ELEMENTARY, "sqrt", "atan2", "copysign")},
}
"""For each function on numbers, the name of its operation in the form."""

REDUCTIONS: Mapping[Callable[..., Any], str] = {
    max: "most",
    min: "least",
    larger: "max",
    magnitude: "magnitude",
    fma: "dot",
}
"""Functions f for which an `each` takes `x = f(x, value)`, or `x = fma(a, b, x)`, as a reduction. The values are the
names of the reductions, as in `form.Fold`.
"""

KINDS: Mapping[Any, Kind] = {float: REAL, int: WHOLE, bool: FLAG}
"""The kind of value for each annotation."""

Class = TypeVar("Class", bound=type)


def record_of(stated: Any) -> Record | None:
    """Return the `form.Record` (names and kinds of the fields) of a class declared by `@record`, else None."""
    record = getattr(stated, "record", None)
    return record if isinstance(stated, type) and isinstance(record, Record) else None


def form_of(stated: type) -> Record:
    """Return the `form.Record`, the names and kinds of the fields, of a class declared by `@record`."""
    record = record_of(stated)
    assert record is not None
    return record


def record(stated: Class) -> Class:
    """Declare a class as a record: its annotated fields are numbers, zero at first, in the order of the class.

    A procedure takes a record as a parameter, and reads and writes its fields. In Python the argument is an instance of
    the class. In machine code it is memory with the layout of `stated.record`, a `form.Record`.
    """
    fields: dict[str, Kind] = {}
    for name, annotation in stated.__annotations__.items():
        kind = {"float": REAL, "int": WHOLE}.get(annotation) if isinstance(annotation, str) else KINDS.get(annotation)
        if kind not in (REAL, WHOLE):
            raise LagrangeError(f"the field {name} of the record {stated.__name__} is {annotation}: use float or int.")
        fields[name] = kind
    made: Any = stated
    made.record = Record(stated.__name__, tuple(fields.items()))

    def start(self: Any) -> None:
        for field, kind in fields.items():
            setattr(self, field, 0.0 if kind is REAL else 0)

    made.__init__, made.names = start, lambda self: tuple(fields)
    return stated
