"""How LLVM spells programs: their numbers are reals and conditions, on one lane or several at once."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.machine.llvm import operations
from lagrange.machine.llvm.emitter import Emitter, literal, suffix
from lagrange.machine.llvm.operations import INTRINSICS, LIBRARY, declaration, type_of
from lagrange.procedure.form import FLAG, REAL
from lagrange.procedure.operations import OPERATIONS
from lagrange.program.program import ARITY

BOOLEAN = frozenset(op for op, signatures in OPERATIONS.items() if signatures[0][1] is FLAG)
"""Operations that give true or false."""


def number(value: float, lanes: int) -> str:
    """Return a constant as an operand of that many lanes."""
    if lanes == 1:
        return literal(value)
    return "<" + ", ".join([f"double {literal(value)}"] * lanes) + ">"


def element(lanes: int) -> str:
    """Return the type of a number."""
    return type_of(REAL, lanes)


def flag_type(lanes: int) -> str:
    """Return the type of a condition."""
    return type_of(FLAG, lanes)


def intrinsics(lanes: int) -> list[str]:
    """Return the declarations of LLVM's own functions that operations on that many lanes become."""
    kind = element(lanes)
    return [declaration(f"llvm.{name}.{suffix(kind)}", op, lanes) for op, name in INTRINSICS.items() if op in ARITY]


def library_functions() -> list[str]:
    """Return the declarations of the C library's functions."""
    own = ["declare void @sincos(double, ptr, ptr)", "declare ptr @malloc(i64)", "declare void @free(ptr)"]
    return [*own, *(declaration(LIBRARY[op], op) for op in sorted(LIBRARY))]


def spell(emitter: Emitter, op: str, args: Sequence[str], lanes: int) -> str:
    """Emit one operation that is neither a leaf, nor a library call, nor of a linear system."""
    return operations.spell(emitter, op, OPERATIONS[op][0][0], args, lanes)
