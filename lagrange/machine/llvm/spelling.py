"""LLVM's spelling of programs: their numbers are reals and conditions, in one lane or several."""

from __future__ import annotations

from collections.abc import Sequence

from lagrange.machine.llvm import operations
from lagrange.machine.llvm.emitter import Emitter, literal, suffix
from lagrange.machine.llvm.operations import INTRINSICS, LIBRARY, declaration, type_of
from lagrange.procedure.form import FLAG, REAL
from lagrange.procedure.operations import OPERATIONS
from lagrange.program.program import ARITY

BOOLEAN = frozenset(op for op, signatures in OPERATIONS.items() if signatures[0][1] is FLAG)
"""Operations with a true or false result."""


def number(value: float, lanes: int) -> str:
    """Return a constant as an operand with `lanes` entries."""
    if lanes == 1:
        return literal(value)
    return "<" + ", ".join([f"double {literal(value)}"] * lanes) + ">"


def element(lanes: int) -> str:
    """Return LLVM's type of a real number, or of a vector of them."""
    return type_of(REAL, lanes)


def flag_type(lanes: int) -> str:
    """Return LLVM's type of a condition, or of a vector of them."""
    return type_of(FLAG, lanes)


def intrinsics(lanes: int) -> list[str]:
    """Return the declarations of the LLVM intrinsics for operations in `lanes` lanes."""
    kind = element(lanes)
    return [declaration(f"llvm.{name}.{suffix(kind)}", op, lanes) for op, name in INTRINSICS.items() if op in ARITY]


def library_functions() -> list[str]:
    """Return the declarations of the C library's functions."""
    own = ["declare void @sincos(double, ptr, ptr)", "declare ptr @malloc(i64)", "declare void @free(ptr)"]
    return [*own, *(declaration(LIBRARY[op], op) for op in sorted(LIBRARY))]


def spell(emitter: Emitter, op: str, args: Sequence[str], lanes: int) -> str:
    """Emit one operation, except leaves, library calls and linear systems."""
    return operations.spell(emitter, op, OPERATIONS[op][0][0], args, lanes)
