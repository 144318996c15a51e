"""From a program to LLVM IR: `prepare` once per set of parameters, a scalar kernel, and a kernel over columns.

Parameters live in one array: the k given values, then the saved results of the program's hoisted part.

    i32 NAME_prepare(ptr parameters)                       fills in the saved results
    i32 NAME(double t, ptr y, ptr parameters, ptr out)     1 if a matrix is singular, else 0
    i64 NAME_columns(i64 count, ptr t, ptr y, ptr parameters, ptr out)

The last takes `count` columns, a multiple of the lanes, of C-ordered arrays: t[count], y[2n][count],
out[size][count]; it returns the first column of a block with a singular matrix, or -1.
"""

from __future__ import annotations

from lagrange.machine.llvm.emitter import Emitter, literal
from lagrange.machine.llvm.linear_solver import PIVOT, factor_size
from lagrange.machine.llvm.spelling import BOOLEAN, LIBRARY, element, number, spell, truth
from lagrange.program.program import Instruction, Program

UNROLLED = 6
"""Largest matrix whose factorization is written out. Beyond it a loop is as fast and compiles at once."""

C_NAMES = {"power": "pow"}
"""Names of the C library that differ from ours."""

ATTRIBUTES = 'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }'


def saved_slots(program: Program) -> dict[int, int]:
    """Return the position of each saved result behind the given parameters."""
    slots: dict[int, int] = {}
    position = program.parameters
    for ref in program.saved:
        slots[ref] = position
        position += _width(program, ref)
    return slots


def prepared_size(program: Program) -> int:
    """Return the length of the parameter array with the saved results."""
    return program.parameters + sum(_width(program, ref) for ref in program.saved)


def _width(program: Program, ref: int) -> int:
    op, _, n = program.instructions[ref]
    if op == "factor":
        return int(n * (n + 1) // 2 + 1) if n <= UNROLLED else factor_size(int(n))
    return int(n) if op == "solve" else 1


def scalar_module(program: Program) -> str:
    """Return the IR of `prepare` and of the scalar kernel."""
    return _module(program, [_prepare(program), _scalar(program)], 1, {})


def column_module(program: Program, lanes: int, vector_names: dict[str, str]) -> str:
    """Return the IR of the kernel over columns; `vector_names` maps operations to vector routines of the C library."""
    return _module(program, [_block(program, lanes, vector_names), _columns(program, lanes)], lanes, vector_names)


def _module(program: Program, functions: list[str], lanes: int, vector_names: dict[str, str]) -> str:
    kind = element(lanes)
    code = f"v{lanes}f64" if lanes > 1 else "f64"
    names = ("fma", "minimum", "maximum")
    lines = [f"declare {kind} @llvm.{name}.{code}({', '.join([kind] * (3 if name == 'fma' else 2))})" for name in names]
    lines += [f"declare {kind} @llvm.{name}.{code}({kind})" for name in ("sqrt", "fabs")]
    lines.append("declare void @sincos(double, ptr, ptr)")
    for op in sorted(LIBRARY):
        operands = 2 if op in ("power", "atan2") else 1
        lines.append(f"declare double @{C_NAMES.get(op, op)}({', '.join(['double'] * operands)})")
        if op in vector_names:
            lines.append(f"declare {kind} @{vector_names[op]}({', '.join([kind] * operands)}) #0")
    lines += [
        "declare i32 @factor_dense(i64, ptr, ptr)",
        "declare void @solve_factored(i64, ptr, ptr, ptr)",
        "declare i32 @solve_lanes(i64, i64, ptr, ptr, ptr)",
    ]
    return "\n".join([*lines, "", *functions, ATTRIBUTES, ""])


class _Body:
    """Emits a stretch of a program's instructions over `lanes` lanes."""

    def __init__(self, program: Program, lanes: int, vector_names: dict[str, str]) -> None:
        self.program = program
        self.lanes = lanes
        self.kind = element(lanes)
        self.vector_names = vector_names
        self.e = Emitter()
        self.values: dict[int, str] = {}
        self.vectors: dict[int, list[str]] = {}
        self.singular: list[str] = []
        self.slots = saved_slots(program)
        self.by_code = {instruction: i for i, instruction in enumerate(program.instructions)}

    def ref(self, i: int) -> str:
        """Return the value of an instruction, bringing in constants and parameters where they are first read."""
        if i not in self.values:
            op, _, data = self.program.instructions[i]
            if op == "constant":
                return number(data, self.lanes)
            if op == "parameter":
                self.values[i] = self.splat(self.e.get("%p", int(data)))
            else:
                self.restore(i, self.slots[i])
        return self.values[i]

    def vector(self, i: int) -> list[str]:
        """Return the entries of a factor or a solution."""
        if i not in self.vectors:
            self.restore(i, self.slots[i])
        return self.vectors[i]

    def splat(self, scalar: str) -> str:
        if self.lanes == 1:
            return scalar
        one = self.e.value(f"insertelement {self.kind} poison, double {scalar}, i64 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.e.value(f"shufflevector {self.kind} {one}, {self.kind} poison, {zeros}")

    def restore(self, ref: int, slot: int) -> None:
        """Read a result that `prepare` left behind the parameters."""
        op, _, n = self.program.instructions[ref]
        if op == "factor" and n > UNROLLED:
            self.values[ref] = self.e.address("%p", slot)
        elif op in ("factor", "solve"):
            width = _width(self.program, ref)
            self.vectors[ref] = [self.splat(self.e.get("%p", slot + k)) for k in range(width)]
            if op == "factor":
                self.vectors[ref][-1] = self.as_truth(self.vectors[ref][-1])
        else:
            value = self.splat(self.e.get("%p", slot))
            self.values[ref] = self.as_truth(value) if op in BOOLEAN else value

    def as_truth(self, value: str) -> str:
        return self.e.value(f"fcmp une {self.kind} {value}, {number(0.0, self.lanes)}")

    def run(self, refs: range) -> None:
        for i in refs:
            instruction = self.program.instructions[i]
            op = instruction.op
            if op in ("constant", "parameter", "state", "time"):
                continue
            if op == "factor":
                self.factor(i, instruction)
            elif op == "solve":
                self.solve(i, instruction)
            elif op == "component":
                self.values[i] = self.vector(instruction.args[0])[int(instruction.data)]
            elif op in LIBRARY:
                self.values[i] = self.library(i, instruction)
            else:
                self.values[i] = spell(self.e, op, [self.ref(arg) for arg in instruction.args], self.lanes)

    def library(self, i: int, instruction: Instruction) -> str:
        """Call the C library; sine and cosine of one angle together."""
        if i in self.values:
            return self.values[i]
        op, args, _ = instruction
        operands = [self.ref(arg) for arg in args]
        if self.lanes > 1:
            return self.vector_call(op, operands)
        twin = self.by_code.get(Instruction({"sin": "cos", "cos": "sin"}.get(op, ""), args))
        if twin is None:
            typed = ", ".join(f"double {operand}" for operand in operands)
            return self.e.value(f"call double @{C_NAMES.get(op, op)}({typed})")
        pair = [self.e.reserve("double"), self.e.reserve("double")]
        self.e.do(f"call void @sincos(double {operands[0]}, ptr {pair[0]}, ptr {pair[1]})")
        sine, cosine = self.e.load(pair[0]), self.e.load(pair[1])
        self.values[twin] = cosine if op == "sin" else sine
        return sine if op == "sin" else cosine

    def vector_call(self, op: str, operands: list[str]) -> str:
        if op in self.vector_names:
            typed = ", ".join(f"{self.kind} {operand}" for operand in operands)
            return self.e.value(f"call {self.kind} @{self.vector_names[op]}({typed}) #0")
        result = "poison"
        for lane in range(self.lanes):
            picked = [self.e.value(f"extractelement {self.kind} {operand}, i64 {lane}") for operand in operands]
            typed = ", ".join(f"double {one}" for one in picked)
            called = self.e.value(f"call double @{C_NAMES.get(op, op)}({typed})")
            result = self.e.value(f"insertelement {self.kind} {result}, double {called}, i64 {lane}")
        return result

    def entries(self, factor: Instruction) -> dict[tuple[int, int], str]:
        """Return the entries (i, j), i >= j, that are not identically zero."""
        n = int(factor.data)
        found = {}
        for i in range(n):
            for j in range(i + 1):
                arg = factor.args[i * (i + 1) // 2 + j]
                op, _, data = self.program.instructions[arg]
                if op != "constant" or data != 0.0:
                    found[i, j] = self.ref(arg)
        return found

    def factor(self, i: int, instruction: Instruction) -> None:
        n = int(instruction.data)
        if n <= UNROLLED:
            self.vectors[i] = self.factor_unrolled(n, self.entries(instruction))
        elif self.lanes == 1:
            matrix = self.matrix(instruction)
            self.values[i] = self.e.reserve("double", factor_size(n))
            status = self.e.value(f"call i32 @factor_dense(i64 {n}, ptr {matrix}, ptr {self.values[i]})")
            self.singular.append(self.e.value(f"icmp ne i32 {status}, 0"))

    def matrix(self, factor: Instruction) -> str:
        """Write the lower triangle to memory, by columns, lanes innermost, and return its address."""
        n = int(factor.data)
        entries = self.entries(factor)
        memory = self.e.reserve(self.kind, n * n)
        for j in range(n):
            for i in range(j, n):
                self.e.put(entries.get((i, j), number(0.0, self.lanes)), memory, j * n + i, self.kind)
        return memory

    def factor_unrolled(self, n: int, a: dict[tuple[int, int], str]) -> list[str]:
        """Return L by rows with 1/d on its diagonal, then whether every pivot can be trusted."""
        e, kind = self.e, self.kind
        lower: dict[tuple[int, int], str] = {}
        scaled: dict[tuple[int, int], str] = {}
        trusted = ""
        for j in range(n):
            for i in range(j, n):
                value = a.get((i, j))
                for k in range(j):
                    if (i, k) in scaled and (j, k) in lower:
                        minus = e.value(f"fneg {kind} {scaled[i, k]}")
                        value = (
                            e.value(f"fmul {kind} {minus}, {lower[j, k]}")
                            if value is None
                            else e.fma(minus, lower[j, k], value, kind)
                        )
                if value is not None:
                    scaled[i, j] = value
            diagonal = scaled.get((j, j), number(0.0, self.lanes))
            size = e.fabs(a.get((j, j), number(0.0, self.lanes)), kind)
            least = e.value(f"fmul {kind} {size}, {number(PIVOT, self.lanes)}")
            good = e.value(f"fcmp ogt {kind} {diagonal}, {least}")
            trusted = e.value(f"and {truth(self.lanes)} {trusted}, {good}") if trusted else good
            lower[j, j] = e.value(f"fdiv {kind} {number(1.0, self.lanes)}, {diagonal}")
            for i in range(j + 1, n):
                if (i, j) in scaled:
                    lower[i, j] = e.value(f"fmul {kind} {scaled[i, j]}, {lower[j, j]}")
        rows = [lower.get((i, j), "") for i in range(n) for j in range(i + 1)]
        return [*(entry or number(0.0, self.lanes) for entry in rows), trusted]

    def solve(self, i: int, instruction: Instruction) -> None:
        factor = self.program.instructions[instruction.args[0]]
        n = int(instruction.data)
        right = [self.ref(arg) for arg in instruction.args[1:]]
        if n <= UNROLLED:
            self.vectors[i] = self.solve_unrolled(factor, self.vector(instruction.args[0]), right)
            return
        memory = self.e.reserve(self.kind, n)
        for k, value in enumerate(right):
            self.e.put(value, memory, k, self.kind)
        if self.lanes == 1:
            spare = self.e.reserve("double", n)
            factors = self.ref(instruction.args[0])
            self.e.do(f"call void @solve_factored(i64 {n}, ptr {factors}, ptr {memory}, ptr {spare})")
        else:
            self.singular.append(self.solve_lanes(n, self.matrix(factor), memory))
        self.vectors[i] = [self.e.get(memory, k, self.kind) for k in range(n)]

    def solve_lanes(self, n: int, matrix: str, right: str) -> str:
        work = self.e.reserve("double", n * n + 2 * n + factor_size(n))
        arguments = f"i64 {n}, i64 {self.lanes}, ptr {matrix}, ptr {right}, ptr {work}"
        return self.e.value(f"icmp ne i32 {self.e.value(f'call i32 @solve_lanes({arguments})')}, 0")

    def solve_unrolled(self, factor: Instruction, factors: list[str], right: list[str]) -> list[str]:
        e, kind, n = self.e, self.kind, len(right)
        *rows, trusted = factors
        zero = number(0.0, self.lanes)

        def lower(i: int, j: int) -> str:
            return rows[i * (i + 1) // 2 + j]

        def less(value: str, entry: str, other: str) -> str:
            return value if entry == zero else e.fma(e.value(f"fneg {kind} {entry}"), other, value, kind)

        x = list(right)
        for i in range(n):
            for k in range(i):
                x[i] = less(x[i], lower(i, k), x[k])
        for i in reversed(range(n)):
            x[i] = e.value(f"fmul {kind} {x[i]}, {lower(i, i)}")
            for k in range(i + 1, n):
                x[i] = less(x[i], lower(k, i), x[k])
        return self.with_pivoting(factor, trusted, x, right)

    def with_pivoting(self, factor: Instruction, trusted: str, x: list[str], right: list[str]) -> list[str]:
        """Return x where all pivots could be trusted, else the solution with pivoting."""
        e, kind, n = self.e, self.kind, len(right)
        name = e.fresh("pivot")
        every = trusted
        if self.lanes > 1:
            bits = e.value(f"bitcast {truth(self.lanes)} {trusted} to i{self.lanes}")
            every = e.value(f"icmp eq i{self.lanes} {bits}, -1")
        before = e.block
        e.do(f"br i1 {every}, label %{name}.join, label %{name}.cold, !prof !0")
        e.label(f"{name}.cold")
        known = dict(self.values)  # what the cold path brings in does not reach the other path
        matrix, memory = self.matrix(factor), e.reserve(kind, n)
        for k, value in enumerate(right):
            e.put(value, memory, k, kind)
        singular = self.solve_lanes(n, matrix, memory)
        slow = [e.get(memory, k, kind) for k in range(n)]
        self.values = known
        cold = e.block
        e.jump(f"{name}.join")
        e.label(f"{name}.join")
        bad = e.value(f"phi i1 [ false, %{before} ], [ {singular}, %{cold} ]")
        self.singular.append(bad)
        return [e.value(f"phi {kind} [ {a}, %{before} ], [ {b}, %{cold} ]") for a, b in zip(x, slow, strict=True)]

    def status(self) -> str:
        """Return 1 if any matrix was singular."""
        if not self.singular:
            return "0"
        total = self.singular[0]
        for other in self.singular[1:]:
            total = self.e.value(f"or i1 {total}, {other}")
        return self.e.value(f"zext i1 {total} to i32")


def _prepare(program: Program) -> str:
    body = _Body(program, 1, {})
    body.run(range(program.hoisted))
    e = body.e
    for ref, slot in body.slots.items():
        op, _, n = program.instructions[ref]
        if op == "factor" and n > UNROLLED:
            for k in range(factor_size(int(n))):
                e.put(e.get(body.values[ref], k), "%p", slot + k)
        elif op in ("factor", "solve"):
            entries = list(body.vectors[ref])
            if op == "factor":
                entries[-1] = e.value(f"uitofp i1 {entries[-1]} to double")
            for k, entry in enumerate(entries):
                e.put(entry, "%p", slot + k)
        else:
            value = body.values[ref]
            e.put(e.value(f"uitofp i1 {value} to double") if op in BOOLEAN else value, "%p", slot)
    e.do(f"ret i32 {body.status()}")
    return e.function(f"define i32 @{program.name}_prepare(ptr noalias %p) #0")


def _scalar(program: Program) -> str:
    body = _Body(program, 1, {})
    e = body.e
    for i, (op, _, data) in enumerate(program.instructions):
        if op == "state":
            body.values[i] = e.get("%y", int(data))
        elif op == "time":
            body.values[i] = "%t"
    _finish(body)
    signature = f"define i32 @{program.name}(double %t, ptr noalias %y, ptr noalias readonly %p, ptr noalias %out) #0"
    return e.function(signature) + "!0 = !{!\"branch_weights\", i32 2000, i32 1}\n"


def _finish(body: _Body, stride: str = "") -> None:
    """Emit the part that runs every time, and store the outputs, one behind the other or a stride apart."""
    program, e = body.program, body.e
    body.run(range(program.hoisted, len(program.instructions)))
    for k, ref in enumerate(program.outputs):
        place = e.value(f"mul nsw i64 {stride}, {k}") if stride and k else k
        op = program.instructions[ref].op
        value = body.ref(ref)
        if op in BOOLEAN:
            value = spell(e, "select", [value, number(1.0, body.lanes), number(0.0, body.lanes)], body.lanes)
        e.store(value, e.address("%out", place), body.kind)
    e.do(f"ret i32 {body.status()}")


def _block(program: Program, lanes: int, vector_names: dict[str, str]) -> str:
    body = _Body(program, lanes, vector_names)
    e = body.e
    for i, (op, _, data) in enumerate(program.instructions):
        if op == "state":
            row = e.value(f"mul nsw i64 %stride, {int(data)}") if data else 0
            body.values[i] = e.load(e.address("%y", row), body.kind)
        elif op == "time":
            body.values[i] = e.load("%t", body.kind)
    _finish(body, "%stride")
    signature = (
        f"define internal i32 @{program.name}_block(ptr noalias %t, ptr noalias %y, i64 %stride, "
        "ptr noalias readonly %p, ptr noalias %out) #0"
    )
    return e.function(signature) + "!0 = !{!\"branch_weights\", i32 2000, i32 1}\n"


def _columns(program: Program, lanes: int) -> str:
    e = Emitter()
    with e.loop(0, "%count", lanes) as i:
        places = [e.address(base, i) for base in ("%t", "%y", "%out")]
        arguments = f"ptr {places[0]}, ptr {places[1]}, i64 %count, ptr %p, ptr {places[2]}"
        status = e.value(f"call i32 @{program.name}_block({arguments})")
        bad = e.value(f"icmp ne i32 {status}, 0")
        with e.when(bad):
            e.do(f"ret i64 {i}")
            e.label(e.fresh("never"))
    e.do("ret i64 -1")
    return e.function(
        f"define i64 @{program.name}_columns(i64 %count, ptr noalias %t, ptr noalias %y, ptr noalias %p, "
        "ptr noalias %out) #0"
    )
