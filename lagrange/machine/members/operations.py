"""LLVM's spelling of operations on vectors with one number for each member."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.engine import lanes as widest
from lagrange.machine.llvm.engine import vector_routines
from lagrange.machine.llvm.operations import LIBRARY, spell, splat, type_of
from lagrange.machine.llvm.sine_cosine import call_sine_and_cosine
from lagrange.procedure.form import ANGLES, FLAG, REAL, WHOLE, Kind


def computed(e: Emitter, op: str, kinds: Sequence[Kind], args: Sequence[str], lanes: int) -> str:
    """Print an operation on vectors with one number for each member."""
    if op in ANGLES:
        return call_sine_and_cosine(e, args[0], lanes)[ANGLES.index(op)]
    if op in LIBRARY:
        return _by_library(e, op, args, lanes)
    if op == "quotient":
        # An inactive member may have a zero divisor here, which would stop the process.
        args = [args[0], _not_zero(e, args[1], lanes)]
    return spell(e, op, kinds, args, lanes)


def _not_zero(e: Emitter, divisor: str, lanes: int) -> str:
    kind, zero, one = type_of(WHOLE, lanes), splat(e, "0", WHOLE, lanes), splat(e, "1", WHOLE, lanes)
    test = e.value(f"icmp eq {kind} {divisor}, {zero}")
    return e.value(f"select {type_of(FLAG, lanes)} {test}, {kind} {one}, {kind} {divisor}")


def routine(op: str, lanes: int) -> str | None:
    """Return the C library's vector routine of an operation for `lanes` numbers, or None if it has none."""
    return vector_routines().get(op) if lanes == widest() else None


def _by_library(e: Emitter, op: str, args: Sequence[str], lanes: int) -> str:
    """Call the vector routine of the C library, or its scalar function for each member."""
    kind, name = type_of(REAL, lanes), routine(op, lanes)
    if name is not None:
        return e.value(f"call {kind} @{name}({', '.join(f'{kind} {arg}' for arg in args)})")
    made = "poison"
    for lane in range(lanes):
        ones = [e.value(f"extractelement {kind} {arg}, i64 {lane}") for arg in args]
        found = e.value(f"call double @{LIBRARY[op]}({', '.join(f'double {one}' for one in ones)})")
        made = e.value(f"insertelement {kind} {made}, double {found}, i64 {lane}")
    return made


def declarations(lanes: int) -> str:
    """Return declarations that procedures for `lanes` members need besides those of all procedures."""
    lines = []
    for kind in (REAL, WHOLE):
        vector, mask = type_of(kind, lanes), type_of(FLAG, lanes)
        tail = f"v{lanes}{'f64' if kind is REAL else 'i64'}"
        lines.append(f"declare {vector} @llvm.masked.gather.{tail}.v{lanes}p0(<{lanes} x ptr>, i32, {mask}, {vector})")
        lines.append(f"declare void @llvm.masked.scatter.{tail}.v{lanes}p0({vector}, <{lanes} x ptr>, i32, {mask})")
    real = type_of(REAL, lanes)
    for op in LIBRARY:
        name = routine(op, lanes)
        if name is not None:
            lines.append(f"declare {real} @{name}({', '.join([real] * (2 if op in ('power', 'atan2') else 1))})")
    return "\n".join(lines)


_ARITHMETIC = ("add", "sub", "mul", "neg", "abs", "min", "max", "fma", "fnma", "copysign", "sign", "magnitude", "real")
CHEAP = frozenset((*_ARITHMETIC, "less", "less_equal", "equal", "and", "or", "not", "select"))
"""Operations that cost less than a branch; none has side effects."""
