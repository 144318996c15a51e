"""Print a procedure as LLVM IR: statements, calls, branches, loops, and loops whose iterations run in vector lanes.

Variables become SSA values: each block of a procedure lists the variables that it sets, so phis are placed where
branches join. An `each` computes several iterations at once if its arrays have room for whole vectors. Values that
differ between iterations are vectors; other values are broadcast where they are combined with vectors.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import (
    KINDS,
    argument_type,
    constant,
    convention,
    declarations,
    foreign_type,
    give,
    phi,
    result_type,
    routines_called,
    separated,
    spell,
    splat,
    together,
    type_of,
)
from lagrange.machine.llvm.sine_cosine import angle_function, angle_name, call_sine_and_cosine, sine_and_cosine
from lagrange.machine.llvm.vectors import (
    IterationBlock,
    Lanes,
    accesses,
    base_arrays,
    gathered,
    number,
    number_of_angles,
    operation,
    reduced,
    scatter,
    store,
    widest,
)
from lagrange.procedure import form
from lagrange.procedure.form import ANGLES, FLAG, PARTIAL, REAL, Array, Block, Kind, Procedure, Record, Type, Vector
from lagrange.procedure.visit import Visitor, visits

INLINE_ANGLES = 8
"""Largest number of sines and cosines of a procedure that are printed in place. A procedure with more of them calls a
function for each, which bounds the compile time of a long chain.
"""

OPERATIONS_PER_BLOCK = 200
"""Largest number of operations in one basic block of a kernel; the next operation begins another block. LLVM schedules
a block as a whole: the Jacobian of a chain of 10 links compiles in 202 ms as one block, in 152 ms as several.
"""

LARGEST_ON_STACK = 50_000
"""Largest number of entries of a local array on the stack (400 kB). Larger arrays are on the heap."""

FEW_RESULTS, MOST_TOGETHER = 16, 4
"""Limits for vector stores of results. A kernel with up to `FEW_RESULTS` stores joins up to `MOST_TOGETHER` adjacent
numbers to one store. A step loads results four at a time. A processor forwards stored values to a load only if a single
store covers the load. Otherwise a small step would take twice as long.
"""

LIKELY = {True: ", !prof !0", False: ", !prof !1", None: ""}
METADATA = '!0 = !{!"branch_weights", i32 2000, i32 1}\n!1 = !{!"branch_weights", i32 1, i32 2000}\n'
"""Branch weights, printed at the end of a module. !0 marks a branch that is almost always taken, !1 a rare one."""

ATTRIBUTES = (
    'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" "stackrealign" }\n'
    "attributes #1 = { nounwind }\n"
    "attributes #2 = { nounwind noinline optnone }\n"
)
"""LLVM attributes of functions. #0 prefers vectors of eight reals, one register on processors with AVX-512, and aligns
the stack to cache lines. With #1 LLVM chooses the width: with #0 it would copy blocks of four numbers in pairs, which
wait for stores of single numbers. #2 is for code that runs once per set of parameters: it is compiled without
optimization.
"""


def module(procedures: Sequence[Procedure], *, elsewhere: Sequence[Procedure] = ()) -> str:
    """Return the IR of a module with `procedures` and all procedures that they call.

    Procedures in `elsewhere` are declared, but not defined: other modules have their code.
    """
    reached = form.transitive_callees(procedures, elsewhere)
    functions = [function(each, hidden=each not in procedures) for each in reached]
    return joined(functions, [declaration(each) for each in dict.fromkeys(elsewhere)])


def joined(functions: Sequence[str], declared: Sequence[str] = ()) -> str:
    """Return the IR of a module that consists of `functions`, each given as IR.

    `declared` are declarations of procedures that other modules define. The declarations of library functions and the
    attributes that the functions need are added.
    """
    angles = [
        angle_function(width) for width in form.WIDTHS if any(f"@{angle_name(width)}(" in text for text in functions)
    ]
    return "\n".join(
        [declarations(), *declared, *routines_called(functions), *angles, *functions, METADATA, ATTRIBUTES]
    )


def declaration(procedure: Procedure) -> str:
    """Return the IR declaration of a procedure whose code is in another module."""
    kinds = ", ".join(argument_type(parameter.type) for parameter in procedure.parameters)
    return f"declare {result_type(procedure.results)} @{procedure.name}({kinds})"


def function(
    procedure: Procedure,
    *,
    hidden: bool = False,
    merged: bool = False,
    quickly: bool = False,
    outside: Container[Procedure] = (),
) -> str:
    """Return the IR of one procedure, without the procedures that it calls.

    A `hidden` procedure is local to its module, so LLVM may inline it into all callers. A `merged` procedure is
    always inlined. A procedure that runs rarely is compiled `quickly`, without optimization. `outside` has the
    procedures that other code, such as C, calls too: they and calls of them need another calling convention.
    """
    printer = Printer(procedure, outside=outside)
    return printer.function("internal " if hidden else "", "alwaysinline " if merged else "", quickly=quickly)


class Printer(Visitor):
    """Prints one procedure as LLVM IR. Statements of a procedure refer to values and variables by ids.

    An operand is a name or constant in IR. `values` maps the id of a value to its operand, and `variables` the id of a
    variable to the operand of its present value. `wide` has the ids of values and variables that are vectors, with one
    entry for each iteration of the `current` block. `outside` has the procedures that other code calls. `e` collects
    the text. `angles` is the number of sines and cosines, or None if they are still to be counted.
    """

    def __init__(
        self,
        procedure: Procedure,
        *,
        outside: Container[Procedure] = (),
        e: Emitter | None = None,
        angles: int | None = None,
    ) -> None:
        self.procedure, self.outside = procedure, outside
        self.foreign = procedure in outside
        self.stores_together = (
            self.foreign and sum(isinstance(statement, form.Store) for statement in procedure.body) <= FEW_RESULTS
        )
        self.e = Emitter() if e is None else e
        self.values: dict[int, str] = {}
        self.kinds: dict[int, Kind] = {}
        self.types: dict[int, Type] = {}
        self.variables: dict[int, str] = {}
        self.wide: dict[int, None] = {}
        self.spread: dict[int, str] = {}
        self.current: IterationBlock | None = None
        self.operations = 0
        self.angles = angles
        """Number of sines and cosines in the procedure, or None before the first of them is printed."""
        self.open = True
        """False if the block that is being printed has already ended with a return."""
        self.memories: list[tuple[str, str, int]] = []
        """Local arrays of the blocks that are being printed: address, LLVM type and size of each."""
        self.free: dict[tuple[str, int], list[str]] = {}
        """Addresses of stack memory that later local arrays may use again, by LLVM type and size."""
        self.together: list[tuple[int, int, str]] = []
        """Delayed stores, which may be joined to a vector store: id of the array, index, and operand of the value."""

    def function(self, linkage: str, merging: str, *, quickly: bool = False) -> str:
        """Return the IR of the procedure. `linkage` and `merging` are LLVM keywords in its first line, or "".

        `linkage` "internal " makes the procedure local to its module. `merging` "alwaysinline " inlines it into its
        callers. A procedure that runs rarely is compiled `quickly`, without optimization.
        """
        parameters = []
        for parameter in self.procedure.parameters:
            kind = parameter.type
            self.define(parameter.ref, f"%{parameter.name}", kind)
            # In inlined code LLVM would add alias metadata to each access, which takes half of the inlining time.
            attributes = " noalias" if isinstance(kind, (Array, Record)) and not merging else ""
            attributes += " readonly" if isinstance(kind, Array) and kind.read else ""
            parameters.append(f"{argument_type(kind)}{attributes} %{parameter.name}")
        self.block(self.procedure.body)
        if self.open:
            self.e.do("ret void")
        results = together(self.result_types())
        merging = "noinline " if self.procedure.noinline else merging
        merging += "#0" if widest(self.procedure.body) > PARTIAL else "#1"
        merging = "#2" if quickly else merging
        linkage += convention(self.procedure.results) if self.foreign else ""
        return self.e.function(f"define {linkage}{results} @{self.procedure.name}({', '.join(parameters)}) {merging}")

    def result_types(self) -> list[str]:
        """Return LLVM's types of the results. In a function that other code calls, flags are C's ints."""
        return [foreign_type(kind) if self.foreign else argument_type(kind) for kind in self.procedure.results]

    # --- definitions of numbers

    def define(self, ref: int, value: str, kind: Type, *, wide: bool = False) -> None:
        """Record operand and type of the value with the id `ref`, a vector over iterations of a loop if `wide`."""
        self.values[ref], self.types[ref] = value, kind
        if isinstance(kind, Kind):
            self.kinds[ref] = kind
        if wide:
            self.wide[ref] = None

    def array(self, ref: int) -> Array:
        """Return the type (length, kind of its entries) of the array with the id `ref`."""
        array_type = self.types[ref]
        assert isinstance(array_type, Array)
        return array_type

    def lanes(self, ref: int) -> int:
        """Return the number of iterations of an `each` loop for which the value or variable `ref` (id) has entries.

        The result is 1 for a single number.
        """
        return self.current.lanes if self.current is not None and ref in self.wide else 1

    def llvm_type(self, ref: int) -> str:
        """Return LLVM's type of the value or variable with the id `ref`."""
        kind = self.types[ref]
        return type_of(*kind) if isinstance(kind, Vector) else type_of(self.kinds[ref], self.lanes(ref))

    def operand(self, ref: int, lanes: int) -> str:
        """Return the operand of the value with the id `ref`, as a vector of `lanes` entries.

        If the value is a single number, all entries are this number.
        """
        if self.current is not None and ref == self.current.each.place:
            return self.current.indices
        if lanes == 1 or ref in self.wide:
            return self.values[ref]
        return self.spread.get(ref) or splat(self.e, self.values[ref], self.kinds[ref], lanes)

    # --- statements

    def block(self, block: Block) -> None:
        """Print the statements of a block, then release the memory of the local arrays that they allocated."""
        before = len(self.memories)
        for statement in block:
            if self.together and not self.passes(statement):
                self.store_together()
            self.statement(statement)
        self.store_together()
        if self.open:
            self.release(before)
        for memory, kind, size in self.memories[before:]:
            if size <= LARGEST_ON_STACK:
                self.free.setdefault((kind, size), []).append(memory)
        del self.memories[before:]

    def release(self, first: int = 0) -> None:
        """Print calls that free the local arrays on the heap, those from index `first` of `memories` on."""
        for memory, _, size in self.memories[first:]:
            if size > LARGEST_ON_STACK:
                self.e.do(f"call void @free(ptr {memory})")

    def reserve(self, array: Array) -> str:
        """Return the address of memory for a local array: on the stack, reused if possible, or on the heap."""
        kind, size = KINDS[array.kind], (array.size or 0) + (array.room if array.room > 1 else 0)
        unused = self.free.get((kind, size))
        if size > LARGEST_ON_STACK:
            memory = self.e.value(f"call ptr @malloc(i64 {8 * size})")
        else:
            memory = unused.pop() if unused else self.e.reserve(kind, size)
        self.memories.append((memory, kind, size))
        return memory

    def passes(self, statement: form.Statement) -> bool:
        """Return True if the delayed stores, all to one array, may stay delayed while a statement is printed.

        The statement must not access this array, or it must be a store to the next entry, which is then delayed, too.
        """
        match statement:
            case form.Let() | form.SineCosine():
                return True
            case form.Load(array=array):
                return self.array(array).read
            case form.Store(array=array, place=place):
                before, last, _ = self.together[-1]
                return array == before and number(self.values[place]) == last + 1
        return False

    def store_together(self) -> None:
        """Print the delayed stores, which are to adjacent entries, as stores of four, two or single numbers."""
        e, stores = self.e, self.together
        self.together = []
        while stores:
            width = next(width for width in (4, 2, 1) if width <= len(stores))
            part, stores = stores[:width], stores[width:]
            total, kind = part[0][2] if width == 1 else "poison", type_of(REAL, width)
            for lane, (_, _, value) in enumerate(part if width > 1 else ()):
                total = e.value(f"insertelement {kind} {total}, double {value}, i64 {lane}")
            e.store(total, e.address(self.values[part[0][0]], part[0][1]), kind)

    @visits(form.Note)
    def note(self, note: form.Note) -> None:
        """Print a note, a text in the procedure for its readers, as comments of IR."""
        self.e.lines += [f"  ; {line}" for line in note.text.splitlines()]

    @visits(form.Reserve)
    def array_of(self, reserve: form.Reserve) -> None:
        """Print the allocation of memory for a local array."""
        self.define(reserve.ref, self.reserve(reserve.array), reserve.array)

    @visits(form.SineCosine)
    def pair(self, pair: form.SineCosine) -> None:
        """Print the computation of the sine and the cosine of one angle."""
        for ref, value in zip((pair.sine, pair.cosine), self.angle(pair.angle), strict=True):
            self.define(ref, value, self.types[pair.angle], wide=self.lanes(pair.angle) > 1)

    @visits(form.ReserveRecord, form.Part)
    def place(self, statement: form.ReserveRecord | form.Part) -> None:
        """Print the allocation of a record with zeros, or the computation of the address of a part of an array."""
        if isinstance(statement, form.ReserveRecord):
            count = len(statement.record.fields) * statement.record.lanes
            self.define(statement.ref, self.e.reserve(numbers := f"[{count} x i64]"), statement.record)
            return self.e.store("zeroinitializer", self.values[statement.ref], numbers)
        held = self.array(statement.array)
        address = self.e.address(self.values[statement.array], self.values[statement.start], KINDS[held.kind])
        return self.define(statement.ref, address, replace(held, size=None))

    @visits(form.Let)
    def let(self, let: form.Let) -> None:
        """Print an operation, on vectors if an operand is a vector."""
        if let.op == form.CONSTANT:
            return self.define(let.ref, constant(let), let.kind)
        self.operations += 1
        if self.foreign and self.current is None and self.operations % OPERATIONS_PER_BLOCK == 0:
            self.e.cut()
        lanes = max(self.lanes(arg) for arg in let.args)
        if let.op in ANGLES:
            return self.define(let.ref, self.angle(*let.args)[ANGLES.index(let.op)], REAL, wide=lanes > 1)
        kinds = tuple(self.kinds[arg] for arg in let.args)
        made = spell(self.e, let.op, kinds, [self.operand(arg, lanes) for arg in let.args], lanes)
        return self.define(let.ref, made, let.kind, wide=lanes > 1)

    @visits(*form.VECTOR_STATEMENTS)
    def on_vectors(self, statement: form.VectorStatement) -> None:
        """Print a statement on vectors that the procedure itself declares, such as a vector load or a gather."""
        match statement:
            case form.VectorStore():
                store(self, statement)
            case form.Scatter():
                scatter(self, statement)
            case form.VectorLet(ref=ref, vector=vector, op=op):
                angle = self.angle(*statement.args)[ANGLES.index(op)] if op in ANGLES else None
                self.define(ref, angle or operation(self, statement), vector)
            case form.Reduce(ref=ref, kind=kind):
                self.define(ref, reduced(self, statement), kind)
            case form.Gather(ref=ref, vector=vector):
                self.define(ref, gathered(self, statement), vector)
            case form.VectorLoad(ref=ref, vector=vector, array=array, place=place):
                where = self.e.address(self.values[array], self.values[place], KINDS[vector.kind])
                self.define(ref, self.e.load(where, type_of(*vector)), vector)

    def angle(self, ref: int) -> tuple[str, str]:
        """Print the sine and cosine of the angle with the id `ref`, in place or as a call, and return both operands."""
        if self.angles is None:
            in_lanes = any(isinstance(parameter.type, Vector) for parameter in self.procedure.parameters)
            self.angles = INLINE_ANGLES + 1 if in_lanes else number_of_angles(self.procedure.body)
        make = sine_and_cosine if self.angles <= INLINE_ANGLES else call_sine_and_cosine
        kind = self.types[ref]
        return make(self.e, self.values[ref], kind.width if isinstance(kind, Vector) else self.lanes(ref))

    @visits(form.Load, form.Store, form.Read, form.Write)
    def memory(self, statement: form.Load | form.Store | form.Read | form.Write) -> None:
        """Print the load or store of an array entry, or of a field of a record."""
        e = self.e
        match statement:
            case form.Load(ref=ref, kind=kind, array=array, place=index):
                lanes = self.lanes(index)
                made = e.load(e.address(self.values[array], self.values[index], KINDS[kind]), type_of(kind, lanes))
                self.define(ref, made, kind, wide=lanes > 1)
            case form.Store():
                self.store(statement)
            case form.Read(ref=ref, kind=kind, record=record, field=field):
                entry = e.load(self.field(record, field), type_of(kind, self.record(record).lanes))
                self.define(ref, entry, self.record(record).type_of(field))
            case form.Write(record=record, field=field, value=value):
                e.store(
                    self.values[value], self.field(record, field), argument_type(self.record(record).type_of(field))
                )

    def record(self, ref: int) -> Record:
        """Return the type of the record with the id `ref`."""
        record_type = self.types[ref]
        assert isinstance(record_type, Record)
        return record_type

    def field(self, ref: int, field: str) -> str:
        """Return the address of the field `field` of the record with the id `ref`."""
        held = self.record(ref)
        return self.e.address(self.values[ref], held.places[field] * held.lanes, KINDS[held.kind(field)])

    def store(self, store: form.Store) -> None:
        """Print the store of numbers to an array. Of a vector, entries after a loop's last iteration are not stored."""
        e, lanes, array = self.e, self.lanes(store.place), self.array(store.array)
        where = number(self.values[store.place]) if lanes == 1 and array.kind is REAL else None
        if self.stores_together and self.current is None and where is not None:
            self.together.append((store.array, where, self.values[store.value]))
            if len(self.together) == MOST_TOGETHER:
                self.store_together()
            return
        address = e.address(self.values[store.array], self.values[store.place], KINDS[array.kind])
        value, kind, current = self.operand(store.value, lanes), type_of(array.kind, lanes), self.current
        count = None if current is None else number(self.values[current.each.iterations])
        if current is None or not current.mask or current.each.spill or (count is not None and array.size == count):
            e.store(value, address, kind)
            return
        e.do(
            f"call void @llvm.masked.store.v{lanes}f64.p0({kind} {value}, ptr {address}, i32 8, "
            f"<{lanes} x i1> {current.mask})"
        )

    @visits(form.Declare, form.Get, form.Set)
    def variable(self, statement: form.VariableStatement) -> None:
        """Print the declaration, read or assignment of a variable. In an `each` loop a variable is a vector."""
        lanes = 1 if self.current is None else self.current.lanes
        match statement:
            case form.Declare(ref=ref, kind=kind, value=value):
                self.define(ref, "", kind, wide=lanes > 1)
                self.variables[ref] = self.operand(value, lanes)
            case form.Get(ref=ref, kind=kind, variable=variable):
                self.define(ref, self.variables[variable], kind, wide=variable in self.wide)
            case form.Set(variable=variable, value=value):
                self.variables[variable] = self.operand(value, lanes)

    @visits(form.Call)
    def call(self, call: form.Call) -> None:
        """Print the call of a procedure or a callback, and record the operands of its results."""
        if isinstance(call.callee, Procedure):
            types = tuple(parameter.type for parameter in call.callee.parameters)
            arguments = [
                f"{argument_type(kind)} {self.values[arg]}" for kind, arg in zip(types, call.args, strict=True)
            ]
            foreign = call.callee in self.outside
            self.called(call, f"@{call.callee.name}({', '.join(arguments)})", call.callee.results, foreign=foreign)
            return
        held = self.types[call.callee]
        assert isinstance(held, form.Callee)
        arguments = [self.callback_argument(kind, arg) for kind, arg in zip(held.parameters, call.args, strict=True)]
        self.called(call, f"{self.values[call.callee]}({', '.join(arguments)})", held.results, foreign=True)

    def callback_argument(self, kind: Kind | Array, arg: int) -> str:
        """Return one argument in the call of a callback as IR: its LLVM type, then its operand.

        `kind` is the type of the callback's parameter, and `arg` the id of the value passed to it.
        """
        if kind is FLAG:
            return f"i32 {self.e.value(f'zext i1 {self.values[arg]} to i32')}"
        return f"{argument_type(kind)} {self.values[arg]}"

    def called(self, call: form.Call, what: str, results: Sequence[Kind | Vector], *, foreign: bool = False) -> None:
        """Print a call, and record the operands of its results.

        `what` is the IR of the callee with its arguments, and `results` are the types of the results. With `foreign`
        the callee is a callback or a function for other code, which returns flags as C's ints.
        """
        e = self.e
        types = [foreign_type(kind) if foreign else argument_type(kind) for kind in results]
        whole = together(types)
        made = f"call {convention(results) if foreign else ''}{whole} {what}"
        if not results:
            e.do(made)
            return
        value = e.value(made)
        for ref, kind, type_name, result in zip(call.refs, results, types, separated(e, types, value), strict=True):
            # Flags of procedures are 0 or 1. By C's convention any nonzero int is true.
            flag = f"trunc i32 {result} to i1" if isinstance(call.callee, Procedure) else f"icmp ne i32 {result}, 0"
            self.define(ref, e.value(flag) if type_name == "i32" else result, kind)

    @visits(form.Leave)
    def leave(self, leave: form.Leave) -> None:
        """Print the return from the procedure with its results, after its local arrays on the heap are freed."""
        self.release()
        pairs = zip(leave.values, self.procedure.results, strict=True)
        values = [
            self.e.value(f"zext i1 {self.values[ref]} to i32") if self.foreign and kind is FLAG else self.values[ref]
            for ref, kind in pairs
        ]
        give(self.e, self.result_types(), values)
        self.open = False

    # --- control

    @visits(form.When, form.Loop, form.Repeat, form.Each)
    def control(self, statement: form.ControlStatement) -> None:
        """Print an if statement or a loop."""
        match statement:
            case form.When():
                self.when(statement)
            case form.Loop(place=index, start=start, stop=stop, step=step, body=body):
                with self.repeated(body, index, self.values[start], step) as name:
                    self.define(index, f"%{name}.i", form.WHOLE)
                    test = self.e.value(f"icmp slt i64 %{name}.i, {self.values[stop]}")
                    self.e.do(f"br i1 {test}, label %{name}.body, label %{name}.end")
            case form.Repeat(test=test_block, condition=condition, body=body):
                with self.repeated((*test_block, *body), None, "", 1, body) as name:
                    self.block(test_block)
                    self.e.do(f"br i1 {self.values[condition]}, label %{name}.body, label %{name}.end")
            case form.Each():
                self.each(statement)

    def when(self, when: form.When) -> None:
        """Print an if statement, with a phi for each variable that has different values after its two branches."""
        e, name, before = self.e, self.e.fresh("if"), dict(self.variables)
        other = f"{name}.else" if when.otherwise else f"{name}.end"
        e.do(f"br i1 {self.values[when.condition]}, label %{name}.then, label %{other}{LIKELY[when.likely]}")
        ways: list[tuple[str, dict[int, str]]] = [] if when.otherwise else [(e.block, before)]
        for label, body in ((f"{name}.then", when.then), (f"{name}.else", when.otherwise)):
            if not body and label != f"{name}.then":
                continue
            e.label(label)
            self.variables, self.open = dict(before), True
            self.block(body)
            if self.open:
                ways.append((e.block, self.variables))
                e.jump(f"{name}.end")
        self.open = bool(ways)
        if not ways:
            return
        e.label(f"{name}.end")
        self.variables = {
            ref: phi(e, self.llvm_type(ref), [(block, held[ref]) for block, held in ways]) for ref in before
        }

    @contextmanager
    def repeated(
        self, inside: Block, index: int | None, start: str, step: int, body: Block | None = None
    ) -> Iterator[str]:
        """Print a loop. The code of the caller's `with` block prints the condition; then this method prints the body.

        Yields the loop's name NAME. The condition must end with a branch to the label NAME.body or NAME.end. `inside`
        has the statements of both condition and body, and `body` those of the body. None means that all statements are
        in the body. `index` is the id of a counter that begins at `start` and grows by `step`, None without a counter.
        """
        e, name = self.e, self.e.fresh("loop")
        variables = dict.fromkeys(s.variable for s in form.walk(inside) if isinstance(s, form.Set))
        carried = [variable for variable in variables if variable in self.variables]
        before, initial = e.block, dict(self.variables)
        e.jump(f"{name}.head")
        e.label(f"{name}.head")
        hole = len(e.lines)
        e.lines += [""] * (len(carried) + 1)
        for k, variable in enumerate(carried):
            self.variables[variable] = f"%{name}.v{k}"
        yield name
        entered = dict(self.variables)
        e.label(f"{name}.body")
        self.block(inside if body is None else body)
        if self.open:
            if index is not None:
                e.do(f"%{name}.next = add nsw i64 %{name}.i, {step}")
            end = e.block
            e.jump(f"{name}.head")
        back = self.open
        if index is not None:
            again = f", [ %{name}.next, %{end} ]" if back else ""
            e.lines[hole] = f"  %{name}.i = phi i64 [ {start}, %{before} ]{again}"
        for k, variable in enumerate(carried):
            again = f", [ {self.variables[variable]}, %{end} ]" if back else ""
            kind = self.llvm_type(variable)
            e.lines[hole + 1 + k] = f"  %{name}.v{k} = phi {kind} [ {initial[variable]}, %{before} ]{again}"
        self.variables, self.open = entered, True
        e.label(f"{name}.end")

    # --- vectors of iterations

    def each(self, each: form.Each) -> None:
        """Print an `each` loop. If its arrays have room for whole vectors, a vector holds several iterations."""
        width = PARTIAL if any(fold.op in form.SUMS for fold in each.folds) else each.width
        whole = base_arrays(each.body)
        through = [
            self.array(whole.get(access.array, access.array))
            for access in accesses(each.body)
            if access.place == each.place
        ]
        room = all(array.kind is REAL and array.room >= width for array in through)
        Lanes(self, each, width if room else 1).run()
