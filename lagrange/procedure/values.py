"""Values, arrays and records of a procedure that is being built, with Python operators."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Kind, Record, Vector

if TYPE_CHECKING:
    from lagrange.procedure.builder import Builder


class Value:
    """One value of a procedure. Every operation on it adds a statement to the block that is being built."""

    kind: ClassVar[Kind]

    def __init__(self, builder: Builder, ref: int) -> None:
        self.builder, self.ref = builder, ref

    def __bool__(self) -> bool:
        raise LagrangeError(
            "a value of a procedure is known only when the procedure runs: use `with p.when(...)` instead of `if`."
        )


def _operator(op: str) -> Callable[[Any, Any], Any]:
    """Return a method for a Python operator, such as `__add__`: the operation `op` on the value and its argument."""
    return lambda self, other: self.builder.operation(op, self, other)


def _reflected(op: str) -> Callable[[Any, Any], Any]:
    """Return a method for a Python operator, such as `__radd__`: its argument is the first operand of `op`."""
    return lambda self, other: self.builder.operation(op, other, self)


def _unary(op: str) -> Callable[[Any], Any]:
    """Return a method for a Python operator with one operand, such as `__neg__`: the operation `op` on the value."""
    return lambda self: self.builder.operation(op, self)


class _Ordered(Value):
    """Python operators of reals and wholes: sums, products and comparisons."""

    __add__, __radd__ = _operator("add"), _reflected("add")
    __sub__, __rsub__ = _operator("sub"), _reflected("sub")
    __mul__, __rmul__ = _operator("mul"), _reflected("mul")
    __neg__ = _unary("neg")
    __lt__, __gt__ = _operator("less"), _reflected("less")
    __le__, __ge__ = _operator("less_equal"), _reflected("less_equal")

    def equals(self, other: Any) -> Flag:
        """Return the flag that is true if two numbers are equal. The flag is false if one of the numbers is NaN."""
        return Flag.of(self.builder.operation("equal", self, other))


class Real(_Ordered):
    """A real value of a procedure under construction: a double."""

    kind = REAL
    __truediv__, __rtruediv__ = _operator("div"), _reflected("div")
    __abs__ = _unary("abs")
    __pow__ = _operator("power")


class Whole(_Ordered):
    """A whole value of a procedure under construction: a 64-bit integer."""

    kind = WHOLE
    __floordiv__ = _operator("quotient")


class Flag(Value):
    """A flag of a procedure under construction: true or false."""

    kind = FLAG
    __and__, __or__ = _operator("and"), _operator("or")
    __invert__ = _unary("not")

    @staticmethod
    def of(value: Any) -> Flag:
        """Return `value`, which must be a flag, with its exact type."""
        assert isinstance(value, Flag)
        return value


VALUES: dict[Kind, Callable[[Builder, int], Any]] = {REAL: Real, WHOLE: Whole, FLAG: Flag}


class Entries:
    """A short vector of a procedure under construction. Operators work entry by entry.

    If the other operand is a number or flag, it is used for every entry.
    """

    __add__, __sub__, __mul__ = _operator("add"), _operator("sub"), _operator("mul")
    __truediv__, __rtruediv__ = _operator("div"), _reflected("div")
    __neg__, __invert__ = _unary("neg"), _unary("not")
    __lt__, __le__ = _operator("less"), _operator("less_equal")
    __and__, __or__ = _operator("and"), _operator("or")

    def __init__(self, builder: Builder, ref: int, vector: Vector) -> None:
        self.builder, self.ref, self.vector = builder, ref, vector
        self.kind, self.width = vector

    def equals(self, other: Any) -> Entries:
        """Return the vector of flags that are true where both entries are equal. A flag is false if an entry is NaN."""
        made: Entries = self.builder.operation("equal", self, other)
        return made

    def permuted(self, *indices: int) -> Any:
        """Return the vector of the entries at the indices. For one index, return the single entry."""
        return self.builder.permuted([self], indices)


class Variable:
    """A variable of a procedure, a number or a vector. Its attribute `value` reads and sets it."""

    def __init__(self, builder: Builder, ref: int, kind: Kind | Vector) -> None:
        self.builder, self.ref = builder, ref
        self.kind: Any = kind

    @property
    def value(self) -> Any:
        """The current value of the variable. Setting it adds an assignment."""
        return self.builder.made(self.kind, lambda ref: form.Get(ref, self.kind, self.ref))

    @value.setter
    def value(self, value: Any) -> None:
        self.builder.add(form.Set(self.ref, self.builder.operand(value, self.kind)))


class Memory:
    """An array, read and written by index. `a[start:]` and `a.at(start)` are its part from an index on.

    `root` is the id of the whole array of which this array is a part; for a whole array it is the id of the array
    itself.
    """

    def __init__(self, builder: Builder, ref: int, array: Array, root: int | None = None) -> None:
        self.builder, self.ref, self.array = builder, ref, array
        self.root = ref if root is None else root

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return self.at(index.start) if index.start is not None else self
        index_ref, kind = self.builder.operand(index, WHOLE), self.array.kind
        return self.builder.made(kind, lambda ref: form.Load(ref, kind, self.ref, index_ref))

    def __setitem__(self, index: Any, value: Any) -> None:
        index_ref = self.builder.operand(index, WHOLE)
        self.builder.add(form.Store(self.ref, index_ref, self.builder.operand(value, self.array.kind)))

    def entries(self, index: Any, width: int) -> Entries:
        """Return `width` adjacent entries from an index on, as a vector."""
        vector, start = Vector(self.array.kind, width), self.builder.operand(index, WHOLE)
        made: Entries = self.builder.made(vector, lambda ref: form.VectorLoad(ref, vector, self.ref, start))
        return made

    def put(self, index: Any, value: Entries) -> None:
        """Write the entries of a vector to adjacent elements of the array, from index `index` on."""
        self.builder.add(form.VectorStore(self.ref, self.builder.operand(index, WHOLE), value.ref))

    def at(self, start: Any) -> Memory:
        """Return the part of the array from index `start` on."""
        return self.builder.part(self, start)


class RecordFields:
    """A record of a procedure under construction. Its fields are read and set as attributes."""

    def __init__(self, builder: Builder, ref: int, record: Record) -> None:
        object.__setattr__(self, "_builder", builder)
        object.__setattr__(self, "_record", record)
        object.__setattr__(self, "ref", ref)

    def __getattr__(self, name: str) -> Any:
        kind = self.kind_of(name)
        return self._builder.made(kind, lambda ref: form.Read(ref, kind, self.ref, name))

    def __setattr__(self, name: str, value: Any) -> None:
        kind = self.kind_of(name)
        self._builder.add(form.Write(self.ref, name, self._builder.operand(value, kind)))

    def names(self) -> tuple[str, ...]:
        """Return the names of the fields."""
        record: Record = self.__dict__["_record"]
        return tuple(record.places)

    def kind_of(self, name: str) -> Kind:
        """Return the kind of a field. Raises LagrangeError if the record has no such field."""
        record: Record = self.__dict__["_record"]
        if name not in record.places:
            raise LagrangeError(f"the record {record.name} has no field {name}: it has {', '.join(record.places)}.")
        return record.kind(name)
