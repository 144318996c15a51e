"""Vector registers of this processor: their width, and the functions of its C library on vectors."""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Sequence
from functools import cache

import llvmlite.binding as llvm

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import LIBRARY, declaration, type_of
from lagrange.procedure.form import REAL
from lagrange.program.program import ARITY

ROUTINES = "_ZGV"
"""Beginning of the names of vector routines in glibc."""


@cache
def start() -> None:
    """Set up LLVM for this process: its target and the library of mathematical functions."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    mathematics = ctypes.util.find_library("m")
    if mathematics is not None:
        llvm.load_library_permanently(mathematics)


@cache
def lanes() -> int:
    """Return the number of doubles in a vector register of this processor."""
    features = llvm.get_host_cpu_features()
    return 8 if features.get("avx512f") else 4 if features.get("avx2") else 2


@cache
def processor() -> str:
    """Return the processor's name in LLVM and the number of doubles in its vectors, as text."""
    return f"{llvm.get_host_cpu_name()} with vectors of {lanes()}"


@cache
def vector_routines() -> dict[str, str]:
    """Return {operation: name of its vector routine in glibc (libmvec)} for the vector width of this processor.

    It is empty if the library is missing.
    """
    start()
    try:
        routines = ctypes.CDLL("libmvec.so.1")
    except OSError:
        return {}
    llvm.load_library_permanently("libmvec.so.1")
    prefix = ROUTINES + {8: "eN8", 4: "dN4", 2: "bN2"}[lanes()]
    names = {op: f"{prefix}{'v' * (ARITY[op] or 0)}_{LIBRARY[op]}" for op in sorted(LIBRARY)}
    return {op: name for op, name in names.items() if hasattr(routines, name)}


def call_library(e: Emitter, op: str, args: Sequence[str], width: int) -> str:
    """Emit a function of the C library on vectors of `width` numbers, and return the operand of the result.

    `op` is the operation, and `args` are its operands. The function is the vector routine for the operation if there
    is one, else the scalar function for each entry.
    """
    kind = type_of(REAL, width)
    name = vector_routines().get(op) if width == lanes() else None
    if name is not None:
        return e.value(f"call {kind} @{name}({', '.join(f'{kind} {arg}' for arg in args)})")
    made = "poison"
    for k in range(width):
        entries = [e.value(f"extractelement {kind} {arg}, i64 {k}") for arg in args]
        value = e.value(f"call double @{LIBRARY[op]}({', '.join(f'double {entry}' for entry in entries)})")
        made = e.value(f"insertelement {kind} {made}, double {value}, i64 {k}")
    return made


def routines_called(texts: Sequence[str]) -> list[str]:
    """Return the declarations of the vector routines that the given IR texts call."""
    if not any(f"@{ROUTINES}" in text for text in texts):
        return []
    names = vector_routines().items()
    return [declaration(name, op, lanes()) for op, name in names if any(f"@{name}(" in text for text in texts)]
