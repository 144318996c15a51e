"""Print a procedure as LLVM IR.

Variables become values: each block of the form knows which variables it sets, so that phis stand where ways meet. An
`each` takes blocks of four turns at once where its arrays have room for that; short ones are written out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from lagrange.machine.llvm.emitter import Emitter, literal, suffix
from lagrange.procedure.form import (
    CONSTANT,
    FLAG,
    PARTIAL,
    REAL,
    WHOLE,
    Array,
    Block,
    Call,
    Callee,
    Declare,
    Each,
    Fold,
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
    Set,
    Statement,
    Store,
    Type,
    When,
    Write,
    inner,
)

KINDS = {REAL: "double", WHOLE: "i64", FLAG: "i1"}
"""LLVM's type of each kind."""

WIDTHS = (1, 4, 8)
"""How many turns of an `each` may be taken at once."""

WRITTEN_OUT = 2
"""Up to this many blocks an `each` is written out."""

_REALS = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_INTRINSICS = {
    "fma": "fma",
    "min": "minimum",
    "max": "maximum",
    "sqrt": "sqrt",
    "abs": "fabs",
    "copysign": "copysign",
    "round": "rint",
}
_WHOLES = {"add": "add nsw", "sub": "sub nsw", "mul": "mul nsw", "quotient": "sdiv"}
_WHOLE_INTRINSICS = {"min": "smin", "max": "smax"}
_COMPARED = {"less": ("olt", "slt"), "less_equal": ("ole", "sle"), "equal": ("oeq", "eq")}
_LIBRARY = {
    name: {"power": "pow"}.get(name, name)
    for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "log", "sinh", "cosh", "tanh", "power")
}

_CONVERTED = {
    ("real", WHOLE): "sitofp i64 {} to double",
    ("real", FLAG): "uitofp i1 {} to double",
    ("whole", REAL): "fptosi double {} to i64",
    ("whole", FLAG): "zext i1 {} to i64",
}

LIKELY = {True: ", !prof !0", False: ", !prof !1", None: ""}
METADATA = '!0 = !{!"branch_weights", i32 2000, i32 1}\n!1 = !{!"branch_weights", i32 1, i32 2000}\n'
"""What a back end may assume of a condition; modules with conditional weights end with it."""


def module(procedures: Sequence[Procedure], *, inside: Sequence[Procedure] = ()) -> str:
    """Return the IR of procedures and of all that they call; `inside` are not seen from elsewhere."""
    wanted: dict[Procedure, None] = {}
    for procedure in (*inside, *procedures):
        wanted |= dict.fromkeys((*procedure.callees, procedure))
    shown = dict.fromkeys(procedures)
    return "\n".join([declarations(), *(function(one, hidden=one not in shown) for one in wanted), METADATA])


def declarations() -> str:
    """Return the declarations of what procedures call from elsewhere."""
    lines = []
    for lanes in WIDTHS:
        kind = "double" if lanes == 1 else f"<{lanes} x double>"
        if lanes > 1:
            lines.append(f"declare void @llvm.masked.store.v{lanes}f64.p0({kind}, ptr, i32, <{lanes} x i1>)")
        for op, name in _INTRINSICS.items():
            operands = ", ".join([kind] * {"fma": 3, "min": 2, "max": 2, "copysign": 2}.get(op, 1))
            lines.append(f"declare {kind} @llvm.{name}.{suffix(kind)}({operands})")
    lines += [f"declare i64 @llvm.{name}.i64(i64, i64)" for name in _WHOLE_INTRINSICS.values()]
    for op, name in _LIBRARY.items():
        lines.append(f"declare double @{name}({', '.join(['double'] * (2 if op in ('power', 'atan2') else 1))})")
    return "\n".join(lines)


def function(procedure: Procedure, *, hidden: bool = False) -> str:
    """Return the IR of one procedure; a `hidden` one may be merged into its callers."""
    return _Printer(procedure).function("internal " if hidden else "")


def result_type(results: Sequence[Kind]) -> str:
    """Return LLVM's type of some results."""
    kinds = [KINDS[kind] for kind in results]
    return kinds[0] if len(kinds) == 1 else "{" + ", ".join(kinds) + "}" if kinds else "void"


def _argument(kind: Type) -> str:
    return KINDS[kind] if isinstance(kind, Kind) else "ptr"


class _Printer:
    """Prints one procedure: `values` are the operands by number, and `held` the present ones of variables."""

    def __init__(self, procedure: Procedure) -> None:
        self.procedure = procedure
        self.e = Emitter()
        self.values: dict[int, str] = {}
        self.kinds: dict[int, Kind] = {}
        self.arrays: dict[int, Array] = {}
        self.records: dict[int, Record] = {}
        self.callees: dict[int, Callee] = {}
        self.held: dict[int, str] = {}
        self.open = True
        """Whether the present block can be left behind its last statement."""

    def function(self, linkage: str) -> str:
        given = []
        for parameter in self.procedure.parameters:
            kind = parameter.type
            self.values[parameter.ref] = f"%{parameter.name}"
            attributes = ""
            if isinstance(kind, Array):
                self.arrays[parameter.ref] = kind
                attributes = " noalias readonly" if kind.read else " noalias"
            elif isinstance(kind, Record):
                self.records[parameter.ref] = kind
                attributes = " noalias"
            elif isinstance(kind, Callee):
                self.callees[parameter.ref] = kind
            else:
                self.kinds[parameter.ref] = kind
            given.append(f"{_argument(kind)}{attributes} %{parameter.name}")
        self.block(self.procedure.body)
        if self.open:
            self.e.do("ret void")
        results = result_type(self.procedure.results)
        return self.e.function(f"define {linkage}{results} @{self.procedure.name}({', '.join(given)}) nounwind")

    # --- statements

    def block(self, block: Block) -> None:
        for statement in block:
            self.statement(statement)

    def statement(self, statement: Statement) -> None:
        e = self.e
        match statement:
            case Let():
                self.values[statement.ref] = self.let(statement)
                self.kinds[statement.ref] = statement.kind
            case Reserve(ref=ref, array=array):
                room = (array.size or 0) + (array.room if array.room > 1 else 0)
                self.values[ref], self.arrays[ref] = e.reserve(KINDS[array.kind], room), array
            case Part(ref=ref, array=array, start=start):
                self.arrays[ref] = self.arrays[array]
                self.values[ref] = e.address(self.values[array], self.values[start], KINDS[self.arrays[array].kind])
            case Load() | Store() | Read() | Write():
                self.memory(statement)
            case Declare(ref=ref, kind=kind, value=value):
                self.held[ref], self.kinds[ref] = self.values[value], kind
            case Get(ref=ref, kind=kind, variable=variable):
                self.values[ref], self.kinds[ref] = self.held[variable], kind
            case Set(variable=variable, value=value):
                self.held[variable] = self.values[value]
            case Call():
                self.call(statement)
            case Leave(values=values):
                self.leave(values)
            case Note():
                e.lines += [f"  ; {line}" for line in statement.text.splitlines()]
            case When() | Loop() | Repeat() | Each():
                self.control(statement)

    def memory(self, statement: Load | Store | Read | Write) -> None:
        e = self.e
        match statement:
            case Load(ref=ref, kind=kind, array=array, index=index):
                self.values[ref] = e.get(self.values[array], self.values[index], KINDS[kind])
                self.kinds[ref] = kind
            case Store(array=array, index=index, value=value):
                kind = self.arrays[array].kind
                e.put(self.values[value], self.values[array], self.values[index], KINDS[kind])
            case Read(ref=ref, kind=kind, record=record, field=field):
                self.values[ref] = e.get(self.values[record], self.records[record].places[field], KINDS[kind])
                self.kinds[ref] = kind
            case Write(record=record, field=field, value=value):
                held = self.records[record]
                e.put(self.values[value], self.values[record], held.places[field], KINDS[held.kind(field)])

    def let(self, let: Let) -> str:
        if let.op == CONSTANT:
            return _constant(let)
        kinds = tuple(self.kinds[arg] for arg in let.args)
        return spell(self.e, let.op, kinds, [self.values[arg] for arg in let.args])

    def call(self, call: Call) -> None:
        e = self.e
        if isinstance(call.callee, Procedure):
            types = tuple(parameter.type for parameter in call.callee.parameters)
            results, target = call.callee.results, f"@{call.callee.name}"
        else:
            held = self.callees[call.callee]
            types, results, target = held.parameters, held.results, self.values[call.callee]
        given = ", ".join(f"{_argument(kind)} {self.values[arg]}" for kind, arg in zip(types, call.args, strict=True))
        made = f"call {result_type(results)} {target}({given})"
        if not results:
            e.do(made)
            return
        value = e.value(made)
        for i, (ref, kind) in enumerate(zip(call.refs, results, strict=True)):
            picked = value if len(results) == 1 else e.value(f"extractvalue {result_type(results)} {value}, {i}")
            self.values[ref], self.kinds[ref] = picked, kind

    def leave(self, refs: Sequence[int]) -> None:
        e, kind = self.e, result_type(self.procedure.results)
        pairs = [(KINDS[k], self.values[ref]) for k, ref in zip(self.procedure.results, refs, strict=True)]
        if len(pairs) < 2:
            e.do(f"ret {kind} {pairs[0][1]}" if pairs else "ret void")
        else:
            made = "poison"
            for i, (one, value) in enumerate(pairs):
                made = e.value(f"insertvalue {kind} {made}, {one} {value}, {i}")
            e.do(f"ret {kind} {made}")
        self.open = False

    # --- control

    def control(self, statement: When | Loop | Repeat | Each) -> None:
        match statement:
            case When():
                self.when(statement)
            case Loop(index=index, start=start, stop=stop, step=step, body=body):
                self.kinds[index] = WHOLE
                with self.turns(body, index, self.values[start], step) as name:
                    self.values[index] = f"%{name}.i"
                    test = self.e.value(f"icmp slt i64 %{name}.i, {self.values[stop]}")
                    self.e.do(f"br i1 {test}, label %{name}.body, label %{name}.end")
            case Repeat(test=test_block, condition=condition, body=body):
                with self.turns((*test_block, *body), None, "", 1, body) as name:
                    self.block(test_block)
                    self.e.do(f"br i1 {self.values[condition]}, label %{name}.body, label %{name}.end")
            case Each():
                self.each(statement)

    def when(self, when: When) -> None:
        e, name, before = self.e, self.e.fresh("if"), dict(self.held)
        other = f"{name}.else" if when.otherwise else f"{name}.end"
        e.do(f"br i1 {self.values[when.condition]}, label %{name}.then, label %{other}{LIKELY[when.likely]}")
        ways: list[tuple[str, dict[int, str]]] = [] if when.otherwise else [(e.block, before)]
        for label, body in ((f"{name}.then", when.then), (f"{name}.else", when.otherwise)):
            if not body and label != f"{name}.then":
                continue
            e.label(label)
            self.held, self.open = dict(before), True
            self.block(body)
            if self.open:
                ways.append((e.block, self.held))
                e.jump(f"{name}.end")
        self.open = bool(ways)
        if not ways:
            return
        e.label(f"{name}.end")
        self.held = {ref: self.joined(ref, ways) for ref in before}

    def joined(self, variable: int, ways: Sequence[tuple[str, dict[int, str]]]) -> str:
        """Return the value of a variable where ways meet."""
        found = [held[variable] for _, held in ways]
        if all(value == found[0] for value in found):
            return found[0]
        entries = ", ".join(f"[ {held[variable]}, %{label} ]" for label, held in ways)
        return self.e.value(f"phi {KINDS[self.kinds[variable]]} {entries}")

    @contextmanager
    def turns(
        self, inside: Block, index: int | None, start: str, step: int, body: Block | None = None
    ) -> Iterator[str]:
        """Print a loop: what stands in the `with` goes to its head and branches to NAME.body or NAME.end."""
        e, name = self.e, self.e.fresh("loop")
        carried = [variable for variable in assigned(inside) if variable in self.held]
        before, initial = e.block, dict(self.held)
        e.jump(f"{name}.head")
        e.label(f"{name}.head")
        hole = len(e.lines)
        e.lines += [""] * (len(carried) + 1)
        for k, variable in enumerate(carried):
            self.held[variable] = f"%{name}.v{k}"
        yield name
        entered = dict(self.held)
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
            again = f", [ {self.held[variable]}, %{end} ]" if back else ""
            kind = KINDS[self.kinds[variable]]
            e.lines[hole + 1 + k] = f"  %{name}.v{k} = phi {kind} [ {initial[variable]}, %{before} ]{again}"
        self.held, self.open = entered, True
        e.label(f"{name}.end")

    # --- many turns at once

    def each(self, each: Each) -> None:
        """Print an `each` in blocks where every array that it goes through has room for them."""
        width = PARTIAL if each.folds else each.width
        room = all(array.kind is REAL and array.room >= width for array in self.through(each))
        _Lanes(self, each, width if room else 1).run()

    def through(self, each: Each) -> Iterator[Array]:
        for statement in each.body:
            if isinstance(statement, (Load, Store)) and statement.index == each.index:
                yield self.arrays[statement.array]


class _Lanes:
    """Prints an `each` some turns at a time: values inside are vectors, and those from outside are spread out."""

    def __init__(self, printer: _Printer, each: Each, lanes: int) -> None:
        self.printer, self.e, self.each, self.lanes = printer, printer.e, each, lanes
        self.stride = max(lanes, PARTIAL) if each.folds else lanes
        """So many turns are one of the machine's loop: all partial sums have a part in it."""
        self.spread: dict[int, str] = {}
        self.values: dict[int, str] = {}
        self.kinds: dict[int, Kind] = {}

    def type(self, kind: Kind) -> str:
        return KINDS[kind] if self.lanes == 1 else f"<{self.lanes} x {KINDS[kind]}>"

    def run(self) -> None:
        each, count = self.each, self.printer.values[self.each.count]
        for ref in self.outside():
            self.spread[ref] = self.splat(self.printer.values[ref], self.printer.kinds[ref])
        start = [self.splat(literal(0.0 if fold.op == "add" else float("-inf")), REAL) for fold in each.folds]
        sums = [[one] * (self.stride // self.lanes) for one in start]
        if count.startswith("%"):
            self.looped(sums, count)
        elif -(-int(count) // self.stride) <= WRITTEN_OUT:
            self.rest(sums, 0, int(count))
        else:
            whole = int(count) - int(count) % self.stride
            self.looped(sums, str(whole))
            self.rest(sums, whole, int(count))
        for fold, found in zip(each.folds, sums, strict=True):
            self.printer.values[fold.ref] = self.total(fold, found)
            self.printer.kinds[fold.ref] = REAL

    def rest(self, sums: list[list[str]], begin: int, count: int) -> None:
        """Write out the turns from one on."""
        for offset in range(begin, count, self.lanes):
            inside = [k < count - offset for k in range(self.lanes)]
            mask = "" if all(inside) else "<" + ", ".join(f"i1 {str(one).lower()}" for one in inside) + ">"
            self.turn(str(offset), mask)
            self.collect(sums, offset, mask)

    def looped(self, sums: list[list[str]], count: str) -> None:
        """Print turns in a loop of the machine, a stride at once."""
        e = self.e
        flat = [(i, k) for i, found in enumerate(sums) for k in range(len(found))]
        carried = [(self.type(REAL), sums[i][k]) for i, k in flat]
        with e.carry(0, count, carried, self.stride) as loop:
            for (i, k), value in zip(flat, loop.values, strict=True):
                sums[i][k] = value
            for offset in range(0, self.stride, self.lanes):
                mask = self.mask(loop.index, count)
                self.turn(e.value(f"add nsw i64 {loop.index}, {offset}") if offset else loop.index, mask)
                self.collect(sums, offset, mask)
            loop.following = [sums[i][k] for i, k in flat]
        for (i, k), value in zip(flat, loop.values, strict=True):
            sums[i][k] = value

    def mask(self, index: str, count: str) -> str:
        """Return which turns of a block are below a count that is known when the procedure runs."""
        stores = not self.each.spill and any(isinstance(one, Store) for one in self.each.body)
        if self.lanes == 1 or not count.startswith("%") or not (stores or self.each.folds):
            return ""
        kind = f"<{self.lanes} x i64>"
        places = self.e.value(
            f"add nsw {kind} {self.splat(index, WHOLE)}, <{', '.join(f'i64 {k}' for k in range(self.lanes))}>"
        )
        return self.e.value(f"icmp slt {kind} {places}, {self.splat(count, WHOLE)}")

    def outside(self) -> list[int]:
        """Return the numbers of values from outside that turns compute with."""
        made = {one.ref for one in self.each.body if isinstance(one, (Let, Load))}
        used: dict[int, None] = {}
        for one in self.each.body:
            if isinstance(one, Let):
                used |= dict.fromkeys(one.args)
            elif isinstance(one, Store):
                used[one.value] = None
        used |= dict.fromkeys(fold.value for fold in self.each.folds)
        return [ref for ref in used if ref not in made]

    def splat(self, value: str, kind: Kind) -> str:
        if self.lanes == 1:
            return value
        if not value.startswith("%"):
            return "<" + ", ".join([f"{KINDS[kind]} {value}"] * self.lanes) + ">"
        vector = self.type(kind)
        one = self.e.value(f"insertelement {vector} poison, {KINDS[kind]} {value}, i64 0")
        return self.e.value(f"shufflevector {vector} {one}, {vector} poison, <{self.lanes} x i32> zeroinitializer")

    def operand(self, ref: int) -> str:
        return self.values[ref] if ref in self.values else self.spread[ref]

    def kind(self, ref: int) -> Kind:
        return self.kinds[ref] if ref in self.kinds else self.printer.kinds[ref]

    def turn(self, offset: str, mask: str) -> None:
        """Print the statements for the turns from an offset on; those that the mask leaves out store nothing."""
        e, arrays = self.e, self.printer.values
        for one in self.each.body:
            match one:
                case Let(ref=ref, kind=kind, op=op, args=args):
                    self.kinds[ref] = kind
                    if op == CONSTANT:
                        self.values[ref] = self.splat(_constant(one), kind)
                    else:
                        kinds = tuple(self.kind(arg) for arg in args)
                        self.values[ref] = spell(e, op, kinds, [self.operand(arg) for arg in args], self.lanes)
                case Load(ref=ref, kind=kind, array=array, index=index):
                    self.kinds[ref] = kind
                    if index == self.each.index:
                        self.values[ref] = e.load(e.address(arrays[array], offset), self.type(kind))
                    else:
                        self.values[ref] = self.splat(e.get(arrays[array], arrays[index], KINDS[kind]), kind)
                case Store(array=array, value=value):
                    self.store(self.operand(value), self.kind(value), array, offset, mask)

    def store(self, value: str, kind: Kind, array: int, offset: str, mask: str) -> None:
        """Store a block, but for what lies behind the end of the turns inside of the array."""
        e, place = self.e, self.e.address(self.printer.values[array], offset)
        whole = self.printer.arrays[array].size == _number(self.printer.values[self.each.count])
        if not mask or self.each.spill or whole:
            e.store(value, place, self.type(kind))
            return
        kinds = f"{self.type(kind)} {value}, ptr {place}, i32 8, <{self.lanes} x i1> {mask}"
        e.do(f"call void @llvm.masked.store.v{self.lanes}f64.p0({kinds})")

    def collect(self, sums: list[list[str]], begin: int, mask: str) -> None:
        """Add what the turns of a block give; those that the mask leaves out give a neutral number."""
        for fold, found in zip(self.each.folds, sums, strict=True):
            value = self.operand(fold.value)
            if mask:
                other = self.splat(literal(0.0 if fold.op == "add" else float("-inf")), REAL)
                kinds = f"<{self.lanes} x i1> {mask}, {self.type(REAL)} {value}"
                value = self.e.value(f"select {kinds}, {self.type(REAL)} {other}")
            slot = begin // self.lanes % len(found)
            found[slot] = spell(self.e, fold.op, (REAL, REAL), [found[slot], value], self.lanes)

    def total(self, fold: Fold, found: list[str]) -> str:
        """Return the number of all partial sums, in a fixed order."""
        e = self.e
        if self.lanes > 1:
            found = [e.value(f"extractelement {self.type(REAL)} {found[0]}, i64 {k}") for k in range(self.lanes)]
        halves = [spell(e, fold.op, (REAL, REAL), found[k : k + 2]) for k in (0, 2)]
        return spell(e, fold.op, (REAL, REAL), halves)


def _number(value: str) -> int | None:
    """Return a constant whole number, or None for one that is known when the procedure runs."""
    return None if value.startswith("%") else int(value)


def assigned(block: Block) -> list[int]:
    """Return the variables that a block sets, in order."""
    found: dict[int, None] = {}
    for statement in block:
        if isinstance(statement, Set):
            found[statement.variable] = None
        for one in inner(statement):
            found |= dict.fromkeys(assigned(one))
    return list(found)


def _constant(let: Let) -> str:
    if let.kind is REAL:
        return literal(0.0 if let.data is None else float(let.data))
    return str(bool(let.data)).lower() if let.kind is FLAG else str(int(let.data or 0))


def spell(e: Emitter, op: str, kinds: Sequence[Kind], args: Sequence[str], lanes: int = 1) -> str:
    """Print an operation on operands of some kinds, each with that many lanes, and return the result."""
    types = [KINDS[kind] if lanes == 1 else f"<{lanes} x {KINDS[kind]}>" for kind in kinds]
    kind = types[-1]
    typed = ", ".join(f"{one} {arg}" for one, arg in zip(types, args, strict=True))
    real = kinds[-1] is REAL
    if op in ("and", "or"):
        return e.value(f"{op} {kind} {args[0]}, {args[1]}")
    if op == "not":
        every = "true" if lanes == 1 else "<" + ", ".join(["i1 true"] * lanes) + ">"
        return e.value(f"xor {kind} {args[0]}, {every}")
    if op == "select":
        return e.value(f"select {typed}")
    if op == "neg":
        return e.value(f"fneg {kind} {args[0]}" if real else f"sub nsw {kind} 0, {args[0]}")
    if op in _COMPARED:
        return e.value(f"{'fcmp' if real else 'icmp'} {_COMPARED[op][not real]} {kind} {args[0]}, {args[1]}")
    if real and op in _REALS:
        return e.value(f"{_REALS[op]} {kind} {args[0]}, {args[1]}")
    if real and op in _INTRINSICS:
        return e.value(f"call {kind} @llvm.{_INTRINSICS[op]}.{suffix(kind)}({typed})")
    if op in _WHOLES:
        return e.value(f"{_WHOLES[op]} {kind} {args[0]}, {args[1]}")
    if op in _WHOLE_INTRINSICS:
        return e.value(f"call i64 @llvm.{_WHOLE_INTRINSICS[op]}.i64({typed})")
    return _single(e, op, kinds, args, lanes)


def _single(e: Emitter, op: str, kinds: Sequence[Kind], args: Sequence[str], lanes: int) -> str:
    """Print what is done one number at a time."""
    if lanes > 1:
        raise NotImplementedError(f"{op} has no form for several turns at once")
    if (op, kinds[0]) in _CONVERTED:
        return e.value(_CONVERTED[op, kinds[0]].format(args[0]))
    if op in _LIBRARY:
        return e.value(f"call double @{_LIBRARY[op]}({', '.join(f'double {arg}' for arg in args)})")
    return _BITS[op](e, args[0])


def _sign(e: Emitter, x: str) -> str:
    above, below = (e.value(f"fcmp {how} double {x}, {literal(0.0)}") for how in ("ogt", "olt"))
    negative = e.choose(below, literal(-1.0), x)
    return e.choose(above, literal(1.0), negative)


def _two_to(e: Emitter, k: str) -> str:
    biased = e.value(f"add i64 {k}, 1023")
    return e.value(f"bitcast i64 {e.value(f'shl i64 {biased}, 52')} to double")


def _exponent(e: Emitter, x: str) -> str:
    bits = e.value(f"bitcast double {x} to i64")
    biased = e.value(f"and i64 {e.value(f'lshr i64 {bits}, 52')}, 2047")
    return e.value(f"sub i64 {biased}, 1023")


def _mantissa(e: Emitter, x: str) -> str:
    bits = e.value(f"bitcast double {x} to i64")
    kept = e.value(f"or i64 {e.value(f'and i64 {bits}, {2**52 - 1}')}, {1023 << 52}")
    return e.value(f"bitcast i64 {kept} to double")


_BITS = {"sign": _sign, "two_to": _two_to, "exponent": _exponent, "mantissa": _mantissa}
