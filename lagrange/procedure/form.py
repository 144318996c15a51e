"""Statements and types of a procedure: typed values, memory and control flow, for any language.

A procedure is a block of statements. Every value, variable, array and record has an integer id, `ref`, and statements
name their operands by id. A value is assigned once; variables, arrays and fields of records can change. There are three
kinds of value, no pointers, no recursion and no exceptions: a procedure that fails returns a status. So it can be
printed as LLVM, C or Python, and `interpreter` runs it directly.

    reals      doubles; a printer may compute several in the lanes of a vector, and flags are then masks
    wholes     64-bit signed integers: counts and indices
    flags      true or false

A vector has 2, 4 or 8 entries of one kind. Operations on vectors work entry by entry. Printers of source text have no
vectors: for them procedures are built with single values.
"""

from __future__ import annotations

import ctypes
import enum
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, get_args

from lagrange.statement.vocabulary.functions import ELEMENTARY


class Kind(enum.StrEnum):
    """The type of a value: real (a double), whole (a 64-bit integer) or flag (true or false)."""

    REAL = "real"
    WHOLE = "whole"
    FLAG = "flag"


REAL, WHOLE, FLAG = Kind.REAL, Kind.WHOLE, Kind.FLAG

CONSTANT = "constant"
"""Name of the operation without operands, a constant. Its `data` is the value."""


@dataclass(frozen=True)
class Record:
    """Named numbers that persist across calls, eight bytes each: the state of one part of an algorithm.

    With `lanes` above 1, each field is a vector with that many entries.
    """

    name: str
    fields: tuple[tuple[str, Kind], ...]
    lanes: int = 1

    @cached_property
    def places(self) -> Mapping[str, int]:
        """The index of each field, by the name of the field."""
        return {name: i for i, (name, _) in enumerate(self.fields)}

    def kind(self, field: str) -> Kind:
        """Return the kind of a field, or of the entries of its vector."""
        return self.fields[self.places[field]][1]

    def type_of(self, field: str) -> Kind | Vector:
        """Return the type of a field: its kind, or a vector with one entry for each lane."""
        return of_width(self.kind(field), self.lanes)

    @cached_property
    def structure(self) -> type[ctypes.Structure]:
        """The ctypes class of the record. Fields of an instance are attributes; machine code gets its address."""
        types: dict[Kind, Any] = {REAL: ctypes.c_double, WHOLE: ctypes.c_int64}
        if self.lanes > 1:
            types = {kind: ctype * self.lanes for kind, ctype in types.items()}
        return type(self.name, (ctypes.Structure,), {"_fields_": [(n, types[kind]) for n, kind in self.fields]})


@dataclass(frozen=True)
class Array:
    """Memory for values of one kind. `size` is the number of values, or None if the caller decides.

    An array is read only if `read` is true, else also written. The arrays of one call do not overlap. Blocks of `room`
    values may be accessed as a whole; the last block may reach beyond `size`.
    """

    kind: Kind = REAL
    size: int | None = None
    read: bool = False
    room: int = 1

    @property
    def length(self) -> int:
        """Number of values to allocate for a local array in exported code: `size` and the spare room, at least 1."""
        return (self.size or 0) + max(self.room - 1, 0) or 1


READ = Array(read=True)
"""Type of an array of real numbers that is only read."""


@dataclass(frozen=True)
class Callee:
    """The type of a parameter that is a function: the types of its parameters and the kinds of its results.

    In Python such a function returns None, a value or a tuple of values. In machine code a flag is C's int, and
    several results are returned in registers.
    """

    parameters: tuple[Kind | Array, ...]
    results: tuple[Kind, ...]


class Vector(NamedTuple):
    """The type of a short vector: the kind of its entries and their number, one of `WIDTHS` above 1."""

    kind: Kind
    width: int


def of_width(kind: Kind, width: int) -> Kind | Vector:
    """Return the type of a vector of `width` values of a kind. For a width of 1 the result is the kind itself."""
    return Vector(kind, width) if width > 1 else kind


Type = Kind | Vector | Array | Record | Callee


class Parameter(NamedTuple):
    """A named parameter of a procedure; `ref` is its id."""

    ref: int
    name: str
    type: Type


class Let(NamedTuple):
    """The result of the operation `op` on earlier values, the ids `args`. `data` is the value of a constant."""

    ref: int
    kind: Kind
    op: str
    args: tuple[int, ...] = ()
    data: float | int | bool | None = None


class SineCosine(NamedTuple):
    """The sine and the cosine of one angle, or of each entry of a vector.

    Both together take little more time than one.
    """

    sine: int
    cosine: int
    angle: int


class VectorLet(NamedTuple):
    """A vector that an operation `op` computes: entry by entry on vectors of one width, or by `permute`.

    `permute` chooses entries of its operands, which are vectors and single values. All their entries are numbered
    consecutively from 0, and `places` are the numbers of the chosen entries.
    """

    ref: int
    vector: Vector
    op: str
    args: tuple[int, ...]
    places: tuple[int, ...] = ()


class Reduce(NamedTuple):
    """A single value from a vector: by `any`, true if any flag is true; by `entry`, the entry at index `place`."""

    ref: int
    kind: Kind
    op: str
    vector: int
    place: int = 0


class VectorLoad(NamedTuple):
    """Statement that reads adjacent entries of an array as a vector, from index `place` on."""

    ref: int
    vector: Vector
    array: int
    place: int


class Gather(NamedTuple):
    """Statement that reads entries of an array as a vector, at the indices in the vector `places`.

    Entries of the result are zero where the mask is false.
    """

    ref: int
    vector: Vector
    array: int
    places: int
    mask: int


class VectorStore(NamedTuple):
    """Statement that writes a vector to adjacent entries of an array, from index `place` on.

    With a mask, only entries where the mask is true are written. The array must have all these entries: the others
    may be read and written back unchanged.
    """

    array: int
    place: int
    value: int
    mask: int | None = None


class Scatter(NamedTuple):
    """Statement that writes the entries of a vector to an array, where the mask is true.

    `places` is the vector of indices in the array, one for each entry.
    """

    array: int
    places: int
    value: int
    mask: int


class Reserve(NamedTuple):
    """A local array with undefined values, which exists during one call of the procedure."""

    ref: int
    array: Array


class ReserveRecord(NamedTuple):
    """A local record, which exists during one call of the procedure. Its fields are zero at first."""

    ref: int
    record: Record


class Part(NamedTuple):
    """Statement that defines a part of an array as an array: all elements from index `start` on."""

    ref: int
    array: int
    start: int


class Load(NamedTuple):
    """Statement that reads an element of an array."""

    ref: int
    kind: Kind
    array: int
    place: int


class Store(NamedTuple):
    """Statement that writes an element of an array."""

    array: int
    place: int
    value: int


class Read(NamedTuple):
    """Statement that reads a field of a record: a number, or a vector if the record has lanes."""

    ref: int
    kind: Kind
    record: int
    field: str


class Write(NamedTuple):
    """Statement that writes a field of a record."""

    record: int
    field: str
    value: int


class Declare(NamedTuple):
    """Statement that declares a variable with its first value, a number or a vector."""

    ref: int
    kind: Kind | Vector
    value: int


class Get(NamedTuple):
    """Statement that reads a variable."""

    ref: int
    kind: Kind | Vector
    variable: int


class Set(NamedTuple):
    """Statement that sets a variable."""

    variable: int
    value: int


class When(NamedTuple):
    """Two branches under a condition. `likely` is the usual value of the condition, or None if neither is usual."""

    condition: int
    then: Block
    otherwise: Block = ()
    likely: bool | None = None


class Loop(NamedTuple):
    """A loop over an index from `start` on, in steps of `step`, while it is below `stop`."""

    place: int
    start: int
    stop: int
    step: int
    body: Block


class Repeat(NamedTuple):
    """Statements that are repeated while a condition holds. The condition is computed before each iteration."""

    test: Block
    condition: int
    body: Block


PARTIAL = 4
"""Number of partial sums of a `Fold`."""

SUMS, WIDTHS = ("add", "dot"), (1, 2, 4, 8)
"""`SUMS`: names of the reductions that are sums. `WIDTHS`: numbers of iterations of an `Each` that may be computed at
once.
"""


class Fold(NamedTuple):
    """A reduction over the iterations of an `Each`: `add`, `dot`, `max`, `most` or `magnitude`.

    `max` is NaN if any value is NaN; `most` ignores NaN. Without iterations both are -infinity. `magnitude` is the
    largest |value|, NaN if any value is NaN, and 0 without iterations. `dot` adds products of two values; each
    multiply-add is rounded once. A sum adds value i to partial sum i mod 4. At the end partial sums 0 and 1, and 2
    and 3, are added, then both results. So the sum is the same with and without blocks of four.
    """

    ref: int
    op: str
    value: int
    factor: int | None = None
    """The second factor of a product."""

    @property
    def first(self) -> float:
        """The result of the reduction for a loop without iterations."""
        return 0.0 if self.op in (*SUMS, "magnitude") else float("-inf")


class Each(NamedTuple):
    """A loop over the indices 0 to `iterations` - 1, whose iterations may run in any order or at the same time.

    Arrays are accessed at the index itself, or read at an index that no iteration writes. An iteration may have
    local variables, and loops with the same count in every iteration. An iteration has no calls and no branches. A
    printer may compute up to `width` iterations at a time, one of `WIDTHS`, and four if there is a sum. With
    `spill` these iterations may overwrite array entries from `iterations` on; otherwise such entries within the
    size of the array are unchanged. With `unrolled` no loop is printed: all iterations follow one another.
    """

    place: int
    iterations: int
    body: Block
    folds: tuple[Fold, ...] = ()
    width: int = PARTIAL
    spill: bool = False
    unrolled: bool = False


class Call(NamedTuple):
    """A call of another procedure, or of the function parameter with the id `callee`."""

    refs: tuple[int, ...]
    callee: Procedure | int
    args: tuple[int, ...]


class Leave(NamedTuple):
    """Statement that returns from the procedure with its results."""

    values: tuple[int, ...]


class Note(NamedTuple):
    """A comment, which printers print."""

    text: str


VectorStatement = VectorLet | Reduce | VectorLoad | Gather | VectorStore | Scatter
MemoryStatement = Reserve | ReserveRecord | Part | Load | Store | Read | Write
VariableStatement = Declare | Get | Set
ControlStatement = When | Loop | Repeat | Each
Statement = (
    Let | SineCosine | VectorStatement | MemoryStatement | VariableStatement | ControlStatement | Call | Leave | Note
)
Block = tuple[Statement, ...]


@dataclass(frozen=True, eq=False)
class Procedure:
    """A checked algorithm. `about` is a sentence that describes it. `names` maps ids to names in the algorithm.

    Printers do not inline a `noinline` procedure: it runs rarely, or has several callers.
    """

    name: str
    about: str
    parameters: tuple[Parameter, ...]
    results: tuple[Kind | Vector, ...]
    body: Block
    names: Mapping[int, str]
    noinline: bool = False

    @property
    def numbers(self) -> tuple[Kind, ...]:
        """The kinds of the results of a procedure. Results that are vectors are left out."""
        return tuple(kind for kind in self.results if isinstance(kind, Kind))

    @cached_property
    def callees(self) -> tuple[Procedure, ...]:
        """The procedures that this one calls, directly or through others, each once and before its callers."""
        procedures: dict[Procedure, None] = {}
        for call in calls(self.body):
            if isinstance(call.callee, Procedure):
                procedures |= dict.fromkeys((*call.callee.callees, call.callee))
        return tuple(procedures)


VECTOR_STATEMENTS = get_args(VectorStatement)
"""Statements on vectors, which printers of source text do not have."""

_BLOCKS: Mapping[type, tuple[str, ...]] = {
    When: ("then", "otherwise"),
    Repeat: ("test", "body"),
    Loop: ("body",),
    Each: ("body",),
}
"""Names of the fields that are blocks, for each statement with blocks inside, in the order in which the blocks run."""


def inner(statement: Statement) -> tuple[Block, ...]:
    """Return the blocks inside a statement, in the order in which they run."""
    return tuple(getattr(statement, name) for name in _BLOCKS.get(type(statement), ()))


def rebuilt(statement: Statement, change: Callable[[Block], Block]) -> Statement:
    """Return a statement in which `change(block)` replaces each inner block.

    `change` is called for the last block first, so that a pass from the end of a procedure meets blocks in its order.
    """
    names = _BLOCKS.get(type(statement), ())
    changes: dict[str, Any] = {name: change(getattr(statement, name)) for name in reversed(names)}
    return statement._replace(**changes)


def walk(block: Block) -> Iterator[Statement]:
    """Yield every statement of a block, including nested ones. A statement comes before the statements inside it."""
    for statement in block:
        yield statement
        if type(statement) in _BLOCKS:
            for body in inner(statement):
                yield from walk(body)


def calls(block: Block) -> list[Call]:
    """Return every call in a block, in order."""
    return [statement for statement in walk(block) if isinstance(statement, Call)]


def transitive_callees(procedures: Sequence[Procedure], elsewhere: Sequence[Procedure] = ()) -> list[Procedure]:
    """Return the procedures and their transitive callees, callees first. Callees in `elsewhere` are left out.

    Procedures that are called only by callees in `elsewhere` are left out too.
    """
    reached: dict[Procedure, None] = {}

    def reach(procedure: Procedure) -> None:
        if procedure in reached:
            return
        for call in calls(procedure.body):
            if isinstance(call.callee, Procedure) and call.callee not in elsewhere:
                reach(call.callee)
        reached[procedure] = None

    for procedure in procedures:
        reach(procedure)
    return list(reached)


Signature = tuple[tuple[Kind, ...], Kind]


def _functions(names: str, *signatures: Signature) -> dict[str, tuple[Signature, ...]]:
    return dict.fromkeys(names.split(), signatures)


_UNARY: Signature = ((REAL,), REAL)
_BINARY: Signature = ((REAL, REAL), REAL)
_WHOLES: Signature = ((WHOLE, WHOLE), WHOLE)
_COMPARED: tuple[Signature, Signature] = ((REAL, REAL), FLAG), ((WHOLE, WHOLE), FLAG)

ANGLES = ("sin", "cos")
"""Operations on an angle that are computed as a pair, in the order of the results."""

OPERATIONS: dict[str, tuple[Signature, ...]] = {
    **_functions("add sub mul min max", _BINARY, _WHOLES),
    **_functions("div power atan2 copysign magnitude", _BINARY),
    **_functions("neg", _UNARY, ((WHOLE,), WHOLE)),
    **_functions("quotient", _WHOLES),
    **_functions(" ".join(("abs sqrt sign round", *ELEMENTARY)), _UNARY),
    **_functions("fma fnma", ((REAL, REAL, REAL), REAL)),
    **_functions("less less_equal equal", *_COMPARED),
    **_functions("and or", ((FLAG, FLAG), FLAG)),
    **_functions("not", ((FLAG,), FLAG)),
    **_functions("select", *(((FLAG, kind, kind), kind) for kind in Kind)),
    **_functions("real", ((WHOLE,), REAL), ((FLAG,), REAL)),
    **_functions("whole", ((REAL,), WHOLE), ((FLAG,), WHOLE)),
    **_functions("two_to", ((WHOLE,), REAL)),
    **_functions("exponent", ((REAL,), WHOLE)),
    **_functions("mantissa", ((REAL,), REAL)),
}
"""Every operation with the kinds of its operands and results.

Comparisons with NaN are false. `min`, `max` and `magnitude` of NaN are NaN; `magnitude`, the larger of |a| and |b|,
takes processors less time than `max`. `fma` is a*b + c rounded once, `fnma` c - a*b. `round` gives the nearest integer,
ties to even. `quotient` rounds towards zero, and so does `whole` of a real in the range of wholes. A normal |x| is
mantissa * 2**exponent with 1 <= mantissa < 2. The exponent of infinity and NaN is 1024, and -1023 for zero and
subnormal numbers. `two_to` k is 2**k for a normal result.
"""


_RESULTS = {(op, taken): result for op, signatures in OPERATIONS.items() for taken, result in signatures}


def result_kind(op: str, kinds: tuple[Kind, ...]) -> Kind | None:
    """Return the kind of the result of the operation `op` on operands of these kinds, or None if they do not fit."""
    return _RESULTS.get((op, kinds))
