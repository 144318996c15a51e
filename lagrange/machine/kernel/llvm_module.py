"""From a program to LLVM IR: a procedure `prepare`, a kernel for one state, and a kernel for many states.

Parameters are one array: the k stated values, followed by all values that depend on them alone. `prepare` computes the
latter once for each set of parameters.

    i32 NAME_prepare(ptr parameters)                       writes the values after the parameters
    i32 NAME(double t, ptr y, ptr parameters, ptr out)     1 if a matrix is singular, else 0
    {double, ..., i32} NAME_registers(double t, double y0, ..., ptr parameters)
    i64 NAME_columns(i64 count, ptr t, ptr INPUT ..., ptr parameters, ptr out)

Kernels of small models have the third function, for steps, which pass a state from one call to the next. A state passed
through memory costs some ten cycles each way, as long as the call itself, because a block of coordinates and velocities
waits for the slowest of its entries. A right-hand side returns only the accelerations, `Program.returned`.

The last function takes C-ordered arrays with one column for each of `count` states, a multiple of the lanes: t[count],
each input of the program as [size][count], out[size][count]. It returns -1, or the first column of the block of lanes
that contains a singular matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from lagrange.algorithm.kernel.body import Style
from lagrange.algorithm.kernel.kernels import cleared_outputs, kernel, kernel_by_value, kernel_through_values, prepare
from lagrange.algorithm.kernel.prepared import PreparedLayout
from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.iterations import number_of_angles
from lagrange.machine.llvm.operations import splat
from lagrange.machine.llvm.procedures import Printer, declaration, function, joined
from lagrange.procedure.form import FLAG, Kind, Leave, Procedure
from lagrange.procedure.lanes import MemberProcedures
from lagrange.procedure.spread import COMMON, OWN
from lagrange.program.elimination import LARGEST_IN_LINE
from lagrange.program.program import SYSTEMS, Program

STORED_TOGETHER = 4
"""Number of doubles that kernels and steps load and store at once."""

MOST_IN_REGISTERS = 8
"""Largest number of entries of a state, and of results, that are passed in registers."""

SCALAR = Style(largest=LARGEST_IN_LINE, substituted=1_000_000, systems=32, entries=32, side_by_side=True, early=False)
"""Treatment of linear systems for one state. Systems that are written out share one test of pivots, at which all their
entries are live. Systems in memory need four vectors of eight reals for each row.
"""

LANES = Style(substituted=4_000, systems=1, pivoting=False)
"""Treatment of linear systems with one column in each lane. Matrices of up to 20 unknowns are eliminated in lanes. A
column that needs pivoting is evaluated again alone.
"""


def fit(dimension: int) -> bool:
    """Return True if states with `dimension` entries are small enough to be passed in registers."""
    return dimension <= MOST_IN_REGISTERS


def in_registers(program: Program) -> bool:
    """Return True if a program has a kernel that takes its state in registers.

    This is so if steps of methods call the program, and its state is small.
    """
    return bool(program.returned) and fit(program.states)


def solves(program: Program) -> bool:
    """Return True if a program has linear systems, so that its code may call the solver of dense systems.

    The code of a small system calls this solver only if a pivot is too small.
    """
    return any(instruction.op in SYSTEMS for instruction in program.instructions)


@dataclass(frozen=True, eq=False)
class KernelCode:
    """The procedures of a program, and their LLVM IR."""

    program: Program

    @cached_property
    def prepared(self) -> PreparedLayout:
        """The layout of the values that depend on parameters alone, which are saved after the parameters."""
        return PreparedLayout.of([self.program], LARGEST_IN_LINE)

    @cached_property
    def prepare(self) -> Procedure:
        """The procedure that computes the values that depend on parameters alone."""
        about = f"Prepare {self.program.name}."
        return prepare(self.prepared, about, name=f"{self.program.name}_prepare", in_place=True, style=SCALAR)

    @cached_property
    def scalar(self) -> tuple[Procedure, ...]:
        """The procedures that evaluate the program at one state.

        If the program has a kernel that takes the state in registers, this kernel comes first.
        """
        program, prepared = self.program, self.prepared
        if not in_registers(program):
            return (kernel(program, prepared, program.name, f"Evaluate {program.name}.", style=SCALAR),)
        outputs = [
            ref for block in program.results if block.name in program.returned for ref in program.part(block.name)
        ]
        by_value = kernel_by_value(program, prepared, outputs, style=SCALAR, suffix="registers")
        return by_value, kernel_through_values(program, prepared, by_value)

    @property
    def called(self) -> tuple[Procedure, ...]:
        """The procedures that the kernels call and that other modules define."""
        every = (callee for caller in (self.prepare, *self.scalar) for callee in caller.callees)
        return tuple(dict.fromkeys(procedure for procedure in every if procedure not in self.scalar))

    def scalar_module(self) -> str:
        """Return the IR of `prepare`, and of the kernels for one state."""
        made = [function(procedure, outside=self.scalar) for procedure in self.scalar]
        first = function(self.prepare, outside=(self.prepare,), quickly=True)
        return joined([first, *made], [declaration(procedure) for procedure in self.called])

    def column_module(self, lanes: int) -> str:
        """Return the IR of the kernel for many states, with `lanes` states in a vector."""
        quickly, by_value = lanes > 1, self._in_lanes(lanes) if lanes > 1 else None
        alone = [function(procedure, hidden=True, outside=self.scalar, quickly=quickly) for procedure in self.scalar]
        called = [] if by_value is None else [function(procedure, hidden=True) for procedure in by_value.callees]
        made = [*alone, *called, self._alone(), self._columns(lanes, by_value)]
        return joined(made, [declaration(procedure) for procedure in self.called])

    @cached_property
    def _places(self) -> list[int]:
        """Indices of the outputs that the kernel for many states computes. All other outputs are zero."""
        cleared = cleared_outputs(self.program)
        return [k for k in range(len(self.program.outputs)) if k not in cleared]

    def _in_lanes(self, lanes: int) -> Procedure:
        """Return the kernel for `lanes` states at once, whose arguments and results are vectors."""
        outputs = [self.program.outputs[k] for k in self._places]
        by_value = kernel_by_value(self.program, self.prepared, outputs, style=LANES)
        signature = tuple(OWN if isinstance(parameter.type, Kind) else COMMON for parameter in by_value.parameters)
        return MemberProcedures(lanes).of(by_value, signature)

    @property
    def _bases(self) -> list[str]:
        """The names of the pointer arguments of the kernel for many states: times, and one for each input."""
        return ["%t", *(f"%{block.name}" for block in self.program.inputs)]

    def _alone(self) -> str:
        """Return the IR of a function that evaluates one state, given by its column in the arrays of many."""
        e, name, program = Emitter(), self.program.name, self.program
        state, out = e.reserve("double", program.states), e.reserve("double", len(program.outputs))
        first = 0
        for block in program.inputs:
            with e.loop(0, block.size) as k:
                e.put(e.get(f"%{block.name}", _at(e, k)), state, e.value(f"add nsw i64 {k}, {first}") if first else k)
            first += block.size
        t = e.get("%t", "%column")
        status = e.value(f"call i32 @{name}(double {t}, ptr {state}, ptr %p, ptr {out})")
        with e.loop(0, len(program.outputs)) as k:
            e.put(e.get(out, k), "%out", _at(e, k))
        e.do(f"ret i32 {status}")
        arguments = ", ".join(f"ptr noalias {base}" for base in (*self._bases, "%p", "%out"))
        return e.function(f"define internal i32 @{name}_alone(i64 %count, i64 %column, {arguments}) noinline #1")

    def _columns(self, lanes: int, by_value: Procedure | None) -> str:
        e, name = Emitter(), self.program.name
        arguments = ", ".join(f"ptr {base}" for base in (*self._bases, "%p", "%out"))
        if by_value is not None and len(self._places) < len(self.program.outputs):
            with e.loop(0, e.value(f"mul nsw i64 %count, {len(self.program.outputs)}")) as k:
                e.put("0.0", "%out", k)
        with e.loop(0, "%count", lanes) as i:
            if by_value is None:
                _leave_if(e, e.value(f"call i32 @{name}_alone(i64 %count, i64 {i}, {arguments})"), i)
            else:
                self._block(e, i, lanes, arguments, by_value)
        e.do("ret i64 -1")
        return e.function(f"define i64 @{name}_columns(i64 %count, {arguments.replace('ptr', 'ptr noalias')}) #0")

    def _block(self, e: Emitter, i: str, lanes: int, arguments: str, by_value: Procedure) -> None:
        """Emit the evaluation of `lanes` states from the state with index `i` on.

        `arguments` are those of the kernel as IR, and `by_value` is its procedure. States whose matrix needs
        pivoting are evaluated again one by one.
        """
        program = self.program
        kind = f"<{lanes} x double>"
        rows = [(f"%{block.name}", row) for block in program.inputs for row in range(block.size)]
        times = e.load(e.address("%t", i), kind)
        state = [e.load(e.address(base, _row(e, row, i)), kind) for base, row in rows]
        *results, bad = _spliced(e, by_value, lanes, [splat(e, "true", FLAG, lanes), times, *state, "%p"])
        for row, value in zip(self._places, results, strict=True):
            e.store(value, e.address("%out", _row(e, row, i)), kind)
        if not bad.startswith("%"):
            return
        bits = e.value(f"bitcast <{lanes} x i1> {bad} to i{lanes}")
        with e.when(e.value(f"icmp ne i{lanes} {bits}, 0")), e.loop(0, lanes) as lane:
            picked = e.value(f"extractelement <{lanes} x i1> {bad}, i64 {lane}")
            with e.when(picked):
                column = e.value(f"add nsw i64 {i}, {lane}")
                _leave_if(e, e.value(f"call i32 @{program.name}_alone(i64 %count, i64 {column}, {arguments})"), i)


def _spliced(e: Emitter, procedure: Procedure, lanes: int, arguments: Sequence[str]) -> list[str]:
    """Print the statements of a procedure into another function, and return its results as vectors.

    The procedure computes `lanes` states at once, and `arguments` are the operands of its parameters. It must have a
    single return, at its end.
    """
    printer = Printer(procedure, e=e, angles=number_of_angles(procedure.body))
    for parameter, argument in zip(procedure.parameters, arguments, strict=True):
        printer.define(parameter.ref, argument, parameter.type)
    *statements, end = procedure.body
    assert isinstance(end, Leave)
    printer.block(tuple(statements))
    pairs = zip(end.values, procedure.results, strict=True)
    return [
        splat(e, printer.values[ref], kind, lanes) if isinstance(kind, Kind) else printer.values[ref]
        for ref, kind in pairs
    ]


def _leave_if(e: Emitter, status: str, column: str) -> None:
    """Emit an early return of `column` from a kernel for many states, taken if `status` reports a singular matrix."""
    with e.when(e.value(f"icmp ne i32 {status}, 0")):
        e.do(f"ret i64 {column}")
        e.label(e.fresh("never"))


def _row(e: Emitter, row: int, column: str) -> str:
    """Return the index of the entry (row, column) in a C-ordered array with one column for each state."""
    return e.value(f"add nsw i64 {e.value(f'mul nsw i64 %count, {row}')}, {column}") if row else column


def _at(e: Emitter, k: str) -> str:
    """Return the index of entry `k` of the state `%column` in an array with one column for each state."""
    return e.value(f"add nsw i64 {e.value(f'mul nsw i64 %count, {k}')}, %column")
