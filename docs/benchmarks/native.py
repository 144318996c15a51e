"""C of this folder, compiled by gcc and loaded, kernels called from C, and the libraries of SUNDIALS."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import sksundae
from measure import FOLDER
from numpy.typing import NDArray

import lagrange as lg
from lagrange.machine.kernel.llvm_kernel import LlvmKernel

FLAGS = ("-O3", "-march=native")
SUNDIALS = ("core", "nvecserial", "sunmatrixdense", "sunlinsoldense")


@cache
def compiled(name: str) -> ctypes.CDLL:
    """Return the library of a C file of this folder."""
    with tempfile.TemporaryDirectory() as folder:
        return library(FOLDER / name, Path(folder))


def library(source: Path, folder: Path) -> ctypes.CDLL:
    """Return the library of a C file, compiled into a folder."""
    target = folder / f"{source.stem}.so"
    subprocess.run(["gcc", *FLAGS, "-shared", "-fPIC", "-o", target, source, "-lm"], check=True)
    return ctypes.CDLL(str(target))


def load_sundials(solver: str) -> None:
    """Load the libraries of a solver that scikit-sundae brings, so that C that is loaded later finds their symbols."""
    libraries = Path(sksundae.__file__).parent.parent / "scikit_sundae.libs"
    for name in (*SUNDIALS, solver):
        (path,) = libraries.glob(f"libsundials_{name}-*")
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)


def pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    """Return a pointer to an array, which lives as long as the pointer."""
    return array.ctypes.data_as(ctypes.c_void_p)


def address(function: Any) -> int:
    """Return the address of a function of a library."""
    return ctypes.cast(function, ctypes.c_void_p).value or 0


def kernel(model: lg.Model, quantity: str) -> tuple[int, NDArray[Any]]:
    """Return the address of a compiled kernel, and the numbers that it reads: parameters, and what depends on them."""
    code = model.kernel(quantity)
    assert isinstance(code, LlvmKernel)
    return code.address, code.prepare(model.parameter_array())


def in_turn(address: int, numbers: NDArray[Any], y: NDArray[Any], count: int) -> Callable[[], int]:
    """Return a call of `count` evaluations of a kernel from C, each of which waits for the one before."""
    function = compiled("right_side.c").waiting
    function.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_int64] * 2
    return partial(function, address, pointer(numbers), pointer(y), len(y), count)
