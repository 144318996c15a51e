"""Check a procedure: every operand is defined and of the right kind, and every path returns the results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from lagrange.errors import LagrangeError
from lagrange.procedure import form
from lagrange.procedure.form import (
    CONSTANT,
    FLAG,
    PARTIAL,
    REAL,
    SUMS,
    WHOLE,
    WIDTHS,
    Array,
    Block,
    Callee,
    Kind,
    Procedure,
    Record,
    Statement,
    Type,
    Vector,
    result_kind,
)

IN_ITERATIONS = (form.Let, form.Load, form.Store, form.Part, form.Declare, form.Get, form.Set, form.Loop, form.Note)
"""Statements that an iteration of an `each` may contain. The count of its loops is the same in every iteration."""


def verify(procedure: Procedure) -> None:
    """Raise LagrangeError unless a procedure is well formed."""
    _Check(procedure).run()


class _Check:
    """Checks a procedure statement by statement, with the types of the values defined so far."""

    def __init__(self, procedure: Procedure) -> None:
        self.procedure = procedure
        self.known: dict[int, Type] = {}
        self.variables: dict[int, Kind | Vector] = {}
        self.numbers: set[int] = set()
        self.each: int | None = None
        self.constants: set[int] = set()
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
            self.define(parameter.ref, parameter.type)
        if not self.block(self.procedure.body) and self.procedure.results:
            raise self.error("a way through it ends without results")

    def error(self, problem: str) -> LagrangeError:
        return LagrangeError(f"procedure {self.procedure.name} is malformed: {problem}")

    def define(self, ref: int, kind: Type) -> None:
        if ref in self.numbers:
            raise self.error(f"%{ref} is defined twice")
        self.numbers.add(ref)
        self.known[ref] = kind

    def type(self, ref: int) -> Type:
        if ref not in self.known:
            raise self.error(f"%{ref} is read where it is not known")
        return self.known[ref]

    def kind(self, ref: int, expected: Kind | Vector) -> None:
        if self.type(ref) != expected:
            raise self.error(f"%{ref} is not a {expected}")

    def array(self, ref: int) -> Array:
        array = self.type(ref)
        if not isinstance(array, Array):
            raise self.error(f"%{ref} is not an array")
        return array

    def writable(self, ref: int) -> Array:
        if self.array(ref).read:
            raise self.error(f"%{ref} is only read")
        return self.array(ref)

    @contextmanager
    def scope(self) -> Iterator[None]:
        """Context at whose end the definitions made inside are dropped."""
        known, variables = dict(self.known), dict(self.variables)
        yield
        self.known, self.variables = known, variables

    def block(self, block: Block) -> bool:
        """Check a block; return True if every path through it ends the procedure."""
        with self.scope():
            return self.statements(block)

    def statements(self, block: Block) -> bool:
        ended = False
        for statement in block:
            if ended:
                raise self.error("a statement stands behind the end")
            if self.each is not None and not isinstance(statement, IN_ITERATIONS):
                raise self.error(f"an iteration of an `each` has a {type(statement).__name__}")
            ended = self.statement(statement)
        return ended

    def statement(self, statement: Statement) -> bool:
        """Check a statement; return True if it ends the procedure."""
        match statement:
            case form.Let():
                self.let(statement)
            case form.Load(ref=ref, kind=kind, array=array, place=index):
                self.place(array, index, kind)
                self.define(ref, kind)
            case form.Store(array=array, place=index, value=value):
                if self.each is not None and index != self.each:
                    raise self.error("an iteration of an `each` stores at another place than its own")
                self.place(array, index, self.writable(array).kind)
                self.kind(value, self.array(array).kind)
            case form.Read() | form.Write():
                self.field(statement)
            case form.Declare() | form.Get() | form.Set():
                self.variable(statement)
            case form.SineCosine(sine=sine, cosine=cosine, angle=angle):
                if _entry_kind(self.type(angle)) is not REAL:
                    raise self.error(f"%{angle} is not an angle")
                self.define(sine, self.type(angle))
                self.define(cosine, self.type(angle))
            case form.Reserve(ref=ref, array=memory):
                if memory.size is None:
                    raise self.error(f"the array %{ref} of its own has no size")
                self.define(ref, memory)
            case form.ReserveRecord(ref=ref, record=record):
                self.define(ref, record)
            case form.Part(ref=ref, array=array, start=start):
                self.kind(start, WHOLE)
                whole = self.array(array)
                self.define(ref, Array(whole.kind, None, whole.read, whole.room))
            case form.Call():
                self.call(statement)
            case form.When(condition=condition, then=then, otherwise=otherwise):
                self.kind(condition, FLAG)
                return self.block(then) & self.block(otherwise)
            case form.Loop() | form.Repeat() | form.Each():
                self.loop(statement)
            case form.Leave(values=values):
                self.kinds(values, self.procedure.results, "the end")
                return True
            case form.VectorLet():
                self.vector_let(statement)
            case form.Reduce():
                self.reduce(statement)
            case form.VectorLoad() | form.Gather() | form.VectorStore() | form.Scatter():
                self.vector_memory(statement)
        return False

    def let(self, let: form.Let) -> None:
        if self.each is not None and any(arg == self.each or arg in self.places for arg in let.args):
            self.places.add(let.ref)
        if let.op == CONSTANT:
            good = isinstance(let.data, {REAL: float, WHOLE: int, FLAG: bool}[let.kind]) and not let.args
            result = let.kind if good and isinstance(let.data, bool) == (let.kind is FLAG) else None
        else:
            kinds = [self.type(arg) for arg in let.args]
            result = result_kind(let.op, tuple(kind for kind in kinds if isinstance(kind, Kind)))
        if result is not let.kind:
            raise self.error(f"%{let.ref} = {let.op} gives no {let.kind}")
        self.define(let.ref, let.kind)
        if let.op == CONSTANT:
            self.constants.add(let.ref)

    def vector_let(self, let: form.VectorLet) -> None:
        kind, width = let.vector
        result: Kind | None = None
        types = [self.type(arg) for arg in let.args]
        if width not in WIDTHS[1:]:
            raise self.error(f"%{let.ref} is a vector of {width} entries, which are one of {WIDTHS[1:]}")
        match let.op, types:
            case "permute", [first, *_] if len(let.places) == width:
                known = [operand for operand in types if _entry_kind(operand) is _entry_kind(first)]
                count = sum(operand.width if isinstance(operand, Vector) else 1 for operand in known)
                inside = all(0 <= index < count for index in let.places)
                result = _entry_kind(first) if inside and len(known) == len(types) else None
            case op, _:
                kinds = tuple(
                    operand.kind for operand in types if isinstance(operand, Vector) and operand.width == width
                )
                result = result_kind(op, kinds) if len(kinds) == len(types) else None
        if result is not kind:
            raise self.error(f"%{let.ref} = {let.op} gives no vector of {width} {kind}s")
        self.define(let.ref, let.vector)

    def reduce(self, reduce: form.Reduce) -> None:
        vector = self.type(reduce.vector)
        kinds = {"any": (FLAG,), "sum": (REAL, WHOLE), "entry": (REAL, WHOLE, FLAG)}.get(reduce.op, ())
        inside = isinstance(vector, Vector) and 0 <= reduce.place < vector.width
        if not isinstance(vector, Vector) or not inside or vector.kind not in kinds or vector.kind is not reduce.kind:
            raise self.error(f"%{reduce.ref} = {reduce.op} gives no {reduce.kind}")
        self.define(reduce.ref, reduce.kind)

    def vector_memory(self, access: form.VectorLoad | form.Gather | form.VectorStore | form.Scatter) -> None:
        held = self.array(access.array)
        vector = self.type(access.value) if isinstance(access, (form.VectorStore, form.Scatter)) else access.vector
        if not isinstance(vector, Vector) or vector.kind is not held.kind or held.kind is FLAG:
            raise self.error(f"%{access.array} holds no entries of {vector}")
        if isinstance(access, (form.VectorStore, form.Scatter)):
            self.writable(access.array)
        if isinstance(access, (form.Gather, form.Scatter)):
            if self.type(access.places) != Vector(WHOLE, vector.width):
                raise self.error(f"%{access.places} is not a vector of {vector.width} places")
        else:
            self.kind(access.place, WHOLE)
        if access.mask is not None and self.type(access.mask) != Vector(FLAG, vector.width):
            raise self.error(f"%{access.mask} is not a mask of {vector.width} flags")
        if isinstance(access, (form.VectorLoad, form.Gather)):
            self.define(access.ref, vector)

    def place(self, array: int, index: int, kind: Kind) -> None:
        self.kind(index, WHOLE)
        if index in self.places:
            raise self.error("an iteration of an `each` reads or writes at a place made of its index")
        if self.array(array).kind is not kind:
            raise self.error(f"%{array} holds no {kind}")

    def field(self, statement: form.Read | form.Write) -> None:
        record, field = self.type(statement.record), statement.field
        if not isinstance(record, Record) or field not in record.places:
            raise self.error(f"%{statement.record} is not a record with the field {field}")
        if isinstance(statement, form.Write):
            self.kind(statement.value, record.type_of(field))
            return
        if record.kind(field) is not statement.kind:
            raise self.error(f"the field {field} is not a {statement.kind}")
        self.define(statement.ref, record.type_of(field))

    def variable(self, statement: form.Declare | form.Get | form.Set) -> None:
        match statement:
            case form.Declare(ref=ref, kind=kind, value=value):
                self.kind(value, kind)
                self.numbers.add(ref)
                self.variables[ref] = kind
                if self.each is not None:
                    self.own.add(ref)
            case form.Get(ref=ref, kind=kind, variable=variable):
                self.held(variable, kind)
                self.define(ref, kind)
            case form.Set(variable=variable, value=value):
                if self.each is not None and variable not in self.own:
                    raise self.error("an iteration of an `each` sets a variable from outside")
                self.held(variable, self.type(value))

    def held(self, variable: int, kind: Type) -> None:
        if variable not in self.variables or self.variables[variable] != kind:
            raise self.error(f"%{variable} is not a variable that holds a {kind}")

    def call(self, call: form.Call) -> None:
        if isinstance(call.callee, Procedure):
            types = tuple(parameter.type for parameter in call.callee.parameters)
            results = call.callee.results
        else:
            callee = self.type(call.callee)
            if not isinstance(callee, Callee):
                raise self.error(f"%{call.callee} is not a function")
            types, results = callee.parameters, callee.results
        self.kinds(call.args, types, "a call")
        if len(call.refs) != len(results):
            raise self.error(f"a call takes {len(call.refs)} of {len(results)} results")
        for ref, kind in zip(call.refs, results, strict=True):
            self.define(ref, kind)

    def kinds(self, refs: Sequence[int], types: Sequence[Type], where: str) -> None:
        if len(refs) != len(types):
            raise self.error(f"{where} has {len(refs)} values for {len(types)}")
        for ref, expected in zip(refs, types, strict=True):
            if not _fits(self.type(ref), expected):
                raise self.error(f"{where} has %{ref} in the place of another type")

    def loop(self, loop: form.Loop | form.Repeat | form.Each) -> None:
        match loop:
            case form.Loop(place=index, start=start, stop=stop, step=step, body=body):
                self.kinds((start, stop), (WHOLE, WHOLE), "a loop")
                if step <= 0:
                    raise self.error("a loop has a step that is not above zero")
                with self.scope():
                    self.define(index, WHOLE)
                    self.statements(body)
            case form.Repeat(test=test, condition=condition, body=body):
                with self.scope():
                    if self.statements(test):
                        raise self.error("the test of a loop ends the procedure")
                    self.kind(condition, FLAG)
                self.block(body)
            case form.Each(place=index, iterations=count, body=body, folds=folds, width=width):
                self.kind(count, WHOLE)
                if width not in WIDTHS:
                    raise self.error(f"an `each` of {width} iterations at once, which are one of {WIDTHS}")
                self.define(index, WHOLE)
                self.each = index
                with self.scope():
                    self.statements(body)
                    for fold in folds:
                        self.fold(fold)
                    if folds and count not in self.constants:
                        self.has_room(index, body)
                self.each = None
                self.own.clear()
                for fold in folds:
                    self.define(fold.ref, REAL)

    def fold(self, fold: form.Fold) -> None:
        known = fold.op in SUMS or fold.op in ("max", "most", "magnitude")
        if (fold.op == "dot") != (fold.factor is not None) or not known:
            raise self.error(f"%{fold.ref} = {fold.op} is no way to make one number of many")
        for value in (fold.value, fold.factor):
            if value is not None:
                self.kind(value, REAL)

    def has_room(self, index: int, body: Block) -> None:
        """Raise an error unless the arrays that a reduction accesses at its `index` have room for a whole last block.

        Called for reductions whose number of iterations is not a constant.
        """
        for statement in body:
            if (
                isinstance(statement, (form.Load, form.Store))
                and statement.place == index
                and self.array(statement.array).room < PARTIAL
            ):
                raise self.error(f"the array %{statement.array} of a sum has no room for a whole block behind its end")


def _entry_kind(operand: Type) -> Kind | None:
    """Return the kind of a number or flag, or of a vector's entries; None for another type."""
    return operand if isinstance(operand, Kind) else operand.kind if isinstance(operand, Vector) else None


def _fits(argument: Type, parameter: Type) -> bool:
    """Return True if the type of an argument fits the type of a parameter.

    A writable array fits a read-only one.
    """
    if isinstance(argument, Array) and isinstance(parameter, Array):
        return argument.kind is parameter.kind and (parameter.read or not argument.read)
    return argument == parameter
