"""From a program to LLVM IR: `prepare` once per set of parameters, a scalar kernel, and a kernel over columns.

Parameters live in one array: the k given values, then the saved results of the program's hoisted part.

    i32 NAME_prepare(ptr parameters)                       fills in the saved results
    i32 NAME(double t, ptr y, ptr parameters, ptr out)     1 if a matrix is singular, else 0
    NAME_registers                                         the same for small states; see `registers`
    i64 NAME_columns(i64 count, ptr t, ptr INPUT ..., ptr parameters, ptr out)

The last takes `count` columns, a multiple of the lanes, of C-ordered arrays: t[count], every input of the program as
[size][count], out[size][count]; it returns the first column of a block with a singular matrix, or -1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lagrange.machine.kernel import llvm_calling
from lagrange.machine.kernel.llvm_body import Body, shares_angle_function
from lagrange.machine.kernel.llvm_solve_groups import GroupedSolves
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import dense_solver
from lagrange.machine.llvm.operations import declaration
from lagrange.machine.llvm.procedures import declaration as announced
from lagrange.machine.llvm.sine_cosine import angle_function
from lagrange.machine.llvm.spelling import BOOLEAN, intrinsics, library_functions, number, spell
from lagrange.procedure.form import Procedure
from lagrange.procedure.linear.ldl import factor_size
from lagrange.program.program import SYSTEMS, Instruction, Program

FEW_RESULTS = 16
"""Up to this many results of a scalar kernel are stored four or two at a time.

A step loads them four at a time, and a processor forwards a value from a store to a load only if one store has all of
it: that would double the time of a small step.
"""

MANY_ZEROS = 32
"""From this many zero outputs on they are cleared in a loop; LLVM takes long to compile so many stores."""

ZERO = Instruction("constant")

METADATA = '!0 = !{!"branch_weights", i32 2000, i32 1}'
ATTRIBUTES = 'attributes #0 = { nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" }'
QUICKLY = "attributes #1 = { nounwind noinline optnone }"
"""What runs once per set of parameters is compiled quickly, without optimization."""


def solves(program: Program) -> bool:
    """Return whether a program calls the solver of dense systems: a small system does where a pivot is no good."""
    return any(instruction.op in SYSTEMS for instruction in program.instructions)


def scalar_module(program: Program) -> str:
    """Return the IR of `prepare` and of the scalar kernel."""
    return scalar_code(program)[0]


def scalar_code(program: Program) -> tuple[str, tuple[Procedure, ...]]:
    """Return the IR of `prepare` and of the scalar kernel, and what it calls beside the solver of dense systems."""
    grouped = GroupedSolves(Body(program, 1, {}))
    scalar = [_in_registers(grouped), _through_registers(program)] if llvm_calling.hold(program) else [_scalar(grouped)]
    called = tuple(grouped.body.called)
    announcements = [announced(one) for one in called]
    return _module(program, [*announcements, prepare_function(program), *scalar], 1, {}), called


def column_module(program: Program, lanes: int, vector_names: dict[str, str]) -> str:
    """Return the IR of the kernel over columns; `vector_names` maps operations to vector routines of the C library."""
    return _module(program, [_block(program, lanes, vector_names), _columns(program, lanes)], lanes, vector_names)


def _module(program: Program, functions: list[str], lanes: int, vector_names: dict[str, str]) -> str:
    lines = [*intrinsics(lanes), *library_functions()]
    lines += [f"{declaration(name, op, lanes)} #0" for op, name in vector_names.items()]
    lines += [announced(one) for one in dense_solver()] if solves(program) else []
    if shares_angle_function(program):
        functions = [angle_function(lanes), *functions]
    return "\n".join([*lines, "", *functions, METADATA, ATTRIBUTES, QUICKLY, ""])


def prepare_function(program: Program) -> str:
    """Return the IR of the part that runs once per set of parameters."""
    body = Body(program, 1, {})
    body.run(range(program.hoisted))
    e = body.e
    for ref, slot in body.slots.items():
        op, n = program.instructions[ref].op, program.instructions[ref].order
        if op == "factor" and not program.eliminations[ref].written_out:
            for k in range(factor_size(n)):
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
    return e.function(f"define i32 @{program.name}_prepare(ptr noalias %p) #1")


def _scalar(grouped: GroupedSolves) -> str:
    body, program = grouped.body, grouped.body.program
    _run(grouped, {i.place: body.e.get("%y", i.place) for i in program.instructions if i.op == "state"})
    if len(program.outputs) <= FEW_RESULTS:
        _store_together(body.e, [_result(body, ref) for ref in program.outputs])
    else:
        _store_each(body, "")
    body.e.do(f"ret i32 {body.status()}")
    return body.e.function(f"define i32 @{program.name}({_IN_MEMORY}) #0")


_IN_MEMORY = "double %t, ptr noalias %y, ptr noalias readonly %p, ptr noalias %out"


def _in_registers(grouped: GroupedSolves) -> str:
    """Emit the kernel that takes its state in registers and returns its results there."""
    body, program = grouped.body, grouped.body.program
    state = [f"%y{i}" for i in range(program.states)]
    _run(grouped, dict(enumerate(state)))
    llvm_calling.give_back(body.e, [_result(body, ref) for ref in llvm_calling.results(program)], body.status())
    return body.e.function(f"define {llvm_calling.signature(program, state)} #0")


def _through_registers(program: Program) -> str:
    """Emit the kernel in memory as a call of that in registers."""
    e = Emitter()
    state = [e.get("%y", i) for i in range(program.states)]
    returned = llvm_calling.results(program)
    found, status = llvm_calling.call(e, f"@{program.name}_registers", "%t", state, len(returned))
    results, code = iter(found), program.instructions
    _store_together(
        e,
        [
            next(results) if block.name in program.returned else state[code[ref].place]
            for block in program.results
            for ref in program.part(block.name)
        ],
    )
    e.do(f"ret i32 {status}")
    return e.function(f"define i32 @{program.name}({_IN_MEMORY}) #0")


def _run(grouped: GroupedSolves, state: dict[int, str]) -> None:
    """Emit the part that runs every time, at a time %t and a state."""
    body = grouped.body
    for i, one in enumerate(body.program.instructions):
        if one.op == "state":
            body.values[i] = state[one.place]
        elif one.op == "time":
            body.values[i] = "%t"
    grouped.run(range(body.program.hoisted, len(body.program.instructions)))


def _store_each(body: Body, stride: str) -> None:
    """Store the outputs one by one; many that are always zero are cleared in a loop before."""
    program, e = body.program, body.e
    zeros = {k for k, ref in enumerate(program.outputs) if program.instructions[ref] == ZERO}
    if len(zeros) < MANY_ZEROS:
        zeros.clear()
    else:
        with e.loop(0, len(program.outputs)) as i:
            place = e.value(f"mul nsw i64 {stride}, {i}") if stride else i
            e.store("zeroinitializer" if body.lanes > 1 else number(0.0, 1), e.address("%out", place), body.kind)
    for k, ref in enumerate(program.outputs):
        if k in zeros:
            continue
        place = e.value(f"mul nsw i64 {stride}, {k}") if stride and k else str(k)
        e.store(_result(body, ref), e.address("%out", place), body.kind)


def _result(body: Body, ref: int) -> str:
    """Return an output as a number."""
    value = body.ref(ref)
    if body.program.instructions[ref].op not in BOOLEAN:
        return value
    return spell(body.e, "select", [value, number(1.0, body.lanes), number(0.0, body.lanes)], body.lanes)


def _store_together(e: Emitter, values: Sequence[str]) -> None:
    """Store the outputs of a scalar kernel four or two at a time; see `FEW_RESULTS`."""
    for begin, width in _block_widths(len(values)):
        kind, total = f"<{width} x double>", "poison"
        for lane, value in enumerate(values[begin : begin + width]):
            total = e.value(f"insertelement {kind} {total}, double {value}, i64 {lane}")
        e.store(total, e.address("%out", begin), kind)


def _block_widths(length: int) -> Iterator[tuple[int, int]]:
    """Yield (first, width) of the blocks of a vector, then of two and of one entry for the rest."""
    begin = 0
    for width in (llvm_calling.BLOCK, 2, 1):
        while begin + width <= length:
            yield begin, width
            begin += width


def _block(program: Program, lanes: int, vector_names: dict[str, str]) -> str:
    body = Body(program, lanes, vector_names)
    e = body.e
    rows = [(f"%{block.name}", place) for block in program.inputs for place in range(block.size)]
    for i, one in enumerate(program.instructions):
        if one.op == "state":
            base, place = rows[one.place]
            row = e.value(f"mul nsw i64 %stride, {place}") if place else 0
            body.values[i] = e.load(e.address(base, row), body.kind)
        elif one.op == "time":
            body.values[i] = e.load("%t", body.kind)
    GroupedSolves(body).run(range(program.hoisted, len(program.instructions)))
    _store_each(body, "%stride")
    e.do(f"ret i32 {body.status()}")
    given = ", ".join(f"ptr noalias {base}" for base in _bases(program))
    return e.function(
        f"define internal i32 @{program.name}_block({given}, i64 %stride, ptr noalias readonly %p, ptr noalias %out) #0"
    )


def _bases(program: Program) -> list[str]:
    """Return the addresses of what a kernel over columns is given: times and inputs."""
    return ["%t", *(f"%{block.name}" for block in program.inputs)]


def _columns(program: Program, lanes: int) -> str:
    e = Emitter()
    with e.loop(0, "%count", lanes) as i:
        *places, out = [e.address(base, i) for base in (*_bases(program), "%out")]
        inputs = ", ".join(f"ptr {place}" for place in places)
        arguments = f"{inputs}, i64 %count, ptr %p, ptr {out}"
        status = e.value(f"call i32 @{program.name}_block({arguments})")
        bad = e.value(f"icmp ne i32 {status}, 0")
        with e.when(bad):
            e.do(f"ret i64 {i}")
            e.label(e.fresh("never"))
    e.do("ret i64 -1")
    given = ", ".join(f"ptr noalias {base}" for base in (*_bases(program), "%p", "%out"))
    return e.function(f"define i64 @{program.name}_columns(i64 %count, {given}) #0")
