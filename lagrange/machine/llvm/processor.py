"""The processor for which machine code is compiled: width of its vector registers (lanes), name, features."""

from __future__ import annotations

import ctypes.util
from functools import cache

import llvmlite.binding as llvm


@cache
def start() -> None:
    """Set up LLVM for this process: compilation for this processor, and the C library of mathematical functions."""
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
