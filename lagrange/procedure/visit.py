"""Visit the statements of procedures: the ids that each statement reads and defines, visitors, and a check.

Printers, the check and all passes use the table and the visitor. A new statement is added to `form`, to the table here,
and as a method to each visitor. Defining a visitor class without a method for some statement raises an error.

The check finds what a builder cannot see while it adds statements one by one. Values are read in their scope only,
every path returns the results, only writable arrays are written, and iterations in any order do not depend on one
another. Kinds of operands are not checked: the builder has made the operands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar, NamedTuple, TypeVar, get_args

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import (
    CONSTANT,
    PARTIAL,
    VECTOR_STATEMENTS,
    WIDTHS,
    Array,
    Block,
    Callee,
    Kind,
    Procedure,
    Statement,
    Vector,
    inner,
    walk,
)


class Fields(NamedTuple):
    """Names of the fields of a statement that hold ids: ids that the statement reads, and ids that it defines."""

    read: tuple[str, ...] = ()
    defined: tuple[str, ...] = ()


FIELDS: Mapping[type, Fields] = {
    form.Let: Fields(("args",), ("ref",)),
    form.SineCosine: Fields(("angle", "angle"), ("sine", "cosine")),
    form.VectorLet: Fields(("args",), ("ref",)),
    form.Reduce: Fields(("vector",), ("ref",)),
    form.VectorLoad: Fields(("array", "place"), ("ref",)),
    form.Gather: Fields(("array", "places", "mask"), ("ref",)),
    form.VectorStore: Fields(("array", "place", "value", "mask")),
    form.Scatter: Fields(("array", "places", "value", "mask")),
    form.Reserve: Fields((), ("ref",)),
    form.ReserveRecord: Fields((), ("ref",)),
    form.Part: Fields(("array", "start"), ("ref",)),
    form.Load: Fields(("array", "place"), ("ref",)),
    form.Store: Fields(("array", "place", "value")),
    form.Read: Fields(("record",), ("ref",)),
    form.Write: Fields(("record", "value")),
    form.Declare: Fields(("value",)),
    form.Get: Fields((), ("ref",)),
    form.Set: Fields(("value",)),
    form.When: Fields(("condition",)),
    form.Loop: Fields(("start", "stop"), ("place",)),
    form.Repeat: Fields(("condition",)),
    form.Each: Fields(("iterations", "folds"), ("place", "folds")),
    form.Call: Fields(("callee", "args"), ("refs",)),
    form.Leave: Fields(("values",)),
    form.Note: Fields(),
}
"""Fields of every kind of statement. Variables are excluded. An angle counts as read twice, for its sine and cosine."""


def operands(statement: Statement) -> tuple[int, ...]:
    """Return the ids that a statement itself reads, without statements inside its blocks.

    Arrays and records that the statement writes to are included; variables are not.
    """
    return tuple(ref for name in FIELDS[type(statement)].read for ref in _numbers(getattr(statement, name)))


def defined(statement: Statement) -> tuple[int, ...]:
    """Return the ids that a statement itself defines, without statements inside its blocks."""
    refs: list[int] = []
    for name in FIELDS[type(statement)].defined:
        value = getattr(statement, name)
        refs += [fold.ref for fold in value] if name == "folds" else _numbers(value)
    return tuple(refs)


def _numbers(value: Any) -> Iterator[int]:
    """Yield the ids in the value of a statement's field. A called procedure contains none."""
    match value:
        case int():
            yield value
        case form.Fold(value=first, factor=second):
            yield first
            if second is not None:
                yield second
        case tuple():
            for part in value:
                yield from _numbers(part)
        case Procedure() | None:
            return


def reads(block: Block) -> frozenset[int]:
    """Return the ids that the statements of a block read, including inner blocks."""
    return frozenset(ref for statement in walk(block) for ref in operands(statement))


def uses_of(block: Block) -> dict[int, int]:
    """Return how often each id is used in a block, by id.

    A use inside a loop counts twice if the value is defined outside of the loop.
    """
    uses: dict[int, int] = {}
    for statement in block:
        for ref in operands(statement):
            uses[ref] = uses.get(ref, 0) + 1
        loops = isinstance(statement, (form.Loop, form.Repeat, form.Each))
        for body in inner(statement):
            made = frozenset(ref for child in walk(body) for ref in defined(child))
            for ref, count in uses_of(body).items():
                uses[ref] = uses.get(ref, 0) + (count if ref in made or not loops else 2 * count)
    return uses


def loop_depth(block: Block) -> int:
    """Return the greatest depth of nested loops in a block."""
    depths = (
        loop_depth(body) + isinstance(statement, (form.Loop, form.Each))
        for statement in block
        for body in inner(statement)
    )
    return max(depths, default=0)


Method = TypeVar("Method", bound=Callable[..., Any])


def visits(*kinds: type) -> Callable[[Method], Method]:
    """Mark a method as the visitor of some kinds of statements."""

    def marked(method: Method) -> Method:
        method.__dict__["visits"] = kinds
        return method

    return marked


class Visitor:
    """Base class of passes over a procedure: calls the method for the class of each statement.

    A subclass has one method for each class of statements, marked by `visits`. It needs none for vectors if it prints
    procedures without vectors only.
    """

    _methods: ClassVar[Mapping[type, str]] = {}

    def __init_subclass__(cls) -> None:
        """Collect the methods of a subclass. Raises TypeError if a class of statements has none."""
        methods = {
            kind: name
            for base in reversed(cls.__mro__)
            for name, method in vars(base).items()
            for kind in getattr(method, "visits", ())
        }
        missing = [kind.__name__ for kind in get_args(Statement) if kind not in (*methods, *VECTOR_STATEMENTS)]
        if missing:
            raise TypeError(f"{cls.__name__} has no method for {', '.join(missing)}")
        cls._methods = methods

    def statement(self, statement: Statement) -> Any:
        """Call the method for the class of a statement, and return its result.

        Raises LagrangeError for a statement on vectors without a method.
        """
        if type(statement) not in self._methods:
            raise LagrangeError(f"{type(self).__name__} prints no vectors: build the procedure with single values.")
        return getattr(self, self._methods[type(statement)])(statement)


IN_ITERATIONS = (form.Let, form.Load, form.Store, form.Part, form.Declare, form.Get, form.Set, form.Loop, form.Note)
"""Statements that an iteration of an `each` may contain. The count of its loops is the same in every iteration."""


def verify(procedure: Procedure) -> None:
    """Raise LagrangeError unless a procedure is well formed."""
    _Check(procedure).run()


class _Check:
    """Checks a procedure statement by statement, with the ids of the values and variables in scope.

    `memory` has the types of arrays, records and functions, and `constants` the ids of constants.
    """

    def __init__(self, procedure: Procedure) -> None:
        self.procedure = procedure
        self.known: set[int] = set()
        self.memory: dict[int, Array | form.Record | Callee] = {}
        self.constants: set[int] = set()
        self.each: int | None = None
        """The index of the present `each`."""
        self.places: set[int] = set()
        """Values computed from the index of an `each`. They may be compared, but must not index an array."""
        self.own: set[int] = set()
        """The variables that are declared inside the present `each`."""

    def run(self) -> None:
        names = [parameter.name for parameter in self.procedure.parameters]
        if len(dict.fromkeys(names)) != len(names):
            raise self.error("two parameters have one name")
        called = [callee.name for callee in self.procedure.callees]
        if len(dict.fromkeys(called)) != len(called):
            raise self.error(f"it calls different procedures of one name among {', '.join(called)}")
        for parameter in self.procedure.parameters:
            self.known.add(parameter.ref)
            if not isinstance(parameter.type, (Kind, Vector)):
                self.memory[parameter.ref] = parameter.type
        if not self.block(self.procedure.body) and self.procedure.results:
            raise self.error("a path through it ends without results")

    def error(self, problem: str) -> LagrangeError:
        return LagrangeError(f"procedure {self.procedure.name} is malformed: {problem}")

    @contextmanager
    def scope(self) -> Iterator[None]:
        """Context manager for a scope: values and variables that are defined in it are unknown after it."""
        known = set(self.known)
        yield
        self.known = known

    def block(self, block: Block) -> bool:
        """Check a block; return True if every path through it ends the procedure."""
        with self.scope():
            return self.statements(block)

    def statements(self, block: Block) -> bool:
        ended = False
        for statement in block:
            if ended:
                raise self.error("a statement follows the end")
            if self.each is not None and not isinstance(statement, IN_ITERATIONS):
                raise self.error(f"an iteration of an `each` has a {type(statement).__name__}")
            ended = self.statement(statement)
        return ended

    def read(self, refs: Sequence[int]) -> None:
        """Raise an error unless the values with these ids are in scope."""
        for ref in refs:
            if ref not in self.known:
                raise self.error(f"%{ref} is read outside of its scope")

    def statement(self, statement: form.Statement) -> bool:
        """Check a statement; return True if it ends the procedure."""
        if isinstance(statement, (form.Loop, form.Repeat, form.Each)):
            self.loop(statement)
            return False
        self.read(operands(statement))
        self.known.update(defined(statement))
        match statement:
            case form.Let(ref=ref, op=op, args=args):
                if op == CONSTANT:
                    self.constants.add(ref)
                if not self.places.isdisjoint(args):
                    self.places.add(ref)
            case form.Load(place=index):
                self.place(index)
            case form.Store(array=array, place=index):
                if self.each is not None and index != self.each:
                    raise self.error("an iteration of an `each` stores at an index other than its own")
                self.place(index)
                self.writable(array)
            case form.VectorStore(array=array) | form.Scatter(array=array):
                self.writable(array)
            case form.Declare(ref=ref):
                self.known.add(ref)
                self.own.add(ref)
            case form.Get(variable=variable) | form.Set(variable=variable):
                self.read([variable])
                if isinstance(statement, form.Set) and self.each is not None and variable not in self.own:
                    raise self.error("an iteration of an `each` sets a variable of an outer block")
            case form.Reserve(ref=ref, array=array_type):
                self.memory[ref] = array_type
            case form.ReserveRecord(ref=ref, record=record):
                self.memory[ref] = record
            case form.Part(ref=ref, array=array):
                self.memory[ref] = self.memory[array]
            case form.Call():
                self.call(statement)
            case form.When(then=then, otherwise=otherwise):
                return self.block(then) & self.block(otherwise)
            case form.Leave(values=values):
                if len(values) != len(self.procedure.results):
                    raise self.error(f"the end has {len(values)} values for {len(self.procedure.results)}")
                return True
        return False

    def place(self, index: int) -> None:
        """Raise an error if an array index is computed from the index of an `each`, but is not that index itself.

        `index` is the id of the array index.
        """
        if index in self.places and index != self.each:
            raise self.error("an iteration of an `each` reads or writes at an index computed from its own")

    def writable(self, array: int) -> None:
        """Raise an error if an array is only read."""
        held = self.memory[array]
        if isinstance(held, Array) and held.read:
            raise self.error(f"%{array} is only read")

    def call(self, call: form.Call) -> None:
        """Raise an error unless the types of arrays, records and functions in a call fit the callee's parameters."""
        callee = call.callee if isinstance(call.callee, Procedure) else self.memory.get(call.callee)
        assert isinstance(callee, (Procedure, Callee))
        types = [
            parameter if isinstance(parameter, (Kind, Array)) else parameter.type for parameter in callee.parameters
        ]
        for arg, expected in zip(call.args, types, strict=True):
            actual = self.memory.get(arg)
            fits = actual == expected
            if isinstance(actual, Array) and isinstance(expected, Array):
                # A writable array fits a read-only parameter.
                fits = actual.kind is expected.kind and (expected.read or not actual.read)
            if not isinstance(expected, (Kind, Vector)) and not fits:
                raise self.error(f"a call has %{arg} as an argument of another type")

    def loop(self, loop: form.Loop | form.Repeat | form.Each) -> None:
        match loop:
            case form.Loop(place=index, start=start, stop=stop, step=step, body=body):
                self.read((start, stop))
                if step <= 0:
                    raise self.error("a loop has a step that is not above zero")
                with self.scope():
                    self.known.add(index)
                    self.statements(body)
            case form.Repeat(test=test, condition=condition, body=body):
                with self.scope():
                    self.statements(test)
                    self.read([condition])
                self.block(body)
            case form.Each(place=index, iterations=count, body=body, folds=folds, width=width):
                self.read([count])
                if width not in WIDTHS:
                    raise self.error(f"an `each` of {width} iterations at once, which are one of {WIDTHS}")
                self.each = index
                self.places, self.own = {index}, set()
                with self.scope():
                    self.known.add(index)
                    self.statements(body)
                    self.read([ref for fold in folds for ref in (fold.value, fold.factor) if ref is not None])
                if folds and count not in self.constants:
                    self.has_room(index, body)
                self.each = None
                self.known.update(fold.ref for fold in folds)

    def has_room(self, index: int, body: Block) -> None:
        """Raise an error unless the arrays that a reduction reads have room for a whole last block.

        They are accessed at the loop index, whose id is `index`. Called for reductions whose number of iterations is
        not a constant.
        """
        for statement in body:
            if isinstance(statement, (form.Load, form.Store)) and statement.place == index:
                held = self.memory[statement.array]
                if isinstance(held, Array) and held.room < PARTIAL:
                    raise self.error(
                        f"the array %{statement.array} of a sum has no room for a whole block after its end"
                    )
