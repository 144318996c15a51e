"""Check a procedure for what its builder cannot see while it adds statements one by one.

Values are read in their scope only, every path returns the results, only writable arrays are written, and iterations in
any order do not depend on one another. Kinds of operands are not checked: the builder has made the operands.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import CONSTANT, PARTIAL, WIDTHS, Array, Block, Callee, Kind, Procedure, Vector
from lagrange.procedure.visit import defined, operands

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
