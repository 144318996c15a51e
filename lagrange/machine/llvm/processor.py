"""What this processor and its C library offer: the width of vectors, and functions on vectors."""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Mapping, Sequence
from functools import cache

import llvmlite.binding as llvm

from lagrange.machine.llvm.emitter import Emitter
from lagrange.machine.llvm.operations import LIBRARY, declaration, type_of
from lagrange.procedure.form import REAL
from lagrange.program.program import ARITY


@cache
def start() -> None:
    """Set up LLVM for this process: target, mathematics library and the linear solver."""
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
    """Return the target of compilation: the processor's name in LLVM, and the doubles of its vectors."""
    return f"{llvm.get_host_cpu_name()} with vectors of {lanes()}"


@cache
def vector_routines() -> dict[str, str]:
    """Return glibc's vector routine (libmvec) for each operation that has one on this processor."""
    start()
    try:
        routines = ctypes.CDLL("libmvec.so.1")
    except OSError:
        return {}
    llvm.load_library_permanently("libmvec.so.1")
    prefix = {8: "_ZGVeN8", 4: "_ZGVdN4", 2: "_ZGVbN2"}[lanes()]
    names = {op: f"{prefix}{'v' * (ARITY[op] or 0)}_{LIBRARY[op]}" for op in sorted(LIBRARY)}
    return {op: name for op, name in names.items() if hasattr(routines, name)}


def routine(op: str, width: int) -> str | None:
    """Return the C library's vector routine of an operation for `width` numbers, or None if it has none."""
    return vector_routines().get(op) if width == lanes() else None


def call_library(e: Emitter, op: str, args: Sequence[str], width: int) -> str:
    """Call the vector routine of the C library, or its function for each entry."""
    kind, name = type_of(REAL, width), routine(op, width)
    if name is not None:
        return e.value(f"call {kind} @{name}({', '.join(f'{kind} {arg}' for arg in args)})")
    made = "poison"
    for k in range(width):
        entries = [e.value(f"extractelement {kind} {arg}, i64 {k}") for arg in args]
        value = e.value(f"call double @{LIBRARY[op]}({', '.join(f'double {entry}' for entry in entries)})")
        made = e.value(f"insertelement {kind} {made}, double {value}, i64 {k}")
    return made


@cache
def routines() -> Mapping[str, str]:
    """Return the declaration of each vector routine of the C library by its name."""
    return {name: declaration(name, op, lanes()) for op, name in vector_routines().items()}
