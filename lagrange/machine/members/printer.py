"""Print a procedure as LLVM IR for many members at once, one in each lane of a vector.

A value that is the same for all members is a number, and any other a vector with one entry per member. A condition that
differs becomes a mask: a branch is entered if some member takes it, and changes nothing for the others. A loop runs
until no member is left in it. The result of a member depends on its own numbers only.
"""

from __future__ import annotations

from lagrange.errors import LagrangeError
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import KINDS, constant, give, separated, spell, splat, together, type_of
from lagrange.machine.llvm.sine_cosine import call_sine_and_cosine, sine_and_cosine
from lagrange.machine.members.control import ALIVE, ControlPrinter
from lagrange.machine.members.memory import HeldMemory, MemberMemory
from lagrange.machine.members.operations import computed
from lagrange.procedure.form import (
    ANGLES,
    CONSTANT,
    FLAG,
    REAL,
    WHOLE,
    Array,
    Block,
    Call,
    Callee,
    Declare,
    Each,
    Get,
    Kind,
    Leave,
    Let,
    Load,
    Loop,
    Note,
    Part,
    Procedure,
    Read,
    Record,
    Repeat,
    Reserve,
    ReserveRecord,
    Set,
    SineCosine,
    Store,
    Type,
    When,
    Write,
)
from lagrange.procedure.spread import Share, Signature, Spreads, signature_of
from lagrange.procedure.visit import Visitor, visits

MASK = "%mask"


class MemberPrinter(Visitor):
    """Prints one procedure for one signature, which says for each argument whether members share it."""

    def __init__(
        self, program: MemberProgram, procedure: Procedure, signature: Signature, e: Emitter | None = None
    ) -> None:
        self.program, self.procedure, self.signature = program, procedure, signature
        self.lanes = program.lanes
        self.spread = program.spreads.of(procedure, signature)
        self.e = Emitter() if e is None else e
        self.memory = MemberMemory(self.e, self.lanes)
        self.values: dict[int, str] = {}
        self.kinds: dict[int, Kind] = {}
        self.types: dict[int, Type] = {}
        self.places: dict[int, HeldMemory] = {}
        self.held: dict[int, str] = {}
        self.levels: dict[int, int] = {}
        self.mask, self.level = MASK, 0
        self.control = ControlPrinter(self)
        self.angles_inline = False
        """True if sines and cosines are written out, False if a function computes them."""
        self.open = True
        """False if the present block has ended with a return or a jump."""

    def function(self) -> str:
        """Return the IR of the procedure."""
        given = [f"{type_of(FLAG, self.lanes)} {MASK}"]
        for parameter, share in zip(self.procedure.parameters, self.signature, strict=True):
            given.append(self.parameter(parameter.ref, parameter.name, parameter.type, share))
        if self.spread.parting:
            self.held[ALIVE] = MASK
            for k, kind in enumerate(self.procedure.results):
                self.kinds[self.result(k)] = kind
                self.held[self.result(k)] = "zeroinitializer"
        self.kinds[ALIVE] = FLAG
        self.block(self.procedure.body)
        if self.open:
            give(
                self.e, self.types_of_results(), [self.held[self.result(k)] for k in range(len(self.procedure.results))]
            )
        name = self.program.name(self.procedure, self.signature)
        attributes = "noinline #0" if self.procedure.apart else "#0"
        return self.e.function(
            f"define internal {together(self.types_of_results())} @{name}({', '.join(given)}) {attributes}"
        )

    def parameter(self, ref: int, name: str, kind: Type, share: Share) -> str:
        """Define a parameter and return its declaration."""
        if isinstance(kind, Callee):
            raise LagrangeError(f"procedure {self.procedure.name} calls a function that is not bound.")
        if isinstance(kind, Kind):
            self.define(ref, f"%{name}", kind)
            return f"{type_of(kind, self.lanes if share.own else 1)} %{name}"
        self.types[ref] = kind
        apart = f"%{name}.places" if share.apart else None
        self.places[ref] = HeldMemory(f"%{name}", share.own, apart)
        attributes = " noalias readonly" if isinstance(kind, Array) and kind.read else " noalias"
        return f"ptr{attributes} %{name}" + (f", {type_of(WHOLE, self.lanes)} {apart}" if apart else "")

    @staticmethod
    def result(place: int) -> int:
        """Return the number of the variable that collects result `place` of members that have left the procedure."""
        return ALIVE - 1 - place

    # --- definitions of numbers

    def define(self, ref: int, value: str, kind: Kind) -> None:
        """Set the operand of a number."""
        self.values[ref], self.kinds[ref] = value, kind

    def differs(self, ref: int) -> bool:
        """Return whether members have different values."""
        return ref < 0 or ref in self.spread.own

    def width(self, ref: int) -> int:
        """Return the number of entries of a value: the lanes, or 1."""
        return self.lanes if self.differs(ref) else 1

    def operand(self, ref: int, lanes: int) -> str:
        """Return the operand of a value with `lanes` entries."""
        value = self.values[ref]
        return splat(self.e, value, self.kinds[ref], lanes) if lanes > self.width(ref) else value

    def array(self, ref: int) -> Array:
        """Return the type of an array."""
        found = self.types[ref]
        assert isinstance(found, Array)
        return found

    # --- statements

    def block(self, block: Block) -> None:
        """Print statements."""
        for statement in block:
            self.statement(statement)

    @visits(Note)
    def note(self, note: Note) -> None:
        """Print a comment."""
        self.e.lines += [f"  ; {line}" for line in note.text.splitlines()]

    @visits(When, Loop, Repeat, Each)
    def branch(self, statement: When | Loop | Repeat | Each) -> None:
        """Print a branch or a loop."""
        self.control.statement(statement)

    @visits(Let)
    def let(self, let: Let) -> None:
        """Print an operation."""
        if let.op == CONSTANT:
            return self.define(let.ref, constant(let), let.kind)
        kinds, lanes = tuple(self.kinds[arg] for arg in let.args), self.width(let.ref)
        args = [self.operand(arg, lanes) for arg in let.args]
        if lanes > 1 and self.angles_inline and let.op in ANGLES:
            return self.define(let.ref, sine_and_cosine(self.e, args[0], lanes)[ANGLES.index(let.op)], let.kind)
        make = computed if lanes > 1 else spell
        return self.define(let.ref, make(self.e, let.op, kinds, args, lanes), let.kind)

    @visits(SineCosine)
    def angle(self, pair: SineCosine) -> None:
        """Print a sine and a cosine of the same angle."""
        lanes = self.width(pair.sine)
        make = sine_and_cosine if self.angles_inline else call_sine_and_cosine
        found = make(self.e, self.operand(pair.angle, lanes), lanes)
        for ref, value in zip((pair.sine, pair.cosine), found, strict=True):
            self.define(ref, value, REAL)

    @visits(Load, Store)
    def entry(self, statement: Load | Store) -> None:
        """Print the read or write of an array."""
        held, kind = self.places[statement.array], self.array(statement.array).kind
        spread = held.apart is not None or self.differs(statement.place)
        where = self.operand(statement.place, self.lanes if spread else 1)
        if isinstance(statement, Load):
            if spread:
                made = self.memory.gather(held, where, kind, self.mask)
            else:
                made = self.memory.load(held, where, kind)
                if not held.own and self.differs(statement.ref):
                    made = splat(self.e, made, kind, self.lanes)
            return self.define(statement.ref, made, kind)
        value = self.operand(statement.value, self.lanes)
        if spread:
            return self.memory.scatter(held, where, value, kind, self.mask)
        if not held.own:
            raise LagrangeError(f"procedure {self.procedure.name}: all members write at one place.")
        return self.memory.store(held, where, value, kind, self.mask_of(held.level))

    @visits(Read, Write)
    def field(self, statement: Read | Write) -> None:
        """Print the read or write of a record."""
        held, record = self.places[statement.record], self.types[statement.record]
        assert isinstance(record, Record)
        place, kind = str(record.places[statement.field]), record.kind(statement.field)
        if isinstance(statement, Read):
            return self.define(statement.ref, self.memory.load(held, place, kind), kind)
        value = self.operand(statement.value, self.lanes)
        return self.memory.store(held, place, value, kind, self.mask_of(held.level))

    def mask_of(self, level: int) -> str | None:
        """Return the mask for writes to memory allocated at a level, or None if all lanes may write it."""
        return None if level == self.level else self.mask

    @visits(Reserve, ReserveRecord, Part)
    def place(self, one: Reserve | ReserveRecord | Part) -> None:
        """Print the address of new memory or of a part of an array."""
        match one:
            case Part(ref=ref, array=array, start=start):
                kind = self.types[ref] = self.array(array)
                spread = self.differs(start) or self.places[array].apart is not None
                where = self.operand(start, self.lanes if spread else 1)
                self.places[ref] = self.memory.part(self.places[array], where, kind.kind, spread=spread)
            case ReserveRecord(ref=ref, record=record):
                count = len(record.fields)
                memory = self.e.reserve("i64", count * self.lanes)
                self.types[ref], self.places[ref] = record, HeldMemory(memory, own=True, level=self.level)
                self.e.store("zeroinitializer", memory, f"[{count * self.lanes} x i64]")
            case Reserve(ref=ref, array=array):
                room = ((array.size or 0) + (array.room if array.room > 1 else 0)) * self.lanes
                memory = self.e.reserve(KINDS[array.kind], room)
                self.types[ref], self.places[ref] = array, HeldMemory(memory, own=True, level=self.level)

    @visits(Declare, Get, Set)
    def variable(self, statement: Declare | Get | Set) -> None:
        """Print the declaration, read or assignment of a variable."""
        match statement:
            case Declare(ref=ref, kind=Kind() as kind, value=value):
                self.kinds[ref], self.levels[ref] = kind, self.level
                self.held[ref] = self.operand(value, self.width(ref))
            case Get(ref=ref, kind=Kind() as kind, variable=variable):
                self.define(ref, self.held[variable], kind)
            case Set(variable=variable, value=value):
                self.assign(variable, self.operand(value, self.width(variable)))

    def assign(self, variable: int, value: str) -> None:
        """Set a variable; masked if more members were active at its declaration than now."""
        if self.differs(variable) and self.levels[variable] != self.level:
            value = self.chosen(self.mask, value, self.held[variable], self.kinds[variable])
        self.held[variable] = value

    def chosen(self, mask: str, value: str, other: str, kind: Kind) -> str:
        """Select `value` for the members of a mask and `other` for the rest."""
        vector = type_of(kind, self.lanes)
        return self.e.value(f"select {type_of(FLAG, self.lanes)} {mask}, {vector} {value}, {vector} {other}")

    # --- calls, and the end

    @visits(Call)
    def call(self, call: Call) -> None:
        """Print a call and define its results."""
        callee = call.callee
        assert isinstance(callee, Procedure)
        signature = signature_of(call, self.spread.own, self.spread.apart)
        name = self.program.name(callee, signature)
        given = [f"{type_of(FLAG, self.lanes)} {self.mask}"]
        given += [self.handed(one.type, arg) for one, arg in zip(callee.parameters, call.args, strict=True)]
        own = self.program.spreads.of(callee, signature).results
        types = [type_of(kind, self.lanes if one else 1) for kind, one in zip(callee.results, own, strict=True)]
        made = f"call {together(types)} @{name}({', '.join(given)})"
        if not types:
            self.e.do(made)
            return
        value = self.e.value(made)
        for ref, kind, found in zip(call.refs, callee.results, separated(self.e, types, value), strict=True):
            self.define(ref, found, kind)

    def handed(self, kind: Type, arg: int) -> str:
        """Return an argument of a call."""
        if isinstance(kind, Kind):
            return f"{type_of(kind, self.width(arg))} {self.values[arg]}"
        held = self.places[arg]
        return f"ptr {held.base}" + (f", {type_of(WHOLE, self.lanes)} {held.apart}" if held.apart else "")

    @visits(Leave)
    def leave(self, leave: Leave) -> None:
        """Print the end of the procedure for active members; it returns if no others are left."""
        parting = self.spread.parting
        values = [
            self.operand(ref, self.lanes if own else 1)
            for ref, own in zip(leave.values, self.spread.results, strict=True)
        ]
        if parting:
            pairs = zip(values, self.procedure.results, strict=True)
            kept = [self.held[self.result(k)] for k in range(len(values))]
            values = [self.chosen(self.mask, v, old, kind) for (v, kind), old in zip(pairs, kept, strict=True)]
        if self.level == 0:
            give(self.e, self.types_of_results(), values)
            self.open = False
            return
        for k, value in enumerate(values):
            self.held[self.result(k)] = value
        self.held[ALIVE] = self.without(self.held[ALIVE], self.mask)
        self.mask = "zeroinitializer"

    def without(self, mask: str, gone: str) -> str:
        """Return the members of a mask that are not in `gone`."""
        flags = type_of(FLAG, self.lanes)
        return self.e.value(f"select {flags} {gone}, {flags} zeroinitializer, {flags} {mask}")

    def both(self, mask: str, other: str) -> str:
        """Return the members in both masks. `other` may be undefined outside of `mask`."""
        flags = type_of(FLAG, self.lanes)
        return self.e.value(f"select {flags} {mask}, {flags} {other}, {flags} zeroinitializer")

    def some(self, mask: str) -> str:
        """Return the flag whether a mask has members."""
        bits = self.e.value(f"bitcast {type_of(FLAG, self.lanes)} {mask} to i{self.lanes}")
        return self.e.value(f"icmp ne i{self.lanes} {bits}, 0")

    def types_of_results(self) -> list[str]:
        """Return LLVM's types of the results."""
        pairs = zip(self.procedure.results, self.spread.results, strict=True)
        return [type_of(kind, self.lanes if own else 1) for kind, own in pairs]


class MemberProgram:
    """Procedures for `lanes` members. Each is printed once for every signature, which says what members share."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.spreads = Spreads()
        self.names: dict[tuple[Procedure, Signature], str] = {}
        self.waiting: list[tuple[Procedure, Signature]] = []

    def name(self, procedure: Procedure, signature: Signature) -> str:
        """Return the name of a function, and queue it for printing."""
        key = procedure, signature
        if key not in self.names:
            self.names[key] = f"{procedure.name}.{len(self.names)}"
            self.waiting.append(key)
        return self.names[key]

    def functions(self) -> list[str]:
        """Return the IR of all queued functions and of their callees."""
        made = []
        while self.waiting:
            procedure, signature = self.waiting.pop()
            made.append(MemberPrinter(self, procedure, signature).function())
        return made
