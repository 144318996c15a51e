"""Build a procedure in plain Python: operators make values, and `with` makes blocks.

p = Builder("norm", "The scaled size of an error.")
error, scale = p.array("error", size=n), p.array("scale", size=n)
with p.each(n) as i:
    ratio = error[i] / scale[i]
    total = p.fold("add", ratio * ratio)
p.leave(p.sqrt(total / float(n)))
norm = p.finish(REAL)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import FLAG, REAL, WHOLE, Array, Block, Callee, Kind, Procedure, Record, Statement, Vector
from lagrange.procedure.values import VALUES, Entries, Flag, Memory, Real, RecordFields, Value, Variable, Whole


class FunctionParameter:
    """A function parameter of a procedure. The procedure can call the function, or pass it on to other procedures."""

    def __init__(self, builder: Builder, ref: int, callee: Callee) -> None:
        self._builder, self.ref, self._callee = builder, ref, callee

    def __call__(self, *args: Any) -> Any:
        """Add a call of the function to the procedure. Return its results: None, a value, or a tuple of values."""
        return self._builder.call_function(self.ref, self._callee.results, self._callee.parameters, args)


class OpenBranches:
    """A branch statement under construction: its first block is complete, and its second can be added."""

    def __init__(self, builder: Builder, index: int) -> None:
        self._builder, self._index = builder, index

    @contextmanager
    def otherwise(self) -> Iterator[None]:
        """Add the second block of the branch: the body of the `with` runs if the condition does not hold."""
        with self._builder.block() as body:
            yield
        statement = self._builder.current[self._index]
        if not isinstance(statement, form.When) or self._index != len(self._builder.current) - 1:
            raise LagrangeError("write `otherwise` directly after the block of its condition.")
        self._builder.current[self._index] = form.When(
            statement.condition, statement.then, tuple(body), likely=statement.likely
        )


class Builder:
    """A procedure under construction. Its methods add statements, and accept Python numbers for values."""

    def __init__(self, name: str, about: str, *, noinline: bool = False) -> None:
        self.name, self.about, self._noinline = name, about, noinline
        self.parameters: list[form.Parameter] = []
        self.names: dict[int, str] = {}
        self.current: list[Statement] = []
        self._folds: list[form.Fold] | None = None
        self._constants: list[dict[tuple[Kind, str], Any]] = [{}]
        """The constants of each open block, by their kind and the text of their value."""
        self._count = 0

    # --- parameters

    def given(self, name: str, kind: Kind | Array) -> Any:
        """Add a parameter `name`, a number or an array as `kind` says, and return its value."""
        ref = self._parameter(name, kind)
        return Memory(self, ref, kind) if isinstance(kind, Array) else VALUES[kind](self, ref)

    def array(
        self, name: str, kind: Kind = REAL, *, size: int | None = None, read: bool = False, room: int = 1
    ) -> Memory:
        """Add a parameter that is an array of values of one kind, and return it.

        `size` is the number of values, or None if the caller decides. With `read` the array is only read. Blocks of
        `room` values may be accessed as a whole; the last block may reach beyond `size`.
        """
        memory: Memory = self.given(name, Array(kind, size, read, room))
        return memory

    def record(self, name: str, record: Record) -> Any:
        """Add a parameter that is a record (named numbers that persist across calls), and return it."""
        return RecordFields(self, self._parameter(name, record), record)

    def function(self, name: str, callee: Callee) -> FunctionParameter:
        """Add a parameter that is a function of the type `callee`, and return it."""
        return FunctionParameter(self, self._parameter(name, callee), callee)

    def _parameter(self, name: str, kind: Kind | Array | Record | Callee) -> int:
        if self.current:
            raise LagrangeError(f"procedure {self.name}: declare the parameter {name} before the first statement.")
        ref = self.unused()
        self.parameters.append(form.Parameter(ref, name, kind))
        return ref

    # --- values

    def operation(self, op: str, *args: Any) -> Any:
        """Return the result of the operation `op`; on vectors it works entry by entry.

        Python numbers among the operands take the kind of the other operands. Numbers and flags are broadcast to
        the width of a vector.
        """
        vectors = [arg for arg in args if isinstance(arg, Entries)]
        kinds = [arg.kind for arg in vectors or args if isinstance(arg, (Value, Entries))]
        kind = next((k for k in kinds if k is not FLAG), REAL)

        def operand(arg: Any) -> Any:
            value = arg if isinstance(arg, (Value, Entries)) else self.constant(arg, kind)
            return self.broadcast(value, vectors[0].width) if vectors and isinstance(value, Value) else value

        operands = [operand(arg) for arg in args]
        result = form.result_kind(op, tuple(value.kind for value in operands))
        if result is None:
            operand_kinds = ", ".join(value.kind for value in operands)
            raise LagrangeError(f"procedure {self.name}: {op} cannot take {operand_kinds}.")
        refs = tuple(value.ref for value in operands)
        if not vectors:
            return self.made(result, lambda ref: form.Let(ref, result, op, refs))
        vector = Vector(result, vectors[0].width)
        return self.made(vector, lambda ref: form.VectorLet(ref, vector, op, refs))

    def sine_cosine(self, angle: Any) -> tuple[Any, Any]:
        """Return the sine and the cosine of an angle, or of each entry of a vector."""
        sine, cosine = self.unused(), self.unused()
        self.add(form.SineCosine(sine, cosine, angle.ref))
        return self.value_of(sine, _kind_of(angle)), self.value_of(cosine, _kind_of(angle))

    def broadcast(self, value: Value, width: int) -> Entries:
        """Return a vector with the same value in every entry."""
        vector: Entries = self.permuted([value], (0,) * width)
        return vector

    def permuted(self, parts: Sequence[Any], indices: Sequence[int]) -> Any:
        """Return a vector of some entries of `parts`, which are vectors and single values.

        The entries of all parts are numbered consecutively from 0. `indices` are the numbers of the chosen entries,
        in order. For one index the result is a single value.
        """
        kind = parts[0].kind
        if len(indices) > 1:
            vector, refs = Vector(kind, len(indices)), tuple(part.ref for part in parts)
            return self.made(vector, lambda ref: form.VectorLet(ref, vector, "permute", refs, tuple(indices)))
        known = [(part, k) for part in parts for k in range(part.width if isinstance(part, Entries) else 1)]
        part, k = known[indices[0]]
        if not isinstance(part, Entries):
            return part
        return self.made(kind, lambda ref: form.Reduce(ref, kind, "entry", part.ref, k))

    def constant(self, value: Any, kind: Kind) -> Any:
        """Return a Python number as a constant of the given kind."""
        if isinstance(value, bool) != (kind is FLAG) or (kind is WHOLE and not isinstance(value, int)):
            raise LagrangeError(f"procedure {self.name}: {value!r} is not of the kind {kind}.")
        data: float | int | bool = float(value) if kind is REAL else value if kind is FLAG else int(value)
        key = kind, repr(data)
        for known in self._constants:
            if key in known:
                return known[key]
        number = self._constants[-1][key] = self.made(kind, lambda ref: form.Let(ref, kind, form.CONSTANT, (), data))
        return number

    @property
    def true(self) -> Flag:
        """The constant flag "true"."""
        return Flag.of(self.constant(value=True, kind=FLAG))

    @property
    def false(self) -> Flag:
        """The constant flag "false"."""
        return Flag.of(self.constant(value=False, kind=FLAG))

    def operand(self, value: Any, kind: Kind | Vector) -> int:
        """Return the id of a value, or of a constant for a Python number.

        Raises LagrangeError for a value that is not of the given kind.
        """
        if not isinstance(value, (Value, Entries)) and isinstance(kind, Kind):
            value = self.constant(value, kind)
        if _kind_of(value) != kind:
            raise LagrangeError(f"procedure {self.name}: an operand is a {_kind_of(value)}: give a {kind}.")
        ref: int = value.ref
        return ref

    def made(self, kind: Kind | Vector, make: Callable[[int], Statement]) -> Any:
        """Add the statement that `make` returns for a new id. Return the value that it defines."""
        ref = self.unused()
        self.add(make(ref))
        return self.value_of(ref, kind)

    def value_of(self, ref: int, kind: Kind | Vector) -> Any:
        """Return the value with the id `ref`, as an object with Python operators."""
        return Entries(self, ref, kind) if isinstance(kind, Vector) else VALUES[kind](self, ref)

    def real(self, value: Any) -> Real:
        """Return a real, whole or flag as a real. A flag gives 1.0 or 0.0."""
        if isinstance(value, Real):
            return value
        number = self.operation("real", value) if isinstance(value, Value) else self.constant(value, REAL)
        assert isinstance(number, Real)
        return number

    def whole(self, value: Any) -> Whole:
        """Return a real, whole or flag as a whole. A real is rounded towards zero."""
        if isinstance(value, Whole):
            return value
        number = self.operation("whole", value) if isinstance(value, Value) else self.constant(value, WHOLE)
        assert isinstance(number, Whole)
        return number

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a*b + c, rounded once."""
        return self.operation("fma", a, b, c)

    def fnma(self, a: Any, b: Any, c: Any) -> Any:
        """Return c - a*b, rounded once."""
        return self.operation("fnma", a, b, c)

    def sqrt(self, x: Any) -> Any:
        """Return the square root of a number, or of each entry of a vector."""
        return self.operation("sqrt", x)

    def choose(self, condition: Flag, a: Any, b: Any) -> Any:
        """Return `a` if the condition holds, else `b`. Both are computed."""
        return self.operation("select", condition, a, b)

    # --- memory

    def variable(self, value: Any, name: str = "") -> Variable:
        """Return a new variable with `value` as its first value. For a Python number the kind follows from its type."""
        kind = _kind_of(value)
        first, ref = self.operand(value, kind), self.unused()
        self.add(form.Declare(ref, kind, first))
        if name:
            self.names[ref] = name
        return Variable(self, ref, kind)

    def reserve(self, size: int, kind: Kind = REAL, *, room: int = 1, name: str = "") -> Memory:
        """Return a new local array of `size` undefined values of one kind.

        Blocks of `room` values may be accessed as a whole; the last block may reach beyond `size`.
        """
        array, ref = Array(kind, size, room=room), self.unused()
        self.add(form.Reserve(ref, array))
        if name:
            self.names[ref] = name
        return Memory(self, ref, array)

    def reserve_record(self, record: Record, name: str = "") -> Any:
        """Return a local record; its fields are zero at first."""
        ref = self.unused()
        self.add(form.ReserveRecord(ref, record))
        self.names[ref] = name or record.name.lower()
        return RecordFields(self, ref, record)

    def part(self, memory: Memory, start: Any) -> Memory:
        """Return the part of an array from index `start` on."""
        first, ref = self.operand(start, WHOLE), self.unused()
        self.add(form.Part(ref, memory.ref, first))
        return Memory(self, ref, Array(memory.array.kind, None, memory.array.read, memory.array.room), memory.root)

    # --- control

    @contextmanager
    def block(self) -> Iterator[list[Statement]]:
        """Collect the statements that the body of the `with` adds, in a new block."""
        outside, self.current = self.current, []
        inside = self.current
        self._constants.append({})
        try:
            yield inside
        finally:
            self.current = outside
            self._constants.pop()

    @contextmanager
    def when(self, condition: Flag, *, likely: bool | None = None) -> Iterator[OpenBranches]:
        """Add a branch: the body of the `with` runs if the condition holds.

        Yields an object whose `otherwise` adds the second block. `likely` is the usual value of the condition, or
        None if neither is usual.
        """
        branches = OpenBranches(self, len(self.current))
        with self.block() as body:
            yield branches
        self.add(form.When(condition.ref, tuple(body), likely=likely))

    @contextmanager
    def loop(self, start: Any, stop: Any, step: int = 1) -> Iterator[Whole]:
        """Add a loop: the body of the `with` runs for each index from `start` in steps of `step`, below `stop`."""
        first, last, index = self.operand(start, WHOLE), self.operand(stop, WHOLE), self.unused()
        with self.block() as body:
            yield Whole(self, index)
        self.add(form.Loop(index, first, last, step, tuple(body)))

    @contextmanager
    def repeat(self, test: Callable[[], Flag]) -> Iterator[None]:
        """Add a loop: the body of the `with` runs while a condition holds.

        `test` builds the condition, which is evaluated before each iteration.
        """
        with self.block() as asked:
            condition = test().ref
        with self.block() as body:
            yield
        self.add(form.Repeat(tuple(asked), condition, tuple(body)))

    @contextmanager
    def each(
        self, count: Any, *, width: int = form.PARTIAL, spill: bool = False, unrolled: bool = False
    ) -> Iterator[Whole]:
        """Add a loop: the body of the `with` runs for each index below `count`, in any order.

        The body may use `fold`. Up to `width` iterations may run at a time. With `spill` they may overwrite array
        entries from `count` on. With `unrolled` all iterations are written out.
        """
        number = self.operand(count, WHOLE)
        index, outside, self._folds = self.unused(), self._folds, []
        if outside is not None:
            raise LagrangeError(
                f"procedure {self.name}: an `each` is inside another `each`: use a plain loop for the inner one."
            )
        with self.block() as body:
            yield Whole(self, index)
        self.add(form.Each(index, number, tuple(body), tuple(self._folds), width, spill, unrolled))
        self._folds = None

    def fold(self, op: str, value: Any, factor: Any = None) -> Real:
        """Return the reduction `op` of a value over the iterations of the enclosing `each`.

        The result is available after the loop: "add" is the sum, "dot" the sum of value * factor, "max" the largest
        value (NaN if any value is NaN), "most" the largest without NaN, "magnitude" the largest |value|.
        """
        if self._folds is None:
            raise LagrangeError(f"procedure {self.name}: sums of values are possible inside `each` only.")
        second = None if factor is None else self.operand(factor, REAL)
        self._folds.append(form.Fold(self.unused(), op, self.operand(value, REAL), second))
        return Real(self, self._folds[-1].ref)

    def call(self, callee: Procedure, *args: Any) -> Any:
        """Add a call of another procedure, and return its results: None, a value or a tuple of values."""
        return self.call_function(
            callee, callee.numbers, tuple(parameter.type for parameter in callee.parameters), args
        )

    def call_function(
        self, callee: Procedure | int, results: tuple[Kind, ...], types: tuple[Any, ...], args: Any
    ) -> Any:
        """Add a call of a procedure, or of the function parameter with the id `callee`, and return its results.

        `results` are the kinds of the results, and `types` the types of the parameters, for the arguments `args`. The
        call returns None, a value or a tuple of values.
        """
        if len(args) != len(types):
            raise LagrangeError(
                f"procedure {self.name}: a call has {len(args)} arguments, and the callee {len(types)} parameters."
            )
        operands = tuple(
            self.operand(arg, kind) if isinstance(kind, Kind) else arg.ref
            for arg, kind in zip(args, types, strict=True)
        )
        refs = tuple(self.unused() for _ in results)
        self.add(form.Call(refs, callee, operands))
        values = tuple(VALUES[kind](self, ref) for kind, ref in zip(results, refs, strict=True))
        return values[0] if len(values) == 1 else values or None

    def leave(self, *values: Any) -> None:
        """Add a return from the procedure with results. Python integers become wholes."""
        self.add(form.Leave(tuple(self.operand(value, _kind_of(value)) for value in values)))

    def note(self, text: str) -> None:
        """Add a comment, which printers print."""
        self.add(form.Note(text))

    def add(self, statement: Statement) -> None:
        """Add a statement to the block that is being built."""
        if self.current and isinstance(self.current[-1], form.Leave):
            raise LagrangeError(f"procedure {self.name}: write no statement after the end of the procedure.")
        self.current.append(statement)

    def finish(self, *results: Kind) -> Procedure:
        """Return the finished procedure, whose results have the given kinds."""
        body: Block = tuple(self.current)
        return Procedure(self.name, self.about, tuple(self.parameters), results, body, dict(self.names), self._noinline)

    def unused(self) -> int:
        """Return an unused id for a new value."""
        self._count += 1
        return self._count - 1


def _kind_of(value: Any) -> Any:
    """Return the type of a value, or the kind of a Python number."""
    if isinstance(value, Entries):
        return value.vector
    if isinstance(value, Value):
        return value.kind
    return FLAG if isinstance(value, bool) else WHOLE if isinstance(value, int) else REAL
